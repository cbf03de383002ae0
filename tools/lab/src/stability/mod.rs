//! Failure modes of the methods: one sweep each over the thesis' rule as written, its order-free form, and Slicewalk's.
//!
//! In: nothing but seeds. Out: a CSV and usually a plot per sweep, and `stability.md`, a page of text around their
//! numbers. Every run writes identical bytes: no times, no threads, no random numbers of the platform.

pub(crate) mod lab;
mod patch;
pub(crate) mod plot;
pub(crate) mod table;
pub(crate) mod written;

mod floors;
mod planes;
mod walls;

mod dirt;
mod invariance;

mod bodies;
mod heights;
mod scenes;

use plot::Plot;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use table::Table;

/// Anything that goes wrong here ends the run.
pub type Error = Box<dyn std::error::Error + Send + Sync>;
/// Result of a sweep.
pub type Result<T> = std::result::Result<T, Error>;

/// The words of the page; `{{name}}` stands for a number or a table of a sweep.
const PAGE: &str = include_str!("page.md");

/// How much to measure.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Small samples only.
    pub quick: bool,
}

impl Effort {
    /// `full`, or `quick` of a quick run.
    pub fn of<T>(&self, full: T, quick: T) -> T {
        if self.quick { quick } else { full }
    }
}

/// Output of a sweep.
#[derive(Debug, Default)]
pub struct Outcome {
    /// CSV files by name.
    tables: Vec<(&'static str, Table)>,
    plots: Vec<Plot>,
    /// Texts for the page by name.
    facts: Vec<(String, String)>,
}

impl Outcome {
    fn fact(&mut self, name: impl Into<String>, text: impl Into<String>) {
        self.facts.push((name.into(), text.into()));
    }
}

type Sweep = fn(Effort) -> Result<Outcome>;

/// All sweeps; the slowest first, so that two threads end together.
const SWEEPS: &[(&str, Sweep)] = &[
    ("limit-angle", planes::limit_angle),
    ("scene-floors", scenes::floors),
    ("verdicts-at-the-limit", planes::at_the_limit),
    ("outliers", dirt::outliers),
    ("noise", floors::noise),
    ("density", walls::density),
    ("phase-z", floors::phase_z),
    ("phase-xy", walls::phase_xy),
    ("rotation", invariance::rotation),
    ("translation", invariance::translation),
    ("order", invariance::order),
    ("duplicates", invariance::duplicates),
    ("holes", dirt::holes),
    ("round", bodies::round),
    ("doors", bodies::doors),
    ("headroom", heights::headroom),
    ("risers", heights::risers),
    ("ramps", heights::ramps),
];

/// Runs the sweeps and writes `stability/*.csv`, `stability/*.svg` and `stability.md` into `out`.
pub fn run(out: &Path, quick: bool, only: Option<&str>) -> Result<()> {
    let folder = out.join("stability");
    std::fs::create_dir_all(&folder)?;
    let chosen: Vec<_> = SWEEPS.iter().filter(|(name, _)| only.is_none_or(|only| name.contains(only))).collect();
    let open = Mutex::new(chosen.iter());
    let facts = Mutex::new(BTreeMap::new());
    let work = || -> Result<()> {
        loop {
            let Some((name, sweep)) = open.lock().expect("no sweep panics with the lock").next() else { return Ok(()) };
            let start = std::time::Instant::now();
            let outcome = sweep(Effort { quick }).map_err(|e| format!("{name}: {e}"))?;
            for (file, table) in &outcome.tables {
                std::fs::write(folder.join(format!("{file}.csv")), table.csv())?;
            }
            outcome.plots.iter().try_for_each(|plot| plot.write(&folder))?;
            facts.lock().expect("no sweep panics with the lock").extend(outcome.facts);
            eprintln!("{name}: {:.1} s", start.elapsed().as_secs_f64());
        }
    };
    std::thread::scope(|scope| {
        let workers = [scope.spawn(work), scope.spawn(work)];
        workers.into_iter().try_for_each(|worker| worker.join().map_err(|_| "a sweep panicked")?)
    })?;
    let facts = facts.into_inner().expect("no sweep panics with the lock");
    match only {
        Some(_) => facts.iter().for_each(|(name, text)| println!("{name}:\n{text}\n")),
        None => std::fs::write(out.join("stability.md"), fill(PAGE, &facts)?)?,
    }
    Ok(())
}

/// The page with every `{{name}}` replaced.
pub(crate) fn fill(page: &str, facts: &BTreeMap<String, String>) -> Result<String> {
    let mut parts = page.split("{{");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (name, rest) = part.split_once("}}").ok_or("page.md: {{ without }}")?;
        text += facts.get(name).ok_or_else(|| format!("page.md: no sweep gives {name:?}"))?;
        text += rest;
    }
    Ok(text)
}
