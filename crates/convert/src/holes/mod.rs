//! Closing of holes in floors: from an archive of what was scanned to an archive that also has inferred floor.
//!
//! Whether a pixel is closed depends on the tile columns around its own (`closing.rs`), which may come much earlier or
//! later in archive order. So the scanned archive is first written whole, as temporary data, and then read in squares
//! of columns. Memory: a quarter of the budget for columns being processed, an eighth for encoded pages. Disk: the
//! scanned archive.

mod closing;
#[cfg(test)]
mod tests;

use super::pages::Writing;
use super::work::{StopFlag, on_threads};
use crate::archive::{
    Archive, ArchiveWriter, ColourReader, EncodedColours, EncodedPage, PageDecoder, PageEncoder, PageEntry,
};
use crate::codec::ColourEncoder;
use crate::colour::ColourPlan;
use crate::frame::{PAGE_QUANTA, PageKey};
use crate::page::{Inferred, Occupancy, Page, PageBuilder, Span};
use crate::plan::Plan;
use crate::{Error, Monitor, Parameter, Result};
pub(super) use closing::Closer;
use closing::{Fill, ScannedColumn};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Low bits in which the numbers of a job's columns differ, so a job is a square of 8 × 8 columns.
const JOB_BITS: u32 = 6;
/// Jobs in a round, per thread.
const JOBS_PER_THREAD: usize = 2;
/// Memory per word of a page being processed (bytes): the page, its spans, and as much again for the results.
const BYTES_PER_WORD: u64 = 32;
/// Further memory per tile column (bytes).
const BYTES_PER_COLUMN: u64 = 1 << 15;
/// Directory entries that a worker caches over all leaves; at least two leaves stay cached.
const KEPT_ENTRIES: usize = 1 << 16;

/// Most spans of one pixel in a page.
const MOST_SPANS: usize = 64;

/// Consecutive tile columns, with the entries of their pages.
struct Job {
    columns: Vec<(u64, Vec<PageEntry>)>,
    words: u64,
}

type KeyedPages = Vec<(PageKey, EncodedPage)>;

/// Writes the pages of `scanned` to `writer`, with inferred floor where holes are closed. `plan` is the plan of the
/// result.
pub(super) fn fill_holes(
    scanned: &Archive,
    plan: &Plan,
    writing: Writing<'_>,
    writer: &mut ArchiveWriter,
    monitor: &dyn Monitor,
) -> Result<()> {
    let Writing { memory_bytes, threads, columns, .. } = writing;
    monitor.stage("filling holes", scanned.header().pages.total(), "pages");
    let share = memory_bytes / 4 / threads as u64;
    let mut jobs = Jobs { entries: scanned.entries(), next: None, max_words: share / BYTES_PER_WORD / 4 };
    let levels = writer.has_levels();
    let worker = |_| -> Result<Mutex<Worker<'_>>> {
        let colours = writer.colours().zip(ColourReader::new(scanned)?);
        Ok(Mutex::new(Worker { colours, ..Worker::new(scanned, plan, levels, memory_bytes / 4) }))
    };
    let workers = (0..threads).map(worker).collect::<Result<Vec<_>>>()?;
    let large = Mutex::new(());
    loop {
        let round: Vec<Job> = jobs.by_ref().take(JOBS_PER_THREAD * threads).collect::<Result<_>>()?;
        if round.is_empty() {
            return Ok(());
        }
        let done: Vec<Mutex<KeyedPages>> = round.iter().map(|_| Mutex::default()).collect();
        let (next_job, next_worker) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let flag = StopFlag::new(monitor);
        on_threads(threads, &flag, || {
            let worker = &workers[next_worker.fetch_add(1, Ordering::Relaxed) % threads];
            let mut worker = worker.lock().unwrap_or_else(PoisonError::into_inner);
            while let Some(number) =
                Some(next_job.fetch_add(1, Ordering::Relaxed)).filter(|&number| number < round.len())
            {
                if flag.is_raised() {
                    return Err(Error::Interrupted);
                }
                let pages = worker.work(&round[number], columns, share, &large)?;
                *done[number].lock().unwrap_or_else(PoisonError::into_inner) = pages;
            }
            Ok(())
        })?;
        for (job, pages) in round.iter().zip(done) {
            let pages = pages.into_inner().unwrap_or_else(PoisonError::into_inner);
            pages.into_iter().try_for_each(|(key, page)| writer.put(key, page))?;
            monitor.advance(job.columns.iter().map(|(_, entries)| entries.len() as u64).sum());
        }
    }
}

/// Iterator over the columns of an archive, grouped into jobs.
struct Jobs<I> {
    entries: I,
    next: Option<PageEntry>,
    max_words: u64,
}

impl<I: Iterator<Item = Result<PageEntry>>> Iterator for Jobs<I> {
    type Item = Result<Job>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut job = Job { columns: Vec::new(), words: 0 };
        loop {
            let entry = match self.next.take().map(Ok).or_else(|| self.entries.next()) {
                Some(Ok(entry)) => entry,
                Some(Err(error)) => return Some(Err(error)),
                None => return (!job.columns.is_empty()).then_some(Ok(job)),
            };
            let column = entry.key.column();
            let own = job.columns.last().is_some_and(|last| last.0 == column);
            let joins = job.columns.first().is_none_or(|first| first.0 >> JOB_BITS == column >> JOB_BITS);
            if !own && (!joins || job.words > self.max_words) {
                self.next = Some(entry);
                return Some(Ok(job));
            }
            if !own {
                job.columns.push((column, Vec::new()));
            }
            job.words += u64::from(entry.size.words());
            if let Some((_, entries)) = job.columns.last_mut() {
                entries.push(entry);
            }
        }
    }
}

/// Worker that reads columns, closes their holes and encodes them.
struct Worker<'a> {
    scanned: &'a Archive,
    memory_bytes: u64,
    leaves: VecDeque<(usize, Arc<Vec<PageEntry>>)>,
    decoder: PageDecoder,
    closer: Closer,
    /// True if heights may be coarsened.
    is_loose: bool,
    builder: PageBuilder,
    encoder: PageEncoder,
    /// Colour plan of the result, and the colours of the scanned archive.
    colours: Option<(ColourPlan, ColourReader)>,
    colour_encoder: ColourEncoder,
}

/// Column that was read: its spans, and its pages if it is to be written.
struct Read {
    pages: Vec<(i32, Page)>,
    spans: ScannedColumn,
}

impl<'a> Worker<'a> {
    fn new(scanned: &'a Archive, plan: &Plan, levels: bool, memory_bytes: u64) -> Self {
        Self {
            scanned,
            memory_bytes,
            leaves: VecDeque::new(),
            decoder: PageDecoder::new(),
            closer: Closer::new(&plan.frame, plan.options.fill_holes),
            is_loose: plan.tolerance_quanta() > 0,
            builder: PageBuilder::default(),
            encoder: PageEncoder::of_plan(plan).for_levels(levels),
            colours: None,
            colour_encoder: ColourEncoder::default().for_levels(levels),
        }
    }

    /// Returns the pages of the columns of a job that lie in `wanted`. Only one job that needs more than `share` bytes
    /// runs at a time.
    fn work(&mut self, job: &Job, wanted: Option<(u64, u64)>, share: u64, alone: &Mutex<()>) -> Result<KeyedPages> {
        let wanted = |column: u64| wanted.is_none_or(|(first, last)| (first..=last).contains(&column));
        let own: Vec<u64> = job.columns.iter().map(|column| column.0).filter(|&column| wanted(column)).collect();
        if own.is_empty() {
            return Ok(KeyedPages::new());
        }
        let mut entries: BTreeMap<u64, Vec<PageEntry>> = job.columns.iter().cloned().collect();
        for near in own.iter().flat_map(|&column| around(column)).flatten() {
            if let Entry::Vacant(unknown) = entries.entry(near) {
                unknown.insert(self.entries_of(near)?);
            }
        }
        entries.retain(|_, entries| !entries.is_empty());
        let words: u64 = entries.values().flatten().map(|entry| u64::from(entry.size.words())).sum();
        let needed = words * BYTES_PER_WORD + entries.len() as u64 * BYTES_PER_COLUMN;
        if needed > self.memory_bytes && own.len() > 1 {
            // Single columns have fewer neighbours.
            let mut pages = KeyedPages::new();
            for (column, entries) in job.columns.iter().filter(|column| wanted(column.0)) {
                let one = Job { columns: vec![(*column, entries.clone())], words: 0 };
                pages.append(&mut self.work(&one, None, share, alone)?);
            }
            return Ok(pages);
        }
        if needed > self.memory_bytes {
            let what = "bytes for the tile columns around a hole (larger pixels make fewer spans)";
            return Err(Error::limit(what, needed, self.memory_bytes).with_suggestion(Parameter::Memory));
        }
        let _alone = (needed > share).then(|| alone.lock().unwrap_or_else(PoisonError::into_inner));
        let mut columns: BTreeMap<u64, Read> = BTreeMap::new();
        for (column, entries) in entries {
            let (scanned, decoder) = (self.scanned, &mut self.decoder);
            let page = |entry: &PageEntry| -> Result<(i32, Page)> {
                Ok((entry.key.layer, scanned.page_with(entry, decoder)?))
            };
            let mut pages = entries.iter().map(page).collect::<Result<Vec<_>>>()?;
            let spans = ScannedColumn::of(&pages);
            if !own.contains(&column) {
                pages = Vec::new();
            }
            columns.insert(column, Read { pages, spans });
        }
        let mut done = KeyedPages::new();
        for column in own {
            let around = around(column).map(|near| Some(&columns.get(&near?)?.spans));
            let fills = self.closer.close(&around);
            if let Some(Read { pages, .. }) = columns.get(&column) {
                self.encode(column, pages, &fills, &mut done)?;
            }
        }
        Ok(done)
    }

    /// Returns the directory entries of a column; empty if nothing was scanned there.
    fn entries_of(&mut self, column: u64) -> Result<Vec<PageEntry>> {
        let mut found = Vec::new();
        let first = PageKey::from_column(column, i32::MIN);
        let from = self.scanned.leaf_of(first).unwrap_or(0);
        for leaf in from..self.scanned.leaf_count() {
            if self.scanned.leaf_first(leaf).column() > column {
                break;
            }
            let entries = self.leaf(leaf)?;
            let start = entries.partition_point(|entry| entry.key.column() < column);
            let end = entries.partition_point(|entry| entry.key.column() <= column);
            found.extend_from_slice(&entries[start..end]);
        }
        Ok(found)
    }

    fn leaf(&mut self, index: usize) -> Result<Arc<Vec<PageEntry>>> {
        let entries = match self.leaves.iter().position(|leaf| leaf.0 == index).and_then(|at| self.leaves.remove(at)) {
            Some((_, entries)) => entries,
            None => Arc::new(self.scanned.leaf(index)?),
        };
        self.leaves.push_back((index, entries.clone()));
        let kept =
            |leaves: &VecDeque<(usize, Arc<Vec<PageEntry>>)>| leaves.iter().map(|leaf| leaf.1.len()).sum::<usize>();
        while self.leaves.len() > 2 && kept(&self.leaves) > KEPT_ENTRIES {
            self.leaves.pop_front();
        }
        Ok(entries)
    }

    /// Encodes the pages of a column with its fills.
    fn encode(&mut self, column: u64, pages: &[(i32, Page)], fills: &[Fill], done: &mut KeyedPages) -> Result<()> {
        let mut layers: BTreeMap<i32, (Option<&Page>, Vec<Fill>)> =
            pages.iter().map(|(layer, page)| (*layer, (Some(page), Vec::new()))).collect();
        for &fill in fills {
            let layer = fill.bottom.div_euclid(PAGE_QUANTA) as i32;
            layers.entry(layer).or_default().1.push(fill);
        }
        for (layer, (page, fills)) in layers {
            let key = PageKey::from_column(column, layer);
            let scanned = page;
            let filled;
            let (page, inferred) = match (page, &fills[..]) {
                (Some(page), []) => (page, Inferred::new()),
                (page, fills) => {
                    let inferred;
                    (filled, inferred) = with_fills(page, layer, fills, &mut self.builder);
                    (&filled, inferred)
                }
            };
            if page.slices() == 0 {
                continue;
            }
            let (encoded, loose) = match self.is_loose {
                true => {
                    let (encoded, page) = self.encoder.encode_lossy(key, page, &inferred);
                    (encoded, Some(page))
                }
                false => (self.encoder.encode_inferred(key, page, &inferred), None),
            };
            let colours = self.colours_of(key, scanned, loose.as_ref().unwrap_or(page))?;
            done.push((key, encoded.with_colours(colours)));
        }
        Ok(())
    }

    /// Returns the colours of `page`, which was made from the `scanned` page.
    fn colours_of(&mut self, key: PageKey, scanned: Option<&Page>, page: &Page) -> Result<EncodedColours> {
        let (Some((plan, reader)), Some(scanned)) = (&mut self.colours, scanned) else {
            return Ok(EncodedColours::default());
        };
        let exact = reader.colours_of(key, scanned)?;
        let occupancy = Occupancy::of(page);
        let colour = |(pixel, k): (usize, u32)| {
            let rgb = exact.of(pixel as u32 & 63, pixel as u32 >> 6, k)?;
            Some(rgb.map(|channel| u16::from(channel) * 257))
        };
        let colours: Vec<_> = occupancy.voxels().map(colour).collect();
        Ok(EncodedColours::new(plan, &occupancy, &colours, &mut self.colour_encoder))
    }
}

/// Adds fills, in order of pixel and height, to the spans of a page; returns the new page and which spans are inferred.
fn with_fills(page: Option<&Page>, layer: i32, fills: &[Fill], builder: &mut PageBuilder) -> (Page, Inferred) {
    builder.clear();
    let floor = i64::from(layer) * PAGE_QUANTA;
    let mut inferred = Inferred::new();
    let mut column: Vec<(Span, bool)> = Vec::new();
    let mut rest = fills;
    for pixel in 0..64 * 64u16 {
        let (px, py) = (u32::from(pixel) & 63, u32::from(pixel) >> 6);
        let (own, others) = rest.split_at(rest.partition_point(|fill| fill.pixel <= pixel));
        rest = others;
        let scanned = page.map_or(&[][..], |page| page.column(px, py));
        if own.is_empty() && scanned.is_empty() {
            continue;
        }
        column.clear();
        column.extend(scanned.iter().map(|&span| (span, false)));
        // A pixel that is already full has no hole worth closing.
        for fill in own.iter().take(MOST_SPANS - scanned.len()) {
            let span = Span::new((fill.bottom - floor) as u32, (fill.top - floor) as u32, false);
            column.extend(span.map(|span| (span, true)));
        }
        column.sort_unstable_by_key(|(span, _)| span.bottom());
        let spans: Vec<Span> = column.iter().map(|(span, _)| *span).collect();
        let mask = column.iter().enumerate().fold(0, |mask, (at, (_, fill))| mask | u64::from(*fill) << (at & 63));
        let taken = builder.set_column(px, py, &spans) && inferred.push(px, py, mask);
        debug_assert!(taken, "fills are apart from what was scanned: {column:?}");
    }
    (builder.build(), inferred)
}

/// Returns the columns around `column`, row by row; `None` beyond the grid.
fn around(column: u64) -> [Option<u64>; 9] {
    let PageKey { tx, ty, .. } = PageKey::from_column(column, 0);
    std::array::from_fn(|at| {
        let (x, y) = (tx.checked_add(at as i32 % 3 - 1)?, ty.checked_add(at as i32 / 3 - 1)?);
        Some(PageKey { tx: x, ty: y, layer: 0 }.column())
    })
}
