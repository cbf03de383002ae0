//! Generated scenes with closed-form truth, and the walker along routes.

use super::world::{self, T};
use super::{everywhere, known, reached, spot, way};
use crate::common::random::Random;
use nalgebra::{Point2, Point3};
use scangen::{Params, Scene};
use slicewalk::reach::{LeakSearch, Pawn, Search};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, MoveInput, State, Walker, Waypoints};

fn named(name: &str, params: &[(&str, f64)]) -> Snapshot {
    let params = params.iter().fold(Params::new(), |params, (name, value)| params.with(name, *value));
    world::world(&Scene::named(name, &params).unwrap(), 0.0)
}

/// Returns whether a route connects two places.
fn connects(store: &Snapshot, pawn: Pawn, from: [f64; 3], to: [f64; 3]) -> bool {
    let (mut standing, region) = reached(store, pawn, from);
    let [a, b] =
        [from, to].map(|at| spot(&mut standing, store, at.into()).unwrap_or_else(|| panic!("{at:?}: no place")));
    way(&mut Search::new(), store, &region, &a, &b).is_some()
}

#[test]
fn a_door_wider_than_the_pawn_and_two_pixels_connects_and_a_narrower_one_does_not() {
    for door in [0.44, 0.62, 0.9] {
        let store = named("corridor", &[("door", door), ("width", 3.0), ("beam", 2.2)]);
        for radius in [0.2, 0.25, 0.3, 0.45] {
            for body in
                [Body::Box { x: 2.0 * radius, y: 2.0 * radius, height: 1.8 }, Body::Cylinder { radius, height: 1.8 }]
            {
                let connects = connects(&store, Pawn::new(body), [1.5, 0.0, 0.0], [7.0, 0.0, 0.0]);
                if door > 2.0 * radius + 2.0 * T {
                    assert!(connects, "{body:?} in a door of {door} m");
                } else if door < 2.0 * radius {
                    assert!(!connects, "{body:?} in a door of {door} m");
                }
            }
        }
    }
}

#[test]
fn a_beam_lets_through_who_is_lower() {
    let store = named("corridor", &[("beam", 1.7)]);
    for (height, passes) in [(1.6, true), (1.8, false)] {
        let pawn = Pawn::new(Body::Cylinder { radius: 0.25, height });
        let (_, region) = reached(&store, pawn, [1.5, 0.0, 0.0]);
        assert_eq!(region.places().any(|place| place.feet.x > 9.5), passes, "{height} m");
        if passes {
            let (place, room) = region.lowest_headroom().unwrap();
            assert!((room - 1.7).abs() < 0.01 && (7.5..8.8).contains(&place.feet.x), "{room} m at {:?}", place.feet);
        }
    }
}

#[test]
fn stairs_connect_just_if_they_can_be_climbed() {
    for (riser, climb, connected) in [(0.17, 0.35, true), (0.3, 0.35, true), (0.3, 0.25, false), (0.17, 0.1, false)] {
        let store = named("stairs", &[("riser", riser), ("risers", 6.0)]);
        let body = Body::Box { x: 0.5, y: 0.5, height: 1.8 };
        let pawn = Pawn { climb, max_drop: climb, ..Pawn::new(body) };
        let (low, high) = ([-1.0, 0.0, 0.0], [2.4, 0.0, 6.0 * riser]);
        assert_eq!(connects(&store, pawn, low, high), connected, "risers of {riser} m, a climb of {climb} m");
        assert_eq!(connects(&store, pawn, high, low), connected, "risers of {riser} m, a climb of {climb} m, down");
        if connected {
            let (_, region) = reached(&store, pawn, low);
            let (_, step) = region.highest_step().unwrap();
            assert!((step - riser).abs() < 0.01, "{step} m for {riser} m");
        }
    }
}

#[test]
fn ramps_can_be_walked_up_to_the_slope_limit() {
    for (slope, walkable) in [(10.0, true), (30.0, true), (40.0, true), (50.0, false), (60.0, false)] {
        let store = named("plane", &[("slope", slope), ("size", 6.0), ("heading", 25.0)]);
        let (_, region) = everywhere(&store, Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 }));
        let flat = 36.0 * f64::to_radians(slope).cos();
        let share = region.area_m2() / flat;
        assert_eq!(share > 0.9, walkable, "{slope}°: {share} of the plane");
        assert!(walkable || share < 0.1, "{slope}°: {share} of the plane");
    }
}

#[test]
fn a_floor_without_walls_is_all_standing_and_ends_at_one_edge() {
    let store = named("plane", &[("size", 6.0)]);
    let (mut standing, region) = reached(&store, Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 }), [0.0; 3]);
    // At most one pixel more at each border.
    assert!((36.0..=(6.0 + 4.0 * T).powi(2)).contains(&region.area_m2()), "{}", region.area_m2());
    let leaks = known(LeakSearch::new(&region).find(&mut standing, &store).unwrap());
    assert_eq!(leaks.len(), 1, "{leaks:?}");
    assert_eq!((leaks[0].kind.name(), leaks[0].drop), ("edge", None));
    assert!((leaks[0].width - 6.0).abs() < 4.0 * T);
}

/// Walks along a route; returns whether the walker arrives.
fn arrives(store: &Snapshot, body: Body, route: &slicewalk::reach::Route) -> bool {
    let config = Config { tick_s: 1.0 / 60.0, ..Config::new(body) };
    let mut walker = Walker::new(config, route.points[0]).unwrap();
    let places: Vec<Point2<f64>> = route.points.iter().map(|point| point.xy()).collect();
    let mut way = Waypoints::new(places).unwrap();
    for _ in 0..(2.0 * route.length_m / 1.4 * 60.0) as usize + 120 {
        walker.follow(store, 1.0 / 60.0, &mut way);
        if walker.state() == State::Arrived {
            let end: Point3<f64> = route.points[route.points.len() - 1];
            return (walker.feet() - end).norm() < 0.1;
        }
    }
    false
}

#[test]
#[ignore = "slow: .ci/run"]
fn the_walker_arrives_along_routes_through_a_house_of_three_storeys() {
    let store = named("house", &[]);
    for body in [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }] {
        let (mut standing, region) = reached(&store, Pawn::new(body), [1.5, 2.0, 0.0]);
        let storeys = region.storeys();
        assert!(storeys.all.len() == 3, "{:?}", storeys.all);
        for (storey, z) in storeys.all.iter().zip([0.0, 3.0, 6.0]) {
            // 14 × 10 m minus the clearance from walls, columns, tables and stairs.
            assert!((storey.z - z).abs() < 0.01 && (80.0..130.0).contains(&storey.area_m2), "{storey:?}");
        }
        let places: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
        let (mut random, mut search) = (Random(3), Search::new());
        let mut looked_at = Vec::new();
        let (mut lost, pairs) = (Vec::new(), 120);
        for _ in 0..pairs {
            let [from, to] = [0, 1].map(|_| places[random.below(places.len() as u32) as usize]);
            let [a, b] = [from, to].map(|at| spot(&mut standing, &store, at).unwrap());
            let route = way(&mut search, &store, &region, &a, &b).unwrap();
            looked_at.push(search.looked_at());
            if !arrives(&store, body, &route) {
                lost.push((from, to));
            }
        }
        assert!(lost.len() * 200 <= pairs, "{body:?}: {} of {pairs} do not arrive: {lost:?}", lost.len());
        looked_at.sort_unstable();
        eprintln!("{body:?}: median {} places looked at, {} lost", looked_at[pairs / 2], lost.len());
    }
}

#[test]
fn the_walker_follows_up_stairs_whose_second_riser_is_just_about_as_high_as_it_climbs() {
    let mut random = Random(17);
    for riser in [0.165, 0.173, 0.1745, 0.175, 0.1755, 0.177] {
        let params = Params::new().with("riser", riser).with("risers", 8.0);
        let store = world::world(&Scene::named("stairs", &params).unwrap(), 0.002);
        for body in [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }] {
            let (mut standing, region) = reached(&store, Pawn::new(body), [-1.0, 0.0, 0.0]);
            let mut search = Search::new();
            for _ in 0..10 {
                let mut across = || f64::from(random.below(1000)) / 1000.0 - 0.5;
                let (low, high) = (Point3::new(-1.0, across(), 0.1), Point3::new(3.2, across(), 8.0 * riser + 0.1));
                let [a, b] = [low, high].map(|at| spot(&mut standing, &store, at).unwrap());
                for (from, to) in [(a, b), (b, a)] {
                    let route = way(&mut search, &store, &region, &from, &to).unwrap();
                    assert!(arrives(&store, body, &route), "{body:?}, risers of {riser} m: {low} and {high}");
                }
            }
        }
    }
}

#[test]
fn who_keeps_from_drops_falls_out_of_no_scene() {
    const MAX_DROP: f64 = 0.35;
    let mut stops = 0;
    for (name, params) in
        [("stairs", &[("risers", 6.0)][..]), ("tower", &[("storeys", 3.0)]), ("plane", &[("size", 5.0)])]
    {
        let store = named(name, params);
        for body in [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }] {
            let (_, region) = everywhere(&store, Pawn::new(body));
            let starts: Vec<Point3<f64>> = region.places().map(|place| place.feet).collect();
            let config = Config { tick_s: 1.0 / 60.0, max_drop: Some(MAX_DROP), speed: 3.0, ..Config::new(body) };
            let mut random = Random(11);
            for _ in 0..8 {
                let start = starts[random.below(starts.len() as u32) as usize];
                let mut walker = Walker::new(config, start).unwrap();
                let (mut ground, mut heading) = (start.z, 0.0f64);
                for step in 0..2500 {
                    if step % 40 == 0 {
                        heading = f64::from(random.below(6283)) / 1000.0;
                    }
                    let wish = MoveInput::Direction([heading.cos(), heading.sin()].into());
                    stops += usize::from(walker.step(&store, 1.0 / 60.0, wish).stop.is_some());
                    let feet = walker.feet();
                    assert!(ground - feet.z <= MAX_DROP + 0.005, "{name}, {body:?}: from {ground} m to {feet}");
                    if walker.state() != State::Falling {
                        ground = feet.z;
                    }
                }
            }
        }
    }
    assert!(stops > 1000, "{stops}");
}
