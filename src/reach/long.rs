//! Long pawns, such as wheelchairs: places with headings, driving along them, and turning on the spot.
//!
//! A long pawn is a round one, a cylinder, drawn out to a `length` of at least its width: the row of discs whose middles
//! lie on a line of `length - width` through its place, the *middle line*. It stands at a place of a [`Region`] of the
//! round pawn in a heading if all squares between pixels that the line meets have places of the region at their corners,
//! linked in both directions. So the ground, the climb height, the grade, seen space and edits count under all of it.
//!
//! Headings are the directions to 16 neighbours. A pawn turned by 180° covers the same ground and drives backwards as
//! well as ahead, so states are places with one of 8 headings. From a state the pawn
//!
//! - drives by the direction of its heading, ahead or back, over all squares that its middle line crosses;
//! - turns on the spot to the next heading, over all squares that meet the two sectors which the line sweeps.
//!
//! The cost of driving is the length of the way, heights included as for [`Search`](super::Search); that of turning is
//! the arc that its ends travel. Links that lead one way, down a drop deeper than the pawn climbs, do not count.
//!
//! Walkers with the shape of the round pawn follow the middle, the front and the rear of each route, as for `Search`.
//!
//! Around most places all pixels are linked: there no mask is tested.
//!
//! # Memory
//!
//! One byte for each place of the region, and one more for what is reached; a route takes 64 bytes for each place, and
//! 12 for each state that waits.

use super::footprints::{ANGLES, DIRECTIONS, Footprints, HEADINGS, kind_of_turn};
use super::region::{NO_PLACE, Region};
use super::route::{
    BETWEEN_LOOKS, DIAGONAL, Follower, Going, KNIGHT, Leg, MOST_SEARCHES, STRAIGHT, UNREACHED, follow_heights,
    least_cost, walkers_at,
};
use super::standing::{PlaceId, StandingPlaces};
use super::{Needs, Route};
use crate::query::Answer;
use crate::store::Snapshot;
use crate::walk::Body;
use crate::{Error, Monitor, Parameter, Result};
use nalgebra::{Point2, Vector2};
use std::borrow::Borrow;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::ops::ControlFlow;

/// Longest middle line (pixels to each side).
const MOST_PIXELS: f64 = 512.0;
/// Lengths that differ by less count as equal (m).
const EQUAL_M: f64 = 1e-9;
/// State that does not exist.
const NO_STATE: u32 = u32::MAX;

/// Headings that a long pawn reaches at each place of a region.
#[derive(Debug, Clone)]
pub struct LongReached(Vec<u8>);

impl LongReached {
    /// Returns whether a place of the same region is reached, in any heading.
    pub fn holds(&self, region: &Region, spot: &PlaceId) -> bool {
        region.number(spot).is_some_and(|place| self.0[place as usize] != 0)
    }
}

impl Region {
    /// Leaves out the places that a long pawn does not reach. [`Storeys`](super::Storeys), [passages](Self::passages),
    /// leaks, the area, the lowest headroom and the highest step are then those of the places that are left; clearances
    /// stay those of the round pawn. `standing` are the standing places of the region.
    pub fn keep_reached(&mut self, standing: &StandingPlaces, reached: &LongReached) {
        self.standing.iter_mut().zip(&reached.0).for_each(|(standing, headings)| *standing &= *headings != 0);
        self.measure(standing);
    }
}

/// A move from one state to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Move {
    Ahead,
    Back,
    Left,
    Right,
}

/// Search for what a long pawn reaches, and for its routes, in a region of the round pawn.
///
/// ```
/// use nalgebra::Point3;
/// use slicewalk::NoMonitor;
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::query::Answer;
/// use slicewalk::reach::{Flood, LongSearch, Pawn, StandingPlaces};
/// use slicewalk::store::Snapshot;
/// use slicewalk::walk::Body;
///
/// let mut builder = PageBuilder::default();
/// for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
///     assert!(builder.set_column(px, py, &[Span::new(0, 10, false).unwrap()])); // a floor of 3.2 × 3.2 m
/// }
/// let key = PageKey { tx: 0, ty: 0, layer: 0 };
/// let store = Snapshot::from_pages(Frame::new(0.05, 0.15)?, [(key, builder.build())]);
///
/// let wheelchair = Pawn::new(Body::Cylinder { radius: 0.4, height: 1.4 });
/// let mut standing = StandingPlaces::new(&store, wheelchair)?;
/// let at = |x, y| Point3::new(x, y, 0.1);
/// let Answer::Known(Some(from)) = standing.spot(&store, at(1.0, 1.0))? else { panic!("it is all floor") };
/// let Answer::Known(Some(to)) = standing.spot(&store, at(2.0, 2.5))? else { panic!("it is all floor") };
/// let mut flood = Flood::from(from);
/// assert_eq!(flood.grow(&mut standing, &store, &NoMonitor)?, Answer::Known(()));
/// let region = flood.region(&standing);
///
/// let mut search = LongSearch::new(&region, 1.2)?;
/// assert!(search.reached(&[from], &NoMonitor)?.holds(&region, &to));
/// let Answer::Known(Some(route)) = search.route(&store, &from, &to, &NoMonitor)? else { panic!("nothing is in the way") };
/// assert_eq!(route.points.len(), route.headings.len());
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct LongSearch<R> {
    region: R,
    footprints: Footprints,
    /// Half the middle line (pixels).
    half: f64,
    /// Cost of a turn by each of the [`ANGLES`].
    turns: [u32; 2],
    /// For each place the number of pixels to each side within which all are linked, as far as it matters.
    open: Vec<u8>,
    /// Places under the last mask.
    under: Vec<u32>,
    /// Moves that walkers could not follow, and states, as moves to themselves.
    refused: HashSet<[u32; 2]>,
    costs: Vec<u32>,
    from: Vec<u32>,
    looked_at: usize,
    /// Way that walkers follow, kept while pages are missing.
    trial: Option<Trial>,
}

/// A way that walkers follow.
#[derive(Debug)]
struct Trial {
    ends: [u32; 2],
    /// The states, and the heading of each among 16.
    way: Vec<u32>,
    headings: Vec<usize>,
    /// Index of the state of the walkers, and the indices of those to go to, the next one last.
    at: usize,
    next: Vec<usize>,
    /// Two walkers each at the middle, the front and the rear; `None` until they stand there in the first state.
    walkers: Option<[Follower; 6]>,
    /// The same walkers, moving to the next state.
    going: Option<Going<6>>,
    searches: usize,
}

impl<R: Borrow<Region>> LongSearch<R> {
    /// Creates a search for a pawn with the shape of `region`'s, a cylinder, drawn out to `length` (m). Fails if it is no
    /// cylinder, or if the length is less than its width or more than 1024 pixels longer than that.
    ///
    /// Takes the time of a flood over the region.
    pub fn new(region: R, length: f64) -> Result<Self> {
        let own = region.borrow();
        let wrong = |reason: String| Error::parameter(Parameter::Pawn("length"), reason);
        let Body::Cylinder { radius, .. } = own.grid.pawn.body else {
            return Err(wrong("only a cylinder can be longer than wide".to_owned()));
        };
        let half = (length - 2.0 * radius) / 2.0 / own.grid.frame.pixel_m();
        let is_long = length >= 2.0 * radius - EQUAL_M && half <= MOST_PIXELS;
        if !is_long {
            let most = 2.0 * (radius + MOST_PIXELS * own.grid.frame.pixel_m());
            let reason = format!("{length} m is not allowed; expected {} (the width) to {most:.1} m", 2.0 * radius);
            return Err(wrong(reason));
        }
        let half = half.max(0.0);
        let end = f64::from(STRAIGHT) * length / 2.0 / own.grid.frame.pixel_m();
        let mut search = Self {
            footprints: Footprints::new(half),
            half,
            turns: ANGLES.map(|angle| (angle * end).round() as u32),
            open: Vec::new(),
            under: Vec::new(),
            refused: HashSet::new(),
            costs: Vec::new(),
            from: Vec::new(),
            looked_at: 0,
            trial: None,
            region,
        };
        search.open = search.opened();
        Ok(search)
    }

    /// Returns the region.
    pub fn region(&self) -> &Region {
        self.region.borrow()
    }

    /// Returns its memory without the region (bytes).
    pub fn memory_bytes(&self) -> usize {
        self.open.capacity() + 4 * (self.costs.capacity() + self.from.capacity()) + self.footprints.memory_bytes()
    }

    /// For each place the number of pixels to each side within which all are linked.
    fn opened(&self) -> Vec<u8> {
        let region = self.region.borrow();
        let most = self.footprints.extent().min(i32::from(u8::MAX)) as u8;
        let mut under = Vec::new();
        let mut around = |place: u32| self.footprints.around.follow(region, place, &mut under);
        let mut open: Vec<u8> = (0..region.len() as u32).map(|place| if around(place) { most } else { 0 }).collect();
        let mut edge: Vec<u32> = (0..region.len() as u32).filter(|place| open[*place as usize] == 0).collect();
        for number in 1..most {
            let mut next = Vec::new();
            let mut offer = |place: u32| {
                if place != NO_PLACE && open[place as usize] > number {
                    open[place as usize] = number;
                    next.push(place);
                }
            };
            for place in edge {
                for (way, &beside) in region.links[place as usize].iter().enumerate().filter(|link| *link.1 != NO_PLACE)
                {
                    offer(beside);
                    let links = region.links[beside as usize];
                    [1, 3].into_iter().for_each(|turn| offer(links[(way + turn) & 3]));
                }
            }
            edge = next;
        }
        open
    }

    /// Returns whether the pawn stands at a place in a heading.
    fn stands(&mut self, place: u32, heading: usize) -> bool {
        let mask = &self.footprints.stand[heading];
        let is_open = mask.extent <= i32::from(self.open[place as usize]);
        is_open || mask.follow(self.region.borrow(), place, &mut self.under)
    }

    /// Returns whether the pawn can stand at a place of the region, in any heading.
    pub fn stands_at(&mut self, spot: &PlaceId) -> bool {
        let place = self.region().number(spot);
        place.is_some_and(|place| (0..HEADINGS).any(|heading| self.stands(place, heading)))
    }

    /// Returns where a move from a state leads: a place and a heading.
    fn moved(&mut self, place: u32, heading: usize, by: Move) -> Option<(u32, usize)> {
        let region = self.region.borrow();
        let open = i32::from(self.open[place as usize]);
        let back = match by {
            Move::Left | Move::Right => {
                let first = if by == Move::Left { heading } else { (heading + HEADINGS - 1) % HEADINGS };
                let mask = &self.footprints.turn[first];
                let turns = mask.extent <= open || mask.follow(region, place, &mut self.under);
                let next = if by == Move::Left { (heading + 1) % HEADINGS } else { first };
                return turns.then_some((place, next));
            }
            by => usize::from(by == Move::Back),
        };
        let mask = &self.footprints.drive[heading][back];
        if mask.extent > open && !mask.follow(region, place, &mut self.under) {
            return None;
        }
        // Any path within the mask leads to the same place; the direction's squares are always part of it.
        let [x, y] = DIRECTIONS[heading].map(|by| if back == 1 { -by } else { by });
        let mut at = place;
        let mut go = |by: i32, axis: usize| {
            let way = if by < 0 { axis + 2 } else { axis };
            for _ in 0..by.abs() {
                at = region.links[at as usize][way];
            }
        };
        // The longer part first: so no square is left before its end.
        match x.abs() > y.abs() {
            true => (go(x.signum(), 0), go(y, 1), go(x - x.signum(), 0)),
            false => (go(y.signum(), 1), go(x, 0), go(y - y.signum(), 1)),
        };
        Some((at, heading))
    }

    /// Returns everything that the pawn reaches from `starts`, places of the region, in whatever headings it can have
    /// there. Fails only if `monitor` asks to stop. Visits up to eight states for each place.
    pub fn reached(&mut self, starts: &[PlaceId], monitor: &dyn Monitor) -> Result<LongReached> {
        let mut headings = vec![0u8; self.region().len()];
        let mut open = Vec::new();
        for place in starts.iter().filter_map(|start| self.region().number(start)).collect::<Vec<u32>>() {
            for heading in (0..HEADINGS).filter(|heading| self.stands(place, *heading)).collect::<Vec<usize>>() {
                headings[place as usize] |= 1 << heading;
                open.push((place, heading));
            }
        }
        let mut taken = 0usize;
        while let Some((place, heading)) = open.pop() {
            taken += 1;
            if taken.is_multiple_of(BETWEEN_LOOKS) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            for by in [Move::Ahead, Move::Back, Move::Left, Move::Right] {
                let is_known = |place: u32, heading: usize| headings[place as usize] >> heading & 1 == 1;
                let turned = match by {
                    Move::Left => is_known(place, (heading + 1) % HEADINGS),
                    Move::Right => is_known(place, (heading + HEADINGS - 1) % HEADINGS),
                    _ => false,
                };
                if turned {
                    continue;
                }
                if let Some((to, next)) = self.moved(place, heading, by)
                    && headings[to as usize] >> next & 1 == 0
                {
                    headings[to as usize] |= 1 << next;
                    open.push((to, next));
                }
            }
        }
        Ok(LongReached(headings))
    }
}

/// Routes.
impl<R: Borrow<Region>> LongSearch<R> {
    /// Returns the cheapest route between two places of the region, from any heading to any, that walkers have followed in
    /// `set` with the middle, the front and the rear of the pawn; `None` if no route connects them. Load pages that are
    /// missing, and call again with the same arguments. Fails only if `monitor` asks to stop.
    ///
    /// Of the two ways round in which a pawn can drive a route, its headings are those with which more of it leads ahead.
    pub fn route(
        &mut self,
        set: &Snapshot,
        from: &PlaceId,
        to: &PlaceId,
        monitor: &dyn Monitor,
    ) -> Result<Answer<Option<Route>>> {
        let (Some(first), Some(last)) = (self.region().number(from), self.region().number(to)) else {
            return Ok(Answer::Known(None));
        };
        let ends = [first, last];
        let mut trial = match self.trial.take().filter(|trial| trial.ends == ends) {
            Some(trial) => trial,
            None => {
                self.refused.clear();
                self.looked_at = 0;
                match self.trial(ends, 0, monitor)? {
                    Some(trial) => trial,
                    None => return Ok(Answer::Known(None)),
                }
            }
        };
        loop {
            match self.follow(set, &mut trial) {
                ControlFlow::Break(stop) => {
                    self.trial = Some(trial);
                    return stop.answer();
                }
                ControlFlow::Continue(refused) if refused.is_empty() => break,
                ControlFlow::Continue(refused) => self.refused.extend(refused),
            }
            let searches = trial.searches + 1;
            let next = if searches < MOST_SEARCHES { self.trial(ends, searches, monitor)? } else { None };
            match next {
                Some(next) => trial = next,
                None => return Ok(Answer::Known(None)),
            }
        }
        Ok(Answer::Known(Some(self.described(&trial))))
    }

    /// Returns the cost of a route (m): its length, and the arcs that the ends of the pawn travel in its turns.
    pub fn cost_m(&self, route: &Route) -> f64 {
        let turned: f64 = route.headings.windows(2).map(|pair| turn_deg(pair[0], pair[1]).abs().to_radians()).sum();
        let per_radian =
            f64::from(self.turns[0]) / ANGLES[0] / f64::from(STRAIGHT) * self.region().grid.frame.pixel_m();
        route.length_m + turned * per_radian
    }

    /// Searches the cheapest way without what was refused.
    fn trial(&mut self, ends: [u32; 2], searches: usize, monitor: &dyn Monitor) -> Result<Option<Trial>> {
        let Some(last) = self.run(ends, monitor)? else { return Ok(None) };
        let mut way = vec![last];
        while let Some(&before) = way.last().map(|state| &self.from[*state as usize]).filter(|from| **from != NO_STATE)
        {
            way.push(before);
        }
        way.reverse();
        let mut headings = vec![way[0] as usize % HEADINGS];
        for pair in way.windows(2) {
            let by = (pair[1] as usize + HEADINGS - pair[0] as usize % HEADINGS) % HEADINGS;
            let own = headings[headings.len() - 1];
            headings.push(match by {
                0 => own,
                1 => (own + 1) % (2 * HEADINGS),
                _ => (own + 2 * HEADINGS - 1) % (2 * HEADINGS),
            });
        }
        // Stretches of the same move: to the place beside, all drives in the same direction are one.
        let step = |at: usize| {
            let [a, b] = [way[at], way[at + 1]].map(|state| self.region().pixels[state as usize / HEADINGS]);
            (headings[at] == headings[at + 1]).then_some([b[0] - a[0], b[1] - a[1]])
        };
        let is_end = |at: &usize| *at + 1 == way.len() || step(*at).is_none() || step(*at) != step(*at - 1);
        let next = (1..way.len()).rev().filter(is_end).collect();
        Ok(Some(Trial { ends, headings, at: 0, next, walkers: None, going: None, searches, way }))
    }

    /// Returns the state in which the cheapest way ends.
    fn run(&mut self, [first, last]: [u32; 2], monitor: &dyn Monitor) -> Result<Option<u32>> {
        let count = HEADINGS * self.region().len();
        self.costs.clear();
        self.costs.resize(count, UNREACHED);
        self.from.resize(count, NO_STATE);
        let goal = self.region().pixels[last as usize];
        let mut heap = BinaryHeap::new();
        for heading in 0..HEADINGS {
            let state = first * HEADINGS as u32 + heading as u32;
            if self.stands(first, heading) && !self.refused.contains(&[state; 2]) {
                (self.costs[state as usize], self.from[state as usize]) = (0, NO_STATE);
                heap.push((Reverse(0), 0, state));
            }
        }
        while let Some((_, cost, state)) = heap.pop() {
            let (place, heading) = (state / HEADINGS as u32, state as usize % HEADINGS);
            if place == last {
                return Ok(Some(state));
            }
            if cost > self.costs[state as usize] {
                continue;
            }
            self.looked_at += 1;
            if self.looked_at.is_multiple_of(BETWEEN_LOOKS) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            for by in [Move::Ahead, Move::Back, Move::Left, Move::Right] {
                let Some((to, next)) = self.moved(place, heading, by) else { continue };
                let own = match by {
                    Move::Left => self.turns[kind_of_turn(heading)],
                    Move::Right => self.turns[kind_of_turn(next)],
                    _ => self.region().length(place, to, across(heading)),
                };
                let (cost, next) = (cost.saturating_add(own), to * HEADINGS as u32 + next as u32);
                if cost >= self.costs[next as usize]
                    || self.refused.contains(&[state, next])
                    || self.refused.contains(&[next; 2])
                {
                    continue;
                }
                (self.costs[next as usize], self.from[next as usize]) = (cost, state);
                let rest = least_cost(self.region().pixels[to as usize], goal);
                heap.push((Reverse(cost.saturating_add(rest)), cost, next));
            }
        }
        Ok(None)
    }

    /// Follows a way to its end with walkers. Returns the moves that they could not follow, both ways; none at the end.
    /// Nothing that was walked is walked again after a wait for pages.
    fn follow(&mut self, set: &Snapshot, trial: &mut Trial) -> Needs<Vec<[u32; 2]>> {
        if trial.walkers.is_none() {
            let first = trial.way[0];
            if trial.going.is_none() {
                trial.going = self.setting_out(first / HEADINGS as u32);
            }
            if !self.walk(set, trial, 0, 0)? {
                return ControlFlow::Continue(vec![[first; 2]]);
            }
            trial.walkers = trial.going.take().map(|going| going.walkers);
        }
        while let Some(&next) = trial.next.last() {
            if trial.going.is_none() {
                trial.going = trial.walkers.clone().map(Going::from);
            }
            let at = trial.at;
            let arrive = self.walk(set, trial, at, next)?;
            let going = trial.going.take();
            if arrive {
                trial.walkers = going.map(|going| going.walkers);
                (trial.at, _) = (next, trial.next.pop());
            } else if next - at > 1 {
                trial.next.push(at.midpoint(next));
            } else {
                let [a, b] = [trial.way[at], trial.way[next]];
                return ControlFlow::Continue(vec![[a, b], [b, a]]);
            }
        }
        ControlFlow::Continue(Vec::new())
    }

    /// Returns walkers at a place that are to go to the middle, the front and the rear of a pawn there.
    fn setting_out(&self, place: u32) -> Option<Going<6>> {
        let middle = walkers_at(self.region(), place).ok()?;
        let walker = |number: usize| {
            let own = middle[number % 2].clone();
            // `slicetool walk` moves the middle of a pawn: its grade counts.
            if number < 2 { own } else { own.on_any_grade() }
        };
        Some(Going::from(std::array::from_fn(walker)))
    }

    /// Moves walkers from their places in one state to those in another, and returns whether all got there. If pages are
    /// missing, call it again.
    fn walk(&mut self, set: &Snapshot, trial: &mut Trial, at: usize, next: usize) -> Needs<bool> {
        let place = trial.way[next] / HEADINGS as u32;
        let heading = trial.headings[next];
        // The heights under the ends: those of the nearest pixels.
        let mask = &self.footprints.stand[heading % HEADINGS];
        let region = self.region.borrow();
        if !mask.follow(region, place, &mut self.under) {
            return ControlFlow::Continue(false);
        }
        let (grid, middle) = (&region.grid, region.feet(place));
        let quantum = grid.frame.quantum_m();
        let (half, under, from) = (self.half, &self.under, trial.headings[at]);
        let leg = |number: usize, walker: &Follower| {
            let side = [0.0, 1.0, -1.0][number / 2];
            let pixels = ahead(heading) * (half * side);
            let nearest = mask.number([pixels.x, pixels.y].map(|by| by.round() as i32)).unwrap_or(0);
            let place = |heading: Vector2<f64>| middle.xy() + heading * (half * side * grid.frame.pixel_m());
            let line: Vec<Point2<f64>> = match from == heading || side == 0.0 {
                true => vec![place(ahead(heading))],
                false => arc(from, heading, half).map(place).collect(),
            };
            let off = if side == 0.0 { quantum } else { (f64::from(grid.up) + 1.0) * quantum };
            Leg::new(walker, line, region.feet(under[nearest]).z, off)
        };
        trial.going.as_mut().map_or(ControlFlow::Continue(false), |going| going.follow(set, leg))
    }

    /// Returns the route of a way.
    fn described(&self, trial: &Trial) -> Route {
        let region = self.region();
        let place = |at: usize| trial.way[at] / HEADINGS as u32;
        let (mut points, mut headings) = (vec![region.feet(place(0))], vec![trial.headings[0]]);
        let (mut profile, mut forwards) = (Vec::new(), 0.0);
        for at in 1..trial.way.len() {
            let (to, heading) = (region.feet(place(at)), trial.headings[at]);
            let by = (to - region.feet(place(at - 1))).xy();
            let next = (at + 1 < trial.way.len()).then(|| region.feet(place(at + 1)).xy() - to.xy());
            forwards += by.dot(&ahead(heading));
            let is_drive = heading == trial.headings[at - 1];
            profile.push(to);
            // The stretch continues.
            if is_drive && next.is_some_and(|next| trial.headings[at + 1] == heading && next.dot(&by) > 0.0) {
                continue;
            }
            if is_drive {
                follow_heights(region, &profile, to, &mut points);
            }
            points.push(to);
            headings.resize(points.len(), heading);
            profile.clear();
        }
        let flip = if forwards < 0.0 { HEADINGS } else { 0 };
        let degrees = |heading: usize| {
            let ahead = ahead((heading + flip) % (2 * HEADINGS));
            ahead.x.atan2(ahead.y).to_degrees().rem_euclid(360.0)
        };
        Route::along(points, headings.into_iter().map(degrees).collect())
    }
}

/// Returns the cost of driving by the direction of a heading on level ground.
fn across(heading: usize) -> u32 {
    match DIRECTIONS[heading].map(i32::abs) {
        [1, 1] => DIAGONAL,
        [0, 1] | [1, 0] => STRAIGHT,
        _ => KNIGHT,
    }
}

/// Returns the unit vector of a heading among 16.
fn ahead(heading: usize) -> Vector2<f64> {
    let [x, y] = DIRECTIONS[heading % HEADINGS].map(f64::from);
    let way = Vector2::new(x, y).normalize();
    if heading < HEADINGS { way } else { -way }
}

/// Returns unit vectors along the turn from a heading to a neighbouring one, so that points `radius` pixels off lie at
/// most a pixel apart.
fn arc(from: usize, to: usize, radius: f64) -> impl Iterator<Item = Vector2<f64>> {
    let (from, to) = (ahead(from), ahead(to));
    let angle = from.perp(&to).atan2(from.dot(&to));
    let steps = (angle.abs() * radius).ceil().max(1.0);
    (1..=steps as usize).map(move |n| if n as f64 == steps { to } else { rotated(from, angle * n as f64 / steps) })
}

fn rotated(way: Vector2<f64>, by: f64) -> Vector2<f64> {
    let (sin, cos) = by.sin_cos();
    Vector2::new(cos * way.x - sin * way.y, sin * way.x + cos * way.y)
}

/// Returns the turn from one heading to another, between -180 and 180 (degrees).
fn turn_deg(from: f64, to: f64) -> f64 {
    (to - from + 180.0).rem_euclid(360.0) - 180.0
}
