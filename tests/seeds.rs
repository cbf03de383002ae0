//! The fuzz targets over seeds: as they are, and changed at random. No bytes make a decoder or a reader panic. A fault planted behind
//! the checks of a target is found, so changes get there.
//!
//! `tests/fuzz/seeds/TARGET/` holds seeds and what fuzzing found, small and committed; the samples of the format are seeds
//! too. `SLICEWALK_FUZZ_RUNS` sets how many changed inputs each target gets, `SLICEWALK_FUZZ_SEED` where their numbers begin,
//! `SLICEWALK_FUZZ_TARGETS` which targets run (names with commas between them; all by default).
#![cfg(feature = "cli")]

#[path = "common/random.rs"]
mod random;
#[path = "fuzz/targets.rs"]
mod targets;

use random::Random;
use std::path::Path;
use targets::TARGETS;

/// Values at which checks of numbers end.
const EDGES: [u64; 8] = [0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFF_FFFF, u64::MAX];

/// One to four changes of the kinds that break formats: bits, numbers at their edges, pieces cut, doubled or taken from
/// another seed.
fn change(bytes: &mut Vec<u8>, others: &[Vec<u8>], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        let len = random.below(64).min(bytes.len() - at.min(bytes.len()));
        match random.below(7) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            1 if !bytes.is_empty() => bytes[at] = random.bits() as u8,
            2 => {
                let width = [1, 2, 4, 8][random.below(4)].min(bytes.len() - at.min(bytes.len()));
                let value = EDGES[random.below(EDGES.len())].to_le_bytes();
                bytes[at..at + width].copy_from_slice(&value[..width]);
            }
            3 => drop(bytes.drain(at..at + len)),
            4 => {
                let piece = bytes[at..at + len].to_vec();
                bytes.splice(at..at, piece);
            }
            5 => bytes.truncate(at),
            _ => {
                let other = &others[random.below(others.len())];
                let from = random.below(other.len());
                let piece = &other[from..other.len().min(from + len)];
                bytes.splice(at..at, piece.iter().copied());
            }
        }
    }
}

fn seeds(target: &str) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![root.join("tests/fuzz/seeds").join(target)];
    if target == "archive" {
        folders.push(root.join("spec/samples"));
    }
    let mut paths: Vec<_> = folders
        .iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display())))
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_none_or(|ending| target != "archive" || ending != "json"))
        .collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// One of the seeds, changed by a number.
fn changed(seeds: &[Vec<u8>], number: u64) -> Vec<u8> {
    let mut random = Random(number);
    let mut bytes = seeds[random.below(seeds.len())].clone();
    change(&mut bytes, seeds, &mut random);
    bytes
}

#[test]
fn seeds_and_changed_seeds_make_no_target_panic() {
    let number = |name: &str, default: u64| std::env::var(name).ok().map_or(default, |text| text.parse().unwrap());
    let (runs, first) = (number("SLICEWALK_FUZZ_RUNS", 300), number("SLICEWALK_FUZZ_SEED", 1));
    let wanted = std::env::var("SLICEWALK_FUZZ_TARGETS").ok();
    let is_wanted = |name: &str| wanted.as_ref().is_none_or(|wanted| wanted.split(',').any(|word| word == name));
    std::thread::scope(|scope| {
        for &(name, target) in TARGETS.iter().filter(|(name, _)| is_wanted(name)) {
            scope.spawn(move || {
                let seeds = seeds(name);
                assert!(!seeds.is_empty(), "{name} has no seed");
                for seed in &seeds {
                    let _ = target(seed);
                }
                for seed in first..first + runs {
                    let bytes = changed(&seeds, seed);
                    let done = std::panic::catch_unwind(|| target(&bytes));
                    assert!(
                        done.is_ok(),
                        "{name}: the input of seed {seed} panics; SLICEWALK_FUZZ_SEED={seed} repeats it"
                    );
                }
                println!("{name}: {} seeds, {runs} changed ones from number {first} on", seeds.len());
            });
        }
    });
}

/// The fault: a panic where something is read to its end that no seed says.
#[test]
fn a_fault_behind_all_checks_of_a_target_is_found() {
    const INPUTS: u64 = 20_000;
    std::thread::scope(|scope| {
        for &(name, target) in TARGETS {
            scope.spawn(move || {
                let seeds = seeds(name);
                let known: Vec<_> = seeds.iter().map(|seed| target(seed)).collect();
                assert!(known.iter().any(Option::is_some), "{name}: no seed is read to its end");
                let found = (1..=INPUTS).find(|&number| {
                    let read = target(&changed(&seeds, number));
                    read.is_some() && !known.contains(&read)
                });
                let found = found.unwrap_or_else(|| panic!("{name}: no changed input gets past the checks"));
                println!("{name}: the planted fault is found by input {found}");
            });
        }
    });
}
