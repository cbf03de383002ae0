//! Terrain: a height field given by a closed formula, a sum of sines over a rectangle.

use super::Polygon;
use crate::geometry::{Aabb, Placement, Vec3, add, scale, sin_cos_deg, sub, unit};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// One term `amplitude · sin(kx·x + ky·y + phase)`, in the terrain's own coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wave {
    /// Amplitude (m).
    pub amplitude: f64,
    /// Wave vector `[rad/m]`.
    pub k: [f64; 2],
    /// Phase `[rad]`.
    pub phase: f64,
}

/// A sum of sines over the rectangle `[-hx, hx] × [-hy, hy]` around its centre, rotated about the vertical.
#[derive(Debug, Clone, PartialEq)]
pub struct Terrain {
    /// Centre of the rectangle, and the height the sines are added to.
    pub center: Vec3,
    /// Half the edges of the rectangle (m).
    pub half: [f64; 2],
    /// Heading of the terrain's own x axis, anticlockwise from the world's `[°]`.
    pub heading_deg: f64,
    /// The terms.
    pub waves: Vec<Wave>,
}

impl Terrain {
    /// Error bound of a terrain's [`Shape::distance_to_box`](super::Shape::distance_to_box); smaller distances are
    /// returned as 0.
    pub const TOLERANCE_M: f64 = 1e-4;

    fn to_local(&self, x: f64, y: f64) -> [f64; 2] {
        let (s, c) = sin_cos_deg(self.heading_deg);
        let (dx, dy) = (x - self.center[0], y - self.center[1]);
        [dx * c + dy * s, dy * c - dx * s]
    }

    fn to_world(&self, u: f64, v: f64, height: f64) -> Vec3 {
        let (s, c) = sin_cos_deg(self.heading_deg);
        add(self.center, [u * c - v * s, u * s + v * c, height])
    }

    /// Height above the centre's z at the terrain's own coordinates.
    fn rise(&self, u: f64, v: f64) -> f64 {
        self.waves.iter().map(|w| w.amplitude * libm::sin(w.k[0] * u + w.k[1] * v + w.phase)).sum()
    }

    /// Derivatives of the rise in the terrain's own coordinates.
    fn gradient(&self, u: f64, v: f64) -> [f64; 2] {
        self.waves.iter().fold([0.0; 2], |g, w| {
            let d = w.amplitude * libm::cos(w.k[0] * u + w.k[1] * v + w.phase);
            [g[0] + d * w.k[0], g[1] + d * w.k[1]]
        })
    }

    /// Largest rise, slope and curvature (tangents and second derivatives) that the terms can add up to.
    fn limits(&self) -> (f64, f64, f64) {
        self.waves.iter().fold((0.0, 0.0, 0.0), |(rise, slope, bend), w| {
            let (a, k2) = (w.amplitude.abs(), w.k[0] * w.k[0] + w.k[1] * w.k[1]);
            (rise + a, slope + a * k2.sqrt(), bend + a * k2)
        })
    }

    pub(super) fn bounds(&self) -> Aabb {
        let (rise, _, _) = self.limits();
        let [hx, hy] = self.half;
        let corners = [(-hx, -hy), (hx, -hy), (hx, hy), (-hx, hy)];
        Aabb::around(corners.into_iter().flat_map(|(u, v)| [self.to_world(u, v, -rise), self.to_world(u, v, rise)]))
    }

    pub(super) fn area(&self) -> f64 {
        const N: usize = 128;
        let [hx, hy] = self.half;
        let mut sum = 0.0;
        for i in 0..N {
            for j in 0..N {
                let at = |k: usize, h: f64| ((k as f64 + 0.5) / N as f64 * 2.0 - 1.0) * h;
                let [gx, gy] = self.gradient(at(i, hx), at(j, hy));
                sum += (1.0 + gx * gx + gy * gy).sqrt();
            }
        }
        sum / (N * N) as f64 * 4.0 * hx * hy
    }

    pub(super) fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let [u, v] = self.to_local(x, y);
        (u.abs() <= self.half[0] && v.abs() <= self.half[1]).then(|| self.center[2] + self.rise(u, v))
    }

    pub(super) fn slope_deg_at(&self, x: f64, y: f64) -> f64 {
        let [u, v] = self.to_local(x, y);
        let [gx, gy] = self.gradient(u, v);
        libm::atan((gx * gx + gy * gy).sqrt()).to_degrees()
    }

    pub(super) fn normal_at(&self, p: Vec3) -> Vec3 {
        let [u, v] = self.to_local(p[0], p[1]);
        let [gx, gy] = self.gradient(u, v);
        let (s, c) = sin_cos_deg(self.heading_deg);
        unit([-(gx * c - gy * s), -(gx * s + gy * c), 1.0])
    }

    /// Takes steps no longer than the gap allows at the largest slope, then bisects the step that crossed.
    pub(super) fn raycast(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<f64> {
        let (mut t, end) = self.bounds().clip(origin, dir, t_min, t_max)?;
        let (_, slope, _) = self.limits();
        let closing = slope * (dir[0] * dir[0] + dir[1] * dir[1]).sqrt() + dir[2].abs();
        let gap_at = |t: f64| {
            let p = add(origin, scale(dir, t));
            let [u, v] = self.to_local(p[0], p[1]);
            p[2] - self.center[2] - self.rise(u, v)
        };
        let side = gap_at(t);
        let mut last = t;
        while t <= end {
            let gap = gap_at(t);
            if gap * side <= 0.0 && t > last {
                let (mut a, mut b) = (last, t);
                for _ in 0..50 {
                    let middle = 0.5 * (a + b);
                    if gap_at(middle) * side <= 0.0 { b = middle } else { a = middle }
                }
                let p = add(origin, scale(dir, b));
                return (b > t_min && b < t_max && self.height_at(p[0], p[1]).is_some()).then_some(b);
            }
            last = t;
            t += (gap.abs() / closing).max(1e-3);
        }
        None
    }

    pub(super) fn chart_size(&self) -> [f64; 2] {
        [2.0 * self.half[0], 2.0 * self.half[1]]
    }

    pub(super) fn chart(&self, u: f64, v: f64) -> Option<Vec3> {
        let (u, v) = (u - self.half[0], v - self.half[1]);
        Some(self.to_world(u, v, self.rise(u, v)))
    }

    pub(super) fn keep_share(&self, p: Vec3) -> f64 {
        let [u, v] = self.to_local(p[0], p[1]);
        let [gx, gy] = self.gradient(u, v);
        let (_, slope, _) = self.limits();
        ((1.0 + gx * gx + gy * gy) / (1.0 + slope * slope)).sqrt()
    }

    pub(super) fn placed(&self, place: &Placement) -> Self {
        Self {
            center: place.apply(self.center),
            heading_deg: self.heading_deg + place.rotate_deg,
            half: self.half,
            waves: self.waves.clone(),
        }
    }

    pub(super) fn triangles(&self, step_m: f64, emit: &mut dyn FnMut([Vec3; 3])) {
        let [w, h] = self.chart_size();
        let (nu, nv) = ((w / step_m).ceil().max(1.0) as usize, (h / step_m).ceil().max(1.0) as usize);
        let at = |i: usize, j: usize| {
            let (u, v) = (w * i as f64 / nu as f64 - self.half[0], h * j as f64 / nv as f64 - self.half[1]);
            self.to_world(u, v, self.rise(u, v))
        };
        for i in 0..nu {
            for j in 0..nv {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                emit([a, b, c]);
                emit([a, c, d]);
            }
        }
    }

    /// Branch and bound over the plan. A cell's surface stays within `slope·ρ` of the height at its middle, and within
    /// `bend·ρ²/2` of the tangent plane there; the exact distance to that part of the plane, minus and plus this,
    /// bounds the cell's distance. Ends when no cell can be nearer than the best by [`Self::TOLERANCE_M`].
    pub(super) fn distance_to_box(&self, query: &Aabb) -> f64 {
        let mut search =
            Search { terrain: self, query, limits: self.limits(), best: f64::INFINITY, open: BinaryHeap::new() };
        // The nearest place is most likely the one next to the box, and a good first bound saves most cells.
        let [x, y, _] = query.center();
        let at = self.to_local(x, y);
        let [u, v] = [0, 1].map(|a| at[a].clamp(-self.half[a], self.half[a]));
        search.best = query.point_distance_squared(self.to_world(u, v, self.rise(u, v))).sqrt();
        search.consider([0.0; 2], self.half);
        while let Some(cell) = search.open.pop() {
            if search.best == 0.0 || cell.low + Self::TOLERANCE_M >= search.best {
                break;
            }
            let wide = if cell.half[0] >= cell.half[1] { 0 } else { 1 };
            let mut half = cell.half;
            half[wide] *= 0.5;
            for side in [-1.0, 1.0] {
                let mut mid = cell.mid;
                mid[wide] += side * half[wide];
                search.consider(mid, half);
            }
        }
        if search.best <= Self::TOLERANCE_M { 0.0 } else { search.best }
    }
}

/// State of one search for the nearest place.
struct Search<'a> {
    terrain: &'a Terrain,
    query: &'a Aabb,
    /// Largest rise, slope and bend.
    limits: (f64, f64, f64),
    best: f64,
    open: BinaryHeap<Cell>,
}

impl Search<'_> {
    /// Bounds the cell `mid ± half` and keeps it if it can hold the nearest place.
    fn consider(&mut self, mid: [f64; 2], half: [f64; 2]) {
        let (t, (_, slope, bend)) = (self.terrain, self.limits);
        let point = t.to_world(mid[0], mid[1], t.rise(mid[0], mid[1]));
        self.best = self.best.min(self.query.point_distance_squared(point).sqrt());
        let rho = (half[0] * half[0] + half[1] * half[1]).sqrt();
        let swing = slope * rho;
        let around = Aabb::new(
            [point[0] - rho, point[1] - rho, point[2] - swing],
            [point[0] + rho, point[1] + rho, point[2] + swing],
        );
        let mut low = around.distance_squared(self.query).sqrt();
        let off_plane = 0.5 * bend * rho * rho;
        if low + Terrain::TOLERANCE_M < self.best && off_plane < swing {
            let [gx, gy] = t.gradient(mid[0], mid[1]);
            let (s, c) = sin_cos_deg(t.heading_deg);
            let edges = [[c, s, gx], [-s, c, gy]].map(|d| scale(d, 2.0));
            let [a, b] = [scale(edges[0], half[0]), scale(edges[1], half[1])];
            let corner = sub(point, scale(add(a, b), 0.5));
            let plane = Polygon::parallelogram(corner, a, b).distance_to_box(self.query);
            low = low.max(plane - off_plane);
            self.best = self.best.min(plane + off_plane);
        }
        if low + Terrain::TOLERANCE_M < self.best {
            self.open.push(Cell { low, mid, half });
        }
    }
}

/// A cell of the plan with a lower bound of its distance; the heap returns the least first.
struct Cell {
    low: f64,
    mid: [f64; 2],
    half: [f64; 2],
}

impl Ord for Cell {
    fn cmp(&self, other: &Self) -> Ordering {
        other.low.total_cmp(&self.low)
    }
}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cell {}
