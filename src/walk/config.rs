//! Shape and abilities of a pawn.

use super::Body;
use super::body::MOST;
use crate::text::number;
use crate::{Error, Parameter, Result};

/// How a pawn responds to something solid in its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Response {
    /// Sweeps the body exactly and slides along walls.
    #[default]
    Slide,
    /// Steps of fixed length, halved while they collide (thesis, section 3.2.2); stands on the highest floor.
    Thesis,
    /// [`Thesis`](Self::Thesis), but standing on the mean of the floor's heights.
    ThesisMean,
}

/// Shape and abilities of a pawn; lengths in metres, times in seconds. [`Walker::new`](super::Walker::new) rejects
/// values outside the limits, which bound the work of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Its shape.
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
    /// Response to something solid in its way.
    pub response: Response,
    /// Deepest ledge that the pawn walks over (m, >= 0); it stops at deeper ones and at the edge of the scan. With
    /// `None`, and with the responses of the thesis, it walks over any ledge and falls.
    pub max_drop: Option<f64>,
}

impl Config {
    /// Returns the defaults for `body`: 1.4 m/s, climbs 0.35 m, ticks of 1/240 s. The default body is that of the
    /// thesis, 0.5 × 0.5 × 1.8 m.
    pub fn new(body: Body) -> Self {
        Self {
            body,
            speed: 1.4,
            climb: 0.35,
            gravity: 9.81,
            terminal: 50.0,
            tick_s: 1.0 / 240.0,
            response: Response::Slide,
            max_drop: None,
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        self.body.check()?;
        let height = self.body.height();
        let limits = |what, value: f64, fits: bool, expected: &str| {
            if fits {
                return Ok(());
            }
            Err(Error::parameter(Parameter::Pawn(what), format!("{} (expected {expected})", number(value))))
        };
        let (speed, climb, gravity, terminal) = (self.speed, self.climb, self.gravity, self.terminal);
        limits("speed", speed, (0.0..=MOST).contains(&speed), "0 to 1000 m/s")?;
        let fits = (0.0..height).contains(&climb);
        limits("climb height", climb, fits, &format!("0 m to less than the pawn's height of {height} m"))?;
        limits("gravity", gravity, (0.0..=MOST).contains(&gravity), "0 to 1000 m/s²")?;
        limits("terminal speed", terminal, terminal > 0.0 && terminal <= MOST, "more than 0, at most 1000 m/s")?;
        let max_drop = self.max_drop.unwrap_or(0.0);
        limits("deepest drop", max_drop, max_drop >= 0.0 && max_drop.is_finite(), "0 m or more")?;
        limits("tick", self.tick_s, (1e-5..=1.0).contains(&self.tick_s), "0.00001 to 1 s")
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 })
    }
}
