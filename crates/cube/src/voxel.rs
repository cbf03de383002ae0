//! Voxel octrees, version 1.1: a header in JSON, and 32-bit words in a second file.
//!
//! The words are the nodes breadth first, then two for each mixed block of 4 × 4 × 4 cubes, whose bits ascend with x, y
//! and z. A node is the index of a mixed block (upper byte 0), a solid leaf (0xFF000000), or a mask of eight children, x
//! lowest, and the index of the first child below. Read depth first, the nodes of each level ascend, so a block of bytes
//! for each level suffices. The format is y-up: its (x, y, z) is (x, -z, y) here.

use super::window::Window;
use super::{Body, Cube, CubeReader, binary_of, refuse};
use serde::Deserialize;
use slicewalk_base::bytes::{ByteSource, open_named};
use slicewalk_base::text::{behind_mark, grouped, one_line};
use slicewalk_base::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most bytes of the header.
const MOST_HEADER: u64 = 1 << 20;
/// Most blocks that nodes can name.
const MOST_BLOCKS: u64 = 1 << 24;
/// Edge of a block (cubes).
const BLOCK: i64 = 4;
/// Most levels of blocks.
const MOST_LEVELS: u32 = 24;
const SOLID: u32 = 0xFF00_0000;
/// A corner of the grid this close to a whole number of cubes from the origin lies there (cubes), besides the rounding of
/// coordinates to 32 bits, and at most so close.
const ALIGNED: f64 = 1e-6;
const MOST_ALIGNED: f64 = 1e-3;
/// Corners farther from the origin than this are not aligned (cubes).
const FARTHEST: f64 = (1u64 << 40) as f64;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Header {
    version: String,
    grid_bounds: Bounds,
    voxel_resolution: f64,
    leaf_size: i64,
    tree_depth: u32,
    num_interior_nodes: u64,
    num_mixed_leaves: u64,
    node_count: u64,
    leaf_data_count: u64,
}

#[derive(Deserialize)]
struct Bounds {
    min: [f64; 3],
    max: Option<[f64; 3]>,
}

/// Opens the octree with this header, and the file of its words beside it.
pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<CubeReader> {
    let Some(binary) = binary_of(path) else {
        return Err(refuse(path, "name", "expected a name that ends in .voxel.json, beside a .voxel.bin"));
    };
    let words = open_named(&binary)?.into();
    of_sources([source, words], path, binary)
}

/// Opens the octree with this header and these words, which `binary` names.
pub fn of_sources([source, words]: [Arc<dyn ByteSource>; 2], path: &Path, binary: PathBuf) -> Result<CubeReader> {
    let wrong = |reason: String| refuse(path, "header", format!("{reason}; fetch or write the file again"));
    if source.len() > MOST_HEADER {
        return Err(wrong(format!("expected at most {MOST_HEADER} bytes of JSON, found {}", source.len())));
    }
    let mut text = vec![0; source.len() as usize];
    source.read_at(0, &mut text)?;
    let head: Header =
        serde_json::from_slice(behind_mark(&text)).map_err(|error| wrong(one_line(&error.to_string()).into_owned()))?;
    if !matches!(head.version.split_once('.'), Some(("1", minor)) if minor.parse().is_ok_and(|minor: u32| minor >= 1)) {
        let reason = format!("expected version 1.1, found {}; write it again", one_line(&head.version));
        return Err(refuse(path, "header", reason));
    }
    let (size, min) = (head.voxel_resolution, head.grid_bounds.min);
    if !(size > 0.0 && size.is_finite()) {
        return Err(wrong("voxelResolution is no length above 0".into()));
    }
    if !min.iter().all(|v| v.is_finite()) {
        return Err(wrong("gridBounds is not finite".into()));
    }
    if head.grid_bounds.max.is_some_and(|max| (0..3).any(|axis| max[axis] < min[axis])) {
        return Err(wrong("gridBounds has a max below its min".into()));
    }
    if head.leaf_size != BLOCK {
        return Err(wrong(format!("expected a leafSize of {BLOCK}, found {}", head.leaf_size)));
    }
    if head.tree_depth > MOST_LEVELS {
        return Err(wrong(format!("expected a treeDepth of at most {MOST_LEVELS}, found {}", head.tree_depth)));
    }
    if head.num_mixed_leaves.checked_mul(2) != Some(head.leaf_data_count) {
        return Err(wrong(format!(
            "expected leafDataCount to be twice numMixedLeaves, found {} and {}",
            head.leaf_data_count, head.num_mixed_leaves
        )));
    }
    let expected = head.node_count.checked_add(head.leaf_data_count).and_then(|words| words.checked_mul(4));
    if expected != Some(words.len()) {
        let reason = format!(
            "expected {} nodes and {} words of leaves, 4 bytes each, found {} bytes; fetch or write both files again",
            grouped(head.node_count),
            grouped(head.leaf_data_count),
            grouped(words.len())
        );
        return Err(refuse(&binary, "length", reason));
    }
    // With z up; the corner with the least y is the one with the greatest z.
    let cubes = min.map(|v| v / size);
    let is_aligned = |v: f64| {
        let slack = (ALIGNED + v.abs() * f64::from(f32::EPSILON)).min(MOST_ALIGNED);
        v.abs() < FARTHEST && (v - v.round()).abs() <= slack
    };
    let (base, origin) = match cubes.iter().all(|v| is_aligned(*v)) {
        true => (cubes.map(|v| v.round() as i64), [0.0; 3]),
        false => ([0; 3], [min[0], 0.0 - min[2], min[1]]),
    };
    let levels = (0..=head.tree_depth).map(|_| Level { window: Window::new(words.clone()), free: 0 }).collect();
    let tree = Tree {
        binary,
        is_read: vec![0; head.num_mixed_leaves.min(MOST_BLOCKS).div_ceil(64) as usize],
        leaves: Window::new(words),
        levels,
        base,
        found: Found::default(),
        stack: Vec::new(),
        block: None,
        state: State::Root,
        head,
    };
    Ok(CubeReader { size, origin, body: Box::new(tree) })
}

struct Level {
    window: Window,
    /// First node that no parent has named yet.
    free: u64,
}

/// Children that are still to be visited.
struct Open {
    mask: u32,
    next: u64,
    corner: [i64; 3],
    edge: i64,
}

#[derive(Default)]
struct Found {
    nodes: u64,
    inner: u64,
    mixed: u64,
}

enum State {
    Root,
    Inside,
    Ended,
}

struct Tree {
    binary: PathBuf,
    head: Header,
    leaves: Window,
    /// A bit for each mixed block that a node has named.
    is_read: Vec<u64>,
    levels: Vec<Level>,
    /// Corner of the grid (cubes, axes of the file).
    base: [i64; 3],
    found: Found,
    /// One node for each level.
    stack: Vec<Open>,
    /// Cubes of the current block that were not given yet.
    block: Option<([i64; 3], u64)>,
    state: State,
}

impl Tree {
    fn damaged(&self, node: u64, what: &str) -> Error {
        refuse(&self.binary, format!("node {node}"), format!("{what}: the file is damaged; fetch or write it again"))
    }

    /// Returns the cube at this corner of the grid, with z up.
    fn cube(&self, corner: [i64; 3], edge: i64) -> Cube {
        let [x, y, z] = [0, 1, 2].map(|axis| corner[axis] + self.base[axis]);
        Cube { corner: [x, -z - edge, y], edge }
    }

    /// Visits a node; returns its cube if it is solid.
    fn enter(&mut self, node: u64, corner: [i64; 3], edge: i64) -> Result<Option<Cube>> {
        let level = self.stack.len();
        let word = match self.levels.get_mut(level) {
            Some(level) if node < self.head.node_count => level.window.bytes(4 * node)?.map(u32::from_le_bytes),
            _ => None,
        };
        let Some(word) = word else { return Err(self.damaged(node, "its parent names a node beyond the last")) };
        self.found.nodes += 1;
        if word == SOLID {
            return Ok(Some(self.cube(corner, edge)));
        }
        let (mask, index) = (word >> 24, u64::from(word & 0xFF_FFFF));
        if mask == 0 {
            if edge != BLOCK {
                return Err(self.damaged(node, "a mixed block lies above the finest level"));
            }
            self.found.mixed += 1;
            let bits = match index < self.head.num_mixed_leaves {
                true => self.leaves.bytes(4 * self.head.node_count + 8 * index)?,
                false => None,
            };
            let Some(bits) = bits else { return Err(self.damaged(node, "it names a block beyond the last")) };
            let (word, bit) = (&mut self.is_read[(index / 64) as usize], 1 << (index % 64));
            if std::mem::replace(word, *word | bit) & bit != 0 {
                return Err(self.damaged(node, "it names the block of another node"));
            }
            self.block = Some((corner, u64::from_le_bytes(bits)));
            return Ok(None);
        }
        if edge == BLOCK {
            return Err(self.damaged(node, "an inner node lies on the level of blocks"));
        }
        self.found.inner += 1;
        // Each node has one parent, so no tree takes longer to read than its file is long.
        let below = &mut self.levels[level + 1];
        if index < below.free.max(node + 1) {
            return Err(self.damaged(node, "its children belong to an earlier node"));
        }
        below.free = index + u64::from(mask.count_ones());
        self.stack.push(Open { mask, next: index, corner, edge });
        Ok(None)
    }

    fn finish(&self) -> Result<()> {
        let Found { nodes, inner, mixed } = self.found;
        let Header { node_count, num_interior_nodes, num_mixed_leaves, .. } = self.head;
        let counts = [
            (nodes, node_count, "nodes"),
            (inner, num_interior_nodes, "inner nodes"),
            (mixed, num_mixed_leaves, "mixed blocks"),
        ];
        for (found, stated, what) in counts {
            if found != stated {
                let reason = format!(
                    "the header states {} {what}, but the tree has {}; fetch or write both files again",
                    grouped(stated),
                    grouped(found)
                );
                return Err(refuse(&self.binary, "nodes", reason));
            }
        }
        Ok(())
    }
}

impl Body for Tree {
    fn next(&mut self) -> Result<Option<Cube>> {
        loop {
            if let Some((corner, bits)) = self.block {
                if bits != 0 {
                    self.block = Some((corner, bits & (bits - 1)));
                    let bit = i64::from(bits.trailing_zeros());
                    let within = [bit % BLOCK, bit / BLOCK % BLOCK, bit / (BLOCK * BLOCK)];
                    return Ok(Some(self.cube([0, 1, 2].map(|axis| corner[axis] + within[axis]), 1)));
                }
                self.block = None;
            }
            let cube = match (&self.state, self.stack.last_mut()) {
                (State::Root, _) => {
                    self.state = State::Inside;
                    match self.head.node_count {
                        0 => None,
                        _ => self.enter(0, [0; 3], BLOCK << self.head.tree_depth)?,
                    }
                }
                (_, Some(open)) if open.mask == 0 => {
                    self.stack.pop();
                    None
                }
                (_, Some(open)) => {
                    let (child, node, edge) = (open.mask.trailing_zeros(), open.next, open.edge / 2);
                    (open.mask, open.next) = (open.mask & (open.mask - 1), node + 1);
                    let corner = [0, 1, 2].map(|axis| open.corner[axis] + edge * i64::from(child >> axis & 1));
                    self.enter(node, corner, edge)?
                }
                (State::Inside, None) => {
                    self.finish()?;
                    self.state = State::Ended;
                    return Ok(None);
                }
                (State::Ended, None) => return Ok(None),
            };
            if cube.is_some() {
                return Ok(cube);
            }
        }
    }
}
