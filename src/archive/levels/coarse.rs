//! Coarsening of a page for the level above: 4 × 4 pixels become one, four slices become one, heights move outwards.
//!
//! All spans of 16 pixels go into one pixel. Their bottoms move down and their tops up to thirds of a slice of the
//! level. Spans that then share a slice or a height merge into one, an obstacle if any of them is. So no solid is lost,
//! and the result does not depend on the order of spans. Pages in which few spans merge are [sparse](is_sparse); their
//! heights move on to whole slices.

use crate::codec::LEVEL_STEP;
use crate::frame::{PAGE_QUANTA, PAGE_SLICES, PageKey, SLICE_QUANTA};
use crate::page::{Page, PageBuilder, Span};

/// Pixels of a level along an edge of a pixel of the level above, and slices in one of its slices.
pub const FACTOR: u32 = 4;
const SLICE: u32 = SLICE_QUANTA as u32;
/// Pixels along an edge, slices, and quanta that a page covers in the level above.
pub const PIXELS: u32 = 64 / FACTOR;
pub const SLICES: u32 = PAGE_SLICES as u32 / FACTOR;
const QUANTA: u32 = PAGE_QUANTA as u32 / FACTOR;
const _: () = assert!(PIXELS * PIXELS == 256 && SLICES == 16);

/// A span that a page contributes to the level above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoarseSpan {
    /// `16·y + x` in the part of the upper page that the lower one covers.
    pixel: u8,
    obstacle: bool,
    /// Spans of the lower page that merged into this one (1..=1024).
    joined: u16,
    /// Heights above the lower page's floor, in quanta of the level above (0..=4080).
    bottom: u16,
    top: u16,
}

/// Returns the key of the page of the level above that covers page `key`.
pub fn above(key: PageKey) -> PageKey {
    PageKey { tx: key.tx >> 2, ty: key.ty >> 2, layer: key.layer >> 2 }
}

/// Returns the position (0..=3) of a page along an axis within its page of the level above.
pub fn part(index: i32) -> u32 {
    (index & 3) as u32
}

impl CoarseSpan {
    /// Returns pixel (`64·y + x`), bottom and top in the page of the level above of a span of page `key`.
    pub fn place(&self, key: PageKey) -> (u32, u32, u32) {
        let (x, y) = (u32::from(self.pixel) % PIXELS, u32::from(self.pixel) / PIXELS);
        let pixel = (part(key.ty) * PIXELS + y) * 64 + part(key.tx) * PIXELS + x;
        let floor = part(key.layer) * QUANTA;
        (pixel, floor + u32::from(self.bottom), floor + u32::from(self.top))
    }

    pub fn is_obstacle(&self) -> bool {
        self.obstacle
    }

    /// Returns the number of spans of the lower page that merged into this one.
    pub fn joined(&self) -> u16 {
        self.joined
    }
}

/// Returns the spans that `page` contributes to the level above, by pixel and from bottom to top. Cost: one pass over
/// its spans.
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

/// Spans of one pixel of the level, merged as they are added.
#[derive(Default)]
struct Cell {
    /// Occupied slices, those joined to the next slice, and those with an obstacle, as bit masks.
    slices: u16,
    joined: u16,
    obstacles: u16,
    /// Lowest bottom of the spans that begin in a slice, and highest top of those that end there.
    low: [u16; SLICES as usize],
    high: [u16; SLICES as usize],
    /// Number of spans that begin in a slice.
    began: [u16; SLICES as usize],
}

impl Cell {
    fn add(&mut self, bottom: u32, top: u32, obstacle: bool) {
        const STEP: u32 = FACTOR * LEVEL_STEP;
        let (bottom, top) = (bottom / STEP * LEVEL_STEP, top.div_ceil(STEP) * LEVEL_STEP);
        let first = bottom / SLICE;
        let last = first.max(top.saturating_sub(1) / SLICE);
        let joined = ((1u32 << last) - (1 << first)) as u16;
        let slices = joined | 1 << last;
        let mut new = slices & !self.slices;
        while new != 0 {
            let slice = new.trailing_zeros() as usize;
            (self.low[slice], self.high[slice], self.began[slice]) = (u16::MAX, 0, 0);
            new &= new - 1;
        }
        self.slices |= slices;
        self.joined |= joined;
        self.obstacles |= if obstacle { slices } else { 0 };
        let (low, high) = (&mut self.low[first as usize], &mut self.high[last as usize]);
        *low = (*low).min(bottom as u16);
        *high = (*high).max(top as u16);
        self.began[first as usize] += 1;
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
            let joined =
                (first..=last).filter(|slice| self.slices >> slice & 1 == 1).map(|slice| self.began[slice]).sum();
            out.push(CoarseSpan { pixel, obstacle, joined, bottom: self.low[first], top: self.high[last] });
            slices &= !own;
        }
    }

    /// Returns whether the span in `slice` continues into the next slice.
    fn goes_on(&self, slice: usize) -> bool {
        let next = slice + 1;
        let boundary = (next as u32 * SLICE) as u16;
        self.joined >> slice & 1 == 1
            || next < SLICES as usize
                && self.slices >> next & 1 == 1
                && (self.high[slice], self.low[next]) == (boundary, boundary)
    }
}

/// Returns whether a page of a level with `spans` spans is sparse: on average, fewer than four of the `below` spans
/// merged into each.
///
/// A densely scanned surface shrinks to a sixteenth of its spans. On a sparse scan each span of a level stands for two
/// or three points, and heights would cost as much as those of the points themselves.
pub fn is_sparse(spans: u64, below: u64) -> bool {
    4 * spans > below
}

/// Moves the heights of a page of a level outwards to whole slices; spans that then touch merge.
pub fn on_slices(page: &Page, builder: &mut PageBuilder) -> Page {
    builder.clear();
    let mut spans: Vec<Span> = Vec::new();
    for (px, py, column) in page.columns() {
        spans.clear();
        for span in column {
            let (bottom, top) = (span.bottom() / SLICE * SLICE, span.top().next_multiple_of(SLICE));
            let below = spans.pop_if(|below| below.top() >= bottom);
            let obstacle = span.is_obstacle() || below.is_some_and(|below| below.is_obstacle());
            spans.extend(Span::new(below.map_or(bottom, |below| below.bottom()), top, obstacle));
        }
        let taken = builder.set_column(px, py, &spans);
        debug_assert!(taken, "spans of a level are apart");
    }
    builder.build()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::pages;
    use proptest::prelude::*;

    /// Reference for one pixel, as the specification states the rule: merge spans that share a slice or a height until
    /// none do.
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
            let step = 85.0;
            let mut expected = Vec::new();
            for y in 0..PIXELS {
                for x in 0..PIXELS {
                    let below = (0..16).flat_map(|n| page.column(4 * x + n % 4, 4 * y + n / 4));
                    let moved = below.map(|s| {
                        let (bottom, top) = (f64::from(s.bottom()) / (4.0 * step), f64::from(s.top()) / (4.0 * step));
                        ((bottom.floor() * step) as u32, (top.ceil() * step) as u32, s.is_obstacle())
                    });
                    expected.extend(joined(moved.collect()).into_iter().map(|(bottom, top, obstacle)| {
                        CoarseSpan { pixel: (16 * y + x) as u8, obstacle, joined: 0, bottom: bottom as u16, top: top as u16 }
                    }));
                }
            }
            let mut found = coarse(&page);
            prop_assert_eq!(found.iter().map(|span| usize::from(span.joined)).sum::<usize>(), page.span_count());
            prop_assert!(found.iter().all(|span| span.joined > 0));
            found.iter_mut().for_each(|span| span.joined = 0);
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn on_slices_spans_join_by_the_rule(page in pages()) {
            let mut builder = PageBuilder::default();
            // Like pages of levels, with at most one span in a slice.
            for (px, py, spans) in page.columns() {
                let spans = joined(spans.iter().map(|s| (s.bottom(), s.top(), s.is_obstacle())).collect());
                let spans: Vec<_> = spans.iter().filter_map(|&(bottom, top, kind)| Span::new(bottom, top, kind)).collect();
                prop_assert!(builder.set_column(px, py, &spans));
            }
            let level = builder.build();
            let found = on_slices(&level, &mut builder);
            for (pixel, spans) in level.columns().map(|(px, py, spans)| ((px, py), spans)) {
                let moved = spans.iter().map(|s| (s.bottom() / 255 * 255, s.top().div_ceil(255) * 255, s.is_obstacle()));
                let expected = joined(moved.collect());
                let found = found.column(pixel.0, pixel.1).iter().map(|s| (s.bottom(), s.top(), s.is_obstacle()));
                prop_assert_eq!(found.collect::<Vec<_>>(), expected);
            }
            prop_assert_eq!(found.columns().count(), level.columns().count());
        }
    }
}
