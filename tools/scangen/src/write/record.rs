//! Point records as bytes (LAS 1.4 R15, tables 7 to 16).

use crate::sample::Kind;

/// Lengths of point formats 0 to 10 `[bytes]`.
const LENGTHS: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
/// Longest record.
pub(super) const MAX_RECORD: usize = 67;

/// Contents of a record.
#[derive(Debug, Clone, Copy)]
pub(super) struct Record {
    pub grid: [i32; 3],
    pub class: u8,
    pub withheld: bool,
    pub index: u64,
    /// Red, green and blue if the format has them; `None` for meaningless values.
    pub colour: Option<[u16; 3]>,
}

/// Length of a record of `format` `[bytes]`; `None` for an unknown format.
pub(super) fn record_len(format: u8) -> Option<usize> {
    LENGTHS.get(usize::from(format)).copied()
}

/// Returns whether records of `format` have colours.
pub(super) fn has_colour(format: u8) -> bool {
    matches!(format, 2 | 3 | 5 | 7 | 8 | 10)
}

/// ASPRS class of a kind: 7 (low noise) for points that a filter should drop, otherwise 1 (unclassified).
pub(super) fn class_of(kind: Kind) -> u8 {
    match kind {
        Kind::Outlier | Kind::Mixed => 7,
        Kind::Surface | Kind::Moving => 1,
    }
}

/// Writes `record` in `format` to the front of `out`; fields not set here stay zero.
#[inline]
pub(super) fn encode(format: u8, record: &Record, out: &mut [u8]) {
    for (axis, value) in record.grid.into_iter().enumerate() {
        out[axis * 4..axis * 4 + 4].copy_from_slice(&value.to_le_bytes());
    }
    // A value that varies from point to point but not randomly: the index, spread over 16 bits.
    let varied = (record.index.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 52) as u16;
    out[12..14].copy_from_slice(&(varied + 1000).to_le_bytes());
    let time = (record.index as f64 * 1e-5).to_le_bytes();
    let color = if format < 6 {
        out[14] = 1 | 1 << 3;
        out[15] = record.class & 31 | u8::from(record.withheld) << 7;
        match format {
            1 | 4 => {
                out[20..28].copy_from_slice(&time);
                None
            }
            3 | 5 => {
                out[20..28].copy_from_slice(&time);
                Some((28, 3))
            }
            2 => Some((20, 3)),
            _ => None,
        }
    } else {
        out[14] = 1 | 1 << 4;
        out[15] = u8::from(record.withheld) << 2;
        out[16] = record.class;
        out[22..30].copy_from_slice(&time);
        match format {
            7 => Some((30, 3)),
            8 | 10 => Some((30, 4)),
            _ => None,
        }
    };
    if let Some((at, bands)) = color {
        for band in 0..bands {
            let value = record.colour.map_or(varied << 4, |colour| colour.get(band).copied().unwrap_or_default());
            out[at + 2 * band..at + 2 * band + 2].copy_from_slice(&value.to_le_bytes());
        }
    }
}
