//! Boxes, cylinders, spheres, rays, floors, ceilings and sweeps at random places.

use crate::Random;
use nalgebra::{Point3, Vector3};
use slicewalk::object::{Model, Object, touches_scene};
use slicewalk::query::*;
use slicewalk::store::PageSet;

/// Questions asked.
pub const ANSWERS: usize = 100_000;

/// The bits of the answers to [`ANSWERS`] questions.
pub fn answers<S: PageSet>(set: &S) -> Vec<u64> {
    let mut words = Vec::with_capacity(3 * ANSWERS);
    let mut random = Random(17);
    let model = model(set);
    for question in 0..ANSWERS {
        let mut at = |low: [f64; 3], high: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| random.in_range(low[axis], high[axis]))
        };
        let low = Point3::from(at([-4.5, -4.5, -0.5], [4.5, 4.5, 6.5]));
        let size = Vector3::from(at([0.0; 3], [0.8, 0.8, 2.0]));
        let way = Vector3::from(at([-1.0; 3], [1.0; 3]));
        let shape = Aabb::new(low, low + size).expect("in order");
        let round = Cylinder::new(low, size.x / 2.0, size.z).expect("finite");
        match question % 10 {
            0 => words.push(overlap(overlaps(set, &shape))),
            1 => words.push(overlap(overlaps(set, &round))),
            2 => words.push(overlap(overlaps(set, &Sphere::new(low, size.x).expect("finite")))),
            3 => {
                let probe = probe(set, &shape).known().expect("all pages are there");
                words.push(u64::from(probe.hit) | u64::from(probe.obstacle) << 1);
                number(&mut words, probe.floor_z);
            }
            4 => {
                let ray = Ray::new(low, way, 20.0).expect("finite");
                let hit = cast(set, &ray).known().expect("all pages are there");
                number(&mut words, hit.map(|hit| hit.distance));
                vector(&mut words, hit.map(|hit| hit.normal));
            }
            5 => {
                let hit = sweep(set, &shape, way).known().expect("all pages are there");
                number(&mut words, hit.map(|hit| hit.fraction));
                vector(&mut words, hit.map(|hit| hit.normal));
            }
            6 => {
                let hit = sweep(set, &round, way).known().expect("all pages are there");
                number(&mut words, hit.map(|hit| hit.fraction));
                vector(&mut words, hit.map(|hit| hit.normal));
            }
            7 => {
                number(&mut words, floor_under(set, &round, low.z + size.z, 3.0).known().expect("all pages are there"));
                number(&mut words, ceiling_above(set, &shape, low.z, 3.0).known().expect("all pages are there"));
            }
            8 => vector(&mut words, depenetrate(set, &round, 0.5).known().expect("all pages are there")),
            _ => {
                // Given as a quaternion of exact numbers: no sine on the way.
                let turn = nalgebra::Quaternion::new(1.0, way.x, way.y, way.z);
                let pose = nalgebra::Isometry3::from_parts(low.coords.into(), nalgebra::Unit::new_normalize(turn));
                words.push(overlap(touches_scene(&Object::new(&model, pose).expect("a rotation"), set)));
            }
        }
    }
    words
}

/// A part of the scene, small enough to turn.
fn model<S: PageSet>(set: &S) -> Model {
    use slicewalk::store::PageSlot;
    let (tx, ty, slots) = set.column_at(0);
    let key = |layer| slicewalk::frame::PageKey { tx, ty, layer };
    let pages = slots.iter().take(1).filter_map(|slot| Some((key(slot.layer()), slot.page()?.clone())));
    Model::from_pages(&slicewalk::store::Store::from_pages(*set.frame(), pages)).expect("all pages are there")
}

fn overlap(answer: Overlap) -> u64 {
    match answer {
        Overlap::Clear => 0,
        Overlap::Hit => 1,
        Overlap::NotLoaded(missing) => 2 + missing.count() as u64,
    }
}

fn number(words: &mut Vec<u64>, value: Option<f64>) {
    words.push(value.map_or(u64::MAX, f64::to_bits));
}

fn vector(words: &mut Vec<u64>, value: Option<Vector3<f64>>) {
    (0..3).for_each(|axis| number(words, value.map(|vector| vector[axis])));
}
