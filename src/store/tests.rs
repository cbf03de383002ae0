//! A model of the loader: drives it in arbitrary orders and checks its contract after every step.

use super::fetch::{Cargo, Decode};
use super::*;
use crate::archive::{Archive, ArchiveWriter, ColourReader, EncodedColours, PageEncoder, Totals};
use crate::bytes::ByteSource;
use crate::bytes::testing::Strike;
use crate::codec::ColourEncoder;
use crate::colour::{ColourPlan, ColourScale};
use crate::edit::{Edits, Prism};
use crate::frame::{Frame, PageKey};
use crate::page::{Occupancy, Page, PageBuilder, Span};
use crate::plan::Plan;
use crate::{Error, NoMonitor, Parameter};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::Range;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

/// The bytes of an archive of these pages, in order of their keys. `colour` gives the colour of a voxel by the number of
/// its page and its own.
pub fn written(
    pages: &[(PageKey, Page)],
    levels: bool,
    colour: Option<&dyn Fn(usize, usize) -> Option<[u16; 3]>>,
) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
    let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
    let plan_of_colours = ColourPlan { scale: ColourScale::of_rgb(65_535), error_milli: 0 };
    if levels {
        writer.set_levels();
    }
    if colour.is_some() {
        writer.set_colours(plan_of_colours);
    }
    let (mut encoder, mut of_colours) = (PageEncoder::new(plan.frame), ColourEncoder::default());
    for (number, (key, page)) in pages.iter().enumerate() {
        let mut encoded = encoder.encode(*key, page);
        if let Some(colour) = colour {
            let occupancy = Occupancy::of(page);
            let colours: Vec<_> = (0..occupancy.len()).map(|voxel| colour(number, voxel)).collect();
            let colours = EncodedColours::new(&plan_of_colours, &occupancy, &colours, &mut of_colours);
            encoded = encoded.with_colours(colours);
        }
        writer.put(*key, encoded).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    std::fs::read(&target).unwrap()
}

/// 12 × 3 pages of rough ground; every fourth has no colours.
pub fn archive(levels: bool) -> Vec<u8> {
    let mut keys: Vec<_> = (0..36).map(|n| PageKey { tx: n % 12, ty: n / 12, layer: 0 }).collect();
    keys.sort_unstable();
    let ground = |number: u32| {
        let mut page = PageBuilder::default();
        for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            let top = 100 + (x * 31 + y * 17) % 5 * 60 + number;
            assert!(page.set_column(x, y, &[Span::new(0, top, false).unwrap()]));
        }
        page.build()
    };
    let pages: Vec<_> = keys.into_iter().zip((0..).map(ground)).collect();
    let colour = |number: usize, voxel: usize| {
        (!number.is_multiple_of(4)).then_some([(voxel * 257 % 65_536) as u16, (number * 1000) as u16, 30_000])
    };
    written(&pages, levels, Some(&colour))
}

pub fn keys(archive: &Archive) -> Vec<PageKey> {
    archive.entries().map(|entry| entry.unwrap().key).collect()
}

/// An archive with colours, its pages, and where the colours of each lie.
type Scene = (Vec<u8>, Vec<PageKey>, Vec<Range<u64>>);

static SCENE: LazyLock<Scene> = LazyLock::new(|| {
    let bytes = archive(false);
    let open = Archive::from_bytes(bytes.clone()).unwrap();
    let (all, mut reader) = (keys(&open), ColourReader::new(&open).unwrap().unwrap());
    let ranges = all.iter().map(|key| reader.find(*key).unwrap().range()).collect();
    (bytes, all, ranges)
});

#[derive(Debug, Clone)]
enum Act {
    Poll,
    Give(usize),
    /// Gives too few bytes.
    Cut(usize),
    Fail(usize),
    /// Answers a fetch that was given up.
    Late(usize),
    Decode(usize),
    Hint(u8, bool),
    Forget,
    Request(u8, u8),
    Want(u8, u8),
    Take,
    Pass(u8),
    Hold(bool),
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        8 => Just(Act::Poll),
        6 => any::<usize>().prop_map(Act::Give),
        1 => any::<usize>().prop_map(Act::Cut),
        2 => any::<usize>().prop_map(Act::Fail),
        1 => any::<usize>().prop_map(Act::Late),
        5 => any::<usize>().prop_map(Act::Decode),
        2 => (0u8..12, any::<bool>()).prop_map(|(x, waits)| Act::Hint(x, waits)),
        1 => Just(Act::Forget),
        1 => (0u8..36, 1u8..12).prop_map(|(first, count)| Act::Request(first, count)),
        2 => (0u8..36, 0u8..72).prop_map(|(first, count)| Act::Want(first, count)),
        3 => Just(Act::Take),
        2 => (0u8..40).prop_map(Act::Pass),
        1 => any::<bool>().prop_map(Act::Hold),
    ]
}

struct Model {
    loader: Loader,
    body: BodyId,
    budget: usize,
    fetches: usize,
    out: BTreeMap<FetchId, Fetch>,
    gone: Vec<Fetch>,
    decodes: Vec<Decode>,
    requests: BTreeSet<RequestId>,
    /// Bytes of colours that were given.
    given: Vec<Range<u64>>,
    /// Pages whose colours were wanted and did not come since.
    wanted: HashSet<PageKey>,
    /// Pages of the last wish that were in memory then.
    wish: HashSet<PageKey>,
    came: usize,
    held: Option<Snapshot>,
    now: Time,
}

impl Model {
    fn new(budget: usize, fetches: usize) -> Self {
        let open = Archive::from_bytes(SCENE.0.clone()).unwrap();
        let options = LoaderOptions { fetches, ..LoaderOptions::new(budget) };
        let mut loader = Loader::new(open.catalog().clone(), options).unwrap();
        let body = loader.body();
        let (out, gone, decodes, requests) = Default::default();
        let (given, wanted, wish, held) = Default::default();
        let mut model = Self {
            loader,
            body,
            budget,
            fetches,
            out,
            gone,
            decodes,
            requests,
            given,
            wanted,
            wish,
            came: 0,
            held,
            now: Time::ZERO,
        };
        model.all();
        model
    }

    /// Does one action of a poll; returns whether there are more.
    fn poll(&mut self) -> bool {
        match self.loader.poll(self.now).unwrap() {
            Next::Fetch(fetch) => {
                assert!(!fetch.range.is_empty());
                assert!(self.out.insert(fetch.id, fetch).is_none());
            }
            Next::Cancel(id) => self.gone.push(self.out.remove(&id).expect("a fetch that is out")),
            Next::Report(page) => assert!(matches!(page.error, Error::Io { .. }), "{}", page.error),
            Next::Wait(until) => {
                assert!(until.is_none_or(|until| until > self.now), "{until:?} at {:?}", self.now);
                return false;
            }
        }
        true
    }

    fn nth(&mut self, at: usize) -> Option<Fetch> {
        let id = *self.out.keys().nth(at % self.out.len().max(1))?;
        self.out.remove(&id)
    }

    fn give(&mut self, fetch: &Fetch, less: u64) -> bool {
        let bytes = SCENE.0[fetch.range.start as usize..(fetch.range.end - less) as usize].to_vec();
        let job = self.loader.given(fetch.id, bytes, self.now);
        let has_work = job.is_some();
        self.decodes.extend(job);
        has_work
    }

    fn take(&mut self) -> bool {
        let Some((key, colours)) = self.loader.take_colours() else { return false };
        match colours {
            Ok(_) => {
                let own = &SCENE.2[SCENE.1.binary_search(&key).unwrap()];
                let has_come = |given: &Range<u64>| given.start <= own.start && own.end <= given.end;
                assert!(own.is_empty() || self.given.iter().any(has_come), "{key}: its colours were not given");
                assert!(self.wanted.remove(&key), "{key}: colours twice");
                self.wish.remove(&key);
                self.came += 1;
            }
            Err(error) => assert!(matches!(error, Error::Io { .. }), "{error}"),
        }
        true
    }

    fn run(&mut self, act: &Act) {
        match *act {
            Act::Poll => drop(self.poll()),
            Act::Give(at) => {
                if let Some(fetch) = self.nth(at) {
                    self.given.extend((fetch.what == Payload::Colours).then(|| fetch.range.clone()));
                    self.give(&fetch, 0);
                }
            }
            Act::Cut(at) => {
                if let Some(fetch) = self.nth(at) {
                    assert!(!self.give(&fetch, 1));
                }
            }
            Act::Fail(at) => {
                if let Some(fetch) = self.nth(at) {
                    let error = Error::io("link", "read", std::io::ErrorKind::TimedOut.into());
                    self.loader.failed(fetch.id, error, self.now);
                }
            }
            Act::Late(at) => {
                if let Some(fetch) = self.gone.get(at % self.gone.len().max(1)).cloned() {
                    assert!(!self.give(&fetch, 0), "it was given up");
                }
            }
            Act::Decode(at) => {
                if !self.decodes.is_empty() {
                    let job = self.decodes.swap_remove(at % self.decodes.len());
                    self.loader.loaded(job.run(), self.now);
                }
            }
            Act::Hint(x, waits) => {
                let at = nalgebra::Point3::new(f64::from(x) * 3.2 + 0.5, 4.0, 1.0);
                let size = nalgebra::Vector3::new(0.5, 0.5, 1.8);
                let hint = MotionHint::walking(at, at + size, nalgebra::Vector3::new(3.0, 0.0, 0.0));
                self.loader.hint(self.body, &hint);
                if waits {
                    self.loader.need(self.body, &Missing::one(SCENE.1[usize::from(x)]));
                }
            }
            Act::Forget => {
                self.loader.forget(self.body);
                self.body = self.loader.body();
            }
            Act::Request(first, count) => {
                let keys: Vec<_> = SCENE.1.iter().cycle().skip(first.into()).take(count.into()).copied().collect();
                self.requests.insert(self.loader.request(&keys, keys[0]));
            }
            Act::Want(first, count) => {
                let keys: Vec<_> = SCENE.1.iter().cycle().skip(first.into()).take(count.into()).copied().collect();
                self.wanted.extend(&keys);
                let view = self.loader.snapshot().unwrap();
                self.wish = keys.iter().copied().filter(|key| view.is_loaded(*key) == Some(true)).collect();
                self.loader.want_colours(&keys);
            }
            Act::Take => drop(self.take()),
            Act::Pass(steps) => self.now += Duration::from_millis(50) * u32::from(steps),
            Act::Hold(holds) => self.held = self.loader.snapshot().filter(|_| holds),
        }
        self.check();
    }

    fn check(&self) {
        let counters = self.loader.counters();
        assert!(counters.used_bytes <= counters.peak_bytes && counters.peak_bytes <= self.budget, "{counters:?}");
        let (mut pages, mut colours, mut contents) = (0, 0, HashSet::new());
        for flight in self.loader.flights.values() {
            match &flight.cargo {
                Cargo::Pages(run) => {
                    pages += 1;
                    assert!(run.contents.iter().all(|(content, _)| contents.insert(*content)), "a page twice");
                }
                Cargo::Colours(_) => colours += 1,
                _ => {}
            }
        }
        assert!(pages <= self.fetches && colours <= 1, "{pages} and {colours} fetches");
        let of_colours = self.out.values().filter(|fetch| fetch.what == Payload::Colours).count();
        assert_eq!(self.loader.flights.values().count(), self.out.len() + self.decodes.len());
        assert!(of_colours <= colours);
        // A large budget never evicts, so a page of the last wish stays wanted until its colours have come.
        if let Some(queue) = self.loader.colours.as_ref().filter(|_| self.budget > 8 << 20) {
            let has_come = |key: &PageKey| queue.ready.iter().any(|(other, made)| other == key && made.is_ok());
            let lost = self.wish.iter().find(|key| !queue.wanted.contains(key) && !has_come(key));
            assert!(lost.is_none(), "{lost:?} is wanted no longer");
        }
    }

    /// Answers and decodes everything that is out; returns whether there was any.
    fn bring(&mut self) -> bool {
        let is_busy = !self.out.is_empty() || !self.decodes.is_empty();
        while let Some(fetch) = self.nth(0) {
            self.given.extend((fetch.what == Payload::Colours).then(|| fetch.range.clone()));
            self.give(&fetch, 0);
        }
        while let Some(job) = self.decodes.pop() {
            self.loader.loaded(job.run(), self.now);
        }
        is_busy
    }

    /// Does everything until nothing is left to do.
    fn all(&mut self) {
        for _ in 0..4000 {
            let mut busy = self.poll() | self.bring();
            while self.take() {
                busy = true;
            }
            self.requests.retain(|request| self.loader.outcome(*request).is_none());
            if !busy {
                match self.loader.poll(self.now).unwrap() {
                    Next::Wait(Some(until)) if until < self.now + Duration::from_secs(10) => self.now = until,
                    Next::Wait(_) => return,
                    Next::Fetch(fetch) => drop(self.out.insert(fetch.id, fetch)),
                    Next::Cancel(id) => drop(self.out.remove(&id)),
                    Next::Report(_) => {}
                }
            }
        }
        panic!("it never ends");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    /// Colours are those of bytes that came, once for each wish; nothing is fetched twice at a time; the budget holds;
    /// and in the end all that was wanted is here, whatever failed or was given up meanwhile.
    #[test]
    #[ignore = "slow: .ci/run"]
    fn what_is_wanted_comes_once_in_any_order_of_events(
        budget in prop_oneof![Just(1100usize << 10), Just(1600 << 10), Just(64 << 20)],
        fetches in 1usize..4,
        is_warm in any::<bool>(),
        acts in proptest::collection::vec(act(), 0..160),
    ) {
        let mut model = Model::new(budget, fetches);
        if is_warm {
            // Two thirds of the pages, and where their colours lie.
            model.run(&Act::Request(0, 24));
            model.all();
            model.run(&Act::Want(0, 1));
            model.all();
        }
        for act in &acts {
            model.run(act);
        }
        model.held = None;
        model.all();
        prop_assert!(model.wish.is_empty() || budget < 8 << 20, "they stay wanted: {:?}", model.wish);
        // All pages, if there is room, and no body that wants other ones.
        model.run(&Act::Forget);
        model.run(&Act::Request(0, 36));
        model.all();
        prop_assert!(model.requests.is_empty() && model.out.is_empty() && model.decodes.is_empty());
        model.run(&Act::Want(0, 36));
        model.wanted = SCENE.1.iter().copied().collect();
        let view = model.loader.snapshot().unwrap();
        let loaded = |key: &PageKey| view.is_loaded(*key) == Some(true);
        let resident = SCENE.1.iter().filter(|key| loaded(key)).count();
        prop_assert!(resident == 36 || budget < 8 << 20);
        drop(view);
        let came = model.came;
        model.all();
        let view = model.loader.snapshot().unwrap();
        let left = model.wanted.iter().filter(|key| view.is_loaded(**key) == Some(true)).count();
        prop_assert_eq!(left, 0, "pages in memory without colours");
        prop_assert!(model.came > came && model.came - came <= 36);
    }
}

/// Memory that is neither of pages nor of snapshots (the table, colours, edited pages) is not waited for: pages make
/// room for others.
#[test]
fn pages_make_room_although_others_hold_a_part_of_the_budget() {
    let mut model = Model::new(1 << 20, 2);
    let _other = model.loader.budget().take(400 << 10).unwrap();
    // All pages are wanted, some of them later.
    let (low, high) = ([0.5, 4.0, 1.0].into(), [1.0, 4.5, 2.8].into());
    let hint = MotionHint::walking(low, high, nalgebra::Vector3::new(60.0, 0.0, 0.0));
    model.loader.hint(model.body, &hint);
    model.all();
    let view = model.loader.snapshot().unwrap();
    let absent: Vec<_> = SCENE.1.iter().copied().filter(|key| view.is_loaded(*key) == Some(false)).collect();
    assert!(!absent.is_empty() && absent.len() < 30, "{absent:?}");
    drop(view);
    let request = model.loader.request(&absent[..1], absent[0]);
    let report = loop {
        model.poll();
        model.bring();
        if let Some(outcome) = model.loader.outcome(request) {
            break outcome.unwrap();
        }
        model.now += Duration::from_millis(10);
    };
    assert_eq!((report.loaded, report.left_out), (1, 0), "{report:?}");
    assert!(report.evicted > 0);
}

/// Fails every third read of colours.
struct Flaky {
    colours: Range<u64>,
    reads: AtomicUsize,
}

impl ByteSource for Flaky {
    fn len(&self) -> u64 {
        SCENE.0.len() as u64
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> crate::Result<()> {
        if self.colours.contains(&offset) && self.reads.fetch_add(1, Relaxed).is_multiple_of(3) {
            return Err(Error::io("link", "read", std::io::ErrorKind::TimedOut.into()));
        }
        buf.copy_from_slice(&SCENE.0[offset as usize..][..buf.len()]);
        Ok(())
    }
}

#[test]
fn a_stream_asks_for_colours_again_after_every_failure() {
    let open = Archive::from_bytes(SCENE.0.clone()).unwrap();
    for prefetch in [Prefetch::Manual, Prefetch::Thread] {
        let source = Flaky { colours: open.catalog().colours_section().unwrap(), reads: AtomicUsize::new(0) };
        let options = StreamOptions { prefetch, ..StreamOptions::new(64 << 20) };
        let stream = Stream::open(Archive::from_source(Box::new(source)).unwrap(), options).unwrap();
        stream.load(&SCENE.1, SCENE.1[0]).unwrap();
        stream.want_colours(&SCENE.1);
        let (start, mut came, mut failed) = (std::time::Instant::now(), 0, 0);
        while came < SCENE.1.len() {
            assert!(start.elapsed().as_secs() < 60, "{came} pages with colours after {failed} failures");
            stream.step();
            while let Some((key, colours)) = stream.take_colours() {
                match colours {
                    Ok(_) => came += 1,
                    Err(error) => {
                        assert!(matches!(error, Error::Io { .. }), "{key}: {error}");
                        failed += 1;
                    }
                }
            }
        }
        assert!(failed >= 2, "{failed} failures");
    }
}

/// Hints of a body that is gone, answers to fetches that were given up, and colours before the archive is open.
#[test]
fn what_comes_too_early_or_too_late_is_ignored() {
    let mut early = Loader::open(None, LoaderOptions::new(1 << 20));
    early.want_colours(&SCENE.1);
    assert!(!early.has_colours() && early.take_colours().is_none());
    let Model { mut loader, body, now, .. } = Model::new(64 << 20, 2);
    let hint = MotionHint::walking([0.5, 4.0, 1.0].into(), [1.0, 4.5, 2.8].into(), nalgebra::Vector3::zeros());
    loader.hint(body, &MotionHint { gravity: f64::NAN, ..hint });
    assert_eq!(loader.counters().hints_dropped, 1);
    loader.forget(body);
    loader.hint(body, &hint);
    loader.need(body, &Missing::one(SCENE.1[0]));
    assert!(matches!(loader.poll(now).unwrap(), Next::Wait(None)));
    let fetched = |loader: &mut Loader| {
        let request = loader.request(&SCENE.1[..1], SCENE.1[0]);
        let Next::Fetch(Fetch { id, range, .. }) = loader.poll(now).unwrap() else { panic!("no fetch") };
        (request, id, loader.given(id, SCENE.0[range.start as usize..range.end as usize].to_vec(), now).unwrap())
    };
    let lost = || Error::io("link", "read", std::io::ErrorKind::ConnectionReset.into());
    // Given up while it is decoded, twice.
    let (request, id, job) = fetched(&mut loader);
    loader.failed(id, lost(), now);
    assert!(loader.outcome(request).unwrap().is_err());
    assert_eq!((loader.loaded(job.run(), now), loader.counters().loaded), (0, 0));
    loader.failed(id, lost(), now);
    assert_eq!(loader.counters().failed, 1);
    // It comes when it is asked for again.
    let (_, _, job) = fetched(&mut loader);
    assert_eq!(loader.loaded(job.run(), now), 1);
    assert_eq!(loader.snapshot().unwrap().is_loaded(SCENE.1[0]), Some(true));
}

#[test]
fn a_stream_of_an_edited_archive_has_the_columns_of_a_resident_snapshot() {
    let whole = [SCENE.0.clone(), written(&[], false, None)];
    let taken = Prism::of_box([0.5, 0.5, -1.0], [1.0, 1.0, 5.0]).unwrap();
    // In another region, and layers above the rest.
    let added = Prism::of_box([-5.0, 1.0, 20.0], [-4.5, 2.0, 31.0]).unwrap();
    let mut edits = [Edits::default(), Edits::default()];
    edits[0].remove(taken.clone()).unwrap();
    edits[1].remove(taken).unwrap();
    edits[1].add(added, true).unwrap();
    for (bytes, edits) in whole.iter().flat_map(|bytes| edits.iter().map(move |edits| (bytes, edits))) {
        let edited = || Archive::from_bytes(bytes.clone()).unwrap().with_edits(edits.clone());
        let expected = Snapshot::resident(&edited(), &NoMonitor).unwrap();
        let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(64 << 20) };
        let stream = Stream::open(edited(), options).unwrap();
        let all = keys(stream.archive());
        if let Some(first) = all.first() {
            assert_eq!(stream.load(&all, *first).unwrap().left_out, 0);
        }
        let (low, high) = ([0.5, 4.0, 1.0].into(), [1.0, 4.5, 2.8].into());
        stream.load_around(&MotionHint::walking(low, high, nalgebra::Vector3::zeros())).unwrap();
        let found = stream.snapshot();
        assert_eq!(found.bounds(), expected.bounds());
        let columns = |view: &Snapshot| -> BTreeMap<_, Vec<_>> {
            let column = |number| {
                let (tx, ty, slots) = view.column_at(number);
                let slots = slots.iter().map(|slot| (slot.layer(), slot.slices(), slot.page().cloned()));
                ((tx, ty), slots.collect())
            };
            (0..view.column_count()).map(column).collect()
        };
        assert_eq!(found.column_count(), expected.column_count());
        assert!(columns(&found) == columns(&expected));
        let regions = |view: &Snapshot| [(0, 0), (-1, 0), (0, -1)].map(|(rx, ry)| view.has_region(rx, ry));
        assert_eq!(regions(&found), regions(&expected));
    }
    // Pages with edits stay in memory, so they must fit.
    for (edits, pages) in edits.iter().zip(["1 page", "3 pages"]) {
        let open = |budget: usize| {
            let edited = Archive::from_bytes(SCENE.0.clone()).unwrap().with_edits(edits.clone());
            Stream::open(edited, StreamOptions::new(budget)).map(drop)
        };
        let error = open(10_000).unwrap_err();
        assert!(matches!(error, Error::Parameter { what: Parameter::Cache, .. }), "{error}");
        let said = error.to_string();
        let enough = said.split(&format!("10000 bytes do not hold the {pages} with edits; give ")).nth(1);
        let enough = enough.and_then(|rest| rest.split(' ').next()?.parse().ok()).expect(&said);
        open(enough).unwrap();
        assert!(open(enough - 1).is_err());
    }
    // A stop is heard while they are edited, too.
    let stops = |archive: Archive| {
        let is_stopped = |at: &u64| matches!(Snapshot::resident(&archive, &*Strike::at(*at)), Err(Error::Interrupted));
        (0..).take_while(is_stopped).count()
    };
    let plain = || Archive::from_bytes(SCENE.0.clone()).unwrap();
    assert!(stops(plain().with_edits(edits[0].clone())) > stops(plain()));
}
