//! Statistics of a scan for the automatic pixel size and tolerance: the distance of a point to its nearest neighbour,
//! and the noise of the heights.
//!
//! Input: a set of scans. Output: statistics of a sample, with identical bits for any order of points and files and any
//! number of threads (guarantee G4). Memory: below 24 MiB for any input and number of threads.
//!
//! A nearest neighbour can only be found where *all* points of a neighbourhood are kept, so the sample consists of
//! whole blocks rather than points. A block (a cube of the grid) is in the sample of round `m` if the top `m` bits of a
//! hash of its indices are zero. Whenever more than `MOST_POINTS` points are held, `m` grows by one and blocks drop
//! out. The final `m` is the smallest for which the points of all its blocks fit, which is a property of the set of
//! points. This is bottom-k sampling (Cohen and Kaplan, "Summarizing Data using Bottom-k Sketches", 2007) with a
//! rounded threshold. The best block size depends on the spacing itself, so several sizes are sampled at once and
//! `choose` picks one.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

use super::noise::{Blocks, noise_of};
use super::{InputSet, PointBatch, PointChunk, PointDecoder};
use crate::plan::Noise;
use crate::{Error, Monitor, Parameter, Result};

/// Cells per metre of the finest grid: a power of two, so that the product is exact.
const FINEST_PER_M: f64 = 64.0;
/// Block edges, as shifts of an index of the finest grid: 1/64, 1/4, 1, 4, 16, 64, 512 and 4096 m.
const SHIFTS: [u32; 8] = [0, 4, 6, 8, 10, 12, 15, 18];
/// Number of levels. The last samples single points, for scans that suit no block size.
const LEVELS: usize = SHIFTS.len() + 1;
/// Maximum number of points held per level.
const MOST_POINTS: usize = 60_000;
/// Minimum number of distinct points for a level to be chosen.
const ENOUGH_POINTS: usize = 1_000;
/// Minimum number of blocks: fewer represent only a corner of the scan.
const ENOUGH_BLOCKS: usize = 12;
/// Minimum mean number of distinct points per block.
const ENOUGH_IN_BLOCK: usize = 64;
/// Coordinates of smaller magnitude count as 0 (m).
const LEAST_M: f64 = 1e-140;
/// Points a thread collects per level before it takes the lock.
const LOCAL_POINTS: usize = 512;

/// Result of [`Survey::spacing`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spacing {
    /// Median distance from a point to its nearest neighbour at another position (m).
    pub spacing_m: f64,
    /// Number of distinct points the median covers.
    pub sampled: u64,
    /// Edge of the sampled blocks (m); 0 if single points were sampled and the spacing was inferred from them.
    pub block_m: f64,
    /// Number of kept points in the scans.
    pub points: u64,
}

/// Reads all of `set` once and estimates the distance between neighbouring points.
///
/// Fails if the scans hold fewer than two distinct points.
pub fn estimate_spacing(set: &InputSet, threads: usize, monitor: &dyn Monitor) -> Result<Spacing> {
    Survey::read(set, threads, "spacing", monitor)?.spacing()
}

/// Samples of a scan.
pub struct Survey {
    samples: Vec<Sample>,
    points: u64,
}

impl Survey {
    /// Reads all of `set` once, as a progress stage named `stage`.
    pub fn read(set: &InputSet, threads: usize, stage: &'static str, monitor: &dyn Monitor) -> Result<Self> {
        monitor.stage(stage, set.points_stated(), "points");
        let (shared, points) = sample(set, threads, monitor)?;
        Ok(Self::of(shared, points))
    }

    fn of(shared: Shared, points: u64) -> Self {
        let levels = shared.levels.map(|l| l.into_inner().unwrap_or_else(|e| e.into_inner()));
        Self {
            samples: levels.into_iter().enumerate().map(|(number, level)| Sample::of(number, level)).collect(),
            points,
        }
    }

    /// Returns the distance between neighbouring points; fails if there are fewer than two distinct points.
    pub fn spacing(&self) -> Result<Spacing> {
        choose(&self.samples, self.points).ok_or_else(|| {
            Error::parameter(
                Parameter::AutomaticPixelSize,
                "the scans hold fewer than two points apart; give the pixel size in metres",
            )
        })
    }

    /// Returns the noise of the heights; `None` if too little of the scan is flat.
    pub fn noise(&self) -> Option<Noise> {
        let blocks = self.samples.iter().filter(|sample| sample.points.len() > 1);
        noise_of(blocks.filter_map(|sample| Some(Blocks { edge_m: sample.edge_m()?, points: &sample.points })))
    }
}

/// Points of the blocks of one level, sorted and without duplicates.
struct Sample {
    level: usize,
    round: u32,
    points: Vec<[f64; 3]>,
    blocks: usize,
}

impl Sample {
    fn of(level: usize, Level { round, mut points }: Level) -> Self {
        // Squared distances between such small numbers underflow to 0, and a search among points without distances
        // never ends.
        points.as_flattened_mut().iter_mut().filter(|v| v.abs() < LEAST_M).for_each(|v| *v = 0.0);
        points.sort_unstable_by(order);
        points.dedup_by(|a, b| order(a, b).is_eq());
        let mut blocks: Vec<[i64; 3]> = points.iter().map(|&p| block_of(p, level)).collect();
        blocks.sort_unstable();
        blocks.dedup();
        Self { level, round, points, blocks: blocks.len() }
    }

    /// Returns the edge of the blocks (m); `None` if single points were sampled.
    fn edge_m(&self) -> Option<f64> {
        SHIFTS.get(self.level).map(|&shift| (1u64 << shift) as f64 / FINEST_PER_M)
    }
}

/// Samples all levels; also returns the number of kept points.
fn sample(set: &InputSet, threads: usize, monitor: &dyn Monitor) -> Result<(Shared, u64)> {
    let shared = Shared::default();
    let chunks = Mutex::new(set.chunks());
    let failed = AtomicBool::new(false);
    let points = AtomicUsize::new(0);
    let work = || -> Result<()> {
        let (mut decoder, mut local) = (PointDecoder::new(), Local::default());
        while !failed.load(Ordering::Relaxed) {
            let next: Option<PointChunk> = chunks.lock().unwrap_or_else(|e| e.into_inner()).next();
            let Some(chunk) = next else { break };
            let counts = decoder.decode(set, &chunk, &mut |batch| {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                local.take(batch, &shared);
                monitor.advance(batch.len() as u64);
                Ok(())
            })?;
            points.fetch_add(counts.kept() as usize, Ordering::Relaxed);
        }
        local.flush(&shared);
        Ok(())
    };
    let guarded = || work().inspect_err(|_| failed.store(true, Ordering::Relaxed));
    let outcomes: Vec<Result<()>> = std::thread::scope(|scope| {
        // If the system starts fewer threads than requested, those do all the work.
        let start = |_| crate::bytes::spawn_in(scope, guarded).ok();
        let threads: Vec<_> = (1..threads.max(1)).map_while(start).collect();
        let mut outcomes = vec![guarded()];
        outcomes.extend(threads.into_iter().map(|t| t.join().unwrap_or_else(|p| std::panic::resume_unwind(p))));
        outcomes
    });
    outcomes.into_iter().collect::<Result<()>>()?;
    Ok((shared, points.into_inner() as u64))
}

/// Hash whose top bits decide whether a block is sampled: the SplitMix64 finaliser over a weighted sum.
#[inline(always)]
fn mix(block: [i64; 3], level: usize) -> u64 {
    let mut h = (block[0] as u64)
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add((block[1] as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F))
        .wrapping_add((block[2] as u64).wrapping_mul(0x1656_67B1_9E37_79F9))
        .wrapping_add((level as u64).wrapping_mul(0x27D4_EB2F_1656_67C5));
    h = (h ^ h >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ h >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    h ^ h >> 31
}

/// Returns the block of `point` at `level`; at the last level, the bits of the point itself.
#[inline(always)]
fn block_of(point: [f64; 3], level: usize) -> [i64; 3] {
    match SHIFTS.get(level) {
        // Adding 0 turns -0 into 0.
        None => point.map(|v| (v + 0.0).to_bits() as i64),
        Some(shift) => finest(point).map(|index| index >> shift),
    }
}

/// Returns the indices on the finest grid. `f64::floor` would be a function call on the oldest x86-64, three times as
/// slow.
#[inline(always)]
fn finest(point: [f64; 3]) -> [i64; 3] {
    point.map(|v| {
        let scaled = v * FINEST_PER_M;
        let toward_zero = scaled as i64;
        toward_zero - i64::from(scaled < toward_zero as f64)
    })
}

fn hash_of(point: [f64; 3], level: usize) -> u64 {
    mix(block_of(point, level), level)
}

/// One level of the sample.
#[derive(Default)]
struct Level {
    /// A block is sampled if its hash has at least this many leading zeros; from 64 on the level stays empty.
    round: u32,
    points: Vec<[f64; 3]>,
}

impl Level {
    fn add(&mut self, level: usize, points: &[[f64; 3]]) {
        for &point in points {
            if hash_of(point, level).leading_zeros() < self.round || self.round >= 64 {
                continue;
            }
            self.points.push(point);
            while self.points.len() > MOST_POINTS {
                self.round += 1;
                let round = self.round;
                self.points.retain(|&p| round < 64 && hash_of(p, level).leading_zeros() >= round);
            }
        }
    }
}

#[derive(Default)]
struct Shared {
    levels: [Mutex<Level>; LEVELS],
    /// Copies of the rounds, which may lag behind: a filter before the lock.
    rounds: [AtomicU32; LEVELS],
}

/// Points a thread has collected since it last took the lock.
#[derive(Default)]
struct Local {
    points: [Vec<[f64; 3]>; LEVELS],
    /// Indices of the batch on the finest grid.
    finest: Vec<[i64; 3]>,
}

impl Local {
    fn take(&mut self, batch: &PointBatch, shared: &Shared) {
        let point = |i: usize| [batch.x[i], batch.y[i], batch.z[i]];
        self.finest.clear();
        self.finest.extend((0..batch.len()).map(|i| finest(point(i))));
        for (level, held) in self.points.iter_mut().enumerate() {
            let mut round = shared.rounds[level].load(Ordering::Relaxed);
            if round >= 64 {
                continue;
            }
            let mut offer = |i: usize, hash: u64| {
                if hash.leading_zeros() >= round {
                    held.push(point(i));
                    if held.len() >= LOCAL_POINTS {
                        round = hand_over(held, level, shared);
                    }
                }
            };
            match SHIFTS.get(level) {
                Some(shift) => self.finest.iter().enumerate().for_each(|(i, index)| {
                    offer(i, mix(index.map(|v| v >> shift), level));
                }),
                None => (0..batch.len()).for_each(|i| offer(i, hash_of(point(i), level))),
            }
        }
    }

    fn flush(&mut self, shared: &Shared) {
        for (level, held) in self.points.iter_mut().enumerate() {
            hand_over(held, level, shared);
        }
    }
}

fn hand_over(held: &mut Vec<[f64; 3]>, level: usize, shared: &Shared) -> u32 {
    let mut into = shared.levels[level].lock().unwrap_or_else(|e| e.into_inner());
    into.add(level, held);
    held.clear();
    shared.rounds[level].store(into.round, Ordering::Relaxed);
    into.round
}

/// Chooses the smallest blocks that hold enough points each. Smaller blocks are more numerous and so represent more of
/// the scan, whose density varies by orders of magnitude: with them, eight real scans came within 12 % of their exact
/// median; with the largest blocks, the error reached a factor of 2.2. Blocks with fewer points lose too many
/// neighbours at their faces. Fallbacks, in this order: blocks that hold the whole scan; few blocks; single points,
/// whose distances grow by √2 for each halving of the sample, as on a surface.
fn choose(samples: &[Sample], points: u64) -> Option<Spacing> {
    let result = |sample: &Sample, factor: f64| {
        let spacing_m = median_distance(&sample.points)? * factor;
        Some(Spacing {
            spacing_m,
            sampled: sample.points.len() as u64,
            block_m: sample.edge_m().unwrap_or(0.0),
            points,
        })
    };
    let crowded = |least: usize| {
        move |sample: &&Sample| sample.points.len() >= ENOUGH_POINTS.max(least * sample.blocks) && sample.blocks > 0
    };
    let (single, blocks) = samples.split_last()?;
    let best = blocks
        .iter()
        .filter(|sample| sample.blocks >= ENOUGH_BLOCKS)
        .find(crowded(ENOUGH_IN_BLOCK))
        .or_else(|| blocks.iter().rfind(|sample| sample.round == 0 && sample.points.len() > 1))
        .or_else(|| blocks.iter().find(crowded(ENOUGH_IN_BLOCK / 2)));
    match best {
        Some(sample) => result(sample, 1.0),
        None => result(single, 0.5f64.powi(single.round as i32).sqrt()),
    }
}

fn order(a: &[f64; 3], b: &[f64; 3]) -> std::cmp::Ordering {
    let key = |p: &[f64; 3]| p.map(|v| v + 0.0);
    let (a, b) = (key(a), key(b));
    a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
}

/// Returns the median (of an even number, the lower) distance from each of the distinct `points` to its nearest other.
fn median_distance(points: &[[f64; 3]]) -> Option<f64> {
    if points.len() < 2 {
        return None;
    }
    let mut tree = points.to_vec();
    build(&mut tree, 0);
    let mut squares: Vec<f64> = points
        .iter()
        .map(|p| {
            let mut least = f64::INFINITY;
            nearest(&tree, 0, p, &mut least);
            least
        })
        .collect();
    let middle = (squares.len() - 1) / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    Some(median.sqrt())
}

/// Arranges `points` as a k-d tree (Bentley, 1975): the median splits along the axis of its depth.
fn build(points: &mut [[f64; 3]], depth: usize) {
    if points.len() < 2 {
        return;
    }
    let middle = points.len() / 2;
    let axis = depth % 3;
    points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    let (below, rest) = points.split_at_mut(middle);
    build(below, depth + 1);
    build(&mut rest[1..], depth + 1);
}

fn nearest(tree: &[[f64; 3]], depth: usize, from: &[f64; 3], least: &mut f64) {
    if tree.is_empty() {
        return;
    }
    let middle = tree.len() / 2;
    let at = &tree[middle];
    let square: f64 = (0..3).map(|a| (at[a] - from[a]) * (at[a] - from[a])).sum();
    if square > 0.0 && square < *least {
        *least = square;
    }
    let ahead = from[depth % 3] - at[depth % 3];
    let (below, above) = (&tree[..middle], &tree[middle + 1..]);
    let (near, far) = if ahead < 0.0 { (below, above) } else { (above, below) };
    nearest(near, depth + 1, from, least);
    if ahead * ahead < *least {
        nearest(far, depth + 1, from, least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survey(points: &[[f64; 3]]) -> Survey {
        let shared = Shared::default();
        for part in points.chunks(1000) {
            let mut local = Local::default();
            let column = |axis: usize| part.iter().map(|p| p[axis]).collect();
            local.take(&PointBatch { x: column(0), y: column(1), z: column(2), ..PointBatch::default() }, &shared);
            local.flush(&shared);
        }
        Survey::of(shared, points.len() as u64)
    }

    fn estimate(points: &[[f64; 3]]) -> Option<Spacing> {
        survey(points).spacing().ok()
    }

    /// A floor of `n × n` points `step` apart, each scattered by up to a quarter of `step`.
    fn floor(n: i64, step: f64) -> Vec<[f64; 3]> {
        let scatter = |i, j, a| (mix([i, j, a], 99) >> 40) as f64 / (1u64 << 24) as f64 * 0.5 - 0.25;
        let point = |i: i64, j: i64| {
            [0, 1, 2].map(|a| (([i, j, 0][a as usize]) as f64 + scatter(i, j, a)) * step + 1000.0 * step)
        };
        (0..n).flat_map(|i| (0..n).map(move |j| point(i, j))).collect()
    }

    #[test]
    fn points_whose_distances_vanish_are_one_point() {
        let tiny: Vec<_> = (0..200).flat_map(|i| (0..200).map(move |j| [f64::from(i), f64::from(j), 0.0])).collect();
        let tiny: Vec<_> = tiny.into_iter().map(|p| p.map(|v| v * 1e-300)).collect();
        assert_eq!(estimate(&tiny), None);
        let far = [tiny, vec![[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]].concat();
        assert_eq!(estimate(&far).map(|spacing| spacing.spacing_m), Some(1.0));
    }

    #[test]
    fn the_order_of_points_does_not_matter() {
        let mut points = floor(400, 0.02);
        let first = estimate(&points).unwrap();
        points.reverse();
        assert_eq!(estimate(&points).unwrap(), first);
        points.sort_by_key(|&p| mix(block_of(p, SHIFTS.len()), 7));
        assert_eq!(estimate(&points).unwrap(), first);
    }

    #[test]
    fn spacings_from_a_tenth_of_a_millimetre_to_a_kilometre_are_found() {
        for step in [1e-4, 1e-3, 0.01, 0.3, 2.0, 50.0, 1000.0] {
            let found = estimate(&floor(600, step)).unwrap();
            let ratio = found.spacing_m / step;
            assert!((0.4..1.1).contains(&ratio), "{step}: {found:?}");
        }
    }

    #[test]
    fn few_or_equal_points_are_told() {
        assert!(estimate(&[]).is_none());
        assert!(estimate(&[[1.0, 2.0, 3.0]; 100]).is_none());
        assert!(estimate(&vec![[1.0, 2.0, 3.0]; 100_000]).is_none());
        let two = estimate(&[[0.0; 3], [0.0, 3.0, 4.0], [0.0; 3]]).unwrap();
        assert_eq!((two.spacing_m, two.sampled), (5.0, 2));
        let twice: Vec<_> = floor(100, 0.1).into_iter().flat_map(|p| [p, p]).collect();
        assert_eq!(estimate(&twice).unwrap().spacing_m, estimate(&floor(100, 0.1)).unwrap().spacing_m);
    }
}
