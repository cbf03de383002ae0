//! Stairs: who climbs them. Our walker, Jolt's `CharacterVirtual` and the controller of `rapier3d`, each with steps of one
//! height, on generated flights whose way is known.

use super::cpp::Native;
use super::matter::{Matter, Mesh};
use crate::peers::character::{FRAME_S, Pawn, Physics, STEPS};
use crate::peers::measure::summary;
use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::walks::cases::{self, Case};
use nalgebra::Vector3;
use parry3d::shape::{SharedShape, TriMesh};
use scangen::SampleSpec;
use slicewalk::plan::Classifier;
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, MoveInput, Walker};
use std::fmt::Write;
use std::time::Instant;

/// The pawn (m); its width is that of capsules, too.
const RADIUS_M: f64 = 0.25;
const HEIGHT_M: f64 = 1.8;
/// Points to a side of a pixel, and their noise (m).
const PER_PIXEL: f64 = 3.0;
const NOISE_M: f64 = 0.002;
/// Times as long as the exact pawn that a pawn is given.
const PATIENCE: f64 = 2.0;
/// Edges of cubes (m).
const EDGES: [f64; 2] = [0.05, 0.02];

/// How a climb ended.
struct Climb {
    /// The greatest height of the feet (m).
    height: f64,
    /// Mean time of a frame (ns).
    frame_ns: f64,
}

impl Climb {
    fn new(feet: impl Iterator<Item = f64>, start: f64, times: Vec<f64>) -> Self {
        Self { height: feet.fold(f64::NEG_INFINITY, f64::max) - start, frame_ns: summary(times)[0] }
    }
}

fn walker(store: &Snapshot, case: &Case, origin: Vector3<f64>, frames: usize) -> Result<Climb> {
    let mut walker = Walker::new(Config::new(case.body), case.start - origin)?;
    let (mut times, mut feet) = (Vec::new(), Vec::new());
    for _ in 0..frames {
        let start = Instant::now();
        walker.step(store, FRAME_S, MoveInput::Direction(case.toward));
        times.push(start.elapsed().as_secs_f64() * 1e9);
        feet.push(walker.feet().z);
    }
    Ok(Climb::new(feet.into_iter(), case.start.z - origin.z, times))
}

fn jolt(native: &Native, mesh: &Mesh, case: &Case, origin: Vector3<f64>, frames: usize) -> Result<Option<Climb>> {
    let config = Config::new(case.body);
    let world = native.build(&[], 1.0, mesh)?;
    let walked =
        world.walk(case.start - origin, case.toward * config.speed, [RADIUS_M, HEIGHT_M], config.climb, frames);
    let start = case.start.z - origin.z;
    Ok(walked.map(|(feet, times)| Climb::new(feet.into_iter().map(|p| p[2]), start, times)))
}

fn rapier(mesh: &Mesh, case: &Case, origin: Vector3<f64>, frames: usize) -> Result<Vec<Climb>> {
    let vertices = mesh.vertices.iter().map(|v| parry3d::math::Vector::new(v[0], v[1], v[2])).collect();
    let physics = Physics::new(SharedShape::new(TriMesh::new(vertices, mesh.triangles.clone())?));
    let way = case.toward * Config::new(case.body).speed * FRAME_S;
    let climbs = STEPS.into_iter().map(|steps| {
        let mut pawn = Pawn::new(&physics, case.start - origin, [RADIUS_M, HEIGHT_M], steps);
        let (mut times, mut feet) = (Vec::new(), Vec::new());
        for _ in 0..frames {
            times.push(pawn.step(way));
            feet.push(pawn.feet().z);
        }
        Climb::new(feet.into_iter(), case.start.z - origin.z, times)
    });
    Ok(climbs.collect())
}

/// The true surfaces, each corner once.
fn surfaces(case: &Case) -> Mesh {
    let (mut numbers, mut mesh) =
        (std::collections::HashMap::new(), Mesh { vertices: Vec::new(), triangles: Vec::new() });
    for surface in case.scene.surfaces() {
        surface.shape.triangles(0.05, &mut |corners| {
            let triangle = corners.map(|corner: [f64; 3]| {
                let single = corner.map(|v| v as f32);
                *numbers.entry(single.map(f32::to_bits)).or_insert_with(|| {
                    mesh.vertices.push(single);
                    mesh.vertices.len() as u32 - 1
                })
            });
            mesh.triangles.push(triangle);
        });
    }
    mesh
}

/// The table of flights of four risers.
pub fn table(native: Option<&Native>, quick: bool) -> Result<String> {
    let body = Body::Cylinder { radius: RADIUS_M, height: HEIGHT_M };
    let cases = cases::all(body, 0.0, [0.013, 0.027, 0.041]).into_iter();
    let cases: Vec<Case> = cases.filter(|case| case.name.starts_with("stairs") && case.name.ends_with("up")).collect();
    let names: Vec<&str> = cases.iter().map(|case| case.name.trim_end_matches(", up")).collect();
    let mut page = format!("\n| | {} |\n| --- |{}\n", names.join(" | "), " --- |".repeat(names.len()));
    let mut rows: Vec<(String, Vec<String>)> = Vec::new();
    let mut add = |who: String, case: &Case, climb: &Climb| {
        let top = case.truth.last().map_or(0.0, |end| end.z) - case.start.z;
        let word = if climb.height > top - 0.05 { "climbs".into() } else { format!("stays at {:.2} m", climb.height) };
        let cell = format!("{word}, {:.1} µs", climb.frame_ns / 1e3);
        println!("{who}: {}: {cell}", case.name);
        match rows.iter_mut().find(|(name, _)| *name == who) {
            Some((_, cells)) => cells.push(cell),
            None => rows.push((who, vec![cell])),
        }
    };
    for case in &cases {
        let frames = (PATIENCE * case.seconds / FRAME_S).ceil() as usize;
        if let Some(native) = native
            && let Some(climb) = jolt(native, &surfaces(case), case, Vector3::zeros(), frames)?
        {
            add("Jolt, true surfaces".into(), case, &climb);
        }
        for &edge in if quick { &EDGES[..1] } else { &EDGES[..] } {
            let spec = SampleSpec::direct_density((PER_PIXEL / edge).powi(2)).with_noise(NOISE_M);
            let scan = Scan::new(case.scene.points(11, &spec)?.collect())?;
            let converted = scan.convert(Setting::new(edge), Classifier::Plane)?;
            let cm = format!("{:.0} cm", edge * 100.0);
            add(format!("slicewalk, {cm}"), case, &walker(&converted.store, case, Vector3::zeros(), frames)?);
            let folder = tempfile::tempdir()?;
            let file = folder.path().join("stairs.slices");
            std::fs::write(&file, &converted.bytes)?;
            let matter = Matter::new(&file, case.start.coords)?;
            add(format!("slicewalk, the cubes, {cm}"), case, &walker(&matter.store, case, matter.origin, frames)?);
            let (mesh, merged) = (matter.mesh(), matter.merged());
            for (what, mesh) in [("faces of the cubes", &mesh), ("merged faces", &merged)] {
                if let Some(native) = native
                    && let Some(climb) = jolt(native, mesh, case, matter.origin, frames)?
                {
                    add(format!("Jolt, {what}, {cm}"), case, &climb);
                }
            }
            for ((_, tread), climb) in STEPS.iter().zip(rapier(&mesh, case, matter.origin, frames)?) {
                add(format!("rapier3d, faces of the cubes, {cm}, treads of {tread} m"), case, &climb);
            }
        }
    }
    for (who, cells) in rows {
        let _ = writeln!(page, "| {who} | {} |", cells.join(" | "));
    }
    Ok(page)
}
