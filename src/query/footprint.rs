//! Traversal shared by all footprint queries: tile columns under a shape, and their pages.

use super::blocks::{self, Kinds, MATTER, PageUnder};
use super::grid::sealed::OnPixels;
use super::grid::{Heights, Rect};
use super::scan;
use super::simd::Window;
use crate::frame::{PAGE_QUANTA, PageKey, TILE_PIXELS};
use crate::page::Page;
use crate::store::{Missing, note};
use crate::store::{PageSlot, Snapshot};
use std::ops::ControlFlow;

/// A tile column under a shape.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub tx: i32,
    pub ty: i32,
    /// First pixel of the tile.
    pub i: i64,
    pub j: i64,
    /// Blocks that the shape's rectangle meets.
    pub blocks: u64,
}

impl Tile {
    #[inline]
    fn new(tx: i32, ty: i32, rect: Rect) -> Self {
        let (i, j) = (i64::from(tx) * TILE_PIXELS, i64::from(ty) * TILE_PIXELS);
        Self { tx, ty, i, j, blocks: rect.bits(i, j, 3) }
    }

    pub fn key(&self, layer: i32) -> PageKey {
        PageKey { tx: self.tx, ty: self.ty, layer }
    }

    #[inline]
    pub fn place<'a>(&self, page: &'a Page, layer: i32) -> PageUnder<'a> {
        PageUnder { page, i: self.i, j: self.j, base: floor_of(layer), blocks: self.blocks }
    }
}

/// Returns the height of a layer's floor (quanta).
#[inline]
pub(super) fn floor_of(layer: i32) -> i64 {
    i64::from(layer) * PAGE_QUANTA
}

/// Calls `f` for every tile column of `set` that `rect` meets, until it breaks. Never visits more tiles than the set
/// has columns, regardless of the rectangle's size.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn for_each_column(set: &Snapshot, rect: Rect, mut f: impl FnMut(&Tile, &[PageSlot]) -> ControlFlow<()>) {
    let Some(bounds) = set.bounds() else { return };
    let tiles = |first: i64, last: i64, axis: usize| {
        ((first >> 6).max(i64::from(bounds.min[axis])), (last >> 6).min(i64::from(bounds.max[axis])))
    };
    let ((tx0, tx1), (ty0, ty1)) = (tiles(rect.i0, rect.i1, 0), tiles(rect.j0, rect.j1, 1));
    if tx0 > tx1 || ty0 > ty1 {
        return;
    }
    // Inside the bounds, indices fit `i32` and their counts fit 33 bits.
    let few = tx1 - tx0 <= 1 && ty1 - ty0 <= 1;
    if !few && (tx1 - tx0 + 1).saturating_mul(ty1 - ty0 + 1) > set.column_count() as i64 {
        return among_all_columns(set, rect, [tx0, tx1, ty0, ty1], &mut f);
    }
    let (mut tx, mut ty) = (tx0, ty0);
    loop {
        let slots = set.column(tx as i32, ty as i32);
        if !slots.is_empty() && f(&Tile::new(tx as i32, ty as i32, rect), slots).is_break() {
            return;
        }
        tx += 1;
        if tx > tx1 {
            (tx, ty) = (tx0, ty + 1);
            if ty > ty1 {
                return;
            }
        }
    }
}

/// Calls `f` for those columns of `set` that lie in `tx0..=tx1`, `ty0..=ty1`. A separate function, so that `f` is
/// inlined in the common case.
#[inline(never)]
fn among_all_columns(
    set: &Snapshot,
    rect: Rect,
    [tx0, tx1, ty0, ty1]: [i64; 4],
    f: &mut impl FnMut(&Tile, &[PageSlot]) -> ControlFlow<()>,
) {
    for number in 0..set.column_count() {
        let (tx, ty, slots) = set.column_at(number);
        let under = (tx0..=tx1).contains(&i64::from(tx)) && (ty0..=ty1).contains(&i64::from(ty));
        if under && f(&Tile::new(tx, ty, rect), slots).is_break() {
            return;
        }
    }
}

/// Returns those of `slots` whose pages can hold a span that meets `heights`; a top on a page's floor belongs to the
/// page below.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn layers(slots: &[PageSlot], heights: Heights) -> impl DoubleEndedIterator<Item = &PageSlot> + Clone {
    let below = move |slot: &PageSlot| floor_of(slot.layer()) + PAGE_QUANTA < heights.low;
    let above = move |slot: &PageSlot| floor_of(slot.layer()) > heights.high;
    // Most columns have few layers, and testing each is faster than a search.
    let (mut first, mut end) = (0, slots.len());
    if slots.len() > 8 {
        first = slots.partition_point(below);
        end = slots.partition_point(|slot| !above(slot)).max(first);
    }
    slots[first..end].iter().filter(move |slot| !below(slot) & !above(slot))
}

/// Returns whether pixel (`i`, `j`) holds solid at `heights`. For a box in one pixel, or a point, the block's mask and its
/// first unions rule most places out without a look at spans.
pub(super) fn touches_in_pixel(
    set: &Snapshot,
    (i, j): (i64, i64),
    heights: Heights,
    missing: &mut Option<Missing>,
) -> bool {
    let (Ok(tx), Ok(ty)) = (i32::try_from(i >> 6), i32::try_from(j >> 6)) else { return false };
    let (px, py) = ((i & 63) as u32, (j & 63) as u32);
    for slot in layers(set.column(tx, ty), heights) {
        let base = floor_of(slot.layer());
        let (low, high) = (blocks::local(heights.low, base), blocks::local(heights.high, base));
        match slot.page() {
            Some(page) => {
                let block = page.block(px >> 3, py >> 3);
                let (x, y) = (px & 7, py & 7);
                // One branch, which is seldom taken.
                let (first, more) = block.union_quads();
                let unions = scan::meeting(std::slice::from_ref(first), u32::from(!more.is_empty()), low, high);
                let may = u64::from(unions) & block.pixels() >> (8 * y + x) & 1;
                if may != 0 && Window::new([x, x], low, high).kinds(block.rows(y, y), MATTER) != 0 {
                    return true;
                }
            }
            None if slot.slices() & blocks::slices_between(low, high) != 0 => {
                note(missing, PageKey { tx, ty, layer: slot.layer() });
            }
            None => {}
        }
    }
    false
}

/// Collects the classes that a shape touches.
pub(super) struct Touch {
    heights: Heights,
    until: Kinds,
    pub found: Kinds,
}

impl Touch {
    /// Starts collecting the classes that `shape` touches, until one of those in `until` is found.
    #[inline]
    pub fn new<G: OnPixels>(shape: &G, until: Kinds) -> Self {
        Self { heights: shape.heights(), until, found: 0 }
    }

    /// Returns whether one of the classes in `until` is found.
    #[inline]
    pub fn done(&self) -> bool {
        self.found & self.until != 0
    }

    /// Tests the pages of one tile column; breaks if one of the classes in `until` is found.
    #[cfg_attr(target_family = "wasm", inline)]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    pub fn column<G: OnPixels>(
        &mut self,
        shape: &G,
        tile: &Tile,
        slots: &[PageSlot],
        missing: &mut Option<Missing>,
    ) -> ControlFlow<()> {
        for slot in layers(slots, self.heights) {
            let base = floor_of(slot.layer());
            let (low, high) = (blocks::local(self.heights.low, base), blocks::local(self.heights.high, base));
            if slot.slices() & blocks::slices_between(low, high) == 0 {
                continue;
            }
            let Some(page) = slot.page() else {
                note(missing, tile.key(slot.layer()));
                continue;
            };
            self.found |= blocks::touched(&tile.place(page, slot.layer()), shape, low, high, self.until);
            if self.done() {
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::page::{PageBuilder, Span};
    use crate::query::{Aabb, Answer, Overlap, Probe, ceiling_above, floor_under, overlaps, probe};
    use nalgebra::{Point3, Vector3};

    /// Pages with a span in one pixel, from height 1000 to 1100; quanta of 2⁻¹⁰ m.
    fn store(keys: impl IntoIterator<Item = PageKey>) -> Snapshot {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(0, 0, &[Span::new(1000, 1100, false).unwrap()]));
        let page = builder.build();
        let frame = Frame::new(0.0625, 255.0 / 1024.0).unwrap();
        Snapshot::from_pages(frame, keys.into_iter().map(|key| (key, page.clone())))
    }

    #[test]
    fn layers_are_those_whose_pages_can_hold_a_span_at_the_heights() {
        for count in [1, 8, 9, 30] {
            // Every other layer has no page.
            let numbers: Vec<i32> = (0..count).map(|n| 2 * n - 5).collect();
            let set = store(numbers.iter().map(|&layer| PageKey { tx: 0, ty: 0, layer }));
            for low in (-7..2 * count - 3).flat_map(|layer| [-1, 0, 1].map(|n| floor_of(layer) + n)) {
                for high in [-1, 0, 1, PAGE_QUANTA, 5 * PAGE_QUANTA, 1 << 40].map(|height| low + height) {
                    let found = layers(set.column(0, 0), Heights { low, high }).map(PageSlot::layer);
                    let meets = |&layer: &i32| floor_of(layer) <= high && low <= floor_of(layer + 1);
                    assert!(found.eq(numbers.iter().copied().filter(meets)), "{count} layers, {low} to {high}");
                }
            }
        }
    }

    /// A rectangle across the whole grid would take minutes tile by tile, however narrow it is.
    #[test]
    fn the_columns_under_a_rectangle_are_visited_and_no_more_tiles_than_the_set_has_columns() {
        let end = (1 << 30) - 1;
        let columns = [[-end, -end], [0, 0], [0, 5], [3, 0], [end, end]];
        let set = store(columns.map(|[tx, ty]| PageKey { tx, ty, layer: 0 }));
        let check = |[i0, i1]: [i64; 2], [j0, j1]: [i64; 2], expected: &[[i32; 2]]| {
            let mut visited = Vec::new();
            for_each_column(&set, Rect { i0, i1, j0, j1 }, |tile, _| {
                visited.push([tile.tx, tile.ty]);
                ControlFlow::Continue(())
            });
            visited.sort_unstable();
            assert_eq!(visited, expected, "{i0} to {i1}, {j0} to {j1}");
        };
        let all = [-1 << 50, 1 << 50];
        check(all, all, &columns);
        check([0, 127], [0, 127], &[[0, 0]]);
        check([0, 192], [0, 10], &[[0, 0], [3, 0]]);
        check([-1, 192], [63, 64], &[[0, 0], [3, 0]]);
        check([63, 64], [-1, 320], &[[0, 0], [0, 5]]);
        for first in [0, 20, 40] {
            check([first, first + 9], all, &[[0, 0], [0, 5]]);
            check(all, [first, first + 9], &[[0, 0], [3, 0]]);
            check([first + 192, first + 200], all, &[[3, 0]]);
            check(all, [first + 320, first + 328], &[[0, 5]]);
        }
    }

    #[test]
    fn a_missing_page_without_solid_at_the_heights_does_not_matter() {
        let key = PageKey { tx: 0, ty: 0, layer: 0 };
        let set = store([key]).keep_loaded(|_| false);
        let metres = |quanta: u32| f64::from(quanta) / 1024.0;
        // In one pixel, in one tile, and across tiles.
        for size in [0.0, 0.5, 20.0] {
            let at = |low: u32, high: u32| {
                let min = Point3::new(0.01, 0.01, metres(low));
                Aabb::new(min, min + Vector3::new(size, size, metres(high - low))).unwrap()
            };
            for shape in [at(0, 500), at(2000, 3000)] {
                assert_eq!(overlaps(&set, &shape), Overlap::Clear, "{shape:?}");
            }
            assert!(matches!(overlaps(&set, &at(1050, 1060)), Overlap::NotLoaded(missing) if missing.keys() == [key]));
            assert_eq!(probe(&set, &at(0, 500)), Answer::Known(Probe::default()));
            for (from, depth, waits) in [(500, f64::INFINITY, false), (3000, 1.0, false), (3000, 2.0, true)] {
                let answer = floor_under(&set, &at(0, 0), metres(from), depth);
                assert_eq!(answer.known(), (!waits).then_some(None), "floor from {from} by {depth}");
            }
            for (from, height, waits) in [(2000, f64::INFINITY, false), (0, 0.5, false), (0, 1.0, true)] {
                let answer = ceiling_above(&set, &at(0, 0), metres(from), height);
                assert_eq!(answer.known(), (!waits).then_some(None), "ceiling from {from} by {height}");
            }
        }
    }
}
