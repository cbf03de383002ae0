//! Colours in pictures, exports, tables and comparisons.

use scangen::{Texture, WriteSpec, write_las};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader};
use slicewalk::colour::ColourSource;
use slicewalk_convert::{ColourMode, ConvertOptions, PixelSize, convert};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// A folder with archives of a floor of 3.2 × 3.2 m with a wall: with colours, without, and with coarse ones.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let floor = (0..64).flat_map(|i| (0..64).map(move |j| [step(i), step(j), 0.35]));
    let wall = (0..64).flat_map(|j| (0..40).map(move |k| [2.525, step(j), 0.35 + step(k)]));
    let texture = Some(Texture { period_m: 1.3, eight_bits: false, exposure: 0.0 });
    let spec = WriteSpec { format: 7, texture, ..WriteSpec::for_path(&scan) };
    write_las(&scan, floor.chain(wall), &spec).unwrap();
    for (name, colour, error) in [
        ("a.slices", ColourMode::Of(ColourSource::Rgb), 0.0),
        ("b.slices", ColourMode::Of(ColourSource::Rgb), 4.0),
        ("plain.slices", ColourMode::Off, 2.0),
    ] {
        let mut options = ConvertOptions::new(vec![scan.clone()], folder.path().join(name));
        options.grid.pixel = PixelSize::Metres(0.1);
        (options.sections.colour, options.sections.colour_error) = (colour, error);
        convert(&options, &NoMonitor).unwrap();
    }
    folder
}

fn slicetool(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_slicetool")).current_dir(folder).args(arguments).output().unwrap()
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let out = slicetool(folder, arguments);
    assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&done(folder, &[arguments, &["--json"]].concat())).unwrap()
}

#[test]
fn pictures_and_exports_have_the_colours_of_voxels() {
    let folder = folder();
    let at = folder.path();
    let archive = Archive::open(at.join("a.slices")).unwrap();
    let mut reader = ColourReader::new(&archive).unwrap().unwrap();
    let entry = archive.entries().next().unwrap().unwrap();
    let colours = reader.colours(&entry).unwrap();
    assert_eq!(colours.count(), archive.header().voxels.occupied, "one page, and every voxel has a colour");

    done(at, &["show", "a.slices", "--z", "0.35", "--colour", "-o", "slice.png"]);
    let mut png =
        png::Decoder::new(std::io::BufReader::new(fs::File::open(at.join("slice.png")).unwrap())).read_info().unwrap();
    let mut pixels = vec![0; png.output_buffer_size().unwrap()];
    let (width, height) = (png.info().width as usize, png.info().height as usize);
    png.next_frame(&mut pixels).unwrap();
    assert_eq!((width, height), (32, 32));
    for (px, py) in (0..32).flat_map(|px| (0..32).map(move |py| (px, py))) {
        let place = ((height - 1 - py) * width + px) * 3;
        assert_eq!(Some(pixels[place..place + 3].try_into().unwrap()), colours.of(px as u32, py as u32, 1));
    }

    let expected: Vec<[u8; 3]> = colours.voxels().filter_map(|(.., colour)| colour).collect();
    done(at, &["export", "a.slices", "-o", "a.ply"]);
    let ply = fs::read(at.join("a.ply")).unwrap();
    let body = ply.len() - 27 * expected.len();
    let found: Vec<[u8; 3]> = ply[body..].chunks_exact(27).map(|point| point[24..].try_into().unwrap()).collect();
    assert_eq!(found, expected);
    for name in ["a.las", "a.laz"] {
        done(at, &["export", "a.slices", "-o", name]);
        let points = las::Reader::from_path(at.join(name)).unwrap().read_all().unwrap();
        let found: Vec<[u8; 3]> =
            points.rgb().unwrap().map(|(r, g, b)| [r, g, b].map(|value| (value / 257) as u8)).collect();
        assert_eq!(found, expected, "{name}");
    }
    let out = slicetool(at, &["show", "plain.slices", "--slice", "0", "--colour", "-o", "no.png"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("has no colours"));
    assert!(!at.join("no.png").exists());
}

#[test]
fn tables_count_colours_and_comparisons_find_theirs() {
    let folder = folder();
    let at = folder.path();
    let (info, stats) = (json(at, &["info", "a.slices"]), json(at, &["stats", "a.slices"]));
    assert_eq!(info["colour"]["source"], "rgb");
    assert_eq!(info["colour"]["range"], serde_json::json!([0, 65_535]));
    assert!(info["bytes"]["colours"].as_u64().unwrap() > 0);
    assert_eq!(info["bytes"]["colours"], stats["bytes"]["colours"]);
    assert_eq!(info["colour"]["voxels"], stats["colours"]["voxels"]);
    assert_eq!(json(at, &["info", "plain.slices"])["bytes"]["colours"], 0);
    assert!(done(at, &["info", "a.slices"]).contains("RGB (16-bit values)"));
    assert_eq!(stats["colours"]["bytes"], stats["bytes"]["colours"], "without levels");
    assert_eq!(stats["colours"]["levels"], 0);
    let voxels = info["voxels"]["occupied"].as_u64().unwrap();
    let same = json(at, &["diff", "a.slices", "a.slices"]);
    assert_eq!((&same["identical"], &same["colours"]["in_both"]), (&true.into(), &voxels.into()));
    let other = json(at, &["diff", "a.slices", "b.slices"]);
    let mean = other["colours"]["mean_difference"].as_f64().unwrap();
    assert_eq!((&other["identical"], &other["pages"]["differing"]), (&false.into(), &0.into()));
    assert!(mean > 0.5 && mean < 4.3, "{mean}");
    let without = json(at, &["diff", "plain.slices", "b.slices"]);
    assert_eq!((&without["colours"]["only_a"], &without["colours"]["only_b"]), (&0.into(), &voxels.into()));
    assert_eq!(json(at, &["diff", "plain.slices", "plain.slices"])["colours"], Value::Null);
    assert!(done(at, &["verify", "a.slices"]).contains(": ok, "));
}

#[test]
fn copies_with_edits_keep_the_colours_that_remain() {
    let folder = folder();
    let at = folder.path();
    let edits = r#"{"remove": [{"box": [1, 1, -1, 3, 2, 3]}], "add": [{"box": [0.5, 0.5, 0.5, 0.9, 0.9, 1]}]}"#;
    fs::write(at.join("e.json"), edits).unwrap();
    done(at, &["extract", "a.slices", "--edits", "e.json", "-o", "edited.slices"]);
    assert!(done(at, &["verify", "edited.slices"]).contains(": ok, "));
    let found = json(at, &["diff", "a.slices", "edited.slices"]);
    let count = |of: &str, name: &str| found[of][name].as_u64().unwrap();
    assert!(count("voxels", "only_a") > 200 && count("voxels", "only_b") > 20, "{found}");
    // Added solid has no colour.
    assert_eq!(count("colours", "only_a"), count("voxels", "only_a"), "{found}");
    assert_eq!((count("colours", "only_b"), count("colours", "other")), (0, 0), "{found}");
    assert!(count("colours", "in_both") > 900, "{found}");
}
