//! Meshes that no program writes: each is refused with one line that names the file and what is wrong with it, or read
//! without the colours that cannot be found, with a warning.

use base64::Engine;
use slicewalk_base::bytes::testing::hold;
use slicewalk_base::{Error, Monitor, Result, Warning};
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
        (r#""mesh":0"#, r#""mesh":3"#, "it names mesh 3, which does not exist"),
        (r#"[{"buffer":0"#, r#"[{"buffer":5"#, "there is no buffer 5"),
        (r#""POSITION":0"#, r#""POSITION":8"#, "it names accessor 8, which does not exist"),
        (r#""count":3,"type":"VEC3""#, r#""count":4,"type":"VEC3""#, "accessor 0"),
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
}

#[test]
fn odd_stls_are_refused() {
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
                endsolid a\n";
    assert_eq!(read("a.stl", text).unwrap().0.len(), 1);
    // On one line, a name may be missing.
    assert_eq!(read("a.stl", text.replace('\n', " ").replace("solid a ", "solid ")).unwrap().0.len(), 1);
    for (from, to, words) in [
        ("endloop", "vertex 1 1 0\nendloop", "a loop has more than 3 corners"),
        ("vertex 0 1 0\n", "", "a loop has 2 corners; expected 3"),
        ("endloop", "endfacet", "a loop ends without \"endloop\""),
        ("vertex 0 1 0\nendloop\nendfacet\nendsolid a\n", "vertex 0 1", "the file ends before \"endsolid\""),
        ("endsolid a\n", "", "the file ends before \"endsolid\""),
        ("vertex 1 0 0", "vertex 1 0 zero", "expected a number, found \"zero\""),
        ("outer loop", "inner loop", "expected a keyword of STL, found \"inner\""),
    ] {
        assert!(text.contains(from), "{from}");
        refuse("a.stl", text.replacen(from, to, 1), words);
    }
    refuse("a.stl", "solid a\nfacet ".to_owned() + &"a".repeat(1 << 21), "a word of more than 1048576 bytes");
    refuse("a.stl", "no", "expected at least 84 bytes or \"solid\", found 2");
}

#[test]
fn odd_plys_are_refused() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(read("a.ply", text).unwrap().0.len(), 1);
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let turned = text.replace(faces, "").replace("element vertex", &format!("{faces}element vertex"));
    refuse("a.ply", turned, "faces come before their corners");
    refuse("a.ply", text.replace("3 0 1 2", "3 0 1 9"), "9");
    refuse("a.ply", text.replace("0 1 0\n3 0 1 2\n", ""), "the file ends before the elements that its header states");
    refuse("a.ply", text.replace("float z", "float w"), "header");
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
        read_all(&path, MeshOptions { memory_bytes, temp_dir, ..MeshOptions::default() }).map(|read| read.0)
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
