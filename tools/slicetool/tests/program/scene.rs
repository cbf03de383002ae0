//! Scenes that several tests convert and export, and their spans.

use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, TILE_PIXELS};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// Runs `slicetool export a.slices ARGUMENTS` in `folder`.
pub fn run(folder: &Path, arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_slicetool");
    Command::new(program).current_dir(folder).args(["export", "a.slices"]).args(arguments).output().unwrap()
}

/// Like [`run`], but must succeed without a warning; returns standard output.
pub fn export(folder: &Path, arguments: &[&str]) -> String {
    let out = run(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success() && said.is_empty(), "{arguments:?}: {said}");
    String::from_utf8(out.stdout).unwrap()
}

/// Converts points to the archive `a.slices` in a new folder that holds nothing else.
pub fn converted(points: Vec<[f64; 3]>, pixel_m: f64, slice_m: Option<f64>) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join("a.slices"));
    (options.grid.pixel, options.grid.slice_m) = (PixelSize::Metres(pixel_m), slice_m);
    convert(&options, &NoMonitor).unwrap();
    fs::remove_file(scan).unwrap();
    folder
}

/// A floor of 4 × 4 m at z = 0.35, a wall 2 m high along x = 3 and a roof over the quarter of least x and y.
pub fn floor_wall_roof() -> Vec<[f64; 3]> {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = (0..80).flat_map(|i| (0..80).map(move |j| [step(i), step(j), 0.35]));
    let wall = (0..80).flat_map(|j| (0..40).map(move |k| [3.025, step(j), 0.35 + step(k)]));
    let roof = (0..40).flat_map(|i| (0..40).map(move |j| [step(i), step(j), 2.75]));
    floor.chain(wall).chain(roof).collect()
}

/// Calls `give` with pixel, bottom and top (quanta) of each span.
pub fn each_span(archive: &Archive, mut give: impl FnMut([i64; 2], i64, i64)) {
    for entry in archive.entries() {
        let entry = entry.unwrap();
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        for (px, py, spans) in archive.page(&entry).unwrap().columns() {
            let pixel =
                [(entry.key.tx, px), (entry.key.ty, py)].map(|(tile, p)| i64::from(tile) * TILE_PIXELS + i64::from(p));
            spans.iter().for_each(|span| give(pixel, base + i64::from(span.bottom()), base + i64::from(span.top())));
        }
    }
}
