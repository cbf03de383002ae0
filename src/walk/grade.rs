//! The steepness of the way that a pawn has walked.

use super::State;
use nalgebra::Point3;
use std::collections::VecDeque;

/// Length over which grades count, height by which the feet may deviate from the ground, and least distance between
/// two places that count (m).
const GRADE_M: f64 = 1.0;
const GRADE_SLACK_M: f64 = 0.02;
const GRADE_STEP_M: f64 = 0.01;

/// Grade of the line that fits the last metre of a pawn's way best (least squares), as that of the ground is the slope of
/// a plane. Give it the place of the pawn after each step of about 1/60 s.
#[derive(Debug, Clone)]
pub struct Grade {
    /// Steepest allowed grade, as rise over run.
    most: f64,
    /// Distance in plan and height of each place of the last metre (m), the farthest first.
    places: VecDeque<(f64, f64)>,
    last: Point3<f64>,
    is_exceeded: bool,
}

impl Grade {
    /// Creates the grade of a way that begins at `start` (m) and must be no steeper than `most` (rise over run; infinite
    /// for any).
    pub fn new(most: f64, start: Point3<f64>) -> Self {
        Self { most, places: VecDeque::new(), last: start, is_exceeded: false }
    }

    /// Returns whether there is a limit.
    pub(crate) fn is_limited(&self) -> bool {
        self.most.is_finite()
    }

    /// Returns whether the way to the last place was too steep.
    pub fn is_exceeded(&self) -> bool {
        self.is_exceeded
    }

    /// Adds a place and returns whether the way to it is too steep. A fall, or a step down to the first ground, is no
    /// way.
    pub fn exceeds(&mut self, feet: Point3<f64>, state: State) -> bool {
        if self.most.is_infinite() {
            return false;
        }
        if state == State::Falling {
            *self = Self::new(self.most, feet);
            return false;
        }
        let step = (feet - self.last).xy().norm();
        if step < GRADE_STEP_M && !self.places.is_empty() {
            return self.is_exceeded;
        }
        let far = self.places.back().map_or(0.0, |place| place.0) + step;
        self.last = feet;
        self.places.push_back((far, feet.z));
        while self.places.get(1).is_some_and(|second| far - second.0 >= GRADE_M) {
            self.places.pop_front();
        }
        let length = far - self.places[0].0;
        self.is_exceeded = length >= GRADE_M && self.slope().abs() * length > self.most * length + GRADE_SLACK_M;
        self.is_exceeded
    }

    fn slope(&self) -> f64 {
        let count = self.places.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| self.places.iter().map(of).sum::<f64>() / count;
        let (far, z) = (mean(|place| place.0), mean(|place| place.1));
        let sum =
            |of: &dyn Fn(f64, f64) -> f64| self.places.iter().map(|place| of(place.0 - far, place.1 - z)).sum::<f64>();
        sum(&|x, z| x * z) / sum(&|x, _| x * x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns whether 5 m with these heights, one every 1.5 cm, are too steep for 10 %.
    fn is_steep(height: impl Fn(f64) -> f64) -> bool {
        let place = |n: i32| (f64::from(n) * 0.015, height(f64::from(n) * 0.015));
        let mut grade = Grade::new(0.1, Point3::new(0.0, 0.0, height(0.0)));
        (0..333).map(place).any(|(x, z)| grade.exceeds(Point3::new(x, 0.0, z), State::Walking))
    }

    #[test]
    fn a_single_place_makes_no_grade() {
        assert!(!is_steep(|x| 0.08 * x) && is_steep(|x| 0.13 * x) && is_steep(|x| -0.13 * x));
        assert!(!is_steep(|x| 0.05 * x + if (2.0..2.02).contains(&x) { 0.15 } else { 0.0 }));
    }
}
