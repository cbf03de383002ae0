//! Requests: pages that somebody waits for, and what became of them.

use super::cache::{Claim, Order};
use super::fetch::Time;
use super::loader::{Loader, Turn};
use crate::Result;
use crate::frame::PageKey;
use std::time::Duration;

/// How long a request waits for views to be dropped, if these hold the room that it needs.
const PATIENCE: Duration = Duration::from_millis(100);

/// Names a [`request`](Loader::request).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(u64);

/// What became of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct LoadReport {
    /// Pages loaded meanwhile.
    pub loaded: usize,
    /// Pages asked for that were in memory already.
    pub already: usize,
    /// Pages dropped to make room.
    pub evicted: usize,
    /// Pages asked for that found no room.
    pub left_out: usize,
    /// A budget in which all pages asked for have room at once (bytes).
    pub needed_bytes: usize,
}

#[derive(Debug)]
pub(super) struct Request {
    pub order: Order,
    since: Time,
    absent: usize,
    evicted: u64,
}

impl Loader {
    /// Asks for these pages before all others, nearest to `around` first, and for an [`outcome`](Self::outcome): when all
    /// are there, one failed, or the rest finds no room. Unknown keys hold no matter and need no page. Pages that no hint
    /// needs now make room, farthest first.
    pub fn request(&mut self, keys: &[PageKey], around: PageKey) -> RequestId {
        let id = RequestId(self.name());
        match &self.cache {
            Some(_) => self.admit(id, keys, around),
            None => self.early.push((id, keys.to_vec(), around)),
        }
        id
    }

    /// What became of a request, told once; `None` while it is under way.
    pub fn outcome(&mut self, request: RequestId) -> Option<Result<LoadReport>> {
        self.ended.remove(&request)
    }

    /// Begins with a request, as the table of pages is there.
    pub(super) fn admit(&mut self, id: RequestId, keys: &[PageKey], around: PageKey) {
        let Some(cache) = &self.cache else { return };
        let order = Order::explicit(cache.index(), keys, around);
        let (absent, evicted) = (cache.absent(&order), self.counters.evicted);
        self.requests.insert(id, Request { order, since: self.now, absent, evicted });
    }

    /// The next step of a request.
    pub(super) fn request_turn(&mut self, id: RequestId, now: Time) -> Turn {
        let now = self.at(now);
        if let Some(outcome) = self.ended.remove(&id) {
            return Turn::Ended(outcome);
        }
        let (Some(cache), Some(request)) = (&mut self.cache, self.requests.get_mut(&id)) else { return Turn::Busy };
        match cache.claim(&mut request.order, now, &mut self.counters) {
            Claim::Run(run) => return Turn::Fetch(self.launch(run, Some(id))),
            Claim::Busy => return Turn::Busy,
            // What is on its way takes room that it gives back.
            Claim::NoRoom(_) if self.flights.values().any(|flight| flight.request == Some(id)) => return Turn::Busy,
            Claim::NoRoom(true) if now < request.since + PATIENCE => return Turn::NoRoom(true),
            Claim::Done | Claim::NoRoom(_) => {}
        }
        let left_out = cache.absent(&request.order);
        let report = LoadReport {
            loaded: request.absent.saturating_sub(left_out),
            already: request.order.pages.len() - request.absent,
            evicted: (self.counters.evicted - request.evicted) as usize,
            left_out,
            needed_bytes: cache.needed_bytes(&request.order),
        };
        self.requests.remove(&id);
        Turn::Ended(Ok(report))
    }
}
