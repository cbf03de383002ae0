//! Points: the same for a seed, on their surfaces, in the requested number and with the requested imperfections.

use scangen::sample::{Mode, Order, ScannerSpec, shuffle};
use scangen::{Kind, Params, SCENES, Sample, SampleSpec, Scene, Truth};

fn scene(name: &str) -> Scene {
    Scene::named(name, &Params::new()).unwrap()
}

/// FNV-1a over the bits of coordinates.
fn hash(points: impl Iterator<Item = [f64; 3]>) -> u64 {
    points
        .flatten()
        .flat_map(|v| v.to_bits().to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325, |h, byte| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn scanner(rays: u64) -> SampleSpec {
    let spec = ScannerSpec { people: 2, ..ScannerSpec::default() };
    SampleSpec { mode: Mode::Scanner(spec), outlier_rate: 0.01, duplicate_rate: 0.01, ..SampleSpec::scanner(rays) }
        .with_noise(0.003)
}

/// Changing any of these breaks every fixture that is named by its seed.
const HASHES: [(&str, u64, u64); 13] = [
    ("plane", 0xd3c44695be6ac1f5, 0x20676da4e04706b0),
    ("ramps", 0x8b7e2c2c2c697e3e, 0xd0894668b2ca39a7),
    ("stairs", 0x0a0ce6efa176e35f, 0x096fb60bd1d62553),
    ("corridor", 0xa8220754b3316c79, 0x7da25ea2903d714b),
    ("house", 0x014fab1edf9c2601, 0x534e6ece377c191d),
    ("hall", 0x25dd6a5b0e7bc1e0, 0xd6e7e617e4613966),
    ("church", 0x5d124f8087919033, 0x7fca8aa1508c9de3),
    ("columns", 0xcf30426e9be79cfe, 0xdd063f73ce2c6485),
    ("street", 0xf696a8388b3429b5, 0x9c956ee9f7cc9f4d),
    ("terrain", 0xae78c0e57f40c3bf, 0x7a364caa6026544b),
    ("tower", 0xcab6cc49c85fac7a, 0xea8b8cc49727ea86),
    ("uniform", 0x95a83dad385b9002, 0x743b187bd93c08ab),
    ("extent", 0x57fe9b5f4ad7db2f, 0x89ff7e6c576c7edc),
];

#[test]
fn a_seed_gives_the_same_points_for_ever() {
    let found: Vec<_> = SCENES
        .iter()
        .map(|info| {
            let scene = scene(info.name);
            let direct = SampleSpec { outlier_rate: 0.01, ..SampleSpec::direct_count(2000).with_noise(0.002) };
            let direct = hash(scene.points(11, &direct).unwrap());
            (info.name, direct, hash(scene.points(11, &scanner(2000)).unwrap()))
        })
        .collect();
    assert_eq!(found, HASHES);
}

#[test]
fn points_lie_on_their_surfaces_within_six_times_the_noise() {
    for info in SCENES {
        let scene = scene(info.name);
        let scans = [SampleSpec::scanner(2000).with_noise(0.004), scanner(2000)];
        let orders = [Order::Random, Order::Surfaces, Order::Grid];
        let direct =
            orders.map(|o| SampleSpec { mode: Mode::Direct(o), ..SampleSpec::direct_count(2000).with_noise(0.004) });
        for spec in direct.iter().chain(&scans) {
            for sample in scene.samples(5, spec).unwrap().filter(|s| s.kind == Kind::Surface) {
                let d = scene.distance_to_point(sample.position);
                assert!(d <= 6.0 * 0.004 + 1e-4, "{}: {d} from every surface", info.name);
                let own = scene.surfaces()[sample.surface as usize]
                    .shape
                    .distance_to_box(&scangen::geometry::Aabb::new(sample.position, sample.position));
                assert!(own <= 6.0 * 0.004 + 1e-4, "{}: {own} from its own surface", info.name);
            }
        }
    }
}

#[test]
fn as_many_points_come_as_were_asked_for_and_even_by_area() {
    let scene = scene("house");
    for order in [Order::Random, Order::Surfaces] {
        let spec = SampleSpec { mode: Mode::Direct(order), ..SampleSpec::direct_count(50_000) };
        let mut counts = vec![0.0; scene.surfaces().len()];
        scene.samples(1, &spec).unwrap().for_each(|s| counts[s.surface as usize] += 1.0);
        assert_eq!(counts.iter().sum::<f64>(), 50_000.0);
        for (surface, count) in scene.surfaces().iter().zip(counts) {
            let expected: f64 = 50_000.0 * surface.shape.area() / scene.area();
            assert!((count - expected).abs() < 6.0 * expected.sqrt() + 2.0, "{count} for {expected}");
        }
    }
    let grid = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(100.0) };
    let count = scene.points(1, &grid).unwrap().count() as f64;
    assert!((count / (100.0 * scene.area()) - 1.0).abs() < 0.05, "{count} points for {} m²", scene.area());
}

#[test]
fn terrain_is_even_by_area_though_it_is_drawn_by_plan() {
    let scene = scene("terrain");
    let (mut steep, mut count) = (0.0, 0.0);
    let plan = |p: [f64; 3]| scene.floor_under(p[0], p[1], 1e3).unwrap().1.to_radians().cos();
    for p in scene.points(9, &SampleSpec::direct_count(20_000)).unwrap() {
        steep += plan(p);
        count += 1.0;
    }
    // The mean of cos(slope) over the area is plan area divided by area.
    let expected = 200.0 * 200.0 / scene.area();
    assert!((steep / count - expected).abs() < 0.004, "{} for {expected}", steep / count);
}

#[test]
fn troubles_do_not_move_the_other_points() {
    let scene = scene("house");
    let clean = SampleSpec::direct_count(3000);
    let dirty = SampleSpec { outlier_rate: 0.05, duplicate_rate: 0.05, ..clean.clone() };
    let plain: Vec<_> = scene.samples(2, &clean).unwrap().collect();
    let samples: Vec<_> = scene.samples(2, &dirty).unwrap().collect();
    let mut kept: Vec<Sample> = samples.iter().copied().filter(|s| s.kind == Kind::Surface).collect();
    let outliers = samples.len() - kept.len();
    let before = kept.len();
    kept.dedup();
    assert_eq!(kept, plain);
    assert!((100..200).contains(&outliers) && (100..200).contains(&(before - kept.len())));
    for pair in samples.windows(2).filter(|p| p[1].kind == Kind::Outlier && p[0].kind == Kind::Surface) {
        let away = scangen::geometry::length(scangen::geometry::sub(pair[1].position, pair[0].position));
        assert!((10.0..=20.0 + 1e-9).contains(&away), "an outlier {away} m away");
    }
    let holed = SampleSpec { holes: vec![[3.0, 3.0, 1.0]], ..clean };
    let kept = scene.samples(2, &holed).unwrap().collect::<Vec<_>>();
    let outside = |s: &Sample| (s.position[0] - 3.0).hypot(s.position[1] - 3.0) > 1.0;
    assert_eq!(kept, plain.into_iter().filter(outside).collect::<Vec<_>>());
}

#[test]
fn a_scanner_sees_only_what_nothing_hides() {
    for name in ["house", "church", "street"] {
        let scene = scene(name);
        let station = scene.stations()[0];
        let spec = ScannerSpec { stations: vec![station], mixed_rate: 0.0, ..ScannerSpec::default() };
        let spec = SampleSpec { mode: Mode::Scanner(spec), ..SampleSpec::scanner(4000) };
        let points: Vec<_> = scene.points(1, &spec).unwrap().collect();
        assert!(points.len() > 1500, "{name}: {} points", points.len());
        for p in points {
            let ray = scangen::geometry::sub(p, station);
            let range = scangen::geometry::length(ray);
            let (seen, _) = scene.raycast(station, scangen::geometry::unit(ray), 1e3).unwrap();
            assert!((seen - range).abs() < 1e-6, "{name}: a point at {range} m behind a surface at {seen} m");
        }
    }
}

#[test]
fn people_leave_streaks_and_edges_leave_mixed_pixels() {
    let scene = scene("house");
    let (mut moving, mut mixed) = (0, 0);
    for sample in scene.samples(4, &scanner(100_000)).unwrap() {
        match sample.kind {
            Kind::Moving => moving += 1,
            Kind::Mixed => mixed += 1,
            _ => {}
        }
    }
    assert!(moving > 500 && mixed > 50, "{moving} moving, {mixed} mixed");
}

#[test]
fn a_crowd_is_where_its_scan_met_it() {
    let scene = scene("hall");
    let station = scene.stations()[0];
    let scanner = ScannerSpec { stations: vec![station], people: 3, mixed_rate: 0.0, ..ScannerSpec::default() };
    let spec = SampleSpec { mode: Mode::Scanner(scanner), ..SampleSpec::scanner(50_000) };
    let crowd = scene.crowd(7, &spec).unwrap().unwrap();
    let mut met = 0;
    for sample in scene.samples(7, &spec).unwrap().filter(|sample| sample.kind != Kind::Outlier) {
        let way = [0, 1, 2].map(|axis| sample.position[axis] - station[axis]);
        let range = way.iter().map(|v| v * v).sum::<f64>().sqrt();
        let nearest = crowd.nearest(way.map(|v| v / range));
        if sample.kind == Kind::Moving {
            met += 1;
            assert!(nearest.is_some_and(|nearest| (nearest - range).abs() < 1e-6), "{sample:?}: {nearest:?}");
        } else {
            assert!(nearest.is_none_or(|nearest| nearest > range - 1e-6), "{sample:?}: {nearest:?}");
        }
    }
    assert!(met > 100, "{met}");
    assert!(scene.crowd(7, &SampleSpec::direct_count(10)).unwrap().is_none());
}

#[test]
fn shuffling_keeps_the_points_and_loses_their_order() {
    let scene = scene("stairs");
    let spec = SampleSpec { mode: Mode::Direct(Order::Surfaces), ..SampleSpec::direct_count(20_000) };
    let ordered: Vec<_> = scene.samples(1, &spec).unwrap().collect();
    let run = |seed| -> Vec<Sample> {
        shuffle(ordered.iter().copied(), seed, None).unwrap().collect::<Result<_, _>>().unwrap()
    };
    let (first, again, other) = (run(1), run(1), run(2));
    assert_eq!(first, again);
    assert_ne!(first, other);
    let sorted = |mut samples: Vec<Sample>| {
        samples.sort_by(|a, b| a.position.partial_cmp(&b.position).unwrap());
        samples
    };
    assert_eq!(sorted(first.clone()), sorted(ordered.clone()));
    // Neighbours come from different surfaces as often as chance predicts, within buckets and across them.
    let mean = |s: &[Sample]| s.iter().map(|s| f64::from(s.surface)).sum::<f64>() / s.len() as f64;
    let (front, back) = first.split_at(first.len() / 2);
    assert!((mean(front) - mean(back)).abs() < 1.0);
}

#[test]
fn wrong_parameters_are_refused_with_the_way_out() {
    let scene = scene("plane");
    let fault = |spec: SampleSpec| scene.points(1, &spec).err().unwrap().to_string();
    assert_eq!(fault(SampleSpec::direct_count(1).with_noise(-1.0)), "noise: -1 lies outside 0 to 1000");
    let text = Scene::named("hose", &Params::new()).unwrap_err().to_string();
    assert!(text.starts_with("SCENE: \"hose\" is not one of plane, ramps"), "{text}");
    let text = Scene::named("stairs", &Params::new().with("risr", 1.0)).unwrap_err().to_string();
    assert_eq!(text, "--param: scene stairs has no parameter \"risr\" (riser, tread, risers, width, landing)");
    let text = Scene::named("stairs", &Params::new().with("riser", 9.0)).unwrap_err().to_string();
    assert_eq!(text, "riser: 9 lies outside 0.01 to 0.4: height of a step (m)");
}
