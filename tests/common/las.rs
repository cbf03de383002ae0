//! LAS and LAZ files made of a few records, to be damaged, and the results of reading them.
#![allow(dead_code, reason = "each test file uses a part")]

use crate::reading;
use laz::laszip::{ChunkTable, LazVlr};
use laz::{LasZipCompressor, LazVlrBuilder};
use slicewalk::Result;
use slicewalk_input::{InputOptions, PointCounts};
use std::path::{Path, PathBuf};

/// Result of reading a set of files.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Read {
    pub counts: PointCounts,
    pub points: Vec<[f64; 3]>,
    pub warnings: String,
}

impl Read {
    /// A sum over the bits of all coordinates in file order, like the reference script computes from laspy's arrays.
    pub fn sums(&self) -> [u64; 3] {
        [0, 1, 2]
            .map(|axis| self.points.iter().fold(0u64, |sum, p| sum.wrapping_mul(31).wrapping_add(p[axis].to_bits())))
    }

    pub fn sorted(&self) -> Vec<[u64; 3]> {
        let mut bits: Vec<_> = self.points.iter().map(|p| p.map(f64::to_bits)).collect();
        bits.sort_unstable();
        bits
    }
}

/// Reads as much as possible.
pub fn read(paths: &[PathBuf], options: InputOptions) -> Result<Read> {
    read_strictly(paths, InputOptions { allow_incomplete: true, ..options })
}

/// Reads everything, or fails.
pub fn read_strictly(paths: &[PathBuf], options: InputOptions) -> Result<Read> {
    let (points, counts, said) = reading::read(paths, options)?;
    assert!(said.iter().all(|line| !line.contains('\n')));
    Ok(Read { counts, points, warnings: said.join("\n") })
}

pub fn read_one(path: &Path) -> Result<Read> {
    read(&[path.to_path_buf()], InputOptions::default())
}

pub fn refusal(path: &Path) -> String {
    let outcome = read_strictly(&[path.to_path_buf()], InputOptions::default());
    let text = outcome.map(|read| read.counts).expect_err("should be refused").to_string();
    assert!(!text.contains('\n') && text.starts_with(path.to_str().unwrap()), "{text}");
    text
}

/// A scan to be written and then damaged.
#[derive(Clone)]
pub struct Scan {
    pub version: u8,
    pub format: u8,
    pub scale: f64,
    pub records: Vec<Vec<u8>>,
    pub vlrs: Vec<(&'static str, u16, Vec<u8>)>,
    pub evlrs: Vec<(&'static str, u16, Vec<u8>)>,
}

pub const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

impl Scan {
    pub fn new(version: u8, format: u8, points: u32) -> Self {
        let mut state = 0x1234_5678_9ABC_DEF1u64;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 33) as i32
        };
        let bytes = RECORD_BYTES[usize::from(format)];
        let records = (0..points as i32)
            .map(|i| {
                let mut record = vec![0u8; bytes];
                for (axis, raw) in [i * 7 + random() % 50, random() % 10_000, random() % 300].into_iter().enumerate() {
                    record[4 * axis..4 * axis + 4].copy_from_slice(&raw.to_le_bytes());
                }
                record[14] = 0x11; // return 1 of 1, in both layouts
                record[if format < 6 { 15 } else { 16 }] = (random() % 6) as u8;
                record
            })
            .collect();
        Self { version, format, scale: 0.01, records, vlrs: Vec::new(), evlrs: Vec::new() }
    }

    pub fn expected(&self) -> Vec<[f64; 3]> {
        let raw = |r: &[u8], a: usize| i32::from_le_bytes(r[4 * a..4 * a + 4].try_into().unwrap());
        self.records.iter().map(|r| [0, 1, 2].map(|a| f64::from(raw(r, a)) * self.scale + 100.0)).collect()
    }

    pub fn head(&self, compressed: bool, vlrs: &[(&str, u16, Vec<u8>)]) -> Vec<u8> {
        let header_bytes = [227, 227, 227, 235, 375, 393][usize::from(self.version)];
        let mut out = vec![0u8; header_bytes];
        let mut put = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        put(24, &[1, self.version]);
        put(94, &(header_bytes as u16).to_le_bytes());
        let points_at = header_bytes + vlrs.iter().map(|v| 54 + v.2.len()).sum::<usize>();
        put(96, &(points_at as u32).to_le_bytes());
        put(100, &(vlrs.len() as u32).to_le_bytes());
        put(104, &[self.format | if compressed { 0x80 } else { 0 }]);
        put(105, &(self.records.first().map_or(RECORD_BYTES[usize::from(self.format)], Vec::len) as u16).to_le_bytes());
        put(107, &(self.records.len() as u32).to_le_bytes());
        for axis in 0..3 {
            put(131 + 8 * axis, &self.scale.to_le_bytes());
            put(155 + 8 * axis, &100f64.to_le_bytes());
        }
        if self.version >= 4 {
            put(247, &(self.records.len() as u64).to_le_bytes());
        }
        for (user, id, body) in vlrs {
            let mut head = [0u8; 54];
            head[2..2 + user.len()].copy_from_slice(user.as_bytes());
            head[18..20].copy_from_slice(&id.to_le_bytes());
            head[20..22].copy_from_slice(&(body.len() as u16).to_le_bytes());
            out.extend(head);
            out.extend(body);
        }
        out
    }

    pub fn tail(&self, mut out: Vec<u8>) -> Vec<u8> {
        if !self.evlrs.is_empty() {
            let at = out.len() as u64;
            out[235..243].copy_from_slice(&at.to_le_bytes());
            out[243..247].copy_from_slice(&(self.evlrs.len() as u32).to_le_bytes());
        }
        for (user, id, body) in &self.evlrs {
            let mut head = [0u8; 60];
            head[2..2 + user.len()].copy_from_slice(user.as_bytes());
            head[18..20].copy_from_slice(&id.to_le_bytes());
            head[20..28].copy_from_slice(&(body.len() as u64).to_le_bytes());
            out.extend(head);
            out.extend(body);
        }
        out
    }

    pub fn las(&self) -> Vec<u8> {
        let mut out = self.head(false, &self.vlrs);
        out.extend(self.records.concat());
        self.tail(out)
    }

    pub fn vlr(&self, chunk: u32) -> LazVlr {
        let usual = RECORD_BYTES[usize::from(self.format)];
        let extra = self.records.first().map_or(0, |r| r.len() - usual) as u16;
        let builder = LazVlrBuilder::default().with_point_format(self.format, extra).unwrap();
        match chunk {
            0 => builder.with_variable_chunk_size().build(),
            n => builder.with_fixed_chunk_size(n).build(),
        }
    }

    /// LAZ with `chunk` points per chunk; 0 for chunks of 100, 300, 500 ... points.
    pub fn laz(&self, chunk: u32) -> Vec<u8> {
        let vlr = self.vlr(chunk);
        let mut body = Vec::new();
        vlr.write_to(&mut body).unwrap();
        let mut vlrs = vec![(LazVlr::USER_ID, LazVlr::RECORD_ID, body)];
        vlrs.extend(self.vlrs.iter().cloned());
        let mut file = std::io::Cursor::new(self.head(true, &vlrs));
        file.set_position(file.get_ref().len() as u64);
        let mut compressor = LasZipCompressor::new(file, vlr).unwrap();
        let (mut left, mut next) = (100, 300);
        for record in &self.records {
            if chunk == 0 && left == 0 {
                compressor.finish_current_chunk().unwrap();
                (left, next) = (next, next + 200);
            }
            left -= 1;
            compressor.compress_one(record).unwrap();
        }
        compressor.done().unwrap();
        self.tail(compressor.into_inner().into_inner())
    }
}

pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// Derives a field of a record from that of the previous one.
pub fn next_field(random: &mut impl FnMut() -> u64, field: &mut [u8], most_bits: u32) {
    let mut eight = [0; 8];
    eight[..field.len()].copy_from_slice(field);
    let before = u64::from_le_bytes(eight);
    let now = match random() % 8 {
        0..4 => before,
        4 | 5 => before.wrapping_add(random() % 9).wrapping_sub(4),
        6 => before.wrapping_add((random() % 1000) * 40),
        _ => random() >> (random() % 32),
    };
    field.copy_from_slice(&(now & ((1 << most_bits) - 1)).to_le_bytes()[..field.len()]);
}

/// Random records: extra bytes, scanner channels, times that jump, return numbers 0 to 15.
pub fn varied(format: u8, points: u32, extra: usize, random: &mut impl FnMut() -> u64) -> Scan {
    let mut scan = Scan::new(4, format, points);
    let bytes = RECORD_BYTES[usize::from(format)];
    // Ends of the fields after the coordinates, the last of which is a time.
    let (ends, time_at) = match format {
        0 | 2 => (vec![14, 15, 16, 17, 18, 20], None),
        0..6 => (vec![14, 15, 16, 17, 18, 20, 28], Some(20)),
        _ => (vec![14, 15, 16, 17, 18, 20, 22, 30], Some(22)),
    };
    let mut last = vec![0u8; bytes + extra];
    for record in &mut scan.records {
        let place: [u8; 12] = record[..12].try_into().unwrap();
        let (mut from, known) = (12, *ends.last().unwrap());
        for to in ends.iter().copied().chain(known + 1..=bytes + extra) {
            // `laz` computes differences of times as if they could not overflow.
            let bits = if time_at == Some(from) { 61 } else { 8 * (to - from) as u32 };
            next_field(random, &mut last[from..to], bits);
            from = to;
        }
        last[..12].copy_from_slice(&place);
        // `laz` computes differences of waveform positions in the same way.
        if let Some(packet) = [(4, 28), (5, 34), (9, 30), (10, 38)].iter().find(|packet| packet.0 == format) {
            last[packet.1 + 8] &= 0x3F;
        }
        record.clone_from(&last);
    }
    scan
}

/// Random numbers of 53 bits.
pub fn numbers(mut state: u64) -> impl FnMut() -> u64 {
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state >> 11
    }
}

/// Offsets of the chunks in a file of `Scan::laz`, and the end of the last one.
pub fn chunk_places(laz: &[u8], scan: &Scan, chunk: u32) -> Vec<usize> {
    let points_at = u64::from(u32::from_le_bytes(laz[96..100].try_into().unwrap()));
    let mut file = std::io::Cursor::new(laz);
    file.set_position(points_at);
    let table = ChunkTable::read_from(&mut file, &scan.vlr(chunk)).unwrap();
    let mut at = points_at as usize + 8;
    let ends = table.as_ref().iter().map(|entry| {
        at += entry.byte_count as usize;
        at
    });
    std::iter::once(points_at as usize + 8).chain(ends).collect()
}
