//! Second pass: tile columns out of the runs, into the archive.

use crate::archive::{ArchiveWriter, EncodedPage, PageEncoder};
use crate::frame::PageKey;
use crate::plan::Plan;
use crate::voxel::fold::{Area, Folded, Moments, Patch, PieceFolder, Sums, Voxel};
use crate::voxel::judge::Judge;
use crate::voxel::record::{ColumnKey, PATCH_AREA, Record};
use crate::voxel::runs::{ColumnJob, Merge, RunStore};
use crate::voxel::spans::ColumnPages;
use crate::{Error, Monitor, Parameter, Result};
use crossbeam_channel::{Receiver, Sender, bounded};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::thread::Builder;

/// Memory of a worker per record of a column: the record as read and twice more while it is sorted, and the voxel (with its
/// verdicts and the place of its sums) and span that it may become.
const JOB_BYTES_PER_RECORD: u64 = 3 * size_of::<Record>() as u64 + size_of::<Voxel>() as u64 + 8 + 16;
/// Records of a job; patches count in 32 bits.
const MOST_RECORDS: u64 = u32::MAX as u64 / 2;
/// Memory of one voxel in a column that is folded piece by piece: before and after a piece, and in the patch.
const DENSE_BYTES_PER_VOXEL: u64 = 3 * size_of::<(usize, Voxel, Moments)>() as u64;
/// Memory of a small page that waits to be written, beyond its bytes.
const PAGE_BYTES: u64 = 320;
/// Jobs that may be finished before the oldest unfinished one.
const JOBS_AHEAD_PER_THREAD: usize = 8;

/// Pages of one job, in archive order, and the voxels dropped in it.
struct Done {
    number: u64,
    records: u64,
    pages: Vec<(PageKey, EncodedPage)>,
    voxels_dropped: u64,
}

/// Second pass: tile columns out of the runs, into the archive. Returns the number of voxels dropped.
pub(super) fn write_columns(
    plan: &Plan,
    store: &RunStore,
    memory_bytes: u64,
    threads: usize,
    writer: &mut ArchiveWriter,
    monitor: &dyn Monitor,
) -> Result<u64> {
    let merge = Merge::new(store);
    monitor.stage("writing slices", merge.records(), "records");
    let (ahead, levels) = (JOBS_AHEAD_PER_THREAD * threads, writer.has_levels());
    let max_records = (memory_bytes / 4 / threads as u64 / JOB_BYTES_PER_RECORD).min(MOST_RECORDS);
    let max_columns = (memory_bytes / 8 / ahead as u64 / PAGE_BYTES).max(1);
    let dense = Dense { one_at_a_time: Mutex::new(()), max_voxels: memory_bytes / 4 / DENSE_BYTES_PER_VOXEL };
    let (job_in, job_out) = bounded::<(u64, ColumnJob)>(threads);
    let (done_in, done_out) = bounded::<Result<Done>>(ahead);
    // A job is given out against a token, and a token comes back when its pages are written: so no more than
    // `ahead` jobs' pages ever wait for an earlier job.
    let (token_in, token_out) = bounded::<()>(ahead);
    for _ in 0..ahead {
        let _ = token_in.send(());
    }
    std::thread::scope(|scope| {
        for number in 0..threads {
            let (jobs, done) = (job_out.clone(), done_in.clone());
            let (merge, dense) = (&merge, &dense);
            let worker = ColumnWorker::new(plan, levels, max_records, dense, monitor);
            let started = Builder::new().spawn_scoped(scope, move || work_on_columns(worker, merge, &jobs, &done));
            match started {
                Ok(_) => {}
                Err(error) if number == 0 => return Err(no_thread(error)),
                // Fewer do the same.
                Err(_) => break,
            }
        }
        drop(job_out);
        let merge = &merge;
        let giver = Builder::new().spawn_scoped(scope, move || {
            let mut number = 0;
            let given = merge.jobs(max_records, max_columns, |job| {
                // A closed channel means that the writer gave up; it knows why.
                if token_out.recv().is_err() || job_in.send((number, job)).is_err() {
                    return Err(Error::Interrupted);
                }
                number += 1;
                Ok(())
            });
            if let Err(error) = given {
                let _ = done_in.send(Err(error));
            }
        });
        let written = match giver {
            Ok(_) => write_in_order(writer, &done_out, &token_in, monitor),
            Err(error) => Err(no_thread(error)),
        };
        // Both ends must go before the scope waits for the threads that may be blocked on them.
        drop((done_out, token_in));
        written
    })
}

fn no_thread(error: std::io::Error) -> Error {
    Error::io("worker threads", "start a thread (end other programs, or raise the limit of processes)", error)
}

fn write_in_order(
    writer: &mut ArchiveWriter,
    done: &Receiver<Result<Done>>,
    tokens: &Sender<()>,
    monitor: &dyn Monitor,
) -> Result<u64> {
    let mut waiting = BTreeMap::new();
    let (mut next, mut voxels_dropped) = (0, 0);
    for result in done {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let result = result?;
        waiting.insert(result.number, result);
        while let Some(result) = waiting.remove(&next) {
            next += 1;
            voxels_dropped += result.voxels_dropped;
            for (key, page) in result.pages {
                writer.put(key, page)?;
            }
            monitor.advance(result.records);
            let _ = tokens.send(());
        }
    }
    Ok(voxels_dropped)
}

fn work_on_columns(
    mut worker: ColumnWorker<'_>,
    merge: &Merge<'_>,
    jobs: &Receiver<(u64, ColumnJob)>,
    done: &Sender<Result<Done>>,
) {
    let _alarm = Alarm(done);
    for (number, job) in jobs {
        let result = worker.work(merge, &job).map(|(pages, voxels_dropped)| Done {
            number,
            records: job.records,
            pages,
            voxels_dropped,
        });
        let failed = result.is_err();
        if done.send(result).is_err() || failed {
            return;
        }
    }
}

/// Wakes the writing thread if a worker panics; it would else wait for ever for that worker's job.
struct Alarm<'a>(&'a Sender<Result<Done>>);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _ = self.0.send(Err(Error::Interrupted));
        }
    }
}

type KeyedPages = Vec<(PageKey, EncodedPage)>;

/// What the workers share for columns that do not fit.
struct Dense {
    /// Held by the one worker that may use as much memory as all workers together.
    one_at_a_time: Mutex<()>,
    /// Voxels that it may then hold.
    max_voxels: u64,
}

/// Scratch of one worker of the second pass.
struct ColumnWorker<'a> {
    dense: &'a Dense,
    monitor: &'a dyn Monitor,
    judge: Judge,
    min_points: u32,
    drop_isolated: bool,
    max_records: u64,
    patch: Patch,
    sums: Sums,
    folder: PieceFolder,
    verdicts: Vec<bool>,
    columns: ColumnPages,
    tolerance: u32,
    encoder: PageEncoder,
    records: Vec<Record>,
}

impl<'a> ColumnWorker<'a> {
    fn new(plan: &Plan, levels: bool, max_records: u64, dense: &'a Dense, monitor: &'a dyn Monitor) -> Self {
        let judge = Judge::new(plan);
        Self {
            dense,
            monitor,
            judge,
            min_points: plan.options.min_points,
            drop_isolated: plan.options.drop_isolated,
            max_records,
            patch: Patch::default(),
            sums: Sums::new(judge.bands()),
            folder: PieceFolder::new(judge.bands()),
            verdicts: Vec::new(),
            columns: ColumnPages::default(),
            tolerance: plan.tolerance_quanta(),
            encoder: PageEncoder::new(plan.frame).for_levels(levels),
            records: Vec::new(),
        }
    }

    fn work(&mut self, merge: &Merge<'_>, job: &ColumnJob) -> Result<(KeyedPages, u64)> {
        let mut pages = KeyedPages::new();
        let mut dropped = 0;
        if job.records > self.max_records {
            dropped += self.dense_column(merge, job)?;
            self.encode(job.columns[0].0, &mut pages)?;
            return Ok((pages, dropped));
        }
        let mut records = std::mem::take(&mut self.records);
        merge.load(job, &mut records)?;
        let mut rest = &records[..];
        for &(key, count) in &job.columns {
            let (own, others) = rest.split_at(count as usize);
            rest = others;
            dropped +=
                self.patch.fold(own, self.min_points, Area::TILE, &mut self.sums) + self.judge_and_add(Area::TILE);
            self.encode(key, &mut pages)?;
        }
        self.records = records;
        Ok((pages, dropped))
    }

    /// Works on a column of more records than memory holds. Where they make few voxels, one pass folds them piece by
    /// piece; else the column is cut into areas of few enough records, with one pass for each.
    ///
    /// Cost: one to three passes over the column's records, then for each area its rows.
    fn dense_column(&mut self, merge: &Merge<'_>, job: &ColumnJob) -> Result<u64> {
        if let Some(dropped) = self.fold_piecemeal(merge, job, Area::TILE, self.max_voxels())? {
            return Ok(dropped);
        }
        let mut counts = vec![0u64; PATCH_AREA];
        self.stream(merge, job, Area::TILE, |records| {
            records.iter().for_each(|record| counts[record.pixel()] += 1);
            true
        })?;
        let mut dropped = 0;
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
                dropped += self.patch.fold(&own, self.min_points, area, &mut self.sums) + self.judge_and_add(area);
                self.records = own;
            } else if let Some([low, high]) = area.halves() {
                // The last is taken first, and spans are to come in order of pixels where they can.
                open.extend([high, low]);
            } else {
                let dense = self.dense;
                let _alone = dense.one_at_a_time.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                (self.patch, self.sums) = (Patch::default(), Sums::new(self.judge.bands()));
                let folded = self.fold_piecemeal(merge, job, area, dense.max_voxels)?;
                (self.patch, self.sums) = (Patch::default(), Sums::new(self.judge.bands()));
                dropped += folded.ok_or_else(|| {
                    let what = "occupied slices of one pixel and its neighbours (larger slices are fewer)";
                    Error::limit(what, "more", dense.max_voxels).with_way_out(Parameter::Memory)
                })?;
            }
        }
        Ok(dropped)
    }

    /// Voxels with sums that fit where `max_records` records do.
    fn max_voxels(&self) -> u64 {
        self.max_records * JOB_BYTES_PER_RECORD / DENSE_BYTES_PER_VOXEL
    }

    /// Folds the records of `area` piece by piece; `None` if they make more than `max_voxels`.
    fn fold_piecemeal(
        &mut self,
        merge: &Merge<'_>,
        job: &ColumnJob,
        area: Area,
        max_voxels: u64,
    ) -> Result<Option<u64>> {
        let mut folder = std::mem::take(&mut self.folder);
        let mut folded = Folded::new();
        let mut own = Vec::new();
        let fits = self.stream(merge, job, area, |records| {
            own.clear();
            own.extend(records.iter().filter(|record| area.holds_with_halo(record.pixel())));
            folder.fold_into(&mut folded, &own);
            folded.len() as u64 <= max_voxels
        })?;
        self.folder = folder;
        if !fits {
            return Ok(None);
        }
        let dropped = self.patch.set_folded(&folded, self.min_points, area, &mut self.sums);
        drop(folded);
        Ok(Some(dropped + self.judge_and_add(area)))
    }

    /// The records of a column in `area` and its halo, and others, piece by piece, until `take` has enough; whether it
    /// saw all.
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

    /// Returns how many isolated voxels were dropped.
    fn judge_and_add(&mut self, area: Area) -> u64 {
        let dropped = if self.drop_isolated { self.patch.drop_isolated(area, &mut self.sums) } else { 0 };
        self.judge.judge(&self.patch, &mut self.sums, area, &mut self.verdicts);
        self.columns.add(&self.patch, area, &self.verdicts);
        dropped
    }

    fn encode(&mut self, column: ColumnKey, pages: &mut KeyedPages) -> Result<()> {
        let Self { columns, encoder, tolerance, .. } = self;
        columns.finish(column.first_slice(), |layer, page| {
            let key = PageKey::from_column(column.column, layer);
            let simple = (*tolerance > 0).then(|| encoder.simplify(page, *tolerance));
            pages.push((key, encoder.encode(key, simple.as_ref().unwrap_or(page))));
            Ok(())
        })
    }
}
