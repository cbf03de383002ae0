//! Reading an archive: head and footer at once, directory leaves and pages on demand (chapter 10).

use super::catalog::Catalog;
use super::directory::{Content, LeafEntries, PageEntry};
use super::head::Header;
use super::levels::Level;
use super::metadata::Metadata;
use super::opening::{Opened, Opening};
use super::page::PageDecoder;
use super::shard::Shard;
use crate::bytes::{ByteSource, MapSource, MemorySource, open_named};
use crate::frame::{Frame, PageKey};
use crate::plan::{Noise, Plan};
use crate::slice::{Inferred, Page};
use crate::unit::LengthUnit;
use crate::{Error, Result};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Most bytes of leaves read at once, unless a single leaf is longer.
const LEAVES: u64 = 1 << 20;

/// An open archive. Any number of threads may read from it at once.
///
/// Memory: the root directory (at most 512 leaves, 24 KiB) and the leaf that [`find`](Self::find) used last.
pub struct Archive {
    source: Arc<dyn ByteSource>,
    catalog: Catalog,
    levels: OnceLock<Vec<Level>>,
    found: Mutex<Option<(usize, Arc<Vec<PageEntry>>)>>,
}

impl Archive {
    /// Opens the archive at `path`, to be read by position: a file that is cut later gives errors. Two reads.
    /// With the feature `remote` the path may be an address, as for [`RemoteSource`](crate::bytes::RemoteSource).
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_source(open_named(path.as_ref())?).map_err(|error| name_stranger(path.as_ref(), error))
    }

    /// Opens the archive at `path` mapped into memory. Condition, as for [`MapSource`]: nobody may write to or cut the
    /// file while it is open, or the process ends with a signal; replacing it by rename is safe.
    pub fn map(path: impl AsRef<Path>) -> Result<Self> {
        let source = MapSource::open(&path)?;
        Self::from_source(Box::new(source)).map_err(|error| name_stranger(path.as_ref(), error))
    }

    /// Opens the archive that `bytes` are.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self> {
        Self::from_source(Box::new(MemorySource::new(bytes)))
    }

    /// Opens an archive with at most two reads: its first 16 KiB, and its footer if that lies beyond them. Finds any
    /// damage of head and footer, and bytes that are missing or too many; pages and leaves are checked when read.
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

    /// An archive whose head is known, whatever the state of the rest.
    pub(super) fn from_parts(source: Arc<dyn ByteSource>, catalog: Catalog) -> Self {
        Self { source, catalog, levels: OnceLock::new(), found: Mutex::new(None) }
    }

    /// The same archive, whose pages come without inferred matter: what was scanned and nothing else (guarantee G2). So do those of
    /// stores and streams of it. Header, directory and overview levels stay as they are.
    pub fn ignoring_inferred(self) -> Self {
        Self::from_parts(self.source, self.catalog.ignoring_inferred())
    }

    /// The same bytes, of which `catalog` says more.
    pub(super) fn with_catalog(&self, catalog: Catalog) -> Self {
        Self::from_parts(self.source.clone(), catalog)
    }

    /// The same archive with inferred matter.
    pub(super) fn whole(&self) -> Self {
        Self::from_parts(self.source.clone(), self.catalog.whole())
    }

    /// The overview levels, finest first; none if the archive was written without, has too few pages for any, or is a level
    /// itself. One read, the first time.
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

    /// Overview level `number` (1 is the finest) as an archive of its own on a coarser grid, for a store, a stream and every
    /// query. It reads from the same source; its metadata are empty. A [`ColourReader`](super::ColourReader) of it reads its colours,
    /// if the archive has some.
    pub fn level(&self, number: u32) -> Result<Self> {
        let levels = self.levels()?;
        let level = levels.iter().find(|level| level.number() == number).ok_or_else(|| {
            let reason = match levels.len() {
                0 => "the archive has no overview levels".to_string(),
                count => format!("the archive has levels 1 to {count}"),
            };
            Error::parameter(format!("level {number}"), reason)
        })?;
        Ok(Self::from_parts(self.source.clone(), level.catalog().clone()))
    }

    /// As [`level`](Self::level), from the bytes of the level alone ([`Level::bytes`]): for programs that fetch bytes
    /// themselves. Fails if there are more or fewer. Its colours lie elsewhere: it has none.
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

    /// What is known of the archive without another read.
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// What the head says about the whole.
    pub fn header(&self) -> &Header {
        self.catalog.header()
    }

    /// Grid and options of the conversion.
    pub fn plan(&self) -> &Plan {
        &self.header().plan
    }

    /// The grid.
    pub fn frame(&self) -> &Frame {
        &self.header().plan.frame
    }

    /// Where the bytes come from.
    pub fn source(&self) -> &dyn ByteSource {
        &*self.source
    }

    /// The coordinate reference system as the input stated it, empty if unknown. One read.
    pub fn crs(&self) -> Result<String> {
        Ok(self.metadata()?.crs)
    }

    /// Which part of a conversion the archive holds, if it was converted in parts. One read.
    pub fn shard(&self) -> Result<Option<Shard>> {
        Ok(self.metadata()?.shard)
    }

    /// The noise of the scan, if the tolerance was chosen by it. One read.
    pub fn noise(&self) -> Result<Option<Noise>> {
        Ok(self.metadata()?.noise)
    }

    /// The units in which the inputs came, ascending and each once; none if unknown. One read.
    pub fn units(&self) -> Result<Vec<LengthUnit>> {
        Ok(self.metadata()?.units)
    }

    pub(super) fn metadata(&self) -> Result<Metadata> {
        self.catalog.decode_metadata(&read(&*self.source, self.catalog.metadata_range())?)
    }

    /// Number of directory leaves.
    pub fn leaf_count(&self) -> usize {
        self.catalog.leaf_count()
    }

    /// The leaf whose entries could include `key`; no read.
    pub fn leaf_of(&self, key: PageKey) -> Option<usize> {
        self.catalog.leaf_of(key)
    }

    /// Key of the first entry of leaf `index`; no read.
    pub fn leaf_first(&self, index: usize) -> PageKey {
        self.catalog.leaf_first(index)
    }

    /// Entries of leaf `index`, ascending. One read of about 10 bytes an entry.
    pub fn leaf(&self, index: usize) -> Result<Vec<PageEntry>> {
        self.open_leaf(index)?.collect()
    }

    /// As [`leaf`](Self::leaf), entry by entry. A rule may turn out to be broken after some of them.
    pub(super) fn open_leaf(&self, index: usize) -> Result<LeafEntries> {
        self.catalog.open_leaf(index, &read(&*self.source, self.catalog.leaf_range(index))?)
    }

    /// All entries in ascending order, leaf by leaf. A leaf that cannot be read is one error, and the next follows. An
    /// archive that has more than 2²² pages without bytes, and more than one for 16 of its bytes, gives one error alone.
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

    /// As [`open_leaf`](Self::open_leaf), of leaves one after the other: `ahead` holds the bytes of some in one read.
    fn leaf_ahead(&self, index: usize, ahead: &mut (Range<u64>, Vec<u8>)) -> Result<LeafEntries> {
        let leaf = self.catalog.leaf_range(index);
        if leaf.start < ahead.0.start || leaf.end > ahead.0.end {
            let ends = (index..self.leaf_count()).map(|index| self.catalog.leaf_range(index).end);
            let end = ends.take_while(|end| end - leaf.start <= LEAVES).last().unwrap_or(leaf.end);
            let is_lasting = |error: &Error| match error {
                Error::Io { source, .. } => source.kind() != std::io::ErrorKind::TimedOut,
                _ => false,
            };
            let bytes = match read(&*self.source, leaf.start..end) {
                // Bytes that cannot be read are the fault of the leaf that they belong to.
                Err(error) if end > leaf.end && is_lasting(&error) => read(&*self.source, leaf.clone())?,
                read => read?,
            };
            *ahead = (leaf.start..leaf.start + bytes.len() as u64, bytes);
        }
        let start = (leaf.start - ahead.0.start) as usize;
        self.catalog.open_leaf(index, &ahead.1[start..start + (leaf.end - leaf.start) as usize])
    }

    /// The entry of a page; `None` if the archive has no matter there. One read, or none in the leaf of the last call.
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

    /// The page of an entry. One read, none for a uniform page.
    pub fn page(&self, entry: &PageEntry) -> Result<Page> {
        self.page_with(entry, &mut PageDecoder::new())
    }

    /// As [`page`](Self::page), with the scratch memory of `decoder`, for loading many.
    pub fn page_with(&self, entry: &PageEntry, decoder: &mut PageDecoder) -> Result<Page> {
        decoder.set_ignore_inferred(self.catalog.ignores_inferred());
        let mut bytes = std::mem::take(&mut decoder.bytes);
        bytes.clear();
        if let Some(extent) = entry.extent() {
            // The length was checked with the leaf; an entry made by hand is checked here.
            if extent.len as usize > super::page::MAX_STORED_PAGE {
                return Err(Error::limit("bytes of a page", extent.len, super::page::MAX_STORED_PAGE));
            }
            bytes.resize(extent.len as usize, 0);
            self.source.read_at(extent.offset, &mut bytes)?;
        }
        let page = decoder.decode(entry, &bytes);
        decoder.bytes = bytes;
        page
    }
}

/// Reads pages one after the other. One with the content of the last is neither read nor decoded again.
#[derive(Debug)]
pub struct PageReader<'a> {
    archive: &'a Archive,
    decoder: PageDecoder,
    last: Option<(Content, Page)>,
}

impl<'a> PageReader<'a> {
    /// A reader of the pages of `archive`. Memory: one page, and the scratch memory of a [`PageDecoder`].
    pub fn new(archive: &'a Archive) -> Self {
        Self { archive, decoder: PageDecoder::new(), last: None }
    }

    /// The page of an entry, as by [`Archive::page`].
    pub fn page(&mut self, entry: &PageEntry) -> Result<&Page> {
        let content = entry.content();
        let last = match self.last.take() {
            Some(last) if last.0 == content => last,
            _ => (content, self.archive.page_with(entry, &mut self.decoder)?),
        };
        Ok(&self.last.insert(last).1)
    }

    /// As [`page`](Self::page), and which of its spans are inferred.
    pub fn page_and_inferred(&mut self, entry: &PageEntry) -> Result<(&Page, &Inferred)> {
        self.page(entry)?;
        match &self.last {
            Some((_, page)) => Ok((page, self.decoder.inferred())),
            None => Err(Error::parameter("page", "was not read")),
        }
    }
}

/// The bytes of `range`, whose length a rule of the format bounds.
fn read(source: &dyn ByteSource, range: Range<u64>) -> Result<Vec<u8>> {
    let mut bytes = vec![0; (range.end - range.start) as usize];
    source.read_at(range.start, &mut bytes)?;
    Ok(bytes)
}

impl std::fmt::Debug for Archive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Archive").field("header", self.header()).field("leaves", &self.leaf_count()).finish()
    }
}

/// An error of opening the file at `path`: what is no archive at all is told by its name, for it may be anything.
fn name_stranger(path: &Path, error: Error) -> Error {
    match error {
        Error::Format { rule: rule @ "H1", expected, found, .. } => {
            let reason = format!("rule {rule}: expected {expected}, found {found}; convert a scan or mesh first");
            Error::input(path, "first bytes", reason)
        }
        other => other,
    }
}
