//! Not all can stand on one place: where those who want to the same one come to rest.

use nalgebra::{Point2, Vector2};

/// Share of a disc that pawns fill who settle around a place: what they reach by sliding along each other.
const PACKED: f64 = 0.5;
/// A pawn gets nearer to its place if it gains this (m).
pub(super) const NEARER_M: f64 = 0.02;
/// It settles behind another one when it has got no nearer for the first time (s), and outside of the disc, or where
/// nobody has settled, after the second.
pub(super) const SETTLES_S: f64 = 0.25;
pub(super) const GIVES_UP_S: f64 = 10.0;
/// So close (m) to one that has settled is behind it.
pub(super) const BEHIND_M: f64 = 0.1;

/// What a pawn is about: the place that it wants to reach, and how it gets past others.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    pub place: Point2<f64>,
    /// How near it came (m), and how long ago that was (s).
    pub nearest: f64,
    pub since: f64,
    pub settled: bool,
    /// Behind whom it settled: if that one goes, there may be room. `None` if it was behind nobody.
    pub behind: Option<usize>,
    /// On which side it passes whom it meets head on: 1 right, -1 left.
    pub hand: f64,
    /// Whether others held it up, so that it asks them to make way; and how long its way has been free since (s).
    pub pushes: bool,
    pub free: f64,
    /// After whom it goes, who could not make way for it; and for how long it did (s).
    pub after: Option<usize>,
    pub after_s: f64,
    /// The way that it wants in this tick, or that leads out of those it stands in (m).
    pub way: Vector2<f64>,
    /// Whether it stands in others, how deep in all of them together (m), and how long that has not become less (s).
    pub parts: bool,
    pub overlap: f64,
    pub waits: f64,
    /// Whether the straight way out of others, or out of the way of one, was closed: then it goes sideways.
    pub closed: bool,
}

impl Aim {
    pub const NONE: Self = Self {
        place: Point2::new(f64::NAN, f64::NAN),
        nearest: f64::INFINITY,
        since: 0.0,
        settled: false,
        behind: None,
        hand: 1.0,
        pushes: false,
        free: 0.0,
        after: None,
        after_s: 0.0,
        way: Vector2::new(0.0, 0.0),
        parts: false,
        overlap: 0.0,
        waits: 0.0,
        closed: false,
    };

    /// Forgets where it wanted to, not how it stands among others.
    pub fn toward(&self, place: Point2<f64>) -> Self {
        Self { place, settled: false, behind: None, nearest: f64::INFINITY, since: 0.0, hand: 1.0, ..*self }
    }
}

/// A place by the bits of its coordinates: sorts, and is equal only to itself.
pub(super) type PlaceKey = [u64; 2];

pub(super) fn key_of(place: Point2<f64>) -> PlaceKey {
    [place.x.to_bits(), place.y.to_bits()]
}

/// Radius of the disc that all those of `wanted` fill together who want to `place` (m); `wanted` has the area of each, in
/// order.
pub(super) fn packed_radius(wanted: &[(PlaceKey, f64)], place: Point2<f64>) -> f64 {
    let key = key_of(place);
    let first = wanted.partition_point(|(other, _)| *other < key);
    let there = wanted[first..].iter().take_while(|(other, _)| *other == key);
    // In order: the sum is the same on every machine.
    (there.map(|(_, area)| area).sum::<f64>() / (std::f64::consts::PI * PACKED)).sqrt()
}
