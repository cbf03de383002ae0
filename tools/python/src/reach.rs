//! `Pages.reach` and `Pages.route`: where a pawn can walk, and how to get there.

use crate::arrays::{numbers, short};
use crate::attend::{Audience, attended};
use crate::errors::Failure;
use crate::options::{refuse, wrong_type};
use crate::pages::{Pages, needs};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use slicewalk::nalgebra::Point3;
use slicewalk::reach::{
    Flood, LeakSearch, LongSearch, Obstruction, ObstructionSearch, Pawn, Place, Planned, Planner, Refusal, Region,
    Route, Sought, StandingPlaces,
};
use slicewalk::seen::SeenSpace;
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk::{Error, Monitor};
use std::sync::Arc;

/// Reads a pawn, given as on the command line; by default the pawn of the thesis.
pub fn body(given: Option<&Bound<'_, PyAny>>) -> PyResult<Body> {
    let Some(given) = given else { return Ok(Body::Box { x: 0.5, y: 0.5, height: 1.8 }) };
    if let Ok(text) = given.cast::<PyString>() {
        return text.to_string().parse().map_err(|reason: String| refuse("pawn", reason));
    }
    let expected = "expected \"box:0.5x0.5x1.8\" or \"cylinder:0.25x1.8\" (m, above 0)";
    Err(wrong_type(given.py(), "pawn", &format!("{expected}, found {}", short(given))))
}

/// Limits of a pawn: arguments of `reach` and `route`.
pub struct Ability {
    pub climb: f64,
    pub max_drop: Option<f64>,
    pub max_grade: Option<f64>,
    pub max_ramp: Option<f64>,
}

/// Makes the pawn for a search.
pub fn pawn(given: Option<&Bound<'_, PyAny>>, ability: &Ability) -> PyResult<Pawn> {
    let Ability { climb, max_drop, max_grade, max_ramp } = *ability;
    Ok(Pawn {
        climb,
        max_drop: max_drop.unwrap_or(climb),
        max_grade: max_grade.unwrap_or(f64::INFINITY),
        max_ramp: max_ramp.unwrap_or(f64::INFINITY),
        ..Pawn::new(body(given)?)
    })
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

fn survey(
    set: &Snapshot,
    pawn: Pawn,
    length: Option<f64>,
    seen: Seen,
    start: [f64; 3],
    monitor: &dyn Monitor,
) -> Result<Found, Failure> {
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
    // The phases below hear no one, so there is a look between them.
    let go_on = || if monitor.cancelled() { Err(Failure::from(Error::Interrupted)) } else { Ok(()) };
    let mut region = flood.region(&standing);
    go_on()?;
    region.keep_linked(&standing, &[spot]);
    go_on()?;
    if let Some(length) = length {
        let reached = LongSearch::new(&region, length)?.reached(&[spot], monitor)?;
        region.keep_reached(&standing, &reached);
    }
    let leaks = needs(LeakSearch::new(&region).find(&mut standing, set)?)?;
    go_on()?;
    let storeys = region.storeys();
    go_on()?;
    let passages = region.passages();
    Ok(Found {
        storeys: storeys.all.iter().map(|storey| (storey.z, storey.area_m2)).collect(),
        passages: passages.iter().map(|passage| (passage.at.into(), passage.width)).collect(),
        leaks: leaks.iter().map(|leak| (leak.at.into(), leak.width, leak.drop, leak.kind.name())).collect(),
        region,
    })
}

/// Returns what a pawn can reach, as `slicewalk.Reach`.
pub fn reach<'py>(
    pages: &Pages,
    start: &Bound<'py, PyAny>,
    pawn: &Pawn,
    length: Option<f64>,
    seen: Seen,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = start.py();
    let at = numbers::<3>(start, "start")?;
    let audience = Audience { progress, ..Audience::default() };
    let found = {
        let set = pages.set.pages(py)?;
        attended(py, &audience, pages.name(), |monitor| survey(set, *pawn, length, seen, at, monitor))?
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

/// Returns the route, as `slicewalk.Route`; if there is none and with `explain`, with the obstruction.
pub fn route<'py>(
    pages: &Pages,
    ends: [&Bound<'py, PyAny>; 2],
    pawn: &Pawn,
    length: Option<f64>,
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
            let found = find(set, *pawn, length, seen.clone(), [from, to], monitor)?;
            let blocked = match found {
                Err(Refusal::NotConnected) if explain => obstruction(set, *pawn, length, seen, [from, to], monitor)?,
                _ => None,
            };
            Ok((found, blocked))
        })?
    };
    let (metres, points, headings, reason) = match found {
        Ok(route) => (Some(route.length_m), route.points, route.headings, None),
        Err(refusal) => (None, Vec::new(), Vec::new(), Some(refusal.name())),
    };
    let headings = length.map(|_| headings.into_pyarray(py));
    let count = points.len();
    let points: Vec<f64> = points.iter().flat_map(|point| [point.x, point.y, point.z]).collect();
    let points = points.into_pyarray(py).reshape([count, 3])?;
    let results = py.import("slicewalk._results")?;
    let blocked = blocked.map(|found| ((found.at.x, found.at.y, found.at.z), found.reason.name(), found.needs));
    let blocked = blocked.map(|found| results.getattr("Obstruction")?.call1(found)).transpose()?;
    results.getattr("Route")?.call1((reason.is_none(), metres, reason, points, blocked, headings))
}

fn find(
    set: &Snapshot,
    pawn: Pawn,
    length: Option<f64>,
    seen: Seen,
    [from, to]: [Point3<f64>; 2],
    monitor: &dyn Monitor,
) -> Result<Result<Route, Refusal>, Failure> {
    monitor.stage("route", 0, "places");
    let mut planner = Planner::new(set, pawn, from, to)?.within_seen(seen).drawn_out(length);
    loop {
        match planner.advance(set, usize::MAX, monitor)? {
            Planned::Done(found) => return Ok(found),
            Planned::NotLoaded(missing) => return Err(missing.into()),
            _ => {}
        }
    }
}

/// Finds what keeps the pawn from the goal.
fn obstruction(
    set: &Snapshot,
    pawn: Pawn,
    length: Option<f64>,
    seen: Seen,
    [from, to]: [Point3<f64>; 2],
    monitor: &dyn Monitor,
) -> Result<Option<Obstruction>, Failure> {
    monitor.stage("obstruction", 0, "places");
    let mut search = ObstructionSearch::new(set, pawn, from, to, monitor)?.within_seen(seen).drawn_out(length);
    loop {
        match search.advance(set)? {
            Sought::Done(found) => return Ok(found),
            Sought::NotLoaded(missing) => return Err(missing.into()),
            _ => {}
        }
    }
}
