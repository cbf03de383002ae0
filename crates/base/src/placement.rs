//! Placement of inputs: a rotation, a uniform scale and a shift, and the rotation that turns a direction upwards.

use std::ops::Mul;

/// A rotation, a uniform scale and a shift: `p` becomes `factor · (rows · p) + shift`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    rows: [[f64; 3]; 3],
    factor: f64,
    shift: [f64; 3],
}

impl Similarity {
    /// Leaves everything in place.
    pub const IDENTITY: Self =
        Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], factor: 1.0, shift: [0.0; 3] };
    /// Greatest deviation of a matrix from a rotation times a scale, relative to the scale.
    const SLACK: f64 = 1e-5;
    /// Least and greatest scale, so that products with coordinates stay finite.
    const FACTORS: std::ops::RangeInclusive<f64> = 1e-9..=1e9;
    /// Greatest shift along an axis (m).
    const FARTHEST_M: f64 = 1e12;

    /// Creates a scale about the origin.
    pub const fn scaling(factor: f64) -> Self {
        Self { factor, ..Self::IDENTITY }
    }

    /// Creates the smallest rotation that turns the unit vector `up` to z. It is exact for the six axes.
    pub fn raising([x, y, z]: [f64; 3]) -> Self {
        // A half turn about x, where the general form has no axis.
        if z <= -1.0 + 1e-12 {
            return Self { rows: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], ..Self::IDENTITY };
        }
        let share = 1.0 / (1.0 + z);
        // Adding 0 turns −0 into 0.
        let rows = [[1.0 - x * x * share, -x * y * share, -x], [-x * y * share, 1.0 - y * y * share, -y], [x, y, z]];
        Self { rows: rows.map(|row| row.map(|v| v + 0.0)), ..Self::IDENTITY }
    }

    /// Parses 16 numbers, row by row, separated by white space or commas. Fails with a reason if the matrix is no
    /// rotation with a uniform scale and a shift.
    pub fn parse(text: &str) -> Result<Self, String> {
        let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
        let numbers: Vec<f64> = words
            .map(|word| {
                let number = word.parse().ok().filter(|v: &f64| v.is_finite());
                number.ok_or_else(|| format!("{:?} is no number", crate::text::one_line(word)))
            })
            .collect::<Result<_, _>>()?;
        let matrix = <[f64; 16]>::try_from(numbers);
        Self::of_matrix(matrix.map_err(|_| "expected 16 numbers: the rows of a 4 × 4 matrix")?)
    }

    /// Creates it from a 4 × 4 matrix, row by row. Fails with a reason if the matrix is none.
    pub fn of_matrix(m: [f64; 16]) -> Result<Self, String> {
        if m[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err("expected 0 0 0 1 as the last row; write the matrix row by row".into());
        }
        let rows = [0, 1, 2].map(|row| [m[4 * row], m[4 * row + 1], m[4 * row + 2]]);
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let [a, b, c] = rows;
        let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        let factor = libm::cbrt(determinant);
        let rows = rows.map(|row| row.map(|v| v / factor));
        let is_rotation = (0..3)
            .all(|i| (0..3).all(|k| (dot(rows[i], rows[k]) - if i == k { 1.0 } else { 0.0 }).abs() <= Self::SLACK));
        if !(factor > 0.0 && factor.is_finite() && is_rotation) {
            return Err(
                "expected a rotation with one scale for all axes and a shift; it mirrors, shears or stretches".into()
            );
        }
        let shift = [m[3], m[7], m[11]];
        if !Self::FACTORS.contains(&factor) || !shift.iter().all(|v| v.abs() <= Self::FARTHEST_M) {
            return Err("expected a scale from 1e-9 to 1e9 and a shift of at most 1e12 m".into());
        }
        Ok(Self { rows, factor, shift })
    }

    /// Returns the 4 × 4 matrix, row by row.
    pub fn matrix(&self) -> [f64; 16] {
        let row = |at: usize| self.rows[at].map(|v| v * self.factor);
        let [[a, b, c], [d, e, f], [g, h, i]] = [row(0), row(1), row(2)];
        let [x, y, z] = self.shift;
        [a, b, c, x, d, e, f, y, g, h, i, z, 0.0, 0.0, 0.0, 1.0]
    }

    /// Returns the rows of the rotation.
    pub fn rows(&self) -> &[[f64; 3]; 3] {
        &self.rows
    }

    /// Returns the scale.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Returns the shift.
    pub fn shift(&self) -> [f64; 3] {
        self.shift
    }

    /// Moves a point. The arithmetic is the same on every platform: each step rounds once.
    #[inline]
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let turned = self.rows.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2]);
        [0, 1, 2].map(|axis| turned[axis] * self.factor + self.shift[axis])
    }

    /// Moves points in columns.
    pub fn apply_to(&self, [x, y, z]: [&mut [f64]; 3]) {
        for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
            [*x, *y, *z] = self.apply([*x, *y, *z]);
        }
    }

    /// Returns a box that holds every moved point of the box `min..=max`, rounding included.
    pub fn apply_to_box(&self, min: [f64; 3], max: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let ends = [0, 1, 2].map(|k| (self.rows[axis][k] * min[k], self.rows[axis][k] * max[k]));
            let sum = |pick: fn(f64, f64) -> f64| ends.iter().map(|end| pick(end.0, end.1)).sum::<f64>();
            let greatest = ends.iter().map(|end| end.0.abs().max(end.1.abs())).sum::<f64>() * self.factor;
            let slack = (greatest + self.shift[axis].abs()) / (1u64 << 45) as f64;
            low[axis] = sum(f64::min) * self.factor + self.shift[axis] - slack;
            high[axis] = sum(f64::max) * self.factor + self.shift[axis] + slack;
        }
        (low, high)
    }
}

/// Returns a row times a matrix.
fn row_of_product(row: [f64; 3], with: &[[f64; 3]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| row[0] * with[0][k] + row[1] * with[1][k] + row[2] * with[2][k])
}

/// Composition: the right one moves first.
impl Mul for Similarity {
    type Output = Self;

    fn mul(self, first: Self) -> Self {
        let rows = self.rows.map(|row| row_of_product(row, &first.rows));
        Self { rows, factor: self.factor * first.factor, shift: self.apply(first.shift) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn axes_turn_exactly() {
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut up = [0.0; 3];
                up[axis] = sign;
                let raised = Similarity::raising(up);
                assert_eq!(raised.apply(up), [0.0, 0.0, 1.0], "{up:?}");
                assert!(raised.rows().as_flattened().iter().all(|v| [0.0, 1.0, -1.0].contains(v)));
                assert_eq!(Similarity::of_matrix(raised.matrix()), Ok(raised));
            }
        }
        // The same turn as that of `Up::Y`.
        assert_eq!(Similarity::raising([0.0, 1.0, 0.0]).apply([1.0, 2.0, 3.0]), [1.0, -3.0, 2.0]);
    }

    proptest! {
        #[test]
        fn directions_turn_upwards_and_boxes_hold_their_points(
            up in prop::array::uniform3(-1.0f64..1.0), shift in prop::array::uniform3(-1e6f64..1e6),
            factor in 1e-3f64..1e3, from in prop::array::uniform3(-1e5f64..1e5), size in prop::array::uniform3(0.0f64..1e4),
            share in prop::array::uniform3(0.0f64..=1.0)
        ) {
            let length = up.iter().map(|v| v * v).sum::<f64>().sqrt();
            prop_assume!(length > 0.01);
            let up = up.map(|v| v / length);
            let raised = Similarity::raising(up);
            let [x, y, z] = raised.apply(up);
            prop_assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && (z - 1.0).abs() < 1e-9);
            let moved = Similarity { shift, ..Similarity::scaling(factor) };
            let both = moved * raised;
            let p: [f64; 3] = std::array::from_fn(|axis| from[axis] + share[axis] * size[axis]);
            let (once, twice) = (both.apply(p), moved.apply(raised.apply(p)));
            prop_assert!((0..3).all(|axis| (once[axis] - twice[axis]).abs() < 1e-5));
            let max = std::array::from_fn(|axis| from[axis] + size[axis]);
            let (low, high) = both.apply_to_box(from, max);
            prop_assert!((0..3).all(|axis| low[axis] <= once[axis] && once[axis] <= high[axis]));
        }
    }

    #[test]
    fn matrices_that_are_none_are_refused_by_reason() {
        let refused = |text: &str| Similarity::parse(text).unwrap_err();
        assert!(refused("1 2 3").contains("16 numbers"));
        assert!(refused("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1").contains("mirrors"));
        assert!(refused("1 0 0 0 0 1 0 0 0 0 1 0 1 0 0 1").contains("last row"));
        assert!(refused("1 0 0 1e300 0 1 0 0 0 0 1 0 0 0 0 1").contains("1e12"));
        assert!(refused("1 0 0 x 0 1 0 0 0 0 1 0 0 0 0 1").contains("\"x\""));
        assert!(Similarity::parse("2,0,0,1, 0,0,-2,0, 0,2,0,0, 0,0,0,1").is_ok());
    }
}
