//! Power failure at any moment leaves the old archive or the new one, and the new one once the program has reported
//! success. Another run, resuming or not, makes the new archive and leaves nothing else.
//!
//! [`model`](crate::disk::testing::model) describes what a power loss may undo. `SLICEWALK_LOSSES` sets the number of
//! random losses, `SLICEWALK_SEED` the first seed; both are printed.

use super::*;
use crate::disk::testing::model::{Fate, Recording, Step};
use std::collections::HashSet;

const DONE: &str = "done";

/// Records every step that a conversion takes on the disk.
fn record(job: &Job) -> Recording {
    let disk = ModelDisk::new(job.content());
    job.convert_on(disk.clone(), false).unwrap();
    disk.say(DONE);
    disk.recording()
}

/// Returns what is wrong with the archive left by a power loss after `end` steps.
fn archive_is_wrong(job: &Job, recording: &Recording, end: usize, left: &Content) -> Option<String> {
    match left.bytes(&job.options.output) {
        Some(bytes) if bytes == job.new => None,
        Some(bytes) if bytes == job.old && !recording.said(end, DONE) => None,
        Some(bytes) if bytes == job.old => Some("the program was done, and the old archive is there".into()),
        Some(bytes) => Some(format!("{} bytes that are not an archive", bytes.len())),
        None => Some("no archive is there".into()),
    }
}

/// Calls `see` with each state of these families, after each step: of the steps not yet durable, nothing is lost; all
/// are lost, or lost in part; one alone is lost, or lost in part; all but one are lost. `without` omits a sync.
fn families(recording: &Recording, without: Option<usize>, see: &mut dyn FnMut(usize, Content)) {
    for end in 0..=recording.steps.len() {
        let durable = recording.durable(end, without);
        for fate in [Fate::Kept, Fate::Lost, Fate::LengthOnly, Fate::Half] {
            see(end, recording.left(&durable, |_| fate));
        }
        for loses in (0..end).filter(|&at| !durable[at]) {
            for fate in [Fate::Lost, Fate::LengthOnly, Fate::Half] {
                see(end, recording.left(&durable, |at| if at == loses { fate } else { Fate::Kept }));
            }
            see(end, recording.left(&durable, |at| if at == loses { Fate::Kept } else { Fate::Lost }));
        }
    }
}

/// Check of the states, each once.
struct Survival<'a> {
    job: &'a Job,
    recording: &'a Recording,
    seen: HashSet<(u64, bool)>,
    /// States without the runs on disk, which a run that does not resume never reads.
    seen_without_runs: HashSet<u64>,
    tried: u64,
}

impl<'a> Survival<'a> {
    fn new(job: &'a Job, recording: &'a Recording) -> Self {
        Self { job, recording, seen: HashSet::new(), seen_without_runs: HashSet::new(), tried: 0 }
    }

    fn check(&mut self, end: usize, left: Content, what: &dyn Fn() -> String) {
        self.tried += 1;
        if !self.seen.insert((left.hash(), self.recording.said(end, DONE))) {
            return;
        }
        let is_new =
            self.seen_without_runs.insert(left.hash_but(|path| path.extension().is_some_and(|e| e == "spill")));
        let wrong = archive_is_wrong(self.job, self.recording, end, &left)
            .or_else(|| is_new.then(|| self.job.next_run_fails(left.clone(), false)).flatten())
            .or_else(|| self.job.next_run_fails(left.clone(), true).map(|wrong| format!("resuming, {wrong}")));
        if let Some(wrong) = wrong {
            panic!("{} after {end} steps: {wrong}", what());
        }
    }
}

#[test]
fn whenever_power_fails_an_archive_is_whole_and_the_next_run_cleans_up() {
    let job = Job::new();
    let recording = record(&job);
    let mut survival = Survival::new(&job, &recording);
    families(&recording, None, &mut |end, left| survival.check(end, left, &|| "power fails".into()));
    let (tried, states) = (survival.tried, survival.seen.len());
    println!("{} steps, {tried} losses by family, {states} states", recording.steps.len());
    assert!(recording.steps.len() > 15 && states > 100);
}

#[test]
#[ignore = "slow: .ci/run"]
fn whatever_a_power_loss_takes_at_random_an_archive_is_whole_and_the_next_run_cleans_up() {
    let number = |name: &str, default: u64| std::env::var(name).ok().map_or(default, |text| text.parse().unwrap());
    let (losses, first) = (number("SLICEWALK_LOSSES", 2_000), number("SLICEWALK_SEED", 1));
    let job = Job::new();
    let recording = record(&job);
    let mut survival = Survival::new(&job, &recording);
    println!("random losses with seeds {first} to {}", first + losses - 1);
    for seed in first..first + losses {
        let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let end = random.below(recording.steps.len() as u64 + 1) as usize;
        let durable = recording.durable(end, None);
        // Some losses take little, others nearly everything.
        let share = random.below(101);
        let left = recording.left(&durable, |_| match random.below(100) {
            chance if chance >= share => Fate::Kept,
            _ => match random.below(4) {
                0 => Fate::LengthOnly,
                1 => Fate::Half,
                2 => Fate::Blocks(random.bits()),
                _ => Fate::Lost,
            },
        });
        survival.check(end, left, &|| format!("seed {seed}: power fails"));
    }
    println!("{losses} random losses, {} states, 0 wrong", survival.seen.len());
}

#[test]
fn without_any_one_of_its_syncs_a_conversion_would_lose_an_archive() {
    let job = Job::new();
    let recording = record(&job);
    let syncs = recording.syncs();
    assert!(syncs.iter().any(|&at| matches!(recording.steps[at], Step::Sync { .. })));
    assert!(syncs.iter().any(|&at| matches!(recording.steps[at], Step::SyncFolder { .. })));
    for without in syncs {
        let mut wrong = Vec::new();
        families(&recording, Some(without), &mut |end, left| {
            wrong.extend(archive_is_wrong(&job, &recording, end, &left));
        });
        assert!(!wrong.is_empty(), "{:?} could be left out", recording.steps[without]);
        println!("without {:?}: {} of its states, for example {}", recording.steps[without], wrong.len(), wrong[0]);
    }
}
