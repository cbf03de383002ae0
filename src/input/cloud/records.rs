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

/// Red, green and blue within a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rgb {
    /// A number each.
    Fields([Field; 3]),
    /// The bytes of a number, blue lowest.
    Bytes(Field),
}

impl Rgb {
    /// Three numbers of a type that says what is white; `None` for others.
    pub fn of(fields: [Option<Field>; 3]) -> Option<Self> {
        let [Some(r), Some(g), Some(b)] = fields else { return None };
        let known = |field: &Field| matches!(field.number, Number::U8 | Number::U16 | Number::F32 | Number::F64);
        [r, g, b].iter().all(known).then_some(Self::Fields([r, g, b]))
    }

    /// As 16-bit values.
    fn read(&self, record: &[u8], big: bool) -> [u16; 3] {
        match self {
            Self::Fields(fields) => fields.map(|field| {
                let value = field.number.read(&record[field.at..], big);
                let white = match field.number {
                    Number::U8 => 257.0,
                    Number::U16 => 1.0,
                    _ => 65_535.0,
                };
                // NaN becomes 0.
                (value * white).clamp(0.0, 65_535.0).round() as u16
            }),
            Self::Bytes(field) => {
                let bytes = &record[field.at..field.at + 4];
                let at = |place: usize| u16::from(bytes[if big { 3 - place } else { place }]) * 257;
                [at(2), at(1), at(0)]
            }
        }
    }
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
    pub rgb: Option<Rgb>,
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

    fn has_rgb(&self) -> bool {
        self.rgb.is_some()
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
        let rgb = self.rgb.filter(|_| taker.wants_rgb());
        let at_once = (SLAB_BYTES / self.stride).max(1) as u64;
        let mut next = piece.first;
        while next < piece.end {
            let want = (piece.end - next).min(at_once) as usize * self.stride;
            scratch.resize(want, 0);
            let got = source.read_at(scratch, self.start + next * self.stride as u64)? / self.stride;
            for record in scratch.chunks_exact(self.stride).take(got) {
                let value = |field: Field| field.number.read(&record[field.at..], self.big);
                let values = rgb.map(|rgb| rgb.read(record, self.big));
                taker.push_with(self.axes.map(value), class.map(value), values)?;
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
