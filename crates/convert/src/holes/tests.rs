//! Tests of holes: comparison with the definition pixel by pixel, and shapes that are or are not closed.

use super::closing::{Closer, Fill, ScannedColumn};
use crate::frame::Frame;
use crate::page::{PageBuilder, Span};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};

type Pixel = (i64, i64);
/// Spans of pixels: bottom, top (quanta), floor or not.
type World = BTreeMap<Pixel, Vec<(i64, i64, bool)>>;

fn frame() -> Frame {
    Frame::new(0.1, 0.3).unwrap()
}

/// Returns a length in quanta, rounded to nearest.
fn quanta(metres: f64) -> i64 {
    (metres * 850.0).round() as i64
}

/// Returns the fills of tile (0, 0).
fn closed(world: &World, widest: u8) -> BTreeSet<(Pixel, i64, i64)> {
    let columns: Vec<Option<ScannedColumn>> = (0..9i64)
        .map(|tile| {
            let corner = (tile % 3 * 64 - 64, tile / 3 * 64 - 64);
            let mut builders: BTreeMap<i64, BTreeMap<Pixel, Vec<Span>>> = BTreeMap::new();
            for (&(x, y), spans) in world {
                let at = (x - corner.0, y - corner.1);
                if !(0..64).contains(&at.0) || !(0..64).contains(&at.1) {
                    continue;
                }
                for &(bottom, top, floor) in spans {
                    // Cut at page boundaries.
                    for layer in bottom.div_euclid(16320)..=(top - 1).max(bottom).div_euclid(16320) {
                        let [low, high] = [bottom, top].map(|height| (height - layer * 16320).clamp(0, 16320) as u32);
                        let span = Span::new(low, high, !floor).unwrap();
                        builders.entry(layer).or_default().entry(at).or_default().push(span);
                    }
                }
            }
            let pages: Vec<_> = builders
                .into_iter()
                .map(|(layer, columns)| {
                    let mut builder = PageBuilder::default();
                    columns.iter().for_each(|(at, spans)| assert!(builder.set_column(at.0 as u32, at.1 as u32, spans)));
                    (layer as i32, builder.build())
                })
                .collect();
            (!pages.is_empty()).then(|| ScannedColumn::of(&pages))
        })
        .collect();
    let around = std::array::from_fn(|tile| columns[tile].as_ref());
    let fills = Closer::new(&frame(), widest).close(&around);
    assert!(fills.is_sorted());
    fills
        .into_iter()
        .map(|Fill { pixel, bottom, top }| ((i64::from(pixel) % 64, i64::from(pixel) / 64), bottom, top))
        .collect()
}

/// Computes the fills of tile (0, 0) by the definition: those of each width in turn.
fn by_definition(world: &World, widest: i64) -> BTreeSet<(Pixel, i64, i64)> {
    let mut found = BTreeMap::new();
    (1..=widest).for_each(|width| add_by_definition(world, width, &mut found));
    found.into_iter().flat_map(|(at, fills)| fills.into_iter().map(move |(b, t)| (at, b, t))).collect()
}

/// Adds the fills of holes of one width.
fn add_by_definition(world: &World, widest: i64, found: &mut BTreeMap<Pixel, Vec<(i64, i64)>>) {
    let step = quanta(0.35) / 4;
    let across = widest + 1;
    let in_disc = |x: i64, y: i64| {
        let [x, y] = [x, y].map(|v| v as f64 + 0.5 - across as f64 / 2.0);
        x * x + y * y <= (across as f64 / 2.0 - 0.25).powi(2) + 1e-9
    };
    let disc: Vec<Pixel> =
        (0..across).flat_map(|y| (0..across).map(move |x| (x, y))).filter(|&(x, y)| in_disc(x, y)).collect();
    let tops = || world.values().flatten().filter(|span| span.2).map(|span| span.1);
    let (Some(low), Some(high)) = (tops().min(), tops().max()) else { return };
    for window in low.div_euclid(step) - 3..=high.div_euclid(step) {
        let heights = window * step..(window + 4) * step;
        let floor: BTreeMap<Pixel, i64> = world
            .iter()
            .filter_map(|(&at, spans)| {
                let tops = spans.iter().filter(|span| span.2 && heights.contains(&span.1)).map(|span| span.1);
                Some((at, tops.max()?))
            })
            .collect();
        if floor.is_empty() {
            continue;
        }
        // As far around the tile as any pixel can have an effect.
        const SIDE: i64 = 144;
        let place = |x: i64, y: i64| ((y + 40) * SIDE + x + 40) as usize;
        let mut is_floor = vec![false; (SIDE * SIDE) as usize];
        let inside = |&&(x, y): &&Pixel| (-40..104).contains(&x) && (-40..104).contains(&y);
        floor.keys().filter(inside).for_each(|&(x, y)| is_floor[place(x, y)] = true);
        let mut open: HashSet<Pixel> = HashSet::new();
        for (x, y) in (-40..104 - across).flat_map(|y| (-40..104 - across).map(move |x| (x, y))) {
            if disc.iter().all(|&(dx, dy)| !is_floor[place(x + dx, y + dy)]) {
                open.extend(disc.iter().map(|&(dx, dy)| (x + dx, y + dy)));
            }
        }
        for _ in 0..(widest + 1) / 4 + 1 {
            let near = |&(x, y): &Pixel| (0..9).map(move |n| (x + n % 3 - 1, y + n / 3 - 1));
            let void = |at: &Pixel| inside(&at) && !is_floor[place(at.0, at.1)];
            let more: Vec<Pixel> = open.iter().flat_map(near).filter(void).collect();
            open.extend(more);
        }
        for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
            if floor.contains_key(&(x, y)) || open.contains(&(x, y)) {
                continue;
            }
            let hit = |dx: i64, dy: i64| {
                let steps = (1..=widest + widest * 5 / 12 + 1).map(|n| (n, (x + n * dx, y + n * dy)));
                steps.filter_map(|(n, at)| Some((n, *floor.get(&at)?))).next()
            };
            let mut heights = Vec::new();
            for (dx, dy) in [(1, 0), (0, 1), (1, 1), (1, -1)] {
                if let (Some((a, top_a)), Some((b, top_b))) = (hit(dx, dy), hit(-dx, -dy)) {
                    let height = (top_a * b + top_b * a) * 1024;
                    heights.push(height.div_euclid(a + b));
                }
            }
            if heights.len() < 2 {
                continue;
            }
            let (sum, all) = (heights.iter().sum::<i64>(), 1024 * heights.len() as i64);
            let (bottom, top) = (sum.div_euclid(all), -(-sum).div_euclid(all));
            let spans = world.get(&(x, y)).map_or(&[][..], |spans| spans);
            let climb = 4 * step;
            let others = found.entry((x, y)).or_default();
            if others.iter().any(|fill| bottom <= fill.1 + climb && fill.0 <= top + climb)
                || spans.iter().any(|span| span.1 >= bottom && span.0 <= top + climb)
            {
                continue;
            }
            let below: Vec<_> = spans.iter().filter(|span| span.1 < bottom).collect();
            let is_free = match &below[..] {
                [] => true,
                [_] => false,
                [.., room, ceiling] => bottom - ceiling.1 <= quanta(0.6) && ceiling.0 - room.1 >= quanta(1.5),
            };
            if is_free {
                others.push((bottom, top));
            }
        }
    }
}

/// Flat floor at `height` in the tile and 60 pixels around it, where `holds` returns true.
fn flat(height: i64, holds: impl Fn(i64, i64) -> bool) -> World {
    let all = (-60..124).flat_map(|y| (-60..124).map(move |x| (x, y)));
    all.filter(|&(x, y)| holds(x, y)).map(|at| (at, vec![(height - 2, height, true)])).collect()
}

fn pixels(fills: &BTreeSet<(Pixel, i64, i64)>) -> HashSet<Pixel> {
    fills.iter().map(|fill| fill.0).collect()
}

/// Two storeys of floor with slope and noise, walls, and holes of all kinds.
fn world() -> impl Strategy<Value = World> {
    let hole = (-20i64..80, -20i64..80, 1i64..24, 1i64..24, any::<bool>());
    let holes = proptest::collection::vec(hole, 1..12);
    let slope = (-9i64..10, -9i64..10, 0i64..12, -3000i64..3000);
    (holes, slope, 0u64..6, any::<u64>()).prop_map(|(holes, (dx, dy, noise, base), storeys, seed)| {
        let mut state = seed;
        let mut below = |most: i64| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as i64 % most.max(1)
        };
        let mut world = World::new();
        for (x, y) in (-30..94).flat_map(|y| (-30..94).map(move |x| (x, y))) {
            let in_hole = holes.iter().any(|&(cx, cy, a, b, round)| match round {
                true => (x - cx).pow(2) * 4 + (y - cy).pow(2) * 4 <= a * a,
                false => (0..a).contains(&(x - cx)) && (0..b).contains(&(y - cy)),
            });
            let floor = base + dx * x + dy * y + below(noise + 1);
            let mut spans = Vec::new();
            if !in_hole && below(40) > 0 {
                spans.push((floor - 1, floor, true));
            }
            if below(150) == 0 {
                spans = vec![(floor - below(900), floor + below(2000), false)];
            }
            if storeys > 2 && below(9) > 0 {
                // A ceiling and the floor of the next storey, in some pixels a table.
                spans.push((floor + 2500, floor + 2501, true));
                if !in_hole {
                    spans.push((floor + 2720, floor + 2722, true));
                } else if below(12) == 0 {
                    spans.push((floor + 3300, floor + 3310, true));
                }
            }
            if !spans.is_empty() {
                world.insert((x, y), spans);
            }
        }
        world
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]
    #[test]
    fn holes_are_those_of_the_definition(world in world(), widest in prop::sample::select(vec![1u8, 2, 3, 5, 8])) {
        let (found, expected) = (closed(&world, widest), by_definition(&world, widest.into()));
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn a_larger_width_never_closes_less(world in world()) {
        let mut before = BTreeSet::new();
        for widest in [1u8, 2, 3, 4, 6, 9, 13, 20, 45] {
            let found = closed(&world, widest);
            let lost: Vec<_> = before.difference(&found).collect();
            prop_assert!(lost.is_empty(), "{} pixels close less: {:?}", widest, lost);
            before = found;
        }
    }
}

#[test]
fn slots_squares_and_discs_are_closed_up_to_the_width_and_not_beyond() {
    for widest in [1u8, 2, 3, 4, 6, 9, 14, 24, 45] {
        let k = i64::from(widest);
        for size in [1, k - 1, k, k + 1, k + 2, k + 4, 2 * k].into_iter().filter(|&size| (1..60).contains(&size)) {
            let from = 32 - size / 2;
            let inside = |v: i64| (from..from + size).contains(&v);
            let slot = |x: i64, _: i64| inside(x);
            let square = |x: i64, y: i64| inside(x) && inside(y);
            let disc = |x: i64, y: i64| {
                let [x, y] = [x, y].map(|v| 2 * (v - from) + 1 - size);
                x * x + y * y <= size * size
            };
            type Shape<'a> = (&'a str, &'a dyn Fn(i64, i64) -> bool);
            let shapes: [Shape<'_>; 3] = [("slot", &slot), ("square", &square), ("disc", &disc)];
            for (name, shape) in shapes {
                let world = flat(700, |x, y| !shape(x, y));
                let found = pixels(&closed(&world, widest));
                let all = (0..64).flat_map(|y| (0..64).map(move |x| (x, y))).filter(|&(x, y)| shape(x, y));
                let all: HashSet<Pixel> = all.collect();
                // The rim of a disc is as rough as its pixels.
                match size {
                    size if size <= k => assert_eq!(found, all, "{name} of {size}, up to {k}"),
                    size if name != "disc" || size > k + 1 => {
                        assert!(found.is_empty(), "{name} of {size}, up to {k}: {found:?}");
                    }
                    _ => {}
                }
            }
        }
    }
}

#[test]
#[ignore = "slow: .ci/run"]
fn slots_at_any_angle_are_closed_up_to_the_width() {
    for widest in [6u8, 12, 24, 45] {
        for degrees in (0..180).step_by(7) {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            let slot = |width: f64| {
                let world = flat(0, |x, y| ((x as f64 - 31.5) * sin - (y as f64 - 31.5) * cos).abs() > width / 2.0);
                let void = (0..64 * 64).map(|at| (at % 64, at / 64)).filter(|at| !world.contains_key(at)).count();
                (pixels(&closed(&world, widest)).len(), void)
            };
            // A slot one pixel narrower is always closed, one 2.5 pixels wider never.
            let (found, void) = slot(f64::from(widest) - 1.0);
            assert_eq!(found, void, "{widest} pixels at {degrees} degrees");
            assert_eq!(slot(f64::from(widest) + 2.5).0, 0, "{widest} pixels at {degrees} degrees");
        }
    }
}

#[test]
fn heights_lie_between_those_on_both_sides() {
    // Slope of 10 quanta per pixel along x, with a slot across it and a hole.
    let slope: World = flat(0, |x, y| !(20..26).contains(&x) && ((x - 45).pow(2) + (y - 30).pow(2) > 9))
        .into_keys()
        .map(|(x, y)| ((x, y), vec![(10 * x - 1, 10 * x, true)]))
        .collect();
    let found = closed(&slope, 7);
    assert_eq!(found.len(), 6 * 64 + 29);
    for ((x, _), bottom, top) in found {
        assert!(bottom <= 10 * x && 10 * x <= top && top - bottom <= 1, "{x}: {bottom} to {top}");
    }
}

#[test]
fn nothing_is_closed_across_a_ledge_or_beyond_the_edge_of_the_scan_or_in_a_door_to_the_outside() {
    let climb = quanta(0.35);
    for drop in [0, climb / 2, climb + 4, 3000] {
        let world: World = flat(0, |x, _| !(30..34).contains(&x))
            .into_keys()
            .map(|(x, y)| ((x, y), if x < 30 { vec![(-1, 0, true)] } else { vec![(drop - 1, drop, true)] }))
            .collect();
        let found = closed(&world, 6);
        assert_eq!(found.len(), if drop <= climb / 2 { 4 * 64 } else { 0 }, "{drop} quanta");
    }
    let edge = closed(&flat(0, |x, _| x < 40), 20);
    assert!(edge.is_empty(), "{edge:?}");
    let corner = closed(&flat(0, |x, y| x < 40 || y < 20), 20);
    assert!(corner.is_empty(), "{corner:?}");
    // A wall with a door, and nothing behind it.
    let mut door = flat(0, |x, _| x < 40);
    for y in (-60..124).filter(|y| !(25..33).contains(y)) {
        door.insert((40, y), vec![(-1, 2000, false)]);
        door.insert((41, y), vec![(-1, 2000, false)]);
    }
    assert!(closed(&door, 20).is_empty());
    // A wall that meets the floor stays as it is; so does the void between two walls.
    door.extend(flat(0, |x, _| x > 41));
    let found = pixels(&closed(&door, 20));
    assert!(found.iter().all(|&(x, y)| (40..42).contains(&x) && (25..33).contains(&y)), "only the sill: {found:?}");
}

#[test]
fn a_hole_through_which_something_was_scanned_is_no_hole_of_the_scan() {
    let hole = |x: i64, y: i64| (20..24).contains(&x) && (20..24).contains(&y);
    let with = |spans: Vec<(i64, i64, bool)>| {
        let mut world = flat(0, |x, y| !hole(x, y));
        (20..24).flat_map(|y| (20..24).map(move |x| (x, y))).for_each(|at| drop(world.insert(at, spans.clone())));
        closed(&world, 6).len()
    };
    assert_eq!(with(Vec::new()), 16);
    assert_eq!(with(vec![(-601, -600, true)]), 0, "the bottom of a pit");
    assert_eq!(with(vec![(-2600, -2599, true)]), 0, "the floor below");
    assert_eq!(with(vec![(-2600, -2599, true), (-220, -219, true)]), 16, "a ceiling with a room below");
    assert_eq!(with(vec![(-1300, -1299, true), (-220, -219, true)]), 0, "no room");
    assert_eq!(with(vec![(200, 201, true)]), 0, "a box");
    assert_eq!(with(vec![(620, 621, true)]), 16, "a table");
    assert_eq!(with(vec![(-100, 900, false)]), 0, "a pillar");
}
