//! Merge of runs: tile columns in archive order, each with its records.

use super::store::{Run, RunKind, RunStorage, RunStore};
use super::{SORTED_RECORDS, Segment, SegmentCoder};
use crate::Result;
use crate::voxel::record::{ColumnKey, PATCH_PIXELS, Record, RecordPieces};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;

/// Least and greatest read-ahead in the index of a run on disk (bytes).
const INDEX_CHUNK_BYTES: (u64, u64) = (256, 4096);

/// Reads the segments of one run from front to back.
#[derive(Debug)]
struct Cursor {
    coder: SegmentCoder,
    /// Buffered bytes of the index, and how many of them are consumed.
    chunk: Vec<u8>,
    used: usize,
    /// Offset in the index of the next byte to fetch.
    fetched: u64,
    segments_left: u64,
    /// Most index bytes to fetch at once.
    chunk_bytes: usize,
    /// Current segment and the number of its first record.
    segment: Option<Segment>,
    first_record: u64,
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
                        store.read(index_at + *fetched, chunk)?;
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
    /// Position of a column in the job, and its number of records; in order.
    columns: Vec<(u32, u32)>,
}

impl Stretch {
    fn records(&self) -> u64 {
        self.columns.iter().map(|column| u64::from(column.1)).sum()
    }

    /// Returns whether it has a single column, sorted by pixel.
    fn is_sorted(&self) -> bool {
        self.columns.len() == 1 && self.records() >= SORTED_RECORDS
    }
}

/// A few neighbouring tile columns that are processed together, in archive order.
#[derive(Debug, Default)]
pub struct ColumnJob {
    /// The tile columns, each with its number of records.
    pub columns: Vec<(ColumnKey, u64)>,
    /// Sum of the records of all columns.
    pub records: u64,
    /// Number of value records of each column.
    pub values: Vec<u64>,
    stretches: Vec<Stretch>,
    value_stretches: Vec<Stretch>,
}

/// Merges the runs into jobs in archive order.
#[derive(Debug)]
pub struct Merge<'a> {
    store: &'a RunStore,
    pub(super) runs: Vec<Run>,
}

impl<'a> Merge<'a> {
    /// Takes the runs out of `store`.
    pub fn new(store: &'a RunStore) -> Self {
        Self { store, runs: store.take_runs() }
    }

    /// Adds the runs that the store has received since. The next call of [`jobs`](Self::jobs) includes them.
    pub fn take_more(&mut self) {
        self.runs.append(&mut self.store.take_runs());
    }

    /// Records of all runs except those of values.
    pub fn records(&self) -> u64 {
        self.runs.iter().filter(|run| run.kind == RunKind::Matter).map(|run| run.records).sum()
    }

    /// Returns whether some of the runs are on disk.
    pub fn reads_disk(&self) -> bool {
        self.runs.iter().any(|run| matches!(run.storage, RunStorage::Disk { .. }))
    }

    /// Calls `give` with each job in turn, each of at most `max_columns` columns and `max_records` records, or of a
    /// single column. Memory: up to 4 KiB per run, and the lists of the job.
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
            let of_kind = |kind: RunKind| {
                let own = same.iter().filter(|&&run| self.runs[run].kind == kind);
                own.map(|&run| u64::from(segment_of(run, &cursors))).sum::<u64>()
            };
            let (records, values) = (of_kind(RunKind::Matter), of_kind(RunKind::Values));
            let full = job.records + records > max_records || job.columns.len() as u64 >= max_columns;
            if !job.columns.is_empty() && full {
                part_of.fill(usize::MAX);
                give(std::mem::take(&mut job))?;
            }
            let column = job.columns.len() as u32;
            job.columns.push((key, records));
            job.records += records;
            job.values.push(values);
            for &run in &same {
                let stretches = match self.runs[run].kind {
                    RunKind::Matter => &mut job.stretches,
                    RunKind::Values => &mut job.value_stretches,
                };
                if part_of[run] == usize::MAX {
                    part_of[run] = stretches.len();
                    stretches.push(Stretch { run, first_record: cursors[run].first_record, columns: Vec::new() });
                }
                stretches[part_of[run]].columns.push((column, segment_of(run, &cursors)));
                cursors[run].advance(&self.runs[run], self.store)?;
                heap.extend(key_of(&cursors[run]).map(|key| Reverse((key, run))));
            }
        }
        if job.columns.is_empty() { Ok(()) } else { give(job) }
    }

    /// Loads the records of all columns of `job`; reads those on disk into `buffer`.
    pub fn load<'b>(&'b self, job: &ColumnJob, buffer: &'b mut Vec<Record>) -> Result<LoadedRecords<'b>> {
        self.load_from(&job.stretches, buffer)
    }

    /// Replaces `records` by the value records of all columns of `job`, column by column.
    pub fn load_values(&self, job: &ColumnJob, records: &mut Vec<Record>) -> Result<()> {
        let mut buffer = Vec::new();
        let loaded = self.load_from(&job.value_stretches, &mut buffer)?;
        records.clear();
        (0..job.columns.len()).for_each(|number| loaded.column(number).each(|piece| records.extend_from_slice(piece)));
        Ok(())
    }

    fn load_from<'b>(&'b self, stretches: &[Stretch], buffer: &'b mut Vec<Record>) -> Result<LoadedRecords<'b>> {
        let mut parts = Vec::new();
        buffer.clear();
        for stretch in stretches {
            match &self.runs[stretch.run].storage {
                RunStorage::Memory { records, .. } => {
                    let mut rest = &records[stretch.first_record as usize..];
                    for &(column, count) in &stretch.columns {
                        let (own, others) = rest.split_at(count as usize);
                        parts.push((column, Part::InMemory(own)));
                        rest = others;
                    }
                }
                RunStorage::Disk { .. } => {
                    let mut begin = buffer.len();
                    buffer.resize(begin + stretch.records() as usize, Record(0));
                    self.store.read_records(&self.runs[stretch.run], stretch.first_record, &mut buffer[begin..])?;
                    for &(column, count) in &stretch.columns {
                        let end = begin + count as usize;
                        parts.push((column, Part::Read(begin..end)));
                        begin = end;
                    }
                }
            }
        }
        // The sort is stable, so records of a column stay in the order of runs.
        parts.sort_by_key(|part| part.0);
        Ok(LoadedRecords { parts, buffer })
    }

    /// Loads the records of a job's only column whose pixels lie in the `rows` (first and end) of its patch; copies
    /// those that are on disk or unsorted into `buffer`.
    pub fn load_rows<'b>(
        &'b self,
        job: &ColumnJob,
        rows: (u32, u32),
        buffer: &'b mut Vec<Record>,
    ) -> Result<LoadedRecords<'b>> {
        let mut parts = Vec::new();
        buffer.clear();
        for stretch in &job.stretches {
            let run = &self.runs[stretch.run];
            let (begin, is_sorted) = (buffer.len(), stretch.is_sorted());
            let within = self.rows_of(stretch, rows)?;
            let (first, count) = (stretch.first_record + within.start, (within.end - within.start) as usize);
            if let (RunStorage::Memory { records, .. }, true) = (&run.storage, is_sorted) {
                parts.push((0, Part::InMemory(&records[first as usize..first as usize + count])));
                continue;
            }
            buffer.resize(begin + count, Record(0));
            self.store.read_records(run, first, &mut buffer[begin..])?;
            if !is_sorted {
                let pixels = rows.0 as usize * PATCH_PIXELS..rows.1 as usize * PATCH_PIXELS;
                let mut kept = begin;
                for number in begin..buffer.len() {
                    let record = buffer[number];
                    buffer[kept] = record;
                    kept += usize::from(pixels.contains(&record.pixel()));
                }
                buffer.truncate(kept);
            }
            parts.push((0, Part::Read(begin..buffer.len())));
        }
        Ok(LoadedRecords { parts, buffer })
    }

    /// Calls `take` with the records of a job's only column whose pixels lie in the `rows` (first and end) of its
    /// patch, and possibly others, at most `chunk` at a time, in no particular order, until it returns false.
    pub fn stream(
        &self,
        job: &ColumnJob,
        rows: (u32, u32),
        chunk: usize,
        take: impl FnMut(&[Record]) -> Result<bool>,
    ) -> Result<()> {
        self.stream_from(&job.stretches, rows, chunk, take)
    }

    /// Like [`stream`](Self::stream), but for value records.
    pub fn stream_values(
        &self,
        job: &ColumnJob,
        rows: (u32, u32),
        chunk: usize,
        take: impl FnMut(&[Record]) -> Result<bool>,
    ) -> Result<()> {
        self.stream_from(&job.value_stretches, rows, chunk, take)
    }

    fn stream_from(
        &self,
        stretches: &[Stretch],
        rows: (u32, u32),
        chunk: usize,
        mut take: impl FnMut(&[Record]) -> Result<bool>,
    ) -> Result<()> {
        let mut buffer = Vec::new();
        for stretch in stretches {
            let Range { start: mut first, end } = self.rows_of(stretch, rows)?;
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

    /// Returns the numbers of a stretch's records that lie in `rows`; of all records if it is not sorted.
    fn rows_of(&self, stretch: &Stretch, rows: (u32, u32)) -> Result<Range<u64>> {
        Ok(match stretch.is_sorted() {
            true => self.row_begins(stretch, rows.0)?..self.row_begins(stretch, rows.1)?,
            false => 0..stretch.records(),
        })
    }

    /// Returns the number of the first record of a sorted stretch that does not lie before `row`.
    fn row_begins(&self, stretch: &Stretch, row: u32) -> Result<u64> {
        let (mut low, mut high) = (0, stretch.records());
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

/// Records of one run and column.
#[derive(Debug)]
enum Part<'a> {
    InMemory(&'a [Record]),
    /// Range of the buffer.
    Read(Range<usize>),
}

/// Loaded records of the columns of a [`ColumnJob`]; those of runs in memory are borrowed.
#[derive(Debug)]
pub struct LoadedRecords<'a> {
    /// Parts with the position of their column in the job, sorted by it.
    parts: Vec<(u32, Part<'a>)>,
    buffer: &'a [Record],
}

impl LoadedRecords<'_> {
    /// Returns the records of the column at position `number` of the job.
    pub fn column(&self, number: usize) -> ColumnRecords<'_> {
        let begin = self.parts.partition_point(|part| (part.0 as usize) < number);
        let end = self.parts.partition_point(|part| part.0 as usize <= number);
        ColumnRecords { parts: &self.parts[begin..end], buffer: self.buffer }
    }
}

/// Records of a column.
#[derive(Debug, Clone, Copy)]
pub struct ColumnRecords<'a> {
    parts: &'a [(u32, Part<'a>)],
    buffer: &'a [Record],
}

impl RecordPieces for ColumnRecords<'_> {
    #[inline]
    fn each(&self, mut take: impl FnMut(&[Record])) {
        for (_, part) in self.parts {
            match part {
                Part::InMemory(records) => take(records),
                Part::Read(range) => take(&self.buffer[range.clone()]),
            }
        }
    }
}
