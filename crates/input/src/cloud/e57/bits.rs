//! Values of a column out of the bits of its packets.

use super::Needed;
use super::description::Kind;
use crate::cloud::Piece;

/// Bits of one column in one piece.
pub(super) struct Bits {
    kind: Kind,
    bits: usize,
    /// Wanted bytes, as a range in the column.
    wanted: std::ops::Range<u64>,
    /// The wanted bytes, followed by enough zeros to read any value as two words.
    bytes: Vec<u8>,
    held: usize,
    /// Offset of the first value in the first byte (bits).
    shift: usize,
}

impl Bits {
    pub(super) fn of(column: &Needed, piece: &Piece) -> Self {
        // No overflow: the file holds as many bits of this column.
        let (first, end) = (piece.first * column.bits, piece.end * column.bits);
        let wanted = first / 8..end.div_ceil(8);
        let len = (wanted.end - wanted.start) as usize;
        Self {
            kind: column.kind,
            bits: column.bits as usize,
            bytes: vec![0; len + 16],
            held: 0,
            shift: (first % 8) as usize,
            wanted,
        }
    }

    pub(super) fn is_full(&self) -> bool {
        self.held as u64 == self.wanted.end - self.wanted.start
    }

    /// Copies the wanted bytes from a part of the column that begins at its byte `at`.
    pub(super) fn take(&mut self, piece: &[u8], at: u64) {
        let begin = self.wanted.start + self.held as u64;
        let end = self.wanted.end.min(at + piece.len() as u64);
        if begin >= end || begin < at {
            return;
        }
        let own = &piece[(begin - at) as usize..(end - at) as usize];
        self.bytes[self.held..self.held + own.len()].copy_from_slice(own);
        self.held += own.len();
    }

    #[inline]
    pub(super) fn value(&self, number: usize) -> f64 {
        let bit = self.shift + number * self.bits;
        let word = |at: usize| u64::from_le_bytes(self.bytes[at..at + 8].try_into().unwrap_or_default());
        let (at, shift) = (bit / 8, bit % 8);
        match self.kind {
            Kind::Single => f64::from(f32::from_bits(word(at) as u32)),
            Kind::Double => f64::from_bits(word(at)),
            Kind::Integer { min, scale, offset, .. } => {
                let raw = if self.bits == 0 {
                    0
                } else {
                    let low = word(at) >> shift;
                    let high = if shift > 0 { u64::from(self.bytes[at + 8]) << (64 - shift) } else { 0 };
                    (low | high) & (u64::MAX >> (64 - self.bits))
                };
                min.wrapping_add(raw as i64) as f64 * scale + offset
            }
        }
    }
}
