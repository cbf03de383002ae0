//! Costs that grow with the size of a scene, and costs that do not: speed and memory of conversions of one to a
//! thousand million points, queries in scenes of a hundred thousand to thirty million voxels, a walk across a scene of
//! great extent, and equal LAZ files through a converter of another project.
//!
//! Out: `chart/scale.csv`, `chart/memory.csv`, `scale.md`. Every conversion runs in a process of its own.

mod converter;
mod extent;
mod queries;
mod sizes;
pub(crate) mod town;

use crate::chart::lines::{self, Scaled, Value};
use crate::stability::Result;
use crate::stability::table::{number, spread};
use std::path::PathBuf;

/// The words at the top of the page.
const HEAD: &str = include_str!("head.md");

/// Memory budget of every conversion (bytes).
pub(crate) const MEMORY: u64 = 512 << 20;

/// Options of the measurement.
#[derive(Debug, Clone, clap::Args)]
pub struct Scale {
    /// Small samples: a check that everything runs
    #[arg(long)]
    quick: bool,
    /// Folder to write into [default: tools/lab/results, or target/bench-quick with --quick]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Sizes of the converted scans, in millions of points [default: 1,3,10,30,100,300,1000; with --quick: 1,3]
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u64).range(1..=4000))]
    points: Vec<u64>,
    /// Parts to measure [default: all]
    #[arg(long, value_delimiter = ',')]
    only: Vec<Part>,
    /// The program `copc_converter`, to convert the same files with
    #[arg(long)]
    copc_converter: Option<PathBuf>,
    /// Folder for scans and archives, which are deleted; 21 bytes a point of the greatest scan, and as much again
    #[arg(long, default_value_os_t = std::env::temp_dir())]
    work: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// Conversion against the size of the input
    Conversion,
    /// Queries against the size of the scene
    Queries,
    /// A walk across a scene of great extent
    Extent,
    /// Beside another converter
    Converter,
}

/// Results of all parts: numbers for charts, and sections of the page.
#[derive(Debug)]
struct Found {
    numbers: Vec<Scaled>,
    page: String,
}

impl Found {
    /// Adds the median of `values`, with the least and the greatest.
    fn add(&mut self, what: &str, size: u64, metric: &str, values: &[f64]) {
        let [value, low, high] = spread(values);
        let value = Value { value, low, high };
        self.numbers.push(Scaled { what: what.to_owned(), size, metric: metric.to_owned(), value });
    }

    /// Adds a section, and prints it.
    fn section(&mut self, text: &str) {
        println!("{text}");
        self.page += text;
        self.page.push('\n');
    }
}

impl Scale {
    /// Measures, and writes.
    pub fn run(&self) -> Result<()> {
        let default = if self.quick { "target/bench-quick" } else { "tools/lab/results" };
        let out = self.out.clone().unwrap_or_else(|| default.into());
        let chart = out.join("chart");
        std::fs::create_dir_all(&chart)?;
        let work = tempfile::tempdir_in(&self.work)?;
        let mut found = Found { numbers: Vec::new(), page: String::new() };
        found.section(&format!("{HEAD}\n{}\n", machine()));
        if self.has(Part::Conversion) {
            let sizes = match (&self.points[..], self.quick) {
                ([], true) => &[1, 3][..],
                ([], false) => &[1, 3, 10, 30, 100, 300, 1000],
                (given, _) => given,
            };
            let memory = sizes::measure(&mut found, work.path(), sizes, self.quick)?;
            std::fs::write(chart.join("memory.csv"), memory.csv())?;
        }
        if self.has(Part::Queries) {
            queries::measure(&mut found, work.path(), self.quick)?;
        }
        if self.has(Part::Extent) {
            extent::measure(&mut found, work.path(), self.quick)?;
        }
        if self.has(Part::Converter) {
            converter::measure(&mut found, work.path(), self.copc_converter.as_deref(), self.quick)?;
        }
        lines::write(&chart.join("scale.csv"), &found.numbers)?;
        std::fs::write(out.join("scale.md"), found.page)?;
        Ok(())
    }

    fn has(&self, part: Part) -> bool {
        self.only.is_empty() || self.only.contains(&part)
    }
}

/// Describes the machine from the information that the system gives.
pub(crate) fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let memory = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let kib = memory.lines().find_map(|line| line.strip_prefix("MemTotal:")?.split_whitespace().next()?.parse().ok());
    format!(
        "{} threads of {}; {} GiB of memory.",
        std::thread::available_parallelism().map_or(1, |n| n.get()),
        model.map_or("an unknown processor", |(_, name)| name.trim()),
        number(kib.unwrap_or(0.0) / f64::from(1 << 20), 0),
    )
}
