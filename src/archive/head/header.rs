//! Header of an archive: counts, lengths and offsets, checked by decoding.

use super::super::colour_section::{ColourHead, LEAF_RECORD, LevelColours};
use super::super::levels::Levels;
use crate::plan::Plan;
use crate::{Error, Result};

/// Number of tiles in an archive. A tile is one slice of a page that contains solid.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tiles {
    /// All occupied tiles.
    pub occupied: u64,
    /// Tiles whose page has bytes of its own or shares those of another; the rest belong to uniform pages.
    pub stored: u64,
    /// Tiles whose page has bytes of its own.
    pub unique: u64,
}

/// Number of voxels in an archive.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Voxels {
    /// All occupied voxels.
    pub occupied: u64,
    /// Voxels that contain an obstacle.
    pub obstacle: u64,
    /// Voxels whose solid is only inferred: floor that closes holes of the scan.
    pub inferred: u64,
}

/// Number of pages in an archive, by storage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pages {
    /// Pages with bytes of their own.
    pub stored: u64,
    /// Pages that share the bytes of an earlier one.
    pub shared: u64,
    /// Pages described by one span.
    pub uniform: u64,
}

impl Pages {
    /// Returns the number of all pages.
    pub fn total(&self) -> u64 {
        self.stored.saturating_add(self.shared).saturating_add(self.uniform)
    }
}

/// Lengths of the sections (bytes), in file order without gaps; the footer ends the file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sections {
    /// Header and root directory.
    pub head: u64,
    /// Pages.
    pub pages: u64,
    /// Colours of voxels, including those of overview levels.
    pub colours: u64,
    /// Overview levels: their pages and directories.
    pub levels: u64,
    /// Directory leaves.
    pub directory: u64,
    /// Metadata block.
    pub metadata: u64,
}

/// Smallest and largest coordinates (m).
pub type Bounds = ([f64; 3], [f64; 3]);

/// Decoded header of an archive.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Version of the format: (major, minor).
    pub version: (u16, u16),
    /// Features that a reader must know, as bits.
    pub features_required: u64,
    /// Features that a reader may ignore, as bits.
    pub features_optional: u64,
    /// Length of the archive (bytes).
    pub file_len: u64,
    /// Grid and options of the conversion.
    pub plan: Plan,
    /// Identity of the plan: archives with equal hashes can be compared and merged.
    pub plan_hash: u128,
    /// Points read from the input.
    pub points_read: u64,
    /// Points accumulated into voxels.
    pub points_kept: u64,
    /// Points that the input marks as withheld.
    pub points_withheld: u64,
    /// Points of excluded classes.
    pub points_excluded: u64,
    /// Smallest and largest coordinates of the kept points (m); `None` without points.
    pub bounds: Option<Bounds>,
    /// Lowest and highest occupied slice, inclusive; `None` without solid.
    pub slices: Option<(i64, i64)>,
    /// Tiles.
    pub tiles: Tiles,
    /// Voxels.
    pub voxels: Voxels,
    /// Pages.
    pub pages: Pages,
    /// Lengths of the sections.
    pub bytes: Sections,
    /// CRC32C of the metadata block.
    pub metadata_crc: u32,
    /// Entries in each directory leaf but the last.
    pub leaf_entries: u32,
    /// Table of overview levels; `None` if the archive was written without levels.
    pub levels: Option<Levels>,
    /// Colour fields; `None` if the archive was written without colours.
    pub colours: Option<ColourHead>,
    /// Overview level that this header describes; 0 for the archive itself.
    pub level: u32,
}

/// Limit on pages without bytes of their own in any archive, and archive bytes required for each page beyond it.
const MOST_REPEATS: u64 = 1 << 22;
const BYTES_A_REPEAT: u64 = 16;
/// Like [`MOST_REPEATS`], for archives with levels, where each page adds its spans to them.
const MOST_REPEATS_WITH_LEVELS: u64 = 1 << 16;

impl Header {
    /// Fails if the archive expands to more pages than its bytes justify, so that a pass over them would take minutes
    /// or longer.
    pub(in crate::archive) fn check_repeats(&self) -> Result<()> {
        let repeats = self.pages.shared.saturating_add(self.pages.uniform);
        let least = if self.levels.is_some() { MOST_REPEATS_WITH_LEVELS } else { MOST_REPEATS };
        let most = least.max(self.file_len / BYTES_A_REPEAT);
        if repeats > most {
            let what = format!(
                "pages without bytes of their own, in an archive of {} bytes (convert the scan again with larger pixels)",
                self.file_len
            );
            return Err(Error::limit(what, repeats, most));
        }
        Ok(())
    }

    /// Returns the table that locates the colours of overview levels; `None` if levels have none.
    pub(in crate::archive) fn level_colours(&self) -> Option<LevelColours> {
        let (levels, colours) = (self.levels?, self.colours?);
        let leaves = self.pages.total().div_ceil(u64::from(self.leaf_entries.max(1)));
        let end = self.levels_offset().saturating_sub(LEAF_RECORD as u64 * leaves);
        (levels.count > 0).then(|| LevelColours::new(levels.count, self.colours_offset(), end, colours.plan))
    }

    /// Returns the offset of the pages (bytes).
    pub fn pages_offset(&self) -> u64 {
        self.bytes.head
    }

    /// Returns the offset of the colours, where the pages end (bytes).
    pub fn colours_offset(&self) -> u64 {
        self.bytes.head + self.bytes.pages
    }

    /// Returns the offset of the overview levels (bytes).
    pub fn levels_offset(&self) -> u64 {
        self.colours_offset() + self.bytes.colours
    }

    /// Returns the offset of the directory leaves (bytes).
    pub fn directory_offset(&self) -> u64 {
        self.levels_offset() + self.bytes.levels
    }

    /// Returns the offset of the metadata block (bytes).
    pub fn metadata_offset(&self) -> u64 {
        self.directory_offset() + self.bytes.directory
    }
}
