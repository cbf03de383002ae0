//! A town of any size and always the same density: equal blocks, each with a house, pillars and a bench, laid out by chance.

use crate::Random;
use crate::pawns;
use crate::stability::Result;
use nalgebra::Point3;
use scangen::scene::build::Builder;
use scangen::{Sample, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::query::Aabb;
use slicewalk::store::PageSet;
use std::path::Path;

/// Edge of a block (m).
pub const BLOCK_M: f64 = 30.0;
/// House: width, depth, height (m).
const HOUSE_M: [f64; 3] = [14.0, 12.0, 8.0];
/// How far the house stands from the middle of its block, at most (m).
const SHIFT_M: f64 = 5.0;
const PILLARS: usize = 6;
/// Points of a block: 100 for a square metre of its surfaces.
pub const POINTS_PER_BLOCK: u64 = 153_000;

/// A town, as many blocks along x as along y or one more; the last row may be short.
#[derive(Debug, Clone, Copy)]
pub struct Town {
    blocks: u64,
}

impl Town {
    /// A town of about so many points.
    pub fn of_points(points: u64) -> Self {
        Self { blocks: (points as f64 / POINTS_PER_BLOCK as f64).round().max(1.0) as u64 }
    }

    /// Number of blocks.
    pub fn blocks(&self) -> u64 {
        self.blocks
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
    pub fn walking_pawns<S: PageSet>(&self, set: &S, count: usize, seed: u64) -> Vec<Aabb> {
        // No block has anything in this place.
        let street = |random: &mut Random| {
            let [x, y] = self.corner(random.bits() % self.blocks);
            Point3::new(x + 2.3, y + 3.0, 0.05)
        };
        let start = street(&mut Random(seed));
        pawns::wander(set, count, seed, start, |place| self.holds(place), street)
    }

    /// Writes `points` points of the town: block after block in random order, in random order within each.
    pub fn write(&self, path: &Path, points: u64) -> Result<()> {
        let mut order: Vec<u64> = (0..self.blocks).collect();
        let mut random = Random(1);
        for n in (1..order.len()).rev() {
            order.swap(n, (random.bits() % (n as u64 + 1)) as usize);
        }
        let (mut left, blocks) = (points, self.blocks);
        let samples = order.into_iter().enumerate().flat_map(|(n, block)| {
            let count = left / (blocks - n as u64);
            left -= count;
            self.samples(block, count)
        });
        write_samples(path, samples, &WriteSpec::for_path(path))?;
        Ok(())
    }

    fn samples(&self, block: u64, count: u64) -> Vec<Sample> {
        let scene = self.scene(block);
        let spec = SampleSpec::direct_count(count).with_noise(0.002);
        // Its numbers are constants of ours, and allowed.
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
            let along = random.between(2.0, BLOCK_M - 2.0);
            builder.column("pillar", [x + along, y + random.between(0.5, 2.0)], 0.2, [0.0, 3.0]);
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
    fn a_block_has_the_points_of_its_area() {
        let town = Town::of_points(POINTS_PER_BLOCK * 7);
        let area: f64 = town.scene(3).surfaces().iter().map(|surface| surface.shape.area()).sum();
        assert!((POINTS_PER_BLOCK as f64 / area - 100.0).abs() < 2.0, "{area}");
        assert_eq!(town.blocks(), 7);
    }

    #[test]
    fn a_file_holds_all_points_and_they_lie_in_the_town() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("town.las");
        let town = Town { blocks: 5 };
        town.write(&path, 10_003).expect("writes");
        let mut reader = las::Reader::from_path(&path).expect("a LAS file");
        let points: Vec<_> = reader.points().collect::<las::Result<_>>().expect("points");
        assert_eq!(points.len(), 10_003);
        let blocks: std::collections::BTreeSet<_> =
            points.iter().map(|p| [p.x, p.y].map(|v| (v / BLOCK_M).floor() as i64)).collect();
        assert!(blocks.contains(&[0, 0]) && blocks.contains(&[1, 1]) && !blocks.contains(&[2, 2]), "{blocks:?}");
    }
}
