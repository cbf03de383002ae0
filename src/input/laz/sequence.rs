//! Points of formats 0 to 5, whose fields lie in one compressed sequence: all are decoded to get at any.
//!
//! In: the bytes of a chunk or of a whole file, through a buffer of [`WINDOW_BYTES`]. Out: whole records. Source: the items
//! `POINT10`, `GPSTIME11`, `RGB12` (each of version 2) and `BYTE` of LASzip.

use std::io;

use laz::{LazItem, LazItemType};

use super::coder::{Coder, MOST_STEP_BYTES, Median, Model, Numbers, Range};
use crate::input::source::{Source, WINDOW_BYTES};

/// Bytes of the point's own fields, of its time, of its colour.
const POINT_BYTES: usize = 20;
const TIME_BYTES: usize = 8;
const COLOUR_BYTES: usize = 6;

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
                if coder.position() > self.held.len() {
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
    colours: Option<Box<Colours>>,
    extra: Vec<(u8, Model<256>)>,
}

impl Fields {
    fn new(items: Items, first: &[u8]) -> Self {
        let (point, rest) = first.split_at(POINT_BYTES);
        let (time, rest) = rest.split_at(if items.time { TIME_BYTES } else { 0 });
        let (colour, extra) = rest.split_at(if items.colour { COLOUR_BYTES } else { 0 });
        Self {
            point: Point::new(point.first_chunk().copied().unwrap_or_default()),
            times: time.first_chunk().map(|&time| Box::new(Times::new(i64::from_le_bytes(time)))),
            colours: colour.first_chunk().map(|colour| Box::new(Colours::new(colour))),
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
        if let Some(colours) = &mut self.colours {
            let (colour, others) = rest.split_at_mut(COLOUR_BYTES);
            colours.next(coder);
            for (to, from) in colour.chunks_exact_mut(2).zip(colours.last) {
                to.copy_from_slice(&from.to_le_bytes());
            }
            rest = others;
        }
        for (to, (last, model)) in rest.iter_mut().zip(&mut self.extra) {
            *last = last.wrapping_add(coder.symbol(model) as u8);
            *to = *last;
        }
        true
    }
}

/// Models by the last value of a byte, made when that value is met.
struct ByLast(Vec<Option<Box<Model<256>>>>);

impl ByLast {
    fn new() -> Self {
        Self((0..256).map(|_| None).collect())
    }

    fn next(&mut self, coder: &mut Coder, last: u8) -> u8 {
        coder.symbol(self.0[usize::from(last)].get_or_insert_with(|| Box::new(Model::new(256)))) as u8
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
    x: i32,
    y: i32,
    /// Last heights, by level of the return.
    heights: [i32; 8],
    /// Last intensities, medians of the last differences in x and y, by kind of return.
    intensities: [u16; 16],
    steps: [[Median; 2]; 16],
    changes: Model<64>,
    dx: Numbers,
    dy: Numbers,
    z: Numbers,
    intensity: Numbers,
    source_id: Numbers,
    flags: ByLast,
    class: ByLast,
    user: ByLast,
    /// By direction of the scan.
    angle: [Model<256>; 2],
}

impl Point {
    const MOST_STEPS: usize = 1 + 1 + 1 + 1 + 1 + 5 * Numbers::MOST_STEPS;

    fn new(first: [u8; POINT_BYTES]) -> Self {
        let number = |at: usize| first[at..].first_chunk().map_or(0, |&four| i32::from_le_bytes(four));
        let mut last = first;
        // So do LASzip's writers: the intensity of the first point is nowhere expected.
        last[INTENSITY..INTENSITY + 2].fill(0);
        Self {
            last,
            x: number(0),
            y: number(4),
            heights: [0; 8],
            intensities: [0; 16],
            steps: Default::default(),
            changes: Model::new(64),
            dx: Numbers::new(32, 2),
            dy: Numbers::new(32, 22),
            z: Numbers::new(32, 20),
            intensity: Numbers::new(16, 4),
            source_id: Numbers::new(16, 1),
            flags: ByLast::new(),
            class: ByLast::new(),
            user: ByLast::new(),
            angle: [Model::new(256), Model::new(256)],
        }
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, record: &mut [u8]) {
        let changes = coder.symbol(&mut self.changes);
        if changes & 32 != 0 {
            self.last[FLAGS] = self.flags.next(coder, self.last[FLAGS]);
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
        let single = usize::from(count == 1);
        let [step_x, step_y] = &mut self.steps[kind];
        let dx = self.dx.next(coder, single, step_x.get());
        step_x.add(dx);
        self.x = self.x.wrapping_add(dx);
        let context = (self.dx.size() & !1).min(20) as usize + single;
        let dy = self.dy.next(coder, context, step_y.get());
        step_y.add(dy);
        self.y = self.y.wrapping_add(dy);
        let height = &mut self.heights[number.abs_diff(count)];
        let context = (((self.dx.size() + self.dy.size()) / 2) & !1).min(18) as usize + single;
        *height = self.z.next(coder, context, *height);
        record.copy_from_slice(&self.last);
        for (to, from) in record.chunks_exact_mut(4).zip([self.x, self.y, *height]) {
            to.copy_from_slice(&from.to_le_bytes());
        }
    }

    /// Apart from what most points need, with a decoder of its own, so that the other stays in registers.
    #[inline(never)]
    fn seldom<'a>(&mut self, mut coder: Coder<'a>, changes: u32) -> Coder<'a> {
        let last = &mut self.last;
        if changes & 8 != 0 {
            last[CLASS] = self.class.next(&mut coder, last[CLASS]);
        }
        if changes & 4 != 0 {
            let model = &mut self.angle[usize::from(last[FLAGS] >> 6 & 1)];
            last[ANGLE] = last[ANGLE].wrapping_add(coder.symbol(model) as u8);
        }
        if changes & 2 != 0 {
            last[USER] = self.user.next(&mut coder, last[USER]);
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

struct Colours {
    last: [u16; 3],
    changes: Model<128>,
    /// Of red, green and blue the lower, then the upper byte.
    bytes: [Model<256>; 6],
}

impl Colours {
    const MOST_STEPS: usize = 7;

    fn new(first: &[u8; COLOUR_BYTES]) -> Self {
        let &[r0, r1, g0, g1, b0, b1] = first;
        let last = [[r0, r1], [g0, g1], [b0, b1]].map(u16::from_le_bytes);
        Self { last, changes: Model::new(128), bytes: std::array::from_fn(|_| Model::new(256)) }
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder) {
        let changes = coder.symbol(&mut self.changes);
        let last = self.last.map(u16::to_le_bytes);
        let mut now = last;
        let mut byte = |place: usize, expected: u8| {
            let changed = changes >> place & 1 != 0;
            changed.then(|| expected.wrapping_add(coder.symbol(&mut self.bytes[place]) as u8))
        };
        for half in 0..2 {
            now[0][half] = byte(half, last[0][half]).unwrap_or(last[0][half]);
        }
        if changes & 64 == 0 {
            now = [now[0]; 3];
        } else {
            for half in 0..2 {
                // What red changed by, green and blue are expected to.
                let change = |channel: usize, now: [u8; 2]| i32::from(now[half]) - i32::from(last[channel][half]);
                let with = |channel: usize, by: i32| (i32::from(last[channel][half]) + by).clamp(0, 255) as u8;
                let red = change(0, now[0]);
                if let Some(green) = byte(2 + half, with(1, red)) {
                    now[1][half] = green;
                }
                let both = (red + change(1, now[1])) / 2;
                if let Some(blue) = byte(4 + half, with(2, both)) {
                    now[2][half] = blue;
                }
            }
        }
        self.last = now.map(u16::from_le_bytes);
    }
}

/// Multiples of the last difference of times that have a symbol of their own: up to the first number, down to the second.
const MOST_MULTIPLE: i32 = 500;
const LEAST_MULTIPLE: i32 = -10;
const UNCHANGED: i32 = MOST_MULTIPLE - LEAST_MULTIPLE + 1;
const ANEW: i32 = UNCHANGED + 1;
/// Sequences of times that alternate.
const SEQUENCES: usize = 4;

/// Times as the integers that their bits are.
struct Times {
    sequences: [TimeSequence; SEQUENCES],
    last: usize,
    newest: usize,
    multiples: Model<516, u16>,
    /// Where the last difference is 0.
    still: Model<6>,
    numbers: Numbers,
}

/// One sequence of times.
#[derive(Clone, Copy, Default)]
struct TimeSequence {
    time: i64,
    difference: i32,
    /// How often in a row the difference was far from a multiple of the last one.
    misses: u32,
}

impl Times {
    const MOST_STEPS: usize = SEQUENCES + 1 + Numbers::MOST_STEPS + 2;

    fn new(first: i64) -> Self {
        let mut sequences = [TimeSequence::default(); SEQUENCES];
        sequences[0].time = first;
        Self {
            sequences,
            last: 0,
            newest: 0,
            multiples: Model::new(516),
            still: Model::new(6),
            numbers: Numbers::new(32, 9),
        }
    }

    fn last(&self) -> i64 {
        self.sequences[self.last].time
    }

    /// The next time; whether its bytes are those of a writer, who changes to another sequence once.
    #[inline(never)]
    fn next<'a>(&mut self, mut coder: Coder<'a>) -> (Coder<'a>, bool) {
        for _ in 0..SEQUENCES {
            let sequence = &mut self.sequences[self.last];
            let symbol = match sequence.difference {
                0 => match coder.symbol(&mut self.still) as i32 {
                    0 => UNCHANGED,
                    1 => {
                        let difference = self.numbers.next(&mut coder, 0, 0);
                        *sequence = TimeSequence { time: sequence.after(difference), difference, misses: 0 };
                        return (coder, true);
                    }
                    symbol => ANEW - 2 + symbol,
                },
                _ => coder.symbol(&mut self.multiples) as i32,
            };
            match symbol {
                UNCHANGED => return (coder, true),
                ..UNCHANGED => {
                    let (multiple, context) = match symbol {
                        0 => (0, 7),
                        1 => (1, 1),
                        2..10 => (symbol, 2),
                        10..MOST_MULTIPLE => (symbol, 3),
                        MOST_MULTIPLE => (symbol, 4),
                        _ if MOST_MULTIPLE - symbol > LEAST_MULTIPLE => (MOST_MULTIPLE - symbol, 5),
                        _ => (LEAST_MULTIPLE, 6),
                    };
                    let expected = sequence.difference.wrapping_mul(multiple);
                    let difference = self.numbers.next(&mut coder, context, expected);
                    sequence.time = sequence.after(difference);
                    match multiple {
                        1 => sequence.misses = 0,
                        0 | LEAST_MULTIPLE | MOST_MULTIPLE => {
                            sequence.misses += 1;
                            if sequence.misses > 3 {
                                (sequence.difference, sequence.misses) = (difference, 0);
                            }
                        }
                        _ => {}
                    }
                    return (coder, true);
                }
                ANEW => {
                    let upper = self.numbers.next(&mut coder, 8, (sequence.time >> 32) as i32);
                    let lower = coder.bits(16) | coder.bits(16) << 16;
                    self.newest = (self.newest + 1) % SEQUENCES;
                    self.last = self.newest;
                    let time = i64::from(upper) << 32 | i64::from(lower);
                    self.sequences[self.last] = TimeSequence { time, ..TimeSequence::default() };
                    return (coder, true);
                }
                _ => self.last = (self.last + (symbol - ANEW) as usize) % SEQUENCES,
            }
        }
        (coder, false)
    }
}

impl TimeSequence {
    fn after(&self, difference: i32) -> i64 {
        self.time.wrapping_add(i64::from(difference))
    }
}
