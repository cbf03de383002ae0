//! Rectangular parts of a tile column.

use crate::voxel::record::PATCH_PIXELS;

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

    /// Returns whether a patch pixel lies in the area or in the one-pixel halo around it.
    #[inline]
    pub fn holds_with_halo(&self, patch_pixel: usize) -> bool {
        let (x, y) = ((patch_pixel % PATCH_PIXELS) as u32, (patch_pixel / PATCH_PIXELS) as u32);
        // Patch coordinates are one more than the tile's, so `first` is the halo pixel before the area.
        (self.x.0..=self.x.1 + 1).contains(&x) && (self.y.0..=self.y.1 + 1).contains(&y)
    }

    /// Returns whether a patch pixel lies in the area itself.
    pub fn holds(&self, patch_pixel: usize) -> bool {
        let (x, y) = ((patch_pixel % PATCH_PIXELS) as u32, (patch_pixel / PATCH_PIXELS) as u32);
        (self.x.0 + 1..=self.x.1).contains(&x) && (self.y.0 + 1..=self.y.1).contains(&y)
    }

    /// Splits the area in two halves along the longer edge; `None` for a single pixel.
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
