//! The thesis' algorithm 3.3 to the letter, as a baseline.
//!
//! Slices begin at the lowest point of the scan (`z0 = zmin`). Each voxel stores one red value, which every point
//! overwrites: with its own, or with 1 when it was found to differ by more than `εσ` from the *stored* one. Points are
//! drawn seen from above, so that the highest one decides a pixel's colour; a point found to be an obstacle below the
//! stored height is lifted above it. The thesis calls ε "a small percentage" without a number; here `ε = t/σ = 1/3`, so
//! that a slope of 45 degrees fills a pixel by just that much.

use super::lab::{Setting, Vec3, Voxel};

/// Share of the slice height by which two points of a voxel must differ.
pub const EPSILON: f64 = 1.0 / 3.0;
/// Lift of an obstacle point above the stored height ("a correction value"), in slice heights.
const LIFT: f64 = EPSILON / 2.0;

#[derive(Debug, Clone, Copy)]
struct Pixel {
    key: u64,
    /// Red value of the highest point drawn, as the image keeps it.
    red: u8,
    obstacle: bool,
}

/// The slices of a scan.
pub struct Written {
    setting: Setting,
    z0: f64,
    first: [i64; 2],
    /// Ordered by pixel, then by slice.
    pixels: Vec<Pixel>,
}

const SLICE_BITS: u32 = 20;
const PIXEL_BITS: u32 = 22;

impl Written {
    /// Colours `points` in the order given.
    pub fn new(setting: Setting, points: impl Iterator<Item = Vec3> + Clone) -> Self {
        let z0 = points.clone().map(|p| p[2]).fold(f64::INFINITY, f64::min);
        let index = |v: f64| (v / setting.pixel_m).floor() as i64;
        let first = points.clone().map(|p| [index(p[0]), index(p[1])]);
        let first = first.fold([i64::MAX; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])]);
        let mut written = Self { setting, z0, first, pixels: Vec::new() };
        let sigma = setting.slice_m();
        let mut drawn: Vec<(u64, f64)> = points
            .map(|[x, y, z]| {
                let above = (z - z0) / sigma;
                (written.key(index(x), index(y), above.floor() as i64), above.fract())
            })
            .collect();
        // A stable sort keeps the points of a voxel in their original sequence.
        drawn.sort_by_key(|(key, _)| *key);
        written.pixels = drawn.chunk_by(|a, b| a.0 == b.0).map(colour).collect();
        written
    }

    /// Height at which its slices begin: the lowest point (m).
    pub fn origin(&self) -> f64 {
        self.z0
    }

    fn key(&self, i: i64, j: i64, slice: i64) -> u64 {
        let (i, j) = ((i - self.first[0]) as u64, (j - self.first[1]) as u64);
        debug_assert!(i < 1 << PIXEL_BITS && j < 1 << PIXEL_BITS && slice < 1 << SLICE_BITS);
        (i << PIXEL_BITS | j) << SLICE_BITS | slice as u64
    }

    fn slice(&self, z: f64) -> i64 {
        ((z - self.z0) / self.setting.slice_m()).floor() as i64
    }

    /// Pixels `i`, `j` of slices `low..=high`.
    fn range(&self, i: i64, j: i64, low: i64, high: i64) -> &[Pixel] {
        let limit = 1 << PIXEL_BITS;
        let outside = |v: i64, first: i64| !(0..limit).contains(&(v - first));
        if outside(i, self.first[0]) || outside(j, self.first[1]) || high < 0 {
            return &[];
        }
        let top = (1 << SLICE_BITS) - 1;
        let (first, last) = (self.key(i, j, low.clamp(0, top)), self.key(i, j, high.clamp(0, top)));
        let start = self.pixels.partition_point(|p| p.key < first);
        let end = start + self.pixels[start..].partition_point(|p| p.key <= last);
        &self.pixels[start..end]
    }

    /// Calls `give` with every pixel that is not black: its place, red value, and whether it is an obstacle.
    pub fn pixels(&self, mut give: impl FnMut([i64; 3], u8, bool)) {
        for pixel in &self.pixels {
            let place = |shift: u32, bits: u32| (pixel.key >> shift & ((1 << bits) - 1)) as i64;
            let (i, j) = (place(SLICE_BITS + PIXEL_BITS, PIXEL_BITS), place(SLICE_BITS, PIXEL_BITS));
            give([i + self.first[0], j + self.first[1], place(0, SLICE_BITS)], pixel.red, pixel.obstacle);
        }
    }

    /// Calls `give` with every voxel.
    pub fn voxels(&self, mut give: impl FnMut(Voxel)) {
        self.pixels(|[i, j, slice], _, obstacle| {
            let z = [slice, slice + 1].map(|s| self.z0 + s as f64 * self.setting.slice_m());
            give(Voxel { pixel: [i, j], z, obstacle });
        });
    }

    /// Highest floor pixel at one place whose height is at most `from` and at least `from - depth` (m).
    pub fn floor(&self, x: f64, y: f64, from: f64, depth: f64) -> Option<f64> {
        let [i, j] = [x, y].map(|v| (v / self.setting.pixel_m).floor() as i64);
        let slices = self.range(i, j, self.slice(from - depth), self.slice(from));
        let mut heights = slices.iter().rev().filter(|pixel| !pixel.obstacle).map(|pixel| self.height(pixel));
        heights.find(|z| (from - depth..=from).contains(z))
    }

    /// Returns the height that the image gives for the lowest pixel over a footprint, in the slice of `from` (m) or
    /// above: red is the highest point, the only height stored.
    pub fn ceiling(&self, min: Vec3, max: Vec3, from: f64) -> Option<f64> {
        let index = |v: f64| (v / self.setting.pixel_m).floor() as i64;
        let pixels = (index(min[0])..=index(max[0])).flat_map(|i| (index(min[1])..=index(max[1])).map(move |j| (i, j)));
        let heights = pixels.filter_map(|(i, j)| {
            let slices = self.range(i, j, self.slice(from), i64::from(u16::MAX));
            slices.iter().map(|pixel| self.height(pixel)).find(|z| *z >= from)
        });
        heights.min_by(f64::total_cmp)
    }

    fn height(&self, pixel: &Pixel) -> f64 {
        let slice = (pixel.key & ((1 << SLICE_BITS) - 1)) as f64;
        self.z0 + (slice + f64::from(pixel.red) / 255.0) * self.setting.slice_m()
    }

    /// Whether any pixel of the box in the slices that it spans is not black (algorithm 3.4), and whether one is blue.
    pub fn touches(&self, min: Vec3, max: Vec3) -> (bool, bool) {
        let index = |v: f64| (v / self.setting.pixel_m).floor() as i64;
        let (low, high) = (self.slice(min[2]), self.slice(max[2]));
        let mut found = (false, false);
        for i in index(min[0])..=index(max[0]) {
            for j in index(min[1])..=index(max[1]) {
                for pixel in self.range(i, j, low, high) {
                    found = (true, found.1 || pixel.obstacle);
                }
            }
        }
        found
    }
}

/// Draws the points of one voxel in turn.
fn colour(points: &[(u64, f64)]) -> Pixel {
    let mut stored: Option<f64> = None;
    let mut highest = f64::NEG_INFINITY;
    let mut pixel = Pixel { key: points[0].0, red: 0, obstacle: false };
    for &(_, red) in points {
        let old = stored.unwrap_or(red);
        let obstacle = (old - red).abs() > EPSILON;
        stored = Some(if obstacle { 1.0 } else { red });
        let height = if obstacle && old > red { old + LIFT } else { red };
        if height > highest {
            highest = height;
            pixel = Pixel { red: (red * 255.0).round() as u8, obstacle, ..pixel };
        }
    }
    pixel
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_three_points_decides() {
        let verdict = |reds: [f64; 3]| colour(&reds.map(|red| (0, red))).obstacle;
        assert!(verdict([0.1, 0.9, 0.5]));
        // The third point is near enough to the 1 that the second one stored, and drawn over it.
        assert!(!verdict([0.1, 0.5, 0.9]));
    }

    #[test]
    fn a_flat_floor_is_floor_and_a_wall_is_not() {
        let setting = Setting::new(0.1);
        let floor = (0..100).map(|n| [f64::from(n) * 0.01, 0.05, 0.003 * f64::from(n % 3)]);
        Written::new(setting, floor).voxels(|voxel| assert!(!voxel.obstacle));
        let wall = Written::new(setting, (0..100).map(|n| [0.05, 0.05, f64::from(n * 37 % 100) * 0.01]));
        assert_eq!(wall.touches([0.0, 0.0, 0.0], [0.2, 0.2, 1.0]), (true, true));
        assert_eq!(wall.touches([0.2, 0.0, 0.0], [0.4, 0.2, 1.0]), (false, false));
        assert_eq!(wall.floor(0.5, 0.5, 1.0, 1.0), None);
    }
}
