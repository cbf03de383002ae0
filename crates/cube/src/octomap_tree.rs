//! Writer of OctoMap trees (`.bt`).
//!
//! Format: `writeBinary` of OctoMap 1.9 (class `OccupancyOcTreeBase`): a text header, then for each inner node in
//! depth-first order two bits for each of its eight children, x fastest (0 unknown, 1 free, 2 occupied, 3 inner node).
//! Eight occupied or eight free children are one leaf of the next larger size.

use super::free_cubes::FreeCubes;
use super::octomap::{FREE, INNER, LEVELS, OCCUPIED};
use super::recognise::BINARY;
use slicewalk_base::text::number;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::mem;

/// Edge of a block (cubes): a tile column is 64 pixels wide, and a row of cubes along z is one word.
const EDGE: i64 = 64;
/// Levels of the tree above blocks, and blocks along each axis.
const UPPER: u32 = LEVELS - EDGE.ilog2();
const BLOCKS: i64 = 1 << UPPER;

/// A part of the tree.
enum Node {
    Empty,
    /// A leaf: free or occupied.
    Full(u16),
    /// Its bytes, and the number of nodes below it.
    Inner(Vec<u8>, u64),
}

/// Bits along z for each column of a block: occupied cubes, and free ones.
struct Block {
    occupied: Box<[u64; (EDGE * EDGE) as usize]>,
    free: Box<[u64; (EDGE * EDGE) as usize]>,
}

impl Block {
    fn new() -> Self {
        let empty = || Box::new([0; (EDGE * EDGE) as usize]);
        Self { occupied: empty(), free: empty() }
    }
}

/// A tree in the making. Memory: the tree, and the blocks of 64 × 64 columns of cubes (64 KiB for each 64 along z).
///
/// The columns of a tile, a square of 64 × 64 that is anchored at the origin, must be added one after another.
#[derive(Default)]
pub struct OctomapTree {
    /// Blocks of the tile by their place along z.
    blocks: BTreeMap<i64, Block>,
    tile: Option<[i64; 2]>,
    /// Lowest cube along z that was added, and the one after the highest.
    ends: Option<(i64, i64)>,
    seen: FreeCubes,
    nodes: Vec<([i64; 3], Node)>,
    counts: [u64; 2],
}

/// A tree ready to be written.
pub struct Octomap {
    head: String,
    nodes: Vec<u8>,
    /// Occupied cubes.
    pub occupied: u64,
    /// Free cubes.
    pub free: u64,
    /// Cubes by which the tree is moved: a tree has 65,536 cubes along each axis around the origin. Zeros if it fits.
    pub moved: [i64; 3],
}

impl OctomapTree {
    /// Most cubes along an axis.
    pub const MOST_CUBES: i64 = BLOCKS * EDGE;

    /// Creates an empty tree.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes these cubes free, except those that are occupied.
    #[must_use]
    pub fn with_free(self, cubes: FreeCubes) -> Self {
        Self { seen: cubes, ..self }
    }

    /// Makes the cubes from `first` up to `end` along z in the column at `x`, `y` occupied.
    pub fn occupy(&mut self, [x, y]: [i64; 2], cubes: (i64, i64)) {
        self.add([x, y], cubes, |block, at, bits| block.occupied[at] |= bits);
    }

    /// Makes cubes free, like [`occupy`](Self::occupy), except those that are occupied.
    pub(crate) fn free(&mut self, [x, y]: [i64; 2], cubes: (i64, i64)) {
        self.add([x, y], cubes, |block, at, bits| block.free[at] |= bits);
    }

    fn add(&mut self, [x, y]: [i64; 2], (first, end): (i64, i64), set: impl Fn(&mut Block, usize, u64)) {
        if first >= end {
            return;
        }
        self.ends = Some(self.ends.map_or((first, end), |(low, high)| (low.min(first), high.max(end))));
        // No tree holds them, and their blocks could take any amount of memory.
        if self.is_too_high() {
            return;
        }
        let tile = [x.div_euclid(EDGE), y.div_euclid(EDGE)];
        if self.tile != Some(tile) {
            self.finish_tile();
            self.tile = Some(tile);
        }
        let column = (y.rem_euclid(EDGE) * EDGE + x.rem_euclid(EDGE)) as usize;
        let mut at = first;
        while at < end {
            let number = at.div_euclid(EDGE);
            let last = end.min((number + 1) * EDGE);
            let bits = (u64::MAX >> (EDGE - (last - at))) << at.rem_euclid(EDGE);
            set(self.blocks.entry(number).or_insert_with(Block::new), column, bits);
            at = last;
        }
    }

    fn is_too_high(&self) -> bool {
        self.ends.is_some_and(|(low, high)| high.saturating_sub(low) > Self::MOST_CUBES)
    }

    /// Encodes the blocks of the tile.
    fn finish_tile(&mut self) {
        let Some([x, y]) = self.tile else { return };
        for (pixel, cubes) in self.seen.take([x, y]) {
            self.free(pixel, cubes);
        }
        for (z, mut block) in mem::take(&mut self.blocks) {
            for (free, occupied) in block.free.iter_mut().zip(block.occupied.iter()) {
                *free &= !occupied;
            }
            for (count, words) in self.counts.iter_mut().zip([&block.occupied, &block.free]) {
                *count += words.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
            }
            let (mut bytes, mut below) = (Vec::new(), 0);
            let node = match encode(&block, [0; 3], EDGE, &mut bytes, &mut below) {
                0 => Node::Empty,
                leaf @ (FREE | OCCUPIED) => Node::Full(leaf),
                _ => Node::Inner(bytes, below),
            };
            self.nodes.push(([x, y, z], node));
        }
    }

    /// Encodes the tile of the last column, then at each call one tile of free cubes alone; returns false after the last.
    /// [`finish`](Self::finish) does so, too: callers that may have to stop do it before, once all columns are added.
    pub fn encode_next(&mut self) -> bool {
        self.finish_tile();
        self.tile = self.seen.first_tile();
        self.tile.is_some()
    }

    /// Ends the tree, whose cubes have the edge `size` (m). `None` if it is larger than
    /// [`MOST_CUBES`](Self::MOST_CUBES) along an axis.
    ///
    /// # Panics
    ///
    /// The columns of a tile were not added one after another.
    pub fn finish(mut self, size: f64) -> Option<Octomap> {
        while self.encode_next() {}
        if self.is_too_high() {
            return None;
        }
        let Self { mut nodes, counts: [occupied, free], .. } = self;
        let by = shift(&nodes)?;
        nodes.iter_mut().for_each(|(at, _)| *at = [0, 1, 2].map(|axis| at[axis] - by[axis] + BLOCKS / 2));
        nodes.sort_by_key(|(at, _)| interleaved(*at));
        assert!(nodes.windows(2).all(|pair| pair[0].0 != pair[1].0), "columns of a tile were added in two turns");
        // A tree that is one leaf has no place in the format, and nothing is that large; an empty one has no nodes.
        let (bytes, count) = match joined(&mut nodes, 0) {
            Node::Inner(bytes, below) => (bytes, below + 1),
            Node::Empty | Node::Full(_) => (Vec::new(), 0),
        };
        let moved = by.map(|blocks| -blocks * EDGE);
        let mut head = format!("{}\n", String::from_utf8_lossy(BINARY));
        if moved != [0; 3] {
            let [x, y, z] = moved.map(|cubes| number(cubes as f64 * size));
            head.push_str(&format!("# moved by {x} {y} {z} m\n"));
        }
        head.push_str(&format!("id OcTree\nsize {count}\nres {}\ndata\n", number(size)));
        Some(Octomap { head, nodes: bytes, occupied, free, moved })
    }
}

impl Octomap {
    /// Writes the file.
    pub fn write(&self, mut to: impl Write) -> io::Result<()> {
        to.write_all(self.head.as_bytes())?;
        to.write_all(&self.nodes)
    }
}

/// Appends the node of the cube at `at` with this edge, unless it is empty or full; returns the bits that its parent
/// writes for it, and adds the nodes below it to `below`.
fn encode(block: &Block, at: [i64; 3], edge: i64, out: &mut Vec<u8>, below: &mut u64) -> u16 {
    let mask = u64::MAX >> (EDGE - edge) << at[2];
    let (mut any, mut occupied, mut free) = (0, mask, mask);
    for y in at[1]..at[1] + edge {
        let first = (y * EDGE + at[0]) as usize;
        let own = first..first + edge as usize;
        for (solid, clear) in block.occupied[own.clone()].iter().zip(&block.free[own]) {
            (any, occupied, free) = (any | (solid | clear) & mask, occupied & solid, free & clear);
        }
    }
    if any == 0 {
        return 0;
    }
    for (all, leaf) in [(occupied, OCCUPIED), (free, FREE)] {
        if all == mask {
            return leaf;
        }
    }
    let (start, half) = (out.len(), edge / 2);
    out.extend([0, 0]);
    let mut children = 0u16;
    for child in 0..8 {
        let at = [0, 1, 2].map(|axis| at[axis] + half * (child >> axis & 1));
        let bits = encode(block, at, half, out, below);
        children |= bits << (2 * child);
        *below += u64::from(bits != 0);
    }
    out[start..start + 2].copy_from_slice(&children.to_le_bytes());
    INNER
}

/// Returns the number of blocks by which to move the tree along each axis, 0 if it fits; `None` if it is too large.
fn shift(nodes: &[([i64; 3], Node)]) -> Option<[i64; 3]> {
    let mut by = [0; 3];
    for (axis, by) in by.iter_mut().enumerate() {
        let along = || nodes.iter().map(|(at, _)| at[axis]);
        let (Some(low), Some(high)) = (along().min(), along().max()) else { continue };
        if high - low >= BLOCKS {
            return None;
        }
        if low < -BLOCKS / 2 || high >= BLOCKS / 2 {
            // Where all of it is needed, half of it is below the origin.
            *by = low.midpoint(high).max(high + 1 - BLOCKS / 2);
        }
    }
    Some(by)
}

/// Returns a number that sorts blocks as the tree does.
fn interleaved(at: [i64; 3]) -> u64 {
    let bit = |level: u32, axis: usize| (at[axis] as u64 >> level & 1) << (3 * level + axis as u32);
    (0..UPPER).flat_map(|level| (0..3).map(move |axis| (level, axis))).map(|(level, axis)| bit(level, axis)).sum()
}

/// Joins sorted nodes of blocks to the node at this depth.
fn joined(nodes: &mut [([i64; 3], Node)], depth: u32) -> Node {
    match nodes {
        [] => return Node::Empty,
        [(_, node), ..] if depth == UPPER => return mem::replace(node, Node::Empty),
        _ => {}
    }
    let level = UPPER - 1 - depth;
    let child_of = |at: &[i64; 3]| (0..3).map(|axis| (at[axis] >> level & 1) << axis).sum::<i64>();
    let (mut bytes, mut below, mut children, mut rest) = (vec![0, 0], 0, 0u16, nodes);
    for child in 0..8 {
        let count = rest.iter().take_while(|(at, _)| child_of(at) == child).count();
        let (own, others) = rest.split_at_mut(count);
        rest = others;
        let bits = match joined(own, depth + 1) {
            Node::Empty => 0,
            Node::Full(leaf) => leaf,
            Node::Inner(own, count) => {
                bytes.extend(own);
                below += count;
                INNER
            }
        };
        below += u64::from(bits != 0);
        children |= bits << (2 * child);
    }
    match children {
        0 => Node::Empty,
        children if children == OCCUPIED * 0x5555 => Node::Full(OCCUPIED),
        children if children == FREE * 0x5555 => Node::Full(FREE),
        _ => {
            bytes[..2].copy_from_slice(&children.to_le_bytes());
            Node::Inner(bytes, below)
        }
    }
}
