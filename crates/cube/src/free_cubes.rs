//! Seen space as free cubes.

use crate::SpanCubes;
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

/// Cubes that lie in seen cells, by tile: the free cubes of an [`OctomapTree`](crate::OctomapTree).
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

    /// Removes the cubes of a tile, and returns them by columns.
    pub(crate) fn take(&mut self, tile: [i64; 2]) -> impl Iterator<Item = ([i64; 2], (i64, i64))> + use<> {
        self.tiles.remove(&tile).into_iter().flatten().flat_map(|Run { pixels: [first, end], cubes }| {
            let pixels = (first[1]..end[1]).flat_map(move |y| (first[0]..end[0]).map(move |x| [x, y]));
            pixels.map(move |pixel| (pixel, cubes))
        })
    }

    /// Returns the first tile that is left.
    pub(crate) fn first_tile(&self) -> Option<[i64; 2]> {
        self.tiles.keys().next().copied()
    }
}
