//! The lowest ceiling above a footprint.

use super::answer::Answer;
use super::blocks::{PageUnder, for_each_bit, local, slices_between};
use super::footprint::{Tile, floor_of, for_each_column, layers};
use super::grid::sealed::OnPixels;
use super::grid::{Heights, Shape};
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA};
use crate::store::{Missing, note};
use crate::store::{PageSlot, Snapshot};
use std::ops::ControlFlow;

/// Returns the world height (m) of the lowest ceiling above the footprint of `shape`, from height `from` (m) up to
/// `from + height` [m, >= 0, may be infinite]; `None` if there is no ceiling.
///
/// A ceiling is the underside of a solid of either class: the bottom of a span on which no other span of the same pixel
/// ends. A span cut by a page boundary counts as one. The answer is not above the ceiling's lowest point and at most
/// one quantum (slice height / 255) below it. As in [`floor_under`](super::floor_under), `from` is compared in quanta.
/// A NaN finds nothing.
///
/// Cost: like [`overlaps`](super::overlaps), over the layers from `from` up to the first ceiling.
pub fn ceiling_above<H: Shape>(set: &Snapshot, shape: &H, from: f64, height: f64) -> Answer<Option<f64>> {
    // A separate case, because infinity minus infinity is NaN.
    let highest = if height == f64::INFINITY { f64::INFINITY } else { from + height };
    ceiling_between(set, shape, from, highest)
}

/// Like [`ceiling_above`], but from height `low` up to `high` (m, both may be infinite). For programs that have both:
/// `low + (high - low)` may round below a ceiling at `high`.
#[doc(hidden)]
pub fn ceiling_between<H: Shape>(set: &Snapshot, shape: &H, low: f64, high: f64) -> Answer<Option<f64>> {
    if low.is_nan() || high.is_nan() {
        return Answer::Known(None);
    }
    let frame = set.frame();
    let search = CeilingSearch::new(frame.quantum_ceil(low), frame.quantum_floor(high));
    let search = search.run(set, &shape.on_grid(frame));
    Answer::new(search.best.map(|bottom| frame.bottom_height(bottom)), search.missing)
}

/// Searches for the lowest ceiling at or above `from`: a bottom on which no other span of its column ends.
struct CeilingSearch {
    /// Least bottom that counts (quanta).
    from: i64,
    /// Greatest bottom that counts; falls with every ceiling found.
    most: i64,
    best: Option<i64>,
    missing: Option<Missing>,
}

impl CeilingSearch {
    /// Creates a search for bottoms from `from` to `most` (quanta).
    fn new(from: i64, most: i64) -> Self {
        Self { from, most, best: None, missing: None }
    }

    /// Searches all tile columns under `shape`; reports only those missing pages that could hold a lower ceiling.
    fn run<G: OnPixels>(mut self, set: &Snapshot, shape: &G) -> Self {
        for_each_column(set, shape.rect(), |tile, slots| {
            self.column(shape, tile, slots);
            ControlFlow::Continue(())
        });
        match (self.missing, self.best) {
            (Some(_), Some(best)) => {
                let again = Self { missing: None, best: None, ..self }.run(set, shape);
                Self { best: again.best.or(Some(best)), ..again }
            }
            _ => self,
        }
    }

    /// Searches the pages of one tile column, from the bottom up.
    fn column<G: OnPixels>(&mut self, shape: &G, tile: &Tile, slots: &[PageSlot]) {
        if self.from > self.most {
            return;
        }
        // Begin in the page below, on which an underside on a page's floor depends.
        let heights = Heights { low: self.from.saturating_sub(1), high: self.most };
        let mut below: Option<&PageSlot> = None;
        for slot in layers(slots, heights) {
            let base = floor_of(slot.layer());
            if base > self.most {
                break;
            }
            let (from, most) = (local(self.from, base), local(self.most, base));
            let in_range = base + PAGE_QUANTA > self.from;
            if in_range && slot.slices() & slices_between(from, most) != 0 {
                let below = below.filter(|below| below.layer() + 1 == slot.layer());
                match slot.page() {
                    Some(page) => {
                        let place = tile.place(page, slot.layer());
                        let found = lowest_underside(&place, shape, from, most, below, || {
                            note(&mut self.missing, tile.key(slot.layer() - 1));
                        });
                        if let Some(bottom) = found {
                            self.best = Some(base + i64::from(bottom));
                            self.most = base + i64::from(bottom) - 1;
                        }
                    }
                    None => note(&mut self.missing, tile.key(slot.layer())),
                }
            }
            below = Some(slot);
        }
    }
}

/// Returns the lowest underside of the page from `from` to `most` [0..=16320] in the footprint. Calls `unknown` if an
/// underside on the page's floor depends on the page below and that page is not in memory.
fn lowest_underside<G: OnPixels>(
    place: &PageUnder<'_>,
    shape: &G,
    from: u32,
    mut most: u32,
    below: Option<&PageSlot>,
    mut unknown: impl FnMut(),
) -> Option<u32> {
    let mut best = None;
    for_each_bit(place.blocks_between(from, most), |number| {
        let block = place.page.block_at(number);
        if best == Some(from) || !block.unions().any(|span| span.meets(from, most)) {
            return;
        }
        let (i, j) = place.corner(number);
        let pixels = shape.mask(i, j) & block.pixels();
        // Every bottom inside a slice is an underside; the lowest one of all pixels is that of the lowest union.
        let first = block.unions().map(|span| span.bottom()).next().unwrap_or(0);
        if pixels == block.pixels() && first >= from && !first.is_multiple_of(SLICE_QUANTA as u32) {
            best = Some(first);
            most = first - 1;
            return;
        }
        for_each_bit(pixels, |bit| {
            let (px, py) = ((number & 7) << 3 | bit & 7, number & 56 | bit >> 3);
            let mut ended = None;
            for span in block.column(bit).iter().take_while(|span| span.bottom() <= most) {
                let bottom = span.bottom();
                if bottom >= from && ended != Some(bottom) && !(bottom == 0 && hangs_on(below, px, py, &mut unknown)) {
                    best = Some(bottom);
                    // `most` may fall below `from`; then nothing more is found.
                    most = bottom.saturating_sub(1);
                    break;
                }
                ended = Some(span.top());
            }
        });
    });
    best
}

/// Returns whether a span of the page below reaches that page's end in pixel (`px`, `py`).
fn hangs_on(below: Option<&PageSlot>, px: u32, py: u32, unknown: &mut impl FnMut()) -> bool {
    let Some(below) = below else { return false };
    match below.page() {
        Some(page) => page.column(px, py).last().is_some_and(|span| i64::from(span.top()) == PAGE_QUANTA),
        None if below.slices() >> 63 == 0 => false,
        None => {
            unknown();
            true
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::query::Aabb;
    use nalgebra::Point3;

    const LOWEST: PageKey = PageKey { tx: 0, ty: 0, layer: 0 };

    /// Pixels of 2⁻⁴ m and quanta of 2⁻¹⁰ m; each page has one span, in all its pixels.
    fn store(pages: &[(PageKey, [u32; 2])]) -> Snapshot {
        let page = |&(key, [bottom, top]): &(PageKey, [u32; 2])| {
            let mut builder = PageBuilder::default();
            for n in 0..64 * 64 {
                assert!(builder.set_column(n % 64, n / 64, &[Span::new(bottom, top, false).unwrap()]));
            }
            (key, builder.build())
        };
        Snapshot::from_pages(Frame::new(0.0625, 255.0 / 1024.0).unwrap(), pages.iter().map(page))
    }

    /// The ceiling above `from` (quanta) over the last pixels of tile column (0, 0) and the first ones of (1, 0).
    fn ceiling(store: &Snapshot, from: i64) -> Answer<Option<f64>> {
        let shape = Aabb::new(Point3::new(3.9, 1.0, 0.0), Point3::new(4.1, 1.2, 0.0)).unwrap();
        ceiling_above(store, &shape, from as f64 / 1024.0, f64::INFINITY)
    }

    fn known(bottom: i64) -> Answer<Option<f64>> {
        Answer::Known(Some(bottom as f64 / 1024.0))
    }

    fn waits_for(answer: Answer<Option<f64>>, key: PageKey) -> bool {
        matches!(answer, Answer::NotLoaded(missing) if missing.keys() == [key])
    }

    #[test]
    fn a_missing_page_that_ends_where_the_search_begins_matters_only_to_what_may_hang_on_it() {
        let without_lowest = |pages: &[(PageKey, [u32; 2])]| store(pages).keep_loaded(|key| key != LOWEST);
        let above = (PageKey { layer: 1, ..LOWEST }, [0, 50]);
        let full = (LOWEST, [16000, 16320]);
        let alone = without_lowest(&[full]);
        assert_eq!(ceiling(&alone, PAGE_QUANTA), Answer::Known(None));
        assert!(waits_for(ceiling(&alone, PAGE_QUANTA - 1), LOWEST));
        assert!(waits_for(ceiling(&without_lowest(&[full, above]), PAGE_QUANTA), LOWEST));
        // Nothing in the page's last slice, so nothing hangs on it.
        let low = (LOWEST, [100, 140]);
        assert_eq!(ceiling(&without_lowest(&[low, above]), PAGE_QUANTA), known(PAGE_QUANTA));
        assert_eq!(ceiling(&store(&[full, above]), PAGE_QUANTA), Answer::Known(None));
        assert_eq!(ceiling(&store(&[low, above]), PAGE_QUANTA), known(PAGE_QUANTA));
    }

    #[test]
    fn a_missing_page_above_the_ceiling_is_no_hindrance_wherever_the_search_begins() {
        let key = |tx, layer| PageKey { tx, ty: 0, layer };
        for [low, high] in [[key(0, 0), key(1, 1)], [key(1, 0), key(0, 1)]] {
            let all = store(&[(low, [100, 140]), (high, [100, 140])]);
            assert_eq!(ceiling(&all, 0), known(100));
            assert_eq!(ceiling(&all.keep_loaded(|key| key == low), 0), known(100), "{high} is not needed");
            assert!(waits_for(ceiling(&all.keep_loaded(|key| key == high), 0), low), "{low} is needed");
        }
    }
}
