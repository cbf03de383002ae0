//! Several walkers that keep out of each other.

use crate::fault::{self, invalid};
use crate::messages::{CrowdMessage, MemberCode, MemberMessage};
use crate::pawn::{LONGEST_S, Settings};
use slicewalk::frame::Frame;
use slicewalk::nalgebra::{Point2, Point3, Vector2};
use slicewalk::store::{BodyId, Missing, MotionHint, Snapshot};
use slicewalk::walk::{Config, Crowd, MoveInput, State, Walker};

/// Length of a tick (s), longer than that of a single pawn: the walkers of a crowd are many.
const TICK_S: f64 = 1.0 / 60.0;
/// Most walkers.
const MOST: usize = 1000;

/// A crowd, with what the loader knows of each walker.
pub(crate) struct Company {
    crowd: Crowd,
    pub bodies: Vec<(BodyId, Option<MotionHint>)>,
    pub missing: Option<Missing>,
}

impl Company {
    /// Places walkers with the same settings, three numbers each; `body` makes their bodies for the loader.
    pub fn new(settings: &Settings, places: &[f64], body: impl FnMut() -> BodyId) -> Result<Self, String> {
        let (rows, rest) = places.as_chunks::<3>();
        if !rest.is_empty() || !(1..=MOST).contains(&rows.len()) {
            return Err(invalid(format_args!("{} numbers are no places of 1 to {MOST} walkers", places.len())));
        }
        let config = Config { tick_s: TICK_S, ..settings.upright() };
        let walkers: slicewalk::Result<Vec<Walker>> =
            rows.iter().map(|place| Walker::new(config, Point3::from(*place))).collect();
        let crowd = walkers.and_then(Crowd::new).map_err(|error| fault::text(&error))?;
        let bodies = std::iter::repeat_with(body).take(rows.len()).map(|body| (body, None)).collect();
        Ok(Self { crowd, bodies, missing: None })
    }

    /// Advances by at most 0.25 s. Three numbers per walker: x and y of a direction, or of a place if the third is 1.
    pub fn step(&mut self, set: &Snapshot, seconds: f64, wishes: &[f64]) -> Result<(), String> {
        let (rows, rest) = wishes.as_chunks::<3>();
        let count = self.crowd.walkers().len();
        if !rest.is_empty() || rows.len() != count {
            return Err(invalid(format_args!("{} numbers are not wishes of {count} walkers", wishes.len())));
        }
        if let Some(n) = rows.iter().position(|row| !row.iter().all(|v| v.is_finite())) {
            return Err(invalid(format_args!("row {n}: a wish is three finite numbers")));
        }
        let seconds = if seconds > 0.0 { seconds.min(LONGEST_S) } else { 0.0 };
        let report = self.crowd.step(set, seconds, |n, _| match rows[n] {
            [x, y, 1.0] => MoveInput::Toward(Point2::new(x, y)),
            [x, y, _] => MoveInput::Direction(Vector2::new(x, y)),
        });
        self.missing = report.missing;
        Ok(())
    }

    /// Motion hints that have changed.
    pub fn hints(&mut self, frame: &Frame) -> impl Iterator<Item = (BodyId, MotionHint)> {
        self.crowd.walkers().iter().zip(&mut self.bodies).filter_map(|(walker, (body, hinted))| {
            let hint = Some(walker.motion_hint(frame)).filter(|hint| *hinted != Some(*hint))?;
            *hinted = Some(hint);
            Some((*body, hint))
        })
    }

    /// Numbers of a [`CrowdMessage`], and of a [`MemberMessage`] for each walker.
    pub fn state(&self) -> Vec<f64> {
        let missing = self.missing.map_or(0, |missing| missing.count()) as f64;
        let mut numbers = CrowdMessage { missing }.numbers().to_vec();
        for walker in self.crowd.walkers() {
            let activity = match walker.state() {
                State::Walking => MemberCode::Walking,
                State::Falling => MemberCode::Falling,
                State::Blocked => MemberCode::Blocked,
                State::Arrived => MemberCode::Arrived,
            };
            let feet = walker.feet();
            numbers.extend(MemberMessage { x: feet.x, y: feet.y, z: feet.z, activity: activity.into() }.numbers());
        }
        numbers
    }
}
