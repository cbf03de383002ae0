//! Accumulation in parts.

use super::sums::ByPixel;
use super::{Folder, Moments, Voxel};
use crate::voxel::bands::Bands;
use crate::voxel::record::{PATCH_AREA, Record};

/// Voxels with their patch pixel and sums, ordered by pixel and slice.
pub type Folded = Vec<(usize, Voxel, Moments)>;

/// Accumulates records into voxels in parts, if they are too many to be kept in memory.
#[derive(Debug, Default)]
pub struct PieceFolder {
    bands: Bands,
    records: ByPixel,
    folder: Folder,
}

impl PieceFolder {
    /// Creates an accumulator that sums heights above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Adds `records` to the voxels accumulated earlier; `scratch` is a buffer of the same size, reused between calls.
    pub fn fold_into(&mut self, folded: &mut Folded, scratch: &mut Folded, records: &[Record]) {
        std::mem::swap(folded, scratch);
        folded.reserve(scratch.len());
        let mut before = scratch.drain(..).peekable();
        self.records.set(records);
        let mut own_sums = Vec::new();
        for pixel in 0..PATCH_AREA {
            let own = self.records.of_mut(pixel);
            let (voxels, _) = self.folder.fold(own);
            own_sums.clear();
            own_sums.resize(voxels.len(), Moments::default());
            let mut number = 0;
            for &record in &*own {
                if voxels[number].0.slice != record.slice() {
                    number = voxels.partition_point(|(voxel, _)| voxel.slice < record.slice());
                }
                own_sums[number].add_record(record, self.bands);
            }
            for (&(mut voxel, _), mut sums) in voxels.iter().zip(own_sums.iter().copied()) {
                let key = (pixel, voxel.slice);
                while let Some(earlier) = before.next_if(|(pixel, earlier, _)| (*pixel, earlier.slice) < key) {
                    folded.push(earlier);
                }
                if let Some((_, same, more)) = before.next_if(|(pixel, earlier, _)| (*pixel, earlier.slice) == key) {
                    voxel.merge(&same);
                    sums.add_shifted(&more, 0, 0, 0);
                }
                folded.push((pixel, voxel, sums));
            }
        }
        folded.extend(before);
    }
}
