//! `--colour`: each voxel has the mean colour of its points within the stated error, the geometry does not know of it, and no order,
//! thread, budget or part changes a byte. Truth is a formula of the place ([`Texture`]), summed up here by brute force.
#![cfg(feature = "cli")]

#[path = "common/scans.rs"]
mod scans;

use scangen::{Chunks, Params, SampleSpec, Scene, Texture, WriteSpec, write_las};
use scans::{converts, data, refuses, text, verifies};
use slicewalk::archive::{Archive, ColourReader, extract, merge, recover};
use slicewalk::colour::{LabTable, difference, to_8_bits};
use slicewalk::frame::{Frame, PAGE_SLICES, TILE_PIXELS};
use slicewalk::{Error, NoMonitor};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const OPTIONS: [&str; 6] = ["--pixel", "0.1", "--units", "m", "--quiet", "--force"];

/// Exact sums of the colours of points by pixel and slice.
type Sums = BTreeMap<[i64; 3], ([u64; 3], u64)>;

fn texture(eight_bits: bool) -> Texture {
    Texture { period_m: 1.7, eight_bits }
}

/// Points of a house in whole millimetres.
fn points(count: u64) -> Vec<[f64; 3]> {
    let scene = Scene::named("house", &Params::new()).unwrap();
    let spec = SampleSpec::direct_count(count).with_noise(0.004);
    let rounding = WriteSpec::default();
    scene.samples(3, &spec).unwrap().filter_map(|sample| rounding.rounded(sample.position)).collect()
}

/// Writes points with colours.
fn write(path: &Path, points: &[[f64; 3]], format: u8, eight_bits: bool) {
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

/// The colours of all voxels of an archive; `None` where a voxel has none.
fn colours(archive: &Archive) -> BTreeMap<[i64; 3], Option<[u8; 3]>> {
    let mut reader = ColourReader::new(archive).unwrap().expect("the archive has colours");
    let mut found = BTreeMap::new();
    for entry in archive.entries().map(Result::unwrap) {
        let key = entry.key;
        for (px, py, k, colour) in reader.colours(&entry).unwrap().voxels() {
            let at = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
            found.insert([at(key.tx, px), at(key.ty, py), i64::from(key.layer) * PAGE_SLICES + i64::from(k)], colour);
        }
    }
    found
}

/// Mean difference from the exact means (ΔE*ab), and voxels compared. Every voxel with matter and points has a colour.
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
        write(&at.join(name), &points, format, eight_bits);
        let greatest = if eight_bits { 255.0 } else { 65_535.0 };
        for (error, options) in [
            (2.0, &[][..]),
            (0.0, &["--colour-error", "0"][..]),
            (5.0, &["--colour-error", "5", "--levels", "on", "--min-points", "2"][..]),
        ] {
            let options = [&["--colour", "rgb"], options].concat();
            let archive = convert(at, &[name], "a.slices", &options);
            let header = archive.header();
            assert_eq!(header.version, (1, 3));
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
fn order_threads_budget_and_parts_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut points = points(90_000);
    write(&at.join("one.laz"), &points, 7, false);
    points.reverse();
    points.rotate_left(12_345);
    write(&at.join("turned.las"), &points, 2, false);
    let (first, second) = points.split_at(40_000);
    write(&at.join("half-a.laz"), first, 3, false);
    write(&at.join("half-b.las"), second, 8, false);
    for mode in ["rgb", "auto"] {
        let whole = convert(at, &["one.laz"], "whole.slices", &["--colour", mode]);
        assert!(whole.header().colours.is_some());
        let bytes = fs::read(at.join("whole.slices")).unwrap();
        for (inputs, options) in [
            (&["one.laz"][..], &["--threads", "1"][..]),
            (&["turned.las"], &["--threads", "3", "--memory", "64MiB"]),
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
    // By a plan, which says for all parts what colours are made of.
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
    // Parts whose colours were made in another way do not belong together.
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
    write(&at.join("a.laz"), &points, 7, true);
    let grey = convert(at, &["a.laz"], "a.slices", &["--colour", "intensity", "--colour-error", "0"]);
    let found = colours(&grey);
    assert!(found.values().flatten().all(|[r, g, b]| r == g && g == b));
    assert!(found.values().flatten().any(|c| c[0] < 110) && found.values().flatten().any(|c| c[0] > 145), "stretched");
    let class = convert(at, &["a.laz"], "a.slices", &["--colour", "class", "--colour-error", "0"]);
    let palette = [2u8, 6].map(slicewalk::colour::class_colour);
    let pure = colours(&class).values().flatten().filter(|colour| palette.contains(colour)).count();
    assert!(pure > 100, "{pure} voxels have points of one class alone");
    // Without RGB, and with RGB of zeros alone.
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
    let said = converts(at, &["zero.las", "-o", "b.slices", "--pixel", "0.1", "--units", "m", "--colour", "auto"]);
    assert!(said.contains("no colours"), "{said}");
    let none = Archive::open(at.join("b.slices")).unwrap();
    assert_eq!((none.header().colours, none.header().version), (None, (1, 0)));
    assert!(ColourReader::new(&none).unwrap().is_none());
    for (arguments, word) in [
        (&["--colour", "rgb", "--resume"][..], "resum"),
        (&["--colour", "rgb", "--colour-error", "-1"], "--colour-error"),
        (&["--colour", "blue"], "rgb, intensity"),
    ] {
        let said = refuses(at, &[&["a.laz", "-o", "c.slices"], arguments].concat(), 2);
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn damage_of_colours_is_named_and_leaves_the_geometry() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(&at.join("a.las"), &points(20_000), 2, true);
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
    write(&at.join("a.las"), &points(40_000), 2, true);
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
    // The table: all colours are lost, and nothing else.
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
    extract(&good, &(min, max), &path, true, &NoMonitor).unwrap();
    assert_eq!(colours(&Archive::open(&path).unwrap()), all);
}

#[test]
fn colours_go_with_filled_holes_floaters_and_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points: Vec<_> = points(60_000).into_iter().filter(|p| (p[0] - 2.0).hypot(p[1] - 2.0) > 0.2).collect();
    write(&at.join("a.laz"), &points, 7, true);
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
        // Holes are closed from an archive of 8-bit colours.
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
