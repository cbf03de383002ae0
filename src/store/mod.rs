//! Which pages are in memory, and how queries find them.
//!
//! In: pages from memory or from a [`PageSource`] (an archive). Out: a [`PageSet`], the only thing that queries know.
//! Memory: [`Store::from_pages`] holds everything; [`Store::with_budget`] holds pages of at most a given weight, and
//! 24 bytes for every page that the source has, loaded or not. A [`Stream`] holds pages around moving bodies under a
//! budget, and loads them ahead on a thread of its own.
//!
//! ```text
//! archive → Index (all pages, immutable) ┬→ motion (hints → pages by time to need) → loader (claim, read, settle)
//!                                        └→ View (index + snapshot) ← publish (newest snapshot) ← ┘
//! ```
//!
//! A query takes no lock, does no I/O and allocates nothing (guarantee G8): it walks over slots, and a slot either
//! holds its page or says in which slices the page has matter.

mod account;
mod budget;
mod columns;
mod held;
mod loader;
mod missing;
mod motion;
mod publish;
mod snapshot;
mod stream;
mod sync;
mod tally;

pub use budget::{LoadReport, Region};
pub use columns::KeyBounds;
pub use held::{Store, StoreSlot};
pub use loader::PageError;
pub use missing::{MISSING_KEYS, Missing};
pub(crate) use missing::{join, note};
pub use motion::Motion;
pub use snapshot::{View, ViewSlot};
pub use stream::{Pawn, Prefetch, Step, Stream, StreamOptions};
pub use tally::Counters;

use crate::archive::{Archive, PageEntry};
use crate::frame::{Frame, PageKey};
use crate::slice::Page;
use crate::{Error, Result};

/// A set of pages as queries see it. Pages that it does not name hold no matter.
///
/// Implementations answer from memory at once: no lock, no I/O, no allocation.
pub trait PageSet {
    /// Place of one page.
    type Slot: PageSlot;

    /// The grid of all pages.
    fn frame(&self) -> &Frame;

    /// Bounds of all keys; `None` if there are no pages.
    fn bounds(&self) -> Option<KeyBounds>;

    /// The slots of tile column (`tx`, `ty`), lowest layer first; empty where the scan has no matter.
    fn column(&self, tx: i32, ty: i32) -> &[Self::Slot];

    /// Whether some tile column of the region of 64 × 64 tiles with tiles `64·rx .. 64·(rx+1)` has a slot; `true` is
    /// always safe. Long rays leap over regions without.
    fn has_region(&self, rx: i32, ry: i32) -> bool;

    /// Number of tile columns with at least one slot.
    fn column_count(&self) -> usize;

    /// Tile columns by number `0..column_count()`: `(tx, ty, slots)`, in any fixed order.
    fn column_at(&self, number: usize) -> (i32, i32, &[Self::Slot]);
}

/// Place of one page: what is known about it without loading, and the page if it is in memory.
pub trait PageSlot {
    /// Layer of the page.
    fn layer(&self) -> i32;

    /// Slices in which the page has matter, as a mask; known whether the page is in memory or not.
    fn slices(&self) -> u64;

    /// The page, if it is in memory.
    fn page(&self) -> Option<&Page>;
}

/// What a [`PageSource`] knows about a page without loading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageInfo {
    /// Name of the page.
    pub key: PageKey,
    /// Slices with matter, as a mask. A slice with matter that is missing here makes queries answer "clear" wrongly.
    pub slices: u64,
    /// Upper bound of [`Page::weight_bytes`] once loaded (bytes).
    pub weight_bytes: usize,
}

/// Where pages come from: an archive, or a test's memory.
pub trait PageSource: Send + Sync {
    /// The grid of all pages.
    fn frame(&self) -> &Frame;

    /// All pages, each once, in any order.
    fn infos(&self) -> Result<Vec<PageInfo>>;

    /// Loads one page. May block; fails when the bytes cannot be read or are damaged.
    fn load(&self, key: PageKey) -> Result<Page>;
}

impl PageSource for Archive {
    fn frame(&self) -> &Frame {
        self.frame()
    }

    fn infos(&self) -> Result<Vec<PageInfo>> {
        let info =
            |entry: PageEntry| PageInfo { key: entry.key, slices: entry.slices, weight_bytes: entry.weight_bytes() };
        self.entries().map(|entry| entry.map(info)).collect()
    }

    fn load(&self, key: PageKey) -> Result<Page> {
        match self.find(key)? {
            Some(entry) => self.page(&entry),
            None => Err(Error::parameter("page", format!("{key} is not in the archive"))),
        }
    }
}
