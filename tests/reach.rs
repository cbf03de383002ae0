//! Where a pawn can stand and walk, beside brute force, closed forms, exact ways and the walker itself.

mod common;
#[path = "reach/flat.rs"]
mod flat;
#[path = "reach/leaks.rs"]
mod leaks;
#[path = "reach/oracle.rs"]
mod oracle;
#[path = "reach/routes.rs"]
mod routes;
#[path = "reach/scenes.rs"]
mod scenes;
#[allow(dead_code)]
#[path = "walk/world.rs"]
mod world;

use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Ground, Pawn, Region, Route, Search, Spot};
use slicewalk::store::PageSet;

/// The value of an answer of a set whose pages are all in memory.
fn known<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Known(value) => value,
        Answer::NotLoaded(missing) => panic!("{missing:?}"),
    }
}

fn grown<S: PageSet>(ground: &mut Ground, set: &S, mut flood: Flood) -> Region {
    known(flood.grow(ground, set, &NoMonitor).unwrap());
    flood.region(ground)
}

/// All that can be reached from a place.
fn reached<S: PageSet>(set: &S, pawn: Pawn, from: [f64; 3]) -> (Ground, Region) {
    let mut ground = Ground::new(set, pawn).unwrap();
    let start = known(ground.spot(set, from.into())).unwrap_or_else(|| panic!("{from:?} is no place to stand"));
    let region = grown(&mut ground, set, Flood::from(start));
    (ground, region)
}

/// All standing places.
fn everywhere<S: PageSet>(set: &S, pawn: Pawn) -> (Ground, Region) {
    let mut ground = Ground::new(set, pawn).unwrap();
    let flood = known(Flood::everywhere(&mut ground, set));
    let region = grown(&mut ground, set, flood);
    (ground, region)
}

fn spot<S: PageSet>(ground: &mut Ground, set: &S, at: Point3<f64>) -> Option<Spot> {
    known(ground.spot(set, at))
}

fn way(search: &mut Search, region: &Region, from: &Spot, to: &Spot) -> Option<Route> {
    search.route(region, from, to, &NoMonitor).unwrap()
}
