//! Truth: the correct answers to collision queries, computed only from the surfaces.

use crate::geometry::{Aabb, Vec3};
use crate::scene::Scene;

/// Correct answers about a scene, whatever points were drawn from it. Heights and distances in metres.
pub trait Truth {
    /// Distance between the closed box `[min, max]` and the nearest surface; 0 if they meet, infinite without surfaces.
    /// Exact up to rounding (terrain: see [`crate::shape::Terrain::TOLERANCE_M`]).
    fn distance_to_box(&self, min: Vec3, max: Vec3) -> f64;

    /// Distance from a point to the nearest surface.
    fn distance_to_point(&self, p: Vec3) -> f64 {
        self.distance_to_box(p, p)
    }

    /// Highest surface at or below `z` over `(x, y)`: its height, and its slope [°, 0..90). Vertical surfaces do not
    /// count, but undersides do.
    fn floor_under(&self, x: f64, y: f64, z: f64) -> Option<(f64, f64)>;

    /// Lowest surface strictly above `z` over `(x, y)`: its height, and its slope `[°]`.
    fn ceiling_above(&self, x: f64, y: f64, z: f64) -> Option<(f64, f64)>;

    /// Slope of surface `surface` at (or next to) `(x, y)` `[°, 0..=90]`.
    ///
    /// # Panics
    /// If there is no such surface.
    fn slope_at(&self, surface: usize, x: f64, y: f64) -> f64;

    /// Index of the surface nearest to `p` and its distance; among equals any index may be returned.
    fn nearest_surface(&self, p: Vec3) -> Option<(usize, f64)>;

    /// Least distance along the ray, below `max`, at which it meets a surface, and the surface. `dir` has length 1.
    fn raycast(&self, origin: Vec3, dir: Vec3, max: f64) -> Option<(f64, usize)>;
}

impl Truth for Scene {
    fn distance_to_box(&self, min: Vec3, max: Vec3) -> f64 {
        self.nearest_to(&Aabb::new(min, max)).map_or(f64::INFINITY, |(_, d)| d)
    }

    fn floor_under(&self, x: f64, y: f64, z: f64) -> Option<(f64, f64)> {
        let over = |b: &Aabb| b.min[0] <= x && x <= b.max[0] && b.min[1] <= y && y <= b.max[1] && b.min[2] <= z;
        // Heights are negated, so that the highest is the least.
        let found = self.tree().least(
            f64::INFINITY,
            |b, _| over(b).then_some(-b.max[2].min(z)),
            |i, _| self.surfaces()[i].shape.height_at(x, y).filter(|h| *h <= z).map(|h| -h),
        );
        // A bound equal to the current best is skipped; it could only tie.
        found.map(|(i, h)| (-h, self.slope_at(i, x, y)))
    }

    fn ceiling_above(&self, x: f64, y: f64, z: f64) -> Option<(f64, f64)> {
        let over = |b: &Aabb| b.min[0] <= x && x <= b.max[0] && b.min[1] <= y && y <= b.max[1] && b.max[2] > z;
        let found = self.tree().least(
            f64::INFINITY,
            |b, _| over(b).then_some(b.min[2].max(z)),
            |i, _| self.surfaces()[i].shape.height_at(x, y).filter(|h| *h > z),
        );
        found.map(|(i, h)| (h, self.slope_at(i, x, y)))
    }

    fn slope_at(&self, surface: usize, x: f64, y: f64) -> f64 {
        self.surfaces()[surface].shape.slope_deg_at(x, y)
    }

    fn nearest_surface(&self, p: Vec3) -> Option<(usize, f64)> {
        self.nearest_to(&Aabb::new(p, p))
    }

    fn raycast(&self, origin: Vec3, dir: Vec3, max: f64) -> Option<(f64, usize)> {
        let found = self.tree().least(
            max,
            |b, best| b.clip(origin, dir, 0.0, best).map(|(t0, _)| t0),
            |i, best| self.surfaces()[i].shape.raycast(origin, dir, 0.0, best),
        );
        found.map(|(i, t)| (t, i))
    }
}

impl Scene {
    /// Whether a surface is nearer to a point than this (m).
    pub(crate) fn has_near(&self, p: Vec3, distance: f64) -> bool {
        let query = Aabb::new(p, p);
        let near = |b: &Aabb, best: f64| Some(b.distance_squared(&query).sqrt()).filter(|d| *d < best);
        self.tree().least(distance, near, |i, _| Some(self.surfaces()[i].shape.distance_to_box(&query))).is_some()
    }

    fn nearest_to(&self, query: &Aabb) -> Option<(usize, f64)> {
        self.tree().least(
            f64::INFINITY,
            |b, _| Some(b.distance_squared(query).sqrt()),
            |i, _| Some(self.surfaces()[i].shape.distance_to_box(query)),
        )
    }
}
