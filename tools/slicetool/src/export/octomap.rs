//! Occupied space as an octree of OctoMap (`.bt`): cubes with the edge of a pixel, anchored like pixels at the origin.
//!
//! A cube is occupied if a span reaches into it, so the tree contains every scanned point and nothing higher or lower
//! than a pixel beyond a span. Where an archive stores seen space, cubes that lie in it are free unless a span reaches
//! into them. All other cubes are unknown.
//!
//! A tree of OctoMap has 2¹⁶ cubes along each axis, around the origin. An archive that reaches beyond is moved by whole
//! tiles; a comment in the header and the program's message say how far.

use super::cubes::each_span;
use crate::Failure;
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PAGE_SLICES, TILE_PIXELS};
use slicewalk::seen::{CELL_PIXELS, SeenSpace};
use slicewalk_base::output::Output;
use slicewalk_base::text::{counted, grouped, number};
use slicewalk_cube::OctomapTree;
use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError};
use std::path::Path;

/// Most memory for seen space (bytes).
const MOST_SEEN_BYTES: u64 = 4 << 30;
/// Differences of heights that count as rounding (cubes).
const ROUNDING: f64 = 1e-6;

/// Writes the tree; returns a message about it. Memory: the tree, and the blocks of a tile column (64 KiB each).
pub fn bt(archive: &Archive, path: &Path, to: Output) -> Result<String, Failure> {
    let (mut tree, mut column) = (OctomapTree::new(), None);
    let mut free = Free::of(archive, path)?;
    each_span(archive, path, |tile, pixel, cubes| {
        if column != Some(tile)
            && let Some(last) = column.replace(tile)
        {
            free.add(&mut tree, last);
        }
        tree.occupy(pixel, cubes);
    })?;
    for column in column.into_iter().chain(free.rest()) {
        free.add(&mut tree, column);
    }
    let size = archive.frame().pixel_m();
    let tree = tree.finish(size).ok_or_else(|| {
        let reason = format!("larger than the {} cubes of an OctoMap tree along an axis", OctomapTree::MOST_CUBES);
        Failure::Text(format!("{}: {reason}; extract a region first", path.display()))
    })?;
    let mut file = BufWriter::new(to);
    tree.write(&mut file)?;
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let moved = match tree.moved {
        [0, 0, 0] => String::new(),
        by => format!(", moved by {} m", by.map(|cubes| number(cubes as f64 * size)).join(",")),
    };
    let seen = if tree.free > 0 { format!(", {} free", grouped(tree.free)) } else { String::new() };
    Ok(format!("{}{seen} of {} m{moved}", counted(tree.occupied, "occupied cube"), number(size)))
}

/// Seen cells one above the other: their first pixel in the tile column, and the cubes that lie in them along z.
type Run = ([i64; 2], (i64, i64));

/// Free cubes by tile column: those that lie in runs of seen cells.
struct Free {
    columns: BTreeMap<[i64; 2], Vec<Run>>,
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
        Ok(Self { columns })
    }

    /// Moves the free cubes of a tile column to the tree.
    fn add(&mut self, tree: &mut OctomapTree, column: [i64; 2]) {
        for (pixel, cubes) in self.columns.remove(&column).into_iter().flatten() {
            let first = [0, 1].map(|axis| column[axis] * TILE_PIXELS + pixel[axis]);
            for (x, y) in (0..CELL_PIXELS).flat_map(|y| (0..CELL_PIXELS).map(move |x| (x, y))) {
                tree.free([first[0] + x, first[1] + y], cubes);
            }
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
