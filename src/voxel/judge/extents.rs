//! From where to where the matter of each pixel reaches: what settles most verdicts.

use crate::frame::SLICE_QUANTA;
use crate::voxel::fold::{Patch, Voxel};
use crate::voxel::record::{PATCH_AREA, PATCH_PIXELS};

/// Lowest bottom and highest top in each pixel of a patch, and in the 3 × 3 pixels around it. Heights are quanta above the column
/// block's floor with the highest bit turned: as signed numbers, which every processor compares in lanes. Memory: 70 kB, reused.
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
    /// Height in a pixel with matter (quanta).
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
    /// Sets those of the pixels of a patch.
    pub fn set(&mut self, patch: &Patch) {
        let LowHigh { low, high } = &mut self.own;
        low.fill(i32::MAX);
        high.fill(i32::MIN);
        for pixel in patch.occupied() {
            let voxels = &patch.voxels()[patch.range(pixel)];
            // In order of slices, so of heights.
            if let [first, .., last] | [first @ last] = voxels {
                let quanta = |voxel: &Voxel, height: u8| {
                    (voxel.slice * SLICE_QUANTA as u32 + u32::from(height)) as i32 ^ i32::MIN
                };
                (low[pixel], high[pixel]) = (quanta(first, first.bottom), quanta(last, last.top));
            }
        }
    }

    /// Sets those around each pixel, from those of the pixels.
    pub fn set_around(&mut self) {
        three_by_three(&self.own.low, &mut self.around.low, i32::min);
        three_by_three(&self.own.high, &mut self.around.high, i32::max);
    }

    /// Height of what lies in a pixel with matter (quanta).
    #[inline]
    pub fn height(&self, pixel: usize) -> i64 {
        self.own.height(pixel)
    }

    /// Height of what lies in the 3 × 3 pixels around one with matter that is not in the halo (quanta).
    #[inline]
    pub fn height_around(&self, pixel: usize) -> i64 {
        self.around.height(pixel)
    }
}

/// Sets `to`, but in the halo of a patch, to the `join` of the 3 × 3 values around each; rows first, in loops that compile to vector
/// instructions.
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
