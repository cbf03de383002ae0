//! Writing of an archive: pages in key order, directory, head, then rename (chapter 12).

mod unnamed;

use super::FORMAT_VERSION;
use super::colour_section::{ColourWriter, EncodedColours};
use super::dedup::Window;
use super::directory::{Extent, PageEntry, Storage, key_in_grid};
use super::head::{self, Bounds, Header, MAX_HEAD, MAX_LEAF_ENTRIES, MAX_LEAVES, MIN_LEAF_ENTRIES, Sections};
use super::levels::{CoarseSpan, LevelWriter};
use super::metadata::{Metadata, Unknown};
use super::page_coding::EncodedPage;
use super::seen::SeenWriter;
use super::shard::{InputRead, Shard};
use super::solid_bounds::Matter;
use super::spill::{Entries, write_leaves};
use crate::bytes::crc;
use crate::codec::Violation;
use crate::colour::ColourPlan;
use crate::frame::PageKey;
use crate::output::{Existing, Output, OutputKind, Protected};
use crate::page::{PageBounds, PageSize};
use crate::plan::{Noise, Plan};
use crate::seen::SeenBlock;
use crate::unit::LengthUnit;
use crate::{Error, Result};
use std::path::Path;

/// Bytes buffered before they are written. An archive whose pages all fit gets a head of exact length, so this constant
/// affects the bytes and must not depend on a memory budget.
const BUFFER: usize = 1 << 20;

/// Counts and metadata of the conversion, besides the pages.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Totals {
    /// Points read from the input.
    pub points_read: u64,
    /// Points accumulated into voxels.
    pub points_kept: u64,
    /// Points that the input marks as withheld.
    pub points_withheld: u64,
    /// Points of excluded classes.
    pub points_excluded: u64,
    /// Smallest and largest coordinates of the kept points (m); `None` uses the bounds of the solid. Writing fails if
    /// they do not fit the solid (rule T6).
    pub bounds: Option<Bounds>,
    /// Coordinate reference system as the input states it, at most 1 MiB; empty if unknown.
    pub crs: String,
    /// Units of the inputs, ascending and without duplicates, at most 256; empty if unknown.
    pub units: Vec<LengthUnit>,
    /// Noise of the scan, if the tolerance was chosen from it.
    pub noise: Option<Noise>,
}

impl Totals {
    /// Copies the point counts of another archive.
    pub(super) fn of_points(header: &Header) -> Self {
        let &Header { points_read, points_kept, points_withheld, points_excluded, .. } = header;
        Self { points_read, points_kept, points_withheld, points_excluded, ..Self::default() }
    }
}

/// Writes an archive, which appears under its name when it is complete, or not at all.
///
/// Memory: about 9 MiB however many pages there are (1 MiB of pages, 1.5 MiB of entries, 4 MiB to find equal pages, one
/// directory leaf). Disk: the archive, and 40 bytes per page while it is written. Dropping the writer removes its
/// files.
#[derive(Debug)]
pub struct ArchiveWriter {
    output: Output,
    plan: Plan,
    /// Bytes not yet written to the file.
    buffer: Vec<u8>,
    /// Bytes after the head that are in the file.
    flushed: u64,
    /// Where the bytes after the head begin; [`MAX_HEAD`] until the exact length of the head is known.
    base: u64,
    /// True once no page may follow.
    pages_ended: bool,
    entries: Entries,
    window: Window,
    last: Option<PageKey>,
    counts: Header,
    matter: Matter,
    levels: Option<LevelWriter>,
    colours: Option<ColourWriter>,
    seen: Option<SeenWriter>,
    shard: Option<Shard>,
    read: Vec<InputRead>,
    unknown: Unknown,
}

/// A page already added: its entry, and what is needed to refer to its bytes again.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    storage: Storage,
    pub slices: u64,
    size: PageSize,
    pub bounds: PageBounds,
    pub voxels: (u64, u64),
    pub inferred: u64,
    hash: u64,
}

impl ArchiveWriter {
    /// Starts an archive of `plan` at `target`, and replaces an older archive there if `overwrite` is true (see
    /// [`output`](crate::output)).
    pub fn create(target: &Path, plan: &Plan, overwrite: bool) -> Result<Self> {
        Self::begin(target, plan, Existing::replaced_if(overwrite), Protected::default())
    }

    /// Like [`create`](Self::create), but replaces nothing that is protected.
    pub(super) fn begin(target: &Path, plan: &Plan, existing: Existing, protected: Protected) -> Result<Self> {
        plan.options.check()?;
        Self::on(Output::create(target, OutputKind::Archive(existing), protected)?, plan)
    }

    /// Starts an archive of `plan` in `output`.
    #[doc(hidden)]
    pub fn on(output: Output, plan: &Plan) -> Result<Self> {
        plan.options.check()?;
        let counts = Header {
            version: FORMAT_VERSION,
            features_required: if plan.options.fill_holes > 0 { head::INFERRED } else { 0 },
            features_optional: 0,
            file_len: 0,
            plan: plan.clone(),
            plan_hash: plan.hash(),
            points_read: 0,
            points_kept: 0,
            points_withheld: 0,
            points_excluded: 0,
            bounds: None,
            slices: None,
            tiles: Default::default(),
            voxels: Default::default(),
            pages: Default::default(),
            bytes: Default::default(),
            metadata_crc: 0,
            leaf_entries: MIN_LEAF_ENTRIES,
            levels: None,
            colours: None,
            level: 0,
        };
        Ok(Self {
            entries: Entries::new(output.files(), output.beside()),
            output,
            plan: plan.clone(),
            buffer: Vec::new(),
            flushed: 0,
            base: MAX_HEAD as u64,
            pages_ended: false,
            window: Window::default(),
            last: None,
            counts,
            matter: Matter::default(),
            levels: None,
            colours: None,
            seen: None,
            shard: None,
            read: Vec::new(),
            unknown: Unknown::new(),
        })
    }

    /// Adds overview levels to the archive. Must precede the first page.
    pub fn set_levels(&mut self) {
        debug_assert!(self.last.is_none(), "levels are of all pages");
        self.levels = Some(LevelWriter::new(&self.plan, self.output.files(), self.output.beside()));
        self.counts.features_optional |= head::LEVELS;
        self.colour_levels();
    }

    /// Adds colours of `plan` to the archive. Must precede the first page.
    pub fn set_colours(&mut self, plan: ColourPlan) {
        debug_assert!(self.last.is_none(), "every page says which colours it has");
        self.colours = Some(ColourWriter::new(plan, self.output.files(), self.output.beside()));
        self.counts.features_optional |= head::COLOURS;
        self.colour_levels();
    }

    /// Adds colours to the levels if the archive has both.
    fn colour_levels(&mut self) {
        if let (Some(levels), Some(colours)) = (&mut self.levels, &self.colours) {
            levels.set_colours(colours.plan);
        }
    }

    /// Returns how the colours of the archive are made, if it has any.
    pub fn colours(&self) -> Option<ColourPlan> {
        self.colours.as_ref().map(|colours| colours.plan)
    }

    /// Returns whether the archive has overview levels.
    pub fn has_levels(&self) -> bool {
        self.levels.is_some()
    }

    /// Adds seen space to the archive; its blocks follow the last page ([`put_seen`](Self::put_seen)).
    pub fn set_seen(&mut self) {
        self.seen = Some(SeenWriter::new());
        self.counts.features_optional |= head::SEEN;
    }

    /// Adds a block of seen space, of which something must have been seen. Keys must ascend, and no page may follow.
    pub fn put_seen(&mut self, block: &SeenBlock) -> Result<()> {
        let Some(mut seen) = self.seen.take() else {
            return Err(Error::parameter(format!("block {}", block.key), "the archive is written without seen space"));
        };
        self.end_pages();
        let added = seen.add(block, &mut |bytes| self.append(bytes));
        self.seen = Some(seen);
        added
    }

    /// Completes the seen space and returns its cells and the bytes of its section.
    pub fn end_seen(&mut self) -> Result<(u64, u64)> {
        let Some(seen) = self.seen.take() else {
            return Err(Error::parameter("seen space", "the archive is written without it"));
        };
        self.end_pages();
        seen.finish(&mut |bytes| self.append(bytes))
    }

    /// Fixes the length of the head, which depends on the pages alone.
    fn end_pages(&mut self) {
        if !self.pages_ended {
            self.pages_ended = true;
            if self.flushed == 0 {
                self.base = head::exact_len(self.leaf_count()) as u64;
            }
        }
    }

    fn leaf_count(&self) -> usize {
        self.entries.len().div_ceil(head::leaf_entries(self.entries.len()) as u64) as usize
    }

    /// Marks the archive as a part of a conversion; its pages must lie in the columns of `shard`.
    pub fn set_shard(&mut self, shard: Shard) {
        self.shard = Some(shard);
    }

    /// Sets the inputs that this part read and other parts read, too, ordered by number.
    pub fn set_read(&mut self, read: Vec<InputRead>) {
        self.read = read;
    }

    /// Adds metadata of tags that this version does not know.
    pub(super) fn set_unknown(&mut self, unknown: Unknown) {
        self.unknown = unknown;
    }

    /// Moves the faces of `bounds` that do not fit the solid of the pages added, and returns the result.
    pub(super) fn fit(&self, bounds: Option<Bounds>) -> Option<Bounds> {
        self.matter.fit(&self.plan, self.shard.is_some(), bounds)
    }

    /// Moves the faces of `bounds` that lie beyond the solid of the pages added to the solid, and returns the result.
    pub(super) fn shrink(&self, bounds: Option<Bounds>) -> Option<Bounds> {
        self.matter.shrink(&self.plan, bounds)
    }

    /// Adds a page. Keys must ascend. The page must not be empty and must be encoded under this key; if the archive has
    /// overview levels, it must be prepared [for levels](super::PageEncoder::for_levels).
    pub fn put(&mut self, key: PageKey, page: EncodedPage) -> Result<()> {
        self.put_placed(key, &page).map(drop)
    }

    /// Like [`put`](Self::put), and returns what is needed to add the same content again.
    pub(super) fn put_placed(&mut self, key: PageKey, page: &EncodedPage) -> Result<Placed> {
        self.check_key(key)?;
        if page.key != key {
            return Err(Error::parameter(format!("page {key}"), format!("it is encoded as {}", page.key)));
        }
        let Some(bounds) = &page.bounds else {
            return Err(Error::parameter(format!("page {key}"), "has no solid; leave it out"));
        };
        if page.inferred > 0 && self.plan.options.fill_holes == 0 {
            return Err(Error::parameter(format!("page {key}"), "has inferred solid, but the plan fills no holes"));
        }
        if self.levels.is_some() && page.coarse.is_none() {
            return Err(Error::parameter(format!("page {key}"), "is encoded for an archive without overview levels"));
        }
        let placed = Placed {
            storage: match page.uniform {
                Some(span) => Storage::Uniform(span),
                None => self.store(page)?,
            },
            slices: page.slices,
            size: page.size,
            bounds: *bounds,
            voxels: page.voxels,
            inferred: page.inferred,
            hash: page.hash,
        };
        self.push(key, &placed, page.coarse.as_deref().unwrap_or_default(), &page.colours)?;
        Ok(placed)
    }

    /// Adds the content of `like`, which was added before, under `key`. Returns `false` if it must be added with its
    /// bytes, because the window no longer holds them.
    pub(super) fn put_again(
        &mut self,
        key: PageKey,
        like: &Placed,
        coarse: &[CoarseSpan],
        colours: &EncodedColours,
    ) -> Result<bool> {
        let storage = match like.storage {
            Storage::Uniform(span) => Storage::Uniform(span),
            Storage::Stored(extent) | Storage::Shared(extent) => {
                if self.window.candidate(like.hash, extent.len) != Some(extent) {
                    return Ok(false);
                }
                Storage::Shared(extent)
            }
        };
        self.check_key(key)?;
        self.push(key, &Placed { storage, ..*like }, coarse, colours)?;
        Ok(true)
    }

    fn check_key(&self, key: PageKey) -> Result<()> {
        if self.pages_ended {
            return Err(Error::parameter(format!("page {key}"), "put after seen space; pages come first"));
        }
        if self.last.is_some_and(|last| last >= key) || !key_in_grid(key) {
            let last = self.last.map_or("nothing".into(), |last| last.to_string());
            let reason = format!("put after {last}; keys ascend, within ±2^30");
            return Err(Error::parameter(format!("page {key}"), reason));
        }
        if self.entries.len() == MAX_LEAVES as u64 * MAX_LEAF_ENTRIES as u64 {
            let what = "pages in one archive (use larger pixels, or several archives)";
            return Err(Error::limit(what, "more", self.entries.len()));
        }
        Ok(())
    }

    /// Adds an entry whose bytes are placed, and counts it.
    fn push(&mut self, key: PageKey, placed: &Placed, coarse: &[CoarseSpan], colours: &EncodedColours) -> Result<()> {
        if self.levels.is_some() && !colours.bytes.is_empty() && colours.coarse.is_none() {
            return Err(Error::parameter(
                format!("page {key}"),
                "its colours are encoded for an archive without overview levels",
            ));
        }
        let &Placed { storage, slices, size, bounds, voxels, inferred, .. } = placed;
        let entry = PageEntry { key, slices, size, storage };
        self.entries.push(entry)?;
        self.last = Some(key);
        self.matter.add(key, &bounds);
        let tiles = u64::from(slices.count_ones());
        let Header { pages, tiles: count, voxels: sum, .. } = &mut self.counts;
        match storage {
            Storage::Stored(_) => {
                pages.stored += 1;
                count.stored += tiles;
                count.unique += tiles;
            }
            Storage::Shared(_) => {
                pages.shared += 1;
                count.stored += tiles;
            }
            Storage::Uniform(_) => pages.uniform += 1,
        }
        count.occupied += tiles;
        sum.occupied += voxels.0;
        sum.obstacle += voxels.1;
        sum.inferred += inferred;
        let (low, high) = entry.slice_range();
        let (first, last) = self.counts.slices.unwrap_or((low, high));
        self.counts.slices = Some((first.min(low), last.max(high)));
        if let Some(levels) = &mut self.levels {
            let of_colours = if self.colours.is_some() { colours.coarse.as_deref() } else { None };
            levels.add(key, coarse, of_colours.unwrap_or_default())?;
        }
        self.colours.as_mut().map_or(Ok(()), |writer| writer.add(key, colours))
    }

    /// Finds equal bytes or appends those of `page`.
    fn store(&mut self, page: &EncodedPage) -> Result<Storage> {
        let len = page.bytes.len() as u32;
        if let Some(extent) = self.window.candidate(page.hash, len) {
            let mut same = vec![0; len as usize];
            self.bytes_of(extent, &mut same)?;
            if same[super::page_coding::LEADER..] == *page.body() {
                return Ok(Storage::Shared(extent));
            }
        }
        let extent = Extent { offset: self.flushed + self.buffer.len() as u64, len, crc: page.crc() };
        self.append(&page.bytes)?;
        self.window.insert(page.hash, extent);
        Ok(Storage::Stored(extent))
    }

    fn bytes_of(&self, extent: Extent, buf: &mut [u8]) -> Result<()> {
        match extent.offset.checked_sub(self.flushed) {
            Some(start) => {
                buf.copy_from_slice(&self.buffer[start as usize..start as usize + buf.len()]);
                Ok(())
            }
            None => self.output.read_at(self.base + extent.offset, buf),
        }
    }

    /// Appends to the bytes after the head. The bytes of one call are either all in the buffer or all in the file.
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        if self.buffer.len() + bytes.len() > BUFFER {
            self.flush()?;
        }
        self.buffer.extend_from_slice(bytes);
        Ok(())
    }

    fn flush(&mut self) -> Result<()> {
        self.output.write_at(self.base + self.flushed, &self.buffer)?;
        self.flushed += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Writes directory, metadata, footer and head, and publishes the archive under its name. On any error but
    /// [`Error::NotDurable`] nothing appears there, and an older file stays.
    pub fn finish(self, totals: Totals) -> Result<Header> {
        Ok(self.finish_or_keep(totals)?.0)
    }

    /// Like [`finish`](Self::finish), and also returns whether the archive was written (see [`Existing::KeepSame`]).
    pub(super) fn finish_or_keep(mut self, totals: Totals) -> Result<(Header, bool)> {
        let header = self.complete(totals)?;
        Ok((header, self.output.publish()?))
    }

    fn complete(&mut self, totals: Totals) -> Result<Header> {
        let mut header = self.counts.clone();
        let leaf_entries = head::leaf_entries(self.entries.len());
        self.end_pages();
        if self.seen.is_some() {
            self.end_seen()?;
        }
        let pages = self.flushed + self.buffer.len() as u64;
        let (mut colours_len, mut levels_len) = (0, 0);
        let mut levels = self.levels.take();
        if let Some(levels) = &mut levels {
            levels.end()?;
        }
        if let Some(colours) = self.colours.take() {
            let mut give = |bytes: &[u8]| self.append(bytes);
            let of_levels = levels.as_mut().map_or(Ok(0), |levels| levels.finish_colours(&mut give))?;
            let (colours, len) = colours.finish(leaf_entries, of_levels, &mut give)?;
            (header.colours, colours_len) = (Some(colours), of_levels + len);
        }
        if let Some(levels) = levels {
            let (levels, len) = levels.finish(&mut |bytes| self.append(bytes))?;
            (header.levels, levels_len) = (Some(levels), len);
        }
        let entries = std::mem::replace(&mut self.entries, Entries::new(self.output.files(), self.output.beside()));
        let leaves = write_leaves(&entries, leaf_entries, &mut |bytes| self.append(bytes))?;
        let (read, unknown) = (std::mem::take(&mut self.read), std::mem::take(&mut self.unknown));
        let Totals { crs, units, noise, .. } = totals;
        let metadata = Metadata { crs, shard: self.shard, read, units, noise, unknown }.encode()?;
        self.append(&metadata)?;

        let directory = leaves.iter().map(|leaf| leaf.stored_len as u64).sum();
        header.bytes = Sections {
            head: self.base,
            pages,
            colours: colours_len,
            levels: levels_len,
            directory,
            metadata: metadata.len() as u64,
        };
        header.file_len = header.metadata_offset() + header.bytes.metadata + head::FOOTER as u64;
        header.points_read = totals.points_read;
        header.points_kept = totals.points_kept;
        header.points_withheld = totals.points_withheld;
        header.points_excluded = totals.points_excluded;
        header.bounds = self.bounds(totals.bounds)?;
        header.metadata_crc = crc::crc32c(&metadata);
        header.leaf_entries = leaf_entries;
        let head = head::encode(&header, &leaves);
        // Inconsistent totals would make an archive that cannot be opened.
        head::decode(&[&head[..], &[0; head::FOOTER]].concat(), header.file_len)?;

        self.append(&head::encode_footer(header.file_len, &head))?;
        self.flush()?;
        self.output.write_at(0, &head)?;
        Ok(header)
    }

    /// Returns the bounds of the solid, or the `given` ones if they fit it.
    fn bounds(&self, given: Option<Bounds>) -> Result<Option<Bounds>> {
        if given.is_none() {
            return Ok(self.matter.bounds(&self.plan.frame));
        }
        let checked = self.matter.check(&self.plan, self.shard.is_some(), given.as_ref());
        checked.map_err(|Violation { expected, found, .. }| {
            Error::parameter("bounds of the archive", format!("expected {expected}, found {found}"))
        })?;
        Ok(given)
    }
}
