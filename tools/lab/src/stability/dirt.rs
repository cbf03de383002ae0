//! Points that should not be there, and points that should: outliers and holes.

use super::lab::{Method, Scan, Setting, Vec3};
use super::planes::{NOISE_M, PIXEL_M};
use super::plot::{Line, Plot};
use super::table::{Share, Table, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;
use nalgebra::{Point3, Vector3};
use scangen::{Kind, Params, SampleSpec, Scene, Truth};
use slicewalk::query::{Aabb, Answer, Cylinder, floor_under};
use std::collections::HashMap;

/// Free space around a pawn that no guarantee lets solid fill (m): a pixel's diagonal and a slice, with a margin.
const FREE_M: f64 = 0.25;

/// A house with 1e-5 to 1e-2 outliers per point, and `--min-points` 1, 2 and 3.
pub fn outliers(effort: Effort) -> Result<Outcome> {
    let scene = Scene::named("house", &Params::new().with("storeys", 1.0))?;
    let rates: &[f64] = effort.of(&[0.0, 1e-5, 1e-4, 1e-3, 1e-2], &[0.0, 1e-3]);
    let density = effort.of(4.0 / (PIXEL_M * PIXEL_M), 100.0);
    let boxes = free_boxes(&scene, effort.of(3000, 300));
    let mut csv =
        Table::new(["outliers_per_point", "method", "min_points", "free_pawns_blocked", "surface_points_lost"]);
    let mut page = Table::new([
        "outliers per point",
        "thesis as written: free pawns blocked",
        "Slicewalk, --min-points 1",
        "2",
        "3",
        "surface points lost with 2",
        "with 3",
    ]);
    let mut lines = [const { Vec::new() }; 4];
    for &rate in rates {
        let spec = SampleSpec {
            outlier_rate: rate,
            outlier_distance_m: 3.0,
            ..SampleSpec::direct_density(density).with_noise(NOISE_M)
        };
        let samples: Vec<_> = scene.samples(11, &spec)?.collect();
        let scan = Scan::new(samples.iter().map(|sample| sample.position).collect())?;
        let mut cells = vec![format!("{rate}")];
        let mut lost_cells = Vec::new();
        for min_points in 0..=3u32 {
            // 0 stands for the rule as written, which knows no such filter.
            let method = if min_points == 0 { Method::Written } else { Method::Plane };
            let setting = Setting { min_points: min_points.max(1), ..Setting::new(PIXEL_M) };
            let judged = scan.judge(setting, method)?;
            let mut blocked = Share::default();
            boxes.iter().for_each(|(min, max)| blocked.add(judged.touches(*min, *max).0));
            let mut voxels: HashMap<[i64; 3], (u32, u64)> = HashMap::new();
            for (sample, p) in samples.iter().zip(&scan.points) {
                let key = [p[0] / PIXEL_M, p[1] / PIXEL_M, p[2] / setting.slice_m()].map(|v| v.floor() as i64);
                let voxel = voxels.entry(key).or_default();
                voxel.0 += 1;
                voxel.1 += u64::from(sample.kind == Kind::Surface);
            }
            let dropped = voxels.values().filter(|voxel| voxel.0 < setting.min_points).map(|voxel| voxel.1);
            let lost = dropped.sum::<u64>() as f64 / samples.len() as f64;
            let name = method.name();
            csv.row([
                format!("{rate}"),
                name.into(),
                min_points.max(1).to_string(),
                number(blocked.value(), 4),
                number(lost, 5),
            ]);
            cells.push(percent(blocked.value()));
            lines[min_points as usize].push((rate.max(1e-6), blocked.value()));
            if min_points > 1 {
                lost_cells.push(percent(lost));
            }
        }
        page.row(cells.into_iter().chain(lost_cells));
    }
    let mut outcome = Outcome { tables: vec![("outliers", csv)], ..Outcome::default() };
    outcome.fact("outliers", page.markdown());
    outcome.plots.push(Plot {
        name: "outliers",
        title: "Pawns in free space that an outlier blocks: house, 4 points per pixel of 5 cm".into(),
        x: "outliers per point (leftmost: 0)",
        y: "share of pawns blocked",
        log_x: true,
        y_range: (0.0, 1.0),
        marks: vec![],
        lines: lines
            .into_iter()
            .enumerate()
            .map(|(n, points)| match n {
                0 => Line::of(Method::Written, points),
                _ => Line::new(format!("plane, --min-points {n}"), [3, 5, 4][n - 1], points),
            })
            .collect(),
    });
    Ok(outcome)
}

/// Boxes of a pawn with nothing within [`FREE_M`].
fn free_boxes(scene: &Scene, count: usize) -> Vec<(Vec3, Vec3)> {
    let mut random = Random(3);
    let bounds = scene.bounds();
    let mut boxes = Vec::new();
    while boxes.len() < count {
        let low = [0, 1, 2].map(|a| random.between(bounds.min[a], bounds.max[a]));
        let high = [low[0] + 0.5, low[1] + 0.5, low[2] + 1.8];
        let inside = (0..3).all(|a| high[a] < bounds.max[a]);
        if inside && scene.distance_to_box(low, high) > FREE_M {
            boxes.push((low, high));
        }
    }
    boxes
}

/// Discs without points in a floor: where a body in the hole finds no floor.
pub fn holes(effort: Effort) -> Result<Outcome> {
    let radii: Vec<i64> = (1..=20).step_by(effort.of(1, 5)).collect();
    let pitch = 64;
    let mut random = Random(21);
    let mut points = Vec::new();
    let middle = |n: usize| [(n as i64 * pitch + pitch / 2) as f64 * PIXEL_M, 32.0 * PIXEL_M];
    for (n, &radius) in radii.iter().enumerate() {
        let [cx, cy] = middle(n);
        for _ in 0..(pitch * pitch * 10) {
            let half = pitch as f64 * PIXEL_M / 2.0;
            let (dx, dy) = (random.between(-half, half), random.between(-half, half));
            let z = 0.07 + random.normal(NOISE_M);
            if dx.hypot(dy) > radius as f64 * PIXEL_M {
                points.push([cx + dx, cy + dy, z]);
            }
        }
    }
    let scan = Scan::new(points)?;
    let written = scan.judge(Setting::new(PIXEL_M), Method::Written)?;
    let ours = scan.convert(Setting::new(PIXEL_M), slicewalk::plan::Classifier::Plane)?;
    let mut csv = Table::new(["radius_pixels", "written_pixel", "ours_pixel", "ours_cylinder_25cm", "ours_box_50cm"]);
    let mut lines = [Vec::new(), Vec::new(), Vec::new()];
    let mut first_fall = [None; 3];
    for (n, &radius) in radii.iter().enumerate() {
        let [cx, cy] = middle(n);
        let mut shares = [Share::default(); 4];
        for _ in 0..effort.of(2000, 200) {
            // Evenly over the disc.
            let (turn, way) = (random.between(0.0, std::f64::consts::TAU), random.between(0.0, 1.0).sqrt());
            let r = way * radius as f64 * PIXEL_M;
            let (x, y) = (cx + r * turn.cos(), cy + r * turn.sin());
            let feet = Point3::new(x, y, 0.3);
            let missing = |answer| matches!(answer, Answer::Known(None));
            let point = Aabb::new(feet, feet)?;
            let cylinder = Cylinder::new(feet, 0.25, 1.8)?;
            let body = Aabb::standing(feet, Vector3::new(0.5, 0.5, 1.8))?;
            shares[0].add(written.floor(x, y, 0.3, 1.0).is_none());
            shares[1].add(missing(floor_under(&ours.store, &point, 0.3, 1.0)));
            shares[2].add(missing(floor_under(&ours.store, &cylinder, 0.3, 1.0)));
            shares[3].add(missing(floor_under(&ours.store, &body, 0.3, 1.0)));
        }
        let values = shares.map(|share| share.value());
        csv.row([radius.to_string()].into_iter().chain(values.map(|v| number(v, 4))));
        for (line, (first, value)) in lines.iter_mut().zip(first_fall.iter_mut().zip(&values[1..])) {
            line.push((radius as f64, *value));
            if *value > 0.0 && first.is_none() {
                *first = Some(radius);
            }
        }
    }
    let mut outcome = Outcome { tables: vec![("holes", csv)], ..Outcome::default() };
    let text = |radius: Option<i64>| radius.map_or("none up to 20".to_owned(), |r| r.to_string());
    outcome.fact("holes-pixel", text(first_fall[0]));
    outcome.fact("holes-cylinder", text(first_fall[1]));
    outcome.fact("holes-box", text(first_fall[2]));
    let names = ["one pixel", "cylinder of 25 cm radius", "box of 50 cm"];
    outcome.plots.push(Plot {
        name: "holes",
        title: "Bodies standing in a hole of the scan that find no floor: 5 cm pixels".into(),
        x: "radius of the hole (pixels)",
        y: "share without floor",
        log_x: false,
        y_range: (0.0, 1.0),
        marks: vec![],
        lines: names
            .into_iter()
            .zip(lines)
            .enumerate()
            .map(|(n, (name, line))| Line::new(name, [3, 4, 5][n], line))
            .collect(),
    });
    Ok(outcome)
}
