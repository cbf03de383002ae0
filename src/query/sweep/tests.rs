//! Pruning changes no answer: each search must agree with the same test applied to every span.

use super::clearance::nearest_of_all;
use super::solid::Moving;
use super::*;
use crate::frame::PAGE_QUANTA;
use crate::page::{Page, PageBuilder, Span};
use crate::query::{Aabb, Cylinder, Sphere};
use crate::random::Random;
use crate::store::Snapshot;
use nalgebra::Point3;
use proptest::prelude::*;
use std::collections::BTreeMap;

const PIXEL_M: f64 = 0.5;
const SLICE_M: f64 = 2.55;

/// Spans of pixels around the corner of four tiles and two layers. Heights are few, so that many are equal.
fn matter() -> impl Strategy<Value = Vec<Matter>> {
    let height = prop::sample::select(vec![-300i64, -256, -255, -60, -1, 0, 1, 20, 21, 254, 255, 256, 400]);
    let span = (-20i64..20, -20i64..20, height, prop::sample::select(vec![0i64, 1, 5, 200]), any::<bool>());
    let matter = span.prop_map(|(i, j, bottom, more, obstacle)| {
        let (pixel, top) = ([i, j], bottom + more);
        Matter { pixel, bottom, top, obstacle }
    });
    prop::collection::vec(matter, 1..300)
}

/// A store of these spans, and those of them that a page can hold.
fn store(matter: &[Matter]) -> (Snapshot, Vec<Matter>) {
    let mut pages: BTreeMap<PageKey, BTreeMap<(u32, u32), Vec<Span>>> = BTreeMap::new();
    let mut kept = Vec::new();
    for &Matter { pixel: [i, j], bottom, top, obstacle } in matter {
        let layer = bottom.div_euclid(PAGE_QUANTA);
        let base = layer * PAGE_QUANTA;
        let key = PageKey { tx: (i >> 6) as i32, ty: (j >> 6) as i32, layer: layer as i32 };
        let column = pages.entry(key).or_default().entry(((i & 63) as u32, (j & 63) as u32)).or_default();
        let top = top.min(base + PAGE_QUANTA);
        let Some(span) = Span::new((bottom - base) as u32, (top - base) as u32, obstacle) else { continue };
        // Spans of a pixel are apart.
        if column.iter().all(|other| span.top() + 1 < other.bottom() || other.top() + 1 < span.bottom()) {
            column.push(span);
            column.sort_unstable_by_key(|span| span.bottom());
            kept.push(Matter { pixel: [i, j], bottom, top, obstacle });
        }
    }
    let build = |columns: &BTreeMap<(u32, u32), Vec<Span>>| -> Page {
        let mut builder = PageBuilder::default();
        for (&(x, y), spans) in columns {
            assert!(builder.set_column(x, y, spans), "{spans:?}");
        }
        builder.build()
    };
    let frame = Frame::new(PIXEL_M, SLICE_M).unwrap();
    (Snapshot::from_pages(frame, pages.iter().map(|(&key, columns)| (key, build(columns)))), kept)
}

fn first_of_all(store: &Snapshot, matter: &[Matter], rest: Resting, motion: Vector3<f64>) -> Option<SweepHit> {
    let moving = Moving::new(store.frame(), rest, motion);
    let mut best = Best::NONE;
    for &matter in matter {
        if let Some(Contact { at, normal }) = moving.contact(&matter.cell(), f64::INFINITY) {
            let found = Best { at, normal, matter };
            if found.before(&best) {
                best = found;
            }
        }
    }
    (best.at < f64::INFINITY).then(|| best.hit(store.frame(), motion, 1.0))
}

fn check<H: Solid>(store: &Snapshot, matter: &[Matter], shape: &H, motion: Vector3<f64>) -> Result<(), TestCaseError> {
    let expected = first_of_all(store, matter, shape.resting(store.frame()), motion);
    let Answer::Known(found) = sweep(store, shape, motion) else { panic!("all pages are in memory") };
    match (expected, found) {
        // Any span that it is in.
        (Some(expected), Some(found)) if expected.begins_inside() => prop_assert!(found.begins_inside()),
        _ => prop_assert_eq!(found, expected),
    }
    for reach in [0.3, 4.0, f64::INFINITY] {
        let expected =
            nearest_of_all(store.frame(), shape.resting(store.frame()), matter.iter().map(Matter::cell), reach);
        prop_assert_eq!(clearance(store, shape, reach), Answer::Known(expected));
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn what_is_passed_over_changes_no_answer(
        matter in matter(),
        place in prop::array::uniform3(-40i32..40),
        size in prop::array::uniform3(prop::sample::select(vec![0.1, 0.25, 1.0, 1.5, 3.0])),
        way in prop::array::uniform3(prop::sample::select(vec![0.0, 0.0, 0.05, -0.05, 0.7, -0.7, -3.0, 9.0, -40.0])),
        off in prop::sample::select(vec![0.0, 0.01, 0.25]),
    ) {
        let (store, matter) = store(&matter);
        let place = Point3::from(place.map(|v| f64::from(v) * 0.25 + off));
        let motion = Vector3::from(way);
        let (radius, height) = (size[0], size[2]);
        check(&store, &matter, &Aabb::standing(place, Vector3::from(size)).unwrap(), motion)?;
        check(&store, &matter, &Cylinder::new(place, radius, height).unwrap(), motion)?;
        check(&store, &matter, &Sphere::new(place, radius).unwrap(), motion)?;
        for motion in [Vector3::new(0.0, 0.0, -3.0), Vector3::new(0.0, 0.0, 1.5), Vector3::zeros()] {
            check(&store, &matter, &Aabb::standing(place, Vector3::from(size)).unwrap(), motion)?;
            check(&store, &matter, &Cylinder::new(place, radius, height).unwrap(), motion)?;
            check(&store, &matter, &Sphere::new(place, radius).unwrap(), motion)?;
        }
    }
}

/// There are fewer tile columns than tiles along and across the ways, so columns are searched instead of tiles.
#[test]
fn spans_on_few_tiles_far_apart_are_found() {
    let mut random = Random(5);
    let mut hits = 0;
    for _ in 0..2000 {
        // First pixel of a tile.
        let tile = |random: &mut Random| 64 * [-700i64, -30, 0, 1, 30, 900][random.below(6)];
        let matter: Vec<Matter> = (0..=random.below(8))
            .map(|_| {
                let pixel = [(); 2].map(|()| tile(&mut random) + random.below(40i64) - 20);
                let bottom = [-300, -60, 0, 255, 400][random.below(5)];
                let top = bottom + [0, 5, 200][random.below(3)];
                Matter { pixel, bottom, top, obstacle: random.chance(50) }
            })
            .collect();
        let (store, matter) = store(&matter);
        let [x, y] = [(); 2].map(|()| (tile(&mut random) + random.below(60i64) - 30) as f64 * PIXEL_M + 0.1);
        let place = Point3::new(x, y, random.between(-5.0, 5.0));
        let size = Vector3::from([(); 3].map(|()| [0.1, 1.5, 60.0, 3000.0][random.below(4)]));
        let way = [0.0, 0.0, 0.7, -900.0, 30_000.0, -30_000.0];
        let motion = Vector3::from([(); 3].map(|()| way[random.below(6)]));
        let cuboid = Aabb::standing(place, size).unwrap();
        check(&store, &matter, &cuboid, motion).unwrap();
        check(&store, &matter, &Cylinder::new(place, size.x, size.z).unwrap(), motion).unwrap();
        check(&store, &matter, &Sphere::new(place, size.x).unwrap(), motion).unwrap();
        hits += usize::from(sweep(&store, &cuboid, motion) != Answer::Known(None));
    }
    assert!(hits > 80, "{hits} hits: the test shows little");
}
