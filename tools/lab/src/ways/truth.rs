//! Standing places by surfaces in closed form.
//!
//! A cylinder rests on the highest surface under it that it climbs onto from the surface under its middle. It stands there if nothing is in it,
//! and if what it rests on is floor: a surface up to 45° steep lies under it, at most 5 cm below its feet. A claim may take the surface under the
//! middle within one pixel (`docs/walk-and-routes.md`).

use scangen::{Scene, Truth};

/// Height of the pawn, its highest step (m), and the steepest floor (degrees).
pub const HEIGHT: f64 = 1.8;
pub const CLIMB: f64 = 0.35;
pub const SLOPE_DEG: f64 = 45.0;
/// Floor counts as at the feet down to this distance below them (m).
const NEAR_FEET_M: f64 = 0.05;
/// A measured point lies no farther from its surface (m).
const MEASURED_M: f64 = 0.03;
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
    /// Over each corner from the highest down, with their slopes (degrees).
    heights: Vec<(f64, f64)>,
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
            while let Some((z, slope)) = scene.floor_under(x, y, from) {
                heights.push((z, slope));
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

    /// Returns whether a point measured at a place lies on a floor: on a surface up to 45° steep that nothing covers
    /// within a climb. Undersides of slabs are not floors.
    pub fn holds(&self, [x, y, z]: [f64; 3]) -> bool {
        let top = self.scene.floor_under(x, y, z + CLIMB);
        top.is_some_and(|(top, slope)| (top - z).abs() <= MEASURED_M && slope <= SLOPE_DEG)
    }

    /// Whether a body of this radius stands where the surface under its middle is at `z` and `slope` steep, on floor up to `limit_deg` steep; and at
    /// what heights its feet may be.
    pub fn stands(&self, [x, y, z]: [f64; 3], slope: f64, radius: f64, limit_deg: f64) -> Option<Heights> {
        let mut under = vec![(z, slope)];
        self.under([x, y, z], radius, |own| under.push(own));
        let feet = under.iter().map(|own| own.0).fold(z, f64::max);
        if !under.iter().any(|(height, slope)| *slope <= limit_deg && feet - height <= NEAR_FEET_M) {
            return None;
        }
        // Boxes in the cylinder: together they leave out a hundredth of its radius.
        let blocked = (1..12).any(|n| {
            let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_2 / 12.0).sin_cos();
            let (a, b) = (radius * cos, radius * sin);
            self.scene.distance_to_box([x - a, y - b, z + CLIMB], [x + a, y + b, feet + HEIGHT]) == 0.0
        });
        let near = |more: f64| self.highest([x, y, z], (radius + more * self.pixel_m).max(0.0));
        (!blocked).then(|| [near(-1.0), near(1.5)])
    }

    /// Highest surface within a radius that is climbed onto (m).
    fn highest(&self, at: [f64; 3], radius: f64) -> f64 {
        let mut highest = at[2];
        self.under(at, radius, |own| highest = highest.max(own.0));
        highest
    }

    /// Gives `each` the highest surface within a climb above `z` at each corner within a radius, with its slope.
    fn under(&self, [x, y, z]: [f64; 3], radius: f64, mut each: impl FnMut((f64, f64))) {
        let t = self.pixel_m;
        let [low, high] = [-radius, radius].map(|r| [x, y].map(|v| ((v + r) / t).floor() as i64));
        for j in low[1].max(self.first[1])..=(high[1] + 1).min(self.first[1] + self.size[1] as i64 - 1) {
            for i in low[0].max(self.first[0])..=(high[0] + 1).min(self.first[0] + self.size[0] as i64 - 1) {
                if (i as f64 * t - x).hypot(j as f64 * t - y) > radius {
                    continue;
                }
                let corner = (j - self.first[1]) as usize * self.size[0] + (i - self.first[0]) as usize;
                let own = &self.heights[self.starts[corner] as usize..self.starts[corner + 1] as usize];
                if let Some(top) = own.iter().find(|own| own.0 <= z + CLIMB) {
                    each(*top);
                }
            }
        }
    }
}
