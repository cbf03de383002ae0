//! Meshes that no program writes: each is refused with one line that names the file and what is wrong with it, or read
//! without the colours that cannot be found, with a warning.

use base64::Engine;
use slicewalk_base::bytes::testing::{Strike, StruckSource, hold};
use slicewalk_base::bytes::{MemorySource, hold_source, release_sources};
use slicewalk_base::{Error, Monitor, NoMonitor, Result, Warning};
use slicewalk_mesh::{MeshBatch, MeshOptions, MeshSet, Triangle};
use std::path::PathBuf;
use std::sync::Mutex;

/// Notes all warnings.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Monitor for Notes {
    fn warn(&self, warning: &Warning) {
        self.0.lock().unwrap().push(warning.to_string());
    }
}

/// Reads the files at these paths; returns the triangles and the warnings.
fn read_all(paths: &[PathBuf], options: MeshOptions) -> Result<(Vec<Triangle>, Vec<String>)> {
    let notes = Notes::default();
    let set = MeshSet::open(paths, options, &notes)?;
    let (mut feed, mut batch, mut all) = (set.feed(), MeshBatch::default(), Vec::new());
    while feed.next_painted(&mut batch, &notes)? {
        all.extend_from_slice(&batch.triangles);
    }
    Ok((all, notes.0.into_inner().unwrap()))
}

fn read(name: &str, content: impl AsRef<[u8]>) -> Result<(Vec<Triangle>, Vec<String>)> {
    let path = PathBuf::from(format!("odd/{name}"));
    hold(&path, content.as_ref());
    read_all(&[path], MeshOptions { colours: true, ..MeshOptions::default() })
}

fn refuse(name: &str, content: impl AsRef<[u8]>, words: &str) {
    let Err(error) = read(name, content) else { panic!("{name} is read; expected: {words}") };
    let text = error.to_string();
    assert!(text.starts_with("odd/") && text.contains(words) && text.lines().count() == 1, "{words}: {text}");
}

/// A glTF of one triangle with a texture.
fn gltf() -> String {
    let corners: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let data = base64::engine::general_purpose::STANDARD.encode(corners);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"uri":"data:;base64,{data}","byteLength":36}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":30,"byteLength":9}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
        {{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],"textures":[{{"source":0}}],
        "images":[{{"bufferView":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":0}}]}}],"nodes":[{{"mesh":0}}]}}"#
    )
}

#[test]
fn odd_gltfs_are_refused() {
    let base = gltf();
    for (from, to, words) in [
        (r#""version":"2.0""#, r#""version":"1.0""#, "expected glTF of version 2, found \"1.0\""),
        (r#""nodes":[{"#, r#""scenes":[{"nodes":[7]}],"nodes":[{"#, "it names node 7, which does not exist"),
        (r#""nodes":[{"#, r#""extensionsRequired":["KHR_other"],"nodes":[{"#, "KHR_other"),
        (r#""nodes":[{"#, r#""extensionsRequired":["KHR_gaussian_splatting"],"nodes":[{"#, "splats, not a mesh"),
        (r#"{"attributes""#, r#"{"mode":0,"attributes""#, "it has 1 part of points, which are not read"),
        (r#""mesh":0"#, r#""mesh":3"#, "it names mesh 3, which does not exist"),
        (r#"[{"buffer":0"#, r#"[{"buffer":5"#, "there is no buffer 5"),
        (r#""POSITION":0"#, r#""POSITION":8"#, "it names accessor 8, which does not exist"),
        (r#""count":3,"type":"VEC3""#, r#""count":4,"type":"VEC3""#, "accessor 0"),
        (
            r#"[{"buffer":0,"byteLength":36"#,
            r#"[{"buffer":0,"byteStride":8,"byteLength":36"#,
            "accessor 0: its view 0 has values 8 bytes apart; expected 12 or more; write the file again",
        ),
        (r#""byteLength":36}]"#, r#""byteLength":37}]"#, "it should have 37 bytes and has 36: it is cut"),
        (r#""uri":"data:;base64,"#, r#""uri":"data:;base64,?"#, "its base64 text is damaged"),
        (r#""uri":"data:;base64,"#, r#""uri":"https://host/"#, "it lies elsewhere"),
        (r#""uri":"data:;base64,"#, r#""uri":"../"#, "leads out of the folder"),
        (r#"{"asset""#, r#"{"asset":{},"asset""#, "version"),
        (r#"{"asset""#, r#"["asset""#, "an object"),
    ] {
        assert!(base.contains(from), "{from}");
        refuse("a.gltf", base.replacen(from, to, 1), words);
    }
    // Each node below the one before.
    let chain: String = (1..1003).map(|child| format!(r#"{{"children":[{child}]}},"#)).collect();
    refuse("deep.gltf", base.replacen(r#""nodes":["#, &format!(r#""nodes":[{chain}"#), 1), "others");
    // More instances than parts are allowed, whose places take no bytes.
    let zeros = r#""sparse":{"count":0,"indices":{"bufferView":0,"componentType":5121},"values":{"bufferView":0}}"#;
    let places = format!(r#"VEC2"}},{{"componentType":5126,"count":4194305,"type":"VEC3",{zeros}}}]"#);
    let instances = r#"{"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":2}}}}"#;
    let repeated = base.replacen(r#"VEC2"}]"#, &places, 1).replacen(r#"{"mesh":0}"#, instances, 1);
    refuse("many.gltf", &repeated, "more than 4194304 placed parts of meshes");
    assert_eq!(read("few.gltf", repeated.replace("4194305", "3")).unwrap().0.len(), 3);
    // Instances without places lie at their node.
    assert_eq!(read("own.gltf", repeated.replace("\"TRANSLATION\":2", "\"_ID\":2")).unwrap().0.len(), 1);
    // Corners without bytes.
    let corners = format!(r#"[{{"componentType":5126,"count":4294967297,"type":"VEC3",{zeros}}}"#);
    let nothing = base.replacen(r#"[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}"#, &corners, 1);
    refuse("zeros.gltf", &nothing, "accessor 0: 4294967297 values without bytes; expected at most 4294967296");
    hold("odd/long.gltf", vec![b' '; (16 << 20) + 1]);
    let options = MeshOptions { memory_bytes: 1 << 16, allow_incomplete: true, ..MeshOptions::default() };
    let error = read_all(&["odd/long.gltf".into()], options).unwrap_err().to_string();
    assert!(error.contains("structure (bytes)") && error.contains("16777217"), "{error}");
}

#[test]
fn triangles_beside_points_stay_where_incomplete_input_is_allowed() {
    let part = r#"{"attributes":{"POSITION":0}}"#;
    let points = format!(r#"[{part},{{"mode":0,"attributes":{{"POSITION":0}}}},{{"attributes""#);
    hold("odd/mixed.gltf", gltf().replacen(r#"[{"attributes""#, &points, 1).into_bytes());
    let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
    let (triangles, notes) = read_all(&["odd/mixed.gltf".into()], options).unwrap();
    assert_eq!(triangles.len(), 2);
    assert!(notes.iter().any(|note| note.contains("incomplete: structure: it has 1 part of points")), "{notes:?}");
}

#[test]
fn without_a_usable_texture_the_triangles_stay() {
    let base = gltf();
    for (from, to, words) in [
        ("", "", "texture image 0: it is neither PNG nor JPEG"),
        (r#""material":0"#, r#""material":9"#, "there is no material 9"),
        (r#"{"source":0}"#, "{}", "texture 0 has no image in PNG or JPEG"),
        (r#"{"source":0}"#, r#"{"source":4}"#, "there is no image 4"),
        (r#"{"bufferView":0}]"#, "{}]", "it has neither an address nor a place in a buffer"),
        (r#"{"bufferView":0}]"#, r#"{"bufferView":9}]"#, "it should lie in a buffer, and does not"),
        (r#"{"bufferView":0}]"#, r#"{"bufferView":1}]"#, "it should lie in a buffer, and does not"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"data:;base64,?"}]"#, "its base64 text is damaged"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"https://host/a.png"}]"#, "it lies elsewhere"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"../a.png"}]"#, "leads out of the folder"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"none%20such.png"}]"#, "none such.png"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"data:;base64,iVBORw0KGgo="}]"#, "it is damaged"),
        (r#"{"bufferView":0}]"#, r#"{"uri":"data:;base64,/9j/2Q=="}]"#, "it is damaged"),
    ] {
        assert!(base.contains(from), "{from}");
        let (triangles, notes) = read("a.gltf", base.replacen(from, to, 1)).unwrap();
        assert_eq!(triangles.len(), 1, "{words}");
        assert!(
            notes.iter().any(|note| note.starts_with("odd/a.gltf: ") && note.contains(words)),
            "{words}: {notes:?}"
        );
    }
}

/// The contents of an archive must not depend on the memory, so such a texture is not left out.
#[test]
fn a_texture_beyond_the_memory_is_an_error() {
    hold("odd/large.png", [0u8; 100]);
    hold("odd/large.mtl", *b"newmtl a\nmap_Kd large.png\n");
    let base = gltf();
    let obj = "mtllib large.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    for (name, text, words) in [
        ("a.gltf", base.clone(), "textures up to image 0 (bytes): 36 is beyond the limit of 16"),
        (
            "a.gltf",
            base.replacen(r#"{"bufferView":0}]"#, r#"{"uri":"large.png"}]"#, 1),
            "textures up to image 0 (bytes): 100 is beyond the limit of 16",
        ),
        ("a.obj", obj.into(), "textures up to \"large.png\" (bytes): 100 is beyond the limit of 16"),
    ] {
        let path = PathBuf::from(format!("odd/{name}"));
        hold(&path, text.into_bytes());
        for allow_incomplete in [false, true] {
            let options = MeshOptions { colours: true, texture_bytes: 16, allow_incomplete, ..MeshOptions::default() };
            let error = read_all(std::slice::from_ref(&path), options).unwrap_err().to_string();
            assert!(error.contains(words), "{words}: {error}");
        }
    }
}

#[test]
fn materials_beyond_the_limits_are_warnings_and_the_triangles_stay() {
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let warnings = |text: String, triangles: usize| {
        let (found, notes) = read("limits.obj", text).unwrap();
        assert_eq!(found.len(), triangles);
        notes.into_iter().filter(|note| note.contains("materials: ")).collect::<Vec<String>>()
    };
    let unknown: String = (0..20).map(|n| format!("usemtl m{n}\nf 1 2 3\n")).collect();
    let notes = warnings(format!("{corners}{unknown}"), 20);
    let end = " (further warnings for this file are left out)";
    assert!(notes.len() == 8 && notes[7].ends_with(end) && !notes[6].ends_with(end), "{notes:?}");
    // More files, more materials in a file, and more bytes than allowed.
    let mut lines = String::new();
    for n in 0..65 {
        hold(format!("odd/m{n}.mtl"), format!("newmtl m{n}\nKd 1 0 0\n").into_bytes());
        lines += &format!("mtllib m{n}.mtl\n");
    }
    let notes = warnings(format!("{lines}{corners}usemtl m63\nf 1 2 3\nusemtl m64\nf 1 2 3\n"), 2);
    assert!(notes.len() == 1 && notes[0].contains("no material is called \"m64\""), "{notes:?}");
    let many: String = (0..65_537).map(|n| format!("newmtl m{n}\n")).collect();
    let long = vec![b'\n'; (16 << 20) + 1];
    for (bytes, words) in
        [(many.into_bytes(), "more than 65536 materials"), (long, "16777217 bytes; expected at most 16777216")]
    {
        hold("odd/limits.mtl", bytes);
        let notes = warnings(format!("mtllib limits.mtl\n{corners}f 1 2 3\n"), 1);
        assert!(notes.len() == 1 && notes[0].contains(words), "{words}: {notes:?}");
    }
}

/// A program that hands files over, such as the page, knows their names and not their folders.
#[test]
fn files_that_are_handed_over_belong_to_the_mesh_beside_them() {
    hold("odd/walls.mtl", *b"newmtl wall\nmap_Kd textures\\wall.png\n");
    hold("odd/wall.png", *b"no picture");
    let (triangles, notes) =
        read("a.obj", "mtllib walls.mtl\nusemtl wall\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    assert!(triangles.len() == 1 && notes.iter().any(|note| note.contains("neither PNG nor JPEG")), "{notes:?}");
    let (_, notes) =
        read("a.gltf", gltf().replacen(r#"{"bufferView":0}]"#, r#"{"uri":"textures/wall.png"}]"#, 1)).unwrap();
    assert!(notes.iter().any(|note| note.contains("neither PNG nor JPEG")), "{notes:?}");
    let corners: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    hold("odd/corners.bin", corners);
    let base = gltf();
    let (before, data) = base.split_once("data:").unwrap();
    let (_, behind) = data.split_once('"').unwrap();
    let (triangles, _) = read("a.gltf", format!("{before}buffers/corners.bin\"{behind}")).unwrap();
    assert_eq!(triangles.len(), 1);
    // Without folders, files of one name cannot be told apart.
    let two = format!("{before}a/corners.bin\",\"byteLength\":36}},{{\"uri\":\"b/corners.bin\"{behind}");
    refuse("a.gltf", two, "buffer 1: \"b/corners.bin\" and \"a/corners.bin\" differ in their folders");
    hold("odd/walls.mtl", *b"newmtl wall\nmap_Kd a/wall.png\nnewmtl floor\nmap_Kd b/wall.png\n");
    let corners = "mtllib walls.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let (triangles, notes) = read("a.obj", format!("{corners}usemtl wall\nf 1 2 3\nusemtl floor\nf 3 2 1\n")).unwrap();
    let is_told = |note: &String| note.contains("\"b/wall.png\" and \"a/wall.png\" differ in their folders");
    assert!(triangles.len() == 2 && notes.iter().any(is_told), "{notes:?}");
}

#[test]
fn odd_stls_are_refused() {
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
                endsolid a\n";
    assert_eq!(read("a.stl", text).unwrap().0.len(), 1);
    // On one line, a name may be missing.
    let line = text.replace('\n', " ").replace("solid a ", "solid ");
    assert_eq!(read("a.stl", &line).unwrap().0.len(), 1);
    // So may the normal.
    assert_eq!(read("a.stl", line.replace("normal 0 0 1 ", "")).unwrap().0.len(), 1);
    for (from, to, words) in [
        ("endloop", "vertex 1 1 0\nendloop", "a loop has more than 3 corners"),
        ("vertex 0 1 0\n", "", "a loop has 2 corners; expected 3"),
        ("endloop", "endfacet", "a loop ends without \"endloop\""),
        ("vertex 0 1 0\nendloop\nendfacet\nendsolid a\n", "vertex 0 1", "the file ends before \"endsolid\""),
        ("endsolid a\n", "", "the file ends before \"endsolid\""),
        ("vertex 1 0 0", "vertex 1 0 zero", "expected a number, found \"zero\""),
        ("outer loop", "inner loop", "expected a keyword of STL, found \"inner\""),
        // The name of the solid.
        ("a\nfacet normal", "facet\nnormal", "expected a keyword of STL, found \"normal\""),
    ] {
        assert!(text.contains(from), "{from}");
        refuse("a.stl", text.replacen(from, to, 1), words);
    }
    refuse("a.stl", "solid a\nfacet ".to_owned() + &"a".repeat(1 << 21), "a word of more than 1048576 bytes");
    refuse("a.stl", "no", "expected at least 84 bytes or \"solid\", found 2");
}

/// No triangle is made of the corners of a loop that is not one.
#[test]
fn of_a_broken_loop_of_an_stl_no_corner_is_used() {
    let facet = |corners: &str, end: &str| format!("facet\nouter loop\n{corners}{end}endfacet\n");
    let corners = |count: usize| (0..count).map(|n| format!("vertex {n} {} 0\n", n * n)).collect::<String>();
    let sound = facet("vertex 5 0 0\nvertex 6 0 0\nvertex 5 1 0\n", "endloop\n");
    for (broken, words) in [
        (facet(&corners(1), "endloop\n"), "a loop has 1 corners; expected 3"),
        (facet(&corners(3), ""), "a loop ends without \"endloop\""),
        (facet(&corners(4), "endloop\n"), "a loop has more than 3 corners"),
        (facet(&corners(7), "endloop\n"), "a loop has more than 3 corners"),
        (facet(&corners(8), ""), "a loop ends without \"endloop\""),
    ] {
        let text = format!("solid\n{sound}{broken}{sound}endsolid\n");
        refuse("a.stl", &text, words);
        hold("odd/a.stl", text.into_bytes());
        let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
        let (triangles, notes) = read_all(&["odd/a.stl".into()], options).unwrap();
        assert_eq!(triangles, [[[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]; 2], "{words}");
        let told: Vec<&String> = notes.iter().filter(|note| note.contains(words)).collect();
        assert!(told.len() == 1 && !told[0].contains("(and "), "{words}: {notes:?}");
    }
    hold("odd/a.stl", format!("solid\n{sound}facet\nouter loop\nvertex 0 0").into_bytes());
    let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
    let (triangles, notes) = read_all(&["odd/a.stl".into()], options).unwrap();
    assert_eq!(triangles.len(), 1);
    assert!(notes.iter().any(|note| note.contains("the file ends before \"endsolid\"")), "{notes:?}");
}

#[test]
fn behind_a_damaged_word_of_an_stl_the_next_facets_are_read() {
    let facet = |x: &str| {
        format!("facet normal 0 0 1\nouter loop\nvertex {x} 0 0\nvertex 6 0 0\nvertex 5 1 0\nendloop\nendfacet\n")
    };
    let sound = facet("5");
    for (broken, words) in [
        (facet("zero"), "line 11: expected a number, found \"zero\""),
        (sound.replace("outer", "inner"), "line 10: expected a keyword of STL, found \"inner\""),
        (sound.replace("5 1 0", "5 1 0 7"), "line 13: expected a keyword of STL, found \"7\""),
        // The rest of the facet is missing.
        ("facet normal 0 0 1\nouter loop\nvertex 5\n".into(), "line 12: expected a number, found \"facet\""),
    ] {
        let text = format!("solid\n{sound}{broken}{sound}{broken}{sound}endsolid\n");
        refuse("a.stl", &text, words);
        let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
        let (triangles, notes) = read_all(&["odd/a.stl".into()], options).unwrap();
        assert_eq!(triangles, [[[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]; 3], "{words}");
        let is_told = |note: &String| note.contains(words) && note.ends_with(" (and 1 face more)");
        assert!(notes.iter().any(is_told), "{words}: {notes:?}");
    }
}

#[test]
fn odd_plys_are_refused() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(read("a.ply", text).unwrap().0.len(), 1);
    // Programs write either name.
    assert_eq!(read("a.ply", text.replace("vertex_indices", "vertex_index")).unwrap().0.len(), 1);
    // Names of coordinates may be in upper case.
    let upper = ["x", "y", "z"].iter().fold(text.to_owned(), |text, axis| {
        text.replace(&format!("float {axis}"), &format!("float {}", axis.to_uppercase()))
    });
    assert_eq!(read("a.ply", &upper).unwrap().0, read("a.ply", text).unwrap().0);
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let twice = format!("element vertex 0\nproperty float x\n{faces}");
    refuse("a.ply", text.replace(faces, &twice), "it has the element \"vertex\" more than once");
    let lists = format!("{faces}property list uchar int vertex_index\n");
    let two = text.replace(faces, &lists).replace("3 0 1 2", "3 0 1 2 3 0 2 1");
    refuse("a.ply", two, "the element \"face\" has 2 lists \"vertex_indices\"; write one");
    let turned = text.replace(faces, "").replace("element vertex", &format!("{faces}element vertex"));
    refuse("a.ply", turned, "faces come before their corners");
    refuse("a.ply", text.replace("3 0 1 2", "3 0 1 9"), "9");
    refuse("a.ply", text.replace("0 1 0\n3 0 1 2\n", ""), "the file ends before the elements that its header states");
    refuse("a.ply", text.replace("float z", "float w"), "header");
    // Behind a broken face, a count that no file holds.
    let endless = "element face 18446744073709551615\nproperty list uchar int vertex_indices\nend_header";
    let broken = text.replace("element face 1", "element face 2").replace("end_header", endless) + "3 0 1 9\n";
    hold("odd/a.ply", broken.into_bytes());
    let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
    let (triangles, notes) = read_all(&["odd/a.ply".into()], options).unwrap();
    let more = "there is no corner 9: it has 3 (and 18,446,744,073,709,551,614 faces more)";
    assert!(triangles.len() == 1 && notes.iter().any(|note| note.contains(more)), "{notes:?}");
}

/// Corners that make no whole triangle, and surfaces that are not faces.
#[test]
fn what_is_not_read_of_a_mesh_is_refused_or_left_out_with_a_warning() {
    let corners = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.], [0., 3., 0.]];
    let bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|v| v.to_le_bytes()).chain([0u8, 1, 2, 1, 2]).collect();
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    // A triangle, and a part of `count` corners.
    let gltf = |part: &str, count: u64| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"uri":"data:;base64,{data}","byteLength":65}}],
            "bufferViews":[{{"buffer":0,"byteLength":60}},{{"buffer":0,"byteOffset":60,"byteLength":5}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
            {{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3"}},
            {{"bufferView":1,"componentType":5121,"count":{count},"type":"SCALAR"}}],"nodes":[{{"mesh":1}}],
            "meshes":[{{"primitives":[]}},{{"primitives":[{{"attributes":{{"POSITION":0}}}},{{{part}}}]}}]}}"#
        )
    };
    let part = |mode: u8, count: u64| gltf(&format!(r#""mode":{mode},"attributes":{{"POSITION":1}}"#), count);
    let indexed = |count: u64| gltf(r#""attributes":{"POSITION":0},"indices":2"#, count);
    let obj = |line: &str| format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{line}\nf 3 2 1\n");
    let surface = "line 5: it is a free-form surface; export the model as faces";
    for (name, content, lost, kept) in [
        ("2.gltf", part(4, 2), "mesh 1, part 1: it has 2 corners; expected a multiple of 3; write the file again", 1),
        ("4.gltf", part(4, 4), "mesh 1, part 1: it has 4 corners; expected a multiple of 3", 2),
        ("5.gltf", part(4, 5), "mesh 1, part 1: it has 5 corners; expected a multiple of 3", 2),
        ("5-indices.gltf", indexed(5), "mesh 1, part 1: it has 5 corners; expected a multiple of 3", 2),
        ("1.gltf", part(5, 1), "mesh 1, part 1: it has 1 corner; expected at least 3", 1),
        ("2-of-fan.gltf", part(6, 2), "mesh 1, part 1: it has 2 corners; expected at least 3", 1),
        ("surf.obj", obj("surf 0 1 0 1 1 2 3"), surface, 2),
        ("bsp.obj", obj("bsp 1 2 3 1 2 3 1 2 3 1 2 3 1 2 3 1"), surface, 2),
        ("bzp.obj", obj("bzp 1 2 3 1 2 3 1 2 3 1 2 3 1 2 3 1"), surface, 2),
        ("cdp.obj", obj("cdp 1 2 3 1 2 3 1 2 3 1 2 3 1 2 3 1"), surface, 2),
    ] {
        refuse(name, &content, lost);
        let options = MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
        let (triangles, notes) = read_all(&[PathBuf::from(format!("odd/{name}"))], options).unwrap();
        assert_eq!(triangles.len(), kept, "{name}");
        let told: Vec<&String> = notes.iter().filter(|note| note.contains(&format!("incomplete: {lost}"))).collect();
        assert!(told.len() == 1 && !told[0].contains("(and "), "{name}: {notes:?}");
    }
    // Curves, commands and whole triangles are no loss.
    assert_eq!(read("curv.obj", obj("curv 0 1 1 2")).unwrap().0.len(), 2);
    assert_eq!(read("csh.obj", obj("csh -ls")).unwrap().0.len(), 2);
    assert_eq!(read("3.gltf", part(5, 3)).unwrap().0.len(), 2);
    assert_eq!(read("3-indices.gltf", indexed(3)).unwrap().0.len(), 2);
    assert_eq!(read("0.gltf", part(4, 0)).unwrap().0.len(), 1);
}

#[test]
fn files_of_no_known_format_are_refused_and_left_out_where_that_is_allowed() {
    refuse("a.xyz", "1 2 3", "no mesh of a known format; expected .obj, .ply, .stl, .gltf or .glb");
    hold("odd/sound.obj", &b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"[..]);
    let paths = ["odd/none.obj", "odd/sound.obj"].map(PathBuf::from);
    let options = || MeshOptions { allow_incomplete: true, ..MeshOptions::default() };
    let (triangles, notes) = read_all(&paths, options()).unwrap();
    assert_eq!(triangles.len(), 1);
    assert!(notes.iter().any(|note| note.contains("left out: odd/none.obj: cannot open")), "{notes:?}");
    assert!(matches!(read_all(&paths[..1], options()), Err(Error::Io { .. })));
    assert!(matches!(read_all(&paths, MeshOptions::default()), Err(Error::Io { .. })));
}

/// Corners beyond the memory lie in a temporary file.
#[test]
fn little_memory_gives_the_same_triangles() {
    const SIDE: usize = 300;
    let mut obj = String::new();
    for at in 0..SIDE * SIDE {
        obj += &format!("v {} {} {}\n", at % SIDE, at / SIDE, at * 7 % 11);
    }
    // Faces across the whole list, so that corners are read in any order.
    for at in 0..20_000 {
        let corner = |n: usize| (at * 7919 + n * 40_009) % (SIDE * SIDE) + 1;
        obj += &format!("f {} {} {}\n", corner(0), corner(1), corner(2));
    }
    let path = [PathBuf::from("odd/large.obj")];
    hold(&path[0], obj.as_bytes());
    let pass = |memory_bytes: u64, temp_dir: PathBuf| {
        let allow_incomplete = true;
        read_all(&path, MeshOptions { memory_bytes, temp_dir, allow_incomplete, ..MeshOptions::default() })
            .map(|read| read.0)
    };
    let folder = std::env::temp_dir();
    let large = pass(1 << 30, "no/such/folder".into()).unwrap();
    assert!(large.len() > 10_000 && pass(1 << 16, folder).unwrap() == large);
    let error = pass(1 << 16, "no/such/folder".into()).unwrap_err().to_string();
    assert!(
        error.contains("cannot create a temporary file") && error.contains("choose a folder with space"),
        "{error}"
    );
}

/// Files longer than a buffer, so that reading fails at the front, in the middle, and in the padding at the end.
#[test]
fn a_failed_read_is_an_error_or_a_warning_wherever_it_is() {
    let head = |format: &str, faces: usize| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let values: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let facet = "facet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let (face, padding) = (b"\x03\0\0\0\0\x01\0\0\0\x02\0\0\0", vec![0u8; 600 << 10]);
    let triangle = [&[0u8; 12][..], &values, &[0; 2]].concat();
    let binary = [&[b' '; 80][..], &6000u32.to_le_bytes(), &triangle.repeat(6000), &padding].concat();
    for (name, bytes, triangles) in [
        ("a.obj", ("v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned() + &"f 1 2 3\n".repeat(50_000)).into_bytes(), 50_000),
        ("a.stl", format!("solid\n{}endsolid\n", facet.repeat(5_000)).into_bytes(), 5_000),
        ("b.stl", binary, 6000),
        ("a.ply", (head("ascii", 50_000) + "0 0 0\n1 0 0\n0 1 0\n" + &"3 0 1 2\n".repeat(50_000)).into(), 50_000),
        (
            "b.ply",
            [head("binary_little_endian", 21_000).as_bytes(), &values, &face.repeat(21_000), &padding].concat(),
            21_000,
        ),
    ] {
        let path = PathBuf::from(format!("/odd/{name}"));
        for allow_incomplete in [false, true] {
            let mut number = 0;
            loop {
                let strike = Strike::at(number);
                hold_source(&path, StruckSource::new(MemorySource::new(bytes.clone()), &strike));
                let options = MeshOptions { allow_incomplete, ..MeshOptions::default() };
                match read_all(std::slice::from_ref(&path), options) {
                    Ok((found, _)) if !strike.fell() => {
                        assert_eq!(found.len(), triangles, "{name}");
                        break;
                    }
                    Ok((found, notes)) => {
                        assert!(allow_incomplete && found.len() <= triangles, "{name}, {number}: {}", found.len());
                        let words = format!("{name}: incomplete: ");
                        let is_told = |note: &String| note.contains(&words) && note.contains(Strike::REASON);
                        assert!(notes.iter().any(is_told), "{name}, {number}: {notes:?}");
                    }
                    Err(error) => {
                        let text = error.to_string();
                        assert!(text.contains(name) && text.contains(Strike::REASON), "{name}, {number}: {text}");
                    }
                }
                number += 1;
            }
            assert!(number > 1, "{name}: {number} reads");
        }
    }
}

#[test]
fn a_file_that_is_gone_before_it_is_read_is_an_error() {
    for allow_incomplete in [false, true] {
        for name in ["a.obj", "a.ply", "a.stl", "a.gltf"] {
            let path = PathBuf::from(format!("/odd/{name}"));
            hold(&path, *b"any");
            let options = MeshOptions { allow_incomplete, ..MeshOptions::default() };
            let set = MeshSet::open(&[path], options, &NoMonitor).unwrap();
            release_sources();
            let error = set.feed().next(&mut Vec::new(), &NoMonitor).unwrap_err();
            assert!(matches!(error, Error::Io { .. }) && error.to_string().contains(name), "{error}");
        }
    }
}
