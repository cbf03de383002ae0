//! The way down to the spans that a moving or growing shape may meet: tile columns, pages, blocks, spans. What is worth
//! a look is decided by a visitor that is asked about boxes, from large to small.

use crate::frame::{Frame, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::query::Aabb;
use crate::query::blocks::{for_each_bit, local, slices_between, slices_of};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::sealed::{OnGrid, OnPixels};
use crate::query::grid::{Heights, Rect};
use crate::slice::{Page, Span};
use crate::store::{PageSet, PageSlot};

/// A closed box in grid units: pixels, pixels, quanta.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GridCell {
    pub lo: [f64; 3],
    pub hi: [f64; 3],
}

impl GridCell {
    /// The square of `edge` pixels that begins at (`i`, `j`), from height `bottom` to `top`.
    #[inline]
    fn square(i: i64, j: i64, edge: i64, bottom: i64, top: i64) -> Self {
        Self { lo: [i as f64, j as f64, bottom as f64], hi: [(i + edge) as f64, (j + edge) as f64, top as f64] }
    }
}

/// What is asked on the way down.
pub(crate) trait Visit {
    /// Whether matter anywhere in `cell` can matter. If it can in a part of the cell, it can in the cell.
    fn enter(&mut self, cell: &GridCell) -> bool;

    /// Matter that fills `cell`, in pixel (`i`, `j`).
    fn span(&mut self, cell: &GridCell, obstacle: bool, pixel: [i64; 2]);

    /// A page that is not in memory and has matter in a cell that can matter.
    fn missing(&mut self, key: PageKey);

    /// The part of the heights `low..=high` in which matter can still matter.
    #[inline]
    fn heights(&self, low: i64, high: i64) -> (i64, i64) {
        (low, high)
    }

    /// Least and greatest coordinate along the other axis of x and y that can matter between `lo` and `hi` along
    /// `axis`.
    #[inline]
    fn across(&self, _axis: usize, _lo: f64, _hi: f64) -> (f64, f64) {
        (f64::NEG_INFINITY, f64::INFINITY)
    }
}

/// Where to look, and in which order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SweepArea {
    pub rect: Rect,
    /// Matter counts if its top is at least `low` and its bottom at most `high` (quanta).
    pub low: i64,
    pub high: i64,
    /// Axis of x and y along which tile columns are taken in order.
    pub major: usize,
    /// From the far end, per axis.
    pub backward: [bool; 3],
}

impl SweepArea {
    /// What a box that stands still may touch.
    pub fn around(frame: &Frame, shape: &Aabb) -> Self {
        let shape = shape.on_grid(frame);
        let Heights { low, high } = shape.heights();
        Self { rect: shape.rect(), low, high, major: 0, backward: [false; 3] }
    }
}

/// Shows `visit` the matter of `set` in `area`.
#[inline]
pub(crate) fn descend<S: PageSet, V: Visit>(set: &S, area: &SweepArea, visit: &mut V) {
    let Some(bounds) = set.bounds() else { return };
    let tiles = |first: i64, last: i64, axis: usize| {
        ((first >> 6).max(i64::from(bounds.min[axis])), (last >> 6).min(i64::from(bounds.max[axis])))
    };
    let ranges = [tiles(area.rect.i0, area.rect.i1, 0), tiles(area.rect.j0, area.rect.j1, 1)];
    if ranges.iter().any(|(first, last)| first > last) {
        return;
    }
    let (major, minor) = (area.major, 1 - area.major);
    let (first, last) = ranges[major];
    let slabs = (last - first) as u64 + 1;
    if slabs > 4 && slabs > set.column_count() as u64 {
        for number in 0..set.column_count() {
            let (tx, ty, slots) = set.column_at(number);
            let inside = |axis: usize, at: i32| (ranges[axis].0..=ranges[axis].1).contains(&i64::from(at));
            if inside(0, tx) && inside(1, ty) {
                column(area, tx, ty, slots, visit);
            }
        }
        return;
    }
    for n in first..=last {
        let a = if area.backward[major] { first + last - n } else { n };
        let (from, to) = if slabs > 2 {
            let (low, high) = visit.across(major, (a << 6) as f64, ((a + 1) << 6) as f64);
            // Saturating casts: what lies beyond all tiles ends at the first or last one.
            let tile = |v: f64| (v / TILE_PIXELS as f64).floor() as i64;
            (ranges[minor].0.max(tile(low)), ranges[minor].1.min(tile(high)))
        } else {
            ranges[minor]
        };
        if from <= to && (to - from) as u64 > set.column_count() as u64 + 4 {
            // A slab wider than the set has columns.
            for number in 0..set.column_count() {
                let (tx, ty, slots) = set.column_at(number);
                let at = [i64::from(tx), i64::from(ty)];
                if at[major] == a && (from..=to).contains(&at[minor]) {
                    column(area, tx, ty, slots, visit);
                }
            }
            continue;
        }
        for m in from..=to {
            let b = if area.backward[minor] { from + to - m } else { m };
            let (tx, ty) = if major == 0 { (a as i32, b as i32) } else { (b as i32, a as i32) };
            let slots = set.column(tx, ty);
            if !slots.is_empty() {
                column(area, tx, ty, slots, visit);
            }
        }
    }
}

#[inline]
fn column<T: PageSlot, V: Visit>(area: &SweepArea, tx: i32, ty: i32, slots: &[T], visit: &mut V) {
    let (i, j) = (i64::from(tx) * TILE_PIXELS, i64::from(ty) * TILE_PIXELS);
    let mut slots = layers(slots, Heights { low: area.low, high: area.high });
    while let Some(slot) = if area.backward[2] { slots.next_back() } else { slots.next() } {
        let base = floor_of(slot.layer());
        let (low, high) = visit.heights(area.low, area.high);
        let window = (local(low, base), local(high, base));
        let slices = slot.slices() & slices_between(window.0, window.1);
        if slices == 0 {
            continue;
        }
        let bottom = base + i64::from(slices.trailing_zeros()) * SLICE_QUANTA;
        let top = base + i64::from(64 - slices.leading_zeros()) * SLICE_QUANTA;
        if !visit.enter(&GridCell::square(i, j, TILE_PIXELS, bottom, top)) {
            continue;
        }
        match slot.page() {
            Some(held) => page(area, held, i, j, base, visit),
            None => visit.missing(PageKey { tx, ty, layer: slot.layer() }),
        }
    }
}

#[inline]
fn page<V: Visit>(area: &SweepArea, page: &Page, i: i64, j: i64, base: i64, visit: &mut V) {
    let (low, high) = (local(area.low, base), local(area.high, base));
    let (first, last) = slices_of(low, high);
    let blocks = area.rect.bits(i, j, 3) & page.blocks_in(first, last);
    for_each_bit(blocks, |number| {
        let block = page.block_at(number);
        let (low, high) = visit.heights(area.low, area.high);
        let (low, high) = (local(low, base), local(high, base));
        let meets = |span: Span| span.meets(low, high);
        let (bi, bj) = (i + i64::from(number & 7) * 8, j + i64::from(number >> 3) * 8);
        let cell = |span: Span, i: i64, j: i64, edge: i64| {
            GridCell::square(i, j, edge, base + i64::from(span.bottom()), base + i64::from(span.top()))
        };
        if !block.unions().any(|union| meets(union) && visit.enter(&cell(union, bi, bj, 8))) {
            return;
        }
        let clamp = |v: i64, origin: i64| (v.saturating_sub(origin)).clamp(0, 7) as u32;
        let (x0, width) = (clamp(area.rect.i0, bi), clamp(area.rect.i1, bi) - clamp(area.rect.i0, bi));
        for y in clamp(area.rect.j0, bj)..=clamp(area.rect.j1, bj) {
            let pj = bj + i64::from(y);
            for &span in block.rows(y, y) {
                if meets(span) && span.lane().wrapping_sub(x0) <= width {
                    let pi = bi + i64::from(span.lane());
                    visit.span(&cell(span, pi, pj, 1), span.is_obstacle(), [pi, pj]);
                }
            }
        }
    });
}
