//! Triangle against box by separating axes, independent of the code under test: exactly in integers, and in `f64` with
//! the smallest gap.
#![allow(dead_code, reason = "each test file uses a part")]

/// A closed box.
#[derive(Debug, Clone, Copy)]
pub struct Box3<T> {
    pub min: [T; 3],
    pub max: [T; 3],
}

impl Box3<f64> {
    /// Grown by `by` on each side.
    pub fn grown(&self, by: [f64; 3]) -> Self {
        let moved = |of: [f64; 3], sign: f64| [0, 1, 2].map(|k| of[k] + sign * by[k]);
        Self { min: moved(self.min, -1.0), max: moved(self.max, 1.0) }
    }
}

/// The 13 relevant axes: the box's, the triangle's normal, and the products of their edges.
fn axes<T: Copy + std::ops::Sub<Output = T> + std::ops::Mul<Output = T> + From<i8>>(t: &[[T; 3]; 3]) -> [[T; 3]; 13] {
    let sub = |a: [T; 3], b: [T; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let cross =
        |a: [T; 3], b: [T; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let (zero, one) = (T::from(0), T::from(1));
    let unit = [[one, zero, zero], [zero, one, zero], [zero, zero, one]];
    let edges = [sub(t[1], t[0]), sub(t[2], t[1]), sub(t[0], t[2])];
    let mut all = [[zero; 3]; 13];
    all[..3].copy_from_slice(&unit);
    all[3] = cross(edges[0], edges[1]);
    for (n, edge) in edges.into_iter().enumerate() {
        for (m, axis) in unit.into_iter().enumerate() {
            all[4 + 3 * n + m] = cross(edge, axis);
        }
    }
    all
}

/// Returns whether a closed triangle and a closed box share a point, exactly. Coordinates up to 2³⁰.
pub fn meets_exactly(t: &[[i128; 3]; 3], b: &Box3<i128>) -> bool {
    axes(t).iter().all(|axis| {
        let dot = |p: [i128; 3]| (0..3).map(|k| p[k] * axis[k]).sum::<i128>();
        let corners = t.map(dot);
        let (low, high) = (corners.into_iter().min().unwrap(), corners.into_iter().max().unwrap());
        let reach =
            |pick: fn(i128, i128) -> i128| (0..3).map(|k| pick(b.min[k] * axis[k], b.max[k] * axis[k])).sum::<i128>();
        low <= reach(i128::max) && high >= reach(i128::min)
    })
}

/// Largest gap between a triangle and a box along any axis: if positive, they are at least this far apart; if negative,
/// they share a point, and still do after moving the box by less.
pub fn gap(t: &[[f64; 3]; 3], b: &Box3<f64>) -> f64 {
    // Relative to the box's centre, so that products of large coordinates lose nothing.
    let middle = [0, 1, 2].map(|k| (b.min[k] + b.max[k]) / 2.0);
    let half = [0, 1, 2].map(|k| (b.max[k] - b.min[k]) / 2.0);
    let t = t.map(|p| [0, 1, 2].map(|k| p[k] - middle[k]));
    let mut widest = f64::NEG_INFINITY;
    for axis in axes(&t) {
        let length = axis.iter().map(|v| v * v).sum::<f64>().sqrt();
        if length < 1e-300 {
            continue;
        }
        let corners = t.map(|p| (0..3).map(|k| p[k] * axis[k]).sum::<f64>() / length);
        let reach = (0..3).map(|k| half[k] * axis[k].abs()).sum::<f64>() / length;
        let low = corners.into_iter().fold(f64::INFINITY, f64::min);
        let high = corners.into_iter().fold(f64::NEG_INFINITY, f64::max);
        widest = widest.max(low - reach).max(-reach - high);
    }
    widest
}
