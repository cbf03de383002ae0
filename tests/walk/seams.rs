//! Pitfalls of other controllers: seams of tiles and pages in walls, standing on slopes, corners at speed.

use super::world::*;
use nalgebra::{Point3, Vector2};
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::walk::*;

/// A wall along an axis is smooth, however it is cut into tiles and pages: in every frame the pawn keeps the speed of
/// the exact one. Tiles are 3.2 m wide, pages 9.6 m high; pages end at the knee, at the belt and above the head.
#[test]
fn seams_in_a_wall_are_not_felt() {
    for (n, page_end) in [0.4, 1.0, 3.0].into_iter().enumerate() {
        let ground = 9.6 - page_end;
        let scene = scene(|b| {
            b.level("floor", [-5.0, -2.0, 5.0, 1.0], ground, &[]);
            b.quad("wall", [-5.0, 0.62, ground], [10.0, 0.0, 0.0], [0.0, 0.0, 3.0]);
        });
        for turn in [0.0, 90.0] {
            let store = world(&turned(&scene, turn, [0.0; 3]), 0.002);
            let (s, c) = f64::to_radians(turn + 20.0).sin_cos();
            let way = Vector2::new(c, s);
            let (s, c) = f64::to_radians(turn).sin_cos();
            let along = Vector2::new(c, s);
            for body in [BOX, CYLINDER] {
                let at = scangen::geometry::Placement { rotate_deg: turn, translate: [0.0; 3] };
                let start = at.apply([-4.2, 0.3, ground + 0.02 * n as f64]);
                let mut walker = Walker::new(config(body), start.into()).unwrap();
                let mut before = walker.feet();
                for frame in 0..300 {
                    let report = walker.step(&store, 1.0 / 60.0, MoveInput::Direction(way));
                    let gained = (walker.feet() - before).xy().dot(&along);
                    let truth = 1.4 / 60.0 * way.dot(&along);
                    assert!(
                        (gained - truth).abs() < 1e-9,
                        "{body:?}: {gained} m in frame {frame}, at {}",
                        walker.feet()
                    );
                    assert_ne!(report.state, State::Blocked);
                    before = walker.feet();
                }
                assert!(before.xy().coords.dot(&along) > 2.0, "{before}");
            }
        }
    }
}

#[test]
fn slopes_are_stood_on_without_sliding_and_walked_without_bobbing() {
    for slope in [5.0f64, 20.0, 35.0, 40.0] {
        let (rise, run) = (2.0 * slope.to_radians().tan(), 2.0);
        let scene = scene(|b| {
            b.level("floor", [-2.0, -1.0, 0.0, 1.0], 0.0, &[]);
            b.quad("ramp", [0.0, -1.0, 0.0], [run, 0.0, rise], [0.0, 2.0, 0.0]);
            b.level("floor", [run, -1.0, run + 1.5, 1.0], rise, &[]);
        });
        let store = world(&scene, 0.0);
        for body in [BOX, CYLINDER] {
            let mut walker = Walker::new(config(body), Point3::new(-1.0, 0.013, 0.0)).unwrap();
            for (heading, frames) in [(1.0, 70), (0.0, 60), (1.0, 60), (-1.0, 120)] {
                for frame in 0..frames {
                    let before = walker.feet();
                    let wish =
                        if heading == 0.0 { MoveInput::Stay } else { MoveInput::Direction(Vector2::x() * heading) };
                    let report = walker.step(&store, 1.0 / 60.0, wish);
                    let up = (walker.feet().z - before.z) * heading;
                    assert_eq!(report.state, State::Walking, "{slope}°, {body:?}: at {before}");
                    assert!(up >= -1e-9, "{slope}°, {body:?}: down by {} at {before}", -up);
                    // The first frame of standing still may settle.
                    assert!(heading != 0.0 || frame == 0 || walker.feet() == before, "{slope}°: slides at {before}");
                }
            }
        }
    }
}

/// Two walls that form a corner, approached at any speed from any direction: nothing gets through.
#[test]
fn no_speed_leads_through_a_corner() {
    let scene = scene(|b| {
        b.level("floor", [-3.0, -3.0, 3.0, 3.0], 0.0, &[]);
        b.quad("wall", [1.0, -2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0]);
        b.quad("wall", [-2.0, 1.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 3.0]);
    });
    let store = world(&scene, 0.0);
    for speed in [0.1, 1.4, 10.0, 50.0, 300.0] {
        for hz in [15.0, 60.0, 240.0] {
            for degrees in [31.0f64, 45.0, 58.0] {
                for body in [BOX, CYLINDER] {
                    let config = Config { speed, ..config(body) };
                    let mut walker = Walker::new(config, Point3::new(0.3, 0.3, 0.0)).unwrap();
                    let way = Vector2::new(degrees.to_radians().cos(), degrees.to_radians().sin());
                    for _ in 0..((6.0 * hz / speed).clamp(3.0, 6.0 * hz) as usize) {
                        walker.step(&store, 1.0 / hz, MoveInput::Direction(way));
                        let feet = walker.feet();
                        let inside = feet.x <= 0.75 + 1e-6 && feet.y <= 0.75 + 1e-6;
                        assert!(inside && feet.z.abs() < 1e-3, "{body:?}, {speed} m/s, {hz} Hz: {feet}");
                    }
                    let half = config.body.half() * 0.7;
                    let (low, high) = (walker.feet() - half.push(-1e-3), walker.feet() + half.push(1.7));
                    assert_eq!(overlaps(&store, &Aabb::new(low, high).unwrap()), Overlap::Clear);
                }
            }
        }
    }
}

/// A box that meets a round column diagonally fits between two edges of its pixels; it gets out again and continues.
#[test]
fn edges_of_a_column_do_not_turn_a_pawn_back() {
    let scene = scene(|b| {
        b.level("floor", [-3.0, -3.0, 3.0, 3.0], 0.0, &[]);
        b.column("column", [0.0, 0.0], 0.3, [0.0, 3.0]);
    });
    let store = world(&scene, 0.001);
    for body in [BOX, CYLINDER] {
        for tick_s in [1.0 / 60.0, 1.0 / 240.0] {
            for n in 0..24 {
                // Towards the far corner, each run offset to the side by a different amount.
                let aside = 0.021 * (f64::from(n) - 11.5);
                let start = [-1.2 + aside, -1.2 - aside, 0.0];
                let config = Config { tick_s, ..config(body) };
                let trace = walk(&store, config, start, &[[2.0, 1.97]], 60.0, 12.0);
                if !trace.arrived() {
                    for (p, r) in trace.path.iter().zip(&trace.reports).rev().take(70).step_by(3) {
                        println!("DBG {p:?} {:?} {:?}", r.state, r.stop);
                    }
                }
                assert!(trace.arrived(), "{body:?}, ticks of {tick_s} s, {aside} aside: ends at {}", trace.end());
            }
        }
    }
}
