//! Falls through dense storeys that are read while the pawn falls.

use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Table, number};
use nalgebra::Point2;
use scangen::scene::Walk;
use scangen::{Params, SampleSpec, Scene};
use slicewalk::archive::Archive;
use slicewalk::bytes::MemorySource;
use slicewalk::bytes::testing::SlowSource;
use slicewalk::plan::Classifier;
use slicewalk::store::{Counters, Prefetch, Stream, StreamOptions};
use slicewalk::walk::{Config, State, Walker, Waypoints};
use std::time::{Duration, Instant};

/// Time of a frame (s) and of a read.
const FRAME_S: f64 = 1.0 / 60.0;
const READ: Duration = Duration::from_millis(2);
const CACHE: usize = 16 << 20;
const PIXEL_M: f64 = 0.03;

struct Fall {
    frames: usize,
    /// Frames with a page missing, and the pages that these missed.
    missing: [usize; 2],
    /// Times of frames, sorted (ms).
    times: Vec<f64>,
    counters: Counters,
}

/// Measures both modes in real time.
pub fn section(quick: bool) -> Result<String> {
    let storeys = if quick { 6.0 } else { 51.0 };
    let tower = Params::new().with("storeys", storeys).with("size", 6.0).with("shaft", 2.0);
    let scene = Scene::named("tower", &tower)?;
    let walk = scene.walk().ok_or("the tower has a way")?;
    let spec = SampleSpec::direct_density((1.8 / PIXEL_M).powi(2)).with_noise(0.002);
    let points: Vec<_> = scene.points(3, &spec)?.collect();
    let count = points.len();
    let converted = Scan::new(points)?.convert(Setting::new(PIXEL_M), Classifier::Plane)?;
    let mut table = Table::new([
        "prefetch",
        "frames",
        "with a page missing",
        "pages missing",
        "frame p50 (ms)",
        "p99",
        "p99.9",
        "max",
        "reads",
        "MB read",
        "peak (MiB)",
    ]);
    for (name, prefetch) in [("on", Prefetch::Thread), ("off", Prefetch::Off)] {
        let fall = fall(&converted.bytes, walk, prefetch)?;
        let at = |share: f64| number(fall.times[((fall.times.len() - 1) as f64 * share).round() as usize], 3);
        let [frames, pages] = fall.missing.map(|count| count.to_string());
        table.row([
            name.into(),
            fall.frames.to_string(),
            frames,
            pages,
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0),
            fall.counters.reads.to_string(),
            number(fall.counters.read_bytes as f64 / 1e6, 2),
            number(fall.counters.peak_bytes as f64 / f64::from(1 << 20), 2),
        ]);
    }
    Ok(format!(
        "\n## Falls\n\nFrom the edge of a shaft, {} m down past {storeys} dense storeys ({:.1} M points, pixels of {} cm), up to {} m/s, at 60 frames a \
         second by the clock. Nothing but what the pawn stands in is in memory when it begins; each read takes 2 ms; the \
         cache has 16 MiB. Without the prefetcher a frame loads on the spot what it misses. One run; times are those of \
         the frame's own work, on a shared machine.\n\n{}\n",
        walk.start[2],
        count as f64 / 1e6,
        PIXEL_M * 100.0,
        Config::default().terminal,
        table.markdown()
    ))
}

fn fall(bytes: &[u8], way: &Walk, prefetch: Prefetch) -> Result<Fall> {
    let source = SlowSource::new(MemorySource::new(bytes), READ);
    let archive = Archive::from_source(Box::new(source))?;
    let stream = Stream::open(archive, StreamOptions { prefetch, ..StreamOptions::new(CACHE) })?;
    let mut pawn = stream.pawn();
    let mut walker = Walker::new(Config::default(), way.start.into())?;
    let mut fall = Fall { frames: 0, missing: [0; 2], times: Vec::new(), counters: Counters::default() };
    stream.load_around(&walker.motion_hint(stream.archive().frame()))?;
    let clock = Instant::now();
    let mut route = Waypoints::new(way.waypoints.iter().map(|place| Point2::from(*place)).collect())?;
    while walker.state() != State::Arrived && fall.frames < 3600 {
        pawn.hint(&walker.motion_hint(stream.archive().frame()));
        let started = Instant::now();
        let mut report = walker.follow(&stream.snapshot(), FRAME_S, &mut route);
        fall.missing[0] += usize::from(report.waits());
        while let Some(needed) = report.missing {
            fall.missing[1] += needed.count();
            stream.load_missing(&needed)?;
            report = walker.follow(&stream.snapshot(), report.unspent, &mut route);
        }
        fall.times.push(started.elapsed().as_secs_f64() * 1e3);
        fall.frames += 1;
        std::thread::sleep(Duration::from_secs_f64(fall.frames as f64 * FRAME_S).saturating_sub(clock.elapsed()));
    }
    fall.times.sort_by(f64::total_cmp);
    fall.counters = stream.counters();
    Ok(fall)
}
