//! Storeys of floors that lie above themselves.

use super::reached;
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::reach::{Pawn, Region, Storeys};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Pixel size and slice height (m).
const T: f64 = 0.1;
const SLICE: f64 = 0.3;

/// Makes floors of the heights (m, from 0 to 18) over the middle of each pixel within 12 m of the origin, lowest first.
pub(super) fn floors(heights: impl Fn(f64, f64) -> Vec<f64>) -> Snapshot {
    let mut pages: BTreeMap<[i32; 2], PageBuilder> = BTreeMap::new();
    for (j, i) in (-120..120i32).flat_map(|j| (-120..120i32).map(move |i| (j, i))) {
        let quanta = |z: f64| (z / SLICE * 255.0).round() as u32 + 300;
        let found = heights((f64::from(i) + 0.5) * T, (f64::from(j) + 0.5) * T);
        let spans: Vec<Span> = found.iter().map(|&z| Span::new(quanta(z) - 40, quanta(z), false).unwrap()).collect();
        let page = pages.entry([i >> 6, j >> 6]).or_default();
        assert!(page.set_column((i & 63) as u32, (j & 63) as u32, &spans));
    }
    let page = |([tx, ty], builder): ([i32; 2], PageBuilder)| (PageKey { tx, ty, layer: 0 }, builder.build());
    Snapshot::from_pages(Frame::new(T, SLICE).unwrap(), pages.into_iter().map(page))
}

fn storeys(store: &Snapshot, from: [f64; 3]) -> (Region, Storeys) {
    let (_, region) = reached(store, Pawn::new(Body::Box { x: 0.5, y: 0.5, height: 1.8 }), from);
    let storeys = region.storeys();
    (region, storeys)
}

/// Height of the floors of [`floors`] above the origin of the grid (m).
pub(super) const LIFT: f64 = 300.0 / 255.0 * SLICE;

#[test]
fn each_turn_of_a_helical_ramp_is_a_storey() {
    // Three turns of 3 m between radii of 3 and 6 m.
    let store = floors(|x, y| {
        let turn = y.atan2(x).rem_euclid(TAU) / TAU;
        let is_ramp = (3.0..6.0).contains(&x.hypot(y));
        if is_ramp { (0..3).map(|above| 3.0 * (f64::from(above) + turn)).collect() } else { Vec::new() }
    });
    let (region, storeys) = storeys(&store, [4.5, 0.5, LIFT + 0.2]);
    assert_eq!(storeys.all.len(), 3, "{:?}", storeys.all);
    for (storey, z) in storeys.all.iter().zip([1.5, 4.5, 7.5]) {
        assert!((storey.z - LIFT - z).abs() < 0.3, "{storey:?}");
        assert!((storey.area_m2 - region.area_m2() / 3.0).abs() < 0.05 * region.area_m2(), "{storey:?}");
    }
    // Places of a storey do not lie above one another, but for a few at the end of the ramp: less than a storey of their
    // own.
    let mut seen = std::collections::HashSet::new();
    let double = region.places().zip(&storeys.of).filter(|(place, storey)| {
        let pixel = [place.feet.x, place.feet.y].map(|at| (at / T).floor() as i64);
        !seen.insert((**storey, pixel))
    });
    assert!(double.count() < 100);
}

#[test]
fn two_floors_joined_by_a_ramp_are_two_storeys() {
    // Floors of 8 × 8 m at 0 and 3 m, and a ramp of 24 m round the corner.
    let store = floors(|x, y| {
        let is_floor = (-4.0..4.0).contains(&x) && (-4.0..4.0).contains(&y);
        let ramp = |along: f64| 3.0 * along / 24.0;
        match (x, y) {
            _ if is_floor => vec![0.0, 3.0],
            // From the floor below at (4, -3) to the east of it, northwards, and back to the floor above at (-3, 4).
            (x, y) if (4.0..6.0).contains(&x) && (-4.0..8.0).contains(&y) => vec![ramp(y + 4.0)],
            (x, y) if (-6.0..4.0).contains(&x) && (6.0..8.0).contains(&y) => vec![ramp(12.0 + 4.0 - x)],
            (x, y) if (-6.0..-4.0).contains(&x) && (2.0..6.0).contains(&y) => vec![3.0],
            _ => Vec::new(),
        }
    });
    let (region, storeys) = storeys(&store, [0.0, 0.0, LIFT + 0.2]);
    assert_eq!(storeys.all.len(), 2, "{:?}", storeys.all);
    assert!(storeys.all[1].area_m2 > 60.0, "{:?}", storeys.all);
    for (place, storey) in region.places().zip(&storeys.of) {
        let is_floor = place.feet.x.abs() < 3.9 && place.feet.y.abs() < 3.9;
        let is_upper = place.feet.z > LIFT + 2.0;
        assert!(!is_floor || (*storey == 1) == is_upper, "{place:?} in storey {storey}");
    }
}
