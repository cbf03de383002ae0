//! Positions of the points of records.

use crate::frame::{Frame, PageKey, TILE_PIXELS};
use crate::voxel::record::{ColumnKey, HALO_PIXELS, PATCH_PIXELS, Record, SLICE_STEPS, SUBPIXELS};

/// Positions of the points in one column's records.
#[derive(Debug, Clone, Copy)]
pub struct Places {
    /// First pixel of the column with its halo.
    corner: [f64; 2],
    first_slice: f64,
    frame: Frame,
}

impl Places {
    pub(super) fn new(column: ColumnKey, frame: Frame) -> Self {
        let PageKey { tx, ty, .. } = PageKey::from_column(column.column, 0);
        // All of these are exact.
        let corner = [tx, ty].map(|tile| (i64::from(tile) * TILE_PIXELS - HALO_PIXELS) as f64);
        Self { corner, first_slice: column.first_slice() as f64, frame }
    }

    /// Returns a bounding box of all points of the column (m).
    pub(super) fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let [x, y] = self.corner;
        let edge = |pixels: f64| pixels * self.frame.pixel_m();
        let [end_x, end_y] = [x, y].map(|pixels| edge(pixels + PATCH_PIXELS as f64));
        ([edge(x), edge(y), f64::NEG_INFINITY], [end_x, end_y, f64::INFINITY])
    }

    /// Returns the position of a record's point, to the precision of records (m).
    #[inline(always)]
    pub fn of(&self, record: Record) -> [f64; 3] {
        // Converts via `i32`, because vector instructions convert only signed 32-bit integers.
        let float = |whole: u32| f64::from(whole as i32);
        let along = |corner: f64, patch: u32, sub: u32| {
            (corner + float(patch) + (float(sub) + 0.5) / SUBPIXELS as f64) * self.frame.pixel_m()
        };
        let (u, v) = record.place();
        let slice = self.first_slice + float(record.slice());
        let height = float(record.height()) / SLICE_STEPS as f64;
        let (row, pixel) = (record.pixel() as u32 / PATCH_PIXELS as u32, record.pixel() as u32 % PATCH_PIXELS as u32);
        [along(self.corner[0], pixel, u), along(self.corner[1], row, v), (slice + height) * self.frame.slice_m()]
    }
}
