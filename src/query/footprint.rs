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
