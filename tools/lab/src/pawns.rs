//! Where pawns stand when they ask.

use crate::Random;
use crate::building::{SIZE, STOREY};
use nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Answer, probe};
use slicewalk::store::Snapshot;

/// Width, depth and height of the pawn (m).
pub const PAWN: [f64; 3] = [0.5, 0.5, 1.8];

/// A pawn with its feet at `feet`.
pub fn pawn(feet: Point3<f64>) -> Aabb {
    Aabb::standing(feet, Vector3::from(PAWN)).expect("finite")
}

/// Anywhere in the rooms: feet from 2 cm above a floor to where the head is 2 cm below the ceiling.
pub fn random(count: usize, seed: u64) -> Vec<Aabb> {
    let mut random = Random(seed);
    let mut anywhere = || {
        let (x, y) = (random.between(0.5, SIZE[0] - 0.5), random.between(0.5, SIZE[1] - 0.5));
        let storey = f64::from(u8::from(random.bits() & 1 == 1)) * STOREY[0];
        pawn(Point3::new(x, y, storey + random.between(0.04, STOREY[1] - PAWN[2])))
    };
    (0..count).map(|_| anywhere()).collect()
}

/// Steps through the building.
pub fn walk(set: &Snapshot, count: usize, seed: u64) -> Vec<Aabb> {
    let inside = |place: Point3<f64>| (0..2).all(|axis| (0.4..SIZE[axis] - 0.4).contains(&place[axis]));
    // Out of a corner, and now and then to the other storey.
    let elsewhere = |random: &mut Random| {
        let storey = f64::from(u8::from(random.bits() & 1 == 1)) * STOREY[0];
        Point3::new(random.between(0.5, SIZE[0] - 0.5), random.between(0.5, SIZE[1] - 0.5), storey + 0.05)
    };
    wander(set, count, seed, Point3::new(3.0, 2.0, 0.05), inside, elsewhere)
}

/// Steps of 2.3 cm (1.4 m/s at 60 Hz), feet 3 cm above the floor; turns where an obstacle is in the way or a place is not
/// `inside`, and now and then begins again `elsewhere` (m).
pub fn wander(
    set: &Snapshot,
    count: usize,
    seed: u64,
    start: Point3<f64>,
    inside: impl Fn(Point3<f64>) -> bool,
    elsewhere: impl Fn(&mut Random) -> Point3<f64>,
) -> Vec<Aabb> {
    let mut random = Random(seed);
    let mut feet = start;
    let mut heading = 0.3f64;
    let mut steps = Vec::with_capacity(count);
    while steps.len() < count {
        let next = feet + Vector3::new(heading.cos(), heading.sin(), 0.0) * 0.0233;
        let shape = pawn(next);
        steps.push(shape);
        let Answer::Known(found) = probe(set, &shape) else { panic!("all pages are in memory") };
        if found.hit || !inside(next) {
            heading = random.between(0.0, std::f64::consts::TAU);
            if steps.len() % 4000 > 3900 {
                feet = elsewhere(&mut random);
            }
        } else {
            feet = next;
            feet.z = found.floor_z.unwrap_or(feet.z) + 0.03;
            heading += random.normal(0.02);
        }
    }
    steps
}
