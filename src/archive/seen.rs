//! Seen space: a section with one block for each tile column and 64 layers in which a scanner saw something (chapter
//! 15).
//!
//! The section ends the pages section, so that readers that do not know it need not skip it: blocks, the table that
//! locates them, and a trailer. [`SeenTable`] reads table and trailer, [`Archive::seen_space`] everything.

use super::directory::key_in_grid;
use super::head::{Header, SEEN};
use super::reader::Archive;
use crate::bytes::{ByteSource, crc};
use crate::codec::{ByteReader, Packer, Unpacker, Violation, put_varint, unzigzag, zigzag};
use crate::frame::PageKey;
use crate::seen::{SeenBlock, SeenPage, SeenSpace};
use crate::{Error, Result};
use std::ops::Range;

/// First bytes of the trailer.
const MAGIC: [u8; 8] = [0x89, 0x53, 0x45, 0x45, 0x0D, 0x0A, 0x1A, 0x0A];
/// Bytes of the trailer.
const TRAILER: u64 = 40;
/// Most blocks in an archive.
pub(super) const MAX_BLOCKS: usize = 1 << 20;
/// Largest content of a block (bytes).
const MAX_BLOCK: usize = 16 + 64 * SeenPage::BYTES;
/// Largest stored block (bytes): content that does not compress.
const MAX_STORED_BLOCK: u64 = MAX_BLOCK as u64 + 4096;
/// Largest entry of the table before compression (bytes).
const MAX_ENTRY: usize = 10 + 5 + 1 + 4 + 4;

/// Place of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SeenEntry {
    /// Key of the block.
    pub key: PageKey,
    offset: u64,
    len: u32,
    crc: u32,
    /// Pages that were seen in part.
    pages: u8,
}

/// Returns the checksum of a block: CRC32C of its key, then its bytes.
fn block_crc(key: PageKey, bytes: &[u8]) -> u32 {
    let key = [key.tx, key.ty, key.layer].map(i32::to_le_bytes);
    crc::crc32c_append(crc::crc32c(key.as_flattened()), bytes)
}

/// Writes the section. Memory: 40 bytes for each block.
#[derive(Debug)]
pub(super) struct SeenWriter {
    entries: Vec<SeenEntry>,
    cells: u64,
    len: u64,
    packer: Packer,
    raw: Vec<u8>,
    stored: Vec<u8>,
}

impl SeenWriter {
    pub fn new() -> Self {
        let (entries, raw, stored) = (Vec::new(), Vec::new(), Vec::new());
        Self { entries, cells: 0, len: 0, packer: Packer::new(), raw, stored }
    }

    /// Passes the bytes of the next block to `give`. Keys must ascend, and something must have been seen.
    pub fn add(&mut self, block: &SeenBlock, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let key = block.key;
        let bottom = PageKey { layer: key.layer.saturating_mul(64), ..key };
        if self.entries.last().is_some_and(|last| last.key >= key) || !key_in_grid(bottom) || block.is_empty() {
            let reason = "blocks of seen space have cells, and ascending keys in the grid";
            return Err(Error::parameter(format!("block {key}"), reason));
        }
        if self.entries.len() == MAX_BLOCKS {
            let what = "tile columns with seen space (use larger pixels)";
            return Err(Error::limit(what, "more", MAX_BLOCKS));
        }
        self.raw.clear();
        self.raw.extend(block.full.to_le_bytes());
        self.raw.extend(block.mixed.to_le_bytes());
        block.pages.iter().for_each(|page| page.encode(&mut self.raw));
        self.stored.clear();
        self.packer.pack(&self.raw, &mut self.stored);
        let (len, crc) = (self.stored.len() as u32, block_crc(key, &self.stored));
        self.entries.push(SeenEntry { key, offset: self.len, len, crc, pages: block.pages.len() as u8 });
        self.cells += block.cells();
        self.len += u64::from(len);
        give(&self.stored)
    }

    /// Passes table and trailer to `give`. Returns the number of cells, and of bytes of the section.
    pub fn finish(mut self, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<(u64, u64)> {
        self.raw.clear();
        let (mut column, mut group) = (0, 0);
        for SeenEntry { key, .. } in &self.entries {
            put_varint(&mut self.raw, key.column() - column);
            column = key.column();
        }
        for SeenEntry { key, .. } in &self.entries {
            put_varint(&mut self.raw, zigzag(i64::from(key.layer) - group));
            group = i64::from(key.layer);
        }
        self.raw.extend(self.entries.iter().map(|entry| entry.pages));
        self.entries.iter().for_each(|entry| put_varint(&mut self.raw, entry.len.into()));
        self.entries.iter().for_each(|entry| self.raw.extend(entry.crc.to_le_bytes()));
        self.stored.clear();
        self.packer.pack(&self.raw, &mut self.stored);
        let (table_len, table_crc) = (self.stored.len(), crc::crc32c(&self.stored));
        self.stored.extend(MAGIC);
        let len = self.len + table_len as u64 + TRAILER;
        self.stored.extend(len.to_le_bytes());
        self.stored.extend(self.cells.to_le_bytes());
        self.stored.extend((self.entries.len() as u32).to_le_bytes());
        self.stored.extend((table_len as u32).to_le_bytes());
        self.stored.extend(table_crc.to_le_bytes());
        self.stored.extend(crc::crc32c(&self.stored[table_len..]).to_le_bytes());
        give(&self.stored)?;
        Ok((self.cells, len))
    }
}

/// Where the seen space of an archive lies, and how much there is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeenTable {
    /// Cells that were seen, as the archive states.
    cells: u64,
    /// The section (byte offsets).
    range: Range<u64>,
    entries: Vec<SeenEntry>,
}

impl SeenTable {
    /// Returns the number of cells of 4 × 4 pixels and one slice that were seen.
    pub fn cells(&self) -> u64 {
        self.cells
    }

    /// Returns the length of the section (bytes).
    pub fn bytes(&self) -> u64 {
        self.range.end - self.range.start
    }

    /// Returns where the section begins (byte offset).
    pub(super) fn start(&self) -> u64 {
        self.range.start
    }

    pub(super) fn entries(&self) -> &[SeenEntry] {
        &self.entries
    }

    /// Returns the memory that the seen space takes (bytes).
    fn memory(&self) -> u64 {
        let pages: u64 = self.entries.iter().map(|entry| u64::from(entry.pages)).sum();
        pages * SeenPage::BYTES as u64 + 64 * self.entries.len() as u64
    }

    /// Reads trailer and table of the archive with this header (rules V1 and V2). `None` if it has no seen space.
    fn read(source: &dyn ByteSource, header: &Header) -> Result<Option<Self>> {
        if header.features_optional & SEEN == 0 || header.level > 0 {
            return Ok(None);
        }
        let (first, end) = (header.pages_offset(), header.colours_offset());
        let at = end.saturating_sub(TRAILER).max(first);
        let mut bytes = vec![0; (end - at) as usize];
        source.read_at(at, &mut bytes)?;
        let trailer = Trailer::decode(&bytes, end - first).map_err(|broken| broken.at("trailer of seen space", at))?;
        let (start, table_at) = (end - trailer.len, at - u64::from(trailer.table_len));
        bytes.resize(trailer.table_len as usize, 0);
        source.read_at(table_at, &mut bytes)?;
        let entries = trailer.table(&bytes, start, table_at);
        let entries = entries.map_err(|broken| broken.at("table of seen space", table_at))?;
        Ok(Some(Self { cells: trailer.cells, range: start..end, entries }))
    }
}

/// Numbers of the trailer.
struct Trailer {
    len: u64,
    cells: u64,
    blocks: u32,
    table_len: u32,
    table_crc: u32,
}

impl Trailer {
    /// Checks rule V1; the section must lie within `most` bytes.
    fn decode(bytes: &[u8], most: u64) -> Result<Self, Violation> {
        let wrong = |expected: &str, found: String| Violation::new("V1", expected, found);
        let (Some(fields), Some(&MAGIC)) = (bytes.get(..TRAILER as usize - 4), bytes.first_chunk()) else {
            return Err(wrong("the trailer's magic", format!("{:02x?}", &bytes[..bytes.len().min(8)])));
        };
        let mut reader = ByteReader::new(&bytes[MAGIC.len()..], "V1");
        let (len, cells, blocks) = (reader.u64()?, reader.u64()?, reader.u32()?);
        let (table_len, table_crc, crc) = (reader.u32()?, reader.u32()?, reader.u32()?);
        if crc != crc::crc32c(fields) {
            return Err(wrong("the trailer's checksum", format!("{crc:08x}")));
        }
        let least = TRAILER + u64::from(table_len) + u64::from(blocks);
        let fits = table_len > 0 && (least..=most).contains(&len) && blocks as usize <= MAX_BLOCKS;
        match fits && u64::from(table_len) <= MAX_BLOCKS as u64 * MAX_ENTRY as u64 {
            true => Ok(Self { len, cells, blocks, table_len, table_crc }),
            false => Err(wrong("lengths that fit", format!("{len} bytes, {blocks} blocks, a table of {table_len}"))),
        }
    }

    /// Checks rule V2 of the table `stored`; blocks lie from `offset` up to `end`.
    fn table(&self, stored: &[u8], mut offset: u64, end: u64) -> Result<Vec<SeenEntry>, Violation> {
        let wrong = |expected: &str, found: String| Violation::new("V2", expected, found);
        let crc = crc::crc32c(stored);
        if crc != self.table_crc {
            return Err(wrong("the checksum of the trailer", format!("{crc:08x}")));
        }
        let mut unpacker = Unpacker::new();
        let count = self.blocks as usize;
        let raw = unpacker.unpack(stored, count * MAX_ENTRY, "V2")?;
        let mut reader = ByteReader::new(raw, "V2");
        // Each block takes some bytes of the content, so the content bounds what they take here.
        let (mut columns, mut groups) = (Vec::new(), Vec::new());
        let (mut column, mut group) = (0u64, 0i64);
        for _ in 0..count {
            column = column.checked_add(reader.varint()?).ok_or_else(|| wrong("columns of 64 bits", "more".into()))?;
            columns.push(column);
        }
        for _ in 0..count {
            group = group.saturating_add(unzigzag(reader.varint()?));
            groups.push(group);
        }
        let pages = reader.take(count)?;
        let mut entries: Vec<SeenEntry> = Vec::with_capacity(count);
        for ((column, group), &pages) in columns.into_iter().zip(groups).zip(pages) {
            let group = i32::try_from(group).ok().filter(|group| group.checked_mul(64).is_some());
            let key = group.map(|group| PageKey::from_column(column, group));
            let key = key.filter(|key| key_in_grid(PageKey { layer: key.layer * 64, ..*key }));
            let key = key.filter(|&key| entries.last().is_none_or(|last| last.key < key));
            let Some(key) = key.filter(|_| pages <= 64) else {
                return Err(wrong("ascending keys in the grid, at most 64 pages", format!("block {}", entries.len())));
            };
            entries.push(SeenEntry { key, offset: 0, len: 0, crc: 0, pages });
        }
        for entry in &mut entries {
            let len = reader.varint()?;
            if len == 0 || len > MAX_STORED_BLOCK {
                return Err(wrong("blocks of 1 to 135184 bytes", len.to_string()));
            }
            (entry.offset, entry.len) = (offset, len as u32);
            offset += len;
        }
        for entry in &mut entries {
            entry.crc = reader.u32()?;
        }
        match reader.is_empty() && offset == end {
            true => Ok(entries),
            false => Err(wrong("blocks that fill the section", format!("{offset} in place of {end}"))),
        }
    }
}

/// Reads the blocks of an archive in turn.
pub(super) struct SeenReader<'a> {
    archive: &'a Archive,
    unpacker: Unpacker,
    bytes: Vec<u8>,
}

impl<'a> SeenReader<'a> {
    pub fn new(archive: &'a Archive) -> Self {
        Self { archive, unpacker: Unpacker::new(), bytes: Vec::new() }
    }

    /// Reads the block of `entry` (rule V3).
    pub fn block(&mut self, entry: &SeenEntry) -> Result<SeenBlock> {
        self.bytes.resize(entry.len as usize, 0);
        self.archive.source().read_at(entry.offset, &mut self.bytes)?;
        self.decode(entry).map_err(|broken| broken.at(format!("seen space of block {}", entry.key), entry.offset))
    }

    fn decode(&mut self, entry: &SeenEntry) -> Result<SeenBlock, Violation> {
        let crc = block_crc(entry.key, &self.bytes);
        if crc != entry.crc {
            return Err(Violation::new("V3", format!("checksum {:08x}", entry.crc), format!("{crc:08x}")));
        }
        let mut reader = ByteReader::new(self.unpacker.unpack(&self.bytes, MAX_BLOCK, "V3")?, "V3");
        let (full, mixed) = (reader.u64()?, reader.u64()?);
        if full & mixed != 0 || full | mixed == 0 || mixed.count_ones() != u32::from(entry.pages) {
            let expected = format!("{} pages seen in part, none of them entirely", entry.pages);
            return Err(Violation::new("V3", expected, format!("masks {full:016x} and {mixed:016x}")));
        }
        let mut block = SeenBlock { full, mixed, ..SeenBlock::new(entry.key) };
        for _ in 0..entry.pages {
            let page = SeenPage::decode(&reader.array()?);
            if [0, SeenPage::CELLS].contains(&page.cells()) {
                return Err(Violation::new("V3", "pages seen in part", "a page seen entirely or not at all"));
            }
            block.pages.push(page);
        }
        match reader.is_empty() {
            true => Ok(block),
            false => Err(Violation::new("V3", "no bytes after the pages", reader.len())),
        }
    }
}

impl Archive {
    /// Returns where the seen space lies; `None` if the archive was written without any. Takes two reads.
    pub fn seen_table(&self) -> Result<Option<SeenTable>> {
        SeenTable::read(self.source(), self.header())
    }

    /// Reads the seen space; `None` if the archive was written without any. Fails if it takes more than `most_bytes` in
    /// memory.
    pub fn seen_space(&self, most_bytes: u64) -> Result<Option<SeenSpace>> {
        let Some(table) = self.seen_table()? else { return Ok(None) };
        if table.memory() > most_bytes {
            return Err(Error::limit("memory for the seen space of the archive (bytes)", table.memory(), most_bytes));
        }
        let (mut space, mut reader) = (SeenSpace::new(*self.frame()), SeenReader::new(self));
        for entry in &table.entries {
            let in_order = space.push(reader.block(entry)?);
            debug_assert!(in_order, "the table has ascending keys");
        }
        Ok(Some(space))
    }
}
