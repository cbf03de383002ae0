//! State of an open archive without its pages: where leaves and metadata lie, and how to decode their bytes.
//!
//! The caller fetches bytes; this module returns page entries and metadata. It reads nothing itself.

use super::colour_section::{ColourHead, LevelColours};
use super::directory::{LeafEntries, LeafPlace, PageEntry, max_raw_len};
use super::head::{Header, Leaf};
use super::levels::{Level, decode_table};
use super::metadata::Metadata;
use crate::Result;
use crate::bytes::crc;
use crate::codec::{Unpacker, Violation};
use crate::frame::PageKey;
use crate::unit::LengthUnit;
use std::ops::Range;

/// Head of an archive: header and root directory.
///
/// The caller fetches each part by its range and decodes it here; pages are fetched by their
/// [`extent`](PageEntry::extent) and decoded by a [`PageDecoder`](super::PageDecoder).
///
/// Memory: at most 512 leaves of 40 bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct Catalog {
    header: Header,
    leaves: Vec<Leaf>,
    ignores_inferred: bool,
    /// Bytes of the colours section.
    pub(super) colours: Option<Range<u64>>,
    /// Table that locates the colours of this level. Set only for levels, and only until the table was decoded.
    pub(super) level_colours: Option<LevelColours>,
}

impl Catalog {
    pub(super) fn new(header: Header, leaves: Vec<Leaf>) -> Self {
        let colours = header.colours.map(|_| header.colours_offset()..header.levels_offset());
        Self { header, leaves, ignores_inferred: false, colours, level_colours: None }
    }

    /// Returns the catalog of a level; `level_colours` is set if the archive says that the level has colours.
    pub(super) fn of_level(header: Header, leaves: Vec<Leaf>, level_colours: Option<LevelColours>) -> Self {
        Self { level_colours, ..Self::new(header, leaves) }
    }

    /// Returns the catalog of a level whose colours lie in `range`.
    pub(super) fn with_colours_at(&self, head: ColourHead, range: Range<u64>) -> Self {
        let mut catalog = Self { colours: Some(range), level_colours: None, ..self.clone() };
        catalog.header.colours = Some(head);
        catalog
    }

    /// Returns the catalog of a level without its colours.
    pub(super) fn without_level_colours(&self) -> Self {
        Self { level_colours: None, ..self.clone() }
    }

    /// Returns the catalog with inferred spans ignored: archives, stores, loaders and streams then return only what was
    /// scanned (guarantee G2). Header, directory and overview levels stay as they are.
    pub fn ignoring_inferred(self) -> Self {
        Self { ignores_inferred: true, ..self }
    }

    /// Returns whether pages come without inferred spans.
    pub fn ignores_inferred(&self) -> bool {
        self.ignores_inferred
    }

    /// Returns the catalog with inferred spans included.
    pub(super) fn whole(&self) -> Self {
        Self { ignores_inferred: false, ..self.clone() }
    }

    /// Returns the decoded header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Number of directory leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// Returns the leaf whose entries could include `key`.
    pub fn leaf_of(&self, key: PageKey) -> Option<usize> {
        self.leaves.partition_point(|leaf| leaf.first <= key).checked_sub(1)
    }

    /// Returns the key of the first entry of leaf `index`.
    pub fn leaf_first(&self, index: usize) -> PageKey {
        self.leaves[index].first
    }

    /// Returns the bytes of leaf `index`, which lie in the directory section (rule R4). Leaves are contiguous.
    pub fn leaf_range(&self, index: usize) -> Range<u64> {
        let leaf = &self.leaves[index];
        let start = self.header.directory_offset() + leaf.offset;
        start..start + u64::from(leaf.stored_len)
    }

    /// Number of entries of leaf `index`, at most 2²⁰.
    pub fn leaf_entries(&self, index: usize) -> u32 {
        self.leaves[index].entries
    }

    /// Decodes the entries of leaf `index`, ascending, from `stored`, the bytes of its range. Fails if a rule D1 to D11
    /// is broken.
    ///
    /// Memory besides the result: at most 47 bytes per entry.
    pub fn decode_leaf(&self, index: usize, stored: &[u8]) -> Result<Vec<PageEntry>> {
        self.open_leaf(index, stored)?.collect()
    }

    /// Like [`decode_leaf`](Self::decode_leaf), but decodes entries lazily, so a broken rule may show up only after
    /// some of them.
    pub(super) fn open_leaf(&self, index: usize, stored: &[u8]) -> Result<LeafEntries> {
        let leaf = &self.leaves[index];
        let place = LeafPlace {
            index,
            offset: self.leaf_range(index).start,
            entries: leaf.entries,
            first: leaf.first,
            end: self.leaves.get(index + 1).map(|next| next.first),
            pages: self.header.pages_offset()..self.header.colours_offset(),
        };
        let unpacked = self.unpack_leaf(leaf, stored).map_err(|violation| place.broken(violation));
        LeafEntries::new(unpacked?, place)
    }

    fn unpack_leaf(&self, leaf: &Leaf, stored: &[u8]) -> Result<Vec<u8>, Violation> {
        let crc = crc::crc32c(stored);
        if crc != leaf.crc {
            return Err(Violation::new("D1", format!("checksum {:08x}", leaf.crc), format!("{crc:08x}")));
        }
        if leaf.raw_len as u64 > max_raw_len(leaf.entries) {
            let expected = format!("at most {} bytes for {} entries", max_raw_len(leaf.entries), leaf.entries);
            return Err(Violation::new("D2", expected, leaf.raw_len));
        }
        let mut unpacker = Unpacker::new();
        let len = unpacker.unpack(stored, leaf.raw_len as usize, "D2")?.len();
        if len != leaf.raw_len as usize {
            return Err(Violation::new("D2", format!("{} bytes in the frame", leaf.raw_len), len));
        }
        Ok(unpacker.into_content())
    }

    /// Returns the bytes of all overview levels, finest first, with their table last; `None` without levels. Fetching
    /// the end of this range yields the table and the coarsest levels at once.
    pub fn levels_section(&self) -> Option<Range<u64>> {
        Some(self.header.levels_offset()..self.levels_range()?.end)
    }

    /// Returns the bytes of the table of overview levels: at most 300 kB, usually a few hundred bytes. `None` without
    /// levels.
    pub fn levels_range(&self) -> Option<Range<u64>> {
        let levels = self.header.levels.filter(|levels| levels.count > 0)?;
        let end = self.header.directory_offset();
        Some(end - u64::from(levels.table_len)..end)
    }

    /// Decodes the overview levels, finest first, from the bytes of [`levels_range`](Self::levels_range).
    pub fn decode_levels(&self, table: &[u8]) -> Result<Vec<Level>> {
        let at = self.levels_range().map_or(0, |range| range.start);
        decode_table(&self.header, table).map_err(|violation| violation.at("table of levels", at))
    }

    /// Returns the bytes of the metadata block: at most 1 MiB (rule H9).
    pub fn metadata_range(&self) -> Range<u64> {
        let start = self.header.metadata_offset();
        start..start + self.header.bytes.metadata
    }

    /// Decodes the coordinate reference system as the input stated it, empty if unknown, from the metadata block.
    pub fn decode_crs(&self, metadata: &[u8]) -> Result<String> {
        Ok(self.decode_metadata(metadata)?.crs)
    }

    /// Decodes the units of the inputs, ascending and without duplicates, from the metadata block; empty if unknown.
    pub fn decode_units(&self, metadata: &[u8]) -> Result<Vec<LengthUnit>> {
        Ok(self.decode_metadata(metadata)?.units)
    }

    pub(super) fn decode_metadata(&self, bytes: &[u8]) -> Result<Metadata> {
        let metadata = Metadata::decode(bytes, self.header.metadata_crc);
        metadata.map_err(|violation| violation.at("metadata", self.header.metadata_offset()))
    }
}
