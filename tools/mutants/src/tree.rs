//! A copy of the library in which each mutant that was drawn stands behind a switch.

use crate::find::{self, Mutant};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the copy of the library gets. The process that runs the tests says by environment variables which mutant is on, or names a
/// file with a byte for each mutant in which those that are reached are marked, also by programs that a test starts.
const SWITCH: &str = r#"
#[doc(hidden)]
#[allow(missing_docs)]
pub mod mutant {
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed};
    const UNKNOWN: u32 = u32::MAX;
    const MARKS: u32 = u32::MAX - 1;
    static ACTIVE: AtomicU32 = AtomicU32::new(UNKNOWN);
    static MARKED: OnceLock<memmap2::MmapRaw> = OnceLock::new();
    #[inline]
    pub fn is_active(number: u32) -> bool {
        let active = ACTIVE.load(Relaxed);
        if active >= MARKS { first_or_mark(number) } else { active == number }
    }
    #[cold]
    fn first_or_mark(number: u32) -> bool {
        if ACTIVE.load(Relaxed) == UNKNOWN {
            let active = match std::env::var_os("SLICEWALK_MUTANTS_REACHED") {
                Some(path) => {
                    MARKED.get_or_init(|| {
                        let file = std::fs::OpenOptions::new().read(true).write(true).open(path).unwrap();
                        memmap2::MmapRaw::map_raw(&file).unwrap()
                    });
                    MARKS
                }
                None => std::env::var("SLICEWALK_MUTANT").map_or(0, |text| text.parse().unwrap()),
            };
            ACTIVE.store(active, Relaxed);
            return is_active(number);
        }
        let marked = MARKED.get().unwrap();
        assert!((number as usize) < marked.len());
        // SAFETY: within the map, which stays; nothing else but such stores changes its bytes.
        unsafe { AtomicU8::from_ptr(marked.as_mut_ptr().add(number as usize)) }.store(1, Relaxed);
        false
    }
}
"#;

/// A file whose places are changed.
pub struct Source {
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
    pub fn module(&self) -> String {
        let path = self.path.strip_prefix("src").unwrap_or(&self.path).with_extension("");
        path.iter().next().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Place and change, as the results name them.
    pub fn name(&self, mutant: &Mutant) -> String {
        let (line, column) = mutant.at;
        format!("{}:{line}:{column}\t{}", self.path.display(), mutant.change)
    }
}

/// The sources that are changed, in a copy of the repository.
pub struct Tree {
    folder: PathBuf,
    sources: Vec<Source>,
    /// The mutants that stand in the copy.
    chosen: BTreeSet<u32>,
}

impl Tree {
    /// A copy of all that git does not ignore, in the folder `copy` of `out`. What is as it was in the last run stays untouched, and is
    /// not built again.
    pub fn new(root: &Path, out: &Path, paths: Vec<PathBuf>) -> Result<Self> {
        let folder = out.join("copy");
        let listed = Command::new("git")
            .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
            .current_dir(root)
            .output()?;
        let listed = String::from_utf8(listed.stdout)?;
        let names: BTreeSet<_> = listed.split('\0').chain(["Cargo.lock"]).map(|name| folder.join(name)).collect();
        remove_others(&folder, &names)?;
        for name in listed.split('\0').filter(|name| !name.is_empty()).chain(["Cargo.lock"]) {
            let from = root.join(name);
            if !from.is_file() || paths.iter().any(|path| path == Path::new(name)) {
                continue;
            }
            let mut bytes = fs::read(&from).with_context(|| name.to_string())?;
            if name == "src/lib.rs" {
                bytes.extend(SWITCH.as_bytes());
            }
            write(&folder.join(name), &bytes)?;
        }
        let (mut sources, mut first) = (Vec::new(), 1);
        for path in paths {
            let text = fs::read_to_string(root.join(&path))?;
            let mutants = find::mutants(&text).with_context(|| path.display().to_string())?;
            let count = u32::try_from(mutants.len())?;
            sources.push(Source { path, text, mutants, first, ranges: Vec::new() });
            first += count;
        }
        Ok(Self { folder, sources, chosen: BTreeSet::new() })
    }

    /// Where it lies.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Every mutant that somebody could choose: its number, file and change.
    pub fn mutants(&self) -> impl Iterator<Item = (u32, &Source, &Mutant)> {
        self.sources.iter().flat_map(|source| {
            (source.first..).zip(&source.mutants).map(move |(number, mutant)| (number, source, mutant))
        })
    }

    /// Those that were chosen and that the compiler takes.
    pub fn chosen(&self) -> impl Iterator<Item = (u32, &Source, &Mutant)> {
        self.mutants().filter(|(number, ..)| self.chosen.contains(number))
    }

    /// Builds tests, the library's own and those files, with these mutants less those that the compiler refuses; `known` is a file of
    /// those that it refused before. Returns each program with its name; the library's is `lib`.
    pub fn build(&mut self, chosen: BTreeSet<u32>, tests: &[String], known: &Path) -> Result<Vec<(String, PathBuf)>> {
        let place = |source: &Source, mutant: &Mutant| format!("{}\t{}\n", source.name(mutant), mutant.place.start);
        let mut refused = fs::read_to_string(known).unwrap_or_default();
        self.chosen = chosen;
        let before: BTreeSet<_> = refused.split_inclusive('\n').collect();
        let again = self.chosen().filter(|(_, source, mutant)| before.contains(place(source, mutant).as_str()));
        let again: BTreeSet<_> = again.map(|(number, ..)| number).collect();
        self.chosen.retain(|number| !again.contains(number));
        let mut arguments = vec!["test", "-p", "slicewalk", "--all-features", "--no-run", "--lib"];
        arguments.extend(tests.iter().flat_map(|test| ["--test", test]));
        loop {
            self.write()?;
            let (is_sound, messages) = self.cargo(&arguments)?;
            if is_sound {
                let program = |(name, target): (&str, &str)| {
                    let is_it =
                        |message: &&Value| message["profile"]["test"] == true && message["target"]["name"] == target;
                    let path = messages.iter().filter(is_it).find_map(|message| message["executable"].as_str());
                    let path = path.with_context(|| format!("the tests '{name}' are not built"))?;
                    Ok((name.to_string(), PathBuf::from(path)))
                };
                let files = tests.iter().map(|test| (test.as_str(), test.as_str()));
                return [("lib", "slicewalk")].into_iter().chain(files).map(program).collect();
            }
            let errors = messages.iter().filter(|message| message["message"]["level"] == "error");
            let now: BTreeSet<_> = errors.flat_map(|message| self.refused(&message["message"])).collect();
            ensure!(!now.is_empty(), "the compiler refuses more than mutants: {}", first_error(&messages));
            let names = self.mutants().filter(|(number, ..)| now.contains(number));
            refused.extend(names.map(|(_, source, mutant)| place(source, mutant)));
            write(known, refused.as_bytes())?;
            self.chosen.retain(|number| !now.contains(number));
            eprintln!("{} mutants, {} more refused by the compiler", self.chosen.len(), now.len());
        }
    }

    fn write(&mut self) -> Result<()> {
        for source in &mut self.sources {
            let number = |index: usize| {
                let number = source.first + u32::try_from(index).ok()?;
                self.chosen.contains(&number).then_some(number)
            };
            let (text, ranges) = find::switched(&source.text, &source.mutants, number);
            write(&self.folder.join(&source.path), text.as_bytes())?;
            source.ranges = ranges;
        }
        Ok(())
    }

    fn cargo(&self, arguments: &[&str]) -> Result<(bool, Vec<Value>)> {
        let output = Command::new("cargo")
            .args(arguments)
            .args(["--message-format=json", "--quiet"])
            .current_dir(&self.folder)
            .env("CARGO_TARGET_DIR", self.folder.with_file_name("target"))
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env("RUSTFLAGS", "-Awarnings")
            .stderr(Stdio::inherit())
            .output()?;
        let lines = String::from_utf8_lossy(&output.stdout);
        let messages = lines.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        Ok((output.status.success(), messages))
    }

    /// The mutants that an error of the compiler is about.
    fn refused(&self, error: &Value) -> Vec<u32> {
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
                return vec![*number];
            }
            // About what follows a mutant's own words: the mutants whose words end last before it.
            let last = source.ranges.iter().filter(|(_, range)| range.end <= start).max_by_key(|(_, range)| range.end);
            if let Some((number, _)) = last {
                let place = &source.mutants[(number - source.first) as usize].place;
                let same = (source.first..).zip(&source.mutants).filter(|(_, mutant)| mutant.place == *place);
                return same.map(|(number, _)| number).filter(|number| self.chosen.contains(number)).collect();
            }
        }
        Vec::new()
    }
}

/// Removes the files of `folder` that are not among `kept`.
fn remove_others(folder: &Path, kept: &BTreeSet<PathBuf>) -> Result<()> {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry?.path();
        if path.is_dir() {
            remove_others(&path, kept)?;
        } else if !kept.contains(&path) {
            fs::remove_file(&path)?;
        }
    }
    Ok(())
}

/// Writes a file unless it has these bytes.
fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|there| there == bytes) {
        return Ok(());
    }
    fs::create_dir_all(path.parent().context("a file lies in a folder")?)?;
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

fn first_error(messages: &[Value]) -> String {
    let errors = messages.iter().filter(|message| message["message"]["level"] == "error");
    errors
        .filter_map(|message| message["message"]["rendered"].as_str())
        .next()
        .unwrap_or("it does not say why")
        .to_string()
}
