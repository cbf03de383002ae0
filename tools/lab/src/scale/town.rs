//! A town of any size and always the same density: equal blocks, each with a house, pillars and a bench, laid out by chance.

use crate::Random;
use crate::pawns;
use crate::stability::Result;
use nalgebra::Point3;
use scangen::scene::build::Builder;
use scangen::{CloudFormat, Sample, SampleSpec, Scene, WriteSpec, write_clouds, write_samples};
use slicewalk::query::Aabb;
use slicewalk::store::Snapshot;
use std::path::Path;

/// Edge of a block (m).
const BLOCK_M: f64 = 18.0;
/// House: width, depth, height (m).
const HOUSE_M: [f64; 3] = [8.0, 7.0, 7.3];
/// How far the house stands from the middle of its block along an axis, at most (m).
const SHIFT_M: f64 = 1.8;
const PILLARS: usize = 6;
/// Surface of a block (m²).
pub const SURFACE_M2: u64 = 625;

/// A town, as many blocks along x as along y or one more; the last row may be short.
#[derive(Debug, Clone, Copy)]
pub struct Town {
    blocks: u64,
}

impl Town {
    /// Creates a town of `blocks` blocks, at least one.
    pub fn new(blocks: u64) -> Self {
        Self { blocks: blocks.max(1) }
    }

    /// Ground (m²).
    pub fn area_m2(&self) -> f64 {
        self.blocks as f64 * BLOCK_M * BLOCK_M
    }

    /// Corner of a block (m).
    fn corner(&self, block: u64) -> [f64; 2] {
        let columns = (self.blocks as f64).sqrt().ceil() as u64;
        [block % columns, block / columns].map(|n| n as f64 * BLOCK_M)
    }

    /// Whether there is a block at a place.
    pub fn holds(&self, place: Point3<f64>) -> bool {
        let columns = (self.blocks as f64).sqrt().ceil() as i64;
        let [i, j] = [place.x, place.y].map(|v| (v / BLOCK_M).floor() as i64);
        (0..columns).contains(&i) && j >= 0 && ((j * columns + i) as u64) < self.blocks
    }

    /// Pawns anywhere in the town, up to a metre above the ground.
    pub fn random_pawns(&self, count: usize, seed: u64) -> Vec<Aabb> {
        let mut random = Random(seed);
        let mut anywhere = || {
            let [x, y] = self.corner(random.bits() % self.blocks);
            let [dx, dy] = [0; 2].map(|_| random.between(0.0, BLOCK_M));
            pawns::pawn(Point3::new(x + dx, y + dy, random.between(0.04, 1.0)))
        };
        (0..count).map(|_| anywhere()).collect()
    }

    /// Steps of walks through the town.
    pub fn walking_pawns(&self, set: &Snapshot, count: usize, seed: u64) -> Vec<Aabb> {
        // No block has anything in this place.
        let street = |random: &mut Random| {
            let [x, y] = self.corner(random.bits() % self.blocks);
            Point3::new(x + 2.2, y + 2.2, 0.05)
        };
        let start = street(&mut Random(seed));
        pawns::wander(set, count, seed, start, |place| self.holds(place), street)
    }

    /// Writes a scan with `density` points on a square metre: block after block in random order, in random order within
    /// each. Returns the number of points.
    pub fn write(&self, path: &Path, density: u64) -> Result<u64> {
        Ok(write_samples(path, self.all(density), &WriteSpec::for_path(path))?.points)
    }

    /// Writes the same scan in another format, with `cloud_points` points in a cloud. Returns the number of points.
    pub fn write_clouds(&self, path: &Path, format: CloudFormat, density: u64, cloud_points: u64) -> Result<u64> {
        Ok(write_clouds(path, format, self.all(density), &WriteSpec::default(), cloud_points)?.points)
    }

    fn all(&self, density: u64) -> impl Iterator<Item = Sample> {
        let mut order: Vec<u64> = (0..self.blocks).collect();
        let mut random = Random(1);
        for n in (1..order.len()).rev() {
            order.swap(n, (random.bits() % (n as u64 + 1)) as usize);
        }
        order.into_iter().flat_map(move |block| self.samples(block, density * SURFACE_M2))
    }

    fn samples(&self, block: u64, count: u64) -> Vec<Sample> {
        let scene = self.scene(block);
        let spec = SampleSpec::direct_count(count).with_noise(0.002);
        // Cannot fail: all of its numbers are constants within the limits.
        scene.samples(block, &spec).map(Iterator::collect).unwrap_or_default()
    }

    fn scene(&self, block: u64) -> Scene {
        let mut random = Random(block);
        let [x, y] = self.corner(block);
        let mut builder = Builder::new();
        builder.level("ground", [x, y, x + BLOCK_M, y + BLOCK_M], 0.0, &[]);
        let mut shifted = |size: f64| (BLOCK_M - size) / 2.0 + random.between(-SHIFT_M, SHIFT_M);
        let house = [x + shifted(HOUSE_M[0]), y + shifted(HOUSE_M[1])];
        let far = [house[0] + HOUSE_M[0], house[1] + HOUSE_M[1], HOUSE_M[2]];
        builder.open_cuboid("house", [house[0], house[1], 0.0], far);
        // Along two sides of the block, where no house can stand.
        for _ in 0..PILLARS {
            let along = random.between(1.0, BLOCK_M - 1.0);
            builder.column("pillar", [x + along, y + random.between(0.5, 1.0)], 0.2, [0.0, 3.0]);
        }
        let bench = [x + random.between(0.5, 1.0), y + random.between(4.0, BLOCK_M - 4.0)];
        builder.open_cuboid("bench", [bench[0], bench[1], 0.0], [bench[0] + 0.5, bench[1] + 2.0, 0.45]);
        builder.finish("town")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_their_surface() {
        let area: f64 = Town::new(7).scene(3).surfaces().iter().map(|surface| surface.shape.area()).sum();
        assert!((area - SURFACE_M2 as f64).abs() < 1.0, "{area}");
    }

    #[test]
    fn a_scan_holds_all_blocks_and_no_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let town = Town::new(5);
        assert_eq!(town.write(&folder.path().join("town.las"), 2).expect("writes"), 5 * 2 * SURFACE_M2);
        let points = (0..5).flat_map(|block| town.samples(block, 2000)).map(|sample| sample.position);
        // Noise carries points of a border into the next block.
        let inner = |p: &[f64; 3]| p[..2].iter().all(|v| (0.1..BLOCK_M - 0.1).contains(&v.rem_euclid(BLOCK_M)));
        let block = |[x, y, _]: [f64; 3]| [x, y].map(|v| (v / BLOCK_M).floor() as i64);
        let blocks: std::collections::BTreeSet<_> = points.filter(inner).map(block).collect();
        let expected = [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0]];
        assert!(blocks.iter().eq(&expected), "{blocks:?}");
        let middle = |[i, j]: [i64; 2]| Point3::new((i as f64 + 0.5) * BLOCK_M, (j as f64 + 0.5) * BLOCK_M, 0.0);
        assert!(expected.iter().all(|at| town.holds(middle(*at))));
        assert!([[2, 1], [3, 0], [-1, 0], [0, -1], [0, 2]].iter().all(|at| !town.holds(middle(*at))));
    }
}
