//! Loads pages ahead of moving bodies: a state machine without threads, locks, a clock or a source of bytes.

use super::budget::Budget;
use super::cache::{Cache, Order, PageRun, Snapshots};
use super::colour_queue::ColourQueue;
use super::counters::Counters;
use super::directory_loader::{Start, StartTurn};
use super::fetch::{
    Cargo, Decode, Decoded, Fetch, FetchId, Flight, Made, Next, PageError, Payload, Time, Turn, Work, wrong_length,
};
use super::id_map::IdMap;
use super::missing::Missing;
use super::motion_hint::MotionHint;
use super::request::{HINTS, LoadReport, Request, RequestId};
use super::snapshot::Snapshot;
use crate::archive::Catalog;
use crate::frame::PageKey;
use crate::page::Colours;
use crate::sort::sort;
use crate::{Error, Result};
use std::collections::{HashMap, VecDeque};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// The horizon is this many times the latency of a fetch.
const LATENCIES_AHEAD: u32 = 32;
/// Interval at which to check whether snapshots were dropped, since dropping one sends no notification.
const VIEWS_AGAIN: Duration = Duration::from_millis(1);
/// Most reports kept until the driver polls.
const REPORTS: usize = 16;

/// Options of a [`Loader`].
#[derive(Debug, Clone, PartialEq)]
pub struct LoaderOptions {
    /// Most bytes in memory at any moment: the table of pages (about 100 bytes each), pages, including those that snapshots
    /// still hold, bytes in flight, and the scratch memory of decoding them. Once colours are wanted, an eighth is for
    /// these.
    pub budget_bytes: usize,
    /// Least time to look ahead. The time is 32 times the latency of a fetch, clamped to these two limits.
    pub horizon_min: Duration,
    /// Greatest time to look ahead.
    pub horizon_max: Duration,
    /// Most bytes of one fetch, unless a single page is longer; at most an eighth of the budget.
    pub run_bytes: usize,
    /// Most fetches of pages in flight at once.
    pub fetches: usize,
}

impl LoaderOptions {
    /// Creates the default options: looks one to eight seconds ahead; four fetches at once, each of up to 256 KiB.
    pub fn new(budget_bytes: usize) -> Self {
        Self {
            budget_bytes,
            horizon_min: Duration::from_secs(1),
            horizon_max: Duration::from_secs(8),
            run_bytes: 256 << 10,
            fetches: 4,
        }
    }
}

/// Identifier of a body that gives hints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BodyId(u64);

#[derive(Debug, Default)]
struct Tracked {
    motion_hint: Option<MotionHint>,
    /// Pages needed since the last hint, and those needed since the one before.
    missing: [Option<Missing>; 2],
}

/// Keeps the pages around moving bodies in memory, under a byte budget. The loader opens the archive, decides what to
/// fetch, most urgent first, and publishes loaded pages as [`Snapshot`]s. Its owner, the driver, transfers the bytes and
/// supplies the time.
///
/// The loader has no files, threads, locks or clock. Its methods are of four kinds. **Commands** request pages
/// ([`hint`](Self::hint), [`need`](Self::need), [`forget`](Self::forget), [`request`](Self::request)) or colours
/// ([`want_colours`](Self::want_colours)). **Polling**
/// returns actions for the driver ([`poll`](Self::poll), until it returns [`Next::Wait`]). **News** reports their
/// results ([`given`](Self::given), [`failed`](Self::failed), [`loaded`](Self::loaded)). The other methods only read.
/// A sequence of calls always gives the same results.
///
/// A driver that reads from a file on its own thread:
///
/// ```
/// use slicewalk::bytes::ByteSource;
/// use slicewalk::store::{Loader, Next, Time};
///
/// /// Does everything that is due now; returns when to call it again.
/// fn drive(loader: &mut Loader, source: &dyn ByteSource, now: impl Fn() -> Time) -> slicewalk::Result<Option<Time>> {
///     loop {
///         match loader.poll(now())? {
///             Next::Fetch(fetch) => {
///                 let mut bytes = vec![0; (fetch.range.end - fetch.range.start) as usize];
///                 match source.read_at(fetch.range.start, &mut bytes) {
///                     Ok(()) => loader.given(fetch.id, bytes, now()).map(|job| loader.loaded(job.run(), now())),
///                     Err(error) => { loader.failed(fetch.id, error, now()); None }
///                 };
///             }
///             Next::Report(page) => eprintln!("{}: {}", page.key, page.error),
///             Next::Cancel(_) => {}
///             Next::Wait(until) => return Ok(until),
///         }
///     }
/// }
/// ```
///
/// Game loops hand fetches and decoding to their engine, as `examples/async` does, and take the news each frame.
///
/// Pass the result of every [`Decode`] to [`loaded`](Self::loaded); until then its pages count as in flight.
///
/// A loader that is never asked for colours reads none of their bytes. Otherwise it brings them when no page is to be
/// brought, so collision never waits for them.
pub struct Loader {
    options: LoaderOptions,
    budget: Arc<Budget>,
    pub(super) counters: Counters,
    catalog: Option<Arc<Catalog>>,
    /// Present until the directory is loaded.
    start: Option<Box<Start>>,
    pub(super) cache: Option<Box<Cache>>,
    bodies: IdMap<BodyId, Tracked>,
    /// True if the pages that the bodies want, or those that may be evicted, have changed since the last plan.
    pub(super) stale: bool,
    /// Requests in order, and [`HINTS`] last.
    pub(super) requests: IdMap<RequestId, Request>,
    /// Requests made before the directory was loaded.
    pub(super) early: Vec<(RequestId, Vec<PageKey>, PageKey)>,
    pub(super) ended: IdMap<RequestId, Result<LoadReport>>,
    pub(super) flights: IdMap<FetchId, Flight>,
    pub(super) colours: Option<Box<ColourQueue>>,
    reports: VecDeque<PageError>,
    latency: Duration,
    pub(super) now: Time,
    names: u64,
}

impl Loader {
    /// Begins with an archive of which at most the length is known (bytes); the loader also fetches the head and the
    /// directory.
    pub fn open(file_len: Option<u64>, options: LoaderOptions) -> Self {
        let budget = Budget::new(options.budget_bytes);
        Self::begin(Start::new(file_len), budget, options)
    }

    /// Begins with an open archive; the loader also fetches the directory.
    ///
    /// Fails if the table of its pages alone exceeds the budget.
    pub fn new(catalog: Catalog, options: LoaderOptions) -> Result<Self> {
        let budget = Budget::new(options.budget_bytes);
        Ok(Self::begin(Start::with(catalog, &budget)?, budget, options))
    }

    fn begin(start: Start, budget: Arc<Budget>, options: LoaderOptions) -> Self {
        Self {
            options,
            budget,
            counters: Counters::default(),
            catalog: start.catalog().cloned(),
            start: Some(Box::new(start)),
            cache: None,
            bodies: IdMap::new(),
            stale: false,
            requests: IdMap::new(),
            early: Vec::new(),
            ended: IdMap::new(),
            flights: IdMap::new(),
            colours: None,
            reports: VecDeque::new(),
            latency: Duration::ZERO,
            now: Time::ZERO,
            names: 0,
        }
    }

    /// Returns the head of the archive once it is loaded.
    pub fn catalog(&self) -> Option<&Catalog> {
        self.catalog.as_deref()
    }

    #[cfg(not(target_family = "wasm"))]
    pub(super) fn budget(&self) -> &Arc<Budget> {
        &self.budget
    }

    /// Returns the pages in memory now; `None` until the directory is loaded. Answers from a snapshot do not change, and
    /// its pages stay in memory and count against the budget until it is dropped: take one per frame.
    pub fn snapshot(&self) -> Option<Snapshot> {
        Some(self.cache.as_ref()?.snapshots.newest())
    }

    /// Returns a source of snapshots for other threads, which never wait for it; `None` until the directory is loaded.
    pub fn snapshots(&self) -> Option<Snapshots> {
        Some(self.cache.as_ref()?.snapshots.clone())
    }

    /// Returns counts of the loader's work and the memory it holds.
    pub fn counters(&self) -> Counters {
        let cache = self.cache.as_ref();
        let (resident_pages, resident_bytes) = cache.map_or((0, 0), |cache| cache.resident());
        Counters {
            resident_pages,
            resident_bytes,
            used_bytes: self.budget.used(),
            peak_bytes: self.budget.peak(),
            budget_bytes: self.budget.budget(),
            table_bytes: cache.map_or(0, |cache| cache.index().weight_bytes()),
            ..self.counters
        }
    }

    /// Adds a body, which wants nothing yet.
    pub fn body(&mut self) -> BodyId {
        let id = BodyId(self.name());
        self.bodies.insert(id, Tracked::default());
        id
    }

    /// Sets how a body moves now; call it once a frame. Replaces the body's last hint and the pages that it
    /// [needed](Self::need) before that one: whichever comes first in a frame, hint or polling, pages needed in the frame
    /// before are fetched. A hint that is not finite or not in order is dropped and counted.
    pub fn hint(&mut self, body: BodyId, motion_hint: &MotionHint) {
        if !motion_hint.is_valid() {
            self.counters.hints_dropped += 1;
        } else if let Some(body) = self.bodies.get_mut(&body) {
            *body = Tracked { motion_hint: Some(*motion_hint), missing: [None, body.missing[0]] };
            self.stale = true;
        }
    }

    /// Requests pages that a query of this body missed; they precede the pages that hints want.
    pub fn need(&mut self, body: BodyId, missing: &Missing) {
        if let Some(body) = self.bodies.get_mut(&body) {
            body.missing[0] = Some(*missing);
            self.stale = true;
        }
    }

    /// Removes a body and its hints.
    pub fn forget(&mut self, body: BodyId) {
        self.stale |= self.bodies.remove(&body).is_some();
    }

    /// Returns the next action. Call it until it returns [`Next::Wait`], then again after news and commands, or at the
    /// time that `Wait` names.
    ///
    /// Fails while the archive cannot be opened. Bytes that could not be read are requested again after 0.1 s, then 0.2
    /// s and so on up to 6.4 s, as long as the driver keeps polling. An archive that breaks a rule of the format, or
    /// whose table of pages exceeds the budget, fails at every further call.
    pub fn poll(&mut self, now: Time) -> Result<Next> {
        let now = self.at(now);
        if let Some(turn) = self.begin_turn(now)? {
            return Ok(turn);
        }
        if let Some(report) = self.reports.pop_front() {
            return Ok(Next::Report(report));
        }
        self.replan(now);
        let (mut until, mut no_room) = (None, false);
        let is_full = page_runs(&self.flights).count() >= self.options.fetches;
        for id in self.requests.ids() {
            if is_full {
                no_room |= self.is_absent(id, now);
                continue;
            }
            match self.request_turn(id, now) {
                Turn::Fetch(fetch) => return Ok(Next::Fetch(fetch)),
                Turn::Idle | Turn::Busy => {}
                Turn::NoRoom(snapshots) => {
                    no_room = true;
                    until = until.or(snapshots.then_some(now + VIEWS_AGAIN));
                }
            }
        }
        if let Some(id) = self.unwanted(no_room) {
            let run = self.flights.remove(&id).map(|flight| flight.cargo);
            if let (Some(Cargo::Pages(run)), Some(cache)) = (run, &mut self.cache) {
                cache.release(run);
                self.counters.cancelled += 1;
            }
            return Ok(Next::Cancel(id));
        }
        if page_runs(&self.flights).next().is_none()
            && let Some(fetch) = self.colour_turn(now)
        {
            return Ok(Next::Fetch(fetch));
        }
        Ok(Next::Wait([until, self.retry_at()].into_iter().flatten().min()))
    }

    /// Opens the archive; returns the next action for that.
    fn begin_turn(&mut self, now: Time) -> Result<Option<Next>> {
        let Some(start) = &mut self.start else { return Ok(None) };
        let turn = start.poll(now, &self.budget, &self.flights)?;
        self.catalog = start.catalog().cloned();
        match turn {
            StartTurn::Wait(until) => Ok(Some(Next::Wait(until))),
            StartTurn::Fetch(range, cargo) => Ok(Some(Next::Fetch(self.launch(range, cargo)))),
            StartTurn::Ready(index, table) => {
                let cache = Cache::new(index, table, self.budget.clone(), self.options.run_bytes);
                (self.cache, self.start) = (Some(Box::new(cache)), None);
                let colours = self.catalog.as_ref().and_then(|catalog| ColourQueue::new(catalog, &self.budget));
                self.colours = colours.map(Box::new);
                for (id, keys, around) in std::mem::take(&mut self.early) {
                    self.admit(id, &keys, around);
                }
                self.stale = true;
                Ok(None)
            }
        }
    }

    /// Begins the fetch that an order has claimed.
    pub(super) fn launched(&mut self, claim: Turn<(Range<u64>, PageRun)>) -> Turn {
        match claim {
            Turn::Fetch((range, run)) => {
                self.counters.reads += 1;
                self.counters.read_bytes += range.end - range.start;
                Turn::Fetch(self.launch(range, Cargo::Pages(run)))
            }
            Turn::Idle => Turn::Idle,
            Turn::Busy => Turn::Busy,
            Turn::NoRoom(snapshots) => Turn::NoRoom(snapshots),
        }
    }

    /// Returns the next fetch for colours, one at a time. The caller ensures that no page could be fetched instead.
    pub(super) fn colour_turn(&mut self, now: Time) -> Option<Fetch> {
        if self.flights.values().any(|flight| matches!(flight.cargo, Cargo::Colours(_))) {
            return None;
        }
        let (cache, colours) = (self.cache.as_mut()?, self.colours.as_mut()?);
        let stays = |page| self.requests.iter().any(|(id, request)| *id < HINTS && request.order.wants(page));
        let snapshots = cache.snapshots.clone();
        let mut make_room = |bytes| cache.set_aside(bytes, &stays, &mut self.counters);
        let (range, run) = colours.claim(&snapshots, now, &mut make_room)?;
        Some(self.launch(range, Cargo::Colours(run)))
    }

    /// Returns whether the archive has colours for its pages; false until its directory is loaded.
    pub fn has_colours(&self) -> bool {
        self.colours.is_some()
    }

    /// Sets the pages that should get colours, most urgent first, and replaces the previous ones; pages that are not in
    /// memory when it is their turn get none. Does nothing until the directory is loaded, and for an archive or overview
    /// level without colours.
    ///
    /// Colours are fetched when no page is in flight or could be fetched. A fetch of colours is given up if none of its
    /// pages is wanted any longer, or a body waits for a page.
    pub fn want_colours(&mut self, keys: &[PageKey]) {
        if let (Some(colours), Some(cache)) = (&mut self.colours, &self.cache) {
            colours.want(keys, cache.index());
        }
    }

    /// Returns the colours of one page that have come; the next ones are fetched once all are taken, at most 16. Taken
    /// colours no longer count against the budget. Damaged colours are an error of their page, and so is a failure to
    /// read colours, which is tried again; geometry stays intact.
    pub fn take_colours(&mut self) -> Option<(PageKey, Result<Colours>)> {
        self.colours.as_mut()?.take()
    }

    /// Updates the pages that all hints want, if they changed or some may be tried again.
    pub(super) fn replan(&mut self, now: Time) {
        let is_due = self.hints_again().is_some_and(|again| again <= now);
        let Some(cache) = self.cache.as_mut().filter(|_| self.stale || is_due) else { return };
        let horizon =
            (self.latency * LATENCIES_AHEAD).max(self.options.horizon_min).min(self.options.horizon_max).as_secs_f64();
        let index = cache.index();
        let (mut times, mut focus) = (HashMap::new(), Vec::new());
        for body in self.bodies.values() {
            if let Some(motion_hint) = &body.motion_hint {
                motion_hint.wants(index, horizon, &mut times);
                focus.push(motion_hint.focus(index.frame()));
            }
            let missing = body.missing.iter().flatten().flat_map(|missing| missing.keys());
            times.extend(missing.filter_map(|key| Some((index.find(*key)?, 0.0))));
        }
        sort(&mut focus);
        focus.dedup();
        let hinted = Request::hinted(Order::hinted(times, focus));
        cache.replan(&hinted.order, &mut self.counters);
        self.requests.insert(HINTS, hinted);
        self.stale = false;
    }

    /// Returns when pages that hints want and that could not be read may be tried again.
    fn hints_again(&self) -> Option<Time> {
        self.requests.get(&HINTS)?.order.again
    }

    fn launch(&mut self, range: Range<u64>, cargo: Cargo) -> Fetch {
        let id = FetchId(self.name());
        let (what, needed_in) = match &cargo {
            Cargo::Pages(run) => (Payload::Pages, Duration::from_secs_f32(run.needed_in.max(0.0))),
            Cargo::Colours(_) => (Payload::Colours, Duration::MAX),
            _ => (Payload::Pages, Duration::ZERO),
        };
        self.flights.insert(id, Flight { range: range.clone(), cargo, since: self.now, is_decoding: false });
        Fetch { id, what, range, needed_in }
    }

    /// Returns whether a request wants a page that is neither in memory nor in flight.
    fn is_absent(&self, id: RequestId, now: Time) -> bool {
        let request = self.requests.get(&id).zip(self.cache.as_ref());
        request.is_some_and(|(request, cache)| cache.is_absent(&request.order, now))
    }

    /// Returns the first fetch to give up: one of pages that no order wants any longer, if others lack room, or one of
    /// colours that are no longer wanted or for which a body would wait.
    fn unwanted(&self, no_room: bool) -> Option<FetchId> {
        let wants = |page| self.requests.values().any(|request| request.order.wants(page));
        let waits = page_runs(&self.flights).any(|(_, _, run)| run.needed_in <= 0.0);
        let is_unwanted = |flight: &Flight| match &flight.cargo {
            Cargo::Pages(run) => no_room && !run.contents.iter().any(|(_, page)| wants(*page)),
            Cargo::Colours(run) => waits || !self.colours.as_ref().is_some_and(|colours| colours.wants(run)),
            _ => false,
        };
        self.flights.iter().find(|(_, flight)| !flight.is_decoding && is_unwanted(flight)).map(|(id, _)| *id)
    }

    /// Takes the bytes of a fetch and returns the work of decoding them, if there is any. Bytes of a cancelled or
    /// unknown fetch are ignored; a wrong number of bytes counts as a failed fetch.
    ///
    /// For the first fetch of an archive of unknown length, fewer bytes are allowed: they reveal its length.
    pub fn given(&mut self, id: FetchId, bytes: Vec<u8>, now: Time) -> Option<Decode> {
        let now = self.at(now);
        let flight = self.flights.get(&id).filter(|flight| !flight.is_decoding)?;
        let range = flight.range.clone();
        if bytes.len() as u64 != range.end - range.start && !matches!(flight.cargo, Cargo::Head) {
            self.failed(id, wrong_length(&range, bytes.len()), now);
            return None;
        }
        let work = match &flight.cargo {
            Cargo::Head => None,
            Cargo::Leaves { leaves, .. } => Some(Work::Leaves(self.catalog.clone()?, leaves.clone())),
            Cargo::Pages(run) => {
                self.latency = (now - flight.since).max(self.latency.mul_f64(0.95));
                let contents = run.contents.iter().map(|(content, _)| *content).collect();
                Some(Work::Pages(self.cache.as_ref()?.index().clone(), range.start, contents))
            }
            Cargo::Colours(run) => {
                let pages = self.cache.as_ref()?.snapshots.newest();
                run.blocks.clone().map(|blocks| Work::Colours(pages, range.start, blocks))
            }
        };
        if let Some(work) = work {
            self.flights.get_mut(&id)?.is_decoding = true;
            return Some(Decode { id, bytes, work });
        }
        // The rest is decoded at once: it is short, and decides what is fetched next.
        match self.flights.remove(&id)?.cargo {
            Cargo::Colours(run) => self.colours.as_mut()?.arrived(&run, &bytes, now),
            _ => self.start.as_mut()?.given(&range, &bytes, now),
        }
        None
    }

    /// Records that a fetch failed. Pages fetched together are then fetched one at a time. A page that failed alone is
    /// fetched again after 0.1 s, then 0.2 s and so on up to 6.4 s, unless the error is lasting, which is any error but
    /// [`Error::Io`].
    pub fn failed(&mut self, id: FetchId, error: Error, now: Time) {
        let now = self.at(now);
        let Some(flight) = self.flights.remove(&id) else { return };
        let leaves = match flight.cargo {
            Cargo::Head => 0..0,
            Cargo::Leaves { leaves, .. } => leaves,
            Cargo::Colours(run) => {
                if let Some(colours) = &mut self.colours {
                    colours.failed(&run, error, now);
                }
                return;
            }
            Cargo::Pages(run) => return self.pages_failed(run, error),
        };
        if let Some(start) = &mut self.start {
            start.failed(leaves, error, now);
        }
    }

    fn pages_failed(&mut self, run: PageRun, error: Error) {
        let Some(cache) = &mut self.cache else { return };
        self.stale = true;
        match run.contents[..] {
            [(content, page)] => {
                cache.release(run);
                let key = cache.index().key(page);
                self.fail(content, PageError { key, error });
            }
            _ => {
                cache.divide(run);
                for request in self.requests.values_mut() {
                    request.order.restart();
                }
            }
        }
    }

    /// Takes what was decoded: puts pages into the next view and returns their number, and keeps colours to be
    /// [taken](Self::take_colours).
    pub fn loaded(&mut self, decoded: Decoded, now: Time) -> usize {
        self.at(now);
        let cargo = self.flights.remove(&decoded.id).map(|flight| flight.cargo);
        match (cargo, decoded.made) {
            (Some(Cargo::Leaves { leaves, .. }), Made::Leaves(entries)) => {
                if let Some(start) = &mut self.start {
                    start.loaded(leaves, entries);
                }
            }
            (Some(Cargo::Pages(run)), Made::Pages(pages)) => {
                let Some(cache) = &mut self.cache else { return 0 };
                let (loaded, failures) = cache.settle(run, pages, &mut self.counters);
                for (content, error) in failures {
                    self.fail(content, error);
                }
                return loaded;
            }
            (Some(Cargo::Colours(run)), Made::Colours(made)) => {
                if let Some(colours) = &mut self.colours {
                    colours.loaded(&run, made);
                }
            }
            _ => {}
        }
        0
    }

    /// Records that a page could not be loaded: ends the request that waits for it, or queues a report.
    fn fail(&mut self, content: u32, error: PageError) {
        self.counters.failed += 1;
        self.stale = true;
        let Some(cache) = &mut self.cache else { return };
        cache.note_failure(content, &error.error, self.now);
        let page = cache.index().find(error.key);
        let waits = |request: &Request| page.is_some_and(|page| request.order.wants(page));
        let request = self.requests.iter().find(|(_, request)| waits(request)).map(|(id, _)| *id);
        if let Some(id) = request.filter(|id| *id < HINTS) {
            self.requests.remove(&id);
            self.ended.insert(id, Err(error.error));
            return;
        }
        if self.reports.len() == REPORTS {
            self.reports.pop_front();
        }
        self.reports.push_back(error);
    }

    /// Returns when pages or colours that could not be read are tried again, or colours find room.
    pub(super) fn retry_at(&self) -> Option<Time> {
        let colours = self.colours.as_ref().and_then(|colours| colours.again(self.now));
        [self.hints_again(), colours].into_iter().flatten().min()
    }

    /// Returns failures that were not polled yet.
    #[cfg(not(target_family = "wasm"))]
    pub(super) fn take_reports(&mut self) -> Vec<PageError> {
        self.reports.drain(..).collect()
    }

    pub(super) fn at(&mut self, now: Time) -> Time {
        self.now = self.now.max(now);
        self.now
    }

    pub(super) fn name(&mut self) -> u64 {
        self.names += 1;
        self.names
    }
}

/// Returns the runs of pages in flight.
pub(super) fn page_runs(
    flights: &IdMap<FetchId, Flight>,
) -> impl Iterator<Item = (FetchId, &Flight, &PageRun)> + use<'_> {
    flights.iter().filter_map(|(id, flight)| match &flight.cargo {
        Cargo::Pages(run) => Some((*id, flight, run)),
        _ => None,
    })
}

impl std::fmt::Debug for Loader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Loader")
            .field("options", &self.options)
            .field("counters", &self.counters())
            .finish_non_exhaustive()
    }
}
