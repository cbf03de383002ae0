//! Bounded memory (guarantee G5): the program's peak resident memory stays within its budget plus 64 MiB, for points
//! that exceed it, in any order and extent. `tools/measure-memory.sh` measures the same on gigabytes.
#![cfg(target_os = "linux")]

use crate::scans;

use scangen::{CloudFormat, Kind, Sample, Texture, WriteSpec, write_clouds, write_las};
use scans::{Random, command, verifies, write_as};
use std::fs;
use std::io::Write;
use std::time::Duration;
use tempfile::TempDir;

const POINTS: usize = 5_000_000;
const MOST_KIB: u64 = (64 + 64) << 10;

/// Converts points at 64 MiB and returns the peak memory in KiB, as counted by the system, and the temporary bytes.
fn peak_memory_kib(name: &str, pixel: &str, mut point: impl FnMut(usize, &mut Random) -> [f64; 3]) -> (u64, u64) {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(6);
    let points: Vec<[f64; 3]> = (0..POINTS).map(|number| point(number, &mut random)).collect();
    write_as(&folder.path().join("scan.las"), &points, 0.01, [0.0; 3]);
    drop(points);
    let (peak, temp) = peak_of_file(&folder, name, "scan.las", pixel, POINTS, &[]);
    assert!(temp <= 12 * POINTS as u64, "{name}: {temp} temporary bytes");
    (peak, temp)
}

/// Converts `file`, of `count` points or triangles, at 64 MiB.
fn peak_of_file(folder: &TempDir, name: &str, file: &str, pixel: &str, count: usize, options: &[&str]) -> (u64, u64) {
    let report = folder.path().join("report.json");
    let mut child = command(folder.path())
        .args([file, "-o", "a.slices", "--pixel", pixel, "--memory", "64MiB", "--threads", "2", "--json"])
        .args(["--temp-dir", ".", "--quiet"])
        .args(options)
        .stdout(fs::File::create(&report).unwrap())
        .spawn()
        .unwrap();
    let mut peak = 0;
    let ended = loop {
        // The high-water mark never falls, so the last read before the end is close to the maximum.
        peak = peak.max(scans::peak_memory_kib(child.id()));
        if let Some(ended) = child.try_wait().unwrap() {
            break ended;
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    assert!(ended.success(), "{name}");
    verifies(&folder.path().join("a.slices"));
    let report: serde_json::Value = serde_json::from_str(&fs::read_to_string(report).unwrap()).unwrap();
    assert_eq!(report["points_kept"], count);
    let temp = report["temp_bytes"].as_u64().unwrap();
    println!("{name}: {} MiB, {:.2} temporary bytes a point", peak >> 10, temp as f64 / count as f64);
    assert!(peak > 1 << 10, "{name}: {peak} KiB: nothing was measured");
    assert!(peak <= MOST_KIB, "{name}: {peak} KiB is more than {MOST_KIB}");
    (peak, temp)
}

fn uniform(random: &mut Random, size: [f64; 3]) -> [f64; 3] {
    size.map(|size| random.uniform() * size)
}

#[test]
fn shuffled_points_with_an_outlier_stay_within_the_budget_and_go_to_disk() {
    let (_, temp) = peak_memory_kib("shuffled", "0.2", |number, random| match number {
        1_234_567 => [1e7, 0.0, 0.0],
        2_345_678 => [0.0, -3e6, 1e7],
        _ => uniform(random, [400.0, 400.0, 0.3]),
    });
    assert!(temp > 0, "the test shows little");
}

#[test]
#[ignore = "slow: .ci/run"]
fn filling_holes_stays_within_the_budget() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(8);
    // A floor of 9 hectares with a hole of 0.8 m every 2 m.
    let points: Vec<[f64; 3]> = std::iter::repeat_with(|| uniform(&mut random, [300.0, 300.0, 0.01]))
        .filter(|p| [p[0], p[1]].iter().any(|v| v.rem_euclid(2.0) > 0.8))
        .take(POINTS)
        .collect();
    write_as(&folder.path().join("scan.las"), &points, 0.001, [0.0; 3]);
    drop(points);
    peak_of_file(&folder, "holes", "scan.las", "0.2", POINTS, &["--fill-holes", "1.0"]);
    let archive = slicewalk::archive::Archive::open(folder.path().join("a.slices")).unwrap();
    assert!(archive.header().voxels.inferred > 10_000, "nothing was filled");
}

#[test]
#[ignore = "slow: .ci/run"]
fn shuffled_points_with_colours_stay_within_the_budget() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(8);
    let texture = Some(Texture { period_m: 37.0, eight_bits: false, exposure: 0.0 });
    let spec = WriteSpec { format: 2, texture, scale: [0.01; 3], ..WriteSpec::default() };
    let points = (0..POINTS).map(|_| uniform(&mut random, [400.0, 400.0, 0.3]));
    write_las(&folder.path().join("scan.las"), points, &spec).unwrap();
    let (_, temp) = peak_of_file(&folder, "colours", "scan.las", "0.2", POINTS, &["--colour", "rgb"]);
    assert!(temp > 0 && temp <= 30 * POINTS as u64, "{temp} temporary bytes");
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_strip_of_100_kilometres_stays_within_the_budget() {
    peak_memory_kib("strip", "0.5", |_, random| uniform(random, [100_000.0, 20.0, 5.0]));
}

#[test]
fn coincident_points_stay_within_the_budget() {
    peak_memory_kib("coincident", "0.1", |_, _| [12.34, 5.67, 8.9]);
}

#[test]
#[ignore = "slow: .ci/run"]
fn clouds_of_scanners_stay_within_the_budget_and_go_to_disk() {
    // Twice as many bytes of coordinates as the budget plus the allowed excess.
    for (name, format, count) in [("scan.e57", CloudFormat::E57, POINTS), ("scan.ptx", CloudFormat::Ptx, POINTS)] {
        let folder = tempfile::tempdir().unwrap();
        let mut random = Random(6);
        let samples = (0..count).map(|_| {
            let position = uniform(&mut random, [400.0, 400.0, 0.3]);
            Sample { position, kind: Kind::Surface, surface: 0, station: 0 }
        });
        let spec = WriteSpec { scale: [0.01; 3], ..WriteSpec::default() };
        write_clouds(&folder.path().join(name), format, samples, &spec, 2_000_000).unwrap();
        let (_, temp) = peak_of_file(&folder, name, name, "0.2", count, &[]);
        assert!(temp > 0, "the test shows little");
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_mesh_larger_than_the_budget_stays_within_it_and_goes_to_disk() {
    const SIDE: usize = 900;
    let folder = tempfile::tempdir().unwrap();
    let file = fs::File::create(folder.path().join("terrain.ply")).unwrap();
    let mut out = std::io::BufWriter::new(file);
    let faces = 2 * (SIDE - 1) * (SIDE - 1);
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double \
         z\nelement face {faces}\nproperty list uchar uint vertex_indices\nend_header\n",
        SIDE * SIDE
    )
    .unwrap();
    for (i, j) in (0..SIDE * SIDE).map(|n| (n % SIDE, n / SIDE)) {
        let at = [i as f64 * 0.5, j as f64 * 0.5, (i as f64 * 0.05).sin() * (j as f64 * 0.07).cos()];
        at.iter().for_each(|v| out.write_all(&v.to_le_bytes()).unwrap());
    }
    for (i, j) in (0..(SIDE - 1) * (SIDE - 1)).map(|n| (n % (SIDE - 1), n / (SIDE - 1))) {
        let corner = |x: usize, y: usize| ((j + y) * SIDE + i + x) as u32;
        for face in [[corner(0, 0), corner(1, 0), corner(1, 1)], [corner(0, 0), corner(1, 1), corner(0, 1)]] {
            out.write_all(&[3]).unwrap();
            face.iter().for_each(|v| out.write_all(&v.to_le_bytes()).unwrap());
        }
    }
    out.into_inner().unwrap();
    let (_, temp) = peak_of_file(&folder, "mesh", "terrain.ply", "0.25", faces, &[]);
    assert!(temp > 0, "the test shows little");
}
