//! Space that the scanners saw.

use crate::archive::sw_archive;
use crate::border::{Handle, close, fill, give, guard, held, place, sized, sw_status};
use crate::pages::{aabb, batch, sw_pages};
use crate::route::{blocked, ends, plan, sw_obstruction, sw_route};
use crate::walker::sw_pawn;
use engine::Error;
use engine::query::Ray;
use engine::seen::SeenSpace;
use std::sync::Arc;

/// Space that the scanners of an archive saw. Any number of threads may use it at once.
///
/// Space is divided into cells of 4 × 4 pixels and one slice. A cell is seen only if one station looked through all of
/// it; of all other cells nothing is known. The cells of a surface and about two in front of it are never seen.
pub struct sw_seen;

impl Handle for sw_seen {
    type Value = Arc<SeenSpace>;
    const NAME: &'static str = "sw_seen";
}

/// Reads the seen space of an archive. `seen` gets NULL if the archive was written without, so that nothing is known.
/// Space that takes more than `memory` bytes is refused with `SW_ERROR_LIMIT`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_load(archive: *const sw_archive, memory: u64, seen: *mut *mut sw_seen) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `seen`.
        unsafe { place(seen, "place of the new handle") }?.write(std::ptr::null_mut());
        // SAFETY: as the header demands of handles.
        let opened = unsafe { held(archive) }?;
        match opened.archive.seen_space(memory)? {
            // SAFETY: as the header demands of `seen`.
            Some(space) => unsafe { give(seen, || Ok(Arc::new(space))) },
            None => Ok(()),
        }
    })
}

/// Writes the number of seen cells into `cells`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_cells(seen: *const sw_seen, cells: *mut u64) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles.
        let space = unsafe { held(seen) }?;
        // SAFETY: as the header demands of `cells`.
        unsafe { place(cells, "cells") }?.write(space.cells());
        Ok(())
    })
}

/// Answers whether places were seen: 3 numbers each, x, y, z (m). `answers` gets `count` values: 1 if it was, else 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_places(
    seen: *const sw_seen,
    places: *const f64,
    places_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        batch(seen, (places, places_len, "places"), (answers, count), |space: &Arc<SeenSpace>, row: &[f64; 3]| {
            if !row.iter().all(|v| v.is_finite()) {
                return Err(Error::parameter("place", "its numbers must be finite"));
            }
            Ok(space.is_seen((*row).into()).into())
        })
    })
}

/// Answers whether all of each box was seen, like `sw_seen_places`: 6 numbers each, as for `sw_overlaps_boxes`. A box that
/// is clear and seen is free; one that is clear and not seen may hold solid that was never scanned.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_boxes(
    seen: *const sw_seen,
    boxes: *const f64,
    boxes_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        batch(seen, (boxes, boxes_len, "boxes"), (answers, count), |space: &Arc<SeenSpace>, row: &[f64; 6]| {
            let shape = aabb(row)?;
            Ok(space.is_box_seen(shape.min(), shape.max()).into())
        })
    })
}

/// Answers whether all of each ray was seen, like `sw_seen_places`: 8 numbers each, those of `sw_cast_rays`, then the
/// distance that it answered. The ray is followed up to its hit, before which two cells along each axis count as seen,
/// or without a hit up to its longest distance. The answer is 0 where the distance is NaN.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_rays(
    seen: *const sw_seen,
    rays: *const f64,
    rays_len: usize,
    answers: *mut u8,
    count: usize,
) -> sw_status {
    // SAFETY: as the header demands of handles and arrays.
    guard(|| unsafe {
        let given = (rays, rays_len, "rays");
        let answer = |space: &Arc<SeenSpace>, &[x, y, z, dx, dy, dz, max, distance]: &[f64; 8]| {
            let ray = Ray::new([x, y, z].into(), [dx, dy, dz].into(), max)?;
            if distance < 0.0 {
                return Err(Error::parameter("distance", "expected 0 or more"));
            }
            let hits = distance <= ray.max();
            let length = if hits { distance } else { ray.max() };
            let is_seen = !distance.is_nan() && space.is_ray_seen(ray.origin(), ray.direction(), length, hits);
            Ok(is_seen.into())
        };
        batch(seen, given, (answers, count), answer)
    })
}

/// Plans a route like `sw_route_plan`, on which the line through the middle of the pawn was seen, from its climb height
/// to its head. All other ground counts as none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_plan_seen(
    pages: *const sw_pages,
    seen: *const sw_seen,
    pawn: *const sw_pawn,
    from: *const f64,
    to: *const f64,
    route: *mut *mut sw_route,
) -> sw_status {
    guard(|| {
        let made = || {
            // SAFETY: as the header demands of handles, structs and arrays.
            let (pages, space, (pawn, ends)) = unsafe { (held(pages)?, held(seen)?, ends(pawn, from, to)?) };
            plan(pages, Some(space.clone()), pawn, ends)
        };
        // SAFETY: as the header demands of `route`.
        unsafe { give(route, made) }
    })
}

/// Finds what is in the way like `sw_route_blocked`, where `sw_route_plan_seen` returned `SW_ERROR_NO_ROUTE`. If the pawn
/// gets to the goal over ground where it was not seen, the reason is `SW_OBSTRUCTION_UNSEEN`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_blocked_seen(
    pages: *const sw_pages,
    seen: *const sw_seen,
    pawn: *const sw_pawn,
    from: *const f64,
    to: *const f64,
    obstruction: *mut sw_obstruction,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of structs.
        unsafe { sized(obstruction) }?;
        // SAFETY: as the header demands of handles, structs and arrays.
        let (pages, space, (pawn, ends)) = unsafe { (held(pages)?, held(seen)?, ends(pawn, from, to)?) };
        let found = blocked(pages, Some(space.clone()), pawn, ends)?;
        // SAFETY: as the header demands of structs.
        unsafe { fill(obstruction, found) }
    })
}

/// Closes seen space. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_seen_close(seen: *mut sw_seen) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(seen) }
}
