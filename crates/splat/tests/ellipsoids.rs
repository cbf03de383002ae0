//! Ellipsoids on the grid against brute force that shares no formula with the raster: places drawn inside by the
//! definition, and distances of whole boxes by least squares.
//!
//! `SLICEWALK_SPLAT_PLACES` sets the number of places and boxes per scene (default 10,000).

use slicewalk_base::frame::Frame;
use slicewalk_splat::Splat;
use slicewalk_splat::ellipsoid::Ellipsoid;
use slicewalk_splat::raster::{EllipsoidRaster, Piece};
use std::collections::HashMap;

struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 ^ self.0 >> 31).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

const OPACITY: f64 = 0.1;

fn places() -> usize {
    std::env::var("SLICEWALK_SPLAT_PLACES").ok().and_then(|text| text.parse().ok()).unwrap_or(10_000)
}

fn splats(count: usize, seed: u64, far: f64) -> Vec<Splat> {
    let random = &mut Random(seed);
    (0..count)
        .map(|n| {
            let mut scale = [0; 3].map(|_| random.between(-5.0, -1.0).exp() as f32);
            match n % 6 {
                // Flat discs, some without any thickness, and needles.
                0 => scale[n / 6 % 3] *= 0.01,
                1 => scale[n / 6 % 3] = 0.0,
                2 => (scale[0], scale[1]) = (scale[0] * 0.01, scale[1] * 0.001),
                _ => {}
            }
            // Every fifth splat is aligned with the axes.
            let rotation = match n % 5 {
                0 => [1.0, 0.0, 0.0, 0.0],
                1 => [0.5, 0.5, 0.5, 0.5],
                _ => {
                    let q = [0; 4].map(|_| random.between(-1.0, 1.0));
                    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
                    q.map(|v| (v / length) as f32)
                }
            };
            let mean = [0; 3].map(|_| far + random.between(-2.0, 2.0));
            Splat { mean, scale, rotation, opacity: random.between(0.05, 1.0) as f32, colour: [0; 3] }
        })
        .collect()
}

/// Pieces by pixel.
type Pieces = HashMap<(i64, i64), Vec<Piece>>;

fn rasterise(splat: &Splat, frame: Frame) -> Pieces {
    let mut pieces = Pieces::new();
    let Some(ellipsoid) = Ellipsoid::of(splat, OPACITY) else { return pieces };
    let placed = EllipsoidRaster::new(frame, 45.0).place(&ellipsoid).expect("finite");
    assert!(placed.is_on_grid());
    for j in placed.rows().0..=placed.rows().1 {
        placed.for_each_pixel(j, |piece| pieces.entry((piece.i, j)).or_default().push(piece));
    }
    assert!(pieces.values().all(|all| all.len() == 1), "each pixel once");
    pieces
}

/// Matrix with the columns of a rotation, from the quaternion by the sandwich product.
fn rotated(q: [f32; 4], v: [f64; 3]) -> [f64; 3] {
    let mut q = q.map(f64::from);
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q = q.map(|v| v / length);
    let product = |a: [f64; 4], b: [f64; 4]| {
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    };
    let [_, x, y, z] = product(product(q, [0.0, v[0], v[1], v[2]]), [q[0], -q[1], -q[2], -q[3]]);
    [x, y, z]
}

/// Reach of the level set, in standard deviations.
fn reach(splat: &Splat) -> Option<f64> {
    let squared = 2.0 * (f64::from(splat.opacity) / OPACITY).ln();
    (squared >= 0.0).then(|| squared.sqrt())
}

/// A place of the level set, often on its border, where errors show; `unit` is in the unit ball.
fn place_of(splat: &Splat, unit: [f64; 3], reach: f64) -> [f64; 3] {
    let offset = rotated(splat.rotation, [0, 1, 2].map(|k| unit[k] * reach * f64::from(splat.scale[k])));
    [0, 1, 2].map(|axis| splat.mean[axis] + offset[axis])
}

fn in_ball(random: &mut Random) -> [f64; 3] {
    let v = [0; 3].map(|_| random.between(-1.0, 1.0));
    let length = v.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
    let radius = if random.next() < 0.5 { 1.0 - 1e-12 } else { random.next().cbrt() };
    v.map(|v| v / length * radius)
}

fn frames() -> [Frame; 3] {
    [(0.1, 0.3), (0.03, 0.03), (0.25, 0.05)].map(|(pixel, slice)| Frame::new(pixel, slice).unwrap())
}

#[test]
fn no_place_of_a_level_set_is_missed() {
    let each = places() / 100;
    let (mut tested, mut missed) = (0u64, 0u64);
    for (scene, far) in [(1, 0.0), (2, 1.0e6), (3, -3.0e5)] {
        for frame in frames() {
            let random = &mut Random(scene + 10);
            for splat in splats(100, scene, far) {
                let Some(reach) = reach(&splat) else { continue };
                let pieces = rasterise(&splat, frame);
                for _ in 0..each {
                    let p = place_of(&splat, in_ball(random), reach);
                    tested += 1;
                    let found = pieces.get(&(frame.pixel_of(p[0]), frame.pixel_of(p[1])));
                    let hit = found.is_some_and(|found| {
                        found[0].bottom <= frame.quantum_floor(p[2]) && frame.quantum_ceil(p[2]) <= found[0].top
                    });
                    missed += u64::from(!hit);
                }
            }
        }
    }
    println!("{tested} places, {missed} missed");
    assert!(tested as usize >= 7 * places());
    assert_eq!(missed, 0);
}

/// The linear map that makes the level set of a splat, grown to 2⁻¹⁶ of its longest axis, the unit ball: columns for x, y
/// and z.
fn to_unit_ball(splat: &Splat, reach: f64) -> [[f64; 3]; 3] {
    let scale = splat.scale.map(f64::from);
    let least = scale.iter().fold(0.0, |a: f64, &b| a.max(b)) / 65536.0;
    let [w, x, y, z] = splat.rotation;
    [0, 1, 2].map(|axis| {
        let unit = [0, 1, 2].map(|other| f64::from(u8::from(other == axis)));
        let turned = rotated([w, -x, -y, -z], unit);
        [0, 1, 2].map(|k| turned[k] / (reach * scale[k].max(least)))
    })
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Least squared distance of a box from the centre, both as offsets from it, in the measure of the unit ball.
///
/// The box is convex, so the nearest place is the nearest one of its inside, a face, an edge or a corner: every one of them
/// is asked, by least squares.
fn least_distance(columns: &[[f64; 3]; 3], low: [f64; 3], high: [f64; 3]) -> f64 {
    let mut best = f64::INFINITY;
    for number in 0..27 {
        let side = [number % 3, number / 3 % 3, number / 9];
        let mut p = [0, 1, 2].map(|axis| if side[axis] == 1 { low[axis] } else { high[axis] });
        let at = |p: [f64; 3]| [0, 1, 2].map(|k| (0..3).map(|axis| columns[axis][k] * p[axis]).sum::<f64>());
        let free: Vec<usize> = (0..3).filter(|&axis| side[axis] == 0).collect();
        free.iter().for_each(|&axis| p[axis] = 0.0);
        // Modified Gram-Schmidt, twice, of the free columns and the fixed part.
        let mut rest = at(p);
        let mut basis: Vec<[f64; 3]> = Vec::new();
        let mut upper = [[0.0; 3]; 3];
        for (n, &axis) in free.iter().enumerate() {
            let mut v = columns[axis];
            for _ in 0..2 {
                for (m, q) in basis.iter().enumerate() {
                    let part = dot(*q, v);
                    upper[m][n] += part;
                    v = [0, 1, 2].map(|k| v[k] - part * q[k]);
                }
            }
            upper[n][n] = dot(v, v).sqrt();
            basis.push(v.map(|v| v / upper[n][n]));
        }
        let mut parts = [0.0; 3];
        for _ in 0..2 {
            for (m, q) in basis.iter().enumerate() {
                let part = dot(*q, rest);
                parts[m] += part;
                rest = [0, 1, 2].map(|k| rest[k] - part * q[k]);
            }
        }
        let mut solution = [0.0; 3];
        for n in (0..free.len()).rev() {
            let known: f64 = (n + 1..free.len()).map(|m| upper[n][m] * solution[m]).sum();
            solution[n] = (-parts[n] - known) / upper[n][n];
            p[free[n]] = solution[n].clamp(low[free[n]], high[free[n]]);
        }
        // A place that had to be moved into the box is one of it all the same.
        let found = at(p);
        best = best.min(dot(found, found));
    }
    best
}

/// Every quantum at the ends of a height interval reaches the level set, those beyond do not, nor do pixels without one.
#[test]
fn heights_end_where_the_level_set_ends() {
    let (mut tested, mut phantoms, mut missed) = (0u64, 0u64, 0u64);
    for (scene, far) in [(4, 0.0), (5, 1000.0)] {
        let mut of_scene = 0;
        let mut seed = scene * 1000;
        while of_scene < places() {
            seed += 1;
            for (frame, splat) in frames().into_iter().cycle().zip(splats(60, seed, far)) {
                let Some(reach) = reach(&splat).filter(|reach| *reach > 1e-3) else { continue };
                let pieces = rasterise(&splat, frame);
                let columns = to_unit_ball(&splat, reach);
                let longest = reach * splat.scale.iter().fold(0.0, |a: f64, &b| a.max(f64::from(b)));
                // The rounding that the raster states, and that of these tests.
                let slack = 4e-9 * longest + 1e-12 + 1e-15 * far;
                let distance = |(i, j): (i64, i64), (bottom, top): (f64, f64), slack: f64| {
                    let low = [frame.edge_of_pixel(i), frame.edge_of_pixel(j), bottom];
                    let high = [low[0] + frame.pixel_m(), low[1] + frame.pixel_m(), top];
                    let ends = |p: [f64; 3], slack: f64| [0, 1, 2].map(|axis| p[axis] - splat.mean[axis] + slack);
                    least_distance(&columns, ends(low, -slack), ends(high, slack))
                };
                let quantum = frame.quantum_m();
                let heights = |from: i64| (from as f64 * quantum, (from + 1) as f64 * quantum);
                let mut keys: Vec<_> = pieces.keys().copied().collect();
                keys.sort_unstable();
                let step = keys.len().div_ceil(400);
                for pixel in keys.into_iter().step_by(step) {
                    let Piece { bottom, top, .. } = pieces[&pixel][0];
                    of_scene += 4;
                    for inner in [top - 1, bottom] {
                        phantoms += u64::from(distance(pixel, heights(inner), slack) > 1.0 + 1e-6);
                    }
                    for outer in [top, bottom - 1] {
                        missed += u64::from(distance(pixel, heights(outer), -slack) < 1.0 - 1e-6);
                    }
                    for beside in [-1, 1].into_iter().flat_map(|d| [(pixel.0 + d, pixel.1), (pixel.0, pixel.1 + d)]) {
                        if !pieces.contains_key(&beside) {
                            of_scene += 1;
                            let all = (splat.mean[2] - 10.0, splat.mean[2] + 10.0);
                            missed += u64::from(distance(beside, all, -slack) < 1.0 - 1e-6);
                        }
                    }
                }
            }
        }
        tested += of_scene as u64;
    }
    println!("{tested} boxes, {missed} missed, {phantoms} phantoms");
    assert_eq!((missed, phantoms), (0, 0));
}

#[test]
fn a_splat_at_the_threshold_is_solid_at_its_centre() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let mean = [0.55, 0.25, 0.31];
    let mut splat = Splat { mean, scale: [0.2; 3], rotation: [1.0, 0.0, 0.0, 0.0], opacity: 0.5, colour: [0; 3] };
    assert!(Ellipsoid::of(&splat, 0.500001).is_none());
    for scale in [0.2, 0.0] {
        splat.scale = [scale; 3];
        let placed = EllipsoidRaster::new(frame, 45.0).place(&Ellipsoid::of(&splat, 0.5).unwrap()).unwrap();
        let mut found = Vec::new();
        (placed.rows().0..=placed.rows().1).for_each(|j| placed.for_each_pixel(j, |piece| found.push((j, piece))));
        let [(2, Piece { i: 5, bottom, top, .. })] = found[..] else { panic!("{found:?}") };
        assert!(bottom <= frame.quantum_floor(mean[2]) && frame.quantum_ceil(mean[2]) <= top && top - bottom <= 2);
    }
}

#[test]
fn shapes_that_are_no_ellipsoids_are_refused_and_rows_beyond_one_are_empty() {
    let unit = [1.0, 0.0, 0.0, 0.0];
    for (rotation, radii) in [
        ([0.0; 4], [1.0; 3]),
        ([f64::NAN; 4], [1.0; 3]),
        ([f64::MAX; 4], [1.0; 3]),
        (unit, [1.0, -1.0, 1.0]),
        (unit, [1.0, f64::NAN, 1.0]),
        (unit, [1.0, f64::INFINITY, 1.0]),
    ] {
        assert!(Ellipsoid::new([0.0; 3], rotation, radii).is_none(), "{rotation:?} {radii:?}");
    }
    let ball = Ellipsoid::new([0.0; 3], unit, [1.0; 3]).unwrap();
    let placed = EllipsoidRaster::new(Frame::new(0.1, 0.3).unwrap(), 45.0).place(&ball).unwrap();
    for j in [placed.rows().0 - 1, placed.rows().1 + 1] {
        placed.for_each_pixel(j, |piece| panic!("row {j}: {piece:?}"));
    }
}

/// The raster grows by its rounding errors, and may so enter a pixel that the ellipsoid itself only touches.
#[test]
fn bounds_meet_every_pixel_where_an_edge_lies_on_a_grid_line() {
    const PIXEL_M: f64 = 0.1;
    let raster = EllipsoidRaster::new(Frame::new(PIXEL_M, 0.3).unwrap(), 45.0);
    for radius in [0.3, 1.0, 10.0] {
        for offset in [-1e-8, -1e-9, -1e-10, -1e-12, 0.0, 1e-12, 1e-10, 1e-9, 1e-8] {
            for line in [0.0, 7.0, 500_000.0] {
                let centre = [0.0, 1.0, 2.0].map(|axis| (line + axis) * PIXEL_M - radius + offset);
                let ellipsoid = Ellipsoid::new(centre, [1.0, 0.0, 0.0, 0.0], [radius; 3]).unwrap();
                let (min, max) = ellipsoid.bounds();
                let placed = raster.place(&ellipsoid).unwrap();
                for j in placed.rows().0..=placed.rows().1 {
                    placed.for_each_pixel(j, |piece| {
                        for (axis, pixel) in [piece.i, j].into_iter().enumerate() {
                            let (low, high) = (pixel as f64 * PIXEL_M, (pixel + 1) as f64 * PIXEL_M);
                            let meets = low <= max[axis] && high >= min[axis];
                            assert!(meets, "radius {radius}, offset {offset}, line {line}: {low} to {high}");
                        }
                    });
                }
            }
        }
    }
}
