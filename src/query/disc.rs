//! Footprint of round shapes: the pixels that a disc touches.
//!
//! Outward margins of [`SLACK`] relative to the magnitudes involved cover all rounding errors: a pixel that holds a
//! point of the disc is always in the footprint, and no pixel farther from the disc than the margins is.

use super::grid::Rect;
use super::simd::greater;
use crate::frame::Frame;

/// Relative margin, 16 times the rounding error of one operation. The longest chain of operations below has 8.
pub(super) const SLACK: f64 = 16.0 * f64::EPSILON / 2.0;

/// Returns `v` moved down by the margin.
#[inline]
pub(super) fn lower(v: f64) -> f64 {
    v - v.abs() * SLACK
}

/// Returns `v` moved up by the margin.
#[inline]
pub(super) fn upper(v: f64) -> f64 {
    v + v.abs() * SLACK
}

/// A closed disc in world coordinates on a grid of pixels.
#[derive(Debug, Clone, Copy)]
pub struct Disc {
    frame: Frame,
    x: f64,
    y: f64,
    /// Grown by the margin.
    radius: f64,
}

impl Disc {
    pub fn new(frame: &Frame, x: f64, y: f64, radius: f64) -> Self {
        Self { frame: *frame, x, y, radius: upper(radius) }
    }

    /// Returns the radius with its margin (m).
    #[inline]
    pub fn radius(&self) -> f64 {
        self.radius
    }

    #[inline]
    pub fn rect(&self) -> Rect {
        let (i0, i1) = self.pixels(self.x, self.radius);
        let (j0, j1) = self.pixels(self.y, self.radius);
        Rect { i0, i1, j0, j1 }
    }

    /// Returns the first and last pixel whose closed squares hold a coordinate of `center - half ..= center + half`.
    #[inline]
    fn pixels(&self, center: f64, half: f64) -> (i64, i64) {
        // Squares are closed, so the pixel below an edge counts, too. At 0 the relative margin does not include it.
        (-self.frame.pixel_of(-lower(center - half)) - 1, self.frame.pixel_of(upper(center + half)))
    }

    /// Returns a lower bound of the distance from `center` to the pixels `first..first + count` (m).
    #[inline]
    fn gap(&self, center: f64, first: i64, count: i64) -> f64 {
        let low = lower(self.frame.edge_of_pixel(first));
        let high = upper(self.frame.edge_of_pixel(first + count));
        lower(greater(greater(low - center, center - high), 0.0))
    }

    /// Returns an upper bound of half the chord at `distance` from the middle (m); `None` outside the disc.
    #[inline]
    pub fn half_chord(&self, distance: f64) -> Option<f64> {
        let rest = self.radius - distance;
        (rest >= 0.0).then(|| upper((rest * (self.radius + distance)).sqrt()))
    }

    /// Returns a lower bound of the distance from the middle to the square of `edge` pixels that begins at (`i`, `j`)
    /// (m).
    #[inline]
    pub fn distance_to(&self, i: i64, j: i64, edge: i64) -> f64 {
        let (x, y) = (self.gap(self.x, i, edge), self.gap(self.y, j, edge));
        lower((x * x + y * y).sqrt())
    }

    /// Returns whether the square of 8 × 8 pixels that begins at (`i`, `j`) lies inside the disc. May return `false` if
    /// the square is inside by an ulp or less.
    #[inline]
    pub fn holds(&self, i: i64, j: i64) -> bool {
        let far = |center: f64, first: i64| {
            let (low, high) = (self.frame.edge_of_pixel(first), self.frame.edge_of_pixel(first + 8));
            greater(center - low, high - center)
        };
        let (x, y) = (far(self.x, i), far(self.y, j));
        x * x + y * y <= self.radius * self.radius
    }

    /// Returns the pixels of the disc in the block that begins at (`i`, `j`); they are contiguous in each row.
    #[inline]
    pub fn mask(&self, i: i64, j: i64) -> u64 {
        (0..8).fold(0, |mask, row| {
            let Some(half) = self.half_chord(self.gap(self.y, j + row, 1)) else { return mask };
            let (first, last) = self.pixels(self.x, half);
            if last < i || first > i + 7 {
                return mask;
            }
            let (x0, x1) = ((first - i).max(0), (last - i).min(7));
            mask | ((2u64 << x1) - (1u64 << x0)) << (8 * row)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pixels_of_points_inside_are_in_the_mask(
            x in -1e7f64..1e7, y in -1e7f64..1e7, r in 0.0f64..3.0, u in 0.0f64..1.0, angle in 0.0f64..6.3
        ) {
            let frame = Frame::new(0.05, 0.15).unwrap();
            let disc = Disc::new(&frame, x, y, r);
            let d = r * u.sqrt() * (1.0 - 1e-15);
            let (px, py) = (x + d * angle.cos(), y + d * angle.sin());
            prop_assume!((px - x).hypot(py - y) <= r);
            let (i, j) = (frame.pixel_of(px), frame.pixel_of(py));
            let (bi, bj) = (i & !7, j & !7);
            prop_assert!(disc.mask(bi, bj) >> ((j - bj) * 8 + i - bi) & 1 == 1);
            let rect = disc.rect();
            prop_assert!(rect.i0 <= i && i <= rect.i1 && rect.j0 <= j && j <= rect.j1);
        }
    }
}
