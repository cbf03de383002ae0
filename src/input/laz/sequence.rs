//! Points of formats 0 to 5, whose fields lie in one compressed sequence: all are decoded to get at any.
//!
//! In: the bytes of a chunk or of a whole file, through a buffer of [`WINDOW_BYTES`]. Out: whole records. Source: the items
//! `POINT10`, `GPSTIME11`, `RGB12` (each of version 2) and `BYTE` of LASzip.

use std::io;

use laz::{LazItem, LazItemType};

use super::coder::{Coder, MOST_STEP_BYTES, Median, Model, Numbers, Range};
use super::fields::{COLOUR_BYTES, Colours, Coordinates, Lazily, TIME_BYTES, Times};
use crate::input::source::{Source, WINDOW_BYTES};

/// Bytes of the point's own fields.
const POINT_BYTES: usize = 20;

/// What a record consists of, in this order: the point, then what else there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Items {
    time: bool,
    colour: bool,
    extra: usize,
}

impl Items {
    /// What `items` say, if this decoder knows all of them.
    pub fn of(items: &[LazItem]) -> Option<Self> {
        let mut next = items.iter().map(|item| (item.item_type(), item.version())).peekable();
        next.next_if_eq(&(LazItemType::Point10, 2))?;
        let time = next.next_if_eq(&(LazItemType::GpsTime, 2)).is_some();
        let colour = next.next_if_eq(&(LazItemType::RGB12, 2)).is_some();
        let extra = match next.next() {
            Some((LazItemType::Byte(count), 1 | 2)) => usize::from(count),
            Some(_) => return None,
            None => 0,
        };
        next.next().is_none().then_some(Self { time, colour, extra })
    }

    fn record_bytes(self) -> usize {
        POINT_BYTES + TIME_BYTES * usize::from(self.time) + COLOUR_BYTES * usize::from(self.colour) + self.extra
    }

    /// Most bytes that a record takes, packed.
    fn most_packed_bytes(self) -> usize {
        let steps = Point::MOST_STEPS + Times::MOST_STEPS + Colours::MOST_STEPS + self.extra;
        (steps * MOST_STEP_BYTES).max(self.record_bytes() + 4)
    }
}

/// Decoder of the points at some place of a file, as one chunk or as several behind each other.
pub(super) struct Sequence<'a> {
    source: &'a Source,
    items: Items,
    /// Place in the file of the first byte that is not held, and how many follow.
    next: u64,
    left: u64,
    held: Vec<u8>,
    /// Bytes that were read before those that are held.
    before: u64,
    /// Position in `held`.
    position: usize,
    range: Range,
    fields: Option<Box<Fields>>,
    /// Points of a chunk, and those that are left of the one at hand.
    chunk_points: u64,
    points_left: u64,
}

impl<'a> Sequence<'a> {
    /// A decoder of what lies in the `len` bytes from `start` on: chunks of so many points, or a single one (0).
    pub fn new(source: &'a Source, items: Items, start: u64, len: u64, chunk_points: u64) -> Self {
        Self {
            source,
            items,
            next: start,
            left: len,
            held: Vec::new(),
            before: 0,
            position: 0,
            range: Range::default(),
            fields: None,
            chunk_points: if chunk_points == 0 { u64::MAX } else { chunk_points },
            points_left: 0,
        }
    }

    /// Bytes taken.
    pub fn position(&self) -> u64 {
        self.before + self.position as u64
    }

    /// Fills `records` and counts those that are whole in `filled`.
    pub fn next(&mut self, records: &mut [u8], filled: &mut usize) -> io::Result<()> {
        let mut records = records.chunks_exact_mut(self.items.record_bytes());
        let most = self.items.most_packed_bytes();
        while records.len() > 0 {
            if self.left > 0 && self.position + most > self.held.len() {
                self.refill(most)?;
            }
            let Some(fields) = self.fields.as_mut().filter(|_| self.points_left > 0) else {
                self.first(records.next().unwrap_or_default())?;
                *filled += 1;
                continue;
            };
            let mut coder = Coder::resume(&self.held, self.position, self.range);
            // Of what is held, or of all where nothing follows.
            let end = if self.left > 0 { self.held.len() - most } else { self.held.len() };
            let points = usize::try_from(self.points_left).unwrap_or(usize::MAX);
            for record in records.by_ref().take(points) {
                if !fields.next(&mut coder, record) {
                    return Err(io::ErrorKind::InvalidData.into());
                }
                if coder.is_beyond() {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                *filled += 1;
                self.points_left -= 1;
                if coder.position() > end {
                    break;
                }
            }
            (self.position, self.range) = (coder.position(), coder.range());
        }
        Ok(())
    }

    /// The first point of a chunk lies there as it is.
    fn first(&mut self, record: &mut [u8]) -> io::Result<()> {
        let Some(first) = self.held.get(self.position..self.position + record.len() + 4) else {
            return Err(io::ErrorKind::UnexpectedEof.into());
        };
        record.copy_from_slice(&first[..record.len()]);
        self.fields = Some(Box::new(Fields::new(self.items, record)));
        self.points_left = self.chunk_points - 1;
        let coder = Coder::begin(&self.held, self.position + record.len());
        (self.position, self.range) = (coder.position(), coder.range());
        Ok(())
    }

    /// Holds at least `most` bytes from the position on, or all that there are.
    fn refill(&mut self, most: usize) -> io::Result<()> {
        self.before += self.position as u64;
        self.held.drain(..self.position);
        self.position = 0;
        while self.left > 0 && self.held.len() < most {
            let kept = self.held.len();
            self.held.resize(kept + self.left.min(WINDOW_BYTES as u64) as usize, 0);
            let read = self.source.fill(&mut self.held[kept..], self.next)?;
            // A file that became shorter ends here.
            self.left = if kept + read < self.held.len() { 0 } else { self.left - read as u64 };
            self.held.truncate(kept + read);
            self.next += read as u64;
        }
        Ok(())
    }
}

struct Fields {
    point: Point,
    times: Option<Box<Times>>,
    colours: Option<(Box<Colours>, [u8; COLOUR_BYTES])>,
    extra: Vec<(u8, Model<256>)>,
}

impl Fields {
    fn new(items: Items, first: &[u8]) -> Self {
        let (point, rest) = first.split_at(POINT_BYTES);
        let (time, rest) = rest.split_at(if items.time { TIME_BYTES } else { 0 });
        let (colour, extra) = rest.split_at(if items.colour { COLOUR_BYTES } else { 0 });
        Self {
            point: Point::new(point.first_chunk().copied().unwrap_or_default()),
            times: time.first_chunk().map(|&time| Box::new(Times::new(i64::from_le_bytes(time), true))),
            colours: colour.first_chunk().map(|&colour| (Box::new(Colours::new()), colour)),
            extra: extra.iter().map(|&byte| (byte, Model::new(256))).collect(),
        }
    }

    /// The next record; whether its bytes are those of a writer.
    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, record: &mut [u8]) -> bool {
        let (point, rest) = record.split_at_mut(POINT_BYTES);
        self.point.next(coder, point);
        let mut rest = rest;
        if let Some(times) = &mut self.times {
            let (time, others) = rest.split_at_mut(TIME_BYTES);
            let known;
            (*coder, known) = times.next(*coder);
            if !known {
                return false;
            }
            time.copy_from_slice(&times.last().to_le_bytes());
            rest = others;
        }
        if let Some((colours, last)) = &mut self.colours {
            let (colour, others) = rest.split_at_mut(COLOUR_BYTES);
            *last = colours.next(coder, *last);
            colour.copy_from_slice(last);
            rest = others;
        }
        for (to, (last, model)) in rest.iter_mut().zip(&mut self.extra) {
            *last = last.wrapping_add(coder.symbol(model) as u8);
            *to = *last;
        }
        true
    }
}

/// Places in a point's own fields: intensity, flags (number and count of returns, direction and edge of the scan), class,
/// angle, user data, source id.
const INTENSITY: usize = 12;
const FLAGS: usize = 14;
const CLASS: usize = 15;
const ANGLE: usize = 16;
const USER: usize = 17;
const SOURCE_ID: usize = 18;

struct Point {
    /// All fields but the coordinates.
    last: [u8; POINT_BYTES],
    coordinates: Coordinates,
    /// Last heights, by level of the return.
    heights: [i32; 8],
    /// Last intensities, medians of the last differences in x and y, by kind of return.
    intensities: [u16; 16],
    steps: [[Median; 2]; 16],
    changes: Model<64>,
    intensity: Numbers,
    source_id: Numbers,
    flags: Lazily,
    class: Lazily,
    user: Lazily,
    /// By direction of the scan.
    angle: [Model<256>; 2],
}

impl Point {
    const MOST_STEPS: usize = 5 + Coordinates::MOST_STEPS + 2 * Numbers::MOST_STEPS;

    fn new(first: [u8; POINT_BYTES]) -> Self {
        let mut last = first;
        // So do LASzip's writers: the intensity of the first point is nowhere expected.
        last[INTENSITY..INTENSITY + 2].fill(0);
        Self {
            last,
            coordinates: Coordinates::new(&first),
            heights: [0; 8],
            intensities: [0; 16],
            steps: Default::default(),
            changes: Model::new(64),
            intensity: Numbers::new(16, 4),
            source_id: Numbers::new(16, 1),
            flags: Lazily::new(256, 256),
            class: Lazily::new(256, 256),
            user: Lazily::new(256, 256),
            angle: [Model::new(256), Model::new(256)],
        }
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, record: &mut [u8]) {
        let changes = coder.symbol(&mut self.changes);
        if changes & 32 != 0 {
            self.last[FLAGS] = self.flags.next(coder, usize::from(self.last[FLAGS]));
        }
        let (number, count) = (usize::from(self.last[FLAGS] & 7), usize::from(self.last[FLAGS] >> 3 & 7));
        let kind = usize::from(RETURN_KINDS[count][number] & 15);
        if changes != 0 {
            let intensity = &mut self.intensities[kind];
            if changes & 16 != 0 {
                *intensity = self.intensity.next(coder, kind.min(3), i32::from(*intensity)) as u16;
            }
            self.last[INTENSITY..INTENSITY + 2].copy_from_slice(&intensity.to_le_bytes());
            if changes & 15 != 0 {
                *coder = self.seldom(*coder, changes);
            }
        }
        let single = count == 1;
        self.coordinates.next_xy(coder, &mut self.steps[kind], single);
        self.coordinates.next_z(coder, &mut self.heights[number.abs_diff(count)], single);
        record.copy_from_slice(&self.last);
        self.coordinates.write(record);
    }

    /// Apart from what most points need, with a decoder of its own, so that the other stays in registers.
    #[inline(never)]
    fn seldom<'a>(&mut self, mut coder: Coder<'a>, changes: u32) -> Coder<'a> {
        let last = &mut self.last;
        if changes & 8 != 0 {
            last[CLASS] = self.class.next(&mut coder, usize::from(last[CLASS]));
        }
        if changes & 4 != 0 {
            let model = &mut self.angle[usize::from(last[FLAGS] >> 6 & 1)];
            last[ANGLE] = last[ANGLE].wrapping_add(coder.symbol(model) as u8);
        }
        if changes & 2 != 0 {
            last[USER] = self.user.next(&mut coder, usize::from(last[USER]));
        }
        if changes & 1 != 0 {
            let expected = u16::from_le_bytes([last[SOURCE_ID], last[SOURCE_ID + 1]]);
            let id = self.source_id.next(&mut coder, 0, i32::from(expected)) as u16;
            last[SOURCE_ID..].copy_from_slice(&id.to_le_bytes());
        }
        coder
    }
}

/// Kinds of returns, by their count and number in the pulse.
const RETURN_KINDS: [[u8; 8]; 8] = [
    [15, 14, 13, 12, 11, 10, 9, 8],
    [14, 0, 1, 3, 6, 10, 10, 9],
    [13, 1, 2, 4, 7, 11, 11, 10],
    [12, 3, 4, 5, 8, 12, 12, 11],
    [11, 6, 7, 8, 9, 13, 13, 12],
    [10, 10, 11, 12, 13, 14, 14, 13],
    [9, 10, 11, 12, 13, 14, 15, 14],
    [8, 9, 10, 11, 12, 13, 14, 15],
];
