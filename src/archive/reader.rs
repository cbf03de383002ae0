//! Reading an archive: head and footer at once, directory leaves and pages on demand (chapter 10).

use super::directory::{PageEntry, Place, decode_leaf, max_raw_len};
use super::head::{self, FOOTER, Header, Leaf, MAX_HEAD};
use super::metadata::Metadata;
use super::page::PageDecoder;
use super::shard::Shard;
use crate::bytes::{ByteSource, FileSource, MapSource, MemorySource};
use crate::codec::{Unpacker, Violation};
use crate::frame::{Frame, PageKey};
use crate::plan::Plan;
use crate::slice::Page;
use crate::{Error, Result};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// An open archive. Any number of threads may read from it at once.
///
/// Memory: the root directory (at most 512 leaves, 24 KiB) and the leaf that [`find`](Self::find) used last.
pub struct Archive {
    source: Box<dyn ByteSource>,
    header: Header,
    leaves: Vec<Leaf>,
    found: Mutex<Option<(usize, Arc<[PageEntry]>)>>,
}

impl Archive {
    /// Opens the archive at `path`, to be read by position: a file that is cut later gives errors. Two reads.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_source(Box::new(FileSource::open(path)?))
    }

    /// Opens the archive at `path` mapped into memory. Condition, as for [`MapSource`]: nobody may write to or cut the
    /// file while it is open, or the process ends with a signal; replacing it by rename is safe.
    pub fn map(path: impl AsRef<Path>) -> Result<Self> {
        Self::from_source(Box::new(MapSource::open(path)?))
    }

    /// Opens the archive that `bytes` are.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self> {
        Self::from_source(Box::new(MemorySource::new(bytes)))
    }

    /// Opens an archive with at most two reads: its first 16 KiB, and its footer if that lies beyond them. Finds any
    /// damage of head and footer, and bytes that are missing or too many; pages and leaves are checked when read.
    pub fn from_source(source: Box<dyn ByteSource>) -> Result<Self> {
        let file_len = source.len();
        let mut start = vec![0; file_len.min(MAX_HEAD as u64) as usize];
        source.read_at(0, &mut start)?;
        let (header, leaves) = head::decode(&start, file_len)?;
        let mut footer = [0; FOOTER];
        match start.len() as u64 == file_len {
            true => footer.copy_from_slice(&start[start.len() - FOOTER..]),
            false => source.read_at(file_len - FOOTER as u64, &mut footer)?,
        }
        head::check_footer(&footer, file_len, &start[..header.bytes.head as usize])?;
        Ok(Self::from_parts(source, header, leaves))
    }

    /// An archive whose head is known, whatever the state of the rest.
    pub(super) fn from_parts(source: Box<dyn ByteSource>, header: Header, leaves: Vec<Leaf>) -> Self {
        Self { source, header, leaves, found: Mutex::new(None) }
    }

    /// What the head says about the whole.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Grid and options of the conversion.
    pub fn plan(&self) -> &Plan {
        &self.header.plan
    }

    /// The grid.
    pub fn frame(&self) -> &Frame {
        &self.header.plan.frame
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

    pub(super) fn metadata(&self) -> Result<Metadata> {
        let offset = self.header.metadata_offset();
        // At most 1 MiB: rule H9.
        let mut bytes = vec![0; self.header.bytes.metadata as usize];
        self.source.read_at(offset, &mut bytes)?;
        let metadata = Metadata::decode(&bytes, self.header.metadata_crc);
        metadata.map_err(|violation| violation.at("metadata", offset))
    }

    /// Number of directory leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// The leaf whose entries could include `key`; no read.
    pub fn leaf_of(&self, key: PageKey) -> Option<usize> {
        self.leaves.partition_point(|leaf| leaf.first <= key).checked_sub(1)
    }

    /// Key of the first entry of leaf `index`; no read.
    pub fn leaf_first(&self, index: usize) -> PageKey {
        self.leaves[index].first
    }

    /// Entries of leaf `index`, ascending. One read of about 10 bytes an entry.
    pub fn leaf(&self, index: usize) -> Result<Vec<PageEntry>> {
        let leaf = &self.leaves[index];
        let offset = self.header.directory_offset() + leaf.offset;
        // Not beyond the directory section: rule R4.
        let mut stored = vec![0; leaf.stored_len as usize];
        self.source.read_at(offset, &mut stored)?;
        let entries = self.decode_leaf(index, &stored);
        entries.map_err(|violation| violation.at(format!("directory leaf {index}"), offset))
    }

    fn decode_leaf(&self, index: usize, stored: &[u8]) -> Result<Vec<PageEntry>, Violation> {
        let leaf = &self.leaves[index];
        let crc = crc32c::crc32c(stored);
        if crc != leaf.crc {
            return Err(Violation::new("D1", format!("checksum {:08x}", leaf.crc), format!("{crc:08x}")));
        }
        if leaf.raw_len as u64 > max_raw_len(leaf.entries) {
            let expected = format!("at most {} bytes for {} entries", max_raw_len(leaf.entries), leaf.entries);
            return Err(Violation::new("D2", expected, leaf.raw_len));
        }
        let mut unpacker = Unpacker::new();
        let raw = unpacker.unpack(stored, leaf.raw_len as usize, "D2")?;
        if raw.len() != leaf.raw_len as usize {
            return Err(Violation::new("D2", format!("{} bytes in the frame", leaf.raw_len), raw.len()));
        }
        let mut entries = decode_leaf(raw, leaf.entries, leaf.first, self.header.bytes.pages)?;
        if let (Some(next), Some(last)) = (self.leaves.get(index + 1), entries.last())
            && last.key >= next.first
        {
            return Err(Violation::new(
                "D4",
                format!("keys below {}, where the next leaf begins", next.first),
                last.key,
            ));
        }
        for entry in &mut entries {
            if let Place::Stored(extent) | Place::Shared(extent) = &mut entry.place {
                extent.offset += self.header.pages_offset();
            }
        }
        Ok(entries)
    }

    /// All entries in ascending order, leaf by leaf. A leaf that cannot be read is one error, and the next follows.
    pub fn entries(&self) -> impl Iterator<Item = Result<PageEntry>> + '_ {
        (0..self.leaf_count()).flat_map(|index| {
            let (entries, error) = match self.leaf(index) {
                Ok(entries) => (entries, None),
                Err(error) => (Vec::new(), Some(error)),
            };
            entries.into_iter().map(Ok).chain(error.map(Err))
        })
    }

    /// All entries in ascending order, leaves that lie together in one read of at most 1 MiB (or one leaf). Fails with
    /// the first leaf that cannot be read.
    pub(crate) fn all_entries(&self) -> Result<Vec<PageEntry>> {
        let (mut all, mut bytes, mut first) = (Vec::new(), Vec::new(), 0);
        while first < self.leaves.len() {
            let mut len = 0;
            let fits = |leaf: &&Leaf| {
                len += leaf.stored_len as usize;
                len <= 1 << 20
            };
            let count = self.leaves[first..].iter().take_while(fits).count().max(1);
            let leaves = &self.leaves[first..first + count];
            let start = leaves[0].offset;
            // Not beyond the directory section: rule R4.
            bytes.resize(leaves.iter().map(|leaf| leaf.stored_len as usize).sum(), 0);
            let at = self.header.directory_offset() + start;
            self.source.read_at(at, &mut bytes)?;
            for (number, leaf) in leaves.iter().enumerate() {
                let from = (leaf.offset - start) as usize;
                let stored = &bytes[from..from + leaf.stored_len as usize];
                let entries = self.decode_leaf(first + number, stored);
                let part = || format!("directory leaf {}", first + number);
                all.extend(entries.map_err(|violation| violation.at(part(), at + from as u64))?);
            }
            first += count;
        }
        Ok(all)
    }

    /// The entry of a page; `None` if the archive has no matter there. One read, or none in the leaf of the last call.
    pub fn find(&self, key: PageKey) -> Result<Option<PageEntry>> {
        let Some(index) = self.leaf_of(key) else { return Ok(None) };
        let lock = || self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let held = lock().as_ref().filter(|held| held.0 == index).map(|held| held.1.clone());
        let entries = match held {
            Some(entries) => entries,
            None => {
                let entries: Arc<[PageEntry]> = self.leaf(index)?.into();
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
        let mut bytes = std::mem::take(&mut decoder.bytes);
        bytes.clear();
        if let Some(extent) = entry.extent() {
            // The length was checked with the leaf; an entry made by hand is checked here.
            if extent.len as usize > super::page::MAX_STORED_PAGE {
                let max = super::page::MAX_STORED_PAGE.to_string();
                return Err(Error::Limit { what: "bytes of a page".into(), value: extent.len.to_string(), max });
            }
            bytes.resize(extent.len as usize, 0);
            self.source.read_at(extent.offset, &mut bytes)?;
        }
        let page = decoder.decode(entry, &bytes);
        decoder.bytes = bytes;
        page
    }
}

impl std::fmt::Debug for Archive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Archive").field("header", &self.header).field("leaves", &self.leaves.len()).finish()
    }
}
