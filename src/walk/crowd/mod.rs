//! Many pawns in one world that keep out of each other.
//!
//! Once per tick the pawns are sorted into a uniform grid and by priority: first the pawns that overlap others, then by
//! remaining distance, shortest first. In this order each pawn shortens its move to what its neighbours leave free,
//! slides along the nearest one (passing on the right if they meet head on), and takes its tick in the world. If the
//! world moved it into a neighbour, it stays where it was; if it fell onto one, it stands on that one's head. The fixed
//! order makes the outcome the same on every machine.
//!
//! Sliding alone jams: two pawns that meet in a door would block each other for ever. So a pawn that others hold up
//! asks those of lower priority to make way; they take their tick at once, away from it, and ask those behind them in
//! turn. This is priority inheritance (Okumura, Machida, Défago and Tamura, *Priority Inheritance with Backtracking*,
//! IJCAI 2019) with moves in place of cells: the first pawn always finds a path where there is room, and when it gets
//! to its place another one becomes the first. Pawns that overlap part in the same manner, each by half of its overlap
//! with every other, and all others make way for them. No pawn ever enters another.
//!
//! Not all pawns can stand at one place. Those with the same goal [settle](State::Arrived) around it: a pawn stops when
//! it gets no nearer, stands behind one that has settled, and reaches into the disc that all of them fill when loosely
//! packed; so they settle from the middle outwards. Outside of the disc, or where walls leave less room, a pawn walks
//! around the others for a while before it settles behind them. A settled pawn stays until it wants to go elsewhere, or
//! until the one that it settled behind is gone.

mod outline;
mod room;
mod settle;

use super::waypoints::REACH_M;
use super::{BLOCKED_BELOW, Ground, MOST_TICKS, Motion, MoveInput, State, Walker};
use crate::sort::{sort, sort_by};
use crate::store::Missing;
use crate::store::Snapshot;
use crate::{Error, Result};
use nalgebra::{Point2, Point3, Vector2};
use outline::{Outline, TOUCH_M};
use room::{CHAIN, Turn, gains};
use settle::{Aim, BEHIND_M, GIVES_UP_S, NEARER_M, PlaceKey, SETTLES_S, key_of, packed_radius};
use std::ops::ControlFlow;

/// A pawn that got no nearer to its goal for this time (s) asks others to make way, until it has moved freely for as
/// long.
const HELD_UP_S: f64 = 0.5;
/// A pawn whose request another one could not meet has its turns after that one for this time (s).
const AFTER_S: f64 = 1.0;
/// Least speed at which overlapping pawns part (m/s), and time without progress after which they try sideways (s).
const PARTS_M_S: f64 = 1.0;
const PARTS_S: f64 = 0.25;
/// Pawns with a common clock.
#[derive(Debug, Clone)]
pub struct Crowd {
    walkers: Vec<Walker>,
    aims: Vec<Aim>,
    tick_s: f64,
    rest_s: f64,
    /// Longest move of a pawn in a tick (m).
    way: f64,
    /// Edge of a grid cell (m): the pawns that a pawn can touch in a tick are in its cell or in one of the eight around
    /// it.
    cell: f64,
    /// State of the current tick: outlines now, places at its beginning, pawns that had their turn.
    outlines: Vec<Outline>,
    before: Vec<Point3<f64>>,
    done: Vec<bool>,
    grid: Vec<((i64, i64), u32)>,
    /// Pawns that were pushed out of something solid, farther than the cells allow for.
    strays: Vec<u32>,
    /// Order of the turns, with the keys that decide it.
    order: Vec<(f64, u32, u32)>,
    /// Goal and footprint area of every pawn, sorted.
    wanted: Vec<(PlaceKey, f64)>,
}

/// Outcome of a step of a crowd.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CrowdReport {
    /// Number of ticks that passed.
    pub ticks: u32,
    /// Number of blocked pawns.
    pub blocked: usize,
    /// Number of pawns in the air.
    pub falling: usize,
    /// Number of pawns at their goal, or as near as others let them.
    pub arrived: usize,
    /// Number of ticks in which a pawn waited for pages, summed over the pawns.
    pub waits: usize,
    /// Pages that the last of these pawns waited for.
    pub missing: Option<Missing>,
    /// Unused time (s), because a step runs at most [`MOST_TICKS`] ticks. Pass it to the next step, or drop it.
    pub unspent: f64,
}

impl Crowd {
    /// Creates a crowd of `walkers`, all with ticks of the same length; 1/60 s suits 1,000 pawns. Pawns that overlap
    /// part.
    pub fn new(walkers: Vec<Walker>) -> Result<Self> {
        let mut crowd = Self {
            walkers: Vec::new(),
            aims: Vec::new(),
            tick_s: 1.0 / 60.0,
            rest_s: 0.0,
            way: 0.0,
            cell: 0.1,
            outlines: Vec::new(),
            before: Vec::new(),
            done: Vec::new(),
            grid: Vec::new(),
            strays: Vec::new(),
            order: Vec::new(),
            wanted: Vec::new(),
        };
        for walker in walkers {
            crowd.add(walker)?;
        }
        Ok(crowd)
    }

    /// Returns the pawns, by number.
    pub fn walkers(&self) -> &[Walker] {
        &self.walkers
    }

    /// Adds a pawn, wherever it stands, and returns its number. Fails if its ticks are not as long as those of the
    /// others. Allocates memory, unlike a step.
    pub fn add(&mut self, walker: Walker) -> Result<usize> {
        let config = &walker.config;
        if self.walkers.is_empty() {
            self.tick_s = config.tick_s;
        }
        if config.tick_s != self.tick_s {
            let reason =
                format!("ticks of {} s (expected {} s, as those of the pawns so far)", config.tick_s, self.tick_s);
            return Err(Error::parameter("crowd", reason));
        }
        self.way = self.way.max(config.speed.max(PARTS_M_S) * self.tick_s);
        self.cell = self.cell.max(2.0 * (config.body.half().max() + self.way));
        self.walkers.push(walker);
        self.aims.push(Aim::NONE);
        let count = self.walkers.len();
        make_room(&mut self.outlines, count);
        make_room(&mut self.before, count);
        make_room(&mut self.done, count);
        make_room(&mut self.grid, count);
        make_room(&mut self.strays, count);
        make_room(&mut self.order, count);
        make_room(&mut self.wanted, count);
        Ok(count - 1)
    }

    /// Removes and returns the pawn with this number, if there is one. Higher numbers fall by one.
    pub fn remove(&mut self, number: usize) -> Option<Walker> {
        if number >= self.walkers.len() {
            return None;
        }
        self.aims.remove(number);
        for aim in &mut self.aims {
            aim.settled &= aim.behind != Some(number);
            for other in [&mut aim.behind, &mut aim.after] {
                *other = other.filter(|m| *m != number).map(|m| m - usize::from(m > number));
            }
        }
        Some(self.walkers.remove(number))
    }

    /// Advances the crowd by `dt` (s, >= 0). In each tick, `wish` returns the move input of a pawn, given its number
    /// and the place of its feet. A `dt` that is negative or not finite counts as 0.
    ///
    /// At most [`MOST_TICKS`] ticks pass; the rest of the time is returned as [`unspent`](CrowdReport::unspent).
    /// Allocates nothing. Cost: that of each walker, and about 100 ns per neighbour.
    pub fn step(
        &mut self,
        set: &Snapshot,
        dt: f64,
        mut wish: impl FnMut(usize, Point3<f64>) -> MoveInput,
    ) -> CrowdReport {
        let mut report = CrowdReport::default();
        let mut time = self.rest_s + if dt.is_finite() { dt.max(0.0) } else { 0.0 };
        while time >= self.tick_s * (1.0 - 1e-9) {
            if report.ticks == MOST_TICKS {
                (report.unspent, time) = (time, 0.0);
                break;
            }
            time = (time - self.tick_s).max(0.0);
            report.ticks += 1;
            self.tick(set, &mut wish, &mut report);
        }
        self.rest_s = time;
        let count = |state: State| self.walkers.iter().filter(|walker| walker.state == state).count();
        report.blocked = count(State::Blocked);
        report.falling = count(State::Falling);
        report.arrived = count(State::Arrived);
        report
    }

    fn tick(
        &mut self,
        set: &Snapshot,
        wish: &mut impl FnMut(usize, Point3<f64>) -> MoveInput,
        report: &mut CrowdReport,
    ) {
        self.sort();
        for n in 0..self.walkers.len() {
            self.aim(n, wish(n, self.walkers[n].feet()));
        }
        self.order.clear();
        for n in 0..self.walkers.len() {
            let (first, hops) = self.rank(n);
            self.order.push((first, hops, n as u32));
        }
        sort_by(&mut self.order, |a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for place in 0..self.order.len() {
            let n = self.order[place].2 as usize;
            if !self.done[n] {
                let (parts, way) = (self.aims[n].parts, self.aims[n].way);
                self.go(set, n, way, Turn { depth: 0, parts, far: way.norm() }, report);
            }
        }
    }

    /// Returns the sort keys of the turn of pawn `n`: the greatest remaining distance (m) of it and the pawns that it
    /// goes after, and the number of these.
    fn rank(&self, n: usize) -> (f64, u32) {
        let left = |n: usize| {
            let aim = &self.aims[n];
            if aim.parts { -1.0 } else { (aim.place.coords - self.outlines[n].center).norm().min(f64::INFINITY) }
        };
        let (mut first, mut hops, mut next) = (left(n), 0, self.aims[n].after);
        while let Some(other) = next.filter(|_| hops < CHAIN as u32) {
            (first, hops, next) = (first.max(left(other)), hops + 1, self.aims[other].after);
        }
        (first, hops)
    }

    fn cell_of(&self, feet: Point3<f64>) -> (i64, i64) {
        ((feet.x / self.cell).floor() as i64, (feet.y / self.cell).floor() as i64)
    }

    fn sort(&mut self) {
        self.outlines.clear();
        self.outlines.extend(self.walkers.iter().map(Outline::of));
        self.before.clear();
        self.before.extend(self.walkers.iter().map(Walker::feet));
        self.done.clear();
        self.done.resize(self.walkers.len(), false);
        self.strays.clear();
        self.grid.clear();
        for n in 0..self.walkers.len() {
            self.grid.push((self.cell_of(self.before[n]), n as u32));
        }
        sort(&mut self.grid);
        self.wanted.clear();
        let wanted = self.walkers.iter().zip(&self.aims);
        self.wanted.extend(wanted.map(|(walker, aim)| (key_of(aim.place), walker.config.body.area())));
        sort_by(&mut self.wanted, |a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    }

    /// Returns the pawns that may touch pawn `n` in this tick.
    fn neighbours(&self, n: usize) -> impl Iterator<Item = usize> {
        // From its place when the grid was made: others may have moved since by at most one move, which the cells allow
        // for.
        let (ci, cj) = self.cell_of(self.before[n]);
        let near = (ci - 1..=ci + 1).flat_map(move |i| {
            let first = self.grid.partition_point(|(cell, _)| *cell < (i, cj - 1));
            let row = self.grid[first..].iter().take_while(move |(cell, _)| *cell <= (i, cj + 1));
            row.map(|(_, other)| *other as usize)
        });
        near.chain(self.strays.iter().map(|other| *other as usize)).filter(move |other| *other != n)
    }

    /// Runs the turn of pawn `n`, which is to move by `asked`.
    fn go(&mut self, set: &Snapshot, n: usize, asked: Vector2<f64>, turn: Turn, report: &mut CrowdReport) {
        self.done[n] = true;
        let (before, own) = (self.walkers[n].motion, self.outlines[n]);
        let way = self.leave_room(set, n, asked, turn, report);
        let mut outcome = self.advance(set, n, way);
        let mut entered = self.entered(n, &own);
        let mut makes_way = false;
        if entered.is_some() {
            self.aims[n].free = 0.0;
        }
        if let Some(m) = entered
            && self.makes_way(m, n, turn)
        {
            // It slid along a wall into a pawn that makes way.
            let (_, normal) = Outline::of(&self.walkers[n]).gap(&self.outlines[m]);
            self.walkers[n].motion = before;
            makes_way = self.make_way(set, m, n, -normal, turn, report);
            outcome = self.advance(set, n, way);
            entered = self.entered(n, &own);
        }
        if entered.is_some() {
            // It stays, but may fall.
            self.walkers[n].motion = before;
            outcome = self.advance(set, n, Vector2::zeros());
            if self.entered(n, &own).is_some() {
                self.walkers[n].motion = before;
            }
            if makes_way {
                // Resume the detour around an edge once there is room.
                let motion = &mut self.walkers[n].motion;
                (motion.detour, motion.detour_for) = (before.detour, before.detour_for);
            }
        }
        if turn.depth > 0 {
            // Another pawn pushed it here, so its earlier detours no longer count.
            let motion = &mut self.walkers[n].motion;
            (motion.hand, motion.changes, motion.detours) = (0.0, 0, 0);
        }
        self.outlines[n] = Outline::of(&self.walkers[n]);
        let waits = outcome.is_break();
        if let ControlFlow::Break(missing) = outcome {
            report.waits += 1;
            report.missing = Some(missing);
        }
        let (walker, aim) = (&mut self.walkers[n], &mut self.aims[n]);
        let moved = self.outlines[n].center - own.center;
        if !aim.parts {
            aim.closed = turn.depth > 0 && aim.closed == gains(asked, moved);
        }
        let moved = moved.norm();
        if moved > self.way * (1.0 + 1e-6) {
            self.strays.push(n as u32);
        }
        let wanted = if aim.settled { Vector2::zeros() } else { aim.way };
        if waits {
            // Time without pages is no time in which it got no nearer.
            aim.since = (aim.since - self.tick_s).max(0.0);
        } else {
            walker.note_progress(wanted, before.feet.xy());
        }
        walker.state = match walker.motion.ground {
            Ground::Air => State::Falling,
            _ if aim.settled => State::Arrived,
            _ if waits => State::Walking,
            _ if moved < BLOCKED_BELOW * wanted.norm() || walker.progress.is_stuck() => State::Blocked,
            _ => State::Walking,
        };
    }

    /// Runs a tick of pawn `n` in the world; it lands on pawns that it falls onto.
    fn advance(&mut self, set: &Snapshot, n: usize, way: Vector2<f64>) -> ControlFlow<Missing> {
        let before = self.walkers[n].motion.feet.z;
        let outcome = self.walkers[n].tick(set, way);
        let own = Outline::of(&self.walkers[n]);
        if own.low < before {
            let passed = |other: &Outline| other.high <= before && other.high > own.low;
            let heads = self.neighbours(n).map(|m| &self.outlines[m]).filter(|other| passed(other));
            let under = heads.filter(|other| own.gap_across(other).0 < -TOUCH_M);
            let head = under.map(|other| other.high).fold(f64::NEG_INFINITY, f64::max);
            if head > own.low {
                let motion = &mut self.walkers[n].motion;
                let floor_z = motion.floor_z.min(head);
                *motion = Motion { falling: 0.0, ground: Ground::Obstacle, floor_z, ..*motion };
                motion.feet.z = head;
            }
        }
        outcome.map_continue(|_| ())
    }

    /// Returns a pawn that pawn `n` now overlaps and did not overlap at `own`.
    fn entered(&self, n: usize, own: &Outline) -> Option<usize> {
        let now = Outline::of(&self.walkers[n]);
        let enters = |m: &usize| *m != n && now.overlaps(&self.outlines[*m]) && !own.overlaps(&self.outlines[*m]);
        if (now.center - own.center).norm() <= self.way * (1.0 + 1e-6) {
            self.neighbours(n).find(enters)
        } else {
            (0..self.walkers.len()).find(enters)
        }
    }

    /// Updates the aim of pawn `n` for this tick, and whether it has settled.
    fn aim(&mut self, n: usize, wish: MoveInput) {
        let mut aim = self.aims[n];
        match wish {
            MoveInput::Toward(place) if key_of(aim.place) == key_of(place) => {}
            MoveInput::Toward(place) => aim = aim.toward(place),
            _ => aim = aim.toward(Aim::NONE.place),
        }
        let (walker, own) = (&self.walkers[n], &self.outlines[n]);
        aim.after_s += self.tick_s;
        aim.after = aim.after.filter(|_| aim.after_s < AFTER_S);
        if aim.place.x.is_finite() {
            let distance = (walker.feet().xy() - aim.place).norm();
            let alone = |m: usize| own.gap(&self.outlines[m]).0 > 2.0 * BEHIND_M || !self.aims[m].settled;
            if aim.behind.is_some_and(alone) {
                (aim.settled, aim.behind, aim.nearest, aim.since) = (false, None, distance, 0.0);
            }
            if distance < aim.nearest - NEARER_M {
                (aim.nearest, aim.since, aim.hand) = (distance, 0.0, 1.0);
            } else {
                aim.since += self.tick_s;
            }
            if !aim.settled && walker.motion.ground != Ground::Air {
                if distance <= REACH_M {
                    aim.settled = true;
                } else if aim.since >= SETTLES_S {
                    let near = distance - walker.config.body.half().max() <= packed_radius(&self.wanted, aim.place);
                    let late = aim.since >= GIVES_UP_S;
                    if near || late {
                        aim.behind = self.settled_one_before(n, aim.place);
                        aim.settled = near && late || aim.behind.is_some();
                    }
                }
            }
            aim.pushes = (aim.pushes || aim.since >= HELD_UP_S) && aim.free < HELD_UP_S;
        }
        aim.way = if aim.settled { Vector2::zeros() } else { walker.way(wish) };
        let (out, overlap) = self.escape(n);
        if overlap > 0.0 {
            // If the straight way out gains nothing, it goes sideways, alternating sides.
            aim.waits += self.tick_s;
            if overlap < 0.98 * aim.overlap || !aim.parts {
                (aim.overlap, aim.waits) = (overlap, 0.0);
            } else if aim.waits > PARTS_S {
                (aim.closed, aim.waits) = (!aim.closed, 0.0);
                aim.hand = if aim.closed { -aim.hand } else { aim.hand };
            }
            let far = walker.config.speed.max(PARTS_M_S) * self.tick_s;
            let out = if aim.closed { Vector2::new(-out.y, out.x) * aim.hand } else { out };
            aim.way = out * (far / out.norm().max(far));
        }
        aim.parts = overlap > 0.0;
        self.aims[n] = aim;
    }

    /// Returns the first neighbour of pawn `n` that has settled around `place` and stands close.
    fn settled_one_before(&self, n: usize, place: Point2<f64>) -> Option<usize> {
        let own = &self.outlines[n];
        self.neighbours(n).find(|m| {
            let aim = &self.aims[*m];
            aim.settled && key_of(aim.place) == key_of(place) && own.gap(&self.outlines[*m]).0 <= BEHIND_M
        })
    }
}

/// Reserves room for `count` items in all.
fn make_room<T>(list: &mut Vec<T>, count: usize) {
    list.reserve(count - list.len().min(count));
}
