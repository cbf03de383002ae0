//! Clearances and leaks of random scenes compared with brute force over all pixels.
//!
//! `SLICEWALK_CASES` sets the number of scenes.

use super::{everywhere, flat, known};
use crate::common::random::Random;
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::page::Span;
use slicewalk::reach::{LeakSearch, Pawn};
use slicewalk::walk::Body;
use std::collections::{BTreeMap, BTreeSet};

const T: f64 = 0.1;
const SIGMA: f64 = 0.3;
const QUANTUM: f64 = SIGMA / SLICE_QUANTA as f64;
/// Edge of a scene, and the margin examined around it (pixels).
const EDGE: i64 = 44;
const AROUND: i64 = 14;

type At = (i64, i64);

/// Bottom, top (quanta), and whether it is an obstacle.
type Matter = (i64, i64, bool);

struct World {
    spans: BTreeMap<At, Vec<Matter>>,
    body: Body,
}

fn quanta(metres: f64) -> i64 {
    (metres / QUANTUM).round() as i64
}

/// A shape in plan.
fn shape(random: &mut Random, size: f64) -> impl Fn(At) -> bool + use<> {
    let kind = random.below(5);
    let [x, y] = [0, 1].map(|_| random.between(0.0, EDGE as f64));
    let [a, b] = [0, 1].map(|_| random.between(0.3, 1.0) * size);
    let heading = random.between(0.0, std::f64::consts::TAU);
    let (sin, cos) = if random.chance(40) { heading.sin_cos() } else { (0.0, 1.0) };
    move |(i, j)| {
        let [u, v] = [i as f64 + 0.5 - x, j as f64 + 0.5 - y];
        let [u, v] = [u * cos + v * sin, v * cos - u * sin];
        match kind {
            0 => (u / a).hypot(v / b) < 1.0,
            1 => u.abs() < a && v.abs() < 1.0,
            2 => (u.abs() < a && v.abs() < b) && !(u > 0.0 && v > 0.0),
            _ => u.abs() < a && v.abs() < b,
        }
    }
}

fn random_world(seed: u64) -> World {
    let mut random = Random(seed.wrapping_mul(77_977));
    let body = match random.below(6) {
        0 => Body::Box { x: 0.5, y: 0.5, height: 1.8 },
        1 => Body::Box { x: 0.3, y: 0.9, height: 1.2 },
        2 => Body::Box { x: 1.1, y: 0.4, height: 1.6 },
        3 => Body::Box { x: 0.1, y: 0.1, height: 1.0 },
        4 => Body::Cylinder { radius: 0.25, height: 1.7 },
        _ => Body::Cylinder { radius: 0.5, height: 1.5 },
    };
    let mut spans: BTreeMap<At, Vec<Matter>> = BTreeMap::new();
    let storeys = 1 + random.below(2);
    let all = || (0..EDGE).flat_map(|j| (0..EDGE).map(move |i| (i, j)));
    // Ground at depths that vary from place to place.
    let ground: Vec<_> =
        (0..random.below(4)).map(|_| (shape(&mut random, 40.0), [0.7, 1.3, 2.4][random.below(3)])).collect();
    let deep = quanta(3.0);
    for at in all() {
        if let Some((_, depth)) = ground.iter().find(|(shape, _)| shape(at)) {
            let top = deep - quanta(*depth);
            spans.entry(at).or_default().push((top - 2, top, false));
        }
    }
    for storey in 0..storeys {
        let z = deep + storey * quanta(2.8);
        let scanned = (shape(&mut random, 60.0), random.chance(50));
        let raised = (shape(&mut random, 20.0), quanta([0.0, 0.1, 0.3][random.below(3)]));
        let holes: Vec<_> = (0..random.below(5)).map(|_| shape(&mut random, 9.0)).collect();
        let walls: Vec<_> = (0..random.below(4)).map(|_| shape(&mut random, 16.0)).collect();
        let steep = (shape(&mut random, 6.0), random.chance(30));
        let poles: BTreeSet<At> = (0..random.below(6)).map(|_| (random.below(EDGE), random.below(EDGE))).collect();
        let fence = random.chance(50);
        for at in all() {
            let is_fence = fence && (at.0 == 0 || at.1 == 0 || at.0 == EDGE - 1 || at.1 == EDGE - 1);
            if is_fence || poles.contains(&at) || walls.iter().any(|wall| wall(at)) {
                // Down to the ground below, which it stands on.
                let column = spans.entry(at).or_default();
                let bottom = if storey == 0 { quanta(0.3) } else { z - 2 };
                column.retain(|span| span.1 < bottom - 2);
                column.push((bottom, z + quanta(2.0), true));
            } else if (!scanned.1 || scanned.0(at)) && !holes.iter().any(|hole| hole(at)) {
                let top = z + if raised.0(at) { raised.1 } else { 0 };
                let box_top = top + quanta(0.2);
                let is_steep = steep.1 && raised.1 == 0 && steep.0(at);
                let own = if is_steep { (top - 2, box_top, true) } else { (top - 2, top, false) };
                spans.entry(at).or_default().push(own);
            }
        }
    }
    World { spans, body }
}

impl World {
    /// Mirrors the scene if requested, then rotates it by `quarters` quarter turns.
    fn turned(&self, is_mirrored: bool, quarters: usize) -> Self {
        let body = match self.body {
            Body::Box { x, y, height } if quarters % 2 == 1 => Body::Box { x: y, y: x, height },
            body => body,
        };
        let spans = self.spans.iter().map(|(at, spans)| (turn(*at, is_mirrored, quarters), spans.clone()));
        Self { spans: spans.collect(), body }
    }

    fn pawn(&self) -> Pawn {
        Pawn::new(self.body)
    }

    /// Returns clearances by pixel and height, and leaks, of the scene at `corner`.
    fn answers(&self, corner: At) -> (BTreeMap<(At, i64), f64>, Vec<slicewalk::reach::Leak>) {
        let frame = Frame::new(T, SIGMA).unwrap();
        let columns = self.spans.iter().map(|(&(i, j), spans)| {
            let span = |&(bottom, top, steep): &Matter| Span::new(bottom as u32, top as u32, steep).unwrap();
            ((i + corner.0, j + corner.1), spans.iter().map(span).collect())
        });
        let store = flat::store(frame, columns);
        let (mut standing, region) = everywhere(&store, self.pawn());
        let place = |place: slicewalk::reach::Place| {
            let at = (frame.pixel_of(place.feet.x) - corner.0, frame.pixel_of(place.feet.y) - corner.1);
            ((at, frame.quantum_ceil(place.feet.z)), place.clearance)
        };
        let mut leaks = known(LeakSearch::new(&region).find(&mut standing, &store).unwrap());
        for leak in &mut leaks {
            leak.at.x -= corner.0 as f64 * T;
            leak.at.y -= corner.1 as f64 * T;
        }
        (region.places().map(place).collect(), leaks)
    }
}

fn turn((mut i, mut j): At, is_mirrored: bool, quarters: usize) -> At {
    if is_mirrored {
        i = EDGE - 1 - i;
    }
    for _ in 0..quarters {
        (i, j) = (EDGE - 1 - j, i);
    }
    (i, j)
}

/// Pixels that a body enters from the middle of one.
fn footprint(body: &Body) -> Vec<At> {
    let gap = |d: i64| ((d.abs() as f64 - 0.5) * T).max(0.0);
    let enters = |&(dx, dy): &At| {
        (dx, dy) == (0, 0)
            || match *body {
                Body::Box { x, y, .. } => gap(dx) < x / 2.0 - 1e-6 && gap(dy) < y / 2.0 - 1e-6,
                Body::Cylinder { radius, .. } => gap(dx).hypot(gap(dy)) < radius - 1e-6,
            }
    };
    (-8..=8).flat_map(|dx| (-8..=8).map(move |dy| (dx, dy))).filter(enters).collect()
}

const BESIDE: [At; 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

fn plus(a: At, b: At) -> At {
    (a.0 + b.0, a.1 + b.1)
}

/// A scene as seen by a body at one height.
struct Level<'a> {
    world: &'a World,
    level: i64,
    up: i64,
    height: i64,
    footprint: Vec<At>,
    /// Pixels where the body does not fit, and those with ground under its footprint.
    stopped: BTreeSet<At>,
    grounded: BTreeSet<At>,
}

fn pixels() -> impl Iterator<Item = At> {
    (-AROUND..EDGE + AROUND).flat_map(|j| (-AROUND..EDGE + AROUND).map(move |i| (i, j)))
}

impl<'a> Level<'a> {
    fn new(world: &'a World, level: i64) -> Self {
        let up = (0.35 / QUANTUM) as i64 + 1;
        let height = (world.body.height() / QUANTUM) as i64 + 1;
        let footprint = footprint(&world.body);
        let mut own = Self { world, level, up, height, footprint, stopped: BTreeSet::new(), grounded: BTreeSet::new() };
        for &at in world.spans.keys() {
            let under = |set: &mut BTreeSet<At>| set.extend(own.footprint.iter().map(|by| (at.0 - by.0, at.1 - by.1)));
            if own.stops(at) {
                under(&mut own.stopped);
            }
            if own.is_ground(at) {
                under(&mut own.grounded);
            }
        }
        own
    }

    fn spans(&self, at: At) -> impl Iterator<Item = &Matter> {
        self.world.spans.get(&at).into_iter().flatten()
    }

    /// Returns whether solid is in the way, or the ground is too steep.
    fn stops(&self, at: At) -> bool {
        let (level, up) = (self.level, self.up);
        self.is_wall(at) || self.spans(at).any(|span| span.2 && span.1 > level + 60 && span.1 <= level + up)
    }

    fn is_wall(&self, at: At) -> bool {
        self.spans(at).any(|span| span.1 > self.level + self.up && span.0 < self.level + self.height)
    }

    fn is_ground(&self, at: At) -> bool {
        self.spans(at).any(|span| span.1 >= self.level - self.up && span.1 <= self.level + self.up)
    }

    fn is_place(&self, at: At) -> bool {
        self.grounded.contains(&at) && !self.stopped.contains(&at)
    }

    /// Returns whether the body is over nothing.
    fn is_off(&self, at: At) -> bool {
        !self.grounded.contains(&at) && !self.stopped.contains(&at)
    }

    /// All pixels that bound the places connected to `from`.
    fn ends(&self, from: At) -> (BTreeSet<At>, BTreeSet<At>) {
        let (mut seen, mut open) = (BTreeSet::from([from]), vec![from]);
        let mut ends: BTreeSet<At> = pixels().filter(|at| self.stops(*at)).collect();
        while let Some(at) = open.pop() {
            for to in BESIDE.map(|way| plus(at, way)) {
                if self.is_place(to) && seen.insert(to) {
                    open.push(to);
                }
                if self.is_off(to) {
                    ends.extend(self.footprint.iter().map(|by| plus(to, *by)));
                }
            }
        }
        (seen, ends)
    }
}

/// Distance from the middle of a pixel to the edge of another (pixels).
fn gap((dx, dy): At) -> f64 {
    let gap = |d: i64| (d.abs() as f64 - 0.5).max(0.0);
    gap(dx).hypot(gap(dy))
}

fn cases(default: u64) -> u64 {
    std::env::var("SLICEWALK_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(default)
}

#[test]
fn clearances_are_those_of_brute_force_to_a_pixel() {
    let mut offsets: Vec<At> = (-60..=60).flat_map(|dx| (-60..=60).map(move |dy| (dx, dy))).collect();
    offsets.sort_by(|a, b| gap(*a).total_cmp(&gap(*b)));
    let (mut compared, mut worst, mut inexact, mut wrong) = (0, 0.0f64, 0, Vec::new());
    for seed in 0..cases(25) {
        let world = random_world(seed);
        let (found, _) = world.answers((30, 50));
        let levels: BTreeSet<i64> = found.keys().map(|(_, level)| *level).collect();
        for level in levels {
            let view = Level::new(&world, level);
            let mut parts: Vec<(BTreeSet<At>, BTreeSet<At>)> = Vec::new();
            for (&(at, _), &clearance) in found.iter().filter(|((_, own), _)| *own == level) {
                assert!(view.is_place(at), "seed {seed}: {at:?} at {level}");
                let part = match parts.iter().position(|(places, _)| places.contains(&at)) {
                    Some(part) => part,
                    None => {
                        parts.push(view.ends(at));
                        parts.len() - 1
                    }
                };
                let ends = &parts[part].1;
                let nearest = offsets.iter().find(|by| ends.contains(&plus(at, **by))).map(|by| gap(*by));
                let Some(nearest) = nearest else { continue };
                let error = (clearance / T - nearest).abs();
                (compared, worst, inexact) = (compared + 1, worst.max(error), inexact + usize::from(error > 0.01));
                if error > 1.01 {
                    let found = clearance / T;
                    wrong.push(format!("seed {seed}, {:?}: {at:?} at {level}: {found} for {nearest}", world.body));
                }
            }
        }
    }
    eprintln!("{compared} places, at worst {worst:.2} pixels off, {inexact} inexact");
    assert!(wrong.is_empty(), "{}: {:#?}", wrong.len(), &wrong[..wrong.len().min(20)]);
    assert!(compared > 10_000, "{compared}");
}

/// Kind, drop and width in quanta and pixels.
type Found = (&'static str, Option<i64>, i64);

fn summary(leaks: &[slicewalk::reach::Leak]) -> Vec<Found> {
    let one =
        |leak: &slicewalk::reach::Leak| (leak.kind.name(), leak.drop.map(quanta), (leak.width / T).round() as i64);
    let mut all: Vec<Found> = leaks.iter().map(one).collect();
    all.sort_unstable();
    all
}

#[test]
fn where_a_scene_lies_and_how_it_is_turned_does_not_show() {
    for seed in 0..cases(25) {
        let world = random_world(seed);
        let (places, leaks) = world.answers((0, 0));
        let mut random = Random(seed);
        let corner = (random.below(64i64), random.below(64i64));
        let (moved, moved_leaks) = world.answers(corner);
        assert_eq!(moved, places, "seed {seed}");
        let near = |a: &slicewalk::reach::Leak, b: &slicewalk::reach::Leak| (a.at - b.at).norm() < 1e-6;
        assert!(leaks.len() == moved_leaks.len() && leaks.iter().all(|a| moved_leaks.iter().any(|b| near(a, b))));
        assert_eq!(summary(&moved_leaks), summary(&leaks), "seed {seed}");
        let (is_mirrored, quarters) = (random.chance(50), random.below(4));
        let (turned, turned_leaks) = world.turned(is_mirrored, quarters).answers(corner);
        assert_eq!(turned.len(), places.len(), "seed {seed}");
        for ((at, level), clearance) in &places {
            let other = turned.get(&(turn(*at, is_mirrored, quarters), *level));
            let other = other.unwrap_or_else(|| panic!("seed {seed}: {at:?} at {level} is no place when turned"));
            assert!((other - clearance).abs() <= 1.01 * T, "seed {seed}: {at:?} at {level}: {clearance} and {other}");
        }
        assert_eq!(summary(&turned_leaks), summary(&leaks), "seed {seed}, {:?}", world.body);
    }
}

/// A step over a rim: place, height, direction, and depth of the drop.
#[derive(Clone, Copy)]
struct Brink {
    at: At,
    level: i64,
    way: At,
    depth: Option<i64>,
}

impl Brink {
    fn beyond(&self) -> At {
        plus(self.at, self.way)
    }
}

/// Leaks by their definition.
struct Truth<'a> {
    world: &'a World,
    views: BTreeMap<i64, (Level<'a>, BTreeSet<At>)>,
    foot: i64,
    half: [i64; 2],
    /// Half of the pawn (pixels).
    least: f64,
}

/// Groups items that belong together.
fn groups(count: usize, mut together: impl FnMut(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut group: Vec<usize> = (0..count).collect();
    for a in 0..count {
        for b in 0..a {
            if group[a] != group[b] && together(a, b) {
                let (from, to) = (group[a], group[b]);
                group.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
            }
        }
    }
    let names: BTreeSet<usize> = group.iter().copied().collect();
    names.into_iter().map(|name| (0..count).filter(|item| group[*item] == name).collect()).collect()
}

fn middle_of(mut values: Vec<i64>) -> Option<i64> {
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

fn extent(pixels: impl Iterator<Item = At> + Clone) -> [i64; 2] {
    let along = |values: Vec<i64>| values.iter().max().unwrap_or(&0) - values.iter().min().unwrap_or(&0) + 1;
    [along(pixels.clone().map(|at| at.0).collect()), along(pixels.map(|at| at.1).collect())]
}

fn depth_of(brinks: &[Brink]) -> Option<i64> {
    let depths: Vec<i64> = brinks.iter().filter_map(|brink| brink.depth).collect();
    if 2 * depths.len() < brinks.len() { None } else { middle_of(depths) }
}

impl<'a> Truth<'a> {
    fn new(world: &'a World) -> Self {
        let half = world.body.half() / T;
        let half = [half.x, half.y].map(|half| (half - 0.5 - 1e-6).ceil().max(0.0) as i64);
        let least = world.body.half().min() / T;
        Self { world, views: BTreeMap::new(), foot: half[0].min(half[1]).min(1), half, least }
    }

    fn view(&mut self, level: i64) -> &(Level<'a>, BTreeSet<At>) {
        let world = self.world;
        self.views.entry(level).or_insert_with(|| {
            let view = Level::new(world, level);
            let walls = world.spans.keys().filter(|at| view.is_wall(**at));
            let walled =
                walls.flat_map(|at| view.footprint.iter().map(|by| plus(*at, *by)).collect::<Vec<_>>()).collect();
            (view, walled)
        })
    }

    fn is_walled(&mut self, at: At, level: i64) -> bool {
        self.view(level).1.contains(&at)
    }

    /// `None` if the body does not fall here, otherwise the depth of the fall if there is ground.
    fn open(&mut self, at: At, level: i64) -> Option<Option<i64>> {
        let foot = self.foot;
        let (view, walled) = self.view(level);
        if walled.contains(&at) || view.stopped.contains(&at) {
            return None;
        }
        let under = (-foot..=foot).flat_map(|dx| (-foot..=foot).map(move |dy| plus(at, (dx, dy))));
        let below = under.flat_map(|at| view.spans(at)).map(|span| span.1).filter(|top| *top <= level + view.up);
        let depth = below.max().map(|top| level - top);
        depth.is_none_or(|depth| depth > view.up).then_some(depth)
    }

    fn leaks(&mut self, places: impl Iterator<Item = (At, i64)>) -> Vec<Found> {
        let up = (0.35 / QUANTUM) as i64 + 1;
        let mut brinks = Vec::new();
        for (at, level) in places {
            for way in BESIDE {
                if let Some(depth) = self.open(plus(at, way), level) {
                    brinks.push(Brink { at, level, way, depth });
                }
            }
        }
        let far = |a: At, b: At| (a.0 - b.0).abs().max((a.1 - b.1).abs());
        let is_near = |a: &Brink, b: &Brink| {
            far(a.at, b.at) <= 2
                && far(a.beyond(), b.beyond()) <= 2
                && (a.level - b.level).abs() <= up
                && plus(a.way, b.way) != (0, 0)
        };
        let is_alike = |a: Option<i64>, b: Option<i64>| match (a, b) {
            (Some(a), Some(b)) => (a - b).abs() <= up,
            (a, b) => a == b,
        };
        let rims = groups(brinks.len(), |a, b| is_near(&brinks[a], &brinks[b]));
        let mut gaps: Vec<(i64, BTreeSet<At>, bool)> = Vec::new();
        let mut stretches: Vec<(usize, Vec<Brink>)> = Vec::new();
        for rim in rims {
            let own: Vec<Brink> = rim.iter().map(|brink| brinks[*brink]).collect();
            let level = middle_of(own.iter().map(|brink| brink.level).collect()).unwrap();
            stretches.extend(self.stretches(&own, is_near, is_alike).into_iter().map(|own| (gaps.len(), own)));
            let mut seen = BTreeSet::new();
            let mut open: Vec<At> =
                own.iter().filter(|brink| (brink.level - level).abs() <= up).map(Brink::beyond).collect();
            let mut is_closed = true;
            while let Some(at) = open.pop() {
                if [at.0, at.1].iter().any(|v| !(-AROUND..EDGE + AROUND).contains(v)) {
                    is_closed = false;
                } else if self.open(at, level).is_some() && seen.insert(at) {
                    open.extend(BESIDE.map(|way| plus(at, way)));
                }
            }
            gaps.push((level, seen, is_closed));
        }
        let height = self.world.body.height() / QUANTUM;
        let meet = |a: usize, b: usize| {
            gaps[a].2
                && gaps[b].2
                && (gaps[a].0 - gaps[b].0).abs() as f64 <= height + 1e-6
                && gaps[a].1.intersection(&gaps[b].1).next().is_some()
        };
        let mut found = Vec::new();
        for members in groups(gaps.len(), meet) {
            let own: Vec<Vec<Brink>> =
                stretches.iter().filter(|own| members.contains(&own.0)).map(|own| own.1.clone()).collect();
            let is_closed = members.iter().all(|gap| gaps[*gap].2);
            let level = members.iter().map(|gap| gaps[*gap].0).min().unwrap();
            // Depths are those below the lowest gap with the pixel.
            let mut lowest: BTreeMap<At, i64> = BTreeMap::new();
            for gap in &members {
                for at in &gaps[*gap].1 {
                    let own = lowest.entry(*at).or_insert(gaps[*gap].0);
                    *own = gaps[*gap].0.min(*own);
                }
            }
            let pixels: BTreeSet<At> = lowest.keys().copied().collect();
            let mut is_floor = true;
            if is_closed {
                let [x, y] = extent(pixels.iter().copied());
                if pixels.len() as f64 / (x.max(y) as f64) + 2.0 * (self.foot as f64) < self.least - 1e-9 {
                    continue;
                }
                let around = pixels.iter().flat_map(|at| BESIDE.map(|way| plus(*at, way)));
                let border: BTreeSet<At> = around.filter(|at| !pixels.contains(at)).collect();
                let matter = border.iter().filter(|at| self.is_walled(**at, level)).count();
                is_floor = border.len() - matter >= matter;
            }
            let (holes, others): (Vec<_>, Vec<_>) =
                own.into_iter().partition(|own| is_closed && (is_floor || depth_of(own).is_none()));
            for own in others {
                let width = self.width(&own);
                if width as f64 >= self.least - 1e-9 {
                    let depth = depth_of(&own);
                    found.push((if depth.is_some() { "ledge" } else { "edge" }, depth, width));
                }
            }
            let range = |own: &[Brink]| {
                depth_of(own)?;
                let depths = || own.iter().filter_map(|brink| brink.depth);
                Some((depths().min()?, depths().max()?))
            };
            let holes_alike = groups(holes.len(), |a, b| match (range(&holes[a]), range(&holes[b])) {
                (Some(a), Some(b)) => a.0 <= b.1 + up && b.0 <= a.1 + up,
                (a, b) => a == b,
            });
            let is_one = holes_alike.len() == 1;
            for members in holes_alike {
                let own: Vec<Brink> = members.iter().flat_map(|hole| holes[*hole].clone()).collect();
                let own_range = range(&own);
                let mut is_own = |at: &At| {
                    let depth = self.open(*at, lowest[at]).flatten();
                    is_one
                        || match (own_range, depth) {
                            (Some((low, high)), Some(depth)) => (low - up..=high + up).contains(&depth),
                            (range, depth) => range.is_none() && depth.is_none(),
                        }
                };
                let mut part: Vec<At> = pixels.iter().copied().filter(|at| is_own(at)).collect();
                if part.is_empty() {
                    part = own.iter().map(Brink::beyond).collect();
                }
                let [x, y] = extent(part.iter().copied());
                found.push(("hole", depth_of(&own), x.max(y) + 2 * self.foot));
            }
        }
        found.sort_unstable();
        found
    }

    /// Splits a rim by what is below it.
    fn stretches(
        &self,
        rim: &[Brink],
        is_near: impl Fn(&Brink, &Brink) -> bool,
        is_alike: impl Fn(Option<i64>, Option<i64>) -> bool,
    ) -> Vec<Vec<Brink>> {
        let all = groups(rim.len(), |a, b| is_near(&rim[a], &rim[b]) && is_alike(rim[a].depth, rim[b].depth));
        let is_narrow = |own: &[usize]| {
            let [x, y] = extent(own.iter().map(|brink| rim[*brink].at));
            (x.max(y) as f64) < self.least - 1e-9
        };
        let meet = |a: &[usize], b: &[usize]| a.iter().any(|a| b.iter().any(|b| is_near(&rim[*a], &rim[*b])));
        let clusters = groups(all.len(), |a, b| is_narrow(&all[a]) && is_narrow(&all[b]) && meet(&all[a], &all[b]));
        let clusters: Vec<Vec<usize>> =
            clusters.iter().map(|own| own.iter().flat_map(|part| all[*part].clone()).collect()).collect();
        let (narrow, mut wide): (Vec<Vec<usize>>, Vec<Vec<usize>>) =
            clusters.into_iter().partition(|own| is_narrow(own));
        let before = wide.clone();
        let key = |own: &[usize]| {
            let own: Vec<Brink> = own.iter().map(|brink| rim[*brink]).collect();
            (own.len(), depth_of(&own).unwrap_or(i64::MAX))
        };
        for own in narrow {
            let beside = (0..before.len()).filter(|other| meet(&own, &before[*other]));
            match beside.max_by_key(|other| key(&before[*other])) {
                Some(other) => wide[other].extend(own),
                None => wide.push(own),
            }
        }
        wide.iter().map(|own| own.iter().map(|brink| rim[*brink]).collect()).collect()
    }

    fn width(&mut self, own: &[Brink]) -> i64 {
        let extent = extent(own.iter().map(|brink| brink.at));
        let mut width = 0;
        for axis in (0..2).filter(|axis| extent[*axis] >= extent[1 - *axis]) {
            let along = |at: At| [at.0, at.1][axis];
            let ends = [
                (own.iter().map(|brink| along(brink.at)).min(), -1),
                (own.iter().map(|brink| along(brink.at)).max(), 1),
            ];
            let mut sum = extent[axis];
            for (end, sign) in ends {
                let way = if axis == 0 { (sign, 0) } else { (0, sign) };
                let last: Vec<&Brink> = own.iter().filter(|brink| Some(along(brink.at)) == end).collect();
                if last.iter().any(|brink| self.is_walled(plus(brink.at, way), brink.level)) {
                    sum += self.half[axis];
                }
            }
            width = width.max(sum);
        }
        width
    }
}

#[test]
fn leaks_are_those_of_brute_force() {
    let (mut kinds, mut split, mut wrong) = (BTreeMap::new(), 0, Vec::new());
    for seed in 0..cases(25) {
        let world = random_world(seed);
        let (places, leaks) = world.answers((50, 30));
        let expected = Truth::new(&world).leaks(places.keys().copied());
        let found = summary(&leaks);
        if found != expected {
            wrong.push(format!("seed {seed}, {:?}: {found:?} for {expected:?}", world.body));
        }
        for (kind, ..) in &expected {
            *kinds.entry(*kind).or_insert(0) += 1;
        }
        split += usize::from(expected.iter().map(|leak| leak.1).collect::<BTreeSet<_>>().len() > 1);
    }
    eprintln!("{kinds:?}, {split} scenes with different depths");
    assert!(wrong.is_empty(), "{}: {:#?}", wrong.len(), &wrong[..wrong.len().min(20)]);
    assert!(kinds.len() == 3 && split > 5, "{kinds:?}");
}
