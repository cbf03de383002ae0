//! Room among other pawns: the free part of a move, and making way.

use super::outline::{Outline, TOUCH_M};
use super::settle::key_of;
use super::{Crowd, CrowdReport};
use crate::store::Snapshot;
use nalgebra::Vector2;

/// Longest chain of pawns that make way for one.
pub(super) const CHAIN: usize = 16;
/// Most contacts that a move handles, and most pawns that it asks to make way.
const CONTACTS: usize = 2;
const ASKED: usize = 4;
/// Multiples of these fill a square evenly (Roberts, *The unreasonable effectiveness of quasirandom sequences*, 2018);
/// see [`Crowd::direction`].
const EVEN: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// Reason for the turn of a pawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turn {
    /// Length of the chain of pawns that made way before it.
    pub depth: usize,
    /// True if the first one overlaps others: then even pawns that stand make way.
    pub parts: bool,
    /// Distance that pawns move to make way (m).
    pub far: f64,
}

impl Crowd {
    /// Returns the move of pawn `n` out of the pawns that it overlaps, half of the overlap with each, and the sum of
    /// the overlaps (m).
    pub(super) fn escape(&self, n: usize) -> (Vector2<f64>, f64) {
        let own = &self.outlines[n];
        let (mut out, mut overlap) = (Vector2::zeros(), 0.0);
        for other in self.neighbours(n).map(|m| &self.outlines[m]).filter(|other| own.overlaps(other)) {
            let (gap, normal) = own.gap(other);
            let level = (own.center - other.center).dot(&normal) == 0.0;
            out += if level { self.direction(n) } else { normal * (-0.5 * gap) };
            overlap -= gap;
        }
        (out, overlap)
    }

    /// Returns the move of pawn `n` away from others at exactly its place: each gets a different one in a square.
    fn direction(&self, n: usize) -> Vector2<f64> {
        Vector2::from(EVEN.map(|step| 2.0 * ((n + 1) as f64 * step).fract() - 1.0)) * self.way
    }

    /// Returns the first contact of pawn `n` with a neighbour on the move `way` from `at`: the share of the move, the
    /// direction away from the neighbour, and its number. A pawn that parts ignores the pawns that it overlaps.
    fn first_contact(&self, n: usize, at: &Outline, way: Vector2<f64>) -> Option<(f64, Vector2<f64>, usize)> {
        let (own, parts) = (&self.outlines[n], self.aims[n].parts);
        let contacts = self.neighbours(n).filter_map(|m| {
            let (share, normal) = at.meets(&self.outlines[m], way)?;
            (!parts || !own.overlaps(&self.outlines[m])).then_some((share, normal, m))
        });
        contacts.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Returns the part of a move that the neighbours of pawn `n` leave free. Those that it may ask make way first.
    pub(super) fn leave_room(
        &mut self,
        set: &Snapshot,
        n: usize,
        wanted: Vector2<f64>,
        turn: Turn,
        report: &mut CrowdReport,
    ) -> Vector2<f64> {
        let (mut at, mut gone, mut rest) = (self.outlines[n], Vector2::zeros(), wanted);
        let (mut contacts, mut asked, mut aside, mut touches) = (0, 0, false, false);
        let own_way = turn.depth == 0 && !turn.parts;
        while contacts < CONTACTS {
            let Some((share, normal, other)) = self.first_contact(n, &at, rest) else {
                gone += rest;
                break;
            };
            touches = true;
            gone += rest * share;
            at.center += rest * share;
            let left = rest * (1.0 - share);
            if asked < ASKED && self.makes_way(other, n, turn) {
                asked += 1;
                self.make_way(set, other, n, -normal, turn, report);
                rest = left;
                continue;
            }
            contacts += 1;
            if aside && share * rest.norm() < TOUCH_M {
                // That side is closed: it changes to the other one.
                self.aims[n].hand = -self.aims[n].hand;
            }
            rest = left - normal * left.dot(&normal).min(0.0);
            if rest.norm() < 0.25 * left.norm() && own_way {
                // Head on: both move to the right.
                rest = Vector2::new(-normal.y, normal.x) * (0.5 * self.aims[n].hand * left.norm());
                aside = true;
            }
        }
        let aim = &mut self.aims[n];
        aim.free = if touches { 0.0 } else { aim.free + self.tick_s };
        gone
    }

    /// Returns whether pawn `m` takes its turn now to make way for pawn `n`: it has had no turn yet, and wants to move
    /// itself. For overlapping pawns, even those that stand make way.
    pub(super) fn makes_way(&self, m: usize, n: usize, turn: Turn) -> bool {
        let asks = turn.depth > 0 || turn.parts || self.aims[n].pushes;
        let aim = &self.aims[m];
        asks && turn.depth < CHAIN && !self.done[m] && !aim.parts && (turn.parts || aim.way != Vector2::zeros())
    }

    /// Moves pawn `m` out of the way of pawn `n`: `away` from it and towards its own goal, or only sideways if it got
    /// nowhere in the last tick. Returns whether it got anywhere.
    pub(super) fn make_way(
        &mut self,
        set: &Snapshot,
        m: usize,
        n: usize,
        away: Vector2<f64>,
        turn: Turn,
        report: &mut CrowdReport,
    ) -> bool {
        let (aim, other, far) = (&self.aims[m], &self.aims[n], turn.far);
        let mut side = aim.way - away * aim.way.dot(&away);
        if key_of(aim.place) == key_of(other.place) {
            side = Vector2::zeros();
        }
        if aim.closed && side.norm() < 0.1 * far {
            // To the side that lies away from the other one's goal.
            side = Vector2::new(-away.y, away.x) * far;
            if side.dot(&(self.outlines[m].center - other.place.coords)) < 0.0 {
                side = -side;
            }
        }
        let way = if aim.closed { side } else { side + away * far };
        let way = way * (far / way.norm().max(far));
        let (closed, from) = (aim.closed, self.outlines[m].center);
        self.go(set, m, way, Turn { depth: turn.depth + 1, ..turn }, report);
        let gains = gains(way, self.outlines[m].center - from);
        if closed && !gains {
            // It cannot for now, so the other one makes way for it.
            (self.aims[n].after, self.aims[n].after_s) = (Some(m), 0.0);
        }
        gains
    }
}

/// Returns whether a pawn that was to move by `asked` moved at least a tenth of it.
pub(super) fn gains(asked: Vector2<f64>, moved: Vector2<f64>) -> bool {
    moved.dot(&asked) > 0.1 * asked.norm_squared()
}
