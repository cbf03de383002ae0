//! `slicetool walk`: a pawn follows waypoints; writes its path as CSV and its cost as JSON.

use crate::ground::{Loader, Profile, Snap, end_json};
use crate::{Failure, Outcome, cache_too_small};
use clap::ValueEnum;
use nalgebra::{Point2, Point3};
use slicewalk::reach::{Pawn, StandingPlaces};
use slicewalk::store::{MotionHint, Prefetch, Stream, StreamOptions};
use slicewalk::walk::{Body, Config, Grade, Response, State, Stop, Walker, Waypoints};
use slicewalk_base::text::finite_number;
use slicewalk_convert::size::parse_size;
use std::collections::HashSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest time that a pawn may stay blocked before the walk ends (s).
const BLOCKED_S: f64 = 2.0;

/// Longest way between two places that a limited grade sees, as long as a tick allows (m).
const LOOK_M: f64 = 0.025;

/// How often a tick may miss pages that were loaded for it: prefetching may evict them before the pawn asks again.
const ATTEMPTS: usize = 64;

/// Options of `slicetool walk`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Start of the feet (m); in the air, the pawn falls
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    start: Point3<f64>,
    /// Places to reach in turn: columns x,y or x,y,z (a header is optional). z counts only in the last row, where it
    /// selects the floor of --snap. `-` reads standard input
    #[arg(long, value_name = "W.csv")]
    waypoints: PathBuf,
    /// Whose pawn and steps count: those of foot are box:0.5x0.5x1.8 and 0.35 m; of a wheelchair cylinder:0.4x1.4 and
    /// 0.02 m; of a stroller cylinder:0.3x1.2 and 0.08 m
    #[arg(long, value_enum, default_value_t = Profile::Foot)]
    profile: Profile,
    /// The pawn: box:WIDTHxDEPTHxHEIGHT or cylinder:RADIUSxHEIGHT (m) [default: of the profile]
    #[arg(long, value_name = "SHAPE")]
    pawn: Option<Body>,
    /// Walking speed (m/s)
    #[arg(long, default_value_t = 1.4, value_name = "M/S", allow_negative_numbers = true, value_parser = finite_number)]
    speed: f64,
    /// Highest step the pawn climbs (m) [default: of the profile]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = finite_number)]
    climb: Option<f64>,
    /// Stop where the way rises or falls by more than this over a metre (percent) [default: of the profile]
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true, value_parser = crate::ground::above_zero)]
    max_grade: Option<f64>,
    /// Stop before ledges deeper than this and before the edge of the scan (m); by default and with --response thesis,
    /// the pawn falls
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, value_parser = finite_number)]
    max_drop: Option<f64>,
    /// Frames per second
    #[arg(long, default_value_t = 60.0, value_name = "HZ", value_parser = rate)]
    hz: f64,
    #[command(flatten)]
    variant: crate::Variant,
    #[command(flatten)]
    snap: Snap,
    /// Memory for pages
    #[arg(long, default_value = "64MiB", value_name = "SIZE", value_parser = parse_size)]
    cache: u64,
    /// Load pages ahead of the pawn, or only when it misses them
    #[arg(long, value_enum, default_value_t = Switch::On)]
    prefetch: Switch,
    /// Response to obstacles: exact sweeps, or the steps of the thesis
    #[arg(long, value_enum, default_value_t = Rule::Slide)]
    response: Rule,
    /// End after this many seconds
    #[arg(long, default_value_t = 300.0, value_name = "S", value_parser = seconds)]
    max_seconds: f64,
    /// File to write: t,x,y,z,state,frame_us,missing. `-` is standard output
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

/// Parses three numbers separated by commas.
pub fn point(text: &str) -> Result<Point3<f64>, String> {
    numbers::<3>(text, ',').map(Point3::from).ok_or_else(|| "expected three numbers X,Y,Z".into())
}

fn rate(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| (0.1..=1e5).contains(v));
    value.ok_or_else(|| "expected frames per second from 0.1 to 100000".into())
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| *v > 0.0 && *v <= 1e6);
    value.ok_or_else(|| "expected seconds above 0, at most 1000000".into())
}

impl Arguments {
    fn pawn(&self) -> Pawn {
        let profile = self.profile.pawn();
        let climb = self.climb.unwrap_or(profile.climb);
        Pawn {
            body: self.pawn.unwrap_or(profile.body),
            climb,
            max_drop: self.max_drop.unwrap_or(climb),
            max_grade: self.max_grade.map_or(profile.max_grade, |percent| percent / 100.0),
            ..profile
        }
    }
}

/// Walks; the path appears complete or not at all.
pub fn run(arguments: &Arguments) -> Outcome {
    crate::standard::refuse_two("-o", Some(&arguments.output), arguments.json)?;
    let pawn = arguments.pawn();
    let config = Config {
        speed: arguments.speed,
        climb: pawn.climb,
        max_drop: arguments.max_drop,
        response: match arguments.response {
            Rule::Slide => Response::Slide,
            Rule::Thesis => Response::Thesis,
        },
        ..Config::new(pawn.body)
    };
    // Check the options before reading files.
    Walker::new(config, arguments.start)?;
    let (mut places, z) = waypoints(&arguments.waypoints)?;
    let (start, moved, goal) = ends(arguments, places[places.len() - 1], z)?;
    places.pop();
    places.push(goal.place);
    let mut walker = Walker::new(config, start)?;
    let mut route = Waypoints::new(places)?;
    let stream = stream(arguments)?;
    let mut output = crate::output(&arguments.output, stream.archive(), &protected(arguments))?;
    let frame_s = 1.0 / arguments.hz;
    let most = (arguments.max_seconds * arguments.hz).ceil().max(1.0) as u64;
    let mut path = String::from("t,x,y,z,state,frame_us,missing\n");
    let (mut times, mut hits, mut late) = (Vec::new(), 0, 0);
    let (mut distance, mut blocked, mut stop) = (0.0, 0.0, None);
    let mut grade = Grade::new(pawn.max_grade, start);
    // The grade counts over a metre of the way, however far the pawn gets in a frame.
    let steps = if pawn.max_grade.is_finite() { (frame_s * arguments.speed / LOOK_M).ceil().max(1.0) } else { 1.0 };
    let mut pawn = stream.pawn();
    for frame in 1..=most {
        crate::go_on()?;
        if arguments.prefetch == Switch::On {
            let motion_hint = walker.motion_hint(stream.archive().frame());
            pawn.hint(&motion_hint);
            prepare(&stream, &motion_hint, frame, frame_s)?;
        }
        hits += stream.count_loaded(&walker.motion_hint(stream.archive().frame()));
        let before = walker.feet();
        let started = Instant::now();
        let (mut missing, mut hit) = (0, None);
        for _ in 0..steps as u64 {
            let (more, stopped) = step(&stream, &mut walker, &mut route, frame_s / steps, arguments.cache)?;
            (missing, hit) = (missing + more, stopped.or(hit));
            if walker.state() == State::Arrived || grade.exceeds(walker.feet(), walker.state()) {
                break;
            }
        }
        let frame_us = started.elapsed().as_secs_f64() * 1e6;
        late += missing;
        times.push(frame_us);
        distance += (walker.feet() - before).norm();
        let (feet, state) = (walker.feet(), walker.state());
        let t = frame as f64 * frame_s;
        writeln!(path, "{t:.6},{:.6},{:.6},{:.6},{},{frame_us:.1},{missing}", feet.x, feet.y, feet.z, state.name())?;
        (blocked, stop) = if state == State::Blocked { (blocked + frame_s, hit.or(stop)) } else { (0.0, None) };
        if walker.is_lost(&stream.snapshot()) {
            stop = Some(Stop::Void);
            break;
        }
        if state == State::Arrived || blocked >= BLOCKED_S - 1e-9 || grade.is_exceeded() {
            break;
        }
    }
    for failed in stream.take_errors() {
        // The pawn did not need this page, or the walk would have ended.
        crate::say(&format!("warning: page {}: {}", failed.key, failed.error));
    }
    output.write_at(0, path.as_bytes())?;
    output.publish()?;
    let (frames, feet) = (times.len(), walker.feet());
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[((frames - 1) as f64 * share).round() as usize];
    let state = if grade.is_exceeded() { State::Blocked } else { walker.state() };
    stop = if grade.is_exceeded() { Some(Stop::Steep) } else { stop };
    let name = state.name();
    let [x, y, z] = feet.into();
    let end = format!("({x:.3}, {y:.3}, {z:.3}) after {:.2} s and {distance:.2} m", frames as f64 * frame_s);
    let (next, places) = (route.next(), route.places().len());
    if state == State::Blocked {
        crate::say(&format!(
            "{}: blocked at {end}, before waypoint {} of {places}: {}; `{}` has the path up to there",
            arguments.archive.display(),
            next + 1,
            in_the_way(stop),
            arguments.output.display()
        ));
    } else if stop == Some(Stop::Void) {
        crate::say(&format!(
            "{}: fell out of the scan, at {end}, before waypoint {} of {places}: nothing lies below; give --max-drop, or \
             waypoints around it",
            arguments.archive.display(),
            next + 1
        ));
    } else if !arguments.json {
        if moved > 0.0 {
            let [x, y, z] = start.into();
            crate::say(&format!("start moved by {moved:.2} m to {x:.2},{y:.2},{z:.2}, where the pawn can stand"));
        }
        if goal.moved > 0.0 {
            let ([x, y], moved): ([f64; 2], f64) = (goal.place.into(), goal.moved);
            crate::say(&format!("last waypoint moved by {moved:.2} m to {x:.2},{y:.2}, where the pawn can stand"));
        }
        crate::say(&format!("{name} at {end}; waypoint {next} of {places}; {late} pages late"));
    }
    let counters = stream.counters();
    let summary = serde_json::json!({
        "frames": frames,
        "seconds": frames as f64 * frame_s,
        "distance": distance,
        "state": name,
        "stop": stop.map(Stop::name),
        "end": [x, y, z],
        "from": end_json(start, moved),
        "to": goal.json(feet.z),
        "waypoints_reached": next,
        "frame_us": { "p50": at(0.5), "p99": at(0.99), "p99.9": at(0.999), "max": at(1.0) },
        "reads": counters.reads,
        "bytes": counters.read_bytes,
        "hits": hits,
        "late": late,
        "loaded": counters.loaded,
        "evicted": counters.evicted,
        "failed": counters.failed,
        "cache_peak": counters.peak_bytes,
        "cache": counters.budget_bytes,
    });
    let result = if arguments.json { format!("{summary:#}\n") } else { String::new() };
    if state == State::Blocked { Err(Failure::Result(result)) } else { Ok(result) }
}

/// Files that the path must not replace.
fn protected(arguments: &Arguments) -> Vec<&Path> {
    arguments.variant.edits().path().into_iter().chain([arguments.waypoints.as_path()]).collect()
}

/// The last waypoint.
struct Goal {
    place: Point2<f64>,
    /// Distance by which it was moved (m).
    moved: f64,
    /// Heights at which the pawn can stand there, otherwise the requested one (m).
    heights: Vec<f64>,
}

impl Goal {
    /// Returns the JSON of the waypoint, on the floor nearest to `z` (m).
    fn json(&self, z: f64) -> serde_json::Value {
        let height = self.heights.iter().copied().min_by(|a, b| (a - z).abs().total_cmp(&(b - z).abs()));
        let mut json = end_json(Point3::new(self.place.x, self.place.y, height.unwrap_or_default()), self.moved);
        if height.is_none() {
            json["z"] = serde_json::Value::Null;
        }
        json
    }
}

/// Returns where the pawn starts, how far it was moved there (m), and the last waypoint: if the pawn cannot stand at
/// either, that one is moved to the nearest place within `--snap` where it can.
fn ends(arguments: &Arguments, last: Point2<f64>, z: Option<f64>) -> Result<(Point3<f64>, f64, Goal), Failure> {
    let mut goal = Goal { place: last, moved: 0.0, heights: z.into_iter().collect() };
    let (asked, snap) = (arguments.start, arguments.snap.metres);
    if snap == 0.0 {
        return Ok((asked, 0.0, goal));
    }
    let pawn = arguments.pawn();
    let archive = arguments.variant.open_for_pawns(&arguments.archive)?;
    let loader = Loader::new(archive, &arguments.archive, arguments.cache)?;
    // A scan or a pawn may be too large for standing places: then both ends stay. If a search does not fit in memory, that
    // end stays; the walk itself reports how much it needs.
    let Ok(mut standing) = StandingPlaces::new(&loader.snapshot(), pawn) else { return Ok((asked, 0.0, goal)) };
    let found = loader.known(|view| standing.snapped(view, asked, snap)).ok().flatten();
    let (start, moved) =
        found.filter(|found| found.moved > 0.0).map_or((asked, 0.0), |found| (found.feet, found.moved));
    let found = match z {
        Some(z) => {
            let at = Point3::new(last.x, last.y, z);
            loader.known(|view| standing.snapped(view, at, snap)).ok().flatten().into_iter().collect()
        }
        // Any floor will do: the floor that the waypoint means is known when the pawn gets there.
        None => loader.known(|view| standing.snapped_over(view, last, snap)).unwrap_or_default(),
    };
    if let Some(first) = found.first() {
        let place = if first.moved > 0.0 { first.feet.xy() } else { last };
        goal = Goal { place, moved: first.moved, heights: found.iter().map(|found| found.feet.z).collect() };
    }
    Ok((start, moved, goal))
}

/// Describes why a pawn is blocked, and what to do.
fn in_the_way(stop: Option<Stop>) -> &'static str {
    match stop {
        Some(Stop::Wall) => "a wall; add waypoints around it, or change --climb or --pawn",
        Some(Stop::Steep) => "the ground is too steep; add waypoints around it",
        Some(Stop::Headroom) => "a step without headroom; add waypoints around it, or give a lower --pawn",
        Some(Stop::Corner) => "a corner; add waypoints around it, or give a smaller --pawn",
        Some(Stop::Inside) => "the pawn is inside solid; give another --start or a smaller --pawn",
        Some(Stop::Ledge) => "a drop deeper than --max-drop; add waypoints around it, or raise --max-drop",
        Some(Stop::Void) => "nothing was scanned ahead; add waypoints around it, or leave out --max-drop",
        None => "no progress for a second; add waypoints",
    }
}

fn stream(arguments: &Arguments) -> Result<Stream, Failure> {
    let archive = arguments.variant.open_for_pawns(&arguments.archive)?;
    let prefetch = if arguments.prefetch == Switch::On { Prefetch::Thread } else { Prefetch::Off };
    let budget = usize::try_from(arguments.cache).unwrap_or(usize::MAX);
    Ok(Stream::open(archive, StreamOptions { prefetch, ..StreamOptions::new(budget) })?)
}

/// Gives the prefetcher the time until the frame begins. Returns early once the prefetcher has nothing to do, because
/// no page would come in by waiting. So a walk takes less time than it reports, with the same misses.
fn prepare(stream: &Stream, motion_hint: &MotionHint, frame: u64, frame_s: f64) -> Result<(), Failure> {
    if frame == 1 {
        // A program loads the pages around the pawn before it shows the first frame.
        stream.load_around(motion_hint)?;
    }
    stream.settle(Duration::from_secs_f64(frame_s));
    Ok(())
}

/// Advances a frame or a part of it; returns how many needed pages were not in memory, and what blocked the pawn. Missing
/// pages are loaded at once and stay until they have been used.
fn step(
    stream: &Stream,
    walker: &mut Walker,
    route: &mut Waypoints,
    frame_s: f64,
    cache: u64,
) -> Result<(usize, Option<Stop>), Failure> {
    let (mut dt, mut late, mut stop) = (frame_s, 0, None);
    // The pages in order, and the same ones to look them up.
    let (mut needed, mut known, mut attempts) = (Vec::new(), HashSet::new(), 0);
    loop {
        let report = walker.follow(&stream.snapshot(), dt, route);
        stop = report.stop.or(stop);
        // Also left over if a frame is longer than the library's longest step.
        dt = report.unspent;
        if report.ticks > 0 {
            attempts = 0;
            needed.clear();
            known.clear();
        }
        let Some(missing) = report.missing else {
            if dt > 0.0 {
                continue;
            }
            return Ok((late, stop));
        };
        // An answer names some of the pages that it misses, so the next one may name others.
        let before = needed.len();
        needed.extend(missing.keys().iter().copied().filter(|key| known.insert(*key)));
        late += needed.len() - before;
        attempts += usize::from(needed.len() == before);
        let loaded = stream.load(&needed, needed[0])?;
        if loaded.left_out > 0 || attempts > ATTEMPTS {
            let around = stream.load_around(&walker.motion_hint(stream.archive().frame()))?;
            return Err(cache_too_small("one step", cache, loaded.needed_bytes.max(around.needed_bytes)));
        }
    }
}

/// Reads columns x,y and the last row's z, if there is one: by name if there is a header, otherwise the first three.
fn waypoints(path: &Path) -> Result<(Vec<Point2<f64>>, Option<f64>), Failure> {
    let (table, name) = crate::standard::table(path)?;
    let failed = |at: String, reason: String| Failure::Text(format!("{name}: {at}: {reason}"));
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(table);
    let (mut places, mut last_z, mut columns) = (Vec::new(), None, None);
    for row in reader.records() {
        let row = row.map_err(|e| failed("cannot read".into(), e.to_string()))?;
        let line = format!("line {}", row.position().map_or(0, |position| position.line()));
        let named = columns.is_none() && row.iter().any(|field| field.parse::<f64>().is_err());
        let ([x, y], z) = *columns.get_or_insert(([0, 1], Some(2)));
        if named {
            let find = |name: &str| row.iter().position(|field| field.eq_ignore_ascii_case(name));
            let place =
                |name: &str| find(name).ok_or_else(|| failed(line.clone(), format!("no column {name}; expected x,y")));
            columns = Some(([place("x")?, place("y")?], find("z")));
            continue;
        }
        let number = |at: usize| row.get(at)?.parse::<f64>().ok().filter(|v| v.is_finite());
        let value = |at: usize| {
            let field = row.get(at).unwrap_or_default();
            number(at).ok_or_else(|| failed(line.clone(), format!("{field:?} is not a number")))
        };
        places.push(Point2::new(value(x)?, value(y)?));
        last_z = z.and_then(number);
    }
    if places.is_empty() {
        return Err(failed("line 1".into(), "no waypoint; expected rows of x,y".into()));
    }
    Ok((places, last_z))
}
