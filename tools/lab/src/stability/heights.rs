//! Heights: room under tables, steps, ramps.

use super::lab::{Judged, Method, Scan, Setting, Vec3, Voxel};
use super::patch::Field;
use super::planes::{NOISE_M, PIXEL_M, phase};
use super::plot::{Line, Plot};
use super::table::{Errors, Share, Table, crossing, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Answer, ceiling_above};
use std::collections::BTreeMap;

/// Tables of 3 cm with their undersides at 0.6 to 2 m: error of the ceiling found from below.
pub fn headroom(effort: Effort) -> Result<Outcome> {
    const THICK: f64 = 0.03;
    const EDGE: f64 = 12.0 * PIXEL_M;
    let heights: Vec<f64> = (0..=140).step_by(effort.of(1, 10)).map(|n| 0.6 + f64::from(n) * 0.01).collect();
    let mut csv = Table::new(["underside_m", "noise_mm", "thesis_as_written_error_mm", "ours_error_mm"]);
    let mut page = Table::new([
        "noise (mm)",
        "thesis as written: least to greatest error (mm)",
        "RMSE",
        "Slicewalk: least to greatest error (mm)",
        "RMSE",
    ]);
    let mut lines = Vec::new();
    for noise_mm in [0.0, 2.0, 5.0] {
        let mut random = Random(5 + noise_mm as u64);
        let mut points: Vec<Vec3> = Vec::new();
        for (n, &height) in heights.iter().enumerate() {
            for (z, share) in [(0.0, 1.0), (height, 1.0), (height + THICK, 1.0)] {
                for _ in 0..(144.0 * 10.0 * share) as usize {
                    let [x, y] = [n as f64 * 1.5 * EDGE, 0.0].map(|v| v + random.between(0.0, EDGE));
                    points.push([x, y, z + random.normal(noise_mm / 1000.0)]);
                }
            }
        }
        let scan = Scan::new(points)?;
        let written = scan.judge(Setting::new(PIXEL_M), Method::Written)?;
        let ours = scan.convert(Setting::new(PIXEL_M), slicewalk::plan::Classifier::Plane)?;
        let mut errors = [Errors::default(), Errors::default()];
        let mut pair = [Vec::new(), Vec::new()];
        for (n, &height) in heights.iter().enumerate() {
            let middle = [n as f64 * 1.5 * EDGE + EDGE / 2.0, EDGE / 2.0];
            let feet = Point3::new(middle[0], middle[1], 0.1);
            let body = Aabb::standing(feet, Vector3::new(0.3, 0.3, 0.4))?;
            let Answer::Known(Some(found)) = ceiling_above(&ours.store, &body, 0.1, 5.0) else {
                return Err("no ceiling over a body under a table".into());
            };
            let Judged::Written(slices) = &written else { unreachable!("asked for") };
            let red = slices.ceiling(body.min().into(), body.max().into(), 0.1).ok_or("no pixel above")?;
            let own = [red, found].map(|z| (z - height) * 1000.0);
            csv.row([number(height, 2), number(noise_mm, 0), number(own[0], 2), number(own[1], 2)]);
            for k in 0..2 {
                errors[k].0.push(own[k]);
                pair[k].push((height, own[k]));
            }
        }
        if noise_mm == 2.0 {
            lines = [Method::Written, Method::Plane].into_iter().zip(pair).map(|(m, l)| Line::of(m, l)).collect();
        }
        let range = |errors: &Errors| {
            let ends = errors.0.iter().fold([f64::MAX, f64::MIN], |[a, b], &v| [a.min(v), b.max(v)]);
            format!("{} to {}", number(ends[0], 1), number(ends[1], 1))
        };
        let [a, b] = &errors;
        page.row([number(noise_mm, 0), range(a), number(a.rmse(), 1), range(b), number(b.rmse(), 1)]);
    }
    let mut outcome = Outcome { tables: vec![("headroom", csv)], ..Outcome::default() };
    outcome.fact("headroom", page.markdown());
    outcome.plots.push(Plot {
        name: "headroom",
        title: "Error of the room under a table of 3 cm: 2 mm noise, slices of 15 cm".into(),
        x: "height of the underside (m)",
        y: "error: above 0 the head goes into the table (mm)",
        log_x: false,
        y_range: (-20.0, 40.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}

/// One step of 1 to 40 cm between two floors, at several headings and phases.
pub fn risers(effort: Effort) -> Result<Outcome> {
    let risers: &[f64] = effort.of(
        &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 25.0, 30.0, 40.0],
        &[2.0, 8.0, 20.0],
    );
    let headings = [0.0f64, 20.0, 45.0, 70.0];
    let copies = effort.of(8, 2);
    let mut random = Random(19);
    let (mut points, mut steps) = (Vec::<Vec3>::new(), Vec::new());
    let pitch = 48.0 * PIXEL_M;
    for (row, &riser) in risers.iter().enumerate() {
        for column in 0..headings.len() * copies {
            let [px, py, pz] = phase(&mut random);
            let at = |index: usize, phase: f64| (index as f64 + 0.5) * pitch + phase * PIXEL_M;
            let middle = [at(column, px), at(row, py), 2.0 + pz * 3.0 * PIXEL_M];
            let (s, c) = headings[column / copies].to_radians().sin_cos();
            let (half, rise) = (14.0 * PIXEL_M, riser / 100.0);
            let mut add = |along: f64, across: f64, z: f64, noise: [f64; 2]| {
                let along = along + noise[0];
                let [x, y] = [middle[0] + along * c - across * s, middle[1] + along * s + across * c];
                points.push([x, y, middle[2] + z + noise[1]]);
            };
            for _ in 0..(28 * 28 * 10) {
                let (along, across) = (random.between(-half, half), random.between(-half, half));
                add(along, across, if along > 0.0 { rise } else { 0.0 }, [0.0, random.normal(NOISE_M)]);
            }
            for _ in 0..(28.0 * rise / PIXEL_M * 10.0) as usize {
                let (across, z) = (random.between(-half, half), random.between(0.0, rise));
                add(0.0, across, z, [random.normal(NOISE_M), 0.0]);
            }
            steps.push((riser, middle, s, c));
        }
    }
    let scan = Scan::new(points)?;
    let mut csv = Table::new([
        "riser_cm",
        "method",
        "edge_pixels_with_obstacle",
        "other_pixels_with_obstacle",
        "step_error_rmse_mm",
        "step_error_max_mm",
        "step_not_seen",
    ]);
    let mut lines = Vec::new();
    let mut page = Table::new([
        "method",
        "riser at which 10 % / 50 % / 90 % of the edge's pixels are obstacle (cm)",
        "worst share of other pixels called obstacle",
        "worst RMSE of the step seen (mm)",
    ]);
    for method in Method::ALL {
        let judged = scan.judge(Setting::new(PIXEL_M), method)?;
        let mut pixels: BTreeMap<[i64; 2], bool> = BTreeMap::new();
        judged.voxels(|Voxel { pixel, obstacle, .. }| *pixels.entry(pixel).or_default() |= obstacle)?;
        let (mut line, mut worst) = (Vec::new(), [0.0f64; 2]);
        for (row, &riser) in risers.iter().enumerate() {
            let per_row = headings.len() * copies;
            let (mut edge, mut other, mut unseen) = (Share::default(), Share::default(), Share::default());
            let mut errors = Errors::default();
            for &(_, middle, s, c) in &steps[row * per_row..(row + 1) * per_row] {
                let first = [0, 1].map(|a| (middle[a] / PIXEL_M).floor() as i64);
                for di in -14..=14 {
                    for dj in -14..=14 {
                        let pixel = [first[0] + di, first[1] + dj];
                        let [dx, dy] = [0, 1].map(|a| (pixel[a] as f64 + 0.5) * PIXEL_M - middle[a]);
                        let (along, across) = ((dx * c + dy * s) / PIXEL_M, (dy * c - dx * s) / PIXEL_M);
                        // How far a pixel's corners reach along the step's heading.
                        let reach = (s.abs() + c.abs()) / 2.0;
                        if along.abs() > 11.0 || across.abs() > 11.0 {
                            continue;
                        }
                        let obstacle = pixels.get(&pixel).copied().unwrap_or(false);
                        if along.abs() < reach - 0.1 {
                            edge.add(obstacle);
                        } else if along.abs() > reach + 0.1 {
                            other.add(obstacle);
                        }
                    }
                }
                for across in -8..=8 {
                    let across = f64::from(across) * PIXEL_M;
                    let [low, high] = [-4.0, 4.0].map(|along| {
                        let along = along * PIXEL_M;
                        let (x, y) = (middle[0] + along * c - across * s, middle[1] + along * s + across * c);
                        judged.floor(x, y, middle[2] + riser / 100.0 + 0.3, 1.0)
                    });
                    unseen.add(low.is_none() || high.is_none());
                    errors.0.extend(low.zip(high).map(|(low, high)| (high - low) * 1000.0 - riser * 10.0));
                }
            }
            line.push((riser, edge.value()));
            worst = [worst[0].max(other.value()), worst[1].max(errors.rmse())];
            let cells = [number(edge.value(), 4), number(other.value(), 5), number(errors.rmse(), 2)];
            let more = [number(errors.quantile(1.0), 2), number(unseen.value(), 4)];
            csv.row([number(riser, 0), method.name().into()].into_iter().chain(cells).chain(more));
        }
        let cross = [0.1, 0.5, 0.9].map(|level| crossing(&line, level).map_or("never".into(), |v| number(v, 1)));
        page.row([method.name().to_owned(), cross.join(" / "), percent(worst[0]), number(worst[1], 1)]);
        lines.push(Line::of(method, line));
    }
    let mut outcome = Outcome { tables: vec![("risers", csv)], ..Outcome::default() };
    outcome.fact("risers", page.markdown());
    outcome.plots.push(Plot {
        name: "risers",
        title: "Pixels of a step's edge called obstacle: limit 45°, 5 cm pixels, 10 points each".into(),
        x: "height of the riser (cm)",
        y: "share of the edge's pixels",
        log_x: false,
        y_range: (0.0, 1.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}

/// Height of the floor on ramps of 0 to 60 degrees.
pub fn ramps(effort: Effort) -> Result<Outcome> {
    let slopes: Vec<f64> = (0..=60).step_by(effort.of(5, 20)).map(f64::from).collect();
    let copies = effort.of(12, 3);
    let mut random = Random(23);
    let mut field = Field::new(slopes.len() * copies);
    for &slope in &slopes {
        for copy in 0..copies {
            field.add(PIXEL_M, slope, copy as f64 * 90.0 / copies as f64, 28.0, phase(&mut random));
        }
    }
    let scan = Scan::new(field.points(10.0, NOISE_M, &mut random))?;
    let mut csv = Table::new(["slope_deg", "method", "bias_mm", "rmse_mm", "p95_mm", "max_mm", "without_floor"]);
    let mut page = Table::new([
        "slope",
        "thesis as written: bias / RMSE (mm)",
        "without floor",
        "plane: bias / RMSE (mm)",
        "without floor",
    ]);
    let mut lines = Vec::new();
    let mut cells: BTreeMap<usize, Vec<String>> = BTreeMap::new();
    for method in Method::ALL {
        let judged = scan.judge(Setting::new(PIXEL_M), method)?;
        let mut line = Vec::new();
        for (n, &slope) in slopes.iter().enumerate() {
            let (mut errors, mut missing) = (Errors::default(), Share::default());
            for patch in &field.patches[n * copies..(n + 1) * copies] {
                for _ in 0..150 {
                    let [x, y] = [0, 1].map(|a| patch.middle[a] + random.between(-7.0, 7.0) * PIXEL_M);
                    let truth = patch.height(x, y);
                    let found = judged.floor(x, y, truth + 0.3, 0.6);
                    missing.add(found.is_none());
                    errors.0.extend(found.map(|z| (z - truth) * 1000.0));
                }
            }
            let all = [errors.mean(), errors.rmse(), errors.quantile(0.95), errors.quantile(1.0)];
            let values = all.map(|v| number(v, 2)).into_iter().chain([number(missing.value(), 4)]);
            csv.row([number(slope, 0), method.name().into()].into_iter().chain(values));
            if missing.value() < 0.5 {
                line.push((slope, errors.rmse()));
            }
            if [0.0, 15.0, 30.0, 40.0, 45.0, 50.0].contains(&slope) && matches!(method, Method::Written | Method::Plane)
            {
                let pair = match errors.0.is_empty() {
                    true => "–".to_owned(),
                    false => format!("{} / {}", number(all[0], 1), number(all[1], 1)),
                };
                cells.entry(n).or_default().extend([pair, percent(missing.value())]);
            }
        }
        lines.push(Line::of(method, line));
    }
    for (n, cells) in cells {
        page.row([format!("{:.0}°", slopes[n])].into_iter().chain(cells));
    }
    let mut outcome = Outcome { tables: vec![("ramps", csv)], ..Outcome::default() };
    outcome.fact("ramps", page.markdown());
    outcome.plots.push(Plot {
        name: "ramps",
        title: "Height of the floor on a ramp, asked at one place: 5 cm pixels (where most have floor)".into(),
        x: "slope of the ramp (degrees)",
        y: "root mean square error (mm)",
        log_x: false,
        y_range: (0.0, 40.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}
