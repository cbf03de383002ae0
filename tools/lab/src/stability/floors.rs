//! Flat floors: noise, and where the slice boundary lies.

use super::lab::{Judged, Method, Scan, Setting, Vec3};
use super::patch::Field;
use super::planes::{NOISE_M, PIXEL_M, phase, shares};
use super::plot::{Line, Plot};
use super::table::{Errors, Share, Table, number, percent};
use super::{Effort, Outcome, Result};
use crate::Random;
use std::collections::HashMap;

/// Pixels along the edge of a square of floor that is looked at.
const EDGE: i64 = 30;

/// Floor and wall under noise of 0 to 20 mm.
pub fn noise(effort: Effort) -> Result<Outcome> {
    let noises: &[f64] = effort.of(&[0.0, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0], &[0.0, 5.0, 20.0]);
    let copies = effort.of(16, 4);
    // Slope, and whether it is an obstacle.
    let kinds = [(0.0, false), (35.0, false), (55.0, true), (90.0, true)];
    let head = [
        "noise_mm",
        "method",
        "floor_wrong",
        "slope35_wrong",
        "slope55_wrong",
        "wall_wrong",
        "floor_rmse_mm",
        "floor_bias_mm",
        "floor_p95_mm",
        "floor_max_mm",
        "floor_missing",
    ];
    let mut csv = Table::new(head);
    let mut wrong_lines = vec![Vec::new(); Method::ALL.len()];
    let mut rmse_lines = vec![Vec::new(); Method::ALL.len()];
    let mut page = Table::new([
        "noise (mm)",
        "method",
        "flat floor called obstacle",
        "35° called obstacle",
        "55° called floor",
        "wall called floor",
        "floor error: bias / RMSE / max (mm)",
    ]);
    for &noise_mm in noises {
        let mut random = Random(1000 + noise_mm as u64);
        let mut field = Field::new(kinds.len() * copies);
        for (slope, _) in kinds {
            for copy in 0..copies {
                let heading = copy as f64 * 360.0 / copies as f64;
                field.add(PIXEL_M, slope, if slope == 0.0 { 0.0 } else { heading }, 30.0, phase(&mut random));
            }
        }
        let scan = Scan::new(field.points(10.0, noise_mm / 1000.0, &mut random))?;
        for method in Method::ALL {
            let judged = scan.judge(Setting::new(PIXEL_M), method)?;
            let shares = shares(&field, &judged)?;
            let wrong: Vec<f64> = kinds
                .iter()
                .enumerate()
                .map(|(n, (_, obstacle))| {
                    let mut sum = Share::default();
                    shares[n * copies..(n + 1) * copies].iter().for_each(|&share| sum.merge(share));
                    if *obstacle { 1.0 - sum.value() } else { sum.value() }
                })
                .collect();
            let (mut errors, mut missing) = (Errors::default(), Share::default());
            for patch in &field.patches[..copies] {
                for i in -EDGE / 2 + 3..EDGE / 2 - 3 {
                    for j in -EDGE / 2 + 3..EDGE / 2 - 3 {
                        let [x, y] = [0, 1].map(|a| patch.middle[a] + ([i, j][a] as f64 + 0.5) * PIXEL_M);
                        let found = judged.floor(x, y, patch.middle[2] + 0.3, 0.6);
                        missing.add(found.is_none());
                        errors.0.extend(found.map(|z| (z - patch.middle[2]) * 1000.0));
                    }
                }
            }
            let cells = wrong.iter().map(|share| number(*share, 5));
            let heights = [errors.rmse(), errors.mean(), errors.quantile(0.95), errors.quantile(1.0)];
            csv.row(
                [number(noise_mm, 0), method.name().into()]
                    .into_iter()
                    .chain(cells)
                    .chain(heights.map(|v| number(v, 3)))
                    .chain([number(missing.value(), 5)]),
            );
            wrong_lines[method as usize].push((noise_mm, wrong.iter().copied().fold(0.0, f64::max)));
            rmse_lines[method as usize].push((noise_mm, errors.rmse()));
            if [0.0, 2.0, 5.0, 10.0, 20.0].contains(&noise_mm) && method != Method::OrderFree {
                let mut cells = vec![number(noise_mm, 0), method.name().into()];
                cells.extend(wrong.iter().map(|share| percent(*share)));
                cells.push([errors.mean(), errors.rmse(), errors.quantile(1.0)].map(|v| number(v, 1)).join(" / "));
                page.row(cells);
            }
        }
    }
    let lines = |of: &[Vec<(f64, f64)>]| Method::ALL.map(|m| Line::of(m, of[m as usize].clone())).to_vec();
    let mut outcome = Outcome { tables: vec![("noise", csv)], ..Outcome::default() };
    outcome.fact("noise", page.markdown());
    for method in Method::ALL {
        let passed = super::table::crossing(&wrong_lines[method as usize], 0.05);
        let text = passed.map_or("beyond 20 mm".to_owned(), |v| format!("{} mm", number(v, 1)));
        outcome.fact(format!("noise-breakdown-{}", method as usize), text);
    }
    outcome.plots.push(Plot {
        name: "noise",
        title: "Worst share of wrong classes among floor, 35°, 55° and wall: limit 45°, 10 points per pixel of 5 cm"
            .into(),
        x: "noise, one standard deviation (mm)",
        y: "share of voxels misclassified",
        log_x: false,
        y_range: (0.0, 0.5),
        marks: vec![],
        lines: lines(&wrong_lines),
    });
    outcome.plots.push(Plot {
        name: "noise-floor-height",
        title: "Error of the height of a flat floor: 10 points per pixel of 5 cm".into(),
        x: "noise, one standard deviation (mm)",
        y: "root mean square error (mm)",
        log_x: false,
        y_range: (0.0, 10.0),
        marks: vec![],
        lines: lines(&rmse_lines),
    });
    Ok(outcome)
}

/// Results of a method for a level square of pixels.
struct Level {
    errors: Errors,
    /// Greatest difference of neighbouring pixels (mm).
    step: f64,
    /// Share of floor voxels called obstacle.
    wrong: f64,
    /// Share of pixels without floor.
    missing: f64,
}

fn level(judged: &Judged, field: &Field, number: usize) -> Result<Level> {
    let patch = &field.patches[number];
    let mut heights = HashMap::new();
    let (mut errors, mut missing) = (Errors::default(), Share::default());
    for i in 0..EDGE - 6 {
        for j in 0..EDGE - 6 {
            // The middle lies in the middle of a pixel.
            let from = [i, j].map(|v| (v - EDGE / 2 + 3) as f64);
            let [x, y] = [0, 1].map(|a| patch.middle[a] + from[a] * PIXEL_M);
            let found = judged.floor(x, y, patch.middle[2] + 0.3, 0.6);
            missing.add(found.is_none());
            if let Some(z) = found {
                errors.0.push((z - patch.middle[2]) * 1000.0);
                heights.insert((i, j), z);
            }
        }
    }
    let neighbours = heights.iter().flat_map(|(&(i, j), z)| {
        [(i + 1, j), (i, j + 1)].into_iter().filter_map(|next| heights.get(&next)).map(move |other| (other - z).abs())
    });
    let step = neighbours.fold(0.0, f64::max) * 1000.0;
    let wrong = shares(field, judged)?[number].value();
    Ok(Level { errors, step, wrong, missing: missing.value() })
}

/// A flat floor with 2 mm noise at 16 heights within a slice.
pub fn phase_z(effort: Effort) -> Result<Outcome> {
    let (phases, copies) = (16, effort.of(4, 1));
    let mut random = Random(31);
    let mut field = Field::new(phases * copies);
    for copy in 0..copies {
        for phase in 0..phases {
            field.add(PIXEL_M, 0.0, 0.0, EDGE as f64, [0.5, 0.5, (phase + copy * phases) as f64 / phases as f64]);
        }
    }
    let mut points = field.points(10.0, NOISE_M, &mut random);
    let sigma = Setting::new(PIXEL_M).slice_m();
    // The thesis' slices begin at the lowest point: a point on a boundary, away from all floors, aligns them with
    // Slicewalk's.
    points.push([0.0, 0.0, 20.0 * sigma]);
    let scan = Scan::new(points)?;
    let raw = highest(&scan.points);
    let head = [
        "phase_of_slice",
        "method",
        "rmse_mm",
        "bias_mm",
        "p95_mm",
        "max_mm",
        "greatest_step_mm",
        "highest_points_step_mm",
        "called_obstacle",
        "missing",
    ];
    let mut csv = Table::new(head);
    let mut page = Table::new([
        "method",
        "worst RMSE (mm)",
        "worst error (mm)",
        "worst step between neighbours (mm)",
        "of the highest points themselves (mm)",
        "worst share called obstacle",
        "worst share without floor",
    ]);
    let mut lines = Vec::new();
    let mut quantum_excess = f64::NEG_INFINITY;
    for method in Method::ALL {
        let judged = scan.judge(Setting::new(PIXEL_M), method)?;
        let mut worst = [0.0f64; 6];
        let mut line = Vec::new();
        for phase in 0..phases {
            let mut sum = [0.0f64; 7];
            for copy in 0..copies {
                let number = copy * phases + phase;
                let level = level(&judged, &field, number)?;
                let raw_step = raw_step(&raw, &field, number);
                if method == Method::Plane {
                    quantum_excess = quantum_excess.max(level.step - raw_step);
                }
                let own = [
                    level.errors.rmse(),
                    level.errors.quantile(0.95),
                    level.errors.quantile(1.0),
                    level.step,
                    raw_step,
                    level.wrong,
                    level.missing,
                ];
                sum.iter_mut().zip(own).for_each(|(sum, own)| *sum = sum.max(own));
                if copy == 0 {
                    let first = [number_of(phase, phases), method.name().into()];
                    let rest = [own[0], level.errors.mean(), own[1], own[2], own[3], own[4]].map(number3);
                    csv.row(first.into_iter().chain(rest).chain([number5(level.wrong), number5(level.missing)]));
                }
            }
            line.push((phase as f64 / phases as f64, sum[3]));
            let [rmse, _, max, step, raw, wrong, missing] = sum;
            worst.iter_mut().zip([rmse, max, step, raw, wrong, missing]).for_each(|(w, v)| *w = w.max(v));
        }
        lines.push(Line::of(method, line));
        let mut cells = vec![method.name().to_owned()];
        cells.extend(worst[..4].iter().map(|v| number(*v, 1)));
        cells.extend(worst[4..].iter().map(|v| percent(*v)));
        page.row(cells);
    }
    let own = |p: usize| (0..copies).map(|c| raw_step(&raw, &field, c * phases + p)).fold(0.0, f64::max);
    let explained = (0..phases).map(|p| (p as f64 / phases as f64, own(p)));
    lines.push(Line::new("highest points themselves", 6, explained.collect()));
    let mut outcome = Outcome { tables: vec![("phase-z", csv)], ..Outcome::default() };
    outcome.fact("phase-z", page.markdown());
    outcome.fact("phase-z-excess", number(quantum_excess, 2));
    outcome.plots.push(Plot {
        name: "phase-z",
        title: "Greatest step between neighbouring pixels of a flat floor: 2 mm noise, slices of 15 cm, 5 cm pixels"
            .into(),
        x: "height of the floor above a slice boundary (slice heights)",
        y: "greatest step (mm)",
        log_x: false,
        y_range: (0.0, 12.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}

fn number_of(phase: usize, phases: usize) -> String {
    number(phase as f64 / phases as f64, 4)
}

fn number3(value: f64) -> String {
    number(value, 3)
}

fn number5(value: f64) -> String {
    number(value, 5)
}

/// Highest point of every pixel.
fn highest(points: &[Vec3]) -> HashMap<[i64; 2], f64> {
    let mut highest = HashMap::new();
    for &[x, y, z] in points {
        let pixel = [x, y].map(|v| (v / PIXEL_M).floor() as i64);
        let top = highest.entry(pixel).or_insert(z);
        *top = z.max(*top);
    }
    highest
}

/// Greatest difference of the highest points of neighbouring pixels (mm), over the pixels that [`level`] looks at.
fn raw_step(highest: &HashMap<[i64; 2], f64>, field: &Field, number: usize) -> f64 {
    let patch = &field.patches[number];
    let first = [0, 1].map(|a| ((patch.middle[a] / PIXEL_M).floor() as i64) - EDGE / 2 + 3);
    let mut step: f64 = 0.0;
    for i in 0..EDGE - 6 {
        for j in 0..EDGE - 6 {
            let at = |i: i64, j: i64| highest.get(&[first[0] + i, first[1] + j]);
            let next = [(i + 1, j), (i, j + 1)].into_iter().filter(|next| next.0 < EDGE - 6 && next.1 < EDGE - 6);
            for (k, l) in next {
                if let (Some(a), Some(b)) = (at(i, j), at(k, l)) {
                    step = step.max((a - b).abs());
                }
            }
        }
    }
    step * 1000.0
}
