//! Many pawns in one world, which keep out of each other.
//!
//! Once per tick the pawns are sorted into a uniform grid; then one after the other, in the order of their numbers,
//! each shortens its way by what its neighbours leave of it, slides along the nearest one, passing on the right where
//! it meets it head on, and takes its tick in the world. Where the world led it into a neighbour, it stays where it
//! was; where it falls upon one, it stands on its head. The order makes the outcome the same on every machine.
//!
//! Of two that want the same way the one ahead goes first, and the other keeps a hand's breadth behind it: so no two jam in
//! a door. Pawns that stand inside each other part, all of them at once, whatever they want; who stands close around them
//! gives way.
//!
//! Not all can stand on one place. Those that want to the same one [settle](State::Arrived) around it: each stops when
//! it gets no nearer, stands behind one that has settled, and reaches into the disc that all of them fill, loosely
//! packed; so they settle from the middle out. Outside of the disc, or where walls leave less room, it walks around the
//! others for a while before it settles behind them. A pawn that has settled stays until it wants to go elsewhere, or
//! until the one behind which it settled goes: then it tries again.

mod outline;
mod settle;

use super::follow::REACH_M;
use super::{BLOCKED_BELOW, Ground, MOST_TICKS, Motion, State, Walker, Wish};
use crate::store::Missing;
use crate::store::PageSet;
use crate::{Error, Result};
use nalgebra::{Point2, Point3, Vector2};
use outline::{Outline, TOUCH_M};
use settle::{Aim, BEHIND_M, FREE_S, GIVES_UP_S, NEARER_M, PlaceKey, SETTLES_S, key_of, packed_radius};
use std::ops::ControlFlow;

/// Who comes second keeps so far behind who goes first (m).
const BEHIND_FIRST_M: f64 = 0.1;
/// Two that have both got no nearer to their places for so long (s) hold each other up.
const HELD_UP_S: f64 = 1.0;
/// So close (m) to one who flees it is pushed.
const PUSHED_M: f64 = 1e-3;
/// The golden section: its multiples fill a circle evenly.
const GOLDEN: f64 = 0.618_033_988_749_895;

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
    /// Time that was not used (s), because a step is at most [`MOST_TICKS`] long. Give it to the next step, or drop it.
    pub unspent: f64,
}

impl Crowd {
    /// A crowd of `walkers`, all with ticks of the same length; for 1,000 pawns 1/60 s is a good one. They may stand
    /// inside each other: then they part.
    pub fn new(walkers: Vec<Walker>) -> Result<Self> {
        let tick_s = walkers.first().map_or(1.0 / 60.0, |walker| walker.config.tick_s);
        let count = walkers.len();
        let mut crowd = Self {
            walkers: Vec::with_capacity(count),
            aims: Vec::with_capacity(count),
            wanted: Vec::with_capacity(count),
            tick_s,
            rest_s: 0.0,
            cell: 0.1,
            grid: Vec::with_capacity(count),
            before: Vec::with_capacity(count),
        };
        for walker in walkers {
            crowd.add(walker)?;
        }
        Ok(crowd)
    }

    /// The pawns.
    pub fn walkers(&self) -> &[Walker] {
        &self.walkers
    }

    /// Lets another pawn join, wherever it stands, and returns its number: that of pawns before. Its ticks must be as long
    /// as those of the others. Allocates memory, which no step does.
    pub fn add(&mut self, walker: Walker) -> Result<usize> {
        let config = &walker.config;
        if self.walkers.is_empty() {
            self.tick_s = config.tick_s;
        }
        if config.tick_s != self.tick_s {
            let ticks = format!(
                "all pawns need ticks of the same length (expected {} s, found {} s)",
                self.tick_s, config.tick_s
            );
            return Err(Error::parameter("crowd", ticks));
        }
        self.cell = self.cell.max(2.0 * config.body.half().max() + 2.0 * config.speed * config.tick_s + BEHIND_FIRST_M);
        self.before.push(walker.feet());
        self.aims.push(Aim::NONE);
        self.walkers.push(walker);
        // What steps fill.
        let count = self.walkers.len();
        self.wanted.reserve(count - self.wanted.len().min(count));
        self.grid.reserve(count - self.grid.len().min(count));
        Ok(count - 1)
    }

    /// Takes the pawn of this number out; `None` if there is none. Those after it move up by one number.
    pub fn remove(&mut self, number: usize) -> Option<Walker> {
        if number >= self.walkers.len() {
            return None;
        }
        self.aims.remove(number);
        self.before.remove(number);
        for aim in &mut self.aims {
            match aim.behind {
                Some(other) if other == number => (aim.settled, aim.behind) = (false, None),
                Some(other) if other > number => aim.behind = Some(other - 1),
                _ => {}
            }
        }
        Some(self.walkers.remove(number))
    }

    /// Lets `dt` (s, >= 0) pass; what is no such time is none. `wish` says for each tick where the pawn of a number, with
    /// its feet at a place, wants to go.
    ///
    /// At most [`MOST_TICKS`] pass; the rest comes back as [`unspent`](CrowdReport::unspent). Allocates nothing. Cost: that
    /// of each walker, and about 100 ns per neighbour.
    pub fn step<S: PageSet>(
        &mut self,
        set: &S,
        dt: f64,
        mut wish: impl FnMut(usize, Point3<f64>) -> Wish,
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
        let wanted = if self.aims[n].settled { Vector2::zeros() } else { self.walkers[n].way(wish) };
        self.aims[n].way = wanted;
        let (before, own) = (self.walkers[n].motion, self.outline(n));
        let flees = self.way_out(n, &own);
        self.aims[n].flees = flees.unwrap_or_else(Vector2::zeros);
        let way = match flees.or_else(|| self.step_back(n, &own, wanted)) {
            Some(out) => self.slide(n, &own, out),
            None => self.leave_room(n, &own, wanted),
        };
        let mut outcome = self.advance(set, n, way);
        if self.enters_another(n, &own) {
            // Along a wall into somebody: it stays, and only falls.
            self.walkers[n].motion = before;
            outcome = self.advance(set, n, Vector2::zeros());
            if self.enters_another(n, &own) {
                self.walkers[n].motion = before;
            }
        }
        if let ControlFlow::Break(missing) = outcome {
            report.waits += 1;
            report.missing = Some(missing);
        }
        let walker = &mut self.walkers[n];
        walker.note_progress(wanted, before.feet.xy());
        let moved = (walker.motion.feet - before.feet).xy().norm();
        let aim = &mut self.aims[n];
        if aim.aside && way.norm() > TOUCH_M && moved < 0.1 * way.norm() {
            // A wall on that side.
            aim.hand = -aim.hand;
        }
        walker.state = match walker.motion.ground {
            Ground::Air => State::Falling,
            _ if self.aims[n].settled => State::Arrived,
            _ if moved < BLOCKED_BELOW * wanted.norm() || walker.progress.is_stuck() => State::Blocked,
            _ => State::Walking,
        };
    }

    /// A tick of pawn `n` in the world; it lands on whom it falls upon.
    fn advance<S: PageSet>(&mut self, set: &S, n: usize, way: Vector2<f64>) -> ControlFlow<Missing> {
        let before = self.walkers[n].motion.feet.z;
        let outcome = self.walkers[n].tick(set, way);
        let own = self.outline(n);
        if own.low < before {
            let fallen_upon = |other: &Outline| {
                let passed = other.high <= before && other.high > own.low;
                passed && own.gap_across(other).0 < -TOUCH_M
            };
            let heads = self.neighbours(n).map(|other| self.outline(other)).filter(fallen_upon);
            let head = heads.map(|other| other.high).fold(f64::NEG_INFINITY, f64::max);
            if head > own.low {
                let motion = &mut self.walkers[n].motion;
                *motion = Motion { falling: 0.0, ground: Ground::Obstacle, ..*motion };
                motion.feet.z = head;
            }
        }
        outcome.map_continue(|_| ())
    }

    /// Whether pawn `n`, which was at `own`, is now in one that it was not in.
    fn enters_another(&self, n: usize, own: &Outline) -> bool {
        let now = self.outline(n);
        let enters = |other: usize| {
            let other = self.outline(other);
            now.is_inside(&other) && !own.is_inside(&other)
        };
        let moved = (now.center - own.center).norm();
        let config = &self.walkers[n].config;
        if moved <= config.speed * self.tick_s {
            self.neighbours(n).any(enters)
        } else {
            // Pushed out of matter, farther than the grid of neighbours allows for.
            (0..self.walkers.len()).any(|other| other != n && enters(other))
        }
    }

    /// Whether pawn `n` has come as near to its place as it will.
    fn aim(&mut self, n: usize, wish: Wish) {
        let Wish::Toward(place) = wish else {
            self.aims[n] = Aim::NONE;
            return;
        };
        let mut aim = self.aims[n];
        if key_of(aim.place) != key_of(place) {
            aim = Aim { place, way: aim.way, ..Aim::NONE };
        }
        let walker = &self.walkers[n];
        let distance = (walker.feet().xy() - place).norm();
        if aim.behind.is_some_and(|other| self.outline(n).gap(&self.outline(other)).0 > 2.0 * BEHIND_M) {
            (aim.settled, aim.behind, aim.nearest, aim.since) = (false, None, distance, 0.0);
        }
        if distance < aim.nearest - NEARER_M {
            (aim.nearest, aim.since) = (distance, 0.0);
        } else {
            aim.since += self.tick_s;
        }
        let late = aim.since >= GIVES_UP_S;
        if aim.settled || walker.motion.ground == Ground::Air {
            // Stays settled; or is not there yet.
        } else if distance <= REACH_M {
            aim.settled = true;
        } else if aim.since >= SETTLES_S {
            let near = distance - walker.config.body.half().max() <= packed_radius(&self.wanted, place);
            if near || late {
                let settled = |m: usize| self.aims[m].settled && key_of(self.aims[m].place) == key_of(place);
                let ahead =
                    |m: usize| (self.walkers[m].feet() - walker.feet()).xy().dot(&(place - walker.feet().xy())) > 0.0;
                aim.behind = self.nearest_at(n, settled);
                aim.settled = aim.behind.is_some() || near && late;
                if aim.settled && aim.behind.is_none() {
                    aim.behind = self.nearest_at(n, ahead);
                }
            }
        }
        self.aims[n] = aim;
    }

    /// The nearest of those `who` stand close to pawn `n`.
    fn nearest_at(&self, n: usize, who: impl Fn(usize) -> bool) -> Option<usize> {
        let own = self.outline(n);
        let near = self.neighbours(n).filter(|m| who(*m)).map(|m| (own.gap(&self.outline(m)).0, m));
        let nearest = near.filter(|(gap, _)| *gap <= BEHIND_M).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.map(|(_, m)| m)
    }

    fn outline(&self, n: usize) -> Outline {
        Outline::of(&self.walkers[n])
    }

    /// The way of pawn `n` out of those that it stands in, if any, from the deepest most; or from those who flee towards it.
    fn way_out(&self, n: usize, own: &Outline) -> Option<Vector2<f64>> {
        let (mut flees, mut out) = (false, Vector2::zeros());
        for m in self.neighbours(n) {
            let other = self.outline(m);
            let (gap, normal) = own.gap(&other);
            let pushed = self.aims[m].flees.dot(&normal);
            if gap < -TOUCH_M {
                out += if own.center == other.center { direction(n) } else { normal } * -gap;
                flees = true;
            } else if gap < PUSHED_M && pushed > 0.0 {
                out += normal * pushed;
                flees = true;
            }
        }
        let far = self.walkers[n].config.speed * self.tick_s;
        flees.then(|| out * (far / out.norm().max(far)))
    }

    /// Whether pawn `m` goes before pawn `n`: both want the same way, and it is ahead; or both want to the same place, or
    /// hold each other up, and it is nearer to its place.
    fn goes_first(&self, m: usize, n: usize) -> bool {
        let (first, second) = (&self.aims[m], &self.aims[n]);
        let [there, here] = [m, n].map(|n| self.walkers[n].feet().xy());
        if first.settled || second.settled || first.way == Vector2::zeros() {
            return false;
        }
        let same_place = key_of(first.place) == key_of(second.place) && first.place.x.is_finite();
        let gain = if same_place || first.since.min(second.since) > HELD_UP_S {
            (here - second.place).norm() - (there - first.place).norm()
        } else if first.way.dot(&second.way) > 0.0 {
            (there - here).dot(&(first.way + second.way))
        } else {
            return false;
        };
        gain > 0.0 || gain == 0.0 && m < n
    }

    /// The way of pawn `n`, which wants `wanted`, out of the way of those who go first, if it is too near to them: away from
    /// them and back where it came from.
    fn step_back(&self, n: usize, own: &Outline, wanted: Vector2<f64>) -> Option<Vector2<f64>> {
        let far = wanted.norm();
        let too_near = |m: &usize| own.gap(&self.outline(*m)).0 < BEHIND_FIRST_M / 2.0 && self.goes_first(*m, n);
        let mut others = self.neighbours(n).filter(|_| far > 0.0).filter(too_near).peekable();
        others.peek()?;
        let back = others.map(|m| own.gap(&self.outline(m)).1).sum::<Vector2<f64>>() - wanted / far;
        Some(back * (0.5 * far / back.norm().max(1.0)))
    }

    /// The first contact of pawn `n` at `at` on its way with its neighbours, each wider by what `room` says (m) or left out:
    /// after which share of the way, the way from it, and with whom.
    fn first_contact(
        &self,
        n: usize,
        at: &Outline,
        way: Vector2<f64>,
        room: impl Fn(usize) -> Option<f64>,
    ) -> Option<(f64, Vector2<f64>, usize)> {
        let contacts = self.neighbours(n).filter_map(|m| {
            let (share, normal) = at.meets(&self.outline(m).grown(room(m)?), way)?;
            Some((share, normal, m))
        });
        contacts.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// What the neighbours leave of a way along which pawn `n` flees; those that it is in leave all of it.
    fn slide(&self, n: usize, own: &Outline, way: Vector2<f64>) -> Vector2<f64> {
        let (mut at, mut gone, mut rest) = (*own, Vector2::zeros(), way);
        for _ in 0..3 {
            let room = |m: usize| (!own.is_inside(&self.outline(m))).then_some(0.0);
            let Some((share, normal, _)) = self.first_contact(n, &at, rest, room) else {
                return gone + rest;
            };
            gone += rest * share;
            at.center += rest * share;
            rest *= 1.0 - share;
            rest -= normal * rest.dot(&normal).min(0.0);
        }
        gone
    }

    /// What the neighbours leave of the way of pawn `n`: it slides along them, and around them where it meets them head on.
    fn leave_room(&mut self, n: usize, own: &Outline, wanted: Vector2<f64>) -> Vector2<f64> {
        let Aim { mut hand, mut aside, mut free, .. } = self.aims[n];
        let (mut at, mut gone, mut rest) = (*own, Vector2::zeros(), wanted);
        free += self.tick_s;
        for _ in 0..3 {
            let room = |m: usize| if self.goes_first(m, n) { BEHIND_FIRST_M } else { 0.0 };
            let Some((share, normal, other)) = self.first_contact(n, &at, rest, |m| Some(room(m))) else {
                gone += rest;
                break;
            };
            free = 0.0;
            gone += rest * share;
            at.center += rest * share;
            let left = rest * (1.0 - share);
            rest = left - normal * left.dot(&normal).min(0.0);
            // Head on: to the right, both of them; and around all who stand in the way on the same side, even back.
            let along = Vector2::new(-normal.y, normal.x) * hand;
            let least = 0.25 * left.norm();
            let head_on = rest.norm() < least;
            aside |= head_on;
            let stands = self.aims[other].way == Vector2::zeros();
            if head_on || aside && stands && rest.dot(&along) < least {
                rest = along * (2.0 * least);
            }
        }
        if free > FREE_S {
            hand = 1.0;
        } else if aside && gone.norm() < 0.02 * wanted.norm() {
            // Closed: it tries the other side, and keeps to that.
            hand = -hand;
        }
        let aim = &mut self.aims[n];
        (aim.hand, aim.aside, aim.free) = (hand, aside && free == 0.0, free);
        gone
    }
}

/// Where pawn `n` flees from others on its very spot: each into a direction of its own.
fn direction(n: usize) -> Vector2<f64> {
    // Around a square, for angles are not the same on every machine.
    let way = (n as f64 * GOLDEN).fract() * 4.0;
    let along = 2.0 * way.fract() - 1.0;
    let ways = [[1.0, along], [-along, 1.0], [-1.0, -along], [along, -1.0]];
    Vector2::from(ways[way as usize % 4]).normalize()
}
