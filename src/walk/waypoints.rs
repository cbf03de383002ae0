//! Waypoints: places to reach in order.

use super::{MoveInput, Walker};
use crate::{Error, Result};
use nalgebra::{Point2, Point3};

/// A waypoint counts as reached within this distance if the pawn cannot get any nearer (m).
pub(super) const REACH_M: f64 = 0.01;
/// Otherwise it counts as reached within rounding errors: this share of its coordinates, and at least this distance
/// (m). Any farther off, a path through a gate as wide as the pawn would begin with a contact.
const EXACT: f64 = 1e-15;
const EXACT_M: f64 = 1e-15;

/// Places to reach in order, x and y (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Waypoints {
    places: Vec<Point2<f64>>,
    pub(super) next: usize,
}

impl Waypoints {
    /// Creates the path over `places` (m). Fails if it is empty, or if a coordinate is not finite.
    pub fn new(places: Vec<Point2<f64>>) -> Result<Self> {
        if places.is_empty() || !places.iter().all(|place| place.iter().all(|v| v.is_finite())) {
            return Err(Error::parameter("waypoints", "expected at least one place, all of them finite".to_owned()));
        }
        Ok(Self { places, next: 0 })
    }

    /// Returns all places.
    pub fn places(&self) -> &[Point2<f64>] {
        &self.places
    }

    /// Returns the index of the next place to reach, or the number of places if the last one has been reached.
    pub fn next(&self) -> usize {
        self.next
    }

    /// Returns the place that `walker` heads for in its next tick; `None` at the end. For callers that move the
    /// walker tick by tick; [`Walker::follow`] needs no such call.
    pub fn next_place(&mut self, walker: &Walker) -> Option<Point2<f64>> {
        self.wish(walker.feet(), walker.stalled).map(|_| self.places[self.next])
    }

    /// Returns the move input for a pawn at `feet` that did not move in its last tick if `stalled`; `None` at the end.
    pub(super) fn wish(&mut self, feet: Point3<f64>, mut stalled: bool) -> Option<MoveInput> {
        while let Some(place) = self.places.get(self.next) {
            let off = place - feet.xy();
            let is_there = off.amax() <= EXACT_M + EXACT * place.coords.amax() || stalled && off.norm() <= REACH_M;
            if !is_there {
                return Some(MoveInput::Toward(*place));
            }
            (self.next, stalled) = (self.next + 1, false);
        }
        None
    }
}
