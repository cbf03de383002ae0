//! Occupied space as an octree of OctoMap (`.bt`): cubes with the edge of a pixel, anchored like pixels at the origin.
//!
//! A cube is occupied if a span reaches into it, so the tree contains every scanned point and nothing higher or lower
//! than a pixel beyond a span. Where an archive stores seen space, cubes that lie in it are free unless a span reaches
//! into them. All other cubes are unknown. Eight occupied or eight free cubes make one leaf of the next larger size. Format: `writeBinary` of OctoMap 1.9 (class `OccupancyOcTreeBase`): a text header, then for each inner node in
//! depth-first order two bits for each of its eight children, x fastest (0 unknown, 1 free, 2 occupied, 3 inner node).
//!
//! A tree of OctoMap has 2¹⁶ cubes along each axis, around the origin. An archive that reaches beyond is moved by whole
//! tiles; a comment in the header and the program's message say how far.

use super::cubes::each_span;
use crate::Failure;
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PAGE_SLICES};
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use slicewalk_base::output::Output;
use slicewalk_base::text::{counted, grouped, number};
use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

/// Edge of a block (cubes): a tile column is 64 pixels wide, and a row of cubes along z is one word.
const EDGE: i64 = 64;
/// Levels of the tree above blocks, and blocks along each axis.
const UPPER: u32 = 10;
const BLOCKS: i64 = 1 << UPPER;
/// Most memory for seen space (bytes).
const MOST_SEEN_BYTES: u64 = 4 << 30;
/// Differences of heights that count as rounding (cubes).
const ROUNDING: f64 = 1e-6;
/// Values of the two bits of a child.
const FREE: u16 = 1;
const OCCUPIED: u16 = 2;
const INNER: u16 = 3;

/// A part of the tree.
enum Node {
    Empty,
    /// A leaf: free or occupied.
    Full(u16),
    /// Its bytes, and the number of nodes below it.
    Inner(Vec<u8>, u64),
}

/// Bits along z for each pixel of a block: occupied cubes, and free ones.
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

/// Calls `give` with the parts of the cubes from `first` up to `end` along z: block, and bits in it.
fn in_blocks((first, end): (i64, i64), mut give: impl FnMut(i64, u64)) {
    let mut at = first;
    while at < end {
        let block = at.div_euclid(EDGE);
        let last = end.min((block + 1) * EDGE);
        give(block, (u64::MAX >> (EDGE - (last - at))) << at.rem_euclid(EDGE));
        at = last;
    }
}

/// Writes the tree; returns a message about it. Memory: the tree, and the blocks of a tile column (32 KiB each).
pub fn bt(archive: &Archive, path: &Path, to: Output) -> Result<String, Failure> {
    let mut nodes: Vec<([i64; 3], Node)> = Vec::new();
    let (mut blocks, mut column, mut occupied) = (BTreeMap::<i64, Block>::new(), None, 0u64);
    let mut free = Free::of(archive, path)?;
    each_span(archive, path, |tile, pixel, (first, end)| {
        if column != Some(tile) {
            free.add(&mut blocks, column);
            finish(&mut blocks, column, &mut nodes);
            column = Some(tile);
        }
        let [x, y] = pixel.map(|pixel| pixel.rem_euclid(EDGE));
        in_blocks((first, end), |block, bits| {
            let block = blocks.entry(block).or_insert_with(Block::new);
            let word = &mut block.occupied[(y * EDGE + x) as usize];
            occupied += u64::from((bits & !*word).count_ones());
            *word |= bits;
        });
    })?;
    free.add(&mut blocks, column);
    finish(&mut blocks, column, &mut nodes);
    for column in free.rest() {
        free.add(&mut blocks, Some(column));
        finish(&mut blocks, Some(column), &mut nodes);
    }
    let by = shift(&nodes).ok_or_else(|| {
        let reason = format!("larger than the {} cubes of an OctoMap tree along an axis", BLOCKS * EDGE);
        Failure::Text(format!("{}: {reason}; extract a region first", path.display()))
    })?;
    nodes.iter_mut().for_each(|(at, _)| *at = [0, 1, 2].map(|axis| at[axis] - by[axis] + BLOCKS / 2));
    nodes.sort_by_key(|(at, _)| interleaved(*at));
    let root = joined(&mut nodes, 0);
    let size = archive.frame().pixel_m();
    let moved = by.map(|blocks| number(0.0 - (blocks * EDGE) as f64 * size));
    let is_moved = by != [0; 3];
    let mut file = BufWriter::new(to);
    writeln!(file, "# Octomap OcTree binary file")?;
    if is_moved {
        writeln!(file, "# moved by {} {} {} m", moved[0], moved[1], moved[2])?;
    }
    // A tree that is one leaf has no place in the format, and no archive is that large; an empty one has no nodes.
    let (bytes, count) = match &root {
        Node::Inner(bytes, below) => (&bytes[..], below + 1),
        Node::Empty | Node::Full(_) => (&[][..], 0),
    };
    write!(file, "id OcTree\nsize {count}\nres {}\ndata\n", number(size))?;
    file.write_all(bytes)?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let moved = if is_moved { format!(", moved by {} m", moved.join(",")) } else { String::new() };
    let seen = if free.cubes > 0 { format!(", {} free", grouped(free.cubes)) } else { String::new() };
    Ok(format!("{}{seen} of {} m{moved}", counted(occupied, "occupied cube"), number(size)))
}

/// Seen cells one above the other: their first pixel in the tile column, and the cubes that lie in them along z.
type Run = ([i64; 2], (i64, i64));

/// Free cubes by tile column: those that lie in runs of seen cells.
struct Free {
    columns: BTreeMap<[i64; 2], Vec<Run>>,
    cubes: u64,
}

impl Free {
    fn of(archive: &Archive, path: &Path) -> Result<Self, Failure> {
        let mut columns = BTreeMap::<[i64; 2], Vec<_>>::new();
        let space = archive.seen_space(MOST_SEEN_BYTES).map_err(|error| crate::broken(path, &error))?;
        let frame = *archive.frame();
        for (key, page) in space.iter().flat_map(SeenSpace::pages) {
            let tile = [i64::from(key.tx), i64::from(key.ty)];
            let slices = page.slices();
            for (x, y) in (0..16).flat_map(|y| (0..16).map(move |x| (x, y))) {
                let is_seen = |k: usize| slices[k][y / 4] >> (16 * (y % 4) + x) & 1 == 1;
                let mut k = 0;
                while k < 64 {
                    let first = k;
                    while k < 64 && is_seen(k) {
                        k += 1;
                    }
                    if k > first {
                        let cubes =
                            inner_cubes(&frame, [first, k].map(|k| i64::from(key.layer) * PAGE_SLICES + k as i64));
                        columns.entry(tile).or_default().push(([x, y].map(|at| at as i64 * CELL_PIXELS), cubes));
                    }
                    k += 1;
                }
            }
        }
        Ok(Self { columns, cubes: 0 })
    }

    /// Moves the free cubes of a tile column to its blocks, unless they are occupied.
    fn add(&mut self, blocks: &mut BTreeMap<i64, Block>, column: Option<[i64; 2]>) {
        let runs = column.and_then(|column| self.columns.remove(&column));
        for (pixel, cubes) in runs.into_iter().flatten() {
            in_blocks(cubes, |block, bits| {
                let block = blocks.entry(block).or_insert_with(Block::new);
                for (x, y) in (0..CELL_PIXELS).flat_map(|y| (0..CELL_PIXELS).map(move |x| (x, y))) {
                    let at = ((pixel[1] + y) * EDGE + pixel[0] + x) as usize;
                    let clear = bits & !block.occupied[at];
                    block.free[at] |= clear;
                    self.cubes += u64::from(clear.count_ones());
                }
            });
        }
    }

    /// Tile columns that are left: those without spans.
    fn rest(&self) -> Vec<[i64; 2]> {
        self.columns.keys().copied().collect()
    }
}

/// Returns the first cube above the bottom of slice `from`, and the one after the last below that of slice `to`.
fn inner_cubes(frame: &Frame, [from, to]: [i64; 2]) -> (i64, i64) {
    let size = frame.pixel_m();
    // A cube that ends with the slice may seem to end above it, by rounding.
    let [first, end] = [from, to].map(|slice| frame.bottom_of_slice(slice) / size);
    (((first - ROUNDING).ceil()) as i64, ((end + ROUNDING).floor()) as i64)
}

/// Encodes the blocks of a tile column.
fn finish(blocks: &mut BTreeMap<i64, Block>, column: Option<[i64; 2]>, nodes: &mut Vec<([i64; 3], Node)>) {
    let Some([tx, ty]) = column else { return };
    for (z, block) in std::mem::take(blocks) {
        let (mut bytes, mut below) = (Vec::new(), 0);
        let node = match encode(&block, [0; 3], EDGE, &mut bytes, &mut below) {
            0 => Node::Empty,
            leaf @ (FREE | OCCUPIED) => Node::Full(leaf),
            _ => Node::Inner(bytes, below),
        };
        nodes.push(([tx, ty, z], node));
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
            *by = low.midpoint(high);
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
        [(_, node), ..] if depth == UPPER => return std::mem::replace(node, Node::Empty),
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
