//! Records grouped by pixel, and sums over the points of a voxel.

use super::{Moments, Patch, Voxel};
use crate::voxel::bands::Bands;
use crate::voxel::record::{Content, PATCH_AREA, PATCH_PIXELS, Record, RecordPieces, SLICE_STEPS, SUBPIXELS};
use std::ops::Range;

/// Records grouped by patch pixel.
#[derive(Debug, Default)]
pub(super) struct ByPixel {
    records: Vec<Record>,
    /// Start of each pixel's records, and the end of the last.
    starts: Vec<u32>,
}

impl ByPixel {
    /// Replaces the contents, by counting sort.
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

    /// Returns the records of a pixel; none after [`Sums::set_all`] has dropped them.
    #[inline]
    fn of(&self, pixel: usize) -> &[Record] {
        if self.starts.is_empty() { &[] } else { &self.records[self.range(pixel)] }
    }

    /// Returns the records of a pixel, whose order may change.
    #[inline]
    pub(super) fn of_mut(&mut self, pixel: usize) -> &mut [Record] {
        let range = self.range(pixel);
        &mut self.records[range]
    }
}

/// Most sums kept in memory; when they are full, all are dropped and recomputed on demand.
pub(super) const KEPT_SUMS: usize = 1 << 16;
const NO_SUM: u32 = u32::MAX;
/// Limits of bands and records of a patch within which sums about its origin do not overflow: squares of heights below
/// 2²⁰ steps, over fewer than 2²² points.
const MOST_BANDS: u32 = 1 << 7;
const MOST_RECORDS: usize = 1 << 22;
const _: () = assert!(MOST_BANDS as i64 * SLICE_STEPS <= 1 << 20 && PATCH_PIXELS as i64 * SUBPIXELS <= 1 << 20);
/// Up to this number of records per voxel, summing all of them costs less than it saves.
const MOST_RECORDS_FEW: usize = 6;

/// Returns the position of a point relative to the origin of its patch: the first pixel and the band `lowest`.
#[inline]
pub fn place_in_patch(record: Record, pixel: usize, bands: Bands, lowest: u32) -> [i64; 3] {
    let ((u, v), x, y) = (record.place(), pixel % PATCH_PIXELS, pixel / PATCH_PIXELS);
    let above = i64::from(bands.of(record.slice()) - lowest) * SLICE_STEPS;
    [i64::from(u) + x as i64 * SUBPIXELS, i64::from(v) + y as i64 * SUBPIXELS, bands.height(record) + above]
}

/// Sums over the points of voxels, computed on demand, because most voxels are classified by their extent alone.
///
/// Memory: the records of the patch, 4 bytes per voxel, and [`KEPT_SUMS`] sums; or the sums of all voxels if there are
/// no records.
#[derive(Debug, Default)]
pub struct Sums {
    bands: Bands,
    pub(super) records: ByPixel,
    /// True if `records` belong to the patch's voxels only.
    are_all_kept: bool,
    /// See [`lowest_band`](Self::lowest_band).
    lowest_band: Option<u32>,
    /// True if the records of a pixel are sorted by slice.
    pub(super) in_order: Vec<bool>,
    pub(super) kept: Vec<Moments>,
    /// Index into `kept` of each voxel's sums.
    pub(super) places: Vec<u32>,
}

impl Sums {
    /// Creates empty sums of heights above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Adds to `sums` those over the points of voxel `number` of `patch`, which lies in `pixel`. They are about the
    /// origin of the patch if it [has one](Self::lowest_band), else about that of `sums`, from which the voxel lies
    /// `away` (pixels, pixels, bands).
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

    /// Returns the sums over the points of voxel `number` of `patch`, which lies in `pixel`: about the origin of the
    /// patch if it has one, else about that of the voxel.
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

    /// Returns the lowest band of the patch if all sums are about one origin, which is the first pixel and this band;
    /// else `None`. Fits do not depend on the origin.
    pub fn lowest_band(&self) -> Option<u32> {
        self.lowest_band
    }

    /// Returns the records of each pixel, if they are few per voxel and all belong to voxels of the patch.
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

    /// Resets the sums for the voxels of the patch; `are_all_kept` states that none of its records belongs to a dropped
    /// voxel.
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

    /// Sets the sums of all voxels, in order, and drops the records.
    pub(super) fn set_all(&mut self, all: impl Iterator<Item = Moments>) {
        self.records = ByPixel::default();
        (self.are_all_kept, self.lowest_band) = (false, None);
        self.kept.clear();
        self.kept.extend(all);
        self.places.clear();
        self.places.extend(0..self.kept.len() as u32);
    }
}
