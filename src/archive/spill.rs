//! Directory entries of an archive that is being written: a few in memory, the rest in a temporary file.
//!
//! The number of entries per leaf depends on the total, so leaves are written at the end. Memory: 1.5 MiB for any
//! number of pages. Disk: 40 bytes per page beyond the first 32,768. A [`Spool`] buffers bytes that follow the pages.

use super::directory::{Extent, PageEntry, Storage, encode_leaf};
use super::head::Leaf;
use crate::Result;
use crate::bytes::crc;
use crate::codec::{ByteReader, Packer, span_bits, span_from_bits};
use crate::disk::{Files, Temporary};
use crate::frame::PageKey;
use crate::page::PageSize;
use std::path::{Path, PathBuf};

/// Entries kept in memory.
const KEPT: usize = 1 << 15;
const RECORD: usize = 40;
/// Bytes of a spool kept in memory.
const SPOOL_KEPT: usize = 1 << 18;

/// Entries in the order in which they were added.
#[derive(Debug)]
pub(super) struct Entries {
    files: Files,
    target: PathBuf,
    file: Option<Temporary>,
    /// Number of entries in the file.
    spilled: u64,
    tail: Vec<PageEntry>,
}

impl Entries {
    /// Creates an empty list; a temporary file, once needed, lies beside `target`.
    pub fn new(files: &Files, target: &Path) -> Self {
        Self { files: files.clone(), target: target.to_path_buf(), file: None, spilled: 0, tail: Vec::new() }
    }

    /// Returns the number of entries.
    pub fn len(&self) -> u64 {
        self.spilled + self.tail.len() as u64
    }

    /// Adds an entry.
    pub fn push(&mut self, entry: PageEntry) -> Result<()> {
        if self.tail.len() == KEPT {
            let file = match &mut self.file {
                Some(file) => file,
                none => none.insert(Temporary::beside(&self.files, &self.target)?),
            };
            let records: Vec<u8> = self.tail.iter().flat_map(record).collect();
            file.write_at(self.spilled * RECORD as u64, &records)?;
            self.spilled += self.tail.len() as u64;
            self.tail.clear();
        }
        self.tail.push(entry);
        Ok(())
    }

    /// Replaces `out` with `count` entries, from index `first` on.
    pub fn read(&self, first: u64, count: usize, out: &mut Vec<PageEntry>) -> Result<()> {
        out.clear();
        let from_file = self.spilled.saturating_sub(first).min(count as u64) as usize;
        if let Some(file) = self.file.as_ref().filter(|_| from_file > 0) {
            let mut records = vec![0; from_file * RECORD];
            file.read_at(first * RECORD as u64, &mut records)?;
            for bytes in records.chunks_exact(RECORD) {
                out.push(entry(bytes).ok_or_else(|| file.broken("read back directory entries"))?);
            }
        }
        let start = (first + from_file as u64).saturating_sub(self.spilled) as usize;
        out.extend_from_slice(&self.tail[start..start + count - from_file]);
        Ok(())
    }
}

/// Passes the bytes of all leaves, of `leaf_entries` entries each, to `give` and returns their root records.
pub(super) fn write_leaves(
    all: &Entries,
    leaf_entries: u32,
    give: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<Vec<Leaf>> {
    let mut leaves = Vec::new();
    let (mut entries, mut raw, mut stored) = (Vec::new(), Vec::new(), Vec::new());
    let mut packer = Packer::new();
    let (mut first, mut offset, mut base) = (0, 0, 0);
    while first < all.len() {
        let count = (all.len() - first).min(leaf_entries as u64) as usize;
        all.read(first, count, &mut entries)?;
        encode_leaf(&entries, &mut base, &mut raw);
        stored.clear();
        packer.pack(&raw, &mut stored);
        leaves.push(Leaf {
            first: entries[0].key,
            entries: count as u32,
            offset,
            stored_len: stored.len() as u32,
            raw_len: raw.len() as u32,
            crc: crc::crc32c(&stored),
        });
        give(&stored)?;
        first += count as u64;
        offset += stored.len() as u64;
    }
    Ok(leaves)
}

fn record(entry: &PageEntry) -> [u8; RECORD] {
    let mut out = [0; RECORD];
    let (kind, extent) = match entry.storage {
        Storage::Stored(extent) => (0u32, extent),
        Storage::Shared(extent) => (1, extent),
        Storage::Uniform(span) => (2, Extent { offset: 0, len: span_bits(span), crc: 0 }),
    };
    out[..8].copy_from_slice(&entry.key.column().to_le_bytes());
    out[8..12].copy_from_slice(&entry.key.layer.to_le_bytes());
    let kind_and_size = kind | entry.size.blocks() << 2 | entry.size.words() << 9;
    out[12..16].copy_from_slice(&kind_and_size.to_le_bytes());
    out[16..24].copy_from_slice(&entry.slices.to_le_bytes());
    out[24..32].copy_from_slice(&extent.offset.to_le_bytes());
    out[32..36].copy_from_slice(&extent.len.to_le_bytes());
    out[36..].copy_from_slice(&extent.crc.to_le_bytes());
    out
}

fn entry(record: &[u8]) -> Option<PageEntry> {
    let mut reader = ByteReader::new(record, "");
    let column = reader.u64().ok()?;
    let key = PageKey::from_column(column, reader.u32().ok()? as i32);
    let kind_and_size = reader.u32().ok()?;
    let size = PageSize::new(kind_and_size >> 2 & 127, kind_and_size >> 9)?;
    let slices = reader.u64().ok()?;
    let extent = Extent { offset: reader.u64().ok()?, len: reader.u32().ok()?, crc: reader.u32().ok()? };
    let storage = match kind_and_size & 3 {
        0 => Storage::Stored(extent),
        1 => Storage::Shared(extent),
        2 => Storage::Uniform(span_from_bits(extent.len)?),
        _ => return None,
    };
    Some(PageEntry { key, slices, size, storage })
}

/// Buffer of bytes that are read back once, in order.
#[derive(Debug)]
pub(super) struct Spool {
    kept: Vec<u8>,
    files: Files,
    file: Option<Temporary>,
    written: u64,
    beside: PathBuf,
}

impl Spool {
    /// Creates an empty spool; a temporary file, once needed, lies beside `target`.
    pub fn new(files: &Files, target: &Path) -> Self {
        Self { kept: Vec::new(), files: files.clone(), file: None, written: 0, beside: target.to_path_buf() }
    }

    /// Returns the number of bytes added.
    pub fn len(&self) -> u64 {
        self.written + self.kept.len() as u64
    }

    /// Adds bytes.
    pub fn push(&mut self, bytes: &[u8]) -> Result<()> {
        if self.kept.len() + bytes.len() > SPOOL_KEPT && !self.kept.is_empty() {
            let file = match &mut self.file {
                Some(file) => file,
                none => none.insert(Temporary::beside(&self.files, &self.beside)?),
            };
            file.write_at(self.written, &self.kept)?;
            self.written += self.kept.len() as u64;
            self.kept.clear();
        }
        self.kept.extend_from_slice(bytes);
        Ok(())
    }

    /// Passes all bytes to `give` in order, in pieces.
    pub fn read(&self, give: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let mut piece = vec![0; SPOOL_KEPT.min(self.written as usize)];
        let mut at = 0;
        while let Some(file) = self.file.as_ref().filter(|_| at < self.written) {
            let len = (self.written - at).min(SPOOL_KEPT as u64) as usize;
            file.read_at(at, &mut piece[..len])?;
            give(&piece[..len])?;
            at += len as u64;
        }
        give(&self.kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::Span;

    #[test]
    fn a_spool_keeps_little_in_memory_and_gives_all_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::new(&Files::current(), &folder.path().join("a.slices"));
        let piece: Vec<u8> = (0..SPOOL_KEPT / 3).map(|at| (at % 251) as u8).collect();
        for count in 1..=10 {
            spool.push(&piece).unwrap();
            assert_eq!((spool.len(), spool.file.is_some()), (count * piece.len() as u64, count > 3));
            assert!(spool.kept.len() <= SPOOL_KEPT);
        }
        let mut back = Vec::new();
        spool
            .read(&mut |bytes| {
                back.extend_from_slice(bytes);
                Ok(())
            })
            .unwrap();
        assert!(back == piece.repeat(10));
    }

    #[test]
    fn gives_back_entries_from_file_and_memory() {
        let folder = tempfile::tempdir().unwrap();
        let mut entries = Entries::new(&Files::current(), &folder.path().join("a.slices"));
        let made = |at: u64| {
            let extent = Extent { offset: at << 20, len: at as u32, crc: !at as u32 };
            let storage = match at % 3 {
                0 => Storage::Stored(extent),
                1 => Storage::Shared(extent),
                _ => Storage::Uniform(Span::new(at as u32 % 100, 200, at % 2 == 1).unwrap()),
            };
            let size = PageSize::new(1 + at as u32 % 64, 64 + at as u32 * 7).unwrap();
            PageEntry { key: PageKey::from_column(at, -(at as i32)), slices: at << 30, size, storage }
        };
        let count = 2 * KEPT as u64 + 5;
        for at in 0..count {
            entries.push(made(at)).unwrap();
        }
        assert_eq!(entries.len(), count);
        let mut out = Vec::new();
        for (first, len) in [(0, 7), (KEPT as u64 - 3, 9), (2 * KEPT as u64 - 2, 7), (count - 1, 1), (count, 0)] {
            entries.read(first, len, &mut out).unwrap();
            assert_eq!(out, (first..first + len as u64).map(made).collect::<Vec<_>>());
        }
        // The disk gives back a storage that there is not.
        entries.file.as_ref().unwrap().write_at(12, &[1 << 2 | 3]).unwrap();
        let said = entries.read(0, 1, &mut out).unwrap_err().to_string();
        assert!(said.contains("read back directory entries"), "{said}");
        drop(entries);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
