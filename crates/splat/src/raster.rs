//! Ellipsoids to pixels: which pixels an ellipsoid meets, and its height interval over each.
//!
//! In: ellipsoids in metres. Out: the lowest and highest quantum of the closed ellipsoid over each pixel that it meets.
//! Memory: none beyond the stack.
//!
//! *Method.* Let `C` be the matrix of the ellipsoid `(p−m)ᵀ·C⁻¹·(p−m) ≤ 1` in pixels, pixels and quanta, and `A = C⁻¹`.
//! Over a place of the ground plan, heights end at `g·u ± sqrt((1 − ‖u‖²)/A_zz)`, where `u` is the offset from the centre
//! and `‖u‖` its length in the shadow's own measure. The top is a concave function, so over a row of pixels its greatest
//! value at a position `x` is a concave function of `x` too, in closed form: the summit of the cross-section at `x`, or
//! the top on the edge of the row that is nearer to that summit. Over a pixel of the row, it is greatest at the row's
//! summit if this lies in the pixel, else on the pixel's side towards the summit. Bottoms are mirrored. The ellipsoid is
//! convex, so all heights between bottom and top over a pixel are solid: no phantom within a pixel.
//!
//! *Rounding.* Let `u = 2⁻⁵³`, `M` the greatest coordinate of the ellipsoid along an axis and `a` its greatest reach, in
//! pixels or quanta. Sums that could cancel are not used: variances of cross-sections come from products of semi-axes
//! and from sums of squares, so each height is exact for a place beside the stated one and for axes turned by a few `u`.
//! Semi-axes are at least 2⁻¹⁶ of the longest, so this moves the surface by less than `2⁻³¹·a`, and converting
//! coordinates to the grid by `2·u·M`. Rows, pixels and heights grow outwards by `2⁻³⁰·a + 2⁻⁴⁶·M` (`SLACK_OF_REACH`,
//! `SLACK`), which exceeds the sum; that is 10⁻⁸ m for an ellipsoid of 10 m.

use crate::ellipsoid::Ellipsoid;
use slicewalk_base::frame::{Frame, MAX_INDEX, SLICE_QUANTA, floor_index};
use slicewalk_base::plan::rise_of;

const SLACK: f64 = 1.0 / (1u64 << 46) as f64;
const SLACK_OF_REACH: f64 = 1.0 / (1u64 << 30) as f64;
/// A disc is steep if the square of its tangent exceeds the limit's by more than this share, as for triangles.
const SLOPE_SLACK: f64 = 1e-4;

/// Rasterizes ellipsoids to the grid of one archive.
#[derive(Debug, Clone, Copy)]
pub struct EllipsoidRaster {
    frame: Frame,
    /// Square of the tangent above which a disc is steep.
    steep_squared: f64,
    /// Height over a pixel above which an ellipsoid is steep, unless it is a flat disc (quanta).
    steep_run: f64,
}

/// Height interval of an ellipsoid over one pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    /// Pixel along x.
    pub i: i64,
    /// Lowest quantum.
    pub bottom: i64,
    /// Highest quantum.
    pub top: i64,
    /// True for an obstacle, false for a floor; `None` if its shape does not say.
    pub steep: Option<bool>,
}

/// An ellipsoid on the grid: pixels, pixels and quanta.
#[derive(Debug, Clone, Copy)]
pub struct GridEllipsoid {
    centre: [f64; 3],
    /// Greatest reach along each axis.
    reach: [f64; 3],
    slack: [f64; 3],
    /// Offset of the highest place from the centre; of the lowest one with the opposite sign.
    summit: [f64; 3],
    /// Offset of the rightmost place of the shadow.
    rightmost: [f64; 2],
    /// Along a line of constant x or y: offset of the centre of the cross-section per offset of the line, and its reach
    /// through the centre.
    of_x: Section,
    of_y: Section,
    /// Rise of the middle plane along x and y, and half the thickness at the centre per reach of `of_x` across.
    rise: [f64; 2],
    thickness: f64,
    /// True or false for a flat disc, true for a steep needle; `None` for others.
    steep: Option<bool>,
    steep_run: f64,
}

/// Cross-section of an ellipsoid at a constant x (or y), in the other horizontal axis and in z. All its lengths shrink by
/// `sqrt(1 − (offset/reach)²)`.
#[derive(Debug, Clone, Copy)]
struct Section {
    /// Reach of the ellipsoid along the constant axis, and its reciprocal.
    along: f64,
    per_along: f64,
    /// Offset of the section's centre, per offset of the line: across and up.
    drift: [f64; 2],
    /// Reach of the section through the centre: across and up.
    reach: [f64; 2],
    /// Offset across of the section's summit through the centre.
    summit: f64,
}

impl Section {
    /// Returns the length of a section at this offset relative to the one through the centre; `None` outside of the
    /// ellipsoid.
    fn shrink(&self, offset: f64) -> Option<f64> {
        let share = offset * self.per_along;
        (share.abs() <= 1.0).then(|| ((1.0 - share) * (1.0 + share)).sqrt())
    }
}

impl EllipsoidRaster {
    /// Creates a raster on `frame`; discs steeper than `max_slope_deg` (degrees, 0..=90) are obstacles.
    pub fn new(frame: Frame, max_slope_deg: f64) -> Self {
        let tangent = rise_of(max_slope_deg);
        Self {
            frame,
            steep_squared: tangent * tangent * (1.0 + SLOPE_SLACK),
            steep_run: std::f64::consts::SQRT_2 * tangent * frame.quanta(frame.pixel_m()),
        }
    }

    /// Puts the ellipsoid on the grid; `None` if it is not finite there.
    pub fn place(&self, ellipsoid: &Ellipsoid) -> Option<GridEllipsoid> {
        let frame = &self.frame;
        let Ellipsoid { centre, axes, radii, normal, along } = ellipsoid;
        let unit = [frame.pixels(1.0), frame.pixels(1.0), frame.quanta(1.0)];
        let centre = [frame.pixels(centre[0]), frame.pixels(centre[1]), frame.quanta(centre[2])];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let f = [0, 1, 2].map(|row| [0, 1, 2].map(|k| axes[k][row] * radii[k] * unit[row]));
        let g = [0, 1, 2].map(|row| [0, 1, 2].map(|k| axes[k][row] / (radii[k] * unit[row])));
        let c = |a: usize, b: usize| dot(f[a], f[b]);
        let a = |p: usize, q: usize| dot(g[p], g[q]);
        let reach = [0, 1, 2].map(|axis| c(axis, axis).sqrt());
        let root = radii[0] * radii[1] * radii[2] * unit[0] * unit[1] * unit[2];
        let (xx, yy, zz) = (a(0, 0).sqrt(), a(1, 1).sqrt(), a(2, 2).sqrt());
        let of_x = Section {
            along: reach[0],
            per_along: 1.0 / reach[0],
            drift: [c(0, 1) / c(0, 0), c(0, 2) / c(0, 0)],
            reach: [root * zz / reach[0], root * yy / reach[0]],
            summit: -a(1, 2) * root / (reach[0] * yy),
        };
        let of_y = Section {
            along: reach[1],
            per_along: 1.0 / reach[1],
            drift: [c(0, 1) / c(1, 1), c(1, 2) / c(1, 1)],
            reach: [root * zz / reach[1], root * xx / reach[1]],
            summit: -a(0, 2) * root / (reach[1] * xx),
        };
        let longest = reach.iter().zip(unit).fold(0.0, |longest: f64, (reach, unit)| longest.max(reach / unit));
        let slack =
            [0, 1, 2].map(|axis| SLACK * (centre[axis].abs() + reach[axis]) + SLACK_OF_REACH * longest * unit[axis]);
        let flat = |v: &[f64; 3]| v[0] * v[0] + v[1] * v[1];
        // A surface is at least as steep as any line in it.
        let rises = |v: &[f64; 3]| v[2] * v[2] > self.steep_squared * flat(v);
        let of_needle = || along.as_ref().filter(|along| rises(along)).map(|_| true);
        let by_shape = || normal.as_ref().map(|n| flat(n) > self.steep_squared * n[2] * n[2]).or_else(of_needle);
        // Up to a limit of 90° nothing is an obstacle.
        let steep = if self.steep_squared.is_finite() { by_shape() } else { Some(false) };
        let placed = GridEllipsoid {
            centre,
            reach,
            slack,
            summit: [c(0, 2) / reach[2], c(1, 2) / reach[2], reach[2]],
            rightmost: [reach[0], c(0, 1) / reach[0]],
            of_x,
            of_y,
            rise: [-a(0, 2) / a(2, 2), -a(1, 2) / a(2, 2)],
            thickness: 1.0 / (zz * of_x.reach[0]),
            steep,
            steep_run: self.steep_run,
        };
        let sections = [of_x, of_y].iter().all(|s| {
            [s.per_along, s.drift[0], s.drift[1], s.reach[0], s.reach[1], s.summit].iter().all(|v| v.is_finite())
        });
        let ends = centre.iter().chain(&reach).chain(&placed.summit).chain(&placed.rise).chain([&placed.thickness]);
        (sections && ends.into_iter().all(|v| v.is_finite())).then_some(placed)
    }
}

impl GridEllipsoid {
    /// Returns whether all its pixels and slices have an index on the grid.
    pub fn is_on_grid(&self) -> bool {
        [1, 1, SLICE_QUANTA].into_iter().enumerate().all(|(axis, unit)| {
            self.centre[axis].abs() + self.reach[axis] + self.slack[axis] < ((MAX_INDEX - 1) * unit) as f64
        })
    }

    /// Approximate number of voxels that it fills.
    pub fn voxels(&self) -> f64 {
        let area = std::f64::consts::PI * self.of_x.along * self.of_x.reach[0];
        let height = 2.0 * self.reach[2] / SLICE_QUANTA as f64;
        (area + 4.0 * (self.reach[0] + self.reach[1]) + 1.0) * (height + 1.0)
    }

    /// First and last row of pixels that it meets.
    pub fn rows(&self) -> (i64, i64) {
        let reach = self.reach[1] + self.slack[1];
        (floor_index(self.centre[1] - reach), floor_index(self.centre[1] + reach))
    }

    /// Calls `give` with each pixel of row `j` that the ellipsoid meets, from left to right.
    pub fn for_each_pixel(&self, j: i64, mut give: impl FnMut(Piece)) {
        let [cx, cy, cz] = self.centre;
        let low = (j as f64 - cy - self.slack[1]).max(-self.reach[1]);
        let high = ((j + 1) as f64 - cy + self.slack[1]).min(self.reach[1]);
        if low > high {
            return;
        }
        let row = Row { of: self, low, high };
        let (left, right) = (-row.rightmost(-1.0), row.rightmost(1.0));
        let ((summit, top), (pit, depth)) = (row.summit(1.0), row.summit(-1.0));
        let (pit, bottom) = (-pit, -depth);
        for i in floor_index(cx + left - self.slack[0])..=floor_index(cx + right + self.slack[0]) {
            // Beyond the row's part of the shadow there is nothing: its outermost places stand for the slack.
            let inside = |x: f64| x.max(left).min(right);
            let (begin, end) = (inside(i as f64 - cx - self.slack[0]), inside((i + 1) as f64 - cx + self.slack[0]));
            let top = if begin <= summit && summit <= end { top } else { row.top(summit.max(begin).min(end), 1.0) };
            let bottom = if begin <= pit && pit <= end { bottom } else { -row.top(-pit.max(begin).min(end), -1.0) };
            let (low, high) = (bottom.min(top) - self.slack[2], top.max(bottom) + self.slack[2]);
            let (bottom, top) = (floor_index(cz + low), -floor_index(-(cz + high)));
            let steep = self.steep.or_else(|| ((top - bottom) as f64 > self.steep_run).then_some(true));
            give(Piece { i, bottom, top, steep });
        }
    }
}

/// The part of an ellipsoid over a row of pixels; offsets from its centre.
///
/// An ellipsoid is symmetric about its centre. So with `sign` −1, functions answer for the row mirrored at the centre, and
/// bottoms are mirrored tops.
struct Row<'a> {
    of: &'a GridEllipsoid,
    low: f64,
    high: f64,
}

impl Row<'_> {
    /// Ends of the row, mirrored if `sign` is −1.
    fn ends(&self, sign: f64) -> (f64, f64) {
        if sign > 0.0 { (self.low, self.high) } else { (-self.high, -self.low) }
    }

    /// Greatest offset along x of the shadow within the row.
    fn rightmost(&self, sign: f64) -> f64 {
        let (low, high) = self.ends(sign);
        let [x, y] = self.of.rightmost;
        if (low..=high).contains(&y) {
            return x;
        }
        let y = y.max(low).min(high);
        let section = &self.of.of_y;
        (section.drift[0] * y + section.shrink(y).unwrap_or(0.0) * section.reach[0]).min(x)
    }

    /// Offset along x and height of the highest place over the row.
    fn summit(&self, sign: f64) -> (f64, f64) {
        let (low, high) = self.ends(sign);
        let [x, y, z] = self.of.summit;
        if (low..=high).contains(&y) {
            return (x, z);
        }
        let y = y.max(low).min(high);
        let section = &self.of.of_y;
        let shrink = section.shrink(y).unwrap_or(0.0);
        let [across, up] = section.drift;
        (across * y + shrink * section.summit, (up * y + shrink * section.reach[1]).min(z))
    }

    /// Greatest height at this offset along x, within the row. Where the section misses the row, that on the row's edge
    /// nearest to it, without thickness.
    fn top(&self, x: f64, sign: f64) -> f64 {
        let (low, high) = self.ends(sign);
        let section = &self.of.of_x;
        let shrink = section.shrink(x).unwrap_or(0.0);
        let middle = section.drift[0] * x;
        let summit = middle + shrink * section.summit;
        if (low..=high).contains(&summit) {
            return section.drift[1] * x + shrink * section.reach[1];
        }
        let y = summit.max(low).min(high);
        let (reach, offset) = (shrink * section.reach[0], y - middle);
        let half = (reach - offset) * (reach + offset);
        self.of.rise[0] * x + self.of.rise[1] * y + self.of.thickness * half.max(0.0).sqrt()
    }
}
