//! Places that other stations could have seen through, by the true surfaces: an upper bound for the removal of people.

use scangen::geometry::{Vec3, add, cross, length, scale, sub, unit};
use scangen::sample::Crowd;
use scangen::{Scene, Truth};

/// Range of the scanner (m).
const RANGE_M: f64 = 120.0;
/// Least distance of a surface behind a place that proves the place empty (m), and its share of the distance.
const BEHIND_M: [f64; 2] = [0.05, 0.01];
/// Most panes of glass that a ray passes, and how far behind each it continues (m).
const MOST_PANES: usize = 8;
const CLEAR_M: f64 = 1e-6;
/// Angle between a direction and those around it, about twice that between neighbouring rays (degrees).
const AROUND_DEG: f64 = 1.0;

/// Evidence about a point's place from the stations that did not measure it, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RayBound {
    /// A wall or furniture is in front of it.
    Hidden,
    /// A person was in front of it while the station looked there.
    Crowded,
    /// Nothing is behind it within the range of a scanner.
    Open,
    /// The surface behind it is too near to distinguish from it.
    Near,
    /// A person stood there while the station looked there.
    Occupied,
    /// It could be seen through, but more stations hit something there.
    Outvoted,
    /// It could be seen through, but not in all directions around it.
    Grazed,
    /// It could be seen through, in all directions around it, too.
    Clear,
}

/// A station, and the people around it.
pub struct Eye {
    pub station: Vec3,
    pub crowd: Option<Crowd>,
}

/// Returns the best evidence that one of these stations could give about a place (m) which another measured.
pub fn best<'a>(scene: &Scene, eyes: impl Iterator<Item = &'a Eye>, point: Vec3) -> RayBound {
    let sights: Vec<RayBound> = eyes.map(|eye| of(scene, eye, point)).collect();
    let best = sights.iter().copied().max().unwrap_or(RayBound::Hidden);
    let through = sights.iter().filter(|sight| **sight >= RayBound::Grazed).count();
    let hits = 1 + sights.iter().filter(|sight| matches!(sight, RayBound::Near | RayBound::Occupied)).count();
    if best >= RayBound::Grazed && hits > through { RayBound::Outvoted } else { best }
}

fn of(scene: &Scene, eye: &Eye, point: Vec3) -> RayBound {
    let way = sub(point, eye.station);
    let distance = length(way);
    let own = toward(scene, eye, way, distance);
    if own != RayBound::Clear {
        return own;
    }
    let flat = way[0].hypot(way[1]);
    let side = if flat > 0.0 { [-way[1] / flat, way[0] / flat, 0.0] } else { [1.0, 0.0, 0.0] };
    let up = unit(cross(side, way));
    let far = distance * AROUND_DEG.to_radians().tan();
    let around = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (f64::from(a) * far, f64::from(b) * far)));
    let mut ways = around.map(|(a, b)| add(way, add(scale(side, a), scale(up, b))));
    // A direction without background gives no measurement, which is no objection.
    if ways.all(|way| matches!(toward(scene, eye, way, distance), RayBound::Clear | RayBound::Open)) {
        RayBound::Clear
    } else {
        RayBound::Grazed
    }
}

/// Returns the evidence of a ray in the direction of `way` about a place at `distance` (m).
fn toward(scene: &Scene, eye: &Eye, way: Vec3, distance: f64) -> RayBound {
    let direction = unit(way);
    let (sight, margin) = (beyond(scene, eye.station, direction, distance), margin(distance));
    if sight == RayBound::Hidden {
        return sight;
    }
    match eye.crowd.as_ref().and_then(|crowd| crowd.nearest(direction)) {
        Some(met) if met < distance - margin => RayBound::Crowded,
        Some(met) if met <= distance + margin => RayBound::Occupied,
        Some(_) if sight == RayBound::Open => RayBound::Clear,
        _ => sight,
    }
}

/// How far behind a place something must be (m).
fn margin(distance: f64) -> f64 {
    BEHIND_M[0] + BEHIND_M[1] * distance
}

/// Returns the evidence of a ray about a place at `distance` (m) without people.
fn beyond(scene: &Scene, station: Vec3, direction: Vec3, distance: f64) -> RayBound {
    let (mut from, mut passed) = (station, 0.0);
    for _ in 0..MOST_PANES {
        let Some((t, surface)) = scene.raycast(from, direction, RANGE_M - passed) else { return RayBound::Open };
        if scene.surfaces()[surface].label != "glass" {
            let seen = passed + t;
            let margin = margin(distance);
            return match seen - distance {
                behind if behind > margin => RayBound::Clear,
                behind if behind > -margin => RayBound::Near,
                _ => RayBound::Hidden,
            };
        }
        passed += t + CLEAR_M;
        from = add(from, scale(direction, t + CLEAR_M));
    }
    RayBound::Open
}
