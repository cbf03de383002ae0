//! How far walked ways are from the exact ones, both ways round: places walked that are off it, and places of it that were
//! not walked, as by a pawn that got stuck.

use super::record::Figure;
use super::solid::cubes;
use crate::peers::character::{FRAME_S, Pawn, Physics, STEPS};
use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::walks::cases::{self, Case};
use crate::walks::path::nearest;
use nalgebra::Point3;
use rapier3d::prelude::SharedShape;
use scangen::SampleSpec;
use slicewalk::plan::Classifier;
use slicewalk::walk::{Body, Config, MoveInput, Response, Walker};

/// The pawn (m).
const RADIUS_M: f64 = 0.25;
const HEIGHT_M: f64 = 1.8;
/// Obstacles on the paths.
const CASES: [&str; 5] = ["door of 1 m", "inner corner", "kerb of 15 cm", "stairs of 17 cm, up", "ramp of 15°, up"];
/// Points to a side of a pixel; points farther than this from the exact way are left out (m).
const PER_PIXEL: f64 = 3.0;
const ASIDE_M: f64 = 0.8;
/// Times as long as the exact pawn that a pawn is given.
const PATIENCE: f64 = 1.5;
/// Places of the exact way (m).
const STEP_M: f64 = 0.02;

/// A case and the points of its scene.
fn scans(pixel_m: f64) -> Result<Vec<(Case, Scan)>> {
    let body = Body::Cylinder { radius: RADIUS_M, height: HEIGHT_M };
    let cases = cases::all(body, 0.0, [0.013, 0.027, 0.041]).into_iter();
    let spec = SampleSpec::direct_density((PER_PIXEL / pixel_m).powi(2)).with_noise(0.002);
    let scan = |case: Case| {
        let [low, high] = [f64::min, f64::max].map(|of: fn(f64, f64) -> f64| {
            [0, 1].map(|axis| case.truth.iter().map(|p| p[axis]).reduce(of).unwrap_or_default())
        });
        let near = |p: &[f64; 3]| (0..2).all(|a| (low[a] - ASIDE_M..=high[a] + ASIDE_M).contains(&p[a]));
        let scan = Scan::new(case.scene.points(11, &spec)?.filter(near).collect())?;
        Ok((case, scan))
    };
    cases.filter(|case| CASES.contains(&case.name)).map(scan).collect()
}

/// Our walker.
pub fn ours(pixel_m: f64) -> Result<Option<Figure>> {
    let mut offs = Vec::new();
    for (case, scan) in scans(pixel_m)? {
        let store = scan.convert(Setting::new(pixel_m), Classifier::Plane)?.store;
        let config = Config { response: Response::Slide, ..Config::new(case.body) };
        let mut walker = Walker::new(config, case.start)?;
        offs.push(off(&case, || {
            walker.step(&store, FRAME_S, MoveInput::Direction(case.toward));
            walker.feet()
        }));
    }
    Ok(greatest(offs))
}

/// The controller of `rapier3d` on cubes, with the width of treads that suits it better.
pub fn rapier(pixel_m: f64) -> Result<Option<Figure>> {
    let mut offs = [Vec::new(), Vec::new()];
    for (case, scan) in scans(pixel_m)? {
        let points: Vec<_> = scan.points.iter().map(|p| Point3::from(*p)).collect();
        let physics = Physics::new(SharedShape::new(cubes(&points, pixel_m)));
        for (steps, offs) in STEPS.into_iter().zip(&mut offs) {
            let mut pawn = Pawn::new(&physics, case.start, [RADIUS_M, HEIGHT_M], steps);
            let way = case.toward * Config::new(case.body).speed * FRAME_S;
            offs.push(off(&case, || {
                pawn.step(way);
                pawn.feet()
            }));
        }
    }
    Ok(offs.into_iter().filter_map(greatest).min_by(|a, b| a.value.total_cmp(&b.value)))
}

/// The greatest of all cases (cm).
fn greatest(mut offs: Vec<f64>) -> Option<Figure> {
    offs.sort_by(f64::total_cmp);
    let (low, high) = (*offs.first()? * 100.0, *offs.last()? * 100.0);
    Some(Figure { metric: "path_cm", value: high, low, high, n: offs.len() })
}

/// Walks until the end of the exact way, or as long as there is patience; the greatest deviation (m).
fn off(case: &Case, mut step: impl FnMut() -> Point3<f64>) -> f64 {
    let mut walked = vec![case.start];
    let mut off = 0.0f64;
    for _ in 0..(case.seconds * PATIENCE / FRAME_S) as usize {
        let feet = step();
        let (away, share) = nearest(&case.truth, case.goes_on, feet);
        off = off.max(away);
        walked.push(feet);
        if share >= 1.0 {
            break;
        }
    }
    for ends in case.truth.windows(2) {
        let places = ((ends[1] - ends[0]).norm() / STEP_M).ceil() as usize;
        for n in 0..=places {
            let place = ends[0] + (ends[1] - ends[0]) * (n as f64 / places.max(1) as f64);
            off = off.max(nearest(&walked, false, place).0);
        }
    }
    off
}
