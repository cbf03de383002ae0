//! Mesh files of every format, written and read by hand.
#![allow(dead_code, reason = "each test file uses a part")]

use std::fmt::Write as _;
use std::path::Path;

pub type Triangle = [[f64; 3]; 3];

/// OBJ with shared corners, counted from the start.
pub fn write_obj(path: &Path, triangles: &[Triangle]) {
    let (corners, faces) = shared(triangles);
    let mut text = String::from("# a comment\nmtllib none.mtl\no thing\n");
    corners.iter().for_each(|[x, y, z]| writeln!(text, "v {x} {y} {z}").unwrap());
    faces.iter().for_each(|f| writeln!(text, "f {}/1 {}//2 {}/1/1", f[0] + 1, f[1] + 1, f[2] + 1).unwrap());
    std::fs::write(path, text).unwrap();
}

/// Encodings of a PLY file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ply {
    Text,
    Little,
    Big,
}

/// PLY with shared corners as `double`, and an additional property and element.
pub fn write_ply(path: &Path, triangles: &[Triangle], form: Ply) {
    let (corners, faces) = shared(triangles);
    let name = match form {
        Ply::Text => "ascii",
        Ply::Little => "binary_little_endian",
        Ply::Big => "binary_big_endian",
    };
    let mut bytes = format!(
        "ply\nformat {name} 1.0\ncomment made by hand\nelement camera 1\nproperty list uchar short place\n\
         element vertex {}\nproperty double x\nproperty float confidence\nproperty double y\nproperty double z\n\
         element face {}\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n",
        corners.len(),
        faces.len()
    )
    .into_bytes();
    if form == Ply::Text {
        bytes.extend(b"2 7 -8\n");
        corners.iter().for_each(|[x, y, z]| bytes.extend(format!("{x} 0.5 {y} {z}\n").bytes()));
        faces.iter().for_each(|f| bytes.extend(format!("9 3 {} {} {}\n", f[0], f[1], f[2]).bytes()));
    } else {
        let mut put = |mut number: Vec<u8>| {
            if form == Ply::Big {
                number.reverse();
            }
            bytes.extend(number);
        };
        put(vec![2]);
        [7i16, -8].iter().for_each(|v| put(v.to_le_bytes().to_vec()));
        for [x, y, z] in corners {
            put(x.to_le_bytes().to_vec());
            put(0.5f32.to_le_bytes().to_vec());
            [y, z].iter().for_each(|v| put(v.to_le_bytes().to_vec()));
        }
        for face in faces {
            [9, 3].iter().for_each(|&v| put(vec![v]));
            face.iter().for_each(|v| put((*v as i32).to_le_bytes().to_vec()));
        }
    }
    std::fs::write(path, bytes).unwrap();
}

/// STL; coordinates become `f32`.
pub fn write_stl(path: &Path, triangles: &[Triangle], text: bool) {
    if text {
        let mut out = String::from("solid thing\n");
        for triangle in triangles {
            out += " facet normal 0 0 0\n  outer loop\n";
            triangle.iter().for_each(|[x, y, z]| writeln!(out, "   vertex {x} {y} {z}").unwrap());
            out += "  endloop\n endfacet\n";
        }
        out += "endsolid thing\n";
        return std::fs::write(path, out).unwrap();
    }
    // A header as some programs write it, which looks like the text form.
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, b' ');
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for triangle in triangles {
        bytes.extend([0; 12]);
        triangle.iter().flatten().for_each(|&v| bytes.extend((v as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    std::fs::write(path, bytes).unwrap();
}

/// `f32` corners of the triangles, in sequence.
pub fn buffer(triangles: &[Triangle]) -> Vec<u8> {
    triangles.iter().flatten().flatten().flat_map(|&v| (v as f32).to_le_bytes()).collect()
}

/// The structure of a glTF file with one mesh without indices on the given nodes; `source` is empty or `,"uri":"..."`.
pub fn structure(corners: usize, source: &str, nodes: &str, roots: &str) -> String {
    let bytes = corners * 12;
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":{roots}}}],"nodes":{nodes},
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{corners},"type":"VEC3",
        "min":[-1e9,-1e9,-1e9],"max":[1e9,1e9,1e9]}}],
        "bufferViews":[{{"buffer":0,"byteLength":{bytes}}}],"buffers":[{{"byteLength":{bytes}{source}}}]}}"#
    )
}

/// A `.glb` file of a structure and a buffer.
pub fn write_glb(path: &Path, structure: &str, buffer: &[u8]) {
    let mut json = structure.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let whole = 12 + 8 + json.len() + 8 + buffer.len();
    [2, whole as u32, json.len() as u32].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((buffer.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(buffer);
    std::fs::write(path, bytes).unwrap();
}

/// Distinct corners, and triangles by their indices.
fn shared(triangles: &[Triangle]) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let mut numbers = std::collections::BTreeMap::new();
    let mut corners = Vec::new();
    let faces = triangles.iter().map(|triangle| {
        triangle.map(|corner| {
            *numbers.entry(corner.map(f64::to_bits)).or_insert_with(|| {
                corners.push(corner);
                corners.len() - 1
            })
        })
    });
    let faces = faces.collect();
    (corners, faces)
}

/// Triangles of an OBJ file of convex faces or a text PLY file of triangles, read independently of the code under test.
pub fn read(path: &Path) -> Vec<Triangle> {
    let text = std::fs::read_to_string(path).unwrap();
    let numbers = |line: &str| line.split_whitespace().filter_map(|v| v.parse().ok()).collect::<Vec<f64>>();
    let (mut corners, mut faces): (Vec<[f64; 3]>, Vec<[usize; 3]>) = Default::default();
    if let Some((head, body)) = text.split_once("end_header\n") {
        let count: usize = head.lines().find_map(|l| l.strip_prefix("element vertex ")?.trim().parse().ok()).unwrap();
        for (n, line) in body.lines().map(numbers).enumerate().filter(|(_, line)| !line.is_empty()) {
            match n < count {
                true => corners.push([line[0], line[1], line[2]]),
                false => faces.push([1, 2, 3].map(|k| line[k] as usize)),
            }
        }
    }
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("v ") {
            corners.push(numbers(rest)[..3].try_into().unwrap());
        } else if let Some(rest) = line.strip_prefix("f ") {
            let all: Vec<usize> =
                rest.split_whitespace().map(|w| w.split('/').next().unwrap().parse::<usize>().unwrap() - 1).collect();
            // Convex faces become fans.
            faces.extend(all[1..].windows(2).map(|pair| [all[0], pair[0], pair[1]]));
        }
    }
    faces.iter().map(|face| face.map(|n| corners[n])).collect()
}
