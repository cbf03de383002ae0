//! Triangles to pixels: which pixels a triangle touches, and its height interval in each.
//!
//! In: triangles in metres. Out: the lowest and highest quantum of the closed triangle in each pixel that it touches.
//! Memory: none beyond the stack.
//!
//! *Method.* A triangle is clipped to each row of pixels, then the row's polygon to each pixel. The result is convex
//! and connected, so its heights form an interval bounded by its corners. Cut at slice boundaries, that interval gives
//! the exact bottom and top within each slice.
//!
//! *Rounding.* Let `u = 2⁻⁵³` and `M` the greatest coordinate of the triangle along an axis, in pixels or quanta.
//! Converting corners to grid coordinates rounds once, as for points; so any point of the triangle, converted by the
//! frame's monotone functions, lies within `2·u·M` of the triangle between the rounded corners. Clipping to a row moves
//! corners by at most `22·u·M`, clipping to a pixel moves heights by at most `14·u·M`. Rows, pixels and heights grow
//! outwards by `128·u·M` (`SLACK`), which exceeds the sum, and are then cut to the bounds of the corners, which are
//! exact. So guarantee G1 holds for every point of the triangle, not only for its corners. The growth stays within
//! `256·u·M` of the triangle (10⁻⁹ pixels at a coordinate of 30,000 pixels), and vertical or horizontal triangles
//! aligned with the grid's axes do not grow at all.

use crate::frame::{Frame, MAX_INDEX, SLICE_QUANTA, floor_index};
use crate::plan::rise_of;

/// Corners of a triangle (m).
pub type Triangle = [[f64; 3]; 3];

/// Growth of rows, pixels and heights, in units of the greatest coordinate (see the module documentation).
const SLACK: f64 = 1.0 / (1u64 << 46) as f64;
/// A slope is steep if the square of its tangent exceeds the limit's by more than this share: the corners of a ramp
/// built at the limit are rounded, often to 32 bits (0.003 degrees at 45).
const SLOPE_SLACK: f64 = 1e-4;
/// Most corners of a triangle clipped to a strip.
const MOST_CORNERS: usize = 5;

/// Rasterizes triangles to the grid of one archive.
#[derive(Debug, Clone, Copy)]
pub struct Raster {
    frame: Frame,
    /// Square of the tangent above which a triangle is steep.
    steep_squared: f64,
}

/// A triangle on the grid: corners in pixels, pixels and quanta.
#[derive(Debug, Clone, Copy)]
pub struct GridTriangle {
    corners: [[f64; 3]; 3],
    min: [f64; 3],
    max: [f64; 3],
    slack: [f64; 3],
    steep: bool,
    /// True if the sorted corners have the opposite winding of the given ones.
    turned: bool,
}

/// Sorts the corners, so that results depend neither on the winding nor on the first corner.
fn sorted(triangle: &Triangle) -> Triangle {
    let mut sorted = triangle.map(|corner| corner.map(|v| v + 0.0));
    sorted.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    sorted
}

/// Returns whether `sorted` is an odd permutation of `triangle`, whose corners differ.
fn is_odd(triangle: &Triangle, sorted: &Triangle) -> bool {
    let place = |corner: usize| triangle.iter().position(|other| *other == sorted[corner]).unwrap_or(0);
    let places = [place(0), place(1), place(2)];
    !matches!(places, [0, 1, 2] | [1, 2, 0] | [2, 0, 1])
}

fn normal_of([a, b, c]: &Triangle) -> [f64; 3] {
    let (p, q) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
}

/// Returns whether the triangle has an area: its normal in `f64` is not zero.
pub fn has_area(triangle: &Triangle) -> bool {
    normal_of(&sorted(triangle)) != [0.0; 3]
}

/// Area (m²) and longest edge (m) of a triangle.
pub fn extent_of(triangle: &Triangle) -> (f64, f64) {
    let [a, b, c] = triangle;
    let length = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let edge = |p: &[f64; 3], q: &[f64; 3]| length([0, 1, 2].map(|k| q[k] - p[k]));
    (length(normal_of(triangle)) / 2.0, edge(a, b).max(edge(b, c)).max(edge(c, a)))
}

impl Raster {
    /// Creates a raster on `frame`; triangles steeper than `max_slope_deg` (degrees, 0..=90) are obstacles.
    pub fn new(frame: Frame, max_slope_deg: f64) -> Self {
        let tangent = rise_of(max_slope_deg);
        Self { frame, steep_squared: tangent * tangent * (1.0 + SLOPE_SLACK) }
    }

    /// Puts the triangle on the grid; `None` if it has no area (its normal is zero in `f64`) or is not finite.
    pub fn place(&self, triangle: &Triangle) -> Option<GridTriangle> {
        let sorted = sorted(triangle);
        let normal = normal_of(&sorted);
        if normal == [0.0; 3] || !sorted.as_flattened().iter().all(|v| v.is_finite()) {
            return None;
        }
        let (across, up) = (normal[0] * normal[0] + normal[1] * normal[1], normal[2] * normal[2]);
        let frame = &self.frame;
        let corners = sorted.map(|[x, y, z]| [frame.pixels(x), frame.pixels(y), frame.quanta(z)]);
        let fold = |pick: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|axis| pick(pick(corners[0][axis], corners[1][axis]), corners[2][axis]))
        };
        let (min, max) = (fold(f64::min), fold(f64::max));
        let slack = [0, 1, 2].map(|axis| SLACK * min[axis].abs().max(max[axis].abs()));
        let steep = across > self.steep_squared * up;
        Some(GridTriangle { corners, min, max, slack, steep, turned: is_odd(triangle, &sorted) })
    }
}

impl GridTriangle {
    /// Returns whether the triangle is steeper than the limit.
    pub fn is_steep(&self) -> bool {
        self.steep
    }

    /// Returns whether all its pixels and slices have an index on the grid.
    pub fn is_on_grid(&self) -> bool {
        let near = |v: f64, unit: i64| v.abs() < ((MAX_INDEX - 1) * unit) as f64;
        let ends = self.min.iter().zip(&self.max).zip([1, 1, SLICE_QUANTA]);
        ends.into_iter().all(|((&low, &high), unit)| near(low, unit) && near(high, unit))
    }

    /// Calls `give` with each pixel whose vertical centre line crosses the triangle, the height of the crossing
    /// (quanta), and the change of the winding number along the line from below the triangle to above it: 1 or -1.
    ///
    /// All triangles that share an edge compute its position alike, and pixels are half open. So a line through an edge
    /// crosses one, both or neither of its triangles, as if it passed beside the edge, and the changes along a line
    /// through a closed mesh add up to zero.
    pub fn for_each_crossing(&self, mut give: impl FnMut((i64, i64), f64, i32)) {
        let [a, b, c] = self.corners;
        // Edges in sorted order, so that neighbours compute the same values; the last runs against the winding.
        let edges = [(a, b, false), (b, c, false), (a, c, true)];
        let (p, q) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let area = p[0] * q[1] - p[1] * q[0];
        for j in self.rows().0..=self.rows().1 {
            let y = j as f64 + 0.5;
            // Where one edge crosses the row's centre line upwards in y, and where another crosses it downwards.
            let (mut up, mut down) = (None, None);
            for (a, b, against) in edges {
                if (a[1] <= y) != (b[1] <= y) {
                    let place = a[0] + (b[0] - a[0]) * ((y - a[1]) / (b[1] - a[1]));
                    *(if (a[1] <= y) != against { &mut up } else { &mut down }) = Some(place);
                }
            }
            let (Some(up), Some(down)) = (up, down) else { continue };
            let (left, right) = (up.min(down), up.max(down));
            let change = if (up > down) != self.turned { -1 } else { 1 };
            // Pixel centres in `left..right`.
            for i in floor_index(left - 0.5)..=floor_index(right + 0.5) {
                let x = i as f64 + 0.5;
                if left <= x && x < right {
                    let (u, v) = ((x - a[0]) * q[1] - (y - a[1]) * q[0], (y - a[1]) * p[0] - (x - a[0]) * p[1]);
                    let height = a[2] + (u * p[2] + v * q[2]) / area;
                    // Only a vertical triangle has no finite height here, and then any of its heights will do.
                    let height = if height.is_finite() { height } else { a[2] };
                    give((i, j), height.clamp(self.min[2], self.max[2]), change);
                }
            }
        }
    }

    /// Area of its projection to the ground plan (pixels), and the greater of its extents in x and y (pixels).
    pub fn shadow(&self) -> (f64, f64) {
        let [a, b, c] = self.corners;
        let area = ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs() / 2.0;
        (area, (self.max[0] - self.min[0]).max(self.max[1] - self.min[1]))
    }

    /// Lowest and highest pixel, pixel and quantum of its corners.
    pub fn bounds(&self) -> ([i64; 3], [i64; 3]) {
        (self.min.map(floor_index), self.max.map(|v| -floor_index(-v)))
    }

    /// First and last row of pixels that it touches.
    pub fn rows(&self) -> (i64, i64) {
        (floor_index(self.min[1]), floor_index(self.max[1]))
    }

    /// Calls `give` with each pixel of row `j` that the triangle touches, and its lowest and highest quantum there:
    /// `(i, bottom, top)`.
    pub fn for_each_pixel(&self, j: i64, mut give: impl FnMut(i64, i64, i64)) {
        let edges = Edges::new(self.clipped_to_row(j));
        let Some((left, right)) = edges.range else { return };
        let first = floor_index((left - self.slack[0]).max(self.min[0]));
        let last = floor_index((right + self.slack[0]).min(self.max[0]));
        for i in first..=last {
            let window = (i as f64 - self.slack[0], (i + 1) as f64 + self.slack[0]);
            if let Some((low, high)) = edges.heights_between(window) {
                let low = (low - self.slack[2]).max(self.min[2]).min(self.max[2]);
                let high = (high + self.slack[2]).min(self.max[2]).max(self.min[2]);
                give(i, floor_index(low), -floor_index(-high));
            }
        }
    }

    fn clipped_to_row(&self, j: i64) -> Polygon {
        let (low, high) = (j as f64 - self.slack[1], (j + 1) as f64 + self.slack[1]);
        let mut whole = Polygon::default();
        self.corners.iter().for_each(|&corner| whole.push(corner));
        if low <= self.min[1] && self.max[1] <= high {
            return whole;
        }
        whole.clipped(|y| y >= low, low).clipped(|y| y <= high, high)
    }
}

/// A convex polygon in space.
#[derive(Debug, Clone, Copy, Default)]
struct Polygon {
    corners: [[f64; 3]; MOST_CORNERS],
    count: usize,
}

impl Polygon {
    fn push(&mut self, corner: [f64; 3]) {
        // A convex polygon gains at most one corner per cut, so this never drops one.
        if let Some(place) = self.corners.get_mut(self.count) {
            *place = corner;
            self.count += 1;
        }
    }

    /// Clips to the part where `inside` holds for y, which ends at `border` (Sutherland and Hodgman, 1974).
    fn clipped(&self, inside: impl Fn(f64) -> bool, border: f64) -> Self {
        let mut left = Self::default();
        for at in 0..self.count {
            let (a, b) = (self.corners[at], self.corners[(at + 1) % self.count]);
            if inside(a[1]) {
                left.push(a);
            }
            if inside(a[1]) != inside(b[1]) {
                let share = (border - a[1]) / (b[1] - a[1]);
                left.push([a[0] + (b[0] - a[0]) * share, border, a[2] + (b[2] - a[2]) * share]);
            }
        }
        left
    }
}

/// An edge of a row's polygon, left end first: position along the row, and height.
#[derive(Debug, Clone, Copy, Default)]
struct Edge {
    left: (f64, f64),
    right: (f64, f64),
    rise: f64,
}

/// The edges of a row's polygon.
#[derive(Debug)]
struct Edges {
    edges: [Edge; MOST_CORNERS],
    count: usize,
    range: Option<(f64, f64)>,
}

impl Edges {
    fn new(polygon: Polygon) -> Self {
        let mut edges = [Edge::default(); MOST_CORNERS];
        let mut range: Option<(f64, f64)> = None;
        for (at, edge) in edges.iter_mut().enumerate().take(polygon.count) {
            let [a, b] = [at, (at + 1) % polygon.count].map(|at| (polygon.corners[at][0], polygon.corners[at][2]));
            let (left, right) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            *edge = Edge { left, right, rise: (right.1 - left.1) / (right.0 - left.0) };
            range = Some(range.map_or((left.0, right.0), |(low, high)| (low.min(left.0), high.max(right.0))));
        }
        Self { edges, count: polygon.count, range }
    }

    /// Least and greatest height between two positions along the row; `None` if the polygon has no part there.
    #[inline]
    fn heights_between(&self, (left, right): (f64, f64)) -> Option<(f64, f64)> {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for edge in &self.edges[..self.count] {
            if edge.right.0 < left || edge.left.0 > right {
                continue;
            }
            // An edge without width along the row is cut at neither end, so its infinite rise is never used.
            let at = |place: f64| edge.left.1 + (place - edge.left.0) * edge.rise;
            let begin = if left > edge.left.0 { at(left) } else { edge.left.1 };
            let end = if right < edge.right.0 { at(right) } else { edge.right.1 };
            low = low.min(begin.min(end));
            high = high.max(begin.max(end));
        }
        (low <= high).then_some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_has_pixels_in_the_rows_that_it_touches_and_in_no_others() {
        let raster = Raster::new(Frame::new(1.0, 1.0).unwrap(), 45.0);
        let triangle = raster.place(&[[0.2, 0.2, 0.0], [3.1, 0.4, 1.0], [1.0, 2.5, 2.0]]).unwrap();
        let rows = (-3..6).filter(|&j| {
            let mut count = 0;
            triangle.for_each_pixel(j, |_, _, _| count += 1);
            count > 0
        });
        assert_eq!((triangle.rows(), rows.collect::<Vec<_>>()), ((0, 2), vec![0, 1, 2]));
    }
}
