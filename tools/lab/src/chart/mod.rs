//! Speed against accuracy: every method in every scene at six pixel sizes, with its costs and errors.
//!
//! Out: `chart/measured.csv`, one line per figure, and `chart/phantoms.csv`, shares of hits over the distance of the
//! nearest point. Both grow cell by cell; a run resumes where the last one stopped. [`draw`] makes charts from them.

mod cell;
mod clouds;
mod doors;
pub mod draw;
mod images;
pub(crate) mod lines;
mod method;
mod octomap;
mod ours;
mod paths;
mod plan;
mod recast;
mod record;
mod solid;
pub(crate) mod subject;
pub mod walkable;
pub(crate) mod workload;

use crate::stability::Result;
use doors::Doors;
use method::Method;
use nalgebra::Point3;
use ours::Ours;
use plan::Plan;
use rapier3d::prelude::SharedShape;
use record::{Cell, Figure, Record};
use std::time::{Duration, Instant};
use subject::Subject;
use workload::{Grazing, Workload};

pub use plan::Options;

/// Memory limit of a method (bytes).
const MEMORY_BYTES: f64 = 4e9;

/// The scene in whose name doors and paths are measured: they have scenes of their own, one is enough.
const WALKED: &str = "house";
/// The controller that walks in cubes, and the pixel sizes at which it does (cm).
const CONTROLLER: &str = "rapier3d";
const CONTROLLED_CM: [u32; 3] = [4, 8, 16];

/// All methods for a scene that answer about boxes.
fn methods(subject: &Subject) -> Vec<Box<dyn Method>> {
    if subject.is_mesh() {
        // A triangle has its own slope: classifiers play no part.
        let ours = Ours::ALL.into_iter().filter(|ours| ours.classifier == Ours::PLANE.classifier);
        let ours = ours.map(|ours| Box::new(ours) as Box<dyn Method>);
        return ours.chain([Box::new(solid::Triangles) as Box<dyn Method>]).collect();
    }
    let mut all: Vec<Box<dyn Method>> = Vec::new();
    for ours in Ours::ALL {
        all.push(Box::new(ours));
    }
    all.push(Box::new(images::Thesis));
    all.push(Box::new(solid::Voxels));
    all.push(Box::new(solid::Faces));
    all.push(Box::new(clouds::Kiddo { exact: false }));
    all.push(Box::new(clouds::Kiddo { exact: true }));
    all.push(Box::new(clouds::Capt));
    all.push(Box::new(octomap::Octomap));
    all
}

/// Measures, appends to the tables in `chart/` of the folder, and draws them.
pub fn run(options: &Options) -> Result<()> {
    let plan = Plan::new(options)?;
    let out = options.folder();
    let charts = out.join("chart");
    measure_all(&plan, &mut Record::open(&charts, options.fresh)?)?;
    std::fs::write(charts.join(draw::MACHINE_FILE), draw::machine() + "\n")?;
    draw::run(&out)
}

fn measure_all(plan: &Plan, record: &mut Record) -> Result<()> {
    for name in &plan.scenes {
        let start = Instant::now();
        match Subject::named(name, plan.points)? {
            Some(subject) => measure_scene(&subject, plan, record)?,
            None => eprintln!("{name}: skipped, its file is missing"),
        }
        eprintln!("{name}: {:.0} s", start.elapsed().as_secs_f64());
    }
    Ok(())
}

/// How a method did at the last pixel size.
struct Before {
    cubes: usize,
    build_s: f64,
    resident_bytes: f64,
}

fn measure_scene(subject: &Subject, plan: &Plan, record: &mut Record) -> Result<()> {
    let methods = methods(subject);
    let walked = (subject.name == WALKED).then_some(CONTROLLER);
    let names = || methods.iter().map(|method| method.name()).chain([recast::NAME]).chain(walked);
    let open = |record: &Record, pixel: u32| names().any(|name| !record.has(&subject.name, name, pixel));
    let pixels: Vec<u32> = plan.pixels_cm.iter().copied().filter(|&pixel| open(record, pixel)).collect();
    if pixels.is_empty() {
        return Ok(());
    }
    let work = Workload::new(subject, plan.effort.questions)?;
    let area = Figure::one("area_m2", subject.area(), 1);
    let mut ground = recast::Ground::new(subject);
    let mut before: Vec<Option<Before>> = methods.iter().map(|_| None).collect();
    let mut same: Vec<Option<Cell>> = methods.iter().map(|_| None).collect();
    for pixel_cm in pixels {
        let pixel_m = f64::from(pixel_cm) / 100.0;
        let cubes = subject.cubes(pixel_m);
        let grazing = Grazing::new(subject, &work, pixel_m, plan.effort.grazing)?;
        let doors = if subject.name == WALKED { Some(Doors::new(pixel_m)?) } else { None };
        for ((method, before), same) in methods.iter().zip(&mut before).zip(&mut same) {
            if record.has(&subject.name, method.name(), pixel_cm) {
                continue;
            }
            if let Some(known) = same {
                // Methods without pixels give equal answers at each size, but doors and boxes near solid depend on it.
                let mut cell = Cell { pixel_cm, phantoms: Vec::new(), ..known.clone() };
                if let Some(doors) = &doors {
                    cell.figures.retain(|figure| figure.metric != "door_cm");
                    cell.figures.extend(doors.of_boxes(&**method)?);
                }
                record.add(&cell)?;
                continue;
            }
            let mut cell = Cell {
                scene: subject.name.clone(),
                method: method.name().into(),
                settings: method.settings(),
                pixel_cm,
                figures: Vec::new(),
                phantoms: Vec::new(),
            };
            if let Some(why) = too_much(&**method, subject, pixel_m, cubes, before.as_ref(), plan) {
                eprintln!("{} {pixel_cm} cm {}: skipped, {why}", subject.name, method.name());
                cell.settings = why;
                record.add(&cell)?;
                continue;
            }
            let start = Instant::now();
            let seen = cell::measure(&**method, subject, pixel_m, &work, &grazing, &plan.effort)
                .map_err(|e| format!("{}, {pixel_cm} cm, {}: {e}", subject.name, method.name()))?;
            *before = Some(Before { cubes, build_s: seen.build_s, resident_bytes: seen.resident_bytes });
            cell.figures = seen.figures;
            cell.figures.push(area.clone());
            if let Some(doors) = &doors {
                cell.figures.extend(doors.of_boxes(&**method)?);
                if method.name() == Ours::PLANE.name {
                    cell.figures.extend(paths::ours(pixel_m)?);
                }
            }
            cell.phantoms = seen.phantoms;
            eprintln!("{} {pixel_cm} cm {}: {}", subject.name, method.name(), line(&cell, start.elapsed()));
            record.add(&cell)?;
            if !method.has_pixels() {
                *same = Some(cell);
            }
        }
        if !record.has(&subject.name, recast::NAME, pixel_cm) {
            let start = Instant::now();
            record.add(&ground.cell(subject, pixel_cm, cubes, &work.columns, plan.budget_s)?)?;
            eprintln!("{} {pixel_cm} cm {}: {:.1} s in all", subject.name, recast::NAME, start.elapsed().as_secs_f64());
        }
        if let Some(doors) = doors.filter(|_| !record.has(WALKED, CONTROLLER, pixel_cm)) {
            let start = Instant::now();
            record.add(&controlled(&doors, pixel_cm)?)?;
            eprintln!("{WALKED} {pixel_cm} cm {CONTROLLER}: {:.1} s in all", start.elapsed().as_secs_f64());
        }
    }
    Ok(())
}

/// The controller's cell: its door and its paths.
fn controlled(doors: &Doors, pixel_cm: u32) -> Result<Cell> {
    let mut cell = Cell {
        scene: WALKED.into(),
        method: CONTROLLER.into(),
        settings: "KinematicCharacterController on Voxels of t; up z, offset and slopes by default; autostep 0.35 m on the better of treads of 0.05 and 0.2 m; snap to ground 0.35 m".into(),
        pixel_cm,
        figures: Vec::new(),
        phantoms: Vec::new(),
    };
    if CONTROLLED_CM.contains(&pixel_cm) {
        let pixel_m = f64::from(pixel_cm) / 100.0;
        let points: Vec<Point3<f64>> = doors.subject.local().collect();
        cell.figures.extend(doors.of_capsules(SharedShape::new(solid::cubes(&points, pixel_m))));
        cell.figures.extend(paths::rapier(pixel_m)?);
    } else {
        cell.settings = format!("walks only at {CONTROLLED_CM:?} cm: a frame takes it milliseconds");
    }
    Ok(cell)
}

/// Why a cell is not measured, if it is not: it would take too much time or memory, or cannot be built at all.
fn too_much(
    method: &dyn Method,
    subject: &Subject,
    pixel_m: f64,
    cubes: usize,
    before: Option<&Before>,
    plan: &Plan,
) -> Option<String> {
    if let Some(why) = method.refuses(subject, pixel_m) {
        return Some(why);
    }
    let bytes = method.estimate_bytes(subject, pixel_m, cubes);
    let guess = |bytes: f64| format!("would take about {:.1} GB; {} GB is the limit", bytes / 1e9, MEMORY_BYTES / 1e9);
    if bytes > MEMORY_BYTES {
        return Some(guess(bytes));
    }
    let before = before?;
    let grows = (cubes as f64 / before.cubes.max(1) as f64).powi(method.growth());
    let (seconds, bytes) = (before.build_s * grows, before.resident_bytes * grows);
    if bytes > MEMORY_BYTES {
        return Some(guess(bytes));
    }
    let late = format!("would take about {seconds:.0} s to build; {} s is the limit", plan.budget_s);
    (seconds > plan.budget_s).then_some(late)
}

/// A cell in a line.
fn line(cell: &Cell, took: Duration) -> String {
    let of = |metric: &str| cell.figures.iter().find(|figure| figure.metric == metric).map_or(f64::NAN, |f| f.value);
    format!(
        "built in {:.2} s, {:.1} MB, random {:.0} ns, walk {:.0} ns, missed {:.4}, phantom {:.4}, out {:.2} cm, in {:.2} cm; {:.1} s in all",
        of("build_s"),
        of("resident_bytes") / 1e6,
        of("random_mean_ns"),
        of("walk_mean_ns"),
        of("missed"),
        of("phantom"),
        of("out_p99_cm"),
        of("in_p99_cm"),
        took.as_secs_f64(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tiny_run_writes_every_figure_and_misses_nothing() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let options = Options { quick: true, out: None, only: Some("house".into()), budget: 60.0, fresh: true };
        let plan = Plan { pixels_cm: vec![32], points: Some(5000), ..Plan::new(&options)? };
        measure_all(&plan, &mut Record::open(folder.path(), true)?)?;
        let text = std::fs::read_to_string(folder.path().join("measured.csv"))?;
        let of = |method: &str, metric: &str| {
            let line =
                |line: &&str| line.starts_with(&format!("house,{method},")) && line.contains(&format!(",32,{metric},"));
            let found = text.lines().find(line).ok_or_else(|| format!("no {metric} of {method} in\n{text}"))?;
            let rest = found.split_once(&format!(",{metric},")).ok_or("no value")?.1;
            Ok::<f64, crate::stability::Error>(rest.split(',').next().ok_or("no value")?.parse()?)
        };
        let common = [
            "random_mean_ns",
            "random_p50_ns",
            "random_p99_ns",
            "walk_mean_ns",
            "walk_p50_ns",
            "walk_p99_ns",
            "build_s",
            "resident_bytes",
            "area_m2",
            "missed",
            "phantom",
            "out_max_cm",
            "out_p99_cm",
            "out_mean_cm",
            "in_max_cm",
            "in_p99_cm",
            "in_mean_cm",
            "floor_rmse_cm",
            "door_cm",
            "toi_cm",
            "toi_late_cm",
        ];
        for method in ["slicewalk plane", "parry3d Voxels"] {
            for metric in common {
                assert!(of(method, metric)? >= 0.0, "{method}: {metric}");
            }
        }
        for metric in ["file_bytes", "slope_wrong", "path_cm", "stand_rmse_cm", "stand_missing", "stand_wrong"] {
            assert!(of("slicewalk plane", metric)? >= 0.0, "{metric}");
        }
        // One may not be installed, the other may find 32 cm too coarse; both must be reported.
        assert!(text.contains("house,octomap,") && text.contains("house,recast,"));
        for ours in Ours::ALL {
            assert_eq!((of(ours.name, "missed")?, of(ours.name, "in_max_cm")?), (0.0, 0.0), "{}", ours.name);
        }
        assert!(of("kiddo spheres", "missed")? > 0.0, "inscribed spheres leave corners out");
        let phantoms = std::fs::read_to_string(folder.path().join("phantoms.csv"))?;
        assert!(phantoms.lines().any(|line| line.starts_with("house,slicewalk plane,32,") && line.contains(",1,")));
        Ok(())
    }
}
