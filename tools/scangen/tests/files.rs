//! Files contain the drawn samples: read back by `las`, an independent reader of every format.

use las::Reader;
use proptest::prelude::*;
use scangen::write::{truth_json, write_triangles_obj, write_truth_json};
use scangen::{
    Chunks, CloudFormat, Kind, Params, Sample, SampleSpec, Scene, Truth, WriteSpec, write_clouds, write_las,
    write_samples,
};
use std::path::Path;
use tempfile::TempDir;

fn samples(count: u64) -> Vec<Sample> {
    let scene = Scene::named("house", &Params::new()).unwrap();
    let spec = SampleSpec { outlier_rate: 0.01, ..SampleSpec::direct_count(count).with_noise(0.003) };
    scene.samples(1, &spec).unwrap().collect()
}

/// Writes, reads back and compares header, positions and classes.
fn check(path: &Path, samples: &[Sample], spec: &WriteSpec) {
    let written = write_samples(path, samples.iter().copied(), spec).unwrap();
    assert_eq!(written.points, samples.len() as u64);
    assert_eq!(written.len_bytes, path.metadata().unwrap().len());
    let mut reader = Reader::from_path(path).unwrap();
    assert_eq!(reader.header().number_of_points(), samples.len() as u64);
    assert_eq!(reader.header().point_format().to_u8().unwrap(), spec.format);
    let bounds = reader.header().bounds();
    let data = reader.read_all().unwrap();
    assert_eq!(data.len(), samples.len());
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for ((sample, class), ((x, y), z)) in
        samples.iter().zip(data.classification()).zip(data.x().zip(data.y()).zip(data.z()))
    {
        assert_eq!(spec.rounded(sample.position), Some([x, y, z]));
        assert_eq!(class, if sample.kind == Kind::Surface { 1 } else { 7 });
        for (a, v) in [x, y, z].into_iter().enumerate() {
            (low[a], high[a]) = (low[a].min(v), high[a].max(v));
        }
    }
    if !samples.is_empty() {
        assert_eq!([bounds.min.x, bounds.min.y, bounds.min.z], low);
        assert_eq!([bounds.max.x, bounds.max.y, bounds.max.z], high);
        assert_eq!((written.bounds.min, written.bounds.max), (low, high));
    }
}

#[test]
fn every_point_format_reads_back_as_it_was_drawn() {
    let folder = TempDir::new().unwrap();
    let samples = samples(3000);
    for format in 0..=10 {
        check(&folder.path().join("a.las"), &samples, &WriteSpec { format, ..WriteSpec::default() });
        let laz = WriteSpec { format, compression: Some(Chunks::Fixed(700)), ..WriteSpec::default() };
        check(&folder.path().join("a.laz"), &samples, &laz);
    }
}

#[test]
fn a_hundred_thousand_points_read_back_from_laz() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.laz");
    let samples = samples(100_000);
    for format in [0, 1, 6, 7] {
        check(&path, &samples, &WriteSpec { format, ..WriteSpec::for_path(&path) });
        check(
            &path,
            &samples,
            &WriteSpec { format, compression: Some(Chunks::Variable(9000)), ..WriteSpec::default() },
        );
    }
}

#[test]
fn every_version_that_knows_a_format_reads_back() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.las");
    let samples = samples(500);
    for (version, format) in [((1, 0), 0), ((1, 1), 1), ((1, 2), 3), ((1, 3), 5), ((1, 4), 0), ((1, 4), 1)] {
        let spec = WriteSpec { format, version: Some(version), ..WriteSpec::default() };
        check(&path, &samples, &spec);
        let found = Reader::from_path(&path).unwrap().header().version();
        assert_eq!((found.major, found.minor), version);
    }
    let text = write_samples(&path, [], &WriteSpec { format: 6, version: Some((1, 2)), ..WriteSpec::default() });
    assert!(text.is_err());
}

#[test]
fn empty_files_and_files_of_one_point_are_files() {
    let folder = TempDir::new().unwrap();
    let samples = samples(1);
    for name in ["a.las", "a.laz"] {
        let path = folder.path().join(name);
        check(&path, &samples[..1], &WriteSpec::for_path(&path));
        check(&path, &[], &WriteSpec::for_path(&path));
    }
}

#[test]
fn the_same_samples_give_the_same_bytes() {
    let folder = TempDir::new().unwrap();
    let [a, b] = ["a.laz", "b.laz"].map(|n| folder.path().join(n));
    let spec = WriteSpec { withheld_share: 0.1, compression: Some(Chunks::Variable(500)), ..WriteSpec::default() };
    for path in [&a, &b] {
        write_samples(path, samples(5000), &spec).unwrap();
    }
    assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
}

#[test]
fn classes_withheld_flags_and_crs_are_as_specified() {
    let folder = TempDir::new().unwrap();
    let wkt = "LOCAL_CS[\"hall\",UNIT[\"metre\",1]]";
    for (name, format) in [("a.las", 1), ("a.laz", 6)] {
        let path = folder.path().join(name);
        let spec = WriteSpec {
            format,
            version: Some((1, 4)),
            crs_wkt: Some(wkt.to_owned()),
            classes: vec![(2, 3.0), (6, 1.0)],
            withheld_share: 0.2,
            ..WriteSpec::for_path(&path)
        };
        write_las(&path, samples(20_000).into_iter().take(20_000).map(|s| s.position), &spec).unwrap();
        let mut reader = Reader::from_path(&path).unwrap();
        assert_eq!(reader.header().get_wkt_crs_bytes().unwrap(), [wkt.as_bytes(), &[0]].concat());
        let data = reader.read_all().unwrap();
        let ground = data.classification().filter(|c| *c == 2).count();
        assert!((14_500..15_500).contains(&ground), "{ground} of class 2");
        assert!(data.classification().all(|c| c == 2 || c == 6));
        let withheld = data.points().filter(|p| p.as_ref().unwrap().is_withheld).count();
        assert!((3600..4400).contains(&withheld), "{withheld} withheld");
    }
}

#[test]
fn points_far_away_need_an_offset_and_say_so() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.las");
    let far = [5_000_000.0, 4_000_000.0, 0.0];
    let error = write_las(&path, [[0.0; 3], far], &WriteSpec::default()).unwrap_err().to_string();
    assert!(error.contains("point 1 at [5000000.0, 4000000.0, 0.0] does not fit"), "{error}");
    assert!(error.ends_with("use a coarser scale or an offset nearby"), "{error}");
    let spec = WriteSpec { offset: far, ..WriteSpec::default() };
    assert_eq!(write_las(&path, [far], &spec).unwrap().bounds.min, far);
    let not_a_number = write_las(&path, [[f64::NAN, 0.0, 0.0]], &WriteSpec::default());
    assert!(not_a_number.is_err());
}

#[test]
fn the_truth_file_holds_every_surface_and_the_mesh_lies_on_them() {
    let folder = TempDir::new().unwrap();
    for name in ["church", "street", "terrain"] {
        let scene = Scene::named(name, &Params::new()).unwrap();
        let path = folder.path().join("truth.json");
        write_truth_json(&path, &scene).unwrap();
        let read = std::fs::read_to_string(&path).unwrap();
        assert_eq!(read.trim_end(), truth_json(&scene).to_string());
        let read: serde_json::Value = serde_json::from_str(&read).unwrap();
        assert_eq!(read["surfaces"].as_array().unwrap().len(), scene.surfaces().len());
        let mesh = folder.path().join("mesh.obj");
        let count = write_triangles_obj(&mesh, &scene, 5.0).unwrap();
        let text = std::fs::read_to_string(&mesh).unwrap();
        assert_eq!(text.lines().filter(|l| l.starts_with("f ")).count() as u64, count);
        for line in text.lines().filter(|l| l.starts_with("v ")).step_by(7) {
            let v: Vec<f64> = line[2..].split(' ').map(|n| n.parse().unwrap()).collect();
            assert!(scene.distance_to_point([v[0], v[1], v[2]]) < 1e-4, "{name}: {line}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn whatever_fits_reads_back_to_half_a_step(
        points in prop::collection::vec([-2e6..2e6, -2e6..2e6, -2e6..2e6], 0..50), scale in 0.001..0.1, laz: bool,
    ) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a");
        let compression = laz.then_some(Chunks::Fixed(7));
        let spec = WriteSpec { scale: [scale; 3], compression, ..WriteSpec::default() };
        write_las(&path, points.iter().copied(), &spec).unwrap();
        // The reader decides by the extension.
        let named = folder.path().join(if laz { "a.laz" } else { "a.las" });
        std::fs::rename(&path, &named).unwrap();
        let data = Reader::from_path(&named).unwrap().read_all().unwrap();
        for (p, ((x, y), z)) in points.iter().zip(data.x().zip(data.y()).zip(data.z())) {
            for (a, v) in [x, y, z].into_iter().enumerate() {
                prop_assert!((p[a] - v).abs() <= scale * 0.5 + 1e-9);
            }
        }
        prop_assert_eq!(data.len(), points.len());
    }
}

#[test]
fn clouds_hold_what_was_drawn() {
    let folder = TempDir::new().unwrap();
    let samples = &samples(2500)[..2500];
    let spec = WriteSpec { offset: [500_000.0, 0.0, -3.0], ..WriteSpec::default() };
    let expected: Vec<[f64; 3]> = samples.iter().map(|sample| spec.rounded(sample.position).unwrap()).collect();
    let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-9 * (1.0 + b[axis].abs()));
    let write = |name: &str| {
        let path = folder.path().join(name);
        let format = CloudFormat::of(&path).unwrap();
        let written = write_clouds(&path, format, samples.iter().copied(), &spec, 1000).unwrap();
        assert_eq!((written.points, written.len_bytes), (2500, path.metadata().unwrap().len()));
        assert!(
            expected.iter().all(|p| (0..3).all(|a| written.bounds.min[a] <= p[a] && p[a] <= written.bounds.max[a]))
        );
        path
    };
    let mut reader = e57::E57Reader::from_file(write("a.e57")).unwrap();
    let clouds = reader.pointclouds();
    assert_eq!(clouds.iter().map(|cloud| cloud.records).collect::<Vec<_>>(), [1000, 1000, 500]);
    let mut found = Vec::new();
    for cloud in clouds {
        found.extend(reader.pointcloud_simple(&cloud).unwrap().map(|point| match point.unwrap().cartesian {
            e57::CartesianCoordinate::Valid { x, y, z } => [x, y, z],
            other => panic!("{other:?}"),
        }));
    }
    assert!(found.len() == 2500 && found.iter().zip(&expected).all(|(a, b)| near(a, b)));
    for (name, head, columns) in [("a.ptx", 10usize, 4), ("a.pts", 1, 7), ("a.xyz", 0, 3)] {
        let text = std::fs::read_to_string(write(name)).unwrap();
        let mut lines = text.lines();
        let mut found: Vec<[f64; 3]> = Vec::new();
        while found.len() < 2500 {
            let count = match head {
                0 => 2500,
                _ => lines.next().unwrap().trim().parse().unwrap(),
            };
            lines.by_ref().take(head.saturating_sub(1)).for_each(drop);
            for line in lines.by_ref().take(count) {
                let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
                assert_eq!(numbers.len(), columns, "{name}");
                found.push([numbers[0], numbers[1], numbers[2]]);
            }
        }
        assert!(lines.next().is_none() && found.iter().zip(&expected).all(|(a, b)| near(a, b)), "{name}");
    }
}
