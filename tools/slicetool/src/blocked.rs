//! Why no route connects two places: where the best way stops, and what would pass.
//!
//! The pawn is changed in one respect at a time (narrower, lower, a higher step, a steeper grade), by bisection to the least change with
//! which the end is reached. The least of these changes, as a share of the pawn's own measure, is the reason; the place
//! is where the way of the changed pawn leaves what the pawn itself reaches. If no single change helps, a narrow pawn that
//! is also low, or climbs high, finds a way; the reason is then the least change that leads past the first place where
//! this way leaves what the pawn reaches, or the width that passes there once the other measure does not matter. If that
//! fails, too, ground is missing: where what is reached from the start
//! comes nearest to what is reached from the end.
//!
//! A long pawn that does not get where the round one does is too long: the length is bisected in what the round one reaches.
//!
//! A pawn that must stay in seen space is first tried without that: if it then gets through, the reason is `unseen`.
//!
//! Ways are looked for within an ellipse around both ends. Cost: up to about 25 floods of it.

use crate::Failure;
use crate::ground::{Loader, tidy};
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::reach::{Flood, LeakKind, LeakSearch, LongSearch, Pawn, Region, Route, Search, Snapped, StandingPlaces};
use slicewalk::walk::Body;
use std::collections::HashMap;

/// Ways are at most this many times as long as the straight line, plus a detour (m).
const LONGEST: f64 = 2.0;
const DETOUR_M: f64 = 30.0;
/// Least height of a body, and least height above the climb height (m).
const LOWEST_M: f64 = 0.3;
const ABOVE_CLIMB_M: f64 = 0.05;
/// Steepest grade that is tried.
const STEEPEST: f64 = 2.0;
/// Highest step that is tried (m).
const HIGHEST_STEP_M: f64 = 3.0;
/// Precision of steps and headroom (m).
const PRECISION_M: f64 = 0.01;
/// How far a changed pawn may be moved to stand at an end (m).
const SNAP_M: f64 = 0.5;
/// Cell in which the nearest ground is looked for (m).
const CELL_M: f64 = 2.0;

/// Obstruction of a pawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blocked {
    /// Where the way stops (m).
    pub at: Point3<f64>,
    /// `width`, `length`, `headroom`, `step`, `slope`, `gap` or `unseen`.
    pub reason: &'static str,
    /// Width, length or height of the largest pawn that passes, height of the step to climb, or width of the missing
    /// ground (m); or the grade to climb (percent).
    pub needs: f64,
}

impl Blocked {
    /// The value of the key `blocked`.
    pub fn to_json(self) -> serde_json::Value {
        let [x, y, z] = [self.at.x, self.at.y, self.at.z].map(tidy);
        serde_json::json!({ "x": x, "y": y, "z": z, "reason": self.reason, "needs": tidy(self.needs) })
    }

    /// A sentence about it.
    pub fn text(self) -> String {
        let Self { at, reason, needs } = self;
        let at = format!("{:.2},{:.2},{:.2}", at.x, at.y, at.z);
        match reason {
            "width" => format!("too narrow at {at}; a pawn {needs:.2} m wide passes"),
            "length" => format!("too long to pass or to turn at {at}; a pawn {needs:.2} m long passes"),
            "headroom" => format!("too low at {at}; a pawn {needs:.2} m high passes"),
            "step" => format!("a step too high at {at}; --climb {needs:.2} passes"),
            "slope" => format!("too steep at {at}; --max-grade {needs:.1} passes"),
            "gap" => format!("the ground ends at {at}, {needs:.2} m before what leads to the end"),
            _ => format!("nothing was scanned beyond {at}; the ground that leads to the end begins {needs:.2} m off"),
        }
    }
}

/// What a pawn reaches from a place.
struct Reached {
    standing: StandingPlaces,
    flood: Flood,
    start: Snapped,
}

impl Reached {
    /// The places with their steps, without ground that is too steep and what lies beyond it.
    fn region(&self) -> Region {
        let mut region = self.flood.region(&self.standing);
        region.keep_linked(&[self.start.spot]);
        region
    }
}

struct Ways<'a> {
    loader: &'a Loader,
    ends: [Point3<f64>; 2],
    length_m: f64,
    /// True if the pawn may leave seen space.
    anywhere: bool,
}

/// A respect in which a pawn is changed.
#[derive(Clone, Copy)]
enum Change {
    Width,
    Headroom,
    Step,
    Slope,
}

impl Change {
    const ALL: [Self; 4] = [Self::Width, Self::Headroom, Self::Step, Self::Slope];

    /// The measure of the pawn, and the value furthest from it that is tried.
    fn range(self, pawn: &Pawn, pixel_m: f64) -> [f64; 2] {
        let half = pawn.body.half();
        match self {
            Self::Width => [2.0 * half.min(), pixel_m.min(2.0 * half.min()) * half.min() / half.max()],
            Self::Headroom => [pawn.body.height(), (pawn.climb + ABOVE_CLIMB_M).max(LOWEST_M)],
            Self::Step => [pawn.climb, (pawn.body.height() - ABOVE_CLIMB_M).min(HIGHEST_STEP_M)],
            Self::Slope if pawn.max_grade.is_finite() => [pawn.max_grade, STEEPEST],
            Self::Slope => [0.0; 2],
        }
    }

    /// The pawn with this measure.
    fn apply(self, pawn: &Pawn, value: f64) -> Pawn {
        let share = value / (2.0 * pawn.body.half().min());
        let body = match (self, pawn.body) {
            (Self::Width, Body::Box { x, y, height }) => Body::Box { x: x * share, y: y * share, height },
            (Self::Width, Body::Cylinder { radius, height }) => Body::Cylinder { radius: radius * share, height },
            (Self::Headroom, Body::Box { x, y, .. }) => Body::Box { x, y, height: value },
            (Self::Headroom, Body::Cylinder { radius, .. }) => Body::Cylinder { radius, height: value },
            (Self::Step | Self::Slope, body) => body,
        };
        match self {
            Self::Step => Pawn { body, climb: value, max_drop: pawn.max_drop.max(value), ..*pawn },
            Self::Slope => Pawn { max_grade: value, ..*pawn },
            _ => Pawn { body, ..*pawn },
        }
    }

    fn reason(self) -> &'static str {
        match self {
            Self::Width => "width",
            Self::Headroom => "headroom",
            Self::Step => "step",
            Self::Slope => "slope",
        }
    }

    /// How much of the pawn's own measure the change to `value` is.
    fn share(self, pawn: &Pawn, value: f64, pixel_m: f64) -> f64 {
        let own = self.range(pawn, pixel_m)[0];
        (value - own).abs() / own.max(PRECISION_M)
    }

    /// The value as it is reported: metres, or percent.
    fn needs(self, value: f64) -> f64 {
        if matches!(self, Self::Slope) { value * 100.0 } else { value }
    }
}

/// Returns why a pawn, drawn out to `length` (m) if there is one, does not get from one place to the other, both standing
/// places that are not connected.
pub fn blocked(
    loader: &Loader,
    pawn: &Pawn,
    length: Option<f64>,
    ends: [Point3<f64>; 2],
) -> Result<Option<Blocked>, Failure> {
    let straight = (ends[1] - ends[0]).xy().norm();
    let search = Ways { loader, ends, length_m: LONGEST * straight + DETOUR_M, anywhere: false };
    if let Some(length) = length
        && let Some(found) = search.too_long(pawn, length)?
    {
        return Ok(Some(found));
    }
    let Some(own) = search.reached(pawn, ends[0])? else { return Ok(None) };
    let own = Ground::of(loader, &own.region());
    if let Some(seen) = loader.seen()
        && let Some(route) = (Ways { anywhere: true, ..search }).route(pawn, ends[1])?
        && let Some(stop) = own.leaves(&route)
    {
        let is_seen = |feet: &Point3<f64>| seen.is_pawn_seen(*feet, pawn.climb, pawn.body.height());
        let beyond = route[stop + 1..].iter().skip_while(|feet| is_seen(feet)).find(|feet| is_seen(feet));
        let needs = (beyond.unwrap_or(&ends[1]) - route[stop]).norm();
        return Ok(Some(Blocked { at: route[stop], reason: "unseen", needs }));
    }
    if let Some((change, value, passing)) = search.least_change(pawn, ends[1])?
        && let Some(route) = search.route(&passing, ends[1])?
        && let Some(stop) = own.leaves(&route)
    {
        return Ok(Some(Blocked { at: route[stop], reason: change.reason(), needs: change.needs(value) }));
    }
    let pixel_m = search.pixel_m();
    // A low pawn cannot climb high, so these exclude each other.
    for other in [Change::Headroom, Change::Step] {
        let changed = [Change::Width, other].into_iter().fold(*pawn, |pawn, change| {
            let value = change.range(&pawn, pixel_m)[1];
            change.apply(&pawn, value)
        });
        let Some(route) = search.route(&changed, ends[1])? else { continue };
        let Some(stop) = own.leaves(&route) else { continue };
        let beyond = search.stands_beyond(pawn, &route[stop..], &own)?.unwrap_or(ends[1]);
        let found = match search.least_change(pawn, beyond)? {
            Some((change, value, _)) => Some((change, value)),
            // Both measures are too large: the width that passes once the other one does not matter.
            None => {
                let eased = other.apply(pawn, other.range(pawn, pixel_m)[1]);
                search.bisect(&eased, Change::Width, beyond, None)?.map(|value| (Change::Width, value))
            }
        };
        let Some((change, value)) = found else { continue };
        return Ok(Some(Blocked { at: route[stop], reason: change.reason(), needs: change.needs(value) }));
    }
    search.missing_ground(pawn, &own)
}

impl Ways<'_> {
    fn standing(&self, pawn: &Pawn) -> Result<StandingPlaces, Failure> {
        match self.anywhere {
            true => Ok(StandingPlaces::new(&self.loader.snapshot(), *pawn)?),
            false => Ok(self.loader.standing(*pawn)?),
        }
    }

    /// Everything that a pawn reaches from `from`; `None` if it can stand nowhere near.
    fn reached(&self, pawn: &Pawn, from: Point3<f64>) -> Result<Option<Reached>, Failure> {
        let mut standing = self.standing(pawn)?;
        let start = self.loader.known(|view| standing.snapped(view, from, SNAP_M))?;
        let Some(start) = start else { return Ok(None) };
        let mut flood = Flood::from(start.spot);
        flood.within(self.ends.map(|end| end.xy()), self.length_m);
        self.loader.known(|view| flood.grow(&mut standing, view, &NoMonitor))?;
        Ok(Some(Reached { standing, flood, start }))
    }

    /// Whether a pawn gets from the start to `to`.
    fn connects(&self, pawn: &Pawn, to: Point3<f64>) -> Result<bool, Failure> {
        let Some(mut reached) = self.reached(pawn, self.ends[0])? else { return Ok(false) };
        let end = self.loader.known(|view| reached.standing.snapped(view, to, SNAP_M))?;
        let Some(end) = end else { return Ok(false) };
        if pawn.max_grade.is_infinite() {
            return Ok(reached.flood.holds(&reached.standing, &end.spot));
        }
        Ok(reached.region().stands_at(&end.spot))
    }

    /// The least single change with which the pawn gets to `to`, its value, and the pawn.
    fn least_change(&self, pawn: &Pawn, to: Point3<f64>) -> Result<Option<(Change, f64, Pawn)>, Failure> {
        let mut best: Option<(f64, Change, f64)> = None;
        for change in Change::ALL {
            let least = best.map(|(least, ..)| least);
            if let Some(value) = self.bisect(pawn, change, to, least)? {
                let share = change.share(pawn, value, self.pixel_m());
                if least.is_none_or(|least| share < least) {
                    best = Some((share, change, value));
                }
            }
        }
        Ok(best.map(|(_, change, value)| (change, value, change.apply(pawn, value))))
    }

    /// The value nearest to the pawn's own with which it gets to `to`; `None` if no value that is tried does. Ends early,
    /// with a value that passes, once the change is certain to be larger than the share `least`.
    fn bisect(&self, pawn: &Pawn, change: Change, to: Point3<f64>, least: Option<f64>) -> Result<Option<f64>, Failure> {
        let pixel_m = self.pixel_m();
        let [own, furthest] = change.range(pawn, pixel_m);
        let precision = match change {
            Change::Width => pixel_m / 2.0,
            Change::Headroom | Change::Step => PRECISION_M,
            Change::Slope => PRECISION_M / 10.0,
        };
        if (furthest - own).abs() < precision || !self.connects(&change.apply(pawn, furthest), to)? {
            return Ok(None);
        }
        let (mut blocked, mut passing) = (own, furthest);
        while (passing - blocked).abs() > precision
            && least.is_none_or(|least| change.share(pawn, blocked, pixel_m) < least)
        {
            let middle = passing.midpoint(blocked);
            match self.connects(&change.apply(pawn, middle), to)? {
                true => passing = middle,
                false => blocked = middle,
            }
        }
        Ok(Some(passing))
    }

    fn pixel_m(&self) -> f64 {
        self.loader.archive().frame().pixel_m()
    }

    /// Places along a pawn's way from the start to `to`, a pixel apart.
    fn route(&self, pawn: &Pawn, to: Point3<f64>) -> Result<Option<Vec<Point3<f64>>>, Failure> {
        let Some(mut reached) = self.reached(pawn, self.ends[0])? else { return Ok(None) };
        let Some(end) = self.loader.known(|view| reached.standing.snapped(view, to, SNAP_M))? else { return Ok(None) };
        let region = reached.region();
        let (mut search, start) = (Search::new(), reached.start.spot);
        let route = self.loader.known(|view| search.route(view, &region, &start, &end.spot, &NoMonitor))?;
        Ok(route.map(|route| self.places(&region, &route)))
    }

    /// Places along a route through a region, a pixel apart.
    fn places(&self, region: &Region, Route { points, .. }: &Route) -> Vec<Point3<f64>> {
        // A stretch is straight in plan only: between its ends it has the heights of the ground that it crosses.
        let ground = Ground::of(self.loader, region);
        let mut places = vec![points[0]];
        for pair in points.windows(2) {
            let steps = ((pair[1] - pair[0]).xy().norm() / self.pixel_m()).ceil().max(1.0);
            let mut level = pair[0].z;
            for n in 1..steps as usize {
                let mut place = pair[0] + (pair[1] - pair[0]) * (n as f64 / steps);
                level = ground.level([place.x, place.y], level);
                place.z = level;
                places.push(place);
            }
            places.push(pair[1]);
        }
        places
    }

    /// Where the way of a shorter pawn leaves what a pawn of this length reaches; `None` if the round pawn does not get to
    /// the end, either.
    fn too_long(&self, pawn: &Pawn, length: f64) -> Result<Option<Blocked>, Failure> {
        let Some(mut reached) = self.reached(pawn, self.ends[0])? else { return Ok(None) };
        let end = self.loader.known(|view| reached.standing.snapped(view, self.ends[1], SNAP_M))?;
        let (mut region, start) = (reached.region(), reached.start.spot);
        let Some(end) = end.filter(|end| region.stands_at(&end.spot)) else { return Ok(None) };
        let connects = |length: f64| -> Result<bool, Failure> {
            Ok(LongSearch::new(&region, length)?.reached(&[start], &NoMonitor)?.holds(&region, &end.spot))
        };
        let (mut blocked, mut passing) = (length, 2.0 * pawn.body.half().x);
        if !connects(passing)? {
            return Ok(None);
        }
        while blocked - passing > self.pixel_m() / 2.0 {
            let middle = passing.midpoint(blocked);
            match connects(middle)? {
                true => passing = middle,
                false => blocked = middle,
            }
        }
        let mut shorter = LongSearch::new(&region, passing)?;
        let Some(route) = self.loader.known(|view| shorter.route(view, &start, &end.spot, &NoMonitor))? else {
            return Ok(None);
        };
        let places = self.places(&region, &route);
        let own = LongSearch::new(&region, length)?.reached(&[start], &NoMonitor)?;
        region.keep_reached(&reached.standing, &own);
        let stop = Ground::of(self.loader, &region).leaves(&places);
        Ok(stop.map(|stop| Blocked { at: places[stop], reason: "length", needs: passing }))
    }

    /// The first place of a way at which the pawn can stand without having reached it.
    fn stands_beyond(&self, pawn: &Pawn, way: &[Point3<f64>], own: &Ground) -> Result<Option<Point3<f64>>, Failure> {
        let mut standing = self.standing(pawn)?;
        for place in way.iter().filter(|place| !own.holds(place)) {
            if self.loader.known(|view| standing.spot(view, *place))?.is_some() {
                return Ok(Some(*place));
            }
        }
        Ok(None)
    }

    /// Where what the pawn reaches from the start comes nearest to what it reaches from the end.
    fn missing_ground(&self, pawn: &Pawn, own: &Ground) -> Result<Option<Blocked>, Failure> {
        let Some(other) = self.reached(pawn, self.ends[1])? else { return Ok(None) };
        let beyond = Ground::of(self.loader, &other.region());
        let Some((at, needs)) = own.nearest(&beyond) else { return Ok(None) };
        // The ground is missing because it is deeper, or because nothing was scanned.
        let Some(mut reached) = self.reached(pawn, self.ends[0])? else { return Ok(None) };
        let region = reached.region();
        let mut search = LeakSearch::new(&region);
        let leaks = self.loader.known(|view| search.find(&mut reached.standing, view))?;
        let nearest = leaks.iter().min_by(|a, b| (a.at - at).norm().total_cmp(&(b.at - at).norm()));
        let is_deeper = nearest.is_some_and(|leak| leak.kind == LeakKind::Ledge || leak.drop.is_some());
        Ok(Some(Blocked { at, reason: if is_deeper { "gap" } else { "unseen" }, needs }))
    }
}

/// Places that a pawn reaches, by pixel and by cell.
struct Ground {
    pixel_m: f64,
    climb: f64,
    pixels: HashMap<[i64; 2], Vec<f64>>,
    cells: HashMap<[i64; 2], Vec<Point3<f64>>>,
}

impl Ground {
    fn of(loader: &Loader, region: &Region) -> Self {
        let pixel_m = loader.archive().frame().pixel_m();
        let mut ground = Self { pixel_m, climb: region.pawn().climb, pixels: HashMap::new(), cells: HashMap::new() };
        for place in region.places() {
            let at = ground.pixel(place.feet.x, place.feet.y);
            ground.pixels.entry(at).or_default().push(place.feet.z);
            ground.cells.entry(cell(&place.feet)).or_default().push(place.feet);
        }
        ground
    }

    fn pixel(&self, x: f64, y: f64) -> [i64; 2] {
        [x, y].map(|v| (v / self.pixel_m).floor() as i64)
    }

    /// Height of the ground at a place (m): the one nearest to `near`, or `near` where nothing is reached.
    fn level(&self, [x, y]: [f64; 2], near: f64) -> f64 {
        let all = self.pixels.get(&self.pixel(x, y)).into_iter().flatten().copied();
        all.min_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs())).unwrap_or(near)
    }

    /// Whether the place is reached.
    fn holds(&self, at: &Point3<f64>) -> bool {
        let all = self.pixels.get(&self.pixel(at.x, at.y));
        all.is_some_and(|all| all.iter().any(|z| (z - at.z).abs() <= self.climb.max(self.pixel_m)))
    }

    /// Index of the place of a way after which the way is no longer on this ground.
    fn leaves(&self, way: &[Point3<f64>]) -> Option<usize> {
        let last = way.iter().rposition(|place| self.holds(place))?;
        (last + 1 < way.len()).then_some(last)
    }

    /// The place of this ground that is nearest to another ground in plan, and the distance between them (m).
    fn nearest(&self, other: &Self) -> Option<(Point3<f64>, f64)> {
        let mut best: Option<(Point3<f64>, f64)> = None;
        let mut pairs: Vec<(i64, [i64; 2], [i64; 2])> = Vec::new();
        for own in self.cells.keys() {
            for beyond in other.cells.keys() {
                let far = (own[0] - beyond[0]).abs().max((own[1] - beyond[1]).abs());
                pairs.push((far, *own, *beyond));
            }
        }
        pairs.sort_unstable();
        for (far, own, beyond) in pairs {
            let least = (far - 1).max(0) as f64 * CELL_M;
            if best.is_some_and(|(_, distance)| distance <= least) {
                break;
            }
            for (a, b) in self.cells[&own].iter().flat_map(|a| other.cells[&beyond].iter().map(move |b| (a, b))) {
                let distance = (a - b).xy().norm();
                if best.is_none_or(|(_, best)| distance < best) {
                    best = Some((*a, distance));
                }
            }
        }
        best
    }
}

fn cell(at: &Point3<f64>) -> [i64; 2] {
    [at.x, at.y].map(|v| (v / CELL_M).floor() as i64)
}
