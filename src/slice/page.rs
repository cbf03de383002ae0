//! A page in memory: one tile column (64 × 64 pixels) of 64 slices, as spans per pixel under a summary per block.
//!
//! Layout, outermost first. Blocks are 8 × 8 pixels, numbered in row order; only those with matter are stored.
//!
//! 1. Per slice a mask of blocks with matter in it: one pass over the slices that a shape spans leaves the
//!    few blocks that can matter.
//! 2. Per block a record of 48 bytes: the *unions* of its floor spans and of its obstacle spans, if at most four, the
//!    mask of pixels with matter, where its rows begin.
//! 3. Per block the unions beyond four, then its spans in row order.
//!
//! A shape of constant height that covers all pixels with matter of a block is answered by the unions alone, and
//! exactly: the union meets a height interval if and only if some pixel's span does. Where the shape cuts a block, the
//! spans of the rows concerned lie one behind the other, each with its pixel's `x % 8`, so that one loop without
//! branches tests them all (see [`Span`]).

use super::span::Span;
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA, TILE_PIXELS};

/// Edge of a block in pixels; its pixels are the bits of one `u64`.
pub const BLOCK_PIXELS: u32 = 8;
const BLOCKS: usize = 64;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Block {
    /// The lowest unions, filled up with [`Span::NEVER`].
    unions: [Span; 4],
    /// Pixels with matter, bit `8·(y % 8) + x % 8`.
    pixels: u64,
    /// First of the block's further unions and spans in the page's.
    first: u32,
    /// Where each row's spans begin, counted from `first`. Before row 0 lie the unions beyond four, filled up to a
    /// multiple of four.
    rows: [u16; 8],
}

impl Block {
    fn without_matter(first: usize) -> Self {
        Self { unions: [Span::NEVER; 4], pixels: 0, first: first as u32, rows: [0; 8] }
    }
}

/// All matter in one tile column of 64 slices. Immutable; see the module text for its layout.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Page {
    /// Slices with matter.
    slices: u64,
    /// Per block its place in the arrays below; blocks without matter share the sentinel at the end.
    places: [u8; BLOCKS],
    /// From the lowest to the highest slice with matter: its blocks with matter, bit `8·by + bx`.
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
    /// Slices of the page in which some pixel of the block has matter, as a mask.
    pub fn slices(self) -> u64 {
        let number = self.page.places.iter().position(|&place| usize::from(place) == self.place).unwrap_or(0);
        let with_matter = self.page.slice_blocks.iter().rev();
        let slices = with_matter.fold(0, |slices, blocks| slices << 1 | blocks >> number & 1);
        slices << self.page.slices.trailing_zeros().min(63)
    }

    /// Pixels of the block with matter: bit `8·(y % 8) + x % 8`.
    #[inline]
    pub fn pixels(self) -> u64 {
        self.page.blocks[self.place].pixels
    }

    /// Unions of the block's floor spans and unions of its obstacle spans: disjoint within a kind, lowest bottom first.
    pub fn unions(self) -> impl Iterator<Item = Span> {
        let (first, more) = self.union_quads();
        first.iter().chain(more.as_flattened()).copied().take_while(|span| *span != Span::NEVER)
    }

    /// The unions in groups of four, filled up with spans that meet nothing.
    #[inline]
    pub(crate) fn union_quads(self) -> (&'a [Span; 4], &'a [[Span; 4]]) {
        let block = &self.page.blocks[self.place];
        let first = block.first as usize;
        let more = &self.page.spans[first..first + block.rows[0] as usize];
        (&block.unions, more.as_chunks().0)
    }

    /// Spans of the rows `y0..=y1` [0..8], row by row, within a row pixel by pixel, lowest first.
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

    /// Spans of the row of pixel `bit` from the first of that pixel on whose top is not below `low`, or from where it would be.
    #[inline]
    pub(crate) fn row_from(self, bit: u32, low: u32) -> &'a [Span] {
        let row = self.rows(bit >> 3, bit >> 3);
        &row[row.partition_point(|span| span.is_before(bit & 7, low))..]
    }

    /// Spans of the pixel with bit number `bit` in [`pixels`](Self::pixels), lowest first; empty without matter.
    #[inline]
    pub fn column(self, bit: u32) -> &'a [Span] {
        if self.pixels() >> bit & 1 == 0 {
            return &[];
        }
        let (x, y) = (bit & 7, bit >> 3);
        let row = self.rows(y, y);
        // A span at least for each pixel before this one.
        let before = (self.pixels() >> (8 * y) & ((1 << x) - 1)).count_ones() as usize;
        let row = row.get(before..).unwrap_or(&[]);
        let first = row.iter().position(|span| span.lane() >= x).unwrap_or(row.len());
        let count = row[first..].iter().position(|span| span.lane() > x).unwrap_or(row.len() - first);
        &row[first..first + count]
    }
}

impl Page {
    /// The block at block coordinates `bx`, `by` [0..8].
    #[inline]
    pub fn block(&self, bx: u32, by: u32) -> BlockView<'_> {
        debug_assert!(bx < 8 && by < 8);
        self.block_at((by & 7) << 3 | bx & 7)
    }

    /// The block with number `8·by + bx`.
    #[inline]
    pub(crate) fn block_at(&self, number: u32) -> BlockView<'_> {
        BlockView { page: self, place: self.places[(number & 63) as usize] as usize }
    }

    /// Blocks (bit `8·by + bx`) with matter in one of the slices `first..=last` [0..64].
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
            // At most three.
            None => {
                let at = |n: usize| slices.get(n).copied().unwrap_or(0);
                all[0] = at(0) | at(slices.len() / 2) | at(slices.len().wrapping_sub(1));
            }
        }
        all[0] | all[1] | all[2] | all[3]
    }

    /// Spans of pixel (`px`, `py`) [0..64], lowest first.
    #[inline]
    pub fn column(&self, px: u32, py: u32) -> &[Span] {
        self.block(px >> 3, py >> 3).column((py & 7) << 3 | px & 7)
    }

    /// All pixels with matter in row order (y, then x): `(px, py, spans)`.
    pub fn columns(&self) -> impl Iterator<Item = (u32, u32, &[Span])> {
        (0..TILE_PIXELS as u32).flat_map(move |py| {
            (0..TILE_PIXELS as u32 / BLOCK_PIXELS).flat_map(move |bx| {
                let row = self.block(bx, py >> 3).rows(py & 7, py & 7);
                row.chunk_by(|a, b| a.lane() == b.lane()).map(move |spans| (bx << 3 | spans[0].lane(), py, spans))
            })
        })
    }

    /// Slices of the page with matter, as a mask.
    pub fn slices(&self) -> u64 {
        self.slices
    }

    /// Number of spans.
    pub fn span_count(&self) -> usize {
        let further_unions = self.blocks.iter().map(|block| block.rows[0] as usize).sum::<usize>();
        self.spans.len() - further_unions
    }

    /// The blocks with matter.
    fn blocks_with_matter(&self) -> impl Iterator<Item = BlockView<'_>> {
        (0..self.blocks.len() - 1).map(|place| BlockView { page: self, place })
    }

    /// All spans, block by block.
    pub(crate) fn spans_of_blocks(&self) -> impl Iterator<Item = &[Span]> {
        self.blocks_with_matter().map(|block| block.rows(0, BLOCK_PIXELS - 1))
    }

    /// Number of occupied voxels, and how many of them hold obstacle.
    pub fn voxel_counts(&self) -> (u64, u64) {
        let mut counts = (0, 0);
        for (block, y) in self.blocks_with_matter().flat_map(|block| (0..BLOCK_PIXELS).map(move |y| (block, y))) {
            // Slices of the pixel at hand: with matter, and with obstacle.
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

    /// The least box around all matter; `None` for a page without matter. Cost: one pass over the blocks.
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

    /// Bytes of memory that the page holds.
    pub fn weight_bytes(&self) -> usize {
        self.size().weight_bytes(self.slices)
    }

    /// How large the page is.
    pub fn size(&self) -> PageSize {
        PageSize((self.blocks.len() as u32 - 1) << PageSize::SHIFT | self.spans.len() as u32)
    }
}

/// The least box around the matter of a page, both ends inclusive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PageBounds {
    /// Least pixel x and y [0..64] and lowest bottom (quanta above the page's floor).
    pub min: [u32; 3],
    /// Greatest pixel x and y [0..64] and highest top (quanta above the page's floor).
    pub max: [u32; 3],
}

impl PageBounds {
    /// Of a page whose pixels all hold the one `span`.
    pub fn of_uniform(span: Span) -> Self {
        let last = TILE_PIXELS as u32 - 1;
        Self { min: [0, 0, span.bottom()], max: [last, last, span.top()] }
    }
}

/// What the weight of a page follows from, together with its mask of slices: small enough for a directory entry.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct PageSize(u32);

impl PageSize {
    const SHIFT: u32 = 24;
    /// Most words that a page can have: its spans, and as many unions, filled up in each block.
    pub const MAX_WORDS: u32 = 2 * 64 * 64 * 64 + 64 * 3;
    /// The size of a page whose pixels all hold the same single span.
    pub const UNIFORM: Self = Self((64 << Self::SHIFT) | (64 * 64));

    /// The size of a page with this many blocks and words; `None` unless there are 1 to 64 blocks, at least a word for
    /// each and at most [`MAX_WORDS`](Self::MAX_WORDS).
    pub fn new(blocks: u32, words: u32) -> Option<Self> {
        let inside = (1..=64).contains(&blocks) && (blocks..=Self::MAX_WORDS).contains(&words);
        inside.then_some(Self(blocks << Self::SHIFT | words))
    }

    /// Blocks of 8 × 8 pixels with matter.
    pub fn blocks(self) -> u32 {
        self.0 >> Self::SHIFT
    }

    /// Spans, and in each block its unions beyond four, rounded up to a multiple of four.
    pub fn words(self) -> u32 {
        self.0 & ((1 << Self::SHIFT) - 1)
    }

    /// [`Page::weight_bytes`] of a page of this size with matter in `slices` (bytes); exact.
    pub fn weight_bytes(self, slices: u64) -> usize {
        // A mask of blocks for every slice from the lowest to the highest with matter.
        let height = (64 - slices.leading_zeros()).saturating_sub(slices.trailing_zeros()) as usize;
        size_of::<Page>()
            + size_of::<u64>() * height
            + size_of::<Block>() * (self.blocks() as usize + 1)
            + size_of::<Span>() * self.words() as usize
    }
}

/// Collects the spans of a page pixel by pixel; reusable, so that a page costs no more than its final allocations.
#[derive(Debug)]
pub struct PageBuilder {
    /// Per pixel in block-major order: its range in `spans`.
    ranges: Box<[(u32, u32)]>,
    spans: Vec<Span>,
}

impl Default for PageBuilder {
    fn default() -> Self {
        Self { ranges: vec![(0, 0); (TILE_PIXELS * TILE_PIXELS) as usize].into(), spans: Vec::new() }
    }
}

impl PageBuilder {
    /// Bytes of scratch memory that building a page of `spans` spans takes besides the page, if as many were
    /// [reserved](Self::reserve).
    pub fn scratch_bytes(spans: usize) -> usize {
        // All spans, two lists of a block's, and the page's own list where it outgrows what was expected.
        let lists = spans + 2 * spans.min(64 * 64) + 2 * spans;
        size_of::<(u32, u32)>() * (TILE_PIXELS * TILE_PIXELS) as usize
            + size_of::<Block>() * (BLOCKS + 1)
            + size_of::<UnionFinder>()
            + size_of::<Span>() * lists
    }

    /// Makes room for `spans` spans.
    pub fn reserve(&mut self, spans: usize) {
        self.spans.reserve_exact(spans);
    }

    /// Forgets all spans.
    pub fn clear(&mut self) {
        self.ranges.fill((0, 0));
        self.spans.clear();
    }

    /// Whether no pixel has a span.
    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// Sets the spans of pixel (`px`, `py`) [0..64]. They must be lowest first, at most one per slice, and apart: a
    /// span begins above the top of the one below, or on it at a slice boundary if the two differ in kind. Returns
    /// `false`, and takes nothing, if that does not hold or the pixel is set already.
    #[must_use]
    pub fn set_column(&mut self, px: u32, py: u32, spans: &[Span]) -> bool {
        let pixel = Self::place(px, py);
        if self.ranges[pixel].1 != 0 || !spans.windows(2).all(|pair| pair[0].lies_below(pair[1])) || spans.len() > 64 {
            return false;
        }
        let first = self.spans.len() as u32;
        self.spans.extend_from_slice(spans);
        self.ranges[pixel] = (first, spans.len() as u32);
        true
    }

    fn place(px: u32, py: u32) -> usize {
        assert!(px < TILE_PIXELS as u32 && py < TILE_PIXELS as u32, "pixel ({px}, {py}) lies outside the page");
        let block = (py >> 3) << 3 | px >> 3;
        (block << 6 | (py & 7) << 3 | px & 7) as usize
    }

    /// The page of all spans set so far.
    pub fn build(&self) -> Page {
        let occupied = |ranges: &[(u32, u32)]| ranges.iter().any(|range| range.1 > 0);
        let count = self.ranges.chunks_exact(64).filter(|ranges| occupied(ranges)).count();
        let in_block = |ranges: &[(u32, u32)]| ranges.iter().map(|range| range.1 as usize).sum();
        let most: usize = self.ranges.chunks_exact(64).map(in_block).max().unwrap_or(0);
        let mut blocks = Blocks::with_capacity(count, self.spans.len(), most);
        for (number, ranges) in self.ranges.chunks_exact(64).enumerate().filter(|(_, ranges)| occupied(ranges)) {
            let (spans, mut pixels, mut rows) = (&mut blocks.spans, 0, [0; 8]);
            let start = spans.len();
            for (bit, &(first, count)) in ranges.iter().enumerate() {
                if bit % 8 == 0 {
                    rows[bit / 8] = (spans.len() - start) as u16;
                }
                pixels |= u64::from(count > 0) << bit;
                let column = &self.spans[first as usize..(first + count) as usize];
                spans.extend(column.iter().map(|span| span.in_lane(bit as u32 % 8)));
            }
            blocks.add(number, pixels, rows, start);
        }
        blocks.finish()
    }
}

/// Collects the spans of a page whose pixels come in row order, which costs less than in any order; reusable.
#[derive(Debug)]
pub(crate) struct RowBuilder {
    /// Pixels with matter.
    rows: [u64; 64],
    /// Where in `spans` the eight pixels of a row that lie in one block end; valid where some have matter.
    ends: Box<[u32; 8 * 64]>,
    spans: Vec<Span>,
}

impl Default for RowBuilder {
    fn default() -> Self {
        Self { rows: [0; 64], ends: Box::new([0; 8 * 64]), spans: Vec::new() }
    }
}

impl RowBuilder {
    /// Bytes that it takes itself, with room [reserved](Self::reserve) for `spans` spans. What building takes besides is as of a
    /// [`PageBuilder`].
    pub fn own_bytes(spans: usize) -> usize {
        size_of::<Self>() + size_of::<[u32; 8 * 64]>() + size_of::<Span>() * spans
    }

    /// Makes room for `spans` spans.
    pub fn reserve(&mut self, spans: usize) {
        self.spans.reserve_exact(spans);
    }

    /// Begins a page with matter in these pixels.
    pub fn begin(&mut self, rows: [u64; 64]) {
        self.rows = rows;
        self.spans.clear();
    }

    /// Adds the next span of the pixel in work; spans of a pixel come lowest first and [apart](Span::lies_below).
    #[inline(always)]
    pub fn push(&mut self, px: u32, span: Span) {
        self.spans.push(span.in_lane(px % BLOCK_PIXELS));
    }

    /// The next span is one of a pixel behind this.
    #[inline(always)]
    pub fn end_pixel(&mut self, px: u32, py: u32) {
        self.ends[(py << 3 | px >> 3) as usize & 0x1FF] = self.spans.len() as u32;
    }

    /// The page of all spans.
    pub fn build(&self) -> Page {
        let mut parts = [(0, 0); 8 * 64];
        let (mut start, mut sizes) = (0, [0; BLOCKS]);
        for (y, &row) in self.rows.iter().enumerate() {
            let mut rest = row;
            while rest != 0 {
                let bx = (rest.trailing_zeros() / 8) as usize & 7;
                rest &= !(0xFF << (8 * bx));
                let end = self.ends[y << 3 | bx];
                parts[y << 3 | bx] = (start, end);
                sizes[y / 8 * 8 + bx] += (end - start) as usize;
                start = end;
            }
        }
        let count = sizes.iter().filter(|&&size| size > 0).count();
        let mut blocks = Blocks::with_capacity(count, self.spans.len(), sizes.into_iter().max().unwrap_or(0));
        for number in (0..BLOCKS).filter(|&number| sizes[number] > 0) {
            let (spans, mut pixels, mut rows) = (&mut blocks.spans, 0, [0; 8]);
            let start = spans.len();
            for (y, row) in rows.iter_mut().enumerate() {
                let at = number / 8 * 64 + y * 8 + number % 8;
                *row = (spans.len() - start) as u16;
                spans.extend_from_slice(&self.spans[parts[at].0 as usize..parts[at].1 as usize]);
                pixels |= self.pixels(at) << (8 * y);
            }
            blocks.add(number, pixels, rows, start);
        }
        blocks.finish()
    }

    /// Pixels with matter of a row of a block.
    fn pixels(&self, at: usize) -> u64 {
        self.rows[at / 8] >> (8 * (at % 8)) & 0xFF
    }
}

/// The blocks of a page, one after the other.
struct Blocks {
    slices: u64,
    slice_blocks: [u64; 64],
    places: [u8; BLOCKS],
    blocks: Vec<Block>,
    spans: Vec<Span>,
    unions: UnionFinder,
}

impl Blocks {
    /// For so many blocks and spans, at most `most` in a block.
    fn with_capacity(count: usize, spans: usize, most: usize) -> Self {
        Self {
            slices: 0,
            slice_blocks: [0; 64],
            places: [count as u8; BLOCKS],
            blocks: Vec::with_capacity(count + 1),
            spans: Vec::with_capacity(spans + 2 * count),
            unions: UnionFinder::with_capacity(most),
        }
    }

    /// Adds block `number` with matter in `pixels`: its spans are those from `start` on, in which its rows begin at `rows`.
    fn add(&mut self, number: usize, pixels: u64, mut rows: [u16; 8], start: usize) {
        let spans = &mut self.spans;
        let unions = self.unions.find(&spans[start..]);
        let mut slices = unions.iter().fold(0, |mask, span| mask | span.slice_mask());
        // A span that is a slice boundary alone belongs to the slice above, as none of a union does that ends there.
        for union in unions.iter().filter(|union| union.top().is_multiple_of(SLICE_QUANTA as u32)) {
            let is_alone = |span: &Span| span.bottom() == union.top() && span.top() == union.top();
            slices |=
                spans[start..].iter().filter(|span| is_alone(span)).fold(0, |mask, span| mask | span.slice_mask());
        }
        let (lowest, further) = unions.split_at(unions.len().min(4));
        let mut block = Block::without_matter(start);
        block.unions[..lowest.len()].copy_from_slice(lowest);
        if !further.is_empty() {
            let (end, filled) = (spans.len(), further.len().next_multiple_of(4));
            spans.resize(end + filled, Span::NEVER);
            spans.copy_within(start..end, start + filled);
            spans[start..start + filled].fill(Span::NEVER);
            spans[start..start + further.len()].copy_from_slice(further);
            rows.iter_mut().for_each(|row| *row += filled as u16);
        }
        self.slices |= slices;
        let mut rest = slices;
        while rest != 0 {
            self.slice_blocks[rest.trailing_zeros() as usize] |= 1 << number;
            rest &= rest - 1;
        }
        self.places[number] = self.blocks.len() as u8;
        self.blocks.push(Block { pixels, rows, ..block });
    }

    fn finish(mut self) -> Page {
        self.blocks.push(Block::without_matter(self.spans.len()));
        let slices = self.slices;
        let lowest = if slices == 0 { 0 } else { slices.trailing_zeros() as usize };
        Page {
            slices,
            places: self.places,
            slice_blocks: self.slice_blocks[lowest..64 - slices.leading_zeros() as usize].into(),
            blocks: self.blocks.into(),
            spans: self.spans.into(),
        }
    }
}

/// Finds the unions of a block's spans; reusable.
#[derive(Debug)]
struct UnionFinder {
    /// Of floors and of obstacles, two bits for each height above the lowest of the block, the second for what lies between it and the
    /// next: spans that do not share a height are not joined.
    covered: [[u64; Self::WORDS]; 2],
    sorted: Vec<Span>,
    unions: Vec<Span>,
}

impl UnionFinder {
    /// Words that stand for the heights of a block, one more than the longest needs. Higher blocks are sorted.
    const WORDS: usize = 2 * 2048 / 64 + 1;
    /// Longest span that is marked bit by bit (quanta).
    const LONGEST: u32 = 512;

    fn with_capacity(spans: usize) -> Self {
        let lists = [(); 2].map(|()| Vec::with_capacity(spans));
        let [sorted, unions] = lists;
        Self { covered: [[0; Self::WORDS]; 2], sorted, unions }
    }

    /// Unions of the floor spans and of the obstacle spans in `spans`, lowest bottom first.
    fn find(&mut self, spans: &[Span]) -> &[Span] {
        // Signed, so that every processor compares several at once.
        let (mut low, mut high, mut longest) = (i32::MAX, 0, 0);
        for span in spans {
            let (bottom, top) = (span.bottom() as i32, span.top() as i32);
            (low, high, longest) = (low.min(bottom), high.max(top), longest.max(top - bottom));
        }
        let (low, high, longest) = (low as u32, high as u32, longest as u32);
        self.unions.clear();
        if longest <= Self::LONGEST && high - low < 32 * (Self::WORDS as u32 - 1) {
            self.by_bits(spans, low, high);
        } else {
            self.by_order(spans);
        }
        &self.unions
    }

    fn by_bits(&mut self, spans: &[Span], low: u32, high: u32) {
        for span in spans {
            let covered = &mut self.covered[usize::from(span.is_obstacle())];
            let (first, last) = (2 * (span.bottom() - low), 2 * (span.top() - low));
            let (mut word, end) = (first as usize / 64, last as usize / 64);
            let mut run = u64::MAX << (first % 64);
            while word < end {
                covered[word] |= run;
                run = u64::MAX;
                word += 1;
            }
            covered[end] |= run & u64::MAX >> (63 - last % 64);
        }
        let words = 2 * (high - low) as usize / 64 + 2;
        for (kind, covered) in self.covered.iter_mut().enumerate() {
            let mut begun = None;
            for (number, word) in covered[..words.min(Self::WORDS)].iter_mut().enumerate() {
                let height = |bit: u32| low + (64 * number as u32 + bit) / 2;
                let mut bits = std::mem::take(word);
                if bits == u64::MAX && begun.is_some() {
                    continue;
                }
                let mut passed = 0;
                loop {
                    // A run from its first bit to the first that is not in it, as far as this word goes.
                    if begun.is_none() {
                        if bits == 0 {
                            break;
                        }
                        passed = bits.trailing_zeros();
                        begun = Some(height(passed));
                    }
                    let end = passed + (!(bits >> passed)).trailing_zeros();
                    if end >= 64 {
                        break;
                    }
                    let bottom = begun.take();
                    // Where the word begins with the end of a run, that is the last bit of the one before.
                    let top = low + (64 * number as u32 + end - 1) / 2;
                    self.unions.extend(bottom.and_then(|bottom| Span::new(bottom, top, kind == 1)));
                    bits &= u64::MAX << end;
                    passed = 0;
                }
            }
        }
        self.merge_kinds();
    }

    fn by_order(&mut self, spans: &[Span]) {
        let Self { sorted, unions, .. } = self;
        for obstacle in [false, true] {
            sorted.clear();
            sorted.extend(spans.iter().filter(|span| span.is_obstacle() == obstacle));
            sorted.sort_unstable_by_key(|span| span.bottom());
            let mut run: Option<(u32, u32)> = None;
            for span in sorted.iter() {
                run = match run {
                    Some((bottom, top)) if span.bottom() <= top => Some((bottom, top.max(span.top()))),
                    ended => {
                        unions.extend(ended.and_then(|(bottom, top)| Span::new(bottom, top, obstacle)));
                        Some((span.bottom(), span.top()))
                    }
                };
            }
            unions.extend(run.and_then(|(bottom, top)| Span::new(bottom, top, obstacle)));
        }
        self.merge_kinds();
    }

    /// Unions of floors lie before those of obstacles, each kind in order.
    fn merge_kinds(&mut self) {
        let is_one_kind = |ends: (&Span, &Span)| ends.0.is_obstacle() == ends.1.is_obstacle();
        if !self.unions.first().zip(self.unions.last()).is_none_or(is_one_kind) {
            self.unions.sort_unstable_by_key(|span| (span.bottom(), span.is_obstacle()));
        }
    }
}

const _: () = assert!(PAGE_QUANTA < 1 << 14 && BLOCKS * 64 == (TILE_PIXELS * TILE_PIXELS) as usize);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Columns as a builder accepts them: one span per chosen slice, kinds at random.
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

    #[test]
    fn refuses_columns_that_are_not_canonical() {
        let span = |b, t, o| Span::new(b, t, o).unwrap();
        let mut builder = PageBuilder::default();
        assert!(!builder.set_column(0, 0, &[span(10, 20, false), span(5, 6, false)]), "out of order");
        assert!(!builder.set_column(0, 0, &[span(10, 255, true), span(255, 300, true)]), "should be joined");
        assert!(!builder.set_column(0, 0, &[span(10, 20, true), span(20, 30, false)]), "touch inside a slice");
        assert!(builder.set_column(0, 0, &[span(10, 255, true), span(255, 300, false)]));
        assert!(!builder.set_column(0, 0, &[span(10, 20, true)]), "set twice");
    }
}
