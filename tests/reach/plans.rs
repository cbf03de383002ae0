//! Routes as tasks, guided searches, and long routes along coarse ones.

use super::flat::{self, FLOOR, T, room};
use super::{everywhere, known, reached, spot, way};
use crate::common::part::Part;
use crate::common::random::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::frame::Frame;
use slicewalk::page::Span;
use slicewalk::query::Answer;
use slicewalk::reach::{Pawn, Planned, Planner, Refusal, Route, RouteRefiner, Search};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::HashSet;

/// A pawn as wide as a pixel, which stands on each pixel of floor.
pub fn thin() -> Pawn {
    Pawn::new(Body::Box { x: T, y: T, height: 1.0 })
}

pub fn at(i: usize, j: usize) -> Point3<f64> {
    Point3::new((i as f64 + 0.5) * T, (j as f64 + 0.5) * T, FLOOR)
}

/// A hall of `width` by 60 pixels with a cross wall every 100 pixels; the gaps are on alternating sides.
fn hall(width: usize, gap: usize) -> Snapshot {
    room(width, 60, |i, j| {
        let is_gap = if i / 100 % 2 == 0 { j < 1 + gap } else { j > 58 - gap };
        (i % 100 == 99 && !is_gap).then_some(b'#')
    })
}

/// Runs a task to its end, in slices of `steps` steps.
pub fn finish(planner: &mut Planner, set: &Snapshot, steps: usize) -> (Result<Route, Refusal>, usize) {
    for turns in 1.. {
        match planner.advance(set, steps, &NoMonitor).unwrap() {
            Planned::Done(found) => return (found, turns),
            Planned::NotLoaded(missing) => panic!("{missing:?}"),
            _ => {}
        }
    }
    unreachable!()
}

#[test]
fn a_task_goes_on_step_by_step_to_the_same_route() {
    let store = hall(420, 8);
    let plan = |steps: usize, to: Point3<f64>| {
        let mut planner = Planner::new(&store, thin(), at(5, 30), to).unwrap();
        let (found, turns) = finish(&mut planner, &store, steps);
        assert!(found.is_err() || planner.peak_bytes() > 0);
        (found, turns)
    };
    let (whole, turns) = plan(usize::MAX, at(415, 30));
    assert!(turns <= 4, "{turns}");
    let (mut standing, region) = everywhere(&store, thin());
    let [a, b] = [at(5, 30), at(415, 30)].map(|at| spot(&mut standing, &store, at).unwrap());
    let expected = way(&mut Search::new(), &store, &region, &a, &b).unwrap();
    assert!((whole.as_ref().unwrap().length_m - expected.length_m).abs() < 0.01 * expected.length_m);
    let (in_steps, turns) = plan(500, at(415, 30));
    assert_eq!(in_steps, whole);
    assert!(turns > 20, "{turns}");
    assert_eq!(plan(500, at(199, 30)).0, Err(Refusal::NotStandingTo));
    let closed = hall(420, 0);
    let mut planner = Planner::new(&closed, thin(), at(5, 30), at(415, 30)).unwrap();
    assert_eq!(finish(&mut planner, &closed, 500).0, Err(Refusal::NotConnected));
}

#[test]
fn a_task_that_is_bounded_looks_no_farther_than_ways_so_long_lead() {
    // The only gap is 100 pixels to the side of the straight line.
    let store = room(60, 200, |i, j| (i == 30 && j < 180).then_some(b'#'));
    let plan = |most: Option<f64>| {
        let mut planner = Planner::new(&store, thin(), at(5, 80), at(55, 80)).unwrap();
        if let Some(most) = most {
            planner = planner.within(most);
        }
        (finish(&mut planner, &store, usize::MAX).0, planner.peak_bytes())
    };
    let (whole, bytes) = plan(None);
    let length = whole.clone().unwrap().length_m;
    assert!(length > 3.0 * 50.0 * T, "{length}");
    assert_eq!(plan(Some(length)).0, whole);
    let (short, few) = plan(Some(1.1 * 50.0 * T));
    assert_eq!(short, Err(Refusal::NotConnected));
    assert!(few < bytes, "{few} of {bytes} bytes");
}

#[test]
fn a_task_names_the_pages_that_it_needs_and_stops_when_it_is_asked_to() {
    struct Stops;
    impl slicewalk::Monitor for Stops {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let store = hall(1000, 8);
    let mut partly = Part::new(store.clone());
    let mut planner = Planner::new(&partly, thin(), at(5, 30), at(95, 40)).unwrap();
    let mut loaded = 0;
    let found = loop {
        match planner.advance(&partly, usize::MAX, &NoMonitor).unwrap() {
            Planned::Done(found) => break found,
            Planned::NotLoaded(missing) => loaded += partly.load(missing.keys()),
            _ => {}
        }
    };
    let mut whole = Planner::new(&store, thin(), at(5, 30), at(95, 40)).unwrap();
    assert_eq!(found, finish(&mut whole, &store, usize::MAX).0);
    assert!((2..8).contains(&loaded), "{loaded} of 16 pages");
    let mut planner = Planner::new(&store, thin(), at(5, 30), at(995, 30)).unwrap();
    assert!(matches!(planner.advance(&store, usize::MAX, &Stops), Err(slicewalk::Error::Interrupted)));
}

#[test]
fn a_prepared_region_gives_as_good_routes_and_looks_at_less() {
    let store = hall(700, 10);
    let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
    let (mut standing, region) = everywhere(&store, pawn);
    let mut prepared = region.clone();
    prepared.prepare(&NoMonitor).unwrap();
    assert_eq!(prepared.memory_bytes() - region.memory_bytes(), 32 * region.len());
    let (mut plain, mut guided, mut random) = (Search::new(), Search::new(), Random(4));
    let (mut looked_at, mut found) = ([0, 0], 0);
    while found < 60 {
        let [from, to] = [0, 1].map(|_| at(3 + random.below(690) as usize, 3 + random.below(54) as usize));
        let [a, b] = [from, to].map(|at| spot(&mut standing, &store, at));
        let (Some(a), Some(b)) = (a, b) else { continue };
        let [one, other] = [way(&mut plain, &store, &region, &a, &b), way(&mut guided, &store, &prepared, &a, &b)];
        let (one, other) = (one.unwrap(), other.unwrap());
        // Of equal cost; straightening may make a small difference.
        assert!((one.length_m - other.length_m).abs() <= 0.03 * one.length_m, "{from} to {to}: {one:?}, {other:?}");
        looked_at[0] += plain.looked_at();
        looked_at[1] += guided.looked_at();
        found += 1;
    }
    eprintln!("{looked_at:?} places looked at");
    assert!(looked_at[1] * 2 < looked_at[0], "{looked_at:?}");
    // From an enclosed part, the guide reports at once that there is no route.
    let closed = room(300, 60, |i, _| (i == 200).then_some(b'#'));
    let (mut standing, mut region) = everywhere(&closed, pawn);
    region.prepare(&NoMonitor).unwrap();
    let [a, b] = [at(20, 30), at(260, 30)].map(|at| spot(&mut standing, &closed, at).unwrap());
    let mut search = Search::new();
    assert_eq!((way(&mut search, &closed, &region, &a, &b), search.looked_at()), (None, 0));
    assert_eq!(way(&mut search, &closed, &region, &b, &a), None);
}

#[test]
#[ignore = "slow: .ci/run"]
fn the_exact_way_along_a_coarse_one_takes_little_memory() {
    // 450 m.
    let (width, pawn) = (4500, Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 }));
    let store = hall(width, 20);
    let (from, to) = (at(5, 30), at(width - 6, 30));
    let (mut standing, region) = everywhere(&store, pawn);
    let [a, b] = [from, to].map(|at| spot(&mut standing, &store, at).unwrap());
    let best = way(&mut Search::new(), &store, &region, &a, &b).unwrap();
    // Length of the route without walls.
    let empty = room(width, 60, |_, _| None);
    let (mut other, free) = everywhere(&empty, pawn);
    let [c, d] = [from, to].map(|at| spot(&mut other, &empty, at).unwrap());
    let straight = way(&mut Search::new(), &empty, &free, &c, &d).unwrap();
    for (guide, distance, longest) in [(&best, 1.0, 1.01), (&straight, 4.0, 1.05), (&straight, 0.5, 1.1)] {
        let mut along = RouteRefiner::new(pawn, from, to, guide, distance);
        let found = known(along.advance(&store, &NoMonitor).unwrap()).unwrap();
        assert!(
            (0.999..longest).contains(&(found.length_m / best.length_m)),
            "{} of {}",
            found.length_m,
            best.length_m
        );
        let [first, last] = [found.points[0], found.points[found.points.len() - 1]];
        assert!((first - from).norm() < 0.01 && (last - to).norm() < 0.01);
        // Every segment can be walked straight.
        for pair in found.points.windows(2) {
            let ends = [pair[0], pair[1]].map(|at| spot(&mut standing, &store, at).unwrap());
            let direct = way(&mut Search::new(), &store, &region, &ends[0], &ends[1]).unwrap();
            assert!((direct.length_m - (pair[1] - pair[0]).norm()).abs() < 0.01, "{pair:?}");
        }
        let whole = standing.memory_bytes() + region.memory_bytes();
        assert!((whole / 50..whole / 2).contains(&along.peak_bytes()), "{} of {whole}", along.peak_bytes());
    }
    let closed = hall(width, 0);
    let mut along = RouteRefiner::new(pawn, from, to, &straight, 1.0);
    assert_eq!(along.advance(&closed, &NoMonitor).unwrap(), Answer::Known(Err(Refusal::NotConnected)));
    let mut along = RouteRefiner::new(pawn, from, at(99, 40), &straight, 1.0);
    assert_eq!(known(along.advance(&store, &NoMonitor).unwrap()), Err(Refusal::NotStandingTo));
}

#[test]
fn an_end_in_a_wall_is_moved_if_asked_for() {
    let store = hall(90, 8);
    let plan = |snap: f64, from: Point3<f64>, to: Point3<f64>| {
        let mut planner = Planner::new(&store, thin(), from, to).unwrap().snapping(snap);
        finish(&mut planner, &store, usize::MAX).0
    };
    let (inside, wall) = (at(50, 30), at(0, 30));
    for snap in [0.0, 0.9 * T] {
        assert_eq!(plan(snap, wall, inside), Err(Refusal::NotStandingFrom));
        assert_eq!(plan(snap, inside, wall), Err(Refusal::NotStandingTo));
    }
    // The floor begins a pixel farther on.
    let [away, back] = [plan(1.1 * T, wall, inside), plan(1.1 * T, inside, wall)].map(Result::unwrap);
    for end in [away.points[0], back.points[back.points.len() - 1]] {
        assert!((end - at(1, 30)).norm() < 1e-6, "{end}");
    }
}

/// Asks with few pages in memory, those that were missing last. Returns the answer and how often a page was missing again.
fn with_few_pages<T>(store: &Snapshot, mut ask: impl FnMut(&Snapshot) -> Answer<T>) -> (T, usize) {
    const FEW: usize = 5;
    let (mut keys, mut asked, mut again) = (Vec::new(), HashSet::new(), 0);
    for _ in 0..1000 {
        match ask(&store.keep_loaded(|key| keys.contains(&key))) {
            Answer::Known(found) => return (found, again),
            Answer::NotLoaded(missing) => {
                again += missing.keys().iter().filter(|key| !asked.insert(**key)).count();
                keys.extend(missing.keys());
            }
        }
        keys.drain(..keys.len().saturating_sub(FEW));
    }
    panic!("it does not end")
}

#[test]
fn a_search_continues_where_it_was_if_pages_are_evicted_meanwhile() {
    let (store, (from, to)) = (hall(420, 12), (at(5, 30), at(415, 30)));
    // A single stretch over more pages than fit.
    let (open, ends) = (room(420, 20, |_, _| None), (at(8, 10), at(410, 10)));
    let round = Pawn::new(Body::Cylinder { radius: 0.25, height: 1.0 });
    for (store, (from, to)) in [(&store, (from, to)), (&open, ends)] {
        for (pawn, length) in [(thin(), None), (round, Some(0.9))] {
            let planner = || Planner::new(store, pawn, from, to).unwrap().drawn_out(length);
            let mut few = planner();
            let (found, again) = with_few_pages(store, |set| {
                loop {
                    match few.advance(set, 1000, &NoMonitor).unwrap() {
                        Planned::Done(found) => return Answer::Known(found),
                        Planned::NotLoaded(missing) => return Answer::NotLoaded(missing),
                        _ => {}
                    }
                }
            });
            let expected = finish(&mut planner(), store, usize::MAX).0;
            assert!(expected.is_ok() && found == expected, "{length:?}: {found:?}, {expected:?}");
            // Walkers follow the route from its start, whose pages the search has left behind.
            assert!(again > 0, "{length:?}: no page was missing again");
        }
    }
    let guide = finish(&mut Planner::new(&store, thin(), from, to).unwrap(), &store, usize::MAX).0.unwrap();
    let refiner = || RouteRefiner::new(thin(), from, to, &guide, 1.0);
    let mut few = refiner();
    let (found, again) = with_few_pages(&store, |set| few.advance(set, &NoMonitor).unwrap());
    let expected = known(refiner().advance(&store, &NoMonitor).unwrap());
    assert!(expected.is_ok() && found == expected, "{found:?}, {expected:?}");
    assert!(again > 0, "no page was missing again");
}

#[test]
fn steps_that_only_walkers_refuse_are_the_same_with_few_pages() {
    // A corridor over seven pages. Walkers sink behind a sill and would have to climb 0.38 m, more than from place to place.
    const SILL: i64 = 19;
    let pixels = (0..420i64).flat_map(|i| (0..5i64).map(move |j| (i, j)));
    let columns = pixels.map(|(i, j)| {
        let is_wall = i == 0 || j == 0 || i == 419 || j == 4;
        let height = match i {
            _ if is_wall => 2.7,
            SILL => 0.06,
            _ if i > SILL + 2 => 0.38,
            _ => 0.0,
        };
        let top = 2550 + (height / 0.3 * 255.0f64).round() as u32;
        ((i, j), vec![Span::new(2547, top, is_wall).unwrap()])
    });
    let store = flat::store(Frame::new(T, 0.3).unwrap(), columns);
    let pawn = Pawn::new(Body::Cylinder { radius: 0.083, height: 0.8 });
    let (from, to) = (at(8, 2), at(410, 2) + Vector3::z() * 0.4);
    let (mut standing, region) = reached(&store, pawn, from.into());
    let [a, b] = [from, to].map(|at| spot(&mut standing, &store, at).unwrap());
    assert!(region.holds(&b));
    assert_eq!(way(&mut Search::new(), &store, &region, &a, &b), None);
    let mut few = Search::new();
    let (found, _) = with_few_pages(&store, |set| few.route(set, &region, &a, &b, &NoMonitor).unwrap());
    assert_eq!(found, None);
}

#[test]
fn a_way_along_a_coarse_one_stays_on_its_storey() {
    // Two floors of 170 m, 2.4 m above one another, and a ramp between them at the start.
    const EDGE: f64 = 0.25;
    let top = |z: f64| 2550 + (z / 0.3 * 255.0).round() as u32;
    let floor = |z: f64| Span::new(top(z) - 3, top(z), false).unwrap();
    let pixels = (0..680i64).flat_map(|i| (0..6i64).map(move |j| (i, j)));
    let columns = pixels.map(|(i, j)| {
        let spans = match i {
            ..48 => vec![floor(0.0)],
            48..60 if j < 3 => vec![Span::new(2547, top((i - 47) as f64 * 0.2), false).unwrap()],
            48..60 => vec![floor(0.0)],
            _ => vec![floor(0.0), floor(2.4)],
        };
        ((i, j), spans)
    });
    let store = flat::store(Frame::new(EDGE, 0.3).unwrap(), columns);
    let pawn = Pawn::new(Body::Box { x: EDGE, y: EDGE, height: 1.0 });
    let at = |i: i64, z: f64| Point3::new((i as f64 + 0.5) * EDGE, 1.5 * EDGE, FLOOR + z);
    let (from, to) = (at(2, 0.0), at(670, 2.4));
    let mut guide = finish(&mut Planner::new(&store, pawn, from, at(9, 0.0)).unwrap(), &store, usize::MAX).0.unwrap();
    guide.points = vec![at(46, 0.0), at(62, 2.4)];
    let found = known(RouteRefiner::new(pawn, from, to, &guide, 1.0).advance(&store, &NoMonitor).unwrap()).unwrap();
    assert!((found.length_m - 167.9).abs() < 1.0, "{} m", found.length_m);
    assert!((found.points[found.points.len() - 1] - to).norm() < 0.01);
}

#[test]
fn a_way_along_a_coarse_one_is_refused_if_an_end_is_in_a_wall_or_the_coarse_one_leads_back() {
    let store = room(640, 20, |_, _| None);
    let (from, to, wall) = (at(5, 10), at(15, 10), at(0, 10));
    let mut guide = finish(&mut Planner::new(&store, thin(), from, to).unwrap(), &store, usize::MAX).0.unwrap();
    for (ends, between, refusal) in [
        ([from, to], vec![], None),
        ([wall, to], vec![], Some(Refusal::NotStandingFrom)),
        ([from, wall], vec![], Some(Refusal::NotStandingTo)),
        // The place 120 m along it, to which the first piece is planned, is its start.
        ([from, to], vec![at(605, 10), from], Some(Refusal::NotConnected)),
    ] {
        guide.points = between;
        let found =
            known(RouteRefiner::new(thin(), ends[0], ends[1], &guide, 1.0).advance(&store, &NoMonitor).unwrap());
        assert_eq!(found.err(), refusal, "{ends:?} along {:?}", guide.points);
    }
    // From the air, it begins on the floor below.
    guide.points.clear();
    let [low, high] = [from, from + Vector3::z()].map(|from| {
        known(RouteRefiner::new(thin(), from, to, &guide, 1.0).advance(&store, &NoMonitor).unwrap()).unwrap()
    });
    assert_eq!(low, high);
}
