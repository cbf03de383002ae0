//! Columns cut into strips and areas, and runs on disk, make the same bytes, whatever the options.

use super::*;
use crate::plan::Classifier;
use scangen::WriteSpec;

/// Points around the corner of four tiles: ground that may be rough, walls, and lone points above and below.
fn points(random: &mut Random) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    let mut put = |x: f64, y: f64, z: f64| points.push([x, y, z].map(|v| (v * 1000.0).round() / 1000.0));
    let (rough, slope, side) =
        ([0.003, 0.05, 0.3][random.below(3)], random.between(-0.8, 0.8), random.between(2.0, 8.0));
    for _ in 0..3_000 + random.below(6_000) {
        let (x, y) = (random.between(-side, side), random.between(-side, side));
        put(x, y, slope * x + rough * random.normal());
    }
    for _ in 0..random.below(4) {
        let (at, along) = (random.between(-side, side), random.chance(50));
        for _ in 0..1_500 {
            let (s, z) = (random.between(-side, side), random.between(-0.5, 2.5));
            if along { put(at, s, z) } else { put(s, at, z) }
        }
    }
    for _ in 0..random.below(2_000) {
        put(random.between(-side, side), random.between(-side, side), random.between(-2.0, 6.0));
    }
    points
}

#[test]
#[ignore = "slow: .ci/run"]
fn however_columns_are_cut_the_bytes_are_the_same_with_any_options() {
    let number = |name: &str, default: u64| std::env::var(name).ok().map_or(default, |text| text.parse().unwrap());
    let (cases, first) = (number("SLICEWALK_CASES", 12), number("SLICEWALK_SEED", 1));
    for seed in first..first + cases {
        let mut random = Random(seed);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.las");
        write_las(&path, points(&mut random), &WriteSpec::for_path(&path)).unwrap();
        let mut options = ConvertOptions::new(vec![path], folder.path().join("a.slices"));
        let pixel = [0.08, 0.125, 0.25][random.below(3)];
        options.grid.pixel = PixelSize::Metres(pixel);
        options.grid.slice_m = [None, Some(0.1), Some(0.25), Some(1.0)][random.below(4)];
        options.plan.classifier =
            [Classifier::Plane, Classifier::Plane, Classifier::Span, Classifier::Thesis][random.below(4)];
        options.plan.max_slope_deg = random.between(20.0, 70.0);
        options.plan.min_points = 1 + random.below(3);
        options.plan.drop_floaters = [0, 0, 1, 2, 20][random.below(5)];
        options.plan.fill_holes = [0, 0, 1, 4, 12][random.below(5)];
        options.plan.tolerance_m = [0.0, pixel / 4.0][random.below(2)];
        options.sections.levels = random.chance(30);
        options.sections.colour = [ColourMode::Off, ColourMode::Of(ColourSource::Intensity)][random.below(2)];
        options.resources.temp_dir = folder.path().to_path_buf();
        options.resources.memory_bytes = MIN_MEMORY_BYTES;
        options.resources.threads = 1;
        options.overwrite = true;
        options.reading.units = Units::Factor(1.0);
        let report = convert(&options, &NoMonitor).unwrap();
        let expected = fs::read(&options.output).unwrap();
        // With 300 threads, the records of a column do not fit the share of one; with 60, some do not.
        for threads in [2, 60, 300] {
            options.resources.threads = threads;
            for limits in [Limits::of(&options), Limits { retain_bytes: 0, build_bytes: 0, views_bytes: 0 }] {
                let again = convert_within(&options, limits, &NoMonitor).unwrap();
                assert_eq!(again.voxels_dropped, report.voxels_dropped, "seed {seed}, {threads} threads");
                let made = fs::read(&options.output).unwrap();
                assert!(made == expected, "seed {seed}, {threads} threads, {limits:?}, {:?}", options.plan);
            }
        }
    }
    println!("{cases} cases from {first} on");
}
