//! Pawns that walk: gravity, floors, stairs, walls, ledges.
//!
//! Input: a [`Snapshot`] and a move input ([`MoveInput`]). Output: the place of the pawn, and the reason if it stopped. A
//! [`Walker`] takes a few hundred bytes; a step allocates nothing, takes no lock and does no I/O.
//!
//! Time passes in ticks of fixed length ([`Config::tick_s`]). Leftover time carries over to the next frame, so the path
//! does not depend on the frame rate. Nor does it depend on what is in memory: if a tick needs a page that is not
//! loaded, it is postponed, and the pawn waits in place and reports the missing pages. "Not loaded" never counts as
//! free. A step runs at most [`MOST_TICKS`] ticks and returns the time that is left.
//!
//! [`Response::Slide`], the default, sweeps the body exactly instead of stepping and halving: up, forward and down over
//! what is no higher than the climb height, along walls and out of corners. [`Response::Thesis`] is the response of the
//! thesis (section 3.2.2), for comparison.

mod body;
mod change;
mod config;
mod crowd;
mod grade;
mod progress;
mod slide;
mod thesis;
mod waypoints;

pub use body::Body;
pub use config::{Config, Response};
pub use crowd::{Crowd, CrowdReport};
pub use grade::Grade;
pub use waypoints::Waypoints;

use crate::frame::Frame;
use crate::query::Answer;
use crate::store::Missing;
use crate::store::{MotionHint, Snapshot};
use crate::{Error, Parameter, Result};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use progress::Progress;
use std::ops::ControlFlow;

/// State of a pawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// On its feet: walking, or standing without wanting to move.
    Walking,
    /// In the air.
    Falling,
    /// On its feet and without progress although it wants to move: it stands still, or has walked for a second without
    /// getting anywhere.
    Blocked,
    /// At the last waypoint.
    Arrived,
}

impl State {
    /// Returns the name that `slicetool walk` writes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Walking => "walking",
            Self::Falling => "falling",
            Self::Blocked => "blocked",
            Self::Arrived => "arrived",
        }
    }
}

/// Ground under a pawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ground {
    /// Floor at most [`FLOOR_NEAR_M`] below its feet, or beside them.
    Floor,
    /// Something solid without floor near its feet: too steep to climb.
    Obstacle,
    /// Nothing.
    Air,
}

/// Reason why a pawn did not get where it wanted: the last one of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// Something solid, higher than the pawn climbs.
    Wall,
    /// Something low enough to climb, but without floor on or beside it: steeper than the slope limit.
    Steep,
    /// A step without headroom above it.
    Headroom,
    /// Something solid on two sides.
    Corner,
    /// The pawn was inside something solid; it has been pushed out, or could not be.
    Inside,
    /// A drop deeper than [`Config::max_drop`].
    Ledge,
    /// A drop with nothing scanned below (only with [`Config::max_drop`]).
    Void,
}

impl Stop {
    /// Returns the name that `slicetool walk --json` writes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wall => "wall",
            Self::Steep => "steep",
            Self::Headroom => "headroom",
            Self::Corner => "corner",
            Self::Inside => "inside",
            Self::Ledge => "ledge",
            Self::Void => "void",
        }
    }
}

/// Move input of a pawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MoveInput {
    /// Stay in place.
    Stay,
    /// Move in this direction; a length below 1 means slower than full speed.
    Direction(Vector2<f64>),
    /// Move to this place (m).
    Toward(Point2<f64>),
}

/// Outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// State after the step.
    pub state: State,
    /// Reason why the pawn did not get where it wanted, if it did not.
    pub stop: Option<Stop>,
    /// Pages that the pawn waits for; `None` if it does not wait.
    pub missing: Option<Missing>,
    /// Unused time (s), because the pawn waits for pages or because a step runs at most [`MOST_TICKS`] ticks. Pass it
    /// to the next step (after loading the pages), or drop it: then the pawn stood still for that time.
    pub unspent: f64,
    /// Number of ticks that passed.
    pub ticks: u32,
    /// Displacement of the feet (m).
    pub moved: Vector3<f64>,
}

impl StepReport {
    /// Returns whether the pawn waits for pages.
    pub fn waits(&self) -> bool {
        self.missing.is_some()
    }

    /// Returns the number of pages that the pawn waits for.
    pub fn missing_count(&self) -> usize {
        self.missing.map_or(0, |missing| missing.count())
    }
}

/// Depth below the feet down to which floor counts as being at the feet (m): a pawn that stands on a pebble is still on
/// the floor.
pub const FLOOR_NEAR_M: f64 = 0.05;

/// Distance from the footprint within which floor beside it counts (m), rounded down to whole pixels, at least one: the
/// edge of a step is an obstacle, and its tread lies behind.
pub const BESIDE_M: f64 = 0.25;

/// Returns [`BESIDE_M`] in pixels of size `pixel` (m).
pub(crate) fn pixels_beside(pixel: f64) -> i32 {
    ((BESIDE_M / pixel + 1e-6) as i32).max(1)
}

/// A step that missing pages may interrupt: the time that is left for it, and what of it has passed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PendingStep {
    /// Time that is left (s).
    left_s: f64,
    /// Place of the feet where it began; `None` before that.
    from: Option<Point3<f64>>,
    /// Ticks that have passed, the length of the moves that were wanted in them (m), and what stopped the last of these.
    ticks: u32,
    wanted: f64,
    stop: Option<Stop>,
}

impl PendingStep {
    /// Creates a step of `dt` (s). A `dt` that is negative or not finite counts as 0.
    pub(crate) fn of(dt: f64) -> Self {
        let left_s = if dt.is_finite() { dt.max(0.0) } else { 0.0 };
        Self { left_s, from: None, ticks: 0, wanted: 0.0, stop: None }
    }
}

/// Most ticks of one step. Bounds its work however long the frame was: a machine may have slept for hours.
pub const MOST_TICKS: u32 = 256;

/// Greatest coordinate of a pawn along each axis (m); a [`Stream`](crate::store::Stream) takes hints up to the same
/// limit.
const FARTHEST_M: f64 = 1e9;

/// Returns whether `feet` is a valid place for a pawn.
fn is_place(feet: &Point3<f64>) -> bool {
    feet.iter().all(|v| v.abs() <= FARTHEST_M)
}

/// Returns the bottom of the lowest slice that the set can hold (m); `None` if it has no pages.
fn bottom(set: &Snapshot) -> Option<f64> {
    let slice = |layer: i32| i64::from(layer) * crate::frame::PAGE_SLICES;
    set.bounds().map(|bounds| set.frame().bottom_of_slice(slice(bounds.min[2])))
}

/// A pawn that moves less than this share of the wanted distance in a step is blocked.
const BLOCKED_BELOW: f64 = 0.01;

/// A pawn that moves less than this share of the wanted distance in a tick has stalled.
const STALLED_BELOW: f64 = 1e-6;

/// A value, or the pages that are needed to compute it.
type Needs<T> = ControlFlow<Missing, T>;

fn known<T>(answer: Answer<T>) -> Needs<T> {
    match answer {
        Answer::Known(value) => ControlFlow::Continue(value),
        Answer::NotLoaded(missing) => ControlFlow::Break(missing),
    }
}

/// Mutable state of a pawn.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    feet: Point3<f64>,
    ground: Ground,
    /// Height of the floor that it last stood on (m). Climbing is measured from there, so that no ledge is climbed in
    /// several small steps.
    floor_z: f64,
    /// Speed of its fall (m/s); negative while it rises in a jump.
    falling: f64,
    /// For the response of the thesis: step length as a share of the full one.
    step: f64,
    /// For [`Response::Slide`]: the rest of a detour around an edge (m), and the direction into the wall that it
    /// serves.
    detour: Vector2<f64>,
    detour_for: Vector2<f64>,
    /// Side on which it goes around edges (1 left, -1 right, 0 either), number of changes of that side, and distance
    /// walked without contact since (m).
    hand: f64,
    changes: u32,
    free: f64,
    /// Place where the current series of detours began, the move wanted then (m), and the number of detours since.
    detours_from: Point2<f64>,
    detours_for: Vector2<f64>,
    detours: u32,
}

impl Motion {
    fn at(feet: Point3<f64>) -> Self {
        let none = Vector2::zeros();
        Self {
            feet,
            ground: Ground::Obstacle,
            floor_z: feet.z,
            falling: 0.0,
            step: 1.0,
            detour: none,
            detour_for: none,
            hand: 0.0,
            changes: 0,
            free: 0.0,
            detours_from: feet.xy(),
            detours_for: none,
            detours: 0,
        }
    }
}

/// A pawn that walks.
///
/// ```
/// use nalgebra::{Point3, Vector2};
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::store::Snapshot;
/// use slicewalk::walk::{Config, State, Walker, MoveInput};
///
/// let frame = Frame::new(0.05, 0.15)?;
/// let mut builder = PageBuilder::default();
/// for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
///     assert!(builder.set_column(px, py, &[Span::new(0, 10, false).unwrap()])); // a floor of 3.2 × 3.2 m
/// }
/// let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let mut pawn = Walker::new(Config::default(), Point3::new(0.5, 0.5, 0.1))?;
/// for _ in 0..60 {
///     pawn.step(&store, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
/// }
/// assert_eq!(pawn.state(), State::Walking);
/// assert!((pawn.feet().x - 1.9).abs() < 1e-9 && (pawn.feet().z - 10.0 * frame.quantum_m()).abs() < 1e-9);
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Walker {
    config: Config,
    motion: Motion,
    state: State,
    progress: Progress,
    /// Leftover time, less than a tick (s).
    rest_s: f64,
    /// True if it wanted to move in the last tick and stood still.
    stalled: bool,
}

impl Walker {
    /// Creates a pawn with its feet at `feet` (m, within ±10⁹). It falls to the floor below, or stands on it, and never
    /// leaves that range.
    pub fn new(config: Config, feet: Point3<f64>) -> Result<Self> {
        config.check()?;
        if !is_place(&feet) {
            return Err(Error::parameter(Parameter::Pawn("start"), format!("{feet} (expected numbers within ±1e9 m)")));
        }
        let progress = Progress::at(feet.xy());
        Ok(Self { config, motion: Motion::at(feet), state: State::Walking, progress, rest_s: 0.0, stalled: false })
    }

    /// Returns the shape and abilities of the pawn.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the middle of its bottom face (m).
    pub fn feet(&self) -> Point3<f64> {
        self.motion.feet
    }

    /// Returns the state of the pawn.
    pub fn state(&self) -> State {
        self.state
    }

    /// Returns what the pawn stands on.
    pub fn ground(&self) -> Ground {
        self.motion.ground
    }

    /// Returns the speed of its fall (m/s); negative while it rises in a jump.
    pub fn falling(&self) -> f64 {
        self.motion.falling
    }

    /// Returns whether the pawn falls below everything that `set` can hold: nothing will stop it.
    pub fn is_lost(&self, set: &Snapshot) -> bool {
        self.state == State::Falling
            && self.motion.falling >= 0.0
            && bottom(set).is_none_or(|bottom| self.motion.feet.z < bottom)
    }

    /// Returns the motion hint with which a [`Stream`](crate::store::Stream) loads every page before a step needs it;
    /// pass it on once a frame. `frame` is the grid of the pages.
    ///
    /// The pawn may turn at any moment and walk off any ledge, so the box of the hint covers everything that a step
    /// queries around it. With [`Config::max_drop`], a step at an edge also looks for ground below it, however deep; such
    /// pages are loaded once the [missing](StepReport::missing) ones are passed to
    /// [`PawnHandle::need`](crate::store::PawnHandle::need).
    pub fn motion_hint(&self, frame: &Frame) -> MotionHint {
        let config = &self.config;
        // A detour around pixel edges, or floor beside the footprint; a step up, and a step down.
        let aside = config.body.half().add_scalar(BESIDE_M.max(frame.pixel_m()) + slide::EDGE_PIXELS * frame.pixel_m());
        let step = config.climb + FLOOR_NEAR_M + frame.slice_m();
        let up = config.body.height() + step;
        MotionHint {
            min: self.motion.feet - aside.push(step),
            max: self.motion.feet + aside.push(up),
            velocity: Vector3::new(0.0, 0.0, -self.motion.falling),
            gravity: config.gravity,
            terminal_speed: config.terminal,
            agility: config.speed,
        }
    }

    /// Moves the pawn to `feet` (m), at rest. Does nothing if that is not a valid place (NaN, or beyond ±10⁹ m).
    pub fn place(&mut self, feet: Point3<f64>) {
        if is_place(&feet) {
            self.motion = Motion::at(feet);
            self.progress = Progress::at(feet.xy());
            (self.state, self.rest_s, self.stalled) = (State::Walking, 0.0, false);
        }
    }

    /// Advances the pawn by `dt` (s, >= 0) with the move input `wish`. A `dt` that is negative or not finite counts as
    /// 0.
    ///
    /// At most [`MOST_TICKS`] ticks pass; the rest of the time is returned as [`unspent`](StepReport::unspent). An
    /// interactive program drops it; a simulation passes it to the next step. Cost: a few sweeps per tick, about a
    /// microsecond on a floor at 5 cm.
    pub fn step(&mut self, set: &Snapshot, dt: f64, wish: MoveInput) -> StepReport {
        self.run(set, &mut PendingStep::of(dt), |_, _| Some(wish))
    }

    /// Like [`step`](Self::step), but the pawn follows `waypoints`; it has [`Arrived`](State::Arrived) when it is on
    /// its feet at the last one.
    pub fn follow(&mut self, set: &Snapshot, dt: f64, waypoints: &mut Waypoints) -> StepReport {
        self.follow_on(set, &mut PendingStep::of(dt), waypoints)
    }

    /// Like [`follow`](Self::follow), for a step that missing pages may have interrupted. It continues with the tick that
    /// needed them, and its last report is that of the whole step, as if all pages had been in memory.
    pub(crate) fn follow_on(
        &mut self,
        set: &Snapshot,
        step: &mut PendingStep,
        waypoints: &mut Waypoints,
    ) -> StepReport {
        let mut before = waypoints.next;
        let report = self.run(set, step, |feet, stalled| {
            before = waypoints.next;
            waypoints.wish(feet, stalled)
        });
        // A postponed tick asks again, and a pawn that stalled has reached one waypoint by that, not two.
        if report.waits() {
            waypoints.next = before;
        }
        report
    }

    /// Runs ticks, each with its own move input; `None` at the end of the waypoints.
    fn run(
        &mut self,
        set: &Snapshot,
        step: &mut PendingStep,
        mut wish: impl FnMut(Point3<f64>, bool) -> Option<MoveInput>,
    ) -> StepReport {
        let (from, tick) = (*step.from.get_or_insert(self.motion.feet), self.config.tick_s);
        let mut report = StepReport {
            state: self.state,
            stop: None,
            missing: None,
            unspent: 0.0,
            ticks: 0,
            moved: Vector3::zeros(),
        };
        let mut time = self.rest_s + step.left_s;
        // As many ticks as fit, but for rounding errors.
        while time >= tick * (1.0 - 1e-9) {
            if step.ticks == MOST_TICKS {
                (report.unspent, time) = (time, 0.0);
                break;
            }
            let (wish, before) = (wish(self.motion.feet, self.stalled), self.motion.feet.xy());
            let way = wish.map_or(Vector2::zeros(), |wish| self.way(wish));
            match self.tick(set, way) {
                ControlFlow::Continue(stop) => step.stop = stop.or(step.stop),
                ControlFlow::Break(missing) => {
                    report.missing = Some(missing);
                    (report.unspent, time) = (time, 0.0);
                    break;
                }
            }
            self.note_progress(way, before);
            time = (time - tick).max(0.0);
            step.ticks += 1;
            step.wanted += way.norm();
            self.state = match self.motion.ground {
                Ground::Air => State::Falling,
                _ if wish.is_none() => State::Arrived,
                _ => State::Walking,
            };
        }
        (self.rest_s, step.left_s) = (time, report.unspent);
        (report.ticks, report.stop) = (step.ticks, step.stop);
        report.moved = self.motion.feet - from;
        let stands = report.moved.xy().norm() < BLOCKED_BELOW * step.wanted;
        if self.state == State::Walking && (stands || self.progress.is_stuck()) {
            self.state = State::Blocked;
        }
        report.state = self.state;
        report
    }

    /// Returns the wanted move of one tick (m).
    fn way(&self, wish: MoveInput) -> Vector2<f64> {
        let far = self.config.speed * self.config.tick_s;
        // Longer vectors are shortened: their squares might not be finite.
        let bounded = |way: Vector2<f64>| way * (FARTHEST_M / way.amax().max(FARTHEST_M));
        match wish {
            MoveInput::Direction(way) if way.iter().all(|v| v.is_finite()) => {
                let way = bounded(way);
                way * (far / way.norm().max(1.0))
            }
            MoveInput::Toward(place) if place.iter().all(|v| v.is_finite()) => {
                let way = bounded(place - self.motion.feet.xy());
                way * (far / way.norm().max(far)).min(1.0)
            }
            _ => Vector2::zeros(),
        }
    }

    /// Updates the progress after a tick in which the pawn wanted `way` and began at `before`.
    fn note_progress(&mut self, way: Vector2<f64>, before: Point2<f64>) {
        let wanted = if self.motion.ground == Ground::Air { Vector2::zeros() } else { way };
        let gone = (self.motion.feet.xy() - before).norm();
        self.stalled = wanted != Vector2::zeros() && gone < STALLED_BELOW * wanted.norm();
        self.progress.note(self.config.tick_s, wanted, before, self.motion.feet.xy());
    }

    /// Runs one tick; changes nothing if it needs pages that are not in memory.
    fn tick(&mut self, set: &Snapshot, way: Vector2<f64>) -> Needs<Option<Stop>> {
        let (mut motion, mut stop) = self.respond(set, way)?;
        if let Some(max_drop) = self.config.max_drop
            && self.config.response == Response::Slide
            && way != Vector2::zeros()
            && let Some(drop) = self.drop_at(set, &motion, max_drop)?
        {
            // Repeat the tick without the move: a standing pawn stays, a falling one falls straight down.
            motion = self.respond(set, Vector2::zeros())?.0;
            stop = Some(drop);
        }
        self.motion = motion;
        ControlFlow::Continue(stop)
    }

    fn respond(&self, set: &Snapshot, way: Vector2<f64>) -> Needs<(Motion, Option<Stop>)> {
        let mut motion = self.motion;
        let stop = match self.config.response {
            Response::Slide => slide::tick(&self.config, set, &mut motion, way)?,
            Response::Thesis | Response::ThesisMean => thesis::tick(&self.config, set, &mut motion, way)?,
        };
        // A pawn at the limit of valid places stays there.
        if !is_place(&motion.feet) {
            motion = self.motion;
        }
        ControlFlow::Continue((motion, stop))
    }

    /// Returns why the pawn must not get to `after`, if the ground there lies more than `max_drop` below the ground it
    /// stands on, or stood on before it fell.
    fn drop_at(&self, set: &Snapshot, after: &Motion, max_drop: f64) -> Needs<Option<Stop>> {
        let before = &self.motion;
        let from = if before.ground == Ground::Air { before.floor_z } else { before.feet.z };
        // Floors are rounded to quanta.
        let lowest = from - max_drop - set.frame().quantum_m() - slide::LEVEL_M;
        if after.ground != Ground::Air {
            return ControlFlow::Continue((after.feet.z < lowest).then_some(Stop::Ledge));
        }
        let body = &self.config.body;
        let down = Vector3::new(0.0, 0.0, (lowest - after.feet.z).min(0.0));
        if known(body.sweep(set, after.feet, down))?.is_some() {
            return ControlFlow::Continue(None);
        }
        let depth = (after.feet.z - bottom(set).unwrap_or(0.0)).max(0.0) + set.frame().slice_m();
        let below = known(body.top(set, after.feet, after.feet.z, depth))?;
        ControlFlow::Continue(Some(if below.is_some() { Stop::Ledge } else { Stop::Void }))
    }
}
