//! Exact routes along coarse ones, in memory that does not grow with their length.
//!
//! A route planned on an overview level shows roughly where to go. The exact route is searched piece by piece in a
//! corridor around it: each search leads to a place some distance ahead, and the first stretch of the result is kept. A
//! corridor that does not connect is widened.

use super::route::Search;
use super::{Flood, Pawn, PlaceId, Refusal, Region, Route, StandingPlaces};
use crate::query::Answer;
use crate::store::Snapshot;
use crate::{Monitor, Result};
use nalgebra::{Point2, Point3};

/// Length along the guide for which a piece is planned, and length of it that is kept (m).
const AHEAD_M: f64 = 120.0;
const KEPT_M: f64 = 100.0;
/// Least progress of a piece along the guide (m); with less, the search ends.
const LEAST_PROGRESS_M: f64 = 1.0;
/// How often a corridor is doubled in width at most.
const MOST_WIDENINGS: u32 = 4;

/// Search for the exact route along a coarse one.
///
/// Memory: about 69 bytes for each standing place in 120 m of the corridor, and 16 KiB for each tile that it touches.
///
/// Every place of the route was checked at full resolution. Each piece is the shortest one within its corridor; a
/// shorter route may lead elsewhere.
#[derive(Debug)]
pub struct RouteRefiner {
    pawn: Pawn,
    to: Point3<f64>,
    guide: Vec<Point3<f64>>,
    /// Distance from the guide to the edge of the corridor (m).
    distance: f64,
    /// Length along the guide that the route already covers (m).
    done: f64,
    points: Vec<Point3<f64>>,
    piece: Option<Piece>,
    widenings: u32,
    search: Search,
    peak_bytes: usize,
}

/// A piece that is being planned.
#[derive(Debug)]
struct Piece {
    standing: StandingPlaces,
    from: Option<PlaceId>,
    to: Option<PlaceId>,
    flood: Option<Flood>,
    /// The region reached, kept while its route needs more pages.
    region: Option<Region>,
    /// True if it leads to the end.
    is_last: bool,
}

impl RouteRefiner {
    /// Creates a search for the route of `pawn` from `from` to `to` (m) in a corridor that reaches `distance` (m) to
    /// both sides of `guide`. A few pixels of the guide's level are a good distance.
    pub fn new(pawn: Pawn, from: Point3<f64>, to: Point3<f64>, guide: &Route, distance: f64) -> Self {
        let mut line = vec![from];
        line.extend(&guide.points);
        line.push(to);
        let (points, search) = (vec![from], Search::new());
        Self { pawn, to, guide: line, distance, done: 0.0, points, piece: None, widenings: 0, search, peak_bytes: 0 }
    }

    /// Returns its peak memory (bytes).
    pub fn peak_bytes(&self) -> usize {
        self.peak_bytes
    }

    /// Searches until the route is found or pages are missing: load them and call again. Fails if `monitor` asks to
    /// stop, or if a tile holds more spans than any scan has ([`Error::Limit`](crate::Error::Limit)).
    ///
    /// [`Refusal::NotConnected`] means that no corridor connected the ends, not that there is no route.
    pub fn advance(
        &mut self,
        set: &Snapshot,
        monitor: &dyn Monitor,
    ) -> Result<Answer<std::result::Result<Route, Refusal>>> {
        loop {
            let end = self.length();
            let ahead = self.done + AHEAD_M;
            let mut piece = match self.piece.take() {
                Some(piece) => piece,
                None => Piece {
                    standing: StandingPlaces::new(set, self.pawn)?,
                    from: None,
                    to: None,
                    flood: None,
                    region: None,
                    is_last: ahead >= end,
                },
            };
            let answer = self.piece(&mut piece, ahead.min(end), set, monitor)?;
            match answer {
                Answer::NotLoaded(missing) => {
                    self.piece = Some(piece);
                    return Ok(Answer::NotLoaded(missing));
                }
                Answer::Known(Err(refusal)) => return Ok(Answer::Known(Err(refusal))),
                // Widened.
                Answer::Known(Ok(None)) => self.piece = Some(piece),
                Answer::Known(Ok(Some(route))) => {
                    let before = self.done;
                    self.widenings = 0;
                    if self.keep(&route, piece.is_last) {
                        let points = std::mem::take(&mut self.points);
                        return Ok(Answer::Known(Ok(Route::along(points, Vec::new()))));
                    }
                    if self.done < before + LEAST_PROGRESS_M {
                        return Ok(Answer::Known(Err(Refusal::NotConnected)));
                    }
                }
            }
        }
    }

    /// Returns a route to about `ahead` along the guide (m); `None` if the corridor had to be widened first.
    #[allow(clippy::type_complexity)]
    fn piece(
        &mut self,
        piece: &mut Piece,
        ahead: f64,
        set: &Snapshot,
        monitor: &dyn Monitor,
    ) -> Result<Answer<std::result::Result<Option<Route>, Refusal>>> {
        let at = self.points[self.points.len() - 1];
        if piece.from.is_none() {
            match piece.standing.spot(set, at)? {
                Answer::Known(Some(spot)) => piece.from = Some(spot),
                Answer::Known(None) => return Ok(Answer::Known(Err(Refusal::NotStandingFrom))),
                Answer::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
            }
        }
        if piece.is_last && piece.to.is_none() {
            match piece.standing.spot(set, self.to)? {
                Answer::Known(Some(spot)) => piece.to = Some(spot),
                Answer::Known(None) => return Ok(Answer::Known(Err(Refusal::NotStandingTo))),
                Answer::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
            }
        }
        let Some(from) = piece.from else { return Ok(Answer::Known(Ok(None))) };
        let flood = piece.flood.get_or_insert_with(|| Flood::from(from));
        let distance = self.distance * f64::from(1u32 << self.widenings);
        if piece.region.is_none() {
            let line = stretch(&self.guide, self.done - distance, ahead + distance, at.xy());
            flood.along(&line, distance);
            if let Answer::NotLoaded(missing) = flood.grow(&mut piece.standing, set, monitor)? {
                return Ok(Answer::NotLoaded(missing));
            }
        }
        let region = piece.region.get_or_insert_with(|| flood.region(&piece.standing));
        let last = match &piece.to {
            Some(spot) => region.number(spot),
            None => nearest(region, point_at(&self.guide, ahead), distance),
        };
        let route = match (region.number(&from), last) {
            (Some(first), Some(last)) => match self.search.between(set, region, [first, last], monitor)? {
                Answer::Known(route) => route,
                Answer::NotLoaded(missing) => return Ok(Answer::NotLoaded(missing)),
            },
            _ => None,
        };
        let bytes =
            piece.standing.memory_bytes() + flood.memory_bytes() + region.memory_bytes() + self.search.memory_bytes();
        self.peak_bytes = self.peak_bytes.max(bytes);
        piece.region = None;
        if route.is_none() {
            if self.widenings == MOST_WIDENINGS || flood.is_whole() {
                return Ok(Answer::Known(Err(Refusal::NotConnected)));
            }
            self.widenings += 1;
        }
        Ok(Answer::Known(Ok(route)))
    }

    /// Keeps the first stretch of a piece, or all of the last one. Returns whether that was the last one.
    fn keep(&mut self, route: &Route, is_last: bool) -> bool {
        // The start may have been in the air.
        if self.points.len() == 1 {
            self.points[0] = route.points[0];
        }
        let mut length = 0.0;
        for pair in route.points.windows(2) {
            self.points.push(pair[1]);
            length += (pair[1] - pair[0]).norm();
            if !is_last && length >= KEPT_M {
                break;
            }
        }
        let at = self.points[self.points.len() - 1].xy();
        self.done = self.nearest_length(at).max(self.done);
        is_last
    }

    fn length(&self) -> f64 {
        self.guide.windows(2).map(|pair| (pair[1] - pair[0]).xy().norm()).sum()
    }

    /// Returns the length along the guide of its place nearest to `at` (m), between the length covered so far and one
    /// piece more.
    fn nearest_length(&self, at: Point2<f64>) -> f64 {
        let (mut best, mut before) = ((f64::INFINITY, self.done), 0.0);
        for pair in self.guide.windows(2) {
            let (from, along) = (pair[0].xy(), (pair[1] - pair[0]).xy());
            let length = along.norm();
            let [low, high] = [self.done, self.done + AHEAD_M].map(|far| (far - before).clamp(0.0, length));
            if length > 0.0 && high > 0.0 && low < length {
                let share = ((at - from).dot(&along) / length).clamp(low, high);
                let distance = (at - (from + along * (share / length))).norm();
                if distance < best.0 {
                    best = (distance, before + share);
                }
            }
            before += length;
        }
        best.1
    }
}

/// Returns the place `far` along a line (m, on the ground plan), with its height.
fn point_at(line: &[Point3<f64>], far: f64) -> Point3<f64> {
    let mut left = far;
    for pair in line.windows(2) {
        let length = (pair[1] - pair[0]).xy().norm();
        if left <= length && length > 0.0 {
            return pair[0] + (pair[1] - pair[0]) * (left.max(0.0) / length);
        }
        left -= length;
    }
    line[line.len() - 1]
}

/// Returns the part of a line between two lengths along it (m), preceded by `at`.
fn stretch(line: &[Point3<f64>], low: f64, high: f64, at: Point2<f64>) -> Vec<Point2<f64>> {
    let mut stretch = vec![at, point_at(line, low.max(0.0)).xy()];
    let mut before = 0.0;
    for pair in line.windows(2) {
        before += (pair[1] - pair[0]).xy().norm();
        if before > low && before < high {
            stretch.push(pair[1].xy());
        }
    }
    stretch.push(point_at(line, high).xy());
    stretch
}

/// Returns the standing place nearest to `at` on the ground plan, if one lies within `distance` (m): on the storey of `at` if
/// there is one.
fn nearest(region: &Region, at: Point3<f64>, distance: f64) -> Option<u32> {
    let height = region.pawn().body.height();
    let far = |place: u32| {
        let by = region.feet(place) - at;
        // Places above one another are at least as far apart as the pawn is high.
        ((by.z.abs() / height) as u32, by.xy().norm(), place)
    };
    let all = (0..region.len() as u32).filter(|place| region.standing[*place as usize]).map(far);
    let near = all.filter(|(_, far, _)| *far <= distance);
    let nearest = near.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    nearest.map(|(_, _, place)| place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walk::Body;
    use proptest::prelude::*;

    /// Lines of up to nine points on the ground plan, some of them twice, with heights.
    fn lines() -> impl Strategy<Value = Vec<Point3<f64>>> {
        let point = (-60i32..60, -60i32..60, -9i32..9).prop_map(|(x, y, z)| [x, y, z].map(f64::from).into());
        prop::collection::vec((point, 1usize..3), 2..5)
            .prop_map(|points| points.into_iter().flat_map(|(point, times)| vec![point; times]).collect())
    }

    /// Lengths along a line, on the ground plan, at which its points lie.
    fn lengths(line: &[Point3<f64>]) -> Vec<f64> {
        let far = |last: usize| (1..=last).map(|to| (line[to].x - line[to - 1].x).hypot(line[to].y - line[to - 1].y));
        (0..line.len()).map(|last| far(last).sum()).collect()
    }

    proptest! {
        #[test]
        fn places_along_a_line_are_as_far_as_asked_for(line in lines(), part in any::<prop::sample::Index>(), share in 0.0..1.0f64) {
            let lengths = lengths(&line);
            let from = part.index(line.len() - 1);
            prop_assume!(lengths[from + 1] > lengths[from]);
            let far = lengths[from] + share * (lengths[from + 1] - lengths[from]);
            let expected = line[from] + (line[from + 1] - line[from]) * share;
            prop_assert!((point_at(&line, far) - expected).norm() < 1e-9);
            prop_assert_eq!(point_at(&line, -share).xy(), line[0].xy());
            prop_assert_eq!(point_at(&line, lengths[line.len() - 1] + 0.1 + share), line[line.len() - 1]);
        }

        #[test]
        fn a_stretch_of_a_line_is_as_long_as_asked_for(line in lines(), ends in [-20.0..200.0f64, 0.0..200.0]) {
            let lengths = lengths(&line);
            let end = lengths[line.len() - 1];
            let [low, high] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
            let at = Point2::new(1.5, -2.5);
            let found = stretch(&line, low, high, at);
            let mut expected = vec![at, point_at(&line, low).xy()];
            expected.extend((0..line.len()).filter(|own| low < lengths[*own] && lengths[*own] < high).map(|own| line[own].xy()));
            expected.push(point_at(&line, high).xy());
            expected.dedup();
            let mut bare = found.clone();
            bare.dedup();
            prop_assert_eq!(bare, expected);
            let length: f64 = found[1..].windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            let within = |far: f64| far.clamp(0.0, end);
            prop_assert!((length - (within(high) - within(low))).abs() < 1e-9);
        }

        #[test]
        fn progress_is_that_of_the_nearest_place_ahead(line in lines(), done in 0.0..1.0f64, at in [-60.0..60.0f64, -60.0..60.0]) {
            let end = lengths(&line)[line.len() - 1];
            prop_assume!(end > 0.0);
            let guide = Route::along(line[1..line.len() - 1].to_vec(), Vec::new());
            let pawn = Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 });
            let mut refiner = RouteRefiner::new(pawn, line[0], line[line.len() - 1], &guide, 1.0);
            prop_assert!((refiner.length() - end).abs() < 1e-9);
            refiner.done = done * end;
            let found = refiner.nearest_length(at.into());
            let last = (refiner.done + AHEAD_M).min(end);
            prop_assert!((refiner.done - 1e-9..=last + 1e-9).contains(&found), "{found}");
            let distance = |far: f64| (point_at(&line, far).xy() - Point2::from(at)).norm();
            let nearest = (0..=1000).map(|part| distance(refiner.done + (last - refiner.done) * f64::from(part) / 1000.0));
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            prop_assert!(distance(found) <= nearest + 1e-9, "{} beside {nearest}", distance(found));
        }
    }
}
