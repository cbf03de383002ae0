//! Exact collision queries against a set of pages: does a shape touch anything solid, where is the floor, what does a
//! ray hit.
//!
//! In: a [`Snapshot`] of pages and shapes in world coordinates [m, `f64`]. Out: one of
//! three kinds of answers: clear, hit, or "not loaded" with the missing pages. No query allocates, locks or waits.
//!
//! # Definition of touching
//!
//! Solid space is a set of closed boxes: a span of pixel `(i, j)` fills the pixel's square from its bottom to its top.
//! Shapes are closed, and touching counts as a hit. The monotone functions of [`Frame`](crate::frame::Frame) convert
//! all shapes to the grid, so the answer does not depend on page, tile or slice boundaries, and:
//!
//! - **G1**: a shape that contains an input point is a hit, at any coordinate up to ±10⁷ m.
//! - **G2**: a shape that contains no input point even when grown by the pixel size in x and y and by the slice height
//!   in z is clear. A box is exact: it is a hit if and only if pixels `pixel_of(xmin)..=pixel_of(xmax)`,
//!   `pixel_of(ymin)..=pixel_of(ymax)` hold a span with `bottom ≤ quantum_floor(zmax)` and `top ≥ quantum_ceil(zmin)`.
//!   For round shapes and rays, squares and radii grow by rounding errors: at most 2⁻⁴⁸ of the largest coordinate
//!   (4·10⁻⁸ m at 10⁷ m) on top of G2, always towards "hit".
//!
//! "Not loaded" replaces "clear" if a page that is not in memory is occupied in the relevant slices. A hit in a page in
//! memory is a hit, regardless of missing pages.
//!
//! # Method
//!
//! Broad phase and narrow phase of the thesis (algorithm 3.4) in one descent: tile columns under the shape, pages by
//! their slice mask, blocks of 8 × 8 pixels by their masks, then the union of the block's spans, then the spans of its
//! pixels.

mod aabb;
mod answer;
mod batch;
mod blocks;
mod ceiling;
mod cylinder;
mod disc;
mod floor;
mod footprint;
mod grid;
mod parts;
mod probe;
mod ray;
mod scan;
mod simd;
mod sphere;
mod sweep;

pub use aabb::Aabb;
pub use answer::{Answer, Overlap};
pub use ceiling::ceiling_above;
#[doc(hidden)]
pub use ceiling::ceiling_between;
pub use cylinder::Cylinder;
#[doc(hidden)]
pub use floor::floor_between;
pub use floor::floor_under;
pub use grid::Shape;
pub(crate) use grid::all_within_reach;
#[doc(hidden)]
pub use parts::{GridExtent, grid_extent};
pub use probe::{Probe, probe, probe_batch};
#[doc(hidden)]
pub use ray::first_of;
pub use ray::{Ray, RayBound, RayHit, cast, cast_batch, cast_far};
pub use sphere::Sphere;
pub(crate) use sweep::{GridCell, Matter, SweepArea, Visit, descend};
pub use sweep::{
    Solid, SurfacePoint, SweepHit, clearance, clearance_batch, depenetrate, depenetrate_batch, mean_floor_under,
    nearest_surface, nearest_surface_batch, sweep, sweep_batch, top_under,
};

use crate::store::Snapshot;
use blocks::MATTER;
use footprint::{Touch, for_each_column, touches_in_pixel};
use grid::sealed::OnPixels;

/// Returns whether `shape` touches anything solid. Ends at the first hit.
///
/// Cost: a few nanoseconds per tile column (64 × 64 pixels) and block (8 × 8 pixels) under the shape, less for a hit.
/// Exactness: see the [module text](self).
#[inline]
pub fn overlaps<H: Shape>(set: &Snapshot, shape: &H) -> Overlap {
    let shape = shape.on_grid(set.frame());
    let mut missing = None;
    let hit = match shape.pixel() {
        Some(pixel) => touches_in_pixel(set, pixel, shape.heights(), &mut missing),
        None => {
            let mut touch = Touch::new(&shape, MATTER);
            for_each_column(set, shape.rect(), |tile, slots| touch.column(&shape, tile, slots, &mut missing));
            touch.done()
        }
    };
    match missing {
        _ if hit => Overlap::Hit,
        Some(missing) => Overlap::NotLoaded(missing),
        None => Overlap::Clear,
    }
}

/// Runs [`overlaps`] for each of `shapes`, in order, into `answers`.
///
/// If the pages exceed the processor's caches and successive shapes lie apart, the shapes are processed in order of
/// place, which takes up to 16 bytes of memory per shape; otherwise no memory is allocated. The other batches do the same.
///
/// # Panics
/// If `answers` is shorter than `shapes`.
pub fn overlaps_batch<H: Shape>(set: &Snapshot, shapes: &[H], answers: &mut [Overlap]) {
    batch::overlaps_each(set, shapes, answers);
}
