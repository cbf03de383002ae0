//! Facts about each input that a plan stores: enough to recognise it on another machine and to assign it to parts.

use super::points::bounds;
use super::splats::SplatSet;
use super::work::{StopFlag, for_each_batch, on_threads};
use crate::bytes::open_named;
use crate::input::{InputSet, ScanFile, StatedBounds, threads_to_look};
use crate::{Error, Monitor, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use xxhash_rust::xxh3::Xxh3;

/// Blocks of a file in its fingerprint, besides its length: the first, the last, and others evenly between.
const BLOCKS: u64 = 8;
/// Length of a block (bytes).
const BLOCK_BYTES: u64 = 4096;

/// Facts about an input file in a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InputFacts {
    /// File name without folders; only for people who read the plan.
    pub name: String,
    /// Length (bytes).
    pub bytes: u64,
    /// Number of points stated by the header.
    pub points: u64,
    /// XXH3-128 of the length and of eight blocks of 4096 bytes; shows whether another machine has the same file.
    #[serde(with = "super::plan_file::hex")]
    pub fingerprint: u128,
    /// Bounds stated by the header (m); parts that do not meet them leave the file out. `None`: all parts read it.
    #[serde(with = "super::plan_file::bounds")]
    pub bounds: Option<StatedBounds>,
}

impl InputFacts {
    /// Collects the facts of all scans of a set, then of its meshes, then of splats. Cost: eight small reads per file, by `threads`
    /// threads.
    pub(super) fn of(
        (set, splats): (&InputSet, &SplatSet),
        threads: usize,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Self>> {
        let scans = set.files().iter().map(|file| (file.path(), Some(file)));
        let others = set.meshes().iter().map(PathBuf::as_path).chain(splats.paths());
        let all: Vec<_> = scans.chain(others.map(|path| (path, None))).collect();
        let one = |(path, scan): (&Path, Option<&ScanFile>)| {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let (bytes, fingerprint) = fingerprint(path)?;
            let name = name_of(path);
            // Meshes and splats have no header with bounds: every part reads them.
            let (points, bounds) = scan.map_or((0, None), |scan| (scan.points_stated(), scan.bounds_with_slack()));
            Ok(Self { name, bytes, points, fingerprint, bounds })
        };
        let (next, flag) = (AtomicUsize::new(0), StopFlag::new(monitor));
        let work = || {
            let mut found = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(&input) = all.get(number) else { return Ok(found) };
                if flag.is_raised() {
                    return Err(Error::Interrupted);
                }
                found.push((number, one(input)?));
            }
        };
        let threads = threads_to_look(threads, all.iter().map(|&(path, _)| path)).min(all.len());
        let mut found = on_threads(threads, &flag, work)?.into_iter().flatten().collect::<Vec<_>>();
        found.sort_unstable_by_key(|&(number, _)| number);
        Ok(found.into_iter().map(|(_, facts)| facts).collect())
    }

    /// Like [`of`](Self::of), but with the number and bounds of the kept points for scans whose headers do not state
    /// them. Cost: one pass over these scans.
    pub(super) fn measured(
        (set, splats): (&InputSet, &SplatSet),
        threads: usize,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Self>> {
        let mut facts = Self::of((set, splats), threads, monitor)?;
        let is_open = |file: usize| !set.files()[file].has_header();
        if !(0..set.files().len()).any(is_open) {
            return Ok(facts);
        }
        let points = set.files().iter().filter(|file| !file.has_header()).map(ScanFile::points_expected);
        monitor.stage("bounds", points.fold(0, u64::saturating_add), "points");
        let found = Mutex::new(vec![(0u64, None::<StatedBounds>); set.files().len()]);
        for_each_batch(set, threads, monitor, &is_open, &|file, batch| {
            if !batch.is_empty() {
                monitor.advance(batch.len() as u64);
                let (min, max) = bounds(batch);
                let (count, whole) = &mut found.lock().unwrap_or_else(PoisonError::into_inner)[file];
                *count += batch.len() as u64;
                *whole = around(*whole, StatedBounds { min, max });
            }
            true
        })?;
        let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        for (number, (points, bounds)) in found.into_iter().enumerate().filter(|&(number, _)| is_open(number)) {
            (facts[number].points, facts[number].bounds) = (points, bounds);
        }
        Ok(facts)
    }
}

/// Returns the bounds around both.
fn around(one: Option<StatedBounds>, other: StatedBounds) -> Option<StatedBounds> {
    let Some(one) = one else { return Some(other) };
    let axes = |f: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| f(a[axis], b[axis]));
    Some(StatedBounds { min: axes(f64::min, one.min, other.min), max: axes(f64::max, one.max, other.max) })
}

/// Returns the name of a file without folders.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the length of the file at `path`, and the XXH3-128 of the length and the blocks.
fn fingerprint(path: &Path) -> Result<(u64, u128)> {
    let source = open_named(path)?;
    let len = source.len();
    let (mut hash, mut block) = (Xxh3::new(), [0; BLOCK_BYTES as usize]);
    hash.update(&len.to_le_bytes());
    let bytes = len.min(BLOCK_BYTES);
    for number in 0..BLOCKS {
        let at = (u128::from(len - bytes) * u128::from(number) / u128::from(BLOCKS - 1)) as u64;
        source.read_at(at, &mut block[..bytes as usize])?;
        hash.update(&block[..bytes as usize]);
    }
    Ok((len, hash.digest128()))
}
