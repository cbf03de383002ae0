//! One page against one shape.

use super::grid::Heights;
use super::grid::sealed::OnPixels;
use super::scan::meeting;
use super::simd::{Unions, Window};
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA};
use crate::page::{BlockView, Page, Span};

/// Classes of solid that a shape touches: a set of [`MATTER`] and [`OBSTACLE`].
pub(super) type Kinds = u32;
/// Solid of either class.
pub(super) const MATTER: Kinds = 1;
/// An obstacle; never without [`MATTER`].
pub(super) const OBSTACLE: Kinds = Span::OBSTACLE_KIND;

/// Returns the first and last slice in which a span can lie that meets the local heights `low..=high` [0..=16320]. A
/// span that ends at `low` on a slice boundary belongs to the slice below.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn slices_of(low: u32, high: u32) -> (u32, u32) {
    (low.saturating_sub(1) / SLICE_QUANTA as u32, (high / SLICE_QUANTA as u32).min(63))
}

/// Returns the slices of [`slices_of`] as a mask.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn slices_between(low: u32, high: u32) -> u64 {
    let (first, last) = slices_of(low, high);
    u64::MAX >> (63 - last) & u64::MAX << first
}

/// Converts a height above the origin to a height in the page with floor `base`, clamped to the page (quanta).
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn local(height: i64, base: i64) -> u32 {
    (height - base).clamp(0, PAGE_QUANTA) as u32
}

/// Converts `heights` to the page with floor `base`; `None` if they lie outside.
#[inline]
pub(super) fn local_heights(heights: Heights, base: i64) -> Option<(u32, u32)> {
    let meets = heights.low <= base + PAGE_QUANTA && heights.high >= base;
    meets.then(|| (local(heights.low, base), local(heights.high, base)))
}

/// A page under a shape.
pub(super) struct PageUnder<'a> {
    pub page: &'a Page,
    /// First pixel of the page, and height of its floor (quanta).
    pub i: i64,
    pub j: i64,
    pub base: i64,
    /// Blocks that the shape's rectangle meets.
    pub blocks: u64,
}

impl PageUnder<'_> {
    /// Returns the blocks under the shape that are occupied in the slices of local heights `low..=high`.
    #[inline]
    pub fn blocks_between(&self, low: u32, high: u32) -> u64 {
        let (first, last) = slices_of(low, high);
        self.blocks & self.page.blocks_in(first, last)
    }

    /// Returns the first pixel of block `number`.
    #[inline]
    pub fn corner(&self, number: u32) -> (i64, i64) {
        (self.i + i64::from((number & 7) * 8), self.j + i64::from((number >> 3) * 8))
    }
}

/// Returns the classes that `shape` touches between local heights `low` and `high`. May stop once one of `until` is
/// found.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn touched<G: OnPixels>(place: &PageUnder<'_>, shape: &G, low: u32, high: u32, until: Kinds) -> Kinds {
    let mut found = 0;
    let mut blocks = place.blocks_between(low, high);
    while blocks != 0 && found & until == 0 {
        let number = blocks.trailing_zeros();
        blocks &= blocks - 1;
        found |= touched_in_block(place, number, shape, (low, high), found, until);
    }
    found
}

/// Returns the classes that `shape` touches in one block; does not verify those that are already `known`.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn touched_in_block<G: OnPixels>(
    place: &PageUnder<'_>,
    number: u32,
    shape: &G,
    (mut low, mut high): (u32, u32),
    known: Kinds,
    until: Kinds,
) -> Kinds {
    let block = place.page.block_at(number);
    let (i, j) = place.corner(number);
    if !G::UPRIGHT {
        let Some(narrower) = local_heights(shape.heights_over(i, j, 8), place.base) else { return 0 };
        (low, high) = narrower;
    }
    let by_unions = kinds_by_unions(block, low, high);
    if by_unions & !known == 0 || G::UPRIGHT && shape.holds(i, j) {
        return by_unions;
    }
    touched_in_pixels(block, shape, (i, j, place.base), (low, high), by_unions, until)
}

/// Returns the classes that `shape` touches in a block that it may cut and that is occupied at its heights. Not
/// inlined: few blocks get here, and without this code the common path needs fewer registers.
#[inline(never)]
fn touched_in_pixels<G: OnPixels>(
    block: BlockView<'_>,
    shape: &G,
    (i, j, base): (i64, i64, i64),
    (low, high): (u32, u32),
    by_unions: Kinds,
    until: Kinds,
) -> Kinds {
    let mask = shape.mask(i, j);
    let pixels = mask & block.pixels();
    if pixels == 0 || G::UPRIGHT && pixels == block.pixels() {
        return if pixels == 0 { 0 } else { by_unions };
    }
    let mut kinds = 0;
    if G::UPRIGHT {
        for_each_strip(mask, |strip| {
            let window = Window::new([strip.x0, strip.x1], low, high);
            kinds |= window.kinds(block.rows(strip.y0, strip.y1), until);
        });
        return kinds;
    }
    for y in 0..8 {
        let lanes = pixels >> (8 * y) & 0xFF;
        let row = if lanes == 0 { &[] } else { block.rows(y, y) };
        for span in row.iter().filter(|span| lanes >> span.lane() & 1 == 1 && span.meets(low, high)) {
            // The heights over one pixel cost two square roots, so they are computed only for spans that pass the
            // cheaper tests.
            let over_pixel = shape.heights_over(i + i64::from(span.lane()), j + i64::from(y), 1);
            if local_heights(over_pixel, base).is_some_and(|(low, high)| span.meets(low, high)) {
                kinds |= span.kinds();
            }
        }
    }
    kinds
}

/// Returns the classes of spans in any of the block's pixels that meet `low..=high`.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn kinds_by_unions(block: BlockView<'_>, low: u32, high: u32) -> Kinds {
    let (first, more) = block.union_quads();
    meeting(more, meeting(std::slice::from_ref(first), 0, low, high), low, high)
}

/// Returns whether a span in any of the block's pixels meets `low..=high`.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn touches_union(block: BlockView<'_>, low: u32, high: u32) -> bool {
    kinds_by_unions(block, low, high) != 0
}

/// Returns the lowest bottom and the highest top of the block's unions that meet `low..=high`; `None` if none of them
/// does.
#[cfg_attr(target_family = "wasm", inline)]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
pub(super) fn union_heights(block: BlockView<'_>, low: u32, high: u32) -> Option<(u32, u32)> {
    let (first, more) = block.union_quads();
    let mut met = Unions::meeting(first, low, high);
    for quad in more {
        // Unions are sorted by bottom, lowest first.
        if quad[0].bottom() > high {
            break;
        }
        met = met.join(Unions::meeting(quad, low, high));
    }
    let (bottom, top) = met.ends();
    (bottom <= top).then_some((bottom, top))
}

/// Rows `y0..=y1` of a block between lanes `x0..=x1`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Strip {
    pub y0: u32,
    pub y1: u32,
    pub x0: u32,
    pub x1: u32,
}

/// Cuts `mask` (pixels of a block, contiguous in each row) into strips of equal rows.
#[inline]
pub(super) fn for_each_strip(mut mask: u64, mut f: impl FnMut(Strip)) {
    let mut y = 0;
    while mask != 0 {
        let skipped = mask.trailing_zeros() / 8;
        mask >>= 8 * skipped;
        y += skipped;
        let row = mask & 0xFF;
        let rows = (mask ^ (row * 0x0101_0101_0101_0101)).trailing_zeros() / 8;
        f(Strip { y0: y, y1: y + rows - 1, x0: row.trailing_zeros(), x1: 63 - row.leading_zeros() });
        mask = mask.checked_shr(8 * rows).unwrap_or(0);
        y += rows;
    }
}

#[inline]
pub(super) fn for_each_bit(mut mask: u64, mut f: impl FnMut(u32)) {
    while mask != 0 {
        f(mask.trailing_zeros());
        mask &= mask - 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_cut_into_strips_of_equal_rows() {
        let strips = |mask| {
            let mut strips = Vec::new();
            for_each_strip(mask, |s| strips.push((s.y0, s.y1, s.x0, s.x1)));
            strips
        };
        assert_eq!(strips(0), []);
        assert_eq!(strips(u64::MAX), [(0, 7, 0, 7)]);
        assert_eq!(strips(0x80 << 56), [(7, 7, 7, 7)]);
        assert_eq!(strips(0x3C_7E_7E_3C << 8), [(1, 1, 2, 5), (2, 3, 1, 6), (4, 4, 2, 5)]);
        assert_eq!(strips(0x01_00_01), [(0, 0, 0, 0), (2, 2, 0, 0)]);
    }

    #[test]
    fn a_top_on_a_slice_boundary_is_looked_for_in_the_slice_below() {
        assert_eq!(slices_between(255, 255), 0b11);
        assert_eq!(slices_between(256, 256), 0b10);
        assert_eq!(slices_between(0, 0), 0b1);
        assert_eq!(slices_between(0, 16320), u64::MAX);
        assert_eq!(slices_between(16320, 16320), 1 << 63);
    }
}
