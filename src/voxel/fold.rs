//! Folds the records of a tile column into voxels.
//!
//! The fold of a voxel keeps minima, maxima and sums of integers only. It is associative and commutative to the last
//! bit, so the order of points, files and threads cannot show in what comes out (guarantee G4), and voxels of parts of
//! a scan add up to the voxels of the whole.

use super::bands::Bands;
use super::record::{
    Content, HALO_PIXELS, PATCH_AREA, PATCH_PIXELS, Record, SLICE_STEPS, SUBPIXELS, SurfacePart, bottom_quantum,
    top_quantum,
};
use crate::frame::SLICE_QUANTA;
use std::ops::Range;

/// Parts of a slice in [`Voxel::bins`].
pub const BINS: i64 = 16;
const BIN_STEPS: u32 = (SLICE_STEPS / BINS) as u32;

/// Sums over the points of one voxel, exact: place `u`, `v` in its pixel (1/128 pixel) and height `w` in its band
/// [1/8160 band]. Ten numbers determine the least-squares plane and its residual.
///
/// No sum overflows below 10⁹ points in a 3 × 3 × 3 neighbourhood (24,480² · 10⁹ < 2⁶³).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Moments {
    pub n: i64,
    pub u: i64,
    pub v: i64,
    pub w: i64,
    pub uu: i64,
    pub uv: i64,
    pub vv: i64,
    pub uw: i64,
    pub vw: i64,
    pub ww: i64,
}

impl Moments {
    /// The ten numbers, in the order of the fields.
    pub fn numbers(&self) -> [i64; 10] {
        [self.n, self.u, self.v, self.w, self.uu, self.uv, self.vv, self.uw, self.vw, self.ww]
    }

    /// The inverse of [`numbers`](Self::numbers).
    #[inline]
    pub fn from_numbers([n, u, v, w, uu, uv, vv, uw, vw, ww]: [i64; 10]) -> Self {
        Self { n, u, v, w, uu, uv, vv, uw, vw, ww }
    }

    /// Adds one point.
    #[inline]
    pub fn add(&mut self, u: i64, v: i64, w: i64) {
        self.n += 1;
        self.u += u;
        self.v += v;
        self.w += w;
        self.uu += u * u;
        self.uv += u * v;
        self.vv += v * v;
        self.uw += u * w;
        self.vw += v * w;
        self.ww += w * w;
    }

    /// Adds the point of a record; surfaces do not count.
    #[inline]
    fn add_record(&mut self, record: Record, bands: Bands) {
        if record.content() == Content::Point {
            let (u, v) = record.place();
            self.add(i64::from(u), i64::from(v), bands.height(record));
        }
    }

    /// Adds the points of a voxel that lies `pixels_x`, `pixels_y` and `bands` away from the origin of these sums.
    #[inline]
    pub fn add_shifted(&mut self, of: &Self, pixels_x: i64, pixels_y: i64, bands: i64) {
        let (a, b, c) = (pixels_x * SUBPIXELS, pixels_y * SUBPIXELS, bands * SLICE_STEPS);
        self.n += of.n;
        self.u += of.u + of.n * a;
        self.v += of.v + of.n * b;
        self.w += of.w + of.n * c;
        self.uu += of.uu + 2 * a * of.u + of.n * a * a;
        self.uv += of.uv + a * of.v + b * of.u + of.n * a * b;
        self.vv += of.vv + 2 * b * of.v + of.n * b * b;
        self.uw += of.uw + a * of.w + c * of.u + of.n * a * c;
        self.vw += of.vw + b * of.w + c * of.v + of.n * b * c;
        self.ww += of.ww + 2 * c * of.w + of.n * c * c;
    }
}

/// The matter of one voxel, folded: what points and surfaces have in common. Sums over the points are kept apart, since
/// few voxels need them (see [`Sums`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Voxel {
    /// Slice above the first of the column's block.
    pub slice: u32,
    /// Sixteenths of the slice that hold matter: what lies between bottom and top, matter or void.
    pub bins: u16,
    /// Greatest quantum at or below the lowest matter, above the slice's floor (0..=254).
    pub bottom: u8,
    /// Least quantum at or above the highest matter, above the slice's floor (0..=255).
    pub top: u8,
    /// What the matter is: [`POINTS`](Self::POINTS), [`FLAT`](Self::FLAT), [`STEEP`](Self::STEEP).
    pub kinds: u8,
}

impl Voxel {
    /// A surface that is not steeper than the limit.
    pub const FLAT: u8 = 1;
    /// A surface that is.
    pub const STEEP: u8 = 2;
    /// Points.
    pub const POINTS: u8 = 4;
    /// All that is in it is to be dropped.
    const DROPPED: u8 = 8;

    /// Without matter.
    fn empty(slice: u32) -> Self {
        Self { slice, bins: 0, bottom: u8::MAX, top: 0, kinds: 0 }
    }

    /// Of one record.
    #[inline]
    fn of(record: Record) -> Self {
        let mut voxel = Self::empty(record.slice());
        voxel.add(record);
        voxel
    }

    #[inline]
    fn add(&mut self, record: Record) {
        match record.content() {
            Content::Point => {}
            Content::Surface(part) => return self.add_surface(part),
            Content::Dropped => {
                self.kinds |= Self::DROPPED;
                return;
            }
        }
        let height = record.height();
        self.bottom = self.bottom.min(bottom_quantum(height) as u8);
        self.top = self.top.max(top_quantum(height) as u8);
        self.bins |= 1 << (height / BIN_STEPS);
        self.kinds |= Self::POINTS;
    }

    fn add_surface(&mut self, part: SurfacePart) {
        self.bottom = self.bottom.min(part.bottom);
        self.top = self.top.max(part.top);
        let bin = |quantum: u8| (i64::from(quantum) * BINS / SLICE_QUANTA).min(BINS - 1);
        // What ends on the lower border of a bin does not reach into it.
        let (first, last) = (bin(part.bottom), bin(part.top.saturating_sub(1).max(part.bottom)));
        self.bins |= (u16::MAX >> (BINS - 1 - (last - first))) << first;
        self.kinds |= if part.steep { Self::STEEP } else { Self::FLAT };
    }

    /// Lowest and highest matter (quanta above the floor of slice `floor`).
    #[inline]
    pub fn quanta_above(&self, floor: i64) -> (i64, i64) {
        let below = (i64::from(self.slice) - floor) * SLICE_QUANTA;
        (below + i64::from(self.bottom), below + i64::from(self.top))
    }

    /// Whether a surface steeper than the limit is among its matter.
    pub fn is_steep(&self) -> bool {
        self.kinds & Self::STEEP != 0
    }

    /// Whether it holds points, as opposed to surfaces alone.
    pub fn has_points(&self) -> bool {
        self.kinds & Self::POINTS != 0
    }

    /// Whether a voxel of so many points is kept where `min_points` are asked for.
    fn is_kept(&self, points: i64, min_points: u32) -> bool {
        let has_surface = self.kinds & (Self::FLAT | Self::STEEP) != 0;
        self.kinds & Self::DROPPED == 0 && (has_surface || points >= i64::from(min_points))
    }

    fn merge(&mut self, other: &Self) {
        self.bottom = self.bottom.min(other.bottom);
        self.top = self.top.max(other.top);
        self.bins |= other.bins;
        self.kinds |= other.kinds;
    }
}

/// A rectangle of pixels of a tile column, ends excluded, in pixels of the tile (0..=64).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First and end pixel along x.
    pub x: (u32, u32),
    /// First and end pixel along y.
    pub y: (u32, u32),
}

impl Area {
    /// The whole tile.
    pub const TILE: Self = Self { x: (0, 64), y: (0, 64) };

    /// Whether a patch pixel lies in the area or in the one-pixel halo around it.
    #[inline]
    pub fn holds_with_halo(&self, patch_pixel: usize) -> bool {
        let (x, y) = ((patch_pixel % PATCH_PIXELS) as u32, (patch_pixel / PATCH_PIXELS) as u32);
        // Patch coordinates are one more than the tile's, so `first` is the halo pixel before the area.
        (self.x.0..=self.x.1 + 1).contains(&x) && (self.y.0..=self.y.1 + 1).contains(&y)
    }

    /// Whether a patch pixel lies in the area itself.
    pub fn holds(&self, patch_pixel: usize) -> bool {
        let (x, y) = ((patch_pixel % PATCH_PIXELS) as u32, (patch_pixel / PATCH_PIXELS) as u32);
        (self.x.0 + 1..=self.x.1).contains(&x) && (self.y.0 + 1..=self.y.1).contains(&y)
    }

    /// Two halves along the longer edge; `None` for a single pixel.
    pub fn halves(&self) -> Option<[Self; 2]> {
        let (width, height) = (self.x.1 - self.x.0, self.y.1 - self.y.0);
        if width.max(height) < 2 {
            return None;
        }
        let (mut low, mut high) = (*self, *self);
        if width >= height {
            low.x.1 = self.x.0 + width / 2;
            high.x.0 = low.x.1;
        } else {
            low.y.1 = self.y.0 + height / 2;
            high.y.0 = low.y.1;
        }
        Some([low, high])
    }
}

/// Slices of one pixel that are told apart at once; more than that far apart in one pixel costs a search.
const RECENT: usize = 1 << 10;

/// Folds the records of one pixel after another into voxels; its scratch is reused.
#[derive(Debug)]
struct Folder {
    /// Voxels of the pixel at hand and how many points each has.
    voxels: Vec<(Voxel, u32)>,
    /// Number in `voxels` of the last voxel whose slice has this remainder; may be left over from an earlier pixel.
    recent: Box<[u32; RECENT]>,
}

impl Default for Folder {
    fn default() -> Self {
        Self { voxels: Vec::new(), recent: Box::new([0; RECENT]) }
    }
}

impl Folder {
    /// The voxels of one pixel's records, lowest slice first, with the numbers of their points.
    fn fold(&mut self, points: &[Record]) -> &[(Voxel, u32)] {
        let Self { voxels, recent } = self;
        voxels.clear();
        for &point in points {
            let slice = point.slice();
            let place = &mut recent[slice as usize % RECENT];
            let found = match voxels.get(*place as usize) {
                Some((voxel, _)) if voxel.slice == slice => Some(*place as usize),
                // Another slice of this pixel has the same remainder, so this one may hide behind it.
                Some((voxel, _)) if voxel.slice as usize % RECENT == slice as usize % RECENT => {
                    voxels.iter().position(|(voxel, _)| voxel.slice == slice)
                }
                _ => None,
            };
            let number = found.unwrap_or_else(|| {
                voxels.push((Voxel::empty(slice), 0));
                voxels.len() - 1
            });
            *place = number as u32;
            voxels[number].0.add(point);
            voxels[number].1 = voxels[number].1.saturating_add(1);
        }
        voxels.sort_unstable_by_key(|(voxel, _)| voxel.slice);
        voxels
    }
}

/// Records grouped by patch pixel.
#[derive(Debug, Default)]
struct ByPixel {
    records: Vec<Record>,
    /// Where each pixel's records begin, and the end.
    starts: Vec<u32>,
}

impl ByPixel {
    /// Replaces the content: a counting sort.
    fn set(&mut self, records: &[Record]) {
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
    fn pixels(&self) -> impl Iterator<Item = (usize, &[Record])> {
        (0..PATCH_AREA).map(|pixel| (pixel, &self.records[self.range(pixel)])).filter(|(_, own)| !own.is_empty())
    }
}

/// Sums kept at once; beyond that they are made again when they are wanted again.
const KEPT_SUMS: usize = 1 << 16;
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
    records: ByPixel,
    /// Whether `records` are those of the patch's voxels and no others.
    are_all_kept: bool,
    /// Whether the records of a pixel are in order of slices.
    in_order: Vec<bool>,
    kept: Vec<Moments>,
    /// Place in `kept` of each voxel's sums.
    places: Vec<u32>,
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

    /// Nothing is summed yet of the voxels of a patch made of `self.records`.
    fn begin(&mut self, voxels: usize) {
        self.in_order.clear();
        self.in_order.resize(PATCH_AREA, false);
        self.kept.clear();
        self.places.clear();
        self.places.resize(voxels, NO_SUM);
    }

    /// The sums of all voxels, in order.
    fn set_all(&mut self, all: impl Iterator<Item = Moments>) {
        self.records = ByPixel::default();
        self.are_all_kept = false;
        self.kept.clear();
        self.kept.extend(all);
        self.places.clear();
        self.places.extend(0..self.kept.len() as u32);
    }
}

/// The voxels of a tile column with its halo, pixel after pixel, lowest slice first.
#[derive(Debug, Default)]
pub struct Patch {
    starts: Vec<u32>,
    occupied: Vec<u16>,
    voxels: Vec<Voxel>,
    folder: Folder,
}

impl Patch {
    /// All voxels.
    pub fn voxels(&self) -> &[Voxel] {
        &self.voxels
    }

    /// Patch pixels with voxels, in order.
    pub fn occupied(&self) -> impl Iterator<Item = usize> + '_ {
        self.occupied.iter().map(|&pixel| usize::from(pixel))
    }

    /// Numbers of the voxels of a patch pixel.
    #[inline]
    pub fn range(&self, patch_pixel: usize) -> Range<usize> {
        self.starts[patch_pixel] as usize..self.starts[patch_pixel + 1] as usize
    }

    /// Replaces the content by the fold of `records`, over which `sums` will sum. Voxels of fewer than `min_points` points
    /// and no surface, and those of which a record says so, are dropped; returns how many were, without those in the halo
    /// around `area`.
    pub fn fold(&mut self, records: &[Record], min_points: u32, area: Area, sums: &mut Sums) -> u64 {
        let mut folder = std::mem::take(&mut self.folder);
        self.clear();
        sums.records.set(records);
        let (mut dropped, mut folded) = (0, 0);
        for (pixel, own) in sums.records.pixels() {
            let kept = |(voxel, points): &(Voxel, u32)| voxel.is_kept(i64::from(*points), min_points);
            if let [record] = own {
                let voxel = Voxel::of(*record);
                folded += 1;
                dropped += self.push(pixel, std::iter::once((voxel, kept(&(voxel, 1)))), area);
                continue;
            }
            let voxels = folder.fold(own);
            folded += voxels.len();
            dropped += self.push(pixel, voxels.iter().map(|voxel| (voxel.0, kept(voxel))), area);
        }
        self.end();
        self.folder = folder;
        sums.begin(self.voxels.len());
        sums.are_all_kept = folded == self.voxels.len();
        dropped
    }

    /// Replaces the content by voxels that were folded piecemeal (see [`fold_into`]), and `sums` by theirs.
    pub fn set_folded(&mut self, folded: &Folded, min_points: u32, area: Area, sums: &mut Sums) -> u64 {
        self.clear();
        let kept = |(_, voxel, sums): &(usize, Voxel, Moments)| voxel.is_kept(sums.n, min_points);
        let mut dropped = 0;
        for voxels in folded.chunk_by(|a, b| a.0 == b.0) {
            dropped += self.push(voxels[0].0, voxels.iter().map(|voxel| (voxel.1, kept(voxel))), area);
        }
        self.end();
        sums.set_all(folded.iter().filter(|voxel| kept(voxel)).map(|voxel| voxel.2));
        dropped
    }

    /// Number of the voxel of a patch pixel in this slice.
    #[inline]
    pub fn find(&self, patch_pixel: usize, slice: u32) -> Option<usize> {
        let range = self.range(patch_pixel);
        let voxels = &self.voxels[range.clone()];
        let at = if voxels.len() < 16 {
            voxels.iter().position(|voxel| voxel.slice == slice)
        } else {
            voxels.binary_search_by_key(&slice, |voxel| voxel.slice).ok()
        };
        at.map(|at| range.start + at)
    }

    /// Numbers of the voxels of a patch pixel in these slices.
    #[inline]
    pub fn between(&self, patch_pixel: usize, slices: Range<u32>) -> Range<usize> {
        let range = self.range(patch_pixel);
        let voxels = &self.voxels[range.clone()];
        let first = if voxels.len() < 16 {
            voxels.iter().take_while(|voxel| voxel.slice < slices.start).count()
        } else {
            voxels.partition_point(|voxel| voxel.slice < slices.start)
        };
        let count = voxels[first..].iter().take_while(|voxel| voxel.slice < slices.end).count();
        range.start + first..range.start + first + count
    }

    /// Drops the voxels of `area` that have no other voxel in the 3 × 3 × 3 around them, and returns how many. A lone
    /// voxel is in nobody's neighbourhood, so it makes no difference that those of the halo stay.
    pub fn drop_isolated(&mut self, area: Area, sums: &mut Sums) -> u64 {
        let mut kept = vec![true; self.voxels.len()];
        for pixel in self.occupied().filter(|&pixel| area.holds(pixel)) {
            for number in self.range(pixel) {
                let slice = self.voxels[number].slice;
                let slices = slice.saturating_sub(1)..slice + 2;
                let around: usize =
                    neighbourhood(pixel).map(|(other, ..)| self.between(other, slices.clone()).len()).sum();
                kept[number] = around > 1;
            }
        }
        let before = std::mem::take(self);
        for pixel in before.occupied() {
            let own = before.range(pixel).map(|number| (before.voxels[number], kept[number]));
            self.push(pixel, own, area);
        }
        self.end();
        self.folder = before.folder;
        sums.are_all_kept &= kept.len() == self.voxels.len();
        let mut stay = kept.iter();
        sums.places.retain(|_| stay.next().is_none_or(|&stays| stays));
        (kept.len() - self.voxels.len()) as u64
    }

    fn clear(&mut self) {
        self.starts.clear();
        self.occupied.clear();
        self.voxels.clear();
    }

    /// Adds those voxels of the next pixel that are kept; returns how many of the area's are not.
    fn push(&mut self, pixel: usize, voxels: impl Iterator<Item = (Voxel, bool)>, area: Area) -> u64 {
        let first = self.voxels.len();
        let mut dropped = 0;
        self.voxels.extend(voxels.filter_map(|(voxel, kept)| {
            dropped += u64::from(!kept && area.holds(pixel));
            kept.then_some(voxel)
        }));
        if self.voxels.len() > first {
            self.starts.resize(pixel + 1, first as u32);
            self.occupied.push(pixel as u16);
        }
        dropped
    }

    fn end(&mut self) {
        self.starts.resize(PATCH_AREA + 1, self.voxels.len() as u32);
    }
}

/// The 3 × 3 pixels around a patch pixel that is not in the halo, with their places 0..3 in x and y.
pub fn neighbourhood(patch_pixel: usize) -> impl Iterator<Item = (usize, i64, i64)> {
    (0..9).map(move |place| neighbour(patch_pixel, place))
}

/// The pixel of number `place` in the [`neighbourhood`].
#[inline]
pub fn neighbour(patch_pixel: usize, place: usize) -> (usize, i64, i64) {
    let (dx, dy) = (place % 3, place / 3);
    (patch_pixel + dy * PATCH_PIXELS + dx - PATCH_PIXELS - 1, dx as i64, dy as i64)
}

const _: () = assert!(HALO_PIXELS == 1, "neighbourhoods are 3 × 3 pixels");

/// Voxels with their patch pixel and sums, in order of pixel and slice.
pub type Folded = Vec<(usize, Voxel, Moments)>;

/// Folds records into voxels piece by piece, where they are too many to be kept.
#[derive(Debug, Default)]
pub struct PieceFolder {
    bands: Bands,
    records: ByPixel,
    folder: Folder,
}

impl PieceFolder {
    /// A folder for sums of heights above the floors of `bands`.
    pub fn new(bands: Bands) -> Self {
        Self { bands, ..Self::default() }
    }

    /// Folds `records` into voxels folded before.
    pub fn fold_into(&mut self, folded: &mut Folded, records: &[Record]) {
        let before = std::mem::take(folded);
        folded.reserve(before.len());
        let mut before = before.into_iter().peekable();
        self.records.set(records);
        let mut own_sums = Vec::new();
        for (pixel, own) in self.records.pixels() {
            let voxels = self.folder.fold(own);
            own_sums.clear();
            own_sums.resize(voxels.len(), Moments::default());
            let mut number = 0;
            for &record in own {
                if voxels[number].0.slice != record.slice() {
                    number = voxels.partition_point(|(voxel, _)| voxel.slice < record.slice());
                }
                own_sums[number].add_record(record, self.bands);
            }
            for (&(mut voxel, _), mut sums) in voxels.iter().zip(own_sums.iter().copied()) {
                let key = (pixel, voxel.slice);
                while let Some(earlier) = before.next_if(|(pixel, earlier, _)| (*pixel, earlier.slice) < key) {
                    folded.push(earlier);
                }
                if let Some((_, same, more)) = before.next_if(|(pixel, earlier, _)| (*pixel, earlier.slice) == key) {
                    voxel.merge(&same);
                    sums.add_shifted(&more, 0, 0, 0);
                }
                folded.push((pixel, voxel, sums));
            }
        }
        folded.extend(before);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::plan::Plan;
    use crate::voxel::record::{Recorder, surface_voxels};
    use proptest::prelude::*;

    fn records(points: &[(f64, f64, f64)]) -> Vec<Record> {
        let recorder = Recorder::new(Frame::new(0.5, 1.5).unwrap());
        let mut records = Vec::new();
        for &(x, y, z) in points {
            recorder.record(&[x], &[y], &[z], |index, record| {
                if (index.tx, index.ty) == (0, 0) {
                    records.push(record);
                }
            });
        }
        records
    }

    proptest! {
        #[test]
        fn folding_in_pieces_and_in_any_order_is_folding_at_once(
            points in proptest::collection::vec((-1.0f64..33.0, -1.0f64..33.0, -4.0f64..4.0), 1..6000),
            surfaces in proptest::collection::vec((0i64..64, 0i64..64, -600i64..600, 0i64..300, any::<bool>()), 0..500),
            piece in 1usize..500, min_points in 1u32..3, slices in 1u32..7
        ) {
            let mut records = records(&points);
            let points_kept_at_most = records.len() as i64;
            let recorder = Recorder::new(Frame::new(0.5, 1.5).unwrap());
            for voxel in surfaces.iter().flat_map(|&(i, j, low, more, s)| surface_voxels((i, j), (low, low + more), s)) {
                recorder.record_surface(&voxel, |index, record| {
                    if (index.tx, index.ty) == (0, 0) {
                        records.push(record);
                    }
                });
            }
            let (mut at_once, mut piecemeal) = (Patch::default(), Patch::default());
            let thin = Plan::new(Frame::new(0.5, 1.5 / f64::from(slices)).unwrap());
            let bands = Bands::new(&thin);
            assert_eq!(bands.slices(), slices);
            let (mut made, mut added) = (Sums::new(bands), Sums::default());
            let dropped = at_once.fold(&records, min_points, Area::TILE, &mut made);
            records.reverse();
            let (mut folded, mut folder) = (Folded::new(), PieceFolder::new(bands));
            records.chunks(piece).for_each(|piece| folder.fold_into(&mut folded, piece));
            prop_assert_eq!(piecemeal.set_folded(&folded, min_points, Area::TILE, &mut added), dropped);
            prop_assert_eq!(&at_once.voxels, &piecemeal.voxels);
            prop_assert_eq!(&at_once.starts, &piecemeal.starts);
            let mut points_kept = 0;
            for pixel in at_once.occupied() {
                for number in at_once.range(pixel) {
                    prop_assert_eq!(made.of(&at_once, pixel, number), added.of(&piecemeal, pixel, number));
                    points_kept += made.of(&at_once, pixel, number).n;
                }
            }
            prop_assert!(points_kept <= points_kept_at_most);
            prop_assert!(min_points > 1 || points_kept == points_kept_at_most);
            for &(i, j, low, more, steep) in &surfaces {
                let pixel = (j as usize + 1) * PATCH_PIXELS + i as usize + 1;
                let (first, last) = (low.div_euclid(255), low.max(low + more - 1).div_euclid(255));
                for voxel in (first..=last).map(|slice| slice + crate::voxel::record::BLOCK_SLICES / 2) {
                    let found = at_once.voxels[at_once.range(pixel)].iter().find(|v| i64::from(v.slice) == voxel);
                    prop_assert!(found.is_some_and(|v| v.kinds & (Voxel::FLAT | Voxel::STEEP) != 0 && (v.is_steep() || !steep)));
                }
            }
        }

        #[test]
        fn shifted_sums_are_sums_of_shifted_points(
            points in proptest::collection::vec((0i64..128, 0i64..128, 0i64..8160), 0..50),
            (dx, dy, ds) in (0i64..3, 0i64..3, 0i64..3)
        ) {
            let (mut plain, mut shifted, mut direct) = <(Moments, Moments, Moments)>::default();
            for &(u, v, w) in &points {
                plain.add(u, v, w);
                direct.add(u + dx * SUBPIXELS, v + dy * SUBPIXELS, w + ds * SLICE_STEPS);
            }
            shifted.add_shifted(&plain, dx, dy, ds);
            prop_assert_eq!(shifted, direct);
        }
    }

    #[test]
    fn slices_far_apart_in_one_pixel_are_told_apart() {
        let points: Vec<_> = (0..9000).map(|n| (0.2, 0.2, f64::from(n * 7919 % 4500) * 1.5 + 0.1)).collect();
        let mut patch = Patch::default();
        let mut sums = Sums::default();
        patch.fold(&records(&points), 1, Area::TILE, &mut sums);
        assert_eq!(patch.voxels().len(), 4500);
        assert!(patch.voxels().is_sorted_by_key(|voxel| voxel.slice));
        let pixel = PATCH_PIXELS + 1;
        assert!(patch.range(pixel).all(|number| sums.of(&patch, pixel, number).n == 2));
    }

    #[test]
    fn more_sums_than_are_kept_are_made_again() {
        let places = (0..64 * 64).flat_map(|p| (0..20).map(move |s| (p, s)));
        let points: Vec<_> = places
            .map(|(p, s)| (f64::from(p % 64) * 0.5 + 0.2, f64::from(p / 64) * 0.5 + 0.2, f64::from(s) * 1.5 + 0.1))
            .collect();
        assert!(points.len() > KEPT_SUMS, "the test would show nothing");
        let (mut patch, mut sums) = (Patch::default(), Sums::default());
        patch.fold(&records(&points), 1, Area::TILE, &mut sums);
        for round in 0..2 {
            for pixel in patch.occupied() {
                for number in patch.range(pixel) {
                    let alone = *sums.of(&patch, pixel, number);
                    assert_eq!((alone.n, alone.u), (1, 51), "round {round}, voxel {number}");
                    assert!(sums.kept.len() <= KEPT_SUMS);
                }
            }
        }
    }

    #[test]
    fn only_voxels_alone_in_their_neighbourhood_are_dropped() {
        let points = [
            (5.2, 5.2, 0.1),
            (9.2, 9.2, 0.1),
            (9.7, 9.7, 1.6),
            (20.2, 20.2, 0.1),
            (20.2, 20.2, 3.1),
            (31.7, 3.2, 0.1),
            (32.2, 3.2, 0.1),
        ];
        let mut patch = Patch::default();
        let mut sums = Sums::default();
        patch.fold(&records(&points), 1, Area::TILE, &mut sums);
        assert_eq!(
            patch.drop_isolated(Area::TILE, &mut sums),
            3,
            "one alone, two a slice apart; not the diagonal pair"
        );
        assert_eq!(patch.voxels().len(), 4, "the last pair lies across the tile's edge and stays");
        assert_eq!(patch.occupied().count(), 4);
        assert_eq!(sums.places.len(), 4, "the sums stay with their voxels");
    }

    #[test]
    fn halves_cover_an_area_without_overlap_down_to_single_pixels() {
        let mut open = vec![Area::TILE];
        let mut seen = vec![false; 4096];
        while let Some(area) = open.pop() {
            match area.halves() {
                Some(halves) => open.extend(halves),
                None => {
                    assert_eq!((area.x.1, area.y.1), (area.x.0 + 1, area.y.0 + 1));
                    let pixel = (area.y.0 * 64 + area.x.0) as usize;
                    assert!(!std::mem::replace(&mut seen[pixel], true));
                }
            }
        }
        assert!(seen.iter().all(|&seen| seen));
    }
}
