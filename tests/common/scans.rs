//! Small scans on disk, and the program that converts them.
#![allow(dead_code, reason = "each test file uses a part")]

#[path = "data.rs"]
pub mod data;
#[path = "random.rs"]
mod random;

pub use random::Random;

use scangen::{Chunks, WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader, merge};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A rough floor of 20 × 20 m with a wall, a partial roof and a few far points: whole millimetres around the origin, so
/// that any scale and offset that divide them represent them exactly.
pub fn points(count: usize) -> Vec<[f64; 3]> {
    let mut random = Random(5);
    let mut millimetres = |size: f64| (random.uniform() * size * 1000.0).round();
    (0..count)
        .map(|number| {
            let (x, y, z) = (millimetres(20.0), millimetres(20.0), millimetres(0.03));
            let point = match number % 10 {
                _ if number == 77 => [1_500_000.0, -2_000_000.0, 500_000.0],
                0 => [7_000.0 + z, y, x / 5.0],
                1 | 2 => [x / 2.0, y / 2.0, 2_500.0 + z],
                _ => [x, y, z],
            };
            [point[0] - 10_000.0, point[1] - 10_000.0, point[2]].map(|value| value / 1000.0)
        })
        .collect()
}

/// Writes `points` to `path` in the format of its extension, with steps of a millimetre.
pub fn write(path: &Path, points: &[[f64; 3]]) {
    write_as(path, points, 0.001, [0.0; 3]);
}

/// Writes `points` with another step and offset.
pub fn write_as(path: &Path, points: &[[f64; 3]], scale: f64, offset: [f64; 3]) {
    let mut spec = WriteSpec::for_path(path);
    spec.scale = [scale; 3];
    spec.offset = offset;
    spec.compression = spec.compression.map(|_| Chunks::Fixed(5_000));
    write_las(path, points.iter().copied(), &spec).unwrap();
}

/// Runs the program in `folder` and captures its output.
pub fn sliceconv(folder: &Path, arguments: &[&str]) -> Output {
    command(folder).args(arguments).output().unwrap()
}

/// The program in `folder`, to be given arguments.
pub fn command(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sliceconv"));
    command.current_dir(folder);
    command
}

/// Returns the peak resident memory of a running program (KiB); 0 if the system does not report it.
///
/// Until a process has become its program, its memory is that of this one.
pub fn peak_memory_kib(process: u32) -> u64 {
    let is_program = fs::read_link(format!("/proc/{process}/exe")).is_ok_and(|exe| exe.ends_with("sliceconv"));
    let status = if is_program {
        fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default()
    } else {
        String::new()
    };
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Checks that the program converts; returns its standard error.
pub fn converts(folder: &Path, arguments: &[&str]) -> String {
    let out = sliceconv(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(0), "{arguments:?}: {said}");
    said
}

/// Checks that the program fails with `code` without a result and, for 1, with one line, which is returned.
pub fn refuses(folder: &Path, arguments: &[&str], code: i32) -> String {
    let out = sliceconv(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(code), "{arguments:?}: {said}");
    assert!(out.stdout.is_empty(), "{arguments:?}");
    let lines: Vec<&str> = said.lines().filter(|line| !line.starts_with("sliceconv: warning: ")).collect();
    if code == 1 {
        assert_eq!(lines.len(), 1, "{arguments:?}: {said}");
        assert!(lines[0].starts_with("sliceconv: "), "{said}");
    }
    said
}

/// Checks that the archive at `path` is sound in every byte.
pub fn verifies(path: &Path) {
    let archive = Archive::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut findings = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| findings.push(finding.to_string())).unwrap();
    assert_eq!(findings, [""; 0], "{}", path.display());
}

/// Checks that the merged parts have the bytes of `whole`.
pub fn merges_to(parts: &[PathBuf], whole: &Path) {
    let output = whole.with_extension("merged");
    let _ = fs::remove_file(&output);
    let merged = merge(parts, &output, false, &NoMonitor).unwrap();
    assert!(merged.written);
    assert!(fs::read(&output).unwrap() == fs::read(whole).unwrap(), "{} parts of {}", parts.len(), whole.display());
}

/// The colours of all voxels of an archive; `None` for a voxel without one.
pub fn colours(archive: &Archive) -> BTreeMap<[i64; 3], Option<[u8; 3]>> {
    let mut reader = ColourReader::new(archive).unwrap().expect("the archive has colours");
    let mut found = BTreeMap::new();
    for entry in archive.entries().map(Result::unwrap) {
        let key = entry.key;
        for (px, py, k, colour) in reader.colours(&entry).unwrap().voxels() {
            let at = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
            found.insert([at(key.tx, px), at(key.ty, py), i64::from(key.layer) * PAGE_SLICES + i64::from(k)], colour);
        }
    }
    found
}

/// Names in `folder`, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// `path` as an argument.
pub fn text(path: &(impl AsRef<OsStr> + ?Sized)) -> &str {
    path.as_ref().to_str().unwrap()
}
