//! Waypoints: places to reach one after the other.

use super::Wish;
use crate::{Error, Result};
use nalgebra::{Point2, Point3};

/// A place that the pawn cannot get any nearer to counts as reached within this distance (m).
pub(super) const REACH_M: f64 = 0.01;
/// Else it counts as reached within rounding errors, as a share of its coordinates and at least so much (m): beside it, a way
/// through a gate as wide as the pawn would begin with a contact.
const EXACT: f64 = 1e-15;
const EXACT_M: f64 = 1e-15;

/// Places to reach one after the other, in x and y (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Waypoints {
    places: Vec<Point2<f64>>,
    next: usize,
}

impl Waypoints {
    /// The way over these places (m, finite). None at all is refused.
    pub fn new(places: Vec<Point2<f64>>) -> Result<Self> {
        if places.is_empty() || !places.iter().all(|place| place.iter().all(|v| v.is_finite())) {
            return Err(Error::parameter("waypoints", "expected at least one place, all of them finite".to_owned()));
        }
        Ok(Self { places, next: 0 })
    }

    /// The places.
    pub fn places(&self) -> &[Point2<f64>] {
        &self.places
    }

    /// Number of the place to be reached next; the number of places at the end.
    pub fn next(&self) -> usize {
        self.next
    }

    /// Whether the last place has been reached.
    pub fn done(&self) -> bool {
        self.next == self.places.len()
    }

    /// The wish of a pawn at `feet`, which made no progress in its last tick if it `stalled`; `None` at the end.
    pub(super) fn wish(&mut self, feet: Point3<f64>, mut stalled: bool) -> Option<Wish> {
        while let Some(place) = self.places.get(self.next) {
            let off = place - feet.xy();
            let is_there = off.amax() <= EXACT_M + EXACT * place.coords.amax() || stalled && off.norm() <= REACH_M;
            if !is_there {
                return Some(Wish::Toward(*place));
            }
            (self.next, stalled) = (self.next + 1, false);
        }
        None
    }
}
