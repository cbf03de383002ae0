//! SPZ: one column per parameter. Versions 1 to 3 are one gzip stream, or the same bytes bare; version 4 has a header in
//! the clear and one zstd stream per column, which are decompressed side by side.
//!
//! Version 1 has centres in half precision; 2 and later in fixed point of 24 bits. Up to version 2 the quaternion is
//! x, y, z in bytes, later its three smaller components in ten bits each.

use super::columns::{Column, Part, read_error};
use super::gate::{Gate, Raw, colour_of, smallest_three};
use super::store::Store;
use super::{Body, Work, is_all, refuse};
use flate2::bufread::GzDecoder;
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::counted;
use slicewalk_base::{Error, Result};
use slicewalk_input::number::Number;
use slicewalk_input::unzstd::unzstd;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

const OLD_HEADER_BYTES: usize = 16;
const HEADER_BYTES: u64 = 32;
/// Rows decoded at once.
const ROWS: u64 = 1 << 13;
/// Coefficients of spherical harmonics by degree.
const HARMONICS: [u64; 5] = [0, 9, 24, 45, 72];
const COLOUR_SCALE: f64 = 0.15;
const FLAG_EXTENSIONS: u8 = 2;
/// Columns that are read, without the harmonics.
const COLUMNS: usize = 5;

#[derive(Debug, Clone, Copy)]
struct Header {
    version: u32,
    count: u64,
    harmonics: u64,
    fraction: f64,
    flags: u8,
    streams: u8,
}

impl Header {
    fn parse(bytes: &[u8; OLD_HEADER_BYTES], path: &Path) -> Result<Self> {
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let wrong = |reason: String| Err(refuse(path, "SPZ header", reason));
        let (version, count, degree, bits) = (word(4), u64::from(word(8)), bytes[12], bytes[13]);
        if &bytes[..4] != b"NGSP" {
            return wrong("expected NGSP, found other bytes: this is no SPZ, or damaged".into());
        }
        if !(1..=4).contains(&version) {
            return wrong(format!("expected version 1 to 4, found {version}; export it as one of these"));
        }
        let Some(&harmonics) = HARMONICS.get(usize::from(degree)) else {
            return wrong(format!("expected harmonics of degree 0 to 4, found {degree}; fetch or write it again"));
        };
        if bits > 30 {
            return wrong(format!("expected at most 30 fractional bits, found {bits}; fetch or write it again"));
        }
        let fraction = 1.0 / f64::from(1u32 << bits);
        Ok(Self { version, count, harmonics, fraction, flags: bytes[14], streams: bytes[15] })
    }

    /// Bytes a splat of centres, opacities, colours, sizes and quaternions.
    fn widths(&self) -> [u64; COLUMNS] {
        [if self.version == 1 { 6 } else { 9 }, 1, 3, 3, if self.version > 2 { 4 } else { 3 }]
    }

    fn splat(&self, [mean, alpha, colour, scale, rotation]: [&[u8]; COLUMNS]) -> Raw {
        let part = |byte: u8| f64::from(byte);
        let three = |bytes: &[u8], f: &dyn Fn(f64) -> f64| [0, 1, 2].map(|at| f(part(bytes[at])));
        let mean = [0, 1, 2].map(|axis| match self.version {
            1 => Number::F16.read(&mean[axis * 2..], false),
            _ => {
                let at = axis * 3;
                f64::from(i32::from_le_bytes([0, mean[at], mean[at + 1], mean[at + 2]]) >> 8) * self.fraction
            }
        });
        let rotation = if self.version > 2 {
            let packed = u32::from_le_bytes([rotation[0], rotation[1], rotation[2], rotation[3]]);
            let small = [20, 10, 0].map(|shift| {
                let size = f64::from((packed >> shift) & 511) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
                if (packed >> shift) & 512 == 0 { size } else { -size }
            });
            let [x, y, z, w] = smallest_three(small, (packed >> 30) as usize);
            [w, x, y, z]
        } else {
            let [x, y, z] = three(rotation, &|v| v / 127.5 - 1.0);
            smallest_three([x, y, z], 0)
        };
        Raw {
            mean,
            scale: three(scale, &|v| libm::exp(v / 16.0 - 10.0)),
            rotation,
            opacity: part(alpha[0]) / 255.0,
            colour: three(colour, &|v| colour_of((v / 255.0 - 0.5) / COLOUR_SCALE)),
        }
    }
}

/// How the columns are stored.
enum Packing {
    /// As they are.
    Bare,
    Gzip {
        /// Columns of an earlier pass.
        columns: Option<Arc<dyn ByteSource>>,
    },
    /// Start and length of the stream of each column (bytes).
    Zstd([(u64, u64); COLUMNS]),
}

pub struct Spz {
    source: Arc<dyn ByteSource>,
    header: Header,
    packing: Packing,
    /// Bytes behind the last stream.
    behind: u64,
}

impl Spz {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let mut start = [0; OLD_HEADER_BYTES];
        let cut = |e| read_error(path, "SPZ header", e);
        Column::rest(&source, 0).read_exact(&mut start).map_err(cut)?;
        if start.starts_with(&[0x1F, 0x8B]) {
            GzDecoder::new(Column::rest(&source, 0)).read_exact(&mut start).map_err(cut)?;
            let header = Header::parse(&start, path)?;
            if header.version > 3 {
                return Err(refuse(path, "SPZ header", "expected version 1 to 3 inside gzip, found 4; write it again"));
            }
            return Ok(Self { source, header, packing: Packing::Gzip { columns: None }, behind: 0 });
        }
        let header = Header::parse(&start, path)?;
        if header.version < 4 {
            return Ok(Self { source, header, packing: Packing::Bare, behind: 0 });
        }
        let (streams, behind) = Self::streams(&source, &header, path)?;
        Ok(Self { source, header, packing: Packing::Zstd(streams), behind })
    }

    /// Reads and checks the table of streams; returns them, and the number of bytes behind the last.
    fn streams(source: &Arc<dyn ByteSource>, header: &Header, path: &Path) -> Result<([(u64, u64); COLUMNS], u64)> {
        let wrong = |reason: String| refuse(path, "SPZ streams", reason);
        let mut place = [0; 4];
        let table_error = |e| read_error(path, "SPZ table of streams", e);
        Column::rest(source, OLD_HEADER_BYTES as u64).read_exact(&mut place).map_err(table_error)?;
        let table_at = u64::from(u32::from_le_bytes(place));
        if table_at < HEADER_BYTES {
            return Err(wrong(format!(
                "expected the table behind the header of 32 bytes, found it at byte {table_at}"
            )));
        }
        let mut widths = header.widths().to_vec();
        widths.push(header.harmonics);
        widths.retain(|width| width * header.count > 0);
        if usize::from(header.streams) != widths.len() {
            let (expected, found) = (widths.len(), header.streams);
            return Err(wrong(format!("expected {expected} streams, found {found}; fetch or write it again")));
        }
        let mut table = vec![0; widths.len() * 16];
        Column::rest(source, table_at).read_exact(&mut table).map_err(table_error)?;
        let mut at = table_at + table.len() as u64;
        let mut streams = [(0, 0); COLUMNS];
        for (number, (width, entry)) in widths.iter().zip(table.chunks_exact(16)).enumerate() {
            let long = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| entry[at + byte]));
            let (packed, stated, expected) = (long(0), long(8), width * header.count);
            if stated != expected {
                return Err(wrong(format!("expected {expected} bytes in stream {number}, found {stated}")));
            }
            if packed > source.len().saturating_sub(at) {
                let rest = source.len().saturating_sub(at);
                return Err(wrong(format!(
                    "stream {number} states {packed} bytes, and the file holds {rest}: it is cut"
                )));
            }
            if let Some(stream) = streams.get_mut(number) {
                *stream = (at, packed);
            }
            at += packed;
        }
        Ok((streams, source.len().saturating_sub(at)))
    }

    /// Decompresses the columns, without the harmonics. If the stream is damaged, returns the intact beginning and the
    /// error.
    fn unpack(&self, work: &Work<'_>) -> Result<(Store, Option<Error>)> {
        let mut rest = self.header.widths().iter().sum::<u64>() * self.header.count + OLD_HEADER_BYTES as u64;
        let mut behind = self.header.harmonics * self.header.count;
        let mut store = Store::new(work, work.memory / 2);
        let mut gzip = GzDecoder::new(Column::rest(&self.source, 0));
        let mut block = vec![0; 1 << 16];
        let mut extra = 0;
        loop {
            if work.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            // Reads to the end of the stream, where its checksum stands.
            let len = match gzip.read(&mut block) {
                Ok(0) => break,
                Ok(len) => len as u64,
                Err(error) => {
                    let error = read_error(work.path, "gzip stream", error);
                    return if matches!(error, Error::Input { .. }) { Ok((store, Some(error))) } else { Err(error) };
                }
            };
            let kept = len.min(rest);
            store.append(&block[..kept as usize])?;
            rest -= kept;
            extra += (len - kept).saturating_sub(behind);
            behind = behind.saturating_sub(len - kept);
        }
        if rest + behind > 0 {
            let reason = format!("the data end {} bytes before their stated length; fetch it again", rest + behind);
            return Ok((store, Some(refuse(work.path, "SPZ data", reason))));
        }
        let behind = gzip.into_inner();
        if extra > 0 && self.header.flags & FLAG_EXTENSIONS == 0 {
            let reason = format!("{} follow the last column; fetch or write it again", counted(extra, "byte"));
            return Ok((store, Some(refuse(work.path, "SPZ data", reason))));
        }
        if !is_all(behind, |byte| *byte == 0, work)? {
            let reason = "other data follow the gzip stream; fetch or write the file again";
            return Ok((store, Some(refuse(work.path, "gzip stream", reason))));
        }
        Ok((store, None))
    }

    /// Passes on the rows that `columns` hold; each is read in step with the others.
    fn pass(
        &self,
        columns: &mut [Box<dyn Read + '_>; COLUMNS],
        rows: u64,
        path: &Path,
        gate: &mut Gate<'_>,
    ) -> Result<()> {
        let widths = self.header.widths();
        let mut blocks = widths.map(|width| vec![0; (width * ROWS.min(rows)) as usize]);
        let mut done = 0;
        while done < rows {
            let count = ROWS.min(rows - done);
            for ((column, block), width) in columns.iter_mut().zip(&mut blocks).zip(widths) {
                let read = column.read_exact(&mut block[..(width * count) as usize]);
                if let Err(error) = read.map_err(|e| read_error(path, format!("splat {done}"), e)) {
                    return if matches!(error, Error::Input { .. }) { gate.break_off(error) } else { Err(error) };
                }
            }
            for row in 0..count {
                let [a, b, c, d, e] = std::array::from_fn(|column| {
                    let width = widths[column] as usize;
                    &blocks[column][row as usize * width..][..width]
                });
                gate.push(self.header.splat([a, b, c, d, e]))?;
            }
            done += count;
        }
        Ok(())
    }

    /// Passes on columns that lie one behind the other in `source`.
    fn pass_bare(&self, source: &Arc<dyn ByteSource>, path: &Path, gate: &mut Gate<'_>) -> Result<()> {
        let (widths, count) = (self.header.widths(), self.header.count);
        let mut at = OLD_HEADER_BYTES as u64;
        let starts = widths.map(|width| {
            at += width * count;
            at - width * count
        });
        let there = starts.iter().zip(widths).map(|(start, width)| source.len().saturating_sub(*start) / width);
        let rows = there.min().unwrap_or(0).min(count);
        gate.miss(count - rows)?;
        let mut columns =
            std::array::from_fn(|n| Box::new(Column::new(source, starts[n], widths[n] * count)) as Box<dyn Read>);
        self.pass(&mut columns, rows, path, gate)
    }
}

impl Body for Spz {
    fn count(&self) -> u64 {
        self.header.count
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        match &self.packing {
            Packing::Bare => {
                let harmonics = self.header.harmonics * self.header.count;
                let whole = self.header.widths().iter().sum::<u64>() * self.header.count + OLD_HEADER_BYTES as u64;
                match self.source.len() {
                    len if len < whole + harmonics => {
                        let expected = whole + harmonics;
                        let reason = format!("expected {expected} bytes, found {len}: the file is cut; fetch it again");
                        gate.refuse(refuse(work.path, "length", reason))?;
                    }
                    len if len > whole + harmonics && self.header.flags & FLAG_EXTENSIONS == 0 => {
                        let end = whole + harmonics;
                        if !is_all(Column::rest(&self.source, end), |byte| *byte == 0, work)? {
                            let reason = format!("expected {end} bytes, found {len}; fetch or write it again");
                            gate.refuse(refuse(work.path, "length", reason))?;
                        }
                    }
                    _ => {}
                }
                self.pass_bare(&self.source.clone(), work.path, gate)
            }
            Packing::Gzip { columns: Some(columns) } => self.pass_bare(&columns.clone(), work.path, gate),
            Packing::Gzip { columns: None } => {
                let (store, damage) = self.unpack(work)?;
                let store: Arc<dyn ByteSource> = Arc::new(store);
                match damage {
                    None => self.packing = Packing::Gzip { columns: Some(store.clone()) },
                    Some(error) if !work.options.allow_incomplete => return gate.break_off(error),
                    Some(error) => gate.refuse(error)?,
                }
                self.pass_bare(&store, work.path, gate)
            }
            Packing::Zstd(_) if self.header.count == 0 => Ok(()),
            Packing::Zstd(streams) => {
                let end = self.source.len() - self.behind;
                if self.header.flags & FLAG_EXTENSIONS == 0
                    && !is_all(Column::rest(&self.source, end), |byte| *byte == 0, work)?
                {
                    let found = self.source.len();
                    let reason = format!("expected {end} bytes, found {found}; fetch or write it again");
                    gate.refuse(refuse(work.path, "length", reason))?;
                }
                let mut columns = Vec::with_capacity(COLUMNS);
                for (number, &(start, len)) in streams.iter().enumerate() {
                    let part = Part::new(&self.source, start, len)
                        .ok_or_else(|| refuse(work.path, "SPZ streams", format!("stream {number} is cut")))?;
                    columns.push(Column::rest(&(Arc::new(part) as Arc<dyn ByteSource>), 0));
                }
                // All windows together stay within the memory; the usual ones have at most 8 MiB.
                let window = (work.memory / 8).ilog2().min(27);
                let open = |column| -> std::io::Result<Box<dyn Read>> { unzstd(column, window) };
                let columns = columns.into_iter().map(open).collect::<std::io::Result<Vec<_>>>();
                let columns = columns.map_err(|e| read_error(work.path, "SPZ streams", e))?;
                let Ok(mut columns) = <[Box<dyn Read>; COLUMNS]>::try_from(columns) else { return Ok(()) };
                self.pass(&mut columns, self.header.count, work.path, gate)?;
                for column in &mut columns {
                    // The checksum of a stream stands at its end.
                    match column.read(&mut [0]).map_err(|e| read_error(work.path, "SPZ streams", e)) {
                        Ok(0) => {}
                        Ok(_) => {
                            let reason = "a stream holds more bytes than it states; fetch or write it again";
                            gate.refuse(refuse(work.path, "SPZ streams", reason))?;
                        }
                        Err(error @ Error::Input { .. }) => gate.refuse(error)?,
                        Err(error) => return Err(error),
                    }
                }
                Ok(())
            }
        }
    }
}
