//! Axes and placement of the input: `--up auto` finds the floor of tilted scans and splats or refuses, `--transform`
//! moves every kind of input alike, and parts of placed splats merge to the bytes of one run.

use crate::scans;
use crate::splats::{Splat, write};

use scangen::{Params, SampleSpec, Scene, Truth};
use scans::{Random, converts, merges_to, refuses, sliceconv, text, verifies};
use serde_json::Value;
use slicewalk::archive::Archive;
use std::fs;
use std::path::Path;

type Vec3 = [f64; 3];

/// Rotation by a quaternion w, x, y, z of length 1, as the sandwich product.
fn turned(q: [f64; 4], v: Vec3) -> Vec3 {
    let [_, x, y, z] = product(product(q, [0.0, v[0], v[1], v[2]]), [q[0], -q[1], -q[2], -q[3]]);
    [x, y, z]
}

fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / length)
}

/// A house: furniture on its floors, walls in all directions.
fn house() -> Scene {
    Scene::named("house", &Params::new().with("width", 10.0).with("depth", 9.0).with("storeys", 1.0)).unwrap()
}

/// Flat splats on the surfaces of a scene, turned about the origin.
fn splats(scene: &Scene, count: u64, q: [f64; 4]) -> Vec<Splat> {
    let mut random = Random(3);
    let samples = scene.samples(5, &SampleSpec::direct_count(count)).unwrap();
    samples
        .map(|sample| {
            let [nx, ny, nz] = scene.surfaces()[sample.surface as usize].shape.normal_at(sample.position);
            // Turns z to the normal.
            let to = if nz > -0.999 { unit([1.0 + nz, -ny, nx, 0.0]) } else { [0.0, 1.0, 0.0, 0.0] };
            let mut size = || 0.03 + 0.05 * random.uniform();
            (turned(q, sample.position), [size(), size(), 0.004], product(q, to), 0.8)
        })
        .collect()
}

fn facts(folder: &Path, arguments: &[&str]) -> Value {
    let out = sliceconv(folder, arguments);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

/// Rotations of an upright scene: none, y up, y down, x up, and tilted by 25° and more about a slanted axis.
fn poses() -> Vec<[f64; 4]> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let mut all = vec![[1.0, 0.0, 0.0, 0.0], [half, -half, 0.0, 0.0], [half, half, 0.0, 0.0], [half, 0.0, half, 0.0]];
    all.extend([unit([1.0, 0.2, -0.1, 0.3]), unit([half, -half, 0.15, 0.1]), unit([0.1, 0.9, 0.2, 0.3])]);
    all
}

#[test]
#[ignore = "slow: .ci/run"]
fn the_floor_shows_which_way_is_up() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = house();
    for (number, q) in poses().into_iter().enumerate() {
        write(&at("room.ply"), &splats(&scene, 20_000, q));
        let points = scene.points(6, &SampleSpec::direct_count(60_000).with_noise(0.003)).unwrap();
        let lines: Vec<String> =
            points.map(|p| turned(q, p)).map(|[x, y, z]| format!("{x:.4} {y:.4} {z:.4}\n")).collect();
        fs::write(at("room.xyz"), lines.concat()).unwrap();
        let expected = turned(q, [0.0, 0.0, 1.0]);
        for input in ["room.ply", "room.xyz"] {
            let fixed = [input, "--up", "auto", "--units", "m", "--pixel", "0.1", "--json", "--threads", "2"];
            let seen = facts(folder.path(), &[&fixed[..], &["--dry-run"]].concat());
            let up = &seen["up_auto"];
            let found = [0, 1, 2].map(|axis| up["direction"][axis].as_f64().unwrap());
            let along: f64 = found.iter().zip(expected).map(|(a, b)| a * b).sum();
            assert!(along > 0.999_85, "{number} {input}: {up}, expected {expected:?}");
            let sure = up["sure"].as_f64().unwrap();
            assert!((0.2..=1.0).contains(&sure), "{number} {input}: {up}");
            // As high as the house, with little beyond it; text states no bounds.
            let height = seen["extent"][2].as_f64();
            assert_eq!(height.is_some(), input == "room.ply");
            assert!(height.is_none_or(|height| (2.9..3.6).contains(&height)), "{number} {input}: {height:?}");
            // An upright input stays where it is.
            assert_eq!(seen["placement"].is_null(), number == 0, "{number} {input}");
            if number == 4 {
                let done = facts(folder.path(), &[&fixed[..], &["-o", "auto.slices", "--force"]].concat());
                assert_eq!((&done["up_auto"], &done["placement"]), (up, &seen["placement"]));
                // The same matrix by hand makes the same archive.
                let matrix = seen["placement"].as_array().unwrap();
                let text: Vec<String> = matrix.iter().map(|v| v.to_string()).collect();
                fs::write(at("m.txt"), text.join(" ")).unwrap();
                let by_hand = [input, "--units", "m", "--pixel", "0.1", "--quiet", "--force", "--transform", "m.txt"];
                converts(folder.path(), &[&by_hand[..], &["-o", "hand.slices"]].concat());
                let (a, b) = (Archive::open(at("auto.slices")).unwrap(), Archive::open(at("hand.slices")).unwrap());
                let (a, b) = (a.header().voxels.occupied as f64, b.header().voxels.occupied as f64);
                assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
                // Threads and memory change nothing, and the line says so.
                let other = [input, "--up", "auto", "--units", "m", "--pixel", "0.1", "--threads", "1", "--force"];
                let said =
                    converts(folder.path(), &[&other[..], &["-o", "other.slices", "--memory", "64MiB"]].concat());
                assert!(fs::read(at("auto.slices")).unwrap() == fs::read(at("other.slices")).unwrap());
                assert!(said.lines().any(|line| line.contains("--up auto: ") && line.contains("% sure")), "{said}");
            }
        }
    }
}

#[test]
fn a_scan_that_stands_upright_stays_so() {
    let folder = tempfile::tempdir().unwrap();
    let points: Vec<Vec3> = house().points(6, &SampleSpec::direct_count(30_000).with_noise(0.003)).unwrap().collect();
    scans::write(&folder.path().join("room.las"), &points);
    let fixed = ["room.las", "--up", "auto", "--units", "m", "--pixel", "0.1", "--json", "--dry-run"];
    let seen = facts(folder.path(), &fixed);
    assert!(seen["placement"].is_null() && seen["up_auto"]["axis"] == "z", "{seen}");
}

#[test]
fn a_direction_that_is_not_sure_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Six equal faces, and noise in the air: nothing says which is the floor.
    let mut random = Random(4);
    let mut lines = String::new();
    for number in 0..30_000 {
        let mut place = [0; 3].map(|_| 4.0 * random.uniform());
        place[number % 3] = if number / 3 % 2 == 0 { 0.0 } else { 4.0 };
        lines += &format!("{:.3} {:.3} {:.3}\n", place[0], place[1], place[2]);
    }
    fs::write(at("cube.xyz"), &lines).unwrap();
    let fixed = ["cube.xyz", "--units", "m", "--pixel", "0.1", "-o", "out.slices"];
    let line = refuses(folder.path(), &[&fixed[..], &["--up", "auto"]].concat(), 1);
    assert!(line.contains("--up auto: ") && line.contains("--up x, y, z") && line.contains("--transform"), "{line}");
    let cloud: String =
        (0..5_000).map(|_| [0; 3].map(|_| format!("{:.3}", random.uniform())).join(" ") + "\n").collect();
    fs::write(at("cloud.xyz"), cloud).unwrap();
    refuses(folder.path(), &["cloud.xyz", "--units", "m", "--pixel", "0.1", "--up", "auto", "-o", "out.slices"], 1);
    fs::write(at("few.xyz"), "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    refuses(folder.path(), &["few.xyz", "--units", "m", "--pixel", "0.1", "--up", "auto", "-o", "out.slices"], 1);
    // A wall alone has two sides.
    let wall: String =
        (0..6400).map(|n| format!("0 {:.2} {:.2}\n", 0.05 * f64::from(n % 80), 0.05 * f64::from(n / 80))).collect();
    fs::write(at("wall.xyz"), wall).unwrap();
    let wall = ["wall.xyz", "--units", "m", "--pixel", "0.1", "--up", "auto", "-o", "out.slices"];
    let line = refuses(folder.path(), &wall, 1);
    assert!(line.contains("floor and ceiling look alike: up is x or -x"), "{line}");
    assert!(!at("out.slices").exists());
    // By hand it works, in every direction.
    for up in ["x", "-x", "y", "-y", "z", "-z"] {
        converts(folder.path(), &[&fixed[..], &["--quiet", "--force", "--up", up]].concat());
    }
    // Meshes are not turned silently by half.
    fs::write(at("mesh.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    for up in ["auto", "x", "-y"] {
        let mixed = ["cube.xyz", "mesh.obj", "--units", "m", "--pixel", "0.1", "-o", "no.slices", "--up", up];
        let line = refuses(folder.path(), &mixed, 2);
        assert!(line.contains("mesh.obj") && line.contains("--transform"), "{line}");
    }
    assert!(!at("no.slices").exists());
    refuses(folder.path(), &[&fixed[..], &["--up", "up"]].concat(), 2);
}

/// A quarter turn about z, twice the size, and a shift: exact in floats for these places.
const MATRIX: &str = "0 -2 0 10\n2 0 0 -20\n0 0 2 0.5\n0 0 0 1\n";

fn moved([x, y, z]: Vec3) -> Vec3 {
    [10.0 - 2.0 * y, 2.0 * x - 20.0, 2.0 * z + 0.5]
}

#[test]
fn a_matrix_moves_every_input_alike() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Editors on Windows begin a text with a byte order mark.
    fs::write(at("m.txt"), format!("\u{feff}{MATRIX}")).unwrap();
    let mut random = Random(8);
    let mut draw = || [0; 3].map(|_| (random.uniform() * 4096.0).round() / 512.0);
    let points: Vec<Vec3> = (0..5_000).map(|_| draw()).collect();
    let rows = |points: &mut dyn Iterator<Item = Vec3>| -> String {
        points.map(|[x, y, z]| format!("{x} {y} {z}\n")).collect()
    };
    let mesh = |points: &mut dyn Iterator<Item = Vec3>| -> String {
        let corners: String = points.take(300).map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
        corners + &(0..100).map(|n| format!("f {} {} {}\n", 3 * n + 1, 3 * n + 2, 3 * n + 3)).collect::<String>()
    };
    fs::write(at("a.xyz"), rows(&mut points.iter().copied())).unwrap();
    fs::write(at("b.xyz"), rows(&mut points.iter().copied().map(moved))).unwrap();
    fs::write(at("a.obj"), mesh(&mut points.iter().copied())).unwrap();
    fs::write(at("b.obj"), mesh(&mut points.iter().copied().map(moved))).unwrap();
    scans::write_as(&at("a.las"), &points, 1.0 / 512.0, [0.0; 3]);
    scans::write_as(&at("b.las"), &points.iter().copied().map(moved).collect::<Vec<_>>(), 1.0 / 512.0, [0.0; 3]);
    let fixed = ["--units", "m", "--pixel", "0.1", "--quiet", "--force"];
    for inputs in [&["xyz"][..], &["obj"], &["las"], &["las", "obj", "xyz"]] {
        let names = |letter: char| inputs.iter().map(|ending| format!("{letter}.{ending}")).collect::<Vec<_>>();
        let made = |letter: char, more: &[&str], output: &str| {
            let names = names(letter);
            let inputs: Vec<&str> = names.iter().map(String::as_str).collect();
            converts(folder.path(), &[&inputs[..], &fixed, more, &["-o", output]].concat());
            fs::read(at(output)).unwrap()
        };
        let expected = made('b', &[], "b.slices");
        assert!(made('a', &["--transform", "m.txt"], "a.slices") == expected, "{inputs:?}");
        assert!(made('a', &[], "a.slices") != expected, "{inputs:?}");
        // Parts choose their files by the moved bounds.
        let parts: Vec<_> = (1..=3)
            .map(|index| {
                let (shard, name) = (format!("{index}/3"), format!("{index}.slices"));
                made('a', &["--transform", "m.txt", "--shard", &shard], &name);
                at(&name)
            })
            .collect();
        merges_to(&parts, &at("b.slices"));
    }
    // A plan keeps the matrix, and contradictions are refused.
    converts(
        folder.path(),
        &["a.las", "--units", "m", "--pixel", "0.1", "--transform", "m.txt", "--write-plan", "p.json"],
    );
    let parts: Vec<_> = (1..=2)
        .map(|index| {
            let (shard, name) = (format!("{index}/2"), format!("plan-{index}.slices"));
            converts(folder.path(), &["a.las", "--plan", "p.json", "--shard", &shard, "--quiet", "-o", &name]);
            at(&name)
        })
        .collect();
    converts(folder.path(), &[&["b.las", "-o", "b.slices"], &fixed[..]].concat());
    merges_to(&parts, &at("b.slices"));
    fs::write(at("other.txt"), MATRIX.replace("10", "11")).unwrap();
    let plan = ["a.las", "--plan", "p.json", "-o", "c.slices", "--quiet"];
    let line = refuses(folder.path(), &[&plan[..], &["--transform", "other.txt"]].concat(), 2);
    assert!(line.contains("--transform"), "{line}");
    converts(folder.path(), &[&plan[..], &["--transform", "m.txt"]].concat());
}

#[test]
#[ignore = "slow: .ci/run"]
fn parts_of_splats_merge_to_the_bytes_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let tilt = unit([1.0, 0.2, -0.1, 0.3]);
    let all = splats(&house(), 12_000, tilt);
    let (some, more) = all.split_at(5_000);
    write(&at("a.ply"), some);
    write(&at("b.ply"), more);
    let rules = ["--units", "m", "--pixel", "0.05", "--up", "auto", "--opacity", "0.2", "--max-size", "0.35"];
    for options in [&[][..], &["--colour", "rgb", "--drop-floaters", "20"]] {
        let inputs = ["*.ply", "--quiet", "--force", "--threads", "2"];
        converts(folder.path(), &[&inputs[..], &rules, options, &["-o", "whole.slices"]].concat());
        verifies(&at("whole.slices"));
        converts(folder.path(), &[&inputs[..], &rules, options, &["--write-plan", "p.json"]].concat());
        for by_plan in [true, false] {
            let parts: Vec<_> = (1..=3)
                .map(|index| {
                    let (shard, name) = (format!("{index}/3"), format!("{index}.slices"));
                    let how = if by_plan { vec!["--plan", "p.json"] } else { [&rules[..], options].concat() };
                    converts(folder.path(), &[&inputs[..], &how, &["--shard", &shard, "-o", &name]].concat());
                    verifies(&at(&name));
                    at(&name)
                })
                .collect();
            merges_to(&parts, &at("whole.slices"));
        }
        // Resuming without earlier data begins anew.
        converts(folder.path(), &[&inputs[..], &rules, options, &["--resume", "-o", "again.slices"]].concat());
        assert!(fs::read(at("again.slices")).unwrap() == fs::read(at("whole.slices")).unwrap());
    }
    let line = refuses(folder.path(), &["*.ply", "--plan", "p.json", "--opacity", "0.3", "-o", "c.slices"], 2);
    assert!(line.contains("--opacity"), "{line}");
    // Another file under the name of one of the plan.
    write(&at("b.ply"), &more[1..]);
    refuses(folder.path(), &["*.ply", "--plan", "p.json", "--shard", "1/2", "-o", text(&at("c.slices"))], 1);
}

#[test]
fn a_preview_counts_what_would_be_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let scene = house();
    write(&folder.path().join("a.ply"), &splats(&scene, 4_000, [1.0, 0.0, 0.0, 0.0]));
    let fixed = ["a.ply", "--units", "m", "--pixel", "0.1", "--max-size", "0.25", "--json"];
    let seen = facts(folder.path(), &[&fixed[..], &["--dry-run"]].concat());
    let done = facts(folder.path(), &[&fixed[..], &["-o", "a.slices"]].concat());
    for key in ["splats_read", "splats_transparent", "splats_faint", "splats_large", "splats_unusable"] {
        assert_eq!(seen[key], done[key], "{key}");
    }
    let bounds = [&seen["bounds"], &done["bounds"]];
    assert_eq!(bounds[0], bounds[1]);
    let large = done["splats_large"].as_u64().unwrap();
    assert!((100..3900).contains(&large), "{large}");
    let out = sliceconv(folder.path(), &["a.ply", "--units", "m", "--pixel", "0.1", "--max-size", "0.25", "--dry-run"]);
    let said = String::from_utf8(out.stdout).unwrap();
    let row = said.lines().find(|line| line.starts_with("splats ")).expect("a row of splats");
    assert!(row.contains("4,000 splats") && row.contains("above --max-size"), "{row}");
    // The scene's own truth: it stands on its floor.
    assert!(scene.floor_under(1.5, 2.0, 1.0).is_some());
}
