//! Outlines of pawns: gaps between them, and first contacts of moves.

use crate::walk::{Body, Walker};
use nalgebra::Vector2;

/// Gap up to which pawns touch (m).
pub(super) const TOUCH_M: f64 = 1e-9;

/// Depth from which pawns overlap (m): rounding errors at 10⁷ m are less.
const OVERLAP_M: f64 = 2e-8;

/// Outline of a pawn: its footprint and its heights.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outline {
    /// Middle of its footprint (m).
    pub center: Vector2<f64>,
    half: Vector2<f64>,
    round: bool,
    /// Heights of the feet and the head (m).
    pub low: f64,
    pub high: f64,
}

impl Outline {
    pub fn of(walker: &Walker) -> Self {
        let (feet, body) = (walker.feet(), &walker.config.body);
        Self {
            center: feet.xy().coords,
            half: body.half(),
            round: matches!(body, Body::Cylinder { .. }),
            low: feet.z,
            high: feet.z + body.height(),
        }
    }

    /// Returns the gap to another pawn (m, negative inside it) and the direction away from it. The gap is infinite if
    /// the other one is above or below.
    pub fn gap(&self, other: &Self) -> (f64, Vector2<f64>) {
        if self.low >= other.high || other.low >= self.high {
            return (f64::INFINITY, Vector2::x());
        }
        self.gap_across(other)
    }

    /// Returns whether the pawns overlap.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.gap(other).0 < -OVERLAP_M
    }

    /// Returns the gap on the ground plan. Between two cylinders it is that of discs; a cylinder beside a box counts as
    /// a box.
    pub fn gap_across(&self, other: &Self) -> (f64, Vector2<f64>) {
        let apart = self.center - other.center;
        if self.round && other.round {
            let distance = apart.norm();
            let normal = if distance > 0.0 { apart / distance } else { Vector2::x() };
            return (distance - self.half.x - other.half.x, normal);
        }
        let gaps = apart.abs() - self.half - other.half;
        let axis = usize::from(gaps.y > gaps.x);
        let mut normal = Vector2::zeros();
        normal[axis] = if apart[axis] < 0.0 { -1.0 } else { 1.0 };
        (gaps[axis], normal)
    }

    /// Returns the share of the move `way` after which it touches another pawn, and the direction away from that one.
    pub fn meets(&self, other: &Self, way: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (gap, normal) = self.gap(other);
        if gap == f64::INFINITY || gap > way.norm() {
            return None;
        }
        if self.round && other.round {
            let (apart, reach) = (self.center - other.center, self.half.x + other.half.x);
            let (a, b, c) = (way.norm_squared(), apart.dot(&way), apart.norm_squared() - reach * reach);
            let root = b * b - a * c;
            // A move along the other pawn is not towards it, in spite of rounding errors.
            if b >= -TOUCH_M * a.sqrt() || root <= 0.0 {
                return None;
            }
            let share = ((-b - root.sqrt()) / a).max(0.0);
            let normal = (apart + way * share).try_normalize(0.0).unwrap_or(normal);
            return (share <= 1.0).then_some((share, normal));
        }
        let (mut enter, mut leave, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 0);
        for a in 0..2 {
            let (apart, reach) = (other.center[a] - self.center[a], self.half[a] + other.half[a]);
            if way[a] == 0.0 {
                if apart.abs() >= reach - TOUCH_M {
                    return None;
                }
                continue;
            }
            let (s, t) = ((apart - reach) / way[a], (apart + reach) / way[a]);
            if s.min(t) > enter {
                (enter, axis) = (s.min(t), a);
            }
            leave = leave.min(s.max(t));
        }
        let mut normal = Vector2::zeros();
        normal[axis] = -way[axis].signum();
        let near = TOUCH_M / way.norm();
        (enter < leave - near && enter <= 1.0 && enter >= -near).then_some((enter.max(0.0), normal))
    }
}
