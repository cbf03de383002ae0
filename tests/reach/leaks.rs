//! Leaks and passages of flat worlds with known answers.

use super::flat::{Columns, FLOOR, T, layers, room};
use super::{everywhere, known, reached};
use crate::common::part::Part;
use crate::common::random::Random;
use slicewalk::NoMonitor;
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::query::Answer;
use slicewalk::reach::{Flood, Leak, LeakKind, LeakSearch, Passage, Pawn, Region, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::BTreeMap;

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
fn a_hole_larger_than_a_tile_is_one() {
    // No floor is near the pixels of the tile from 64 to 128.
    let inside = |i: usize| (58..134).contains(&i);
    let found = leaks(&room(192, 192, |i, j| (inside(i) && inside(j)).then_some(b' ')));
    assert_eq!(found.len(), 1, "{found:?}");
    let leak = found[0];
    assert!(leak.kind == LeakKind::Hole && leak.drop.is_none() && is_near(leak.width, 7.6), "{leak:?}");
    assert!(is_near(leak.at.x, 9.6) && is_near(leak.at.y, 9.6), "{leak:?}");
}

#[test]
fn a_hole_over_ground_of_two_depths_is_divided() {
    // Ground 1 m lower below the first 16 pixels, and nothing below the other 24.
    let store = room(90, 70, |i, j| match (i, j) {
        (20..36, 25..35) => Some(b'-'),
        (36..60, 25..35) => Some(b' '),
        _ => None,
    });
    let mut found = leaks(&store);
    found.sort_by(|a, b| a.at.x.total_cmp(&b.at.x));
    assert_eq!(found.len(), 2, "{found:?}");
    // The feet have support a pixel to each side of their middle.
    for (leak, (x, width)) in found.iter().zip([(2.8, 1.6), (4.8, 2.4)]) {
        assert_eq!(leak.kind, LeakKind::Hole, "{found:?}");
        assert!((leak.at.x - x).abs() < 2.5 * T && (leak.width - width).abs() < 2.5 * T, "{found:?}");
        assert!(is_near(leak.at.y, 3.0) && (leak.at.z - FLOOR).abs() < 0.01, "{found:?}");
    }
    assert!(found[0].drop.is_some_and(|drop| (drop - 1.0).abs() < 0.01) && found[1].drop.is_none(), "{found:?}");
}

/// A floor with a hole of 42 × 14 pixels, below which the ground lies as deep (m) as `depth` says.
fn hole_over(depth: impl Fn(usize, usize) -> f64) -> Snapshot {
    let quanta = |metres: f64| ((FLOOR + metres) / 0.3 * SLICE_QUANTA as f64).round() as i64;
    let mut columns = Columns::new();
    for (i, j) in (0..80).flat_map(|i| (0..60).map(move |j| (i, j))) {
        let is_wall = [0, 79].contains(&i) || [0, 59].contains(&j);
        let top = if (20..62).contains(&i) && (20..34).contains(&j) { -depth(i, j) } else { 0.0 };
        let high = quanta(if is_wall { 5.0 } else { top });
        columns.insert((i as i64, j as i64), vec![(quanta(top) - 3, high, is_wall)]);
    }
    layers(Frame::new(T, 0.3).unwrap(), &columns)
}

#[test]
fn stretches_of_a_rim_are_one_hole_if_their_depths_are_within_the_climb_height() {
    // Around 3 m in the middle, 1 m on the left and another depth on the right. The pawn climbs 0.35 m.
    for (right, expected) in [(1.0, 2), (1.3, 2), (0.7, 2), (1.4, 3), (0.6, 3)] {
        let found = leaks(&hole_over(|i, _| {
            if i < 34 {
                1.0
            } else if i < 48 {
                3.0
            } else {
                right
            }
        }));
        assert_eq!(found.len(), expected, "{right}: {found:?}");
        // Both sides together are as wide as the hole. The feet have support a pixel to each side of their middle.
        let widest = found.iter().map(|leak| leak.width).fold(0.0, f64::max);
        assert!((widest - if expected == 2 { 4.2 } else { 1.4 }).abs() < 2.5 * T, "{right}: {found:?}");
    }
}

#[test]
fn a_hole_reaches_as_far_as_ground_within_the_climb_height_of_its_rim() {
    // 1 m below the left half, 2 m below the right one, and in each strips that belong to the other half or to neither.
    let store = hole_over(|i, j| match (i < 41, j) {
        (false, 25..27) if i < 52 => 1.3,
        (false, 29..30) if i < 58 => 1.4,
        (false, _) => 2.0,
        (true, 28..32) if i >= 30 => 1.7,
        (true, 22..25) if i >= 24 => 1.6,
        _ => 1.0,
    });
    let mut found = leaks(&store);
    found.sort_by(|a, b| a.drop.unwrap().total_cmp(&b.drop.unwrap()));
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found.iter().all(|leak| (leak.width - 3.2).abs() < 2.5 * T), "{found:?}");
}

#[test]
fn holes_above_one_another_are_as_many_if_their_floors_are_a_storey_apart() {
    let quanta = |metres: f64| (metres / 0.3 * SLICE_QUANTA as f64).round() as i64;
    let floor = |z: f64| (quanta(FLOOR + z) - 3, quanta(FLOOR + z), false);
    let mut columns = Columns::new();
    for (i, j) in (0..60).flat_map(|i| (0..60).map(move |j| (i, j))) {
        let is_wall = [0, 59].contains(&i) || [0, 59].contains(&j);
        let is_hole = (25..35).contains(&i) && (25..35).contains(&j);
        let spans = match (is_wall, is_hole) {
            (true, _) => vec![(quanta(FLOOR) - 3, quanta(FLOOR + 5.0), true)],
            (_, true) => vec![floor(-1.0)],
            _ => vec![floor(0.0), floor(2.8)],
        };
        columns.insert((i, j), spans);
    }
    let store = layers(Frame::new(T, 0.3).unwrap(), &columns);
    let (mut standing, region) = everywhere(&store, pawn());
    let mut found = known(LeakSearch::new(&region).find(&mut standing, &store).unwrap());
    found.sort_by(|a, b| a.at.z.total_cmp(&b.at.z));
    assert_eq!(found.len(), 2, "{found:?}");
    for (leak, (z, drop)) in found.iter().zip([(0.0, 1.0), (2.8, 3.8)]) {
        assert!(leak.kind == LeakKind::Hole && is_near(leak.width, 1.0), "{found:?}");
        assert!((leak.at.z - FLOOR - z).abs() < 0.01, "{found:?}");
        assert!(leak.drop.is_some_and(|own| (own - drop).abs() < 0.01), "{found:?}");
    }
}

#[test]
fn a_search_for_leaks_waits_for_the_pages_behind_a_rim() {
    // Lower ground or nothing over three tiles, whose pages what is reached does not need.
    for below in [b'-', b' '] {
        let store = room(300, 40, |i, j| ((50..299).contains(&i) && (1..39).contains(&j)).then_some(below));
        let expected = leaks(&store);
        assert_eq!(expected.len(), 1, "{expected:?}");
        let mut part = Part::new(store);
        let mut standing = StandingPlaces::new(&part, pawn()).unwrap();
        let start = loop {
            match standing.spot(&part, [0.5, 0.5, FLOOR].into()).unwrap() {
                Answer::Known(start) => break start.unwrap(),
                Answer::NotLoaded(missing) => assert!(part.load(missing.keys()) > 0),
            }
        };
        let mut flood = Flood::from(start);
        while let Answer::NotLoaded(missing) = flood.grow(&mut standing, &part, &NoMonitor).unwrap() {
            assert!(part.load(missing.keys()) > 0);
        }
        let region = flood.region(&standing);
        let (mut search, mut waits) = (LeakSearch::new(&region), 0);
        let found = loop {
            match search.find(&mut standing, &part).unwrap() {
                Answer::Known(found) => break found,
                Answer::NotLoaded(missing) => {
                    waits += 1;
                    assert!(part.load(missing.keys()) > 0);
                }
            }
        };
        assert_eq!(found, expected);
        assert!(waits > 0);
    }
}

#[test]
fn a_gap_narrower_than_half_of_the_pawn_is_none() {
    assert_eq!(leaks(&room(60, 60, |i, j| ((30..32).contains(&i) && (20..40).contains(&j)).then_some(b' '))), []);
}

#[test]
fn a_slit_is_as_wide_as_on_average() {
    // Half of the pawn is 4.5 pixels wide.
    for (width, expected) in [(4, 0), (5, 1)] {
        let store = room(60, 60, |i, j| ((30..30 + width).contains(&i) && (15..45).contains(&j)).then_some(b' '));
        let found = leaks_with(&store, Pawn::new(Body::Box { x: 0.9, y: 0.9, height: 1.8 })).1;
        assert_eq!(found.len(), expected, "{width}: {found:?}");
    }
}

#[test]
fn a_leak_lies_as_high_as_the_middle_of_its_rim() {
    // The floor rises by a centimetre in each pixel along the door.
    let quanta = |metres: f64| ((FLOOR + metres) / 0.3 * SLICE_QUANTA as f64).round() as i64;
    let mut columns = Columns::new();
    for (i, j) in (0..60).flat_map(|i| (0..50).map(move |j| (i, j))) {
        let is_wall = i == 0 || i == 59 || j == 0 || j == 49;
        let own = if is_wall { (quanta(0.0) - 3, quanta(4.0), true) } else { (0, quanta(j as f64 * 0.01), false) };
        if i < 59 || !(20..29).contains(&j) {
            columns.insert((i, j), vec![own]);
        }
    }
    let found = leaks(&layers(Frame::new(T, 0.3).unwrap(), &columns));
    assert!(found.len() == 1 && found[0].kind == LeakKind::Edge, "{found:?}");
    // The feet rest on the highest ground under the body, two pixels on.
    assert!((found[0].at.z - FLOOR - 0.26).abs() < 0.015, "{found:?}");
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

/// For each pixel of the walls the first pixel of its wall, and the wall's extent along x or y, whichever is more (pixels).
fn extents(side: usize, is_wall: &dyn Fn(usize, usize) -> bool) -> BTreeMap<[usize; 2], ([usize; 2], usize)> {
    let mut extents = BTreeMap::new();
    for first in (0..side * side).map(|at| [at % side, at / side]).filter(|[i, j]| is_wall(*i, *j)) {
        if extents.contains_key(&first) {
            continue;
        }
        let mut wall = vec![first];
        extents.insert(first, (first, 0));
        let mut next = 0;
        while let Some(&[i, j]) = wall.get(next) {
            next += 1;
            for to in [[i + 1, j], [i.wrapping_sub(1), j], [i, j + 1], [i, j.wrapping_sub(1)]] {
                if to[0] < side && to[1] < side && is_wall(to[0], to[1]) && !extents.contains_key(&to) {
                    extents.insert(to, (first, 0));
                    wall.push(to);
                }
            }
        }
        let along = |axis: usize| {
            let all = || wall.iter().map(|pixel| pixel[axis]);
            all().max().unwrap_or(0) - all().min().unwrap_or(0) + 1
        };
        let extent = along(0).max(along(1));
        extents.extend(wall.iter().map(|pixel| (*pixel, (first, extent))));
    }
    extents
}

#[test]
fn the_passages_of_a_floor_plan_are_its_doors() {
    // Three by three rooms of 26 × 26 pixels with walls of one pixel around them.
    const ROOM: usize = 27;
    const SIDE: usize = 3 * ROOM + 1;
    let mut found = 0;
    for seed in 0..12 {
        let (mut random, has_poles) = (Random(seed), seed % 2 == 0);
        // Doors to the right and upwards: first pixel and width along the wall.
        let mut doors = Vec::new();
        for (room, upwards) in (0..9usize).flat_map(|room| [(room, false), (room, true)]) {
            let [column, row] = [room % 3, room / 3];
            if (if upwards { row } else { column }) < 2 && random.below(5) > 0 {
                let width = 2 + random.below(if has_poles { 4 } else { 8 }) as usize;
                let first = 1 + random.below((ROOM - 1 - width) as u32) as usize;
                doors.push(([column, row], upwards, first, width));
            }
        }
        let is_door = |i: usize, j: usize| {
            doors.iter().any(|&([column, row], upwards, first, width)| {
                let (across, along) = if upwards { (j, i) } else { (i, j) };
                let (before, beside) = if upwards { (row, column) } else { (column, row) };
                across == (before + 1) * ROOM && (beside * ROOM + first..beside * ROOM + first + width).contains(&along)
            })
        };
        // A pole in a room makes no passage.
        let poles: Vec<[usize; 2]> =
            (0..9).map(|room| [room % 3, room / 3].map(|room| room * ROOM + 7 + random.below(13) as usize)).collect();
        let store = room(SIDE, SIDE, |i, j| {
            let is_wall = i % ROOM == 0 || j % ROOM == 0;
            (is_wall && !is_door(i, j) || has_poles && poles.contains(&[i, j])).then_some(b'#')
        });
        let (_, region) = everywhere(&store, Pawn::new(Body::Box { x: T, y: T, height: 1.8 }));
        let passages = region.passages();
        assert!(passages.windows(2).all(|pair| pair[0].width <= pair[1].width), "{passages:?}");
        // Between posts that are short beside a door's width, ground is open.
        let extents = extents(SIDE, &|i, j| (i % ROOM == 0 || j % ROOM == 0) && !is_door(i, j));
        doors.retain(|&([column, row], upwards, first, width)| {
            let ends = [first - 1, first + width].map(|along| match upwards {
                true => extents[&[column * ROOM + along, (row + 1) * ROOM]],
                false => extents[&[(column + 1) * ROOM, row * ROOM + along]],
            });
            ends[0] == ends[1] || ends.iter().all(|(_, extent)| *extent > 2 * width)
        });
        assert_eq!(passages.len(), doors.len(), "seed {seed}: {doors:?}, {passages:?}");
        found += doors.len();
        // The place of each room with the most clearance.
        let widest = |[column, row]: [usize; 2]| {
            let is_in = |v: f64, room: usize| (room * ROOM..(room + 1) * ROOM).contains(&((v / T) as usize));
            let places = region.places().filter(|place| is_in(place.feet.x, column) && is_in(place.feet.y, row));
            places.map(|place| place.clearance).fold(0.0, f64::max)
        };
        let clearance = |at: nalgebra::Point3<f64>| region.places().find(|place| place.feet == at).unwrap().clearance;
        for &([column, row], upwards, first, width) in &doors {
            let (across, along) = ((if upwards { row } else { column } + 1) * ROOM, if upwards { column } else { row });
            let middle = [(across as f64 + 0.5) * T, ((along * ROOM + first) as f64 + width as f64 / 2.0) * T];
            let [x, y] = if upwards { [middle[1], middle[0]] } else { middle };
            let at = |passage: &&slicewalk::reach::Passage| is_near(passage.at.x, x) && is_near(passage.at.y, y);
            let passage = passages.iter().find(at).unwrap_or_else(|| {
                panic!(
                    "seed {seed}: no passage at {x}, {y}: {width} {:?} {poles:?}",
                    passages.iter().map(|p| (p.at.x, p.at.y, p.width)).collect::<Vec<_>>()
                )
            });
            assert!(is_near(passage.width, width as f64 * T), "seed {seed}: {width} pixels, {passage:?}");
            let beyond = if upwards { [column, row + 1] } else { [column + 1, row] };
            let mut rooms = [[column, row], beyond].map(widest);
            let mut joined = passage.rooms.map(clearance);
            rooms.sort_by(f64::total_cmp);
            joined.sort_by(f64::total_cmp);
            assert_eq!(joined, rooms, "seed {seed}: {passage:?}");
        }
    }
    assert!(found > 60, "{found} doors");
}

#[test]
fn a_wall_that_stands_free_makes_a_passage_where_it_is_long_beside_the_gap() {
    // Between its end and the outer wall; across the hall beyond its other end it is too short for the width.
    for (gap, length, is_passage) in [(4, 20, true), (4, 7, false), (8, 20, true), (8, 14, false), (12, 8, false)] {
        let store = room(90, 46, |i, j| (i == 45 && (1 + gap..1 + gap + length).contains(&j)).then_some(b'#'));
        let (_, region) = everywhere(&store, Pawn::new(Body::Box { x: T, y: T, height: 1.8 }));
        let narrow: Vec<f64> = region.passages().iter().map(|passage| passage.width).collect();
        let expected: Vec<f64> = if is_passage { vec![gap as f64 * T] } else { Vec::new() };
        assert_eq!(narrow.len(), expected.len(), "{gap}, {length}: {narrow:?}");
        assert!(narrow.iter().zip(&expected).all(|(a, b)| is_near(*a, *b)), "{gap}, {length}: {narrow:?}");
    }
}

/// The passages between places of a pawn as wide as a pixel.
fn passages(store: &Snapshot) -> Vec<Passage> {
    everywhere(store, Pawn::new(Body::Box { x: T, y: T, height: 1.8 })).1.passages()
}

#[test]
fn a_bay_is_a_room_if_it_is_clearly_wider_than_its_mouth() {
    // A quarter wider, and two pixels to each side.
    for (mouth, bay, is_room) in [(10, 14, false), (10, 19, true), (4, 6, false), (4, 11, true)] {
        let (first, end) = (25 - mouth / 2, 25 + mouth / 2);
        let is_mouth = |i: usize, j: usize| i == 40 && (first..end).contains(&j);
        let is_bay =
            |i: usize, j: usize| (41..41 + bay).contains(&i) && (25 - bay / 2..25 + bay.div_ceil(2)).contains(&j);
        let store = room(64, 50, |i, j| (i >= 40 && !is_mouth(i, j) && !is_bay(i, j)).then_some(b'#'));
        let found = passages(&store);
        assert_eq!(found.len(), usize::from(is_room), "{mouth}, {bay}: {found:?}");
        assert!(found.iter().all(|passage| is_near(passage.width, mouth as f64 * T)), "{mouth}, {bay}: {found:?}");
    }
    // A corridor is as wide as its mouth, however long it is.
    let store = room(120, 50, |i, j| (i >= 40 && !(20..30).contains(&j)).then_some(b'#'));
    assert_eq!(passages(&store), []);
}

#[test]
fn a_corridor_between_rooms_is_a_passage_in_its_middle() {
    for (first, end, turned) in [(40, 61, false), (40, 61, true), (33, 70, false)] {
        let is_solid = |i: usize, j: usize| (first..end).contains(&i) && !(20..27).contains(&j);
        let store = room(110, 110, |i, j| {
            let (along, across) = if turned { (j, i) } else { (i, j) };
            (is_solid(along, across) || across > 50).then_some(b'#')
        });
        let found = passages(&store);
        assert!(found.len() == 1 && is_near(found[0].width, 0.7), "{found:?}");
        let [along, across] = if turned { [found[0].at.y, found[0].at.x] } else { [found[0].at.x, found[0].at.y] };
        assert!(is_near(along, (first + end) as f64 / 2.0 * T) && is_near(across, 2.35), "{found:?}");
    }
}

#[test]
fn a_door_in_a_wall_that_stands_askew_is_as_wide_as_it_is_straight_across() {
    for way in [[1.0, 1.0], [1.0, -1.0], [2.0, 1.0], [1.0, 2.0], [2.0, -1.0], [1.0, -2.0]] {
        let length = f64::hypot(way[0], way[1]);
        // How far a pixel is beside the wall's middle line, and from the door's middle along it.
        let place = |i: usize, j: usize| {
            let [x, y] = [i, j].map(|v| v as f64 - 59.5);
            [(x * way[1] - y * way[0]) / length, (x * way[0] + y * way[1]) / length]
        };
        let store = room(120, 120, |i, j| {
            let [beside, along] = place(i, j);
            (beside.abs() < 1.0 && along.abs() > 12.0).then_some(b'#')
        });
        let found = passages(&store);
        assert_eq!(found.len(), 1, "{way:?}: {found:?}");
        assert!((found[0].width - 2.4).abs() < 1.6 * T, "{way:?}: {found:?}");
    }
}

#[test]
fn a_pit_makes_a_passage_where_it_is_long_beside_the_gap() {
    for (gap, length, is_passage) in [(4, 20, true), (4, 5, false), (8, 20, true), (8, 12, false)] {
        let is_pit = |i: usize, j: usize| (43..48).contains(&i) && (1 + gap..1 + gap + length).contains(&j);
        let found = passages(&room(90, 46, |i, j| is_pit(i, j).then_some(b' ')));
        assert_eq!(found.iter().any(|passage| passage.at.y < 1.5), is_passage, "{gap}, {length}: {found:?}");
    }
}
