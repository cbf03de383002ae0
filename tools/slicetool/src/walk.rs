//! `slicetool walk`: a pawn follows waypoints; its path as CSV, what it cost as JSON.

use crate::{Failure, Outcome};
use clap::ValueEnum;
use nalgebra::{Point2, Point3, Vector3};
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, PageKey, TILE_PIXELS};
use slicewalk::query::Missing;
use slicewalk::size::parse_size;
use slicewalk::store::{ByteSource, FileSource, PageSet, PageSlot, Region, Store};
use slicewalk::walk::{Body, Config, Response, Route, State, Walker};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// So long a pawn may be blocked before the walk ends (s).
const BLOCKED_S: f64 = 2.0;
/// How far ahead pages are loaded (s), and around the pawn in any case (m).
const AHEAD_S: f64 = 0.5;
const AROUND_M: f64 = 1.0;

/// Where to walk, and how.
#[derive(clap::Args)]
pub struct Arguments {
    archive: PathBuf,
    /// Where the feet stand first (m); if in the air, the pawn falls
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    start: Point3<f64>,
    /// Places to reach one after the other: columns x,y (a header is optional)
    #[arg(long, value_name = "W.csv")]
    waypoints: PathBuf,
    /// The pawn: box:WIDTHxDEPTHxHEIGHT or cylinder:RADIUSxHEIGHT (m)
    #[arg(long, value_name = "SHAPE", default_value = "box:0.5x0.5x1.8", value_parser = body)]
    pawn: Body,
    /// Walking speed (m/s)
    #[arg(long, default_value_t = 1.4, value_name = "M/S")]
    speed: f64,
    /// Highest step it climbs (m)
    #[arg(long, default_value_t = 0.35, value_name = "METRES")]
    climb: f64,
    /// Frames per second
    #[arg(long, default_value_t = 60.0, value_name = "HZ", value_parser = rate)]
    hz: f64,
    /// Memory for pages
    #[arg(long, default_value = "64MiB", value_name = "SIZE", value_parser = parse_size)]
    cache: u64,
    /// Load pages ahead of the pawn, or only when it misses them
    #[arg(long, value_enum, default_value_t = Switch::On)]
    prefetch: Switch,
    /// How it answers what is in its way: exact sweeps, or the steps of the thesis
    #[arg(long, value_enum, default_value_t = Rule::Slide)]
    response: Rule,
    /// End after so much time
    #[arg(long, default_value_t = 300.0, value_name = "S", value_parser = seconds)]
    max_seconds: f64,
    /// File to write: t,x,y,z,state,frame_us,missing
    #[arg(short, long, value_name = "path.csv")]
    output: PathBuf,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, ValueEnum)]
enum Rule {
    Slide,
    Thesis,
}

fn numbers<const N: usize>(text: &str, separator: char) -> Option<[f64; N]> {
    let values: Option<Vec<f64>> =
        text.split(separator).map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    values?.try_into().ok()
}

fn point(text: &str) -> Result<Point3<f64>, String> {
    numbers::<3>(text, ',').map(Point3::from).ok_or_else(|| "expected three numbers X,Y,Z".into())
}

fn body(text: &str) -> Result<Body, String> {
    let wrong = || "expected box:0.5x0.5x1.8 or cylinder:0.25x1.8 (m, above 0)".to_owned();
    let positive = |values: &[f64]| values.iter().all(|v| *v > 0.0);
    match text.split_once(':').ok_or_else(wrong)? {
        ("box", size) => match numbers::<3>(size, 'x') {
            Some([x, y, height]) if positive(&[x, y, height]) => Ok(Body::Box { x, y, height }),
            _ => Err(wrong()),
        },
        ("cylinder", size) => match numbers::<2>(size, 'x') {
            Some([radius, height]) if positive(&[radius, height]) => Ok(Body::Cylinder { radius, height }),
            _ => Err(wrong()),
        },
        _ => Err(wrong()),
    }
}

fn rate(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| (0.1..=1e5).contains(v));
    value.ok_or_else(|| "expected frames per second from 0.1 to 100000".into())
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| *v > 0.0 && *v <= 1e6);
    value.ok_or_else(|| "expected seconds above 0, at most 1000000".into())
}

/// Walks; the path appears whole, or not at all.
pub fn run(arguments: &Arguments) -> Outcome {
    let config = Config {
        speed: arguments.speed,
        climb: arguments.climb,
        response: match arguments.response {
            Rule::Slide => Response::Slide,
            Rule::Thesis => Response::Thesis,
        },
        ..Config::new(arguments.pawn)
    };
    let mut walker = Walker::new(config, arguments.start)?;
    let mut route = Route::new(waypoints(&arguments.waypoints)?)?;
    let mut pages = Pages::open(&arguments.archive, arguments.cache, arguments.prefetch == Switch::On)?;
    let frame_s = 1.0 / arguments.hz;
    let most = (arguments.max_seconds * arguments.hz).ceil().max(1.0) as u64;
    let mut path = String::from("t,x,y,z,state,frame_us,missing\n");
    let mut times = Vec::new();
    let (mut distance, mut blocked) = (0.0, 0.0);
    for frame in 1..=most {
        let ahead = Ahead::of(&walker, &route);
        pages.prepare(&ahead)?;
        let before = walker.feet();
        let started = Instant::now();
        let (mut dt, mut missing) = (frame_s, 0);
        loop {
            let report = walker.follow(&pages.store, dt, &mut route);
            let Some(needed) = report.missing else { break };
            missing += needed.count();
            if !pages.fetch(&needed, &ahead)? {
                // No room for what it needs: it waits in place, and time passes.
                break;
            }
            dt = report.unspent;
        }
        let frame_us = started.elapsed().as_secs_f64() * 1e6;
        pages.late += missing as u64;
        times.push(frame_us);
        distance += (walker.feet() - before).norm();
        let (feet, state) = (walker.feet(), walker.state());
        let t = frame as f64 * frame_s;
        writeln!(path, "{t:.6},{:.6},{:.6},{:.6},{},{frame_us:.1},{missing}", feet.x, feet.y, feet.z, state.name())?;
        blocked = if state == State::Blocked { blocked + frame_s } else { 0.0 };
        if state == State::Arrived || blocked >= BLOCKED_S - 1e-9 {
            break;
        }
    }
    std::fs::write(&arguments.output, path)
        .map_err(|e| Failure::Text(format!("{}: cannot write: {e}", arguments.output.display())))?;
    let (frames, feet) = (times.len(), walker.feet());
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[((frames - 1) as f64 * share).round() as usize];
    let state = walker.state().name();
    if !arguments.json {
        eprintln!(
            "{state} at ({:.3}, {:.3}, {:.3}) after {:.2} s and {distance:.2} m; waypoint {} of {}; {} pages late",
            feet.x,
            feet.y,
            feet.z,
            frames as f64 * frame_s,
            route.next(),
            route.places().len(),
            pages.late
        );
        return Ok(String::new());
    }
    let summary = serde_json::json!({
        "frames": frames,
        "seconds": frames as f64 * frame_s,
        "distance": distance,
        "state": state,
        "end": [feet.x, feet.y, feet.z],
        "waypoints_reached": route.next(),
        "frame_us": { "p50": at(0.5), "p99": at(0.99), "p99.9": at(0.999), "max": at(1.0) },
        "reads": pages.counters.reads.load(Ordering::Relaxed),
        "bytes": pages.counters.bytes.load(Ordering::Relaxed),
        "hits": pages.hits,
        "late": pages.late,
        "loaded": pages.loaded,
        "evicted": pages.evicted,
        "cache_peak": pages.peak,
        "cache": pages.store.budget_bytes(),
    });
    Ok(format!("{summary:#}\n"))
}

/// Reads columns x,y: by their names if there is a header, else the first two.
fn waypoints(path: &Path) -> Result<Vec<Point2<f64>>, Failure> {
    let failed = |at: String, reason: String| Failure::Text(format!("{}: {at}: {reason}", path.display()));
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(path)
        .map_err(|e| failed("cannot open".into(), e.to_string()))?;
    let (mut places, mut columns) = (Vec::new(), None);
    for row in reader.records() {
        let row = row.map_err(|e| failed("cannot read".into(), e.to_string()))?;
        let line = format!("line {}", row.position().map_or(0, |position| position.line()));
        let named = columns.is_none() && row.iter().any(|field| field.parse::<f64>().is_err());
        let [x, y] = *columns.get_or_insert([0, 1]);
        if named {
            let place = |name: &str| {
                let found = row.iter().position(|field| field.eq_ignore_ascii_case(name));
                found.ok_or_else(|| failed(line.clone(), format!("no column {name}; expected x,y")))
            };
            columns = Some([place("x")?, place("y")?]);
            continue;
        }
        let value = |at: usize| {
            let field = row.get(at).unwrap_or_default();
            let value = field.parse::<f64>().ok().filter(|v| v.is_finite());
            value.ok_or_else(|| failed(line.clone(), format!("{field:?} is no number")))
        };
        places.push(Point2::new(value(x)?, value(y)?));
    }
    if places.is_empty() {
        return Err(failed("line 1".into(), "no waypoint; expected rows of x,y".into()));
    }
    Ok(places)
}

/// Where a pawn will be soon: the box that pages are loaded for.
struct Ahead {
    feet: Point3<f64>,
    low: Point3<f64>,
    high: Point3<f64>,
}

impl Ahead {
    fn of(walker: &Walker, route: &Route) -> Self {
        let (feet, config) = (walker.feet(), walker.config());
        let half = config.body.half().push(0.0);
        let way = route.places().get(route.next()).map_or(nalgebra::zero(), |place| place - feet.xy());
        let far = config.speed * AHEAD_S;
        let way = way * (far / way.norm().max(far.max(1e-9)));
        let fall = (walker.falling() + config.gravity * AHEAD_S).min(config.terminal) * AHEAD_S;
        let margin = Vector3::repeat(AROUND_M);
        let up = Vector3::new(0.0, 0.0, config.body.height() + config.climb);
        let way = way.push(0.0);
        let low = feet - half - margin + way.inf(&Vector3::zeros()) - Vector3::new(0.0, 0.0, fall);
        let high = feet + half + margin + way.sup(&Vector3::zeros()) + up;
        Self { feet, low, high }
    }
}

/// The pages around the pawn: all that this command knows of loading. Loads on the spot, between frames or on a miss.
struct Pages {
    store: Store,
    counters: Arc<Counters>,
    prefetch: bool,
    /// Pages around the pawn that were in memory already, counted anew in every frame.
    hits: u64,
    late: u64,
    loaded: u64,
    evicted: u64,
    peak: usize,
}

impl Pages {
    fn open(path: &Path, cache: u64, prefetch: bool) -> Result<Self, Failure> {
        let counters = Arc::new(Counters::default());
        let source = Counting { file: FileSource::open(path)?, counters: counters.clone() };
        let archive = Archive::from_source(Box::new(source))?;
        let budget = usize::try_from(cache).unwrap_or(usize::MAX);
        let store = Store::with_budget(Box::new(archive), budget)?;
        Ok(Self { store, counters, prefetch, hits: 0, late: 0, loaded: 0, evicted: 0, peak: 0 })
    }

    fn key(&self, at: Point3<f64>) -> [i32; 3] {
        let frame = self.store.frame();
        let index = |v: i64, unit: i64| v.div_euclid(unit).clamp(i32::MIN.into(), i32::MAX.into()) as i32;
        let tile = |v: f64| index(frame.pixel_of(v), TILE_PIXELS);
        [tile(at.x), tile(at.y), index(frame.quantum_floor(at.z), PAGE_QUANTA)]
    }

    /// Before a frame: counts what is there, and loads what is not if that is wished.
    fn prepare(&mut self, ahead: &Ahead) -> Result<(), Failure> {
        let region = Region { min: self.key(ahead.low), max: self.key(ahead.high) };
        if self.prefetch {
            let [tx, ty, layer] = self.key(ahead.feet);
            let report = self.store.load(&region, PageKey { tx, ty, layer })?;
            self.hits += report.already as u64;
            self.note(report.loaded, report.evicted);
            return Ok(());
        }
        for tx in region.min[0]..=region.max[0] {
            for ty in region.min[1]..=region.max[1] {
                let slots = self.store.column(tx, ty).iter();
                let inside = slots.filter(|slot| (region.min[2]..=region.max[2]).contains(&slot.layer()));
                self.hits += inside.filter(|slot| slot.page().is_some()).count() as u64;
            }
        }
        Ok(())
    }

    /// Loads what a frame missed; `false` if there is no room.
    fn fetch(&mut self, missing: &Missing, ahead: &Ahead) -> Result<bool, Failure> {
        let [tx, ty, layer] = self.key(ahead.feet);
        let report = self.store.load_missing(missing.keys(), PageKey { tx, ty, layer })?;
        self.note(report.loaded, report.evicted);
        Ok(report.loaded > 0)
    }

    fn note(&mut self, loaded: usize, evicted: usize) {
        self.loaded += loaded as u64;
        self.evicted += evicted as u64;
        self.peak = self.peak.max(self.store.weight_bytes());
    }
}

#[derive(Default)]
struct Counters {
    reads: AtomicU64,
    bytes: AtomicU64,
}

/// A file that counts what is read of it.
struct Counting {
    file: FileSource,
    counters: Arc<Counters>,
}

impl ByteSource for Counting {
    fn len(&self) -> u64 {
        self.file.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> slicewalk::Result<()> {
        self.counters.reads.fetch_add(1, Ordering::Relaxed);
        self.counters.bytes.fetch_add(buf.len() as u64, Ordering::Relaxed);
        self.file.read_at(offset, buf)
    }
}
