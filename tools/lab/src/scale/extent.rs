//! A scene of great extent: converted, opened, and walked across with a small cache.

use super::{Found, MEMORY};
use crate::measured::Conversion;
use crate::stability::Result;
use crate::stability::table::{Table, number};
use nalgebra::Point2;
use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::archive::Archive;
use slicewalk::bytes::FileSource;
use slicewalk::bytes::testing::SlowSource;
use slicewalk::store::{Prefetch, Stream, StreamOptions};
use slicewalk::walk::{Config, State, Walker, Waypoints};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

const PIXEL_M: f64 = 0.05;
/// Noise of the scanner, one standard deviation (m).
const NOISE_M: f64 = 0.002;
const CACHE: usize = 64 << 20;
const FRAME_S: f64 = 1.0 / 60.0;
/// How much faster than life the walk is run: a frame has an eighth of its time.
const HASTE: f64 = 8.0;
/// Width of a block of the city, and from its border to the middle of the street (m).
const BLOCK_M: f64 = 60.0;

type Counted = Arc<SlowSource<FileSource>>;

/// Cost of a walk across.
struct Walked {
    metres: f64,
    frames: usize,
    /// Frames that missed a page.
    missed: usize,
    state: State,
    /// Reads of opening the archive, and until the stream was open.
    reads: [(u64, u64); 2],
    opening_ms: [f64; 2],
    counters: slicewalk::store::Counters,
}

/// Converts the city, opens it, and walks from one corner to the opposite.
pub fn measure(found: &mut Found, work: &Path, quick: bool) -> Result<()> {
    let params = Params::new();
    let params = if quick { params.with("width", 240.0).with("depth", 180.0).with("height", 60.0) } else { params };
    let scene = Scene::named("extent", &params)?;
    let (scan, path) = (work.join("extent.las"), work.join("extent.slices"));
    let spec = SampleSpec::direct_density(PIXEL_M.powi(-2)).with_noise(NOISE_M);
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..spec };
    let written = write_samples(&scan, scene.samples(1, &spec)?, &WriteSpec::default())?;
    let conversion = Conversion { memory: Some(MEMORY), ..Conversion::new(&scan, &path, false, PIXEL_M) };
    let converted = conversion.measure(1)?;
    std::fs::remove_file(scan)?;
    let voxels = Archive::open(&path)?.header().voxels.occupied;
    let size = [0, 1, 2].map(|axis| scene.bounds().max[axis] - scene.bounds().min[axis]);
    let on = walk(&path, [size[0], size[1]], Prefetch::Thread)?;
    let off = walk(&path, [size[0], size[1]], Prefetch::Off)?;
    std::fs::remove_file(path)?;
    if on.state != State::Arrived {
        return Err(
            format!("the walk across the city ended {} after {} m", on.state.name(), number(on.metres, 0)).into()
        );
    }
    let mib = |bytes: f64| number(bytes / f64::from(1 << 20), 1);
    let opening = |n: usize| {
        let (reads, bytes) = on.reads[n];
        format!("{reads} reads, {} KiB, {} ms", number(bytes as f64 / 1024.0, 1), number(on.opening_ms[n], 2))
    };
    let mut table = Table::new(["", ""]);
    for (what, seen) in [
        ("extent (m)", size.map(|s| number(s, 0)).join(" × ")),
        ("points (M)", number(written.points as f64 / 1e6, 1)),
        ("occupied voxels (M)", number(voxels as f64 / 1e6, 1)),
        ("conversion (s), peak (MiB)", format!("{}, {}", number(converted.seconds, 1), number(converted.peak_mib, 0))),
        ("archive (MiB)", mib(converted.bytes as f64)),
        ("opening the archive", opening(0)),
        ("and the whole table of pages", opening(1)),
        ("walk (m)", number(on.metres, 0)),
        ("frames, of these with a page missing", format!("{}, {}", on.frames, on.missed)),
        ("the same without the prefetcher", format!("{}, {}", off.frames, off.missed)),
        ("pages loaded, evicted", format!("{}, {}", on.counters.loaded, on.counters.evicted)),
        ("read on the way (MiB)", mib(on.counters.read_bytes as f64)),
        ("cache at peak (MiB)", mib(on.counters.peak_bytes as f64)),
    ] {
        table.row([what.to_owned(), seen]);
    }
    found.section(&format!(
        "## A scene of great extent\n\nThe generated city `extent` at pixels of 5 cm, a point per pixel, `--memory 512MiB`. A pawn walks through \
         its streets from one corner to the opposite, with a cache of {} MiB and nothing in it at the start; the clock runs \
         {HASTE} times as fast as in life, so that a frame has {} ms for all its reads.\n\n{}\n",
        CACHE >> 20,
        number(FRAME_S / HASTE * 1e3, 1),
        table.markdown()
    ));
    Ok(())
}

/// From the corner at the origin along the middle of streets: half of the way along x, all of it along y, and on along x.
fn route(size: [f64; 2]) -> ([f64; 3], Vec<Point2<f64>>) {
    let street = |far: f64| (far / BLOCK_M / 2.0).floor() * BLOCK_M;
    let (middle, last) = (street(size[0]), (size[1] / BLOCK_M).floor() * BLOCK_M);
    let places = [[2.0, 1.0], [middle, 1.0], [middle, last], [size[0] - 1.0, last], [size[0] - 1.0, size[1] - 1.0]];
    ([1.0, 1.0, 0.0], places.map(Point2::from).to_vec())
}

fn walk(path: &Path, size: [f64; 2], prefetch: Prefetch) -> Result<Walked> {
    let start = Instant::now();
    let source: Counted = Arc::new(SlowSource::new(FileSource::open(path)?, Duration::ZERO));
    let archive = Archive::from_source(Box::new(source.clone()))?;
    let opened = (source.counts(), start.elapsed().as_secs_f64() * 1e3);
    let stream = Stream::open(archive, StreamOptions { prefetch, ..StreamOptions::new(CACHE) })?;
    let ready = (source.counts(), start.elapsed().as_secs_f64() * 1e3);
    let mut pawn = stream.pawn();
    let (feet, places) = route(size);
    let mut walker = Walker::new(Config::default(), feet.into())?;
    let mut route = Waypoints::new(places)?;
    stream.load_around(&walker.motion_hint(stream.archive().frame()))?;
    let (mut metres, mut frames, mut missed) = (0.0, 0, 0);
    // Twice the way at its speed, at most.
    let limit = (2.0 * (size[0] + size[1]) / walker.config().speed / FRAME_S) as usize;
    let clock = Instant::now();
    while walker.state() != State::Arrived && frames < limit {
        pawn.hint(&walker.motion_hint(stream.archive().frame()));
        let mut report = walker.follow(&stream.snapshot(), FRAME_S, &mut route);
        missed += usize::from(report.waits());
        metres += report.moved.norm();
        while let Some(needed) = report.missing {
            stream.load_missing(&needed)?;
            report = walker.follow(&stream.snapshot(), report.unspent, &mut route);
            metres += report.moved.norm();
        }
        frames += 1;
        if prefetch == Prefetch::Off {
            continue;
        }
        let due = Duration::from_secs_f64(frames as f64 * FRAME_S / HASTE);
        std::thread::sleep(due.saturating_sub(clock.elapsed()));
    }
    Ok(Walked {
        metres,
        frames,
        missed,
        state: walker.state(),
        reads: [opened.0, ready.0],
        opening_ms: [opened.1, ready.1],
        counters: stream.counters(),
    })
}
