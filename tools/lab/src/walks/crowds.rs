//! A thousand pawns at sixty frames a second.

use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Table, number};
use nalgebra::{Point2, Point3};
use scangen::SampleSpec;
use scangen::scene::build::Builder;
use slicewalk::plan::Classifier;
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, Crowd, MoveInput, Walker};
use std::time::Instant;

const TICK_S: f64 = 1.0 / 60.0;
/// Half the width of the hall, and from pawn to pawn at the start (m).
const HALF_M: f64 = 24.0;
const APART_M: f64 = 1.2;

/// Measures crowds that cross and crowds that converge.
pub fn section(quick: bool) -> Result<String> {
    let count = if quick { 100 } else { 1000 };
    let mut build = Builder::new();
    build.level("floor", [-HALF_M, -HALF_M, HALF_M, HALF_M], 0.0, &[]);
    let edge = 2.0 * HALF_M;
    for [x, y, dx, dy] in [
        [-HALF_M, -HALF_M, edge, 0.0],
        [-HALF_M, HALF_M, edge, 0.0],
        [-HALF_M, -HALF_M, 0.0, edge],
        [HALF_M, -HALF_M, 0.0, edge],
    ] {
        build.quad("wall", [x, y, 0.0], [dx, dy, 0.0], [0.0, 0.0, 3.0]);
    }
    for [x, y] in [[-12.0, -12.0], [12.0, -12.0], [12.0, 12.0], [-12.0, 12.0]] {
        build.column("column", [x, y], 0.3, [0.0, 3.0]);
    }
    let spec = SampleSpec::direct_density(900.0).with_noise(0.001);
    let scan = Scan::new(build.finish("hall").points(7, &spec)?.collect())?;
    let store = scan.convert(Setting::new(0.05), Classifier::Plane)?.store;
    let mut table = Table::new([
        "crowd of",
        "wants",
        "frame p50 (ms)",
        "p99",
        "max",
        "settled",
        "after (s)",
        "within (m)",
        "deepest overlap (m)",
    ]);
    for (name, one) in [("across the hall", false), ("to one place", true)] {
        let seen = walk(&store, count, one)?;
        let at = |share: f64| number(seen.times[((seen.times.len() - 1) as f64 * share).round() as usize], 2);
        table.row([
            count.to_string(),
            name.into(),
            at(0.5),
            at(0.99),
            at(1.0),
            seen.settled.to_string(),
            number(seen.times.len() as f64 * TICK_S, 1),
            number(seen.within, 1),
            number(seen.overlap, 9),
        ]);
    }
    Ok(format!(
        "\n## Crowds\n\nHalf boxes, half cylinders, in a walled hall of {} m with four columns at pixels of 5 cm; ticks of 1/60 s. \
         *Within* is the greatest distance of a pawn that has settled from its place: only one fits on a place that all \
         want to. A dense counterflow jams: nobody gives way. One run on one core of a \
         machine that others kept busy: times are upper bounds.\n\n{}\n",
        2.0 * HALF_M,
        table.markdown()
    ))
}

struct Seen {
    /// Times of frames, sorted (ms).
    times: Vec<f64>,
    settled: usize,
    within: f64,
    overlap: f64,
}

/// Until all have settled, a minute at most.
fn walk(store: &Snapshot, count: usize, to_one: bool) -> Result<Seen> {
    let side = (count as f64).sqrt().ceil() as usize;
    let place = |n: usize| {
        let at = |k: usize| (k as f64 - (side - 1) as f64 / 2.0) * APART_M;
        Point2::new(at(n % side), at(n / side))
    };
    let bodies = [Body::Box { x: 0.5, y: 0.5, height: 1.8 }, Body::Cylinder { radius: 0.25, height: 1.8 }];
    let walker = |n: usize| {
        let config = Config { tick_s: TICK_S, ..Config::new(bodies[n % 2]) };
        Walker::new(config, Point3::new(place(n).x, place(n).y, 0.01))
    };
    let goal = |n: usize| if to_one { Point2::new(0.3, 0.1) } else { Point2::new(-place(n).x, place(n).y) };
    let mut crowd = Crowd::new((0..count).map(walker).collect::<slicewalk::Result<_>>()?)?;
    let mut seen = Seen { times: Vec::new(), settled: 0, within: 0.0, overlap: 0.0 };
    while seen.times.len() < 3600 && seen.settled < count {
        let start = Instant::now();
        let report = crowd.step(store, TICK_S, |n, _| MoveInput::Toward(goal(n)));
        seen.times.push(start.elapsed().as_secs_f64() * 1e3);
        seen.settled = report.arrived;
        if seen.times.len().is_multiple_of(60) {
            seen.overlap = seen.overlap.max(deepest(crowd.walkers()));
        }
    }
    seen.overlap = seen.overlap.max(deepest(crowd.walkers()));
    let arrived =
        crowd.walkers().iter().enumerate().filter(|(_, walker)| walker.state() == slicewalk::walk::State::Arrived);
    seen.within = arrived.map(|(n, walker)| (walker.feet().xy() - goal(n)).norm()).fold(0.0, f64::max);
    seen.times.sort_by(f64::total_cmp);
    Ok(seen)
}

/// How deep two pawns are in each other at most (m).
fn deepest(walkers: &[Walker]) -> f64 {
    let depth = |a: &Walker, b: &Walker| {
        let apart = (a.feet() - b.feet()).xy();
        match (a.config().body, b.config().body) {
            (Body::Cylinder { radius: r, .. }, Body::Cylinder { radius: s, .. }) => r + s - apart.norm(),
            (a, b) => (a.half() + b.half() - apart.abs()).min(),
        }
    };
    let pairs = walkers.iter().enumerate().flat_map(|(n, a)| walkers[..n].iter().map(move |b| depth(a, b)));
    pairs.fold(0.0, f64::max)
}
