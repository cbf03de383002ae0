//! Extraction of a region into an archive of its own, which answers queries inside the region like the whole.

use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{Copier, beyond_this_version};
use super::head::{Bounds, Header};
use super::metadata::{Metadata, tag_name};
use super::page_coding::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::seen::SeenReader;
use super::writer::{ArchiveWriter, Totals};
use crate::codec::ColourEncoder;
use crate::frame::{Frame, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::output::{Existing, Protected};
use crate::page::{Inferred, Page, PageBuilder, Span};
use crate::seen::{CELL_PIXELS, SeenBlock, SeenPage};
use crate::{Error, Monitor, Parameter, Result};
use std::path::Path;

/// Result of an extraction.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Extracted {
    /// Header of the new archive.
    pub header: Header,
    /// Contents of the archive, besides solid, points and reference system, that the extract lacks, as text.
    pub dropped: Vec<String>,
}

/// Whole pixels and slices, first and last.
struct Region {
    i: (i64, i64),
    j: (i64, i64),
    slices: (i64, i64),
}

/// Returns the first and last index (0 to 63) of `range` in a page that begins at `start`, or `None` if they do not
/// meet.
fn within(range: (i64, i64), start: i64) -> Option<(u32, u32)> {
    let (first, last) = ((range.0 - start).max(0), (range.1 - start).min(TILE_PIXELS - 1));
    (first <= last).then_some((first as u32, last as u32))
}

impl Region {
    /// Returns the pixels and slices of `bounds` and one more on every side, because what touches a face of the region
    /// from inside may lie in the neighbour.
    fn around(frame: &Frame, (min, max): &Bounds) -> Self {
        let pixels = |axis: usize| (frame.pixel_of(min[axis]) - 1, frame.pixel_of(max[axis]) + 1);
        Self { i: pixels(0), j: pixels(1), slices: (frame.slice_of(min[2]) - 1, frame.slice_of(max[2]) + 1) }
    }

    /// Returns the part of page `key` that lies in the region, if any.
    fn part_of(&self, key: PageKey) -> Option<PagePart> {
        let parts = [(self.i, key.tx), (self.j, key.ty), (self.slices, key.layer)];
        let [px, py, slices] = parts.map(|(range, at)| within(range, i64::from(at) * TILE_PIXELS));
        Some(PagePart { px: px?, py: py?, slices: slices? })
    }
}

/// A box of pixels and slices of one page, first and last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct PagePart {
    px: (u32, u32),
    py: (u32, u32),
    slices: (u32, u32),
}

impl PagePart {
    const WHOLE: Self = Self { px: (0, 63), py: (0, 63), slices: (0, 63) };

    /// Returns the content of `page` in this box, built in `builder`, and marks which of its spans are inferred.
    fn cut(&self, page: &Page, inferred: &Inferred, builder: &mut PageBuilder) -> (Page, Inferred) {
        let Self { px, py, slices } = *self;
        let (low, high) = (slices.0 * SLICE_QUANTA as u32, (slices.1 + 1) * SLICE_QUANTA as u32);
        builder.clear();
        let (mut column, mut kept): (Vec<Span>, Inferred) = (Vec::new(), Inferred::new());
        let inside = |range: (u32, u32), at: u32| (range.0..=range.1).contains(&at);
        for (x, y, spans) in page.columns().filter(|&(x, y, _)| inside(px, x) && inside(py, y)) {
            column.clear();
            let (marks, mut mask) = (inferred.of(x, y), 0);
            for (at, span) in spans.iter().enumerate() {
                let (first, last) = span.slices();
                if first <= slices.1
                    && last >= slices.0
                    && let Some(part) = Span::new(span.bottom().max(low), span.top().min(high), span.is_obstacle())
                {
                    mask |= (marks >> (at & 63) & 1) << column.len();
                    column.push(part);
                }
            }
            if !column.is_empty() {
                let in_order = kept.push(x, y, mask);
                debug_assert!(in_order, "columns come in row order");
                let canonical = builder.set_column(x, y, &column);
                debug_assert!(canonical, "parts of spans that are apart are apart");
            }
        }
        (builder.build(), kept)
    }
}

const _: () = assert!(PAGE_SLICES == TILE_PIXELS, "pages are cut alike along all axes");

/// Writes the part of `archive` in `bounds` (m) as a new archive to `output`.
///
/// Keeps whole pixels and slices, and one more on every side, so any query that stays within `bounds` gets the same
/// answer as in the whole archive. Spans are cut at slices. Point counts stay those of the conversion; the bounds are
/// cut. Metadata of unknown tags is dropped because it may describe what was cut away.
///
/// Fails if `bounds` are inverted or NaN, if `output` exists and `overwrite` is false, or if `monitor` cancels. Cost:
/// reads the directory and the pages that meet the region.
pub fn extract(
    archive: &Archive,
    bounds: &Bounds,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Extracted> {
    let (min, max) = bounds;
    // Negated so that NaN fails.
    if !(0..3).all(|axis| min[axis] <= max[axis]) {
        return Err(Error::parameter(Parameter::Bounds, format!("no region lies between {min:?} and {max:?}")));
    }
    let archive = &archive.whole();
    let (frame, header) = (archive.frame(), archive.header());
    let region = Region::around(frame, bounds);
    monitor.stage("extract", header.pages.total(), "pages");
    let Metadata { crs, shard, units, noise, unknown, .. } = archive.metadata()?;
    let mut protected = Protected::default();
    protected.add_source(archive.source());
    let plan = archive.plan().clone();
    let mut writer = ArchiveWriter::begin(output, &plan, Existing::replaced_if(overwrite), protected)?;
    let levels = header.levels.is_some();
    if levels {
        writer.set_levels();
    }
    let mut colours = ColourReader::new(archive)?;
    if let Some(colours) = header.colours {
        writer.set_colours(colours.plan);
    }
    let (mut decoder, mut builder) = (PageDecoder::new(), PageBuilder::default());
    let mut colour_encoder = ColourEncoder::default();
    let mut encoder = PageEncoder::of_plan(&plan).for_levels(levels);
    let mut copier = Copier::new();
    for entry in archive.entries() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let entry = entry?;
        monitor.advance(1);
        let Some(part) = region.part_of(entry.key) else { continue };
        let own = match &mut colours {
            Some(colours) => {
                let page = archive.page_with(&entry, &mut decoder)?;
                if part == PagePart::WHOLE {
                    colours.copied(entry.key, &page)?
                } else {
                    let (cut, _) = part.cut(&page, decoder.inferred(), &mut builder);
                    colours.part(entry.key, &page, &cut, &mut colour_encoder)?
                }
            }
            None => EncodedColours::default(),
        };
        copier.put(&mut writer, entry.key, (entry.content(), part), own, || {
            let page = archive.page_with(&entry, &mut decoder)?;
            if part == PagePart::WHOLE {
                return Ok(Some(encoder.copied(entry.key, &decoder.bytes, &page, decoder.inferred())));
            }
            let (part, inferred) = part.cut(&page, decoder.inferred(), &mut builder);
            Ok((part.slices() != 0).then(|| encoder.encode_inferred(entry.key, &part, &inferred)))
        })?;
    }
    extract_seen(archive, &region, &mut writer)?;
    let bounds = writer.fit(header.bounds.and_then(|whole| region.bounds(frame, &whole)));
    let mut dropped: Vec<_> = unknown.iter().map(|(tag, _)| format!("metadata {}", tag_name(tag))).collect();
    dropped.extend(shard.map(|shard| format!("that it is {shard}")));
    dropped.extend(beyond_this_version(header));
    let header = writer.finish(Totals { bounds, crs, units, noise, ..Totals::of_points(header) })?;
    Ok(Extracted { header, dropped })
}

/// Copies the seen cells that meet the region.
fn extract_seen(archive: &Archive, region: &Region, writer: &mut ArchiveWriter) -> Result<()> {
    let Some(table) = archive.seen_table()? else { return Ok(()) };
    writer.set_seen();
    let mut reader = SeenReader::new(archive);
    for entry in table.entries().iter().filter(|entry| region.meets_block(entry.key)) {
        let block = reader.block(entry)?;
        let mut kept = SeenBlock::new(block.key);
        for (key, mut page) in block.each_page() {
            if let Some(part) = region.part_of(key) {
                let mut inside = SeenPage::NOTHING;
                let cells = |(first, last): (u32, u32)| [first, last].map(|at| at as usize / CELL_PIXELS as usize);
                inside.mark([cells(part.px), cells(part.py), [part.slices.0, part.slices.1].map(|at| at as usize)]);
                page.intersect(&inside);
                kept.push(SeenBlock::place_of(key).1, &page);
            }
        }
        if !kept.is_empty() {
            writer.put_seen(&kept)?;
        }
    }
    Ok(())
}

impl Region {
    /// Returns whether some page of a block of seen space lies in the region.
    fn meets_block(&self, key: PageKey) -> bool {
        let across = [(self.i, key.tx), (self.j, key.ty)];
        let first = i64::from(key.layer) * 64 * PAGE_SLICES;
        across.iter().all(|&(range, at)| within(range, i64::from(at) * TILE_PIXELS).is_some())
            && self.slices.0 < first + 64 * PAGE_SLICES
            && self.slices.1 >= first
    }

    /// Returns the part of `whole` in the region, if any.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_of_a_page_is_cut_at_slices_and_stays_inferred() {
        let span = |slice: u32| Span::new(slice * 255 + 10, slice * 255 + 300, false).unwrap();
        let (mut builder, mut inferred) = (PageBuilder::default(), Inferred::new());
        assert!(builder.set_column(5, 6, &[span(1), span(10), span(20)]) && inferred.push(5, 6, 0b101));
        let page = builder.build();
        for (px, py, slices, spans, marks) in [
            ((0, 63), (0, 63), (0, 63), vec![span(1), span(10), span(20)], 0b101u64),
            ((5, 5), (6, 6), (3, 63), vec![span(10), span(20)], 0b10),
            (
                (5, 6),
                (0, 6),
                (2, 10),
                vec![Span::new(510, 555, false).unwrap(), Span::new(2560, 2805, false).unwrap()],
                0b1,
            ),
            ((6, 63), (0, 63), (0, 63), vec![], 0),
            ((0, 63), (0, 5), (0, 63), vec![], 0),
        ] {
            let (part, kept) = PagePart { px, py, slices }.cut(&page, &inferred, &mut builder);
            assert_eq!((part.column(5, 6), part.span_count()), (&spans[..], spans.len()));
            assert_eq!((kept.of(5, 6), kept.span_count()), (marks, u64::from(marks.count_ones())));
        }
    }
}
