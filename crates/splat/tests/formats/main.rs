//! Splats of every format, written here and read back; then cut at every byte, and changed at random.

mod odd;
mod write;

use slicewalk_base::bytes::testing::{Strike, StruckSource};
use slicewalk_base::bytes::{MemorySource, testing};
use slicewalk_base::{Error, NoMonitor, Result};
use slicewalk_splat::{HEAD_BYTES, Splat, SplatFormat, SplatOptions, SplatReader, SplatSummary, format_of, recognise};
use std::path::Path;
use std::sync::Arc;
use write::{Kind, Random, gzip, with};

/// Name and bytes of a file, and how far its numbers are from those that were written.
struct Case {
    name: &'static str,
    format: SplatFormat,
    bytes: Vec<u8>,
    /// Error of centres (units), relative error of sizes, error of quaternions, opacities (0 to 1) and colours (steps).
    error: [f64; 5],
    /// Shift of a node.
    shift: [f64; 3],
}

fn cases(splats: &[Splat]) -> Vec<Case> {
    use SplatFormat::{CompressedPly, Gltf, Ksplat, Ply, Sog, Spz};
    let exact = [1e-5, 1e-5, 1e-5, 1e-5, 0.0];
    let halves = [0.02, 0.005, 0.002, 0.003, 1.0];
    let packed = [0.011, 0.01, 0.002, 0.002, 1.0];
    // w follows from x, y and z: near 0 it is the root of their errors.
    let spz_old = [2e-4, 0.033, 0.12, 0.002, 2.0];
    let spz_first = [0.01, 0.033, 0.12, 0.002, 2.0];
    let spz_new = [2e-4, 0.033, 0.002, 0.002, 2.0];
    let sog = [6e-4, 0.013, 0.02, 0.01, 2.0];
    let (text, little, big) = (Kind::Text, Kind::Little, Kind::Big);
    let case = |name, format, bytes, error| Case { name, format, bytes, error, shift: [0.0; 3] };
    let mut all = vec![
        case("text.ply", Ply, write::ply(splats, text, "float", 9), exact),
        case("little.ply", Ply, write::ply(splats, little, "float", 45), exact),
        case("big.ply", Ply, write::ply(splats, big, "float", 0), exact),
        case("half.ply", Ply, write::ply(splats, little, "half", 9), halves),
        case("half-big.ply", Ply, write::ply(splats, big, "half", 0), halves),
        case("double.ply", Ply, write::ply(splats, big, "double", 0), exact),
        case("a.compressed.ply", CompressedPly, write::packed_ply(splats, true, 0), packed),
        case("b.compressed.ply", CompressedPly, write::packed_ply(splats, false, 24), packed),
        case("v1.spz", Spz, write::spz(splats, 1, 0, true), spz_first),
        case("v2.spz", Spz, write::spz(splats, 2, 3, true), spz_old),
        case("v3.spz", Spz, write::spz(splats, 3, 1, true), spz_new),
        case("raw-v1.spz", Spz, write::spz(splats, 1, 0, false), spz_first),
        case("raw-v3.spz", Spz, write::spz(splats, 3, 2, false), spz_new),
        case("v4.spz", Spz, write::spz(splats, 4, 4, true), spz_new),
        case("v4-plain.spz", Spz, write::spz(splats, 4, 0, true), spz_new),
        case("v1.sog", Sog, write::zip(&write::sog(splats, 1), false), sog),
        case("v2.sog", Sog, write::zip(&write::sog(splats, 2), true), sog),
        case("a.splat", SplatFormat::Splat, write::splat(splats), [1e-5, 1e-5, 0.01, 0.002, 0.0]),
        case("0.ksplat", Ksplat, write::ksplat(splats, 0, 1), [1e-5, 1e-5, 1e-5, 0.002, 0.0]),
        case("1.ksplat", Ksplat, write::ksplat(splats, 1, 2), [4e-4, 0.002, 0.002, 0.002, 0.0]),
        case("2.ksplat", Ksplat, write::ksplat(splats, 2, 1), [4e-4, 0.002, 0.002, 0.002, 0.0]),
        case("v2-spz.glb", Gltf, write::gltf_spz(splats, 2), spz_old),
        case("v4-spz.glb", Gltf, write::gltf_spz(splats, 4), spz_new),
    ];
    let bytes = write::gltf(splats);
    all.push(Case { name: "a.glb", format: Gltf, bytes, error: exact, shift: [1.0, 2.0, 3.0] });
    all
}

fn read(bytes: &[u8], name: &str, allow_incomplete: bool) -> Result<(u64, Vec<Splat>, SplatSummary)> {
    let options = SplatOptions { allow_incomplete, ..SplatOptions::default() };
    let source = Arc::new(MemorySource::new(bytes));
    collect(&mut SplatReader::of_source(source, name, &options)?)
}

fn collect(reader: &mut SplatReader) -> Result<(u64, Vec<Splat>, SplatSummary)> {
    let mut all = Vec::new();
    let summary = reader.for_each_batch(&NoMonitor, &mut |batch| {
        all.extend_from_slice(batch);
        Ok(())
    })?;
    Ok((reader.count(), all, summary))
}

fn compare(name: &str, expected: &[Splat], found: &[Splat], error: [f64; 5], shift: [f64; 3]) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (a, b) in expected.iter().zip(found) {
        let near = |most: f64, error: f64| assert!(error <= most + 1e-6, "{name}: {error}: {a:?} {b:?}");
        for (axis, step) in shift.iter().enumerate() {
            near(error[0], (a.mean[axis] + step - b.mean[axis]).abs());
            near(error[1], f64::from((a.scale[axis] / b.scale[axis] - 1.0).abs()));
            near(error[4], (f64::from(a.colour[axis]) - f64::from(b.colour[axis])).abs());
        }
        // A quaternion and its negative are the same rotation.
        let dot: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
        let apart: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| (a - b * dot.signum()).powi(2)).sum();
        near(error[2], f64::from(apart.sqrt()));
        near(error[3], f64::from((a.opacity - b.opacity).abs()));
    }
}

#[test]
fn every_format_reads_back_what_was_written() {
    for (count, seed) in [(1, 1), (7, 2), (300, 3), (20_000, 4)] {
        let splats = write::random_splats(count, seed);
        for case in cases(&splats) {
            let head = &case.bytes[..case.bytes.len().min(HEAD_BYTES)];
            assert_eq!(recognise(head, Path::new(case.name)), Some(case.format), "{}", case.name);
            let (stated, found, summary) = read(&case.bytes, case.name, false).unwrap();
            assert_eq!((stated, summary.splats, summary.lost()), (count as u64, count as u64, 0), "{}", case.name);
            compare(case.name, &splats, &found, case.error, case.shift);
        }
    }
}

#[test]
fn a_second_pass_reads_the_same() {
    for case in cases(&write::random_splats(300, 5)) {
        let source = Arc::new(MemorySource::new(&case.bytes[..]));
        let mut reader = SplatReader::of_source(source, case.name, &SplatOptions::default()).unwrap();
        let [first, second] = [0, 1].map(|_| collect(&mut reader).unwrap());
        assert!(first == second, "{}", case.name);
    }
}

/// With the least memory the columns lie in a temporary file: without a folder for it, reading fails.
#[test]
fn little_memory_gives_the_same_splats() {
    let splats = write::random_splats(450_000, 11);
    let somewhere = SplatOptions::default();
    let nowhere = SplatOptions { temp_dir: "no/such/folder".into(), ..SplatOptions::default() };
    let files = [("a.spz", write::spz(&splats, 3, 1, true)), ("a.sog", write::zip(&write::sog(&splats, 2), true))];
    for (name, bytes) in files {
        let pass = |memory_bytes: u64, options: &SplatOptions| {
            let options = SplatOptions { memory_bytes, ..options.clone() };
            let mut reader = SplatReader::of_source(Arc::new(MemorySource::new(&bytes[..])), name, &options)?;
            let mut all = Vec::with_capacity(splats.len());
            reader.for_each_batch(&NoMonitor, &mut |batch| {
                all.extend_from_slice(batch);
                Ok(())
            })?;
            Ok::<_, Error>(all)
        };
        let [large, small] = [1 << 30, 1].map(|memory| pass(memory, &somewhere).unwrap());
        assert!(large == small && large.len() == splats.len(), "{name}");
        assert!(pass(1 << 30, &nowhere).unwrap() == large, "{name}");
        let error = pass(1, &nowhere).unwrap_err().to_string();
        assert!(error.contains("choose a folder with space"), "{name}: {error}");
    }
}

#[test]
fn folders_of_sog_and_their_levels_are_read() {
    let splats = write::random_splats(50, 6);
    for (folder, version, part) in [("fine_0", 1, 0..20), ("fine_1", 2, 20..50), ("coarse", 2, 0..10)] {
        for (name, bytes) in write::sog(&splats[part], version) {
            testing::hold(format!("scene/{folder}/{name}"), bytes);
        }
    }
    let options = SplatOptions::default();
    let mut reader = SplatReader::open("scene/fine_1/meta.json", &options).unwrap();
    assert_eq!(reader.format(), SplatFormat::SogFolder);
    let error = [6e-4, 0.013, 0.02, 0.01, 2.0];
    compare("folder", &splats[20..], &collect(&mut reader).unwrap().1, error, [0.0; 3]);
    let set = r#"{"version":1,"lodLevels":2,"counts":[43,12],"environment":"sky/meta.json",
        "filenames":["fine_0/meta.json","fine_1/meta.json","coarse/meta.json"],
        "tree":{"bound":{},"children":[
            {"lods":{"0":{"file":1,"offset":5,"count":25},"1":{"file":2,"offset":0,"count":10}}},
            {"lods":{"0":{"file":0,"offset":0,"count":18}}},
            {"lods":{"0":{"file":0,"offset":0,"count":0},"1":{"file":0,"offset":18,"count":2}}}]}}"#;
    testing::hold("scene/lod-meta.json", set.as_bytes());
    let mut reader = SplatReader::open("scene/lod-meta.json", &options).unwrap();
    assert_eq!((reader.format(), reader.count()), (SplatFormat::SogLevels, 45));
    let expected = [&splats[..20], &splats[25..]].concat();
    compare("levels", &expected, &collect(&mut reader).unwrap().1, error, [0.0; 3]);
    let wrong = set.replace("\"count\":25", "\"count\":26").replace("[43,12]", "[44,12]");
    testing::hold("scene/lod-meta.json", wrong.as_bytes());
    let reader = SplatReader::open("scene/lod-meta.json", &options);
    assert!(reader.and_then(|mut reader| collect(&mut reader)).unwrap_err().to_string().contains("at least 31 splats"));
}

/// A node that turns, stretches and mirrors makes another ellipsoid: its covariance is that of the moved one.
#[test]
fn nodes_move_ellipsoids_exactly() {
    let splats = write::random_splats(200, 7);
    let plain = write::gltf(&splats);
    // Columns of each map. A quarter turn about z comes after the scale; the last map flattens everything to a line.
    for (node, m) in [
        ("\"matrix\":[2,0.5,0,0,0,-1,0.25,0,0,0,0.1,0,5,6,7,1]", [[2.0, 0.5, 0.0], [0.0, -1.0, 0.25], [0.0, 0.0, 0.1]]),
        (
            "\"translation\":[5,6,7],\"rotation\":[0,0,0.7071067811865476,0.7071067811865476],\"scale\":[2,3,0.5]",
            [[0.0, 2.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 0.5]],
        ),
        ("\"translation\":[5,6,7],\"scale\":[2,0,0]", [[2.0, 0.0, 0.0], [0.0; 3], [0.0; 3]]),
    ] {
        let bytes = write::glb_with(&plain, "\"translation\":[1,2,3]", node);
        moves_exactly(&splats, &read(&bytes, "moved.glb", false).unwrap().1, m);
    }
}

/// Checks that `found` are `splats` under the map with columns `m`, and then moved by (5, 6, 7).
fn moves_exactly(splats: &[Splat], found: &[Splat], m: [[f64; 3]; 3]) {
    assert_eq!(splats.len(), found.len());
    for (a, b) in splats.iter().zip(found) {
        let mean = [0, 1, 2].map(|r| (0..3).map(|c| m[c][r] * a.mean[c]).sum::<f64>() + [5.0, 6.0, 7.0][r]);
        assert!((0..3).all(|axis| (mean[axis] - b.mean[axis]).abs() < 1e-5), "{a:?} {b:?}");
        let (before, after) = (covariance(a), covariance(b));
        for r in 0..3 {
            for c in 0..3 {
                let moved: f64 = (0..9).map(|n| m[n / 3][r] * before[n / 3][n % 3] * m[n % 3][c]).sum();
                assert!((moved - after[r][c]).abs() < 1e-5, "{moved} {} {a:?} {b:?}", after[r][c]);
            }
        }
    }
}

fn covariance(splat: &Splat) -> [[f64; 3]; 3] {
    let [w, x, y, z] = splat.rotation.map(f64::from);
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let s = splat.scale.map(|v| f64::from(v).powi(2));
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| r[i][k] * s[k] * r[j][k]).sum()))
}

#[test]
fn unusable_splats_are_counted_or_refused() {
    let good = write::random_splats(6, 8);
    let mut bytes = write::splat(&good);
    bytes[0..4].copy_from_slice(&f32::NAN.to_le_bytes());
    bytes[32 + 12..32 + 16].copy_from_slice(&(-0.5f32).to_le_bytes());
    bytes[64 + 28..64 + 32].copy_from_slice(&[128; 4]);
    bytes[96 + 16..96 + 20].copy_from_slice(&f32::INFINITY.to_le_bytes());
    bytes.truncate(6 * 32 - 5);
    let error = read(&bytes, "a.splat", false).unwrap_err().to_string();
    assert!(error.contains("rows of 32 bytes, found 187 bytes"), "{error}");
    let error = read(&bytes[..5 * 32], "a.splat", false).unwrap_err().to_string();
    assert!(error.contains("splat 0: 1 splat with a number that is not finite"), "{error}");
    let (stated, found, summary) = read(&bytes, "a.splat", true).unwrap();
    let counts = [summary.not_finite, summary.negative, summary.no_rotation, summary.missing, summary.splats];
    assert_eq!((stated, found.len(), counts), (6, 1, [2, 1, 1, 1, 1]));
    // Also one without a colour.
    let mut ply = write::ply(&good, Kind::Little, "float", 0);
    let colours = ply.len() - good.len() * 17 * 4 + 6 * 4;
    ply[colours..colours + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(read(&ply, "a.ply", true).unwrap().2.not_finite, 1);
    let mut glb = write::gltf(&good);
    let opacities = glb.len() - good.len() * 16;
    glb[opacities..opacities + 4].copy_from_slice(&1.5f32.to_le_bytes());
    assert_eq!(read(&glb, "a.glb", true).unwrap().2.opacity, 1);
    // A node that turns splats does not hide what is wrong with them.
    let rotations = glb.len() - good.len() * (16 + 12 + 16);
    glb[rotations + 16..rotations + 32].fill(0);
    glb[rotations + 36..rotations + 40].copy_from_slice(&f32::NAN.to_le_bytes());
    let turned = write::glb_with(&glb, "\"translation\":[1,2,3]", "\"rotation\":[0,1,0,0]");
    let (_, found, summary) = read(&turned, "a.glb", true).unwrap();
    assert_eq!((found.len(), summary.lost()), (3, 3));
    assert_eq!([summary.opacity, summary.no_rotation, summary.not_finite], [1; 3]);
}

/// A count, a length and an end that a file states must agree.
#[test]
fn files_that_hold_more_than_they_state_are_refused() {
    let splats = write::random_splats(300, 12);
    let counting = |mut bytes: Vec<u8>, count: u32| {
        bytes[8..12].copy_from_slice(&count.to_le_bytes());
        bytes
    };
    let fewer = |bytes: &[u8]| with(bytes, "element vertex 300", "element vertex 299");
    let text = write::ply(&splats, Kind::Text, "float", 9);
    let little = write::ply(&splats, Kind::Little, "float", 0);
    let packed = write::packed_ply(&splats, true, 0);
    let [bare, spz] = [false, true].map(|packed| write::spz(&splats, 3, 1, packed));
    let ksplat = write::ksplat(&splats, 0, 0);
    let v4 = write::spz(&splats, 4, 0, true);
    let glb = write::gltf(&splats);
    let more = |bytes: &[u8], extra: &[u8]| [bytes, extra].concat();
    let mut shorter = counting(v4.clone(), 299);
    for (entry, width) in [9u64, 1, 3, 3, 4].into_iter().enumerate() {
        shorter[40 + 16 * entry..48 + 16 * entry].copy_from_slice(&(299 * width).to_le_bytes());
    }
    let mut sog = write::sog(&splats, 2);
    sog[0].1 = with(&sog[0].1, "\"count\":300", "\"count\":299");
    let cases = [
        ("a.ply", fewer(&text), "expected 299 rows of all elements, found 300", 299),
        ("b.ply", fewer(&little), "for all elements, found", 299),
        ("c.ply", more(&little, &[1; 7]), "for all elements, found", 300),
        ("d.compressed.ply", fewer(&packed), "for all elements, found", 299),
        ("e.compressed.ply", more(&packed, &[7; 16]), "for all elements, found", 300),
        ("f.ksplat", more(&ksplat, &[b'x'; 44]), "for all sections, found", 300),
        ("g.spz", counting(bare.clone(), 299), "bytes, found", 299),
        ("h.spz", gzip(&counting(bare.clone(), 299)), "29 bytes follow the last column", 299),
        ("i.spz", gzip(&counting(bare.clone(), 0)), "8,700 bytes follow the last column", 0),
        ("j.spz", more(&spz, b"abc"), "other data follow the gzip stream", 300),
        ("k.spz", more(&spz, &gzip(b"abc")), "other data follow the gzip stream", 300),
        ("l.spz", more(&v4, b"abc"), "bytes, found", 300),
        ("m.spz", shorter, "a stream holds more bytes than it states", 299),
        ("n.sog", write::zip(&sog, true), "q.webp: expected 299 splats, found more", 299),
        ("o.glb", more(&glb, b"more"), "bytes, and the file has", 300),
    ];
    for (name, bytes, words, left) in cases {
        let error = read(&bytes, name, false).map(drop).unwrap_err();
        assert!(error.to_string().contains(words) && is_one_line(&error), "{name}: {error}");
        let (_, found, summary) = read(&bytes, name, true).unwrap();
        assert_eq!((found.len(), summary.lost(), summary.is_complete()), (left, 0, false), "{name}");
    }
    // Padding, and extensions of SPZ.
    let mut extended = counting(more(&bare, &[5; 40]), 300);
    extended[14] = 2;
    let blank = more(&text, b"\n \r\n");
    for (name, bytes) in [("a.ply", blank), ("b.ply", more(&little, &[0; 9])), ("c.spz", gzip(&extended))]
        .into_iter()
        .chain([("d.spz", more(&spz, &[0; 3])), ("e.ksplat", more(&ksplat, &[0; 512])), ("f.spz", extended.clone())])
        .chain([("g.spz", more(&bare, &[0; 3])), ("h.glb", more(&glb, b"\0\0 \n"))])
    {
        let (_, found, summary) = read(&bytes, name, false).unwrap();
        assert_eq!((found.len(), summary.is_complete()), (300, true), "{name}");
    }
}

/// Files that could be read in two ways are refused, and so are splats that no scene shows.
#[test]
fn ambiguous_files_are_refused() {
    let splats = write::random_splats(30, 13);
    let files = write::sog(&splats, 2);
    let twice = |name: &str| {
        let again = files.iter().filter(|file| file.0 == name).cloned();
        write::zip(&files.iter().cloned().chain(again).collect::<Vec<_>>(), false)
    };
    let folders: Vec<_> = ["a/", "b/"]
        .iter()
        .flat_map(|at| files.iter().map(move |file| (format!("{at}{}", file.0), file.1.clone())))
        .collect();
    let text = String::from_utf8(write::ply(&splats, Kind::Text, "float", 9)).unwrap();
    let glb = write::gltf(&splats);
    let mesh = glb.windows(8).position(|bytes| bytes == b"\"mesh\":0").unwrap();
    let hidden = [&glb[..mesh], b"\"mash\":0", &glb[mesh + 8..]].concat();
    let edited = |from: &str, to: &str| {
        let json_len = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
        let json = std::str::from_utf8(&glb[20..20 + json_len]).unwrap().replace(from, to);
        write::glb(&json, glb[28 + json_len..].to_vec())
    };
    let instances = "\"mesh\":0,\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":0}}},";
    let triangles = "\"primitives\":[{\"attributes\":{\"POSITION\":0}},";
    let has_more = edited("\"primitives\":[", triangles);
    assert_eq!(read(&has_more, "a.glb", true).unwrap().1.len(), 30);
    let required =
        |name: &str| edited("\"extensionsUsed\"", &format!("\"extensionsRequired\":[\"{name}\"],\"extensionsUsed\""));
    assert_eq!(read(&required("KHR_materials_unlit"), "a.glb", false).unwrap().1.len(), 30);
    for (name, bytes, words) in [
        ("a.sog", twice("l.webp"), "expected one entry \"l.webp\", found 2"),
        ("b.sog", twice("meta.json"), "expected one meta.json, found 2"),
        ("c.sog", write::zip(&folders, false), "expected one meta.json, found 2; unpack it"),
        ("d.ply", text.replace("f_rest_3", "opacity").into(), "has the property \"opacity\" more than once"),
        ("i.ply", text.replace("f_rest_3", "Opacity").into(), "has the property \"opacity\" more than once"),
        ("f.glb", edited("\"mesh\":0,", instances), "node 0: EXT_mesh_gpu_instancing of splats is not read"),
        ("g.glb", has_more, "mesh 0: it has triangles, lines or points that are not splats"),
        ("h.glb", required("ABC_moves"), "it needs \"ABC_moves\", which is not read"),
        ("e.glb", hidden, "no node of the scene has a mesh of splats, of which there are 30"),
    ] {
        let error = read(&bytes, name, false).map(drop).unwrap_err();
        assert!(error.to_string().contains(words) && is_one_line(&error), "{name}: {error}");
    }
}

/// The extension has sizes as they are; its late drafts had their logarithms.
#[test]
fn sizes_of_gltf_are_those_of_the_extension_or_its_drafts() {
    let splats = write::random_splats(40, 14);
    let mut glb = write::gltf(&splats);
    assert!(splats.iter().any(|splat| splat.scale.iter().any(|size| *size < 1.0)));
    let sizes = |glb: &[u8]| -> Vec<[f32; 3]> {
        read(glb, "a.glb", false).unwrap().1.iter().map(|splat| splat.scale).collect()
    };
    let of_draft = sizes(&glb);
    let json_len = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    // Behind the centres and the quaternions.
    let at = 28 + json_len + splats.len() * (12 + 16);
    for (place, size) in glb[at..].chunks_exact_mut(4).zip(splats.iter().flat_map(|splat| splat.scale)) {
        place.copy_from_slice(&size.to_le_bytes());
    }
    let linear = sizes(&glb);
    for ((a, b), splat) in linear.iter().zip(&of_draft).zip(&splats) {
        assert_eq!(*a, splat.scale);
        assert!(a.iter().zip(b).all(|(a, b)| (a / b - 1.0).abs() < 1e-5), "{a:?} {b:?}");
    }
}

/// Meshes that are quantized have centres in whole numbers.
#[test]
fn whole_numbers_are_shares_only_where_the_file_says_so() {
    let floats = [0.0f32, 0.0, 0.0, 1.0, -1.0, -1.0, -1.0].map(f32::to_le_bytes);
    let name = "KHR_gaussian_splatting";
    let shorts: &[u8; 12] = &[1, 0, 2, 0, 3, 1, 0, 0, 0, 0, 0, 0];
    let words: &[u8; 12] = &[1, 0, 0, 0, 2, 0, 0, 0, 3, 1, 0, 0];
    for (kind, centre, normalized, expected) in [
        (5123, shorts, false, [1.0, 2.0, 259.0]),
        (5123, shorts, true, [1.0, 2.0, 259.0].map(|v| v / 65_535.0)),
        (5122, &[0xFE, 0xFF, 2, 0, 0, 0x80, 0, 0, 0, 0, 0, 0], false, [-2.0, 2.0, -32_768.0]),
        // −32,768 is −1, too.
        (5122, &[0x01, 0x80, 0xFF, 0x7F, 0, 0x80, 0, 0, 0, 0, 0, 0], true, [-1.0, 1.0, -1.0]),
        (5125, words, false, [1.0, 2.0, 259.0]),
    ] {
        let binary = [&centre[..], floats.as_flattened()].concat();
        let json = format!(
            "{{\"extensionsUsed\":[\"{name}\"],\"buffers\":[{{\"byteLength\":40}}],\"bufferViews\":[\
             {{\"buffer\":0,\"byteLength\":12}},{{\"buffer\":0,\"byteOffset\":12,\"byteLength\":16}},\
             {{\"buffer\":0,\"byteOffset\":28,\"byteLength\":12}}],\"accessors\":[\
             {{\"bufferView\":0,\"componentType\":{kind},\"normalized\":{normalized},\"count\":1,\"type\":\"VEC3\"}},\
             {{\"bufferView\":1,\"componentType\":5126,\"count\":1,\"type\":\"VEC4\"}},\
             {{\"bufferView\":2,\"componentType\":5126,\"count\":1,\"type\":\"VEC3\"}}],\"nodes\":[{{\"mesh\":0}}],\
             \"meshes\":[{{\"primitives\":[{{\"mode\":0,\"attributes\":{{\"POSITION\":0,\"{name}:ROTATION\":1,\
             \"{name}:SCALE\":2}},\"extensions\":{{\"{name}\":{{}}}}}}]}}]}}"
        );
        let (_, found, _) = read(&write::glb(&json, binary), "a.glb", false).unwrap();
        let near = |(value, expected): (&f64, f64)| (value - expected).abs() < 1e-9;
        assert!(found[0].mean.iter().zip(expected).all(near), "{kind}, {normalized}: {found:?}");
    }
}

#[test]
fn names_decide_where_the_content_does_not() {
    let sog = b"PK\x03\x04 and then means_l.webp";
    let cases: [(&[u8], &str, Option<SplatFormat>); 17] = [
        (sog, "a.zip", Some(SplatFormat::Sog)),
        (sog, "a.sog", Some(SplatFormat::Sog)),
        (sog, "a.docx", None),
        (b"PK\x03\x04 and then word.xml", "a.zip", None),
        (b"PK\x03\x04 and then word.xml", "a.sog", Some(SplatFormat::Sog)),
        (b"{\"means\":{", "a/meta.json", Some(SplatFormat::SogFolder)),
        (b"{\"means\":{", "a/other.json", None),
        (b"{\"other\":{", "a/meta.json", None),
        (b"{\"other\":{", "a/lod-meta.json", Some(SplatFormat::SogLevels)),
        (b"{\"means\":{},\"quats\":{}", "a/other.json", Some(SplatFormat::SogFolder)),
        (b"{\"lodLevels\":3", "a/other.json", Some(SplatFormat::SogLevels)),
        (b"\x1F\x8B", "a.spz", Some(SplatFormat::Spz)),
        (b"\x1F\x8B", "a.gz", None),
        (b"anything", "a.KSPLAT", Some(SplatFormat::Ksplat)),
        (b"anything", "a.spz", Some(SplatFormat::Spz)),
        (b"anything", "a.sog", Some(SplatFormat::Sog)),
        (b"anything", "a.bin", None),
    ];
    for (head, name, format) in cases {
        assert_eq!(recognise(head, Path::new(name)), format, "{name}: {}", head.escape_ascii());
    }
}

/// Programs that sort keys write the buffers of a glTF, which may be text, in front of its extensions.
#[test]
fn splats_of_a_gltf_are_found_behind_buffers_in_its_text() {
    use base64::Engine;
    let glb = write::gltf(&write::random_splats(1500, 40));
    let len = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let json = std::str::from_utf8(&glb[20..20 + len]).unwrap().trim_end();
    let data = base64::engine::general_purpose::STANDARD.encode(&glb[28 + len..]);
    let (before, rest) = json.split_once("\"buffers\":[{").unwrap();
    let (own, behind) = rest.split_once("}],").unwrap();
    let text = format!("{{\"buffers\":[{{\"uri\":\"data:;base64,{data}\",{own}}}],{}{behind}", &before[1..]);
    assert!(text.find("KHR_").unwrap() > HEAD_BYTES);
    let expected = read(&glb, "a.glb", false).unwrap().1;
    assert!(read(text.as_bytes(), "late.gltf", false).unwrap().1 == expected);
    let long = write::glb(&text, glb[28 + len..].to_vec());
    assert!(read(&long, "late.glb", false).unwrap().1 == expected);
    let format = |bytes: &[u8]| format_of(&MemorySource::new(bytes), Path::new("late.gltf")).unwrap();
    assert_eq!(format(text.replace("KHR_gaussian_splatting", "KHR_other").as_bytes()), None);
    // A file may list the extension, or have its name elsewhere, and hold triangles.
    let name = "KHR_gaussian_splatting";
    let listed = format!("{{\"extensionsUsed\":[\"{name}\"],\"meshes\":[{{\"name\":\"{name}:\"}}]");
    assert_eq!(format(listed.as_bytes()), None);
    assert_eq!(format(format!("{listed},\"a\":{{\"{name}\" : 1").as_bytes()), Some(SplatFormat::Gltf));
    // Across the ends of the pieces that are searched.
    for end in [HEAD_BYTES, HEAD_BYTES + (1 << 20)] {
        for before in [0, 1, 21, 22, 24, 25, 40] {
            let mut bytes = vec![b' '; end - before];
            bytes[0] = b'{';
            bytes.extend(b"KHR_gaussian_splatting\" :");
            assert_eq!(format(&bytes), Some(SplatFormat::Gltf), "{before} bytes before {end}");
        }
    }
}

/// Damage can be allowed. A read that fails is not damage: the next one may succeed.
#[test]
fn a_failed_read_is_refused_whatever_is_allowed() {
    for case in cases(&write::random_splats(300, 15)) {
        for allow_incomplete in [false, true] {
            let options = SplatOptions { allow_incomplete, ..SplatOptions::default() };
            for number in 0.. {
                let strike = Strike::at(number);
                let source = Arc::new(StruckSource::new(MemorySource::new(&case.bytes[..]), &strike));
                let done = SplatReader::of_source(source, case.name, &options).and_then(|mut r| collect(&mut r));
                if !strike.fell() {
                    assert_eq!(done.unwrap().1.len(), 300, "{}", case.name);
                    break;
                }
                let error = done.map(|(_, found, _)| found.len()).unwrap_err().to_string();
                assert!(error.contains(Strike::REASON), "{} read {number}: {error}", case.name);
            }
        }
    }
}

fn is_sound(splat: &Splat) -> bool {
    let length: f32 = splat.rotation.iter().map(|v| v * v).sum();
    splat.mean.iter().all(|v| v.abs() <= 1e12)
        && splat.scale.iter().all(|v| v.is_finite() && *v >= 0.0)
        && (length - 1.0).abs() < 1e-5
        && (0.0..=1.0).contains(&splat.opacity)
}

fn is_one_line(error: &Error) -> bool {
    let text = error.to_string();
    !text.is_empty() && !text.contains('\n') && text.len() < 1000
}

#[test]
fn files_cut_anywhere_are_refused_or_read_as_far_as_they_go() {
    let splats = write::random_splats(6, 9);
    for case in cases(&splats) {
        let whole = read(&case.bytes, case.name, false).unwrap().1;
        // The headers of ksplat are mostly zeros.
        let skipped = if case.format == SplatFormat::Ksplat { 64..5100 } else { 0..0 };
        for len in (0..case.bytes.len()).filter(|len| !skipped.contains(len)) {
            let cut = &case.bytes[..len];
            match read(cut, case.name, false) {
                // Nothing states how many rows there should be.
                Ok((_, found, _)) if case.format == SplatFormat::Splat => assert_eq!(found, whole[..len / 32]),
                // A number may be shorter, or the last line end absent.
                Ok((_, found, _)) if case.name == "text.ply" => assert_eq!(found[..5], whole[..5]),
                // Its last rows are harmonics, which are not read.
                Ok(_) if case.format == SplatFormat::CompressedPly => panic!("{} cut to {len} bytes", case.name),
                Ok((_, found, _)) => assert!(found == whole, "{} cut to {len} bytes", case.name),
                Err(error) => assert!(is_one_line(&error), "{error}"),
            }
            if let Ok((stated, found, summary)) = read(cut, case.name, true) {
                assert_eq!(summary.splats, found.len() as u64);
                assert!(summary.splats + summary.lost() == stated, "{} cut to {len}: {summary:?}", case.name);
                assert!(case.name == "text.ply" || found[..] == whole[..found.len()], "{} cut to {len}", case.name);
            }
        }
    }
}

/// 1,500 changes of each file; SLICEWALK_SPLAT_CHANGES asks for more.
#[test]
fn changed_files_never_crash_and_never_yield_unsound_splats() {
    let changes = std::env::var("SLICEWALK_SPLAT_CHANGES").ok().and_then(|n| n.parse().ok()).unwrap_or(1500);
    let splats = write::random_splats(9, 10);
    let words: [u32; 8] = [0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 0x7FC0_0000];
    for case in cases(&splats) {
        let mut random = Random(0xDEAD_BEEF);
        let mut kept = 0;
        for number in 0..changes {
            let mut bytes = case.bytes.clone();
            for _ in 0..=random.below(3) {
                // Headers decide most.
                let most = if random.below(2) == 0 { bytes.len().min(200) } else { bytes.len() };
                let at = random.below(most);
                match random.below(5) {
                    0 => bytes[at] = random.word() as u8,
                    1 => bytes[at] ^= 1 << random.below(8),
                    2 => {
                        let word = words[random.below(words.len())].to_le_bytes();
                        bytes[at..].iter_mut().zip(word).for_each(|(byte, new)| *byte = new);
                    }
                    3 => bytes.truncate(at.max(1)),
                    _ => bytes.insert(at, b'9'),
                }
            }
            match read(&bytes, case.name, number % 2 == 0) {
                Ok((_, found, summary)) => {
                    kept += 1;
                    assert_eq!(found.len() as u64, summary.splats, "{} change {number}", case.name);
                    assert!(found.iter().all(is_sound), "{} change {number}: {found:?}", case.name);
                }
                Err(error) => assert!(is_one_line(&error), "{} change {number}: {error}", case.name),
            }
        }
        println!("{}: {changes} changes, {kept} still read", case.name);
    }
}
