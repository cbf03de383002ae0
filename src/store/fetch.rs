//! What passes between a [`Loader`](super::Loader) and its driver: bytes to fetch, work to do, news.

use super::snapshot::Index;
use crate::archive::{Catalog, PageDecoder, PageEntry};
use crate::frame::PageKey;
use crate::slice::{Page, PageSize};
use crate::{Error, Result};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// A moment: the time since one that the driver chose. Never runs back: an earlier one counts as the last.
pub type Time = Duration;

/// Names one fetch of a loader, and never another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FetchId(pub(super) u64);

/// Bytes of the archive to fetch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fetch {
    /// To be named with the answer.
    pub id: FetchId,
    /// Which bytes; never none.
    pub range: Range<u64>,
    /// Time until a body may need them (s); zero if it waits already.
    pub needed_in: Duration,
}

/// What a driver should do next.
#[derive(Debug)]
pub enum Next {
    /// Fetch these bytes, then say [`given`](super::Loader::given) or [`failed`](super::Loader::failed).
    Fetch(Fetch),
    /// Give this fetch up, and its bytes with it: nobody wants them any more. An answer that comes all the same is ignored.
    Cancel(FetchId),
    /// A page could not be loaded.
    Report(PageError),
    /// Nothing until there is news, a command, or this moment.
    Wait(Option<Time>),
}

/// A page that could not be loaded. It stays "not loaded" in every view.
#[derive(Debug)]
#[non_exhaustive]
pub struct PageError {
    /// The page.
    pub key: PageKey,
    /// Why: bytes that cannot be read, or a rule of the format that they break.
    pub error: Error,
}

/// Fetched bytes, to be decoded on any thread; what comes of it goes back by [`Loader::loaded`](super::Loader::loaded).
///
/// The scratch memory of decoding is reserved in the budget from the fetch on.
#[derive(Debug)]
#[must_use = "run it, and hand the result to `Loader::loaded`"]
pub struct Decode {
    pub(super) id: FetchId,
    pub(super) bytes: Vec<u8>,
    pub(super) work: Work,
}

#[derive(Debug)]
pub(super) enum Work {
    /// Directory leaves that lie together.
    Leaves(Arc<Catalog>, Range<usize>),
    /// Pages by number, from bytes that begin at this offset of the archive.
    Pages(Arc<Index>, u64, Vec<u32>),
}

/// What a [`Decode`] made of its bytes.
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
}

impl Decode {
    /// Decodes: about 0.1 ms a page. Damage becomes part of the result.
    pub fn run(self) -> Decoded {
        let made = match self.work {
            Work::Leaves(catalog, leaves) => Made::Leaves(leaves_of(&catalog, leaves, &self.bytes)),
            Work::Pages(index, start, pages) => {
                let sizes = pages.iter().map(|page| index.entry(*page).size);
                let largest = sizes.max_by_key(|size| size.words()).unwrap_or(PageSize::UNIFORM);
                let mut decoder = PageDecoder::for_size(largest);
                decoder.set_ignore_inferred(index.ignores_inferred());
                let decode = |page: &u32| {
                    let entry = index.entry(*page);
                    let extent = entry.extent().map_or(0..0, |extent| {
                        let from = (extent.offset - start) as usize;
                        from..from + extent.len as usize
                    });
                    decoder.decode(entry, &self.bytes[extent])
                };
                Made::Pages(pages.iter().map(decode).collect())
            }
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
