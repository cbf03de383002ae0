//! Colours of the voxels of a page.

use super::spans::Page;

const PIXELS: usize = 64 * 64;

/// Occupied voxels of a page, numbered pixel by pixel in row order and from the lowest slice up within a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occupancy {
    /// Occupied slices of each pixel.
    masks: Box<[u64]>,
    /// Number of each pixel's first voxel.
    first: Box<[u32]>,
    count: usize,
}

impl Default for Occupancy {
    fn default() -> Self {
        Self { masks: vec![0; PIXELS].into(), first: vec![0; PIXELS].into(), count: 0 }
    }
}

impl Occupancy {
    /// Returns the occupied voxels of `page`. Memory: 48 KiB.
    pub fn of(page: &Page) -> Self {
        let mut occupancy = Self::default();
        occupancy.set(page);
        occupancy
    }

    /// Replaces the contents by the occupied voxels of `page`, without allocating.
    pub fn set(&mut self, page: &Page) {
        self.masks.fill(0);
        for (px, py, spans) in page.columns() {
            self.masks[(py << 6 | px) as usize] = spans.iter().fold(0, |mask, span| mask | span.slice_mask());
        }
        self.count = 0;
        for (first, mask) in self.first.iter_mut().zip(&self.masks) {
            *first = self.count as u32;
            // Most masks have at most one bit, and some processors have no instruction that counts bits.
            let is_few = mask & mask.wrapping_sub(1) == 0;
            self.count += if is_few { usize::from(*mask != 0) } else { mask.count_ones() as usize };
        }
    }

    /// Returns the number of voxels.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are no voxels.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the occupied slices of pixel `64·py + px` as a mask, and the number of its first voxel.
    #[inline]
    pub fn pixel(&self, pixel: usize) -> (u64, usize) {
        (self.masks[pixel & (PIXELS - 1)], self.first[pixel & (PIXELS - 1)] as usize)
    }

    /// Returns the number of the voxel in slice `k` (0..=63) of pixel `64·py + px`, or `None` if it is not occupied.
    #[inline]
    pub fn find(&self, pixel: usize, k: u32) -> Option<usize> {
        let (mask, first) = self.pixel(pixel);
        let below = mask & ((1u64 << (k & 63)) - 1);
        (mask >> (k & 63) & 1 == 1).then(|| first + below.count_ones() as usize)
    }

    /// Iterates over all voxels in order: pixel `64·py + px` and slice of the page.
    pub fn voxels(&self) -> impl Iterator<Item = (usize, u32)> + '_ {
        let slices = |mask: u64| std::iter::successors(Some(mask), |mask| Some(mask & mask.wrapping_sub(1)));
        self.masks.iter().enumerate().filter(|(_, mask)| **mask != 0).flat_map(move |(pixel, &mask)| {
            slices(mask).take_while(|mask| *mask != 0).map(move |mask| (pixel, mask.trailing_zeros()))
        })
    }
}

/// Colours (sRGB, 8 bits a channel) of the occupied voxels of a page. A voxel has no colour if none of its points had
/// one: for instance an inferred voxel, or one that a span reaches only within the height tolerance.
///
/// Memory: 48 KiB and 4 bytes a voxel.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Colours {
    occupancy: Occupancy,
    /// Red, green, blue, and 255 if the voxel has a colour; in order of voxels.
    values: Vec<[u8; 4]>,
}

impl Colours {
    /// Pairs the voxels of `occupancy` with `values`, in order; `None` if the counts differ.
    pub(crate) fn new(occupancy: Occupancy, values: Vec<[u8; 4]>) -> Option<Self> {
        (values.len() == occupancy.len()).then_some(Self { occupancy, values })
    }

    /// Returns the occupied voxels of the page.
    pub fn occupancy(&self) -> &Occupancy {
        &self.occupancy
    }

    /// Returns the colour of the voxel in slice `k` (0..=63) of pixel (`px`, `py`) [0..64]; `None` if the voxel is not
    /// occupied or has no colour.
    pub fn of(&self, px: u32, py: u32, k: u32) -> Option<[u8; 3]> {
        let number = self.occupancy.find(((py & 63) << 6 | px & 63) as usize, k)?;
        let [r, g, b, a] = *self.values.get(number)?;
        (a != 0).then_some([r, g, b])
    }

    /// Iterates over all occupied voxels in row order, lowest first: pixel x and y, slice of the page, colour.
    pub fn voxels(&self) -> impl Iterator<Item = (u32, u32, u32, Option<[u8; 3]>)> + '_ {
        let places = self.occupancy.voxels().zip(&self.values);
        places
            .map(|((pixel, k), &[r, g, b, a])| (pixel as u32 & 63, pixel as u32 >> 6, k, (a != 0).then_some([r, g, b])))
    }

    /// Returns the colours in order of voxels: red, green, blue, 255 for voxels with a colour, (0, 0, 0, 0) for others.
    pub fn values(&self) -> &[[u8; 4]] {
        &self.values
    }

    /// Returns the number of voxels that have a colour.
    pub fn count(&self) -> u64 {
        self.values.iter().filter(|value| value[3] != 0).count() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::super::{PageBuilder, Span};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn voxels_are_those_that_spans_touch(
            columns in proptest::collection::btree_map((0u32..64, 0u32..64), (0u32..16000, 0u32..900), 1..50)
        ) {
            let mut builder = PageBuilder::default();
            for (&(px, py), &(bottom, height)) in &columns {
                let span = Span::new(bottom, (bottom + height).min(16320), false).unwrap();
                prop_assert!(builder.set_column(px, py, &[span]));
            }
            let page = builder.build();
            let occupancy = Occupancy::of(&page);
            prop_assert_eq!(occupancy.len() as u64, page.voxel_counts().0);
            for (number, (pixel, k)) in occupancy.voxels().enumerate() {
                prop_assert_eq!(occupancy.find(pixel, k), Some(number));
                let spans = page.column(pixel as u32 & 63, pixel as u32 >> 6);
                prop_assert!(spans.iter().any(|span| span.within_slice(k).is_some()));
            }
            prop_assert_eq!(occupancy.voxels().count(), occupancy.len());
            prop_assert!(!occupancy.is_empty() && Occupancy::default().is_empty());
            let values = vec![[1, 2, 3, 255]; occupancy.len()];
            prop_assert!(Colours::new(occupancy.clone(), values[1..].to_vec()).is_none());
            let colours = Colours::new(occupancy, values).unwrap();
            prop_assert_eq!(colours.count(), page.voxel_counts().0);
            prop_assert!(colours.voxels().all(|(px, py, k, colour)| colours.of(px, py, k) == colour));
            let values = colours.voxels().map(|(.., colour)| colour.map_or([0; 4], |[r, g, b]| [r, g, b, 255]));
            prop_assert!(values.eq(colours.values().iter().copied()));
        }
    }
}
