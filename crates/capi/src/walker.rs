//! Walkers.

use crate::border::{
    Failure, Handle, Outcome, Sized32, close, fill, give, guard, held, output, place, record, sized, sw_status,
};
use crate::pages::sw_pages;
use crate::stream::{busy, numbers, sw_stream};
use engine::nalgebra::{Point2, Vector2};
use engine::store::{Missing, PawnHandle, Stream};
use engine::walk::{Body, Config, Ground, MoveInput, State, StepReport, Stop, Walker};
use std::sync::{Arc, Mutex, MutexGuard, Weak};

/// A pawn with gravity, stairs and walls. One thread at a time: another one gets `SW_ERROR_BUSY`.
pub struct sw_walker;

impl Handle for sw_walker {
    type Value = Mutex<Pawn>;
    const NAME: &'static str = "sw_walker";
}

/// A walker, and its hints to the stream that it walked on last.
pub struct Pawn {
    walker: Walker,
    missing: Option<Missing>,
    hints: Option<(Weak<Stream>, PawnHandle)>,
}

/// Shape and abilities of a pawn. `sw_pawn_default` fills it in.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_pawn {
    /// `sizeof(sw_pawn)`, set by the caller.
    pub size: u32,
    /// `SW_BOX` or `SW_CYLINDER`.
    pub shape: u32,
    /// Width along x; the diameter of a cylinder (m).
    pub width: f64,
    /// Width along y (m); not used for a cylinder.
    pub depth: f64,
    /// Height (m).
    pub height: f64,
    /// Highest step that it climbs (m).
    pub climb: f64,
    /// Deepest drop that it steps down (m); with infinity, it falls off any ledge.
    pub max_drop: f64,
    /// Walking speed (m/s).
    pub speed: f64,
    /// Acceleration downwards (m/s²).
    pub gravity: f64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_pawn {
    const NAME: &'static str = "sw_pawn";
}

impl sw_pawn {
    /// Returns its shape.
    pub fn body(&self) -> Outcome<Body> {
        match self.shape {
            0 => Ok(Body::Box { x: self.width, y: self.depth, height: self.height }),
            1 => Ok(Body::Cylinder { radius: self.width / 2.0, height: self.height }),
            other => Err(Failure::argument(format!("sw_pawn.shape: expected 0 (box) or 1 (cylinder), found {other}"))),
        }
    }

    fn config(&self) -> Outcome<Config> {
        let max_drop = Some(self.max_drop).filter(|&drop| drop != f64::INFINITY);
        let (speed, climb, gravity) = (self.speed, self.climb, self.gravity);
        Ok(Config { speed, climb, gravity, max_drop, ..Config::new(self.body()?) })
    }
}

/// Result of a step.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct sw_step {
    /// `sizeof(sw_step)`, set by the caller.
    pub size: u32,
    /// State after the step: `SW_WALKING` to `SW_ARRIVED`.
    pub state: u32,
    /// Why it stopped short: `SW_STOP_NONE` to `SW_STOP_VOID`.
    pub stop: u32,
    /// Ticks of 1/240 s that passed.
    pub ticks: u32,
    /// Number of pages that it waits for; `sw_walker_missing` writes their keys.
    pub missing: u32,
    /// Ground under it: 0 floor, 1 an obstacle, 2 no ground.
    pub ground: u32,
    /// Unused time, because it waits for pages (s). Pass it to the next step, or drop it.
    pub unspent: f64,
    /// Feet after the step (m).
    pub feet: [f64; 3],
    /// Motion of the feet (m).
    pub moved: [f64; 3],
    /// Speed downwards (m/s).
    pub falling: f64,
}

// SAFETY: `repr(C)`, the size first, and numbers only.
unsafe impl Sized32 for sw_step {
    const NAME: &'static str = "sw_step";
}

/// Distance along x and y within which a pawn is at the place that it walks toward (m): it gets there but for rounding.
const THERE_M: f64 = 1e-6;

impl sw_step {
    fn of(report: &StepReport, walker: &Walker, wish: MoveInput) -> Self {
        let is_there = match wish {
            MoveInput::Toward(place) => (place - walker.feet().xy()).amax() <= THERE_M,
            _ => false,
        };
        let stop = report.stop.map_or(0, |stop| match stop {
            Stop::Wall => 1,
            Stop::Steep => 2,
            Stop::Headroom => 3,
            Stop::Corner => 4,
            Stop::Inside => 5,
            Stop::Ledge => 6,
            Stop::Void => 7,
        });
        Self {
            size: size_of::<Self>() as u32,
            state: match report.state {
                State::Walking if is_there => 3,
                State::Walking => 0,
                State::Falling => 1,
                State::Blocked => 2,
                State::Arrived => 3,
            },
            stop,
            ticks: report.ticks,
            missing: u32::try_from(report.missing_count()).unwrap_or(u32::MAX),
            ground: match walker.ground() {
                Ground::Floor => 0,
                Ground::Obstacle => 1,
                Ground::Air => 2,
            },
            unspent: report.unspent,
            feet: walker.feet().into(),
            moved: report.moved.into(),
            falling: walker.falling(),
        }
    }
}

/// Fills in a pawn of 0.5 × 0.5 × 1.8 m that climbs 0.35 m, walks 1.4 m/s, and falls off any ledge.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_pawn_default(pawn: *mut sw_pawn) -> sw_status {
    let config = Config::default();
    let value = sw_pawn {
        size: size_of::<sw_pawn>() as u32,
        shape: 0,
        width: 2.0 * config.body.half().x,
        depth: 2.0 * config.body.half().y,
        height: config.body.height(),
        climb: config.climb,
        max_drop: f64::INFINITY,
        speed: config.speed,
        gravity: config.gravity,
    };
    // SAFETY: as the header demands of structs.
    guard(|| unsafe { fill(pawn, value) })
}

/// Creates a walker with its feet at `feet`, 3 numbers (m).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_open(
    pawn: *const sw_pawn,
    feet: *const f64,
    walker: *mut *mut sw_walker,
) -> sw_status {
    guard(|| {
        let made = || {
            // SAFETY: as the header demands of structs and arrays.
            let (pawn, feet) = unsafe { (record(pawn)?, numbers::<3>(feet, "feet")?) };
            let walker = Walker::new(pawn.config()?, feet.into())?;
            Ok(Mutex::new(Pawn { walker, missing: None, hints: None }))
        };
        // SAFETY: as the header demands of `walker`.
        unsafe { give(walker, made) }
    })
}

/// # Safety
/// The conditions of [`held`] hold.
unsafe fn locked<'a>(walker: *const sw_walker) -> Outcome<MutexGuard<'a, Pawn>> {
    // SAFETY: guaranteed by the caller.
    unsafe { held(walker) }?.try_lock().map_err(|_| busy("walker"))
}

/// # Safety
/// The conditions of [`numbers`] hold for `to`, unless `wish` needs no numbers.
unsafe fn wish(wish: u32, to: *const f64, dt: f64) -> Outcome<MoveInput> {
    if !dt.is_finite() || dt < 0.0 {
        return Err(Failure::argument(format!("dt: expected seconds, 0 or more, found {dt}")));
    }
    // SAFETY: guaranteed by the caller.
    let to = || unsafe { numbers::<2>(to, "to") };
    match wish {
        0 => Ok(MoveInput::Stay),
        1 => Ok(MoveInput::Direction(Vector2::from(to()?))),
        2 => Ok(MoveInput::Toward(Point2::from(to()?))),
        other => Err(Failure::argument(format!("wish: expected 0 (stay), 1 (direction) or 2 (toward), found {other}"))),
    }
}

/// Advances the walker by `dt` seconds. `wish` is `SW_STAY`, `SW_DIRECTION` or `SW_TOWARD`, and `to` the two numbers of
/// the direction or the place (NULL for `SW_STAY`). The state is `SW_ARRIVED` if it is on its feet at that place. If
/// pages are missing, the pawn waits in place and `report` counts them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_step(
    walker: *const sw_walker,
    pages: *const sw_pages,
    dt: f64,
    wish: u32,
    to: *const f64,
    report: *mut sw_step,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `report`. A call that is refused moves nothing.
        unsafe { sized(report) }?;
        // SAFETY: as the header demands of handles and arrays.
        let (mut pawn, pages, wish) = unsafe { (locked(walker)?, held(pages)?, self::wish(wish, to, dt)?) };
        let done = pawn.walker.step(pages, dt, wish);
        pawn.missing = done.missing;
        // SAFETY: as the header demands of `report`.
        unsafe { fill(report, sw_step::of(&done, &pawn.walker, wish)) }
    })
}

/// Like `sw_walker_step`, on the pages that a stream has now. It also hints the motion to the stream and asks for
/// missing pages, so the pawn continues as soon as they are loaded.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_step_stream(
    walker: *const sw_walker,
    stream: *const sw_stream,
    dt: f64,
    wish: u32,
    to: *const f64,
    report: *mut sw_step,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of `report`. A call that is refused moves nothing.
        unsafe { sized(report) }?;
        // SAFETY: as the header demands of handles and arrays.
        let (mut pawn, stream, wish) = unsafe { (locked(walker)?, held(stream)?, self::wish(wish, to, dt)?) };
        let pawn = &mut *pawn;
        let same = pawn.hints.take().filter(|(own, _)| own.as_ptr() == Arc::as_ptr(stream));
        let (own, mut hints) = same.unwrap_or_else(|| (Arc::downgrade(stream), stream.pawn()));
        hints.hint(&pawn.walker.motion_hint(stream.archive().frame()));
        let done = pawn.walker.step(&stream.snapshot(), dt, wish);
        if let Some(missing) = &done.missing {
            hints.need(missing);
        }
        pawn.hints = Some((own, hints));
        pawn.missing = done.missing;
        // SAFETY: as the header demands of `report`.
        unsafe { fill(report, sw_step::of(&done, &pawn.walker, wish)) }
    })
}

/// Writes the keys of the pages that the last step waited for into `keys`, 3 numbers each and at most 16 pages, and the
/// number of written numbers into `written`. Keys that do not fit into `keys_len` numbers are left out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_missing(
    walker: *const sw_walker,
    keys: *mut i32,
    keys_len: usize,
    written: *mut usize,
) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and arrays.
        let (pawn, keys, written) =
            unsafe { (locked(walker)?, output(keys, keys_len, "keys")?, place(written, "written")?) };
        let missing = pawn.missing.as_ref().map_or(&[][..], |missing| missing.keys());
        let (rows, _) = keys.as_chunks_mut::<3>();
        let mut count = 0;
        for (row, key) in rows.iter_mut().zip(missing) {
            row.iter_mut().zip([key.tx, key.ty, key.layer]).for_each(|(place, value)| _ = place.write(value));
            count += 3;
        }
        written.write(count);
        Ok(())
    })
}

/// Moves the walker to `feet`, 3 numbers (m); it rests there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_place(walker: *const sw_walker, feet: *const f64) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and arrays.
        let (mut pawn, feet) = unsafe { (locked(walker)?, numbers::<3>(feet, "feet")?) };
        pawn.walker.place(feet.into());
        Ok(())
    })
}

/// Writes the place of the feet: 3 numbers (m).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_feet(walker: *const sw_walker, feet: *mut f64) -> sw_status {
    guard(|| {
        // SAFETY: as the header demands of handles and arrays.
        let (pawn, feet) = unsafe { (locked(walker)?, output(feet, 3, "feet")?) };
        feet.iter_mut().zip(pawn.walker.feet().iter()).for_each(|(place, &value)| _ = place.write(value));
        Ok(())
    })
}

/// Removes a walker. NULL is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sw_walker_close(walker: *mut sw_walker) -> sw_status {
    // SAFETY: as the header demands of handles.
    unsafe { close(walker) }
}
