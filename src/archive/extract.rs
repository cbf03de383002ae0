//! Extraction of a region into an archive of its own, which answers queries inside the region like the whole.

use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{Copier, beyond_this_version};
use super::head::{Bounds, Header};
use super::metadata::{Metadata, tag_name};
use super::page_coding::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::region::{PagePart, Region};
use super::seen::SeenReader;
use super::writer::{ArchiveWriter, Totals};
use crate::codec::ColourEncoder;
use crate::output::{Existing, Protected};
use crate::page::PageBuilder;
use crate::seen::SeenBlock;
use crate::{Error, Monitor, Result};
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
    let archive = &archive.whole();
    let (frame, header) = (archive.frame(), archive.header());
    // One more on every side, because what touches a face of the region from inside may lie in the neighbour.
    let region = Region::of(frame, bounds)?.grown();
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
                page.intersect(&part.cells(false));
                kept.push(SeenBlock::place_of(key).1, &page);
            }
        }
        if !kept.is_empty() {
            writer.put_seen(&kept)?;
        }
    }
    Ok(())
}
