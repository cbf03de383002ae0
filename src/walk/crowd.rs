//! Many pawns in one world, which keep out of each other.
//!
//! Once per tick the pawns are sorted into a uniform grid; then one after the other, in the order of their numbers,
//! each shortens its way by what its neighbours leave of it, slides along the nearest one, passing on the right where
//! it meets it head on, and takes its tick in the world. Where the world led it into a neighbour, it stays where it
//! was. The order makes the outcome the same on every machine.
//!
//! Not all can stand on one place. Those that want to the same one [settle](State::Arrived) around it: each stops when
//! it gets no nearer, stands behind one that has settled, and reaches into the disc that all of them fill, loosely
//! packed; so they settle from the middle out. Outside of the disc, or where walls leave less room, it walks around the
//! others for a while before it settles behind them. A pawn that has settled stays until it wants to go elsewhere.

use super::follow::REACH_M;
use super::{BLOCKED_BELOW, Body, Ground, State, Walker, Wish};
use crate::store::Missing;
use crate::store::PageSet;
use crate::{Error, Result};
use nalgebra::{Point2, Point3, Vector2};
use std::ops::ControlFlow;

/// Pawns closer than this touch (m).
const TOUCH_M: f64 = 1e-9;

/// Share of a disc that pawns fill who settle around a place: what they reach by sliding along each other.
const PACKED: f64 = 0.5;
/// A pawn gets nearer to its place if it gains this (m).
const NEARER_M: f64 = 0.02;
/// It settles behind another one when it has got no nearer for the first time (s), and outside of the disc, or where
/// nobody has settled, after the second.
const SETTLES_S: f64 = 0.25;
const GIVES_UP_S: f64 = 20.0;
/// So close (m) to one that has settled is behind it.
const BEHIND_M: f64 = 0.1;

/// The place that a pawn wants to reach.
#[derive(Debug, Clone, Copy)]
struct Aim {
    place: Point2<f64>,
    /// How near it came (m), and how long ago that was (s).
    nearest: f64,
    since: f64,
    settled: bool,
    /// On which side it passes whom it meets head on: 1 right, -1 left.
    hand: f64,
}

impl Aim {
    const NONE: Self =
        Self { place: Point2::new(f64::NAN, f64::NAN), nearest: f64::INFINITY, since: 0.0, settled: false, hand: 1.0 };
}

/// A place by the bits of its coordinates: sorts, and is equal only to itself.
type PlaceKey = [u64; 2];

fn key_of(place: Point2<f64>) -> PlaceKey {
    [place.x.to_bits(), place.y.to_bits()]
}

/// Pawns with a common clock.
#[derive(Debug, Clone)]
pub struct Crowd {
    walkers: Vec<Walker>,
    aims: Vec<Aim>,
    /// Area of every pawn, with the place that it wants to reach, as of the beginning of the tick.
    wanted: Vec<(PlaceKey, f64)>,
    tick_s: f64,
    rest_s: f64,
    /// Edge of a cell (m): what a pawn can touch in a tick lies in its cell or in one of the eight around it.
    cell: f64,
    grid: Vec<((i64, i64), u32)>,
    before: Vec<Point3<f64>>,
}

/// What a step of a crowd did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CrowdReport {
    /// Ticks that passed.
    pub ticks: u32,
    /// Pawns that are blocked.
    pub blocked: usize,
    /// Pawns in the air.
    pub falling: usize,
    /// Pawns that stand at the place they wanted to reach, or as near as others let them.
    pub arrived: usize,
    /// Pawn ticks in which one waited for pages.
    pub waits: usize,
    /// The pages that the last of these waited for.
    pub missing: Option<Missing>,
}

impl Crowd {
    /// A crowd of `walkers`, all with ticks of the same length; for 1,000 pawns 1/60 s is a good one. They may stand
    /// inside each other: then they part.
    pub fn new(walkers: Vec<Walker>) -> Result<Self> {
        let tick_s = walkers.first().map_or(1.0 / 60.0, |walker| walker.config.tick_s);
        if walkers.iter().any(|walker| walker.config.tick_s != tick_s) {
            return Err(Error::parameter("crowd", "all pawns need ticks of the same length".to_owned()));
        }
        let width = walkers.iter().map(|walker| 2.0 * walker.config.body.half().max()).fold(0.1, f64::max);
        let way = walkers.iter().map(|walker| walker.config.speed * tick_s).fold(0.0, f64::max);
        let before = walkers.iter().map(Walker::feet).collect();
        let (grid, wanted) = (Vec::with_capacity(walkers.len()), Vec::with_capacity(walkers.len()));
        let aims = vec![Aim::NONE; walkers.len()];
        Ok(Self { walkers, aims, wanted, tick_s, rest_s: 0.0, cell: width + 2.0 * way, grid, before })
    }

    /// The pawns.
    pub fn walkers(&self) -> &[Walker] {
        &self.walkers
    }

    /// Lets `dt` (s, >= 0) pass. `wish` says for each tick where the pawn of a number, with its feet at a place, wants
    /// to go.
    ///
    /// Allocates nothing. Cost: that of each walker, and about 100 ns per neighbour.
    pub fn step<S: PageSet>(
        &mut self,
        set: &S,
        dt: f64,
        mut wish: impl FnMut(usize, Point3<f64>) -> Wish,
    ) -> CrowdReport {
        let mut report = CrowdReport::default();
        let mut time = self.rest_s + if dt.is_finite() { dt.max(0.0) } else { 0.0 };
        while time >= self.tick_s * (1.0 - 1e-9) {
            time = (time - self.tick_s).max(0.0);
            report.ticks += 1;
            self.sort();
            for n in 0..self.walkers.len() {
                let wish = wish(n, self.walkers[n].feet());
                self.tick(set, n, wish, &mut report);
            }
        }
        self.rest_s = time;
        let count = |state: State| self.walkers.iter().filter(|walker| walker.state == state).count();
        report.blocked = count(State::Blocked);
        report.falling = count(State::Falling);
        report.arrived = count(State::Arrived);
        report
    }

    fn cell_of(&self, feet: Point3<f64>) -> (i64, i64) {
        ((feet.x / self.cell).floor() as i64, (feet.y / self.cell).floor() as i64)
    }

    fn sort(&mut self) {
        self.grid.clear();
        for (n, walker) in self.walkers.iter().enumerate() {
            self.before[n] = walker.feet();
            let cell = self.cell_of(walker.feet());
            self.grid.push((cell, n as u32));
        }
        self.grid.sort_unstable();
        self.wanted.clear();
        let wanted = self.walkers.iter().zip(&self.aims);
        self.wanted.extend(wanted.map(|(walker, aim)| (key_of(aim.place), walker.config.body.area())));
        self.wanted.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    }

    /// Pawns that may touch pawn `n` in this tick.
    fn neighbours(&self, n: usize) -> impl Iterator<Item = usize> {
        // Where it was when the grid was made: others may have moved since, by at most a way, and the cells allow for
        // that.
        let (ci, cj) = self.cell_of(self.before[n]);
        (ci - 1..=ci + 1).flat_map(move |i| {
            let first = self.grid.partition_point(|(cell, _)| *cell < (i, cj - 1));
            let row = self.grid[first..].iter().take_while(move |(cell, _)| *cell <= (i, cj + 1));
            row.map(|(_, other)| *other as usize).filter(move |other| *other != n)
        })
    }

    fn tick<S: PageSet>(&mut self, set: &S, n: usize, wish: Wish, report: &mut CrowdReport) {
        self.aim(n, wish);
        let walker = &self.walkers[n];
        let wanted = if self.aims[n].settled { Vector2::zeros() } else { walker.way(wish) };
        let before = walker.motion;
        let own = self.outline(n);
        let (way, hand) = self.leave_room(n, &own, wanted);
        self.aims[n].hand = hand;
        let inside = self.depth(n, &own);
        let walker = &mut self.walkers[n];
        let mut outcome = walker.tick(set, way);
        if self.depth(n, &self.outline(n)) > inside.max(TOUCH_M) {
            // Along a wall into somebody: it stays, and only falls.
            let walker = &mut self.walkers[n];
            walker.motion = before;
            outcome = walker.tick(set, Vector2::zeros());
        }
        let walker = &mut self.walkers[n];
        if let ControlFlow::Break(missing) = outcome {
            report.waits += 1;
            report.missing = Some(missing);
        }
        let moved = (walker.motion.feet - before.feet).xy().norm();
        walker.state = match walker.motion.ground {
            Ground::Air => State::Falling,
            _ if self.aims[n].settled => State::Arrived,
            _ if moved < BLOCKED_BELOW * wanted.norm() => State::Blocked,
            _ => State::Walking,
        };
    }

    /// Whether pawn `n` has come as near to its place as it will.
    fn aim(&mut self, n: usize, wish: Wish) {
        let Wish::Toward(place) = wish else {
            self.aims[n] = Aim::NONE;
            return;
        };
        let mut aim = self.aims[n];
        if key_of(aim.place) != key_of(place) {
            aim = Aim { place, ..Aim::NONE };
        }
        let walker = &self.walkers[n];
        let distance = (walker.feet().xy() - place).norm();
        if distance < aim.nearest - NEARER_M {
            (aim.nearest, aim.since, aim.hand) = (distance, 0.0, 1.0);
        } else {
            aim.since += self.tick_s;
        }
        let late = aim.since >= GIVES_UP_S;
        if aim.settled || walker.motion.ground == Ground::Air {
            // Stays settled; or is not there yet.
        } else if distance <= REACH_M {
            aim.settled = true;
        } else if aim.since >= SETTLES_S {
            let near = distance - walker.config.body.half().max() <= self.packed_radius(place);
            aim.settled = (near || late) && (near && late || self.is_behind_a_settled_one(n, place));
        }
        self.aims[n] = aim;
    }

    /// Radius of the disc that all who want to reach `place` fill together (m).
    fn packed_radius(&self, place: Point2<f64>) -> f64 {
        let key = key_of(place);
        let first = self.wanted.partition_point(|(other, _)| *other < key);
        let there = self.wanted[first..].iter().take_while(|(other, _)| *other == key);
        // In order: the sum is the same on every machine.
        (there.map(|(_, area)| area).sum::<f64>() / (std::f64::consts::PI * PACKED)).sqrt()
    }

    /// Whether pawn `n` touches one that has settled at `place`.
    fn is_behind_a_settled_one(&self, n: usize, place: Point2<f64>) -> bool {
        let own = self.outline(n);
        self.neighbours(n).any(|m| {
            let aim = &self.aims[m];
            aim.settled && key_of(aim.place) == key_of(place) && own.gap(&self.outline(m)).0 <= BEHIND_M
        })
    }

    fn outline(&self, n: usize) -> Outline {
        Outline::of(&self.walkers[n])
    }

    /// How deep pawn `n` with this outline is in its neighbours (m).
    fn depth(&self, n: usize, own: &Outline) -> f64 {
        let depths = self.neighbours(n).map(|other| -own.gap(&self.outline(other)).0);
        depths.fold(0.0, f64::max)
    }

    /// What the neighbours leave of a way; and on which side to pass the next time.
    fn leave_room(&self, n: usize, own: &Outline, wanted: Vector2<f64>) -> (Vector2<f64>, f64) {
        let mut hand = self.aims[n].hand;
        // Out of whom it stands in, whatever it wants.
        let deepest = self.neighbours(n).map(|other| own.gap(&self.outline(other)));
        if let Some((gap, normal)) = deepest.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(gap, _)| *gap < -TOUCH_M) {
            let config = &self.walkers[n].config;
            return (normal * (config.speed * self.tick_s).min(-gap), hand);
        }
        let (mut at, mut gone, mut rest, mut aside) = (*own, Vector2::zeros(), wanted, false);
        for _ in 0..2 {
            let contacts = self.neighbours(n).filter_map(|other| at.meets(&self.outline(other), rest));
            let Some((share, normal)) = contacts.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                gone += rest;
                break;
            };
            if aside && share * rest.norm() < TOUCH_M {
                // Closed: it tries the other side, and keeps to that.
                hand = -hand;
            }
            gone += rest * share;
            at.center += rest * share;
            let left = rest * (1.0 - share);
            rest = left - normal * left.dot(&normal).min(0.0);
            if rest.norm() < 0.25 * left.norm() {
                // Head on: to the right, both of them.
                rest = Vector2::new(-normal.y, normal.x) * (0.5 * hand * left.norm());
                aside = true;
            }
        }
        (gone, hand)
    }
}

/// A pawn from above.
#[derive(Debug, Clone, Copy)]
struct Outline {
    center: Vector2<f64>,
    half: Vector2<f64>,
    round: bool,
    low: f64,
    high: f64,
}

impl Outline {
    fn of(walker: &Walker) -> Self {
        let (feet, body) = (walker.feet(), &walker.config.body);
        Self {
            center: feet.xy().coords,
            half: body.half(),
            round: matches!(body, Body::Cylinder { .. }),
            low: feet.z,
            high: feet.z + body.height(),
        }
    }

    /// Gap to another pawn (m, negative inside it), and the way from it. Two cylinders are round; a box and a cylinder
    /// keep apart as boxes do.
    fn gap(&self, other: &Self) -> (f64, Vector2<f64>) {
        let apart = self.center - other.center;
        if self.low >= other.high || other.low >= self.high {
            return (f64::INFINITY, Vector2::x());
        }
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

    /// The share of `way` after which it touches another pawn, and the way from that.
    fn meets(&self, other: &Self, way: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (gap, normal) = self.gap(other);
        if gap == f64::INFINITY || gap > way.norm() {
            return None;
        }
        if self.round && other.round {
            let (apart, reach) = (self.center - other.center, self.half.x + other.half.x);
            let (a, b, c) = (way.norm_squared(), apart.dot(&way), apart.norm_squared() - reach * reach);
            let root = b * b - a * c;
            // Along it is not towards it, whatever rounding says.
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
