//! What a head says: counts, lengths and places, checked when they were decoded.

use super::super::colours::{ColourHead, LEAF_RECORD, LevelColours};
use super::super::levels::Levels;
use crate::plan::Plan;
use crate::{Error, Result};

/// How many tiles (one slice of a page, where it holds matter) an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tiles {
    /// All tiles with matter.
    pub occupied: u64,
    /// Those whose page has bytes of its own or shares those of another; the rest are uniform.
    pub stored: u64,
    /// Those whose page has bytes of its own.
    pub unique: u64,
}

/// How many voxels an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Voxels {
    /// Voxels with matter.
    pub occupied: u64,
    /// Those with obstacle.
    pub obstacle: u64,
    /// Those whose matter is inferred alone: floor that closes holes of the scan.
    pub inferred: u64,
}

/// How many pages of each kind an archive has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pages {
    /// Pages with bytes of their own.
    pub stored: u64,
    /// Pages with the bytes of an earlier one.
    pub shared: u64,
    /// Pages told by one span.
    pub uniform: u64,
}

impl Pages {
    /// Pages of all kinds.
    pub fn total(&self) -> u64 {
        self.stored.saturating_add(self.shared).saturating_add(self.uniform)
    }
}

/// Lengths of the sections in the order in which they lie, without gap; the footer ends the file (bytes).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sections {
    /// Header and root directory.
    pub head: u64,
    /// Pages.
    pub pages: u64,
    /// Colours of voxels.
    pub colours: u64,
    /// Overview levels: their pages and directories.
    pub levels: u64,
    /// Leaf directories.
    pub directory: u64,
    /// Metadata block.
    pub metadata: u64,
}

/// Least and greatest coordinates (m).
pub type Bounds = ([f64; 3], [f64; 3]);

/// What the head of an archive says about the whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Version of the format: major, minor.
    pub version: (u16, u16),
    /// Features that a reader must know.
    pub features_required: u64,
    /// Features that a reader may ignore.
    pub features_optional: u64,
    /// Length of the archive (bytes).
    pub file_len: u64,
    /// Grid and options of the conversion.
    pub plan: Plan,
    /// Identity of the plan: archives of equal hash can be compared and merged.
    pub plan_hash: u128,
    /// Points read from the input.
    pub points_read: u64,
    /// Points that made voxels.
    pub points_kept: u64,
    /// Points that the input marks as withheld.
    pub points_withheld: u64,
    /// Points of excluded classes.
    pub points_excluded: u64,
    /// Least and greatest coordinates of the kept points (m); `None` without points.
    pub bounds: Option<Bounds>,
    /// Lowest and highest slice with matter, inclusive; `None` without matter.
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
    /// Where the overview levels are told of; `None` if the archive was written without.
    pub levels: Option<Levels>,
    /// What is said of colours; `None` if the archive was written without.
    pub colours: Option<ColourHead>,
    /// Which overview level this is the head of; 0 for the archive itself.
    pub level: u32,
}

/// Pages without bytes of their own that are gone through however small the archive is, and bytes for each one more.
const MOST_REPEATS: u64 = 1 << 22;
const BYTES_A_REPEAT: u64 = 16;
/// As [`MOST_REPEATS`] where each page adds its spans to overview levels.
const MOST_REPEATS_WITH_LEVELS: u64 = 1 << 16;

impl Header {
    /// Refuses to go through all pages of an archive that makes so many of so few bytes that it would take minutes and more.
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

    /// Where the colours of the overview levels are told of; `None` if levels have none.
    pub(in crate::archive) fn level_colours(&self) -> Option<LevelColours> {
        let (levels, colours) = (self.levels?, self.colours?);
        let leaves = self.pages.total().div_ceil(u64::from(self.leaf_entries.max(1)));
        let end = self.levels_offset().saturating_sub(LEAF_RECORD as u64 * leaves);
        (levels.count > 0).then(|| LevelColours::new(levels.count, self.colours_offset(), end, colours.plan))
    }

    /// Offset of the pages (bytes).
    pub fn pages_offset(&self) -> u64 {
        self.bytes.head
    }

    /// Offset of the colours, where the pages end (bytes).
    pub fn colours_offset(&self) -> u64 {
        self.bytes.head + self.bytes.pages
    }

    /// Offset of the overview levels (bytes).
    pub fn levels_offset(&self) -> u64 {
        self.colours_offset() + self.bytes.colours
    }

    /// Offset of the leaf directories (bytes).
    pub fn directory_offset(&self) -> u64 {
        self.levels_offset() + self.bytes.levels
    }

    /// Offset of the metadata block (bytes).
    pub fn metadata_offset(&self) -> u64 {
        self.directory_offset() + self.bytes.directory
    }
}
