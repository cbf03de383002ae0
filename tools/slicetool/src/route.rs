//! `slicetool route`: the shortest way of a pawn between two places.

use crate::ground::{Loader, Walks};
use crate::{Failure, Outcome};
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::query::Answer;
use slicewalk::reach::{Along, Planned, Planner, Refusal, Route};
use slicewalk::store::View;
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

/// Ways between places farther apart are planned on overview levels first (m).
const FAR_M: f64 = 150.0;
/// Largest pixels of a level on which ways are planned (m).
const COARSEST_M: f64 = 4.0;
/// From a coarse way to the edge of the corridor about it (pixels of its level).
const BESIDE: f64 = 3.0;

/// From where to where, and who.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Where the way begins (m); in the air, the floor below counts
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    from: Point3<f64>,
    /// Where the way ends (m), likewise
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    to: Point3<f64>,
    #[command(flatten)]
    walks: Walks,
    /// Answer from the overview levels alone (`sliceconv --levels on`): at once, over any distance, and only about right
    #[arg(long)]
    coarse: bool,
    /// File to write: x,y,z of the places to reach one after the other; `walk --waypoints` takes it. `-` is standard output
    #[arg(short, long, value_name = "ROUTE.csv")]
    output: Option<PathBuf>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

/// Finds the way; without an output and --json it is the result.
pub fn run(arguments: &Arguments) -> Outcome {
    crate::standard::refuse_two(arguments.output.as_deref(), arguments.json)?;
    let started = Instant::now();
    let loader = Loader::open(&arguments.archive, &arguments.walks)?;
    let output = arguments.output.as_deref().map(|output| crate::output(output, loader.archive(), &[])).transpose()?;
    let mut bytes = 0;
    let (found, level) = if arguments.coarse {
        on_levels(arguments, &loader, &mut bytes)?
    } else {
        (find(arguments, &loader, &mut bytes)?, None)
    };
    let seconds = started.elapsed().as_secs_f64();
    let mut rows = String::from("x,y,z\n");
    for point in found.iter().flat_map(|route| &route.points) {
        writeln!(rows, "{:.4},{:.4},{:.4}", point.x, point.y, point.z)?;
    }
    if let Some(mut output) = output {
        output.write_at(0, rows.as_bytes())?;
        output.publish()?;
    }
    if arguments.json {
        let summary = serde_json::json!({
            "found": found.is_ok(),
            "length_m": found.as_ref().ok().map(|route| route.length_m),
            "reason": found.as_ref().err().map(|refusal| refusal.name()),
            "level": level,
            "memory_bytes": bytes.max(loader.memory_bytes()),
            "seconds": seconds,
        });
        return Ok(format!("{summary:#}\n"));
    }
    match &found {
        Ok(route) => {
            let about = level.map_or(String::new(), |level| format!("about, on overview level {level}: "));
            crate::say(&format!("{about}{:.2} m over {} places", route.length_m, route.points.len()));
        }
        Err(refusal) => {
            let why = match refusal {
                Refusal::NotStandingFrom => {
                    "the pawn cannot stand at --from; `slicetool reach` shows where it can".to_owned()
                }
                Refusal::NotStandingTo => {
                    "the pawn cannot stand at --to; `slicetool reach` shows where it can".to_owned()
                }
                Refusal::NotConnected => {
                    "no way leads there for this pawn; try a lower --pawn or a higher --climb".to_owned()
                }
                other => other.name().to_owned(),
            };
            crate::say(&format!("no route: {why}"));
        }
    }
    Ok(if arguments.output.is_some() { String::new() } else { rows })
}

/// A route, or why there is none.
type Found = Result<Route, Refusal>;

/// The way in the archive itself: near the straight line first, and farther if it leads farther; long ways along a coarse one.
fn find(arguments: &Arguments, loader: &Loader, bytes: &mut usize) -> Result<Found, Failure> {
    let (pawn, ends) = (arguments.walks.pawn(), [arguments.from, arguments.to]);
    if (ends[1] - ends[0]).xy().norm() > FAR_M
        && let Some((number, guide)) = coarse(arguments, loader, bytes)?
        && let Some(route) = refined(arguments, loader, number, guide, bytes)?
    {
        return Ok(Ok(route));
    }
    let mut planner = Planner::new(&loader.view(), pawn, ends[0], ends[1])?;
    let found = loader.known(|view| planned(&mut planner, view))?;
    *bytes = (*bytes).max(loader.memory_bytes() + planner.peak_bytes());
    Ok(found)
}

fn planned(planner: &mut Planner, view: &View) -> slicewalk::Result<Answer<Found>> {
    loop {
        match planner.go_on(view, usize::MAX, &NoMonitor)? {
            Planned::Done(found) => return Ok(Answer::Known(found)),
            Planned::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
            _ => {}
        }
    }
}

/// The way on levels alone, with the level that it was found on.
fn on_levels(arguments: &Arguments, loader: &Loader, bytes: &mut usize) -> Result<(Found, Option<u32>), Failure> {
    if loader.archive().levels().map_err(|error| crate::broken(&arguments.archive, &error))?.is_empty() {
        let archive = arguments.archive.display();
        let text = format!("{archive}: it has no overview levels; convert with --levels on, or leave out --coarse");
        return Err(Failure::Text(text));
    }
    Ok(match coarse(arguments, loader, bytes)? {
        Some((number, route)) => (Ok(route), Some(number)),
        None => (Err(Refusal::NotConnected), None),
    })
}

/// The way on the coarsest level that has one, and the level's number; `None` where there are no levels, or no way on them.
fn coarse(arguments: &Arguments, loader: &Loader, bytes: &mut usize) -> Result<Option<(u32, Route)>, Failure> {
    let broken = |error| crate::broken(&arguments.archive, &error);
    for level in loader.archive().levels().map_err(broken)?.iter().rev() {
        // A body is a few pixels wide at least where doors matter; a whole level of one page says nothing of ways.
        if level.frame().pixel_m() > COARSEST_M {
            continue;
        }
        let on_level = loader.level(level.number(), &arguments.walks)?;
        let pawn = arguments.walks.pawn().on_level(level.frame());
        let mut planner = Planner::new(&on_level.view(), pawn, arguments.from, arguments.to)?;
        let found = on_level.known(|view| planned(&mut planner, view))?;
        *bytes = (*bytes).max(on_level.memory_bytes() + planner.peak_bytes());
        if let Ok(route) = found {
            return Ok(Some((level.number(), route)));
        }
    }
    Ok(None)
}

/// The exact way along a coarse one on level `number`, level by level; `None` where no corridor connects.
fn refined(
    arguments: &Arguments,
    loader: &Loader,
    number: u32,
    guide: Route,
    bytes: &mut usize,
) -> Result<Option<Route>, Failure> {
    let pawn = arguments.walks.pawn();
    let fine = *loader.archive().frame();
    let pixel = |number: u32| fine.pixel_m() * f64::from(4u32.pow(number));
    let (mut guide, mut of) = (guide, number);
    for number in (1..number).rev() {
        let on_level = loader.level(number, &arguments.walks)?;
        let pawn = pawn.on_level(on_level.archive().frame());
        let mut along = Along::new(pawn, arguments.from, arguments.to, &guide, BESIDE * pixel(of));
        let found = on_level.known(|view| along.go_on(view, &NoMonitor))?;
        *bytes = (*bytes).max(on_level.memory_bytes() + along.peak_bytes());
        if let Ok(route) = found {
            (guide, of) = (route, number);
        }
    }
    let mut along = Along::new(pawn, arguments.from, arguments.to, &guide, BESIDE * pixel(of));
    let found = loader.known(|view| along.go_on(view, &NoMonitor))?;
    *bytes = (*bytes).max(loader.memory_bytes() + along.peak_bytes());
    Ok(found.ok())
}
