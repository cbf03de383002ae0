//! Colours of the pages that scenes draw, on the grid of a drawing, for a texture in which a shader looks up voxels.
//!
//! In: colours of a page and the coarseness of its drawing. Out: masks of the slices with a colour, and colours.

use slicewalk::frame::TILE_PIXELS;
use slicewalk::page::Colours;

/// Colours of a page, cell by cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Paint {
    /// Cells along an edge.
    pub edge: u32,
    /// Four per cell, row by row: slices with a colour (low and high 32 bits), index of the cell's first colour, zero.
    pub cells: Vec<u32>,
    /// Red, green, blue and 255; within a cell from its lowest slice up.
    pub colours: Vec<u8>,
}

impl Paint {
    /// Builds cells of `2^coarseness` pixels. The colour of several voxels is the root mean square of each channel,
    /// which is about the mean of their light.
    pub fn new(colours: &Colours, coarseness: u32) -> Self {
        let edge = TILE_PIXELS as u32 >> coarseness;
        let mut paint = Self { edge, cells: Vec::with_capacity((4 * edge * edge) as usize), colours: Vec::new() };
        let occupancy = colours.occupancy();
        for number in 0..edge * edge {
            let (x, y) = ((number % edge) << coarseness, (number / edge) << coarseness);
            let (mut mask, mut sums) = (0u64, [[0u32; 4]; 64]);
            for (dx, dy) in (0..1 << coarseness).flat_map(|dy| (0..1 << coarseness).map(move |dx| (dx, dy))) {
                let (mut slices, first) = occupancy.pixel((64 * (y + dy) + x + dx) as usize);
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

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk::archive::{Archive, ArchiveWriter, ColourReader, EncodedColours, PageEncoder, Totals};
    use slicewalk::codec::ColourEncoder;
    use slicewalk::colour::{ColourPlan, ColourScale};
    use slicewalk::frame::{Frame, PageKey};
    use slicewalk::page::{Occupancy, PageBuilder, Span};
    use slicewalk::plan::Plan;

    const RED: [u16; 3] = [65_535, 0, 0];
    const BLACK: [u16; 3] = [0, 0, 0];

    /// Two occupied pixels in slices 2 and 40, and one without a colour.
    fn colours() -> Colours {
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let mut page = PageBuilder::default();
        let spans =
            [Span::new(2 * 255, 2 * 255 + 100, false).unwrap(), Span::new(40 * 255, 40 * 255 + 9, true).unwrap()];
        for (x, y) in [(6, 9), (7, 9), (20, 20)] {
            assert!(page.set_column(x, y, &spans));
        }
        let (page, key) = (page.build(), PageKey { tx: 0, ty: 0, layer: 0 });
        let exact = [Some(RED), Some(BLACK), Some(BLACK), Some(RED), None, None];
        let of_colours = ColourPlan { scale: ColourScale::of_rgb(65_535), error_milli: 0 };
        let encoded = EncodedColours::new(&of_colours, &Occupancy::of(&page), &exact, &mut ColourEncoder::default());
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        writer.set_colours(of_colours);
        writer.put(key, PageEncoder::new(plan.frame).encode(key, &page).with_colours(encoded)).unwrap();
        writer.finish(Totals { points_read: 1, points_kept: 1, ..Totals::default() }).unwrap();
        let archive = Archive::open(&target).unwrap();
        ColourReader::new(&archive).unwrap().unwrap().colours_of(key, &page).unwrap()
    }

    fn cell(paint: &Paint, x: u32, y: u32) -> (u64, Vec<[u8; 4]>) {
        let at = 4 * (y * paint.edge + x) as usize;
        let [low, high, first, 0] = paint.cells[at..at + 4] else { panic!("four numbers a cell") };
        let mask = u64::from(high) << 32 | u64::from(low);
        let colours = paint.colours.as_chunks::<4>().0[first as usize..].iter();
        (mask, colours.take(mask.count_ones() as usize).copied().collect())
    }

    #[test]
    fn a_cell_has_the_mean_of_its_voxels_in_each_slice() {
        let colours = colours();
        let fine = Paint::new(&colours, 0);
        assert_eq!((fine.edge, fine.cells.len(), fine.colours.len()), (64, 4 * 64 * 64, 16));
        let both = 1 << 2 | 1 << 40;
        assert_eq!(cell(&fine, 6, 9), (both, vec![[255, 0, 0, 255], [0, 0, 0, 255]]));
        assert_eq!(cell(&fine, 7, 9), (both, vec![[0, 0, 0, 255], [255, 0, 0, 255]]));
        assert_eq!(cell(&fine, 20, 20), (0, vec![]));
        let coarse = Paint::new(&colours, 1);
        assert_eq!(coarse.edge, 32);
        // The square root of half of 255².
        assert_eq!(cell(&coarse, 3, 4), (both, vec![[180, 0, 0, 255]; 2]));
        assert_eq!(coarse.colours.len(), 8);
    }
}
