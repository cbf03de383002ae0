//! Folding piece by piece.

use super::sums::ByPixel;
use super::{Folder, Moments, Voxel};
use crate::voxel::bands::Bands;
use crate::voxel::record::{PATCH_AREA, Record};

/// Voxels with their patch pixel and sums, in order of pixel and slice.
pub type Folded = Vec<(usize, Voxel, Moments)>;

/// Folds records into voxels piece by piece, where they are too many to be kept.
#[derive(Debug, Default)]
pub struct PieceFolder {
    bands: Bands,
    records: ByPixel,
    folder: Folder,
}

impl PieceFolder {
    /// A folder for sums of heights above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Folds `records` into voxels folded before; `scratch` is memory for as many, kept from piece to piece.
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
