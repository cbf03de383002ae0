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
    absent: usize,
    evicted: u64,
    /// Whether it lacks room that others give back; meanwhile nobody behind it fetches.
    lacks_room: bool,
    /// Since when it waits for views alone.
    waits_since: Option<Time>,
}

impl Loader {
    /// Asks for these pages before all others, nearest to `around` first, and for an [`outcome`](Self::outcome): when all
    /// are there, one failed, or the rest finds no room. Unknown keys hold no matter and need no page. Pages that neither a hint
    /// needs now nor an earlier request asks for make room, farthest first. Before it does without a page it waits for all that is on
    /// its way, and for views to be dropped, these for 0.1 s; hints and later requests fetch nothing meanwhile.
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
        self.requests.insert(id, Request { order, absent, evicted, lacks_room: false, waits_since: None });
        self.stale = true;
    }

    /// Whether a request before this one, or before the hints, lacks room.
    pub(super) fn gives_way(&self, id: Option<RequestId>) -> bool {
        self.requests.iter().any(|(other, request)| request.lacks_room && id.is_none_or(|id| *other < id))
    }

    /// The next step of a request.
    pub(super) fn request_turn(&mut self, id: RequestId, now: Time) -> Turn {
        let now = self.at(now);
        if let Some(outcome) = self.ended.remove(&id) {
            return Turn::Ended(outcome);
        }
        if self.gives_way(Some(id)) {
            return Turn::NoRoom(false);
        }
        let (Some(cache), Some(mut request)) = (&mut self.cache, self.requests.remove(&id)) else { return Turn::Busy };
        let stays = |page| self.requests.iter().any(|(other, earlier)| *other < id && earlier.order.wants(page));
        let mut claim = cache.claim(&mut request.order, &stays, now, &mut self.counters);
        if matches!(claim, Claim::Done) && cache.absent(&request.order) > 0 {
            // An earlier request took the room of what was there.
            request.order.restart();
            claim = cache.claim(&mut request.order, &stays, now, &mut self.counters);
        }
        request.lacks_room = matches!(claim, Claim::NoRoom(_));
        // What is on its way takes room that it gives back, and so does what an earlier request waits for.
        let comes = !self.flights.is_empty() || self.requests.iter().any(|(other, _)| *other < id);
        let turn = match claim {
            Claim::Run(run) => Turn::Fetch(self.launch(run)),
            Claim::Busy => Turn::Busy,
            Claim::NoRoom(_) if comes => Turn::NoRoom(false),
            Claim::NoRoom(true) if now < *request.waits_since.get_or_insert(now) + PATIENCE => {
                self.requests.insert(id, request);
                return Turn::NoRoom(true);
            }
            Claim::Done | Claim::NoRoom(_) => {
                let left_out = cache.absent(&request.order);
                self.stale = true;
                return Turn::Ended(Ok(LoadReport {
                    loaded: request.absent.saturating_sub(left_out),
                    already: request.order.pages.len() - request.absent,
                    evicted: (self.counters.evicted - request.evicted) as usize,
                    left_out,
                    needed_bytes: cache.needed_bytes(&request.order),
                }));
            }
        };
        request.waits_since = None;
        self.requests.insert(id, request);
        turn
    }
}
