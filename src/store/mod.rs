//! Pages in memory, and how queries find them.
//!
//! In: pages from memory or from an archive. Out: a [`Snapshot`], the only set of pages that queries know. Memory: a
//! resident snapshot holds all pages; a [`Loader`] holds those around moving bodies, under a budget that covers
//! everything it allocates. A [`Stream`] is a loader with its own thread.
//!
//! ```text
//! hints, requests → Loader: start (head, leaves) → Index (all pages) → outlook (pages by time to need) → cache (claim, settle)
//!        driver: fetches bytes, decodes (Decode → Decoded)               Snapshot (table + newest slots) ← publish ┘
//! ```
//!
//! A query takes no lock, does no I/O and allocates nothing (guarantee G8): it visits slots, and a slot either holds
//! its page or knows in which slices the page is occupied.

mod account;
mod by_id;
mod cache;
mod colours;
mod fetch;
mod index;
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

pub use cache::Snapshots;
pub use colours::ColourLoader;
pub use fetch::{Decode, Decoded, Fetch, FetchId, Next, PageError, Time};
pub use loader::{BodyId, Loader, LoaderOptions};
pub use missing::{MISSING_KEYS, Missing};
pub(crate) use missing::{join, note};
pub use outlook::Outlook;
pub use request::{LoadReport, RequestId};
pub use snapshot::{PageSlot, Snapshot};
#[cfg(not(target_family = "wasm"))]
pub use stream::{PawnHandle, Prefetch, Step, Stream, StreamOptions};
pub use table::KeyBounds;
pub use tally::Counters;
