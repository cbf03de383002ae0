//! Rays: the first solid along a half-line.
//!
//! Two searches give the same answer. Both step through cells on four levels: regions of 64 × 64 tiles, tiles, blocks,
//! pixels.
//!
//! - The *exact* search follows Amanatides and Woo (1987), with two differences. It computes crossings from the cell's
//!   index instead of adding them up, so errors do not grow with the number of steps. And it grows cells by a margin,
//!   so a ray along an edge or through a corner visits the cells on both sides.
//! - The *quick* search reads from masks which blocks and pixels are occupied, and computes where the ray meets these
//!   alone. It grows cells by far more than the margin and so misses nothing. A hit counts only if the ray also meets
//!   it with cells shrunk by the same amount. If the two differ, or a page is missing, the exact search decides.

mod exact;
mod far;
mod line;
mod walk;

use super::answer::Answer;
use super::batch;
use super::grid::all_within_reach;
use crate::frame::{Frame, PAGE_QUANTA};
use crate::page::Span;
use crate::store::Snapshot;
use crate::text::{number, place};
use crate::{Error, Result};
pub use far::{RayBound, cast_far};
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
    /// Creates the ray from `origin` (m, within ±10¹⁰⁰) along `direction` (finite, of any length but zero) with a
    /// length of `max` [m, >= 0, may be infinite]. Fails if a value lies outside these ranges.
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

    /// Returns the origin (m).
    pub fn origin(&self) -> Point3<f64> {
        self.origin
    }

    /// Returns the direction, of length 1.
    pub fn direction(&self) -> Vector3<f64> {
        self.direction
    }

    /// Returns the length (m).
    pub fn max(&self) -> f64 {
        self.max
    }

    /// Returns the point at `distance` from the origin (m).
    pub fn at(&self, distance: f64) -> Point3<f64> {
        self.origin + self.direction * distance
    }
}

/// First solid along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RayHit {
    /// Distance from the origin (m).
    pub distance: f64,
    /// Outward normal of the face that was hit: ±x or ±y for the side of a pixel, ±z for the top or bottom of a span.
    /// Zero if the ray begins inside or on a solid: then there is no such face, and the distance is 0.
    pub normal: Vector3<f64>,
    /// The span that was hit is an obstacle.
    pub obstacle: bool,
}

impl RayHit {
    /// Returns whether this hit precedes `other`; at equal distances an obstacle does.
    fn is_before(&self, other: &Self) -> bool {
        self.distance < other.distance || self.distance == other.distance && self.obstacle
    }
}

/// Returns the first solid that `ray` hits; `None` if it hits nothing within its length. Not loaded if a page that is
/// not in memory could hold an earlier hit.
///
/// Solid space is that of [all queries](super#definition-of-touching). Pixel squares are closed and grown by at most
/// 2⁻⁴⁸ of the coordinates, so a ray through an input point always hits. A ray that grazes a face may meet it earlier
/// by that amount divided by the sine of their angle. If the ray enters through a pixel's side and a span's end at
/// once, the result has the side's normal.
///
/// Cost: one step per tile column along the ray, per block in pages occupied at the ray's heights, and per pixel in
/// blocks occupied there. A region of 64 × 64 tiles without pages is one step.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Answer, Ray, cast};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::store::Snapshot;
///
/// let frame = Frame::new(0.5, 1.5)?;
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(4, 0, &[Span::new(0, 255, true).unwrap()])); // x from 2 to 2.5, z from 0 to 1.5
/// let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let ray = Ray::new(Point3::new(-3.0, 0.25, 1.0), Vector3::new(2.0, 0.0, 0.0), 100.0)?;
/// let Answer::Known(Some(hit)) = cast(&store, &ray) else { panic!("the pillar stands in the way") };
/// assert!((hit.distance - 5.0).abs() < 1e-12);
/// assert_eq!(hit.normal, -Vector3::x());
/// # Ok::<(), slicewalk::Error>(())
/// ```
pub fn cast(set: &Snapshot, ray: &Ray) -> Answer<Option<RayHit>> {
    let Some(bounds) = set.bounds() else { return Answer::Known(None) };
    let line = Line::new(set.frame(), ray);
    // A web page casts few rays, and would have to fetch the 2 kB of the quick search before its first step.
    if cfg!(target_family = "wasm") {
        return exact::search(set, line, &bounds);
    }
    walk::first_hit(set, &line, &bounds).map_or_else(|_| exact::search(set, line, &bounds), Answer::Known)
}

/// Returns the first hit among `spans` of one pixel of a page in `layer`, all of which `ray` must meet; `None` without
/// spans. For programs that find the pixel themselves.
#[doc(hidden)]
pub fn first_of(frame: &Frame, ray: &Ray, pixel: [i64; 2], layer: i32, spans: &[Span]) -> Option<RayHit> {
    let (line, base) = (Line::new(frame, ray), i64::from(layer) * PAGE_QUANTA);
    let hits = spans.iter().map(|&span| line.meet((pixel[0], pixel[1]), base, span));
    hits.reduce(|first, hit| if hit.is_before(&first) { hit } else { first })
}

/// Runs [`cast`] for each of `rays`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `rays`.
pub fn cast_batch(set: &Snapshot, rays: &[Ray], answers: &mut [Answer<Option<RayHit>>]) {
    let pixel = |ray: &Ray| [ray.origin.x, ray.origin.y].map(|along| set.frame().pixel_of(along));
    batch::answer_each(set, rays, answers, pixel, |ray| cast(set, ray));
}

#[cfg(test)]
mod tests;
