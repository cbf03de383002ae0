//! The fuzz targets over seeds, unchanged and changed at random. No bytes make a decoder or reader panic. A fault
//! planted behind a target's checks is found, which shows that changes get there.
//!
//! `tests/fuzz/seeds/TARGET/` holds seeds and findings of fuzzing, small and committed; the format's samples are seeds
//! too. `SLICEWALK_FUZZ_RUNS` sets the number of changed inputs per target, `SLICEWALK_FUZZ_SEED` where their numbers
//! begin, `SLICEWALK_FUZZ_TARGETS` the targets (names separated by commas; all by default).
//!
//! With `SLICEWALK_FUZZ_TOTALS`, a file, runs continue where earlier ones ended: batches alternate until each target
//! has had the inputs 1 to `SLICEWALK_FUZZ_RUNS`. The file has a line for each target, `NAME RUNS`, written after each
//! batch, and one for each finding, `finding NAME INPUT`, which stays until it is fixed and the line removed by hand.
//! `SLICEWALK_FUZZ_THREADS` sets the number of targets run concurrently, one by default.

#[path = "common/random.rs"]
mod random;
#[path = "fuzz/targets.rs"]
mod targets;

use random::Random;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use targets::{TARGETS, Target};

/// Values at the limits of numeric checks.
const EDGES: [u64; 8] = [0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFF_FFFF, u64::MAX];

/// Makes one to four changes of kinds that break formats: flipped bits, numbers at their limits, parts cut, doubled or
/// taken from another seed.
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

/// Longest archive that is changed (bytes): longer ones have no other parts, and take a hundred times as long to read.
const MOST_ARCHIVE: usize = 1200;

/// The seeds of a target that are changed.
fn short_seeds(target: &str) -> Vec<Vec<u8>> {
    let mut seeds = seeds(target);
    if target == "archive" {
        seeds.retain(|seed| seed.len() <= MOST_ARCHIVE);
        // Sound seeds are chosen more often, because most damage is detected at once.
        let sound: Vec<_> = seeds.iter().filter(|seed| targets::archive(seed).is_some()).cloned().collect();
        seeds.extend([sound.clone(), sound].concat());
    }
    seeds
}

/// One of the seeds, changed according to a number.
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
    let wanted = TARGETS.iter().filter(|(name, _)| is_wanted(name));
    if let Ok(path) = std::env::var("SLICEWALK_FUZZ_TOTALS") {
        let threads = number("SLICEWALK_FUZZ_THREADS", 1);
        return advance(&Totals::read(path.into()), &wanted.copied().collect::<Vec<_>>(), runs, threads);
    }
    std::thread::scope(|scope| {
        for &(name, target) in wanted {
            scope.spawn(move || {
                let seeds = seeds(name);
                assert!(!seeds.is_empty(), "{name} has no seed");
                for seed in &seeds {
                    let _ = target(seed);
                }
                let short = short_seeds(name);
                for seed in first..first + runs {
                    let bytes = changed(&short, seed);
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

/// Inputs of a target between two updates of the totals.
const BATCH: u64 = 10_000;
/// Time after which an input is reported as slow.
const SLOW: Duration = Duration::from_secs(1);

/// Inputs run per target in all runs, stored in a file.
struct Totals {
    path: PathBuf,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    runs: BTreeMap<String, u64>,
    findings: BTreeSet<String>,
    /// Targets that are running.
    busy: BTreeSet<&'static str>,
}

impl Totals {
    fn read(path: PathBuf) -> Self {
        let mut state = State::default();
        for line in std::fs::read_to_string(&path).unwrap_or_default().lines() {
            match line.split_once(' ').expect("a name and a number") {
                ("finding", which) => drop(state.findings.insert(which.to_owned())),
                (name, runs) => drop(state.runs.insert(name.to_owned(), runs.parse().expect("a number of runs"))),
            }
        }
        Self { path, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the idle and unfinished target that has run least, and its number of inputs.
    fn next(&self, targets: &[Target], goal: u64) -> Option<(Target, u64)> {
        let mut state = self.state();
        let runs = |name: &str| state.runs.get(name).copied().unwrap_or(0);
        let todo = targets.iter().map(|&target| (target, runs(target.0)));
        let next =
            todo.filter(|((name, _), runs)| *runs < goal && !state.busy.contains(name)).min_by_key(|&(_, n)| n)?;
        state.busy.insert(next.0.0);
        Some(next)
    }

    /// Records that a target has run `runs` inputs. A kill while the file is written leaves the previous one.
    fn done(&self, name: &'static str, runs: u64, findings: Vec<u64>) {
        let mut state = self.state();
        state.busy.remove(name);
        state.runs.insert(name.to_owned(), runs);
        state.findings.extend(findings.iter().map(|input| format!("{name} {input}")));
        let runs = state.runs.iter().map(|(name, runs)| format!("{name} {runs}\n"));
        let findings = state.findings.iter().map(|which| format!("finding {which}\n"));
        let new = self.path.with_extension("new");
        std::fs::write(&new, runs.chain(findings).collect::<String>()).expect("a folder to write to");
        std::fs::rename(&new, &self.path).expect("a folder to write to");
    }
}

/// Runs each target until it has had `goal` inputs.
fn advance(totals: &Totals, targets: &[Target], goal: u64, threads: u64) {
    let work = || {
        let mut all_seeds = BTreeMap::new();
        while let Some(((name, target), before)) = totals.next(targets, goal) {
            let seeds = all_seeds.entry(name).or_insert_with(|| short_seeds(name));
            let (runs, mut findings) = (goal.min(before + BATCH), Vec::new());
            for input in before + 1..=runs {
                let (bytes, start) = (changed(seeds, input), Instant::now());
                if std::panic::catch_unwind(|| target(&bytes)).is_err() {
                    findings.push(input);
                }
                if start.elapsed() > SLOW {
                    println!("{name}: input {input} took {:?}", start.elapsed());
                }
            }
            totals.done(name, runs, findings);
        }
    };
    std::thread::scope(|scope| {
        (0..threads).for_each(|_| drop(scope.spawn(work)));
    });
    let state = totals.state();
    assert!(state.findings.is_empty(), "findings, by target and number of input: {:?}", state.findings);
    println!("runs: {:?}", state.runs);
}

/// The planted fault: a panic when something that no seed contains is read to its end.
#[test]
fn a_fault_behind_all_checks_of_a_target_is_found() {
    const INPUTS: u64 = 20_000;
    std::thread::scope(|scope| {
        for &(name, target) in TARGETS {
            scope.spawn(move || {
                let seeds = short_seeds(name);
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
