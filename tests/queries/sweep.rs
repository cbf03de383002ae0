//! Sweeps, clearance and ways out of solid, compared with brute force over the spans and with dense steps of
//! `overlaps`.

mod infinite;
use crate::scene;

use nalgebra::{Point3, Vector3};
use scene::{Random, Scene};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey, TILE_PIXELS};
use slicewalk::page::{Page, PageBuilder, Span};
use slicewalk::query::*;
use slicewalk::store::{Missing, Snapshot};

/// Rounding errors at 10⁷ m, of the library and of the tests (m).
const SLACK: f64 = 1e-7;
/// Slack along a way past the edge of a round shape: a slightly smaller gap there needs a much longer way (m).
const ROUND_SLACK: f64 = 1e-3;

/// Boxes of all spans (m).
fn boxes(scene: &Scene) -> Vec<([f64; 3], [f64; 3])> {
    let (frame, quantum) = (&scene.frame, scene.frame.quantum_m());
    let columns = scene.columns.iter();
    columns
        .flat_map(|(&(i, j), spans)| {
            spans.iter().map(move |m| {
                let low = [frame.edge_of_pixel(i), frame.edge_of_pixel(j), m.0 as f64 * quantum];
                let high = [frame.edge_of_pixel(i + 1), frame.edge_of_pixel(j + 1), m.1 as f64 * quantum];
                (low, high)
            })
        })
        .collect()
}

/// First time at which the box `shape` meets one of `boxes` grown by `grow` (negative: shrunk).
fn brute_box(boxes: &[([f64; 3], [f64; 3])], shape: &Aabb, motion: Vector3<f64>, grow: f64) -> Option<f64> {
    let hits = boxes.iter().filter_map(|(low, high)| {
        let (mut t0, mut t1) = (f64::NEG_INFINITY, f64::INFINITY);
        for a in 0..3 {
            // The shape as a point, the box enlarged by its size.
            let (lo, hi) = (low[a] - grow - shape.max()[a], high[a] + grow - shape.min()[a]);
            if lo > hi {
                return None;
            }
            if motion[a] == 0.0 {
                if lo >= 0.0 || hi <= 0.0 {
                    return None;
                }
            } else {
                t0 = t0.max((lo / motion[a]).min(hi / motion[a]));
                t1 = t1.min((lo / motion[a]).max(hi / motion[a]));
            }
        }
        (t0 < t1 && t1 > 0.0 && t0 <= 1.0).then_some(t0.max(0.0))
    });
    hits.min_by(f64::total_cmp)
}

/// Distance from a round shape moved by `way` to a box; negative inside.
fn gap(low: &[f64; 3], high: &[f64; 3], center: Point3<f64>, radius: f64, height: Option<f64>) -> f64 {
    let axis = |a: usize| (low[a] - center[a]).max(center[a] - high[a]).max(0.0);
    match height {
        None => Vector3::new(axis(0), axis(1), axis(2)).norm() - radius,
        Some(height) => {
            let up = (low[2] - center.z - height).max(center.z - high[2]);
            (axis(0).hypot(axis(1)) - radius).max(up)
        }
    }
}

/// First time at which a round shape comes nearer than `near` to one of `boxes`. The gap is a convex function of time,
/// so a search for its minimum and then for its first root finds it.
fn brute_round(
    boxes: &[([f64; 3], [f64; 3])],
    center: Point3<f64>,
    radius: f64,
    height: Option<f64>,
    motion: Vector3<f64>,
    near: f64,
) -> Option<f64> {
    let hits = boxes.iter().filter_map(|(low, high)| {
        let at = |t: f64| gap(low, high, center + motion * t, radius, height) - near;
        let (mut a, mut b) = (0.0, 1.0);
        for _ in 0..120 {
            let (c, d) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
            if at(c) <= at(d) { b = d } else { a = c }
        }
        let least = [a, 0.0, 1.0].into_iter().min_by(|s, t| at(*s).total_cmp(&at(*t)))?;
        if at(least) >= 0.0 {
            return None;
        }
        let (mut a, mut b) = (0.0, least);
        for _ in 0..60 {
            let middle = 0.5 * (a + b);
            if at(middle) < 0.0 { b = middle } else { a = middle }
        }
        Some(b)
    });
    hits.min_by(f64::total_cmp)
}

/// Motions of all kinds: along an axis, diagonal, tiny, as long as the scene and far longer.
fn random_motion(scene: &Scene, random: &mut Random) -> Vector3<f64> {
    let length = scene.frame.pixel_m() * [0.1, 2.0, 30.0, 3000.0][random.below(4)];
    let mut motion = Vector3::from_fn(|_, _| random.between(-length, length));
    for axis in 0..3 {
        if random.chance(35) {
            motion[axis] = 0.0;
        }
    }
    motion
}

/// A box of at most a pawn's size, often with faces on edges of pixels and quanta.
fn random_pawn(scene: &Scene, random: &mut Random) -> Aabb {
    let t = scene.frame.pixel_m();
    let a = scene.random_point(random);
    let most = [0.0, 2.0, 12.0][random.below(3)];
    let mut size = Vector3::from_fn(|_, _| t * random.between(0.0, most));
    if random.chance(40) {
        size = size.map(|v| (v / t).round() * t);
    }
    // Without height it could lie in the plane between two pages, or move across its own plane.
    size.z = size.z.max(1e-3 * t);
    Aabb::new(a, a + size).unwrap()
}

fn check(hit: Option<SweepHit>, early: Option<f64>, late: Option<f64>, motion: Vector3<f64>, what: &str) {
    let tolerance = SLACK / motion.norm().max(SLACK);
    if let Some(late) = late {
        let at = hit.unwrap_or_else(|| panic!("{what}: no hit, expected one at {late}")).fraction;
        assert!(at <= late + tolerance, "{what}: {hit:?} later than {late}");
    }
    if let Some(hit) = hit {
        let early = early.unwrap_or_else(|| panic!("{what}: {hit:?}, expected none"));
        assert!(hit.fraction >= early - tolerance, "{what}: {hit:?} earlier than {early}");
        assert!((0.0..=1.0).contains(&hit.fraction) && (hit.distance - hit.fraction * motion.norm()).abs() < 1e-9);
        let length = hit.normal.norm();
        assert!(hit.begins_inside() && hit.fraction == 0.0 || (length - 1.0).abs() < 1e-9, "{what}: {hit:?}");
        assert!(hit.normal.dot(&motion) <= SLACK * motion.norm(), "{what}: {hit:?} faces the motion {motion}");
    }
}

#[test]
fn boxes_stop_at_the_first_span() {
    for (scene, mut random) in Scene::all() {
        let (store, boxes) = (scene.store(), boxes(&scene));
        for _ in 0..150 {
            let (shape, motion) = (random_pawn(&scene, &mut random), random_motion(&scene, &mut random));
            let Answer::Known(hit) = sweep(&store, &shape, motion) else { panic!("all pages are in memory") };
            let (early, late) = (brute_box(&boxes, &shape, motion, SLACK), brute_box(&boxes, &shape, motion, -SLACK));
            check(hit, early, late, motion, &format!("{shape:?} by {motion:?}"));
        }
    }
}

#[test]
fn cylinders_and_spheres_stop_at_the_first_span() {
    for (scene, mut random) in Scene::all() {
        let (store, boxes) = (scene.store(), boxes(&scene));
        if boxes.len() > 1000 {
            continue;
        }
        for _ in 0..40 {
            let motion = random_motion(&scene, &mut random);
            let center = scene.random_point(&mut random);
            let t = scene.frame.pixel_m();
            let (r, h) = (t * random.between(0.1, 8.0), t * random.between(0.0, 20.0));
            let known = |answer| match answer {
                Answer::Known(hit) => hit,
                Answer::NotLoaded(_) => panic!("all pages are in memory"),
            };
            let cylinder = known(sweep(&store, &Cylinder::new(center, r, h).unwrap(), motion));
            let times = |height, near| brute_round(&boxes, center, r, height, motion, near);
            let what = format!("{center} {r} {h} by {motion:?}");
            check(cylinder, times(Some(h), SLACK), times(Some(h), -SLACK), motion, &format!("cylinder {what}"));
            let sphere = known(sweep(&store, &Sphere::new(center, r).unwrap(), motion));
            check(sphere, times(None, SLACK), times(None, -SLACK), motion, &format!("sphere {what}"));
        }
    }
}

#[test]
fn before_a_contact_dense_steps_touch_nothing() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..30 {
            let (shape, motion) = (random_pawn(&scene, &mut random), random_motion(&scene, &mut random));
            let Answer::Known(hit) = sweep(&store, &shape, motion) else { panic!("all pages are in memory") };
            let moved = |by: Vector3<f64>, grow: f64| {
                let grow = Vector3::repeat(grow);
                Aabb::new(shape.min() + by - grow, shape.max() + by + grow).ok()
            };
            let until = hit.map_or(1.0, |hit| hit.fraction);
            for step in 0..200 {
                let inner = moved(motion * (until * f64::from(step) / 199.0), -SLACK);
                let touches = inner.is_some_and(|inner| overlaps(&store, &inner) == Overlap::Hit);
                assert!(!touches || hit.is_some_and(|hit| hit.begins_inside()), "{shape:?} by {motion:?}: {hit:?}");
            }
            if let Some(hit) = hit {
                let outer = moved(motion * hit.fraction, SLACK).unwrap();
                assert_eq!(overlaps(&store, &outer), Overlap::Hit, "{shape:?} by {motion:?}: {hit:?}");
            }
        }
    }
}

#[test]
fn after_a_contact_the_way_along_it_and_back_is_free() {
    for (scene, mut random) in Scene::all() {
        let store = scene.store();
        for _ in 0..100 {
            let (shape, motion) = (random_pawn(&scene, &mut random), random_motion(&scene, &mut random));
            let Answer::Known(Some(hit)) = sweep(&store, &shape, motion) else { continue };
            if hit.begins_inside() {
                continue;
            }
            let by = motion * hit.fraction;
            let there = Aabb::new(shape.min() + by, shape.max() + by).unwrap();
            let again = |motion| sweep(&store, &there, motion).known().flatten();
            if let Some(back) = again(-by) {
                // Rounding errors may let what was touched at the start stop the end of the way back.
                assert!((1.0 - back.fraction) * by.norm() < SLACK, "{there:?} by {:?}: {back:?}", -by);
            }
            if motion.norm() > SLACK * 10.0 {
                let on = again(motion * 2.0)
                    .unwrap_or_else(|| panic!("{there:?} by {motion:?}: free after {hit:?} of {shape:?}"));
                assert!(on.distance < SLACK && !on.begins_inside(), "{there:?} by {motion:?}: {on:?} after {hit:?}");
            }
        }
    }
}

#[test]
fn creeping_into_matter_never_gets_inside() {
    for (scene, mut random) in Scene::all().take(30) {
        let store = scene.store();
        for _ in 0..20 {
            let (mut shape, motion) = (random_pawn(&scene, &mut random), random_motion(&scene, &mut random));
            let tiny = motion * (1e-10 / motion.norm().max(1e-10));
            for _ in 0..30 {
                match sweep(&store, &shape, motion).known().flatten() {
                    Some(hit) if hit.begins_inside() => break,
                    Some(hit) => {
                        let by = motion * hit.fraction;
                        shape = Aabb::new(shape.min() + by, shape.max() + by).unwrap();
                    }
                    None => break,
                }
                for _ in 0..20 {
                    let hit = sweep(&store, &shape, tiny).known().flatten();
                    assert!(hit.is_none_or(|hit| !hit.begins_inside()), "{shape:?} by {tiny:?}: {hit:?}");
                    let by = tiny * hit.map_or(1.0, |hit| hit.fraction);
                    shape = Aabb::new(shape.min() + by, shape.max() + by).unwrap();
                }
            }
        }
    }
}

#[test]
fn the_answer_does_not_depend_on_where_pages_begin() {
    // A scene moved by parts of a tile: boundaries lie elsewhere, everything else is the same bit for bit.
    let (t, s) = (0.0625, 0.25);
    let frame = Frame::new(t, s).unwrap();
    let mut random = Random(7);
    for _ in 0..60 {
        let matter: Vec<_> = (0..400)
            .map(|_| {
                let axis = |random: &mut Random| random.below(40) as i64 - 20;
                let bottom = random.below(255 * 12) as i64 - 255 * 6;
                ((axis(&mut random), axis(&mut random)), bottom, random.chance(50))
            })
            .collect();
        let store = |di: i64, dj: i64, ds: i64| {
            let mut columns = scene::Columns::new();
            for &((i, j), bottom, obstacle) in &matter {
                // Within one slice, and one per pixel.
                let base = bottom.div_euclid(255) * 255 + ds * 255;
                let low = bottom + ds * 255;
                columns.insert((i + di, j + dj), vec![(low, (low + 40).min(base + 250).max(low), obstacle)]);
            }
            Snapshot::from_pages(frame, scene::pages_of(&columns))
        };
        let (here, there) = (store(0, 0, 0), store(37, -23, 29));
        let shift = Vector3::new(37.0 * t, -23.0 * t, 29.0 * s);
        for _ in 0..50 {
            let mut steps = |n: usize, unit: f64| (random.below(n) as f64 - n as f64 / 2.0) * unit;
            let at = Point3::new(steps(200, t / 4.0), steps(200, t / 4.0), steps(100, s / 8.0));
            let shape = |by| Aabb::standing(at + by, Vector3::new(0.5, 0.5, 1.75)).unwrap();
            let motion = Vector3::new(steps(64, t), steps(64, t), steps(16, s));
            let (a, b) = (sweep(&here, &shape(Vector3::zeros()), motion), sweep(&there, &shape(shift), motion));
            let (a, b) = (a.known().flatten(), b.known().flatten());
            assert_eq!(a.is_some(), b.is_some());
            if let (Some(a), Some(b)) = (a, b) {
                assert!((a.fraction - b.fraction).abs() < 1e-12, "{a:?} {b:?}");
                assert_eq!(a.normal, b.normal, "{a:?} {b:?}");
                if a.begins_inside() {
                    continue;
                }
                assert_eq!(a.obstacle, b.obstacle);
                assert_eq!([a.pixel[0] + 37, a.pixel[1] - 23], b.pixel);
            }
        }
    }
}

/// Pixel, top (quanta) and kind of each span of each page; a span that continues in another page has a top there, too.
fn tops(scene: &Scene) -> Vec<([i64; 2], i64, bool)> {
    let of_page = |(key, page): &(PageKey, Page)| -> Vec<_> {
        let place = |tile: i32, pixel: u32| i64::from(tile) * TILE_PIXELS + i64::from(pixel);
        let base = i64::from(key.layer) * PAGE_QUANTA;
        let pixels = (0..64 * 64).map(|pixel| (pixel % 64, pixel / 64));
        let spans = pixels.flat_map(|(px, py)| {
            let pixel = [place(key.tx, px), place(key.ty, py)];
            page.column(px, py).iter().map(move |span| (pixel, base + i64::from(span.top()), span.is_obstacle()))
        });
        spans.collect()
    };
    scene.pages.iter().flat_map(of_page).collect()
}

#[test]
fn tops_and_mean_floors_are_those_of_the_pixels_under_the_shape() {
    let (mut found, mut means) = (0, 0);
    for (scene, mut random) in Scene::all() {
        let (store, frame, tops) = (scene.store(), &scene.frame, tops(&scene));
        let edges = |n: i64| (frame.edge_of_pixel(n), frame.edge_of_pixel(n + 1));
        for turn in 0..12 {
            let pawn = random_pawn(&scene, &mut random);
            let (min, max, middle) = (pawn.min(), pawn.max(), nalgebra::center(&pawn.min(), &pawn.max()));
            let (from, depth) = (scene.random_point(&mut random).z, frame.slice_m() * random.between(0.0, 30.0));
            let radius = frame.pixel_m() * random.between(0.1, 8.0);
            // How deep the footprint reaches into a pixel; touching is not enough.
            let in_box = |i: i64, j: i64| {
                let deep = |a: usize, (low, high): (f64, f64)| max[a].min(high) - min[a].max(low);
                deep(0, edges(i)).min(deep(1, edges(j)))
            };
            let in_disc = |i: i64, j: i64| {
                let gap = |a: usize, (low, high): (f64, f64)| (low - middle[a]).max(middle[a] - high).max(0.0);
                radius - gap(0, edges(i)).hypot(gap(1, edges(j)))
            };
            let (depth_in, answers): (&dyn Fn(i64, i64) -> f64, _) = match turn % 3 {
                0 => (&in_box, (top_under(&store, &pawn, from, depth), mean_floor_under(&store, &pawn, from, depth))),
                1 => {
                    let cylinder = Cylinder::new(middle, radius, 1.0).unwrap();
                    let mean = mean_floor_under(&store, &cylinder, from, depth);
                    (&in_disc, (top_under(&store, &cylinder, from, depth), mean))
                }
                _ => {
                    let sphere = Sphere::new(middle, radius).unwrap();
                    let mean = mean_floor_under(&store, &sphere, from, depth);
                    (&in_disc, (top_under(&store, &sphere, from, depth), mean))
                }
            };
            let (top, mean) = (answers.0.known().unwrap(), answers.1.known().unwrap());
            let what = format!("{pawn:?}, radius {radius}, from {from} by {depth}");
            let window = frame.quantum_ceil(from - depth)..=frame.quantum_floor(from);
            let [sure, possible] = [SLACK, -SLACK].map(|least| {
                let under = tops.iter().filter(|(_, top, _)| window.contains(top));
                under.filter(|([i, j], ..)| depth_in(*i, *j) > least).collect::<Vec<_>>()
            });
            let highest = |tops: &[&([i64; 2], i64, bool)]| {
                tops.iter().map(|(_, top, _)| *top).max().map(|top| frame.top_height(top))
            };
            assert!(highest(&sure) <= top && top <= highest(&possible), "{what}: {top:?}");
            found += usize::from(top.is_some());
            if sure.len() == possible.len() {
                let floors: Vec<_> =
                    sure.iter().filter(|(.., obstacle)| !obstacle).map(|(_, top, _)| *top as f64).collect();
                let expected = floors.iter().sum::<f64>() / floors.len() as f64 * frame.quantum_m();
                assert_eq!(mean.is_some(), !floors.is_empty(), "{what}: {mean:?}");
                assert!(mean.is_none_or(|mean| (mean - expected).abs() < 1e-9), "{what}: {mean:?}, not {expected}");
                means += usize::from(mean.is_some());
            }
        }
        let pawn = random_pawn(&scene, &mut random);
        for (from, depth) in [(f64::NAN, 1.0), (1.0, f64::NAN), (f64::INFINITY, 1.0), (1.0, f64::INFINITY), (1.0, -1.0)]
        {
            assert_eq!(top_under(&store, &pawn, from, depth), Answer::Known(None), "from {from} by {depth}");
            assert_eq!(mean_floor_under(&store, &pawn, from, depth), Answer::Known(None), "from {from} by {depth}");
        }
    }
    assert!(found > 100 && means > 60, "{found} tops, {means} means");
}

#[test]
fn clearance_is_the_distance_to_the_nearest_span() {
    for (scene, mut random) in Scene::all() {
        let (store, boxes) = (scene.store(), boxes(&scene));
        for _ in 0..60 {
            let shape = random_pawn(&scene, &mut random);
            let max = scene.frame.pixel_m() * [0.5, 5.0, 200.0][random.below(3)];
            let near = |answer: Answer<Option<f64>>, nearest: f64, what: &str| {
                let Answer::Known(answer) = answer else { panic!("all pages are in memory") };
                match answer {
                    Some(distance) => assert!((distance - nearest).abs() < SLACK, "{what}: {distance}, {nearest}"),
                    None => assert!(nearest > max - SLACK, "{what}: none, {nearest}"),
                }
            };
            let apart = |(low, high): &([f64; 3], [f64; 3])| {
                let gap = |a: usize| (low[a] - shape.max()[a]).max(shape.min()[a] - high[a]).max(0.0);
                Vector3::new(gap(0), gap(1), gap(2)).norm()
            };
            let nearest = boxes.iter().map(apart).fold(f64::INFINITY, f64::min);
            near(clearance(&store, &shape, max), nearest, "box");
            let (center, r) = (shape.min(), scene.frame.pixel_m());
            let sphere = Sphere::new(center, r).unwrap();
            near(clearance(&store, &sphere, max), (scene.distance(center) - r).max(0.0), "sphere");
        }
    }
}

#[test]
fn the_way_out_of_matter_is_free_and_the_shortest() {
    for (scene, mut random) in Scene::all() {
        let (store, boxes) = (scene.store(), boxes(&scene));
        for _ in 0..40 {
            let shape = random_pawn(&scene, &mut random);
            let max = scene.frame.pixel_m() * 40.0;
            let Answer::Known(out) = depenetrate(&store, &shape, max) else { panic!("all pages are in memory") };
            let inside = |by: Vector3<f64>, grow: f64| {
                let moved = Aabb::new(shape.min() + by, shape.max() + by).unwrap();
                brute_box(&boxes, &moved, Vector3::zeros(), grow).is_some()
            };
            let Some(out) = out else {
                assert!(inside(Vector3::zeros(), SLACK));
                continue;
            };
            assert!(!inside(out, -SLACK), "{shape:?} pushed by {out:?}");
            let distance = out.norm();
            for step in 0..20 {
                for axis in 0..3 {
                    for sign in [1.0, -1.0] {
                        let mut shorter = Vector3::zeros();
                        shorter[axis] = sign * (distance - 2.0 * SLACK) * f64::from(step) / 20.0;
                        assert!(distance < 3.0 * SLACK || inside(shorter, SLACK), "{shape:?}: {shorter:?} < {out:?}");
                    }
                }
            }
            let cylinder = Cylinder::new(shape.min(), scene.frame.pixel_m() * 3.0, 0.5).unwrap();
            let sphere = Sphere::new(shape.min(), scene.frame.pixel_m() * 3.0).unwrap();
            // Whether a round shape moved this far along one axis is in solid, with gaps above `least` counted as none.
            let within = |shape: &[f64; 4], height: Option<f64>, by: Vector3<f64>, least: f64| {
                let at = Point3::new(shape[0], shape[1], shape[2]) + by;
                boxes.iter().any(|(low, high)| gap(low, high, at, shape[3], height) < least)
            };
            let round = |at: Point3<f64>, radius: f64| [at.x, at.y, at.z, radius];
            let (feet, center) = (round(cylinder.feet(), cylinder.radius()), round(sphere.center(), sphere.radius()));
            let ways = [
                (feet, Some(cylinder.height()), depenetrate(&store, &cylinder, max)),
                (center, None, depenetrate(&store, &sphere, max)),
            ];
            for (place, height, out) in ways {
                let Answer::Known(Some(out)) = out else { continue };
                assert!(!within(&place, height, out, -SLACK), "{place:?} {height:?} pushed by {out:?}");
                let shorter = out.norm() - ROUND_SLACK;
                for (step, axis, sign) in (0..20).flat_map(|n| (0..6).map(move |way| (n, way / 2, way % 2))) {
                    let mut by = Vector3::zeros();
                    by[axis] = shorter * f64::from(step) / 20.0 * [1.0, -1.0][sign];
                    assert!(
                        shorter < 0.0 || within(&place, height, by, SLACK),
                        "{place:?} {height:?}: {by:?} < {out:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn pages_not_in_memory_are_never_taken_for_free() {
    for (scene, mut random) in Scene::all() {
        let full = scene.store();
        let some: Vec<_> = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(40)).collect();
        for _ in 0..25 {
            let (shape, motion) = (random_pawn(&scene, &mut random), random_motion(&scene, &mut random));
            let max = scene.frame.pixel_m() * 20.0;
            let mut store = scene.part(&some);
            loop {
                let (a, b, c) =
                    (sweep(&store, &shape, motion), clearance(&store, &shape, max), depenetrate(&store, &shape, max));
                let mut keys = Vec::new();
                for missing in [missing(a), missing(b), missing(c)].into_iter().flatten() {
                    assert!(missing.count() > 0);
                    keys.extend_from_slice(missing.keys());
                }
                if let Answer::Known(hit) = a {
                    let whole = sweep(&full, &shape, motion).known().flatten();
                    let inside = |hit: Option<SweepHit>| hit.is_some_and(|hit| hit.begins_inside());
                    assert!(hit == whole || inside(hit) && inside(whole), "{hit:?} {whole:?}");
                }
                if let Answer::Known(near) = b {
                    assert_eq!(Answer::Known(near), clearance(&full, &shape, max));
                }
                if let Answer::Known(out) = c {
                    assert_eq!(Answer::Known(out), depenetrate(&full, &shape, max));
                }
                if keys.is_empty() {
                    break;
                }
                keys.sort();
                keys.dedup();
                assert_eq!(store.load(&keys), keys.len());
            }
        }
    }
}

fn missing<T>(answer: Answer<T>) -> Option<Missing> {
    match answer {
        Answer::NotLoaded(missing) => Some(missing),
        Answer::Known(_) => None,
    }
}

#[test]
fn who_stands_on_matter_touches_it_and_is_not_inside() {
    // Quanta of 2⁻¹⁰ m, so that all heights are exact.
    let frame = Frame::new(0.25, 255.0 / 1024.0).unwrap();
    let mut builder = PageBuilder::default();
    let floor = Span::new(0, 512, false).unwrap();
    for pixel in 0..64 * 64 {
        assert!(builder.set_column(pixel % 64, pixel / 64, &[floor]));
    }
    let key = PageKey { tx: 0, ty: 0, layer: 0 };
    let store = Snapshot::from_pages(frame, [(key, builder.build())]);
    let (top, quantum, down) = (0.5, 1.0 / 1024.0, Vector3::new(0.0, 0.0, -1.0));
    let standing = |z: f64, motion: Vector3<f64>| {
        let at = Point3::new(4.0, 4.0, z);
        let hits = [
            sweep(&store, &Cylinder::new(at, 0.25, 1.0).unwrap(), motion),
            sweep(&store, &Aabb::new(at, at + Vector3::new(0.5, 0.5, 1.0)).unwrap(), motion),
        ];
        hits.map(|hit| hit.known().unwrap())
    };
    for hit in [down, Vector3::new(1.0, 0.0, -1.0)].into_iter().flat_map(|motion| standing(top, motion)) {
        let hit = hit.unwrap();
        assert!(hit.fraction == 0.0 && hit.normal == Vector3::z() && !hit.begins_inside(), "{hit:?}");
    }
    for hit in standing(top + quantum, down) {
        let hit = hit.unwrap();
        assert!((hit.distance - quantum).abs() < 1e-12 && hit.normal == Vector3::z(), "{hit:?}");
    }
    assert_eq!(standing(top, -down), [None; 2]);
    for hit in standing(top - quantum, down) {
        assert!(hit.unwrap().begins_inside());
    }
}

#[test]
fn a_round_shape_that_overlaps_a_corner_by_a_rounding_error_may_leave_it() {
    // 2⁻⁴⁸ of the corner's coordinates is `error`; pixels, shapes and motions are exact.
    let frame = Frame::new(0.25, 255.0 / 1024.0).unwrap();
    let (far, error) = (1i64 << 20, 2f64.powi(-28));
    let store =
        Snapshot::from_pages(frame, scene::pages_of(&scene::Columns::from([((far, far), vec![(0, 512, false)])])));
    let corner = frame.edge_of_pixel(far);
    let (away, towards, along) =
        (Vector3::new(-0.75, -1.0, 0.0), Vector3::new(0.75, 1.0, 0.0), Vector3::new(1.0, -0.75, 0.0));
    // Nearer to the corner along both axes by this share of a pixel, which is 1.4 times as much along the diagonal.
    for (nearer, is_inside) in [(0.0, false), (error / 2.0, false), (error, true)] {
        let [x, y] = [0.75, 1.0].map(|apart| corner - apart + 0.25 * nearer);
        let ask = |motion| {
            [
                sweep(&store, &Cylinder::new(Point3::new(x, y, 0.0), 1.25, 0.25).unwrap(), motion),
                sweep(&store, &Sphere::new(Point3::new(x, y, 0.25), 1.25).unwrap(), motion),
            ]
        };
        for hit in ask(towards) {
            let hit = hit.known().flatten().unwrap();
            assert!(hit.distance < SLACK && hit.begins_inside() == is_inside, "{nearer}: {hit:?}");
            let normal = if is_inside { Vector3::zeros() } else { Vector3::new(-0.6, -0.8, 0.0) };
            assert!((hit.normal - normal).norm() < 1e-6, "{nearer}: {hit:?}");
        }
        for hit in [away, along].into_iter().flat_map(ask) {
            let is_stopped = hit.known().flatten().is_some_and(|hit| hit.begins_inside());
            assert!(if is_inside { is_stopped } else { hit == Answer::Known(None) }, "{nearer}: {hit:?}");
        }
    }
}

/// The bounding box meets the edge all the way, the sphere never.
#[test]
fn a_sphere_passes_along_an_edge_that_is_further_than_its_radius() {
    let frame = Frame::new(0.25, 255.0 / 256.0).unwrap();
    let columns = (0..20).map(|i| ((i, 0), vec![(0, 256, false)])).collect();
    let store = Snapshot::from_pages(frame, scene::pages_of(&columns));
    for (aside, hits) in [(0.4, false), (0.3, true)] {
        for motion in [Vector3::x() * 3.0, Vector3::x() * -3.0] {
            let from = if motion.x > 0.0 { -1.0 } else { 6.0 };
            // From the upper edge of the row, as far to the side as above.
            let sphere = Sphere::new([from, 0.25 + aside, 1.0 + aside].into(), 0.5).unwrap();
            assert_eq!(sweep(&store, &sphere, motion).known().unwrap().is_some(), hits, "{aside} {motion:?}");
        }
    }
}

/// A body that comes down at the foot of a wall, or on an edge, lands: contact from above at the same moment counts.
#[test]
fn of_contacts_at_the_same_moment_landing_counts() {
    // Pixels of 1/4 m, quanta of 1/256 m: all ends are exact.
    let frame = Frame::new(0.25, 255.0 / 256.0).unwrap();
    let (floor, wall) = ((0, 256, false), (300, 700, false));
    for mirrored in [false, true] {
        let mut columns = scene::Columns::new();
        let pixel = |i: i64| if mirrored { -1 - i } else { i };
        let mut store = |at: &[(i64, scene::Matter)]| {
            columns.clear();
            columns.extend(at.iter().flat_map(|&(i, matter)| (-3..6).map(move |j| ((pixel(i), j), vec![matter]))));
            Snapshot::from_pages(frame, scene::pages_of(&columns))
        };
        let side: f64 = if mirrored { -1.0 } else { 1.0 };
        // Half a metre from the wall, half a metre above the floor.
        let (from, to) = (0.25 * side, 0.5 * side);
        let shape = Aabb::new([from.min(to), 0.25, 1.5].into(), [from.max(to), 0.5, 2.5].into()).unwrap();
        let motion = Vector3::new(side, 0.0, -1.0);
        let both = store(&[(2, floor), (3, floor), (4, wall)]);
        let edge = store(&[(4, floor)]);
        for store in [both, edge] {
            let hit = sweep(&store, &shape, motion).known().unwrap().unwrap();
            assert!((hit.fraction - 0.5).abs() < 1e-9 && hit.normal == Vector3::z(), "{hit:?}");
        }
        let hit = sweep(&store(&[(4, wall)]), &shape, motion).known().unwrap().unwrap();
        assert!((hit.fraction - 0.5).abs() < 1e-9 && hit.normal == -side * Vector3::x(), "{hit:?}");
    }
}

/// Spans of pixels of 1 m and quanta of 1 m.
fn metres(spans: &[((i64, i64), scene::Matter)]) -> Snapshot {
    let columns = spans.iter().map(|&(pixel, span)| (pixel, vec![span])).collect();
    Snapshot::from_pages(Frame::new(1.0, 255.0).unwrap(), scene::pages_of(&columns))
}

#[test]
fn of_spans_met_at_the_same_moment_the_obstacle_is_reported() {
    let shape = Aabb::new([0.0, 0.0, 6.0].into(), [2.0, 2.0, 8.0].into()).unwrap();
    for (pixels, low, high, motion) in [
        ([(0, 0), (1, 1)], 2, 4, Vector3::new(0.0, 0.0, -4.0)),
        ([(0, 0), (1, 1)], 10, 12, Vector3::new(0.0, 0.0, 4.0)),
        ([(4, 0), (4, 1)], 6, 8, Vector3::new(4.0, 0.0, 0.0)),
    ] {
        for obstacle in [0, 1] {
            let store = metres(&[0, 1].map(|n| (pixels[n], (low, high, n == obstacle))));
            let hit = sweep(&store, &shape, motion).known().flatten().unwrap();
            let (i, j) = pixels[obstacle];
            assert_eq!((hit.fraction, hit.obstacle, hit.pixel), (0.5, true, [i, j]), "{motion:?}");
        }
    }
}

#[test]
fn of_walls_met_at_the_same_moment_that_across_x_is_reported() {
    let shape = Aabb::new([0.0; 3].into(), [1.0; 3].into()).unwrap();
    let motion = Vector3::new(4.0, 4.0, 0.0);
    // Also if only the other is an obstacle.
    for obstacle in [false, true] {
        let store = metres(&[((3, 2), (0, 2, false)), ((2, 3), (0, 2, obstacle))]);
        let hit = sweep(&store, &shape, motion).known().flatten().unwrap();
        assert_eq!((hit.fraction, hit.normal, hit.pixel), (0.5, -Vector3::x(), [3, 2]));
        assert!(!hit.obstacle);
    }
}

#[test]
fn a_cylinder_meets_walls_with_its_side_and_floors_with_its_bottom() {
    let hit = |store: &Snapshot, z: f64, motion: Vector3<f64>| {
        let cylinder = Cylinder::new([0.0, 0.5, z].into(), 1.0, 1.0).unwrap();
        let hit = sweep(store, &cylinder, motion).known().flatten().unwrap();
        (hit.fraction, hit.normal)
    };
    let wall = metres(&[((3, 0), (0, 10, true))]);
    for rise in [0.5, -0.25, 0.0] {
        assert_eq!(hit(&wall, 0.5, Vector3::new(4.0, 0.0, rise)), (0.5, -Vector3::x()), "{rise}");
    }
    let floor = metres(&[((0, 0), (0, 2, false))]);
    for aside in [1.0, -1.0, 0.0] {
        assert_eq!(hit(&floor, 4.0, Vector3::new(aside, 0.0, -4.0)), (0.5, Vector3::z()), "{aside}");
    }
    // Both at once, on an edge: it lands.
    let edge = metres(&[((3, 0), (0, 2, false))]);
    assert_eq!(hit(&edge, 3.0, Vector3::new(4.0, 0.0, -2.0)), (0.5, Vector3::z()));
}

#[test]
fn round_shapes_of_no_radius_land_and_begin_inside_like_boxes() {
    let store = metres(&[((0, 0), (0, 2, false))]);
    let hits = |z: f64, motion: Vector3<f64>| {
        let at = Point3::new(0.5, 0.5, z);
        let hits = [
            sweep(&store, &Aabb::new(at, at).unwrap(), motion),
            sweep(&store, &Cylinder::new(at, 0.0, 0.0).unwrap(), motion),
            sweep(&store, &Sphere::new(at, 0.0).unwrap(), motion),
        ];
        hits.map(|hit| hit.known().flatten().unwrap())
    };
    for hit in hits(4.0, Vector3::new(0.0, 0.0, -4.0)) {
        assert_eq!((hit.fraction, hit.normal), (0.5, Vector3::z()));
    }
    for motion in [Vector3::zeros(), Vector3::new(0.0, 0.0, -4.0), Vector3::new(1.0, 1.0, 1.0)] {
        assert!(hits(1.0, motion).iter().all(SweepHit::begins_inside), "{motion:?}");
    }
    // What only touches the floor is stopped by it.
    for hit in hits(2.0, Vector3::new(0.0, 0.0, -4.0)) {
        assert_eq!((hit.fraction, hit.normal, hit.begins_inside()), (0.0, Vector3::z(), false));
    }
    let aslant = Vector3::new(1.0, 0.0, -4.0);
    let [upright, thin, point] = hits(2.0, aslant);
    assert_eq!([upright.normal, thin.normal, point.normal], [Vector3::z(), Vector3::z(), -aslant.normalize()]);
    let stands = Cylinder::new(Point3::new(0.5, 0.5, 2.0), 0.25, 1.0).unwrap();
    let round = sweep(&store, &stands, aslant).known().flatten().unwrap();
    for hit in [upright, thin, point, round] {
        assert_eq!((hit.fraction, hit.begins_inside()), (0.0, false));
    }
    assert_eq!(round.normal, Vector3::z());
}

/// The normal is that of the place of contact, not of the begin.
#[test]
fn round_shapes_meet_a_corner_halfway() {
    let store = metres(&[((0, 0), (0, 2, false))]);
    // Its corner is 3 m and 4 m away after half of the motion.
    let motion = Vector3::new(8.0, 0.0, 0.0);
    let hits = [
        sweep(&store, &Cylinder::new([-7.0, -4.0, 0.5].into(), 5.0, 1.0).unwrap(), motion),
        sweep(&store, &Sphere::new([-7.0, -4.0, 1.0].into(), 5.0).unwrap(), motion),
    ];
    for hit in hits {
        let hit = hit.known().flatten().unwrap();
        assert!((hit.fraction - 0.5).abs() < 1e-9, "{hit:?}");
        assert!((hit.normal - Vector3::new(-0.6, -0.8, 0.0)).norm() < 1e-9, "{hit:?}");
    }
}

#[test]
fn a_point_is_stopped_against_its_way() {
    let store = metres(&[((3, 4), (0, 2, false))]);
    let motion = Vector3::new(6.0, 8.0, 0.0);
    let hit = |x: f64, y: f64, radius: f64| {
        let point = Sphere::new([x, y, 1.0].into(), radius).unwrap();
        sweep(&store, &point, motion).known().flatten().unwrap()
    };
    let outside = hit(0.0, 0.5, 0.0);
    assert!((outside.fraction, outside.distance) == (0.5, 5.0), "{outside:?}");
    assert!((outside.normal - Vector3::new(-0.6, -0.8, 0.0)).norm() < 1e-12, "{outside:?}");
    // From there, and from inside, it goes nowhere.
    for (x, radius) in [(3.0, 0.0), (3.0, 1e-20), (3.5, 0.0), (3.5, 1e-20)] {
        assert_eq!(hit(x, 4.5, radius).fraction, 0.0, "{x} {radius}");
    }
}

#[test]
fn only_pages_that_could_hold_an_earlier_contact_are_missing() {
    let key = |tx, ty| PageKey { tx, ty, layer: 0 };
    // A span in each of two pages, and one of the pages in memory.
    let ask = |spans: [((i64, i64), scene::Matter); 2], loaded: PageKey, shape: &Aabb, motion: Vector3<f64>| {
        let mut part = scene::Part::new(metres(&spans));
        assert_eq!(part.load(&[loaded]), 1);
        sweep(&part, shape, motion)
    };
    let cube = Aabb::new([0.0; 3].into(), [1.0; 3].into()).unwrap();
    let walls = [((10, 0), (0, 2, true)), ((70, 0), (0, 2, true))];
    let behind = ask(walls, key(0, 0), &cube, Vector3::new(100.0, 0.0, 0.0));
    assert_eq!(behind.known().flatten().unwrap().pixel, [10, 0]);
    let before = ask(walls, key(1, 0), &cube, Vector3::new(100.0, 0.0, 0.0));
    assert_eq!(missing(before).unwrap().keys(), [key(0, 0)]);
    // The page of the higher ceiling is visited first.
    let wide = Aabb::new([0.0, 60.0, 0.0].into(), [1.0, 68.0, 1.0].into()).unwrap();
    let ceilings = [((0, 60), (2550, 2560, false)), ((0, 65), (1275, 1280, false))];
    let above = ask(ceilings, key(0, 1), &wide, Vector3::new(0.0, 0.0, 4000.0));
    assert_eq!(above.known().flatten().unwrap().pixel, [0, 65]);
    let below = ask(ceilings, key(0, 0), &wide, Vector3::new(0.0, 0.0, 4000.0));
    assert_eq!(missing(below).unwrap().keys(), [key(0, 1)]);
    // Nothing is earlier than a begin inside.
    let inside = Aabb::new([63.25, 0.0, 0.0].into(), [64.75, 1.0, 1.0].into()).unwrap();
    let begin = ask([((63, 0), (0, 2, true)), ((64, 0), (0, 2, true))], key(1, 0), &inside, Vector3::x());
    assert!(begin.known().flatten().unwrap().begins_inside());
}

#[test]
fn a_thin_wall_stops_at_any_speed() {
    // One pixel thick, and one quantum thick from above.
    let frame = Frame::new(0.05, 0.15).unwrap();
    for far in [0i64, 200_000_000] {
        let columns: scene::Columns = (-40..40)
            .flat_map(|j| {
                let wall = ((far + 100, j), vec![(0, 3400, true)]);
                (far - 20..far + 100).map(move |i| ((i, j), vec![(-7, -7, false)])).chain([wall])
            })
            .collect();
        let store = Snapshot::from_pages(frame, scene::pages_of(&columns));
        let from = store.frame().edge_of_pixel(far);
        for speed in [0.1, 1.4, 30.0, 300.0, 3e4, 3e8] {
            for hz in [15.0, 60.0, 240.0] {
                let mut pawn = Aabb::standing([from, 0.0, 0.1].into(), [0.5, 0.5, 1.8].into()).unwrap();
                let step = Vector3::new(speed / hz, speed / hz * 0.01, 0.0);
                let mut frames = 0;
                let hit = loop {
                    if let Answer::Known(Some(hit)) = sweep(&store, &pawn, step) {
                        break hit;
                    }
                    pawn = Aabb::new(pawn.min() + step, pawn.max() + step).unwrap();
                    frames += 1;
                    assert!(frames < 100_000, "{speed} m/s");
                };
                assert_eq!((hit.normal, hit.obstacle), (-Vector3::x(), true));
                assert!((pawn.max().x + hit.fraction * step.x - from - 5.0).abs() < 1e-6);
                let fall = Vector3::new(0.0, 0.0, -speed / hz);
                let high = Aabb::standing([from, 0.0, 100.0].into(), [0.5, 0.5, 1.8].into()).unwrap();
                let Answer::Known(hit) = sweep(&store, &high, fall) else { panic!("in memory") };
                assert_eq!(hit.is_some(), speed / hz > 101.0);
                assert!(hit.is_none_or(|hit| hit.normal == Vector3::z() && !hit.obstacle));
            }
        }
    }
}

#[test]
fn long_and_endless_motions_are_answered_at_once() {
    let (scene, _) = Scene::all().nth(4).unwrap();
    let store = scene.store();
    let shape = Aabb::standing(scene.origin - Vector3::new(1e6, 0.0, 0.0), Vector3::new(0.5, 0.5, 1.8)).unwrap();
    for motion in [Vector3::new(1e9, 1e9, 1e9), Vector3::new(1e15, 0.0, 0.0), Vector3::new(-1e12, 1e12, 1.0)] {
        assert!(matches!(sweep(&store, &shape, motion), Answer::Known(_)));
    }
    let endless = sweep(&store, &shape, Vector3::new(f64::NAN, 0.0, f64::INFINITY)).known().flatten();
    let endless = endless.unwrap();
    assert!(endless.begins_inside() && (endless.fraction, endless.distance) == (0.0, 0.0));
    assert!(endless.heights.iter().all(|height| (height - shape.min().z).abs() < 1e-6), "{endless:?}");
    let through = sweep(&store, &shape, Vector3::new(2e6, 0.0, 0.0));
    assert!(matches!(through, Answer::Known(_)));
}

#[test]
fn batches_answer_like_single_queries() {
    let [mut stopped, mut near, mut inside] = [0; 3];
    for (scene, mut random) in Scene::all().take(9) {
        let store = scene.store();
        let ways: Vec<_> =
            (0..50).map(|_| (random_pawn(&scene, &mut random), random_motion(&scene, &mut random))).collect();
        let mut hits = vec![Answer::Known(None); ways.len()];
        sweep_batch(&store, &ways, &mut hits);
        let shapes: Vec<_> = ways.iter().map(|way| way.0).collect();
        let (mut gaps, mut out) = (vec![Answer::Known(None); ways.len()], vec![Answer::Known(None); ways.len()]);
        clearance_batch(&store, &shapes, 1.0, &mut gaps);
        depenetrate_batch(&store, &shapes, 1.0, &mut out);
        for (n, (shape, motion)) in ways.iter().enumerate() {
            assert_eq!(hits[n], sweep(&store, shape, *motion));
            assert_eq!(gaps[n], clearance(&store, shape, 1.0));
            assert_eq!(out[n], depenetrate(&store, shape, 1.0));
        }
        // An answer left as it was would be none.
        stopped += hits.iter().filter(|hit| matches!(hit, Answer::Known(Some(_)))).count();
        near += gaps.iter().filter(|gap| matches!(gap, Answer::Known(Some(_)))).count();
        inside += out.iter().filter(|out| matches!(out, Answer::Known(Some(out)) if out.norm() > 0.0)).count();
    }
    assert!(stopped > 50 && near > 50 && inside > 10, "{stopped} stopped, {near} near, {inside} inside");
}

/// The rest of the way may be shorter there than the spacing of numbers near the way gone.
#[test]
fn a_long_push_to_the_origin_ends() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let page = |top: u32| {
        let mut builder = PageBuilder::default();
        assert!(builder.set_column(0, 0, &[Span::new(0, top, true).unwrap()]));
        builder.build()
    };
    let key = |layer| PageKey { tx: 0, ty: 0, layer };
    for (low, height, top) in [(-1.2036273971743077, 0.001, 1), (-1.2025090831431826, 0.0005, 2)] {
        let pages = [(key(-1), page(PAGE_QUANTA as u32)), (key(0), page(top))];
        let store = Snapshot::from_pages(frame, pages);
        let shape = Aabb::new([0.02, 0.02, low].into(), [0.03, 0.03, low + height].into()).unwrap();
        let out = depenetrate(&store, &shape, 2.0).known().flatten().unwrap() * (1.0 + 1e-12);
        let moved = Aabb::new(shape.min() + out, shape.max() + out).unwrap();
        assert_eq!(overlaps(&store, &moved), Overlap::Clear, "{out:?}");
    }
}

#[test]
fn distances_that_are_none_find_nothing() {
    let frame = Frame::new(0.1, 0.3).unwrap();
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(5, 5, &[Span::new(100, 140, false).unwrap()]));
    let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
    let bottom = 100.0 * frame.quantum_m();
    let shape = Aabb::standing(Point3::new(0.55, 0.55, bottom), Vector3::new(0.3, 0.3, 0.3)).unwrap();
    assert_eq!(clearance(&store, &shape, 0.0), Answer::Known(Some(0.0)));
    assert!(matches!(depenetrate(&store, &shape, 1.0), Answer::Known(Some(_))));
    for none in [f64::NAN, -1.0, -f64::MIN_POSITIVE] {
        assert_eq!(clearance(&store, &shape, none), Answer::Known(None), "{none}");
        assert_eq!(depenetrate(&store, &shape, none), Answer::Known(None), "{none}");
    }
    let infinite = f64::INFINITY;
    assert!(matches!(ceiling_above(&store, &shape, 0.0, infinite), Answer::Known(Some(_))));
    assert!(matches!(floor_under(&store, &shape, 20.0, infinite), Answer::Known(Some(_))));
    for [from, reach] in [[f64::NAN, infinite], [f64::NAN, 1.0], [0.0, f64::NAN], [-infinite, f64::NAN]] {
        assert_eq!(ceiling_above(&store, &shape, from, reach), Answer::Known(None), "{from} {reach}");
        assert_eq!(floor_under(&store, &shape, -from, reach), Answer::Known(None), "{from} {reach}");
    }
}
