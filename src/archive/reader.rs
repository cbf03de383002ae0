//! Reading of an archive: head and footer at once, directory leaves and pages on demand (chapter 11).

use super::catalog::Catalog;
use super::directory::{Content, LeafEntries, PageEntry};
use super::head::Header;
use super::levels::Level;
use super::metadata::Metadata;
use super::opening::{Opened, Opening};
use super::page_coding::PageDecoder;
use super::shard::Shard;
use crate::bytes::{ByteSource, MapSource, MemorySource, open_named};
use crate::edit::Edits;
use crate::frame::{Frame, PageKey};
use crate::page::{Inferred, Page};
use crate::plan::{Noise, Plan};
use crate::unit::LengthUnit;
use crate::{Error, Result};
use std::io::ErrorKind;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Most bytes of leaves read at once, unless a single leaf is longer.
const LEAVES: u64 = 1 << 20;

/// Open archive. Any number of threads may read from it at once.
///
/// Memory: the root directory (at most 512 leaves, 20 KiB) and the leaf last used by [`find`](Self::find).
pub struct Archive {
    source: Arc<dyn ByteSource>,
    catalog: Catalog,
    levels: OnceLock<Vec<Level>>,
    found: Mutex<Option<(usize, Arc<Vec<PageEntry>>)>>,
    edits: Option<Arc<Edits>>,
}

impl Archive {
    /// Opens the archive at `path` for positioned reads, with two reads. A file that is truncated later gives errors.
    ///
    /// With the feature `remote`, the path may be an address, as for [`RemoteSource`](crate::bytes::RemoteSource).
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_source(open_named(path.as_ref())?).map_err(|error| name_stranger(path.as_ref(), error))
    }

    /// Opens the archive at `path` mapped into memory. As for [`MapSource`], the file must not be written to or
    /// truncated while it is open, or the process ends with a signal; replacing it by rename is safe.
    pub fn map(path: impl AsRef<Path>) -> Result<Self> {
        let source = MapSource::open(&path)?;
        Self::from_source(Box::new(source)).map_err(|error| name_stranger(path.as_ref(), error))
    }

    /// Opens an archive held in memory.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self> {
        Self::from_source(Box::new(MemorySource::new(bytes)))
    }

    /// Opens an archive with at most two reads: its first 16 KiB, and its footer if that lies beyond them. Fails on any
    /// damage of head and footer, and on missing or extra bytes; leaves and pages are checked when they are read.
    pub fn from_source(source: Box<dyn ByteSource>) -> Result<Self> {
        let mut opening = Opening::new(Some(source.len()));
        loop {
            match opening.next()? {
                Opened::Ready(catalog) => return Ok(Self::from_parts(source.into(), *catalog)),
                Opened::Wants(ranges) => {
                    for range in ranges {
                        opening.give(range.start, &read(&*source, range.clone())?);
                    }
                }
            }
        }
    }

    /// Creates an archive from a known head, whatever the state of the rest.
    pub(super) fn from_parts(source: Arc<dyn ByteSource>, catalog: Catalog) -> Self {
        Self { source, catalog, levels: OnceLock::new(), found: Mutex::new(None), edits: None }
    }

    /// Returns the archive with inferred spans ignored: its pages, and those of stores and streams on it, then hold
    /// only what was scanned (guarantee G2). Header, directory and overview levels stay as they are.
    pub fn ignoring_inferred(self) -> Self {
        Self { edits: self.edits, ..Self::from_parts(self.source, self.catalog.ignoring_inferred()) }
    }

    /// Returns the archive with edits: stores and streams on it, and on its levels, hold the edited space. Its own pages
    /// and entries stay as they are, as do the loaders of a program that reads bytes itself.
    pub fn with_edits(self, edits: Edits) -> Self {
        Self { edits: (!edits.is_empty()).then(|| Arc::new(edits)), ..self }
    }

    /// Returns the edits that the archive carries.
    pub fn edits(&self) -> Option<&Edits> {
        self.edits.as_deref()
    }

    /// Returns an archive on the same bytes with `catalog` in place of its own.
    pub(super) fn with_catalog(&self, catalog: Catalog) -> Self {
        Self::from_parts(self.source.clone(), catalog)
    }

    /// Returns the archive, with its edits, with inferred spans included.
    pub(super) fn whole(&self) -> Self {
        Self { edits: self.edits.clone(), ..Self::from_parts(self.source.clone(), self.catalog.whole()) }
    }

    /// Returns the overview levels, finest first; none if the archive was written without levels, has too few pages for
    /// any, or is a level itself. Takes one read, the first time.
    pub fn levels(&self) -> Result<&[Level]> {
        if let Some(levels) = self.levels.get() {
            return Ok(levels);
        }
        let levels = match self.catalog.levels_range() {
            Some(range) => self.catalog.decode_levels(&read(&*self.source, range)?)?,
            None => Vec::new(),
        };
        Ok(self.levels.get_or_init(|| levels))
    }

    /// Returns overview level `number` (1 is the finest) as an archive of its own on a coarser grid; stores, streams
    /// and all queries accept it. It reads from the same source; its metadata is empty. A
    /// [`ColourReader`](super::ColourReader) on it reads its colours, if the archive has any. Fails if there is no such
    /// level.
    pub fn level(&self, number: u32) -> Result<Self> {
        let levels = self.levels()?;
        let level = levels.iter().find(|level| level.number() == number).ok_or_else(|| {
            let reason = match levels.len() {
                0 => "the archive has no overview levels".to_string(),
                count => format!("the archive has levels 1 to {count}"),
            };
            Error::parameter(format!("level {number}"), reason)
        })?;
        let edits = self.edits.clone();
        Ok(Self { edits, ..Self::from_parts(self.source.clone(), level.catalog().clone()) })
    }

    /// Like [`level`](Self::level), but from the bytes of the level alone ([`Level::bytes`]), for programs that fetch
    /// bytes themselves. Fails if `bytes` are more or fewer. The level has no colours, since those lie elsewhere.
    pub fn of_level(level: &Level, bytes: Vec<u8>) -> Result<Self> {
        let range = level.bytes();
        let len = range.end - range.start;
        if bytes.len() as u64 != len {
            let reason = format!("expected its {len} bytes from {} on, found {}", range.start, bytes.len());
            return Err(Error::parameter(format!("level {}", level.number()), reason));
        }
        let source = Arc::new(MemorySource::part(range.start, bytes));
        Ok(Self::from_parts(source, level.catalog().without_level_colours()))
    }

    /// Returns what is known of the archive without another read.
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// Returns the decoded header.
    pub fn header(&self) -> &Header {
        self.catalog.header()
    }

    /// Returns grid and options of the conversion.
    pub fn plan(&self) -> &Plan {
        &self.header().plan
    }

    /// Returns the grid.
    pub fn frame(&self) -> &Frame {
        &self.header().plan.frame
    }

    /// Returns the source of the bytes.
    pub fn source(&self) -> &dyn ByteSource {
        &*self.source
    }

    /// Returns the coordinate reference system as the input stated it, empty if unknown. Takes one read.
    pub fn crs(&self) -> Result<String> {
        Ok(self.metadata()?.crs)
    }

    /// Returns the part of a conversion that the archive holds, if it was converted in parts. Takes one read.
    pub fn shard(&self) -> Result<Option<Shard>> {
        Ok(self.metadata()?.shard)
    }

    /// Returns the noise of the scan, if the tolerance was chosen from it. Takes one read.
    pub fn noise(&self) -> Result<Option<Noise>> {
        Ok(self.metadata()?.noise)
    }

    /// Returns the units of the inputs, ascending and without duplicates; empty if unknown. Takes one read.
    pub fn units(&self) -> Result<Vec<LengthUnit>> {
        Ok(self.metadata()?.units)
    }

    pub(super) fn metadata(&self) -> Result<Metadata> {
        self.catalog.decode_metadata(&read(&*self.source, self.catalog.metadata_range())?)
    }

    /// Returns the number of directory leaves.
    pub fn leaf_count(&self) -> usize {
        self.catalog.leaf_count()
    }

    /// Returns the leaf whose entries could include `key`. Takes no read.
    pub fn leaf_of(&self, key: PageKey) -> Option<usize> {
        self.catalog.leaf_of(key)
    }

    /// Returns the key of the first entry of leaf `index`. Takes no read.
    pub fn leaf_first(&self, index: usize) -> PageKey {
        self.catalog.leaf_first(index)
    }

    /// Returns the entries of leaf `index`, ascending. Takes one read of about 10 bytes per entry.
    pub fn leaf(&self, index: usize) -> Result<Vec<PageEntry>> {
        self.open_leaf(index)?.collect()
    }

    /// Like [`leaf`](Self::leaf), but decodes entries lazily, so a broken rule may show up only after some of them.
    pub(super) fn open_leaf(&self, index: usize) -> Result<LeafEntries> {
        self.catalog.open_leaf(index, &read(&*self.source, self.catalog.leaf_range(index))?)
    }

    /// Iterates over all entries in ascending order, leaf by leaf. A leaf that cannot be read gives one error; the next
    /// leaf follows.
    ///
    /// Gives a single error and no entries if more than 2²² pages (2¹⁶ with overview levels) have no bytes of their own
    /// and they exceed one for every 16 bytes of the archive.
    pub fn entries(&self) -> impl Iterator<Item = Result<PageEntry>> + '_ {
        let limits = self.header().check_repeats().err();
        let leaves = if limits.is_some() { 0 } else { self.leaf_count() };
        let mut ahead = (0..0, Vec::new());
        let leaves = (0..leaves).flat_map(move |index| {
            let leaf = self.leaf_ahead(index, &mut ahead).and_then(|entries| entries.check().map(|_| entries));
            let (entries, error) = match leaf {
                Ok(entries) => (Some(entries), None),
                Err(error) => (None, Some(error)),
            };
            entries.into_iter().flatten().chain(error.map(Err))
        });
        limits.map(Err).into_iter().chain(leaves)
    }

    /// Like [`open_leaf`](Self::open_leaf), for sequential reading: `ahead` caches the bytes of several leaves from one
    /// read.
    fn leaf_ahead(&self, index: usize, ahead: &mut (Range<u64>, Vec<u8>)) -> Result<LeafEntries> {
        let leaf = self.catalog.leaf_range(index);
        if leaf.start < ahead.0.start || leaf.end > ahead.0.end {
            let ends = (index..self.leaf_count()).map(|index| self.catalog.leaf_range(index).end);
            let end = ends.take_while(|end| end - leaf.start <= LEAVES).last().unwrap_or(leaf.end);
            let is_lasting =
                |error: &Error| matches!(error, Error::Io { source, .. } if source.kind() != ErrorKind::TimedOut);
            let bytes = match read(&*self.source, leaf.start..end) {
                // Report a read error only for the leaf whose bytes fail.
                Err(error) if end > leaf.end && is_lasting(&error) => read(&*self.source, leaf.clone())?,
                read => read?,
            };
            *ahead = (leaf.start..leaf.start + bytes.len() as u64, bytes);
        }
        let start = (leaf.start - ahead.0.start) as usize;
        self.catalog.open_leaf(index, &ahead.1[start..start + (leaf.end - leaf.start) as usize])
    }

    /// Returns the entry of a page; `None` if the archive has no such page. Takes one read, or none if the last call
    /// used the same leaf.
    pub fn find(&self, key: PageKey) -> Result<Option<PageEntry>> {
        let Some(index) = self.leaf_of(key) else { return Ok(None) };
        let lock = || self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let held = lock().as_ref().filter(|held| held.0 == index).map(|held| held.1.clone());
        let entries = match held {
            Some(entries) => entries,
            None => {
                let entries = Arc::new(self.leaf(index)?);
                *lock() = Some((index, entries.clone()));
                entries
            }
        };
        Ok(entries.binary_search_by_key(&key, |entry| entry.key).ok().map(|at| entries[at]))
    }

    /// Reads the page of `entry`. Takes one read, or none for a uniform page.
    pub fn page(&self, entry: &PageEntry) -> Result<Page> {
        self.page_with(entry, &mut PageDecoder::new())
    }

    /// Like [`page`](Self::page), but reuses the scratch memory of `decoder`, for loading many pages.
    pub fn page_with(&self, entry: &PageEntry, decoder: &mut PageDecoder) -> Result<Page> {
        decoder.set_ignore_inferred(self.catalog.ignores_inferred());
        let mut bytes = std::mem::take(&mut decoder.bytes);
        bytes.clear();
        if let Some(extent) = entry.extent() {
            // Decoding a leaf bounds the length; an entry made by hand is checked here.
            if extent.len as usize > super::page_coding::MAX_STORED_PAGE {
                return Err(Error::limit("bytes of a page", extent.len, super::page_coding::MAX_STORED_PAGE));
            }
            bytes.resize(extent.len as usize, 0);
            self.source.read_at(extent.offset, &mut bytes)?;
        }
        let page = decoder.decode(entry, &bytes);
        decoder.bytes = bytes;
        page
    }
}

/// Reads pages in turn. A page with the same content as the last one is neither read nor decoded again.
#[derive(Debug)]
pub struct PageReader<'a> {
    archive: &'a Archive,
    decoder: PageDecoder,
    last: Option<(Content, Page)>,
}

impl<'a> PageReader<'a> {
    /// Creates a reader of the pages of `archive`. Memory: one page, and the scratch memory of a [`PageDecoder`].
    pub fn new(archive: &'a Archive) -> Self {
        Self { archive, decoder: PageDecoder::new(), last: None }
    }

    /// Reads the page of `entry`; see [`Archive::page`].
    pub fn page(&mut self, entry: &PageEntry) -> Result<&Page> {
        Ok(self.page_and_inferred(entry)?.0)
    }

    /// Like [`page`](Self::page), and also returns which of its spans are inferred.
    pub fn page_and_inferred(&mut self, entry: &PageEntry) -> Result<(&Page, &Inferred)> {
        let content = entry.content();
        let last = match self.last.take() {
            Some(last) if last.0 == content => last,
            _ => (content, self.archive.page_with(entry, &mut self.decoder)?),
        };
        Ok((&self.last.insert(last).1, self.decoder.inferred()))
    }
}

/// Reads the bytes of `range`, whose length a rule of the format bounds.
pub(super) fn read(source: &dyn ByteSource, range: Range<u64>) -> Result<Vec<u8>> {
    let mut bytes = vec![0; (range.end - range.start) as usize];
    source.read_at(range.start, &mut bytes)?;
    Ok(bytes)
}

impl std::fmt::Debug for Archive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Archive").field("header", self.header()).field("leaves", &self.leaf_count()).finish()
    }
}

/// Adds the path to the error about a file that is not an archive.
fn name_stranger(path: &Path, error: Error) -> Error {
    match error {
        Error::Format { rule: rule @ "H1", expected, found, .. } => {
            let reason = format!("rule {rule}: expected {expected}, found {found}; convert a scan or mesh first");
            Error::input(path, "first bytes", reason)
        }
        other => other,
    }
}
