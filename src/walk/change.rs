//! Changes to a pawn while it walks: jumps, another body, another speed.

use super::{Body, Config, Ground, Response, Walker};
use crate::Result;
use crate::query::Answer;
use crate::store::Snapshot;
use nalgebra::Vector3;

impl Walker {
    /// Jumps with an upward speed (m/s) if the pawn stands on something, and returns whether it jumped. The pawn rises
    /// `speed² / 2g`, or until its head meets something solid, and climbs no steps in the air. Does nothing with the
    /// responses of the thesis.
    pub fn jump(&mut self, speed: f64) -> bool {
        let stands = self.motion.ground != Ground::Air && self.config.response == Response::Slide;
        let jumps = stands && speed > 0.0 && speed.is_finite();
        if jumps {
            (self.motion.ground, self.motion.falling) = (Ground::Air, -speed);
        }
        jumps
    }

    /// Replaces the configuration from the next tick on; place and motion stay. A larger body may overlap something
    /// solid, and the next tick then pushes it out: check [`has_room`](Self::has_room) first.
    pub fn set_config(&mut self, config: Config) -> Result<()> {
        config.check()?;
        self.config = config;
        Ok(())
    }

    /// Returns whether `body` would overlap nothing solid at the pawn's feet. Touching is not overlapping. False for a body
    /// with a size outside the limits of [`Body`].
    pub fn has_room(&self, set: &Snapshot, body: &Body) -> Answer<bool> {
        if body.check().is_err() {
            return Answer::Known(false);
        }
        match body.sweep(set, self.motion.feet, Vector3::zeros()) {
            Answer::Known(hit) => Answer::Known(hit.is_none()),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        }
    }
}
