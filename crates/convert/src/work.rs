//! Workers that read inputs. The first pass is the same for inputs of every kind: each thread writes runs.

use super::conversion::Limits;
use super::points::Read;
use crate::bytes::spawn_in;
use crate::colour::ColourScale;
use crate::input::scenes::Scene;
use crate::input::{InputSet, PointBatch, PointChunk, PointDecoder};
use crate::plan::Plan;
use crate::shard_filter::ShardScope;
use crate::voxel::record::Recorder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::{ConvertOptions, Error, Monitor, NoMonitor, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Settings, runs and monitor of the first pass, for inputs of any kind.
#[derive(Clone, Copy)]
pub(super) struct FirstPass<'a> {
    pub options: &'a ConvertOptions,
    pub plan: &'a Plan,
    pub limits: Limits,
    /// Part to convert; `None` for the whole.
    pub scope: Option<&'a ShardScope>,
    pub store: &'a RunStore,
    pub monitor: &'a dyn Monitor,
}

impl FirstPass<'_> {
    /// Creates a worker's builder of runs of records.
    pub fn runs(&self) -> RunBuilder {
        self.of_part(RunBuilder::new(Recorder::new(self.plan.frame), self.limits.build_bytes))
    }

    /// Creates a worker's builder of runs of values; if `with_points`, each value follows its record.
    pub fn values(&self, with_points: bool) -> RunBuilder {
        self.of_part(RunBuilder::of_values(Recorder::new(self.plan.frame), self.limits.build_bytes, with_points))
    }

    fn of_part(&self, runs: RunBuilder) -> RunBuilder {
        match self.scope {
            Some(scope) => runs.only(scope.keeps()),
            None => runs,
        }
    }

    /// Runs `work` on all threads of the conversion.
    pub fn on_threads<T: Send>(&self, flag: &StopFlag<'_>, work: impl Fn() -> Result<T> + Sync) -> Result<Vec<T>> {
        on_threads(self.options.resources.threads, flag, work)
    }
}

/// Flag that an error of a worker or the monitor raises, so that all workers stop.
pub(super) struct StopFlag<'a> {
    monitor: &'a dyn Monitor,
    failed: AtomicBool,
}

impl<'a> StopFlag<'a> {
    pub fn new(monitor: &'a dyn Monitor) -> Self {
        Self { monitor, failed: AtomicBool::new(false) }
    }

    pub fn is_raised(&self) -> bool {
        self.monitor.cancelled() || self.failed.load(Ordering::Relaxed)
    }
}

/// Settings for the colours of triangles and splats.
#[derive(Debug, Clone, Copy)]
pub(super) struct Colouring {
    pub scale: ColourScale,
    /// True if values follow the records that they belong to.
    pub with_points: bool,
}

/// Result of the first pass over inputs without points: triangles, splats, cubes.
pub(super) struct SourceRead<'a> {
    /// Items counted as if they were points, with their bounds.
    pub read: Read,
    /// Files with their bounds.
    pub scenes: Vec<Scene<'a>>,
    /// Content hashes of the files, as read.
    pub hashes: Vec<u128>,
    pub complete: bool,
}

impl SourceRead<'_> {
    pub const NOTHING: Self = Self { read: Read::NOTHING, scenes: Vec::new(), hashes: Vec::new(), complete: true };
}

/// Runs `work` on `threads` threads and returns the results, or the most informative error, which raises `flag`. If the
/// system starts fewer threads, these find all the work; if it starts none, the calling thread does it.
pub(super) fn on_threads<T: Send>(
    threads: usize,
    flag: &StopFlag<'_>,
    work: impl Fn() -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let work = || work().inspect_err(|_| flag.failed.store(true, Ordering::Relaxed));
    let results: Vec<Result<T>> = std::thread::scope(|scope| {
        let start = |_| spawn_in(scope, work).ok();
        let workers: Vec<_> = (0..threads).map_while(start).collect();
        if workers.is_empty() {
            return vec![work()];
        }
        workers
            .into_iter()
            .map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    let (mut done, mut stopped) = (Vec::with_capacity(threads), false);
    for result in results {
        match result {
            Ok(result) => done.push(result),
            // Stopped by another thread's error, which says more.
            Err(Error::Interrupted) => stopped = true,
            Err(error) => return Err(error),
        }
    }
    if stopped { Err(Error::Interrupted) } else { Ok(done) }
}

/// Reads the points of the files that are `wanted` (by number), one batch after the other on all threads, until `take`
/// returns false. A file that was read whole and is only partly readable fails unless that is allowed; the main pass
/// reports what is missing.
pub(super) fn for_each_batch(
    set: &InputSet,
    threads: usize,
    monitor: &dyn Monitor,
    wanted: &(dyn Fn(usize) -> bool + Sync),
    take: &(dyn Fn(usize, &PointBatch) -> bool + Sync),
) -> Result<()> {
    // Files of which chunks were passed over.
    let is_partial: Vec<AtomicBool> = set.files().iter().map(|_| AtomicBool::new(false)).collect();
    let is_wanted = |chunk: &PointChunk| {
        let is_wanted = wanted(chunk.file());
        is_partial[chunk.file()].fetch_or(!is_wanted, Ordering::Relaxed);
        is_wanted
    };
    let chunks = Mutex::new(set.chunks().filter(is_wanted));
    let (flag, enough) = (StopFlag::new(monitor), AtomicBool::new(false));
    on_threads(threads, &flag, || {
        let mut decoder = PointDecoder::new();
        while !enough.load(Ordering::Relaxed) {
            let next = chunks.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some(chunk) = next else { return Ok(()) };
            let done = decoder.decode(set, &chunk, &mut |batch| {
                if flag.is_raised() || enough.load(Ordering::Relaxed) {
                    return Err(Error::Interrupted);
                }
                if !take(chunk.file(), batch) {
                    enough.store(true, Ordering::Relaxed);
                }
                Ok(())
            });
            match done {
                // Stopped because `take` has enough.
                Err(Error::Interrupted) if enough.load(Ordering::Relaxed) && !monitor.cancelled() => return Ok(()),
                done => drop(done?),
            }
        }
        Ok(())
    })?;
    // To check the others, the rest of them would have to be read.
    let is_whole = |file: usize| !enough.load(Ordering::Relaxed) && !is_partial[file].load(Ordering::Relaxed);
    set.check_complete_of(&is_whole, &NoMonitor)
}
