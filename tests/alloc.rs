//! A frame allocates and frees nothing: queries, sweeps, walkers, crowds, views and hints, whatever they answer
//! (guarantee G8).

#[path = "common/random.rs"]
mod random;

#[path = "common/counting.rs"]
mod counting;
#[path = "oracle/scene.rs"]
#[allow(dead_code)]
mod scene;
#[path = "stream/tower.rs"]
mod tower;

use counting::allocations;
use nalgebra::{Point3, Vector2, Vector3};
use scene::Scene;
use slicewalk::bytes::MemorySource;
use slicewalk::frame::PageKey;
use slicewalk::object::{Model, Object, touches, touches_box, touches_scene, touches_sphere};
use slicewalk::query::*;
use slicewalk::store::{Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk::walk::{Body, Config, Crowd, MoveInput, Response, Walker, Waypoints};
use std::hint::black_box;
use std::sync::LazyLock;
use std::time::Duration;

#[test]
fn no_query_allocates() {
    assert!(allocations(|| drop(black_box(vec![1u8]))) > 0, "the counter counts");
    let mut not_loaded = 0;
    for (scene, mut random) in Scene::all().take(30) {
        let some: Vec<PageKey> = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(40)).collect();
        assert_eq!(ask_everything(&scene.store(), &scene, &mut random), 0);
        not_loaded += ask_everything(&scene.part(&some), &scene, &mut random);
    }
    assert!(not_loaded > 0, "some pages were missing");
}

/// Runs every kind of query on random boxes, without allocation; returns how many need a missing page.
fn ask_everything(store: &Snapshot, scene: &Scene, random: &mut scene::Random) -> usize {
    let boxes: Vec<Aabb> = (0..100).map(|_| scene.random_box(random)).collect();
    let mut answers = vec![Overlap::Clear; boxes.len()];
    let mut probes = vec![Answer::Known(Probe::default()); boxes.len()];
    let count = allocations(|| {
        overlaps_batch(store, &boxes, &mut answers);
        probe_batch(store, &boxes, &mut probes);
        for shape in &boxes {
            let (corner, size) = (shape.min(), shape.max() - shape.min());
            let sphere = Sphere::new(corner, size.norm() / 2.0).expect("finite");
            let cylinder = Cylinder::new(corner, size.x, size.z).expect("finite");
            black_box(overlaps(store, &sphere));
            black_box(overlaps(store, &cylinder));
            black_box(probe(store, &sphere));
            black_box(floor_under(store, &cylinder, shape.max().z, f64::INFINITY));
            black_box(ceiling_above(store, &cylinder, shape.min().z, f64::INFINITY));
            let way = size + Vector3::new(1e-3, 0.0, 1e-3);
            black_box(sweep(store, shape, way));
            black_box(sweep(store, &cylinder, -way));
            black_box(clearance(store, &cylinder, 0.5));
            black_box(nearest_surface(store, corner, 0.5));
            black_box(depenetrate(store, shape, 0.5));
            black_box(depenetrate(store, &cylinder, 0.5));
            black_box(top_under(store, &cylinder, shape.max().z, size.z));
            black_box(mean_floor_under(store, shape, shape.max().z, size.z));
            black_box(cast(store, &Ray::new(corner, way, f64::INFINITY).expect("finite")));
        }
    });
    assert_eq!(count, 0);
    answers.iter().filter(|answer| matches!(answer, Overlap::NotLoaded(_))).count()
}

static TOWER: LazyLock<Vec<u8>> = LazyLock::new(|| tower::tower(4.0, 12.0, 1));

/// Walkers of all bodies and responses, each with its feet on the tower's second floor.
fn walkers() -> Vec<Walker> {
    let bodies = [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }];
    let responses = [Response::Slide, Response::Thesis, Response::ThesisMean];
    let walker = |n: usize| {
        let config = Config { response: responses[n / 2], tick_s: 1.0 / 60.0, ..Config::new(bodies[n % 2]) };
        Walker::new(config, Point3::new(1.5 + 0.7 * (n / 3) as f64, 0.8 * (n % 3) as f64, 3.1)).unwrap()
    };
    (0..6).map(walker).collect()
}

/// Walks around and off the edge of the shaft; returns how often a walker had to wait.
fn walk(set: &Snapshot, walkers: &mut [Walker], route: &mut Waypoints) -> u32 {
    let mut waits = 0;
    for frame in 0..240 {
        let angle = f64::from(frame / 20);
        let wish = MoveInput::Direction(Vector2::new(angle.cos(), angle.sin()));
        for walker in &mut walkers[..3] {
            waits += u32::from(walker.step(set, 1.0 / 60.0, wish).waits());
            black_box(walker.motion_hint(set.frame()));
        }
        for walker in &mut walkers[3..] {
            waits += u32::from(walker.follow(set, 1.0 / 60.0, route).waits());
        }
    }
    waits
}

#[test]
fn no_walker_and_no_crowd_allocates() {
    let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(1 << 20) };
    let empty = Stream::open(tower::open(MemorySource::new(&TOWER[..])), options).unwrap();
    assert_eq!(walkers_and_a_crowd(&tower::resident(&TOWER)), 0);
    assert!(walkers_and_a_crowd(&empty.snapshot()) > 0, "no page is there");
}

/// Walks all walkers, alone and as a crowd, without allocation; returns how often one had to wait.
fn walkers_and_a_crowd(store: &Snapshot) -> u32 {
    let mut route = Waypoints::new(vec![[0.0, 0.0].into(), [3.0, 2.0].into()]).unwrap();
    let (mut walkers, mut waits) = (walkers(), 0);
    assert_eq!(allocations(|| waits = walk(store, &mut walkers, &mut route)), 0);
    let mut crowd = Crowd::new(walkers).unwrap();
    let mut step = || {
        for _ in 0..60 {
            black_box(crowd.step(store, 1.0 / 60.0, |n, _| MoveInput::Toward([n as f64 - 3.0, 1.0].into())));
        }
    };
    assert_eq!(allocations(&mut step), 0);
    waits
}

/// The prefetcher loads and evicts pages on its own thread meanwhile.
#[test]
fn no_frame_on_a_stream_allocates() {
    let options = StreamOptions { prefetch: Prefetch::Thread, ..StreamOptions::new(2 << 20) };
    let stream = Stream::open(tower::open(MemorySource::new(&TOWER[..])), options).unwrap();
    let mut pawn = stream.pawn();
    let mut walkers = walkers();
    let mut waits = 0;
    for frame in 0..600 {
        if frame % 60 == 0 {
            // Moves to where nothing is in memory.
            let at = f64::from(frame / 60 % 4);
            walkers[0].place(Point3::new(1.5 - at, 3.0 - 2.0 * at, 3.1 * at + 0.1));
        }
        let count = allocations(|| {
            pawn.hint(&walkers[0].motion_hint(stream.archive().frame()));
            let view = stream.snapshot();
            let report = walkers[0].step(&view, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
            if let Some(missing) = report.missing {
                pawn.need(&missing);
                black_box(view.is_loaded(missing.keys()[0]));
                waits += 1;
            }
            drop((view, pawn.snapshot()));
        });
        assert_eq!(count, 0, "frame {frame}");
        if frame % 7 == 0 {
            stream.settle(Duration::from_secs(60));
        }
    }
    let counters = stream.counters();
    assert!(waits > 0 && counters.loaded > 50 && counters.evicted > 0, "{waits} waits, {counters:?}");
}

#[test]
fn no_question_about_objects_allocates() {
    for (scene, mut random) in Scene::all().take(30) {
        let some: Vec<PageKey> = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(40)).collect();
        let (store, part) = (scene.store(), scene.part(&some));
        let model = Model::from_pages(&store).expect("all pages are there");
        let boxes: Vec<Aabb> = (0..20).map(|_| scene.random_box(&mut random)).collect();
        let count = allocations(|| {
            for shape in &boxes {
                let turn = nalgebra::Vector3::new(0.3, -0.2, shape.min().x);
                let objects = [0.0, 0.1].map(|shift| {
                    let moved = (shape.max() - shape.min()) * shift;
                    Object::new(&model, nalgebra::Isometry3::new(moved, turn * shift)).expect("finite")
                });
                black_box(touches(&objects[0], &objects[1]));
                black_box(touches_box(&objects[1], shape));
                black_box(touches_sphere(&objects[1], &Sphere::new(shape.min(), 0.2).expect("finite")));
                black_box(touches_scene(&objects[1], &store));
                black_box(touches_scene(&objects[1], &part));
            }
        });
        assert_eq!(count, 0);
    }
}
