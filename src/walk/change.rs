//! What a player changes about a pawn while it walks: jumps, and another body or speed.

use super::{Body, Config, Ground, Response, Walker};
use crate::Result;
use crate::query::Answer;
use crate::store::PageSet;
use nalgebra::Vector3;

impl Walker {
    /// Jumps with this speed upwards (m/s) if the pawn stands; whether it does. It rises `speed² / 2g`, or until its head
    /// meets matter, and climbs nothing on the way. The responses of the thesis know no jumps.
    pub fn jump(&mut self, speed: f64) -> bool {
        let stands = self.motion.ground != Ground::Air && self.config.response == Response::Slide;
        let jumps = stands && speed > 0.0 && speed.is_finite();
        if jumps {
            (self.motion.ground, self.motion.falling) = (Ground::Air, -speed);
        }
        jumps
    }

    /// Takes other numbers from the next tick on; place and motion stay. A larger body may find itself in matter, out of
    /// which the next tick pushes it: ask [`has_room`](Self::has_room) first.
    pub fn set_config(&mut self, config: Config) -> Result<()> {
        config.check()?;
        self.config = config;
        Ok(())
    }

    /// Whether `body` would stand free of matter where the pawn's feet are. Touching is free.
    pub fn has_room<S: PageSet>(&self, set: &S, body: &Body) -> Answer<bool> {
        match body.sweep(set, self.motion.feet, Vector3::zeros()) {
            Answer::Known(hit) => Answer::Known(hit.is_none()),
            Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
        }
    }
}
