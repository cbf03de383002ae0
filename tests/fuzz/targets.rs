//! The fuzz targets as plain functions: any bytes in; a panic is a finding. The fuzzer and `tests/seeds.rs` call them. Each says what
//! it read, if it got to the end: tests see by that whether changed inputs get past all checks.

mod forged;
mod loader;
mod script;

pub use forged::forged;
pub use loader::loader;

use script::Script;
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader};
use slicewalk::codec::{ColourBlock, ColourEncoder, Decoder, Encoder};
use slicewalk::colour::ColourSource;
use slicewalk::frame::Frame;
use slicewalk::input::{InputOptions, InputSet, PointDecoder, quiet_decoder_panics};
use slicewalk::mesh::{MeshOptions, MeshSet};
use slicewalk::plan::Coding;
use slicewalk::slice::{Occupancy, Page, PageBuilder, Span};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

/// Points and triangles after which reading ends: a few bytes may stand for billions.
const ENOUGH: usize = 1 << 20;

/// A number that stands for all that was read; `None` where reading ended before.
pub type Read = Option<u64>;

/// A target, by the name under which the fuzzer and the seeds know it.
pub type Target = (&'static str, fn(&[u8]) -> Read);

fn digest(content: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    content.hash(&mut hasher);
    hasher.finish()
}

/// All targets.
pub const TARGETS: &[Target] = &[
    ("archive", archive),
    ("forged", forged),
    ("loader", loader),
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
pub fn archive(bytes: &[u8]) -> Read {
    let read = read_archive(bytes.to_vec());
    repair(bytes).map_or(read, read_archive)
}

fn read_archive(bytes: Vec<u8>) -> Read {
    let archive = Archive::from_bytes(bytes.clone()).ok()?;
    let mut said = (archive.crs().ok(), archive.units().ok(), archive.noise().ok().map(|noise| format!("{noise:?}")));
    let summary = archive.verify(&NoMonitor, &mut |_| ()).expect("nobody asks to stop");
    let sound = |archive: &Archive| {
        let mut hasher = DefaultHasher::new();
        let read = |entry: slicewalk::Result<_>| -> slicewalk::Result<()> {
            let entry = entry?;
            let page = archive.page(&entry)?;
            page.columns().for_each(|column| column.hash(&mut hasher));
            Ok(())
        };
        archive.entries().try_for_each(read).ok().map(|()| hasher.finish())
    };
    let pages = sound(&archive);
    assert!(pages.is_some() || summary.findings > 0, "verify finds what reading refuses");
    let mut coloured = 0;
    let with_colours = match ColourReader::new(&archive) {
        Ok(Some(mut reader)) => archive.entries().all(|entry| {
            let colours = entry.and_then(|entry| reader.colours(&entry));
            colours.inspect(|colours| coloured = digest((coloured, colours.values()))).is_ok()
        }),
        Ok(None) => true,
        Err(_) => false,
    };
    assert!(with_colours || summary.findings > 0, "verify finds the colours that reading refuses");
    let Ok(levels) = archive.levels() else {
        assert!(summary.findings > 0, "verify finds a table of levels that reading refuses");
        return None;
    };
    for level in levels {
        let range = level.bytes();
        let alone = bytes[range.start as usize..range.end as usize].to_vec();
        let alone = Archive::of_level(level, alone).expect("as many bytes as the level has");
        let sound = sound(&alone).is_some() && archive.level(level.number()).is_ok_and(|level| sound(&level).is_some());
        assert!(sound || summary.findings > 0, "verify finds what reading refuses of level {}", level.number());
    }
    said.0 = said.0.take().filter(|crs| !crs.is_empty());
    pages.map(|pages| digest((pages, coloured, format!("{said:?}"), archive.header().points_read)))
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

/// The page that a script says: columns of spans, as far as they can stand together.
fn page_of(script: &mut Script) -> Page {
    let mut builder = PageBuilder::default();
    for _ in 0..1 + script.below(64) {
        if script.is_over() {
            break;
        }
        let (px, py) = (script.below(64) as u32, script.below(64) as u32);
        let (mut spans, mut floor) = (Vec::new(), 0);
        for _ in 0..1 + script.below(4) {
            let bottom = floor + u32::from(script.short()) % 4096;
            let top = bottom + [0, 1, u32::from(script.byte()), u32::from(script.short()) % 16_321][script.below(4)];
            spans.extend(Span::new(bottom, top.min(16_320), script.below(2) == 0));
            floor = top;
        }
        let _ = builder.set_column(px, py, &spans);
    }
    builder.build()
}

const CODINGS: [Coding; 2] = [Coding::Adaptive, Coding::Braided];

fn encoded(page: &Page, coding: Coding) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(Frame::new(0.05, 0.15).expect("sizes of a grid"), 0).with_coding(coding).encode(page, &mut bytes);
    bytes
}

/// Decodes any bytes as an encoded page; what decodes must encode to bytes that decode to the same page. So must the page that the
/// bytes describe as a script.
pub fn page(bytes: &[u8]) -> Read {
    let mut decoder = Decoder::default();
    if let Ok(page) = decoder.decode(bytes) {
        for coding in CODINGS {
            assert_eq!(decoder.decode(&encoded(&page, coding)).as_ref(), Ok(&page));
        }
    }
    let page = page_of(&mut Script(bytes));
    if page.span_count() == 0 {
        return None;
    }
    let coded = CODINGS.map(|coding| encoded(&page, coding));
    for coded in &coded {
        let decoded = decoder.decode(coded);
        assert_eq!(decoded.as_ref(), Ok(&page));
    }
    Some(digest(coded.concat()))
}

/// Decodes any bytes as the colours of a page of walls and floor; what decodes must encode to bytes that decode to the same. So must
/// colours that the bytes are.
pub fn colours(bytes: &[u8]) -> Read {
    let mut builder = PageBuilder::default();
    for at in 0..40 * 40 {
        let (px, py) = (at % 40, at / 40);
        let top = if px % 9 == 0 { 4000 } else { 1000 + 8 * px };
        let span = Span::new(900, top, px % 9 == 0).expect("a span");
        assert!(builder.set_column(px, py, &[span]));
    }
    let occupancy = Occupancy::of(&builder.build());
    let again = |mut block: ColourBlock| {
        let (mut again, before) = (Vec::new(), block.clone());
        block.encode(&occupancy, &mut ColourEncoder::default(), &mut again);
        assert_eq!(ColourBlock::decode(&again, &occupancy), Ok(before));
        again
    };
    if let Ok(block) = ColourBlock::decode(bytes, &occupancy) {
        again(block);
    }
    let mut script = Script(bytes);
    let error_milli = script.short();
    // The bytes are a pattern that repeats; where one is 0 there is no colour.
    let pattern: Vec<_> = script.0.chunks(4).map(|bytes| <[u8; 4]>::try_from(bytes).unwrap_or_default()).collect();
    let colour = |[a, r, g, b]: [u8; 4]| (a != 0).then(|| [r, g, b].map(|channel| u16::from(channel) * 257));
    let exact: Vec<_> = pattern.iter().cycle().take(occupancy.len()).map(|&bytes| colour(bytes)).collect();
    let is_whole = exact.len() == occupancy.len();
    let block =
        is_whole.then(|| ColourBlock::quantise(&exact, error_milli, &mut ColourEncoder::default())).flatten()?;
    Some(digest(again(block)))
}

/// Opens any bytes as a LAS or LAZ file, as they are and behind a sound signature, and decodes what they seem to hold.
pub fn scan(bytes: &[u8]) -> Read {
    quiet_decoder_panics();
    let read = read_scan("laz", bytes);
    let mut signed = bytes.to_vec();
    if signed.len() > 24 {
        signed[..4].copy_from_slice(b"LASF");
        signed[24] = 1;
        return read_scan("laz", &signed);
    }
    read
}

/// Opens any bytes as an E57, as they are and with the checksums of its pages put right.
pub fn e57(bytes: &[u8]) -> Read {
    read_scan("e57", bytes);
    let mut checked = bytes.to_vec();
    for page in checked.as_chunks_mut::<1024>().0 {
        let (content, stated) = page.split_at_mut(1020);
        stated.copy_from_slice(&crc32c::crc32c(content).to_be_bytes());
    }
    read_scan("e57", &checked)
}

/// Opens any bytes as a scan with this ending, and decodes what they seem to hold.
pub fn read_scan(ending: &str, bytes: &[u8]) -> Read {
    let file = File::new(ending, bytes);
    // Of formats that have some.
    let source = ColourSource::ALL[bytes.len() % 3];
    let options = InputOptions { colour: Some(source), ..InputOptions::default() };
    let set = InputSet::open(std::slice::from_ref(&file.0), options, &NoMonitor).ok()?;
    let mut decoder = PointDecoder::new();
    let (mut points, mut hasher) = (0, DefaultHasher::new());
    for chunk in set.chunks().take(64) {
        let decoded = decoder.decode(&set, &chunk, &mut |batch| {
            points += batch.len();
            assert!(batch.values.is_empty() || batch.values.len() == batch.len());
            let coordinates = || batch.x.iter().chain(&batch.y).chain(&batch.z);
            assert!(coordinates().all(|v| v.abs() <= 1e12));
            coordinates().for_each(|v| v.to_bits().hash(&mut hasher));
            if points < ENOUGH { Ok(()) } else { Err(slicewalk::Error::Interrupted) }
        });
        decoded.ok()?;
    }
    (points > 0).then(|| hasher.finish())
}

/// Reads any bytes as a mesh of the format that `ending` names, with its colours.
pub fn mesh(ending: &str, bytes: &[u8]) -> Read {
    let file = File::new(ending, bytes);
    let options =
        MeshOptions { memory_bytes: 1 << 16, colours: true, texture_bytes: 1 << 22, ..MeshOptions::default() };
    let set = MeshSet::open(std::slice::from_ref(&file.0), options, &NoMonitor).ok()?;
    let (mut feed, mut batch, mut triangles, mut hasher) = (set.feed(), Vec::new(), 0, DefaultHasher::new());
    while triangles < ENOUGH && feed.next(&mut batch, &NoMonitor).unwrap_or(false) {
        let coordinates = batch.as_flattened().as_flattened();
        assert!(coordinates.iter().all(|v| v.abs() <= 1e12));
        coordinates.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        triangles += batch.len().max(1);
    }
    (triangles > 0).then(|| hasher.finish())
}

/// Reads any bytes as a plan; what is read must be written as text that reads as the same.
#[cfg(feature = "cli")]
pub fn plan(bytes: &[u8]) -> Read {
    use slicewalk::convert::PlanFile;
    let file = File::new("json", bytes);
    let plan = PlanFile::read(&file.0).ok()?;
    let mut text = Vec::new();
    plan.write_text(&mut text).expect("memory takes all");
    let text = String::from_utf8(text).expect("JSON");
    let again = File::new("json", text.as_bytes());
    assert_eq!(PlanFile::read(&again.0).expect("it was written"), plan);
    Some(digest(text))
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
