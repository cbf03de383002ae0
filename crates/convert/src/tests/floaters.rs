//! Components found in memory equal those found on disk, in columns that fit and in columns cut into areas.

use super::*;

/// Conversion of points around the corner of four tiles, most of them in small components.
fn options(folder: &Path, most: u16, seed: u64) -> ConvertOptions {
    let mut random = Random(seed);
    let mut points: Vec<[f64; 3]> = Vec::new();
    for _ in 0..3_000 {
        let mut at = [random.below(120), random.below(120), random.below(400)].map(|v| v as i64 - 60);
        for _ in 0..random.below(9) {
            // Several points per voxel, so that a column has many more records than voxels.
            points.extend((0..3).map(|_| at.map(|v| v as f64 * 0.25 + 0.01 + random.below(200) as f64 / 1000.0)));
            at[random.below(3) as usize] += random.below(3) as i64 - 1;
        }
    }
    let path = folder.join("points.las");
    write_las(&path, points.iter().copied(), &WriteSpec::for_path(&path)).unwrap();
    let mut options = ConvertOptions::new(vec![path], folder.join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.25);
    options.grid.slice_m = Some(0.25);
    options.plan.drop_floaters = most;
    options.plan.min_points = 2;
    options.resources.temp_dir = folder.to_path_buf();
    options.resources.memory_bytes = MIN_MEMORY_BYTES;
    options.overwrite = true;
    options.reading.units = Units::Factor(1.0);
    options
}

#[test]
fn runs_on_disk_and_columns_in_areas_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for (most, seed) in [(1, 11), (1, 12), (1, 13), (2, 11), (5, 11)] {
        let mut options = options(folder.path(), most, seed);
        options.resources.threads = 1;
        let report = convert(&options, &NoMonitor).unwrap();
        assert!(report.voxels_dropped > 300 && report.header.voxels.occupied > 100, "{most}");
        let expected = fs::read(&options.output).unwrap();
        // With 300 threads, the records of a column do not fit the share of one.
        for threads in [1, 2, 300] {
            options.resources.threads = threads;
            for limits in [Limits::of(&options), Limits { retain_bytes: 0, build_bytes: 0, views_bytes: 0 }] {
                let again = convert_within(&options, limits, &NoMonitor).unwrap();
                assert_eq!(again.voxels_dropped, report.voxels_dropped);
                assert!(
                    fs::read(&options.output).unwrap() == expected,
                    "{most}, seed {seed}, {threads} threads, {limits:?}"
                );
            }
        }
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing temporary is left");
}
