//! Pawns that walk: gravity, floors, stairs, walls, ledges.
//!
//! In: a [`PageSet`] and where a pawn wants to go. Out: where it is, and why it stopped. A [`Walker`] is a few hundred
//! bytes; a step allocates nothing, takes no lock and does no I/O.
//!
//! Time passes in ticks of fixed length ([`Config::tick_s`]), whatever the length of a frame: what is left of a frame
//! is kept for the next one. So the way walked does not depend on the frame rate. It does not depend on what is in
//! memory either: a tick that needs a page that is not there does not happen, the pawn waits in place and says which
//! pages are missing. "Not loaded" is never free. A step is at most [`MOST_TICKS`] long, and gives back the rest.
//!
//! [`Response::Slide`] is ours: exact sweeps of the body (never steps and halving), up, forward and down over what is
//! no higher than the pawn can climb, along walls and out of corners. [`Response::Thesis`] is that of the thesis,
//! section 3.2.2, for comparison.

mod body;
mod change;
mod config;
mod crowd;
mod progress;
mod slide;
mod thesis;
mod waypoints;

pub use body::Body;
pub use config::{Config, Response};
pub use crowd::{Crowd, CrowdReport};
pub use waypoints::Waypoints;

use crate::frame::Frame;
use crate::query::Answer;
use crate::store::Missing;
use crate::store::{Outlook, PageSet};
use crate::{Error, Parameter, Result};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use progress::Progress;
use std::ops::ControlFlow;

/// What a pawn is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// On its feet: walking, or standing where it was told to.
    Walking,
    /// In the air.
    Falling,
    /// On its feet, wants to go on and makes no progress: it stands still, or has walked for a second and is still
    /// where it was.
    Blocked,
    /// At the last waypoint.
    Arrived,
}

impl State {
    /// As `slicetool walk` writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Walking => "walking",
            Self::Falling => "falling",
            Self::Blocked => "blocked",
            Self::Arrived => "arrived",
        }
    }
}

/// What a pawn stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ground {
    /// Floor no farther below its feet than [`FLOOR_NEAR_M`].
    Floor,
    /// Matter without floor near its feet: something too steep to be climbed.
    Obstacle,
    /// Nothing.
    Air,
}

/// Why a pawn did not get where it wanted. Of several reasons in one step, the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// Matter higher than it can climb.
    Wall,
    /// Matter that it could climb, but without floor on or beside it: steeper than the slope limit.
    Steep,
    /// A step, but no room for its head above it.
    Headroom,
    /// Matter on two sides.
    Corner,
    /// It was inside matter and has been pushed out, or could not be.
    Inside,
    /// A drop deeper than it takes ([`Config::max_drop`]).
    Ledge,
    /// Nothing was scanned below ([`Config::max_drop`]).
    Void,
}

impl Stop {
    /// As `slicetool walk --json` writes it.
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

/// Where a pawn wants to go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wish {
    /// Nowhere.
    Stay,
    /// This way, for as long as it may; a length below 1 means slower.
    Direction(Vector2<f64>),
    /// To this place (m).
    Toward(Point2<f64>),
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// What the pawn is doing after it.
    pub state: State,
    /// Why it did not get where it wanted, if so.
    pub stop: Option<Stop>,
    /// Pages without which it could not go on: it waits. `None` if it did not have to.
    pub missing: Option<Missing>,
    /// Time that it did not use (s), because it waits for pages or because a step is at most [`MOST_TICKS`] long. Pass it
    /// to the next step (after loading the pages), or drop it: then the pawn has stood still for so long.
    pub unspent: f64,
    /// Ticks that passed.
    pub ticks: u32,
    /// From where it was to where it is (m).
    pub moved: Vector3<f64>,
}

impl StepReport {
    /// Whether it waits for pages.
    pub fn waits(&self) -> bool {
        self.missing.is_some()
    }

    /// Number of pages that it waits for.
    pub fn missing_count(&self) -> usize {
        self.missing.map_or(0, |missing| missing.count())
    }
}

/// Floor counts as being at the pawn's feet down to so far below them (m): a pawn stands on the highest matter under
/// it, be that a pebble, and is still on the floor.
pub const FLOOR_NEAR_M: f64 = 0.05;

/// Floor beside the footprint counts within this distance (m), rounded down to whole pixels, but to one at least: the edge of a step
/// is an obstacle, its tread comes behind.
pub const BESIDE_M: f64 = 0.25;

/// The same in pixels of `pixel` (m).
pub(crate) fn pixels_beside(pixel: f64) -> i32 {
    ((BESIDE_M / pixel + 1e-6) as i32).max(1)
}

/// Most ticks of one step, so that its work is bounded however long the frame was: a machine may have slept for hours.
pub const MOST_TICKS: u32 = 256;

/// Farthest place of a pawn along each axis (m); a [`Stream`](crate::store::Stream) takes hints as far out.
const FARTHEST_M: f64 = 1e9;

/// Whether a pawn can be there.
fn is_place(feet: &Point3<f64>) -> bool {
    feet.iter().all(|v| v.abs() <= FARTHEST_M)
}

/// Less than this share of the way wanted is "blocked".
const BLOCKED_BELOW: f64 = 0.01;

/// Less than this share of the way wanted in one tick is none.
const STALLED_BELOW: f64 = 1e-6;

/// The answer of a tick, or the pages that it needs.
type Needs<T> = ControlFlow<Missing, T>;

fn known<T>(answer: Answer<T>) -> Needs<T> {
    match answer {
        Answer::Known(value) => ControlFlow::Continue(value),
        Answer::NotLoaded(missing) => ControlFlow::Break(missing),
    }
}

/// All that changes about a pawn.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    feet: Point3<f64>,
    ground: Ground,
    /// Height of the floor that it stood on last: climbing is measured from there, so that no ledge is climbed in parts
    /// (m).
    floor_z: f64,
    /// Speed of its fall (m/s); negative while it rises in a jump.
    falling: f64,
    /// Of the thesis' response: its step as a share of the full one.
    step: f64,
    /// Of ours: the rest of a way around an edge, and the way into the wall that it is for (m).
    detour: Vector2<f64>,
    detour_for: Vector2<f64>,
    /// On which side it goes around edges (1 left, -1 right, 0 either), how often it changed its mind about that, and how
    /// far it has walked freely since (m).
    hand: f64,
    changes: u32,
    free: f64,
    /// Where it began to go around the edges that it is at, what it wanted then (m), and how often it has gone around one
    /// since.
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

/// A pawn.
///
/// ```
/// use nalgebra::{Point3, Vector2};
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::slice::{PageBuilder, Span};
/// use slicewalk::store::Store;
/// use slicewalk::walk::{Config, State, Walker, Wish};
///
/// let frame = Frame::new(0.05, 0.15)?;
/// let mut builder = PageBuilder::default();
/// for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
///     assert!(builder.set_column(px, py, &[Span::new(0, 10, false).unwrap()])); // a floor of 3.2 × 3.2 m
/// }
/// let store = Store::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let mut pawn = Walker::new(Config::default(), Point3::new(0.5, 0.5, 0.1))?;
/// for _ in 0..60 {
///     pawn.step(&store, 1.0 / 60.0, Wish::Direction(Vector2::x()));
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
    /// Part of a tick that is left of the time given so far (s).
    rest_s: f64,
    /// Whether it wanted to go on in the last tick, and stood.
    stalled: bool,
}

impl Walker {
    /// A pawn with its feet at `feet` (m, within ±10⁹). It falls to the floor below, or stands on it; it never gets
    /// farther out than that.
    pub fn new(config: Config, feet: Point3<f64>) -> Result<Self> {
        config.check()?;
        if !is_place(&feet) {
            return Err(Error::parameter(Parameter::Pawn("start"), format!("{feet} (expected numbers within ±1e9 m)")));
        }
        let progress = Progress::at(feet.xy());
        Ok(Self { config, motion: Motion::at(feet), state: State::Walking, progress, rest_s: 0.0, stalled: false })
    }

    /// Its numbers.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Middle of its bottom face (m).
    pub fn feet(&self) -> Point3<f64> {
        self.motion.feet
    }

    /// What it is doing.
    pub fn state(&self) -> State {
        self.state
    }

    /// What it stands on.
    pub fn ground(&self) -> Ground {
        self.motion.ground
    }

    /// Speed of its fall (m/s); negative while it rises in a jump.
    pub fn falling(&self) -> f64 {
        self.motion.falling
    }

    /// What a [`Stream`](crate::store::Stream) needs to know to have every page there before a step asks for it: hint it
    /// once a frame. `frame` is the grid of the pages.
    ///
    /// The pawn may turn at any moment and walk off any ledge; its box is grown by all that a step looks at around it.
    pub fn outlook(&self, frame: &Frame) -> Outlook {
        let config = &self.config;
        // Around an edge of pixels, to floor ahead of a step; up a step, and down one.
        let aside = config.body.half().add_scalar(BESIDE_M.max(frame.pixel_m()) + slide::EDGE_PIXELS * frame.pixel_m());
        let step = config.climb + FLOOR_NEAR_M + frame.slice_m();
        let up = config.body.height() + step;
        Outlook {
            min: self.motion.feet - aside.push(step),
            max: self.motion.feet + aside.push(up),
            velocity: Vector3::new(0.0, 0.0, -self.motion.falling),
            gravity: config.gravity,
            terminal_speed: config.terminal,
            agility: config.speed,
        }
    }

    /// Puts it elsewhere (m), at rest. It stays where it is if no pawn can be there (NaN, or beyond ±10⁹ m).
    pub fn place(&mut self, feet: Point3<f64>) {
        if is_place(&feet) {
            self.motion = Motion::at(feet);
            self.progress = Progress::at(feet.xy());
            (self.state, self.rest_s, self.stalled) = (State::Walking, 0.0, false);
        }
    }

    /// Lets `dt` (s, >= 0) pass while the pawn wants to go where `wish` says. A `dt` that is negative or not finite counts as 0.
    ///
    /// At most [`MOST_TICKS`] pass; the rest comes back as [`unspent`](StepReport::unspent). A program that shows frames
    /// drops it; a simulation passes it to the next step. Cost: a few sweeps per tick, about a microsecond on a floor at
    /// 5 cm.
    pub fn step<S: PageSet>(&mut self, set: &S, dt: f64, wish: Wish) -> StepReport {
        self.run(set, dt, |_, _| Some(wish))
    }

    /// As [`step`](Self::step) while the pawn follows `waypoints`; it has [`Arrived`](State::Arrived) when it is on its
    /// feet at the end.
    pub fn follow<S: PageSet>(&mut self, set: &S, dt: f64, waypoints: &mut Waypoints) -> StepReport {
        self.run(set, dt, |feet, stalled| waypoints.wish(feet, stalled))
    }

    /// Ticks, each with the wish for it; `None` at the end of the way.
    fn run<S: PageSet>(
        &mut self,
        set: &S,
        dt: f64,
        mut wish: impl FnMut(Point3<f64>, bool) -> Option<Wish>,
    ) -> StepReport {
        let (from, tick) = (self.motion.feet, self.config.tick_s);
        let mut report = StepReport {
            state: self.state,
            stop: None,
            missing: None,
            unspent: 0.0,
            ticks: 0,
            moved: Vector3::zeros(),
        };
        let mut time = self.rest_s + if dt.is_finite() { dt.max(0.0) } else { 0.0 };
        let mut wanted = 0.0;
        // A frame is as many ticks as fit but for rounding errors.
        while time >= tick * (1.0 - 1e-9) {
            if report.ticks == MOST_TICKS {
                (report.unspent, time) = (time, 0.0);
                break;
            }
            let (wish, before) = (wish(self.motion.feet, self.stalled), self.motion.feet.xy());
            let way = wish.map_or(Vector2::zeros(), |wish| self.way(wish));
            match self.tick(set, way) {
                ControlFlow::Continue(stop) => report.stop = stop.or(report.stop),
                ControlFlow::Break(missing) => {
                    report.missing = Some(missing);
                    (report.unspent, time) = (time, 0.0);
                    break;
                }
            }
            self.note_progress(way, before);
            time = (time - tick).max(0.0);
            report.ticks += 1;
            wanted += way.norm();
            self.state = match self.motion.ground {
                Ground::Air => State::Falling,
                _ if wish.is_none() => State::Arrived,
                _ => State::Walking,
            };
        }
        self.rest_s = time;
        report.moved = self.motion.feet - from;
        let stands = report.moved.xy().norm() < BLOCKED_BELOW * wanted;
        if self.state == State::Walking && (stands || self.progress.is_stuck()) {
            self.state = State::Blocked;
        }
        report.state = self.state;
        report
    }

    /// The way of one tick (m).
    fn way(&self, wish: Wish) -> Vector2<f64> {
        let far = self.config.speed * self.config.tick_s;
        // Lengths beyond this are equal: their squares would not be finite.
        let bounded = |way: Vector2<f64>| way * (FARTHEST_M / way.amax().max(FARTHEST_M));
        match wish {
            Wish::Direction(way) if way.iter().all(|v| v.is_finite()) => {
                let way = bounded(way);
                way * (far / way.norm().max(1.0))
            }
            Wish::Toward(place) if place.iter().all(|v| v.is_finite()) => {
                let way = bounded(place - self.motion.feet.xy());
                way * (far / way.norm().max(far)).min(1.0)
            }
            _ => Vector2::zeros(),
        }
    }

    /// Judges a tick in which the pawn wanted `way` and began at `before`.
    fn note_progress(&mut self, way: Vector2<f64>, before: Point2<f64>) {
        let wanted = if self.motion.ground == Ground::Air { Vector2::zeros() } else { way };
        let gone = (self.motion.feet.xy() - before).norm();
        self.stalled = wanted != Vector2::zeros() && gone < STALLED_BELOW * wanted.norm();
        self.progress.note(self.config.tick_s, wanted, before, self.motion.feet.xy());
    }

    /// One tick; if it needs pages that are not in memory, nothing has changed.
    fn tick<S: PageSet>(&mut self, set: &S, way: Vector2<f64>) -> Needs<Option<Stop>> {
        let (mut motion, mut stop) = self.respond(set, way)?;
        if let Some(max_drop) = self.config.max_drop
            && self.config.response == Response::Slide
            && way != Vector2::zeros()
            && let Some(drop) = self.drop_at(set, &motion, max_drop)?
        {
            // As if it had not wanted to go: what stands still stays, what falls falls straight.
            motion = self.respond(set, Vector2::zeros())?.0;
            stop = Some(drop);
        }
        self.motion = motion;
        ControlFlow::Continue(stop)
    }

    fn respond<S: PageSet>(&self, set: &S, way: Vector2<f64>) -> Needs<(Motion, Option<Stop>)> {
        let mut motion = self.motion;
        let stop = match self.config.response {
            Response::Slide => slide::tick(&self.config, set, &mut motion, way)?,
            Response::Thesis | Response::ThesisMean => thesis::tick(&self.config, set, &mut motion, way)?,
        };
        // Where the world of pawns ends it stays.
        if !is_place(&motion.feet) {
            motion = self.motion;
        }
        ControlFlow::Continue((motion, stop))
    }

    /// Why the pawn must not get to `after`, if what is below lies more than `max_drop` under what it stands on, or stood on
    /// before it fell.
    fn drop_at<S: PageSet>(&self, set: &S, after: &Motion, max_drop: f64) -> Needs<Option<Stop>> {
        let before = &self.motion;
        let from = if before.ground == Ground::Air { before.floor_z } else { before.feet.z };
        // Floors are stored to a quantum.
        let lowest = from - max_drop - set.frame().quantum_m() - slide::LEVEL_M;
        if after.ground != Ground::Air {
            return ControlFlow::Continue((after.feet.z < lowest).then_some(Stop::Ledge));
        }
        let body = &self.config.body;
        let down = Vector3::new(0.0, 0.0, (lowest - after.feet.z).min(0.0));
        if known(body.sweep(set, after.feet, down))?.is_some() {
            return ControlFlow::Continue(None);
        }
        // Down to the lowest matter that the set can hold.
        let bottom = set.bounds().map_or(0.0, |bounds| {
            let slice = i64::from(bounds.min[2]) * crate::frame::PAGE_SLICES;
            set.frame().bottom_of_slice(slice)
        });
        let depth = (after.feet.z - bottom).max(0.0) + set.frame().slice_m();
        let below = known(body.top(set, after.feet, after.feet.z, depth))?;
        ControlFlow::Continue(Some(if below.is_some() { Stop::Ledge } else { Stop::Void }))
    }
}
