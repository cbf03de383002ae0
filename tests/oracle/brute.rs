//! Brute-force answers that examine every span.

use super::scene::{Matter, Scene};
use nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Ray};

impl Scene {
    /// Spans of all pixels that `covers` accepts.
    fn matter(&self, covers: impl Fn(i64, i64) -> bool) -> impl Iterator<Item = Matter> {
        let columns = self.columns.iter().filter(move |((i, j), _)| covers(*i, *j));
        columns.flat_map(|(_, spans)| spans.iter().copied())
    }

    pub fn pixels_of(&self, shape: &Aabb) -> impl Fn(i64, i64) -> bool + use<> {
        let pixel = |v| self.frame.pixel_of(v);
        let (i, j) = (pixel(shape.min().x)..=pixel(shape.max().x), pixel(shape.min().y)..=pixel(shape.max().y));
        move |a, b| i.contains(&a) && j.contains(&b)
    }

    pub fn quanta(&self, low: f64, high: f64) -> (i64, i64) {
        (self.frame.quantum_ceil(low), self.frame.quantum_floor(high))
    }

    /// `(hit, obstacle)`.
    pub fn touches(&self, covers: impl Fn(i64, i64) -> bool, (low, high): (i64, i64)) -> (bool, bool) {
        let meeting: Vec<_> = self.matter(covers).filter(|m| m.0 <= high && m.1 >= low).collect();
        (!meeting.is_empty(), meeting.iter().any(|m| m.2))
    }

    pub fn floor(&self, covers: impl Fn(i64, i64) -> bool, (low, high): (i64, i64)) -> Option<f64> {
        let tops = self.matter(covers).filter(|m| !m.2 && (low..=high).contains(&m.1)).map(|m| m.1);
        tops.max().map(|top| self.frame.top_height(top))
    }

    pub fn ceiling(&self, covers: impl Fn(i64, i64) -> bool, (low, high): (i64, i64)) -> Option<f64> {
        let columns = self.columns.iter().filter(|((i, j), _)| covers(*i, *j));
        let undersides = columns.flat_map(|(_, spans)| {
            (0..spans.len()).filter(|&n| n == 0 || spans[n - 1].1 != spans[n].0).map(|n| spans[n].0)
        });
        undersides.filter(|b| (low..=high).contains(b)).min().map(|b| self.frame.bottom_height(b))
    }

    /// Pixels at most `reach` from (`x`, `y`).
    pub fn pixels_near(&self, x: f64, y: f64, reach: f64) -> impl Fn(i64, i64) -> bool {
        move |i, j| self.gap(x, y, i, j) <= reach
    }

    /// Distance in x and y from (`x`, `y`) to pixel (`i`, `j`).
    fn gap(&self, x: f64, y: f64, i: i64, j: i64) -> f64 {
        let edge = |n| self.frame.edge_of_pixel(n);
        let axis = |v: f64, n: i64| (edge(n) - v).max(v - edge(n + 1)).max(0.0);
        axis(x, i).hypot(axis(y, j))
    }

    /// Distance from `center` to the nearest solid (m).
    pub fn distance(&self, center: Point3<f64>) -> f64 {
        let quantum = self.frame.quantum_m();
        let distances = self.columns.iter().flat_map(|(&(i, j), spans)| {
            let gap = self.gap(center.x, center.y, i, j);
            let up = |m: &Matter| (m.0 as f64 * quantum - center.z).max(center.z - m.1 as f64 * quantum).max(0.0);
            spans.iter().map(move |m| gap.hypot(up(m)))
        });
        distances.fold(f64::INFINITY, f64::min)
    }

    /// Lowest and highest corner of all spans (m).
    fn boxes(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> {
        let (frame, quantum) = (&self.frame, self.frame.quantum_m());
        self.columns.iter().flat_map(move |(&(i, j), spans)| {
            spans.iter().map(move |m| {
                let low = [frame.edge_of_pixel(i), frame.edge_of_pixel(j), m.0 as f64 * quantum];
                let high = [frame.edge_of_pixel(i + 1), frame.edge_of_pixel(j + 1), m.1 as f64 * quantum];
                (low, high)
            })
        })
    }

    /// Returns whether `point` is, within `slack` metres, on the side of a span that `normal` points to.
    pub fn has_face(&self, point: Point3<f64>, normal: Vector3<f64>, slack: f64) -> bool {
        self.boxes().any(|(low, high)| {
            (0..3).all(|axis| {
                let low = if normal[axis] > 0.0 { high[axis] } else { low[axis] };
                let high = if normal[axis] < 0.0 { low } else { high[axis] };
                (low - slack..=high + slack).contains(&point[axis])
            })
        })
    }

    /// First distance at which `ray` meets a span grown by `grow` (negative: shrunk) (m).
    pub fn cast(&self, ray: &Ray, grow: f64) -> Option<f64> {
        let hits = self.boxes().filter_map(|(low, high)| {
            let (mut t0, mut t1) = (0.0f64, ray.max());
            for axis in 0..3 {
                let (a, b) = (low[axis] - grow - ray.origin()[axis], high[axis] + grow - ray.origin()[axis]);
                let d = ray.direction()[axis];
                if a > b {
                    return None; // shrunk to nothing
                }
                if d != 0.0 {
                    t0 = t0.max((a / d).min(b / d));
                    t1 = t1.min((a / d).max(b / d));
                } else if a > 0.0 || b < 0.0 {
                    return None;
                }
            }
            (t0 <= t1).then_some(t0)
        });
        hits.min_by(f64::total_cmp)
    }
}
