//! Carpentry shared by the scenes: boxes, walls with openings, slabs with holes, stairs, columns, arches.

use super::{Scene, Surface, Walk};
use crate::geometry::{Vec3, add, sin_cos_deg};
use crate::shape::{Cylinder, Disc, Polygon, Shape};

/// A rectangle in the plane of a wall or slab: `[u0, v0, u1, v1]`, `u0 < u1`, `v0 < v1`.
pub type Rect = [f64; 4];

/// Collects the surfaces of a scene.
#[derive(Debug, Default)]
pub struct Builder {
    surfaces: Vec<Surface>,
    walk: Option<Walk>,
    stations: Vec<Vec3>,
}

/// Straight flight of stairs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flight {
    /// Middle of the foot of the first riser.
    pub foot: Vec3,
    /// Direction of climbing, anticlockwise from x `[°]`.
    pub heading_deg: f64,
    /// Number of risers; there is one tread fewer, because the last riser ends at the landing.
    pub risers: usize,
    /// Height of a riser (m).
    pub riser: f64,
    /// Depth of a tread (m).
    pub tread: f64,
    /// Width (m).
    pub width: f64,
}

/// Upright wall along a line in plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// Start of its right-hand face in plan, seen from above in the direction of the wall.
    pub from: [f64; 2],
    /// End of that face; any direction is allowed.
    pub to: [f64; 2],
    /// Thickness, to the left of that line `[m, >= 0]`; 0 makes a single sheet.
    pub thickness: f64,
    /// Foot and top.
    pub z: [f64; 2],
}

impl Builder {
    /// Starts an empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the scene.
    pub fn finish(self, name: &str) -> Scene {
        let mut scene = Scene::new(name, self.surfaces);
        scene.walk = self.walk;
        scene.stations = self.stations;
        if scene.stations.is_empty() && !scene.surfaces.is_empty() {
            let c = scene.bounds.center();
            scene.stations = vec![[c[0], c[1], scene.bounds.max[2] + 1.7]];
        }
        scene
    }

    /// Sets the route to walk.
    pub fn walk(&mut self, start: Vec3, waypoints: Vec<[f64; 2]>, end: Vec3) {
        self.walk = Some(Walk { start, waypoints, end });
    }

    /// Adds a place for the scanner.
    pub fn station(&mut self, at: Vec3) {
        self.stations.push(at);
    }

    /// Adds a surface.
    pub fn shape(&mut self, label: &'static str, shape: Shape) {
        self.surfaces.push(Surface { shape, label });
    }

    /// Adds the parallelogram with corner `origin` and edges `a`, `b`.
    pub fn quad(&mut self, label: &'static str, origin: Vec3, a: Vec3, b: Vec3) {
        self.shape(label, Shape::Polygon(Polygon::parallelogram(origin, a, b)));
    }

    /// Adds the horizontal rectangle `[x0, y0, x1, y1]` at height `z` without its holes.
    pub fn level(&mut self, label: &'static str, rect: Rect, z: f64, holes: &[Rect]) {
        for [x0, y0, x1, y1] in subtract(rect, holes) {
            self.quad(label, [x0, y0, z], [x1 - x0, 0.0, 0.0], [0.0, y1 - y0, 0.0]);
        }
    }

    /// Adds the six faces of a box.
    pub fn cuboid(&mut self, label: &'static str, min: Vec3, max: Vec3) {
        self.level(label, [min[0], min[1], max[0], max[1]], min[2], &[]);
        self.open_cuboid(label, min, max);
    }

    /// Adds a box without its underside, for things that stand on a floor.
    pub fn open_cuboid(&mut self, label: &'static str, min: Vec3, max: Vec3) {
        let [dx, dy, dz] = [max[0] - min[0], max[1] - min[1], max[2] - min[2]];
        self.level(label, [min[0], min[1], max[0], max[1]], max[2], &[]);
        self.quad(label, min, [dx, 0.0, 0.0], [0.0, 0.0, dz]);
        self.quad(label, [min[0], max[1], min[2]], [dx, 0.0, 0.0], [0.0, 0.0, dz]);
        self.quad(label, min, [0.0, dy, 0.0], [0.0, 0.0, dz]);
        self.quad(label, [max[0], min[1], min[2]], [0.0, dy, 0.0], [0.0, 0.0, dz]);
    }

    /// Adds an upright column with a flat top.
    pub fn column(&mut self, label: &'static str, center: [f64; 2], radius: f64, z: [f64; 2]) {
        self.shape(label, Shape::Cylinder(Cylinder { center, radius, z_min: z[0], z_max: z[1] }));
        self.shape(label, Shape::Disc(Disc { center: [center[0], center[1], z[1]], radius }));
    }

    /// Adds a slab: floor on top, ceiling below, and the edges of its holes.
    pub fn slab(&mut self, rect: Rect, z_top: f64, thickness: f64, holes: &[Rect]) {
        self.level("floor", rect, z_top, holes);
        self.level("ceiling", rect, z_top - thickness, holes);
        for [x0, y0, x1, y1] in holes {
            let (low, up) = (z_top - thickness, [0.0, 0.0, thickness]);
            self.quad("slab edge", [*x0, *y0, low], [x1 - x0, 0.0, 0.0], up);
            self.quad("slab edge", [*x0, *y1, low], [x1 - x0, 0.0, 0.0], up);
            self.quad("slab edge", [*x0, *y0, low], [0.0, y1 - y0, 0.0], up);
            self.quad("slab edge", [*x1, *y0, low], [0.0, y1 - y0, 0.0], up);
        }
    }

    /// Adds a wall with openings `[along0, z0, along1, z1]` (z absolute): both faces, top, ends, and the reveals.
    pub fn wall(&mut self, wall: Wall, openings: &[Rect]) {
        let [dx, dy] = [wall.to[0] - wall.from[0], wall.to[1] - wall.from[1]];
        let len = (dx * dx + dy * dy).sqrt();
        let along = [dx / len, dy / len, 0.0];
        let through = [-along[1] * wall.thickness, along[0] * wall.thickness, 0.0];
        let at = |u: f64, z: f64| [wall.from[0] + along[0] * u, wall.from[1] + along[1] * u, z];
        let run = |d: f64| [along[0] * d, along[1] * d, 0.0];
        let [z0, z1] = wall.z;
        for [u0, v0, u1, v1] in subtract([0.0, z0, len, z1], openings) {
            self.quad("wall", at(u0, v0), run(u1 - u0), [0.0, 0.0, v1 - v0]);
            if wall.thickness > 0.0 {
                self.quad("wall", add(at(u0, v0), through), run(u1 - u0), [0.0, 0.0, v1 - v0]);
            }
        }
        if wall.thickness <= 0.0 {
            return;
        }
        self.quad("wall", at(0.0, z1), run(len), through);
        self.quad("wall", at(0.0, z0), through, [0.0, 0.0, z1 - z0]);
        self.quad("wall", at(len, z0), through, [0.0, 0.0, z1 - z0]);
        for [u0, v0, u1, v1] in openings {
            self.quad("reveal", at(*u0, *v0), through, [0.0, 0.0, v1 - v0]);
            self.quad("reveal", at(*u1, *v0), through, [0.0, 0.0, v1 - v0]);
            self.quad("reveal", at(*u0, *v1), run(u1 - u0), through);
            if *v0 > z0 {
                self.quad("reveal", at(*u0, *v0), run(u1 - u0), through);
            }
        }
    }

    /// Adds a flight of stairs, solid below: treads, risers, both sides, and the back under the landing.
    pub fn flight(&mut self, f: Flight) {
        let (s, c) = sin_cos_deg(f.heading_deg);
        let at = |along: f64, left: f64, up: f64| add(f.foot, [along * c - left * s, along * s + left * c, up]);
        let run = |d: f64| [d * c, d * s, 0.0];
        let wide = [-f.width * s, f.width * c, 0.0];
        for i in 0..f.risers {
            let (along, up) = (i as f64 * f.tread, i as f64 * f.riser);
            self.quad("riser", at(along, -f.width / 2.0, up), wide, [0.0, 0.0, f.riser]);
            if i + 1 < f.risers {
                let top = up + f.riser;
                self.quad("tread", at(along, -f.width / 2.0, top), run(f.tread), wide);
                for side in [-f.width / 2.0, f.width / 2.0] {
                    self.quad("stair side", at(along, side, 0.0), run(f.tread), [0.0, 0.0, top]);
                }
            }
        }
        let (end, height) = ((f.risers - 1) as f64 * f.tread, (f.risers - 1) as f64 * f.riser);
        if height > 0.0 {
            self.quad("stair side", at(end, -f.width / 2.0, 0.0), wide, [0.0, 0.0, height]);
        }
    }

    /// Adds a half-round arch of `facets` flat facets, swept by `sweep`: from `origin` (middle of the springing line)
    /// it spans `±radius` along the horizontal unit vector `across`. With `spandrel` above `radius` its two faces are
    /// filled up to that height above the springing.
    pub fn arch(&mut self, origin: Vec3, across: Vec3, radius: f64, sweep: Vec3, facets: usize, spandrel: f64) {
        let at = |i: usize| {
            let (s, c) = sin_cos_deg(180.0 * i as f64 / facets as f64);
            add(origin, [across[0] * radius * c, across[1] * radius * c, radius * s])
        };
        for i in 0..facets {
            let (a, b) = (at(i), at(i + 1));
            self.quad("arch", a, [b[0] - a[0], b[1] - a[1], b[2] - a[2]], sweep);
            let top = origin[2] + spandrel;
            if spandrel > radius {
                for side in [[0.0; 3], sweep] {
                    let (a, b) = (add(a, side), add(b, side));
                    let face = vec![a, b, [b[0], b[1], top], [a[0], a[1], top]];
                    self.shape("spandrel", Shape::Polygon(Polygon::new(face)));
                }
            }
        }
    }
}

/// The rectangle without the holes, as disjoint rectangles.
pub fn subtract(rect: Rect, holes: &[Rect]) -> Vec<Rect> {
    let [u0, v0, u1, v1] = rect;
    let mut cuts: Vec<f64> = holes.iter().flat_map(|h| [h[0], h[2]]).filter(|u| *u > u0 && *u < u1).collect();
    cuts.extend([u0, u1]);
    cuts.sort_by(f64::total_cmp);
    cuts.dedup();
    let mut parts = Vec::new();
    for strip in cuts.windows(2) {
        let middle = (strip[0] + strip[1]) / 2.0;
        let mut gaps: Vec<(f64, f64)> =
            holes.iter().filter(|h| h[0] < middle && middle < h[2]).map(|h| (h[1], h[3])).collect();
        gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut from = v0;
        for (low, high) in gaps {
            if low > from {
                parts.push([strip[0], from, strip[1], low.min(v1)]);
            }
            from = from.max(high);
        }
        if from < v1 {
            parts.push([strip[0], from, strip[1], v1]);
        }
    }
    parts
}
