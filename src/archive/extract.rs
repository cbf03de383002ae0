//! Cutting a region out of an archive: an archive of its own whose answers inside the region are those of the whole.

use super::head::{Bounds, Header};
use super::page::{EncodedPage, PageDecoder, PageEncoder};
use super::reader::Archive;
use super::writer::{ArchiveWriter, Totals};
use crate::frame::{Frame, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::output::{Existing, Protected};
use crate::slice::{Page, PageBuilder, Span};
use crate::{Error, Monitor, Result};
use std::path::Path;

/// Whole pixels and slices, first and last.
struct Region {
    i: (i64, i64),
    j: (i64, i64),
    slices: (i64, i64),
}

/// First and last of `range` in a page that begins at `start`, of 64; `None` if they do not meet.
fn within(range: (i64, i64), start: i64) -> Option<(u32, u32)> {
    let (first, last) = ((range.0 - start).max(0), (range.1 - start).min(TILE_PIXELS - 1));
    (first <= last).then_some((first as u32, last as u32))
}

impl Region {
    /// The pixels and slices around `bounds`, and one more on every side: what touches the region's faces, seen from
    /// inside, may lie in the neighbour.
    fn around(frame: &Frame, (min, max): &Bounds) -> Self {
        let pixels = |axis: usize| (frame.pixel_of(min[axis]) - 1, frame.pixel_of(max[axis]) + 1);
        Self { i: pixels(0), j: pixels(1), slices: (frame.slice_of(min[2]) - 1, frame.slice_of(max[2]) + 1) }
    }

    /// The part of `page` in the region, built in `builder`; `None` if it is all of the page.
    fn cut(&self, key: PageKey, page: &Page, builder: &mut PageBuilder) -> Option<Page> {
        let parts = [(self.i, key.tx), (self.j, key.ty), (self.slices, key.layer)];
        let [Some(px), Some(py), Some(slices)] = parts.map(|(range, at)| within(range, i64::from(at) * TILE_PIXELS))
        else {
            return Some(PageBuilder::default().build());
        };
        if [px, py, slices] == [(0, 63); 3] {
            return None;
        }
        let (low, high) = (slices.0 * SLICE_QUANTA as u32, (slices.1 + 1) * SLICE_QUANTA as u32);
        builder.clear();
        let mut column: Vec<Span> = Vec::new();
        let inside = |range: (u32, u32), at: u32| (range.0..=range.1).contains(&at);
        for (x, y, spans) in page.columns().filter(|&(x, y, _)| inside(px, x) && inside(py, y)) {
            column.clear();
            let met = spans.iter().filter(|span| {
                let (first, last) = span.slices();
                first <= slices.1 && last >= slices.0
            });
            column.extend(
                met.filter_map(|span| Span::new(span.bottom().max(low), span.top().min(high), span.is_obstacle())),
            );
            if !column.is_empty() {
                let canonical = builder.set_column(x, y, &column);
                debug_assert!(canonical, "parts of spans that are apart are apart");
            }
        }
        Some(builder.build())
    }
}

const _: () = assert!(PAGE_SLICES == TILE_PIXELS, "pages are cut alike along all axes");

/// Writes the part of `archive` in `bounds` as an archive of its own to `output`.
///
/// Whole pixels and slices are kept, and one more on every side, so that any query that stays within `bounds` is
/// answered as by the whole; spans are cut at slices. Point counts stay those of the conversion; the bounds are cut.
/// Cost: the directory, and the pages that meet the region.
pub fn extract(
    archive: &Archive,
    bounds: &Bounds,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Header> {
    let (min, max) = bounds;
    // Written so that NaN fails.
    if !(0..3).all(|axis| min[axis] <= max[axis]) {
        return Err(Error::parameter("--bounds", format!("no region lies between {min:?} and {max:?}")));
    }
    let (frame, header) = (archive.frame(), archive.header());
    let region = Region::around(frame, bounds);
    monitor.stage("extract", header.pages.total(), "pages");
    let mut protected = Protected::default();
    protected.add_source(archive.source());
    let mut writer = ArchiveWriter::begin(output, archive.plan(), Existing::replaced_if(overwrite), protected)?;
    let (mut decoder, mut encoder, mut builder) =
        (PageDecoder::new(), PageEncoder::new(*frame), PageBuilder::default());
    for entry in archive.entries() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let (entry, key) = entry.map(|entry| (entry, entry.key))?;
        monitor.advance(1);
        let meets = |range, at: i32| within(range, i64::from(at) * TILE_PIXELS).is_some();
        if !(meets(region.i, key.tx) && meets(region.j, key.ty) && meets(region.slices, key.layer)) {
            continue;
        }
        let page = archive.page_with(&entry, &mut decoder)?;
        match region.cut(key, &page, &mut builder) {
            None => writer.put(key, EncodedPage::copied(key, &decoder.bytes, &page))?,
            Some(part) if part.slices() == 0 => {}
            Some(part) => writer.put(key, encoder.encode(key, &part))?,
        }
    }
    let metadata = archive.metadata()?;
    writer.finish(Totals {
        points_read: header.points_read,
        points_kept: header.points_kept,
        points_withheld: header.points_withheld,
        points_excluded: header.points_excluded,
        bounds: header.bounds.and_then(|whole| region.bounds(frame, &whole)),
        crs: metadata.crs,
        units: metadata.units,
    })
}

impl Region {
    /// The part of `whole` in the region, `None` if there is none.
    fn bounds(&self, frame: &Frame, whole: &Bounds) -> Option<Bounds> {
        let least =
            [frame.edge_of_pixel(self.i.0), frame.edge_of_pixel(self.j.0), frame.bottom_of_slice(self.slices.0)];
        let greatest = [
            frame.edge_of_pixel(self.i.1 + 1),
            frame.edge_of_pixel(self.j.1 + 1),
            frame.bottom_of_slice(self.slices.1 + 1),
        ];
        let min: [f64; 3] = std::array::from_fn(|axis| whole.0[axis].max(least[axis]));
        let max: [f64; 3] = std::array::from_fn(|axis| whole.1[axis].min(greatest[axis]));
        (0..3).all(|axis| min[axis] <= max[axis]).then_some((min, max))
    }
}
