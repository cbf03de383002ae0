//! Upright cylinders: columns, posts. The lateral surface only; caps are [`super::Disc`]s.

use crate::geometry::{Aabb, Placement, Vec3, interval_gap};
use std::f64::consts::TAU;

/// Lateral surface of an upright cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    /// Axis in plan: x, y.
    pub center: [f64; 2],
    /// Radius `[m, > 0]`.
    pub radius: f64,
    /// Lower end.
    pub z_min: f64,
    /// Upper end `[> z_min]`.
    pub z_max: f64,
}

/// Minimum and maximum distance in plan from a point to the box's rectangle.
pub(super) fn plan_range(center: [f64; 2], query: &Aabb) -> (f64, f64) {
    let (mut near, mut far) = (0.0, 0.0);
    for (a, c) in center.into_iter().enumerate() {
        let gap = interval_gap(query.min[a], query.max[a], c, c);
        let reach = (c - query.min[a]).abs().max((query.max[a] - c).abs());
        near += gap * gap;
        far += reach * reach;
    }
    (near.sqrt(), far.sqrt())
}

impl Cylinder {
    pub(super) fn bounds(&self) -> Aabb {
        let ([x, y], r) = (self.center, self.radius);
        Aabb::new([x - r, y - r, self.z_min], [x + r, y + r, self.z_max])
    }

    pub(super) fn area(&self) -> f64 {
        TAU * self.radius * (self.z_max - self.z_min)
    }

    /// The surface is circle × interval and the box rectangle × interval, so the squared distances add up.
    pub(super) fn distance_to_box(&self, query: &Aabb) -> f64 {
        let (near, far) = plan_range(self.center, query);
        let plan = (near - self.radius).max(self.radius - far).max(0.0);
        let height = interval_gap(self.z_min, self.z_max, query.min[2], query.max[2]);
        (plan * plan + height * height).sqrt()
    }

    pub(super) fn height_at(&self, _x: f64, _y: f64) -> Option<f64> {
        None
    }

    pub(super) fn slope_deg_at(&self, _x: f64, _y: f64) -> f64 {
        90.0
    }

    pub(super) fn normal_at(&self, p: Vec3) -> Vec3 {
        let (dx, dy) = (p[0] - self.center[0], p[1] - self.center[1]);
        let len = (dx * dx + dy * dy).sqrt();
        if len > 0.0 { [dx / len, dy / len, 0.0] } else { [1.0, 0.0, 0.0] }
    }

    pub(super) fn raycast(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<f64> {
        let (ox, oy) = (origin[0] - self.center[0], origin[1] - self.center[1]);
        let a = dir[0] * dir[0] + dir[1] * dir[1];
        let b = ox * dir[0] + oy * dir[1];
        let c = ox * ox + oy * oy - self.radius * self.radius;
        let discriminant = b * b - a * c;
        if a == 0.0 || discriminant < 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        [(-b - root) / a, (-b + root) / a].into_iter().find(|&t| {
            let z = origin[2] + t * dir[2];
            t > t_min && t < t_max && z >= self.z_min && z <= self.z_max
        })
    }

    pub(super) fn chart_size(&self) -> [f64; 2] {
        [TAU * self.radius, self.z_max - self.z_min]
    }

    pub(super) fn chart(&self, u: f64, v: f64) -> Option<Vec3> {
        let (s, c) = libm::sincos(u / self.radius);
        Some([self.center[0] + self.radius * c, self.center[1] + self.radius * s, self.z_min + v])
    }

    pub(super) fn placed(&self, place: &Placement) -> Self {
        let p = place.apply([self.center[0], self.center[1], self.z_min]);
        Self {
            center: [p[0], p[1]],
            z_min: p[2],
            z_max: place.apply([self.center[0], self.center[1], self.z_max])[2],
            ..*self
        }
    }

    pub(super) fn triangles(&self, step_m: f64, emit: &mut dyn FnMut([Vec3; 3])) {
        let around = ((TAU * self.radius / step_m).ceil() as usize).clamp(12, 3600);
        let at = |i: usize, z: f64| {
            let (s, c) = libm::sincos(TAU * (i % around) as f64 / around as f64);
            [self.center[0] + self.radius * c, self.center[1] + self.radius * s, z]
        };
        for i in 0..around {
            let [a, b] = [at(i, self.z_min), at(i + 1, self.z_min)];
            let [c, d] = [at(i + 1, self.z_max), at(i, self.z_max)];
            emit([a, b, c]);
            emit([a, c, d]);
        }
    }
}
