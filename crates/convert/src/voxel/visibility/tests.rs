use super::cell::{Cell, EDGE, LEVELS, direction};
use super::view::{CELL_ANGLE, FARTHEST_CM, LEAST_SEEN, NEAREST_M, beyond, margin_m, seen_m};
use super::*;
use crate::voxel::record::Recorder;
use proptest::prelude::*;
use std::collections::HashMap;
use std::sync::atomic::Ordering;

fn frame() -> Frame {
    Frame::new(0.05, 0.15).unwrap()
}

fn stood(at: [f64; 3]) -> Station {
    Station { at, within_m: 0.0 }
}

proptest! {
    #[test]
    fn cells_are_those_of_the_face_that_the_direction_points_to(
        d in [-3i32..=3, -3..=3, -3..=3], more in [-1f64..1.0, -1f64..1.0, -1f64..1.0], scale in prop_oneof![Just(0.0), Just(1e-3), Just(1.0)]
    ) {
        // Includes ties of the coordinates, edges and corners.
        let d: [f64; 3] = std::array::from_fn(|axis| f64::from(d[axis]) + scale * more[axis]);
        prop_assume!(d != [0.0; 3]);
        let size = d.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        // Of axes of equal length, x comes before y, and y before z.
        let axis = d.iter().position(|v| v.abs() == size).unwrap();
        let at = |axis: usize| (((d[axis % 3] / size + 1.0) / 2.0 * EDGE as f64) as i64).min(EDGE as i64 - 1);
        let face = 2 * axis + usize::from(d[axis] < 0.0);
        for level in 0..LEVELS {
            let expected = (face, [at(axis + 1) >> level, at(axis + 2) >> level]);
            prop_assert_eq!(Cell::of(d).parts(level), expected);
            let edge = EDGE >> level;
            let index = (face * edge + expected.1[1] as usize) * edge + expected.1[0] as usize;
            prop_assert_eq!(Cell::of(d).index(level), index);
        }
    }

    #[test]
    fn records_tell_where_their_points_lie(x in -500f64..500.0, y in -500f64..500.0, z in -90f64..90.0) {
        let views = Views::new(&[], frame(), 0).unwrap();
        Recorder::new(frame()).record(&[x], &[y], &[z], |index, record| {
            let place = views.places(index.key()).of(record);
            let (min, max) = views.places(index.key()).bounds();
            assert!((0..3).all(|axis| min[axis] <= place[axis] && place[axis] <= max[axis]));
            let near = (place[0] - x).abs() < 0.0005 && (place[1] - y).abs() < 0.0005 && (place[2] - z).abs() < 0.0001;
            assert!(near, "{place:?}");
        });
    }

    #[test]
    fn a_cell_beyond_an_edge_is_the_neighbour_on_the_next_face(face in 0usize..6, along in 0i64..512, side in 0usize..4) {
        let cell = [[-1, along], [512, along], [along, -1], [along, 512]][side];
        let inside = [[0, along], [511, along], [along, 0], [along, 511]][side];
        let vector = |(face, cell): (usize, [i64; 2])| {
            let d = direction(face, cell, 512);
            let len = d.iter().map(|v| v * v).sum::<f64>().sqrt();
            d.map(|v| v / len)
        };
        let out = Cell::of(direction(face, cell, 512));
        prop_assert_ne!(out.parts(0).0, face);
        let (a, b) = (vector(out.parts(0)), vector((face, inside)));
        let apart = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
        prop_assert!(apart < 3.0 * 2.0 / 512.0, "{}", apart);
    }
}

impl View {
    fn add_point(&self, [x, y, z]: [f64; 3]) {
        self.add([&[x], &[y], &[z]]);
    }
}

/// Least distance in a cell, which may lie beyond the edges of the face (m).
fn distance(view: &View, level: usize, face: usize, cell: [i64; 2]) -> Option<f64> {
    let edge = EDGE >> level;
    let value = if cell.iter().all(|&at| (0..edge as i64).contains(&at)) {
        view.cell(level, face, cell)
    } else {
        let (face, cell) = Cell::of(direction(face, cell, edge)).parts(level);
        view.cell(level, face, cell)
    };
    Some(value.load(Ordering::Relaxed)).filter(|&value| value != 0).map(seen_m)
}

impl Views {
    /// Returns whether a point (m) counts as moving, by the definition.
    fn is_moving(&self, point: [f64; 3]) -> bool {
        let said = |what: Visibility| self.views.iter().filter(|view| says_by_definition(view, point) == what).count();
        said(Visibility::Through) > 0 && said(Visibility::Through) >= said(Visibility::Hit)
    }
}

/// Observation of a station by the definition, distance by distance.
fn says_by_definition(view: &View, point: [f64; 3]) -> Visibility {
    let (distance_m, cell) = view.station.look(point);
    let margin = margin_m(distance_m);
    if distance_m < NEAREST_M || distance_m + margin >= f64::from(FARTHEST_CM) * 0.01 {
        return Visibility::Nothing;
    }
    let of = |seen: f64| {
        if seen > distance_m + margin {
            Visibility::Through
        } else if seen + margin + 0.01 >= distance_m {
            Visibility::Hit
        } else {
            Visibility::Nothing
        }
    };
    for level in view.station.first_level()..LEVELS {
        let least_m = view.station.within_m * (EDGE >> level) as f64 / CELL_ANGLE;
        if distance_m < least_m {
            continue;
        }
        let (face, [x, y]) = cell.parts(level);
        let Some(seen) = distance(view, level, face, [x, y]) else { continue };
        if of(seen) != Visibility::Through {
            return of(seen);
        }
        let near = (0..9).filter(|&step| step != 4).map(|step| [x + step % 3 - 1, y + step / 3 - 1]);
        let seen: Vec<f64> = near.filter_map(|cell| distance(view, level, face, cell)).collect();
        if let Some(&seen) = seen.iter().find(|&&seen| of(seen) != Visibility::Through) {
            return of(seen);
        }
        if seen.len() + 1 >= LEAST_SEEN {
            return Visibility::Through;
        }
    }
    Visibility::Nothing
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn stations_say_what_the_definition_says(seed: u64, spread in 0.01f64..0.5, within_m in prop_oneof![Just(0.0), 0.01f64..0.1]) {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut place = |r: f64| -> [f64; 3] {
            // Includes the corners and edges of the faces.
            let d = [1.0, 1.0, -1.0].map(|at| at + spread * (2.0 * uniform() - 1.0));
            d.map(|v| v * r * (0.2 + uniform()))
        };
        let view = View::new(Station { at: [0.0; 3], within_m });
        (0..30_000).for_each(|_| view.add_point(place(6.0)));
        view.make_coarser();
        let mut counts = [0; 3];
        for _ in 0..3_000 {
            let point = place(5.0);
            let (distance, cell) = view.station.look(point);
            let says = view.says(distance, cell);
            prop_assert_eq!(says, says_by_definition(&view, point));
            let may = view.may_see_through(distance, cell);
            prop_assert!(says != Visibility::Through || may);
            prop_assert!(!may || view.reaches(point, point));
            prop_assert!(!may || within_m == 0.0 || view.may_see_through_some(point, point));
            let mut counted = [Counts::default()];
            view.count([&[point[0]], &[point[1]], &[point[2]]], &mut counted);
            let expected = [Visibility::Through, Visibility::Hit].map(|own| u32::from(may && says == own));
            prop_assert_eq!([counted[0].through, counted[0].hit], expected);
            counts[says as usize] += 1;
        }
        prop_assert!(counts[0] > 20 && counts[2] > 20 || within_m > 0.0, "{counts:?}");
    }

    #[test]
    fn values_beyond_a_distance_are_those_that_tell_of_more(distance_m in 0.0f64..655.3) {
        let most = beyond(distance_m);
        prop_assert!(most > 0 && seen_m(most) > distance_m);
        prop_assert!(most > FARTHEST_CM || seen_m(most + 1) <= distance_m);
    }
}

/// Points of a floor at z = 0, a wall at x = 8 and anything in front of them, seen from a station at steps of a quarter
/// of a degree.
fn see(views: &Views, station: usize, from: [f64; 3], in_front: impl Fn([f64; 3]) -> Option<f64>) -> Vec<[f64; 3]> {
    see_at(views, station, (from, 4), in_front)
}

/// Like [`see`], but with the given number of steps per degree.
fn see_at(
    views: &Views,
    station: usize,
    (from, steps): ([f64; 3], i32),
    in_front: impl Fn([f64; 3]) -> Option<f64>,
) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for turn in 0..360 * steps {
        for rise in -85 * steps..85 * steps {
            let [a, b] = [turn, rise].map(|at| (f64::from(at) / f64::from(steps)).to_radians());
            let d = [b.cos() * a.cos(), b.cos() * a.sin(), b.sin()];
            let floor = if d[2] < 0.0 { -from[2] / d[2] } else { f64::INFINITY };
            let wall = if d[0] > 0.0 { (8.0 - from[0]) / d[0] } else { f64::INFINITY };
            let t = floor.min(wall).min(in_front(d).unwrap_or(f64::INFINITY));
            if t < 60.0 {
                let point = [0, 1, 2].map(|axis| from[axis] + t * d[axis]);
                views.views[station].add_point(point);
                points.push(point);
            }
        }
    }
    points
}

#[test]
fn what_stood_there_for_one_station_only_is_moving_and_floors_and_walls_are_not() {
    let (one, two) = ([0.0, 0.0, 1.6], [3.0, 5.0, 1.6]);
    let views = Views::new(&[one, two].map(stood), frame(), u64::MAX).unwrap();
    // A person, modelled as a screen 1.7 m high, 4 m in front of the first station.
    let person = |d: [f64; 3]| {
        let t = 4.0 / d[0];
        let within = d[0] > 0.0 && (t * d[1]).abs() < 0.25 && (-1.6..0.1).contains(&(t * d[2]));
        within.then_some(t)
    };
    let of_one = see(&views, 0, one, person);
    let of_two = see(&views, 1, two, |_| None);
    views.finish();
    let on_person = |p: &&[f64; 3]| (p[0] - 4.0).abs() < 1e-9 && p[1].abs() < 0.25 && p[2] > 0.001 && p[2] < 1.7;
    let person: Vec<_> = of_one.iter().filter(on_person).collect();
    let gone = person.iter().filter(|p| views.is_moving(***p)).count();
    assert!(person.len() > 500 && gone as f64 > 0.95 * person.len() as f64, "{gone} of {}", person.len());
    let others: Vec<_> = of_one.iter().filter(|p| !on_person(p)).chain(&of_two).collect();
    let lost = others.iter().filter(|p| views.is_moving(***p)).count();
    assert!(lost * 100_000 <= others.len(), "{lost} of {}", others.len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]
    #[test]
    fn records_are_judged_as_the_definition_says(seed: u64, within_m in prop_oneof![Just(0.0), 0.03f64..0.1], pieces in 1usize..5000) {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let stations: Vec<Station> = (0..6)
            .map(|n| Station { at: [0.3 * f64::from(n), 5.0 * uniform(), 1.6], within_m: if n == 5 { 0.0 } else { within_m } })
            .collect();
        let views = Views::new(&stations, frame(), u64::MAX).unwrap();
        let mut points = Vec::new();
        for (number, station) in stations.iter().enumerate() {
            // A person, who stands at another place for each station.
            let [x, y] = [4.0 + uniform(), station.at[1] + uniform()];
            points.extend(see_at(&views, number, (station.at, 1), |d| {
                let t = (x - station.at[0]) / d[0];
                let within = d[0] > 0.0 && (station.at[1] + t * d[1] - y).abs() < 0.3 && (-1.6..0.2).contains(&(t * d[2]));
                (within && number < 2).then_some(t)
            }));
        }
        views.finish();
        let mut columns: HashMap<ColumnKey, Vec<Record>> = HashMap::new();
        for [x, y, z] in points.into_iter().filter(|_| uniform() < 0.2) {
            Recorder::new(frame()).record(&[x], &[y], &[z], |index, record| columns.entry(index.key()).or_default().push(record));
        }
        let mut counts = [0; 2];
        for (key, records) in columns {
            let places = views.places(key);
            for records in records.chunks(pieces) {
                let found = views.are_moving(places, records);
                for (record, found) in records.iter().zip(found) {
                    prop_assert_eq!(found, views.is_moving(places.of(*record)));
                    counts[usize::from(found)] += 1;
                }
            }
        }
        // In 150 cases, 44 to 96 points were moving.
        prop_assert!(counts[0] > 1000 && counts[1] > 20, "{counts:?}");
    }

    #[test]
    fn boxes_that_are_not_asked_hold_nothing_that_was_seen_through(seed: u64, within_m in 0.03f64..0.1) {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let view = View::new(Station { at: [0.1, 0.2, 0.3], within_m });
        let mut place = |r: f64| -> [f64; 3] { [0; 3].map(|_| r * (2.0 * uniform() - 1.0)) };
        (0..4000).for_each(|_| view.add_point(place(12.0)));
        view.make_coarser();
        let mut counts = [0; 2];
        for _ in 0..4000 {
            let (corner, size) = (place(11.0), place(0.3).map(f64::abs));
            let max = std::array::from_fn(|axis| corner[axis] + size[axis]);
            let may = view.may_see_through_some(corner, max);
            counts[usize::from(may)] += 1;
            for _ in 0..20 {
                let at = place(0.5);
                let point = std::array::from_fn(|axis| {
                    // Includes corners and faces.
                    let share = (1.2 * (at[axis] + 0.5) - 0.1).clamp(0.0, 1.0);
                    (corner[axis] + share * size[axis]).min(max[axis])
                });
                let (distance, cell) = view.station.look(point);
                prop_assert!(may || !view.may_see_through(distance, cell));
            }
        }
        prop_assert!(counts.iter().all(|count| *count > 100), "{counts:?}");
    }
}

#[test]
fn many_stations_are_asked_only_about_what_lies_within_what_they_saw() {
    let near = View::new(stood([0.0; 3]));
    assert!(!near.reaches([-1.0; 3], [1.0; 3]), "it saw nothing");
    near.add_point([3.0, 0.0, 0.0]);
    near.add_point([0.0, 8.0, 0.0]);
    near.make_coarser();
    assert!(near.reaches([-1.0; 3], [1.0; 3]) && near.reaches([7.0, -1.0, -1.0], [9.0, 1.0, 1.0]));
    assert!(near.reaches([-50.0, -50.0, -7.5], [50.0, 50.0, -7.0]), "in another direction it may have, too");
    assert!(!near.reaches([8.0, -50.0, -50.0], [9.0, 50.0, 50.0]));
    assert!(!near.reaches([5.0, 5.0, 5.0], [6.0, 6.0, 6.0]));
}

#[test]
fn one_station_alone_takes_nothing_for_moving_and_memory_is_limited() {
    let views = Views::new(&[stood([0.0, 0.0, 1.6])], frame(), stood([0.0; 3]).bytes()).unwrap();
    let points = see(&views, 0, [0.0, 0.0, 1.6], |d| (d[0] > 0.9).then_some(2.0));
    views.finish();
    assert_eq!(points.iter().filter(|p| views.is_moving(**p)).count(), 0);
    let refused = Views::new(&[stood([0.0; 3]); 2], frame(), stood([0.0; 3]).bytes()).unwrap_err();
    assert_eq!(refused.suggestion(), Some(&Parameter::Memory));
}

#[test]
fn a_way_of_some_metres_fits_the_least_memory() {
    let stations = vec![Station { at: [0.0; 3], within_m: 0.1 }; 266];
    assert!(Views::new(&stations, frame(), 16 << 20).is_ok());
}
