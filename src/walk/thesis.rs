//! The response of the thesis (section 3.2.2) as written there, weaknesses included, for comparison.
//!
//! The pawn moves by steps of fixed length. If an obstacle touches it above the climb height, it returns to the place
//! of its last step and halves the step length; a step without collision resets the length. Its height is the highest
//! floor (or the mean of all floors) under it up to the climb height. The thesis does not say how a pawn falls; here it
//! falls once per tick and lands on floor that it then finds under it.

use super::{Config, Ground, Motion, Needs, Response, Stop, known};
use crate::store::Snapshot;
use nalgebra::Vector2;
use std::ops::ControlFlow;

/// Shortest step, as a share of the full one.
const LEAST_STEP: f64 = 1.0 / 64.0;

pub(super) fn tick(config: &Config, set: &Snapshot, motion: &mut Motion, way: Vector2<f64>) -> Needs<Option<Stop>> {
    let mut stop = None;
    let body = &config.body;
    if way.norm() > 0.0 {
        let to = motion.feet + (way * motion.step).push(0.0);
        if known(body.obstructed(set, to, config.climb))? {
            motion.step = (motion.step * 0.5).max(LEAST_STEP);
            stop = Some(Stop::Wall);
        } else {
            motion.feet = to;
            motion.step = 1.0;
        }
    }
    let fall = motion.falling * config.tick_s;
    motion.feet.z -= fall;
    // From the climb height down to the feet; on the ground, also down by the climb height.
    let (from, depth) = match motion.ground {
        Ground::Air => (motion.feet.z + config.climb, config.climb),
        _ => (motion.feet.z + config.climb, 2.0 * config.climb),
    };
    let floor = match config.response {
        Response::ThesisMean => body.mean_floor(set, motion.feet, from, depth),
        _ => body.floor(set, motion.feet, from, depth),
    };
    match known(floor)? {
        Some(floor) => {
            motion.feet.z = floor;
            (motion.ground, motion.falling, motion.floor_z) = (Ground::Floor, 0.0, floor);
        }
        None => {
            motion.ground = Ground::Air;
            motion.falling = (motion.falling + config.gravity * config.tick_s).min(config.terminal);
        }
    }
    ControlFlow::Continue(stop)
}
