//! `--drop-floaters` drops exactly the small components, whatever the order, files, threads and parts.

use crate::scans;

use scans::{Random, converts, refuses, sliceconv, text, verifies, write};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, merge};
use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Pixels of 0.1 m and slices of 0.3 m; points are in the middle of their voxels, so that rounding never decides.
const GRID: [&str; 7] = ["--pixel", "0.1", "--units", "m", "--quiet", "--force", "--json"];

type Cell = [i64; 3];

fn middle([i, j, s]: Cell) -> [f64; 3] {
    [0.1 * i as f64 + 0.05, 0.1 * j as f64 + 0.05, 0.3 * s as f64 + 0.15]
}

/// A floor, components of all sizes around the corner of four tiles, and a thin line across many tiles.
fn scene() -> Vec<Cell> {
    let mut random = Random(3);
    let mut cells = Vec::new();
    for i in -80..80 {
        cells.extend((-70..70).map(|j| [i, j, -9]));
    }
    for _ in 0..900 {
        let mut at = [random.below(240) as i64 - 120, random.below(240) as i64 - 120, random.below(40) as i64];
        for _ in 0..random.below(30) {
            cells.push(at);
            at[random.below(3)] += random.below(3) as i64 - 1;
        }
    }
    cells.extend((-300..300i64).map(|i| [i, i / 2, 60 + i.rem_euclid(2)]));
    cells
}

/// The cells of components larger than `most`, by definition.
fn stays(cells: &[Cell], most: usize) -> HashSet<Cell> {
    let all: HashSet<Cell> = cells.iter().copied().collect();
    let (mut seen, mut kept) = (HashSet::new(), HashSet::new());
    for &start in &all {
        if !seen.insert(start) {
            continue;
        }
        let (mut piece, mut next) = (vec![start], 0);
        while let Some(&[i, j, s]) = piece.get(next) {
            next += 1;
            for step in 0..27 {
                let near = [i + step % 3 - 1, j + step / 3 % 3 - 1, s + step / 9 - 1];
                if all.contains(&near) && seen.insert(near) {
                    piece.push(near);
                }
            }
        }
        if piece.len() > most {
            kept.extend(piece);
        }
    }
    kept
}

/// Converts; returns the archive's bytes and the program's report.
fn convert(at: &Path, inputs: &[&str], options: &[&str]) -> (Vec<u8>, serde_json::Value) {
    let out = sliceconv(at, &[inputs, &["-o", "out.slices"], &GRID, options].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    verifies(&at.join("out.slices"));
    (fs::read(at.join("out.slices")).unwrap(), serde_json::from_slice(&out.stdout).unwrap())
}

/// The pages of the archive at `path` as stored.
fn pages(path: &Path) -> Vec<u8> {
    let archive = Archive::open(path).unwrap();
    let (begin, len) = (archive.header().pages_offset() as usize, archive.header().bytes.pages as usize);
    fs::read(path).unwrap()[begin..begin + len].to_vec()
}

fn folder() -> (TempDir, Vec<Cell>) {
    let folder = tempfile::tempdir().unwrap();
    let cells = scene();
    write(&folder.path().join("all.las"), &cells.iter().copied().map(middle).collect::<Vec<_>>());
    (folder, cells)
}

#[test]
fn the_archive_is_that_of_the_points_of_larger_pieces() {
    let (folder, cells) = folder();
    let at = folder.path();
    let occupied = cells.iter().collect::<HashSet<_>>().len();
    for most in [1, 2, 7, 20, 599, 600, 65_535] {
        let kept = stays(&cells, most);
        let points: Vec<_> = cells.iter().copied().filter(|cell| kept.contains(cell)).map(middle).collect();
        write(&at.join("kept.las"), &points);
        convert(at, &["kept.las"], &[]);
        let expected = pages(&at.join("out.slices"));
        let (_, report) = convert(at, &["all.las"], &["--drop-floaters", &most.to_string()]);
        assert!(pages(&at.join("out.slices")) == expected, "{most}");
        assert_eq!(report["voxels_dropped"], occupied - kept.len(), "{most}");
        assert_eq!(report["drop_isolated"], true);
        assert_eq!(report["drop_floaters"], if most > 1 { most.into() } else { serde_json::Value::Null });
    }
}

#[test]
fn the_old_name_makes_the_same_bytes_and_order_files_and_threads_do_not_show() {
    let (folder, cells) = folder();
    let at = folder.path();
    let (one, _) = convert(at, &["all.las"], &["--drop-floaters", "1"]);
    assert!(convert(at, &["all.las"], &["--drop-isolated"]).0 == one);
    let dense = ["--drop-floaters", "11", "--threads", "1"];
    let (expected, _) = convert(at, &["all.las"], &dense);
    let mut points: Vec<_> = cells.iter().copied().map(middle).collect();
    Random(4).shuffle(&mut points);
    write(&at.join("p.laz"), &points[..9_000]);
    write(&at.join("q.las"), &points[9_000..]);
    for threads in ["1", "2", "5"] {
        for memory in ["64MiB", "1GiB"] {
            let options = ["--drop-floaters", "11", "--threads", threads, "--memory", memory];
            assert!(convert(at, &["q.las", "p.laz"], &options).0 == expected, "{threads} threads, {memory}");
        }
    }
}

#[test]
fn parts_merge_to_the_bytes_of_one_run_although_pieces_cross_them() {
    let (folder, cells) = folder();
    let at = folder.path();
    // One file per strip of 2 m: parts leave some out, but none within reach of a component.
    let mut strips: HashMap<i64, Vec<[f64; 3]>> = HashMap::new();
    cells.iter().for_each(|cell| strips.entry(cell[0].div_euclid(20)).or_default().push(middle(*cell)));
    let names: Vec<String> = strips.keys().map(|strip| format!("strip{strip}.las")).collect();
    strips.iter().for_each(|(strip, points)| write(&at.join(format!("strip{strip}.las")), points));
    let inputs: Vec<&str> = names.iter().map(String::as_str).collect();
    for most in ["9", "90"] {
        let options = ["--drop-floaters", most];
        let (whole, _) = convert(at, &inputs, &options);
        converts(at, &[&inputs[..], &["--write-plan", "plan.json"], &GRID[..6], &options].concat());
        let parts: Vec<_> = (1..=5).map(|index| at.join(format!("{index}.slices"))).collect();
        for (index, part) in parts.iter().enumerate() {
            let shard = format!("{}/5", index + 1);
            let options = ["--plan", "plan.json", "--shard", &shard, "-o", text(part), "--quiet", "--force"];
            converts(at, &[&inputs[..], &options].concat());
        }
        let _ = fs::remove_file(at.join("merged.slices"));
        merge(&parts, &at.join("merged.slices"), false, &NoMonitor).unwrap();
        assert!(fs::read(at.join("merged.slices")).unwrap() == whole, "{most}");
    }
}

#[test]
fn numbers_that_make_no_sense_and_two_names_at_once_are_refused() {
    let (folder, _) = folder();
    for wrong in
        [&["--drop-floaters", "0"][..], &["--drop-floaters", "65536"], &["--drop-floaters", "2", "--drop-isolated"]]
    {
        refuses(folder.path(), &[&["all.las", "-o", "x.slices"], wrong].concat(), 2);
    }
}
