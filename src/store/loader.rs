//! Loads pages ahead of moving bodies: a state machine without threads, locks, a clock or a source of bytes.

use super::budget::Budget;
use super::cache::{Cache, Claim, Order, PageRun, Snapshots};
use super::counters::Counters;
use super::directory_loader::{Start, StartTurn, short_answer};
use super::fetch::{Decode, Decoded, Fetch, FetchId, Made, Next, PageError, Time, Work};
use super::id_map::IdMap;
use super::missing::Missing;
use super::motion_hint::MotionHint;
use super::request::{LoadReport, Request, RequestId};
use super::snapshot::Snapshot;
use crate::archive::Catalog;
use crate::frame::PageKey;
use crate::{Error, Result};
use std::collections::{HashMap, VecDeque};
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
    /// still hold, bytes in flight, and the scratch memory of decoding them.
    pub budget_bytes: usize,
    /// Least time to look ahead. The time is 32 times the latency of a fetch, clamped to these two limits.
    pub horizon_min: Duration,
    /// Greatest time to look ahead.
    pub horizon_max: Duration,
    /// Most bytes of one fetch, unless a single page is longer; at most an eighth of the budget.
    pub run_bytes: usize,
    /// Most fetches in flight at once.
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
    missing: Option<Missing>,
}

/// A run that is in flight or being decoded.
#[derive(Debug)]
pub(super) struct Flight {
    run: PageRun,
    since: Time,
    decoding: bool,
}

/// Next action found by [`Loader::turn`].
#[derive(Debug)]
pub(super) enum Turn {
    Fetch(Fetch),
    /// Nothing to do until there is news, or until [`Loader::retry_at`].
    Idle,
    /// Everything left is in flight.
    Busy,
    /// The rest does not fit in the budget; `true` if it may fit once snapshots are dropped.
    NoRoom(bool),
    /// A request has finished.
    Ended(Result<LoadReport>),
}

/// Keeps the pages around moving bodies in memory, under a byte budget. The loader opens the archive, decides what to
/// fetch, most urgent first, and publishes loaded pages as [`Snapshot`]s. Its owner, the driver, transfers the bytes and
/// supplies the time.
///
/// The loader has no files, threads, locks or clock. Its methods are of four kinds. **Commands** request pages
/// ([`hint`](Self::hint), [`need`](Self::need), [`forget`](Self::forget), [`request`](Self::request)). **Polling**
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
/// In a game loop, with an engine that fetches and decodes in the background:
///
/// ```
/// # use slicewalk::store::{BodyId, Decode, Decoded, Fetch, FetchId, Loader, Next, MotionHint, Snapshot, Time};
/// # trait Engine { fn fetch(&mut self, fetch: Fetch); fn cancel(&mut self, id: FetchId); fn decode(&mut self, job: Decode);
/// #     fn arrived(&mut self) -> Option<(FetchId, Vec<u8>)>; fn decoded(&mut self) -> Option<Decoded>; }
/// fn frame(loader: &mut Loader, pawn: BodyId, motion_hint: &MotionHint, engine: &mut impl Engine, now: Time) -> slicewalk::Result<()> {
///     while let Some((id, bytes)) = engine.arrived() {
///         loader.given(id, bytes, now).map(|job| engine.decode(job));
///     }
///     while let Some(decoded) = engine.decoded() {
///         loader.loaded(decoded, now);
///     }
///     loader.hint(pawn, motion_hint);
///     loop {
///         match loader.poll(now)? {
///             Next::Fetch(fetch) => engine.fetch(fetch),
///             Next::Cancel(id) => engine.cancel(id),
///             Next::Report(_) => {}
///             Next::Wait(_) => return Ok(()), // loader.snapshot() is this frame's
///         }
///     }
/// }
/// ```
///
/// Pass the result of every [`Decode`] to [`loaded`](Self::loaded); until then its pages count as in flight.
pub struct Loader {
    options: LoaderOptions,
    budget: Arc<Budget>,
    pub(super) counters: Counters,
    catalog: Option<Arc<Catalog>>,
    /// Present until the directory is loaded.
    start: Option<Box<Start>>,
    pub(super) cache: Option<Box<Cache>>,
    bodies: IdMap<BodyId, Tracked>,
    /// Pages that the bodies want; `stale` if they, or the pages that may be evicted, have changed since.
    hinted: Order,
    pub(super) stale: bool,
    again: Option<Time>,
    pub(super) requests: IdMap<RequestId, Request>,
    /// Requests made before the directory was loaded.
    pub(super) early: Vec<(RequestId, Vec<PageKey>, PageKey)>,
    pub(super) ended: IdMap<RequestId, Result<LoadReport>>,
    pub(super) flights: IdMap<FetchId, Flight>,
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
            hinted: Order::default(),
            stale: false,
            again: None,
            requests: IdMap::new(),
            early: Vec::new(),
            ended: IdMap::new(),
            flights: IdMap::new(),
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

    pub(super) fn shared_catalog(&self) -> Option<Arc<Catalog>> {
        self.catalog.clone()
    }

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
    /// [needed](Self::need). An motion_hint that is not finite or not in order is dropped and counted.
    pub fn hint(&mut self, body: BodyId, motion_hint: &MotionHint) {
        if !motion_hint.is_valid() {
            self.counters.hints_dropped += 1;
        } else if let Some(body) = self.bodies.get_mut(&body) {
            *body = Tracked { motion_hint: Some(*motion_hint), missing: None };
            self.stale = true;
        }
    }

    /// Requests pages that a query of this body missed; they precede the pages that hints want.
    pub fn need(&mut self, body: BodyId, missing: &Missing) {
        if let Some(body) = self.bodies.get_mut(&body) {
            body.missing = Some(*missing);
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
        if self.stale || self.again.is_some_and(|again| again <= now) {
            self.replan();
        }
        let mut until: Option<Time> = None;
        let mut wait = |time: Time| until = Some(until.map_or(time, |least| least.min(time)));
        let mut no_room = false;
        let turns = self.requests.ids().into_iter().map(Some).chain([None]);
        for request in turns {
            if self.flights.len() >= self.options.fetches {
                no_room |= self.is_absent(request, now);
                continue;
            }
            let turn = match request {
                Some(id) => self.request_turn(id, now),
                None => self.turn(now),
            };
            match turn {
                Turn::Fetch(fetch) => return Ok(Next::Fetch(fetch)),
                Turn::Idle | Turn::Busy => {}
                Turn::NoRoom(snapshots) => {
                    no_room = true;
                    if snapshots {
                        wait(now + VIEWS_AGAIN);
                    }
                }
                Turn::Ended(outcome) => {
                    if let Some(id) = request {
                        self.ended.insert(id, outcome);
                    }
                }
            }
        }
        // No order wants these pages any longer, and they take memory that wanted pages need.
        if no_room && let Some(id) = self.unwanted() {
            let flight = self.flights.remove(&id);
            if let (Some(flight), Some(cache)) = (flight, &mut self.cache) {
                cache.release(flight.run);
                self.counters.cancelled += 1;
                return Ok(Next::Cancel(id));
            }
        }
        until = [until, self.again].into_iter().flatten().min();
        Ok(Next::Wait(until))
    }

    /// Opens the archive; returns the next action for that.
    fn begin_turn(&mut self, now: Time) -> Result<Option<Next>> {
        let Some(start) = &mut self.start else { return Ok(None) };
        let turn = start.poll(now, &self.budget)?;
        self.catalog = start.catalog().cloned();
        match turn {
            StartTurn::Wait(until) => Ok(Some(Next::Wait(until))),
            StartTurn::Fetch(range, leaves, room) => {
                let id = FetchId(self.name());
                if let Some(start) = &mut self.start {
                    start.launched(id, range.clone(), leaves, room);
                }
                Ok(Some(Next::Fetch(Fetch { id, range, needed_in: Duration::ZERO })))
            }
            StartTurn::Ready(index, table) => {
                let cache = Cache::new(index, table, self.budget.clone(), self.options.run_bytes);
                (self.cache, self.start) = (Some(Box::new(cache)), None);
                for (id, keys, around) in std::mem::take(&mut self.early) {
                    self.admit(id, &keys, around);
                }
                self.stale = true;
                Ok(None)
            }
        }
    }

    /// Returns the next step for the hints.
    pub(super) fn turn(&mut self, now: Time) -> Turn {
        let now = self.at(now);
        if self.stale || self.again.is_some_and(|again| again <= now) {
            self.replan();
        }
        if self.gives_way(None) {
            return Turn::Busy;
        }
        let Some(cache) = &mut self.cache else { return Turn::Busy };
        let stays = |page| self.requests.values().any(|request| request.order.wants(page));
        let claim = cache.claim(&mut self.hinted, &stays, now, &mut self.counters);
        self.again = self.hinted.again;
        match claim {
            Claim::Run(run) => Turn::Fetch(self.launch(run)),
            Claim::Done => Turn::Idle,
            Claim::Busy => Turn::Busy,
            Claim::NoRoom(snapshots) => Turn::NoRoom(snapshots),
        }
    }

    /// Updates the pages that all hints want.
    fn replan(&mut self) {
        let Some(cache) = &mut self.cache else { return };
        let horizon =
            (self.latency * LATENCIES_AHEAD).max(self.options.horizon_min).min(self.options.horizon_max).as_secs_f64();
        let index = cache.index();
        let (mut times, mut focus) = (HashMap::new(), Vec::new());
        for body in self.bodies.values() {
            if let Some(motion_hint) = &body.motion_hint {
                motion_hint.wants(index, horizon, &mut times);
                focus.push(motion_hint.focus(index.frame()));
            }
            let missing = body.missing.iter().flat_map(|missing| missing.keys());
            times.extend(missing.filter_map(|key| Some((index.find(*key)?, 0.0))));
        }
        focus.sort_unstable();
        focus.dedup();
        self.hinted = Order::hinted(times, focus);
        cache.replan(&self.hinted, &mut self.counters);
        (self.stale, self.again) = (false, None);
    }

    pub(super) fn launch(&mut self, run: PageRun) -> Fetch {
        let id = FetchId(self.name());
        let range = run.bytes.clone();
        self.counters.reads += 1;
        self.counters.read_bytes += range.end - range.start;
        let needed_in = Duration::from_secs_f32(run.needed_in.max(0.0));
        self.flights.insert(id, Flight { run, since: self.now, decoding: false });
        Fetch { id, range, needed_in }
    }

    /// Returns whether a request, or a hint, wants a page that is neither in memory nor in flight.
    fn is_absent(&self, request: Option<RequestId>, now: Time) -> bool {
        let order = match request {
            Some(id) => self.requests.get(&id).map(|request| &request.order),
            None => Some(&self.hinted),
        };
        order.zip(self.cache.as_ref()).is_some_and(|(order, cache)| cache.is_absent(order, now))
    }

    /// Returns the first fetch in flight with no page that is still wanted.
    fn unwanted(&self) -> Option<FetchId> {
        let wanted = |flight: &Flight| {
            let pages = || flight.run.contents.iter().map(|(_, page)| *page);
            pages().any(|page| self.hinted.wants(page) || self.requests.values().any(|r| r.order.wants(page)))
        };
        let flight = self.flights.iter().find(|(_, flight)| !flight.decoding && !wanted(flight));
        flight.map(|(id, _)| *id)
    }

    /// Takes the bytes of a fetch and returns the work of decoding them, if there is any. Bytes of a cancelled or
    /// unknown fetch are ignored; a wrong number of bytes counts as a failed fetch.
    ///
    /// For the first fetch of an archive of unknown length, fewer bytes are allowed: they reveal its length.
    pub fn given(&mut self, id: FetchId, bytes: Vec<u8>, now: Time) -> Option<Decode> {
        let now = self.at(now);
        if let Some(start) = &mut self.start {
            let work = start.given(id, &bytes, now)?;
            return Some(Decode { id, bytes, work });
        }
        let flight = self.flights.get_mut(&id).filter(|flight| !flight.decoding)?;
        if bytes.len() as u64 != flight.run.bytes.end - flight.run.bytes.start {
            let error = short_answer(&flight.run.bytes, bytes.len());
            self.failed(id, error, now);
            return None;
        }
        flight.decoding = true;
        self.latency = (now - flight.since).max(self.latency.mul_f64(0.95));
        let contents = flight.run.contents.iter().map(|(content, _)| *content).collect();
        let work = Work::Pages(self.cache.as_ref()?.index().clone(), flight.run.bytes.start, contents);
        Some(Decode { id, bytes, work })
    }

    /// Records that a fetch failed. Pages fetched together are then fetched one at a time. A page that failed alone is
    /// fetched again after 0.1 s, then 0.2 s and so on up to 6.4 s, unless the error is lasting, which is any error but
    /// [`Error::Io`].
    pub fn failed(&mut self, id: FetchId, error: Error, now: Time) {
        let now = self.at(now);
        if let Some(start) = &mut self.start {
            return start.failed(id, error, now);
        }
        let (Some(flight), Some(cache)) = (self.flights.remove(&id), &mut self.cache) else { return };
        self.stale = true;
        match flight.run.contents[..] {
            [(content, page)] => {
                cache.release(flight.run);
                let key = cache.index().key(page);
                self.fail(content, PageError { key, error });
            }
            _ => {
                cache.divide(flight.run);
                for request in self.requests.values_mut() {
                    request.order.restart();
                }
            }
        }
    }

    /// Puts decoded pages into the next view and returns their number.
    pub fn loaded(&mut self, decoded: Decoded, now: Time) -> usize {
        self.at(now);
        match decoded.made {
            Made::Leaves(entries) => {
                if let Some(start) = &mut self.start {
                    start.loaded(decoded.id, entries);
                }
                0
            }
            Made::Pages(pages) => {
                let (Some(flight), Some(cache)) = (self.flights.remove(&decoded.id), &mut self.cache) else { return 0 };
                let (loaded, failures) = cache.settle(flight.run, pages, &mut self.counters);
                for (content, error) in failures {
                    self.fail(content, error);
                }
                loaded
            }
        }
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
        if let Some(id) = request {
            self.requests.remove(&id);
            self.ended.insert(id, Err(error.error));
            return;
        }
        if self.reports.len() == REPORTS {
            self.reports.pop_front();
        }
        self.reports.push_back(error);
    }

    /// Returns when pages that could not be read are tried again.
    #[cfg(not(target_family = "wasm"))]
    pub(super) fn retry_at(&self) -> Option<Time> {
        self.again
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

impl std::fmt::Debug for Loader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Loader")
            .field("options", &self.options)
            .field("counters", &self.counters())
            .finish_non_exhaustive()
    }
}
