//! Colours: a section with one block for each page that has coloured voxels (chapter 10).
//!
//! The section holds the blocks in page order, then one *colour leaf* for each directory leaf, which locates the blocks
//! of its pages, then a table of these leaves. Collision queries never read it. [`ColourReader`] reads colours page by
//! page; a program that fetches bytes itself asks a [`Catalog`](super::Catalog) where they lie.
//!
//! Colours of overview levels precede those of the archive: first a table that locates each level's colours, then one
//! part for each level, coarsest first, with the same layout as the section.

use super::catalog::Catalog;
use super::directory::PageEntry;
use super::head::{MAX_LEAF_ENTRIES, MAX_LEAVES};
use super::levels::{CoarseColour, MAX_LEVELS, coarse_colours};
use super::page_coding::PageDecoder;
use super::reader::Archive;
use super::spill::Spool;
use crate::bytes::crc;
use crate::codec::{ByteReader, ColourBlock, ColourEncoder, MAX_COLOUR_BLOCK, Packer, Unpacker, Violation, put_varint};
use crate::colour::ColourPlan;
use crate::disk::Files;
use crate::frame::PageKey;
use crate::page::{Colours, Occupancy, Page};
use crate::{Error, Result};
use std::ops::Range;
use std::path::Path;

/// Bytes of a leaf's record in the table.
pub(super) const LEAF_RECORD: usize = 12;
/// Largest entry of a leaf before compression (bytes).
const MAX_ENTRY: u64 = 5 + 4;
/// Bytes of an entry while an archive is written: length and checksum.
const ENTRY: usize = 8;
/// Bytes of a record in the table of level colours, and of the checksum after the records.
const LEVEL_RECORD: u64 = 20;
const LEVEL_CRC: u64 = 4;

/// Colour fields of the head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourHead {
    /// How the colours were made.
    pub plan: ColourPlan,
    /// Voxels with a colour.
    pub voxels: u64,
    /// CRC32C of the table of colour leaves.
    pub(super) table_crc: u32,
}

/// Encoded colours of a page; empty if no voxel has one.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EncodedColours {
    pub(super) bytes: Vec<u8>,
    pub(super) voxels: u64,
    /// Contribution to overview levels, if there are to be any.
    pub(super) coarse: Option<Box<[CoarseColour]>>,
}

impl EncodedColours {
    /// Encodes exact colours (16 bits a channel) of a page's voxels, in the order of `occupancy`, as `plan` says.
    pub fn new(
        plan: &ColourPlan,
        occupancy: &Occupancy,
        colours: &[Option<[u16; 3]>],
        encoder: &mut ColourEncoder,
    ) -> Self {
        match ColourBlock::quantise(colours, plan.error_milli, encoder) {
            Some(block) => Self::of_block(block, occupancy, encoder),
            None => Self::default(),
        }
    }

    /// Encodes a block without quantising it again.
    pub(super) fn of_block(mut block: ColourBlock, occupancy: &Occupancy, encoder: &mut ColourEncoder) -> Self {
        let mut bytes = Vec::new();
        block.encode(occupancy, encoder, &mut bytes);
        let coarse = encoder.is_for_levels().then(|| coarse_colours(occupancy, block.rgb()));
        Self { voxels: block.count(), bytes, coarse }
    }
}

/// Returns the checksum of a block: CRC32C of its page's key followed by its bytes.
fn block_crc(key: PageKey, bytes: &[u8]) -> u32 {
    let key = [key.tx, key.ty, key.layer].map(i32::to_le_bytes);
    crc::crc32c_append(crc::crc32c(key.as_flattened()), bytes)
}

/// Colours of an archive that is being written, buffered until its pages are complete.
///
/// Memory: 512 KiB; the rest waits in temporary files beside the archive.
#[derive(Debug)]
pub(super) struct ColourWriter {
    pub plan: ColourPlan,
    blocks: Spool,
    entries: Spool,
    voxels: u64,
}

impl ColourWriter {
    /// Creates a writer whose temporary files lie beside `target`.
    pub fn new(plan: ColourPlan, files: &Files, target: &Path) -> Self {
        Self { plan, blocks: Spool::new(files, target), entries: Spool::new(files, target), voxels: 0 }
    }

    /// Adds the colours of the next page.
    pub fn add(&mut self, key: PageKey, colours: &EncodedColours) -> Result<()> {
        let mut entry = [0; ENTRY];
        if !colours.bytes.is_empty() {
            entry[..4].copy_from_slice(&(colours.bytes.len() as u32).to_le_bytes());
            entry[4..].copy_from_slice(&block_crc(key, &colours.bytes).to_le_bytes());
            self.blocks.push(&colours.bytes)?;
            self.voxels += colours.voxels;
        }
        self.entries.push(&entry)
    }

    /// Passes all bytes of the section after its first `base` to `give`, in order; each directory leaf but the last has
    /// `leaf_entries` entries. Returns the colour fields of the head and the number of bytes passed.
    pub fn finish(
        self,
        leaf_entries: u32,
        mut base: u64,
        give: &mut dyn FnMut(&[u8]) -> Result<()>,
    ) -> Result<(ColourHead, u64)> {
        let mut len = self.blocks.len();
        self.blocks.read(give)?;
        let (mut table, mut packer) = (Vec::new(), Packer::new());
        let mut entries: Vec<u8> = Vec::new();
        let mut leaf = |entries: &[u8], give: &mut dyn FnMut(&[u8]) -> Result<()>| -> Result<()> {
            let (raw, mut stored) = (encode_leaf(entries, &mut base), Vec::new());
            packer.pack(&raw, &mut stored);
            for value in [stored.len() as u32, raw.len() as u32, crc::crc32c(&stored)] {
                table.extend(value.to_le_bytes());
            }
            len += stored.len() as u64;
            give(&stored)
        };
        let whole = leaf_entries as usize * ENTRY;
        self.entries.read(&mut |bytes| {
            entries.extend_from_slice(bytes);
            while entries.len() >= whole {
                leaf(&entries[..whole], give)?;
                entries.drain(..whole);
            }
            Ok(())
        })?;
        if !entries.is_empty() {
            leaf(&entries, give)?;
        }
        give(&table)?;
        let head = ColourHead { plan: self.plan, voxels: self.voxels, table_crc: crc::crc32c(&table) };
        Ok((head, len + table.len() as u64))
    }
}

/// Returns the content of a leaf: where its blocks begin, their lengths, their checksums.
fn encode_leaf(entries: &[u8], base: &mut u64) -> Vec<u8> {
    let (entries, _) = entries.as_chunks::<ENTRY>();
    let len = |entry: &[u8; ENTRY]| u32::from_le_bytes([entry[0], entry[1], entry[2], entry[3]]);
    let mut raw = Vec::new();
    put_varint(&mut raw, *base);
    for entry in entries {
        put_varint(&mut raw, u64::from(len(entry)));
        *base += u64::from(len(entry));
    }
    entries.iter().filter(|entry| len(entry) > 0).for_each(|entry| raw.extend(&entry[4..]));
    raw
}

/// Colours of a level as they were written.
pub(super) struct LevelPart {
    pub head: ColourHead,
    /// Length of the part (bytes).
    pub len: u64,
}

/// Encodes the table of level colours, finest first.
pub(super) fn encode_level_colours(levels: &[LevelPart]) -> Vec<u8> {
    let mut table = Vec::new();
    for LevelPart { head, len } in levels {
        table.extend(len.to_le_bytes());
        table.extend(head.voxels.to_le_bytes());
        table.extend(head.table_crc.to_le_bytes());
    }
    table.extend(crc::crc32c(&table).to_le_bytes());
    table
}

/// Table that locates the colours of levels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LevelColours {
    count: u32,
    /// Where the table begins, and the limit for the end of the parts (byte offsets).
    start: u64,
    end: u64,
    plan: ColourPlan,
}

impl LevelColours {
    /// Describes the table of `count` levels, which begins at byte `start`; the parts end at byte `end` at the latest.
    pub fn new(count: u32, start: u64, end: u64, plan: ColourPlan) -> Self {
        Self { count, start, end, plan }
    }

    /// Returns the bytes of the table.
    pub fn table(&self) -> Range<u64> {
        self.start..self.start + LEVEL_CRC + LEVEL_RECORD * u64::from(self.count)
    }

    /// Decodes the table: one record for each level, finest first. The parts lie coarsest first (rule K11).
    pub fn decode(&self, bytes: &[u8]) -> Result<Vec<LevelPlace>> {
        self.decoded(bytes).map_err(|violation| violation.at("table of colours of levels", self.start))
    }

    fn decoded(&self, bytes: &[u8]) -> Result<Vec<LevelPlace>, Violation> {
        let wrong = |found: String| {
            Violation::new("K11", format!("{} levels and the checksum of what is said of them", self.count), found)
        };
        let (records, crc) = bytes.split_last_chunk::<4>().ok_or_else(|| wrong(format!("{} bytes", bytes.len())))?;
        let found = crc::crc32c(records);
        if bytes.len() as u64 != self.table().end - self.start || found != u32::from_le_bytes(*crc) {
            return Err(wrong(format!("{} bytes of checksum {found:08x}", bytes.len())));
        }
        let mut reader = ByteReader::new(records, "K11");
        let (mut told, mut end) = (Vec::with_capacity(MAX_LEVELS), self.table().end);
        for _ in 0..self.count {
            let (len, voxels, table_crc) = (reader.u64()?, reader.u64()?, reader.u32()?);
            told.push(LevelPlace { head: ColourHead { plan: self.plan, voxels, table_crc }, range: 0..len });
        }
        // The coarsest level lies first.
        for LevelPlace { range, .. } in told.iter_mut().rev() {
            let outside = || Violation::new("K11", format!("colours of levels up to byte {}", self.end), "some beyond");
            let next = end.checked_add(range.end).filter(|&next| next <= self.end).ok_or_else(outside)?;
            *range = end..next;
            end = next;
        }
        Ok(told)
    }
}

/// Colours of one level and where they lie.
#[derive(Debug, Clone)]
pub(super) struct LevelPlace {
    pub head: ColourHead,
    pub range: Range<u64>,
}

/// Where the colours of a page lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourEntry {
    /// First byte (offset from the start of the archive).
    pub offset: u64,
    /// Length (bytes); 0 if no voxel of the page has a colour.
    pub len: u32,
    /// CRC32C of the page's key and the block.
    pub(super) crc: u32,
}

impl ColourEntry {
    /// Returns the bytes of the block.
    pub fn range(&self) -> Range<u64> {
        self.offset..self.offset + u64::from(self.len)
    }

    /// Decodes the block of page `key`, whose voxels are those of `occupancy`, from its bytes (rules K4 to K7).
    pub(super) fn block(&self, key: PageKey, occupancy: &Occupancy, bytes: &[u8]) -> Result<ColourBlock, Violation> {
        let crc = block_crc(key, bytes);
        if bytes.len() != self.len as usize || crc != self.crc {
            let expected = format!("{} bytes of checksum {:08x}", self.len, self.crc);
            return Err(Violation::new("K4", expected, format!("{} of {crc:08x}", bytes.len())));
        }
        ColourBlock::decode(bytes, occupancy)
    }

    /// Decodes the colours of page `key` from the bytes of their [`range`](Self::range). `page` must include inferred
    /// spans, if the archive has any ([`Catalog::ignores_inferred`]). [`Format`](Error::Format) errors name the broken
    /// rule.
    pub fn decode(&self, key: PageKey, page: &Page, bytes: &[u8]) -> Result<Colours> {
        let occupancy = Occupancy::of(page);
        if self.len == 0 {
            let none = vec![[0; 4]; occupancy.len()];
            return Ok(Colours::new(occupancy, none).unwrap_or_default());
        }
        let block = self.block(key, &occupancy, bytes).map_err(|violation| self.broken(key, violation))?;
        Ok(block.colours(occupancy).unwrap_or_default())
    }

    fn broken(&self, key: PageKey, violation: Violation) -> Error {
        violation.at(format!("colours of page {key}"), self.offset)
    }
}

/// Table of an archive's colour leaves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColourTable {
    leaves: Vec<ColourLeaf>,
}

/// Record of a colour leaf in the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ColourLeaf {
    offset: u64,
    stored_len: u32,
    raw_len: u32,
    crc: u32,
}

impl ColourTable {
    /// Returns the bytes of the colour leaf that belongs to directory leaf `index`.
    pub fn leaf_range(&self, index: usize) -> Range<u64> {
        let leaf = &self.leaves[index];
        leaf.offset..leaf.offset + u64::from(leaf.stored_len)
    }
}

impl Catalog {
    /// Returns the bytes of all colours, including those of overview levels; `None` if the archive has none. For a
    /// level, returns its own colours, and only after [`with_level_colours`](Self::with_level_colours).
    pub fn colours_section(&self) -> Option<Range<u64>> {
        self.colours.clone()
    }

    /// Returns the bytes, at most 324, of the table that locates the colours of this overview level. `None` if it has
    /// no colours or the table was [decoded](Self::with_level_colours).
    pub fn level_colours_range(&self) -> Option<Range<u64>> {
        self.level_colours.as_ref().map(LevelColours::table)
    }

    /// Returns this overview level with its colours located, from the bytes of
    /// [`level_colours_range`](Self::level_colours_range) (rule K11).
    pub fn with_level_colours(&self, table: &[u8]) -> Result<Self> {
        let Some(place) = &self.level_colours else { return Ok(self.clone()) };
        let told = place.decode(table)?;
        let number = self.header().level;
        let own = (number as usize).checked_sub(1).and_then(|at| told.get(at).cloned());
        let least = (self.leaf_count() * LEAF_RECORD) as u64;
        match own {
            Some(LevelPlace { head, range }) if range.end - range.start >= least => {
                Ok(self.with_colours_at(head, range))
            }
            _ => {
                let violation = Violation::new("K11", format!("colours of {least} bytes or more"), "fewer");
                Err(violation.at(format!("colours of level {number}"), place.start))
            }
        }
    }

    /// Returns the bytes, at most 6 KiB, of the table of colour leaves; `None` without a
    /// [`colours_section`](Self::colours_section).
    pub fn colour_table_range(&self) -> Option<Range<u64>> {
        let end = self.colours_section()?.end;
        Some(end - (self.leaf_count() * LEAF_RECORD) as u64..end)
    }

    /// Decodes the table from the bytes of its range (rule K2).
    pub fn decode_colour_table(&self, bytes: &[u8]) -> Result<ColourTable> {
        let at = self.colour_table_range().map_or(0, |range| range.start);
        self.colour_table(bytes).map_err(|violation| violation.at("table of colours", at))
    }

    fn colour_table(&self, bytes: &[u8]) -> Result<ColourTable, Violation> {
        let (Some(head), Some(range)) = (self.header().colours, self.colour_table_range()) else {
            return Err(Violation::new("K2", "an archive with colours", "one without"));
        };
        let crc = crc::crc32c(bytes);
        if bytes.len() as u64 != range.end - range.start || crc != head.table_crc {
            return Err(Violation::new("K2", format!("checksum {:08x}", head.table_crc), format!("{crc:08x}")));
        }
        let mut reader = ByteReader::new(bytes, "K2");
        let mut leaves = Vec::with_capacity(self.leaf_count());
        for index in 0..self.leaf_count() {
            let [stored_len, raw_len, crc] = [reader.u32()?, reader.u32()?, reader.u32()?];
            let most = max_raw_len(self.leaf_entries(index));
            if u64::from(raw_len) > most {
                return Err(Violation::new("K2", format!("colour leaves of at most {most} bytes"), raw_len));
            }
            leaves.push(ColourLeaf { offset: 0, stored_len, raw_len, crc });
        }
        // Leaves are contiguous and end where the table begins.
        let section = self.colours_start();
        let mut end = range.start;
        for leaf in leaves.iter_mut().rev() {
            let start = end.checked_sub(u64::from(leaf.stored_len)).filter(|&start| start >= section);
            end = start.ok_or_else(|| Violation::new("K2", "colour leaves inside their section", leaf.stored_len))?;
            leaf.offset = end;
        }
        Ok(ColourTable { leaves })
    }

    /// Decodes where the blocks of the pages of directory leaf `index` lie, in the order of its entries, from the bytes
    /// of the colour leaf's range (rules K3 and K4).
    pub fn decode_colour_leaf(&self, table: &ColourTable, index: usize, stored: &[u8]) -> Result<Vec<ColourEntry>> {
        let leaf = table.leaves[index];
        self.colour_leaf(table, index, stored)
            .map_err(|violation| violation.at(format!("colour leaf {index}"), leaf.offset))
    }

    fn colour_leaf(&self, table: &ColourTable, index: usize, stored: &[u8]) -> Result<Vec<ColourEntry>, Violation> {
        let leaf = table.leaves[index];
        let crc = crc::crc32c(stored);
        if crc != leaf.crc {
            return Err(Violation::new("K3", format!("checksum {:08x}", leaf.crc), format!("{crc:08x}")));
        }
        let mut unpacker = Unpacker::new();
        let content = unpacker.unpack(stored, leaf.raw_len as usize, "K3")?;
        if content.len() != leaf.raw_len as usize {
            return Err(Violation::new("K3", format!("{} bytes in the frame", leaf.raw_len), content.len()));
        }
        let mut reader = ByteReader::new(content, "K3");
        let section = self.colours_start();
        // Blocks end where leaves begin.
        let end = table.leaves.first().map_or(section, |first| first.offset);
        let outside = || Violation::new("K4", format!("blocks in bytes {section} to {end}"), "one outside");
        let mut at = section.checked_add(reader.varint()?).filter(|&at| at <= end).ok_or_else(outside)?;
        let mut entries = Vec::with_capacity(self.leaf_entries(index) as usize);
        for _ in 0..self.leaf_entries(index) {
            let len = reader.varint()?;
            if len > MAX_COLOUR_BLOCK as u64 || len > end - at {
                return Err(outside());
            }
            entries.push(ColourEntry { offset: at, len: len as u32, crc: 0 });
            at += len;
        }
        for entry in entries.iter_mut().filter(|entry| entry.len > 0) {
            entry.crc = reader.u32()?;
        }
        if !reader.is_empty() {
            return Err(Violation::new("K3", "no byte behind the checksums", format!("{} more", reader.len())));
        }
        Ok(entries)
    }
}

impl Catalog {
    /// Returns where the colours begin (byte offset).
    fn colours_start(&self) -> u64 {
        self.colours.as_ref().map_or(0, |range| range.start)
    }
}

/// Returns the largest size of a colour leaf of `entries` entries before compression (bytes).
fn max_raw_len(entries: u32) -> u64 {
    10 + u64::from(entries) * MAX_ENTRY
}

const _: () = assert!(10 + MAX_LEAF_ENTRIES as u64 * MAX_ENTRY < u32::MAX as u64 && MAX_LEAVES * LEAF_RECORD <= 6144);

/// Reads the colours of pages. Memory: one directory leaf with its colour leaf, and one page.
#[derive(Debug)]
pub struct ColourReader {
    archive: Archive,
    table: ColourTable,
    decoder: PageDecoder,
    occupancy: Occupancy,
    bytes: Vec<u8>,
    /// Index of the loaded leaf, its keys, and where their colours lie.
    leaf: Option<(usize, Vec<(PageKey, ColourEntry)>)>,
}

impl ColourReader {
    /// Opens the colours of `archive`; `None` if it has none. Takes one read, or two for an overview level.
    pub fn new(archive: &Archive) -> Result<Option<Self>> {
        let mut archive = archive.whole();
        if let Some(range) = archive.catalog().level_colours_range() {
            let catalog = archive.catalog().with_level_colours(&read(&archive, range)?)?;
            archive = archive.with_catalog(catalog);
        }
        let Some(range) = archive.catalog().colour_table_range() else { return Ok(None) };
        let table = archive.catalog().decode_colour_table(&read(&archive, range)?)?;
        let (decoder, occupancy) = (PageDecoder::new(), Occupancy::default());
        Ok(Some(Self { archive, table, decoder, occupancy, bytes: Vec::new(), leaf: None }))
    }

    /// Reads the colours of the page of `entry`. Takes up to four reads: directory leaf and colour leaf, which are kept
    /// for the next page, the page, and its colours.
    pub fn colours(&mut self, entry: &PageEntry) -> Result<Colours> {
        let place = self.find(entry.key)?;
        let page = self.archive.page_with(entry, &mut self.decoder)?;
        self.decode(&place, entry.key, &page)
    }

    /// Like [`colours`](Self::colours), but takes an already decoded page, which must include its inferred spans.
    pub fn colours_of(&mut self, key: PageKey, page: &Page) -> Result<Colours> {
        let place = self.find(key)?;
        self.decode(&place, key, page)
    }

    fn decode(&mut self, place: &ColourEntry, key: PageKey, page: &Page) -> Result<Colours> {
        self.fetch(place)?;
        place.decode(key, page, &self.bytes)
    }

    /// Finds where the colours of page `key` lie. Takes up to two reads; fails if the archive has no such page.
    pub fn find(&mut self, key: PageKey) -> Result<ColourEntry> {
        let unknown = || Error::parameter(format!("page {key}"), "the archive has no such page");
        let index = self.archive.leaf_of(key).ok_or_else(unknown)?;
        let leaf = match self.leaf.take().filter(|leaf| leaf.0 == index) {
            Some(leaf) => leaf,
            None => {
                let keys = self.archive.leaf(index)?.into_iter().map(|entry| entry.key);
                (index, keys.zip(self.leaf_entries(index)?).collect())
            }
        };
        let (_, pages) = self.leaf.insert(leaf);
        let at = pages.binary_search_by_key(&key, |page| page.0).map_err(|_| unknown())?;
        Ok(pages[at].1)
    }

    /// Returns where the colours of the pages of directory leaf `index` lie. Takes one read.
    pub(super) fn leaf_entries(&self, index: usize) -> Result<Vec<ColourEntry>> {
        let stored = read(&self.archive, self.table.leaf_range(index))?;
        self.archive.catalog().decode_colour_leaf(&self.table, index, &stored)
    }

    /// Returns the bytes of the colours: for an archive those of its levels, which come first, and its own; for a level
    /// its own.
    pub fn bytes(&self) -> Range<u64> {
        self.archive.catalog().colours_section().unwrap_or(0..0)
    }

    /// Returns the number of coloured voxels that the archive states.
    pub(super) fn stated_voxels(&self) -> u64 {
        self.archive.header().colours.map_or(0, |colours| colours.voxels)
    }

    /// Returns where the section begins (byte offset).
    pub(super) fn start(&self) -> u64 {
        self.archive.catalog().colours_start()
    }

    /// Returns where the blocks end (byte offset).
    pub(super) fn blocks_end(&self) -> u64 {
        let first = self.table.leaves.first();
        first.map_or(self.archive.catalog().colour_table_range().map_or(0, |range| range.start), |first| first.offset)
    }

    fn fetch(&mut self, place: &ColourEntry) -> Result<()> {
        self.bytes.resize(place.len as usize, 0);
        if place.len > 0 {
            self.archive.source().read_at(place.offset, &mut self.bytes)?;
        }
        Ok(())
    }

    /// Reads the block at `place` of page `key`, whose content is `page`; `None` if it has no colours.
    pub(super) fn block(&mut self, place: &ColourEntry, key: PageKey, page: &Page) -> Result<Option<ColourBlock>> {
        if place.len == 0 {
            return Ok(None);
        }
        self.fetch(place)?;
        self.occupancy.set(page);
        let block = place.block(key, &self.occupancy, &self.bytes);
        block.map(Some).map_err(|violation| self.broken(place, key, violation))
    }

    pub(super) fn broken(&self, place: &ColourEntry, key: PageKey, violation: Violation) -> Error {
        match self.archive.header().level {
            0 => place.broken(key, violation),
            level => violation.at(format!("colours of page {key} of level {level}"), place.offset),
        }
    }

    /// Returns the voxels of the page whose block was read last.
    pub(super) fn occupancy(&self) -> &Occupancy {
        &self.occupancy
    }

    /// Returns the colours of page `key`, whose content is `page`, for another archive. Decodes them as a check.
    pub(super) fn copied(&mut self, key: PageKey, page: &Page) -> Result<EncodedColours> {
        let place = self.find(key)?;
        let Some(block) = self.block(&place, key, page)? else { return Ok(EncodedColours::default()) };
        let coarse = Some(coarse_colours(&self.occupancy, block.rgb()));
        Ok(EncodedColours { bytes: self.bytes.clone(), voxels: block.count(), coarse })
    }

    /// Returns whether the bytes of `block`, which was read last, are the canonical encoding of its content (rule K9).
    pub(super) fn is_canonical(&self, block: &mut ColourBlock, encoder: &mut ColourEncoder) -> bool {
        let mut again = Vec::with_capacity(self.bytes.len());
        block.encode(&self.occupancy, encoder, &mut again);
        again == self.bytes
    }

    /// Returns the colours of those voxels of `page` that are also in `part`, which was cut from it or edited.
    pub(super) fn part(
        &mut self,
        key: PageKey,
        page: &Page,
        part: &Page,
        encoder: &mut ColourEncoder,
    ) -> Result<EncodedColours> {
        let place = self.find(key)?;
        let Some(block) = self.block(&place, key, page)? else { return Ok(EncodedColours::default()) };
        let occupancy = Occupancy::of(part);
        let cut = block.part(&self.occupancy, &occupancy);
        Ok(cut.map_or_else(EncodedColours::default, |cut| EncodedColours::of_block(cut, &occupancy, encoder)))
    }
}

/// Reads the bytes of `range`, whose length a rule of the format bounds.
fn read(archive: &Archive, range: Range<u64>) -> Result<Vec<u8>> {
    let mut bytes = vec![0; (range.end - range.start) as usize];
    archive.source().read_at(range.start, &mut bytes)?;
    Ok(bytes)
}
