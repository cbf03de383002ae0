//! Gaussian splats: places inside their solid parts are hits (G1), order, threads and memory change nothing (G4), and
//! options leave out what they say.

use crate::scans;

use scans::{Random, converts, refuses, text, verifies};
use slicewalk::archive::Archive;
use slicewalk_convert::AUTO_PIXELS;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Centre, standard deviations, quaternion, opacity.
pub type Splat = ([f64; 3], [f64; 3], [f64; 4], f64);

fn scene(count: usize) -> Vec<Splat> {
    let mut random = Random(5);
    (0..count)
        .map(|_| {
            let mut draw = |low: f64, high: f64| low + (high - low) * random.uniform();
            let mean = [draw(-6.0, 6.0), draw(-6.0, 6.0), draw(0.0, 3.0)];
            let scale = [draw(0.02, 0.3), draw(0.02, 0.3), draw(0.002, 0.1)];
            let q = [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)];
            (mean, scale, q, draw(0.05, 0.95))
        })
        .collect()
}

/// Writes splats as 3DGS PLY.
pub fn write(path: &Path, splats: &[Splat]) {
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", splats.len()).into_bytes();
    names.split(' ').for_each(|name| bytes.extend(format!("property float {name}\n").bytes()));
    bytes.extend(b"end_header\n");
    for (mean, scale, q, opacity) in splats {
        let odds = (opacity / (1.0 - opacity)).ln();
        let row = mean.iter().copied().chain([0.5, -0.5, 0.1, odds]).chain(scale.map(f64::ln)).chain(*q);
        row.for_each(|value| bytes.extend((value as f32).to_le_bytes()));
    }
    fs::write(path, bytes).unwrap();
}

fn archive(folder: &Path, input: &str, arguments: &[&str]) -> Vec<u8> {
    let fixed = [input, "-o", "out.slices", "--force", "--quiet", "--pixel", "0.1", "--units", "m"];
    converts(folder, &[&fixed, arguments].concat());
    fs::read(folder.join("out.slices")).unwrap()
}

#[test]
fn order_threads_and_memory_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let mut splats = scene(3000);
    write(&folder.path().join("a.ply"), &splats);
    splats.reverse();
    write(&folder.path().join("b.ply"), &splats);
    for colour in ["off", "rgb"] {
        let expected = archive(folder.path(), "a.ply", &["--threads", "1", "--colour", colour]);
        verifies(&folder.path().join("out.slices"));
        for (input, threads, memory) in [("a.ply", "3", "64MiB"), ("b.ply", "2", "512MiB"), ("b.ply", "1", "64MiB")] {
            let again = archive(folder.path(), input, &["--threads", threads, "--memory", memory, "--colour", colour]);
            assert!(again == expected, "{input} {threads} {memory} {colour}");
        }
    }
}

/// Programs that sort the keys of a glTF write buffers of any length in front of the names of its extensions.
#[test]
fn a_gltf_that_names_its_splats_late_is_one_of_splats() {
    let folder = tempfile::tempdir().unwrap();
    // Centre, quaternion x, y, z, w, and sizes of a splat.
    let values: Vec<u8> =
        [1.0f32, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.2, 0.2, 0.2].iter().flat_map(|v| v.to_le_bytes()).collect();
    fs::write(folder.path().join("a.bin"), values).unwrap();
    let (name, long) = ("KHR_gaussian_splatting", "long".repeat(50_000));
    let gltf = format!(
        r#"{{"accessors":[{{"bufferView":0,"componentType":5126,"count":1,"type":"VEC3"}},
        {{"bufferView":1,"componentType":5126,"count":1,"type":"VEC4"}},
        {{"bufferView":2,"componentType":5126,"count":1,"type":"VEC3"}}],"asset":{{"generator":"{long}","version":"2.0"}},
        "bufferViews":[{{"buffer":0,"byteLength":12}},{{"buffer":0,"byteLength":16,"byteOffset":12}},
        {{"buffer":0,"byteLength":12,"byteOffset":28}}],"buffers":[{{"byteLength":40,"uri":"a.bin"}}],
        "extensionsUsed":["{name}"],"meshes":[{{"primitives":[{{"attributes":{{"{name}:ROTATION":1,"{name}:SCALE":2,
        "POSITION":0}},"extensions":{{"{name}":{{}}}},"mode":0}}]}}],"nodes":[{{"mesh":0}}]}}"#
    );
    fs::write(folder.path().join("a.gltf"), gltf).unwrap();
    archive(folder.path(), "a.gltf", &[]);
    assert_eq!(Archive::open(folder.path().join("out.slices")).unwrap().header().points_kept, 1);
}

#[test]
fn options_leave_out_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let splats = scene(1000);
    write(&folder.path().join("a.ply"), &splats);
    let fixed = ["a.ply", "-o", "out.slices", "--force", "--pixel", "0.1", "--units", "m", "--json"];
    let facts = |arguments: &[&str]| -> serde_json::Value {
        let mut sliceconv = Command::new(env!("CARGO_BIN_EXE_sliceconv"));
        let out = sliceconv.current_dir(folder.path()).args([&fixed, arguments].concat()).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let count = |low: f64, high: f64| splats.iter().filter(|splat| low <= splat.3 && splat.3 < high).count();
    let all = facts(&[]);
    assert_eq!(all["splats_read"], 1000);
    assert_eq!(all["splats_transparent"], count(0.0, 0.1));
    assert_eq!([&all["splats_faint"], &all["splats_large"]], [0, 0]);
    let few = facts(&["--opacity", "0.3", "--min-opacity", "0.2"]);
    assert_eq!([&few["splats_faint"], &few["splats_transparent"]], [count(0.0, 0.2), count(0.2, 0.3)]);
    let said = converts(
        folder.path(),
        &["a.ply", "-o", "none.slices", "--units", "m", "--pixel", "0.1", "--min-opacity", "0.99"],
    );
    assert!(said.contains("1,000 splats by limits of splats or unusable, 0 without a finite position"), "{said}");
    let none = facts(&["--min-opacity", "0.99"]);
    assert_eq!((&none["splats_faint"], &none["voxels"]["occupied"]), (&1000.into(), &0.into()));
    let size = |splat: &Splat| {
        let reach = (2.0 * (splat.3 / 0.1).ln()).sqrt();
        2.0 * reach * splat.1.iter().fold(0.0, |a: f64, &b| a.max(b))
    };
    let large = splats.iter().filter(|splat| splat.3 >= 0.1 && size(splat) > 0.8).count();
    assert_eq!(facts(&["--max-size", "0.8"])["splats_large"], large);
    assert!(large > 100);
}

/// Splats that a file states and does not hold are missing, not read.
#[test]
fn cut_files_count_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    write(&path, &scene(100));
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 3 * 56]).unwrap();
    let fixed = ["a.ply", "-o", "out.slices", "--pixel", "0.1", "--units", "m"];
    let said = refuses(folder.path(), &fixed, 1);
    assert!(said.contains("splat 0: 3 splats missing"), "{said}");
    let mut sliceconv = Command::new(env!("CARGO_BIN_EXE_sliceconv"));
    let out = sliceconv.current_dir(folder.path()).args(fixed).args(["--json", "--allow-incomplete"]).output().unwrap();
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let counts = ["splats_read", "points_missing", "splats_unusable"].map(|key| facts[key].as_u64());
    assert_eq!((counts, &facts["complete"]), ([Some(97), Some(3), Some(0)], &false.into()));
}

#[test]
fn a_file_that_cannot_be_opened_is_left_out_if_incomplete_input_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("a.ply"), &scene(20));
    fs::write(folder.path().join("b.ksplat"), [0; 10]).unwrap();
    let fixed = ["b.ksplat", "-o", "out.slices", "--pixel", "0.1", "--units", "m"];
    let said = refuses(folder.path(), &[&fixed[..], &["a.ply"]].concat(), 1);
    assert!(said.contains("b.ksplat: header"), "{said}");
    refuses(folder.path(), &[&fixed[..], &["--allow-incomplete"]].concat(), 1);
    let out = scans::sliceconv(folder.path(), &[&fixed[..], &["a.ply", "--json", "--allow-incomplete"]].concat());
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(said.contains("incomplete: left out: b.ksplat: header"), "{said}");
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&facts["splats_read"], &facts["complete"]), (&20.into(), &false.into()));
}

/// An empty archive would silently replace a good one.
#[test]
fn splats_of_which_none_is_usable_replace_no_archive() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = ([f64::NAN, 0.0, 0.0], [0.1; 3], [1.0, 0.0, 0.0, 0.0], 0.9);
    write(&folder.path().join("a.ply"), &balls(&[0.9]));
    write(&folder.path().join("b.ply"), &[nowhere; 2]);
    let before = archive(folder.path(), "a.ply", &[]);
    let fixed = ["b.ply", "-o", "out.slices", "--force", "--pixel", "0.1", "--units", "m", "--allow-incomplete"];
    let said = refuses(folder.path(), &fixed, 1);
    assert!(said.contains("b.ply: splats: none of 2 can be used; fetch or write it again"), "{said}");
    assert!(fs::read(folder.path().join("out.slices")).unwrap() == before);
    // Beside usable ones they are only left out.
    converts(folder.path(), &[&fixed[..], &["a.ply"]].concat());
}

/// Balls of the same solid part, of these opacities, each far from the others.
fn balls(opacities: &[f64]) -> Vec<Splat> {
    let ball = |(number, &opacity): (usize, &f64)| {
        let scale = 0.33 / (2.0 * (opacity / 0.1).ln()).sqrt();
        ([4.0 * number as f64 + 0.05, 0.05, 0.15], [scale; 3], [1.0, 0.0, 0.0, 0.0], opacity)
    };
    opacities.iter().enumerate().map(ball).collect()
}

#[test]
fn faint_floaters_go_sooner() {
    let folder = tempfile::tempdir().unwrap();
    let facts = |arguments: &[&str]| -> serde_json::Value {
        let fixed = ["a.ply", "-o", "out.slices", "--force", "--pixel", "0.1", "--units", "m", "--json"];
        let mut sliceconv = Command::new(env!("CARGO_BIN_EXE_sliceconv"));
        let out = sliceconv.current_dir(folder.path()).args([&fixed, arguments].concat()).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let opacities = [0.2, 0.25, 0.26, 0.5, 0.75, 0.76, 0.95];
    let quarters = [1, 1, 2, 2, 3, 4, 4];
    let each: Vec<u64> = opacities
        .iter()
        .map(|&opacity| {
            write(&folder.path().join("a.ply"), &balls(&[opacity]));
            facts(&[])["voxels"]["occupied"].as_u64().unwrap()
        })
        .collect();
    assert!(each.iter().all(|&count| count == each[0] && count > 40), "{each:?}");
    write(&folder.path().join("a.ply"), &balls(&opacities));
    for weight in 1..=4 {
        let most = (each[0] * weight).div_ceil(4);
        for (most, reaches) in [(most, weight), ((each[0] * weight - 1) / 4, weight - 1)] {
            let few = facts(&["--drop-floaters", &most.to_string()]);
            let dropped = quarters.iter().filter(|&&quarters| quarters <= reaches).count() as u64 * each[0];
            assert_eq!(few["voxels_dropped"], dropped, "{most}");
            assert_eq!(few["voxels"]["occupied"], opacities.len() as u64 * each[0] - dropped, "{most}");
        }
    }
    // Four faint voxels count for one; the greatest opacity in a voxel counts.
    let pair = |opacity: f64| ([0.1, 0.05, 0.15], [0.01; 3], [1.0, 0.0, 0.0, 0.0], opacity);
    for (opacities, dropped) in [(&[0.2][..], 2), (&[0.5], 2), (&[0.2, 0.6], 0), (&[0.9], 0)] {
        write(&folder.path().join("a.ply"), &opacities.iter().copied().map(pair).collect::<Vec<_>>());
        assert_eq!(facts(&["--drop-isolated"])["voxels_dropped"], dropped, "{opacities:?}");
    }
}

#[test]
fn what_is_no_disc_is_floor_where_discs_around_are_or_in_a_surface() {
    let folder = tempfile::tempdir().unwrap();
    let level = [1.0, 0.0, 0.0, 0.0];
    let about_y = |deg: f64| [(deg / 2.0).to_radians().cos(), 0.0, (deg / 2.0).to_radians().sin(), 0.0];
    // Slices of 0.3 m begin at multiples of it.
    let ball = |x: f64, y: f64, z: f64| ([x, y, z], [0.02; 3], level, 0.9);
    let needle = |deg: f64| ([0.05, 0.05, 0.15], [0.05, 0.01, 0.01], about_y(deg), 0.9);
    let disc = |x: f64, y: f64, z: f64, deg: f64| ([x, y, z], [0.05, 0.05, 0.001], about_y(deg), 0.9);
    let each = || (0..20).flat_map(|i| (0..20).map(move |j| (0.1 * f64::from(i) + 0.05, 0.1 * f64::from(j) + 0.05)));
    let floor = || each().map(|(x, y)| disc(x, y, 0.05, 0.0));
    let obstacles = |splats: &[Splat]| {
        write(&folder.path().join("a.ply"), splats);
        archive(folder.path(), "a.ply", &[]);
        let archive = Archive::open(folder.path().join("out.slices")).unwrap();
        let voxels = &archive.header().voxels;
        (voxels.obstacle, voxels.occupied)
    };
    assert_eq!(obstacles(&floor().collect::<Vec<_>>()).0, 0);
    assert_eq!(obstacles(&floor().chain([ball(1.05, 1.05, 0.1)]).collect::<Vec<_>>()).0, 0);
    assert_eq!(obstacles(&[ball(0.05, 0.05, 0.15)]), (1, 1));
    archive(folder.path(), "a.ply", &["--max-slope", "90"]);
    assert_eq!(Archive::open(folder.path().join("out.slices")).unwrap().header().voxels.obstacle, 0);
    // On the side of something upright.
    let upright = disc(0.05, 0.05, 0.15, 90.0);
    let (alone, occupied) = obstacles(&[upright]);
    assert_eq!(alone, occupied);
    assert_eq!(obstacles(&[upright, ball(0.15, 0.05, 0.2)]), (occupied + 1, occupied + 1));
    for deg in [0.0, 60.0] {
        let (obstacle, occupied) = obstacles(&[needle(deg)]);
        assert_eq!(obstacle, occupied, "{deg}");
    }
    // A steep needle is an obstacle on a floor, too, one along it is not.
    let with_needle = |deg: f64| floor().chain([needle(deg)]).collect::<Vec<_>>();
    assert_eq!(obstacles(&with_needle(0.0)).0, 0);
    assert!(obstacles(&with_needle(60.0)).0 > 0);
    // Balls alone, one in each pixel, are a floor, except for its corners.
    let carpet: Vec<_> = each().map(|(x, y)| ball(x, y, 0.1)).collect();
    assert_eq!(obstacles(&carpet), (4, 400));
}

#[test]
fn a_matrix_and_a_distance_place_splats() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let ball = ([1.0, 2.0, 3.0], [0.5; 3], [1.0, 0.0, 0.0, 0.0], 0.9);
    write(&at("a.ply"), &[ball]);
    // A quarter turn about x, twice the size, a shift.
    fs::write(at("m.txt"), "2 0 0 10\n0 0 -2 20\n0 2 0 30\n0 0 0 1\n").unwrap();
    archive(folder.path(), "a.ply", &["--transform", "m.txt"]);
    let (min, max) = Archive::open(at("out.slices")).unwrap().header().bounds.unwrap();
    let reach = 2.0 * 0.5 * (2.0 * 9f64.ln()).sqrt();
    for (axis, centre) in [12.0, 14.0, 34.0].into_iter().enumerate() {
        assert!(
            (min[axis] - centre + reach).abs() < 1e-5 && (max[axis] - centre - reach).abs() < 1e-5,
            "{min:?} {max:?}"
        );
    }
    let fixed = ["a.ply", "-o", "out.slices", "--force", "--quiet", "--pixel", "0.1"];
    // Without a unit, in metres; with y up, (x, y, z) becomes (x, -z, y).
    for (more, centre) in [(&["--threads", "1"][..], [1.0, 2.0, 3.0]), (&["--up", "y"], [1.0, -3.0, 2.0])] {
        converts(folder.path(), &[&fixed[..], more].concat());
        let (min, max) = Archive::open(at("out.slices")).unwrap().header().bounds.unwrap();
        for (axis, centre) in centre.into_iter().enumerate() {
            let (low, high) = (centre - reach / 2.0, centre + reach / 2.0);
            assert!((min[axis] - low).abs() < 1e-5 && (max[axis] - high).abs() < 1e-5, "{more:?}: {min:?} {max:?}");
        }
    }
    converts(folder.path(), &[&fixed[..], &["--scale-from", "0,0,0", "0,0,4", "2"]].concat());
    let (min, max) = Archive::open(at("out.slices")).unwrap().header().bounds.unwrap();
    assert!((max[2] - min[2] - reach / 2.0).abs() < 1e-5);
    fs::write(at("m.txt"), "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1").unwrap();
    let line = refuses(folder.path(), &[&fixed[..], &["--transform", text(&at("m.txt"))]].concat(), 1);
    assert!(line.contains("mirrors"), "{line}");
    refuses(folder.path(), &[&fixed[..], &["--opacity", "0"]].concat(), 2);
}

#[test]
fn a_folder_of_splats_counts_by_the_file_that_describes_it() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("room")).unwrap();
    fs::write(folder.path().join("room/meta.json"), "{\"version\": 2}").unwrap();
    write(&folder.path().join("a.ply"), &balls(&[0.9]));
    let fixed = ["--pixel", "0.1", "--units", "m"];
    converts(folder.path(), &[&["a.ply", "--write-plan", "p.json"], &fixed[..]].concat());
    for more in [&fixed[..], &["--plan", "p.json", "--shard", "1/2"]] {
        let line = refuses(folder.path(), &[&["room", "-o", "x.slices"], more].concat(), 1);
        assert!(line.contains("meta.json"), "{line}");
    }
    assert!(!folder.path().join("x.slices").exists());
}

#[test]
fn floats_that_are_coarse_for_the_pixels_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let ball = |x: f64| ([x, 0.0, 0.0], [0.1; 3], [1.0, 0.0, 0.0, 0.0], 0.9);
    let said = |x: f64, pixel: &str| {
        write(&folder.path().join("a.ply"), &[ball(x), ball(x + 1.0)]);
        let fixed = ["a.ply", "-o", "out.slices", "--force", "--units", "m", "--pixel", pixel];
        converts(folder.path(), &fixed)
    };
    let far = said(5_711_234.0, "0.1");
    assert!(far.contains("a.ply: coordinates are floats of 32 bits, which are 0.5 m apart at 5,711,235"), "{far}");
    for (x, pixel) in [(5_711_234.0, "4"), (1000.0, "0.1")] {
        let near = said(x, pixel);
        assert!(!near.contains("floats of 32 bits"), "{near}");
    }
}

#[test]
fn the_pixel_size_follows_from_the_extent_of_meshes_and_splats_together() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.obj"), "v 0 0 0\nv 10 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    write(&at("a.ply"), &[([30.0, 0.5, 0.1], [0.1; 3], [1.0, 0.0, 0.0, 0.0], 0.9)]);
    let extent = 30.0 + 0.1 * (2.0 * 9f64.ln()).sqrt();
    for more in [&["--json"][..], &["--json", "--slice", "0.3"]] {
        let out = scans::sliceconv(folder.path(), &[&["a.obj", "a.ply", "--units", "m", "--dry-run"], more].concat());
        let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let found = facts["pixel_size"].as_f64().unwrap() / (extent / AUTO_PIXELS);
        assert!((0.95..1.05).contains(&found), "{more:?}: {facts}");
    }
}

#[test]
fn splats_beyond_the_grid_or_larger_than_any_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let level = [1.0, 0.0, 0.0, 0.0];
    for (splat, pixel, word) in [
        (([1e11, 0.0, 0.0], [0.5; 3], level, 0.9), "0.1", "a grid of this pixel size reaches"),
        (([0.0; 3], [1000.0; 3], level, 0.9), "0.001", "voxels that one splat fills"),
    ] {
        write(&folder.path().join("a.ply"), &[splat]);
        let line = refuses(folder.path(), &["a.ply", "-o", "x.slices", "--units", "m", "--pixel", pixel], 1);
        assert!(line.contains(word) && line.contains("give a larger --pixel"), "{line}");
    }
    assert!(!folder.path().join("x.slices").exists());
}
