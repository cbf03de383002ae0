//! From where to where the matter of each pixel reaches: what settles most verdicts.

use crate::frame::SLICE_QUANTA;
use crate::voxel::fold::{Patch, Voxel};
use crate::voxel::record::{PATCH_AREA, PATCH_PIXELS};

/// Lowest bottom and highest top in each pixel of a patch (quanta above the column block's floor).
#[derive(Debug)]
pub struct Extents {
    low: Vec<u32>,
    high: Vec<u32>,
}

impl Extents {
    /// Of the pixels of a patch. Memory: 35 kB.
    pub fn of(patch: &Patch) -> Self {
        let (mut low, mut high) = (vec![u32::MAX; PATCH_AREA], vec![0; PATCH_AREA]);
        for pixel in patch.occupied() {
            let voxels = &patch.voxels()[patch.range(pixel)];
            // In order of slices, so of heights.
            if let [first, .., last] | [first @ last] = voxels {
                let quanta = |voxel: &Voxel, height: u8| voxel.slice * SLICE_QUANTA as u32 + u32::from(height);
                (low[pixel], high[pixel]) = (quanta(first, first.bottom), quanta(last, last.top));
            }
        }
        Self { low, high }
    }

    /// Of the 3 × 3 pixels around each pixel; in the halo of a patch it means nothing.
    pub fn around(&self) -> Self {
        Self { low: three_by_three(&self.low, u32::min), high: three_by_three(&self.high, u32::max) }
    }

    /// Height of what lies in a pixel with matter (quanta).
    #[inline]
    pub fn height(&self, pixel: usize) -> i64 {
        i64::from(self.high[pixel]) - i64::from(self.low[pixel])
    }
}

/// `join` of the 3 × 3 values around each; rows first, then columns, in loops that compile to vector instructions.
pub fn three_by_three<T: Copy>(values: &[T], join: impl Fn(T, T) -> T) -> Vec<T> {
    let three = |values: &[T], step: usize| {
        let count = values.len() - 2 * step;
        let threes = values[..count].iter().zip(&values[step..]).zip(&values[2 * step..]);
        let mut joined = values[..step].to_vec();
        joined.reserve_exact(count + step);
        joined.extend(threes.map(|((&before, &own), &after)| join(own, join(before, after))));
        joined.extend_from_slice(&values[count + step..]);
        joined
    };
    three(&three(values, 1), PATCH_PIXELS)
}
