//! Slice archive: one file of pages and a directory of them. The modules follow the chapters of
//! `spec/slice-archive.md`.
//!
//! An archive takes pages in ascending [`PageKey`](crate::frame::PageKey) order. The file appears under its name when
//! it is complete, or not at all. A page is read by its key in at most three reads: head, directory leaf, page.
//!
//! Memory: the writer holds a few MiB however large the archive is ([`ArchiveWriter`]); a reader holds the root
//! directory (at most 16 KiB in the file) and one leaf.

mod head;

mod directory;

mod page_coding;

mod metadata;

mod solid_bounds;

mod colour_section;

mod colour_check;

mod levels;

mod seen;

mod shard;

mod dedup;

mod spill;

mod writer;

mod catalog;

mod opening;

mod reader;

mod runs;

mod verify;

mod merge;

mod copy;

mod region;

mod edited;

mod extract;

mod replace;

mod salvage;

mod recover;

pub use catalog::Catalog;
pub use colour_section::{ColourEntry, ColourHead, ColourReader, ColourTable, EncodedColours};
pub use directory::{Content, Extent, PageEntry, Storage};
pub(crate) use edited::{each_edited_page, edited_pages};
pub use extract::{Extracted, extract};
pub use head::{Bounds, Header, Pages, Sections, Tiles, Voxels};
pub use levels::{Level, Levels};
pub use merge::{Merged, merge, merge_run};
pub use metadata::MAX_UNITS;
pub use opening::{Opened, Opening};
pub use page_coding::{EncodedPage, PageDecoder, PageEncoder};
pub use reader::{Archive, PageReader};
pub use recover::{Recovered, recover};
pub use replace::{Replaced, replace};
pub(crate) use runs::joined;
pub use seen::SeenTable;
pub use shard::{InputRead, MAX_SHARDS, Shard};
pub use verify::{Finding, LISTED, VerifySummary};
pub use writer::{ArchiveWriter, Totals};

/// Format version that is written, and the newest that is read: (major, minor).
pub const FORMAT_VERSION: (u16, u16) = (1, 0);

#[cfg(test)]
mod tests;
