//! Shapes with infinite sides, and shapes and motions with the largest numbers.

use super::scene::{Scene, pages_of};
use super::{SLACK, random_motion, random_pawn};
use nalgebra::{Point3, Vector3};
use slicewalk::frame::Frame;
use slicewalk::query::*;
use slicewalk::store::Snapshot;

/// Moves the sides of `shape` selected by the bits of `open` to a distance `far` from `origin`.
fn opened(shape: &Aabb, open: usize, origin: Point3<f64>, far: f64) -> Aabb {
    let side = |bit: usize, inside: f64, outside: f64| if open >> bit & 1 == 1 { outside } else { inside };
    let min = Point3::from([0, 1, 2].map(|axis| side(axis, shape.min()[axis], origin[axis] - far)));
    let max = Point3::from([0, 1, 2].map(|axis| side(axis + 3, shape.max()[axis], origin[axis] + far)));
    Aabb::new(min, max).unwrap()
}

fn near(a: Answer<Option<f64>>, b: Answer<Option<f64>>, what: &str) {
    let (a, b) = (a.known().unwrap(), b.known().unwrap());
    let same = a.zip(b).map_or(a.is_some() == b.is_some(), |(a, b)| (a - b).abs() < SLACK);
    assert!(same, "{what}: {a:?} {b:?}");
}

#[test]
fn an_infinite_side_is_one_beyond_all_matter() {
    let mut hits = 0;
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        let reach = scene.frame.pixel_m() * 20.0;
        for _ in 0..60 {
            let (shape, open) = (random_pawn(&scene, &mut random), random.below(64));
            let (motion, from) = (random_motion(&scene, &mut random), scene.random_point(&mut random).z);
            // Farther out than the width of the scene plus the length of the motion.
            let plain = opened(&shape, open, scene.origin, 1e5 + 3.0 * motion.norm());
            for far in [f64::INFINITY, f64::MAX, 1e300, 1e20] {
                let shape = opened(&shape, open, scene.origin, far);
                let what = format!("{shape:?} by {motion:?}");
                let [a, b] = [&shape, &plain].map(|shape| sweep(&store, shape, motion).known().unwrap());
                assert_eq!(a.is_some(), b.is_some(), "{what}: {a:?} {b:?}");
                if let (Some(a), Some(b)) = (a, b) {
                    assert!(
                        a.begins_inside() == b.begins_inside() && (a.distance - b.distance).abs() < SLACK,
                        "{what}"
                    );
                    hits += usize::from(!a.begins_inside());
                }
                let [a, b] = [&shape, &plain].map(|shape| depenetrate(&store, shape, reach).known().unwrap());
                let same = a.zip(b).map_or(a.is_some() == b.is_some(), |(a, b)| (a - b).norm() < SLACK);
                assert!(same, "{what}: {a:?} {b:?}");
                let ask = |query: &dyn Fn(&Aabb) -> Answer<Option<f64>>| near(query(&shape), query(&plain), &what);
                ask(&|shape| clearance(&store, shape, reach));
                ask(&|shape| top_under(&store, shape, from, 3.0 * reach));
                ask(&|shape| mean_floor_under(&store, shape, from, 3.0 * reach));
                ask(&|shape| floor_under(&store, shape, from, f64::INFINITY));
                ask(&|shape| ceiling_above(&store, shape, from, f64::INFINITY));
                assert_eq!(overlaps(&store, &shape), overlaps(&store, &plain), "{what}");
            }
        }
    }
    assert!(hits > 300, "{hits}: the test shows little");
}

/// A wall across x, from 5 to 5.05 m.
fn wall() -> Snapshot {
    let columns = (-40..40).map(|j| ((100, j), vec![(0, 3400, true)])).collect();
    Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), pages_of(&columns))
}

#[test]
fn no_way_is_too_long_for_a_wall() {
    let store = wall();
    for length in [1e3, 1e9, 1e15, 1e30, 1e100, 1e300, f64::MAX] {
        // From the face of the wall, from a pixel before it, and from afar.
        for start in [4.75, 4.7, 0.0, -1e6].into_iter().filter(|start| start + length > 5.0) {
            for aside in [0.0, 1e-3] {
                let motion = Vector3::new(length, length * aside * 1e-6, 0.0);
                let pawn = Aabb::standing([start, 0.0, 0.1].into(), [0.5, 0.5, 1.8].into()).unwrap();
                let round = Cylinder::new([start, 0.0, 0.1].into(), 0.25, 1.8).unwrap();
                let ball = Sphere::new([start, 0.0, 1.0].into(), 0.25).unwrap();
                let hits = [sweep(&store, &pawn, motion), sweep(&store, &round, motion), sweep(&store, &ball, motion)];
                for hit in hits {
                    let what = format!("{start} by {motion:?}: {hit:?}");
                    let Answer::Known(Some(hit)) = hit else { panic!("{what}") };
                    assert!((hit.distance - (4.75 - start)).abs() < 1e-6 * (1.0 + start.abs() * 1e-3), "{what}");
                    assert!(hit.normal.x < -0.99 && hit.fraction <= 1.0, "{what}");
                }
            }
        }
    }
}

#[test]
fn an_endless_slab_stops_at_the_wall_and_gets_out_of_it() {
    let store = wall();
    let infinite = f64::INFINITY;
    let slab = Aabb::new([-infinite, -infinite, 0.1].into(), [4.0, infinite, 1.9].into()).unwrap();
    let hit = sweep(&store, &slab, Vector3::new(10.0, 0.0, 0.0)).known().flatten().unwrap();
    assert!((hit.distance - 1.0).abs() < 1e-9 && hit.normal == -Vector3::x(), "{hit:?}");
    let inside = Aabb::new([-infinite, -infinite, 0.1].into(), [5.02, infinite, 1.9].into()).unwrap();
    let out = depenetrate(&store, &inside, infinite).known().flatten().unwrap();
    assert!((out - Vector3::new(-0.02, 0.0, 0.0)).norm() < 1e-9, "{out:?}");
    let all = Aabb::new([-infinite; 3].into(), [infinite; 3].into()).unwrap();
    assert_eq!(depenetrate(&store, &all, infinite), Answer::Known(None));
    assert!(sweep(&store, &all, Vector3::x()).known().flatten().unwrap().begins_inside());
    assert_eq!(top_under(&store, &all, 10.0, 20.0), floor_top(&store));
}

fn floor_top(store: &Snapshot) -> Answer<Option<f64>> {
    let wide = Aabb::new([-100.0; 3].into(), [100.0; 3].into()).unwrap();
    top_under(store, &wide, 10.0, 20.0)
}

#[test]
fn what_is_no_shape_is_refused() {
    let (infinite, nan) = (f64::INFINITY, f64::NAN);
    for (min, max) in [(infinite, infinite), (-infinite, -infinite), (nan, 1.0), (0.0, nan), (1.0, 0.0)] {
        for axis in 0..3 {
            let (mut low, mut high) = (Point3::new(0.0, 0.0, 0.0), Point3::new(1.0, 1.0, 1.0));
            (low[axis], high[axis]) = (min, max);
            assert!(Aabb::new(low, high).is_err(), "{low} {high}");
        }
    }
    for bad in [nan, infinite, -infinite, 1e101, -1e101] {
        let far = Point3::new(0.0, bad, 0.0);
        assert!(Cylinder::new(far, 1.0, 1.0).is_err() && Sphere::new(far, 1.0).is_err());
        assert!(Cylinder::new(Point3::origin(), bad, 1.0).is_err() && Sphere::new(Point3::origin(), bad).is_err());
        assert!(Cylinder::new(Point3::origin(), 1.0, bad).is_err());
        assert!(Ray::new(far, Vector3::x(), 1.0).is_err());
    }
    let store = wall();
    let huge = Sphere::new(Point3::new(-1e100, 0.0, 0.0), 1e100).unwrap();
    assert_eq!(overlaps(&store, &huge), Overlap::Hit, "within rounding errors of the largest coordinate");
    let far = Sphere::new(Point3::new(-1e100, 0.0, 0.0), 1e99).unwrap();
    assert_eq!(overlaps(&store, &far), Overlap::Clear);
    let ray = Ray::new(Point3::new(-1e100, 0.0, 0.0), Vector3::y(), infinite).unwrap();
    assert_eq!(cast(&store, &ray), Answer::Known(None));
}
