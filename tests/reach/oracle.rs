//! Standing places of random worlds compared with brute force.

use super::{everywhere, flat, grown, known};
use crate::common::part::Part;
use crate::common::random::Random;
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::page::Span;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, LeakSearch, Pawn, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::BTreeMap;

const T: f64 = 0.1;
const SIGMA: f64 = 0.3;
/// Edge of the world (pixels), across four tiles.
const FIRST: i64 = 40;
const EDGE: i64 = 48;

/// Spans by pixel: heights in quanta, and whether it is an obstacle.
pub type World = BTreeMap<(i64, i64), Vec<(i64, i64, bool)>>;

pub fn random_world(seed: u64) -> World {
    let mut random = Random(seed);
    let mut world = World::new();
    let shares = [4, 30, 60][seed as usize % 3];
    for (i, j) in (FIRST..FIRST + EDGE).flat_map(|i| (FIRST..FIRST + EDGE).map(move |j| (i, j))) {
        let mut spans = Vec::new();
        let mut low = 0i64;
        for _ in 0..4 {
            // Floors are mostly at a few heights, so that there are many standing places.
            let bottom = low + [255, 255 * 6, 300 + i64::from(random.below(600))][random.below(3) as usize];
            let top = bottom + i64::from(random.below(40));
            if random.below(100) >= shares {
                spans.push((bottom, top, random.below(4) == 0));
            }
            low = (top / SLICE_QUANTA + 2) * SLICE_QUANTA;
        }
        if !spans.is_empty() {
            world.insert((i, j), spans);
        }
    }
    world
}

pub fn store(world: &World) -> Snapshot {
    let span = |&(bottom, top, steep): &(i64, i64, bool)| Span::new(bottom as u32, top as u32, steep).unwrap();
    let columns = world.iter().map(|(at, spans)| (*at, spans.iter().map(span).collect()));
    flat::store(Frame::new(T, SIGMA).unwrap(), columns)
}

/// Returns whether the inside of the body in the middle of a pixel enters another one.
fn covers(body: &Body, dx: i64, dy: i64) -> bool {
    let gap = |d: i64| ((d.abs() as f64 - 0.5) * T).max(0.0);
    match *body {
        Body::Box { x, y, .. } => gap(dx) < x / 2.0 - 1e-9 && gap(dy) < y / 2.0 - 1e-9,
        Body::Cylinder { radius, .. } => gap(dx).hypot(gap(dy)) < radius - 1e-9,
    }
}

/// Tops at which the body fits, with the greatest height of floor near them (quanta).
fn tops(world: &World, body: &Body, (i, j): (i64, i64)) -> Vec<(i64, bool)> {
    let quantum = SIGMA / SLICE_QUANTA as f64;
    let height = (body.height() / quantum + 1e-6).floor() as i64 + 1;
    let near = (0.05 / quantum) as i64;
    let reach = (-8..=8).flat_map(|dx| (-8..=8).map(move |dy| (dx, dy)));
    let under: Vec<(i64, i64, bool)> = reach
        .filter(|(dx, dy)| covers(body, *dx, *dy))
        .flat_map(|(dx, dy)| world.get(&(i + dx, j + dy)).into_iter().flatten().copied())
        .collect();
    let mut tops: Vec<i64> = under.iter().map(|span| span.1).collect();
    tops.sort_unstable();
    tops.dedup();
    // Free from the top to the head.
    tops.retain(|top| !under.iter().any(|span| span.1 > *top && span.0 < top + height));
    let has_floor = |top: i64| under.iter().any(|span| !span.2 && span.1 <= top && span.1 >= top - near);
    tops.iter().map(|top| (*top, has_floor(*top))).collect()
}

fn places(world: &World, pawn: &Pawn) -> Vec<(i64, i64, i64)> {
    let quantum = SIGMA / SLICE_QUANTA as f64;
    let (near, up) = ((0.05 / quantum) as i64, (pawn.climb / quantum + 1e-6) as i64 + 1);
    let half = pawn.body.half() / T;
    let beside = [half.x, half.y].map(|half| ((half - 0.5 - 1e-6).ceil() as i64).max(0));
    let foot = beside[0].min(beside[1]).min(1);
    let area = || (FIRST - 9..FIRST + EDGE + 9).flat_map(|j| (FIRST - 9..FIRST + EDGE + 9).map(move |i| (i, j)));
    let all: BTreeMap<(i64, i64), Vec<(i64, bool)>> = area().map(|at| (at, tops(world, &pawn.body, at))).collect();
    let mut places = Vec::new();
    for (i, j) in area() {
        for &(top, has_floor) in &all[&(i, j)] {
            // 25 cm are two pixels.
            let [x, y] = beside.map(|beside| beside + 2);
            let mut beside = (-x..=x).flat_map(|dx| (-y..=y).map(move |dy| (i + dx, j + dy)));
            let mut is_edge = || {
                let near_top = |span: &(i64, i64, bool)| !span.2 && (span.1 - top).abs() <= near;
                beside.any(|at| world.get(&at).into_iter().flatten().any(near_top))
            };
            let matter = (-foot..=foot).flat_map(|dx| (-foot..=foot).map(move |dy| (i + dx, j + dy)));
            let mut matter = matter.flat_map(|at| world.get(&at).into_iter().flatten());
            if (has_floor || is_edge()) && matter.any(|span| span.1 <= top && span.1 >= top - up) {
                places.push((i, j, top));
            }
        }
    }
    places.sort_unstable();
    places
}

#[test]
fn standing_places_are_those_of_brute_force() {
    let mut found_some = 0;
    for seed in 0..6 {
        let world = random_world(seed);
        let store = store(&world);
        for body in [
            Body::Box { x: 0.5, y: 0.5, height: 1.2 },
            Body::Box { x: 0.2, y: 0.7, height: 0.8 },
            Body::Box { x: 0.05, y: 0.05, height: 1.8 },
            Body::Cylinder { radius: 0.3, height: 1.2 },
            Body::Cylinder { radius: 0.52, height: 0.5 },
        ] {
            let pawn = Pawn::new(body);
            let (_, region) = everywhere(&store, pawn);
            let frame = store.frame();
            let mut found: Vec<(i64, i64, i64)> = region
                .places()
                .map(|place| {
                    let feet = place.feet;
                    (frame.pixel_of(feet.x), frame.pixel_of(feet.y), frame.quantum_ceil(feet.z))
                })
                .collect();
            found.sort_unstable();
            let inside = |at: &(i64, i64, i64)| (0..128).contains(&at.0) && (0..128).contains(&at.1);
            let expected: Vec<_> = places(&world, &pawn).into_iter().filter(inside).collect();
            assert_eq!(found, expected, "seed {seed}, {body:?}");
            found_some += usize::from(found.len() > 300);
        }
    }
    assert!(found_some > 10, "{found_some} worlds have places");
}

#[test]
fn the_order_of_tiles_and_pages_does_not_show() {
    let world = random_world(1);
    let whole = store(&world);
    let pawn = Pawn::new(Body::Cylinder { radius: 0.25, height: 1.2 });
    let (_, expected) = everywhere(&whole, pawn);
    let mut random = Random(5);
    for _ in 0..4 {
        let mut standing = StandingPlaces::new(&whole, pawn).unwrap();
        for _ in 0..5 {
            let [x, y] = [0, 1].map(|_| f64::from(random.below(128)) * T);
            known(standing.spot(&whole, [x, y, 1.0].into()).unwrap());
        }
        let flood = known(Flood::everywhere(&mut standing, &whole).unwrap());
        let region = grown(&mut standing, &whole, flood);
        assert_eq!(region.len(), expected.len());
        assert!(region.places().eq(expected.places()));
        assert_eq!(region.passages(), expected.passages());
        assert_eq!(region.storeys(), expected.storeys());
    }
}

#[test]
fn what_is_not_loaded_is_asked_for_and_never_guessed() {
    let world = random_world(0);
    let whole = store(&world);
    let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.2 });
    let (mut standing, region) = everywhere(&whole, pawn);
    let leaks = known(LeakSearch::new(&region).find(&mut standing, &whole).unwrap());
    let mut partly = Part::new(whole.clone());
    let mut standing = StandingPlaces::new(&partly, pawn).unwrap();
    let mut waits = 0;
    let mut load = |partly: &mut Part, missing: slicewalk::store::Missing| {
        waits += 1;
        assert_eq!(partly.load(&missing.keys()[..1]), 1);
    };
    let mut flood = loop {
        match Flood::everywhere(&mut standing, &partly).unwrap() {
            Answer::Known(flood) => break flood,
            Answer::NotLoaded(missing) => load(&mut partly, missing),
        }
    };
    while let Answer::NotLoaded(missing) = flood.grow(&mut standing, &partly, &slicewalk::NoMonitor).unwrap() {
        load(&mut partly, missing);
    }
    let found = flood.region(&standing);
    assert!(found.places().eq(region.places()));
    assert_eq!(known(LeakSearch::new(&found).find(&mut standing, &partly).unwrap()), leaks);
    assert_eq!(waits, 4, "four pages, one at a time");
    // A search for leaks continues where it waited, also in the middle of a gap.
    assert!(!leaks.is_empty());
    let mut partly = Part::new(whole.clone());
    let mut standing = StandingPlaces::new(&partly, pawn).unwrap();
    let mut search = LeakSearch::new(&region);
    let again = loop {
        match search.find(&mut standing, &partly).unwrap() {
            Answer::Known(leaks) => break leaks,
            Answer::NotLoaded(missing) => assert_eq!(partly.load(&missing.keys()[..1]), 1),
        }
    };
    assert_eq!(again, leaks);
    assert_eq!(known(search.find(&mut standing, &partly).unwrap()), leaks, "again, from the start");
}
