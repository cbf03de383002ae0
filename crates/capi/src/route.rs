//! Routes.

use crate::border::{Failure, Handle, Outcome, close, give, guard, held, output, place, record, sw_status};
use crate::pages::sw_pages;
use crate::stream::numbers;
use crate::walker::sw_pawn;
use engine::NoMonitor;
use engine::reach::{Pawn, Planned, Planner, Route};
use engine::seen::SeenSpace;
use engine::store::Snapshot;
use std::sync::Arc;

/// A route that a walker can follow. Any number of threads may use it at once.
pub struct sw_route;

impl Handle for sw_route {
    type Value = Route;
    const NAME: &'static str = "sw_route";
}

/// Places that a planner visits between two looks at its state.
const STEPS: usize = 1 << 20;

/// Plans the route, which may be bound to `seen` space.
pub fn plan(set: &Snapshot, seen: Option<Arc<SeenSpace>>, pawn: Pawn, [from, to]: [[f64; 3]; 2]) -> Outcome<Route> {
    let mut planner = Planner::new(set, pawn, from.into(), to.into())?.within_seen(seen);
    loop {
        match planner.advance(set, STEPS, &NoMonitor)? {
            Planned::Done(Ok(route)) => return Ok(route),
            Planned::Done(Err(refusal)) => {
                let text = format!("no route: {}", refusal.name());
                return Err(Failure(sw_status::SW_ERROR_NO_ROUTE, text));
            }
            Planned::NotLoaded(missing) => {
                let text = format!("{} pages of the route are not in memory; load them, or all pages", missing.count());
                return Err(Failure(sw_status::SW_ERROR_NOT_LOADED, text));
            }
            _ => {}
        }
    }
}

/// Reads the pawn of a route, and its ends.
///
/// # Safety
/// The conditions of [`record`] and [`numbers`] hold.
pub unsafe fn ends(pawn: *const sw_pawn, from: *const f64, to: *const f64) -> Outcome<(Pawn, [[f64; 3]; 2])> {
    // SAFETY: guaranteed by the caller.
    let (pawn, from, to) = unsafe { (record(pawn)?, numbers::<3>(from, "from")?, numbers::<3>(to, "to")?) };
    let max_drop = if pawn.max_drop == f64::INFINITY { pawn.climb } else { pawn.max_drop };
    Ok((Pawn { climb: pawn.climb, max_drop, ..Pawn::new(pawn.body()?) }, [from, to]))
}

/// Plans a route of a pawn between two places of 3 numbers (m); a place in the air stands for the floor below it. A
/// pawn whose `max_drop` is infinite steps down as far as it climbs. The call returns when the search ends: call it on
/// a thread of its own if the program must not wait.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_plan(
    pages: *const sw_pages,
    pawn: *const sw_pawn,
    from: *const f64,
    to: *const f64,
    route: *mut *mut sw_route,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles, structs and arrays.
        let (pages, (pawn, ends)) = unsafe { (held(pages)?, ends(pawn, from, to)?) };
        // SAFETY: as the header demands of `route`.
        unsafe { give(route, || plan(pages, None, pawn, ends)) }
    })
}

/// Writes the length of a route (m) and the number of its points. Either pointer may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_size(route: *const sw_route, length: *mut f64, points: *mut usize) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles.
        let route = unsafe { held(route) }?;
        if !length.is_null() {
            // SAFETY: as the header demands of `length`.
            unsafe { place(length, "length") }?.write(route.length_m);
        }
        if !points.is_null() {
            // SAFETY: as the header demands of `points`.
            unsafe { place(points, "points") }?.write(route.points.len());
        }
        Ok(())
    })
}

/// Writes the points of a route, 3 numbers each (m). `xyz_len` must be 3 times the number of points.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_points(route: *const sw_route, xyz: *mut f64, xyz_len: usize) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles.
        let route = unsafe { held(route) }?;
        let count = route.points.len();
        if xyz_len != 3 * count {
            let text = format!("xyz: expected room for {} numbers of {count} points, found {xyz_len}", 3 * count);
            return Err(Failure::argument(text));
        }
        // SAFETY: as the header demands of `xyz`.
        let xyz = unsafe { output(xyz, xyz_len, "xyz") }?;
        let numbers = route.points.iter().flat_map(|point| [point.x, point.y, point.z]);
        xyz.iter_mut().zip(numbers).for_each(|(place, value)| _ = place.write(value));
        Ok(())
    })
}

/// Closes a route. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_close(route: *mut sw_route) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(route) }
}
