//! The cache of a stream: its budget, pages held by views, shared pages, no allocation, many threads.

mod common;
#[path = "common/counting.rs"]
mod counting;
#[path = "stream/tower.rs"]
mod tower;

use common::random;
use counting::allocations;
use slicewalk::archive::Archive;
use slicewalk::bytes::MemorySource;
use slicewalk::query::{Overlap, Ray, cast, ceiling_above, floor_under, overlaps};
use slicewalk::store::{Prefetch, Step, Stream, StreamOptions};
use std::hint::black_box;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tower::{Body, Random, open, resident};

/// More than enough for one place.
const BUDGET: usize = 8 << 20;

static TOWER: LazyLock<Vec<u8>> = LazyLock::new(|| tower::tower(4.0, 90.0, 7));

fn stream(budget: usize, prefetch: Prefetch) -> Stream {
    let options = StreamOptions { prefetch, ..StreamOptions::new(budget) };
    Stream::open(open(MemorySource::new(&TOWER[..])), options).unwrap()
}

fn finish(stream: &Stream) {
    while let Step::Loaded(_) = stream.step() {}
}

#[test]
fn a_frame_of_queries_allocates_and_frees_nothing_while_pages_come_and_go() {
    let stream = stream(2 << 20, Prefetch::Thread);
    let mut pawn = stream.pawn();
    let (mut random, mut missing) = (Random(1), 0);
    let (start, mut frame) = (Instant::now(), 0);
    while frame < 2000 || stream.counters().evicted < 100 && start.elapsed() < Duration::from_secs(60) {
        frame += 1;
        // Jumps constantly, so that the thread is always loading and evicting.
        let body = Body::at(random.between(-3.0, 3.0), random.between(-3.0, 3.0), random.between(0.0, 90.0));
        let (shape, motion) = (body.shape(), body.motion());
        let ray = Ray::new(body.feet, [1.0, 0.2, -0.3].into(), 4.0).unwrap();
        let allocated = allocations(|| {
            pawn.hint(&motion);
            let view = stream.snapshot();
            for _ in 0..5 {
                if let Overlap::NotLoaded(pages) = black_box(overlaps(&view, &shape)) {
                    missing += 1;
                    pawn.need(&pages);
                }
                black_box(floor_under(&view, &shape, body.feet.z, 3.0));
                black_box(ceiling_above(&view, &shape, body.feet.z, 3.0));
                black_box(cast(&view, &ray));
            }
        });
        assert_eq!(allocated, 0, "frame {frame}");
    }
    let counters = stream.counters();
    assert!(missing > 0 && counters.evicted > 0, "{counters:?}");
    assert!(counters.peak_bytes <= 2 << 20);
}

#[test]
fn pages_that_a_view_sees_stay_and_count_until_it_is_dropped() {
    let (here, there) = (Body::at(0.9, 0.9, 10.0), Body::at(0.9, 0.9, 70.0));
    let needed = |body: &Body| stream(BUDGET, Prefetch::Off).load_around(&body.motion()).unwrap().needed_bytes;
    // Enough for either place, but not for both.
    let budget = needed(&here).max(needed(&there));
    let stream = stream(budget, Prefetch::Manual);
    let mut pawn = stream.pawn();
    stream.load_around(&here.motion()).unwrap();
    let view = stream.snapshot();
    let seen = overlaps(&view, &here.shape());
    assert!(!matches!(seen, Overlap::NotLoaded(_)));
    pawn.hint(&there.motion());
    while let Step::Loaded(_) = stream.step() {
        assert!(stream.counters().used_bytes <= budget);
    }
    assert_eq!(stream.step(), Step::NoRoom(true), "the old view holds what was evicted");
    assert!(!stream.settle(Duration::from_millis(2)));
    assert_eq!(overlaps(&view, &here.shape()), seen, "and still answers");
    let loaded = stream.counters().loaded;
    drop(view);
    finish(&stream);
    assert!(stream.counters().loaded > loaded, "what found no room comes once the view is gone");
    assert!(!matches!(overlaps(&stream.snapshot(), &there.shape()), Overlap::NotLoaded(_)));
    let counters = stream.counters();
    assert!(counters.peak_bytes <= budget && counters.evicted > 0, "{counters:?}");
    assert_eq!(counters.used_bytes, counters.table_bytes + counters.resident_bytes, "nothing is lost");
}

#[test]
fn the_farthest_go_first_and_those_in_use_never() {
    let stream = stream(3 << 20, Prefetch::Manual);
    let (mut pawn, mut other) = (stream.pawn(), stream.pawn());
    let (mut body, still) = (Body::at(0.9, 0.9, 10.0), Body::at(-1.9, -1.9, 60.0));
    other.hint(&still.motion());
    let inside = |body: &Body| !matches!(overlaps(&stream.snapshot(), &body.shape()), Overlap::NotLoaded(_));
    for step in 0..100 {
        body.feet.z = 10.0 + 0.7 * f64::from(step);
        pawn.hint(&body.motion());
        finish(&stream);
        assert!(inside(&body) && inside(&still), "step {step}");
    }
    let view = stream.snapshot();
    let loaded = |layer: i32| {
        let slots = |tx, ty| view.column(tx, ty).iter().filter(move |slot| slot.layer() == layer);
        (-4..4)
            .flat_map(|tx| (-4..4).map(move |ty| (tx, ty)))
            .flat_map(|(tx, ty)| slots(tx, ty))
            .filter(|slot| slot.page().is_some())
            .count()
    };
    let lowest: usize = (0..4).map(loaded).sum();
    let near: usize = (17..21).map(loaded).sum();
    assert!(near > 4 * lowest, "{near} near, {lowest} at the start");
    assert!(stream.counters().evicted > 100);
}

#[test]
fn shared_and_uniform_pages_are_held_once() {
    use slicewalk::page::Span;
    let floor = |bottom| {
        common::page((0..900).map(|at| ((at % 30, at / 30), vec![Span::new(bottom, bottom + at % 7, false).unwrap()])))
    };
    let slab = || common::page((0..4096).map(|at| ((at % 64, at / 64), vec![Span::new(5, 9, true).unwrap()])));
    let mut pages = common::Pages::new();
    for at in 0..20 {
        pages.insert(common::key(at, 0, 0), floor(100));
        pages.insert(common::key(at, 0, 1), slab());
    }
    let keys: Vec<_> = pages.keys().copied().collect();
    let weight = floor(100).weight_bytes() + slab().weight_bytes();
    let bytes = common::archive(&(pages, Default::default()));
    let opened = |budget| {
        let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(budget) };
        Stream::open(Archive::from_bytes(bytes.clone()).unwrap(), options).unwrap()
    };
    // Only one of each fits.
    let needed = opened(1 << 20).load(&keys, keys[0]).unwrap().needed_bytes;
    let stream = opened(needed);
    let report = stream.load(&keys, keys[0]).unwrap();
    assert_eq!((report.loaded, report.already, report.left_out, report.evicted), (40, 0, 0, 0));
    let counters = stream.counters();
    assert_eq!((counters.resident_pages, counters.resident_bytes, counters.reads), (2, weight, 1));
    assert!(counters.peak_bytes <= needed);
    let view = stream.snapshot();
    assert!(keys.iter().all(|key| view.is_loaded(*key) == Some(true)));
    assert_eq!(view.is_loaded(common::key(99, 0, 0)), None);
    let again = stream.load(&keys, keys[0]).unwrap();
    assert_eq!((again.loaded, again.already), (0, 40));
}

#[test]
fn a_budget_too_small_for_a_page_loads_none_and_says_how_much_is_needed() {
    let table = stream(1 << 20, Prefetch::Off).counters().table_bytes;
    let motion = Body::at(0.9, 0.9, 10.0).motion();
    for prefetch in [Prefetch::Off, Prefetch::Manual] {
        // The leaf was decoded in the space left for pages, but these are larger.
        let stream = stream(table * 195 / 100, prefetch);
        let report = stream.load_around(&motion).unwrap();
        assert!(report.loaded == 0 && report.left_out > 0);
        let mut pawn = stream.pawn();
        pawn.hint(&motion);
        assert!(matches!((prefetch, stream.step()), (Prefetch::Off, Step::Idle) | (_, Step::NoRoom(false))));
        assert_eq!(stream.counters().resident_bytes, 0);
        let enough = self::stream(report.needed_bytes, prefetch);
        let again = enough.load_around(&motion).unwrap();
        assert_eq!((again.left_out, again.evicted, again.needed_bytes), (0, 0, report.needed_bytes));
        assert!(!matches!(overlaps(&enough.snapshot(), &Body::at(0.9, 0.9, 10.0).shape()), Overlap::NotLoaded(_)));
    }
}

#[test]
fn a_budget_below_the_table_of_pages_is_refused_before_a_leaf_is_read() {
    use slicewalk::bytes::testing::SlowSource;
    let source = std::sync::Arc::new(SlowSource::new(MemorySource::new(&TOWER[..]), Duration::ZERO));
    let archive = open(source.clone());
    let (reads, pages) = (source.counts().0, archive.header().pages.total());
    let error = Stream::open(archive, StreamOptions::new(10_000)).unwrap_err().to_string();
    assert_eq!(source.counts().0, reads);
    assert!(error.contains(&format!("10000 bytes are too few: the table of {pages} pages")), "{error}");
}

#[test]
fn directories_tell_the_exact_weight_of_every_page() {
    for bytes in [TOWER.clone(), common::archive(&common::scene())] {
        let archive = Archive::from_bytes(bytes).unwrap();
        for entry in archive.entries().map(Result::unwrap) {
            assert_eq!(entry.weight_bytes(), archive.page(&entry).unwrap().weight_bytes(), "{entry:?}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_file_that_is_cut_or_replaced_is_an_error_or_the_old_archive() {
    use slicewalk::bytes::FileSource;
    let folder = tempfile::tempdir().unwrap();
    let (path, other) = (folder.path().join("a.slices"), folder.path().join("b.slices"));
    let new = tower::tower(4.0, 90.0, 8);
    let body = Body::at(0.9, 0.9, 60.0);
    let old_answer = overlaps(&resident(&TOWER), &body.shape());
    let manual = || StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(8 << 20) };
    let opened = || {
        std::fs::write(&path, &TOWER[..]).unwrap();
        let stream = Stream::open(open(FileSource::open(&path).unwrap()), manual()).unwrap();
        let pawn = stream.pawn();
        (stream, pawn)
    };
    // Replaced by a rename, as archives are published: the old file stays until it is closed.
    let (stream, mut pawn) = opened();
    std::fs::write(&other, &new).unwrap();
    std::fs::rename(&other, &path).unwrap();
    pawn.hint(&body.motion());
    finish(&stream);
    assert!(stream.take_errors().is_empty());
    assert_eq!(overlaps(&stream.snapshot(), &body.shape()), old_answer);
    // Cut, or overwritten in place: errors, and never a page of the other archive.
    for damage in [&TOWER[..TOWER.len() / 2], &new[..], &[]] {
        let (stream, mut pawn) = opened();
        let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(0).unwrap();
        std::io::Write::write_all(&mut &file, damage).unwrap();
        pawn.hint(&body.motion());
        finish(&stream);
        let errors = stream.take_errors();
        assert!(!errors.is_empty());
        let answer = overlaps(&stream.snapshot(), &body.shape());
        assert!(answer == old_answer || matches!(answer, Overlap::NotLoaded(_)), "{answer:?}");
    }
}

/// Four threads with bodies that walk, fall and jump in a small cache, compared with the resident store. Takes a few
/// seconds; ten minutes with `SLICEWALK_SOAK_SECONDS=600`.
#[test]
fn soak_no_thread_ever_gets_a_wrong_answer() {
    let seconds = std::env::var("SLICEWALK_SOAK_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(4);
    let all = resident(&TOWER);
    let budget = 3 << 20;
    let stream = stream(budget, Prefetch::Thread);
    let (stop, known, unknown) = (AtomicBool::new(false), AtomicU64::new(0), AtomicU64::new(0));
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (stream, all, stop, known, unknown) = (&stream, &all, &stop, &known, &unknown);
            scope.spawn(move || {
                let mut random = Random(thread);
                let mut pawn = stream.pawn();
                let mut body = Body::at(0.0, 0.0, 50.0);
                while !stop.load(Ordering::Relaxed) {
                    match random.below(200) {
                        0 => {
                            body = Body::at(
                                random.between(-4.0, 4.0),
                                random.between(-4.0, 4.0),
                                random.between(0.0, 90.0),
                            )
                        }
                        1 => body.velocity = [random.between(-2.0, 2.0), random.between(-2.0, 2.0), -10.0].into(),
                        2 => pawn = stream.pawn(),
                        3 => {
                            let _ = stream.load_around(&body.motion()).unwrap();
                        }
                        4 => std::thread::sleep(Duration::from_millis(random.below(5))),
                        _ => {}
                    }
                    body.feet += body.velocity / 60.0;
                    pawn.hint(&body.motion());
                    let view = stream.snapshot();
                    let shape = body.shape();
                    let answer = overlaps(&view, &shape);
                    let floor = floor_under(&view, &shape, body.feet.z, 2.0);
                    if let Overlap::NotLoaded(missing) = &answer {
                        pawn.need(missing);
                        unknown.fetch_add(1, Ordering::Relaxed);
                    } else {
                        assert_eq!(answer, overlaps(all, &shape));
                        known.fetch_add(1, Ordering::Relaxed);
                    }
                    if let Some(floor) = floor.known() {
                        assert_eq!(Some(floor), floor_under(all, &shape, body.feet.z, 2.0).known());
                    }
                }
            });
        }
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(seconds) {
            std::thread::sleep(Duration::from_millis(5));
            assert!(stream.counters().used_bytes <= budget);
        }
        stop.store(true, Ordering::Relaxed);
    });
    let counters = stream.counters();
    println!("{known:?} answers, {unknown:?} not loaded, {counters:?}");
    assert!(counters.peak_bytes <= budget && counters.evicted > 0 && counters.failed == 0);
    assert!(known.into_inner() > 100);
}
