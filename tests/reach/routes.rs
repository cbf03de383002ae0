//! Routes compared with exhaustive search and exact any-angle routes.

use super::flat::{FLOOR, T, room};
use super::{everywhere, spot, way};
use crate::common::random::Random;
use nalgebra::Point3;
use slicewalk::reach::{Pawn, Search};
use slicewalk::walk::Body;
use std::collections::{HashSet, VecDeque};

/// A pawn as wide as a pixel, which stands on each pixel of floor.
fn thin() -> Pawn {
    Pawn::new(Body::Box { x: T, y: T, height: 1.0 })
}

fn random_walls(seed: u64, edge: usize, share: u32) -> HashSet<(usize, usize)> {
    let mut random = Random(seed);
    let mut walls = HashSet::new();
    for _ in 0..share {
        let [i, j] = [0, 1].map(|_| 1 + random.below(edge as u32 - 2) as usize);
        let (along, length) = (random.below(2) == 0, 1 + random.below(5) as usize);
        walls.extend((0..length).map(|n| if along { (i + n, j) } else { (i, j + n) }));
    }
    walls
}

fn at(pixel: (usize, usize)) -> Point3<f64> {
    Point3::new((pixel.0 as f64 + 0.5) * T, (pixel.1 as f64 + 0.5) * T, FLOOR)
}

/// Pixels reachable along the axes.
fn exhaustive(free: impl Fn((usize, usize)) -> bool, from: (usize, usize)) -> HashSet<(usize, usize)> {
    let (mut seen, mut open) = (HashSet::from([from]), VecDeque::from([from]));
    while let Some((i, j)) = open.pop_front() {
        for to in [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)] {
            if free(to) && seen.insert(to) {
                open.push_back(to);
            }
        }
    }
    seen
}

#[test]
fn a_route_is_found_just_where_exhaustive_search_finds_one() {
    let (mut found, mut refused) = (0, 0);
    for seed in 0..12 {
        let edge = 70;
        let walls = random_walls(seed, edge, 700);
        let free = |(i, j): (usize, usize)| i > 0 && j > 0 && i < edge - 1 && j < edge - 1 && !walls.contains(&(i, j));
        let store = room(edge, edge, |i, j| walls.contains(&(i, j)).then_some(b'#'));
        let (mut standing, mut region) = everywhere(&store, thin());
        if seed % 2 == 1 {
            region.prepare(&slicewalk::NoMonitor).unwrap();
        }
        let (mut random, mut search) = (Random(seed), Search::new());
        for _ in 0..40 {
            let [from, to] = [0, 1].map(|_| (random.below(70) as usize, random.below(70) as usize));
            let [a, b] = [from, to].map(|pixel| spot(&mut standing, &store, at(pixel)));
            assert_eq!([a.is_some(), b.is_some()], [free(from), free(to)], "seed {seed}");
            let (Some(a), Some(b)) = (a, b) else { continue };
            let route = way(&mut search, &store, &region, &a, &b);
            assert_eq!(route.is_some(), exhaustive(free, from).contains(&to), "seed {seed}: {from:?} to {to:?}");
            found += usize::from(route.is_some());
            refused += usize::from(route.is_none());
        }
    }
    assert!(found > 100 && refused > 20, "{found} found, {refused} not");
}

/// Returns whether a square of one pixel can move straight between the middles of two pixels.
fn sees(free: &impl Fn((usize, usize)) -> bool, a: (usize, usize), b: (usize, usize)) -> bool {
    let steps = 64 * (a.0.abs_diff(b.0) + a.1.abs_diff(b.1)).max(1);
    (0..=steps).all(|n| {
        let share = n as f64 / steps as f64;
        let [x, y] = [(a.0, b.0), (a.1, b.1)].map(|(a, b)| a as f64 + share * (b as f64 - a as f64));
        let corners = |v: f64| [(v + 1e-9).floor() as usize, (v - 1e-9).ceil() as usize];
        corners(x).into_iter().all(|i| corners(y).into_iter().all(|j| free((i, j))))
    })
}

/// Length of the shortest route over middles of pixels connected by straight moves (pixels).
fn optimum(
    free: &impl Fn((usize, usize)) -> bool,
    edge: usize,
    from: (usize, usize),
    to: (usize, usize),
) -> Option<f64> {
    // A route bends only at corners of walls.
    let is_wall = |(i, j): (usize, usize)| !free((i, j));
    let near_corner = |&(i, j): &(usize, usize)| {
        [(1, 1), (1, -1), (-1, 1), (-1, -1)].into_iter().any(|(dx, dy): (isize, isize)| {
            let (x, y) = (i.wrapping_add_signed(dx), j.wrapping_add_signed(dy));
            is_wall((x, y)) && free((x, j)) && free((i, y))
        })
    };
    let inner = (1..edge - 1).flat_map(|i| (1..edge - 1).map(move |j| (i, j))).filter(|pixel| free(*pixel));
    let mut nodes: Vec<(usize, usize)> = inner.filter(near_corner).collect();
    nodes.extend([from, to]);
    let (mut far, mut done) = (vec![f64::INFINITY; nodes.len()], vec![false; nodes.len()]);
    far[nodes.len() - 2] = 0.0;
    loop {
        let next =
            (0..nodes.len()).filter(|n| !done[*n] && far[*n].is_finite()).min_by(|a, b| far[*a].total_cmp(&far[*b]))?;
        if next == nodes.len() - 1 {
            return Some(far[next]);
        }
        done[next] = true;
        for other in 0..nodes.len() {
            let (a, b) = (nodes[next], nodes[other]);
            let length = (a.0 as f64 - b.0 as f64).hypot(a.1 as f64 - b.1 as f64);
            if !done[other] && far[next] + length < far[other] && sees(free, a, b) {
                far[other] = far[next] + length;
            }
        }
    }
}

#[test]
fn routes_are_at_most_a_twentieth_longer_than_the_shortest_way() {
    let edge = 30;
    let (mut worst, mut compared) = (1.0f64, 0);
    for seed in 0..10 {
        let walls = random_walls(100 + seed, edge, 45);
        let free = |(i, j): (usize, usize)| i > 0 && j > 0 && i < edge - 1 && j < edge - 1 && !walls.contains(&(i, j));
        let store = room(edge, edge, |i, j| walls.contains(&(i, j)).then_some(b'#'));
        let (mut standing, mut region) = everywhere(&store, thin());
        if seed % 2 == 1 {
            region.prepare(&slicewalk::NoMonitor).unwrap();
        }
        let (mut random, mut search) = (Random(seed), Search::new());
        for _ in 0..12 {
            let [from, to] = [0, 1].map(|_| (random.below(30) as usize, random.below(30) as usize));
            let [a, b] = [from, to].map(|pixel| spot(&mut standing, &store, at(pixel)));
            let (Some(a), Some(b)) = (a, b) else { continue };
            let route = way(&mut search, &store, &region, &a, &b);
            let best = optimum(&free, edge, from, to);
            assert_eq!(route.is_some(), best.is_some(), "seed {seed}: {from:?} to {to:?}");
            let (Some(route), Some(best)) = (route, best.map(|pixels| pixels * T)) else { continue };
            assert!(route.length_m >= best - 1e-9, "seed {seed}: shorter than the shortest, {from:?} to {to:?}");
            assert!(
                route.length_m <= 1.05 * best + 1e-9,
                "seed {seed}: {} for {best}, {from:?} to {to:?}",
                route.length_m
            );
            let ends = [route.points[0], route.points[route.points.len() - 1]];
            assert!((ends[0] - at(from)).norm() < 0.01 && (ends[1] - at(to)).norm() < 0.01);
            (worst, compared) = (worst.max(route.length_m / best.max(T)), compared + 1);
        }
    }
    assert!(compared > 60, "{compared}");
    eprintln!("{compared} routes, at worst {worst:.4} of the shortest way");
}

#[test]
fn a_search_stops_when_it_is_asked_to() {
    struct Stops;
    impl slicewalk::Monitor for Stops {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let store = room(190, 190, |_, _| None);
    let (mut standing, region) = everywhere(&store, thin());
    let [a, b] = [(2, 2), (187, 180)].map(|pixel| spot(&mut standing, &store, at(pixel)).unwrap());
    // With a free view the search ends at once; behind a wall without a door it examines much.
    let walled = room(190, 190, |i, _| (i == 100).then_some(b'#'));
    let (mut other, halves) = everywhere(&walled, thin());
    let [c, d] = [(2, 2), (187, 180)].map(|pixel| spot(&mut other, &walled, at(pixel)).unwrap());
    assert!(matches!(Search::new().route(&walled, &halves, &c, &d, &Stops), Err(slicewalk::Error::Interrupted)));
    assert!(way(&mut Search::new(), &store, &region, &a, &b).is_some());
    assert!(way(&mut Search::new(), &walled, &halves, &c, &d).is_none());
}

/// Heights of a world of floor (m), by pixel, as a store.
fn hills(edge: usize, height: impl Fn(usize, usize) -> f64) -> slicewalk::store::Snapshot {
    let frame = slicewalk::frame::Frame::new(T, 0.3).unwrap();
    let pixels = (0..edge).flat_map(|i| (0..edge).map(move |j| (i, j)));
    let columns = pixels.map(|(i, j)| {
        let top = ((FLOOR + height(i, j)) / 0.3 * 255.0).round() as u32;
        ((i as i64, j as i64), vec![slicewalk::page::Span::new(top - 200, top, false).unwrap()])
    });
    super::flat::store(frame, columns)
}

#[test]
fn lengths_count_heights_and_ways_lead_around_ridges() {
    let edge = 90;
    // A ridge across the straight line, lower towards one side; a cone; a hollow; rough ground.
    let ridge = |i: usize, j: usize| {
        let across = (1.0 - (i as f64 - 45.0).abs() * T / 3.0).max(0.0);
        2.4 * across * (j as f64 / 60.0).min(1.0)
    };
    let cone = |i: usize, j: usize| (3.0 - (i as f64 - 45.0).hypot(j as f64 - 45.0) * T).max(0.0) * 0.8;
    let rough = |i: usize, j: usize| 0.02 * f64::from(((i * 7 + j * 13) % 5) as u8);
    let worlds: [&dyn Fn(usize, usize) -> f64; 4] =
        [&ridge, &cone, &|i, j| 3.0 - cone(i, j), &|i, j| ridge(i, j) + rough(i, j)];
    for (number, height) in worlds.into_iter().enumerate() {
        let store = hills(edge, height);
        let (mut standing, region) = everywhere(&store, thin());
        let (mut random, mut search, mut worst) = (Random(number as u64), Search::new(), 1.0f64);
        // Exact: all straight lines between places of a coarser grid, with the heights below them.
        let nodes: Vec<(usize, usize)> = (0..15).flat_map(|i| (0..15).map(move |j| (3 + 6 * i, 3 + 6 * j))).collect();
        let line = |a: (usize, usize), b: (usize, usize)| {
            let far = (a.0 as f64 - b.0 as f64).hypot(a.1 as f64 - b.1 as f64);
            let steps = (far / 3.0).ceil().max(1.0) as usize;
            let z = |n: usize| {
                let share = n as f64 / steps as f64;
                let [i, j] = [(a.0, b.0), (a.1, b.1)].map(|(a, b)| a as f64 + share * (b as f64 - a as f64));
                height(i.round() as usize, j.round() as usize)
            };
            (0..steps).map(|n| (far * T / steps as f64).hypot(z(n + 1) - z(n))).sum::<f64>()
        };
        for _ in 0..6 {
            let [from, to] = [0, 1].map(|_| random.below(nodes.len()));
            let mut far = vec![f64::INFINITY; nodes.len()];
            let mut done = vec![false; nodes.len()];
            far[from] = 0.0;
            while let Some(next) = (0..nodes.len()).filter(|n| !done[*n]).min_by(|a, b| far[*a].total_cmp(&far[*b])) {
                done[next] = true;
                for other in 0..nodes.len() {
                    if !done[other] {
                        far[other] = far[other].min(far[next] + line(nodes[next], nodes[other]));
                    }
                }
            }
            let place = |node: usize| {
                let (i, j) = nodes[node];
                Point3::new((i as f64 + 0.5) * T, (j as f64 + 0.5) * T, FLOOR + height(i, j) + 0.01)
            };
            let [a, b] = [from, to].map(|node| spot(&mut standing, &store, place(node)).unwrap());
            let route = way(&mut search, &store, &region, &a, &b).unwrap();
            assert!(route.length_m <= 1.05 * far[to] + 1e-9, "world {number}: {} for {}", route.length_m, far[to]);
            worst = worst.max(route.length_m / far[to].max(T));
        }
        eprintln!("world {number}: at worst {worst:.4} of the shortest way");
    }
}
