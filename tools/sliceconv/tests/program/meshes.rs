//! Meshes: every format gives the same archive, real meshes answer boxes without a miss (G1) or a phantom (G2), order,
//! threads and memory change nothing (G4), and bad files are refused in one line.

use crate::files;
use crate::sat;
use crate::scans;
use crate::truth;

use files::{Ply, Triangle, buffer, structure, write_glb, write_obj, write_ply, write_stl};
use scans::{Random, converts, data, refuses, text, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::plan::Up;
use slicewalk::query::{Aabb, Answer, Overlap, overlaps, probe};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;
use slicewalk_mesh::{MeshMode, MeshOptions, MeshSet};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A heap of triangles of all sizes and slopes whose corners are exact in 32 bits, some of them level or upright.
fn heap(count: usize, seed: u64) -> Vec<Triangle> {
    let mut random = Random(seed);
    let mut steps = |size: f64| (random.uniform() * size * 64.0).round() / 64.0;
    (0..count)
        .map(|n| {
            let middle = [steps(30.0) - 15.0, steps(30.0) - 15.0, steps(6.0)];
            let size = if n % 50 == 0 { 8.0 } else { 0.7 };
            let mut triangle = [0; 3].map(|_| [0, 1, 2].map(|axis| middle[axis] + steps(size)));
            if n % 7 < 3 {
                (1..3).for_each(|k| triangle[k][n % 7] = triangle[0][n % 7]);
            }
            triangle
        })
        .collect()
}

fn archive(folder: &Path, inputs: &[&str], arguments: &[&str]) -> Vec<u8> {
    let fixed = ["-o", "out.slices", "--force", "--quiet", "--temp-dir", ".", "--pixel", "0.1"];
    converts(folder, &[inputs, &fixed, arguments].concat());
    fs::read(folder.join("out.slices")).unwrap()
}

/// Binary PLY of a triangle whose x and y are in 32 bits.
fn ply_in_floats(triangle: &Triangle) -> Vec<u8> {
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                  property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let corner =
        |&[x, y, z]: &[f64; 3]| [&(x as f32).to_le_bytes()[..], &(y as f32).to_le_bytes(), &z.to_le_bytes()].concat();
    let face = [0i32, 1, 2].map(i32::to_le_bytes).concat();
    [header.as_bytes(), &triangle.iter().flat_map(corner).collect::<Vec<u8>>(), &[3], &face].concat()
}

#[test]
fn meshes_in_floats_that_are_coarse_for_the_pixels_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let near: Triangle = [[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]];
    let far = near.map(|[x, y, z]| [x, y + 5_000_000.0, z]);
    for (place, triangle) in [("near", near), ("far", far)] {
        write_stl(&at(&format!("{place}.stl")), &[triangle], false);
        write_stl(&at(&format!("{place}-text.stl")), &[triangle], true);
        write_ply(&at(&format!("{place}-double.ply")), &[triangle], Ply::Little);
        fs::write(at(&format!("{place}.ply")), ply_in_floats(&triangle)).unwrap();
        write_obj(&at(&format!("{place}.obj")), &[triangle]);
    }
    let said = |inputs: &[&str], pixel: &str| {
        let options = ["-o", "out.slices", "--force", "--units", "m", "--pixel", pixel];
        let said = converts(folder.path(), &[inputs, &options].concat());
        said.lines().filter(|line| line.contains("floats of 32 bits")).collect::<Vec<_>>().join("\n")
    };
    for name in ["far.stl", "far.ply"] {
        let line = said(&[name], "0.5");
        assert!(
            line.contains(&format!("{name}: coordinates are floats of 32 bits, which are 0.5 m apart at")),
            "{line}"
        );
        assert_eq!(said(&[name], "2"), "", "{name}: a quarter of a pixel");
    }
    assert!(said(&["far.stl", "near.ply", "far.obj", "far.ply"], "0.5").contains("far.ply and 1 more: "));
    let quiet = ["near.stl", "near.ply", "far-text.stl", "far-double.ply", "far.obj"];
    assert_eq!(said(&quiet, "0.5"), "");
}

#[test]
fn every_format_gives_the_same_archive() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let heap = heap(3000, 1);
    write_obj(&at("a.obj"), &heap);
    for up in ["z", "y"] {
        let expected = archive(folder.path(), &["a.obj"], &["--up", up]);
        verifies(&at("out.slices"));
        for (name, form) in [("a.ply", Ply::Text), ("b.ply", Ply::Little), ("c.PLY", Ply::Big)] {
            write_ply(&at(name), &heap, form);
            assert!(archive(folder.path(), &[name], &["--up", up]) == expected, "{name}");
        }
        for (name, text) in [("a.stl", true), ("b.stl", false)] {
            write_stl(&at(name), &heap, text);
            assert!(archive(folder.path(), &[name], &["--up", up]) == expected, "{name}");
        }
        if up == "y" {
            let one = |source: &str| structure(3 * heap.len(), source, r#"[{"mesh":0}]"#, "[0]");
            write_glb(&at("a.glb"), &one(""), &buffer(&heap));
            fs::write(at("with space.bin"), buffer(&heap)).unwrap();
            fs::write(at("b.gltf"), one(r#","uri":"with%20space.bin""#)).unwrap();
            for name in ["a.glb", "b.gltf"] {
                assert!(archive(folder.path(), &[name], &["--up", "y"]) == expected, "{name}");
            }
        }
    }
}

#[test]
fn order_threads_memory_and_files_do_not_show() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut heap = heap(20_000, 2);
    write_obj(&at("a.obj"), &heap);
    let expected = archive(folder.path(), &["a.obj"], &["--threads", "1", "--memory", "1GiB"]);
    Random(4).shuffle(&mut heap);
    heap.iter_mut().enumerate().for_each(|(n, triangle)| triangle.rotate_left(n % 3));
    heap.iter_mut().step_by(3).for_each(|triangle| triangle.reverse());
    write_stl(&at("b.stl"), &heap[..9000], false);
    write_ply(&at("c.ply"), &heap[9000..], Ply::Little);
    for threads in ["1", "2", "4"] {
        let found = archive(folder.path(), &["c.ply", "b.stl"], &["--threads", threads, "--memory", "64MiB"]);
        assert!(found == expected, "{threads} threads");
    }
}

#[test]
fn polygons_negative_numbers_and_continued_lines_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // An L as one face, and a face that precedes its corners.
    fs::write(
        at("a.obj"),
        "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nf -6 -5 -4 \\\n -3 -2 -1 # an L\nf 7 8 9\nv 5 5 1 0.5 1 \
         1\r\nv 6 5 1\nv 5 6 1\n",
    )
    .unwrap();
    let l =
        [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]].map(|[x, y]| [x, y, 0.0]);
    let apart = [[5.0, 5.0, 1.0], [6.0, 5.0, 1.0], [5.0, 6.0, 1.0]];
    let cut = [[l[0], l[1], l[2]], [l[0], l[2], l[3]], [l[3], l[4], l[5]], [l[3], l[5], l[6]], apart];
    write_stl(&at("b.stl"), &cut, true);
    assert!(archive(folder.path(), &["a.obj"], &[]) == archive(folder.path(), &["b.stl"], &[]));
}

#[test]
fn a_byte_order_mark_before_text_is_no_part_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let heap = heap(60, 8);
    write_obj(&at("a.obj"), &heap);
    write_ply(&at("a.ply"), &heap, Ply::Text);
    write_stl(&at("a.stl"), &heap, true);
    fs::write(at("a.bin"), buffer(&heap)).unwrap();
    fs::write(at("a.gltf"), structure(180, r#","uri":"a.bin""#, r#"[{"mesh":0}]"#, "[0]")).unwrap();
    for name in ["a.obj", "a.ply", "a.stl", "a.gltf"] {
        let mut bytes = fs::read(at(name)).unwrap();
        if name == "a.obj" {
            // A meaningful line comes first.
            bytes = bytes.splitn(4, |&byte| byte == b'\n').last().unwrap().to_vec();
            assert!(bytes.starts_with(b"v "));
            fs::write(at(name), &bytes).unwrap();
        }
        let expected = archive(folder.path(), &[name], &[]);
        fs::write(at(name), [b"\xEF\xBB\xBF", &bytes[..]].concat()).unwrap();
        assert!(archive(folder.path(), &[name], &[]) == expected, "{name}");
    }
}

#[test]
fn nodes_of_gltf_place_their_meshes_and_the_triangles_are_turned_to_z_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let triangle = [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]];
    // Scaled by 2, rotated a quarter turn about y (x to −z), moved; then a child of that, moved along the parent's x.
    let nodes = r#"[{"children":[1],"mesh":0,"translation":[10,20,30],"rotation":[0,0.70710678118,0,0.70710678118],
        "scale":[2,2,2]},{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,5,0,0,1]}]"#;
    write_glb(&path, &structure(3, "", nodes, "[0]"), &buffer(&triangle));
    converts(folder.path(), &["a.glb", "-o", "a.slices", "--pixel", "0.1"]);
    let (min, max) = Archive::open(folder.path().join("a.slices")).unwrap().header().bounds.unwrap();
    // In glTF x is 10, y is 20 to 24, z is 18 (child: 30 − 2·(5 + 1)) to 30; z up: (x, −z, y).
    for (found, expected) in min.iter().chain(&max).zip([10.0, -30.0, 20.0, 10.0, -18.0, 24.0]) {
        assert!((found - expected).abs() < 1e-6, "{min:?} {max:?}");
    }
    let circle = r#"[{"children":[1],"mesh":0},{"children":[0]}]"#;
    write_glb(&path, &structure(3, "", circle, "[0]"), &buffer(&triangle));
    let said = refuses(folder.path(), &["a.glb", "-o", "b.slices", "--pixel", "0.1"], 1);
    assert!(said.contains("two parents"), "{said}");
}

#[test]
fn scans_and_meshes_mix_and_units_apply_to_both() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    scans::write(&at("a.las"), &[[1.0, 1.0, 1.0], [2.0, 1.0, 1.0], [1.0, 2.0, 1.0]]);
    write_obj(&at("b.obj"), &[[[5.0, 5.0, 2.0], [9.0, 5.0, 2.0], [5.0, 9.0, 2.0]]]);
    let said = converts(folder.path(), &["a.las", "b.obj", "-o", "a.slices", "--pixel", "0.05", "--units", "0.5"]);
    assert!(said.contains("a.slices: 4 points and triangles → "), "{said}");
    let store = Snapshot::resident(&Archive::open(at("a.slices")).unwrap(), &NoMonitor).unwrap();
    let hit = |p: [f64; 3]| overlaps(&store, &Aabb::new(p.into(), p.into()).unwrap()) == Overlap::Hit;
    assert!(hit([0.5, 0.5, 0.5]) && hit([3.0, 3.0, 1.0]) && !hit([4.4, 4.4, 1.0]) && !hit([3.0, 3.0, 1.2]));
}

/// A square of 4 m from `x` on whose far edge is higher by `rise`; upright if that is infinite.
fn slope(x: f64, rise: f64) -> [Triangle; 2] {
    let far = if rise.is_infinite() { (x, 4.0) } else { (x + 4.0, rise) };
    let [a, b, c, d] = [[x, 0.0, 0.0], [far.0, 0.0, far.1], [far.0, 4.0, far.1], [x, 4.0, 0.0]];
    [[a, b, c], [a, c, d]]
}

#[test]
fn the_true_slope_makes_obstacles_whatever_the_classifier_and_scanned_points_do_not_hide_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rises = [0.0, 4.0 * 44.9f64.to_radians().tan(), 4.0, 4.0 * 45.1f64.to_radians().tan(), f64::INFINITY];
    let all: Vec<Triangle> = rises.iter().enumerate().flat_map(|(n, rise)| slope(10.0 * n as f64, *rise)).collect();
    write_obj(&at("slopes.obj"), &all);
    // A scanned floor under all of them, and one that is two metres away.
    let scan: Vec<[f64; 3]> = (0..50_000)
        .map(|n| {
            [f64::from(n % 500) * 0.1 + 0.05, f64::from(n / 500) * 0.04 + 0.02, if n % 2 == 0 { -0.01 } else { -2.0 }]
        })
        .collect();
    scans::write(&at("floor.las"), &scan);
    for rule in ["plane", "span", "thesis"] {
        for inputs in [&["slopes.obj"][..], &["slopes.obj", "floor.las"]] {
            archive(folder.path(), inputs, &["--classifier", rule, "--units", "m"]);
            let store = Snapshot::resident(&Archive::open(at("out.slices")).unwrap(), &NoMonitor).unwrap();
            let found = |n: usize| {
                // Halfway up.
                let start = 10.0 * n as f64;
                let (x, z) = if rises[n].is_infinite() { (start, 2.0) } else { (start + 2.0, rises[n] / 2.0) };
                let shape = Aabb::new([x, 1.0, z].into(), [x, 3.0, z].into()).unwrap();
                let Answer::Known(found) = probe(&store, &shape) else { panic!("all is loaded") };
                assert!(found.hit, "{rule}, {inputs:?}: slope {n}");
                found.obstacle
            };
            let verdicts = [0, 1, 2, 3, 4].map(found);
            assert_eq!(verdicts, [false, false, false, true, true], "{rule}, {inputs:?}");
        }
    }
}

fn real_meshes() -> Vec<(PathBuf, Up, f64)> {
    let Some(data) = data::folder() else { return Vec::new() };
    [("sibenik", Up::Y, 0.1), ("sponza_dabrovic", Up::Y, 0.1), ("nav_test", Up::Y, 0.25), ("delft_street", Up::Z, 0.5)]
        .map(|(name, up, t)| (data.join(format!("meshes/{name}.obj")), up, t))
        .into_iter()
        .chain([(data.join("meshes/bunny_stanford.ply"), Up::Y, 0.001)])
        .collect()
}

fn store_of(path: &Path, up: Up, t: f64, mesh: MeshMode) -> Snapshot {
    let folder = tempfile::tempdir().unwrap();
    let mut options = ConvertOptions::new(vec![path.to_path_buf()], folder.path().join("a.slices"));
    (options.plan.up, options.grid.pixel, options.reading.mesh) = (up, PixelSize::Metres(t), mesh);
    convert(&options, &NoMonitor).unwrap();
    verifies(&options.output);
    Snapshot::resident(&Archive::open(&options.output).unwrap(), &NoMonitor).unwrap()
}

#[test]
fn boxes_on_real_meshes_have_no_miss_and_no_phantom() {
    let folder = tempfile::tempdir().unwrap();
    for (path, up, t) in real_meshes() {
        // Faces are often not flat, and each reader triangulates them differently; here the test decides.
        let triangles = files::read(&path);
        let cut = folder.path().join("cut.obj");
        write_obj(&cut, &triangles);
        let store = store_of(&cut, up, t, MeshMode::Exact);
        let truth = truth::Truth::new(triangles, up == Up::Y, 4.0 * t);
        let mut random = Random(12);
        let (mut hits, mut clear) = (0, 0);
        for _ in 0..3_000 {
            let place = truth.place(&mut random);
            let size = [0; 3].map(|_| 3.0 * t * random.uniform().powi(3));
            let off = [0; 3].map(|_| 4.0 * t * (random.uniform() - 0.5));
            let min = [0, 1, 2].map(|k| place[k] + off[k] - size[k] / 2.0);
            let shape = sat::Box3 { min, max: [0, 1, 2].map(|k| min[k] + size[k]) };
            let found = overlaps(&store, &Aabb::new(shape.min.into(), shape.max.into()).unwrap());
            let slack = 1e-9;
            if truth.nearest(&shape) < -slack {
                assert_eq!(found, Overlap::Hit, "{}: missed {shape:?}", path.display());
                hits += 1;
            } else if truth.nearest(&shape.grown([t, t, 3.0 * t])) > slack {
                assert_eq!(found, Overlap::Clear, "{}: phantom {shape:?}", path.display());
                clear += 1;
            }
        }
        assert!(hits > 300 && clear > 30, "{}: {hits} {clear}: the test shows little", path.display());
    }
}

/// Occupied voxels: pixels and slices.
fn voxels(store: &Snapshot) -> BTreeSet<(i64, i64, i64)> {
    truth::voxels(store)
}

#[test]
fn points_a_quarter_of_a_pixel_apart_fill_the_pixels_of_their_triangles_but_for_cut_corners() {
    for (path, up, t) in real_meshes() {
        let exact = voxels(&store_of(&path, up, t, MeshMode::Exact));
        let sampled = voxels(&store_of(&path, up, t, MeshMode::Sampled { step_m: Some(t / 4.0) }));
        let name = path.display();
        // A rounded point may lie beside its triangle, in the next pixel or slice.
        let beyond = sampled.difference(&exact).count();
        assert!(beyond <= sampled.len() / 10_000, "{name}: {beyond} of {} beyond the triangles", sampled.len());
        // Points miss corners of a pixel or ends of a slice that a triangle cuts off within less than a step: beside it
        // is a pixel that they do not miss.
        let missed: Vec<_> = exact.difference(&sampled).collect();
        assert!(missed.len() < exact.len() / 8, "{name}: {} of {} missed", missed.len(), exact.len());
        for &&(i, j, s) in &missed {
            let around = (0..27).map(|n| (i + n % 3 - 1, j + n / 3 % 3 - 1, s + n / 9 - 1));
            assert!(around.into_iter().any(|at| sampled.contains(&at)), "{name}: ({i}, {j}, {s}) is missed whole");
        }
    }
}

#[test]
fn bad_files_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let heap = heap(200, 3);
    let good = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    write_ply(&at("good.ply"), &heap, Ply::Little);
    write_ply(&at("text.ply"), &heap, Ply::Text);
    write_stl(&at("good.stl"), &heap, false);
    write_stl(&at("text.stl"), &heap, true);
    write_glb(&at("good.glb"), &structure(600, "", r#"[{"mesh":0}]"#, "[0]"), &buffer(&heap));
    let bytes = |name: &str| fs::read(at(name)).unwrap();
    let cut = |name: &str, by: usize| bytes(name)[..bytes(name).len() - by].to_vec();
    let json = |from: &str, to: &str| {
        let text = structure(600, "", r#"[{"mesh":0}]"#, "[0]");
        assert!(text.contains(from), "{from}");
        write_glb(&at("changed.glb"), &text.replace(from, to), &buffer(&heap));
        bytes("changed.glb")
    };
    let ply = |from: &str, to: &str| {
        let text = String::from_utf8(bytes("text.ply")).unwrap();
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1).into_bytes()
    };
    let cases: &[(&str, Vec<u8>, &str)] = &[
        ("a.obj", good.into(), "no triangles"),
        ("a.obj", vec![], "no triangles"),
        ("a.obj", format!("{good}f 1 2 4\n").into(), "line 4: there is no corner \"4\""),
        ("a.obj", format!("{good}f 1 2 0\n").into(), "no corner \"0\""),
        ("a.obj", format!("{good}f 1 2 -4\n").into(), "no corner \"-4\""),
        ("a.obj", format!("{good}f 1 2 99999999999999999999\n").into(), "line 4: expected the number of a corner"),
        ("a.obj", format!("{good}f 1 2 9223372036854775807\n").into(), "no corner"),
        ("a.obj", format!("{good}f 1 2\n").into(), "line 4: a face has 2 corners"),
        ("a.obj", "v 0 0 zero\n".into(), "line 1: expected a number, found \"zero\""),
        ("a.obj", "v 0 0\n".into(), "found the end of the line"),
        ("a.obj", vec![b'v'; 3 << 20], "more than 1048576 bytes"),
        ("a.obj", (0..10_000u32).flat_map(|n| n.wrapping_mul(2_654_435_769).to_le_bytes()).collect(), "a.obj"),
        ("a.obj", format!("{good}f 1 1 2\nf 1 2 2\n").into(), "none of its 2 triangles has an area"),
        ("a.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".into(), "none of its 1 triangles"),
        ("a.obj", "v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".into(), "none of its 1 triangles"),
        ("a.obj", "v 1e11 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".into(), "give a larger --pixel, or the unit by --units"),
        ("a.obj", "v 1e7 0 0\nv 1 0 0\nv 0 1e7 0\nf 1 2 3\n".into(), "voxels that one triangle fills"),
        ("a.ply", vec![], "this is no PLY file"),
        ("a.ply", b"PK\x03\x04zip".to_vec(), "this is no PLY file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n".to_vec(), "ends before \"end_header\""),
        ("a.ply", cut("good.ply", 5), "the file ends before the elements"),
        ("a.ply", cut("text.ply", 40), "line 8"),
        ("a.ply", ply("property double y", "property double why"), "no properties x, y and z"),
        ("a.ply", ply("vertex_indices", "corners"), "no list \"vertex_indices\""),
        ("a.ply", ply("property float", "property quaternion"), "a property that PLY does not know"),
        ("a.ply", ply("element face 200", "element face 18446744073709551615"), "the file ends before"),
        ("a.ply", ply("element vertex ", "element vertex -"), "expected a number of elements"),
        ("a.ply", ply("format ascii", "format utf8"), "found \"utf8\""),
        ("a.ply", ply("\n9 3 ", "\n9 70000 "), "a list of 70000 numbers"),
        ("a.ply", ply("\n9 3 ", "\n9 3 99999"), "there is no corner"),
        ("a.stl", vec![1, 2, 3], "at least 84 bytes"),
        ("a.stl", cut("good.stl", 1), "cut or damaged"),
        ("a.stl", [vec![0; 80], vec![255; 4]].concat(), "states 4294967295 triangles"),
        ("a.stl", vec![0; 84], "no triangles"),
        ("a.stl", cut("text.stl", 15), "ends before \"endsolid\""),
        ("a.stl", b"solid a\n vertex 1 2 3\n endloop\n".to_vec(), "a loop has 1 corners"),
        ("a.stl", b"solid a\n nonsense\n".to_vec(), "found \"nonsense\""),
        ("a.glb", cut("good.glb", 1), "cut or damaged"),
        ("a.glb", bytes("good.glb")[..15].to_vec(), "header"),
        ("a.gltf", b"{".to_vec(), "structure"),
        ("a.gltf", b"{\"asset\":{\"version\":\"2.0\"}}".to_vec(), "no triangles"),
        (
            "a.gltf",
            br#"{"asset":{"version":"2.0"},"extensionsRequired":["KHR_materials_unlit","KHR_gaussian_splatting"]}"#
                .to_vec(),
            "Gaussian splats",
        ),
        (
            "a.gltf",
            structure(3, r#","uri":"none.bin""#, r#"[{"mesh":0}]"#, "[0]").into(),
            "buffer 0: cannot open none.bin",
        ),
        ("a.gltf", structure(3, r#","uri":"https://x/y""#, r#"[{"mesh":0}]"#, "[0]").into(), "it lies elsewhere"),
        ("a.gltf", structure(3, r#","uri":"data:;base64,AAA!""#, r#"[{"mesh":0}]"#, "[0]").into(), "base64"),
        ("a.gltf", structure(3, r#","uri":"data:;base64,AAAA""#, r#"[{"mesh":0}]"#, "[0]").into(), "it is cut"),
        ("a.gltf", structure(3, "", r#"[{"mesh":0}]"#, "[0]").into(), "no binary part"),
        ("a.glb", json("\"count\":600", "\"count\":601"), "accessor 0: its 601 values reach beyond"),
        ("a.glb", json("\"count\":600", "\"count\":4611686018427387904"), "accessor 0"),
        ("a.glb", json("\"VEC3\"", "\"VEC2\""), "accessor 0: expected Vec3"),
        ("a.glb", json("\"byteLength\":7200", "\"byteLength\":9999999"), "a.glb"),
        ("a.glb", json("\"POSITION\":0", "\"POSITION\":5"), "structure"),
    ];
    for (number, (name, bytes, expected)) in cases.iter().enumerate() {
        fs::write(at(name), bytes).unwrap();
        let said = refuses(folder.path(), &[name, "-o", "bad.slices", "--pixel", "0.01", "--threads", "2"], 1);
        assert!(said.contains(expected), "case {number}: {said}: expected {expected}");
        assert!(!at("bad.slices").exists() && said.contains(name), "case {number}: {said}");
    }
    let said = refuses(folder.path(), &["a.off", "-o", "bad.slices"], 1);
    assert!(said.contains("a.off"), "{said}");
}

#[test]
fn damage_anywhere_is_an_error_of_one_line_or_other_triangles() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let heap = heap(30, 5);
    write_obj(&at("a.obj"), &heap);
    for (name, form) in [("a.ply", Ply::Text), ("b.ply", Ply::Little), ("c.ply", Ply::Big)] {
        write_ply(&at(name), &heap, form);
    }
    for (name, text) in [("a.stl", true), ("b.stl", false)] {
        write_stl(&at(name), &heap, text);
    }
    let nodes = r#"[{"mesh":0,"children":[1]},{"mesh":0,"translation":[1,2,3]}]"#;
    write_glb(&at("a.glb"), &structure(90, "", nodes, "[0]"), &buffer(&heap));
    let mut random = Random(17);
    let (mut refused, mut read) = (0, 0);
    for name in ["a.obj", "a.ply", "b.ply", "c.ply", "a.stl", "b.stl", "a.glb"] {
        let whole = fs::read(at(name)).unwrap();
        let bad = at(&format!("bad-{name}"));
        for round in 0..300 {
            let mut bytes = whole.clone();
            // As often near the front as anywhere, because the structure is there.
            let limit = if round % 2 == 0 { bytes.len() } else { bytes.len().min(700) };
            let place = random.below(limit);
            match round % 5 {
                0 => bytes.truncate(place),
                1 => bytes[place] ^= 1 << random.below(8),
                2 => bytes[place] = random.below(256) as u8,
                3 => drop(bytes.drain(place..(place + 1 + random.below(9)).min(whole.len()))),
                _ => bytes[place] = b"0123456789-.e{}[],\n "[random.below(20)],
            }
            fs::write(&bad, &bytes).unwrap();
            let (units, temp_dir) = (Units::Factor(1.0), folder.path().to_path_buf());
            let options = MeshOptions { units, memory_bytes: 1 << 20, temp_dir, ..MeshOptions::default() };
            let set = MeshSet::open(std::slice::from_ref(&bad), options, &NoMonitor).unwrap();
            let (mut feed, mut batch) = (set.feed(), Vec::new());
            let error = loop {
                match feed.next(&mut batch, &NoMonitor) {
                    Ok(true) => assert!(batch.len() < 10_000),
                    Ok(false) => break None,
                    Err(error) => break Some(error.to_string()),
                }
            };
            match error {
                Some(error) => {
                    assert!(error.contains("bad-") && !error.contains('\n'), "{name}, {round}: {error}");
                    refused += 1;
                }
                None => read += 1,
            }
        }
    }
    assert!(refused > 300 && read > 300, "{refused} {read}: the test shows little");
}

#[test]
fn triangles_without_area_are_left_out_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 2\nf 1 2 4\nf 1 2 3\n").unwrap();
    let said = converts(folder.path(), &[text(&path), "-o", "a.slices"]);
    assert!(said.contains("2 of 4 triangles left out"), "{said}");
    assert!(said.contains("a.slices: 2 triangles → ") && said.contains("left out: 2 triangles (2 unusable)"), "{said}");
    assert!(said.contains("metres are assumed"), "{said}");
    let header = Archive::open(folder.path().join("a.slices")).unwrap().header().clone();
    assert_eq!((header.points_read, header.points_kept), (4, 2));
    // A 700th of an extent of one metre, to two digits.
    assert_eq!(header.plan.frame.pixel_m(), 0.0014);
}
