//! `--edits`: random houses beside a search over their rooms, and each kind of edit on its own.

use crate::house::{House, ROOM_M, Side, archive_of, slicetool};
use scangen::{WriteSpec, write_las};
use serde_json::{Value, json};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, HoleWidth, PixelSize, convert};
use std::collections::HashSet;
use std::fs;
use tempfile::TempDir;

/// Rooms along a side of a house.
const ROOMS: usize = 3;

fn write(folder: &TempDir, edits: &Value) {
    fs::write(folder.path().join("e.json"), edits.to_string()).unwrap();
}

fn summary(folder: &TempDir, command: &str, arguments: &[&str]) -> Value {
    let out = slicetool(folder, command, &[&["a.slices", "--json"], arguments].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

/// Rooms that `reach` gets to from the first one: those with a place near their middle.
fn reached(folder: &TempDir, house: &House, options: &[&str]) -> HashSet<usize> {
    let from = house.middle(0);
    let from = format!("{},{},0.1", from[0], from[1]);
    let out = slicetool(folder, "reach", &[&["a.slices", "--from", &from, "-o", "r.csv"], options].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let table = fs::read_to_string(folder.path().join("r.csv")).unwrap();
    let number = |line: &str| -> Vec<f64> { line.split(',').map(|field| field.parse().unwrap()).collect() };
    let places: Vec<Vec<f64>> = table.lines().skip(1).map(number).collect();
    let is_near = |room: usize| {
        let [x, y] = house.middle(room);
        places.iter().any(|place| (place[0] - x).abs() < 0.3 && (place[1] - y).abs() < 0.3)
    };
    (0..ROOMS * ROOMS).filter(|room| is_near(*room)).collect()
}

/// Rooms that a search over open sides and links gets to from the first one.
fn by_rooms(house: &House, links: &[[usize; 2]], no_go: Option<usize>) -> HashSet<usize> {
    let mut found = HashSet::from([0]);
    loop {
        let sides = house.sides.iter().filter(|side| side.is_open).map(|side| side.rooms);
        let ways = sides.chain(links.iter().copied());
        let more: Vec<usize> = ways
            .flat_map(|[a, b]| [(a, b), (b, a)])
            .filter(|(a, b)| found.contains(a) && !found.contains(b) && Some(*b) != no_go)
            .map(|(_, b)| b)
            .collect();
        if more.is_empty() {
            return found;
        }
        found.extend(more);
    }
}

#[test]
fn edited_houses_are_reached_as_far_as_a_search_over_rooms_gets() {
    let mut counts = [0; 2];
    for seed in 0..6 {
        let mut house = House::new(ROOMS, seed);
        let folder = archive_of(house.points());
        let before = fs::read(folder.path().join("a.slices")).unwrap();
        assert_eq!(reached(&folder, &house, &[]), by_rooms(&house, &[], None), "house {seed} as it was scanned");
        let (mut doors, mut removed) = (Vec::new(), Vec::new());
        for number in 0..house.sides.len() {
            let change = house.random.below(3);
            let Side { is_open, has_door, .. } = house.sides[number];
            match (has_door, change) {
                (true, 0 | 1) => {
                    let shape = house.door(number);
                    doors.push(json!({ "name": format!("door {number}"), "box": shape, "open": !is_open }));
                    house.sides[number].is_open = !is_open;
                }
                (false, 0) => {
                    removed.push(json!({ "box": house.wall(number) }));
                    house.sides[number].is_open = true;
                }
                _ => {}
            }
        }
        let no_go = 1 + house.random.below(ROOMS * ROOMS - 1);
        let [x, y] = house.middle(no_go);
        let half = ROOM_M / 2.0 - 0.1;
        let outline = [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]];
        let mut edits = json!({ "doors": doors, "remove": removed });
        write(&folder, &edits);
        assert_eq!(reached(&folder, &house, &["--edits", "e.json"]), by_rooms(&house, &[], None), "{seed}: {edits}");
        edits["no_go"] = json!([{ "outline": outline, "z": [0.0, 2.0] }]);
        write(&folder, &edits);
        let expected = by_rooms(&house, &[], Some(no_go));
        assert_eq!(reached(&folder, &house, &["--edits", "e.json"]), expected, "{seed}: {edits}");
        let apart = (0..ROOMS * ROOMS).find(|room| !expected.contains(room) && *room != no_go);
        counts[usize::from(apart.is_some())] += 1;
        if let Some(apart) = apart {
            let ([x, y], [far_x, far_y]) = (house.middle(0), house.middle(apart));
            edits["links"] = json!([{ "name": "lift", "from": [x, y, 0.1], "to": [far_x, far_y, 0.1], "seconds": 20 }]);
            write(&folder, &edits);
            let expected = by_rooms(&house, &[[0, apart]], Some(no_go));
            assert_eq!(reached(&folder, &house, &["--edits", "e.json"]), expected, "{seed}: {edits}");
            let ends = [format!("{},{y},0.1", x + 0.5), format!("{},{far_y},0.1", far_x - 0.5)];
            let ends = ["--from", ends[0].as_str(), "--to", ends[1].as_str(), "--edits", "e.json"];
            let found = summary(&folder, "route", &ends);
            assert_eq!(found["links"], json!(["lift"]), "{found}");
            let (way_s, length_m) = (found["way_s"].as_f64().unwrap(), found["length_m"].as_f64().unwrap());
            assert!((way_s - 20.0 - length_m / 1.4).abs() < 1e-3 && (0.9..1.3).contains(&length_m), "{found}");
            let way = summary(&folder, "reach", &ends);
            assert_eq!((&way["links"], &way["way_s"]), (&found["links"], &found["way_s"]));
        }
        assert!(fs::read(folder.path().join("a.slices")).unwrap() == before, "the archive has changed");
    }
    assert!(counts[0] + counts[1] == 6 && counts[1] > 0, "{counts:?}");
}

/// Points of a floor of 8 × 4 m with a wall across at x = 4 and a door of 1 m in it.
fn hall() -> Vec<[f64; 3]> {
    let floor = (0..160 * 80).map(|n| [f64::from(n % 160) * 0.05 + 0.025, f64::from(n / 160) * 0.05 + 0.025, 0.0]);
    let wall = (0..80 * 44).map(|n| [4.025, f64::from(n % 80) * 0.05 + 0.025, f64::from(n / 80) * 0.05 + 0.025]);
    floor.chain(wall.filter(|[_, y, _]| !(1.5..2.5).contains(y))).collect()
}

const ENDS: [&str; 4] = ["--from", "1,2,0.1", "--to", "7,2,0.1"];

#[test]
fn a_link_is_taken_only_if_it_saves_time_and_in_its_direction() {
    let folder = archive_of(hall());
    let link = |seconds: f64, one_way: bool| {
        let link = json!({ "name": "moving walk", "from": [7, 1, 0], "to": [1, 1, 0], "seconds": seconds, "one_way": one_way });
        write(&folder, &json!({ "links": [link] }));
        summary(&folder, "route", &[&ENDS[..], &["--edits", "e.json"]].concat())
    };
    assert_eq!(link(0.5, false)["links"], json!(["moving walk"]));
    let ends = [&["a.slices"], &ENDS[..], &["--edits", "e.json", "-o", "r.geojson"]].concat();
    assert!(slicetool(&folder, "route", &ends).status.success());
    let features: Value = serde_json::from_slice(&fs::read(folder.path().join("r.geojson")).unwrap()).unwrap();
    let feature = &features["features"][0];
    assert_eq!(
        (&feature["geometry"]["type"], &feature["properties"]["links"]),
        (&json!("LineString"), &json!(["moving walk"]))
    );
    assert_eq!(link(60.0, false)["links"], json!([]));
    assert_eq!(link(0.5, true)["links"], json!([]), "it leads the other way");
    write(&folder, &json!({ "links": [{ "name": "far", "from": [1, 1, 0], "to": [90, 1, 0], "seconds": 1 }] }));
    let out = slicetool(&folder, "route", &[&["a.slices"], &ENDS[..], &["--edits", "e.json"]].concat());
    assert!(out.status.success() && String::from_utf8_lossy(&out.stderr).contains("link \"far\" is left out"));
}

#[test]
fn the_table_of_a_route_has_both_ends_of_each_link() {
    let folder = archive_of(hall());
    let link =
        |name: &str, from: [i32; 3], to: [i32; 3]| json!({ "name": name, "from": from, "to": to, "seconds": 0.1 });
    let routed = |links: Value, from: &str, to: &str| {
        write(&folder, &json!({ "links": links }));
        let route = ["a.slices", "--from", from, "--to", to, "--edits", "e.json"];
        let table = slicetool(&folder, "route", &route);
        assert!(table.status.success());
        let rows = String::from_utf8(table.stdout).unwrap();
        let place =
            |row: &str| -> Vec<i32> { row.split(',').take(2).map(|v| v.parse::<f64>().unwrap() as i32).collect() };
        let rows: Vec<Vec<i32>> = rows.lines().skip(1).map(place).collect();
        assert!(slicetool(&folder, "route", &[&route[..], &["-o", "r.geojson"]].concat()).status.success());
        let drawn: Value = serde_json::from_slice(&fs::read(folder.path().join("r.geojson")).unwrap()).unwrap();
        (rows, drawn["features"][0]["geometry"]["coordinates"].as_array().unwrap().len())
    };
    // No step is left to walk, before, between or behind them.
    let one = json!([link("one", [1, 2, 0], [7, 2, 0])]);
    assert_eq!(routed(one, ENDS[1], ENDS[3]), (vec![vec![1, 2], vec![7, 2]], 2));
    let two = json!([link("one", [1, 2, 0], [2, 1, 0]), link("two", [2, 1, 0], [7, 2, 0])]);
    assert_eq!(routed(two, ENDS[1], ENDS[3]), (vec![vec![1, 2], vec![2, 1], vec![7, 2]], 3));
    // A line has two ends, even from a place to itself.
    assert_eq!(routed(json!([]), ENDS[1], ENDS[1]), (vec![vec![1, 2]], 2));
}

#[test]
fn queries_and_walks_meet_the_edits() {
    let folder = archive_of(hall());
    let at = folder.path();
    let door = json!([{ "name": "hall", "box": [3.9, 1.5, 0.0, 4.1, 2.5, 2.0], "open": false }]);
    write(
        &folder,
        &json!({ "doors": door, "add": [{ "box": [20, 20, 0, 21, 21, 1] }], "no_go": [{ "box": [6, 1, 0, 7, 2, 2] }] }),
    );
    // The door; solid far from the scan; a no-go area, which is not solid; the wall; the floor.
    let boxes = "3.95,1.9,0.9,4.05,2.1,1\n20.4,20.4,0.5,20.6,20.6,0.6\n6.4,1.4,0.5,6.6,1.6,0.6\n4,0.5,1,4.05,0.6,1.1\n1,1,-0.1,1.1,1.1,0.1\n";
    fs::write(at.join("q.csv"), boxes).unwrap();
    let column = |arguments: &[&str]| -> String {
        let out = slicetool(&folder, "query", &[&["a.slices", "--boxes", "q.csv"], arguments].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let table = String::from_utf8(out.stdout).unwrap();
        let place = |name: &str| table.lines().next().unwrap().split(',').position(|field| field == name).unwrap();
        let name = if arguments.contains(&"--show-edits") { "edited" } else { "hit" };
        table.lines().skip(1).map(|line| line.split(',').nth(place(name)).unwrap()).collect()
    };
    assert_eq!(column(&[]), "00011");
    assert_eq!(column(&["--edits", "e.json"]), "11011");
    assert_eq!(column(&["--edits", "e.json", "--show-edits"]), "11000");
    fs::write(at.join("w.csv"), "x,y\n7,2.5\n").unwrap();
    let walk = ["a.slices", "--start", "1,2,0.1", "--waypoints", "w.csv", "-o", "p.csv", "--json"];
    assert!(slicetool(&folder, "walk", &walk).status.success());
    let out = slicetool(&folder, "walk", &[&walk[..], &["--edits", "e.json"]].concat());
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((out.status.code(), &found["state"]), (Some(1), &json!("blocked")), "{found}");
    assert!((3.4..4.0).contains(&found["end"][0].as_f64().unwrap()), "{found}");
    let found = summary(&folder, "route", &[&ENDS[..], &["--edits", "e.json"]].concat());
    assert_eq!(found["reason"], json!("not_connected"), "{found}");
    // Something stands there: it is not missing from the scan. The wall beside the door is thinner than the door.
    let blocked = &found["blocked"];
    let [x, y] = ["x", "y"].map(|axis| blocked[axis].as_f64().unwrap());
    assert!(blocked["reason"] == "gap" && (3.4..4.0).contains(&x) && (1.0..3.0).contains(&y), "{found}");
    let ends = [&["a.slices"], &ENDS[..], &["--edits", "e.json", "-o", "r.geojson"]].concat();
    assert!(slicetool(&folder, "route", &ends).status.success());
    let features: Value = serde_json::from_slice(&fs::read(at.join("r.geojson")).unwrap()).unwrap();
    let feature = &features["features"][0];
    assert_eq!((&feature["geometry"]["type"], &feature["properties"]["what"]), (&json!("Point"), &json!("blocked")));
    let out = slicetool(&folder, "export", &["a.slices", "-o", "a.ply", "--edits", "e.json"]);
    assert!(
        out.status.code() == Some(2)
            && String::from_utf8_lossy(&out.stderr).contains("--edits: this option is only for")
    );
}

#[test]
fn bad_edits_are_refused_in_one_line() {
    let folder = archive_of(hall());
    let at = folder.path();
    let refused = |arguments: &[&str], code: i32| -> String {
        let out = slicetool(&folder, "route", &[&["a.slices"], &ENDS[..], arguments].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(code), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        said
    };
    assert!(refused(&["--edits", "none.json"], 1).contains("none.json: cannot read"));
    assert!(refused(&["--edits", "-"], 2).contains("name a file"));
    for (text, says) in [
        ("{", "e.json: edits: EOF"),
        (r#"{"wall": []}"#, "unknown field `wall`, expected one of `remove`, `add`, `doors`, `links`, `no_go`"),
        (r#"{"doors": [{"name": "a", "box": [0, 0, 0, 1, 1, 1]}]}"#, "e.json: doors[0]: open: expected true or false"),
        (r#"{"add": [{"box": [0, 0, 0, 1e8, 1e8, 1]}]}"#, "pages that edits change"),
        (r#"{"add": [{"box": [0, 0, 0, 1, 1, 1e8]}]}"#, "pages that edits change"),
    ] {
        fs::write(at.join("e.json"), text).unwrap();
        let said = refused(&["--edits", "e.json"], 1);
        assert!(said.contains(says), "{text}: {said}");
    }
    // What is read is not replaced.
    fs::write(at.join("e.json"), "{}").unwrap();
    refused(&["--edits", "e.json", "-o", "e.json"], 1);
    assert_eq!(fs::read_to_string(at.join("e.json")).unwrap(), "{}");
    // Maps say so before they look for places, of which this pawn has none.
    let nowhere = ["--pawn", "box:9x9x1.8"];
    for (edits, output, more) in [
        ("e.npy", "e.npy", &["--esdf"][..]),
        ("e.yaml", "e.yaml", &[&["--storey", "0"], &nowhere[..]].concat()[..]),
        ("e.pgm", "e.yaml", &[&["--z", "0"], &nowhere[..]].concat()[..]),
        ("e_storey0.yaml", "e.yaml", &nowhere),
        ("e_links.geojson", "e.yaml", &nowhere),
    ] {
        fs::write(at.join(edits), "{}").unwrap();
        let out = slicetool(&folder, "export", &[&["a.slices", "-o", output, "--edits", edits], more].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        assert!(out.status.code() == Some(1) && said.contains("this command reads"), "{edits}: {said}");
        assert_eq!(fs::read_to_string(at.join(edits)).unwrap(), "{}");
        fs::remove_file(at.join(edits)).unwrap();
    }
}

#[test]
fn maps_show_what_edits_add_beyond_the_scan() {
    let folder = archive_of(hall());
    // A floor that leads out of the scan, and beyond the tiles of 6.4 m in which it lies.
    write(&folder, &json!({ "add": [{ "box": [7, 1, -0.3, 16, 3, 0] }] }));
    let map = |more: &[&str]| {
        let out = slicetool(&folder, "export", &[&["a.slices", "-o", "m.yaml", "--storey", "0"], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let image = fs::read(folder.path().join("m.pgm")).unwrap();
        let mut lines = image.splitn(4, |byte| *byte == b'\n');
        let size = String::from_utf8(lines.nth(1).unwrap().to_vec()).unwrap();
        let width: usize = size.split(' ').next().unwrap().parse().unwrap();
        let samples = lines.nth(1).unwrap();
        let beyond = samples.chunks(width).flat_map(|row| row.iter().skip(128));
        (width, beyond.filter(|sample| **sample == 254).count())
    };
    assert_eq!(map(&[]), (128, 0));
    let (width, free) = map(&["--edits", "e.json"]);
    assert!(width == 192 && free > 300, "{width} {free}");
}

#[test]
fn a_map_of_places_shows_the_walls_of_the_edits() {
    let folder = archive_of(hall());
    let map = |archive: &str, more: &[&str]| {
        let out = slicetool(&folder, "reach", &[&[archive, "--from", "1,2,0.1", "-o", "m.png"], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        fs::read(folder.path().join("m.png")).unwrap()
    };
    let door = json!({ "name": "door", "box": [3.9, 1.4, 0.0, 4.1, 2.6, 2.2], "open": false });
    write(&folder, &json!({ "doors": [door], "remove": [{ "box": [3.8, 0.0, 0.02, 4.2, 1.0, 2.5] }] }));
    let copy = slicetool(&folder, "extract", &["a.slices", "-o", "b.slices", "--edits", "e.json"]);
    assert!(copy.status.success(), "{}", String::from_utf8_lossy(&copy.stderr));
    let edited = map("a.slices", &["--edits", "e.json"]);
    assert!(edited == map("b.slices", &[]), "a copy with the edits");
    assert!(edited != map("a.slices", &[]), "without them");
}

#[test]
fn distances_reach_to_what_edits_add_beyond_the_scan() {
    let folder = archive_of(hall());
    write(
        &folder,
        &json!({ "add": [{ "box": [20.1, 0.5, 0.0, 20.75, 3.5, 2.0] }], "remove": [{ "box": [90, 0, 0, 91, 1, 1] }] }),
    );
    let copy = slicetool(&folder, "extract", &["a.slices", "-o", "b.slices", "--edits", "e.json"]);
    assert!(copy.status.success(), "{}", String::from_utf8_lossy(&copy.stderr));
    let samples = |archive: &str, more: &[&str]| {
        let fixed = [archive, "-o", "d.npy", "--esdf", "--step", "0.5"];
        let out = slicetool(&folder, "export", &[&fixed[..], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let said = String::from_utf8(out.stdout).unwrap();
        (said, fs::read(folder.path().join("d.npy")).unwrap())
    };
    let (said, distances) = samples("a.slices", &["--edits", "e.json"]);
    // From 0 to 20.8 m along x; the scan ends at 8 m.
    assert!(said.starts_with("d.npy: 42 × "), "{said}");
    assert!(samples("a.slices", &[]).0.starts_with("d.npy: 16 × "));
    assert!((said, distances) == samples("b.slices", &[]), "a copy with the edits");
}

#[test]
fn a_copy_with_edits_answers_as_the_archive_with_them() {
    let house = House::new(ROOMS, 3);
    let folder = archive_of(house.points());
    let at = folder.path();
    let open = house.sides.iter().position(|side| side.has_door && side.is_open).unwrap();
    let shut = json!({
        "doors": [{ "name": "door", "box": house.door(open), "open": false }],
        "links": [{ "name": "lift", "from": [1, 1, 0], "to": [1, 1, 3], "seconds": 5 }],
    });
    write(&folder, &shut);
    let out = slicetool(&folder, "extract", &["a.slices", "--edits", "e.json", "-o", "shut.slices"]);
    let said = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success() && said.contains("dropped: 1 link\n"), "{said}");
    let (mut boxes, doors) = (String::new(), house.door(open));
    let [x, y, z] = [0, 1, 2].map(|axis| doors[axis].midpoint(doors[axis + 3]));
    for step in 0..200 {
        let by = f64::from(step) * 0.03 - 3.0;
        boxes += &format!("{},{},{},{},{},{}\n", x + by, y - by, z, x + by + 0.1, y - by + 0.1, z + 0.1);
        boxes += &format!("{},{},{},{},{},{}\n", x + by, y, z, x + by + 0.02, y + 0.02, z + 0.02);
    }
    fs::write(at.join("boxes.csv"), boxes).unwrap();
    let ask = |archive: &str, more: &[&str]| {
        let out = slicetool(&folder, "query", &[&[archive, "--boxes", "boxes.csv"], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stdout).unwrap()
    };
    assert_eq!(ask("shut.slices", &[]), ask("a.slices", &["--edits", "e.json"]));
    assert_ne!(ask("shut.slices", &[]), ask("a.slices", &[]));
    // The page walks in the same copy.
    fs::create_dir(at.join("page")).unwrap();
    fs::write(at.join("page/index.html"), "<title>page</title>").unwrap();
    let site = ["a.slices", "--edits", "e.json", "--page", "page", "-o", "site"];
    let out = slicetool(&folder, "site", &site);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success() && said.contains("the page does not know 1 link"), "{said}");
    assert!(fs::read(at.join("site/a.slices")).unwrap() == fs::read(at.join("shut.slices")).unwrap());
    // Combinations that are refused.
    let refused = slicetool(&folder, "site", &[&["shut.slices"], &site[..]].concat());
    assert_eq!(refused.status.code(), Some(2), "two archives");
    let refused = slicetool(&folder, "extract", &["a.slices", "--edits", "e.json", "-o", "e.json", "--force"]);
    assert_eq!(refused.status.code(), Some(1), "the edits themselves");
    assert_eq!(fs::read_to_string(at.join("e.json")).unwrap(), shut.to_string());
    assert_eq!(slicetool(&folder, "extract", &["a.slices", "-o", "b.slices"]).status.code(), Some(2), "no bounds");
}

/// A floor with two filled holes, a post on one of them.
#[test]
fn a_copy_with_edits_keeps_the_marks_of_filled_holes_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let is_hole = |x: f64, y: f64| [1.5, 4.0].iter().any(|low| [x, y].iter().all(|v| (*low..low + 0.3).contains(v)));
    let grid = (0..240 * 240).map(|at| [f64::from(at % 240), f64::from(at / 240)].map(|step| (step + 0.5) * 0.025));
    let floor = grid.filter(|[x, y]| !is_hole(*x, *y)).map(|[x, y]| [x, y, 0.0]);
    let scan = folder.path().join("scan.las");
    write_las(&scan, floor, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.1);
    options.grid.fill_holes = Some(HoleWidth::Metres(0.4));
    convert(&options, &NoMonitor).unwrap();
    write(&folder, &json!({ "add": [{ "box": [3.9, 3.9, 0.0, 4.4, 4.4, 0.5] }] }));
    let out = slicetool(&folder, "extract", &["a.slices", "--edits", "e.json", "-o", "post.slices"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let inferred = |archive: &str| -> Value {
        let out = slicetool(&folder, "info", &[archive, "--json"]);
        serde_json::from_slice::<Value>(&out.stdout).unwrap()["voxels"]["inferred"].clone()
    };
    assert_eq!([inferred("a.slices"), inferred("post.slices")], [json!(18), json!(9)]);
    let out = slicetool(&folder, "diff", &["a.slices", "post.slices", "--json"]);
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    let marks = ["inferred_only_a", "inferred_only_b"].map(|key| found["voxels"][key].clone());
    assert_eq!(marks, [json!(9), json!(0)], "{found}");
    // Layers ignore the marks as other answers do.
    let without_floor = |layers: &str, more: &[&str]| {
        let fixed = ["a.slices", "-o", "a.tif", "--layer", layers];
        let out = slicetool(&folder, "export", &[&fixed[..], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let file = fs::File::open(folder.path().join("a.tif")).unwrap();
        let samples = tiff::decoder::Decoder::new(file).unwrap().read_image().unwrap();
        let tiff::decoder::DecodingResult::F32(samples) = samples else { panic!("expected f32") };
        let bands = layers.split(',').count();
        samples.iter().step_by(bands).filter(|height| height.is_nan()).count()
    };
    for layers in ["height,slope", "height"] {
        assert_eq!(without_floor(layers, &["--ignore-inferred"]), without_floor(layers, &[]) + 18, "{layers}");
    }
}
