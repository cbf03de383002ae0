//! Colours of meshes: voxels get the colours of corners, materials and textures, within a bound of a formula's values;
//! order, threads, memory and parts change no byte; missing or hostile textures are warnings and do not affect the
//! geometry.

use crate::files;
use crate::scans;

use files::write_glb;
use scangen::{WriteSpec, write_las};
use scans::{Random, colours, converts, refuses, text, verifies};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, merge};
use slicewalk::frame::Frame;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

const OPTIONS: [&str; 9] =
    ["--pixel", "0.1", "--units", "m", "--quiet", "--force", "--temp-dir", ".", "--colour-error"];
/// Texels of the texture.
const SIZE: [u32; 2] = [512, 384];

/// Colour at a position of the texture, 0 to 1 from its upper left, before rounding.
fn formula([u, v]: [f64; 2]) -> [f64; 3] {
    [255.0 * u, 255.0 * v, 128.0 + 100.0 * (6.0 * u + 4.0 * v).sin()]
}

fn write_texture(path: &Path) {
    let [width, height] = SIZE;
    let texel = |x: u32, y: u32| {
        formula([(f64::from(x) + 0.5) / f64::from(width), (f64::from(y) + 0.5) / f64::from(height)])
            .map(|value| value.round() as u8)
    };
    let rgb: Vec<u8> = (0..height).flat_map(|y| (0..width).flat_map(move |x| texel(x, y))).collect();
    fs::write(path, png(width, height, &rgb)).unwrap();
}

fn png(width: u32, height: u32, rgb: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(rgb).unwrap();
    bytes
}

/// Point on the quad for a position in its texture: 6.4 × 4.8 m, tilted along both axes.
fn place([u, v]: [f64; 2]) -> [f64; 3] {
    [6.4 * u + 0.03, 4.8 * (1.0 - v) - 0.02, 1.5 * u + 2.2 * (1.0 - v) + 0.013]
}

/// The quad in `cut × cut` pieces of two triangles each, as positions in the texture.
fn quad(cut: u32) -> Vec<[[f64; 2]; 3]> {
    let at = |n: u32| f64::from(n) / f64::from(cut);
    let pieces = (0..cut).flat_map(|y| (0..cut).map(move |x| (x, y)));
    pieces
        .flat_map(|(x, y)| {
            let corner = |dx: u32, dy: u32| [at(x + dx), at(y + dy)];
            [[corner(0, 0), corner(1, 0), corner(0, 1)], [corner(1, 0), corner(1, 1), corner(0, 1)]]
        })
        .collect()
}

/// Mean colours of the voxels that the quad meets, from very many points on it.
fn truth(frame: &Frame) -> BTreeMap<[i64; 3], ([f64; 3], u32)> {
    let mut sums: BTreeMap<[i64; 3], ([f64; 3], u32)> = BTreeMap::new();
    for y in 0..1500 {
        for x in 0..2000 {
            let at = [(f64::from(x) + 0.5) / 2000.0, (f64::from(y) + 0.5) / 1500.0];
            let [px, py, pz] = place(at);
            let voxel = [frame.pixel_of(px), frame.pixel_of(py), frame.slice_of(pz)];
            let (sum, n) = sums.entry(voxel).or_default();
            formula(at).iter().zip(sum).for_each(|(value, sum)| *sum += value);
            *n += 1;
        }
    }
    sums.values_mut().for_each(|(sum, n)| *sum = sum.map(|sum| sum / f64::from(*n)));
    sums
}

fn convert(at: &Path, inputs: &[&str], output: &str, options: &[&str]) -> Archive {
    converts(at, &[inputs, &["-o", output], &OPTIONS, &["0"], options].concat());
    verifies(&at.join(output));
    Archive::open(at.join(output)).unwrap()
}

/// Arguments of the conversion of one file.
fn arguments<'a>(input: &'a str, options: &[&'a str]) -> Vec<&'a str> {
    let own = [input, "-o", "a.slices", "--pixel", "0.1", "--units", "m", "--force", "--colour-error", "0"];
    [&own, options].concat()
}

/// Checks that every voxel has a colour near the true one.
fn assert_is_the_texture(archive: &Archive, mean_limit: f64, what: &str) {
    let truth = truth(archive.frame());
    let (mut sum, mut count, mut most) = (0.0, 0, 0.0f64);
    for (voxel, colour) in colours(archive) {
        let colour = colour.unwrap_or_else(|| panic!("{what}: {voxel:?} has no colour"));
        // Skips slivers at the edge, with few points.
        let Some((exact, n)) = truth.get(&voxel).filter(|(_, n)| *n > 50) else { continue };
        assert!(*n > 0);
        let apart = (0..3).map(|k| (exact[k] - f64::from(colour[k])).abs()).fold(0.0, f64::max);
        (sum, count, most) = (sum + apart, count + 1, most.max(apart));
    }
    assert!(count > 2500, "{what}: {count}");
    assert!(
        sum / f64::from(count) < mean_limit && most < 6.0 * mean_limit,
        "{what}: {} and {most}",
        sum / f64::from(count)
    );
}

fn write_obj(path: &Path, triangles: &[[[f64; 2]; 3]], materials: &str) {
    write_obj_with(path, triangles, materials, |place| place);
}

/// `named` maps positions in the texture, from its lower left, to those that corners name.
fn write_obj_with(path: &Path, triangles: &[[[f64; 2]; 3]], materials: &str, named: impl Fn([f64; 2]) -> [f64; 2]) {
    let mut out = format!("mtllib {materials}\nusemtl first\n");
    for corner in triangles.iter().flatten() {
        let ([x, y, z], [u, v]) = (place(*corner), named([corner[0], 1.0 - corner[1]]));
        writeln!(out, "v {x} {y} {z}\nvt {u} {v}").unwrap();
    }
    out.push_str("usemtl wood\n");
    (0..triangles.len())
        .for_each(|n| writeln!(out, "f {0}/{0} {1}/{1}/ {2}/{2}", 3 * n + 1, 3 * n + 2, 3 * n + 3).unwrap());
    fs::write(path, out).unwrap();
}

fn write_ply(path: &Path, triangles: &[[[f64; 2]; 3]], colour: &str) {
    let white = if colour == "float" { 1.0 } else { 255.0 };
    let mut out = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nproperty {colour} red\n\
         property {colour} green\nproperty {colour} blue\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        3 * triangles.len(),
        triangles.len()
    );
    for corner in triangles.iter().flatten() {
        let ([x, y, z], [r, g, b]) = (place(*corner), formula(*corner).map(|v| v / 255.0 * white));
        let (r, g, b) = if white > 1.0 { (r.round(), g.round(), b.round()) } else { (r, g, b) };
        writeln!(out, "{x} {y} {z} {r} {g} {b}").unwrap();
    }
    (0..triangles.len()).for_each(|n| writeln!(out, "3 {} {} {}", 3 * n, 3 * n + 1, 3 * n + 2).unwrap());
    fs::write(path, out).unwrap();
}

/// A structure and a buffer of the quad: coordinates, positions in the texture, and the texture itself.
fn gltf(triangles: &[[[f64; 2]; 3]], image: &[u8], uri: Option<&str>) -> (String, Vec<u8>) {
    gltf_with(triangles, image, uri, |place| place)
}

/// `named` maps positions in the texture to those that corners name.
fn gltf_with(
    triangles: &[[[f64; 2]; 3]],
    image: &[u8],
    uri: Option<&str>,
    named: impl Fn([f64; 2]) -> [f64; 2],
) -> (String, Vec<u8>) {
    let corners: Vec<[f64; 2]> = triangles.iter().flatten().copied().collect();
    let float = |value: f64| (value as f32).to_le_bytes();
    // z up becomes y up.
    let mut buffer: Vec<u8> = corners
        .iter()
        .flat_map(|corner| {
            let [x, y, z] = place(*corner);
            [x, z, -y].map(float).concat()
        })
        .collect();
    buffer.extend(corners.iter().flat_map(|corner| named(*corner).map(float).concat()));
    let (count, at) = (corners.len(), buffer.len());
    buffer.extend(image);
    let image = match uri {
        Some(uri) => format!(r#"{{"uri":"{uri}"}}"#),
        None => r#"{"bufferView":2,"mimeType":"image/png"}"#.into(),
    };
    let structure = format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,
        "TEXCOORD_0":1}},"material":0}}]}}],"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
        "textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071,"wrapT":33071}}],"images":[{image}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[-9,-9,-9],"max":[9,9,9]}},
        {{"bufferView":1,"componentType":5126,"count":{count},"type":"VEC2"}}],
        "bufferViews":[{{"buffer":0,"byteLength":{}}},{{"buffer":0,"byteOffset":{},"byteLength":{}}},
        {{"buffer":0,"byteOffset":{at},"byteLength":{}}}],"buffers":[{{"byteLength":{}}}]}}"#,
        12 * count,
        12 * count,
        8 * count,
        buffer.len() - at,
        buffer.len()
    );
    (structure, buffer)
}

const MATERIALS: &str = "newmtl first\nKd 1 0 0\nnewmtl wood\nKd 0 0 0\nmap_Kd -s 1 1 1 my textures\\a b.png\n";

#[test]
#[ignore = "slow: .ci/run"]
fn voxels_have_the_colours_of_the_texture_and_of_corners_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("my textures")).unwrap();
    write_texture(&at.join("my textures/a b.png"));
    let image = fs::read(at.join("my textures/a b.png")).unwrap();
    fs::write(at.join("a.mtl"), MATERIALS).unwrap();
    write_obj(&at.join("a.obj"), &quad(1), "a.mtl");
    write_obj(&at.join("b.obj"), &quad(40), "none.mtl ./a.mtl");
    let (structure, buffer) = gltf(&quad(3), &image, None);
    write_glb(&at.join("c.glb"), &structure, &buffer);
    let (structure, buffer) = gltf(&quad(2), &[], Some("my%20textures/a%20b.png"));
    write_glb(&at.join("d.glb"), &structure, &buffer);
    write_ply(&at.join("e.ply"), &quad(200), "uchar");
    write_ply(&at.join("f.ply"), &quad(64), "float");
    for (name, limit) in
        [("a.obj", 2.5), ("b.obj", 2.5), ("c.glb", 2.5), ("d.glb", 2.5), ("e.ply", 1.5), ("f.ply", 1.5)]
    {
        for options in [&["--colour", "rgb"][..], &["--colour", "auto", "--mesh", "sampled"]] {
            let sampled = options.len() > 2;
            let archive = convert(at, &[name], "a.slices", options);
            assert_is_the_texture(&archive, if sampled { 3.0 } else { limit }, &format!("{name} {options:?}"));
            let plain: Vec<&str> =
                options.iter().copied().filter(|o| !["--colour", "rgb", "auto"].contains(o)).collect();
            let plain = convert(at, &[name], "plain.slices", &plain);
            let pages = |archive: &Archive| {
                let header = archive.header();
                let mut bytes = vec![0; (header.colours_offset() - header.pages_offset()) as usize];
                archive.source().read_at(header.pages_offset(), &mut bytes).unwrap();
                bytes
            };
            assert!(pages(&archive) == pages(&plain), "{name}");
        }
    }
}

#[test]
fn textures_lie_where_materials_move_scale_and_turn_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_texture(&at.join("a.png"));
    let image = fs::read(at.join("a.png")).unwrap();
    let write_mtl = |options: &str| fs::write(at.join("a.mtl"), format!("newmtl wood\nmap_Kd {options} a.png\n"));
    write_mtl("-s 2 -4 1 -o 0.25 0.5").unwrap();
    write_obj_with(&at.join("a.obj"), &quad(5), "a.mtl", |[u, v]| [(u - 0.25) / 2.0, (v - 0.5) / -4.0]);
    // Inverts the extension's transform of a position: moved, rotated, scaled.
    let ((sin, cos), offset, scale) = (0.7f64.sin_cos(), [0.3, -0.2], [2.0, 0.5]);
    let named = |[u, v]: [f64; 2]| {
        let (u, v) = (u - offset[0], v - offset[1]);
        [(cos * u - sin * v) / scale[0], (sin * u + cos * v) / scale[1]]
    };
    let (structure, buffer) = gltf_with(&quad(5), &image, None, named);
    let transform = r#""KHR_texture_transform":{"offset":[0.3,-0.2],"rotation":0.7,"scale":[2,0.5],"texCoord":1}"#;
    let structure = structure
        .replace(r#"{"index":0}"#, &format!(r#"{{"index":0,"extensions":{{{transform}}}}}"#))
        .replace(r#""TEXCOORD_0":1"#, r#""TEXCOORD_1":1"#)
        .replace(r#"{"asset""#, r#"{"extensionsRequired":["KHR_texture_transform"],"asset""#);
    write_glb(&at.join("b.glb"), &structure, &buffer);
    for name in ["a.obj", "b.glb"] {
        let archive = convert(at, &[name], "a.slices", &["--colour", "rgb"]);
        assert_is_the_texture(&archive, 2.5, name);
    }
    write_mtl("-t 0.5 -mm 0 1").unwrap();
    let said = converts(at, &arguments("a.obj", &["--colour", "rgb"]));
    assert_eq!(said.matches("map_Kd -t 0.5 is not supported and is left out").count(), 1, "{said}");
    let other = structure.replace("KHR_texture_transform", "KHR_other");
    write_glb(&at.join("b.glb"), &other, &buffer);
    let said = refuses(at, &arguments("b.glb", &["--colour", "rgb"]), 1);
    assert!(said.contains("requires the extension \"KHR_other\""), "{said}");
}

#[test]
fn textures_in_jpeg_are_read_in_both_forms() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (name, bytes) in [
        ("baseline", &include_bytes!("../../../../tests/mesh/baseline.jpg")[..]),
        ("progressive", include_bytes!("../../../../tests/mesh/progressive.jpg")),
    ] {
        let (structure, buffer) = gltf(&quad(2), bytes, None);
        write_glb(&at.join("a.glb"), &structure, &buffer);
        let archive = convert(at, &["a.glb"], "a.slices", &["--colour", "rgb"]);
        let mut seen = 0;
        for (voxel, colour) in colours(&archive) {
            // The middle of the voxel, mapped to the texture of 64 × 48 texels whose colour at (x, y) is (4x, 5y, 128).
            let middle = |axis: usize| (voxel[axis] as f64 + 0.5) * 0.1;
            let (u, v) = ((middle(0) - 0.03) / 6.4, 1.0 - (middle(1) + 0.02) / 4.8);
            let [r, g, b] = colour.unwrap().map(f64::from);
            if (0.02..0.98).contains(&u) && (0.02..0.98).contains(&v) {
                let apart = [r - 4.0 * (64.0 * u - 0.5), g - 5.0 * (48.0 * v - 0.5), b - 128.0];
                assert!(apart.iter().all(|v| v.abs() < 9.0), "{name} {voxel:?}: {r} {g} {b}, {apart:?}");
                seen += 1;
            }
        }
        assert!(seen > 2500, "{seen}");
    }
}

#[test]
fn order_threads_memory_and_parts_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("my textures")).unwrap();
    write_texture(&at.join("my textures/a b.png"));
    fs::write(at.join("a.mtl"), MATERIALS).unwrap();
    let mut triangles = quad(70);
    write_obj(&at.join("a.obj"), &triangles, "a.mtl");
    Random(3).shuffle(&mut triangles);
    triangles.iter_mut().enumerate().for_each(|(n, triangle)| triangle.rotate_left(n % 3));
    triangles.iter_mut().step_by(3).for_each(|triangle| triangle.reverse());
    write_obj(&at.join("b.obj"), &triangles[..3000], "a.mtl");
    write_obj(&at.join("c.obj"), &triangles[3000..], "a.mtl");
    // With a 16-bit scan beside it: triangles are scaled to its range of values.
    let spec = WriteSpec {
        format: 7,
        texture: Some(scangen::Texture { period_m: 1.0, eight_bits: false, exposure: 0.0 }),
        ..WriteSpec::for_path(&at.join("s.laz"))
    };
    let points = (0..20_000).map(|n| [f64::from(n % 160) * 0.05, f64::from(n / 160) * 0.04, 0.5]);
    write_las(&at.join("s.laz"), points, &spec).unwrap();
    for scan in [&[][..], &["s.laz"][..]] {
        let all = |meshes: &[&'static str]| [meshes, scan].concat();
        let whole = convert(at, &all(&["a.obj"]), "whole.slices", &["--colour", "rgb", "--threads", "1"]);
        let high = whole.header().colours.unwrap().plan.scale.high;
        assert_eq!(high, if scan.is_empty() { 255 } else { 65_535 });
        let bytes = fs::read(at.join("whole.slices")).unwrap();
        for options in [["--threads", "4", "--memory", "64MiB"], ["--threads", "2", "--memory", "2GiB"]] {
            convert(at, &all(&["c.obj", "b.obj"]), "again.slices", &[&["--colour", "auto"], &options[..]].concat());
            assert!(fs::read(at.join("again.slices")).unwrap() == bytes, "{options:?}");
        }
        let parts: Vec<PathBuf> = (1..=3).map(|index| at.join(format!("{index}.slices"))).collect();
        for planned in [false, true] {
            if planned {
                converts(
                    at,
                    &[&all(&["a.obj"])[..], &["--write-plan", "p.json", "--colour", "rgb"], &OPTIONS, &["0"]].concat(),
                );
            }
            for (index, part) in parts.iter().enumerate() {
                let shard = format!("{}/3", index + 1);
                if planned {
                    let own = ["-o", text(part), "--plan", "p.json", "--shard", &shard, "--quiet", "--force"];
                    converts(at, &[&all(&["a.obj"])[..], &own].concat());
                } else {
                    convert(at, &all(&["a.obj"]), text(part), &["--colour", "rgb", "--shard", &shard]);
                }
            }
            merge(&parts, &at.join("merged.slices"), true, &NoMonitor).unwrap();
            assert!(fs::read(at.join("merged.slices")).unwrap() == bytes, "planned: {planned}");
        }
    }
}

/// The single colour of an archive.
fn only_colour(archive: &Archive) -> Option<[u8; 3]> {
    let mut all: Vec<Option<[u8; 3]>> = colours(archive).into_values().collect();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 1, "{all:?}");
    all[0]
}

#[test]
fn materials_factors_and_faces_colour_whole_triangles() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.mtl"), "newmtl wood\r\nKd 0.2 0.4 1.0\r\n").unwrap();
    write_obj(&at.join("a.obj"), &quad(3), "a.mtl");
    assert_eq!(only_colour(&convert(at, &["a.obj"], "a.slices", &["--colour", "rgb"])), Some([51, 102, 255]));
    // Linear light of 0.5 is 188; a colour of corners multiplies it, also to 188.
    let (structure, mut buffer) = gltf(&quad(3), &[], Some("none.png"));
    let texture = r#""baseColorTexture":{"index":0}"#;
    let factor = structure.replace(texture, r#""baseColorFactor":[0.5,1,0,1]"#);
    write_glb(&at.join("a.glb"), &factor, &buffer);
    assert_eq!(only_colour(&convert(at, &["a.glb"], "a.slices", &["--colour", "rgb"])), Some([188, 255, 0]));
    let start = buffer.len();
    (0..54).for_each(|_| buffer.extend([255, 128, 255, 0]));
    let corners = factor
        .replace(r#""TEXCOORD_0":1"#, r#""COLOR_0":2"#)
        .replace(
            r#""type":"VEC2"}"#,
            r#""type":"VEC2"},{"bufferView":3,"componentType":5121,"normalized":true,"count":54,"type":"VEC4"}"#,
        )
        .replace(r#"}],"buffers""#, &format!(r#"}},{{"buffer":0,"byteOffset":{start},"byteLength":216}}],"buffers""#))
        .replace(&format!(r#""byteLength":{start}}}]}}"#), &format!(r#""byteLength":{}}}]}}"#, buffer.len()));
    write_glb(&at.join("a.glb"), &corners, &buffer);
    assert_eq!(only_colour(&convert(at, &["a.glb"], "a.slices", &["--colour", "rgb"])), Some([188, 188, 0]));
    // Corners with colours after their coordinates, and a face with one such corner.
    fs::write(at.join("a.obj"), "v 0 0 0 1 0.5 0\nv 4 0 0 1 0.5 0\nv 0 4 0 1 0.5 0\nf 1 2 3\n").unwrap();
    assert_eq!(only_colour(&convert(at, &["a.obj"], "a.slices", &["--colour", "rgb"])), Some([255, 128, 0]));
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
                  property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    fs::write(at.join("a.ply"), format!("{header}0 0 0\n4 0 0\n0 4 0\n3 0 1 2 7 8 9\n")).unwrap();
    assert_eq!(only_colour(&convert(at, &["a.ply"], "a.slices", &["--colour", "rgb"])), Some([7, 8, 9]));
    // Beside triangles with a colour, others have none.
    let apart = "v 0 0 0 1 0.5 0\nv 4 0 0 1 0.5 0\nv 0 4 0 1 0.5 0\nv 50 0 0\nv 54 0 0\nv 50 4 0\nf 1 2 3\nf 4 5 6\n";
    fs::write(at.join("a.obj"), apart).unwrap();
    for ([x, ..], colour) in colours(&convert(at, &["a.obj"], "a.slices", &["--colour", "rgb"])) {
        assert_eq!(colour, (x < 250).then_some([255, 128, 0]), "{x}");
    }
    // Without any colours there is no section, or a refusal.
    fs::write(at.join("a.obj"), "v 0 0 0\nv 4 0 0\nv 0 4 0\nf 1 2 3\n").unwrap();
    let said = converts(at, &arguments("a.obj", &["--colour", "auto"]));
    assert!(said.contains("the archive has no colours"), "{said}");
    assert!(Archive::open(at.join("a.slices")).unwrap().header().colours.is_none());
    for (colour, word) in [("rgb", "no triangle has a colour"), ("intensity", "meshes have RGB alone")] {
        let said = refuses(at, &arguments("a.obj", &["--colour", colour]), 2);
        assert!(said.contains(word), "{said}");
    }
    // The texture that would have been one may be missing.
    fs::write(at.join("b.mtl"), "newmtl first\nnewmtl wood\nmap_Kd wall.png\n").unwrap();
    write_obj(&at.join("b.obj"), &quad(1), "b.mtl");
    let said = refuses(at, &arguments("b.obj", &["--colour", "rgb"]), 2);
    assert!(said.contains("no triangle has a colour") && said.matches("wall.png: ").count() == 1, "{said}");
}

#[test]
fn textures_that_cannot_be_used_are_warnings_and_the_material_colours_in_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let outer = folder.path();
    let at = &outer.join("inner");
    fs::create_dir(at).unwrap();
    write_texture(&outer.join("secret.png"));
    let sound = fs::read(outer.join("secret.png")).unwrap();
    let huge = {
        // A head that states more texels than allowed, with a valid checksum.
        let mut bytes = png(2, 2, &[9; 12]);
        bytes[16..24].copy_from_slice(&[0, 0, 0xEA, 0x60, 0, 0, 0xEA, 0x60]);
        let sum = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&sum.to_be_bytes());
        bytes
    };
    fs::write(at.join("cut.png"), &sound[..sound.len() / 2]).unwrap();
    fs::write(at.join("huge.png"), huge).unwrap();
    fs::write(at.join("text.png"), "no image").unwrap();
    fs::write(at.join("empty.png"), "").unwrap();
    let jpeg = include_bytes!("../../../../tests/mesh/progressive.jpg");
    fs::write(at.join("cut.jpg"), &jpeg[..jpeg.len() / 2]).unwrap();
    fs::create_dir(at.join("folder.png")).unwrap();
    for (name, word) in [
        ("none.png", "cannot read"),
        ("../secret.png", "leads out of the folder"),
        ("/etc/passwd", "leads out of the folder"),
        ("C:\\secret.png", "leads out of the folder"),
        ("..\\secret.png", "leads out of the folder"),
        ("cut.png", "damaged"),
        ("huge.png", "texels"),
        ("text.png", "neither PNG nor JPEG"),
        ("empty.png", "neither PNG nor JPEG"),
        ("cut.jpg", "damaged"),
        ("folder.png", "cannot read"),
    ] {
        fs::write(at.join("a.mtl"), format!("newmtl wood\nKd 0 1 0\nmap_Kd {name}\n")).unwrap();
        write_obj(&at.join("a.obj"), &quad(2), "a.mtl");
        let said = converts(at, &arguments("a.obj", &["--colour", "rgb"]));
        assert_eq!(said.matches("texture ").count(), 1, "{name}: {said}");
        assert!(said.contains(word), "{name}: {said}");
        assert_eq!(only_colour(&Archive::open(at.join("a.slices")).unwrap()), Some([0, 255, 0]), "{name}");
        let name = name.replace('\\', "/");
        let (structure, buffer) = gltf(&quad(2), &[], Some(&name));
        write_glb(&at.join("a.glb"), &structure, &buffer);
        converts(at, &arguments("a.glb", &["--colour", "rgb"]));
        assert_eq!(only_colour(&Archive::open(at.join("a.slices")).unwrap()), Some([255; 3]), "{name}");
    }
    // Materials that are missing, or have other names.
    for (text, word) in [("", "no material is called"), ("newmtl other\nKd 1 1 1\n", "no material is called")] {
        fs::write(at.join("a.mtl"), text).unwrap();
        write_obj(&at.join("a.obj"), &quad(2), "../a.mtl a.mtl");
        let said = converts(at, &arguments("a.obj", &["--colour", "auto"]));
        assert!(said.contains(word) && said.contains("the archive has no colours"), "{said}");
    }
    // A part names a material that does not exist.
    let (structure, buffer) = gltf(&quad(2), &sound, None);
    write_glb(&at.join("a.glb"), &structure.replace(r#""material":0"#, r#""material":7"#), &buffer);
    let said = converts(at, &arguments("a.glb", &["--colour", "auto"]));
    assert!(said.contains("the archive has no colours"), "{said}");
}

#[test]
fn a_texture_that_does_not_fit_the_memory_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.png"), png(3000, 2200, &vec![200; 3 * 3000 * 2200])).unwrap();
    fs::write(at.join("a.mtl"), "newmtl wood\nmap_Kd a.png\n").unwrap();
    write_obj(&at.join("a.obj"), &quad(2), "a.mtl");
    let with_memory = |memory| arguments("a.obj", &["--colour", "rgb", "--memory", memory]);
    let said = refuses(at, &with_memory("64MiB"), 1);
    assert!(said.contains("--memory") && said.contains("a.png"), "{said}");
    assert!(!at.join("a.slices").exists());
    converts(at, &with_memory("256MiB"));
    assert_eq!(only_colour(&Archive::open(at.join("a.slices")).unwrap()), Some([200; 3]));
}

/// CRC-32 of a PNG chunk, by definition.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| if sum & 1 == 1 { sum >> 1 ^ 0xEDB8_8320 } else { sum >> 1 })
    })
}
