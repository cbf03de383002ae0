//! Clouds in every format, written by hand or, for E57, by the crate `e57`.
#![allow(dead_code, reason = "each test file uses a part")]

use e57::{E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation};
use std::fmt::Write as _;
use std::path::Path;

pub type Point = [f64; 3];

/// Encoding of numbers in PLY.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ply {
    Text,
    Little,
    Big,
}

/// PLY with shuffled properties, two elements before the points and one after them. x is a `float`.
pub fn ply(points: &[Point], form: Ply) -> Vec<u8> {
    let name = match form {
        Ply::Text => "ascii",
        Ply::Little => "binary_little_endian",
        Ply::Big => "binary_big_endian",
    };
    let mut bytes = format!(
        "ply\r\nformat {name} 1.0\ncomment of no use\nobj_info none\nelement camera 2\nproperty list uchar short place\n\
         element sensor 1\nproperty double time\nelement vertex {}\nproperty uchar red\nproperty double z\n\
         property float x\nproperty int number\nproperty float64 y\nelement face 0\n\
         property list uchar int vertex_indices\nelement tail 1\nproperty int end\nend_header\n",
        points.len()
    )
    .into_bytes();
    if form == Ply::Text {
        bytes.extend(b"2 7 -8\n0\n12.5\n");
        for (number, [x, y, z]) in points.iter().enumerate() {
            bytes.extend(format!("{} {z} {x} {number} {y} \n", number % 256).bytes());
        }
        bytes.extend(b"77\n");
        return bytes;
    }
    let mut put = |number: &[u8]| match form {
        Ply::Big => bytes.extend(number.iter().rev()),
        _ => bytes.extend(number),
    };
    put(&[2]);
    [7i16, -8].iter().for_each(|v| put(&v.to_le_bytes()));
    put(&[0]);
    put(&12.5f64.to_le_bytes());
    for (number, [x, y, z]) in points.iter().enumerate() {
        put(&[number as u8]);
        put(&z.to_le_bytes());
        put(&(*x as f32).to_le_bytes());
        put(&(number as i32).to_le_bytes());
        put(&y.to_le_bytes());
    }
    put(&77i32.to_le_bytes());
    bytes
}

/// Encoding of points in PCD.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pcd {
    Text,
    Binary,
    Packed,
}

/// PCD with padding, a colour, and y in 8 bytes.
pub fn pcd(points: &[Point], form: Pcd) -> Vec<u8> {
    let name = match form {
        Pcd::Text => "ascii",
        Pcd::Binary => "binary",
        Pcd::Packed => "binary_compressed",
    };
    let count = points.len();
    let mut bytes = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x _ y rgb z\nSIZE 4 1 8 4 4\nTYPE F U F U F\n\
         COUNT 1 3 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {name}\n"
    )
    .into_bytes();
    let record = |[x, y, z]: Point| {
        [
            (x as f32).to_le_bytes().to_vec(),
            vec![1, 2, 3],
            y.to_le_bytes().to_vec(),
            0x00FF_8040u32.to_le_bytes().to_vec(),
            (z as f32).to_le_bytes().to_vec(),
        ]
    };
    match form {
        Pcd::Text => points.iter().for_each(|[x, y, z]| bytes.extend(format!("{x} 1 2 3 {y} 16744512 {z}\n").bytes())),
        Pcd::Binary => points.iter().for_each(|&point| bytes.extend(record(point).concat())),
        Pcd::Packed => {
            let columns = (0..5).flat_map(|field| points.iter().flat_map(move |&point| record(point)[field].clone()));
            let plain: Vec<u8> = columns.collect();
            let packed = lzf(&plain);
            bytes.extend((packed.len() as u32).to_le_bytes());
            bytes.extend((plain.len() as u32).to_le_bytes());
            bytes.extend(packed);
            bytes.extend([0; 100]);
        }
    }
    bytes
}

/// LZF: literals, and references to the last occurrence of the same three bytes.
pub fn lzf(plain: &[u8]) -> Vec<u8> {
    let (mut out, mut literals, mut at) = (Vec::new(), Vec::new(), 0);
    let mut last = std::collections::HashMap::new();
    let flush = |literals: &mut Vec<u8>, out: &mut Vec<u8>| {
        for piece in literals.chunks(32) {
            out.push(piece.len() as u8 - 1);
            out.extend(piece);
        }
        literals.clear();
    };
    while at < plain.len() {
        let key = plain.get(at..at + 3);
        let found = key.and_then(|key| last.insert(key.to_vec(), at)).filter(|&before| at - before <= 1 << 13);
        if let Some(before) = found {
            let most = (plain.len() - at).min(264);
            let len = (0..most).take_while(|&n| plain[before + n] == plain[at + n]).count();
            let back = at - before - 1;
            flush(&mut literals, &mut out);
            if len < 9 {
                out.extend([((len - 2) << 5 | back >> 8) as u8, back as u8]);
            } else {
                out.extend([(7 << 5 | back >> 8) as u8, (len - 9) as u8, back as u8]);
            }
            at += len;
        } else {
            literals.push(plain[at]);
            at += 1;
        }
    }
    flush(&mut literals, &mut out);
    out
}

/// Rows with this separator.
pub fn rows(points: &[Point], separator: &str) -> String {
    let mut text = String::new();
    points.iter().for_each(|[x, y, z]| writeln!(text, "{x}{separator}{y}{separator}{z}").unwrap());
    text
}

/// PTS: clouds of these points.
pub fn pts(clouds: &[&[Point]]) -> String {
    let mut text = String::new();
    for points in clouds {
        writeln!(text, "{}", points.len()).unwrap();
        points.iter().for_each(|[x, y, z]| writeln!(text, "{x} {y} {z} -512 10 20 30\r").unwrap());
    }
    text
}

/// PTX: clouds rotated by a quarter turn about z and shifted, which the matrix reverses, with a pixel without a return
/// after every tenth point.
pub fn ptx(clouds: &[&[Point]]) -> (String, u64) {
    let (mut text, mut absent) = (String::new(), 0);
    for points in clouds {
        let none = points.len() / 10;
        absent += none as u64;
        writeln!(
            text,
            "{}\n1\n4 8 0.5\n0 1 0\n-1 0 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n4 8 0.5 1",
            points.len() + none
        )
        .unwrap();
        for (number, [x, y, z]) in points.iter().enumerate() {
            // (a b c) · M = (-b + 4, a + 8, c + 0.5)
            writeln!(text, "{} {} {} 0.5 1 2 3", y - 8.0, 4.0 - x, z - 0.5).unwrap();
            if number % 10 == 9 {
                text.push_str("0 0 0 0.500000 0 0 0\n");
            }
        }
    }
    (text, absent)
}

/// PTX of clouds around their scanners, whose positions the headers state.
pub fn ptx_of_stations(clouds: &[(Point, Vec<Point>)]) -> String {
    let mut text = String::new();
    for ([a, b, c], points) in clouds {
        let count = points.len();
        writeln!(text, "{count}\n1\n{a} {b} {c}\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{a} {b} {c} 1")
            .unwrap();
        points.iter().for_each(|[x, y, z]| writeln!(text, "{} {} {} 0.5", x - a, y - b, z - c).unwrap());
    }
    text
}

/// E57 of clouds around their scanners, whose positions the poses state, with a half turn about z.
pub fn e57_of_stations(path: &Path, clouds: &[(Point, Vec<Point>)]) {
    let mut writer = E57Writer::from_file(path, "{00000000-0000-0000-0000-000000000002}").unwrap();
    for ([a, b, c], points) in clouds {
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let prototype = axes.map(|name| Record { name, data_type: RecordDataType::F64 }).to_vec();
        let mut cloud = writer.add_pointcloud("cloud", prototype).unwrap();
        let rotation = Quaternion { w: 0.0, x: 0.0, y: 0.0, z: 1.0 };
        cloud.set_transform(Some(Transform { rotation, translation: Translation { x: *a, y: *b, z: *c } }));
        for [x, y, z] in points {
            cloud.add_point([a - x, b - y, z - c].map(RecordValue::Double).to_vec()).unwrap();
        }
        cloud.finalize().unwrap();
    }
    writer.finalize().unwrap();
}

/// Encoding of coordinates in E57.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum E57 {
    Single,
    Double,
    /// Whole steps of 1/1024 in 17 bits, starting at -65,536.
    Scaled,
}

/// A cloud of an E57.
#[derive(Debug, Clone, Copy)]
pub struct Cloud<'a> {
    pub points: &'a [Point],
    pub form: E57,
    /// Whether it is rotated by a half turn about z and shifted, which its pose reverses.
    pub posed: bool,
    /// Whether every fifth point is followed by an invalid one, with colours and a constant column in between.
    pub mixed: bool,
}

/// E57 of these clouds.
pub fn e57(path: &Path, clouds: &[Cloud<'_>], system: Option<&str>) {
    let mut writer = E57Writer::from_file(path, "{00000000-0000-0000-0000-000000000001}").unwrap();
    writer.set_coordinate_metadata(system.map(str::to_owned));
    for (number, cloud) in clouds.iter().enumerate() {
        let kind = match cloud.form {
            E57::Single => RecordDataType::F32,
            E57::Double => RecordDataType::F64,
            E57::Scaled => {
                RecordDataType::ScaledInteger { min: -65_536, max: 65_535, scale: 1.0 / 1024.0, offset: 0.0 }
            }
        };
        let record = |name: RecordName, data_type: &RecordDataType| Record { name, data_type: data_type.clone() };
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut prototype: Vec<Record> = axes.into_iter().map(|name| record(name, &kind)).collect();
        if cloud.mixed {
            let few = |max| RecordDataType::Integer { min: 0, max };
            prototype.insert(1, Record::INTENSITY_U16);
            prototype.extend([Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8]);
            prototype.push(record(RecordName::CartesianInvalidState, &few(2)));
            prototype.push(record(RecordName::RowIndex, &few(0)));
        }
        let mut points = writer.add_pointcloud(&format!("cloud {number}"), prototype).unwrap();
        if cloud.posed {
            points.set_transform(Some(Transform {
                rotation: Quaternion { w: 0.0, x: 0.0, y: 0.0, z: 1.0 },
                translation: Translation { x: 2.0, y: -4.0, z: 0.25 },
            }));
        }
        let value = |v: f64| match cloud.form {
            E57::Single => RecordValue::Single(v as f32),
            E57::Double => RecordValue::Double(v),
            E57::Scaled => RecordValue::ScaledInteger((v * 1024.0).round() as i64),
        };
        let mut put = |[x, y, z]: Point, state: i64| {
            let mut values: Vec<RecordValue> = [x, y, z].into_iter().map(value).collect();
            if cloud.mixed {
                values.insert(1, RecordValue::Integer(777));
                values.extend([1, 2, 3, state, 0].map(RecordValue::Integer));
            }
            points.add_point(values).unwrap();
        };
        for (number, &[x, y, z]) in cloud.points.iter().enumerate() {
            put(if cloud.posed { [2.0 - x, -4.0 - y, z - 0.25] } else { [x, y, z] }, 0);
            if cloud.mixed && number % 5 == 4 {
                put([0.0, 1.0, 2.0], 1 + (number as i64 / 5) % 2);
            }
        }
        points.finalize().unwrap();
    }
    writer.finalize().unwrap();
}
