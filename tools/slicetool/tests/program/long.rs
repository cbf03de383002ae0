//! `--length`: wheelchairs in corridors with a bend, and what no pawn can be.

use crate::house::{House, archive_of, slicetool};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::fs;
use tempfile::TempDir;

/// Points of two corridors of a width with a right angle between them (m): along y, then along x.
fn bend(width: f64) -> Vec<[f64; 3]> {
    let at = |n: i32| f64::from(n) * 0.05 + 0.025;
    let is_in = |x: f64, y: f64| x < width && y < 6.0 || y < width && x < 6.0;
    let near = |x: f64, y: f64| {
        (-1..=1)
            .any(|i| (-1..=1).any(|j| is_in(x + f64::from(i) * 0.05, y + f64::from(j) * 0.05) && x > 0.0 && y > 0.0))
    };
    let all = || (-2..124).flat_map(|i| (-2..124).map(move |j| (i, j)));
    let mut points = Vec::new();
    for (i, j) in all() {
        let (x, y) = (at(i), at(j));
        match x > 0.0 && y > 0.0 && is_in(x, y) {
            true => points.push([x, y, 0.0]),
            false if near(x, y) || x < 0.0 || y < 0.0 => points.extend((0..40).map(|k| [x, y, at(k)])),
            false => {}
        }
    }
    points
}

fn route(folder: &TempDir, options: &[&str]) -> Value {
    let ends = ["a.slices", "--from", "0.55,4.5,0.1", "--to", "4.5,0.55,0.1", "--json"];
    let out = slicetool(folder, "route", &[&ends[..], options].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

const ROUND: [&str; 4] = ["--profile", "wheelchair", "--pawn", "cylinder:0.4x1.4"];

#[test]
fn a_wheelchair_turns_where_there_is_room() {
    let folder = archive_of(bend(1.6));
    let found = route(&folder, &["--profile", "wheelchair", "--length", "1.2", "-o", "r.csv"]);
    assert_eq!(found["found"], Value::from(true), "{found}");
    assert!(found["turned_deg"].as_f64().unwrap() >= 89.9, "{found}");
    let table = fs::read_to_string(folder.path().join("r.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        table.lines().skip(1).map(|row| row.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert!(
        table.starts_with("x,y,z,heading\n") && rows.iter().all(|row| row.len() == 4 && (0.0..360.0).contains(&row[3]))
    );
    // Down the one corridor, to the right along the other.
    assert!((rows[0][3] - 180.0).abs() < 30.0 && (rows[rows.len() - 1][3] - 90.0).abs() < 30.0, "{table}");
    // The rows of a route are waypoints.
    let walk =
        ["a.slices", "--profile", "wheelchair", "--start", "0.55,4.5,0.1", "--waypoints", "r.csv", "-o", "p.csv"];
    assert!(slicetool(&folder, "walk", &walk).status.success());
    route(&folder, &["--profile", "wheelchair", "-o", "r.geojson"]);
    let drawn: Value = serde_json::from_slice(&fs::read(folder.path().join("r.geojson")).unwrap()).unwrap();
    let headings = drawn["features"][0]["properties"]["headings"].as_array().unwrap().len();
    assert_eq!(headings, rows.len());
    // Without --length the columns are those of other pawns; turns have no rows.
    let found = route(&folder, &["--profile", "wheelchair", "-o", "r.csv"]);
    assert!(found["turned_deg"].as_f64().unwrap() >= 89.9, "{found}");
    let table = fs::read_to_string(folder.path().join("r.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert!(
        lines[0] == "x,y,z" && lines.len() < headings && lines.windows(2).all(|pair| pair[0] != pair[1]),
        "{table}"
    );
    let straight = ["a.slices", "--profile", "wheelchair", "--from", "0.55,4.5,0.1", "--to", "0.55,3.5,0.1", "--json"];
    let straight: Value = serde_json::from_slice(&slicetool(&folder, "route", &straight).stdout).unwrap();
    assert_eq!(straight["turned_deg"].to_string(), "0.0", "{straight}");
    // The round pawn has neither the column nor the key.
    let round = route(&folder, &[&ROUND[..], &["-o", "r.csv"]].concat());
    assert!(round.get("turned_deg").is_none(), "{round}");
    assert!(fs::read_to_string(folder.path().join("r.csv")).unwrap().starts_with("x,y,z\n"));
}

#[test]
fn a_bend_too_narrow_for_a_wheelchair_is_named() {
    let folder = archive_of(bend(1.0));
    let found = route(&folder, &["--profile", "wheelchair"]);
    assert_eq!(found["found"], Value::from(false), "{found}");
    let (blocked, number) = (&found["blocked"], |key: &str| found["blocked"][key].as_f64().unwrap());
    assert_eq!(blocked["reason"], Value::from("length"), "{found}");
    assert!((0.8..1.2).contains(&number("needs")) && number("x") < 1.6 && number("y") < 1.6, "{found}");
    // A little shorter, it passes.
    let needs = format!("{}", number("needs"));
    assert_eq!(route(&folder, &["--profile", "wheelchair", "--length", &needs])["found"], Value::from(true));
    assert_eq!(route(&folder, &ROUND)["found"], Value::from(true));
    let area = |options: &[&str]| {
        let from = ["a.slices", "--from", "0.55,4.5,0.1", "--json", "-o", "r.geojson"];
        let out = slicetool(&folder, "reach", &[&from[..], options].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let found: Value = serde_json::from_slice(&out.stdout).unwrap();
        found["area_m2"].as_f64().unwrap()
    };
    let (long, round) = (area(&["--profile", "wheelchair"]), area(&ROUND));
    assert!(long > 0.0 && long < 0.6 * round, "{long} and {round}");
}

#[test]
fn a_start_in_the_air_is_moved_like_one_on_the_floor() {
    // In the outer corner, the pawn has room in no heading.
    let folder = archive_of(bend(1.6));
    let from = |z: &str| {
        let at = format!("0.47,0.47,{z}");
        let options = ["a.slices", "--from", &at, "--profile", "wheelchair", "--length", "1.5", "--json"];
        let out = slicetool(&folder, "reach", &options);
        assert!(out.status.success(), "{z}: {}", String::from_utf8_lossy(&out.stderr));
        let found: Value = serde_json::from_slice(&out.stdout).unwrap();
        found["from"].clone()
    };
    let low = from("0.1");
    assert!(low["moved"].as_f64().is_some_and(|moved| (0.2..0.5).contains(&moved)), "{low}");
    assert_eq!(from("1.1"), low);
}

#[test]
fn doors_wide_enough_let_a_wheelchair_through_all_rooms() {
    for seed in 0..2 {
        let house = House::new(3, seed);
        let folder = archive_of(house.points());
        let from = house.middle(0);
        let from = format!("{},{},0.1", from[0], from[1]);
        let rooms = |options: &[&str]| {
            let out = slicetool(&folder, "reach", &[&["a.slices", "--from", &from, "-o", "r.csv"], options].concat());
            assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
            let table = fs::read_to_string(folder.path().join("r.csv")).unwrap();
            let number = |line: &str| -> Vec<f64> { line.split(',').map(|field| field.parse().unwrap()).collect() };
            let places: Vec<Vec<f64>> = table.lines().skip(1).map(number).collect();
            let is_in = |room: &usize| {
                let [x, y] = house.middle(*room);
                places.iter().any(|place| (place[0] - x).abs() < 0.3 && (place[1] - y).abs() < 0.3)
            };
            (0..9).filter(is_in).collect::<Vec<usize>>()
        };
        assert_eq!(rooms(&["--profile", "wheelchair"]), rooms(&ROUND), "house {seed}");
    }
}

#[test]
fn lengths_that_no_pawn_can_have_are_refused_in_one_line() {
    let folder = archive_of(bend(1.6));
    let ends = ["a.slices", "--from", "0.55,4.5,0.1", "--to", "4.5,0.55,0.1"];
    for (options, code, text) in [
        (&["--length", "1.2"][..], 2, "--length 1.2: only a cylinder can be drawn out"),
        (&["--length", "0.5", "--profile", "wheelchair"], 2, "--length 0.5: the pawn is 0.8 m wide"),
        (&["--length", "1.2", "--profile", "wheelchair", "--coarse"], 2, "leave out --coarse or --length"),
        (&["--max-grade", "6", "--coarse"], 2, "the overview levels do not know --max-grade"),
        (&["--max-ramp", "6", "--coarse"], 2, "the overview levels do not know --max-ramp"),
        (&["--ignore-inferred", "--coarse"], 2, "the overview levels do not know --ignore-inferred"),
        (&["--length", "500", "--profile", "wheelchair"], 2, "--length: 500 m is not allowed"),
        (&["--length", "x"], 2, "--length"),
    ] {
        for command in ["route", "reach"] {
            if command == "reach" && options.contains(&"--coarse") {
                continue;
            }
            let out = slicetool(&folder, command, &[&ends[..], options].concat());
            let said = String::from_utf8(out.stderr).unwrap();
            assert!(out.status.code() == Some(code) && said.contains(text), "{command} {options:?}: {said}");
            assert!(code == 2 || said.lines().count() == 1, "{said}");
        }
    }
}

#[test]
fn the_landing_of_the_real_building_lets_through_only_short_pawns() {
    let Some(scans) = crate::data::folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut options =
        ConvertOptions::new(vec![scans.join("indoor_two_storey_zup.laz")], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor).unwrap();
    let route = |more: &[&str]| {
        let ends = ["a.slices", "--from=-5,-3,-1.2", "--to=-7,-4.5,4.5", "--pawn", "cylinder:0.25x1.6", "--json"];
        let out = slicetool(&folder, "route", &[&ends[..], more].concat());
        serde_json::from_slice::<Value>(&out.stdout).unwrap()
    };
    let (round, long) = (route(&[]), route(&["--length", "1"]));
    let metres = |found: &Value| found["length_m"].as_f64().unwrap();
    assert!(metres(&long) < 1.1 * metres(&round) && long["turned_deg"].as_f64().unwrap() > 180.0, "{round} {long}");
    let stopped = route(&["--length", "1.4"]);
    let number = |key: &str| stopped["blocked"][key].as_f64().unwrap();
    assert_eq!(stopped["blocked"]["reason"], Value::from("length"), "{stopped}");
    assert!((1.0..1.4).contains(&number("needs")) && (number("z") - 1.23).abs() < 0.5, "{stopped}");
}
