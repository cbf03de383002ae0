//! Why there is no route: the place and the value that passes, in scenes with known obstructions.

use scangen::{WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Points of a rectangle of floor.
fn floor([x, to_x]: [f64; 2], [y, to_y]: [f64; 2], z: f64) -> impl Iterator<Item = [f64; 3]> {
    let count = |length: f64| (length / 0.05).round() as i32;
    let step = |from: f64, n: i32| from + f64::from(n) * 0.05 + 0.025;
    let rows = count(to_y - y);
    (0..count(to_x - x)).flat_map(move |i| (0..rows).map(move |j| [step(x, i), step(y, j), z]))
}

/// Points of a wall along y at x = 4, from `bottom` to `top`.
fn wall([y, to_y]: [f64; 2], [bottom, top]: [f64; 2]) -> impl Iterator<Item = [f64; 3]> {
    let count = |length: f64| (length / 0.05).round() as i32;
    let rows = count(top - bottom);
    (0..count(to_y - y)).flat_map(move |j| {
        (0..rows).map(move |k| [4.025, y + f64::from(j) * 0.05 + 0.025, bottom + f64::from(k) * 0.05 + 0.025])
    })
}

fn archive_of(points: Vec<[f64; 3]>) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
    options.pixel = PixelSize::Metres(0.1);
    convert(&options, &NoMonitor).unwrap();
    folder
}

fn slicetool(folder: &TempDir, command: &str, arguments: &[&str]) -> Output {
    let mut slicetool = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    slicetool.current_dir(folder.path()).args([command, "a.slices", "--json"]).args(arguments).output().unwrap()
}

fn route(points: Vec<[f64; 3]>, [from, to]: [&str; 2], options: &[&str]) -> Value {
    let out = slicetool(&archive_of(points), "route", &[&["--from", from, "--to", to], options].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

/// Checks the reason, the value within a tolerance, and that the place is near the wall at x = 4 and at `y`.
fn check(found: &Value, reason: &str, needs: f64, within: f64, y: Option<[f64; 2]>) {
    assert_eq!(found["found"], Value::from(false), "{found}");
    let blocked = &found["blocked"];
    assert_eq!(blocked["reason"], Value::from(reason), "{found}");
    let number = |key: &str| blocked[key].as_f64().unwrap();
    assert!((number("needs") - needs).abs() <= within, "{needs}: {found}");
    assert!((2.5..=4.3).contains(&number("x")), "{found}");
    if let Some([low, high]) = y {
        assert!((low..=high).contains(&number("y")), "{found}");
    }
}

const ENDS: [&str; 2] = ["1,3,0.1", "7,3,0.1"];

#[test]
fn a_narrow_door_a_low_lintel_and_a_high_step_are_named() {
    let ground = || floor([0.0, 8.0], [0.0, 6.0], 0.0);
    // A door from y = 2 to 2.7, another one 0.4 m wide.
    let narrow =
        || wall([0.0, 2.0], [0.0, 2.5]).chain(wall([2.7, 5.0], [0.0, 2.5])).chain(wall([5.4, 6.0], [0.0, 2.5]));
    let found = route(ground().chain(narrow()).collect(), ENDS, &["--pawn", "box:0.9x0.9x1.8"]);
    check(&found, "width", 0.7, 0.11, Some([1.8, 2.9]));
    assert_eq!(route(ground().chain(narrow()).collect(), ENDS, &["--pawn", "box:0.5x0.5x1.8"])["blocked"], Value::Null);

    let lintel = wall([0.0, 2.0], [0.0, 2.5]).chain(wall([2.0, 3.2], [1.5, 2.5])).chain(wall([3.2, 6.0], [0.0, 2.5]));
    let found = route(ground().chain(lintel).collect(), ENDS, &[]);
    check(&found, "headroom", 1.5, 0.05, Some([1.8, 3.4]));

    let stage = floor([0.0, 4.0], [0.0, 6.0], 0.0).chain(floor([4.0, 8.0], [0.0, 6.0], 0.5));
    let riser = wall([0.0, 6.0], [0.0, 0.5]);
    let found = route(stage.chain(riser).collect(), ["1,3,0.1", "7,3,0.6"], &[]);
    check(&found, "step", 0.5, 0.03, None);
}

#[test]
fn the_least_of_two_changes_is_the_reason() {
    // A door for which the pawn is 0.2 m too wide, and one for which it is 0.1 m too high.
    let ground = floor([0.0, 8.0], [0.0, 6.0], 0.0);
    let walls = wall([0.0, 1.0], [0.0, 2.5])
        .chain(wall([1.7, 3.0], [0.0, 2.5]))
        .chain(wall([3.0, 4.5], [1.7, 2.5]))
        .chain(wall([4.5, 6.0], [0.0, 2.5]));
    let found = route(ground.chain(walls).collect(), ENDS, &["--pawn", "box:0.9x0.9x1.8"]);
    check(&found, "headroom", 1.7, 0.05, Some([2.8, 4.7]));
}

#[test]
fn a_ramp_too_steep_for_a_wheelchair_is_named() {
    // Level, 5 m of ramp, level.
    let ramp = |grade: f64| {
        floor([0.0, 12.0], [0.0, 3.0], 0.0).map(move |[x, y, _]| [x, y, (x - 3.0).clamp(0.0, 5.0) * grade]).collect()
    };
    let steep = ["1,1.5,0.1", "11,1.5,0.5"];
    assert_eq!(
        route(ramp(0.04), ["1,1.5,0.1", "11,1.5,0.3"], &["--profile", "wheelchair"])["found"],
        Value::from(true)
    );
    assert_eq!(route(ramp(0.09), steep, &["--profile", "stroller"])["found"], Value::from(true));
    assert_eq!(route(ramp(0.09), steep, &[])["found"], Value::from(true));
    for options in
        [&["--profile", "wheelchair"][..], &["--max-grade", "7"], &["--profile", "stroller", "--max-grade", "5"]]
    {
        check(&route(ramp(0.09), steep, options), "slope", 9.0, 0.4, None);
    }
    let folder = archive_of(ramp(0.09));
    let area = |options: &[&str]| {
        let out = slicetool(&folder, "reach", &[&["--from", "1,1.5,0.1"], options].concat());
        let found: Value = serde_json::from_slice(&out.stdout).unwrap();
        found["area_m2"].as_f64().unwrap()
    };
    // Half a metre to each side, the ground 0.2 m up the ramp rises by 6 %: 3.2 × 3 m are reached.
    let wheelchair = area(&["--profile", "wheelchair", "--pawn", "box:0.1x0.1x1.4"]);
    assert!((9.0..10.2).contains(&wheelchair) && area(&["--pawn", "box:0.1x0.1x1.4"]) > 35.0, "{wheelchair}");
    // The walker stops on the ramp.
    std::fs::write(folder.path().join("w.csv"), "x,y\n11,1.5\n").unwrap();
    let walk = ["--start", "1,1.5,0.1", "--waypoints", "w.csv", "-o", "p.csv"];
    let out = slicetool(&folder, "walk", &[&walk[..], &["--max-grade", "6"]].concat());
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    let x = found["end"][0].as_f64().unwrap();
    assert!(out.status.code() == Some(1) && found["stop"] == "steep" && (3.0..4.3).contains(&x), "{found}");
    assert!(slicetool(&folder, "walk", &[&walk[..], &["--max-grade", "10"]].concat()).status.success());
    // A step of 5 cm stops a wheelchair, whatever the grade.
    let step =
        || floor([0.0, 12.0], [0.0, 3.0], 0.0).map(|[x, y, _]| [x, y, if x < 4.0 { 0.0 } else { 0.05 }]).collect();
    let ends = ["1,1.5,0.1", "11,1.5,0.1"];
    let found = route(step(), ends, &["--profile", "wheelchair"]);
    assert_eq!(found["found"], Value::from(false));
    assert_eq!(route(step(), ends, &["--profile", "stroller"])["found"], Value::from(true));
}

#[test]
fn missing_ground_is_a_gap_or_unseen() {
    let islands = || floor([0.0, 4.0], [0.0, 6.0], 3.0).chain(floor([5.5, 8.0], [0.0, 6.0], 3.0));
    let ends = ["1,3,3.1", "7,3,3.1"];
    check(&route(islands().collect(), ends, &[]), "unseen", 1.5, 0.5, None);
    let below = islands().chain(floor([4.0, 5.5], [0.0, 6.0], 0.0));
    check(&route(below.collect(), ends, &[]), "gap", 1.5, 0.5, None);
}
