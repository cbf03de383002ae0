//! The public header block of LAS 1.0 to 1.5, every number checked against the file's length.
//!
//! Input: an open file. Output: the facts that decoding needs, or one line that names the wrong byte.
//! Memory: 512 bytes. Standard: "LAS Specification 1.4 - R15" (ASPRS), sections 2.4 and 2.6; offsets below are bytes.
//!
//! The crate `las` is not used: it reads all fields of a version regardless of the stated header length, so it fails on
//! headers with a wrong version or length although the points are sound.

use super::source::Source;
use crate::{Error, Result};

/// Length of the oldest header (bytes), the shortest of all versions.
const SHORTEST: u16 = 227;
/// Minimum header length with the LAS 1.3 field (offset of the waveforms).
const WITH_WAVEFORMS: u16 = 235;
/// Minimum header length with the LAS 1.4 fields (64-bit counts, extended records).
const WITH_LONG_COUNTS: u16 = 375;
/// Record length of each point format without extra bytes.
const RECORD_BYTES: [u16; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// A checked header.
#[derive(Debug, Clone)]
pub(super) struct LasHeader {
    pub version: (u8, u8),
    /// The global encoding states that the reference system is well-known text.
    pub says_wkt: bool,
    pub header_bytes: u16,
    /// Offset of the first point; may lie beyond the end of a truncated file.
    pub points_at: u64,
    pub records: u32,
    pub format: u8,
    pub compressed: bool,
    pub record_bytes: u16,
    /// Point count stated by the header; only a hint.
    pub points_stated: u64,
    /// Sum of the point counts by return; 0 if absent.
    pub points_by_return: u64,
    pub scale: [f64; 3],
    pub offset: [f64; 3],
    /// Minimum and maximum corner stated by the header, in file units.
    pub bounds: [[f64; 3]; 2],
    /// Offset of the waveforms (LAS 1.3 and later); 0 if absent.
    pub waveforms_at: u64,
    pub first_extended: u64,
    pub extended: u32,
    /// Warnings for the monitor.
    pub notes: Vec<String>,
}

impl LasHeader {
    pub(super) fn read(source: &Source, file_bytes: u64) -> Result<Self> {
        let mut block = [0u8; 512];
        let got = source.read_at(&mut block, 0)?;
        let bad = |at: &str, reason: String| Err(Error::input(source.path(), at, reason));
        if got < 4 || &block[..4] != b"LASF" {
            return bad("byte 0", format!("no LAS or LAZ file: expected \"LASF\", found {}", quote(&block[..got])));
        }
        if got < usize::from(SHORTEST) {
            return bad("header", format!("the file ends after {got} bytes, within its header of at least {SHORTEST}"));
        }
        let version = (block[24], block[25]);
        if version.0 != 1 || version.1 > 5 {
            return Err(Error::Unsupported {
                what: format!("{}: LAS version {}.{}", source.path().display(), version.0, version.1),
                version: env!("CARGO_PKG_VERSION"),
                suggestion: "versions 1.0 to 1.5 are read; rewrite the file in one of them".into(),
            });
        }
        let header_bytes = u16_at(&block, 94);
        let points_at = u64::from(u32_at(&block, 96));
        if header_bytes == 0 || points_at == 0 {
            let reason = format!(
                "header length {header_bytes} and offset to the points {points_at}: the program that wrote this file \
                 was interrupted; write or fetch the file again"
            );
            return bad("header, byte 94", reason);
        }
        if header_bytes < SHORTEST || u64::from(header_bytes) > file_bytes {
            let reason = format!("header length {header_bytes}, expected {SHORTEST} to the file's length {file_bytes}");
            return bad("header, byte 94", reason);
        }
        if points_at < u64::from(header_bytes) {
            let reason = format!("the points begin at byte {points_at}, within the header of {header_bytes} bytes");
            return bad("header, byte 96", reason);
        }
        let format = block[104] & 0x3F;
        let Some(&least) = RECORD_BYTES.get(usize::from(format)) else {
            return Err(Error::Unsupported {
                what: format!("{}: point format {format}", source.path().display()),
                version: env!("CARGO_PKG_VERSION"),
                suggestion: "formats 0 to 10 are read; rewrite the file in one of them".into(),
            });
        };
        let record_bytes = u16_at(&block, 105);
        if record_bytes < least {
            let reason = format!("records of {record_bytes} bytes, but point format {format} takes at least {least}");
            return bad("header, byte 105", reason);
        }
        let mut notes = Vec::new();
        let long = version.1 >= 4 && header_bytes >= WITH_LONG_COUNTS;
        let old_count = u64::from(u32_at(&block, 107));
        let points_stated = match if long { u64_at(&block, 247) } else { 0 } {
            0 => old_count,
            count => {
                if old_count != 0 && old_count != count {
                    notes.push(format!("the header states {count} points and, in its older field, {old_count}"));
                }
                count
            }
        };
        let sum = |counts: &[u64]| counts.iter().fold(0, |sum: u64, &count| sum.saturating_add(count));
        let old_by_return: [u64; 5] = std::array::from_fn(|number| u32_at(&block, 111 + 4 * number).into());
        let by_return: [u64; 15] = std::array::from_fn(|number| u64_at(&block, 255 + 8 * number));
        let points_by_return = match if long { sum(&by_return) } else { 0 } {
            0 => sum(&old_by_return),
            count => count,
        };
        let triple = |at: usize| [f64_at(&block, at), f64_at(&block, at + 8), f64_at(&block, at + 16)];
        let header = Self {
            version,
            says_wkt: u16_at(&block, 6) & 0x10 != 0 && version.1 >= 4,
            header_bytes,
            points_at,
            records: u32_at(&block, 100),
            format,
            compressed: block[104] & 0x80 != 0,
            record_bytes,
            points_stated,
            points_by_return,
            scale: triple(131),
            offset: triple(155),
            bounds: [
                [f64_at(&block, 187), f64_at(&block, 203), f64_at(&block, 219)],
                [f64_at(&block, 179), f64_at(&block, 195), f64_at(&block, 211)],
            ],
            waveforms_at: if version.1 >= 3 && header_bytes >= WITH_WAVEFORMS { u64_at(&block, 227) } else { 0 },
            first_extended: if long { u64_at(&block, 235) } else { 0 },
            extended: if long { u32_at(&block, 243) } else { 0 },
            notes,
        };
        if points_stated > 0 {
            header.check_scale(source)?;
        }
        Ok(header)
    }

    /// Checks that scales and offsets yield finite coordinates. A negative scale mirrors an axis: unusual, but
    /// well-defined, so it is accepted.
    fn check_scale(&self, source: &Source) -> Result<()> {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let (scale, offset) = (self.scale[axis], self.offset[axis]);
            if scale == 0.0 || !scale.is_finite() {
                let reason = format!("the scale of {name} is {scale}; expected a finite number other than 0");
                return Err(Error::input(source.path(), format!("header, byte {}", 131 + 8 * axis), reason));
            }
            if !offset.is_finite() {
                let reason = format!("the offset of {name} is {offset}; expected a finite number");
                return Err(Error::input(source.path(), format!("header, byte {}", 155 + 8 * axis), reason));
            }
        }
        Ok(())
    }
}

/// Quotes the first bytes of a file in another format as readable text.
fn quote(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "an empty file".into();
    }
    let start = &bytes[..bytes.len().min(40)];
    let line: Vec<u8> = start.iter().copied().take_while(|&b| b != b'\n' && b != b'\r').collect();
    if !line.is_empty() && line.iter().all(|b| matches!(b, b' '..=b'~' | b'\t')) {
        return format!("text: \"{}\"", String::from_utf8_lossy(&line).replace('\t', " "));
    }
    let hex: Vec<String> = start.iter().take(8).map(|b| format!("{b:02x}")).collect();
    format!("the bytes {}", hex.join(" "))
}

/// Reads a little-endian number; the caller ensures that `bytes` is long enough.
pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from(u16_at(bytes, at)) | u32::from(u16_at(bytes, at + 2)) << 16
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

pub(super) fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}
