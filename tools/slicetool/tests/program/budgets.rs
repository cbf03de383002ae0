//! Hostile archives and a large sound one under system limits: every command ends, in a stated amount of memory, with
//! an answer or one line. `docs/convert.md` lists the amounts.
//!
//! `SLICEWALK_BUDGET_TILES` sets the number of tiles along each side of the sound archive, 4,096 voxels each.
#![cfg(target_os = "linux")]

use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{Page, PageBuilder, Span};
use slicewalk::plan::Plan;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Memory of a command that inspects an archive (MiB), without caches.
const MEMORY_MIB: u64 = 64;
/// Memory of a surface or of all reachable places, which are held whole (MiB).
const SURFACE_MIB: u64 = 1024;
/// Cache of queries and walks (MiB).
const CACHE_MIB: u64 = 16;
/// Processor time after which the system ends a command (s): many times that of the slowest one, so that only endless
/// work exceeds it.
const SECONDS: u64 = 60;

/// Runs the program under limits of private memory and of time.
fn limited(folder: &Path, mib: u64, arguments: &[&str]) -> Output {
    let limits = format!("ulimit -d {} && ulimit -t {SECONDS} && exec \"$0\" \"$@\"", mib << 10);
    Command::new("sh")
        // A single arena, because each further one reserves memory that it may never use.
        .env("MALLOC_ARENA_MAX", "1")
        .current_dir(folder)
        .args(["-c", &limits, env!("CARGO_BIN_EXE_slicetool")])
        .args(arguments)
        .output()
        .unwrap()
}

/// Checks that the command succeeded, or failed with one line.
fn is_handled(arguments: &[&str], out: &Output) {
    let said = String::from_utf8_lossy(&out.stderr);
    let code = out.status.code();
    assert!(matches!(code, Some(0 | 1)), "{arguments:?}: {}, {said}", out.status);
    assert!(!said.contains("panicked") && !said.contains("memory allocation"), "{arguments:?}: {said}");
    let errors = said.lines().filter(|line| !line.starts_with("slicetool: warning: ")).count();
    assert!(code == Some(0) || errors <= 1, "{arguments:?}: {said}");
}

/// A folder with the files that commands read beside the archive.
fn folder_with_tables() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("boxes.csv"), "0,0,0,1,1,1\n-1e6,-1e6,-1e6,1e6,1e6,1e6\n").unwrap();
    fs::write(at.join("rays.csv"), "0,0,1,1,0,0,1e9\n0,0,1,0,0,-1,inf\n").unwrap();
    fs::write(at.join("way.csv"), "1,1\n2,2\n").unwrap();
    folder
}

/// Returns whether the memory of a command grows with its result.
fn holds_its_result(arguments: &[&str]) -> bool {
    arguments.contains(&"p.glb") || arguments[0] == "reach"
}

/// Runs every command on the archive `name` and returns the outputs.
fn ask_everything(folder: &Path, name: &str, is_wanted: impl Fn(&[&str]) -> bool) -> Vec<Output> {
    let cache = format!("{CACHE_MIB}MiB");
    let commands: [&[&str]; 18] = [
        &["info", name, "--json"],
        &["verify", name],
        &["stats", name],
        &["show", name, "--slice", "0", "-o", "s.png"],
        &["diff", name, name],
        &["query", name, "--boxes", "boxes.csv", "--cache", &cache],
        &["query", name, "--rays", "rays.csv", "--cache", &cache],
        &["walk", name, "--start", "1,1,7.5", "--waypoints", "way.csv", "--cache", &cache, "-o", "p.csv"],
        &["reach", name, "--from", "1,1,7.5", "--cache", &cache],
        &["route", name, "--from", "1,1,7.5", "--to", "2,2,7.5", "--cache", &cache],
        &["export", name, "-o", "p.ply"],
        &["export", name, "-o", "p.tif"],
        &["export", name, "-o", "p.dxf"],
        &["export", name, "-o", "p.glb"],
        &["extract", name, "-o", "x.slices", "--bounds", "0,0,0,1,1,1", "--force"],
        &["diff", name, "x.slices", "--changes", "c.ply"],
        &["recover", name, "-o", "r.slices", "--force"],
        &["replace", name, "--with", name, "-o", "c.slices", "--bounds=-9e9,-9e9,-9e9,9e9,2,9", "--force"],
    ];
    let wanted = commands.into_iter().filter(|arguments| is_wanted(arguments));
    wanted
        .map(|arguments| {
            let mib = if holds_its_result(arguments) { SURFACE_MIB } else { MEMORY_MIB + CACHE_MIB };
            let out = limited(folder, mib, arguments);
            is_handled(arguments, &out);
            out
        })
        .collect()
}

#[test]
fn forged_archives_cost_little_whatever_is_asked() {
    let Some(data) = std::env::var_os("SLICEWALK_DATA").map(PathBuf::from).filter(|data| data.join("forged").is_dir())
    else {
        eprintln!("skipped: SLICEWALK_DATA names no folder with forged archives");
        return;
    };
    let folder = folder_with_tables();
    let mut count = 0;
    for entry in fs::read_dir(data.join("forged")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "slices") {
            continue;
        }
        count += 1;
        ask_everything(folder.path(), path.to_str().unwrap(), |_| true);
    }
    assert!(count > 20, "{count} archives");
}

/// Rough ground that fills a tile, at a height of 7 m.
fn rough_ground() -> Page {
    let mut builder = PageBuilder::default();
    for pixel in 0..4096u32 {
        let top = 6000 + pixel.wrapping_mul(2_654_435_761) % 100;
        assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(top, top, false).unwrap()]));
    }
    builder.build()
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_large_sound_archive_costs_no_more_than_a_small_one() {
    let tiles = std::env::var("SLICEWALK_BUDGET_TILES").map_or(48, |tiles| tiles.parse().unwrap());
    let folder = folder_with_tables();
    let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
    let mut writer = ArchiveWriter::create(&folder.path().join("a.slices"), &plan, false).unwrap();
    let (page, mut encoder) = (rough_ground(), PageEncoder::new(plan.frame));
    let mut keys: Vec<_> = (0..tiles).flat_map(|tx| (0..tiles).map(move |ty| PageKey { tx, ty, layer: 0 })).collect();
    keys.sort_unstable();
    for key in keys {
        writer.put(key, encoder.encode(key, &page)).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    let all = ask_everything(folder.path(), "a.slices", |arguments| !holds_its_result(arguments));
    for out in all {
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    }
}
