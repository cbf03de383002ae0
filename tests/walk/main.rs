//! Pawns in scenes with known truth: what they walk on, climb and refuse, without jitter, tunnelling or leaks.

#[path = "../../tools/lab/src/walks/cases.rs"]
mod cases;
mod crowds;
mod guards;
mod jams;
mod jumps;
mod motion;
#[path = "../../tools/lab/src/walks/path.rs"]
mod path;
#[path = "../common/random.rs"]
mod random;
mod seams;
mod stuck;
mod world;

use nalgebra::{Point3, Vector2, Vector3};
use scangen::{Params, Scene};
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk::walk::*;
use world::*;

const BODIES: [Body; 2] = [BOX, CYLINDER];

/// Checks that only the floor touches the body, at any time.
fn assert_free(store: &Snapshot, trace: &Trace, what: &str) {
    let body = trace.walker.config().body;
    let (half, height) = (body.half(), body.height());
    for feet in &trace.path {
        // A cylinder contains the box of 0.7 times its width.
        let share = if matches!(body, Body::Box { .. }) { 1.0 } else { 0.7 };
        let margin = Vector3::new(1e-6, 1e-6, 1e-3);
        let low = feet - (half * share).push(0.0) + margin;
        let high = feet + (half * share).push(height) - margin;
        let shape = Aabb::new(low, high).unwrap();
        assert_eq!(overlaps(store, &shape), Overlap::Clear, "{what}: inside solid at {feet}");
    }
}

#[test]
fn doors_let_through_what_fits() {
    for body in BODIES {
        let mut passed = Vec::new();
        for width in [0.40, 0.45, 0.48, 0.55, 0.60, 0.65, 0.7, 0.9, 1.2] {
            let scene = scene(|b| {
                b.level("floor", [-2.0, -2.0, 2.0, 2.0], 0.0, &[]);
                wall(b, [0.0, -2.0], [0.0, 2.0], &[[2.0 - width / 2.0, 0.0, 2.0 + width / 2.0, 2.1]]);
            });
            let store = world(&scene, 0.001);
            let trace = walk(&store, config(body), [-1.5, 0.013, 0.0], &[[1.5, 0.013]], 60.0, 20.0);
            assert_free(&store, &trace, "door");
            assert!(trace.arrived() || width < 0.65, "{body:?}: a door of {width} m is wide enough, {}", trace.end());
            assert!(!trace.arrived() || width > 0.5, "{body:?}: a door of {width} m is too narrow");
            passed.push(trace.arrived());
        }
        assert!(passed.is_sorted(), "{body:?}: {passed:?}");
    }
}

#[test]
fn tables_are_walked_under_if_the_head_fits() {
    for body in BODIES {
        for (clear, fits) in [(1.0, false), (1.7, false), (1.79, false), (1.81, true), (1.9, true)] {
            let scene = scene(|b| {
                b.level("floor", [-2.0, -1.0, 2.0, 1.0], 0.0, &[]);
                b.cuboid("table", [-0.6, -1.0, clear], [0.6, 1.0, clear + 0.05]);
            });
            let store = world(&scene, 0.0);
            let trace = walk(&store, config(body), [-1.5, 0.0, 0.0], &[[1.5, 0.0]], 60.0, 10.0);
            assert_eq!(trace.arrived(), fits, "{body:?}: {clear} m clear, ends at {}", trace.end());
            assert_free(&store, &trace, "table");
            if !fits {
                assert_eq!(trace.reports.last().unwrap().stop, Some(Stop::Wall));
                assert!((trace.end().x + 0.85).abs() < 2.0 * T, "{}", trace.end());
            }
        }
    }
}

#[test]
fn stairs_are_climbed_up_to_the_climb_height_and_not_beyond() {
    for centimetres in 5..=40 {
        let riser = f64::from(centimetres) / 100.0;
        let stairs = Scene::named("stairs", &Params::new().with("riser", riser).with("risers", 4.0)).unwrap();
        // Alternating headings and phases; each riser meets several of them, its neighbours the others.
        for n in 0..2 {
            let turn = [0.0, 17.0, 45.0, 90.0][(centimetres + n) as usize % 4];
            let shift = [0.013 * f64::from(centimetres), 0.031, 0.007 * f64::from(centimetres)];
            let scene = turned(&stairs, turn, shift);
            let store = world(&scene, 0.0);
            let way = scene.walk().unwrap();
            let body = BODIES[(centimetres + n) as usize / 2 % 2];
            let up = walk(&store, config(body), way.start, &way.waypoints, 60.0, 20.0);
            let climbs = centimetres <= 35;
            assert_eq!(up.arrived(), climbs, "{body:?}: risers of {riser} m turned by {turn}°, ends at {}", up.end());
            assert_free(&store, &up, "stairs");
            if climbs {
                assert!((up.end().z - way.end[2]).abs() < 0.002, "{}", up.end());
                let down = walk(&store, config(body), way.end, &[[way.start[0], way.start[1]]], 60.0, 20.0);
                assert!(down.arrived(), "{body:?}: down risers of {riser} m: ends at {}", down.end());
                assert!(down.reports.iter().all(|r| r.state != State::Falling), "down risers of {riser} m: falls");
                let highest = up.path.windows(2).map(|w| w[1].z - w[0].z).fold(0.0, f64::max);
                assert!(highest <= 0.35 + 0.002, "{riser}: jumps by {highest}");
            } else {
                assert!(up.end().z - way.start[2] < 0.36, "{body:?}: ratchets up to {}", up.end());
            }
        }
    }
}

#[test]
fn stairs_with_noise_are_climbed_too() {
    for riser in [0.05, 0.1, 0.17, 0.2, 0.25, 0.3, 0.34] {
        let stairs = Scene::named("stairs", &Params::new().with("riser", riser).with("risers", 5.0)).unwrap();
        for (n, body) in BODIES.into_iter().enumerate() {
            let scene = turned(&stairs, 13.0 + 20.0 * n as f64, [0.0; 3]);
            let store = world(&scene, 0.002);
            let way = scene.walk().unwrap();
            let up = walk(&store, config(body), way.start, &way.waypoints, 60.0, 20.0);
            assert!(up.arrived(), "{body:?}: risers of {riser} m: ends at {}", up.end());
            let down = walk(&store, config(body), way.end, &[[way.start[0], way.start[1]]], 60.0, 20.0);
            assert!(down.arrived() && down.reports.iter().all(|r| r.state != State::Falling), "{riser} m down");
        }
    }
}

/// A floor, a ramp rising by 1.2 m along x, and a floor on top.
fn ramp(slope_deg: f64) -> (Scene, f64) {
    let rise = 1.2;
    let run = rise / slope_deg.to_radians().tan();
    let scene = scene(|b| {
        b.level("floor", [-2.0, -1.0, 0.0, 1.0], 0.0, &[]);
        b.quad("ramp", [0.0, -1.0, 0.0], [run, 0.0, rise], [0.0, 2.0, 0.0]);
        b.level("floor", [run, -1.0, run + 2.0, 1.0], rise, &[]);
    });
    (scene, run)
}

#[test]
fn ramps_are_climbed_below_the_slope_limit_and_refused_above() {
    for slope in [10.0, 30.0, 40.0, 42.0, 48.0, 50.0, 60.0, 75.0] {
        let (flat, run) = ramp(slope);
        for (n, turn) in [0.0, 30.0, 45.0, 78.0].into_iter().enumerate() {
            let scene = turned(&flat, turn, [0.02 * n as f64, 0.0, 0.03 * n as f64]);
            let store = world(&scene, 0.001);
            let place = |x: f64| {
                let p = scangen::geometry::Placement {
                    rotate_deg: turn,
                    translate: [0.02 * n as f64, 0.0, 0.03 * n as f64],
                };
                p.apply([x, 0.0, 0.0])
            };
            let (from, to) = (place(-1.2), place(run + 1.2));
            let body = BODIES[n % 2];
            let trace = walk(&store, config(body), from, &[[to[0], to[1]]], 60.0, 20.0);
            assert_eq!(trace.arrived(), slope < 45.0, "{body:?}: {slope}° turned by {turn}°: ends at {}", trace.end());
            if slope > 45.0 {
                let climbed = trace.end().z - from[2];
                assert!(climbed < 0.36, "{body:?}: {slope}° turned by {turn}°: climbs {climbed} m");
            } else {
                // And down again, on its feet.
                let down = walk(&store, config(body), [to[0], to[1], 1.2 + from[2]], &[[from[0], from[1]]], 60.0, 20.0);
                assert!(down.arrived() && down.reports.iter().all(|r| r.state != State::Falling), "{slope}° down");
            }
        }
    }
}

#[test]
fn a_step_under_a_low_ceiling_is_climbed_if_the_head_fits() {
    for body in BODIES {
        for (ceiling, fits) in [(1.85, false), (1.95, false), (1.99, false), (2.01, true), (2.1, true)] {
            let scene = scene(|b| {
                b.level("floor", [-2.0, -1.0, 0.0, 1.0], 0.0, &[]);
                b.quad("riser", [0.0, -1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.2]);
                b.level("floor", [0.0, -1.0, 2.0, 1.0], 0.2, &[]);
                b.level("ceiling", [-1.0, -1.0, 2.0, 1.0], ceiling, &[]);
            });
            let store = world(&scene, 0.0);
            let trace = walk(&store, config(body), [-1.5, 0.0, 0.0], &[[1.5, 0.0]], 60.0, 10.0);
            assert_eq!(trace.arrived(), fits, "{body:?}: {ceiling} m, ends at {}", trace.end());
            assert_free(&store, &trace, "ceiling");
            if !fits {
                assert_eq!(trace.reports.last().unwrap().stop, Some(Stop::Headroom));
            }
        }
    }
}

#[test]
fn inner_corners_end_the_way_without_jitter() {
    for (degrees, body) in [(90.0, BOX), (90.0, CYLINDER), (60.0, BOX), (60.0, CYLINDER), (120.0, CYLINDER)] {
        let (s, c) = f64::to_radians(degrees).sin_cos();
        let scene = scene(|b| {
            b.level("floor", [-1.0, -1.0, 5.0, 5.0], 0.0, &[]);
            b.quad("wall", [0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 3.0]);
            b.quad("wall", [0.0, 0.0, 0.0], [4.0 * c, 4.0 * s, 0.0], [0.0, 0.0, 3.0]);
        });
        let store = world(&scene, 0.001);
        let (s, c) = f64::to_radians(degrees / 2.0).sin_cos();
        for aim in [-0.2, 0.0, 0.3] {
            let mut walker = Walker::new(config(body), Point3::new(2.5 * c, 2.5 * s, 0.0)).unwrap();
            let way = Vector2::new(-c + aim * s, -s - aim * c);
            for _ in 0..300 {
                walker.step(&store, 1.0 / 60.0, MoveInput::Direction(way));
            }
            let still = walker.feet();
            for _ in 0..120 {
                let report = walker.step(&store, 1.0 / 60.0, MoveInput::Direction(way));
                assert_eq!(walker.feet(), still, "{degrees}° {body:?} {aim}: jitters");
                assert_eq!(report.state, State::Blocked);
            }
            assert!(still.x > 0.0 && still.y > 0.0 && still.coords.norm() < 1.2, "{degrees}° {body:?} {aim}: {still}");
        }
    }
}

#[test]
fn round_columns_are_walked_around() {
    let radius = 0.32;
    let scene = scene(|b| {
        b.level("floor", [-3.0, -3.0, 3.0, 3.0], 0.0, &[]);
        b.column("column", [0.0, 0.0], radius, [0.0, 3.0]);
    });
    let store = world(&scene, 0.001);
    for body in BODIES {
        for heading in [0.0f64, 30.0, 45.0, 70.0] {
            for aside in [0.1, 0.25, 0.4] {
                let (s, c) = heading.to_radians().sin_cos();
                let at = |along: f64| [along * c - aside * s, along * s + aside * c];
                let (from, to) = (at(-2.0), at(2.0));
                let trace = walk(&store, config(body), [from[0], from[1], 0.0], &[to], 60.0, 20.0);
                if matches!(body, Body::Box { .. }) && heading == 0.0 && aside < 0.3 {
                    // A flat front meets the foremost line of a round column: little or nothing pushes it aside.
                    assert!(trace.arrived() || (trace.end().x + radius + 0.25).abs() < 2.0 * T);
                    continue;
                }
                assert!(trace.arrived(), "{body:?} heading {heading}, {aside} aside: ends at {}", trace.end());
                assert_free(&store, &trace, "column");
                if matches!(body, Body::Cylinder { .. }) {
                    // Closed form: the pawn's middle moves along a circle of both radii.
                    let nearest = trace.path.iter().map(|p| p.xy().coords.norm()).fold(f64::INFINITY, f64::min);
                    let truth = aside.max(radius + 0.25);
                    assert!((nearest - truth).abs() < 2.0 * T, "{heading}: {nearest} m, truth {truth}");
                }
            }
        }
    }
}

#[test]
fn walls_across_the_grid_are_slid_along() {
    for (n, degrees) in [20.0f64, 33.0, 45.0, 60.0, 70.0].into_iter().enumerate() {
        // A wall through the origin at this angle to the path, which is along x.
        let (s, c) = degrees.to_radians().sin_cos();
        let scene = scene(|b| {
            b.level("floor", [-3.0, -3.0, 3.0, 3.0], 0.0, &[]);
            b.quad("wall", [-3.0 * c, -3.0 * s, 0.0], [6.0 * c, 6.0 * s, 0.0], [0.0, 0.0, 3.0]);
        });
        let store = world(&scene, 0.001);
        for body in BODIES {
            let mut walker = Walker::new(config(body), Point3::new(-2.0, 0.013 * n as f64 + 0.3, 0.0)).unwrap();
            let mut path = Vec::new();
            for _ in 0..120 {
                walker.step(&store, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
                path.push(walker.feet());
            }
            // In two seconds it would go 2.8 m; along the wall, without friction, the component along it.
            let from_wall = |p: &Point3<f64>| p.y * c - p.x * s;
            let half = body.half();
            let clear = match body {
                Body::Box { .. } => half.x * s + half.y * c,
                Body::Cylinder { radius, .. } => radius,
            };
            let contact = path.iter().position(|p| from_wall(p) < clear + 2.0 * T);
            let Some(contact) = contact else { panic!("{body:?} {degrees}°: never gets to the wall") };
            let slid = (path[path.len() - 1] - path[contact]).norm();
            let truth = 1.4 / 60.0 * (path.len() - 1 - contact) as f64 * c;
            assert!(slid > 0.35 * truth, "{body:?} {degrees}°: slides {slid} m, truth {truth}");
            for p in &path[contact..] {
                assert!((from_wall(p) - clear).abs() < 2.0 * T, "{body:?} {degrees}°: {} from the wall", from_wall(p));
            }
        }
    }
}

/// A part of `bench walks`, which covers more rotations and pixel sizes.
#[test]
fn paths_stay_within_two_pixels_of_the_exact_ones() {
    for (body, turn, noise) in [(BOX, 30.0, 0.0), (CYLINDER, 17.0, 0.002)] {
        for case in cases::all(body, turn, [0.0; 3]) {
            let store = world(&case.scene, noise);
            let seen = path::walk(&store, &case, Response::Slide);
            let what = format!("{}, {body:?}, turned by {turn}°: {seen:?}", case.name);
            assert!(seen.off <= 2.0 * T, "{what}");
            // A wall of pixel edges is rougher than the true one: the pawn is slower or, around an edge, faster.
            let rough = case.name.starts_with("wall");
            assert!(seen.share > if rough { 0.4 } else { 0.9 } && seen.share < 1.2, "{what}");
        }
    }
}
