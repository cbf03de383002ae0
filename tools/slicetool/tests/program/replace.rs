//! A region of one archive in place of that of another, against conversions of the points that each contributes.

use crate::forge;

use scangen::{Texture, WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::colour::ColourSource;
use slicewalk::frame::Frame;
use slicewalk::plan::Classifier;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ColourMode, ConvertOptions, PixelSize, convert};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

type Points = Vec<[f64; 3]>;

/// SplitMix64 as numbers from 0 to 1.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn place(&mut self, (min, max): ([f64; 3], [f64; 3])) -> [f64; 3] {
        std::array::from_fn(|axis| min[axis] + (max[axis] - min[axis]) * self.uniform())
    }
}

/// Writes an archive `name` of `points`, with levels and exact colours if `rich`.
fn archive(folder: &Path, name: &str, points: &[[f64; 3]], rich: bool, classifier: Classifier) {
    let scan = folder.join("scan.las");
    let texture = Texture { period_m: 1.7, eight_bits: false, exposure: 0.0 };
    let spec = WriteSpec { format: 2, texture: Some(texture), ..WriteSpec::for_path(&scan) };
    write_las(&scan, points.iter().copied(), &spec).unwrap();
    let mut options = ConvertOptions::new(vec![scan.clone()], folder.join(name));
    options.grid.pixel = PixelSize::Metres(0.1);
    options.plan.classifier = classifier;
    options.sections.levels = rich;
    options.sections.colour = if rich { ColourMode::Of(ColourSource::Rgb) } else { ColourMode::Off };
    options.sections.colour_error = 0.0;
    options.overwrite = true;
    convert(&options, &NoMonitor).unwrap();
    fs::remove_file(scan).unwrap();
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).current_dir(folder).args(arguments).output().unwrap()
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    let said = text(out.stderr);
    assert!(out.status.success() && said.is_empty(), "{arguments:?}: {said}");
    text(out.stdout)
}

fn refuses(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    let said = text(out.stderr);
    assert!(out.status.code() == Some(1) && out.stdout.is_empty(), "{arguments:?}: {said}");
    assert!(said.lines().count() == 1 && said.starts_with("slicetool: "), "{arguments:?}: {said}");
    said
}

/// Corners of the region, in the middle of pixels and slices; its top is that of a page, 19.2 m.
const REGION: ([f64; 3], [f64; 3]) = ([-0.95, 5.95, 16.65], [2.25, 7.05, 19.05]);
const BOUNDS: &str = "--bounds=-0.95,5.95,16.65,2.25,7.05,19.05";
/// A space around it that reaches over four columns of pages and two layers.
const AROUND: ([f64; 3], [f64; 3]) = ([-2.0, 4.9, 15.0], [3.3, 8.1, 21.0]);

/// Returns whether the pixels and slices of the region, with `margin` (m) on every side, hold a point.
fn is_inside(point: &[f64; 3], margin: [f64; 3]) -> bool {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let place = |point: [f64; 3]| [frame.pixel_of(point[0]), frame.pixel_of(point[1]), frame.slice_of(point[2])];
    let [low, high] = [(REGION.0, -1.0), (REGION.1, 1.0)]
        .map(|(corner, sign)| place(std::array::from_fn(|axis| corner[axis] + sign * margin[axis])));
    place(*point).iter().zip(low.iter().zip(high)).all(|(at, (low, high))| (*low..=high).contains(at))
}

fn rounded(point: [f64; 3]) -> [f64; 3] {
    WriteSpec::default().rounded(point).unwrap()
}

fn replaced(at: &Path) -> Vec<u8> {
    done(at, &["replace", "a.slices", "--with", "b.slices", BOUNDS, "-o", "c.slices", "--force"]);
    done(at, &["verify", "c.slices"]);
    fs::read(at.join("c.slices")).unwrap()
}

/// The bytes of an archive with other point counts.
fn with_counts(bytes: &[u8], count: usize) -> Vec<u8> {
    let parts = forge::Parts::of(bytes);
    assert!(parts.build(|_| ()) == bytes);
    parts.build(|head| {
        forge::put(head, 128, count as u64, 8);
        forge::put(head, 136, count as u64, 8);
    })
}

/// By the thesis' rule, classes depend on the points of a voxel alone, so spans of both archives join at the seams.
#[test]
fn voxels_of_both_archives_make_the_bytes_of_one_conversion() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut random = Random(7);
    for rich in [false, true] {
        let all: Points = (0..40_000).map(|_| rounded(random.place(AROUND))).collect();
        // Some heights on the boundaries of slices.
        let all: Points = all
            .into_iter()
            .map(|[x, y, z]| {
                if random.uniform() < 0.1 { [x, y, rounded([0.0, 0.0, (z / 0.3).round() * 0.3])[2]] } else { [x, y, z] }
            })
            .collect();
        let (new, old): (Points, Points) = all.iter().partition(|point| is_inside(point, [0.0; 3]));
        assert!(new.len() > 2000 && old.len() > 5000);
        for (name, points) in [("a.slices", &old), ("b.slices", &new), ("all.slices", &all)] {
            archive(at, name, points, rich, Classifier::Thesis);
        }
        let all = fs::read(at.join("all.slices")).unwrap();
        assert!(replaced(at) == all, "rich: {rich}: {}", done(at, &["diff", "all.slices", "c.slices"]));
    }
}

/// Guarantee G1, also where spans of both archives cross the faces of the region, whatever the classes.
#[test]
fn every_point_that_an_archive_contributes_is_a_hit() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut random = Random(11);
    let mut scan = |count: usize| -> Points {
        let points = (0..count).map(|_| {
            let [x, y, z] = random.place(AROUND);
            // On the boundaries of slices, and anywhere.
            let height = if random.uniform() < 0.4 { (z / 0.3).round() * 0.3 } else { z };
            rounded([x, y, height])
        });
        points.collect()
    };
    for (count, classifier) in [(60_000, Classifier::Plane), (60_000, Classifier::Span), (9_000, Classifier::Plane)] {
        let scans = [scan(count), scan(count)];
        archive(at, "a.slices", &scans[0], false, classifier);
        archive(at, "b.slices", &scans[1], false, classifier);
        replaced(at);
        let store = Snapshot::resident(&Archive::open(at.join("c.slices")).unwrap(), &NoMonitor).unwrap();
        for (points, is_new) in scans.iter().zip([false, true]) {
            let kept = points.iter().filter(|point| is_inside(point, [0.0; 3]) == is_new);
            let missed = kept.filter(|point| {
                let place = (**point).into();
                overlaps(&store, &Aabb::new(place, place).unwrap()) != Overlap::Hit
            });
            assert_eq!(missed.collect::<Vec<_>>(), [&[0.0; 3]; 0], "{count} {classifier:?}");
        }
    }
}

#[test]
fn what_was_in_the_region_and_what_the_rescan_has_elsewhere_leaves_no_trace() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut random = Random(3);
    // Small groups of points, away from the faces of the region, so that no class depends on points beyond them.
    let mut blobs = |is_new: bool| {
        let mut kept: [Points; 2] = Default::default();
        for _ in 0..4000 {
            let corner = random.place(AROUND);
            let blob: Points = (0..12)
                .map(|_| rounded(random.place((corner, std::array::from_fn(|axis| corner[axis] + 0.25)))))
                .collect();
            let margin = [0.3, 0.3, 0.6];
            let inside = blob.iter().all(|point| is_inside(point, margin.map(|by: f64| -by)));
            let outside = blob.iter().all(|point| !is_inside(point, margin));
            if inside || outside {
                kept[usize::from(inside == is_new)].extend(blob);
            }
        }
        kept
    };
    let ([mut away, old], [beyond, new]) = (blobs(false), blobs(true));
    let old_out = {
        // Bounds are those of points outside.
        let mut corners = vec![AROUND.0, AROUND.1.map(|v| v + 0.3)];
        corners.extend(old.iter().copied());
        corners
    };
    away.extend(&old_out);
    let both: Points = new.iter().chain(&beyond).copied().collect();
    let all: Points = old_out.iter().chain(&new).copied().collect();
    assert!(new.len() > 200 && beyond.len() > 200 && away.len() > old_out.len() + 200);
    for rich in [false, true] {
        for (name, points) in [("a.slices", &away), ("b.slices", &both), ("all.slices", &all)] {
            archive(at, name, points, rich, Classifier::Plane);
        }
        let all = with_counts(&fs::read(at.join("all.slices")).unwrap(), away.len() + both.len());
        assert!(replaced(at) == all, "rich: {rich}: {}", done(at, &["diff", "all.slices", "c.slices"]));
    }
}

/// A floor with a wall, and one without it but with a step.
fn rooms(at: &Path) {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = || (0..80).flat_map(move |i| (0..80).map(move |j| [step(i), step(j), 0.35]));
    let wall = (0..80).flat_map(|j| (0..40).map(move |k| [3.025, step(j), 0.35 + step(k)]));
    archive(at, "a.slices", &floor().chain(wall).collect::<Points>(), false, Classifier::Plane);
    let box_top = (0..10).flat_map(|i| (0..10).map(move |j| [1.0 + step(i), 1.0 + step(j), 0.8]));
    archive(at, "b.slices", &floor().chain(box_top).collect::<Points>(), false, Classifier::Plane);
}

#[test]
fn a_rescan_takes_the_place_of_a_room() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    rooms(at);
    let bounds = "--bounds=0.05,0.05,-1,3.95,1.95,5";
    let command = ["replace", "a.slices", "--with", "b.slices", bounds, "-o", "c.slices"];
    let said = done(at, &command);
    assert!(said.starts_with("c.slices: ") && said.contains(" voxels, "), "{said}");
    done(at, &["verify", "c.slices"]);
    // The box of the rescan, the wall that is gone there, and the wall that stays elsewhere.
    fs::write(at.join("q.csv"), "1.1,1.1,0.7,1.3,1.3,0.9\n2.9,1,1,3.1,1.5,2\n2.9,2.1,1,3.1,2.5,2\n").unwrap();
    let hits = |name: &str| -> Vec<String> {
        let said = done(at, &["query", name, "--boxes", "q.csv"]);
        said.lines().skip(1).map(|line| line.split(',').nth(6).unwrap().to_owned()).collect()
    };
    assert_eq!([hits("a.slices"), hits("b.slices"), hits("c.slices")].map(|hits| hits.join("")), ["011", "100", "101"]);
    assert!(refuses(at, &command).contains("--force"));
    let facts: Value = serde_json::from_str(&done(at, &[&command[..], &["--force", "--json"]].concat())).unwrap();
    let info = |name: &str| -> Value { serde_json::from_str(&done(at, &["info", name, "--json"])).unwrap() };
    assert_eq!((&facts["region_empty"], &facts["dropped"]), (&false.into(), &Value::Array(vec![])), "{facts}");
    let sum = info("a.slices")["points_kept"].as_u64().unwrap() + info("b.slices")["points_kept"].as_u64().unwrap();
    assert_eq!((&facts["points_kept"], &facts["voxels"]), (&sum.into(), &info("c.slices")["voxels"]), "{facts}");
}

#[test]
fn a_region_in_which_the_rescan_holds_nothing_becomes_empty() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    rooms(at);
    let command =
        ["replace", "a.slices", "--with", "b.slices", "--bounds=2.55,-9,1,3.55,9,9", "-o", "c.slices", "--json"];
    let out = slicetool(at, &command);
    let said = text(out.stderr);
    assert!(out.status.success() && said.lines().count() == 1, "{said}");
    assert!(said.starts_with("slicetool: warning: b.slices: nothing lies within --bounds; "), "{said}");
    let facts: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(facts["region_empty"] == true && facts["bounds"]["max"][2].as_f64() < Some(1.0), "{facts}");
    done(at, &["verify", "c.slices"]);
}

#[test]
fn what_does_not_fit_is_refused_in_one_line_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    rooms(at);
    let whole = fs::read(at.join("b.slices")).unwrap();
    let mut damaged = whole.clone();
    let first_page = whole.windows(4).position(|bytes| bytes == b"\x89PAG").unwrap();
    damaged[first_page + 40] ^= 1;
    fs::write(at.join("damaged.slices"), damaged).unwrap();
    fs::write(at.join("text.slices"), "no archive at all ".repeat(100)).unwrap();
    let scan = at.join("scan.las");
    write_las(&scan, [[1.0, 1.0, 1.0]], &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], at.join("fine.slices"));
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor).unwrap();
    options.grid.pixel = PixelSize::Metres(0.1);
    (options.output, options.plan.max_slope_deg) = (at.join("steep.slices"), 60.0);
    convert(&options, &NoMonitor).unwrap();
    for (with, words) in [
        (
            "fine.slices",
            &["fine.slices: grid: pixel 0.05 m", "a.slices has pixel 0.1 m", "--pixel 0.1 --slice 0.3"][..],
        ),
        ("steep.slices", &["steep.slices: options: --max-slope is 60 and not 45 as in a.slices"]),
        ("damaged.slices", &["damaged.slices: damaged: rule P2"]),
        ("text.slices", &["text.slices"]),
        ("scan.las", &["scan.las: it is a laser scan"]),
        ("none.slices", &["none.slices"]),
    ] {
        let said = refuses(at, &["replace", "a.slices", "--with", with, "--bounds=0,0,0,2,2,2", "-o", "c.slices"]);
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert!(!at.join("c.slices").exists());
    }
    for output in ["a.slices", "b.slices"] {
        let before = fs::read(at.join(output)).unwrap();
        let command = ["replace", "a.slices", "--with", "b.slices", "--bounds=0,0,0,2,2,2", "-o", output, "--force"];
        assert!(refuses(at, &command).contains("this command reads"));
        assert!(fs::read(at.join(output)).unwrap() == before);
    }
    assert!(Archive::open(at.join("a.slices")).is_ok());
    let standard = ["replace", "a.slices", "--with", "-", "--bounds=0,0,0,2,2,2", "-o", "c.slices"];
    assert_eq!(slicetool(at, &standard).status.code(), Some(2));
}
