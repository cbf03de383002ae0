//! `slicetool route`: the shortest way of a pawn between two places.

use crate::ground::{Loader, Walks};
use crate::{Failure, Outcome};
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::reach::{Flood, Refusal, Route, Search, Spot, StandingPlaces};
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

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
    let found = find(arguments, &loader)?;
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
            "seconds": seconds,
        });
        return Ok(format!("{summary:#}\n"));
    }
    match &found {
        Ok(route) => crate::say(&format!("{:.2} m over {} places", route.length_m, route.points.len())),
        Err(refusal) => crate::say(&format!("no route: {}", refusal.name())),
    }
    Ok(if arguments.output.is_some() { String::new() } else { rows })
}

fn find(arguments: &Arguments, loader: &Loader) -> Result<Result<Route, Refusal>, Failure> {
    let mut standing = StandingPlaces::new(&loader.view(), arguments.walks.pawn())?;
    let mut spot = |at: Point3<f64>| -> Result<Option<Spot>, Failure> { loader.known(|view| standing.spot(view, at)) };
    let Some(from) = spot(arguments.from)? else { return Ok(Err(Refusal::NotStandingFrom)) };
    let Some(to) = spot(arguments.to)? else { return Ok(Err(Refusal::NotStandingTo)) };
    let mut flood = Flood::from(from);
    let mut search = Search::new();
    let ends = [arguments.from.xy(), arguments.to.xy()];
    // What a way of this length can touch; a shorter way lies in it whole.
    let mut length = 1.5 * (ends[1] - ends[0]).norm() + 10.0;
    loop {
        flood.within(ends, length);
        loader.known(|view| flood.grow(&mut standing, view, &NoMonitor))?;
        let region = flood.region(&standing);
        match search.route(&region, &from, &to, &NoMonitor)? {
            Some(route) if route.length_m <= length || flood.is_whole() => return Ok(Ok(route)),
            Some(route) => length = route.length_m,
            None if flood.is_whole() => return Ok(Err(Refusal::NotConnected)),
            None => length *= 2.0,
        }
    }
}
