//! Sound meshes in many parts: each triangle that a file states is there once and has its own corners and colour, however
//! the file stores them, and a part that changes while it is read is no part of the mesh.

use base64::Engine;
use slicewalk_base::bytes::testing::hold;
use slicewalk_base::{Monitor, NoMonitor, Result, Warning};
use slicewalk_mesh::paint::Paint;
use slicewalk_mesh::{MeshBatch, MeshOptions, MeshSet, Triangle};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Notes all warnings.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Monitor for Notes {
    fn warn(&self, warning: &Warning) {
        self.0.lock().unwrap().push(warning.to_string());
    }
}

/// Reads a file with its colours; calls `act` after the first batch. Returns the triangles and the warnings.
fn read_and(path: &Path, allow_incomplete: bool, act: impl FnOnce()) -> Result<(Vec<Triangle>, Vec<String>)> {
    let notes = Notes::default();
    let options = MeshOptions { colours: true, allow_incomplete, ..MeshOptions::default() };
    let set = MeshSet::open(&[path.to_path_buf()], options, &notes)?;
    let (mut feed, mut batch, mut all, mut act) = (set.feed(), MeshBatch::default(), Vec::new(), Some(act));
    while feed.next_painted(&mut batch, &notes)? {
        all.extend_from_slice(&batch.triangles);
        if let Some(act) = act.take() {
            act();
        }
    }
    Ok((all, notes.0.into_inner().unwrap()))
}

/// Reads a file of few triangles, with their paints.
fn read_painted(name: &str, content: &str) -> (Vec<Triangle>, Vec<Paint>) {
    let path = PathBuf::from(format!("parts/{name}"));
    hold(&path, content.as_bytes());
    let set = MeshSet::open(&[path], MeshOptions { colours: true, ..MeshOptions::default() }, &NoMonitor).unwrap();
    let (mut feed, mut batch) = (set.feed(), MeshBatch::default());
    let (mut triangles, mut paints) = (Vec::new(), Vec::new());
    while feed.next_painted(&mut batch, &NoMonitor).unwrap() {
        triangles.append(&mut batch.triangles);
        paints.append(&mut batch.paints);
    }
    (triangles, paints)
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A buffer in the text itself.
fn in_text(bytes: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!(r#"{{"uri":"data:;base64,{text}","byteLength":{}}}"#, bytes.len())
}

/// A glTF of one mesh; `rest` begins with a comma or is empty.
fn gltf(primitives: &str, accessors: &str, views: &str, buffers: &str, rest: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitives}]}}],
        "accessors":[{accessors}],"bufferViews":[{views}],"buffers":[{buffers}]{rest}}}"#
    )
}

fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&[90; 12]).unwrap();
    bytes
}

/// Parts with `counts` triangles: a glTF of one file per part, the content of these files, and the triangles.
fn in_files(counts: &[usize]) -> (String, Vec<Vec<u8>>, Vec<Triangle>) {
    let list = |text: fn(usize, usize) -> String| {
        counts.iter().enumerate().map(|(part, count)| text(part, *count)).collect::<Vec<String>>().join(",")
    };
    let text = gltf(
        &list(|part, _| format!(r#"{{"attributes":{{"POSITION":{part}}}}}"#)),
        &list(|part, count| {
            format!(r#"{{"bufferView":{part},"componentType":5126,"count":{},"type":"VEC3"}}"#, 3 * count)
        }),
        &list(|part, count| format!(r#"{{"buffer":{part},"byteLength":{}}}"#, 36 * count)),
        &list(|part, count| format!(r#"{{"uri":"{part}.bin","byteLength":{}}}"#, 36 * count)),
        "",
    );
    let (mut files, mut triangles) = (Vec::new(), Vec::new());
    for (part, &count) in counts.iter().enumerate() {
        let mut bytes = Vec::new();
        for number in 0..count {
            let (x, y) = (part as f32, number as f32);
            bytes.extend(floats(&[x, y, 0.0, x + 0.5, y, 0.0, x, y + 0.5, 0.0]));
            // In glTF y is up.
            let [x, z] = [x, y].map(f64::from);
            triangles.push([[x, 0.0, z], [x + 0.5, 0.0, z], [x, 0.0, z + 0.5]]);
        }
        files.push(bytes);
    }
    (text, files, triangles)
}

/// More parts than files are held open, and more triangles than are read at a time.
const COUNTS: [usize; 12] = [5000, 1, 2, 1, 1, 1, 1, 1, 1, 1, 1, 3];

#[test]
fn a_gltf_in_many_files_is_whole_and_a_file_that_changes_is_named() {
    let (text, files, triangles) = in_files(&COUNTS);
    let path = PathBuf::from("parts/a.gltf");
    let hold_all = || {
        hold(&path, text.as_bytes());
        files.iter().enumerate().for_each(|(part, bytes)| hold(format!("parts/{part}.bin"), &bytes[..]));
    };
    hold_all();
    let (found, notes) = read_and(&path, false, || ()).unwrap();
    assert!(found == triangles && notes.is_empty(), "{} {notes:?}", found.len());
    // A file that was read before it changed, and two that were not.
    for (part, left) in [(0, triangles.len()), (1, 5000), (11, triangles.len() - 3)] {
        let change = || hold(format!("parts/{part}.bin"), [&files[part][..], &[0; 4]].concat());
        let words = format!("parts/{part}.bin changed while it was read");
        hold_all();
        let error = read_and(&path, false, change).unwrap_err().to_string();
        assert!(error.starts_with("parts/a.gltf: ") && error.contains(&words), "{error}");
        hold_all();
        let (found, notes) = read_and(&path, true, change).unwrap();
        assert!(found == triangles[..left], "{part}: {}", found.len());
        assert!(notes.len() == 1 && notes[0].contains("incomplete: ") && notes[0].contains(&words), "{notes:?}");
    }
}

#[test]
fn a_file_that_is_cut_while_it_is_read_gives_no_triangles_or_colours() {
    let folder = tempfile::tempdir().unwrap();
    let (text, files, triangles) = in_files(&[5000, 1]);
    let path = folder.path().join("a.gltf");
    let image = r#","materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"textures":[{"source":0}],
        "images":[{"bufferView":1}]"#;
    let text = text.replacen(r#"{"POSITION":1}}"#, r#"{"POSITION":1},"material":0}"#, 1);
    fs::write(&path, format!("{}{image}}}", text.strip_suffix('}').unwrap())).unwrap();
    let cut = || fs::File::options().write(true).open(folder.path().join("1.bin")).unwrap().set_len(0).unwrap();
    for allow_incomplete in [false, true] {
        files
            .iter()
            .enumerate()
            .for_each(|(n, bytes)| fs::write(folder.path().join(format!("{n}.bin")), bytes).unwrap());
        match read_and(&path, allow_incomplete, cut) {
            Ok((found, notes)) => {
                assert!(allow_incomplete && found == triangles[..5000], "{}", found.len());
                for words in ["texture image 0: ", "incomplete: buffer 1: "] {
                    let is_told =
                        |note: &String| note.contains(words) && note.contains("the file ends before its values");
                    assert!(notes.iter().any(is_told), "{words}: {notes:?}");
                }
            }
            Err(error) => {
                let words = "buffer 1: the file ends before its values";
                assert!(!allow_incomplete && error.to_string().contains(words), "{error}");
            }
        }
    }
}

#[test]
fn sparse_values_replace_those_of_their_numbers_and_no_others() {
    // On a parabola, so that any three corners have an area.
    let corner = |number: usize, z: f32| [number as f32, (number * number) as f32, z];
    for chosen in 1..64usize {
        let numbers: Vec<usize> = (0..6).filter(|number| chosen >> number & 1 == 1).collect();
        let (count, end) = (numbers.len(), 72 + 12 * numbers.len());
        let (kind, size) = [(5121, 1), (5123, 2), (5125, 4)][chosen % 3];
        let mut bytes = floats(&(0..6).flat_map(|number| corner(number, 0.0)).collect::<Vec<f32>>());
        bytes.extend(floats(&numbers.iter().flat_map(|&number| corner(number, 1.0)).collect::<Vec<f32>>()));
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()[..size].to_vec()));
        let accessor = format!(
            r#"{{"bufferView":0,"componentType":5126,"count":6,"type":"VEC3","sparse":{{"count":{count},
            "indices":{{"bufferView":2,"componentType":{kind}}},"values":{{"bufferView":1}}}}}}"#
        );
        let views = format!(
            r#"{{"buffer":0,"byteLength":72}},{{"buffer":0,"byteOffset":72,"byteLength":{}}},
            {{"buffer":0,"byteOffset":{end},"byteLength":{}}}"#,
            12 * count,
            size * count
        );
        let text = gltf(r#"{"attributes":{"POSITION":0}}"#, &accessor, &views, &in_text(&bytes), "");
        let expected = |number: usize| {
            let [x, y, z] = corner(number, if numbers.contains(&number) { 1.0 } else { 0.0 }).map(f64::from);
            [x, -z, y]
        };
        let (found, _) = read_painted("sparse.gltf", &text);
        assert_eq!(found, [[0, 1, 2].map(expected), [3, 4, 5].map(expected)], "{numbers:?}");
    }
}

#[test]
fn sparse_values_whose_indices_do_not_ascend_are_refused() {
    // The first accessor is plain, the second replaces two of its three values.
    let text = |indices: [u8; 2], primitive: &str| {
        let mut bytes = floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0., 2., 0., 0., 0., 2., 0.]);
        bytes.extend(indices);
        let plain = r#""bufferView":0,"componentType":5126,"count":3,"type":"VEC3""#;
        let sparse = r#""count":2,"indices":{"bufferView":2,"componentType":5121},"values":{"bufferView":1}"#;
        let views = r#"{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":24},
            {"buffer":0,"byteOffset":60,"byteLength":2}"#;
        gltf(primitive, &format!(r#"{{{plain}}},{{{plain},"sparse":{{{sparse}}}}}"#), views, &in_text(&bytes), "")
    };
    let path = PathBuf::from("parts/order.gltf");
    let (places, colours) = (r#"{"attributes":{"POSITION":1}}"#, r#"{"attributes":{"POSITION":0,"COLOR_0":1}}"#);
    for primitive in [places, colours] {
        hold(&path, text([1, 2], primitive).into_bytes());
        assert_eq!(read_and(&path, false, || ()).unwrap().0.len(), 1);
        for (indices, index) in [([2, 1], 1), ([1, 1], 1), ([0, 3], 3)] {
            hold(&path, text(indices, primitive).into_bytes());
            let words = format!("accessor 1: sparse value 1 has the index {index}; expected ascending indices below 3");
            for allow_incomplete in [false, true] {
                let error = read_and(&path, allow_incomplete, || ()).unwrap_err().to_string();
                assert!(error.starts_with("parts/order.gltf: ") && error.contains(&words), "{words}: {error}");
            }
        }
    }
    // Colours are only read if they are requested.
    hold(&path, text([2, 1], colours).into_bytes());
    let set = MeshSet::open(&[path], MeshOptions::default(), &NoMonitor).unwrap();
    let (mut feed, mut batch) = (set.feed(), Vec::new());
    assert!(feed.next(&mut batch, &NoMonitor).unwrap() && batch.len() == 1);
}

/// A file may have several scenes, of which the default one or the first is read.
#[test]
fn parts_that_the_scene_does_not_show_are_left_out_with_a_warning() {
    let part = r#"{"attributes":{"POSITION":0}}"#;
    let accessor = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}"#;
    let buffer = in_text(&floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0.]));
    let path = PathBuf::from("parts/scenes.gltf");
    for (scene, shown, hidden) in [("", 2, "1 part"), (r#""scene":1,"#, 1, "2 parts")] {
        let scenes = format!(r#",{scene}"scenes":[{{"nodes":[0]}},{{"nodes":[1]}}]"#);
        let text = gltf(part, accessor, r#"{"buffer":0,"byteLength":36}"#, &buffer, &scenes);
        // Lines are no triangles that could be missed.
        let lines = r#"{"mode":1,"attributes":{"POSITION":0}}"#;
        let meshes = format!(r#""meshes":[{{"primitives":[{part},{lines},{part}]}},"#);
        let text = text.replacen(r#""nodes":[{"mesh":0}]"#, r#""nodes":[{"mesh":0},{"mesh":1}]"#, 1);
        hold(&path, text.replacen(r#""meshes":["#, &meshes, 1).into_bytes());
        let (found, notes) = read_and(&path, false, || ()).unwrap();
        let note = format!("parts/scenes.gltf: left out {hidden} of meshes that the scene does not show");
        assert_eq!((found.len(), notes), (shown, vec![note]));
    }
}

#[test]
fn positions_in_16_bits_without_a_sign_are_numbers_or_fractions() {
    let bytes: Vec<u8> =
        [0u16, 0, 0, 65_535, 0, 0, 0, 40_000, 0].iter().flat_map(|value| value.to_le_bytes()).collect();
    for (normalized, whole) in [(false, 1.0), (true, 65_535.0)] {
        let accessor =
            format!(r#"{{"bufferView":0,"componentType":5123,"normalized":{normalized},"count":3,"type":"VEC3"}}"#);
        let view = r#"{"buffer":0,"byteLength":18}"#;
        let text = gltf(r#"{"attributes":{"POSITION":0}}"#, &accessor, view, &in_text(&bytes), "");
        let (found, _) = read_painted("short.gltf", &text);
        assert_eq!(found, [[[0.0; 3], [65_535.0 / whole, 0.0, 0.0], [0.0, 0.0, 40_000.0 / whole]]], "{normalized}");
    }
}

/// Corners without a colour have that of the material, and corners without a place in the texture lie at its origin.
#[test]
fn colours_and_places_of_a_gltf_may_be_fewer_than_its_corners() {
    let mut bytes = floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0., 0.25, 0.75]);
    bytes.extend([65_535u16, 0, 0, 0, 65_535, 0].iter().flat_map(|value| value.to_le_bytes()));
    let image = bytes.len();
    bytes.extend(png());
    let views = format!(
        r#"{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":8}},
        {{"buffer":0,"byteOffset":44,"byteLength":12}},{{"buffer":0,"byteOffset":{image},"byteLength":{}}}"#,
        bytes.len() - image
    );
    let accessors = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":1,"componentType":5126,"count":1,"type":"VEC2"},
        {"bufferView":2,"componentType":5123,"count":2,"type":"VEC3"}"#;
    let primitives = r#"{"attributes":{"POSITION":0,"COLOR_0":2}},
        {"attributes":{"POSITION":0,"TEXCOORD_0":1},"material":0},
        {"attributes":{"POSITION":0,"TEXCOORD_0":1,"COLOR_0":2},"material":0}"#;
    let rest = r#","materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"textures":[{"source":0}],
        "images":[{"bufferView":3}]"#;
    let (found, paints) = read_painted("few.gltf", &gltf(primitives, accessors, &views, &in_text(&bytes), rest));
    assert_eq!(found.len(), 3);
    let colours = [[255, 0, 0], [0, 255, 0], [255; 3]];
    let [
        Paint::Corners(corners),
        Paint::Texture { texture, places, tints },
        Paint::Texture { texture: again, tints: other, .. },
    ] = &paints[..]
    else {
        panic!("{paints:?}")
    };
    assert_eq!((corners, tints, other), (&colours, &[[255; 3]; 3], &colours));
    assert_eq!(*places, [[0.25, 0.75], [0.0; 2], [0.0; 2]]);
    // An image is read once.
    assert!(Arc::ptr_eq(texture, again));
}

/// Triangles do not need colours.
#[test]
fn without_usable_colours_the_triangles_of_a_gltf_have_the_colour_of_their_material() {
    let mut bytes = floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 1.]);
    let image = bytes.len();
    bytes.extend(png());
    let views = format!(
        r#"{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":24}},
        {{"buffer":0,"byteOffset":{image},"byteLength":{}}}"#,
        bytes.len() - image
    );
    let accessors = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}"#;
    let primitives = r#"{"attributes":{"POSITION":0,"TEXCOORD_0":1},"material":0},{"attributes":{"POSITION":0}}"#;
    let rest = r#","materials":[{"pbrMetallicRoughness":{"baseColorFactor":[1,0,0,1],"baseColorTexture":{"index":0}}}],
        "textures":[{"source":0}],"images":[{"bufferView":2}]"#;
    let base = gltf(primitives, accessors, &views, &in_text(&bytes), rest);
    let missing = "a part has a texture whose coordinates are missing, or of a set other than 0 and 1";
    for (from, to, words, has_texture) in [
        (r#""type":"VEC2""#, r#""type":"VEC4""#, "accessor 1: expected Vec2".to_owned(), false),
        (r#""TEXCOORD_0":1"#, r#""TEXCOORD_0":7"#, "it names accessor 7, which does not exist".into(), false),
        (r#","TEXCOORD_0":1"#, "", format!("TEXCOORD_0: {missing}"), false),
        (r#"{"index":0}"#, r#"{"index":0,"texCoord":2}"#, format!("TEXCOORD_2: {missing}"), false),
        (r#""TEXCOORD_0":1"#, r#""TEXCOORD_0":1,"COLOR_0":1"#, "accessor 1: expected Vec3".into(), true),
    ] {
        assert!(base.contains(from), "{from}");
        let text = base.replacen(from, to, 1);
        let (_, paints) = read_painted("without.gltf", &text);
        match &paints[..] {
            [Paint::Flat([255, 0, 0]), Paint::None] => assert!(!has_texture, "{words}"),
            [Paint::Texture { tints: [[255, 0, 0], ..], .. }, Paint::None] => assert!(has_texture, "{words}"),
            _ => panic!("{words}: {paints:?}"),
        }
        for allow_incomplete in [false, true] {
            let (found, notes) = read_and(Path::new("parts/without.gltf"), allow_incomplete, || ()).unwrap();
            assert!(found.len() == 2 && notes.len() == 1 && notes[0].contains(&words), "{words}: {notes:?}");
        }
    }
}

#[test]
fn faces_of_an_obj_are_white_if_they_have_no_place_in_their_texture() {
    hold("parts/a.png", png());
    hold("parts/a.mtl", *b"newmtl a\nKd 0 0 0\nmap_Kd a.png\n");
    let text = "mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1 2 3\nf 1/1 2/2 3/3\n";
    let (_, paints) = read_painted("a.obj", text);
    assert!(matches!(paints[..], [Paint::Flat([255, 255, 255]), Paint::Texture { .. }]), "{paints:?}");
}

#[test]
fn materials_of_an_obj_may_begin_with_a_byte_order_mark() {
    hold("parts/mark.mtl", "\u{feff}newmtl red\nKd 1 0 0\n".as_bytes());
    let (_, paints) = read_painted("mark.obj", "mtllib mark.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n");
    assert!(matches!(paints[..], [Paint::Flat([255, 0, 0])]), "{paints:?}");
}

/// One range for all corners: those that are dark have no value above 1 either.
#[test]
fn colours_of_an_obj_run_to_1_or_to_255_in_the_whole_file() {
    let corners = |colour: &str| ["0 0 0", "1 0 0", "0 1 0"].map(|at| format!("v {at} {colour}\n")).concat();
    for (first, second, expected) in [
        ("1 1 0", "200 9 9", [[1u8, 1, 0], [200, 9, 9]]),
        ("1 1 0", "2 0 0", [[1, 1, 0], [2, 0, 0]]),
        ("1 1 0", "1 0.2 -3", [[255, 255, 0], [255, 51, 0]]),
        // Slightly beyond white.
        ("0.2 1 0", "1.004 0.2 0", [[51, 255, 0], [255, 51, 0]]),
    ] {
        let text = format!("{}{}f 1 2 3\nf 4 5 6\n", corners(first), corners(second));
        let (_, paints) = read_painted("range.obj", &text);
        let [Paint::Corners(dark), Paint::Corners(bright)] = &paints[..] else { panic!("{paints:?}") };
        assert_eq!([*dark, *bright], expected.map(|colour| [colour; 3]), "{second}");
    }
}

#[test]
fn the_colour_of_a_corner_of_an_obj_stands_behind_its_weight() {
    let text = |more: &str| format!("v 0 0 0 {more}\nv 1 0 0 {more}\nv 0 1 0 {more}\nf 1 2 3\n");
    for more in ["255 0 9", "1 255 0 9", "0.5 255 0 9 # red", "1 1 0 0.035"] {
        let (_, paints) = read_painted("weight.obj", &text(more));
        assert!(matches!(paints[..], [Paint::Corners([[255, 0, 9], [255, 0, 9], [255, 0, 9]])]), "{more}: {paints:?}");
    }
    let (_, paints) = read_painted("weight.obj", &text("0.5"));
    assert!(matches!(paints[..], [Paint::None]), "{paints:?}");
}

/// A comment may name a folder of Windows; other lines go on behind a backslash.
#[test]
fn a_backslash_in_a_comment_of_an_obj_joins_no_lines() {
    let text = "# C:\\scans\\\nv 0 0 0\nv 1 0 0\nv 0 1 0 # D:\\\nf 1 2 3\n  # E:\\\nf 1 \\\n2 3\n";
    assert_eq!(read_painted("comment.obj", text).0.len(), 2);
}

/// Each byte is looked at a few times, however many lines are joined.
#[test]
fn many_joined_lines_of_an_obj_take_no_longer_than_others() {
    let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 \\\n{}3 \\\n# \\\n", "\\\n".repeat(200_000));
    assert_eq!(read_painted("joined.obj", &text).0.len(), 1);
}

#[test]
fn strips_of_a_ply_have_the_colours_of_their_corners_and_may_have_other_properties() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\nelement tristrips 1\n\
                property uchar flags\nproperty list int int vertex_indices\nproperty uchar layer\nend_header\n\
                0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n1 1 0 9 8 7\n1 4 0 1 2 3 2\n";
    let (found, paints) = read_painted("a.ply", text);
    let places = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
    assert_eq!(found, [[places[0], places[1], places[2]], [places[1], places[2], places[3]]]);
    let [Paint::Corners(first), Paint::Corners(second)] = &paints[..] else { panic!("{paints:?}") };
    assert_eq!(*first, [[255, 0, 0], [0, 255, 0], [0, 0, 255]]);
    assert_eq!(*second, [[0, 255, 0], [0, 0, 255], [9, 8, 7]]);
}

/// A batch is full in the middle of the lines that are read for it.
#[test]
fn large_faces_of_an_obj_fill_many_batches_and_none_is_lost() {
    const CORNERS: usize = 20;
    let mut text = String::new();
    for n in 0..CORNERS {
        // On a parabola: convex.
        text += &format!("v {n} {} 0\n", n * n);
    }
    let face: String = (1..=CORNERS).map(|n| format!(" {n}")).collect();
    text += &format!("f{face}\n").repeat(600);
    let path = PathBuf::from("parts/large.obj");
    hold(&path, text.into_bytes());
    let set = MeshSet::open(&[path], MeshOptions::default(), &NoMonitor).unwrap();
    let (mut feed, mut batch, mut count) = (set.feed(), Vec::new(), 0);
    while feed.next(&mut batch, &NoMonitor).unwrap() {
        assert!(batch.len() < 4096 + CORNERS, "{}", batch.len());
        count += batch.len();
    }
    assert_eq!(count, 600 * (CORNERS - 2));
}
