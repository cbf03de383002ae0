//! Clouds with colours and intensities in every format.
#![allow(dead_code, reason = "each test file uses a part")]

use super::write::{Pcd, Ply, Point, lzf};
use e57::{E57Writer, Record, RecordDataType, RecordName, RecordValue};
use std::fmt::Write as _;
use std::path::Path;

/// A point with red, green, blue and intensity in the range of LAS.
#[derive(Debug, Clone, Copy)]
pub struct Coloured {
    pub at: Point,
    pub rgb: [u16; 3],
    pub intensity: u16,
}

/// LAS of point format 2 with this scale.
pub fn las(path: &Path, points: &[Coloured], scale: f64) {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(2).unwrap();
    let axis = las::Transform { scale, offset: 0.0 };
    builder.transforms = las::Vector { x: axis, y: axis, z: axis };
    let mut writer = las::Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for Coloured { at: [x, y, z], rgb: [red, green, blue], intensity } in points.iter().copied() {
        let color = Some(las::Color { red, green, blue });
        writer.write_point(las::Point { x, y, z, intensity, color, ..Default::default() }).unwrap();
    }
    writer.close().unwrap();
}

/// Numbers in columns of colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Numbers {
    /// Whole numbers of 8 bits.
    Bytes,
    /// Whole numbers of 16 bits.
    Whole,
    /// 0 to 1, scaled from 65,535.
    Unit,
}

impl Numbers {
    fn of(self, value: u16) -> f64 {
        if self == Self::Unit { f64::from(value) / 65_535.0 } else { f64::from(value) }
    }
}

/// PLY with blue before red, and the intensity between them.
pub fn ply(points: &[Coloured], form: Ply, numbers: Numbers) -> Vec<u8> {
    let name = match form {
        Ply::Text => "ascii",
        Ply::Little => "binary_little_endian",
        Ply::Big => "binary_big_endian",
    };
    let kind = match numbers {
        Numbers::Bytes => "uchar",
        Numbers::Whole => "ushort",
        Numbers::Unit => "float",
    };
    let mut bytes = format!(
        "ply\nformat {name} 1.0\nelement vertex {}\nproperty {kind} blue\nproperty double x\nproperty double y\n\
         property float scalar_Intensity\nproperty double z\nproperty {kind} red\nproperty {kind} green\nend_header\n",
        points.len()
    )
    .into_bytes();
    for Coloured { at: [x, y, z], rgb, intensity } in points {
        let [r, g, b] = rgb.map(|value| numbers.of(value));
        if form == Ply::Text {
            bytes.extend(format!("{b} {x} {y} {intensity} {z} {r} {g}\n").bytes());
            continue;
        }
        let mut put = |mut number: Vec<u8>| {
            if form == Ply::Big {
                number.reverse();
            }
            bytes.extend(number);
        };
        let channel = |value: f64| match numbers {
            Numbers::Bytes => vec![value as u8],
            Numbers::Whole => (value as u16).to_le_bytes().to_vec(),
            Numbers::Unit => (value as f32).to_le_bytes().to_vec(),
        };
        put(channel(b));
        [x, y].into_iter().for_each(|v| put(v.to_le_bytes().to_vec()));
        put(f32::from(*intensity).to_le_bytes().to_vec());
        put(z.to_le_bytes().to_vec());
        [r, g].into_iter().for_each(|v| put(channel(v)));
    }
    bytes
}

/// PCD with the colour packed in one number, whose upper byte is `alpha`.
pub fn pcd(points: &[Coloured], form: Pcd, float: bool) -> Vec<u8> {
    let name = match form {
        Pcd::Text => "ascii",
        Pcd::Binary => "binary",
        Pcd::Packed => "binary_compressed",
    };
    let (field, kind) = if float { ("rgb", "F") } else { ("rgba", "U") };
    let count = points.len();
    let mut bytes = format!(
        "VERSION 0.7\nFIELDS {field} x y z intensity\nSIZE 4 4 4 4 4\nTYPE {kind} F F F F\nCOUNT 1 1 1 1 1\nWIDTH {count}\n\
         HEIGHT 1\nPOINTS {count}\nDATA {name}\n"
    )
    .into_bytes();
    let packed = |point: &Coloured| {
        let [r, g, b] = point.rgb.map(u32::from);
        (if float { 0 } else { 0xFF00_0000 }) | r << 16 | g << 8 | b
    };
    let record = |point: &Coloured| {
        let [x, y, z] = point.at.map(|v| (v as f32).to_le_bytes());
        [packed(point).to_le_bytes(), x, y, z, f32::from(point.intensity).to_le_bytes()]
    };
    match form {
        Pcd::Text => points.iter().for_each(|point| {
            let [x, y, z] = point.at;
            let colour = if float { f32::from_bits(packed(point)).to_string() } else { packed(point).to_string() };
            bytes.extend(format!("{colour} {x} {y} {z} {}\n", point.intensity).bytes());
        }),
        Pcd::Binary => points.iter().for_each(|point| bytes.extend(record(point).as_flattened())),
        Pcd::Packed => {
            let column = |field: usize| points.iter().flat_map(move |point| record(point)[field]);
            let plain: Vec<u8> = (0..5).flat_map(column).collect();
            let packed = lzf(&plain);
            bytes.extend((packed.len() as u32).to_le_bytes());
            bytes.extend((plain.len() as u32).to_le_bytes());
            bytes.extend(packed);
        }
    }
    bytes
}

/// Rows of x, y, z, intensity, red, green, blue.
pub fn rows(points: &[Coloured], separator: &str, colours: Numbers, intensities: Numbers) -> String {
    let mut text = String::new();
    for Coloured { at, rgb, intensity } in points {
        let numbers = at.iter().copied().chain([intensities.of(*intensity)]).chain(rgb.map(|value| colours.of(value)));
        let words: Vec<String> = numbers.map(|number| number.to_string()).collect();
        writeln!(text, "{}", words.join(separator)).unwrap();
    }
    text
}

/// PTS; `signed` intensities are those of Cyclone.
pub fn pts(points: &[Coloured], signed: bool) -> String {
    let mut text = format!("{}\n", points.len());
    for Coloured { at: [x, y, z], rgb: [r, g, b], intensity } in points {
        let intensity = if signed { i32::from(*intensity) - 2048 } else { i32::from(*intensity) };
        writeln!(text, "{x} {y} {z} {intensity} {r} {g} {b}").unwrap();
    }
    text
}

/// PTX of two clouds, the second without colours, with a pixel without a return.
pub fn ptx(clouds: [&[Coloured]; 2]) -> String {
    let mut text = String::new();
    for (number, points) in clouds.into_iter().enumerate() {
        let count = points.len() + 1;
        writeln!(text, "{count}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1").unwrap();
        for Coloured { at: [x, y, z], rgb: [r, g, b], intensity } in points {
            write!(text, "{x} {y} {z} {}", Numbers::Unit.of(*intensity)).unwrap();
            writeln!(text, "{}", if number == 0 { format!(" {r} {g} {b}") } else { String::new() }).unwrap();
        }
        writeln!(text, "0 0 0 0.5").unwrap();
    }
    text
}

/// A cloud of an E57.
#[derive(Debug, Clone, Copy)]
pub struct Cloud<'a> {
    pub points: &'a [Coloured],
    /// Red, green and blue; absent if `None`.
    pub colours: Option<Numbers>,
    pub intensities: Option<Numbers>,
    /// Follows every third point by one at the same place whose colour and intensity are marked invalid.
    pub invalid: bool,
}

/// E57 of clouds; the stated limits match the columns.
pub fn e57(path: &Path, clouds: &[Cloud<'_>]) {
    let mut writer = E57Writer::from_file(path, "{00000000-0000-0000-0000-000000000003}").unwrap();
    for cloud in clouds {
        let record = |name, data_type| Record { name, data_type };
        let kind = |numbers| match numbers {
            Numbers::Bytes => RecordDataType::Integer { min: 0, max: 255 },
            Numbers::Whole => RecordDataType::Integer { min: 0, max: 65_535 },
            Numbers::Unit => RecordDataType::Single { min: Some(0.0), max: Some(1.0) },
        };
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut prototype: Vec<Record> = axes.map(|name| record(name, RecordDataType::F64)).to_vec();
        if let Some(numbers) = cloud.colours {
            let names = [RecordName::ColorRed, RecordName::ColorGreen, RecordName::ColorBlue];
            prototype.extend(names.map(|name| record(name, kind(numbers))));
            if cloud.invalid {
                prototype.push(record(RecordName::IsColorInvalid, RecordDataType::Integer { min: 0, max: 1 }));
            }
        }
        if let Some(numbers) = cloud.intensities {
            prototype.push(record(RecordName::Intensity, kind(numbers)));
            if cloud.invalid {
                prototype.push(record(RecordName::IsIntensityInvalid, RecordDataType::Integer { min: 0, max: 1 }));
            }
        }
        let mut points = writer.add_pointcloud("cloud", prototype).unwrap();
        let value = |numbers, value: u16| match numbers {
            Numbers::Unit => RecordValue::Single(numbers.of(value) as f32),
            _ => RecordValue::Integer(value.into()),
        };
        let mut put = |point: &Coloured, invalid: i64| {
            let mut values: Vec<RecordValue> = point.at.map(RecordValue::Double).to_vec();
            if let Some(numbers) = cloud.colours {
                values.extend(point.rgb.map(|v| value(numbers, v)));
                values.extend(cloud.invalid.then_some(RecordValue::Integer(invalid)));
            }
            if let Some(numbers) = cloud.intensities {
                values.push(value(numbers, point.intensity));
                values.extend(cloud.invalid.then_some(RecordValue::Integer(invalid)));
            }
            points.add_point(values).unwrap();
        };
        for (number, point) in cloud.points.iter().enumerate() {
            put(point, 0);
            if cloud.invalid && number % 3 == 2 {
                put(&Coloured { rgb: [9; 3], intensity: 99, ..*point }, 1);
            }
        }
        points.finalize().unwrap();
    }
    writer.finalize().unwrap();
}
