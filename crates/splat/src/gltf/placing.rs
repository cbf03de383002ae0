//! Placement of splats by a node: a linear map and a shift. A map that stretches unevenly turns an ellipsoid into
//! another one, whose axes are the eigenvectors of its covariance.

use crate::gate::Raw;

type Matrix = [[f64; 3]; 3];

/// Columns of the linear map, and the shift.
#[derive(Debug, Clone, Copy)]
pub struct Placing {
    map: Matrix,
    shift: [f64; 3],
}

impl Placing {
    pub const IDENTITY: Self = Self { map: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], shift: [0.0; 3] };

    /// Creates the placement from a matrix by columns.
    pub fn of_matrix(m: [f64; 16]) -> Self {
        Self { map: [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]], shift: [m[12], m[13], m[14]] }
    }

    /// Creates the placement from a shift, a quaternion x, y, z, w and a scale.
    pub fn of_parts(shift: Option<[f64; 3]>, rotation: Option<[f64; 4]>, scale: Option<[f64; 3]>) -> Self {
        let mut map = rotation.map_or(Self::IDENTITY.map, |[x, y, z, w]| axes([w, x, y, z]));
        for (column, factor) in map.iter_mut().zip(scale.unwrap_or([1.0; 3])) {
            *column = column.map(|v| v * factor);
        }
        Self { map, shift: shift.unwrap_or([0.0; 3]) }
    }

    fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|row| self.map[0][row] * v[0] + self.map[1][row] * v[1] + self.map[2][row] * v[2])
    }

    /// Applies `inner` first, then this.
    pub fn then(&self, inner: &Self) -> Self {
        let moved = self.turn(inner.shift);
        Self { map: inner.map.map(|column| self.turn(column)), shift: [0, 1, 2].map(|a| moved[a] + self.shift[a]) }
    }

    pub fn is_finite(&self) -> bool {
        self.map.as_flattened().iter().chain(&self.shift).all(|v| v.is_finite())
    }

    /// Moves a splat. A splat without a finite size and a rotation stays unchanged; the checks find it later.
    pub fn apply(&self, raw: Raw) -> Raw {
        let moved = self.turn(raw.mean);
        let mean = [0, 1, 2].map(|axis| moved[axis] + self.shift[axis]);
        if self.map == Self::IDENTITY.map {
            return Raw { mean, ..raw };
        }
        let length = raw.rotation.iter().map(|v| v * v).sum::<f64>();
        let is_sound = length > 0.0 && length.is_finite() && raw.scale.iter().all(|s| s.is_finite() && *s >= 0.0);
        if !is_sound {
            return Raw { mean, ..raw };
        }
        // Columns are the moved axes, as long as the sizes.
        let mut axes = axes(raw.rotation);
        for (axis, size) in axes.iter_mut().zip(raw.scale) {
            *axis = self.turn(axis.map(|v| v * size));
        }
        let (scale, rotation) = ellipsoid(axes);
        Raw { mean, scale, rotation, ..raw }
    }
}

/// Returns the axes that a quaternion w, x, y, z of any length turns to.
fn axes(q: [f64; 4]) -> Matrix {
    let length = libm::sqrt(q.iter().map(|v| v * v).sum());
    let [w, x, y, z] = q.map(|v| v / length);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns sizes and rotation of the ellipsoid that has these conjugate half axes: one-sided Jacobi rotations make them
/// orthogonal, without squaring their lengths first, so that thin discs stay thin.
fn ellipsoid(mut axes: Matrix) -> ([f64; 3], [f64; 4]) {
    for _ in 0..32 {
        let mut is_done = true;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (axes[i], axes[j]);
            let (aa, bb, ab) = (dot(a, a), dot(b, b), dot(a, b));
            if ab == 0.0 || libm::fabs(ab) <= 1e-15 * libm::sqrt(aa * bb) {
                continue;
            }
            is_done = false;
            let zeta = (bb - aa) / (2.0 * ab);
            let t = libm::copysign(1.0, zeta) / (libm::fabs(zeta) + libm::sqrt(1.0 + zeta * zeta));
            let c = 1.0 / libm::sqrt(1.0 + t * t);
            let s = c * t;
            axes[i] = [0, 1, 2].map(|n| c * a[n] - s * b[n]);
            axes[j] = [0, 1, 2].map(|n| s * a[n] + c * b[n]);
        }
        if is_done {
            break;
        }
    }
    let scale = axes.map(|axis| libm::sqrt(dot(axis, axis)));
    // An axis without length follows from the others.
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| scale[*b].total_cmp(&scale[*a]));
    let unit = |axis: [f64; 3]| {
        let length = libm::sqrt(dot(axis, axis));
        (length > 0.0 && length.is_finite()).then(|| axis.map(|v| v / length))
    };
    let first = unit(axes[order[0]]).unwrap_or([1.0, 0.0, 0.0]);
    let helper = if libm::fabs(first[0]) < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let second = unit(axes[order[1]]).filter(|s| libm::fabs(dot(*s, first)) < 1e-3);
    let second = second.or_else(|| unit(cross(first, helper))).unwrap_or([0.0, 1.0, 0.0]);
    let third = unit(cross(first, second)).unwrap_or([0.0, 0.0, 1.0]);
    let second = cross(third, first);
    // In the direction that it had, so that a rotation stays the same rotation.
    let third = if dot(third, axes[order[2]]) < 0.0 { third.map(|v| -v) } else { third };
    let mut turned = [[0.0; 3]; 3];
    (turned[order[0]], turned[order[1]], turned[order[2]]) = (first, second, third);
    // A mirror image of an ellipsoid is the same ellipsoid.
    if dot(cross(turned[0], turned[1]), turned[2]) < 0.0 {
        turned[2] = turned[2].map(|v| -v);
    }
    (scale, quaternion(turned))
}

/// Returns the quaternion w, x, y, z of orthogonal unit axes.
fn quaternion(m: Matrix) -> [f64; 4] {
    let trace = m[0][0] + m[1][1] + m[2][2];
    // Four times the squares of the components; the greatest divides the others.
    let squares = [1.0 + trace, 1.0 + 2.0 * m[0][0] - trace, 1.0 + 2.0 * m[1][1] - trace, 1.0 + 2.0 * m[2][2] - trace];
    let greatest = (0..4).max_by(|a, b| squares[*a].total_cmp(&squares[*b])).unwrap_or(0);
    let [wx, wy, wz] = [m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]];
    let [xy, xz, yz] = [m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]];
    let s = squares[greatest];
    match greatest {
        0 => [s, wx, wy, wz],
        1 => [wx, s, xy, xz],
        2 => [wy, xy, s, yz],
        _ => [wz, xz, yz, s],
    }
}
