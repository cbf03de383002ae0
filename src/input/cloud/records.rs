//! Binary records of one length: PLY and PCD.

use super::{Cloud, Opening, Piece, Source, Taker};
use crate::Result;
use crate::input::number::Number;

/// Points of a piece.
const PIECE_POINTS: u64 = 1 << 17;
/// Bytes read at once, or one record.
const SLAB_BYTES: usize = 1 << 20;
/// Longest record (bytes).
pub(super) const MOST_BYTES: usize = 1 << 16;

/// A number within a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Field {
    pub at: usize,
    pub number: Number,
}

/// Where the records lie, and the coordinates in them.
#[derive(Debug)]
pub(super) struct Records {
    pub format: &'static str,
    pub start: u64,
    /// Bytes of a record [1..=MOST_BYTES]; fields lie inside.
    pub stride: usize,
    pub stated: u64,
    pub points: u64,
    pub axes: [Field; 3],
    pub class: Option<Field>,
    pub big: bool,
}

impl Records {
    /// As many of the `stated` records from byte `start` on as the file holds; fewer are a loss.
    pub fn held(opening: &mut Opening<'_, '_>, start: u64, stride: usize, stated: u64) -> Result<u64> {
        let room = opening.bytes.saturating_sub(start) / stride as u64;
        if room < stated {
            opening.findings.lose(format!("the header states {stated} points, the file holds {room} whole ones"))?;
        }
        Ok(stated.min(room))
    }
}

impl Cloud for Records {
    fn format(&self) -> &'static str {
        self.format
    }

    fn points_stated(&self) -> u64 {
        self.stated
    }

    fn points_expected(&self) -> u64 {
        self.points
    }

    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_> {
        Box::new((0..self.points.div_ceil(PIECE_POINTS)).map(|number| {
            let first = number * PIECE_POINTS;
            let end = self.points.min(first + PIECE_POINTS);
            Piece { points: end - first, part: 0, first, end }
        }))
    }

    fn decode(&self, piece: &Piece, source: &Source, scratch: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64> {
        let class = self.class.filter(|_| taker.wants_classes());
        let at_once = (SLAB_BYTES / self.stride).max(1) as u64;
        let mut next = piece.first;
        while next < piece.end {
            let want = (piece.end - next).min(at_once) as usize * self.stride;
            scratch.resize(want, 0);
            let got = source.read_at(scratch, self.start + next * self.stride as u64)? / self.stride;
            for record in scratch.chunks_exact(self.stride).take(got) {
                let value = |field: Field| field.number.read(&record[field.at..], self.big);
                taker.push(self.axes.map(value), class.map(value))?;
            }
            next += got as u64;
            if got * self.stride < want {
                break; // the file became shorter since it was opened
            }
        }
        Ok(piece.end - next)
    }

    fn state(&self) -> Vec<u8> {
        let fields = self.axes.iter().chain(&self.class).flat_map(|field| [field.at as u64, field.number as u64]);
        let numbers = [self.start, self.stride as u64, self.points, u64::from(self.big)].into_iter().chain(fields);
        numbers.flat_map(u64::to_le_bytes).collect()
    }
}
