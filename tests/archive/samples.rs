//! The archives in `spec/samples/`, each with a JSON twin that states its content or the rule that it breaks: material
//! for readers of the format, such as `spec/reader.py`.
//!
//! `SLICEWALK_SAMPLES=write cargo test --test archive samples` regenerates them.

use crate::common;
use crate::levels::damaged_levels;
mod damaged;
mod damaged_seen;
mod good;

use common::content::content_or_rule;
use common::read_all;
use serde_json::{Value, json};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Every sample: its name, its bytes, and the rule that it breaks.
fn all() -> Vec<(String, Vec<u8>, Option<&'static str>)> {
    let good = good::all().into_iter().map(|(name, bytes)| (name.to_string(), bytes, None));
    let damaged = damaged::all().into_iter().chain(damaged_seen::all()).chain(damaged_levels());
    good.chain(damaged.map(|(name, rule, bytes)| (format!("damaged-{name}"), bytes, Some(rule)))).collect()
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/samples")
}

/// The JSON twin as stored: one page per line.
fn text(twin: &Value) -> String {
    let Some(pages) = twin["pages"].as_array() else { return format!("{twin}\n") };
    let pages: Vec<_> = pages.iter().map(Value::to_string).collect();
    let [seen, levels] = ["seen", "levels"]
        .map(|name| twin.get(name).map_or(String::new(), |section| format!(",\n\"{name}\": {section}")));
    format!("{{\"info\": {},\n\"pages\": [\n{}\n]{seen}{levels}}}\n", twin["info"], pages.join(",\n"))
}

/// Only some pages, by index, of a content with very many.
fn short(mut content: Value) -> Value {
    let Some(pages) = content["pages"].as_array().filter(|pages| pages.len() > 1000) else { return content };
    let some = [0, 1, 2, 4095, 4096, pages.len() - 1];
    let some: serde_json::Map<_, _> = some.into_iter().map(|at| (at.to_string(), pages[at].clone())).collect();
    content["some_pages"] = some.into();
    content.as_object_mut().unwrap().remove("pages");
    content
}

#[test]
fn every_sample_holds_what_its_twin_says() {
    let write = std::env::var("SLICEWALK_SAMPLES").as_deref() == Ok("write");
    let mut listed = BTreeSet::from([".gitignore".to_string()]);
    let mut sum = 0;
    for (name, bytes, rule) in all() {
        let twin = short(content_or_rule(bytes.clone()));
        if let Some(rule) = rule {
            assert_eq!(twin, json!({ "rule": rule }), "{name}");
        }
        let [archive, json] = ["slices", "json"].map(|end| format!("{name}.{end}"));
        if write {
            std::fs::write(folder().join(&archive), &bytes).unwrap();
            std::fs::write(folder().join(&json), text(&twin)).unwrap();
        }
        let stored = std::fs::read(folder().join(&archive)).unwrap();
        let expected: Value = serde_json::from_slice(&std::fs::read(folder().join(&json)).unwrap()).unwrap();
        assert!(stored.len() < 20_000, "{name} is large: {} bytes", stored.len());
        sum += stored.len();
        assert!(short(content_or_rule(stored)) == expected, "{name} does not hold what its twin says");
        assert!(twin == expected, "{name} as it is made today does not hold what its twin says");
        listed.extend([archive, json]);
    }
    assert!(sum < 150_000, "{sum} bytes");
    let present = std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(present.collect::<BTreeSet<_>>(), listed);
}

#[test]
#[ignore = "slow: .ci/run"]
fn every_changed_byte_of_a_good_sample_is_found() {
    for (name, good) in good::all() {
        let pages = read_all(&Archive::from_bytes(good.clone()).unwrap()).unwrap();
        // A full check of very many pages, spans or bytes would take long; the step is odd, so that all bits of bytes
        // get their turn.
        let step = match pages.values().map(|page| page.span_count()).sum::<usize>() {
            _ if pages.len() > 1000 => 293,
            spans if spans > 10_000 => 17,
            _ => (good.len() / 2400) | 1,
        };
        for at in (0..good.len()).step_by(step) {
            let mut bytes = good.clone();
            bytes[at] ^= 1 << (at % 8);
            let Ok(archive) = Archive::from_bytes(bytes) else { continue };
            let mut findings = 0;
            archive.verify(&NoMonitor, &mut |_| findings += 1).unwrap();
            assert!(findings > 0, "{name}: byte {at}");
            if let Ok(read) = read_all(&archive) {
                assert_eq!(read, pages, "{name}: byte {at} changes the content");
            }
        }
    }
}

#[test]
fn the_worked_example_of_the_specification_is_a_sample() {
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
    assert_eq!(bytes, std::fs::read(folder().join("two-pixels.slices")).unwrap());
}
