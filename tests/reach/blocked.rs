//! Obstructions of pawns, in scenes with known obstructions, with all pages in memory and with few.

use super::flat::{Columns, layers};
use crate::common::part::Part;
use nalgebra::Point3;
use slicewalk::frame::{Frame, PageKey, SLICE_QUANTA};
use slicewalk::reach::{Obstruction, ObstructionSearch, Pawn, Reason, Sought};
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
    expected: Option<(Reason, f64, f64)>,
}

fn cases() -> Vec<Case> {
    let body = Body::Box { x: 0.5, y: 0.5, height: 1.8 };
    let across = |z: f64| [at([20, 45], 0.0), at([150, 45], z)];
    let case = |store: Snapshot, z: f64, reason: Reason, needs: f64, within: f64| Case {
        pawn: Pawn::new(body),
        length: None,
        ends: across(z),
        expected: Some((reason, needs, within)),
        store,
    };
    let door = |from: i64, to: i64, over: Over| move |j: i64| (from..to).contains(&j).then_some(over);
    let plain = Over::Floor(0.0);
    let ramp = |i: i64| Over::Floor((i as f64 * T - 6.0).clamp(0.0, 5.0) * 0.09);
    let long_ramp = |i: i64| Over::Floor((i as f64 * T - 4.0).clamp(0.0, 8.0) * 0.055);
    let disc = Pawn::new(Body::Cylinder { radius: 0.25, height: 1.8 });
    let pit = |below: Over| scene(HALL, move |i, _| if (MIDDLE..MIDDLE + 15).contains(&i) { below } else { plain });
    let bend = scene([60, 60], |i, j| if i < 11 || j < 11 { plain } else { Over::Wall });
    let cylinder = Body::Cylinder { radius: 0.4, height: 1.4 };
    vec![
        case(hall(door(30, 33, plain)), 0.0, Reason::Width, 0.3, 0.05),
        case(hall(door(30, 42, Over::Beam(1.5))), 0.0, Reason::Headroom, 1.5, 0.03),
        // The beam is the smaller change.
        case(hall(|j| door(30, 33, plain)(j).or(door(60, 72, Over::Beam(1.7))(j))), 0.0, Reason::Headroom, 1.7, 0.03),
        case(hall(door(30, 33, Over::Beam(1.3))), 0.0, Reason::Width, 0.3, 0.05),
        case(scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { 0.6 })), 0.6, Reason::Step, 0.6, 0.02),
        Case {
            pawn: Pawn { max_grade: 0.06, ..Pawn::new(body) },
            ..case(scene(HALL, |i, _| ramp(i)), 0.45, Reason::Slope, 0.09, 0.004)
        },
        // It starts on ground that is too steep.
        Case {
            pawn: Pawn { max_grade: 0.06, ..Pawn::new(body) },
            ends: [at([MIDDLE, 45], 0.225), at([150, 45], 0.45)],
            ..case(scene(HALL, |i, _| ramp(i)), 0.45, Reason::Slope, 0.09, 0.004)
        },
        // A pawn that climbs higher takes no deeper drops, unless it takes drops as deep as its steps.
        Case {
            pawn: Pawn { climb: 0.2, max_drop: 0.2, ..Pawn::new(body) },
            ..case(scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { -0.6 })), -0.6, Reason::Step, 0.6, 0.02)
        },
        Case {
            pawn: Pawn { climb: 0.2, ..Pawn::new(body) },
            ..case(scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { -0.6 })), -0.6, Reason::Gap, 0.6, 0.05)
        },
        case(pit(Over::Floor(-2.0)), 0.0, Reason::Gap, 1.5, 0.4),
        case(pit(Over::Nothing), 0.0, Reason::Unseen, 1.5, 0.4),
        // A wall without a door, and the same with a hole in a corner of the first room. The place is on the way.
        case(hall(|_| None), 0.0, Reason::Gap, 0.6, 0.11),
        case(
            scene(HALL, |i, j| match i {
                MIDDLE => Over::Wall,
                _ if i < 12 && j < 12 => Over::Nothing,
                _ => plain,
            }),
            0.0,
            Reason::Gap,
            0.6,
            0.11,
        ),
        // Another storey is as far as it is high.
        case(scene(HALL, |_, _| Over::Deck(3.4)), 3.4, Reason::Unseen, 3.4, 0.01),
        Case {
            pawn: Pawn { climb: 0.02, max_drop: 0.02, ..Pawn::new(cylinder) },
            length: Some(1.3),
            ends: [at([5, 50], 0.0), at([50, 5], 0.0)],
            ..case(bend, 0.0, Reason::Length, 1.0, 0.2)
        },
        Case { pawn: disc, ..case(hall(door(30, 33, plain)), 0.0, Reason::Width, 0.3, 0.05) },
        Case { pawn: disc, ..case(hall(door(30, 42, Over::Beam(1.5))), 0.0, Reason::Headroom, 1.5, 0.03) },
        // A pawn lower than the least height that is tried for others.
        Case {
            pawn: Pawn { climb: 0.02, max_drop: 0.02, ..Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 0.1 }) },
            ..case(hall(door(30, 42, Over::Beam(0.085))), 0.0, Reason::Headroom, 0.08, 0.011)
        },
        // A door of half a metre for the longer of its sides.
        Case {
            pawn: Pawn::new(Body::Box { x: 0.4, y: 0.8, height: 1.8 }),
            ..case(hall(door(30, 35, plain)), 0.0, Reason::Width, 0.25, 0.03)
        },
        Case {
            pawn: Pawn { climb: 0.2, ..Pawn::new(body) },
            ..case(scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { 0.6 })), 0.6, Reason::Step, 0.6, 0.02)
        },
        Case {
            pawn: Pawn { max_grade: 0.06, max_ramp: 6.0, ..Pawn::new(body) },
            ..case(scene(HALL, |i, _| long_ramp(i)), 0.44, Reason::Ramp, 8.0, 0.8)
        },
        // It goes down a drop that it does not climb, but no long pawn does, however short it is.
        Case {
            pawn: Pawn { climb: 0.2, max_drop: 0.5, ..Pawn::new(cylinder) },
            length: Some(1.3),
            expected: None,
            ..case(scene(HALL, |i, _| Over::Floor(if i < MIDDLE { 0.0 } else { -0.4 })), -0.4, Reason::Length, 0.0, 0.0)
        },
        // It gets there, or cannot stand at the goal.
        Case { expected: None, ..case(hall(door(30, 42, plain)), 0.0, Reason::Width, 0.0, 0.0) },
        Case {
            ends: [at([20, 45], 0.0), at([MIDDLE, 45], 0.0)],
            expected: None,
            ..case(hall(|_| None), 0.0, Reason::Width, 0.0, 0.0)
        },
    ]
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
fn obstructions_are_found_whatever_pages_are_in_memory() {
    for (number, case) in cases().iter().enumerate() {
        let (found, questions, _) = sought(case, Memory::All);
        let near = |(reason, needs, within): (Reason, f64, f64)| {
            found.is_some_and(|found| found.reason == reason && (found.needs - needs).abs() <= within)
        };
        assert!(case.expected.map_or(found.is_none(), near), "case {number}: {found:?}");
        let pages = case.store.column_count();
        let (growing, asked, waits) = sought(case, Memory::Growing(Part::new(case.store.clone())));
        assert_eq!((growing, asked), (found, questions), "case {number}");
        assert!((1..=pages).contains(&waits), "case {number}: {waits} waits for {pages} pages");
        // Pages are loaded again, but no question is asked again.
        let (bounded, asked, waits) = sought(case, Memory::Bounded(Vec::new()));
        assert_eq!((bounded, asked), (found, questions), "case {number}");
        assert!(waits >= 1 && waits <= 8 * questions + pages, "case {number}: {waits} waits, {questions} questions");
    }
}

#[test]
fn a_wall_is_met_on_the_straight_line() {
    for over in [Over::Wall, Over::Nothing] {
        let store = scene(HALL, |i, _| if (MIDDLE..MIDDLE + 15).contains(&i) { over } else { Over::Floor(0.0) });
        let ends = [at([20, 65], 0.0), at([150, 65], 0.0)];
        let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
        let found = sought(&Case { store, pawn, length: None, ends, expected: None }, Memory::All).0.unwrap();
        assert!((found.at.y - ends[0].y).abs() < T && (found.at.x - MIDDLE as f64 * T).abs() < 0.5, "{found:?}");
        assert_eq!(found.reason, if matches!(over, Over::Wall) { Reason::Gap } else { Reason::Unseen });
    }
}

#[test]
fn a_pawn_changed_by_what_is_needed_gets_there() {
    for (number, case) in cases().into_iter().enumerate() {
        let Some(found) = sought(&case, Memory::All).0 else { continue };
        let (x, needs) = (2.0 * case.pawn.body.half().x, found.needs);
        let pawn = match (found.reason, case.pawn.body) {
            (Reason::Width, Body::Box { height, .. }) => {
                // Too narrow a door that is also too low.
                let height = if number == 3 { 1.2 } else { height };
                let side = |half: f64| needs * half / case.pawn.body.half().min();
                let [x, y] = [case.pawn.body.half().x, case.pawn.body.half().y].map(side);
                Pawn { body: Body::Box { x, y, height }, ..case.pawn }
            }
            (Reason::Width, Body::Cylinder { height, .. }) => {
                Pawn { body: Body::Cylinder { radius: needs / 2.0, height }, ..case.pawn }
            }
            (Reason::Headroom, Body::Cylinder { radius, .. }) => {
                Pawn { body: Body::Cylinder { radius, height: needs }, ..case.pawn }
            }
            (Reason::Headroom, _) => Pawn { body: Body::Box { x, y: x, height: needs }, ..case.pawn },
            (Reason::Step, _) if case.pawn.max_drop == case.pawn.climb => {
                Pawn { climb: needs, max_drop: needs, ..case.pawn }
            }
            (Reason::Step, _) => Pawn { climb: needs, ..case.pawn },
            (Reason::Ramp, _) => Pawn { max_ramp: needs, ..case.pawn },
            (Reason::Slope, _) => Pawn { max_grade: needs, ..case.pawn },
            (Reason::Length, _) => case.pawn,
            _ => continue,
        };
        let length = case.length.map(|_| needs);
        assert_eq!(sought(&Case { pawn, length, ..case }, Memory::All).0, None, "case {number}: {found:?}");
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
    let pawn = Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 });
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
