//! What an open archive knows without its pages: where leaves and metadata lie, and what their bytes say.
//!
//! In: bytes that the caller fetched. Out: entries of pages, metadata. No reads, and no state.

use super::colours::{ColourHead, LevelColours};
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

/// The head of an archive: header and root directory. What it names is fetched by its range and decoded here;
/// pages by their [`extent`](PageEntry::extent) and a [`PageDecoder`](super::PageDecoder).
///
/// Memory: at most 512 leaves of 48 bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct Catalog {
    header: Header,
    leaves: Vec<Leaf>,
    ignores_inferred: bool,
    /// Where colours lie.
    pub(super) colours: Option<Range<u64>>,
    /// Of a level: where it is told where its colours lie, as long as that is not known.
    pub(super) level_colours: Option<LevelColours>,
}

impl Catalog {
    pub(super) fn new(header: Header, leaves: Vec<Leaf>) -> Self {
        let colours = header.colours.map(|_| header.colours_offset()..header.levels_offset());
        Self { header, leaves, ignores_inferred: false, colours, level_colours: None }
    }

    /// That of a level, of which the archive says that it has colours, if it does.
    pub(super) fn of_level(header: Header, leaves: Vec<Leaf>, level_colours: Option<LevelColours>) -> Self {
        Self { level_colours, ..Self::new(header, leaves) }
    }

    /// That of a level whose colours lie in `range`.
    pub(super) fn with_colours_at(&self, head: ColourHead, range: Range<u64>) -> Self {
        let mut catalog = Self { colours: Some(range), level_colours: None, ..self.clone() };
        catalog.header.colours = Some(head);
        catalog
    }

    /// That of a level without its colours.
    pub(super) fn without_level_colours(&self) -> Self {
        Self { level_colours: None, ..self.clone() }
    }

    /// The same, of which archives, stores, loaders and streams give pages without inferred matter: what was scanned and nothing
    /// else (guarantee G2). Header, directory and overview levels stay as they are.
    pub fn ignoring_inferred(self) -> Self {
        Self { ignores_inferred: true, ..self }
    }

    /// Whether pages come without inferred matter.
    pub fn ignores_inferred(&self) -> bool {
        self.ignores_inferred
    }

    /// The same with inferred matter.
    pub(super) fn whole(&self) -> Self {
        Self { ignores_inferred: false, ..self.clone() }
    }

    /// What the head says about the whole.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Number of directory leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaves.len()
    }

    /// The leaf whose entries could include `key`.
    pub fn leaf_of(&self, key: PageKey) -> Option<usize> {
        self.leaves.partition_point(|leaf| leaf.first <= key).checked_sub(1)
    }

    /// Key of the first entry of leaf `index`.
    pub fn leaf_first(&self, index: usize) -> PageKey {
        self.leaves[index].first
    }

    /// Where the bytes of leaf `index` lie, within the directory section (rule R4). Leaves lie one behind the other.
    pub fn leaf_range(&self, index: usize) -> Range<u64> {
        let leaf = &self.leaves[index];
        let start = self.header.directory_offset() + leaf.offset;
        start..start + u64::from(leaf.stored_len)
    }

    /// Number of entries of leaf `index`, at most 2²⁰.
    pub fn leaf_entries(&self, index: usize) -> u32 {
        self.leaves[index].entries
    }

    /// Entries of leaf `index`, ascending, from `stored`, the bytes of its range. Breaks of rules D1 to D11 are errors.
    /// Memory besides the result: at most 47 bytes an entry.
    pub fn decode_leaf(&self, index: usize, stored: &[u8]) -> Result<Vec<PageEntry>> {
        self.open_leaf(index, stored)?.collect()
    }

    /// As [`decode_leaf`](Self::decode_leaf), entry by entry. A rule may turn out to be broken after some of them.
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

    /// Where all overview levels lie, the finest first, their table last; `None` if there are none. A program that fetches the
    /// end of it gets the table and the coarsest levels at once.
    pub fn levels_section(&self) -> Option<Range<u64>> {
        Some(self.header.levels_offset()..self.levels_range()?.end)
    }

    /// Where the table of overview levels lies: at most 300 kB, mostly some hundred bytes; `None` if there are no levels.
    pub fn levels_range(&self) -> Option<Range<u64>> {
        let levels = self.header.levels.filter(|levels| levels.count > 0)?;
        let end = self.header.directory_offset();
        Some(end - u64::from(levels.table_len)..end)
    }

    /// The overview levels, finest first, from the bytes of [`levels_range`](Self::levels_range).
    pub fn decode_levels(&self, table: &[u8]) -> Result<Vec<Level>> {
        let at = self.levels_range().map_or(0, |range| range.start);
        decode_table(&self.header, table).map_err(|violation| violation.at("table of levels", at))
    }

    /// Where the metadata block lies: at most 1 MiB (rule H9).
    pub fn metadata_range(&self) -> Range<u64> {
        let start = self.header.metadata_offset();
        start..start + self.header.bytes.metadata
    }

    /// The coordinate reference system as the input stated it, empty if unknown, from the bytes of the metadata block.
    pub fn decode_crs(&self, metadata: &[u8]) -> Result<String> {
        Ok(self.decode_metadata(metadata)?.crs)
    }

    /// The units in which the inputs came, ascending and each once, from the bytes of the metadata block; none if unknown.
    pub fn decode_units(&self, metadata: &[u8]) -> Result<Vec<LengthUnit>> {
        Ok(self.decode_metadata(metadata)?.units)
    }

    pub(super) fn decode_metadata(&self, bytes: &[u8]) -> Result<Metadata> {
        let metadata = Metadata::decode(bytes, self.header.metadata_crc);
        metadata.map_err(|violation| violation.at("metadata", self.header.metadata_offset()))
    }
}
