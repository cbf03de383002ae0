//! Horizontal discs: caps of columns and posts, round tables.

use super::cylinder::plan_range;
use crate::geometry::{Aabb, Placement, Vec3, interval_gap};
use std::f64::consts::{PI, TAU};

/// A horizontal disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    /// Centre.
    pub center: Vec3,
    /// Radius `[m, > 0]`.
    pub radius: f64,
}

impl Disc {
    pub(super) fn bounds(&self) -> Aabb {
        let ([x, y, z], r) = (self.center, self.radius);
        Aabb::new([x - r, y - r, z], [x + r, y + r, z])
    }

    pub(super) fn area(&self) -> f64 {
        PI * self.radius * self.radius
    }

    /// Disc × height against rectangle × interval: the squared distances add up.
    pub(super) fn distance_to_box(&self, query: &Aabb) -> f64 {
        let (near, _) = plan_range([self.center[0], self.center[1]], query);
        let plan = (near - self.radius).max(0.0);
        let height = interval_gap(self.center[2], self.center[2], query.min[2], query.max[2]);
        (plan * plan + height * height).sqrt()
    }

    pub(super) fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        let (dx, dy) = (x - self.center[0], y - self.center[1]);
        (dx * dx + dy * dy <= self.radius * self.radius).then_some(self.center[2])
    }

    pub(super) fn slope_deg_at(&self, _x: f64, _y: f64) -> f64 {
        0.0
    }

    pub(super) fn normal_at(&self, _p: Vec3) -> Vec3 {
        [0.0, 0.0, 1.0]
    }

    pub(super) fn raycast(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<f64> {
        if dir[2] == 0.0 {
            return None;
        }
        let t = (self.center[2] - origin[2]) / dir[2];
        (t > t_min && t < t_max && self.height_at(origin[0] + t * dir[0], origin[1] + t * dir[1]).is_some())
            .then_some(t)
    }

    pub(super) fn chart_size(&self) -> [f64; 2] {
        [2.0 * self.radius; 2]
    }

    pub(super) fn chart(&self, u: f64, v: f64) -> Option<Vec3> {
        let (x, y) = (self.center[0] - self.radius + u, self.center[1] - self.radius + v);
        self.height_at(x, y).map(|z| [x, y, z])
    }

    pub(super) fn placed(&self, place: &Placement) -> Self {
        Self { center: place.apply(self.center), ..*self }
    }

    pub(super) fn triangles(&self, step_m: f64, emit: &mut dyn FnMut([Vec3; 3])) {
        let around = ((TAU * self.radius / step_m).ceil() as usize).clamp(12, 3600);
        let at = |i: usize| {
            let (s, c) = libm::sincos(TAU * (i % around) as f64 / around as f64);
            [self.center[0] + self.radius * c, self.center[1] + self.radius * s, self.center[2]]
        };
        for i in 0..around {
            emit([self.center, at(i), at(i + 1)]);
        }
    }
}
