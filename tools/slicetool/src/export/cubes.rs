//! Cubes with the edge of a pixel, anchored like pixels at the origin, for formats of solid and empty cubes.

use crate::Failure;
use slicewalk::archive::{Archive, PageReader};
use slicewalk::frame::{Frame, PAGE_QUANTA, SLICE_QUANTA, TILE_PIXELS};
use std::path::Path;

/// Ratios of slice height to pixel size up to this are recognised as whole numbers.
const MOST_RATIO: f64 = 1e6;

/// Conversion of heights to cubes along z.
struct Heights<'a> {
    frame: &'a Frame,
    /// Pixels in a slice height, if that is a whole number: then cubes follow exactly.
    ratio: Option<i64>,
}

impl<'a> Heights<'a> {
    fn of(frame: &'a Frame) -> Self {
        let ratio = frame.slice_m() / frame.pixel_m();
        let is_whole = ratio <= MOST_RATIO && ratio.round() >= 1.0 && (ratio - ratio.round()).abs() <= 1e-12 * ratio;
        Self { frame, ratio: is_whole.then_some(ratio.round() as i64) }
    }

    /// Returns the first cube that a span from `bottom` to `top` (quanta) reaches, and the one after the last.
    fn of_span(&self, bottom: i64, top: i64) -> (i64, i64) {
        let (first, end) = match self.ratio {
            Some(ratio) => {
                let scaled = [bottom, top].map(|height| i128::from(height) * i128::from(ratio));
                let slice = i128::from(SLICE_QUANTA);
                (scaled[0].div_euclid(slice) as i64, -(-scaled[1]).div_euclid(slice) as i64)
            }
            None => {
                let size = self.frame.pixel_m();
                let first = (self.frame.bottom_height(bottom) / size).floor();
                (first as i64, (self.frame.top_height(top) / size).ceil() as i64)
            }
        };
        (first, end.max(first + 1))
    }
}

/// Calls `give` with each span of an archive at `path`, in the archive's order: tile column, pixel, the first cube that
/// the span reaches along z, and the one after the last. Memory: a page.
pub fn each_span(
    archive: &Archive,
    path: &Path,
    mut give: impl FnMut([i64; 2], [i64; 2], (i64, i64)),
) -> Result<(), Failure> {
    let heights = Heights::of(archive.frame());
    let mut pages = PageReader::new(archive);
    for entry in archive.entries() {
        let entry = entry.map_err(|error| crate::broken(path, &error))?;
        let tile = [i64::from(entry.key.tx), i64::from(entry.key.ty)];
        let base = i64::from(entry.key.layer) * PAGE_QUANTA;
        for (px, py, spans) in pages.page(&entry).map_err(|error| crate::broken(path, &error))?.columns() {
            let pixel = [tile[0] * TILE_PIXELS + i64::from(px), tile[1] * TILE_PIXELS + i64::from(py)];
            for span in spans {
                give(tile, pixel, heights.of_span(base + i64::from(span.bottom()), base + i64::from(span.top())));
            }
        }
    }
    Ok(())
}
