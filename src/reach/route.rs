//! Shortest routes between two places of a region.
//!
//! A\* over steps to 16 neighbours (the eight, and knight's moves) finds a path at most 2.8 % longer than any through
//! the same cells; then each stretch is straightened if that does not make it longer. A straight stretch crosses
//! squares between four pixel centres, and all four must be places linked with each other: the footprint of a body
//! anywhere inside such a square is covered by the union of the footprints at its corners.
//!
//! Lengths include heights, averaged over [`LEVEL_M`]: stairs count as ramps, and roughness not at all, but a route
//! around a ridge may be shorter than one over it.
//!
//! Then a [`Walker`] with the limits of the pawn follows the path, once with its default ticks and once with ticks of
//! 1/60 s, the longest that programs commonly use. A stretch that it cannot follow is divided; a single step that it cannot take is excluded, and
//! the search starts again. So every route can be walked, however steps over pixels differ from the motion of a body in
//! between.
//!
//! A [prepared](Region::prepare) region guides the search around walls and up stairs; the cost of preparing is shared
//! by many routes.
//!
//! Steps next to the end of the region cost 2 % more and bridges 4 %, so that the path keeps a pixel away from walls
//! and does not follow gaps.

use super::region::{NO_PLACE, Region};
use super::standing::PlaceId;
use super::{Needs, Stop};
use crate::query::Answer;
use crate::store::Snapshot;
use crate::walk::{Config, Grade, PendingStep, State, Walker, Waypoints};
use crate::{Error, Monitor, Result};
use nalgebra::{Point2, Point3};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::ops::ControlFlow;

/// Costs of steps of lengths 1, √2 and √5 pixels, rounded down.
pub(super) const STRAIGHT: u32 = 1000;
pub(super) const DIAGONAL: u32 = 1414;
pub(super) const KNIGHT: u32 = 2236;
/// Places expanded between two checks of the monitor.
pub(super) const BETWEEN_LOOKS: usize = 1 << 12;
/// Number of places from which a prepared region stores the costs of routes.
pub(super) const LANDMARKS: usize = 8;
/// Cost of a place that cannot be reached.
pub(super) const UNREACHED: u32 = u32::MAX;
/// Edge of the square over which heights are averaged, approximately (m), and most pixels to each side: enough for pixels
/// of 1.5 mm.
const LEVEL_M: f64 = 0.6;
const MOST_LEVELLED: i32 = 200;
/// Most searches for one route, each without the steps that the walker could not take before.
pub(super) const MOST_SEARCHES: usize = 1 << 7;
/// A walker fails if it takes longer than `PATIENCE` times the time of the path plus `PATIENCE_S` (s).
const PATIENCE: f64 = 2.0;
const PATIENCE_S: f64 = 1.0;
/// Long tick with which a route is followed as well (s).
const LONG_TICK_S: f64 = 1.0 / 60.0;
/// Share of the run by which a way must stay below the steepest grade: a walker with other frames stands at other places.
const GRADE_MARGIN: f64 = 0.003;
/// Distance from a place within which the walker has reached it (m).
const THERE_M: f64 = 1e-6;

/// Reason why there is no route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// The pawn cannot stand at the start.
    NotStandingFrom,
    /// The pawn cannot stand at the end.
    NotStandingTo,
    /// No route connects the two.
    NotConnected,
}

impl Refusal {
    /// Returns the name that `slicetool route` writes.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotStandingFrom => "not_standing_from",
            Self::NotStandingTo => "not_standing_to",
            Self::NotConnected => "not_connected",
        }
    }
}

/// A route that a walker has followed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Route {
    /// Places to reach in order, both ends included (m). The route is straight between them, except for the heights of
    /// steps.
    pub points: Vec<Point3<f64>>,
    /// Length of the lines between the points, heights included (m).
    pub length_m: f64,
    /// Heading of a [long pawn](super::LongSearch) at each point (degrees clockwise from +y, from 0 to 360); empty for
    /// other pawns.
    pub headings: Vec<f64>,
}

impl Route {
    /// Returns the route along `points`.
    pub(super) fn along(points: Vec<Point3<f64>>, headings: Vec<f64>) -> Self {
        // The sum of no lengths is -0.
        let length_m = 0.0 + points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>();
        Self { points, length_m, headings }
    }
}

/// Search for routes; reuses its memory from one to the next.
#[derive(Debug, Default)]
pub struct Search {
    /// For each place the least known cost, the place before it, and the search that set them.
    costs: Vec<u32>,
    from: Vec<u32>,
    search_of: Vec<u32>,
    search: u32,
    heap: BinaryHeap<(Reverse<u32>, u32, u32)>,
    looked_at: usize,
    goal: Goal,
    /// Steps that a walker could not take.
    refused: HashSet<(u32, u32)>,
    /// The place where walkers stopped on the shortest path.
    stop: Option<u32>,
    /// Path that a walker follows, kept while pages are missing.
    trial: Option<Trial>,
}

/// A walker that keeps the limits of its pawn, and the grade of its way.
#[derive(Debug, Clone)]
pub(super) struct Follower {
    walker: Walker,
    grade: Grade,
}

impl Follower {
    /// Lets it walk however steep its way is.
    pub(super) fn on_any_grade(mut self) -> Self {
        self.grade = Grade::new(f64::INFINITY, self.walker.feet());
        self
    }
}

/// Followers with short and with long ticks.
pub(super) type Walkers = [Follower; 2];

/// A path that walkers follow.
#[derive(Debug)]
struct Trial {
    ends: [u32; 2],
    places: usize,
    way: Vec<u32>,
    /// Indices in `way`: the place of the walkers, and the places to go to, the next one last.
    at: usize,
    next: Vec<usize>,
    walkers: Walkers,
    /// The same walkers, moving to the next place.
    going: Option<Going<2>>,
    /// The rest of the path, once a step of it was refused.
    rest: Option<Rest>,
    points: Vec<Point3<f64>>,
    searches: usize,
}

/// The steps of a path from a refused one on, each tested by itself to save searches.
#[derive(Debug)]
struct Rest {
    refused: Vec<(u32, u32)>,
    /// Index in the path of the place where the next step begins, and walkers that have come there.
    at: usize,
    going: Option<Going<2>>,
}

/// Goal of a search.
#[derive(Debug, Clone, Copy, Default)]
struct Goal {
    /// `None` to reach all places.
    place: Option<u32>,
    pixel: [i32; 2],
    /// Cost to get there from each landmark.
    from_landmarks: [u32; LANDMARKS],
}

impl Goal {
    fn of(region: &Region, place: u32) -> Self {
        let from_landmarks = region.landmarks.get(place as usize).copied().unwrap_or([0; LANDMARKS]);
        Self { place: Some(place), pixel: region.pixels[place as usize], from_landmarks }
    }

    /// Returns a lower bound of the cost from `place` to the goal; [`UNREACHED`] if no path leads there.
    #[inline]
    fn least_cost(&self, region: &Region, place: u32) -> u32 {
        if self.place.is_none() {
            return 0;
        }
        let mut least = least_cost(region.pixels[place as usize], self.pixel);
        // A path from a landmark over this place to the goal costs at least as much as the cheapest one to the goal.
        for (&own, &to) in
            region.landmarks.get(place as usize).iter().flat_map(|own| own.iter().zip(&self.from_landmarks))
        {
            if own != UNREACHED {
                if to == UNREACHED {
                    return UNREACHED;
                }
                least = least.max(to.saturating_sub(own));
            }
        }
        least
    }
}

impl Search {
    /// Creates a search; it allocates memory when it is first used.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the number of places that the last search expanded.
    pub fn looked_at(&self) -> usize {
        self.looked_at
    }

    /// Returns the place where walkers stopped on the shortest path of the last search, if they did.
    pub(super) fn stopped_at(&self) -> Option<u32> {
        self.stop
    }

    /// Returns its memory (bytes).
    pub fn memory_bytes(&self) -> usize {
        (self.costs.capacity() + self.from.capacity() + self.search_of.capacity()) * size_of::<u32>()
            + self.heap.capacity() * size_of::<(Reverse<u32>, u32, u32)>()
    }

    /// Returns a route between two places of `region` that is at most 5 % longer than the shortest one and that a
    /// [`Walker`] has followed in `set`; `None` if there is no route. Load pages that are missing, and call again with
    /// the same arguments. Fails only if `monitor` asks to stop.
    pub fn route(
        &mut self,
        set: &Snapshot,
        region: &Region,
        from: &PlaceId,
        to: &PlaceId,
        monitor: &dyn Monitor,
    ) -> Result<Answer<Option<Route>>> {
        match (region.number(from), region.number(to)) {
            (Some(first), Some(last)) => self.between(set, region, [first, last], monitor),
            _ => Ok(Answer::Known(None)),
        }
    }

    /// Returns a route between two numbered places, like [`route`](Self::route).
    pub(super) fn between(
        &mut self,
        set: &Snapshot,
        region: &Region,
        ends: [u32; 2],
        monitor: &dyn Monitor,
    ) -> Result<Answer<Option<Route>>> {
        let kept = self.trial.take().filter(|trial| trial.ends == ends && trial.places == region.len());
        let mut searches = 0;
        let mut trial = match kept {
            Some(trial) => trial,
            None => {
                self.refused.clear();
                self.stop = None;
                match self.trial(region, ends, searches, monitor)? {
                    Some(trial) => trial,
                    None => return Ok(Answer::Known(None)),
                }
            }
        };
        loop {
            match trial.follow(set, region) {
                ControlFlow::Break(stop) => {
                    self.trial = Some(trial);
                    return stop.answer();
                }
                ControlFlow::Continue(Ok(route)) => return Ok(Answer::Known(Some(route))),
                ControlFlow::Continue(Err(steps)) => {
                    self.stop = self.stop.or(steps.first().map(|step| step.0));
                    self.refused.extend(steps);
                    searches = trial.searches + 1;
                    let next = match searches < MOST_SEARCHES {
                        true => self.trial(region, ends, searches, monitor)?,
                        false => None,
                    };
                    match next {
                        Some(next) => trial = next,
                        None => return Ok(Answer::Known(None)),
                    }
                }
            }
        }
    }

    /// Searches the shortest path without the refused steps, and puts a walker at its start.
    fn trial(
        &mut self,
        region: &Region,
        [first, last]: [u32; 2],
        searches: usize,
        monitor: &dyn Monitor,
    ) -> Result<Option<Trial>> {
        if !self.run(region, first, Some(last), monitor)? {
            return Ok(None);
        }
        let mut way = vec![last];
        while let Some(&place) = way.last().filter(|place| **place != first) {
            way.push(self.from[place as usize]);
        }
        way.reverse();
        let next = straightened(region, &way);
        let walkers = walkers_at(region, first)?;
        let ends = [first, last];
        Ok(Some(Trial {
            ends,
            places: region.len(),
            way,
            at: 0,
            next,
            walkers,
            going: None,
            rest: None,
            points: vec![region.feet(first)],
            searches,
        }))
    }

    fn run(&mut self, region: &Region, first: u32, last: Option<u32>, monitor: &dyn Monitor) -> Result<bool> {
        if self.costs.len() < region.len() || self.search == u32::MAX {
            *self = Self {
                costs: vec![0; region.len()],
                from: vec![NO_PLACE; region.len()],
                search_of: vec![0; region.len()],
                ..Self::default()
            };
        }
        self.search += 1;
        self.heap.clear();
        self.looked_at = 0;
        self.goal = last.map_or_else(Goal::default, |last| Goal::of(region, last));
        self.offer(region, first, NO_PLACE, 0);
        while let Some((Reverse(estimate), cost, place)) = self.heap.pop() {
            if Some(place) == last {
                return Ok(true);
            }
            if cost > self.costs[place as usize] {
                continue;
            }
            debug_assert!(estimate >= cost);
            self.looked_at += 1;
            if self.looked_at.is_multiple_of(BETWEEN_LOOKS) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            self.expand(region, place, cost);
        }
        Ok(false)
    }

    #[inline]
    fn offer(&mut self, region: &Region, place: u32, from: u32, cost: u32) {
        let at = place as usize;
        if self.search_of[at] == self.search && self.costs[at] <= cost {
            return;
        }
        if !self.refused.is_empty() && self.refused.contains(&(from, place)) {
            return;
        }
        (self.search_of[at], self.costs[at], self.from[at]) = (self.search, cost, from);
        let rest = self.goal.least_cost(region, place);
        if rest != UNREACHED {
            // Of equal estimates the one nearest to the goal comes first.
            self.heap.push((Reverse(cost.saturating_add(rest)), cost, place));
        }
    }

    /// Offers the 16 neighbours of a place by quadrants: between two directions along the axes lie a diagonal and two
    /// knight's moves.
    fn expand(&mut self, region: &Region, place: u32, cost: u32) {
        let links = region.links[place as usize];
        let weigh = |to: u32, length: u32| {
            let length = region.length(place, to, length);
            let weight = if !region.standing[to as usize] {
                length + length / 25
            } else if region.is_beside_end(to) {
                length + length / 50
            } else {
                length
            };
            cost.saturating_add(weight)
        };
        let climbs = |to: u32| region.grid.is_stride(region.tops[to as usize] - region.tops[place as usize]);
        for way in 0..4 {
            let (a, b) = (links[way], links[(way + 1) & 3]);
            if a == NO_PLACE {
                continue;
            }
            self.offer(region, a, place, weigh(a, STRAIGHT));
            if b == NO_PLACE {
                continue;
            }
            let side = (way + 1) & 3;
            let corner = region.links[a as usize][side];
            if corner == NO_PLACE || region.links[b as usize][way] != corner || !climbs(corner) {
                continue;
            }
            self.offer(region, corner, place, weigh(corner, DIAGONAL));
            for (ahead, along, across) in [(a, way, side), (b, side, way)] {
                let beyond = region.links[ahead as usize][along];
                let knight = region.links[corner as usize][along];
                if beyond != NO_PLACE
                    && knight != NO_PLACE
                    && region.links[beyond as usize][across] == knight
                    && climbs(knight)
                {
                    self.offer(region, knight, place, weigh(knight, KNIGHT));
                }
            }
        }
    }
}

/// Returns the cost of the shortest path of the sixteen steps on open ground, a lower bound.
#[inline]
pub(super) fn least_cost(from: [i32; 2], to: [i32; 2]) -> u32 {
    let [x, y] = [0, 1].map(|axis| from[axis].abs_diff(to[axis]));
    let (long, short) = (x.max(y), x.min(y));
    if 2 * short <= long {
        (long - 2 * short).saturating_mul(STRAIGHT).saturating_add(short.saturating_mul(KNIGHT))
    } else {
        (long - short).saturating_mul(KNIGHT).saturating_add((2 * short - long).saturating_mul(DIAGONAL))
    }
}

impl Region {
    /// Prepares for many routes: stores the costs of the routes from eight distant places to all places, which show a
    /// [`Search`] where not to look (landmarks, after Goldberg and Harrelson, "Computing the shortest path", 2005).
    /// Routes keep the same search cost.
    ///
    /// Takes the time of nine searches that expand every place, and 32 bytes for each place. Fails only if `monitor`
    /// asks to stop; the region is then not prepared.
    pub fn prepare(&mut self, monitor: &dyn Monitor) -> Result<()> {
        self.landmarks = Vec::new();
        let Some(first) = self.in_largest_part() else { return Ok(()) };
        let mut search = Search::new();
        let mut landmarks = vec![[UNREACHED; LANDMARKS]; self.len()];
        let mut nearest = vec![UNREACHED; self.len()];
        let mut next = first;
        // The first search only finds a distant place.
        for number in 0..=LANDMARKS {
            search.run(self, next, None, monitor)?;
            let mut farthest = (0, next);
            for (place, own) in nearest.iter_mut().enumerate() {
                if search.search_of[place] != search.search {
                    continue;
                }
                let cost = search.costs[place];
                if let Some(column) = number.checked_sub(1) {
                    landmarks[place][column] = cost;
                    *own = cost.min(*own);
                }
                let far = if number == 0 { cost } else { *own };
                if far > farthest.0 {
                    farthest = (far, place as u32);
                }
            }
            next = farthest.1;
        }
        self.landmarks = landmarks;
        Ok(())
    }

    /// Returns a place of the largest linked part.
    fn in_largest_part(&self) -> Option<u32> {
        let mut seen = vec![false; self.len()];
        let mut largest = None;
        for first in 0..self.len() as u32 {
            if std::mem::replace(&mut seen[first as usize], true) {
                continue;
            }
            let (mut part, mut next) = (vec![first], 0);
            while next < part.len() {
                for &link in self.links[part[next] as usize].iter().filter(|link| **link != NO_PLACE) {
                    if !std::mem::replace(&mut seen[link as usize], true) {
                        part.push(link);
                    }
                }
                next += 1;
            }
            if largest.is_none_or(|(size, _)| part.len() > size) {
                largest = Some((part.len(), first));
            }
        }
        largest.map(|(_, first)| first)
    }

    /// Returns the cost of a step, given the cost `across` of its length on the ground plan.
    #[inline]
    pub(super) fn length(&self, from: u32, to: u32, across: u32) -> u32 {
        let rise = self.levels[to as usize] - self.levels[from as usize];
        if rise == 0 {
            return across;
        }
        let up = f64::from(rise) * self.grid.frame.quantum_m() / self.grid.frame.pixel_m() * f64::from(STRAIGHT);
        f64::from(across).hypot(up) as u32
    }

    /// Returns the cost of the straight line between two places, if a body can walk it.
    fn straight(&self, a: u32, b: u32) -> Option<u32> {
        let [from, to] = [a, b].map(|place| self.pixels[place as usize].map(f64::from));
        let way = [to[0] - from[0], to[1] - from[1]];
        let squared = way[0] * way[0] + way[1] * way[1];
        let across = squared.sqrt() * f64::from(STRAIGHT);
        let (mut sum, mut last, mut share) = (0, a, 0.0);
        let is_straight = self.is_straight(a, b, |place| {
            let [i, j] = self.pixels[place as usize].map(f64::from);
            let own = ((i - from[0]) * way[0] + (j - from[1]) * way[1]) / squared;
            sum += self.length(last, place, ((own - share).abs() * across) as u32);
            (last, share) = (place, own);
        });
        is_straight.then_some(sum)
    }

    /// Returns the heights, averaged over the places around each one.
    pub(super) fn levelled(&self) -> Vec<i32> {
        let far = ((LEVEL_M / 2.0 / self.grid.frame.pixel_m()) as i32).min(MOST_LEVELLED);
        let mut levels = self.tops.clone();
        for axis in [0, 1] {
            let mean = |place: u32| {
                let (mut sum, mut count) = (i64::from(levels[place as usize]), 1);
                for way in [axis, axis + 2] {
                    let mut at = place;
                    for _ in 0..far {
                        at = self.links[at as usize][way];
                        if at == NO_PLACE {
                            break;
                        }
                        (sum, count) = (sum + i64::from(levels[at as usize]), count + 1);
                    }
                }
                (sum / count) as i32
            };
            levels = (0..self.len() as u32).map(mean).collect();
        }
        levels
    }

    /// Returns whether a body can walk straight from place `a` to place `b`; calls `each` with the places near the
    /// line, in order.
    fn is_straight(&self, a: u32, b: u32, mut each: impl FnMut(u32)) -> bool {
        let (from, to) = (self.pixels[a as usize], self.pixels[b as usize]);
        let [dx, dy] = [0, 1].map(|axis| i64::from(to[axis]) - i64::from(from[axis]));
        let (x, y) = (if dx < 0 { 2 } else { 0 }, if dy < 0 { 3 } else { 1 });
        let (dx, dy) = (dx.abs(), dy.abs());
        let link = |place: u32, way: usize| {
            let next = self.links[place as usize][way];
            (next != NO_PLACE).then_some(next)
        };
        if dx == 0 || dy == 0 {
            let mut at = a;
            for _ in 0..dx + dy {
                let Some(next) = link(at, if dx == 0 { y } else { x }) else { return false };
                at = next;
                each(at);
            }
            return at == b;
        }
        let climbs = |a: u32, b: u32| self.grid.is_stride(self.tops[b as usize] - self.tops[a as usize]);
        // The corners of a square: the nearest one, those beside it along x and along y, and the opposite one.
        let square = |near: u32, beside_x: Option<u32>, beside_y: Option<u32>| {
            let beside_x = beside_x.or_else(|| link(near, x))?;
            let beside_y = beside_y.or_else(|| link(near, y))?;
            let far = link(beside_x, y)?;
            (link(beside_y, x)? == far && climbs(near, far) && climbs(beside_x, beside_y) && climbs(beside_y, beside_x))
                .then_some([near, beside_x, beside_y, far])
        };
        let (mut i, mut j) = (0, 0);
        let Some(mut corners) = square(a, None, None) else { return false };
        loop {
            let [_, beside_x, beside_y, far] = corners;
            if i + 1 == dx && j + 1 == dy {
                each(far);
                return far == b;
            }
            let next = match ((i + 1) * dy).cmp(&((j + 1) * dx)) {
                std::cmp::Ordering::Less => {
                    i += 1;
                    each(beside_x);
                    square(beside_x, None, Some(far))
                }
                std::cmp::Ordering::Greater => {
                    j += 1;
                    each(beside_y);
                    square(beside_y, Some(far), None)
                }
                std::cmp::Ordering::Equal => {
                    (i, j) = (i + 1, j + 1);
                    each(far);
                    square(far, None, None)
                }
            };
            let Some(next) = next else { return false };
            corners = next;
        }
    }
}

/// Returns the places of a path, as indices in it and the last one first, between which it can be straight without
/// becoming longer.
fn straightened(region: &Region, way: &[u32]) -> Vec<usize> {
    let mut far = vec![0u64];
    for pair in way.windows(2) {
        let [from, to] = [0, 1].map(|at| region.pixels[pair[at] as usize]);
        let across = match (from[0].abs_diff(to[0]), from[1].abs_diff(to[1])) {
            (1, 1) => DIAGONAL,
            (0, 1) | (1, 0) => STRAIGHT,
            _ => KNIGHT,
        };
        far.push(far[far.len() - 1] + u64::from(region.length(pair[0], pair[1], across)));
    }
    let mut kept = vec![];
    let mut at = 0;
    while at + 1 < way.len() {
        let sees = |to: usize| {
            region
                .straight(way[at], way[to])
                .is_some_and(|cost| u64::from(cost) <= far[to] - far[at] + u64::from(STRAIGHT) / 10)
        };
        // Doubling, then bisection: visibility mostly ends at one place.
        let (mut near, mut step) = (at + 1, 2);
        while at + step < way.len() && sees(at + step) {
            near = at + step;
            step *= 2;
        }
        let mut far = (at + step).min(way.len());
        while near + 1 < far {
            let middle = near.midpoint(far);
            if sees(middle) { near = middle } else { far = middle }
        }
        kept.push(near);
        at = near;
    }
    kept.reverse();
    kept
}

impl Trial {
    /// Follows the path to its end. Returns the route, or the steps that the walker could not take. Nothing that was walked
    /// is walked again after a wait for pages.
    fn follow(&mut self, set: &Snapshot, region: &Region) -> Needs<std::result::Result<Route, Vec<(u32, u32)>>> {
        while let (None, Some(&next)) = (&self.rest, self.next.last()) {
            let [from, to] = [self.at, next].map(|at| self.way[at]);
            let going = self.going.get_or_insert_with(|| Going::from(self.walkers.clone()));
            let arrives = going.walk(set, region, to)?;
            if let Some(going) = self.going.take().filter(|_| arrives) {
                self.walkers = going.walkers;
                (self.at, _) = (next, self.next.pop());
                let mut profile = Vec::new();
                region.is_straight(from, to, |place| profile.push(region.feet(place)));
                let to = region.feet(to);
                follow_heights(region, &profile, to, &mut self.points);
                self.points.push(to);
            } else if next - self.at > 1 {
                self.next.push(self.at.midpoint(next));
            } else {
                self.rest = Some(Rest { refused: vec![(from, to)], at: next, going: None });
            }
        }
        if let Some(rest) = &mut self.rest {
            return ControlFlow::Continue(Err(rest.test(set, region, &self.way)?));
        }
        let points = std::mem::take(&mut self.points);
        ControlFlow::Continue(Ok(Route::along(points, Vec::new())))
    }
}

impl Rest {
    /// Returns the refused steps of the path, the first one included.
    fn test(&mut self, set: &Snapshot, region: &Region, way: &[u32]) -> Needs<Vec<(u32, u32)>> {
        // A grade shows only over many steps.
        let has_grade = region.pawn().max_grade.is_finite();
        while let Some(&[from, to]) = way.get(self.at..self.at + 2) {
            if self.going.is_none() {
                self.going = walkers_at(region, from).ok().map(Going::from);
            }
            let arrives = match &mut self.going {
                Some(going) => Some(going.walk(set, region, to)?),
                None => None,
            };
            if arrives == Some(false) {
                self.refused.push((from, to));
            }
            let come = self.going.take().filter(|_| arrives == Some(true) && has_grade);
            (self.going, self.at) = (come.map(|going| Going::from(going.walkers)), self.at + 1);
        }
        ControlFlow::Continue(std::mem::take(&mut self.refused))
    }
}

/// Returns walkers at a place, with the limits of the region's pawn.
pub(super) fn walkers_at(region: &Region, place: u32) -> Result<Walkers> {
    let (pawn, feet) = (region.pawn(), region.feet(place));
    let config = Config { climb: pawn.climb, max_drop: Some(pawn.max_drop), ..Config::new(pawn.body) };
    let follower = |config: Config| -> Result<Follower> {
        let grade = Grade::new((pawn.max_grade - GRADE_MARGIN).max(0.0), feet);
        Ok(Follower { walker: Walker::new(config, feet)?, grade })
    };
    Ok([follower(config)?, follower(Config { tick_s: LONG_TICK_S, ..config })?])
}

/// Walkers that follow a line each, in turn.
#[derive(Debug)]
pub(super) struct Going<const N: usize> {
    pub walkers: [Follower; N],
    /// Number of walkers at their ends, and the way of the next one.
    there: usize,
    leg: Option<Leg>,
}

impl<const N: usize> From<[Follower; N]> for Going<N> {
    fn from(walkers: [Follower; N]) -> Self {
        Self { walkers, there: 0, leg: None }
    }
}

impl<const N: usize> Going<N> {
    /// Moves each walker along the way that `leg` returns for its number, and returns whether all got to their ends. If
    /// pages are missing, call it again: it continues where it was.
    pub fn follow(&mut self, set: &Snapshot, leg: impl Fn(usize, &Follower) -> Option<Leg>) -> Needs<bool> {
        while let Some(walker) = self.walkers.get_mut(self.there) {
            if self.leg.is_none() {
                self.leg = leg(self.there, walker);
            }
            let Some(leg) = &mut self.leg else { return ControlFlow::Continue(false) };
            if !leg.follow(set, walker)? {
                return ControlFlow::Continue(false);
            }
            (self.there, self.leg) = (self.there + 1, None);
        }
        ControlFlow::Continue(true)
    }
}

impl Going<2> {
    /// Moves the walkers straight to a place, like [`follow`](Self::follow).
    fn walk(&mut self, set: &Snapshot, region: &Region, place: u32) -> Needs<bool> {
        let (to, off) = (region.feet(place), region.grid.frame.quantum_m());
        self.follow(set, |_, walker| Leg::new(walker, vec![to.xy()], to.z, off))
    }
}

/// The way of a walker along a line.
#[derive(Debug)]
pub(super) struct Leg {
    line: Waypoints,
    /// End of the line, and how far from its height the walker may end (m).
    end: Point3<f64>,
    off: f64,
    /// Ticks that are left for it.
    left: f64,
    /// A step that waits for pages.
    step: Option<PendingStep>,
}

impl Leg {
    /// Creates the way of `follower` along `line` to the end of it, at a height of `z` or at most `off` from that (m); `None`
    /// if the line has no place.
    pub fn new(follower: &Follower, line: Vec<Point2<f64>>, z: f64, off: f64) -> Option<Self> {
        let (start, config) = (follower.walker.feet(), follower.walker.config());
        let end = *line.last()?;
        let length: f64 = line.iter().fold((0.0, start.xy()), |(sum, at), to| (sum + (to - at).norm(), *to)).0;
        let left = (PATIENCE * length.hypot(z - start.z) / config.speed + PATIENCE_S) / config.tick_s;
        let line = Waypoints::new(line).ok()?;
        Some(Self { line, end: Point3::new(end.x, end.y, z), off, left, step: None })
    }

    /// Moves the walker to the end and returns whether it got there. If pages are missing, call it again: the walker
    /// continues with the tick that needs them, so the outcome does not depend on what is in memory.
    fn follow(&mut self, set: &Snapshot, Follower { walker, grade }: &mut Follower) -> Needs<bool> {
        let look_s = if grade.is_limited() { LONG_TICK_S } else { 8.0 * walker.config().tick_s };
        while self.left > 0.0 {
            let step = self.step.get_or_insert_with(|| PendingStep::of(look_s));
            let report = walker.follow_on(set, step, &mut self.line);
            if let Some(missing) = report.missing {
                return ControlFlow::Break(Stop::Missing(missing));
            }
            self.step = None;
            self.left -= f64::from(report.ticks);
            let feet = walker.feet();
            if grade.exceeds(feet, report.state) {
                return ControlFlow::Continue(false);
            }
            match report.state {
                State::Arrived => {
                    let off = self.end - feet;
                    return ControlFlow::Continue(off.xy().norm() <= THERE_M && off.z.abs() <= self.off);
                }
                State::Blocked => return ControlFlow::Continue(false),
                _ => {}
            }
        }
        ControlFlow::Continue(false)
    }
}

/// Adds points between the last of `points` and `to` so that the line stays within the climb height of the `profile`.
pub(super) fn follow_heights(region: &Region, profile: &[Point3<f64>], to: Point3<f64>, points: &mut Vec<Point3<f64>>) {
    let Some(&from) = points.last() else { return };
    let way = (to - from).xy();
    let off = |place: &Point3<f64>| {
        let share = ((place - from).xy().dot(&way) / way.norm_squared()).clamp(0.0, 1.0);
        (place.z - from.z - share * (to.z - from.z), share)
    };
    let farthest = profile.iter().enumerate().map(|(at, place)| (off(place), at));
    let Some(((error, share), at)) = farthest.max_by(|a, b| a.0.0.abs().total_cmp(&b.0.0.abs())) else { return };
    if error.abs() <= region.grid.pawn.climb.max(region.grid.frame.pixel_m()) || share <= 0.0 || share >= 1.0 {
        return;
    }
    let middle = Point3::new(from.x + share * way.x, from.y + share * way.y, profile[at].z);
    follow_heights(region, &profile[..at], middle, points);
    points.push(middle);
    follow_heights(region, &profile[at + 1..], to, points);
}
