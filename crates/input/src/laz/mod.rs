//! LAZ: location of its chunks, and their decoding in bounded memory.
//!
//! Input: a checked header and the LASzip record. Output: a [`Chunking`], whose chunks can be decoded in any order, and
//! whole point records. Source: M. Isenburg, *LASzip: lossless compression of LiDAR data* (PE&RS 79(2), 2013), and what
//! the program LASzip and the crate `laz` write: versions 1 and 2 of the items of formats 0 to 5, versions 2 to 4 of
//! those of formats 6 to 10. Formats 0 to 5 are decoded in full. Near infrared, wave packets and extra bytes of formats
//! 6 to 10 lie in layers of their own, which are never decoded.
//!
//! LAZ has no checksums, but an encoder ends each chunk, and each of its layers, in a state that can be recognised. So
//! decoding must end in that state and where the stated length does, the layers must fill the chunk, the chunks must
//! fill the file up to their table, and their points must add up to the count in the header.
//!
//! Memory of one decoder: one slab of records, one piece of [`PackedBytes`](packed::PackedBytes), and for formats 6 to
//! 10 the needed compressed layers of one chunk (x, y, z, flags; class, intensity, RGB, point source id and GPS time
//! only if wanted). Exceeding the budget is an error.

mod chunking;
mod coder;
mod fields;
mod items;
mod layers;
mod memory;
mod packed;
mod sequence;
#[cfg(test)]
mod tests;
mod version_one;
mod wave_packets;

use std::io;

use self::coder::Numbers;
use self::items::{Kind, LaszipRecord};
use self::layers::{Layers, POINT_BYTES};
use self::sequence::{Items, Sequence};
use super::convert::Layout;
use super::diagnostics::Findings;
use super::header::LasHeader;
use super::is_of_input;
use super::source::Source;
use crate::{Error, Monitor, Parameter, Result};

pub(super) use self::chunking::{Chunk, Chunking};
pub(super) use self::memory::ChunkMemory;
use self::memory::Permit;

/// Packing of the points of one LAZ file.
#[derive(Debug, Clone)]
pub(super) struct Packing {
    record: LaszipRecord,
    layered: bool,
    /// True if the whole file is one sequence without chunks or chunk table (compressor 1).
    whole: bool,
    /// Items of a record of formats 0 to 5.
    items: Option<Items>,
    /// Bytes of an unpacked record according to the items; a few writers state another length in the header.
    record_bytes: usize,
    pub layout: Layout,
    /// Number of layer sizes in the head of a layered chunk.
    layers: usize,
    /// Version of the point's own item.
    version: u16,
    /// Memory of the models of extra bytes (bytes).
    models_bytes: u64,
    /// Offset of the GPS time in an unpacked record of formats 0 to 5.
    pub time_at: Option<usize>,
    /// Offset of RGB in an unpacked record; `rgb_layer`: index of its layer in a layered chunk.
    pub rgb_at: Option<usize>,
    rgb_layer: usize,
    /// Version of the item of RGB.
    rgb_version: u16,
}

impl Packing {
    /// Checks the LASzip record `body`; `memory_bytes` limits the models of extra bytes.
    pub(super) fn read(source: &Source, body: &[u8], memory_bytes: u64) -> Result<Self> {
        let record = LaszipRecord::read(body).map_err(|reason| Error::input(source.path(), "LASzip record", reason))?;
        let version = record.items[0].version;
        let layered = record.items[0].kind == Kind::Point14;
        let (mut record_bytes, mut layers, mut extra) = (0, 0, 0);
        let (mut time_at, mut rgb_at, mut rgb_layer, mut rgb_version) = (None, None, 0, 0);
        for item in &record.items {
            match item.kind {
                Kind::RGB12 | Kind::RGB14 | Kind::RGBNIR14 => {
                    (rgb_at, rgb_layer, rgb_version) = (Some(record_bytes), layers, item.version);
                }
                Kind::GpsTime11 => time_at = Some(record_bytes),
                Kind::Byte => extra += item.bytes as u64,
                _ => {}
            }
            record_bytes += item.bytes;
            layers += item.layers();
        }
        // Each extra byte has adaptive models of 256 symbols: about 3 KiB, and the same again while they grow.
        let models_bytes = extra * (12 << 10);
        if models_bytes > memory_bytes {
            let what = format!("models of {extra} extra bytes a point (bytes)");
            return Err(too_much(source, &what, models_bytes, memory_bytes));
        }
        let items = Items::of(&record.items).filter(|_| !layered);
        let decodes = if layered { layers::exist(version) } else { items.is_some() };
        if !decodes {
            let listed: Vec<String> =
                record.items.iter().map(|item| format!("{:?} of version {}", item.kind, item.version)).collect();
            return Err(Error::Unsupported {
                what: format!("{}: LASzip points of {}", source.path().display(), listed.join(", ")),
                version: env!("CARGO_PKG_VERSION"),
                suggestion: "decompress the file to LAS with the program that wrote it".into(),
            });
        }
        let layout = if layered { Layout::Extended } else { Layout::Old };
        let whole = record.compressor == 1;
        Ok(Self {
            record,
            layered,
            whole,
            items,
            record_bytes,
            layout,
            layers,
            version,
            models_bytes,
            time_at,
            rgb_at,
            rgb_layer,
            rgb_version,
        })
    }

    /// Adds a note if the header states records of another length.
    pub(super) fn check_record_bytes(&self, header: &LasHeader, findings: &mut Findings) {
        if self.record_bytes != usize::from(header.record_bytes) {
            findings.note(format!(
                "the header states records of {} bytes, the LASzip record {}; the latter counts",
                header.record_bytes, self.record_bytes
            ));
        }
    }

    /// Checks the number of points against the sum of those by return: on very regular data the decoder ends soundly
    /// after other numbers, too. Cost: decodes the last chunk again if the two differ.
    pub(super) fn check_returns(
        &self,
        source: &Source,
        header: &LasHeader,
        body: &Chunking,
        memory: &ChunkMemory,
        findings: &mut Findings,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let (stated, by_return) = (header.points_stated, header.points_by_return);
        if self.layered || by_return == 0 || by_return == stated {
            return Ok(());
        }
        let (start, len, points, stream) = match body {
            Chunking::Stream { start, len, points: 1.., table_at } => (*start, *len, by_return, Some(*table_at)),
            Chunking::Chunks { start, chunks } if self.record.chunk_points != LaszipRecord::VARIABLE => {
                let Some(last) = chunks.iter().rposition(|chunk| chunk.points > 0) else { return Ok(()) };
                let sum =
                    |part: fn(&Chunk) -> u32| chunks[..last].iter().map(|chunk| u64::from(part(chunk))).sum::<u64>();
                let rest = by_return.saturating_sub(sum(|chunk| chunk.points));
                if rest == 0 || rest > u64::from(self.record.chunk_points) {
                    return Ok(());
                }
                (start + sum(|chunk| chunk.bytes), chunks[last].bytes.into(), rest, None)
            }
            Chunking::Stream { .. } | Chunking::Chunks { .. } => return Ok(()),
        };
        let wanted = Wanted { classes: false, intensity: false, rgb: false, source_ids: false, times: false };
        let name = "LAZ points".into();
        let packed = PackedPoints { source, packing: self, start, len, points, stream, wanted, memory, name };
        let mut slab = vec![0; self.record_bytes * CHECKED_POINTS];
        let mut sink = |_: &[u8]| if monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) };
        match packed.decode(false, &mut slab, &mut sink) {
            Ok(()) => findings.lose_points(
                by_return.saturating_sub(stated),
                format!(
                    "the header states {stated} points, but {by_return} by return, after which the data end soundly"
                ),
            ),
            Err(error) if is_of_input(&error) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Returns the bytes of a decoded record. In layered records, the fields after the point's own are decoded only for
    /// RGB.
    pub(super) fn decoded_bytes(&self, rgb: bool) -> usize {
        if self.layered && !rgb { POINT_BYTES } else { self.record_bytes }
    }
}

/// Creates an error for a part of a file that exceeds the memory budget.
fn too_much(source: &Source, what: &str, found: u64, most: u64) -> Error {
    Error::limit(format!("{}: {what}", source.path().display()), found, most).with_suggestion(Parameter::Memory)
}

/// Bytes that the arithmetic coder writes for zero symbols.
const EMPTY_CODE_BYTES: u64 = 4;

/// Points decoded at once to check their number.
const CHECKED_POINTS: usize = 1 << 6;

/// Fields needed besides coordinates and flags.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted {
    pub classes: bool,
    pub intensity: bool,
    /// True if RGB is needed and the file has it.
    pub rgb: bool,
    pub source_ids: bool,
    pub times: bool,
}

/// Reason why decoding fails or cannot be trusted.
#[derive(Debug)]
pub(super) enum Flaw {
    Short,
    Strange,
    Uneven,
    Io(io::Error),
}

impl From<io::Error> for Flaw {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Packed points of a chunk or a stream, and what decoding them requires.
pub(super) struct PackedPoints<'a> {
    pub source: &'a Source,
    pub packing: &'a Packing,
    pub start: u64,
    pub len: u64,
    pub points: u64,
    /// `Some` for a stream: holds the offset of the chunk table stated by the file, if it has one.
    pub stream: Option<Option<u64>>,
    pub wanted: Wanted,
    pub memory: &'a ChunkMemory,
    /// Name for messages: "LAZ chunk 3".
    pub name: String,
}

/// Receives whole records.
type Sink<'a> = &'a mut dyn FnMut(&[u8]) -> Result<()>;

impl PackedPoints<'_> {
    /// Decodes into `slab` and calls `sink` with whole records; fails unless all points are present and end where they
    /// should.
    ///
    /// If `only_whole`, `sink` gets only the points of whole chunks. Cost: everything is decoded twice, because a chunk
    /// is known to be whole only at its end. Meanwhile `sink` is called with no records, so that it can cancel.
    pub(super) fn decode(&self, only_whole: bool, slab: &mut [u8], sink: Sink) -> Result<()> {
        if only_whole {
            let mut whole = 0;
            let found = self.run(self.points, slab, &mut |_| sink(&[]), &mut whole);
            if whole > 0 && found.as_ref().err().is_none_or(is_of_input) {
                self.run(whole, slab, sink, &mut 0)?;
            }
            return found;
        }
        // If the sink cannot accept a record, the cause may be damage that only shows at the end.
        let mut refusal = None;
        let mut take = |records: &[u8]| match refusal.is_none().then(|| sink(records)) {
            Some(Err(error @ (Error::Input { .. } | Error::Limit { .. }))) => {
                refusal = Some(error);
                Ok(())
            }
            other => other.unwrap_or(Ok(())),
        };
        self.run(self.points, slab, &mut take, &mut 0)?;
        refusal.map_or(Ok(()), Err)
    }

    /// Decodes the first `points`; sets `whole` to the number of points in chunks known to be whole.
    fn run(&self, points: u64, slab: &mut [u8], sink: Sink, whole: &mut u64) -> Result<()> {
        if self.packing.layered {
            return self.run_layers(slab, sink, whole);
        }
        let Some(items) = self.packing.items else {
            return Err(self.damaged(0, "no decoder can be made of its items"));
        };
        let _permit = self.permit("models of extra bytes", self.packing.models_bytes)?;
        let chunk_points = match self.stream {
            Some(Some(_)) => u64::from(self.packing.record.chunk_points),
            _ => points,
        };
        let mut sequence = Sequence::new(self.source, items, (self.start, self.len), points, chunk_points);
        let done = self.fill((0, points), slab, sink, |records, filled| sequence.next(records, filled));
        *whole = sequence.whole();
        done?;
        if points == 0 && self.len > 0 {
            // A chunk without points consists of the end of an encoder.
            let bytes = self.source.bytes_at(self.start, EMPTY_CODE_BYTES as usize)?.unwrap_or_default();
            let is_empty = self.len == EMPTY_CODE_BYTES && layers::is_still(&bytes);
            return if is_empty { Ok(()) } else { Err(self.damaged(0, "it holds more than its points")) };
        }
        let end = sequence.position();
        match self.stream {
            _ if points < self.points || end == self.len => Ok(()),
            None => {
                *whole = 0;
                Err(self.damaged(points, "it holds more than its points"))
            }
            Some(table_at) => {
                let (at, file_end) = (self.start + end, self.start + self.len);
                match self.packing.may_end(self.source, at, file_end, table_at, points.div_ceil(chunk_points))? {
                    true => Ok(()),
                    false => Err(self.damaged(points, "neither the chunk table nor the end of the file follows")),
                }
            }
        }
    }

    /// Waits until the decoder may hold `bytes` for the chunk.
    fn permit(&self, what: &str, bytes: u64) -> Result<Permit<'_>> {
        let refuse = |most| too_much(self.source, &format!("{}: {what}", self.name), bytes, most);
        self.memory.permit(bytes).map_err(refuse)
    }

    fn run_layers(&self, slab: &mut [u8], sink: Sink, whole: &mut u64) -> Result<()> {
        let Some(head) = self.packing.head(self.source, self.start, self.len)? else {
            return Err(self.damaged(0, "it is too short for its head"));
        };
        let places = layers::places(self.wanted, self.packing.rgb_layer);
        let sizes = places.map(|place| place.and_then(|place| head.sizes.get(place).copied()).unwrap_or(0));
        let needed: u64 = sizes.iter().sum();
        if head.bytes != self.len {
            return Err(self.damaged(0, &format!("its layers take {} bytes, it has {}", head.bytes, self.len)));
        }
        if u64::from(head.points) != self.points {
            return Err(self.damaged(0, &format!("it holds {} points, expected {}", head.points, self.points)));
        }
        let _permit = self.permit("compressed bytes", needed)?;
        let colour = self.packing.rgb_at.filter(|_| self.wanted.rgb).map(|at| (at, self.packing.rgb_version));
        if colour.is_some_and(|(_, version)| !layers::exist(version)) {
            return Err(self.damaged(0, "no decoder can be made of its items"));
        }
        let mut bytes = vec![0; usize::try_from(needed).unwrap_or(usize::MAX)];
        let mut rest = bytes.as_mut_slice();
        let mut are_still = true;
        for (place, size) in places.iter().zip(sizes) {
            let Some(place) = place else { continue };
            let at = self.start + head.first.len() as u64 + head.sizes[..*place].iter().sum::<u64>();
            let (layer, others) = rest.split_at_mut(size as usize);
            if self.source.read_at(layer, at)? < layer.len() {
                return Err(self.damaged(0, "its data end early"));
            }
            are_still &= layers::is_still(layer);
            rest = others;
        }
        let record_bytes = self.packing.decoded_bytes(self.wanted.rgb);
        if head.points > 0 {
            sink(&head.first[..record_bytes])?;
        }
        // Setting up layers is the most expensive part of decoding.
        let are_at_end = match head.points {
            0 | 1 => are_still,
            _ => {
                let sizes = sizes.map(|size| size as usize);
                let mut layers = Layers::new(&head.first[..record_bytes], bytes, sizes, self.packing.version, colour);
                self.fill((1, self.points), slab, sink, |records, filled| layers.next(records, record_bytes, filled))?;
                layers.are_at_end()
            }
        };
        if !are_at_end {
            return Err(self.flawed(self.points, Flaw::Uneven));
        }
        *whole = self.points;
        Ok(())
    }

    /// Decodes records `done..points`: fills `slab` by `next`, which counts the decoded records, and passes them to
    /// `sink`.
    fn fill(
        &self,
        (mut done, points): (u64, u64),
        slab: &mut [u8],
        sink: Sink,
        mut next: impl FnMut(&mut [u8], &mut usize) -> Result<(), Flaw>,
    ) -> Result<()> {
        let record_bytes = self.packing.decoded_bytes(self.wanted.rgb);
        while done < points {
            let want = (slab.len() / record_bytes).min(usize::try_from(points - done).unwrap_or(usize::MAX));
            let mut filled = 0;
            let outcome = next(&mut slab[..want * record_bytes], &mut filled);
            if filled > 0 {
                sink(&slab[..filled * record_bytes])?;
            }
            done += filled as u64;
            outcome.map_err(|flaw| self.flawed(done, flaw))?;
        }
        Ok(())
    }

    fn flawed(&self, done: u64, flaw: Flaw) -> Error {
        match flaw {
            Flaw::Short => self.damaged(done, "its data end early"),
            Flaw::Strange => self.damaged(done, "the decoder cannot follow its data"),
            Flaw::Uneven => self.damaged(done, "its points do not end where its data do"),
            Flaw::Io(error) => Error::io(self.source.path(), format!("decode {}", self.name), error),
        }
    }

    fn damaged(&self, done: u64, what: &str) -> Error {
        let reason = format!("damaged: {what}, after {done} of {} points; fetch or write the file again", self.points);
        Error::input(self.source.path(), self.name.clone(), reason).with_suggestion(Parameter::Incomplete)
    }
}
