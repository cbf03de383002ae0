//! Tilted rectangles, many in one file: each on its own site, far enough from the others to be classified alone.

use super::lab::{Vec3, Voxel};
use crate::Random;

/// Distance of sites (pixels): no multiple of a tile, so that tile borders cut through some.
pub const PITCH: i64 = 48;
/// Pixels between a voxel and the nearest edge of its rectangle for it to be called interior.
const MARGIN: f64 = 2.2;

/// A rectangle that rises towards a heading.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Its middle (m).
    pub middle: Vec3,
    /// Slope (degrees).
    pub slope_deg: f64,
    /// Direction of ascent, anticlockwise from x (degrees).
    pub heading_deg: f64,
    /// Length along the slope, and width (pixels).
    pub size: [f64; 2],
    pixel_m: f64,
}

/// Many patches, and the site of each.
#[derive(Debug, Default)]
pub struct Field {
    /// Patch `n` stands on site `n`.
    pub patches: Vec<Patch>,
    per_row: i64,
}

impl Field {
    /// Sites for `count` patches.
    pub fn new(count: usize) -> Self {
        Self { patches: Vec::new(), per_row: (count as f64).sqrt().ceil() as i64 }
    }

    /// Adds a patch of at most `edge` pixels in plan on the next site, its middle shifted by `phase` (pixels, pixels,
    /// slices).
    pub fn add(&mut self, pixel_m: f64, slope_deg: f64, heading_deg: f64, edge: f64, phase: Vec3) {
        let number = self.patches.len() as i64;
        let site = [number % self.per_row, number / self.per_row];
        let [x, y] = [0, 1].map(|a| ((site[a] * PITCH + PITCH / 2) as f64 + phase[a]) * pixel_m);
        // Long on the slope, so that a steep one has an inside, but no longer than 40 slices.
        let length = (edge / slope_deg.to_radians().cos().max(1e-9)).min(120.0);
        let middle = [x, y, (30.0 + phase[2]) * 3.0 * pixel_m];
        self.patches.push(Patch { middle, slope_deg, heading_deg, size: [length, edge], pixel_m });
    }

    /// The patch on whose site a pixel lies.
    pub fn at(&self, pixel: [i64; 2]) -> Option<usize> {
        let site = pixel.map(|v| v.div_euclid(PITCH));
        let number = site[1] * self.per_row + site[0];
        ((0..self.per_row).contains(&site[0]) && (0..self.patches.len() as i64).contains(&number))
            .then_some(number as usize)
    }

    /// Points of all patches: `density` per squared pixel of surface, independent of each other, with `noise_m` along
    /// the normal.
    pub fn points(&self, density: f64, noise_m: f64, random: &mut Random) -> Vec<Vec3> {
        let mut points = Vec::new();
        self.patches.iter().for_each(|patch| patch.points(density, noise_m, random, &mut points));
        points
    }
}

impl Patch {
    /// Unit vectors up the slope, across it, and along its normal.
    fn axes(&self) -> [Vec3; 3] {
        let ((s, c), (hs, hc)) = (self.slope_deg.to_radians().sin_cos(), self.heading_deg.to_radians().sin_cos());
        [[c * hc, c * hs, s], [-hs, hc, 0.0], [-s * hc, -s * hs, c]]
    }

    fn points(&self, density: f64, noise_m: f64, random: &mut Random, points: &mut Vec<Vec3>) {
        let count = (self.size[0] * self.size[1] * density).round() as usize;
        let [up, across, normal] = self.axes();
        let half = self.size.map(|size| size * self.pixel_m / 2.0);
        for _ in 0..count {
            let (a, b) = (random.between(-half[0], half[0]), random.between(-half[1], half[1]));
            let off = if noise_m > 0.0 { random.normal(noise_m) } else { 0.0 };
            points.push([0, 1, 2].map(|k| self.middle[k] + a * up[k] + b * across[k] + off * normal[k]));
        }
    }

    /// Height of its plane over a place (m); only for slopes below 90 degrees.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let (hs, hc) = self.heading_deg.to_radians().sin_cos();
        let along = (x - self.middle[0]) * hc + (y - self.middle[1]) * hs;
        self.middle[2] + along * self.slope_deg.to_radians().tan()
    }

    /// Whether the window of a voxel (3 × 3 pixels, a slice up and down) holds no edge of the rectangle.
    pub fn is_interior(&self, voxel: &Voxel) -> bool {
        let at = voxel.middle(self.pixel_m);
        let from = [0, 1, 2].map(|k| (at[k] - self.middle[k]) / self.pixel_m);
        let [up, across, _] = self.axes();
        let along = |axis: Vec3| axis[0] * from[0] + axis[1] * from[1] + axis[2] * from[2];
        let (s, c) = self.slope_deg.to_radians().sin_cos();
        let margin = (MARGIN / c.max(1e-9)).min(7.0 / s.max(1e-9));
        along(up).abs() <= self.size[0] / 2.0 - margin && along(across).abs() <= self.size[1] / 2.0 - MARGIN
    }
}
