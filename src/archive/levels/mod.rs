//! Overview levels: coarser copies of the archive. They serve first looks, distant views and long rays.
//!
//! Level 1 has pixels of 4t and slices of 4σ; each further level is four times coarser, up to one page (or the eight
//! pages around the origin). Pages, directory leaves and queries of a level are those of an archive on a coarser grid:
//! [`Archive::level`](super::Archive::level) opens it as an archive of its own, which a [`Snapshot`](crate::store::Snapshot),
//! a [`Stream`](crate::store::Stream) or a [`Loader`](crate::store::Loader) loads and every query answers.
//!
//! A level errs towards "hit": space that is free in it is free in the archive. Its pages cover all solid of the pages
//! below, its heights are moved outwards to thirds of its slices (to whole slices where the scan is sparse), and floor
//! that shares a slice with an obstacle becomes part of the obstacle.
//!
//! ```no_run
//! use slicewalk::archive::Archive;
//!
//! let archive = Archive::open("city.slices")?;
//! for level in archive.levels()? {
//!     let (pages, bytes) = (level.catalog().header().pages.total(), level.bytes());
//!     println!("level {}: {} m pixels, {pages} pages in bytes {bytes:?}", level.number(), level.frame().pixel_m());
//! }
//! // The coarsest one, all of it in memory.
//! if let Some(last) = archive.levels()?.last() {
//!     let outline = archive.level(last.number())?;
//!     let store = slicewalk::store::Snapshot::resident(&outline, &slicewalk::NoMonitor)?;
//! }
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! A program without files fetches ranges itself: first the table of levels, then all of one level, or only its nearby
//! pages, with a [`Loader`](crate::store::Loader) on `level.catalog().clone()`. The coarsest level lies last, before
//! the table, so one read of the end of [`Catalog::levels_section`](super::Catalog::levels_section) brings both.
//!
//! ```
//! use slicewalk::archive::{Archive, Catalog};
//! use slicewalk::store::Snapshot;
//!
//! /// The finest level of at most `most_bytes`, in memory.
//! fn outline(
//!     catalog: &Catalog,
//!     most_bytes: u64,
//!     fetch: impl Fn(std::ops::Range<u64>) -> Vec<u8>,
//! ) -> slicewalk::Result<Option<Snapshot>> {
//!     let Some(table) = catalog.levels_range() else { return Ok(None) };
//!     let levels = catalog.decode_levels(&fetch(table))?;
//!     let fits = |range: std::ops::Range<u64>| range.end - range.start <= most_bytes;
//!     let Some(level) = levels.iter().find(|level| fits(level.bytes())) else { return Ok(None) };
//!     let archive = Archive::of_level(level, fetch(level.bytes()))?;
//!     Snapshot::resident(&archive, &slicewalk::NoMonitor).map(Some)
//! }
//! ```
//!
//! If the archive has colours, its levels have them, too: a voxel of a level has the mean colour of the archive's
//! voxels inside. [`ColourReader`](super::ColourReader) reads colours of a level like those of an archive; they lie in
//! the colours section.
//!
//! Levels follow from the pages and their colours alone, so everything that writes an archive rebuilds them in the same
//! pass: a conversion, a merge of parts, an extract, a replacement, a recovery. `verify` rebuilds them and compares.

mod build;
mod check;
mod coarse;
mod level_colours;
mod level_writer;

pub(super) use build::MAX_LEVELS;
pub(super) use check::LevelCheck;
pub(super) use coarse::{CoarseSpan, coarse};
pub(super) use level_colours::{CoarseColour, coarse_colours};
pub(super) use level_writer::LevelWriter;

use super::catalog::Catalog;
use super::head::{self, Header, Leaf, MAX_LEAF_ENTRIES, MAX_LEAVES, Pages, Sections};
use crate::bytes::crc;
use crate::codec::{ByteReader, Packer, Unpacker, Violation};
use crate::frame::Frame;
use std::ops::Range;

/// Table of overview levels, as the head describes it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Levels {
    /// Number of levels; 0 if the archive has too few pages for any.
    pub count: u32,
    /// Length of the table of levels (bytes).
    pub table_len: u32,
    /// CRC32C of the table of levels.
    pub table_crc: u32,
}

/// One overview level.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    number: u32,
    catalog: Catalog,
}

impl Level {
    /// Returns the level's number `n`: pixels and slices are 4ⁿ times those of the archive.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Returns the level's grid.
    pub fn frame(&self) -> &Frame {
        &self.catalog.header().plan.frame
    }

    /// Returns the directory of the level's pages. Its header has the level's grid, pages and slices; bounds and points
    /// are those of the archive; tiles and voxels are not counted and stay 0.
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// Returns the bytes of the archive that hold the level's pages and directory.
    pub fn bytes(&self) -> Range<u64> {
        let header = self.catalog.header();
        header.pages_offset()..header.metadata_offset()
    }
}

/// Largest table before compression (bytes).
const MAX_TABLE: usize = MAX_LEVELS * (FIXED + MAX_LEAVES * head::ROOT_RECORD);
/// Largest table in the file (bytes).
pub(super) const MAX_STORED_TABLE: u32 = MAX_TABLE as u32 + (1 << 16);
/// Bytes of a level's record before its leaves.
const FIXED: usize = 40;

/// Record of a level in the table.
pub(super) struct LevelRecord {
    pub pages_len: u64,
    pub pages: Pages,
    pub leaf_entries: u32,
    pub leaves: Vec<Leaf>,
}

impl LevelRecord {
    fn directory_len(&self) -> u64 {
        self.leaves.iter().map(|leaf| u64::from(leaf.stored_len)).sum()
    }
}

/// Encodes the table of levels, compressed.
pub(super) fn encode_table(levels: &[LevelRecord]) -> Vec<u8> {
    let mut raw = Vec::new();
    for level in levels {
        for value in [level.pages_len, level.directory_len(), level.pages.stored, level.pages.uniform] {
            raw.extend(value.to_le_bytes());
        }
        raw.extend(level.leaf_entries.to_le_bytes());
        raw.extend((level.leaves.len() as u32).to_le_bytes());
        level.leaves.iter().for_each(|leaf| leaf.encode(&mut raw));
    }
    let mut table = Vec::new();
    Packer::new().pack(&raw, &mut table);
    table
}

/// Decodes the levels of the archive with this header from the bytes of its table (rules L2 to L4).
pub(super) fn decode_table(header: &Header, table: &[u8]) -> Result<Vec<Level>, Violation> {
    let Some(levels) = header.levels.filter(|levels| levels.count > 0) else { return Ok(Vec::new()) };
    let crc = crc::crc32c(table);
    if crc != levels.table_crc {
        return Err(Violation::new("L2", format!("checksum {:08x}", levels.table_crc), format!("{crc:08x}")));
    }
    let mut unpacker = Unpacker::new();
    let mut reader = ByteReader::new(unpacker.unpack(table, MAX_TABLE, "L3")?, "L3");
    let mut found = Vec::new();
    let (mut at, mut below) = (header.levels_offset(), header.pages.total());
    for number in 1..=levels.count {
        let frame = header.plan.frame.coarser(number);
        let frame =
            frame.ok_or_else(|| Violation::new("L4", "cells of at most 1000000 m", format!("level {number}")))?;
        let [pages_len, directory_len, stored, uniform] = [reader.u64()?, reader.u64()?, reader.u64()?, reader.u64()?];
        let [leaf_entries, leaf_count] = [reader.u32()?, reader.u32()?];
        let pages = Pages { stored, shared: 0, uniform };
        if !(1..=below).contains(&pages.total()) {
            return Err(Violation::new("L4", format!("1 to {below} pages in level {number}"), format!("{pages:?}")));
        }
        if leaf_count as usize > MAX_LEAVES || leaf_entries > MAX_LEAF_ENTRIES {
            return Err(Violation::new("R1", "at most 512 leaves of 2^20 entries", leaf_count));
        }
        let end = pages_len.checked_add(directory_len).and_then(|len| at.checked_add(len));
        let end = end.filter(|&end| end <= header.directory_offset());
        let end = end.ok_or_else(|| Violation::new("L4", "levels inside their section", format!("level {number}")))?;
        let mut plan = header.plan.clone();
        plan.frame = frame;
        let own = Header {
            level: number,
            levels: None,
            colours: None,
            plan,
            pages,
            leaf_entries,
            slices: header.slices.map(|(first, last)| (first >> (2 * number), last >> (2 * number))),
            tiles: Default::default(),
            voxels: Default::default(),
            bytes: Sections {
                head: at,
                pages: pages_len,
                colours: 0,
                levels: 0,
                directory: directory_len,
                metadata: 0,
            },
            metadata_crc: crc::crc32c(&[]),
            ..header.clone()
        };
        let records = reader.take(leaf_count as usize * head::ROOT_RECORD)?;
        let leaves = head::decode_root(records, leaf_count as usize, &own)?;
        found.push(Level { number, catalog: Catalog::of_level(own, leaves, header.level_colours()) });
        (at, below) = (end, pages.total());
    }
    if !reader.is_empty() {
        return Err(Violation::new("L3", "no byte beyond the last level", format!("{} more", reader.len())));
    }
    let table_at = header.directory_offset() - u64::from(levels.table_len);
    if at != table_at {
        return Err(Violation::new("L4", format!("levels up to byte {table_at}"), at));
    }
    Ok(found)
}
