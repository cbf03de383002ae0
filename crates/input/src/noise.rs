//! Noise of the heights of a scan: the residuals of planes fitted to flat parts.
//!
//! Input: all points of each sampled block ([`Survey`](super::spacing::Survey)). Output: identical bits for any order
//! of points and files and any number of threads (guarantee G4): sums are exact integers, all else is correctly rounded
//! operations in a fixed order.
//!
//! Blocks are cut into cubes, *regions*. A region counts if its points lie on a plane up to noise:
//!
//! - at least `LEAST_POINTS` points, spread over both axes and all four quarters of its base;
//! - all of them away from the bottom and top of the cube, which would clip the noise, on a plane that rises at most 1
//!   in 2;
//! - mean residuals of the quarters and thirds of its base no greater than noise explains: edges, steps and curves fail
//!   here.
//!
//! Each region yields a variance of residuals with `n − 3` degrees of freedom. The noise is the root of their lower
//! quartile: a quarter of the flat regions are no rougher, and clutter, grass or gravel that passes for flat lies above
//! it. The region size used is the one that yields the most regions.

use crate::plan::Noise;

/// Minimum number of points in a region: 9 degrees of freedom.
const LEAST_POINTS: usize = 12;
/// Minimum number of regions for a result.
const LEAST_REGIONS: u64 = 20;
/// Units per region edge in which positions are counted.
const UNITS: f64 = (1u64 << 20) as f64;
/// Units at the bottom and at the top of a region in which no point may lie: an eighth of its height.
const MARGIN: i64 = 1 << 17;
/// Minimum variance along x and y relative to an even spread, and minimum determinant relative to their product.
const LEAST_SPREAD: f64 = 0.5;
/// Maximum slope of the plane, rise over run, squared.
const MOST_RISE_SQUARED: f64 = 0.25;
/// Number of non-planar shapes visible in mean residuals of parts: bent along x, bent along y, twisted.
const SHAPES: f64 = 3.0;
/// Maximum mean square per shape, in variances of the remaining residuals. Noise alone exceeds it in about one of
/// twenty regions (the F-test of nested models).
const MOST_SHAPE: f64 = 4.0;

/// Points of the blocks of one size: cubes with this edge (m), a power of two.
pub(super) struct Blocks<'a> {
    pub edge_m: f64,
    pub points: &'a [[f64; 3]],
}

/// Number of times blocks are halved.
const HALVINGS: i32 = 3;

/// Estimates the noise of heights from these samples; `None` if too little is flat.
pub(super) fn noise_of<'a>(samples: impl Iterator<Item = Blocks<'a>>) -> Option<Noise> {
    let mut best: Option<Noise> = None;
    let mut places = Vec::new();
    for Blocks { edge_m, points } in samples {
        for halvings in 0..=HALVINGS {
            let edge_m = edge_m * 0.5f64.powi(halvings);
            let cells = cut(points, edge_m, &mut places);
            // Further halving only makes the regions smaller.
            if points.len() < LEAST_POINTS.max(cells * LEAST_POINTS / 4) {
                break;
            }
            let mut variances: Vec<f64> = places.chunk_by(|a, b| a.0 == b.0).filter_map(variance).collect();
            let regions = variances.len() as u64;
            if regions < LEAST_REGIONS || best.is_some_and(|best| best.regions >= regions) {
                continue;
            }
            let quarter = variances.len() / 4;
            let (_, variance, _) = variances.select_nth_unstable_by(quarter, f64::total_cmp);
            let noise_m = variance.sqrt() / UNITS * edge_m;
            best = Some(Noise { noise_m, regions, region_m: edge_m });
        }
    }
    best
}

/// A point: its region, and its position in the region (in 2⁻²⁰ of the edge).
type Place = ([i64; 3], [i64; 3]);

/// Sets `places` to the points sorted by region; returns the number of regions.
fn cut(points: &[[f64; 3]], edge_m: f64, places: &mut Vec<Place>) -> usize {
    places.clear();
    places.extend(points.iter().map(|point| {
        // Exact: the edge is a power of two, and the fraction has no more digits than the number.
        let scaled = point.map(|v| v / edge_m);
        let region = scaled.map(f64::floor);
        (region.map(|v| v as i64), [0, 1, 2].map(|axis| ((scaled[axis] - region[axis]) * UNITS) as i64))
    }));
    places.sort_unstable();
    places.chunk_by(|a, b| a.0 == b.0).count()
}

/// Returns the variance of heights about a plane fitted to the points of a region; `None` if the region is not flat.
fn variance(places: &[Place]) -> Option<f64> {
    let n = places.len();
    let is_inside = |(_, [_, _, w]): &Place| (MARGIN..(1 << 20) - MARGIN).contains(w);
    if n < LEAST_POINTS || !places.iter().all(is_inside) {
        return None;
    }
    // Sums of products. Those of deviations from the means, times n, are exact, too.
    let (mut sum, mut product) = ([0i128; 3], [[0i128; 3]; 3]);
    for (_, place) in places {
        (0..3).for_each(|axis| {
            sum[axis] += i128::from(place[axis]);
            (axis..3).for_each(|other| product[axis][other] += i128::from(place[axis] * place[other]));
        });
    }
    let deviation = |axis: usize, other: usize| (n as i128 * product[axis][other] - sum[axis] * sum[other]) as f64;
    let (uu, uv, vv) = (deviation(0, 0), deviation(0, 1), deviation(1, 1));
    let (uw, vw, ww) = (deviation(0, 2), deviation(1, 2), deviation(2, 2));
    let points = n as f64;
    let even = points * points * UNITS * UNITS / 12.0;
    let determinant = uu * vv - uv * uv;
    if uu < LEAST_SPREAD * even || vv < LEAST_SPREAD * even || determinant < LEAST_SPREAD * uu * vv {
        return None;
    }
    let rise = [(uw * vv - vw * uv) / determinant, (vw * uu - uw * uv) / determinant];
    if rise[0] * rise[0] + rise[1] * rise[1] > MOST_RISE_SQUARED {
        return None;
    }
    let squares = ((ww - rise[0] * uw - rise[1] * vw) / points).max(0.0);
    let freedom = points - 3.0;
    let variance = squares / freedom;
    // Mean residuals of the quarters of the base, and of its thirds along x and along y.
    let mut parts = [(0i64, [0i64; 3]); 10];
    for (_, place) in places {
        let half = |axis: usize| (place[axis] >> 19) as usize;
        let third = |axis: usize| ((3 * place[axis]) >> 20) as usize;
        for part in [half(0) + 2 * half(1), 4 + third(0), 7 + third(1)] {
            parts[part].0 += 1;
            (0..3).for_each(|axis| parts[part].1[axis] += place[axis]);
        }
    }
    if parts[..4].iter().any(|&(count, _)| count < 2) {
        return None;
    }
    let mean = sum.map(|sum| sum as f64 / points);
    let mut shape = 0.0;
    for (count, sums) in parts.into_iter().filter(|part| part.0 > 0) {
        let count = count as f64;
        let off = [0, 1, 2].map(|axis| sums[axis] as f64 / count - mean[axis]);
        let residual = off[2] - rise[0] * off[0] - rise[1] * off[1];
        shape += count * residual * residual;
    }
    // Positions are whole units, so a variance below 1 is rounding.
    let rest = (squares - shape).max(0.0) / (freedom - SHAPES);
    if variance > 1.0 && shape > MOST_SHAPE * SHAPES * rest {
        return None;
    }
    // Variances with few degrees of freedom are skewed; this makes their median the true one (Wilson and Hilferty,
    // 1931).
    Some(variance / (1.0 - 2.0 / (9.0 * freedom)).powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the `number`-th value of an even distribution in [0, 1).
    fn random(number: u64) -> f64 {
        let mut h = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        h = (h ^ h >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        h = (h ^ h >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        (h ^ h >> 31) as f64 / u64::MAX as f64
    }

    /// `n × n` points of a plane, `step` apart, with noise of this standard deviation.
    fn floor(n: u64, step: f64, rise: f64, noise_m: f64) -> Vec<[f64; 3]> {
        let point = |at: u64| {
            let (x, y) = ((at % n) as f64 + random(7 * at), (at / n) as f64 + random(7 * at + 1));
            let normal = (0..6).map(|part| random(100_003 * part + at)).sum::<f64>() - 3.0;
            [x * step, y * step, 0.4 + rise * x * step + normal * std::f64::consts::SQRT_2 * noise_m]
        };
        (0..n * n).map(point).collect()
    }

    fn measured(points: &[[f64; 3]], edges_m: &[f64]) -> Option<Noise> {
        noise_of(edges_m.iter().map(|&edge_m| Blocks { edge_m, points }))
    }

    #[test]
    fn the_noise_of_planes_is_found_within_a_fifth_at_any_slope_and_region() {
        for (rise, noise_m) in [(0.0, 0.003), (0.1, 0.003), (0.3, 0.001), (0.0, 0.0002), (-0.2, 0.01)] {
            for edges in [&[0.25, 1.0, 4.0][..], &[0.125], &[1.0]] {
                let found = measured(&floor(200, 0.02, rise, noise_m), edges).unwrap();
                let ratio = found.noise_m / noise_m;
                assert!((0.8..1.05).contains(&ratio), "{rise} {noise_m} {edges:?}: {found:?}, {ratio}");
            }
        }
    }

    #[test]
    fn what_is_flat_without_noise_has_none() {
        let found = measured(&floor(200, 0.02, 0.125, 0.0), &[0.25, 1.0]).unwrap();
        assert!(found.noise_m < 1e-6, "{found:?}");
    }

    #[test]
    fn what_is_not_flat_does_not_count() {
        let curved: Vec<_> =
            floor(200, 0.02, 0.0, 0.0).iter().map(|&[x, y, z]| [x, y, z + (x * 40.0).sin() * 0.05]).collect();
        assert_eq!(measured(&curved, &[0.25]), None);
        let wall: Vec<_> = floor(200, 0.02, 0.0, 0.001).iter().map(|&[x, y, z]| [x, z, y]).collect();
        assert_eq!(measured(&wall, &[0.25]), None);
        assert_eq!(measured(&[], &[0.25]), None);
        assert_eq!(measured(&floor(12, 0.02, 0.0, 0.001), &[0.25]), None);
    }

    #[test]
    fn clutter_on_a_part_of_the_floor_changes_little() {
        let mut points = floor(200, 0.02, 0.0, 0.002);
        let clean = measured(&points, &[0.25]).unwrap();
        points
            .iter_mut()
            .enumerate()
            .filter(|(at, _)| at % 200 < 80)
            .for_each(|(at, p)| p[2] += 0.05 * random(at as u64 + 5));
        let found = measured(&points, &[0.25]).unwrap();
        assert!((0.8..1.2).contains(&(found.noise_m / clean.noise_m)), "{found:?} {clean:?}");
    }

    #[test]
    fn the_order_of_points_does_not_matter() {
        let mut points = floor(150, 0.02, 0.05, 0.004);
        let first = measured(&points, &[0.25, 1.0]);
        points.reverse();
        assert_eq!(measured(&points, &[0.25, 1.0]), first);
        points.sort_by_key(|p| p[2].to_bits() % 1009);
        assert_eq!(measured(&points, &[0.25, 1.0]), first);
    }
}
