//! Making all levels in the pass that writes, checks or copies an archive: pages come in the order of the archive and go out in
//! the order of each level.
//!
//! In: the coarse spans of each page. Out: pages of levels, by [`Give`]. The 16 columns of pages under one column of a level
//! follow each other in the order of pages, so a level holds one column of its own and gives it away when the next one begins.
//! Memory: 2 MiB of spans for each of at most 16 levels; what does not fit is sorted in a temporary file.

use super::coarse::{CoarseSpan, above, coarse, is_sparse, on_slices};
use crate::Result;
use crate::codec::LevelSteps;
use crate::disk::{Files, Temporary};
use crate::frame::{Frame, PageKey};
use crate::slice::{Page, PageBuilder, Span};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::{Path, PathBuf};

/// Greatest number of levels: then every tile index is 0 or −1.
pub const MAX_LEVELS: usize = 16;
/// Spans of a level held in memory.
const KEPT: usize = 1 << 17;
/// Spans of a sorted run read at once.
const PIECE: usize = 128;
const RECORD: usize = 12;
const OBSTACLE: u16 = 1 << 15;

/// Takes a page of the level with this number, less 1.
pub type Give<'a> = dyn FnMut(usize, PageKey, &Page) -> Result<()> + 'a;

/// The levels above pages that come in the order of the archive.
#[derive(Debug)]
pub struct LevelBuilder {
    levels: Vec<Growing>,
    /// Levels that the grid leaves room for.
    most: usize,
    /// How files are written, and beside what temporary ones lie; `None` for the system's folder for them.
    files: Files,
    beside: Option<PathBuf>,
    builder: PageBuilder,
    steps: LevelSteps,
}

/// A level and what it takes to tell whether there is one.
#[derive(Debug, Default)]
struct Growing {
    column: Option<u64>,
    spans: Sorter,
    /// Pages of the level below, and whether one lies beyond the eight around the origin, which no level can join.
    pages_below: u64,
    beyond_origin: bool,
    /// Pages that come before it is known that there is such a level: at most eight.
    held: Vec<(PageKey, Page)>,
}

impl Growing {
    fn exists(&self) -> bool {
        self.pages_below > 1 && self.beyond_origin
    }
}

impl LevelBuilder {
    /// No levels yet, over pages on the grid `frame`, with heights on `steps`; temporary files lie beside `target`, or where the system
    /// has them.
    pub fn new(frame: &Frame, steps: LevelSteps, files: &Files, target: Option<&Path>) -> Self {
        let most = (1..=MAX_LEVELS as u32).take_while(|&number| frame.coarser(number).is_some()).count();
        Self {
            levels: Vec::new(),
            most,
            files: files.clone(),
            beside: target.map(Path::to_path_buf),
            builder: PageBuilder::default(),
            steps,
        }
    }

    /// Adds the page `key` of the archive by its coarse spans. Keys ascend.
    pub fn add(&mut self, key: PageKey, spans: &[CoarseSpan], give: &mut Give<'_>) -> Result<()> {
        self.add_below(0, key, spans, give)
    }

    /// Gives the pages that are left, and returns the number of levels.
    pub fn finish(&mut self, give: &mut Give<'_>) -> Result<usize> {
        let mut at = 0;
        while self.levels.get(at).is_some_and(Growing::exists) {
            self.give_column(at, give)?;
            at += 1;
        }
        Ok(at)
    }

    /// Adds a page of the level below number `at`.
    fn add_below(&mut self, at: usize, key: PageKey, spans: &[CoarseSpan], give: &mut Give<'_>) -> Result<()> {
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
        if level.column.is_some_and(|last| last != column) {
            self.give_column(at, give)?;
        }
        let level = &mut self.levels[at];
        level.column = Some(column);
        for span in spans {
            level.spans.push(Record::new(key, span), &self.files, self.beside.as_deref())?;
        }
        Ok(())
    }

    /// Gives the pages of the column that level `at` holds.
    fn give_column(&mut self, at: usize, give: &mut Give<'_>) -> Result<()> {
        let level = &mut self.levels[at];
        let Some(column) = level.column.take() else { return Ok(()) };
        let mut spans = std::mem::take(&mut level.spans);
        let steps = self.steps;
        let builder = std::mem::take(&mut self.builder);
        let mut pages = Pages { builder, steps, layer: None, pixel: 0, below: 0, spans: Vec::new() };
        spans.drain(|record| match pages.take(record) {
            Some((layer, page)) => self.give_page(at, PageKey::from_column(column, layer), page, give),
            None => Ok(()),
        })?;
        let last = pages.finish();
        self.builder = pages.builder;
        // Its memory serves the next column.
        self.levels[at].spans = spans;
        last.map_or(Ok(()), |(layer, page)| self.give_page(at, PageKey::from_column(column, layer), page, give))
    }

    fn give_page(&mut self, at: usize, key: PageKey, page: Page, give: &mut Give<'_>) -> Result<()> {
        let spans = coarse(&page, self.steps);
        let level = &mut self.levels[at];
        if level.exists() {
            for (key, page) in level.held.drain(..) {
                give(at, key, &page)?;
            }
            give(at, key, &page)?;
        } else {
            level.held.push((key, page));
        }
        self.add_below(at + 1, key, &spans, give)
    }
}

/// A span of a level, in the order of layers, pixels and bottoms.
#[derive(Debug, Clone, Copy)]
struct Record {
    /// Layer (plus 2³¹) in the bits from 32 on, pixel in those from 16 on, bottom below.
    place: u64,
    /// Top, and above it whether the span is an obstacle.
    top: u16,
    /// Spans of the level below that became this one.
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

    fn to_bytes(self) -> [u8; RECORD] {
        let mut bytes = [0; RECORD];
        bytes[..8].copy_from_slice(&self.place.to_le_bytes());
        bytes[8..10].copy_from_slice(&self.top.to_le_bytes());
        bytes[10..].copy_from_slice(&self.joined.to_le_bytes());
        bytes
    }

    fn of_bytes(&[a, b, c, d, e, f, g, h, i, j, k, l]: &[u8; RECORD]) -> Self {
        let place = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        Self { place, top: u16::from_le_bytes([i, j]), joined: u16::from_le_bytes([k, l]) }
    }
}

/// Makes pages of records in their order.
struct Pages {
    builder: PageBuilder,
    steps: LevelSteps,
    layer: Option<i32>,
    pixel: u32,
    /// Spans of the level below that the page in work joins.
    below: u64,
    spans: Vec<Span>,
}

impl Pages {
    /// Takes a span; the page that ends before it.
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
        // Of two pages below, one above the other.
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

    /// The page in work.
    fn finish(&mut self) -> Option<(i32, Page)> {
        self.end_pixel();
        let layer = self.layer.take();
        let page = layer.map(|layer| (layer, self.builder.build()));
        let below = std::mem::take(&mut self.below);
        let page = page.map(|(layer, page)| match self.steps {
            LevelSteps::Thirds if is_sparse(page.span_count() as u64, below) => {
                (layer, on_slices(&page, &mut self.builder))
            }
            _ => (layer, page),
        });
        self.builder.clear();
        page
    }
}

/// Sorts records, in memory and beyond [`KEPT`] of them in a temporary file.
#[derive(Debug, Default)]
struct Sorter {
    records: Vec<Record>,
    file: Option<Temporary>,
    /// Where the sorted runs in the file end, in records.
    runs: Vec<u64>,
}

impl Sorter {
    fn push(&mut self, record: Record, files: &Files, beside: Option<&Path>) -> Result<()> {
        if self.records.len() == KEPT {
            let file = match &mut self.file {
                Some(file) => file,
                none => {
                    let systems = || std::env::temp_dir().join("levels");
                    none.insert(Temporary::beside(files, &beside.map_or_else(systems, Path::to_path_buf))?)
                }
            };
            self.records.sort_unstable_by_key(|record| record.place);
            let start = self.runs.last().copied().unwrap_or(0);
            for (piece, records) in (0..).zip(self.records.chunks(1 << 14)) {
                let bytes: Vec<u8> = records.iter().flat_map(|record| record.to_bytes()).collect();
                file.write_at((start + (piece << 14)) * RECORD as u64, &bytes)?;
            }
            self.runs.push(start + KEPT as u64);
            self.records.clear();
        }
        self.records.push(record);
        Ok(())
    }

    /// Gives all records in order and forgets them.
    fn drain(&mut self, mut give: impl FnMut(Record) -> Result<()>) -> Result<()> {
        self.records.sort_unstable_by_key(|record| record.place);
        let Some(file) = self.file.take() else {
            return self.records.drain(..).try_for_each(give);
        };
        let starts = [0].into_iter().chain(self.runs.iter().copied());
        let mut runs: Vec<Run<'_>> =
            starts.zip(&self.runs).map(|(at, &end)| Run { file: &file, at, end, read: Vec::new() }).collect();
        let mut heads = BinaryHeap::new();
        for (number, run) in runs.iter_mut().enumerate() {
            heads.extend(run.next()?.map(|record| Reverse((record.place, number, record.top, record.joined))));
        }
        let mut kept = self.records.drain(..).peekable();
        while let Some(&Reverse((place, number, top, joined))) = heads.peek() {
            if let Some(record) = kept.next_if(|record| record.place < place) {
                give(record)?;
                continue;
            }
            give(Record { place, top, joined })?;
            heads.pop();
            heads.extend(runs[number].next()?.map(|record| Reverse((record.place, number, record.top, record.joined))));
        }
        kept.try_for_each(give)?;
        self.runs.clear();
        Ok(())
    }
}

/// A sorted run in the file.
struct Run<'a> {
    file: &'a Temporary,
    /// The next record that is not read, and the end.
    at: u64,
    end: u64,
    /// Records read, last first.
    read: Vec<Record>,
}

impl Run<'_> {
    fn next(&mut self) -> Result<Option<Record>> {
        if self.read.is_empty() && self.at < self.end {
            let count = (self.end - self.at).min(PIECE as u64);
            let mut bytes = vec![0; count as usize * RECORD];
            self.file.read_at(self.at * RECORD as u64, &mut bytes)?;
            self.read.extend(bytes.as_chunks().0.iter().rev().map(Record::of_bytes));
            self.at += count;
        }
        Ok(self.read.pop())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_in_order_from_memory_and_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut sorter = Sorter::default();
        for count in [5, KEPT, KEPT + 1, 3 * KEPT + 77, 9] {
            let record = |n: usize| {
                let place = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                Record { place, top: (place >> 7) as u16, joined: (place >> 9) as u16 }
            };
            for n in 0..count {
                sorter.push(record(n), &Files::current(), Some(&folder.path().join("a.slices"))).unwrap();
            }
            let mut found = Vec::new();
            sorter
                .drain(|record| {
                    found.push((record.place, record.top, record.joined));
                    Ok(())
                })
                .unwrap();
            let mut expected: Vec<_> =
                (0..count).map(record).map(|record| (record.place, record.top, record.joined)).collect();
            expected.sort_unstable();
            assert!(found == expected, "{count} records");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}
