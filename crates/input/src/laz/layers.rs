//! Points of formats 6 to 10, whose fields lie in separate layers: only wanted layers are decoded. All other fields
//! keep the values of the first point of the chunk.
//!
//! Input: the first point of a chunk and its layers, read as a whole. Output: records. Source: the items `POINT14` and
//! `RGB14` of LASzip, versions 2 (a draft of 3), 3 and 4, which differ in the colour expected after a change of the
//! scanner channel.

use std::ops::Range as Places;

use super::coder::{Coder, Median, Model, Numbers, Range};
use super::fields::{COLOUR_BYTES, Colours, Coordinates, Lazily, Times};
use super::{Flaw, Wanted};

/// Bytes of the point's own fields.
pub(super) const POINT_BYTES: usize = 30;

/// Number of layers that may be wanted; below, their indices, in the order of a chunk.
pub(super) const WANTED: usize = 8;
const XY: usize = 0;
const Z: usize = 1;
const CLASSES: usize = 2;
const FLAGS: usize = 3;
const INTENSITIES: usize = 4;
const SOURCE_IDS: usize = 5;
const TIMES: usize = 6;
const COLOURS: usize = 7;

/// Returns whether there is a decoder for items of this version.
pub(super) fn exist(version: u16) -> bool {
    matches!(version, 2..=4)
}

/// Returns whether a layer that never changes its field is sound: it is empty, or an encoder without symbols wrote it.
pub(super) fn is_still(layer: &[u8]) -> bool {
    layer.is_empty() || layer.len() == Coder::begin(layer, 0).position() && Coder::begin(layer, 0).is_at_end()
}

/// Returns the indices of the `wanted` layers among all layers; `colour` is that of the colours.
pub(super) fn places(wanted: Wanted, colour: usize) -> [Option<usize>; WANTED] {
    let Wanted { classes, intensity, rgb, source_ids, times } = wanted;
    // Scan angle (5) and user data (6) are never wanted.
    [(true, 0), (true, 1), (classes, 2), (true, 3), (intensity, 4), (source_ids, 7), (times, 8), (rgb, colour)]
        .map(|(wanted, place)| wanted.then_some(place))
}

/// Decoder of one chunk.
pub(super) struct Layers {
    bytes: Vec<u8>,
    /// Range of each layer in `bytes`; empty if the layer is not wanted or no point changes its field.
    places: [Places<usize>; WANTED],
    /// Decoder state of each layer.
    reached: [(usize, Range); WANTED],
    points: Points,
}

impl Layers {
    /// Creates a decoder of the points after the `first`. Their layers of these `sizes` (bytes) follow one another in
    /// `bytes`; `colour` is the offset of the colour in a record and the version of its packing.
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

    /// Fills `records`, each of `record_bytes` bytes, and counts those that are whole in `filled`.
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

    /// Returns whether each layer ends after the points already decoded.
    pub fn are_at_end(&self) -> bool {
        self.places.iter().zip(self.reached).enumerate().all(|(n, (place, (position, range)))| {
            let coder = Coder::resume(&self.bytes[place.clone()], position, range);
            place.is_empty() && n != XY || position == place.len() && coder.is_at_end()
        })
    }
}

/// Offsets in a record: intensity, number of the return (low) and of returns, flags (of the class, channel of the
/// scanner, direction and edge of the scan), class, source id, time.
const INTENSITY: usize = 12;
const RETURNS: usize = 14;
const FLAG: usize = 15;
const CLASS: usize = 16;
const SOURCE_ID: usize = 20;
const TIME: usize = 22;

/// Number of channels of a scanner.
const CHANNELS: usize = 4;

/// Points of all channels, each predicted from the last one of its channel.
struct Points {
    channels: [Option<Box<Channel>>; CHANNELS],
    /// Channel of the last point.
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

    /// Decodes the next record; returns whether a writer can have written its bytes.
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
            // Before version 4, a point in the same channel as the one before has the colour context of channel 0.
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
    /// Context of `changes`: whether the last return was the first, and the last, of its pulse, and had a new time.
    before: usize,
    /// Last heights by level of the return; `intensities`: last ones by position in the pulse and whether the time is
    /// new; `steps`: medians of the last differences in x and y by kind of return and whether the time is new.
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
    /// Creates a channel whose predictions follow `last`, whichever channel that is in.
    fn new(last: [u8; POINT_BYTES]) -> Self {
        let coordinates = Coordinates::new(&last);
        let time = last[TIME..].first_chunk().map_or(0, |&eight| i64::from_le_bytes(eight));
        let (return_number, count) = (last[RETURNS] & 15, last[RETURNS] >> 4);
        let (changes, returns) = (Model::new(128), Model::new(16));
        Self {
            last,
            heights: [coordinates.z(); 8],
            coordinates,
            before: usize::from(return_number == 1) | usize::from(return_number >= count) << 1,
            intensities: [u16::from_le_bytes([last[INTENSITY], last[INTENSITY + 1]]); 8],
            steps: Default::default(),
            changes: std::array::from_fn(|_| changes.clone()),
            other_channel: Model::new(3),
            counts: std::array::from_fn(|_| returns.clone()),
            numbers: std::array::from_fn(|_| returns.clone()),
            number_of_same_time: Model::new(13),
            class: Lazily::new(64, 256),
            flags: Lazily::new(64, 64),
            intensity: Numbers::new(16, 4),
            source_id: Numbers::new(16, 1),
            times: Times::new(time, false),
        }
    }
}

/// Kinds of returns by their count and number in the pulse.
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
    /// Offset of the colour in a record.
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

    /// Decodes the colour of the next point; without a coder, the colour does not change.
    fn next(&mut self, coder: Option<&mut Coder>, channel: usize, record: &mut [u8]) {
        let before = std::mem::replace(&mut self.channel, channel);
        let is_new = self.channels[channel].is_none();
        let models = self.channels[channel].get_or_insert_with(|| Box::new(Colours::new()));
        if is_new {
            self.last[channel] = self.last[before];
        }
        // Before version 4, prediction continues from the channel before if both occurred: the writers do the same.
        let expected = if self.version != 4 && !is_new { before } else { channel };
        let last = &mut self.last[expected];
        if let Some(coder) = coder {
            *last = models.next(coder, *last);
        }
        record[self.at..self.at + COLOUR_BYTES].copy_from_slice(last);
    }
}
