//! Builders of pages from spans: pixel by pixel in any order, or in row order.

use super::unions::UnionFinder;
use super::{BLOCK_PIXELS, BLOCKS, Block, Page};
use crate::frame::{SLICE_QUANTA, TILE_PIXELS};
use crate::page::Span;

/// Collects the spans of a page pixel by pixel, in any order. Reusable, so each further page allocates only its own
/// memory.
#[derive(Debug)]
pub struct PageBuilder {
    /// Range in `spans` of each pixel, in block-major order.
    ranges: Box<[(u32, u32)]>,
    spans: Vec<Span>,
}

impl Default for PageBuilder {
    fn default() -> Self {
        Self { ranges: vec![(0, 0); (TILE_PIXELS * TILE_PIXELS) as usize].into(), spans: Vec::new() }
    }
}

impl PageBuilder {
    /// Returns the scratch memory (bytes, without the page itself) for building a page of `spans` spans, if that number
    /// was [reserved](Self::reserve).
    pub fn scratch_bytes(spans: usize) -> usize {
        let ranges = size_of::<(u32, u32)>() * (TILE_PIXELS * TILE_PIXELS) as usize;
        ranges + size_of::<Span>() * spans + Blocks::scratch_bytes(spans)
    }

    /// Reserves memory for `spans` spans.
    pub fn reserve(&mut self, spans: usize) {
        self.spans.reserve_exact(spans);
    }

    /// Removes all spans.
    pub fn clear(&mut self) {
        self.ranges.fill((0, 0));
        self.spans.clear();
    }

    /// Returns whether no pixel has a span.
    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// Sets the spans of pixel (`px`, `py`) [0..64]. They must come lowest first, at most 64 of them, and apart: a span
    /// begins above the top of the one below, or on that top if it is a slice boundary and the two differ in class.
    /// Returns `false` and changes nothing if that does not hold or if the pixel is already set. Panics if the pixel
    /// lies outside the page.
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

    /// Builds the page of all spans set since the last `clear`.
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

/// Collects the spans of a page whose pixels come in row order, which is cheaper than any order. Reusable.
#[derive(Debug)]
pub struct RowBuilder {
    /// Occupied pixels of each row.
    rows: [u64; 64],
    /// End in `spans` of the eight pixels of a row that lie in one block; valid if one of them is occupied.
    ends: Box<[u32; 8 * 64]>,
    spans: Vec<Span>,
}

impl Default for RowBuilder {
    fn default() -> Self {
        Self { rows: [0; 64], ends: Box::new([0; 8 * 64]), spans: Vec::new() }
    }
}

impl RowBuilder {
    /// Returns the scratch memory (bytes, without the page itself) for building a page of `spans` spans, if that number
    /// was [reserved](Self::reserve).
    pub fn scratch_bytes(spans: usize) -> usize {
        size_of::<Self>() + size_of::<[u32; 8 * 64]>() + size_of::<Span>() * spans + Blocks::scratch_bytes(spans)
    }

    /// Reserves memory for `spans` spans.
    pub fn reserve(&mut self, spans: usize) {
        self.spans.reserve_exact(spans);
    }

    /// Begins a page in which these pixels are occupied.
    pub fn begin(&mut self, rows: [u64; 64]) {
        self.rows = rows;
        self.spans.clear();
    }

    /// Adds the next span of the current pixel; the spans of a pixel come lowest first and [apart](Span::lies_below).
    #[inline(always)]
    pub fn push(&mut self, px: u32, span: Span) {
        self.spans.push(span.in_lane(px % BLOCK_PIXELS));
    }

    /// Ends the current pixel: the next span belongs to a later one.
    #[inline(always)]
    pub fn end_pixel(&mut self, px: u32, py: u32) {
        self.ends[(py << 3 | px >> 3) as usize & 0x1FF] = self.spans.len() as u32;
    }

    /// Builds the page of all spans.
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

    /// Returns the occupied pixels of one row of a block.
    fn pixels(&self, at: usize) -> u64 {
        self.rows[at / 8] >> (8 * (at % 8)) & 0xFF
    }
}

/// Block-major arrays of a page under construction.
struct Blocks {
    slices: u64,
    slice_blocks: [u64; 64],
    places: [u8; BLOCKS],
    blocks: Vec<Block>,
    spans: Vec<Span>,
    unions: UnionFinder,
}

impl Blocks {
    /// Returns the scratch memory for the blocks of `spans` spans (bytes, without the page itself).
    fn scratch_bytes(spans: usize) -> usize {
        // Two lists of one block's spans, and the page's own list if it outgrows its estimate.
        let lists = 2 * spans.min(64 * 64) + 2 * spans;
        size_of::<Block>() * (BLOCKS + 1) + size_of::<UnionFinder>() + size_of::<Span>() * lists
    }

    /// Allocates for `count` blocks and `spans` spans, at most `most` of them in one block.
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

    /// Adds block `number` with occupied `pixels`. Its spans are those from `start` on; its rows begin at `rows`.
    fn add(&mut self, number: usize, pixels: u64, mut rows: [u16; 8], start: usize) {
        let spans = &mut self.spans;
        let unions = self.unions.find(&spans[start..]);
        let mut slices = unions.iter().fold(0, |mask, span| mask | span.slice_mask());
        // A span `[b, b]` on a slice boundary belongs to the slice above, which a union that ends at `b` does not
        // count.
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

#[cfg(test)]
mod tests {
    use super::*;

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
