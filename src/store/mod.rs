//! Which pages are in memory, and how queries find them.
//!
//! In: pages from memory or from an archive. Out: a [`PageSet`], the only thing that queries know. Memory: a [`Store`]
//! holds all pages; a [`Loader`] holds those around moving bodies under a budget, in which everything counts. A
//! [`Stream`] is a loader with a thread of its own.
//!
//! ```text
//! hints, requests → Loader: start (head, leaves) → Index (all pages) → outlook (pages by time to need) → cache (claim, settle)
//!        driver: fetches bytes, decodes (Decode → Decoded)                    View (index + newest snapshot) ← publish ┘
//! ```
//!
//! A query takes no lock, does no I/O and allocates nothing (guarantee G8): it walks over slots, and a slot either
//! holds its page or says in which slices the page has matter.

mod account;
mod by_id;
mod cache;
mod colours;
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

    /// About how many bytes the pages in memory have, 0 if that is not known: batches of queries look ahead where these exceed the
    /// processor's caches.
    fn weight_hint(&self) -> usize {
        0
    }

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
