//! A route as a task that can wait and stop.

use super::{Flood, Pawn, Refusal, Region, Route, Search, Spot, StandingPlaces};
use crate::query::Answer;
use crate::store::{Missing, PageSet};
use crate::{Monitor, Result};
use nalgebra::Point3;

/// Ways are looked for up to this multiple of the straight line, and some metres for the way around what stands there (m).
const STRETCH: f64 = 1.05;
const ROUND_M: f64 = 4.0;
/// By how much longer ones are looked for where none is found.
const WIDER: f64 = 1.5;

/// Where a [`Planner`] is.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Planned {
    /// The way, or why there is none.
    Done(std::result::Result<Route, Refusal>),
    /// It takes these pages: load them and go on.
    NotLoaded(Missing),
    /// It has more to do: go on when there is time.
    Unfinished,
}

/// Plans one route, some steps at a time: it looks near the straight line first, and farther if the way leads farther.
///
/// It does no I/O and holds no clock, so it runs in a browser's frame as well as on a thread; whoever drops it cancels it.
/// [`Search`] plans many routes in one region faster.
#[derive(Debug)]
pub struct Planner {
    ends: [Point3<f64>; 2],
    standing: StandingPlaces,
    spots: [Option<Spot>; 2],
    flood: Option<Flood>,
    /// What has been reached, while the way through it takes more pages.
    region: Option<Region>,
    search: Search,
    length: f64,
    /// Whether longer ways are of no use.
    is_bounded: bool,
    peak_bytes: usize,
}

impl Planner {
    /// Plans the way of `pawn` between two places (m); in the air, the floor below counts. Fails for a pawn that is none and for a set of pages
    /// that is too large, as [`StandingPlaces::new`] does.
    pub fn new<S: PageSet>(set: &S, pawn: Pawn, from: Point3<f64>, to: Point3<f64>) -> Result<Self> {
        let length = STRETCH * (to - from).xy().norm() + ROUND_M;
        let standing = StandingPlaces::new(set, pawn)?;
        Ok(Self {
            ends: [from, to],
            standing,
            spots: [None; 2],
            flood: None,
            region: None,
            search: Search::new(),
            length,
            is_bounded: false,
            peak_bytes: 0,
        })
    }

    /// Looks only where ways of up to this length lead (m), and no farther. [`Refusal::NotConnected`] then says that no way is so short; one
    /// that is found may be a little longer.
    #[must_use]
    pub fn within(self, length: f64) -> Self {
        Self { length, is_bounded: true, ..self }
    }

    /// Most bytes of memory that it took so far.
    pub fn peak_bytes(&self) -> usize {
        self.peak_bytes
    }

    /// Goes on for about `steps` places, and to the end of one search. Fails when `monitor` asks to stop, and where more matter
    /// lies over one tile than any scan has ([`Error::Limit`](crate::Error::Limit)).
    pub fn go_on<S: PageSet>(&mut self, set: &S, steps: usize, monitor: &dyn Monitor) -> Result<Planned> {
        for (end, refusal) in [(0, Refusal::NotStandingFrom), (1, Refusal::NotStandingTo)] {
            if self.spots[end].is_none() {
                match self.standing.spot(set, self.ends[end])? {
                    Answer::Known(Some(spot)) => self.spots[end] = Some(spot),
                    Answer::Known(None) => return Ok(Planned::Done(Err(refusal))),
                    Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
                }
            }
        }
        let [Some(from), Some(to)] = self.spots else { return Ok(Planned::Unfinished) };
        let flood = self.flood.get_or_insert_with(|| Flood::from(from));
        if self.region.is_none() {
            flood.within(self.ends.map(|end| end.xy()), self.length);
            match flood.grow_some(&mut self.standing, set, steps, monitor)? {
                Answer::Known(true) => {}
                Answer::Known(false) => return Ok(Planned::Unfinished),
                Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
            }
        }
        let region = self.region.get_or_insert_with(|| flood.region(&self.standing));
        let route = match self.search.route(set, region, &from, &to, monitor)? {
            Answer::Known(route) => route,
            Answer::NotLoaded(missing) => return Ok(Planned::NotLoaded(missing)),
        };
        let search = self.search.memory_bytes();
        let bytes = self.standing.memory_bytes() + flood.memory_bytes() + region.memory_bytes() + search;
        self.peak_bytes = self.peak_bytes.max(bytes);
        self.region = None;
        // What a way of this length can touch has been looked at; a shorter way lies in it whole.
        let is_last = self.is_bounded || flood.is_whole();
        match route {
            Some(route) if is_last || route.length_m <= self.length => return Ok(Planned::Done(Ok(route))),
            Some(route) => self.length = route.length_m,
            None if is_last => return Ok(Planned::Done(Err(Refusal::NotConnected))),
            None => self.length *= WIDER,
        }
        Ok(Planned::Unfinished)
    }
}
