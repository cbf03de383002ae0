//! A pawn climbs scanned stairs in an app without a window.

use bevy_app::App;
use bevy_math::Vec3;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use bevy_transform::components::Transform;
use bevy_walk::{Pawn, Scan, ScanPlugin};
use scangen::geometry::Placement;
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::nalgebra::{Point3, Vector2, Vector3};
use slicewalk::walk::{Config, MoveInput};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::time::Duration;

/// Where `f32` has steps of half a metre.
const FAR: [f64; 3] = [4_500_000.0, 5_300_000.0, 100.0];

/// A flight of 12 stairs along x, from (0, 0, 0) up to 2.04 m, at `FAR`.
fn stairs() -> Archive {
    let folder = tempfile::tempdir().unwrap();
    let (scan, made) = (folder.path().join("scan.las"), folder.path().join("stairs.slices"));
    let place = Placement { rotate_deg: 0.0, translate: FAR };
    let scene = Scene::named("stairs", &Params::new()).unwrap().placed(&place);
    let samples = scene.samples(1, &SampleSpec::direct_density(3600.0).with_noise(0.001)).unwrap();
    write_samples(&scan, samples, &WriteSpec { offset: FAR, ..WriteSpec::for_path(&scan) }).unwrap();
    let mut options = ConvertOptions::new(vec![scan], made.clone());
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor).unwrap();
    Archive::from_bytes(std::fs::read(made).unwrap()).unwrap()
}

#[test]
fn a_pawn_climbs_the_stairs_and_its_transform_follows() {
    let origin = Point3::from(FAR);
    let scan = Scan::new(stairs(), 16 << 20, origin).unwrap();
    let mut pawn = Pawn::new(&scan, Config::default(), origin + Vector3::new(-1.5, 0.0, 0.1)).unwrap();
    pawn.wish = MoveInput::Direction(Vector2::x());
    let tick = Duration::from_secs_f64(1.0 / 64.0);
    let mut app = App::new();
    app.add_plugins((TimePlugin, ScanPlugin))
        .insert_resource(TimeUpdateStrategy::ManualDuration(tick))
        .insert_resource(Time::<Fixed>::from_duration(tick))
        .insert_resource(scan);
    let walker = app.world_mut().spawn((pawn, Transform::default())).id();
    let place = |app: &App| app.world().get::<Transform>(walker).unwrap().translation;
    let mut highest = f32::MIN;
    for _ in 0..64 * 6 {
        app.update();
        highest = highest.max(place(&app).y);
    }
    assert!((highest - 2.04).abs() < 0.02, "{highest}");
    let feet = app.world().get::<Pawn>(walker).unwrap().walker().feet() - origin;
    let expected = Vec3::new(feet.x as f32, feet.z as f32, -feet.y as f32);
    assert!(place(&app).distance(expected) < 1e-5, "{} beside {expected}", place(&app));
}
