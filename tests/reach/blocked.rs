//! Obstructions of pawns, in scenes with known obstructions, with all pages in memory and with few.

use super::flat::{Columns, layers};
use super::plans::finish;
use crate::common::part::Part;
use nalgebra::Point3;
use slicewalk::frame::{Frame, PageKey, SLICE_QUANTA};
use slicewalk::reach::{Obstruction, ObstructionSearch, Pawn, Planner, Reason, Sought};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk::{Error, Monitor, NoMonitor};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Pixel and slice (m).
const T: f64 = 0.1;
const SIGMA: f64 = 0.3;
/// Height of the floor (quanta, m), and size of the hall (pixels): two by three tiles, and a wall across its middle.
const FLOOR: i64 = 10 * SLICE_QUANTA;
const FLOOR_M: f64 = 10.0 * SIGMA;
const HALL: [i64; 2] = [170, 90];
const MIDDLE: i64 = 85;

fn quanta(metres: f64) -> i64 {
    (metres / SIGMA * SLICE_QUANTA as f64).round() as i64
}

/// Scene over a pixel: nothing, a floor of this height (m), a wall, or a floor at 0 m below a beam or another floor of
/// this height (m).
#[derive(Clone, Copy)]
enum Over {
    Nothing,
    Floor(f64),
    Wall,
    Beam(f64),
    Deck(f64),
}

fn scene([width, depth]: [i64; 2], over: impl Fn(i64, i64) -> Over) -> Snapshot {
    let floor = |z: f64| (FLOOR + quanta(z) - 3, FLOOR + quanta(z), false);
    let above = |z: f64| (FLOOR + quanta(z), FLOOR + 9 * SLICE_QUANTA, true);
    let mut columns = Columns::new();
    for (i, j) in (0..width).flat_map(|i| (0..depth).map(move |j| (i, j))) {
        let is_outer = i == 0 || j == 0 || i + 1 == width || j + 1 == depth;
        let spans = match if is_outer { Over::Wall } else { over(i, j) } {
            Over::Nothing => continue,
            Over::Floor(z) => vec![floor(z)],
            Over::Wall => vec![(FLOOR - 3, FLOOR + 9 * SLICE_QUANTA, true)],
            Over::Beam(z) => vec![floor(0.0), above(z)],
            Over::Deck(z) => vec![floor(0.0), floor(z)],
        };
        columns.insert((i, j), spans);
    }
    layers(Frame::new(T, SIGMA).unwrap(), &columns)
}

/// A hall with a wall across its middle; `door` says what stands there in its place.
fn hall(door: impl Fn(i64) -> Option<Over>) -> Snapshot {
    scene(HALL, |i, j| if i == MIDDLE { door(j).unwrap_or(Over::Wall) } else { Over::Floor(0.0) })
}

fn at([i, j]: [i64; 2], z: f64) -> Point3<f64> {
    Point3::new((i as f64 + 0.5) * T, (j as f64 + 0.5) * T, FLOOR_M + z + 0.05)
}

/// A scene, a pawn with its length, and what keeps it from the goal.
struct Case {
    store: Snapshot,
    pawn: Pawn,
    length: Option<f64>,
    ends: [Point3<f64>; 2],
    /// The reason, the measure that is needed, and by how much it may differ.
    expected: Option<(Reason, f64, f64)>,
}

const BODY: Body = Body::Box { x: 0.5, y: 0.5, height: 1.8 };
const CYLINDER: Body = Body::Cylinder { radius: 0.4, height: 1.4 };
const PLAIN: Over = Over::Floor(0.0);

/// A box across a hall whose far end is at `z`.
fn case(store: Snapshot, z: f64, reason: Reason, needs: f64, within: f64) -> Case {
    let ends = [at([20, 45], 0.0), at([150, 45], z)];
    Case { store, pawn: Pawn::new(BODY), length: None, ends, expected: Some((reason, needs, within)) }
}

/// Puts `over` in place of the wall from pixel `from` to before pixel `to`.
fn door(from: i64, to: i64, over: Over) -> impl Fn(i64) -> Option<Over> {
    move |j| (from..to).contains(&j).then_some(over)
}

fn edge(z: f64) -> Snapshot {
    scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { z }))
}

fn ramp() -> Snapshot {
    scene(HALL, |i, _| Over::Floor((i as f64 * T - 6.0).clamp(0.0, 5.0) * 0.09))
}

fn pit(below: Over) -> Snapshot {
    scene(HALL, |i, _| if (MIDDLE..MIDDLE + 15).contains(&i) { below } else { PLAIN })
}

/// A test for each case.
macro_rules! cases {
    ($($(#[$about:meta])* $name:ident: $case:expr;)*) => {
        $($(#[$about])* #[test] fn $name() { holds(&$case); })*
    };
}

cases! {
    a_narrow_door: case(hall(door(30, 33, PLAIN)), 0.0, Reason::Width, 0.3, 0.05);
    a_low_door: case(hall(door(30, 42, Over::Beam(1.5))), 0.0, Reason::Headroom, 1.5, 0.03);
    of_two_doors_that_of_the_smaller_change: case(
        hall(|j| door(30, 33, PLAIN)(j).or(door(60, 72, Over::Beam(1.7))(j))),
        0.0,
        Reason::Headroom,
        1.7,
        0.03,
    );
    a_step_up: case(edge(0.6), 0.6, Reason::Step, 0.6, 0.02);
    a_step_up_without_drops_so_deep:
        Case { pawn: Pawn { climb: 0.2, ..Pawn::new(BODY) }, ..case(edge(0.6), 0.6, Reason::Step, 0.6, 0.02) };
    a_steep_ramp: Case {
        pawn: Pawn { max_grade: 0.06, ..Pawn::new(BODY) },
        ..case(ramp(), 0.45, Reason::Slope, 0.09, 0.004)
    };
    a_start_on_a_steep_ramp: Case {
        pawn: Pawn { max_grade: 0.06, ..Pawn::new(BODY) },
        ends: [at([MIDDLE, 45], 0.225), at([150, 45], 0.45)],
        ..case(ramp(), 0.45, Reason::Slope, 0.09, 0.004)
    };
    a_long_ramp: Case {
        pawn: Pawn { max_grade: 0.06, max_ramp: 6.0, ..Pawn::new(BODY) },
        ..case(
            scene(HALL, |i, _| Over::Floor((i as f64 * T - 4.0).clamp(0.0, 8.0) * 0.055)),
            0.44,
            Reason::Ramp,
            8.0,
            0.8,
        )
    };
    a_step_down_of_who_takes_drops_as_deep_as_steps: Case {
        pawn: Pawn { climb: 0.2, max_drop: 0.2, ..Pawn::new(BODY) },
        ..case(edge(-0.6), -0.6, Reason::Step, 0.6, 0.02)
    };
    /// A pawn that climbs higher takes no deeper drops.
    a_step_down: Case { pawn: Pawn { climb: 0.2, ..Pawn::new(BODY) }, ..case(edge(-0.6), -0.6, Reason::Gap, 0.6, 0.05) };
    a_pit: case(pit(Over::Floor(-2.0)), 0.0, Reason::Gap, 1.5, 0.4);
    ground_that_was_not_scanned: case(pit(Over::Nothing), 0.0, Reason::Unseen, 1.5, 0.4);
    a_wall: case(hall(|_| None), 0.0, Reason::Gap, 0.6, 0.11);
    /// The hole, in a corner of the first room, is not on the way.
    a_wall_beside_a_hole: case(
        scene(HALL, |i, j| match i {
            MIDDLE => Over::Wall,
            _ if i < 12 && j < 12 => Over::Nothing,
            _ => PLAIN,
        }),
        0.0,
        Reason::Gap,
        0.6,
        0.11,
    );
    /// It is as far as it is high.
    another_storey: case(scene(HALL, |_, _| Over::Deck(3.4)), 3.4, Reason::Unseen, 3.4, 0.01);
    a_bend: Case {
        pawn: Pawn { climb: 0.02, max_drop: 0.02, ..Pawn::new(CYLINDER) },
        length: Some(1.3),
        ends: [at([5, 50], 0.0), at([50, 5], 0.0)],
        ..case(
            scene([60, 60], |i, j| if i < 11 || j < 11 { PLAIN } else { Over::Wall }),
            0.0,
            Reason::Length,
            1.0,
            0.2,
        )
    };
    a_narrow_door_for_a_cylinder: Case {
        pawn: Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 }),
        ..case(hall(door(30, 33, PLAIN)), 0.0, Reason::Width, 0.3, 0.05)
    };
    a_low_door_for_a_cylinder: Case {
        pawn: Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 }),
        ..case(hall(door(30, 42, Over::Beam(1.5))), 0.0, Reason::Headroom, 1.5, 0.03)
    };
    /// Lower than the least height that is tried for others.
    a_low_door_for_a_low_box: Case {
        pawn: Pawn { climb: 0.02, max_drop: 0.02, ..Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 0.1 }) },
        ..case(hall(door(30, 42, Over::Beam(0.085))), 0.0, Reason::Headroom, 0.08, 0.011)
    };
    /// Half a metre for the longer of its sides.
    a_narrow_door_for_an_oblong_box: Case {
        pawn: Pawn::new(Body::Box { x: 0.4, y: 0.8, height: 1.8 }),
        ..case(hall(door(30, 35, PLAIN)), 0.0, Reason::Width, 0.25, 0.03)
    };
    /// The pawn goes down a drop that it does not climb, but no long pawn does, however short it is.
    a_drop_for_a_long_pawn: Case {
        pawn: Pawn { climb: 0.2, max_drop: 0.5, ..Pawn::new(CYLINDER) },
        length: Some(1.3),
        expected: None,
        ..case(edge(-0.4), -0.4, Reason::Length, 0.0, 0.0)
    };
    nothing: Case { expected: None, ..case(hall(door(30, 42, PLAIN)), 0.0, Reason::Width, 0.0, 0.0) };
    no_room_at_the_goal: Case {
        ends: [at([20, 45], 0.0), at([MIDDLE, 45], 0.0)],
        expected: None,
        ..case(hall(|_| None), 0.0, Reason::Width, 0.0, 0.0)
    };
}

#[test]
fn a_door_narrow_and_low() {
    let case = case(hall(door(30, 33, Over::Beam(1.3))), 0.0, Reason::Width, 0.3, 0.05);
    let found = same_in_any_memory(&case).unwrap();
    let low = Pawn::new(Body::Box { x: found.needs, y: found.needs, height: 1.2 });
    assert_eq!(sought(&Case { pawn: low, ..case }, Memory::All).0, None, "{found:?}");
}

/// One measure leads past the first wall, another one past the second: the first one counts.
#[test]
fn a_low_door_before_a_narrow_one() {
    let store = scene(HALL, |i, j| match i {
        60 if (30..42).contains(&j) => Over::Beam(1.5),
        110 if (30..33).contains(&j) => PLAIN,
        60 | 110 => Over::Wall,
        _ => PLAIN,
    });
    let found = same_in_any_memory(&case(store, 0.0, Reason::Headroom, 1.5, 0.03)).unwrap();
    assert!((found.at.x - 60.0 * T).abs() < 0.5, "{found:?}");
}

/// From place to place it rises by 0.32 m, but walkers sink behind the sill, and climb 0.38 m.
#[test]
fn a_step_that_only_walkers_meet() {
    const SILL: i64 = 19;
    let height = |i: i64| if i == SILL { 0.06 } else { 0.38 * f64::from(u8::from(i > SILL + 2)) };
    let pawn = Pawn::new(Body::Cylinder { radius: 0.083, height: 0.8 });
    // Each width that is tried costs many walks.
    let store = scene([44, 9], |i, _| Over::Floor(height(i)));
    let ends = [at([8, 4], 0.0), at([34, 4], 0.38)];
    let found = same_in_any_memory(&Case { pawn, ends, ..case(store, 0.38, Reason::Step, 0.37, 0.021) }).unwrap();
    assert!((found.at.x - SILL as f64 * T).abs() < 0.5, "{found:?}");
}

/// Two corridors beside each other with a narrow door, and a wider one beyond: that one counts if the sum of its distances
/// from both ends is at most twice the straight line and 30 m, to within a tile.
#[test]
fn a_way_around_counts_if_it_is_not_much_longer_than_the_straight_line() {
    for (apart, beyond, counts) in [(0, 150, true), (0, 230, false), (200, 235, true), (200, 320, false)] {
        let (narrow, wide) = (5 + apart / 2, 5 + apart + beyond);
        let store = scene([23, wide + 20], |i, j| {
            let is_door = (narrow - 1..=narrow + 1).contains(&j) || (wide - 2..=wide + 2).contains(&j);
            if i == 11 && !is_door { Over::Wall } else { PLAIN }
        });
        let ends = [at([5, 5], 0.0), at([17, 5 + apart], 0.0)];
        let pawn = Pawn::new(Body::Box { x: 0.7, y: 0.7, height: 1.8 });
        let found = sought(&Case { pawn, ends, ..case(store, 0.0, Reason::Width, 0.0, 0.0) }, Memory::All).0.unwrap();
        let is_wide = found.needs > 0.4;
        assert!(found.reason == Reason::Width && is_wide == counts, "{apart}, {beyond}: {found:?}");
    }
}

/// Checks what is found whatever pages are in memory, that a pawn changed by what it needs gets there, and that one
/// changed by a little less does not.
fn holds(case: &Case) {
    let Some(found) = same_in_any_memory(case) else { return };
    let (precision, own) = match found.reason {
        Reason::Width => (T / 2.0, 2.0 * case.pawn.body.half().min()),
        Reason::Length => (T / 2.0, case.length.unwrap()),
        Reason::Headroom => (0.01, case.pawn.body.height()),
        Reason::Step => (0.01, case.pawn.climb),
        Reason::Slope => (0.001, case.pawn.max_grade),
        Reason::Ramp => (0.1, case.pawn.max_ramp),
        _ => return,
    };
    assert!(connects(&changed(case, found, found.needs)), "{found:?}");
    let less = found.needs + (own - found.needs).signum() * 1.01 * precision;
    assert!(!connects(&changed(case, found, less)), "{less} m is enough: {found:?}");
}

/// Whether there is a route between the ends.
fn connects(case: &Case) -> bool {
    let [from, to] = case.ends;
    let mut planner = Planner::new(&case.store, case.pawn, from, to).unwrap().drawn_out(case.length);
    finish(&mut planner, &case.store, usize::MAX).0.is_ok()
}

/// The case with the measure that was found too large, or too small, as `needs` says.
fn changed(case: &Case, found: Obstruction, needs: f64) -> Case {
    let body = case.pawn.body;
    let share = needs / (2.0 * body.half().min());
    let other = |body| Pawn { body, ..case.pawn };
    let pawn = match (found.reason, body) {
        (Reason::Width, Body::Box { x, y, height }) => other(Body::Box { x: x * share, y: y * share, height }),
        (Reason::Width, Body::Cylinder { height, .. }) => other(Body::Cylinder { radius: needs / 2.0, height }),
        (Reason::Headroom, Body::Box { x, y, .. }) => other(Body::Box { x, y, height: needs }),
        (Reason::Headroom, Body::Cylinder { radius, .. }) => other(Body::Cylinder { radius, height: needs }),
        (Reason::Step, _) if case.pawn.max_drop == case.pawn.climb => {
            Pawn { climb: needs, max_drop: needs, ..case.pawn }
        }
        (Reason::Step, _) => Pawn { climb: needs, ..case.pawn },
        (Reason::Ramp, _) => Pawn { max_ramp: needs, ..case.pawn },
        (Reason::Slope, _) => Pawn { max_grade: needs, ..case.pawn },
        _ => case.pawn,
    };
    Case { pawn, length: case.length.map(|_| needs), store: case.store.clone(), ..*case }
}

/// Returns what is found, which is what the case expects and the same with few pages in memory.
fn same_in_any_memory(case: &Case) -> Option<Obstruction> {
    let (found, questions, _) = sought(case, Memory::All);
    let near = |(reason, needs, within): (Reason, f64, f64)| {
        found.is_some_and(|found| found.reason == reason && (found.needs - needs).abs() <= within)
    };
    assert!(case.expected.map_or(found.is_none(), near), "{found:?}");
    let pages = case.store.column_count();
    let (growing, asked, waits) = sought(case, Memory::Growing(Part::new(case.store.clone())));
    assert_eq!((growing, asked), (found, questions));
    assert!((1..=pages).contains(&waits), "{waits} waits for {pages} pages");
    // Pages are loaded again, but no question is asked again.
    let (bounded, asked, waits) = sought(case, Memory::Bounded(Vec::new()));
    assert_eq!((bounded, asked), (found, questions));
    assert!(waits >= 1 && waits <= 8 * questions + pages, "{waits} waits, {questions} questions");
    found
}

/// How the pages of a search are loaded.
enum Memory {
    All,
    /// Those that were needed stay in memory.
    Growing(Part),
    /// Only those that were needed last.
    Bounded(Vec<PageKey>),
}

/// The most pages in memory if it is bounded.
const FEW: usize = 9;

/// Returns the result, the number of questions, and how often pages were missing.
fn sought(case: &Case, mut memory: Memory) -> (Option<Obstruction>, usize, usize) {
    let [from, to] = case.ends;
    let search = ObstructionSearch::new(&case.store, case.pawn, from, to, &NoMonitor).unwrap();
    let (mut search, mut questions, mut waits) = (search.drawn_out(case.length), 0, 0);
    loop {
        let set = match &memory {
            Memory::All => case.store.clone(),
            Memory::Growing(part) => (**part).clone(),
            Memory::Bounded(keys) => case.store.keep_loaded(|key| keys.contains(&key)),
        };
        match search.advance(&set).unwrap() {
            Sought::Done(found) => return (found, questions, waits),
            Sought::NotLoaded(missing) => {
                waits += 1;
                match &mut memory {
                    Memory::All => panic!("{missing:?}"),
                    Memory::Growing(part) => assert!(part.load(missing.keys()) > 0),
                    Memory::Bounded(keys) => {
                        keys.extend(missing.keys());
                        keys.drain(..keys.len().saturating_sub(FEW));
                    }
                }
            }
            _ => questions += 1,
        }
    }
}

#[test]
fn a_wall_is_met_on_the_straight_line() {
    for over in [Over::Wall, Over::Nothing] {
        let store = scene(HALL, |i, _| if (MIDDLE..MIDDLE + 15).contains(&i) { over } else { Over::Floor(0.0) });
        let ends = [at([20, 65], 0.0), at([150, 65], 0.0)];
        let pawn = Pawn::new(BODY);
        let found = sought(&Case { store, pawn, length: None, ends, expected: None }, Memory::All).0.unwrap();
        assert!((found.at.y - ends[0].y).abs() < T && (found.at.x - MIDDLE as f64 * T).abs() < 0.5, "{found:?}");
        assert_eq!(found.reason, if matches!(over, Over::Wall) { Reason::Gap } else { Reason::Unseen });
    }
}

/// Asks to stop at its `n`th look, and not again.
struct StopsAt(AtomicUsize);

impl Monitor for StopsAt {
    fn cancelled(&self) -> bool {
        self.0.fetch_sub(1, Ordering::Relaxed) == 1
    }
}

#[test]
fn a_search_stops_when_it_is_asked_to_and_can_begin_anew() {
    let store =
        scene([400, 300], |i, j| if i == 200 && !(150..154).contains(&j) { Over::Wall } else { Over::Floor(0.0) });
    let pawn = Pawn::new(BODY);
    let [from, to] = [at([20, 150], 0.0), at([380, 150], 0.0)];
    let finish = |search: &mut ObstructionSearch| loop {
        match search.advance(&store) {
            Ok(Sought::Done(found)) => return Ok(found.map(|found| found.reason)),
            Ok(Sought::NotLoaded(missing)) => panic!("{missing:?}"),
            Ok(_) => {}
            Err(error) => return Err(error),
        }
    };
    let mut stopped = 0;
    for look in [1, 2, 5, 12, 30] {
        let monitor = StopsAt(AtomicUsize::new(look));
        let mut search = ObstructionSearch::new(&store, pawn, from, to, &monitor).unwrap();
        match finish(&mut search) {
            Err(Error::Interrupted) => stopped += 1,
            other => panic!("look {look}: {other:?}"),
        }
        assert_eq!(finish(&mut search).unwrap(), Some(Reason::Width));
    }
    assert_eq!(stopped, 5);
    let text = format!("{:?}", ObstructionSearch::new(&store, pawn, from, to, &NoMonitor).unwrap());
    assert!(text.starts_with("ObstructionSearch { pawn: "), "{text}");
    let wrong = Pawn { climb: 3.0, ..pawn };
    assert!(matches!(ObstructionSearch::new(&store, wrong, from, to, &NoMonitor), Err(Error::Parameter { .. })));
    // The round pawn gets through, so its length counts.
    let disc = Pawn::new(Body::Cylinder { radius: 0.15, height: 1.8 });
    let mut search = ObstructionSearch::new(&store, disc, from, to, &NoMonitor).unwrap().drawn_out(Some(0.2));
    assert!(matches!(finish(&mut search), Err(Error::Parameter { .. })));
}
