//! Progress of a pawn, measured by where it gets to rather than by how far it walks.

use nalgebra::{Point2, Vector2};

/// Time over which progress is measured (s).
const WINDOW_S: f64 = 1.0;
/// A pawn is stuck if it got no farther than this share of the distance that it wanted to go, and of the distance that
/// it walked.
const SHARE: f64 = 0.25;
/// A pawn without a steady direction is never stuck: the sum of its wanted moves must be longer than this share of
/// their lengths.
const STRAIGHT: f64 = 0.5;

/// The current measurement of a pawn on its feet; if it is stuck, the measurement that showed it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Progress {
    from: Point2<f64>,
    /// Since then: sum of the wanted moves and of their lengths, length walked (m), time (s).
    wanted: Vector2<f64>,
    wanted_m: f64,
    walked: f64,
    time: f64,
    /// Sum of the wanted moves of the second without progress; zero if the pawn is not stuck.
    stuck_for: Vector2<f64>,
}

impl Progress {
    pub fn at(place: Point2<f64>) -> Self {
        let none = Vector2::zeros();
        Self { from: place, wanted: none, wanted_m: 0.0, walked: 0.0, time: 0.0, stuck_for: none }
    }

    /// Returns whether the pawn walked without getting anywhere.
    pub fn is_stuck(&self) -> bool {
        self.stuck_for != Vector2::zeros()
    }

    /// Adds a tick of `tick_s` in which the pawn wanted `way` and moved from `before` to `after`. In the air, `way` is
    /// zero.
    pub fn note(&mut self, tick_s: f64, way: Vector2<f64>, before: Point2<f64>, after: Point2<f64>) {
        if way == Vector2::zeros()
            || self.is_stuck() && 2.0 * way.dot(&self.stuck_for) < way.norm() * self.stuck_for.norm()
        {
            // It stands on purpose, or tries another direction.
            *self = Self::at(after);
            return;
        }
        let gained = (after - self.from).norm();
        if self.is_stuck() {
            if gained > SHARE * self.stuck_for.norm() {
                *self = Self::at(after);
            }
            return;
        }
        self.wanted += way;
        self.wanted_m += way.norm();
        self.walked += (after - before).norm();
        self.time += tick_s;
        if self.time >= WINDOW_S * (1.0 - 1e-9) {
            let wanted = self.wanted.norm();
            let is_stuck = gained < SHARE * self.walked.min(wanted) && wanted > STRAIGHT * self.wanted_m;
            *self = if is_stuck { Self { stuck_for: self.wanted, ..*self } } else { Self::at(after) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: f64 = 1.0 / 60.0;

    /// Walks for some seconds by `step`, which returns the wanted move and the place after a tick. Returns in how many
    /// ticks of the last second the pawn was stuck.
    fn stuck(seconds: usize, step: impl Fn(f64) -> (Vector2<f64>, Point2<f64>)) -> usize {
        let mut before = step(0.0).1;
        let (mut progress, mut count) = (Progress::at(before), 0);
        for n in 1..=60 * seconds {
            let (way, after) = step(n as f64 * TICK);
            progress.note(TICK, way, before, after);
            before = after;
            count += usize::from(progress.is_stuck() && n > 60 * (seconds - 1));
        }
        count
    }

    #[test]
    fn who_runs_round_and_round_is_stuck_and_who_creeps_is_not() {
        let far = 1.4 * TICK;
        let ahead = Vector2::x() * far;
        // Around a circle of 10 cm while it wants straight ahead.
        assert_eq!(stuck(3, |t| (ahead, Point2::new((14.0 * t).cos() * 0.1, (14.0 * t).sin() * 0.1))), 60);
        // Back and forth.
        assert_eq!(stuck(3, |t| (ahead, Point2::new(0.1 * (9.0 * t).sin(), 0.0))), 60);
        // Slowly along a wall; and around a circle on purpose.
        assert_eq!(stuck(3, |t| (ahead, Point2::new(0.05 * t, 0.0))), 0);
        let turning = |t: f64| Vector2::new(-(14.0 * t).sin(), (14.0 * t).cos()) * far;
        assert_eq!(stuck(3, |t| (turning(t), Point2::new((14.0 * t).cos() * 0.1, (14.0 * t).sin() * 0.1))), 0);
        // Back and forth on purpose.
        let away = |t: f64| if (t % 1.0) < 0.5 { t % 1.0 } else { 1.0 - t % 1.0 };
        let way = |t: f64| if (t % 1.0) <= 0.5 { ahead } else { -ahead };
        assert_eq!(stuck(3, |t| (way(t), Point2::new(1.4 * away(t), 0.0))), 0);
        // Standing still while blocked is detected elsewhere, at once.
        assert_eq!(stuck(3, |_| (ahead, Point2::origin())), 0);
    }

    #[test]
    fn who_gets_away_or_turns_round_is_stuck_no_more() {
        let ahead = Vector2::x() * (1.4 * TICK);
        let circle = |t: f64| Point2::new((14.0 * t).cos() * 0.1, (14.0 * t).sin() * 0.1);
        assert!(
            stuck(3, |t| if t < 2.2 { (ahead, circle(t)) } else { (ahead, Point2::new(1.4 * (t - 2.2), 0.0)) }) < 35
        );
        assert!(stuck(3, |t| (if t < 2.2 { ahead } else { -ahead }, circle(t))) < 15);
    }
}
