//! Directory leaves: sorted entries, one per page, column by column (chapter 4).
//!
//! In: entries in ascending key order. Out: the bytes of a leaf before compression, about 10 bytes an entry after it.
//! Memory: one leaf, at most 2²⁰ entries.

use crate::codec::{Reader, Violation, put_varint, span_bits, span_from_bits, unzigzag, zigzag};
use crate::frame::{MAX_INDEX, PAGE_SLICES, PageKey};
use crate::slice::{PageSize, Span};

/// A stretch of bytes of the archive with its checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extent {
    /// First byte [bytes from the start of the archive].
    pub offset: u64,
    /// Length (bytes).
    pub len: u32,
    /// CRC32C of the page as its leader holds it.
    pub crc: u32,
}

/// Where the content of a page is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In bytes of its own.
    Stored(Extent),
    /// In the bytes of an earlier page of equal content.
    Shared(Extent),
    /// Nowhere: every pixel holds this one span.
    Uniform(Span),
}

/// A page as the directory tells of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageEntry {
    /// Which page.
    pub key: PageKey,
    /// Slices of the page with matter: bit `k` for slice `64·layer + k`. Never 0.
    pub slices: u64,
    /// How large the page is in memory; of a uniform page always [`PageSize::UNIFORM`].
    pub size: PageSize,
    /// Where its content is.
    pub place: Place,
}

impl PageEntry {
    /// Bytes to read for the content; `None` for a uniform page, which needs no read.
    pub fn extent(&self) -> Option<Extent> {
        match self.place {
            Place::Stored(extent) | Place::Shared(extent) => Some(extent),
            Place::Uniform(_) => None,
        }
    }

    /// Bytes of memory that the page takes once decoded; exact, and checked when it is.
    pub fn weight_bytes(&self) -> usize {
        self.size.weight_bytes(self.slices)
    }

    /// Lowest and highest slice with matter, as indices of the grid.
    pub fn slice_range(&self) -> (i64, i64) {
        let floor = self.key.layer as i64 * PAGE_SLICES;
        (floor + self.slices.trailing_zeros() as i64, floor + 63 - self.slices.leading_zeros() as i64)
    }
}

/// Kinds of entries in the order of their codes.
const STORED: u8 = 0;
const SHARED: u8 = 1;
const UNIFORM: u8 = 2;

/// Least and greatest bytes of an entry before compression.
const MIN_ENTRY: usize = 1 + 1 + 1 + 4;
const MAX_ENTRY: usize = 10 + 5 + 1 + 8 + 5 + 10 + 4 + 1 + 3;

/// Stands in for an extent until its entry is filled in.
const NOWHERE: Extent = Extent { offset: 0, len: 0, crc: 0 };

/// Greatest layer and tile index in magnitude (toward −∞ one more).
const MAX_TILE: i32 = (MAX_INDEX / PAGE_SLICES) as i32;

/// Greatest length of a leaf of `entries` entries before compression (bytes).
pub(super) fn max_raw_len(entries: u32) -> u64 {
    10 + entries as u64 * MAX_ENTRY as u64
}

/// The bytes of a leaf before compression. `entries` are ascending and not empty; their offsets count from the start
/// of the pages section, and the stored pages among them lie one after the other from `base`, which moves behind them.
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
    out.extend(entries.iter().map(|entry| match entry.place {
        Place::Stored(_) => STORED,
        Place::Shared(_) => SHARED,
        Place::Uniform(_) => UNIFORM,
    }));
    let paged = || entries.iter().filter_map(|entry| Some((entry, entry.extent()?)));
    for byte in 0..8 {
        out.extend(paged().map(|(entry, _)| entry.slices.to_le_bytes()[byte]));
    }
    for (_, extent) in paged() {
        put_varint(out, extent.len as u64);
    }
    for (entry, extent) in paged() {
        match entry.place {
            Place::Stored(_) => *base = extent.offset + extent.len as u64,
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
        if let Place::Uniform(span) = entry.place {
            out.extend(span_bits(span).to_le_bytes());
        }
    }
}

/// The `count` entries of a leaf, the first of which has the key `first`; offsets count from the start of the pages
/// section, which is `pages_len` bytes long. Breaks of rules D3 to D8 and D11 are errors.
pub(super) fn decode_leaf(raw: &[u8], count: u32, first: PageKey, pages_len: u64) -> Result<Vec<PageEntry>, Violation> {
    let count = count as usize;
    if raw.len() < count.saturating_mul(MIN_ENTRY) || raw.len() as u64 > max_raw_len(count as u32) {
        return Err(Violation::new("D3", format!("a leaf of {count} entries"), format!("{} bytes", raw.len())));
    }
    let mut reader = Reader::new(raw, "D3");
    let mut next = reader.varint()?;
    let keys = decode_keys(&mut reader, count, first)?;
    let kinds = reader.take(count)?;
    if let Some(kind) = kinds.iter().find(|&&kind| kind > UNIFORM) {
        return Err(Violation::new("D5", "kind 0, 1 or 2", kind));
    }
    let paged = kinds.iter().filter(|&&kind| kind != UNIFORM).count();
    let masks = reader.take(8 * paged)?;
    // Lengths and back distances follow each other, so a second reader runs ahead to the distances.
    let mut lens = Vec::with_capacity(paged);
    for _ in 0..paged {
        let len = reader.varint()?;
        let longest = super::page::MAX_STORED_PAGE as u64;
        if len <= super::page::LEADER as u64 || len > longest {
            return Err(Violation::new("D6", format!("a page of at most {longest} bytes"), len));
        }
        lens.push(len as u32);
    }
    let mut entries = Vec::with_capacity(count);
    let mut at = 0;
    for (&key, &kind) in keys.iter().zip(kinds) {
        if kind == UNIFORM {
            // Filled in below; the mask of no slice marks the gap.
            entries.push(PageEntry { key, slices: 0, size: PageSize::UNIFORM, place: Place::Shared(NOWHERE) });
            continue;
        }
        let len = lens[at];
        let mask = (0..8).rev().fold(0u64, |mask, byte| mask << 8 | masks[byte * paged + at] as u64);
        if mask == 0 {
            return Err(Violation::new("D7", "a slice with matter", format!("none in page {key}")));
        }
        let offset = match kind {
            STORED => next,
            _ => {
                let back = reader.varint()?;
                let offset = next.checked_sub(back).filter(|_| back >= len as u64);
                offset
                    .ok_or_else(|| Violation::new("D6", "shared bytes that end before here", format!("{back} back")))?
            }
        };
        let end = offset.checked_add(len as u64).filter(|&end| end <= pages_len);
        let Some(end) = end else {
            let found = format!("{len} bytes at {offset} for page {key}");
            return Err(Violation::new("D6", format!("pages within {pages_len} bytes"), found));
        };
        let extent = Extent { offset, len, crc: 0 };
        let place = if kind == STORED { Place::Stored(extent) } else { Place::Shared(extent) };
        if kind == STORED {
            next = end;
        }
        entries.push(PageEntry { key, slices: mask, size: PageSize::UNIFORM, place });
        at += 1;
    }
    for entry in entries.iter_mut().filter(|entry| entry.slices != 0) {
        if let Place::Stored(extent) | Place::Shared(extent) = &mut entry.place {
            extent.crc = reader.u32()?;
        }
    }
    let blocks = reader.take(paged)?;
    for (entry, &blocks) in entries.iter_mut().filter(|entry| entry.slices != 0).zip(blocks) {
        let (blocks, more) = (blocks as u32 + 1, reader.varint()?);
        let words = u32::try_from(more.saturating_add(blocks as u64)).ok();
        entry.size = words.and_then(|words| PageSize::new(blocks, words)).ok_or_else(|| {
            let expected = format!("1 to 64 blocks with up to {} words", PageSize::MAX_WORDS);
            Violation::new("D11", expected, format!("{blocks} blocks and {more} words more in page {}", entry.key))
        })?;
    }
    for entry in entries.iter_mut().filter(|entry| entry.slices == 0) {
        let bits = reader.u32()?;
        let span = span_from_bits(bits);
        let span = span.ok_or_else(|| Violation::new("D8", "a span inside the page", format!("{bits:08x}")))?;
        entry.slices = span.slice_mask();
        entry.place = Place::Uniform(span);
    }
    reader.finish()?;
    Ok(entries)
}

fn decode_keys(reader: &mut Reader<'_>, count: usize, first: PageKey) -> Result<Vec<PageKey>, Violation> {
    let wrong = |found: String| Violation::new("D4", "keys in ascending order, the first as the root says", found);
    let mut columns = Vec::with_capacity(count);
    let mut column = first.column();
    for at in 0..count {
        let delta = reader.varint()?;
        let sum = column.checked_add(delta).filter(|_| at > 0 || delta == 0);
        column = sum.ok_or_else(|| wrong(format!("a step of {delta} after column {column}")))?;
        columns.push(column);
    }
    let mut keys: Vec<PageKey> = Vec::with_capacity(count);
    let mut layer = first.layer as i64;
    for (at, column) in columns.into_iter().enumerate() {
        let delta = unzigzag(reader.varint()?);
        let sum = layer.checked_add(delta).filter(|_| at > 0 || delta == 0);
        layer = sum.ok_or_else(|| wrong(format!("a step of {delta} after layer {layer}")))?;
        let inside = -MAX_TILE as i64 - 1..=MAX_TILE as i64;
        if !inside.contains(&layer) {
            return Err(wrong(format!("layer {layer}")));
        }
        let key = PageKey::from_column(column, layer as i32);
        let tiles_inside = [key.tx, key.ty].iter().all(|&tile| inside.contains(&(tile as i64)));
        if !tiles_inside || keys.last().is_some_and(|&last| last >= key) {
            return Err(wrong(format!("page {key}")));
        }
        keys.push(key);
    }
    Ok(keys)
}

/// Whether the grid has a page of this key.
pub(super) fn key_in_grid(key: PageKey) -> bool {
    [key.tx, key.ty, key.layer].iter().all(|index| (-MAX_TILE - 1..=MAX_TILE).contains(index))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Entries as a writer makes them, with a gap in the pages before the first of them.
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
                let place = match kind {
                    SHARED if !made.is_empty() => Place::Shared(made[crc as usize % made.len()]),
                    UNIFORM => Place::Uniform(Span::new(bottom, bottom + height, crc & 1 == 1).unwrap()),
                    _ => {
                        made.push(Extent { offset: next, len, crc });
                        next += len as u64;
                        Place::Stored(made[made.len() - 1])
                    }
                };
                let blocks = 1 + crc % 64;
                let size = PageSize::new(blocks, blocks + (slices % 524_000) as u32);
                let (slices, size) = match place {
                    Place::Uniform(span) => (span.slice_mask(), PageSize::UNIFORM),
                    _ => (slices, size.unwrap()),
                };
                entries.push(PageEntry { key, slices, size, place });
            }
            entries
        })
    }

    fn encoded(entries: &[PageEntry]) -> Vec<u8> {
        let stored = entries.iter().find(|entry| matches!(entry.place, Place::Stored(_)));
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
            place: Place::Shared(Extent { offset, len: 100, crc: 7 }),
        });
        encode_leaf(&entries, &mut base, &mut raw);
        assert_eq!(base, 5000);
        assert_eq!(decode_leaf(&raw, 2, entries[0].key, 5000), Ok(entries.to_vec()));
    }

    proptest! {
        #[test]
        fn leaves_round_trip(entries in entries()) {
            let raw = encoded(&entries);
            prop_assert!(raw.len() as u64 <= max_raw_len(entries.len() as u32));
            let again = decode_leaf(&raw, entries.len() as u32, entries[0].key, u64::MAX);
            prop_assert_eq!(again, Ok(entries));
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
