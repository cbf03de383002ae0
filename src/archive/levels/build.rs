//! Builds all levels in the pass that writes, checks or copies an archive. Pages arrive in the order of the archive and
//! leave in the order of each level.
//!
//! Takes the coarse spans and colours of each page; passes pages of levels and sums of their colours to [`Give`]. In
//! page order, the 16 columns of pages under one column of a level are adjacent, so each level holds one column and
//! emits it when the next one begins.
//!
//! Memory: 2 MiB of spans for each of at most 16 levels, and 1.3 MiB of colours; the rest is sorted in temporary files.

use super::coarse::{CoarseSpan, above, coarse, is_sparse, on_slices};
use super::level_colours::{CoarseColour, ColourRecord, VoxelSum, coarser};
use crate::Result;
use crate::colour::ColourSum;
use crate::disk::{Files, Temporary};
use crate::frame::{Frame, PageKey};
use crate::page::{Page, PageBuilder, Span};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::vec::Drain;

/// Most levels; beyond them every tile index is 0 or −1.
pub const MAX_LEVELS: usize = 16;
/// Records of a sorted run read at once, and written at once.
const PIECE: usize = 128;
const PIECE_WRITTEN: usize = 1 << 14;
const OBSTACLE: u16 = 1 << 15;

/// Receives a page: the level number minus 1, the key, the page, and the colour sums of its voxels in order.
pub type Give<'a> = dyn FnMut(usize, PageKey, &Page, &[VoxelSum]) -> Result<()> + 'a;

/// Builds the levels above pages that arrive in the order of the archive.
#[derive(Debug)]
pub struct LevelBuilder {
    levels: Vec<Growing>,
    /// Levels that the grid allows.
    most: usize,
    /// How files are written, and the target that temporary files lie beside; `None` for the system's temporary folder.
    files: Files,
    beside: Option<PathBuf>,
    builder: PageBuilder,
}

/// A level under construction, with what decides whether it exists.
#[derive(Debug, Default)]
struct Growing {
    column: Option<u64>,
    spans: Sorter<Record>,
    colours: Sorter<ColourRecord>,
    /// Pages of the level below, and whether one lies beyond the eight around the origin, which no level can join.
    pages_below: u64,
    beyond_origin: bool,
    /// Pages held back until the level is known to exist: at most eight.
    held: Vec<(PageKey, Page, Vec<VoxelSum>)>,
}

impl Growing {
    fn exists(&self) -> bool {
        self.pages_below > 1 && self.beyond_origin
    }
}

impl LevelBuilder {
    /// Creates a builder without levels over pages on the grid `frame`. Temporary files lie beside `target`, or in the
    /// system's temporary folder.
    pub fn new(frame: &Frame, files: &Files, target: Option<&Path>) -> Self {
        let most = (1..=MAX_LEVELS as u32).take_while(|&number| frame.coarser(number).is_some()).count();
        Self {
            levels: Vec::new(),
            most,
            files: files.clone(),
            beside: target.map(Path::to_path_buf),
            builder: PageBuilder::default(),
        }
    }

    /// Adds page `key` of the archive by its coarse spans and colours. Keys must ascend.
    pub fn add(
        &mut self,
        key: PageKey,
        spans: &[CoarseSpan],
        colours: &[CoarseColour],
        give: &mut Give<'_>,
    ) -> Result<()> {
        self.add_below(0, key, spans, &mut colours.iter().map(CoarseColour::place_and_sum), give)
    }

    /// Emits the remaining pages and returns the number of levels.
    pub fn finish(&mut self, give: &mut Give<'_>) -> Result<usize> {
        let mut at = 0;
        while let Some(level) = self.levels.get_mut(at).filter(|level| level.exists())
            && let Some(column) = level.column.take()
        {
            self.give_column(at, column, give)?;
            at += 1;
        }
        Ok(at)
    }

    /// Adds a page of the level below level index `at`.
    fn add_below(
        &mut self,
        at: usize,
        key: PageKey,
        spans: &[CoarseSpan],
        colours: &mut dyn Iterator<Item = (u8, u8, ColourSum)>,
        give: &mut Give<'_>,
    ) -> Result<()> {
        if at == self.most {
            return Ok(());
        }
        if at == self.levels.len() {
            self.levels.push(Growing::default());
        }
        let column = above(key).column();
        let level = &mut self.levels[at];
        level.pages_below += 1;
        level.beyond_origin |= [key.tx, key.ty, key.layer].iter().any(|index| ![0, -1].contains(index));
        if let Some(last) = level.column.replace(column).filter(|&last| last != column) {
            self.give_column(at, last, give)?;
        }
        let level = &mut self.levels[at];
        for span in spans {
            level.spans.push(Record::new(key, span), &self.files, self.beside.as_deref())?;
        }
        for colour in colours {
            level.colours.push(ColourRecord::new(key, colour), &self.files, self.beside.as_deref())?;
        }
        Ok(())
    }

    /// Emits the pages of `column`, whose spans and colours level index `at` holds.
    fn give_column(&mut self, at: usize, column: u64, give: &mut Give<'_>) -> Result<()> {
        let level = &mut self.levels[at];
        let (mut spans, mut colours) = (std::mem::take(&mut level.spans), std::mem::take(&mut level.colours));
        let builder = std::mem::take(&mut self.builder);
        let mut pages = Pages { builder, layer: None, pixel: 0, below: 0, spans: Vec::new() };
        let mut sums = LayerSums { sorted: colours.sorted()?, next: None };
        let mut sorted = spans.sorted()?;
        while let Some(record) = sorted.next()? {
            if let Some((layer, page)) = pages.take(record) {
                self.give_page(at, PageKey::from_column(column, layer), page, sums.of(layer)?, give)?;
            }
        }
        let last = pages.finish();
        self.builder = pages.builder;
        if let Some((layer, page)) = last {
            self.give_page(at, PageKey::from_column(column, layer), page, sums.of(layer)?, give)?;
        }
        // Reuse the memory for the next column.
        drop((sorted, sums));
        (self.levels[at].spans, self.levels[at].colours) = (spans, colours);
        Ok(())
    }

    fn give_page(
        &mut self,
        at: usize,
        key: PageKey,
        page: Page,
        sums: Vec<VoxelSum>,
        give: &mut Give<'_>,
    ) -> Result<()> {
        let (spans, colours) = (coarse(&page), coarser(&sums));
        let level = &mut self.levels[at];
        if level.exists() {
            for (key, page, sums) in level.held.drain(..) {
                give(at, key, &page, &sums)?;
            }
            give(at, key, &page, &sums)?;
        } else {
            level.held.push((key, page, sums));
        }
        self.add_below(at + 1, key, &spans, &mut colours.into_iter(), give)
    }
}

/// A span of a level; records sort by layer, pixel and bottom.
#[derive(Debug, Clone, Copy, Default)]
struct Record {
    /// Layer (plus 2³¹) from bit 32, pixel from bit 16, bottom in the lowest 16 bits.
    place: u64,
    /// Top, with [`OBSTACLE`] set for an obstacle.
    top: u16,
    /// Spans of the level below that were merged into this one.
    joined: u16,
}

impl Record {
    fn new(below: PageKey, span: &CoarseSpan) -> Self {
        let (pixel, bottom, top) = span.place(below);
        let layer = above(below).layer as u32 ^ 1 << 31;
        let place = u64::from(layer) << 32 | u64::from(pixel) << 16 | u64::from(bottom);
        Self { place, top: top as u16 | if span.is_obstacle() { OBSTACLE } else { 0 }, joined: span.joined() }
    }

    fn layer(&self) -> i32 {
        ((self.place >> 32) as u32 ^ 1 << 31) as i32
    }

    fn pixel(&self) -> u32 {
        (self.place >> 16) as u32 & 0xFFFF
    }
}

impl Sortable for Record {
    const KEPT: usize = 1 << 17;
    const LEN: usize = 12;

    fn place(&self) -> u64 {
        self.place
    }

    fn put(&self, out: &mut Vec<u8>) {
        out.extend(self.place.to_le_bytes());
        out.extend(self.top.to_le_bytes());
        out.extend(self.joined.to_le_bytes());
    }

    fn of(bytes: &[u8]) -> Self {
        let Ok([a, b, c, d, e, f, g, h, i, j, k, l]) = <[u8; Self::LEN]>::try_from(bytes) else {
            return Self::default();
        };
        let place = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        Self { place, top: u16::from_le_bytes([i, j]), joined: u16::from_le_bytes([k, l]) }
    }
}

/// Colour sums of a column, read layer by layer.
struct LayerSums<'a> {
    sorted: Sorted<'a, ColourRecord>,
    next: Option<ColourRecord>,
}

impl LayerSums<'_> {
    /// Returns the sums of `layer`. Layers must ascend.
    fn of(&mut self, layer: i32) -> Result<Vec<VoxelSum>> {
        let mut found = Vec::new();
        loop {
            let next = match self.next.take() {
                Some(next) => next,
                None => match self.sorted.next()? {
                    Some(next) => next,
                    None => return Ok(found),
                },
            };
            if next.layer() > layer {
                self.next = Some(next);
                return Ok(found);
            }
            found.push(next.voxel());
        }
    }
}

/// Builds pages from records in order.
struct Pages {
    builder: PageBuilder,
    layer: Option<i32>,
    pixel: u32,
    /// Spans of the level below that the current page merges.
    below: u64,
    spans: Vec<Span>,
}

impl Pages {
    /// Adds a span, and returns the page that it ends, if any.
    fn take(&mut self, record: Record) -> Option<(i32, Page)> {
        let (layer, pixel) = (record.layer(), record.pixel());
        let ended = if self.layer != Some(layer) { self.finish() } else { None };
        if pixel != self.pixel {
            self.end_pixel();
        }
        (self.layer, self.pixel) = (Some(layer), pixel);
        self.below += u64::from(record.joined);
        let (bottom, top) = (record.place as u32 & 0xFFFF, u32::from(record.top & !OBSTACLE));
        let obstacle = record.top & OBSTACLE != 0;
        // Merge spans that meet where two pages below lie one above the other.
        let span = match self.spans.last().copied().filter(|last| last.top() == bottom) {
            Some(last) => {
                self.spans.pop();
                Span::new(last.bottom(), top, obstacle || last.is_obstacle())
            }
            None => Span::new(bottom, top, obstacle),
        };
        self.spans.extend(span);
        ended
    }

    fn end_pixel(&mut self) {
        if !self.spans.is_empty() {
            let taken = self.builder.set_column(self.pixel % 64, self.pixel / 64, &self.spans);
            debug_assert!(taken, "spans of a level are apart");
            self.spans.clear();
        }
    }

    /// Returns the current page, if it has spans.
    fn finish(&mut self) -> Option<(i32, Page)> {
        self.end_pixel();
        let layer = self.layer.take();
        let page = layer.map(|layer| (layer, self.builder.build()));
        let below = std::mem::take(&mut self.below);
        let page = page.map(|(layer, page)| {
            let is_sparse = is_sparse(page.span_count() as u64, below);
            (layer, if is_sparse { on_slices(&page, &mut self.builder) } else { page })
        });
        self.builder.clear();
        page
    }
}

/// Record sorted by its place, which is unique.
pub trait Sortable: Copy {
    /// Records kept in memory.
    const KEPT: usize;
    /// Bytes of a record.
    const LEN: usize;

    fn place(&self) -> u64;

    /// Appends the record's bytes.
    fn put(&self, out: &mut Vec<u8>);

    /// Decodes a record from its bytes.
    fn of(bytes: &[u8]) -> Self;
}

/// Sorts records in memory, and in a temporary file beyond [`Sortable::KEPT`] of them.
#[derive(Debug)]
struct Sorter<R> {
    records: Vec<R>,
    file: Option<Temporary>,
    /// Ends of the sorted runs in the file (records).
    runs: Vec<u64>,
}

impl<R> Default for Sorter<R> {
    fn default() -> Self {
        Self { records: Vec::new(), file: None, runs: Vec::new() }
    }
}

impl<R: Sortable> Sorter<R> {
    fn push(&mut self, record: R, files: &Files, beside: Option<&Path>) -> Result<()> {
        if self.records.len() == R::KEPT {
            let file = match &mut self.file {
                Some(file) => file,
                none => {
                    let systems = || std::env::temp_dir().join("levels");
                    none.insert(Temporary::beside(files, &beside.map_or_else(systems, Path::to_path_buf))?)
                }
            };
            self.records.sort_unstable_by_key(R::place);
            let start = self.runs.last().copied().unwrap_or(0);
            let mut bytes = Vec::with_capacity(PIECE_WRITTEN * R::LEN);
            for (piece, records) in (0..).zip(self.records.chunks(PIECE_WRITTEN)) {
                bytes.clear();
                records.iter().for_each(|record| record.put(&mut bytes));
                file.write_at((start + piece * PIECE_WRITTEN as u64) * R::LEN as u64, &bytes)?;
            }
            self.runs.push(start + R::KEPT as u64);
            self.records.clear();
        }
        self.records.push(record);
        Ok(())
    }

    /// Returns all records in order and leaves the sorter empty.
    fn sorted(&mut self) -> Result<Sorted<'_, R>> {
        self.records.sort_unstable_by_key(R::place);
        let file = self.file.take();
        let ends = std::mem::take(&mut self.runs);
        let starts = [0].into_iter().chain(ends.iter().copied());
        let mut runs: Vec<Run<R>> = starts.zip(&ends).map(|(at, &end)| Run { at, end, read: Vec::new() }).collect();
        let mut heads = BinaryHeap::new();
        if let Some(file) = &file {
            for (number, run) in runs.iter_mut().enumerate() {
                heads.extend(run.peek(file)?.map(|place| Reverse((place, number))));
            }
        }
        Ok(Sorted { kept: self.records.drain(..).peekable(), file, runs, heads })
    }
}

/// Iterates over sorted records.
struct Sorted<'a, R> {
    kept: Peekable<Drain<'a, R>>,
    file: Option<Temporary>,
    runs: Vec<Run<R>>,
    /// Smallest place of each run that has records left.
    heads: BinaryHeap<Reverse<(u64, usize)>>,
}

impl<R: Sortable> Sorted<'_, R> {
    fn next(&mut self) -> Result<Option<R>> {
        let (Some(file), Some(&Reverse((place, number)))) = (&self.file, self.heads.peek()) else {
            return Ok(self.kept.next());
        };
        if let Some(record) = self.kept.next_if(|record| record.place() < place) {
            return Ok(Some(record));
        }
        self.heads.pop();
        let run = &mut self.runs[number];
        let record = run.read.pop();
        self.heads.extend(run.peek(file)?.map(|place| Reverse((place, number))));
        Ok(record)
    }
}

/// A sorted run in the file.
struct Run<R> {
    /// Next record to read, and the end (records).
    at: u64,
    end: u64,
    /// Records already read, last first.
    read: Vec<R>,
}

impl<R: Sortable> Run<R> {
    /// Returns the place of the next record, reading more if necessary.
    fn peek(&mut self, file: &Temporary) -> Result<Option<u64>> {
        if self.read.is_empty() && self.at < self.end {
            let count = (self.end - self.at).min(PIECE as u64);
            let mut bytes = vec![0; count as usize * R::LEN];
            file.read_at(self.at * R::LEN as u64, &mut bytes)?;
            self.read.extend(bytes.chunks_exact(R::LEN).rev().map(R::of));
            self.at += count;
        }
        Ok(self.read.last().map(R::place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_in_order_from_memory_and_file() {
        let span = |n: usize| {
            let place = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            Record { place, top: (place >> 7) as u16, joined: (place >> 9) as u16 }
        };
        sorted_come_back(span, |record| (record.place, record.top, record.joined));
        let colour = |n: usize| {
            let word = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let (below, sum) = (PageKey { tx: 0, ty: 0, layer: word as i32 >> 4 }, [word, word >> 3, word >> 5]);
            ColourRecord::new(below, ((word >> 33) as u8, (word >> 41) as u8 & 15, ColourSum { n: word >> 1, sum }))
        };
        sorted_come_back(colour, |record| (record.place(), record.voxel().sum.n, record.voxel().sum.sum));
    }

    fn sorted_come_back<R: Sortable, T: Ord>(record: impl Fn(usize) -> R, shown: impl Fn(&R) -> T) {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let (mut sorter, counts) = (Sorter::default(), [5, R::KEPT, R::KEPT + 1, 3 * R::KEPT + 77, 9]);
        // In the end in the system's temporary folder.
        for (count, beside) in counts.map(|count| (count, Some(&*target))).into_iter().chain([(R::KEPT + 1, None)]) {
            for n in 0..count {
                sorter.push(record(n), &Files::current(), beside).unwrap();
            }
            let (mut found, mut sorted) = (Vec::new(), sorter.sorted().unwrap());
            while let Some(record) = sorted.next().unwrap() {
                found.push(record);
            }
            drop(sorted);
            assert!(found.is_sorted_by_key(R::place), "{count} records");
            let mut found: Vec<T> = found.iter().map(&shown).collect();
            let mut expected: Vec<T> = (0..count).map(|n| shown(&record(n))).collect();
            found.sort_unstable();
            expected.sort_unstable();
            assert!(found == expected, "{count} records");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}
