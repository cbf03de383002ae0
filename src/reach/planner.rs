//! Route planning as a task that can wait for pages and be cancelled.

use super::{Flood, LongSearch, Pawn, PlaceId, Refusal, Region, Route, Search, StandingPlaces};
use crate::query::Answer;
use crate::seen::SeenSpace;
use crate::store::{Missing, Snapshot};
use crate::{Monitor, Result};
use nalgebra::Point3;
use std::sync::Arc;

/// Routes are searched up to this multiple of the straight line, plus some metres for the way around obstacles at the
/// ends (m).
const STRETCH: f64 = 1.05;
const ROUND_M: f64 = 4.0;
/// Factor by which the search is extended if there is no route.
const WIDER: f64 = 1.5;

/// State of a [`Planner`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Planned {
    /// The route, or the reason for a refusal.
    Done(std::result::Result<Route, Refusal>),
    /// These pages are needed: load them and continue.
    NotLoaded(Missing),
    /// The search is not finished: continue when there is time.
    Unfinished,
}

/// Plans one route, a bounded number of steps at a time: near the straight line first, and farther if the route leads
/// farther.
///
/// It does no I/O and reads no clock, so it runs within a browser's frame as well as on a thread; dropping it cancels
/// the search. [`Search`] plans many routes in one region faster.
#[derive(Debug)]
pub struct Planner {
    ends: [Point3<f64>; 2],
    standing: StandingPlaces,
    spots: [Option<PlaceId>; 2],
    /// Distance within which the ends are moved to places where the pawn can stand (m).
    snap: f64,
    flood: Option<Flood>,
    finder: Box<dyn Finder>,
    length: f64,
    /// True if longer routes are not wanted.
    is_bounded: bool,
    peak_bytes: usize,
}

impl Planner {
    /// Creates a plan for the route of `pawn` between two places (m); in the air, the floor below counts. Fails like
    /// [`StandingPlaces::new`] for an invalid pawn or a set of pages that is too large.
    pub fn new(set: &Snapshot, pawn: Pawn, from: Point3<f64>, to: Point3<f64>) -> Result<Self> {
        let standing = StandingPlaces::new(set, pawn)?;
        Ok(Self {
            ends: [from, to],
            standing,
            spots: [None; 2],
            snap: 0.0,
            flood: None,
            finder: Box::new(RoundFinder { region: None, search: Search::new() }),
            length: first_length(&[from, to]),
            is_bounded: false,
            peak_bytes: 0,
        })
    }

    /// Keeps the route within seen space; see [`StandingPlaces::within_seen`].
    #[must_use]
    pub fn within_seen(self, seen: Option<Arc<SeenSpace>>) -> Self {
        Self { standing: self.standing.within_seen(seen), ..self }
    }

    /// Moves an end where the pawn cannot stand to the nearest standing place within `metres`; see
    /// [`StandingPlaces::snapped`].
    #[must_use]
    pub fn snapping(self, metres: f64) -> Self {
        Self { snap: metres, ..self }
    }

    /// Plans for a pawn drawn out to `length` (m), from any heading to any; see [`LongSearch`]. An unfit length is an error
    /// of the first search.
    #[must_use]
    pub fn drawn_out(self, length: Option<f64>) -> Self {
        match length {
            Some(length) => Self { finder: Box::new(LongFinder { length, search: None }), ..self },
            None => self,
        }
    }

    /// Restricts the search to where routes of up to `length` (m) may lead. [`Refusal::NotConnected`] then means that
    /// no route is that short; a route that is found may be a little longer.
    #[must_use]
    pub fn within(self, length: f64) -> Self {
        Self { length, is_bounded: true, ..self }
    }

    /// Returns its peak memory (bytes).
    pub fn peak_bytes(&self) -> usize {
        self.peak_bytes
    }

    /// Continues for about `steps` places, or to the end of one search. Fails if `monitor` asks to stop, or if a tile
    /// holds more spans than any scan has ([`Error::Limit`](crate::Error::Limit)).
    pub fn advance(&mut self, set: &Snapshot, steps: usize, monitor: &dyn Monitor) -> Result<Planned> {
        for (end, refusal) in [(0, Refusal::NotStandingFrom), (1, Refusal::NotStandingTo)] {
            if self.spots[end].is_none() {
                match self.standing.snapped(set, self.ends[end], self.snap)? {
                    Answer::Known(Some(snapped)) => {
                        self.spots[end] = Some(snapped.spot);
                        if snapped.moved > 0.0 {
                            self.move_end(end, snapped.feet);
                        }
                    }
                    Answer::Known(None) => return Ok(Planned::Done(Err(refusal))),
                    Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
                }
            }
        }
        let [Some(from), Some(to)] = self.spots else { return Ok(Planned::Unfinished) };
        let flood = self.flood.get_or_insert_with(|| Flood::from(from));
        if !self.finder.waits() {
            flood.within(self.ends.map(|end| end.xy()), self.length + self.finder.beyond_m());
            match flood.grow_some(&mut self.standing, set, steps, monitor)? {
                Answer::Known(true) => {}
                Answer::Known(false) => return Ok(Planned::Unfinished),
                Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
            }
        }
        let found = match self.finder.find(set, &|| flood.region(&self.standing), [from, to], monitor)? {
            Answer::Known(found) => found,
            Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
        };
        let bytes = self.standing.memory_bytes() + flood.memory_bytes() + found.bytes;
        self.peak_bytes = self.peak_bytes.max(bytes);
        Ok(match found.route {
            Ok(route) => self.judged(route, found.cost_m),
            Err(refusal) => Planned::Done(Err(refusal)),
        })
    }

    /// Moves an end: the search lies around the places where the route begins and ends.
    fn move_end(&mut self, end: usize, feet: Point3<f64>) {
        self.ends[end] = feet;
        if !self.is_bounded {
            self.length = first_length(&self.ends);
        }
    }

    /// Returns a route if no better one can lie outside of what was searched; otherwise widens the search.
    fn judged(&mut self, route: Option<Route>, cost_m: f64) -> Planned {
        // Everything that a route of this cost can touch has been searched, and so every better route.
        let is_last = self.is_bounded || self.flood.as_ref().is_some_and(Flood::is_whole);
        match route {
            Some(route) if is_last || cost_m <= self.length => return Planned::Done(Ok(route)),
            Some(_) => self.length = cost_m,
            None if is_last => return Planned::Done(Err(Refusal::NotConnected)),
            None => self.length *= WIDER,
        }
        Planned::Unfinished
    }
}

/// Returns the length up to which routes are searched first (m).
fn first_length([from, to]: &[Point3<f64>; 2]) -> f64 {
    STRETCH * (to - from).xy().norm() + ROUND_M
}

/// Search for a route in what was reached. An object, so that a program that never draws a pawn out, such as the engine of the
/// viewer, does not hold the search for that.
trait Finder: std::fmt::Debug + Send + Sync {
    /// Whether a search waits for pages and continues with its region.
    fn waits(&self) -> bool;
    /// How far the pawn may reach beyond its way (m).
    fn beyond_m(&self) -> f64;
    /// Finds the route between the places in the region `reached`.
    fn find(
        &mut self,
        set: &Snapshot,
        reached: &dyn Fn() -> Region,
        ends: [PlaceId; 2],
        monitor: &dyn Monitor,
    ) -> Result<Answer<Found>>;
}

/// Result of a [`Finder`].
struct Found {
    /// The route, if there is one within the region.
    route: std::result::Result<Option<Route>, Refusal>,
    /// Its cost (m).
    cost_m: f64,
    /// Memory that the search took.
    bytes: usize,
}

#[derive(Debug)]
struct RoundFinder {
    /// Kept while its route needs more pages.
    region: Option<Region>,
    search: Search,
}

impl Finder for RoundFinder {
    fn waits(&self) -> bool {
        self.region.is_some()
    }

    fn beyond_m(&self) -> f64 {
        0.0
    }

    fn find(
        &mut self,
        set: &Snapshot,
        reached: &dyn Fn() -> Region,
        [from, to]: [PlaceId; 2],
        monitor: &dyn Monitor,
    ) -> Result<Answer<Found>> {
        let region = self.region.get_or_insert_with(reached);
        let route = match self.search.route(set, region, &from, &to, monitor)? {
            Answer::Known(route) => route,
            Answer::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
        };
        let bytes = region.memory_bytes() + self.search.memory_bytes();
        self.region = None;
        let cost_m = route.as_ref().map_or(0.0, |route| route.length_m);
        Ok(Answer::Known(Found { route: Ok(route), cost_m, bytes }))
    }
}

#[derive(Debug)]
struct LongFinder {
    /// Length of the pawn (m).
    length: f64,
    /// Kept while its route needs more pages.
    search: Option<LongSearch<Region>>,
}

impl Finder for LongFinder {
    fn waits(&self) -> bool {
        self.search.is_some()
    }

    /// The ends of a long pawn lie beside its way.
    fn beyond_m(&self) -> f64 {
        self.length
    }

    fn find(
        &mut self,
        set: &Snapshot,
        reached: &dyn Fn() -> Region,
        [from, to]: [PlaceId; 2],
        monitor: &dyn Monitor,
    ) -> Result<Answer<Found>> {
        let mut search = match self.search.take() {
            Some(search) => search,
            None => LongSearch::new(reached(), self.length)?,
        };
        for (end, refusal) in [(&from, Refusal::NotStandingFrom), (&to, Refusal::NotStandingTo)] {
            if search.region().holds(end) && !search.stands_at(end) {
                return Ok(Answer::Known(Found { route: Err(refusal), cost_m: 0.0, bytes: 0 }));
            }
        }
        let route = match search.route(set, &from, &to, monitor)? {
            Answer::Known(route) => route,
            Answer::NotLoaded(missing) => {
                self.search = Some(search);
                return Ok(Answer::NotLoaded(missing));
            }
        };
        let bytes = search.region().memory_bytes() + search.memory_bytes();
        let cost_m = route.as_ref().map_or(0.0, |route| search.cost_m(route));
        Ok(Answer::Known(Found { route: Ok(route), cost_m, bytes }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use crate::frame::{Frame, PageKey};
    use crate::page::{PageBuilder, Span};
    use crate::walk::Body;

    #[test]
    fn the_search_lies_around_ends_that_were_moved() {
        let mut floor = PageBuilder::default();
        for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            assert!(floor.set_column(x, y, &[Span::new(0, 10, false).unwrap()]));
        }
        let key = PageKey { tx: 0, ty: 0, layer: 0 };
        let set = Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), [(key, floor.build())]);
        let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
        let (from, to) = (Point3::new(-0.4, 1.0, 0.1), Point3::new(2.0, 1.0, 0.1));
        let found = StandingPlaces::new(&set, pawn).unwrap().snapped(&set, from, 0.6).unwrap();
        let Answer::Known(Some(moved)) = found else { panic!("{found:?}") };
        let plan = || Planner::new(&set, pawn, from, to).unwrap().snapping(0.6);
        let length = STRETCH * (to - moved.feet).xy().norm() + ROUND_M;
        for (mut planner, length) in [(plan(), length), (plan().within(9.0), 9.0)] {
            planner.advance(&set, 1, &NoMonitor).unwrap();
            assert_eq!((planner.ends, planner.length), ([moved.feet, to], length));
        }
    }
}
