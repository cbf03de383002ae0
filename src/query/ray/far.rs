//! Rays beyond the pages in memory: overview levels give a lower bound of their free length.

use super::super::answer::Answer;
use super::{Ray, RayHit, cast};
use crate::frame::{Frame, PAGE_SLICES, PageKey, TILE_PIXELS};
use crate::store::Snapshot;

/// Result of [`cast_far`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RayBound {
    /// The answer that [`cast`] would give if all pages were loaded.
    Exact(Option<RayHit>),
    /// A page is missing where the ray may hit something, and there is nothing solid nearer than this distance (m). The
    /// bound comes from an overview level, which shows where something may be solid but not where it is.
    AtLeast(f64),
}

/// Returns the first solid that `ray` hits in `set`. If pages are missing, `level`, an overview level of the same
/// archive ([`Archive::level`](crate::archive::Archive::level)), bounds the free length of the ray from below: a level
/// covers all solid space of the pages, so whatever is free in it is free. Not loaded if pages of the level are
/// missing, too.
///
/// Cost: up to three rays. The pages answer up to the first missing page, the level from there on.
pub fn cast_far(set: &Snapshot, level: &Snapshot, ray: &Ray) -> Answer<RayBound> {
    let missing = match cast(set, ray) {
        Answer::Known(hit) => return Answer::Known(RayBound::Exact(hit)),
        Answer::NotLoaded(missing) => missing,
    };
    let entries = missing.keys().iter().map(|key| entry(set.frame(), *key, ray));
    // Covers what rounding can change.
    let margin = 1e-6 + 1e-13 * ray.origin.coords.amax();
    let near = (entries.fold(f64::INFINITY, f64::min) - margin).clamp(0.0, ray.max);
    // More pages may be missing than the answer names.
    let known = cast(set, &Ray { max: near, ..*ray }) == Answer::Known(None);
    let near = if known { near } else { 0.0 };
    match cast(level, &Ray { origin: ray.at(near), max: ray.max - near, ..*ray }) {
        Answer::Known(None) => Answer::Known(RayBound::Exact(None)),
        Answer::Known(Some(hit)) => Answer::Known(RayBound::AtLeast((near + hit.distance - margin).max(near))),
        Answer::NotLoaded(_) => Answer::NotLoaded(missing),
    }
}

/// Returns the distance at which a ray enters a page's box (m); 0 if it misses the box because of rounding.
fn entry(frame: &Frame, key: PageKey, ray: &Ray) -> f64 {
    let edge = TILE_PIXELS as f64 * frame.pixel_m();
    let size = [edge, edge, PAGE_SLICES as f64 * frame.slice_m()];
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for (axis, (number, size)) in [key.tx, key.ty, key.layer].into_iter().zip(size).enumerate() {
        let (origin, direction) = (ray.origin[axis], ray.direction[axis]);
        let low = f64::from(number) * size;
        if direction != 0.0 {
            let (a, b) = ((low - origin) / direction, (low + size - origin) / direction);
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
    }
    if enter <= leave { enter } else { 0.0 }
}
