//! The quick search against the exact one: bit-identical answers, and rarely undecided.

use super::line::Line;
use super::*;
use crate::frame::{Frame, PageKey};
use crate::page::{PageBuilder, Span};
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
