//! The loader as a state machine, driven by a script of commands, answers, failures and time in any order.

use super::script::Script;
use super::{Read, digest};
use nalgebra::{Point3, Vector3};
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::{
    BodyId, Decode, Decoded, Fetch, Loader, LoaderOptions, MotionHint, Next, RequestId, Snapshot, Time,
};
use slicewalk::{Error, NoMonitor};
use std::io::ErrorKind;
use std::sync::LazyLock;
use std::time::Duration;

/// Twelve small pages with levels; other targets test the contents of pages.
const BYTES: &[u8] = include_bytes!("loader-archive");
/// Steps after which a script ends, and polls after which a loader that never waits counts as hung.
const STEPS: usize = 400;
const POLLS: usize = 10_000;

/// Budgets in bytes: too small for the table, for reading a page, then enough for one page, a few pages, all pages, a
/// few concurrent fetches, and everything that may be in flight. Reading a page takes 287 kB; the table and all pages
/// take 10 kB.
const BUDGETS: [usize; 8] = [1 << 12, 1 << 18, 292_000, 294_000, 296_000, 1 << 19, 1 << 20, 1 << 21];

/// The true content of the archive.
struct Truth {
    archive: Archive,
    keys: Vec<PageKey>,
    /// All pages in memory.
    store: Snapshot,
}

static TRUTH: LazyLock<Truth> = LazyLock::new(|| {
    let archive = Archive::from_bytes(BYTES.to_vec()).expect("a sound sample");
    let keys = archive.entries().map(|entry| entry.map(|entry| entry.key)).collect::<Result<_, _>>();
    let store = Snapshot::resident(&archive, &NoMonitor).expect("a sound sample");
    Truth { keys: keys.expect("a sound sample"), store, archive }
});

/// The loader's driver, which works as badly as the script says.
struct Driver {
    loader: Loader,
    now: Time,
    on_the_way: Vec<Fetch>,
    jobs: Vec<Decode>,
    decoded: Vec<Decoded>,
    requests: Vec<RequestId>,
    views: Vec<Snapshot>,
    seen: Vec<String>,
}

impl Driver {
    /// Polls the loader; returns true once it waits for nothing or has ended.
    fn poll(&mut self) -> bool {
        for _ in 0..POLLS {
            match self.loader.poll(self.now) {
                Ok(Next::Fetch(fetch)) => {
                    assert!(
                        fetch.range.start < fetch.range.end && fetch.range.end <= (64 << 10).max(BYTES.len() as u64)
                    );
                    self.seen.push(format!("{:?}", fetch.range));
                    self.on_the_way.push(fetch);
                }
                Ok(Next::Cancel(id)) => {
                    self.seen.push(format!("cancel {id:?}"));
                    self.on_the_way.retain(|fetch| fetch.id != id);
                }
                Ok(Next::Report(report)) => self.seen.push(format!("{report:?}")),
                Ok(Next::Wait(until)) => return until.is_none(),
                Err(_) => return true,
            }
        }
        panic!("the loader never waits");
    }

    fn answer(&mut self, at: usize, manner: usize, script: &mut Script) {
        let fetch = self.on_the_way.swap_remove(at);
        let end = (fetch.range.end as usize).min(BYTES.len());
        let mut bytes = BYTES[(fetch.range.start as usize).min(end)..end].to_vec();
        match manner {
            0 => {
                let error = Error::io("link", "read", ErrorKind::ConnectionReset.into());
                return self.loader.failed(fetch.id, error, self.now);
            }
            1 => bytes.truncate(script.below(bytes.len().max(1))),
            2 => script.change_in_place(&mut bytes),
            3 => bytes.push(0),
            _ => {}
        }
        self.jobs.extend(self.loader.given(fetch.id, bytes, self.now));
    }

    fn check(&mut self) {
        let counters = self.loader.counters();
        assert!(counters.peak_bytes <= counters.budget_bytes, "{counters:?}");
        let Some(view) = self.loader.snapshot() else { return };
        let at = self.seen.len() as u16;
        let shape = shape(at.wrapping_mul(40_503));
        let answer = overlaps(&view, &shape);
        assert!(matches!(answer, Overlap::NotLoaded(_)) || answer == overlaps(&TRUTH.store, &shape), "{shape:?}");
    }
}

/// Runs a script. Whatever a driver does, no view contains a wrong page, memory stays within the budget, and good
/// answers at the end load everything requested.
pub fn loader(bytes: &[u8]) -> Read {
    let mut script = Script(bytes);
    let budget = BUDGETS[script.below(BUDGETS.len())];
    let options = LoaderOptions {
        fetches: 1 + script.below(4),
        run_bytes: [0, 1000, 256 << 10][script.below(3)],
        ..LoaderOptions::new(budget)
    };
    let loader = match script.below(3) {
        0 => Loader::open(None, options),
        1 => Loader::open(Some(BYTES.len() as u64), options),
        _ => match Loader::new(TRUTH.archive.catalog().clone(), options) {
            Ok(loader) => loader,
            Err(_) => return None,
        },
    };
    let mut driver = Driver {
        loader,
        now: Time::ZERO,
        on_the_way: Vec::new(),
        jobs: Vec::new(),
        decoded: Vec::new(),
        requests: Vec::new(),
        views: Vec::new(),
        seen: Vec::new(),
    };
    let mut bodies: Vec<BodyId> = Vec::new();
    let keys = &TRUTH.keys;
    for _ in 0..STEPS {
        if script.is_over() {
            break;
        }
        match script.below(12) {
            0 if bodies.len() < 8 => bodies.push(driver.loader.body()),
            1 | 2 => {
                let (at, motion) = (script.short(), script.byte());
                if let Some(&body) = bodies.get(usize::from(motion) % bodies.len().max(1)) {
                    driver.loader.hint(body, &motion_hint(at, motion));
                }
            }
            3 if !bodies.is_empty() => driver.loader.forget(bodies.swap_remove(script.below(bodies.len()))),
            4 => {
                let wanted: Vec<_> = (0..script.below(4)).map(|_| keys[script.below(keys.len())]).collect();
                let around = keys[script.below(keys.len())];
                driver.requests.push(driver.loader.request(&wanted, around));
            }
            5 => {
                let loader = &mut driver.loader;
                driver.requests.retain(|&request| loader.outcome(request).is_none());
            }
            6 => _ = driver.poll(),
            7 if !driver.on_the_way.is_empty() => {
                let (at, manner) = (script.below(driver.on_the_way.len()), script.below(12));
                driver.answer(at, manner, &mut script);
            }
            8 => driver.decoded.extend(driver.jobs.pop().map(Decode::run)),
            9 => {
                if let Some(decoded) = driver.decoded.pop() {
                    driver.loader.loaded(decoded, driver.now);
                }
            }
            10 if driver.views.len() < 4 => driver.views.extend(driver.loader.snapshot()),
            10 => driver.views.clear(),
            11 => driver.now += Duration::from_millis(u64::from(script.short())),
            _ => {}
        }
        driver.check();
    }
    finish(driver)
}

/// Answers well until the loader is idle. Then every request has its outcome, and a request for all pages has loaded
/// them if the budget suffices, except for pages that arrived damaged before, which are lost for good.
fn finish(mut driver: Driver) -> Read {
    driver.views.clear();
    let last = driver.loader.request(&TRUTH.keys, TRUTH.keys[0]);
    // A damaged directory or too small a budget may have ended the loader for good.
    for _ in 0..100 {
        let has_work = !(driver.on_the_way.is_empty() && driver.jobs.is_empty() && driver.decoded.is_empty());
        let is_quiet = driver.poll() && driver.on_the_way.is_empty() && !has_work;
        while !driver.on_the_way.is_empty() {
            driver.answer(0, usize::MAX, &mut Script(&[]));
        }
        for job in std::mem::take(&mut driver.jobs) {
            driver.decoded.push(job.run());
        }
        for decoded in std::mem::take(&mut driver.decoded) {
            driver.loader.loaded(decoded, driver.now);
        }
        driver.now += Duration::from_secs(7);
        driver.check();
        if is_quiet {
            break;
        }
    }
    let view = driver.loader.snapshot()?;
    let counters = driver.loader.counters();
    for request in std::mem::take(&mut driver.requests) {
        assert!(driver.loader.outcome(request).is_some(), "{request:?} never ends: {:?}", driver.seen);
    }
    match driver.loader.outcome(last).expect("good answers end every request") {
        Ok(report) => {
            let keys = &TRUTH.keys;
            let there = keys.iter().filter(|key| view.is_loaded(**key) == Some(true)).count();
            let said = report.loaded + report.already + report.left_out;
            assert!(said >= keys.len(), "{report:?}, {:?}", driver.seen);
            let has_room = counters.budget_bytes >= report.needed_bytes;
            assert!(!has_room || there == keys.len(), "{there} pages, {report:?}, {counters:?}, {:?}", driver.seen);
        }
        Err(error) => assert!(counters.failed > 0, "{error}"),
    }
    (counters.failed > 0).then(|| digest((driver.seen, counters.resident_pages)))
}

/// A place inside or outside the archive.
fn feet(at: u16) -> Point3<f64> {
    let (min, max) = TRUTH.archive.header().bounds.expect("the sample has matter");
    let share = |bits: u16| f64::from(bits & 31) / 24.0;
    Point3::from(std::array::from_fn(|axis| min[axis] + share(at >> (5 * axis)) * (max[axis] - min[axis])))
}

/// A box of a person's size.
fn shape(at: u16) -> Aabb {
    let feet = feet(at);
    Aabb::new(feet - Vector3::new(0.3, 0.3, 0.0), feet + Vector3::new(0.3, 0.3, 1.8)).expect("finite numbers")
}

/// A moving body of that size.
fn motion_hint(at: u16, motion: u8) -> MotionHint {
    let (feet, speed) = (feet(at), |bits: u8| f64::from(bits & 3) - 1.0);
    let velocity = Vector3::new(speed(motion), speed(motion >> 2), speed(motion >> 4)) * 3.0;
    MotionHint::walking(feet - Vector3::new(0.3, 0.3, 0.0), feet + Vector3::new(0.3, 0.3, 1.8), velocity)
}
