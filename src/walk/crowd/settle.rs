//! Settling: where pawns with the same goal come to rest around it.

use nalgebra::{Point2, Vector2};

/// Share of a disc that pawns fill when they settle around a place: the density that they reach by sliding along each
/// other.
const PACKED: f64 = 0.5;
/// Least gain that counts as getting nearer to a goal (m).
pub(super) const NEARER_M: f64 = 0.02;
/// Time without getting nearer after which a pawn in the disc settles behind another one (s). After [`GIVES_UP_S`] it
/// also settles outside of the disc, or if no pawn has settled there.
pub(super) const SETTLES_S: f64 = 0.25;
pub(super) const GIVES_UP_S: f64 = 10.0;
/// Gap up to which a pawn stands behind a settled one (m).
pub(super) const BEHIND_M: f64 = 0.1;

/// Goal of a pawn, and how it gets past others.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    pub place: Point2<f64>,
    /// Least distance to the goal until now (m), and time since it was reached (s).
    pub nearest: f64,
    pub since: f64,
    pub settled: bool,
    /// Pawn that it settled behind, if any: when that one leaves, there may be room.
    pub behind: Option<usize>,
    /// Side on which it passes a pawn that it meets head on: 1 right, -1 left.
    pub hand: f64,
    /// True if others held it up, so that it asks them to make way; and time that it has moved freely since (s).
    pub pushes: bool,
    pub free: f64,
    /// Pawn that could not make way for it and therefore goes first; and time since then (s).
    pub after: Option<usize>,
    pub after_s: f64,
    /// Move that it wants in this tick, or that leads out of the pawns it overlaps (m).
    pub way: Vector2<f64>,
    /// True if it overlaps others; sum of the overlaps (m), and time for which that has not decreased (s).
    pub parts: bool,
    pub overlap: f64,
    pub waits: f64,
    /// True if the straight move out of others, or out of the way of one, was blocked: then it moves sideways.
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

    /// Returns an aim at another place that keeps how the pawn stands among others.
    pub fn toward(&self, place: Point2<f64>) -> Self {
        Self { place, settled: false, behind: None, nearest: f64::INFINITY, since: 0.0, hand: 1.0, ..*self }
    }
}

/// A place by the bits of its coordinates: sortable, and equal only to itself.
pub(super) type PlaceKey = [u64; 2];

pub(super) fn key_of(place: Point2<f64>) -> PlaceKey {
    [place.x.to_bits(), place.y.to_bits()]
}

/// Returns the radius of the disc that all pawns with the goal `place` fill together (m); `wanted` lists goal and area
/// of each pawn, sorted.
pub(super) fn packed_radius(wanted: &[(PlaceKey, f64)], place: Point2<f64>) -> f64 {
    let key = key_of(place);
    let first = wanted.partition_point(|(other, _)| *other < key);
    let there = wanted[first..].iter().take_while(|(other, _)| *other == key);
    // Sorted, so that the sum is the same on every machine.
    (there.map(|(_, area)| area).sum::<f64>() / (std::f64::consts::PI * PACKED)).sqrt()
}
