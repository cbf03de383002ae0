//! Binary records of fixed length: PLY and PCD.

use super::values::{Channels, Kind, SAMPLE_PLACES, SAMPLE_POINTS, Sample, bytes_of};
use super::{Cloud, Depth, Opening, Piece, Source, Taker};
use crate::Result;
use crate::colour::ColourSource;
use crate::number::Number;

/// Points per piece.
const PIECE_POINTS: u64 = 1 << 17;
/// Bytes read at once, unless a single record is longer.
const SLAB_BYTES: usize = 1 << 20;
/// Maximum record length (bytes).
pub(super) const MOST_BYTES: usize = 1 << 16;

/// A number in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Field {
    pub at: usize,
    pub number: Number,
}

/// Red, green and blue in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rgb {
    /// One number each.
    Fields([Field; 3]),
    /// Bytes of a single number, blue lowest.
    Bytes(Field),
}

/// Returns the kind of a channel stored in these number types.
pub(super) fn kind_of(numbers: &[Number]) -> Kind {
    match numbers {
        _ if numbers.iter().all(|number| number.bytes() == 1) => Kind::Bytes,
        _ if numbers.iter().any(|number| matches!(number, Number::F16 | Number::F32 | Number::F64)) => Kind::Any,
        _ => Kind::Whole,
    }
}

/// Colour values in a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Values {
    rgb: Option<Rgb>,
    intensity: Option<Field>,
    pub channels: Channels,
}

impl Values {
    pub fn new(rgb: Option<Rgb>, intensity: Option<Field>) -> Self {
        let of_rgb = |rgb: Rgb| match rgb {
            Rgb::Fields(fields) => kind_of(&fields.map(|field| field.number)),
            Rgb::Bytes(_) => Kind::Bytes,
        };
        let channels = Channels::new(rgb.map(of_rgb), intensity.map(|field| kind_of(&[field.number])));
        Self { rgb, intensity, channels }
    }

    /// Returns the fields that a source needs: one, or three.
    pub fn fields(&self, source: ColourSource) -> Option<Rgb> {
        match source {
            ColourSource::Rgb => self.rgb,
            ColourSource::Intensity => self.intensity.map(Rgb::Bytes),
            ColourSource::Class => None,
        }
    }

    /// Returns the value of a record for `source`: `read` reads a field as a number, `bits` as packed colours.
    #[inline]
    pub fn of(
        &self,
        source: ColourSource,
        read: impl Fn(Field) -> f64,
        bits: impl Fn(Field) -> u32,
    ) -> Option<[u16; 3]> {
        let scale = self.channels.scale();
        Some(match (source, self.rgb) {
            (ColourSource::Intensity, _) => [scale.of(read(self.intensity?)), 0, 0],
            (ColourSource::Rgb, Some(Rgb::Fields(fields))) => fields.map(|field| scale.of(read(field))),
            (ColourSource::Rgb, Some(Rgb::Bytes(field))) => bytes_of(bits(field)),
            _ => return None,
        })
    }

    /// Adds the numbers of `source` that `read` reads from a record to a sample.
    pub fn look(&self, source: ColourSource, read: impl Fn(Field) -> f64, sample: &mut Sample) {
        match (source, self.rgb) {
            (ColourSource::Intensity, _) => self.intensity.into_iter().for_each(|field| sample.add(read(field))),
            (ColourSource::Rgb, Some(Rgb::Fields(fields))) => fields.into_iter().for_each(|f| sample.add(read(f))),
            _ => {}
        }
    }
}

/// Reads the 32 bits of a packed colour, which only PCD has: lowest byte first.
#[inline]
pub(super) fn bits_of(at: &[u8]) -> u32 {
    u32::from_le_bytes([at[0], at[1], at[2], at[3]])
}

/// Location of the records, and of the coordinates in them.
#[derive(Debug)]
pub(super) struct Records {
    pub format: &'static str,
    pub start: u64,
    /// Record length (bytes) [1..=MOST_BYTES]; all fields lie inside.
    pub stride: usize,
    pub stated: u64,
    pub points: u64,
    pub axes: [Field; 3],
    pub class: Option<Field>,
    pub values: Values,
    pub big: bool,
}

impl Records {
    /// Returns how many of the `stated` records from byte `start` on the file holds; fewer are a loss.
    pub fn held(opening: &mut Opening<'_, '_>, start: u64, stride: usize, stated: u64) -> Result<u64> {
        let room = opening.bytes.saturating_sub(start) / stride as u64;
        if room < stated {
            let text = format!("the header states {stated} points, the file holds {room} whole ones");
            opening.findings.lose_points(stated - room, text)?;
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

    fn has_values(&self, source: ColourSource) -> bool {
        if source == ColourSource::Class { self.class.is_some() } else { self.values.channels.has(source) }
    }

    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()> {
        let mut sample = Sample::NOTHING;
        let places = if self.values.channels.is_open(source) { SAMPLE_PLACES } else { 0 };
        let mut bytes = Vec::new();
        for place in 0..places {
            let first = (u128::from(self.points) * u128::from(place) / u128::from(places)) as u64;
            bytes.resize(SAMPLE_POINTS.min(SLAB_BYTES / self.stride).max(1) * self.stride, 0);
            let got = file.read_at(&mut bytes, self.start + first * self.stride as u64)? / self.stride;
            let of_cloud = (self.points - first).min(got as u64) as usize;
            for record in bytes.chunks_exact(self.stride).take(of_cloud) {
                self.values.look(source, |field| field.number.read(&record[field.at..], self.big), &mut sample);
            }
        }
        self.values.channels.settle(source, &sample);
        Ok(())
    }

    fn depth(&self) -> Depth {
        self.values.channels.depth()
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
        let wanted = taker.wanted();
        let at_once = (SLAB_BYTES / self.stride).max(1) as u64;
        let is_single = self.axes.map(|axis| axis.number == Number::F32);
        let mut next = piece.first;
        while next < piece.end {
            let want = (piece.end - next).min(at_once) as usize * self.stride;
            scratch.resize(want, 0);
            let got = source.read_at(scratch, self.start + next * self.stride as u64)? / self.stride;
            for record in scratch.chunks_exact(self.stride).take(got) {
                let value = |field: Field| field.number.read(&record[field.at..], self.big);
                let bits = |field: Field| bits_of(&record[field.at..]);
                let colour = wanted.and_then(|source| self.values.of(source, value, bits));
                let at = self.axes.map(value);
                taker.note_singles(at, is_single);
                taker.push(at, class.map(value), colour)?;
            }
            next += got as u64;
            if got * self.stride < want {
                break; // the file was truncated since it was opened
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
