//! Two Stanford bunnies in random poses: in Slicewalk at some pixel sizes, and as triangles in `parry3d`.

use super::models::triangles;
use crate::Random;
use crate::data;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::shape::TriMesh;
use slicewalk::frame::Frame;
use slicewalk::object::{Model, Object, touches};
use slicewalk_mesh::Triangle;
use std::hint::black_box;
use std::time::Instant;

/// Poses are drawn with their middles this near along each axis (m); the bunny is 0.16 m wide.
const REACH_M: f64 = 0.16;
/// Most denied hits of which the distance is asked: it takes `parry3d` about a second.
const DISTANCES: usize = 25;
/// Rounds over all poses with Slicewalk.
const ROUNDS: usize = 3;

/// The table by name.
pub fn measure(quick: bool) -> Result<Vec<(&'static str, String)>> {
    let Some(path) = data::file("meshes/bunny_stanford.ply") else {
        return Ok(vec![("bunnies", "The bunny was not there.".into())]);
    };
    let mut bunny = triangles(&path, true)?;
    // About its middle.
    bunny.iter_mut().flatten().for_each(|p| *p = [p[0] + 0.017, p[1] - 0.002, p[2] - 0.11]);
    let mut random = Random(8);
    let poses: Vec<[Isometry3<f64>; 2]> =
        (0..if quick { 200 } else { 10_000 }).map(|_| [pose(&mut random), pose(&mut random)]).collect();

    let mesh = trimesh(&bunny)?;
    let pairs: Vec<[Pose; 2]> = poses.iter().map(|pair| pair.map(|pose| parry_pose(&pose))).collect();
    let mut truth = Vec::with_capacity(poses.len());
    let start = cpu_seconds()?;
    for [a, b] in &pairs {
        truth.push(parry3d::query::intersection_test(a, &mesh, b, &mesh)?.intersecting);
    }
    let theirs = (cpu_seconds()? - start) * 1e6 / poses.len() as f64;
    let touching = truth.iter().filter(|&&hit| hit).count();

    let mut table = Table::new([
        "pixel (mm)",
        "spans",
        "memory (MB)",
        "prepared (ms)",
        "a pose, mean (µs)",
        "median (µs)",
        "99 % below (µs)",
        "parry3d / Slicewalk, mean",
        "hits",
        "hits that triangles deny",
        "furthest of these (pixels)",
        "misses",
    ]);
    for t in [0.004, 0.002, 0.001, 0.0005] {
        let start = Instant::now();
        let model = Model::from_triangles(Frame::new(t, 3.0 * t)?, &bunny, false)?;
        let prepared = start.elapsed().as_secs_f64() * 1e3;
        let mut objects = Vec::with_capacity(poses.len());
        for [a, b] in &poses {
            objects.push([Object::new(&model, *a)?, Object::new(&model, *b)?]);
        }
        // The best of some rounds for each pose: other work on the machine only adds.
        let mut single = vec![f64::INFINITY; objects.len()];
        for _ in 0..ROUNDS {
            for ([a, b], best) in objects.iter().zip(&mut single) {
                let start = Instant::now();
                black_box(touches(black_box(a), black_box(b)));
                *best = best.min(start.elapsed().as_secs_f64() * 1e6);
            }
        }
        let start = cpu_seconds()?;
        for [a, b] in &objects {
            black_box(touches(black_box(a), black_box(b)));
        }
        let ours = (cpu_seconds()? - start) * 1e6 / objects.len() as f64;
        single.sort_by(f64::total_cmp);
        let found: Vec<bool> = objects.iter().map(|[a, b]| touches(a, b)).collect();
        let misses = found.iter().zip(&truth).filter(|(ours, theirs)| !**ours && **theirs).count();
        let denied: Vec<usize> = (0..found.len()).filter(|&n| found[n] && !truth[n]).collect();
        let mut furthest = 0.0f64;
        for &n in denied.iter().take(DISTANCES) {
            let [a, b] = &pairs[n];
            furthest = furthest.max(f64::from(parry3d::query::distance(a, &mesh, b, &mesh)?.distance));
        }
        table.row([
            number(t * 1e3, 1),
            model.span_count().to_string(),
            number(model.weight_bytes() as f64 / 1e6, 1),
            number(prepared, 0),
            number(ours, 2),
            number(single[single.len() / 2], 2),
            number(single[single.len() * 99 / 100], 2),
            number(theirs / ours, 1),
            found.iter().filter(|&&hit| hit).count().to_string(),
            denied.len().to_string(),
            number(furthest / t, 2),
            misses.to_string(),
        ]);
    }
    let words = format!(
        "{} poses, {touching} of them touching by the triangles; `parry3d` {} takes {} µs a pose.",
        poses.len(),
        "0.31 (`TriMesh` against `TriMesh`, 32 bits)",
        number(theirs, 0)
    );
    Ok(vec![("bunnies", format!("{words}\n\n{}", table.markdown()))])
}

/// Time that this thread has had a processor (s): others on the machine do not count.
fn cpu_seconds() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: f64 = text.split_whitespace().next().ok_or("the system tells no time")?.parse()?;
    Ok(nanoseconds / 1e9)
}

fn pose(random: &mut Random) -> Isometry3<f64> {
    let half = REACH_M / 2.0;
    let place = Translation3::from(Vector3::from_fn(|_, _| random.between(-half, half)));
    let axis = Vector3::from_fn(|_, _| random.between(-1.0, 1.0));
    Isometry3::from_parts(place, UnitQuaternion::new(axis * 3.0))
}

fn parry_pose(pose: &Isometry3<f64>) -> Pose {
    let (shift, turn) = (pose.translation.vector.map(|v| v as f32), pose.rotation.coords.map(|v| v as f32));
    Pose::from_parts(
        Vector::new(shift.x, shift.y, shift.z),
        Rotation::from_xyzw(turn.x, turn.y, turn.z, turn.w).normalize(),
    )
}

fn trimesh(triangles: &[Triangle]) -> Result<TriMesh> {
    let corner = |p: &[f64; 3]| Vector::new(p[0] as f32, p[1] as f32, p[2] as f32);
    let corners = triangles.iter().flatten().map(corner).collect();
    let faces = (0..triangles.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
    TriMesh::new(corners, faces).map_err(|e| format!("parry3d: {e:?}").into())
}
