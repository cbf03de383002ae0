//! Exports of cubes and maps, read by readers written from the formats' descriptions: OctoMap, voxel octrees, Nav2.

use crate::scene::{converted, each_span, export, floor_wall_roof, run};
use serde_json::Value;
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const PIXEL_M: f64 = 0.1;
/// Quanta in a cube: the slice height is three pixels.
const CUBE_QUANTA: i64 = 85;

type Cube = [i64; 3];

/// A floor, a wall and a roof at `corner`.
fn folder(corner: [f64; 3]) -> TempDir {
    let points = floor_wall_roof().into_iter().map(|at| [0, 1, 2].map(|axis| at[axis] + corner[axis]));
    converted(points.collect(), PIXEL_M, None)
}

/// Cubes that spans reach.
fn expected(folder: &Path) -> BTreeSet<Cube> {
    let mut cubes = BTreeSet::new();
    each_span(&Archive::open(folder.join("a.slices")).unwrap(), |[i, j], bottom, top| {
        let first = bottom.div_euclid(CUBE_QUANTA);
        let last = (top - 1).div_euclid(CUBE_QUANTA).max(first);
        cubes.extend((first..=last).map(|k| [i, j, k]));
    });
    cubes
}

/// Occupied cubes of a binary tree of OctoMap, the metres by which it was moved, and whether a leaf was larger than a
/// cube.
fn octomap(bytes: &[u8]) -> (BTreeSet<Cube>, [f64; 3], bool) {
    let ([free, occupied], moved, is_joined) = leaves_of_octomap(bytes);
    assert!(free.is_empty(), "a free leaf");
    (occupied, moved, is_joined)
}

/// Like [`octomap`], with the free cubes before the occupied ones.
pub fn leaves_of_octomap(bytes: &[u8]) -> ([BTreeSet<Cube>; 2], [f64; 3], bool) {
    let data = bytes.windows(6).position(|part| part == b"\ndata\n").unwrap();
    let head = std::str::from_utf8(&bytes[..data]).unwrap();
    assert!(head.starts_with("# Octomap OcTree binary file\n"));
    let value = |key: &str| head.lines().find_map(|line| line.strip_prefix(key)).map(str::to_owned);
    assert_eq!(value("id ").unwrap(), "OcTree");
    let moved: Vec<f64> = value("# moved by ").map_or(vec![0.0; 3], |text| {
        text.trim_end_matches(" m").split(' ').map(|number| number.parse().unwrap()).collect()
    });
    let (mut at, mut nodes, mut cubes, mut is_joined) = (data + 6, 1u64, [BTreeSet::new(), BTreeSet::new()], false);
    // Depth first: position of a node's corner in cubes, and its edge.
    let mut open = vec![([-(1 << 15); 3], 1i64 << 16)];
    while let Some((corner, edge)) = open.pop() {
        let children = u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        at += 2;
        let mut inner = Vec::new();
        for child in 0..8 {
            let half = edge / 2;
            let corner = [0, 1, 2].map(|axis| corner[axis] + half * (child >> axis & 1));
            let bits = children >> (2 * child) & 3;
            nodes += u64::from(bits != 0);
            match bits {
                0 => {}
                leaf @ (1 | 2) => {
                    is_joined |= half > 1;
                    for (x, y, z) in cubes_within(half) {
                        cubes[usize::from(leaf - 1)].insert([corner[0] + x, corner[1] + y, corner[2] + z]);
                    }
                }
                _ => inner.push((corner, half)),
            }
        }
        open.extend(inner.into_iter().rev());
    }
    assert_eq!(at, bytes.len());
    assert_eq!(value("size ").unwrap(), nodes.to_string());
    (cubes, moved.try_into().unwrap(), is_joined)
}

fn cubes_within(edge: i64) -> impl Iterator<Item = (i64, i64, i64)> {
    (0..edge).flat_map(move |x| (0..edge).flat_map(move |y| (0..edge).map(move |z| (x, y, z))))
}

/// Solid cubes of a voxel octree, in the axes of the archive.
fn voxels(head: &Value, words: &[u32]) -> BTreeSet<Cube> {
    let number = |key: &str| head[key].as_u64().unwrap() as usize;
    let (nodes, leaves) = words.split_at(number("nodeCount"));
    assert_eq!(leaves.len(), number("leafDataCount"));
    assert_eq!(leaves.len(), 2 * number("numMixedLeaves"));
    let size = head["voxelResolution"].as_f64().unwrap();
    let low: Vec<i64> =
        (0..3).map(|axis| (head["gridBounds"]["min"][axis].as_f64().unwrap() / size).round() as i64).collect();
    let high: Vec<i64> =
        (0..3).map(|axis| (head["gridBounds"]["max"][axis].as_f64().unwrap() / size).round() as i64).collect();
    let (mut cubes, mut inner) = (BTreeSet::new(), 0);
    let mut open = vec![(0usize, 4i64 << number("treeDepth"), [0i64; 3])];
    while let Some((node, edge, corner)) = open.pop() {
        let word = nodes[node];
        let mut solid = |by: (i64, i64, i64)| {
            let at = [corner[0] + by.0 + low[0], corner[1] + by.1 + low[1], corner[2] + by.2 + low[2]];
            assert!((0..3).all(|axis| at[axis] < high[axis]), "outside of the grid");
            cubes.insert([at[0], -at[2] - 1, at[1]]);
        };
        match word >> 24 {
            0 => {
                assert_eq!(edge, 4);
                let bits = u64::from(leaves[2 * word as usize]) | u64::from(leaves[2 * word as usize + 1]) << 32;
                (0..64).filter(|bit| bits >> bit & 1 == 1).for_each(|bit| solid((bit & 3, bit >> 2 & 3, bit >> 4)));
            }
            _ if word == 0xFF00_0000 => cubes_within(edge).for_each(solid),
            mask => {
                inner += 1;
                let children = (0..8).filter(|child| mask >> child & 1 == 1);
                for (next, child) in ((word & 0xFF_FFFF) as usize..).zip(children) {
                    let corner = [0, 1, 2].map(|axis| corner[axis] + edge / 2 * (child >> axis & 1));
                    open.push((next, edge / 2, corner));
                }
            }
        }
    }
    assert_eq!(inner, number("numInteriorNodes"));
    cubes
}

fn read_voxels(folder: &Path) -> (Value, BTreeSet<Cube>) {
    let head: Value = serde_json::from_slice(&fs::read(folder.join("a.voxel.json")).unwrap()).unwrap();
    let bytes = fs::read(folder.join("a.voxel.bin")).unwrap();
    let words: Vec<u32> = bytes.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    assert_eq!(bytes.len(), 4 * words.len());
    let cubes = voxels(&head, &words);
    (head, cubes)
}

#[test]
fn octrees_hold_the_cubes_that_spans_reach() {
    // A massive block joins cubes to larger leaves in both formats.
    let solid = || {
        let block = (0..64).flat_map(|i| (0..64).flat_map(move |j| (0..32).map(move |k| [i, j, 2 * k])));
        block.map(|at| at.map(|v| f64::from(v) * 0.05 + 0.025 - 1.6)).collect()
    };
    let massive = || converted(solid(), PIXEL_M, None);
    for (folder, has_large) in [(folder([0.0; 3]), false), (folder([-2.03, -1.97, -1.0]), false), (massive(), true)] {
        let at = folder.path();
        let expected = expected(at);
        let about = export(at, &["-o", "a.bt"]);
        let (cubes, moved, is_joined) = octomap(&fs::read(at.join("a.bt")).unwrap());
        assert!(
            cubes == expected && moved == [0.0; 3] && (is_joined || !has_large),
            "{} of {}",
            cubes.len(),
            expected.len()
        );
        let digits: String = about.split(": ").nth(1).unwrap().chars().filter(char::is_ascii_digit).collect();
        assert!(digits.starts_with(&expected.len().to_string()), "{about}");
        export(at, &["-o", "a.voxel.json"]);
        let (head, cubes) = read_voxels(at);
        assert!(cubes == expected, "{} of {}", cubes.len(), expected.len());
        assert_eq!((&head["version"], &head["leafSize"]), (&Value::from("1.1"), &Value::from(4)));
        let bound =
            |end: &str, axis: usize| (head["sceneBounds"][end][axis].as_f64().unwrap() / PIXEL_M).round() as i64;
        let ends = |axis: usize| {
            (expected.iter().map(|cube| cube[axis]).min(), expected.iter().map(|cube| cube[axis] + 1).max())
        };
        assert_eq!((Some(bound("min", 0)), Some(bound("max", 0))), ends(0));
        assert_eq!((Some(bound("min", 1)), Some(bound("max", 1))), ends(2));
        assert_eq!((Some(-bound("max", 2)), Some(-bound("min", 2))), ends(1));
    }
}

/// Converts the exported file at `path` with default options in place of the archive, and exports it again.
fn again(folder: &Path, input: &str) -> BTreeSet<Cube> {
    let mut options = ConvertOptions::new(vec![folder.join(input)], folder.join("a.slices"));
    options.overwrite = true;
    let report = convert(&options, &NoMonitor).unwrap();
    assert!(report.cubes > 0 && report.header.voxels.obstacle == 0);
    export(folder, &["-o", "again.bt"]);
    let (cubes, moved, _) = octomap(&fs::read(folder.join("again.bt")).unwrap());
    let by = moved.map(|metres| (metres / PIXEL_M).round() as i64);
    cubes.into_iter().map(|cube| [0, 1, 2].map(|axis| cube[axis] - by[axis])).collect()
}

#[test]
fn exported_cubes_come_back_as_the_same_cubes() {
    for corner in [[0.0; 3], [-2.03, -1.97, -1.0], [200_000.0, 500_000.0, 0.0]] {
        for name in ["c.bt", "c.voxel.json"] {
            let folder = folder(corner);
            let at = folder.path();
            let expected = expected(at);
            export(at, &["-o", name]);
            let tree = fs::read(at.join(name)).unwrap();
            assert!(again(at, name) == expected, "{corner:?} {name}");
            export(at, &["-o", name]);
            assert!(fs::read(at.join(name)).unwrap() == tree, "the same bytes: {corner:?} {name}");
        }
    }
}

#[test]
fn cubes_of_a_real_scan_come_back_as_the_same_cubes() {
    let Some(scan) = std::env::var_os("SLICEWALK_DATA").map(|data| Path::new(&data).join("pump_room.laz")) else {
        return eprintln!("skipped: SLICEWALK_DATA is not set");
    };
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut options = ConvertOptions::new(vec![scan], at.join("a.slices"));
    options.grid.pixel = PixelSize::Metres(PIXEL_M);
    convert(&options, &NoMonitor).unwrap();
    let expected = expected(at);
    assert!(expected.len() > 2000, "{}", expected.len());
    export(at, &["-o", "c.bt"]);
    export(at, &["-o", "c.voxel.json"]);
    let tree = fs::read(at.join("c.bt")).unwrap();
    assert!(again(at, "c.voxel.json") == expected);
    assert!(again(at, "c.bt") == expected && fs::read(at.join("again.bt")).unwrap() == tree);
}

#[test]
fn a_slice_height_that_is_no_multiple_of_pixels_loses_no_span() {
    let points = (0..4000).map(|n| {
        let [a, b, c] = [12.9898, 78.233, 37.719].map(|k| (f64::from(n) * k).sin().abs().fract() * 3.0);
        [a, b, c - 1.0]
    });
    let folder = converted(points.collect(), PIXEL_M, Some(0.17));
    let at = folder.path();
    let frame = *Archive::open(at.join("a.slices")).unwrap().frame();
    export(at, &["-o", "a.bt"]);
    let (cubes, ..) = octomap(&fs::read(at.join("a.bt")).unwrap());
    let mut reached = BTreeSet::new();
    each_span(&Archive::open(at.join("a.slices")).unwrap(), |[i, j], bottom, top| {
        let [low, high] = [frame.bottom_height(bottom), frame.top_height(top)];
        for k in (low / PIXEL_M).floor() as i64..=(high / PIXEL_M).ceil() as i64 {
            let edge = [k, k + 1].map(|k| k as f64 * PIXEL_M);
            // Beyond the rounding of an edge.
            if edge[1] > low + 1e-9 && edge[0] < high - 1e-9 {
                assert!(cubes.contains(&[i, j, k]), "{i} {j} {k}");
                reached.insert([i, j, k]);
            }
        }
    });
    // A cube beyond may come from a top on an edge, which rounding puts above it.
    assert!(cubes.len() <= reached.len() + reached.len() / 50, "{} {}", cubes.len(), reached.len());
}

#[test]
fn a_tree_of_octomap_far_from_the_origin_is_moved() {
    let corner = [200_000.0, 500_000.0, 0.0];
    let folder = folder(corner);
    let at = folder.path();
    let about = export(at, &["-o", "a.bt"]);
    let (cubes, moved, _) = octomap(&fs::read(at.join("a.bt")).unwrap());
    assert!(about.contains("moved by") && moved[2] == 0.0, "{about}");
    let by = moved.map(|metres| (metres / PIXEL_M).round() as i64);
    let expected: BTreeSet<Cube> =
        expected(at).into_iter().map(|cube| [0, 1, 2].map(|axis| cube[axis] + by[axis])).collect();
    assert_eq!(cubes, expected);
    let far = [[0.0, 0.0, 0.0], [7000.0, 0.0, 0.0]];
    let folder = converted(far.to_vec(), PIXEL_M, None);
    let out = run(folder.path(), &["-o", "a.bt"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(
        out.status.code() == Some(1) && said.contains("extract a region first") && said.lines().count() == 1,
        "{said}"
    );
    assert!(!folder.path().join("a.bt").exists());
}

/// Width, height, and samples by pixel of the scan.
fn map(folder: &Path, name: &str) -> (String, impl Fn(f64, f64) -> u8 + use<>) {
    let text = fs::read_to_string(folder.join(name)).unwrap();
    let value = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)).unwrap().trim().to_owned();
    let resolution: f64 = value("resolution:").parse().unwrap();
    let origin: Vec<f64> = value("origin:").trim_matches(['[', ']']).split(", ").map(|v| v.parse().unwrap()).collect();
    assert_eq!((resolution, origin[2], value("mode:")), (PIXEL_M, 0.0, "trinary".into()));
    // The map server compares (255 - v) / 255 with the thresholds.
    let shade = |v: u8| f64::from(255 - v) / 255.0;
    let [occupied, free] = ["occupied_thresh:", "free_thresh:"].map(|key| value(key).parse::<f64>().unwrap());
    assert!(shade(0) > occupied && shade(254) < free && (free..occupied).contains(&shade(205)));
    let bytes = fs::read(folder.join(value("image:").trim_matches('"'))).unwrap();
    let head = bytes.split(|byte| *byte == b'\n').take(3).map(|line| String::from_utf8_lossy(line).into_owned());
    let head: Vec<String> = head.collect();
    assert_eq!((&head[0][..], &head[2][..]), ("P5", "255"));
    let size: Vec<usize> = head[1].split(' ').map(|v| v.parse().unwrap()).collect();
    let samples = bytes[bytes.len() - size[0] * size[1]..].to_vec();
    let sample = move |x: f64, y: f64| {
        let (i, j) = (((x - origin[0]) / resolution) as usize, ((y - origin[1]) / resolution) as usize);
        samples[(size[1] - 1 - j) * size[0] + i]
    };
    (text, sample)
}

#[test]
fn maps_of_storeys_tell_free_occupied_and_unknown() {
    let folder = folder([10.0, -20.0, 0.0]);
    let at = folder.path();
    let about = export(at, &["-o", "m.yaml", "--pawn", "box:0.1x0.1x1.8"]);
    assert_eq!(about.lines().count(), 3, "{about}");
    let (_, ground) = map(at, "m_storey0.yaml");
    let (_, roof) = map(at, "m_storey1.yaml");
    let middle = |n: i32| f64::from(n) * PIXEL_M + 0.05;
    let (mut free, mut occupied) = (0, 0);
    for (i, j) in (-3..43).flat_map(|i| (-3..43).map(move |j| (i, j))) {
        let (x, y) = (10.0 + middle(i), -20.0 + middle(j));
        let is_inside = (0..40).contains(&i) && (0..40).contains(&j);
        let expected = match i {
            30 if is_inside => 0,
            _ if is_inside => 254,
            _ => 205,
        };
        // Beside the floor nothing is in the way.
        assert_eq!(ground(x, y), expected, "{i} {j}");
        free += usize::from(expected == 254);
        occupied += usize::from(expected == 0);
        if i < 25 && j < 25 {
            let is_roof = (0..20).contains(&i) && (0..20).contains(&j);
            assert_eq!(roof(x, y) == 254, is_roof, "{i} {j}");
        }
    }
    assert_eq!((free, occupied), (39 * 40, 40));
    let links: Value = serde_json::from_slice(&fs::read(at.join("m_links.geojson")).unwrap()).unwrap();
    assert_eq!(links["features"], Value::Array(Vec::new()));
    let all: BTreeSet<_> = fs::read_dir(at).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(all.len(), 6, "{all:?}");

    // A wider pawn keeps away from the wall, and one storey has the name that was asked for.
    export(at, &["-o", "one.yaml", "--z", "0.3", "--pawn", "box:0.5x0.5x1.8"]);
    let (_, wide) = map(at, "one.yaml");
    for i in 0..40 {
        assert_eq!(wide(10.0 + middle(i), -18.0), if (28..=32).contains(&i) { 0 } else { 254 }, "{i}");
    }
    export(at, &["-o", "one.yaml", "--storey", "1"]);
    assert!(map(at, "one.yaml").0.contains("floor at z = 2.75"));
    let out = run(at, &["-o", "one.yaml", "--storey", "2"]);
    assert!(out.status.code() == Some(1) && String::from_utf8_lossy(&out.stderr).contains("expected 0 to 1"));
    for arguments in [&["-o", "a.ply", "--storey", "0"][..], &["-o", "a.yaml", "--storey", "0", "--z", "1"]] {
        assert_eq!(run(at, arguments).status.code(), Some(2), "{arguments:?}");
    }
    assert_eq!(run(at, &["-o", "a.json"]).status.code(), Some(1));
    let wall = (0..80).flat_map(|j| (0..400).map(move |k| [3.0, f64::from(j) * 0.05, f64::from(k) * 0.05]));
    let folder = converted(wall.collect(), PIXEL_M, None);
    let out = run(folder.path(), &["-o", "n.yaml"]);
    assert!(out.status.code() == Some(1) && String::from_utf8_lossy(&out.stderr).contains("can stand nowhere"));
}

#[test]
fn stairs_between_storeys_are_links() {
    // Treads of 0.3 m and 0.2 m from the floor to a gallery at 3 m.
    let mut points = Vec::new();
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    points.extend((0..200).flat_map(|i| (0..80).map(move |j| [step(i), step(j), 0.0])));
    for tread in 0..15 {
        let z = f64::from(tread + 1) * 0.2;
        points.extend((0..6).flat_map(|i| (0..30).map(move |j| [5.0 + f64::from(tread) * 0.3 + step(i), step(j), z])));
    }
    points.extend((0..60).flat_map(|i| (0..80).map(move |j| [9.5 + step(i), step(j), 3.0])));
    let folder = converted(points, PIXEL_M, None);
    let at = folder.path();
    export(at, &["-o", "m.yaml"]);
    let links: Value = serde_json::from_slice(&fs::read(at.join("m_links.geojson")).unwrap()).unwrap();
    let [link] = &links["features"].as_array().unwrap()[..] else { panic!("{links}") };
    let about = &link["properties"];
    assert_eq!((&about["kind"], &about["from"], &about["to"]), (&"stairs".into(), &0.into(), &1.into()), "{links}");
    assert_eq!((&about["from_map"], &about["to_map"]), (&"m_storey0.yaml".into(), &"m_storey1.yaml".into()));
    let [x, y, z] = [0, 1, 2].map(|axis| link["geometry"]["coordinates"][axis].as_f64().unwrap());
    assert!((5.0..9.5).contains(&x) && (0.0..1.5).contains(&y) && (0.5..2.5).contains(&z), "{links}");
}
