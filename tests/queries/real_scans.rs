//! Every real scan converts, verifies, and answers random boxes without a miss (G1) or a phantom (G2), compared with
//! brute force over its points, which are read here without code of this crate.
//!
//! Needs a folder of scans in `SLICEWALK_DATA`; without it the tests say so and do nothing.

use crate::data;
use crate::random;

use random::Random;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk::{Monitor, NoMonitor};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::path::Path;

struct Quiet;
impl Monitor for Quiet {}

/// Points sorted into square cells in xy, to count those in a box without visiting all of them.
struct Truth {
    cell: f64,
    min: [f64; 3],
    max: [f64; 3],
    columns: usize,
    starts: Vec<u32>,
    points: Vec<[f64; 3]>,
}

impl Truth {
    fn read(path: &Path, metres_per_unit: f64, cell: f64) -> Self {
        let mut reader = las::Reader::from_path(path).unwrap();
        let all = reader.read_all().unwrap();
        let points: Vec<[f64; 3]> =
            all.x().zip(all.y()).zip(all.z()).map(|((x, y), z)| [x, y, z].map(|v| v * metres_per_unit)).collect();
        let fold = |start: f64, pick: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|axis| points.iter().fold(start, |extreme, point| pick(extreme, point[axis])))
        };
        let (min, max) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
        let columns = ((max[0] - min[0]) / cell) as usize + 1;
        let rows = ((max[1] - min[1]) / cell) as usize + 1;
        let mut truth = Self { cell, min, max, columns, starts: vec![0; columns * rows + 1], points };
        let cells: Vec<usize> = truth.points.iter().map(|point| truth.cell_of(point[0], point[1])).collect();
        let mut order: Vec<u32> = (0..truth.points.len() as u32).collect();
        order.sort_unstable_by_key(|&number| cells[number as usize]);
        for &cell in &cells {
            truth.starts[cell + 1] += 1;
        }
        for cell in 1..truth.starts.len() {
            truth.starts[cell] += truth.starts[cell - 1];
        }
        truth.points = order.iter().map(|&number| truth.points[number as usize]).collect();
        truth
    }

    fn cell_of(&self, x: f64, y: f64) -> usize {
        let clamp = |value: f64, count: usize| (value.max(0.0) as usize).min(count - 1);
        let rows = (self.starts.len() - 1) / self.columns;
        let column = clamp((x - self.min[0]) / self.cell, self.columns);
        let row = clamp((y - self.min[1]) / self.cell, rows);
        row * self.columns + column
    }

    /// Returns whether a point is in the closed box.
    fn holds(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let (first, last) = (self.cell_of(min[0], min[1]), self.cell_of(max[0], max[1]));
        let (x0, x1) = (first % self.columns, last % self.columns);
        (first / self.columns..=last / self.columns).any(|row| {
            let range = self.starts[row * self.columns + x0]..self.starts[row * self.columns + x1 + 1];
            self.points[range.start as usize..range.end as usize]
                .iter()
                .any(|point| (0..3).all(|axis| min[axis] <= point[axis] && point[axis] <= max[axis]))
        })
    }
}

fn check(name: &str, pixel: f64, metres_per_unit: f64) {
    let Some(data) = data::folder() else { return };
    let path = data.join(name);
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("scan.slices");
    let mut options = ConvertOptions::new(vec![path.clone()], output.clone());
    options.grid.pixel = PixelSize::Metres(pixel);
    options.resources.memory_bytes = 64 << 20;
    options.resources.temp_dir = dir.path().to_owned();
    // None of the scans states its unit, though one is in feet.
    options.reading.units = Units::Factor(metres_per_unit);
    let report = convert(&options, &Quiet).unwrap();

    let truth = Truth::read(&path, metres_per_unit, 16.0 * pixel);
    assert_eq!(report.header.points_kept, truth.points.len() as u64);
    assert_eq!(report.header.bounds, Some((truth.min, truth.max)), "bounds are those of the points, exactly");

    let archive = Archive::open(&output).unwrap();
    let mut findings = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| findings.push(finding.to_string())).unwrap();
    assert_eq!(findings, [""; 0]);

    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let frame = *archive.frame();
    let mut random = Random(1);
    let (mut hits, mut clear, mut between) = (0, 0, 0);
    for number in 0..10_000 {
        // Half of the boxes are near points, half anywhere; from less than a voxel to a room.
        let centre = if number % 2 == 0 {
            let point = truth.points[random.below(truth.points.len())];
            point.map(|value| value + (random.uniform() - 0.5) * 20.0 * pixel)
        } else {
            [0, 1, 2].map(|axis| truth.min[axis] + random.uniform() * (truth.max[axis] - truth.min[axis]))
        };
        let half = [0, 1, 2].map(|_| 0.5 * pixel * 0.1 * 400f64.powf(random.uniform()));
        let (min, max) = ([0, 1, 2].map(|a| centre[a] - half[a]), [0, 1, 2].map(|a| centre[a] + half[a]));
        let answer = overlaps(&store, &Aabb::new(min.into(), max.into()).unwrap());
        let grow = [pixel, pixel, frame.slice_m()];
        if truth.holds(min, max) {
            assert_eq!(answer, Overlap::Hit, "{name}: box {min:?} to {max:?} misses a point (G1)");
            hits += 1;
        } else if !truth.holds([0, 1, 2].map(|a| min[a] - grow[a]), [0, 1, 2].map(|a| max[a] + grow[a])) {
            assert_eq!(answer, Overlap::Clear, "{name}: box {min:?} to {max:?} hits a phantom (G2)");
            clear += 1;
        } else {
            between += 1;
        }
    }
    assert!(hits > 500 && clear > 500, "{name}: {hits} hits, {clear} clear, {between} between: the test shows little");
}

#[test]
fn indoor_two_storeys() {
    check("indoor_two_storey_zup.laz", 0.05, 1.0);
}

#[test]
fn room_from_one_station() {
    check("room_single_station.laz", 0.04, 1.0);
}

#[test]
fn corridor_from_three_stations() {
    check("corridor_three_stations.laz", 0.05, 1.0);
}

#[test]
fn pump_room() {
    check("pump_room.laz", 0.02, 1.0);
}

#[test]
fn city_block_from_the_air() {
    check("delft_city_block_ahn3.laz", 0.5, 1.0);
}

#[test]
fn town_on_a_slope_with_far_outliers() {
    check("isprs_csite2_town.laz", 0.5, 1.0);
}

#[test]
fn forest_plot() {
    check("forest_plot_tls.laz", 0.1, 1.0);
}

#[test]
fn stadium_in_feet() {
    check("autzen_stadium.laz", 1.0, 0.3048);
}
