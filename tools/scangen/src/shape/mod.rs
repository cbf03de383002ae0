//! Closed-form surfaces. Each knows its exact distance to a closed box, its height at a place, where a ray meets it,
//! and how to draw points evenly from it.
//!
//! | shape | distance to a box |
//! |---|---|
//! | [`Polygon`] planar, convex, any plane | exact: separating axes, else the closest vertex, corner or edge pair |
//! | [`Cylinder`] vertical, lateral surface only | exact: circle against rectangle in plan, interval in height |
//! | [`Disc`] horizontal | exact, like a cylinder |
//! | [`Terrain`] height field, a sum of sines | numeric, error at most [`Terrain::TOLERANCE_M`] |
//!
//! Boxes, ramps, stairs, walls and arches consist of polygons; an arch *is* its facets, and so is its truth.

mod cylinder;
mod disc;
mod polygon;
mod terrain;

pub use cylinder::Cylinder;
pub use disc::Disc;
pub use polygon::Polygon;
pub use terrain::{Terrain, Wave};

use crate::geometry::{Aabb, Placement, Vec3};

/// A surface of any kind.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Planar convex polygon.
    Polygon(Polygon),
    /// Lateral surface of an upright cylinder.
    Cylinder(Cylinder),
    /// Horizontal disc.
    Disc(Disc),
    /// Height field over a rectangle.
    Terrain(Terrain),
}

macro_rules! each {
    ($self:expr, $shape:ident => $body:expr) => {
        match $self {
            Shape::Polygon($shape) => $body,
            Shape::Cylinder($shape) => $body,
            Shape::Disc($shape) => $body,
            Shape::Terrain($shape) => $body,
        }
    };
}

impl Shape {
    /// Smallest box around the surface (a terrain's is bounded by its amplitudes, not tight).
    pub fn bounds(&self) -> Aabb {
        each!(self, s => s.bounds())
    }

    /// Area `[m²]`; exact except for terrain, where a fixed midpoint rule approximates it.
    pub fn area(&self) -> f64 {
        each!(self, s => s.area())
    }

    /// Distance between the closed box and the surface (m); 0 if they meet.
    pub fn distance_to_box(&self, query: &Aabb) -> f64 {
        each!(self, s => s.distance_to_box(query))
    }

    /// Height of the surface over `(x, y)`; `None` outside it and for a vertical surface.
    pub fn height_at(&self, x: f64, y: f64) -> Option<f64> {
        each!(self, s => s.height_at(x, y))
    }

    /// Angle between the surface at (or next to) `(x, y)` and the horizontal `[°, 0..=90]`.
    pub fn slope_deg_at(&self, x: f64, y: f64) -> f64 {
        each!(self, s => s.slope_deg_at(x, y))
    }

    /// Unit normal at (or next to) `p`.
    pub fn normal_at(&self, p: Vec3) -> Vec3 {
        each!(self, s => s.normal_at(p))
    }

    /// Least `t` in `(t_min, t_max)` at which `origin + t·dir` meets the surface; `dir` has length 1.
    pub fn raycast(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<f64> {
        each!(self, s => s.raycast(origin, dir, t_min, t_max))
    }

    /// Size of the rectangle `[0, w] × [0, h]` of surface coordinates (m).
    pub fn chart_size(&self) -> [f64; 2] {
        each!(self, s => s.chart_size())
    }

    /// The point at surface coordinates `(u, v)`; `None` where the rectangle extends beyond the surface. The chart
    /// preserves area, except for terrain, whose chart is the plan.
    pub fn chart(&self, u: f64, v: f64) -> Option<Vec3> {
        each!(self, s => s.chart(u, v))
    }

    /// Fraction of chart samples to keep at `p` for points even in area; 1 except for terrain.
    pub fn keep_share(&self, p: Vec3) -> f64 {
        match self {
            Self::Terrain(t) => t.keep_share(p),
            _ => 1.0,
        }
    }

    /// The surface moved by `place`.
    pub fn placed(&self, place: &Placement) -> Self {
        match self {
            Self::Polygon(s) => Self::Polygon(s.placed(place)),
            Self::Cylinder(s) => Self::Cylinder(s.placed(place)),
            Self::Disc(s) => Self::Disc(s.placed(place)),
            Self::Terrain(s) => Self::Terrain(s.placed(place)),
        }
    }

    /// Triangles that cover the surface; curved ones are cut into steps of at most `step_m` `[m, > 0]`.
    pub fn triangles(&self, step_m: f64, emit: &mut dyn FnMut([Vec3; 3])) {
        each!(self, s => s.triangles(step_m, emit))
    }
}
