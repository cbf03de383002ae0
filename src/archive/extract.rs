//! Extraction of a region into an archive of its own, which answers queries inside the region like the whole.
//!
//! If the archive carries edits, the extract holds the edited space: the tile columns that they touch are read and edited
//! first, and their pages take the place of the archive's.

use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{Copier, beyond_this_version};
use super::directory::PageEntry;
use super::edited::edited_pages;
use super::head::{Bounds, Header};
use super::metadata::{Metadata, tag_name};
use super::page_coding::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::region::{PagePart, Region};
use super::seen::SeenReader;
use super::writer::{ArchiveWriter, Totals};
use crate::codec::ColourEncoder;
use crate::frame::PageKey;
use crate::output::{Existing, Protected};
use crate::page::{Inferred, Page, PageBuilder};
use crate::seen::SeenBlock;
use crate::{Error, Monitor, Result};
use std::collections::BTreeMap;
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
/// If the archive [carries edits](Archive::with_edits), the new one holds the edited space, and its bounds grow around
/// solid that was added. Added solid has no colour; seen space stays as it is.
///
/// Fails if `bounds` are inverted or NaN, if `output` exists and `overwrite` is false, if the edits touch more than 2¹⁶
/// pages, or if `monitor` cancels. Cost: reads the directory and the pages that meet the region; holds those of the tile
/// columns with edits.
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
    let edited = edited_pages(archive, monitor)?.unwrap_or_default();
    let mut colours = ColourReader::new(archive)?;
    if let Some(colours) = header.colours {
        writer.set_colours(colours.plan);
    }
    let (mut decoder, mut builder) = (PageDecoder::new(), PageBuilder::default());
    let mut colour_encoder = ColourEncoder::default();
    let mut encoder = PageEncoder::of_plan(&plan).for_levels(levels);
    let mut copier = Copier::new();
    for page in pages(archive, edited) {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let (key, entry, edited) = page?;
        monitor.advance(u64::from(entry.is_some()));
        let Some(part) = region.part_of(key) else { continue };
        let original = match (&entry, &edited) {
            (Some(entry), Some(_)) => Some(archive.page_with(entry, &mut decoder)?),
            _ => None,
        };
        if let Some(edited) = edited.filter(|edited| original.as_ref() != Some(edited)) {
            let inferred = unchanged(original.as_ref(), decoder.inferred(), &edited);
            let (page, inferred) = part.cut(&edited, &inferred, &mut builder);
            if page.slices() != 0 {
                let own = match (&mut colours, &original) {
                    (Some(colours), Some(original)) => colours.part(key, original, &page, &mut colour_encoder)?,
                    _ => EncodedColours::default(),
                };
                writer.put(key, encoder.encode_inferred(key, &page, &inferred).with_colours(own))?;
            }
            continue;
        }
        let Some(entry) = entry else { continue };
        let own = match &mut colours {
            Some(colours) => {
                let page = archive.page_with(&entry, &mut decoder)?;
                if part == PagePart::WHOLE {
                    colours.copied(key, &page)?
                } else {
                    let (cut, _) = part.cut(&page, decoder.inferred(), &mut builder);
                    colours.part(key, &page, &cut, &mut colour_encoder)?
                }
            }
            None => EncodedColours::default(),
        };
        copier.put(&mut writer, key, (entry.content(), part), own, || {
            let page = archive.page_with(&entry, &mut decoder)?;
            if part == PagePart::WHOLE {
                return Ok(Some(encoder.copied(key, &decoder.bytes, &page, decoder.inferred())));
            }
            let (part, inferred) = part.cut(&page, decoder.inferred(), &mut builder);
            Ok((part.slices() != 0).then(|| encoder.encode_inferred(key, &part, &inferred)))
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

/// Iterates over the keys of the archive and of `edited`, in order, with the archive's entry and the edited page.
fn pages(
    archive: &Archive,
    edited: BTreeMap<PageKey, Page>,
) -> impl Iterator<Item = Result<(PageKey, Option<PageEntry>, Option<Page>)>> + '_ {
    let (mut entries, mut edited) = (archive.entries().peekable(), edited.into_iter().peekable());
    std::iter::from_fn(move || {
        let own = match entries.peek() {
            Some(Ok(entry)) => Some(entry.key),
            Some(Err(_)) => return entries.next().and_then(Result::err).map(Err),
            None => None,
        };
        let key = [own, edited.peek().map(|(key, _)| *key)].into_iter().flatten().min()?;
        let entry = entries.next_if(|_| own == Some(key)).and_then(Result::ok);
        Some(Ok((key, entry, edited.next_if(|page| page.0 == key).map(|page| page.1))))
    })
}

/// Returns which spans of `edited` are inferred: those of pixels that are as in the original, whose marks are
/// `inferred`.
fn unchanged(original: Option<&Page>, inferred: &Inferred, edited: &Page) -> Inferred {
    let mut kept = Inferred::new();
    let Some(original) = original else { return kept };
    for (px, py, mask) in inferred.pixels().filter(|&(px, py, _)| original.column(px, py) == edited.column(px, py)) {
        let in_order = kept.push(px, py, mask);
        debug_assert!(in_order, "pixels come in row order");
    }
    kept
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
