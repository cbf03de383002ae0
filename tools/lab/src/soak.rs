//! A long run: bodies on four threads walk, fall and jump through a building whose pages come and go in a small cache,
//! and every answer is compared with that of an archive that is wholly in memory.
//!
//! Out: `soak.md`. Ends with an error at the first wrong answer, and when the cache exceeds its budget.

use crate::stability::lab::{Scan, Setting};
use crate::stability::table::number;
use crate::stability::{Error, Result};
use crate::{Random, building};
use nalgebra::{Point3, Vector2, Vector3};
use slicewalk::archive::Archive;
use slicewalk::plan::Classifier;
use slicewalk::query::{
    Aabb, Answer, Cylinder, Overlap, Ray, SweepHit, cast, ceiling_above, floor_under, overlaps, probe, sweep,
};
use slicewalk::store::{Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk::walk::{Body, Config, MoveInput, Walker};
use std::path::Path;
use std::time::{Duration, Instant};

const THREADS: u64 = 4;
const PIXEL_M: f64 = 0.03;

/// Answers that were known and equal, and those that waited for pages.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    frames: u64,
    equal: u64,
    not_loaded: u64,
}

impl Tally {
    fn add<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, seen: Option<T>, truth: Option<T>) -> Result<()> {
        match seen {
            None => self.not_loaded += 1,
            Some(_) if seen == truth => self.equal += 1,
            Some(seen) => return Err(format!("{what}: {seen:?}, of all pages {truth:?}").into()),
        }
        Ok(())
    }
}

/// Runs for `minutes`, and writes `soak.md` into `out`.
pub fn run(out: &Path, minutes: f64) -> Result<()> {
    let mut points = Vec::new();
    building::scan(PIXEL_M / 1.6, 5, |point| points.push([point.x, point.y, point.z]));
    let converted = Scan::new(points)?.convert(Setting::new(PIXEL_M), Classifier::Plane)?;
    let all = converted.store;
    let budget = all.weight_bytes() / 8;
    let options = StreamOptions { prefetch: Prefetch::Thread, ..StreamOptions::new(budget) };
    let stream = Stream::open(Archive::from_bytes(converted.bytes)?, options)?;
    let (begin, memory) = (Instant::now(), resident_mib());
    let end = begin + Duration::from_secs_f64(minutes * 60.0);
    let tally = std::thread::scope(|scope| -> Result<Tally> {
        let (stream, all) = (&stream, &all);
        let threads: Vec<_> = (0..THREADS).map(|seed| scope.spawn(move || body(stream, all, seed, end))).collect();
        let mut sum = Tally::default();
        for thread in threads {
            let part = thread.join().map_err(|_| -> Error { "a thread panicked".into() })??;
            sum.frames += part.frames;
            sum.equal += part.equal;
            sum.not_loaded += part.not_loaded;
        }
        Ok(sum)
    })?;
    let counters = stream.counters();
    if counters.peak_bytes > budget || counters.failed > 0 {
        return Err(format!("the cache: {counters:?}").into());
    }
    let million = |count: u64| number(count as f64 / 1e6, 2);
    let mib = |bytes: usize| number(bytes as f64 / f64::from(1 << 20), 2);
    let page = format!(
        "# Soak\n\n`cargo run --release --manifest-path tools/lab/Cargo.toml -- soak --minutes {minutes}` writes this page.\n\n\
         Four threads, each with a body that walks, falls and jumps through a building of two storeys at pixels of {} cm, \
         while a prefetcher loads and evicts its pages in a cache of an eighth of their weight. Every answer is compared \
         with that of a store that holds all pages.\n\n\
         | | |\n| --- | --- |\n| time | {} min |\n| frames | {} M |\n| answers, all equal | {} M |\n| \
         not loaded | {} M |\n| wrong answers | 0 |\n| pages loaded, evicted | {}, {} |\n| reads | {} |\n| cache, at peak \
         (MiB) | {} of {} |\n| resident memory of the process, before and after (MiB) | {memory}, {} |\n",
        number(PIXEL_M * 100.0, 0),
        number(begin.elapsed().as_secs_f64() / 60.0, 1),
        million(tally.frames),
        million(tally.equal),
        million(tally.not_loaded),
        counters.loaded,
        counters.evicted,
        counters.reads,
        mib(counters.peak_bytes),
        mib(budget),
        resident_mib(),
    );
    print!("{page}");
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("soak.md"), page)?;
    Ok(())
}

/// One body until `end`.
fn body(stream: &Stream, all: &Snapshot, seed: u64, end: Instant) -> Result<Tally> {
    let mut random = Random(seed);
    let mut pawn = stream.pawn();
    let mut tally = Tally::default();
    let shape = Body::Box { x: 0.5, y: 0.5, height: 1.8 };
    let mut walker = Walker::new(Config::new(shape), Point3::new(3.0, 3.0, 0.1))?;
    let mut heading = 0.0f64;
    while Instant::now() < end {
        if tally.frames.is_multiple_of(200) {
            let storey = building::STOREY[0] * f64::from(random.bits() as u32 % 2);
            let mut at = |axis: usize| random.between(0.6, building::SIZE[axis] - 0.6);
            walker.place(Point3::new(at(0), at(1), storey + 0.8));
        }
        tally.frames += 1;
        heading += random.normal(0.1);
        pawn.hint(&walker.motion_hint(all_frame(all)));
        let wish = MoveInput::Direction(Vector2::new(heading.cos(), heading.sin()));
        let view = pawn.snapshot();
        let mut truth = walker.clone();
        let expected = truth.step(all, 1.0 / 60.0, wish);
        let seen = walker.step(&view, 1.0 / 60.0, wish);
        match seen.missing {
            None => tally.add("a step", Some((seen, walker.feet())), Some((expected, truth.feet())))?,
            Some(missing) => {
                tally.not_loaded += 1;
                pawn.need(&missing);
                drop(view);
                if random.bits().is_multiple_of(4) {
                    stream.load_missing(&missing)?;
                }
                walker = truth;
                continue;
            }
        }
        ask(&view, all, walker.feet(), &mut random, &mut tally)?;
    }
    Ok(tally)
}

fn all_frame(all: &Snapshot) -> &slicewalk::frame::Frame {
    slicewalk::store::Snapshot::frame(all)
}

/// Queries around a place.
fn ask(view: &Snapshot, all: &Snapshot, feet: Point3<f64>, random: &mut Random, tally: &mut Tally) -> Result<()> {
    let mut offset = |far: f64| random.between(-far, far);
    let at = feet + Vector3::new(offset(2.0), offset(2.0), offset(1.0));
    let shape = Aabb::standing(at, Vector3::new(0.5, 0.5, 1.8))?;
    let round = Cylinder::new(at, 0.3, 1.7)?;
    let way = Vector3::new(offset(0.5), offset(0.5), offset(0.2));
    let ray = Ray::new(at, Vector3::new(offset(1.0), offset(1.0), offset(0.3)) + Vector3::new(1e-3, 0.0, 0.0), 8.0)?;
    let hit = |answer: Overlap| match answer {
        Overlap::NotLoaded(_) => None,
        known => Some(known),
    };
    tally.add("overlaps", hit(overlaps(view, &shape)), hit(overlaps(all, &shape)))?;
    tally.add("cylinder", hit(overlaps(view, &round)), hit(overlaps(all, &round)))?;
    tally.add("probe", known(probe(view, &shape)), known(probe(all, &shape)))?;
    tally.add("floor", known(floor_under(view, &shape, at.z, 3.0)), known(floor_under(all, &shape, at.z, 3.0)))?;
    tally.add(
        "ceiling",
        known(ceiling_above(view, &round, at.z, 3.0)),
        known(ceiling_above(all, &round, at.z, 3.0)),
    )?;
    // If a shape begins inside solid, any span around it is a right answer.
    let place = |hit: SweepHit| if hit.begins_inside() { None } else { Some(hit) };
    let met = |answer: Answer<Option<SweepHit>>| answer.known().map(|hit| hit.map(place));
    tally.add("sweep", met(sweep(view, &shape, way)), met(sweep(all, &shape, way)))?;
    tally.add("ray", known(cast(view, &ray)), known(cast(all, &ray)))
}

fn known<T>(answer: Answer<T>) -> Option<T> {
    answer.known()
}

/// Resident memory of this process (MiB), if the system reports it.
fn resident_mib() -> String {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
    kib.map_or("unknown".into(), |kib| number(kib / 1024.0, 1))
}
