//! Conversion of solid cubes to records: the voxels that they fill.
//!
//! A cube holds its lower faces and not its upper ones, as a pixel does, so a cube of the size of a pixel on the same grid
//! fills that pixel and no other. Faces are computed in doubles: one that comes within `2⁻⁴⁶` of its coordinates to an
//! edge of the grid lies there, which exceeds the rounding errors of a product and a conversion to the grid.

use super::record::{BATCH, SurfaceVoxel, surface_voxels};
use super::runs::{RunBuilder, RunStore};
use crate::frame::{Frame, MAX_INDEX, SLICE_QUANTA, floor_index};
use crate::{Error, Parameter, Result};
use slicewalk_cube::Cube;

/// Approximate limit of the voxels that one cube may fill. More indicate a damaged tree, or a wrong unit or pixel size.
const MOST_VOXELS: f64 = (1u64 << 30) as f64;
const SLACK: f64 = 1.0 / (1u64 << 46) as f64;

/// Place of a file's cubes: their size, and the corner of cube (0, 0, 0) (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubeGrid {
    pub size_m: f64,
    pub origin_m: [f64; 3],
}

impl CubeGrid {
    /// Returns the lowest and the highest corner of a cube (m).
    pub fn bounds(&self, cube: &Cube) -> ([f64; 3], [f64; 3]) {
        let corner = |edge: i64| [0, 1, 2].map(|axis| self.face(axis, cube.corner[axis] + edge));
        (corner(0), corner(cube.edge))
    }

    fn face(&self, axis: usize, number: i64) -> f64 {
        self.origin_m[axis] + number as f64 * self.size_m
    }

    /// Returns face `number` of an axis on a grid with `scale` cells a metre: a whole number if it lies on an edge.
    fn on_grid(&self, axis: usize, number: i64, scale: f64) -> f64 {
        let at = self.face(axis, number) * scale;
        let slack = (self.origin_m[axis].abs() + (number as f64 * self.size_m).abs()) * scale * SLACK;
        let edge = at.round();
        if (at - edge).abs() <= slack { edge } else { at }
    }
}

/// Pixels and heights that a cube fills.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlacedCube {
    /// First and last pixel along x and y.
    pixels: [(i64, i64); 2],
    /// Bottom and top (quanta).
    heights: (i64, i64),
}

impl PlacedCube {
    /// Puts a cube on the grid of an archive; `None` if the grid does not reach it.
    pub fn new(frame: &Frame, grid: &CubeGrid, cube: &Cube) -> Option<Self> {
        let ends = |axis: usize, scale: f64| {
            let [low, high] = [0, cube.edge].map(|edge| grid.on_grid(axis, cube.corner[axis] + edge, scale));
            (floor_index(low), -floor_index(-high))
        };
        let along = |axis: usize| {
            let (first, end) = ends(axis, frame.pixels(1.0));
            (first, (end - 1).max(first))
        };
        let (pixels, heights) = ([along(0), along(1)], ends(2, frame.quanta(1.0)));
        let is_near = |index: i64| index.abs() <= MAX_INDEX;
        let slices = [heights.0.div_euclid(SLICE_QUANTA), heights.1.div_euclid(SLICE_QUANTA)];
        let reached = pixels.iter().all(|(first, last)| is_near(*first) && is_near(*last));
        (reached && slices.into_iter().all(is_near)).then_some(Self { pixels, heights })
    }

    /// Number of voxels that it fills.
    pub fn voxels(&self) -> f64 {
        let [x, y] = self.pixels.map(|(first, last)| (last - first + 1) as f64);
        let (bottom, top) = self.heights;
        x * y * ((top - 1).div_euclid(SLICE_QUANTA) - bottom.div_euclid(SLICE_QUANTA) + 1).max(1) as f64
    }
}

/// Converts the cubes of one worker to records; reuses its buffer.
#[derive(Debug, Default)]
pub struct CubeBuilder {
    voxels: Vec<SurfaceVoxel>,
}

impl CubeBuilder {
    /// Adds a cube. Stops with an error once `cancelled` is true.
    pub fn push(
        &mut self,
        cube: &PlacedCube,
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        let filled = cube.voxels();
        if filled > MOST_VOXELS {
            let error = Error::limit("voxels that one cube fills", format!("{filled:.0}"), MOST_VOXELS);
            return Err(error.with_suggestion(Parameter::PixelSize));
        }
        let [(left, right), (near, far)] = cube.pixels;
        for (j, i) in (near..=far).flat_map(|j| (left..=right).map(move |i| (j, i))) {
            // Level on top, whatever stands beside it.
            for voxel in surface_voxels((i, j), cube.heights, false) {
                self.voxels.push(voxel);
                if self.voxels.len() == BATCH {
                    if cancelled() {
                        return Err(Error::Interrupted);
                    }
                    self.flush(runs, store)?;
                }
            }
        }
        Ok(())
    }

    /// Passes the remaining records on; must be called at the end.
    pub fn flush(&mut self, runs: &mut RunBuilder, store: &RunStore) -> Result<()> {
        runs.push_surfaces(&self.voxels, store)?;
        self.voxels.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_cube_of_the_size_of_a_pixel_is_one_voxel() {
        for size in [0.05, 0.1, 0.03, 0.123, 1.0 / 3.0, 0.2, 7.0] {
            let frame = Frame::new(size, size).unwrap();
            let grid = CubeGrid { size_m: size, origin_m: [0.0; 3] };
            for k in (-32768..32768).step_by(7) {
                let placed = PlacedCube::new(&frame, &grid, &Cube { corner: [k, -k, k], edge: 1 }).unwrap();
                let heights = (k * SLICE_QUANTA, (k + 1) * SLICE_QUANTA);
                assert_eq!(placed, PlacedCube { pixels: [(k, k), (-k, -k)], heights }, "{size} {k}");
            }
        }
    }

    proptest! {
        #[test]
        fn every_place_of_a_cube_is_filled_and_nothing_farther_than_a_pixel(
            corner in prop::array::uniform3(-40_000i64..40_000),
            level in 0u32..6,
            size in 0.01f64..0.5,
            pixel in 0.01f64..0.5,
            slice in 0.01f64..0.5,
            origin in prop::array::uniform3(-1e3f64..1e3),
            share in prop::array::uniform3(0.0f64..1.0),
        ) {
            let frame = Frame::new(pixel, slice).unwrap();
            let (grid, cube) = (CubeGrid { size_m: size, origin_m: origin }, Cube { corner, edge: 1 << level });
            let placed = PlacedCube::new(&frame, &grid, &cube).unwrap();
            let (min, max) = grid.bounds(&cube);
            let place = [0, 1, 2].map(|axis| min[axis] + share[axis] * (max[axis] - min[axis]) * (1.0 - 1e-9));
            for axis in 0..2 {
                let (first, last) = placed.pixels[axis];
                prop_assert!((first..=last).contains(&frame.pixel_of(place[axis])));
                prop_assert!(frame.edge_of_pixel(first) > min[axis] - pixel * 1.000001);
                prop_assert!(frame.edge_of_pixel(last + 1) < max[axis] + pixel * 1.000001);
            }
            let (bottom, top) = placed.heights;
            prop_assert!(bottom <= frame.quantum_floor(place[2]) && frame.quantum_ceil(place[2]) <= top);
            prop_assert!(frame.bottom_height(bottom) > min[2] - frame.quantum_m() * 1.000001);
            prop_assert!(frame.top_height(top) < max[2] + frame.quantum_m() * 1.000001);
        }
    }
}
