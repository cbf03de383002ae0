//! Where pawns can walk, measured: standing places beside the truth and beside Recast, doors and stairs, routes, leaks, and what is
//! left of walking people.
//!
//! Each part writes a page of its own: `standing.md`, `routes.md`, `city-routes.md`, `coarse-routes.md`, `leaks.md`, `moving.md`,
//! `moving-speed.md`.

mod city;
mod claims;
mod doors;
mod holes;
mod levels;
mod moving;
mod peer;
mod routes;
mod sight;
mod standing;
mod steps;
mod truth;

use crate::stability::Result;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Pawn, PlaceId, Region, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::{Monitor, NoMonitor};
use std::path::{Path, PathBuf};

pub use moving::Moving;

/// A part of the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// Standing places, doors and stairs
    Standing,
    /// Routes in buildings
    Routes,
    /// Routes across a city
    City,
    /// Coarse routes on the overview levels of real scans
    Levels,
    /// Holes in floors, and random steps with a guard rail
    Leaks,
    /// Walking people removed
    Moving,
    /// Time and memory of that on 100 million points
    Speed,
}

/// Options of the measurement.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Parts [default: all]
    #[arg(value_enum)]
    parts: Vec<Part>,
    /// Small samples: a check that everything runs
    #[arg(long)]
    quick: bool,
    /// Share of the full samples: of pixels, pairs, steps and rooms
    #[arg(long, default_value_t = 1.0)]
    share: f64,
    /// Only scenes whose name contains this; writes no page
    #[arg(long)]
    only: Option<String>,
    /// Folder to write into [default: tools/lab/results, or target/bench-quick with --quick]
    #[arg(long)]
    out: Option<PathBuf>,
}

/// How much is measured.
#[derive(Debug, Clone)]
pub struct Effort {
    quick: bool,
    share: f64,
    only: Option<String>,
}

impl Effort {
    fn takes(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|only| name.contains(only.as_str()))
    }

    /// The share of `full`, but at least `quick`; that with `--quick`.
    fn of(&self, full: usize, quick: usize) -> usize {
        if self.quick { quick } else { ((full as f64 * self.share) as usize).max(quick) }
    }
}

/// Measures the parts, and writes a page for each.
pub fn run(options: &Options) -> Result<()> {
    let default = if options.quick { "target/bench-quick" } else { "tools/lab/results" };
    let out = options.out.clone().unwrap_or_else(|| default.into());
    let all = [Part::Standing, Part::Routes, Part::City, Part::Levels, Part::Leaks, Part::Moving, Part::Speed];
    let parts = if options.parts.is_empty() { &all[..] } else { &options.parts };
    let effort = Effort { quick: options.quick, share: options.share, only: options.only.clone() };
    for part in parts {
        let (name, page) = match part {
            Part::Standing => ("standing.md", standing::page(&effort)? + &doors::section(&effort)?),
            Part::Routes => ("routes.md", routes::page(&effort)?),
            Part::City => ("city-routes.md", city::page(&effort)?),
            Part::Levels => ("coarse-routes.md", levels::page(&effort)?),
            Part::Leaks => ("leaks.md", holes::page(&effort)? + &steps::section(&effort)?),
            Part::Moving => ("moving.md", moving::page(&effort)?),
            Part::Speed => ("moving-speed.md", moving::speed(&effort)?),
        };
        println!("{page}");
        if options.only.is_none() {
            write(&out, name, &page)?;
        }
    }
    Ok(())
}

fn write(out: &Path, name: &str, page: &str) -> Result<()> {
    std::fs::create_dir_all(out)?;
    Ok(std::fs::write(out.join(name), page)?)
}

/// The value of an answer of a store, which has all pages in memory.
fn known<T>(answer: Answer<T>) -> Result<T> {
    match answer {
        Answer::Known(value) => Ok(value),
        Answer::NotLoaded(_) => Err("a store without a page".into()),
    }
}

/// All standing places of a pawn.
fn everywhere(store: &Snapshot, pawn: Pawn) -> Result<(StandingPlaces, Region)> {
    let mut standing = StandingPlaces::new(store, pawn)?;
    let flood = known(Flood::everywhere(&mut standing, store)?)?;
    let region = grown(store, &mut standing, flood)?;
    Ok((standing, region))
}

/// All that can be reached from a place.
fn reached(store: &Snapshot, standing: &mut StandingPlaces, from: PlaceId) -> Result<Region> {
    grown(store, standing, Flood::from(from))
}

fn grown(store: &Snapshot, standing: &mut StandingPlaces, mut flood: Flood) -> Result<Region> {
    known(flood.grow(standing, store, &NoMonitor as &dyn Monitor)?)?;
    Ok(flood.region(standing))
}

/// The standing place under a point.
fn spot(store: &Snapshot, standing: &mut StandingPlaces, at: [f64; 3]) -> Result<Option<PlaceId>> {
    known(standing.spot(store, at.into())?)
}

/// Processor time of this thread (s), which other work on the machine does not affect.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().next().and_then(|word| word.parse::<f64>().ok());
    nanoseconds.unwrap_or(0.0) * 1e-9
}
