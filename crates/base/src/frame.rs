//! Integer grid: the only place where world coordinates are rounded.
//!
//! The grid is anchored at the coordinate origin of the scan, never at the corner of its data, so that the same place
//! always falls into the same voxel, whatever else is scanned around it. Pixels are half open: pixel `i` holds
//! `i ≤ x·(1/t) < i + 1`. Heights are counted in quanta of `σ/255`; slice `s` holds the quanta `255·s .. 255·(s+1)`.
//!
//! Every function from world to grid is one correctly rounded multiplication and one rounding to an integer, and
//! therefore monotone: `a ≤ b` in the world implies `pixel_of(a) ≤ pixel_of(b)`. Guarantee G1 (no missed point) depends
//! only on that, so it holds at any coordinate, whatever the rounding error.

use crate::text::number;
use crate::{Error, Parameter, Result};

/// Edge of a tile and of a page (pixels); one row of a tile is one `u64`.
pub const TILE_PIXELS: i64 = 64;
/// Slices in one page.
pub const PAGE_SLICES: i64 = 64;
/// Height quanta in one slice.
pub const SLICE_QUANTA: i64 = 255;
/// Height quanta in one page.
pub const PAGE_QUANTA: i64 = PAGE_SLICES * SLICE_QUANTA;
/// Greatest magnitude of a pixel or slice index, so that tile and layer indices fit `i32`.
pub const MAX_INDEX: i64 = (1 << 36) - 1;

/// Greatest pixel size and slice height (m).
pub const MAX_CELL_M: f64 = 1e6;

/// Pixel size `t` and slice height `σ` of an archive, with the conversions between world and grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    pixel_m: f64,
    slice_m: f64,
    pixels_per_m: f64,
    quanta_per_m: f64,
}

impl Frame {
    /// Creates a grid with pixels of `pixel_m` and slices of `slice_m` (m, each 1e-6..=1e6).
    pub fn new(pixel_m: f64, slice_m: f64) -> Result<Self> {
        for (what, value) in [(Parameter::PixelSize, pixel_m), (Parameter::SliceHeight, slice_m)] {
            if !(1e-6..=MAX_CELL_M).contains(&value) {
                return Err(Error::parameter(what, format!("{} m lies outside 0.000001 to 1000000 m", number(value))));
            }
        }
        Ok(Self { pixel_m, slice_m, pixels_per_m: 1.0 / pixel_m, quanta_per_m: SLICE_QUANTA as f64 / slice_m })
    }

    /// Returns the grid of overview level `number`: pixels and slices are larger by 4 to that power. `None` beyond the
    /// limits.
    ///
    /// Each of its indices is that of this grid, divided by that power and rounded down, because the sizes differ by a
    /// power of two.
    pub fn coarser(&self, number: u32) -> Option<Self> {
        let factor = 1u64.checked_shl(2 * number)? as f64;
        Self::new(self.pixel_m * factor, self.slice_m * factor).ok()
    }

    /// Returns the pixel size `t` (m).
    pub fn pixel_m(&self) -> f64 {
        self.pixel_m
    }

    /// Returns the slice height `σ` (m).
    pub fn slice_m(&self) -> f64 {
        self.slice_m
    }

    /// Returns the height quantum `σ/255` (m).
    pub fn quantum_m(&self) -> f64 {
        self.slice_m / SLICE_QUANTA as f64
    }

    /// Returns the fractional pixel coordinate of `x` (or `y`) (pixels).
    #[inline]
    pub fn pixels(&self, x: f64) -> f64 {
        x * self.pixels_per_m
    }

    /// Returns the fractional height of `z` (quanta).
    #[inline]
    pub fn quanta(&self, z: f64) -> f64 {
        z * self.quanta_per_m
    }

    /// Returns the index of the pixel that holds `x` (or `y`); saturates far outside [`MAX_INDEX`], 0 for NaN.
    #[inline]
    pub fn pixel_of(&self, x: f64) -> i64 {
        floor_index(self.pixels(x))
    }

    /// Returns the greatest quantum at or below `z`.
    #[inline]
    pub fn quantum_floor(&self, z: f64) -> i64 {
        floor_index(self.quanta(z))
    }

    /// Returns the least quantum at or above `z`.
    #[inline]
    pub fn quantum_ceil(&self, z: f64) -> i64 {
        -floor_index(-self.quanta(z))
    }

    /// Returns the index of the slice that holds `z`.
    #[inline]
    pub fn slice_of(&self, z: f64) -> i64 {
        self.quantum_floor(z).div_euclid(SLICE_QUANTA)
    }

    /// Returns the world coordinate of the lower edge of pixel `i` (m), rounded to nearest.
    pub fn edge_of_pixel(&self, i: i64) -> f64 {
        i as f64 * self.pixel_m
    }

    /// Returns the world height of the bottom of slice `s` (m), rounded to nearest.
    pub fn bottom_of_slice(&self, s: i64) -> f64 {
        s as f64 * self.slice_m
    }

    /// Returns the world height of a top at `quantum` (m): not below any point whose
    /// [`quantum_ceil`](Self::quantum_ceil) is `quantum`, and less than a few units in the last place above the exact
    /// value.
    pub fn top_height(&self, quantum: i64) -> f64 {
        let mut height = quantum as f64 / self.quanta_per_m;
        while self.quanta(height) > quantum as f64 {
            height = height.next_down();
        }
        while self.quanta(height.next_up()) <= quantum as f64 {
            height = height.next_up();
        }
        height
    }

    /// Returns the world height of a bottom at `quantum` (m): not above any point whose
    /// [`quantum_floor`](Self::quantum_floor) is `quantum`.
    pub fn bottom_height(&self, quantum: i64) -> f64 {
        -self.top_height(-quantum)
    }
}

/// Returns the greatest integer at or below `v`; saturates at ±2⁵⁰, 0 for NaN.
#[inline]
pub fn floor_index(v: f64) -> i64 {
    const LIMIT: f64 = (1u64 << 50) as f64;
    let v = if v.is_nan() { 0.0 } else { v };
    let v = if v < LIMIT { v } else { LIMIT };
    floor_small(if v > -LIMIT { v } else { -LIMIT })
}

/// Returns the greatest integer at or below `v`, for magnitudes up to 2⁵⁰.
///
/// Without SSE 4.1, `f64::floor` is a call and a checked conversion takes several branches; a query needs six
/// conversions. Adding 1.5 · 2⁵² rounds to the nearest integer and leaves it in the low bits (Hacker's Delight, section
/// 17-2). This also vectorises.
#[inline]
pub fn floor_small(v: f64) -> i64 {
    const SHIFT: f64 = (3u64 << 51) as f64;
    let nearest = v + SHIFT;
    let too_high = nearest - SHIFT > v;
    (nearest.to_bits() as i64).wrapping_sub(SHIFT.to_bits() as i64) - i64::from(too_high)
}

/// Key of a page: a tile column in xy and one layer of [`PAGE_SLICES`] slices in it.
///
/// Keys have the order of pages in the archive: tile columns along the Morton curve, the layer innermost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PageKey {
    /// Tile index along x: pixels `64·tx .. 64·(tx+1)`.
    pub tx: i32,
    /// Tile index along y.
    pub ty: i32,
    /// Layer index along z: slices `64·layer .. 64·(layer+1)`.
    pub layer: i32,
}

impl PageKey {
    /// Returns the position of the tile column on the Morton curve: bits of `tx` and `ty` (each plus 2³¹) interleaved,
    /// `tx` lowest.
    pub fn column(&self) -> u64 {
        morton(self.tx, self.ty)
    }

    /// Returns the key with this [`column`](Self::column) and layer.
    pub fn from_column(column: u64, layer: i32) -> Self {
        let half = |bits: u64| (gather_even_bits(bits) ^ (1 << 31)) as i32;
        Self { tx: half(column), ty: half(column >> 1), layer }
    }
}

impl Ord for PageKey {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.column(), self.layer).cmp(&(other.column(), other.layer))
    }
}

impl PartialOrd for PageKey {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl std::fmt::Display for PageKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({}, {}, {})", self.tx, self.ty, self.layer)
    }
}

/// Returns the position of tile `(tx, ty)` on the Morton curve (see [`PageKey::column`]).
pub fn morton(tx: i32, ty: i32) -> u64 {
    let half = |v: i32| spread_bits(v as u32 ^ (1 << 31));
    half(tx) | half(ty) << 1
}

fn spread_bits(v: u32) -> u64 {
    let mut v = v as u64;
    v = (v | v << 16) & 0x0000_FFFF_0000_FFFF;
    v = (v | v << 8) & 0x00FF_00FF_00FF_00FF;
    v = (v | v << 4) & 0x0F0F_0F0F_0F0F_0F0F;
    v = (v | v << 2) & 0x3333_3333_3333_3333;
    (v | v << 1) & 0x5555_5555_5555_5555
}

fn gather_even_bits(v: u64) -> u32 {
    let mut v = v & 0x5555_5555_5555_5555;
    v = (v | v >> 1) & 0x3333_3333_3333_3333;
    v = (v | v >> 2) & 0x0F0F_0F0F_0F0F_0F0F;
    v = (v | v >> 4) & 0x00FF_00FF_00FF_00FF;
    v = (v | v >> 8) & 0x0000_FFFF_0000_FFFF;
    (v | v >> 16) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn refuses_sizes_that_make_no_grid() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
            assert!(Frame::new(bad, 0.1).is_err());
            assert!(Frame::new(0.1, bad).is_err());
        }
    }

    #[test]
    fn indices_round_down_and_saturate() {
        for v in [0.0, -0.0, 0.5, -0.5, 1.0, -1.0, 3.99, -3.99, 1e15 + 0.5, -1e15 - 0.5, 0.49999999999999994] {
            assert_eq!(floor_index(v), f64::floor(v) as i64, "{v}");
        }
        assert_eq!(floor_index(f64::NAN), 0);
        assert_eq!(floor_index(f64::INFINITY), 1 << 50);
        assert_eq!(floor_index(f64::NEG_INFINITY), -1 << 50);
        assert_eq!(floor_index(-1e300), -1 << 50);
    }

    #[test]
    fn limits_are_sizes_still_and_coarser_grids_end_there() {
        assert!(Frame::new(1e-6, 1e6).is_ok() && Frame::new(1e6, 1e-6).is_ok());
        let frame = Frame::new(0.1, 0.3).unwrap();
        assert_eq!(frame.coarser(0), Some(frame));
        // 0.3 m times 4 to the power of 10 is 314,573 m; another factor of 4 is too much.
        assert!(frame.coarser(10).is_some() && frame.coarser(11).is_none());
        assert_eq!([31, 32, 1 << 30].map(|number| frame.coarser(number)), [None; 3]);
        let fine = Frame::new(1e-6, 1e-6).unwrap();
        assert!(fine.coarser(19).is_some() && fine.coarser(20).is_none());
    }

    #[test]
    fn keys_say_their_indices() {
        assert_eq!(PageKey { tx: -3, ty: 40, layer: 7 }.to_string(), "(-3, 40, 7)");
    }

    /// Reference: the column's position on the curve, bit by bit.
    fn interleaved(tx: i32, ty: i32) -> u64 {
        let bit = |v: i32, bit: u32| u64::from((v as u32 ^ 1 << 31) >> bit & 1);
        (0..32).fold(0, |sum, at| sum | bit(tx, at) << (2 * at) | bit(ty, at) << (2 * at + 1))
    }

    proptest! {
        #[test]
        fn keys_are_ordered_along_the_curve_and_then_by_layer(a: [i32; 3], b: [i32; 3], near: bool) {
            let [a, mut b] = [a, b].map(|[tx, ty, layer]| PageKey { tx, ty, layer });
            if near {
                (b.tx, b.ty) = (a.tx, a.ty);
            }
            prop_assert_eq!(a.column(), interleaved(a.tx, a.ty));
            let order = |key: PageKey| (interleaved(key.tx, key.ty), key.layer);
            prop_assert_eq!(a.cmp(&b), order(a).cmp(&order(b)));
            prop_assert_eq!(a.partial_cmp(&b), Some(a.cmp(&b)));
        }

        /// If sizes are powers of two, edges are exact: each edge is the least coordinate of its pixel or slice.
        #[test]
        fn edges_are_where_pixels_and_slices_begin(index in -MAX_INDEX / 8..MAX_INDEX / 8, power in -8i32..4) {
            let size = 2f64.powi(power);
            let frame = Frame::new(size, 255.0 * size).unwrap();
            let (edge, bottom) = (frame.edge_of_pixel(index), frame.bottom_of_slice(index));
            prop_assert_eq!([frame.pixel_of(edge), frame.pixel_of(edge.next_down())], [index, index - 1]);
            prop_assert_eq!([frame.slice_of(bottom), frame.slice_of(bottom.next_down())], [index, index - 1]);
            prop_assert_eq!(frame.quantum_floor(bottom), 255 * index);
            prop_assert_eq!(frame.quantum_ceil(bottom), 255 * index);
            prop_assert_eq!(frame.quantum_m(), size);
        }

        #[test]
        fn indices_of_coarser_grids_are_those_of_this_one_divided(
            x in -1e7f64..1e7, t in 0.001f64..1.0, s in 0.003f64..3.0, number in 0u32..8
        ) {
            let frame = Frame::new(t, s).unwrap();
            let coarse = frame.coarser(number).unwrap();
            let factor = 4i64.pow(number);
            prop_assert_eq!([coarse.pixel_m(), coarse.slice_m()], [t, s].map(|size| size * factor as f64));
            prop_assert_eq!(coarse.pixel_of(x), frame.pixel_of(x).div_euclid(factor));
            prop_assert_eq!(coarse.quantum_floor(x), frame.quantum_floor(x).div_euclid(factor));
            prop_assert_eq!(coarse.slice_of(x), frame.slice_of(x).div_euclid(factor));
        }

        #[test]
        fn morton_round_trips_and_orders_within_a_row_of_two(tx: i32, ty: i32, layer: i32) {
            let key = PageKey { tx, ty, layer };
            prop_assert_eq!(PageKey::from_column(key.column(), layer), key);
        }

        #[test]
        fn heights_enclose_the_points_that_they_stand_for(z in -1e7f64..1e7, slice in 0.003f64..3.0) {
            let frame = Frame::new(0.1, slice).unwrap();
            let top = frame.top_height(frame.quantum_ceil(z));
            let bottom = frame.bottom_height(frame.quantum_floor(z));
            prop_assert!(bottom <= z && z <= top);
            let slack = frame.quantum_m() + 1e-8;
            prop_assert!(top - z <= slack && z - bottom <= slack);
        }

        #[test]
        fn tops_are_the_greatest_heights_of_their_quantum(quantum in -1i64 << 40..1 << 40, slice in 0.003f64..3.0) {
            let frame = Frame::new(0.1, slice).unwrap();
            let top = frame.top_height(quantum);
            prop_assert!(frame.quanta(top) <= quantum as f64 && frame.quanta(top.next_up()) > quantum as f64);
        }

        #[test]
        fn world_to_grid_is_monotone(a in -1e7f64..1e7, step in 0.0f64..1e-6, t in 0.001f64..1.0) {
            let frame = Frame::new(t, 3.0 * t).unwrap();
            prop_assert!(frame.pixel_of(a) <= frame.pixel_of(a + step));
            prop_assert!(frame.quantum_ceil(a) <= frame.quantum_ceil(a + step));
        }
    }
}
