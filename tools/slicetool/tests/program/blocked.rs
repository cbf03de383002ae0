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
    options.grid.pixel = PixelSize::Metres(0.1);
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
    // Longer than six metres without a landing, and besides too steep.
    let long = |grade: f64| {
        floor([0.0, 14.0], [0.0, 3.0], 0.0).map(move |[x, y, _]| [x, y, (x - 3.0).clamp(0.0, 8.0) * grade]).collect()
    };
    let far = |grade: f64| ["1,1.5,0.1".into(), format!("13,1.5,{}", 8.0 * grade + 0.1)];
    let blocked = |grade: f64| {
        let ends = far(grade);
        route(long(grade), [&ends[0], &ends[1]], &["--profile", "wheelchair"])
    };
    // It gets half of the way that needs a landing.
    let found = blocked(0.055)["blocked"].clone();
    let number = |key: &str| found[key].as_f64().unwrap();
    assert_eq!(found["reason"], Value::from("ramp"));
    assert!((number("needs") - 8.0).abs() < 0.4 && (5.0..6.1).contains(&number("x")), "{found}");
    check(&blocked(0.09), "slope", 9.0, 0.4, None);
    assert_eq!(blocked(0.028)["found"], Value::from(true));
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
    // Nothing is level enough where it starts.
    let start = ["--from", "5.5,1.5,0.3", "--max-grade", "6"];
    for file in ["m.png", "m.csv", "m.ply", "m.geojson"] {
        let out = slicetool(&folder, "reach", &[&start[..], &["-o", file]].concat());
        let found: Value = serde_json::from_slice(&out.stdout).unwrap();
        let nothing = ["area_m2", "places"].iter().all(|key| found[key].as_f64() == Some(0.0));
        assert!(nothing && found["storeys"].as_array().is_some_and(Vec::is_empty), "{file}: {found}");
        let said = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.success() && said.contains("--max-grade") && said.lines().count() == 1, "{file}: {said}");
        assert!(folder.path().join(file).exists(), "{file}");
    }
    let found = route(ramp(0.09), [start[1], "11,1.5,0.5"], &start[2..])["blocked"].clone();
    assert!(found["reason"] == "slope" && (found["x"].as_f64().unwrap() - 5.5).abs() < 0.11, "{found}");
    // The walker stops on the ramp.
    std::fs::write(folder.path().join("w.csv"), "x,y\n11,1.5\n").unwrap();
    let walk = ["--start", "1,1.5,0.1", "--waypoints", "w.csv", "-o", "p.csv"];
    // In the last case, the whole way fits in a frame.
    for hz in ["60", "1", "0.1"] {
        let out = slicetool(&folder, "walk", &[&walk[..], &["--max-grade", "6", "--hz", hz]].concat());
        let found: Value = serde_json::from_slice(&out.stdout).unwrap();
        let x = found["end"][0].as_f64().unwrap();
        let is_stopped = out.status.code() == Some(1) && found["stop"] == "steep";
        assert!(is_stopped && (3.0..4.3).contains(&x), "{hz} Hz: {found}");
    }
    assert!(slicetool(&folder, "walk", &[&walk[..], &["--max-grade", "10"]].concat()).status.success());
    // A step of 5 cm stops a wheelchair, whatever the grade.
    let step =
        || floor([0.0, 12.0], [0.0, 3.0], 0.0).map(|[x, y, _]| [x, y, if x < 4.0 { 0.0 } else { 0.05 }]).collect();
    let ends = ["1,1.5,0.1", "11,1.5,0.1"];
    let found = route(step(), ends, &["--profile", "wheelchair"]);
    assert_eq!(found["found"], Value::from(false));
    assert_eq!(route(step(), ends, &["--profile", "stroller"])["found"], Value::from(true));
}

/// Whether the walker arrives along the route between two places, with the options of the route.
fn arrives(points: Vec<[f64; 3]>, [from, to]: [&str; 2], options: &[&str]) -> bool {
    let folder = archive_of(points);
    let out = slicetool(&folder, "route", &[&["--from", from, "--to", to, "-o", "w.csv"], options].concat());
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(found["found"], Value::from(true), "{found}");
    let start = ["x", "y", "z"].map(|axis| found["from"][axis].to_string()).join(",");
    let out =
        slicetool(&folder, "walk", &[&["--start", &start, "--waypoints", "w.csv", "-o", "p.csv"], options].concat());
    out.status.success()
}

#[test]
fn a_route_keeps_the_limits_of_a_walk() {
    // Across a ridge that is so narrow that the plane around it is less steep than the way along it.
    let ridge = |[x, y, _]: [f64; 3]| {
        let is_ridge = (y - 2.0).abs() < 0.2;
        [x, y, if is_ridge { 0.25 * (1.0 - (x - 4.0).abs()).max(0.0) } else { 0.0 }]
    };
    let thin = ["--pawn", "box:0.1x0.1x1.4", "--climb", "0.35"];
    let ends = ["1.05,2.05,0.1", "7.05,2.05,0.1"];
    let level = floor([0.0, 8.0], [0.0, 4.0], 0.0).map(ridge).collect();
    assert!(arrives(level, ends, &[&thin[..], &["--max-grade", "12"]].concat()));
    // Diagonally over a corner where two steps down meet.
    let steps = |[x, y, _]: [f64; 3]| [x, y, -0.05 * f64::from(u8::from(x > 4.0) + u8::from(y > 2.0))];
    let corner = floor([0.0, 8.0], [0.0, 4.0], 0.0).map(steps).collect();
    assert!(arrives(corner, ["3.05,1.05,0.1", "4.95,2.95,0.1"], &[&thin[..], &["--max-drop", "0.07"]].concat()));
}

#[test]
fn what_only_a_walker_meets_is_named() {
    // The pawn sinks behind a sill before it meets the step: from place to place it rises by 0.32 m, but climbs 0.38 m.
    let height = |x: f64| if x > 4.2 { 0.38 } else { 0.06 * f64::from(u8::from(3.9 < x && x < 4.0)) };
    let points = floor([0.0, 8.0], [0.0, 6.0], 0.0).map(|[x, y, _]| [x, y, height(x)]).collect();
    check(&route(points, ["1,3,0.1", "7,3,0.5"], &["--pawn", "cylinder:0.083x0.8"]), "step", 0.38, 0.03, None);
}

#[test]
fn missing_ground_is_a_gap_or_unseen() {
    let islands = || floor([0.0, 4.0], [0.0, 6.0], 3.0).chain(floor([5.5, 8.0], [0.0, 6.0], 3.0));
    let ends = ["1,3,3.1", "7,3,3.1"];
    check(&route(islands().collect(), ends, &[]), "unseen", 1.5, 0.5, None);
    let below = islands().chain(floor([4.0, 5.5], [0.0, 6.0], 0.0));
    check(&route(below.collect(), ends, &[]), "gap", 1.5, 0.5, None);
}

#[test]
fn a_door_both_narrow_and_low_needs_the_width_that_passes() {
    // 0.3 m wide and 1.3 m high: neither a narrower nor a lower pawn passes, but one that is both.
    let ground = floor([0.0, 8.0], [0.0, 6.0], 0.0);
    let walls = wall([0.0, 2.0], [0.0, 2.5]).chain(wall([2.0, 2.3], [1.3, 2.5])).chain(wall([2.3, 6.0], [0.0, 2.5]));
    let found = route(ground.chain(walls).collect(), ENDS, &["--pawn", "box:0.8x0.8x1.8"]);
    check(&found, "width", 0.3, 0.06, Some([1.6, 2.8]));
}

/// Rooms along a side of a random house, edge of a room, and height of its walls (m).
const ROOMS: usize = 3;
const ROOM_M: f64 = 3.0;
const WALL_M: f64 = 3.6;
/// Width, height and climb of the default pawn (m).
const PAWN: [f64; 3] = [0.5, 1.8, 0.35];
/// Middle of a door along its wall, in the middle of a pixel (m).
const MIDDLE_M: f64 = 1.55;
/// How exact a width, a headroom and a step are: half a pixel, the spacing of points and the precision of the search (m).
const EXACT: [f64; 3] = [0.06, 0.07, 0.04];
const REASONS: [&str; 3] = ["width", "headroom", "step"];

/// A wall between two rooms with a door.
struct Door {
    rooms: [usize; 2],
    /// First corner of the wall (m) and the axis along which it stands.
    from: [f64; 2],
    along: usize,
    /// Width, height and step (m); the wall is closed if the width is 0.
    measures: [f64; 3],
}

impl Door {
    fn middle(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.from[axis] + if axis == self.along { MIDDLE_M } else { 0.0 })
    }

    /// Whether a pawn with these measures passes.
    fn passes(&self, pawn: [f64; 3]) -> bool {
        self.measures[0] >= pawn[0] && self.measures[1] >= pawn[1] && self.measures[2] <= pawn[2]
    }
}

/// A house with doors that are narrow, low, high or two of these, and floors at different heights.
fn random_house(random: &mut crate::house::Random) -> (Vec<Door>, Vec<f64>, Vec<[f64; 3]>) {
    let heights: Vec<f64> = (0..ROOMS * ROOMS).map(|_| [0.0, 0.0, 0.0, 0.0, 0.45, 0.6][random.below(6)]).collect();
    let mut doors = Vec::new();
    for room in 0..ROOMS * ROOMS {
        let [x, y] = [room % ROOMS, room / ROOMS].map(|at| at as f64 * ROOM_M);
        let sides = [
            (room % ROOMS + 1 < ROOMS, room + 1, [x + ROOM_M, y], 1),
            (room / ROOMS + 1 < ROOMS, room + ROOMS, [x, y + ROOM_M], 0),
        ];
        for (_, other, from, along) in sides.into_iter().filter(|side| side.0) {
            let width = [0.0, 0.1, 0.3, 0.3, 1.1, 1.1, 1.1, 1.1][random.below(8)];
            let high = if random.below(4) > 0 { 2.2 } else { 1.0 + random.below(7) as f64 * 0.1 };
            let step = (heights[room] - heights[other]).abs();
            doors.push(Door { rooms: [room, other], from, along, measures: [width, high, step] });
        }
    }
    let count = |length: f64| (length / 0.05).round() as i32;
    let at = |n: i32| f64::from(n) * 0.05 + 0.025;
    let mut points = Vec::new();
    for (room, height) in heights.iter().enumerate() {
        let [x, y] = [room % ROOMS, room / ROOMS].map(|at| at as f64 * ROOM_M);
        points.extend(floor([x, x + ROOM_M], [y, y + ROOM_M], *height));
    }
    let mut wall = |from: [f64; 2], along: usize, length: f64, opening: Option<([f64; 3], f64)>| {
        for (n, k) in (0..count(length)).flat_map(|n| (0..count(WALL_M)).map(move |k| (n, k))) {
            let mut place = [from[0] + 0.025, from[1] + 0.025, at(k)];
            place[along] = from[along] + at(n);
            let is_open = opening.is_some_and(|([width, high, _], sill)| {
                (at(n) - MIDDLE_M).abs() < width / 2.0 && (sill..sill + high).contains(&at(k))
            });
            if !is_open {
                points.push(place);
            }
        }
    };
    let length = ROOMS as f64 * ROOM_M;
    for beyond in [0.0, length - 0.05] {
        wall([0.0, beyond], 0, length, None);
        wall([beyond, 0.0], 1, length, None);
    }
    for door in &doors {
        let sill = heights[door.rooms[0]].max(heights[door.rooms[1]]);
        wall(door.from, door.along, ROOM_M, Some((door.measures, sill)));
    }
    (doors, heights, points)
}

/// Rooms that a pawn with these measures gets to.
fn rooms_of(doors: &[Door], pawn: [f64; 3], from: usize) -> Vec<bool> {
    let mut found = vec![false; ROOMS * ROOMS];
    found[from] = true;
    for _ in 0..ROOMS * ROOMS {
        for door in doors.iter().filter(|door| door.passes(pawn)) {
            let either = door.rooms.iter().any(|room| found[*room]);
            door.rooms.iter().for_each(|room| found[*room] |= either);
        }
    }
    found
}

/// The value of each measure, nearest to the pawn's own, with which it gets from one room to another.
fn least_changes(doors: &[Door], [from, to]: [usize; 2]) -> [Option<f64>; 3] {
    [0, 1, 2].map(|measure| {
        let all = doors.iter().map(|door| door.measures[measure]).filter(|value| *value > 0.0);
        let passing = all.filter(|value| {
            let mut pawn = PAWN;
            pawn[measure] = *value;
            rooms_of(doors, pawn, from)[to]
        });
        let far = |value: &f64| (value - PAWN[measure]).abs();
        passing.min_by(|a, b| far(a).total_cmp(&far(b)))
    })
}

/// `SLICEWALK_BLOCKED` sets the number of pairs, `SLICEWALK_FIRST` the first house.
#[test]
fn reasons_in_random_houses_are_the_least_changes_of_brute_force() {
    let number = |name: &str| std::env::var(name).ok().map(|value| value.parse::<usize>().unwrap());
    let (most, first) = (number("SLICEWALK_BLOCKED").unwrap_or(12), number("SLICEWALK_FIRST").unwrap_or(0));
    let (mut pairs, mut twofold, mut wrong) = (0, 0, Vec::new());
    for seed in first.. {
        if pairs >= most {
            break;
        }
        let mut random = crate::house::Random(seed as u64);
        let (doors, heights, points) = random_house(&mut random);
        let folder = archive_of(points);
        for _ in 0..4 {
            let ends = [random.below(ROOMS * ROOMS), random.below(ROOMS * ROOMS)];
            let own = rooms_of(&doors, PAWN, ends[0]);
            if own[ends[1]] {
                continue;
            }
            let place = |room: usize| {
                let [x, y] = [room % ROOMS, room / ROOMS].map(|at| (at as f64 + 0.5) * ROOM_M);
                format!("{x},{y},{}", heights[room] + 0.1)
            };
            let [from, to] = ends.map(place);
            let out = slicetool(&folder, "route", &["--from", &from, "--to", &to]);
            let found: Value = serde_json::from_slice(&out.stdout).unwrap();
            let what = format!("house {seed}, {from} to {to}: {found}");
            assert_eq!(found["reason"], Value::from("not_connected"), "{what}");
            pairs += 1;
            let blocked = &found["blocked"];
            let (reason, needs) = (blocked["reason"].as_str().unwrap_or_default(), blocked["needs"].as_f64());
            let truths = least_changes(&doors, ends);
            let share = |measure: usize, value: f64| (value - PAWN[measure]).abs() / PAWN[measure];
            let shares = (0..3).filter_map(|measure| Some(share(measure, truths[measure]?)));
            let Some(least) = shares.reduce(f64::min) else {
                // No single change helps: two at once may, or a wall without a door.
                twofold += 1;
                if blocked.is_null() || reason == "width" && needs.is_some_and(|needs| needs < 0.1 - EXACT[0]) {
                    wrong.push(what);
                }
                continue;
            };
            let is_right = REASONS.iter().position(|name| *name == reason).is_some_and(|measure| {
                let slack = EXACT[measure] / PAWN[measure];
                truths[measure].zip(needs).is_some_and(|(truth, needs)| {
                    (truth - needs).abs() <= EXACT[measure] && share(measure, truth) <= least + slack
                })
            });
            let [x, y] = ["x", "y"].map(|axis| blocked[axis].as_f64().unwrap_or(f64::NAN));
            let is_there = doors.iter().filter(|door| own[door.rooms[0]] != own[door.rooms[1]]).any(|door| {
                let [at_x, at_y] = door.middle();
                (x - at_x).hypot(y - at_y) < 1.2
            });
            if !is_right || !is_there {
                wrong.push(format!("{what}; expected {truths:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{} of {pairs} pairs, {twofold} with two changes:\n{}", wrong.len(), wrong.join("\n"));
    assert!(twofold < pairs, "no pair has a single change");
}
