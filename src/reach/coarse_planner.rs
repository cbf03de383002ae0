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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::walk::Body;

    /// Quanta in a metre of height, and the layer of all pages.
    const METRE: f64 = 850.0;
    const LAYER: i32 = 3;
    /// Height of a plain floor (quanta); spans are 3 high, and heights have no common divisor.
    const FLOOR: u32 = 1000;

    /// Cost of 0.4 m of doubt, as far as a detour of 16 m: 159,999.99 in floats.
    const LACKS: u32 = 159_999;

    /// A pawn that climbs 300 quanta, steps down 200 and is 1445 high, all rounded up; five pixels of 0.1 m wide.
    fn pawn() -> Pawn {
        let metres = |quanta: f64| (quanta - 0.7) / METRE;
        let body = Body::Box { x: 0.5001, y: 0.5001, height: metres(1445.0) };
        Pawn { climb: metres(300.0), max_drop: metres(200.0), ..Pawn::new(body) }
    }

    type Spans = Vec<(u32, u32, bool)>;

    /// One page of pixels of `pixel_m` metres with these spans: bottom, top, and whether it is an obstacle.
    fn level(pixel_m: f64, spans: impl Fn(u32, u32) -> Spans) -> Snapshot {
        let mut builder = PageBuilder::default();
        for (px, py) in (0..64).flat_map(|px| (0..64).map(move |py| (px, py))) {
            let own =
                spans(px, py).into_iter().map(|(bottom, top, obstacle)| Span::new(bottom, top, obstacle).unwrap());
            assert!(builder.set_column(px, py, &own.collect::<Vec<_>>()));
        }
        let key = PageKey { tx: 0, ty: 0, layer: LAYER };
        Snapshot::from_pages(Frame::new(pixel_m, 0.3).unwrap(), [(key, builder.build())])
    }

    fn at([i, j]: [u32; 2], top: u32) -> Point3<f64> {
        let z = f64::from(LAYER) * 19.2 + f64::from(top) / METRE;
        Point3::new((f64::from(i) + 0.5) * 0.1, (f64::from(j) + 0.5) * 0.1, z)
    }

    fn floor(top: u32) -> Spans {
        vec![(top - 3, top, false)]
    }

    /// A planner that has finished, and what it found.
    fn finished(set: &Snapshot, ends: [Point3<f64>; 2], guide: Option<&Route>) -> (Coarse, Result<Route, Refusal>) {
        let mut planner = Coarse::new(set, pawn(), ends[0], ends[1]).unwrap();
        if let Some(guide) = guide {
            planner = planner.near(guide, 0.05);
        }
        match planner.advance(set, usize::MAX, &NoMonitor).unwrap() {
            Planned::Done(found) => (planner, found),
            other => panic!("{other:?}"),
        }
    }

    /// The cost of the way between pixels of plain floor, or `None` without a way.
    fn cost(ends: [[u32; 2]; 2], spans: impl Fn(u32, u32) -> Spans) -> Option<u32> {
        let (planner, found) = finished(&level(0.1, spans), ends.map(|end| at(end, FLOOR)), None);
        assert!(planner.is_fine());
        found.ok().map(|_| planner.nodes[planner.goal.unwrap() as usize].cost)
    }

    fn node(bottom: i32, top: i32, room: i32, unit: i32, obstacle: bool) -> Node {
        Node { pixel: [0; 2], bottom, top, ceiling: top + room, unit, obstacle, cost: 0, from: NO_NODE }
    }

    /// Checks the doubt and the cost of steps (quanta).
    fn steps(planner: &Coarse, table: &[(Node, Node, Option<[i32; 2]>)]) {
        for (from, to, expected) in table {
            let found = planner.step(from, to).map(|step| [step.doubt, step.cost]);
            assert_eq!(found, *expected, "from {from:?} to {to:?}");
        }
    }

    #[test]
    fn a_step_costs_what_only_rounding_explains() {
        let set = level(0.1, |_, _| floor(FLOOR));
        let planner = Coarse::new(&set, pawn(), at([1, 1], FLOOR), at([2, 2], FLOOR)).unwrap();
        assert_eq!((planner.pixel, planner.width, planner.grid.height), (85, 425, 1445));
        let thin = |top: i32| node(top - 10, top, 9000, 10, false);
        let lower = |room: i32, unit: i32| node(990, 1000, room, unit, true);
        let own = thin(1000);
        steps(
            &planner,
            &[
                (own, thin(1000), Some([0, 0])),
                (own, thin(1300), Some([0, 0])),
                (own, thin(1301), Some([1, 1])),
                // Twice the climb height from the top of one to the bottom of the other.
                (own, thin(1610), Some([310, 310])),
                (own, thin(1611), None),
                (own, thin(800), Some([0, 0])),
                (own, thin(799), Some([1, 1])),
                (own, thin(390), Some([410, 410])),
                (own, thin(389), None),
                // Heights in wider units.
                (node(500, 1000, 9000, 500, false), thin(1450), Some([0, 150])),
                (own, node(950, 1450, 9000, 500, false), Some([0, 150])),
                (own, lower(1445, 10), Some([0, 0])),
                (own, lower(1444, 10), Some([1, 1])),
                (own, lower(1425, 10), Some([20, 20])),
                (own, lower(1424, 10), None),
                (own, lower(1385, 30), Some([60, 60])),
                (own, lower(1384, 30), None),
            ],
        );
        let deep = Pawn { max_drop: 399.3 / METRE, ..pawn() };
        let planner = Coarse::new(&set, deep, at([1, 1], FLOOR), at([2, 2], FLOOR)).unwrap();
        steps(&planner, &[(own, thin(290), Some([310, 310])), (own, thin(289), None)]);
        // A pixel's width is as much as 40 pixels, rounded down.
        let costs = [0, 85, 425, 2124, 2126, 9000].map(|quanta| planner.cost(quanta));
        assert_eq!(costs, [0, 39_999, 199_999, 999_529, 1_000_000, 1_000_000]);
    }

    #[test]
    fn on_wide_pixels_the_feet_stand_anywhere_in_a_span() {
        let set = level(0.3, |_, _| floor(FLOOR));
        let planner = Coarse::new(&set, pawn(), at([1, 1], FLOOR), at([2, 2], FLOOR)).unwrap();
        assert!(!planner.is_fine() && planner.pixel == 255);
        let own = node(990, 1000, 9000, 10, false);
        let spans = |bottom: i32, top: i32, obstacle: bool| node(bottom, top, 9000, 10, obstacle);
        steps(
            &planner,
            &[
                (own, spans(990, 1000, false), Some([0, 0])),
                (own, spans(990, 1000, true), Some([0, 63])),
                // Two units and a pixel, and a unit, need no explanation.
                (own, spans(900, 1175, false), Some([0, 265])),
                (own, spans(900, 1176, false), Some([1, 266])),
                (own, spans(1600, 1610, false), Some([310, 310])),
                (own, spans(1601, 1611, false), None),
                (own, spans(380, 390, false), Some([410, 410])),
                (own, spans(380, 389, false), None),
                (own, node(990, 1000, 445, 10, false), Some([1000, 1000])),
            ],
        );
    }

    #[test]
    fn what_is_drawn_over_the_border_of_pages_is_one_span_with_the_wider_unit() {
        let page = |spans: &[(u32, u32, bool)]| {
            let mut builder = PageBuilder::default();
            let spans: Vec<Span> = spans.iter().map(|own| Span::new(own.0, own.1, own.2).unwrap()).collect();
            assert!(builder.set_column(5, 5, &spans));
            builder.build()
        };
        for [below, above] in [[true, false], [false, true]] {
            let pages = [
                (LAYER, page(&[(16_000, 16_100, false), (16_200, 16_320, below)])),
                (LAYER + 1, page(&[(0, 255, above), (510, 765, false)])),
            ];
            let pages = pages.map(|(layer, page)| (PageKey { tx: 0, ty: 0, layer }, page));
            let set = Snapshot::from_pages(Frame::new(0.1, 0.3).unwrap(), pages);
            let mut planner = Coarse::new(&set, pawn(), at([5, 5], FLOOR), at([5, 5], FLOOR)).unwrap();
            let ControlFlow::Continue((first, last)) = planner.column(&set, [64 + 5; 2]) else {
                panic!("all is loaded")
            };
            let found = planner.nodes[first as usize..last as usize]
                .iter()
                .map(|own| ([own.bottom, own.top, own.ceiling, own.unit], own.obstacle));
            let expected = [
                ([16_000, 16_100, 16_200, 5], false),
                ([16_200, 16_575, 16_830, 255], true),
                ([16_830, 17_085, i32::MAX, 255], false),
            ];
            assert_eq!(found.collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn steps_beside_walls_cost_a_quarter_more_and_narrow_ones_what_the_body_lacks() {
        let room = |width: u32, depth: u32| {
            move |i: u32, j: u32| {
                let is_inside = (10..10 + width).contains(&i) && (10..10 + depth).contains(&j);
                if is_inside { floor(FLOOR) } else { Vec::new() }
            }
        };
        assert_eq!(cost([[10, 12], [14, 12]], room(5, 5)), Some(1250 + 3 * 1000));
        assert_eq!(cost([[12, 14], [12, 10]], room(5, 5)), Some(1250 + 3 * 1000));
        assert_eq!(cost([[10, 10], [14, 14]], room(5, 5)), Some(1414 + 353 + 3 * 1414));
        // A body of five pixels in a corridor of one: 0.4 m, each as much as 40 m.
        assert_eq!(cost([[10, 10], [14, 10]], room(5, 1)), Some(4 * (1250 + LACKS)));
        assert_eq!(cost([[10, 14], [10, 10]], room(1, 5)), Some(4 * (1250 + LACKS)));
        // Open to one side along each axis: beside a wall, but not narrow.
        assert_eq!(cost([[10, 10], [11, 10]], room(2, 2)), Some(1250));
    }

    #[test]
    fn a_diagonal_step_passes_over_a_pixel_beside_it() {
        for (way, by) in AROUND.into_iter().enumerate().filter(|(way, _)| way % 2 == 1) {
            let place = |offset: [i32; 2]| [20 + offset[0], 20 + offset[1]].map(|v| v as u32);
            let to = place(by);
            // The cost of a step to a height, past a pixel of another height.
            let past = |pixel: [u32; 2], height: Option<u32>, end: u32| {
                let set = level(0.1, |i, j| match [i, j] {
                    own if own == [20; 2] => floor(FLOOR),
                    own if own == to => floor(end),
                    own if own == pixel => height.map_or(Vec::new(), floor),
                    _ => Vec::new(),
                });
                let (planner, found) = finished(&set, [at([20; 2], FLOOR), at(to, end)], None);
                found.ok().map(|_| planner.nodes[planner.goal.unwrap() as usize].cost)
            };
            for over in [(way + 7) % 8, (way + 1) % 8].map(|way| place(AROUND[way])) {
                assert_eq!(past(over, None, FLOOR), None);
                assert_eq!(past(over, Some(FLOOR), FLOOR), Some(1414 + 353 + LACKS), "{by:?} by {over:?}");
                // No step leads to it, or none from it.
                assert_eq!(past(over, Some(FLOOR - 610), FLOOR - 120), None, "{by:?} by {over:?}");
                assert_eq!(past(over, Some(FLOOR - 500), FLOOR + 110), None, "{by:?} by {over:?}");
            }
        }
    }

    #[test]
    fn gaps_up_to_a_pixel_more_than_the_body_are_bridged_unless_something_is_in_the_way() {
        for (number, by) in AROUND.into_iter().enumerate().filter(|(number, _)| number % 2 == 0) {
            // Two places, and what is drawn in the middle between them.
            let scene = |pixels: i32, between: Spans| {
                let to = [30 + pixels * by[0], 30 + pixels * by[1]].map(|v| v as u32);
                let middle = [30 + pixels / 2 * by[0], 30 + pixels / 2 * by[1]].map(|v| v as u32);
                cost([[30; 2], to], move |i, j| match [i, j] {
                    own if own == [30; 2] || own == to => floor(FLOOR),
                    own if own == middle => between.clone(),
                    _ => Vec::new(),
                })
            };
            for pixels in 2..=6 {
                assert_eq!(scene(pixels, Vec::new()), Some(3000 * pixels as u32), "way {number}, {pixels} pixels");
            }
            assert_eq!(scene(7, Vec::new()), None);
            // Far below, above the head, and just below it. The head ends 1445 above the bottom of the unit of 1.
            assert_eq!(scene(4, floor(FLOOR - 700)), Some(12_000));
            assert_eq!(scene(4, vec![(FLOOR + 1443, FLOOR + 1600, true)]), Some(12_000));
            assert_eq!(scene(4, vec![(FLOOR + 1442, FLOOR + 1600, true)]), None);
            // As high as the knees, which are 600 above the feet, and higher; no step leads onto what has no headroom.
            let ceiling = (FLOOR + 1443, FLOOR + 1600, true);
            assert_eq!(scene(4, vec![(FLOOR - 5, FLOOR + 400, true), ceiling]), Some(12_000));
            assert_eq!(scene(4, vec![(FLOOR - 5, FLOOR + 601, true), ceiling]), Some(12_000));
            assert_eq!(scene(4, vec![(FLOOR - 5, FLOOR + 602, true), ceiling]), None);
        }
    }

    #[test]
    fn a_corridor_holds_the_pixels_near_its_line() {
        let set = level(0.1, |i, j| if i < 9 && j < 9 { floor(FLOOR) } else { Vec::new() });
        for ends in [[[0, 4], [8, 4]], [[4, 0], [4, 8]], [[8, 4], [0, 4]], [[4, 8], [4, 0]]] {
            let ends = ends.map(|end| at(end, FLOOR));
            let guide = Route::along(ends.to_vec(), Vec::new());
            let (planner, found) = finished(&set, ends, Some(&guide));
            assert_eq!((found.unwrap().length_m * 10.0).round(), 8.0);
            let offered = planner.nodes.iter().filter(|node| node.cost < u32::MAX).count();
            assert_eq!((offered, planner.looked_at()), (9, 8));
        }
    }

    #[test]
    fn the_floor_beside_a_place_without_one_counts() {
        for by in AROUND {
            let own = [40 + by[0], 40 + by[1]].map(|v| v as u32);
            let set = level(0.1, |i, j| if [i, j] == own { floor(FLOOR) } else { Vec::new() });
            let (planner, found) = finished(&set, [at([40, 40], FLOOR); 2], None);
            assert!(found.is_ok(), "{by:?}");
            assert_eq!(planner.nodes[planner.goal.unwrap() as usize].pixel, own.map(|v| v as i32 + 64));
        }
        // Of several, the one ahead along x counts first, then along y.
        for (axis, by) in [[1, 0], [0, 1]].into_iter().enumerate() {
            let set =
                level(0.1, |i, j| if [i, j][1 - axis] == 40 && [i, j][axis] != 40 { floor(FLOOR) } else { Vec::new() });
            let (planner, _) = finished(&set, [at([40, 40], FLOOR); 2], None);
            let found = planner.nodes[planner.goal.unwrap() as usize].pixel;
            assert_eq!(found, [64 + 40 + by[0], 64 + 40 + by[1]]);
        }
    }

    #[test]
    fn each_span_is_expanded_once_and_a_turn_ends_after_as_many_as_asked_for() {
        // Steps of very different costs, so that many spans are offered more than once.
        let height = |i: u32, j: u32| FLOOR + (i * 7 + j * 11) % 5 * 120;
        let is_goal = |i: u32, j: u32| (i, j) == (40, 40);
        let set = level(0.1, |i, j| if i < 16 && j < 16 || is_goal(i, j) { floor(height(i, j)) } else { Vec::new() });
        let ends = [at([0, 0], height(0, 0)), at([40, 40], height(40, 40))];
        let (planner, found) = finished(&set, ends, None);
        assert_eq!((found, planner.looked_at()), (Err(Refusal::NotConnected), 256));
        let mut planner = Coarse::new(&set, pawn(), ends[0], ends[1]).unwrap();
        for turn in 1..=25 {
            assert_eq!(planner.advance(&set, 10, &NoMonitor).unwrap(), Planned::Unfinished);
            assert_eq!(planner.looked_at(), 10 * turn);
        }
        assert_eq!(planner.advance(&set, 10, &NoMonitor).unwrap(), Planned::Done(Err(Refusal::NotConnected)));
    }

    #[test]
    fn the_doubt_of_a_route_is_that_of_its_steps() {
        let set = level(0.1, |i, j| if j < 9 { floor(FLOOR + i / 4 % 2 * 345) } else { Vec::new() });
        let (planner, found) = finished(&set, [at([0, 4], FLOOR), at([13, 4], FLOOR + 345)], None);
        assert!(found.is_ok());
        // Up twice and down once: 45 and 145 quanta more than it climbs and steps down.
        assert!((planner.doubt_m() - f64::from(2 * 45 + 145) / METRE).abs() < 1e-12, "{}", planner.doubt_m());
    }
}
