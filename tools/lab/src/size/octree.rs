//! Size of the points of a scan as OctoMap's binary tree (`.bt`) of occupied cubes.
//!
//! The size follows from the format (Hornung et al., Autonomous Robots 2013, section 3.4): two bytes for each inner node,
//! two bits a child; eight equal occupied children are pruned into one leaf. Free space, which a map built from rays
//! would hold too, is left out: the octree is as small as it can be. The header is taken as 100 bytes.

use crate::stability::Result;
use slicewalk::NoMonitor;
use slicewalk_input::{InputOptions, InputSet, PointDecoder, Units};
use std::path::{Path, PathBuf};

const HEADER: u64 = 100;
/// Levels of OctoMap's trees.
const LEVELS: u32 = 16;

/// Bytes of the tree with leaves of `cube_m`.
pub fn bytes(file: &Path, units: Units, cube_m: f64) -> Result<u64> {
    let set = InputSet::open(&[PathBuf::from(file)], InputOptions { units, ..Default::default() }, &NoMonitor)?;
    let mut cells = Vec::new();
    let mut decoder = PointDecoder::new();
    for chunk in set.chunks() {
        decoder.decode(&set, &chunk, &mut |batch| {
            for ((x, y), z) in batch.x.iter().zip(&batch.y).zip(&batch.z) {
                cells.push([x, y, z].map(|value| (value / cube_m).floor() as i64));
            }
            Ok(())
        })?;
    }
    let low = (0..3).map(|axis| cells.iter().map(|cell| cell[axis]).min().unwrap_or(0)).collect::<Vec<_>>();
    // A tree is centred in its key space; where the centre lies moves the size by little.
    let codes = cells.iter().map(|cell| morton([0, 1, 2].map(|axis| (cell[axis] - low[axis]) as u64)));
    let mut codes: Vec<u64> = codes.collect();
    codes.sort_unstable();
    codes.dedup();
    Ok(HEADER + 2 * inner_nodes(codes))
}

fn morton(cell: [u64; 3]) -> u64 {
    (0..LEVELS + 5).fold(0, |code, bit| {
        let place = |axis: usize| (cell[axis] >> bit & 1) << (3 * bit + axis as u32);
        code | place(0) | place(1) | place(2)
    })
}

/// Inner nodes above the sorted `codes` of the leaves, up to the root 16 levels above them.
fn inner_nodes(codes: Vec<u64>) -> u64 {
    // Nodes of a level, and whether each is a pruned leaf.
    let mut level: Vec<(u64, bool)> = codes.into_iter().map(|code| (code, true)).collect();
    let mut inner = 0;
    for _ in 0..LEVELS {
        let mut above: Vec<(u64, bool)> = Vec::new();
        for children in level.chunk_by(|a, b| a.0 >> 3 == b.0 >> 3) {
            let pruned = children.len() == 8 && children.iter().all(|child| child.1);
            inner += u64::from(!pruned);
            above.push((children[0].0 >> 3, pruned));
        }
        level = above;
    }
    inner
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_cubes_are_one_leaf_and_single_cells_a_chain() {
        assert_eq!(inner_nodes(vec![5]), 16);
        assert_eq!(inner_nodes((0..8).collect()), 15);
        assert_eq!(inner_nodes((0..64).collect()), 14);
        assert_eq!(inner_nodes(vec![0, 8]), 17);
    }
}
