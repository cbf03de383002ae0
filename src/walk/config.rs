//! What a pawn is and can do.

use super::Body;
use crate::{Error, Result};

/// Longest body (m), highest speed (m/s) and strongest gravity (m/s²): they bound the work of a tick.
const MOST: f64 = 1000.0;

/// How a pawn answers matter in its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Response {
    /// Exact sweeps; slides along walls.
    #[default]
    Slide,
    /// Steps of fixed length, halved while they collide (thesis, section 3.2.2); stands on the highest floor.
    Thesis,
    /// As [`Thesis`](Self::Thesis), standing on the mean of the floor's heights.
    ThesisMean,
}

/// Numbers of a pawn. All lengths in metres, times in seconds; what lies outside the limits is refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Its shape: lengths above 0, at most 1,000 m.
    pub body: Body,
    /// Walking speed (m/s, 0 to 1,000).
    pub speed: f64,
    /// Highest step it climbs or walks down without falling (m, >= 0, less than its height).
    pub climb: f64,
    /// Acceleration downwards (m/s², 0 to 1,000).
    pub gravity: f64,
    /// Greatest speed of a fall (m/s, above 0, at most 1,000).
    pub terminal: f64,
    /// Length of a tick (s, 0.00001 to 1).
    pub tick_s: f64,
    /// How it answers matter in its way.
    pub response: Response,
}

impl Config {
    /// The pawn of the thesis: 0.5 × 0.5 × 1.8 m, 1.4 m/s, climbs 0.35 m.
    pub fn new(body: Body) -> Self {
        Self {
            body,
            speed: 1.4,
            climb: 0.35,
            gravity: 9.81,
            terminal: 50.0,
            tick_s: 1.0 / 240.0,
            response: Response::Slide,
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        let within = |what: &'static str, value: f64, fits: bool, unit: &str, range: &str| {
            if fits { Ok(()) } else { Err(Error::parameter(what, format!("{value} {unit} lies outside {range}"))) }
        };
        let half = self.body.half();
        let sizes =
            [("pawn's width", 2.0 * half.x), ("pawn's width", 2.0 * half.y), ("pawn's height", self.body.height())];
        for (what, size) in sizes {
            within(what, size, size > 0.0 && size <= MOST, "m", "0 (excluded) to 1000 m")?;
        }
        let (speed, gravity, terminal, tick_s) = (self.speed, self.gravity, self.terminal, self.tick_s);
        within("speed", speed, (0.0..=MOST).contains(&speed), "m/s", "0 to 1000 m/s")?;
        let climbs = (0.0..self.body.height()).contains(&self.climb);
        within(
            "climb height",
            self.climb,
            climbs,
            "m",
            &format!("0 to the pawn's height, {} m (excluded)", self.body.height()),
        )?;
        within("gravity", gravity, (0.0..=MOST).contains(&gravity), "m/s²", "0 to 1000 m/s²")?;
        within("terminal speed", terminal, terminal > 0.0 && terminal <= MOST, "m/s", "0 (excluded) to 1000 m/s")?;
        within("tick", tick_s, (1e-5..=1.0).contains(&tick_s), "s", "0.00001 to 1 s")
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 })
    }
}
