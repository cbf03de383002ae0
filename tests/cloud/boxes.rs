//! Boxes queried in archives of real clouds, compared with brute force over points that were read independently
//! (guarantees G1 and G2).

use super::scans::Random;
use super::write::Point;
use super::{clouds::by_the_crate, data, plain};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Boxes per file.
const BOXES: usize = 10_000;

/// Points sorted into cells a few voxels large.
struct Cells<'a> {
    points: &'a [Point],
    size: Point,
    cells: HashMap<[i64; 3], Vec<usize>>,
}

impl<'a> Cells<'a> {
    fn new(points: &'a [Point], size: Point) -> Self {
        let mut all = Self { points, size, cells: HashMap::new() };
        for (number, point) in points.iter().enumerate() {
            all.cells.entry(all.of(*point)).or_default().push(number);
        }
        all
    }

    fn of(&self, point: Point) -> [i64; 3] {
        std::array::from_fn(|axis| (point[axis] / self.size[axis]).floor() as i64)
    }

    /// Returns whether a closed box, grown by `grow`, contains a point.
    fn hold(&self, min: Point, max: Point, grow: Point) -> bool {
        let min: Point = std::array::from_fn(|axis| min[axis] - grow[axis]);
        let max: Point = std::array::from_fn(|axis| max[axis] + grow[axis]);
        let (a, b) = (self.of(min), self.of(max));
        let inside = |p: &Point| (0..3).all(|axis| min[axis] <= p[axis] && p[axis] <= max[axis]);
        let cells = (a[0]..=b[0]).flat_map(|i| (a[1]..=b[1]).flat_map(move |j| (a[2]..=b[2]).map(move |k| [i, j, k])));
        let mut held = cells.filter_map(|cell| self.cells.get(&cell));
        held.any(|held| held.iter().any(|&number| inside(&self.points[number])))
    }
}

/// A box containing a point, near one or far from one, up to four voxels large, often with faces at a point's
/// coordinates.
fn some_box(random: &mut Random, points: &[Point], bounds: [Point; 2], voxel: Point) -> (Point, Point) {
    let p = points[random.below(points.len())];
    let kind = random.below(10);
    let (mut min, mut max) = (p, p);
    for axis in 0..3 {
        let size = if random.chance(20) { 0.0 } else { random.uniform() * 4.0 * voxel[axis] };
        let begin = match kind {
            0..4 => p[axis] - size * random.uniform(),
            4..8 => p[axis] + random.normal() * 3.0 * voxel[axis],
            _ => random.between(bounds[0][axis], bounds[1][axis]),
        };
        (min[axis], max[axis]) = (begin, begin + size);
        match random.below(6) {
            0 if kind < 4 => min[axis] = p[axis],
            1 if kind < 4 => max[axis] = p[axis],
            _ => {}
        }
        max[axis] = max[axis].max(min[axis]);
    }
    (min, max)
}

/// `loose`: the points equal those of the file up to rounding.
fn check(folder: &Path, path: &Path, points: &[Point], loose: bool) -> [usize; 2] {
    let ends =
        |axis: usize| points.iter().map(move |p| p[axis]).fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(v), b.max(v)]);
    let ends = [ends(0), ends(1), ends(2)];
    let extent = ends.iter().map(|[low, high]| high - low).fold(0.0, f64::max);
    let magnitude = ends.as_flattened().iter().fold(0.0f64, |most, v| most.max(v.abs()));
    let pixel: f64 = format!("{:.1e}", (extent / 80.0).max(magnitude / 1e7).max(0.001)).parse().unwrap();
    let mut options = ConvertOptions::new(vec![path.to_path_buf()], folder.join("out.slices"));
    (options.grid.pixel, options.overwrite, options.resources.temp_dir) =
        (PixelSize::Metres(pixel), true, folder.to_path_buf());
    let report = convert(&options, &NoMonitor).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(report.header.points_kept, points.len() as u64, "{}", path.display());
    let archive = Archive::open(folder.join("out.slices")).unwrap();
    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let (t, s) = (archive.header().plan.frame.pixel_m(), archive.header().plan.frame.slice_m());
    let cells = Cells::new(points, [4.0 * t, 4.0 * t, 4.0 * s]);
    let slack = 4e-15 * magnitude + if loose { 1e-9 * (1.0 + magnitude) } else { 0.0 };
    let bounds = [0, 1].map(|end| [0, 1, 2].map(|axis| ends[axis][end]));
    let (mut random, mut hits, mut clears) = (Random(7), 0, 0);
    for _ in 0..BOXES {
        let (min, max) = some_box(&mut random, points, bounds, [t, t, s]);
        let hit = overlaps(&store, &Aabb::new(min.into(), max.into()).unwrap()) == Overlap::Hit;
        let name = path.display();
        let within = if loose { [-slack; 3] } else { [0.0; 3] };
        assert!(hit || !cells.hold(min, max, within), "G1: {name}: {min:?} {max:?}");
        assert!(!hit || cells.hold(min, max, [t + slack, t + slack, s + slack]), "G2: {name}: {min:?} {max:?}");
        if hit { hits += 1 } else { clears += 1 }
    }
    [hits, clears]
}

#[test]
fn boxes_miss_no_point_of_a_real_cloud_and_hit_no_phantom() {
    let Some(formats) = data::folder().map(|folder| folder.join("formats")).filter(|folder| folder.is_dir()) else {
        return eprintln!("skipped: the real data have no folder \"formats\"");
    };
    // Files without readable points, splats, and meshes.
    let not_asked = [
        "badheader.txt",
        "corrupt_crc.e57",
        "diamond_with_bool.ply",
        "empty.e57",
        "InvalidCVHeader.e57",
        "InvalidFileLength.e57",
        "mesh.ply",
        "missingheader.pcd",
        "no_vertex.ply",
        "ply_empty_bin.ply",
        "ply_empty_header.ply",
        "ripple.ptx",
        "stereo_left.pcd",
        "synthetic-normals.e57",
        "ZeroPoints.e57",
        "ZeroPointsInvalid.e57",
    ];
    let mut paths: Vec<PathBuf> = ["e57", "pcd", "ply", "pts", "ptx", "text"]
        .iter()
        .flat_map(|name| std::fs::read_dir(formats.join(name)).unwrap().map(|entry| entry.unwrap().path()))
        .filter(|path| !not_asked.iter().any(|name| path.ends_with(name)))
        .chain([formats.join("made/pump_three_stations_poses.e57")])
        .collect();
    paths.sort();
    let folder = tempfile::tempdir().unwrap();
    let (mut files, mut found) = (0, [0, 0]);
    for path in paths {
        let is_e57 = path.extension().is_some_and(|ending| ending == "e57");
        let points = if is_e57 { by_the_crate(&path) } else { plain::points(&path) };
        let [hits, clears] = check(folder.path(), &path, &points, is_e57);
        (files, found) = (files + 1, [found[0] + hits, found[1] + clears]);
    }
    println!("{files} files, {BOXES} boxes each: {} hits, {} clear", found[0], found[1]);
    assert!(files > 65 && found.iter().all(|&count| count > 100_000), "{files} {found:?}");
}
