//! Walkers of all bodies and a crowd, on a store and on a loader over a link in virtual time.

use crate::Random;
use nalgebra::{Point3, Vector2};
use slicewalk::store::{FetchId, Loader, LoaderOptions, Next, PageSet, Time};
use slicewalk::walk::{Body, Config, Crowd, Response, Walker, Wish};
use std::ops::Range;
use std::time::Duration;

const FRAMES: u32 = 1800;
const FRAME_S: f64 = 1.0 / 60.0;

fn walkers() -> Vec<Walker> {
    let bodies = [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }];
    let responses = [Response::Slide, Response::Thesis, Response::ThesisMean];
    let walker = |n: usize| {
        let config = Config { response: responses[n / 2], ..Config::new(bodies[n % 2]) };
        Walker::new(config, Point3::new(1.5 - 0.9 * n as f64, 0.4 * n as f64, 3.5)).expect("a sound config")
    };
    (0..6).map(walker).collect()
}

/// Wishes that turn now and then; their directions are made without a sine.
fn wish(random: &mut Random) -> Wish {
    Wish::Direction(Vector2::new(random.in_range(-1.0, 1.0), random.in_range(-1.0, 1.0)))
}

fn put(words: &mut Vec<u64>, walker: &Walker) {
    words.extend(walker.feet().iter().map(|value| value.to_bits()));
    words.push(walker.state() as u64);
}

/// Feet and states of walkers alone, then of a crowd of them, frame by frame.
pub fn path<S: PageSet>(set: &S) -> Vec<u64> {
    let (mut words, mut random) = (Vec::new(), Random(5));
    let mut walkers = walkers();
    let mut wishes = vec![Wish::Stay; walkers.len()];
    for frame in 0..FRAMES {
        for (walker, wish) in walkers.iter_mut().zip(&mut wishes) {
            if frame % 90 == 0 {
                *wish = self::wish(&mut random);
            }
            walker.step(set, FRAME_S, *wish);
            put(&mut words, walker);
        }
    }
    let mut crowd = Crowd::new(self::walkers()).expect("apart");
    for frame in 0..FRAMES / 3 {
        if frame % 90 == 0 {
            wishes.iter_mut().for_each(|wish| *wish = self::wish(&mut random));
        }
        crowd.step(set, FRAME_S, |n, _| wishes[n]);
        crowd.walkers().iter().for_each(|walker| put(&mut words, walker));
    }
    words
}

/// Feet of a walker, and what its loader asks for, over a link of 40 ms and 20 Mbit/s.
pub fn streamed_path(bytes: &[u8]) -> Vec<u64> {
    let (mut words, mut random) = (Vec::new(), Random(9));
    let mut loader = Loader::open(None, LoaderOptions::new(64 << 20));
    let pawn = loader.body();
    let mut walker = walkers().remove(0);
    let mut link: Vec<(Time, FetchId, Range<u64>)> = Vec::new();
    let (mut free_at, mut now, mut wish) = (Time::ZERO, Time::ZERO, Wish::Stay);
    for frame in 0..FRAMES {
        if frame % 90 == 0 {
            wish = self::wish(&mut random);
        }
        link.retain(|(at, id, range)| {
            if *at <= now {
                let end = range.end.min(bytes.len() as u64);
                let job = loader.given(*id, bytes[range.start as usize..end as usize].to_vec(), now);
                job.map(|job| loader.loaded(job.run(), now));
            }
            *at > now
        });
        if let Some(view) = loader.view() {
            walker.step(&view, FRAME_S, wish);
            loader.hint(pawn, &walker.outlook(view.frame()));
        }
        loop {
            match loader.poll(now).expect("a sound archive") {
                Next::Fetch(fetch) => {
                    words.extend([fetch.range.start, fetch.range.end]);
                    let took = Duration::from_nanos((fetch.range.end - fetch.range.start) * 400);
                    free_at = free_at.max(now + Duration::from_millis(40)) + took;
                    link.push((free_at, fetch.id, fetch.range));
                }
                Next::Cancel(cancelled) => link.retain(|(_, id, _)| *id != cancelled),
                Next::Report(report) => panic!("{}", report.error),
                Next::Wait(_) => break,
            }
        }
        put(&mut words, &walker);
        now += Duration::from_nanos(16_666_667);
    }
    words
}
