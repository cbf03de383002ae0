//! Pages in memory, and how queries find them.
//!
//! In: pages from memory or from an archive. Out: a [`Snapshot`], the only set of pages that queries know. Memory: a
//! resident snapshot holds all pages; a [`Loader`] holds those around moving bodies, under a budget that covers
//! everything it allocates. A [`Stream`] is a loader with its own thread.
//!
//! ```text
//! hints, requests → Loader: start (head, leaves) → Index (all pages) → motion_hint (pages by time to need) → cache (claim, settle)
//!        driver: fetches bytes, decodes (Decode → Decoded)               Snapshot (table + newest slots) ← publish ┘
//! ```
//!
//! A query takes no lock, does no I/O and allocates nothing (guarantee G8): it visits slots, and a slot either holds
//! its page or knows in which slices the page is occupied.

mod budget;
mod cache;
mod colour_queue;
mod counters;
mod directory_loader;
mod edited;
mod fetch;
mod id_map;
mod index;
mod loader;
mod missing;
mod motion_hint;
mod publish;
mod request;
mod snapshot;
#[cfg(not(target_family = "wasm"))]
mod stream;
mod sync;
mod table;
#[cfg(test)]
mod tests;

pub use cache::Snapshots;
pub use counters::Counters;
pub use fetch::{Decode, Decoded, Fetch, FetchId, Next, PageError, Payload, Time};
pub use loader::{BodyId, Loader, LoaderOptions};
pub use missing::{MISSING_KEYS, Missing};
pub(crate) use missing::{join, note};
pub use motion_hint::MotionHint;
pub use request::{LoadReport, RequestId};
pub use snapshot::{PageSlot, Snapshot};
#[cfg(not(target_family = "wasm"))]
pub use stream::{PawnHandle, Prefetch, Step, Stream, StreamOptions};
pub use table::KeyBounds;
