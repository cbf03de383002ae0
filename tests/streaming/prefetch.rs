//! The prefetcher: no page is missing when it is needed, no frame waits, and no answer changes.

use crate::clock;
use crate::tower;

use clock::ClockSource;

use slicewalk::bytes::MemorySource;
use slicewalk::bytes::testing::{Fault, FaultySource, GatedSource, SlowSource};
use slicewalk::query::{Answer, Overlap, Ray, cast, ceiling_above, floor_under, overlaps};
use slicewalk::store::{Counters, Prefetch, Step, Stream, StreamOptions};
use slicewalk::walk::{Config, MoveInput, Walker};
use std::sync::{Arc, LazyLock, mpsc};
use std::time::{Duration, Instant};
use tower::{Body, FRAME_S, READ_S, Random, open, resident};

const BUDGET: usize = 16 << 20;

static TOWER: LazyLock<Vec<u8>> = LazyLock::new(|| tower::tower(4.0, 156.0, 1));

fn options(budget: usize, prefetch: Prefetch) -> StreamOptions {
    StreamOptions { prefetch, ..StreamOptions::new(budget) }
}

/// Falls 150 m from rest at `speed` in virtual time: during each frame the loader reads for the frame's duration.
/// Returns the number of frames, those with a missing page, and the counters.
fn fall(prefetch: Prefetch, speed: f64, budget: usize) -> (u32, u32, Counters) {
    let source = Arc::new(SlowSource::new(MemorySource::new(&TOWER[..]), Duration::ZERO));
    let stream = Stream::open(open(source.clone()), options(budget, prefetch)).unwrap();
    let mut pawn = stream.pawn();
    let mut body = Body::at(0.0, 0.0, 152.0);
    body.velocity.z = -speed;
    // A program's first frame waits for the pages around the body, and for no others.
    stream.load_around(&body.motion()).unwrap();
    let (mut frames, mut missing, mut read_s) = (0, 0, 0.0f64);
    while body.feet.z > 2.0 {
        pawn.hint(&body.motion());
        if let Overlap::NotLoaded(pages) = overlaps(&stream.snapshot(), &body.shape()) {
            missing += 1;
            // Like a program without a prefetcher: stop until the pages are loaded.
            stream.load_missing(&pages).unwrap();
        }
        frames += 1;
        let end = f64::from(frames) * FRAME_S;
        while read_s < end {
            let before = source.counts().0;
            match stream.step() {
                Step::Loaded(_) => read_s += READ_S * (source.counts().0 - before) as f64 + 1e-4,
                _ => read_s = end,
            }
        }
        body.fall();
    }
    (frames, missing, stream.counters())
}

#[test]
fn a_fall_through_150_m_never_misses_a_page_with_prefetch_and_does_without() {
    for speed in [0.0, 50.0] {
        let (frames, missing, counters) = fall(Prefetch::Manual, speed, BUDGET);
        println!("on, from {speed} m/s: {frames} frames, {missing} with a missing page, {counters:?}");
        assert_eq!((missing, counters.late, counters.failed), (0, 0, 0));
        assert!(counters.peak_bytes <= BUDGET && counters.peak_bytes > BUDGET / 4, "{}", counters.peak_bytes);
        let (frames, missing, counters) = fall(Prefetch::Off, speed, BUDGET);
        println!("off, from {speed} m/s: {frames} frames, {missing} with a missing page, {counters:?}");
        assert!(missing > 20, "{missing} of {frames}");
        assert!(counters.peak_bytes <= BUDGET);
    }
}

#[test]
fn a_fall_with_a_quarter_of_the_memory_still_misses_nothing_and_keeps_the_budget() {
    let (_, missing, counters) = fall(Prefetch::Manual, 50.0, BUDGET / 4);
    assert_eq!(missing, 0, "{counters:?}");
    assert!(counters.peak_bytes <= BUDGET / 4 && counters.evicted > 0, "{counters:?}");
}

/// Falls through the tower as a walker, with the stream's own thread, on a clock that the test moves: a read takes
/// 2 ms, a frame 1/60 s. Returns frames, frames with a missing page, and the counters.
fn fall_of_a_walker(prefetch: Prefetch, budget: usize) -> (u32, u32, Counters) {
    let source = Arc::new(ClockSource::new(MemorySource::new(&TOWER[..]), READ_S));
    let stream = Stream::open(open(source.clone()), options(budget, prefetch)).unwrap();
    let _end = source.end();
    let mut pawn = stream.pawn();
    let mut walker = Walker::new(Config::default(), [0.0, 0.0, 152.0].into()).unwrap();
    stream.load_around(&walker.motion_hint(stream.archive().frame())).unwrap();
    let (mut frames, mut missing) = (0, 0);
    while walker.feet().z > 2.0 {
        pawn.hint(&walker.motion_hint(stream.archive().frame()));
        let mut report = walker.step(&stream.snapshot(), FRAME_S, MoveInput::Stay);
        missing += u32::from(report.waits());
        while let Some(needed) = report.missing {
            assert_eq!(stream.load_missing(&needed).unwrap().left_out, 0);
            report = walker.step(&stream.snapshot(), report.unspent, MoveInput::Stay);
        }
        frames += 1;
        source.run(&stream, f64::from(frames) * FRAME_S);
    }
    assert!(walker.falling() > 49.0, "{}", walker.falling());
    (frames, missing, stream.counters())
}

#[test]
fn a_walker_falls_150_m_past_dense_storeys_and_misses_nothing_with_the_thread_and_much_without() {
    for budget in [BUDGET, BUDGET / 4] {
        let (frames, missing, counters) = fall_of_a_walker(Prefetch::Thread, budget);
        println!("on, {budget} bytes: {frames} frames, {missing} with a missing page, {counters:?}");
        assert_eq!((missing, counters.late, counters.failed), (0, 0, 0));
        assert!(counters.peak_bytes <= budget && counters.reads > 20, "{counters:?}");
    }
    let (frames, missing, counters) = fall_of_a_walker(Prefetch::Off, BUDGET);
    println!("off: {frames} frames, {missing} with a missing page, {counters:?}");
    assert!(missing > 20, "{missing} of {frames}");
    assert!(counters.peak_bytes <= BUDGET);
}

#[test]
fn pages_are_loaded_in_the_order_in_which_a_fall_needs_them() {
    let mut options = options(BUDGET, Prefetch::Manual);
    options.loader.run_bytes = 0;
    let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options).unwrap();
    let mut pawn = stream.pawn();
    let mut body = Body::at(0.0, 0.0, 152.0);
    body.velocity.z = -50.0;
    pawn.hint(&body.motion());
    let mut last = 153.0;
    // As pages arrive, the body can fall ever further without missing one.
    while let Step::Loaded(_) = stream.step() {
        let view = stream.snapshot();
        let mut probe = body;
        while probe.feet.z > 100.0 && !matches!(overlaps(&view, &probe.shape()), Overlap::NotLoaded(_)) {
            probe.feet.z -= 0.5;
        }
        assert!(probe.feet.z <= last, "what was loaded is still there");
        last = probe.feet.z;
    }
    assert!(last < 152.0 - 45.0, "as far as the horizon of one second: {last}");
}

/// Random walks with jumps; every answer of the stream is that of the resident store or "not loaded".
fn walk_and_compare(prefetch: Prefetch, budget: usize, seed: u64) -> (u32, u32) {
    let all = resident(&TOWER);
    let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options(budget, prefetch)).unwrap();
    let mut pawn = stream.pawn();
    let mut random = Random(seed);
    let mut body = Body::at(0.0, 0.0, 30.0);
    let (mut known, mut unknown) = (0, 0);
    for frame in 0..400 {
        if frame % 50 == 0 {
            let mut at = |limit: f64| random.between(-limit, limit);
            body.feet = [at(4.0), at(4.0), 75.0 + at(75.0)].into();
            body.velocity = [at(3.0), at(3.0), at(20.0)].into();
        }
        body.feet += body.velocity * FRAME_S;
        pawn.hint(&body.motion());
        for _ in 0..random.below(3) {
            stream.step();
        }
        let view = stream.snapshot();
        let box_ = body.shape();
        let mut same = |told: bool, equal: bool| {
            assert!(!told || equal, "frame {frame} of seed {seed}");
            *(if told { &mut known } else { &mut unknown }) += 1;
        };
        let answer = overlaps(&view, &box_);
        same(!matches!(answer, Overlap::NotLoaded(_)), answer == overlaps(&all, &box_));
        let answer = floor_under(&view, &box_, body.feet.z - 1.0, body.feet.z + 0.4);
        same(answer.known().is_some(), answer == floor_under(&all, &box_, body.feet.z - 1.0, body.feet.z + 0.4));
        let answer = ceiling_above(&view, &box_, body.feet.z, body.feet.z + 3.0);
        same(answer.known().is_some(), answer == ceiling_above(&all, &box_, body.feet.z, body.feet.z + 3.0));
        let ray = Ray::new(body.feet, [random.between(-1.0, 1.0), 0.3, -0.2].into(), 5.0).unwrap();
        let answer = cast(&view, &ray);
        same(matches!(answer, Answer::Known(_)), answer == cast(&all, &ray));
        drop(view);
        // Sometimes the program loads what is missing.
        if random.below(4) == 0
            && let Overlap::NotLoaded(missing) = overlaps(&stream.snapshot(), &box_)
        {
            let report = stream.load_missing(&missing).unwrap();
            let again = overlaps(&stream.snapshot(), &box_);
            let fits = report.left_out == 0 && missing.count() <= missing.keys().len();
            assert!(!fits || again == overlaps(&all, &box_) || matches!(again, Overlap::NotLoaded(_)));
        }
        let counters = stream.counters();
        assert!(counters.peak_bytes <= budget, "{counters:?}");
    }
    (known, unknown)
}

#[test]
#[ignore = "slow: .ci/run"]
fn answers_are_those_of_a_resident_store_with_prefetch_on_and_off_and_with_tiny_budgets() {
    for (seed, budget) in (0..).zip([600_000, 1 << 20, BUDGET]) {
        for prefetch in [Prefetch::Manual, Prefetch::Thread, Prefetch::Off] {
            let (known, unknown) = walk_and_compare(prefetch, budget, seed);
            println!("{prefetch:?}, {budget} bytes: {known} answers known, {unknown} not");
            assert!(known > 0);
        }
    }
}

#[test]
fn queries_and_hints_go_on_while_the_source_hangs() {
    let source = Arc::new(GatedSource::new(MemorySource::new(&TOWER[..])));
    let stream = Stream::open(open(source.clone()), options(BUDGET, Prefetch::Thread)).unwrap();
    let mut pawn = stream.pawn();
    let body = Body::at(0.0, 0.0, 100.0);
    stream.load_around(&body.motion()).unwrap();
    source.set_open(false);
    pawn.hint(&Body::at(0.0, 0.0, 20.0).motion());
    while !source.is_waiting() {
        std::thread::yield_now();
    }
    let (done, finished) = mpsc::channel();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for step in 0..10_000 {
                let body = Body::at(0.0, 0.0, 100.0 - f64::from(step % 7));
                pawn.hint(&body.motion());
                overlaps(&stream.snapshot(), &body.shape());
            }
            assert!(!matches!(overlaps(&stream.snapshot(), &body.shape()), Overlap::NotLoaded(_)));
            done.send(()).unwrap();
        });
        let outcome = finished.recv_timeout(Duration::from_secs(20));
        source.set_open(true);
        outcome.expect("a query or a hint waited for the source");
    });
}

#[test]
fn settling_waits_for_all_that_is_wanted_and_no_longer() {
    let long = Duration::from_secs(60);
    for prefetch in [Prefetch::Thread, Prefetch::Manual] {
        let source = Arc::new(GatedSource::new(MemorySource::new(&TOWER[..])));
        let stream = Stream::open(open(source.clone()), options(BUDGET, prefetch)).unwrap();
        let mut pawn = stream.pawn();
        assert!(stream.settle(long), "nothing is wanted");
        for z in [100.0, 20.0] {
            let body = Body::at(0.0, 0.0, z);
            // A hint may coincide with the moment in which the previous one is taken.
            loop {
                let dropped = stream.counters().hints_dropped;
                pawn.hint(&body.motion());
                if stream.counters().hints_dropped == dropped {
                    break;
                }
            }
            assert!(stream.settle(long));
            let counters = stream.counters();
            assert_eq!(counters.loaded, counters.requested, "{prefetch:?}: all of it is there");
            assert_eq!(stream.load_around(&body.motion()).unwrap().loaded, 0);
        }
        if prefetch == Prefetch::Thread {
            source.set_open(false);
            pawn.hint(&Body::at(0.0, 0.0, 60.0).motion());
            assert!(!stream.settle(Duration::from_millis(5)), "the source hangs");
            source.set_open(true);
        }
        assert!(stream.settle(long));
        // A page that does not fit never will.
        let table = stream.counters().table_bytes;
        let tiny = open(MemorySource::new(&TOWER[..]));
        let tiny = Stream::open(tiny, options(table * 195 / 100, prefetch)).unwrap();
        let mut pawn = tiny.pawn();
        pawn.hint(&Body::at(0.9, 0.0, 31.0).motion());
        assert!(tiny.settle(long) && tiny.counters().no_room > 0);
    }
    let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options(BUDGET, Prefetch::Off)).unwrap();
    assert!(stream.settle(Duration::ZERO));
}

#[test]
fn dropping_a_busy_stream_joins_its_thread_and_frees_everything() {
    for pause_ms in [0, 1, 5, 20] {
        let source = Arc::new(SlowSource::new(MemorySource::new(&TOWER[..]), Duration::from_millis(3)));
        let stream = Stream::open(open(source.clone()), options(BUDGET, Prefetch::Thread)).unwrap();
        let mut pawn = stream.pawn();
        pawn.hint(&Body::at(0.0, 0.0, 100.0).motion());
        std::thread::sleep(Duration::from_millis(pause_ms));
        let start = Instant::now();
        drop(stream);
        assert!(start.elapsed() < Duration::from_secs(5));
        let reads = source.counts();
        std::thread::sleep(Duration::from_millis(10));
        assert_eq!(source.counts(), reads, "nobody reads on");
        drop(pawn);
        assert_eq!(Arc::strong_count(&source), 1, "nothing is left");
    }
}

#[test]
fn a_view_outlives_its_stream() {
    let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options(BUDGET, Prefetch::Thread)).unwrap();
    let body = Body::at(0.9, 0.0, 0.0);
    stream.load_around(&body.motion()).unwrap();
    let view = stream.snapshot();
    drop(stream);
    assert_eq!(overlaps(&view, &body.shape()), Overlap::Hit);
}

#[test]
fn errors_are_reported_and_their_pages_stay_not_loaded_until_they_can_be_read() {
    let source = Arc::new(FaultySource::new(MemorySource::new(&TOWER[..])));
    let stream = Stream::open(open(source.clone()), options(BUDGET, Prefetch::Manual)).unwrap();
    let mut pawn = stream.pawn();
    let body = Body::at(0.9, 0.0, 31.0);
    let mut turn = || {
        pawn.hint(&body.motion());
        while let Step::Loaded(_) = stream.step() {}
        stream.take_errors()
    };
    source.set(Fault::Fail, 0..u64::MAX);
    let errors = turn();
    assert!(!errors.is_empty() && errors.iter().all(|error| error.error.to_string().contains("read")), "{errors:?}");
    assert!(matches!(overlaps(&stream.snapshot(), &body.shape()), Overlap::NotLoaded(_)));
    assert!(stream.load_around(&body.motion()).unwrap_err().to_string().contains("read"));
    // The loader's own tests, with their own clock, check when exactly they are retried.
    source.set(Fault::None, 0..0);
    turn();
    let start = Instant::now();
    while matches!(overlaps(&stream.snapshot(), &body.shape()), Overlap::NotLoaded(_)) {
        assert!(start.elapsed() < Duration::from_secs(60), "{:?}", stream.counters());
        std::thread::sleep(Duration::from_millis(20));
        assert!(turn().is_empty());
    }
}

#[test]
fn one_damaged_page_of_a_run_is_an_error_and_the_others_are_loaded() {
    let source = Arc::new(FaultySource::new(MemorySource::new(&TOWER[..])));
    let archive = open(source.clone());
    let body = Body::at(0.9, 0.0, 31.0);
    let frame = *archive.frame();
    let key = slicewalk::frame::PageKey {
        tx: frame.pixel_of(0.9).div_euclid(64) as i32,
        ty: 0,
        layer: frame.slice_of(31.0).div_euclid(64) as i32,
    };
    let extent = archive.find(key).unwrap().unwrap().extent().unwrap();
    for (fault, text) in [(Fault::Flip, "rule P2"), (Fault::Fail, "read")] {
        source.set(fault, extent.offset + 30..extent.offset + 31);
        let stream = Stream::open(open(source.clone()), options(BUDGET, Prefetch::Manual)).unwrap();
        let mut pawn = stream.pawn();
        pawn.hint(&body.motion());
        while let Step::Loaded(_) = stream.step() {}
        let errors = stream.take_errors();
        // On a busy machine, the page may be retried in the meantime.
        assert!(!errors.is_empty() && errors.iter().all(|error| error.key == key), "{errors:?}");
        assert!(errors[0].error.to_string().contains(text), "{}", errors[0].error);
        let view = stream.snapshot();
        assert_eq!(view.is_loaded(key), Some(false));
        assert_eq!(view.is_loaded(slicewalk::frame::PageKey { layer: key.layer - 1, ..key }), Some(true));
        assert!(stream.counters().resident_pages > 20);
    }
}

#[test]
fn neighbouring_pages_come_with_one_read() {
    let reads = |run_bytes: usize| {
        let mut options = options(BUDGET, Prefetch::Manual);
        options.loader.run_bytes = run_bytes;
        let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options);
        let stream = stream.unwrap();
        let mut pawn = stream.pawn();
        pawn.hint(&Body::at(0.0, 0.0, 100.0).motion());
        while let Step::Loaded(_) = stream.step() {}
        let counters = stream.counters();
        assert_eq!(counters.loaded, counters.requested);
        (counters.reads, counters.loaded)
    };
    let ((single, pages), (runs, same)) = (reads(0), reads(256 << 10));
    println!("{pages} pages: {single} reads page by page, {runs} in runs");
    assert_eq!(pages, same);
    assert!(single == pages && runs * 3 < single, "{runs} of {single}");
}

#[test]
fn hints_that_make_no_sense_are_counted_and_stale_ones_dropped() {
    let stream = Stream::open(open(MemorySource::new(&TOWER[..])), options(BUDGET, Prefetch::Manual)).unwrap();
    let mut pawn = stream.pawn();
    let mut body = Body::at(f64::NAN, 0.0, 0.0);
    pawn.hint(&slicewalk::store::MotionHint { min: body.feet, ..Body::at(0.0, 0.0, 0.0).motion() });
    assert_eq!((stream.counters().hints_dropped, stream.step()), (1, Step::Idle));
    body = Body::at(0.0, 0.0, 100.0);
    pawn.hint(&body.motion());
    assert!(matches!(stream.step(), Step::Loaded(_)));
    // The body moves away before all pages are loaded: the rest is no longer loaded.
    let before = stream.counters().loaded;
    pawn.hint(&Body::at(1000.0, 0.0, 100.0).motion());
    assert_eq!(stream.step(), Step::Idle);
    drop(pawn);
    assert_eq!((stream.step(), stream.counters().loaded), (Step::Idle, before));
}
