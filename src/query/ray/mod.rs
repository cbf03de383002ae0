//! Rays: the first matter along a half-line.
//!
//! Two searches give one answer. Both step through cells on four levels: regions of 64 × 64 tiles, tiles, blocks, pixels.
//!
//! - The *exact* one follows Amanatides and Woo (1987), with two differences. Crossings are computed from the cell's index
//!   instead of summed up, so errors do not grow with the number of steps. And cells are grown by a margin, so a ray along
//!   an edge or through a corner looks at the cells on both sides.
//! - The *quick* one asks masks which rows of blocks and pixels hold matter, and computes where the ray meets these alone.
//!   It grows cells by far more than the margin and so passes over nothing that counts. What it meets counts only if the
//!   ray meets it with cells shrunk by as much, too. Where the two differ, or a page is missing, the exact search decides.

mod exact;
mod far;
mod line;
mod walk;

use super::answer::Answer;
use super::batch;
use super::grid::all_within_reach;
use crate::store::PageSet;
use crate::text::{number, place};
use crate::{Error, Result};
pub use far::{Sight, cast_far};
use line::Line;
use nalgebra::{Point3, Vector3};

/// A half-line of limited length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    origin: Point3<f64>,
    direction: Vector3<f64>,
    max: f64,
}

impl Ray {
    /// The ray from `origin` (m, within ±10¹⁰⁰) along `direction` (finite, of any length but zero) for `max` metres
    /// [m, >= 0, may be infinite].
    pub fn new(origin: Point3<f64>, direction: Vector3<f64>, max: f64) -> Result<Self> {
        let scale = direction.amax();
        let fits = all_within_reach(&origin.coords) && direction.iter().all(|v| v.is_finite());
        if !fits || scale == 0.0 || max.is_nan() || max < 0.0 {
            let reason = format!(
                "no ray begins at {}, points along {} and is {} m long",
                place(origin.into()),
                place(direction.into()),
                number(max)
            );
            return Err(Error::parameter("ray", reason));
        }
        // Scaled first, so that the square of a tiny or huge length neither vanishes nor overflows.
        Ok(Self { origin, direction: (direction / scale).normalize(), max })
    }

    /// Where the ray begins (m).
    pub fn origin(&self) -> Point3<f64> {
        self.origin
    }

    /// Direction, of length 1.
    pub fn direction(&self) -> Vector3<f64> {
        self.direction
    }

    /// Length (m).
    pub fn max(&self) -> f64 {
        self.max
    }

    /// The point at `distance` from the origin (m).
    pub fn at(&self, distance: f64) -> Point3<f64> {
        self.origin + self.direction * distance
    }
}

/// The first matter along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RayHit {
    /// Distance from the origin (m).
    pub distance: f64,
    /// Outward normal of the face that was hit: ±x or ±y for the side of a pixel, ±z for the top or bottom of a span.
    /// Zero if the ray begins in or on matter: then there is no such face, and the distance is 0.
    pub normal: Vector3<f64>,
    /// The matter is an obstacle.
    pub obstacle: bool,
}

impl RayHit {
    /// Whether this is the first of two hits; of two at one distance an obstacle is.
    fn is_before(&self, other: &Self) -> bool {
        self.distance < other.distance || self.distance == other.distance && self.obstacle
    }
}

/// The first matter that `ray` meets; `None` if there is none within its length. Not loaded if a page that is not in
/// memory could hold matter before that.
///
/// Matter is as for [all queries](super#what-touching-means); squares are closed and grown by at most 2⁻⁴⁸ of the
/// coordinates, so a ray through an input point always hits; a ray that grazes a face may meet it earlier by as much
/// over the sine of their angle. Where the ray enters a side and a span's end at once, the side's normal is given.
///
/// Cost: a step per tile column on the way, per block in pages with matter at the ray's heights, and per pixel in blocks
/// with matter there; a region of 64 × 64 tiles without pages is one step.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Answer, Ray, cast};
/// use slicewalk::slice::{PageBuilder, Span};
/// use slicewalk::store::Store;
///
/// let frame = Frame::new(0.5, 1.5)?;
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(4, 0, &[Span::new(0, 255, true).unwrap()])); // x from 2 to 2.5, z from 0 to 1.5
/// let store = Store::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let ray = Ray::new(Point3::new(-3.0, 0.25, 1.0), Vector3::new(2.0, 0.0, 0.0), 100.0)?;
/// let Answer::Known(Some(hit)) = cast(&store, &ray) else { panic!("the pillar stands in the way") };
/// assert!((hit.distance - 5.0).abs() < 1e-12);
/// assert_eq!(hit.normal, -Vector3::x());
/// # Ok::<(), slicewalk::Error>(())
/// ```
pub fn cast<S: PageSet>(set: &S, ray: &Ray) -> Answer<Option<RayHit>> {
    let Some(bounds) = set.bounds() else { return Answer::Known(None) };
    let line = Line::new(set.frame(), ray);
    // A page on the web asks few rays, and the quick search would be 2 kB of what it fetches before the first step.
    if cfg!(target_family = "wasm") {
        return exact::search(set, line, &bounds);
    }
    walk::first_hit(set, &line, &bounds).map_or_else(|_| exact::search(set, line, &bounds), Answer::Known)
}

/// [`cast`] for each of `rays`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `rays`.
pub fn cast_batch<S: PageSet>(set: &S, rays: &[Ray], answers: &mut [Answer<Option<RayHit>>]) {
    let pixel = |ray: &Ray| [ray.origin.x, ray.origin.y].map(|along| set.frame().pixel_of(along));
    batch::answer_each(set, rays, answers, pixel, |ray| cast(set, ray));
}

#[cfg(test)]
mod tests;
