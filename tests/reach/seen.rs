//! Standing places, routes and what blocks them within seen space.

use super::flat::{T, room};
use super::oracle::{random_world, store};
use super::plans::{at, finish, thin};
use super::{everywhere, grown, known};
use crate::common::random::Random;
use nalgebra::Point3;
use slicewalk::NoMonitor;
use slicewalk::frame::{Frame, PageKey};
use slicewalk::reach::{
    Flood, ObstructionSearch, Pawn, Place, Planner, Reason, Refusal, Route, Sought, StandingPlaces,
};
use slicewalk::seen::{SeenBlock, SeenPage, SeenSpace};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::sync::Arc;

/// Seen space in pages of layer 0; `run` returns the first and the last slice that were seen at a cell along x and y.
fn space(frame: Frame, tiles: i32, run: impl Fn([i64; 2]) -> Option<[usize; 2]>) -> SeenSpace {
    let mut blocks = Vec::new();
    for (tx, ty) in (0..tiles).flat_map(|tx| (0..tiles).map(move |ty| (tx, ty))) {
        let mut page = SeenPage::NOTHING;
        for (x, y) in (0..16).flat_map(|x| (0..16).map(move |y| (x, y))) {
            if let Some(run) = run([i64::from(tx) * 16 + x, i64::from(ty) * 16 + y]) {
                page.mark([[x as usize; 2], [y as usize; 2], run]);
            }
        }
        let (key, at) = SeenBlock::place_of(PageKey { tx, ty, layer: 0 });
        let mut block = SeenBlock::new(key);
        block.push(at, &page);
        blocks.push(block);
    }
    blocks.sort_by_key(|block| block.key.column());
    let mut seen = SeenSpace::new(frame);
    for block in blocks {
        assert!(seen.push(block));
    }
    seen
}

fn places_within(set: &Snapshot, pawn: Pawn, seen: SeenSpace) -> Vec<Place> {
    let mut standing = StandingPlaces::new(set, pawn).unwrap().within_seen(Some(Arc::new(seen)));
    let flood = known(Flood::everywhere(&mut standing, set).unwrap());
    grown(&mut standing, set, flood).places().collect()
}

#[test]
fn a_pawn_stands_where_its_middle_was_seen() {
    let mut random = Random(11);
    let (mut kept, mut left) = (0, 0);
    for seed in 0..6 {
        let store = store(&random_world(seed));
        let frame = *store.frame();
        // Columns of cells that are seen from one slice to another, some all of them, some not at all.
        let columns: Vec<[usize; 2]> = (0..32 * 32)
            .map(|_| {
                let ends = [random.below(40), random.below(40)];
                [[0, 63], [ends[0], ends[0] + ends[1] / 2], [0, ends[0]]][random.below(3) as usize]
            })
            .collect();
        let run = |[x, y]: [i64; 2]| columns[(y * 32 + x) as usize];
        for (climb, height) in [(0.35, 1.25), (1.0, 1.25), (0.1, 0.5), (0.35, 2.8)] {
            let pawn = Pawn { climb, ..Pawn::new(Body::Box { x: 0.3, y: 0.3, height }) };
            let is_seen = |place: &Place| {
                let feet = place.feet;
                let slice = |above: f64| frame.slice_of(feet.z + above);
                let low = slice(climb).max(slice(0.0) + 3).min(slice(height));
                let [first, last] = run([feet.x, feet.y].map(|at| frame.pixel_of(at).div_euclid(4)));
                (low..=slice(height)).all(|slice| (first as i64..=last as i64).contains(&slice))
            };
            let (_, region) = everywhere(&store, pawn);
            // Pages are stored for these tiles alone.
            let (expected, refused): (Vec<Place>, Vec<Place>) = region.places().partition(|place| {
                let within = [place.feet.x, place.feet.y].map(|at| (0..128).contains(&frame.pixel_of(at)));
                within == [true; 2] && is_seen(place)
            });
            // The clearance of a place depends on those around it.
            let feet = |place: &Place| place.feet;
            let found = places_within(&store, pawn, space(frame, 2, |at| Some(run(at))));
            assert!(
                found.iter().map(feet).eq(expected.iter().map(feet)),
                "seed {seed}, {climb} m, {height} m: {} and {}",
                found.len(),
                expected.len()
            );
            kept += expected.len();
            left += refused.len();
        }
    }
    assert!(kept > 1000 && left > 1000, "{kept} {left}");
}

/// A room of 60 × 40 pixels in which the columns of cells `strip` along x were seen only from row `open` on.
fn half_seen(strip: i64, open: i64) -> (Snapshot, Option<Arc<SeenSpace>>) {
    let store = room(60, 40, |_, _| None);
    let is_seen = |[x, y]: [i64; 2]| x != strip || y >= open;
    let seen = space(*store.frame(), 1, |at| is_seen(at).then_some([0, 63]));
    (store, Some(Arc::new(seen)))
}

#[test]
fn a_route_keeps_to_seen_space() {
    let plan = |(store, seen): (Snapshot, Option<Arc<SeenSpace>>)| -> Result<Route, Refusal> {
        let mut planner = Planner::new(&store, thin(), at(4, 4), at(55, 4)).unwrap().within_seen(seen);
        finish(&mut planner, &store, usize::MAX).0
    };
    let straight = plan((half_seen(7, 8).0, None)).unwrap();
    assert!((straight.length_m - 51.0 * T).abs() < 1e-6, "{}", straight.length_m);
    // The seen part of the strip begins at row 32: its corners are the turns of the shortest way.
    let around = plan(half_seen(7, 8)).unwrap();
    let least = (24.0f64.hypot(28.0) + 3.0 + 24.0f64.hypot(28.0)) * T;
    assert!((least..1.05 * least).contains(&around.length_m), "{} beside {least}", around.length_m);
    let is_unseen = |point: &Point3<f64>| (28..32).contains(&((point.x / T) as i64)) && point.y < 32.0 * T;
    assert!(!around.points.iter().any(is_unseen), "{:?}", around.points);
    assert_eq!(plan(half_seen(7, 10)), Err(Refusal::NotConnected));
    assert_eq!(plan(half_seen(1, 10)), Err(Refusal::NotStandingFrom));
    assert_eq!(plan(half_seen(13, 10)), Err(Refusal::NotStandingTo));
}

#[test]
fn unseen_space_blocks_a_way() {
    let blocked = |(store, seen): (Snapshot, Option<Arc<SeenSpace>>)| {
        let mut search =
            ObstructionSearch::new(&store, thin(), at(4, 4), at(55, 4), &NoMonitor).unwrap().within_seen(seen);
        loop {
            match search.advance(&store).unwrap() {
                Sought::Done(found) => return found,
                Sought::NotLoaded(missing) => panic!("{missing:?}"),
                _ => {}
            }
        }
    };
    assert_eq!(blocked(half_seen(7, 8)), None);
    // The pawn stops in the last seen pixel, and 4 pixels on it is seen again.
    let found = blocked(half_seen(7, 10)).unwrap();
    assert_eq!(found.reason, Reason::Unseen);
    assert!((found.at - at(27, 4)).norm() < 1.5 * T, "{found:?}");
    assert!((found.needs - 0.5).abs() < 1.5 * T, "{found:?}");
    // It is as wide as on the way, and not as where it is narrowest.
    let (store, _) = half_seen(7, 10);
    let is_seen = |[x, y]: [i64; 2]| !(7..if y < 5 { 10 } else { 8 }).contains(&x);
    let seen = space(*store.frame(), 1, |at| is_seen(at).then_some([0, 63]));
    let found = blocked((store, Some(Arc::new(seen)))).unwrap();
    assert!(found.reason == Reason::Unseen && (found.at - at(27, 4)).norm() < 1.5 * T, "{found:?}");
    assert!((found.needs - 1.3).abs() < 1.5 * T, "{found:?}");
}
