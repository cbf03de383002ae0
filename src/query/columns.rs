//! The walk that all footprint queries share: tile columns under a shape, and the pages in them.

use super::blocks::{self, Kinds, Place};
use super::grid::sealed::OnPixels;
use super::grid::{Heights, Rect};
use super::missing::{Missing, note};
use crate::frame::{PAGE_QUANTA, PageKey, TILE_PIXELS};
use crate::slice::Page;
use crate::store::{PageSet, PageSlot};
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
    pub fn place<'a>(&self, page: &'a Page, layer: i32) -> Place<'a> {
        Place { page, i: self.i, j: self.j, base: floor_of(layer), blocks: self.blocks }
    }
}

/// Height of a layer's floor [quanta].
#[inline]
pub(super) fn floor_of(layer: i32) -> i64 {
    i64::from(layer) * PAGE_QUANTA
}

/// Calls `f` for every tile column of `set` that `rect` meets, until it breaks. Never visits more tiles than the set
/// has columns, however large the rectangle.
#[inline]
pub(super) fn for_each_column<S: PageSet>(
    set: &S,
    rect: Rect,
    mut f: impl FnMut(&Tile, &[S::Slot]) -> ControlFlow<()>,
) {
    let Some(bounds) = set.bounds() else { return };
    let tiles = |first: i64, last: i64, axis: usize| {
        let first = (first >> 6).max(i64::from(bounds.min[axis])) as i32;
        let last = (last >> 6).min(i64::from(bounds.max[axis])) as i32;
        (first, last)
    };
    let clamp = |value: i64| value.clamp(i64::from(i32::MIN) << 6, i64::from(i32::MAX) << 6);
    let (tx0, tx1) = tiles(clamp(rect.i0), clamp(rect.i1), 0);
    let (ty0, ty1) = tiles(clamp(rect.j0), clamp(rect.j1), 1);
    if tx0 > tx1 || ty0 > ty1 {
        return;
    }
    let tiles = (u64::from(tx1.abs_diff(tx0)) + 1).saturating_mul(u64::from(ty1.abs_diff(ty0)) + 1);
    if tiles <= 4 || tiles <= set.column_count() as u64 {
        for ty in ty0..=ty1 {
            for tx in tx0..=tx1 {
                let slots = set.column(tx, ty);
                if !slots.is_empty() && f(&Tile::new(tx, ty, rect), slots).is_break() {
                    return;
                }
            }
        }
    } else {
        for number in 0..set.column_count() {
            let (tx, ty, slots) = set.column_at(number);
            let under = (tx0..=tx1).contains(&tx) && (ty0..=ty1).contains(&ty);
            if under && f(&Tile::new(tx, ty, rect), slots).is_break() {
                return;
            }
        }
    }
}

/// Those of `slots` with layers `first..=last`.
#[inline]
pub(super) fn layers<T: PageSlot>(slots: &[T], first: i64, last: i64) -> impl DoubleEndedIterator<Item = &T> + Clone {
    // Most columns have a few layers: looking at each is faster than searching.
    let (mut below, mut until) = (0, slots.len());
    if slots.len() > 8 {
        below = slots.partition_point(|slot| i64::from(slot.layer()) < first);
        until = slots.partition_point(|slot| i64::from(slot.layer()) <= last).max(below);
    }
    slots[below..until].iter().filter(move |slot| (first..=last).contains(&i64::from(slot.layer())))
}

/// First and last layer that can hold matter meeting `heights`: a top on a page's floor lies in the page below.
#[inline]
pub(super) fn layers_of(heights: Heights) -> (i64, i64) {
    (heights.low.saturating_sub(1).div_euclid(PAGE_QUANTA), heights.high.div_euclid(PAGE_QUANTA))
}

/// Collects what a shape touches.
pub(super) struct Touch {
    heights: Heights,
    layers: (i64, i64),
    until: Kinds,
    pub found: Kinds,
}

impl Touch {
    /// Collects what `shape` touches, until that is one of the kinds in `until`.
    #[inline]
    pub fn new<G: OnPixels>(shape: &G, until: Kinds) -> Self {
        let heights = shape.heights();
        Self { heights, layers: layers_of(heights), until, found: 0 }
    }

    /// Whether one of the wanted kinds is found.
    #[inline]
    pub fn done(&self) -> bool {
        self.found & self.until != 0
    }

    /// The pages of one tile column; breaks when one of the wanted kinds is found.
    #[inline]
    pub fn column<G: OnPixels, T: PageSlot>(
        &mut self,
        shape: &G,
        tile: &Tile,
        slots: &[T],
        missing: &mut Option<Missing>,
    ) -> ControlFlow<()> {
        for slot in layers(slots, self.layers.0, self.layers.1) {
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
