//! Streams, and a conversion's ordered hand-over of jobs, in schedules chosen by the test: threads are switched at
//! every synchronisation (shuttle), so a lost wake-up becomes a deadlock that the test detects. `.ci/long schedules`
//! builds and runs it; `SLICEWALK_SCHEDULES` sets the number of random schedules per scene, and a failing one is
//! printed for a rerun.
#![cfg(slicewalk_schedules)]

/// Replaces the `sync` module of `hand_over.rs` by shuttle's.
mod sync {
    use shuttle::sync::{Arc, Mutex, mpsc};
    pub use shuttle::thread::{Scope, scope};

    pub const HAS_THREADS: bool = true;

    pub struct Sender<T>(mpsc::SyncSender<T>);
    pub struct Receiver<T>(Arc<Mutex<mpsc::Receiver<T>>>);

    pub fn bounded<T>(capacity: usize) -> (Sender<T>, Receiver<T>) {
        let (sender, receiver) = mpsc::sync_channel(capacity);
        (Sender(sender), Receiver(Arc::new(Mutex::new(receiver))))
    }

    impl<T> Clone for Sender<T> {
        fn clone(&self) -> Self {
            Self(self.0.clone())
        }
    }

    impl<T> Sender<T> {
        pub fn send(&self, value: T) -> Result<(), mpsc::SendError<T>> {
            self.0.send(value)
        }
    }

    impl<T> Clone for Receiver<T> {
        fn clone(&self) -> Self {
            Self(self.0.clone())
        }
    }

    impl<T> Receiver<T> {
        pub fn recv(&self) -> Result<T, mpsc::RecvError> {
            self.0.lock().unwrap().recv()
        }
    }

    pub fn start<'scope, 'env>(
        scope: &'scope Scope<'scope, 'env>,
        work: impl FnOnce() + Send + 'scope,
    ) -> std::io::Result<()> {
        scope.spawn(work);
        Ok(())
    }
}

#[path = "../crates/convert/src/pipeline.rs"]
mod pipeline;

use hand_over::{Closed, HandOver};
use nalgebra::{Point3, Vector3};
use shuttle::sync::atomic::{AtomicUsize, Ordering};
use shuttle::thread;
use slicewalk::archive::{Archive, ArchiveWriter, PageEncoder, Totals};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::plan::Plan;
use slicewalk::query::{Aabb, Overlap, overlaps};
use slicewalk::store::{MotionHint, Prefetch, Stream, StreamOptions};
use std::sync::{Arc, LazyLock, OnceLock};
use std::time::Duration;

/// Pages in a row along x, 3.2 m each.
const PAGES: i32 = 4;
const FOREVER: Duration = Duration::from_secs(1 << 20);

/// A solid block in each of the pages.
static BYTES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let plan = Plan::new(Frame::new(0.05, 0.15).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("a.slices");
    let mut writer = ArchiveWriter::create(&target, &plan, false).unwrap();
    let mut encoder = PageEncoder::new(plan.frame);
    for tx in 0..PAGES {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(10, 20, &[Span::new(0, 255 + tx as u32, false).unwrap()]));
        let key = PageKey { tx, ty: 0, layer: 0 };
        writer.put(key, encoder.encode(key, &builder.build())).unwrap();
    }
    writer.finish(Totals::default()).unwrap();
    std::fs::read(&target).unwrap()
});

fn stream(budget_bytes: usize) -> Stream {
    let options = StreamOptions { prefetch: Prefetch::Thread, ..StreamOptions::new(budget_bytes) };
    Stream::open(Archive::from_bytes(BYTES.clone()).unwrap(), options).unwrap()
}

/// A box on the block of page `page`, and a body there.
fn body(page: i32) -> (Aabb, MotionHint) {
    let x = 3.2 * f64::from(page) + 0.5;
    let (min, max) = (Point3::new(x, 1.0, 0.0), Point3::new(x + 0.1, 1.1, 0.1));
    (Aabb::new(min, max).unwrap(), MotionHint::walking(min, max, Vector3::zeros()))
}

/// Runs `scene` in random schedules, and in schedules with few switches at the worst places (PCT).
fn schedules(scene: impl Fn() + Send + Sync + 'static) {
    let runs = std::env::var("SLICEWALK_SCHEDULES").map_or(2_000, |runs| runs.parse().unwrap());
    LazyLock::force(&BYTES);
    let scene = Arc::new(scene);
    let again = scene.clone();
    shuttle::check_random(move || scene(), runs);
    shuttle::check_pct(move || again(), runs, 3);
}

#[test]
fn what_a_hint_wants_comes_without_another_call() {
    schedules(|| {
        let stream = stream(1 << 20);
        let mut pawn = stream.pawn();
        let (shape, motion_hint) = body(1);
        pawn.hint(&motion_hint);
        // If the thread is just reading hints, one is dropped and counted.
        while stream.counters().hints_dropped > 0 && overlaps(&stream.snapshot(), &shape) != Overlap::Hit {
            pawn.hint(&motion_hint);
            assert!(stream.settle(FOREVER));
        }
        assert!(stream.settle(FOREVER));
        assert_eq!(overlaps(&stream.snapshot(), &shape), Overlap::Hit);
    });
}

#[test]
fn bodies_on_their_threads_get_their_pages_or_not_loaded_and_never_free() {
    schedules(|| {
        let stream = Arc::new(stream(1 << 20));
        let bodies: Vec<_> = (0..2)
            .map(|page| {
                let stream = stream.clone();
                thread::spawn(move || {
                    let mut pawn = stream.pawn();
                    for page in [page, page + 1] {
                        let (shape, motion_hint) = body(page);
                        pawn.hint(&motion_hint);
                        match overlaps(&pawn.snapshot(), &shape) {
                            Overlap::Hit => {}
                            Overlap::NotLoaded(missing) => pawn.need(&missing),
                            clear => panic!("{clear:?} where there is solid"),
                        }
                        stream.load_around(&motion_hint).unwrap();
                        assert_eq!(overlaps(&pawn.snapshot(), &shape), Overlap::Hit);
                    }
                })
            })
            .collect();
        bodies.into_iter().for_each(|body| body.join().unwrap());
        assert!(stream.settle(FOREVER));
        assert!(stream.take_errors().is_empty());
    });
}

/// Two concurrent requests, and a body that comes and goes, with room for one page beside that of the body.
#[test]
fn requests_at_once_get_their_pages_in_the_room_that_each_needs() {
    static BUDGET: OnceLock<usize> = OnceLock::new();
    schedules(move || {
        let budget = *BUDGET.get_or_init(|| {
            let all = stream(1 << 20);
            all.load_around(&body(3).1).unwrap();
            let beside = all.counters().resident_bytes;
            beside + (0..2).map(|page| all.load_around(&body(page).1).unwrap().needed_bytes).max().unwrap()
        });
        let stream = Arc::new(stream(budget));
        let mut pawn = stream.pawn();
        pawn.hint(&body(3).1);
        let loads: Vec<_> = (0..2)
            .map(|page| {
                let stream = stream.clone();
                thread::spawn(move || stream.load_around(&body(page).1).unwrap())
            })
            .collect();
        drop(pawn);
        for load in loads {
            let report = load.join().unwrap();
            assert_eq!(report.left_out, 0, "{report:?}, {:?}", stream.counters());
        }
        assert!(stream.settle(FOREVER));
        assert!(stream.counters().peak_bytes <= budget);
    });
}

#[test]
fn a_stream_that_is_dropped_ends_its_thread_whatever_it_does() {
    schedules(|| {
        let stream = stream(1 << 20);
        let mut pawn = stream.pawn();
        let speaker = thread::spawn(move || {
            for page in 0..PAGES {
                pawn.hint(&body(page).1);
            }
        });
        drop(stream);
        speaker.join().unwrap();
    });
}

/// Failure in a hand-over of `JOBS` jobs, by the job at which it occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    Give(u32),
    Work(u32),
    Take(u32),
    Check,
}

const JOBS: u32 = 5;

/// Hands jobs over once; checks that the first jobs are taken in order, and all of them unless something fails.
fn hand_over(threads: usize, ahead: usize, fault: Fault) {
    let fails = |at: Fault| if at == fault { Err(fault) } else { Ok(()) };
    let mut taken = Vec::new();
    let (begun, ended) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let done = HandOver { threads, ahead }.run(
        |job| {
            (0..JOBS).try_for_each(|number| {
                fails(Fault::Give(number))?;
                job(number).map_err(|Closed| Fault::None)
            })
        },
        || {
            |number: u32| {
                let begun = begun.fetch_add(1, Ordering::SeqCst) + 1;
                assert!(begun <= ended.load(Ordering::SeqCst) + ahead, "too many run ahead");
                fails(Fault::Work(number)).map(|()| number)
            }
        },
        |number| {
            fails(Fault::Take(number))?;
            taken.push(number);
            ended.fetch_add(1, Ordering::SeqCst);
            Ok(())
        },
        || fails(Fault::Check),
        |_| Fault::None,
    );
    assert!(taken.iter().copied().eq(0..taken.len() as u32), "{taken:?}");
    match fault {
        Fault::None => assert_eq!((done, taken.len()), (Ok(()), JOBS as usize)),
        Fault::Give(at) | Fault::Work(at) | Fault::Take(at) => {
            assert_eq!(done, Err(fault));
            assert!(taken.len() <= at as usize);
        }
        Fault::Check => assert_eq!((done, taken.len()), (Err(fault), 0)),
    }
}

#[test]
fn jobs_come_back_in_order_whatever_fails() {
    let faults = [Fault::None, Fault::Give(3), Fault::Work(0), Fault::Work(2), Fault::Take(1), Fault::Check];
    for (threads, ahead) in [(1, 1), (2, 1), (2, 3), (3, 2)] {
        for fault in faults {
            schedules(move || hand_over(threads, ahead, fault));
        }
    }
}

/// Every schedule of a small hand-over, up to a limit.
#[test]
fn a_small_hand_over_ends_in_schedules_one_after_the_other() {
    for fault in [Fault::None, Fault::Work(0), Fault::Take(0)] {
        shuttle::check_dfs(move || hand_over(1, 1, fault), Some(200_000));
    }
}
