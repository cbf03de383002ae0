//! Colours of levels: for each voxel of a level, the sum over the archive's coloured voxels inside.
//!
//! Sums are of integers, so they do not depend on the order. The sums of all levels are over the archive's own voxels,
//! so errors do not add up from level to level.

use super::build::Sortable;
use super::coarse::{FACTOR, PIXELS, SLICES, above, part};
use crate::colour::ColourSum;
use crate::frame::PageKey;
use crate::page::Occupancy;

/// Largest value of a channel.
const WHITE: u16 = 255;
/// Voxels of a level that a page of the level below covers.
const CELLS: usize = (PIXELS * PIXELS * SLICES) as usize;

/// Colour sum that a page of the archive contributes to one voxel of level 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoarseColour {
    /// `16·y + x` in the part of the upper page that the lower one covers.
    pixel: u8,
    /// Slice in that part (0..=15).
    slice: u8,
    /// Number of coloured voxels (1..=64), and the sums of their channels.
    n: u8,
    sum: [u16; 3],
}

impl CoarseColour {
    pub fn place_and_sum(&self) -> (u8, u8, ColourSum) {
        (self.pixel, self.slice, ColourSum { n: self.n.into(), sum: self.sum.map(u64::from) })
    }
}

/// Returns the index, among the voxels of the level that a page covers, of slice `k` in the page's pixel `64·y + x`.
#[inline]
fn cell(pixel: usize, k: u32) -> usize {
    let (x, y) = (pixel as u32 & 63, pixel as u32 >> 6);
    ((y / FACTOR * PIXELS + x / FACTOR) * SLICES + k / FACTOR) as usize
}

/// Returns pixel and slice of voxel index `cell`.
fn place(cell: usize) -> (u8, u8) {
    ((cell / SLICES as usize) as u8, (cell % SLICES as usize) as u8)
}

/// Returns the contribution of a page to level 1, ordered by pixel and slice, from the decoded colours of its voxels.
pub fn coarse_colours(occupancy: &Occupancy, colours: impl Iterator<Item = Option<[u8; 3]>>) -> Box<[CoarseColour]> {
    let mut sums = vec![(0u8, [0u16; 3]); CELLS];
    for ((pixel, k), colour) in occupancy.voxels().zip(colours) {
        let Some(colour) = colour else { continue };
        let (n, sum) = &mut sums[cell(pixel, k)];
        *n += 1;
        sum.iter_mut().zip(colour).for_each(|(sum, channel)| *sum += u16::from(channel));
    }
    let some = sums.iter().enumerate().filter(|(_, (n, _))| *n > 0);
    some.map(|(cell, &(n, sum))| {
        let (pixel, slice) = place(cell);
        CoarseColour { pixel, slice, n, sum }
    })
    .collect()
}

/// Colour sum of a voxel of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoxelSum {
    /// `64·y + x` in the page.
    pub pixel: u16,
    /// Slice in the page (0..=63).
    pub slice: u8,
    pub sum: ColourSum,
}

/// Returns the contribution of a page of a level to the level above: pixel, slice and sum.
pub fn coarser(voxels: &[VoxelSum]) -> Vec<(u8, u8, ColourSum)> {
    if voxels.is_empty() {
        return Vec::new();
    }
    let mut sums = vec![ColourSum::default(); CELLS];
    for voxel in voxels {
        let sum = &mut sums[cell(voxel.pixel.into(), voxel.slice.into())];
        sum.n += voxel.sum.n;
        sum.sum.iter_mut().zip(voxel.sum.sum).for_each(|(sum, more)| *sum += more);
    }
    let some = sums.into_iter().enumerate().filter(|(_, sum)| sum.n > 0);
    some.map(|(cell, sum)| {
        let (pixel, slice) = place(cell);
        (pixel, slice, sum)
    })
    .collect()
}

/// Returns exact colours (16 bits a channel) of the voxels of a page of a level, from sums ordered by pixel and slice.
///
/// A sum may belong to no voxel: a span that only touches a slice boundary from above merges with one that ends there,
/// and then belongs to the slice below.
pub fn exact(occupancy: &Occupancy, sums: &[VoxelSum]) -> Vec<Option<[u16; 3]>> {
    let mut sums = sums.iter().peekable();
    let own = |place: (usize, u32)| {
        let place_of = |sum: &VoxelSum| (usize::from(sum.pixel), u32::from(sum.slice));
        while sums.next_if(|sum| place_of(sum) < place).is_some() {}
        sums.next_if(|sum| place_of(sum) == place)?.sum.mean(WHITE)
    };
    occupancy.voxels().map(own).collect()
}

/// Colour sum of a voxel of a level; records sort by layer, pixel and slice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourRecord {
    /// Layer (plus 2³¹) from bit 32, pixel from bit 16, slice in the lowest bits.
    place: u64,
    sum: ColourSum,
}

impl ColourRecord {
    /// Creates the record of the voxel in `slice` of `pixel` (`16·y + x`) that page `below` contributes to.
    pub fn new(below: PageKey, (pixel, slice, sum): (u8, u8, ColourSum)) -> Self {
        let (x, y) = (u32::from(pixel) % PIXELS, u32::from(pixel) / PIXELS);
        let pixel = (part(below.ty) * PIXELS + y) * 64 + part(below.tx) * PIXELS + x;
        let slice = part(below.layer) * SLICES + u32::from(slice);
        let layer = above(below).layer as u32 ^ 1 << 31;
        Self { place: u64::from(layer) << 32 | u64::from(pixel) << 16 | u64::from(slice), sum }
    }

    pub fn layer(&self) -> i32 {
        ((self.place >> 32) as u32 ^ 1 << 31) as i32
    }

    pub fn voxel(&self) -> VoxelSum {
        VoxelSum { pixel: (self.place >> 16) as u16, slice: self.place as u8, sum: self.sum }
    }
}

impl Sortable for ColourRecord {
    const KEPT: usize = 1 << 15;
    const LEN: usize = 40;

    fn place(&self) -> u64 {
        self.place
    }

    fn put(&self, out: &mut Vec<u8>) {
        let [r, g, b] = self.sum.sum;
        [self.place, self.sum.n, r, g, b].iter().for_each(|word| out.extend(word.to_le_bytes()));
    }

    fn of(bytes: &[u8]) -> Self {
        let mut words = bytes.as_chunks::<8>().0.iter().map(|word| u64::from_le_bytes(*word));
        let mut word = || words.next().unwrap_or_default();
        Self { place: word(), sum: ColourSum { n: word(), sum: [word(), word(), word()] } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::pages;
    use crate::page::{PageBuilder, Span};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        /// Reference: voxel indices divided by four.
        #[test]
        fn sums_are_those_of_the_voxels_inside(page in pages(), seed: u32, key in any::<[i8; 3]>()) {
            let occupancy = Occupancy::of(&page);
            let colour = |number: usize| {
                let hash = (number as u32 ^ seed).wrapping_mul(0x9E37_79B1);
                (!hash.is_multiple_of(5)).then(|| [8, 16, 24].map(|shift| (hash >> shift) as u8))
            };
            let given = coarse_colours(&occupancy, (0..occupancy.len()).map(colour));
            let below = PageKey { tx: key[0].into(), ty: key[1].into(), layer: key[2].into() };
            let found: BTreeMap<_, _> = given.iter().map(|one| {
                let record = ColourRecord::new(below, one.place_and_sum());
                assert_eq!(ColourRecord::of(&{ let mut bytes = Vec::new(); record.put(&mut bytes); bytes }), record);
                let voxel = record.voxel();
                ((record.layer(), voxel.pixel, voxel.slice), voxel.sum)
            }).collect();
            prop_assert_eq!(found.len(), given.len());
            let mut expected: BTreeMap<_, ColourSum> = BTreeMap::new();
            for (number, (pixel, k)) in occupancy.voxels().enumerate() {
                let whole = |tile: i8, at: usize| (i32::from(tile) * 64 + at as i32).div_euclid(4);
                let [x, y, z] = [whole(key[0], pixel & 63), whole(key[1], pixel >> 6), whole(key[2], k as usize)];
                let place = (z.div_euclid(64), (y.rem_euclid(64) * 64 + x.rem_euclid(64)) as u16, z.rem_euclid(64) as u8);
                if let Some(colour) = colour(number) {
                    let sum = expected.entry(place).or_default();
                    sum.n += 1;
                    (0..3).for_each(|channel| sum.sum[channel] += u64::from(colour[channel]));
                }
            }
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn sums_of_no_voxel_colour_none() {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(5, 1, &[Span::new(100, 600, false).unwrap()]));
        let occupancy = Occupancy::of(&builder.build());
        let voxel = |pixel, slice| VoxelSum { pixel, slice, sum: ColourSum { n: 2, sum: [2, 3, 510] } };
        let colour = Some([257, 386, 65_535]);
        for (sums, expected) in [
            (vec![voxel(69, 0), voxel(69, 2)], [colour, None, colour]),
            (vec![voxel(3, 1), voxel(68, 1), voxel(69, 1), voxel(69, 3), voxel(70, 0)], [None, colour, None]),
            (vec![voxel(69, 3)], [None; 3]),
        ] {
            assert_eq!(exact(&occupancy, &sums), expected);
        }
    }

    #[test]
    fn a_level_above_a_level_sums_its_sums() {
        let sum = |n, channel| ColourSum { n, sum: [channel; 3] };
        let voxel = |x: u16, y: u16, slice, sum| VoxelSum { pixel: 64 * y + x, slice, sum };
        let voxels = [voxel(0, 0, 0, sum(1, 7)), voxel(3, 3, 3, sum(1 << 40, 1 << 45)), voxel(4, 3, 3, sum(2, 9))];
        assert_eq!(coarser(&voxels), [(0, 0, sum((1 << 40) + 1, (1 << 45) + 7)), (1, 0, sum(2, 9))]);
        assert!(coarser(&[]).is_empty());
    }
}
