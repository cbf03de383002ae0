//! Accumulation outside this crate, as by a graphics card.

use super::{Folded, Moments, Voxel};
use crate::voxel::record::{Record, RecordPieces};
use std::fmt::Debug;

/// Accumulator of the points of tile columns to voxels, used in place of this crate's where it can be.
pub trait Accumulate: Debug + Send + Sync {
    /// Accumulates `records` of several tile columns; `ends` holds where the records of each column end, and `band` the
    /// slices of a band. Returns the voxels of each column, ordered by pixel and slice, or `None` if it cannot, as for
    /// records of other things than points: then this crate does it.
    fn accumulate(&self, records: &[u64], ends: &[usize], band: u32) -> Option<Vec<Vec<PointVoxel>>>;
}

/// Sums over the points of a voxel. A record holds, from the highest bits down, 13 bits of the pixel in the patch, 24 of
/// the slice, 13 of the height in the slice (below 8160 for a point), and 7 each of the position along x and y.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PointVoxel {
    /// Pixel and slice, as the high bits of a record hold them (37 bits).
    pub key: u64,
    /// Least and greatest height.
    pub heights: [u32; 2],
    /// Heights divided by 510, as bits.
    pub bins: u16,
    /// Number of points, and sums of position `u`, `v` and height in the band `w`: n, u, v, w, uu, uv, vv, uw, vw, ww.
    pub sums: [i64; 10],
}

/// Records of all columns of a job, to be accumulated elsewhere.
#[derive(Debug, Default)]
pub struct Job {
    records: Vec<u64>,
    ends: Vec<usize>,
}

impl Job {
    /// Appends a column.
    pub fn push(&mut self, column: &impl RecordPieces) {
        column.each(|piece| self.records.extend(piece.iter().map(|record| record.0)));
        self.ends.push(self.records.len());
    }

    /// Returns the voxels of each column; empty if `accumulator` cannot.
    pub fn fold(&self, accumulator: &dyn Accumulate, band: u32) -> Vec<Folded> {
        let columns = accumulator.accumulate(&self.records, &self.ends, band).unwrap_or_default();
        columns.into_iter().map(|voxels| voxels.into_iter().map(folded).collect()).collect()
    }
}

fn folded(point: PointVoxel) -> (usize, Voxel, Moments) {
    let at = Record(point.key << (u64::BITS - KEY_BITS));
    let voxel = Voxel::of_points(at.slice(), point.heights, point.bins);
    (at.pixel(), voxel, Moments::from_numbers(point.sums))
}

/// Bits of a record that hold its pixel and its slice.
const KEY_BITS: u32 = 37;
