//! Writers of every format, written from the descriptions of the formats alone.

use image_webp::{ColorType, WebPEncoder};
use slicewalk_splat::Splat;
use std::io::Write;

const SH: f64 = 0.282_094_791_773_878_14;

/// Seeded random numbers (xorshift).
pub struct Random(pub u64);

impl Random {
    pub fn word(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    pub fn below(&mut self, most: usize) -> usize {
        (self.word() >> 11) as usize % most.max(1)
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * ((self.word() >> 11) as f64 / (1u64 << 53) as f64)
    }
}

pub fn random_splats(count: usize, seed: u64) -> Vec<Splat> {
    let mut random = Random(seed * 2 + 0x9E37_79B9);
    let mut splat = || {
        let q: [f64; 4] = std::array::from_fn(|_| random.between(-1.0, 1.0));
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        Splat {
            mean: std::array::from_fn(|_| f64::from(random.between(-10.0, 10.0) as f32)),
            scale: std::array::from_fn(|_| random.between(-4.0, 0.0).exp() as f32),
            rotation: q.map(|v| (v / length) as f32),
            opacity: random.between(0.05, 0.95) as f32,
            colour: std::array::from_fn(|_| random.below(256) as u8),
        }
    };
    (0..count).map(|_| splat()).collect()
}

#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Text,
    Little,
    Big,
}

pub fn half(value: f64) -> u16 {
    let bits = (value as f32).to_bits();
    let (sign, exponent, fraction) = ((bits >> 16) & 0x8000, (bits >> 23) & 0xFF, bits & 0x7F_FFFF);
    if exponent < 113 { sign as u16 } else { (sign | ((exponent - 112) << 10) | (fraction >> 13)) as u16 }
}

fn logit(opacity: f32) -> f64 {
    let p = f64::from(opacity);
    (p / (1.0 - p)).ln()
}

fn wave(colour: u8) -> f64 {
    (f64::from(colour) / 255.0 - 0.5) / SH
}

/// 3DGS PLY; `number` is half, float or double; `rest` coefficients of higher harmonics follow the colour.
pub fn ply(splats: &[Splat], kind: Kind, number: &str, rest: usize) -> Vec<u8> {
    let format = ["ascii", "binary_little_endian", "binary_big_endian"][kind as usize];
    let mut out = format!("ply\nformat {format} 1.0\ncomment a test\nelement vertex {}\n", splats.len()).into_bytes();
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).into();
    names.extend((0..3).map(|n| format!("f_dc_{n}")));
    names.extend((0..rest).map(|n| format!("f_rest_{n}")));
    names.push("opacity".into());
    names.extend((0..3).map(|n| format!("scale_{n}")));
    names.extend((0..4).map(|n| format!("rot_{n}")));
    names.iter().for_each(|name| out.extend(format!("property {number} {name}\n").bytes()));
    out.extend(b"end_header\n");
    for s in splats {
        let mut row: Vec<f64> = s.mean.to_vec();
        row.extend([0.0; 3]);
        row.extend(s.colour.map(wave));
        row.extend(vec![0.25; rest]);
        row.push(logit(s.opacity));
        row.extend(s.scale.map(|v| f64::from(v).ln()));
        row.extend(s.rotation.map(f64::from));
        if kind == Kind::Text {
            let words: Vec<String> = row.iter().map(f64::to_string).collect();
            out.extend(words.join(" ").bytes());
            out.push(b'\n');
            continue;
        }
        for value in row {
            let mut bytes = match number {
                "half" => half(value).to_le_bytes().to_vec(),
                "float" => (value as f32).to_le_bytes().to_vec(),
                _ => value.to_le_bytes().to_vec(),
            };
            if kind == Kind::Big {
                bytes.reverse();
            }
            out.extend(bytes);
        }
    }
    out
}

fn share(value: f64, [least, most]: [f64; 2], steps: u32) -> u32 {
    let span = most - least;
    if span > 0.0 { ((value - least) / span * f64::from(steps)).round() as u32 } else { 0 }
}

/// Largest component made positive, and the place of it.
fn largest(rotation: [f32; 4]) -> (usize, [f64; 4]) {
    let place = (0..4).max_by(|a, b| rotation[*a].abs().total_cmp(&rotation[*b].abs())).unwrap();
    let sign = if rotation[place] < 0.0 { -1.0 } else { 1.0 };
    (place, rotation.map(|v| f64::from(v) * sign))
}

fn bounds(values: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    [values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max)].map(|v| f64::from(v as f32))
}

/// Compressed PLY of PlayCanvas, with bounds of colours and `rest` harmonics.
pub fn packed_ply(splats: &[Splat], colours: bool, rest: usize) -> Vec<u8> {
    let mut out = b"ply\nformat binary_little_endian 1.0\n".to_vec();
    out.extend(format!("element chunk {}\n", splats.len().div_ceil(256)).bytes());
    let axes = |head: &str| ["x", "y", "z"].map(|axis| format!("{head}_{axis}"));
    let mut names: Vec<String> = ["min", "max", "min_scale", "max_scale"].iter().flat_map(|head| axes(head)).collect();
    if colours {
        names.extend(["min", "max"].iter().flat_map(|head| ["r", "g", "b"].map(|c| format!("{head}_{c}"))));
    }
    names.iter().for_each(|name| out.extend(format!("property float {name}\n").bytes()));
    out.extend(format!("element vertex {}\n", splats.len()).bytes());
    for name in ["position", "rotation", "scale", "color"] {
        out.extend(format!("property uint packed_{name}\n").bytes());
    }
    if rest > 0 {
        out.extend(format!("element sh {}\n", splats.len()).bytes());
        (0..rest).for_each(|n| out.extend(format!("property uchar f_rest_{n}\n").bytes()));
    }
    out.extend(b"end_header\n");
    let mut rows = Vec::new();
    for chunk in splats.chunks(256) {
        let mean = [0, 1, 2].map(|axis| bounds(chunk.iter().map(|s| s.mean[axis])));
        let scale = [0, 1, 2].map(|axis| bounds(chunk.iter().map(|s| f64::from(s.scale[axis]).ln())));
        let tint = match colours {
            true => [0, 1, 2].map(|c| bounds(chunk.iter().map(|s| f64::from(s.colour[c]) / 255.0))),
            false => [[0.0, 1.0]; 3],
        };
        for group in [mean, scale].iter().chain(colours.then_some(&tint)) {
            for side in 0..2 {
                group.iter().for_each(|axis| out.extend((axis[side] as f32).to_le_bytes()));
            }
        }
        for s in chunk {
            let three = |values: [f64; 3], bounds: [[f64; 2]; 3]| {
                share(values[0], bounds[0], 2047) << 21
                    | share(values[1], bounds[1], 1023) << 11
                    | share(values[2], bounds[2], 2047)
            };
            let (place, q) = largest(s.rotation);
            let mut word = place as u32;
            for value in (0..4).filter(|n| *n != place).map(|n| q[n]) {
                word = word << 10 | ((value / 2f64.sqrt() + 0.5) * 1023.0).round() as u32;
            }
            let mut shade = 0;
            for (colour, bounds) in s.colour.iter().zip(tint) {
                shade = shade << 8 | share(f64::from(*colour) / 255.0, bounds, 255);
            }
            shade = shade << 8 | (s.opacity * 255.0).round() as u32;
            let scales = s.scale.map(|v| f64::from(v).ln());
            for word in [three(s.mean, mean), word, three(scales, scale), shade] {
                rows.extend(word.to_le_bytes());
            }
        }
    }
    out.extend(rows);
    out.extend(vec![128; rest * splats.len()]);
    out
}

/// SPZ without compression (`packed` false), else gzip, or zstd from version 4 on.
pub fn spz(splats: &[Splat], version: u32, degree: u8, packed: bool) -> Vec<u8> {
    let mut columns: Vec<Vec<u8>> = vec![Vec::new(); 6];
    for s in splats {
        for v in s.mean {
            match version {
                1 => columns[0].extend(half(v).to_le_bytes()),
                _ => columns[0].extend(&((v * 4096.0).round() as i32).to_le_bytes()[..3]),
            }
        }
        columns[1].push((s.opacity * 255.0).round() as u8);
        columns[2].extend(s.colour.map(|c| ((wave(c) * 0.15 + 0.5) * 255.0).round().clamp(0.0, 255.0) as u8));
        columns[3].extend(s.scale.map(|v| ((f64::from(v).ln() + 10.0) * 16.0).round() as u8));
        let [w, x, y, z] = s.rotation;
        if version > 2 {
            let (place, q) = largest([x, y, z, w]);
            let mut word = place as u32;
            for v in (0..4).filter(|n| *n != place).map(|n| q[n]) {
                let size = (v.abs() / 0.5f64.sqrt() * 511.0).round() as u32;
                word = word << 10 | u32::from(v < 0.0) << 9 | size;
            }
            columns[4].extend(word.to_le_bytes());
        } else {
            let sign = if w < 0.0 { -1.0 } else { 1.0 };
            columns[4].extend([x, y, z].map(|v| ((v * sign + 1.0) * 127.5).round() as u8));
        }
        columns[5].extend(vec![128; [0, 9, 24, 45, 72][usize::from(degree)]]);
    }
    columns.retain(|column| !column.is_empty());
    let mut out = b"NGSP".to_vec();
    out.extend(version.to_le_bytes());
    out.extend((splats.len() as u32).to_le_bytes());
    out.extend([degree, 12, 0, if version > 3 { columns.len() as u8 } else { 0 }]);
    if version > 3 {
        out.extend(32u32.to_le_bytes());
        out.extend([0; 12]);
        let streams: Vec<Vec<u8>> = columns.iter().map(|c| zstd::encode_all(&c[..], 3).unwrap()).collect();
        for (stream, column) in streams.iter().zip(&columns) {
            out.extend((stream.len() as u64).to_le_bytes());
            out.extend((column.len() as u64).to_le_bytes());
        }
        out.extend(streams.concat());
        return out;
    }
    out.extend(columns.concat());
    if !packed {
        return out;
    }
    gzip(&out)
}

pub fn splat(splats: &[Splat]) -> Vec<u8> {
    let mut out = Vec::new();
    for s in splats {
        s.mean.iter().for_each(|v| out.extend((*v as f32).to_le_bytes()));
        s.scale.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(s.colour);
        out.push((s.opacity * 255.0).round() as u8);
        out.extend(s.rotation.map(|v| (v * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8));
    }
    out
}

/// `.ksplat` with one section; buckets of four splats, the last one partly filled.
pub fn ksplat(splats: &[Splat], level: u16, degree: u16) -> Vec<u8> {
    const BUCKET: usize = 4;
    const BLOCK: f64 = 40.0;
    let (full, partial) = (splats.len() / BUCKET, usize::from(!splats.len().is_multiple_of(BUCKET)));
    let buckets = if level == 0 { 0 } else { full + partial };
    let mut header = vec![0; 4096 + 1024];
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    let count = (splats.len() as u32).to_le_bytes();
    put(1, &[1]);
    put(4, &1u32.to_le_bytes());
    put(8, &1u32.to_le_bytes());
    put(12, &count);
    put(16, &count);
    put(20, &level.to_le_bytes());
    put(4096, &count);
    put(4100, &count);
    put(4104, &(BUCKET as u32).to_le_bytes());
    put(4108, &(buckets as u32).to_le_bytes());
    put(4112, &(BLOCK as f32).to_le_bytes());
    put(4116, &12u16.to_le_bytes());
    if level > 0 {
        put(4128, &(full as u32).to_le_bytes());
        put(4132, &(partial as u32).to_le_bytes());
    }
    put(4136, &degree.to_le_bytes());
    let mut out = header;
    if level > 0 && partial > 0 {
        out.extend(((splats.len() % BUCKET) as u32).to_le_bytes());
    }
    let centre = |bucket: usize| [(bucket % 8) as f64, -1.0, 2.0];
    (0..buckets).flat_map(centre).for_each(|v| out.extend((v as f32).to_le_bytes()));
    for (number, s) in splats.iter().enumerate() {
        let float =
            |v: f64| if level == 0 { (v as f32).to_le_bytes().to_vec() } else { half(v).to_le_bytes().to_vec() };
        for axis in 0..3 {
            let step = (s.mean[axis] - centre(number / BUCKET)[axis]) / (BLOCK / 2.0 / 32767.0) + 32767.0;
            match level {
                0 => out.extend((s.mean[axis] as f32).to_le_bytes()),
                _ => out.extend((step.round() as u16).to_le_bytes()),
            }
        }
        s.scale.iter().chain(&s.rotation).for_each(|v| out.extend(float(f64::from(*v))));
        out.extend(s.colour);
        out.push((s.opacity * 255.0).round() as u8);
        out.extend(vec![0; [0, 9, 24][usize::from(degree)] * [4, 2, 1][usize::from(level)]]);
    }
    out
}

pub fn webp(pixels: &[[u8; 4]]) -> Vec<u8> {
    image(pixels.as_flattened(), 4, ColorType::Rgba8)
}

/// An image without alpha.
pub fn webp_rgb(pixels: &[[u8; 3]]) -> Vec<u8> {
    image(pixels.as_flattened(), 3, ColorType::Rgb8)
}

fn image(pixels: &[u8], channels: usize, kind: ColorType) -> Vec<u8> {
    let count = pixels.len() / channels;
    let width = count.isqrt().max(1);
    let height = count.div_ceil(width).max(1);
    let mut bytes = pixels.to_vec();
    bytes.resize(width * height * channels, 0);
    let mut out = Vec::new();
    WebPEncoder::new(&mut out).encode(&bytes, width as u32, height as u32, kind).unwrap();
    out
}

/// The files of SOG, `meta.json` first.
pub fn sog(splats: &[Splat], version: u32) -> Vec<(String, Vec<u8>)> {
    let log = |v: f64| v.signum() * (v.abs() + 1.0).ln();
    let all = |f: &dyn Fn(&Splat) -> f64| bounds(splats.iter().map(f));
    let mean = [0, 1, 2].map(|axis| all(&|s| log(s.mean[axis])));
    let scale = [0, 1, 2].map(|axis| all(&|s| f64::from(s.scale[axis]).ln()));
    let tint = [0, 1, 2].map(|c| all(&|s| wave(s.colour[c])));
    let odds = all(&|s| logit(s.opacity));
    let table = |least: f64, most: f64| -> Vec<f64> {
        (0..256).map(|n| least + (most - least) * f64::from(n) / 255.0).collect()
    };
    let mut images: [Vec<[u8; 4]>; 5] = Default::default();
    for s in splats {
        let steps = [0, 1, 2].map(|axis| share(log(s.mean[axis]), mean[axis], 65_535) as u16);
        images[0].push([steps[0] as u8, steps[1] as u8, steps[2] as u8, 255]);
        images[1].push([(steps[0] >> 8) as u8, (steps[1] >> 8) as u8, (steps[2] >> 8) as u8, 255]);
        let (place, q) = largest(s.rotation);
        let small: Vec<u8> =
            (0..4).filter(|n| *n != place).map(|n| ((q[n] * 2f64.sqrt() + 1.0) * 127.5).round() as u8).collect();
        images[2].push([small[0], small[1], small[2], 252 + place as u8]);
        let (sizes, colours) = match version {
            1 => (scale, tint),
            _ => ([[-5.0, 1.0]; 3], [[-2.0, 2.0]; 3]),
        };
        let size = [0, 1, 2].map(|a| share(f64::from(s.scale[a]).ln(), sizes[a], 255) as u8);
        let colour = [0, 1, 2].map(|c| share(wave(s.colour[c]), colours[c], 255) as u8);
        let opacity = match version {
            1 => share(logit(s.opacity), odds, 255) as u8,
            _ => (s.opacity * 255.0).round() as u8,
        };
        images[3].push([size[0], size[1], size[2], 255]);
        images[4].push([colour[0], colour[1], colour[2], opacity]);
    }
    let side = |bounds: &[[f64; 2]], side: usize| bounds.iter().map(|b| b[side]).collect::<Vec<f64>>();
    let colours = [&tint[..], &[odds]].concat();
    let means =
        format!("\"mins\":{:?},\"maxs\":{:?},\"files\":[\"l.webp\",\"u.webp\"]", side(&mean, 0), side(&mean, 1));
    let count = splats.len();
    let meta = match version {
        1 => format!(
            "{{\"means\":{{\"shape\":[{count},3],\"dtype\":\"float32\",{means}}},\"scales\":{{\"mins\":{:?},\"maxs\":{:?},\
             \"files\":[\"s.webp\"]}},\"quats\":{{\"files\":[\"q.webp\"]}},\"sh0\":{{\"mins\":{:?},\"maxs\":{:?},\
             \"files\":[\"c.webp\"]}}}}",
            side(&scale, 0),
            side(&scale, 1),
            side(&colours, 0),
            side(&colours, 1)
        ),
        _ => format!(
            "{{\"version\":2,\"count\":{count},\"means\":{{{means}}},\"scales\":{{\"codebook\":{:?},\"files\":[\"s.webp\"]}},\
             \"quats\":{{\"files\":[\"q.webp\"]}},\"sh0\":{{\"codebook\":{:?},\"files\":[\"c.webp\"]}}}}",
            table(-5.0, 1.0),
            table(-2.0, 2.0)
        ),
    };
    let names = ["l.webp", "u.webp", "q.webp", "s.webp", "c.webp"];
    let images = names.iter().zip(&images).map(|(name, pixels)| (name.to_string(), webp(pixels)));
    [("meta.json".to_owned(), meta.into_bytes())].into_iter().chain(images).collect()
}

/// A zip of files, stored or deflated.
pub fn zip(files: &[(String, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let packed = match deflated {
            true => {
                let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::fast());
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            false => bytes.clone(),
        };
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        let mut common = vec![20, 0, 0, 0, if deflated { 8 } else { 0 }, 0, 0, 0, 0, 0];
        for value in [crc.sum(), packed.len() as u32, bytes.len() as u32] {
            common.extend(value.to_le_bytes());
        }
        common.extend([name.len() as u8, 0, 0, 0]);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend((out.len() as u32).to_le_bytes());
        directory.extend(name.bytes());
        out.extend(b"PK\x03\x04");
        out.extend(common);
        out.extend(name.bytes());
        out.extend(packed);
    }
    let (at, count) = (out.len() as u32, files.len() as u8);
    out.extend(&directory);
    out.extend(b"PK\x05\x06\0\0\0\0");
    out.extend([count, 0, count, 0]);
    out.extend((directory.len() as u32).to_le_bytes());
    out.extend(at.to_le_bytes());
    out.extend([0, 0]);
    out
}

pub fn glb(json: &str, mut binary: Vec<u8>) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

/// GLB of attributes under a node that moves by (1, 2, 3).
pub fn gltf(splats: &[Splat]) -> Vec<u8> {
    let count = splats.len();
    let mut binary = Vec::new();
    let floats = |binary: &mut Vec<u8>, row: &dyn Fn(&Splat) -> Vec<f64>| {
        splats.iter().flat_map(row).for_each(|v| binary.extend((v as f32).to_le_bytes()));
    };
    floats(&mut binary, &|s| s.mean.to_vec());
    floats(&mut binary, &|s| [1, 2, 3, 0].map(|n| f64::from(s.rotation[n])).to_vec());
    floats(&mut binary, &|s| s.scale.map(|v| f64::from(v).ln()).to_vec());
    floats(&mut binary, &|s| vec![f64::from(s.opacity)]);
    floats(&mut binary, &|s| s.colour.map(wave).to_vec());
    let (mut views, mut accessors, mut at) = (Vec::new(), Vec::new(), 0);
    for (number, width) in [3, 4, 3, 1, 3].iter().enumerate() {
        let len = count * width * 4;
        views.push(format!("{{\"buffer\":0,\"byteOffset\":{at},\"byteLength\":{len}}}"));
        let kind = ["SCALAR", "", "VEC3", "VEC4"][width - 1];
        accessors
            .push(format!("{{\"bufferView\":{number},\"componentType\":5126,\"count\":{count},\"type\":\"{kind}\"}}"));
        at += len;
    }
    let name = "KHR_gaussian_splatting";
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"extensionsUsed\":[\"{name}\"],\"buffers\":[{{\"byteLength\":{at}}}],\
         \"bufferViews\":[{}],\"accessors\":[{}],\"nodes\":[{{\"mesh\":0,\"translation\":[1,2,3]}}],\
         \"meshes\":[{{\"primitives\":[{{\"mode\":0,\"attributes\":{{\"POSITION\":0,\"{name}:ROTATION\":1,\
         \"{name}:SCALE\":2,\"{name}:OPACITY\":3,\"{name}:SH_DEGREE_0_COEF_0\":4}},\
         \"extensions\":{{\"{name}\":{{\"kernel\":\"ellipse\",\"colorSpace\":\"srgb_rec709_display\"}}}}}}]}}]}}",
        views.join(","),
        accessors.join(",")
    );
    glb(&json, binary)
}

/// GLB with SPZ in a buffer view, without a node that moves it.
pub fn gltf_spz(splats: &[Splat], version: u32) -> Vec<u8> {
    let binary = spz(splats, version, 1, true);
    let (count, len, name) = (splats.len(), binary.len(), "KHR_gaussian_splatting");
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"extensionsUsed\":[\"{name}\"],\"buffers\":[{{\"byteLength\":{len}}}],\
         \"bufferViews\":[{{\"buffer\":0,\"byteLength\":{len}}}],\
         \"accessors\":[{{\"componentType\":5126,\"count\":{count},\"type\":\"VEC3\"}}],\
         \"nodes\":[{{\"mesh\":0}}],\"meshes\":[{{\"primitives\":[{{\"mode\":0,\"attributes\":{{\"POSITION\":0}},\
         \"extensions\":{{\"{name}\":{{\"extensions\":{{\"{name}_compression_spz\":{{\"bufferView\":0}}}}}}}}}}]}}]}}"
    );
    glb(&json, binary)
}

/// `bytes` with the first `from` replaced.
pub fn with(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|bytes| bytes == from.as_bytes());
    let at = at.unwrap_or_else(|| panic!("no {from}"));
    [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
}

/// `bytes` with others from `at` on.
pub fn put(bytes: &[u8], at: usize, new: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[at..at + new.len()].copy_from_slice(new);
    bytes
}

/// A GLB with the first `from` of its JSON replaced.
pub fn glb_with(old: &[u8], from: &str, to: &str) -> Vec<u8> {
    let len = u32::from_le_bytes(old[12..16].try_into().unwrap()) as usize;
    let json = String::from_utf8(with(&old[20..20 + len], from, to)).unwrap();
    let binary = old[28 + len..].to_vec();
    glb(json.trim_end(), binary)
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(bytes).unwrap();
    gzip.finish().unwrap()
}
