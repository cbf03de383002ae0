//! Counts how many wrong places the library's tests notice.
//!
//! Mutants are compiled all at once, each behind a switch that an environment variable turns on, so one build serves
//! thousands of runs of tests. The sources are changed in a copy. What the compiler refuses is no mutant. Each test runs once by itself
//! with all switches off, which records the mutants that it reaches. Then each mutant meets only the tests that reach it, the quickest
//! first, until one fails.
//!
//! Results are added to a file, one line a mutant; the next run goes on behind them. Where sources have changed, remove it first.

mod find;
mod tree;
mod trial;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tree::Tree;
use trial::Trial;

/// Runs the library's unit tests, and test files, for each mutant of some of its sources.
#[derive(Debug, Parser)]
struct Options {
    /// Modules: files and folders of src/ whose sources are changed
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// Test files that run beside the library's unit tests
    #[arg(long)]
    test: Vec<String>,
    /// Folder for the copy, its build and the results
    #[arg(long, default_value = "target/mutants")]
    out: PathBuf,
    /// Only this many mutants of each module, drawn evenly
    #[arg(long)]
    sample: Option<usize>,
    /// Draws others: each this many mutants further on
    #[arg(long, default_value_t = 0)]
    offset: usize,
    /// Leaves out tests that take longer, in seconds
    #[arg(long, default_value_t = 30.0)]
    slowest: f64,
    /// Leaves out tests that take less, in seconds, and tries again what was missed: a second run, with the slow tests
    #[arg(long, default_value_t = 0.0)]
    quickest: f64,
    /// Tests that run at the same time
    #[arg(long, default_value_t = 2)]
    jobs: usize,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let root = std::env::current_dir()?;
    ensure!(root.join("src/lib.rs").is_file(), "expected to run in the root of the repository");
    let out = root.join(&options.out);
    let mut tree = Tree::new(&root, &out, sources(&root, &options.sources)?)?;
    let mut by_module: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for (number, source, _) in tree.mutants() {
        by_module.entry(source.module()).or_default().push(number);
    }
    for (module, all) in &by_module {
        eprintln!("{module}: {} mutants", all.len());
    }
    let mut drawn: Vec<_> = by_module.values().flat_map(|all| draw(all, options.sample, options.offset)).collect();
    // Some of each module early on.
    drawn.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let drawn: Vec<_> = drawn.into_iter().map(|(_, number)| *number).collect();
    let programs = tree.build(drawn.iter().copied().collect(), &options.test, &out.join("refused.tsv"))?;
    let paths = [tree.folder(), &out.join("scratch"), &out.join("reached.tsv")];
    let [quickest, slowest] = [options.quickest, options.slowest].map(Duration::try_from_secs_f64);
    let times = quickest?..=slowest?;
    let trial = Trial::record(&programs, tree.mutants().count(), &times, options.jobs, paths)?;
    let results = out.join("results.tsv");
    let names: BTreeMap<_, _> = tree.chosen().map(|(number, source, mutant)| (number, source.name(mutant))).collect();
    run(&trial, &drawn, &names, &results, &options)?;
    let wanted: BTreeSet<_> = names.values().map(String::as_str).collect();
    print!("{}", summary(&fs::read_to_string(results)?, &wanted));
    Ok(())
}

/// Tries the mutants that the results do not know yet, or those that were missed.
fn run(
    trial: &Trial,
    drawn: &[u32],
    names: &BTreeMap<u32, String>,
    results: &Path,
    Options { quickest, jobs, .. }: &Options,
) -> Result<()> {
    let known = fs::read_to_string(results).unwrap_or_default();
    let again = *quickest > 0.0;
    let known: BTreeSet<_> = outcomes(&known)
        .into_iter()
        .filter(|(_, (outcome, _))| !again || is_noticed(outcome))
        .map(|(name, _)| name)
        .collect();
    let chosen = drawn.iter().filter_map(|number| Some((*number, names.get(number)?)));
    let todo: Vec<_> = chosen.filter(|(_, name)| !known.contains(name.as_str())).collect();
    eprintln!("{} mutants to try", todo.len());
    let file = fs::OpenOptions::new().create(true).append(true).open(results)?;
    trial::in_parallel(*jobs, &todo, |_, (number, name)| {
        let (outcome, by) = trial.of(*number)?;
        // What quick tests reach and miss stays missed where no slow one reaches it.
        if again && !is_noticed(&format!("{outcome:?}")) {
            return Ok(());
        }
        // In one piece, so that lines of several workers do not mix.
        Ok((&file).write_all(format!("{outcome:?}\t{name}\t{by}\n").as_bytes())?)
    })?;
    Ok(())
}

/// Outcome, name of the mutant, and the test that noticed it, of a line of the results.
fn columns(line: &str) -> Option<(&str, &str, &str)> {
    let (outcome, rest) = line.split_once('\t')?;
    let (name, by) = rest.rsplit_once('\t')?;
    Some((outcome, name, by))
}

fn is_noticed(outcome: &str) -> bool {
    !matches!(outcome, "Missed" | "Unreached")
}

/// The last outcome of each mutant, and the test that noticed it.
fn outcomes(results: &str) -> BTreeMap<&str, (&str, &str)> {
    results.lines().filter_map(columns).map(|(outcome, name, by)| (name, (outcome, by))).collect()
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

/// So many of `all`, evenly, each `offset` further on, in an order that has some from everywhere early on; with each the part of
/// them that comes before it.
fn draw<T>(all: &[T], sample: Option<usize>, offset: usize) -> impl Iterator<Item = (f64, &T)> {
    let count = sample.unwrap_or(all.len()).clamp(1, all.len().max(1));
    let stride = (count * 5 / 8..).find(|&stride| is_coprime(stride, count)).unwrap_or(1);
    let place = move |turn: usize| (turn * stride % count * all.len() / count + offset) % all.len().max(1);
    (0..count).filter_map(move |turn| Some((turn as f64 / count as f64, all.get(place(turn))?)))
}

fn is_coprime(a: usize, b: usize) -> bool {
    if b == 0 { a == 1 } else { is_coprime(b, a % b) }
}

/// One line a module, from those lines of the results that are about `wanted`.
fn summary(results: &str, wanted: &BTreeSet<&str>) -> String {
    #[derive(Default)]
    struct Counts {
        own: usize,
        unit: usize,
        files: usize,
        hung: usize,
        missed: usize,
        unreached: usize,
    }
    let mut modules: BTreeMap<&str, Counts> = BTreeMap::new();
    for (name, (outcome, by)) in outcomes(results).into_iter().filter(|(name, _)| wanted.contains(name)) {
        let path = name.strip_prefix("src/").unwrap_or(name);
        let module = path.split(['/', '.']).next().unwrap_or(path);
        let counts = modules.entry(module).or_default();
        let test = by.strip_prefix("lib ");
        let is_own = test.is_some_and(|test| test.strip_prefix(module).is_some_and(|rest| rest.starts_with("::")));
        *match outcome {
            "Missed" => &mut counts.missed,
            "Unreached" => &mut counts.unreached,
            "Hung" => &mut counts.hung,
            _ if is_own => &mut counts.own,
            _ if test.is_some() => &mut counts.unit,
            _ => &mut counts.files,
        } += 1;
    }
    let line = |(module, Counts { own, unit, files, hung, missed, unreached }): (&str, Counts)| {
        let noticed = own + unit + files + hung;
        let all = noticed + missed + unreached;
        let share = noticed as f64 * 100.0 / all as f64;
        format!(
            "{module}: {noticed} of {all} mutants noticed ({share:.1} %): {own} by its unit tests, {unit} by other unit tests, \
             {files} by test files, {hung} by hanging; {missed} missed, {unreached} not reached\n"
        )
    };
    modules.into_iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_even_and_others_further_on() {
        let all: Vec<usize> = (0..100).collect();
        let drawn = |sample, offset| {
            let drawn: BTreeSet<_> = draw(&all, sample, offset).map(|(_, number)| *number).collect();
            drawn.into_iter().collect::<Vec<_>>()
        };
        assert_eq!(drawn(None, 0), all);
        assert_eq!(drawn(Some(4), 0), [0, 25, 50, 75]);
        assert_eq!(drawn(Some(4), 30), [5, 30, 55, 80]);
        assert_eq!(draw(&all[..0], Some(4), 3).count(), 0);
    }

    #[test]
    fn a_summary_says_who_noticed() {
        let results = "Caught\tsrc/codec/a.rs:1:2\t+ becomes -\tlib codec::a::tests::b\n\
                       Caught\tsrc/codec/a.rs:1:3\t+ becomes *\tlib codecs::c\n\
                       Caught\tsrc/codec/a.rs:1:4\tx\toracle c\n\
                       Hung\tsrc/codec/a.rs:1:5\tx\toracle c\n\
                       Missed\tsrc/frame.rs:1:5\tx\t\n\
                       Unreached\tsrc/frame.rs:1:6\tx\t\n\
                       Unreached\tsrc/frame.rs:1:7\tx\t\n";
        let wanted = results.lines().filter_map(|line| Some(columns(line)?.1)).filter(|name| !name.contains(":7\t"));
        let said = summary(results, &wanted.collect());
        let codec = "codec: 4 of 4 mutants noticed (100.0 %): 1 by its unit tests, 1 by other unit tests, 1 by test files, \
                     1 by hanging; 0 missed, 0 not reached\n";
        let frame = "frame: 0 of 2 mutants noticed (0.0 %): 0 by its unit tests, 0 by other unit tests, 0 by test files, \
                     0 by hanging; 1 missed, 1 not reached\n";
        assert_eq!(said, format!("{codec}{frame}"));
    }
}
