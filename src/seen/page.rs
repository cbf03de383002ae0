//! Seen cells of one page, and of 64 pages one above the other.

use crate::frame::{PageKey, TILE_PIXELS};

/// Edge of a cell along x and y (pixels).
pub const CELL_PIXELS: i64 = 4;
/// Cells along an edge of a page.
pub(super) const CELLS_PER_ROW: i64 = TILE_PIXELS / CELL_PIXELS;
/// Layers in a block.
pub(super) const BLOCK_LAYERS: i32 = 64;
/// Words of a slice.
const WORDS: usize = 4;

/// Cells of a page that were seen: 16 × 16 in each of 64 slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeenPage {
    /// For each slice a bit per cell, rows one after the other: four rows a word.
    slices: [[u64; WORDS]; 64],
}

impl SeenPage {
    /// Cells of a page.
    pub const CELLS: u64 = 64 * 64 * WORDS as u64;
    /// Bytes of a page.
    pub const BYTES: usize = 8 * WORDS * 64;
    /// The page in which nothing was seen.
    pub const NOTHING: Self = Self { slices: [[0; WORDS]; 64] };
    /// The page in which everything was seen.
    pub const ALL: Self = Self { slices: [[u64::MAX; WORDS]; 64] };

    /// Marks a box of cells as seen, from the first to the last index along x, y (each up to 15) and z (up to 63).
    pub fn mark(&mut self, ranges: [[usize; 2]; 3]) {
        self.words(ranges, |word, mask| {
            *word |= mask;
            true
        });
    }

    /// Returns whether a box of cells was seen, from the first to the last index along x, y and z.
    pub fn is_seen(&self, ranges: [[usize; 2]; 3]) -> bool {
        // A copy, so that one loop serves both.
        let mut copy = *self;
        copy.words(ranges, |word, mask| *word & mask == mask)
    }

    /// Returns the runs of seen cells in one column: the first slice and the one after the last.
    pub(super) fn runs(&self, [x, y]: [usize; 2]) -> impl Iterator<Item = [i64; 2]> + use<> {
        let is_seen = |slice: &[u64; WORDS]| slice[y / 4] >> (16 * (y % 4) + x) & 1;
        let mut bits = (0..).zip(&self.slices).fold(0, |bits, (slice, words)| bits | is_seen(words) << slice);
        std::iter::from_fn(move || {
            let first = (bits != 0).then(|| bits.trailing_zeros())?;
            let end = first + (bits >> first).trailing_ones();
            bits &= u64::MAX.checked_shl(end).unwrap_or(0);
            Some([first, end].map(i64::from))
        })
    }

    /// Passes the words of a box of cells, with the bits of its cells, to `take`, until that returns `false`.
    #[inline]
    fn words(&mut self, [x, y, z]: [[usize; 2]; 3], mut take: impl FnMut(&mut u64, u64) -> bool) -> bool {
        let row = (u64::MAX >> (63 - (x[1] - x[0]))) << x[0];
        for slice in &mut self.slices[z[0]..=z[1]] {
            for (number, word) in slice.iter_mut().enumerate().take(y[1] / 4 + 1).skip(y[0] / 4) {
                let rows = (y[0].max(4 * number)..=y[1].min(4 * number + 3)).map(|at| row << (16 * (at % 4)));
                if !take(word, rows.fold(0, |mask, row| mask | row)) {
                    return false;
                }
            }
        }
        true
    }

    /// Returns the number of cells that were seen.
    pub fn cells(&self) -> u64 {
        self.slices.as_flattened().iter().map(|word| u64::from(word.count_ones())).sum()
    }

    /// Leaves only what was also seen in `other`.
    pub fn intersect(&mut self, other: &Self) {
        for (word, other) in self.slices.as_flattened_mut().iter_mut().zip(other.slices.as_flattened()) {
            *word &= other;
        }
    }

    /// Takes the cells of `inside` from `other`. Further cells of `meets`, which lie in both, stay seen if both pages say
    /// so.
    pub(crate) fn replace(&mut self, other: &Self, inside: &Self, meets: &Self) {
        for (slice, word) in self.slices.as_flattened_mut().iter_mut().enumerate() {
            let [other, inside, meets] = [other, inside, meets].map(|page| page.slices.as_flattened()[slice]);
            *word = (*word | inside) & (other | !meets);
        }
    }

    /// Returns the bits of its slices: cell `(x, y)` is bit `16·(y mod 4) + x` of word `y / 4`.
    pub fn slices(&self) -> &[[u64; 4]; 64] {
        &self.slices
    }

    /// Appends its bytes: of each slice, the bits in which it differs from the slice below.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let mut below = [0; WORDS];
        for slice in &self.slices {
            for (word, below) in slice.iter().zip(&mut below) {
                out.extend((word ^ *below).to_le_bytes());
                *below = *word;
            }
        }
    }

    /// Reads the page from its bytes.
    pub fn decode(bytes: &[u8; Self::BYTES]) -> Self {
        let mut page = Self::NOTHING;
        let (words, _) = bytes.as_chunks::<8>();
        let mut below = [0; WORDS];
        for (slice, words) in page.slices.iter_mut().zip(words.chunks(WORDS)) {
            for ((word, bytes), below) in slice.iter_mut().zip(words).zip(&mut below) {
                *word = u64::from_le_bytes(*bytes) ^ *below;
                *below = *word;
            }
        }
        page
    }
}

/// Seen cells of up to 64 pages one above the other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeenBlock {
    /// Tile column; `layer` is that of the pages divided by 64, rounded down.
    pub key: PageKey,
    /// Pages that were seen entirely: bit `k` for layer `64 · layer + k`.
    pub full: u64,
    /// Pages that were seen in part.
    pub mixed: u64,
    /// Pages that were seen in part, lowest first.
    pub pages: Vec<SeenPage>,
}

impl SeenBlock {
    /// Creates the block of the pages at `key` (a block's) in which nothing was seen yet.
    pub fn new(key: PageKey) -> Self {
        Self { key, full: 0, mixed: 0, pages: Vec::new() }
    }

    /// Returns the block's key and number in the block of the page `key`.
    pub fn place_of(key: PageKey) -> (PageKey, u32) {
        let block = PageKey { layer: key.layer.div_euclid(BLOCK_LAYERS), ..key };
        (block, key.layer.rem_euclid(BLOCK_LAYERS) as u32)
    }

    /// Adds the page of number `at` in the block, above those added before.
    pub fn push(&mut self, at: u32, page: &SeenPage) {
        debug_assert!((self.full | self.mixed) >> at == 0, "pages come in order");
        match page.cells() {
            0 => {}
            SeenPage::CELLS => self.full |= 1 << at,
            _ => {
                self.mixed |= 1 << at;
                self.pages.push(*page);
            }
        }
    }

    /// Returns whether nothing was seen in it.
    pub fn is_empty(&self) -> bool {
        self.full | self.mixed == 0
    }

    /// Returns the number of cells that were seen.
    pub fn cells(&self) -> u64 {
        let full = u64::from(self.full.count_ones()) * SeenPage::CELLS;
        full + self.pages.iter().map(SeenPage::cells).sum::<u64>()
    }

    /// Iterates over its pages in which something was seen, with their keys.
    pub fn each_page(&self) -> impl Iterator<Item = (PageKey, SeenPage)> + '_ {
        let mut part = self.pages.iter();
        (0..BLOCK_LAYERS).filter_map(move |at| {
            let page = match (self.full >> at & 1, self.mixed >> at & 1) {
                (1, _) => SeenPage::ALL,
                (_, 1) => *part.next()?,
                _ => return None,
            };
            Some((PageKey { layer: self.key.layer * BLOCK_LAYERS + at, ..self.key }, page))
        })
    }
}
