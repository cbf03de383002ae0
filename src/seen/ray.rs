//! Rays through seen space, cell by cell (J. Amanatides, A. Woo, "A fast voxel traversal algorithm", 1987).

use super::{CellIndex, HIT_CELLS, SeenSpace};
use nalgebra::{Point3, Vector3};

impl SeenSpace {
    /// Returns whether a ray was all seen from `origin` (m) in the direction `along`, which need not have length 1, up
    /// to `length` times `along`.
    ///
    /// If it `hits` something there, the cells within two of the hit's along each axis count as seen, since none is
    /// stored so near to a surface. A ray of infinite length ends at the first cell that was not seen.
    pub fn is_ray_seen(&self, origin: Point3<f64>, along: Vector3<f64>, length: f64, hits: bool) -> bool {
        let end = self.cell_of(origin + along * length);
        let near = |cell: &CellIndex| hits && (0..3).all(|axis| (cell[axis] - end[axis]).abs() <= HIT_CELLS);
        let size = self.cell_m();
        let mut cell = self.cell_of(origin);
        // Lengths at which the ray reaches the next cell along each axis, and from one to the next.
        let step: [i64; 3] = std::array::from_fn(|axis| if along[axis] < 0.0 { -1 } else { 1 });
        let apart: [f64; 3] = std::array::from_fn(|axis| (size[axis] / along[axis]).abs());
        let reached = |axis: usize, cell: &CellIndex| {
            let edge = (cell[axis] + step[axis].max(0)) as f64 * size[axis];
            let at = (edge - origin[axis]) / along[axis];
            // Not a number, or infinite, where the ray does not move along the axis.
            if along[axis] == 0.0 || at.is_nan() { f64::INFINITY } else { at }
        };
        let mut next: [f64; 3] = std::array::from_fn(|axis| reached(axis, &cell));
        loop {
            if !near(&cell) && !self.is_cell_seen(cell) {
                return false;
            }
            let axis = (0..3).fold(0, |least, axis| if next[axis] < next[least] { axis } else { least });
            if next[axis] > length || next[axis] == f64::INFINITY || length.is_nan() {
                return true;
            }
            cell[axis] += step[axis];
            // Adding lengths would let errors grow; a step always leads on.
            next[axis] = reached(axis, &cell).max(next[axis]).min(next[axis] + 2.0 * apart[axis]);
        }
    }
}
