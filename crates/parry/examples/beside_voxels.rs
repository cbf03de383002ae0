//! Prints memory and speed of a window beside parry's own voxels of the same solid, as ratios.
//!
//! Run with `cargo run --release -p slicewalk-parry --example beside_voxels`.

use parry3d::math::{IVector, Pose, Vector};
use parry3d::query::{Ray, RayCast};
use parry3d::shape::{Ball, CompositeShape, Shape, Voxels};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::nalgebra::Point3;
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use slicewalk_parry::{Options, Window};
use std::time::Instant;

/// Edge of a cube (m); also the pixel size.
const EDGE: f64 = 0.05;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let pages = stairs()?;
    let begin = Instant::now();
    let corners = [Point3::new(-4.0, -3.0, -1.0), Point3::new(8.0, 3.0, 4.0)];
    let window = Window::new(&pages, corners[0], corners[1], &Options::new(Point3::origin()))?;
    let made = begin.elapsed().as_secs_f64();
    let cubes = cubes(&window);
    let begin = Instant::now();
    let voxels = Voxels::new(Vector::splat(EDGE as f32), &cubes);
    let voxels_made = begin.elapsed().as_secs_f64();

    let mut random = 5;
    let mut between = |low: f64, high: f64| (low + (high - low) * unit(&mut random)) as f32;
    let mut place = || {
        let at = Vector::new(between(-1.5, 4.5), between(-0.9, 0.9), between(0.2, 3.0));
        (at, Vector::new(between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 0.0)))
    };
    let places: Vec<_> = (0..20_000).map(|_| place()).collect();
    let time = |work: &dyn Fn(Vector, Vector) -> f32| {
        let begin = Instant::now();
        let sum: f32 = places.iter().map(|&(at, way)| work(at, way)).sum();
        (begin.elapsed().as_secs_f64(), sum)
    };
    let ray = |shape: &dyn RayCast, at, way| shape.cast_local_ray(&Ray::new(at, way), 3.0, true).unwrap_or(0.0);
    let ball = Ball::new(0.2);
    let touches = |shape: &dyn Shape, at: Vector| {
        let hit = parry3d::query::intersection_test(&Pose::IDENTITY, shape, &Pose::from_translation(at), &ball);
        hit.map_or(0.0, |hit| f32::from(u8::from(hit.intersecting)))
    };
    let spans = window.len() as f64;
    println!("a span: {:.0} bytes, {:.2} µs to make", window.memory_bytes() as f64 / spans, made * 1e6 / spans);
    println!("{spans} spans, {} cubes; window divided by voxels:", cubes.len());
    println!("memory {:.2}", window.memory_bytes() as f64 / voxels.total_memory_size() as f64);
    println!("making {:.2}", made / voxels_made);
    let rays = [time(&|at, way| ray(&window, at, way)), time(&|at, way| ray(&voxels, at, way))];
    println!("rays {:.2}", rays[0].0 / rays[1].0);
    let balls = [time(&|at, _| touches(&window, at)), time(&|at, _| touches(&voxels, at))];
    println!("balls {:.2}; of {} touch {} and {}", balls[0].0 / balls[1].0, places.len(), balls[0].1, balls[1].1);
    Ok(())
}

/// Returns a scanned flight of 12 stairs.
fn stairs() -> Result<Snapshot, Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let (scan, made) = (folder.path().join("scan.las"), folder.path().join("stairs.slices"));
    let scene = Scene::named("stairs", &Params::new())?;
    let samples = scene.samples(1, &SampleSpec::direct_density(3600.0).with_noise(0.001))?;
    write_samples(&scan, samples, &WriteSpec::for_path(&scan))?;
    let mut options = ConvertOptions::new(vec![scan], made.clone());
    options.grid.pixel = PixelSize::Metres(EDGE);
    options.reading.units = Units::Factor(1.0);
    convert(&options, &NoMonitor)?;
    Ok(Snapshot::resident(&Archive::open(made)?, &NoMonitor)?)
}

/// Returns the cubes that the spans of the window occupy.
fn cubes(window: &Window) -> Vec<IVector> {
    let mut cubes = Vec::new();
    for part in 0..window.len() as u32 {
        CompositeShape::map_part_at(window, part, &mut |pose, shape, _| {
            let (Some(pose), Some(shape)) = (pose, shape.as_cuboid()) else { return };
            let (low, high) = (pose.translation - shape.half_extents, pose.translation + shape.half_extents);
            let cell = |v: f32| (f64::from(v) / EDGE).floor() as i32;
            let middle = pose.translation;
            (cell(low.z)..=cell(high.z)).for_each(|z| cubes.push(IVector::new(cell(middle.x), cell(middle.y), z)));
        });
    }
    cubes
}

/// A number from 0 to 1, from a linear congruential generator.
fn unit(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 53) as f64
}
