//! The quick search against the exact one: bit-identical answers, and rarely undecided.

use super::line::Line;
use super::*;
use crate::frame::{Frame, PageKey};
use crate::page::{Page, PageBuilder, Span};
use crate::query::Answer;
use crate::random::Random;
use crate::store::Snapshot;
use std::collections::BTreeMap;

/// A number from -1 to 1; with `coarse` a multiple of an eighth.
fn unit(random: &mut Random, coarse: bool) -> f64 {
    let steps: u64 = if coarse { 8 } else { 1 << 40 };
    random.below(2 * steps + 1) as f64 / steps as f64 - 1.0
}

/// Pages around the origin, sparse or dense, with ends of spans on and next to slice boundaries.
fn scene(random: &mut Random) -> Snapshot {
    let most = [2, 60, 2000, 6000][random.below(4) as usize];
    let keys = (-2..2).flat_map(|tx| (-2..2).flat_map(move |ty| (-1..1).map(move |layer| PageKey { tx, ty, layer })));
    let pages = keys.filter_map(|key| {
        let mut builder = PageBuilder::default();
        for _ in 0..=random.below(most) {
            let end = |random: &mut Random| random.below(64) * 255 + [0, 1, 2, 100][random.below(4) as usize];
            let (a, b) = (end(random) as u32, end(random) as u32);
            let (px, py) = (random.below(64) as u32, random.below(64) as u32);
            let bottom = a.min(b).max(a.max(b).saturating_sub(random.below(600) as u32));
            if let Some(span) = Span::new(bottom, a.max(b).min(16320), random.below(2) == 0) {
                let _ = builder.set_column(px, py, &[span]);
            }
        }
        (!builder.is_empty()).then(|| (key, builder.build()))
    });
    let pages: Vec<_> = pages.collect();
    Snapshot::from_pages(Frame::new(0.5, 1.5).unwrap(), pages)
}

/// Any ray around the scene, some of them along and through edges of pixels, tiles, pages and slices.
fn ray(random: &mut Random) -> Option<Ray> {
    let coarse = random.below(3) == 0;
    let along = [(); 3].map(|()| [1.0, 1.0, 0.1, 0.0][random.below(4) as usize] * unit(random, coarse));
    let coarse = random.below(3) == 0;
    let from = [64.0, 64.0, 100.0].map(|far| {
        let at = far * unit(random, coarse);
        if random.below(40) == 0 { at * 1e3 } else { at }
    });
    let max = [0.0, 1.0, 20.0, 300.0, f64::INFINITY][random.below(5) as usize];
    Ray::new(from.into(), along.into(), max).ok()
}

/// Compares the searches; returns whether the quick one was certain, and whether the ray hit something.
fn agree(set: &Snapshot, ray: &Ray) -> (bool, bool) {
    let bounds = set.bounds().unwrap();
    let line = Line::new(set.frame(), ray);
    let exact = exact::search(set, line, &bounds);
    let quick = walk::first_hit(set, &line, &bounds);
    let known = quick.is_ok();
    let bits = |hit: RayHit| (hit.distance.to_bits(), hit.normal.map(f64::to_bits), hit.obstacle);
    if let Ok(hit) = quick {
        let Answer::Known(expected) = exact else { panic!("{ray:?}: {hit:?}, expected {exact:?}") };
        assert_eq!(hit.map(bits), expected.map(bits), "{ray:?}: {hit:?}, expected {expected:?}");
    }
    (known, matches!(exact, Answer::Known(Some(_))))
}

#[test]
fn both_searches_agree_to_the_last_bit() {
    let mut random = Random(7);
    let (mut rays, mut known, mut hits) = (0, 0, 0);
    for _ in 0..60 {
        let store = scene(&mut random);
        let part = store.keep_loaded(|_| random.below(4) != 0);
        for _ in 0..3000 {
            let Some(ray) = ray(&mut random) else { continue };
            let (was_known, was_hit) = agree(&store, &ray);
            agree(&part, &ray);
            (rays, known, hits) = (rays + 1, known + u32::from(was_known), hits + u32::from(was_hit));
        }
    }
    assert!(hits > rays / 10 && hits < rays / 10 * 9, "{hits} hits of {rays} rays");
    assert!(known > rays / 2 && known < rays, "{known} known of {rays} rays");
}

#[test]
fn rays_in_general_position_are_no_matter_of_doubt() {
    let mut random = Random(8);
    let store = scene(&mut random);
    let doubtful = (0..5000).filter(|_| {
        let [from, along] = [(); 2].map(|()| [(); 3].map(|()| unit(&mut random, false)));
        let ray = Ray::new(Point3::from(from) * 50.0, along.into(), 200.0).unwrap();
        !agree(&store, &ray).0
    });
    assert!(doubtful.count() <= 25);
}

/// A page with a span of these heights in some pixels of its first row.
fn row(pixels: &[u32], top: u32) -> Page {
    let mut builder = PageBuilder::default();
    for &px in pixels {
        assert!(builder.set_column(px, 0, &[Span::new(0, top, true).unwrap()]));
    }
    builder.build()
}

/// Rounding decides whether such a ray is in the page at all before it leaves the block or the tile.
#[test]
fn rays_that_reach_a_pages_floor_as_they_leave_a_cell_meet_nothing_before_or_behind() {
    let (frame, mut random) = (Frame::new(0.5, 1.5).unwrap(), Random(9));
    let mut known = 0;
    for layer in [-1, 1] {
        // Low spans before the ends of blocks and of the tile: the ray is below those before, and above those behind.
        let page = row(&[7, 15, 23, 63], 3);
        let set = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer }, page)]);
        let floor = f64::from(layer) * 96.0;
        for _ in 0..5000 {
            let edge = [8.0, 16.0, 24.0, 64.0][random.below(4)];
            let begin = 0.5 * random.between(0.0, edge - 1.0);
            let from = Point3::new(begin, 0.25, floor - random.between(1.0, 50.0));
            // The quick search grows cells by this much.
            let to = Point3::new(0.5 * (edge + walk::SLACK), 0.25, floor - walk::SLACK_Z * frame.quantum_m());
            let ray = Ray::new(from, to - from, f64::INFINITY).unwrap();
            let (was_known, was_hit) = agree(&set, &ray);
            assert!(!was_hit, "{ray:?}");
            known += u32::from(was_known);
        }
    }
    assert!(known > 1000, "{known} known: the test shows little");
}

/// A scene of spans in layer 0: the pixel, the ends and the class of each.
fn scene_of(frame: Frame, spans: &[([i64; 2], [u32; 2], bool)]) -> Snapshot {
    let mut pages: BTreeMap<PageKey, PageBuilder> = BTreeMap::new();
    for &([i, j], [bottom, top], obstacle) in spans {
        let key = PageKey { tx: (i >> 6) as i32, ty: (j >> 6) as i32, layer: 0 };
        let span = Span::new(bottom, top, obstacle).unwrap();
        assert!(pages.entry(key).or_default().set_column((i & 63) as u32, (j & 63) as u32, &[span]));
    }
    Snapshot::from_pages(frame, pages.into_iter().map(|(key, builder)| (key, builder.build())))
}

/// Pixels of half a metre and of a millimetre: a tile is far more and far less than one metre. Tiles lie on one side of
/// both axes, and in one region or in several.
#[test]
fn pillars_many_tiles_apart_are_seen_from_one_another_in_any_direction() {
    for case in 0..32u32 {
        let is = |bit: u32| case >> bit & 1 == 1;
        let pixel_m = if is(0) { 0.5 } else { 1.0 / 1024.0 };
        let frame = Frame::new(pixel_m, 1.5).unwrap();
        // The pillars' centres (pixels) lie so many steps of (4, 3) apart, turned and mirrored.
        let last = if is(1) { 2000.0 } else { 500.0 };
        let at = |step: f64| {
            let (a, b) = (4512.5 + 4.0 * step, 4512.5 + 3.0 * step);
            let (a, b) = (if is(2) { -a } else { a }, if is(3) { -b } else { b });
            if is(4) { [b, a] } else { [a, b] }
        };
        let pixel = |step: f64| at(step).map(|v| v.floor() as i64);
        let set = scene_of(frame, &[(pixel(0.0), [0, 255], false), (pixel(last), [0, 255], true)]);
        for (from, to) in [(1.0, last), (last - 1.0, 0.0)] {
            let [[x0, y0], [x1, y1]] = [from, to].map(|step| at(step).map(|v| v * pixel_m));
            let way = Vector3::new(x1 - x0, y1 - y0, 0.0);
            let ray = Ray::new(Point3::new(x0, y0, 0.75), way, f64::INFINITY).unwrap();
            let Answer::Known(Some(hit)) = cast(&set, &ray) else { panic!("case {case}: {ray:?} leads to a pillar") };
            // From centre to centre, less half a pixel along the major axis.
            let expected = (5.0 * (last - 1.0) - 0.625) * pixel_m;
            assert!((hit.distance - expected).abs() < 1e-6, "case {case}: {ray:?}: {hit:?}, expected {expected}");
            assert_eq!(hit.obstacle, to > 0.0, "case {case}: {ray:?}: {hit:?}");
            assert_eq!(agree(&set, &ray), (true, true), "case {case}: {ray:?}");
        }
    }
}

/// The quick search counts pixels in 32 bits.
#[test]
fn pages_beyond_the_reach_of_the_quick_search_are_found() {
    let frame = Frame::new(0.5, 1.5).unwrap();
    // Sides of pixels 2³² + 5 and -2³² + 5.
    for (tx, along, distance) in [(1 << 26, 1.0, 2_147_483_650.25), (-(1 << 26), -1.0, 2_147_483_645.25)] {
        let set = Snapshot::from_pages(frame, [(PageKey { tx, ty: 0, layer: 0 }, row(&[5], 255))]);
        let ray = Ray::new(Point3::new(0.25, 0.25, 0.75), Vector3::new(along, 0.0, 0.0), f64::INFINITY).unwrap();
        let Answer::Known(Some(hit)) = cast(&set, &ray) else { panic!("{ray:?} leads to a pillar") };
        assert!((hit.distance - distance).abs() < 1e-4, "{ray:?}: {hit:?}");
        assert_eq!(hit.normal, Vector3::new(-along, 0.0, 0.0));
    }
}

/// Heights differ by less than the quick search grows spans.
#[test]
fn rays_a_hair_below_or_above_a_span_miss_it() {
    let frame = Frame::new(0.5, 1.5).unwrap();
    let set = scene_of(frame, &[([3, 0], [255, 510], true)]);
    for (quanta, hits) in [(254.9999, false), (255.0001, true), (509.9999, true), (510.0001, false)] {
        let from = Point3::new(0.25, 0.25, quanta / 170.0);
        let ray = Ray::new(from, Vector3::x(), f64::INFINITY).unwrap();
        let Answer::Known(hit) = cast(&set, &ray) else { panic!("all pages are in memory") };
        assert_eq!(hit.is_some(), hits, "at {quanta} quanta: {hit:?}");
        assert!(hit.is_none_or(|hit| (hit.distance - 1.25).abs() < 1e-9), "at {quanta} quanta: {hit:?}");
    }
}

/// The quick search's mask holds both pixels, the first of them for its margin alone.
#[test]
fn a_ray_of_limited_length_close_to_an_edge_passes_the_solid_beside_it() {
    let set = scene_of(Frame::new(0.5, 1.5).unwrap(), &[([2, 0], [0, 255], true), ([3, 5], [0, 255], true)]);
    let ray = Ray::new(Point3::new(1.50005, -1.0, 0.75), Vector3::y(), 20.0).unwrap();
    let Answer::Known(Some(hit)) = cast(&set, &ray) else { panic!("{ray:?} leads to the second pixel") };
    assert!((hit.distance - 3.5).abs() < 1e-9, "{hit:?}");
    assert_eq!(hit.normal, -Vector3::y());
    assert_eq!(agree(&set, &ray), (true, true));
}

#[test]
fn along_an_edge_an_obstacle_precedes_other_solid_at_the_same_distance() {
    let frame = Frame::new(0.5, 1.5).unwrap();
    // Edges inside a block, of a block and of a tile.
    for (edge, first) in [3i64, 8, 64].into_iter().flat_map(|edge| [(edge, false), (edge, true)]) {
        let set = scene_of(frame, &[([edge - 1, 4], [0, 255], first), ([edge, 4], [0, 255], !first)]);
        let ray = Ray::new(Point3::new(edge as f64 * 0.5, 0.25, 0.75), Vector3::y(), 10.0).unwrap();
        let Answer::Known(Some(hit)) = cast(&set, &ray) else { panic!("{ray:?} passes between two pixels") };
        assert!((hit.distance - 1.75).abs() < 1e-9, "{ray:?}: {hit:?}");
        assert_eq!(hit.normal, -Vector3::y(), "{ray:?}");
        assert!(hit.obstacle, "{ray:?}, the first an obstacle: {first}");
    }
}

#[test]
fn the_first_of_one_pixels_spans_is_the_nearest_and_an_obstacle_if_two_are_met_at_once() {
    // A page that begins at 192 m, which is 32640 quanta of 1/170 m. Two spans meet at 193.5 m.
    let (frame, pixel, layer) = (Frame::new(0.5, 1.5).unwrap(), [10, -3], 2);
    for obstacles in [[false, true], [true, false]] {
        let spans = [Span::new(0, 255, obstacles[0]).unwrap(), Span::new(255, 300, obstacles[1]).unwrap()];
        let check = |from: [f64; 3], along: [f64; 3], distance: f64, normal: Vector3<f64>, obstacle: bool| {
            let ray = Ray::new(from.into(), along.into(), 100.0).unwrap();
            let hit = first_of(&frame, &ray, pixel, layer, &spans).unwrap();
            assert!((hit.distance - distance).abs() < 1e-9, "{ray:?}: {hit:?}");
            assert_eq!((hit.normal, hit.obstacle), (normal, obstacle), "{ray:?}");
            assert_eq!(first_of(&frame, &ray, pixel, layer, &[]), None);
        };
        check([0.0, -1.25, 193.5], [1.0, 0.0, 0.0], 5.0, -Vector3::x(), true);
        check([5.25, -1.25, 200.0], [0.0, 0.0, -1.0], 200.0 - 32940.0 / 170.0, Vector3::z(), obstacles[1]);
        // Through a corner the ray enters along x.
        check([4.0, -2.5, 193.5], [1.0, 1.0, 0.0], 2f64.sqrt(), -Vector3::x(), true);
    }
}

#[test]
fn directions_of_any_length_become_one_of_length_1() {
    let (origin, along) = (Point3::new(1e7, -2.5, 3.0), Vector3::new(0.6, 0.0, -0.8));
    for length in [1e-310, 1e-200, 0.5, 1.0, 1e200, 1e308] {
        let ray = Ray::new(origin, along * length, 7.5).unwrap();
        assert!((ray.direction() - along).norm() < 1e-12, "{length}: {ray:?}");
        assert_eq!((ray.origin(), ray.max()), (origin, 7.5));
    }
}

#[test]
fn a_level_in_memory_bounds_a_ray_beyond_missing_pages() {
    let frame = Frame::new(0.5, 1.5).unwrap();
    let key = |tx, ty| PageKey { tx, ty, layer: 0 };
    // A pillar from x = 42 m on, and the pixel of the level that covers it. The level's pixel at 20 m counts for nothing,
    // because the pages show that the ray is free there.
    let set = Snapshot::from_pages(frame, [(key(1, 0), row(&[20], 255))]).keep_loaded(|_| false);
    let level = Snapshot::from_pages(frame.coarser(1).unwrap(), [(key(0, 0), row(&[10, 21], 64))]);
    let ray = |x: f64| Ray::new(Point3::new(x, 0.25, 1.0), Vector3::x(), 2e9).unwrap();
    // From afar, rounding moves the ray's end by some 10⁻⁷ m, and pages grow by some 10⁻⁶ m.
    for from in [1.0, -1e9] {
        let answer = cast_far(&set, &level, &ray(from));
        let Answer::Known(RayBound::AtLeast(bound)) = answer else { panic!("the level is loaded") };
        assert!((41.99..=42.0).contains(&(from + bound)), "from {from}: {bound}");
    }
    let Answer::NotLoaded(missing) = cast_far(&set, &level.keep_loaded(|_| false), &ray(1.0)) else {
        panic!("neither the page nor the level is loaded")
    };
    assert_eq!(missing.keys(), [key(1, 0)]);
}

/// The ray passes the page's corner so closely that the page counts as missing, and its box is missed by rounding.
#[test]
fn a_level_answers_for_a_page_that_the_ray_only_grazes() {
    let frame = Frame::new(0.5, 1.5).unwrap();
    let key = |tx, ty| PageKey { tx, ty, layer: 0 };
    // The page begins at (32 m, 32 m); its only pixel lies farther along x.
    let whole = Snapshot::from_pages(frame, [(key(1, 1), row(&[30], 255))]);
    let level = Snapshot::from_pages(
        frame.coarser(1).unwrap(),
        [(key(0, 0), {
            let mut builder = PageBuilder::default();
            assert!(builder.set_column(23, 16, &[Span::new(0, 64, true).unwrap()]));
            builder.build()
        })],
    );
    let ray = Ray::new(Point3::new(22.0, 42.0 - 1e-13, 1.0), Vector3::new(1.0, -1.0, 0.0), 100.0).unwrap();
    let set = whole.keep_loaded(|_| false);
    assert!(matches!(cast(&set, &ray), Answer::NotLoaded(_)));
    assert_eq!(cast(&whole, &ray), Answer::Known(None));
    assert_eq!(cast_far(&set, &level, &ray), Answer::Known(RayBound::Exact(None)));
}
