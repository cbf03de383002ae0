//! Descent to the spans that a moving or growing shape may meet: tile columns, pages, blocks, spans. A visitor decides
//! which cells are relevant. It names the heights (quanta) that a span must meet, and narrows them as it finds spans;
//! masks select the spans that meet them, four at a time. Tile columns and blocks are passed to it as boxes.

use crate::frame::{Frame, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::page::{BLOCK_PIXELS, BlockView, Span};
use crate::query::Aabb;
use crate::query::blocks::{for_each_bit, local, slices_between, slices_of, union_heights};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::sealed::{OnGrid, OnPixels};
use crate::query::grid::{Heights, Rect, column_bits, row_bits};
use crate::query::simd::{Window, last_four};
use crate::store::{PageSlot, Snapshot};

/// A closed box in grid units: pixels, pixels, quanta.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GridCell {
    pub lo: [f64; 3],
    pub hi: [f64; 3],
}

impl GridCell {
    /// Returns the square of `edge` pixels that begins at (`i`, `j`), from height `bottom` to `top`.
    #[inline]
    fn square(i: i64, j: i64, edge: i64, bottom: i64, top: i64) -> Self {
        Self { lo: [i as f64, j as f64, bottom as f64], hi: [(i + edge) as f64, (j + edge) as f64, top as f64] }
    }
}

/// A span of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Matter {
    pub pixel: [i64; 2],
    /// Heights (quanta).
    pub bottom: i64,
    pub top: i64,
    pub obstacle: bool,
}

impl Matter {
    /// Returns the box that the span fills.
    #[inline]
    pub fn cell(&self) -> GridCell {
        GridCell::square(self.pixel[0], self.pixel[1], 1, self.bottom, self.top)
    }
}

/// Decisions on the descent.
pub(crate) trait Visit {
    /// Returns whether the cell can contain a relevant span. True for a cell if it is true for any part of it.
    fn enter(&mut self, cell: &GridCell) -> bool;

    /// Receives a span that meets [`heights`](Self::heights), in a pixel of the area.
    fn matter(&mut self, matter: &Matter);

    /// Receives the key of a page that is not in memory and is occupied in a relevant cell.
    fn missing(&mut self, key: PageKey);

    /// Returns the lowest top and the highest bottom of spans that are relevant now.
    fn heights(&self) -> (i64, i64);

    /// Returns whether [`enter`](Self::enter) can be skipped because it rarely rejects cells at these heights.
    #[inline]
    fn takes_all(&self) -> bool {
        false
    }

    /// Returns the range of relevant coordinates along the other axis of x and y, between `lo` and `hi` along `axis`.
    #[inline]
    fn across(&self, _axis: usize, _lo: f64, _hi: f64) -> (f64, f64) {
        (f64::NEG_INFINITY, f64::INFINITY)
    }
}

/// Area of a descent, and its order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SweepArea {
    pub rect: Rect,
    /// A span counts if its top is at least `low` and its bottom at most `high` (quanta).
    pub low: i64,
    pub high: i64,
    /// Axis of x and y along which tile columns are visited in order.
    pub major: usize,
    /// Per axis, true if the descent begins at the far end.
    pub backward: [bool; 3],
}

impl SweepArea {
    /// Returns the area that a box at rest may touch.
    pub fn around(frame: &Frame, shape: &Aabb) -> Self {
        let shape = shape.on_grid(frame);
        let Heights { low, high } = shape.heights();
        Self { rect: shape.rect(), low, high, major: 0, backward: [false; 3] }
    }
}

/// Passes the spans of `set` in `area` to `visit`.
#[inline]
pub(crate) fn descend<V: Visit>(set: &Snapshot, area: &SweepArea, visit: &mut V) {
    // A web page fetches the code it runs, so all visitors share one copy of the descent.
    #[cfg(target_family = "wasm")]
    let visit: &mut dyn Visit = visit;
    tiles(set, area, visit);
}

#[inline]
fn tiles<V: Visit + ?Sized>(set: &Snapshot, area: &SweepArea, visit: &mut V) {
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
            // Saturating casts: a coordinate beyond all tiles becomes the first or last tile.
            let tile = |v: f64| (v / TILE_PIXELS as f64).floor() as i64;
            (ranges[minor].0.max(tile(low)), ranges[minor].1.min(tile(high)))
        } else {
            ranges[minor]
        };
        if from <= to && (to - from) as u64 > set.column_count() as u64 + 4 {
            // The slab is wider than the set has columns.
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
fn column<V: Visit + ?Sized>(area: &SweepArea, tx: i32, ty: i32, slots: &[PageSlot], visit: &mut V) {
    let (i, j) = (i64::from(tx) * TILE_PIXELS, i64::from(ty) * TILE_PIXELS);
    let (x, y) = (Extent::within(area.rect.i0, area.rect.i1, i), Extent::within(area.rect.j0, area.rect.j1, j));
    let under = column_bits(x.first >> 3, x.last >> 3) & row_bits(y.first >> 3, y.last >> 3);
    let mut slots = layers(slots, Heights { low: area.low, high: area.high });
    while let Some(slot) = if area.backward[2] { slots.next_back() } else { slots.next() } {
        let place = Place { i, j, base: floor_of(slot.layer()) };
        let (low, high) = place.heights(visit);
        let slices = slot.slices() & slices_between(low, high);
        if slices == 0 {
            continue;
        }
        let (bottom, top) = (slices.trailing_zeros(), 64 - slices.leading_zeros());
        let cell = || place.cell(TILE_PIXELS, bottom * SLICE_QUANTA as u32, top * SLICE_QUANTA as u32);
        match slot.page() {
            Some(page) if visit.takes_all() || visit.enter(&cell()) => {
                let (first, last) = slices_of(low, high);
                for_each_bit(under & page.blocks_in(first, last), |number| {
                    let (bx, by) = ((number & 7) << 3, number & 56);
                    block(page.block_at(number), place.at(bx, by), [x.in_block(bx), y.in_block(by)], visit);
                });
            }
            None if visit.enter(&cell()) => visit.missing(PageKey { tx, ty, layer: slot.layer() }),
            _ => {}
        }
    }
}

/// First and last pixel of a tile, or of a block, along x or y.
#[derive(Clone, Copy)]
struct Extent {
    first: u32,
    last: u32,
}

impl Extent {
    /// Returns the part of `first..=last` in the tile that begins at `origin`.
    #[inline]
    fn within(first: i64, last: i64, origin: i64) -> Self {
        let clamp = |pixel: i64| (pixel - origin).clamp(0, TILE_PIXELS - 1) as u32;
        Self { first: clamp(first), last: clamp(last) }
    }

    /// Returns the part in the block that begins at pixel `begin` of the tile.
    #[inline]
    fn in_block(self, begin: u32) -> Self {
        Self { first: self.first.saturating_sub(begin), last: (self.last - begin).min(BLOCK_PIXELS - 1) }
    }
}

/// Visits the pixels `x`, `y` of a block that begins at `place`.
#[inline]
fn block<V: Visit + ?Sized>(block: BlockView<'_>, place: Place, [x, y]: [Extent; 2], visit: &mut V) {
    let (low, high) = place.heights(visit);
    let Some((bottom, top)) = union_heights(block, low, high) else { return };
    if !visit.takes_all() && !visit.enter(&place.cell(i64::from(BLOCK_PIXELS), bottom, top)) {
        return;
    }
    let (lanes, y0) = ([x.first, x.last], y.first);
    for (n, spans) in block.rows(y0, y.last).chunks(MOST).enumerate() {
        let (low, high) = place.heights(visit);
        let met = met_of(spans, Window::new(lanes, low, high));
        if met != 0 {
            place.spans(spans, met, visit, |k| block.row_of(y0, MOST * n + k));
        }
    }
}

/// Most spans tested together; one bit of a mask each.
const MOST: usize = 64;

/// Returns the mask of those of at most [`MOST`] spans that are in `window`.
#[cfg_attr(not(target_family = "wasm"), inline)]
fn met_of(spans: &[Span], window: Window) -> u64 {
    let mut met = 0;
    // The last group overlaps the previous one, which avoids a loop over the remainder.
    if let Some(last) = spans.last_chunk() {
        for (n, sixteen) in spans.as_chunks().0.iter().enumerate() {
            met |= u64::from(window.meets_of_sixteen(sixteen)) << (16 * n);
        }
        return met | u64::from(window.meets_of_sixteen(last)) << (spans.len() - 16);
    }
    for (n, four) in spans.as_chunks().0.iter().enumerate() {
        met |= u64::from(window.meets(four)) << (4 * n);
    }
    met | u64::from(window.meets(&last_four(spans))) << spans.len().saturating_sub(4)
}

/// A position in a page: a pixel, and the height of the page's floor.
#[derive(Clone, Copy)]
struct Place {
    i: i64,
    j: i64,
    base: i64,
}

impl Place {
    /// Returns the place `x` and `y` pixels further.
    #[inline]
    fn at(self, x: u32, y: u32) -> Self {
        Self { i: self.i + i64::from(x), j: self.j + i64::from(y), ..self }
    }

    /// Returns the square of `edge` pixels that begins here, between two heights in the page.
    #[inline]
    fn cell(self, edge: i64, bottom: u32, top: u32) -> GridCell {
        GridCell::square(self.i, self.j, edge, self.base + i64::from(bottom), self.base + i64::from(top))
    }

    /// Returns the relevant heights in the page.
    #[inline]
    fn heights<V: Visit + ?Sized>(self, visit: &V) -> (u32, u32) {
        let (low, high) = visit.heights();
        (local(low, self.base), local(high, self.base))
    }

    /// Passes the spans in the mask `met` of a block here to `visit`.
    #[inline(never)]
    fn spans<V: Visit + ?Sized>(self, spans: &[Span], mut met: u64, visit: &mut V, row_of: impl Fn(usize) -> u32) {
        let (mut low, mut high) = (0, u32::MAX);
        while met != 0 {
            let n = met.trailing_zeros() as usize;
            met &= met - 1;
            let span = spans[n];
            // A span found before may have narrowed the heights.
            if span.meets(low, high) {
                let Self { i, j, base } = self.at(span.lane(), row_of(n));
                let (bottom, top) = (base + i64::from(span.bottom()), base + i64::from(span.top()));
                visit.matter(&Matter { pixel: [i, j], bottom, top, obstacle: span.is_obstacle() });
                (low, high) = self.heights(visit);
            }
        }
    }
}
