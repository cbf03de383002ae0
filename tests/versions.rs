//! Archives of every released version read, verify and answer for ever.
//!
//! Each `*.slices` in `tests/golden/` has a `*.txt` twin that says what it holds. New ones are made by
//! `SLICEWALK_GOLDEN=write cargo test --test versions`, which never replaces one that is there.

mod common;

use common::{archive, archive_with_colours, archive_with_levels, braided, plan, render, scene, two_pixels};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, Totals};
use slicewalk::colour::ColourScale;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Archives of version 1.0, with colours and levels one of 1.4, one of 1.5, one of 1.4 whose levels have no colours, and one of 1.3. Nobody
/// writes the last two any more.
const GOLDEN: [&str; 7] = ["empty", "scene", "two-pixels", "level-colours", "braided", "levels", "colours"];

fn with_colours() -> Vec<u8> {
    archive_with_colours(&scene(), ColourScale::of_rgb(255), 2000, true)
}

fn with_braids() -> Vec<u8> {
    archive_with_levels(&braided(&plan()), &scene(), None)
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn write_missing() {
    if std::env::var("SLICEWALK_GOLDEN").as_deref() != Ok("write") {
        return;
    }
    let made = [(Default::default(), Totals::default()), scene(), two_pixels()];
    for (name, bytes) in GOLDEN.iter().zip(made.iter().map(archive).chain([with_colours(), with_braids()])) {
        let path = golden(&format!("{name}.slices"));
        if !path.exists() {
            std::fs::write(path, &bytes).unwrap();
            std::fs::write(golden(&format!("{name}.txt")), render(&Archive::from_bytes(bytes).unwrap())).unwrap();
        }
    }
}

#[test]
fn every_golden_archive_opens_verifies_and_answers() {
    write_missing();
    for name in GOLDEN {
        let archive = Archive::open(golden(&format!("{name}.slices"))).unwrap();
        let mut findings = Vec::new();
        archive.verify(&NoMonitor, &mut |finding| findings.push(finding)).unwrap();
        assert_eq!(findings, [], "{name}");
        let expected = std::fs::read_to_string(golden(&format!("{name}.txt"))).unwrap();
        assert_eq!(render(&archive), expected, "{name}");
        for entry in archive.entries().map(Result::unwrap) {
            assert_eq!(archive.find(entry.key).unwrap(), Some(entry));
        }
    }
}

#[test]
fn no_golden_archive_is_unlisted() {
    let listed: BTreeSet<String> =
        GOLDEN.iter().flat_map(|name| [format!("{name}.slices"), format!("{name}.txt")]).collect();
    let present = std::fs::read_dir(golden("")).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(present.filter(|name| !name.starts_with('.')).collect::<BTreeSet<_>>(), listed);
}

#[test]
fn what_is_written_today_holds_what_was_written_then() {
    for (name, bytes) in [
        ("scene", archive(&scene())),
        ("two-pixels", archive(&two_pixels())),
        ("level-colours", with_colours()),
        ("braided", with_braids()),
    ] {
        let expected = std::fs::read_to_string(golden(&format!("{name}.txt"))).unwrap();
        assert_eq!(render(&Archive::from_bytes(bytes).unwrap()), expected, "{name}");
    }
}

#[test]
fn the_worked_example_of_the_specification_is_the_golden_archive() {
    let spec = Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/slice-archive.md");
    let text = std::fs::read_to_string(spec).unwrap();
    let mut bytes = Vec::new();
    for line in text.lines().filter(|line| line.starts_with("0x")) {
        let (offset, rest) = line.split_once(": ").unwrap();
        assert_eq!(usize::from_str_radix(&offset[2..], 16).unwrap(), bytes.len(), "{line}");
        let hex = rest.split("  ").next().unwrap().trim();
        match hex.split_once(" times ") {
            Some((count, byte)) => {
                let byte = u8::from_str_radix(byte, 16).unwrap();
                bytes.extend(std::iter::repeat_n(byte, count.parse().unwrap()));
            }
            None => bytes.extend(hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap())),
        }
    }
    assert_eq!(bytes, std::fs::read(golden("two-pixels.slices")).unwrap());
}
