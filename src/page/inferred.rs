//! Inferred spans of a page: floor that closes a hole of the scan and holds no point.

use super::span::Span;
use super::spans::{Page, PageBuilder};
use crate::frame::TILE_PIXELS;

const PIXELS: usize = (TILE_PIXELS * TILE_PIXELS) as usize;

/// Inferred spans of a page, by pixel; all of them are floor. Memory: 16 bytes per pixel that has one.
///
/// The page holds them among its scanned spans, so queries treat both alike; this type distinguishes them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inferred {
    /// Pixel `64·py + px`, ascending, and the mask of its inferred spans: bit `k` is the span above `k` others. No mask
    /// is 0.
    pixels: Vec<(u16, u64)>,
}

impl Inferred {
    /// Set without inferred spans.
    pub const NONE: Self = Self { pixels: Vec::new() };

    /// Creates a set without inferred spans.
    pub fn new() -> Self {
        Self::NONE
    }

    /// Returns the most memory for marks of a page of `spans` spans (bytes).
    pub(crate) fn most_bytes(spans: usize) -> usize {
        size_of::<(u16, u64)>() * spans.min(PIXELS)
    }

    /// Returns whether no span is inferred.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Removes all entries.
    pub fn clear(&mut self) {
        self.pixels.clear();
    }

    /// Adds the inferred spans `mask` of pixel (`px`, `py`) [0..64]: bit `k` is the span above `k` others. Pixels must
    /// come in row order; returns `false` and adds nothing if they do not, or if the pixel lies outside the page.
    #[must_use]
    pub fn push(&mut self, px: u32, py: u32, mask: u64) -> bool {
        let pixel = (py << 6 | px) as u16;
        let in_order = px < 64 && py < 64 && self.pixels.last().is_none_or(|&(last, _)| last < pixel);
        if in_order && mask != 0 {
            self.pixels.push((pixel, mask));
        }
        in_order
    }

    /// Returns the mask of inferred spans of pixel (`px`, `py`): bit `k` is the span above `k` others.
    pub fn of(&self, px: u32, py: u32) -> u64 {
        let found = self.pixels.binary_search_by_key(&((py << 6 | px) as u16), |&(pixel, _)| pixel);
        found.map_or(0, |at| self.pixels[at].1)
    }

    /// Iterates over the pixels with inferred spans in row order: `(px, py, mask)`.
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32, u64)> + '_ {
        self.pixels.iter().map(|&(pixel, mask)| (u32::from(pixel) & 63, u32::from(pixel) >> 6, mask))
    }

    /// Returns the number of inferred spans.
    pub fn span_count(&self) -> u64 {
        self.pixels.iter().map(|(_, mask)| u64::from(mask.count_ones())).sum()
    }

    /// Returns the number of voxels of `page` that only inferred spans occupy.
    pub fn voxel_count(&self, page: &Page) -> u64 {
        let voxels = |(px, py, mask): (u32, u32, u64)| {
            let slices = |inferred: bool| {
                let spans = page.column(px, py).iter().enumerate();
                let wanted = spans.filter(|(at, _)| (mask >> (at & 63) & 1 == 1) == inferred);
                wanted.fold(0, |slices, (_, span)| slices | span.slice_mask())
            };
            u64::from((slices(true) & !slices(false)).count_ones())
        };
        self.pixels().map(voxels).sum()
    }

    /// Returns a copy of `page` without its inferred spans, built in `builder`.
    pub fn without(&self, page: &Page, builder: &mut PageBuilder) -> Page {
        builder.clear();
        let mut scanned: Vec<Span> = Vec::new();
        for (px, py, spans) in page.columns() {
            let mask = self.of(px, py);
            scanned.clear();
            scanned.extend(spans.iter().enumerate().filter(|(at, _)| mask >> (at & 63) & 1 == 0).map(|(_, span)| span));
            if !scanned.is_empty() {
                let taken = builder.set_column(px, py, &scanned);
                debug_assert!(taken, "spans that are apart stay so");
            }
        }
        builder.build()
    }

    /// Returns the run lengths of the floor spans of `page`, alternately scanned and inferred, in row order and lowest
    /// first. The first run is scanned (it may be 0), the last one inferred. Empty if no span is inferred.
    pub(crate) fn runs(&self, page: &Page) -> Vec<u32> {
        let mut runs = vec![0u32];
        for (px, py, spans) in page.columns() {
            let mask = self.of(px, py);
            for (at, _) in spans.iter().enumerate().filter(|(_, span)| !span.is_obstacle()) {
                let inferred = mask >> (at & 63) & 1 == 1;
                // Runs of inferred spans have odd numbers.
                if inferred == (runs.len() % 2 == 1) {
                    runs.push(0);
                }
                if let Some(run) = runs.last_mut() {
                    *run += 1;
                }
            }
        }
        runs.truncate(runs.len() / 2 * 2);
        runs
    }

    /// Sets the inferred spans from [`runs`](Self::runs) of `page`; returns `false` if the runs exceed its floor spans.
    pub(crate) fn set_runs(&mut self, page: &Page, mut runs: impl Iterator<Item = u32>) -> bool {
        self.pixels.clear();
        self.pixels.reserve_exact(page.span_count().min(PIXELS));
        let (mut left, mut inferred) = (runs.next().unwrap_or(u32::MAX), false);
        for (px, py, spans) in page.columns() {
            let mut mask = 0;
            for (at, _) in spans.iter().enumerate().filter(|(_, span)| !span.is_obstacle()) {
                while left == 0 {
                    // After the last run, all spans are scanned.
                    (left, inferred) = (runs.next().unwrap_or(u32::MAX), !inferred);
                }
                left -= 1;
                mask |= u64::from(inferred) << (at & 63);
            }
            if mask != 0 {
                self.pixels.push(((py << 6 | px) as u16, mask));
            }
        }
        runs.next().is_none() && (left == 0 || !inferred)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pixel and its spans: thickness, obstacle, inferred.
    type Column = (u32, u32, Vec<(u32, bool, bool)>);

    fn page(columns: &[Column]) -> (Page, Inferred) {
        let (mut builder, mut inferred) = (PageBuilder::default(), Inferred::new());
        for (px, py, spans) in columns {
            let heights = spans.iter().zip(0u32..);
            let spans: Vec<Span> =
                heights.map(|(&(top, obstacle, _), k)| Span::new(600 * k, 600 * k + top, obstacle).unwrap()).collect();
            assert!(builder.set_column(*px, *py, &spans));
        }
        let page = builder.build();
        for (px, py, _) in page.columns() {
            let spans = &columns.iter().find(|column| (column.0, column.1) == (px, py)).unwrap().2;
            let mask = spans.iter().enumerate().filter(|(_, span)| span.2 && !span.1).map(|(k, _)| 1u64 << k).sum();
            assert!(inferred.push(px, py, mask));
        }
        (page, inferred)
    }

    proptest! {
        #[test]
        fn runs_tell_the_same_and_what_is_left_without_is_scanned(
            columns in proptest::collection::btree_map(
                (0u32..64, 0u32..64), proptest::collection::vec((0u32..500, any::<bool>(), any::<bool>()), 1..5), 1..60)
        ) {
            let columns: Vec<_> = columns.into_iter().map(|((px, py), spans)| (px, py, spans)).collect();
            let (page, inferred) = page(&columns);
            let runs = inferred.runs(&page);
            prop_assert_eq!(runs.is_empty(), inferred.is_empty());
            prop_assert!(runs.len().is_multiple_of(2) && runs.iter().skip(1).all(|&run| run > 0));
            let mut again = Inferred::new();
            prop_assert!(again.set_runs(&page, runs.into_iter()));
            prop_assert_eq!(&again, &inferred);
            let floors = page.columns().flat_map(|(_, _, spans)| spans).filter(|span| !span.is_obstacle()).count() as u32;
            let mut refuses = |runs: [u32; 2]| !again.set_runs(&page, runs.into_iter());
            prop_assert!(refuses([0, floors + 1]) && refuses([floors, 1]));
            let scanned = inferred.without(&page, &mut PageBuilder::default());
            let (all, obstacle) = page.voxel_counts();
            prop_assert_eq!(scanned.voxel_counts(), (all - inferred.voxel_count(&page), obstacle));
            prop_assert_eq!(scanned.span_count() as u64 + inferred.span_count(), page.span_count() as u64);
        }
    }

    #[test]
    fn pixels_come_in_order() {
        let mut inferred = Inferred::new();
        assert!(inferred.push(5, 1, 2) && inferred.push(6, 1, 0) && inferred.push(4, 2, 1));
        assert!(!inferred.push(4, 2, 1) && !inferred.push(0, 64, 1));
        assert_eq!(inferred.pixels().collect::<Vec<_>>(), [(5, 1, 2), (4, 2, 1)]);
        assert_eq!((inferred.of(5, 1), inferred.of(6, 1), inferred.span_count()), (2, 0, 2));
    }
}
