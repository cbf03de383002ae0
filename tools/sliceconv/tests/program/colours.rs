//! `--colour`: each voxel has the mean colour of its points within the stated error, the geometry is not affected, and
//! no order, thread, budget or part changes a byte. Truth is a formula of the position ([`Texture`]), summed by brute
//! force.

use crate::coloured;
use crate::scans;
use crate::write;

use coloured::{Cloud, Coloured, Numbers, e57, las};
use scangen::sample::{Mode, ScannerSpec};
use scangen::{Chunks, Params, Sample, SampleSpec, Scene, Texture, WriteSpec, write_las, write_samples};
use scans::{Random, colours, converts, data, refuses, text, verifies};
use slicewalk::archive::{Archive, ColourReader, extract, merge, recover};
use slicewalk::colour::{LabTable, difference, to_8_bits};
use slicewalk::frame::Frame;
use slicewalk::{Error, NoMonitor};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use write::{Pcd, Ply};

const OPTIONS: [&str; 6] = ["--pixel", "0.1", "--units", "m", "--quiet", "--force"];

/// Exact sums of the colours of points by pixel and slice.
type Sums = BTreeMap<[i64; 3], ([u64; 3], u64)>;

fn texture(eight_bits: bool) -> Texture {
    Texture { period_m: 1.7, eight_bits, exposure: 0.0 }
}

/// Points of a house in whole millimetres.
fn points(count: u64) -> Vec<[f64; 3]> {
    let scene = Scene::named("house", &Params::new()).unwrap();
    let spec = SampleSpec::direct_count(count).with_noise(0.004);
    let rounding = WriteSpec::default();
    scene.samples(3, &spec).unwrap().filter_map(|sample| rounding.rounded(sample.position)).collect()
}

/// Writes points with colours.
fn write_textured(path: &Path, points: &[[f64; 3]], format: u8, eight_bits: bool) {
    let mut spec = WriteSpec { format, texture: Some(texture(eight_bits)), ..WriteSpec::for_path(path) };
    spec.compression = spec.compression.map(|_| Chunks::Fixed(3_000));
    spec.classes = vec![(2, 0.5), (6, 0.5)];
    write_las(path, points.iter().copied(), &spec).unwrap();
}

fn sums(points: &[[f64; 3]], frame: &Frame, of: impl Fn([f64; 3]) -> [u16; 3]) -> Sums {
    let mut sums = Sums::new();
    for &point in points {
        let place = [frame.pixel_of(point[0]), frame.pixel_of(point[1]), frame.slice_of(point[2])];
        let (sum, n) = sums.entry(place).or_default();
        of(point).iter().zip(sum).for_each(|(value, sum)| *sum += u64::from(*value));
        *n += 1;
    }
    sums
}

/// Mean difference from the exact means (ΔE*ab), and number of voxels compared. Every occupied voxel with points has a
/// colour.
fn error_of(archive: &Archive, sums: &Sums, greatest: f64) -> (f64, usize) {
    let table = LabTable::get();
    let (mut sum, mut count) = (0.0, 0);
    for (place, colour) in colours(archive) {
        let Some((channels, n)) = sums.get(&place) else {
            assert_eq!(colour, None, "{place:?} has no points");
            continue;
        };
        let colour = colour.unwrap_or_else(|| panic!("{place:?} has points and no colour"));
        let exact = channels.map(|sum| (sum as f64 / *n as f64 / greatest * 65_535.0).round() as u16);
        sum += f64::from(difference(table.of_16_bits(exact), table.of_8_bits(colour)));
        count += 1;
    }
    (sum / count as f64, count)
}

fn convert(at: &Path, inputs: &[&str], output: &str, options: &[&str]) -> Archive {
    converts(at, &[inputs, &["-o", output], &OPTIONS, options].concat());
    verifies(&at.join(output));
    Archive::open(at.join(output)).unwrap()
}

fn section(archive: &Archive, from: u64, to: u64) -> Vec<u8> {
    let mut bytes = vec![0; (to - from) as usize];
    archive.source().read_at(from, &mut bytes).unwrap();
    bytes
}

#[test]
#[ignore = "slow: .ci/run"]
fn voxels_have_the_colours_of_their_points_in_every_format_and_pages_are_those_without() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points = points(60_000);
    let plain_of = |input: &str, options: &[&str]| convert(at, &[input], "plain.slices", options);
    for (name, format, eight_bits) in [
        ("a.las", 2, true),
        ("b.laz", 3, false),
        ("c.laz", 7, false),
        ("d.las", 8, true),
        ("e.laz", 10, true),
        ("f.las", 5, false),
    ] {
        write_textured(&at.join(name), &points, format, eight_bits);
        let greatest = if eight_bits { 255.0 } else { 65_535.0 };
        for (error, options) in [
            (2.0, &[][..]),
            (0.0, &["--colour-error", "0"][..]),
            (5.0, &["--colour-error", "5", "--levels", "on", "--min-points", "2"][..]),
        ] {
            let options = [&["--colour", "rgb"], options].concat();
            let archive = convert(at, &[name], "a.slices", &options);
            let header = archive.header();
            assert_eq!(header.version, (1, 0));
            assert_eq!(f64::from(header.colours.unwrap().plan.scale.high), greatest, "{name}");
            let sums = sums(&points, archive.frame(), |point| texture(eight_bits).at(point));
            let (found, count) = error_of(&archive, &sums, greatest);
            assert_eq!(header.colours.unwrap().voxels, count as u64);
            assert!(count > 1000 && found <= if error > 0.0 { error } else { 0.5 }, "{name}: {found} of {error}");
            if error == 0.0 {
                for (place, colour) in colours(&archive) {
                    let exact = sums.get(&place).map(|(sum, n)| {
                        sum.map(|sum| to_8_bits((sum as f64 / *n as f64 / greatest * 65_535.0).round() as u16))
                    });
                    assert_eq!(exact, colour, "{place:?}");
                }
            }
            let plain_options: Vec<&str> = options
                .iter()
                .copied()
                .filter(|o| !o.starts_with("--colour") && *o != "rgb" && *o != "0" && *o != "5")
                .collect();
            let plain = plain_of(name, &plain_options);
            let pages = |archive: &Archive| {
                let header = archive.header();
                section(archive, header.pages_offset(), header.colours_offset())
            };
            assert!(pages(&plain) == pages(&archive), "{name}: the pages differ");
            assert_eq!((plain.header().bytes.colours, plain.header().colours), (0, None));
            assert_eq!(plain.header().voxels, header.voxels);
        }
    }
}

#[test]
fn voxels_that_stations_saw_in_different_light_have_the_mean_of_what_they_saw() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Scene::named("house", &Params::new()).unwrap();
    let spec = SampleSpec { mode: Mode::Scanner(ScannerSpec::default()), ..SampleSpec::direct_count(80_000) };
    let texture = Texture { exposure: 0.5, ..texture(false) };
    let writing = WriteSpec { format: 7, texture: Some(texture), ..WriteSpec::for_path(&at.join("a.laz")) };
    let samples: Vec<Sample> = scene.samples(5, &spec).unwrap().collect();
    write_samples(&at.join("a.laz"), samples.iter().copied(), &writing).unwrap();
    let archive = convert(at, &["a.laz"], "a.slices", &["--colour", "rgb"]);
    let (frame, mut sums, mut lights) = (archive.frame(), Sums::new(), BTreeMap::new());
    for sample in &samples {
        let point = writing.rounded(sample.position).unwrap();
        let place = [frame.pixel_of(point[0]), frame.pixel_of(point[1]), frame.slice_of(point[2])];
        let (sum, n) = sums.entry(place).or_default();
        // The formula, with the fraction that the station records.
        let seen = texture.at(point).map(|value| (f64::from(value) * texture.share(sample.station)).round() as u64);
        seen.iter().zip(sum).for_each(|(value, sum)| *sum += value);
        *n += 1;
        lights.entry(place).or_insert_with(BTreeSet::new).insert(sample.station);
    }
    assert!(lights.values().filter(|stations| stations.len() > 1).count() > 500);
    let (found, count) = error_of(&archive, &sums, 65_535.0);
    assert!(count > 2000 && found <= 2.0, "{found} in {count} voxels");
}

#[test]
#[ignore = "slow: .ci/run"]
fn order_threads_budget_and_parts_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut points = points(90_000);
    write_textured(&at.join("one.laz"), &points, 7, false);
    points.reverse();
    points.rotate_left(12_345);
    write_textured(&at.join("turned.las"), &points, 2, false);
    let (first, second) = points.split_at(40_000);
    write_textured(&at.join("half-a.laz"), first, 3, false);
    write_textured(&at.join("half-b.las"), second, 8, false);
    for mode in ["rgb", "auto"] {
        let whole = convert(at, &["one.laz"], "whole.slices", &["--colour", mode]);
        assert!(whole.header().colours.is_some());
        let bytes = fs::read(at.join("whole.slices")).unwrap();
        for (inputs, options) in [
            (&["one.laz"][..], &["--threads", "1"][..]),
            (&["turned.las"], &["--threads", "3", "--memory", "64MiB"]),
            // Columns in strips of rows, and in smaller areas.
            (&["turned.las"], &["--threads", "16", "--memory", "64MiB"]),
            (&["turned.las"], &["--threads", "100", "--memory", "64MiB"]),
            (&["half-b.las", "half-a.laz"], &["--threads", "2"]),
        ] {
            convert(at, inputs, "again.slices", &[&["--colour", mode], options].concat());
            assert!(fs::read(at.join("again.slices")).unwrap() == bytes, "{inputs:?} {options:?}");
        }
        for count in [1, 3] {
            let parts: Vec<PathBuf> = (1..=count).map(|index| at.join(format!("{index}.slices"))).collect();
            for (index, part) in parts.iter().enumerate() {
                let shard = format!("{}/{count}", index + 1);
                convert(at, &["one.laz"], text(part), &["--colour", mode, "--shard", &shard]);
            }
            let merged = at.join("merged.slices");
            merge(&parts, &merged, true, &NoMonitor).unwrap();
            assert!(fs::read(&merged).unwrap() == bytes, "{count} parts");
        }
    }
    // With a plan, which fixes the source of colours for all parts.
    convert(at, &["half-a.laz", "half-b.las"], "whole.slices", &["--colour", "auto", "--colour-error", "4"]);
    let plan = ["half-a.laz", "half-b.las", "--write-plan", "plan.json", "--colour", "auto", "--colour-error", "4"];
    converts(at, &[&plan[..], &OPTIONS].concat());
    let parts: Vec<PathBuf> = (1..=2).map(|index| at.join(format!("planned-{index}.slices"))).collect();
    for (index, part) in parts.iter().enumerate() {
        let shard = format!("{}/2", index + 1);
        let arguments = ["half-a.laz", "half-b.las", "-o", text(part), "--plan", "plan.json", "--shard", &shard];
        converts(at, &[&arguments[..], &["--quiet", "--force"]].concat());
    }
    merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
    assert!(fs::read(at.join("merged.slices")).unwrap() == fs::read(at.join("whole.slices")).unwrap());
    // Parts whose colours were made differently do not belong together.
    convert(at, &["one.laz"], "1.slices", &["--colour", "intensity", "--shard", "1/2"]);
    convert(at, &["one.laz"], "2.slices", &["--colour", "rgb", "--shard", "2/2"]);
    assert!(merge(&[at.join("1.slices"), at.join("2.slices")], &at.join("merged.slices"), true, &NoMonitor).is_err());
    let refused =
        refuses(at, &["half-a.laz", "half-b.las", "-o", "x.slices", "--plan", "plan.json", "--colour", "class"], 2);
    assert!(refused.contains("--colour"), "{refused}");
}

#[test]
fn intensity_and_class_are_grey_and_a_palette_and_zeros_count_as_none() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points = points(30_000);
    write_textured(&at.join("a.laz"), &points, 7, true);
    let grey = convert(at, &["a.laz"], "grey.slices", &["--colour", "intensity", "--colour-error", "0"]);
    let found = colours(&grey);
    assert!(found.values().flatten().all(|[r, g, b]| r == g && g == b));
    assert!(found.values().flatten().any(|c| c[0] < 110) && found.values().flatten().any(|c| c[0] > 145), "stretched");
    let class = convert(at, &["a.laz"], "class.slices", &["--colour", "class", "--colour-error", "0"]);
    let palette = [2u8, 6].map(slicewalk::colour::class_colour);
    let pure = colours(&class).values().flatten().filter(|colour| palette.contains(colour)).count();
    assert!(pure > 100, "{pure} voxels have points of one class alone");
    // Without RGB, and with RGB of only zeros.
    write_las(&at.join("none.las"), points.iter().copied(), &WriteSpec::default()).unwrap();
    let mut bytes = fs::read(at.join("none.las")).unwrap();
    let auto = convert(at, &["none.las"], "a.slices", &["--colour", "auto"]);
    assert_eq!(auto.header().colours.unwrap().plan.scale.source.name(), "intensity");
    assert!(
        refuses(at, &["none.las", "-o", "b.slices", "--colour", "rgb"], 2).contains("no point of the input has an RGB")
    );
    let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    for record in bytes[start..].chunks_exact_mut(20) {
        record[12..14].fill(0);
    }
    fs::write(at.join("zero.las"), &bytes).unwrap();
    let said = refuses(at, &["zero.las", "-o", "b.slices", "--colour", "intensity"], 2);
    assert!(said.contains("no point of the input has an intensity other than 0"), "{said}");
    let said = converts(at, &["zero.las", "-o", "b.slices", "--pixel", "0.1", "--units", "m", "--colour", "auto"]);
    assert!(said.contains("no colours"), "{said}");
    let none = Archive::open(at.join("b.slices")).unwrap();
    assert_eq!((none.header().colours, none.header().version), (None, (1, 0)));
    assert!(ColourReader::new(&none).unwrap().is_none());
    for (arguments, word) in [
        (&["--colour", "rgb", "--colour-error", "-1"][..], "--colour-error"),
        (&["--colour", "blue"], "rgb, intensity"),
    ] {
        let said = refuses(at, &[&["a.laz", "-o", "c.slices"], arguments].concat(), 2);
        assert!(said.contains(word), "{said}");
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn damage_of_colours_is_named_and_leaves_the_geometry() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_textured(&at.join("a.las"), &points(20_000), 2, true);
    let good = convert(at, &["a.las"], "a.slices", &["--colour", "rgb", "--levels", "on"]);
    let bytes = fs::read(at.join("a.slices")).unwrap();
    let header = good.header().clone();
    let (from, to) = (header.colours_offset() as usize, header.levels_offset() as usize);
    assert_eq!((to - from) as u64, header.bytes.colours);
    for place in (from..to).step_by((to - from) / 150 + 1).chain(to - 12..to) {
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << (place % 8);
        let archive = Archive::from_bytes(damaged).unwrap();
        let mut rules = Vec::new();
        archive.verify(&NoMonitor, &mut |finding| rules.push((finding.rule, finding.part))).unwrap();
        assert!(
            !rules.is_empty() && rules.iter().all(|(rule, part)| rule.starts_with('K') && part.contains("colour")),
            "{rules:?}"
        );
        // The table's only leaf takes its last 12 bytes; its checksum is checked before any number in it is used.
        let is_table = |(rule, part): &(&str, String)| *rule == "K2" && part == "table of colours";
        assert!(place < to - 12 || rules.iter().all(is_table), "{rules:?}");
        for entry in good.entries().map(Result::unwrap) {
            assert_eq!(archive.page(&entry).unwrap(), good.page(&entry).unwrap());
        }
        // Either an error that names the rule, or the right colours.
        let Ok(Some(mut reader)) = ColourReader::new(&archive) else { continue };
        let mut sound = ColourReader::new(&good).unwrap().unwrap();
        for entry in good.entries().map(Result::unwrap) {
            match reader.colours(&entry) {
                Ok(colours) => assert_eq!(colours, sound.colours(&entry).unwrap()),
                Err(error) => assert!(matches!(error, Error::Format { rule, .. } if rule.starts_with('K')), "{error}"),
            }
        }
    }
}

#[test]
fn recovery_and_extracts_keep_the_colours_that_are_sound() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_textured(&at.join("a.las"), &points(40_000), 2, true);
    let good = convert(at, &["a.las"], "a.slices", &["--colour", "rgb"]);
    let all = colours(&good);
    let path = at.join("r.slices");
    let recovered = recover(&at.join("a.slices"), None, &path, true, &NoMonitor).unwrap();
    assert!(recovered.identical && recovered.is_complete());
    let mut bytes = fs::read(at.join("a.slices")).unwrap();
    bytes[good.header().colours_offset() as usize + 3] ^= 4;
    fs::write(at.join("damaged.slices"), &bytes).unwrap();
    let recovered = recover(&at.join("damaged.slices"), None, &path, true, &NoMonitor).unwrap();
    assert!(
        !recovered.is_complete() && recovered.dropped.iter().any(|what| what.contains("colours of")),
        "{:?}",
        recovered.dropped
    );
    verifies(&path);
    let left = colours(&Archive::open(&path).unwrap());
    assert_eq!(left.len(), all.len());
    let lost = left.iter().filter(|(place, colour)| **colour != all[*place]).count();
    assert!(lost > 0 && lost < all.len() / 2, "{lost} of {}", all.len());
    assert!(left.iter().all(|(place, colour)| colour.is_none() || *colour == all[place]));
    // In the table: all colours are lost, and nothing else.
    let end = good.header().levels_offset() as usize;
    bytes[end - 1] ^= 1;
    fs::write(at.join("damaged.slices"), &bytes).unwrap();
    recover(&at.join("damaged.slices"), None, &path, true, &NoMonitor).unwrap();
    verifies(&path);
    assert!(colours(&Archive::open(&path).unwrap()).values().all(Option::is_none));

    let (min, max) = good.header().bounds.unwrap();
    let middle = [0, 1, 2].map(|axis| (min[axis] + max[axis]) / 2.0);
    extract(&good, &(min, [middle[0], middle[1], max[2]]), &path, true, &NoMonitor).unwrap();
    verifies(&path);
    let part = Archive::open(&path).unwrap();
    let some = colours(&part);
    assert!(some.len() > 100 && some.len() < all.len());
    assert!(some.iter().all(|(place, colour)| *colour == all[place]));
    // Some systems cannot replace an open file.
    drop(part);
    extract(&good, &(min, max), &path, true, &NoMonitor).unwrap();
    assert_eq!(colours(&Archive::open(&path).unwrap()), all);
}

#[test]
#[ignore = "slow: .ci/run"]
fn colours_go_with_filled_holes_floaters_and_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points: Vec<_> = points(60_000).into_iter().filter(|p| (p[0] - 2.0).hypot(p[1] - 2.0) > 0.2).collect();
    write_textured(&at.join("a.laz"), &points, 7, true);
    for options in [
        &["--fill-holes", "0.4"][..],
        &["--tolerance", "0.05"],
        &["--drop-floaters", "3"],
        &["--fill-holes", "0.4", "--tolerance", "0.02", "--slice", "0.12"],
    ] {
        let archive = convert(at, &["a.laz"], "a.slices", &[&["--colour", "rgb"], options].concat());
        let sums = sums(&points, archive.frame(), |point| texture(true).at(point));
        let (table, mut error, mut count) = (LabTable::get(), 0.0, 0u32);
        for (place, colour) in colours(&archive) {
            if let (Some(colour), Some((sum, n))) = (colour, sums.get(&place)) {
                let exact = sum.map(|sum| (sum as f64 / *n as f64 * 257.0).round() as u16);
                error += f64::from(difference(table.of_16_bits(exact), table.of_8_bits(colour)));
                count += 1;
            }
        }
        // Holes are closed in an archive of 8-bit colours.
        assert!(count > 1000 && error / f64::from(count) <= 2.4, "{options:?}: {error} of {count}");
        if options[0] == "--fill-holes" {
            let inferred = archive.header().voxels.inferred;
            let none = colours(&archive).values().filter(|colour| colour.is_none()).count();
            assert!(inferred > 0 && none as u64 >= inferred);
            let parts = [1, 2].map(|index| at.join(format!("{index}.slices")));
            for (index, part) in parts.iter().enumerate() {
                let shard = format!("{}/2", index + 1);
                convert(at, &["a.laz"], text(part), &[&["--colour", "rgb", "--shard", &shard], options].concat());
            }
            merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
            assert!(fs::read(at.join("merged.slices")).unwrap() == fs::read(at.join("a.slices")).unwrap());
        }
    }
}

#[test]
fn real_scans_take_at_most_0_8_bytes_a_voxel() {
    for name in ["autzen_stadium.laz", "pump_room.laz"] {
        let Some(scan) = data::file(name) else { return };
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("a.slices");
        converts(folder.path(), &[text(&scan), "-o", text(&output), "--colour", "auto", "--quiet"]);
        let header = Archive::open(&output).unwrap().header().clone();
        let colours = header.colours.unwrap();
        let per_voxel = header.bytes.colours as f64 / colours.voxels as f64;
        println!("{name}: {} of {} voxels, {per_voxel:.3} bytes a voxel", colours.voxels, header.voxels.occupied);
        assert!(per_voxel <= 0.8, "{name}: {per_voxel}");
    }
}

/// A step that 32-bit floats, decimal text and LAS represent exactly.
const STEP: f64 = 1.0 / 1024.0;

/// Points of a floor and a wall, with colours up to `white` that depend on the position plus noise, and intensities up
/// to `most`.
fn coloured(count: usize, white: u16, most: u16) -> Vec<Coloured> {
    let mut random = Random(11);
    (0..count)
        .map(|number| {
            let mut steps = |size: f64| (random.uniform() * size / STEP).round() * STEP;
            let at = match number % 4 {
                0 => [7.0 + steps(0.02), steps(8.0) - 4.0, STEP + steps(3.0)],
                _ => [steps(8.0), steps(8.0) - 4.0, STEP + steps(0.03)],
            };
            let share = [at[0] / 8.0, (at[1] + 4.0) / 8.0, random.uniform()];
            let rgb = share.map(|share| (share * f64::from(white)).round() as u16);
            Coloured { at, rgb, intensity: (share[2] * share[0] * f64::from(most)).round() as u16 }
        })
        .collect()
}

fn bytes(at: &Path, inputs: &[&str], options: &[&str]) -> Vec<u8> {
    let fixed = ["-o", "out.slices", "--pixel", "0.25", "--quiet", "--force", "--temp-dir", "."];
    converts(at, &[inputs, &fixed, options].concat());
    fs::read(at.join("out.slices")).unwrap()
}

/// Checks that `verify` finds nothing; returns the exact colours of all voxels.
fn exact(at: &Path, inputs: &[&str], source: &str) -> BTreeMap<[i64; 3], Option<[u8; 3]>> {
    bytes(at, inputs, &["--colour", source, "--colour-error", "0"]);
    verifies(&at.join("out.slices"));
    colours(&Archive::open(at.join("out.slices")).unwrap())
}

/// Checks that no channel differs by more than rounding twice.
fn assert_near(
    found: &BTreeMap<[i64; 3], Option<[u8; 3]>>,
    expected: &BTreeMap<[i64; 3], Option<[u8; 3]>>,
    name: &str,
) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (place, colour) in expected {
        let near = match (found[place], colour) {
            (Some(a), Some(b)) => a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1),
            (a, b) => a == *b,
        };
        assert!(near, "{name}: {place:?}: {:?}, expected {colour:?}", found[place]);
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn every_format_gives_the_colours_of_the_same_points_as_las() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let put = |name: &str, bytes: &[u8]| fs::write(at.join(name), bytes).unwrap();
    let (narrow, wide) = (coloured(70_000, 255, 4_095), coloured(70_000, 65_535, 65_535));
    las(&at.join("narrow.las"), &narrow, STEP);
    las(&at.join("wide.las"), &wide, STEP);
    let of_narrow = |numbers, name: &str| {
        let cloud =
            |points| Cloud { points, colours: Some(numbers), intensities: Some(Numbers::Whole), invalid: false };
        e57(&at.join(name), &[cloud(&narrow[..66_000]), cloud(&narrow[66_000..])]);
    };
    put("text.ply", &coloured::ply(&narrow, Ply::Text, Numbers::Bytes));
    put("little.ply", &coloured::ply(&narrow, Ply::Little, Numbers::Bytes));
    put("big.ply", &coloured::ply(&narrow, Ply::Big, Numbers::Whole));
    put("text.pcd", &coloured::pcd(&narrow, Pcd::Text, false));
    put("float.pcd", &coloured::pcd(&narrow, Pcd::Text, true));
    put("binary.pcd", &coloured::pcd(&narrow, Pcd::Binary, true));
    put("packed.pcd", &coloured::pcd(&narrow, Pcd::Packed, false));
    let plain = coloured::rows(&narrow, " ", Numbers::Whole, Numbers::Whole);
    put("plain.xyz", plain.as_bytes());
    put("named.csv", format!("X,Y,Z,Intensity,Red,Green,Blue\n{}", plain.replace(' ', ",")).as_bytes());
    put("plain.pts", coloured::pts(&narrow, false).as_bytes());
    of_narrow(Numbers::Bytes, "narrow.e57");
    let options = |threads| ["--colour", "rgb", "--threads", threads, "--memory", "64MiB"];
    let expected = bytes(at, &["narrow.las"], &options("1"));
    assert_eq!(Archive::open(at.join("out.slices")).unwrap().header().colours.unwrap().plan.scale.high, 255);
    let columns = ["--columns", "x,y,z,i,r,g,b"];
    for name in [
        "text.ply",
        "little.ply",
        "big.ply",
        "text.pcd",
        "float.pcd",
        "binary.pcd",
        "packed.pcd",
        "plain.pts",
        "narrow.e57",
    ] {
        assert!(bytes(at, &[name], &options("3")) == expected, "{name}");
    }
    assert!(bytes(at, &["named.csv"], &options("3")) == expected, "named columns");
    assert!(bytes(at, &["plain.xyz"], &[&options("2")[..], &columns].concat()) == expected, "--columns");
    // Intensities in the range of LAS.
    let grey = bytes(at, &["narrow.las"], &["--colour", "intensity"]);
    for (name, more) in [
        ("text.ply", &[][..]),
        ("little.ply", &[]),
        ("big.ply", &[]),
        ("text.pcd", &[]),
        ("packed.pcd", &[]),
        ("plain.pts", &[]),
        ("named.csv", &[]),
        ("narrow.e57", &[]),
        ("plain.xyz", &columns),
    ] {
        assert!(bytes(at, &[name], &[&["--colour", "intensity"], more].concat()) == grey, "{name}");
    }
    // 16 bits, as whole numbers and from 0 to 1.
    let expected = bytes(at, &["wide.las"], &options("2"));
    assert_eq!(Archive::open(at.join("out.slices")).unwrap().header().colours.unwrap().plan.scale.high, 65_535);
    let grey = bytes(at, &["wide.las"], &["--colour", "intensity"]);
    for (name, numbers) in [("whole", Numbers::Whole), ("unit", Numbers::Unit)] {
        let names = [".ply", ".text.ply", ".xyz", ".e57"].map(|ending| format!("{name}{ending}"));
        put(&names[0], &coloured::ply(&wide, Ply::Little, numbers));
        put(&names[1], &coloured::ply(&wide, Ply::Text, numbers));
        put(&names[2], coloured::rows(&wide, "\t", numbers, numbers).as_bytes());
        let cloud = |points| Cloud { points, colours: Some(numbers), intensities: Some(numbers), invalid: false };
        e57(&at.join(&names[3]), &[cloud(&wide[..1000]), cloud(&wide[1000..])]);
        for name in &names {
            let more = if name.ends_with(".xyz") { &columns[..] } else { &[] };
            assert!(bytes(at, &[name], &[&options("2")[..], more].concat()) == expected, "{name}");
            assert!(bytes(at, &[name], &[&["--colour", "intensity"], more].concat()) == grey, "{name}, intensity");
        }
    }
    // Colours without a header that names them are not guessed, and `auto` falls back.
    put("bare.xyz", plain.as_bytes());
    let said = refuses(at, &["bare.xyz", "-o", "x.slices", "--colour", "rgb"], 2);
    assert!(said.contains("no point of the input has an RGB value") && said.contains("columns"), "{said}");
    put("spare.xyzrgb", coloured::rows(&narrow, " ", Numbers::Whole, Numbers::Whole).as_bytes());
    converts(at, &["spare.xyzrgb", "-o", "x.slices", "--colour", "auto", "--quiet"]);
    assert!(Archive::open(at.join("x.slices")).unwrap().header().colours.is_some());
    let wrong = plain.replacen("\n", " \n", 1).replacen(" 0.", " x0.", 40);
    put("wrong.xyz", wrong.as_bytes());
    let said = refuses(at, &[&["wrong.xyz", "-o", "y.slices", "--colour", "auto"], &columns[..]].concat(), 1);
    assert!(said.contains("line") && said.contains("expected a number"), "{said}");
}

#[test]
fn formats_mix_by_what_is_white_in_each_and_points_without_a_value_colour_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let put = |name: &str, bytes: &[u8]| fs::write(at.join(name), bytes).unwrap();
    let all = coloured(60_000, 255, 4_095);
    let widened: Vec<Coloured> = all.iter().map(|p| Coloured { rgb: p.rgb.map(|v| v * 257), ..*p }).collect();
    las(&at.join("narrow.las"), &all, STEP);
    las(&at.join("wide.las"), &widened, STEP);
    let (narrow, wide) = (exact(at, &["narrow.las"], "rgb"), bytes(at, &["wide.las"], &["--colour", "rgb"]));
    // 8 bits in LAS, PLY and text beside 16 in E57, in any order, with a plan and in parts.
    las(&at.join("a.las"), &all[..15_000], STEP);
    put("b.ply", &coloured::ply(&all[15_000..30_000], Ply::Big, Numbers::Bytes));
    put(
        "c.csv",
        format!("x,y,z,i,r,g,b\n{}", coloured::rows(&all[30_000..45_000], ",", Numbers::Whole, Numbers::Whole))
            .as_bytes(),
    );
    let cloud = Cloud { points: &widened[45_000..], colours: Some(Numbers::Unit), intensities: None, invalid: false };
    e57(&at.join("d.e57"), &[cloud]);
    let inputs = ["a.las", "b.ply", "c.csv", "d.e57"];
    for (inputs, threads) in [(inputs, "1"), (["d.e57", "c.csv", "a.las", "b.ply"], "3")] {
        assert!(bytes(at, &inputs, &["--colour", "auto", "--threads", threads]) == wide);
    }
    // 16 bits in LAS, which does not state them, beside 8 in PLY.
    las(&at.join("more.las"), &widened[..30_000], STEP);
    put("less.ply", &coloured::ply(&all[30_000..], Ply::Big, Numbers::Bytes));
    assert!(bytes(at, &["more.las", "less.ply"], &["--colour", "rgb"]) == wide);
    let fixed = ["--pixel", "0.25", "--colour", "rgb", "--quiet"];
    converts(at, &[&inputs[..], &["--write-plan", "plan.json", "--force"], &fixed].concat());
    for with_plan in [true, false] {
        let parts = ["1", "2", "3"].map(|index| at.join(format!("part-{with_plan}-{index}.slices")));
        for (index, part) in (1..).zip(&parts) {
            let shard = format!("{index}/3");
            let more = if with_plan { &["--plan", "plan.json", "--quiet"][..] } else { &fixed };
            converts(at, &[&inputs[..], &["-o", text(part), "--shard", &shard], more].concat());
        }
        merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
        assert!(fs::read(at.join("merged.slices")).unwrap() == wide, "with plan: {with_plan}");
    }
    // Without the 16-bit file, all are read unchanged.
    let three = exact(at, &inputs[..3], "rgb");
    las(&at.join("three.las"), &all[..45_000], STEP);
    assert_eq!(three, exact(at, &["three.las"], "rgb"));
    // The second cloud has no colours, and neither have points marked so.
    let (coloured, bare) = all.split_at(30_000);
    put("two.ptx", coloured::ptx([coloured, bare]).as_bytes());
    las(&at.join("half.las"), coloured, STEP);
    put("bare.xyz", coloured::rows(bare, " ", Numbers::Whole, Numbers::Whole).as_bytes());
    let half = exact(at, &["half.las", "bare.xyz"], "rgb");
    assert!(half.values().any(Option::is_none) && half.values().any(Option::is_some));
    assert_eq!(exact(at, &["two.ptx"], "rgb"), half);
    let cloud = |points, colours, invalid| Cloud { points, colours, intensities: Some(Numbers::Whole), invalid };
    e57(&at.join("two.e57"), &[cloud(coloured, Some(Numbers::Bytes), false), cloud(bare, None, false)]);
    assert_eq!(exact(at, &["two.e57"], "rgb"), half);
    e57(&at.join("invalid.e57"), &[cloud(&all, Some(Numbers::Bytes), true)]);
    assert_eq!(exact(at, &["invalid.e57"], "rgb"), narrow);
    assert_eq!(exact(at, &["invalid.e57"], "intensity"), exact(at, &["narrow.las"], "intensity"));
    // The limits stated by the file mean black and white: 12 bits of intensity become 16.
    let unit = exact(at, &["two.ptx"], "intensity");
    assert_eq!(unit, exact(at, &["narrow.las"], "intensity"));
    put("signed.pts", coloured::pts(&all, true).as_bytes());
    assert_near(&exact(at, &["signed.pts"], "intensity"), &unit, "-2048 to 2047");
}

/// Mean colours of a cloud's points by pixel and slice, from another reader (0 to 1).
fn means(frame: &Frame, points: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> BTreeMap<[i64; 3], [f64; 3]> {
    let mut sums: BTreeMap<[i64; 3], ([f64; 3], f64)> = BTreeMap::new();
    for (at, rgb) in points {
        let sum = sums.entry([frame.pixel_of(at[0]), frame.pixel_of(at[1]), frame.slice_of(at[2])]).or_default();
        (0..3).for_each(|channel| sum.0[channel] += rgb[channel]);
        sum.1 += 1.0;
    }
    sums.into_iter().map(|(place, (sum, n))| (place, sum.map(|sum| sum / n * 255.0))).collect()
}

#[test]
fn real_clouds_have_the_colours_that_other_readers_find() {
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, least: usize, points: &mut dyn Iterator<Item = ([f64; 3], [f64; 3])>| {
        let Some(path) = data::file(name) else { return };
        let fixed = ["-o", "a.slices", "--pixel", "0.05", "--units", "m", "--quiet", "--force"];
        converts(folder.path(), &[&[text(&path)], &fixed[..], &["--colour", "rgb", "--colour-error", "0"]].concat());
        let archive = Archive::open(folder.path().join("a.slices")).unwrap();
        let (means, mut compared) = (means(archive.frame(), points), 0);
        for (place, colour) in colours(&archive) {
            let (Some(colour), Some(mean)) = (colour, means.get(&place)) else { continue };
            compared += 1;
            assert!(
                (0..3).all(|c| (f64::from(colour[c]) - mean[c]).abs() < 0.51),
                "{name}: {place:?} {colour:?} {mean:?}"
            );
        }
        assert!(compared >= least, "{name}: {compared} voxels");
    };
    for (name, least) in [
        ("formats/e57/pumpAVisualReferenceImage.e57", 5000),
        ("formats/e57/ColouredCubeDouble.e57", 500),
        ("formats/e57/tinyCartesianFloatRgb.e57", 100),
        ("formats/e57/las2e57_no_images_tag.e57", 50),
        ("formats/made/pump_three_stations_poses.e57", 0),
    ] {
        let Some(path) = data::file(name) else { return };
        let mut reader = ::e57::E57Reader::from_file(path).unwrap();
        let mut found = Vec::new();
        for cloud in reader.pointclouds() {
            let mut points = reader.pointcloud_simple(&cloud).unwrap();
            points.apply_pose(true);
            for point in points.map(Result::unwrap) {
                let ::e57::CartesianCoordinate::Valid { x, y, z } = point.cartesian else { continue };
                found.extend(point.color.map(|c| ([x, y, z], [c.red, c.green, c.blue].map(f64::from))));
            }
        }
        if least > 0 || !found.is_empty() {
            check(name, least, &mut found.into_iter());
        }
    }
    // Doubles, followed by bytes of colours in this file.
    let name = "formats/ply/fragment_002.ply";
    if let Some(path) = data::file(name) {
        let bytes = fs::read(path).unwrap();
        let start = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let point = |record: &[u8; 27]| {
            let at = [0, 8, 16].map(|at| f64::from_le_bytes(record[at..at + 8].try_into().unwrap()));
            (at, [24, 25, 26].map(|at| f64::from(record[at]) / 255.0))
        };
        check(name, 1000, &mut bytes[start..].as_chunks().0.iter().map(point));
    }
    // Compressed by the Point Cloud Library; every voxel has a colour, and the colours differ.
    for name in [
        "formats/pcd/milk_color.pcd",
        "formats/pcd/office1.pcd",
        "formats/ptx/1.2-with-color.ptx",
        "formats/pts/test.pts",
    ] {
        let Some(path) = data::file(name) else { return };
        let found = exact(folder.path(), &[text(&path)], "rgb");
        let different: std::collections::BTreeSet<_> = found.values().collect();
        assert!(!different.contains(&None) && different.len() > 4, "{name}: {} colours", different.len());
    }
}
