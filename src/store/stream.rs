//! A stream: a [`Loader`] with a thread, a lock, a clock and an archive to read from.

use super::cache::Snapshots;
use super::counters::Counters;
use super::edited::edited_columns;
use super::fetch::{Fetch, Next, PageError, Payload, Time, Turn};
use super::loader::{BodyId, Loader, LoaderOptions};
use super::missing::Missing;
use super::motion_hint::MotionHint;
use super::request::{HINTS, LoadReport};
use super::snapshot::Snapshot;
use super::sync::{
    Arc, AtomicBool, AtomicU64, Builder, Condvar, JoinHandle, Mutex, MutexGuard, Thread, park, park_timeout,
    wait_at_most, yield_now,
};
use crate::archive::Archive;
use crate::bytes::interruptible;
use crate::frame::PageKey;
use crate::page::Colours;
use crate::{Error, Result};
use std::sync::PoisonError;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::time::{Duration, Instant};

/// Where pages are loaded before they are needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Prefetch {
    /// Nowhere: only [`Stream::load`] loads pages.
    Off,
    /// On a background thread named `slicewalk-prefetch`.
    Thread,
    /// On the caller of [`Stream::step`]: for programs with their own scheduler, or tests with their own time.
    Manual,
}

/// Options of a [`Stream`].
#[derive(Debug, Clone, PartialEq)]
pub struct StreamOptions {
    /// Options of its loader; `fetches` is ignored, because each thread that loads reads one run at a time.
    pub loader: LoaderOptions,
    /// Where pages are loaded ahead.
    pub prefetch: Prefetch,
}

impl StreamOptions {
    /// Creates the default options: a background thread, and those of [`LoaderOptions::new`].
    pub fn new(budget_bytes: usize) -> Self {
        Self { loader: LoaderOptions::new(budget_bytes), prefetch: Prefetch::Thread }
    }
}

/// Result of one [`Stream::step`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Step {
    /// Read and decoded a run; this many pages were added.
    Loaded(usize),
    /// There were no pages to read, so colours of some were read or decoded.
    Coloured,
    /// Nothing is left to do until a hint changes.
    Idle,
    /// Another thread reads the rest.
    Busy,
    /// The rest does not fit in the budget. `true` if it may fit once snapshots are dropped.
    NoRoom(bool),
}

#[derive(Debug)]
struct Inbox {
    body: BodyId,
    /// Given since they were last collected.
    motion_hint: Option<MotionHint>,
    missing: Option<Missing>,
    changed: bool,
    gone: bool,
}

/// The pages of an archive around moving bodies.
///
/// ```no_run
/// use nalgebra::{Point3, Vector3};
/// use slicewalk::archive::Archive;
/// use slicewalk::query::{Aabb, Overlap, overlaps};
/// use slicewalk::store::{MotionHint, Stream, StreamOptions};
///
/// let stream = Stream::open(Archive::open("scan.slices")?, StreamOptions::new(16 << 20))?;
/// let mut pawn = stream.pawn();
/// let (min, max) = (Point3::new(-0.25, -0.25, 0.0), Point3::new(0.25, 0.25, 1.8));
/// stream.load_around(&MotionHint::walking(min, max, Vector3::zeros()))?; // blocks: a loading screen
/// for _frame in 0..600 {
///     pawn.hint(&MotionHint::walking(min, max, Vector3::new(1.4, 0.0, 0.0)));
///     let view = stream.snapshot();
///     if let Overlap::NotLoaded(missing) = overlaps(&view, &Aabb::new(min, max)?) {
///         pawn.need(&missing);
///     }
/// }
/// for failed in stream.take_errors() {
///     eprintln!("{}: {}", failed.key, failed.error);
/// }
/// # Ok::<(), slicewalk::Error>(())
/// ```
///
/// Any number of bodies may hint and query from any number of threads. Queries run on a [`Snapshot`]: they take no lock, do
/// no I/O and allocate nothing (guarantee G8). Loading never changes an answer; it only replaces "not loaded" by one.
/// Dropping the stream ends its thread at once, or as soon as the read in progress returns; reads of remote objects end
/// within a moment. The thread belongs to the process that opened the stream: after a `fork`, nothing loads ahead in the
/// child, so open another one there.
///
/// Memory: the budget covers everything. A stream is a [`Loader`] that drives itself. Programs with their own scheduler
/// or way to fetch, and browsers, drive a [`Loader`] directly.
pub struct Stream {
    shared: Arc<Shared>,
    worker: Option<JoinHandle<()>>,
    /// Process of the thread, if there is one.
    process: Option<u32>,
}

struct Shared {
    archive: Archive,
    snapshots: Snapshots,
    loader: Mutex<Loader>,
    /// Notified when a run was loaded or failed.
    settled: Condvar,
    options: StreamOptions,
    origin: Instant,
    pawns: Mutex<Vec<Arc<Mutex<Inbox>>>>,
    /// Increases with every hint.
    hints: AtomicU64,
    hints_dropped: AtomicU64,
    stop: AtomicBool,
    /// Newest number of `hints` that the loader knows; locked for the whole of a step.
    desk: Mutex<Option<u64>>,
    /// Newest number of `hints` for which the background thread has nothing left to do.
    rested: Mutex<Option<u64>>,
    rest: Condvar,
}

impl Stream {
    /// Opens a stream on an archive; no page is loaded yet. Reads the whole directory, one read per MiB. Fails if that
    /// cannot be read, or if the table of pages alone exceeds the budget.
    pub fn open(archive: Archive, options: StreamOptions) -> Result<Self> {
        let mut loader = Loader::new(archive.catalog().clone(), options.loader.clone())?;
        let origin = Instant::now();
        while loader.snapshots().is_none() {
            if let Next::Fetch(fetch) = loader.poll(origin.elapsed())? {
                let bytes = read(&archive, &fetch)?;
                if let Some(job) = loader.given(fetch.id, bytes, origin.elapsed()) {
                    loader.loaded(job.run(), origin.elapsed());
                }
            }
        }
        let Some(mut snapshots) = loader.snapshots() else {
            return Err(Error::parameter("archive", "it has no directory"));
        };
        snapshots.edited = edited_columns(&archive, &snapshots.index, loader.budget())?.map(Arc::new);
        let prefetch = options.prefetch;
        let shared = Arc::new(Shared {
            archive,
            snapshots,
            loader: Mutex::new(loader),
            settled: Condvar::new(),
            options,
            origin,
            pawns: Mutex::default(),
            hints: AtomicU64::new(0),
            hints_dropped: AtomicU64::new(0),
            stop: AtomicBool::new(false),
            desk: Mutex::default(),
            rested: Mutex::default(),
            rest: Condvar::new(),
        });
        let worker = match prefetch {
            Prefetch::Thread => {
                let shared = shared.clone();
                let builder = Builder::new().name("slicewalk-prefetch".into());
                let spawned = builder.spawn(move || {
                    let ended = shared.clone();
                    interruptible(Some(Arc::new(move || ended.stop.load(Acquire))), || shared.work());
                });
                Some(spawned.map_err(|error| Error::io("slicewalk-prefetch", "start a thread", error))?)
            }
            _ => None,
        };
        let process = worker.is_some().then(std::process::id);
        Ok(Self { shared, worker, process })
    }

    /// Returns the pages in memory now. Lock-free; allocates nothing. Take one per frame, and drop it with the frame.
    #[inline]
    pub fn snapshot(&self) -> Snapshot {
        self.shared.snapshots.newest()
    }

    /// Returns a handle through which one body gives its hints, as long as the handle lives.
    pub fn pawn(&self) -> PawnHandle {
        let body = lock(&self.shared.loader).body();
        let inbox = Arc::new(Mutex::new(Inbox { body, motion_hint: None, missing: None, changed: false, gone: false }));
        lock(&self.shared.pawns).push(inbox.clone());
        let worker = self.worker.as_ref().map(|worker| worker.thread().clone());
        PawnHandle { inbox, shared: self.shared.clone(), worker }
    }

    /// Loads the pages `keys`, nearest to `around` first, and blocks until all are in memory, one fails, or the rest
    /// does not fit. Unknown keys are ignored, because they have no page. Evicts pages that no hint needs now, farthest
    /// first.
    ///
    /// Fails with the error of the first page that cannot be loaded; pages loaded before stay. Pages that do not fit
    /// are counted as [`left_out`](LoadReport::left_out): the budget is too small, or snapshots hold it (drop your own
    /// first).
    pub fn load(&self, keys: &[PageKey], around: PageKey) -> Result<LoadReport> {
        let shared = &self.shared;
        let mut loader = lock(&shared.loader);
        let request = loader.request(keys, around);
        loop {
            match loader.request_turn(request, shared.now()) {
                Turn::Idle => {
                    let outcome = loader.outcome(request);
                    return outcome.unwrap_or_else(|| Err(Error::parameter("request", "its outcome was taken")));
                }
                Turn::Fetch(fetch) => {
                    drop(loader);
                    shared.carry(fetch);
                    loader = lock(&shared.loader);
                }
                turn => {
                    // Another thread reads one of these pages, or snapshots hold the memory.
                    let pause = Duration::from_millis(if matches!(turn, Turn::Busy) { 10 } else { 1 });
                    loader = wait_at_most(&shared.settled, &shared.loader, loader, pause);
                }
            }
        }
    }

    /// Runs [`load`](Self::load) for all pages that a query missed.
    pub fn load_missing(&self, missing: &Missing) -> Result<LoadReport> {
        let keys = missing.keys();
        self.load(keys, keys[0])
    }

    /// Runs [`load`](Self::load) for all pages that a body touches before it moves: for the first frame, or after a
    /// jump to another place. Fails, too, if the motion_hint is invalid.
    pub fn load_around(&self, motion_hint: &MotionHint) -> Result<LoadReport> {
        if !motion_hint.is_valid() {
            return Err(Error::parameter("motion_hint", "its numbers must be finite and in order"));
        }
        let keys = self.shared.snapshots.keys_around(motion_hint);
        self.load(&keys, motion_hint.focus(self.snapshot().frame()))
    }

    /// Returns the number of pages in memory that a body touches before it moves; 0 if the motion_hint is invalid.
    pub fn count_loaded(&self, motion_hint: &MotionHint) -> usize {
        let now = self.snapshot();
        let keys = self.shared.snapshots.keys_around(motion_hint);
        keys.iter().filter(|key| now.is_loaded(**key) == Some(true)).count()
    }

    /// Does one step of the background thread's work on this thread: reads one run of pages. For [`Prefetch::Manual`];
    /// does nothing otherwise.
    pub fn step(&self) -> Step {
        match self.shared.options.prefetch {
            Prefetch::Manual => self.shared.step(),
            _ => Step::Idle,
        }
    }

    /// Waits until every page that the present hints want is loaded, has failed, or does not fit, but at most for
    /// `at_most`. Returns whether it got that far. With [`Prefetch::Manual`] it loads on this thread; with
    /// [`Prefetch::Off`] it returns `true` at once.
    ///
    /// For programs whose frames are not paced by a clock, such as simulations and recordings. Drop snapshots first: the
    /// memory that they hold is not available.
    pub fn settle(&self, at_most: Duration) -> bool {
        let (shared, start) = (&self.shared, Instant::now());
        match shared.options.prefetch {
            Prefetch::Off => true,
            Prefetch::Manual => loop {
                match self.step() {
                    Step::Idle | Step::NoRoom(false) => return true,
                    _ if start.elapsed() >= at_most => return false,
                    Step::Loaded(_) => {}
                    // Pages come before colours, so they are done.
                    Step::Coloured => return true,
                    Step::Busy | Step::NoRoom(true) => yield_now(),
                }
            },
            Prefetch::Thread => {
                let newest = Some(shared.hints.load(Acquire));
                let rested = shared.rest.wait_timeout_while(lock(&shared.rested), at_most, |rested| *rested < newest);
                *rested.unwrap_or_else(PoisonError::into_inner).0 >= newest
            }
        }
    }

    /// Sets the pages whose colours are wanted, most urgent first, and replaces the previous ones; pages that are not
    /// in memory get none. Colours are read only if no page is to be read, so a page waits for at most one read of
    /// colours (64 KiB). With [`Prefetch::Off`] no colours are read. Does nothing for an archive without colours.
    pub fn want_colours(&self, keys: &[PageKey]) {
        lock(&self.shared.loader).want_colours(keys);
        self.wake();
    }

    /// Returns the colours of one page that have come; see [`Loader::take_colours`].
    pub fn take_colours(&self) -> Option<(PageKey, Result<Colours>)> {
        let taken = lock(&self.shared.loader).take_colours()?;
        self.wake();
        Some(taken)
    }

    fn wake(&self) {
        self.worker.iter().for_each(|worker| worker.thread().unpark());
    }

    /// Returns counts of the stream's work and the memory it holds.
    pub fn counters(&self) -> Counters {
        let counters = lock(&self.shared.loader).counters();
        let dropped = self.shared.hints_dropped.load(Relaxed);
        Counters { hints_dropped: counters.hints_dropped + dropped, ..counters }
    }

    /// Returns the errors of loading ahead since the last call, at most the last 16. Their pages stay "not loaded".
    /// Pages that could not be read are tried again after 0.1 s, then 0.2 s and so on up to 6.4 s; damaged pages are
    /// not.
    pub fn take_errors(&self) -> Vec<PageError> {
        lock(&self.shared.loader).take_reports()
    }

    /// Returns the archive.
    pub fn archive(&self) -> &Archive {
        &self.shared.archive
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.shared.stop.store(true, Release);
        // After a fork, the child has no such thread.
        let is_there = self.process.is_some_and(|process| process == std::process::id());
        if let Some(worker) = self.worker.take().filter(|_| is_there) {
            worker.thread().unpark();
            // The thread's panic was reported when it happened.
            let _ = worker.join();
        }
    }
}

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stream").field("options", &self.shared.options).field("counters", &self.counters()).finish()
    }
}

/// Handle through which one body gives hints. Dropping it ends them.
pub struct PawnHandle {
    inbox: Arc<Mutex<Inbox>>,
    shared: Arc<Shared>,
    worker: Option<Thread>,
}

impl PawnHandle {
    /// Sets how the body moves now; call it once a frame. Replaces the last hint and the pages requested by
    /// [`need`](Self::need) before it. Never waits: a hint that is not finite or not in order, or that is given at the
    /// moment at which the last one is collected, is dropped and counted.
    pub fn hint(&mut self, motion_hint: &MotionHint) {
        self.put(motion_hint.is_valid(), |inbox| {
            (inbox.motion_hint, inbox.changed) = (Some(*motion_hint), true);
        });
    }

    /// Requests pages that a query missed; they precede all others. Never waits.
    pub fn need(&mut self, missing: &Missing) {
        self.put(true, |inbox| (inbox.missing, inbox.changed) = (Some(*missing), true));
    }

    /// Returns the pages in memory now, like [`Stream::snapshot`]; for a body on a thread of its own.
    #[inline]
    pub fn snapshot(&self) -> Snapshot {
        self.shared.snapshots.newest()
    }

    fn put(&self, valid: bool, put: impl FnOnce(&mut Inbox)) {
        match self.inbox.try_lock() {
            Ok(mut inbox) if valid => put(&mut inbox),
            _ => {
                self.shared.hints_dropped.fetch_add(1, Relaxed);
                return;
            }
        }
        self.told();
    }

    /// Wakes the background thread, because there is something new.
    fn told(&self) {
        self.shared.hints.fetch_add(1, Release);
        if let Some(worker) = &self.worker {
            worker.unpark();
        }
    }
}

impl Drop for PawnHandle {
    fn drop(&mut self) {
        lock(&self.inbox).gone = true;
        self.told();
    }
}

impl std::fmt::Debug for PawnHandle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PawnHandle").finish_non_exhaustive()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads the bytes of a fetch.
fn read(archive: &Archive, fetch: &Fetch) -> Result<Vec<u8>> {
    let mut bytes = vec![0; (fetch.range.end - fetch.range.start) as usize];
    let read = archive.source().read_at(fetch.range.start, &mut bytes);
    // The reader was asked to stop, but the bytes are intact: an I/O error lets the pages be tried again.
    let again = |error| match error {
        Error::Interrupted => Error::io("archive", "read on", std::io::Error::other("interrupted")),
        error => error,
    };
    read.map(|()| bytes).map_err(again)
}

impl Shared {
    fn now(&self) -> Time {
        self.origin.elapsed()
    }

    /// Runs the background thread.
    fn work(&self) {
        while !self.stop.load(Acquire) {
            match self.step() {
                Step::Loaded(_) => {}
                Step::Coloured => {
                    *lock(&self.rested) = *lock(&self.desk);
                    self.rest.notify_all();
                }
                Step::Idle | Step::NoRoom(false) => {
                    *lock(&self.rested) = *lock(&self.desk);
                    self.rest.notify_all();
                    // An unpark since the step has left its token, so parking returns at once.
                    let again = lock(&self.loader).retry_at();
                    match again {
                        Some(at) => park_timeout(at.saturating_sub(self.now())),
                        None => park(),
                    }
                }
                Step::Busy | Step::NoRoom(true) => park_timeout(Duration::from_millis(1)),
            }
        }
    }

    /// Reads one run of the pages that the newest hints want.
    fn step(&self) -> Step {
        let mut known = lock(&self.desk);
        let newest = self.hints.load(Acquire);
        let mut loader = lock(&self.loader);
        if *known != Some(newest) {
            self.collect(&mut loader);
            *known = Some(newest);
        }
        let now = self.now();
        loader.replan(now);
        let (step, fetch) = match loader.request_turn(HINTS, now) {
            Turn::Busy => return Step::Busy,
            Turn::Fetch(fetch) => (Step::Idle, Some(fetch)),
            Turn::Idle => (Step::Idle, None),
            Turn::NoRoom(held) => (Step::NoRoom(held), None),
        };
        // Colours come if no page can.
        let fetch = fetch.or_else(|| loader.colour_turn(now));
        drop(loader);
        match fetch {
            Some(fetch) if fetch.what == Payload::Pages => Step::Loaded(self.carry(fetch)),
            Some(fetch) => {
                self.carry(fetch);
                Step::Coloured
            }
            None => step,
        }
    }

    /// Passes the hints that pawns gave since the last time to the loader.
    fn collect(&self, loader: &mut Loader) {
        lock(&self.pawns).retain(|inbox| {
            let mut inbox = lock(inbox);
            if inbox.gone {
                loader.forget(inbox.body);
            } else if std::mem::take(&mut inbox.changed) {
                if let Some(motion_hint) = inbox.motion_hint.take() {
                    loader.hint(inbox.body, &motion_hint);
                }
                if let Some(missing) = inbox.missing.take() {
                    loader.need(inbox.body, &missing);
                }
            }
            !inbox.gone
        });
    }

    /// Reads and decodes a fetch without holding a lock; returns the number of loaded pages.
    fn carry(&self, fetch: Fetch) -> usize {
        let answer = read(&self.archive, &fetch);
        let job = match answer {
            Ok(bytes) => lock(&self.loader).given(fetch.id, bytes, self.now()),
            Err(error) => {
                lock(&self.loader).failed(fetch.id, error, self.now());
                None
            }
        };
        let decoded = job.map(|job| job.run());
        let loaded = decoded.map_or(0, |decoded| lock(&self.loader).loaded(decoded, self.now()));
        self.settled.notify_all();
        loaded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::{ArchiveWriter, PageEncoder, Totals};
    use crate::bytes::{ByteSource, MemorySource, stop_of_thread};
    use crate::frame::Frame;
    use crate::page::{PageBuilder, Span};
    use crate::plan::Plan;
    use crate::query::{Aabb, Overlap, overlaps};
    use crate::walk::{Config, MoveInput, Walker};
    use nalgebra::Vector2;

    impl Stream {
        /// Reserves all memory that is left.
        pub(in crate::store) fn fill_the_budget(&self) -> crate::store::budget::Reservation {
            lock(&self.shared.loader).budget().take_rest()
        }
    }

    fn archive() -> Archive {
        let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(10, 20, &[Span::new(0, 255, false).unwrap()]));
        let key = PageKey { tx: 0, ty: 0, layer: 0 };
        writer.put(key, PageEncoder::new(plan.frame).encode(key, &builder.build())).unwrap();
        writer.finish(Totals::default()).unwrap();
        Archive::from_bytes(std::fs::read(&target).unwrap()).unwrap()
    }

    #[test]
    fn a_budget_of_nothing_is_refused_by_name() {
        let refused = Stream::open(archive(), StreamOptions::new(0)).unwrap_err();
        assert!(matches!(refused, Error::Parameter { what: crate::Parameter::Cache, .. }), "{refused}");
    }

    fn hint() -> MotionHint {
        MotionHint::walking([0.52, 1.02, 0.1].into(), [0.6, 1.1, 1.0].into(), Default::default())
    }

    fn manual() -> StreamOptions {
        StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(1 << 20) }
    }

    #[test]
    fn hints_that_make_no_sense_load_nothing() {
        let stream = Stream::open(archive(), manual()).unwrap();
        let wrong = MotionHint { agility: -1.0, ..hint() };
        let refused = stream.load_around(&wrong).unwrap_err().to_string();
        assert!(refused.contains("motion_hint") && refused.contains("finite"), "{refused}");
        assert_eq!((stream.load_around(&hint()).unwrap().loaded, stream.count_loaded(&hint())), (1, 1));
        assert_eq!(stream.count_loaded(&wrong), 0);
    }

    #[test]
    fn pages_that_a_body_needs_come_without_a_hint_and_settling_takes_no_longer_than_it_may() {
        let stream = Stream::open(archive(), manual()).unwrap();
        let shape = Aabb::new(hint().min, hint().max).unwrap();
        let Overlap::NotLoaded(missing) = overlaps(&stream.snapshot(), &shape) else { panic!("it is loaded") };
        let mut pawn = stream.pawn();
        pawn.need(&missing);
        assert!(!stream.settle(Duration::ZERO), "a page was to be read");
        assert_eq!(overlaps(&stream.snapshot(), &shape), Overlap::Hit);
        assert!(stream.settle(Duration::ZERO));
    }

    /// Ends reads like that of a remote object on a thread that is to stop.
    struct Stopping {
        bytes: MemorySource,
        is_slow: AtomicBool,
        is_waiting: AtomicBool,
        is_stopped: AtomicBool,
    }

    impl ByteSource for Stopping {
        fn len(&self) -> u64 {
            self.bytes.len()
        }

        fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
            if !self.is_slow.load(Acquire) {
                return self.bytes.read_at(offset, buf);
            }
            self.is_waiting.store(true, Release);
            let (start, stop) = (Instant::now(), stop_of_thread());
            // On a thread that nothing can stop, the read ends at once.
            while stop.as_ref().is_some_and(|stop| !stop()) && start.elapsed() < Duration::from_secs(20) {
                yield_now();
            }
            self.is_stopped.store(stop.is_some_and(|stop| stop()), Release);
            Err(Error::Interrupted)
        }
    }

    #[test]
    fn a_read_that_is_stopped_ends_its_thread_and_leaves_its_pages_to_be_read_again() {
        for prefetch in [Prefetch::Manual, Prefetch::Thread] {
            let mut bytes = vec![0; archive().source().len() as usize];
            archive().source().read_at(0, &mut bytes).unwrap();
            let bytes = MemorySource::new(bytes);
            let [is_slow, is_waiting, is_stopped] = Default::default();
            let source = Arc::new(Stopping { bytes, is_slow, is_waiting, is_stopped });
            let archive = Archive::from_source(Box::new(source.clone())).unwrap();
            let stream = Stream::open(archive, StreamOptions { prefetch, ..manual() }).unwrap();
            source.is_slow.store(true, Release);
            let mut pawn = stream.pawn();
            pawn.hint(&hint());
            if prefetch == Prefetch::Manual {
                assert_eq!(stream.step(), Step::Loaded(0));
                let errors = stream.take_errors();
                assert!(matches!(errors[..], [PageError { error: Error::Io { .. }, .. }]), "{errors:?}");
                source.is_slow.store(false, Release);
                assert_eq!(stream.load_around(&hint()).unwrap().loaded, 1);
            } else {
                // A hint may coincide with the moment in which the one before is taken.
                while !source.is_waiting.load(Acquire) {
                    pawn.hint(&hint());
                    yield_now();
                }
            }
            drop(stream);
            assert_eq!(source.is_stopped.load(Acquire), prefetch == Prefetch::Thread);
        }
    }

    #[test]
    fn a_body_that_is_gone_leaves_nothing_to_wait_for() {
        let stream = Stream::open(archive(), StreamOptions::new(1 << 20)).unwrap();
        let long = Duration::from_secs(60);
        assert!(stream.settle(long));
        let mut pawn = stream.pawn();
        pawn.hint(&MotionHint::walking([0.52, 1.02, 0.1].into(), [0.6, 1.1, 1.0].into(), Default::default()));
        assert!(stream.settle(long));
        drop(pawn);
        assert!(stream.settle(long));
    }

    /// A loader suspended forever at the worst moment: every lock is held, even that of the cell which a publication
    /// writes. Frames must continue.
    #[test]
    fn no_lock_held_for_ever_holds_a_frame() {
        let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(1 << 20) };
        let stream = Stream::open(archive(), options).unwrap();
        let mut pawn = stream.pawn();
        let (min, max) = ([0.52, 1.02, 0.1].into(), [0.6, 1.1, 1.0].into());
        let (motion_hint, shape) = (MotionHint::walking(min, max, Default::default()), Aabb::new(min, max).unwrap());
        stream.load_around(&motion_hint).unwrap();
        let mut walker = Walker::new(Config::default(), [0.0, 0.0, 1.0].into()).unwrap();
        let inbox = pawn.inbox.clone();
        let (_loader, _pawns) = (lock(&stream.shared.loader), lock(&stream.shared.pawns));
        let (_inbox, _desk) = (lock(&inbox), lock(&stream.shared.desk));
        let _cell = stream.shared.snapshots.current.hold_a_publication();
        let (done, finished) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for _ in 0..100 {
                    pawn.hint(&motion_hint);
                    assert_eq!(overlaps(&stream.snapshot(), &shape), Overlap::Hit);
                    assert_eq!(overlaps(&pawn.snapshot(), &shape), Overlap::Hit);
                    let report = walker.step(&pawn.snapshot(), 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
                    assert!(report.ticks > 0 && report.missing.is_none());
                    pawn.hint(&walker.motion_hint(stream.archive().frame()));
                }
                done.send(()).unwrap();
            });
            // A frame that waits for a lock would hang here, and the process with it: report it and exit.
            if finished.recv_timeout(Duration::from_secs(20)).is_err() {
                eprintln!("a frame waited for a lock");
                std::process::abort();
            }
        });
        assert_eq!(stream.shared.hints_dropped.load(Relaxed), 200, "hints do not wait either");
    }
}
