//! Long pawns compared with brute force over places and headings, in hand-made scenes, and followed by walkers.

use super::flat::{Columns, layers};
use super::walked::{SIGMA, Scene};
use super::{everywhere, known, spot};
use crate::common::part::Part;
use crate::common::random::Random;
use nalgebra::{Point2, Point3, Vector2};
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::reach::{LongSearch, Pawn, PlaceId, Planned, Planner, Refusal, Region, Route, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use slicewalk::{Error, Monitor, NoMonitor};
use std::collections::{BTreeMap, BTreeSet};

/// Height of the floor (quanta, m).
const FLOOR: i64 = 10 * SLICE_QUANTA;
const FLOOR_M: f64 = 10.0 * SIGMA;

/// A scene of pixels of an edge `t` (m): the height of the floor above the lowest one (quanta), or `None` for a wall.
fn scene(t: f64, [width, depth]: [i64; 2], height: impl Fn(i64, i64) -> Option<i64>) -> Snapshot {
    let pixel = |i: i64, j: i64| match height(i, j) {
        Some(height) => (FLOOR - 3, FLOOR + height, false),
        None => (FLOOR - 3, FLOOR + 9 * SLICE_QUANTA, true),
    };
    let all = (0..width).flat_map(|i| (0..depth).map(move |j| (i, j)));
    let columns: Columns = all.map(|(i, j)| ((i, j), vec![pixel(i, j)])).collect();
    layers(Frame::new(t, SIGMA).unwrap(), &columns)
}

fn at(t: f64, [i, j]: [i64; 2]) -> Point3<f64> {
    Point3::new((i as f64 + 0.5) * t, (j as f64 + 0.5) * t, FLOOR_M + 0.8)
}

/// Squares by their lower corner, and sides.
type Met = (BTreeSet<[i64; 2]>, BTreeSet<[[i64; 2]; 2]>);

/// Adds the squares and sides that a line meets, found by where it crosses the lines of the grid.
fn line(from: Vector2<f64>, to: Vector2<f64>, met: &mut Met) {
    let by = to - from;
    if by.norm() == 0.0 {
        return;
    }
    let mut shares = vec![0.0, 1.0];
    for axis in 0..2 {
        for n in -40..=40 {
            let share = (f64::from(n) - from[axis]) / by[axis];
            shares.extend((share > 0.0 && share < 1.0).then_some(share));
        }
    }
    shares.sort_by(f64::total_cmp);
    for pair in shares.windows(2).filter(|pair| pair[1] - pair[0] > 1e-9) {
        let middle = from + by * pair[0].midpoint(pair[1]);
        let [i, j] = [0, 1].map(|axis| (middle[axis] + 1e-9).floor() as i64);
        // On a line of the grid.
        let [x, y] = [0, 1].map(|axis| (middle[axis] - middle[axis].round()).abs() < 1e-9);
        match (x, y) {
            (true, _) => _ = met.1.insert([[i, j], [i, j + 1]]),
            (_, true) => _ = met.1.insert([[i, j], [i + 1, j]]),
            _ => _ = met.0.insert([i, j]),
        }
    }
}

/// Adds the squares that a sector between two unit vectors meets: those in which a fine polygon has an area.
fn sector([low, high]: [Vector2<f64>; 2], radius: f64, met: &mut Met) {
    let angle = low.perp(&high).atan2(low.dot(&high));
    let turned = |by: f64| Vector2::new(low.x * by.cos() - low.y * by.sin(), low.x * by.sin() + low.y * by.cos());
    let mut polygon = vec![Vector2::zeros()];
    polygon.extend((0..=2000).map(|n| turned(angle * f64::from(n) / 2000.0) * radius));
    let most = radius.ceil() as i64 + 1;
    for square in (-most..most).flat_map(|i| (-most..most).map(move |j| [i, j])) {
        let mut part = polygon.clone();
        for (axis, side) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
            let edge = square[axis] as f64 + if side < 0.0 { 1.0 } else { 0.0 };
            let inside = |p: &Vector2<f64>| (p[axis] - edge) * side;
            let mut next = Vec::new();
            for (n, own) in part.iter().enumerate() {
                let before = &part[(n + part.len() - 1) % part.len()];
                let (a, b) = (inside(before), inside(own));
                if (a > 0.0) != (b > 0.0) {
                    next.push(before + (own - before) * (a / (a - b)));
                }
                if b > 0.0 {
                    next.push(*own);
                }
            }
            part = next;
            if part.is_empty() {
                break;
            }
        }
        let area: f64 = (0..part.len()).map(|n| part[n].perp(&part[(n + 1) % part.len()])).sum::<f64>() / 2.0;
        if area.abs() > 1e-7 {
            met.0.insert(square);
        }
    }
}

/// Directions of the eight headings.
const DIRECTIONS: [[i64; 2]; 8] = [[1, 0], [2, 1], [1, 1], [1, 2], [0, 1], [-1, 2], [-1, 1], [-2, 1]];

fn unit(heading: usize) -> Vector2<f64> {
    let [x, y] = DIRECTIONS[heading % 8].map(|v| v as f64);
    Vector2::new(x, y).normalize() * if heading % 16 < 8 { 1.0 } else { -1.0 }
}

/// A long pawn by definition: for each move what its middle line meets, and what it costs (m).
struct Brute {
    stand: Vec<Met>,
    /// Heading before, offset, heading after, what is met, cost.
    moves: Vec<(usize, [i64; 2], usize, Met, f64)>,
}

impl Brute {
    fn new(t: f64, half: f64, length: f64) -> Self {
        let (mut stand, mut moves) = (Vec::new(), Vec::new());
        for (heading, by) in DIRECTIONS.into_iter().enumerate() {
            let end = unit(heading) * half;
            let step = Vector2::new(by[0] as f64, by[1] as f64);
            let mut met = Met::default();
            line(-end, end, &mut met);
            stand.push(met);
            for sign in [1.0, -1.0] {
                let mut met = Met::default();
                line(-end * sign, end * sign + step * sign, &mut met);
                moves.push((heading, by.map(|by| by * sign as i64), heading, met, step.norm() * t));
            }
            let next = (heading + 1) % 8;
            let mut met = Met::default();
            if half > 0.0 {
                for from in [heading, heading + 8] {
                    sector([unit(from), unit(from + 1)], half, &mut met);
                    line(Vector2::zeros(), unit(from) * half, &mut met);
                    line(Vector2::zeros(), unit(from + 1) * half, &mut met);
                }
            }
            let arc = unit(heading).dot(&unit(heading + 1)).acos() * length / 2.0;
            moves.push((heading, [0, 0], next, met.clone(), arc));
            moves.push((next, [0, 0], heading, met, arc));
        }
        Self { stand, moves }
    }

    /// Whether all that is met from a pixel on is linked: heights of the places by pixel, and the highest step (quanta).
    fn fits(met: &Met, [i, j]: [i64; 2], heights: &BTreeMap<[i64; 2], i64>, climb: i64) -> bool {
        let height = |[x, y]: [i64; 2]| heights.get(&[i + x, j + y]);
        let linked = |a: [i64; 2], b: [i64; 2]| match (height(a), height(b)) {
            (Some(a), Some(b)) => (a - b).abs() <= climb,
            _ => false,
        };
        let square = |&[x, y]: &[i64; 2]| {
            let corners = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]];
            (0..4).all(|a| (0..4).all(|b| linked(corners[a], corners[b])))
        };
        height([0, 0]).is_some() && met.0.iter().all(square) && met.1.iter().all(|[a, b]| linked(*a, *b))
    }

    /// The least cost to each state from a pixel in any heading (m).
    fn costs(&self, from: [i64; 2], heights: &BTreeMap<[i64; 2], i64>, climb: i64) -> BTreeMap<([i64; 2], usize), f64> {
        let mut costs = BTreeMap::new();
        let mut open: BTreeSet<(u64, [i64; 2], usize)> = (0..8)
            .filter(|heading| Self::fits(&self.stand[*heading], from, heights, climb))
            .map(|heading| (0, from, heading))
            .collect();
        open.iter().for_each(|(_, pixel, heading)| _ = costs.insert((*pixel, *heading), 0.0));
        while let Some((bits, pixel, heading)) = open.pop_first() {
            let cost = f64::from_bits(bits);
            if cost > costs[&(pixel, heading)] {
                continue;
            }
            for (_, by, next, met, own) in self.moves.iter().filter(|own| own.0 == heading) {
                let to = ([pixel[0] + by[0], pixel[1] + by[1]], *next);
                if costs.get(&to).is_none_or(|known| cost + own < *known) && Self::fits(met, pixel, heights, climb) {
                    costs.insert(to, cost + own);
                    open.insert(((cost + own).to_bits(), to.0, to.1));
                }
            }
        }
        costs
    }
}

fn pixel_of(t: f64, feet: Point3<f64>) -> [i64; 2] {
    [feet.x, feet.y].map(|v| (v / t).floor() as i64)
}

/// Pixels of the places that a long pawn reaches.
fn pixels(
    t: f64,
    region: &Region,
    standing: &StandingPlaces,
    search: &mut LongSearch<&Region>,
    from: &PlaceId,
) -> BTreeSet<[i64; 2]> {
    let reached = search.reached(&[*from], &NoMonitor).unwrap();
    let mut kept = region.clone();
    kept.keep_reached(standing, &reached);
    kept.places().map(|place| pixel_of(t, place.feet)).collect()
}

#[test]
fn what_is_reached_over_steps_is_that_of_brute_force() {
    let [_, refused, partial] = beside_brute_force(false);
    assert!(refused > 3 && partial > 3, "{refused} {partial}");
}

#[test]
fn what_is_reached_on_flat_ground_and_what_it_costs_are_those_of_brute_force() {
    let [turned, refused, partial] = beside_brute_force(true);
    assert!(turned > 20 && refused > 5 && partial > 3, "{turned} {refused} {partial}");
}

/// Compares what is reached, and on flat ground its costs, with brute force. Returns how many routes turned, how many there
/// were not, and how many starts reached some places but not all.
fn beside_brute_force(is_flat: bool) -> [usize; 3] {
    const T: f64 = 0.1;
    let quanta = |metres: f64| (metres / SIGMA * SLICE_QUANTA as f64).round() as i64;
    let (mut turned, mut refused, mut partial) = (0, 0, 0);
    let cases = std::env::var("SLICEWALK_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(12);
    for seed in (0..cases).filter(|seed| is_flat == (seed % 3 != 0)) {
        let mut random = Random(seed);
        let edge = 44i64;
        // Pawns as wide as a pixel stand on each floor; wider ones only on flat ground, where neighbours are linked.
        let radius = if is_flat { [0.05, 0.15, 0.3][random.below(3) as usize] } else { 0.05 };
        let half = [0.0, 0.7, 1.0, 1.5, 2.0, 2.9, 4.0, 6.3][random.below(8) as usize];
        let length = 2.0 * radius + 2.0 * half * T;
        let mut heights: BTreeMap<[i64; 2], i64> = BTreeMap::new();
        for (i, j) in (1..edge - 1).flat_map(|i| (1..edge - 1).map(move |j| (i, j))) {
            heights.insert([i, j], 0);
        }
        for _ in 0..random.below(24) {
            let [x, y] = [0, 1].map(|_| 1 + random.below(edge - 2));
            let long = 1 + random.below(16i64);
            let wide = 1 + random.below(2i64);
            let [w, h] = if random.below(2) == 0 { [long, wide] } else { [wide, long] };
            let kind = random.below(3);
            for pixel in (x..x + w).flat_map(|i| (y..y + h).map(move |j| [i, j])) {
                match heights.get_mut(&pixel) {
                    Some(height) if !is_flat && kind == 0 => *height = quanta(0.3),
                    Some(height) if !is_flat && kind == 1 => *height = quanta(0.6),
                    _ => _ = heights.remove(&pixel),
                }
            }
        }
        let store = scene(T, [edge, edge], |i, j| heights.get(&[i, j]).copied());
        let pawn = Pawn::new(Body::Cylinder { radius, height: 1.0 });
        let (mut standing, region) = everywhere(&store, pawn);
        // The places of the round pawn, with the heights of the floor; its links are those of steps.
        let tops: BTreeMap<[i64; 2], i64> = region
            .places()
            .map(|place| pixel_of(T, place.feet))
            .map(|pixel| (pixel, heights.get(&pixel).copied().unwrap_or(0)))
            .collect();
        let all: Vec<[i64; 2]> = tops.keys().copied().collect();
        let brute = Brute::new(T, half, length);
        let mut search = LongSearch::new(&region, length).unwrap();
        for _ in 0..4 {
            let from = all[random.below(all.len())];
            let start = spot(&mut standing, &store, at(T, from)).unwrap();
            let costs = brute.costs(from, &tops, quanta(0.36));
            let expected: BTreeSet<[i64; 2]> = costs.keys().map(|state| state.0).collect();
            let found = pixels(T, &region, &standing, &mut search, &start);
            let wrong: Vec<_> = found.symmetric_difference(&expected).take(5).collect();
            assert!(
                wrong.is_empty(),
                "seed {seed}, half {half}, from {from:?}: {} and {}: {wrong:?}",
                found.len(),
                expected.len()
            );
            partial += usize::from(!expected.is_empty() && expected.len() < all.len());
            for _ in 0..6 {
                let to = all[random.below(all.len())];
                let end = spot(&mut standing, &store, at(T, to)).unwrap();
                let route = known(search.route(&store, &start, &end, &NoMonitor).unwrap());
                let least = (0..8).filter_map(|heading| costs.get(&(to, heading))).copied().min_by(f64::total_cmp);
                let about = format!("seed {seed}, half {half}, from {from:?} to {to:?}");
                match (route, least) {
                    (Some(route), Some(least)) if is_flat => {
                        let cost = search.cost_m(&route);
                        assert!((cost - least).abs() <= 5e-4 * least + 1e-9, "{about}: {cost} and {least}: {route:?}");
                        turned += usize::from(route.headings.windows(2).any(|pair| pair[0] != pair[1]));
                    }
                    (Some(_), Some(_)) => {}
                    (None, None) => refused += 1,
                    (route, least) => panic!("{about}: {route:?} and {least:?}"),
                }
            }
        }
    }
    [turned, refused, partial]
}

/// How much more of a route the pawn drives ahead than back (m).
fn driven_ahead(route: &Route) -> f64 {
    let way = |degrees: f64| Vector2::new(degrees.to_radians().sin(), degrees.to_radians().cos());
    let stretches = route.points.windows(2).zip(&route.headings[1..]);
    stretches.map(|(ends, heading)| (ends[1] - ends[0]).xy().dot(&way(*heading))).sum()
}

/// Follows a route with the middle, the front and the rear of a pawn.
fn is_followed(store: &Snapshot, pawn: &Pawn, length: f64, route: &Route, tick_s: f64) -> bool {
    let half = length / 2.0 - pawn.body.half().x;
    let way = |degrees: f64| Vector2::new(degrees.to_radians().sin(), degrees.to_radians().cos());
    [0.0, 1.0, -1.0].into_iter().all(|side| {
        let mut line: Vec<Point2<f64>> = Vec::new();
        let mut before = route.headings[0];
        for (point, &heading) in route.points.iter().zip(&route.headings) {
            // Turns in steps of about 2°.
            let by = (heading - before + 180.0).rem_euclid(360.0) - 180.0;
            let steps = (by.abs() / 2.0).ceil().max(1.0) as usize;
            line.extend((1..=steps).map(|n| point.xy() + way(before + by * n as f64 / steps as f64) * half * side));
            before = heading;
        }
        let config = Config { tick_s, climb: pawn.climb, ..Config::new(pawn.body) };
        let mut walker = Walker::new(config, route.points[0]).unwrap();
        let end = line[line.len() - 1];
        let length: f64 = line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let mut waypoints = Waypoints::new(line).unwrap();
        for _ in 0..(2.0 * length / 1.4 * 60.0) as usize + 240 {
            walker.follow(store, 1.0 / 60.0, &mut waypoints);
            if walker.state() == State::Arrived {
                break;
            }
        }
        let high = (walker.feet().z - route.points[route.points.len() - 1].z).abs();
        walker.state() == State::Arrived && (walker.feet().xy() - end).norm() < 0.01 && high < 0.75
    })
}

#[test]
fn walkers_follow_the_middle_the_front_and_the_rear_of_routes_of_random_scenes() {
    let cases = std::env::var("SLICEWALK_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(30);
    let (mut found, mut refused, mut lost) = (0, 0, Vec::new());
    for seed in 0..cases {
        let mut random = Random(seed ^ 0x10e6);
        let by = [0, 1].map(|_| random.below(64i64));
        let columns: Columns = Scene::random(seed).columns(random.below(4), random.below(2) == 0, by, 0).collect();
        let store = layers(Frame::new(0.1, SIGMA).unwrap(), &columns);
        let radius = [0.15, 0.25, 0.3][random.below(3) as usize];
        let length = 2.0 * radius + [0.2, 0.4, 0.75][random.below(3) as usize];
        let pawn = Pawn::new(Body::Cylinder { radius, height: 1.4 });
        let (mut standing, region) = everywhere(&store, pawn);
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let mut search = LongSearch::new(&region, length).unwrap();
        for _ in 0..if places.is_empty() { 0 } else { 6 } {
            let ends = [0, 1].map(|_| places[random.below(places.len())]);
            let [a, b] = ends.map(|at| spot(&mut standing, &store, at).unwrap());
            let Some(route) = known(search.route(&store, &a, &b, &NoMonitor).unwrap()) else {
                refused += 1;
                continue;
            };
            found += 1;
            assert!(driven_ahead(&route) > -1e-6, "seed {seed}: it drives back more than ahead: {route:?}");
            for tick_s in [1.0 / 240.0, 1.0 / 60.0] {
                if !is_followed(&store, &pawn, length, &route, tick_s) {
                    lost.push(format!("seed {seed}, {pawn:?}, {length} m, ticks of {tick_s}: {ends:?}"));
                }
            }
        }
    }
    eprintln!("{found} routes, {refused} pairs without, {} lost", lost.len());
    assert!(lost.is_empty(), "{} of {found}: {:#?}", lost.len(), &lost[..lost.len().min(5)]);
    assert!(found > cases && refused > 0, "{found} found, {refused} not");
}

/// A wheelchair, and its pixels (m): its width is 16 pixels, its middle line 8.
const WIDE: Body = Body::Cylinder { radius: 0.4, height: 1.4 };
const LENGTH: f64 = 1.2;
const FINE: f64 = 0.05;

/// The round pawn's region of a scene, from a pixel on.
fn ground(store: &Snapshot, from: [i64; 2]) -> (StandingPlaces, Region, PlaceId) {
    let (mut standing, region) = super::reached(store, Pawn::new(WIDE), at(FINE, from).into());
    let start = spot(&mut standing, store, at(FINE, from)).unwrap();
    (standing, region, start)
}

/// The route of a pawn of this length between two pixels.
fn drive(store: &Snapshot, length: f64, from: [i64; 2], to: [i64; 2]) -> Option<Route> {
    let (mut standing, region, start) = ground(store, from);
    let end = spot(&mut standing, store, at(FINE, to)).unwrap();
    let route = known(LongSearch::new(&region, length).unwrap().route(store, &start, &end, &NoMonitor).unwrap());
    if let Some(route) = &route {
        assert!(is_followed(store, region.pawn(), length, route, 1.0 / 240.0), "{route:?}");
        assert!(driven_ahead(route) > -1e-6, "{route:?}");
    }
    route
}

/// Where the middle lines of two corridors meet (pixels).
const MEET: i64 = 22;

/// Two corridors of a width (pixels) with a right angle between them, and a square turning place around their middle.
fn bend(width: i64, turning: i64) -> Snapshot {
    let is_in = |v: i64, width: i64| (MEET - width / 2..MEET - width / 2 + width).contains(&v);
    scene(FINE, [100, 100], |i, j| {
        let is_along = |i: i64, j: i64| is_in(i, width) && (MEET - width / 2..99).contains(&j);
        (is_along(i, j) || is_along(j, i) || is_in(i, turning) && is_in(j, turning)).then_some(0)
    })
}

/// A place in the first corridor, and one in the second.
const ENDS: [[i64; 2]; 2] = [[MEET, 80], [80, MEET]];

/// The least width of corridors (pixels) around whose bend a pawn of this length gets.
fn least_width(length: f64) -> i64 {
    let passes = |width: i64| drive(&bend(width, 0), length, ENDS[0], ENDS[1]).is_some();
    let widths: Vec<i64> = (17..40).filter(|width| passes(*width)).collect();
    assert!(widths.windows(2).all(|pair| pair[1] == pair[0] + 1) && widths.last() == Some(&39), "{widths:?}");
    widths[0]
}

#[test]
fn a_bend_lets_through_whoever_is_short_enough() {
    let widths = [0.8, 1.0, 1.2, 1.4].map(|length| (length, least_width(length)));
    eprintln!("{widths:?}");
    // A disc needs its own width, and half a pixel more on each side.
    assert_eq!(widths[0].1, 17);
    for (length, width) in widths {
        let (radius, half) = (0.4, length / 2.0 - 0.4);
        let width = width as f64 * FINE;
        // With the middle line across the bend, its middle is nearest to the inner corner.
        let corner = radius * (1.0 + 0.5f64.sqrt());
        assert!(width >= corner + half * 0.5f64.sqrt() - FINE, "{length} m: {width}");
        // It can turn at one place, its ends on the outer walls and its front around the inner corner.
        let turns = (corner + half * (1.0 + 0.5f64.sqrt())).max(2.0 * (radius + half));
        assert!(width <= turns + 3.0 * FINE, "{length} m: {width}");
    }
    assert!(widths[0].1 < widths[1].1 && widths[1].1 < widths[3].1, "{widths:?}");
}

#[test]
fn a_turning_place_lets_through_whoever_can_turn_on_it() {
    // The circle that it turns in, and half a pixel more on each side, are 25 pixels wide; it need not turn all around.
    for (turning, passes) in [(0, false), (19, false), (25, true), (31, true)] {
        let route = drive(&bend(17, turning), LENGTH, ENDS[0], ENDS[1]);
        assert_eq!(route.is_some(), passes, "{turning}");
        let Some(route) = route else { continue };
        for n in 1..route.points.len() {
            let at = route.points[n];
            let is_turn = route.headings[n] != route.headings[n - 1];
            assert!(!is_turn || at.x.max(at.y) < (MEET + 17) as f64 * FINE, "it turns in the corridor: {route:?}");
        }
    }
}

struct Stops;

impl Monitor for Stops {
    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn a_dead_end_is_left_backwards() {
    // A corridor as wide as the pawn leads from a hall to the right, and ends at 140.
    let store = scene(FINE, [160, 80], |i, j| {
        let is_hall = (1..60).contains(&i) && (1..79).contains(&j);
        (is_hall || (60..140).contains(&i) && (30..47).contains(&j)).then_some(0)
    });
    let (mut standing, region, start) = ground(&store, [30, 60]);
    let mut search = LongSearch::new(&region, LENGTH).unwrap();
    let pixels = pixels(FINE, &region, &standing, &mut search, &start);
    // The front is 4 pixels ahead of the middle, and the disc around it covers 8 more.
    assert_eq!(pixels.last(), Some(&[127, 38]));
    for ends in [[[30, 60], [127, 38]], [[127, 38], [30, 60]]] {
        let route = drive(&store, LENGTH, ends[0], ends[1]).unwrap();
        let inside = route.points.iter().zip(&route.headings).filter(|(at, _)| at.x > 64.0 * FINE);
        let headings: Vec<f64> = inside.map(|(_, heading)| *heading).collect();
        assert!(!headings.is_empty() && headings.iter().all(|heading| *heading == headings[0]), "{route:?}");
        assert!([90.0, 270.0].contains(&headings[0]), "{route:?}");
    }
    // Only the round pawn stands at the very end.
    let [hall, end] = [[30, 60], [131, 38]];
    for (ends, refusal) in [([hall, end], Refusal::NotStandingTo), ([end, hall], Refusal::NotStandingFrom)] {
        let [from, to] = ends.map(|end| at(FINE, end));
        let mut planner = Planner::new(&store, Pawn::new(WIDE), from, to).unwrap().drawn_out(Some(LENGTH));
        let found = loop {
            match planner.advance(&store, usize::MAX, &NoMonitor).unwrap() {
                Planned::Done(found) => break found,
                Planned::NotLoaded(missing) => panic!("{missing:?}"),
                _ => {}
            }
        };
        assert_eq!(found, Err(refusal));
    }
    let end = spot(&mut standing, &store, at(FINE, end)).unwrap();
    assert_eq!(known(search.route(&store, &start, &end, &NoMonitor).unwrap()), None);
    assert!(matches!(search.route(&store, &start, &end, &Stops), Err(Error::Interrupted)));
    assert!(matches!(search.reached(&[start], &Stops), Err(Error::Interrupted)));
    // The way in and out is the same: the pawn turns in the hall, or not at all.
    let way = [[127, 38], [30, 60], [127, 38]]
        .windows(2)
        .map(|ends| drive(&store, LENGTH, ends[0], ends[1]).unwrap().length_m);
    let lengths: Vec<f64> = way.collect();
    assert!((lengths[0] - lengths[1]).abs() < 0.05 * lengths[0], "{lengths:?}");
}

#[test]
fn a_gap_narrower_than_long_is_crossed_lengthwise_only() {
    // Two halls, and a door 0.9 m wide in the wall between them.
    let store = scene(FINE, [120, 100], |i, j| {
        let is_wall = (58..62).contains(&i) && !(40..58).contains(&j);
        (!is_wall && i > 0 && j > 0 && i < 119 && j < 99).then_some(0)
    });
    let route = drive(&store, LENGTH, [20, 20], [100, 80]).unwrap();
    let (mut before, mut crossed) = (0, false);
    for n in 0..route.points.len() {
        if route.points[n].x > 60.0 * FINE && route.points[before].x <= 60.0 * FINE {
            crossed = true;
            assert!([90.0, 270.0].contains(&route.headings[n]), "{route:?}");
        }
        before = n;
    }
    assert!(crossed);
    // As a box turned by 90° it does not fit through, and a longer one than the halls are deep can turn nowhere.
    assert!(drive(&store, 5.6, [20, 50], [100, 50]).is_none());
}

#[test]
fn a_step_that_only_walkers_meet_ends_every_route_over_it() {
    // From place to place it rises by 0.32 m, but walkers sink behind the sill, and climb 0.38 m.
    const T: f64 = 0.1;
    const SILL: i64 = 19;
    let quanta = |metres: f64| (metres / SIGMA * SLICE_QUANTA as f64).round() as i64;
    let store = scene(T, [44, 24], |i, j| {
        let height = if i == SILL { 0.06 } else { 0.38 * f64::from(u8::from(i > SILL + 2)) };
        (i > 0 && j > 0 && i < 43 && j < 23).then_some(quanta(height))
    });
    let pawn = Pawn::new(Body::Cylinder { radius: 0.083, height: 0.8 });
    let (mut standing, region) = super::reached(&store, pawn, at(T, [8, 12]).into());
    let [low, sill, high] =
        [[8, 12], [SILL, 12], [34, 12]].map(|pixel| spot(&mut standing, &store, at(T, pixel)).unwrap());
    let mut search = LongSearch::new(&region, 0.566).unwrap();
    let reached = search.reached(&[low], &NoMonitor).unwrap();
    assert!(reached.holds(&region, &sill) && reached.holds(&region, &high));
    assert_eq!(known(search.route(&store, &low, &high, &NoMonitor).unwrap()), None);
    // Its front would lie beyond the step if it stood on the sill along the way: it begins in another heading.
    let route = known(search.route(&store, &sill, &low, &NoMonitor).unwrap()).unwrap();
    assert!(![90.0, 270.0].contains(&route.headings[0]), "{route:?}");
}

#[test]
fn what_is_no_long_pawn_is_refused() {
    let store = bend(20, 0);
    let region = |body: Body| super::reached(&store, Pawn::new(body), at(FINE, ENDS[0]).into()).1;
    let round = region(WIDE);
    for (length, expected) in
        [(0.79, "0.8 (the width)"), (f64::NAN, "expected"), (60.0, "to 52.0 m"), (-1.0, "expected")]
    {
        let error = LongSearch::new(&round, length).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
    assert!(LongSearch::new(&round, 0.8).is_ok());
    let error = LongSearch::new(&region(Body::Box { x: 0.5, y: 0.5, height: 1.8 }), 1.2).unwrap_err().to_string();
    assert!(error.contains("cylinder"), "{error}");
}

#[test]
fn a_planned_route_is_that_of_the_search_and_its_pages_are_asked_for() {
    let expected = drive(&bend(26, 0), LENGTH, ENDS[0], ENDS[1]).unwrap();
    let plan = |width: i64| {
        let mut part = Part::new(bend(width, 0));
        let [from, to] = ENDS.map(|end| at(FINE, end));
        let mut planner = Planner::new(&part, Pawn::new(WIDE), from, to).unwrap().drawn_out(Some(LENGTH));
        loop {
            match planner.advance(&part, 1000, &NoMonitor).unwrap() {
                Planned::Done(found) => break found,
                Planned::NotLoaded(missing) => assert!(part.load(missing.keys()) > 0),
                _ => {}
            }
        }
    };
    assert_eq!(plan(26).unwrap(), expected);
    assert_eq!(plan(18), Err(Refusal::NotConnected));
}
