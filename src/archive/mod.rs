//! The slice archive: one file of pages under a directory (`spec/slice-archive.md`; files here follow its chapters).
//!
//! In: pages in ascending [`PageKey`](crate::frame::PageKey) order. Out: a file that appears complete under its name or
//! not at all, and from it the pages again, by key, in at most three reads (head, directory leaf, page). Memory: the
//! writer holds a few MiB however large the archive ([`ArchiveWriter`]); a reader holds the root directory
//! (at most 16 KiB) and one leaf.

mod head;

mod directory;

mod page;

mod metadata;

mod matter;

mod colours;

mod colour_check;

mod levels;

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

mod extract;

mod salvage;

mod recover;

pub use catalog::Catalog;
pub use colours::{ColourEntry, ColourHead, ColourReader, ColourTable, EncodedColours};
pub use directory::{Content, Extent, PageEntry, Storage};
pub use extract::{Extracted, extract};
pub use head::{Bounds, Header, Pages, Sections, Tiles, Voxels};
pub use levels::{Level, Levels};
pub use merge::{Merged, merge, merge_run};
pub use metadata::MAX_UNITS;
pub use opening::{Opened, Opening};
pub use page::{EncodedPage, PageDecoder, PageEncoder};
pub use reader::{Archive, PageReader};
pub use recover::{Recovered, recover};
pub use shard::{InputRead, MAX_SHARDS, Shard};
pub use verify::{Finding, LISTED, VerifySummary};
pub use writer::{ArchiveWriter, Totals};

/// Version of the format that is written, and the latest that is read: major, minor.
pub const FORMAT_VERSION: (u16, u16) = (1, 0);

#[cfg(test)]
mod tests;
