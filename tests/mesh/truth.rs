//! Triangles sorted into square cells in xy, to find what a box really meets; and the voxels of a store.
#![allow(dead_code, reason = "each test file uses a part")]

use super::files::Triangle;
use super::sat::{Box3, gap};
use super::scans::Random;
use slicewalk::store::Snapshot;
use std::collections::{BTreeMap, BTreeSet};

pub struct Truth {
    cell: f64,
    triangles: Vec<Triangle>,
    cells: BTreeMap<(i64, i64), Vec<u32>>,
}

impl Truth {
    pub fn new(mut triangles: Vec<Triangle>, y_up: bool, cell: f64) -> Self {
        if y_up {
            triangles.iter_mut().flatten().for_each(|corner| *corner = [corner[0], -corner[2], corner[1]]);
        }
        let mut cells: BTreeMap<_, Vec<u32>> = BTreeMap::new();
        for (n, triangle) in triangles.iter().enumerate() {
            let range = |axis: usize| {
                let values = triangle.map(|corner| corner[axis]);
                let index = |v: f64| (v / cell).floor() as i64;
                (
                    index(values.into_iter().fold(f64::INFINITY, f64::min)),
                    index(values.into_iter().fold(-1e300, f64::max)),
                )
            };
            let (x, y) = (range(0), range(1));
            for at in (x.0..=x.1).flat_map(|i| (y.0..=y.1).map(move |j| (i, j))) {
                cells.entry(at).or_default().push(n as u32);
            }
        }
        Self { cell, triangles, cells }
    }

    /// A random point on some triangle.
    pub fn place(&self, random: &mut Random) -> [f64; 3] {
        let triangle = self.triangles[random.below(self.triangles.len())];
        let (p, q) = (random.uniform(), random.uniform());
        let (p, q) = if p + q > 1.0 { (1.0 - p, 1.0 - q) } else { (p, q) };
        [0, 1, 2].map(|k| {
            let [a, b, c] = triangle.map(|corner| corner[k]);
            a + p * (b - a) + q * (c - a)
        })
    }

    /// Smallest gap between the box and a triangle; far triangles count as infinitely far.
    pub fn nearest(&self, shape: &Box3<f64>) -> f64 {
        let index = |v: f64| (v / self.cell).floor() as i64;
        let rows = index(shape.min[1] - 1e-6)..=index(shape.max[1] + 1e-6);
        let near = rows.flat_map(|j| {
            let columns = index(shape.min[0] - 1e-6)..=index(shape.max[0] + 1e-6);
            columns.filter_map(move |i| self.cells.get(&(i, j))).flatten()
        });
        near.map(|&n| gap(&self.triangles[n as usize], shape)).fold(f64::INFINITY, f64::min)
    }
}

/// Occupied voxels: pixels and slices.
pub fn voxels(store: &Snapshot) -> BTreeSet<(i64, i64, i64)> {
    let mut all = BTreeSet::new();
    for number in 0..store.column_count() {
        let (tx, ty, slots) = store.column_at(number);
        for slot in slots {
            for (px, py, spans) in slot.page().unwrap().columns() {
                for span in spans {
                    let (first, last) = span.slices();
                    let at = |k: u32| i64::from(slot.layer()) * 64 + i64::from(k);
                    let pixel = (i64::from(tx) * 64 + i64::from(px), i64::from(ty) * 64 + i64::from(py));
                    all.extend((first..=last).map(|k| (pixel.0, pixel.1, at(k))));
                }
            }
        }
    }
    all
}
