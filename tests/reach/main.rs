//! Standing places and walking, compared with brute force, closed forms, exact routes and the walker itself.

mod blocked;
mod brute;
mod coarse;
#[path = "../common/mod.rs"]
mod common;
#[path = "../common/data.rs"]
mod data;
mod ends;
mod flat;
mod leaks;
mod limits;
mod oracle;
mod oriented;
mod plans;
mod ramps;
mod routes;
mod scenes;
mod seen;
mod snapping;
mod storeys;
mod walked;
#[allow(dead_code)]
#[path = "../walk/world.rs"]
mod world;

use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Pawn, PlaceId, Region, Route, Search, StandingPlaces};
use slicewalk::store::Snapshot;

/// Unwraps the answer of a set whose pages are all in memory.
fn known<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Known(value) => value,
        Answer::NotLoaded(missing) => panic!("{missing:?}"),
    }
}

fn grown(standing: &mut StandingPlaces, set: &Snapshot, mut flood: Flood) -> Region {
    known(flood.grow(standing, set, &NoMonitor).unwrap());
    flood.region(standing)
}

/// Everything reachable from a place.
fn reached(set: &Snapshot, pawn: Pawn, from: [f64; 3]) -> (StandingPlaces, Region) {
    let mut standing = StandingPlaces::new(set, pawn).unwrap();
    let start =
        known(standing.spot(set, from.into()).unwrap()).unwrap_or_else(|| panic!("{from:?} is no place to stand"));
    let region = grown(&mut standing, set, Flood::from(start));
    (standing, region)
}

/// All standing places.
fn everywhere(set: &Snapshot, pawn: Pawn) -> (StandingPlaces, Region) {
    let mut standing = StandingPlaces::new(set, pawn).unwrap();
    let flood = known(Flood::everywhere(&mut standing, set).unwrap());
    let region = grown(&mut standing, set, flood);
    (standing, region)
}

fn spot(standing: &mut StandingPlaces, set: &Snapshot, at: Point3<f64>) -> Option<PlaceId> {
    known(standing.spot(set, at).unwrap())
}

fn way(search: &mut Search, set: &Snapshot, region: &Region, from: &PlaceId, to: &PlaceId) -> Option<Route> {
    known(search.route(set, region, from, to, &NoMonitor).unwrap())
}
