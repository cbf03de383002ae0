//! Pixels of a page row by row, as the codec visits them, and folded differences.

use super::step_grid::{Boundaries, End};
use crate::frame::SLICE_QUANTA;
use crate::page::{BLOCK_PIXELS, Page, Span};

/// Pixels of a page.
pub(super) const PIXELS: usize = 64 * 64;
/// Most spans in one pixel.
pub(super) const MAX_COLUMN: u32 = 64;
/// Height of a slice (quanta).
pub(super) const SLICE: u32 = SLICE_QUANTA as u32;

/// Folds the sign of `difference`, taken modulo 2¹⁴, into the lowest bit: 0..2¹⁴.
#[inline]
pub(super) fn fold(difference: i32) -> u32 {
    let difference = difference << 18 >> 18;
    (difference << 1 ^ difference >> 31) as u32
}

/// Inverse of [`fold`].
#[inline]
pub(super) fn unfold(folded: u32) -> i32 {
    (folded >> 1) as i32 ^ -((folded & 1) as i32)
}

/// Spans of a page in row order, for encoding.
pub(super) struct Rows<'a> {
    page: &'a Page,
    /// Spans still to come in the current row of the current block.
    rest: &'a [Span],
    /// That row: x of the block, y of the pixels.
    row: (u32, u32),
}

impl<'a> Rows<'a> {
    pub fn of(page: &'a Page) -> Self {
        Self { page, rest: &[], row: (u32::MAX, 0) }
    }

    /// Returns the spans of an occupied pixel. All occupied pixels must be asked for in row order.
    #[inline]
    pub fn at(&mut self, px: u32, py: u32) -> &'a [Span] {
        let row = (px / BLOCK_PIXELS, py);
        if row != self.row {
            self.row = row;
            self.rest = self.page.block(row.0, py / BLOCK_PIXELS).rows(py % BLOCK_PIXELS, py % BLOCK_PIXELS);
        }
        let count = self.rest.iter().take_while(|span| span.lane() == px % BLOCK_PIXELS).count();
        let (own, rest) = self.rest.split_at(count);
        self.rest = rest;
        own
    }
}

/// Collects the heights of `page` that reveal its steps, and returns the others.
pub(super) fn telling_heights(page: &Page, heights: &mut Vec<(u32, End)>) -> Boundaries {
    let mut boundaries = Boundaries::default();
    heights.clear();
    for spans in page.spans_of_blocks() {
        heights.extend(spans.iter().flat_map(|span| [(span.bottom(), End::Bottom), (span.top(), End::Top)]));
    }
    heights.retain(|&(height, end)| !boundaries.add(height, end));
    boundaries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folding_is_a_bijection() {
        let mut folded: Vec<u32> = (-8192..8192).map(fold).collect();
        assert!((-8192..8192).all(|value| unfold(fold(value)) == value && fold(value + (1 << 14)) == fold(value)));
        folded.sort_unstable();
        assert!(folded.into_iter().eq(0..1 << 14));
    }
}
