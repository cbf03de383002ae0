//! Changes that must not affect the result: rotation, translation, the order of points, repeated points.

use super::lab::{Judged, Method, Scan, Setting, Vec3, Voxel};
use super::patch::Field;
use super::planes::{NOISE_M, PIXEL_M, phase, shares};
use super::plot::{Line, Plot};
use super::table::{Errors, Share, Table, number, percent};
use super::written::Written;
use super::{Effort, Outcome, Result};
use crate::Random;
use scangen::{Params, SampleSpec, Scene};
use slicewalk::frame::SLICE_QUANTA;
use slicewalk::plan::Classifier;
use std::collections::BTreeMap;

/// Floor, two slopes and a wall, turned by 0 to 90 degrees.
pub fn rotation(effort: Effort) -> Result<Outcome> {
    let step = effort.of(5.0, 45.0);
    let angles: Vec<f64> = (0..=(90.0 / step) as usize).map(|n| n as f64 * step).collect();
    let slopes = [0.0, 40.0, 50.0, 90.0];
    let copies = effort.of(8, 2);
    let mut random = Random(500);
    let mut field = Field::new(angles.len() * slopes.len() * copies);
    for &slope in &slopes {
        for &angle in &angles {
            for _ in 0..copies {
                field.add(PIXEL_M, slope, angle, 24.0, phase(&mut random));
            }
        }
    }
    let scan = Scan::new(field.points(4.0, NOISE_M, &mut random))?;
    let head = ["angle_deg", "method", "floor_wrong", "slope40_wrong", "slope50_wrong", "wall_wrong"];
    let mut csv = Table::new(head);
    let mut page = Table::new([
        "method",
        "floor: wrong",
        "40°: wrong, least to most over angles",
        "50°: wrong, least to most",
        "wall: wrong, least to most",
    ]);
    let mut lines = Vec::new();
    for method in Method::ALL {
        let shares = shares(&field, &scan.judge(Setting::new(PIXEL_M), method)?)?;
        let mut ends = [[f64::INFINITY, f64::NEG_INFINITY]; 4];
        let mut line = Vec::new();
        for (a, &angle) in angles.iter().enumerate() {
            let wrong = [0, 1, 2, 3].map(|s| {
                let mut sum = Share::default();
                let first = (s * angles.len() + a) * copies;
                shares[first..first + copies].iter().for_each(|&share| sum.merge(share));
                if slopes[s] > 45.0 { 1.0 - sum.value() } else { sum.value() }
            });
            ends.iter_mut().zip(wrong).for_each(|(ends, v)| *ends = [ends[0].min(v), ends[1].max(v)]);
            line.push((angle, wrong.into_iter().fold(0.0, f64::max)));
            csv.row([number(angle, 0), method.name().into()].into_iter().chain(wrong.map(|v| number(v, 4))));
        }
        lines.push(Line::of(method, line));
        let range = |s: usize| format!("{} to {}", percent(ends[s][0]), percent(ends[s][1]));
        page.row([method.name().to_owned(), percent(ends[0][1]), range(1), range(2), range(3)]);
    }
    let mut outcome = Outcome { tables: vec![("rotation", csv)], ..Outcome::default() };
    outcome.fact("rotation", page.markdown());
    outcome.plots.push(Plot {
        name: "rotation",
        title: "Worst share of wrong classes of floor, 40°, 50° and wall: limit 45°, 4 points per pixel".into(),
        x: "heading (degrees)",
        y: "share of voxels misclassified",
        log_x: false,
        y_range: (0.0, 1.0),
        marks: vec![],
        lines,
    });
    Ok(outcome)
}

/// Floor, slopes and a wall near the origin.
fn small_scene(pixel_m: f64, density: f64) -> (Field, Vec<Vec3>) {
    let mut random = Random(808);
    let mut field = Field::new(9);
    for slope in [0.0, 0.0, 30.0, 42.0, 45.0, 48.0, 60.0, 90.0, 90.0] {
        field.add(pixel_m, slope, 33.0, 24.0, phase(&mut random));
    }
    let points = field.points(density, NOISE_M, &mut random);
    (field, points)
}

/// Returns the classes by voxel, in tiles and slices of the shifted scene moved back.
fn verdicts(judged: &Judged, pixel_m: f64, pixels: i64, z_m: f64) -> Result<BTreeMap<[i64; 3], bool>> {
    let mut verdicts = BTreeMap::new();
    judged.voxels(|Voxel { pixel: [i, j], z, obstacle }| {
        let slice = ((z[0] - z_m) / (3.0 * pixel_m)).round() as i64;
        verdicts.insert([i - pixels, j - pixels, slice], obstacle);
    })?;
    Ok(verdicts)
}

fn differing(a: &BTreeMap<[i64; 3], bool>, b: &BTreeMap<[i64; 3], bool>) -> f64 {
    let mut share = Share::default();
    a.iter().for_each(|(key, verdict)| share.add(b.get(key) != Some(verdict)));
    b.keys().filter(|key| !a.contains_key(*key)).for_each(|_| share.add(true));
    share.value()
}

/// One scene at 0, 500, 5000 and 10 000 km, on grids that binary numbers hold exactly and on decimal ones.
pub fn translation(_: Effort) -> Result<Outcome> {
    let head = [
        "grid",
        "shift_m",
        "method",
        "verdicts_differing",
        "spans_equal",
        "floor_rmse_mm",
        "greatest_change_of_a_floor_mm",
    ];
    let mut csv = Table::new(head);
    let mut page = Table::new([
        "grid",
        "shift",
        "method",
        "classes differing from those at 0",
        "spans equal",
        "floor RMSE (mm)",
        "greatest change of a floor (mm)",
    ]);
    for (grid, pixel_m, step) in [("binary 1/16 m", 0.0625, 1.0 / 1024.0), ("decimal 5 cm", 0.05, 0.001)] {
        let (field, points) = small_scene(pixel_m, 6.0);
        let mut at_origin: BTreeMap<usize, AtOrigin> = BTreeMap::new();
        for shift in [0.0f64, 5e5, 5e6, 1e7] {
            // Whole tiles and whole slices: 64 pixels, 64 slices.
            let tiles = (shift / (64.0 * pixel_m)).round();
            let (pixels, offset) = (tiles as i64 * 64, tiles * 64.0 * pixel_m);
            let layers = (shift / 1e4 / (64.0 * 3.0 * pixel_m)).round();
            let z_offset = layers * 64.0 * 3.0 * pixel_m;
            // Coordinates and offset apart, as LAS keeps them: the steps are the same integers everywhere.
            let moved = points.iter().map(|p| [p[0] + offset, p[1] + offset, p[2] + z_offset]).collect();
            let scan = Scan::in_steps(moved, step, [offset, offset, z_offset])?;
            let floats = |v: f64| f64::from(v as f32);
            let single = scan.points.iter().map(|p| p.map(floats));
            let setting = Setting::new(pixel_m);
            let mut cases: Vec<(usize, String, Judged)> = Vec::new();
            for method in Method::ALL {
                cases.push((method as usize, method.name().into(), scan.judge(setting, method)?));
            }
            let name = "thesis as written in 32-bit floats";
            cases.push((4, name.into(), Judged::Written(Written::new(setting, single))));
            for (number_of, name, judged) in cases {
                let own = verdicts(&judged, pixel_m, pixels, origin(&judged, z_offset))?;
                let spans = spans(&judged, pixels, layers as i64 * 64 * SLICE_QUANTA)?;
                let mut errors = Errors::default();
                for patch in &field.patches[..2] {
                    for i in -8..8 {
                        for j in -8..8 {
                            let [x, y] = [0, 1].map(|a| patch.middle[a] + offset + ([i, j][a] as f64 + 0.3) * pixel_m);
                            let truth = patch.middle[2] + z_offset;
                            // No floor counts as one 1 m too low.
                            let found = judged.floor(x, y, truth + 0.3, 0.6).unwrap_or(truth - 1.0);
                            errors.0.push((found - truth) * 1000.0);
                        }
                    }
                }
                let (first, first_spans, first_errors) =
                    at_origin.entry(number_of).or_insert_with(|| (own.clone(), spans.clone(), errors.0.clone()));
                let change = first_errors.iter().zip(&errors.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                let differing = differing(first, &own);
                let equal = match (spans.is_empty(), *first_spans == spans) {
                    (true, _) => "",
                    (_, true) => "yes",
                    (_, false) => "no",
                };
                let shift = number(shift, 0);
                let heights = [errors.rmse(), change].map(|v| number(v, 3));
                csv.row(
                    [grid.into(), shift.clone(), name.clone(), number(differing, 6), equal.into()]
                        .into_iter()
                        .chain(heights),
                );
                if shift != "0" && number_of != Method::Span as usize && number_of != Method::OrderFree as usize {
                    let [rmse, change] = [errors.rmse(), change].map(|v| number(v, 1));
                    page.row([grid.into(), format!("{shift} m"), name, percent(differing), equal.into(), rmse, change]);
                }
            }
        }
    }
    let mut outcome = Outcome { tables: vec![("translation", csv)], ..Outcome::default() };
    outcome.fact("translation", page.markdown());
    Ok(outcome)
}

/// Classes, spans and floors of a scene that has not been shifted.
type AtOrigin = (BTreeMap<[i64; 3], bool>, Vec<Spans>, Vec<f64>);
type Spans = ([i64; 2], [i64; 2], bool);

/// Height from which slices count: the lowest point for the rule as written, the shift for Slicewalk.
fn origin(judged: &Judged, shift: f64) -> f64 {
    match judged {
        Judged::Written(written) => written.origin(),
        Judged::Converted(_) => shift,
    }
}

fn spans(judged: &Judged, pixels: i64, quanta: i64) -> Result<Vec<Spans>> {
    let mut all = Vec::new();
    if let Judged::Converted(converted) = judged {
        converted.spans(|[i, j], z, obstacle| {
            all.push(([i - pixels, j - pixels], z.map(|z| z - quanta), obstacle));
        })?;
    }
    all.sort_unstable();
    Ok(all)
}

/// The house in twenty orders.
pub fn order(effort: Effort) -> Result<Outcome> {
    let shuffles = effort.of(20, 3);
    let scene = Scene::named("house", &Params::new())?;
    let points: Vec<Vec3> =
        scene.points(5, &SampleSpec::direct_count(effort.of(400_000, 50_000)).with_noise(NOISE_M))?.collect();
    let setting = Setting::new(effort.of(0.08, 0.2));
    let mut random = Random(99);
    let mut scan = Scan::new(points)?;
    let first = verdicts(&scan.judge(setting, Method::Written)?, setting.pixel_m, 0, 0.0)?;
    let classifiers = [Classifier::Thesis, Classifier::Span, Classifier::Plane];
    let bytes = classifiers.map(|c| scan.convert(setting, c).map(|converted| converted.bytes));
    let mut csv = Table::new(["order", "thesis_as_written_verdicts_changed", "archives_of_ours_equal"]);
    let (mut worst, mut all_equal) = (0.0f64, true);
    for n in 0..shuffles {
        let mut points = std::mem::take(&mut scan.points);
        if n == 0 {
            points.reverse();
        } else {
            for at in (1..points.len()).rev() {
                points.swap(at, (random.bits() % (at as u64 + 1)) as usize);
            }
        }
        scan = Scan::new(points)?;
        let changed = differing(&first, &verdicts(&scan.judge(setting, Method::Written)?, setting.pixel_m, 0, 0.0)?);
        let mut equal = true;
        for (classifier, bytes) in classifiers.into_iter().zip(&bytes) {
            equal &= bytes
                .as_ref()
                .is_ok_and(|bytes| *bytes == scan.convert(setting, classifier).map_or(vec![], |c| c.bytes));
        }
        worst = worst.max(changed);
        all_equal &= equal;
        let name = if n == 0 { "reversed".to_owned() } else { format!("shuffle {n}") };
        csv.row([name, number(changed, 5), if equal { "yes" } else { "no" }.into()]);
    }
    let mut outcome = Outcome { tables: vec![("order", csv)], ..Outcome::default() };
    outcome.fact("order-count", shuffles.to_string());
    outcome.fact("order-written", percent(worst));
    outcome.fact("order-ours", if all_equal { "equal byte for byte" } else { "NOT equal" });
    Ok(outcome)
}

/// Points repeated: one in ten, half, all, all four times; next to each other, or at the end of the file.
pub fn duplicates(_: Effort) -> Result<Outcome> {
    let (_, points) = small_scene(PIXEL_M, 4.0);
    let setting = Setting::new(PIXEL_M);
    let mut csv = Table::new(["repeated", "where", "method", "verdicts_changed"]);
    let mut page =
        Table::new(["repeated", "where"].into_iter().chain(Method::ALL.map(Method::name)).collect::<Vec<_>>());
    let mut first = Vec::new();
    for (what, share, times) in
        [("none", 0.0, 1), ("1 in 10", 0.1, 1), ("half", 0.5, 1), ("all", 1.0, 1), ("all three times", 1.0, 3)]
    {
        for place in ["beside", "at the end"] {
            let mut random = Random(17);
            let (mut all, mut more) = (Vec::new(), Vec::new());
            for &point in &points {
                all.push(point);
                if random.between(0.0, 1.0) < share {
                    let to = if place == "beside" { &mut all } else { &mut more };
                    to.extend(std::iter::repeat_n(point, times));
                }
            }
            all.extend(more);
            let scan = Scan::new(all)?;
            let mut cells = vec![what.to_owned(), place.to_owned()];
            for method in Method::ALL {
                let own = verdicts(&scan.judge(setting, method)?, PIXEL_M, 0, 0.0)?;
                if share == 0.0 && place == "beside" {
                    first.push(own.clone());
                }
                let changed = differing(&first[method as usize], &own);
                csv.row([what.into(), place.into(), method.name().into(), number(changed, 5)]);
                cells.push(percent(changed));
            }
            if share > 0.0 {
                page.row(cells);
            }
        }
    }
    let mut outcome = Outcome { tables: vec![("duplicates", csv)], ..Outcome::default() };
    outcome.fact("duplicates", page.markdown());
    Ok(outcome)
}
