//! Occupied space as a sparse voxel octree, version 1.1 (`NAME.voxel.json` with `NAME.voxel.bin`), for SuperSplat,
//! PlayCanvas and Babylon.
//!
//! Cubes with the edge of a pixel are solid if a span reaches into them, so the tree contains every scanned point and
//! nothing higher or lower than a pixel beyond a span. The format is y-up: (x, y, z) of the archive is (x, z, -y).
//!
//! Format (page "Voxel format" of the user manual of splat-transform): the binary file holds 32-bit words, first the
//! nodes breadth first, then two words for each mixed block of 4 × 4 × 4 cubes, whose bits ascend with x, y, z. A node is
//! the index of a mixed block (upper byte 0), a solid leaf (0xFF000000), or the mask of its eight children, x lowest, in
//! the upper byte and the index of the first child below.

use super::cubes::each_span;
use crate::Failure;
use serde_json::json;
use slicewalk::archive::Archive;
use slicewalk_base::output::Output;
use slicewalk_base::text::{counted, number};
use std::collections::HashMap;
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

/// Edge of a block (cubes).
const BLOCK: i64 = 4;
/// Empty space around the solid (m): viewers treat everything outside of the grid as solid.
const MARGIN_M: f64 = 2.0;
/// Most nodes, and most mixed blocks: their indices have 24 bits.
const MOST: usize = 1 << 24;
/// Most blocks along an axis.
const MOST_BLOCKS: i64 = 1 << 20;
/// Most blocks in memory. Blocks that join to larger solid cubes take no nodes, so more than the format has may fit.
const MOST_HELD: usize = 1 << 25;
const SOLID: u32 = 0xFF00_0000;

/// A node of one level of the tree.
#[derive(Clone, Copy)]
struct Node {
    /// Place among all nodes of the level, as bits of x, y and z in turn.
    morton: u64,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Solid,
    /// Bits of the cubes of a block.
    Mixed(u64),
    /// Children: their mask, and the index of the first one in the level below.
    Inner(u8, usize),
}

/// Writes header and tree; returns a message about them. Memory: the tree, up to 70 bytes for each of at most 2²⁵
/// blocks.
pub fn write(archive: &Archive, path: &Path, [header, binary]: [Output; 2]) -> Result<String, Failure> {
    let size = archive.frame().pixel_m();
    let (mut blocks, mut cubes) = (HashMap::<[i64; 3], u64>::new(), 0u64);
    let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
    let too_large = |what: &str| {
        Failure::Text(format!("{}: {what} than the format can address; extract a region first", path.display()))
    };
    // Limits count before the cubes of a span: there may be any number of them.
    let mut beyond = None;
    each_span(archive, path, |[i, j], (first, end)| {
        let [x, z] = [i, -j - 1];
        for (axis, (from, to)) in [(x, x), (first, end - 1), (z, z)].into_iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(from), high[axis].max(to));
        }
        if (0..3).any(|axis| high[axis].saturating_sub(low[axis]) >= MOST_BLOCKS * BLOCK) {
            beyond = Some("longer along an axis");
        } else if blocks.len() > MOST_HELD {
            beyond = Some("more detailed");
        }
        if beyond.is_some() {
            return;
        }
        for y in first..end {
            let at = [x, y, z];
            let bit = at.iter().rev().fold(0, |bits, v| bits * BLOCK + v.rem_euclid(BLOCK));
            let block = blocks.entry(at.map(|v| v.div_euclid(BLOCK))).or_default();
            cubes += u64::from(*block >> bit & 1 == 0);
            *block |= 1 << bit;
        }
    })?;
    if let Some(what) = beyond {
        return Err(too_large(what));
    }
    let margin = (MARGIN_M / size / BLOCK as f64).ceil().clamp(1.0, MOST_BLOCKS as f64) as i64;
    let is_empty = blocks.is_empty();
    let ends = |axis: usize| match is_empty {
        true => (0, 0),
        false => (low[axis].div_euclid(BLOCK) - margin, high[axis].div_euclid(BLOCK) + margin + 1),
    };
    let ends = [ends(0), ends(1), ends(2)];
    let longest = ends.iter().map(|(low, high)| high - low).max().unwrap_or(0);
    if longest > MOST_BLOCKS {
        return Err(too_large("longer along an axis"));
    }
    let depth = (longest.max(2) as u64).next_power_of_two().trailing_zeros();
    let mut leaves: Vec<Node> = blocks
        .into_iter()
        .map(|(at, bits)| Node {
            morton: interleaved([0, 1, 2].map(|axis| (at[axis] - ends[axis].0) as u64)),
            kind: if bits == u64::MAX { Kind::Solid } else { Kind::Mixed(bits) },
        })
        .collect();
    leaves.sort_unstable_by_key(|node| node.morton);
    let tree = Tree::over(leaves, depth);
    let (nodes, mixed) = tree.words();
    if nodes.len() > MOST || mixed.len() > MOST {
        return Err(too_large("more detailed"));
    }
    let corner = |pick: fn(&(i64, i64)) -> i64| ends.iter().map(|ends| (pick(ends) * BLOCK) as f64 * size).collect();
    let (min, max): (Vec<f64>, Vec<f64>) = (corner(|ends| ends.0), corner(|ends| ends.1));
    let scene = |edges: [i64; 3]| edges.map(|edge| if is_empty { 0.0 } else { edge as f64 * size });
    let inner = nodes.iter().filter(|word| **word >> 24 != 0 && **word != SOLID).count();
    let about = json!({
        "version": "1.1",
        "asset": { "generator": format!("slicewalk {}", env!("CARGO_PKG_VERSION")) },
        "gridBounds": { "min": min, "max": max },
        "sceneBounds": { "min": scene(low), "max": scene(high.map(|last| last.saturating_add(1))) },
        "voxelResolution": size,
        "leafSize": BLOCK,
        "treeDepth": depth,
        "numInteriorNodes": inner,
        "numMixedLeaves": mixed.len(),
        "nodeCount": nodes.len(),
        "leafDataCount": 2 * mixed.len(),
    });
    let mut file = BufWriter::new(binary);
    for word in &nodes {
        file.write_all(&word.to_le_bytes())?;
    }
    for bits in &mixed {
        file.write_all(&bits.to_le_bytes())?;
    }
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let mut file = BufWriter::new(header);
    writeln!(file, "{about:#}")?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    Ok(format!("{} of {} m, {}", counted(cubes, "solid cube"), number(size), counted(nodes.len() as u64, "node")))
}

/// Returns the bits of three numbers in turn, x lowest.
fn interleaved(at: [u64; 3]) -> u64 {
    (0..21).map(|bit| (0..3).map(|axis| (at[axis] >> bit & 1) << (3 * bit + axis)).sum::<u64>()).sum()
}

/// Levels of nodes, from the leaves up to the root.
struct Tree(Vec<Vec<Node>>);

impl Tree {
    /// Builds the `depth` levels over sorted leaves.
    fn over(leaves: Vec<Node>, depth: u32) -> Self {
        let mut levels = vec![leaves];
        for level in 0..depth as usize {
            let below = &levels[level];
            let mut nodes = Vec::new();
            let mut first = 0;
            while let Some(node) = below.get(first) {
                let own = below[first..].iter().take_while(|other| other.morton >> 3 == node.morton >> 3);
                let (mut mask, mut count, mut is_solid) = (0u8, 0, true);
                for child in own {
                    mask |= 1 << (child.morton & 7);
                    count += 1;
                    is_solid &= child.kind == Kind::Solid;
                }
                let kind = if is_solid && count == 8 { Kind::Solid } else { Kind::Inner(mask, first) };
                nodes.push(Node { morton: node.morton >> 3, kind });
                first += count;
            }
            levels.push(nodes);
        }
        Self(levels)
    }

    /// Returns the words of all nodes, breadth first, and the bits of the mixed blocks.
    fn words(&self) -> (Vec<u32>, Vec<u64>) {
        let (mut words, mut mixed) = (Vec::new(), Vec::new());
        let mut wave: Vec<Node> = self.0.last().into_iter().flatten().copied().collect();
        for level in (0..self.0.len()).rev() {
            let start = words.len() + wave.len();
            let mut next = Vec::new();
            for node in &wave {
                words.push(match node.kind {
                    Kind::Solid => SOLID,
                    Kind::Mixed(bits) => {
                        mixed.push(bits);
                        (mixed.len() - 1) as u32
                    }
                    Kind::Inner(mask, first) => {
                        let word = u32::from(mask) << 24 | (start + next.len()) as u32 & (MOST - 1) as u32;
                        next.extend(&self.0[level - 1][first..first + mask.count_ones() as usize]);
                        word
                    }
                });
            }
            wave = next;
        }
        (words, mixed)
    }
}
