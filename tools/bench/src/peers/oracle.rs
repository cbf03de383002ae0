//! Brute force: what the points themselves answer.

use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;
use std::collections::HashMap;

/// Edge of a cell (m).
const CELL: f64 = 0.1;

/// All points, by cells.
pub struct Oracle(HashMap<[i32; 3], Vec<Point3<f64>>>);

fn cell(p: &Point3<f64>) -> [i32; 3] {
    [p.x, p.y, p.z].map(|v| (v / CELL).floor() as i32)
}

/// What is touched is not met: points on the faces of a box do not stop it.
fn inside(shape: &Aabb) -> (Point3<f64>, Point3<f64>) {
    let skin = Vector3::repeat(1e-6);
    (shape.min() + skin, shape.max() - skin)
}

impl Oracle {
    pub fn new(points: &[Point3<f64>]) -> Self {
        let mut cells: HashMap<_, Vec<_>> = HashMap::new();
        points.iter().for_each(|p| cells.entry(cell(p)).or_default().push(*p));
        Self(cells)
    }

    /// The points in a closed box.
    pub fn points(&self, min: Point3<f64>, max: Point3<f64>) -> impl Iterator<Item = &Point3<f64>> {
        let (low, high) = (cell(&min), cell(&max));
        let cells = (low[0]..=high[0])
            .flat_map(move |i| (low[1]..=high[1]).flat_map(move |j| (low[2]..=high[2]).map(move |k| [i, j, k])));
        let points = cells.filter_map(|cell| self.0.get(&cell)).flatten();
        points.filter(move |p| (0..3).all(|axis| (min[axis]..=max[axis]).contains(&p[axis])))
    }

    pub fn hits(&self, shape: &Aabb) -> bool {
        self.points(shape.min(), shape.max()).next().is_some()
    }

    /// Distance after which the inside of a moving box meets the first point; the whole way if it meets none.
    pub fn sweep(&self, shape: &Aabb, way: Vector3<f64>) -> f64 {
        let (min, max) = inside(shape);
        let zero = Vector3::zeros();
        let fraction = |p: &Point3<f64>| {
            let (mut enter, mut leave) = (0.0f64, 1.0f64);
            for axis in 0..3 {
                let (low, high) = (p[axis] - max[axis], p[axis] - min[axis]);
                if way[axis] == 0.0 {
                    if low > 0.0 || high < 0.0 {
                        return 1.0;
                    }
                    continue;
                }
                let (s, t) = (low / way[axis], high / way[axis]);
                (enter, leave) = (enter.max(s.min(t)), leave.min(s.max(t)));
            }
            if enter <= leave { enter } else { 1.0 }
        };
        let reached = self.points(min + way.inf(&zero), max + way.sup(&zero));
        reached.map(fraction).fold(1.0, f64::min) * way.norm()
    }

    /// Height of the highest point under the inside of the box's footprint, from its bottom down to `depth` below (m).
    pub fn top(&self, shape: &Aabb, depth: f64) -> Option<f64> {
        let (min, mut max) = inside(shape);
        max.z = min.z;
        self.points(min - Vector3::new(0.0, 0.0, depth), max).map(|p| p.z).max_by(f64::total_cmp)
    }

    /// Whether a point is as near as this across and along z (m).
    pub fn near(&self, p: Point3<f64>, across: f64, along_z: f64) -> bool {
        let by = Vector3::new(across, across, along_z);
        self.points(p - by, p + by).next().is_some()
    }
}
