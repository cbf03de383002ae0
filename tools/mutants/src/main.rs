//! Counts how many wrong places the tests of a module notice.
//!
//! All mutants of a module are compiled at once, each behind a switch that an environment variable turns on, so one build serves
//! thousands of runs of the tests. The sources are changed in a copy. What the compiler refuses is no mutant.
//!
//! Results are added to a file, one line a mutant; the next run goes on behind them. Where sources have changed, remove it first.

mod find;

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use find::Mutant;
use serde_json::Value;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// What the copy of the library gets: the number of the mutant that is on.
const SWITCH: &str = r#"
#[doc(hidden)]
#[allow(missing_docs)]
pub mod mutant {
    use std::sync::atomic::{AtomicU32, Ordering};
    static ACTIVE: AtomicU32 = AtomicU32::new(u32::MAX);
    #[inline]
    pub fn is_active(number: u32) -> bool {
        let active = ACTIVE.load(Ordering::Relaxed);
        number == if active == u32::MAX { first() } else { active }
    }
    #[cold]
    fn first() -> u32 {
        let active = std::env::var("SLICEWALK_MUTANT").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
        ACTIVE.store(active, Ordering::Relaxed);
        active
    }
}
"#;

/// Runs the unit tests of a module of the library once for each mutant of its sources.
#[derive(Debug, Parser)]
struct Options {
    /// Modules: files and folders of src/ whose sources are changed
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// Test files that run where the unit tests notice nothing
    #[arg(long)]
    test: Vec<String>,
    /// Folder for the copy, its build and the results
    #[arg(long, default_value = "target/mutants")]
    out: PathBuf,
    /// Only this many mutants of each module, drawn evenly
    #[arg(long)]
    sample: Option<usize>,
    /// Mutants that run at the same time
    #[arg(long, default_value_t = 2)]
    jobs: usize,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let root = std::env::current_dir()?;
    ensure!(root.join("src/lib.rs").is_file(), "expected to run in the root of the repository");
    let out = root.join(&options.out);
    let files = sources(&root, &options.sources)?;
    let copy = copy(&root, &out, &files)?;
    let mut tree = Tree::read(&root, &copy, files)?;
    tree.settle(&out.join("refused.tsv"))?;
    let (modules, results) = (tree.build(&options)?, options.out.join("results.tsv"));
    tree.run(&options, &results, &modules)?;
    print!("{}", summary(&fs::read_to_string(&results)?));
    Ok(())
}

/// A copy of all that git does not ignore but for `changed`, with the switch. What is as it was in the last run stays untouched, and
/// is not built again.
fn copy(root: &Path, out: &Path, changed: &[PathBuf]) -> Result<PathBuf> {
    let copy = out.join("copy");
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root)
        .output()?;
    let listed = String::from_utf8(listed.stdout)?;
    for name in listed.split('\0').filter(|name| !name.is_empty()).chain(["Cargo.lock"]) {
        let (from, to) = (root.join(name), copy.join(name));
        if !from.is_file() || changed.iter().any(|path| path == Path::new(name)) {
            continue;
        }
        let mut bytes = fs::read(&from).with_context(|| name.to_string())?;
        if name == "src/lib.rs" {
            bytes.extend(SWITCH.as_bytes());
        }
        write(&to, &bytes)?;
    }
    Ok(copy)
}

/// Writes a file unless it has these bytes.
fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|there| there == bytes) {
        return Ok(());
    }
    fs::create_dir_all(path.parent().context("a file lies in a folder")?)?;
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

/// The Rust files below `wanted`, without those of tests alone; relative to the root.
fn sources(root: &Path, wanted: &[PathBuf]) -> Result<Vec<PathBuf>> {
    fn below(path: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
        if path.is_dir() {
            for entry in fs::read_dir(path)? {
                below(&entry?.path(), found)?;
            }
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path.to_path_buf());
        }
        Ok(())
    }
    let mut found = Vec::new();
    for path in wanted {
        below(&root.join("src").join(path), &mut found).with_context(|| path.display().to_string())?;
    }
    let is_test =
        |path: &Path| path.components().any(|part| ["tests", "tests.rs"].iter().any(|name| part.as_os_str() == *name));
    let mut found: Vec<_> = found
        .iter()
        .filter_map(|path| path.strip_prefix(root).ok())
        .filter(|path| !is_test(path))
        .map(Path::to_path_buf)
        .collect();
    found.sort();
    ensure!(!found.is_empty(), "no Rust file below {wanted:?}");
    Ok(found)
}

/// A file whose places are changed.
struct Source {
    path: PathBuf,
    text: String,
    mutants: Vec<Mutant>,
    /// The number of its first mutant.
    first: u32,
    /// Where the changed text says what each mutant is.
    ranges: Vec<(u32, Range<usize>)>,
}

impl Source {
    /// The first word of its path in the library.
    fn module(&self) -> String {
        let path = self.path.strip_prefix("src").unwrap_or(&self.path).with_extension("");
        path.iter().next().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn name(&self, mutant: &Mutant) -> String {
        format!("{}:{}\t{}", self.path.display(), mutant.line, mutant.change)
    }
}

/// The sources that are changed, and the mutants that the compiler refuses.
struct Tree {
    copy: PathBuf,
    sources: Vec<Source>,
    refused: BTreeSet<u32>,
}

impl Tree {
    fn read(root: &Path, copy: &Path, paths: Vec<PathBuf>) -> Result<Self> {
        let (mut sources, mut first) = (Vec::new(), 1);
        for path in paths {
            let text = fs::read_to_string(root.join(&path))?;
            let mutants = find::mutants(&text).with_context(|| path.display().to_string())?;
            let count = u32::try_from(mutants.len())?;
            sources.push(Source { path, text, mutants, first, ranges: Vec::new() });
            first += count;
        }
        Ok(Self { copy: copy.to_path_buf(), sources, refused: BTreeSet::new() })
    }

    /// Every mutant that the compiler takes: its number, file and change.
    fn mutants(&self) -> impl Iterator<Item = (u32, &Source, &Mutant)> {
        self.sources
            .iter()
            .flat_map(|source| {
                (source.first..).zip(&source.mutants).map(move |(number, mutant)| (number, source, mutant))
            })
            .filter(|(number, ..)| !self.refused.contains(number))
    }

    fn write(&mut self) -> Result<()> {
        for source in &mut self.sources {
            let number = |index: usize| {
                let number = source.first + u32::try_from(index).ok()?;
                (!self.refused.contains(&number)).then_some(number)
            };
            let (text, ranges) = find::switched(&source.text, &source.mutants, number);
            write(&self.copy.join(&source.path), text.as_bytes())?;
            source.ranges = ranges;
        }
        Ok(())
    }

    fn cargo(&self, arguments: &[&str]) -> Result<(bool, Vec<Value>)> {
        let output = Command::new("cargo")
            .args(arguments)
            .args(["--message-format=json", "--quiet"])
            .current_dir(&self.copy)
            .env("CARGO_TARGET_DIR", self.copy.with_file_name("target"))
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env("RUSTFLAGS", "-Awarnings")
            .stderr(Stdio::inherit())
            .output()?;
        let lines = String::from_utf8_lossy(&output.stdout);
        let messages = lines.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        Ok((output.status.success(), messages))
    }

    /// Leaves mutants out until the compiler takes the rest. `known` is a file of those that it refused before.
    fn settle(&mut self, known: &Path) -> Result<()> {
        let place = |source: &Source, mutant: &Mutant| format!("{}\t{}\n", source.name(mutant), mutant.place.start);
        let before = fs::read_to_string(known).unwrap_or_default();
        let before: BTreeSet<_> = before.split_inclusive('\n').collect();
        let again = self.mutants().filter(|(_, source, mutant)| before.contains(place(source, mutant).as_str()));
        self.refused = again.map(|(number, ..)| number).collect();
        for round in 1.. {
            self.write()?;
            let (is_sound, messages) = self.cargo(&["check", "-p", "slicewalk", "--all-features", "--lib"])?;
            if is_sound {
                let all = self
                    .sources
                    .iter()
                    .flat_map(|source| (source.first..).zip(&source.mutants).map(move |m| (source, m)));
                let refused = all.filter(|(_, (number, _))| self.refused.contains(number));
                write(
                    known,
                    refused.map(|(source, (_, mutant))| place(source, mutant)).collect::<String>().as_bytes(),
                )?;
                eprintln!("{} mutants, {} refused by the compiler", self.mutants().count(), self.refused.len());
                return Ok(());
            }
            let before = self.refused.len();
            for message in messages.iter().filter(|message| message["message"]["level"] == "error") {
                self.refuse(&message["message"]);
            }
            ensure!(self.refused.len() > before, "the compiler refuses more than mutants: {}", first_error(&messages));
            eprintln!("round {round}: {} mutants refused", self.refused.len());
        }
        Ok(())
    }

    /// Leaves out the mutants that an error of the compiler is about.
    fn refuse(&mut self, error: &Value) {
        let mut spans: Vec<_> = error["spans"].as_array().into_iter().flatten().collect();
        spans.sort_by_key(|span| !span["is_primary"].as_bool().unwrap_or(false));
        for span in spans {
            let Some(name) = span["file_name"].as_str() else { continue };
            let Some(source) = self.sources.iter().find(|source| Path::new(name).ends_with(&source.path)) else {
                continue;
            };
            let (start, end) =
                (span["byte_start"].as_u64().unwrap_or(0) as usize, span["byte_end"].as_u64().unwrap_or(0) as usize);
            let within: Vec<_> =
                source.ranges.iter().filter(|(_, range)| range.start <= start && end <= range.end).collect();
            if let Some((number, _)) = within.iter().min_by_key(|(_, range)| range.len()) {
                self.refused.insert(*number);
                return;
            }
            // About what follows a mutant's own words: the mutants whose words end last before it.
            let last = source.ranges.iter().filter(|(_, range)| range.end <= start).max_by_key(|(_, range)| range.end);
            if let Some((number, _)) = last {
                let place = &source.mutants[(number - source.first) as usize].place;
                let same = (source.first..).zip(&source.mutants).filter(|(_, mutant)| mutant.place == *place);
                self.refused.extend(same.map(|(number, _)| number));
                return;
            }
        }
    }

    /// What runs for mutants of each module: its unit tests, then the test files, the quickest first.
    fn build(&self, options: &Options) -> Result<BTreeMap<String, Vec<Tests>>> {
        let mut arguments = vec!["test", "-p", "slicewalk", "--all-features", "--no-run", "--lib"];
        for test in &options.test {
            arguments.extend(["--test", test]);
        }
        let (is_sound, messages) = self.cargo(&arguments)?;
        ensure!(is_sound, "the tests do not build: {}", first_error(&messages));
        let program = |name: &str| {
            let is_it = |message: &&Value| message["profile"]["test"] == true && message["target"]["name"] == name;
            let path = messages.iter().filter(is_it).find_map(|message| message["executable"].as_str());
            path.map(PathBuf::from).with_context(|| format!("the tests '{name}' are not built"))
        };
        let file = |name: &String| Tests::new(program(name)?, None, &self.copy);
        let mut files = options.test.iter().map(file).collect::<Result<Vec<_>>>()?;
        // The quick ones first: most mutants never come to the others.
        files.sort_by_key(|tests| tests.limit);
        let mut modules = BTreeMap::new();
        for source in &self.sources {
            if let Entry::Vacant(entry) = modules.entry(source.module()) {
                let unit = Tests::new(program("slicewalk")?, Some(format!("{}::", entry.key())), &self.copy)?;
                entry.insert([&[unit], &files[..]].concat());
            }
        }
        Ok(modules)
    }

    /// Runs all mutants or a sample that the results do not know yet.
    fn run(&self, options: &Options, results: &Path, modules: &BTreeMap<String, Vec<Tests>>) -> Result<()> {
        let known = fs::read_to_string(results).unwrap_or_default();
        let known: BTreeSet<_> = known.lines().filter_map(|line| line.split_once('\t')).map(|(_, name)| name).collect();
        let mut by_module: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for mutant in self.mutants() {
            by_module.entry(mutant.1.module()).or_default().push(mutant);
        }
        let mut drawn: Vec<_> = by_module.values().flat_map(|all| draw(all, options.sample)).collect();
        // Some of each module early on.
        drawn.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let drawn = drawn.into_iter().map(|(_, mutant)| mutant);
        let todo: Vec<_> = drawn.filter(|(_, source, mutant)| !known.contains(source.name(mutant).as_str())).collect();
        let (file, next) = (fs::OpenOptions::new().create(true).append(true).open(results)?, AtomicUsize::new(0));
        let work = || -> Result<()> {
            while let Some((number, source, mutant)) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
                let mut outcome = Outcome::Missed;
                for tests in &modules[&source.module()] {
                    outcome = tests.run(*number, tests.limit, &self.copy)?;
                    if outcome != Outcome::Missed {
                        break;
                    }
                }
                // In one piece, so that lines of several workers do not mix.
                (&file).write_all(format!("{outcome:?}\t{}\n", source.name(mutant)).as_bytes())?;
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..options.jobs.max(1)).map(|_| scope.spawn(work)).collect();
            workers.into_iter().try_for_each(|worker| worker.join().unwrap_or_else(|_| bail!("a worker panicked")))
        })
    }
}

/// A test program, or the part of it that is about one module.
#[derive(Debug, Clone)]
struct Tests {
    program: PathBuf,
    /// How the tests' names begin.
    module: Option<String>,
    /// After which a run counts as hanging.
    limit: Duration,
}

impl Tests {
    /// They must pass without a mutant; their limit is some times as long as that takes.
    fn new(program: PathBuf, module: Option<String>, folder: &Path) -> Result<Self> {
        let mut tests = Self { program, module, limit: Duration::ZERO };
        let start = Instant::now();
        let outcome = tests.run(0, Duration::from_secs(3600), folder)?;
        ensure!(outcome == Outcome::Missed, "{tests:?} fail without a mutant");
        tests.limit = start.elapsed() * 4 + Duration::from_secs(10);
        Ok(tests)
    }

    /// What they say with a mutant on.
    fn run(&self, number: u32, limit: Duration, folder: &Path) -> Result<Outcome> {
        let mut child = Command::new(&self.program)
            .args(&self.module)
            .args(["--test-threads", "1"])
            .current_dir(folder)
            .env("SLICEWALK_MUTANT", number.to_string())
            .env("PROPTEST_RNG_SEED", "1")
            .env("RUST_BACKTRACE", "0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        // Ends with the first test that fails, or with the program.
        let (failed, news) = mpsc::channel();
        let mut lines = BufReader::new(child.stdout.take().context("its output comes here")?).lines();
        std::thread::spawn(move || {
            if lines.any(|line| line.is_ok_and(|line| line.ends_with("... FAILED"))) {
                let _ = failed.send(());
            }
        });
        // Counted, so that time counts only while this program runs: somebody may stop it for a while.
        const TICK: Duration = Duration::from_millis(100);
        let mut ticks = limit.div_duration_f64(TICK) as u64;
        let outcome = loop {
            match news.recv_timeout(TICK) {
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    return Ok(if child.wait()?.success() { Outcome::Missed } else { Outcome::Caught });
                }
                Ok(()) => break Outcome::Caught,
                Err(mpsc::RecvTimeoutError::Timeout) if ticks == 0 => break Outcome::Hung,
                Err(mpsc::RecvTimeoutError::Timeout) => ticks -= 1,
            }
        };
        child.kill()?;
        child.wait()?;
        Ok(outcome)
    }
}

/// What tests did about a mutant; those that hang notice it, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Caught,
    Hung,
    Missed,
}

/// So many of `all`, evenly, in an order that has some from everywhere early on; with each the part of them that comes before it.
fn draw<T>(all: &[T], sample: Option<usize>) -> impl Iterator<Item = (f64, &T)> {
    let count = sample.unwrap_or(all.len()).clamp(1, all.len().max(1));
    let stride = (count * 5 / 8..).find(|&stride| is_coprime(stride, count)).unwrap_or(1);
    let place = move |turn: usize| turn * stride % count * all.len() / count;
    (0..count).filter_map(move |turn| Some((turn as f64 / count as f64, all.get(place(turn))?)))
}

fn is_coprime(a: usize, b: usize) -> bool {
    if b == 0 { a == 1 } else { is_coprime(b, a % b) }
}

fn first_error(messages: &[Value]) -> String {
    let errors = messages.iter().filter(|message| message["message"]["level"] == "error");
    errors
        .filter_map(|message| message["message"]["rendered"].as_str())
        .next()
        .unwrap_or("it does not say why")
        .to_string()
}

/// One line a module, from the lines of the results.
fn summary(results: &str) -> String {
    let mut modules: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    for line in results.lines() {
        let Some((said, place)) = line.split_once("\tsrc/") else { continue };
        let module = place.split(['/', '.']).next().unwrap_or(place);
        let outcome = ["Caught", "Hung", "Missed"].iter().position(|word| *word == said);
        modules.entry(module).or_default()[outcome.unwrap_or(2)] += 1;
    }
    let line = |(module, [caught, hung, missed]): (&str, [usize; 3])| {
        let all = caught + hung + missed;
        let share = (caught + hung) as f64 * 100.0 / all as f64;
        format!("{module}: {all} mutants, {caught} caught, {hung} hung, {missed} missed: {share:.1} % noticed\n")
    };
    modules.into_iter().map(line).collect()
}
