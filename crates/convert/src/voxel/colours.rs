//! Colours of the voxels of a tile column, as exact sums.
//!
//! Each point's colour values take records of their own next to that of the point: 8 bytes, with the voxel in the same
//! bits, so that one external sort serves both. Without colours there are no such records. A point takes one, or two if
//! its RGB has 16 bits that are not widened 8-bit values; each piece of a triangle takes one, or two if its weight
//! exceeds 1. Sums of records equal the sums of points and pieces, in any order.

use super::accumulate::{Area, Patch};
use super::record::{Content, PATCH_PIXELS, Record, VALUE_BITS};
use crate::colour::{ColourScale, ColourSource, ColourSum, class_colour};
use crate::frame::PAGE_SLICES;
use crate::mesh::paint::{MOST_WEIGHT, PaintedPiece};
use crate::page::{Occupancy, Page};
use crate::{Error, Parameter, Result};

/// Tags of the payload, stored in the bits above it.
const BYTES: u32 = 0;
const BYTES_257: u32 = 1;
const BYTES_256: u32 = 2;
const FIRST_HALF: u32 = 3;
const SECOND_HALF: u32 = 4;
const VALUE: u32 = 5;
/// Weight (6 bits), red times the weight (14 bits), and the bits of blue times the weight above its lower 10.
const FIRST_OF_PIECE: u32 = 6;
/// Green times the weight (14 bits), and the lower 10 bits of blue times the weight.
const SECOND_OF_PIECE: u32 = 7;
const PAYLOAD_BITS: u32 = 24;
const _: () = assert!(MOST_WEIGHT < 1 << 6 && MOST_WEIGHT * 255 < 1 << 14);
const _: () = assert!(PAYLOAD_BITS + 3 == VALUE_BITS);

/// Encodes a point's values as the lower bits of one or two records.
#[inline]
pub fn values_of(source: ColourSource, [r, g, b]: [u16; 3]) -> (u32, Option<u32>) {
    let packed = |tag: u32, [r, g, b]: [u16; 3]| {
        tag << PAYLOAD_BITS | u32::from(r & 0xFF) << 16 | u32::from(g & 0xFF) << 8 | u32::from(b & 0xFF)
    };
    if source != ColourSource::Rgb {
        return (VALUE << PAYLOAD_BITS | u32::from(r), None);
    }
    let (any, low) = (r | g | b, (r & 0xFF) | (g & 0xFF) | (b & 0xFF));
    let high = [r >> 8, g >> 8, b >> 8];
    if any < 256 {
        return (packed(BYTES, [r, g, b]), None);
    }
    if low == 0 {
        return (packed(BYTES_256, high), None);
    }
    if [r, g, b].iter().all(|&value| value >> 8 == value & 0xFF) {
        return (packed(BYTES_257, high), None);
    }
    let first = FIRST_HALF << PAYLOAD_BITS | u32::from(r) << 8 | u32::from(g >> 8);
    let second = SECOND_HALF << PAYLOAD_BITS | u32::from(g & 0xFF) << 16 | u32::from(b);
    (first, Some(second))
}

/// Encodes the colour of a triangle's piece in a voxel as the lower bits of one or two records.
#[inline]
pub fn values_of_piece(scale: &ColourScale, piece: PaintedPiece) -> (u32, Option<u32>) {
    let [r, g, b] = piece.colour.map(u32::from);
    let weight = piece.weight.min(MOST_WEIGHT);
    if weight == 1 {
        let tag = if scale.high > u16::from(u8::MAX) { BYTES_257 } else { BYTES };
        return (tag << PAYLOAD_BITS | r << 16 | g << 8 | b, None);
    }
    let [r, g, b] = [r * weight, g * weight, b * weight];
    let first = FIRST_OF_PIECE << PAYLOAD_BITS | weight << 18 | r << 4 | b >> 10;
    (first, Some(SECOND_OF_PIECE << PAYLOAD_BITS | g << 10 | b & 0x3FF))
}

/// Fact about an input's values, taken from one record: for RGB whether it exceeds 8 bits, else the value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueFact {
    /// All channels fit 8 bits.
    Bytes,
    /// At least one channel does not.
    Wide,
    /// Intensity or class.
    Value(u16),
}

impl ValueFact {
    /// Derives the fact from a record's [value](Record::value). For a point with two records, the first decides.
    pub fn of(value: u32) -> Self {
        match value >> PAYLOAD_BITS {
            BYTES | SECOND_HALF | FIRST_OF_PIECE | SECOND_OF_PIECE => Self::Bytes,
            BYTES_257 | BYTES_256 | FIRST_HALF => Self::Wide,
            _ => Self::Value(value as u16),
        }
    }
}

/// Filter that drops the values of removed points. Each value follows the record of its point, or that of a surface
/// piece, which is always kept.
#[derive(Debug, Default)]
pub struct ValueSieve {
    next: Next,
    is_removed: bool,
}

/// Kind of the next record.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum Next {
    #[default]
    Point,
    Value,
    SecondHalf,
}

impl ValueSieve {
    /// Appends to `out` the values of points that are not `removed`. A run may be passed in several consecutive parts.
    pub fn sift(&mut self, records: &[Record], removed: impl Fn(Record) -> bool, out: &mut Vec<Record>) {
        for &record in records {
            if self.next == Next::Point {
                (self.next, self.is_removed) = (Next::Value, record.content() == Content::Point && removed(record));
                continue;
            }
            let is_half = matches!(record.value() >> PAYLOAD_BITS, FIRST_HALF | FIRST_OF_PIECE);
            let has_second = self.next == Next::Value && is_half;
            self.next = if has_second { Next::SecondHalf } else { Next::Point };
            if !self.is_removed {
                out.push(record);
            }
        }
    }
}

/// Adds a record of values to sums.
#[inline]
fn add(sum: &mut ColourSum, scale: &ColourScale, value: u32) {
    let payload = value & ((1 << PAYLOAD_BITS) - 1);
    let bytes = [payload >> 16, payload >> 8 & 0xFF, payload & 0xFF];
    let (points, channels) = match value >> PAYLOAD_BITS {
        BYTES => (1, bytes),
        BYTES_257 => (1, bytes.map(|byte| byte * 257)),
        BYTES_256 => (1, bytes.map(|byte| byte * 256)),
        FIRST_HALF => (1, [payload >> 8, (payload & 0xFF) << 8, 0]),
        SECOND_HALF => (0, [0, payload >> 16, payload & 0xFFFF]),
        // 8-bit values, widened to the range of the points' values.
        FIRST_OF_PIECE => {
            let wide = u32::from(scale.high) / 255;
            (payload >> 18, [(payload >> 4 & 0x3FFF) * wide, 0, ((payload & 0xF) << 10) * wide])
        }
        SECOND_OF_PIECE => {
            let wide = u32::from(scale.high) / 255;
            (0, [0, (payload >> 10) * wide, (payload & 0x3FF) * wide])
        }
        _ if scale.source == ColourSource::Class => (1, class_colour(payload as u8).map(u32::from)),
        _ => (1, [u32::from(scale.stretch(payload as u16)); 3]),
    };
    sum.n += u64::from(points);
    for (sum, channel) in sum.sum.iter_mut().zip(channels) {
        *sum += u64::from(channel);
    }
}

/// Greatest value of the summed channels.
fn greatest(scale: &ColourScale) -> u16 {
    match scale.source {
        // Intensities are stretched before they are summed.
        ColourSource::Intensity => u16::MAX,
        ColourSource::Rgb | ColourSource::Class => scale.high,
    }
}

/// Colours of one tile column at a time; reuses its buffers.
///
/// Memory: 32 bytes for each voxel of the current patch, 16 for each coloured voxel of the column.
#[derive(Debug)]
pub struct ColumnColours {
    scale: ColourScale,
    /// Most voxels of a column.
    most: usize,
    sums: Vec<ColourSum>,
    /// Position (layer, pixel, slice) and mean of voxels.
    found: Vec<(u64, [u16; 3])>,
}

impl ColumnColours {
    /// Creates the colours of `scale`, for at most `most` voxels per column.
    pub fn new(scale: ColourScale, most: usize) -> Self {
        Self { scale, most, sums: Vec::new(), found: Vec::new() }
    }

    /// Begins an area whose voxels are those of `patch`.
    pub fn begin(&mut self, patch: &Patch) {
        self.sums.clear();
        self.sums.resize(patch.voxels().len(), ColourSum::default());
    }

    /// Adds the records in `area`. Skips voxels that `patch` does not have, because they were dropped.
    pub fn add(&mut self, patch: &Patch, area: Area, records: &[Record]) {
        // Values have no copies in halos.
        let is_whole = area == Area::TILE;
        for record in records.iter().filter(|record| is_whole || area.holds(record.pixel())) {
            if let Some(number) = patch.find(record.pixel(), record.slice()) {
                add(&mut self.sums[number], &self.scale, record.value());
            }
        }
    }

    /// Ends the area.
    pub fn end(&mut self, patch: &Patch, area: Area) -> Result<()> {
        let high = greatest(&self.scale);
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            let (x, y) = (pixel % PATCH_PIXELS - 1, pixel / PATCH_PIXELS - 1);
            for number in patch.range(pixel) {
                let slice = u64::from(patch.voxels()[number].slice);
                if let Some(mean) = self.sums[number].mean(high) {
                    let place = slice >> 6 << 18 | ((y << 6 | x) as u64) << 6 | slice & 63;
                    self.found.push((place, mean));
                }
            }
        }
        if self.found.len() > self.most {
            let what = "voxels with colours in one tile column (larger slices are fewer)";
            return Err(Error::limit(what, self.found.len(), self.most).with_suggestion(Parameter::Memory));
        }
        Ok(())
    }

    /// Clears the column.
    pub fn clear(&mut self) {
        self.found.clear();
        self.found.shrink_to(1 << 16);
    }

    /// Sets `out` to the colours of a page's voxels in the order of `occupancy`, which is set to that of the page. The
    /// column's lowest slice is `first_slice`.
    pub fn of_page(
        &mut self,
        first_slice: i64,
        layer: i32,
        page: &Page,
        occupancy: &mut Occupancy,
        out: &mut Vec<Option<[u16; 3]>>,
    ) {
        if !self.found.is_sorted_by_key(|found| found.0) {
            self.found.sort_unstable_by_key(|found| found.0);
        }
        occupancy.set(page);
        out.clear();
        out.resize(occupancy.len(), None);
        let layer = (i64::from(layer) - first_slice.div_euclid(PAGE_SLICES)) as u64;
        let start = self.found.partition_point(|found| found.0 >> 18 < layer);
        for &(place, mean) in self.found[start..].iter().take_while(|found| found.0 >> 18 == layer) {
            // A point on the top boundary of a span may lie in a slice that the span does not occupy; it colours
            // nothing.
            if let Some(number) = occupancy.find((place >> 6 & 0xFFF) as usize, place as u32 & 63) {
                out[number] = Some(mean);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::accumulate::Sums;
    use super::super::record::Recorder;
    use super::*;
    use crate::frame::Frame;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn channel() -> impl Strategy<Value = u16> {
        prop_oneof![0u16..256, (0u16..256).prop_map(|v| v * 257), (0u16..256).prop_map(|v| v << 8), any::<u16>()]
    }

    proptest! {
        #[test]
        fn records_of_values_add_up_to_those_of_points(
            values in proptest::collection::vec([channel(), channel(), channel()], 1..60), source in 0usize..3
        ) {
            let source = ColourSource::ALL[source];
            let scale = ColourScale { source, low: 100, high: if source == ColourSource::Class { 255 } else { 60_000 } };
            let (mut sum, mut expected) = (ColourSum::default(), ColourSum::default());
            for &value in &values {
                let (first, second) = values_of(source, value);
                prop_assert!(first < 1 << VALUE_BITS && second.is_none_or(|second| second < 1 << VALUE_BITS));
                for record in second.into_iter().chain([first]) {
                    add(&mut sum, &scale, record);
                }
                let channels = match source {
                    ColourSource::Rgb => value,
                    ColourSource::Intensity => [scale.stretch(value[0]); 3],
                    _ => class_colour(value[0] as u8).map(u16::from),
                };
                expected.n += 1;
                (0..3).for_each(|at| expected.sum[at] += u64::from(channels[at]));
            }
            prop_assert_eq!(sum, expected);
        }

        #[test]
        fn records_of_pieces_add_up_to_their_colours_times_their_weights(
            pieces in proptest::collection::vec((any::<[u8; 3]>(), 1u32..=MOST_WEIGHT), 1..60), wide: bool
        ) {
            let scale = ColourScale::of_rgb(if wide { 1000 } else { 255 });
            let (mut sum, mut expected) = (ColourSum::default(), ColourSum::default());
            for &(colour, weight) in &pieces {
                let (first, second) = values_of_piece(&scale, PaintedPiece { colour, weight });
                prop_assert!(first < 1 << VALUE_BITS && second.is_none_or(|second| second < 1 << VALUE_BITS));
                for record in second.into_iter().chain([first]) {
                    add(&mut sum, &scale, record);
                }
                expected.n += u64::from(weight);
                let one = if wide { 257 } else { 1 };
                (0..3).for_each(|at| expected.sum[at] += u64::from(weight) * u64::from(colour[at]) * one);
            }
            prop_assert_eq!(sum, expected);
        }

        #[test]
        fn a_sieve_keeps_the_values_of_points_that_stay(
            points in proptest::collection::vec(((0.0f64..6.3, 0.0f64..6.3, 0.0f64..3.0), [channel(), channel(), channel()]), 1..80),
            pieces in 1usize..9
        ) {
            let recorder = Recorder::new(Frame::new(0.1, 0.3).unwrap());
            // Any rule that depends on the whole record.
            let removed = |record: Record| (record.0.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 60) < 6;
            let (mut all, mut expected) = (Vec::new(), Vec::new());
            for &((x, y, z), rgb) in &points {
                let (axes, value) = ([&[x][..], &[y], &[z]], values_of(ColourSource::Rgb, rgb));
                recorder.record_values(axes, true, |_| value, |_, record| all.push(record));
                let mut own = Vec::new();
                recorder.record(axes[0], axes[1], axes[2], |index, record| {
                    if (index.tx, index.ty) == (0, 0) { own.push(record); }
                });
                if !removed(own[0]) {
                    recorder.record_values(axes, false, |_| value, |_, record| expected.push(record));
                }
            }
            let (mut sieve, mut found) = (ValueSieve::default(), Vec::new());
            all.chunks(pieces).for_each(|piece| sieve.sift(piece, removed, &mut found));
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn records_say_what_the_values_of_an_input_need(value in [channel(), channel(), channel()]) {
            let (first, second) = values_of(ColourSource::Rgb, value);
            let wide = second.into_iter().chain([first]).any(|value| ValueFact::of(value) == ValueFact::Wide);
            prop_assert_eq!(wide, value.iter().any(|&value| value > 255));
            let (first, _) = values_of(ColourSource::Intensity, value);
            prop_assert_eq!(ValueFact::of(first), ValueFact::Value(value[0]));
        }

        #[test]
        fn voxels_have_the_means_of_their_points(
            points in proptest::collection::vec(((0.0f64..6.3, 0.0f64..6.3, 0.0f64..3.0), [any::<u8>(), any::<u8>(), any::<u8>()]), 1..500),
            pieces in 1usize..40
        ) {
            let frame = Frame::new(0.1, 0.3).unwrap();
            let recorder = Recorder::new(frame);
            let (mut records, mut colours) = (Vec::new(), Vec::new());
            let mut sums: BTreeMap<(i64, i64, i64), ([u64; 3], u64)> = BTreeMap::new();
            for &((x, y, z), rgb) in &points {
                recorder.record(&[x], &[y], &[z], |index, record| {
                    if (index.tx, index.ty) == (0, 0) { records.push(record); }
                });
                let value = values_of(ColourSource::Rgb, rgb.map(u16::from));
                recorder.record_values([&[x], &[y], &[z]], false, |_| value, |_, record| colours.push(record));
                let at = sums.entry((frame.pixel_of(x), frame.pixel_of(y), frame.slice_of(z))).or_default();
                (0..3).for_each(|c| at.0[c] += u64::from(rgb[c]));
                at.1 += 1;
            }
            let mut patch = Patch::default();
            patch.fold(&records[..], 1, Area::TILE, &mut Sums::default());
            let mut column = ColumnColours::new(ColourScale::of_rgb(255), 1 << 20);
            for area in Area::TILE.halves().unwrap().into_iter().rev() {
                column.begin(&patch);
                colours.chunks(pieces).for_each(|records| column.add(&patch, area, records));
                column.end(&patch, area).unwrap();
            }
            prop_assert_eq!(column.found.len(), sums.len());
            for &(place, mean) in &column.found {
                let slice = ((place >> 18) as i64) * 64 + (place & 63) as i64 - super::super::record::BLOCK_SLICES / 2;
                let (sum, n) = sums[&((place >> 6 & 63) as i64, (place >> 12 & 63) as i64, slice)];
                prop_assert_eq!(Some(mean), ColourSum { n, sum }.mean(255));
            }
        }
    }
}
