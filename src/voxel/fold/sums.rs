//! Records grouped by pixel, and sums over those of a voxel.

use super::{Moments, Patch, Voxel};
use crate::voxel::bands::Bands;
use crate::voxel::record::{Content, PATCH_AREA, PATCH_PIXELS, Record, RecordPieces, SLICE_STEPS, SUBPIXELS};
use std::ops::Range;

/// Records grouped by patch pixel.
#[derive(Debug, Default)]
pub(super) struct ByPixel {
    records: Vec<Record>,
    /// Where each pixel's records begin, and the end.
    starts: Vec<u32>,
}

impl ByPixel {
    /// Replaces the content: a counting sort.
    pub(super) fn set(&mut self, records: &(impl RecordPieces + ?Sized)) {
        // One more than the pixels: while records are placed, entry `p + 1` is where the next one of `p` goes.
        self.starts.clear();
        self.starts.resize(PATCH_AREA + 2, 0);
        records.each(|piece| piece.iter().for_each(|record| self.starts[record.pixel() + 2] += 1));
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.records.resize(end as usize, Record(0));
        records.each(|piece| {
            for &record in piece {
                let place = &mut self.starts[record.pixel() + 1];
                self.records[*place as usize] = record;
                *place += 1;
            }
        });
    }

    fn range(&self, pixel: usize) -> Range<usize> {
        self.starts[pixel] as usize..self.starts[pixel + 1] as usize
    }

    /// The records of a pixel; none where all records are gone.
    #[inline]
    fn of(&self, pixel: usize) -> &[Record] {
        if self.starts.is_empty() { &[] } else { &self.records[self.range(pixel)] }
    }

    /// The records of a pixel, whose order may change.
    #[inline]
    pub(super) fn of_mut(&mut self, pixel: usize) -> &mut [Record] {
        let range = self.range(pixel);
        &mut self.records[range]
    }
}

/// Sums kept at once; beyond that they are made again when they are wanted again.
pub(super) const KEPT_SUMS: usize = 1 << 16;
const NO_SUM: u32 = u32::MAX;
/// Bands and records of a patch up to which sums about its origin are small enough: squares of heights below 2²⁰ steps, of fewer than
/// 2²² points.
const MOST_BANDS: u32 = 1 << 7;
const MOST_RECORDS: usize = 1 << 22;
const _: () = assert!(MOST_BANDS as i64 * SLICE_STEPS <= 1 << 20 && PATCH_PIXELS as i64 * SUBPIXELS <= 1 << 20);
/// Records per voxel up to which summing all costs less than it saves.
const MOST_RECORDS_FEW: usize = 6;

/// Place of a point about the origin of its patch: of the first pixel and the band `lowest`.
#[inline]
pub fn place_in_patch(record: Record, pixel: usize, bands: Bands, lowest: u32) -> [i64; 3] {
    let ((u, v), x, y) = (record.place(), pixel % PATCH_PIXELS, pixel / PATCH_PIXELS);
    let above = i64::from(bands.of(record.slice()) - lowest) * SLICE_STEPS;
    [i64::from(u) + x as i64 * SUBPIXELS, i64::from(v) + y as i64 * SUBPIXELS, bands.height(record) + above]
}

/// Sums over the points of voxels, made when they are wanted: most voxels are judged by the extent of their matter alone.
///
/// Memory: the records of the patch, 4 bytes per voxel, and [`KEPT_SUMS`] sums; or the sums of all voxels where the
/// records are gone.
#[derive(Debug, Default)]
pub struct Sums {
    bands: Bands,
    pub(super) records: ByPixel,
    /// Whether `records` are those of the patch's voxels and no others.
    are_all_kept: bool,
    /// See [`lowest_band`](Self::lowest_band).
    lowest_band: Option<u32>,
    /// Whether the records of a pixel are in order of slices.
    pub(super) in_order: Vec<bool>,
    pub(super) kept: Vec<Moments>,
    /// Place in `kept` of each voxel's sums.
    pub(super) places: Vec<u32>,
}

impl Sums {
    /// No sums yet; heights will be those above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Adds to `sums` those over the points of voxel `number` of `patch`, which lies in `pixel`: about the origin of the patch, where there is
    /// [one](Self::lowest_band), else about that of `sums`, which is so many pixels and bands away.
    #[inline]
    pub fn add_to(&mut self, sums: &mut Moments, patch: &Patch, (pixel, number): (usize, usize), away: [i64; 3]) {
        match (self.records.of(pixel), self.lowest_band) {
            // Scans have many voxels of one point, whose sums need not be kept.
            ([record], Some(lowest)) if record.content() == Content::Point => {
                let [u, v, w] = place_in_patch(*record, pixel, self.bands, lowest);
                sums.add(u, v, w);
            }
            (_, Some(_)) => sums.add_all(self.of(patch, pixel, number)),
            (_, None) => {
                let [x, y, bands] = away;
                sums.add_shifted(self.of(patch, pixel, number), x, y, bands);
            }
        }
    }

    /// The sums over the points of voxel `number` of `patch`, which lies in `pixel`: about the origin of the patch, where there is one, else
    /// about that of the voxel.
    pub fn of(&mut self, patch: &Patch, pixel: usize, number: usize) -> &Moments {
        if self.places[number] == NO_SUM {
            if self.kept.len() >= KEPT_SUMS {
                self.kept.clear();
                self.places.fill(NO_SUM);
            }
            let own = self.records.of_mut(pixel);
            if !std::mem::replace(&mut self.in_order[pixel], true) {
                own.sort_unstable();
            }
            let slice = patch.voxels[number].slice;
            let first = own.partition_point(|record| record.slice() < slice);
            let of_voxel = own[first..].iter().take_while(|record| record.slice() == slice);
            let mut sums = Moments::default();
            match self.lowest_band {
                Some(lowest) => of_voxel.filter(|record| record.content() == Content::Point).for_each(|&record| {
                    let [u, v, w] = place_in_patch(record, pixel, self.bands, lowest);
                    sums.add(u, v, w);
                }),
                None => of_voxel.for_each(|&record| sums.add_record(record, self.bands)),
            }
            self.places[number] = self.kept.len() as u32;
            self.kept.push(sums);
        }
        &self.kept[self.places[number] as usize]
    }

    /// The lowest band of the patch, if sums are about one origin for all of it, that of its first pixel and this band: what a fit makes of
    /// them does not depend on it.
    pub fn lowest_band(&self) -> Option<u32> {
        self.lowest_band
    }

    /// The records of each pixel, if they are few for their voxels and those of no others.
    pub fn few_by_pixel<'s>(&'s self) -> Option<impl Fn(usize) -> &'s [Record]> {
        let count = self.records.records.len();
        let are_few = count <= MOST_RECORDS_FEW * self.places.len();
        (self.are_all_kept && are_few).then_some(|pixel| self.records.of(pixel))
    }

    /// Takes the records of a patch.
    pub(super) fn begin(&mut self, records: &(impl RecordPieces + ?Sized)) {
        self.records.set(records);
        self.in_order.clear();
        self.in_order.resize(PATCH_AREA, false);
    }

    /// Nothing is summed yet of the voxels of the patch, in which all records may be kept.
    pub(super) fn end(&mut self, voxels: &[Voxel], are_all_kept: bool) {
        self.are_all_kept = are_all_kept;
        let (lowest, highest) = voxels.iter().fold((u32::MAX, 0), |(lowest, highest), voxel| {
            let band = self.bands.of(voxel.slice);
            (band.min(lowest), band.max(highest))
        });
        let is_small = highest.saturating_sub(lowest) < MOST_BANDS && self.records.records.len() < MOST_RECORDS;
        self.lowest_band = is_small.then_some(lowest);
        self.kept.clear();
        self.places.clear();
        self.places.resize(voxels.len(), NO_SUM);
    }

    /// Only these voxels of the patch stay, one after the other.
    pub(super) fn retain(&mut self, stays: &[bool]) {
        self.are_all_kept &= stays.iter().all(|&stays| stays);
        let mut stays = stays.iter();
        self.places.retain(|_| stays.next().is_none_or(|&stays| stays));
    }

    /// The sums of all voxels, in order.
    pub(super) fn set_all(&mut self, all: impl Iterator<Item = Moments>) {
        self.records = ByPixel::default();
        (self.are_all_kept, self.lowest_band) = (false, None);
        self.kept.clear();
        self.kept.extend(all);
        self.places.clear();
        self.places.extend(0..self.kept.len() as u32);
    }
}
