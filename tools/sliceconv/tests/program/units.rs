//! Units and reference systems of inputs: what archives record of them, and the messages when they do not match.

use crate::scans;

use scangen::{WriteSpec, write_las};
use scans::{converts, points, refuses, sliceconv, write};
use serde_json::{Value, json};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, MAX_UNITS, merge};
use slicewalk::unit::US_SURVEY_FOOT_M;
use slicewalk_convert::info;
use std::fs;
use std::path::Path;

const FEET: &str =
    r#"PROJCS["Texas Central",GEOGCS["G",UNIT["degree",0.0174532925]],UNIT["US survey foot",0.304800609601219]]"#;
const METRES: &str = r#"PROJCS["UTM 33N",GEOGCS["G",UNIT["degree",0.0174532925]],UNIT["metre",1]]"#;

/// Points around `(east, 0, 0)`, in a reference system.
fn scan(folder: &Path, name: &str, crs: &str, east: f64) {
    let path = folder.join(name);
    let spec = WriteSpec { crs_wkt: Some(crs.into()), offset: [east, 0.0, 0.0], ..WriteSpec::for_path(&path) };
    let near = points(2000).into_iter().filter(|point| point.iter().all(|v| v.abs() < 100.0));
    write_las(&path, near.map(|[x, y, z]| [x + east, y, z]), &spec).unwrap();
}

fn unit_of(folder: &Path, name: &str) -> Value {
    info::info(&Archive::open(folder.join(name)).unwrap()).unwrap()["unit"].clone()
}

const OPTIONS: [&str; 4] = ["--pixel", "0.1", "--force", "-o"];

#[test]
fn the_unit_applied_is_recorded_and_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "feet.las", FEET, 0.0);
    scan(at, "metres.las", METRES, 0.0);
    let with_heights = format!(r#"COMPD_CS["C",{METRES},VERT_CS["V",UNIT["foot",0.3048]]]"#);
    scan(at, "heights.las", &with_heights, 0.0);
    scan(at, "degrees.las", r#"GEOGCS["G",UNIT["degree",0.0174532925199433]]"#, 0.0);
    let with_depths = format!(r#"COMPD_CS["C",{METRES},VERT_CS["V",UNIT["metre",1],AXIS["Depth",DOWN]]]"#);
    scan(at, "depths.las", &with_depths, 0.0);
    write(&at.join("plain.las"), &points(500));
    fs::write(at.join("floor.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let us_foot = json!({ "name": "us-ft", "factor": US_SURVEY_FOOT_M });
    let metre = json!({ "name": "m", "factor": 1.0 });
    let foot = json!({ "name": "ft", "factor": 0.3048 });
    for (inputs, expected, words) in [
        (&["feet.las"][..], us_foot.clone(), "US survey feet (0.3048006096012192 m); the archive is in metres"),
        (&["feet.las", "--units", "m"], metre.clone(), "unit of the source: metres;"),
        (&["feet.las", "--units", "m"], metre.clone(), "feet.las: it states a unit of 0.30480060960121"),
        (&["feet.las", "--units", "ft"], foot.clone(), "feet (0.3048 m);"),
        (&["heights.las", "--units", "m"], metre.clone(), "it states a unit of 0.3048 m; the given one, 1 m, counts"),
        (&["degrees.las", "--units", "m"], metre.clone(), "longitude and latitude in degrees"),
        (&["depths.las", "--units", "m"], metre.clone(), "its reference system counts depths, downwards"),
        (&["plain.las", "--units", "2.5"], json!({ "name": "other", "factor": 2.5 }), "units of 2.5 m;"),
        (&["plain.las"], metre.clone(), "metres;"),
        (&["floor.obj"], metre.clone(), "metres;"),
        (&["floor.obj", "--units", "ft"], foot.clone(), "feet (0.3048 m);"),
        (
            &["heights.las"],
            json!({ "name": "m", "factor": 1.0, "vertical": foot }),
            "metres, heights in feet (0.3048 m);",
        ),
        (
            &["feet.las", "floor.obj", "metres.las"],
            json!({ "name": "mixed", "factor": null, "units": [us_foot, metre] }),
            "US survey feet (0.3048006096012192 m); metres;",
        ),
    ] {
        let said = converts(at, &[inputs, &OPTIONS, &["a.slices"]].concat());
        assert!(said.contains(words), "{inputs:?}: {said}");
        assert_eq!(unit_of(at, "a.slices"), expected, "{inputs:?}");
        let out = sliceconv(at, &[inputs, &OPTIONS, &["a.slices", "--json", "--quiet"]].concat());
        assert_eq!(serde_json::from_slice::<Value>(&out.stdout).unwrap()["unit"], expected, "{inputs:?}");
    }
    let archive = Archive::open(at.join("a.slices")).unwrap();
    assert_eq!(info::info(&archive).unwrap()["crs"], FEET, "the source's system, in its own unit");
    // The unit of a given system is not that of a file.
    for inputs in [&["plain.las", "--units", "m", "--crs", "EPSG:2277"][..], &["metres.las", "--units", "m"]] {
        let said = converts(at, &[inputs, &OPTIONS, &["a.slices"]].concat());
        assert!(!said.contains("it states a unit"), "{inputs:?}: {said}");
    }
}

#[test]
fn heights_are_in_the_unit_that_the_vertical_axis_states() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let feet = r#"UNIT["Foot_US",0.3048006096012192]"#;
    for (number, wkt) in [
        format!(r#"{METRES},VERTCS["V",VDATUM["D"],PARAMETER["Direction",1.0],{feet}]"#),
        format!(r#"COMPD_CS["C",{METRES}],VERT_CS["V",VERT_DATUM["D",2005],{feet},AXIS["Up",UP]]]"#),
        r#"PROJCRS["P",CS[Cartesian,3],AXIS["E",east,LENGTHUNIT["metre",1]],AXIS["N",north,LENGTHUNIT["metre",1]],
           AXIS["h",up,LENGTHUNIT["US survey foot",0.304800609601219]]]"#
            .into(),
    ]
    .iter()
    .enumerate()
    {
        let name = format!("{number}.las");
        scan(at, &name, wkt, 0.0);
        converts(at, &[&[&name[..]], &OPTIONS[..], &["a.slices"]].concat());
        let vertical = json!({ "name": "us-ft", "factor": US_SURVEY_FOOT_M });
        assert_eq!(unit_of(at, "a.slices"), json!({ "name": "m", "factor": 1.0, "vertical": vertical }), "{wkt}");
    }
}

#[test]
fn parts_and_extracts_keep_the_unit() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "feet.las", FEET, 0.0);
    converts(at, &[&["feet.las"], &OPTIONS[..], &["whole.slices"]].concat());
    let parts = ["1/2", "2/2"].map(|shard| {
        let name = shard.replace('/', "-of-");
        converts(at, &[&["feet.las"], &OPTIONS[..], &[&name, "--shard", shard]].concat());
        at.join(name)
    });
    merge(&parts, &at.join("merged.slices"), false, &NoMonitor).unwrap();
    assert!(fs::read(at.join("merged.slices")).unwrap() == fs::read(at.join("whole.slices")).unwrap());
    let whole = Archive::open(at.join("whole.slices")).unwrap();
    slicewalk::archive::extract(&whole, &([0.0; 3], [1.0; 3]), &at.join("cut.slices"), false, &NoMonitor).unwrap();
    assert_eq!(unit_of(at, "cut.slices")["name"], "us-ft");
}

#[test]
fn units_that_no_scan_has_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for size in ["1e-7", "0", "-1", "20000"] {
        scan(at, "odd.las", &format!(r#"PROJCS["P",UNIT["odd",{size}]]"#), 0.0);
        let said = refuses(at, &["odd.las", "-o", "a.slices", "--pixel", "0.1"], 1);
        assert!(said.contains("odd.las: reference system") && said.contains("--units"), "{said}");
        converts(at, &["odd.las", "-o", "a.slices", "--pixel", "0.1", "--units", "m", "--force"]);
    }
    scan(at, "odd.las", r#"PROJCS["P",UNIT["millimetre",0.001]]"#, 0.0);
    converts(at, &["odd.las", "-o", "a.slices", "--pixel", "0.0001", "--force"]);
}

#[test]
fn more_units_than_an_archive_records_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("many")).unwrap();
    for number in 0..=MAX_UNITS {
        let path = at.join(format!("many/{number}.las"));
        let crs = format!(r#"LOCAL_CS["L",UNIT["odd",{}]]"#, 0.3 + number as f64 / 1000.0);
        write_las(&path, [[0.0; 3]], &WriteSpec { crs_wkt: Some(crs), ..WriteSpec::for_path(&path) }).unwrap();
    }
    let many = ["many", "-o", "a.slices", "--pixel", "0.1"];
    let said = refuses(at, &many, 1);
    assert!(said.contains("different units of inputs: 257") && said.contains("--units"), "{said}");
    converts(at, &[&many[..], &["--units", "m"]].concat());
}

#[test]
fn different_systems_and_scenes_far_apart_are_warned_of_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "a.las", METRES, 0.0);
    scan(at, "b.las", METRES, 30.0);
    scan(at, "far.las", METRES, 500_000.0);
    scan(at, "feet.las", FEET, 0.0);
    fs::write(at.join("local.obj"), "v 9e5 0 0\nv 900001 0 0\nv 9e5 1 0\nf 1 2 3\n").unwrap();
    let said = |inputs: &[&str], more: &[&str]| converts(at, &[inputs, more, &OPTIONS, &["a.slices"]].concat());
    assert!(!said(&["a.las", "b.las"], &[]).contains("warning"));
    let turned = said(&["a.las"], &["--up", "y"]);
    assert!(turned.contains("its y axis is turned upwards, and the archive keeps the system"), "{turned}");
    for up in ["x", "-z", "auto"] {
        let refused = refuses(at, &[&["a.las", "--up", up], &OPTIONS[..], &["no.slices"]].concat(), 2);
        assert!(refused.contains("a.las: it states a reference system, in which z is up"), "{refused}");
    }
    let systems = said(&["a.las", "b.las", "feet.las"], &[]);
    assert!(systems.contains("feet.las (Texas Central) and a.las and 1 more (UTM 33N) state different"), "{systems}");
    let far = said(&["a.las", "b.las", "far.las"], &[]);
    assert!(far.contains("b.las and far.las lie 500 km apart"), "{far}");
    let far = said(&["a.las", "b.las", "local.obj"], &[]);
    assert!(far.contains("b.las and local.obj lie 900 km apart"), "{far}");
    for more in [&["--write-plan", "p.json"][..], &["--dry-run"]] {
        let said = converts(at, &[&["a.las", "far.las", "--pixel", "0.1"], more].concat());
        assert!(said.contains("a.las and far.las lie 500 km apart"), "{said}");
    }
    // A plan edited by hand that states no system.
    let mut plan: Value = serde_json::from_slice(&fs::read(at.join("p.json")).unwrap()).unwrap();
    plan["stated"]["reference_system"] = Value::Null;
    fs::write(at.join("q.json"), plan.to_string()).unwrap();
    let part = ["a.las", "far.las", "--plan", "q.json", "--shard", "1/2", "-o", "part.slices"];
    let refused = refuses(at, &part, 1);
    assert!(refused.contains("the inputs have another reference system than it states"), "{refused}");
    // A dry run names meshes by their length.
    let out = sliceconv(at, &["local.obj", "--pixel", "0.1", "--units", "m", "--dry-run", "--json"]);
    let facts: Value = serde_json::from_slice(&out.stdout).unwrap();
    let bytes = fs::metadata(at.join("local.obj")).unwrap().len();
    assert_eq!(facts["inputs"], json!([{ "path": "local.obj", "bytes": bytes, "points_stated": null, "text": null }]));
}

#[test]
fn a_given_reference_system_completes_scans_that_state_none_and_contradicts_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(&at.join("plain.las"), &points(500));
    scan(at, "named.las", METRES, 0.0);
    let coded = METRES.replace("1]]", r#"1],AUTHORITY["EPSG","32633"]]"#);
    scan(at, "coded.las", &coded, 0.0);
    fs::write(at.join("floor.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let run = |inputs: &[&str], crs: &str| {
        let said = converts(at, &[inputs, &["--crs", crs], &OPTIONS[..], &["c.slices"]].concat());
        let facts = info::info(&Archive::open(at.join("c.slices")).unwrap()).unwrap();
        (facts["crs"].as_str().unwrap().to_owned(), facts["unit"]["name"].as_str().unwrap().to_owned(), said)
    };
    let (crs, unit, said) = run(&["plain.las"], "EPSG:25832");
    assert_eq!((&crs[..], &unit[..]), ("EPSG:25832", "m"));
    assert!(!said.contains("no unit of length"), "the system has one: {said}");
    let (crs, unit, _) = run(&["plain.las"], "epsg:2277");
    assert_eq!((&crs[..], &unit[..]), ("EPSG:2277", "us-ft"));
    let few = points(200).iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect::<String>();
    fs::write(at.join("plain.xyz"), few).unwrap();
    for geographic in ["EPSG:4326", "EPSG:4167", "EPSG:4674", "EPSG:4759", "EPSG:4979", "EPSG:7844", "EPSG:9518"] {
        for name in ["plain.las", "plain.xyz"] {
            let said = run(&[name], geographic).2;
            assert!(said.contains("longitude and latitude"), "{name}, {geographic}: {said}");
        }
    }
    let said = run(&["plain.xyz"], "EPSG:900913").2;
    assert!(said.contains("the unit of EPSG:900913 is unknown") && said.contains("no unit of length"), "{said}");
    assert_eq!(run(&["floor.obj"], "EPSG:25832").0, "EPSG:25832");
    // The scan's own text is kept if it agrees, or cannot be compared.
    let (crs, _, said) = run(&["plain.las", "coded.las"], "EPSG:32633");
    assert!(crs == coded && !said.contains("reference system"), "{said}");
    let (crs, _, said) = run(&["named.las"], "EPSG:32633");
    assert!(crs == METRES && said.contains("named.las: it states the reference system UTM 33N"), "{said}");
    let both = [&["plain.las", "coded.las", "--crs", "EPSG:25832"], &OPTIONS[..], &["no.slices"]].concat();
    let said = refuses(at, &both, 1);
    assert!(said.contains("coded.las: ") && said.contains("expected EPSG:25832, found UTM 33N (EPSG:32633)"), "{said}");
    assert!(!at.join("no.slices").exists());
    for wrong in ["25832", "EPSG:", "EPSG:0", "EPSG:x", "ESRI:102100", "é"] {
        let said = refuses(at, &["plain.las", "-o", "no.slices", "--crs", wrong], 2);
        assert!(said.contains("--crs") && said.contains("EPSG:25832"), "{said}");
    }
    // A plan fixes it: parts must not differ.
    converts(at, &["plain.las", "--pixel", "0.1", "--crs", "EPSG:25832", "--write-plan", "plan.json"]);
    converts(at, &["plain.las", "--plan", "plan.json", "-o", "planned.slices"]);
    assert_eq!(Archive::open(at.join("planned.slices")).unwrap().crs().unwrap(), "EPSG:25832");
    let other = ["plain.las", "--plan", "plan.json", "--crs", "EPSG:25833", "-o", "no.slices"];
    assert!(refuses(at, &other, 2).contains("--crs: contradicts the plan"));
}
