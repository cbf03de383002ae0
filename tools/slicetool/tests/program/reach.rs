//! `slicetool reach` and `slicetool route` from a user's view: files, summaries, exit codes.

use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_las, write_samples};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, HoleWidth, PixelSize, convert};
use slicewalk_input::Units;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).current_dir(folder).args(arguments).output().unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

fn to_archive(scan: PathBuf, folder: &Path) {
    let mut options = ConvertOptions::new(vec![scan], folder.join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.05);
    options.resources.threads = 1;
    convert(&options, &NoMonitor).unwrap();
}

/// A floor of 8 × 4 m at z = 1 within walls 2.5 m high, with a hole of 1 × 1 m around (6, 2) and a wall with a door
/// 0.9 m wide at x = 4.
fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |n: i32| f64::from(n) * 0.025 + 0.0125;
    let inside = |x: f64, y: f64| (5.5..6.5).contains(&x) && (1.5..2.5).contains(&y);
    let floor = (0..320).flat_map(|i| (0..160).map(move |j| [at(i), at(j), 1.0]));
    let floor = floor.filter(|[x, y, _]| !inside(*x, *y));
    let height = || (0..100).map(|k| 1.0 + f64::from(k) * 0.025);
    let ends = (0..160).flat_map(|j| [0.01, 7.99].map(|x| (x, at(j))));
    let sides = (0..320).flat_map(|i| [0.01, 3.99].map(|y| (at(i), y)));
    let door = (0..160).map(|j| (4.01, at(j))).filter(|(_, y)| !(1.55..2.45).contains(y));
    let walls = ends.chain(sides).chain(door).flat_map(|(x, y)| height().map(move |z| [x, y, z]));
    let scan = folder.path().join("scan.las");
    write_las(&scan, floor.chain(walls), &WriteSpec::for_path(&scan)).unwrap();
    to_archive(scan, folder.path());
    folder
}

#[test]
fn reach_reports_area_passages_and_leaks() {
    let folder = room();
    let at = folder.path();
    let found = json(&done(at, &["reach", "a.slices", "--from", "1,1,1.1", "--json"]));
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{value}: {found}"));
    let area = number(&found["area_m2"]);
    assert!((20.0..26.0).contains(&area), "{area}");
    let storeys = found["storeys"].as_array().unwrap();
    assert_eq!(storeys.len(), 1);
    assert!((number(&storeys[0]["z"]) - 1.0).abs() < 0.01 && (number(&storeys[0]["area_m2"]) - area).abs() < 1e-9);
    let leaks = found["leaks"].as_array().unwrap();
    assert_eq!(leaks.len(), 1, "{found}");
    let leak = &leaks[0];
    assert!((number(&leak["x"]) - 6.0).abs() < 0.06 && (number(&leak["y"]) - 2.0).abs() < 0.06, "{leak}");
    assert!((number(&leak["z"]) - 1.0).abs() < 0.01 && (number(&leak["width"]) - 1.0).abs() < 0.11, "{leak}");
    assert_eq!((&leak["kind"], leak["drop"].is_null()), (&"hole".into(), true));
    let passages = found["passages"].as_array().unwrap();
    let door = passages.iter().find(|passage| (number(&passage["x"]) - 4.0).abs() < 0.11);
    assert!(door.is_some_and(|door| (number(&door["width"]) - 0.9).abs() < 0.11), "{found}");
    let rooms = door.map(|door| [0, 1].map(|side| number(&door["connects"][side]["x"])));
    assert!(rooms.is_some_and(|[a, b]| a.min(b) < 3.5 && a.max(b) > 4.5), "{found}");
    assert!(number(&found["memory_bytes"]) > 0.0 && number(&found["seconds"]) >= 0.0);
    assert!(found["way_m"].is_null());
    let there =
        done(at, &["reach", "a.slices", "--from", "1,1,1.1", "--to", "7.3,3.3,1.1", "-o", "way.geojson", "--json"]);
    let way = number(&json(&there)["way_m"]);
    assert!((6.6..8.0).contains(&way), "{way}");
    let collection = json(&fs::read_to_string(at.join("way.geojson")).unwrap());
    let line =
        collection["features"].as_array().unwrap().iter().find(|feature| feature["geometry"]["type"] == "LineString");
    assert!(line.is_some_and(|line| line["properties"]["length_m"] == way), "{collection}");
    let dark = |name: &str, more: &[&str]| {
        done(at, &[&["reach", "a.slices", "--from", "1,1,1.1", "-o", name], more].concat());
        let bytes = fs::read(at.join(name)).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut image = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut image).unwrap();
        image.chunks_exact(3).filter(|pixel| *pixel == [30; 3]).count()
    };
    assert!(dark("way.png", &["--to", "7.3,3.3,1.1"]) > dark("plain.png", &[]) + 1000);
    // A pawn wider than the door stays in its room and finds no hole.
    let wide = ["reach", "a.slices", "--from", "1,1,1.1", "--json", "--pawn", "cylinder:0.5x1.8"];
    let found = json(&done(at, &wide));
    assert!(found["leaks"].as_array().unwrap().is_empty() && found["area_m2"].as_f64().unwrap() < 10.0, "{found}");
    let text = done(at, &["reach", "a.slices", "--from", "1,1,1.1"]);
    assert!(text.contains("hole") && text.lines().any(|line| line.starts_with("area ")), "{text}");
}

#[test]
fn reach_writes_maps_tables_points_and_polygons() {
    let folder = room();
    let at = folder.path();
    let places = |out: &str| {
        let found = json(&done(at, &["reach", "a.slices", "--from", "1,1,1.1", "-o", out, "--json"]));
        (
            found["places"].as_u64().unwrap() as usize,
            fs::read(at.join(out)).unwrap(),
            found["area_m2"].as_f64().unwrap(),
        )
    };
    let (count, csv, area) = places("out.csv");
    let csv = String::from_utf8(csv).unwrap();
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("x,y,z,clearance"));
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), count);
    assert!((area - count as f64 * 0.0025).abs() < 1e-6);
    assert!(rows.iter().all(|row| (row[2] - 1.0).abs() < 0.01 && row[3] >= 0.0 && row[3] < 2.5));
    let (_, ply, _) = places("out.ply");
    let header = ply.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
    assert!(String::from_utf8_lossy(&ply[..header]).contains(&format!("element vertex {count}\n")));
    assert_eq!(ply.len() - header, count * 28);
    let x = f64::from_le_bytes(ply[header..header + 8].try_into().unwrap());
    assert!((x - rows[0][0]).abs() < 1e-3);
    let (_, png, _) = places("out.png");
    let image = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    assert!(image.info().width > 300 && image.info().height > 150);
    let (_, text, _) = places("out.geojson");
    let collection = json(std::str::from_utf8(&text).unwrap());
    assert_eq!(collection["type"], "FeatureCollection");
    let features = collection["features"].as_array().unwrap();
    let what = |name: &str| features.iter().filter(|feature| feature["properties"]["what"] == name).count();
    assert_eq!((what("storey"), what("leak")), (1, 1));
    let rings = features[0]["geometry"]["coordinates"][0].as_array().unwrap();
    let area_of = |ring: &serde_json::Value| {
        let corners: Vec<[f64; 2]> =
            ring.as_array().unwrap().iter().map(|at| [0, 1].map(|n| at[n].as_f64().unwrap())).collect();
        corners.windows(2).map(|pair| (pair[0][0] * pair[1][1] - pair[1][0] * pair[0][1]) / 2.0).sum::<f64>()
    };
    assert!((rings.iter().map(area_of).sum::<f64>() - area).abs() < 1e-6, "outer ring less its holes");
}

/// Features of one kind that `reach` writes about a scene, by their properties.
fn features(scene: &str, parameters: &Params, from: &str, what: &str) -> Vec<serde_json::Value> {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scan = at.join("scene.las");
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(3600.0) };
    let scene = Scene::named(scene, parameters).unwrap();
    write_samples(&scan, scene.samples(5, &spec).unwrap(), &WriteSpec::for_path(&scan)).unwrap();
    to_archive(scan, at);
    done(at, &["reach", "a.slices", "--from", from, "-o", "out.geojson"]);
    let collection = json(&fs::read_to_string(at.join("out.geojson")).unwrap());
    let features = collection["features"].as_array().unwrap();
    let properties = features.iter().map(|feature| feature["properties"].clone());
    properties.filter(|properties| properties["what"] == what).collect()
}

#[test]
fn steps_and_ramps_are_features() {
    let stairs = Params::new().with("risers", 6.0).with("riser", 0.17);
    let steps = features("stairs", &stairs, "-1,0.3,0.1", "step");
    assert_eq!(steps.len(), 6, "{steps:?}");
    for step in &steps {
        let [height, width] = ["height", "width"].map(|name| step[name].as_f64().unwrap());
        assert!((height - 0.17).abs() < 0.01 && width > 0.5, "{step}");
    }
    assert!(features("stairs", &stairs, "-1,0.3,0.1", "ramp").is_empty());
    for (slope, expected) in [(6.0, 1), (2.0, 0)] {
        let plane = Params::new().with("slope", slope).with("size", 6.0).with("heading", 25.0);
        let ramps = features("plane", &plane, "0,0,0.5", "ramp");
        assert_eq!(ramps.len(), expected, "{slope}°: {ramps:?}");
        for ramp in &ramps {
            let [grade, rise] = ["grade_percent", "rise"].map(|name| ramp[name].as_f64().unwrap());
            assert!((grade - 100.0 * f64::to_radians(slope).tan()).abs() < 0.7, "{ramp}");
            assert!(rise > 0.5, "{ramp}");
        }
        assert!(features("plane", &plane, "0,0,0.5", "step").is_empty());
    }
}

#[test]
fn a_route_is_written_as_waypoints_and_walked() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("stairs", &Params::new().with("risers", 6.0)).unwrap();
    let scan = at.join("stairs.las");
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(3600.0) };
    write_samples(&scan, scene.samples(5, &spec).unwrap(), &WriteSpec::for_path(&scan)).unwrap();
    to_archive(scan, at);
    let base = ["route", "a.slices", "--from", "-1,0.3,0.1", "--to", "2.4,-0.3,1.1"];
    let found = json(&done(at, &[&base[..], &["-o", "route.csv", "--json"]].concat()));
    assert_eq!((&found["found"], found["reason"].is_null()), (&true.into(), true));
    let length = found["length_m"].as_f64().unwrap();
    assert!((3.45..3.8).contains(&length) && found["seconds"].is_number(), "{found}");
    let csv = fs::read_to_string(at.join("route.csv")).unwrap();
    assert!(csv.starts_with("x,y,z\n") && csv.lines().count() >= 3, "{csv}");
    assert_eq!(done(at, &base), csv, "without an output the way is the result");
    let walked = done(
        at,
        &["walk", "a.slices", "--start", "-1,0.3,0.1", "--waypoints", "route.csv", "-o", "path.csv", "--json"],
    );
    assert_eq!(json(&walked)["state"], "arrived");
    // The step is too high: there is no route, which is a valid answer.
    let refused = json(&done(at, &[&base[..], &["--climb", "0.1", "--json"]].concat()));
    assert_eq!((&refused["found"], &refused["reason"]), (&false.into(), &"not_connected".into()));
    assert!(refused["length_m"].is_null());
    let refused = json(&done(at, &["route", "a.slices", "--from", "-1,9,0", "--to", "2.4,0,1", "--json"]));
    assert_eq!(refused["reason"], "not_standing_from");
    // In the first riser, too close to the wall of the next step for the body.
    let refused = json(&done(at, &["route", "a.slices", "--from", "-1,0,0", "--to", "2.4,0,-3", "--json"]));
    assert_eq!(refused["reason"], "not_standing_to");
}

/// A floor of 190 × 20 m, with or without overview levels.
fn long_floor(levels: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("floor.las");
    let middle = |n: i32| 0.2 * f64::from(n) + 0.1;
    let floor = (0..950).flat_map(|i| (-50..50).map(move |j| [middle(i), middle(j), 0.0]));
    write_las(&scan, floor, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
    (options.grid.pixel, options.resources.threads, options.sections.levels) = (PixelSize::Metres(0.2), 1, levels);
    convert(&options, &NoMonitor).unwrap();
    folder
}

#[test]
fn a_long_route_is_planned_on_levels_first_and_a_coarse_one_says_that_it_is() {
    let base = ["route", "a.slices", "--from", "2,3,0.1", "--to", "187,-6,0.1", "--json"];
    let straight = f64::hypot(185.0, 9.0);
    let folder = long_floor(true);
    let at = folder.path();
    let found = json(&done(at, &[&base[..], &["--coarse"]].concat()));
    assert!(found["found"] == true && found["level"].as_u64().is_some_and(|level| level >= 1), "{found}");
    let length = |found: &serde_json::Value| found["length_m"].as_f64().unwrap_or_else(|| panic!("{found}"));
    assert!((straight..1.1 * straight).contains(&length(&found)), "{found}");
    let found = json(&done(at, &[&base[..], &["-o", "route.csv"]].concat()));
    assert!(found["found"] == true && found["level"].is_null(), "{found}");
    assert!((straight - 0.3..1.05 * straight).contains(&length(&found)), "{found}");
    let walk = ["walk", "a.slices", "--start", "2,3,0.1", "--waypoints", "route.csv", "-o", "path.csv", "--json"];
    assert_eq!(json(&done(at, &walk))["state"], "arrived");
    // Ends beside the floor are moved onto it, as those of an exact route are.
    let beside = ["route", "a.slices", "--from", "2,10.4,0.1", "--to", "187,-10.4,0.1", "--json"];
    let [exact, coarse] =
        [&beside[..], &[&beside[..], &["--coarse"]].concat()].map(|arguments| json(&done(at, arguments)));
    for end in ["from", "to"] {
        assert_eq!(coarse[end], exact[end]);
        assert!(coarse[end]["moved"].as_f64().is_some_and(|moved| (0.1..0.5).contains(&moved)), "{coarse}");
    }
    assert!(coarse["found"] == true && coarse["level"].is_number(), "{coarse}");
    let off = json(&done(at, &[&beside[..], &["--coarse", "--snap", "0"]].concat()));
    assert_eq!((&off["found"], &off["reason"]), (&false.into(), &"not_standing_from".into()));
    let folder = long_floor(false);
    let at = folder.path();
    let found = json(&done(at, &base));
    assert!((straight - 0.3..1.05 * straight).contains(&length(&found)), "{found}");
    let out = slicetool(at, &[&base[..], &["--coarse"]].concat());
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code() == Some(1) && said.contains("--levels on") && said.lines().count() == 1, "{said}");
    // One page has no levels, whatever the conversion was asked for.
    fs::write(at.join("small.xyz"), "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    let mut options = ConvertOptions::new(vec![at.join("small.xyz")], at.join("small.slices"));
    (options.grid.pixel, options.reading.units, options.sections.levels) =
        (PixelSize::Metres(0.1), Units::Factor(1.0), true);
    convert(&options, &NoMonitor).unwrap();
    let out = slicetool(at, &["route", "small.slices", "--from", "0,0,0.1", "--to", "1,0,0.1", "--coarse"]);
    let said = String::from_utf8(out.stderr).unwrap();
    let reason = "small.slices: it is too small for overview levels; leave out --coarse\n";
    assert!(out.status.code() == Some(1) && said.ends_with(reason), "{said}");
}

/// A house blocks the straight line: levels show the way around it, and no shorter route is searched farther out.
#[test]
fn a_route_planned_on_levels_leads_around_a_house_and_is_as_short_as_one_without_levels() {
    const PIXEL: f64 = 0.05;
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let middle = |n: i32| PIXEL * (f64::from(n) + 0.5);
    let is_house = |i: i32, j: i32| (340..580).contains(&i) && (80..840).contains(&j);
    let is_wall = |i: i32, j: i32| {
        is_house(i, j) && [(-1, 0), (1, 0), (0, -1), (0, 1)].iter().any(|way| !is_house(i + way.0, j + way.1))
    };
    let columns = (0..920).flat_map(|i| (0..920).map(move |j| (i, j)));
    let points = columns.flat_map(|(i, j)| {
        let heights = match (is_wall(i, j), is_house(i, j)) {
            (true, _) => 0..160,
            (_, true) => 159..160,
            _ => 0..1,
        };
        heights.map(move |k| [middle(i), middle(j), PIXEL * f64::from(k)])
    });
    let scan = at.join("scan.las");
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let routes = [true, false].map(|levels| {
        let mut options = ConvertOptions::new(vec![scan.clone()], at.join(format!("{levels}.slices")));
        (options.grid.pixel, options.resources.threads, options.sections.levels) =
            (PixelSize::Metres(PIXEL), 1, levels);
        convert(&options, &NoMonitor).unwrap();
        let archive = format!("{levels}.slices");
        json(&done(at, &["route", &archive, "--from", "2,21,0.1", "--to", "44,25,0.1", "--json"]))
    });
    let number = |found: &serde_json::Value, key: &str| found[key].as_f64().unwrap_or_else(|| panic!("{found}"));
    let [length, shortest] = routes.each_ref().map(|found| number(found, "length_m"));
    assert!(shortest > 1.3 * 42.0 && (0.99..1.05).contains(&(length / shortest)), "{routes:?}");
    let [bytes, most] = routes.each_ref().map(|found| number(found, "memory_bytes"));
    assert!(bytes < most, "{routes:?}");
}

#[test]
fn answers_that_rest_on_inferred_floor_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let middle = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = (0..80).flat_map(|i| (0..80).map(move |j| [middle(i), middle(j), 1.0]));
    let floor = floor.filter(|[x, y, _]| !((1.8..2.2).contains(x) && (1.8..2.2).contains(y)));
    let scan = at.join("scan.las");
    write_las(&scan, floor, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], at.join("a.slices"));
    (options.grid.pixel, options.resources.threads, options.grid.fill_holes) =
        (PixelSize::Metres(0.1), 1, Some(HoleWidth::Metres(0.6)));
    convert(&options, &NoMonitor).unwrap();
    let answers = |table: &str, rows: &str, more: &[&str]| -> Vec<Vec<String>> {
        fs::write(at.join("q.csv"), rows).unwrap();
        let said = done(at, &[&["query", "a.slices", table, "q.csv"], more].concat());
        said.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let boxes =
        "xmin,ymin,zmin,xmax,ymax,zmax\n0.5,0.5,0.9,0.9,0.9,1.1\n1.9,1.9,0.9,2.1,2.1,1.1\n1.9,1.9,1.5,2.1,2.1,2.0\n";
    let found = answers("--boxes", boxes, &["--show-inferred"]);
    let last = |rows: &[Vec<String>]| -> Vec<String> { rows.iter().map(|row| row[row.len() - 1].clone()).collect() };
    // The last place is in the air; the floor below it counts.
    assert_eq!(last(&found), ["inferred", "0", "1", "1"]);
    let hits = |rows: &[Vec<String>]| -> Vec<String> { rows[1..].iter().map(|row| row[6].clone()).collect() };
    assert_eq!(hits(&found), ["1", "1", "0"]);
    assert_eq!(hits(&answers("--boxes", boxes, &["--ignore-inferred"])), ["1", "0", "0"]);
    let rays = "x,y,z,dx,dy,dz,max\n0.7,0.7,2,0,0,-1,5\n2,2,2,0,0,-1,5\n";
    assert_eq!(last(&answers("--rays", rays, &["--show-inferred"])), ["inferred", "0", "1"]);
    let wrong = ["query", "a.slices", "--boxes", "q.csv", "--show-inferred", "--ignore-inferred"];
    assert_eq!(slicetool(at, &wrong).status.code(), Some(2));
}

#[test]
fn a_walk_with_max_drop_stops_before_a_hole() {
    let folder = room();
    let at = folder.path();
    fs::write(at.join("w.csv"), "x,y,z\n7.5,2,1\n").unwrap();
    let walk = |more: &[&str]| {
        let base = ["walk", "a.slices", "--start", "4.6,2,1.05", "--waypoints", "w.csv", "-o", "path.csv", "--json"];
        let out = slicetool(at, &[&base[..], &["--max-seconds", "10"], more].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        let found = json(std::str::from_utf8(&out.stdout).unwrap());
        (found["state"].as_str().unwrap().to_owned(), found["end"][2].as_f64().unwrap(), out.status.code(), said)
    };
    let (state, z, code, said) = walk(&["--max-drop", "0.5"]);
    assert!(state == "blocked" && (z - 1.0).abs() < 0.01, "{state} at {z} m");
    // The hole goes through the scan, so nothing was scanned below it.
    assert!(code == Some(1) && said.lines().count() == 1 && said.contains("nothing was scanned ahead"), "{said}");
    // Without a limit it falls out of the scan, and no farther.
    let (state, z, code, said) = walk(&[]);
    assert!(state == "falling" && (-1.0..0.0).contains(&z) && code == Some(0), "{state} at {z} m");
    assert!(said.lines().count() == 1 && said.contains("fell out of the scan"), "{said}");
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let folder = room();
    let at = folder.path();
    for wrong in [
        &["reach", "a.slices"][..],
        &["reach", "a.slices", "--from", "1,2"],
        &["reach", "a.slices", "--from", "1,2,1", "--pawn", "cone:1x1"],
        &["reach", "a.slices", "--from", "1,2,1", "--climb", "2"],
        &["reach", "a.slices", "--from", "1,2,1", "--max-drop", "-1"],
        &["reach", "a.slices", "--from", "1,2,1", "--max-grade", "0"],
        &["route", "a.slices", "--from", "1,2,1", "--to", "2,2,1", "--max-ramp", "-1"],
        &["route", "a.slices", "--from", "1,2,1"],
        &["route", "a.slices", "--from", "1,2,1", "--to", "2,2,1", "--pawn", "box:2000x1x1"],
        &["reach", "a.slices", "--from", "1,2,1", "--pawn", "box:50x50x1"],
        &["reach", "a.slices", "--from", "1,1,1", "--cache", "0"],
    ] {
        let out = slicetool(at, wrong);
        let text = String::from_utf8(out.stderr).unwrap();
        // The message names the last option, or the one that is missing.
        let option = wrong.iter().rfind(|word| word.starts_with("--")).unwrap_or(&"--from");
        assert!(out.status.code() == Some(2), "{wrong:?}: {text}");
        assert!(text.contains(option) || text.contains("--to"), "{wrong:?}: {text}");
    }
    let before = fs::read(at.join("a.slices")).unwrap();
    for (wrong, said) in [
        (&["reach", "a.slices", "--from", "50,50,1"][..], "cannot stand"),
        (&["reach", "a.slices", "--from", "6,2,1", "--snap", "0.2"], "cannot stand"),
        (&["reach", "a.slices", "--from", "1,1,1", "-o", "out.bmp"], ".geojson"),
        (&["reach", "a.slices", "--from", "1,1,1", "-o", "none/out.csv"], "out.csv"),
        (&["reach", "none.slices", "--from", "1,1,1"], "none.slices"),
        (&["route", "a.slices", "--from", "1,1,1", "--to", "2,1,1", "-o", "a.slices"], "a.slices"),
        (&["reach", "a.slices", "--from", "1,1,1", "--cache", "1KiB"], "too few"),
    ] {
        let out = slicetool(at, wrong);
        let text = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(1), "{wrong:?}: {text}");
        assert!(text.contains(said) && text.lines().count() == 1 && out.stdout.is_empty(), "{wrong:?}: {text}");
    }
    assert_eq!(fs::read(at.join("a.slices")).unwrap(), before);
}

#[test]
fn a_start_or_an_end_beside_a_wall_is_moved_to_the_nearest_place_and_says_by_how_much() {
    let folder = room();
    let at = folder.path();
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{value}: no number"));
    // 10 cm from one wall and 15 cm from another: the middle of the pawn stays 25 cm from both. The other end is in the
    // wall, below the floor.
    let route = ["route", "a.slices", "--from", "1,0.1,1.5", "--to", "7.85,3,0.8", "--json"];
    let found = json(&done(at, &route));
    assert_eq!(found["found"], true, "{found}");
    let (from, to) = (&found["from"], &found["to"]);
    assert!((0.1..0.26).contains(&number(&from["moved"])) && (number(&from["y"]) - 0.3).abs() < 0.06, "{from}");
    assert!((0.2..0.35).contains(&number(&to["moved"])) && (number(&to["x"]) - 7.7).abs() < 0.06, "{to}");
    let stays = json(&done(at, &["route", "a.slices", "--from", "1,1,1.5", "--to", "3,3,1", "--json"]));
    assert_eq!([&stays["from"]["moved"], &stays["to"]["moved"]], [0.0, 0.0]);
    let off = json(&done(at, &[&route[..], &["--snap", "0"]].concat()));
    assert_eq!((&off["found"], &off["reason"]), (&false.into(), &"not_standing_from".into()));
    let reach = json(&done(at, &["reach", "a.slices", "--from", "1,0.1,1.5", "--to", "7.85,3,0.8", "--json"]));
    assert_eq!((&reach["from"], &reach["to"]), (from, to));
    assert!(!slicetool(at, &["reach", "a.slices", "--from", "1,0.1,1.5", "--snap", "0.05"]).status.success());
    assert_eq!(slicetool(at, &["reach", "a.slices", "--from", "1,1,1", "--snap", "-1"]).status.code(), Some(2));
    fs::write(at.join("way.csv"), "x,y\n1,2\n").unwrap();
    let walk = ["walk", "a.slices", "--start", "1,0.1,1", "--waypoints", "way.csv", "-o", "path.csv", "--json"];
    let walked = json(&done(at, &walk));
    assert_eq!((&walked["from"]["moved"], &walked["state"]), (&from["moved"], &"arrived".into()));
}

/// Two floors of 4 × 4 m, at z = 1 and z = 4, within walls.
fn storeys() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |n: i32| f64::from(n) * 0.025 + 0.0125;
    let floors = (0..160).flat_map(|i| (0..160).flat_map(move |j| [1.0, 4.0].map(|z| [at(i), at(j), z])));
    let sides = (0..160).flat_map(|i| [0.01, 3.99].into_iter().flat_map(move |wall| [(wall, at(i)), (at(i), wall)]));
    let walls = sides.flat_map(|(x, y)| (0..200).map(move |k| [x, y, 1.0 + f64::from(k) * 0.025]));
    let scan = folder.path().join("scan.las");
    write_las(&scan, floors.chain(walls), &WriteSpec::for_path(&scan)).unwrap();
    to_archive(scan, folder.path());
    folder
}

#[test]
fn a_last_waypoint_beside_a_wall_is_moved_to_the_nearest_place_of_its_floor() {
    let folder = storeys();
    let at = folder.path();
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{value}: no number"));
    let walk = |start: &str, waypoints: &str, more: &[&str]| {
        fs::write(at.join("way.csv"), waypoints).unwrap();
        let walk = ["walk", "a.slices", "--start", start, "--waypoints", "way.csv", "-o", "path.csv", "--json"];
        let out = slicetool(at, &[&walk[..], more].concat());
        json(&String::from_utf8(out.stdout).unwrap())
    };
    for z in [1.0, 4.0] {
        let start = format!("1,2,{z}");
        let walked = ["x,y\n3,1\n2,0.1\n".to_owned(), format!("x,y,z\n2,0.1,{z}\n"), format!("3,1\n2,0.1,{z}\n")]
            .map(|waypoints| walk(&start, &waypoints, &[]));
        for found in &walked {
            let to = &found["to"];
            assert_eq!(found["state"], "arrived", "{found}");
            assert!((0.1..0.26).contains(&number(&to["moved"])) && (number(&to["y"]) - 0.3).abs() < 0.06, "{to}");
            assert!((number(&to["z"]) - z).abs() < 0.01 && (number(&to["x"]) - 2.0).abs() < 0.06, "{to}");
            assert_eq!((&found["end"][0], &found["end"][1]), (&to["x"], &to["y"]));
            assert_eq!(to, &walked[0]["to"]);
        }
        // Where the pawn can stand, nothing moves.
        for waypoints in ["2,2.013\n".to_owned(), format!("2,2.013,{z}\n"), format!("2,2.013,{}\n", z + 0.5)] {
            let found = walk(&start, &waypoints, &[]);
            assert_eq!((number(&found["to"]["y"]), number(&found["to"]["moved"])), (2.013, 0.0));
            assert!((number(&found["to"]["z"]) - z).abs() < 0.01 && found["state"] == "arrived", "{found}");
        }
        for (waypoints, z) in [("2,0.1\n".to_owned(), None), (format!("2,0.1,{z}\n"), Some(z))] {
            let off = walk(&start, &waypoints, &["--snap", "0"]);
            assert_eq!((&off["state"], off["to"]["z"].as_f64()), (&"blocked".into(), z));
            assert_eq!((number(&off["to"]["y"]), number(&off["to"]["moved"])), (0.1, 0.0));
        }
    }
    let far = walk("1,2,1", "2,-1\n", &[]);
    assert_eq!((&far["state"], &far["to"]["moved"]), (&"blocked".into(), &0.0.into()));
}
