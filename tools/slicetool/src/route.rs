//! `slicetool route`: finds the shortest route of a pawn between two places.

use crate::blocked::{self, blocked};
use crate::edits::Link;
use crate::ground::{Loader, Walks, end_json, tidy};
use crate::links::{Joined, Way};
use crate::reach::geojson;
use crate::{Failure, Outcome, Quiet};
use nalgebra::Point3;
use slicewalk::archive::Archive;
use slicewalk::query::Answer;
use slicewalk::reach::{Coarse, Obstruction, Planned, Planner, Refusal, Route, RouteRefiner};
use slicewalk::store::Snapshot;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

/// Distance of the ends above which routes are planned on overview levels first (m).
const NEAR_M: f64 = 40.0;
/// Distance of the ends above which the route along a coarse one is the answer, however long it is, unless only few
/// pixels could hold a shorter route (m).
const FAR_M: f64 = 150.0;
const FEW_PIXELS: f64 = 5e5;
/// Bound of the length of all other routes, as a multiple of the shortest.
const WITHIN: f64 = 1.05;
/// Largest pixels of a level used for planning (m).
const COARSEST_M: f64 = 4.0;
/// Distance from a coarse route to the edge of the corridor around it (pixels of its level).
const BESIDE: f64 = 3.0;
/// A doubtful coarse route is searched again on a finer level, over at most this many spans.
const MOST_SPANS: usize = 1 << 20;

/// Options of `slicetool route`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Start of the route (m); in the air, the floor below counts
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    from: Point3<f64>,
    /// End of the route (m); in the air, the floor below counts
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    to: Point3<f64>,
    #[command(flatten)]
    walks: Walks,
    /// Use only the overview levels (`sliceconv --levels on`): immediate over any distance, but approximate
    #[arg(long)]
    coarse: bool,
    /// File to write: x,y,z (with --length also the heading, degrees clockwise from +y) of the places to reach in turn,
    /// which `walk --waypoints` takes, or with .geojson a line, or the place where the best way stops, in the coordinates
    /// of the scan. `-` writes CSV to standard output
    #[arg(short, long, value_name = "ROUTE")]
    output: Option<PathBuf>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

/// Finds the route; without `--output` and `--json` the route is the result.
pub fn run(arguments: &Arguments) -> Outcome {
    crate::standard::refuse_two("-o", arguments.output.as_deref(), arguments.json)?;
    let started = Instant::now();
    let is_long = arguments.walks.length()?.is_some() && !arguments.coarse;
    if arguments.coarse
        && let Some(option) = arguments.walks.unknown_to_levels()
    {
        let text = format!("--coarse: the overview levels do not know --{option}; leave out one of them");
        return Err(Failure::Usage(text));
    }
    if arguments.coarse && arguments.walks.has_length() {
        let text = "--coarse: the overview levels do not have headings; leave out --coarse or --length";
        return Err(Failure::Usage(text.into()));
    }
    let archive = arguments.walks.open(&arguments.archive)?;
    let edits = arguments.walks.edits().path();
    let output =
        arguments.output.as_deref().map(|output| crate::output(output, &archive, edits.as_slice())).transpose()?;
    let is_geojson = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("geojson"));
    let crs = match arguments.output.as_ref().filter(|path| is_geojson(path)) {
        Some(_) => Some(archive.crs().map_err(|error| crate::broken(&arguments.archive, &error))?),
        None => None,
    };
    let mut bytes = 0;
    let mut ends = [(arguments.from, 0.0), (arguments.to, 0.0)];
    let mut stop = None;
    let links = arguments.walks.edits().read()?.map(|file| file.links).unwrap_or_default();
    let on_foot = |found: Found| found.map(Way::on_foot);
    let (found, guess) = if !links.is_empty() {
        if arguments.coarse {
            let text = "--coarse: the overview levels do not have the links of --edits; leave out one of them";
            return Err(Failure::Usage(text.into()));
        }
        (by_links(arguments, archive, &links, &mut ends, &mut stop, &mut bytes)?, None)
    } else if arguments.coarse {
        match on_levels(arguments, archive, &mut ends, &mut bytes)? {
            Ok(guess) => (on_foot(Ok(guess.route)), Some((guess.level, guess.doubt_m))),
            Err(refusal) => (Err(refusal), None),
        }
    } else {
        (on_foot(find(arguments, archive, &mut ends, &mut stop, &mut bytes)?), None)
    };
    let seconds = started.elapsed().as_secs_f64();
    // Readers of routes of a profile expect its columns, and no place twice.
    let has_headings = is_long && arguments.walks.has_length();
    let mut rows = String::from(if has_headings { "x,y,z,heading\n" } else { "x,y,z\n" });
    let mut last = None;
    for (number, point) in found.iter().flat_map(|route| route.points.iter().enumerate()) {
        let heading = found.as_ref().ok().and_then(|route| route.headings.get(number));
        let is_turn = heading.is_some() && last.replace(point) == Some(point);
        // Not rounded, because a gate may be exactly as wide as the pawn.
        match heading.filter(|_| has_headings) {
            Some(heading) => writeln!(rows, "{},{},{:.4},{heading:.1}", point.x, point.y, point.z)?,
            None if is_turn => {}
            None => writeln!(rows, "{},{},{:.4}", point.x, point.y, point.z)?,
        }
    }
    if let Some(mut output) = output {
        let features = match (&found, &stop) {
            (Ok(way), _) => vec![geojson::way_feature(way)],
            (Err(_), stop) => stop.iter().map(geojson::blocked_feature).collect(),
        };
        let text = crs.map_or(rows.clone(), |crs| format!("{}\n", geojson::collection(&crs, features)));
        output.write_at(0, text.as_bytes())?;
        output.publish()?;
    }
    if arguments.json {
        let mut summary = serde_json::json!({
            "found": found.is_ok(),
            "length_m": found.as_ref().ok().map(|route| route.length_m),
            "reason": found.as_ref().err().map(|refusal| refusal.name()),
            "blocked": stop.as_ref().map(blocked::to_json),
            "from": end_json(ends[0].0, ends[0].1),
            "to": end_json(ends[1].0, ends[1].1),
            "way_s": found.as_ref().ok().map(|way| tidy(way.seconds)),
            "links": found.as_ref().map(|way| &way.links[..]).unwrap_or_default(),
            "level": guess.map(|guess| guess.0),
            "doubt_m": guess.map(|guess| guess.1),
            "memory_bytes": bytes,
            "seconds": seconds,
        });
        if is_long {
            summary["turned_deg"] = found.as_ref().ok().map(|way| tidy(way.turned_deg())).into();
        }
        return Ok(format!("{summary:#}\n"));
    }
    match &found {
        Ok(route) => {
            let about = guess.map_or(String::new(), |(level, doubt_m)| match doubt_m {
                0.0 => format!("about, on overview level {level}: "),
                doubt_m => format!("about, on overview level {level}, with {doubt_m:.1} m in doubt: "),
            });
            let by = if route.links.is_empty() { String::new() } else { format!(" and {}", route.links.join(", ")) };
            let turns = if is_long { format!(", with turns of {:.0}°", route.turned_deg()) } else { String::new() };
            crate::say(&format!("{about}{:.2} m over {} places{by}{turns}", route.length_m, route.points.len()));
            for (name, (feet, moved)) in ["start", "end"].into_iter().zip(ends).filter(|end| end.1.1 > 0.0) {
                crate::say(&format!("{name} moved by {moved:.2} m to {:.2},{:.2},{:.2}", feet.x, feet.y, feet.z));
            }
        }
        Err(refusal) => {
            let why = match refusal {
                Refusal::NotStandingFrom => {
                    format!("the pawn cannot stand at --from ({})", arguments.walks.nowhere_near())
                }
                Refusal::NotStandingTo => {
                    format!("the pawn cannot stand at --to ({})", arguments.walks.nowhere_near())
                }
                Refusal::NotConnected => match stop {
                    Some(stop) => blocked::text(&stop),
                    None => "no way leads there for this pawn; try a lower --pawn or a higher --climb".to_owned(),
                },
                other => other.name().to_owned(),
            };
            crate::say(&format!("no route: {why}"));
        }
    }
    Ok(if arguments.output.is_some() { String::new() } else { rows })
}

/// A route, or the reason for a refusal.
type Found = Result<Route, Refusal>;

/// Start and end, each with the distance that it was moved (m).
type Ends = [(Point3<f64>, f64); 2];

/// Finds the route in the archive itself: along a coarse route if that is known to be good enough, otherwise near the
/// straight line first and then farther out. Moves `ends` to standing places and records by how much (m), and where the
/// best way stops if none connects them.
fn find(
    arguments: &Arguments,
    archive: Archive,
    ends: &mut Ends,
    stop: &mut Option<Obstruction>,
    bytes: &mut usize,
) -> Result<Found, Failure> {
    let loader = arguments.walks.loader(archive, &arguments.archive)?;
    let pawn = arguments.walks.pawn();
    if let Err(refusal) = stand(arguments, &loader, ends)? {
        return Ok(Err(refusal));
    }
    let (ends, length) = (ends.map(|end| end.0), arguments.walks.length()?);
    let straight = (ends[1] - ends[0]).xy().norm();
    // Overview levels do not say what was seen.
    // Overview levels have no headings, either.
    let known = match straight > NEAR_M && loader.seen().is_none() && length.is_none() {
        true => match coarse(arguments, loader.archive(), ends, bytes)? {
            Ok(guess) => refined(arguments, &loader, ends, guess, bytes)?,
            Err(_) => None,
        },
        false => None,
    };
    let mut planner =
        Planner::new(&loader.snapshot(), pawn, ends[0], ends[1])?.within_seen(loader.seen().cloned()).drawn_out(length);
    let known = match known {
        Some(route) => {
            // Only a route this short would be better by more than the bound.
            let shorter = route.length_m / WITHIN;
            let pixels = ellipse_m2(straight, shorter) / loader.archive().frame().pixel_m().powi(2);
            if pixels == 0.0 || straight > FAR_M && pixels > FEW_PIXELS {
                return Ok(Ok(route));
            }
            planner = planner.within(shorter);
            Some(route)
        }
        None => None,
    };
    let found = loader.known(|view| planned(&mut planner, view))?;
    *bytes = (*bytes).max(loader.memory_bytes() + planner.peak_bytes());
    if found.is_err() && known.is_none() {
        *stop = blocked(&loader, &pawn, length, ends)?;
    }
    Ok(match (found, known) {
        (Ok(found), Some(known)) if known.length_m < found.length_m => Ok(known),
        (Err(_), Some(known)) => Ok(known),
        (found, _) => found,
    })
}

/// Finds the way of least time over links. Moves `ends` like [`find`].
fn by_links(
    arguments: &Arguments,
    archive: Archive,
    links: &[Link],
    ends: &mut Ends,
    stop: &mut Option<Obstruction>,
    bytes: &mut usize,
) -> Result<Result<Way, Refusal>, Failure> {
    let loader = arguments.walks.loader(archive, &arguments.archive)?;
    let pawn = arguments.walks.pawn();
    let mut standing = loader.standing(pawn)?;
    let mut snapped = Vec::new();
    for (end, refusal) in ends.iter_mut().zip([Refusal::NotStandingFrom, Refusal::NotStandingTo]) {
        let Some(found) = arguments.walks.snapped(&loader, &mut standing, end.0)? else { return Ok(Err(refusal)) };
        *end = (found.feet, found.moved);
        snapped.push(found);
    }
    let joined = Joined::from(&loader, &arguments.walks, &mut standing, &snapped[0], links)?;
    let way = joined.way(&loader, [&snapped[0], &snapped[1]], links)?;
    *bytes = loader.memory_bytes() + joined.memory_bytes() + standing.memory_bytes();
    match way {
        Some(way) => Ok(Ok(way)),
        None => {
            *stop = blocked(&loader, &pawn, arguments.walks.length()?, ends.map(|end| end.0))?;
            Ok(Err(Refusal::NotConnected))
        }
    }
}

/// Moves the ends to standing places and records by how much (m).
fn stand(arguments: &Arguments, loader: &Loader, ends: &mut Ends) -> Result<Result<(), Refusal>, Failure> {
    let mut standing = loader.standing(arguments.walks.pawn())?;
    for (end, refusal) in ends.iter_mut().zip([Refusal::NotStandingFrom, Refusal::NotStandingTo]) {
        match arguments.walks.snapped(loader, &mut standing, end.0)? {
            Some(snapped) => *end = (snapped.feet, snapped.moved),
            None => return Ok(Err(refusal)),
        }
    }
    Ok(Ok(()))
}

/// Area that routes of this `length` can cover between two places that are `straight` apart (m²).
fn ellipse_m2(straight: f64, length: f64) -> f64 {
    std::f64::consts::PI / 4.0 * length * (length.powi(2) - straight.powi(2)).max(0.0).sqrt()
}

fn planned(planner: &mut Planner, view: &Snapshot) -> slicewalk::Result<Answer<Found>> {
    loop {
        match planner.advance(view, usize::MAX, &Quiet)? {
            Planned::Done(found) => return Ok(Answer::Known(found)),
            Planned::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
            _ => {}
        }
    }
}

/// A route on an overview level.
struct Guess {
    level: u32,
    route: Route,
    doubt_m: f64,
}

/// Loads pages of a level.
fn on_level(arguments: &Arguments, archive: &Archive, number: u32) -> Result<Loader, Failure> {
    let level = archive.level(number).map_err(|error| crate::broken(&arguments.archive, &error))?;
    Loader::new(level, &arguments.archive, arguments.walks.cache())
}

/// Finds a route on the overview levels only, between standing places of the archive.
fn on_levels(
    arguments: &Arguments,
    archive: Archive,
    ends: &mut Ends,
    bytes: &mut usize,
) -> Result<Result<Guess, Refusal>, Failure> {
    if arguments.walks.needs_seen() {
        let text = "--coarse: overview levels do not say what was seen; leave out --coarse or --seen";
        return Err(Failure::Usage(text.into()));
    }
    if archive.levels().map_err(|error| crate::broken(&arguments.archive, &error))?.is_empty() {
        let path = arguments.archive.display();
        let reason = match archive.header().levels {
            Some(_) => "it is too small for overview levels; leave out --coarse",
            None => "it has no overview levels; convert with --levels on, or leave out --coarse",
        };
        return Err(Failure::Text(format!("{path}: {reason}")));
    }
    let loader = Loader::new(archive, &arguments.archive, arguments.walks.cache())?;
    let standing = stand(arguments, &loader, ends)?;
    *bytes = loader.memory_bytes();
    match standing {
        Ok(()) => coarse(arguments, loader.archive(), ends.map(|end| end.0), bytes),
        Err(refusal) => Ok(Err(refusal)),
    }
}

/// Returns the route on the coarsest level without doubt, otherwise that on the finest level that has one. A fine level
/// can also rule out any route.
fn coarse(
    arguments: &Arguments,
    archive: &Archive,
    [from, to]: [Point3<f64>; 2],
    bytes: &mut usize,
) -> Result<Result<Guess, Refusal>, Failure> {
    let broken = |error| crate::broken(&arguments.archive, &error);
    let mut best = Err(Refusal::NotConnected);
    for level in archive.levels().map_err(broken)?.iter().rev() {
        // On coarser levels, a body is less than a few pixels wide where doors matter, and a level of one page shows no
        // routes.
        if level.frame().pixel_m() > COARSEST_M {
            continue;
        }
        let on_level = on_level(arguments, archive, level.number())?;
        let mut planner = Coarse::new(&on_level.snapshot(), arguments.walks.pawn(), from, to)?;
        let most = if best.is_ok() { MOST_SPANS } else { usize::MAX };
        let found = on_level.known(|view| guessed(&mut planner, view, most))?;
        *bytes = (*bytes).max(on_level.memory_bytes() + planner.memory_bytes());
        match found {
            Some(Ok(route)) => {
                let doubt_m = planner.doubt_m();
                best = Ok(Guess { level: level.number(), route, doubt_m });
                if doubt_m == 0.0 {
                    break;
                }
            }
            Some(Err(refusal)) if planner.is_fine() => {
                best = Err(refusal);
                break;
            }
            Some(Err(refusal)) if best.is_err() => best = Err(refusal),
            _ => {}
        }
    }
    Ok(best)
}

/// Result of a planner on a level; `None` if it looks at more than `most` spans.
fn guessed(planner: &mut Coarse, view: &Snapshot, most: usize) -> slicewalk::Result<Answer<Option<Found>>> {
    Ok(match planner.advance(view, most.saturating_sub(planner.looked_at()), &Quiet)? {
        Planned::Done(found) => Answer::Known(Some(found)),
        Planned::NotLoaded(missing) => Answer::NotLoaded(missing),
        _ => Answer::Known(None),
    })
}

/// Refines a coarse route level by level to an exact one; `None` if no corridor connects.
fn refined(
    arguments: &Arguments,
    loader: &Loader,
    [from, to]: [Point3<f64>; 2],
    guess: Guess,
    bytes: &mut usize,
) -> Result<Option<Route>, Failure> {
    let pawn = arguments.walks.pawn();
    let fine = *loader.archive().frame();
    let beside = |level: u32| BESIDE * fine.pixel_m() * f64::from(4u32.pow(level));
    let mut guide = guess;
    for level in (1..guide.level).rev() {
        let on_level = on_level(arguments, loader.archive(), level)?;
        let mut best: Option<Guess> = None;
        // A coarser level hides obstacles: where the finest level shows one, the route may lead around it, anywhere.
        for is_near in [true, false].into_iter().take(if level == 1 { 2 } else { 1 }) {
            let mut planner = Coarse::new(&on_level.snapshot(), pawn, from, to)?;
            if is_near {
                planner = planner.near(&guide.route, beside(guide.level));
            }
            let found = on_level.known(|view| guessed(&mut planner, view, MOST_SPANS))?;
            *bytes = (*bytes).max(on_level.memory_bytes() + planner.memory_bytes());
            let doubt_m = planner.doubt_m();
            if let Some(Ok(route)) = found
                && best.as_ref().is_none_or(|best| doubt_m < best.doubt_m)
            {
                best = Some(Guess { level, route, doubt_m });
            }
            if best.as_ref().is_some_and(|best| best.doubt_m == 0.0) {
                break;
            }
        }
        guide = best.unwrap_or(guide);
    }
    let mut along = RouteRefiner::new(pawn, from, to, &guide.route, beside(guide.level));
    let found = loader.known(|view| along.advance(view, &Quiet))?;
    *bytes = (*bytes).max(loader.memory_bytes() + along.peak_bytes());
    Ok(found.ok())
}
