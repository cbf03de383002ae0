//! Conversion of point records to metres: the inner loop of both decoders.
//!
//! Input: whole records as bytes, in the layout of a LAS file. Output: kept points in a [`PointBatch`].
//! The arithmetic is exactly `(raw · scale + offset) · unit` in `f64`, each step rounded once (no fused operation),
//! followed by the rotation to z up and the placement, if there is one, so that an independent reader gets the same bits.

use crate::placement::Similarity;
use crate::plan::{ClassSet, Up};
use crate::{PointBatch, PointCounts};

/// Greatest magnitude of a kept coordinate (m).
pub const FARTHEST_M: f64 = 1e12;

/// Converts raw integers to metres, z up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Transform {
    pub scale: [f64; 3],
    pub offset: [f64; 3],
    /// Metres per file unit along the file's x, y and z.
    pub unit: [f64; 3],
    pub up: Up,
    /// Placement of the points (m, z up).
    pub placement: Option<Similarity>,
}

impl Transform {
    #[inline(always)]
    fn axis(&self, axis: usize, raw: i32) -> f64 {
        (f64::from(raw) * self.scale[axis] + self.offset[axis]) * self.unit[axis]
    }

    /// Returns the point of a record before the rotation to z up (m).
    fn place(&self, record: &[u8]) -> [f64; 3] {
        std::array::from_fn(|axis| self.axis(axis, raw(record, axis)))
    }

    /// Returns whether every raw value yields a coordinate within [`FARTHEST_M`].
    fn always_near(&self) -> bool {
        [i32::MIN, i32::MAX].iter().all(|&raw| (0..3).all(|a| self.axis(a, raw).abs() <= FARTHEST_M))
    }

    /// Converts a corner from file units to metres, z up; `None` if not finite.
    pub(super) fn corner(&self, at: [f64; 3]) -> Option<[f64; 3]> {
        let m = [at[0] * self.unit[0], at[1] * self.unit[1], at[2] * self.unit[2]];
        let placed = self.placed(self.up.turn(m));
        placed.iter().all(|v| v.is_finite()).then_some(placed)
    }

    fn placed(&self, at: [f64; 3]) -> [f64; 3] {
        self.placement.map_or(at, |placement| placement.apply(at))
    }

    /// Converts a box from file units to metres, z up: a box that holds the placed one. `None` if not finite.
    pub(super) fn bounds(&self, a: [f64; 3], b: [f64; 3]) -> Option<([f64; 3], [f64; 3])> {
        let unplaced = Self { placement: None, ..*self };
        let (a, b) = (unplaced.corner(a)?, unplaced.corner(b)?);
        let pick = |f: fn(f64, f64) -> f64| std::array::from_fn(|axis| f(a[axis], b[axis]));
        let (min, max) = (pick(f64::min), pick(f64::max));
        let Some(placement) = self.placement else { return Some((min, max)) };
        let (min, max) = placement.apply_to_box(min, max);
        min.iter().chain(&max).all(|v| v.is_finite()).then_some((min, max))
    }
}

/// Location of flags and class in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// Formats 0 to 5: class in bits 0 to 4 of byte 15, withheld flag in bit 7.
    Old,
    /// Formats 6 to 10: withheld flag in bit 2 of byte 15, class in byte 16.
    Extended,
}

/// Location of colour values in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    /// Three 16-bit numbers from this byte on.
    Rgb(usize),
    /// The 16-bit intensity.
    Intensity,
    /// The class.
    Class(Layout),
}

impl Field {
    #[inline]
    fn of(self, record: &[u8]) -> [u16; 3] {
        let number = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
        match self {
            Self::Rgb(at) => [number(at), number(at + 2), number(at + 4)],
            Self::Intensity => [number(12), 0, 0],
            Self::Class(Layout::Old) => [u16::from(record[15] & 31), 0, 0],
            Self::Class(Layout::Extended) => [u16::from(record[16]), 0, 0],
        }
    }
}

/// Location of the tag in a record that identifies the station of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TagField {
    /// The point source id, from this byte on.
    SourceId(usize),
    /// The GPS time (s), from this byte on.
    GpsTime(usize),
}

impl TagField {
    #[inline]
    fn of(self, record: &[u8]) -> f64 {
        match self {
            Self::SourceId(at) => f64::from(u16::from_le_bytes([record[at], record[at + 1]])),
            Self::GpsTime(at) => f64::from_le_bytes(std::array::from_fn(|byte| record[at + byte])),
        }
    }
}

/// Fields to read from a record besides coordinates, flags and class.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Extras {
    pub field: Option<Field>,
    pub tag: Option<TagField>,
}

const WITHHELD: u8 = 1;
const EXCLUDED: u8 = 2;

/// Filter for points to leave out: tables over bytes 15 and 16 of a record.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    byte_15: [u8; 256],
    byte_16: [u8; 256],
}

impl Filter {
    pub(super) fn new(layout: Layout, exclude: &ClassSet) -> Self {
        let none = exclude.is_empty();
        let excluded = |class: usize| if !none && exclude.contains(class as u8) { EXCLUDED } else { 0 };
        let withheld = |byte: usize, bit: u32| if byte >> bit & 1 == 1 { WITHHELD } else { 0 };
        let (byte_15, byte_16) = match layout {
            Layout::Old => (std::array::from_fn(|b| withheld(b, 7) | excluded(b & 31)), [0; 256]),
            Layout::Extended => (std::array::from_fn(|b| withheld(b, 2)), std::array::from_fn(excluded)),
        };
        Self { byte_15, byte_16 }
    }

    #[inline(always)]
    fn verdict(&self, record: &[u8]) -> u8 {
        self.byte_15[usize::from(record[15])] | self.byte_16[usize::from(record[16])]
    }
}

/// Replaces the content of `batch` by the kept points of `records`, each `stride` (at least 20) bytes long, with the
/// values and tags of the fields in `extras`, if given; other fields are ignored. Updates all of `counts` but
/// `missing`.
pub(super) fn convert(
    records: &[u8],
    stride: usize,
    transform: &Transform,
    filter: &Filter,
    extras: Extras,
    batch: &mut PointBatch,
    counts: &mut PointCounts,
) {
    let n = records.len() / stride;
    counts.read += n as u64;
    batch.resize(n);
    batch.values.clear();
    batch.tags.clear();
    let flagged = records.chunks_exact(stride).fold(0, |any, record| any | filter.verdict(record));
    // If no raw value can be out of range, records without flags need no check of their coordinates.
    if flagged == 0 && transform.always_near() {
        // Constant strides let the compiler unroll: the usual record lengths without extra bytes.
        match stride {
            20 => whole::<20>(records, transform, batch),
            26 => whole::<26>(records, transform, batch),
            28 => whole::<28>(records, transform, batch),
            30 => whole::<30>(records, transform, batch),
            34 => whole::<34>(records, transform, batch),
            36 => whole::<36>(records, transform, batch),
            38 => whole::<38>(records, transform, batch),
            _ => place(records.chunks_exact(stride), transform, batch),
        }
        if let Some(field) = extras.field {
            batch.values.extend(records.chunks_exact(stride).map(|record| field.of(record)));
        }
        if let Some(tag) = extras.tag {
            batch.tags.extend(records.chunks_exact(stride).map(|record| tag.of(record)));
        }
    } else {
        let kept = sieve(records, stride, transform, filter, extras, batch, counts);
        batch.resize(kept);
    }
    if transform.up == Up::Y {
        std::mem::swap(&mut batch.y, &mut batch.z);
        batch.y.iter_mut().for_each(|y| *y = -*y);
    }
    transform.placement.iter().for_each(|placement| placement.apply_to(batch.columns()));
}

fn whole<const STRIDE: usize>(records: &[u8], transform: &Transform, batch: &mut PointBatch) {
    let (records, _) = records.as_chunks::<STRIDE>();
    place(records.iter().map(|r| r.as_slice()), transform, batch);
}

#[inline(always)]
fn raw(record: &[u8], axis: usize) -> i32 {
    let at = 4 * axis;
    i32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]])
}

#[inline(always)]
fn place<'a>(records: impl Iterator<Item = &'a [u8]>, transform: &Transform, batch: &mut PointBatch) {
    let places = batch.x.iter_mut().zip(&mut batch.y).zip(&mut batch.z);
    for (record, ((x, y), z)) in records.zip(places) {
        *x = transform.axis(0, raw(record, 0));
        *y = transform.axis(1, raw(record, 1));
        *z = transform.axis(2, raw(record, 2));
    }
}

/// Converts slabs in which points are left out; returns the number of kept points, which are stored first in `batch`.
fn sieve(
    records: &[u8],
    stride: usize,
    transform: &Transform,
    filter: &Filter,
    extras: Extras,
    batch: &mut PointBatch,
    counts: &mut PointCounts,
) -> usize {
    let mut kept = 0;
    for record in records.chunks_exact(stride) {
        let verdict = filter.verdict(record);
        if verdict != 0 {
            // A withheld point of an excluded class counts as withheld.
            *(if verdict & WITHHELD != 0 { &mut counts.withheld } else { &mut counts.excluded }) += 1;
            continue;
        }
        let point = transform.place(record);
        if !point.iter().all(|v| v.abs() <= FARTHEST_M) {
            counts.not_finite += 1;
            continue;
        }
        [batch.x[kept], batch.y[kept], batch.z[kept]] = point;
        batch.values.extend(extras.field.map(|field| field.of(record)));
        batch.tags.extend(extras.tag.map(|tag| tag.of(record)));
        kept += 1;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(stride: usize, xyz: [i32; 3], byte_15: u8, byte_16: u8) -> Vec<u8> {
        let mut bytes: Vec<u8> = xyz.iter().flat_map(|v| v.to_le_bytes()).collect();
        bytes.resize(stride, 0xEE);
        bytes[15] = byte_15;
        bytes[16] = byte_16;
        bytes
    }

    fn run(records: &[Vec<u8>], layout: Layout, exclude: ClassSet, transform: Transform) -> (PointBatch, PointCounts) {
        let (mut batch, mut counts) = (PointBatch::default(), PointCounts::default());
        let filter = Filter::new(layout, &exclude);
        convert(&records.concat(), records[0].len(), &transform, &filter, Extras::default(), &mut batch, &mut counts);
        (batch, counts)
    }

    const PLAIN: Transform =
        Transform { scale: [0.01; 3], offset: [1.0, -2.0, 3.0], unit: [1.0; 3], up: Up::Z, placement: None };

    #[test]
    fn every_stride_gives_the_same_exact_coordinates() {
        for stride in 20..=70 {
            let records: Vec<_> = (0..9).map(|i| record(stride, [i, -i * 7, i32::MAX - i], 0, 0)).collect();
            let (batch, counts) = run(&records, Layout::Extended, ClassSet::default(), PLAIN);
            assert_eq!(counts.read, 9);
            for i in 0..9 {
                assert_eq!(batch.x[i], i as f64 * 0.01 + 1.0);
                assert_eq!(batch.y[i], -(i as f64) * 7.0 * 0.01 + -2.0);
                assert_eq!(batch.z[i], f64::from(i32::MAX - i as i32) * 0.01 + 3.0);
            }
        }
    }

    #[test]
    fn withheld_and_excluded_points_are_left_out_and_counted_in_both_layouts() {
        let exclude: ClassSet = [7, 130].into_iter().collect();
        let old: Vec<_> = [0, 0x80, 7, 0x87, 0x67, 2].map(|b| record(20, [1, 2, 3], b, 7)).into();
        let (batch, counts) = run(&old, Layout::Old, exclude, PLAIN);
        assert_eq!((batch.len(), counts.withheld, counts.excluded), (2, 2, 2));
        let extended: Vec<_> =
            [(0, 0), (4, 0), (0, 7), (4, 7), (3, 130), (0x80, 2)].map(|(f, c)| record(30, [1, 2, 3], f, c)).into();
        let (batch, counts) = run(&extended, Layout::Extended, exclude, PLAIN);
        assert_eq!((batch.len(), counts.withheld, counts.excluded, counts.read), (2, 2, 2, 6));
    }

    #[test]
    fn values_belong_to_the_points_that_are_kept() {
        let exclude: ClassSet = [7].into_iter().collect();
        for (layout, stride, classes) in [(Layout::Old, 26, [2, 7, 3]), (Layout::Extended, 36, [2, 7, 3])] {
            for exclude in [ClassSet::default(), exclude] {
                let records: Vec<u8> = (0u8..3)
                    .flat_map(|at| {
                        let class = classes[usize::from(at)];
                        let (b15, b16) = if layout == Layout::Old { (class, 0) } else { (0, class) };
                        let mut record = record(stride, [at.into(), 0, 0], b15, b16);
                        record[12..14].copy_from_slice(&(1000 + u16::from(at)).to_le_bytes());
                        record[stride - 6..].copy_from_slice(&[at, 1, at, 2, at, 3]);
                        record
                    })
                    .collect();
                let filter = Filter::new(layout, &exclude);
                let kept: Vec<u16> = (0..3).filter(|&at| exclude.is_empty() || at != 1).collect();
                for field in [Field::Rgb(stride - 6), Field::Intensity, Field::Class(layout)] {
                    let (mut batch, mut counts) = (PointBatch::default(), PointCounts::default());
                    let extras = Extras { field: Some(field), tag: Some(TagField::SourceId(stride - 4)) };
                    convert(&records, stride, &PLAIN, &filter, extras, &mut batch, &mut counts);
                    let expected = kept.iter().map(|&at| match field {
                        Field::Rgb(_) => [256 + at, 512 + at, 768 + at],
                        Field::Intensity => [1000 + at, 0, 0],
                        Field::Class(_) => [u16::from(classes[usize::from(at)]), 0, 0],
                    });
                    assert_eq!(batch.values, expected.collect::<Vec<_>>());
                    assert_eq!(batch.len(), kept.len());
                    let tags: Vec<f64> = kept.iter().map(|&at| f64::from(512 + at)).collect();
                    assert_eq!(batch.tags, tags);
                }
            }
        }
    }

    #[test]
    fn far_and_infinite_coordinates_are_left_out_and_counted() {
        let records: Vec<_> = [1, 1000, i32::MAX, -5].map(|v| record(34, [v, 0, 0], 0, 0)).into();
        let (batch, counts) =
            run(&records, Layout::Old, ClassSet::default(), Transform { scale: [1e10, 1.0, 1.0], ..PLAIN });
        assert_eq!((batch.x.as_slice(), counts.not_finite), ([1e10 + 1.0, -5e10 + 1.0].as_slice(), 2));
        let (batch, counts) =
            run(&records, Layout::Old, ClassSet::default(), Transform { scale: [1e308, 1.0, 1.0], ..PLAIN });
        assert_eq!((batch.len(), counts.not_finite), (0, 4));
    }

    #[test]
    fn corners_are_placed_as_points_are() {
        // A quarter turn about z, twice the size, and a shift.
        let matrix = [0.0, -2.0, 0.0, 10.0, 2.0, 0.0, 0.0, 20.0, 0.0, 0.0, 2.0, 30.0, 0.0, 0.0, 0.0, 1.0];
        let placed = Transform { placement: Some(Similarity::of_matrix(matrix).unwrap()), ..PLAIN };
        assert_eq!(placed.corner([1.0, 2.0, 3.0]), Some([6.0, 22.0, 36.0]));
        assert_eq!(placed.corner([f64::MAX, 0.0, 0.0]), None);
        let (batch, _) = run(&[record(20, [0, 400, 0], 0, 0)], Layout::Old, ClassSet::default(), placed);
        assert_eq!(placed.corner([1.0, 2.0, 3.0]), Some([batch.x[0], batch.y[0], batch.z[0]]));
    }

    #[test]
    fn up_y_turns_z_to_minus_y_and_y_to_z() {
        let turned = Transform { unit: [0.5, 0.5, 2.0], up: Up::Y, ..PLAIN };
        let (batch, _) = run(&[record(26, [100, 200, 300], 0, 0)], Layout::Old, ClassSet::default(), turned);
        assert_eq!((batch.x[0], batch.y[0], batch.z[0]), (1.0, -12.0, 0.0));
    }
}
