//! Shapes on the grid: the pixels that a shape covers, and its heights.

use crate::frame::Frame;

/// A shape that queries accept: [`Aabb`](super::Aabb), [`Cylinder`](super::Cylinder), [`Sphere`](super::Sphere).
pub trait Shape: sealed::OnGrid {}

impl<T: sealed::OnGrid> Shape for T {}

/// Greatest magnitude of the numbers of round shapes, rays and poses (m), small enough that squares are finite.
pub(crate) const FARTHEST_M: f64 = 1e100;

/// Returns whether all values are within ±[`FARTHEST_M`]; NaN is not.
pub(crate) fn all_within_reach<'a>(values: impl IntoIterator<Item = &'a f64>) -> bool {
    values.into_iter().all(|v| v.abs() <= FARTHEST_M)
}

/// Pixels `i0..=i1` × `j0..=j1`, within ±2⁵⁰ as [`Frame`] returns them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    pub i0: i64,
    pub i1: i64,
    pub j0: i64,
    pub j1: i64,
}

/// Heights within ±2⁵⁰ (quanta). A span meets them if its bottom is at most `high` and its top at least `low`. For a
/// shape between two neighbouring quanta, `low` is `high + 1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heights {
    pub low: i64,
    pub high: i64,
}

impl Heights {
    /// Converts the closed world interval `[low, high]` (m).
    #[inline]
    pub fn of(frame: &Frame, low: f64, high: f64) -> Self {
        Self { low: frame.quantum_ceil(low), high: frame.quantum_floor(high) }
    }
}

/// Properties of a shape that the traversal of blocks needs. Public in name only, because the module is private.
pub(super) mod sealed {
    use super::{Heights, Rect};
    use crate::frame::Frame;

    /// A shape that can be converted to a grid.
    pub trait OnGrid {
        type Grid: OnPixels;
        fn on_grid(&self, frame: &Frame) -> Self::Grid;
    }

    /// A shape on a grid.
    pub trait OnPixels {
        /// True if the heights are the same over all pixels of the footprint.
        const UPRIGHT: bool;

        /// Returns the smallest rectangle around the footprint.
        fn rect(&self) -> Rect;

        /// Returns the heights over the whole footprint.
        fn heights(&self) -> Heights;

        /// Returns the pixel that is the whole footprint, if the shape is upright and has no other.
        #[inline]
        fn pixel(&self) -> Option<(i64, i64)> {
            let rect = self.rect();
            (Self::UPRIGHT && rect.i0 == rect.i1 && rect.j0 == rect.j1).then_some((rect.i0, rect.j0))
        }

        /// Returns whether the whole block of 8 × 8 pixels that begins at pixel (`i`, `j`) lies in the footprint; may
        /// return `false` for a block that does.
        fn holds(&self, i: i64, j: i64) -> bool;

        /// Returns the pixels of the footprint in the block of 8 × 8 pixels that begins at pixel (`i`, `j`), bit `8·dy
        /// + dx`. The bits of a row are contiguous.
        fn mask(&self, i: i64, j: i64) -> u64;

        /// Returns the heights over the square of `edge` pixels that begins at pixel (`i`, `j`) and meets the
        /// footprint.
        fn heights_over(&self, _i: i64, _j: i64, _edge: i64) -> Heights {
            self.heights()
        }
    }
}

/// Returns the mask of columns `first..=last` [0..8] of a block.
#[inline]
pub(super) fn column_bits(first: u32, last: u32) -> u64 {
    let row = (2u64 << last) - (1u64 << first);
    row * 0x0101_0101_0101_0101
}

/// Returns the mask of rows `first..=last` [0..8] of a block.
#[inline]
pub(super) fn row_bits(first: u32, last: u32) -> u64 {
    u64::MAX >> (8 * (7 - last)) & u64::MAX << (8 * first)
}

impl Rect {
    /// Returns whether pixel (`i`, `j`) lies in the rectangle.
    #[inline]
    pub(super) fn holds(&self, i: i64, j: i64) -> bool {
        (self.i0 <= i) & (i <= self.i1) & (self.j0 <= j) & (j <= self.j1)
    }

    /// Returns the rectangle's part in the square of 8 × 8 cells that begins at (`i`, `j`), as a mask of these cells of
    /// `1 << shift` pixels each. The two must meet.
    #[inline]
    pub(super) fn bits(&self, i: i64, j: i64, shift: u32) -> u64 {
        let last = (8 << shift) - 1;
        let cell = |value: i64, origin: i64| ((value - origin).clamp(0, last) as u32) >> shift;
        column_bits(cell(self.i0, i), cell(self.i1, i)) & row_bits(cell(self.j0, j), cell(self.j1, j))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_become_masks() {
        assert_eq!(column_bits(0, 7), u64::MAX);
        assert_eq!(column_bits(7, 7), 0x8080_8080_8080_8080);
        assert_eq!(row_bits(0, 7), u64::MAX);
        assert_eq!(row_bits(7, 7), 0xFF << 56);
        assert_eq!(row_bits(2, 3), 0xFFFF_0000);
        let rect = Rect { i0: -3, i1: 9, j0: 6, j1: 6 };
        assert_eq!(rect.bits(-8, 0, 0), 0b1110_0000 << 48);
        assert_eq!(rect.bits(8, 0, 0), 0b0000_0011 << 48);
        assert_eq!(rect.bits(0, 0, 3), 0b0000_0011);
        let end = 1 << 50;
        let huge = Rect { i0: -end, i1: end, j0: -end, j1: end };
        assert_eq!(huge.bits(64, 64, 3), u64::MAX);
    }

    #[test]
    fn rectangles_hold_their_edges_and_nothing_beyond() {
        let rect = Rect { i0: -3, i1: 9, j0: 5, j1: 6 };
        assert!([(-3, 5), (9, 5), (-3, 6), (9, 6), (0, 5)].iter().all(|&(i, j)| rect.holds(i, j)));
        assert!(![(-4, 5), (10, 5), (-3, 4), (9, 7), (0, 4), (0, 7)].iter().any(|&(i, j)| rect.holds(i, j)));
    }
}
