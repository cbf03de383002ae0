//! Storage of runs: in memory while they fit, else on disk.

use super::cover::Cover;
use super::{RECORD_BYTES, count_segments};
use crate::Result;
use crate::voxel::record::Record;
use crate::voxel::spill::{RunSum, Spill, SpillPlace, SpilledRun};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

const COPY_BYTES: usize = 1 << 16;
/// Most bytes of runs in memory while others are on disk; bounds the work lost when the process is killed, whatever the
/// budget.
pub const MOST_IN_MEMORY_WHILE_SPILLING: u64 = 128 << 20;

#[derive(Debug)]
pub(super) enum RunStorage {
    Memory { records: Vec<Record>, index: Vec<u8>, cover: Cover },
    Disk { records_at: u64, index_at: u64, index_bytes: u64 },
}

/// Kind of the records of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunKind {
    /// Points, surfaces, and marks of dropped voxels.
    Matter,
    /// Values of points, for colours.
    Values,
}

#[derive(Debug)]
pub(super) struct Run {
    pub kind: RunKind,
    pub storage: RunStorage,
    pub records: u64,
    pub columns: u64,
}

impl Run {
    fn spilled(run: SpilledRun) -> Self {
        let SpilledRun { records_at, records, index_bytes, columns, values } = run;
        let kind = if values { RunKind::Values } else { RunKind::Matter };
        let index_at = records_at + records * RECORD_BYTES;
        Self { kind, storage: RunStorage::Disk { records_at, index_at, index_bytes }, records, columns }
    }

    fn memory_bytes(&self) -> u64 {
        match &self.storage {
            RunStorage::Memory { records, index, cover } => {
                records.len() as u64 * RECORD_BYTES + (index.len() + cover.bytes.len()) as u64
            }
            RunStorage::Disk { .. } => 0,
        }
    }
}

#[derive(Debug, Default)]
struct Kept {
    runs: Vec<Run>,
    memory_bytes: u64,
}

/// All runs, in memory while they fit, else on disk.
#[derive(Debug)]
pub struct RunStore {
    pub(super) retain_bytes: u64,
    kept: Mutex<Kept>,
    spill: Spill,
    /// Points covered by the runs on disk.
    points: AtomicU64,
}

impl RunStore {
    /// Creates a store that keeps up to `retain_bytes` in memory and the rest in a new spill at `place`.
    pub fn new(retain_bytes: u64, place: SpillPlace) -> Self {
        Self::resumed(retain_bytes, Spill::new(place), Vec::new(), 0)
    }

    /// Creates a store that resumes from the `runs` in `spill`, which cover `points` points.
    pub fn resumed(retain_bytes: u64, spill: Spill, runs: Vec<SpilledRun>, points: u64) -> Self {
        let runs = runs.into_iter().map(Run::spilled).collect();
        Self { retain_bytes, kept: Mutex::new(Kept { runs, memory_bytes: 0 }), spill, points: points.into() }
    }

    /// Bytes of runs on disk.
    pub fn temp_bytes(&self) -> u64 {
        self.spill.bytes()
    }

    /// Points of the input covered by the runs on disk; 0 if coverage is not recorded.
    pub fn points_on_disk(&self) -> u64 {
        self.points.load(Ordering::Relaxed)
    }

    /// Keeps the files on disk for another process, and returns their path.
    pub fn keep(&mut self) -> Option<PathBuf> {
        self.spill.keep();
        self.spill.path().map(Path::to_path_buf)
    }

    /// Returns whether runs go to disk.
    pub(super) fn spills(&self) -> bool {
        self.spill.is_open()
    }

    /// Takes the runs out.
    pub(super) fn take_runs(&self) -> Vec<Run> {
        std::mem::take(&mut self.lock().runs)
    }

    /// Reads from disk.
    pub(super) fn read(&self, at: u64, bytes: &mut [u8]) -> Result<()> {
        self.spill.read(at, bytes)
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        // A panic of another worker ends the whole conversion; the list itself is never left half changed.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores a run, and returns its buffer if it is no longer needed.
    pub(super) fn add(
        &self,
        kind: RunKind,
        mut records: Vec<Record>,
        index: Vec<u8>,
        cover: Cover,
    ) -> Result<Vec<Record>> {
        let columns = count_segments(&index)?;
        let count = records.len() as u64;
        if !self.spill.is_open() {
            let bytes = count * RECORD_BYTES + (index.len() + cover.bytes.len()) as u64;
            let mut kept = self.lock();
            if kept.memory_bytes + bytes <= self.retain_bytes {
                kept.memory_bytes += bytes;
                records.shrink_to_fit();
                let storage = RunStorage::Memory { records, index, cover };
                kept.runs.push(Run { kind, storage, records: count, columns });
                return Ok(Vec::new());
            }
        }
        self.write_run(kind, &records, &index, columns, &cover)?;
        self.lighten()?;
        Ok(records)
    }

    /// Moves one of the runs in memory to disk if they take too much.
    fn lighten(&self) -> Result<()> {
        let run = {
            let mut kept = self.lock();
            let most = MOST_IN_MEMORY_WHILE_SPILLING;
            let in_memory = kept.runs.iter().position(|run| kept.memory_bytes > most && run.memory_bytes() > 0);
            let Some(place) = in_memory else { return Ok(()) };
            let run = kept.runs.swap_remove(place);
            kept.memory_bytes -= run.memory_bytes();
            run
        };
        match &run.storage {
            RunStorage::Memory { records, index, cover } => {
                self.write_run(run.kind, records, index, run.columns, cover)
            }
            RunStorage::Disk { .. } => Ok(()),
        }
    }

    fn write_run(&self, kind: RunKind, records: &[Record], index: &[u8], columns: u64, cover: &Cover) -> Result<()> {
        let (count, index_bytes) = (records.len() as u64, index.len() as u64);
        let records_at = self.spill.reserve(count * RECORD_BYTES + index_bytes)?;
        let (mut buffer, mut sum, mut at) = (vec![0u8; COPY_BYTES], RunSum::default(), records_at);
        for chunk in records.chunks(COPY_BYTES / RECORD_BYTES as usize) {
            let bytes = &mut buffer[..chunk.len() * RECORD_BYTES as usize];
            for (bytes, record) in bytes.chunks_exact_mut(RECORD_BYTES as usize).zip(chunk) {
                bytes.copy_from_slice(&record.0.to_ne_bytes());
            }
            sum.update(bytes);
            self.spill.write(at, bytes)?;
            at += bytes.len() as u64;
        }
        sum.update(index);
        self.spill.write(at, index)?;
        let values = kind == RunKind::Values;
        let run = SpilledRun { records_at, records: count, index_bytes, columns, values };
        // A run without recorded coverage is of no use to another process.
        if !cover.bytes.is_empty() {
            self.spill.note(&run, sum.value(), &cover.bytes)?;
            // Value runs cover the same points again.
            self.points.fetch_add(if values { 0 } else { cover.points }, Ordering::Relaxed);
        }
        self.lock().runs.push(Run::spilled(run));
        Ok(())
    }

    pub(super) fn read_records(&self, run: &Run, first: u64, records: &mut [Record]) -> Result<()> {
        match &run.storage {
            RunStorage::Memory { records: all, .. } => {
                records.copy_from_slice(&all[first as usize..first as usize + records.len()]);
            }
            RunStorage::Disk { records_at, .. } => {
                let mut buffer = vec![0u8; COPY_BYTES.min(records.len() * RECORD_BYTES as usize)];
                let mut at = records_at + first * RECORD_BYTES;
                for chunk in records.chunks_mut(COPY_BYTES / RECORD_BYTES as usize) {
                    let bytes = &mut buffer[..chunk.len() * RECORD_BYTES as usize];
                    self.spill.read(at, bytes)?;
                    at += bytes.len() as u64;
                    for (record, bytes) in chunk.iter_mut().zip(bytes.as_chunks::<8>().0) {
                        *record = Record(u64::from_ne_bytes(*bytes));
                    }
                }
            }
        }
        Ok(())
    }
}
