//! Routes on overview levels: a good guess at where the exact route leads.
//!
//! A level holds all spans of the archive, rounded outwards to whole units of height and joined over sixteen pixels and
//! over slices. So a span on it does not prove that the pawn cannot pass, and a search that needs room for the whole
//! body fails at most doors. This search allows a step if rounding alone may explain the obstruction, and charges more
//! the less likely that is: the *doubt* of the step.
//!
//! A level is *fine* if its pixels are no wider than half of the body and its slices are lower than the body. Then the
//! pixel under the middle of the feet lies under the footprint as a whole, and no gap inside a span has room for the
//! body. So the feet stand at least as high as one unit below the top of a span, and the head ends below the next span:
//! a fine level has a route wherever the archive has one, except over some bridges.
//!
//! On coarser levels the feet may stand anywhere in a span: a street and the wall beside it are one span. What is
//! taller than rounding explains costs its height.

use super::distance::to_line;
use super::intervals::Columns;
use super::pawn::Grid;
use super::{Needs, Pawn, Planned, Refusal, Route, Stop};
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA};
use crate::query::Answer;
use crate::store::{PageSlot, Snapshot};
use crate::{Error, Monitor, Result};
use nalgebra::{Point2, Point3};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::ops::ControlFlow;

/// Length of the detour that avoids a metre of doubt (m).
const DETOUR: f64 = 40.0;
/// Costs of steps of lengths 1 and √2 pixels.
const STRAIGHT: u32 = 1000;
const DIAGONAL: u32 = 1414;
/// Greatest cost of the doubt in one step.
const MOST_COST: f64 = 1e6;
/// Nodes expanded between two checks of the monitor.
const BETWEEN_LOOKS: usize = 1 << 12;
const NO_NODE: u32 = u32::MAX;
/// The eight neighbours; those with even numbers lie along the axes.
const AROUND: [[i32; 2]; 8] = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]];

/// Plans a route on an overview [level](crate::archive::Level), a bounded number of steps at a time.
///
/// It does no I/O: load the pages that it reports and call it again. Memory: about 50 bytes for each span in the tiles
/// that it touches, and 16 KiB for each of these tiles.
#[derive(Debug)]
pub struct Coarse {
    grid: Grid,
    ends: [Point3<f64>; 2],
    is_fine: bool,
    /// Width of a pixel and of the body (quanta).
    pixel: i32,
    width: i32,
    /// A line and the distance from it within which the route stays (m).
    corridor: Option<(Vec<Point2<f64>>, f64)>,
    tiles: HashMap<[i32; 2], Box<[u32]>>,
    nodes: Vec<Node>,
    heap: BinaryHeap<(Reverse<u32>, u32, u32)>,
    /// The node to expand next, before those of the heap: its turn was cut short.
    next: Option<(Reverse<u32>, u32, u32)>,
    goal: Option<u32>,
    doubt_m: f64,
    looked_at: usize,
}

/// A span of a pixel (quanta).
#[derive(Debug, Clone, Copy)]
struct Node {
    pixel: [i32; 2],
    bottom: i32,
    top: i32,
    /// Bottom of the next span above.
    ceiling: i32,
    /// Common divisor of the heights in its page.
    unit: i32,
    obstacle: bool,
    cost: u32,
    from: u32,
}

/// Demands of a step (quanta).
#[derive(Debug, Clone, Copy)]
struct Step {
    /// The part that only rounding can explain.
    doubt: i32,
    /// Cost in addition to its length.
    cost: i32,
}

impl Coarse {
    /// Creates a plan for the route of `pawn` between two places (m) on `level`; in the air, the floor below counts.
    /// Fails like [`StandingPlaces::new`](super::StandingPlaces::new) for an invalid pawn or a set of pages that is too
    /// large.
    pub fn new(level: &Snapshot, pawn: Pawn, from: Point3<f64>, to: Point3<f64>) -> Result<Self> {
        let grid = Grid::new(level, pawn)?;
        let frame = &grid.frame;
        let half = pawn.body.half().min();
        let is_fine = frame.pixel_m() <= half && frame.slice_m() < pawn.body.height();
        // Far below what overflows, far above any building.
        let quanta = |metres: f64| frame.quanta(metres).min(f64::from(1 << 28)) as i32;
        let (pixel, width) = (quanta(frame.pixel_m()), quanta(2.0 * half));
        Ok(Self {
            ends: [from, to],
            is_fine,
            pixel,
            width,
            grid,
            corridor: None,
            tiles: HashMap::new(),
            nodes: Vec::new(),
            heap: BinaryHeap::new(),
            next: None,
            goal: None,
            doubt_m: 0.0,
            looked_at: 0,
        })
    }

    /// Restricts the search to places within `distance` (m) of a route, for instance of one on a coarser level.
    #[must_use]
    pub fn near(mut self, guide: &Route, distance: f64) -> Self {
        let line = self.ends[..1].iter().chain(&guide.points).chain(&self.ends[1..]);
        self.corridor = Some((line.map(|point| point.xy()).collect(), distance));
        self
    }

    /// Returns the doubt of the route that was found (m): heights to climb, missing headroom and spans to pass that
    /// only rounding can explain. 0 if the level shows nothing in the way.
    pub fn doubt_m(&self) -> f64 {
        self.doubt_m
    }

    /// Returns whether the level is fine enough to show where the pawn cannot walk: then [`Refusal::NotConnected`] is
    /// nearly certain.
    pub fn is_fine(&self) -> bool {
        self.is_fine
    }

    /// Returns the number of spans that the search has expanded.
    pub fn looked_at(&self) -> usize {
        self.looked_at
    }

    /// Returns its memory (bytes).
    pub fn memory_bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>()
            + self.heap.capacity() * size_of::<(Reverse<u32>, u32, u32)>()
            + self.tiles.len() * (64 * 64 + 1) * size_of::<u32>()
    }

    /// Continues the search for at most `steps` spans. Fails if `monitor` asks to stop, or if a tile holds more spans
    /// than any scan has ([`Error::Limit`]).
    pub fn advance(&mut self, level: &Snapshot, steps: usize, monitor: &dyn Monitor) -> Result<Planned> {
        match self.run(level, steps, monitor) {
            ControlFlow::Continue(planned) => planned,
            ControlFlow::Break(stop) => Ok(match stop.answer::<()>()? {
                Answer::NotLoaded(missing) => Planned::NotLoaded(missing),
                Answer::Known(()) => Planned::Unfinished,
            }),
        }
    }

    fn run(&mut self, level: &Snapshot, steps: usize, monitor: &dyn Monitor) -> Needs<Result<Planned>> {
        let done = |found| ControlFlow::Continue(Ok(Planned::Done(found)));
        let goal = match self.goal {
            Some(goal) => goal,
            None => {
                let Some(first) = self.under(level, self.ends[0])? else { return done(Err(Refusal::NotStandingFrom)) };
                let Some(last) = self.under(level, self.ends[1])? else { return done(Err(Refusal::NotStandingTo)) };
                self.goal = Some(last);
                self.offer(first, NO_NODE, 0, last);
                last
            }
        };
        let mut taken = 0;
        while let Some((estimate, cost, node)) = self.next.take().or_else(|| self.heap.pop()) {
            if node == goal {
                let route = self.route(goal);
                return done(Ok(route));
            }
            if cost > self.nodes[node as usize].cost {
                continue;
            }
            if taken == steps {
                self.next = Some((estimate, cost, node));
                return ControlFlow::Continue(Ok(Planned::Unfinished));
            }
            taken += 1;
            self.looked_at += 1;
            if self.looked_at.is_multiple_of(BETWEEN_LOOKS) && monitor.cancelled() {
                return ControlFlow::Continue(Err(Error::Interrupted));
            }
            if let ControlFlow::Break(stop) = self.expand(level, node, goal) {
                // It counts once, however often it waits for pages, and what it has offered does not go before it.
                self.looked_at -= 1;
                self.next = Some((estimate, cost, node));
                return ControlFlow::Break(stop);
            }
        }
        done(Err(Refusal::NotConnected))
    }

    fn expand(&mut self, level: &Snapshot, number: u32, goal: u32) -> Needs<()> {
        let own = self.nodes[number as usize];
        let mut around = [(0, 0); 8];
        for (place, way) in around.iter_mut().zip(AROUND) {
            *place = self.column(level, [own.pixel[0] + way[0], own.pixel[1] + way[1]])?;
        }
        let (mut is_narrow, mut is_beside) = (false, false);
        if self.is_fine {
            let is_open = |way: usize| self.among(around[way]).any(|next| self.step(&own, next).is_some());
            let [right, up, left, down] = [0, 2, 4, 6].map(is_open);
            (is_narrow, is_beside) = (!(right || left) || !(up || down), !(right && up && left && down));
        }
        // The body is wider than this pixel, and the neighbours may leave no room for the rest.
        let squeezed = if is_narrow { (self.width - self.pixel).max(0) } else { 0 };
        for (way, offset) in AROUND.into_iter().enumerate() {
            let (first, last) = around[way];
            if !self.is_near([own.pixel[0] + offset[0], own.pixel[1] + offset[1]]) {
                continue;
            }
            let is_straight = way % 2 == 0;
            let mut leads = false;
            for next in first..last {
                let to = self.nodes[next as usize];
                let Some(step) = self.step(&own, &to) else { continue };
                // A diagonal step passes over one of the pixels beside it.
                let mut beside = [around[way.saturating_sub(1)], around[(way + 1) % 8]].into_iter();
                let is_over = |node: &Node| self.step(&own, node).is_some() && self.step(node, &to).is_some();
                if !is_straight && !beside.any(|nodes| self.among(nodes).any(is_over)) {
                    continue;
                }
                leads = true;
                let length = if is_straight { STRAIGHT } else { DIAGONAL };
                let length = if is_beside { length + length / 4 } else { length };
                let cost = own.cost.saturating_add(length);
                let cost = cost.saturating_add(self.cost(step.cost.saturating_add(squeezed)));
                self.offer(next, number, cost, goal);
            }
            if is_straight && !leads && self.is_fine {
                self.bridge(level, number, offset, goal)?;
            }
        }
        ControlFlow::Continue(())
    }

    /// Adds steps over pixels without floor that the footprint spans, if nothing in them obstructs the body.
    fn bridge(&mut self, level: &Snapshot, number: u32, way: [i32; 2], goal: u32) -> Needs<()> {
        let own = self.nodes[number as usize];
        // The feet stand at most the climb height above what lies under their middle.
        let (knees, head) = (own.top + 2 * self.grid.up, own.top - own.unit + self.grid.height);
        for pixels in 1..=1 + self.width / self.pixel.max(1) {
            let pixel = [own.pixel[0] + pixels * way[0], own.pixel[1] + pixels * way[1]];
            let (first, last) = self.column(level, pixel)?;
            if !self.is_near(pixel) {
                break;
            }
            let mut leads = false;
            for next in if pixels == 1 { 0..0 } else { first..last } {
                let Some(step) = self.step(&own, &self.nodes[next as usize]) else { continue };
                leads = true;
                let length = STRAIGHT.saturating_mul(3 * pixels as u32);
                let cost = own.cost.saturating_add(length).saturating_add(self.cost(step.cost));
                self.offer(next, number, cost, goal);
            }
            let blocks = |node: &Node| node.top - node.unit > knees && node.bottom + node.unit < head;
            if leads || self.among((first, last)).any(blocks) {
                break;
            }
        }
        ControlFlow::Continue(())
    }

    fn among(&self, (first, last): (u32, u32)) -> impl Iterator<Item = &Node> {
        self.nodes[first as usize..last as usize].iter()
    }

    /// Returns the cost of `quanta` of doubt.
    fn cost(&self, quanta: i32) -> u32 {
        let pixels = f64::from(quanta) * self.grid.frame.quantum_m() / self.grid.frame.pixel_m();
        (pixels * DETOUR * f64::from(STRAIGHT)).min(MOST_COST) as u32
    }

    /// Returns the lowest and the highest level at which the feet may stand in a span (quanta).
    fn floor(&self, node: &Node) -> [i32; 2] {
        [if self.is_fine { node.top - node.unit } else { node.bottom }, node.top]
    }

    /// Returns the demands of a step between spans of neighbouring pixels; `None` if not even rounding explains it.
    fn step(&self, from: &Node, to: &Node) -> Option<Step> {
        let grid = &self.grid;
        let ([low, high], [next_low, next_high]) = (self.floor(from), self.floor(to));
        // Feet rest on the highest span under the footprint, at most the climb height above the one under their middle.
        if next_low - high > 2 * grid.up || low - next_high > grid.up.saturating_add(grid.drop.max(grid.up)) {
            return None;
        }
        let lacking = (grid.height - to.ceiling.saturating_sub(to.top)).max(0);
        let unit = from.unit.max(to.unit);
        if self.is_fine && lacking > 2 * unit {
            return None;
        }
        let rise = to.top - from.top;
        let takes = if rise > 0 { grid.up } else { grid.drop };
        let beyond = |takes: i32| (rise.abs() - takes).max(0);
        let thick = |least: i32| if self.is_fine { 0 } else { (to.top - to.bottom - least).max(0) };
        // Obstacles on coarse levels are less likely to be floor.
        let unlikely = if to.obstacle && !self.is_fine { self.pixel / 4 } else { 0 };
        Some(Step {
            doubt: beyond(takes.max(unit)).saturating_add(lacking).saturating_add(thick(2 * to.unit + self.pixel)),
            cost: beyond(takes).saturating_add(lacking).saturating_add(thick(to.unit)).saturating_add(unlikely),
        })
    }

    fn offer(&mut self, node: u32, from: u32, cost: u32, goal: u32) {
        let goal = self.nodes[goal as usize].pixel;
        let own = &mut self.nodes[node as usize];
        if own.cost <= cost {
            return;
        }
        (own.cost, own.from) = (cost, from);
        let [x, y] = [0, 1].map(|axis| own.pixel[axis].abs_diff(goal[axis]));
        let rest = (x.max(y) - x.min(y)).saturating_mul(STRAIGHT).saturating_add(x.min(y).saturating_mul(DIAGONAL));
        self.heap.push((Reverse(cost.saturating_add(rest)), cost, node));
    }

    fn is_near(&self, pixel: [i32; 2]) -> bool {
        let Some((line, distance)) = &self.corridor else { return true };
        let at = Point2::new(self.grid.middle(pixel[0], 0), self.grid.middle(pixel[1], 1));
        line.windows(2).any(|ends| to_line(at, [ends[0], ends[1]]) <= *distance)
    }

    /// Returns the node under a place, or one beside it.
    fn under(&mut self, level: &Snapshot, at: Point3<f64>) -> Needs<Option<u32>> {
        let Some(pixel) = self.grid.pixel(at.x, at.y) else { return ControlFlow::Continue(None) };
        let highest = self.grid.level(at.z).saturating_add(self.grid.up);
        for way in std::iter::once([0, 0]).chain(AROUND) {
            let (first, last) = self.column(level, [pixel[0] + way[0], pixel[1] + way[1]])?;
            let below = (first..last).rfind(|node| self.floor(&self.nodes[*node as usize])[0] <= highest);
            if below.is_some() {
                return ControlFlow::Continue(below);
            }
        }
        ControlFlow::Continue(None)
    }

    /// Returns the range of the nodes of a pixel, from below; reads its tile if necessary.
    fn column(&mut self, level: &Snapshot, pixel: [i32; 2]) -> Needs<(u32, u32)> {
        if !self.grid.is_inside(pixel) {
            return ControlFlow::Continue((0, 0));
        }
        let at = pixel.map(|pixel| pixel >> 6);
        if !self.tiles.contains_key(&at) {
            let tile = self.read(level, at)?;
            self.tiles.insert(at, tile);
        }
        ControlFlow::Continue(self.known(pixel).unwrap_or((0, 0)))
    }

    /// Returns the range of the nodes of a pixel if its tile has been read.
    fn known(&self, pixel: [i32; 2]) -> Option<(u32, u32)> {
        let starts = self.tiles.get(&pixel.map(|pixel| pixel >> 6))?;
        let cell = (((pixel[1] & 63) << 6) | (pixel[0] & 63)) as usize;
        Some((starts[cell], starts[cell + 1]))
    }

    /// Reads the nodes of a tile. Returns the number of the first node of each pixel, and the end.
    fn read(&mut self, level: &Snapshot, at: [i32; 2]) -> Needs<Box<[u32]>> {
        let corner = at.map(|at| at * 64);
        let columns = Columns::under(level, &self.grid, corner, corner)?;
        let (spans, most) = columns.spans();
        if spans > most || self.nodes.len() + spans >= NO_NODE as usize {
            return ControlFlow::Break(Stop::Spans(spans, most));
        }
        let slots = columns.at(corner[0], corner[1]);
        let unit = |slot: &PageSlot| slot.page().map_or(SLICE_QUANTA as i32, |page| page.height_unit() as i32);
        let units: Vec<i32> = slots.iter().map(unit).collect();
        let mut starts = Vec::with_capacity(64 * 64 + 1);
        starts.push(self.nodes.len() as u32);
        for cell in 0..64 * 64 {
            let pixel = [corner[0] + (cell & 63), corner[1] + (cell >> 6)];
            let own = self.nodes.len();
            for (slot, &unit) in slots.iter().zip(&units) {
                let Some(page) = slot.page() else { continue };
                let base = ((i64::from(slot.layer()) - i64::from(self.grid.origin[2])) * PAGE_QUANTA) as i32;
                for span in page.column((cell & 63) as u32, (cell >> 6) as u32) {
                    let [bottom, top] = [span.bottom(), span.top()].map(|quanta| base + quanta as i32);
                    let below = self.nodes[own..].last_mut();
                    if let Some(below) = below {
                        if bottom <= below.top {
                            (below.top, below.unit) = (below.top.max(top), below.unit.max(unit));
                            below.obstacle |= span.is_obstacle();
                            continue;
                        }
                        below.ceiling = bottom;
                    }
                    let (cost, from) = (u32::MAX, NO_NODE);
                    let (ceiling, obstacle) = (i32::MAX, span.is_obstacle());
                    self.nodes.push(Node { pixel, bottom, top, ceiling, unit, obstacle, cost, from });
                }
            }
            starts.push(self.nodes.len() as u32);
        }
        ControlFlow::Continue(starts.into())
    }

    /// Returns the route to a node.
    fn route(&mut self, last: u32) -> Route {
        let mut way = vec![last];
        while let Some(before) = way.last().map(|node| self.nodes[*node as usize].from).filter(|from| *from != NO_NODE)
        {
            way.push(before);
        }
        way.reverse();
        let steps = way.windows(2).filter_map(|pair| {
            let [from, to] = [0, 1].map(|at| &self.nodes[pair[at] as usize]);
            self.step(from, to).map(|step| step.doubt)
        });
        // The sum of nothing is -0.
        self.doubt_m = (0.0 + steps.map(f64::from).sum::<f64>()) * self.grid.frame.quantum_m();
        // As level as the spans allow it.
        let mut z = self.ends[0].z;
        let place = |&node: &u32| {
            let node = &self.nodes[node as usize];
            let [low, high] = self.floor(node).map(|height| self.grid.z(height));
            z = z.max(low).min(high);
            Point3::new(self.grid.middle(node.pixel[0], 0), self.grid.middle(node.pixel[1], 1), z)
        };
        let mut all: Vec<Point3<f64>> = way.iter().map(place).collect();
        if way.len() == 1 {
            (way, all) = (vec![last; 2], vec![all[0]; 2]);
        }
        // The ends are known better than to a pixel.
        let end = all.len() - 1;
        for (at, own) in [(0, self.ends[0]), (end, self.ends[1])] {
            (all[at].x, all[at].y) = (own.x, own.y);
        }
        let (mut points, mut at) = (vec![all[0]], 0);
        while at < end {
            let sees = |to: usize| self.is_clear(way[at], way[to]);
            // Doubling, then bisection: visibility mostly ends at one place.
            let (mut near, mut step) = (at + 1, 2);
            while at + step <= end && sees(at + step) {
                near = at + step;
                step *= 2;
            }
            let mut far = (at + step).min(end + 1);
            while near + 1 < far {
                let middle = near.midpoint(far);
                if sees(middle) { near = middle } else { far = middle }
            }
            points.push(all[near]);
            at = near;
        }
        Route::along(points, Vec::new())
    }

    /// Returns whether the straight line between two nodes has no doubt.
    fn is_clear(&self, from: u32, to: u32) -> bool {
        let [first, last] = [from, to].map(|node| self.nodes[node as usize].pixel);
        let [dx, dy] = [0, 1].map(|axis| i64::from(last[axis]) - i64::from(first[axis]));
        let steps = dx.abs().max(dy.abs());
        let mut at = from;
        for step in 1..=steps {
            // The nearest pixel.
            let along = |way: i64| (2 * way * step + steps).div_euclid(2 * steps) as i32;
            let Some((low, end)) = self.known([first[0] + along(dx), first[1] + along(dy)]) else { return false };
            let own = &self.nodes[at as usize];
            let next =
                (low..end).find(|next| self.step(own, &self.nodes[*next as usize]).is_some_and(|step| step.doubt == 0));
            let Some(next) = next else { return false };
            at = next;
        }
        at == to
    }
}
