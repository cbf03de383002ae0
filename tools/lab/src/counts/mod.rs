//! Instructions of the hot paths, counted by Valgrind's callgrind, beside those that are committed in `counts.toml`.
//!
//! A guard against regressions that a busy machine cannot disturb: the same program counts the same, to about a
//! thousandth. It says nothing of time: a cache miss counts as one instruction.
//!
//! Callgrind is run from here and not through a benchmark harness: the harnesses need a runner of exactly their own version
//! installed beside them, and compare with the last run on a machine, where we compare with a committed figure.

mod callgrind;
mod committed;
pub mod paths;

use crate::building;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Table, number};
use crate::stability::{Error, Result};
use committed::Committed;
use scangen::{Kind, Sample, WriteSpec, write_samples};
use slicewalk::plan::Classifier;
use std::path::{Path, PathBuf};

/// Instructions over committed ones above which the report fails. Compilers and processors move counts by a few
/// hundredths; what makes a path half as slow again is a mistake. Or another profile: with `lto = "off"`, which keeps
/// functions of one unit of code out of the others, a box query takes three times as many. Cargo's own release profile
/// counts as the one in `Cargo.toml` does, to a hundredth.
pub const LIMIT: f64 = 1.5;
/// Pixel size of the archive that is asked (m).
const PIXEL_M: f64 = 0.08;
/// Points to a side of a pixel in it.
const PER_PIXEL: f64 = 1.6;
/// Distance between points of the scan that is converted (m).
const CONVERTED_SPACING_M: f64 = 0.2;

/// Options of a count.
#[derive(Debug, Clone, clap::Args)]
pub struct Counts {
    /// Writes the counts as the new committed ones
    #[arg(long)]
    write: bool,
    /// How often each path is counted, to see that counts do not depend on chance
    #[arg(long, default_value_t = 2)]
    runs: usize,
    /// The committed counts
    #[arg(long, default_value = "tools/lab/counts.toml")]
    committed: PathBuf,
}

/// Instructions of one path in each of the runs.
struct Counted {
    path: paths::Path,
    instructions: Vec<u64>,
}

impl Counted {
    /// Instructions per operation, from the first run; all are nearly equal.
    fn each(&self) -> f64 {
        self.instructions[0] as f64 / self.path.operations as f64
    }

    /// How far the runs are apart, as a share of the first.
    fn spread(&self) -> f64 {
        let (least, most) = self.instructions.iter().fold((u64::MAX, 0), |(l, m), &n| (l.min(n), m.max(n)));
        (most - least) as f64 / self.instructions[0] as f64
    }
}

impl Counts {
    /// Counts, and prints path, count, committed count and ratio. A path above [`LIMIT`] times its committed count is an
    /// error.
    pub fn run(&self) -> Result<()> {
        callgrind::check()?;
        let counted = self.count()?;
        let before = Committed::read(&self.committed)?;
        let mut table = Table::new(["path", "operations", "instructions each", "committed", "ratio"]);
        let mut beyond = Vec::new();
        for counted in &counted {
            let (name, each) = (counted.path.name, counted.each());
            let known = before.get(name);
            let ratio = known.map(|known| each / known);
            if let Some(ratio) = ratio.filter(|&ratio| ratio > LIMIT) {
                beyond.push(format!("{name} takes {} times its committed count", number(ratio, 2)));
            }
            table.row([
                name.to_owned(),
                counted.path.operations.to_string(),
                number(each, 1),
                known.map_or("none".into(), |known| number(known, 1)),
                ratio.map_or("new".into(), |ratio| number(ratio, 3)),
            ]);
        }
        println!("{}", table.markdown());
        if self.runs > 1 {
            let spread = counted.iter().map(Counted::spread).fold(0.0, f64::max);
            println!("\n{} runs of the same program: counts at most {} % apart", self.runs, number(spread * 100.0, 4));
        }
        if self.write {
            return Committed::write(&self.committed, counted.iter().map(|c| (c.path.name, c.each())));
        }
        if beyond.is_empty() {
            return Ok(());
        }
        let out = "make it cheaper, or say why it must cost more and renew the counts by `.ci/counts --write`";
        Err(Error::from(format!("{} (at most {LIMIT} times is allowed): {out}", beyond.join("; "))))
    }

    fn count(&self) -> Result<Vec<Counted>> {
        let folder = tempfile::tempdir()?;
        prepare(folder.path())?;
        let mut counted: Vec<Counted> = Vec::new();
        for run in 0..self.runs.max(1) {
            let found = paths::GROUPS.map(|group| callgrind::count(folder.path(), group));
            for (n, (path, instructions)) in
                found.into_iter().collect::<Result<Vec<_>>>()?.concat().into_iter().enumerate()
            {
                match counted.get_mut(n) {
                    Some(counted) if run > 0 => counted.instructions.push(instructions),
                    _ => counted.push(Counted { path, instructions: vec![instructions] }),
                }
            }
        }
        Ok(counted)
    }
}

/// Writes the scan to be converted and the archive to be asked into `folder`, so that Valgrind need not make them.
fn prepare(folder: &Path) -> Result<()> {
    let points = |spacing: f64| {
        let mut points = Vec::new();
        building::scan(spacing, 7, |point| points.push(point.into()));
        points
    };
    let sample = |position: [f64; 3]| Sample { position, kind: Kind::Surface, surface: 0, station: 0 };
    let samples = points(CONVERTED_SPACING_M).into_iter().map(sample);
    write_samples(&folder.join(paths::SCAN), samples, &WriteSpec::default())?;
    let scan = Scan::new(points(PIXEL_M / PER_PIXEL))?.convert(Setting::new(PIXEL_M), Classifier::Plane)?;
    std::fs::write(folder.join(paths::ARCHIVE), scan.bytes)?;
    Ok(())
}
