//! The nearest place of the surface, compared with brute force over the spans, from outside and from inside.

use crate::scene;

use nalgebra::{Point3, Vector3};
use scene::{Matter, Random, Scene};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::*;
use slicewalk::store::Snapshot;
use std::collections::BTreeMap;

/// Rounding errors at 10⁷ m, of the library and of the tests (m).
const SLACK: f64 = 1e-7;

/// Spans of each pixel that touch, joined.
fn joined(scene: &Scene) -> BTreeMap<(i64, i64), Vec<(f64, f64)>> {
    let quantum = scene.frame.quantum_m();
    let join = |spans: &Vec<Matter>| {
        let mut runs: Vec<(i64, i64)> = Vec::new();
        for &(bottom, top, _) in spans {
            match runs.last_mut() {
                Some(last) if last.1 >= bottom => last.1 = last.1.max(top),
                _ => runs.push((bottom, top)),
            }
        }
        runs.into_iter().map(|(bottom, top)| (bottom as f64 * quantum, top as f64 * quantum)).collect()
    };
    scene.columns.iter().map(|(pixel, spans)| (*pixel, join(spans))).collect()
}

/// Signed distance to the surface of solid space, by looking at every span, and inside at every pixel up to `max` away.
fn signed(runs: &BTreeMap<(i64, i64), Vec<(f64, f64)>>, scene: &Scene, at: Point3<f64>, max: f64) -> f64 {
    let t = scene.frame.pixel_m();
    let flat = |(i, j): (i64, i64)| {
        let apart = |at: f64, first: i64| (first as f64 * t - at).max(at - (first + 1) as f64 * t).max(0.0);
        apart(at.x, i).hypot(apart(at.y, j))
    };
    let spans = runs.iter().flat_map(|(pixel, runs)| runs.iter().map(move |run| (*pixel, *run)));
    let outside = spans
        .map(|(pixel, (bottom, top))| flat(pixel).hypot((bottom - at.z).max(at.z - top).max(0.0)))
        .fold(f64::INFINITY, f64::min);
    if outside > 0.0 {
        return outside;
    }
    let (i, j, reach) = ((at.x / t).floor() as i64, (at.y / t).floor() as i64, (max / t) as i64 + 2);
    let mut inside = f64::INFINITY;
    for pixel in (i - reach..=i + reach).flat_map(|i| (j - reach..=j + reach).map(move |j| (i, j))) {
        let run = runs.get(&pixel).and_then(|runs| runs.iter().find(|(low, high)| *low <= at.z && at.z <= *high));
        let up = run.map_or(0.0, |(low, high)| (at.z - low).min(high - at.z));
        inside = inside.min(flat(pixel).hypot(up));
    }
    -inside
}

/// A place near a span or inside one, now and then on an edge of the grid.
fn place(scene: &Scene, random: &mut Random) -> Point3<f64> {
    let (frame, mut at) = (&scene.frame, scene.random_point(random));
    if random.chance(60) {
        let number = random.below(scene.columns.len());
        let (&(i, j), spans) = scene.columns.iter().nth(number).unwrap();
        let (bottom, top, _) = spans[random.below(spans.len())];
        let share = |random: &mut Random| [0.0, 0.5, random.between(0.0, 1.0)][random.below(3)];
        at = Point3::new(
            (i as f64 + share(random)) * frame.pixel_m(),
            (j as f64 + share(random)) * frame.pixel_m(),
            (bottom as f64 + (top - bottom) as f64 * share(random)) * frame.quantum_m(),
        );
    }
    at
}

#[test]
fn the_nearest_surface_is_that_of_brute_force() {
    let (mut outside, mut inside, mut none) = (0, 0, 0);
    for (scene, mut random) in Scene::all().step_by(2) {
        let (store, runs) = (scene.store(), joined(&scene));
        for _ in 0..40 {
            let at = place(&scene, &mut random);
            let max = scene.frame.pixel_m() * [0.4, 5.0, 40.0][random.below(3)];
            let expected = signed(&runs, &scene, at, max);
            let Answer::Known(found) = nearest_surface(&store, at, max) else { panic!("all pages are in memory") };
            let Some(SurfacePoint { distance, point, gradient, .. }) = found else {
                assert!(expected.abs() > max - SLACK, "{at:?}: none within {max}, {expected}");
                none += 1;
                continue;
            };
            // A place on a face is inside by a rounding error, or outside by one.
            assert!((distance - expected).abs() < SLACK, "{at:?}: {distance}, {expected}");
            assert!(distance.abs() <= max + SLACK);
            assert!(((point - at).norm() - distance.abs()).abs() < SLACK, "{point:?}");
            assert!(signed(&runs, &scene, point, max).abs() < SLACK, "{point:?} lies on the surface");
            if distance.abs() > 1e-3 {
                assert!((gradient.norm() - 1.0).abs() < 1e-9);
                assert!((at - gradient * distance - point).norm() < SLACK, "{at:?} {gradient:?} {point:?}");
                *if distance > 0.0 { &mut outside } else { &mut inside } += 1;
            }
        }
    }
    assert!(outside > 100 && inside > 40 && none > 50, "{outside} {inside} {none}");
}

#[test]
fn thick_solid_is_left_by_the_shortest_way_in_any_direction() {
    // A block of 20 × 30 pixels and 2 m beside a notch, across the border of two pages.
    let frame = Frame::new(0.1, 0.3).unwrap();
    let mut builder = PageBuilder::default();
    let span = |low: u32, high: u32| Span::new(low, high, true).unwrap();
    for (x, y) in (0..20).flat_map(|x| (0..30).map(move |y| (x, y))) {
        let spans = if (8..10).contains(&x) && y == 15 {
            vec![span(850, 1300), span(1500, 2550)]
        } else {
            vec![span(850, 2550)]
        };
        assert!(builder.set_column(x, y, &spans));
    }
    let page = builder.build();
    let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, page)]);
    let from = |x: f64, y: f64, z: f64| {
        let found = nearest_surface(&store, Point3::new(x, y, z), 5.0).known().flatten().unwrap();
        (found.distance, found.point, found.gradient)
    };
    // A quantum is 0.3 / 255 m: solid from 1 to 3 m, the notch from 1.529 to 1.765 m.
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    let (distance, point, gradient) = from(0.3, 1.0, 2.0);
    assert!(near(distance, -0.3) && near(point.x, 0.0) && near(gradient.x, -1.0) && point.y == 1.0);
    let (distance, point, gradient) = from(1.0, 2.5, 2.8);
    assert!(near(distance, -0.2) && near(point.z, 3.0) && near(gradient.z, 1.0));
    let (distance, _, gradient) = from(0.9, 1.35, 1.65);
    assert!(near(distance, -0.15) && near(gradient.y, 1.0), "{distance} {gradient:?}");
    let (distance, point, _) = from(0.9, 1.55, 1.0 + 1.0 / 3.0);
    assert!(near(distance, 4.0 / 3.0 - 1300.0 * 0.3 / 255.0) && near(point.z, 1300.0 * 0.3 / 255.0), "{distance}");
    let (distance, point, gradient) = from(2.3, 3.4, 3.0);
    assert!(near(distance, 0.5) && near(point.x, 2.0) && near(point.y, 3.0));
    assert!((gradient - Vector3::new(0.6, 0.8, 0.0)).norm() < 1e-9);
    let on_it = from(0.0, 1.0, 2.0);
    assert!(on_it.0 == 0.0 && on_it.2 == Vector3::zeros());
    let at_once = nearest_surface(&store, Point3::new(0.0, 1.0, 2.0), 0.0).known().flatten();
    assert!(at_once.is_some_and(|found| found.distance == 0.0), "{at_once:?}");
    let none = |at: Point3<f64>, max: f64| nearest_surface(&store, at, max) == Answer::Known(None);
    assert!(none([1.0, 1.5, 2.4].into(), 0.3) && none([9.0, 9.0, 9.0].into(), 1.0));
    for at in [[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0]] {
        assert!(none(at.into(), 1.0));
    }
    assert!(none([0.3, 1.0, 2.0].into(), f64::NAN) && none([0.3, 1.0, 2.0].into(), -1.0));
}

/// Columns of spans, in pixels of 1/4 m and quanta of 1/1024 m.
fn exact(columns: scene::Columns) -> Snapshot {
    Snapshot::from_pages(Frame::new(0.25, 255.0 / 1024.0).unwrap(), scene::pages_of(&columns))
}

#[test]
fn a_hole_in_any_pixel_around_is_found() {
    let holes = (-2i64..=2).flat_map(|a| (-2i64..=2).map(move |b| (a, b))).filter(|hole| *hole != (0, 0));
    for (a, b) in holes {
        let mut columns = scene::Columns::new();
        columns.extend((-4..=4).flat_map(|i| (-4..=4).map(move |j| ((24 + i, 24 + j), vec![(0, 16_000, true)]))));
        columns.remove(&(24 + a, 24 + b));
        let store = exact(columns);
        // From the middle of a pixel, half the height of the solid: other places outside are further away.
        let at = Point3::new(6.125, 6.125, 8.0);
        let gap = |pixels: i64| pixels.signum() as f64 * (pixels.abs() as f64 - 0.5).max(0.0) * 0.25;
        let way = Vector3::new(gap(a), gap(b), 0.0);
        let found = nearest_surface(&store, at, 5.0).known().flatten().unwrap();
        assert!((found.distance + way.norm()).abs() < 1e-9, "{a} {b}: {found:?}");
        assert!((found.point - (at + way)).norm() < 1e-9, "{a} {b}: {found:?}");
    }
}

/// Three pages over one another, all solid in one wide pixel: at their borders nothing ends.
#[test]
fn solid_that_goes_on_in_another_page_has_no_surface_at_its_border() {
    let frame = Frame::new(100.0, 0.3).unwrap();
    let columns = scene::Columns::from([((0, 0), vec![(-PAGE_QUANTA, 2 * PAGE_QUANTA, true)])]);
    let store = Snapshot::from_pages(frame, scene::pages_of(&columns));
    let quantum = frame.quantum_m();
    for n in (100..8000).step_by(157) {
        let at = Point3::new(50.0, 50.0, f64::from(n) * quantum);
        let height = frame.quanta(at.z);
        // Exactly as far as the borders.
        for max in [height * quantum, (PAGE_QUANTA as f64 - height) * quantum] {
            assert_eq!(nearest_surface(&store, at, max), Answer::Known(None), "{at:?} {max}");
        }
        let found = nearest_surface(&store, at, 40.0).known().flatten().unwrap();
        let expected = (f64::from(n) + PAGE_QUANTA as f64) * quantum;
        assert!((found.distance + expected).abs() < 1e-9, "{at:?}: {found:?}");
    }
}

/// The place lies inside solid at the border to a page that is not in memory, and free space begins on its other side.
#[test]
fn a_missing_page_matters_only_where_it_could_hold_a_nearer_place() {
    let missing = PageKey { tx: -1, ty: 0, layer: 0 };
    let half = |bottom: i64, top: i64| {
        let mut columns = scene::Columns::new();
        columns.extend((20..40).map(|j| ((0, j), vec![(0, 4096, true)])));
        columns.extend((20..40).map(|j| ((-1, j), vec![(bottom, top, true)])));
        exact(columns).keep_loaded(|key| key != missing)
    };
    let from = |store: &Snapshot, pixels: f64| nearest_surface(store, Point3::new(pixels * 0.25, 7.625, 2.0), 1.0);
    let distance = |answer: Answer<Option<SurfacePoint>>| answer.known().flatten().map(|found| found.distance);
    // An eighth of a pixel from one side or the other.
    let beside = half(0, 4096);
    assert_eq!(distance(from(&beside, 0.875)), Some(-0.03125));
    let Answer::NotLoaded(needed) = from(&beside, 0.125) else { panic!("it could be free there") };
    assert_eq!(needed.keys(), [missing]);
    // A page without solid at these heights is free there.
    let elsewhere = half(10_000, 10_100);
    assert_eq!(distance(from(&elsewhere, 0.125)), Some(-0.03125));
}

#[test]
fn batches_give_the_answers_of_single_questions_in_their_order() {
    for (scene, mut random) in Scene::all().step_by(7) {
        let (store, max) = (scene.store(), scene.frame.pixel_m() * 6.0);
        let places: Vec<_> = (0..300).map(|_| place(&scene, &mut random)).collect();
        let mut answers = vec![Answer::Known(None); places.len()];
        nearest_surface_batch(&store, &places, max, &mut answers);
        assert!(places.iter().zip(&answers).all(|(at, answer)| nearest_surface(&store, *at, max) == *answer));
        assert!(answers.iter().any(|answer| *answer != Answer::Known(None)));
    }
}
