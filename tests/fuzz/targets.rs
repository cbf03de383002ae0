//! The fuzz targets as plain functions from any bytes; a panic is a finding. The fuzzer and `tests/seeds.rs` call them.
//! Each returns what it read if it reached the end, so that tests see whether changed inputs pass all checks.

mod forged;
mod loader;
mod script;

pub use forged::forged;
pub use loader::loader;

use script::Script;
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, ColourReader, PageDecoder};
use slicewalk::bytes::MemorySource;
use slicewalk::bytes::testing::hold;
use slicewalk::codec::{ColourBlock, ColourEncoder, Decoder, Encoder};
use slicewalk::colour::ColourSource;
use slicewalk::frame::Frame;
use slicewalk::page::{Occupancy, Page, PageBuilder, Span};
use slicewalk_input::{InputOptions, InputSet, PointDecoder};
use slicewalk_mesh::{MeshOptions, MeshSet};
use slicewalk_splat::{SplatOptions, SplatReader};
use std::cell::RefCell;
use std::hash::{Hash, Hasher};
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

/// Points and triangles after which reading ends, because a few bytes may stand for billions.
const ENOUGH: usize = 1 << 20;

/// A number that represents everything read; `None` if reading ended early.
pub type Read = Option<u64>;

/// A target and its name, used by the fuzzer and the seeds.
pub type Target = (&'static str, fn(&[u8]) -> Read);

fn digest(content: impl Hash) -> u64 {
    let mut hasher = Sum::default();
    content.hash(&mut hasher);
    hasher.finish()
}

/// Distinguishes contents that are not adversarial; `DefaultHasher` takes as long as reading.
#[derive(Default)]
struct Sum(u64);

impl Hasher for Sum {
    fn write(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(8) {
            let mut number = [0; 8];
            number[..piece.len()].copy_from_slice(piece);
            self.write_u64(u64::from_le_bytes(number));
        }
        self.write_u64(bytes.len() as u64);
    }

    fn write_u8(&mut self, number: u8) {
        self.write_u64(number.into());
    }

    fn write_u32(&mut self, number: u32) {
        self.write_u64(number.into());
    }

    fn write_usize(&mut self, number: usize) {
        self.write_u64(number as u64);
    }

    fn write_u64(&mut self, number: u64) {
        self.0 = (self.0.rotate_left(23) ^ number).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }

    fn finish(&self) -> u64 {
        self.0
    }
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
    ("splats", splats),
    ("plan", plan),
];

/// Opens, verifies and reads any bytes as an archive with its overview levels, unchanged and with recomputed checksums
/// of the head, the table of levels and the footer.
pub fn archive(bytes: &[u8]) -> Read {
    let read = read_archive(bytes.to_vec());
    repair(bytes).filter(|repaired| repaired != bytes).map_or(read, read_archive)
}

fn read_archive(bytes: Vec<u8>) -> Read {
    let archive = Archive::from_bytes(bytes.clone()).ok()?;
    let mut said = (archive.crs().ok(), archive.units().ok(), archive.noise().ok().map(|noise| format!("{noise:?}")));
    let summary = archive.verify(&NoMonitor, &mut |_| ()).expect("nobody asks to stop");
    let mut decoder = PageDecoder::new();
    let mut sound = |archive: &Archive| {
        let mut hasher = Sum::default();
        let read = |entry: slicewalk::Result<_>| -> slicewalk::Result<()> {
            let entry = entry?;
            let page = archive.page_with(&entry, &mut decoder)?;
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

/// Recomputes the checksum of the table of levels, if there is one.
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

/// Recomputes the checksum of the table of colour leaves, if there is one.
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

/// The page that a script describes: columns of spans, as far as they are compatible.
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

thread_local! {
    /// Scratch memory is allocated once, as in a conversion.
    static ENCODER: RefCell<Encoder> = RefCell::new(Encoder::new(Frame::new(0.05, 0.15).expect("sizes of a grid"), 0));
    static DECODER: RefCell<Decoder> = RefCell::default();
    static COLOURS: RefCell<ColourEncoder> = RefCell::default();
}

fn encoded(page: &Page) -> Vec<u8> {
    let mut bytes = Vec::new();
    ENCODER.with_borrow_mut(|encoder| encoder.encode(page, &mut bytes));
    bytes
}

/// Decodes any bytes as an encoded page. A decoded page must encode to bytes that decode to the same page. So must the
/// page that the bytes describe as a script.
pub fn page(bytes: &[u8]) -> Read {
    DECODER.with_borrow_mut(|decoder| page_with(bytes, decoder))
}

fn page_with(bytes: &[u8], decoder: &mut Decoder) -> Read {
    if let Ok(page) = decoder.decode(bytes) {
        assert_eq!(decoder.decode(&encoded(&page)).as_ref(), Ok(&page));
    }
    let page = page_of(&mut Script(bytes));
    if page.span_count() == 0 {
        return None;
    }
    let coded = encoded(&page);
    assert_eq!(decoder.decode(&coded).as_ref(), Ok(&page));
    Some(digest(coded))
}

/// Voxels of a page with walls and floor.
static WALLS: LazyLock<Occupancy> = LazyLock::new(|| {
    let mut builder = PageBuilder::default();
    // Up to the last column and row, where neighbours end; one column is left out, and the slices of others are far
    // apart.
    for at in (0..5 * 3).filter(|at| *at != 7) {
        let (px, py) = (59 + at % 5, 61 + at / 5);
        let top = if px % 5 == 0 { 3000 } else { 1000 + 24 * (px - 50) };
        let span = Span::new(900, top, px % 5 == 0).expect("a span");
        let shelf = Span::new(6000, 6100, false).filter(|_| px % 4 == 1);
        assert!(builder.set_column(px, py, &[Some(span), shelf].into_iter().flatten().collect::<Vec<_>>()));
    }
    Occupancy::of(&builder.build())
});

/// Decodes any bytes as the colours of a page with walls and floor. Decoded colours must encode to bytes that decode to
/// the same. So must the bytes themselves as colours.
pub fn colours(bytes: &[u8]) -> Read {
    let occupancy: &Occupancy = &WALLS;
    let again = |mut block: ColourBlock| {
        let (mut again, before) = (Vec::new(), block.clone());
        COLOURS.with_borrow_mut(|encoder| block.encode(occupancy, encoder, &mut again));
        assert_eq!(ColourBlock::decode(&again, occupancy), Ok(before));
        again
    };
    if let Ok(block) = ColourBlock::decode(bytes, occupancy) {
        again(block);
    }
    let mut script = Script(bytes);
    let error_milli = script.short();
    // The bytes are a repeating pattern; a 0 means no colour.
    let pattern: Vec<_> = script.0.chunks(4).map(|bytes| <[u8; 4]>::try_from(bytes).unwrap_or_default()).collect();
    let colour = |[a, r, g, b]: [u8; 4]| (a != 0).then(|| [r, g, b].map(|channel| u16::from(channel) * 257));
    let exact: Vec<_> = pattern.iter().cycle().take(occupancy.len()).map(|&bytes| colour(bytes)).collect();
    let is_whole = exact.len() == occupancy.len();
    let block = COLOURS
        .with_borrow_mut(|encoder| is_whole.then(|| ColourBlock::quantise(&exact, error_milli, encoder)).flatten())?;
    Some(digest(again(block)))
}

/// Opens any bytes as a LAS or LAZ file, unchanged and after a sound signature, and decodes their points.
pub fn scan(bytes: &[u8]) -> Read {
    let read = read_scan("laz", bytes);
    let mut signed = bytes.to_vec();
    if signed.len() > 24 {
        signed[..4].copy_from_slice(b"LASF");
        signed[24] = 1;
    }
    if signed == bytes { read } else { read_scan("laz", &signed) }
}

/// Opens any bytes as an E57, unchanged and with recomputed page checksums.
pub fn e57(bytes: &[u8]) -> Read {
    let read = read_scan("e57", bytes);
    let mut checked = bytes.to_vec();
    for page in checked.as_chunks_mut::<1024>().0 {
        let (content, stated) = page.split_at_mut(1020);
        stated.copy_from_slice(&crc32c::crc32c(content).to_be_bytes());
    }
    if checked == bytes { read } else { read_scan("e57", &checked) }
}

/// Opens any bytes as splats, in the format recognised from their first bytes; `.splat`, which has no signature, by default.
pub fn splats(bytes: &[u8]) -> Read {
    let allow_incomplete = bytes.len().is_multiple_of(2);
    let options = SplatOptions { allow_incomplete, memory_bytes: 16 << 20, ..SplatOptions::default() };
    let mut reader =
        SplatReader::of_source(Arc::new(MemorySource::new(bytes)), "/no folder/fuzz.splat", &options).ok()?;
    let (mut splats, mut hasher) = (0, Sum::default());
    let read = reader.for_each_batch(&NoMonitor, &mut |batch| {
        splats += batch.len();
        for splat in batch {
            assert!(splat.mean.iter().all(|v| v.abs() <= 1e12));
            assert!(splat.scale.iter().all(|v| v.is_finite() && *v >= 0.0));
            assert!((splat.rotation.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
            assert!((0.0..=1.0).contains(&splat.opacity));
            splat.mean.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        }
        if splats < ENOUGH { Ok(()) } else { Err(slicewalk::Error::Interrupted) }
    });
    read.ok().filter(|summary| summary.splats as usize == splats && splats > 0).map(|_| hasher.finish())
}

/// Opens any bytes as a scan with this extension, and decodes their points.
pub fn read_scan(ending: &'static str, bytes: &[u8]) -> Read {
    // For formats that have colours.
    let source = ColourSource::ALL[bytes.len() % 3];
    let options = InputOptions { colour: Some(source), ..InputOptions::default() };
    let path = PathBuf::from(format!("/no folder/fuzz.{ending}"));
    hold(&path, bytes);
    let set = InputSet::open(&[path], options, &NoMonitor).ok()?;
    let mut decoder = PointDecoder::new();
    let (mut points, mut hasher) = (0, Sum::default());
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

/// Reads any bytes as a mesh of the format selected by `ending`, with its colours.
pub fn mesh(ending: &'static str, bytes: &[u8]) -> Read {
    let options =
        MeshOptions { memory_bytes: 1 << 16, colours: true, texture_bytes: 1 << 22, ..MeshOptions::default() };
    let path = PathBuf::from(format!("/no folder/fuzz.{ending}"));
    hold(&path, bytes);
    let set = MeshSet::open(&[path], options, &NoMonitor).ok()?;
    let (mut feed, mut batch, mut triangles, mut hasher) = (set.feed(), Vec::new(), 0, Sum::default());
    while triangles < ENOUGH && feed.next(&mut batch, &NoMonitor).unwrap_or(false) {
        let coordinates = batch.as_flattened().as_flattened();
        assert!(coordinates.iter().all(|v| v.abs() <= 1e12));
        coordinates.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        triangles += batch.len().max(1);
    }
    (triangles > 0).then(|| hasher.finish())
}

/// Reads any bytes as a plan; a plan that is read must be written as text that reads the same.
pub fn plan(bytes: &[u8]) -> Read {
    use slicewalk_convert::PlanFile;
    let path = std::path::Path::new("/no folder/fuzz.json");
    hold(path, bytes);
    let plan = PlanFile::read(path).ok()?;
    let mut text = Vec::new();
    plan.write_text(&mut text).expect("memory takes all");
    let text = String::from_utf8(text).expect("JSON");
    hold(path, text.as_bytes());
    assert_eq!(PlanFile::read(path).expect("it was written"), plan);
    Some(digest(text))
}
