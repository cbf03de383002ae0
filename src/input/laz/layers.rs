//! Points of formats 6 to 10, whose fields lie in layers that are decoded beside each other: only those that are wanted. All
//! other fields keep what the first point of the chunk has.
//!
//! In: the first point of a chunk and its layers, read as a whole. Out: records. Source: the items `POINT14` and `RGB14` of
//! LASzip, versions 2 (a draft of 3), 3 and 4, which differ in the colour that is expected where the scanner's channel changes.

use std::ops::Range as Places;

use super::coder::{Coder, Median, Model, Numbers, Range};
use super::fields::{COLOUR_BYTES, Colours, Coordinates, Lazily, Times};
use super::{Flaw, Wanted};

/// Bytes of the point's own fields.
pub(super) const POINT_BYTES: usize = 30;

/// Layers that may be wanted, in the order in which they lie in a chunk.
pub(super) const WANTED: usize = 8;
const XY: usize = 0;
const Z: usize = 1;
const CLASSES: usize = 2;
const FLAGS: usize = 3;
const INTENSITIES: usize = 4;
const SOURCE_IDS: usize = 5;
const TIMES: usize = 6;
const COLOURS: usize = 7;

/// Whether there is a decoder of items of this version.
pub(super) fn exist(version: u16) -> bool {
    matches!(version, 2..=4)
}

/// Whether the layer of a chunk whose points it does not tell apart is whole: it is empty, or an encoder without symbols wrote it.
pub(super) fn is_still(layer: &[u8]) -> bool {
    layer.is_empty() || layer.len() == Coder::begin(layer, 0).position() && Coder::begin(layer, 0).is_at_end()
}

/// Places among all layers of those that are `wanted`; `colour` is that of the colours.
pub(super) fn places(wanted: Wanted, colour: usize) -> [Option<usize>; WANTED] {
    let Wanted { classes, intensity, rgb, source_ids, times } = wanted;
    // Those of scan angle (5) and user data (6) never are.
    [(true, 0), (true, 1), (classes, 2), (true, 3), (intensity, 4), (source_ids, 7), (times, 8), (rgb, colour)]
        .map(|(wanted, place)| wanted.then_some(place))
}

/// Decodes one chunk.
pub(super) struct Layers {
    bytes: Vec<u8>,
    /// Where each layer lies in `bytes`; nowhere if it is not wanted or no point changes what is in it.
    places: [Places<usize>; WANTED],
    /// How far each is decoded.
    reached: [(usize, Range); WANTED],
    points: Points,
}

impl Layers {
    /// A decoder of the points after the `first`, whose layers lie behind each other in `bytes` and are of these `sizes` (bytes);
    /// `colour` is where a record has its colour, and the version in which that is packed.
    pub fn new(
        first: &[u8],
        bytes: Vec<u8>,
        sizes: [usize; WANTED],
        version: u16,
        colour: Option<(usize, u16)>,
    ) -> Self {
        let mut end = 0;
        let places = sizes.map(|size| {
            let start = end;
            end += size;
            start..end
        });
        let coders = places.clone().map(|place| Coder::begin(&bytes[place], 0));
        let reached = coders.map(|coder| coder.state());
        Self { bytes, places, reached, points: Points::new(first, version, colour) }
    }

    /// Fills `records`, each of so many bytes, and counts those that are whole in `filled`.
    pub fn next(&mut self, records: &mut [u8], record_bytes: usize, filled: &mut usize) -> Result<(), Flaw> {
        let Self { bytes, places, reached, points } = self;
        let layer = |layer: usize| &bytes[places[layer].clone()];
        let present: [bool; WANTED] = std::array::from_fn(|n| n == XY || !layer(n).is_empty());
        let mut coders: [Coder; WANTED] = std::array::from_fn(|n| Coder::resume(layer(n), reached[n].0, reached[n].1));
        for record in records.chunks_exact_mut(record_bytes) {
            if !points.next(&mut coders, &present, record) {
                return Err(Flaw::Strange);
            }
            if coders.iter().zip(present).any(|(coder, present)| present && coder.is_beyond()) {
                return Err(Flaw::Short);
            }
            *filled += 1;
        }
        *reached = coders.map(|coder| coder.state());
        Ok(())
    }

    /// Whether each layer ends behind the points decoded so far.
    pub fn are_at_end(&self) -> bool {
        self.places.iter().zip(self.reached).enumerate().all(|(n, (place, (position, range)))| {
            let coder = Coder::resume(&self.bytes[place.clone()], position, range);
            place.is_empty() && n != XY || position == place.len() && coder.is_at_end()
        })
    }
}

/// Places in a record: intensity, numbers of the return (low) and of returns, flags (of the class, channel of the scanner, direction
/// and edge of the scan), class, source id, time.
const INTENSITY: usize = 12;
const RETURNS: usize = 14;
const FLAG: usize = 15;
const CLASS: usize = 16;
const SOURCE_ID: usize = 20;
const TIME: usize = 22;

/// Channels of a scanner.
const CHANNELS: usize = 4;

/// Points of all channels, each expected to follow the last one of its channel.
struct Points {
    channels: [Option<Box<Channel>>; CHANNELS],
    /// The last point's.
    channel: usize,
    colours: Option<ColoursByChannel>,
    version: u16,
}

impl Points {
    fn new(first: &[u8], version: u16, colour: Option<(usize, u16)>) -> Self {
        let point = first.first_chunk().copied().unwrap_or([0; POINT_BYTES]);
        let channel = usize::from(point[FLAG] >> 4) % CHANNELS;
        let mut channels = [const { None }; CHANNELS];
        channels[channel] = Some(Box::new(Channel::new(point)));
        let colours = colour.and_then(|(at, version)| {
            let first = *first.get(at..)?.first_chunk()?;
            Some(ColoursByChannel::new(at, version, first, channel))
        });
        Self { channels, channel, colours, version }
    }

    /// The next record; whether its bytes are those of a writer.
    #[inline(always)]
    fn next(&mut self, coders: &mut [Coder; WANTED], present: &[bool; WANTED], record: &mut [u8]) -> bool {
        let [xy, z, classes, flags, intensities, source_ids, times, colours] = coders;
        let Some(mut channel) = self.channels[self.channel].as_mut() else { return false };
        let changes = xy.symbol(&mut channel.changes[channel.before]);
        let changed = changes & 64 != 0;
        if changed {
            let by = xy.symbol(&mut channel.other_channel) as usize + 1;
            self.channel = (self.channel + by) % CHANNELS;
            let last = channel.last;
            channel = self.channels[self.channel].get_or_insert_with(|| Box::new(Channel::new(last)));
            channel.last[FLAG] = channel.last[FLAG] & 0b1100_1111 | (self.channel as u8) << 4;
        }
        let channel = &mut **channel;
        let last = &mut channel.last;
        let new_time = changes & 16 != 0;
        let (last_number, last_count) = (last[RETURNS] & 15, last[RETURNS] >> 4);
        let count = match changes & 4 {
            0 => last_count,
            _ => xy.symbol(&mut channel.counts[usize::from(last_count)]) as u8,
        };
        let number = match changes & 3 {
            0 => last_number,
            1 => last_number + 1,
            2 => last_number + 15,
            _ if new_time => xy.symbol(&mut channel.numbers[usize::from(last_number)]) as u8,
            _ => last_number + 2 + xy.symbol(&mut channel.number_of_same_time) as u8,
        } % 16;
        last[RETURNS] = count << 4 | number;
        let place = usize::from(number == 1) << 1 | usize::from(number >= count);
        channel.before = usize::from(number == 1) | usize::from(number >= count) << 1 | usize::from(new_time) << 2;

        let kind = usize::from(RETURN_KINDS[usize::from(count)][usize::from(number)]) << 1 | usize::from(new_time);
        let single = count == 1;
        channel.coordinates.next_xy(xy, &mut channel.steps[kind], single);
        if present[Z] {
            let height = &mut channel.heights[usize::from(number.abs_diff(count).min(7))];
            channel.coordinates.next_z(z, height, single);
        }
        if present[CLASSES] {
            let before = usize::from(last[CLASS] & 31) << 1 | usize::from(place == 3);
            last[CLASS] = channel.class.next(classes, before);
        }
        if present[FLAGS] {
            let before = last[FLAG] & 15 | (last[FLAG] >> 6) << 4;
            let now = channel.flags.next(flags, usize::from(before));
            last[FLAG] = (now >> 4) << 6 | (self.channel as u8) << 4 | now & 15;
        }
        if present[INTENSITIES] {
            let intensity = &mut channel.intensities[place << 1 | usize::from(new_time)];
            *intensity = channel.intensity.next(intensities, place, i32::from(*intensity)) as u16;
            last[INTENSITY..INTENSITY + 2].copy_from_slice(&intensity.to_le_bytes());
        }
        if present[SOURCE_IDS] && changes & 32 != 0 {
            let expected = u16::from_le_bytes([last[SOURCE_ID], last[SOURCE_ID + 1]]);
            let id = channel.source_id.next(source_ids, 0, i32::from(expected)) as u16;
            last[SOURCE_ID..SOURCE_ID + 2].copy_from_slice(&id.to_le_bytes());
        }
        if present[TIMES] && new_time {
            let known;
            (*times, known) = channel.times.next(*times);
            if !known {
                return false;
            }
            last[TIME..].copy_from_slice(&channel.times.last().to_le_bytes());
        }
        channel.coordinates.write(last);
        record[..POINT_BYTES].copy_from_slice(last);
        if let Some(by_channel) = &mut self.colours {
            // Before version 4 a point whose channel is the one before's has colours as in channel 0.
            let channel = if changed || self.version == 4 { self.channel } else { 0 };
            by_channel.next(present[COLOURS].then_some(colours), channel, record);
        }
        true
    }
}

/// One channel of a scanner.
struct Channel {
    last: [u8; POINT_BYTES],
    coordinates: Coordinates,
    /// Context of what changes: whether the last return was the first, and the last, of its pulse, and had a new time.
    before: usize,
    /// Last heights, by level of the return; last intensities, by place in the pulse and whether the time is new; medians of the last
    /// differences in x and y, by kind of return and whether the time is new.
    heights: [i32; 8],
    intensities: [u16; 8],
    steps: [[Median; 2]; 12],
    changes: [Model<128>; 8],
    other_channel: Model<3>,
    counts: [Model<16>; 16],
    numbers: [Model<16>; 16],
    number_of_same_time: Model<13>,
    class: Lazily,
    flags: Lazily,
    intensity: Numbers,
    source_id: Numbers,
    times: Times,
}

impl Channel {
    /// What is expected after `last`, whichever channel it is of.
    fn new(last: [u8; POINT_BYTES]) -> Self {
        let coordinates = Coordinates::new(&last);
        let time = last[TIME..].first_chunk().map_or(0, |&eight| i64::from_le_bytes(eight));
        let (return_number, count) = (last[RETURNS] & 15, last[RETURNS] >> 4);
        Self {
            last,
            heights: [coordinates.z(); 8],
            coordinates,
            before: usize::from(return_number == 1) | usize::from(return_number >= count) << 1,
            intensities: [u16::from_le_bytes([last[INTENSITY], last[INTENSITY + 1]]); 8],
            steps: Default::default(),
            changes: std::array::from_fn(|_| Model::new(128)),
            other_channel: Model::new(3),
            counts: std::array::from_fn(|_| Model::new(16)),
            numbers: std::array::from_fn(|_| Model::new(16)),
            number_of_same_time: Model::new(13),
            class: Lazily::new(64, 256),
            flags: Lazily::new(64, 64),
            intensity: Numbers::new(16, 4),
            source_id: Numbers::new(16, 1),
            times: Times::new(time, false),
        }
    }
}

/// Kinds of returns, by their count and number in the pulse.
const RETURN_KINDS: [[u8; 16]; 16] = [
    [0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5],
    [1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3],
    [2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3],
    [3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5],
];

/// Colours of all channels.
struct ColoursByChannel {
    /// Where a record has its colour.
    at: usize,
    version: u16,
    channels: [Option<Box<Colours>>; CHANNELS],
    last: [[u8; COLOUR_BYTES]; CHANNELS],
    channel: usize,
}

impl ColoursByChannel {
    fn new(at: usize, version: u16, first: [u8; COLOUR_BYTES], channel: usize) -> Self {
        let mut all =
            Self { at, version, channels: [const { None }; CHANNELS], last: [[0; COLOUR_BYTES]; CHANNELS], channel };
        all.channels[channel] = Some(Box::new(Colours::new()));
        all.last[channel] = first;
        all
    }

    /// The colour of the next point; without a coder none changes.
    fn next(&mut self, coder: Option<&mut Coder>, channel: usize, record: &mut [u8]) {
        let before = std::mem::replace(&mut self.channel, channel);
        let is_new = self.channels[channel].is_none();
        let models = self.channels[channel].get_or_insert_with(|| Box::new(Colours::new()));
        if is_new {
            self.last[channel] = self.last[before];
        }
        // Before version 4 it goes on from the channel before if both were met: so do the writers.
        let expected = if self.version != 4 && !is_new { before } else { channel };
        let last = &mut self.last[expected];
        if let Some(coder) = coder {
            *last = models.next(coder, *last);
        }
        record[self.at..self.at + COLOUR_BYTES].copy_from_slice(last);
    }
}
