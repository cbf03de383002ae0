//! Second pass: writes the tile columns of the runs into the archive.

use super::columns::{ColumnWork, Columns, EachRecords, Patches, TakeAreas};
use super::holes::fill_holes;
use super::removed::RemovedPoints;
use crate::archive::{ArchiveWriter, EncodedColours, EncodedPage, PageEncoder, Totals};
use crate::codec::ColourEncoder;
use crate::colour::ColourPlan;
use crate::frame::PageKey;
use crate::page::{Inferred, Occupancy, Page};
use crate::plan::{Plan, PlanOptions};
use crate::voxel::accumulate::{Accumulate, Area, Patch, Sums};
use crate::voxel::classify::{VoxelClasses, VoxelClassifier};
use crate::voxel::colours::ColumnColours;
use crate::voxel::components::{Dropped, Frontier, PieceFinder, Pieces};
use crate::voxel::record::{ColumnIndex, ColumnKey, Record, Recorder};
use crate::voxel::runs::{ColumnJob, Merge, RunBuilder, RunStore};
use crate::voxel::spans::ColumnPages;
use crate::voxel::visibility::Views;
use crate::{Monitor, Result};
use std::path::Path;

/// Memory of a small page that waits to be written, besides its bytes.
const PAGE_BYTES: u64 = 320;
/// Jobs per thread that may be finished before the oldest unfinished one: small jobs of records in memory, and jobs of
/// runs on disk.
const JOBS_AHEAD_PER_THREAD: (usize, usize) = (64, 8);
/// The corresponding limit for jobs that find components.
const PIECES_AHEAD_PER_THREAD: usize = 2;

/// Least memory for the colours of a tile column, and memory per voxel with colour (bytes).
const LEAST_COLOUR_BYTES: u64 = 4 << 20;
const BYTES_PER_COLOUR: u64 = 16;

/// Settings of the second pass.
#[derive(Clone, Copy)]
pub(super) struct Writing<'a> {
    pub memory_bytes: u64,
    pub threads: usize,
    /// First and last column of the archive, if the runs hold others too.
    pub columns: Option<(u64, u64)>,
    /// Views of the stations, if points that other stations saw through are to be removed.
    pub views: Option<&'a Views>,
    /// Folder for temporary data.
    pub temp_dir: &'a Path,
    /// Accumulator to use in place of this crate's.
    pub accumulator: Option<&'a dyn Accumulate>,
}

/// Counts of what the second pass left out.
#[derive(Clone, Copy, Default)]
pub(super) struct LeftOut {
    pub voxels: u64,
    /// Points removed as moving.
    pub moving: u64,
}

/// Runs the second pass and, if holes are to be closed, a third: first writes the archive of what was scanned as
/// temporary data, then the archive with inferred floor.
pub(super) fn write_archive(
    plan: &Plan,
    store: &RunStore,
    writing: Writing<'_>,
    writer: &mut ArchiveWriter,
    removed: Option<&mut RemovedPoints>,
    monitor: &dyn Monitor,
) -> Result<LeftOut> {
    if plan.options.fill_holes == 0 {
        return write_columns(plan, store, writing, writing.columns, writer, removed, monitor);
    }
    // Heights are coarsened last, together with those of inferred floor.
    let options = PlanOptions { fill_holes: 0, tolerance_m: 0.0, ..plan.options.clone() };
    let exact = Plan { frame: plan.frame, options };
    let output = writer.scratch(writing.temp_dir)?;
    let mut scanned = ArchiveWriter::on(output, &exact)?;
    if let Some(colours) = writer.colours() {
        scanned.set_colours(ColourPlan { error_milli: 0, ..colours });
    }
    // A part also needs the columns around its own; what is left out of those counts in other parts.
    let all = Writing { columns: None, ..writing };
    let left_out = write_columns(&exact, store, all, writing.columns, &mut scanned, removed, monitor)?;
    fill_holes(&scanned.read_back(Totals::default())?, plan, writing, writer, monitor)?;
    Ok(left_out)
}

/// Second pass: writes the tile columns of the runs into the archive, and the points that it removes as moving into
/// `removed`. Only what is left out of the columns `own` counts and goes there; `None` are all columns.
fn write_columns(
    plan: &Plan,
    store: &RunStore,
    writing: Writing<'_>,
    own: Option<(u64, u64)>,
    writer: &mut ArchiveWriter,
    mut removed: Option<&mut RemovedPoints>,
    monitor: &dyn Monitor,
) -> Result<LeftOut> {
    let Writing { memory_bytes, threads, columns, views, accumulator, .. } = writing;
    let mut merge = Merge::new(store);
    if plan.options.drop_floaters > 0 {
        mark_floaters(plan, store, &merge, writing, monitor)?;
        merge.take_more();
    }
    monitor.stage("writing slices", merge.records(), "records");
    let (small, large) = JOBS_AHEAD_PER_THREAD;
    let (ahead, levels) = (threads * if merge.reads_disk() { large } else { small }, writer.has_levels());
    let max_columns = (memory_bytes / 8 / ahead as u64 / PAGE_BYTES).max(1);
    let colours = writer.colours();
    let values = colours.is_some();
    let pass =
        Columns { merge: &merge, memory_bytes, threads, ahead, max_columns, views, values, accumulator, monitor };
    let most = (memory_bytes / 16 / threads as u64).max(LEAST_COLOUR_BYTES) / BYTES_PER_COLOUR;
    let maker = || PageMaker {
        colours: colours.map(|plan| PageColours::new(plan, most, levels)),
        ..PageMaker::new(plan, levels)
    };
    let worker = |patches| PageWorker { patches, pages: maker(), columns, own };
    let mut left_out = LeftOut::default();
    pass.work_in_order(plan, worker, |done: PagesDone| {
        left_out.voxels += done.voxels_dropped;
        left_out.moving += done.moving.len() as u64;
        if let (Some(removed), Some(views)) = (&mut removed, views) {
            done.moving.into_iter().try_for_each(|(key, record)| removed.push(views.places(key).of(record)))?;
        }
        done.pages.into_iter().try_for_each(|(key, page)| writer.put(key, page))
    })?;
    Ok(left_out)
}

/// Finds connected components of few voxels and adds records to `store` that mark them as dropped.
///
/// Memory: the second pass's share for pages, half for the frontier of components not finished, half for the new runs.
fn mark_floaters(
    plan: &Plan,
    store: &RunStore,
    merge: &Merge<'_>,
    writing: Writing<'_>,
    monitor: &dyn Monitor,
) -> Result<()> {
    let Writing { memory_bytes, threads, columns, views, .. } = writing;
    monitor.stage("finding floaters", merge.records(), "records");
    let most = plan.options.drop_floaters;
    let mut frontier = Frontier::new(most, memory_bytes / 16);
    let mut runs = RunBuilder::new(Recorder::new(plan.frame), memory_bytes / 16);
    if let Some((first, last)) = columns {
        runs = runs.only(move |index: ColumnIndex| (first..=last).contains(&index.key().column));
    }
    let ahead = PIECES_AHEAD_PER_THREAD * threads;
    let (max_columns, values, accumulator) = (1 << 10, false, writing.accumulator);
    let pass = Columns { merge, memory_bytes, threads, ahead, max_columns, views, values, accumulator, monitor };
    let worker = |patches| PieceWorker { patches, finder: PieceFinder::new(most) };
    let mut dropped: Vec<Dropped> = Vec::new();
    pass.work_in_order(plan, worker, |areas: Vec<Pieces>| {
        for pieces in areas {
            frontier.add(pieces, &mut dropped)?;
            runs.push_dropped(&dropped, store)?;
            dropped.clear();
        }
        Ok(())
    })?;
    runs.flush(store)
}

/// Worker that finds the components of tile columns.
struct PieceWorker<'a> {
    patches: Patches<'a>,
    finder: PieceFinder,
}

/// Collector of the components of a job's areas.
struct TakePieces<'a> {
    finder: &'a mut PieceFinder,
    found: Vec<Pieces>,
}

impl TakeAreas for TakePieces<'_> {
    fn area(&mut self, column: ColumnKey, area: Area, patch: &Patch, _: &mut Sums) {
        self.found.push(self.finder.find(column, patch, area));
    }

    fn end(&mut self, _: ColumnKey) -> Result<()> {
        Ok(())
    }
}

impl ColumnWork for PieceWorker<'_> {
    type Done = Vec<Pieces>;

    fn work(&mut self, merge: &Merge<'_>, job: &ColumnJob) -> Result<Self::Done> {
        let mut take = TakePieces { finder: &mut self.finder, found: Vec::new() };
        self.patches.take(merge, job, |_| true, &mut take)?;
        self.patches.removed.clear();
        self.patches.dropped.clear();
        Ok(take.found)
    }
}

type KeyedPages = Vec<(PageKey, EncodedPage)>;

/// Result of a job.
struct PagesDone {
    /// In archive order.
    pages: KeyedPages,
    voxels_dropped: u64,
    /// Removed points, in order.
    moving: Vec<(ColumnKey, Record)>,
}

/// Returns whether a tile column is one of `columns`, given as the first and the last; `None` are all.
fn is_within(columns: Option<(u64, u64)>, key: ColumnKey) -> bool {
    columns.is_none_or(|(first, last)| (first..=last).contains(&key.column))
}

/// Worker that makes the pages of tile columns.
struct PageWorker<'a> {
    patches: Patches<'a>,
    pages: PageMaker,
    columns: Option<(u64, u64)>,
    /// Columns of which the result has what was left out.
    own: Option<(u64, u64)>,
}

impl ColumnWork for PageWorker<'_> {
    type Done = PagesDone;

    fn work(&mut self, merge: &Merge<'_>, job: &ColumnJob) -> Result<Self::Done> {
        let (columns, own) = (self.columns, self.own);
        self.patches.take(merge, job, |key| is_within(columns, key), &mut self.pages)?;
        let dropped = self.patches.dropped.drain(..).filter(|&(key, _)| is_within(own, key));
        let voxels_dropped = dropped.map(|(_, voxels)| voxels).sum();
        let mut moving = std::mem::take(&mut self.patches.removed);
        moving.retain(|&(key, _)| is_within(own, key));
        moving.sort_unstable();
        Ok(PagesDone { pages: std::mem::take(&mut self.pages.done), voxels_dropped, moving })
    }
}

/// Maker of pages from the voxels of areas; reuses its scratch memory.
struct PageMaker {
    classify: VoxelClassifier,
    voxel_classes: VoxelClasses,
    columns: ColumnPages,
    /// True if heights may be coarsened.
    is_loose: bool,
    encoder: PageEncoder,
    colours: Option<PageColours>,
    done: KeyedPages,
}

/// Maker of the colours of pages; reuses its scratch memory.
struct PageColours {
    plan: ColourPlan,
    column: ColumnColours,
    occupancy: Occupancy,
    found: Vec<Option<[u16; 3]>>,
    encoder: ColourEncoder,
}

impl PageColours {
    /// Creates a maker for at most `most` voxels per column, for an archive with or without `levels`.
    fn new(plan: ColourPlan, most: u64, levels: bool) -> Self {
        let column = ColumnColours::new(plan.scale, usize::try_from(most).unwrap_or(usize::MAX));
        let (occupancy, encoder) = (Occupancy::default(), ColourEncoder::default().for_levels(levels));
        Self { plan, column, occupancy, found: Vec::new(), encoder }
    }

    fn of(&mut self, column: ColumnKey, layer: i32, page: &Page) -> EncodedColours {
        let Self { plan, column: colours, occupancy, found, encoder } = self;
        colours.of_page(column.first_slice(), layer, page, occupancy, found);
        EncodedColours::new(plan, occupancy, found, encoder)
    }
}

impl PageMaker {
    fn new(plan: &Plan, levels: bool) -> Self {
        Self {
            classify: VoxelClassifier::new(plan),
            voxel_classes: VoxelClasses::default(),
            columns: ColumnPages::default(),
            is_loose: plan.tolerance_quanta() > 0,
            encoder: PageEncoder::of_plan(plan).for_levels(levels),
            colours: None,
            done: KeyedPages::new(),
        }
    }
}

impl TakeAreas for PageMaker {
    fn area(&mut self, _: ColumnKey, area: Area, patch: &Patch, sums: &mut Sums) {
        self.classify.classify(patch, sums, area, &mut self.voxel_classes);
        self.columns.add(patch, area, &self.voxel_classes);
    }

    fn values(&mut self, patch: &Patch, area: Area, each: &mut EachRecords<'_>) -> Result<()> {
        let Some(PageColours { column, .. }) = &mut self.colours else { return Ok(()) };
        column.begin(patch);
        each(&mut |records| column.add(patch, area, records))?;
        column.end(patch, area)
    }

    fn end(&mut self, column: ColumnKey) -> Result<()> {
        let Self { columns, encoder, is_loose, colours, done, .. } = self;
        columns.finish(column.first_slice(), |layer, page| -> Result<()> {
            let key = PageKey::from_column(column.column, layer);
            let (encoded, loose) = match is_loose {
                true => {
                    let (encoded, page) = encoder.encode_lossy(key, page, &Inferred::NONE);
                    (encoded, Some(page))
                }
                false => (encoder.encode(key, page), None),
            };
            let page = loose.as_ref().unwrap_or(page);
            let colours = colours.as_mut().map(|colours| colours.of(column, layer, page));
            done.push((key, encoded.with_colours(colours.unwrap_or_default())));
            Ok(())
        })?;
        if let Some(colours) = colours {
            colours.column.clear();
        }
        Ok(())
    }
}
