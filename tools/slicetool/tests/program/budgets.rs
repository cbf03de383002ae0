//! Hostile archives and a large sound one under system limits: every command ends, in a stated amount of memory, with
//! an answer or one line. `docs/convert.md` lists the amounts.
//!
//! `SLICEWALK_BUDGET_TILES` sets the number of tiles along each side of the sound archive, 4,096 voxels each.
#![cfg(target_os = "linux")]

use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{Page, PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk::seen::{SeenBlock, SeenPage};
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

/// Rough ground that fills a tile, at a height of 7 m. Each number gives other ground.
fn rough_ground(number: u32) -> Page {
    let mut builder = PageBuilder::default();
    for pixel in 0..4096u32 {
        let top = 6000 + (4096 * number + pixel).wrapping_mul(2_654_435_761) % 100;
        assert!(builder.set_column(pixel % 64, pixel / 64, &[Span::new(top, top, false).unwrap()]));
    }
    builder.build()
}

/// Writes `a.slices` of so many tiles along x and y, and layers. `page` returns the page of a number.
fn sound_archive(folder: &Path, [width, depth, layers]: [i32; 3], page: impl Fn(u32) -> Page) {
    let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
    let mut writer = ArchiveWriter::create(&folder.join("a.slices"), &plan, false).unwrap();
    let mut encoder = PageEncoder::new(plan.frame);
    let columns = (0..width).flat_map(|tx| (0..depth).map(move |ty| (tx, ty)));
    let mut keys: Vec<_> =
        columns.flat_map(|(tx, ty)| (0..layers).map(move |layer| PageKey { tx, ty, layer })).collect();
    keys.sort_unstable();
    for (key, number) in keys.into_iter().zip(0..) {
        writer.put(key, encoder.encode(key, &page(number))).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
}

/// Runs the program on `a.slices` with a cache of this size (KiB).
fn with_cache(folder: &Path, command: &str, arguments: &[&str], cache: usize) -> Output {
    let cache = format!("{cache}KiB");
    limited(folder, SURFACE_MIB, &[&[command, "a.slices", "--json", "--cache", &cache], arguments].concat())
}

/// The cache that a refusal asks for (KiB).
fn enough(out: &Output) -> usize {
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(1) && said.lines().count() == 1 && said.contains("one place needs"), "{said}");
    let size = said.split("give --cache ").nth(1).and_then(|rest| rest.split("KiB").next()).expect(&said);
    size.parse().unwrap()
}

#[test]
fn a_scan_larger_than_the_cache_has_the_same_answers() {
    let folder = folder_with_tables();
    let at = folder.path();
    sound_archive(at, [8, 3, 1], rough_ground);
    // The nine pages around a place in the middle.
    let start = ["--from", "25,9.6,7.5"];
    let few = enough(&with_cache(at, "reach", &start, 64));
    // The way leads along the border of two rows of pages.
    for (command, ends) in [("reach", &start[..]), ("route", &["--from", "1,6.4,7.5", "--to", "50,6.4,7.5"])] {
        let [one, other] = [few + few / 16, 1 << 16].map(|cache| {
            let out = with_cache(at, command, ends, cache);
            assert!(out.status.success(), "{command}, {cache}: {}", String::from_utf8_lossy(&out.stderr));
            let mut found: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
            for key in ["memory_bytes", "seconds"] {
                found[key].take();
            }
            found
        });
        assert_eq!(one, other, "{command}");
        assert!(one["places"].as_u64().is_some_and(|places| places > 80_000) || one["found"] == true, "{one}");
    }
    // With less, no place is known; a walk needs fewer pages at once.
    assert_eq!(enough(&with_cache(at, "reach", &start, few - 1)), few);
    fs::write(at.join("way.csv"), "25,9.6\n25.2,9.6\n").unwrap();
    let walk = ["--start", "25,9.6,7.5", "--waypoints", "way.csv", "--prefetch", "off", "-o", "p.csv"];
    let out = with_cache(at, "walk", &walk, few - 1);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

/// Pages of which an answer does not name all at once: 27, in a cache for some 19.
#[test]
#[ignore = "slow: .ci/run"]
fn a_cache_too_small_for_a_high_place_is_refused() {
    let folder = folder_with_tables();
    sound_archive(folder.path(), [3, 3, 3], rough_ground);
    let start = ["--from", "9.6,9.6,50"];
    let ask = |cache: usize| with_cache(folder.path(), "reach", &start, cache);
    let named = enough(&ask(64));
    assert!(enough(&ask(named + named / 8)) > named);
    assert!(ask(3 * named).status.success());
}

#[test]
fn a_span_of_a_billion_cubes_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan::new(Frame::new(0.001, 1e6).unwrap());
    let mut writer = ArchiveWriter::create(&folder.path().join("a.slices"), &plan, false).unwrap();
    let mut page = PageBuilder::default();
    assert!(page.set_column(0, 0, &[Span::new(0, 255, true).unwrap()]));
    let key = PageKey { tx: 0, ty: 0, layer: 0 };
    writer.put(key, PageEncoder::new(plan.frame).encode(key, &page.build())).unwrap();
    writer.finish(Totals::default()).unwrap();
    for output in ["a.bt", "a.voxel.json"] {
        let arguments = ["export", "a.slices", "-o", output];
        let out = limited(folder.path(), SURFACE_MIB, &arguments);
        is_handled(&arguments, &out);
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(1) && said.contains("extract a region first"), "{said}");
    }
}

/// Seen space of a few hundred bytes, with millions of cells; and a plan of gigabytes.
#[test]
#[ignore = "slow: .ci/run"]
fn little_seen_space_costs_little_whatever_it_claims() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, columns: &[[i32; 2]], layers: u32| {
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let mut writer = ArchiveWriter::create(&folder.path().join(name), &plan, false).unwrap();
        writer.set_seen();
        let mut keys: Vec<_> = columns.iter().map(|&[tx, ty]| PageKey { tx, ty, layer: 0 }).collect();
        keys.sort_unstable();
        for key in keys {
            let mut block = SeenBlock::new(key);
            (0..layers).for_each(|layer| block.push(layer, &SeenPage::ALL));
            writer.put_seen(&block).unwrap();
        }
        writer.finish(Totals::default()).unwrap();
    };
    // Blocks that do not touch.
    write("all.slices", &[[0, 0], [2, 0], [0, 2], [2, 2]], 64);
    write("far.slices", &[[0, 0], [4000, 4000]], 1);
    let out = limited(folder.path(), MEMORY_MIB + CACHE_MIB, &["stats", "all.slices", "--coverage"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let drawn = ["stats", "far.slices", "--coverage", "-o", "p.png"];
    let out = limited(folder.path(), MEMORY_MIB + CACHE_MIB, &drawn);
    is_handled(&drawn, &out);
    assert!(String::from_utf8_lossy(&out.stderr).contains("in all; extract a region first"));
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_large_sound_archive_costs_no_more_than_a_small_one() {
    let tiles = std::env::var("SLICEWALK_BUDGET_TILES").map_or(48, |tiles| tiles.parse().unwrap());
    let folder = folder_with_tables();
    let page = rough_ground(0);
    sound_archive(folder.path(), [tiles, tiles, 1], |_| page.clone());
    let all = ask_everything(folder.path(), "a.slices", |arguments| !holds_its_result(arguments));
    for out in all {
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    }
}
