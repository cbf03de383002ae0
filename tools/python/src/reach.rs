//! `Pages.reach` and `Pages.route`: where a pawn can walk, and how to get there.

use crate::arrays::numbers;
use crate::attend::{Audience, attended};
use crate::errors::Failure;
use crate::options::refuse;
use crate::pages::{Pages, needs};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use slicewalk::nalgebra::Point3;
use slicewalk::reach::{
    Flood, LeakSearch, Obstruction, ObstructionSearch, Pawn, Place, Refusal, Region, Route, Search, Sought,
    StandingPlaces,
};
use slicewalk::seen::SeenSpace;
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk::{Error, Monitor};
use std::sync::Arc;

/// Reads a pawn, given as on the command line or as its sizes; by default the pawn of the thesis.
pub fn body(given: Option<&Bound<'_, PyAny>>) -> PyResult<Body> {
    let Some(given) = given else { return Ok(Body::Box { x: 0.5, y: 0.5, height: 1.8 }) };
    if let Ok(text) = given.cast::<PyString>() {
        return text.to_string().parse().map_err(|reason: String| refuse("pawn", reason));
    }
    let reason = "expected \"box:0.5x0.5x1.8\" or \"cylinder:0.25x1.8\" (m, above 0)";
    Err(refuse("pawn", reason))
}

/// Makes the pawn for a search.
pub fn pawn(given: Option<&Bound<'_, PyAny>>, climb: f64, max_drop: Option<f64>) -> PyResult<Pawn> {
    Ok(Pawn { climb, max_drop: max_drop.unwrap_or(climb), ..Pawn::new(body(given)?) })
}

/// Space in which a pawn must stay, if it must.
type Seen = Option<Arc<SeenSpace>>;

/// Results of a search from one start.
struct Found {
    region: Region,
    storeys: Vec<(f64, f64)>,
    passages: Vec<([f64; 3], f64)>,
    leaks: Vec<([f64; 3], f64, Option<f64>, &'static str)>,
}

fn survey(set: &Snapshot, pawn: Pawn, seen: Seen, start: [f64; 3], monitor: &dyn Monitor) -> Result<Found, Failure> {
    let must_be_seen = if seen.is_some() { ", all of it seen" } else { "" };
    let mut standing = StandingPlaces::new(set, pawn)?.within_seen(seen);
    let Some(spot) = needs(standing.spot(set, start.into())?)? else {
        let [x, y, z] = start;
        let reason = format!(
            "the pawn cannot stand at {x}, {y}, {z} (expected floor below it and room for its whole body{must_be_seen}); choose another \
             place, or a smaller pawn"
        );
        return Err(Error::parameter("start", reason).into());
    };
    let mut flood = Flood::from(spot);
    monitor.stage("reach", 0, "places");
    needs(flood.grow(&mut standing, set, monitor)?)?;
    let region = flood.region(&standing);
    let leaks = needs(LeakSearch::new(&region).find(&mut standing, set)?)?;
    Ok(Found {
        storeys: region.storeys().all.iter().map(|storey| (storey.z, storey.area_m2)).collect(),
        passages: region.passages().iter().map(|passage| (passage.at.into(), passage.width)).collect(),
        leaks: leaks.iter().map(|leak| (leak.at.into(), leak.width, leak.drop, leak.kind.name())).collect(),
        region,
    })
}

/// Returns what a pawn can reach, as `slicewalk.Reach`.
pub fn reach<'py>(
    pages: &Pages,
    start: &Bound<'py, PyAny>,
    pawn: &Pawn,
    seen: Seen,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = start.py();
    let at = numbers::<3>(start, "start")?;
    let audience = Audience { progress, ..Audience::default() };
    let found = {
        let set = pages.set.pages(py)?;
        attended(py, &audience, pages.name(), |monitor| survey(set, *pawn, seen, at, monitor))?
    };
    let places: Vec<f64> = py.detach(|| {
        let row = |place: Place| [place.feet.x, place.feet.y, place.feet.z, place.clearance];
        found.region.places().flat_map(row).collect()
    });
    let count = places.len() / 4;
    let extreme = |place: Option<(Place, f64)>| place.map(|(place, height)| (<[f64; 3]>::from(place.feet), height));
    py.import("slicewalk._results")?.getattr("Reach")?.call_method1(
        "_of",
        (
            found.region.area_m2(),
            found.storeys,
            found.passages,
            found.leaks,
            extreme(found.region.lowest_headroom()),
            extreme(found.region.highest_step()),
            places.into_pyarray(py).reshape([count, 4])?,
        ),
    )
}

/// Returns the route, as `slicewalk.Route`; with what is in the way if there is none, and `explain`.
pub fn route<'py>(
    pages: &Pages,
    ends: [&Bound<'py, PyAny>; 2],
    pawn: &Pawn,
    seen: Seen,
    explain: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = ends[0].py();
    let [from, to] = [numbers::<3>(ends[0], "start")?, numbers::<3>(ends[1], "goal")?].map(Point3::from);
    let audience = Audience { progress, ..Audience::default() };
    let (found, blocked) = {
        let set = pages.set.pages(py)?;
        attended(py, &audience, pages.name(), |monitor| {
            let found = find(set, *pawn, seen.clone(), [from, to], monitor)?;
            let blocked = match found {
                Err(Refusal::NotConnected) if explain => obstruction(set, *pawn, seen, [from, to], monitor)?,
                _ => None,
            };
            Ok((found, blocked))
        })?
    };
    let (length, points, reason) = match found {
        Ok(route) => (Some(route.length_m), route.points, None),
        Err(refusal) => (None, Vec::new(), Some(refusal.name())),
    };
    let count = points.len();
    let points: Vec<f64> = points.iter().flat_map(|point| [point.x, point.y, point.z]).collect();
    let points = points.into_pyarray(py).reshape([count, 3])?;
    let results = py.import("slicewalk._results")?;
    let blocked = blocked.map(|found| ((found.at.x, found.at.y, found.at.z), found.reason.name(), found.needs));
    let blocked = blocked.map(|found| results.getattr("Obstruction")?.call1(found)).transpose()?;
    results.getattr("Route")?.call1((reason.is_none(), length, reason, points, blocked))
}

fn find(
    set: &Snapshot,
    pawn: Pawn,
    seen: Seen,
    ends: [Point3<f64>; 2],
    monitor: &dyn Monitor,
) -> Result<Result<Route, Refusal>, Failure> {
    let mut standing = StandingPlaces::new(set, pawn)?.within_seen(seen);
    let Some(from) = needs(standing.spot(set, ends[0])?)? else { return Ok(Err(Refusal::NotStandingFrom)) };
    let Some(to) = needs(standing.spot(set, ends[1])?)? else { return Ok(Err(Refusal::NotStandingTo)) };
    let (mut flood, mut search) = (Flood::from(from), Search::new());
    let places = ends.map(|end| end.xy());
    // Bounds of everything that a route of this length can touch; a shorter route lies entirely within.
    let mut length = 1.5 * (places[1] - places[0]).norm() + 10.0;
    monitor.stage("route", 0, "places");
    loop {
        flood.within(places, length);
        needs(flood.grow(&mut standing, set, monitor)?)?;
        let region = flood.region(&standing);
        match needs(search.route(set, &region, &from, &to, monitor)?)? {
            Some(route) if route.length_m <= length || flood.is_whole() => return Ok(Ok(route)),
            Some(route) => length = route.length_m,
            None if flood.is_whole() => return Ok(Err(Refusal::NotConnected)),
            None => length *= 2.0,
        }
    }
}

/// Finds what keeps the pawn from the goal.
fn obstruction(
    set: &Snapshot,
    pawn: Pawn,
    seen: Seen,
    [from, to]: [Point3<f64>; 2],
    monitor: &dyn Monitor,
) -> Result<Option<Obstruction>, Failure> {
    monitor.stage("obstruction", 0, "places");
    let mut search = ObstructionSearch::new(set, pawn, from, to, monitor)?.within_seen(seen);
    loop {
        match search.advance(set)? {
            Sought::Done(found) => return Ok(found),
            Sought::NotLoaded(missing) => return Err(missing.into()),
            _ => {}
        }
    }
}
