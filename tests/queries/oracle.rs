//! Queries compared with brute force: over the raw points (guarantees G1 and G2) and over the spans (equality).

use crate::scene;

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use scene::{Columns, Random, Scene, pages_of};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::query::*;
use slicewalk::store::Snapshot;

/// The stated bound on phantoms of round shapes and rays at 10⁷ m, plus the tests' own rounding (m).
const SLACK: f64 = 4e-8;

#[test]
fn boxes_hit_exactly_the_spans_and_no_point_is_missed() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        let (t, s) = (scene.frame.pixel_m() + SLACK, scene.frame.slice_m() + SLACK);
        for _ in 0..400 {
            let shape = scene.random_box(&mut random);
            let heights = scene.quanta(shape.min().z, shape.max().z);
            let (hit, obstacle) = scene.touches(scene.pixels_of(&shape), heights);
            let expected = if hit { Overlap::Hit } else { Overlap::Clear };
            assert_eq!(overlaps(&store, &shape), expected, "{shape:?}");
            let floor_z = scene.floor(scene.pixels_of(&shape), (i64::MIN, heights.1));
            assert_eq!(probe(&store, &shape), Answer::Known(Probe { hit, obstacle, floor_z }), "{shape:?}");

            let holds_point = |grow: Vector3<f64>| {
                let (min, max) = (shape.min() - grow, shape.max() + grow);
                scene.points.iter().any(|p| (0..3).all(|axis| min[axis] <= p[axis] && p[axis] <= max[axis]))
            };
            assert!(hit || !holds_point(Vector3::zeros()), "G1: {shape:?}");
            assert!(!hit || holds_point(Vector3::new(t, t, s)), "G2: {shape:?}");
        }
    }
}

#[test]
fn cylinders_and_spheres_miss_no_point_and_hit_no_phantom() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        let (t, s) = (scene.frame.pixel_m(), scene.frame.slice_m());
        for _ in 0..200 {
            let c = scene.random_point(&mut random);
            let most = [0.0, 0.5, 5.0, 40.0][random.below(4)];
            let r = t * random.between(0.0, most);
            let h = s * random.between(0.0, 10.0);
            let is_hit = |answer| {
                assert!(!matches!(answer, Overlap::NotLoaded(_)));
                answer == Overlap::Hit
            };
            let cylinder = is_hit(overlaps(&store, &Cylinder::new(c, r, h).unwrap()));
            let sphere = is_hit(overlaps(&store, &Sphere::new(c, r).unwrap()));

            // Tests whether a point is in the shape, grown along the axes and then outwards.
            let beyond = |v: f64, grow: f64| (v.abs() - grow).max(0.0);
            let in_cylinder = |grow: f64, grow_z: f64, slack: f64| {
                scene.points.iter().any(|p| {
                    let d = p - c;
                    beyond(d.x, grow).powi(2) + beyond(d.y, grow).powi(2) <= (r + slack).powi(2)
                        && p.z >= c.z - grow_z - slack
                        && p.z <= c.z + h + grow_z + slack
                })
            };
            let in_sphere = |grow: f64, grow_z: f64, slack: f64| {
                scene.points.iter().any(|p| {
                    let d = p - c;
                    let rest = Vector3::new(beyond(d.x, grow), beyond(d.y, grow), beyond(d.z, grow_z));
                    rest.norm_squared() <= (r + slack).powi(2)
                })
            };
            assert!(cylinder || !in_cylinder(0.0, 0.0, 0.0), "G1: cylinder {c} {r} {h}");
            assert!(!cylinder || in_cylinder(t, s, SLACK), "G2: cylinder {c} {r} {h}");
            assert!(sphere || !in_sphere(0.0, 0.0, 0.0), "G1: sphere {c} {r}");
            assert!(!sphere || in_sphere(t, s, SLACK), "G2: sphere {c} {r}");

            // Compared with the spans: equal, except for solid within rounding errors of the rim.
            let heights = scene.quanta(c.z, c.z + h);
            let by_spans = |r: f64| scene.touches(scene.pixels_near(c.x, c.y, r), heights).0;
            assert!(cylinder || !by_spans(r - SLACK), "cylinder {c} {r} {h}");
            assert!(!cylinder || by_spans(r + SLACK), "cylinder {c} {r} {h}");
            let distance = scene.distance(c);
            assert!(sphere || distance > r - SLACK, "sphere {c} {r}: {distance}");
            assert!(!sphere || distance <= r + SLACK, "sphere {c} {r}: {distance}");
        }
    }
}

#[test]
fn floors_and_ceilings_are_those_of_the_spans_whatever_the_pages() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..200 {
            let shape = scene.random_box(&mut random);
            let from = scene.random_point(&mut random).z;
            let reach = [f64::INFINITY, random.between(0.0, 80.0) * scene.frame.slice_m()][random.below(2)];
            let floor = scene.floor(scene.pixels_of(&shape), scene.quanta(from - reach, from));
            assert_eq!(floor_under(&store, &shape, from, reach), Answer::Known(floor), "{shape:?} {from} {reach}");
            let ceiling = scene.ceiling(scene.pixels_of(&shape), scene.quanta(from, from + reach));
            assert_eq!(ceiling_above(&store, &shape, from, reach), Answer::Known(ceiling), "{shape:?} {from} {reach}");
        }
    }
}

/// Equal, except for solid within rounding errors of the rim.
#[test]
fn floors_and_ceilings_of_round_shapes_are_those_of_the_pixels_they_touch() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..12 {
            let c = scene.random_point(&mut random);
            let most = [0.0, 5.0, 40.0][random.below(3)];
            let r = scene.frame.pixel_m() * random.between(0.0, most);
            let (from, reach) = (scene.random_point(&mut random).z, [f64::INFINITY, 3.0][random.below(2)]);
            let (cylinder, sphere) = (Cylinder::new(c, r, 1.0).unwrap(), Sphere::new(c, r).unwrap());
            let what = format!("at {c}, radius {r}, from {from} by {reach}");

            let floor = |r: f64| scene.floor(scene.pixels_near(c.x, c.y, r), scene.quanta(from - reach, from));
            let (least, most) = (floor(r - SLACK), floor(r + SLACK));
            let found = floor_under(&store, &cylinder, from, reach).known().unwrap();
            assert!(least <= found && found <= most, "{what}: {found:?}, not {least:?} to {most:?}");
            assert_eq!(floor_under(&store, &sphere, from, reach), Answer::Known(found), "{what}");

            let ceiling = |r: f64| scene.ceiling(scene.pixels_near(c.x, c.y, r), scene.quanta(from, from + reach));
            let height = |ceiling: Option<f64>| ceiling.unwrap_or(f64::INFINITY);
            let (most, least) = (height(ceiling(r - SLACK)), height(ceiling(r + SLACK)));
            let found = ceiling_above(&store, &cylinder, from, reach).known().unwrap();
            assert!((least..=most).contains(&height(found)), "{what}: {found:?}, not {least} to {most}");
            assert_eq!(ceiling_above(&store, &sphere, from, reach), Answer::Known(found), "{what}");
        }
    }
}

/// Their distance from the other end, taken from that end, rounds beyond them.
#[test]
fn floors_and_ceilings_at_the_last_height_of_a_search_are_found() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let shape = Aabb::new(Point3::new(0.02, 0.02, 0.0), Point3::new(0.03, 0.03, 0.0)).unwrap();
    for quantum in 1..300 {
        let columns = Columns::from([((0, 0), vec![(-quantum, quantum, false)])]);
        let store = Snapshot::from_pages(frame, pages_of(&columns));
        let (bottom, top) = (frame.bottom_height(-quantum), frame.top_height(quantum));
        for end in [1.0, 2.5, 5.0, 7.3, f64::INFINITY] {
            assert_eq!(floor_between(&store, &shape, top, end), Answer::Known(Some(top)), "{quantum} {end}");
            assert_eq!(ceiling_between(&store, &shape, -end, bottom), Answer::Known(Some(bottom)), "{quantum} {end}");
            assert_eq!(floor_between(&store, &shape, top.next_up(), end), Answer::Known(None), "{quantum} {end}");
        }
        assert_eq!(floor_between(&store, &shape, f64::NAN, 1.0), Answer::Known(None));
        assert_eq!(ceiling_between(&store, &shape, -1.0, f64::NAN), Answer::Known(None));
    }
}

/// With and without a page above in which the span may continue.
#[test]
fn floors_and_ceilings_at_the_ends_of_pages_are_those_of_the_spans() {
    // Quanta of 2⁻¹⁰ m, so that all heights are exact.
    let frame = Frame::new(0.25, 255.0 / 1024.0).unwrap();
    let mut random = Random(17);
    let mut at_ends = 0;
    for _ in 0..400 {
        let mut columns = Columns::new();
        let end = |random: &mut Random| PAGE_QUANTA * [-1, 0, 1][random.below(3)];
        for _ in 0..=random.below(6) {
            let end = end(&mut random);
            let (below, above) = ([0, 1, 300][random.below(3)], [0, 0, 1, 300][random.below(4)]);
            let pixel = (random.below(12i64) - 6, random.below(12i64));
            columns.insert(pixel, vec![(end - below, end + above, random.chance(30))]);
        }
        let pages = pages_of(&columns);
        let scene = Scene { frame, origin: Point3::origin(), points: Vec::new(), columns, pages };
        let store = scene.store();
        for _ in 0..20 {
            let corner = Point3::new(random.between(-1.6, 1.6), random.between(-0.1, 3.1), random.between(-20.0, 20.0));
            let size = [0.0, 0.6, 3.0][random.below(3)];
            let shape = Aabb::new(corner, corner + Vector3::repeat(size)).unwrap();
            let from = (end(&mut random) + [-1, 0, 1, 400][random.below(4)]) as f64 / 1024.0;
            let reach = [f64::INFINITY, 0.0, 1.0][random.below(3)];
            let what = format!("{shape:?} {from} {reach}: {:?}", scene.columns);
            let floor = scene.floor(scene.pixels_of(&shape), scene.quanta(from - reach, from));
            assert_eq!(floor_under(&store, &shape, from, reach), Answer::Known(floor), "{what}");
            let ceiling = scene.ceiling(scene.pixels_of(&shape), scene.quanta(from, from + reach));
            assert_eq!(ceiling_above(&store, &shape, from, reach), Answer::Known(ceiling), "{what}");
            at_ends += usize::from(floor.is_some_and(|floor| frame.quantum_floor(floor) % PAGE_QUANTA == 0));
        }
    }
    assert!(at_ends > 150, "{at_ends} floors at the ends of pages");
}

#[test]
fn a_scene_without_pages_holds_nothing() {
    let store = Snapshot::from_pages(Frame::new(0.1, 0.3).unwrap(), []);
    let (at, infinite) = (Point3::new(1.0, 2.0, 3.0), f64::INFINITY);
    let pawn = Aabb::standing(at, Vector3::new(0.5, 0.5, 1.8)).unwrap();
    let everything = Aabb::new([-infinite; 3].into(), [infinite; 3].into()).unwrap();
    for shape in [pawn, everything] {
        assert_eq!(overlaps(&store, &shape), Overlap::Clear);
        assert_eq!(probe(&store, &shape), Answer::Known(Probe::default()));
        assert_eq!(sweep(&store, &shape, Vector3::new(0.0, 3.0, -9.0)), Answer::Known(None));
        assert_eq!(depenetrate(&store, &shape, infinite), Answer::Known(Some(Vector3::zeros())));
        let heights = [
            clearance(&store, &shape, infinite),
            floor_under(&store, &shape, 9.0, infinite),
            ceiling_above(&store, &shape, -9.0, infinite),
            top_under(&store, &shape, 9.0, 9.0),
            mean_floor_under(&store, &shape, 9.0, 9.0),
        ];
        assert_eq!(heights, [Answer::Known(None); 5]);
    }
    assert_eq!(nearest_surface(&store, at, infinite), Answer::Known(None));
    assert_eq!(cast(&store, &Ray::new(at, Vector3::x(), infinite).unwrap()), Answer::Known(None));
}

#[test]
fn rays_end_at_the_first_span() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..200 {
            let from = scene.random_point(&mut random);
            let mut way = scene.random_point(&mut random) - from;
            for axis in 0..3 {
                if random.chance(25) {
                    way[axis] = 0.0;
                }
            }
            if way.norm() == 0.0 {
                way.z = -1.0;
            }
            let max = [f64::INFINITY, way.norm() * random.between(0.0, 3.0)][random.below(2)];
            let ray = Ray::new(from, way, max).unwrap();
            let Answer::Known(hit) = cast(&store, &ray) else { panic!("all pages are in memory") };
            let distance = hit.map(|hit| hit.distance);
            // A grazing ray enters a grown span much earlier than the span, and may miss a shrunk one.
            let (first, last) = (scene.cast(&ray, SLACK), scene.cast(&ray, -SLACK));
            if let Some(last) = last {
                assert!(distance.is_some_and(|d| d <= last + SLACK), "{ray:?}: {hit:?}, expected {last}");
            }
            if let Some(hit) = hit {
                let d = hit.distance;
                assert!(first.is_some_and(|first| d >= first - SLACK), "{ray:?}: {d}, expected {first:?}");
                assert!((0.0..=max).contains(&d), "{ray:?}: {d}");
                let faces = hit.normal.norm() == 1.0 && hit.normal.dot(&ray.direction()) < 0.0;
                assert!(faces || hit.normal == Vector3::zeros() && d == 0.0, "{ray:?} {hit:?}");
                let face = scene.has_face(ray.at(d), hit.normal, 2.0 * SLACK);
                assert!(face || d == 0.0, "{ray:?}: no face there: {hit:?}");
            }
        }
    }
}

/// A few pillars on hundreds of tiles, so that most rays cross many empty ones.
#[test]
fn rays_find_pillars_far_across_empty_tiles() {
    let frame = Frame::new(0.25, 0.5).unwrap();
    let mut random = Random(31);
    let mut columns = Columns::new();
    let mut pixel = |tiles: usize| random.below(64 * tiles) as i64 - 32 * tiles as i64;
    for _ in 0..60 {
        columns.insert((pixel(400), pixel(300)), vec![(-2000, 9000, false)]);
    }
    let pages = pages_of(&columns);
    let scene = Scene { frame, origin: Point3::origin(), points: Vec::new(), columns, pages };
    let store = scene.store();
    let pillars: Vec<_> = scene.columns.keys().map(|&(i, j)| [i, j].map(|n| (n as f64 + 0.5) * 0.25)).collect();
    let mut far = 0;
    for number in 0..400 {
        let [x, y] = pillars[number % pillars.len()];
        let from =
            Point3::new(random.between(-3500.0, 3500.0), random.between(-2600.0, 2600.0), random.between(-3.0, 17.0));
        let aim = Point3::new(x + random.between(-0.3, 0.3), y + random.between(-0.3, 0.3), random.between(-3.0, 17.0));
        let ray = Ray::new(from, aim - from, f64::INFINITY).unwrap();
        let Answer::Known(hit) = cast(&store, &ray) else { panic!("all pages are in memory") };
        let (early, late) = (scene.cast(&ray, SLACK), scene.cast(&ray, -SLACK));
        assert!(
            late.is_none_or(|late| hit.is_some_and(|hit| hit.distance <= late + SLACK)),
            "{ray:?}: {hit:?} {late:?}"
        );
        assert!(
            hit.is_none_or(|hit| early.is_some_and(|early| hit.distance >= early - SLACK)),
            "{ray:?}: {hit:?} {early:?}"
        );
        far += usize::from(hit.is_some_and(|hit| hit.distance > 64.0 * 16.0));
    }
    assert!(far > 50, "{far} far ones: the test shows little");
}

#[test]
fn a_ray_along_an_axis_through_a_point_hits() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..200 {
            let point = scene.points[random.below(scene.points.len())];
            let axis = random.below(3);
            let mut way = Vector3::zeros();
            way[axis] = [1.0, -1.0][random.below(2)];
            let ray = Ray::new(point - way * scene.frame.pixel_m() * 100.0, way, f64::INFINITY).unwrap();
            let Answer::Known(Some(hit)) = cast(&store, &ray) else { panic!("{ray:?} passes through {point}") };
            let beyond = (ray.at(hit.distance) - point).dot(&way);
            assert!(beyond <= SLACK, "{ray:?} passes through {point}, and hits {beyond} m beyond: {hit:?}");
        }
    }
}

#[test]
fn shapes_beyond_all_bounds_are_answered_at_once() {
    let (scene, _) = Scene::all().nth(4).unwrap();
    let mut pages = scene.pages.clone();
    // One outlier extends the bounds to the end of the grid.
    let far = (1 << 30) - 1;
    pages.push((PageKey { tx: far, ty: -far, layer: far }, pages[0].1.clone()));
    let store = Snapshot::from_pages(scene.frame, pages);
    let infinite = f64::INFINITY;
    let everything = |z0, z1| Aabb::new([-infinite, -1e300, z0].into(), [infinite, 1e12, z1].into()).unwrap();
    assert_eq!(overlaps(&store, &everything(-infinite, infinite)), Overlap::Hit);
    assert_eq!(overlaps(&store, &everything(-1e15, -1e14)), Overlap::Clear);
    assert_eq!(overlaps(&store, &everything(1e14, infinite)), Overlap::Clear);
    assert!(probe(&store, &everything(-1e15, 1e15)).known().unwrap().floor_z.is_some());
    let whole = everything(-infinite, infinite);
    let highest = floor_under(&store, &whole, infinite, infinite).known().unwrap();
    assert!(highest.is_some() && highest == floor_under(&store, &whole, 1e15, 2e15).known().unwrap());
    let lowest = ceiling_above(&store, &whole, -infinite, infinite).known().unwrap();
    assert!(lowest.is_some() && lowest == ceiling_above(&store, &whole, -1e15, 2e15).known().unwrap());
    for far in [1e12, -1e12, 1e300] {
        // In a single pixel.
        for at in [Point3::new(far, 0.0, 0.0), Point3::new(0.0, far, 0.0)] {
            assert_eq!(overlaps(&store, &Aabb::new(at, at).unwrap()), Overlap::Clear, "{at}");
        }
    }
    let big = Sphere::new(Point3::new(0.0, 0.0, -1e10), 0.9e10).unwrap();
    assert_eq!(overlaps(&store, &big), Overlap::Clear);
    let below = Ray::new(Point3::new(-1e12, 3.0, -1e12), Vector3::new(1.0, 0.0, 1e-9), infinite).unwrap();
    assert_eq!(cast(&store, &below), Answer::Known(None));
    let above = scene.origin + Vector3::new(0.0, 0.0, 1e4);
    let across = Ray::new(above, Vector3::new(1.0, -1.0, 0.0), infinite).unwrap();
    assert_eq!(cast(&store, &across), Answer::Known(None));
}

#[test]
fn refuses_shapes_that_are_none() {
    let p = |x, y, z| Point3::new(x, y, z);
    assert!(Aabb::new(p(0.0, f64::NAN, 0.0), p(1.0, 1.0, 1.0)).is_err());
    assert!(Aabb::new(p(0.0, 2.0, 0.0), p(1.0, 1.0, 1.0)).is_err());
    assert!(Cylinder::new(p(0.0, 0.0, 0.0), -1.0, 1.0).is_err());
    assert!(Cylinder::new(p(0.0, 0.0, 0.0), 1.0, f64::NAN).is_err());
    assert!(Sphere::new(p(0.0, f64::INFINITY, 0.0), 1.0).is_err());
    assert!(Ray::new(p(0.0, 0.0, 0.0), Vector3::zeros(), 1.0).is_err());
    assert!(Ray::new(p(0.0, 0.0, 0.0), Vector3::x(), -1.0).is_err());
    assert!(Ray::new(p(0.0, 0.0, 0.0), Vector3::x() * 1e-310, 1.0).is_ok());
}

#[test]
fn batches_answer_like_single_queries() {
    let (mut touching, mut ends) = (0, 0);
    for (scene, mut random) in Scene::all().take(6) {
        let store = scene.store();
        let boxes: Vec<_> = (0..100).map(|_| scene.random_box(&mut random)).collect();
        let mut answers = vec![Overlap::Clear; boxes.len()];
        overlaps_batch(&store, &boxes, &mut answers);
        touching += answers.iter().filter(|answer| **answer == Overlap::Hit).count();
        let mut probes = vec![Answer::Known(Probe::default()); boxes.len()];
        probe_batch(&store, &boxes, &mut probes);
        for (n, shape) in boxes.iter().enumerate() {
            assert_eq!(answers[n], overlaps(&store, shape));
            assert_eq!(probes[n], probe(&store, shape));
        }
        let up = Vector3::new(0.0, 0.0, 1e-3);
        let way = |shape: &Aabb, to: Point3<f64>| Ray::new(shape.min(), to - shape.min() + up, f64::INFINITY).unwrap();
        let rays: Vec<_> = boxes.iter().map(|shape| way(shape, scene.random_point(&mut random))).collect();
        let mut hits = vec![Answer::Known(None); rays.len()];
        cast_batch(&store, &rays, &mut hits);
        assert!(rays.iter().zip(&hits).all(|(ray, hit)| *hit == cast(&store, ray)));
        ends += hits.iter().filter(|hit| matches!(hit, Answer::Known(Some(_)))).count();
    }
    // An answer left as it was would be "clear" or none.
    assert!(touching > 60 && ends > 60, "{touching} boxes touch, {ends} rays end");
}

proptest! {
    #[test]
    fn growing_a_box_never_turns_hit_into_clear(
        seed in 0u64..500, grow in prop::array::uniform6(0.0f64..0.5), which in 0u64..1000
    ) {
        let scene = Scene::new(seed, [0.0, 5e5, -1e7][seed as usize % 3], 100);
        let store = scene.store();
        let shape = scene.random_box(&mut Random(which));
        let (a, b) = (Vector3::new(grow[0], grow[1], grow[2]), Vector3::new(grow[3], grow[4], grow[5]));
        let grown = Aabb::new(shape.min() - a, shape.max() + b).unwrap();
        if overlaps(&store, &shape) == Overlap::Hit {
            prop_assert_eq!(overlaps(&store, &grown), Overlap::Hit);
        }
    }

    #[test]
    fn every_shape_of_no_size_at_a_point_hits_it(x in -1e7f64..1e7, y in -1e7f64..1e7, z in -1e5f64..1e5) {
        let mut scene = Scene::new(1, 0.0, 1);
        let frame = &scene.frame;
        let matter = (frame.quantum_floor(z), frame.quantum_ceil(z), false);
        scene.pages = pages_of(&Columns::from([((frame.pixel_of(x), frame.pixel_of(y)), vec![matter])]));
        let store = scene.store();
        let p = Point3::new(x, y, z);
        prop_assert_eq!(overlaps(&store, &Aabb::new(p, p).unwrap()), Overlap::Hit);
        prop_assert_eq!(overlaps(&store, &Sphere::new(p, 0.0).unwrap()), Overlap::Hit);
        prop_assert_eq!(overlaps(&store, &Cylinder::new(p, 0.0, 0.0).unwrap()), Overlap::Hit);
        let ray = Ray::new(p, Vector3::new(1.0, 2.0, -3.0), 0.0).unwrap();
        prop_assert!(cast(&store, &ray).known().flatten().is_some_and(|hit| hit.distance == 0.0));
    }
}
