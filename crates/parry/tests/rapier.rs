//! Bodies of rapier on scanned stairs, and the window beside its definition and parry's own shapes.

use parry3d::bounding_volume::Aabb;
use parry3d::query::{PointQuery, Ray as ParryRay, RayCast};
use parry3d::shape::Shape as _;
use rapier3d::control::{CharacterAutostep, CharacterLength, KinematicCharacterController};
use rapier3d::prelude::*;
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{self, Overlap, cast, overlaps};
use slicewalk::store::{Snapshot, Stream, StreamOptions};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use slicewalk_parry::{Follow, Options, Unloaded, Window};
use std::sync::OnceLock;

/// Far from the coordinate origin, where `f32` has steps of half a metre.
const FAR: [f64; 3] = [4_500_000.0, 5_300_000.0, 100.0];

/// The archive of a flight of 12 stairs along x, from (0, 0, 0) up to 2.04 m, at `FAR`.
fn archive() -> &'static Archive {
    static MADE: OnceLock<Archive> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (scan, made) = (folder.path().join("scan.las"), folder.path().join("stairs.slices"));
        let place = scangen::geometry::Placement { rotate_deg: 0.0, translate: FAR };
        let scene = Scene::named("stairs", &Params::new()).unwrap().placed(&place);
        let samples = scene.samples(1, &SampleSpec::direct_density(3600.0).with_noise(0.001)).unwrap();
        write_samples(&scan, samples, &WriteSpec { offset: FAR, ..WriteSpec::for_path(&scan) }).unwrap();
        let mut options = ConvertOptions::new(vec![scan], made.clone());
        options.grid.pixel = PixelSize::Metres(0.05);
        options.reading.units = Units::Factor(1.0);
        options.resources.threads = 1;
        convert(&options, &NoMonitor).unwrap();
        Archive::from_bytes(std::fs::read(made).unwrap()).unwrap()
    })
}

fn store() -> Snapshot {
    Snapshot::resident(archive(), &NoMonitor).unwrap()
}

fn options() -> Options {
    Options::new(FAR.into())
}

fn corner(x: f64, y: f64, z: f64) -> Point3<f64> {
    Point3::from(FAR) + Vector3::new(x, y, z)
}

/// All of the stairs.
fn whole(store: &Snapshot) -> Window {
    Window::new(store, corner(-4.0, -3.0, -1.0), corner(8.0, 3.0, 4.0), &options()).unwrap()
}

/// A world with one collider of the scan, z up.
fn world(window: Window) -> (PhysicsWorld, ColliderHandle) {
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::new(0.0, 0.0, -9.81);
    let scan = world.insert_collider(ColliderBuilder::new(SharedShape::new(window)).friction(0.8), None);
    (world, scan)
}

fn unit(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

#[test]
fn rays_points_and_boxes_get_the_answers_of_the_library() {
    let store = store();
    let window = whole(&store);
    let (mut random, mut hits, mut free) = (3, 0, 0);
    for _ in 0..2000 {
        let at =
            Vector3::new(-1.5 + 6.0 * unit(&mut random), 2.0 * unit(&mut random) - 1.0, 3.0 * unit(&mut random) - 0.3);
        let way = Vector3::from_fn(|_, _| unit(&mut random) - 0.5).normalize();
        let from = Point3::from(FAR) + at;
        let [at32, way32] = [at, way].map(|v| Vector::new(v.x as f32, v.y as f32, v.z as f32));
        let expected = cast(&store, &query::Ray::new(from, way, 3.0).unwrap()).known().unwrap();
        let found = window.cast_local_ray(&ParryRay::new(at32, way32), 3.0, true);
        match (expected, found) {
            (Some(expected), Some(found)) => {
                // A ray that grazes an edge may meet or miss it by rounding, and then hits the next span.
                let near = (expected.distance - f64::from(found)).abs() < 1e-4;
                hits += usize::from(near);
            }
            (None, None) => free += 1,
            _ => {}
        }
        // A ball that the library calls clear has no solid within its radius, and one 1 mm larger than the distance hits.
        let distance = f64::from(window.distance_to_local_point(at32, true));
        let ball = |radius: f64| overlaps(&store, &query::Sphere::new(from, radius.max(0.0)).unwrap());
        assert_eq!(ball(distance + 1e-3), Overlap::Hit, "at {at:?}");
        assert!(distance < 2e-3 || ball(distance - 1e-3) == Overlap::Clear, "at {at:?}");
    }
    assert!(hits + free >= 1990 && hits > 500 && free > 300, "{hits} hits and {free} free rays are the same");
    let bounds = window.compute_local_aabb();
    assert!((bounds.mins.x + 2.0).abs() < 0.2 && (bounds.maxs.z - 2.04).abs() < 0.1, "{bounds:?}");
}

/// Lets a body roll from the upper landing down the stairs, with a small window that follows it.
fn rolls_down(shape: ColliderBuilder) -> (Vec<Vector>, usize) {
    let store = store();
    let mut follow = Follow::new(options(), 0.5);
    let start = Vector::new(3.3, 0.0, 2.3);
    let near = Aabb::from_half_extents(start, Vector::splat(0.3));
    let (mut world, scan) = world(follow.update(&store, &near).unwrap().unwrap());
    let body = RigidBodyBuilder::dynamic().translation(start).linvel(Vector::new(-2.0, 0.0, 0.0)).ccd_enabled(true);
    let body = world.insert_body(body);
    world.insert_collider(shape.friction(0.3).restitution(0.0), Some(body));
    let (mut path, mut windows) = (Vec::new(), 1);
    for _ in 0..480 {
        let at = world.bodies[body].translation();
        let near = Aabb::from_half_extents(at, Vector::splat(0.3));
        if let Some(window) = follow.update(&store, &near).unwrap() {
            assert!(window.memory_bytes() < 1 << 20, "{window:?}: {} bytes", window.memory_bytes());
            world.colliders[scan].set_shape(SharedShape::new(window));
            windows += 1;
        }
        world.step();
        let at = world.bodies[body].translation();
        // The scan ends there.
        if at.x < -1.7 || at.y.abs() > 0.9 {
            break;
        }
        path.push(at);
    }
    (path, windows)
}

#[test]
fn a_ball_rolls_down_scanned_stairs() {
    let (path, windows) = rolls_down(ColliderBuilder::ball(0.2));
    let end = path[path.len() - 1];
    println!("{} steps, {windows} windows, end {end:?}", path.len());
    let lowest = path.iter().map(|at| at.z).fold(f32::MAX, f32::min);
    assert!(windows >= 3, "{windows} windows");
    assert!(lowest > 0.17, "it sank into the scan: {lowest}");
    assert!(path.iter().any(|at| at.x < 0.2 && at.z < 0.3), "it is not at the foot of the stairs: {end:?}");
}

#[test]
fn a_capsule_and_a_box_tumble_down_scanned_stairs_and_stay_above() {
    for shape in [ColliderBuilder::capsule_y(0.1, 0.15), ColliderBuilder::cuboid(0.15, 0.15, 0.15)] {
        let (path, _) = rolls_down(shape);
        let lowest = path.iter().map(|at| at.z).fold(f32::MAX, f32::min);
        assert!(lowest > 0.1, "it sank into the scan: {lowest}");
        assert!(path.iter().any(|at| at.z < 2.1), "it stayed on the landing");
    }
}

#[test]
fn a_ball_rolls_over_seams_between_pixels_without_bumps() {
    let store = store();
    let jump = |level: f64| {
        let window =
            Window::new(&store, corner(-2.0, -1.0, -1.0), corner(0.0, 1.0, 1.0), &Options { level, ..options() });
        let (mut world, _) = world(window.unwrap());
        let body =
            RigidBodyBuilder::dynamic().translation(Vector::new(-1.7, 0.0, 0.21)).linvel(Vector::new(1.0, 0.0, 0.0));
        let body = world.insert_body(body);
        world.insert_collider(ColliderBuilder::ball(0.2), Some(body));
        let mut highest = 0.0_f32;
        for step in 0..60 {
            world.step();
            if step > 15 {
                highest = highest.max(world.bodies[body].linvel().z);
            }
        }
        (highest, world.bodies[body].translation().x)
    };
    let (upwards, end) = jump(0.01);
    assert!(end > -1.0, "the ball stopped at {end}");
    let (with_edges, _) = jump(0.0);
    assert!(upwards < 0.01 && upwards < with_edges, "the ball jumps at {upwards} m/s, over edges at {with_edges} m/s");
}

#[test]
fn the_character_controller_walks_up_scanned_stairs() {
    let store = store();
    let (mut world, _) = world(whole(&store));
    world.step();
    let shape = Cuboid::new(Vector::new(0.25, 0.25, 0.85));
    let controller = KinematicCharacterController {
        up: Vector::Z,
        offset: CharacterLength::Absolute(0.02),
        autostep: Some(CharacterAutostep {
            max_height: CharacterLength::Absolute(0.35),
            min_width: CharacterLength::Absolute(0.1),
            include_dynamic_bodies: false,
        }),
        snap_to_ground: Some(CharacterLength::Absolute(0.35)),
        ..KinematicCharacterController::default()
    };
    let mut at = Vector::new(-1.5, 0.0, 0.9);
    for _ in 0..600 {
        let wish = Vector::new(1.4 / 60.0, 0.0, -0.02);
        let pose = Pose::from_translation(at);
        let moved = controller.move_shape(1.0 / 60.0, &world.query_pipeline(), &shape, &pose, wish, |_| {});
        at += moved.translation;
        if at.x > 4.0 {
            break;
        }
    }
    assert!(at.x > 4.0 && (at.z - 0.85 - 2.04).abs() < 0.15, "the character stands at {at:?}");
}

#[test]
fn a_missing_page_is_solid_or_free_as_the_program_says() {
    let options_of = |unloaded| Options { unloaded, ..options() };
    let mut streaming = StreamOptions::new(64 << 20);
    streaming.prefetch = slicewalk::store::Prefetch::Off;
    let stream = Stream::open(Archive::from_bytes(bytes()).unwrap(), streaming).unwrap();
    let (min, max) = (corner(-1.5, -0.5, -0.5), corner(-0.5, 0.5, 0.5));
    let solid = Window::new(&stream.snapshot(), min, max, &options_of(Unloaded::Solid)).unwrap();
    let free = Window::new(&stream.snapshot(), min, max, &options_of(Unloaded::Free)).unwrap();
    assert!(
        !solid.missing().is_empty() && !solid.is_empty() && solid.contains_local_point(Vector::new(-1.0, 0.0, 0.0))
    );
    assert!(free.is_empty() && free.missing() == solid.missing());
    stream.load(solid.missing(), solid.missing()[0]).unwrap();
    let loaded = Window::new(&stream.snapshot(), min, max, &options()).unwrap();
    assert!(loaded.missing().is_empty());
    assert_eq!(loaded.len(), Window::new(&store(), min, max, &options()).unwrap().len());
}

/// The bytes of [`archive`].
fn bytes() -> Vec<u8> {
    let source = archive().source();
    let mut bytes = vec![0; source.len() as usize];
    source.read_at(0, &mut bytes).unwrap();
    bytes
}

#[test]
fn windows_that_cannot_be_are_refused() {
    let store = store();
    let refused = |min, max| Window::new(&store, min, max, &options()).unwrap_err().to_string();
    assert!(refused(corner(1.0, 0.0, 0.0), corner(0.0, 1.0, 1.0)).contains("corners"));
    assert!(refused(corner(f64::NAN, 0.0, 0.0), corner(0.0, 1.0, 1.0)).contains("corners"));
    assert!(refused(corner(-1e6, -1e6, 0.0), corner(1e6, 1e6, 1.0)).contains("smaller"));
    let nothing = Window::new(&store, corner(100.0, 0.0, 0.0), corner(101.0, 1.0, 1.0), &options()).unwrap();
    assert!(nothing.is_empty() && nothing.cast_local_ray(&ParryRay::new(Vector::ZERO, Vector::X), 9.0, true).is_none());
}
