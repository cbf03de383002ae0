//! Leaks and passages of flat worlds with known answers.

use super::flat::{FLOOR, T, room};
use super::{known, reached};
use slicewalk::reach::{Leak, LeakKind, LeakSearch, Pawn, Region};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;

fn pawn() -> Pawn {
    Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 })
}

fn leaks_with(store: &Snapshot, pawn: Pawn) -> (Region, Vec<Leak>) {
    let (mut standing, region) = reached(store, pawn, [0.5, 0.5, FLOOR]);
    let leaks = known(LeakSearch::new(&region).find(&mut standing, store).unwrap());
    (region, leaks)
}

fn leaks(store: &Snapshot) -> Vec<Leak> {
    leaks_with(store, pawn()).1
}

fn is_near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1.01 * T
}

#[test]
fn a_closed_floor_has_no_leak_and_the_area_of_its_middles() {
    let (region, leaks) = leaks_with(&room(90, 70, |_, _| None), pawn());
    assert_eq!(leaks, []);
    // Places stay two pixels away from the walls.
    assert!((region.area_m2() - 84.0 * 64.0 * T * T).abs() < 1e-9, "{}", region.area_m2());
    assert_eq!(region.passages(), []);
    let widest = region.places().map(|place| place.clearance).fold(0.0, f64::max);
    assert!(is_near(widest, 3.4), "{widest}");
}

#[test]
fn every_hole_is_listed_once_where_it_is() {
    let holes = [(10, 10, 6, 6), (30, 12, 14, 8), (55, 40, 9, 9), (20, 45, 20, 10)];
    let inside =
        |i: usize, j: usize| holes.iter().any(|&(x, y, w, h)| (x..x + w).contains(&i) && (y..y + h).contains(&j));
    for (below, drop) in [(b' ', None), (b'-', Some(1.0))] {
        let store = room(90, 70, |i, j| inside(i, j).then_some(below));
        let found = leaks(&store);
        assert_eq!(found.len(), holes.len(), "{found:?}");
        for (x, y, w, h) in holes {
            let middle = |from: usize, size: usize| (from as f64 + size as f64 / 2.0) * T;
            let leak = found.iter().find(|leak| is_near(leak.at.x, middle(x, w)) && is_near(leak.at.y, middle(y, h)));
            let leak = leak.unwrap_or_else(|| panic!("no leak at {x}, {y}: {found:?}"));
            assert_eq!(leak.kind, LeakKind::Hole);
            assert!(is_near(leak.width, w.max(h) as f64 * T), "{leak:?}");
            assert!((leak.at.z - FLOOR).abs() < 0.01);
            assert_eq!(leak.drop.is_some(), drop.is_some());
            assert!(drop.is_none_or(|drop| (leak.drop.unwrap() - drop).abs() < 0.01), "{leak:?}");
        }
    }
    // The ground that it drops to is not a leak.
    let deep = room(90, 70, |i, j| inside(i, j).then_some(b'-'));
    assert_eq!(leaks_with(&deep, Pawn { max_drop: 1.2, ..pawn() }).1, []);
}

#[test]
fn a_gap_narrower_than_half_of_the_pawn_is_none() {
    assert_eq!(leaks(&room(60, 60, |i, j| ((30..32).contains(&i) && (20..40).contains(&j)).then_some(b' '))), []);
}

#[test]
fn a_door_to_where_nothing_was_scanned_is_an_edge_of_its_width() {
    let store = room(60, 50, |i, j| (i == 59 && (20..29).contains(&j)).then_some(b'.'));
    let found = leaks(&store);
    assert_eq!(found.len(), 1, "{found:?}");
    let leak = found[0];
    assert_eq!((leak.kind, leak.drop), (LeakKind::Edge, None));
    assert!(is_near(leak.width, 0.9) && is_near(leak.at.y, 2.45) && is_near(leak.at.x, 5.95), "{leak:?}");
    // A gap narrower than the pawn is not an exit.
    assert_eq!(leaks(&room(60, 50, |i, j| (i == 59 && (20..24).contains(&j)).then_some(b'.'))), []);
}

#[test]
fn a_stage_ends_at_a_ledge() {
    let store = room(80, 40, |i, j| ((50..79).contains(&i) && (1..39).contains(&j)).then_some(b'-'));
    let found = leaks(&store);
    assert_eq!(found.len(), 1, "{found:?}");
    let leak = found[0];
    assert_eq!(leak.kind, LeakKind::Ledge);
    assert!(
        is_near(leak.width, 3.8) && is_near(leak.at.x, 4.95) && (leak.drop.unwrap() - 1.0).abs() < 0.01,
        "{leak:?}"
    );
    let (region, leaks) = leaks_with(&store, Pawn { max_drop: 1.5, ..pawn() });
    assert_eq!(leaks, []);
    assert!(region.places().any(|place| place.feet.z < FLOOR - 0.9));
}

#[test]
fn doors_are_passages_of_their_width_and_connect_what_fits() {
    for door in 3..14usize {
        let store = room(80, 60, |i, j| (i == 40 && !(30..30 + door).contains(&j)).then_some(b'#'));
        let (region, leaks) = leaks_with(&store, pawn());
        assert_eq!(leaks, []);
        let connects = region.places().any(|place| place.feet.x > 5.0);
        // The middle of the pawn stands on middles of pixels, so it needs 5 of them here.
        assert_eq!(connects, door >= 5, "a door of {door} pixels");
        let passages = region.passages();
        assert_eq!(passages.len(), usize::from(connects), "{passages:?}");
        if let Some(passage) = passages.first() {
            assert!(is_near(passage.width, door as f64 * T), "{door}: {passage:?}");
            assert!(
                is_near(passage.at.x, 4.05) && is_near(passage.at.y, (30.0 + door as f64 / 2.0) * T),
                "{passage:?}"
            );
            // The rooms are 4 and 3.9 m wide.
            let [one, other] = passage.rooms;
            assert!(one.x.min(other.x) < 3.5 && one.x.max(other.x) > 4.6, "{passage:?}");
        }
    }
    // Two doors between the same rooms are two passages.
    let is_door = |j: usize| (10..18).contains(&j) || (40..50).contains(&j);
    let store = room(80, 60, |i, j| (i == 40 && !is_door(j)).then_some(b'#'));
    let widths: Vec<f64> = leaks_with(&store, pawn()).0.passages().iter().map(|passage| passage.width).collect();
    assert!(widths.len() == 2 && is_near(widths[0], 0.8) && is_near(widths[1], 1.0), "{widths:?}");
}
