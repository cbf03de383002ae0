//! Accumulates the records of a tile column into voxels.
//!
//! An accumulator keeps only minima, maxima and sums of integers. Accumulation is exactly associative and commutative,
//! so the result does not depend on the order of points, files and threads (guarantee G4), and voxels of parts of a
//! scan add up to the voxels of the whole.

mod area;
mod elsewhere;
mod moments;
mod pieces;
mod sums;
mod voxel;

use super::record::{HALO_PIXELS, PATCH_AREA, PATCH_PIXELS, Record, RecordPieces};
pub use area::Area;
pub use elsewhere::{Accumulate, Job, PointVoxel};
pub use moments::Moments;
pub use pieces::{Folded, PieceFolder};
use std::ops::Range;
pub use sums::{Sums, place_in_patch};
pub use voxel::{BINS, Voxel};

/// Slices of one pixel that are distinguished at once, by remainder; a pixel whose slices collide is sorted.
const RECENT: usize = 1 << 10;
/// Up to this number of records of a pixel, sorting them costs less than distinguishing their slices.
const MOST_SORTED: usize = 16;

/// Accumulates the records of one pixel after another into voxels; reuses its buffers.
#[derive(Debug)]
struct Folder {
    /// Voxels of the current pixel, each with its number of points.
    voxels: Vec<(Voxel, u32)>,
    /// Number in `voxels` of the last voxel whose slice has this remainder; may be left over from an earlier pixel.
    recent: Box<[u32; RECENT]>,
}

impl Default for Folder {
    fn default() -> Self {
        Self { voxels: Vec::new(), recent: Box::new([0; RECENT]) }
    }
}

impl Folder {
    /// Returns the voxels of one pixel's records, lowest slice first, each with its number of points; and whether the
    /// records were sorted.
    fn fold(&mut self, points: &mut [Record]) -> (&[(Voxel, u32)], bool) {
        let is_sorted = points.len() <= MOST_SORTED || !self.fold_unsorted(points);
        if is_sorted {
            points.sort_unstable();
            self.voxels.clear();
            for &point in &*points {
                match self.voxels.last_mut() {
                    Some((voxel, count)) if voxel.slice == point.slice() => {
                        voxel.add(point);
                        *count = count.saturating_add(1);
                    }
                    _ => self.voxels.push((Voxel::of(point), 1)),
                }
            }
        }
        (&self.voxels, is_sorted)
    }

    /// Accumulates records in any order; returns `false` if two of their slices have the same remainder.
    fn fold_unsorted(&mut self, points: &[Record]) -> bool {
        let Self { voxels, recent } = self;
        voxels.clear();
        for &point in points {
            let slice = point.slice();
            let place = &mut recent[slice as usize % RECENT];
            let number = match voxels.get(*place as usize) {
                Some((voxel, _)) if voxel.slice == slice => *place as usize,
                Some((voxel, _)) if voxel.slice as usize % RECENT == slice as usize % RECENT => return false,
                _ => {
                    voxels.push((Voxel::empty(slice), 0));
                    voxels.len() - 1
                }
            };
            *place = number as u32;
            voxels[number].0.add(point);
            voxels[number].1 = voxels[number].1.saturating_add(1);
        }
        voxels.sort_unstable_by_key(|(voxel, _)| voxel.slice);
        true
    }
}

/// The voxels of a tile column with its halo, ordered by pixel, then by slice.
#[derive(Debug, Default)]
pub struct Patch {
    starts: Vec<u32>,
    occupied: Vec<u16>,
    voxels: Vec<Voxel>,
    folder: Folder,
}

impl Patch {
    /// All voxels.
    pub fn voxels(&self) -> &[Voxel] {
        &self.voxels
    }

    /// Returns the patch pixels with voxels, in order.
    pub fn occupied(&self) -> impl Iterator<Item = usize> + '_ {
        self.occupied.iter().map(|&pixel| usize::from(pixel))
    }

    /// Returns the numbers of the voxels of a patch pixel.
    #[inline]
    pub fn range(&self, patch_pixel: usize) -> Range<usize> {
        self.starts[patch_pixel] as usize..self.starts[patch_pixel + 1] as usize
    }

    /// Replaces the contents by the voxels of `records`, over which `sums` will sum. Drops voxels without surface that
    /// have fewer than `min_points` points, and those marked as dropped by a record. Returns the number of voxels
    /// dropped in `area`, without its halo.
    pub fn fold(
        &mut self,
        records: &(impl RecordPieces + ?Sized),
        min_points: u32,
        area: Area,
        sums: &mut Sums,
    ) -> u64 {
        let Self { starts, occupied, voxels, folder } = self;
        starts.clear();
        occupied.clear();
        voxels.clear();
        sums.begin(records);
        let (mut dropped, mut folded) = (0, 0);
        for pixel in 0..PATCH_AREA {
            let (first, before) = (voxels.len(), folded);
            starts.push(first as u32);
            let own = sums.records.of_mut(pixel);
            if own.is_empty() {
                continue;
            }
            if let [record] = own {
                let voxel = Voxel::of(*record);
                folded += 1;
                if voxel.is_kept(1, min_points) {
                    voxels.push(voxel);
                }
            } else {
                let (all, is_sorted) = folder.fold(own);
                folded += all.len();
                let kept = all.iter().filter(|(voxel, points)| voxel.is_kept(i64::from(*points), min_points));
                voxels.extend(kept.map(|(voxel, _)| voxel));
                sums.in_order[pixel] = is_sorted;
            }
            if voxels.len() > first {
                occupied.push(pixel as u16);
            }
            if folded - before > voxels.len() - first && area.holds(pixel) {
                dropped += (folded - before - (voxels.len() - first)) as u64;
            }
        }
        starts.push(voxels.len() as u32);
        sums.end(&self.voxels, folded == self.voxels.len());
        dropped
    }

    /// Replaces the contents by voxels that were accumulated in parts (see [`PieceFolder::fold_into`]), and `sums` by
    /// their sums. Returns the number of voxels dropped, like [`accumulate`](Self::fold).
    pub fn set_folded(&mut self, folded: &Folded, min_points: u32, area: Area, sums: &mut Sums) -> u64 {
        self.clear();
        let kept = |(_, voxel, sums): &(usize, Voxel, Moments)| voxel.is_kept(sums.n, min_points);
        let mut dropped = 0;
        for voxels in folded.chunk_by(|a, b| a.0 == b.0) {
            dropped += self.push(voxels[0].0, voxels.iter().map(|voxel| (voxel.1, kept(voxel))), area);
        }
        self.end();
        sums.set_all(folded.iter().filter(|voxel| kept(voxel)).map(|voxel| voxel.2));
        dropped
    }

    /// Returns the number of the voxel of a patch pixel in this slice.
    #[inline]
    pub fn find(&self, patch_pixel: usize, slice: u32) -> Option<usize> {
        let range = self.range(patch_pixel);
        let voxels = &self.voxels[range.clone()];
        let at = if voxels.len() < 16 {
            voxels.iter().position(|voxel| voxel.slice == slice)
        } else {
            voxels.binary_search_by_key(&slice, |voxel| voxel.slice).ok()
        };
        at.map(|at| range.start + at)
    }

    /// Returns the numbers of the voxels of a patch pixel in these slices.
    #[inline]
    pub fn between(&self, patch_pixel: usize, slices: Range<u32>) -> Range<usize> {
        let range = self.range(patch_pixel);
        let voxels = &self.voxels[range.clone()];
        let first = if voxels.len() < 16 {
            voxels.iter().take_while(|voxel| voxel.slice < slices.start).count()
        } else {
            voxels.partition_point(|voxel| voxel.slice < slices.start)
        };
        let count = voxels[first..].iter().take_while(|voxel| voxel.slice < slices.end).count();
        range.start + first..range.start + first + count
    }

    fn clear(&mut self) {
        self.starts.clear();
        self.occupied.clear();
        self.voxels.clear();
    }

    /// Adds the kept voxels of the next pixel; returns how many voxels of the area are not kept.
    fn push(&mut self, pixel: usize, voxels: impl Iterator<Item = (Voxel, bool)>, area: Area) -> u64 {
        let first = self.voxels.len();
        let mut dropped = 0;
        self.voxels.extend(voxels.filter_map(|(voxel, kept)| {
            dropped += u64::from(!kept && area.holds(pixel));
            kept.then_some(voxel)
        }));
        if self.voxels.len() > first {
            self.starts.resize(pixel + 1, first as u32);
            self.occupied.push(pixel as u16);
        }
        dropped
    }

    fn end(&mut self) {
        self.starts.resize(PATCH_AREA + 1, self.voxels.len() as u32);
    }
}

/// Returns the 3 × 3 pixels around a patch pixel that is not in the halo, with their positions 0..3 in x and y.
pub fn neighbourhood(patch_pixel: usize) -> impl Iterator<Item = (usize, i64, i64)> {
    (0..9).map(move |place| neighbour(patch_pixel, place))
}

/// Returns pixel number `place` of the [`neighbourhood`].
#[inline]
pub fn neighbour(patch_pixel: usize, place: usize) -> (usize, i64, i64) {
    let (dx, dy) = (place % 3, place / 3);
    (patch_pixel + dy * PATCH_PIXELS + dx - PATCH_PIXELS - 1, dx as i64, dy as i64)
}

const _: () = assert!(HALO_PIXELS == 1, "neighbourhoods are 3 × 3 pixels");

#[cfg(test)]
mod tests;
