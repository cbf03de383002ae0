//! A scan converted in parts and merged has the bytes of a single run. Parts of another plan or other inputs, too few
//! parts, and damaged parts are refused.

use crate::scans;

use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use scans::{converts, data, merges_to, names, points, refuses, text, verifies, write};
use slicewalk::archive::{Archive, merge, merge_run};
use slicewalk::{Error, NoMonitor};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Points of `scene` in `folder`, with classes to leave out and withheld ones.
fn scan(folder: &Path, name: &str, scene: &str, count: u64) {
    let scene = Scene::named(scene, &Params::new()).unwrap();
    let mut spec = WriteSpec::for_path(Path::new(name));
    spec.classes = vec![(2, 0.7), (7, 0.1), (18, 0.2)];
    spec.withheld_share = 0.03;
    spec.crs_wkt = Some(format!("LOCAL_CS[\"{name}\"]"));
    let samples = SampleSpec::direct_count(count).with_noise(0.004);
    write_samples(&folder.join(name), scene.samples(11, &samples).unwrap(), &spec).unwrap();
}

const QUIET: [&str; 4] = ["--quiet", "--force", "--threads", "2"];

fn convert(folder: &Path, inputs: &[&str], output: &str, options: &[&str]) {
    converts(folder, &[inputs, &["-o", output], &QUIET, options].concat());
}

/// Converts all parts, the last one first, and returns their names.
fn parts(folder: &Path, inputs: &[&str], count: u32, options: &[&str]) -> Vec<PathBuf> {
    let names: Vec<PathBuf> = (1..=count).map(|index| folder.join(format!("{index}-of-{count}.slices"))).collect();
    for (index, name) in names.iter().enumerate().rev() {
        let shard = format!("{}/{count}", index + 1);
        convert(folder, inputs, text(name), &[options, &["--shard", &shard]].concat());
        verifies(name);
    }
    names
}

#[test]
#[ignore = "slow: .ci/run"]
fn parts_of_scenes_with_ramps_and_walls_merge_to_the_bytes_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "house.laz", "house", 120_000);
    scan(at, "ramps.las", "ramps", 80_000);
    write(&at.join("more.laz"), &points(20_000));
    for (inputs, options) in [
        (&["house.laz"][..], &["--pixel", "0.05", "--exclude-class", "7,18", "--levels", "on"][..]),
        (&["ramps.las", "house.laz", "more.laz"], &["--pixel", "0.1", "--drop-isolated", "--min-points", "2"]),
        (&["ramps.las"], &["--pixel", "0.04", "--classifier", "thesis", "--tolerance", "0.01", "--levels", "on"]),
        (&["ramps.las"], &["--pixel", "0.1", "--slice", "0.02"]),
        (&["house.laz", "ramps.las"], &["--pixel", "auto", "--classifier", "span"]),
        (&["house.laz"], &["--pixel", "0.03", "--slice", "0.1", "--up", "y", "--units", "ft"]),
    ] {
        convert(at, inputs, "whole.slices", options);
        let whole = Archive::open(at.join("whole.slices")).unwrap();
        assert!(whole.header().points_withheld > 0);
        for count in [1, 3, 7] {
            let mut parts = parts(at, inputs, count, options);
            let kept = |path: &PathBuf| Archive::open(path).unwrap().header().points_kept;
            let with_points = parts.iter().filter(|part| kept(part) > 0).count();
            assert!(with_points as u32 > count / 2, "{with_points} of {count} parts hold something");
            parts.rotate_left(count as usize / 2);
            merges_to(&parts, &at.join("whole.slices"));
        }
    }
}

#[test]
fn parts_join_as_a_tree_to_the_bytes_of_one_run_and_a_wrong_tree_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "house.laz", "house", 60_000);
    scan(at, "ramps.las", "ramps", 60_000);
    let inputs = ["house.laz", "ramps.las"];
    let options = ["--pixel", "0.05", "--levels", "on", "--fill-holes", "0.2", "--drop-isolated"];
    convert(at, &inputs, "whole.slices", &options);
    let parts = parts(at, &inputs, 9, &options);
    let run = |from: &[PathBuf], of: (u32, u32), name: String| {
        let output = at.join(name);
        merge_run(from, of, &output, true, &NoMonitor).map(|_| output)
    };
    // Groups of unequal size, on two levels; each node is an archive and a part.
    let of_three = |at: [usize; 4]| -> Vec<PathBuf> {
        let group = |n: usize| run(&parts[at[n]..at[n + 1]], (n as u32 + 1, 3), format!("g{n}.slices")).unwrap();
        (0..3).map(group).collect()
    };
    for cut in [[0, 3, 6, 9], [0, 1, 2, 9], [0, 6, 8, 9]] {
        let groups = of_three(cut);
        groups.iter().for_each(|group| verifies(group));
        assert_eq!(Archive::open(&groups[1]).unwrap().shard().unwrap().map(|s| (s.index, s.count)), Some((2, 3)));
        merges_to(&groups, &at.join("whole.slices"));
        let upper = [run(&groups[..2], (1, 2), "u0".into()).unwrap(), run(&groups[2..], (2, 2), "u1".into()).unwrap()];
        merges_to(&upper, &at.join("whole.slices"));
    }
    let refused = |error: Result<PathBuf, Error>, words: &str| {
        let error = error.unwrap_err().to_string();
        assert!(error.contains(words), "{words}: {error}");
        assert!(!at.join("x").exists());
    };
    refused(run(&parts[1..4], (1, 3), "x".into()), "begins with part 1");
    refused(run(&parts[..3], (3, 3), "x".into()), "begins with part 1");
    refused(run(&parts[3..6], (5, 4), "x".into()), "begins with part 1");
    refused(run(&[parts[3].clone(), parts[5].clone()], (2, 3), "x".into()), "missing of 9: 5");
    refused(run(&[], (2, 3), "x".into()), "no part was given");
    // A cut with a gap, and one with an overlap.
    let groups = of_three([0, 3, 6, 9]);
    for middle in [&parts[4..6], &parts[2..6]] {
        let wrong = run(middle, (2, 3), "wrong".into()).unwrap();
        let all = [groups[0].clone(), wrong, groups[2].clone()];
        refused(merge(&all, &at.join("x"), false, &NoMonitor).map(|_| at.join("x")), "do not follow");
    }
}

#[test]
fn parts_of_meshes_beside_a_scan_merge_to_the_bytes_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    scan(at, "house.laz", "house", 40_000);
    // A floor, a ramp and a wall of large triangles across many tiles, and a triangle that is left out.
    let corners = "v -20 -20 1\nv 20 -20 1\nv 20 20 1\nv -20 20 6\nv 3 -15 0\nv 3 15 0\nv 3 15 3\n";
    fs::write(at.join("room.obj"), format!("{corners}f 1 2 3\nf 1 3 4\nf 5 6 7\nf 1 1 2\n")).unwrap();
    for (inputs, options) in [
        (&["room.obj"][..], &["--pixel", "0.2", "--units", "m"][..]),
        (&["house.laz", "room.obj"], &["--pixel", "0.1", "--units", "m", "--mesh", "sampled"]),
        (&["house.laz", "room.obj"], &["--pixel", "auto", "--units", "m", "--drop-isolated"]),
    ] {
        convert(at, inputs, "whole.slices", options);
        converts(at, &[inputs, options, &["--write-plan", "plan.json", "--quiet", "--force"]].concat());
        for options in [options, &["--plan", "plan.json"]] {
            merges_to(&parts(at, inputs, 4, options), &at.join("whole.slices"));
        }
    }
    let shard = ["--plan", "plan.json", "--mesh", "sampled", "--shard", "1/2", "-o", "x.slices"];
    refuses(at, &[&["house.laz", "room.obj"][..], &shard].concat(), 2);
}

#[test]
fn parts_of_a_real_scan_merge_to_the_bytes_of_one_run() {
    let Some(data) = data::folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let input = data.join("delft_city_block_ahn3.laz");
    let options = ["--pixel", "0.5", "--memory", "64MiB"];
    convert(at, &[text(&input)], "whole.slices", &options);
    for count in [3, 7] {
        merges_to(&parts(at, &[text(&input)], count, &options), &at.join("whole.slices"));
    }
}

#[test]
fn a_file_is_read_for_the_points_beside_the_columns_of_a_part() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Tiles of 6.4 m and the files meet at x = 0; the voxels beside the seam have no other neighbours.
    let side = |sign: f64| (0..40).map(move |n| [sign * 0.05, 1.0 + 0.3 * f64::from(n % 16), 0.9 * f64::from(n / 16)]);
    write(&at.join("west.las"), &side(-1.0).collect::<Vec<_>>());
    write(&at.join("east.las"), &side(1.0).collect::<Vec<_>>());
    let (inputs, options) = (["west.las", "east.las"], ["--pixel", "0.1", "--units", "m", "--drop-isolated"]);
    convert(at, &inputs, "whole.slices", &options);
    let parts = parts(at, &inputs, 2, &options);
    for part in &parts {
        assert_eq!(Archive::open(part).unwrap().header().points_kept, 40);
    }
    merges_to(&parts, &at.join("whole.slices"));
}

/// Three parts of two adjacent scans, their plan, and the whole.
fn job() -> (TempDir, Vec<PathBuf>) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut all = points(20_000);
    // Without the few far points, so that headers show where the scans are.
    all.retain(|point| point.iter().all(|v| v.abs() < 100.0));
    write(&at.join("west.las"), &all);
    let east: Vec<_> = all.iter().map(|[x, y, z]| [x + 40.0, *y, *z]).collect();
    write(&at.join("east.laz"), &east);
    converts(at, &["west.las", "east.laz", "--pixel", "0.1", "--units", "m", "--write-plan", "plan.json", "--quiet"]);
    let parts = parts(at, &["west.las", "east.laz"], 3, &["--plan", "plan.json"]);
    convert(at, &["west.las", "east.laz"], "whole.slices", &["--plan", "plan.json"]);
    (folder, parts)
}

fn refused(parts: &[PathBuf], output: &Path, words: &[&str]) {
    let before = names(output.parent().unwrap());
    let error = merge(parts, output, false, &NoMonitor).unwrap_err().to_string();
    assert!(words.iter().all(|word| error.contains(word)), "{words:?}: {error}");
    assert_eq!(error.lines().count(), 1);
    assert_eq!(names(output.parent().unwrap()), before);
}

#[test]
fn a_plan_makes_the_archive_of_the_same_options_and_parts_leave_files_out_that_they_do_not_need() {
    let (folder, parts) = job();
    let at = folder.path();
    convert(at, &["west.las", "east.laz"], "direct.slices", &["--pixel", "0.1", "--units", "m"]);
    assert!(fs::read(at.join("direct.slices")).unwrap() == fs::read(at.join("whole.slices")).unwrap());
    merges_to(&parts, &at.join("whole.slices"));
    // Files that are not needed are not read: damage in them goes unnoticed.
    let again = |index: &str| {
        let inputs = ["west.las", "east.laz", "--plan", "plan.json", "--quiet", "--force"];
        scans::sliceconv(at, &[&inputs[..], &["--shard", index, "-o", "eighth.slices"]].concat())
    };
    assert!(again("1/8").status.success());
    let before = fs::read(at.join("eighth.slices")).unwrap();
    assert!(Archive::open(at.join("eighth.slices")).unwrap().header().points_kept > 0);
    let mut east = fs::read(at.join("east.laz")).unwrap();
    let middle = east.len() / 2;
    east[middle..middle + 300].fill(0xA5);
    fs::write(at.join("east.laz"), east).unwrap();
    assert!(again("1/8").status.success());
    assert!(fs::read(at.join("eighth.slices")).unwrap() == before);
    assert_eq!(again("8/8").status.code(), Some(1));
}

#[test]
fn a_part_opens_the_files_that_it_meets_and_those_whose_names_say_too_little() {
    let (folder, _) = job();
    let at = folder.path();
    for (from, to) in
        [("west.las", "a/tile.las"), ("east.laz", "b/tile.laz"), ("west.las", "c/one.las"), ("east.laz", "c/one.laz")]
    {
        let to = at.join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(at.join(from), to).unwrap();
    }
    // Under other names, and copies under one name.
    for inputs in [["a/tile.las", "b/tile.laz"], ["c/one.las", "c/one.laz"], ["west.las", "b/tile.laz"]] {
        let parts = parts(at, &inputs, 3, &["--plan", "plan.json"]);
        merges_to(&parts, &at.join("whole.slices"));
    }
    let plan = ["a/tile.las", "c/one.laz", "--pixel", "0.1", "--units", "m", "--write-plan", "q.json", "--quiet"];
    converts(at, &plan);
    let of_q = parts(at, &["a/tile.las", "c/one.laz"], 4, &["--plan", "q.json"]);
    convert(at, &["a/tile.las", "c/one.laz"], "q.slices", &["--plan", "q.json"]);
    merges_to(&of_q, &at.join("q.slices"));
    // A part that does not need a file's content still needs the file; another length is detected.
    let run = |shard: &str, output: &str| {
        let shard = ["--plan", "plan.json", "--shard", shard, "-o", output, "--quiet", "--force"];
        scans::sliceconv(at, &[&["west.las", "east.laz"][..], &shard].concat())
    };
    let east = fs::read(at.join("east.laz")).unwrap();
    assert!(run("1/8", "before.slices").status.success());
    fs::write(at.join("east.laz"), vec![0; east.len()]).unwrap();
    assert!(run("1/8", "after.slices").status.success());
    assert!(fs::read(at.join("before.slices")).unwrap() == fs::read(at.join("after.slices")).unwrap());
    let out = run("8/8", "after.slices");
    assert_eq!(out.status.code(), Some(1), "{out:?}");
    fs::write(at.join("east.laz"), &east[..east.len() - 1]).unwrap();
    assert_eq!(run("1/8", "after.slices").status.code(), Some(1));
    fs::write(at.join("east.laz"), &east).unwrap();
    // The plan's data on all inputs must match those that are opened.
    let good = fs::read_to_string(at.join("plan.json")).unwrap();
    let change = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        fs::write(at.join("plan.json"), good.replacen(from, to, 1)).unwrap();
    };
    change("\"length_units\": [", "\"length_units\": [[0.5, 0.5]], \"none\": [");
    let out = run("1/8", "after.slices");
    assert!(
        String::from_utf8_lossy(&out.stderr).contains("the inputs have another unit of length than it states"),
        "{out:?}"
    );
    change("\"length_units\": [", "\"length_units\": [[0]], \"none\": [");
    assert!(String::from_utf8_lossy(&run("1/8", "after.slices").stderr).contains("stated.length_units"));
    change("\"stated\": {", "\"earlier\": {");
    let out = run("1/8", "after.slices");
    assert!(String::from_utf8_lossy(&out.stderr).contains("missing field `stated`"), "{out:?}");
}

#[test]
fn any_order_and_copies_merge_and_what_is_there_already_is_left_alone() {
    let (folder, parts) = job();
    let (at, whole) = (folder.path(), folder.path().join("whole.slices"));
    for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
        merges_to(&order.map(|part| parts[part].clone()), &whole);
    }
    fs::copy(&parts[1], at.join("copy.slices")).unwrap();
    let with_copy = [&parts[..], &[at.join("copy.slices"), parts[0].clone()]].concat();
    let output = at.join("merged.slices");
    let merged = merge(&with_copy, &output, false, &NoMonitor).unwrap();
    assert!(merged.written && merged.copies == [at.join("copy.slices"), parts[0].clone()], "{:?}", merged.copies);
    let bytes = fs::read(&whole).unwrap();
    assert!(fs::read(&output).unwrap() == bytes);
    let again = merge(&parts, &output, false, &NoMonitor).unwrap();
    assert!(!again.written && again.header == merged.header);
    fs::copy(&parts[0], &output).unwrap();
    refused(&parts, &output, &["merged.slices", "allow it to be replaced"]);
    assert!(merge(&parts, &output, true, &NoMonitor).unwrap().written);
    assert!(fs::read(&output).unwrap() == bytes);
    fs::write(&output, "something else").unwrap();
    refused(&parts, &output, &["merged.slices", "not a slice archive"]);
    assert!(merge(&parts, &output, true, &NoMonitor).is_err());
    assert!(merge(&parts, &parts[0], true, &NoMonitor).unwrap_err().to_string().contains("this command reads"));
    merges_to(&parts, &whole);
}

#[test]
fn missing_foreign_overlapping_and_damaged_parts_are_refused_by_name() {
    let (folder, parts) = job();
    let at = folder.path();
    let output = at.join("merged.slices");
    refused(&parts[..1], &output, &["missing of 3: 2-3", "convert these too"]);
    refused(&[], &output, &["no part"]);
    let whole = at.join("whole.slices");
    refused(&[&parts[..], std::slice::from_ref(&whole)].concat(), &output, &["whole.slices", "no part of one"]);
    let with = |foreign: &str| [&parts[1..], &[at.join(foreign)]].concat();
    let inputs = ["west.las", "east.laz"];
    convert(at, &inputs, "steep.slices", &["--pixel", "0.1", "--units", "m", "--max-slope", "30", "--shard", "1/3"]);
    refused(&with("steep.slices"), &output, &["steep.slices", "its plan"]);
    convert(at, &inputs[..1], "west.slices", &["--pixel", "0.1", "--units", "m", "--shard", "1/3"]);
    refused(&with("west.slices"), &output, &["west.slices", "other inputs"]);
    convert(at, &inputs, "half.slices", &["--plan", "plan.json", "--shard", "1/2"]);
    refused(&with("half.slices"), &output, &["half.slices", "of 3"]);
    // Different content under the same number: the head's count of points, with recomputed checksums.
    let mut other = fs::read(&parts[0]).unwrap();
    other[128] ^= 64;
    let head_len = u32::from_le_bytes(other[12..16].try_into().unwrap()) as usize;
    let crc = crc32c::crc32c(&other[..head_len - 4]).to_le_bytes();
    other[head_len - 4..head_len].copy_from_slice(&crc);
    let footer = other.len() - 24;
    other[footer + 8..footer + 12].copy_from_slice(&crc);
    let crc = crc32c::crc32c(&other[footer..footer + 12]).to_le_bytes();
    other[footer + 12..footer + 16].copy_from_slice(&crc);
    fs::write(at.join("other.slices"), other).unwrap();
    refused(&[&parts[..], &[at.join("other.slices")]].concat(), &output, &["other.slices", "1-of-3.slices"]);
    // Flipped bytes of a part are refused with the part's name, wherever they are. Its levels are never read.
    let good = fs::read(&parts[0]).unwrap();
    let header = Archive::open(&parts[0]).unwrap().header().clone();
    let levels = header.levels_offset() as usize..header.directory_offset() as usize;
    for place in (0..good.len()).step_by(good.len() / 150 + 1).filter(|place| !levels.contains(place)) {
        let mut bad = good.clone();
        bad[place] ^= 1;
        fs::write(at.join("bad.slices"), bad).unwrap();
        let error = merge(&with("bad.slices"), &output, false, &NoMonitor).unwrap_err();
        assert!(matches!(&error, Error::Input { path, .. } if path.ends_with("bad.slices")), "byte {place}: {error}");
        assert!(!output.exists());
    }
}

#[test]
fn bounds_in_a_header_that_are_wrong_are_noticed_by_the_part_that_owns_the_file() {
    let (folder, _) = job();
    let at = folder.path();
    // The largest and smallest x of the eastern scan, in its header: it claims to be in the west.
    let mut east = fs::read(at.join("east.laz")).unwrap();
    east[179..187].copy_from_slice(&10f64.to_le_bytes());
    east[187..195].copy_from_slice(&(-10f64).to_le_bytes());
    fs::write(at.join("east.laz"), east).unwrap();
    let inputs = ["west.las", "east.laz"];
    let options = ["--pixel", "0.1", "--units", "m"];
    converts(at, &[&inputs[..], &options, &["--write-plan", "p.json", "--quiet"]].concat());
    let shard = ["--plan", "p.json", "--shard", "1/3", "-o", "x.slices", "--quiet"];
    let said = refuses(at, &[&inputs[..], &shard].concat(), 1);
    assert!(said.contains("east.laz") && said.contains("null"), "{said}");
    assert!(!at.join("x.slices").exists());
    // The solution that the error suggests.
    let plan = fs::read_to_string(at.join("p.json")).unwrap();
    let mut plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
    for input in plan["inputs"].as_array_mut().unwrap() {
        if input["name"] == "east.laz" {
            input["bounds"] = serde_json::Value::Null;
        }
    }
    fs::write(at.join("p.json"), plan.to_string()).unwrap();
    convert(at, &inputs, "whole.slices", &options);
    merges_to(&parts(at, &inputs, 3, &["--plan", "p.json"]), &at.join("whole.slices"));
}

#[test]
fn a_plan_holds_the_measured_bounds_of_text() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rows: String = (0..100_000).map(|n| format!("{} {} 0.5\n", n % 300, n / 300)).collect();
    fs::write(at.join("a.xyz"), rows).unwrap();
    converts(at, &["a.xyz", "--pixel", "0.5", "--units", "m", "--write-plan", "plan.json", "--quiet"]);
    let plan: serde_json::Value = serde_json::from_slice(&fs::read(at.join("plan.json")).unwrap()).unwrap();
    let input = &plan["inputs"][0];
    assert_eq!(input["points"], 100_000);
    assert_eq!(input["bounds"], serde_json::json!({ "min": [0.0, 0.0, 0.5], "max": [299.0, 333.0, 0.5] }));
}

#[test]
fn plans_and_parts_on_the_command_line_are_checked() {
    let (folder, _) = job();
    let at = folder.path();
    let inputs = ["west.las", "east.laz"];
    for wrong in [
        &["--plan", "plan.json", "--pixel", "0.2", "-o", "x.slices"][..],
        &["--plan", "plan.json", "--pixel", "auto", "-o", "x.slices"],
        &["--plan", "plan.json", "--max-slope", "30", "-o", "x.slices"],
        &["--plan", "plan.json", "--units", "ft", "-o", "x.slices"],
        &["--plan", "plan.json", "--up", "y", "-o", "x.slices"],
        &["--plan", "plan.json", "--drop-isolated", "-o", "x.slices"],
        &["--plan", "plan.json", "--write-plan", "q.json"],
        &["--write-plan", "q.json", "-o", "x.slices"],
        &["--plan", "plan.json", "--shard", "0/3", "-o", "x.slices"],
        &["--plan", "plan.json", "--shard", "4/3", "-o", "x.slices"],
        &["--plan", "plan.json", "--shard", "3", "-o", "x.slices"],
        &["--plan", "plan.json"],
    ] {
        refuses(at, &[&inputs[..], wrong].concat(), 2);
    }
    convert(
        at,
        &inputs,
        "same.slices",
        &["--plan", "plan.json", "--pixel", "0.1", "--max-slope", "45", "--units", "m"],
    );
    let said = refuses(at, &[&inputs[..], &["--pixel", "0.1", "--write-plan", "plan.json"]].concat(), 1);
    assert!(said.contains("plan.json: exists already; --force"), "{said}");
    let good = fs::read_to_string(at.join("plan.json")).unwrap();
    for (from, to, word) in [
        ("{", "[", "line 1: no plan in JSON"),
        ("\"slicewalk_plan\": 2", "\"slicewalk_plan\": 1", "slicewalk_plan"),
        ("\"pixel_size\": 0.1", "\"pixel_size\": -1", "pixel_size"),
        ("\"pixel_size\": 0.1", "\"pixel_size\": 0.2", "plan_hash"),
        ("\"classifier\": \"plane\"", "\"classifier\": \"flat\"", "classifier"),
        ("\"units\": 1.0", "\"units\": 1e-300", "units: expected"),
        ("\"fingerprint\": \"", "\"fingerprint\": \"x", "inputs[0].fingerprint"),
    ] {
        assert!(good.contains(from), "{from}");
        fs::write(at.join("bad.json"), good.replacen(from, to, 1)).unwrap();
        let said = refuses(at, &[&inputs[..], &["--plan", "bad.json", "-o", "x.slices", "--quiet"]].concat(), 1);
        assert!(said.contains("bad.json") && said.contains(word), "{word}: {said}");
    }
    // A report in JSON names the part.
    let part = ["--plan", "plan.json", "--shard", "2/3", "-o", "part.slices", "--json"];
    let out = scans::sliceconv(at, &[&inputs[..], &part].concat());
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((&facts["shard"]["index"], &facts["shard"]["count"]), (&2.into(), &3.into()));
    // Inputs other than those of the plan.
    let shard = ["--plan", "plan.json", "--shard", "1/3", "-o", "x.slices", "--quiet"];
    assert!(refuses(at, &[&inputs[..1], &shard].concat(), 1).contains("east.laz"));
    write(&at.join("third.las"), &points(100));
    let said = refuses(at, &[&inputs[..], &["third.las"], &shard].concat(), 1);
    assert!(said.contains("third.las") && said.contains("not among the files of the plan"), "{said}");
    assert!(!at.join("x.slices").exists());
}
