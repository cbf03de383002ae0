//! A player's pawn: a [`Walker`] that also runs, jumps, crouches and flies, in whole ticks, and keeps a recording.
//!
//! A step passes as many ticks as fit into its time. A recording holds the ticks that passed and their inputs, so a
//! replay gives the same path bit for bit, whatever was in memory during the recording.

use crate::fault::{self, invalid};
use crate::messages::{GroundCode, InputMessage, SettingsMessage, StateMessage, StopCode};
use crate::routes::Routing;
use slicewalk::frame::Frame;
use slicewalk::nalgebra::{Point2, Point3, Vector2, Vector3};
use slicewalk::query::Answer;
use slicewalk::store::{Missing, MotionHint, Snapshot};
use slicewalk::walk::{Body, Config, Ground, MoveInput, State, Stop, Walker, Waypoints};

/// Length of a tick (s).
pub const TICK_S: f64 = 1.0 / 240.0;
/// Longest time of one step (s); the rest is dropped.
pub(crate) const LONGEST_S: f64 = 0.25;
/// Numbers of one recorded step: ticks, wish or place x and y, pace, lift, flags, place z, and one reserved.
const ROW: usize = 8;
const JUMP: u32 = 1;
const CROUCH: u32 = 2;
const FLY: u32 = 4;
const TOWARD: u32 = 8;
const PLACE: u32 = 16;
const FOLLOW: u32 = 32;

/// Settings that can change while a pawn walks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Shape while standing.
    pub body: Body,
    /// Highest step (m).
    pub climb: f64,
    /// Walking speed (m/s).
    pub speed: f64,
    /// Acceleration downwards (m/s²).
    pub gravity: f64,
    /// Height of a jump (m).
    pub jump: f64,
    /// Height while crouching (m).
    pub crouch: f64,
    /// Deepest drop that the pawn walks over.
    pub max_drop: Option<f64>,
}

impl Settings {
    /// Reads the numbers of a `SettingsMessage`.
    pub fn from_numbers(numbers: &[f64]) -> Result<Self, String> {
        let message = SettingsMessage::from_numbers(numbers).ok_or_else(|| invalid("settings are ten numbers"))?;
        let SettingsMessage { shape, x, y, height, climb, speed, gravity, jump, crouch, max_drop } = message;
        let body = if shape == 0.0 { Body::Box { x, y, height } } else { Body::Cylinder { radius: x, height } };
        let max_drop = (!max_drop.is_nan()).then_some(max_drop);
        let settings = Self { body, climb, speed, gravity, jump, crouch, max_drop };
        if !(0.0..=1000.0).contains(&jump) {
            return Err(invalid(format_args!("height of a jump: {jump} m lies outside 0 to 1000 m")));
        }
        if !(crouch > 0.0 && crouch <= height) {
            return Err(invalid(format_args!("crouching height: {crouch} m lies outside 0 to {height} m, the body's")));
        }
        Walker::new(settings.config(1.0, false), Point3::origin())
            .and_then(|_| Walker::new(settings.config(1.0, true), Point3::origin()))
            .map_err(|error| fault::text(&error))?;
        Ok(settings)
    }

    /// Returns the configuration of an upright pawn.
    pub fn upright(&self) -> Config {
        self.config(1.0, false)
    }

    /// Returns the configuration of an upright pawn that walks over no drop from which it could not return.
    pub fn careful(&self) -> Config {
        let config = self.upright();
        Config { max_drop: config.max_drop.or(Some(config.climb)), ..config }
    }

    fn config(&self, pace: f64, crouched: bool) -> Config {
        Config {
            speed: self.speed * pace,
            climb: self.climb,
            gravity: self.gravity,
            tick_s: TICK_S,
            max_drop: self.max_drop,
            ..Config::new(self.body(crouched))
        }
    }

    fn body(&self, crouched: bool) -> Body {
        let low = |height: f64| if crouched { self.crouch } else { height };
        match self.body {
            Body::Box { x, y, height } => Body::Box { x, y, height: low(height) },
            Body::Cylinder { radius, height } => Body::Cylinder { radius, height: low(height) },
        }
    }
}

/// Input of a pawn for the time of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Input {
    /// Direction, or the place to walk to if [`toward`](Self::toward).
    pub wish: Vector2<f64>,
    /// Multiplies the walking speed.
    pub pace: f64,
    /// Up or down while flying, -1 to 1.
    pub lift: f64,
    /// Walks to the place `wish`.
    pub toward: bool,
    /// Walks along the pawn's route.
    pub follow: bool,
    /// Jumps if the pawn stands.
    pub jump: bool,
    /// Crouches.
    pub crouch: bool,
    /// Flies, also through solid.
    pub fly: bool,
}

impl Input {
    /// Reads the numbers of an `InputMessage`.
    pub fn from_numbers(numbers: &[f64]) -> Result<Self, String> {
        let message = InputMessage::from_numbers(numbers).ok_or_else(|| invalid("an input is five numbers"))?;
        let InputMessage { x, y, pace, lift, flags } = message;
        let finite = x.is_finite() && y.is_finite() && lift.is_finite();
        if !finite || !(0.0..=100.0).contains(&pace) {
            return Err(invalid(format_args!("no pawn can go ({x}, {y}) at pace {pace}, lift {lift}")));
        }
        let has = |flag: u32| flags as u32 & flag != 0;
        let (jump, crouch, fly, toward, follow) = (has(JUMP), has(CROUCH), has(FLY), has(TOWARD), has(FOLLOW));
        Ok(Self { wish: Vector2::new(x, y), pace, lift: lift.clamp(-1.0, 1.0), toward, follow, jump, crouch, fly })
    }

    fn flags(&self) -> u32 {
        let flag = |is: bool, flag: u32| if is { flag } else { 0 };
        flag(self.jump, JUMP) | flag(self.crouch, CROUCH) | flag(self.fly, FLY) | flag(self.toward, TOWARD)
    }

    fn row(&self, ticks: u32) -> [f64; ROW] {
        [f64::from(ticks), self.wish.x, self.wish.y, self.pace, self.lift, f64::from(self.flags()), 0.0, 0.0]
    }
}

/// A pawn of a player.
#[derive(Debug)]
pub struct Pawn {
    walker: Walker,
    settings: Settings,
    crouched: bool,
    flying: bool,
    /// A jump was requested, and no tick has passed since.
    jumps: bool,
    /// Ticks since the pawn was placed here, and whether any had passed when the last step began.
    ticks_here: u64,
    goes_on: bool,
    /// Fraction of a tick left over from the time so far (s).
    rest_s: f64,
    ticks: u64,
    steps: u64,
    stop: Option<Stop>,
    missing: Option<Missing>,
    /// The route that it follows.
    route: Option<Waypoints>,
    /// Horizontal and upward speed over the last step (m/s).
    speed: [f64; 2],
    recording: Option<Recording>,
}

#[derive(Debug, Default)]
struct Recording {
    steps: Vec<f64>,
    path: Vec<f64>,
}

impl Pawn {
    /// Places a pawn with its feet at `at` (m, finite).
    pub fn new(settings: Settings, at: Point3<f64>) -> Result<Self, String> {
        let walker = Walker::new(settings.config(1.0, false), at).map_err(|error| fault::text(&error))?;
        Ok(Self {
            walker,
            settings,
            crouched: false,
            flying: false,
            jumps: false,
            ticks_here: 0,
            goes_on: false,
            rest_s: 0.0,
            ticks: 0,
            steps: 0,
            stop: None,
            missing: None,
            route: None,
            speed: [0.0; 2],
            recording: None,
        })
    }

    /// Motion hint. At a new place it covers only what the pawn stands on, until the step after its first tick: nothing
    /// delays this tick, and the caller that requested it has seen it.
    pub fn motion_hint(&self, frame: &Frame) -> MotionHint {
        let motion_hint = self.walker.motion_hint(frame);
        if !self.goes_on {
            return MotionHint {
                velocity: Vector3::zeros(),
                gravity: 0.0,
                terminal_speed: 0.0,
                agility: 0.0,
                ..motion_hint
            };
        }
        motion_hint
    }

    /// Pages that the last step waited for.
    pub fn missing(&self) -> Option<&Missing> {
        self.missing.as_ref()
    }

    /// Changes the settings; refuses a body that does not fit.
    pub fn set(&mut self, set: &Snapshot, settings: Settings) -> Result<(), String> {
        if self.recording.is_some() {
            return Err(invalid("settings cannot change during a recording"));
        }
        let body = settings.body(self.crouched);
        if body != *self.body() && !self.flying && self.walker.has_room(set, &body) == Answer::Known(false) {
            return Err(invalid("there is no room here for a pawn of this size"));
        }
        self.walker.set_config(settings.config(1.0, self.crouched)).map_err(|error| fault::text(&error))?;
        self.settings = settings;
        Ok(())
    }

    fn body(&self) -> &Body {
        &self.walker.config().body
    }

    /// Moves the pawn elsewhere (m, within ±10⁹), at rest.
    pub fn place(&mut self, at: Point3<f64>) -> Result<(), String> {
        self.walker.place(at);
        // The walker ignores other places.
        if self.walker.feet() != at {
            return Err(invalid(format_args!("a place: expected three numbers within ±1e9 m, found {at}")));
        }
        (self.rest_s, self.jumps, self.stop, self.missing, self.speed) = (0.0, false, None, None, [0.0; 2]);
        (self.ticks_here, self.goes_on, self.route) = (0, false, None);
        self.keep([0.0, at.x, at.y, 1.0, 0.0, f64::from(PLACE), at.z, 0.0]);
        Ok(())
    }

    /// Advances by at most 0.25 s.
    pub fn step(&mut self, set: &Snapshot, seconds: f64, input: &Input) {
        self.steps += 1;
        self.goes_on = self.ticks_here > 0;
        self.jumps |= input.jump;
        self.rest_s += if seconds > 0.0 { seconds.min(LONGEST_S) } else { 0.0 };
        let ticks = (self.rest_s / TICK_S * (1.0 + 1e-9)) as u32;
        if ticks == 0 {
            return;
        }
        self.rest_s = (self.rest_s - f64::from(ticks) * TICK_S).max(0.0);
        let mut input = Input { jump: std::mem::take(&mut self.jumps), ..*input };
        input.crouch = input.crouch || self.crouched && !self.may_stand_up(set);
        let before = self.walker.feet();
        let route = if input.follow && !input.fly { self.route.take() } else { None };
        match route {
            Some(route) => self.follow(set, ticks, &input, route),
            None => {
                let passed = self.advance(set, ticks, &input);
                self.keep(input.row(passed));
            }
        }
        let moved = (self.walker.feet() - before) / (f64::from(ticks) * TICK_S);
        self.speed = [moved.xy().norm(), moved.z];
    }

    /// Begins the route of a pawn as it stands; see [`set_route`](Self::set_route).
    pub fn routing(&self, name: u32, to: Point3<f64>) -> Result<Routing, String> {
        Routing::new(name, self.walker.feet(), self.settings, to)
    }

    /// Sets the places that the pawn walks to in order while its input says so.
    pub fn set_route(&mut self, points: &[Point3<f64>]) {
        self.route = Waypoints::new(points.iter().map(|point| point.xy()).collect()).ok();
    }

    /// Walks along `route`. The recording has a row for each place on the way.
    fn follow(&mut self, set: &Snapshot, ticks: u32, input: &Input, mut route: Waypoints) {
        let mut row: Option<Input> = None;
        let mut passed = 0;
        for tick in 0..ticks {
            let jump = input.jump && tick == 0;
            let next = route.next_place(&self.walker);
            let toward =
                Input { wish: next.map_or(Vector2::zeros(), |next| next.coords), jump, follow: false, ..*input };
            let toward = Input { toward: next.is_some(), ..toward };
            if row.is_some_and(|row| row != Input { jump: row.jump, ..toward }) {
                row.take().into_iter().for_each(|row| self.keep(row.row(passed)));
                passed = 0;
            }
            row.get_or_insert(toward);
            if self.advance(set, 1, &toward) == 0 {
                break;
            }
            passed += 1;
        }
        row.into_iter().for_each(|row| self.keep(row.row(passed)));
        self.route = Some(route);
    }

    fn may_stand_up(&self, set: &Snapshot) -> bool {
        self.flying || self.walker.has_room(set, &self.settings.body(false)) == Answer::Known(true)
    }

    /// Advances by up to `ticks` ticks and returns how many passed: all, unless pages are missing.
    fn advance(&mut self, set: &Snapshot, ticks: u32, input: &Input) -> u32 {
        (self.crouched, self.flying) = (input.crouch, input.fly);
        // The settings are checked already; pace only makes it faster.
        let config = self.settings.config(input.pace, self.crouched);
        let applied = self.walker.set_config(config);
        debug_assert!(applied.is_ok());
        (self.stop, self.missing) = (None, None);
        let passed = if input.fly { self.fly(ticks, input) } else { self.walk(set, ticks, input) };
        self.ticks += u64::from(passed);
        self.ticks_here += u64::from(passed);
        passed
    }

    fn fly(&mut self, ticks: u32, input: &Input) -> u32 {
        let across = match input.toward {
            true => input.wish - self.walker.feet().xy().coords,
            false => input.wish,
        };
        let way: Vector3<f64> = (across / across.norm().max(1.0)).push(input.lift);
        let far = self.settings.speed * input.pace * TICK_S * f64::from(ticks);
        self.walker.place(self.walker.feet() + way * far);
        ticks
    }

    fn walk(&mut self, set: &Snapshot, ticks: u32, input: &Input) -> u32 {
        if input.jump {
            self.walker.jump((2.0 * self.settings.gravity * self.settings.jump).sqrt());
        }
        let wish = match input.toward {
            true => MoveInput::Toward(Point2::from(input.wish)),
            false => MoveInput::Direction(input.wish),
        };
        let report = self.walker.step(set, f64::from(ticks) * TICK_S, wish);
        (self.stop, self.missing) = (report.stop, report.missing);
        report.ticks
    }

    /// Begins a recording here and at rest.
    pub fn record(&mut self) {
        self.walker.place(self.walker.feet());
        (self.crouched, self.flying, self.rest_s, self.jumps) = (false, false, 0.0, false);
        self.recording = Some(Recording::default());
    }

    fn keep(&mut self, row: [f64; ROW]) {
        if let Some(recording) = &mut self.recording {
            recording.steps.extend(row);
            recording.path.extend(self.walker.feet().iter());
        }
    }

    /// The steps recorded so far, and the feet after each.
    pub fn recording(&self) -> (&[f64], &[f64]) {
        self.recording.as_ref().map_or((&[], &[]), |recording| (&recording.steps, &recording.path))
    }

    /// Repeats `steps` from where the pawn stands; returns the feet after each.
    pub fn replay(&mut self, set: &Snapshot, steps: &[f64]) -> Result<Vec<f64>, String> {
        let mut path = Vec::new();
        let (rows, rest) = steps.as_chunks::<ROW>();
        if !rest.is_empty() {
            return Err(invalid("a recording has eight numbers a step"));
        }
        for &[ticks, x, y, pace, lift, flags, z, _] in rows {
            if flags as u32 & PLACE != 0 {
                self.place(Point3::new(x, y, z))?;
            } else {
                let input = Input::from_numbers(&[x, y, pace, lift, flags])?;
                let passed = self.advance(set, ticks as u32, &input);
                if f64::from(passed) != ticks {
                    return Err(invalid(format_args!("{passed} of {ticks} ticks passed: pages are missing")));
                }
            }
            path.extend(self.walker.feet().iter());
        }
        Ok(path)
    }

    /// State for the package.
    pub fn state(&self) -> StateMessage {
        let feet = self.walker.feet();
        let ground = match self.walker.state() {
            _ if self.flying => GroundCode::Flying,
            _ if self.walker.ground() == Ground::Air => GroundCode::Falling,
            State::Blocked => GroundCode::Blocked,
            State::Falling | State::Walking | State::Arrived => GroundCode::Walking,
        };
        let stop = match self.stop {
            None => StopCode::None,
            Some(Stop::Wall) => StopCode::Wall,
            Some(Stop::Steep) => StopCode::Steep,
            Some(Stop::Headroom) => StopCode::Headroom,
            Some(Stop::Corner) => StopCode::Corner,
            Some(Stop::Inside) => StopCode::Inside,
            Some(Stop::Ledge) => StopCode::Ledge,
            Some(Stop::Void) => StopCode::Void,
        };
        StateMessage {
            x: feet.x,
            y: feet.y,
            z: feet.z,
            ground: ground.into(),
            stop: stop.into(),
            speed: self.speed[0],
            rise: self.speed[1],
            crouched: f64::from(u8::from(self.crouched)),
            height: self.body().height(),
            missing: self.missing.map_or(0, |missing| missing.count()) as f64,
            ticks: self.ticks as f64,
            steps: self.steps as f64,
            ahead: self.route.as_ref().map_or(0, |route| route.places().len() - route.next()) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk::store::Snapshot;

    #[test]
    fn at_a_new_place_a_pawn_needs_only_what_it_stands_on() {
        let numbers = [0.0, 0.5, 0.5, 1.8, 0.35, 1.4, 9.81, 0.5, 1.0, f64::NAN];
        let mut pawn = Pawn::new(Settings::from_numbers(&numbers).unwrap(), Point3::origin()).unwrap();
        let frame = Frame::new(0.05, 0.15).unwrap();
        let empty = Snapshot::from_pages(frame, []);
        let speeds = |pawn: &Pawn| {
            let motion_hint = pawn.motion_hint(&frame);
            assert!(motion_hint.is_valid() && motion_hint.min.x < -0.25 && motion_hint.max.z > 1.8);
            (motion_hint.agility, motion_hint.gravity)
        };
        let input = Input::from_numbers(&[0.0, 0.0, 1.0, 0.0, f64::from(FLY)]).unwrap();
        assert_eq!(speeds(&pawn), (0.0, 0.0));
        pawn.step(&empty, TICK_S / 2.0, &input);
        assert_eq!(speeds(&pawn), (0.0, 0.0));
        pawn.step(&empty, TICK_S, &input);
        assert_eq!(speeds(&pawn), (0.0, 0.0));
        pawn.step(&empty, TICK_S, &input);
        assert_eq!(speeds(&pawn), (1.4, 9.81));
        // A place that is refused leaves the pawn as it is.
        assert!(pawn.place(Point3::new(0.0, 1e10, 0.0)).is_err_and(|error| error.contains("±1e9 m")));
        assert_eq!(speeds(&pawn), (1.4, 9.81));
        pawn.place(Point3::origin()).unwrap();
        assert_eq!(speeds(&pawn), (0.0, 0.0));
    }
}
