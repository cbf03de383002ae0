//! Pages in memory, and how queries find them.
//!
//! In: pages from memory or from an archive. Out: a [`PageSet`], the only type that queries know. Memory: a [`Store`]
//! holds all pages; a [`Loader`] holds those around moving bodies, under a budget that covers everything it allocates.
//! A [`Stream`] is a loader with its own thread.
//!
//! ```text
//! hints, requests → Loader: start (head, leaves) → Index (all pages) → outlook (pages by time to need) → cache (claim, settle)
//!        driver: fetches bytes, decodes (Decode → Decoded)                    View (index + newest snapshot) ← publish ┘
//! ```
//!
//! A query takes no lock, does no I/O and allocates nothing (guarantee G8): it visits slots, and a slot either holds
//! its page or knows in which slices the page is occupied.

mod account;
mod by_id;
mod cache;
mod colours;
mod edited;
mod fetch;
mod held;
mod loader;
mod missing;
mod outlook;
mod publish;
mod request;
mod snapshot;
mod start;
#[cfg(not(target_family = "wasm"))]
mod stream;
mod sync;
mod table;
mod tally;

pub use cache::Views;
pub use colours::ColourLoader;
pub use fetch::{Decode, Decoded, Fetch, FetchId, Next, PageError, Time};
pub use held::{Store, StoreSlot};
pub use loader::{BodyId, Loader, LoaderOptions};
pub use missing::{MISSING_KEYS, Missing};
pub(crate) use missing::{join, note};
pub use outlook::Outlook;
pub use request::{LoadReport, RequestId};
pub use snapshot::{View, ViewSlot};
#[cfg(not(target_family = "wasm"))]
pub use stream::{PawnHandle, Prefetch, Step, Stream, StreamOptions};
pub use table::KeyBounds;
pub use tally::Counters;

use crate::frame::Frame;
use crate::slice::Page;

/// A set of pages as queries see it. Space outside its pages is free.
///
/// Implementations answer from memory at once: no lock, no I/O, no allocation.
pub trait PageSet {
    /// Slot of one page.
    type Slot: PageSlot;

    /// Returns the grid of all pages.
    fn frame(&self) -> &Frame;

    /// Returns the bounds of all keys; `None` if there are no pages.
    fn bounds(&self) -> Option<KeyBounds>;

    /// Returns the slots of tile column (`tx`, `ty`), lowest layer first; empty if the scan has no page there.
    fn column(&self, tx: i32, ty: i32) -> &[Self::Slot];

    /// Returns whether any tile column of region (`rx`, `ry`), the 64 × 64 tiles that begin at (`64·rx`, `64·ry`), has
    /// a slot. `true` is always safe; long rays skip regions without slots.
    fn has_region(&self, rx: i32, ry: i32) -> bool;

    /// Returns the approximate memory of the pages in memory (bytes), 0 if unknown. Batches of queries are ordered by
    /// place if this exceeds the processor's caches.
    fn weight_hint(&self) -> usize {
        0
    }

    /// Returns the number of tile columns with at least one slot.
    fn column_count(&self) -> usize;

    /// Returns tile column `number` (`0..column_count()`) as `(tx, ty, slots)`, in any fixed order.
    fn column_at(&self, number: usize) -> (i32, i32, &[Self::Slot]);
}

/// Slot of one page: properties known without loading it, and the page itself if it is in memory.
pub trait PageSlot {
    /// Returns the layer of the page.
    fn layer(&self) -> i32;

    /// Returns the occupied slices of the page as a mask, known even if the page is not in memory.
    fn slices(&self) -> u64;

    /// Returns the page if it is in memory.
    fn page(&self) -> Option<&Page>;
}
