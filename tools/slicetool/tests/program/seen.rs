//! Seen space in answers: queries, routes, pictures, exports.

use crate::cubes::leaves_of_octomap;
use scangen::sample::{Mode, ScannerSpec};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::seen::SeenSpace;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const PIXEL_M: f64 = 0.1;

/// A storey of a house in which all surfaces were scanned, but only one station looked around, in the west room.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::named("house", &Params::new().with("storeys", 1.0)).unwrap();
    let at = scene.stations()[0];
    let scanner = ScannerSpec { stations: vec![at], mixed_rate: 0.0, ..ScannerSpec::default() };
    let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(200_000) };
    // What lies behind other surfaces makes nothing seen.
    let seen = scene.points(1, &spec).unwrap();
    let points: Vec<_> = seen.chain(scene.points(2, &SampleSpec::direct_density(300.0)).unwrap()).collect();
    let scan = folder.path().join("scan.las");
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let stations = folder.path().join("stations.csv");
    fs::write(&stations, format!("file,x,y,z\nscan.las,{},{},{}\n", at[0], at[1], at[2])).unwrap();
    for (name, free_space) in [("a.slices", true), ("plain.slices", false)] {
        let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join(name));
        options.grid.pixel = PixelSize::Metres(PIXEL_M);
        options.sections.free_space = free_space;
        options.stations = free_space.then(|| stations.clone());
        convert(&options, &NoMonitor).unwrap();
    }
    folder
}

fn tool(folder: &Path, arguments: &[&str], input: &str) -> Output {
    let program = env!("CARGO_BIN_EXE_slicetool");
    let mut command = Command::new(program);
    command.current_dir(folder).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut running = command.spawn().unwrap();
    running.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    running.wait_with_output().unwrap()
}

fn answer(folder: &Path, arguments: &[&str], input: &str) -> String {
    let out = tool(folder, arguments, input);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn space(folder: &Path) -> SeenSpace {
    Archive::open(folder.join("a.slices")).unwrap().seen_space(1 << 30).unwrap().unwrap()
}

#[test]
fn queries_say_last_what_was_seen_where_the_archive_stores_it() {
    let folder = folder();
    let at = folder.path();
    // In the room of the station; behind its wall; beside a wall.
    let boxes = "0.9,3.25,1.25,1.1,3.5,1.45\n7,1.4,1.3,7.2,1.6,1.45\n0,3,1,0.2,3.2,1.4\n";
    let said = answer(at, &["query", "a.slices", "--boxes", "-"], boxes);
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines[0], "xmin,ymin,zmin,xmax,ymax,zmax,hit,obstacle,floor_z,seen");
    let seen: Vec<&str> = lines[1..].iter().map(|line| line.rsplit(',').next().unwrap()).collect();
    assert_eq!(seen, ["1", "0", "0"]);
    // To the wall of the room, through the hall that nobody saw, and across the room without a hit.
    let rays = "1.5,3.5,1.6,-1,0,0,9\n7,8.5,1.6,0,-1,0,9\n3.3,3.4,1.65,1,0,0,0.6\n";
    let said = answer(at, &["query", "a.slices", "--rays", "-"], rays);
    assert!(said.starts_with("x,y,z,dx,dy,dz,max,hit,distance,nx,ny,nz,seen\n"), "{said}");
    let ends: Vec<[&str; 2]> = said
        .lines()
        .skip(1)
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            [fields[7], fields[12]]
        })
        .collect();
    assert_eq!(ends, [["1", "1"], ["1", "0"], ["0", "1"]], "{said}");
    let said = answer(at, &["query", "plain.slices", "--boxes", "-"], boxes);
    assert!(said.starts_with("xmin,ymin,zmin,xmax,ymax,zmax,hit,obstacle,floor_z\n"), "{said}");
    let info: Value = serde_json::from_str(&answer(at, &["info", "a.slices", "--json"], "")).unwrap();
    assert_eq!(info["seen"]["cells"], space(at).cells());
    let bytes = |path: &str| {
        let info: Value = serde_json::from_str(&answer(at, &["info", path, "--json"], "")).unwrap();
        (info["bytes"]["tiles"].as_u64(), info["bytes"]["file"].as_u64().unwrap(), info["seen"]["bytes"].as_u64())
    };
    let (with, without) = (bytes("a.slices"), bytes("plain.slices"));
    assert_eq!((with.0, with.1 - with.2.unwrap(), None), (without.0, without.1, without.2));
}

#[test]
fn routes_can_stay_in_seen_space_and_say_where_it_ends() {
    let folder = folder();
    let at = folder.path();
    let ends = ["--from", "1.5,3.5,0.5", "--to", "8.5,8.8,0.5", "--json"];
    let route = |archive: &str, more: &[&str]| -> Value {
        serde_json::from_str(&answer(at, &[&["route", archive][..], &ends, more].concat(), "")).unwrap()
    };
    assert_eq!(route("a.slices", &[])["found"], true);
    // The end moves to where the pawn was seen, if it is near; here it is not.
    let there = route("a.slices", &["--seen"]);
    assert_eq!((&there["found"], &there["reason"]), (&false.into(), &"not_standing_to".into()), "{there}");
    let near = ["route", "a.slices", "--from", "1.5,3.5,0.5", "--to", "1.3,3.3,0.5", "--json", "--seen"];
    let near: Value = serde_json::from_str(&answer(at, &near, "")).unwrap();
    assert_eq!(near["found"], true, "{near}");
    let area = |more: &[&str]| {
        let asked = ["reach", "a.slices", "--from", "1.5,3.5,0.5", "--json"];
        let found: Value = serde_json::from_str(&answer(at, &[&asked[..], more].concat(), "")).unwrap();
        found["area_m2"].as_f64().unwrap()
    };
    let (all, seen) = (area(&[]), area(&["--seen"]));
    assert!(all > 60.0 && seen > 0.1 && seen < 0.6 * all, "{seen} of {all} m²");
    let out = tool(at, &["reach", "plain.slices", "--from", "1.5,3.5,0.5", "--seen"], "");
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code() == Some(1) && said.lines().count() == 1 && said.contains("--free-space"), "{said}");
}

#[test]
fn seen_space_beyond_the_cache_asks_for_more_of_it() {
    let folder = folder();
    let at = folder.path();
    // A page of seen space takes 2 KiB; the table of the archive's pages, 3,093 bytes.
    for (arguments, limit) in [
        (&["query", "a.slices", "--boxes", "-", "--cache", "3000"][..], "1500"),
        (&["reach", "a.slices", "--from", "1.5,3.5,0.5", "--seen", "--cache", "3500"], "3500"),
        (&["export", "a.slices", "-o", "map.yaml", "--cache", "3500"], "3500"),
    ] {
        let out = tool(at, arguments, "");
        let said = String::from_utf8(out.stderr).unwrap();
        let end = format!(" is beyond the limit of {limit}; give more --cache\n");
        assert!(out.status.code() == Some(1) && said.contains("seen space") && said.ends_with(&end), "{said}");
    }
}

#[test]
fn octrees_have_free_cubes_and_maps_unknown_ground() {
    let folder = folder();
    let at = folder.path();
    answer(at, &["export", "a.slices", "-o", "a.bt"], "");
    answer(at, &["export", "plain.slices", "-o", "plain.bt"], "");
    let ([free, occupied], ..) = leaves_of_octomap(&fs::read(at.join("a.bt")).unwrap());
    let ([none, plain], ..) = leaves_of_octomap(&fs::read(at.join("plain.bt")).unwrap());
    assert!(none.is_empty() && plain == occupied);
    let space = space(at);
    let middle = |cube: [i64; 3]| nalgebra::Point3::from(cube.map(|v| (v as f64 + 0.5) * PIXEL_M));
    let (low, high) = ([-10, -10, -10], [160, 120, 50]);
    let mut expected = BTreeSet::new();
    for x in low[0]..high[0] {
        for y in low[1]..high[1] {
            expected.extend((low[2]..high[2]).map(|z| [x, y, z]).filter(|cube| space.is_seen(middle(*cube))));
        }
    }
    let expected: BTreeSet<_> = expected.difference(&occupied).copied().collect();
    assert!(free == expected && free.len() > 10_000, "{} of {}", free.len(), expected.len());
    let counts = |archive: &str| {
        answer(at, &["export", archive, "-o", "map.yaml", "--storey", "0"], "");
        let image = fs::read(at.join("map.pgm")).unwrap();
        [254, 205, 0].map(|grey| image.iter().filter(|sample| **sample == grey).count())
    };
    let (with, without) = (counts("a.slices"), counts("plain.slices"));
    assert!(with[0] > 500 && with[0] < without[0] / 2 && with[1] > without[1], "{with:?} {without:?}");
    assert!(with[2].abs_diff(without[2]) <= 1, "{with:?} {without:?}");
}

#[test]
fn pictures_show_seen_space() {
    let folder = folder();
    let at = folder.path();
    answer(at, &["show", "a.slices", "--z", "1.4", "--seen", "-o", "a.png"], "");
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(at.join("a.png")).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let seen = pixels.chunks(3).filter(|pixel| **pixel == [0, 0, 96]).count();
    assert!(seen > 1000, "{seen}");
    let out = tool(at, &["show", "plain.slices", "--z", "1.4", "--seen", "-o", "b.png"], "");
    assert_eq!(out.status.code(), Some(1));
    assert!(!at.join("b.png").exists());
}

#[test]
fn the_next_station_stands_where_seen_space_ends() {
    let folder = folder();
    let at = folder.path();
    let report: Value = serde_json::from_str(&answer(at, &["stats", "a.slices", "--coverage", "--json"], "")).unwrap();
    assert_eq!(report["seen"]["cells"], space(at).cells());
    let first = &report["next"][0];
    let value = |key: &str| first[key].as_f64().unwrap();
    // The hall was seen through the door of the west room alone, which ends at x = 5.
    assert!(value("x") > 4.0 && (1.2..2.0).contains(&value("z")) && value("share") > 0.3, "{report:#}");
    assert!(report["border_m2"].as_f64().unwrap() > 1.0);
    let said = answer(at, &["stats", "a.slices", "--coverage", "-o", "plan.png"], "");
    assert!(said.contains("station 1: ") && at.join("plan.png").exists(), "{said}");
    let volume = report["seen"]["m3"].as_f64().unwrap().round();
    assert!(said.contains(&format!(", {volume} m³; ")), "{said}");
    let out = tool(at, &["stats", "plain.slices", "--coverage"], "");
    assert_eq!(out.status.code(), Some(1));
    let out = tool(at, &["stats", "a.slices", "--coverage", "--json", "-o", "-"], "");
    assert!(out.status.code() == Some(2) && out.stdout.is_empty(), "a picture and JSON into one stream");
}
