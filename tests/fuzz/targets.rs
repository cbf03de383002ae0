//! The fuzz targets as plain functions: any bytes in; a panic is a finding. The fuzzer and `tests/seeds.rs` call them.

use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader};
use slicewalk::codec::{ColourBlock, ColourEncoder, Decoder, Encoder};
use slicewalk::colour::ColourSource;
use slicewalk::frame::Frame;
use slicewalk::input::{InputOptions, InputSet, PointDecoder, quiet_decoder_panics};
use slicewalk::mesh::{MeshOptions, MeshSet};
use slicewalk::slice::{Occupancy, PageBuilder, Span};
use std::path::PathBuf;

/// Points and triangles after which reading ends: a few bytes may stand for billions.
const ENOUGH: usize = 1 << 20;

/// A target, by the name under which the fuzzer and the seeds know it.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: &[Target] = &[
    ("archive", archive),
    ("page", page),
    ("colours", colours),
    ("scan", scan),
    ("obj", |bytes| mesh("obj", bytes)),
    ("ply", |bytes| mesh("ply", bytes)),
    ("stl", |bytes| mesh("stl", bytes)),
    ("gltf", |bytes| mesh("gltf", bytes)),
    ("glb", |bytes| mesh("glb", bytes)),
    ("points", |bytes| read_scan("ply", bytes)),
    ("pcd", |bytes| read_scan("pcd", bytes)),
    ("xyz", |bytes| read_scan("xyz", bytes)),
    ("pts", |bytes| read_scan("pts", bytes)),
    ("ptx", |bytes| read_scan("ptx", bytes)),
    ("e57", e57),
    #[cfg(feature = "cli")]
    ("plan", plan),
];

/// Opens, verifies and reads any bytes as an archive with its overview levels, as they are and with the checksums of the head, of
/// the table of levels and of the footer put right.
pub fn archive(bytes: &[u8]) {
    read_archive(bytes.to_vec());
    if let Some(repaired) = repair(bytes) {
        read_archive(repaired);
    }
}

fn read_archive(bytes: Vec<u8>) {
    let Ok(archive) = Archive::from_bytes(bytes.clone()) else { return };
    let _ = archive.crs();
    let summary = archive.verify(&NoMonitor, &mut |_| ()).expect("nobody asks to stop");
    let sound = |archive: &Archive| archive.entries().all(|entry| entry.and_then(|entry| archive.page(&entry)).is_ok());
    assert!(sound(&archive) || summary.findings > 0, "verify finds what reading refuses");
    let with_colours = match ColourReader::new(&archive) {
        Ok(Some(mut reader)) => archive.entries().all(|entry| entry.and_then(|entry| reader.colours(&entry)).is_ok()),
        Ok(None) => true,
        Err(_) => false,
    };
    assert!(with_colours || summary.findings > 0, "verify finds the colours that reading refuses");
    let Ok(levels) = archive.levels() else {
        return assert!(summary.findings > 0, "verify finds a table of levels that reading refuses");
    };
    for level in levels {
        let range = level.bytes();
        let alone = bytes[range.start as usize..range.end as usize].to_vec();
        let alone = Archive::of_level(level, alone).expect("as many bytes as the level has");
        let sound = sound(&alone) && archive.level(level.number()).is_ok_and(|level| sound(&level));
        assert!(sound || summary.findings > 0, "verify finds what reading refuses of level {}", level.number());
    }
}

fn repair(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = bytes.to_vec();
    let len = bytes.len();
    let head_len = u32::from_le_bytes(bytes.get(12..16)?.try_into().ok()?) as usize;
    bytes.get_mut(32..40)?.copy_from_slice(&(len as u64).to_le_bytes());
    let end = head_len.checked_sub(4).filter(|_| head_len <= len)?;
    repair_levels(&mut bytes, head_len);
    repair_colours(&mut bytes, head_len);
    let crc = crc32c::crc32c(&bytes[..end]).to_le_bytes();
    bytes[end..head_len].copy_from_slice(&crc);
    let footer = len.checked_sub(24).filter(|&at| at >= head_len)?;
    bytes[footer..footer + 8].copy_from_slice(&(len as u64).to_le_bytes());
    bytes[footer + 8..footer + 12].copy_from_slice(&crc);
    let crc = crc32c::crc32c(&bytes[footer..footer + 12]).to_le_bytes();
    bytes[footer + 12..footer + 16].copy_from_slice(&crc);
    Some(bytes)
}

/// Puts the checksum of the table of levels right, if there is one.
fn repair_levels(bytes: &mut [u8], head_len: usize) -> Option<()> {
    let number = |at: usize, len: usize| {
        let bytes = bytes.get(at..at + len)?;
        Some(bytes.iter().rev().fold(0u64, |number, &byte| number << 8 | u64::from(byte)))
    };
    let (levels, pages_len, table_len) = (number(24, 1)? & 1, number(288, 8)?, number(336, 4)?);
    let end = (head_len as u64).checked_add(pages_len).filter(|&end| levels == 1 && end <= bytes.len() as u64)?;
    let start = end.checked_sub(table_len).filter(|&start| start >= head_len as u64)?;
    let crc = crc32c::crc32c(&bytes[start as usize..end as usize]).to_le_bytes();
    bytes.get_mut(340..344)?.copy_from_slice(&crc);
    Some(())
}

/// Puts the checksum of the table of colour leaves right, if there is one.
fn repair_colours(bytes: &mut [u8], head_len: usize) -> Option<()> {
    let number = |at: usize, len: usize| {
        let bytes = bytes.get(at..at + len)?;
        Some(bytes.iter().rev().fold(0u64, |number, &byte| number << 8 | u64::from(byte)))
    };
    let (features, pages_len, levels_len, leaves) = (number(24, 1)?, number(288, 8)?, number(328, 8)?, number(320, 4)?);
    let end = (head_len as u64).checked_add(pages_len)?.checked_sub(if features & 1 == 1 { levels_len } else { 0 })?;
    let end = Some(end).filter(|&end| features & 2 == 2 && end <= bytes.len() as u64)?;
    let start = end.checked_sub(12 * leaves).filter(|&start| start >= head_len as u64)?;
    let crc = crc32c::crc32c(&bytes[start as usize..end as usize]).to_le_bytes();
    bytes.get_mut(368..372)?.copy_from_slice(&crc);
    Some(())
}

/// Decodes any bytes as an encoded page; what decodes must encode to bytes that decode to the same page.
pub fn page(bytes: &[u8]) {
    let mut decoder = Decoder::default();
    if let (Ok(page), Ok(frame)) = (decoder.decode(bytes), Frame::new(0.05, 0.15)) {
        let mut again = Vec::new();
        Encoder::new(frame, 0).encode(&page, &mut again);
        assert_eq!(decoder.decode(&again).as_ref(), Ok(&page));
    }
}

/// Decodes any bytes as the colours of a page of walls and floor; what decodes must encode to bytes that decode to the same.
pub fn colours(bytes: &[u8]) {
    let mut builder = PageBuilder::default();
    for at in 0..40 * 40 {
        let (px, py) = (at % 40, at / 40);
        let top = if px % 9 == 0 { 4000 } else { 1000 + 8 * px };
        let span = Span::new(900, top, px % 9 == 0).expect("a span");
        assert!(builder.set_column(px, py, &[span]));
    }
    let occupancy = Occupancy::of(&builder.build());
    if let Ok(mut block) = ColourBlock::decode(bytes, &occupancy) {
        let (mut again, before) = (Vec::new(), block.clone());
        block.encode(&occupancy, &mut ColourEncoder::default(), &mut again);
        assert_eq!(ColourBlock::decode(&again, &occupancy), Ok(before));
    }
}

/// Opens any bytes as a LAS or LAZ file, as they are and behind a sound signature, and decodes what they seem to hold.
pub fn scan(bytes: &[u8]) {
    quiet_decoder_panics();
    read_scan("laz", bytes);
    let mut signed = bytes.to_vec();
    if signed.len() > 24 {
        signed[..4].copy_from_slice(b"LASF");
        signed[24] = 1;
        read_scan("laz", &signed);
    }
}

/// Opens any bytes as an E57, as they are and with the checksums of its pages put right.
pub fn e57(bytes: &[u8]) {
    read_scan("e57", bytes);
    let mut checked = bytes.to_vec();
    for page in checked.as_chunks_mut::<1024>().0 {
        let (content, stated) = page.split_at_mut(1020);
        stated.copy_from_slice(&crc32c::crc32c(content).to_be_bytes());
    }
    read_scan("e57", &checked);
}

/// Opens any bytes as a scan with this ending, and decodes what they seem to hold.
pub fn read_scan(ending: &str, bytes: &[u8]) {
    let file = File::new(ending, bytes);
    // Of formats that have some.
    let source = ColourSource::ALL[bytes.len() % 3];
    let options = InputOptions { colour: Some(source), ..InputOptions::default() };
    let Ok(set) = InputSet::open(std::slice::from_ref(&file.0), options, &NoMonitor) else { return };
    let mut decoder = PointDecoder::new();
    let mut points = 0;
    for chunk in set.chunks().take(64) {
        let decoded = decoder.decode(&set, &chunk, &mut |batch| {
            points += batch.len();
            assert!(batch.values.is_empty() || batch.values.len() == batch.len());
            assert!(batch.x.iter().chain(&batch.y).chain(&batch.z).all(|v| v.abs() <= 1e12));
            if points < ENOUGH { Ok(()) } else { Err(slicewalk::Error::Interrupted) }
        });
        if decoded.is_err() {
            return;
        }
    }
}

/// Reads any bytes as a mesh of the format that `ending` names.
pub fn mesh(ending: &str, bytes: &[u8]) {
    let file = File::new(ending, bytes);
    let options = MeshOptions { memory_bytes: 1 << 16, ..MeshOptions::default() };
    let Ok(set) = MeshSet::open(std::slice::from_ref(&file.0), options, &NoMonitor) else { return };
    let (mut feed, mut batch, mut triangles) = (set.feed(), Vec::new(), 0);
    while triangles < ENOUGH && feed.next(&mut batch, &NoMonitor).unwrap_or(false) {
        assert!(batch.as_flattened().as_flattened().iter().all(|v| v.abs() <= 1e12));
        triangles += batch.len().max(1);
    }
}

/// Reads any bytes as a plan; what is read must be written as text that reads as the same.
#[cfg(feature = "cli")]
pub fn plan(bytes: &[u8]) {
    use slicewalk::convert::PlanFile;
    let file = File::new("json", bytes);
    if let Ok(plan) = PlanFile::read(&file.0) {
        let again = File::new("json", plan.to_json().to_string().as_bytes());
        assert_eq!(PlanFile::read(&again.0).expect("it was written"), plan);
    }
}

/// A file of its own for each thread, which goes with this.
struct File(PathBuf);

impl File {
    fn new(ending: &str, bytes: &[u8]) -> Self {
        let name = format!("slicewalk-fuzz-{}-{:?}.{ending}", std::process::id(), std::thread::current().id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).expect("a folder to write to");
        Self(path)
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
