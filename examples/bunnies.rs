//! Flies bodies of a mesh around in a box at 60 frames a second; they turn back where they touch each other.
//!
//! `cargo run --release --example bunnies -- bunny.ply [COUNT]`; the Stanford bunny is one such mesh. Prints the time
//! of a frame's collision tests. Bounding spheres are compared first; [`touches`] decides.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use slicewalk::NoMonitor;
use slicewalk::frame::Frame;
use slicewalk::object::{Model, Object, touches};
use slicewalk::plan::Up;
use slicewalk_input::Units;
use slicewalk_mesh::{MeshOptions, MeshSet, Triangle};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

const FRAMES: usize = 600;
const DT: f64 = 1.0 / 60.0;

struct Body {
    pose: Isometry3<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("name a mesh: OBJ, PLY, STL or glTF")?;
    let count: usize = arguments.next().as_deref().unwrap_or("30").parse()?;

    let triangles = read(Path::new(&path))?;
    let axis = |k: usize| triangles.iter().flatten().map(move |p| p[k]);
    let size = (0..3).map(|k| axis(k).fold(f64::MIN, f64::max) - axis(k).fold(f64::MAX, f64::min)).fold(0.0, f64::max);
    let pixel = size / 150.0;
    let model = Model::from_triangles(Frame::new(pixel, 3.0 * pixel)?, &triangles, false)?;
    println!("{} triangles, {} spans, {} kB", triangles.len(), model.span_count(), model.weight_bytes() / 1000);

    // Start side by side, then move in random directions.
    let side = (count as f64).cbrt().ceil() as usize;
    let middle =
        |n: usize| Vector3::new((n % side) as f64, (n / side % side) as f64, (n / side / side) as f64) * size * 1.8;
    let wave = |n: usize, k: f64| (n as f64 * k).sin();
    let mut bodies: Vec<Body> = (0..count)
        .map(|n| Body {
            pose: Isometry3::from_parts(Translation3::from(middle(n)), UnitQuaternion::identity()),
            velocity: Vector3::new(wave(n, 1.3), wave(n, 2.7), wave(n, 3.1)) * size,
            spin: Vector3::new(wave(n, 0.7), wave(n, 1.9), wave(n, 2.3)) * 3.0,
        })
        .collect();

    let (mut worst, mut total, mut contacts, mut tests) = (0.0f64, 0.0, 0u64, 0u64);
    for _ in 0..FRAMES {
        let before: Vec<Isometry3<f64>> = bodies.iter().map(|body| body.pose).collect();
        for body in &mut bodies {
            body.pose.translation.vector += body.velocity * DT;
            body.pose.rotation = UnitQuaternion::new(body.spin * DT) * body.pose.rotation;
            for k in 0..3 {
                let place = body.pose.translation.vector[k];
                let inward = if place < 0.0 { 1.0 } else { -1.0 };
                if !(0.0..=size * 1.8 * side as f64).contains(&place) {
                    body.velocity[k] = inward * body.velocity[k].abs();
                }
            }
        }
        let start = Instant::now();
        let placed = bodies.iter().map(|body| Object::new(&model, body.pose));
        let objects = placed.collect::<slicewalk::Result<Vec<_>>>()?;
        let mut touched = Vec::new();
        for (a, b) in (0..count).flat_map(|a| (0..a).map(move |b| (a, b))) {
            let ((p, r), (q, s)) = (objects[a].ball(), objects[b].ball());
            if (p - q).norm() <= r + s {
                tests += 1;
                if touches(&objects[a], &objects[b]) {
                    touched.push((a, b));
                }
            }
        }
        let micros = start.elapsed().as_secs_f64() * 1e6;
        (worst, total) = (worst.max(micros), total + micros);
        for (a, b) in touched {
            contacts += 1;
            // Move back to where the bodies did not touch, and away from each other.
            let apart = bodies[a].pose.translation.vector - bodies[b].pose.translation.vector;
            let away = apart.try_normalize(1e-12).unwrap_or(Vector3::x());
            for (n, sign) in [(a, 1.0), (b, -1.0)] {
                let body = &mut bodies[n];
                body.pose = before[n];
                let speed = body.velocity.norm();
                body.velocity =
                    (body.velocity + away * sign * speed).try_normalize(1e-12).unwrap_or(away * sign) * speed;
                body.spin = -body.spin;
            }
        }
    }
    println!("{count} bodies, {FRAMES} frames: {tests} pairs looked at, {contacts} contacts");
    println!("collision of a frame: {:.0} µs on average, {worst:.0} at most, of 16,667", total / FRAMES as f64);
    Ok(())
}

fn read(path: &Path) -> slicewalk::Result<Vec<Triangle>> {
    let options =
        MeshOptions { units: Units::Factor(1.0), up: Up::Y, memory_bytes: 256 << 20, ..MeshOptions::default() };
    let set = MeshSet::open(&[path.to_path_buf()], options, &NoMonitor)?;
    let (mut feed, mut batch, mut all) = (set.feed(), Vec::new(), Vec::new());
    while feed.next(&mut batch, &NoMonitor)? {
        all.extend_from_slice(&batch);
    }
    Ok(all)
}
