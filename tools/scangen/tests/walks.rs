//! The scenes' walks are walkable: by the truth alone, a box of 0.5 × 0.5 × 1.8 m gets from start to end.

use scangen::{Params, SCENES, Scene, Truth};

const HALF: f64 = 0.25;
const TALL: f64 = 1.8;
const CLIMB: f64 = 0.35;

/// Highest floor under the footprint that the box can step on from `z`.
fn floor(scene: &Scene, x: f64, y: f64, z: f64) -> f64 {
    let mut best = f64::NEG_INFINITY;
    for i in 0..=10 {
        for j in 0..=10 {
            let at = |k: i32| (f64::from(k) / 5.0 - 1.0) * HALF;
            best = best.max(scene.floor_under(x + at(i), y + at(j), z + CLIMB).map_or(best, |f| f.0));
        }
    }
    best
}

/// Follows the walk; returns the height of the feet at its end.
fn follow(scene: &Scene) -> f64 {
    let walk = scene.walk().unwrap();
    let ([mut x, mut y, mut z], name) = (walk.start, scene.name());
    assert!((floor(scene, x, y, z) - z).abs() < 1e-9, "{name}: the start is not on a floor");
    for [tx, ty] in &walk.waypoints {
        let len = (tx - x).hypot(ty - y);
        let steps = (len / 0.05).ceil().max(1.0);
        let (dx, dy) = ((tx - x) / steps, (ty - y) / steps);
        for _ in 0..steps as usize {
            (x, y) = (x + dx, y + dy);
            z = floor(scene, x, y, z);
            let free = scene.distance_to_box([x - HALF, y - HALF, z + CLIMB], [x + HALF, y + HALF, z + TALL]);
            assert!(free > 0.0, "{name}: blocked at {x:.2} {y:.2} {z:.2}");
        }
    }
    z
}

#[test]
fn every_walk_arrives_where_it_says() {
    for info in SCENES {
        let scene = Scene::named(info.name, &Params::new()).unwrap();
        if let Some(walk) = scene.walk() {
            assert!((follow(&scene) - walk.end[2]).abs() < 1e-9, "{} ends elsewhere", info.name);
            let last = walk.waypoints.last().unwrap();
            assert_eq!([walk.end[0], walk.end[1]], *last);
        }
    }
}

#[test]
fn the_house_can_be_climbed_in_other_sizes_too() {
    for (storeys, height) in [(1.0, 3.0), (2.0, 2.6), (5.0, 2.8), (4.0, 3.6)] {
        let params = Params::new().with("storeys", storeys).with("height", height).with("depth", 12.0);
        let scene = Scene::named("house", &params).unwrap();
        assert!((follow(&scene) - (storeys - 1.0) * height).abs() < 1e-9);
    }
}

#[test]
fn the_demonstration_leads_to_the_top() {
    let scene = Scene::demo();
    assert!((follow(&scene) - 6.0).abs() < 1e-9);
    assert_eq!(scene.walk().unwrap().start[2], 0.0);
    let count = scangen::demo::demo_samples(&scene, 1).unwrap().count();
    assert!((1_000_000..2_000_000).contains(&count), "{count} points");
}
