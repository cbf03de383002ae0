//! The nearest place to stand, compared with a search over all places.

use super::flat::{Columns, FLOOR, layers, room};
use super::{everywhere, known, spot};
use crate::common::random::Random;
use nalgebra::{Point2, Point3};
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::reach::{Pawn, Place, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::BTreeMap;

/// Pixel, slice, and edge of a scene (m, pixels).
const T: f64 = 0.1;
const SIGMA: f64 = 0.3;
const EDGE: i64 = 40;

/// Patches of a floor at 3 m, of another one 2.4 m above it, and walls between them.
fn scene(random: &mut Random) -> Snapshot {
    let quanta = |metres: f64| (metres / SIGMA * SLICE_QUANTA as f64).round() as i64;
    let mut patches = |count: usize, size: i64| {
        let mut patch = || [random.below(EDGE), random.below(EDGE), 1 + random.below(size), 1 + random.below(size)];
        let all: Vec<[i64; 4]> = (0..count).map(|_| patch()).collect();
        move |i: i64, j: i64| all.iter().any(|[x, y, a, b]| (*x..x + a).contains(&i) && (*y..y + b).contains(&j))
    };
    let (low, high, wall) = (patches(7, 14), patches(4, 12), patches(6, 4));
    let mut columns = Columns::new();
    for (i, j) in (0..EDGE * EDGE).map(|at| (at % EDGE, at / EDGE)) {
        let floors = [(low(i, j), 3.0), (high(i, j), 5.4)].into_iter().filter(|floor| floor.0);
        let mut spans: Vec<_> = floors.map(|(_, z)| (quanta(z) - 2, quanta(z), false)).collect();
        if wall(i, j) {
            spans = vec![(quanta(3.0) - 2, quanta(5.0), true)];
        }
        if !spans.is_empty() {
            columns.insert((i, j), spans);
        }
    }
    layers(Frame::new(T, SIGMA).unwrap(), &columns)
}

#[test]
fn the_nearest_place_is_that_of_a_search_over_all() {
    let (mut moved, mut none, mut above) = (0, 0, 0);
    for seed in 0..12 {
        let mut random = Random(seed);
        let store = scene(&mut random);
        let (mut standing, region) = everywhere(&store, Pawn::new(Body::Box { x: 0.3, y: 0.3, height: 1.7 }));
        // Over each pixel, by its middle, along y, then x; from below.
        let mut over: BTreeMap<[i64; 2], Vec<Place>> = BTreeMap::new();
        for place in region.places() {
            let pixel = [place.feet.y, place.feet.x].map(|v| (v / T).floor() as i64);
            over.entry(pixel).or_default().push(place);
        }
        over.values_mut().for_each(|places| places.sort_by(|a, b| a.feet.z.total_cmp(&b.feet.z)));
        for _ in 0..60 {
            let [x, y] = [0, 1].map(|_| random.between(-0.5, EDGE as f64 * T + 0.5));
            let at = Point3::new(x, y, random.between(2.0, 7.0));
            let snap = random.between(0.0, 1.2);
            let found = known(standing.snapped(&store, at, snap).unwrap());
            let own = spot(&mut standing, &store, at);
            let mut best: Option<(f64, Point3<f64>)> = None;
            for (pixel, places) in &over {
                let middle = Point3::new((pixel[1] as f64 + 0.5) * T, (pixel[0] as f64 + 0.5) * T, at.z);
                let below = spot(&mut standing, &store, middle);
                for place in places {
                    let across = (place.feet - at).xy().norm();
                    let spot = spot(&mut standing, &store, place.feet + nalgebra::Vector3::z() * 0.01);
                    // In the air, the floor below counts.
                    let is_below = below.is_some() && below == spot;
                    let up = if is_below { (place.feet.z - at.z).max(0.0) } else { place.feet.z - at.z };
                    let distance = across.hypot(up);
                    if distance <= snap && best.is_none_or(|best| distance < best.0 - 1e-12) {
                        best = Some((distance, place.feet));
                    }
                }
            }
            match (found, own, best) {
                (Some(found), Some(own), _) => assert_eq!((found.spot, found.moved), (own, 0.0), "{seed}: {at}"),
                (Some(found), None, Some((distance, feet))) => {
                    assert!((found.moved - distance).abs() < 1e-9, "{seed}: {at}, {snap}: {found:?}, {distance} m");
                    assert!((found.feet - feet).norm() < 1e-9, "{seed}: {at}, {snap}: {found:?}, {feet}");
                    moved += 1;
                }
                (found, None, None) => {
                    assert_eq!(found, None, "{seed}: {at}, {snap}");
                    none += 1;
                }
                (found, own, best) => panic!("{seed}: {at}, {snap}: {found:?}, {own:?}, {best:?}"),
            }

            let all = known(standing.snapped_over(&store, at.xy(), snap).unwrap());
            let pixel = [at.y, at.x].map(|v| (v / T).floor() as i64);
            let across =
                |pixel: &[i64; 2]| (T * (pixel[1] as f64 + 0.5) - at.x).hypot(T * (pixel[0] as f64 + 0.5) - at.y);
            let nearest = match over.get_key_value(&pixel) {
                Some(own) => Some((0.0, own.1)),
                None => over
                    .iter()
                    .map(|(pixel, places)| (across(pixel), places))
                    .filter(|near| near.0 <= snap)
                    .reduce(|best, near| if near.0 < best.0 - 1e-12 { near } else { best }),
            };
            let expected: Vec<_> = nearest
                .into_iter()
                .flat_map(|(moved, places)| places.iter().map(move |place| (place.feet, moved)))
                .collect();
            assert_eq!(all.len(), expected.len(), "{seed}: over {at}, {snap}");
            for (found, (feet, moved)) in all.iter().zip(&expected) {
                assert!((found.feet - feet).norm() < 1e-9 && (found.moved - moved).abs() < 1e-9, "{seed}: over {at}");
            }
            above += usize::from(all.len() > 1);
        }
    }
    assert!(
        moved > 100 && none > 100 && above > 20,
        "{moved} moved, {none} without a place, {above} above one another"
    );
}

#[test]
fn a_place_beside_the_scan_is_moved_as_far_as_asked_for() {
    let store = room(20, 20, |_, _| None);
    let pawn = Pawn::new(Body::Box { x: T, y: T, height: 1.0 });
    let mut standing = StandingPlaces::new(&store, pawn).unwrap();
    // Farther off than the tile around the scan in which a body may hang over its end.
    let at = Point3::new(-10.0, 0.55, FLOOR);
    let nearest = Point3::new(0.15, 0.55, FLOOR);
    for (snap, is_near) in [(10.2, true), (10.1, false)] {
        let found = known(standing.snapped(&store, at, snap).unwrap());
        let over = known(standing.snapped_over(&store, at.xy(), snap).unwrap());
        assert_eq!((found.is_some(), over.len()), (is_near, usize::from(is_near)), "{snap} m");
        for found in found.into_iter().chain(over) {
            assert!((found.feet - nearest).norm() < 1e-6 && (found.moved - 10.15).abs() < 1e-6, "{found:?}");
        }
    }
    for x in [f64::NAN, f64::INFINITY, -1e300, 1e12] {
        assert_eq!(known(standing.snapped(&store, Point3::new(x, 0.55, FLOOR), 100.0).unwrap()), None, "{x}");
        assert_eq!(known(standing.snapped_over(&store, Point2::new(x, 0.55), 100.0).unwrap()), [], "{x}");
    }
}
