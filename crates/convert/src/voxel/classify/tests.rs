use super::*;
use crate::frame::Frame;
use crate::plan::PlanOptions;
use crate::voxel::bands::Bands;
use crate::voxel::record::{PATCH_PIXELS, Record, Recorder};

const T: f64 = 0.05;

fn plan(classifier: Classifier, max_slope_deg: f64) -> Plan {
    plan_of_slices(classifier, max_slope_deg, 3.0)
}

/// Generator of uniform numbers in 0..1 and of nearly normal ones.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// The voxels of tile (0, 0), which holds `points`.
fn folded(plan: &Plan, points: impl Iterator<Item = [f64; 3]>) -> (Patch, Sums) {
    let recorder = Recorder::new(plan.frame);
    let mut records: Vec<Record> = Vec::new();
    for [x, y, z] in points {
        recorder.record(&[x], &[y], &[z], |index, record| {
            if (index.tx, index.ty) == (0, 0) {
                records.push(record);
            }
        });
    }
    let (mut patch, mut sums) = (Patch::default(), Sums::new(Bands::new(plan)));
    patch.fold(&records[..], 1, Area::TILE, &mut sums);
    (patch, sums)
}

/// Share of obstacles among the voxels of the inner pixels of tile (0, 0), which holds `points`.
fn obstacle_share(plan: &Plan, points: impl Iterator<Item = [f64; 3]>) -> f64 {
    obstacle_share_between(plan, points, (4, 60))
}

/// Share of obstacles among the pixels `x.0..x.1`.
fn obstacle_share_between(plan: &Plan, points: impl Iterator<Item = [f64; 3]>, x: (u32, u32)) -> f64 {
    let (patch, mut sums) = folded(plan, points);
    let inner = Area { x, y: (4, 60) };
    let mut voxel_classes = VoxelClasses::default();
    VoxelClassifier::new(plan).classify(&patch, &mut sums, inner, &mut voxel_classes);
    let (mut all, mut obstacles) = (0, 0);
    for pixel in patch.occupied().filter(|&pixel| inner.holds(pixel)) {
        for number in patch.range(pixel) {
            all += 1;
            obstacles += usize::from(voxel_classes[number]);
        }
    }
    f64::from(obstacles as u32) / f64::from(all)
}

fn plane(slope_deg: f64, heading_deg: f64, per_edge: f64, noise: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let (slope, heading) = (slope_deg.to_radians(), heading_deg.to_radians());
    let edge = 64.0 * T;
    // Uniform on the plane itself, like the points of a scanner at a fair distance.
    let count = (64.0 * per_edge).powi(2) / slope.cos().max(0.05);
    let phase = random.uniform() * 3.0 * T;
    (0..count as usize)
        .map(|_| {
            let (x, y) = (random.uniform() * edge, random.uniform() * edge);
            let along = (x - edge / 2.0) * heading.cos() + (y - edge / 2.0) * heading.sin();
            let z = phase + along * slope.tan();
            let off = noise * random.normal();
            let (nx, nz) = (-slope.sin(), slope.cos());
            [x + off * nx * heading.cos(), y + off * nx * heading.sin(), z + off * nz]
        })
        .collect()
}

#[test]
#[ignore = "slow: .ci/run"]
fn the_plane_rule_flips_at_the_limit_within_three_degrees_for_every_heading_and_phase() {
    let mut random = Random(7);
    for limit in [30.0, 45.0] {
        let plan = plan(Classifier::Plane, limit);
        for noise in [0.0, 0.002] {
            for heading in [0.0, 15.0, 30.0, 45.0, 77.0, 90.0, 200.0] {
                for (slope, obstacle) in [
                    (0.0, false),
                    (limit - 10.0, false),
                    (limit - 3.0, false),
                    (limit + 3.0, true),
                    (limit + 8.0, true),
                    (limit + 15.0, true),
                    (75.0, true),
                    (85.0, true),
                ] {
                    let share = obstacle_share(&plan, plane(slope, heading, 2.0, noise, &mut random).into_iter());
                    let right = if obstacle { share } else { 1.0 - share };
                    assert!(right >= 0.95, "limit {limit} slope {slope} heading {heading} noise {noise}: {right}");
                }
            }
        }
    }
}

#[test]
fn what_is_floor_without_a_fit_is_floor_by_the_fit_too() {
    let mut random = Random(31);
    let edge = 64.0 * T;
    for (limit, noise) in [(30.0, 0.002), (45.0, 0.004), (45.0, 0.012), (60.0, 0.02), (80.0, 0.03)] {
        let plan = plan(Classifier::Plane, limit);
        // From a point in three pixels to ten in one: densities that hardly determine a plane, and ones that do.
        let points: Vec<_> = (0..12_000)
            .map(|_| {
                let (x, y) = (random.uniform() * edge, random.uniform().powi(3) * edge);
                let step = f64::from((x * 3.0) as u32) * 0.05 + x * 0.2;
                [x, y, step + noise * random.normal()]
            })
            .collect();
        let with = VoxelClassifier::new(&plan);
        let mut without = with;
        without.surfaces.level = -1;
        let (patch, mut sums) = folded(&plan, points.into_iter());
        let [mut fast, mut full] = [VoxelClasses::default(), VoxelClasses::default()];
        with.classify(&patch, &mut sums, Area::TILE, &mut fast);
        without.classify(&patch, &mut sums, Area::TILE, &mut full);
        assert!(*fast == *full, "limit {limit}, noise {noise}");
        assert!(full.contains(&false), "the test would show nothing");
    }
}

#[test]
fn ground_fitted_in_one_go_gets_the_verdicts_of_single_fits() {
    let mut random = Random(37);
    let edge = 64.0 * T;
    let mut steep = 0;
    for (limit, slice, noise) in [(20.0, 3.0, 0.3), (45.0, 3.0, 0.2), (45.0, 0.7, 0.25), (60.0, 6.0, 0.5)] {
        let options = PlanOptions { max_slope_deg: limit, ..PlanOptions::default() };
        let plan = Plan { frame: Frame::new(T, slice * T).unwrap(), options };
        // Ground that gets steeper, a wall, and leaves above both.
        let points: Vec<_> = (0..9_000)
            .map(|number| {
                let (x, y) = (random.uniform() * edge, random.uniform() * edge);
                let ground = 0.6 * x * x / edge + noise * T * random.normal();
                let above = match number % 16 {
                    0 => random.uniform() * edge / 4.0,
                    1 if y > edge / 2.0 => 20.0 * T + noise * T * random.normal(),
                    _ => 0.0,
                };
                [x, y, ground + above]
            })
            .collect();
        let classify = VoxelClassifier::new(&plan);
        let mut one_by_one = classify;
        one_by_one.least_windows = usize::MAX;
        let (patch, mut sums) = folded(&plan, points.into_iter());
        let [mut at_once, mut single] = [VoxelClasses::default(), VoxelClasses::default()];
        classify.classify(&patch, &mut sums, Area::TILE, &mut at_once);
        one_by_one.classify(&patch, &mut sums, Area::TILE, &mut single);
        assert!(*at_once == *single, "limit {limit}, slices of {slice} pixels");
        assert!(sums.few_by_pixel().is_some() && sums.lowest_band().is_some(), "the test would show nothing");
        steep += single.iter().filter(|&&voxel_class| voxel_class).count();
    }
    assert!(steep > 1000, "{steep}");
}

#[test]
fn a_flat_floor_on_a_slice_boundary_is_floor() {
    let mut random = Random(3);
    for classifier in [Classifier::Plane, Classifier::Span] {
        let edge = 64.0 * T;
        let points = (0..60_000).map(|_| [random.uniform() * edge, random.uniform() * edge, 0.002 * random.normal()]);
        assert_eq!(obstacle_share(&plan(classifier, 45.0), points.collect::<Vec<_>>().into_iter()), 0.0);
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_slab_scanned_from_above_and_below_is_floor_wherever_its_slices_begin() {
    let mut random = Random(17);
    let edge = 64.0 * T;
    for phase in 0..16 {
        for thickness in [0.08, 0.12, 0.2, 0.25, 0.3] {
            let top = f64::from(phase) * 3.0 * T / 16.0;
            let points: Vec<_> = (0..40_000)
                .map(|n| {
                    let z = if n % 2 == 0 { top } else { top - thickness };
                    [random.uniform() * edge, random.uniform() * edge, z + 0.003 * random.normal()]
                })
                .collect();
            for classifier in [Classifier::Plane, Classifier::Span] {
                let share = obstacle_share(&plan(classifier, 45.0), points.iter().copied());
                assert!(share < 0.01, "{classifier:?}, {thickness} m thick, top at {top}: {share}");
            }
        }
    }
}

#[test]
fn a_slab_beside_a_wall_is_floor_up_to_the_wall() {
    let mut random = Random(23);
    let edge = 64.0 * T;
    for (slab, wall) in [(40_000, 4_000), (40_000, 12_000), (150_000, 40_000)] {
        for thickness in [0.2, 0.25] {
            let mut points: Vec<_> = (0..slab)
                .map(|n| {
                    let z = if n % 2 == 0 { 0.3 } else { 0.3 - thickness };
                    [random.uniform() * 1.6, random.uniform() * edge, z + 0.002 * random.normal()]
                })
                .collect();
            // The wall fills pixel 32, from 1.60 to 1.65 m.
            points.extend((0..wall).map(|_| [1.61, random.uniform() * edge, random.uniform() * 2.4 - 1.2]));
            for classifier in [Classifier::Plane, Classifier::Span] {
                let share = |x| obstacle_share_between(&plan(classifier, 45.0), points.iter().copied(), x);
                let (beside, own) = (share((31, 32)), share((32, 33)));
                assert!(beside < 0.02, "{classifier:?}, {thickness} m, {wall} points: {beside} beside the wall");
                assert!(
                    own > 0.9 || classifier == Classifier::Span,
                    "{classifier:?}, {thickness} m, {wall} points: {own} of the wall"
                );
            }
        }
    }
}

#[test]
fn stairs_are_floor_and_their_risers_are_not() {
    let mut random = Random(5);
    let edge = 64.0 * T;
    let height = |x: f64| (x / 0.3).floor() * 0.18;
    let treads: Vec<_> = (0..80_000)
        .map(|_| (random.uniform() * edge, random.uniform() * edge))
        .map(|(x, y)| [x, y, height(x)])
        .collect();
    let share = obstacle_share(&plan(Classifier::Plane, 45.0), treads.into_iter());
    assert!(share < 0.01, "treads: {share}");
    // A riser at x = 1.21, in the middle of a pixel, without its treads.
    let riser: Vec<_> = (0..20_000).map(|_| [1.21, random.uniform() * edge, random.uniform() * 0.18]).collect();
    let share = obstacle_share(&plan(Classifier::Plane, 45.0), riser.into_iter());
    assert!(share > 0.95, "riser: {share}");
}

#[test]
fn walls_are_obstacles_down_to_one_point_per_voxel() {
    let mut random = Random(11);
    let edge = 64.0 * T;
    for (density, least) in [(10.0, 0.99), (1.0, 0.9)] {
        // Points per voxel of the wall's pixels.
        let count = (64.0 * (2.4 / (3.0 * T)) * density) as usize;
        let wall: Vec<_> = (0..count).map(|_| [1.21, random.uniform() * edge, random.uniform() * 2.4]).collect();
        let share = obstacle_share(&plan(Classifier::Plane, 45.0), wall.into_iter());
        assert!(share >= least, "{density} points per voxel: {share}");
    }
}

#[test]
fn mirrored_points_get_mirrored_verdicts() {
    let mut random = Random(13);
    let points = plane(45.0, 33.0, 2.0, 0.003, &mut random);
    let edge = 64.0 * T;
    // Keeps off pixel borders, which are half open and so do not mirror.
    let inside = |v: f64| ((v / T).fract() - 0.5).abs() < 0.49;
    let points: Vec<_> = points.into_iter().filter(|p| inside(p[0]) && inside(p[1])).collect();
    let mirrored = points.iter().map(|&[x, y, z]| [edge - x, y, z]).collect::<Vec<_>>();
    let plan = plan(Classifier::Plane, 45.0);
    let share = obstacle_share(&plan, points.into_iter());
    assert!((0.05..0.95).contains(&share), "{share}: the test would show nothing");
    assert!((share - obstacle_share(&plan, mirrored.into_iter())).abs() < 0.01);
}

/// Slice heights from far below a pixel to far above one (pixels).
const SLICE_PIXELS: [f64; 10] = [0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.9, 3.0, 7.0, 20.0];

fn plan_of_slices(classifier: Classifier, max_slope_deg: f64, slice_pixels: f64) -> Plan {
    let options = PlanOptions { max_slope_deg, classifier, ..PlanOptions::default() };
    Plan { frame: Frame::new(T, slice_pixels * T).unwrap(), options }
}

/// A classified voxel: the middle of its pixel, and its heights (m).
struct Classified {
    place: [f64; 2],
    low: f64,
    high: f64,
    obstacle: bool,
}

/// All voxels of tile (0, 0), which holds `points`.
fn classified(plan: &Plan, points: impl Iterator<Item = [f64; 3]>) -> Vec<Classified> {
    let (patch, mut sums) = folded(plan, points);
    let mut voxel_classes = VoxelClasses::default();
    VoxelClassifier::new(plan).classify(&patch, &mut sums, Area::TILE, &mut voxel_classes);
    let first_slice = crate::voxel::record::ColumnKey { column: 0, block: 0 }.first_slice();
    let mut all = Vec::new();
    for pixel in patch.occupied().filter(|&pixel| Area::TILE.holds(pixel)) {
        let place = [pixel % PATCH_PIXELS, pixel / PATCH_PIXELS].map(|p| (p as f64 - 0.5) * T);
        for number in patch.range(pixel) {
            let (low, high) = patch.voxels()[number].quanta_above(-first_slice);
            let [low, high] = [low, high].map(|quanta| quanta as f64 * plan.frame.quantum_m());
            all.push(Classified { place, low, high, obstacle: voxel_classes[number] });
        }
    }
    all
}

/// A rectangle that rises towards a heading.
struct Sheet {
    middle: [f64; 3],
    slope_deg: f64,
    heading_deg: f64,
    /// Along the slope and across it (pixels).
    size: [f64; 2],
}

impl Sheet {
    /// Unit vectors up the slope, across it and along the normal.
    fn axes(&self) -> [[f64; 3]; 3] {
        let ((s, c), (hs, hc)) = (self.slope_deg.to_radians().sin_cos(), self.heading_deg.to_radians().sin_cos());
        [[c * hc, c * hs, s], [-hs, hc, 0.0], [-s * hc, -s * hs, c]]
    }

    /// Points at random positions, `per_edge` per pixel edge.
    fn points(&self, per_edge: f64, noise: f64, random: &mut Random) -> Vec<[f64; 3]> {
        let [up, across, normal] = self.axes();
        let count = (self.size[0] * self.size[1] * per_edge * per_edge) as usize;
        let mut places = || self.size.map(|size| (random.uniform() - 0.5) * size * T);
        let places: Vec<_> = (0..count).map(|_| places()).collect();
        let mut point = |[a, b]: [f64; 2]| {
            let off = noise * random.normal();
            [0, 1, 2].map(|k| self.middle[k] + a * up[k] + b * across[k] + off * normal[k])
        };
        places.into_iter().map(&mut point).collect()
    }

    /// Returns whether all edges of the rectangle are too far from a voxel to affect it.
    fn is_inside(&self, voxel: &Classified) -> bool {
        let at = [voxel.place[0], voxel.place[1], (voxel.low + voxel.high) / 2.0];
        let [up, across, _] = self.axes();
        let along = |axis: [f64; 3]| (0..3).map(|k| (at[k] - self.middle[k]) * axis[k]).sum::<f64>().abs() / T;
        let (s, c) = self.slope_deg.to_radians().sin_cos();
        let margin = (2.2 / c.max(1e-9)).min(9.0 / s.max(1e-9));
        along(up) <= self.size[0] / 2.0 - margin && along(across) <= self.size[1] / 2.0 - 2.2
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn planes_flip_at_the_limit_whatever_the_slice_height() {
    let mut random = Random(41);
    let mut case = 0;
    for limit in [30.0, 45.0, 60.0] {
        for slice_pixels in SLICE_PIXELS {
            let plan = plan_of_slices(Classifier::Plane, limit, slice_pixels);
            // Pixels along a slope: high slices need high walls.
            let steepest = 26.0 + 3.0 * slice_pixels;
            for slope_deg in [0.0, limit - 3.0, limit + 3.0, limit + 10.0, 80.0, 90.0] {
                let (mut inside, mut right) = (0, 0);
                for _ in 0..3 {
                    // Headings, densities and noises alternate with different periods.
                    case += 1;
                    let heading_deg = [0.0, 20.0, 45.0, 77.0, 200.0][case % 5];
                    let (per_edge, noise) = ([2.0, 3.0, 5.0, 10.0][case % 4], [0.0, 0.002][case / 4 % 2]);
                    let phase = [(); 3].map(|()| random.uniform());
                    let middle = [(32.0 + phase[0]) * T, (32.0 + phase[1]) * T, 3.0 * phase[2] * T];
                    let cos = slope_deg.to_radians().cos();
                    let sheet =
                        Sheet { middle, slope_deg, heading_deg, size: [(12.0 / cos).clamp(12.0, steepest), 12.0] };
                    let points = sheet.points(per_edge, noise, &mut random);
                    for voxel in classified(&plan, points.into_iter()).iter().filter(|voxel| sheet.is_inside(voxel)) {
                        inside += 1;
                        right += usize::from(voxel.obstacle == (slope_deg > limit));
                    }
                }
                assert!(inside >= 5, "{inside} voxels show nothing");
                let share = right as f64 / inside as f64;
                assert!(share >= 0.98, "limit {limit}, slope {slope_deg}, slices of {slice_pixels} pixels: {share}");
            }
        }
    }
}

#[test]
fn walls_are_obstacles_whatever_the_limit() {
    let mut random = Random(59);
    for limit in [0.0, 20.0, 70.0, 75.0, 80.0] {
        for slice_pixels in SLICE_PIXELS {
            let middle = [32.3 * T, 32.3 * T, random.uniform() * T];
            let sheet = Sheet { middle, slope_deg: 90.0, heading_deg: 20.0, size: [26.0 + 3.0 * slice_pixels, 12.0] };
            let points = sheet.points(2.0, 0.002, &mut random);
            let all = classified(&plan_of_slices(Classifier::Plane, limit, slice_pixels), points.into_iter());
            let inside: Vec<_> = all.iter().filter(|voxel| sheet.is_inside(voxel)).collect();
            let share = inside.iter().filter(|voxel| voxel.obstacle).count() as f64 / inside.len() as f64;
            assert!(share >= 0.98, "limit {limit}, slices of {slice_pixels} pixels: {share}");
        }
    }
}

#[test]
fn thin_slices_tell_a_slope_from_the_floor_below_it() {
    let mut random = Random(61);
    let edge = 64.0 * T;
    // A slope of 38° rises from pixel 20 on, above a level floor.
    let (foot, rise) = (20.0 * T, 38f64.to_radians().tan());
    let points: Vec<_> = (0..200_000)
        .map(|n| {
            let (x, y) = (random.uniform() * edge, random.uniform() * edge);
            [x, y, if n % 2 == 0 { (x - foot).max(0.0) * rise } else { 0.0 }]
        })
        .collect();
    for slice_pixels in [0.05, 0.1, 0.2, 0.3] {
        let all = classified(&plan_of_slices(Classifier::Plane, 30.0, slice_pixels), points.iter().copied());
        for (kind, obstacle) in [("floor", false), ("slope", true)] {
            let of_kind = |voxel: &&Classified| {
                let below = (voxel.place[0] - foot) * rise;
                let inside = (3.0 * T..edge - 3.0 * T).contains(&voxel.place[1]);
                inside && below > 1.5 * T && below < 8.0 * T && (voxel.low > 1.1 * T) == obstacle
            };
            let own: Vec<_> = all.iter().filter(of_kind).collect();
            let right = own.iter().filter(|voxel| voxel.obstacle == obstacle).count();
            assert!(right as f64 > 0.98 * own.len() as f64, "{kind}, {slice_pixels}: {right} of {}", own.len());
        }
    }
}

#[test]
fn runs_do_not_depend_on_the_slice_height() {
    let mut random = Random(43);
    for slice_pixels in SLICE_PIXELS {
        let plan = plan_of_slices(Classifier::Span, 45.0, slice_pixels);
        for (slope_deg, obstacle, least) in
            [(0.0, false, 1.0), (42.0, false, 1.0), (75.0, true, 0.97), (90.0, true, 0.9)]
        {
            for heading_deg in [0.0, 33.0] {
                let middle = [32.3 * T, 32.3 * T, random.uniform() * T];
                let sheet = Sheet { middle, slope_deg, heading_deg, size: [24.0 + 3.0 * slice_pixels, 12.0] };
                let points = sheet.points(5.0, 0.0, &mut random);
                let all = classified(&plan, points.into_iter());
                let inside: Vec<_> = all.iter().filter(|voxel| sheet.is_inside(voxel)).collect();
                let right = inside.iter().filter(|voxel| voxel.obstacle == obstacle).count();
                let share = right as f64 / inside.len() as f64;
                assert!(share >= least, "slope {slope_deg}, slices of {slice_pixels} pixels: {share}");
            }
        }
    }
}

#[test]
fn floors_walls_stairs_and_shelves_keep_their_verdicts_at_every_slice_height() {
    let mut random = Random(47);
    let edge = 64.0 * T;
    // Along x: a floor with a wall in pixel 16, stairs from pixel 24 on, and a shelf two pixels above a wall in pixel
    // 60.
    let (wall, stairs, low_wall) = (16.5 * T, 24.5 * T, 60.5 * T);
    let (tread, riser, steps) = (6.0 * T, 3.6 * T, 5.0);
    let (board, low_wall_top) = (12.0 * T, 10.0 * T);
    for (per_edge, noise) in [(2.0, 0.002), (5.0, 0.0)] {
        let mut points = Vec::new();
        let mut fill = |from: [f64; 2], to: [f64; 2]| {
            let length = (to[0] - from[0]).hypot(to[1] - from[1]);
            for _ in 0..(length * edge * (per_edge / T) * (per_edge / T)) as usize {
                let (along, y) = (random.uniform(), random.uniform() * edge);
                let [dx, dz] = [noise * random.normal(), noise * random.normal()];
                points.push([from[0] + along * (to[0] - from[0]) + dx, y, from[1] + along * (to[1] - from[1]) + dz]);
            }
        };
        fill([0.0, 0.0], [stairs, 0.0]);
        fill([wall, 0.0], [wall, 30.0 * T]);
        for step in 0..5 {
            let (x, z) = (stairs + f64::from(step) * tread, f64::from(step) * riser);
            fill([x, z], [x, z + riser]);
            fill([x, z + riser], [x + tread, z + riser]);
        }
        fill([low_wall, 0.0], [low_wall, low_wall_top]);
        fill([57.0 * T, board], [edge, board]);
        for slice_pixels in SLICE_PIXELS {
            let plan = plan_of_slices(Classifier::Plane, 45.0, slice_pixels);
            // Correct and all voxels of: floor, wall, treads, risers, shelf, the wall below it.
            let mut counts = [[0, 0]; 6];
            for voxel in classified(&plan, points.iter().copied()) {
                let x = voxel.place[0];
                let on_stairs = (x - stairs) / tread;
                let from_riser = (on_stairs - on_stairs.round()).abs() * tread;
                let foot = on_stairs.round() * riser;
                let within = |low: f64, high: f64| low + T / 2.0 < voxel.low && voxel.high < high - T / 2.0;
                let kind = if x < stairs - 2.0 * T {
                    let beside = (x - wall).abs() > T;
                    if beside { Some((0, false)) } else { within(0.0, 28.0 * T).then_some((1, true)) }
                } else if (0.0..steps).contains(&on_stairs) && from_riser > 1.2 * T {
                    Some((2, false))
                } else if (0.5..steps - 0.5).contains(&on_stairs) && from_riser < T / 4.0 {
                    within(foot, foot + riser).then_some((3, true))
                } else if x > 57.0 * T && voxel.low > board - T / 2.0 {
                    Some((4, false))
                } else {
                    (x > 57.0 * T && within(0.0, low_wall_top)).then_some((5, true))
                };
                if let Some((kind, obstacle)) = kind {
                    counts[kind][0] += usize::from(voxel.obstacle == obstacle);
                    counts[kind][1] += 1;
                }
            }
            let names = ["floor", "wall", "treads", "risers", "shelf", "low wall"];
            for (name, [right, all]) in names.into_iter().zip(counts) {
                // A surface that shares its slice with another has no voxel of its own.
                assert!(all > 20 || slice_pixels > 0.5 && !["floor", "treads"].contains(&name), "{name}: {all}");
                let least = if name == "risers" { 0.94 } else { 0.98 };
                let case = format!("{name}, {per_edge} points per edge, slices of {slice_pixels} pixels");
                assert!(all <= 20 || right as f64 >= least * all as f64, "{case}: {right} of {all}");
            }
        }
    }
}

#[test]
fn lines_of_few_points_are_no_wall_where_slices_hold_a_whole_storey() {
    let mut random = Random(53);
    let edge = 64.0 * T;
    // Lines across a floor and a table, like those of a slowly turning scanner.
    let points: Vec<_> = (0..4000)
        .map(|n| [random.uniform() * edge, (0.5 + f64::from(n % 16) * 4.0) * T, f64::from(n / 16 % 2) * 15.0 * T])
        .collect();
    for slice_pixels in SLICE_PIXELS {
        let share = obstacle_share(&plan_of_slices(Classifier::Plane, 45.0, slice_pixels), points.iter().copied());
        assert_eq!(share, 0.0, "slices of {slice_pixels} pixels");
    }
}

#[test]
fn floor_and_ceiling_are_no_run_where_something_stands_beside_them() {
    // Pixel 30 has a floor and a ceiling, pixel 31 something between them, pixel 29 nothing.
    for (height, wall, highest_slice) in [(2.95, true, 3.0), (12.0, false, 20.0), (30.0, false, 20.0)] {
        for slice_pixels in SLICE_PIXELS.into_iter().filter(|&pixels| pixels <= highest_slice) {
            let plan = plan_of_slices(Classifier::Span, 42.0, slice_pixels);
            let at = |pixel: f64, height: f64| [(pixel + 0.5) * T, 30.5 * T, height * T];
            let points = [at(30.0, 0.1), at(30.0, 0.1 + height), at(31.0, 0.1 + height / 2.0)];
            let all = classified(&plan, points.into_iter());
            let own: Vec<_> =
                all.iter().filter(|voxel| voxel.place[0] < 31.0 * T).map(|voxel| voxel.obstacle).collect();
            assert!(own.iter().all(|&obstacle| obstacle == wall), "{height} pixels, slices of {slice_pixels}: {own:?}");
        }
    }
}
