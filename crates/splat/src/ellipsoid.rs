//! The solid part of a splat: where its own opacity reaches a threshold, an ellipsoid.
//!
//! A splat of opacity `α` has the opacity `α·exp(−d²/2)` at the Mahalanobis distance `d` from its centre. It is at least
//! `X` where `d² ≤ 2·ln(α/X)`: an ellipsoid whose semi-axes are the standard deviations times `sqrt(2·ln(α/X))`.
//!
//! *Rounding.* The logarithm is that of `libm`, so it is the same on every platform; its error is below 1 unit in the last
//! place. Semi-axes are multiplied by `1 + 2⁻⁴⁰` (`GROWTH`), which exceeds all relative errors up to here. An axis
//! shorter than 2⁻¹⁶ of the longest grows to that length (0.15 mm for a splat that reaches 10 m), so that flat discs and
//! needles have an inverse. The ellipsoid only grows, so no place of the level set is missed (guarantee G1).

use crate::Splat;

/// Default opacity from which on a place is solid.
pub const DEFAULT_OPACITY: f64 = 0.1;

/// Relative growth of semi-axes, beyond the rounding errors of their computation.
const GROWTH: f64 = 1.0 / (1u64 << 40) as f64;
/// Least length of a semi-axis, in lengths of the longest one.
const LEAST_SHARE: f64 = 1.0 / (1u64 << 16) as f64;
/// Least length of the longest semi-axis (m): a splat that reaches the threshold at its centre alone is solid there.
const LEAST_RADIUS_M: f64 = 1e-9;
/// A splat is a flat disc if its smallest axis has at most this share of the middle one.
const FLAT_SHARE: f64 = 0.5;
/// Any other splat is a needle if its middle axis has at most this share of the longest one.
const NEEDLE_SHARE: f64 = 0.8;

/// An ellipsoid: the places where a splat's opacity reaches a threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// Centre (m).
    pub centre: [f64; 3],
    /// Unit vectors along its axes.
    pub axes: [[f64; 3]; 3],
    /// Semi-axes (m), all above 0.
    pub radii: [f64; 3],
    /// Normal of a flat disc: the smallest axis is at most half as long as the middle one.
    pub normal: Option<[f64; 3]>,
    /// Direction of a needle: no flat disc, and the longest axis is at least 1.25 times as long as the middle one.
    pub along: Option<[f64; 3]>,
}

impl Ellipsoid {
    /// Returns the places where the opacity of `splat` is at least `opacity` (above 0); `None` if no place reaches it,
    /// or if a number is not finite.
    pub fn of(splat: &Splat, opacity: f64) -> Option<Self> {
        let squared = 2.0 * libm::log(f64::from(splat.opacity) / opacity);
        // A splat that just reaches the threshold is solid at its centre alone.
        if !(squared >= 0.0 && squared.is_finite() && splat.mean.iter().all(|v| v.is_finite())) {
            return None;
        }
        let reach = squared.sqrt() * (1.0 + GROWTH);
        let radii = splat.scale.map(|scale| f64::from(scale) * reach);
        Self::new(splat.mean, splat.rotation.map(f64::from), radii)
    }

    /// Creates the ellipsoid with these semi-axes (m), turned by a quaternion w, x, y, z of any length above 0.
    pub fn new(centre: [f64; 3], [w, x, y, z]: [f64; 4], radii: [f64; 3]) -> Option<Self> {
        let longest = radii.iter().fold(LEAST_RADIUS_M, |longest: f64, &radius| longest.max(radius));
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let usable = longest.is_finite() && radii.iter().all(|r| *r >= 0.0) && length > 0.0;
        if !(usable && length.is_finite()) {
            return None;
        }
        let [w, x, y, z] = [w, x, y, z].map(|v| v / length);
        let axes = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| radii[a].total_cmp(&radii[b]));
        let is_flat = radii[order[0]] <= FLAT_SHARE * radii[order[1]];
        let is_needle = !is_flat && radii[order[1]] <= NEEDLE_SHARE * radii[order[2]];
        let (normal, along) = (is_flat.then_some(axes[order[0]]), is_needle.then_some(axes[order[2]]));
        let radii = radii.map(|radius| radius.max(LEAST_SHARE * longest));
        Some(Self { centre, axes, radii, normal, along })
    }

    /// Returns the ellipsoid scaled by `factor` (above 0), turned by the rotation with these rows, then shifted.
    pub fn moved(&self, factor: f64, rows: &[[f64; 3]; 3], shift: [f64; 3]) -> Self {
        let turned = |v: [f64; 3]| rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
        let centre = turned(self.centre);
        Self {
            centre: [0, 1, 2].map(|axis| centre[axis] * factor + shift[axis]),
            axes: self.axes.map(turned),
            radii: self.radii.map(|radius| radius * factor),
            normal: self.normal.map(turned),
            along: self.along.map(turned),
        }
    }

    /// Longest diameter (m).
    pub fn size(&self) -> f64 {
        2.0 * self.radii.iter().fold(0.0, |longest: f64, &radius| longest.max(radius))
    }

    /// Volume (m³).
    pub fn volume(&self) -> f64 {
        4.0 / 3.0 * std::f64::consts::PI * self.radii[0] * self.radii[1] * self.radii[2]
    }

    /// Returns bounds of its coordinates (m): at least as wide as those of its pixels and slices, which the raster grows
    /// by `2⁻³⁰` of the reach and `2⁻⁴⁶` of the coordinates.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let reach =
            [0, 1, 2].map(|row| (0..3).map(|k| (self.axes[k][row] * self.radii[k]).powi(2)).sum::<f64>().sqrt());
        let longest = reach.iter().fold(0.0, |longest: f64, &reach| longest.max(reach));
        let slack = |axis: usize| longest / (1u64 << 29) as f64 + self.centre[axis].abs() / (1u64 << 45) as f64;
        let ends = |sign: f64| [0, 1, 2].map(|axis| self.centre[axis] + sign * (reach[axis] + slack(axis)));
        (ends(-1.0), ends(1.0))
    }
}
