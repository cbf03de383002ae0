//! Routes.

use crate::border::{
    Failure, Handle, Outcome, Sized32, close, fill, give, guard, held, output, place, record, sized, sw_status,
};
use crate::pages::sw_pages;
use crate::stream::numbers;
use crate::walker::sw_pawn;
use engine::NoMonitor;
use engine::reach::{Obstruction, ObstructionSearch, Pawn, Planned, Planner, Reason, Route, Sought};
use engine::seen::SeenSpace;
use engine::store::{Missing, Snapshot};
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
            Planned::NotLoaded(missing) => return Err(not_loaded(&missing)),
            _ => {}
        }
    }
}

fn not_loaded(missing: &Missing) -> Failure {
    let text = format!("{} pages of the route are not in memory; load them, or all pages", missing.count());
    Failure(sw_status::SW_ERROR_NOT_LOADED, text)
}

/// Obstruction of a pawn: where its best way stops, and the measure that would pass.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_obstruction {
    /// `sizeof(sw_obstruction)`, set by the caller.
    pub size: u32,
    /// Reason: `SW_OBSTRUCTION_NONE` to `SW_OBSTRUCTION_UNSEEN`.
    pub reason: u32,
    /// The last place that the pawn reaches (m).
    pub at: [f64; 3],
    /// The width along the shorter side, the length or the height of the largest pawn that passes with its other measures
    /// as they are, or the climb height that passes (m); the grade that passes (rise over run); or the distance to the
    /// ground that leads to the goal (m).
    pub needs: f64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_obstruction {
    const NAME: &'static str = "sw_obstruction";
}

impl sw_obstruction {
    fn of(found: Option<Obstruction>) -> Outcome<Self> {
        let size = size_of::<Self>() as u32;
        let Some(found) = found else { return Ok(Self { size, reason: 0, at: [f64::NAN; 3], needs: f64::NAN }) };
        let reason = match found.reason {
            Reason::Width => 1,
            Reason::Length => 2,
            Reason::Headroom => 3,
            Reason::Step => 4,
            Reason::Slope => 5,
            Reason::Ramp => 6,
            Reason::Gap => 7,
            Reason::Unseen => 8,
            other => return Err(Failure(sw_status::SW_ERROR_INTERNAL, format!("no number of {}", other.name()))),
        };
        Ok(Self { size, reason, at: found.at.into(), needs: found.needs })
    }
}

/// Finds what keeps the pawn, which may be bound to `seen` space, from its goal.
pub fn blocked(
    set: &Snapshot,
    seen: Option<Arc<SeenSpace>>,
    pawn: Pawn,
    [from, to]: [[f64; 3]; 2],
) -> Outcome<sw_obstruction> {
    let mut search = ObstructionSearch::new(set, pawn, from.into(), to.into(), &NoMonitor)?.within_seen(seen);
    loop {
        match search.advance(set)? {
            Sought::Done(found) => return sw_obstruction::of(found),
            Sought::NotLoaded(missing) => return Err(not_loaded(&missing)),
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
        let made = || {
            // SAFETY: as the header demands of handles, structs and arrays.
            let (pages, (pawn, ends)) = unsafe { (held(pages)?, ends(pawn, from, to)?) };
            plan(pages, None, pawn, ends)
        };
        // SAFETY: as the header demands of `route`.
        unsafe { give(route, made) }
    })
}

/// Finds what is in the way where `sw_route_plan` with the same arguments returned `SW_ERROR_NO_ROUTE`. The reason is the
/// smallest change, relative to the pawn's own measure, that opens a way of at most twice the straight distance plus
/// 30 m. It is `SW_OBSTRUCTION_NONE` if the pawn gets to the goal, cannot stand at one of the places, or if nothing was
/// found; the numbers are NaN then. Takes up to about 25 times as long as finding all places within that distance.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_route_blocked(
    pages: *const sw_pages,
    pawn: *const sw_pawn,
    from: *const f64,
    to: *const f64,
    obstruction: *mut sw_obstruction,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of structs.
        unsafe { sized(obstruction) }?;
        // SAFETY: as the header demands of handles, structs and arrays.
        let (pages, (pawn, ends)) = unsafe { (held(pages)?, ends(pawn, from, to)?) };
        let found = blocked(pages, None, pawn, ends)?;
        // SAFETY: as the header demands of structs.
        unsafe { fill(obstruction, found) }
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
