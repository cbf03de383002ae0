//! Vertical extents of the solids of each pixel, which settle most classifications.

use crate::frame::SLICE_QUANTA;
use crate::voxel::accumulate::{Patch, Voxel};
use crate::voxel::record::{PATCH_AREA, PATCH_PIXELS};

/// Lowest bottom and highest top in each pixel of a patch, and in the 3 × 3 pixels around it. Heights are quanta above
/// the column block's floor with the highest bit flipped, which makes them signed numbers that every processor compares
/// in vector lanes. Memory: 70 kB, reused.
#[derive(Debug)]
pub struct Extents {
    own: LowHigh,
    around: LowHigh,
}

#[derive(Debug)]
struct LowHigh {
    low: Vec<i32>,
    high: Vec<i32>,
}

impl LowHigh {
    /// Height of the solids in an occupied pixel (quanta).
    #[inline]
    fn height(&self, pixel: usize) -> i64 {
        i64::from(self.high[pixel]) - i64::from(self.low[pixel])
    }
}

impl Default for Extents {
    fn default() -> Self {
        let nowhere = || LowHigh { low: vec![i32::MAX; PATCH_AREA], high: vec![i32::MIN; PATCH_AREA] };
        Self { own: nowhere(), around: nowhere() }
    }
}

impl Extents {
    /// Sets the extents of the pixels of a patch.
    pub fn set(&mut self, patch: &Patch) {
        let LowHigh { low, high } = &mut self.own;
        low.fill(i32::MAX);
        high.fill(i32::MIN);
        for pixel in patch.occupied() {
            let voxels = &patch.voxels()[patch.range(pixel)];
            // Voxels are sorted by slice, so by height.
            if let [first, .., last] | [first @ last] = voxels {
                let quanta = |voxel: &Voxel, height: u8| {
                    (voxel.slice * SLICE_QUANTA as u32 + u32::from(height)) as i32 ^ i32::MIN
                };
                (low[pixel], high[pixel]) = (quanta(first, first.bottom), quanta(last, last.top));
            }
        }
    }

    /// Sets the extents around each pixel from those of the pixels.
    pub fn set_around(&mut self) {
        three_by_three(&self.own.low, &mut self.around.low, i32::min);
        three_by_three(&self.own.high, &mut self.around.high, i32::max);
    }

    /// Height of the solids in an occupied pixel (quanta).
    #[inline]
    pub fn height(&self, pixel: usize) -> i64 {
        self.own.height(pixel)
    }

    /// Height of the solids in the 3 × 3 pixels around an occupied one that is not in the halo (quanta).
    #[inline]
    pub fn height_around(&self, pixel: usize) -> i64 {
        self.around.height(pixel)
    }
}

/// Sets `to`, except in the halo of a patch, to the `join` of the 3 × 3 values around each; first across rows, in loops
/// that compile to vector instructions.
fn three_by_three(values: &[i32], to: &mut [i32], join: impl Fn(i32, i32) -> i32) {
    let (rows, _) = values.as_chunks::<PATCH_PIXELS>();
    let (to, _) = to.as_chunks_mut::<PATCH_PIXELS>();
    for (to, three) in to[1..].iter_mut().zip(rows.windows(3)) {
        let joined: [i32; PATCH_PIXELS] = std::array::from_fn(|x| join(three[1][x], join(three[0][x], three[2][x])));
        for x in 1..PATCH_PIXELS - 1 {
            to[x] = join(joined[x], join(joined[x - 1], joined[x + 1]));
        }
    }
}
