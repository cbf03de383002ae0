//! Requests: pages for which a caller waits, and their outcomes.

use super::cache::Order;
use super::fetch::{Time, Turn};
use super::loader::{Loader, page_runs};
use crate::Result;
use crate::frame::PageKey;
use std::time::Duration;

/// Time that a request waits for snapshots to be dropped if they hold the memory that it needs.
const PATIENCE: Duration = Duration::from_millis(100);

/// Identifier of a [`request`](Loader::request).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(u64);

/// The request that stands for all hints, after all others; it never ends.
pub(super) const HINTS: RequestId = RequestId(u64::MAX);

/// Outcome of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct LoadReport {
    /// Requested pages that were loaded.
    pub loaded: usize,
    /// Requested pages that were in memory already.
    pub already: usize,
    /// Pages evicted meanwhile to make room.
    pub evicted: usize,
    /// Requested pages that did not fit in the budget.
    pub left_out: usize,
    /// Budget in which all requested pages fit at once (bytes).
    pub needed_bytes: usize,
}

#[derive(Debug, Default)]
pub(super) struct Request {
    pub order: Order,
    absent: usize,
    evicted: u64,
    /// True while it waits for memory that others will release; later requests and hints then fetch nothing.
    lacks_room: bool,
    /// Since when it waits only for snapshots.
    waits_since: Option<Time>,
}

impl Request {
    pub fn hinted(order: Order) -> Self {
        Self { order, ..Self::default() }
    }
}

impl Loader {
    /// Requests these pages before all others, nearest to `around` first. The [`outcome`](Self::outcome) is ready when
    /// all are in memory, one has failed, or the rest does not fit. Unknown keys are ignored, because they have no
    /// page. Evicts pages that neither a hint needs now nor an earlier request wants, farthest first. Before it leaves
    /// out a page, the request waits for everything in flight and up to 0.1 s for snapshots to be dropped; meanwhile, hints
    /// and later requests fetch nothing.
    pub fn request(&mut self, keys: &[PageKey], around: PageKey) -> RequestId {
        let id = RequestId(self.name());
        match &self.cache {
            Some(_) => self.admit(id, keys, around),
            None => self.early.push((id, keys.to_vec(), around)),
        }
        id
    }

    /// Returns the outcome of a request, once; `None` while it is in progress.
    pub fn outcome(&mut self, request: RequestId) -> Option<Result<LoadReport>> {
        self.ended.remove(&request)
    }

    /// Begins a request once the table of pages is loaded.
    pub(super) fn admit(&mut self, id: RequestId, keys: &[PageKey], around: PageKey) {
        let Some(cache) = &self.cache else { return };
        let order = Order::explicit(cache.index(), keys, around);
        let (absent, evicted) = (cache.absent(&order), self.counters.evicted);
        self.requests.insert(id, Request { order, absent, evicted, ..Request::default() });
        self.stale = true;
    }

    /// Returns the next step of a request, which is idle once it has an outcome.
    pub(super) fn request_turn(&mut self, id: RequestId, now: Time) -> Turn {
        let now = self.at(now);
        if self.ended.get(&id).is_some() {
            return Turn::Idle;
        }
        if self.requests.iter().any(|(other, request)| *other < id && request.lacks_room) {
            return Turn::Busy;
        }
        let (Some(cache), Some(mut request)) = (&mut self.cache, self.requests.remove(&id)) else { return Turn::Busy };
        let stays = |page| self.requests.iter().any(|(other, earlier)| *other < id && earlier.order.wants(page));
        let mut claim = cache.claim(&mut request.order, &stays, now, &mut self.counters);
        if id == HINTS {
            self.requests.insert(id, request);
            return self.launched(claim);
        }
        if matches!(claim, Turn::Idle) && cache.absent(&request.order) > 0 {
            // An earlier request evicted pages that were in memory.
            request.order.restart();
            claim = cache.claim(&mut request.order, &stays, now, &mut self.counters);
        }
        request.lacks_room = matches!(claim, Turn::NoRoom(_));
        // Runs in flight release memory, and so do earlier requests when they finish.
        let comes = page_runs(&self.flights).next().is_some() || self.requests.iter().any(|(other, _)| *other < id);
        let turn = match claim {
            Turn::NoRoom(_) if comes => Turn::NoRoom(false),
            Turn::NoRoom(true) if now < *request.waits_since.get_or_insert(now) + PATIENCE => {
                self.requests.insert(id, request);
                return Turn::NoRoom(true);
            }
            Turn::Idle | Turn::NoRoom(_) => {
                let left_out = cache.absent(&request.order);
                self.stale = true;
                let report = LoadReport {
                    loaded: request.absent.saturating_sub(left_out),
                    already: request.order.pages.len() - request.absent,
                    evicted: (self.counters.evicted - request.evicted) as usize,
                    left_out,
                    needed_bytes: cache.needed_bytes(&request.order),
                };
                self.ended.insert(id, Ok(report));
                return Turn::Idle;
            }
            claim => self.launched(claim),
        };
        request.waits_since = None;
        self.requests.insert(id, request);
        turn
    }
}
