//! The exact search of a ray, which visits every cell along it and settles every case.

use super::RayHit;
use super::line::Line;
use crate::frame::{PAGE_QUANTA, PageKey};
use crate::page::{BlockView, Page, Span};
use crate::query::answer::Answer;
use crate::query::blocks::{local, local_heights, slices_between, touches_union};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::Rect;
use crate::store::{KeyBounds, Missing, PageSlot, Snapshot, note};
use std::ops::ControlFlow;

/// Returns the first solid on `line` in a set of pages with these bounds, or the pages missing before it.
#[inline(never)]
pub(super) fn search(set: &Snapshot, line: Line, bounds: &KeyBounds) -> Answer<Option<RayHit>> {
    let mut search = Search { line, best: None, missing: None };
    if let Some((t0, t1)) = line.within(bounds) {
        let region = |axis: usize| (i64::from(bounds.min[axis] >> 6), i64::from(bounds.max[axis] >> 6));
        let tile = |axis: usize| (i64::from(bounds.min[axis]), i64::from(bounds.max[axis]));
        let tiles = Rect { i0: tile(0).0, i1: tile(0).1, j0: tile(1).0, j1: tile(1).1 };
        let regions = Rect { i0: region(0).0, i1: region(0).1, j0: region(1).0, j1: region(1).1 };
        let _ = line.cells(6 + 6, regions, t0, t1, |rx, ry, t0, t1| {
            search.continue_at(t0)?;
            if set.has_region(rx as i32, ry as i32) {
                // A break in one region does not end the search: a ray along an edge is in the region on the other
                // side, too.
                let _ = line.cells(6, tiles.part(rx << 6, ry << 6, 64), t0, t1, |tx, ty, t0, t1| {
                    search.tile(set.column(tx as i32, ty as i32), tx as i32, ty as i32, t0, t1)
                });
            }
            ControlFlow::Continue(())
        });
    }
    Answer::new(search.best, search.missing)
}

impl Rect {
    /// Returns the part of a rectangle of cells in the square of `edge` cells that begins at (`i`, `j`).
    fn part(&self, i: i64, j: i64, edge: i64) -> Self {
        let (i1, j1) = (self.i1.min(i + edge - 1), self.j1.min(j + edge - 1));
        Self { i0: self.i0.max(i), i1, j0: self.j0.max(j), j1 }
    }
}

/// Returns the cells of the 8 × 8 square that begins at (`i`, `j`).
fn square(i: i64, j: i64) -> Rect {
    Rect { i0: i, i1: i + 7, j0: j, j1: j + 7 }
}

/// Nearest hit found, and the pages missing before it.
struct Search {
    line: Line,
    best: Option<RayHit>,
    missing: Option<Missing>,
}

impl Search {
    /// Continues if a span at or behind `t` can still be the first hit. Tested when a cell is entered, not when one is
    /// left: a ray along an edge is in the cells on both sides at once.
    #[inline]
    fn continue_at(&self, t: f64) -> ControlFlow<()> {
        match self.best {
            Some(best) if best.distance < t => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    }

    fn tile(&mut self, slots: &[PageSlot], tx: i32, ty: i32, t0: f64, t1: f64) -> ControlFlow<()> {
        self.continue_at(t0)?;
        let heights = self.line.heights(t0, t1);
        let mut slots = layers(slots, heights);
        let upward = self.line.speed[2] >= 0.0;
        while let Some(slot) = if upward { slots.next() } else { slots.next_back() } {
            let base = floor_of(slot.layer());
            let (low, high) = (local(heights.low, base), local(heights.high, base));
            if slot.slices() & slices_between(low, high) == 0 {
                continue;
            }
            let (t0, t1) = self.line.clip(2, base as f64, (base + PAGE_QUANTA) as f64, t0, t1);
            if t0 > t1 || self.continue_at(t0).is_break() {
                continue;
            }
            match slot.page() {
                Some(page) => self.page(page, tx, ty, base, t0, t1),
                None => note(&mut self.missing, PageKey { tx, ty, layer: slot.layer() }),
            }
        }
        ControlFlow::Continue(())
    }

    fn page(&mut self, page: &Page, tx: i32, ty: i32, base: i64, t0: f64, t1: f64) {
        let line = self.line;
        let (bi, bj) = (i64::from(tx) * 8, i64::from(ty) * 8);
        let _ = line.cells(3, square(bi, bj), t0, t1, |i, j, t0, t1| {
            self.continue_at(t0)?;
            let block = page.block((i - bi) as u32, (j - bj) as u32);
            let heights = local_heights(line.heights(t0, t1), base);
            if heights.is_some_and(|(low, high)| touches_union(block, low, high)) {
                self.block(block, i * 8, j * 8, base, t0, t1);
            }
            ControlFlow::Continue(())
        });
    }

    fn block(&mut self, block: BlockView<'_>, i0: i64, j0: i64, base: i64, t0: f64, t1: f64) {
        let line = self.line;
        let pixels = block.pixels();
        let _ = line.cells(0, square(i0, j0), t0, t1, |i, j, t0, t1| {
            self.continue_at(t0)?;
            let bit = (j - j0) as u32 * 8 + (i - i0) as u32;
            if pixels >> bit & 1 == 1 {
                self.pixel(block.column(bit), i, j, base, t0, t1);
            }
            ControlFlow::Continue(())
        });
    }

    fn pixel(&mut self, spans: &[Span], i: i64, j: i64, base: i64, t0: f64, t1: f64) {
        let line = &self.line;
        let Some((low, high)) = local_heights(line.heights(t0, t1), base) else { return };
        for &span in spans.iter().filter(|span| span.meets(low, high)) {
            let hit = line.meet((i, j), base, span);
            if self.best.is_none_or(|best| hit.is_before(&best)) {
                self.best = Some(hit);
            }
        }
    }
}
