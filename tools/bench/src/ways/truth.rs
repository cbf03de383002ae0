//! What surfaces in closed form say about standing.
//!
//! A cylinder stands on a floor (a surface up to 45° steep) if nothing is in it from the highest surface under it that it climbs onto.

use scangen::{Scene, Truth};

/// Height of the pawn, its highest step (m), and the steepest floor (degrees).
pub const HEIGHT: f64 = 1.8;
pub const CLIMB: f64 = 0.35;
pub const SLOPE_DEG: f64 = 45.0;
/// Surfaces nearer to each other are one (m).
const APART_M: f64 = 1e-4;

/// Heights that feet may have: between these of a body smaller and larger by a pixel (m).
pub type Heights = [f64; 2];

/// The surfaces of a scene, and their heights over the corners of all pixels.
pub struct Floors<'a> {
    scene: &'a Scene,
    pixel_m: f64,
    first: [i64; 2],
    size: [usize; 2],
    starts: Vec<u32>,
    /// Over each corner from the highest down.
    heights: Vec<f64>,
}

impl<'a> Floors<'a> {
    /// Of pixels of `pixel_m` (m).
    pub fn new(scene: &'a Scene, pixel_m: f64) -> Self {
        let bounds = scene.bounds();
        let first = [0, 1].map(|axis| (bounds.min[axis] / pixel_m).floor() as i64);
        let size = [0, 1].map(|axis| ((bounds.max[axis] / pixel_m).ceil() as i64 - first[axis] + 1) as usize);
        let (mut starts, mut heights) = (vec![0], Vec::new());
        for (j, i) in (0..size[1] as i64).flat_map(|j| (0..size[0] as i64).map(move |i| (j, i))) {
            let [x, y] = [first[0] + i, first[1] + j].map(|v| v as f64 * pixel_m);
            let mut from = bounds.max[2] + 1.0;
            while let Some((z, _)) = scene.floor_under(x, y, from) {
                heights.push(z);
                from = z - APART_M;
            }
            starts.push(heights.len() as u32);
        }
        Self { scene, pixel_m, first, size, starts, heights }
    }

    /// Floors over a place, from the highest down, with their slopes (m, degrees); what lies less than a climb under another is no floor.
    pub fn over(&self, x: f64, y: f64) -> Vec<(f64, f64)> {
        let (mut floors, mut from) = (Vec::new(), self.scene.bounds().max[2] + 1.0);
        while let Some((z, slope)) = self.scene.floor_under(x, y, from) {
            floors.push((z, slope));
            from = z - CLIMB;
        }
        floors
    }

    /// Whether a body of this radius stands at a floor, and at what heights its feet may be.
    pub fn stands(&self, [x, y, z]: [f64; 3], slope: f64, radius: f64) -> Option<Heights> {
        if slope > SLOPE_DEG {
            return None;
        }
        let feet = self.highest([x, y, z], radius);
        // Boxes in the cylinder: together they leave out a twentieth of it.
        let blocked = (1..6).any(|n| {
            let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_2 / 6.0).sin_cos();
            let (a, b) = (radius * cos, radius * sin);
            self.scene.distance_to_box([x - a, y - b, z + CLIMB], [x + a, y + b, feet + HEIGHT]) == 0.0
        });
        let near = |more: f64| self.highest([x, y, z], (radius + more * self.pixel_m).max(0.0));
        (!blocked).then(|| [near(-1.0), near(1.5)])
    }

    /// Highest surface within a radius that is climbed onto (m).
    fn highest(&self, [x, y, z]: [f64; 3], radius: f64) -> f64 {
        let t = self.pixel_m;
        let [low, high] = [-radius, radius].map(|r| [x, y].map(|v| ((v + r) / t).floor() as i64));
        let mut highest = z;
        for j in low[1].max(self.first[1])..=(high[1] + 1).min(self.first[1] + self.size[1] as i64 - 1) {
            for i in low[0].max(self.first[0])..=(high[0] + 1).min(self.first[0] + self.size[0] as i64 - 1) {
                if (i as f64 * t - x).hypot(j as f64 * t - y) > radius {
                    continue;
                }
                let corner = (j - self.first[1]) as usize * self.size[0] + (i - self.first[0]) as usize;
                let own = &self.heights[self.starts[corner] as usize..self.starts[corner + 1] as usize];
                if let Some(top) = own.iter().find(|height| **height <= z + CLIMB) {
                    highest = highest.max(*top);
                }
            }
        }
        highest
    }
}
