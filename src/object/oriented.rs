//! Separating-axis test for two boxes in different coordinate frames.

use nalgebra::Isometry3;

/// Growth of all comparisons relative to the coordinates, above their rounding errors: some 20 operations of `2⁻⁵³`.
pub(super) const SLACK: f64 = 1.0 / (1u64 << 45) as f64;

/// A closed box along the axes of its object (m).
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalBox {
    pub middle: [f64; 3],
    pub half: [f64; 3],
}

/// Pose of a second object in the frame of the first.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relative {
    /// Row `k`: axis `k` of the first object in the frame of the second.
    turn: [[f64; 3]; 3],
    abs: [[f64; 3]; 3],
    shift: [f64; 3],
    slack: f64,
}

impl Relative {
    /// Creates the relative pose of two objects; `coordinates_m` is the sum of the coordinates from which poses and
    /// boxes are computed (m).
    pub(super) fn new(first: &Isometry3<f64>, second: &Isometry3<f64>, coordinates_m: f64) -> Self {
        let turn = (first.rotation.inverse() * second.rotation).to_rotation_matrix();
        let between = second.translation.vector - first.translation.vector;
        let shift = first.rotation.inverse() * between;
        let rows = |f: fn(f64) -> f64| [0, 1, 2].map(|row| [0, 1, 2].map(|column| f(turn[(row, column)])));
        Self { turn: rows(|v| v), abs: rows(f64::abs), shift: shift.into(), slack: SLACK * coordinates_m }
    }

    /// Returns the vector from the middle of `a` to the middle of `b`, along the axes of the first object.
    #[inline]
    fn between(&self, a: &LocalBox, b: &LocalBox) -> [f64; 3] {
        [0, 1, 2].map(|k| {
            let [x, y, z] = self.turn[k];
            x * b.middle[0] + y * b.middle[1] + z * b.middle[2] + self.shift[k] - a.middle[k]
        })
    }

    /// Returns the squared distance between the middles of two boxes (m²).
    #[inline]
    pub(super) fn distance_squared(&self, a: &LocalBox, b: &LocalBox) -> f64 {
        self.between(a, b).iter().map(|v| v * v).sum()
    }

    /// Returns whether a face of either box separates them, which decides most pairs that are apart.
    #[inline]
    pub(super) fn separates_by_faces(&self, a: &LocalBox, b: &LocalBox) -> bool {
        self.faces(&self.between(a, b), a, b)
    }

    #[inline]
    fn faces(&self, d: &[f64; 3], a: &LocalBox, b: &LocalBox) -> bool {
        let (turn, abs) = (&self.turn, &self.abs);
        let of_first = |k: usize| {
            let reach = abs[k][0] * b.half[0] + abs[k][1] * b.half[1] + abs[k][2] * b.half[2];
            d[k].abs() > a.half[k] + reach + self.slack
        };
        let of_second = |k: usize| {
            let along = d[0] * turn[0][k] + d[1] * turn[1][k] + d[2] * turn[2][k];
            let reach = abs[0][k] * a.half[0] + abs[1][k] * a.half[1] + abs[2][k] * a.half[2];
            along.abs() > b.half[k] + reach + self.slack
        };
        (0..3).any(of_first) || (0..3).any(of_second)
    }

    /// Returns whether the boxes share a point.
    pub(super) fn meets(&self, a: &LocalBox, b: &LocalBox) -> bool {
        let d = self.between(a, b);
        !self.faces(&d, a, b) && !self.edges(&d, a, b)
    }

    /// Returns whether a plane along an edge of each box separates them.
    fn edges(&self, d: &[f64; 3], a: &LocalBox, b: &LocalBox) -> bool {
        let (turn, abs) = (&self.turn, &self.abs);
        (0..9).any(|n| {
            let (i, j) = (n / 3, n % 3);
            let ((i1, i2), (j1, j2)) = (((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3));
            let along = d[i2] * turn[i1][j] - d[i1] * turn[i2][j];
            let reach = a.half[i1] * abs[i2][j] + a.half[i2] * abs[i1][j];
            let other = b.half[j1] * abs[i][j2] + b.half[j2] * abs[i][j1];
            // The axis of two almost parallel edges has no length; both sides are then rounding errors.
            along.abs() > reach + other + self.slack
        })
    }
}
