//! Routes of random scenes: the walker arrives on each of them, wherever the scene is.

use super::{everywhere, flat, spot, way};
use crate::common::random::Random;
use nalgebra::{Point2, Point3};
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::page::Span;
use slicewalk::reach::{Pawn, Region, Route, Search, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use std::collections::BTreeMap;

pub(super) const T: f64 = 0.1;
pub(super) const SIGMA: f64 = 0.3;
/// Edge of a scene (pixels).
const EDGE: i64 = 70;
/// Height of the lowest floor (quanta).
const GROUND: i64 = 10 * SLICE_QUANTA;

fn quanta(metres: f64) -> i64 {
    (metres / SIGMA * SLICE_QUANTA as f64).round() as i64
}

/// Bottom and top (quanta), and whether it is an obstacle.
pub(super) type Solid = (i64, i64, bool);

/// Spans by pixel.
#[derive(Clone)]
pub(super) struct Scene(BTreeMap<(i64, i64), Vec<Solid>>);

impl Scene {
    fn rectangle(random: &mut Random, most: i64) -> [i64; 4] {
        let [w, h] = [0, 1].map(|_| 1 + random.below(most));
        let [x, y] = [w, h].map(|size| random.below(EDGE - size + 1));
        [x, y, x + w, y + h]
    }

    /// Replaces the content of a rectangle; `None` leaves a hole.
    fn fill(&mut self, [x, y, to_x, to_y]: [i64; 4], spans: impl Fn(i64, i64) -> Option<Solid>) {
        for (i, j) in (x..to_x).flat_map(|i| (y..to_y).map(move |j| (i, j))) {
            self.0.remove(&(i, j));
            if let Some(span) = spans(i, j) {
                self.0.insert((i, j), vec![span]);
            }
        }
    }

    pub(super) fn random(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut scene = Self(BTreeMap::new());
        let noise = [0.0, 0.0, 0.01, 0.03][random.below(4) as usize];
        let rough: Vec<i64> = (0..EDGE * EDGE).map(|_| quanta(random.between(-noise, noise))).collect();
        let floor = |i: i64, j: i64, z: i64| {
            let top = GROUND + z + rough[(i * EDGE + j) as usize];
            (top - 3, top, false)
        };
        scene.fill([0, 0, EDGE, EDGE], |i, j| Some(floor(i, j, 0)));
        for _ in 0..random.below(5) {
            // A block, the end of a ramp, or a stage.
            let height = [0.1, 0.17, 0.2, 0.34, 0.35, 0.36, 0.5, 1.0][random.below(8) as usize];
            let area = Self::rectangle(&mut random, 25);
            scene.fill(area, |i, j| Some(floor(i, j, quanta(height))));
        }
        for _ in 0..random.below(4) {
            let slope = random.between(0.1, 0.95);
            let area = Self::rectangle(&mut random, 25);
            let along = random.below(2) == 0;
            scene.fill(area, |i, j| {
                let far = if along { i - area[0] } else { j - area[1] };
                let (_, top, _) = floor(i, j, quanta(far as f64 * T * slope));
                Some((top - quanta(T * slope) - 3, top, false))
            });
        }
        if random.below(2) == 0 {
            // Stairs up to a gallery whose floor is thin.
            let riser = [0.15, 0.17, 0.25, 0.3, 0.35][random.below(5) as usize];
            let tread = 2 + random.below(4i64);
            let (x, y, width) = (random.below(20i64), random.below(40i64), 4 + random.below(12i64));
            let steps = 8i64;
            scene.fill([x, y, x + steps * tread, y + width], |i, j| {
                let step = (i - x) / tread + 1;
                Some(floor(i, j, quanta(riser * step as f64)))
            });
            let level = GROUND + quanta(riser * steps as f64);
            for (i, j) in (x + steps * tread..EDGE).flat_map(|i| (y..(y + width + 8).min(EDGE)).map(move |j| (i, j))) {
                let column = scene.0.entry((i, j)).or_default();
                if column.iter().all(|span| span.1 + SLICE_QUANTA < level) {
                    column.push((level - 3, level, false));
                }
            }
        }
        for _ in 0..random.below(4) {
            let most = [3, 12][random.below(2) as usize];
            let area = Self::rectangle(&mut random, most);
            scene.fill(area, |_, _| None);
        }
        for _ in 0..random.below(8) {
            // A wall, mostly with a gate exactly as wide as one of the bodies.
            let (at, gate, width) = (random.below(EDGE), random.below(EDGE - 8), 2 + random.below(6i64));
            let along = random.below(2) == 0;
            let area = if along { [at, 0, at + 1, EDGE] } else { [0, at, EDGE, at + 1] };
            let from = random.below(EDGE / 2);
            let kept = scene.clone();
            scene.fill(area, |i, j| {
                let far = if along { j } else { i };
                if (gate..gate + width).contains(&far) || far < from {
                    return kept.0.get(&(i, j)).map(|spans| spans[0]);
                }
                Some((GROUND - 3, GROUND + quanta(2.5), true))
            });
        }
        for _ in 0..random.below(30) {
            let (i, j) = (random.below(EDGE), random.below(EDGE));
            match random.below(3) {
                // A lintel or a lamp.
                0 => {
                    let column = scene.0.entry((i, j)).or_default();
                    let bottom = GROUND + quanta(random.between(1.0, 2.4));
                    if column.iter().all(|span| span.1 + SLICE_QUANTA < bottom) {
                        column.push((bottom, bottom + 20, true));
                    }
                }
                1 => {
                    scene.0.remove(&(i, j));
                }
                // An edge without floor.
                _ => {
                    for span in scene.0.entry((i, j)).or_default() {
                        span.2 = true;
                    }
                }
            }
        }
        scene
    }

    /// The scene rotated by quarter turns, mirrored, and moved by a number of pixels.
    fn store(&self, turns: u64, mirrored: bool, by: [i64; 2]) -> Snapshot {
        let span = |(bottom, top, steep): Solid| Span::new(bottom as u32, top as u32, steep).unwrap();
        let columns = self.columns(turns, mirrored, by, 0);
        flat::store(
            Frame::new(T, SIGMA).unwrap(),
            columns.map(|(at, spans)| (at, spans.into_iter().map(span).collect())),
        )
    }

    /// Returns its spans by pixel, turned by quarters and mirrored, moved by pixels and raised by quanta.
    pub(super) fn columns(
        &self,
        turns: u64,
        mirrored: bool,
        by: [i64; 2],
        rise: i64,
    ) -> impl Iterator<Item = ((i64, i64), Vec<Solid>)> {
        self.0.iter().filter(|(_, spans)| !spans.is_empty()).map(move |(&at, spans)| {
            let (i, j) = turned(at, turns, mirrored);
            let mut spans: Vec<Solid> = spans.iter().map(|span| (span.0 + rise, span.1 + rise, span.2)).collect();
            spans.sort_unstable();
            ((i + by[0], j + by[1]), spans)
        })
    }
}

fn turned((mut i, mut j): (i64, i64), turns: u64, mirrored: bool) -> (i64, i64) {
    if mirrored {
        i = EDGE - 1 - i;
    }
    for _ in 0..turns {
        (i, j) = (EDGE - 1 - j, i);
    }
    (i, j)
}

pub(super) fn bodies() -> [Body; 7] {
    let cube = |x, y, height| Body::Box { x, y, height };
    let cylinder = |radius, height| Body::Cylinder { radius, height };
    [
        cube(0.5, 0.5, 1.8),
        cube(0.4, 0.4, 1.6),
        cube(0.3, 0.6, 1.2),
        cube(0.45, 0.33, 1.8),
        cylinder(0.25, 1.8),
        cylinder(0.3, 1.2),
        cylinder(0.17, 1.6),
    ]
}

/// Follows a route with the walker of `slicetool walk`; returns where it ends.
fn walk(store: &Snapshot, body: Body, route: &Route, tick_s: f64) -> (State, Point3<f64>) {
    let mut walker = Walker::new(Config { tick_s, ..Config::new(body) }, route.points[0]).unwrap();
    let places: Vec<Point2<f64>> = route.points.iter().map(|point| point.xy()).collect();
    let mut waypoints = Waypoints::new(places).unwrap();
    for _ in 0..(2.0 * route.length_m / 1.4 * 60.0) as usize + 120 {
        walker.follow(store, 1.0 / 60.0, &mut waypoints);
        if walker.state() == State::Arrived {
            break;
        }
    }
    (walker.state(), walker.feet())
}

/// Number of scenes; `SLICEWALK_CASES` raises it.
fn cases() -> u64 {
    std::env::var("SLICEWALK_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(40)
}

#[test]
fn the_walker_arrives_on_every_route_of_random_scenes() {
    let (mut found, mut refused, mut lost) = (0, 0, Vec::new());
    for seed in 0..cases() {
        let scene = Scene::random(seed);
        let mut random = Random(seed ^ 0x5eed);
        let by = [0, 1].map(|_| random.below(64i64));
        let store = scene.store(random.below(4), random.below(2) == 0, by);
        let body = bodies()[random.below(7) as usize];
        let (mut standing, region) = everywhere(&store, Pawn::new(body));
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let mut search = Search::new();
        for _ in 0..if places.is_empty() { 0 } else { 12 } {
            let ends = [0, 1].map(|_| places[random.below(places.len())]);
            let [a, b] = ends.map(|at| spot(&mut standing, &store, at).unwrap());
            let Some(route) = way(&mut search, &store, &region, &a, &b) else {
                refused += 1;
                continue;
            };
            found += 1;
            for tick_s in [1.0 / 240.0, 1.0 / 60.0] {
                let (state, end) = walk(&store, body, &route, tick_s);
                if state != State::Arrived || (end - ends[1]).norm() > 0.01 {
                    lost.push(format!("seed {seed}, {body:?}, ticks of {tick_s}: {ends:?}, {state:?} at {end}"));
                }
            }
        }
    }
    eprintln!("{found} routes, {refused} pairs without, {} lost", lost.len());
    assert!(lost.is_empty(), "{} of {found}: {:#?}", lost.len(), &lost[..lost.len().min(5)]);
    assert!(found > cases() && refused > 0, "{found} found, {refused} not");
}

/// Reachable places, in the scene's own pixels.
fn places(region: &Region, turns: u64, mirrored: bool, by: [i64; 2]) -> Vec<(i64, i64, i64)> {
    let frame = Frame::new(T, SIGMA).unwrap();
    let back = |(mut i, mut j): (i64, i64)| {
        for _ in 0..turns {
            (i, j) = (j, EDGE - 1 - i);
        }
        (if mirrored { EDGE - 1 - i } else { i }, j)
    };
    let mut places: Vec<_> = region
        .places()
        .map(|place| {
            let (i, j) = back((frame.pixel_of(place.feet.x) - by[0], frame.pixel_of(place.feet.y) - by[1]));
            (i, j, frame.quantum_ceil(place.feet.z))
        })
        .collect();
    places.sort_unstable();
    places
}

#[test]
fn moving_turning_and_mirroring_a_scene_moves_turns_and_mirrors_what_is_reached() {
    let mut some = 0;
    for seed in 0..cases() {
        let scene = Scene::random(seed);
        let mut random = Random(seed ^ 0x1eaf);
        // As wide along x as along y, because a rotation swaps them.
        let body = bodies()[[0, 1, 4, 5, 6][random.below(5) as usize]];
        let start = (random.below(EDGE), random.below(EDGE));
        let reached = |turns: u64, mirrored: bool, by: [i64; 2]| {
            let store = scene.store(turns, mirrored, by);
            let (i, j) = turned(start, turns, mirrored);
            let at = Point3::new((i + by[0]) as f64 * T + 0.05, (j + by[1]) as f64 * T + 0.05, 3.2);
            let mut standing = StandingPlaces::new(&store, Pawn::new(body)).unwrap();
            let place = spot(&mut standing, &store, at)?;
            let region = super::grown(&mut standing, &store, slicewalk::reach::Flood::from(place));
            Some((places(&region, turns, mirrored, by), (region.area_m2() * 1e6).round()))
        };
        let expected = reached(0, false, [0, 0]);
        for _ in 0..3 {
            let (turns, mirrored) = (random.below(4), random.below(2) == 0);
            let by = [0, 1].map(|_| random.below(192i64));
            assert!(
                reached(turns, mirrored, by) == expected,
                "seed {seed}: {turns} turns, {mirrored}, moved by {by:?}"
            );
        }
        some += usize::from(expected.is_some_and(|(places, _)| places.len() > 200));
    }
    assert!(some as u64 > cases() / 3, "{some}");
}

/// Routes in real scans, between a few pairs of places each; `SLICEWALK_PAIRS` raises the number, `SLICEWALK_SCANS` is
/// the beginning of the names of the scans to test.
#[test]
fn the_walker_arrives_on_every_route_of_real_scans() {
    let Some(folder) = crate::data::folder() else { return };
    let pairs = std::env::var("SLICEWALK_PAIRS").ok().and_then(|pairs| pairs.parse().ok()).unwrap_or(6);
    let low = |x: f64| Body::Box { x, y: x, height: 1.6 };
    let scans = [
        ("indoor_two_storey_zup.laz", 0.05, 1.0, low(0.5)),
        ("indoor_two_storey_zup.laz", 0.1, 1.0, low(0.5)),
        ("room_single_station.laz", 0.1, 1.0, Body::Cylinder { radius: 0.25, height: 1.6 }),
        ("corridor_three_stations.laz", 0.1, 1.0, low(0.5)),
        ("pump_room.laz", 0.05, 1.0, Body::Cylinder { radius: 0.2, height: 1.2 }),
        ("forest_plot_tls.laz", 0.1, 1.0, low(0.4)),
        ("delft_city_block_ahn3.laz", 0.5, 1.0, low(0.5)),
        ("isprs_csite2_town.laz", 0.5, 1.0, Body::Cylinder { radius: 0.5, height: 1.8 }),
        ("autzen_stadium.laz", 1.0, 0.3048, low(1.0)),
    ];
    let mut lost = Vec::new();
    let chosen = std::env::var("SLICEWALK_SCANS").unwrap_or_default();
    for (name, pixel, unit, body) in scans.into_iter().filter(|scan| scan.0.starts_with(&chosen)) {
        let dir = tempfile::tempdir().unwrap();
        let mut options =
            slicewalk_convert::ConvertOptions::new(vec![folder.join(name)], dir.path().join("scan.slices"));
        options.grid.pixel = slicewalk_convert::PixelSize::Metres(pixel);
        options.reading.units = slicewalk_input::Units::Factor(unit);
        slicewalk_convert::convert(&options, &slicewalk::NoMonitor).unwrap();
        let archive = slicewalk::archive::Archive::open(dir.path().join("scan.slices")).unwrap();
        let store = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
        let (mut standing, region) = everywhere(&store, Pawn::new(body));
        let all: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let (mut random, mut search, mut found, mut starts) = (Random(7), Search::new(), 0, 0);
        while found < pairs && starts < 4 * pairs {
            starts += 1;
            let from = all[random.below(all.len())];
            let start = spot(&mut standing, &store, from).unwrap();
            let own = super::grown(&mut standing, &store, slicewalk::reach::Flood::from(start));
            let near: Vec<Point3<f64>> = own.places().map(|place| place.feet).collect();
            if near.len() < 200 {
                continue;
            }
            for _ in 0..(pairs / 10).max(2) {
                let to = near[random.below(near.len())];
                let goal = spot(&mut standing, &store, to).unwrap();
                let Some(route) = way(&mut search, &store, &own, &start, &goal) else {
                    eprintln!("{name}: reached, but no way from {from} to {to}");
                    continue;
                };
                found += 1;
                let (state, end) = walk(&store, body, &route, 1.0 / 240.0);
                if state != State::Arrived || (end - to).norm() > 0.01 {
                    lost.push(format!("{name} at {pixel} m, {body:?}: {from} to {to}, {state:?} at {end}"));
                }
            }
        }
        eprintln!("{name} at {pixel} m: {found} routes, {} lost so far", lost.len());
    }
    assert!(lost.is_empty(), "{lost:#?}");
}
