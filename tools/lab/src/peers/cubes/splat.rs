//! `splat-transform` of PlayCanvas: the size of its `.voxel.bin`. Its writer takes Gaussians and needs a GPU, and it has no
//! reader, so the bytes follow from its format, and nothing is asked.

use std::collections::HashMap;

/// Voxels along an edge of a leaf.
const LEAF: i32 = 4;

/// Length of the file (bytes): four for every node of an octree over blocks of 4 x 4 x 4 voxels from the least block on, in
/// which whole blocks and nodes of eight whole ones are one leaf, and eight more for every block that is not whole.
pub fn voxel_bytes(cubes: &[[i32; 3]]) -> u64 {
    let mut counts: HashMap<[i32; 3], u32> = HashMap::new();
    for cube in cubes {
        *counts.entry(cube.map(|n| n.div_euclid(LEAF))).or_default() += 1;
    }
    let low = [0, 1, 2].map(|axis| counts.keys().map(|block| block[axis]).min().unwrap_or_default());
    let whole = |count: u32| count == (LEAF * LEAF * LEAF) as u32;
    let mixed = counts.values().filter(|count| !whole(**count)).count() as u64;
    let moved = |block: [i32; 3]| [0, 1, 2].map(|axis| block[axis] - low[axis]);
    let mut level: HashMap<[i32; 3], bool> =
        counts.into_iter().map(|(block, count)| (moved(block), whole(count))).collect();
    let mut nodes = 0;
    loop {
        nodes += level.len() as u64;
        if level.keys().all(|at| at.iter().all(|n| *n == 0)) {
            break;
        }
        let mut above: HashMap<[i32; 3], u32> = HashMap::new();
        for (at, whole) in &level {
            *above.entry(at.map(|n| n / 2)).or_default() += u32::from(*whole);
        }
        // Eight whole ones need no nodes of their own.
        nodes -= 8 * above.values().filter(|count| **count == 8).count() as u64;
        level = above.into_iter().map(|(at, count)| (at, count == 8)).collect();
    }
    4 * nodes + 8 * mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(edge: i32) -> Vec<[i32; 3]> {
        (0..edge * edge * edge).map(|n| [n % edge, n / edge % edge, n / (edge * edge)]).collect()
    }

    #[test]
    fn whole_blocks_are_one_node_and_others_have_a_mask() {
        // A whole cube of 8 x 8 x 8 blocks is its root alone.
        assert_eq!(voxel_bytes(&filled(32)), 4);
        // One voxel less: the root, three levels of eight nodes, and the mask of the block that is not whole.
        assert_eq!(voxel_bytes(&filled(32)[1..]), 4 * (1 + 3 * 8) + 8);
        // Two blocks side by side, wherever they lie: a root and two masks.
        assert_eq!(voxel_bytes(&[[-4, 0, 0], [0, 0, 0]]), 4 * 3 + 2 * 8);
    }
}
