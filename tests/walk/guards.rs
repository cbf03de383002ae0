//! Guard rails: a pawn with `max_drop` stops at ledges and at the edge of the scan.

use super::world::*;
use nalgebra::{Point3, Vector2};
use slicewalk::store::Snapshot;
use slicewalk::walk::*;

/// A floor of 8 × 6 m with a hole, and on it a stage 1 m high with a hole through both.
fn stage() -> Snapshot {
    let deep = [-3.0, -1.0, -1.8, 0.4];
    let through = [2.5, -0.5, 3.5, 0.7];
    let scene = scene(|b| {
        b.level("floor", [-4.0, -3.0, 1.0, 3.0], 0.0, &[deep]);
        b.level("stage", [1.0, -3.0, 4.0, 3.0], 1.0, &[through]);
        b.quad("riser", [1.0, -3.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 1.0]);
    });
    world(&scene, 0.0)
}

/// Steps in random directions; returns where the pawn has been and why it stopped.
fn wander(store: &Snapshot, config: Config, start: [f64; 3], seed: u64, steps: usize) -> (Vec<Point3<f64>>, Vec<Stop>) {
    let mut walker = Walker::new(config, start.into()).unwrap();
    let (mut places, mut stops) = (Vec::new(), Vec::new());
    let mut state = seed;
    let mut heading = 0.0f64;
    for step in 0..steps {
        if step % 40 == 0 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            heading = (state >> 40) as f64;
        }
        let report = walker.step(store, 1.0 / 60.0, MoveInput::Direction(Vector2::new(heading.cos(), heading.sin())));
        stops.extend(report.stop);
        places.push(walker.feet());
    }
    (places, stops)
}

#[test]
fn nobody_falls_out_of_the_world() {
    let store = stage();
    for body in [BOX, CYLINDER] {
        let config = Config { tick_s: 1.0 / 60.0, ..config(body) };
        for (max_drop, start, low) in
            [(0.35, [0.0, 0.0, 0.05], -0.01), (0.35, [2.0, 2.0, 1.05], 0.99), (1.2, [2.0, 2.0, 1.05], -0.01)]
        {
            let config = Config { max_drop: Some(max_drop), ..config };
            let (mut lowest, mut reasons) = (f64::INFINITY, Vec::new());
            for seed in 0..4 {
                let (places, stops) = wander(&store, config, start, seed, 6000);
                lowest = places.iter().map(|feet| feet.z).fold(lowest, f64::min);
                reasons.extend(stops);
            }
            assert!(lowest > low, "{body:?}, {max_drop} m from {start:?}: at {lowest} m");
            assert!(reasons.contains(&Stop::Void), "{body:?}: it comes to the edge of the scan");
            assert_eq!(reasons.contains(&Stop::Ledge), max_drop < 1.0 && start[2] > 1.0, "{body:?}");
            if max_drop > 1.0 {
                assert!(lowest < 0.1, "{body:?}: it may jump off the stage");
            }
        }
        let (places, _) = wander(&store, config, [0.0, 0.0, 0.05], 1, 6000);
        assert!(places.iter().any(|feet| feet.z < -1.0), "{body:?}: without a guard rail it falls");
    }
}

#[test]
fn a_pawn_at_a_ledge_is_blocked_and_walks_back() {
    let store = stage();
    let config = Config { max_drop: Some(0.35), ..config(BOX) };
    let trace = walk(&store, config, [2.0, 2.0, 1.05], &[[-2.0, 2.0]], 60.0, 20.0);
    assert_eq!(trace.state(), State::Blocked);
    assert_eq!(trace.reports.last().unwrap().stop, Some(Stop::Ledge));
    // On the last pixel of the stage.
    assert!((0.7..1.0).contains(&trace.end().x) && (trace.end().z - 1.0).abs() < 0.01, "{}", trace.end());
    let mut back = trace.walker;
    for _ in 0..60 {
        back.step(&store, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
    }
    assert!(back.feet().x > 1.8, "{}", back.feet());
    // The words of `slicetool walk --json`.
    let stops = [Stop::Wall, Stop::Steep, Stop::Headroom, Stop::Corner, Stop::Inside, Stop::Ledge, Stop::Void];
    assert_eq!(stops.map(Stop::name), ["wall", "steep", "headroom", "corner", "inside", "ledge", "void"]);
    assert!(Walker::new(Config { max_drop: Some(-1.0), ..config }, Point3::origin()).is_err());
    assert!(Walker::new(Config { max_drop: Some(f64::NAN), ..config }, Point3::origin()).is_err());
}
