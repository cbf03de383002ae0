//! Construction of runs: records grouped by tile column, by counting sort.

use super::cover::Covering;
use super::store::{RunKind, RunStore};
use super::{SORTED_RECORDS, Segment, SegmentCoder};
use crate::Result;
use crate::voxel::record::{
    BATCH, ColumnIndex, ColumnKey, PATCH_AREA, Record, RecordSink, Recorder, SurfaceVoxel, record_dropped,
};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Bytes per record of a run under construction: the record, its column number and its sorted copy.
pub const BUILD_BYTES: u64 = 20;
/// Bytes per tile column of a run under construction: its entries in the list and in the lookup, both of which double
/// as they grow, and in the order and the index built at the end. They dominate a run of scattered points.
const COLUMN_BYTES: usize = 120;
/// Records of a run while no run is on disk. Many small runs are expensive only on disk, and memory that is never
/// touched costs nothing.
const SMALL_RUN_RECORDS: usize = 1 << 20;

/// Mixes the few bytes of a [`ColumnIndex`]. The keys come from coordinates, so a crafted input can at worst slow down
/// the map.
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

type Lookup = HashMap<ColumnIndex, u32, BuildHasherDefault<ColumnHasher>>;

/// Filter of tile columns; caches the last answer at each position of a 16 × 16 pattern.
struct Only {
    keeps: Box<dyn Fn(ColumnIndex) -> bool + Send>,
    recent: [Option<(ColumnIndex, bool)>; 256],
}

impl Only {
    #[inline]
    fn keeps(&mut self, index: ColumnIndex) -> bool {
        match &mut self.recent[place(index, 4)] {
            Some((same, keeps)) if *same == index => *keeps,
            other => {
                let keeps = (self.keeps)(index);
                *other = Some((index, keeps));
                keeps
            }
        }
    }
}

impl std::fmt::Debug for Only {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Only")
    }
}

/// Position of a column in a pattern of `2^bits` × `2^bits`.
#[inline]
fn place(index: ColumnIndex, bits: u32) -> usize {
    let low = |index: i32| index as u32 & ((1 << bits) - 1);
    (low(index.tx) | low(index.ty) << bits) as usize
}

/// Edge of the pattern in which columns are found without hashing, as a power of two: 256 tiles of 64 pixels, 1.6 km at
/// 10 cm. Unordered points jump between all of them.
const PATTERN_BITS: u32 = 8;

/// Returns the number of a column; appends it to `columns` if it is new.
#[cold]
fn number_of(index: ColumnIndex, lookup: &mut Lookup, columns: &mut Vec<(ColumnIndex, u32)>) -> u32 {
    *lookup.entry(index).or_insert_with(|| {
        columns.push((index, 0));
        (columns.len() - 1) as u32
    })
}

/// Adds records to those of a builder.
struct Adder<'a> {
    records: &'a mut Vec<Record>,
    numbers: &'a mut Vec<u32>,
    columns: &'a mut Vec<(ColumnIndex, u32)>,
    lookup: &'a mut Lookup,
    recent: &'a mut [u32],
    only: Option<&'a mut Only>,
}

impl Adder<'_> {
    /// Returns the number of a column.
    #[inline]
    fn number(&mut self, index: ColumnIndex) -> u32 {
        // Finds most columns without hashing.
        let number = &mut self.recent[place(index, PATTERN_BITS)];
        if self.columns.get(*number as usize).is_none_or(|column| column.0 != index) {
            *number = number_of(index, self.lookup, self.columns);
        }
        *number
    }
}

impl RecordSink for Adder<'_> {
    #[inline]
    fn add(&mut self, index: ColumnIndex, record: Record) {
        if self.only.as_mut().is_some_and(|only| !only.keeps(index)) {
            return;
        }
        let number = self.number(index);
        self.columns[number as usize].1 += 1;
        self.records.push(record);
        self.numbers.push(number);
    }

    #[inline]
    fn add_all(&mut self, records: &[Record], index: impl Fn(usize) -> ColumnIndex) {
        if self.only.is_some() {
            return records.iter().enumerate().for_each(|(number, &record)| self.add(index(number), record));
        }
        // Consecutive points mostly share a column, so their count is kept in a local variable.
        let mut last = None;
        let (mut number, mut count) = (0, 0);
        let start = self.numbers.len();
        self.numbers.resize(start + records.len(), 0);
        for at in 0..records.len() {
            let index = index(at);
            if last != Some(index) {
                if count > 0 {
                    self.columns[number as usize].1 += count;
                }
                (number, count, last) = (self.number(index), 0, Some(index));
            }
            count += 1;
            self.numbers[start + at] = number;
        }
        if count > 0 {
            self.columns[number as usize].1 += count;
        }
        self.records.extend_from_slice(records);
    }
}

/// Collects the records of one worker and passes them to a [`RunStore`] in runs.
#[derive(Debug)]
pub struct RunBuilder {
    kind: RunKind,
    recorder: Recorder,
    /// Filter of the tile columns whose records are kept; `None` keeps all.
    only: Option<Only>,
    capacity: usize,
    records: Vec<Record>,
    /// Index into `columns` for each record.
    numbers: Vec<u32>,
    columns: Vec<(ColumnIndex, u32)>,
    lookup: Lookup,
    /// Number of the last column seen at each position of a pattern ([`PATTERN_BITS`]); may be left over from an
    /// earlier run. Memory is touched only where there are columns.
    recent: Box<[u32]>,
    /// Buffer of a run that was written to disk.
    spare: Vec<Record>,
    covering: Option<Covering>,
    /// True if values follow the records of their points.
    with_points: bool,
}

impl RunBuilder {
    /// Creates a builder whose runs take `build_bytes` of memory during construction.
    pub fn new(recorder: Recorder, build_bytes: u64) -> Self {
        let capacity = (build_bytes / BUILD_BYTES).clamp(1 << 13, u32::MAX as u64) as usize;
        Self {
            kind: RunKind::Matter,
            recorder,
            only: None,
            capacity,
            records: Vec::new(),
            numbers: Vec::new(),
            columns: Vec::new(),
            lookup: Lookup::default(),
            recent: vec![0; 1 << (2 * PATTERN_BITS)].into(),
            spare: Vec::new(),
            covering: None,
            with_points: false,
        }
    }

    /// Like [`new`](Self::new), but for runs of values; `with_points` puts each value after the record of its point.
    pub fn of_values(recorder: Recorder, build_bytes: u64, with_points: bool) -> Self {
        Self { kind: RunKind::Values, with_points, ..Self::new(recorder, build_bytes) }
    }

    /// Records the part of the input that each run covers. `note` appends further data for each piece of a chunk.
    pub fn covering(mut self, note: impl FnMut(&mut Vec<u8>) + Send + 'static) -> Self {
        self.covering = Some(Covering::new(Box::new(note)));
        self
    }

    /// Begins a chunk of the input: the points that follow are its points, from the first.
    pub fn begin_chunk(&mut self, chunk: u64) {
        if let Some(covering) = &mut self.covering {
            covering.begin(chunk);
        }
    }

    /// Skips points of the chunk that other runs cover.
    pub fn pass(&mut self, points: u64) {
        if let Some(covering) = &mut self.covering {
            covering.pass(points);
        }
    }

    /// Ends the chunk. With a `result`, a process that resumes from the runs need not read the chunk again.
    pub fn end_chunk(&mut self, result: Option<&[u8]>) {
        if let Some(covering) = &mut self.covering {
            covering.close(result);
        }
    }

    /// Keeps only the records of tile columns for which `keeps` is true, including the copies in their halo.
    pub fn only(mut self, keeps: impl Fn(ColumnIndex) -> bool + Send + 'static) -> Self {
        self.only = Some(Only { keeps: Box::new(keeps), recent: [None; 256] });
        self
    }

    /// Adds points (all within [`Recorder::reaches`]); a full run goes to `store`.
    pub fn push(&mut self, x: &[f64], y: &[f64], z: &[f64], store: &RunStore) -> Result<()> {
        for start in (0..x.len()).step_by(BATCH) {
            let chunk = start..(start + BATCH).min(x.len());
            self.make_room(chunk.len(), store)?;
            let recorder = self.recorder;
            let count = chunk.len() as u64;
            recorder.record_into(&x[chunk.clone()], &y[chunk.clone()], &z[chunk], self.adder());
            if let Some(covering) = &mut self.covering {
                covering.add(count);
            }
        }
        Ok(())
    }

    /// Counts points of the chunk that have no records in these runs as covered.
    pub fn without_records(&mut self, points: u64) {
        if let Some(covering) = &mut self.covering {
            covering.add(points);
        }
    }

    /// Adds the `values` of points (all within [`Recorder::reaches`]), one or two records each; a full run goes to
    /// `store`.
    pub fn push_values(
        &mut self,
        [x, y, z]: [&[f64]; 3],
        values: impl Fn(usize) -> (u32, Option<u32>),
        store: &RunStore,
    ) -> Result<()> {
        for start in (0..x.len()).step_by(BATCH) {
            let chunk = start..(start + BATCH).min(x.len());
            self.make_room(chunk.len(), store)?;
            let recorder = self.recorder;
            let of_chunk = |number: usize| values(start + number);
            let (count, with_points) = (chunk.len() as u64, self.with_points);
            let points = [&x[chunk.clone()], &y[chunk.clone()], &z[chunk]];
            let mut adder = self.adder();
            recorder.record_values(points, with_points, of_chunk, |index, record| adder.add(index, record));
            if let Some(covering) = &mut self.covering {
                covering.add(count);
            }
        }
        Ok(())
    }

    /// Adds the parts of voxels that surfaces fill (all on the grid); a full run goes to `store`.
    pub fn push_surfaces(&mut self, voxels: &[SurfaceVoxel], store: &RunStore) -> Result<()> {
        for chunk in voxels.chunks(BATCH) {
            self.make_room(chunk.len(), store)?;
            let recorder = self.recorder;
            recorder.record_surfaces(chunk, self.adder());
        }
        Ok(())
    }

    /// Adds the values of surface pieces in voxels (all on the grid), one or two records each; a full run goes to
    /// `store`.
    pub fn push_surface_values(
        &mut self,
        pieces: &[(SurfaceVoxel, (u32, Option<u32>))],
        store: &RunStore,
    ) -> Result<()> {
        for chunk in pieces.chunks(BATCH) {
            self.make_room(chunk.len(), store)?;
            let (recorder, with_points) = (self.recorder, self.with_points);
            let mut adder = self.adder();
            for (voxel, values) in chunk {
                recorder.record_surface_values(voxel, with_points, *values, |index, record| adder.add(index, record));
            }
        }
        Ok(())
    }

    /// Marks voxels (pixel and slice, all on the grid) as dropped; a full run goes to `store`.
    pub fn push_dropped(&mut self, voxels: &[((i64, i64), i64)], store: &RunStore) -> Result<()> {
        for chunk in voxels.chunks(BATCH) {
            self.make_room(chunk.len(), store)?;
            let mut adder = self.adder();
            chunk
                .iter()
                .for_each(|&(pixel, slice)| record_dropped(pixel, slice, |index, record| adder.add(index, record)));
        }
        Ok(())
    }

    /// Makes room for `count` (at most [`BATCH`]) points or voxels with all their copies, so that adding needs no
    /// checks.
    fn make_room(&mut self, count: usize, store: &RunStore) -> Result<()> {
        let columns = self.columns.len() * (COLUMN_BYTES / BUILD_BYTES as usize);
        let covered = self.covering.as_ref().map_or(0, |covering| covering.len() / BUILD_BYTES as usize);
        let capacity = if store.spills() { self.capacity } else { self.capacity.min(SMALL_RUN_RECORDS) };
        if self.records.len() + columns + covered + 4 * count > capacity {
            self.flush(store)?;
        }
        if self.records.capacity() < capacity {
            self.records.reserve_exact(capacity - self.records.len());
            self.numbers.reserve_exact(capacity - self.numbers.len());
        }
        Ok(())
    }

    fn adder(&mut self) -> Adder<'_> {
        let Self { records, numbers, columns, lookup, recent, only, .. } = self;
        Adder { records, numbers, columns, lookup, recent, only: only.as_mut() }
    }

    /// Passes the collected records to `store`; must be called once more at the end.
    pub fn flush(&mut self, store: &RunStore) -> Result<()> {
        let cover = self.covering.as_mut().map(Covering::take).unwrap_or_default();
        if self.records.is_empty() && cover.is_empty() {
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
        // The records are in `sorted` now, so their memory is free for use as scratch.
        let mut rest = &mut sorted[..];
        let mut start = 0;
        for &(_, number) in &order {
            // The position of the next record is now the end of the segment.
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
        self.spare = store.add(self.kind, sorted, index, cover)?;
        Ok(())
    }
}

/// Sorts many records by pixel only, by counting sort.
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
