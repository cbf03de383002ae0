//! `slicetool reach`: finds where a pawn can walk from a place, how narrow it gets, and where it leaks.

mod features;
mod files;
pub mod geojson;
mod map;

use crate::ground::{Walks, end_json, tidy};
use crate::links::{Joined, Way};
use crate::{Failure, Outcome};
use nalgebra::Point3;
use slicewalk::reach::{Leak, LeakSearch, Passage, Region, Snapped, Storeys};
use std::fmt::Write;
use std::io::{BufWriter, IntoInnerError};
use std::path::PathBuf;
use std::time::Instant;

/// Options of `slicetool reach`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    archive: PathBuf,
    /// Start of the feet (m); in the air, the floor below counts
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    from: nalgebra::Point3<f64>,
    /// Another place (m): maps and GeoJSON show the route there as a line
    #[arg(long, value_name = "X,Y,Z", value_parser = crate::walk::point, allow_hyphen_values = true)]
    to: Option<nalgebra::Point3<f64>>,
    #[command(flatten)]
    walks: Walks,
    /// File to write: a map (.png), x,y,z,clearance of each standing place (.csv, .ply), or areas and leaks (.geojson). `-`
    /// writes CSV to standard output
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

/// Results of the search.
struct Reach {
    region: Region,
    storeys: Storeys,
    passages: Vec<Passage>,
    leaks: Vec<Leak>,
    /// Route to the other place, if requested and reachable.
    way: Option<Way>,
    /// Where the pawn starts, and where the route should end.
    from: Snapped,
    to: Option<Snapped>,
}

/// Finds everything that can be reached; a file appears complete or not at all.
pub fn run(arguments: &Arguments) -> Outcome {
    crate::standard::refuse_two("-o", arguments.output.as_deref(), arguments.json)?;
    let started = Instant::now();
    let write = arguments.output.as_deref().map(files::writer).transpose()?;
    let archive = arguments.walks.open(&arguments.archive)?;
    let loader = arguments.walks.loader(archive, &arguments.archive)?;
    let edits = arguments.walks.edits().path();
    let output = arguments
        .output
        .as_deref()
        .map(|output| crate::output(output, loader.archive(), edits.as_slice()))
        .transpose()?;
    let mut standing = loader.standing(arguments.walks.pawn())?;
    let Some(from) = arguments.walks.snapped(&loader, &mut standing, arguments.from)? else {
        let [x, y, z] = [arguments.from.x, arguments.from.y, arguments.from.z];
        return Err(Failure::Text(format!(
            "--from {x},{y},{z}: the pawn cannot stand there ({}); choose another place, or a smaller --pawn",
            arguments.walks.nowhere_near()
        )));
    };
    let to = match arguments.to {
        Some(to) => arguments.walks.snapped(&loader, &mut standing, to)?,
        None => None,
    };
    let links = arguments.walks.edits().read()?.map(|file| file.links).unwrap_or_default();
    let joined = Joined::from(&loader, &arguments.walks, &mut standing, &from, &links)?;
    let mut search = LeakSearch::new(&joined.region);
    let leaks = loader.known(|view| search.find(&mut standing, view))?;
    let mut way = None;
    if let Some(asked) = arguments.to {
        if let Some(to) = &to {
            way = joined.way(&loader, [&from, to], &links)?;
        }
        if way.is_none() {
            crate::say(&format!("--to {},{},{}: no way leads there", asked.x, asked.y, asked.z));
        }
    }
    let own = standing.memory_bytes() + joined.memory_bytes();
    let region = joined.region;
    if region.places().next().is_none() {
        let Point3 { coords, .. } = arguments.from;
        crate::say(&format!(
            "--from {},{},{}: no ground there is as level as --max-grade and --max-ramp ask",
            coords.x, coords.y, coords.z
        ));
    }
    crate::go_on()?;
    let storeys = region.storeys();
    crate::go_on()?;
    let passages = region.passages();
    crate::go_on()?;
    let reach = Reach { storeys, passages, leaks, way, region, from, to };
    if let (Some(write), Some(output)) = (write, output) {
        let mut out = BufWriter::new(output);
        write(&reach, &loader, &mut out)?;
        out.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    }
    let seconds = started.elapsed().as_secs_f64();
    let memory = own + loader.memory_bytes();
    if arguments.json {
        return json(&reach, memory, seconds);
    }
    let text = text(&reach, memory, seconds)?;
    arguments.output.as_deref().map_or(Ok(text.clone()), |output| crate::standard::written(output, &text))
}

fn json(reach: &Reach, memory_bytes: usize, seconds: f64) -> Outcome {
    let at = |at: nalgebra::Point3<f64>, name: &str, value: f64| {
        let [x, y, z, value] = [at.x, at.y, at.z, value].map(tidy);
        serde_json::json!({ "x": x, "y": y, "z": z, name: value })
    };
    let region = &reach.region;
    let summary = serde_json::json!({
        "area_m2": tidy(region.area_m2()),
        "storeys": reach.storeys.all.iter().map(|storey| serde_json::json!({ "z": tidy(storey.z), "area_m2": tidy(storey.area_m2) })).collect::<Vec<_>>(),
        "passages": reach.passages.iter().map(passage_json).collect::<Vec<_>>(),
        "leaks": reach.leaks.iter().map(|leak| serde_json::json!({
            "x": tidy(leak.at.x), "y": tidy(leak.at.y), "z": tidy(leak.at.z),
            "width": tidy(leak.width), "drop": leak.drop.map(tidy), "kind": leak.kind.name(),
        })).collect::<Vec<_>>(),
        "lowest_headroom": region.lowest_headroom().map(|(place, room)| at(place.feet, "height", room)),
        "highest_step": region.highest_step().map(|(place, rise)| at(place.feet, "height", rise)),
        "places": region.places().count(),
        "from": end_json(reach.from.feet, reach.from.moved),
        "to": reach.to.map(|to| end_json(to.feet, to.moved)),
        "way_m": reach.way.as_ref().map(|way| way.length_m),
        "way_s": reach.way.as_ref().map(|way| tidy(way.seconds)),
        "links": reach.way.as_ref().map(|way| &way.links[..]).unwrap_or_default(),
        "memory_bytes": memory_bytes,
        "seconds": seconds,
    });
    Ok(format!("{summary:#}\n"))
}

fn passage_json(passage: &Passage) -> serde_json::Value {
    let place = |at: nalgebra::Point3<f64>| {
        let [x, y, z] = [at.x, at.y, at.z].map(tidy);
        serde_json::json!({ "x": x, "y": y, "z": z })
    };
    let mut json = place(passage.at);
    json["width"] = tidy(passage.width).into();
    json["connects"] = passage.rooms.map(place).to_vec().into();
    json
}

fn text(reach: &Reach, memory_bytes: usize, seconds: f64) -> Outcome {
    let mut text = format!("area {:.2} m²\n", reach.region.area_m2());
    for (name, end) in [("start", Some(reach.from)), ("end", reach.to)] {
        if let Some(Snapped { feet, moved, .. }) = end.filter(|end| end.moved > 0.0) {
            writeln!(text, "{name} moved by {moved:.2} m to {:.2},{:.2},{:.2}", feet.x, feet.y, feet.z)?;
        }
    }
    for storey in &reach.storeys.all {
        writeln!(text, "storey at z = {:.2} m: {:.2} m²", storey.z, storey.area_m2)?;
    }
    if let Some((place, room)) = reach.region.lowest_headroom() {
        let at = place.feet;
        writeln!(text, "lowest headroom {room:.2} m at {:.2},{:.2},{:.2}", at.x, at.y, at.z)?;
    }
    if let Some((place, rise)) = reach.region.highest_step() {
        let at = place.feet;
        writeln!(text, "highest step {rise:.2} m at {:.2},{:.2},{:.2}", at.x, at.y, at.z)?;
    }
    for Passage { at, width, .. } in &reach.passages {
        writeln!(text, "passage {width:.2} m wide at {:.2},{:.2},{:.2}", at.x, at.y, at.z)?;
    }
    for Leak { at, width, drop, kind, .. } in &reach.leaks {
        let depth = drop.map_or("nothing scanned below".into(), |drop| format!("drop {drop:.2} m"));
        writeln!(text, "{} {width:.2} m wide at {:.2},{:.2},{:.2}: {depth}", kind.name(), at.x, at.y, at.z)?;
    }
    if let Some(way) = &reach.way {
        writeln!(text, "way of {:.2} m", way.length_m)?;
    }
    writeln!(text, "{:.1} MiB, {seconds:.2} s", memory_bytes as f64 / f64::from(1 << 20))?;
    Ok(text)
}
