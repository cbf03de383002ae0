//! Colours of the pages that scenes draw, on the grid of a drawing: for a texture that a shader looks voxels up in.
//!
//! In: which pages are drawn and how finely; bytes, when nothing else is on its way. Out: masks of the slices with a colour, and colours.

use slicewalk::frame::TILE_PIXELS;
use slicewalk::slice::Colours;

/// Colours of a page, cell by cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Paint {
    /// Cells along an edge.
    pub edge: u32,
    /// Four a cell, row by row: slices with a colour (low and high 32 bits), number of the cell's first colour, zero.
    pub cells: Vec<u32>,
    /// Red, green, blue and 255; those of a cell from its lowest slice up.
    pub colours: Vec<u8>,
}

impl Paint {
    /// With cells of `2^coarseness` pixels; a colour of several voxels is their mean, of the squares of channels, which is
    /// about that of their light.
    pub fn new(colours: &Colours, coarseness: u32) -> Self {
        let edge = TILE_PIXELS as u32 >> coarseness;
        let mut paint = Self { edge, cells: Vec::with_capacity((4 * edge * edge) as usize), colours: Vec::new() };
        let occupancy = colours.occupancy();
        for number in 0..edge * edge {
            let (x, y) = ((number % edge) << coarseness, (number / edge) << coarseness);
            let (mut mask, mut sums) = (0u64, [[0u32; 4]; 64]);
            for (dx, dy) in (0..1 << coarseness).flat_map(|dy| (0..1 << coarseness).map(move |dx| (dx, dy))) {
                let (mut slices, first) = occupancy.pixel(((y + dy) << 6 | x + dx) as usize);
                let mut at = first;
                while slices != 0 {
                    let k = slices.trailing_zeros();
                    slices &= slices - 1;
                    if let Some(&[r, g, b, 255]) = colours.values().get(at) {
                        mask |= 1 << k;
                        let sum = &mut sums[k as usize];
                        for (sum, channel) in sum.iter_mut().zip([r, g, b]) {
                            *sum += u32::from(channel) * u32::from(channel);
                        }
                        sum[3] += 1;
                    }
                    at += 1;
                }
            }
            paint.cells.extend([mask as u32, (mask >> 32) as u32, paint.colours.len() as u32 / 4, 0]);
            while mask != 0 {
                let [r, g, b, count] = sums[mask.trailing_zeros() as usize];
                mask &= mask - 1;
                let mean = |sum: u32| ((f64::from(sum) / f64::from(count)).sqrt() + 0.5) as u8;
                paint.colours.extend([mean(r), mean(g), mean(b), 255]);
            }
        }
        paint
    }
}
