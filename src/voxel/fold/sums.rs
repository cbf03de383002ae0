//! Records grouped by pixel, and sums over those of a voxel.

use super::{Moments, Patch};
use crate::voxel::bands::Bands;
use crate::voxel::record::{Content, PATCH_AREA, Record, SLICE_STEPS, SUBPIXELS};
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
    pub(super) fn set(&mut self, records: &[Record]) {
        // One more than the pixels: while records are placed, entry `p + 1` is where the next one of `p` goes.
        self.starts.clear();
        self.starts.resize(PATCH_AREA + 2, 0);
        records.iter().for_each(|record| self.starts[record.pixel() + 2] += 1);
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.records.resize(records.len(), Record(0));
        for &record in records {
            let place = &mut self.starts[record.pixel() + 1];
            self.records[*place as usize] = record;
            *place += 1;
        }
    }

    fn range(&self, pixel: usize) -> Range<usize> {
        self.starts[pixel] as usize..self.starts[pixel + 1] as usize
    }

    /// The records of a pixel; none where all records are gone.
    #[inline]
    fn of(&self, pixel: usize) -> &[Record] {
        if self.starts.is_empty() { &[] } else { &self.records[self.range(pixel)] }
    }

    /// Patch pixels with records, in order, and these.
    pub(super) fn pixels(&self) -> impl Iterator<Item = (usize, &[Record])> {
        (0..PATCH_AREA).map(|pixel| (pixel, &self.records[self.range(pixel)])).filter(|(_, own)| !own.is_empty())
    }
}

/// Sums kept at once; beyond that they are made again when they are wanted again.
pub(super) const KEPT_SUMS: usize = 1 << 16;
const NO_SUM: u32 = u32::MAX;
/// Records per voxel up to which summing all costs less than it saves.
const MOST_RECORDS_FEW: usize = 6;

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
    /// Whether the records of a pixel are in order of slices.
    in_order: Vec<bool>,
    pub(super) kept: Vec<Moments>,
    /// Place in `kept` of each voxel's sums.
    pub(super) places: Vec<u32>,
}

impl Sums {
    /// No sums yet; heights will be those above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Adds to `sums` those over the points of voxel `number` of `patch`, which lies in `pixel` and so many pixels and bands away
    /// from the origin of `sums`.
    #[inline]
    pub fn add_to(&mut self, sums: &mut Moments, patch: &Patch, (pixel, number): (usize, usize), away: [i64; 3]) {
        let [x, y, bands] = away;
        match self.records.of(pixel) {
            // Scans have many voxels of one point, whose sums need not be kept.
            [record] if record.content() == Content::Point => {
                let (u, v) = record.place();
                let w = self.bands.height(*record) + bands * SLICE_STEPS;
                sums.add(i64::from(u) + x * SUBPIXELS, i64::from(v) + y * SUBPIXELS, w);
            }
            _ => sums.add_shifted(self.of(patch, pixel, number), x, y, bands),
        }
    }

    /// The sums over the points of voxel `number` of `patch`, which lies in `pixel`.
    pub fn of(&mut self, patch: &Patch, pixel: usize, number: usize) -> &Moments {
        if self.places[number] == NO_SUM {
            if self.kept.len() >= KEPT_SUMS {
                self.kept.clear();
                self.places.fill(NO_SUM);
            }
            let range = self.records.range(pixel);
            let own = &mut self.records.records[range];
            if !std::mem::replace(&mut self.in_order[pixel], true) {
                own.sort_unstable();
            }
            let slice = patch.voxels[number].slice;
            let first = own.partition_point(|record| record.slice() < slice);
            let mut sums = Moments::default();
            own[first..]
                .iter()
                .take_while(|record| record.slice() == slice)
                .for_each(|&record| sums.add_record(record, self.bands));
            self.places[number] = self.kept.len() as u32;
            self.kept.push(sums);
        }
        &self.kept[self.places[number] as usize]
    }

    /// Patch pixels with records, in order, and these, if they are few for their voxels and those of no others.
    pub fn few_by_pixel(&self) -> Option<impl Iterator<Item = (usize, &[Record])>> {
        let count = self.records.records.len();
        let are_few = count <= MOST_RECORDS_FEW * self.places.len() && count < 1 << 22;
        (self.are_all_kept && are_few).then(|| self.records.pixels())
    }

    /// Nothing is summed yet of the voxels of a patch made of `self.records`, all of which may be kept.
    pub(super) fn begin(&mut self, voxels: usize, are_all_kept: bool) {
        self.are_all_kept = are_all_kept;
        self.in_order.clear();
        self.in_order.resize(PATCH_AREA, false);
        self.kept.clear();
        self.places.clear();
        self.places.resize(voxels, NO_SUM);
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
        self.are_all_kept = false;
        self.kept.clear();
        self.kept.extend(all);
        self.places.clear();
        self.places.extend(0..self.kept.len() as u32);
    }
}
