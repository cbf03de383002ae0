//! What a level knows of the level below: 4 × 4 pixels as one, four slices as one, heights moved outwards.
//!
//! In: a page. Out: the spans that it gives to its page of the level above. All spans of 16 pixels go into one pixel; their
//! bottoms go down and their tops up to thirds of a slice of the level; those that then share a slice or a height become
//! one span, an obstacle if any of them is. So no matter is lost, and the result does not depend on any order.

use crate::frame::{PAGE_QUANTA, PAGE_SLICES, PageKey, SLICE_QUANTA};
use crate::slice::Page;

/// Pixels of a level along one edge of a pixel of the level above, and slices in one of its slices.
pub const FACTOR: u32 = 4;
/// Heights of levels are multiples of this (quanta of the level): a third of a slice, by default an edge of its pixels.
pub const HEIGHT_STEP: u32 = 85;
/// As many quanta of the level below.
const STEP_BELOW: u32 = HEIGHT_STEP * FACTOR;
const SLICE: u32 = SLICE_QUANTA as u32;
/// Pixels along an edge, slices, and quanta that a page takes in the level above.
const PIXELS: u32 = 64 / FACTOR;
const SLICES: u32 = PAGE_SLICES as u32 / FACTOR;
const QUANTA: u32 = PAGE_QUANTA as u32 / FACTOR;
const _: () = assert!(SLICE.is_multiple_of(HEIGHT_STEP) && PIXELS * PIXELS == 256 && SLICES == 16);

/// A span that a page gives to the level above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoarseSpan {
    /// `16·y + x` in the part of the upper page that the lower one covers.
    pixel: u8,
    obstacle: bool,
    /// Quanta of the level above the lower page's floor (0..=4080).
    bottom: u16,
    top: u16,
}

/// Key of the page of the level above that covers the page `key`.
pub fn above(key: PageKey) -> PageKey {
    PageKey { tx: key.tx >> 2, ty: key.ty >> 2, layer: key.layer >> 2 }
}

impl CoarseSpan {
    /// Pixel (`64·y + x`), bottom and top in the page of the level above, for a span that page `key` gives.
    pub fn place(&self, key: PageKey) -> (u32, u32, u32) {
        let part = |tile: i32| (tile & 3) as u32;
        let (x, y) = (u32::from(self.pixel) % PIXELS, u32::from(self.pixel) / PIXELS);
        let pixel = (part(key.ty) * PIXELS + y) * 64 + part(key.tx) * PIXELS + x;
        let floor = part(key.layer) * QUANTA;
        (pixel, floor + u32::from(self.bottom), floor + u32::from(self.top))
    }

    pub fn is_obstacle(&self) -> bool {
        self.obstacle
    }
}

/// The spans that `page` gives to the level above, by pixel and from below. Cost: one pass over its spans.
pub fn coarse(page: &Page) -> Vec<CoarseSpan> {
    let mut out = Vec::new();
    for y in 0..PIXELS {
        for across in 0..PIXELS / 2 {
            let view = page.block_at(y / 2 * 8 + across);
            if view.pixels() == 0 {
                continue;
            }
            let mut cells = [Cell::default(), Cell::default()];
            for span in view.rows(y % 2 * 4, y % 2 * 4 + 3) {
                cells[span.lane() as usize / 4].add(span.bottom(), span.top(), span.is_obstacle());
            }
            for (side, cell) in (0..).zip(&cells) {
                cell.give((y * PIXELS + across * 2 + side) as u8, &mut out);
            }
        }
    }
    out
}

/// The spans of one pixel of the level, joined as they come.
#[derive(Default)]
struct Cell {
    /// Slices with matter, those joined to the next, and those with an obstacle.
    slices: u16,
    joined: u16,
    obstacles: u16,
    /// Lowest bottom and highest top of the spans that begin and end in a slice.
    low: [u16; SLICES as usize],
    high: [u16; SLICES as usize],
}

impl Cell {
    fn add(&mut self, bottom: u32, top: u32, obstacle: bool) {
        let (bottom, top) = (bottom / STEP_BELOW * HEIGHT_STEP, top.div_ceil(STEP_BELOW) * HEIGHT_STEP);
        let first = bottom / SLICE;
        let last = first.max(top.saturating_sub(1) / SLICE);
        let joined = ((1u32 << last) - (1 << first)) as u16;
        let slices = joined | 1 << last;
        let mut new = slices & !self.slices;
        while new != 0 {
            let slice = new.trailing_zeros() as usize;
            (self.low[slice], self.high[slice]) = (u16::MAX, 0);
            new &= new - 1;
        }
        self.slices |= slices;
        self.joined |= joined;
        self.obstacles |= if obstacle { slices } else { 0 };
        let (low, high) = (&mut self.low[first as usize], &mut self.high[last as usize]);
        *low = (*low).min(bottom as u16);
        *high = (*high).max(top as u16);
    }

    fn give(&self, pixel: u8, out: &mut Vec<CoarseSpan>) {
        let mut slices = self.slices;
        while slices != 0 {
            let first = slices.trailing_zeros() as usize;
            let mut last = first;
            while self.goes_on(last) {
                last += 1;
            }
            let own = (u16::MAX << first) & (u16::MAX >> (SLICES as usize - 1 - last));
            let obstacle = self.obstacles & own != 0;
            out.push(CoarseSpan { pixel, obstacle, bottom: self.low[first], top: self.high[last] });
            slices &= !own;
        }
    }

    /// Whether the span in `slice` goes on into the next one.
    fn goes_on(&self, slice: usize) -> bool {
        let next = slice + 1;
        let boundary = (next as u32 * SLICE) as u16;
        self.joined >> slice & 1 == 1
            || next < SLICES as usize
                && self.slices >> next & 1 == 1
                && (self.high[slice], self.low[next]) == (boundary, boundary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::pages;
    use proptest::prelude::*;

    /// The rule as the specification states it, for one pixel: join what shares a slice or a height until nothing does.
    fn joined(mut spans: Vec<(u32, u32, bool)>) -> Vec<(u32, u32, bool)> {
        let last = |span: &(u32, u32, bool)| (span.0 / SLICE).max(span.1.saturating_sub(1) / SLICE);
        spans.sort_unstable();
        loop {
            let meet = |a: &(u32, u32, bool), b: &(u32, u32, bool)| {
                (a.0 / SLICE <= last(b) && b.0 / SLICE <= last(a)) || (a.0 <= b.1 && b.0 <= a.1)
            };
            let pair =
                (0..spans.len()).flat_map(|a| (0..a).map(move |b| (a, b))).find(|&(a, b)| meet(&spans[a], &spans[b]));
            let Some((a, b)) = pair else { break };
            let other = spans.remove(a);
            let span = &mut spans[b];
            *span = (span.0.min(other.0), span.1.max(other.1), span.2 || other.2);
        }
        spans.sort_unstable();
        spans
    }

    proptest! {
        #[test]
        fn spans_join_by_the_rule_and_hold_all_matter(page in pages()) {
            let mut expected = Vec::new();
            for y in 0..PIXELS {
                for x in 0..PIXELS {
                    let below = (0..16).flat_map(|n| page.column(4 * x + n % 4, 4 * y + n / 4));
                    let moved = below.map(|s| {
                        let step = f64::from(STEP_BELOW);
                        let (bottom, top) = ((f64::from(s.bottom()) / step).floor(), (f64::from(s.top()) / step).ceil());
                        ((bottom * 85.0) as u32, (top * 85.0) as u32, s.is_obstacle())
                    });
                    expected.extend(joined(moved.collect()).into_iter().map(|(bottom, top, obstacle)| {
                        CoarseSpan { pixel: (16 * y + x) as u8, obstacle, bottom: bottom as u16, top: top as u16 }
                    }));
                }
            }
            prop_assert_eq!(coarse(&page), expected);
        }
    }
}
