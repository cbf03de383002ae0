//! Preparation: points made by oversampling (table 4.4), time and memory (figures 4.2 and 4.3, table 4.3), and what
//! oversampling misses.

use super::models::Model;
use crate::measured::{Conversion, Measured};
use crate::stability::Result;
use crate::stability::table::{Table, number, percent};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;
use slicewalk::store::Snapshot;
use slicewalk_mesh::sample::oversample;
use std::collections::BTreeMap;
use std::path::Path;

/// Sides of the thesis' images (pixels).
const SIDES: [f64; 2] = [350.0, 700.0];

/// Tables by name.
pub fn measure(models: &[Model], folder: &Path, quick: bool) -> Result<Vec<(&'static str, String)>> {
    let rounds = if quick { 1 } else { 2 };
    let meshes: Vec<&Model> = models.iter().filter(|model| model.is_mesh()).collect();
    Ok(vec![
        ("points", points(&meshes)),
        ("cost", cost(models, folder, rounds)?),
        ("exact", exact(&meshes, folder, rounds)?),
        ("scans", scans(models, folder, rounds)?),
    ])
}

fn made(model: &Model, step_m: f64) -> u64 {
    let mut count = 0;
    model.triangles.iter().for_each(|triangle| oversample(triangle, step_m, |_| count += 1));
    count
}

/// Table 4.4.
fn points(meshes: &[&Model]) -> String {
    let mut table = Table::new([
        "model",
        "thesis, 350",
        "t corrected, 350",
        "t printed, 350",
        "thesis, 700",
        "t corrected, 700",
        "t printed, 700",
        "Slicewalk / thesis, 700",
    ]);
    for model in meshes {
        let mut cells = vec![model.name.to_owned()];
        let theirs = model.thesis.and_then(|thesis| thesis.made);
        let mut ratio = "-".to_owned();
        for (at, side) in SIDES.into_iter().enumerate() {
            let mended = made(model, model.pixel(side));
            cells.push(theirs.map_or("-".into(), |made| made[at].to_string()));
            cells.push(mended.to_string());
            cells.push(made(model, model.pixel_as_printed(side)).to_string());
            if let Some(theirs) = theirs {
                ratio = number(mended as f64 / theirs[at] as f64, 2);
            }
        }
        cells.push(ratio);
        table.row(cells);
    }
    table.markdown()
}

/// Figures 4.2 and 4.3, table 4.3.
fn cost(models: &[Model], folder: &Path, rounds: usize) -> Result<String> {
    let mut table = Table::new([
        "model",
        "pixels",
        "exact (s)",
        "peak (MiB)",
        "archive (kB)",
        "oversampled, thesis' rule (s)",
        "peak (MiB)",
        "archive (kB)",
        "thesis: for obstacles alone (MB)",
    ]);
    let cells =
        |found: Measured| [number(found.seconds, 2), number(found.peak_mib, 0), number(found.bytes as f64 / 1e3, 0)];
    for model in models {
        for (at, side) in SIDES.into_iter().enumerate() {
            let pixel = model.pixel(side);
            let exact = Conversion::new(&model.path, &folder.join("a.slices"), model.y_up, pixel);
            let sampled = Conversion { step: Some(pixel), thesis_rule: true, ..exact.clone() };
            let theirs = model.thesis.map_or("-".into(), |thesis| number(thesis.obstacles_mb[at], 1));
            let head = [model.name.to_owned(), number(side, 0)];
            let row = head.into_iter().chain(cells(exact.measure(rounds)?)).chain(cells(sampled.measure(rounds)?));
            table.row(row.chain([theirs]));
        }
    }
    Ok(table.markdown())
}

/// Occupied slices of each pixel of each page.
fn voxels(path: &Path) -> Result<BTreeMap<(PageKey, u32, u32), u64>> {
    let store = Snapshot::resident(&Archive::open(path)?, &NoMonitor)?;
    let mut all = BTreeMap::new();
    for number in 0..store.column_count() {
        let (tx, ty, slots) = store.column_at(number);
        for slot in slots {
            let key = PageKey { tx, ty, layer: slot.layer() };
            for (px, py, spans) in slot.page().ok_or("a page is missing")?.columns() {
                let mask = spans.iter().fold(0u64, |mask, span| {
                    let (first, last) = span.slices();
                    mask | (u64::MAX >> (63 - (last - first))) << first
                });
                all.insert((key, px, py), mask);
            }
        }
    }
    Ok(all)
}

/// Bits of `a` that `b` has not.
fn beyond(a: &BTreeMap<(PageKey, u32, u32), u64>, b: &BTreeMap<(PageKey, u32, u32), u64>) -> u64 {
    a.iter().map(|(at, mask)| u64::from((mask & !b.get(at).unwrap_or(&0)).count_ones())).sum()
}

/// Exact beside oversampled.
fn exact(meshes: &[&Model], folder: &Path, rounds: usize) -> Result<String> {
    let mut table = Table::new([
        "model",
        "how",
        "time (s)",
        "peak (MiB)",
        "points made",
        "voxels",
        "missed",
        "added",
        "archive (kB)",
    ]);
    for model in meshes {
        let pixel = model.pixel(SIDES[1]);
        let path = folder.join("a.slices");
        let exact = Conversion::new(&model.path, &path, model.y_up, pixel);
        let mut truth = None;
        for (name, share) in [("exact", None), ("step t", Some(1.0)), ("t/2", Some(0.5)), ("t/4", Some(0.25))] {
            // The finer steps take long, and are there for what they miss.
            let rounds = if share.is_some_and(|share| share < 1.0) { 1 } else { rounds };
            let found = Conversion { step: share.map(|share| share * pixel), ..exact.clone() }.measure(rounds)?;
            let found_voxels = voxels(&path)?;
            let count: u64 = found_voxels.values().map(|mask| u64::from(mask.count_ones())).sum();
            let truth = &*truth.get_or_insert_with(|| found_voxels.clone());
            let all: u64 = truth.values().map(|mask| u64::from(mask.count_ones())).sum();
            table.row([
                model.name.to_owned(),
                name.into(),
                number(found.seconds, 2),
                number(found.peak_mib, 0),
                found.points_made.to_string(),
                count.to_string(),
                percent(beyond(truth, &found_voxels) as f64 / all as f64),
                beyond(&found_voxels, truth).to_string(),
                number(found.bytes as f64 / 1e3, 0),
            ]);
        }
    }
    Ok(table.markdown())
}

/// Table 4.5.
fn scans(models: &[Model], folder: &Path, rounds: usize) -> Result<String> {
    let mut table = Table::new([
        "",
        "thesis: image-based",
        "thesis: R-tree of BVHs",
        "Slicewalk, pixels of eq. 3.3 at 700",
        "thesis / Slicewalk",
    ]);
    let Some(scan) = models.iter().find(|model| model.points.len() == 580_062) else {
        return Ok("The scan was not there.".into());
    };
    let path = folder.join("a.slices");
    let found = Conversion::new(&scan.path, &path, false, scan.pixel(SIDES[1])).measure(rounds)?;
    let store = Snapshot::resident(&Archive::open(&path)?, &NoMonitor)?;
    let resident = (store.weight_bytes() + store.table_bytes()) as f64 / 1e6;
    let times = |theirs: f64, ours: f64| number(theirs / ours, 0);
    table.row([
        "preparation (s)".into(),
        "13.9".into(),
        "1500".into(),
        number(found.seconds, 2),
        times(13.9, found.seconds),
    ]);
    table.row([
        "memory at run time (MB)".into(),
        "143.36, application and images".into(),
        "225.44".into(),
        format!("{}, all pages and their table", number(resident, 1)),
        times(143.36, resident),
    ]);
    table.row(["frames per second", "30", "16 to 30", "see the next table", "-"]);
    Ok(table.markdown())
}
