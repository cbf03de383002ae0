//! Recovery of a damaged archive (appendix C).
//!
//! Sound leaves of a sound head list all their pages. A lost leaf leaves a gap in the pages section, where pages are
//! found by their leaders; so are pages that are not where their leaf puts them. Only leaves describe uniform and
//! shared pages, so those of a lost leaf are lost. Without a head, the caller must supply the plan, and the whole file
//! is searched for pages.
//!
//! Memory: 9 MiB of the file, 40 bytes for each page of a gap, one leaf and one writer.

use super::catalog::Catalog;
use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{Copier, beyond_this_version};
use super::directory::{Content, Extent, PageEntry, Storage};
use super::head::{self, Header, MAX_HEAD, Pages, SEEN};
use super::metadata::Metadata;
use super::page_coding::{EncodedPage, PageDecoder, PageEncoder, own_key};
use super::reader::Archive;
use super::salvage::{Found, find_pages};
use super::seen::SeenReader;
use super::writer::{ArchiveWriter, Totals};
use crate::bytes::{ByteSource, open_named};
use crate::frame::PageKey;
use crate::output::Existing;
use crate::page::{Inferred, Page};
use crate::plan::Plan;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

/// Result of a recovery.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Recovered {
    /// Header of the new archive.
    pub header: Header,
    /// True if the damaged archive's head was sound.
    pub head: bool,
    /// Directory leaves: number of sound ones and of all; `None` without a sound head.
    pub leaves: Option<(usize, usize)>,
    /// Pages found: with bytes of their own, shared, uniform.
    pub found: Pages,
    /// Pages that the head counts and that were not found; `None` without a sound head.
    pub lost: Option<Pages>,
    /// True if reference system and other metadata are lost or unknown.
    pub metadata_lost: bool,
    /// Sound contents that could not be kept, as text.
    pub dropped: Vec<String>,
    /// Corrections of broken rules in the new archive, as text.
    pub mended: Vec<String>,
    /// True if the new archive equals the undamaged one byte for byte.
    pub identical: bool,
}

impl Recovered {
    /// Returns whether the new archive is known to hold everything that the undamaged one held.
    pub fn is_complete(&self) -> bool {
        self.lost.is_some_and(|lost| lost.total() == 0) && !self.metadata_lost && self.dropped.is_empty()
    }
}

/// Writes all sound pages of the archive at `path` to a new archive `output`. `plan` is needed only if the head is
/// damaged; if the head is sound and has another plan, the call fails.
///
/// The new archive keeps every rule, whatever the damage. Its point counts are those of the conversion, or 0 if the
/// head that stated them is lost. Fails if no sound page is left. Cost: one pass over the file; all pages are decoded
/// and encoded again.
pub fn recover(
    path: &Path,
    plan: Option<&Plan>,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Recovered> {
    let source = open_named(path)?;
    let old = sound_head(&*source).map(|catalog| {
        let archive = Archive::from_parts(open_named(path)?.into(), catalog);
        Ok::<_, Error>(archive)
    });
    let old = old.transpose()?;
    let plan = match (old.as_ref().map(Archive::plan), plan) {
        (Some(told), Some(given)) if told.hash() != given.hash() => {
            let reason = format!("is not the plan of {}, whose head is sound; leave it out", path.display());
            return Err(Error::parameter(Parameter::Plan, reason));
        }
        (Some(plan), _) | (None, Some(plan)) => plan.clone(),
        (None, None) => {
            let reason = "it is damaged, so grid and options are unknown";
            return Err(Error::input(path, "head", reason).with_suggestion(Parameter::Plan));
        }
    };
    let limits = old.as_ref().map_or(Ok(()), |archive| archive.header().check_repeats());
    limits.map_err(|error| Error::input(path, "directory", error.to_string()))?;
    monitor.stage("recover", source.len(), "bytes");
    let levels = old.as_ref().is_some_and(|archive| archive.header().levels.is_some());
    let mut rescue = Rescue {
        source: &*source,
        monitor,
        writer: ArchiveWriter::begin(output, &plan, Existing::replaced_if(overwrite), [path].into_iter().collect())?,
        copier: Copier::new(),
        decoder: PageDecoder::new(),
        encoder: PageEncoder::of_plan(&plan).for_levels(levels),
        found: Pages::default(),
        columns: None,
        encoded_anew: 0,
        entries_wrong: 0,
        // Without their table, no colours can be found.
        colours: old.as_ref().and_then(|archive| ColourReader::new(archive).ok().flatten()),
        colours_found: 0,
    };
    if let Some(colours) = old.as_ref().and_then(|archive| archive.header().colours) {
        rescue.writer.set_colours(colours.plan);
    }
    if levels {
        rescue.writer.set_levels();
    }
    let leaves = match &old {
        Some(archive) => Some((rescue.by_directory(archive)?, archive.leaf_count())),
        None => {
            rescue.gap(0..source.len(), |_| true, true)?;
            None
        }
    };
    let stated = old.as_ref().map(|archive| archive.header().pages);
    if rescue.found.total() == 0 && stated.is_none_or(|stated| stated.total() > 0) {
        return Err(Error::input(path, "pages", "no sound page is left in it; convert the scan again"));
    }
    let mut recovered = rescue.finish(old.as_ref(), leaves)?;
    recovered.identical = recovered.is_complete() && same_head(&*source, output, &recovered.header)?;
    Ok(recovered)
}

/// Decodes header and leaves if the whole head is present and sound; the rest of the file may be missing.
fn sound_head(source: &dyn ByteSource) -> Option<Catalog> {
    let mut start = vec![0; MAX_HEAD];
    let there = source.len().min(MAX_HEAD as u64) as usize;
    source.read_at(0, &mut start[..there]).ok()?;
    let stated = u64::from_le_bytes(start[32..40].try_into().ok()?);
    let (header, leaves) = head::decode(&start, stated).ok()?;
    (header.bytes.head <= there as u64).then(|| Catalog::new(header, leaves))
}

/// Returns whether the archive at `output`, whose header is `header`, has the same head as `source`. Its checksums then
/// imply that the rest is the same, too.
fn same_head(source: &dyn ByteSource, output: &Path, header: &Header) -> Result<bool> {
    let mut heads = [vec![0; header.bytes.head as usize], vec![0; header.bytes.head as usize]];
    if source.len() < header.bytes.head {
        return Ok(false);
    }
    source.read_at(0, &mut heads[0])?;
    open_named(output)?.read_at(0, &mut heads[1])?;
    Ok(heads[0] == heads[1])
}

/// State of a recovery.
struct Rescue<'a> {
    source: &'a dyn ByteSource,
    monitor: &'a dyn Monitor,
    writer: ArchiveWriter,
    copier: Copier<Content>,
    decoder: PageDecoder,
    encoder: PageEncoder,
    found: Pages,
    /// First and last column with a page.
    columns: Option<(u64, u64)>,
    /// Pages that did not have the canonical encoding.
    encoded_anew: u64,
    /// Pages whose directory entry did not match their content.
    entries_wrong: u64,
    colours: Option<ColourReader>,
    /// Voxels whose colours were found.
    colours_found: u64,
}

impl Rescue<'_> {
    /// Recovers the pages that sound leaves list, and those found in the gaps of the others. Returns the number of
    /// sound leaves.
    fn by_directory(&mut self, archive: &Archive) -> Result<usize> {
        let header = archive.header();
        let place = |index| archive.open_leaf(index).ok().and_then(|entries| entries.check().ok());
        let places: Vec<Option<Range<u64>>> = (0..archive.leaf_count()).map(place).collect();
        // If neither leaves nor metadata are where the head puts them, nothing may be: bytes were lost or added.
        let in_place = places.iter().any(Option::is_some) || archive.metadata().is_ok();
        let mut from = header.pages_offset();
        let mut index = 0;
        while index < places.len() {
            let sound = (index..places.len()).find(|&index| places[index].is_some());
            if sound != Some(index) {
                let first = archive.leaf_first(index);
                let end = sound.map(|sound| archive.leaf_first(sound));
                let to = match sound.and_then(|sound| places[sound].as_ref()) {
                    Some(place) => place.start,
                    None if in_place => header.colours_offset(),
                    None => self.source.len(),
                };
                let inside = |key| first <= key && end.is_none_or(|end| key < end);
                self.gap(from..to, inside, !in_place)?;
            }
            let Some(sound) = sound else { break };
            let place = places[sound].clone().unwrap_or(from..from);
            let next = places[sound + 1..].iter().flatten().next().map_or(header.colours_offset(), |next| next.start);
            let displaced = self.displaced(archive, sound, place.start..next)?;
            for entry in archive.open_leaf(sound)? {
                let entry = entry?;
                match displaced.get(&entry.key) {
                    Some(found) => self.found(found)?,
                    None => self.listed(archive, &entry)?,
                }
            }
            from = place.end;
            index = sound + 1;
        }
        Ok(places.iter().flatten().count())
    }

    /// Finds, within `range`, the stored pages of a leaf that are not where it puts them but between neighbours that
    /// are.
    fn displaced(&self, archive: &Archive, leaf: usize, range: Range<u64>) -> Result<BTreeMap<PageKey, Found>> {
        let (mut displaced, mut missed, mut from) = (BTreeMap::new(), BTreeSet::new(), range.start);
        let mut find = |missed: &mut BTreeSet<PageKey>, range| -> Result<()> {
            if !missed.is_empty() {
                let found = find_pages(self.source, range, |key| missed.contains(&key), false, self.monitor)?;
                displaced.extend(found.into_iter().map(|found| (found.key, found)));
                missed.clear();
            }
            Ok(())
        };
        let mut bytes = Vec::new();
        for entry in archive.open_leaf(leaf)? {
            let entry = entry?;
            let Storage::Stored(extent) = entry.storage else { continue };
            bytes.resize(extent.len as usize, 0);
            let read = self.source.read_at(extent.offset, &mut bytes);
            if read.is_ok() && own_key(&bytes) == Some(entry.key) {
                find(&mut missed, from..extent.offset)?;
                from = extent.offset + u64::from(extent.len);
            } else {
                missed.insert(entry.key);
            }
        }
        find(&mut missed, from..range.end)?;
        Ok(displaced)
    }

    /// Recovers the pages found in the bytes `range`.
    fn gap(&mut self, range: Range<u64>, keys: impl Fn(PageKey) -> bool, to_the_leaf: bool) -> Result<()> {
        let found = find_pages(self.source, range, keys, to_the_leaf, self.monitor)?;
        found.iter().try_for_each(|found| self.found(found))
    }

    /// Recovers a page that was found by its leader.
    fn found(&mut self, found: &Found) -> Result<()> {
        let mut bytes = vec![0; found.len];
        self.source.read_at(found.offset, &mut bytes)?;
        let Some((key, page)) = self.decoder.salvage(&bytes) else { return Ok(()) };
        let inferred = self.decoder.inferred();
        let colours = self.colours.as_mut().and_then(|colours| colours.copied(key, &page).ok()).unwrap_or_default();
        let page = in_the_one_encoding(&mut self.encoder, &mut self.encoded_anew, key, &bytes, (&page, inferred));
        self.colours_found += colours.voxels;
        self.writer.put(key, page.with_colours(colours))?;
        self.found.stored += 1;
        self.count(key, found.len as u64)
    }

    /// Recovers the page of an entry, if it is sound. For a page with bytes of its own its leader counts, because the
    /// content in the entry may be wrong.
    fn listed(&mut self, archive: &Archive, entry: &PageEntry) -> Result<()> {
        let Self { writer, copier, decoder, encoder, encoded_anew, entries_wrong, colours, .. } = self;
        let read = |decoder: &mut PageDecoder| match entry.storage {
            Storage::Stored(extent) => own_page(archive, extent, decoder).filter(|(key, _)| *key == entry.key),
            _ => archive.page_with(entry, decoder).ok().map(|page| (entry.key, page)),
        };
        let own = colours.as_mut().and_then(|colours| colours.copied(entry.key, &read(decoder)?.1).ok());
        let own: EncodedColours = own.unwrap_or_default();
        let coloured = own.voxels;
        let placed = copier.put(writer, entry.key, entry.content(), own, || {
            let Some((key, page)) = read(decoder) else { return Ok(None) };
            *entries_wrong += u64::from((page.slices(), page.size()) != (entry.slices, entry.size));
            let content = (&page, decoder.inferred());
            Ok(Some(in_the_one_encoding(encoder, encoded_anew, key, &decoder.bytes, content)))
        })?;
        if placed.is_none() {
            return Ok(());
        }
        self.colours_found += coloured;
        let (count, len) = match entry.storage {
            Storage::Stored(extent) => (&mut self.found.stored, extent.len),
            Storage::Shared(_) => (&mut self.found.shared, 0),
            Storage::Uniform(_) => (&mut self.found.uniform, 0),
        };
        *count += 1;
        self.count(entry.key, len.into())
    }

    /// Recovers the sound blocks of seen space. Returns what is lost of it, as text.
    fn seen_space(&mut self, archive: &Archive) -> Result<Option<String>> {
        if archive.header().features_optional & SEEN == 0 {
            return Ok(None);
        }
        // Without the table, no blocks can be found.
        let Ok(Some(table)) = archive.seen_table() else { return Ok(Some("seen space (damaged)".into())) };
        self.writer.set_seen();
        let (mut reader, mut cells) = (SeenReader::new(archive), 0);
        for entry in table.entries() {
            if let Ok(block) = reader.block(entry) {
                cells += block.cells();
                self.writer.put_seen(&block)?;
            }
        }
        let lost = table.cells().saturating_sub(cells);
        Ok((lost > 0).then(|| format!("{lost} of {} cells of seen space (damaged)", table.cells())))
    }

    fn count(&mut self, key: PageKey, bytes: u64) -> Result<()> {
        let (first, _) = self.columns.unwrap_or((key.column(), 0));
        self.columns = Some((first, key.column()));
        self.monitor.advance(bytes);
        if self.monitor.cancelled() { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// Completes the new archive with what the rest of the `old` one still states.
    fn finish(mut self, old: Option<&Archive>, leaves: Option<(usize, usize)>) -> Result<Recovered> {
        let (mut dropped, mut mended) = (Vec::new(), Vec::new());
        let header = old.map(Archive::header);
        let lost = header.map(|Header { pages, .. }| Pages {
            stored: pages.stored.saturating_sub(self.found.stored),
            shared: pages.shared.saturating_sub(self.found.shared),
            uniform: pages.uniform.saturating_sub(self.found.uniform),
        });
        let all_found = lost.is_some_and(|lost| lost.total() == 0);
        let metadata = old.and_then(|archive| archive.metadata().ok());
        let metadata_lost = metadata.is_none();
        let Metadata { crs, shard, read, units, noise, unknown } = metadata.unwrap_or_default();
        if let Some(shard) = shard {
            let inside = |(first, last)| shard.columns().contains(&first) && shard.columns().contains(&last);
            if all_found && self.columns.is_none_or(inside) {
                self.writer.set_shard(shard);
                self.writer.set_read(read);
            } else {
                let why = if all_found { "it has pages of other parts" } else { "pages of it are lost" };
                dropped.push(format!("that it is {shard} ({why})"));
            }
        }
        self.writer.set_unknown(unknown);
        if let Some(stated) = header.and_then(|header| header.colours).map(|colours| colours.voxels)
            && stated > self.colours_found
        {
            dropped.push(format!("colours of {} of {stated} voxels (damaged)", stated - self.colours_found));
        }
        if let Some(archive) = old {
            dropped.extend(self.seen_space(archive)?);
        }
        dropped.extend(header.and_then(beyond_this_version));
        // Metadata are found by the head.
        let totals = header.map_or_else(Totals::default, |header| {
            let bounds = self.writer.fit(header.bounds);
            Totals { bounds, crs, units, noise, ..Totals::of_points(header) }
        });
        let new = self.writer.finish(totals)?;
        let mut say = |broken: bool, what: String| mended.extend(broken.then_some(what));
        let pages = |count| if count == 1 { "1 page".to_owned() } else { format!("{count} pages") };
        say(self.encoded_anew > 0, format!("encoding of {} (rule P10)", pages(self.encoded_anew)));
        say(self.entries_wrong > 0, format!("directory entries of {} (rules P9, P11)", pages(self.entries_wrong)));
        if let Some(header) = header.filter(|_| all_found) {
            let counts = |header: &Header| (header.pages.total(), header.tiles.occupied, header.voxels, header.slices);
            say(counts(header) != counts(&new), "counts in the head (rules T1 to T4)".into());
            say(header.bounds != new.bounds, "bounds in the head (rule T6)".into());
        }
        Ok(Recovered {
            header: new,
            head: old.is_some(),
            leaves,
            found: self.found,
            lost,
            metadata_lost,
            dropped,
            mended,
            identical: false,
        })
    }
}

/// Reads and decodes the page at `extent` by its leader, and leaves its bytes in `decoder`.
fn own_page(archive: &Archive, extent: Extent, decoder: &mut PageDecoder) -> Option<(PageKey, Page)> {
    let mut bytes = std::mem::take(&mut decoder.bytes);
    bytes.resize(extent.len as usize, 0);
    let read = archive.source().read_at(extent.offset, &mut bytes);
    let page = read.ok().and_then(|()| decoder.salvage(&bytes));
    decoder.bytes = bytes;
    page
}

/// Prepares the page with the old `bytes` for the new archive; if they are not the canonical encoding, encodes it again
/// and increments `anew`.
fn in_the_one_encoding(
    encoder: &mut PageEncoder,
    anew: &mut u64,
    key: PageKey,
    bytes: &[u8],
    (page, inferred): (&Page, &Inferred),
) -> EncodedPage {
    if bytes.is_empty() || encoder.gives(page, inferred, bytes) {
        return encoder.copied(key, bytes, page, inferred);
    }
    *anew += 1;
    encoder.encode_inferred(key, page, inferred)
}
