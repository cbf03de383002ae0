//! Brute force: what the points themselves answer.

use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;
use std::collections::HashMap;

/// Edge of a cell (m), where nothing else is asked for.
const CELL: f64 = 0.1;

/// All points, ordered by cells.
pub struct Oracle {
    edge: f64,
    points: Vec<Point3<f64>>,
    /// Where the points of a cell lie: first, and one behind the last.
    cells: HashMap<[i32; 3], (u32, u32)>,
}

fn cell(p: &Point3<f64>, edge: f64) -> [i32; 3] {
    [p.x, p.y, p.z].map(|v| (v / edge).floor() as i32)
}

/// Shrinks a box slightly: points on its faces do not stop it.
fn inside(shape: &Aabb) -> (Point3<f64>, Point3<f64>) {
    let skin = Vector3::repeat(1e-6);
    (shape.min() + skin, shape.max() - skin)
}

impl Oracle {
    pub fn new(points: &[Point3<f64>]) -> Self {
        Self::with_cells(points, CELL)
    }

    /// With cells of this edge (m): as many as the points make worthwhile.
    pub fn with_cells(points: &[Point3<f64>], edge: f64) -> Self {
        let mut points = points.to_vec();
        points.sort_by_cached_key(|p| cell(p, edge));
        let mut cells = HashMap::new();
        let mut first = 0;
        for own in points.chunk_by(|a, b| cell(a, edge) == cell(b, edge)) {
            let end = first + own.len() as u32;
            cells.insert(cell(&own[0], edge), (first, end));
            first = end;
        }
        Self { edge, points, cells }
    }

    /// The points in a closed box.
    pub fn points(&self, min: Point3<f64>, max: Point3<f64>) -> impl Iterator<Item = &Point3<f64>> {
        let (low, high) = (cell(&min, self.edge), cell(&max, self.edge));
        let cells = (low[0]..=high[0])
            .flat_map(move |i| (low[1]..=high[1]).flat_map(move |j| (low[2]..=high[2]).map(move |k| [i, j, k])));
        let ranges = cells.filter_map(|cell| self.cells.get(&cell));
        let points = ranges.flat_map(|&(first, end)| &self.points[first as usize..end as usize]);
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
