//! The shortest way between two places of a region.
//!
//! A\* over steps to 16 neighbours (the eight, and knight's moves) finds a way at most 2.8 % longer than any in its cells; then
//! each stretch that can be walked straight is. A straight stretch passes squares between four pixel centres, and all four
//! must be places linked with each other: the footprint of a body anywhere inside such a square lies under the union of the
//! footprints at its corners. So what a straight stretch crosses, the whole body can cross.
//!
//! A [prepared](Region::prepare) region guides the search around walls and up stairs; many routes share what that takes.
//!
//! Steps next to the end of the region count 2 % more and bridges three times, so that the way keeps a pixel away from walls
//! and does not lead along gaps.

use super::region::{NO_PLACE, Region};
use super::standing::Spot;
use crate::{Error, Monitor, Result};
use nalgebra::Point3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Costs of steps of lengths 1, √2 and √5 pixels, rounded down.
const STRAIGHT: u32 = 1000;
const DIAGONAL: u32 = 1414;
const KNIGHT: u32 = 2236;
/// Places looked at between two looks at the monitor.
const BETWEEN_LOOKS: usize = 1 << 12;
/// Places from which a prepared region knows what ways cost.
pub(super) const LANDMARKS: usize = 8;
/// Cost of a way that there is not.
const UNREACHED: u32 = u32::MAX;

/// Why there is no route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// The pawn cannot stand where it begins.
    NotStandingFrom,
    /// The pawn cannot stand where it ends.
    NotStandingTo,
    /// No way leads there.
    NotConnected,
}

impl Refusal {
    /// As `slicetool route` writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotStandingFrom => "not_standing_from",
            Self::NotStandingTo => "not_standing_to",
            Self::NotConnected => "not_connected",
        }
    }
}

/// A way.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Route {
    /// Places to reach one after the other, the first and the last included; straight in between, but for steps (m).
    pub points: Vec<Point3<f64>>,
    /// Length of the lines between the points, heights included (m).
    pub length_m: f64,
}

/// Searches routes; keeps its memory from one to the next.
#[derive(Debug, Default)]
pub struct Search {
    /// Per place the least cost so far, where it comes from, and the search that this belongs to.
    costs: Vec<u32>,
    from: Vec<u32>,
    search_of: Vec<u32>,
    search: u32,
    heap: BinaryHeap<(Reverse<u32>, u32, u32)>,
    looked_at: usize,
    goal: Goal,
}

/// Where a search wants to get.
#[derive(Debug, Clone, Copy, Default)]
struct Goal {
    /// `None`: everywhere.
    place: Option<u32>,
    pixel: [i32; 2],
    /// What it costs to get there from each landmark.
    from_landmarks: [u32; LANDMARKS],
}

impl Goal {
    fn of(region: &Region, place: u32) -> Self {
        let from_landmarks = region.landmarks.get(place as usize).copied().unwrap_or([0; LANDMARKS]);
        Self { place: Some(place), pixel: region.pixels[place as usize], from_landmarks }
    }

    /// No way from `place` costs less; [`UNREACHED`] if there is none.
    #[inline]
    fn least_cost(&self, region: &Region, place: u32) -> u32 {
        if self.place.is_none() {
            return 0;
        }
        let mut least = least_cost(region.pixels[place as usize], self.pixel);
        // A way from a landmark over this place to the goal costs no less than the cheapest one to the goal.
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
    /// A search without memory.
    pub fn new() -> Self {
        Self::default()
    }

    /// Places that the last search looked at.
    pub fn looked_at(&self) -> usize {
        self.looked_at
    }

    /// Bytes of memory that it takes.
    pub fn memory_bytes(&self) -> usize {
        (self.costs.capacity() + self.from.capacity() + self.search_of.capacity()) * size_of::<u32>()
            + self.heap.capacity() * size_of::<(Reverse<u32>, u32, u32)>()
    }

    /// The shortest way from one place of `region` to another, within 5 %; `None` if none leads there. Fails only when `monitor`
    /// asks to stop.
    pub fn route(&mut self, region: &Region, from: &Spot, to: &Spot, monitor: &dyn Monitor) -> Result<Option<Route>> {
        match (region.number(from), region.number(to)) {
            (Some(first), Some(last)) => self.between(region, first, last, monitor),
            _ => Ok(None),
        }
    }

    /// The same between two numbered places.
    pub(super) fn between(
        &mut self,
        region: &Region,
        first: u32,
        last: u32,
        monitor: &dyn Monitor,
    ) -> Result<Option<Route>> {
        Ok(self.run(region, first, Some(last), monitor)?.then(|| {
            let mut way = vec![last];
            while let Some(&place) = way.last().filter(|place| **place != first) {
                way.push(self.from[place as usize]);
            }
            way.reverse();
            straighten(region, &way)
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
        (self.search_of[at], self.costs[at], self.from[at]) = (self.search, cost, from);
        let rest = self.goal.least_cost(region, place);
        if rest != UNREACHED {
            // Of equal estimates the one that is farthest on its way.
            self.heap.push((Reverse(cost.saturating_add(rest)), cost, place));
        }
    }

    /// Steps to the neighbours of a place, by quarters: between two ways along the axes lie a diagonal and two knight's moves.
    fn expand(&mut self, region: &Region, place: u32, cost: u32) {
        let links = region.links[place as usize];
        let weigh = |to: u32, length: u32| {
            let to = to as usize;
            let weight = if !region.standing[to] {
                3 * length
            } else if region.is_beside_end(to as u32) {
                length + length / 50
            } else {
                length
            };
            cost.saturating_add(weight)
        };
        let climbs = |to: u32| (region.tops[to as usize] - region.tops[place as usize]).abs() <= region.grid.up;
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

/// No way over the sixteen steps is shorter.
#[inline]
fn least_cost(from: [i32; 2], to: [i32; 2]) -> u32 {
    let [x, y] = [0, 1].map(|axis| from[axis].abs_diff(to[axis]));
    let (long, short) = (x.max(y), x.min(y));
    if 2 * short <= long {
        (long - 2 * short).saturating_mul(STRAIGHT).saturating_add(short.saturating_mul(KNIGHT))
    } else {
        (long - short).saturating_mul(KNIGHT).saturating_add((2 * short - long).saturating_mul(DIAGONAL))
    }
}

impl Region {
    /// Prepares for many routes: from eight places far from each other finds what all ways cost, which tells a [`Search`] where not to look
    /// (landmarks, after Goldberg and Harrelson, "Computing the shortest path", 2005). Routes stay the same to what their search counts as cost.
    ///
    /// Takes the time of some nine routes that look at every place, and 32 bytes a place. Fails only when `monitor` asks to stop; the region
    /// is then as before.
    pub fn prepare(&mut self, monitor: &dyn Monitor) -> Result<()> {
        self.landmarks = Vec::new();
        let Some(first) = self.in_largest_part() else { return Ok(()) };
        let mut search = Search::new();
        let mut landmarks = vec![[UNREACHED; LANDMARKS]; self.len()];
        let mut nearest = vec![UNREACHED; self.len()];
        let mut next = first;
        // The first one only shows what is far off.
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

    /// A place of the largest part whose places are linked with each other.
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

    /// Whether a body can walk straight from place `a` to place `b`; `each` gets the places near the line, in order.
    fn is_straight(&self, a: u32, b: u32, mut each: impl FnMut(u32)) -> bool {
        let (from, to) = (self.pixels[a as usize], self.pixels[b as usize]);
        let [dx, dy] = [0, 1].map(|axis| i64::from(to[axis]) - i64::from(from[axis]));
        let (x, y) = (if dx < 0 { 2 } else { 0 }, if dy < 0 { 3 } else { 1 });
        let (dx, dy) = (dx.abs(), dy.abs());
        let link = |place: u32, way: usize| {
            let next = self.links[place as usize][way];
            (next != NO_PLACE && (self.standing[next as usize] || next == b)).then_some(next)
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
        let climbs = |a: u32, b: u32| (self.tops[a as usize] - self.tops[b as usize]).abs() <= self.grid.up;
        // The corners of a square: nearest, beside it along x and along y, and opposite.
        let square = |near: u32, beside_x: Option<u32>, beside_y: Option<u32>| {
            let beside_x = beside_x.or_else(|| link(near, x))?;
            let beside_y = beside_y.or_else(|| link(near, y))?;
            let far = link(beside_x, y)?;
            (link(beside_y, x)? == far && climbs(near, far) && climbs(beside_x, beside_y))
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

/// The way over as few of its places as can be.
fn straighten(region: &Region, way: &[u32]) -> Route {
    let mut kept = vec![0];
    let mut at = 0;
    while at + 1 < way.len() {
        let sees = |to: usize| region.is_straight(way[at], way[to], |_| {});
        // By doubling, then by halving: what is seen is mostly all up to some place.
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
    let mut points = vec![region.feet(way[0])];
    for ends in kept.windows(2) {
        let mut profile = Vec::new();
        region.is_straight(way[ends[0]], way[ends[1]], |place| profile.push(region.feet(place)));
        let to = region.feet(way[ends[1]]);
        follow_heights(region, &profile, to, &mut points);
        points.push(to);
    }
    let length_m = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    Route { points, length_m }
}

/// Adds points between the last of `points` and `to` so that the line keeps within the climb height of the `profile`.
fn follow_heights(region: &Region, profile: &[Point3<f64>], to: Point3<f64>, points: &mut Vec<Point3<f64>>) {
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
