//! Solid of one voxel.

use crate::frame::SLICE_QUANTA;
use crate::voxel::record::{Content, Record, SLICE_STEPS, SurfacePart, WHOLE, bottom_quantum, top_quantum};

/// Parts of a slice in [`Voxel::bins`].
pub const BINS: i64 = 16;
const BIN_STEPS: u32 = (SLICE_STEPS / BINS) as u32;

/// Accumulated solid of one voxel: the properties common to points and surfaces. Sums over the points are stored
/// separately, because few voxels need them (see [`Sums`](super::Sums)).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Voxel {
    /// Slice above the first of the column's block.
    pub slice: u32,
    /// Sixteenths of the slice that contain solid; they show the voids between bottom and top.
    pub bins: u16,
    /// Greatest quantum at or below the lowest solid, above the slice's floor (0..=254).
    pub bottom: u8,
    /// Least quantum at or above the highest solid, above the slice's floor (0..=255).
    pub top: u8,
    /// Kinds of solid: [`POINTS`](Self::POINTS), [`FLAT`](Self::FLAT), [`STEEP`](Self::STEEP),
    /// [`UNDECIDED`](Self::UNDECIDED); and the greatest weight of its surfaces.
    pub kinds: u8,
}

impl Voxel {
    /// A surface at most as steep as the limit.
    pub const FLAT: u8 = 1;
    /// A surface steeper than the limit.
    pub const STEEP: u8 = 2;
    /// Points.
    pub const POINTS: u8 = 4;
    /// The voxel is to be dropped with all its contents.
    const DROPPED: u8 = 8;
    /// One of these bits for each quarter by which the greatest weight exceeds the first, from the lowest up: `or`
    /// gives the greatest of several.
    const QUARTERS: u32 = 4;
    /// A surface of unknown slope.
    pub const UNDECIDED: u8 = 128;
    /// Surfaces of any kind.
    pub const SURFACES: u8 = Self::FLAT | Self::STEEP | Self::UNDECIDED;

    /// Creates a voxel without solid.
    #[inline]
    pub(super) fn empty(slice: u32) -> Self {
        Self { slice, bins: 0, bottom: u8::MAX, top: 0, kinds: 0 }
    }

    /// Creates the voxel of one record.
    #[inline]
    pub(super) fn of(record: Record) -> Self {
        let mut voxel = Self::empty(record.slice());
        voxel.add(record);
        voxel
    }

    /// Creates the voxel of points with these least and greatest heights (steps).
    pub(super) fn of_points(slice: u32, [least, greatest]: [u32; 2], bins: u16) -> Self {
        let (bottom, top) = (bottom_quantum(least) as u8, top_quantum(greatest) as u8);
        Self { slice, bins, bottom, top, kinds: Self::POINTS }
    }

    #[inline]
    pub(super) fn add(&mut self, record: Record) {
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
        // A surface that ends on the lower border of a bin does not reach into it.
        let (first, last) = (bin(part.bottom), bin(part.top.saturating_sub(1).max(part.bottom)));
        self.bins |= (u16::MAX >> (BINS - 1 - (last - first))) << first;
        self.kinds |= match part {
            SurfacePart { steep: true, .. } => Self::STEEP,
            SurfacePart { undecided: true, .. } => Self::UNDECIDED,
            _ => Self::FLAT,
        };
        self.kinds |= ((1 << (part.weight - 1)) - 1) << Self::QUARTERS;
    }

    /// Returns the lowest and highest solid (quanta above the floor of slice `floor`).
    #[inline]
    pub fn quanta_above(&self, floor: i64) -> (i64, i64) {
        let below = (i64::from(self.slice) - floor) * SLICE_QUANTA;
        (below + i64::from(self.bottom), below + i64::from(self.top))
    }

    /// Returns whether a surface steeper than the limit is among its contents.
    pub fn is_steep(&self) -> bool {
        self.kinds & Self::STEEP != 0
    }

    /// Returns whether its surfaces are known to be at most as steep as the limit.
    pub fn is_flat(&self) -> bool {
        self.kinds & (Self::FLAT | Self::STEEP) == Self::FLAT
    }

    /// Returns whether it holds nothing but surfaces of unknown slope.
    pub fn is_undecided(&self) -> bool {
        self.kinds & (Self::SURFACES | Self::POINTS) == Self::UNDECIDED
    }

    /// Returns whether it holds points, as opposed to surfaces alone.
    pub fn has_points(&self) -> bool {
        self.kinds & Self::POINTS != 0
    }

    /// Returns how many quarters of a voxel it counts for in components.
    #[inline]
    pub fn weight(&self) -> u32 {
        if self.has_points() { u32::from(WHOLE) } else { 1 + (self.kinds >> Self::QUARTERS & 7).count_ones() }
    }

    /// Returns whether a voxel of `points` points is kept at this minimum.
    #[inline]
    pub(super) fn is_kept(&self, points: i64, min_points: u32) -> bool {
        let has_surface = self.kinds & Self::SURFACES != 0;
        self.kinds & Self::DROPPED == 0 && (has_surface || points >= i64::from(min_points))
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.bottom = self.bottom.min(other.bottom);
        self.top = self.top.max(other.top);
        self.bins |= other.bins;
        self.kinds |= other.kinds;
    }
}
