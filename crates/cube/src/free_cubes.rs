//! Seen space as free cubes.

use crate::{OctomapTree, SpanCubes};
use slicewalk_base::frame::{Frame, TILE_PIXELS};
use std::collections::BTreeMap;

/// Seen cells above one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Run {
    /// First pixel along x and y, and the one after the last.
    pixels: [[i64; 2]; 2],
    /// First cube along z, and the one after the last.
    cubes: (i64, i64),
}

/// Cubes that lie in seen cells, by tile, for a tree to which the cubes of spans are added tile by tile.
#[derive(Debug, Default)]
pub struct FreeCubes {
    tiles: BTreeMap<[i64; 2], Vec<Run>>,
}

impl FreeCubes {
    /// Collects the cubes of `runs`: the first pixel of a cell, the first slice and the one after the last, none across the
    /// border of a tile. Cells are `edge` pixels long. Only pixels and slices from the first to the last of `within` count,
    /// along x, y and z.
    pub fn new(
        frame: &Frame,
        edge: i64,
        runs: impl IntoIterator<Item = ([i64; 2], [i64; 2])>,
        within: Option<[[i64; 3]; 2]>,
    ) -> Self {
        let (mut free, cubes) = (Self::default(), SpanCubes::of(frame));
        for (pixel, [mut first, mut end]) in runs {
            let mut pixels = [pixel, pixel.map(|at| at + edge)];
            if let Some([low, high]) = within {
                for axis in 0..2 {
                    pixels[0][axis] = pixels[0][axis].max(low[axis]);
                    pixels[1][axis] = pixels[1][axis].min(high[axis] + 1);
                }
                (first, end) = (first.max(low[2]), end.min(high[2] + 1));
            }
            if first < end && (0..2).all(|axis| pixels[0][axis] < pixels[1][axis]) {
                let tile = pixel.map(|at| at.div_euclid(TILE_PIXELS));
                free.tiles.entry(tile).or_default().push(Run { pixels, cubes: cubes.within_slices(first, end) });
            }
        }
        free
    }

    /// Moves the cubes of a tile to the tree.
    pub fn add(&mut self, tree: &mut OctomapTree, tile: [i64; 2]) {
        for Run { pixels: [first, end], cubes } in self.tiles.remove(&tile).into_iter().flatten() {
            for (x, y) in (first[1]..end[1]).flat_map(|y| (first[0]..end[0]).map(move |x| (x, y))) {
                tree.free([x, y], cubes);
            }
        }
    }

    /// Moves the cubes of all tiles that are left to the tree.
    pub fn add_rest(&mut self, tree: &mut OctomapTree) {
        while let Some(tile) = self.tiles.keys().next().copied() {
            self.add(tree, tile);
        }
    }
}
