use super::*;
use nalgebra::Vector3;
use proptest::prelude::*;
use std::collections::{BTreeMap, HashSet};

const PIXEL_M: f64 = 0.05;

fn frame() -> Frame {
    Frame::new(PIXEL_M, 0.15).unwrap()
}

/// A space of which these boxes of cells were seen, and its cells.
fn space(boxes: &[([i64; 3], [i64; 3])]) -> (SeenSpace, HashSet<[i64; 3]>) {
    let mut cells = HashSet::new();
    for (first, size) in boxes {
        for x in first[0]..first[0] + size[0] {
            for y in first[1]..first[1] + size[1] {
                cells.extend((first[2]..first[2] + size[2]).map(|z| [x, y, z]));
            }
        }
    }
    let mut pages = BTreeMap::new();
    for cell in &cells {
        let at = [cell[0].div_euclid(16), cell[1].div_euclid(16), cell[2].div_euclid(64)].map(|at| at as i32);
        let key = PageKey { tx: at[0], ty: at[1], layer: at[2] };
        let inner = [cell[0].rem_euclid(16), cell[1].rem_euclid(16), cell[2].rem_euclid(64)];
        pages.entry(key).or_insert(SeenPage::NOTHING).mark(inner.map(|at| [at as usize; 2]));
    }
    let mut space = SeenSpace::new(frame());
    let mut block: Option<SeenBlock> = None;
    for (key, page) in &pages {
        let (of, at) = SeenBlock::place_of(*key);
        if block.as_ref().is_some_and(|block| block.key != of) {
            assert!(space.push(block.take().unwrap()));
        }
        block.get_or_insert_with(|| SeenBlock::new(of)).push(at, page);
    }
    assert!(block.is_none_or(|block| space.push(block)));
    assert_eq!(space.cells(), cells.len() as u64);
    assert!(space.pages().map(|(key, _)| key).eq(pages.keys().copied()));
    (space, cells)
}

fn boxes() -> impl Strategy<Value = Vec<([i64; 3], [i64; 3])>> {
    let one = ([-20i64..20, -20..20, -70..70], [1i64..30, 1..30, 1..140]);
    proptest::collection::vec(one, 1..4)
}

/// Cell of a place, by division alone.
fn cell(place: [f64; 3]) -> [i64; 3] {
    [(place[0] / 0.2).floor() as i64, (place[1] / 0.2).floor() as i64, (place[2] / 0.15).floor() as i64]
}

proptest! {
    #[test]
    fn boxes_are_seen_if_all_their_cells_are(
        boxes in boxes(), corner in [-5.0f64..5.0, -5.0..5.0, -11.0..11.0], size in [0.0f64..3.0, 0.0..3.0, 0.0..8.0], tiny: bool
    ) {
        let (space, cells) = space(&boxes);
        // Away from edges of cells, where the two roundings may differ.
        let corner = corner.map(|v| (v * 100.0).floor() / 100.0 + 0.0033);
        let size = size.map(|v| if tiny { 0.0 } else { (v * 100.0).floor() / 100.0 });
        let end: [f64; 3] = std::array::from_fn(|axis| corner[axis] + size[axis]);
        let (first, last) = (cell(corner), cell(end));
        let all = (first[0]..=last[0]).all(|x| (first[1]..=last[1]).all(|y| {
            (first[2]..=last[2]).all(|z| cells.contains(&[x, y, z]))
        }));
        prop_assert_eq!(space.is_box_seen(corner.into(), end.into()), all);
        prop_assert_eq!(space.is_seen(corner.into()), cells.contains(&first));
    }

    #[test]
    fn pawns_are_seen_if_the_line_above_three_slices_is(
        boxes in boxes(), feet in [-5.0f64..5.0, -5.0..5.0, -11.0..11.0], climb in 0.0f64..1.0, height in 0.1f64..3.0
    ) {
        let (space, cells) = space(&boxes);
        let feet = feet.map(|v| (v * 100.0).floor() / 100.0 + 0.0033);
        let [climb, height] = [climb, height].map(|v| (v * 100.0).floor() / 100.0);
        let [floor, climbed, head] = [0.0, climb, height].map(|up| cell([feet[0], feet[1], feet[2] + up]));
        let lowest = if climbed[2] > floor[2] + 3 { climbed[2] } else { floor[2] + 3 };
        let lowest = if lowest < head[2] { lowest } else { head[2] };
        let all = (lowest..=head[2]).all(|z| cells.contains(&[floor[0], floor[1], z]));
        prop_assert_eq!(space.is_pawn_seen(feet.into(), climb, height), all);
    }

    #[test]
    fn rays_are_seen_if_all_cells_on_their_way_are(
        boxes in boxes(), origin in [-5.0f64..5.0, -5.0..5.0, -11.0..11.0], along in [-1.0f64..1.0, -1.0..1.0, -1.0..1.0],
        length in 0.0f64..6.0, hits: bool, flat in 0usize..8
    ) {
        let (space, cells) = space(&boxes);
        let along: [f64; 3] = std::array::from_fn(|axis| if flat >> axis & 1 == 1 { 0.0 } else { along[axis] });
        let at = |share: f64| -> [f64; 3] { std::array::from_fn(|axis| origin[axis] + along[axis] * length * share) };
        let end = cell(at(1.0));
        let counts = |own: [i64; 3]| !(hits && (0..3).all(|axis| (own[axis] - end[axis]).abs() <= 2));
        let steps = 6000;
        let all = (0..=steps).all(|step| {
            let own = cell(at(f64::from(step) / f64::from(steps)));
            !counts(own) || cells.contains(&own)
        });
        let found = space.is_ray_seen(origin.into(), Vector3::from(along), length, hits);
        // The samples may miss the corner of a cell, but see nothing that is not on the ray.
        prop_assert!(!found || all, "the ray crosses a cell that was not seen");
        if all && !found {
            // Then it crosses such a cell for less than two steps.
            let near = (0..=steps).any(|step| {
                let place = at(f64::from(step) / f64::from(steps));
                (0..8).any(|corner: i32| {
                    let by = |axis: i32| if corner >> axis & 1 == 1 { 0.0021 } else { -0.0021 };
                    let own = cell([place[0] + by(0), place[1] + by(1), place[2] + by(2)]);
                    counts(own) && !cells.contains(&own)
                })
            });
            prop_assert!(near, "all cells on the way were seen");
        }
    }

    #[test]
    fn pages_become_bytes_and_back(words in proptest::collection::vec(any::<u64>(), 256)) {
        let mut bytes = Vec::new();
        words.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
        let page = SeenPage::decode(&bytes.clone().try_into().unwrap());
        let mut again = Vec::new();
        page.encode(&mut again);
        prop_assert_eq!(again, bytes);
        // The bits of a cell by its place.
        let bit = |x: usize, y: usize, z: usize| page.slices()[z][y / 4] >> (16 * (y % 4) + x) & 1 == 1;
        for (x, y, z) in [(0, 0, 0), (15, 3, 17), (4, 15, 63), (9, 6, 40)] {
            prop_assert_eq!(bit(x, y, z), page.is_seen([[x; 2], [y; 2], [z; 2]]));
        }
    }
}

#[test]
fn rays_without_an_end_stop_where_nothing_was_seen_and_far_boxes_are_not_seen() {
    let (space, _) = space(&[([-4, -4, -4], [8, 8, 8])]);
    let middle = Point3::new(0.01, 0.01, 0.01);
    assert!(!space.is_ray_seen(middle, Vector3::x(), f64::INFINITY, false));
    assert!(space.is_ray_seen(middle, Vector3::x(), 0.5, false));
    assert!(!space.is_ray_seen(middle, Vector3::x(), 1.5, false));
    assert!(space.is_ray_seen(middle, Vector3::x(), 1.1, true));
    assert!(space.is_ray_seen(middle, Vector3::zeros(), f64::INFINITY, false));
    assert!(!space.is_box_seen(Point3::new(-1e300, -1e300, -1e300), Point3::new(1e300, 1e300, 1e300)));
    assert!(!space.is_seen(Point3::new(1e12, 0.0, f64::NAN)));
    let nothing = SeenSpace::new(frame());
    assert!(!nothing.is_box_seen(middle, middle) && nothing.cells() == 0);
}

#[test]
fn blocks_come_in_order_and_keep_full_pages_apart() {
    let key = PageKey { tx: 0, ty: 0, layer: -1 };
    let mut block = SeenBlock::new(key);
    let mut part = SeenPage::NOTHING;
    part.mark([[0, 0], [15, 15], [63, 63]]);
    block.push(0, &SeenPage::NOTHING);
    block.push(1, &part);
    block.push(63, &SeenPage::ALL);
    assert_eq!((block.full, block.mixed, block.pages.len()), (1 << 63, 2, 1));
    assert_eq!(block.cells(), 1 + SeenPage::CELLS);
    let keys: Vec<_> = block.each_page().map(|(key, page)| (key.layer, page.cells())).collect();
    assert_eq!(keys, [(-63, 1), (-1, SeenPage::CELLS)]);
    let mut space = SeenSpace::new(frame());
    assert!(space.push(block.clone()) && !space.push(block));
    assert_eq!(space.cells(), 1 + SeenPage::CELLS);
    let besides = space.bytes() - 2048;
    assert!((24..=48).contains(&besides), "{besides} bytes of a block besides its page");
    // The full page ends at height 0 and is 3.2 m wide.
    let seen = |x: f64, z: f64| space.is_box_seen(Point3::new(0.01, 0.01, -9.0), Point3::new(x, 3.19, z));
    assert!(seen(3.19, -0.01) && !seen(3.21, -0.01) && !seen(3.19, 0.01));
}
