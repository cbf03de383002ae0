//! The loader as a state machine: it opens an archive, streams it over any link, and repeats exactly.

use crate::link;
use crate::tower;

use link::{Link, Manners};
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;
use slicewalk::query::{Overlap, floor_under, overlaps};
use slicewalk::store::{BodyId, Loader, LoaderOptions, Next};
use slicewalk::walk::{Config, MoveInput, Walker};
use std::sync::LazyLock;
use std::time::Duration;
use tower::{Body, FRAME_S, Random, resident};

const BUDGET: usize = 4 << 20;

static TOWER: LazyLock<Vec<u8>> = LazyLock::new(|| tower::tower(4.0, 60.0, 1));

fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

fn opened(bytes: &[u8], options: LoaderOptions) -> (Loader, BodyId) {
    let archive = Archive::from_bytes(bytes.to_vec()).unwrap();
    let mut loader = Loader::new(archive.catalog().clone(), options).unwrap();
    let body = loader.body();
    (loader, body)
}

#[test]
fn it_opens_by_itself_in_three_rounds_and_stands_after_a_few_more() {
    let body = Body::at(0.9, 0.0, 31.0);
    for known in [true, false] {
        let manners = Manners { latency: Duration::from_millis(40), rate: 2.5e6, ..Manners::GOOD };
        let mut link = Link::new(&TOWER, manners, 1);
        let mut loader = Loader::open(known.then_some(TOWER.len() as u64), LoaderOptions::new(BUDGET));
        let pawn = loader.body();
        loader.hint(pawn, &body.motion());
        let (mut standing, mut requests) = (false, 0);
        while !standing {
            link.run(&mut loader, link.now + seconds(0.01)).unwrap();
            standing =
                loader.snapshot().is_some_and(|view| !matches!(overlaps(&view, &body.shape()), Overlap::NotLoaded(_)));
            requests = link.requests();
            assert!(link.now < seconds(5.0), "{:#?}", link.transcript);
        }
        println!("length known: {known}; stands after {:?} and {requests} requests", link.now);
        // Head and footer, leaves, pages.
        assert!(requests <= 3 + 2 * LoaderOptions::new(BUDGET).fetches, "{:#?}", link.transcript);
        assert_eq!(loader.catalog().unwrap().header().file_len, TOWER.len() as u64);
    }
}

#[test]
fn a_small_archive_of_unknown_length_opens_with_its_first_answer() {
    let small = tower::tower(0.3, 0.5, 1);
    assert!(small.len() < 16 << 10, "{}", small.len());
    let mut link = Link::new(&small, Manners::GOOD, 1);
    let mut loader = Loader::open(None, LoaderOptions::new(BUDGET));
    link.run(&mut loader, seconds(1.0)).unwrap();
    assert!(loader.snapshot().is_some());
    assert_eq!(link.requests(), 2, "the start, then the leaf: {:#?}", link.transcript);
}

/// An hour of walking over a link that loses one answer in twenty: no wrong page, the budget is kept, and a second run
/// gives the same transcript.
#[test]
#[ignore = "slow: .ci/run"]
fn an_hour_over_a_bad_link_is_right_within_the_budget_and_the_same_twice() {
    let all = resident(&TOWER);
    let manners = Manners { latency: Duration::from_millis(40), rate: 2.5e6, lost: 5, shuffled: false };
    let walk = || {
        let mut link = Link::new(&TOWER, Manners::GOOD, 7);
        let (mut loader, pawn) = opened(&TOWER, LoaderOptions { fetches: 3, ..LoaderOptions::new(BUDGET) });
        link.run(&mut loader, seconds(0.1)).unwrap();
        link.manners = manners;
        let mut random = Random(3);
        let (mut body, mut known) = (Body::at(0.0, 0.0, 30.0), 0);
        for step in 1..=360 {
            if step % 6 == 0 {
                let mut at = |limit: f64| random.between(-limit, limit);
                body = Body::at(at(3.5), at(3.5), 30.0 + at(29.0));
            }
            body.velocity = [random.between(-0.1, 0.1), random.between(-0.1, 0.1), 0.0].into();
            body.feet += body.velocity * 10.0;
            loader.hint(pawn, &body.motion());
            link.run(&mut loader, seconds(10.0 * f64::from(step))).unwrap();
            let view = loader.snapshot().unwrap();
            let answer = overlaps(&view, &body.shape());
            if !matches!(answer, Overlap::NotLoaded(_)) {
                known += 1;
                assert_eq!(answer, overlaps(&all, &body.shape()));
                let floor = floor_under(&view, &body.shape(), body.feet.z, 0.3);
                assert!(
                    floor
                        .known()
                        .is_none_or(|floor| Some(floor) == floor_under(&all, &body.shape(), body.feet.z, 0.3).known())
                );
            }
        }
        assert!(known > 350, "{known} of 360 places");
        (link.transcript, loader.counters())
    };
    let (transcript, counters) = walk();
    println!("{} lines, {counters:?}", transcript.len());
    assert!(counters.peak_bytes <= BUDGET && counters.evicted > 100, "{counters:?}");
    assert!(transcript.iter().any(|line| line.contains("lost")));
    assert_eq!((transcript, counters), walk());
}

/// A game loop that gives the hint, polls, asks, and says last what it missed.
#[test]
fn needed_pages_come_although_each_frame_begins_with_a_hint() {
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions::new(BUDGET));
    let (stands, looks) = (Body::at(0.9, 0.0, 31.0), Body::at(2.5, 2.5, 1.0).shape());
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    let mut frames = 0;
    let view = loop {
        loader.hint(pawn, &stands.motion());
        link.run(&mut loader, link.now + seconds(FRAME_S)).unwrap();
        let view = loader.snapshot().unwrap();
        let Overlap::NotLoaded(missing) = overlaps(&view, &looks) else { break view };
        loader.need(pawn, &missing);
        frames += 1;
        assert!(frames < 60, "{:#?}", link.transcript);
    };
    assert!(frames > 0 && overlaps(&view, &looks) == overlaps(&resident(&TOWER), &looks), "{frames}");
    // Needed pages are not kept for good.
    assert!(loader.counters().resident_pages < resident(&TOWER).page_count());
}

/// Drivers that answer in any order, lose answers, and cannot cancel: once the bodies rest, exactly the pages they need
/// are loaded.
#[test]
fn whatever_the_driver_does_the_same_pages_are_there_in_the_end() {
    let mut expected = None;
    for seed in 0..12 {
        let mut random = Random(seed);
        let manners = Manners {
            latency: Duration::from_millis(random.below(50)),
            rate: [1e5, 1e6, 1e9][random.below(3) as usize],
            lost: [0, 10, 50][random.below(3) as usize],
            shuffled: random.below(2) == 0,
        };
        let options = LoaderOptions {
            fetches: 1 + random.below(8) as usize,
            run_bytes: [0, 10_000, 256 << 10][random.below(3) as usize],
            horizon_max: Duration::from_secs(1),
            ..LoaderOptions::new(BUDGET)
        };
        // Opened over a good link, because an answer lost before the directory is loaded is an error for the driver.
        let mut link = Link::new(&TOWER, Manners::GOOD, seed);
        let (mut loader, pawn) = opened(&TOWER, options);
        link.run(&mut loader, seconds(0.1)).unwrap();
        link.manners = manners;
        for _ in 0..20 {
            let body = Body::at(random.between(-4.0, 4.0), random.between(-4.0, 4.0), random.between(0.0, 60.0));
            loader.hint(pawn, &body.motion());
            link.run(&mut loader, link.now + seconds(random.between(0.0, 0.2))).unwrap();
        }
        let body = Body::at(0.9, 0.2, 31.0);
        loader.hint(pawn, &body.motion());
        link.run(&mut loader, link.now + seconds(3600.0)).unwrap();
        let counters = loader.counters();
        assert!(counters.peak_bytes <= BUDGET, "seed {seed}: {counters:?}");
        let view = loader.snapshot().unwrap();
        let answer = overlaps(&view, &body.shape());
        assert!(!matches!(answer, Overlap::NotLoaded(_)), "seed {seed}");
        // All pages that the body needs, whatever else is loaded.
        let mut probe = loader.request(&[], PageKey { tx: 0, ty: 0, layer: 0 });
        link.poll(&mut loader).unwrap();
        assert_eq!(loader.outcome(probe).unwrap().unwrap().left_out, 0);
        let keys = loader.snapshots().unwrap().keys_around(&body.motion());
        probe = loader.request(&keys, keys[0]);
        link.poll(&mut loader).unwrap();
        let report = loader.outcome(probe).unwrap().unwrap();
        assert_eq!((report.already, report.loaded), (keys.len(), 0), "seed {seed}");
        assert_eq!(expected.get_or_insert((answer, keys.len())), &(answer, keys.len()));
    }
}

/// A budget that fits these pages at the same time.
fn needed_bytes(keys: &[PageKey]) -> usize {
    let (mut loader, _) = opened(&TOWER, LoaderOptions::new(16 * BUDGET));
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    let request = loader.request(keys, keys[0]);
    link.run(&mut loader, seconds(10.0)).unwrap();
    let report = loader.outcome(request).unwrap().unwrap();
    assert_eq!((report.loaded, report.left_out), (keys.len(), 0));
    report.needed_bytes
}

fn keys_around(body: &Body) -> Vec<PageKey> {
    let (mut loader, _) = opened(&TOWER, LoaderOptions::new(BUDGET));
    Link::new(&TOWER, Manners::GOOD, 1).run(&mut loader, seconds(0.1)).unwrap();
    loader.snapshots().unwrap().keys_around(&body.motion())
}

#[test]
fn a_request_waits_for_room_that_others_give_back() {
    let wanted = keys_around(&Body::at(0.9, 0.0, 31.0));
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions::new(needed_bytes(&wanted)));
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    link.run(&mut loader, seconds(0.1)).unwrap();
    loader.hint(pawn, &Body::at(-3.0, -3.0, 5.0).motion());
    let mut decoding = Vec::new();
    while let Next::Fetch(fetch) = loader.poll(link.now).unwrap() {
        let bytes = TOWER[fetch.range.start as usize..fetch.range.end as usize].to_vec();
        decoding.push(loader.given(fetch.id, bytes, link.now).unwrap());
    }
    assert!(!decoding.is_empty());
    loader.forget(pawn);
    let request = loader.request(&wanted, wanted[0]);
    link.run(&mut loader, seconds(0.2)).unwrap();
    assert!(loader.outcome(request).is_none(), "what is being decoded holds room still");
    for job in decoding {
        loader.loaded(job.run(), link.now);
    }
    link.run(&mut loader, seconds(1.0)).unwrap();
    let report = loader.outcome(request).unwrap().unwrap();
    assert_eq!((report.loaded, report.left_out), (wanted.len(), 0), "{report:?}");
}

/// Two requests and a resting body, with the budget that the larger request needs beside the body.
#[test]
fn requests_get_all_pages_one_after_the_other_in_the_budget_that_each_needs() {
    let places = [Body::at(0.9, 0.0, 31.0), Body::at(3.0, -3.0, 50.0), Body::at(-3.0, 3.0, 8.0)];
    let [here, first, second] = places.each_ref().map(keys_around);
    let beside = |keys: &[PageKey]| needed_bytes(&[keys, &here].concat());
    let budget = beside(&first).max(beside(&second));
    for seed in 0..48 {
        let mut random = Random(seed);
        let options = LoaderOptions {
            fetches: 1 + random.below(6) as usize,
            run_bytes: [0, 10_000, 256 << 10][random.below(3) as usize],
            ..LoaderOptions::new(budget)
        };
        let (mut loader, pawn) = opened(&TOWER, options);
        let mut link = Link::new(&TOWER, Manners::GOOD, seed);
        link.run(&mut loader, seconds(0.1)).unwrap();
        link.manners = Manners {
            latency: Duration::from_millis(random.below(50)),
            rate: [1e5, 1e6, 1e9][random.below(3) as usize],
            lost: 0,
            shuffled: random.below(2) == 0,
        };
        let mut requests = Vec::new();
        for _ in 0..4 {
            loader.hint(pawn, &places[0].motion());
            let later = link.now + seconds(random.between(0.0, 0.2));
            link.run(&mut loader, later).unwrap();
            let wanted = if random.below(2) == 0 { &first } else { &second };
            requests.push(loader.request(wanted, wanted[0]));
        }
        link.run(&mut loader, seconds(1000.0)).unwrap();
        for request in requests {
            let report = loader.outcome(request).unwrap().unwrap();
            assert_eq!(report.left_out, 0, "seed {seed}: {report:?}");
        }
        let counters = loader.counters();
        assert!(counters.peak_bytes <= budget, "seed {seed}: {counters:?}");
    }
}

/// A page arrives slowly in the free space; the next one requires an eviction, which a view still blocks for a moment.
#[test]
fn patience_with_views_begins_when_nothing_else_holds_room() {
    let wanted = keys_around(&Body::at(0.9, 0.0, 31.0));
    let other = [Body::at(3.0, -3.0, 50.0), Body::at(-3.0, 3.0, 8.0)].map(|body| keys_around(&body)).concat();
    let budget = needed_bytes(&[&other[..], &wanted[..1]].concat());
    assert!(wanted.len() > 1 && budget >= needed_bytes(&wanted));
    let options = LoaderOptions { run_bytes: 0, fetches: 1, ..LoaderOptions::new(budget) };
    let (mut loader, _) = opened(&TOWER, options);
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    loader.request(&other, other[0]);
    link.run(&mut loader, seconds(1.0)).unwrap();
    let old = loader.snapshot().unwrap();
    link.manners.latency = Duration::from_millis(300);
    let request = loader.request(&wanted, wanted[0]);
    link.run(&mut loader, link.now + seconds(0.35)).unwrap();
    assert!(loader.snapshot().unwrap().is_loaded(wanted[0]) == Some(true) && loader.outcome(request).is_none());
    drop(old);
    link.run(&mut loader, link.now + seconds(10.0)).unwrap();
    let report = loader.outcome(request).unwrap().unwrap();
    assert_eq!((report.loaded, report.left_out), (wanted.len(), 0), "{report:?}");
}

#[test]
fn polling_again_without_news_changes_nothing() {
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions::new(BUDGET));
    while !matches!(loader.poll(Duration::ZERO).unwrap(), Next::Wait(_)) {}
    let before = loader.counters();
    for _ in 0..5 {
        assert!(matches!(loader.poll(Duration::ZERO).unwrap(), Next::Wait(None)));
    }
    assert_eq!(loader.counters(), before);
    loader.forget(pawn);
}

/// The most urgent page first: a page fetched second is needed no sooner.
#[test]
fn the_most_urgent_fetch_comes_first_and_none_twice() {
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    let (mut loader, pawn) =
        opened(&TOWER, LoaderOptions { run_bytes: 0, fetches: 1000, ..LoaderOptions::new(16 * BUDGET) });
    link.run(&mut loader, seconds(1.0)).unwrap();
    loader.hint(pawn, &Body::at(0.0, 0.0, 50.0).motion());
    let (mut last, mut ranges) = (Duration::ZERO, std::collections::BTreeSet::new());
    while let Next::Fetch(fetch) = loader.poll(link.now).unwrap() {
        assert!(fetch.needed_in >= last, "{fetch:?}");
        assert!(ranges.insert(fetch.range.start), "{fetch:?} again");
        last = fetch.needed_in;
    }
    assert!(ranges.len() > 20 && last > Duration::from_millis(200));
}

#[test]
fn what_nobody_wants_is_cancelled_when_it_is_in_the_way_and_its_answer_ignored() {
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions { fetches: 2, ..LoaderOptions::new(BUDGET) });
    link.run(&mut loader, seconds(1.0)).unwrap();
    loader.hint(pawn, &Body::at(-3.0, -3.0, 5.0).motion());
    let mut fetches = Vec::new();
    let now = link.now;
    while let Next::Fetch(fetch) = loader.poll(now).unwrap() {
        fetches.push(fetch);
    }
    assert_eq!(fetches.len(), 2);
    loader.hint(pawn, &Body::at(3.0, 3.0, 55.0).motion());
    let mut cancelled = Vec::new();
    loop {
        match loader.poll(now).unwrap() {
            Next::Cancel(id) => cancelled.push(id),
            Next::Fetch(fetch) => assert!(fetches.iter().all(|old| old.range != fetch.range)),
            Next::Report(report) => panic!("{report:?}"),
            Next::Wait(_) => break,
        }
    }
    assert_eq!(cancelled, [fetches[0].id, fetches[1].id]);
    for fetch in fetches {
        let bytes = TOWER[fetch.range.start as usize..fetch.range.end as usize].to_vec();
        assert!(loader.given(fetch.id, bytes, now).is_none());
    }
    assert_eq!((loader.counters().cancelled, loader.counters().loaded), (2, 0));
}

#[test]
fn pages_that_cannot_be_read_are_tried_again_ever_later() {
    let mut link = Link::new(&TOWER, Manners { lost: 0, ..Manners::GOOD }, 1);
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions { run_bytes: 0, fetches: 1, ..LoaderOptions::new(BUDGET) });
    link.run(&mut loader, seconds(1.0)).unwrap();
    link.manners.lost = 100;
    let body = Body::at(0.9, 0.0, 31.0);
    loader.hint(pawn, &body.motion());
    link.run(&mut loader, seconds(60.0)).unwrap();
    assert!(!link.reports.is_empty() && loader.counters().loaded == 0);
    let key = link.reports[0].key;
    let at: Vec<f64> = link
        .transcript
        .iter()
        .filter(|line| line.ends_with(&format!("report {key}")))
        .map(|line| line.split(' ').next().unwrap().parse().unwrap())
        .collect();
    let pauses: Vec<f64> = at.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(pauses.len() >= 8, "{pauses:?}");
    for (n, pause) in pauses.iter().enumerate() {
        let least = 0.1 * f64::from(1 << n.min(6));
        assert!(*pause >= least && *pause <= least + 1.5, "{pauses:?}");
    }
    link.manners.lost = 0;
    link.run(&mut loader, seconds(75.0)).unwrap();
    assert!(!matches!(overlaps(&loader.snapshot().unwrap(), &body.shape()), Overlap::NotLoaded(_)));
}

#[test]
fn an_archive_that_breaks_a_rule_fails_for_ever_and_one_that_cannot_be_read_only_as_long() {
    let mut damaged = TOWER.clone();
    damaged[200] ^= 1;
    let mut link = Link::new(&damaged, Manners::GOOD, 1);
    let mut loader = Loader::open(Some(damaged.len() as u64), LoaderOptions::new(BUDGET));
    for _ in 0..3 {
        let error = link.run(&mut loader, link.now + seconds(10.0)).unwrap_err();
        assert!(error.to_string().contains("rule H3"), "{error}");
    }
    let archive = Archive::from_bytes(TOWER.clone()).unwrap();
    let leaf = archive.catalog().leaf_range(0);
    let mut damaged = TOWER.clone();
    damaged[leaf.start as usize + 9] ^= 1;
    let mut link = Link::new(&damaged, Manners::GOOD, 1);
    let mut loader = Loader::open(None, LoaderOptions::new(BUDGET));
    for _ in 0..3 {
        let error = link.run(&mut loader, link.now + seconds(10.0)).unwrap_err();
        assert!(error.to_string().contains("rule D1: directory leaf 0"), "{error}");
    }
    let mut link = Link::new(&TOWER, Manners { lost: 100, ..Manners::GOOD }, 1);
    let mut loader = Loader::open(None, LoaderOptions::new(BUDGET));
    let mut failures = 0;
    while link.now < seconds(5.0) {
        failures += u32::from(link.run(&mut loader, link.now + seconds(0.5)).is_err());
    }
    assert!((5..20).contains(&failures), "{failures}");
    link.manners.lost = 0;
    while link.now < seconds(20.0) {
        let _ = link.run(&mut loader, link.now + seconds(0.5));
    }
    assert!(loader.snapshot().is_some());
}

#[test]
fn a_cut_archive_of_unknown_length_and_a_budget_below_the_table_are_refused() {
    let cut = &TOWER[..TOWER.len() - 5];
    let mut link = Link::new(cut, Manners::GOOD, 1);
    let mut loader = Loader::open(None, LoaderOptions::new(BUDGET));
    assert!(link.run(&mut loader, seconds(1.0)).unwrap_err().to_string().contains("read 24 bytes"));
    let mut link = Link::new(&TOWER, Manners::GOOD, 1);
    let mut loader = Loader::open(None, LoaderOptions::new(10_000));
    for _ in 0..2 {
        let error = link.run(&mut loader, link.now + seconds(1.0)).unwrap_err().to_string();
        assert!(error.contains("10000 bytes are too few: the table of"), "{error}");
    }
    assert_eq!(link.requests(), 2, "no leaf is asked for: {:#?}", link.transcript);
}

/// A frame loop like a game's, over a slow link: a walker never waits once it stands.
#[test]
fn a_walker_on_a_slow_link_waits_at_the_start_only() {
    let manners = Manners { latency: Duration::from_millis(40), rate: 2.5e6, lost: 0, shuffled: false };
    let mut link = Link::new(&TOWER, manners, 1);
    let (mut loader, pawn) = opened(&TOWER, LoaderOptions::new(BUDGET));
    let mut walker = Walker::new(Config::default(), [1.5, 0.0, 30.3].into()).unwrap();
    let frame = *Archive::from_bytes(TOWER.clone()).unwrap().frame();
    let (mut waits, mut started) = (0, None);
    for n in 0..1200u32 {
        loader.hint(pawn, &walker.motion_hint(&frame));
        link.run(&mut loader, seconds(f64::from(n) * FRAME_S)).unwrap();
        let Some(view) = loader.snapshot() else { continue };
        let angle = f64::from(n / 120);
        let report = walker.step(&view, FRAME_S, MoveInput::Direction([angle.cos(), angle.sin()].into()));
        match report.waits() {
            true if started.is_some() => waits += 1,
            true => {}
            false => started = started.or(Some(n)),
        }
    }
    println!("walks after {started:?} frames, {waits} waits, {:?}", loader.counters());
    assert!(started.is_some_and(|n| n < 60));
    assert_eq!(waits, 0);
}
