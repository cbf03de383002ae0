//! Which tests reach which mutants, and what these tests say about each.

use anyhow::{Context, Result, bail, ensure};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, UNIX_EPOCH};

/// Starts a test with limits of its own: seconds of a processor, for itself and for each program that it starts, 8 GiB of
/// addresses and files of 4 GiB.
const LIMITED: &str = r#"ulimit -t "$1"; ulimit -v 8388608; ulimit -f 8388608; shift; exec "$@""#;

/// What the record says of a test that failed without a mutant.
const LEFT_OUT: &str = "-";

/// A test, and what it reached when no mutant was on.
struct Test {
    /// The test file, or `lib`.
    program: String,
    path: PathBuf,
    name: String,
    /// How long it took.
    time: Duration,
    reached: BTreeSet<u32>,
}

/// All tests, the quickest first, and where they run.
pub struct Trial {
    tests: Vec<Test>,
    folder: PathBuf,
    scratch: PathBuf,
}

impl Trial {
    /// Runs every test of these programs by itself. `known` is a file of what earlier runs recorded, which is taken where the program is
    /// the same. A test that fails, or that takes longer than `slowest`, is left out.
    pub fn record(
        programs: &[(String, PathBuf)],
        mutants: usize,
        times: &RangeInclusive<Duration>,
        jobs: usize,
        [folder, scratch, known]: [&Path; 3],
    ) -> Result<Self> {
        if scratch.exists() {
            fs::remove_dir_all(scratch)?;
        }
        fs::create_dir_all(scratch)?;
        let before = fs::read_to_string(known).unwrap_or_default();
        let before: BTreeMap<_, _> = before.lines().filter_map(|line| line.rsplit_once("\t= ")).collect();
        let mut wanted = Vec::new();
        for (program, path) in programs {
            let built = fs::metadata(path)?.modified()?.duration_since(UNIX_EPOCH)?.as_nanos();
            let listed = Command::new(path).args(["--list", "--format", "terse"]).current_dir(folder).output()?;
            let listed = String::from_utf8(listed.stdout)?;
            let names = listed.lines().filter_map(|line| line.strip_suffix(": test"));
            wanted.extend(names.map(|name| (program, path, format!("{program}\t{built}\t{name}"), name.to_string())));
        }
        let mut trial = Self { tests: Vec::new(), folder: folder.to_path_buf(), scratch: scratch.to_path_buf() };
        let kept = wanted.iter().filter_map(|(.., key, _)| Some(format!("{key}\t= {}\n", before.get(key.as_str())?)));
        fs::write(known, kept.collect::<String>())?;
        let file = fs::OpenOptions::new().append(true).open(known)?;
        let tests = in_parallel(jobs, &wanted, |index, (program, path, key, name)| {
            let mut test = Test {
                program: String::clone(program),
                path: PathBuf::clone(path),
                name: name.clone(),
                time: Duration::ZERO,
                reached: BTreeSet::new(),
            };
            if let Some(said) = before.get(key.as_str()) {
                if *said == LEFT_OUT {
                    return Ok(None);
                }
                let mut numbers = said.split(' ').map(|number| number.parse::<u32>());
                test.time = Duration::from_millis(numbers.next().context("a time")??.into());
                test.reached = numbers.collect::<Result<_, _>>()?;
                return Ok(Some(test));
            }
            let marks = trial.scratch.join(format!("reached-{index}"));
            fs::write(&marks, vec![0; mutants + 1])?;
            let (outcome, time) = trial.run(&test, ("SLICEWALK_MUTANTS_REACHED", marks.as_os_str()), *times.end())?;
            let marked = fs::read(&marks)?;
            fs::remove_file(&marks)?;
            if outcome != Outcome::Missed {
                eprintln!("left out: {program} {name}, {outcome:?} without a mutant");
                // What took too long may fit another run, which allows more time.
                if outcome != Outcome::Hung {
                    (&file).write_all(format!("{key}\t= {LEFT_OUT}\n").as_bytes())?;
                }
                return Ok(None);
            }
            test.time = time;
            test.reached = (0..).zip(marked).filter(|(_, mark)| *mark == 1).map(|(number, _)| number).collect();
            let numbers: String = test.reached.iter().map(|number| format!(" {number}")).collect();
            (&file).write_all(format!("{key}\t= {}{numbers}\n", time.as_millis()).as_bytes())?;
            Ok(Some(test))
        })?;
        trial.tests = tests.into_iter().flatten().collect();
        let slow = trial.tests.extract_if(.., |test| test.time > *times.end());
        slow.for_each(|test| eprintln!("left out: {} {}, takes {:?}", test.program, test.name, test.time));
        trial.tests.retain(|test| test.time >= *times.start());
        trial.tests.sort_by_key(|test| test.time);
        ensure!(!trial.tests.is_empty(), "no test can be run");
        Ok(trial)
    }

    /// What the tests say about a mutant, and the first of them that noticed it.
    pub fn of(&self, number: u32) -> Result<(Outcome, String)> {
        let mut result = Outcome::Unreached;
        for test in self.tests.iter().filter(|test| test.reached.contains(&number)) {
            let value = number.to_string();
            (result, _) = self.run(test, ("SLICEWALK_MUTANT", value.as_ref()), test.time)?;
            if result != Outcome::Missed {
                return Ok((result, format!("{} {}", test.program, test.name)));
            }
        }
        Ok((result, String::new()))
    }

    /// Runs a test that usually takes `time`.
    fn run(
        &self,
        test: &Test,
        (variable, value): (&str, &std::ffi::OsStr),
        time: Duration,
    ) -> Result<(Outcome, Duration)> {
        let processor = (time.as_secs_f64() * 5.0).ceil() as u64 + 2;
        let mut child = Command::new("sh")
            .args(["-c", LIMITED, "sh", &processor.to_string()])
            .arg(&test.path)
            .args(["--exact", &test.name, "--test-threads", "1"])
            .current_dir(&self.folder)
            .env(variable, value)
            .env("TMPDIR", &self.scratch)
            .env("PROPTEST_RNG_SEED", "1")
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        // Counted, so that time counts only while this program runs: somebody may stop it for a while.
        const TICK: Duration = Duration::from_millis(2);
        let limit = time * 10 + Duration::from_secs(20);
        let mut ran = Duration::ZERO;
        let outcome = loop {
            if let Some(status) = child.try_wait()? {
                break match status.code() {
                    Some(0) => Outcome::Missed,
                    None if ran >= Duration::from_secs(processor) / 2 => Outcome::Hung,
                    _ => Outcome::Caught,
                };
            }
            if ran > limit {
                child.kill()?;
                child.wait()?;
                break Outcome::Hung;
            }
            thread::sleep(TICK);
            ran += TICK;
        };
        Ok((outcome, ran))
    }
}

/// What tests did about a mutant; those that hang notice it, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// A test failed.
    Caught,
    /// A test took far longer than usual.
    Hung,
    /// All tests that reach it passed.
    Missed,
    /// No test reaches it.
    Unreached,
}

/// Works on all items, so many at a time; the results are in their order.
pub fn in_parallel<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    work: impl Fn(usize, &T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let worker = || -> Result<Vec<(usize, R)>> {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { return Ok(done) };
            done.push((index, work(index, item)?));
        }
    };
    let mut all = Vec::new();
    thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            let Ok(done) = worker.join() else { bail!("a worker panicked") };
            all.extend(done?);
        }
        Ok(())
    })?;
    all.sort_by_key(|(index, _)| *index);
    Ok(all.into_iter().map(|(_, result)| result).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parallel_results_come_in_order_and_errors_come_back() {
        let items: Vec<usize> = (0..100).collect();
        let twice = in_parallel(3, &items, |index, item| Ok(index + item)).unwrap();
        assert_eq!(twice, items.iter().map(|item| item * 2).collect::<Vec<_>>());
        assert!(in_parallel(2, &items, |_, item| if *item == 50 { bail!("fifty") } else { Ok(()) }).is_err());
    }
}
