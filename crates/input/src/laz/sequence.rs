//! Points of formats 0 to 5, whose fields lie in one compressed sequence: reading any field requires decoding all.
//!
//! Input: the bytes of a chunk or of a whole file. Output: whole records. Source: the items `POINT10`, `GPSTIME11`,
//! `RGB12`, `BYTE` (each of version 2; those of version 1 are in [`version_one`]) and `WAVEPACKET13` of LASzip.

use super::coder::{Coder, MOST_STEP_BYTES, Median, Model, Numbers};
use super::fields::{COLOUR_BYTES, Colours, Coordinates, Lazily, TIME_BYTES, Times};
use super::items::{self, Kind};
use super::packed::PackedBytes;
use super::wave_packets::{PACKET_BYTES, WavePackets};
use super::{Flaw, version_one};
use crate::source::Source;

/// Bytes of the point's own fields.
pub(super) const POINT_BYTES: usize = 20;

/// Items of a record, in this order: the point, then the optional ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Items {
    /// True if all items but wave packets are of version 1, false for version 2.
    version_one: bool,
    time: bool,
    colour: bool,
    packet: bool,
    extra: usize,
}

impl Items {
    /// Returns the items listed in `items`, or `None` if there is no decoder for the combination.
    pub fn of(items: &[items::Item]) -> Option<Self> {
        let version = items.first()?.version;
        let mut next = items.iter().peekable();
        let mut has = |kind: Kind| {
            let known = if kind == Kind::WavePacket13 { 1..=2 } else { version..=version };
            next.next_if(|item| item.kind == kind && known.contains(&item.version)).map(|item| item.bytes)
        };
        has(Kind::Point10)?;
        let [time, colour, packet] = [Kind::GpsTime11, Kind::RGB12, Kind::WavePacket13].map(|kind| has(kind).is_some());
        let extra = has(Kind::Byte).unwrap_or(0);
        let known = matches!(version, 1 | 2) && next.next().is_none();
        known.then_some(Self { version_one: version == 1, time, colour, packet, extra })
    }

    fn record_bytes(self) -> usize {
        let others = [(self.time, TIME_BYTES), (self.colour, COLOUR_BYTES), (self.packet, PACKET_BYTES)];
        let others = others.iter().filter(|(is_there, _)| *is_there).map(|(_, bytes)| bytes);
        POINT_BYTES + others.sum::<usize>() + self.extra
    }

    /// Returns the maximum packed size of a record, or of the beginning of a chunk (bytes).
    fn most_packed_bytes(self) -> usize {
        let extra = Numbers::MOST_STEPS * self.extra;
        let steps = Point::MOST_STEPS + Times::MOST_STEPS + Colours::MOST_STEPS + WavePackets::MOST_STEPS + extra;
        (steps * MOST_STEP_BYTES).max(self.record_bytes() + 4)
    }
}

/// Decoder of one item of each record.
pub(super) trait Item {
    /// Creates a decoder whose predictions follow `first`.
    fn new(first: &[u8]) -> Self;

    /// Decodes the next `field`; returns whether a writer can have written its bytes.
    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool;
}

/// Decoder of the points in a part of a file, as one chunk or several consecutive ones.
pub(super) struct Sequence<'a> {
    bytes: PackedBytes<'a>,
    items: Items,
    /// Created at the second point of each chunk, because they are expensive to set up.
    fields: Option<Fields>,
    /// Points per chunk and of all chunks; `left_of_chunk` and `left`: points still to decode.
    chunk_points: u64,
    points: u64,
    left_of_chunk: u64,
    left: u64,
    first: Vec<u8>,
    /// Number of points in chunks that ended where they should.
    whole: u64,
}

impl<'a> Sequence<'a> {
    /// Creates a decoder of `points` points in the `len` bytes from `start` on: chunks of `chunk_points`, the last of
    /// which may have fewer.
    pub fn new(source: &'a Source, items: Items, (start, len): (u64, u64), points: u64, chunk_points: u64) -> Self {
        Self {
            bytes: PackedBytes::new(source, start, len),
            items,
            fields: None,
            chunk_points,
            points,
            left_of_chunk: 0,
            left: points,
            first: vec![0; items.record_bytes()],
            whole: 0,
        }
    }

    /// Returns the number of bytes consumed.
    pub fn position(&self) -> u64 {
        self.bytes.position()
    }

    /// Returns the number of points in chunks that ended where they should.
    pub fn whole(&self) -> u64 {
        self.whole
    }

    /// Fills `records`, at most as many as are left, and counts those that are decoded in `filled`.
    pub fn next(&mut self, records: &mut [u8], filled: &mut usize) -> Result<(), Flaw> {
        let mut records = records.chunks_exact_mut(self.items.record_bytes());
        let most = self.items.most_packed_bytes();
        while records.len() > 0 && self.left > 0 {
            self.bytes.hold(most)?;
            if self.left_of_chunk == 0 {
                self.first(records.next().unwrap_or_default())?;
                *filled += 1;
            } else {
                let fields = self.fields.get_or_insert_with(|| Fields::new(self.items, &self.first));
                let end = self.bytes.reach(most);
                let mut coder = self.bytes.coder();
                let left = usize::try_from(self.left_of_chunk).unwrap_or(usize::MAX);
                let before = *filled;
                let some = records.by_ref().take(left);
                match fields {
                    Fields::One(fields) => fields.decode(some, &mut coder, end, filled)?,
                    Fields::Two(fields) => fields.decode(some, &mut coder, end, filled)?,
                }
                let done = (*filled - before) as u64;
                (self.left_of_chunk, self.left) = (self.left_of_chunk - done, self.left - done);
                let state = coder.state();
                self.bytes.keep(state);
            }
            if self.left_of_chunk == 0 {
                self.end_chunk()?;
            }
        }
        Ok(())
    }

    /// Reads the first point of a chunk, which is stored uncompressed.
    fn first(&mut self, record: &mut [u8]) -> Result<(), Flaw> {
        let first = self.bytes.bytes(record.len() + 4).ok_or(Flaw::Short)?;
        record.copy_from_slice(&first[..record.len()]);
        self.first.copy_from_slice(record);
        self.fields = None;
        self.left_of_chunk = self.chunk_points.min(self.left) - 1;
        self.left -= 1;
        let state = self.bytes.begin(record.len()).state();
        self.bytes.keep(state);
        Ok(())
    }

    fn end_chunk(&mut self) -> Result<(), Flaw> {
        if !self.bytes.coder().is_at_end() {
            return Err(Flaw::Uneven);
        }
        self.whole = self.points - self.left;
        Ok(())
    }
}

/// Decoders of the fields of all records of a chunk, by version.
enum Fields {
    One(Box<FieldsOf<version_one::Point, version_one::Times, version_one::Colours, version_one::ExtraBytes>>),
    Two(Box<FieldsOf<Point, Times, LastColour, ExtraBytes>>),
}

impl Fields {
    fn new(items: Items, first: &[u8]) -> Self {
        match items.version_one {
            true => Self::One(Box::new(FieldsOf::new(items, first))),
            false => Self::Two(Box::new(FieldsOf::new(items, first))),
        }
    }
}

struct FieldsOf<P, T, C, E> {
    point: P,
    time: Option<Box<T>>,
    colour: Option<Box<C>>,
    packet: Option<Box<WavePackets>>,
    extra: E,
}

impl<P: Item, T: Item, C: Item, E: Item> FieldsOf<P, T, C, E> {
    fn new(items: Items, first: &[u8]) -> Self {
        let (point, rest) = first.split_at(POINT_BYTES);
        let (time, rest) = rest.split_at(if items.time { TIME_BYTES } else { 0 });
        let (colour, rest) = rest.split_at(if items.colour { COLOUR_BYTES } else { 0 });
        let (packet, extra) = rest.split_at(if items.packet { PACKET_BYTES } else { 0 });
        Self {
            point: P::new(point),
            time: items.time.then(|| Box::new(T::new(time))),
            colour: items.colour.then(|| Box::new(C::new(colour))),
            packet: items.packet.then(|| Box::new(WavePackets::new(packet))),
            extra: E::new(extra),
        }
    }

    /// Decodes `records` until the coder is past `end`, and counts them in `filled`.
    #[inline(always)]
    fn decode<'r>(
        &mut self,
        records: impl Iterator<Item = &'r mut [u8]>,
        coder: &mut Coder,
        end: usize,
        filled: &mut usize,
    ) -> Result<(), Flaw> {
        for record in records {
            if !self.next(coder, record) {
                return Err(Flaw::Strange);
            }
            if coder.is_beyond() {
                return Err(Flaw::Short);
            }
            *filled += 1;
            if coder.position() > end {
                break;
            }
        }
        Ok(())
    }

    /// Decodes the next record; returns whether a writer can have written its bytes.
    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, record: &mut [u8]) -> bool {
        let (point, mut rest) = record.split_at_mut(POINT_BYTES);
        let mut known = self.point.next(coder, point);
        if let Some(time) = &mut self.time {
            let (field, others) = rest.split_at_mut(TIME_BYTES);
            known &= time.next(coder, field);
            rest = others;
        }
        if let Some(colour) = &mut self.colour {
            let (field, others) = rest.split_at_mut(COLOUR_BYTES);
            known &= colour.next(coder, field);
            rest = others;
        }
        if let Some(packet) = &mut self.packet {
            let (field, others) = rest.split_at_mut(PACKET_BYTES);
            known &= packet.next(coder, field);
            rest = others;
        }
        known & self.extra.next(coder, rest)
    }
}

impl Item for Times {
    fn new(first: &[u8]) -> Self {
        Times::new(first.first_chunk().map_or(0, |&time| i64::from_le_bytes(time)), true)
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        let known;
        (*coder, known) = self.next(*coder);
        field.copy_from_slice(&self.last().to_le_bytes());
        known
    }
}

struct LastColour {
    colours: Colours,
    last: [u8; COLOUR_BYTES],
}

impl Item for LastColour {
    fn new(first: &[u8]) -> Self {
        Self { colours: Colours::new(), last: first.first_chunk().copied().unwrap_or_default() }
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        self.last = self.colours.next(coder, self.last);
        field.copy_from_slice(&self.last);
        true
    }
}

/// Extra bytes: each as a difference from the last one.
struct ExtraBytes(Vec<(u8, Model<256>)>);

impl Item for ExtraBytes {
    fn new(first: &[u8]) -> Self {
        Self(first.iter().map(|&byte| (byte, Model::new(256))).collect())
    }

    #[inline(always)]
    fn next(&mut self, coder: &mut Coder, field: &mut [u8]) -> bool {
        for (to, (last, model)) in field.iter_mut().zip(&mut self.0) {
            *last = last.wrapping_add(coder.symbol(model) as u8);
            *to = *last;
        }
        true
    }
}

/// Offsets in a point's own fields: intensity, flags (number and count of returns, direction and edge of the scan),
/// class, angle, user data, source id.
pub(super) const INTENSITY: usize = 12;
pub(super) const FLAGS: usize = 14;
pub(super) const CLASS: usize = 15;
pub(super) const ANGLE: usize = 16;
pub(super) const USER: usize = 17;
pub(super) const SOURCE_ID: usize = 18;

struct Point {
    /// All fields but the coordinates.
    last: [u8; POINT_BYTES],
    coordinates: Coordinates,
    /// Last heights by level of the return.
    heights: [i32; 8],
    /// Last intensities by kind of return; `steps`: medians of the last differences in x and y by kind of return.
    intensities: [u16; 16],
    steps: [[Median; 2]; 16],
    changes: Model<64>,
    intensity: Numbers,
    source_id: Numbers,
    flags: Lazily,
    class: Lazily,
    user: Lazily,
    /// Models of the angle by direction of the scan.
    angle: [Model<256>; 2],
}

impl Item for Point {
    fn new(first: &[u8]) -> Self {
        let mut last: [u8; POINT_BYTES] = first.first_chunk().copied().unwrap_or_default();
        // LASzip's writers do the same: they never predict from the intensity of the first point.
        last[INTENSITY..INTENSITY + 2].fill(0);
        Self {
            last,
            coordinates: Coordinates::new(first),
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
    fn next(&mut self, coder: &mut Coder, record: &mut [u8]) -> bool {
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
        true
    }
}

impl Point {
    /// Maximum number of decoding steps per point; those of version 1 take no more.
    const MOST_STEPS: usize = 5 + Coordinates::MOST_STEPS + 3 * Numbers::MOST_STEPS;

    /// Decodes fields that few points change. Not inlined, and with a decoder of its own, so that the caller's stays in
    /// registers.
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

/// Kinds of returns by their count and number in the pulse.
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
