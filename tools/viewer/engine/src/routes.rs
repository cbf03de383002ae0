//! Routes for a pawn, planned a little at a time between its steps.

use crate::fault;
use crate::messages::RouteCode;
use crate::pawn::{Settings, TICK_S};
use slicewalk::NoMonitor;
use slicewalk::nalgebra::Point3;
use slicewalk::reach::{Pawn, Planned, Planner, Refusal};
use slicewalk::store::{Missing, Snapshot};
use slicewalk::walk::{MoveInput, State, Walker};

/// Ends are moved to standing places within this distance (m), as `slicetool route` does.
const SNAP_M: f64 = 0.5;
/// Places searched, and ticks walked, by one call: some milliseconds.
const PLACES: usize = 256;
const TICKS: u32 = 480;
/// Places after which a search is given up: about a quarter of a minute.
const MOST_PLACES: usize = 1 << 20;
/// A straight walk takes at most this multiple of its time, plus some seconds.
const PATIENCE: f64 = 1.5;
const PATIENCE_S: f64 = 2.0;
/// Distances within which a straight walk has arrived: across, and of heights (m).
const NEAR_M: f64 = 1e-3;
const NEAR_UP_M: f64 = 0.5;

/// State of a route.
#[derive(Debug)]
pub enum Routed {
    /// Continue.
    Unfinished,
    /// These pages are needed.
    NotLoaded(Missing),
    /// No route, with the reason.
    Refused(RouteCode),
    /// Places to go to in order.
    Found(Vec<Point3<f64>>),
}

/// A route that is being planned. What a straight walk reaches needs no plan.
#[derive(Debug)]
pub struct Routing {
    /// Name of the pawn.
    pub pawn: u32,
    ends: [Point3<f64>; 2],
    settings: Settings,
    way: Way,
}

#[derive(Debug)]
enum Way {
    /// A walker on the straight line, and the ticks that it has left.
    Straight(Box<Walker>, u32),
    /// A plan, and the places that its search has left.
    Planned(Box<Planner>, usize),
}

impl Routing {
    /// Begins the route of a pawn, as it stands, to a place (m, finite).
    pub fn new(pawn: u32, from: Point3<f64>, settings: Settings, to: Point3<f64>) -> Result<Self, String> {
        let straight = Walker::new(settings.careful(), from).map_err(|error| fault::text(&error))?;
        let seconds = PATIENCE * (to - from).xy().norm() / settings.speed.max(0.1) + PATIENCE_S;
        // Longer ones are planned.
        let ticks = (seconds / TICK_S).min(1e6) as u32;
        Ok(Self { pawn, ends: [from, to], settings, way: Way::Straight(Box::new(straight), ticks) })
    }

    /// Continues for some milliseconds.
    pub fn advance(&mut self, set: &Snapshot) -> Result<Routed, String> {
        let to = self.ends[1];
        match &mut self.way {
            Way::Straight(walker, left) => {
                let ticks = TICKS.min(*left);
                *left -= ticks;
                let report = walker.step(set, f64::from(ticks) * TICK_S, MoveInput::Toward(to.xy()));
                let off = to - walker.feet();
                if report.missing.is_none() && off.xy().norm() < NEAR_M && report.state != State::Falling {
                    if off.z.abs() < NEAR_UP_M {
                        return Ok(Routed::Found(vec![self.ends[0], walker.feet()]));
                    }
                    *left = 0;
                }
                if report.missing.is_some() || report.state == State::Blocked || *left == 0 {
                    self.plan(set)?;
                }
                Ok(Routed::Unfinished)
            }
            Way::Planned(planner, left) => {
                if *left == 0 {
                    return Ok(Routed::Refused(RouteCode::TooFar));
                }
                let planned = planner.advance(set, PLACES, &NoMonitor).map_err(|error| fault::text(&error))?;
                Ok(match planned {
                    Planned::Done(Ok(route)) => Routed::Found(route.points),
                    Planned::Done(Err(Refusal::NotStandingFrom)) => Routed::Refused(RouteCode::NotStandingFrom),
                    Planned::Done(Err(Refusal::NotStandingTo)) => Routed::Refused(RouteCode::NotStandingTo),
                    Planned::Done(Err(_)) => Routed::Refused(RouteCode::NotConnected),
                    Planned::NotLoaded(missing) => Routed::NotLoaded(missing),
                    _ => {
                        *left = left.saturating_sub(PLACES);
                        Routed::Unfinished
                    }
                })
            }
        }
    }

    fn plan(&mut self, set: &Snapshot) -> Result<(), String> {
        let config = self.settings.careful();
        let max_drop = config.max_drop.unwrap_or(config.climb);
        let pawn = Pawn { climb: config.climb, max_drop, ..Pawn::new(config.body) };
        let [from, to] = self.ends;
        let planner = Planner::new(set, pawn, from, to).map_err(|error| fault::text(&error))?;
        self.way = Way::Planned(Box::new(planner.snapping(SNAP_M)), MOST_PLACES);
        Ok(())
    }
}
