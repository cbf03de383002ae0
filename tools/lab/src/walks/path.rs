//! How far a walked path is from the exact one, and how far along.

use super::cases::Case;
use nalgebra::{Point3, Vector3};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Config, MoveInput, Response, Walker};

/// How a walk compares with the exact one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Greatest distance from the exact way (m).
    pub off: f64,
    /// How far it came along the exact way in the time that the exact pawn takes for all of it, as a share; above 1 it was
    /// faster.
    pub share: f64,
}

/// Walks a case at 60 frames a second, for as long as the exact pawn takes.
pub fn walk(set: &Snapshot, case: &Case, response: Response) -> Deviation {
    let config = Config { response, ..Config::new(case.body) };
    let mut walker = Walker::new(config, case.start).expect("a finite start");
    let mut seen = Deviation { off: 0.0, share: 0.0 };
    for _ in 0..(case.seconds * 60.0).round() as usize {
        walker.step(set, 1.0 / 60.0, MoveInput::Direction(case.toward));
        let (off, share) = nearest(&case.truth, case.goes_on, walker.feet());
        seen = Deviation { off: seen.off.max(off), share: seen.share.max(share) };
    }
    seen
}

/// Returns the distance to the nearest point of a polyline, whose last segment may extend without end (m), and the
/// place of that point as a share of the length.
pub fn nearest(line: &[Point3<f64>], goes_on: bool, to: Point3<f64>) -> (f64, f64) {
    let (mut best, mut before) = ((f64::INFINITY, 0.0), 0.0);
    for (n, ends) in line.windows(2).enumerate() {
        let along: Vector3<f64> = ends[1] - ends[0];
        let length = along.norm();
        let most = if goes_on && n + 2 == line.len() { f64::INFINITY } else { 1.0 };
        let at = ((to - ends[0]).dot(&along) / along.norm_squared()).clamp(0.0, most);
        let distance = (to - (ends[0] + along * at)).norm();
        if distance < best.0 {
            best = (distance, before + at * length);
        }
        before += length;
    }
    (best.0, best.1 / before)
}
