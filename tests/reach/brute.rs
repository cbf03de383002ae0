//! Regions and lengths of routes in random scenes beside brute force by their definition.
//!
//! `SLICEWALK_CASES` sets the number of scenes, `SLICEWALK_FIRST` the first one.

use super::walked::{SIGMA, Scene, T, bodies};
use super::{everywhere, flat, grown, spot, way};
use crate::common::random::Random;
use nalgebra::Point3;
use slicewalk::frame::{Frame, PAGE_QUANTA, SLICE_QUANTA};
use slicewalk::reach::{Flood, Pawn, Region, Route, Search};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap, HashSet};
use std::ops::RangeInclusive;

const QUANTUM: f64 = SIGMA / SLICE_QUANTA as f64;
/// Farthest that a body or the floor that it looks for reaches beyond the scene (pixels).
const AROUND: i64 = 10;
/// Longest straight edges of the visibility graph along an axis (pixels). Ways that follow them are at most 0.35 % longer than the shortest.
const FAR: i64 = 6;
const ROUNDING: f64 = 1.0035;
/// How often a path of the graph is replaced because a walker cannot take one of its steps.
const MOST_WAYS: usize = 200;

type At = (i64, i64);
const WAYS: [At; 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

fn plus(a: At, b: At) -> At {
    (a.0 + b.0, a.1 + b.1)
}

/// Whether the inside of the body enters the pixel `(dx, dy)` away, its middle `by` pixels beside the middle of its own.
fn enters(body: &Body, (dx, dy): At, by: [f64; 2]) -> bool {
    let gap = |d: i64, by: f64| (((d as f64 - by).abs() - 0.5) * T).max(0.0);
    let [x, y] = [gap(dx, by[0]), gap(dy, by[1])];
    match *body {
        Body::Box { x: width, y: depth, .. } => x < width / 2.0 - 1e-7 && y < depth / 2.0 - 1e-7,
        Body::Cylinder { radius, .. } => x.hypot(y) < radius - 1e-7,
    }
}

fn footprint(body: &Body, by: [f64; 2]) -> Vec<At> {
    let all = (-8..=8).flat_map(|dy| (-8..=8).map(move |dx| (dx, dy)));
    all.filter(|at| enters(body, *at, by)).collect()
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Refused,
    Bridge,
    Standing,
}

/// A top at which the body fits.
struct Place {
    at: At,
    top: i64,
    /// How much higher its floor lies.
    floor: Option<i64>,
    kind: Kind,
}

/// All places of a scene, by the definition in the text of `slicewalk::reach`.
struct Truth<'a> {
    spans: &'a HashMap<At, Vec<(i64, i64, bool)>>,
    footprint: Vec<At>,
    /// Per axis, whether the body touches no pixel outside of both footprints half way between two pixels.
    lets_go: [bool; 2],
    height: i64,
    up: i64,
    places: Vec<Place>,
    /// First place of each pixel.
    first: HashMap<At, usize>,
    links: Vec<[Option<usize>; 4]>,
    /// Heights averaged over 0.6 m, which is three linked places to each side, along x and then along y.
    levels: Vec<i64>,
}

impl<'a> Truth<'a> {
    fn new(spans: &'a HashMap<At, Vec<(i64, i64, bool)>>, pawn: &Pawn) -> Self {
        let body = pawn.body;
        let height = (body.height() / QUANTUM + 1e-6).floor() as i64 + 1;
        let up = (pawn.climb / QUANTUM + 1e-6).floor() as i64 + 1;
        let own = footprint(&body, [0.0; 2]);
        let widest = own.iter().fold([0, 0], |far, at| [far[0].max(at.0), far[1].max(at.1)]);
        let in_both = |axis: usize| {
            let next = WAYS[axis];
            let by = [[0.5, 0.0], [0.0, 0.5]][axis];
            // The outermost row of a cylinder may drag behind; the one through its middle counts.
            let middle = |at: &&At| [at.1, at.0][axis] == 0;
            let halfway = footprint(&body, by);
            halfway.iter().filter(middle).all(|at| own.contains(at) && own.contains(&plus(*at, (-next.0, -next.1))))
        };
        let lets_go = [in_both(0), in_both(1)];
        let mut truth = Self {
            spans,
            footprint: own,
            lets_go,
            height,
            up,
            places: Vec::new(),
            first: HashMap::new(),
            links: Vec::new(),
            levels: Vec::new(),
        };
        let corners = [0, 1].map(|axis| {
            let along = || spans.keys().map(move |at| [at.0, at.1][axis]);
            [along().min().unwrap_or(0) - AROUND, along().max().unwrap_or(0) + AROUND]
        });
        for at in (corners[1][0]..=corners[1][1]).flat_map(|j| (corners[0][0]..=corners[0][1]).map(move |i| (i, j))) {
            truth.first.insert(at, truth.places.len());
            truth.add(at, widest);
        }
        truth.links = (0..truth.places.len()).map(|place| [0, 1, 2, 3].map(|way| truth.step(place, way))).collect();
        truth.levels = truth.places.iter().map(|place| place.top).collect();
        for axis in [0, 1] {
            let links = &truth.links;
            let mean = |place: usize| {
                let along = |way: usize| std::iter::successors(links[place][way], move |at: &usize| links[*at][way]);
                let beside = along(axis).take(3).chain(along(axis + 2).take(3));
                let all: Vec<i64> = beside.chain([place]).map(|at| truth.levels[at]).collect();
                all.iter().sum::<i64>() / all.len() as i64
            };
            truth.levels = (0..truth.places.len()).map(mean).collect();
        }
        truth
    }

    fn under(&self, at: At) -> impl Iterator<Item = (i64, i64, bool)> + Clone + '_ {
        self.footprint.iter().flat_map(move |by| self.spans.get(&plus(at, *by)).into_iter().flatten().copied())
    }

    fn add(&mut self, at: At, widest: [i64; 2]) {
        let near = (0.05 / QUANTUM + 1e-6).floor() as i64;
        let tops: BTreeSet<i64> = self.under(at).map(|span| span.1).collect();
        for top in tops {
            if self.under(at).any(|span| span.1 > top && span.0 < top + self.height) {
                continue;
            }
            let under = self.under(at).filter(|span| !span.2 && (top - near..=top).contains(&span.1));
            // 25 cm are two pixels.
            let [x, y] = widest.map(|widest| widest + 2);
            let around = (-y..=y).flat_map(|dy| (-x..=x).map(move |dx| (dx, dy)));
            let around = around.flat_map(|by| self.spans.get(&plus(at, by)).into_iter().flatten());
            let floors: Vec<i64> = around.filter(|span| !span.2).map(|span| span.1 - top).collect();
            let beside =
                |heights: RangeInclusive<i64>| floors.iter().copied().filter(|floor| heights.contains(floor)).max();
            let above = floors.iter().copied().filter(|floor| (near..=self.up.max(near)).contains(floor)).min();
            let floor = under.map(|span| span.1 - top).max().or(beside(-near..=0)).or(beside(0..=near)).or(above);
            let foot = widest[0].min(widest[1]).min(1);
            let middle = (-foot..=foot).flat_map(|dy| (-foot..=foot).map(move |dx| (dx, dy)));
            let mut middle = middle.flat_map(|by| self.spans.get(&plus(at, by)).into_iter().flatten());
            let has_matter = middle.any(|span| (top - self.up..=top).contains(&span.1));
            let kind = match floor {
                None => Kind::Refused,
                Some(floor) if floor <= near && has_matter => Kind::Standing,
                Some(_) => Kind::Bridge,
            };
            self.places.push(Place { at, top, floor, kind });
        }
    }

    fn at(&self, at: At) -> impl Iterator<Item = usize> + '_ {
        let first = self.first.get(&at).copied().unwrap_or(self.places.len());
        (first..self.places.len()).take_while(move |place| self.places[*place].at == at)
    }

    /// Where a step leads that goes down no deeper than it goes up.
    fn step(&self, place: usize, way: usize) -> Option<usize> {
        let from = &self.places[place];
        if from.kind == Kind::Refused {
            return None;
        }
        let near = (0.05 / QUANTUM + 1e-6).floor() as i64;
        let floor = from.floor?;
        let mut limit = if floor > near { from.top + floor } else { from.top.max(from.top + floor + self.up) };
        let next = plus(from.at, WAYS[way]);
        let highest = |limit: i64| self.at(next).filter(|place| self.places[*place].top <= limit).last();
        let mut to = highest(limit)?;
        let edge = &self.places[to];
        if edge.top > from.top && edge.floor.is_some_and(|floor| edge.top + floor > limit) {
            limit = edge.top - 1;
            to = highest(limit)?;
        }
        let top = self.places[to].top;
        if from.top - top > self.up || self.places[to].kind == Kind::Refused {
            return None;
        }
        let level = from.top.max(top);
        let fits = |at: At, above: i64| !self.under(at).any(|span| span.1 > above && span.0 < level + self.height);
        (self.lets_go[way & 1] || fits(from.at, from.top) && fits(next, top)).then_some(to)
    }

    /// Standing places that can be reached from a place.
    fn reached(&self, from: usize) -> Vec<(At, i64)> {
        let (mut seen, mut open) = (HashSet::from([from]), vec![from]);
        while let Some(place) = open.pop() {
            open.extend(self.links[place].iter().flatten().filter(|next| seen.insert(**next)));
        }
        let mut all: Vec<(At, i64)> = seen.iter().filter_map(|place| self.standing(*place)).collect();
        all.sort_unstable();
        all
    }

    fn standing(&self, place: usize) -> Option<(At, i64)> {
        let place = &self.places[place];
        (place.kind == Kind::Standing).then_some((place.at, place.top))
    }

    /// Where a straight way leads over squares between four linked places, and its length with averaged heights (m).
    fn straight(&self, from: usize, (dx, dy): At, squares: &[At]) -> Option<(usize, f64)> {
        let x = if dx < 0 { 2 } else { 0 };
        let y = if dy < 0 { 3 } else { 1 };
        let (dx, dy) = (dx.abs(), dy.abs());
        let number = |(i, j): At| (j * (dx + 1) + i) as usize;
        let mut known = vec![None; ((dx + 1) * (dy + 1)) as usize];
        known[0] = Some(from);
        if dx == 0 || dy == 0 {
            for step in 1..known.len() {
                known[step] = Some(self.links[known[step - 1]?][if dx == 0 { y } else { x }]?);
            }
        }
        let climbs = |a: usize, b: usize| (self.places[a].top - self.places[b].top).abs() <= self.up;
        for &(i, j) in squares {
            let near = known[number((i, j))]?;
            let (a, b) = (self.links[near][x]?, self.links[near][y]?);
            let far = self.links[a][y]?;
            if self.links[b][x]? != far || !climbs(near, far) || !climbs(a, b) {
                return None;
            }
            for (at, place) in [((i + 1, j), a), ((i, j + 1), b), ((i + 1, j + 1), far)] {
                if *known[number(at)].get_or_insert(place) != place {
                    return None;
                }
            }
        }
        let to = known[number((dx, dy))]?;
        // The nearest place every few pixels.
        let parts = (dx.max(dy) + FAR - 1) / FAR;
        let across = (dx as f64).hypot(dy as f64) * T / parts as f64;
        let near = |part: i64| ((2 * dx * part + parts) / (2 * parts), (2 * dy * part + parts) / (2 * parts));
        let level = |part: i64| known[number(near(part))].map(|place| self.levels[place] as f64 * QUANTUM);
        let length = (0..parts).map(|part| Some(across.hypot(level(part + 1)? - level(part)?))).sum::<Option<f64>>()?;
        Some((to, length))
    }

    /// Length of a route with averaged heights (m); `None` if a point of it is at no place. A part that leaves the squares
    /// between linked places, which only following it proved, counts as a straight line.
    fn length(&self, from: usize, route: &Route) -> Option<f64> {
        let frame = Frame::new(T, SIGMA).unwrap();
        let middle = |pixel: i64| (pixel as f64 + 0.5) * T;
        let (mut at, mut sum) = (from, 0.0);
        for point in &route.points[1..] {
            let to = (frame.pixel_of(point.x), frame.pixel_of(point.y));
            // Points for heights lie on the line to the next place.
            if (point.x - middle(to.0)).abs().max((point.y - middle(to.1)).abs()) > 1e-9 {
                continue;
            }
            let way = (to.0 - self.places[at].at.0, to.1 - self.places[at].at.1);
            let direct = || {
                let top = frame.quantum_ceil(point.z);
                let next = self.at(to).min_by_key(|place| (self.places[*place].top - top).abs())?;
                let rise = (self.levels[next] - self.levels[at]) as f64 * QUANTUM;
                Some((next, ((way.0 as f64).hypot(way.1 as f64) * T).hypot(rise)))
            };
            let (next, length) = self.straight(at, way, &crossed(way)).or_else(direct)?;
            (at, sum) = (next, sum + length);
        }
        Some(sum)
    }

    fn feet(&self, place: usize) -> Point3<f64> {
        let Place { at, top, .. } = self.places[place];
        let frame = Frame::new(T, SIGMA).unwrap();
        Point3::new((at.0 as f64 + 0.5) * T, (at.1 as f64 + 0.5) * T, frame.top_height(top))
    }
}

/// The squares between pixel centres that a straight way crosses, from its beginning on and as if both of its sides were positive.
fn crossed((dx, dy): At) -> Vec<At> {
    let (dx, dy) = (dx.abs(), dy.abs());
    let all = (0..dx).flat_map(|i| (0..dy).map(move |j| (i, j)));
    let mut squares: Vec<At> = all.filter(|(i, j)| dy * (i + 1) - dx * j > 0 && dy * i - dx * (j + 1) < 0).collect();
    squares.sort_unstable_by_key(|(i, j)| i + j);
    squares
}

/// Directions of edges of the visibility graph, each with the squares that it crosses.
fn directions() -> Vec<(At, Vec<At>)> {
    let gcd = |mut a: i64, mut b: i64| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a.abs()
    };
    let all = (-FAR..=FAR).flat_map(|dy| (-FAR..=FAR).map(move |dx| (dx, dy)));
    all.filter(|(dx, dy)| gcd(*dx, *dy) == 1).map(|way| (way, crossed(way))).collect()
}

/// The shortest way over straight edges, heights included (m), without those that are `closed`.
fn shortest(
    truth: &Truth,
    edges: &[Vec<(u32, f32)>],
    closed: &HashSet<(usize, usize)>,
    [from, to]: [usize; 2],
) -> Option<(f64, Vec<usize>)> {
    let mut far = vec![f64::INFINITY; truth.places.len()];
    let mut before = vec![usize::MAX; truth.places.len()];
    let mut open = BinaryHeap::new();
    far[from] = 0.0;
    open.push((Reverse(0u64), from));
    while let Some((Reverse(key), place)) = open.pop() {
        if key > far[place].to_bits() {
            continue;
        }
        if place == to {
            let mut way = vec![to];
            while way[way.len() - 1] != from {
                way.push(before[way[way.len() - 1]]);
            }
            way.reverse();
            return Some((far[to], way));
        }
        for &(next, length) in &edges[place] {
            let (next, sum) = (next as usize, far[place] + f64::from(length));
            if sum < far[next] && (closed.is_empty() || !closed.contains(&(place, next))) {
                (far[next], before[next]) = (sum, place);
                // Positive numbers compare as their bits do.
                open.push((Reverse(sum.to_bits()), next));
            }
        }
    }
    None
}

/// The edges of a way that a walker cannot take.
fn not_walked(store: &Snapshot, pawn: &Pawn, truth: &Truth, way: &[usize]) -> Vec<(usize, usize)> {
    let config = Config { climb: pawn.climb, ..Config::new(pawn.body) };
    let mut walker = Walker::new(config, truth.feet(way[0])).unwrap();
    let mut refused = Vec::new();
    for pair in way.windows(2) {
        let to = truth.feet(pair[1]);
        let mut waypoints = Waypoints::new(vec![to.xy()]).unwrap();
        let ticks = (2.0 * (to - walker.feet()).norm() / 1.4 + 1.0) * 240.0;
        for _ in 0..(ticks / 8.0) as usize + 1 {
            walker.follow(store, 8.0 / 240.0, &mut waypoints);
            if matches!(walker.state(), State::Arrived | State::Blocked) {
                break;
            }
        }
        let off = to - walker.feet();
        if walker.state() != State::Arrived || off.xy().norm() > 1e-6 || off.z.abs() > QUANTUM {
            refused.push((pair[0], pair[1]));
            walker = Walker::new(config, to).unwrap();
        }
    }
    refused
}

fn standing_of(region: &Region) -> Vec<(At, i64)> {
    let frame = Frame::new(T, SIGMA).unwrap();
    let place = |feet: Point3<f64>| ((frame.pixel_of(feet.x), frame.pixel_of(feet.y)), frame.quantum_ceil(feet.z));
    let mut all: Vec<(At, i64)> = region.places().map(|own| place(own.feet)).collect();
    all.sort_unstable();
    all
}

#[test]
fn regions_and_lengths_are_those_of_brute_force() {
    let number = |name: &str| std::env::var(name).ok().and_then(|value| value.parse().ok());
    let (first, cases) = (number("SLICEWALK_FIRST").unwrap_or(0u64), number("SLICEWALK_CASES").unwrap_or(25u64));
    let directions = directions();
    let (mut places, mut compared, mut longest, mut none, mut replaced) = (0, 0, 1.0f64, 0, 0);
    let mut wrong = Vec::new();
    for seed in first..first + cases {
        let mut random = Random(seed ^ 0xB047);
        // The ground lies below or above the border of two pages, or at it.
        let scene = Scene::random(seed);
        let rise = [0, PAGE_QUANTA - i64::from(random.below(14u32)) * SLICE_QUANTA];
        let rise = rise[random.below(2)] + random.below(SLICE_QUANTA);
        let columns = scene.columns(random.below(4), random.chance(50), [0, 1].map(|_| random.below(64i64)), rise);
        let spans: HashMap<At, Vec<(i64, i64, bool)>> = columns.collect();
        let store = flat::layers(Frame::new(T, SIGMA).unwrap(), &spans);
        let pawn = Pawn::new(bodies()[random.below(7) as usize]);
        let truth = Truth::new(&spans, &pawn);
        let mut all: Vec<(At, i64)> = (0..truth.places.len()).filter_map(|place| truth.standing(place)).collect();
        all.sort_unstable();
        let (mut standing, region) = everywhere(&store, pawn);
        if standing_of(&region) != all {
            let found: HashSet<_> = standing_of(&region).into_iter().collect();
            let expected: HashSet<_> = all.into_iter().collect();
            wrong.push(format!("seed {seed}, {:?}: places {:?}", pawn.body, found.symmetric_difference(&expected)));
            continue;
        }
        places += all.len();
        let numbers: Vec<usize> = (0..truth.places.len()).filter(|place| truth.standing(*place).is_some()).collect();
        if numbers.is_empty() {
            continue;
        }
        let edges: Vec<Vec<(u32, f32)>> = (0..truth.places.len())
            .map(|from| {
                let to = directions.iter().filter_map(|(way, squares)| truth.straight(from, *way, squares));
                to.map(|(to, length)| (to as u32, length as f32)).collect()
            })
            .collect();
        let mut search = Search::new();
        for _ in 0..4 {
            let [from, to] = [0, 1].map(|_| numbers[random.below(numbers.len())]);
            let start = spot(&mut standing, &store, truth.feet(from)).unwrap();
            let own = grown(&mut standing, &store, Flood::from(start));
            let (found, expected) = (standing_of(&own), truth.reached(from));
            if found != expected {
                let [found, expected] = [found, expected].map(|all| all.into_iter().collect::<HashSet<_>>());
                let differ: Vec<_> = found.symmetric_difference(&expected).collect();
                wrong.push(format!(
                    "seed {seed}, {:?}: {} more or less from {:?}: {:?}",
                    pawn.body,
                    differ.len(),
                    truth.feet(from),
                    &differ[..differ.len().min(4)]
                ));
                continue;
            }
            let goal = spot(&mut standing, &store, truth.feet(to)).unwrap();
            let route = way(&mut search, &store, &region, &start, &goal);
            let route = route.map(|route| truth.length(from, &route).unwrap_or(f64::NAN));
            let mut closed = HashSet::new();
            let mut best = None;
            for _ in 0..MOST_WAYS {
                let Some((length, graph)) = shortest(&truth, &edges, &closed, [from, to]) else { break };
                // A path this long need not be walked: the route is within the bound of it.
                if route.is_some_and(|route| route <= 1.05 * length / ROUNDING) {
                    best = Some(length);
                    break;
                }
                let refused = not_walked(&store, &pawn, &truth, &graph);
                if refused.is_empty() {
                    best = Some(length);
                    break;
                }
                replaced += 1;
                closed.extend(refused);
            }
            let ends = [from, to].map(|place| truth.feet(place));
            match (route, best) {
                (Some(route), Some(best)) if best > 0.0 => {
                    (compared, longest) = (compared + 1, longest.max(route / best));
                    if route.is_nan() || route > 1.05 * best {
                        wrong.push(format!("seed {seed}, {:?}: {} m for {best} m, {ends:?}", pawn.body, route));
                    }
                }
                (None, Some(best)) => {
                    wrong.push(format!("seed {seed}, {:?}: no route, but {best} m, {ends:?}", pawn.body))
                }
                (Some(route), None) => {
                    wrong.push(format!("seed {seed}, {:?}: {route} m, but no way, {ends:?}", pawn.body));
                }
                (None, None) => none += 1,
                _ => {}
            }
        }
        if (seed + 1).is_multiple_of(100) {
            eprintln!(
                "{} scenes: {places} places, {compared} routes, {none} pairs without, {replaced} ways replaced, at worst {longest:.4}, {} wrong",
                seed + 1 - first,
                wrong.len()
            );
        }
    }
    eprintln!(
        "{places} places, {compared} routes, {none} pairs without, {replaced} ways replaced, at worst {longest:.4} of the shortest way"
    );
    assert!(wrong.is_empty(), "{}: {:#?}", wrong.len(), &wrong[..wrong.len().min(20)]);
    assert!(compared as u64 > cases / 2, "{compared}");
}
