//! Planar convex polygons in any orientation: floors, walls, ramps, treads, facets of arches.

use crate::geometry::{Aabb, Placement, Vec3, add, cross, dot, length, scale, sub, unit};

/// A planar convex polygon. The order of its vertices decides the side of the normal (anticlockwise seen from there).
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    vertices: Vec<Vec3>,
    normal: Vec3,
    /// Unit vector along the first edge, and the one perpendicular to it in the plane.
    axes: [Vec3; 2],
    /// Corner of the chart's rectangle in those axes, and its size.
    chart_min: [f64; 2],
    chart_size: [f64; 2],
    area: f64,
    bounds: Aabb,
}

impl Polygon {
    /// The polygon of at least three `vertices`. The caller ensures that they are in one plane, convex and distinct.
    ///
    /// # Panics
    /// With fewer than three vertices or no area.
    pub fn new(vertices: Vec<Vec3>) -> Self {
        assert!(vertices.len() >= 3, "a polygon has at least three vertices");
        let origin = vertices[0];
        let mut doubled = [0.0; 3];
        for pair in vertices[1..].windows(2) {
            doubled = add(doubled, cross(sub(pair[0], origin), sub(pair[1], origin)));
        }
        let area = length(doubled) / 2.0;
        assert!(area > 0.0, "a polygon has an area");
        let normal = unit(doubled);
        let along = unit(sub(vertices[1], origin));
        let axes = [along, cross(normal, along)];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for vertex in &vertices {
            for axis in 0..2 {
                let value = dot(sub(*vertex, origin), axes[axis]);
                low[axis] = low[axis].min(value);
                high[axis] = high[axis].max(value);
            }
        }
        let bounds = Aabb::around(vertices.iter().copied());
        Self { vertices, normal, axes, chart_min: low, chart_size: [high[0] - low[0], high[1] - low[1]], area, bounds }
    }

    /// The parallelogram with corner `origin` and edges `a` and `b`; its normal is `a × b`.
    pub fn parallelogram(origin: Vec3, a: Vec3, b: Vec3) -> Self {
        Self::new(vec![origin, add(origin, a), add(add(origin, a), b), add(origin, b)])
    }

    /// Vertices in order.
    pub fn vertices(&self) -> &[Vec3] {
        &self.vertices
    }

    /// Unit normal.
    pub fn normal(&self) -> Vec3 {
        self.normal
    }

    pub(super) fn bounds(&self) -> Aabb {
        self.bounds
    }

    pub(super) fn area(&self) -> f64 {
        self.area
    }

    pub(super) fn slope_deg_at(&self, _x: f64, _y: f64) -> f64 {
        let run = (self.normal[0] * self.normal[0] + self.normal[1] * self.normal[1]).sqrt();
        libm::atan2(run, self.normal[2].abs()).to_degrees()
    }

    pub(super) fn normal_at(&self, _p: Vec3) -> Vec3 {
        self.normal
    }

    fn edges(&self) -> impl Iterator<Item = (Vec3, Vec3)> + '_ {
        (0..self.vertices.len()).map(|i| (self.vertices[i], self.vertices[(i + 1) % self.vertices.len()]))
    }

    pub(super) fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let nz = self.normal[2];
        let inside_box =
            x >= self.bounds.min[0] && x <= self.bounds.max[0] && y >= self.bounds.min[1] && y <= self.bounds.max[1];
        if !inside_box || nz.abs() < 1e-9 {
            return None;
        }
        let inside = self.edges().all(|(a, b)| {
            let turn = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
            if nz > 0.0 { turn >= 0.0 } else { turn <= 0.0 }
        });
        if !inside {
            return None;
        }
        let from = self.vertices[0];
        let z = from[2] - (self.normal[0] * (x - from[0]) + self.normal[1] * (y - from[1])) / nz;
        Some(z.clamp(self.bounds.min[2], self.bounds.max[2]))
    }

    /// Returns whether a point of the plane is inside or on the border.
    fn holds(&self, p: Vec3) -> bool {
        self.edges().all(|(a, b)| dot(cross(sub(b, a), sub(p, a)), self.normal) >= 0.0)
    }

    pub(super) fn raycast(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<f64> {
        let towards = dot(dir, self.normal);
        if towards == 0.0 {
            return None;
        }
        let t = dot(sub(self.vertices[0], origin), self.normal) / towards;
        (t > t_min && t < t_max && self.holds(add(origin, scale(dir, t)))).then_some(t)
    }

    pub(super) fn chart_size(&self) -> [f64; 2] {
        self.chart_size
    }

    pub(super) fn chart(&self, u: f64, v: f64) -> Option<Vec3> {
        let [along, across] = self.axes;
        let (u, v) = (self.chart_min[0] + u, self.chart_min[1] + v);
        let p = add(self.vertices[0], add(scale(along, u), scale(across, v)));
        // A rectangle fills its chart; rounding must not drop its border.
        (self.area >= self.chart_size[0] * self.chart_size[1] * (1.0 - 1e-12) || self.holds(p)).then_some(p)
    }

    pub(super) fn placed(&self, place: &Placement) -> Self {
        Self::new(self.vertices.iter().map(|v| place.apply(*v)).collect())
    }

    pub(super) fn triangles(&self, _step_m: f64, emit: &mut dyn FnMut([Vec3; 3])) {
        for pair in self.vertices[1..].windows(2) {
            emit([self.vertices[0], pair[0], pair[1]]);
        }
    }

    /// Exact up to rounding: two convex bodies either meet, or their distance is that of a vertex and a face or of two
    /// edges. They are apart if one of the separating axes (box faces, polygon plane, products of edges) separates
    /// them.
    pub(super) fn distance_to_box(&self, query: &Aabb) -> f64 {
        // Coordinates relative to the box keep the numbers small far from the origin.
        let center = query.center();
        let half: Vec3 = std::array::from_fn(|a| (query.max[a] - query.min[a]) / 2.0);
        if self.bounds.distance_squared(query) == 0.0 && !self.parted(center, half) {
            return 0.0;
        }
        let mut best = f64::INFINITY;
        for vertex in &self.vertices {
            best = best.min(query.point_distance_squared(*vertex));
        }
        let corners = query.corners();
        for corner in corners {
            let height = dot(sub(corner, self.vertices[0]), self.normal);
            if height * height < best && self.holds(sub(corner, scale(self.normal, height))) {
                best = height * height;
            }
        }
        for (a, b) in self.edges() {
            for (i, from) in corners.iter().enumerate() {
                for axis in 0..3 {
                    if i >> axis & 1 == 0 {
                        best = best.min(segment_distance_squared(a, b, *from, corners[i | 1 << axis]));
                    }
                }
            }
        }
        best.sqrt()
    }

    /// Returns whether an axis strictly separates the polygon from the box.
    fn parted(&self, center: Vec3, half: Vec3) -> bool {
        let parts = |axis: Vec3| {
            let reach: f64 = (0..3).map(|a| (axis[a] * half[a]).abs()).sum();
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for vertex in &self.vertices {
                let value = dot(sub(*vertex, center), axis);
                low = low.min(value);
                high = high.max(value);
            }
            // The product of nearly parallel edges is not an axis; 1e-13 m is far below any coordinate's resolution.
            low > reach + 1e-13 || high < -reach - 1e-13
        };
        if parts(self.normal) {
            return true;
        }
        self.edges().any(|(a, b)| {
            let edge = unit(sub(b, a));
            [[0.0, -edge[2], edge[1]], [edge[2], 0.0, -edge[0]], [-edge[1], edge[0], 0.0]]
                .into_iter()
                .any(|axis| dot(axis, axis) > 1e-18 && parts(axis))
        })
    }
}

/// Squared distance of two closed segments (after Ericson, Real-Time Collision Detection, 5.1.9).
fn segment_distance_squared(p1: Vec3, q1: Vec3, p2: Vec3, q2: Vec3) -> f64 {
    let (d1, d2, r) = (sub(q1, p1), sub(q2, p2), sub(p1, p2));
    let (a, e, f) = (dot(d1, d1), dot(d2, d2), dot(d2, r));
    let clamp01 = |v: f64| v.clamp(0.0, 1.0);
    let (s, t);
    if a == 0.0 && e == 0.0 {
        return dot(r, r);
    } else if a == 0.0 {
        (s, t) = (0.0, clamp01(f / e));
    } else {
        let c = dot(d1, r);
        if e == 0.0 {
            (s, t) = (clamp01(-c / a), 0.0);
        } else {
            let b = dot(d1, d2);
            let denominator = a * e - b * b;
            let first = if denominator > 1e-15 * a * e { clamp01((b * f - c * e) / denominator) } else { 0.0 };
            let along = (b * first + f) / e;
            (s, t) = if along < 0.0 {
                (clamp01(-c / a), 0.0)
            } else if along > 1.0 {
                (clamp01((b - c) / a), 1.0)
            } else {
                (first, along)
            };
        }
    }
    let gap = sub(add(p1, scale(d1, s)), add(p2, scale(d2, t)));
    dot(gap, gap)
}
