//! The partition of records by tile column, within a memory budget: an external counting sort.
//!
//! Workers collect records into runs; a full run is sorted by tile column and kept in memory while the budget allows,
//! else written to one unnamed temporary file. Afterwards the runs are merged: tile columns come out in archive order,
//! each with the ranges of records that belong to it. Every run is read from front to back, whatever the order of the
//! input, so neither shuffled points nor a huge extent turn the disk's work into single small reads.
//!
//! Memory: `retain_bytes` for runs kept, 20 bytes per record and 120 per tile column of each run under construction,
//! while merging up to 4 KiB per run, or less for very many runs. Disk: 8 bytes per record plus 3 to 12 bytes per tile
//! column and run.

use super::record::{BATCH, ColumnIndex, ColumnKey, PATCH_AREA, PATCH_PIXELS, Record, Recorder, SurfaceVoxel};
use crate::bytes::{read_exact_at, write_all_at};
use crate::{Error, Parameter, Result};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::fs::File;
use std::hash::{BuildHasherDefault, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Bytes per record of a run under construction: the record, its column number and its sorted copy.
pub const BUILD_BYTES: u64 = 20;
/// Bytes per tile column of a run under construction: its place in the list and in the lookup, both of which double
/// as they grow, and in the order and the index made at the end. A run of scattered points is mostly this.
const COLUMN_BYTES: usize = 120;
const RECORD_BYTES: u64 = size_of::<Record>() as u64;
/// Segments of a run with at least this many records are sorted by pixel too: a column of very many records is worked on
/// in areas, and their rows can then be found without reading the whole column for each.
const SORTED_RECORDS: u64 = 1 << 14;
/// Records of a run while no run is on disk: only there many runs cost more than few, and memory that is never touched
/// costs nothing.
const SMALL_RUN_RECORDS: usize = 1 << 20;
/// Read-ahead in the index of a run on disk, least and most.
const INDEX_CHUNK_BYTES: (u64, u64) = (256, 4096);
const COPY_BYTES: usize = 1 << 16;

/// Mixes the few bytes of a [`ColumnIndex`]; the keys come from coordinates, and a slow map is the worst a crafted
/// input can cause.
#[derive(Default)]
struct ColumnHasher(u64);

impl Hasher for ColumnHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_i32(i32::from(byte));
        }
    }
    fn write_i16(&mut self, value: i16) {
        self.write_i32(i32::from(value));
    }
    fn write_i32(&mut self, value: i32) {
        self.0 = (self.0.rotate_left(23) ^ u64::from(value as u32)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 ^= self.0 >> 32;
    }
}

/// One tile column's records in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Segment {
    key: ColumnKey,
    records: u32,
}

/// Collects the records of one worker and hands them to a [`RunStore`] run by run.
#[derive(Debug)]
pub struct RunBuilder {
    recorder: Recorder,
    /// Tile columns whose records are kept; `None` for all.
    only: Option<(u64, u64)>,
    capacity: usize,
    records: Vec<Record>,
    /// Number of each record's column in `columns`.
    numbers: Vec<u32>,
    columns: Vec<(ColumnIndex, u32)>,
    lookup: HashMap<ColumnIndex, u32, BuildHasherDefault<ColumnHasher>>,
    /// Number of the last column met at this place of a 16 × 16 pattern; may be left over from an earlier run.
    recent: [u32; 256],
    /// Memory of a run that went to disk.
    spare: Vec<Record>,
}

impl RunBuilder {
    /// A builder of runs that take `build_bytes` of memory while they are built.
    pub fn new(recorder: Recorder, build_bytes: u64) -> Self {
        let capacity = (build_bytes / BUILD_BYTES).clamp(1 << 14, u32::MAX as u64) as usize;
        Self {
            recorder,
            only: None,
            capacity,
            records: Vec::new(),
            numbers: Vec::new(),
            columns: Vec::new(),
            lookup: HashMap::default(),
            recent: [0; 256],
            spare: Vec::new(),
        }
    }

    /// Keeps only the records of the tile columns `first..=last`, copies in their halo included.
    pub fn only(mut self, first: u64, last: u64) -> Self {
        self.only = Some((first, last));
        self
    }

    /// Adds points (all within [`Recorder::reaches`]); a full run goes to `store`.
    pub fn push(&mut self, x: &[f64], y: &[f64], z: &[f64], store: &RunStore) -> Result<()> {
        for start in (0..x.len()).step_by(BATCH) {
            let chunk = start..(start + BATCH).min(x.len());
            self.make_room(chunk.len(), store)?;
            let recorder = self.recorder;
            recorder.record(&x[chunk.clone()], &y[chunk.clone()], &z[chunk], self.adder());
        }
        Ok(())
    }

    /// Adds what surfaces fill of voxels (all on the grid); a full run goes to `store`.
    pub fn push_surfaces(&mut self, voxels: &[SurfaceVoxel], store: &RunStore) -> Result<()> {
        for chunk in voxels.chunks(BATCH) {
            self.make_room(chunk.len(), store)?;
            let recorder = self.recorder;
            let mut add = self.adder();
            chunk.iter().for_each(|voxel| recorder.record_surface(voxel, &mut add));
        }
        Ok(())
    }

    /// Makes room for `count` (at most [`BATCH`]) points or voxels with all their copies, so that adding needs no checks.
    fn make_room(&mut self, count: usize, store: &RunStore) -> Result<()> {
        let columns = self.columns.len() * (COLUMN_BYTES / BUILD_BYTES as usize);
        let spills = store.file.get().is_some();
        let capacity = if spills { self.capacity } else { self.capacity.min(SMALL_RUN_RECORDS) };
        if self.records.len() + columns + 4 * count > capacity {
            self.flush(store)?;
        }
        if self.records.capacity() < capacity {
            self.records.reserve_exact(capacity - self.records.len());
            self.numbers.reserve_exact(capacity - self.numbers.len());
        }
        Ok(())
    }

    fn adder(&mut self) -> impl FnMut(ColumnIndex, Record) + use<'_> {
        let Self { records, numbers, columns, lookup, recent, only, .. } = self;
        let only = *only;
        move |index, record| {
            if only.is_some_and(|(first, last)| !(first..=last).contains(&index.key().column)) {
                return;
            }
            // Points of a scan jump between few columns; most are found here without hashing.
            let place = &mut recent[(index.tx & 15 | (index.ty & 15) << 4) as usize];
            if columns.get(*place as usize).is_none_or(|column| column.0 != index) {
                *place = *lookup.entry(index).or_insert_with(|| {
                    columns.push((index, 0));
                    (columns.len() - 1) as u32
                });
            }
            columns[*place as usize].1 += 1;
            records.push(record);
            numbers.push(*place);
        }
    }

    /// Hands what is collected to `store`; call once more at the end.
    pub fn flush(&mut self, store: &RunStore) -> Result<()> {
        if self.records.is_empty() {
            return Ok(());
        }
        let mut order: Vec<(ColumnKey, u32)> =
            self.columns.iter().enumerate().map(|(number, column)| (column.0.key(), number as u32)).collect();
        order.sort_unstable();
        let mut index = Vec::with_capacity(4 * order.len());
        let mut encoder = SegmentCoder::default();
        let mut next = 0u32;
        for &(key, number) in &order {
            let records = std::mem::replace(&mut self.columns[number as usize].1, next);
            encoder.encode(Segment { key, records }, &mut index);
            next += records;
        }
        let mut sorted = std::mem::take(&mut self.spare);
        sorted.resize(self.records.len(), Record(0));
        for (&record, &number) in self.records.iter().zip(&self.numbers) {
            let place = &mut self.columns[number as usize].1;
            sorted[*place as usize] = record;
            *place += 1;
        }
        // The records are in `sorted` now; their memory is scratch from here on.
        let mut rest = &mut sorted[..];
        let mut start = 0;
        for &(_, number) in &order {
            // The place of the next record is now the end of the segment.
            let end = self.columns[number as usize].1;
            let (segment, others) = rest.split_at_mut((end - start) as usize);
            if segment.len() as u64 >= SORTED_RECORDS {
                sort_by_pixel(segment, &mut self.records);
            }
            (rest, start) = (others, end);
        }
        self.records.clear();
        self.numbers.clear();
        self.columns.clear();
        self.lookup.clear();
        index.shrink_to_fit();
        self.spare = store.add(sorted, index)?;
        Ok(())
    }
}

/// Sorts many records by pixel, and by nothing else, by counting.
fn sort_by_pixel(records: &mut [Record], scratch: &mut Vec<Record>) {
    let mut next = [0u32; PATCH_AREA];
    records.iter().for_each(|record| next[record.pixel()] += 1);
    let mut start = 0;
    for count in &mut next {
        start += std::mem::replace(count, start);
    }
    scratch.clear();
    scratch.extend_from_slice(records);
    for &record in &*scratch {
        let place = &mut next[record.pixel()];
        records[*place as usize] = record;
        *place += 1;
    }
}

/// Segments as bytes: column minus the column before (variable length), then the block if it is not 0, then the count.
#[derive(Default)]
struct SegmentCoder {
    column: u64,
}

fn put_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

impl SegmentCoder {
    fn encode(&mut self, segment: Segment, out: &mut Vec<u8>) {
        put_varint(segment.key.column.wrapping_sub(self.column), out);
        self.column = segment.key.column;
        let block = segment.key.block;
        // One bit of the count tells whether a block follows: nearly all columns are one block.
        put_varint(u64::from(segment.records) << 1 | u64::from(block != 0), out);
        if block != 0 {
            out.extend_from_slice(&block.to_le_bytes());
        }
    }

    fn decode(&mut self, mut next: impl FnMut() -> Result<u8>) -> Result<Segment> {
        let mut varint = || -> Result<u64> {
            let mut value = 0;
            for shift in (0..64).step_by(7) {
                let byte = next()?;
                value |= u64::from(byte & 0x7F) << shift;
                if byte < 0x80 {
                    break;
                }
            }
            Ok(value)
        };
        self.column = self.column.wrapping_add(varint()?);
        let count = varint()?;
        let block = if count & 1 == 1 { i16::from_le_bytes([next()?, next()?]) } else { 0 };
        Ok(Segment { key: ColumnKey { column: self.column, block }, records: (count >> 1) as u32 })
    }
}

#[derive(Debug)]
enum RunStorage {
    Memory { records: Vec<Record>, index: Vec<u8> },
    Disk { records_at: u64, index_at: u64, index_bytes: u64 },
}

#[derive(Debug)]
struct Run {
    storage: RunStorage,
    records: u64,
    columns: u64,
}

#[derive(Debug, Default)]
struct Kept {
    runs: Vec<Run>,
    memory_bytes: u64,
    file_bytes: u64,
}

/// All runs, in memory while they fit, else in an unnamed temporary file that vanishes with the process.
#[derive(Debug)]
pub struct RunStore {
    retain_bytes: u64,
    temp_dir: PathBuf,
    kept: Mutex<Kept>,
    file: std::sync::OnceLock<File>,
}

impl RunStore {
    /// A store that keeps up to `retain_bytes` in memory and the rest in `temp_dir`.
    pub fn new(retain_bytes: u64, temp_dir: &Path) -> Self {
        Self {
            retain_bytes,
            temp_dir: temp_dir.to_path_buf(),
            kept: Mutex::default(),
            file: std::sync::OnceLock::new(),
        }
    }

    /// Bytes written to the temporary file.
    pub fn temp_bytes(&self) -> u64 {
        self.lock().file_bytes
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Kept> {
        // A panic of another worker ends the whole conversion; the list itself is never left half changed.
        self.kept.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Takes a run, and gives back its memory if it is not needed.
    fn add(&self, mut records: Vec<Record>, index: Vec<u8>) -> Result<Vec<Record>> {
        let columns = count_segments(&index)?;
        let count = records.len() as u64;
        let bytes = count * RECORD_BYTES + index.len() as u64;
        let (records_at, index_at) = {
            let mut kept = self.lock();
            if kept.memory_bytes + bytes <= self.retain_bytes {
                kept.memory_bytes += bytes;
                records.shrink_to_fit();
                kept.runs.push(Run { storage: RunStorage::Memory { records, index }, records: count, columns });
                return Ok(Vec::new());
            }
            let at = kept.file_bytes;
            kept.file_bytes += bytes;
            (at, at + count * RECORD_BYTES)
        };
        let file = self.file()?;
        let mut buffer = vec![0u8; COPY_BYTES];
        for (number, chunk) in records.chunks(COPY_BYTES / RECORD_BYTES as usize).enumerate() {
            let bytes = &mut buffer[..chunk.len() * RECORD_BYTES as usize];
            for (bytes, record) in bytes.chunks_exact_mut(RECORD_BYTES as usize).zip(chunk) {
                bytes.copy_from_slice(&record.0.to_ne_bytes());
            }
            self.write(file, bytes, records_at + (number * COPY_BYTES) as u64)?;
        }
        self.write(file, &index, index_at)?;
        let storage = RunStorage::Disk { records_at, index_at, index_bytes: index.len() as u64 };
        self.lock().runs.push(Run { storage, records: count, columns });
        Ok(records)
    }

    fn file(&self) -> Result<&File> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        let file = tempfile::tempfile_in(&self.temp_dir)
            .map_err(|e| Error::io(&self.temp_dir, "create a temporary file", e).with_way_out(Parameter::TempDir))?;
        // Another worker may have been faster; its file is then the one, and this one vanishes.
        Ok(self.file.get_or_init(|| file))
    }

    fn write(&self, file: &File, bytes: &[u8], offset: u64) -> Result<()> {
        write_all_at(file, offset, bytes).map_err(|e| {
            let action = format!("write temporary data at byte {offset}");
            Error::io(&self.temp_dir, action, e).with_way_out(Parameter::TempDir)
        })
    }

    fn read(&self, bytes: &mut [u8], offset: u64) -> Result<()> {
        let file = self.file()?;
        read_exact_at(file, offset, bytes)
            .map_err(|e| Error::io(&self.temp_dir, format!("read temporary data at byte {offset}"), e))
    }

    fn read_records(&self, run: &Run, first: u64, records: &mut [Record]) -> Result<()> {
        match &run.storage {
            RunStorage::Memory { records: all, .. } => {
                records.copy_from_slice(&all[first as usize..first as usize + records.len()]);
            }
            RunStorage::Disk { records_at, .. } => {
                let mut buffer = vec![0u8; COPY_BYTES.min(records.len() * RECORD_BYTES as usize)];
                let mut at = records_at + first * RECORD_BYTES;
                for chunk in records.chunks_mut(COPY_BYTES / RECORD_BYTES as usize) {
                    let bytes = &mut buffer[..chunk.len() * RECORD_BYTES as usize];
                    self.read(bytes, at)?;
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

fn count_segments(index: &[u8]) -> Result<u64> {
    let (mut coder, mut bytes, mut count) = (SegmentCoder::default(), index.iter(), 0);
    while bytes.len() > 0 {
        coder.decode(|| Ok(bytes.next().copied().unwrap_or(0)))?;
        count += 1;
    }
    Ok(count)
}

/// Reads the segments of one run from front to back.
#[derive(Debug)]
struct Cursor {
    coder: SegmentCoder,
    /// Index bytes at hand, and how many of them are used up.
    chunk: Vec<u8>,
    used: usize,
    /// Next byte of the index to fetch, counted from its start.
    fetched: u64,
    segments_left: u64,
    /// Most index bytes to fetch at once.
    chunk_bytes: usize,
    /// The segment at hand and the record where it begins.
    segment: Option<Segment>,
    first_record: u64,
}

impl std::fmt::Debug for SegmentCoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SegmentCoder({})", self.column)
    }
}

impl Cursor {
    fn new(run: &Run, store: &RunStore, chunk_bytes: usize) -> Result<Self> {
        let mut cursor = Self {
            coder: SegmentCoder::default(),
            chunk: Vec::new(),
            used: 0,
            fetched: 0,
            segments_left: run.columns,
            chunk_bytes,
            segment: None,
            first_record: 0,
        };
        cursor.advance(run, store)?;
        Ok(cursor)
    }

    fn advance(&mut self, run: &Run, store: &RunStore) -> Result<()> {
        self.first_record += self.segment.map_or(0, |segment| u64::from(segment.records));
        if self.segments_left == 0 {
            self.segment = None;
            return Ok(());
        }
        self.segments_left -= 1;
        let Self { coder, chunk, used, fetched, chunk_bytes, .. } = self;
        self.segment = Some(coder.decode(|| {
            if *used == chunk.len() {
                match &run.storage {
                    RunStorage::Memory { index, .. } => {
                        let end = index.len().min(*fetched as usize + *chunk_bytes);
                        chunk.clear();
                        chunk.extend_from_slice(&index[*fetched as usize..end]);
                    }
                    RunStorage::Disk { index_at, index_bytes, .. } => {
                        chunk.resize(((index_bytes - *fetched) as usize).min(*chunk_bytes), 0);
                        store.read(chunk, index_at + *fetched)?;
                    }
                }
                *fetched += chunk.len() as u64;
                *used = 0;
            }
            *used += 1;
            Ok(chunk[*used - 1])
        })?);
        Ok(())
    }
}

/// Records of one run that belong to a [`ColumnJob`]: a contiguous range.
#[derive(Debug)]
struct Stretch {
    run: usize,
    first_record: u64,
    /// Position of a column in the job, and how many records follow for it.
    columns: Vec<(u32, u32)>,
}

/// A few neighbouring tile columns to be worked on together, in archive order.
#[derive(Debug, Default)]
pub struct ColumnJob {
    /// The tile columns and how many records each has.
    pub columns: Vec<(ColumnKey, u64)>,
    /// Sum of the records of all columns.
    pub records: u64,
    stretches: Vec<Stretch>,
}

/// Merges the runs: hands out jobs in archive order.
#[derive(Debug)]
pub struct Merge<'a> {
    store: &'a RunStore,
    runs: Vec<Run>,
}

impl<'a> Merge<'a> {
    /// Takes the runs out of `store`.
    pub fn new(store: &'a RunStore) -> Self {
        Self { store, runs: std::mem::take(&mut store.lock().runs) }
    }

    /// Records of all runs.
    pub fn records(&self) -> u64 {
        self.runs.iter().map(|run| run.records).sum()
    }

    /// Calls `give` with one job after another, each of at most `max_columns` columns and `max_records` records, or of a
    /// single column. Memory: up to 4 KiB per run and what the job lists.
    pub fn jobs(
        &self,
        max_records: u64,
        max_columns: u64,
        mut give: impl FnMut(ColumnJob) -> Result<()>,
    ) -> Result<()> {
        let (least, most) = INDEX_CHUNK_BYTES;
        let chunk_bytes = (self.store.retain_bytes / 8 / self.runs.len().max(1) as u64).clamp(least, most) as usize;
        let cursor = |run| Cursor::new(run, self.store, chunk_bytes);
        let mut cursors = self.runs.iter().map(cursor).collect::<Result<Vec<_>>>()?;
        let key_of = |cursor: &Cursor| cursor.segment.map(|segment| segment.key);
        let mut heap: BinaryHeap<_> =
            cursors.iter().enumerate().filter_map(|(run, cursor)| Some(Reverse((key_of(cursor)?, run)))).collect();
        let mut job = ColumnJob::default();
        let mut part_of = vec![usize::MAX; self.runs.len()];
        let mut same = Vec::new();
        while let Some(&Reverse((key, _))) = heap.peek() {
            same.clear();
            while let Some(&Reverse((next, run))) = heap.peek()
                && next == key
            {
                same.push(run);
                heap.pop();
            }
            let segment_of = |run: usize, cursors: &[Cursor]| cursors[run].segment.map_or(0, |segment| segment.records);
            let records: u64 = same.iter().map(|&run| u64::from(segment_of(run, &cursors))).sum();
            let full = job.records + records > max_records || job.columns.len() as u64 >= max_columns;
            if !job.columns.is_empty() && full {
                part_of.fill(usize::MAX);
                give(std::mem::take(&mut job))?;
            }
            let column = job.columns.len() as u32;
            job.columns.push((key, records));
            job.records += records;
            for &run in &same {
                if part_of[run] == usize::MAX {
                    part_of[run] = job.stretches.len();
                    job.stretches.push(Stretch { run, first_record: cursors[run].first_record, columns: Vec::new() });
                }
                job.stretches[part_of[run]].columns.push((column, segment_of(run, &cursors)));
                cursors[run].advance(&self.runs[run], self.store)?;
                heap.extend(key_of(&cursors[run]).map(|key| Reverse((key, run))));
            }
        }
        if job.columns.is_empty() { Ok(()) } else { give(job) }
    }

    /// Puts the records of all columns of `job` into `records`, column after column.
    pub fn load(&self, job: &ColumnJob, records: &mut Vec<Record>) -> Result<()> {
        records.clear();
        records.resize(job.records as usize, Record(0));
        let mut next = Vec::with_capacity(job.columns.len());
        let mut start = 0;
        for &(_, count) in &job.columns {
            next.push(start as usize);
            start += count;
        }
        let mut buffer = Vec::new();
        for stretch in &job.stretches {
            let run = &self.runs[stretch.run];
            let total: usize = stretch.columns.iter().map(|column| column.1 as usize).sum();
            let first = stretch.first_record as usize;
            let mut rest = match &run.storage {
                RunStorage::Memory { records, .. } => &records[first..first + total],
                RunStorage::Disk { .. } => {
                    buffer.clear();
                    buffer.resize(total, Record(0));
                    self.store.read_records(run, stretch.first_record, &mut buffer)?;
                    &buffer[..]
                }
            };
            for &(column, count) in &stretch.columns {
                let (own, others) = rest.split_at(count as usize);
                let place = &mut next[column as usize];
                records[*place..*place + own.len()].copy_from_slice(own);
                *place += own.len();
                rest = others;
            }
        }
        Ok(())
    }

    /// Calls `take` with the records of a job's only column whose pixels lie in the `rows` (first and end) of its patch,
    /// and maybe others, at most `chunk` records at a time, in no particular order, as long as it asks for more.
    pub fn stream(
        &self,
        job: &ColumnJob,
        rows: (u32, u32),
        chunk: usize,
        mut take: impl FnMut(&[Record]) -> Result<bool>,
    ) -> Result<()> {
        let mut buffer = Vec::new();
        for stretch in &job.stretches {
            let (mut first, mut end) = (0, stretch.columns.iter().map(|column| u64::from(column.1)).sum());
            if end >= SORTED_RECORDS && stretch.columns.len() == 1 {
                (first, end) = (self.row_begins(stretch, end, rows.0)?, self.row_begins(stretch, end, rows.1)?);
            }
            while first < end {
                buffer.resize((end - first).min(chunk as u64) as usize, Record(0));
                self.store.read_records(&self.runs[stretch.run], stretch.first_record + first, &mut buffer)?;
                if !take(&buffer)? {
                    return Ok(());
                }
                first += buffer.len() as u64;
            }
        }
        Ok(())
    }

    /// Number of the first record of a sorted stretch of `records` that does not lie before `row`.
    fn row_begins(&self, stretch: &Stretch, records: u64, row: u32) -> Result<u64> {
        let (mut low, mut high) = (0, records);
        while low < high {
            let middle = low + (high - low) / 2;
            let mut record = [Record(0)];
            self.store.read_records(&self.runs[stretch.run], stretch.first_record + middle, &mut record)?;
            if record[0].pixel() < row as usize * PATCH_PIXELS {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use std::collections::BTreeMap;

    type Columns = BTreeMap<ColumnKey, Vec<Record>>;

    fn points(count: usize) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut axes = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..count {
            axes.0.push(random() * 100.0 - 50.0);
            axes.1.push(random() * 40.0);
            axes.2.push(if number == 7 { 1e7 } else { random() * 3.0 });
        }
        axes
    }

    fn expected(recorder: Recorder, (x, y, z): &(Vec<f64>, Vec<f64>, Vec<f64>)) -> Columns {
        let mut columns = Columns::new();
        for number in 0..x.len() {
            recorder.record(&x[number..=number], &y[number..=number], &z[number..=number], |index, record| {
                columns.entry(index.key()).or_default().push(record);
            });
        }
        columns.values_mut().for_each(|records| records.sort_unstable());
        columns
    }

    #[test]
    fn every_record_comes_out_in_its_column_from_memory_and_from_disk() {
        let recorder = Recorder::new(Frame::new(0.05, 0.15).unwrap());
        let points = points(100_000);
        let expected = expected(recorder, &points);
        let dir = tempfile::tempdir().unwrap();
        for (retain_bytes, max_records) in [(u64::MAX, 1000), (0, 5000), (500_000, 1)] {
            let store = RunStore::new(retain_bytes, dir.path());
            let mut builder = RunBuilder::new(recorder, 20 << 14);
            builder.push(&points.0, &points.1, &points.2, &store).unwrap();
            builder.flush(&store).unwrap();
            assert_eq!(store.temp_bytes() > 0, retain_bytes < 1_000_000);
            let merge = Merge::new(&store);
            assert!(merge.runs.len() > 5);
            let mut found = Columns::new();
            let mut streamed = Columns::new();
            merge
                .jobs(max_records, 1000, |job| {
                    assert!(job.columns.len() <= 1000);
                    assert!(job.records <= max_records || job.columns.len() == 1);
                    let mut records = Vec::new();
                    merge.load(&job, &mut records)?;
                    let mut rest = &records[..];
                    for &(key, count) in &job.columns {
                        let (own, others) = rest.split_at(count as usize);
                        assert!(found.last_key_value().is_none_or(|(last, _)| *last < key));
                        found.insert(key, own.to_vec());
                        rest = others;
                    }
                    if job.columns.len() == 1 {
                        let of_column = streamed.entry(job.columns[0].0).or_default();
                        merge.stream(&job, (0, 66), 100, |chunk| {
                            of_column.extend_from_slice(chunk);
                            Ok(true)
                        })?;
                    }
                    Ok(())
                })
                .unwrap();
            found.values_mut().chain(streamed.values_mut()).for_each(|records| records.sort_unstable());
            assert_eq!(found, expected);
            if max_records == 1 {
                assert_eq!(streamed, expected);
            }
        }
    }

    #[test]
    fn rows_of_a_dense_column_come_without_most_of_the_others() {
        let recorder = Recorder::new(Frame::new(1.0, 3.0).unwrap());
        let dir = tempfile::tempdir().unwrap();
        let at = |number: usize, factor: usize| (number * factor % 64_000) as f64 / 1000.0;
        let count = 3 * SORTED_RECORDS as usize;
        let x: Vec<f64> = (0..count).map(|number| at(number, 7919)).collect();
        let y: Vec<f64> = (0..count).map(|number| at(number, 104_729)).collect();
        let z = vec![0.5; count];
        for retain_bytes in [0, u64::MAX] {
            let store = RunStore::new(retain_bytes, dir.path());
            let mut builder = RunBuilder::new(recorder, 40 * SORTED_RECORDS);
            builder.push(&x, &y, &z, &store).unwrap();
            builder.flush(&store).unwrap();
            let merge = Merge::new(&store);
            let mut dense = 0;
            merge
                .jobs(1, 1, |job| {
                    let gather = |rows: (u32, u32)| {
                        let mut all = Vec::new();
                        let take = |records: &[Record]| {
                            all.extend_from_slice(records);
                            Ok(true)
                        };
                        merge.stream(&job, rows, 1000, take).unwrap();
                        all.sort_unstable();
                        all
                    };
                    let all = gather((0, 66));
                    assert_eq!(all.len() as u64, job.records);
                    for rows in [(0, 3), (10, 13), (64, 66)] {
                        let within =
                            |record: &Record| (rows.0 as usize..rows.1 as usize).contains(&(record.pixel() / 66));
                        let mut some = gather(rows);
                        if job.records > 2 * SORTED_RECORDS {
                            dense += 1;
                            assert!(some.len() < all.len() / 2, "{} of {}", some.len(), all.len());
                        }
                        some.retain(within);
                        assert_eq!(some, all.iter().copied().filter(within).collect::<Vec<_>>());
                    }
                    Ok(())
                })
                .unwrap();
            assert_eq!(dense, 3, "the test needs one dense column");
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named_in_the_error() {
        let store = RunStore::new(0, Path::new("/nonexistent/folder"));
        let mut builder = RunBuilder::new(Recorder::new(Frame::new(0.05, 0.15).unwrap()), 0);
        builder.push(&[0.0], &[0.0], &[0.0], &store).unwrap();
        let text = builder.flush(&store).unwrap_err().to_string();
        assert!(text.contains("/nonexistent/folder") && text.contains("choose a folder"), "{text}");
    }
}
