//! Records: one point as 8 bytes relative to its tile column, and the keys of tile columns.
//!
//! A record holds the point's voxel in its high bits and the position inside the voxel in its low bits, so that sorting
//! records as integers groups them by pixel, then by slice, then by height. A height beyond the slice marks a record of
//! another kind, such as the part of a voxel that surfaces fill: bottom, top, and whether one of them is steep. Records
//! of one tile column include a *halo*, copies of the points in the first pixel beyond each edge, so that code that
//! inspects 3 × 3 pixels needs no other tile column.

use crate::frame::{Frame, MAX_INDEX, SLICE_QUANTA, TILE_PIXELS, floor_small, morton};

/// Pixels beyond each edge of a tile column whose points are copied into it.
pub const HALO_PIXELS: i64 = 1;
/// Edge of a tile column with its halo (pixels).
pub const PATCH_PIXELS: usize = (TILE_PIXELS + 2 * HALO_PIXELS) as usize;
/// Pixels of a tile column with its halo.
pub const PATCH_AREA: usize = PATCH_PIXELS * PATCH_PIXELS;

/// Steps per pixel edge at which the position of a point inside its pixel is stored.
pub const SUBPIXELS: i64 = 1 << SUBPIXEL_BITS;
const SUBPIXEL_BITS: u32 = 7;
/// Steps per height quantum: 16 cells, each split into "on its lower end" and "above it" (see [`Record::height`]).
const STEPS_PER_QUANTUM: i64 = 32;
/// Steps per slice at which the height of a point is stored.
pub const SLICE_STEPS: i64 = SLICE_QUANTA * STEPS_PER_QUANTUM;
const HEIGHT_BITS: u32 = 13;
const SLICE_BITS: u32 = 24;

/// Slices in one block of a tile column; a higher column is cut into blocks.
pub const BLOCK_SLICES: i64 = 1 << SLICE_BITS;

const _: () = assert!(SLICE_STEPS <= 1 << HEIGHT_BITS && PATCH_AREA <= 1 << 13);
const _: () = assert!(13 + SLICE_BITS + HEIGHT_BITS + 2 * SUBPIXEL_BITS == 64);

/// Bits of a record below its slice.
const PLACE_BITS: u32 = HEIGHT_BITS + 2 * SUBPIXEL_BITS;
/// Bits of the value in a value record.
pub const VALUE_BITS: u32 = PLACE_BITS;
/// Least content of these bits in the record of a surface; what its weight lacks (2 bits), bottom (8), top (8) and
/// steepness (1) are added. The top comes before the bottom if the slope is undecided.
const SURFACE: u64 = (SLICE_STEPS as u64) << (2 * SUBPIXEL_BITS);
/// Content of these bits in a record that marks its voxel as dropped: no surface has its bottom on the slice's top.
const DROPPED: u64 = (1 << PLACE_BITS) - 1;
const _: () = assert!(SURFACE + (1 << 19) == 1 << PLACE_BITS);

/// Content of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// A point.
    Point,
    /// The part of the voxel that surfaces fill.
    Surface(SurfacePart),
    /// The voxel is to be dropped with all its contents.
    Dropped,
}

/// A tile column, or one block of [`BLOCK_SLICES`] slices of a very high one. Ordered like its pages in the archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ColumnKey {
    /// Position on the Morton curve (see [`crate::frame::PageKey::column`]).
    pub column: u64,
    /// Block of slices: slices `2²⁴·block − 2²³ .. 2²⁴·block + 2²³`.
    pub block: i16,
}

impl ColumnKey {
    /// Returns the lowest slice of the block.
    pub fn first_slice(self) -> i64 {
        i64::from(self.block) * BLOCK_SLICES - BLOCK_SLICES / 2
    }
}

/// A point relative to its tile column; the module documentation describes the layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(transparent)]
pub struct Record(pub u64);

impl Record {
    fn new(pixel: u64, slice: u64, place: u64) -> Self {
        Self((pixel << SLICE_BITS | slice) << PLACE_BITS | place)
    }

    /// Decodes the content of the record.
    #[inline]
    pub fn content(self) -> Content {
        match (self.0 & ((1 << PLACE_BITS) - 1)).checked_sub(SURFACE) {
            None => Content::Point,
            Some(part) if part == DROPPED - SURFACE => Content::Dropped,
            Some(part) => {
                let (first, second) = ((part >> 9) as u8, (part >> 1) as u8);
                Content::Surface(SurfacePart {
                    bottom: first.min(second),
                    top: first.max(second),
                    steep: part & 1 == 1,
                    undecided: first > second,
                    weight: WHOLE - (part >> 17) as u8,
                })
            }
        }
    }

    /// Pixel in the patch: `(y + 1)·66 + x + 1`, `x` and `y` from −1 to 64.
    #[inline]
    pub fn pixel(self) -> usize {
        (self.0 >> (64 - 13)) as usize
    }

    /// Slice above the first of the column's block.
    #[inline]
    pub fn slice(self) -> u32 {
        (self.0 >> (HEIGHT_BITS + 2 * SUBPIXEL_BITS)) as u32 & ((1 << SLICE_BITS) - 1)
    }

    /// Height of a point above the slice's floor [steps, 0..8160]. Even steps are exact multiples of 1/16 quantum, odd
    /// ones lie between two multiples; so both the floor and the ceiling in whole quanta can be derived.
    #[inline]
    pub fn height(self) -> u32 {
        (self.0 >> (2 * SUBPIXEL_BITS)) as u32 & ((1 << HEIGHT_BITS) - 1)
    }

    /// Value of a value record, which is stored in the bits of the position.
    #[inline]
    pub fn value(self) -> u32 {
        (self.0 & ((1 << VALUE_BITS) - 1)) as u32
    }

    /// Position of a point inside its pixel (1/128 pixel).
    #[inline]
    pub fn place(self) -> (u32, u32) {
        let mask = (1 << SUBPIXEL_BITS) - 1;
        ((self.0 >> SUBPIXEL_BITS) as u32 & mask, self.0 as u32 & mask)
    }
}

/// Records stored in several places, which can be visited repeatedly.
pub trait RecordPieces {
    /// Passes all records to `take`, piece by piece, in the same order each time.
    fn each(&self, take: impl FnMut(&[Record]));
}

impl RecordPieces for [Record] {
    fn each(&self, mut take: impl FnMut(&[Record])) {
        take(self);
    }
}

/// Part of a voxel that surfaces fill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurfacePart {
    /// Lowest quantum above the slice's floor (0..=254).
    pub bottom: u8,
    /// Highest quantum above the slice's floor (0..=255).
    pub top: u8,
    /// True if a surface steeper than the limit is among them.
    pub steep: bool,
    /// True if its slope is not known, so that the neighbourhood decides; then its top lies above its bottom.
    pub undecided: bool,
    /// Quarters of a voxel for which it counts in components (1..=[`WHOLE`]).
    pub weight: u8,
}

/// Weight of a voxel that counts in full.
pub const WHOLE: u8 = 4;

/// Part of one voxel that a surface fills, with the voxel's position on the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurfaceVoxel {
    /// Pixel.
    pub pixel: (i64, i64),
    /// Slice.
    pub slice: i64,
    /// Filled part.
    pub part: SurfacePart,
}

/// Cuts the heights `bottom..=top` (quanta) of a surface over a pixel at slice boundaries; each part has full weight. Like for spans, a top on a
/// boundary belongs to the slice below, unless the whole surface lies on that boundary.
pub fn surface_voxels(pixel: (i64, i64), (bottom, top): (i64, i64), steep: bool) -> impl Iterator<Item = SurfaceVoxel> {
    let first = bottom.div_euclid(SLICE_QUANTA);
    let last = first.max((top - 1).div_euclid(SLICE_QUANTA));
    (first..=last).map(move |slice| {
        let above = |quantum: i64| (quantum - slice * SLICE_QUANTA).clamp(0, SLICE_QUANTA) as u8;
        let part = SurfacePart { bottom: above(bottom), top: above(top), steep, undecided: false, weight: WHOLE };
        SurfaceVoxel { pixel, slice, part }
    })
}

/// Greatest quantum at or below a height in steps.
#[inline]
pub fn bottom_quantum(steps: u32) -> u32 {
    steps / STEPS_PER_QUANTUM as u32
}

/// Least quantum at or above a height in steps.
#[inline]
pub fn top_quantum(steps: u32) -> u32 {
    steps.div_ceil(STEPS_PER_QUANTUM as u32)
}

/// Converts points in metres to records.
#[derive(Debug, Clone, Copy)]
pub struct Recorder {
    subpixels_per_m: f64,
    cells_per_m: f64,
    frame: Frame,
}

/// A tile column by its indices; cheaper to compare than a [`ColumnKey`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ColumnIndex {
    /// Tile index along x.
    pub tx: i32,
    /// Tile index along y.
    pub ty: i32,
    /// Block of slices.
    pub block: i16,
}

impl ColumnIndex {
    /// Returns the key by which columns are ordered.
    pub fn key(self) -> ColumnKey {
        ColumnKey { column: morton(self.tx, self.ty), block: self.block }
    }
}

/// Consumer of records.
pub trait RecordSink {
    /// Takes one record of the column.
    fn add(&mut self, index: ColumnIndex, record: Record);

    /// Takes several records; `index` returns the column of each by its number.
    fn add_all(&mut self, records: &[Record], index: impl Fn(usize) -> ColumnIndex) {
        records.iter().enumerate().for_each(|(number, &record)| self.add(index(number), record));
    }
}

impl<F: FnMut(ColumnIndex, Record)> RecordSink for F {
    fn add(&mut self, index: ColumnIndex, record: Record) {
        self(index, record);
    }
}

/// More slices than any point on the grid lies below the origin.
const MOST_SLICES: i64 = 1 << 40;
const _: () = assert!(MAX_INDEX < MOST_SLICES && MOST_SLICES < i64::MAX / SLICE_STEPS / 2);

/// Most points in one batch.
pub const BATCH: usize = 1 << 10;

impl Recorder {
    /// Creates a recorder for the grid `frame`.
    pub fn new(frame: Frame) -> Self {
        // Multiplying by a power of two is exact, so these round exactly like the frame's functions.
        Self {
            subpixels_per_m: frame.pixels(1.0) * SUBPIXELS as f64,
            cells_per_m: frame.quanta(1.0) * (STEPS_PER_QUANTUM / 2) as f64,
            frame,
        }
    }

    /// Returns whether all points within these bounds have an index on the grid.
    pub fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        let indices = |p: [f64; 3]| [self.frame.pixel_of(p[0]), self.frame.pixel_of(p[1]), self.frame.slice_of(p[2])];
        indices(min).into_iter().chain(indices(max)).all(|index| index.abs() <= MAX_INDEX)
    }

    /// Passes each point's record to `sink`, and copies for the tile columns whose halo contains the point. Takes at
    /// most [`BATCH`] points, which must be within [`reaches`](Self::reaches).
    #[inline]
    pub fn record_into(&self, x: &[f64], y: &[f64], z: &[f64], mut sink: impl RecordSink) {
        let places = self.places(x, y, z);
        match Near::of(&places) {
            Some(near) => near.each(places.count, &mut sink),
            None => places.each(|_, fx, fy, steps| {
                let place = place_of(fx, fy, steps);
                let pixel = (fx >> SUBPIXEL_BITS, fy >> SUBPIXEL_BITS);
                spread(pixel, slice_of(steps), place, &mut |index, record| sink.add(index, record));
            }),
        }
    }

    /// Like [`record_into`](Self::record_into), but takes a closure.
    #[cfg(test)]
    pub fn record(&self, x: &[f64], y: &[f64], z: &[f64], sink: impl FnMut(ColumnIndex, Record)) {
        self.record_into(x, y, z, sink);
    }

    /// Passes one or two value records of each point to `sink`, without copies; `values` returns them by the point's
    /// number. With `with_points`, the point's record comes first. The points must satisfy the conditions of
    /// [`record_into`](Self::record_into).
    pub fn record_values(
        &self,
        [x, y, z]: [&[f64]; 3],
        with_points: bool,
        mut values: impl FnMut(usize) -> (u32, Option<u32>),
        mut sink: impl FnMut(ColumnIndex, Record),
    ) {
        self.places(x, y, z).each(|number, fx, fy, steps| {
            let (i, j) = (fx >> SUBPIXEL_BITS, fy >> SUBPIXEL_BITS);
            let slice = slice_of(steps);
            let block = (slice + BLOCK_SLICES / 2).div_euclid(BLOCK_SLICES);
            let slice = (slice + BLOCK_SLICES / 2 - block * BLOCK_SLICES) as u64;
            let pixel = ((j & 63) + HALO_PIXELS) * PATCH_PIXELS as i64 + (i & 63) + HALO_PIXELS;
            let index = ColumnIndex { tx: (i >> 6) as i32, ty: (j >> 6) as i32, block: block as i16 };
            if with_points {
                sink(index, Record::new(pixel as u64, slice, place_of(fx, fy, steps)));
            }
            let (first, second) = values(number);
            sink(index, Record::new(pixel as u64, slice, u64::from(first)));
            if let Some(second) = second {
                sink(index, Record::new(pixel as u64, slice, u64::from(second)));
            }
        });
    }

    /// Passes one or two value records of a surface's piece in a voxel to `sink`, without copies. With `with_points`,
    /// the record of the piece comes first. The voxel must be on the grid.
    pub fn record_surface_values(
        &self,
        voxel: &SurfaceVoxel,
        with_points: bool,
        (first, second): (u32, Option<u32>),
        mut sink: impl FnMut(ColumnIndex, Record),
    ) {
        let mut give = |place: u64| {
            let mut is_first = true;
            spread(voxel.pixel, voxel.slice, place, &mut |index, record| {
                // The original comes first, its copies after it.
                if std::mem::take(&mut is_first) {
                    sink(index, record);
                }
            });
        };
        if with_points {
            give(place_of_surface(voxel.part));
        }
        give(u64::from(first));
        if let Some(second) = second {
            give(u64::from(second));
        }
    }

    /// Returns the positions of at most [`BATCH`] points.
    #[inline]
    fn places(&self, x: &[f64], y: &[f64], z: &[f64]) -> Places {
        let count = x.len().min(y.len()).min(z.len()).min(BATCH);
        let [mut fx, mut fy, mut steps] = [[0; BATCH]; 3];
        let across = |to: &mut [i64; BATCH], from: &[f64]| {
            for (to, from) in to.iter_mut().zip(&from[..count]) {
                *to = floor_small(from * self.subpixels_per_m);
            }
        };
        across(&mut fx, x);
        across(&mut fy, y);
        for (steps, z) in steps.iter_mut().zip(&z[..count]) {
            let cells = z * self.cells_per_m;
            let cell = floor_small(cells);
            *steps = 2 * cell + (cell as f64 != cells) as i64;
        }
        Places { count, fx, fy, steps }
    }

    /// Passes the records of the parts of voxels that surfaces fill to `sink`, then their copies. Takes at most [`BATCH`]
    /// voxels, which must be on the grid.
    pub fn record_surfaces(&self, voxels: &[SurfaceVoxel], mut sink: impl RecordSink) {
        let nowhere = (ColumnIndex { tx: 0, ty: 0, block: 0 }, Record(0), (0, 0));
        let mut own = [nowhere; BATCH];
        let mut records = [Record(0); BATCH];
        for (number, voxel) in voxels.iter().take(BATCH).enumerate() {
            own[number] = own_record(voxel.pixel, voxel.slice, place_of_surface(voxel.part));
            records[number] = own[number].1;
        }
        let count = voxels.len().min(BATCH);
        sink.add_all(&records[..count], |number| own[number].0);
        for &(index, record, sides) in own[..count].iter().filter(|own| own.2 != (0, 0)) {
            copy(index, record, sides, &mut |index, record| sink.add(index, record));
        }
    }

    /// Passes the record of the part of a voxel that a surface fills to `sink`, and its copies. The voxel must be on
    /// the grid.
    #[cfg(test)]
    pub fn record_surface(&self, voxel: &SurfaceVoxel, mut sink: impl FnMut(ColumnIndex, Record)) {
        spread(voxel.pixel, voxel.slice, place_of_surface(voxel.part), &mut sink);
    }
}

/// Positions of a batch's points on the grid: one array per coordinate, so that the arithmetic compiles to vector
/// instructions.
struct Places {
    count: usize,
    /// Subpixels.
    fx: [i64; BATCH],
    fy: [i64; BATCH],
    /// Height in steps.
    steps: [i64; BATCH],
}

impl Places {
    /// Passes the number of each point, its position in subpixels, and its height in steps to `take`.
    #[inline]
    fn each(&self, mut take: impl FnMut(usize, i64, i64, i64)) {
        let Self { count, fx, fy, steps } = self;
        for (number, ((&fx, &fy), &steps)) in fx.iter().zip(fy).zip(steps).take(*count).enumerate() {
            take(number, fx, fy, steps);
        }
    }
}

/// Records of a batch whose points lie close together, as in nearly all batches: 32-bit offsets suffice, and vector
/// instructions compute twice as many of them at once.
struct Near {
    block: i16,
    /// Tile column, and whether the point lies in the halo of another.
    tx: [i32; BATCH],
    ty: [i32; BATCH],
    is_copied: [bool; BATCH],
    records: [Record; BATCH],
}

impl Near {
    /// Returns `None` if a point is too far from the first: 2³⁰ subpixels, 2¹⁷ slices, or in another block.
    #[inline]
    fn of(places: &Places) -> Option<Self> {
        const TILE_BITS: u32 = TILE_PIXELS.ilog2();
        const BELOW: i64 = 1 << 17;
        let Places { count, fx, fy, steps } = places;
        let first_slice = slice_of(steps[0]) - BELOW;
        let block = (first_slice + BELOW + BLOCK_SLICES / 2).div_euclid(BLOCK_SLICES);
        let lowest = i32::try_from(first_slice + BLOCK_SLICES / 2 - block * BLOCK_SLICES).ok()?;
        let mut near = Self {
            block: block as i16,
            tx: [0; BATCH],
            ty: [0; BATCH],
            is_copied: [false; BATCH],
            records: [Record(0); BATCH],
        };
        // Origin of the first point's tile, so that offsets are whole tiles.
        let origin = |first: i64| first >> (SUBPIXEL_BITS + TILE_BITS);
        let (tx, ty) = (origin(fx[0]), origin(fy[0]));
        let from = |tile: i64| tile << (SUBPIXEL_BITS + TILE_BITS);
        let (from_x, from_y, from_z) = (from(tx), from(ty), first_slice * SLICE_STEPS);
        // Nonzero if an offset needs more than 31 bits or a slice lies beyond the block.
        let mut far = 0;
        for number in 0..*count {
            let (x, y, z) = (fx[number] - from_x, fy[number] - from_y, steps[number] - from_z);
            far |= ((x + (1 << 30)) as u64 | (y + (1 << 30)) as u64 | z as u64) >> 31;
            let (x, y, z) = (x as i32, y as i32, z as u32);
            let above = z / SLICE_STEPS as u32;
            let height = z - above * SLICE_STEPS as u32;
            let slice = (lowest + above as i32) as u32;
            far |= u64::from(slice >> SLICE_BITS);
            let pixel = |subpixel: i32| (subpixel >> SUBPIXEL_BITS) & (TILE_PIXELS as i32 - 1);
            let (px, py) = (pixel(x), pixel(y));
            near.tx[number] = (tx as i32).wrapping_add(x >> (SUBPIXEL_BITS + TILE_BITS));
            near.ty[number] = (ty as i32).wrapping_add(y >> (SUBPIXEL_BITS + TILE_BITS));
            let is_at_edge = |p: i32| p < HALO_PIXELS as i32 || p >= (TILE_PIXELS - HALO_PIXELS) as i32;
            near.is_copied[number] = is_at_edge(px) | is_at_edge(py);
            let patch_pixel = (py + HALO_PIXELS as i32) * PATCH_PIXELS as i32 + px + HALO_PIXELS as i32;
            let within = |subpixel: i32| subpixel as u32 & (SUBPIXELS as u32 - 1);
            let place = (height << SUBPIXEL_BITS | within(x)) << SUBPIXEL_BITS | within(y);
            near.records[number] = Record::new(patch_pixel as u64, slice.into(), place.into());
        }
        (far == 0).then_some(near)
    }

    /// Passes the records of the first `count` points to `sink`, then their copies.
    #[inline]
    fn each(&self, count: usize, sink: &mut impl RecordSink) {
        let index = |number: usize| ColumnIndex { tx: self.tx[number], ty: self.ty[number], block: self.block };
        sink.add_all(&self.records[..count], index);
        for number in (0..count).filter(|&number| self.is_copied[number]) {
            let own = self.records[number];
            copy(index(number), own, beyond(own.pixel()), &mut |index, record| sink.add(index, record));
        }
    }
}

/// Returns on which sides, along x and y, a pixel of a tile lies in the halo of another tile.
#[inline]
fn beyond(patch_pixel: usize) -> (i64, i64) {
    let side = |p: usize| {
        let p = p as i64 - HALO_PIXELS;
        i64::from(p >= TILE_PIXELS - HALO_PIXELS) - i64::from(p < HALO_PIXELS)
    };
    (side(patch_pixel % PATCH_PIXELS), side(patch_pixel / PATCH_PIXELS))
}

/// Lower bits of the record of a surface's part of a voxel.
#[inline]
fn place_of_surface(SurfacePart { bottom, top, steep, undecided, weight }: SurfacePart) -> u64 {
    let lacks = u64::from(WHOLE - weight);
    let (first, second) = if undecided { (top, bottom) } else { (bottom, top) };
    SURFACE + (lacks << 17 | u64::from(first) << 9 | u64::from(second) << 1 | u64::from(steep))
}

/// Position of a point in its voxel.
#[inline]
fn place_of(fx: i64, fy: i64, steps: i64) -> u64 {
    let height = (steps - slice_of(steps) * SLICE_STEPS) as u64;
    let (u, v) = ((fx & (SUBPIXELS - 1)) as u64, (fy & (SUBPIXELS - 1)) as u64);
    (height << SUBPIXEL_BITS | u) << SUBPIXEL_BITS | v
}

/// Slice of a height in steps.
#[inline]
fn slice_of(steps: i64) -> i64 {
    // Shifted above zero by whole slices, because an unsigned division by a constant is a multiplication.
    ((steps + MOST_SLICES * SLICE_STEPS) as u64 / SLICE_STEPS as u64) as i64 - MOST_SLICES
}

/// Passes the record that marks a voxel on the grid as dropped to `sink`, and its copies.
pub fn record_dropped(pixel: (i64, i64), slice: i64, mut sink: impl FnMut(ColumnIndex, Record)) {
    spread(pixel, slice, DROPPED, &mut sink);
}

/// Passes a record with the low bits `place` for pixel `(i, j)` to `sink`, and its copies.
#[inline]
fn spread(pixel: (i64, i64), slice: i64, place: u64, sink: &mut impl FnMut(ColumnIndex, Record)) {
    let (index, record, sides) = own_record(pixel, slice, place);
    sink(index, record);
    if sides != (0, 0) {
        copy(index, record, sides, sink);
    }
}

/// Returns the record with the low bits `place` for pixel `(i, j)`, its column, and on which sides it lies in the halo of
/// others.
#[inline]
fn own_record((i, j): (i64, i64), slice: i64, place: u64) -> (ColumnIndex, Record, (i64, i64)) {
    let block = (slice + BLOCK_SLICES / 2).div_euclid(BLOCK_SLICES);
    let slice = (slice + BLOCK_SLICES / 2 - block * BLOCK_SLICES) as u64;
    let (tx, ty) = ((i >> 6) as i32, (j >> 6) as i32);
    let (px, py) = (i & 63, j & 63);
    let index = ColumnIndex { tx, ty, block: block as i16 };
    let pixel = (py + HALO_PIXELS) * PATCH_PIXELS as i64 + px + HALO_PIXELS;
    let side = |p: i64| i64::from(p >= TILE_PIXELS - HALO_PIXELS) - i64::from(p < HALO_PIXELS);
    (index, Record::new(pixel as u64, slice, place), (side(px), side(py)))
}

/// Passes the copies of a record to `sink`, one each to the tile columns `dx` tiles away along x, `dy` along y, and
/// both.
#[cold]
fn copy(of: ColumnIndex, record: Record, (dx, dy): (i64, i64), sink: &mut impl FnMut(ColumnIndex, Record)) {
    for (dx, dy) in [(dx, 0), (0, dy), (dx, dy)].into_iter().take(if dx != 0 && dy != 0 { 3 } else { 2 }) {
        if (dx, dy) != (0, 0) {
            let index = ColumnIndex { tx: of.tx + dx as i32, ty: of.ty + dy as i32, block: of.block };
            let pixels = (dy * PATCH_PIXELS as i64 + dx) * TILE_PIXELS;
            sink(index, Record(record.0.wrapping_sub((pixels as u64) << (64 - 13))));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn records_agree_with_the_frame(
            x in -1e7f64..1e7, y in -1e3f64..1e3, z in -1e7f64..1e7, t in 0.01f64..1.0
        ) {
            let frame = Frame::new(t, 3.0 * t).unwrap();
            let recorder = Recorder::new(frame);
            prop_assert!(recorder.reaches([x, y, z], [x, y, z]));
            let mut copies = 0;
            recorder.record(&[x], &[y], &[z], |index, record| {
                copies += 1;
                let pixel = record.pixel() as i64;
                let i = i64::from(index.tx) * 64 + pixel % PATCH_PIXELS as i64 - HALO_PIXELS;
                let j = i64::from(index.ty) * 64 + pixel / PATCH_PIXELS as i64 - HALO_PIXELS;
                assert_eq!((i, j), (frame.pixel_of(x), frame.pixel_of(y)));
                let slice = index.key().first_slice() + i64::from(record.slice());
                assert_eq!(slice, frame.slice_of(z));
                let floor = slice * SLICE_QUANTA;
                assert_eq!(floor + i64::from(bottom_quantum(record.height())), frame.quantum_floor(z));
                assert_eq!(floor + i64::from(top_quantum(record.height())), frame.quantum_ceil(z));
            });
            prop_assert!((1..=4).contains(&copies));
        }
    }

    proptest! {
        #[test]
        fn batches_of_near_and_of_far_points_are_recorded_as_their_points_are(
            origin in prop::array::uniform3(-1e6f64..1e6),
            mut points in prop::collection::vec(prop::array::uniform3(-30f64..30.0), 1..60),
            far in 0usize..9,
        ) {
            // One point is farther along one axis than a near batch allows, or none is.
            let (too_far, in_reach) = ([1e6, 1e6, 2.3e4], far >= 3);
            points.iter_mut().flatten().enumerate().for_each(|(at, v)| *v += origin[at % 3]);
            if !in_reach {
                let near = points[0];
                points[0][far] += too_far[far];
                points.push(near);
            }
            let recorder = Recorder::new(Frame::new(0.05, 0.15).unwrap());
            let [x, y, z] = [0, 1, 2].map(|axis| points.iter().map(|p| p[axis]).collect::<Vec<_>>());
            let places = recorder.places(&x, &y, &z);
            prop_assert_eq!(Near::of(&places).is_some(), in_reach);
            let (mut found, mut expected) = (Vec::new(), Vec::new());
            recorder.record(&x, &y, &z, |index, record| found.push((index.key(), record)));
            places.each(|_, fx, fy, steps| {
                let (pixel, place) = ((fx >> SUBPIXEL_BITS, fy >> SUBPIXEL_BITS), place_of(fx, fy, steps));
                spread(pixel, slice_of(steps), place, &mut |index, record| expected.push((index.key(), record)));
            });
            found.sort_unstable();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn surfaces_come_back_slice_by_slice(
            i in -100_000i64..100_000, j in -200i64..200, bottom in -3000i64..3000, extent in 0i64..2000, steep: bool,
            weight in 1u8..=WHOLE, undecided: bool
        ) {
            let recorder = Recorder::new(Frame::new(0.1, 0.3).unwrap());
            let top = bottom + extent;
            let mut joined: Option<(i64, i64)> = None;
            for mut voxel in surface_voxels((i, j), (bottom, top), steep) {
                voxel.part.weight = weight;
                voxel.part.undecided = undecided && extent > 0;
                recorder.record_surface(&voxel, |index, record| {
                    let pixel = record.pixel() as i64;
                    assert_eq!(i64::from(index.tx) * 64 + pixel % PATCH_PIXELS as i64 - HALO_PIXELS, i);
                    assert_eq!(i64::from(index.ty) * 64 + pixel / PATCH_PIXELS as i64 - HALO_PIXELS, j);
                    assert_eq!(record.content(), Content::Surface(voxel.part));
                    assert_eq!(index.key().first_slice() + i64::from(record.slice()), voxel.slice);
                });
                let floor = voxel.slice * SLICE_QUANTA;
                let (low, high) = (floor + i64::from(voxel.part.bottom), floor + i64::from(voxel.part.top));
                prop_assert!(voxel.part.bottom < 255 && low <= high);
                prop_assert!(joined.is_none_or(|(_, end)| end == low), "parts lie on each other");
                joined = Some((joined.map_or(low, |(begin, _)| begin), high));
            }
            prop_assert_eq!(joined, Some((bottom, top)));
        }

        #[test]
        fn points_are_no_surfaces(x in -1e3f64..1e3, z in -1e3f64..1e3) {
            let recorder = Recorder::new(Frame::new(0.1, 0.3).unwrap());
            recorder.record(&[x], &[x], &[z], |_, record| assert_eq!(record.content(), Content::Point));
        }
    }

    #[test]
    fn points_on_both_sides_of_a_block_s_border_keep_their_blocks() {
        let frame = Frame::new(1.0, 3.0).unwrap();
        let border = 3.0 * (BLOCK_SLICES / 2) as f64;
        let z = [border - 1.0, border + 1.0];
        for z in [z, [z[1], z[0]]] {
            let mut found = Vec::new();
            Recorder::new(frame).record(&[1.5; 2], &[1.5; 2], &z, |index, record| {
                found.push(index.key().first_slice() + i64::from(record.slice()));
            });
            assert_eq!(found, z.map(|z| frame.slice_of(z)));
        }
    }

    #[test]
    fn a_corner_point_goes_to_four_columns_and_an_inner_one_to_one() {
        let recorder = Recorder::new(Frame::new(1.0, 3.0).unwrap());
        let columns = |x, y| {
            let mut found = Vec::new();
            recorder.record(&[x], &[y], &[0.0], |index, _| found.push((index.tx, index.ty)));
            found
        };
        assert_eq!(columns(0.5, 0.5), [(0, 0), (-1, 0), (0, -1), (-1, -1)]);
        assert_eq!(columns(63.5, 32.0), [(0, 0), (1, 0)]);
        assert_eq!(columns(32.0, 32.0), [(0, 0)]);
    }
}
