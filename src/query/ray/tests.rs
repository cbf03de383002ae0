//! The quick search against the exact one: bit-identical answers, and rarely undecided.

use super::line::Line;
use super::*;
use crate::frame::{Frame, PageKey};
use crate::page::{Page, PageBuilder, Span};
use crate::query::Answer;
use crate::random::Random;
use crate::store::Snapshot;

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
    // A pillar from x = 42 m on, and the pixel of the level that covers it.
    let set = Snapshot::from_pages(frame, [(key(1, 0), row(&[20], 255))]).keep_loaded(|_| false);
    let level = Snapshot::from_pages(frame.coarser(1).unwrap(), [(key(0, 0), row(&[21], 64))]);
    let ray = Ray::new(Point3::new(1.0, 0.25, 1.0), Vector3::x(), 100.0).unwrap();
    let Answer::Known(RayBound::AtLeast(bound)) = cast_far(&set, &level, &ray) else { panic!("the level is loaded") };
    assert!((40.99..=41.0).contains(&bound), "{bound}");
    let Answer::NotLoaded(missing) = cast_far(&set, &level.keep_loaded(|_| false), &ray) else {
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
