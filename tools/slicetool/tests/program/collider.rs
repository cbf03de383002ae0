//! Colliders, by readers and geometry of their own: every place of a span lies inside, no surface lies beyond the error,
//! and each tile is closed.

use crate::data;
use crate::scene::{converted, each_span, export, run};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

type Point = [f64; 3];

/// Numbers from 0 to 1.
fn random(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A rough floor, a wall askew, a ramp, a pipe, leaves in the air, and a point far above, over two tiles.
fn scene() -> TempDir {
    let mut next = random(11);
    let mut points: Vec<Point> = Vec::new();
    for _ in 0..12_000 {
        let (u, v) = (next(), next());
        points.push([14.0 * u, 2.5 * v, 0.03 * next()]);
        points.push([4.0 + 3.0 * u, 0.5 + 2.2 * u, 2.5 * v]);
        points.push([8.0 + 2.0 * u, 1.0 * v, 0.3 * 2.0 * u]);
        let angle = std::f64::consts::TAU * v;
        points.push([2.0 + 0.15 * angle.cos(), 2.0 + 0.15 * angle.sin(), 3.0 * u]);
    }
    points.extend((0..60).map(|_| [13.0 * next(), 2.5 * next(), 1.0 + 2.0 * next()]));
    points.push([3.0, 3.0, 90.0]);
    let moved = points.into_iter().map(|[x, y, z]| [x + 200_001.3, y + 500_000.7, z - 0.4]);
    converted(moved.collect(), 0.1, None)
}

/// Boxes of spans by pixel: least and greatest corner (m).
struct Solid {
    pixel: f64,
    boxes: BTreeMap<[i64; 2], Vec<[f64; 2]>>,
}

impl Solid {
    fn of(folder: &Path) -> Self {
        let archive = Archive::open(folder.join("a.slices")).unwrap();
        let mut boxes: BTreeMap<_, Vec<_>> = BTreeMap::new();
        let quantum = archive.frame().slice_m() / 255.0;
        each_span(&archive, |at, bottom, top| {
            boxes.entry(at).or_default().push([bottom, top].map(|z| z as f64 * quantum));
        });
        Self { pixel: archive.frame().pixel_m(), boxes }
    }

    /// Distance from a place to the nearest solid, if it is at most `most`.
    fn distance(&self, [x, y, z]: Point, most: f64) -> Option<f64> {
        let far = |v: f64| ((v - most) / self.pixel).floor() as i64 - 1..=((v + most) / self.pixel).ceil() as i64 + 1;
        let beyond = |v: f64, low: f64, high: f64| (low - v).max(v - high).max(0.0);
        let mut least = f64::INFINITY;
        for (i, j) in far(x).flat_map(|i| far(y).map(move |j| (i, j))) {
            for [bottom, top] in self.boxes.get(&[i, j]).into_iter().flatten() {
                let edge = |pixel: i64| pixel as f64 * self.pixel;
                let off = [beyond(x, edge(i), edge(i + 1)), beyond(y, edge(j), edge(j + 1)), beyond(z, *bottom, *top)];
                least = least.min(off.iter().map(|v| v * v).sum::<f64>().sqrt());
            }
        }
        (least <= most).then_some(least)
    }
}

/// A closed surface.
#[derive(Default)]
struct Mesh {
    corners: Vec<Point>,
    triangles: Vec<[usize; 3]>,
}

/// The meshes of a file of glTF, in the coordinates of the archive.
fn glb(path: &Path) -> Vec<Mesh> {
    let bytes = fs::read(path).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((word(0), word(4), word(8) as usize), (0x4654_6C67, 2, bytes.len()));
    let head: Value = serde_json::from_slice(&bytes[20..20 + word(12) as usize]).unwrap();
    let binary = 28 + word(12) as usize;
    let number = |value: &Value| value.as_u64().unwrap() as usize;
    let accessor = |at: &Value| {
        let accessor = &head["accessors"][number(at)];
        let view = &head["bufferViews"][number(&accessor["bufferView"])];
        (binary + number(&view["byteOffset"]) + number(&accessor["byteOffset"]), number(&accessor["count"]))
    };
    let nodes = head["scenes"][0]["nodes"].as_array().unwrap();
    let mesh = |node: &Value| {
        let node = &head["nodes"][number(node)];
        let moved = [0, 1, 2].map(|axis| node["translation"][axis].as_f64().unwrap());
        let part = &head["meshes"][number(&node["mesh"])]["primitives"][0];
        let (at, count) = accessor(&part["attributes"]["POSITION"]);
        let corner = |n: usize| {
            let float = |axis: usize| f64::from(f32::from_bits(word(at + 12 * n + 4 * axis))) + moved[axis];
            [float(0), -float(2), float(1)]
        };
        let corners = (0..count).map(corner).collect();
        let (at, count) = accessor(&part["indices"]);
        let index = |n: usize| word(at + 4 * n) as usize;
        let triangles = (0..count / 3).map(|n| [0, 1, 2].map(|side| index(3 * n + side))).collect();
        Mesh { corners, triangles }
    };
    nodes.iter().map(mesh).collect()
}

/// The objects of a file of OBJ.
fn obj(path: &Path) -> Vec<Mesh> {
    let mut meshes: Vec<Mesh> = Vec::new();
    let mut first = 1;
    for line in fs::read_to_string(path).unwrap().lines() {
        let mut words = line.split(' ');
        match words.next() {
            Some("o") => {
                first += meshes.last().map_or(0, |mesh| mesh.corners.len());
                meshes.push(Mesh::default());
            }
            Some("v") => {
                let place: Vec<f64> = words.map(|word| word.parse().unwrap()).collect();
                meshes.last_mut().unwrap().corners.push(place.try_into().unwrap());
            }
            Some("f") => {
                let corners: Vec<usize> = words.map(|word| word.parse::<usize>().unwrap() - first).collect();
                meshes.last_mut().unwrap().triangles.push(corners.try_into().unwrap());
            }
            _ => assert!(line.starts_with('#'), "{line}"),
        }
    }
    meshes
}

impl Mesh {
    fn places(&self, triangle: &[usize; 3]) -> [Point; 3] {
        triangle.map(|at| self.corners[at])
    }

    /// How often the surface winds around a place: crossings of the ray from it towards +x.
    fn winding(&self, place: Point) -> i32 {
        let mut sum = 0;
        for triangle in &self.triangles {
            let corners = self.places(triangle).map(|corner| [0, 1, 2].map(|axis| corner[axis] - place[axis]));
            if corners.iter().all(|c| c[0] < 0.0) {
                continue;
            }
            // Seen along x: the ray is a point, in general position.
            let turn = |a: Point, b: Point| a[1] * b[2] - a[2] * b[1];
            let [a, b, c] = corners;
            let parts = [turn(b, c), turn(c, a), turn(a, b)];
            let sign = if parts.iter().all(|part| *part > 0.0) {
                1
            } else if parts.iter().all(|part| *part < 0.0) {
                -1
            } else {
                continue;
            };
            let along = (0..3).map(|n| parts[n] * corners[n][0]).sum::<f64>() / parts.iter().sum::<f64>();
            sum += if along > 0.0 { sign } else { 0 };
        }
        sum
    }
}

/// Checks a collider; returns the number of its triangles.
fn check(solid: &Solid, meshes: &[Mesh], error: f64, places: usize) -> usize {
    for mesh in meshes {
        let mut edges: HashMap<[usize; 2], i32> = HashMap::new();
        for triangle in &mesh.triangles {
            for side in 0..3 {
                *edges.entry([triangle[side], triangle[(side + 1) % 3]]).or_default() += 1;
            }
        }
        for ([from, to], count) in &edges {
            assert_eq!((*count, edges.get(&[*to, *from])), (1, Some(&1)), "an edge has no two triangles");
        }
        let mut corners: Vec<_> = mesh.corners.iter().map(|corner| corner.map(f64::to_bits)).collect();
        corners.sort_unstable();
        corners.dedup();
        assert_eq!(corners.len(), mesh.corners.len(), "corners share a place");
    }
    // Places of solid: its corners, edges and middle, moved by less than a nanometre into general position.
    let mut next = random(5);
    let spans: Vec<_> = solid.boxes.iter().flat_map(|(at, spans)| spans.iter().map(move |span| (at, span))).collect();
    let bounds: Vec<[Point; 2]> = meshes
        .iter()
        .map(|mesh| {
            let end = |f: fn(f64, f64) -> f64, from: f64| {
                mesh.corners.iter().fold([from; 3], |end, at| [0, 1, 2].map(|axis| f(end[axis], at[axis])))
            };
            [end(f64::min, f64::INFINITY), end(f64::max, f64::NEG_INFINITY)]
        })
        .collect();
    let windings = |place: Point| {
        let near = bounds
            .iter()
            .zip(meshes)
            .filter(|(ends, _)| (0..3).all(|axis| ends[0][axis] <= place[axis] && place[axis] <= ends[1][axis]));
        near.map(|(_, mesh)| mesh.winding(place)).collect::<Vec<_>>()
    };
    for number in 0..places {
        let (at, [bottom, top]) = spans[number * spans.len() / places];
        let mut share = || [0.0, 1.0, next()][(next() * 3.0) as usize];
        let place = [
            (at[0] as f64 + share()) * solid.pixel,
            (at[1] as f64 + share()) * solid.pixel,
            bottom + share() * (top - bottom),
        ];
        let place = place.map(|v| v + 1e-10 * (next() - 0.5));
        assert!(windings(place).contains(&1), "{place:?} of a span is outside");
    }
    // Places of the surface.
    let triangles: usize = meshes.iter().map(|mesh| mesh.triangles.len()).sum();
    let mut farthest = 0.0f64;
    for mesh in meshes {
        for triangle in &mesh.triangles {
            let [a, b, c] = mesh.places(triangle);
            for number in 0..3 + 2 * places / triangles {
                let (mut u, mut v) = match number {
                    0 => (0.0, 0.0),
                    1 => (1.0, 0.0),
                    2 => (0.0, 1.0),
                    _ => (next(), next()),
                };
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                let place = [0, 1, 2].map(|axis| a[axis] + u * (b[axis] - a[axis]) + v * (c[axis] - a[axis]));
                let distance = solid.distance(place, error + 1e-6);
                assert!(distance.is_some(), "{place:?} of the surface is farther than {error}");
                farthest = farthest.max(distance.unwrap());
            }
        }
    }
    assert!(farthest > error / 4.0, "{farthest}");
    // Places in the air.
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for ends in &bounds {
        for axis in 0..3 {
            (low[axis], high[axis]) = (low[axis].min(ends[0][axis]), high[axis].max(ends[1][axis]));
        }
    }
    let mut empty = 0;
    for _ in 0..places {
        let place = [0, 1, 2].map(|axis| low[axis] + next() * (high[axis] - low[axis]));
        if solid.distance(place, error + 1e-6).is_none() {
            empty += 1;
            assert!(windings(place).iter().all(|around| *around == 0), "{place:?} is inside, beyond {error}");
        }
    }
    assert!(empty > 0);
    triangles
}

#[test]
fn colliders_contain_all_solid_and_end_within_the_error() {
    let folder = scene();
    let at = folder.path();
    let solid = Solid::of(at);
    let mut before = usize::MAX;
    for error in ["0.09", "0.3", "1.3"] {
        let said = export(at, &["-o", "a.glb", "--error", error]);
        let meshes = glb(&at.join("a.glb"));
        let triangles = check(&solid, &meshes, error.parse().unwrap(), 4000);
        let tiles = if error == "1.3" { 2..=3 } else { 3..=4 };
        assert!(tiles.contains(&meshes.len()), "{} tiles", meshes.len());
        assert!(said.ends_with(&format!("at most {error} m beyond the solid\n")), "{said}");
        assert!(said.contains(&format!("{} triangles in ", slicewalk_base::text::grouped(triangles as u64))), "{said}");
        assert!(triangles < before, "{error}: {triangles} triangles after {before}");
        before = triangles;
    }
}

#[test]
fn obj_holds_the_surface_of_glb_and_both_are_the_same_again() {
    let folder = scene();
    let at = folder.path();
    for name in ["a.glb", "b.glb", "a.obj"] {
        export(at, &["-o", name, "--error", "0.4"]);
    }
    assert_eq!(fs::read(at.join("a.glb")).unwrap(), fs::read(at.join("b.glb")).unwrap());
    let [meshes, others] = [glb(&at.join("a.glb")), obj(&at.join("a.obj"))];
    assert_eq!(meshes.len(), others.len());
    for (mesh, other) in meshes.iter().zip(&others) {
        assert_eq!(mesh.triangles, other.triangles);
        let off =
            mesh.corners.iter().zip(&other.corners).flat_map(|(a, b)| (0..3).map(|axis| (a[axis] - b[axis]).abs()));
        assert!(off.fold(0.0, f64::max) < 1e-9);
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_number_of_triangles_is_kept_and_used() {
    let folder = scene();
    let at = folder.path();
    let said = export(at, &["-o", "a.glb", "--triangles", "500"]);
    let error: f64 = said.split("at most ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    let triangles = check(&Solid::of(at), &glb(&at.join("a.glb")), error, 1000);
    assert!((250..=500).contains(&triangles), "{triangles}");
    let out = run(at, &["-o", "b.glb", "--triangles", "3"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(
        out.status.code() == Some(1) && said.contains("give more --triangles") && said.lines().count() == 1,
        "{said}"
    );
    assert!(!at.join("b.glb").exists());
}

#[test]
fn colliders_of_a_real_scan_keep_their_bound() {
    let Some(scan) = data::file("pump_room.laz") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut options = ConvertOptions::new(vec![scan], folder.path().join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.05);
    convert(&options, &NoMonitor).unwrap();
    let solid = Solid::of(folder.path());
    export(folder.path(), &["-o", "a.glb", "--error", "0.15"]);
    check(&solid, &glb(&folder.path().join("a.glb")), 0.15, 3000);
}

#[test]
fn bounds_that_cannot_be_meant_are_refused() {
    let folder = scene();
    let at = folder.path();
    for arguments in [
        &["-o", "a.glb", "--error", "0"][..],
        &["-o", "a.glb", "--error", "-0.1"],
        &["-o", "a.glb", "--error", "nan"],
        &["-o", "a.glb", "--triangles", "0"],
        &["-o", "a.glb", "--triangles", "many"],
        &["-o", "a.glb", "--triangles", "10", "--error", "0.1"],
        &["-o", "a.obj"],
    ] {
        assert_eq!(run(at, arguments).status.code(), Some(2), "{arguments:?}");
    }
    let out = run(at, &["-o", "a.glb", "--error", "0.001"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code() == Some(1) && said.contains("too small") && said.lines().count() == 1, "{said}");
    assert_eq!(fs::read_dir(at).unwrap().count(), 1);
    // Heights can be coarser than pixels: slices of 1000 m.
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("high.xyz"), "0 0 0\n0.1 0 0\n0 0 3000\n").unwrap();
    let mut options = ConvertOptions::new(vec![folder.path().join("high.xyz")], folder.path().join("a.slices"));
    (options.grid.pixel, options.grid.slice_m) = (PixelSize::Metres(0.1), Some(1000.0));
    options.reading.units = Units::Factor(1.0);
    convert(&options, &NoMonitor).unwrap();
    let out = run(folder.path(), &["-o", "a.glb", "--error", "0.02"]);
    let said = String::from_utf8(out.stderr).unwrap();
    // A 128th of a quantum.
    assert!(said.ends_with("pixels of 0.1 m and slices of 1000 m; give at least 0.030638\n"), "{said}");
}

#[test]
fn an_empty_archive_has_an_empty_collider() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("none.xyz"), "# nothing\n").unwrap();
    let mut options = ConvertOptions::new(vec![at.join("none.xyz")], at.join("a.slices"));
    options.grid.pixel = PixelSize::Metres(0.1);
    if convert(&options, &NoMonitor).is_ok() {
        assert_eq!(
            export(at, &["-o", "a.glb", "--error", "0.2"]),
            "a.glb: 0 triangles in 0 tiles, at most 0.2 m beyond the solid\n"
        );
    }
}
