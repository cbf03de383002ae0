//! Routes on overview levels, compared with exact ones.

use super::flat::{self, Columns};
use super::{everywhere, known, reached, spot, way};
use crate::common::part::Part;
use crate::common::random::Random;
use crate::common::{Pages, archive_with_levels, key, page, plan};
use nalgebra::{Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, Totals};
use slicewalk::frame::{Frame, PAGE_QUANTA};
use slicewalk::page::Span;
use slicewalk::plan::Plan;
use slicewalk::reach::{Coarse, Flood, Pawn, Planned, Refusal, Route, Search};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;

/// Pixel size, height of the lowest floor and of the ceiling (m).
const T: f64 = 0.05;
const FLOOR: f64 = 1.0;
const CEILING: f64 = 3.7;
/// Pixels along a side of the building, and of one room.
const SIDE: usize = 256;
const ROOM: usize = 64;

/// Solid in a pixel from one height to another (m), and whether it is an obstacle.
type Matter = (f64, f64, bool);

/// An archive with levels, in one layer; `draw` returns the content of each pixel.
fn archive(draw: impl Fn(usize, usize) -> Vec<Matter>) -> Archive {
    let frame = Frame::new(T, 3.0 * T).unwrap();
    let quanta = |height: f64| (height / frame.quantum_m()).round() as u32;
    let mut pages = Pages::new();
    for (tx, ty) in (0..SIDE / 64).flat_map(|tx| (0..SIDE / 64).map(move |ty| (tx, ty))) {
        let pixels = (0..64 * 64).map(|cell| (cell % 64, cell / 64));
        let columns = pixels.map(|(x, y)| {
            let spans = draw(64 * tx + x, 64 * ty + y).into_iter();
            let spans = spans.map(|(low, high, obstacle)| Span::new(quanta(low), quanta(high), obstacle).unwrap());
            ((x as u32, y as u32), spans.collect())
        });
        pages.insert(key(tx as i32, ty as i32, 0), page(columns));
    }
    let plan = Plan { frame, ..plan() };
    Archive::from_bytes(archive_with_levels(&plan, &(pages, Totals::default()), None)).unwrap()
}

/// Rooms with floors at different heights, doors of different widths under lintels, and tables.
fn rooms(seed: u64) -> Archive {
    let mut random = Random(seed);
    let count = SIDE / ROOM;
    let floors: Vec<f64> = (0..count * count).map(|_| FLOOR + 0.17 * random.below(3usize) as f64).collect();
    // Doors of each room to the right and upwards: start and end (pixels), and height (m).
    let mut door = || (random.below(40usize), 12 + random.below(14usize), 2.1 + 0.1 * random.below(3usize) as f64);
    let doors: Vec<_> = (0..count * count).map(|_| [door(), door()]).collect();
    let tables: Vec<_> = (0..count * count).map(|_| [12 + random.below(20usize), 12 + random.below(20usize)]).collect();
    archive(move |i, j| {
        let room = j / ROOM * count + i / ROOM;
        let (x, y, floor) = (i % ROOM, j % ROOM, floors[room]);
        let wall = (i == 0 || j == 0 || x + 2 >= ROOM || y + 2 >= ROOM).then(|| {
            let [right, up] = doors[room];
            let is_outer = i == 0 || j == 0 || i + 2 >= SIDE || j + 2 >= SIDE;
            let through = |at: usize, (from, width, height): (usize, usize, f64)| {
                (from..from + width).contains(&at).then_some(height)
            };
            if is_outer {
                None
            } else if x + 2 >= ROOM {
                through(y, right)
            } else {
                through(x, up)
            }
        });
        match wall {
            Some(None) => vec![(floor - 0.2, CEILING, true)],
            Some(Some(height)) => vec![(floor - 0.02, floor, false), (floor + height, CEILING, true)],
            None => {
                let is_table =
                    (tables[room][0]..).take(16).any(|at| at == x) && (tables[room][1]..).take(24).any(|at| at == y);
                let mut all = vec![(floor - 0.02, floor, false)];
                if is_table {
                    all.push((floor + 0.72, floor + 0.75, false));
                }
                all.push((CEILING - 0.02, CEILING, true));
                all
            }
        }
    })
}

fn pawn() -> Pawn {
    Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.7 })
}

fn finish(planner: &mut Coarse, set: &Snapshot, steps: usize) -> Result<Route, Refusal> {
    loop {
        match planner.advance(set, steps, &NoMonitor).unwrap() {
            Planned::Done(found) => return found,
            Planned::NotLoaded(missing) => panic!("{missing:?}"),
            _ => {}
        }
    }
}

fn level(archive: &Archive, number: u32) -> Snapshot {
    Snapshot::resident(&archive.level(number).unwrap(), &NoMonitor).unwrap()
}

#[test]
#[ignore = "slow: .ci/run"]
fn a_fine_level_has_a_way_wherever_an_exact_one_leads_and_mostly_along_it() {
    let (mut connected, mut held, mut refused, mut lengths) = (0, 0, 0, [0.0; 2]);
    for seed in 0..6 {
        let archive = rooms(seed);
        let (store, level) = (Snapshot::resident(&archive, &NoMonitor).unwrap(), level(&archive, 1));
        let (mut standing, region) = everywhere(&store, pawn());
        // On floors, not on tables or walls.
        let feet = region.places().map(|place| place.feet);
        let places: Vec<Point3<f64>> = feet.filter(|feet| feet.z < FLOOR + 0.5).collect();
        let mut random = Random(seed + 100);
        for _ in 0..6 {
            let from = places[random.below(places.len())];
            let (_, own) = reached(&store, pawn(), from.into());
            for _ in 0..6 {
                let to = places[random.below(places.len())];
                let ends = [from, to].map(|at| spot(&mut standing, &store, at).unwrap());
                let exact = way(&mut Search::new(), &store, &own, &ends[0], &ends[1]);
                let mut planner = Coarse::new(&level, pawn(), from, to).unwrap();
                assert!(planner.is_fine());
                let found = finish(&mut planner, &level, usize::MAX);
                let Some(exact) = exact else {
                    refused += usize::from(found.is_err());
                    continue;
                };
                let found = found.unwrap_or_else(|refusal| panic!("{seed}: {from} to {to}: {refusal:?}"));
                connected += 1;
                assert!((found.points[0] - from).xy().norm() < 1e-9);
                assert!((found.points[found.points.len() - 1] - to).xy().norm() < 1e-9);
                // A detour may avoid doubt.
                lengths = [lengths[0] + found.length_m, lengths[1] + exact.length_m];
                let line: Vec<_> = found.points.iter().map(|point| point.xy()).collect();
                let mut flood = Flood::from(ends[0]);
                flood.along(&line, 3.0 * level.frame().pixel_m());
                known(flood.grow(&mut standing, &store, &NoMonitor).unwrap());
                held += usize::from(flood.region(&standing).holds(&ends[1]));
            }
        }
    }
    eprintln!("{held} of {connected} coarse ways have an exact one beside them; {refused} refused; {lengths:?} m");
    assert!(connected > 60 && 100 * held >= 80 * connected, "{held} of {connected}");
    assert!(lengths[0] < 1.3 * lengths[1], "{lengths:?} m");
}

#[test]
fn a_way_without_doubt_and_none_through_a_wall() {
    let hall = |wall: Option<usize>| {
        archive(move |i, _| match wall {
            Some(at) if (at..at + 2).contains(&i) => vec![(FLOOR, CEILING, true)],
            _ => vec![(FLOOR - 0.02, FLOOR, false), (CEILING - 0.02, CEILING, true)],
        })
    };
    let [from, to] = [[1.0, 1.0, FLOOR], [11.0, 9.0, FLOOR]].map(Point3::from);
    let open = level(&hall(None), 1);
    let mut planner = Coarse::new(&open, pawn(), from, to).unwrap();
    let found = finish(&mut planner, &open, 10).unwrap();
    assert!((found.length_m - (to - from).norm()).abs() < 0.05, "{found:?}");
    assert_eq!((planner.doubt_m(), found.points.len()), (0.0, 2));
    assert!(planner.memory_bytes() > 0 && planner.looked_at() > 0);
    // A corridor around another route.
    let guide = Route::clone(&found);
    let mut near = Coarse::new(&open, pawn(), from, to).unwrap().near(&guide, 0.5);
    assert_eq!(finish(&mut near, &open, usize::MAX).map(|route| route.length_m), Ok(found.length_m));
    assert!(near.memory_bytes() > 0);
    let closed = level(&hall(Some(100)), 1);
    let mut planner = Coarse::new(&closed, pawn(), from, to).unwrap();
    assert_eq!(finish(&mut planner, &closed, usize::MAX), Err(Refusal::NotConnected));
    // Far off, beside the floor, and at the end of the tile around it.
    for outside in [-50.0, -2.0, -12.7].map(|x| Point3::new(x, 1.0, FLOOR)) {
        for (ends, refusal) in [([outside, to], Refusal::NotStandingFrom), ([from, outside], Refusal::NotStandingTo)] {
            let mut planner = Coarse::new(&open, pawn(), ends[0], ends[1]).unwrap();
            assert_eq!(finish(&mut planner, &open, usize::MAX), Err(refusal), "{outside}");
        }
    }
    // Both ends in one pixel of the level.
    let beside = from + Vector3::new(0.05, 0.0, 0.0);
    let mut planner = Coarse::new(&open, pawn(), from, beside).unwrap();
    let found = finish(&mut planner, &open, usize::MAX).unwrap();
    assert!(found.points.len() == 2 && (found.length_m - 0.05).abs() < 1e-9, "{found:?}");
    assert!(planner.doubt_m() == 0.0 && planner.doubt_m().is_sign_positive());
    // If pixels are wider than the pawn, a route may pass any wall: it is found, and reports its doubt.
    let thin = Pawn::new(Body::Box { x: 0.2, y: 0.2, height: 1.7 });
    let mut planner = Coarse::new(&closed, thin, from, to).unwrap();
    let found = finish(&mut planner, &closed, usize::MAX);
    assert!(!planner.is_fine() && found.is_ok() && planner.doubt_m() > 1.0, "{found:?}, {}", planner.doubt_m());
}

/// Plans on the archive itself as if it were a level: heights that are multiples of 0.05 m look rounded.
fn planned(draw: impl Fn(usize, usize) -> Vec<Matter>, pawn: Pawn, ends: [[f64; 3]; 2]) -> (Route, f64) {
    let store = Snapshot::resident(&archive(draw), &NoMonitor).unwrap();
    let [from, to] = ends.map(Point3::from);
    let mut planner = Coarse::new(&store, pawn, from, to).unwrap();
    assert!(planner.is_fine());
    let found = finish(&mut planner, &store, usize::MAX).unwrap();
    (found, planner.doubt_m())
}

/// A floor that only the climb height, a beam that only the height of the body, and nothing: where a route leads round is as
/// far as the doubt of the way through is worth.
#[test]
fn a_metre_of_doubt_is_worth_a_detour_of_forty_metres() {
    let [wall, wide, metre] = [126, 2, 20];
    let ends = [[1.0, 1.0, FLOOR], [11.9, 1.0, FLOOR]];
    // A barrier across the hall that ends `beyond` metres from the straight way.
    let hall = |beyond: f64, barrier: Vec<Matter>| {
        let gap = metre + (beyond * metre as f64) as usize;
        let open = vec![(FLOOR - 0.05, FLOOR, false), (CEILING - 0.05, CEILING, true)];
        move |i: usize, j: usize| {
            if (wall..wall + wide).contains(&i) && j < gap { barrier.clone() } else { open.clone() }
        }
    };
    let step = |rise: f64| vec![(FLOOR - 0.05, FLOOR + rise, false), (CEILING - 0.05, CEILING, true)];
    let beam = |room: f64| vec![(FLOOR - 0.05, FLOOR, false), (FLOOR + room, CEILING, true)];
    let tall = |height: f64| Pawn::new(Body::Box { x: 0.5, y: 0.5, height });
    // Beyond the climb height up, and down; headroom lacks in each of the two pixels.
    let up = Pawn { climb: 0.3, max_drop: 0.5, ..pawn() };
    let down = Pawn { climb: 0.5, max_drop: 0.3, ..pawn() };
    for (name, pawn, barrier, doubt) in [
        ("nothing", up, step(0.0), 0.0),
        ("a step within reach", up, step(0.3), 0.0),
        ("a step up", up, step(0.36), 0.06),
        ("a step up and down", Pawn { max_drop: 0.3, ..up }, step(0.34), 0.08),
        ("a drop", down, step(0.38), 0.08),
        ("headroom", tall(1.7), beam(1.7), 0.0),
        ("a low beam", tall(1.68), beam(1.65), 0.06),
        ("a lower beam", tall(1.7), beam(1.65), 0.1),
    ] {
        // Diagonal steps are √2 as long: a way around at a distance is 2 (√2 − 1) times that longer.
        let worth = 40.0 * doubt / (2.0 * (2f64.sqrt() - 1.0));
        for beyond in [worth - 0.5, worth + 0.5].into_iter().filter(|beyond| *beyond > 0.0) {
            let (found, found_doubt) = planned(hall(beyond, barrier.clone()), pawn, ends);
            let aside = found.points.iter().map(|point| point.y - 1.0).fold(0.0, f64::max);
            let (is_around, expected) = if beyond < worth { (true, 0.0) } else { (false, doubt) };
            assert!((found_doubt - expected).abs() < 2e-3, "{name}, {beyond} m: a doubt of {found_doubt} m");
            assert_eq!(aside > beyond - 0.1 && beyond > 0.2, is_around, "{name}, {beyond} m: {aside} m aside");
        }
    }
    // Rounding explains no more than twice the climb height, and two units of headroom.
    for barrier in [step(0.72), beam(1.55)] {
        let (found, doubt) = planned(hall(9.0, barrier), up, ends);
        assert!(doubt == 0.0 && found.length_m > 16.0, "{} m, a doubt of {doubt} m", found.length_m);
    }
}

#[test]
fn a_way_over_a_level_of_wide_pixels_leads_through_the_gap() {
    let gap = |i: usize, j: usize| match (i, j) {
        (100..104, ..180 | 200..) => vec![(FLOOR, CEILING, true)],
        _ => vec![(FLOOR - 0.02, FLOOR, false), (CEILING - 0.02, CEILING, true)],
    };
    let level = level(&archive(gap), 1);
    let thin = Pawn::new(Body::Box { x: 0.2, y: 0.2, height: 1.7 });
    let [from, to] = [[1.0, 1.0, FLOOR], [11.0, 2.0, FLOOR]].map(Point3::from);
    let mut planner = Coarse::new(&level, thin, from, to).unwrap();
    let found = finish(&mut planner, &level, usize::MAX).unwrap();
    assert!(!planner.is_fine() && planner.doubt_m() == 0.0, "{}", planner.doubt_m());
    let crossing = found.points.windows(2).find(|pair| pair[0].x <= 5.1 && pair[1].x > 5.1).unwrap();
    let share = (5.1 - crossing[0].x) / (crossing[1].x - crossing[0].x);
    let y = crossing[0].y + share * (crossing[1].y - crossing[0].y);
    assert!((9.0..10.0).contains(&y), "{found:?}");
    // A wider pawn needs the gap; the straight line has no such gap.
    let found = finish(&mut Coarse::new(&level, pawn(), from, to).unwrap(), &level, usize::MAX).unwrap();
    let mut straight = found.clone();
    straight.points = vec![from, to];
    let mut near = Coarse::new(&level, pawn(), from, to).unwrap().near(&straight, 0.5);
    assert_eq!(finish(&mut near, &level, usize::MAX), Err(Refusal::NotConnected), "{found:?}");
}

#[test]
fn a_coarse_way_names_the_pages_that_it_needs_and_stops_when_it_is_asked_to() {
    struct Stops;
    impl slicewalk::Monitor for Stops {
        fn cancelled(&self) -> bool {
            true
        }
    }
    // The archive itself used like a level, with more pages.
    let store = Snapshot::resident(&rooms(3), &NoMonitor).unwrap();
    let [from, near, far] = [[1.0, 1.0, FLOOR], [1.2, 3.0, FLOOR], [12.0, 12.0, FLOOR]].map(Point3::from);
    for to in [near, far] {
        let mut partly = Part::new(store.clone());
        let mut planner = Coarse::new(&partly, pawn(), from, to).unwrap();
        let mut loaded = 0;
        let found = loop {
            match planner.advance(&partly, usize::MAX, &NoMonitor).unwrap() {
                Planned::Done(found) => break found,
                Planned::NotLoaded(missing) => loaded += partly.load(missing.keys()),
                _ => {}
            }
        };
        assert!((1..=16).contains(&loaded), "{loaded}");
        let mut whole = Coarse::new(&store, pawn(), from, to).unwrap();
        assert_eq!(found, finish(&mut whole, &store, 100));
        // A span that waits for pages counts once.
        assert_eq!(planner.looked_at(), whole.looked_at());
    }
    let mut planner = Coarse::new(&store, pawn(), from, far).unwrap();
    assert!(matches!(planner.advance(&store, usize::MAX, &Stops), Err(slicewalk::Error::Interrupted)));
}

#[test]
fn a_way_leads_over_gaps_as_wide_as_the_body_and_around_slits_narrower_than_it() {
    let (wall, far) = (126, 100);
    let ends = [[1.0, 1.02, FLOOR], [11.9, 1.02, FLOOR]];
    let open = || vec![(FLOOR - 0.05, FLOOR, false), (CEILING - 0.05, CEILING, true)];
    for (width, is_through) in [(1usize, false), (14, true)] {
        let slit = 20 - width / 2..20 + width.div_ceil(2);
        let (found, doubt) = planned(
            |i, j| match (wall..wall + 2).contains(&i) && j < far && !slit.contains(&j) {
                true => vec![(FLOOR - 0.05, CEILING, true)],
                false => open(),
            },
            pawn(),
            ends,
        );
        let aside = found.points.iter().map(|point| point.y).fold(0.0, f64::max);
        assert_eq!(aside < 2.0, is_through, "{width} pixels: {found:?}");
        assert!(doubt == 0.0 && (is_through || aside >= far as f64 * T), "{width} pixels: {doubt} m, {found:?}");
    }
    // The body is ten pixels wide.
    for (width, is_through) in [(4, true), (14, false)] {
        let hall = archive(|i, _| match (wall..wall + width).contains(&i) {
            true => vec![(CEILING - 0.05, CEILING, true)],
            false => open(),
        });
        let store = Snapshot::resident(&hall, &NoMonitor).unwrap();
        let [from, to] = ends.map(Point3::from);
        let found = finish(&mut Coarse::new(&store, pawn(), from, to).unwrap(), &store, usize::MAX);
        let length = found.map(|route| route.length_m);
        match is_through {
            true => assert!(length.is_ok_and(|length| (length - 10.9).abs() < 0.1), "{width} pixels: {length:?}"),
            false => assert_eq!(length, Err(Refusal::NotConnected), "{width} pixels"),
        }
    }
}

#[test]
fn a_floor_and_a_wall_over_the_border_of_two_pages_are_one() {
    for has_wall in [false, true] {
        let all = (0..64).flat_map(|i| (0..20).map(move |j| (i, j)));
        let columns: Columns = all
            .map(|(i, j)| {
                let (height, is_wall) = if has_wall && i == 30 { (2000, true) } else { (4, false) };
                ((i, j), vec![(PAGE_QUANTA - 3, PAGE_QUANTA + height, is_wall)])
            })
            .collect();
        let store = flat::layers(Frame::new(0.1, 0.3).unwrap(), &columns);
        let floor = 64.0 * 0.3 + 0.01;
        let [from, to] = [[1.05, 1.05, floor], [5.05, 1.05, floor]].map(Point3::from);
        let mut planner = Coarse::new(&store, pawn(), from, to).unwrap();
        let found = finish(&mut planner, &store, usize::MAX);
        match found {
            Ok(route) => {
                assert!(!has_wall && planner.doubt_m() == 0.0 && (route.length_m - 4.0).abs() < 0.05, "{route:?}")
            }
            Err(refusal) => assert!(has_wall && refusal == Refusal::NotConnected, "{refusal:?}"),
        }
    }
}
