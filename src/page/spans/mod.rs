//! A page in memory: one tile column (64 × 64 pixels) of 64 slices, as spans per pixel below a summary per block.
//!
//! Layout, outermost first. Blocks are 8 × 8 pixels, numbered in row order; only occupied ones are stored.
//!
//! 1. Per slice, a mask of the blocks occupied in it: one pass over the slices that a shape spans selects the few
//!    blocks that are relevant.
//! 2. Per block, a record of 48 bytes: the four lowest *unions* of its floor spans and of its obstacle spans, the mask
//!    of occupied pixels, and where its rows begin.
//! 3. Per block, the unions beyond four, then its spans in row order.
//!
//! For a shape of constant height that covers all occupied pixels of a block, the unions alone give an exact answer: a
//! union meets a height interval if and only if the span of some pixel does. If the shape cuts a block, the spans of
//! the rows that it covers are contiguous and each stores its pixel's `x % 8`, so one loop without branches tests them
//! all (see [`Span`]).

mod builder;
mod unions;

use super::span::Span;
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA, TILE_PIXELS};

pub use builder::PageBuilder;
pub use builder::RowBuilder;

/// Edge of a block in pixels; its pixels are the bits of one `u64`.
pub const BLOCK_PIXELS: u32 = 8;
const BLOCKS: usize = 64;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Block {
    /// The lowest unions, padded with [`Span::NEVER`].
    unions: [Span; 4],
    /// Occupied pixels, bit `8·(y % 8) + x % 8`.
    pixels: u64,
    /// Index in the page's spans of the block's further unions, which its spans follow.
    first: u32,
    /// Where the spans of each row begin, counted from `first`. The unions beyond four come before row 0, padded to a
    /// multiple of four.
    rows: [u16; 8],
}

impl Block {
    fn without_matter(first: usize) -> Self {
        Self { unions: [Span::NEVER; 4], pixels: 0, first: first as u32, rows: [0; 8] }
    }
}

/// Spans of one tile column of 64 slices. Immutable; the module text describes the layout.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Page {
    /// Occupied slices.
    slices: u64,
    /// Index of each block in the arrays below; empty blocks share the sentinel at the end.
    places: [u8; BLOCKS],
    /// Occupied blocks (bit `8·by + bx`) of each slice from the lowest occupied one to the highest.
    slice_blocks: Box<[u64]>,
    blocks: Box<[Block]>,
    spans: Box<[Span]>,
}

/// One block of a page.
#[derive(Clone, Copy)]
pub struct BlockView<'a> {
    page: &'a Page,
    place: usize,
}

impl<'a> BlockView<'a> {
    /// Returns the slices of the page in which a pixel of the block is occupied, as a mask.
    pub fn slices(self) -> u64 {
        let number = self.page.places.iter().position(|&place| usize::from(place) == self.place).unwrap_or(0);
        let with_matter = self.page.slice_blocks.iter().rev();
        let slices = with_matter.fold(0, |slices, blocks| slices << 1 | blocks >> number & 1);
        slices << self.page.slices.trailing_zeros().min(63)
    }

    /// Returns the occupied pixels of the block: bit `8·(y % 8) + x % 8`.
    #[inline]
    pub fn pixels(self) -> u64 {
        self.page.blocks[self.place].pixels
    }

    /// Iterates over the unions of the block's floor spans and those of its obstacle spans: disjoint within a class,
    /// lowest bottom first.
    pub fn unions(self) -> impl Iterator<Item = Span> {
        let (first, more) = self.union_quads();
        first.iter().chain(more.as_flattened()).copied().take_while(|span| *span != Span::NEVER)
    }

    /// Returns the unions in groups of four, padded with spans that meet nothing.
    #[inline]
    pub(crate) fn union_quads(self) -> (&'a [Span; 4], &'a [[Span; 4]]) {
        let block = &self.page.blocks[self.place];
        let first = block.first as usize;
        let more = &self.page.spans[first..first + block.rows[0] as usize];
        (&block.unions, more.as_chunks().0)
    }

    /// Returns the spans of the rows `y0..=y1` [0..8]: row by row, within a row pixel by pixel, lowest first.
    #[inline]
    pub(crate) fn rows(self, y0: u32, y1: u32) -> &'a [Span] {
        let block = &self.page.blocks[self.place];
        if block.pixels == 0 {
            return &[];
        }
        let first = block.first as usize + block.rows[y0 as usize & 7] as usize;
        let end = if y1 < 7 {
            block.first as usize + block.rows[y1 as usize + 1] as usize
        } else {
            self.page.blocks[self.place + 1].first as usize
        };
        &self.page.spans[first..end]
    }

    /// Returns the row of span `number`, counted from the first span of row `y0`.
    #[inline]
    pub(crate) fn row_of(self, y0: u32, number: usize) -> u32 {
        let begins = &self.page.blocks[self.place].rows;
        let number = begins[y0 as usize & 7] + number as u16;
        begins.iter().map(|&begin| u32::from(begin <= number)).sum::<u32>() - 1
    }

    /// Returns the rest of the row of pixel `bit`, beginning with the first span of that pixel whose top is not below
    /// `low`, or where that span would be.
    #[inline]
    pub(crate) fn row_from(self, bit: u32, low: u32) -> &'a [Span] {
        let row = self.rows(bit >> 3, bit >> 3);
        &row[row.partition_point(|span| span.is_before(bit & 7, low))..]
    }

    /// Returns the spans of the pixel with bit number `bit` in [`pixels`](Self::pixels), lowest first; empty if it is
    /// not occupied.
    #[inline]
    pub fn column(self, bit: u32) -> &'a [Span] {
        if self.pixels() >> bit & 1 == 0 {
            return &[];
        }
        let (x, y) = (bit & 7, bit >> 3);
        let row = self.rows(y, y);
        // Each occupied pixel before this one has at least one span.
        let before = (self.pixels() >> (8 * y) & ((1 << x) - 1)).count_ones() as usize;
        let row = row.get(before..).unwrap_or(&[]);
        let first = row.iter().position(|span| span.lane() >= x).unwrap_or(row.len());
        let count = row[first..].iter().position(|span| span.lane() > x).unwrap_or(row.len() - first);
        &row[first..first + count]
    }
}

impl Page {
    /// Returns the block at block coordinates `bx`, `by` [0..8].
    #[inline]
    pub fn block(&self, bx: u32, by: u32) -> BlockView<'_> {
        debug_assert!(bx < 8 && by < 8);
        self.block_at((by & 7) << 3 | bx & 7)
    }

    /// Returns the block with number `8·by + bx`.
    #[inline]
    pub(crate) fn block_at(&self, number: u32) -> BlockView<'_> {
        BlockView { page: self, place: self.places[(number & 63) as usize] as usize }
    }

    /// Returns the blocks (bit `8·by + bx`) that are occupied in any of the slices `first..=last` [0..64].
    #[inline]
    pub(crate) fn blocks_in(&self, first: u32, last: u32) -> u64 {
        let lowest = self.slices.trailing_zeros();
        let below = first.saturating_sub(lowest) as usize;
        let upto = (last + 1).saturating_sub(lowest) as usize;
        let slices = self.slice_blocks.get(below..upto.min(self.slice_blocks.len())).unwrap_or(&[]);
        let quads = slices.as_chunks::<4>().0;
        let or = |all: [u64; 4], quad: &[u64; 4]| [0, 1, 2, 3].map(|n| all[n] | quad[n]);
        let mut all = quads.iter().fold([0; 4], or);
        match slices.last_chunk() {
            Some(last) => all = or(all, last),
            // At most three slices.
            None => {
                let at = |n: usize| slices.get(n).copied().unwrap_or(0);
                all[0] = at(0) | at(slices.len() / 2) | at(slices.len().wrapping_sub(1));
            }
        }
        all[0] | all[1] | all[2] | all[3]
    }

    /// Returns the spans of pixel (`px`, `py`) [0..64], lowest first.
    #[inline]
    pub fn column(&self, px: u32, py: u32) -> &[Span] {
        self.block(px >> 3, py >> 3).column((py & 7) << 3 | px & 7)
    }

    /// Iterates over all occupied pixels in row order (y, then x): `(px, py, spans)`.
    pub fn columns(&self) -> impl Iterator<Item = (u32, u32, &[Span])> {
        (0..TILE_PIXELS as u32).flat_map(move |py| {
            (0..TILE_PIXELS as u32 / BLOCK_PIXELS).flat_map(move |bx| {
                let row = self.block(bx, py >> 3).rows(py & 7, py & 7);
                row.chunk_by(|a, b| a.lane() == b.lane()).map(move |spans| (bx << 3 | spans[0].lane(), py, spans))
            })
        })
    }

    /// Returns the greatest common divisor of a slice and all heights (quanta). In a page of an overview level, whose
    /// heights are rounded, about a third of a slice, and in sparse ones a slice.
    pub(crate) fn height_unit(&self) -> u32 {
        let mut unit = SLICE_QUANTA as u32;
        for (.., column) in self.columns() {
            for mut height in column.iter().flat_map(|span| [span.bottom(), span.top()]) {
                while height != 0 {
                    (unit, height) = (height, unit % height);
                }
            }
            if unit == 1 {
                break;
            }
        }
        unit
    }

    /// Returns the occupied slices of the page as a mask.
    pub fn slices(&self) -> u64 {
        self.slices
    }

    /// Returns the number of spans.
    pub fn span_count(&self) -> usize {
        let further_unions = self.blocks.iter().map(|block| block.rows[0] as usize).sum::<usize>();
        self.spans.len() - further_unions
    }

    /// Iterates over the occupied blocks.
    fn blocks_with_matter(&self) -> impl Iterator<Item = BlockView<'_>> {
        (0..self.blocks.len() - 1).map(|place| BlockView { page: self, place })
    }

    /// Iterates over all spans, block by block.
    pub(crate) fn spans_of_blocks(&self) -> impl Iterator<Item = &[Span]> {
        self.blocks_with_matter().map(|block| block.rows(0, BLOCK_PIXELS - 1))
    }

    /// Returns the number of occupied voxels, and how many of them hold obstacle.
    pub fn voxel_counts(&self) -> (u64, u64) {
        let mut counts = (0, 0);
        for (block, y) in self.blocks_with_matter().flat_map(|block| (0..BLOCK_PIXELS).map(move |y| (block, y))) {
            // Occupied slices of the current pixel, and those that hold obstacle.
            let (mut lane, mut slices, mut obstacles) = (0, 0u64, 0u64);
            let mut count = |slices: u64, obstacles: u64| {
                counts.0 += u64::from(slices.count_ones());
                counts.1 += u64::from(obstacles.count_ones());
            };
            for span in block.rows(y, y) {
                if span.lane() != lane {
                    count(slices, obstacles);
                    (lane, slices, obstacles) = (span.lane(), 0, 0);
                }
                let mask = span.slice_mask();
                slices |= mask;
                obstacles |= if span.is_obstacle() { mask } else { 0 };
            }
            count(slices, obstacles);
        }
        counts
    }

    /// Returns the smallest box around all spans, or `None` for an empty page. Cost: one pass over the blocks.
    pub fn bounds(&self) -> Option<PageBounds> {
        let (mut x, mut y, mut bottom, mut top) = (0u64, 0u64, u32::MAX, 0);
        for number in 0..BLOCKS as u32 {
            let block = self.block_at(number);
            for (row, pixels) in (0..).zip(block.pixels().to_le_bytes()) {
                x |= u64::from(pixels) << (8 * (number & 7));
                y |= u64::from(pixels != 0) << (8 * (number >> 3) + row);
            }
            for union in block.unions() {
                (bottom, top) = (bottom.min(union.bottom()), top.max(union.top()));
            }
        }
        let ends = |pixels: u64| (pixels.trailing_zeros(), 63 - pixels.leading_zeros());
        (x != 0).then(|| {
            let (x, y) = (ends(x), ends(y));
            PageBounds { min: [x.0, y.0, bottom], max: [x.1, y.1, top] }
        })
    }

    /// Returns the memory of the page (bytes).
    pub fn weight_bytes(&self) -> usize {
        self.size().weight_bytes(self.slices)
    }

    /// Returns the size of the page.
    pub fn size(&self) -> PageSize {
        PageSize((self.blocks.len() as u32 - 1) << PageSize::SHIFT | self.spans.len() as u32)
    }
}

/// Smallest box around the spans of a page, both ends inclusive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PageBounds {
    /// Least pixel x and y [0..64] and lowest bottom (quanta above the page's floor).
    pub min: [u32; 3],
    /// Greatest pixel x and y [0..64] and highest top (quanta above the page's floor).
    pub max: [u32; 3],
}

impl PageBounds {
    /// Bounds of a page in which every pixel holds `span` and nothing else.
    pub fn of_uniform(span: Span) -> Self {
        let last = TILE_PIXELS as u32 - 1;
        Self { min: [0, 0, span.bottom()], max: [last, last, span.top()] }
    }
}

/// Blocks and words of a page. Together with the mask of slices it gives the page's memory, and it is small enough for
/// a directory entry.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct PageSize(u32);

impl PageSize {
    const SHIFT: u32 = 24;
    /// Most words of a page: its spans and an equal number of unions, padded in each block.
    pub const MAX_WORDS: u32 = 2 * 64 * 64 * 64 + 64 * 3;
    /// Size of a page in which every pixel holds the same single span.
    pub const UNIFORM: Self = Self((64 << Self::SHIFT) | (64 * 64));

    /// Returns the size of a page with `blocks` blocks and `words` words; `None` unless there are 1 to 64 blocks and
    /// from one word per block to [`MAX_WORDS`](Self::MAX_WORDS) words.
    pub fn new(blocks: u32, words: u32) -> Option<Self> {
        let inside = (1..=64).contains(&blocks) && (blocks..=Self::MAX_WORDS).contains(&words);
        inside.then_some(Self(blocks << Self::SHIFT | words))
    }

    /// Returns the number of occupied blocks of 8 × 8 pixels.
    pub fn blocks(self) -> u32 {
        self.0 >> Self::SHIFT
    }

    /// Returns the number of words: the spans, plus each block's unions beyond four, rounded up to a multiple of four.
    pub fn words(self) -> u32 {
        self.0 & ((1 << Self::SHIFT) - 1)
    }

    /// Returns the exact [`Page::weight_bytes`] of a page of this size in which `slices` are occupied (bytes).
    pub fn weight_bytes(self, slices: u64) -> usize {
        // One mask of blocks per slice from the lowest occupied one to the highest.
        let height = (64 - slices.leading_zeros()).saturating_sub(slices.trailing_zeros()) as usize;
        size_of::<Page>()
            + size_of::<u64>() * height
            + size_of::<Block>() * (self.blocks() as usize + 1)
            + size_of::<Span>() * self.words() as usize
    }
}

const _: () = assert!(PAGE_QUANTA < 1 << 14 && BLOCKS * 64 == (TILE_PIXELS * TILE_PIXELS) as usize);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Columns as a builder accepts them: one span per chosen slice, classes at random.
    fn columns() -> impl Strategy<Value = BTreeMap<(u32, u32), Vec<Span>>> {
        let span = (0u32..64, 0u32..250, 0u32..4, any::<bool>());
        let column = proptest::collection::vec(span, 1..6).prop_map(|parts| {
            let by_slice: BTreeMap<u32, _> = parts.into_iter().map(|(k, b, h, o)| (k, (b, h, o))).collect();
            by_slice.into_iter().filter_map(|(k, (b, h, o))| Span::new(k * 255 + b, k * 255 + b + h, o)).collect()
        });
        proptest::collection::btree_map((0u32..64, 0u32..64), column, 0..200)
    }

    fn build(columns: &BTreeMap<(u32, u32), Vec<Span>>) -> Page {
        let mut builder = PageBuilder::default();
        for (&(px, py), spans) in columns {
            assert!(builder.set_column(px, py, spans));
        }
        builder.build()
    }

    proptest! {
        #[test]
        fn gives_back_what_was_set(columns in columns()) {
            let page = build(&columns);
            let owned = size_of_val::<[u64]>(&page.slice_blocks)
                + size_of_val::<[Block]>(&page.blocks)
                + size_of_val::<[Span]>(&page.spans);
            prop_assert_eq!(page.weight_bytes(), size_of::<Page>() + owned);
            prop_assert!(page.size().words() <= PageSize::MAX_WORDS);
            let slices = columns.values().flatten().fold(0, |mask, span| mask | span.slice_mask());
            prop_assert_eq!(page.slices(), slices);
            for py in 0..64 {
                for px in 0..64 {
                    let expected = columns.get(&(px, py)).map_or(&[][..], |spans| spans);
                    prop_assert_eq!(page.column(px, py), expected);
                }
            }
            let spans = || columns.iter().flat_map(|(&at, spans)| spans.iter().map(move |span| (at, span)));
            let bounds = spans().next().map(|_| PageBounds {
                min: [spans().map(|(at, _)| at.0).min(), spans().map(|(at, _)| at.1).min(), spans().map(|(_, s)| s.bottom()).min()]
                    .map(Option::unwrap),
                max: [spans().map(|(at, _)| at.0).max(), spans().map(|(at, _)| at.1).max(), spans().map(|(_, s)| s.top()).max()]
                    .map(Option::unwrap),
            });
            prop_assert_eq!(page.bounds(), bounds);
            for (bx, by) in (0..64).map(|n| (n % 8, n / 8)) {
                let spans = (0..64).flat_map(|bit| page.block(bx, by).column(bit));
                let slices = spans.fold(0, |mask, span| mask | span.slice_mask());
                prop_assert_eq!(page.block(bx, by).slices(), slices);
                for (first, last) in [(0, 63), (0, 0), (63, 63), (5, 9), (17, 40)] {
                    let meets = slices & u64::MAX << first & u64::MAX >> (63 - last) != 0;
                    prop_assert_eq!(page.blocks_in(first, last) >> (by * 8 + bx) & 1 == 1, meets);
                }
            }
        }

        #[test]
        fn unions_meet_an_interval_exactly_when_a_pixel_does(
            columns in columns(), low in 0u32..16320, height in 0u32..600
        ) {
            let page = build(&columns);
            let high = low + height;
            for by in 0..8 {
                for bx in 0..8 {
                    for obstacle in [false, true] {
                        let meets = |s: &Span| s.is_obstacle() == obstacle && s.meets(low, high);
                        let block = page.block(bx, by);
                        let by_pixels = (0..64).any(|bit| block.column(bit).iter().any(meets));
                        prop_assert_eq!(block.unions().any(|s| meets(&s)), by_pixels);
                    }
                }
            }
        }
    }
}
