//! `slicetool walk` from a user's view: files, summary, exit codes; and the route through a real building.

use crate::data;

use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::{ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn slicetool(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).args(arguments).output().unwrap()
}

fn to_archive(scan: PathBuf, dir: &Path) -> PathBuf {
    let archive = dir.join("scene.slices");
    let mut options = ConvertOptions::new(vec![scan], archive.clone());
    options.grid.pixel = PixelSize::Metres(0.05);
    options.reading.units = Units::Factor(1.0);
    options.resources.threads = 1;
    options.resources.temp_dir = dir.to_path_buf();
    convert(&options, &NoMonitor).unwrap();
    archive
}

/// Converts stairs of four risers of 17 cm between two landings of 4 m.
fn stairs(dir: &Path) -> PathBuf {
    let scene = Scene::named("stairs", &Params::new().with("risers", 4.0).with("landing", 4.0)).unwrap();
    let scan = dir.join("stairs.las");
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(3600.0) };
    write_samples(&scan, scene.samples(5, &spec).unwrap(), &WriteSpec::for_path(&scan)).unwrap();
    to_archive(scan, dir)
}

struct Row {
    t: f64,
    feet: [f64; 3],
    state: String,
    frame_us: f64,
    missing: u64,
}

fn rows(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t,x,y,z,state,frame_us,missing"));
    lines
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            assert_eq!(fields.len(), 7, "{line}");
            let number = |at: usize| fields[at].parse::<f64>().unwrap();
            Row {
                t: number(0),
                feet: [number(1), number(2), number(3)],
                state: fields[4].to_owned(),
                frame_us: number(5),
                missing: fields[6].parse().unwrap(),
            }
        })
        .collect()
}

#[test]
fn a_walk_up_the_stairs_arrives_and_is_written_down() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, out) = (stairs(dir.path()), dir.path().join("path.csv"));
    let (archive, out_text) = (archive.to_str().unwrap(), out.to_str().unwrap());
    for (n, waypoints) in ["x,y\n2.5,0\n", "2.5,0\n", "\u{feff}# a note\ny,z,x\n0,9,2.5\n"].into_iter().enumerate() {
        let file = dir.path().join(format!("w{n}.csv"));
        std::fs::write(&file, waypoints).unwrap();
        let done = slicetool(&[
            "walk",
            archive,
            "--start",
            "-2,0.1,0",
            "--waypoints",
            file.to_str().unwrap(),
            "-o",
            out_text,
            "--json",
            "--hz",
            "30",
        ]);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let rows = rows(&out);
        let last = rows.last().unwrap();
        assert_eq!(last.state, "arrived");
        assert!((last.feet[0] - 2.5).abs() < 0.02 && (last.feet[2] - 0.68).abs() < 0.002, "{:?}", last.feet);
        for (n, row) in rows.iter().enumerate() {
            assert!((row.t - (n + 1) as f64 / 30.0).abs() < 1e-5 && row.frame_us >= 0.0);
            assert!(["walking", "arrived"].contains(&&*row.state), "{}", row.state);
            assert_eq!(row.missing, 0, "pages are loaded ahead");
        }
        let summary: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        assert_eq!(summary["frames"], rows.len());
        assert_eq!(summary["state"], "arrived");
        for key in ["seconds", "distance", "reads", "bytes", "hits", "late", "cache_peak"] {
            assert!(summary[key].is_number(), "{key}: {summary}");
        }
        let times = &summary["frame_us"];
        let at = |key: &str| times[key].as_f64().unwrap();
        assert!(at("p50") <= at("p99") && at("p99") <= at("p99.9") && at("p99.9") <= at("max"));
        assert_eq!(summary["late"], 0);
        assert!(summary["cache_peak"].as_u64() <= summary["cache"].as_u64());
    }
}

#[test]
fn without_prefetch_there_are_misses_and_the_path_is_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let archive = stairs(dir.path());
    let file = dir.path().join("w.csv");
    std::fs::write(&file, "3.5,0.5\n-3,0\n").unwrap();
    let walk = |prefetch: &str, cache: &str| {
        let out = dir.path().join(format!("path-{prefetch}-{cache}.csv"));
        let done = slicetool(&[
            "walk",
            archive.to_str().unwrap(),
            "--start",
            "-3.5,0,0",
            "--waypoints",
            file.to_str().unwrap(),
            "--prefetch",
            prefetch,
            "--cache",
            cache,
            "-o",
            out.to_str().unwrap(),
        ]);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        rows(&out)
    };
    let (on, off) = (walk("on", "64MiB"), walk("off", "64MiB"));
    assert_eq!(on.iter().map(|row| row.missing).sum::<u64>(), 0);
    assert!(off.iter().map(|row| row.missing).sum::<u64>() > 0);
    assert_eq!(on.len(), off.len());
    for (a, b) in on.iter().zip(&off) {
        assert_eq!((a.feet, &a.state), (b.feet, &b.state));
    }
    // A cache too small for the table of pages, or for one step: the error states a sufficient size.
    let refused = |cache: &str| {
        let out = dir.path().join("none.csv");
        let mut arguments = vec!["walk", archive.to_str().unwrap(), "--start", "-3.5,0,0", "--prefetch", "off"];
        arguments.extend(["--waypoints", file.to_str().unwrap(), "--cache", cache, "-o", out.to_str().unwrap()]);
        let done = slicetool(&arguments);
        assert!(done.status.code() == Some(1) && !out.exists(), "{cache}");
        String::from_utf8(done.stderr).unwrap()
    };
    assert!(refused("1KiB").contains("1024 bytes are too few: the table of"), "{}", refused("1KiB"));
    let said = refused("60KiB");
    let enough = said.split("give --cache ").nth(1).and_then(|rest| rest.split("KiB").next()).expect(&said);
    let enough: usize = enough.parse().unwrap();
    assert!(said.contains("one step needs") && (60..4096).contains(&enough), "{said}");
    // Steps elsewhere need slightly more.
    assert_eq!(walk("off", &format!("{}KiB", 2 * enough)).last().unwrap().state, "arrived");
}

#[test]
fn a_scan_too_high_for_standing_places_is_walked_all_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, way, out) = (dir.path().join("a.slices"), dir.path().join("w.csv"), dir.path().join("path.csv"));
    let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
    let mut floor = PageBuilder::default();
    for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
        assert!(floor.set_column(x, y, &[Span::new(0, 10, false).unwrap()]));
    }
    let page = floor.build();
    let (mut writer, mut encoder) =
        (ArchiveWriter::create(&archive, &plan, false).unwrap(), PageEncoder::new(plan.frame));
    // The floor, and something 672 km above it.
    for layer in [0, 70_000] {
        let key = PageKey { tx: 0, ty: 0, layer };
        writer.put(key, encoder.encode(key, &page)).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    std::fs::write(&way, "2,2\n").unwrap();
    let archive = archive.to_str().unwrap();
    let walk = ["walk", archive, "--start", "1,1,0.1", "--waypoints", way.to_str().unwrap()];
    let done = slicetool(&[&walk[..], &["-o", out.to_str().unwrap()]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(rows(&out).last().unwrap().state, "arrived");
    let done = slicetool(&["reach", archive, "--from", "1,1,0.1"]);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.code() == Some(1) && said.contains("extract a region first"), "{said}");
}

/// A pawn of 800 m beside a mast, in pages of 0.64 m: an answer names a few of those that it misses.
#[test]
fn a_step_that_needs_more_pages_than_any_answer_names_is_walked() {
    const LAYERS: i32 = 1300;
    let dir = tempfile::tempdir().unwrap();
    let (archive, way, out) = (dir.path().join("a.slices"), dir.path().join("w.csv"), dir.path().join("path.csv"));
    let plan = Plan::new(Frame::new(0.1, 0.01).unwrap());
    let page = |has_floor: bool| {
        let mut builder = PageBuilder::default();
        for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            let span = match (x, y) {
                (60, 60) => Span::new(0, 16_319, true),
                _ if has_floor => Span::new(0, 0, false),
                _ => continue,
            };
            assert!(builder.set_column(x, y, &[span.unwrap()]));
        }
        builder.build()
    };
    let (floor, mast) = (page(true), page(false));
    let (mut writer, mut encoder) =
        (ArchiveWriter::create(&archive, &plan, false).unwrap(), PageEncoder::new(plan.frame));
    for layer in 0..LAYERS {
        let key = PageKey { tx: 0, ty: 0, layer };
        writer.put(key, encoder.encode(key, if layer == 0 { &floor } else { &mast })).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    std::fs::write(&way, "2.3,2\n").unwrap();
    let walk = ["walk", archive.to_str().unwrap(), "--start", "2,2,0", "--waypoints", way.to_str().unwrap()];
    let pawn = ["--pawn", "box:0.5x0.5x800", "--snap", "0", "--prefetch", "off", "--json"];
    let done = slicetool(&[&walk[..], &pawn, &["-o", out.to_str().unwrap()]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    let late = found["late"].as_u64().unwrap();
    assert!(found["state"] == "arrived" && (1025..=u64::from(LAYERS.unsigned_abs())).contains(&late), "{found}");
}

#[test]
fn a_blocked_pawn_ends_after_two_seconds_and_a_slow_one_after_the_time_given() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, out) = (stairs(dir.path()), dir.path().join("path.csv"));
    let file = dir.path().join("w.csv");
    std::fs::write(&file, "2.5,0\n").unwrap();
    let walk = |more: &[&str]| {
        let mut arguments = vec!["walk", archive.to_str().unwrap(), "--start", "-2,0,0", "-o", out.to_str().unwrap()];
        arguments.extend(["--waypoints", file.to_str().unwrap()]);
        arguments.extend(more);
        slicetool(&arguments)
    };
    let run = |more: &[&str]| {
        let done = walk(more);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        rows(&out)
    };
    // The path is written, and the command fails with a reason.
    let done = walk(&["--climb", "0.1", "--json"]);
    let said = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(
        said.lines().count() == 1 && said.contains("scene.slices: blocked at (") && said.contains("a wall"),
        "{said}"
    );
    let summary: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((&summary["state"], &summary["stop"]), (&"blocked".into(), &"wall".into()));
    let blocked = rows(&out);
    let tail = blocked.iter().rev().take_while(|row| row.state == "blocked").count();
    assert_eq!(tail, 120);
    assert!(blocked.last().unwrap().feet[2] < 0.01);
    let slow = run(&["--speed", "0.05", "--max-seconds", "3"]);
    assert_eq!((slow.len(), &*slow.last().unwrap().state), (180, "walking"));
    let round = run(&["--pawn", "cylinder:0.3x1.7", "--hz", "60"]);
    assert_eq!(round.last().unwrap().state, "arrived");
    let thesis = run(&["--response", "thesis"]);
    assert_eq!(thesis.last().unwrap().state, "arrived");
}

/// Frames longer than the library's longest step lose no time: the pawn walks every second of them.
#[test]
fn few_frames_a_second_walk_as_far_as_many() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, out) = (stairs(dir.path()), dir.path().join("path.csv"));
    let file = dir.path().join("w.csv");
    std::fs::write(&file, "2.5,0\n").unwrap();
    let run = |hz: &str, prefetch: &str| {
        let mut arguments = vec!["walk", archive.to_str().unwrap(), "--start", "-2,0,0", "-o", out.to_str().unwrap()];
        arguments.extend(["--waypoints", file.to_str().unwrap(), "--hz", hz, "--prefetch", prefetch]);
        arguments.extend(["--speed", "0.25", "--max-seconds", "16"]);
        let done = slicetool(&arguments);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        rows(&out)
    };
    let often = run("60", "on");
    for (hz, prefetch) in [("0.25", "on"), ("0.5", "off"), ("0.625", "on")] {
        for row in run(hz, prefetch) {
            let there = often.iter().find(|other| (other.t - row.t).abs() < 1.0 / 120.0).unwrap();
            let gap = (0..3).map(|axis| (row.feet[axis] - there.feet[axis]).abs()).fold(0.0, f64::max);
            assert!(gap < 0.01, "{hz} Hz, {prefetch}: {gap} m apart at {} s", row.t);
        }
    }
}

#[test]
fn a_reader_of_messages_that_has_gone_ends_no_walk() {
    let dir = tempfile::tempdir().unwrap();
    let (archive, out) = (stairs(dir.path()), dir.path().join("path.csv"));
    let file = dir.path().join("w.csv");
    std::fs::write(&file, "-1,0\n").unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let status = Command::new(env!("CARGO_BIN_EXE_slicetool"))
        .args(["walk", archive.to_str().unwrap(), "--start", "-2,0,0", "-o", out.to_str().unwrap()])
        .args(["--waypoints", file.to_str().unwrap()])
        .stderr(writer)
        .status()
        .unwrap();
    assert!(status.success(), "{status}");
    assert_eq!(rows(&out).last().unwrap().state, "arrived");
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let archive = stairs(dir.path());
    let file = dir.path().join("w.csv");
    std::fs::write(&file, "x,y\n1,oops\n").unwrap();
    let out = dir.path().join("path.csv");
    let base = ["walk", archive.to_str().unwrap(), "--waypoints", file.to_str().unwrap(), "-o", out.to_str().unwrap()];
    let run = |more: &[&str]| slicetool(&[&base[..], more].concat());
    for wrong in [
        &["--start", "1,2"][..],
        &["--start", "0,0,0", "--pawn", "box:1x1"],
        &["--start", "0,0,0", "--pawn", "cone:1x1"],
        &["--start", "0,0,0", "--hz", "0"],
        &["--start", "0,0,0", "--cache", "lots"],
        &["--start", "1e300,0,0"],
        &["--start", "0,0,0", "--speed", "2000"],
        &["--start", "0,0,0", "--speed=-1"],
        &["--start", "0,0,0", "--speed", "nan"],
        &["--start", "0,0,0", "--climb", "2"],
        &["--start", "0,0,0", "--climb=-0.1"],
        &["--start", "0,0,0", "--max-drop", "-1"],
        &["--start", "0,0,0", "--pawn", "box:1x1xinf"],
        &["--start", "0,0,0", "--pawn", "box:0.5x0.5x1001", "--climb", "0"],
    ] {
        assert_eq!(run(wrong).status.code(), Some(2), "{wrong:?}");
    }
    let done = run(&["--start", "0,0,0"]);
    assert_eq!(done.status.code(), Some(1));
    let text = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(text.contains("line 2") && text.contains("oops") && text.lines().count() == 1, "{text}");
    assert!(!out.exists());
    std::fs::write(&file, "1,1\n").unwrap();
    let empty = run(&["--start", "0,0,0", "--cache", "0"]);
    let said = String::from_utf8_lossy(&empty.stderr).into_owned();
    assert!(empty.status.code() == Some(2) && said.contains("--cache: 0 bytes"), "{said}");
    let before = std::fs::read(&archive).unwrap();
    let same = archive.to_str().unwrap();
    let done = slicetool(&["walk", same, "--waypoints", file.to_str().unwrap(), "--start", "0,0,0", "-o", same]);
    assert_eq!(done.status.code(), Some(1), "the archive is no place for the path");
    assert_eq!(std::fs::read(&archive).unwrap(), before);
}

/// A corner at which a cylinder once circled the same edges forever, and caches too small for one step.
#[test]
fn a_pawn_in_a_corner_of_the_real_building_is_blocked() {
    let Some(scan) = data::file("indoor_two_storey_zup.laz") else { return };
    let dir = tempfile::tempdir().unwrap();
    let archive = to_archive(scan, dir.path());
    let (out, file) = (dir.path().join("path.csv"), dir.path().join("w.csv"));
    std::fs::write(&file, "-1.8775,-8.5676\n").unwrap();
    let run = |more: &[&str]| {
        let mut arguments = vec!["walk", archive.to_str().unwrap(), "--start", "0.1669,-3.1211,-1.32"];
        arguments.extend(["--waypoints", file.to_str().unwrap(), "-o", out.to_str().unwrap()]);
        arguments.extend(["--pawn", "cylinder:0.25x1.8", "--climb", "0.2"]);
        arguments.extend(more);
        let done = slicetool(&arguments);
        let said = String::from_utf8(done.stderr).unwrap();
        assert!(done.status.code() == Some(1) && said.lines().count() == 1, "{more:?}: {said}");
        said
    };
    for prefetch in ["on", "off"] {
        for cache in ["60KiB", "100KiB", "300KiB"] {
            let said = run(&["--prefetch", prefetch, "--cache", cache]);
            assert!(said.contains("one step needs") && said.contains("give --cache") && !out.exists(), "{said}");
        }
    }
    let said = run(&[]);
    assert!(said.contains("blocked at"), "{said}");
    assert!(rows(&out).len() < 60 * 10, "{said}");
}

#[test]
fn the_documented_route_leads_through_the_real_building_and_back() {
    let Some(scan) = data::file("indoor_two_storey_zup.laz") else { return };
    let dir = tempfile::tempdir().unwrap();
    let archive = to_archive(scan, dir.path());
    let route = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/route-indoor.csv");
    for pawn in ["box:0.5x0.5x1.6", "cylinder:0.25x1.6"] {
        let out = dir.path().join("path.csv");
        let done = slicetool(&[
            "walk",
            archive.to_str().unwrap(),
            "--start",
            "-5,-3,-1.2",
            "--waypoints",
            route.to_str().unwrap(),
            "--pawn",
            pawn,
            "--cache",
            "16MiB",
            "-o",
            out.to_str().unwrap(),
        ]);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let rows = rows(&out);
        assert_eq!(rows.last().unwrap().state, "arrived", "{pawn}");
        let heights: Vec<f64> = rows.iter().map(|row| row.feet[2]).collect();
        let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(a, b), z| (a.min(*z), b.max(*z)));
        assert!((-1.35..-1.1).contains(&low) && (4.4..4.6).contains(&high), "{pawn}: from {low} to {high}");
        assert!((heights[heights.len() - 1] - heights[0]).abs() < 0.05, "{pawn}");
        for (n, row) in rows.iter().enumerate() {
            assert!(row.missing == 0 && row.state != "falling" && row.state != "blocked", "{pawn}: at {} s", row.t);
            // No jump: at most a riser up, and no faster than walking speed.
            let before = rows[n.saturating_sub(1)].feet;
            assert!((row.feet[2] - before[2]).abs() < 0.25, "{pawn}: at {} s", row.t);
            assert!(
                (row.feet[0] - before[0]).hypot(row.feet[1] - before[1]) < 1.5 / 60.0 + 0.01,
                "{pawn}: {} s",
                row.t
            );
        }
    }
}

/// The stair leads over the floor on which the pawn starts, and what stops it is on the stair.
#[test]
fn a_pawn_too_high_for_the_stair_of_the_real_building_is_stopped_at_its_landing() {
    let Some(scan) = data::file("indoor_two_storey_zup.laz") else { return };
    let dir = tempfile::tempdir().unwrap();
    let archive = to_archive(scan, dir.path());
    let ends = ["--from", "-5,-3,-1.2", "--to", "-7,-4.5,4.5"];
    let route = |more: &[&str]| slicetool(&[&["route", archive.to_str().unwrap()], &ends[..], more].concat());
    let found: Value = serde_json::from_slice(&route(&["--json"]).stdout).unwrap();
    let blocked = &found["blocked"];
    assert_eq!(blocked["reason"], "headroom");
    assert!((1.1..1.4).contains(&blocked["z"].as_f64().unwrap()), "{blocked}");
    // The height in the message passes.
    let said = String::from_utf8(route(&[]).stderr).unwrap();
    let height = said.split("a pawn ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let said = String::from_utf8(route(&["--pawn", &format!("box:0.5x0.5x{height}")]).stderr).unwrap();
    assert!(said.contains(" places"), "{said}");
}
