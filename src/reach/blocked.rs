//! Why no route connects two places: where the best way stops, and what would pass.
//!
//! The pawn is changed in one respect at a time (narrower, lower, a higher step, a steeper grade, a longer ramp), by
//! bisection to the least change with which the end is reached. The least of these changes, as a share of the pawn's own measure, is the
//! reason; the place is where the way of the changed pawn leaves what the pawn itself reaches. If no single change helps,
//! a narrow pawn that is also low, or climbs high, finds a way; the reason is then the least change that leads past the
//! first place where this way leaves what the pawn reaches, or the width that passes there once the other measure does
//! not matter. If that fails, too, a wall has no way through, or ground is missing: where what is reached from the start
//! comes nearest to what is reached from the end.
//!
//! A long pawn that does not get where the round one does is too long: the length is bisected in what the round one
//! reaches.
//!
//! A pawn that must stay in seen space is first tried without that: if it then gets through, the reason is unseen ground.
//!
//! Where steps lead to the end but no walker gets there, the place is where walkers stop on the shortest path, and the
//! reason is the least change with which they get to the end.
//!
//! Ways are looked for within an ellipse around both ends.

use super::{Flood, LeakKind, LeakSearch, LongSearch, Pawn, Region, Route, Search, Snapped, StandingPlaces};
use crate::query::{Aabb, Answer, sweep};
use crate::seen::SeenSpace;
use crate::store::{Missing, Snapshot};
use crate::walk::Body;
use crate::{Error, Monitor, Result};
use nalgebra::{Point3, Vector3};
use std::collections::{BTreeMap, HashMap};
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

/// Ways are at most this many times as long as the straight line, plus a detour (m).
const LONGEST: f64 = 2.0;
const DETOUR_M: f64 = 30.0;
/// Least height of a body, or half of its own if that is less; and least height above the climb height (m).
const LOWEST_M: f64 = 0.3;
const ABOVE_CLIMB_M: f64 = 0.05;
/// Steepest grade that is tried.
const STEEPEST: f64 = 2.0;
/// Highest step that is tried (m).
const HIGHEST_STEP_M: f64 = 3.0;
/// Longest ramp that is tried (m).
const LONGEST_RAMP_M: f64 = 1000.0;
/// Precision of steps and headroom, and of ramps (m).
const PRECISION_M: f64 = 0.01;
const RAMP_PRECISION_M: f64 = 0.1;
/// How far a changed pawn may be moved to stand at an end (m).
const SNAP_M: f64 = 0.5;
/// Cell in which the nearest ground is looked for (m), edge of a block of them, and cells between two checks of the monitor.
const CELL_M: f64 = 1.0;
const BLOCK: i64 = 16;
const BETWEEN_LOOKS: usize = 1 << 16;

/// Reason why a pawn does not get to its goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Reason {
    /// It is too wide.
    Width,
    /// A [long pawn](LongSearch) is too long to pass or to turn.
    Length,
    /// It is too high.
    Headroom,
    /// A step is higher than it climbs.
    Step,
    /// The ground is steeper than it walks.
    Slope,
    /// A ramp is longer than it goes without a landing.
    Ramp,
    /// The ground between is deeper than it steps down, or a wall without a way through.
    Gap,
    /// The ground between was not scanned, or no scanner saw the pawn there and it must stay in seen space.
    Unseen,
}

impl Reason {
    /// Returns the name that `slicetool route` writes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Width => "width",
            Self::Length => "length",
            Self::Headroom => "headroom",
            Self::Step => "step",
            Self::Slope => "slope",
            Self::Ramp => "ramp",
            Self::Gap => "gap",
            Self::Unseen => "unseen",
        }
    }
}

/// Place where the best way of a pawn stops, and the measure that would pass.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Obstruction {
    /// The last place that the pawn reaches (m).
    pub at: Point3<f64>,
    /// The measure of the pawn, or the lack of ground, that stops it.
    pub reason: Reason,
    /// With the pawn's other measures as they are: the width along its shorter side, the length or the height of the
    /// largest pawn that passes, the height of the step to climb (with drops as deep, if the pawn's drops are as deep as
    /// its steps) or the length of a ramp without a landing (m), all found by bisection and known to pass; the [steepest
    /// grade](Pawn::max_grade) that passes; or the distance to the ground that leads to the goal (m).
    pub needs: f64,
}

/// State of an [`ObstructionSearch`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Sought {
    /// The obstruction; `None` if the pawn gets from one place to the other, cannot stand at one of them, or if nothing
    /// was found.
    Done(Option<Obstruction>),
    /// These pages are needed: load them and continue.
    NotLoaded(Missing),
    /// The search is not finished: continue when there is time.
    Unfinished,
}

/// Search for what keeps a pawn from getting from one place to another, for pawns that a [`Planner`](super::Planner)
/// answered [`NotConnected`](super::Refusal::NotConnected).
///
/// The reason is the smallest change, relative to the pawn's own measure, that opens a way of at most twice the straight
/// distance plus 30 m. If no single change helps, it is the least one that leads past the first obstacle; for a door both
/// narrow and low, or narrow and high, the width.
///
/// It does no I/O and reads no clock, and dropping it ends the search. It takes the time of up to about 25 floods of that
/// ellipse, and the memory of one at a time with its [`StandingPlaces`], of a [`Region`] with a route, and of some 50 bytes
/// for each place that the pawn reaches.
///
/// ```
/// use nalgebra::Point3;
/// use slicewalk::NoMonitor;
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::reach::{ObstructionSearch, Pawn, Reason, Sought};
/// use slicewalk::store::Snapshot;
/// use slicewalk::walk::Body;
///
/// let mut builder = PageBuilder::default();
/// for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
///     // A floor of 3.2 × 3.2 m, and across it a wall with a door of 0.45 m.
///     let is_wall = px == 32 && !(30..39).contains(&py);
///     let span = if is_wall { Span::new(0, 5000, true) } else { Span::new(0, 10, false) };
///     assert!(builder.set_column(px, py, &[span.unwrap()]));
/// }
/// let key = PageKey { tx: 0, ty: 0, layer: 0 };
/// let store = Snapshot::from_pages(Frame::new(0.05, 0.15)?, [(key, builder.build())]);
///
/// let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
/// let (from, to) = (Point3::new(0.5, 1.7, 0.1), Point3::new(2.7, 1.7, 0.1));
/// let mut search = ObstructionSearch::new(&store, pawn, from, to, &NoMonitor)?;
/// let found = loop {
///     match search.advance(&store)? {
///         Sought::Done(found) => break found.expect("the door is too narrow"),
///         Sought::NotLoaded(missing) => panic!("{missing:?}"), // load these pages, and give the new snapshot
///         _ => {}
///     }
/// };
/// assert!(found.reason == Reason::Width && (found.needs - 0.45).abs() < 0.03);
/// # Ok::<(), slicewalk::Error>(())
/// ```
pub struct ObstructionSearch<'a> {
    ways: Ways<'a>,
    running: Option<Running<'a>>,
}

/// A search that has begun. It is plain code that asks one question after the other, and a future only so that it can stop
/// within a question for which pages are missing, and continue from there: it waits for nothing else, and only
/// [`ObstructionSearch::advance`] polls it.
type Running<'a> = Pin<Box<dyn Future<Output = Result<Option<Obstruction>>> + Send + 'a>>;

impl std::fmt::Debug for ObstructionSearch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Ways { pawn, ends, length, .. } = &self.ways;
        let mut text = f.debug_struct("ObstructionSearch");
        text.field("pawn", pawn).field("ends", ends).field("length", length).finish_non_exhaustive()
    }
}

impl<'a> ObstructionSearch<'a> {
    /// Creates a search between two places (m); in the air, the floor below counts. `monitor` can end it. Fails like
    /// [`StandingPlaces::new`] for an invalid pawn or a set of pages that is too large.
    pub fn new(
        set: &Snapshot,
        pawn: Pawn,
        from: Point3<f64>,
        to: Point3<f64>,
        monitor: &'a dyn Monitor,
    ) -> Result<Self> {
        let pixel_m = StandingPlaces::new(set, pawn)?.grid.frame.pixel_m();
        let ways = Ways {
            exchange: Arc::default(),
            monitor,
            pawn,
            length: None,
            ends: [from, to],
            seen: None,
            pixel_m,
            is_walked: false,
        };
        Ok(Self { ways, running: None })
    }

    /// Keeps the pawn within seen space; see [`StandingPlaces::within_seen`]. Call it before anything else.
    #[must_use]
    pub fn within_seen(self, seen: Option<Arc<SeenSpace>>) -> Self {
        Self { ways: Ways { seen, ..self.ways }, ..self }
    }

    /// Searches for a pawn drawn out to `length` (m); see [`LongSearch`]. Call it before anything else. An unfit length is
    /// an error of the search if the round pawn gets through.
    #[must_use]
    pub fn drawn_out(self, length: Option<f64>) -> Self {
        Self { ways: Ways { length, ..self.ways }, ..self }
    }

    /// Continues to the end of one question, such as a flood or a route, or until pages are missing: load them and call
    /// again. After the end or an error, the next call starts again from the beginning. Fails if the monitor asks to stop, or if a tile holds
    /// more spans than any scan has ([`Error::Limit`](crate::Error::Limit)).
    pub fn advance(&mut self, set: &Snapshot) -> Result<Sought> {
        *lock(&self.ways.exchange) = Exchange { set: Some(set.clone()), missing: None };
        let running = self.running.get_or_insert_with(|| Box::pin(self.ways.clone().obstruction()));
        let polled = running.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        // Pages that were evicted since would stay in memory with their snapshot.
        let missing = std::mem::take(&mut *lock(&self.ways.exchange)).missing;
        match polled {
            Poll::Ready(found) => {
                self.running = None;
                found.map(Sought::Done)
            }
            Poll::Pending => Ok(missing.map_or(Sought::Unfinished, Sought::NotLoaded)),
        }
    }
}

/// Pages of the moment, and those that the search misses among them: all that passes between a search and its caller.
#[derive(Default)]
struct Exchange {
    set: Option<Snapshot>,
    missing: Option<Missing>,
}

fn lock(exchange: &Mutex<Exchange>) -> MutexGuard<'_, Exchange> {
    exchange.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Places that a pawn reaches from a start.
struct Reached {
    standing: StandingPlaces,
    flood: Flood,
    start: Snapped,
}

impl Reached {
    /// The places with their steps, without ground that is too steep and what lies beyond it.
    fn region(&self) -> Region {
        let mut region = self.flood.region(&self.standing);
        region.keep_linked(&self.standing, &[self.start.spot]);
        region
    }
}

/// A respect in which a pawn is changed.
#[derive(Clone, Copy)]
enum Change {
    Width,
    Headroom,
    Step,
    Slope,
    Ramp,
}

impl Change {
    const ALL: [Self; 5] = [Self::Width, Self::Headroom, Self::Step, Self::Slope, Self::Ramp];

    /// The measure of the pawn, and the value furthest from it that is tried.
    fn range(self, pawn: &Pawn, pixel_m: f64) -> [f64; 2] {
        let half = pawn.body.half();
        match self {
            Self::Width => [2.0 * half.min(), pixel_m.min(2.0 * half.min()) * half.min() / half.max()],
            Self::Headroom => {
                let height = pawn.body.height();
                let lowest = LOWEST_M.min(height / 2.0).max(pawn.climb + ABOVE_CLIMB_M);
                [height, lowest.min(height)]
            }
            Self::Step => [pawn.climb, (pawn.body.height() - ABOVE_CLIMB_M).min(HIGHEST_STEP_M).max(pawn.climb)],
            Self::Slope if pawn.max_grade.is_finite() => [pawn.max_grade, STEEPEST],
            Self::Ramp if pawn.max_ramp.is_finite() => [pawn.max_ramp, LONGEST_RAMP_M],
            Self::Slope | Self::Ramp => [0.0; 2],
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
            (Self::Step | Self::Slope | Self::Ramp, body) => body,
        };
        match self {
            // A pawn that takes drops as deep as its steps keeps to that, or it would not get back.
            Self::Step if pawn.max_drop == pawn.climb => Pawn { climb: value, max_drop: value, ..*pawn },
            Self::Step => Pawn { climb: value, ..*pawn },
            Self::Slope => Pawn { max_grade: value, ..*pawn },
            Self::Ramp => Pawn { max_ramp: value, ..*pawn },
            _ => Pawn { body, ..*pawn },
        }
    }

    fn reason(self) -> Reason {
        match self {
            Self::Width => Reason::Width,
            Self::Headroom => Reason::Headroom,
            Self::Step => Reason::Step,
            Self::Slope => Reason::Slope,
            Self::Ramp => Reason::Ramp,
        }
    }

    /// Returns the change to `value` as a share of the pawn's own measure.
    fn share(self, pawn: &Pawn, value: f64, pixel_m: f64) -> f64 {
        let own = self.range(pawn, pixel_m)[0];
        (value - own).abs() / own.max(PRECISION_M)
    }
}

/// The search, and what it asks.
#[derive(Clone)]
struct Ways<'a> {
    exchange: Arc<Mutex<Exchange>>,
    monitor: &'a dyn Monitor,
    pawn: Pawn,
    /// Length of a long pawn (m).
    length: Option<f64>,
    ends: [Point3<f64>; 2],
    /// Space in which the pawn must stay.
    seen: Option<Arc<SeenSpace>>,
    pixel_m: f64,
    /// Whether a pawn gets only where walkers have followed a route.
    is_walked: bool,
}

impl Ways<'_> {
    /// Repeats `ask` until it knows the answer. Each time that pages are missing, and once more with the answer, the
    /// search stops for the caller.
    async fn known<T>(&self, mut ask: impl FnMut(&Snapshot) -> Result<Answer<T>>) -> Result<T> {
        let mut found = None;
        poll_fn(|_| {
            if let Some(found) = found.take() {
                return Poll::Ready(found);
            }
            let Some(set) = lock(&self.exchange).set.clone() else { return Poll::Pending };
            match ask(&set) {
                Ok(Answer::Known(value)) => found = Some(Ok(value)),
                Ok(Answer::NotLoaded(missing)) => lock(&self.exchange).missing = Some(missing),
                Err(error) => return Poll::Ready(Err(error)),
            }
            Poll::Pending
        })
        .await
    }

    async fn obstruction(mut self) -> Result<Option<Obstruction>> {
        let Some(ends) = self.feet().await? else { return Ok(None) };
        self.ends = ends;
        let pawn = self.pawn;
        if let Some(length) = self.length
            && let Some(found) = self.too_long(&pawn, length).await?
        {
            return Ok(Some(found));
        }
        let Some(own) = self.own_ground().await? else { return self.stopped().await };
        if let Some(seen) = &self.seen
            && let Some(route) = (Ways { seen: None, ..self.clone() }).route(&pawn, ends[1]).await?
            && let Some(stop) = own.leaves(&route)
        {
            let is_seen = |feet: &Point3<f64>| seen.is_pawn_seen(*feet, pawn.climb, pawn.body.height());
            let beyond = route[stop + 1..].iter().skip_while(|feet| is_seen(feet)).find(|feet| is_seen(feet));
            let needs = (beyond.unwrap_or(&ends[1]) - route[stop]).norm();
            return Ok(Some(Obstruction { at: route[stop], reason: Reason::Unseen, needs }));
        }
        let mut least = self.least_change(&pawn, ends[1]).await?;
        if least.is_none() && pawn.max_ramp.is_finite() {
            // A steep ramp may be long, too: the grade is the reason.
            least = self.least_change(&Pawn { max_ramp: f64::INFINITY, ..pawn }, ends[1]).await?;
        }
        if let Some((change, needs, passing)) = least
            && let Some(route) = self.route(&passing, ends[1]).await?
            && let Some(stop) = own.leaves(&route)
        {
            return Ok(Some(Obstruction { at: route[stop], reason: change.reason(), needs }));
        }
        // A low pawn cannot climb high, so these exclude each other.
        for other in [Change::Headroom, Change::Step] {
            let changed = [Change::Width, other].into_iter().fold(pawn, |pawn, change| {
                let value = change.range(&pawn, self.pixel_m)[1];
                change.apply(&pawn, value)
            });
            let Some(route) = self.route(&changed, ends[1]).await? else { continue };
            let Some(stop) = own.leaves(&route) else { continue };
            let beyond = self.stands_beyond(&pawn, &route[stop..], &own).await?.unwrap_or(ends[1]);
            let found = match self.least_change(&pawn, beyond).await? {
                Some((change, value, _)) => Some((change, value)),
                // Both measures are too large: the width that passes once the other one is free.
                None => {
                    let eased = other.apply(&pawn, other.range(&pawn, self.pixel_m)[1]);
                    self.bisect(&eased, Change::Width, beyond, None).await?.map(|value| (Change::Width, value))
                }
            };
            let Some((change, needs)) = found else { continue };
            return Ok(Some(Obstruction { at: route[stop], reason: change.reason(), needs }));
        }
        self.missing_ground(&pawn, &own).await
    }

    /// The places at the ends where the pawn stands; `None` if it cannot stand at one of them.
    async fn feet(&self) -> Result<Option<[Point3<f64>; 2]>> {
        let (mut standing, mut feet) = (self.standing(&self.pawn).await?, self.ends);
        for end in &mut feet {
            let Some(found) = self.known(|set| standing.snapped(set, *end, 0.0)).await? else { return Ok(None) };
            *end = found.feet;
        }
        Ok(Some(feet))
    }

    /// Where walkers stop although steps lead to the end: between two places they may meet what neither place shows.
    /// `None` if they get to the end.
    async fn stopped(mut self) -> Result<Option<Obstruction>> {
        let (pawn, [start, end]) = (self.pawn, self.ends);
        let Some(mut reached) = self.reached(&pawn, start).await? else { return Ok(None) };
        let Some(end_place) = self.known(|set| reached.standing.snapped(set, end, SNAP_M)).await? else {
            return Ok(None);
        };
        let (region, mut search) = (reached.region(), Search::new());
        let route =
            self.known(|set| search.route(set, &region, &reached.start.spot, &end_place.spot, self.monitor)).await?;
        let Some(at) = search.stopped_at().filter(|_| route.is_none()).map(|place| region.feet(place)) else {
            return Ok(None);
        };
        drop((reached, region, search));
        self.is_walked = true;
        Ok(Some(match self.least_change(&pawn, end).await? {
            Some((change, needs, _)) => Obstruction { at, reason: change.reason(), needs },
            None => Obstruction { at, reason: Reason::Gap, needs: (end - at).norm() },
        }))
    }

    /// The ground that the pawn itself reaches; `None` if the end is on it.
    async fn own_ground(&self) -> Result<Option<Ground>> {
        let Some(mut reached) = self.reached(&self.pawn, self.ends[0]).await? else { return Ok(None) };
        let end = self.known(|set| reached.standing.snapped(set, self.ends[1], SNAP_M)).await?;
        let region = reached.region();
        Ok(end.is_none_or(|end| !region.stands_at(&end.spot)).then(|| Ground::of(&region)))
    }

    async fn standing(&self, pawn: &Pawn) -> Result<StandingPlaces> {
        let standing = self.known(|set| Ok(Answer::Known(StandingPlaces::new(set, *pawn)?))).await?;
        Ok(standing.within_seen(self.seen.clone()))
    }

    /// Everything that a pawn reaches from `from`; `None` if it can stand nowhere near.
    async fn reached(&self, pawn: &Pawn, from: Point3<f64>) -> Result<Option<Reached>> {
        let mut standing = self.standing(pawn).await?;
        let Some(start) = self.known(|set| standing.snapped(set, from, SNAP_M)).await? else { return Ok(None) };
        let mut flood = Flood::from(start.spot);
        let straight = (self.ends[1] - self.ends[0]).xy().norm();
        flood.within(self.ends.map(|end| end.xy()), LONGEST * straight + DETOUR_M);
        self.known(|set| flood.grow(&mut standing, set, self.monitor)).await?;
        Ok(Some(Reached { standing, flood, start }))
    }

    /// Returns whether a pawn gets from the start to `to`.
    async fn connects(&self, pawn: &Pawn, to: Point3<f64>) -> Result<bool> {
        if self.is_walked {
            return Ok(self.route(pawn, to).await?.is_some());
        }
        let Some(mut reached) = self.reached(pawn, self.ends[0]).await? else { return Ok(false) };
        let end = self.known(|set| reached.standing.snapped(set, to, SNAP_M)).await?;
        let Some(end) = end else { return Ok(false) };
        if pawn.max_grade.is_infinite() && pawn.max_ramp.is_infinite() {
            return Ok(reached.flood.holds(&reached.standing, &end.spot));
        }
        Ok(reached.region().stands_at(&end.spot))
    }

    /// The least single change with which the pawn gets to `to`, its value, and the pawn.
    async fn least_change(&self, pawn: &Pawn, to: Point3<f64>) -> Result<Option<(Change, f64, Pawn)>> {
        let mut best: Option<(f64, Change, f64)> = None;
        for change in Change::ALL {
            let least = best.map(|(least, ..)| least);
            if let Some(value) = self.bisect(pawn, change, to, least).await? {
                let share = change.share(pawn, value, self.pixel_m);
                if least.is_none_or(|least| share < least) {
                    best = Some((share, change, value));
                }
            }
        }
        Ok(best.map(|(_, change, value)| (change, value, change.apply(pawn, value))))
    }

    /// The value nearest to the pawn's own with which it gets to `to`; `None` if no value that is tried does. Ends early,
    /// with a value that passes, once the change is certain to be larger than the share `least`.
    async fn bisect(&self, pawn: &Pawn, change: Change, to: Point3<f64>, least: Option<f64>) -> Result<Option<f64>> {
        let [own, furthest] = change.range(pawn, self.pixel_m);
        let precision = match change {
            Change::Width => self.pixel_m / 2.0,
            Change::Headroom | Change::Step => PRECISION_M,
            Change::Slope => PRECISION_M / 10.0,
            Change::Ramp => RAMP_PRECISION_M,
        };
        if (furthest - own).abs() < precision || !self.connects(&change.apply(pawn, furthest), to).await? {
            return Ok(None);
        }
        let (mut blocked, mut passing) = (own, furthest);
        while (passing - blocked).abs() > precision
            && least.is_none_or(|least| change.share(pawn, blocked, self.pixel_m) < least)
        {
            let middle = passing.midpoint(blocked);
            match self.connects(&change.apply(pawn, middle), to).await? {
                true => passing = middle,
                false => blocked = middle,
            }
        }
        Ok(Some(passing))
    }

    /// Places along a pawn's way from the start to `to`, a pixel apart.
    async fn route(&self, pawn: &Pawn, to: Point3<f64>) -> Result<Option<Vec<Point3<f64>>>> {
        let Some(mut reached) = self.reached(pawn, self.ends[0]).await? else { return Ok(None) };
        let end = self.known(|set| reached.standing.snapped(set, to, SNAP_M)).await?;
        let Some(end) = end else { return Ok(None) };
        let region = reached.region();
        let (mut search, start) = (Search::new(), reached.start.spot);
        let route = self.known(|set| search.route(set, &region, &start, &end.spot, self.monitor)).await?;
        Ok(route.map(|route| places(&region, &route)))
    }

    /// Finds where the way of a shorter pawn leaves what a pawn of this length reaches; `None` if the round pawn does not get to
    /// the end, either.
    async fn too_long(&self, pawn: &Pawn, length: f64) -> Result<Option<Obstruction>> {
        let Some(mut reached) = self.reached(pawn, self.ends[0]).await? else { return Ok(None) };
        let end = self.known(|set| reached.standing.snapped(set, self.ends[1], SNAP_M)).await?;
        let (mut region, start) = (reached.region(), reached.start.spot);
        let Some(end) = end.filter(|end| region.stands_at(&end.spot)) else { return Ok(None) };
        let connects = |length: f64| -> Result<bool> {
            Ok(LongSearch::new(&region, length)?.reached(&[start], self.monitor)?.holds(&region, &end.spot))
        };
        let (mut blocked, mut passing) = (length, 2.0 * pawn.body.half().x);
        if !connects(passing)? {
            return Ok(None);
        }
        while blocked - passing > self.pixel_m / 2.0 {
            let middle = passing.midpoint(blocked);
            match connects(middle)? {
                true => passing = middle,
                false => blocked = middle,
            }
        }
        let mut shorter = LongSearch::new(&region, passing)?;
        let route = self.known(|set| shorter.route(set, &start, &end.spot, self.monitor)).await?;
        let Some(route) = route else { return Ok(None) };
        let places = places(&region, &route);
        let own = LongSearch::new(&region, length)?.reached(&[start], self.monitor)?;
        region.keep_reached(&reached.standing, &own);
        let stop = Ground::of(&region).leaves(&places);
        Ok(stop.map(|stop| Obstruction { at: places[stop], reason: Reason::Length, needs: passing }))
    }

    /// The first place of a way at which the pawn can stand without having reached it.
    async fn stands_beyond(&self, pawn: &Pawn, way: &[Point3<f64>], own: &Ground) -> Result<Option<Point3<f64>>> {
        let mut standing = self.standing(pawn).await?;
        for place in way.iter().filter(|place| !own.holds(place)) {
            if self.known(|set| standing.spot(set, *place)).await?.is_some() {
                return Ok(Some(*place));
            }
        }
        Ok(None)
    }

    /// Finds where what the pawn reaches from the start comes nearest to what it reaches from the end.
    async fn missing_ground(&self, pawn: &Pawn, own: &Ground) -> Result<Option<Obstruction>> {
        let nearest = match self.reached(pawn, self.ends[1]).await? {
            Some(beyond) => own.nearest(&Ground::of(&beyond.region()), &self.ends, self.monitor)?,
            None => None,
        };
        let Some(([at, to], needs)) = nearest else { return Ok(None) };
        if self.is_walled(pawn, at, to).await? {
            return Ok(Some(Obstruction { at, reason: Reason::Gap, needs }));
        }
        // The ground is missing because it is deeper, or because nothing was scanned.
        let Some(mut reached) = self.reached(pawn, self.ends[0]).await? else { return Ok(None) };
        let region = reached.region();
        let mut search = LeakSearch::new(&region);
        let leaks = self.known(|set| search.find(&mut reached.standing, set)).await?;
        let nearest = leaks.iter().min_by(|a, b| (a.at - at).norm().total_cmp(&(b.at - at).norm()));
        let is_deeper = nearest.is_some_and(|leak| leak.kind == LeakKind::Ledge || leak.drop.is_some());
        Ok(Some(Obstruction { at, reason: if is_deeper { Reason::Gap } else { Reason::Unseen }, needs }))
    }

    /// Whether something solid stands between two places, at a height at which the body would pass from one to the other.
    async fn is_walled(&self, pawn: &Pawn, at: Point3<f64>, to: Point3<f64>) -> Result<bool> {
        let (low, high) = (at.z.max(to.z) + pawn.climb, at.z.min(to.z) + pawn.body.height());
        if low >= high {
            return Ok(false);
        }
        let upright = Aabb::new(Point3::new(at.x, at.y, low), Point3::new(at.x, at.y, high))?;
        let by = (to - at).xy().push(0.0);
        Ok(self.known(|set| Ok(sweep(set, &upright, by))).await?.is_some())
    }
}

/// Places along a route through a region, a pixel apart.
fn places(region: &Region, Route { points, .. }: &Route) -> Vec<Point3<f64>> {
    // A stretch has the heights of the ground that it crosses, which its line follows.
    let ground = Ground::of(region);
    let mut places = vec![points[0]];
    for pair in points.windows(2) {
        let steps = ((pair[1] - pair[0]).xy().norm() / ground.pixel_m).ceil().max(1.0);
        for n in 1..steps as usize {
            let mut place = pair[0] + (pair[1] - pair[0]) * (n as f64 / steps);
            place.z = ground.level(&place);
            places.push(place);
        }
        places.push(pair[1]);
    }
    places
}

/// Places that a pawn reaches, by pixel and by cell.
struct Ground {
    pixel_m: f64,
    climb: f64,
    pixels: HashMap<[i64; 2], Vec<f64>>,
    cells: HashMap<[i64; 2], Cell>,
}

/// Places in a square of the plan, and the lowest and highest of their coordinates.
#[derive(Default)]
struct Cell {
    places: Vec<Point3<f64>>,
    bounds: Option<[Point3<f64>; 2]>,
}

impl Cell {
    fn of(place: Point3<f64>) -> Self {
        Self { places: vec![place], bounds: Some([place; 2]) }
    }

    fn add(&mut self, place: Point3<f64>) {
        self.places.push(place);
        let [low, high] = self.bounds.unwrap_or([place; 2]);
        self.bounds = Some([low.inf(&place), high.sup(&place)]);
    }

    /// Returns a distance that no place of this cell falls below to one of the `other` (m).
    fn least_distance(&self, other: &Self) -> f64 {
        let (Some([low, high]), Some([from, to])) = (self.bounds, other.bounds) else { return f64::INFINITY };
        (low - to).sup(&(from - high)).sup(&Vector3::zeros()).norm()
    }
}

impl Ground {
    fn of(region: &Region) -> Self {
        let pixel_m = region.grid.frame.pixel_m();
        let mut ground = Self { pixel_m, climb: region.pawn().climb, pixels: HashMap::new(), cells: HashMap::new() };
        for place in region.places() {
            let at = ground.pixel(place.feet.x, place.feet.y);
            ground.pixels.entry(at).or_default().push(place.feet.z);
            ground.cells.entry(cell(&place.feet)).or_default().add(place.feet);
        }
        ground
    }

    fn pixel(&self, x: f64, y: f64) -> [i64; 2] {
        [x, y].map(|v| (v / self.pixel_m).floor() as i64)
    }

    /// Heights of the ground at a place (m), without the storeys above and below.
    fn levels(&self, at: &Point3<f64>) -> impl Iterator<Item = f64> {
        let (z, off) = (at.z, self.climb.max(self.pixel_m));
        let all = self.pixels.get(&self.pixel(at.x, at.y)).into_iter().flatten().copied();
        all.filter(move |level| (level - z).abs() <= off)
    }

    /// Height of the ground at a place of a line along it (m): that of the line where only the edge of a step lies.
    fn level(&self, at: &Point3<f64>) -> f64 {
        self.levels(at).min_by(|a, b| (a - at.z).abs().total_cmp(&(b - at.z).abs())).unwrap_or(at.z)
    }

    /// Returns whether the place is reached.
    fn holds(&self, at: &Point3<f64>) -> bool {
        self.levels(at).next().is_some()
    }

    /// Index of the place of a way after which the way is no longer on this ground: its start if that is too steep.
    fn leaves(&self, way: &[Point3<f64>]) -> Option<usize> {
        let last = way.iter().rposition(|place| self.holds(place)).unwrap_or(0);
        (last + 1 < way.len()).then_some(last)
    }

    /// The place of this ground that is nearest to another ground, to within half a pixel, and the place there; of
    /// several, such as along a wall, the one on the shortest way between two `ends`. Also the least distance between the
    /// grounds (m). Fails only if `monitor` asks to stop.
    fn nearest(
        &self,
        other: &Self,
        ends: &[Point3<f64>; 2],
        monitor: &dyn Monitor,
    ) -> Result<Option<([Point3<f64>; 2], f64)>> {
        let (blocks, beyond) = (self.blocks(), other.blocks());
        let (Some(own), Some(all)) = (around(&blocks), around(&beyond)) else { return Ok(None) };
        // How far the other ground is at least: in cells along x or y, and in metres.
        let away = |own: &Extent| {
            let gaps = beyond.values().map(|other| gaps(own, other));
            let cells = gaps.clone().map(|[x, y]| x.max(y)).min().unwrap_or(0);
            (cells, gaps.map(metres).fold(f64::INFINITY, f64::min))
        };
        let least: BTreeMap<[i64; 2], (i64, f64)> = blocks.iter().map(|(at, own)| (*at, away(own))).collect();
        let mut cells: Vec<(&[i64; 2], (i64, f64))> = self.cells.keys().map(|at| (at, least[&block(at)])).collect();
        cells.sort_unstable_by_key(|(at, _)| *at);
        let nearest = least.values().map(|least| least.0).min().unwrap_or(0);
        let furthest = (0..2).map(|axis| (all[1][axis] - own[0][axis]).max(own[1][axis] - all[0][axis])).max();
        let (mut best, mut looks): (Option<f64>, usize) = (None, 0);
        // The cells of the other ground that are `far` cells away, then those farther off.
        for far in nearest..=furthest.unwrap_or(0) {
            if best.is_some_and(|best| best <= (far - 1).max(0) as f64 * CELL_M) {
                break;
            }
            // To ask all blocks pays if they are few, compared with the cells that far away.
            let is_worth_it = (beyond.len() as i64) < 64 * far;
            for &(at, least) in &cells {
                let is_off = |(cells, metres): (i64, f64)| cells > far || best.is_some_and(|best| best < metres);
                if is_off(least) || is_worth_it && is_off(away(&[*at; 2])) {
                    continue;
                }
                let own = &self.cells[at];
                for to in ring(at, far, &all) {
                    looks += 1;
                    if looks.is_multiple_of(BETWEEN_LOOKS) && monitor.cancelled() {
                        return Err(Error::Interrupted);
                    }
                    let Some(beyond) = other.cells.get(&to) else { continue };
                    if best.is_some_and(|best| best <= own.least_distance(beyond)) {
                        continue;
                    }
                    for (a, b) in own.places.iter().flat_map(|a| beyond.places.iter().map(move |b| (a, b))) {
                        let distance = (a - b).norm();
                        if best.is_none_or(|best| distance < best) {
                            best = Some(distance);
                        }
                    }
                }
            }
        }
        let Some(best) = best else { return Ok(None) };
        let most = best + self.pixel_m / 2.0;
        let from_ends = ends.map(Cell::of);
        let bound = |cell: &Cell| from_ends.iter().map(|end| end.least_distance(cell)).sum::<f64>();
        let near = cells.into_iter().filter(|(_, (_, metres))| *metres <= most);
        let mut cells: Vec<(f64, &[i64; 2])> = near.map(|(at, _)| (bound(&self.cells[at]), at)).collect();
        cells.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: Option<(f64, [Point3<f64>; 2])> = None;
        for (bound, at) in cells {
            if found.is_some_and(|(way, _)| way <= bound) {
                break;
            }
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let own = &self.cells[at];
            let blocks = beyond.values().filter(|block| metres(gaps(&[*at; 2], block)) <= most);
            let near = blocks.flat_map(cells_of).filter_map(|to| other.cells.get(&to));
            let near: Vec<&Cell> = near.filter(|cell| own.least_distance(cell) <= most).collect();
            for place in &own.places {
                let way = ends.iter().map(|end| (end - place).norm()).sum::<f64>();
                if found.is_some_and(|(best, _)| best <= way) {
                    continue;
                }
                let beyond = near.iter().flat_map(|cell| &cell.places).map(|to| ((to - place).norm(), *to));
                let nearest = beyond.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(distance, _)| *distance <= most);
                found = nearest.map(|(_, to)| (way, [*place, to])).or(found);
            }
        }
        Ok(found.map(|(_, places)| (places, best)))
    }

    /// The extent of the cells in each block.
    fn blocks(&self) -> BTreeMap<[i64; 2], Extent> {
        let mut blocks = BTreeMap::new();
        for own in self.cells.keys() {
            extend(blocks.entry(block(own)).or_insert([*own; 2]), &[*own; 2]);
        }
        blocks
    }
}

/// Lowest and highest cell along x and y.
type Extent = [[i64; 2]; 2];

fn extend([low, high]: &mut Extent, other: &Extent) {
    *low = [0, 1].map(|axis| low[axis].min(other[0][axis]));
    *high = [0, 1].map(|axis| high[axis].max(other[1][axis]));
}

/// The extent of all blocks; `None` without any.
fn around(blocks: &BTreeMap<[i64; 2], Extent>) -> Option<Extent> {
    let mut all = *blocks.values().next()?;
    blocks.values().for_each(|own| extend(&mut all, own));
    Some(all)
}

/// Distances along x and y (cells); 0 where both have the same cells.
fn gaps(a: &Extent, b: &Extent) -> [i64; 2] {
    [0, 1].map(|axis| (b[0][axis] - a[1][axis]).max(a[0][axis] - b[1][axis]).max(0))
}

/// A distance (m) that no places in cells this many apart along x and y fall below: they may lie at the near sides.
fn metres(gaps: [i64; 2]) -> f64 {
    let [x, y] = gaps.map(|gap| (gap - 1).max(0) as f64 * CELL_M);
    (x * x + y * y).sqrt()
}

/// The cells of an extent, in order.
fn cells_of([low, high]: &Extent) -> impl Iterator<Item = [i64; 2]> + use<> {
    let ([x, y], [to_x, to_y]) = (*low, *high);
    (x..=to_x).flat_map(move |x| (y..=to_y).map(move |y| [x, y]))
}

/// Cells on the border of a square around one, in order, those within an extent.
fn ring([x, y]: &[i64; 2], far: i64, [low, high]: &Extent) -> impl Iterator<Item = [i64; 2]> + use<> {
    let ([x, y], [low, high]) = ([*x, *y], [*low, *high]);
    (low[0].max(x - far)..=high[0].min(x + far)).flat_map(move |to| {
        let rows = |from: i64, to: i64| from.max(low[1])..=to.min(high[1]);
        let is_side = (to - x).abs() == far;
        let first = if is_side { rows(y - far, y + far) } else { rows(y - far, y - far) };
        // A side is complete.
        let second = if is_side { rows(1, 0) } else { rows(y + far, y + far) };
        first.chain(second).map(move |row| [to, row])
    })
}

fn block(cell: &[i64; 2]) -> [i64; 2] {
    cell.map(|at| at.div_euclid(BLOCK))
}

fn cell(at: &Point3<f64>) -> [i64; 2] {
    [at.x, at.y].map(|v| (v / CELL_M).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use proptest::prelude::*;

    const ENDS: [Point3<f64>; 2] = [Point3::new(10.0, 20.0, 0.0), Point3::new(90.0, 40.0, 1.0)];

    #[test]
    fn a_change_leads_from_the_measure_of_the_pawn_to_the_furthest_that_is_tried() {
        const PIXEL_M: f64 = 0.1;
        let oblong = Body::Box { x: 0.4, y: 0.8, height: 1.8 };
        let ranges = |pawn: &Pawn| Change::ALL.map(|change| change.range(pawn, PIXEL_M));
        let pawn = Pawn::new(oblong);
        // A pixel for the longer side, 0.05 m above the climb height, and for steps 0.05 m below the height.
        assert_eq!(ranges(&pawn), [[0.4, 0.1 * 0.2 / 0.4], [1.8, 0.35 + 0.05], [0.35, 1.8 - 0.05], [0.0; 2], [0.0; 2]]);
        let sloped = Pawn { max_grade: 0.06, max_ramp: 6.0, climb: 0.1, ..pawn };
        assert_eq!(ranges(&sloped)[1..], [[1.8, 0.3], [0.1, 1.75], [0.06, 2.0], [6.0, 1000.0]]);
        let tall = Pawn::new(Body::Cylinder { radius: 0.02, height: 4.0 });
        assert_eq!(ranges(&tall)[..3], [[0.04, 0.04], [4.0, 0.35 + 0.05], [0.35, 3.0]]);
        let low = Pawn { climb: 0.02, ..Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 0.1 }) };
        assert_eq!(ranges(&low)[1..3], [[0.1, 0.02 + 0.05], [0.02, 0.1 - 0.05]]);

        let narrow = Body::Box { x: 0.2, y: 0.4, height: 1.8 };
        assert_eq!(Change::Width.apply(&pawn, 0.2), Pawn { body: narrow, ..pawn });
        assert_eq!(Change::Slope.apply(&pawn, 0.2), Pawn { max_grade: 0.2, ..pawn });
        assert_eq!(Change::Ramp.apply(&pawn, 9.0), Pawn { max_ramp: 9.0, ..pawn });
        let share = |change: Change, value: f64| change.share(&pawn, value, PIXEL_M);
        assert_eq!([share(Change::Width, 0.3), share(Change::Step, 0.7)], [(0.4 - 0.3) / 0.4, 1.0]);
        // Of nothing, a centimetre is all.
        assert_eq!(Change::Step.share(&Pawn { climb: 0.0, ..pawn }, 0.02, PIXEL_M), 2.0);

        let reasons = Change::ALL.map(|change| change.reason().name());
        assert_eq!(reasons, ["width", "headroom", "step", "slope", "ramp"]);
        let others = [Reason::Length, Reason::Gap, Reason::Unseen].map(Reason::name);
        assert_eq!(others, ["length", "gap", "unseen"]);
    }

    struct Stops;

    impl Monitor for Stops {
        fn cancelled(&self) -> bool {
            true
        }
    }

    fn ground(places: impl IntoIterator<Item = [f64; 3]>) -> Ground {
        let mut ground = Ground { pixel_m: 0.1, climb: 0.35, pixels: HashMap::new(), cells: HashMap::new() };
        for place in places.into_iter().map(Point3::from) {
            ground.cells.entry(cell(&place)).or_default().add(place);
        }
        ground
    }

    /// Ground with a place in each of 60 × 60 cells from one on.
    fn square(x: i32, y: i32, z: f64) -> Ground {
        let all = (x..x + 60).flat_map(|i| (y..y + 60).map(move |j| (i, j)));
        ground(all.map(|(i, j)| [f64::from(i) + 0.5, f64::from(j) + 0.5, z]))
    }

    #[test]
    fn ground_far_off_is_found_at_once_and_a_search_for_it_stops_when_it_is_asked_to() {
        let own = square(0, 0, 0.0);
        for (x, y, distance) in [(600, 10, 541.0), (-600, 600, 541.0f64.hypot(541.0)), (20, 70, 11.0), (30, 30, 0.0)] {
            let ([at, _], found) = own.nearest(&square(x, y, 0.0), &ENDS, &NoMonitor).unwrap().unwrap();
            assert!((found - distance).abs() < 1e-9 && own.cells.contains_key(&cell(&at)), "{x}, {y}: {found}");
        }
        // Along a diagonal, most of its box is empty.
        let street = ground((0..600).map(|n| [f64::from(n), f64::from(n) - 300.0, 0.0]));
        let (_, found) = own.nearest(&street, &ENDS, &NoMonitor).unwrap().unwrap();
        assert!((found - 241.0 * 0.5f64.sqrt()).abs() < 1.0, "{found}");
        // Far above it, no cell is too far off.
        assert!(matches!(own.nearest(&square(0, 0, 30.0), &ENDS, &Stops), Err(Error::Interrupted)));
        let near = ground([[0.0; 3]]).nearest(&ground([[1.0; 3]]), &ENDS, &Stops);
        assert!(matches!(near, Err(Error::Interrupted)));
        let nothing = ground([]);
        assert_eq!(own.nearest(&nothing, &ENDS, &NoMonitor).unwrap(), None);
        assert_eq!(nothing.nearest(&own, &ENDS, &NoMonitor).unwrap(), None);
    }

    #[test]
    fn nearer_ground_in_cells_farther_off_and_shorter_ways_in_cells_looked_at_later_count() {
        // In the next cell at 1.9 m, and two cells on at 1.06 m.
        let own = ground([[0.05, 0.5, 0.0]]);
        let (_, found) =
            own.nearest(&ground([[1.95, 0.5, 0.0], [-1.01, 0.5, 0.0]]), &ENDS, &NoMonitor).unwrap().unwrap();
        assert!((found - 1.06).abs() < 1e-9, "{found}");
        // The bounds of the first cell reach nearest to the ends, but none of its places does.
        let places = [[0.05, 0.95, 0.0], [0.95, 0.05, 0.0], [-0.5, 0.05, 0.0]];
        let above = places.map(|[x, y, _]| [x, y, 2.0]);
        let ends = [Point3::origin(); 2];
        let (found, _) = ground(places).nearest(&ground(above), &ends, &NoMonitor).unwrap().unwrap();
        assert_eq!(found, [[-0.5, 0.05, 0.0], [-0.5, 0.05, 2.0]].map(Point3::from));
    }

    proptest! {
        #[test]
        fn the_nearest_ground_is_that_of_all_pairs(
            own in prop::collection::vec(any::<[i8; 3]>(), 1..40),
            other in prop::collection::vec(any::<[i8; 3]>(), 1..40),
            apart in 0..300i32,
        ) {
            let places = |all: &[[i8; 3]], by: i32| {
                let place = move |[x, y, z]: &[i8; 3]| [f64::from(*x) * 0.4 + f64::from(by), f64::from(*y) * 0.4, f64::from(*z) * 0.1];
                all.iter().map(place).collect::<Vec<_>>()
            };
            let (own, other) = (places(&own, 0), places(&other, apart));
            let far = |a: &[f64; 3], b: &[f64; 3]| (Point3::from(*a) - Point3::from(*b)).norm();
            let nearest = |a: &[f64; 3]| other.iter().map(|b| far(a, b)).fold(f64::INFINITY, f64::min);
            let least = own.iter().map(nearest).fold(f64::INFINITY, f64::min);
            let way = |a: &[f64; 3]| ENDS.iter().map(|end| (end - Point3::from(*a)).norm()).sum::<f64>();
            let near = own.iter().filter(|&a| nearest(a) <= least + 0.05);
            let shortest = near.map(way).fold(f64::INFINITY, f64::min);
            let found = ground(own.clone()).nearest(&ground(other.clone()), &ENDS, &NoMonitor).unwrap();
            let (places, distance) = found.unwrap();
            let [at, to] = places.map(|place| <[f64; 3]>::from(place.coords));
            prop_assert_eq!(distance, least);
            prop_assert!(own.contains(&at) && other.contains(&to));
            prop_assert!(far(&at, &to) == nearest(&at) && far(&at, &to) <= least + 0.05);
            prop_assert!((way(&at) - shortest).abs() < 1e-9);
        }
    }
}
