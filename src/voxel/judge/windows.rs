//! Sums over the points of 3 × 3 pixels, of all pixels at once: what judges rough ground of few points, where every pixel's
//! surface has to be fitted.

use super::extents::three_by_three;
use crate::voxel::bands::Bands;
use crate::voxel::fold::{Moments, Patch, Sums};
use crate::voxel::record::{Content, PATCH_AREA, PATCH_PIXELS, SLICE_STEPS, SUBPIXELS};

/// Bands of a patch up to which its sums stay small enough: squares of heights below 2²⁰ steps, of fewer than 2²² points.
const MOST_BANDS: u32 = 1 << 7;

/// The sums of each pixel's window, about one origin for the whole patch: what a fit makes of them does not depend on it.
/// Memory: 350 kB.
#[derive(Debug)]
pub struct Windows {
    /// Of each of the ten numbers, those of all pixels.
    sums: [Vec<i64>; 10],
}

impl Windows {
    /// Of a patch; `None` where it is too high, or has many points for its voxels.
    ///
    /// Cost: each point once, and 40 additions a pixel.
    pub fn of(patch: &Patch, sums: &Sums, bands: Bands) -> Option<Self> {
        let by_pixel = sums.few_by_pixel()?;
        let of_voxels = || patch.voxels().iter().map(|voxel| bands.of(voxel.slice));
        let (lowest, highest) = (of_voxels().min()?, of_voxels().max()?);
        if highest - lowest >= MOST_BANDS {
            return None;
        }
        let mut all = [(); 10].map(|()| vec![0; PATCH_AREA]);
        for (pixel, records) in by_pixel {
            let (x, y) = ((pixel % PATCH_PIXELS) as i64 * SUBPIXELS, (pixel / PATCH_PIXELS) as i64 * SUBPIXELS);
            let mut own = Moments::default();
            for &record in records.iter().filter(|record| record.content() == Content::Point) {
                let (u, v) = record.place();
                let above = i64::from(bands.of(record.slice()) - lowest) * SLICE_STEPS;
                own.add(i64::from(u) + x, i64::from(v) + y, bands.height(record) + above);
            }
            all.iter_mut().zip(own.numbers()).for_each(|(to, number)| to[pixel] = number);
        }
        Some(Self { sums: all.map(|own| three_by_three(&own, |a, b| a + b)) })
    }

    /// The sums over all points in the 3 × 3 pixels around a pixel that is not in the halo.
    #[inline]
    pub fn around(&self, pixel: usize) -> Moments {
        Moments::from_numbers(std::array::from_fn(|number| self.sums[number][pixel]))
    }
}
