//! What other stations could have seen through, by the true surfaces: a bound for whoever removes people.

use scangen::geometry::{Vec3, add, cross, length, scale, sub, unit};
use scangen::{Scene, Truth};

/// Range of the scanner (m).
const RANGE_M: f64 = 120.0;
/// How far behind a place something must be to tell that nothing is there (m), by the distance of the place.
const BEHIND_M: [f64; 2] = [0.05, 0.01];
/// Panes of glass that a ray passes at most, and how far behind each it goes on (m).
const MOST_PANES: usize = 8;
const CLEAR_M: f64 = 1e-6;
/// Angle between a direction and those around it, about twice that between neighbouring rays (degrees).
const AROUND_DEG: f64 = 1.0;

/// What those stations that did not measure a point could tell of its place, the best last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Sight {
    /// Something is in front of it.
    Hidden,
    /// Nothing is behind it within the range of a scanner.
    Open,
    /// What is behind it is too near to tell from it.
    Near,
    /// It could be seen through, but not in all directions around it.
    Grazed,
    /// It could be seen through, in all directions around it, too.
    Clear,
}

/// The best that one of these stations could tell of a place (m).
pub fn best(scene: &Scene, stations: impl Iterator<Item = Vec3>, point: Vec3) -> Sight {
    stations.map(|station| of(scene, station, point)).max().unwrap_or(Sight::Hidden)
}

fn of(scene: &Scene, station: Vec3, point: Vec3) -> Sight {
    let way = sub(point, station);
    let distance = length(way);
    let own = toward(scene, station, way, distance);
    if own != Sight::Clear {
        return own;
    }
    let flat = way[0].hypot(way[1]);
    let side = if flat > 0.0 { [-way[1] / flat, way[0] / flat, 0.0] } else { [1.0, 0.0, 0.0] };
    let up = unit(cross(side, way));
    let far = distance * AROUND_DEG.to_radians().tan();
    let around = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (f64::from(a) * far, f64::from(b) * far)));
    let mut ways = around.map(|(a, b)| add(way, add(scale(side, a), scale(up, b))));
    // Where nothing is behind, nothing is measured, and that hinders nobody.
    if ways.all(|way| matches!(toward(scene, station, way, distance), Sight::Clear | Sight::Open)) {
        Sight::Clear
    } else {
        Sight::Grazed
    }
}

/// What a ray in the direction of `way` tells of a place at `distance` (m).
fn toward(scene: &Scene, station: Vec3, way: Vec3, distance: f64) -> Sight {
    let direction = unit(way);
    let (mut from, mut passed) = (station, 0.0);
    for _ in 0..MOST_PANES {
        let Some((t, surface)) = scene.raycast(from, direction, RANGE_M - passed) else { return Sight::Open };
        if scene.surfaces()[surface].label != "glass" {
            let seen = passed + t;
            let margin = BEHIND_M[0] + BEHIND_M[1] * distance;
            return match seen - distance {
                behind if behind > margin => Sight::Clear,
                behind if behind > -margin => Sight::Near,
                _ => Sight::Hidden,
            };
        }
        passed += t + CLEAR_M;
        from = add(from, scale(direction, t + CLEAR_M));
    }
    Sight::Open
}
