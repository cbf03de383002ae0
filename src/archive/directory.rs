//! Directory leaves: sorted entries, one per page, stored column by column (chapter 4).
//!
//! Entries come in ascending key order; a compressed leaf takes about 10 bytes per entry. Memory: one leaf, at most 2²⁰
//! entries.

use crate::codec::{ByteReader, Violation, put_varint, span_bits, span_from_bits, unzigzag, zigzag};
use crate::frame::{MAX_INDEX, PAGE_SLICES, PageKey};
use crate::page::{PageSize, Span};
use crate::{Error, Result};
use std::ops::Range;

/// Byte range of the archive with its checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Extent {
    /// First byte (offset from the start of the archive).
    pub offset: u64,
    /// Length (bytes).
    pub len: u32,
    /// CRC32C from the page's leader.
    pub crc: u32,
}

/// Where the content of a page is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Storage {
    /// In bytes of its own.
    Stored(Extent),
    /// In the bytes of an earlier page with equal content.
    Shared(Extent),
    /// In the directory: every pixel holds this one span.
    Uniform(Span),
}

/// Directory entry of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageEntry {
    /// Key of the page.
    pub key: PageKey,
    /// Slices of the page that contain solid: bit `k` for slice `64·layer + k`. Never 0.
    pub slices: u64,
    /// Size of the page in memory; always [`PageSize::UNIFORM`] for a uniform page.
    pub size: PageSize,
    /// Where its content is stored.
    pub storage: Storage,
}

/// Identity of a page's content by its directory entry: entries of equal content hold equal pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Content {
    /// Never [`Storage::Shared`]: shared bytes count as stored ones.
    storage: Storage,
    slices: u64,
    size: PageSize,
}

impl PageEntry {
    /// Returns the identity of the page's content, independent of its key.
    pub fn content(&self) -> Content {
        let storage = match self.storage {
            Storage::Shared(extent) => Storage::Stored(extent),
            storage => storage,
        };
        Content { storage, slices: self.slices, size: self.size }
    }

    /// Returns the bytes to read for the content; `None` for a uniform page, which needs no read.
    pub fn extent(&self) -> Option<Extent> {
        match self.storage {
            Storage::Stored(extent) | Storage::Shared(extent) => Some(extent),
            Storage::Uniform(_) => None,
        }
    }

    /// Returns the byte range of the content; empty for a uniform page.
    pub fn bytes(&self) -> Range<u64> {
        self.extent().map_or(0..0, |extent| extent.offset..extent.offset + u64::from(extent.len))
    }

    /// Returns the exact memory that the page takes once decoded (bytes). Decoding checks it.
    pub fn weight_bytes(&self) -> usize {
        self.size.weight_bytes(self.slices)
    }

    /// Returns the lowest and highest slice that contain solid, as grid indices.
    pub fn slice_range(&self) -> (i64, i64) {
        let floor = self.key.layer as i64 * PAGE_SLICES;
        (floor + self.slices.trailing_zeros() as i64, floor + 63 - self.slices.leading_zeros() as i64)
    }
}

/// Codes of the entry kinds.
const STORED: u8 = 0;
const SHARED: u8 = 1;
const UNIFORM: u8 = 2;

/// Smallest and largest entry before compression (bytes).
const MIN_ENTRY: usize = 1 + 1 + 1 + 4;
const MAX_ENTRY: usize = 10 + 5 + 1 + 8 + 5 + 10 + 4 + 1 + 3;

/// Largest layer and tile index; the smallest is `-MAX_TILE - 1`.
const MAX_TILE: i32 = (MAX_INDEX / PAGE_SLICES) as i32;

/// Returns the largest size of a leaf of `entries` entries before compression (bytes).
pub(super) fn max_raw_len(entries: u32) -> u64 {
    10 + entries as u64 * MAX_ENTRY as u64
}

/// Encodes a leaf before compression. `entries` are ascending and not empty; their offsets count from the start of the
/// pages section. The stored pages among them are contiguous from `base`, which advances to their end.
pub(super) fn encode_leaf(entries: &[PageEntry], base: &mut u64, out: &mut Vec<u8>) {
    out.clear();
    put_varint(out, *base);
    let mut last = entries[0].key;
    for entry in entries {
        put_varint(out, entry.key.column() - last.column());
        last = entry.key;
    }
    let mut layer = entries[0].key.layer;
    for entry in entries {
        put_varint(out, zigzag(entry.key.layer as i64 - layer as i64));
        layer = entry.key.layer;
    }
    out.extend(entries.iter().map(|entry| match entry.storage {
        Storage::Stored(_) => STORED,
        Storage::Shared(_) => SHARED,
        Storage::Uniform(_) => UNIFORM,
    }));
    let paged = || entries.iter().filter_map(|entry| Some((entry, entry.extent()?)));
    for byte in 0..8 {
        out.extend(paged().map(|(entry, _)| entry.slices.to_le_bytes()[byte]));
    }
    for (_, extent) in paged() {
        put_varint(out, extent.len as u64);
    }
    for (entry, extent) in paged() {
        match entry.storage {
            Storage::Stored(_) => *base = extent.offset + extent.len as u64,
            _ => put_varint(out, *base - extent.offset),
        }
    }
    for (_, extent) in paged() {
        out.extend(extent.crc.to_le_bytes());
    }
    out.extend(paged().map(|(entry, _)| entry.size.blocks() as u8 - 1));
    for (entry, _) in paged() {
        put_varint(out, (entry.size.words() - entry.size.blocks()) as u64);
    }
    for entry in entries {
        if let Storage::Uniform(span) = entry.storage {
            out.extend(span_bits(span).to_le_bytes());
        }
    }
}

/// Iterator over a leaf's entries, decoded directly from its columns: it takes no more memory than the leaf's bytes.
///
/// It checks each entry against rules D3 to D8 and D11, and ends after a broken rule.
#[derive(Debug)]
pub(super) struct LeafEntries {
    raw: Vec<u8>,
    leaf: LeafPlace,
    cursor: Cursor,
}

impl LeafEntries {
    /// Opens the leaf with bytes `raw`, described by `leaf`.
    pub fn new(raw: Vec<u8>, leaf: LeafPlace) -> Result<Self> {
        match Cursor::new(&raw, &leaf) {
            Ok(cursor) => Ok(Self { raw, leaf, cursor }),
            Err(violation) => Err(leaf.broken(violation)),
        }
    }

    /// Checks all remaining entries and returns the archive bytes of the leaf's stored pages.
    pub fn check(&self) -> Result<Range<u64>> {
        let mut cursor = self.cursor.clone();
        while cursor.next(&self.raw, &self.leaf).map_err(|violation| self.leaf.broken(violation))?.is_some() {}
        let start = self.leaf.pages.start;
        Ok(start + self.cursor.next..start + cursor.next)
    }
}

impl Iterator for LeafEntries {
    type Item = Result<PageEntry>;

    fn next(&mut self) -> Option<Self::Item> {
        let entry = self.cursor.next(&self.raw, &self.leaf);
        entry.map_err(|violation| self.leaf.broken(violation)).transpose()
    }
}

/// Description of a leaf by the rest of the archive.
#[derive(Debug, Clone)]
pub(super) struct LeafPlace {
    /// Index of the leaf, and its byte offset in the archive.
    pub index: usize,
    pub offset: u64,
    pub entries: u32,
    /// Key of the first entry.
    pub first: PageKey,
    /// Key of the next leaf's first entry.
    pub end: Option<PageKey>,
    /// Bytes of the pages section in the archive.
    pub pages: Range<u64>,
}

impl LeafPlace {
    /// Returns the error for a rule that the leaf breaks.
    pub fn broken(&self, violation: Violation) -> Error {
        violation.at(format!("directory leaf {}", self.index), self.offset)
    }
}

/// Position in each column of a leaf.
#[derive(Debug, Clone)]
struct Cursor {
    /// Offset of the next stored page from the start of the pages section (bytes).
    next: u64,
    /// Number of entries already returned, and how many of them have bytes.
    given: usize,
    given_paged: usize,
    /// Entries with bytes, in the whole leaf.
    paged: usize,
    last: Option<(u64, PageKey)>,
    columns: Column,
    layers: Column,
    kinds: usize,
    masks: usize,
    lengths: Column,
    distances: Column,
    checksums: usize,
    blocks: usize,
    words: Column,
    spans: usize,
}

/// Remaining bytes of a column of varints.
#[derive(Debug, Clone, Copy)]
struct Column {
    at: usize,
    end: usize,
}

impl Column {
    /// Finds the column of `count` varints that begins at `at` and ends before `end`.
    fn of(raw: &[u8], at: usize, end: usize, count: usize) -> Result<Self, Violation> {
        let rest = raw.get(at..end).unwrap_or(&[]);
        let mut left = count;
        let mut last = |byte: &u8| {
            left -= usize::from(*byte < 0x80);
            left == 0
        };
        match if count == 0 { Some(0) } else { rest.iter().position(&mut last).map(|last| last + 1) } {
            Some(len) => Ok(Self { at, end: at + len }),
            None => Err(Violation::new("D3", format!("a column of {count} varints"), format!("{left} less"))),
        }
    }

    #[inline]
    fn varint(&mut self, raw: &[u8]) -> Result<u64, Violation> {
        // Most varints take one byte.
        match raw[..self.end].get(self.at) {
            Some(&byte) if byte < 0x80 => {
                self.at += 1;
                Ok(byte.into())
            }
            _ => self.long_varint(raw),
        }
    }

    fn long_varint(&mut self, raw: &[u8]) -> Result<u64, Violation> {
        let mut reader = ByteReader::new(&raw[self.at..self.end], "D3");
        let value = reader.varint()?;
        self.at = self.end - reader.len();
        Ok(value)
    }
}

/// Reads the little-endian u32 at `at`.
fn word(raw: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([raw[at], raw[at + 1], raw[at + 2], raw[at + 3]])
}

impl Cursor {
    fn new(raw: &[u8], leaf: &LeafPlace) -> Result<Self, Violation> {
        let (count, len) = (leaf.entries as usize, raw.len());
        let short = || Violation::new("D3", format!("a leaf of {count} entries"), format!("{len} bytes"));
        if len < count.saturating_mul(MIN_ENTRY) || len as u64 > max_raw_len(leaf.entries) {
            return Err(short());
        }
        let mut reader = ByteReader::new(raw, "D3");
        let next = reader.varint()?;
        let columns = Column::of(raw, len - reader.len(), len, count)?;
        let layers = Column::of(raw, columns.end, len, count)?;
        let kinds = layers.end;
        let all = raw.get(kinds..kinds + count).ok_or_else(short)?;
        if let Some(kind) = all.iter().find(|&&kind| kind > UNIFORM) {
            return Err(Violation::new("D5", "kind 0, 1 or 2", kind));
        }
        let of_kind = |wanted: u8| all.iter().filter(|&&kind| kind == wanted).count();
        let (shared, uniform) = (of_kind(SHARED), of_kind(UNIFORM));
        let paged = count - uniform;
        let masks = kinds + count;
        // The spans end the leaf, so the columns between masks and spans are bounded from both sides.
        let spans = len.checked_sub(4 * uniform).filter(|&spans| spans >= masks + 8 * paged).ok_or_else(short)?;
        let lengths = Column::of(raw, masks + 8 * paged, spans, paged)?;
        let distances = Column::of(raw, lengths.end, spans, shared)?;
        let (checksums, blocks) = (distances.end, distances.end + 4 * paged);
        let words = Column { at: blocks + paged, end: spans };
        if words.at > words.end {
            return Err(short());
        }
        let (given, given_paged, last) = (0, 0, None);
        Ok(Self {
            next,
            given,
            given_paged,
            paged,
            last,
            columns,
            layers,
            kinds,
            masks,
            lengths,
            distances,
            checksums,
            blocks,
            words,
            spans,
        })
    }

    fn next(&mut self, raw: &[u8], leaf: &LeafPlace) -> Result<Option<PageEntry>, Violation> {
        if self.given == leaf.entries as usize {
            return match self.words.end - self.words.at {
                0 => Ok(None),
                more => Err(Violation::new("D3", "no byte beyond the last column", format!("{more} more"))),
            };
        }
        let entry = self.entry(raw, leaf);
        self.given = if entry.is_ok() { self.given + 1 } else { leaf.entries as usize };
        entry.map(Some)
    }

    fn entry(&mut self, raw: &[u8], leaf: &LeafPlace) -> Result<PageEntry, Violation> {
        let key = self.key(raw, leaf)?;
        let kind = raw[self.kinds + self.given];
        if kind == UNIFORM {
            let bits = word(raw, self.spans + 4 * (self.given - self.given_paged));
            let span = span_from_bits(bits);
            let span = span.ok_or_else(|| Violation::new("D8", "a span inside the page", format!("{bits:08x}")))?;
            return Ok(PageEntry {
                key,
                slices: span.slice_mask(),
                size: PageSize::UNIFORM,
                storage: Storage::Uniform(span),
            });
        }
        let at = self.given_paged;
        self.given_paged += 1;
        let len = self.lengths.varint(raw)?;
        let longest = super::page_coding::MAX_STORED_PAGE as u64;
        if len <= super::page_coding::LEADER as u64 || len > longest {
            let expected = format!("a page of {} to {longest} bytes", super::page_coding::LEADER + 1);
            return Err(Violation::new("D6", expected, len));
        }
        let mask =
            (0..8).rev().fold(0u64, |mask, byte| mask << 8 | u64::from(raw[self.masks + byte * self.paged + at]));
        if mask == 0 {
            return Err(Violation::new("D7", "an occupied slice", format!("none in page {key}")));
        }
        let offset = match kind {
            STORED => self.next,
            _ => {
                let back = self.distances.varint(raw)?;
                let offset = self.next.checked_sub(back).filter(|_| back >= len);
                offset
                    .ok_or_else(|| Violation::new("D6", "shared bytes that end before here", format!("{back} back")))?
            }
        };
        let pages_len = leaf.pages.end - leaf.pages.start;
        let Some(end) = offset.checked_add(len).filter(|&end| end <= pages_len) else {
            let found = format!("{len} bytes at {offset} for page {key}");
            return Err(Violation::new("D6", format!("pages within {pages_len} bytes"), found));
        };
        let (blocks, more) = (u32::from(raw[self.blocks + at]) + 1, self.words.varint(raw)?);
        let words = u32::try_from(more.saturating_add(blocks.into())).ok();
        let size = words.and_then(|words| PageSize::new(blocks, words)).ok_or_else(|| {
            let expected = format!("1 to 64 blocks with up to {} words", PageSize::MAX_WORDS);
            Violation::new("D11", expected, format!("{blocks} blocks and {more} words more in page {key}"))
        })?;
        let crc = word(raw, self.checksums + 4 * at);
        let extent = Extent { offset: leaf.pages.start + offset, len: len as u32, crc };
        let storage = if kind == STORED { Storage::Stored(extent) } else { Storage::Shared(extent) };
        if kind == STORED {
            self.next = end;
        }
        Ok(PageEntry { key, slices: mask, size, storage })
    }

    fn key(&mut self, raw: &[u8], leaf: &LeafPlace) -> Result<PageKey, Violation> {
        let wrong = |found: String| Violation::new("D4", "keys in ascending order, the first as the root says", found);
        let (across, up) = (self.columns.varint(raw)?, unzigzag(self.layers.varint(raw)?));
        let Some((column, last)) = self.last else {
            let first = leaf.first;
            if across != 0 || up != 0 || !key_in_grid(first) {
                return Err(wrong(format!("a leaf that begins {across} columns and {up} layers after {first}")));
            }
            return self.below_end(leaf, first.column(), first);
        };
        let next = column.checked_add(across).ok_or_else(|| wrong(format!("{across} columns after {last}")))?;
        let layer = i64::from(last.layer).checked_add(up).and_then(|layer| i32::try_from(layer).ok());
        let layer = layer.ok_or_else(|| wrong(format!("{up} layers after {last}")))?;
        let key = if across == 0 { PageKey { layer, ..last } } else { PageKey::from_column(next, layer) };
        if !key_in_grid(key) || across == 0 && up <= 0 {
            return Err(wrong(format!("page {key} after {last}")));
        }
        self.below_end(leaf, next, key)
    }

    fn below_end(&mut self, leaf: &LeafPlace, column: u64, key: PageKey) -> Result<PageKey, Violation> {
        if let Some(end) = leaf.end.filter(|&end| key >= end) {
            return Err(Violation::new("D4", format!("keys below {end}, where the next leaf begins"), key));
        }
        self.last = Some((column, key));
        Ok(key)
    }
}

/// Returns whether the grid has a page with this key.
pub(super) fn key_in_grid(key: PageKey) -> bool {
    [key.tx, key.ty, key.layer].iter().all(|index| (-MAX_TILE - 1..=MAX_TILE).contains(index))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Entries like a writer makes them, with a gap in the pages before the first.
    pub fn entries() -> impl Strategy<Value = Vec<PageEntry>> {
        let key = (-3i32..4, -3i32..4, -40i32..40);
        let place = (0u8..3, 25u32..5000, any::<u32>(), 1u64.., 0u32..16000, 0u32..300);
        let parts = proptest::collection::btree_map(key, place, 1..60);
        (parts, 0u64..1 << 40).prop_map(|(parts, start)| {
            let key = |&(tx, ty, layer): &(i32, i32, i32)| PageKey { tx, ty, layer };
            let mut parts: Vec<_> = parts.iter().map(|(k, v)| (key(k), *v)).collect();
            parts.sort_by_key(|part| part.0);
            let mut next = start;
            let mut made: Vec<Extent> = Vec::new();
            let mut entries = Vec::new();
            for (key, (kind, len, crc, slices, bottom, height)) in parts {
                let storage = match kind {
                    SHARED if !made.is_empty() => Storage::Shared(made[crc as usize % made.len()]),
                    UNIFORM => Storage::Uniform(Span::new(bottom, bottom + height, crc & 1 == 1).unwrap()),
                    _ => {
                        made.push(Extent { offset: next, len, crc });
                        next += len as u64;
                        Storage::Stored(made[made.len() - 1])
                    }
                };
                let blocks = 1 + crc % 64;
                let size = PageSize::new(blocks, blocks + (slices % 524_000) as u32);
                let (slices, size) = match storage {
                    Storage::Uniform(span) => (span.slice_mask(), PageSize::UNIFORM),
                    _ => (slices, size.unwrap()),
                };
                entries.push(PageEntry { key, slices, size, storage });
            }
            entries
        })
    }

    fn place(entries: u32, first: PageKey, pages_len: u64) -> LeafPlace {
        LeafPlace { index: 3, offset: 9, entries, first, end: None, pages: 0..pages_len }
    }

    fn decode_leaf(raw: &[u8], entries: u32, first: PageKey, pages_len: u64) -> Result<Vec<PageEntry>> {
        let entries = LeafEntries::new(raw.to_vec(), place(entries, first, pages_len))?;
        entries.check()?;
        entries.collect()
    }

    fn encoded(entries: &[PageEntry]) -> Vec<u8> {
        let stored = entries.iter().find(|entry| matches!(entry.storage, Storage::Stored(_)));
        let mut base = stored.and_then(PageEntry::extent).map_or(0, |extent| extent.offset);
        let mut raw = Vec::new();
        encode_leaf(entries, &mut base, &mut raw);
        raw
    }

    #[test]
    fn a_leaf_may_share_pages_of_leaves_before_it_and_store_none() {
        let (mut base, mut raw) = (5000, Vec::new());
        let size = PageSize::new(1, 1).unwrap();
        let entries = [100, 4900].map(|offset| PageEntry {
            key: PageKey { tx: 0, ty: 0, layer: offset as i32 },
            slices: 1,
            size,
            storage: Storage::Shared(Extent { offset, len: 100, crc: 7 }),
        });
        encode_leaf(&entries, &mut base, &mut raw);
        assert_eq!(base, 5000);
        assert_eq!(decode_leaf(&raw, 2, entries[0].key, 5000).unwrap(), entries);
        let place = LeafPlace { end: Some(entries[1].key), ..place(2, entries[0].key, 5000) };
        let before_the_next = LeafEntries::new(raw, place).unwrap().check();
        assert!(before_the_next.unwrap_err().to_string().contains("rule D4: directory leaf 3 at byte 9"));
    }

    #[test]
    fn steps_between_keys_must_lead_to_keys() {
        let first = PageKey { tx: 0, ty: 0, layer: 5 };
        let second = |across: u64, up: i64| {
            let mut raw = vec![0];
            [0, across, 0, zigzag(up)].into_iter().for_each(|number| put_varint(&mut raw, number));
            raw.extend([UNIFORM; 2]);
            raw.extend(span_bits(Span::new(5, 9, true).unwrap()).to_le_bytes().repeat(2));
            Ok::<_, Error>(decode_leaf(&raw, 2, first, 0)?[1].key)
        };
        assert_eq!(second(0, 1).unwrap(), PageKey { layer: 6, ..first });
        for (across, up, words) in [
            (u64::MAX, 0, "columns after"),
            (0, i64::MAX, "layers after"),
            (0, i64::MIN, "layers after"),
            (0, 1 << 40, "layers after"),
            (0, 1 << 30, "page (0, 0, 1073741829) after"),
            (0, 0, "page (0, 0, 5) after"),
            (0, -1, "page (0, 0, 4) after"),
        ] {
            let said = second(across, up).unwrap_err().to_string();
            assert!(said.contains("rule D4") && said.contains(words), "{across}, {up}: {said}");
        }
    }

    proptest! {
        #[test]
        fn leaves_round_trip(entries in entries()) {
            let raw = encoded(&entries);
            prop_assert!(raw.len() as u64 <= max_raw_len(entries.len() as u32));
            let again = decode_leaf(&raw, entries.len() as u32, entries[0].key, u64::MAX);
            prop_assert_eq!(again.unwrap(), entries);
        }

        #[test]
        fn damaged_leaves_are_refused_or_hold_valid_entries(
            entries in entries(), at: prop::sample::Index, value: u8, cut in 0usize..40
        ) {
            let mut raw = encoded(&entries);
            let place = at.index(raw.len());
            raw[place] = value;
            raw.truncate(raw.len().saturating_sub(cut.saturating_sub(20)));
            if let Ok(entries) = decode_leaf(&raw, entries.len() as u32, entries[0].key, 1 << 41) {
                prop_assert!(entries.is_sorted_by_key(|entry| entry.key));
                prop_assert!(entries.iter().all(|e| e.slices != 0 && key_in_grid(e.key)));
                let ends = entries.iter().filter_map(PageEntry::extent).map(|e| e.offset + e.len as u64);
                prop_assert!(ends.max().unwrap_or(0) <= 1 << 41);
            }
        }

        #[test]
        fn random_bytes_never_panic(raw in proptest::collection::vec(any::<u8>(), 0..300), count in 0u32..40) {
            let _ = decode_leaf(&raw, count, PageKey { tx: 0, ty: 0, layer: 0 }, 1 << 20);
        }
    }
}
