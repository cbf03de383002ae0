//! Second-pass work by tile column: several threads accumulate the runs' records to voxels, and the results come in
//! archive order.

use super::pipeline::{Closed, Pipeline};
use crate::plan::Plan;
use crate::voxel::accumulate::{Accumulate, Area, Folded, Job, Moments, Patch, PieceFolder, Sums, Voxel};
use crate::voxel::bands::Bands;
use crate::voxel::colours::ValueSieve;
use crate::voxel::record::{ColumnKey, PATCH_AREA, PATCH_PIXELS, Record, RecordPieces};
use crate::voxel::runs::{ColumnJob, LoadedRecords, Merge};
use crate::voxel::visibility::{CHUNK, Views};
use crate::{Error, Monitor, Parameter, Result};
use std::sync::{Arc, Mutex, PoisonError};

/// Memory of a worker per record of a column (bytes): the record as read, two more copies while sorting, and the voxel
/// (with its classes and the place of its sums) and span that it may become.
const JOB_BYTES_PER_RECORD: u64 = 3 * size_of::<Record>() as u64 + size_of::<Voxel>() as u64 + 8 + 16;
/// Further memory per record if values are wanted (bytes): two copies of the value, and the sum and the mean of a
/// voxel.
const VALUE_BYTES_PER_RECORD: u64 = 2 * size_of::<Record>() as u64 + 32 + 16;
/// Most records of a job; patches count in 32 bits.
const MOST_RECORDS: u64 = u32::MAX as u64 / 2;
/// Records of a job of several columns if all runs are in memory: few, so that the last jobs of the workers are a small
/// part of the whole. From runs on disk, so few records would mean small reads.
const JOB_RECORDS: u64 = 1 << 16;
/// Memory of one voxel in a column that is accumulated piece by piece (bytes): before and after a piece, and in the
/// patch.
const DENSE_BYTES_PER_VOXEL: u64 = 3 * size_of::<(usize, Voxel, Moments)>() as u64;
/// Most strips of rows into which a column is cut. More strips would spend longer on their halos, and on unsorted
/// records, than it takes to accumulate the whole column piece by piece.
const MOST_STRIPS: u64 = 16;

/// Work of one worker on jobs.
pub(super) trait ColumnWork {
    /// Result of a job.
    type Done: Send;

    /// Does one job.
    fn work(&mut self, merge: &Merge<'_>, job: &ColumnJob) -> Result<Self::Done>;
}

/// A pass over all tile columns.
pub(super) struct Columns<'a> {
    pub merge: &'a Merge<'a>,
    /// Budget of the conversion (bytes); a quarter of it is for columns being processed.
    pub memory_bytes: u64,
    pub threads: usize,
    /// See [`Pipeline`].
    pub ahead: usize,
    /// Most columns of a job.
    pub max_columns: u64,
    /// Views of the stations, if points that other stations saw through are to be removed.
    pub views: Option<&'a Views>,
    /// True if the values of points are wanted.
    pub values: bool,
    /// Accumulator to use in place of this crate's.
    pub accumulator: Option<&'a dyn Accumulate>,
    pub monitor: &'a dyn Monitor,
}

impl Columns<'_> {
    /// Passes the result of each job to `take`, in archive order. `worker` makes each worker from the patches it uses.
    pub fn work_in_order<'w, W: ColumnWork + Send>(
        &'w self,
        plan: &Plan,
        mut worker: impl FnMut(Patches<'w>) -> W,
        mut take: impl FnMut(W::Done) -> Result<()>,
    ) -> Result<()> {
        let Self { merge, memory_bytes, threads, ahead, max_columns, views, values, accumulator, monitor } = *self;
        let max_records = (memory_bytes / 4 / threads as u64 / job_bytes_per_record(views, values)).min(MOST_RECORDS);
        let max_voxels = memory_bytes / 4 / DENSE_BYTES_PER_VOXEL;
        let dense = Arc::new(Dense { one_at_a_time: Mutex::new(()), max_voxels });
        let job_records = if merge.reads_disk() { max_records } else { max_records.min(JOB_RECORDS) };
        Pipeline { threads, ahead }.run(
            |job| merge.jobs(job_records, max_columns, |next| job(next).map_err(|Closed| Error::Interrupted)),
            || {
                let patches = Patches::new(plan, max_records, dense.clone(), (views, values), monitor);
                let mut worker = worker(Patches { accumulator, ..patches });
                move |job: ColumnJob| worker.work(merge, &job).map(|what| (job.records, what))
            },
            |(records, what)| {
                take(what)?;
                monitor.advance(records);
                Ok(())
            },
            || if monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) },
            |error| {
                Error::io(
                    "worker threads",
                    "start a thread (end other programs, or raise the limit of processes)",
                    error,
                )
            },
        )
    }
}

/// State shared by the workers for columns that do not fit into memory.
struct Dense {
    /// Held by the one worker that may use as much memory as all workers together.
    one_at_a_time: Mutex<()>,
    /// Most voxels that this worker may then hold.
    max_voxels: u64,
}

/// Function that passes records to its argument, piece by piece.
pub(super) type EachRecords<'a> = dyn FnMut(&mut dyn FnMut(&[Record])) -> Result<()> + 'a;

/// Consumer of the voxels of tile columns, area by area.
pub(super) trait TakeAreas {
    /// Takes the voxels of an area of a column with its halo, and their sums.
    fn area(&mut self, column: ColumnKey, area: Area, patch: &Patch, sums: &mut Sums);

    /// Takes the values of the points of an area, whose voxels `patch` holds: `each` passes them to its argument piece
    /// by piece, mixed with values from elsewhere. Called after [`area`](Self::area), if values are wanted.
    fn values(&mut self, _patch: &Patch, _area: Area, _each: &mut EachRecords<'_>) -> Result<()> {
        Ok(())
    }

    /// Ends a column after all its areas.
    fn end(&mut self, column: ColumnKey) -> Result<()>;
}

/// Accumulator of the records of tile columns to voxels, with the scratch memory of one worker.
pub(super) struct Patches<'a> {
    dense: Arc<Dense>,
    views: Option<&'a Views>,
    accumulator: Option<&'a dyn Accumulate>,
    monitor: &'a dyn Monitor,
    bands: Bands,
    min_points: u32,
    max_records: u64,
    patch: Patch,
    sums: Sums,
    folder: PieceFolder,
    records: Vec<Record>,
    /// Points removed as moving since this list was last emptied, without the copies in halos.
    pub removed: Vec<(ColumnKey, Record)>,
    /// Voxels dropped from each column since this list was last emptied.
    pub dropped: Vec<(ColumnKey, u64)>,
    staying: Vec<Record>,
    /// True if the values of points are wanted; `values` holds those of a job.
    wants_values: bool,
    values: Vec<Record>,
}

/// Removes the points of an area and its halo that are classified as moving, and adds those of the area to `removed`.
fn remove_moving(
    views: &Views,
    key: ColumnKey,
    area: Area,
    records: &mut Vec<Record>,
    removed: &mut Vec<(ColumnKey, Record)>,
) {
    let places = views.places(key);
    let mut kept = 0;
    for begin in (0..records.len()).step_by(CHUNK) {
        let chunk = begin..(begin + CHUNK).min(records.len());
        let is_moving = views.are_moving(places, &records[chunk.clone()]);
        for (number, is_moving) in chunk.zip(is_moving) {
            let record = records[number];
            records[kept] = record;
            kept += usize::from(!is_moving);
            if is_moving && area.holds(record.pixel()) {
                removed.push((key, record));
            }
        }
    }
    records.truncate(kept);
}

/// Returns the memory of a worker per record of a column (bytes).
fn job_bytes_per_record(views: Option<&Views>, values: bool) -> u64 {
    let removed = size_of::<Record>() + size_of::<(ColumnKey, Record)>();
    // With stations, values follow the records of their points; they are copied without those of removed points, which
    // are sorted for that.
    let of_values = if values { 4 * size_of::<Record>() as u64 } else { 0 };
    let removed = if views.is_some() { removed as u64 + of_values } else { 0 };
    JOB_BYTES_PER_RECORD + removed + if values { VALUE_BYTES_PER_RECORD } else { 0 }
}

impl<'a> Patches<'a> {
    fn new(
        plan: &Plan,
        max_records: u64,
        dense: Arc<Dense>,
        (views, wants_values): (Option<&'a Views>, bool),
        monitor: &'a dyn Monitor,
    ) -> Self {
        let bands = Bands::new(plan);
        Self {
            dense,
            views,
            accumulator: None,
            monitor,
            bands,
            min_points: plan.options.min_points,
            max_records,
            patch: Patch::default(),
            sums: Sums::new(bands),
            folder: PieceFolder::new(bands),
            records: Vec::new(),
            removed: Vec::new(),
            dropped: Vec::new(),
            staying: Vec::new(),
            wants_values,
            values: Vec::new(),
        }
    }

    /// Passes the voxels of the `wanted` columns of a job to `take`, and adds to the lists of what was left out.
    pub fn take(
        &mut self,
        merge: &Merge<'_>,
        job: &ColumnJob,
        wanted: impl Fn(ColumnKey) -> bool,
        take: &mut impl TakeAreas,
    ) -> Result<()> {
        if !job.columns.iter().any(|&(key, _)| wanted(key)) {
            return Ok(());
        }
        if job.records > self.max_records {
            let (key, dropped) = (job.columns[0].0, self.dense_column(merge, job, take)?);
            self.dropped.push((key, dropped));
            return take.end(key);
        }
        let mut records = std::mem::take(&mut self.records);
        let mut values = std::mem::take(&mut self.values);
        let loaded = merge.load(job, &mut records)?;
        if self.wants_values {
            merge.load_values(job, &mut values)?;
        }
        let mut elsewhere = self.fold_elsewhere(&loaded, job);
        let mut rest_of_values = &values[..];
        for (number, (&(key, _), &of_values)) in job.columns.iter().zip(&job.values).enumerate() {
            let (own_values, others) = rest_of_values.split_at(if self.wants_values { of_values as usize } else { 0 });
            rest_of_values = others;
            if wanted(key) {
                let dropped = match elsewhere.get_mut(number).map(std::mem::take) {
                    Some(folded) => self.patch.set_folded(&folded, self.min_points, Area::TILE, &mut self.sums),
                    None => self.fold(key, Area::TILE, &loaded.column(number)),
                };
                self.dropped.push((key, dropped));
                take.area(key, Area::TILE, &self.patch, &mut self.sums);
                if self.wants_values {
                    let sifted = self.views.map(|_| {
                        let (removed, mut sifted) = (self.removed_of(key), Vec::new());
                        // The values come run by run, and each run is complete.
                        ValueSieve::default().sift(
                            own_values,
                            |point| removed.binary_search(&point).is_ok(),
                            &mut sifted,
                        );
                        sifted
                    });
                    take.values(&self.patch, Area::TILE, &mut |give| {
                        give(sifted.as_deref().unwrap_or(own_values));
                        Ok(())
                    })?;
                }
                take.end(key)?;
            }
        }
        self.values = values;
        self.records = records;
        Ok(())
    }

    /// Returns the voxels of each column of a job from another accumulator; empty without one, and if points are to be
    /// removed first.
    fn fold_elsewhere(&self, loaded: &LoadedRecords<'_>, job: &ColumnJob) -> Vec<Folded> {
        let Some(accumulator) = self.accumulator.filter(|_| self.views.is_none()) else { return Vec::new() };
        let mut columns = Job::default();
        (0..job.columns.len()).for_each(|number| columns.push(&loaded.column(number)));
        columns.fold(accumulator, self.bands.slices())
    }

    /// Accumulates the records of an area and its halo, except points classified as moving; returns how many voxels
    /// were dropped.
    fn fold(&mut self, key: ColumnKey, area: Area, own: &impl RecordPieces) -> u64 {
        if self.views.is_none() {
            return self.patch.fold(own, self.min_points, area, &mut self.sums);
        }
        let mut staying = std::mem::take(&mut self.staying);
        staying.clear();
        own.each(|piece| staying.extend_from_slice(piece));
        self.remove_moving(key, area, &mut staying);
        let dropped = self.patch.fold(&staying[..], self.min_points, area, &mut self.sums);
        self.staying = staying;
        dropped
    }

    fn remove_moving(&mut self, key: ColumnKey, area: Area, records: &mut Vec<Record>) {
        if let Some(views) = self.views {
            remove_moving(views, key, area, records, &mut self.removed);
        }
    }

    /// Returns the removed points of a column, sorted.
    fn removed_of(&self, key: ColumnKey) -> Vec<Record> {
        let own = self.removed.iter().rev().take_while(|removed| removed.0 == key);
        let mut own: Vec<Record> = own.map(|removed| removed.1).collect();
        own.sort_unstable();
        own
    }

    /// Processes a column with more records than fit into memory, in a few strips of rows that do fit. If that takes
    /// too many strips, one pass accumulates all records piece by piece, provided that they make few voxels; else the
    /// column is cut into areas that fit, with one pass for each.
    ///
    /// Cost: one to three passes over the column's records, then for each strip or area its rows and all unsorted
    /// records.
    fn dense_column(&mut self, merge: &Merge<'_>, job: &ColumnJob, take: &mut impl TakeAreas) -> Result<u64> {
        let key = job.columns[0].0;
        let mut dropped = 0;
        let may_be_few = job.records <= MOST_STRIPS * self.max_records;
        let counts = if may_be_few { Some(self.counts(merge, job)?) } else { None };
        if let Some(strips) = counts.as_ref().and_then(|counts| self.strips(counts)) {
            for strip in strips {
                let mut records = std::mem::take(&mut self.records);
                let loaded = merge.load_rows(job, (strip.y.0, strip.y.1 + 2), &mut records)?;
                dropped += self.fold(key, strip, &loaded.column(0));
                self.records = records;
                take.area(key, strip, &self.patch, &mut self.sums);
                self.stream_values(merge, job, strip, take)?;
            }
            return Ok(dropped);
        }
        if let Some(dropped) = self.fold_piecemeal(merge, job, Area::TILE, self.max_voxels(), take)? {
            return Ok(dropped);
        }
        let counts = counts.map_or_else(|| self.counts(merge, job), Ok)?;
        let mut open = vec![Area::TILE];
        while let Some(area) = open.pop() {
            let with_halo: u64 = (0..PATCH_AREA).filter(|&pixel| area.holds_with_halo(pixel)).map(|p| counts[p]).sum();
            if with_halo <= self.max_records {
                let mut own = std::mem::take(&mut self.records);
                own.clear();
                own.reserve_exact(with_halo as usize);
                self.stream(merge, job, area, |records| {
                    own.extend(records.iter().filter(|record| area.holds_with_halo(record.pixel())));
                    true
                })?;
                self.remove_moving(key, area, &mut own);
                dropped += self.patch.fold(&own[..], self.min_points, area, &mut self.sums);
                take.area(key, area, &self.patch, &mut self.sums);
                self.stream_values(merge, job, area, take)?;
                self.records = own;
            } else if let Some([low, high]) = area.halves() {
                // The stack is popped from its end, and spans should come in pixel order where possible.
                open.extend([high, low]);
            } else {
                let dense = self.dense.clone();
                let _alone = dense.one_at_a_time.lock().unwrap_or_else(PoisonError::into_inner);
                (self.patch, self.sums) = (Patch::default(), Sums::new(self.bands));
                let folded = self.fold_piecemeal(merge, job, area, dense.max_voxels, take)?;
                (self.patch, self.sums) = (Patch::default(), Sums::new(self.bands));
                dropped += folded.ok_or_else(|| {
                    let what = "occupied slices of one pixel and its neighbours (larger slices are fewer)";
                    Error::limit(what, "more", dense.max_voxels).with_suggestion(Parameter::Memory)
                })?;
            }
        }
        Ok(dropped)
    }

    /// Counts the records of a job's only column for each patch pixel.
    fn counts(&self, merge: &Merge<'_>, job: &ColumnJob) -> Result<Vec<u64>> {
        let mut counts = vec![0; PATCH_AREA];
        self.stream(merge, job, Area::TILE, |records| {
            records.iter().for_each(|record| counts[record.pixel()] += 1);
            true
        })?;
        Ok(counts)
    }

    /// Cuts a column, given the number of records of each patch pixel, into strips of whole rows, each as high as
    /// memory allows with its halo. Returns `None` if a single row does not fit, or if there would be more than
    /// [`MOST_STRIPS`].
    fn strips(&self, counts: &[u64]) -> Option<Vec<Area>> {
        let rows: Vec<u64> = counts.chunks(PATCH_PIXELS).map(|row| row.iter().sum()).collect();
        let mut strips = Vec::new();
        let (mut begin, end) = (0, Area::TILE.y.1);
        while begin < end {
            let fits = |end: u32| rows[begin as usize..end as usize + 2].iter().sum::<u64>() <= self.max_records;
            let last = (begin + 1..=end).take_while(|&end| fits(end)).last()?;
            strips.push(Area { y: (begin, last), ..Area::TILE });
            begin = last;
        }
        (strips.len() as u64 <= MOST_STRIPS).then_some(strips)
    }

    /// Returns how many voxels with sums take the memory of `max_records` records.
    fn max_voxels(&self) -> u64 {
        self.max_records * JOB_BYTES_PER_RECORD / DENSE_BYTES_PER_VOXEL
    }

    /// Accumulates the records of `area` piece by piece; returns `None` if they make more than `max_voxels`.
    fn fold_piecemeal(
        &mut self,
        merge: &Merge<'_>,
        job: &ColumnJob,
        area: Area,
        max_voxels: u64,
        take: &mut impl TakeAreas,
    ) -> Result<Option<u64>> {
        let mut folder = std::mem::take(&mut self.folder);
        let (mut folded, mut scratch) = (Folded::new(), Folded::new());
        let (mut own, mut moving) = (Vec::new(), Vec::new());
        let (views, key) = (self.views, job.columns[0].0);
        let fits = self.stream(merge, job, area, |records| {
            own.clear();
            own.extend(records.iter().filter(|record| area.holds_with_halo(record.pixel())));
            if let Some(views) = views {
                remove_moving(views, key, area, &mut own, &mut moving);
            }
            folder.fold_into(&mut folded, &mut scratch, &own);
            folded.len() as u64 <= max_voxels
        })?;
        self.folder = folder;
        drop(scratch);
        if !fits {
            return Ok(None);
        }
        self.removed.append(&mut moving);
        let dropped = self.patch.set_folded(&folded, self.min_points, area, &mut self.sums);
        drop(folded);
        take.area(job.columns[0].0, area, &self.patch, &mut self.sums);
        self.stream_values(merge, job, area, take)?;
        Ok(Some(dropped))
    }

    /// Passes the values of the points of a column in `area` to `take`.
    fn stream_values(&self, merge: &Merge<'_>, job: &ColumnJob, area: Area, take: &mut impl TakeAreas) -> Result<()> {
        if !self.wants_values {
            return Ok(());
        }
        let chunk = (self.max_records / 4).max(1 << 12) as usize;
        // The first row of a patch is the halo.
        let rows = (area.y.0 + 1, area.y.1 + 1);
        let removed = self.removed_of(job.columns[0].0);
        take.values(&self.patch, area, &mut |give| {
            let (mut sieve, mut sifted) = (ValueSieve::default(), Vec::new());
            merge.stream_values(job, rows, chunk, |records| {
                if self.monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                match self.views {
                    None => give(records),
                    Some(_) => {
                        sifted.clear();
                        sieve.sift(records, |point| removed.binary_search(&point).is_ok(), &mut sifted);
                        give(&sifted);
                    }
                }
                Ok(true)
            })
        })
    }

    /// Passes the records of a column in `area` and its halo, mixed with others, to `take` piece by piece until it
    /// returns false. Returns whether `take` saw all of them.
    fn stream(
        &self,
        merge: &Merge<'_>,
        job: &ColumnJob,
        area: Area,
        mut take: impl FnMut(&[Record]) -> bool,
    ) -> Result<bool> {
        let chunk = (self.max_records / 4).max(1 << 12) as usize;
        let mut all = true;
        merge.stream(job, (area.y.0, area.y.1 + 2), chunk, |records| {
            if self.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            all = take(records);
            Ok(all)
        })?;
        Ok(all)
    }
}
