//! LAZ: where its chunks lie, and their decoding in bounded memory.
//!
//! In: a checked header and the LASzip record. Out: a [`Chunking`], whose chunks can be decoded in any order, and whole
//! point records. Sources: the LASzip 1.4 format as implemented by the crate `laz` 0.13, which decodes what [`sequence`] does
//! not: formats 4 and 5, and points as LASzip packed them first. Chunk table, chunk heads and counts are read and checked here.
//!
//! Memory of one decoder: one slab of records, one [`Window`] or as many bytes that a [`Sequence`] holds, and for formats 6
//! to 10 the compressed layers of one chunk that are needed (x, y, z, flags; class, intensity, RGB, point source id and GPS
//! time only when they are wanted); more than the budget is an error.

mod coder;
mod fields;
mod layers;
mod sequence;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};

use laz::laszip::ChunkTable;
use laz::record::{RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{LazItemType, LazVlr};

use super::convert::Layout;
use super::header::{LasHeader, u16_at, u32_at, u64_at};
use super::losses::Findings;
use super::source::{Source, Window};
use crate::{Error, Parameter, Result};
use layers::{Layers, POINT_BYTES};
use sequence::{Items, Sequence};

/// How the points of one LAZ file are packed.
#[derive(Debug, Clone)]
pub(super) struct Packing {
    vlr: LazVlr,
    layered: bool,
    /// The whole file is one sequence without chunks or chunk table (compressor 1).
    whole: bool,
    /// What a record consists of, if [`Sequence`] decodes it.
    items: Option<Items>,
    /// Bytes of an unpacked record, by the items; a few writers state another length in the header.
    record_bytes: usize,
    pub layout: Layout,
    /// Numbers of layer sizes at the head of a layered chunk.
    layers: usize,
    /// Version of the point's own item.
    version: u16,
    /// Where RGB lies in an unpacked record, and the number of its layer in a layered chunk.
    pub rgb_at: Option<usize>,
    rgb_layer: usize,
    /// Version of the item of RGB.
    rgb_version: u16,
}

/// Size and points of one chunk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    pub bytes: u32,
    pub points: u32,
}

/// How the points of a LAZ file turn out to be cut.
#[derive(Debug)]
pub(super) enum Chunking {
    /// Chunks one after the other from byte `start` on. If `open`, the number of points of the last is not known and
    /// its entry is the most it can hold.
    Chunks { start: u64, chunks: Vec<Chunk>, open: bool },
    /// One sequence of points, `len` bytes from `start` on; if `exact`, nothing else lies there.
    Stream { start: u64, len: u64, points: u64, exact: bool },
}

impl Packing {
    /// Checks the LASzip record `body`; `memory_bytes` bounds what the models of extra bytes may take.
    pub(super) fn read(source: &Source, body: &[u8], memory_bytes: u64) -> Result<Self> {
        let bad = |reason: String| Error::input(source.path(), "LASzip record", reason);
        if body.len() < 34 {
            return Err(bad(format!("{} bytes long, expected 34 or more", body.len())));
        }
        let compressor = u16_at(body, 0);
        let items = usize::from(u16_at(body, 32));
        if items == 0 || items > 32 || body.len() < 34 + 6 * items {
            return Err(bad(format!("it lists {items} items in {} bytes, expected 1 to 32 of 6 bytes", body.len())));
        }
        let vlr = LazVlr::from_buffer(body).map_err(|e| bad(e.to_string()))?;
        let (layered, layout) = match vlr.items()[0].item_type() {
            LazItemType::Point10 => (false, Layout::Old),
            LazItemType::Point14 => (true, Layout::Extended),
            other => return Err(bad(format!("its first item is {other:?}, expected a point"))),
        };
        if !matches!((compressor, layered), (1 | 2, false) | (3, true)) {
            return Err(bad(format!("compressor {compressor} does not fit its items; 1 and 2 pack old points, 3 new")));
        }
        let (mut record_bytes, mut layers, mut extra) = (0, 0, 0u64);
        let (mut rgb_at, mut rgb_layer, mut rgb_version) = (None, 0, 0);
        for item in vlr.items() {
            let (bytes, sizes) = match (layered, item.item_type()) {
                (false, LazItemType::Point10) => (20, 0),
                (false, LazItemType::GpsTime) => (8, 0),
                (false, LazItemType::RGB12) => (6, 0),
                (false, LazItemType::WavePacket13) => (29, 0),
                (false, LazItemType::Byte(n)) => (usize::from(n), 0),
                (true, LazItemType::Point14) => (30, 9),
                (true, LazItemType::RGB14) => (6, 1),
                (true, LazItemType::RGBNIR14) => (8, 2),
                (true, LazItemType::WavePacket14) => (29, 1),
                (true, LazItemType::Byte14(n)) => (usize::from(n), usize::from(n)),
                (_, other) => {
                    let first = vlr.items()[0].item_type();
                    return Err(bad(format!("its items belong to different point formats: {first:?} and {other:?}")));
                }
            };
            if matches!(item.item_type(), LazItemType::RGB12 | LazItemType::RGB14 | LazItemType::RGBNIR14) {
                (rgb_at, rgb_layer, rgb_version) = (Some(record_bytes), layers, item.version());
            }
            record_bytes += bytes;
            layers += sizes;
            if let LazItemType::Byte(n) = item.item_type() {
                extra += u64::from(n);
            }
        }
        // Each extra byte has adaptive models of 256 symbols: about 3 KiB, and as much again while they grow.
        if extra * (12 << 10) > memory_bytes {
            return Err(too_much(
                source,
                &format!("models of {extra} extra bytes a point (bytes)"),
                extra * (12 << 10),
                memory_bytes,
            ));
        }
        let version = vlr.items()[0].version();
        let whole = compressor == 1;
        let items = Items::of(vlr.items());
        let packing =
            Self { vlr, items, layered, whole, record_bytes, layout, layers, version, rgb_at, rgb_layer, rgb_version };
        packing.decoder_exists(source)?;
        Ok(packing)
    }

    /// Notes where the header states records of another length.
    pub(super) fn check_record_bytes(&self, header: &LasHeader, findings: &mut Findings) {
        if self.record_bytes != usize::from(header.record_bytes) {
            findings.note(format!(
                "the header states records of {} bytes, the LASzip record {}; the latter counts",
                header.record_bytes, self.record_bytes
            ));
        }
    }

    /// Bytes of a decoded record: of layered ones, the fields behind the point's own are decoded for RGB only.
    pub(super) fn decoded_bytes(&self, rgb: bool) -> usize {
        if self.layered && !rgb { POINT_BYTES } else { self.record_bytes }
    }

    /// Refuses item versions that have no decoder, before any point is read.
    fn decoder_exists(&self, source: &Source) -> Result<()> {
        let unsupported = |what: String| {
            Err(Error::Unsupported {
                what: format!("{}: {what}", source.path().display()),
                version: env!("CARGO_PKG_VERSION"),
                way_out: "decompress the file to LAS with the program that wrote it".into(),
            })
        };
        if self.layered {
            return match layers::exist(self.version) {
                true => Ok(()),
                false => unsupported(format!("LASzip points in layers of version {}", self.version)),
            };
        }
        let nothing = Window::new(source, 0, 0);
        match isolate(|| SequentialPointRecordDecompressor::new(nothing).set_fields_from(self.vlr.items())) {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => unsupported(error.to_string()),
            Err(Panicked) => Err(Error::input(source.path(), "LASzip record", "damaged: no decoder can be made of it")),
        }
    }

    /// Finds the chunks. Falls back from a lost or wrong chunk table to the heads of the chunks (formats 6 to 10) or to one
    /// sequence. `most_chunks` bounds the index.
    pub(super) fn body(
        &self,
        source: &Source,
        header: &LasHeader,
        file_bytes: u64,
        most_chunks: u64,
        findings: &mut Findings,
    ) -> Result<Chunking> {
        let stated = header.points_stated;
        let data_at = header.points_at;
        let bad = |reason: String| Error::input(source.path(), "LAZ points", reason);
        if data_at >= file_bytes {
            if stated > 0 {
                findings.lose(format!("the header states {stated} points, but the file ends before the first"))?;
            }
            return Ok(Chunking::Stream { start: file_bytes, len: 0, points: 0, exact: false });
        }
        let unfinished = || {
            bad("the header states 0 points but data follow: the program that wrote this file was interrupted; write or \
                 fetch the file again"
                .into())
        };
        if self.whole {
            let len = file_bytes - data_at;
            return match stated {
                0 if len >= self.record_bytes as u64 => Err(unfinished()),
                _ => Ok(Chunking::Stream { start: data_at, len, points: stated, exact: false }),
            };
        }
        let start = data_at + 8;
        let Lost { reason, end, exact } = match self.table(source, data_at, file_bytes, most_chunks)? {
            Ok(chunks) => {
                return self.with_counts(source, start, chunks, stated, findings)?.ok_or_else(unfinished);
            }
            Err(lost) => lost,
        };
        let len = end.saturating_sub(start);
        if self.layered {
            let (chunks, rest) = self.walk(source, start, start + len, (!exact).then_some(stated), most_chunks)?;
            let found: u64 = chunks.iter().map(|c| u64::from(c.points)).sum();
            findings.note(format!("{reason}; its points are found without it"));
            if found < stated || rest > 0 && (exact || stated == 0) {
                findings.lose(format!(
                    "the header states {stated} points, whole chunks hold {found}, and {rest} bytes follow them"
                ))?;
            } else if found != stated {
                findings.note(format!("the header states {stated} points, its chunks hold {found}"));
            }
            return Ok(Chunking::Chunks { start, chunks, open: false });
        }
        if self.vlr.uses_variable_size_chunks() {
            let what = "and its chunks vary in length, so none can be found; write or fetch the file again";
            return Err(bad(format!("{reason}, {what}")));
        }
        findings.note(format!("{reason}; its points are read without it"));
        if stated == 0 && len >= self.record_bytes as u64 {
            return Err(unfinished());
        }
        Ok(Chunking::Stream { start, len, points: stated, exact })
    }

    /// Reads the chunk table. The inner error says why it cannot be used, and where the points end.
    fn table(
        &self,
        source: &Source,
        data_at: u64,
        file_bytes: u64,
        most_chunks: u64,
    ) -> Result<std::result::Result<Vec<Chunk>, Lost>> {
        let start = data_at + 8;
        // What a damaged table says of its own place means nothing: points may lie anywhere.
        let lost = |reason: &str| Ok(Err(Lost { reason: reason.to_string(), end: file_bytes, exact: false }));
        let place = |bytes: Option<Vec<u8>>| bytes.map(|b| u64_at(&b, 0));
        let Some(mut table_at) = place(source.bytes_at(data_at, 8)?) else {
            return lost("the file ends before its first point");
        };
        if table_at == u64::MAX || table_at <= data_at {
            // Written to a pipe: the place of the table stands at the very end.
            table_at = place(source.bytes_at(file_bytes.saturating_sub(8), 8)?).unwrap_or(0);
            if table_at < start || table_at > file_bytes.saturating_sub(16) {
                return lost("it has no chunk table");
            }
        }
        if table_at < start || table_at > file_bytes.saturating_sub(8) {
            return lost(&format!("its chunk table should begin at byte {table_at} of {file_bytes}: the file is cut"));
        }
        let Some(head) = source.bytes_at(table_at, 8)? else { return lost("its chunk table is cut") };
        let (version, count) = (u32_at(&head, 0), u64::from(u32_at(&head, 4)));
        let data_bytes = table_at - start;
        // A chunk holds at least one record as it is, so this bounds what the count may size.
        if version != 0 || count > data_bytes / self.record_bytes as u64 {
            return lost(&format!("its chunk table (version {version}, {count} chunks) is damaged"));
        }
        check_count(source, count, most_chunks)?;
        let variable = self.vlr.uses_variable_size_chunks();
        let mut window = Window::new(source, table_at, file_bytes - table_at);
        let Ok(Ok(table)) = isolate(|| ChunkTable::read(&mut &mut window, variable)) else {
            return lost("its chunk table is damaged");
        };
        let chunks: Vec<Chunk> = table
            .as_ref()
            .iter()
            .map(|entry| Chunk {
                // The table holds 32-bit numbers, which `laz` extends by their sign.
                bytes: entry.byte_count as u32,
                points: if variable { entry.point_count as u32 } else { self.vlr.chunk_size() },
            })
            .collect();
        let sum: u64 = chunks.iter().map(|c| u64::from(c.bytes)).sum();
        if sum != data_bytes {
            let reason = format!("its chunk table gives {sum} bytes to {count} chunks, which have {data_bytes}");
            return Ok(Err(Lost { reason, end: table_at, exact: true }));
        }
        Ok(Ok(chunks))
    }

    /// Settles the points of the last chunk; `None` when only the header could tell and it says 0.
    fn with_counts(
        &self,
        source: &Source,
        start: u64,
        mut chunks: Vec<Chunk>,
        stated: u64,
        findings: &mut Findings,
    ) -> Result<Option<Chunking>> {
        let mut open = false;
        if !self.vlr.uses_variable_size_chunks() {
            let size = u64::from(self.vlr.chunk_size());
            let at = start + chunks.iter().rev().skip(1).map(|c| u64::from(c.bytes)).sum::<u64>();
            let before = chunks.len().saturating_sub(1) as u64 * size;
            if let Some(last) = chunks.last_mut() {
                match stated.checked_sub(before) {
                    // The chunk knows better than the header.
                    _ if self.layered => {
                        let head = self.head(source, at, u64::from(last.bytes))?;
                        last.points = head.map_or(0, |h| h.points).min(last.points);
                    }
                    Some(rest) if (1..=size).contains(&rest) => last.points = rest as u32,
                    _ if stated == 0 => return Ok(None),
                    _ => open = true,
                }
            }
        }
        let found: u64 = chunks.iter().map(|c| u64::from(c.points)).sum();
        if open {
            findings.note(format!(
                "the header states {stated} points, but {} chunks cannot hold that many; the last is read to its end",
                chunks.len()
            ));
        } else if found != stated {
            findings.note(format!("the header states {stated} points, its chunks hold {found}"));
        }
        Ok(Some(Chunking::Chunks { start, chunks, open }))
    }

    /// Finds layered chunks by their heads alone, up to so many points (none: all) or the end; and how many bytes are left
    /// before the end.
    fn walk(
        &self,
        source: &Source,
        start: u64,
        end: u64,
        stated: Option<u64>,
        most_chunks: u64,
    ) -> Result<(Vec<Chunk>, u64)> {
        let (mut at, mut points) = (start, 0);
        let mut chunks = Vec::new();
        while stated.is_none_or(|stated| stated == 0 || points < stated) {
            let Some(head) = self.head(source, at, end - at)? else { break };
            if head.points == 0 || head.bytes > end - at || head.bytes > u64::from(u32::MAX) {
                break;
            }
            chunks.push(Chunk { bytes: head.bytes as u32, points: head.points });
            check_count(source, chunks.len() as u64, most_chunks)?;
            at += head.bytes;
            points += u64::from(head.points);
        }
        Ok((chunks, end - at))
    }

    /// Head of the layered chunk at `at`: one plain record, the number of points, the sizes of the layers.
    fn head(&self, source: &Source, at: u64, room: u64) -> Result<Option<Head>> {
        let len = self.record_bytes + 4 + 4 * self.layers;
        if room < len as u64 {
            return Ok(None);
        }
        let Some(bytes) = source.bytes_at(at, len)? else { return Ok(None) };
        let size = |layer: usize| u64::from(u32_at(&bytes, self.record_bytes + 4 + 4 * layer));
        let sizes: Vec<u64> = (0..self.layers).map(size).collect();
        let points = u32_at(&bytes, self.record_bytes);
        Ok(Some(Head { points, bytes: len as u64 + sizes.iter().sum::<u64>(), sizes, first: bytes }))
    }
}

/// Why a chunk table cannot be used, and where the points end: there (`exact`), or there at the latest.
struct Lost {
    reason: String,
    end: u64,
    exact: bool,
}

/// Head of a layered chunk.
struct Head {
    points: u32,
    /// Bytes of the whole chunk.
    bytes: u64,
    /// Bytes of each layer.
    sizes: Vec<u64>,
    /// The first point, and what follows it before the layers.
    first: Vec<u8>,
}

fn check_count(source: &Source, count: u64, most: u64) -> Result<()> {
    if count <= most {
        return Ok(());
    }
    Err(too_much(source, "chunks of a LAZ file", count, most))
}

/// More of a file than the memory budget holds.
fn too_much(source: &Source, what: &str, found: u64, most: u64) -> Error {
    Error::limit(format!("{}: {what}", source.path().display()), found, most).with_way_out(Parameter::Memory)
}

/// Most bytes that the arithmetic coder writes for no symbol.
const EMPTY_CODE_BYTES: u64 = 4;

/// What is needed of points beside their places and flags.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted {
    pub classes: bool,
    pub intensity: bool,
    /// The file has RGB, and it is needed.
    pub rgb: bool,
    pub source_ids: bool,
    pub times: bool,
}

/// The packed points of a chunk or a stream, and what decoding them needs to know.
pub(super) struct PackedPoints<'a> {
    pub source: &'a Source,
    pub packing: &'a Packing,
    pub start: u64,
    pub len: u64,
    /// Points to decode; at most so many if `open`.
    pub points: u64,
    /// Data may end before `points` are decoded.
    pub open: bool,
    pub wanted: Wanted,
    pub memory_bytes: u64,
    /// Name for messages: "LAZ chunk 3".
    pub name: String,
}

impl PackedPoints<'_> {
    /// Decodes into `slab`, calling `sink` with whole records; returns the points decoded and the bytes left over.
    pub(super) fn decode(
        &self,
        stream: bool,
        slab: &mut [u8],
        sink: &mut dyn FnMut(&[u8]) -> Result<()>,
    ) -> Result<(u64, u64)> {
        if self.packing.layered {
            return self.decode_layers(slab, sink);
        }
        if self.points == 1 && !stream {
            return self.decode_one(slab, sink);
        }
        let chunk_points = match stream && !self.packing.whole {
            true => u64::from(self.packing.vlr.chunk_size()),
            false => 0,
        };
        if let Some(items) = self.packing.items {
            let mut sequence = Sequence::new(self.source, items, self.start, self.len, chunk_points);
            let done = self.fill(0, slab, sink, |records, filled| sequence.next(records, filled))?;
            return Ok((done, self.len.saturating_sub(sequence.position())));
        }
        let mut decoder = SequentialPointRecordDecompressor::new(Window::new(self.source, self.start, self.len));
        let items = self.packing.vlr.items();
        let mut in_chunk = None;
        let next = |record: &mut [u8]| {
            if in_chunk.is_none_or(|points| chunk_points > 0 && points == chunk_points) {
                decoder.reset();
                decoder.set_fields_from(items).map_err(std::io::Error::other)?;
                in_chunk = Some(0);
            }
            decoder.decompress_next(record)?;
            in_chunk = in_chunk.map(|points| points + 1);
            Ok(())
        };
        let done = self.fill(0, slab, sink, self.each(next))?;
        Ok((done, self.len.saturating_sub(decoder.get().position())))
    }

    /// The only point of a chunk lies there as it is; what the coder wrote behind it takes a few bytes.
    fn decode_one(&self, slab: &mut [u8], sink: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<(u64, u64)> {
        let len = self.packing.record_bytes;
        let there = self.len >= len as u64 && self.source.read_at(&mut slab[..len], self.start)? == len;
        match (there, self.open) {
            (true, _) => sink(&slab[..len])?,
            (false, true) => return Ok((0, 0)),
            (false, false) => return Err(self.damaged(0, "its data end early")),
        }
        Ok((1, (self.len - len as u64).saturating_sub(EMPTY_CODE_BYTES)))
    }

    fn decode_layers(&self, slab: &mut [u8], sink: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<(u64, u64)> {
        let Some(head) = self.packing.head(self.source, self.start, self.len)? else {
            return Err(self.damaged(0, "it is too short for its head"));
        };
        let places = layers::places(self.wanted, self.packing.rgb_layer);
        let sizes = places.map(|place| place.and_then(|place| head.sizes.get(place).copied()).unwrap_or(0));
        let needed: u64 = sizes.iter().sum();
        if head.bytes > self.len {
            return Err(self.damaged(0, &format!("its layers take {} bytes, it has {}", head.bytes, self.len)));
        }
        if u64::from(head.points) != self.points {
            return Err(self.damaged(0, &format!("it holds {} points, expected {}", head.points, self.points)));
        }
        if needed > self.memory_bytes {
            return Err(too_much(self.source, &format!("{}: compressed bytes", self.name), needed, self.memory_bytes));
        }
        let record_bytes = self.packing.decoded_bytes(self.wanted.rgb);
        if head.points > 0 {
            sink(&head.first[..record_bytes])?;
        }
        // To begin layers is the dearest part of decoding.
        if head.points <= 1 {
            return Ok((self.points, self.len - head.bytes));
        }
        let colour = self.packing.rgb_at.filter(|_| self.wanted.rgb).map(|at| (at, self.packing.rgb_version));
        if colour.is_some_and(|(_, version)| !layers::exist(version)) {
            return Err(self.damaged(1, "no decoder can be made of its items"));
        }
        let mut bytes = vec![0; usize::try_from(needed).unwrap_or(usize::MAX)];
        let mut rest = bytes.as_mut_slice();
        for (place, size) in places.iter().zip(sizes) {
            let Some(place) = place else { continue };
            let at = self.start + head.first.len() as u64 + head.sizes[..*place].iter().sum::<u64>();
            let (layer, others) = rest.split_at_mut(size as usize);
            if self.source.read_at(layer, at)? < layer.len() {
                return Err(self.damaged(1, "its data end early"));
            }
            rest = others;
        }
        let sizes = sizes.map(|size| size as usize);
        let mut layers = Layers::new(&head.first[..record_bytes], bytes, sizes, self.packing.version, colour);
        let done = self.fill(1, slab, sink, |records, filled| layers.next(records, record_bytes, filled))?;
        Ok((done, self.len - head.bytes))
    }

    /// Fills records one by `next`, which calls `laz`, after the other.
    fn each(
        &self,
        mut next: impl FnMut(&mut [u8]) -> std::io::Result<()>,
    ) -> impl FnMut(&mut [u8], &mut usize) -> std::io::Result<()> {
        let record_bytes = self.packing.decoded_bytes(self.wanted.rgb);
        move |records, filled| {
            let all = isolate(|| {
                for record in records.chunks_exact_mut(record_bytes) {
                    next(record)?;
                    *filled += 1;
                }
                Ok(())
            });
            all.unwrap_or_else(|Panicked| Err(std::io::ErrorKind::InvalidData.into()))
        }
    }

    /// Fills `slab` with records by `next`, which counts those that are whole, and hands them to `sink`, so many of which are
    /// `done`; returns the number of all.
    fn fill(
        &self,
        mut done: u64,
        slab: &mut [u8],
        sink: &mut dyn FnMut(&[u8]) -> Result<()>,
        mut next: impl FnMut(&mut [u8], &mut usize) -> std::io::Result<()>,
    ) -> Result<u64> {
        let record_bytes = self.packing.decoded_bytes(self.wanted.rgb);
        while done < self.points {
            let want = (slab.len() / record_bytes).min(usize::try_from(self.points - done).unwrap_or(usize::MAX));
            let mut filled = 0;
            let outcome = next(&mut slab[..want * record_bytes], &mut filled);
            if filled > 0 {
                sink(&slab[..filled * record_bytes])?;
            }
            done += filled as u64;
            match outcome {
                Ok(()) => {}
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => match self.open {
                    true => break,
                    false => return Err(self.damaged(done, "its data end early")),
                },
                Err(error) if error.kind() == std::io::ErrorKind::InvalidData => {
                    return Err(self.damaged(done, "the decoder cannot follow its data"));
                }
                Err(error) => return Err(Error::io(self.source.path(), format!("decode {}", self.name), error)),
            }
        }
        Ok(done)
    }

    fn damaged(&self, done: u64, what: &str) -> Error {
        let reason = format!("damaged: {what}, after {done} of {} points; fetch or write the file again", self.points);
        Error::input(self.source.path(), self.name.clone(), reason).with_way_out(Parameter::Incomplete)
    }
}

/// The decoder ran into a panic.
struct Panicked;

/// Runs `work`, which calls `laz` and nothing of ours that may panic.
///
/// The crate indexes and adds without checks in places that damaged bytes reach, so a panic there is a property of the
/// file, not a mistake of the caller. Its state is dropped by all callers, hence `AssertUnwindSafe`. The panic
/// hook still prints, unless the program asked for silence with [`quiet_decoder_panics`].
fn isolate<T>(work: impl FnOnce() -> T) -> std::result::Result<T, Panicked> {
    let _inside = Inside::enter();
    catch_unwind(AssertUnwindSafe(work)).map_err(|_| Panicked)
}

thread_local! {
    static INSIDE: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

struct Inside;

impl Inside {
    fn enter() -> Self {
        INSIDE.set(true);
        Self
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        INSIDE.set(false);
    }
}

/// Keeps the panic hook silent while damaged LAZ data are being decoded; such panics become errors anyway.
///
/// This replaces the process's panic hook by one that hands all other panics to the hook found now. A library must not
/// do that unasked: programs call it once, early, if they care for a clean standard error.
pub fn quiet_decoder_panics() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |about| {
            if !INSIDE.try_with(|inside| inside.get()).unwrap_or(false) {
                before(about);
            }
        }));
    });
}
