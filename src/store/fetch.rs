//! Messages between a [`Loader`](super::Loader) and its driver: bytes to fetch, bytes to decode, reports.

use super::budget::Reservation;
use super::cache::PageRun;
use super::colour_queue::{ColourRun, decode_blocks};
use super::index::Index;
use super::snapshot::Snapshot;
use crate::archive::{Catalog, ColourEntry, PageDecoder, PageEntry};
use crate::frame::PageKey;
use crate::page::{Colours, Page, PageSize};
use crate::{Error, Result};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// A moment, as the time since an origin that the driver chooses. Time never runs back: an earlier value counts as the
/// latest one passed before.
pub type Time = Duration;

/// Identifier of one fetch of a loader; never reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FetchId(pub(super) u64);

/// Content that a fetch is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Payload {
    /// Pages, or the head or directory of the archive.
    Pages,
    /// Colours of pages: fetched one range at a time while no page is, and given up while a body waits for a page.
    Colours,
}

/// Bytes of the archive to fetch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fetch {
    /// Identifier to pass back with the answer.
    pub id: FetchId,
    /// Content of the bytes.
    pub what: Payload,
    /// Byte range; never empty.
    pub range: Range<u64>,
    /// Time until a body may need the bytes; zero if it is waiting already. No body needs colours.
    pub needed_in: Duration,
}

/// Next action of a driver.
#[derive(Debug)]
pub enum Next {
    /// Fetch these bytes, then call [`given`](super::Loader::given) or [`failed`](super::Loader::failed).
    Fetch(Fetch),
    /// Give up this fetch and drop its bytes: its pages are no longer wanted. An answer that arrives anyway is ignored.
    Cancel(FetchId),
    /// A page could not be loaded.
    Report(PageError),
    /// Nothing to do until bytes arrive, a command is given, or this moment.
    Wait(Option<Time>),
}

/// Next step of the loader for one order of pages, or for a driver that works for one order alone.
#[derive(Debug)]
pub(super) enum Turn<T = Fetch> {
    Fetch(T),
    /// Nothing to do until there is news, or until failed pages may be tried again.
    Idle,
    /// Everything left is in flight.
    Busy,
    /// The rest does not fit in the budget; `true` if it may fit once snapshots are dropped.
    NoRoom(bool),
}

/// A page that could not be loaded. It stays "not loaded" in every view.
#[derive(Debug)]
#[non_exhaustive]
pub struct PageError {
    /// The page.
    pub key: PageKey,
    /// Cause: bytes that cannot be read, or a violated rule of the format.
    pub error: Error,
}

/// Fetched bytes to decode, on any thread; pass the result to [`Loader::loaded`](super::Loader::loaded).
///
/// The scratch memory of decoding is reserved in the budget when the fetch begins.
#[derive(Debug)]
#[must_use = "run it, and hand the result to `Loader::loaded`"]
pub struct Decode {
    pub(super) id: FetchId,
    pub(super) bytes: Vec<u8>,
    pub(super) work: Work,
}

#[derive(Debug)]
pub(super) enum Work {
    /// Adjacent directory leaves.
    Leaves(Arc<Catalog>, Range<usize>),
    /// Pages by number, from bytes that begin at this offset of the archive.
    Pages(Arc<Index>, u64, Vec<u32>),
    /// Colours of pages in memory, likewise.
    Colours(Snapshot, u64, Vec<(PageKey, ColourEntry)>),
}

/// Result of a [`Decode`].
#[derive(Debug)]
#[must_use = "hand it to `Loader::loaded`"]
pub struct Decoded {
    pub(super) id: FetchId,
    pub(super) made: Made,
}

#[derive(Debug)]
pub(super) enum Made {
    Leaves(Result<Vec<PageEntry>>),
    Pages(Vec<Result<Page>>),
    Colours(Vec<(PageKey, Result<Colours>)>),
}

/// Bytes in flight or being decoded, with the memory reserved for them.
#[derive(Debug)]
pub(super) struct Flight {
    pub range: Range<u64>,
    pub cargo: Cargo,
    pub since: Time,
    pub is_decoding: bool,
}

#[derive(Debug)]
pub(super) enum Cargo {
    /// Head or footer.
    Head,
    /// Adjacent directory leaves.
    Leaves {
        leaves: Range<usize>,
        _room: Reservation,
    },
    Pages(PageRun),
    Colours(ColourRun),
}

/// Pauses after failures to fetch the same bytes: 0.1 s, then 0.2 s and so on up to 6.4 s.
#[derive(Debug, Default)]
pub(super) struct Retry {
    tries: u32,
    /// `Time::MAX` for a lasting failure.
    at: Time,
}

impl Retry {
    /// Notes a failure; damaged bytes stay damaged, so only errors of reading are worth another try.
    pub fn failed(&mut self, error: &Error, now: Time) {
        let pause = Duration::from_millis(100) * (1 << self.tries.min(6));
        self.at = if matches!(error, Error::Io { .. }) { now + pause } else { Time::MAX };
        self.tries += 1;
    }

    pub fn is_due(&self, now: Time) -> bool {
        self.at <= now
    }

    /// Returns when to try again; `None` after a lasting failure or none at all.
    pub fn at(&self) -> Option<Time> {
        Some(self.at).filter(|at| *at > Time::ZERO && *at < Time::MAX)
    }
}

/// Returns the error of an answer of `found` bytes to a fetch of `range`.
pub(super) fn wrong_length(range: &Range<u64>, found: usize) -> Error {
    let action = format!("read {} bytes at {}, of which {found} came", range.end - range.start, range.start);
    Error::io("archive", action, std::io::ErrorKind::UnexpectedEof.into())
}

impl Decode {
    /// Decodes the bytes, in about 0.1 ms a page, or 0.3 ms for the colours of one. Damage becomes part of the result.
    pub fn run(self) -> Decoded {
        let made = match self.work {
            Work::Leaves(catalog, leaves) => Made::Leaves(leaves_of(&catalog, leaves, &self.bytes)),
            Work::Pages(index, start, pages) => {
                let sizes = pages.iter().map(|page| index.entry(*page).size);
                let largest = sizes.max_by_key(|size| size.words()).unwrap_or(PageSize::UNIFORM);
                let mut decoder = PageDecoder::for_size(largest, index.ignores_inferred());
                let decode = |page: &u32| {
                    let (entry, own) = (index.entry(*page), index.entry(*page).bytes());
                    let from = own.start.saturating_sub(start) as usize;
                    decoder.decode(entry, &self.bytes[from..from + (own.end - own.start) as usize])
                };
                Made::Pages(pages.iter().map(decode).collect())
            }
            Work::Colours(pages, start, blocks) => Made::Colours(decode_blocks(&pages, &blocks, start, &self.bytes)),
        };
        Decoded { id: self.id, made }
    }
}

fn leaves_of(catalog: &Catalog, leaves: Range<usize>, bytes: &[u8]) -> Result<Vec<PageEntry>> {
    let start = catalog.leaf_range(leaves.start).start;
    let mut all = Vec::with_capacity(leaves.clone().map(|leaf| catalog.leaf_entries(leaf) as usize).sum());
    for leaf in leaves {
        let range = catalog.leaf_range(leaf);
        all.extend(catalog.decode_leaf(leaf, &bytes[(range.start - start) as usize..(range.end - start) as usize])?);
    }
    Ok(all)
}
