//! The highest floor under a footprint.

use super::answer::Answer;
use super::blocks::{PageUnder, for_each_bit, for_each_strip, local, slices_between};
use super::footprint::{Tile, floor_of, for_each_column, layers};
use super::grid::sealed::OnPixels;
use super::grid::{Heights, Shape};
use super::scan::{select, top_in_lanes};
use crate::frame::{Frame, PAGE_QUANTA};
use crate::page::{BlockView, Page, Span};
use crate::store::{Missing, note};
use crate::store::{PageSlot, Snapshot};
use std::ops::ControlFlow;

/// Returns the world height (m) of the highest floor under the footprint of `shape`, from height `from` (m) down to
/// `from - depth` [m, >= 0, may be infinite]; `None` if there is no floor.
///
/// Floor is the top of a span that is not an obstacle. The pixels that the shape's footprint touches count; the shape's
/// own heights do not. The answer is not below the floor's highest point and at most one quantum (slice height / 255)
/// above it. `from` is compared in quanta: a floor in the same quantum as `from` is found. A span cut by a page
/// boundary counts as one. A NaN finds nothing.
///
/// Cost: like [`overlaps`](super::overlaps), over the layers from `from` down to the first floor.
pub fn floor_under<H: Shape>(set: &Snapshot, shape: &H, from: f64, depth: f64) -> Answer<Option<f64>> {
    // A separate case, because infinity minus infinity is NaN.
    let lowest = if depth == f64::INFINITY { f64::NEG_INFINITY } else { from - depth };
    floor_between(set, shape, lowest, from)
}

/// Like [`floor_under`], but from height `high` down to `low` (m, both may be infinite). For programs that have both:
/// `high - (high - low)` may round above a floor at `low`.
#[doc(hidden)]
pub fn floor_between<H: Shape>(set: &Snapshot, shape: &H, low: f64, high: f64) -> Answer<Option<f64>> {
    if low.is_nan() || high.is_nan() {
        return Answer::Known(None);
    }
    let frame = set.frame();
    let search = FloorSearch::new(frame.quantum_ceil(low), frame.quantum_floor(high));
    search.run(set, &shape.on_grid(frame)).answer(frame)
}

/// Searches for the highest top of a floor span at or below `limit`.
#[derive(Clone, Copy)]
pub(super) struct FloorSearch {
    /// Greatest top that counts (quanta).
    limit: i64,
    /// Least top that counts; grows with every floor found.
    least: i64,
    best: Option<i64>,
    pub missing: Option<Missing>,
}

impl FloorSearch {
    /// Creates a search for tops from `least` to `limit` (quanta).
    pub fn new(least: i64, limit: i64) -> Self {
        Self { limit, least, best: None, missing: None }
    }

    /// Searches all tile columns under `shape`.
    #[inline]
    fn run<G: OnPixels>(mut self, set: &Snapshot, shape: &G) -> Self {
        for_each_column(set, shape.rect(), |tile, slots| {
            self.column(shape, tile, slots);
            ControlFlow::Continue(())
        });
        self.settle(set, shape)
    }

    /// Ends a search over all tile columns: keeps only those missing pages that could hold a higher floor than the one
    /// found.
    #[inline]
    pub fn settle<G: OnPixels>(self, set: &Snapshot, shape: &G) -> Self {
        match (self.missing, self.best) {
            (Some(_), Some(_)) => Self { missing: None, best: None, ..self }.run(set, shape).or(self.best),
            _ => self,
        }
    }

    fn or(self, best: Option<i64>) -> Self {
        Self { best: self.best.or(best), ..self }
    }

    /// Returns the world height of the floor found (m).
    pub fn floor_z(&self, frame: &Frame) -> Option<f64> {
        self.best.map(|top| frame.top_height(top))
    }

    fn answer(self, frame: &Frame) -> Answer<Option<f64>> {
        Answer::new(self.floor_z(frame), self.missing)
    }

    /// Searches the pages of one tile column, from the top down.
    #[inline]
    pub fn column<G: OnPixels>(&mut self, shape: &G, tile: &Tile, slots: &[PageSlot]) {
        if self.least > self.limit {
            return;
        }
        let heights = Heights { low: self.least, high: self.limit };
        let mut above: Option<&PageSlot> = None;
        for slot in layers(slots, heights).rev() {
            let base = floor_of(slot.layer());
            if base + PAGE_QUANTA < self.least {
                break;
            }
            let (least, limit) = (local(self.least, base), local(self.limit, base));
            if slot.slices() & slices_between(least, limit) != 0 {
                match slot.page() {
                    Some(page) => {
                        let above = above.filter(|above| above.layer() == slot.layer() + 1);
                        let place = tile.place(page, slot.layer());
                        if let Some(top) = highest_top(&place, shape, least, limit, above) {
                            self.best = Some(base + i64::from(top));
                            self.least = base + i64::from(top) + 1;
                        }
                    }
                    None => note(&mut self.missing, tile.key(slot.layer())),
                }
            }
            above = Some(slot);
        }
    }
}

/// Returns the highest top, from `least` to `limit` [0..=16320], of a floor span of the page in the footprint.
#[inline]
fn highest_top<G: OnPixels>(
    place: &PageUnder<'_>,
    shape: &G,
    mut least: u32,
    limit: u32,
    above: Option<&PageSlot>,
) -> Option<u32> {
    const END: u32 = PAGE_QUANTA as u32;
    // A span that ends at the page's end may continue in the page above, so its pixel needs a closer look.
    let inner_limit = limit.min(END - 1);
    let mut best = None;
    let mut found = |highest: u32, least: &mut u32| {
        if highest > *least {
            best = Some(highest - 1);
            *least = highest;
        }
    };
    // Blocks inside the footprint come first: their unions suffice, and raise `least` for the other blocks.
    let mut cut = 0u64;
    let mut unions = [0u16; 64];
    let mut highest_cut = (0, 0);
    for_each_bit(place.blocks_between(least, limit), |number| {
        let top = highest_union(place.page.block_at(number), limit);
        if top <= least {
            return;
        }
        let (i, j) = place.corner(number);
        if top <= inner_limit + 1 && shape.holds(i, j) {
            return found(top, &mut least);
        }
        cut |= 1 << number;
        unions[number as usize & 63] = top as u16;
        if top > highest_cut.0 {
            highest_cut = (top, number);
        }
    });
    // Then the block with the highest union: its floor usually rules out the rest.
    let first = cut & 1u64.checked_shl(highest_cut.1).unwrap_or(0);
    [first, cut & !first].into_iter().for_each(|blocks| {
        for_each_bit(blocks, |number| {
            let by_union = u32::from(unions[number as usize & 63]);
            if by_union <= least {
                return;
            }
            let block = place.page.block_at(number);
            let (i, j) = place.corner(number);
            let mask = shape.mask(i, j);
            let pixels = mask & block.pixels();
            if pixels == block.pixels() && by_union <= inner_limit + 1 {
                return found(by_union, &mut least);
            }
            let mut highest = 0;
            for_each_strip(mask, |strip| {
                let rows = block.rows(strip.y0, strip.y1);
                highest = highest.max(top_in_lanes(rows, strip.x0, strip.x1, inner_limit, by_union));
            });
            let ends = |bit: u32| block.column(bit).last().is_some_and(|span| !span.is_obstacle() && span.top() == END);
            if limit == END && by_union > END {
                for_each_bit(pixels, |bit| {
                    let (px, py) = ((number & 7) << 3 | bit & 7, number & 56 | bit >> 3);
                    if highest <= END && ends(bit) && !goes_on(above, px, py) {
                        highest = END + 1;
                    }
                });
            }
            found(highest, &mut least);
        })
    });
    best
}

/// Returns the highest top, plus 1, of a union of floor spans that begins at or below `limit`, or 0 without one. The
/// top itself may lie above `limit`.
#[inline]
fn highest_union(block: BlockView<'_>, limit: u32) -> u32 {
    let (first, more) = block.union_quads();
    let highest = |highest: u32, quad: &[Span; 4]| {
        let tops = quad.map(|span| (span.top() + 1) & select(!span.is_obstacle() & (span.bottom() <= limit)));
        highest.max(tops[0].max(tops[1]).max(tops[2].max(tops[3])))
    };
    more.iter().fold(highest(0, first), highest)
}

/// Returns whether floor that ends at the page's end in pixel (`px`, `py`) continues in the page above. If that page is
/// not in memory, the search, which runs from the top down, has already noted it as missing.
fn goes_on(above: Option<&PageSlot>, px: u32, py: u32) -> bool {
    let Some(above) = above else { return false };
    match above.page() {
        Some(page) => starts_with_floor(page, px, py),
        None => above.slices() & 1 != 0,
    }
}

fn starts_with_floor(page: &Page, px: u32, py: u32) -> bool {
    page.column(px, py).first().is_some_and(|span| span.bottom() == 0 && !span.is_obstacle())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::PageKey;
    use crate::page::PageBuilder;
    use crate::query::{Cylinder, Sphere};
    use nalgebra::Point3;

    #[test]
    fn floor_at_a_pages_end_ends_there_if_the_page_above_begins_higher() {
        let frame = Frame::new(0.0625, 255.0 / 1024.0).unwrap();
        let page = |bottom: u32, top: u32| {
            let mut page = PageBuilder::default();
            for n in 0..64 * 64 {
                assert!(page.set_column(n % 64, n / 64, &[Span::new(bottom, top, false).unwrap()]));
            }
            page.build()
        };
        let key = |layer: i32| PageKey { tx: 0, ty: 0, layer };
        let end = PAGE_QUANTA as u32;
        let store = Snapshot::from_pages(frame, [(key(0), page(end - 20, end)), (key(1), page(300, 310))]);
        let shape = Cylinder::new(Point3::new(2.0, 2.0, 0.0), 0.5, 1.0).unwrap();
        let height = f64::from(end) / 1024.0;
        for set in [store.clone(), store.keep_loaded(|key| key.layer == 0)] {
            assert_eq!(floor_under(&set, &shape, height, f64::INFINITY), Answer::Known(Some(height)));
        }
    }

    #[test]
    fn the_floor_under_a_round_shape_is_that_of_the_pixels_that_it_touches() {
        // Pixels of 2⁻⁴ m and quanta of 2⁻¹⁰ m, so that all numbers are exact.
        let frame = Frame::new(0.0625, 255.0 / 1024.0).unwrap();
        // A bowl around the middle of the page: a block that the rim cuts has higher floor outside.
        let top = |px: u32, py: u32| 10 + ((2 * px).abs_diff(63).pow(2) + (2 * py).abs_diff(63).pow(2)) / 8;
        let pixels = || (0..64).flat_map(|py| (0..64).map(move |px| (px, py)));
        let mut page = PageBuilder::default();
        for (px, py) in pixels() {
            assert!(page.set_column(px, py, &[Span::new(top(px, py) - 5, top(px, py), false).unwrap()]));
        }
        let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, page.build())]);
        let middle = Point3::new(2.0, 2.0, 0.0);
        // From the middle to the nearest edge of a row or column of pixels.
        let away = |p: u32| f64::from(p.saturating_sub(32).max(31u32.saturating_sub(p)));
        for radius in [0.5, 1.3, 2.7, 5.6, 10.4, 20.9, 30.2] {
            let cylinder = Cylinder::new(middle, radius / 16.0, 1.0).unwrap();
            let sphere = Sphere::new(middle, radius / 16.0).unwrap();
            for limit in [9, 12, 100, 300, 2000] {
                let touched = pixels().filter(|&(px, py)| away(px).hypot(away(py)) <= radius);
                let highest = touched.map(|(px, py)| top(px, py)).filter(|&top| top <= limit).max();
                let expected = Answer::Known(highest.map(|top| f64::from(top) / 1024.0));
                let from = f64::from(limit) / 1024.0;
                let what = format!("radius {radius}, from {limit}");
                assert_eq!(floor_under(&store, &cylinder, from, f64::INFINITY), expected, "cylinder, {what}");
                assert_eq!(floor_under(&store, &sphere, from, f64::INFINITY), expected, "sphere, {what}");
            }
        }
    }
}
