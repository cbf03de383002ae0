//! Pages that a moving body may touch, and when: the order in which pages are loaded.
//!
//! Times are lower bounds in closed form. A body cannot reach a page before it has closed the gap along each axis:
//! horizontally at its velocity, or at its agility if that is faster (it may turn at any moment); downwards by falling
//! from now on, up to its terminal speed, even if it stands (it may walk off a ledge); upwards at its velocity or
//! agility. A body never touches a page before that page's time, so loading in order of time is loading in order of
//! need.

use super::index::Index;
use crate::frame::{Frame, PageKey, SLICE_QUANTA, TILE_PIXELS};
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// Motion hint: how a body moves, and therefore which pages it may touch soon. See
/// [`PawnHandle::hint`](super::PawnHandle::hint).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionHint {
    /// Least corner of the box that holds everything the queries of one frame may cover if the body stood still (m):
    /// the body grown by climb height, snap distance and skin.
    pub min: Point3<f64>,
    /// Greatest corner of that box (m).
    pub max: Point3<f64>,
    /// Current velocity (m/s).
    pub velocity: Vector3<f64>,
    /// Acceleration of free fall (m/s²); 0 for a body that cannot fall.
    pub gravity: f64,
    /// Greatest speed of falling (m/s).
    pub terminal_speed: f64,
    /// Speed that the body may adopt from one frame to the next, in any horizontal direction or upwards (m/s); for a
    /// walker, its walking speed.
    pub agility: f64,
}

impl MotionHint {
    /// Creates the hint of a walker in the box `min..max` (m) with this velocity (m/s). It falls by 9.81 m/s² up to 60
    /// m/s; its agility is its horizontal speed, at least 1.5 m/s.
    pub fn walking(min: Point3<f64>, max: Point3<f64>, velocity: Vector3<f64>) -> Self {
        let agility = velocity.xy().norm().max(1.5);
        Self { min, max, velocity, gravity: 9.81, terminal_speed: 60.0, agility }
    }

    /// Returns whether all numbers are finite and at most 10⁹ in magnitude, the box is in order, and gravity, terminal
    /// speed and agility are not negative. Other hints are ignored.
    pub fn is_valid(&self) -> bool {
        let ordered = (0..3).all(|axis| self.min[axis] <= self.max[axis]);
        let speeds = [self.gravity, self.terminal_speed, self.agility];
        let finite = |v: &f64| v.is_finite() && v.abs() <= 1e9;
        ordered
            && self.min.iter().chain(self.max.iter()).chain(self.velocity.iter()).all(finite)
            && speeds.iter().all(|speed| finite(speed) && *speed >= 0.0)
    }

    /// Returns the page at the body's middle.
    pub(super) fn focus(&self, frame: &Frame) -> PageKey {
        let middle = nalgebra::center(&self.min, &self.max);
        PageKey {
            tx: clamped(frame.pixel_of(middle.x).div_euclid(TILE_PIXELS)),
            ty: clamped(frame.pixel_of(middle.y).div_euclid(TILE_PIXELS)),
            layer: clamped(frame.slice_of(middle.z).div_euclid(64)),
        }
    }

    /// Returns the least time until the body can touch `low..high` along `axis` (s).
    fn time_along(&self, axis: usize, low: f64, high: f64) -> f64 {
        let over = |gap: f64, speed: f64| if gap <= 0.0 { 0.0 } else { gap / speed };
        let velocity = self.velocity[axis];
        let forward = over(low - self.max[axis], velocity.max(self.agility));
        if axis < 2 {
            return forward.max(over(self.min[axis] - high, (-velocity).max(self.agility)));
        }
        forward.max(self.fall_time(self.min[2] - high))
    }

    /// Returns the time to fall `gap` (m) from now on (s).
    fn fall_time(&self, gap: f64) -> f64 {
        if gap <= 0.0 {
            return 0.0;
        }
        let speed = (-self.velocity.z).max(0.0);
        let (gravity, top) = (self.gravity, self.terminal_speed.max(speed));
        if gravity <= 0.0 {
            return gap / speed.max(self.agility);
        }
        let rise = (top - speed) / gravity;
        let fallen = (speed + top) / 2.0 * rise;
        if gap > fallen { rise + (gap - fallen) / top } else { (top_root(speed, gravity, gap) - speed) / gravity }
    }

    /// Returns how far the body can move sideways along `axis` within `time`, backward and forward (m).
    fn reach(&self, axis: usize, time: f64) -> [f64; 2] {
        [-self.velocity[axis], self.velocity[axis]].map(|speed| speed.max(self.agility) * time)
    }

    /// Adds all pages that the body can touch within `horizon` (s) to `wanted`, each with the least time of all bodies.
    pub(super) fn wants(&self, index: &Index, horizon: f64, wanted: &mut HashMap<u32, f32>) {
        let frame = index.frame();
        let (pixel, slice) = (frame.pixel_m(), frame.slice_m());
        let tiles = |axis: usize| {
            let [back, ahead] = self.reach(axis, horizon);
            let tile = |x: f64| clamped(frame.pixel_of(x).div_euclid(TILE_PIXELS));
            [tile(self.min[axis] - back - pixel), tile(self.max[axis] + ahead + pixel)]
        };
        index.for_each_column(tiles(0), tiles(1), |pages| {
            let first = index.key(pages.start);
            // Grown by a pixel and a slice, so that rounding never makes a page late.
            let side = |axis: usize, tile: i32| {
                let low = frame.edge_of_pixel(i64::from(tile) * TILE_PIXELS) - pixel;
                self.time_along(axis, low, low + (TILE_PIXELS + 2) as f64 * pixel)
            };
            let sideways = side(0, first.tx).max(side(1, first.ty));
            for page in pages {
                let (low, high) = index.entry(page).slice_range();
                let (low, high) = (frame.bottom_of_slice(low - 1), frame.bottom_of_slice(high + 2));
                let time = sideways.max(self.time_along(2, low, high + slice / SLICE_QUANTA as f64));
                if time <= horizon {
                    let least = wanted.entry(page).or_insert(f32::INFINITY);
                    *least = least.min(time as f32);
                }
            }
        });
    }
}

/// Returns the speed after falling `gap` from `speed`.
fn top_root(speed: f64, gravity: f64, gap: f64) -> f64 {
    (speed * speed + 2.0 * gravity * gap).sqrt()
}

fn clamped(index: i64) -> i32 {
    index.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

/// Returns the distance in layers, then in tiles (the greater of x and y), from the nearest of `focus`. The page with
/// the greatest distance is evicted first (thesis, section 3.2.1: the slice with the furthest z goes).
pub(super) fn distance(key: PageKey, focus: &[PageKey]) -> (u32, u32) {
    let from = |around: &PageKey| {
        (key.layer.abs_diff(around.layer), key.tx.abs_diff(around.tx).max(key.ty.abs_diff(around.ty)))
    };
    focus.iter().map(from).min().unwrap_or((0, 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn body(velocity: Vector3<f64>) -> MotionHint {
        MotionHint::walking(Point3::new(-0.25, -0.25, 0.0), Point3::new(0.25, 0.25, 1.8), velocity)
    }

    #[test]
    fn times_of_falls_are_those_of_the_formula() {
        let falls = |speed: f64, gap: f64| body(Vector3::new(0.0, 0.0, -speed)).fall_time(gap);
        assert!((falls(0.0, 4.905) - 1.0).abs() < 1e-12);
        assert!((falls(10.0, 14.905) - 1.0).abs() < 1e-12);
        assert!((falls(60.0, 30.0) - 0.5).abs() < 1e-12, "no faster than the terminal speed");
        assert!((falls(80.0, 40.0) - 0.5).abs() < 1e-12, "unless it is faster already");
        assert_eq!(falls(3.0, 0.0), 0.0);
        // A body that cannot fall comes down only as it moves.
        let sinks = |speed: f64| MotionHint { gravity: 0.0, ..body(Vector3::new(0.0, 0.0, -speed)) }.fall_time(6.0);
        assert!((sinks(3.0) - 2.0).abs() < 1e-12 && sinks(6.0) < sinks(3.0) && sinks(3.0) < sinks(0.0));
    }

    #[test]
    fn hints_that_are_no_numbers_are_not_valid() {
        assert!(body(Vector3::zeros()).is_valid());
        assert!(!body(Vector3::new(f64::NAN, 0.0, 0.0)).is_valid());
        assert!(!MotionHint { gravity: -1.0, ..body(Vector3::zeros()) }.is_valid());
        assert!(!MotionHint { min: Point3::new(1.0, 0.0, 0.0), ..body(Vector3::zeros()) }.is_valid());
        assert!(!MotionHint { max: Point3::new(1.0, 0.0, f64::INFINITY), ..body(Vector3::zeros()) }.is_valid());
    }

    proptest! {
        /// Simulates in small steps: no point is touched before its time, and every point touched is within reach.
        #[test]
        fn nothing_is_touched_before_its_time(
            vx in -20.0f64..20.0, vz in -70.0f64..10.0, turn in 0.0f64..2.0, gap in 0.01f64..40.0, axis in 0usize..3, back: bool
        ) {
            let motion = body(Vector3::new(vx, 0.0, vz));
            let mut velocity = motion.velocity;
            let (mut moved, mut time, step) = (Vector3::zeros(), 0.0, 1e-3);
            let way = if back { -1.0 } else { 1.0 };
            let ends = [motion.min[axis], motion.max[axis]];
            let [low, high] = if back { [ends[0] - gap - 1.0, ends[0] - gap] } else { [ends[1] + gap, ends[1] + gap + 1.0] };
            let least = motion.time_along(axis, low, high);
            while time < 3.0 && way * moved[axis] < gap {
                if time > turn {
                    velocity.x = if back { -motion.agility } else { motion.agility };
                    velocity.y = velocity.x;
                }
                // Exact for the fall within a step, like the body's own motion.
                let falling = (velocity.z - motion.gravity * step).max(-motion.terminal_speed.max(-motion.velocity.z));
                moved += Vector3::new(velocity.x, velocity.y, (velocity.z + falling) / 2.0) * step;
                velocity.z = falling;
                time += step;
            }
            if way * moved[axis] >= gap {
                prop_assert!(least <= time + 1e-9, "touched at {time}, before {least}");
                let reach = motion.reach(axis, time)[usize::from(!back)];
                prop_assert!(axis == 2 || reach >= gap - 1e-6, "{reach} m");
            }
        }
    }
}
