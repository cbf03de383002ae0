//! Clearance and ways out of solid at their bounds: exactly as far as the reach, equally near, and beside pages that are
//! not in memory. Most lengths are exact in binary.

use crate::scene::{Columns, pages_of};

use nalgebra::{Point3, Vector3};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::*;
use slicewalk::store::Snapshot;

/// Pixels of 1/4 m, quanta of 1/1024 m.
fn exact() -> Frame {
    Frame::new(0.25, 255.0 / 1024.0).unwrap()
}

fn store(columns: Columns) -> Snapshot {
    Snapshot::from_pages(exact(), pages_of(&columns))
}

fn cuboid(min: [f64; 3], max: [f64; 3]) -> Aabb {
    Aabb::new(min.into(), max.into()).unwrap()
}

/// Solid of one pixel and one slice at the origin, in the page on either side of it.
#[test]
fn what_is_exactly_as_far_as_the_reach_is_found() {
    for frame in [exact(), Frame::new(0.1, 0.3).unwrap()] {
        let unit = [frame.pixel_m(), frame.pixel_m(), frame.slice_m()];
        for (pixel, span, beyond) in [((0, 0), (0, 255, true), false), ((-1, -1), (-255, 0, true), true)] {
            let store = Snapshot::from_pages(frame, pages_of(&Columns::from([(pixel, vec![span])])));
            for (axis, n) in (0..3).flat_map(|axis| (1..=60).map(move |n| (axis, n))) {
                let apart = unit[axis] * 0.31 * f64::from(n);
                let (mut min, mut max) = (unit.map(|unit| 0.25 * unit), unit.map(|unit| 0.75 * unit));
                (min[axis], max[axis]) = (-apart - 0.3 * unit[axis], -apart);
                let shape = if beyond { cuboid(max.map(|v| -v), min.map(|v| -v)) } else { cuboid(min, max) };
                let found = clearance(&store, &shape, 100.0).known().flatten().unwrap();
                assert!((found - apart).abs() < 1e-9, "{shape:?}: {found}");
                assert_eq!(clearance(&store, &shape, found), Answer::Known(Some(found)), "{shape:?}");
                assert_eq!(clearance(&store, &shape, found * (1.0 - 1e-9)), Answer::Known(None), "{shape:?}");
            }
        }
    }
}

/// From a pillar of one pixel at 2 m, 1 m high: legs of 3-4-5 and 5-12-13 triangles.
#[test]
fn the_clearance_of_a_round_shape_begins_at_its_rim() {
    let store = store(Columns::from([((8, 8), vec![(0, 1024, true)])]));
    let cylinder = |x: f64, y: f64, z: f64| Cylinder::new(Point3::new(x, y, z), 0.5, 0.5).unwrap();
    let sphere = |x: f64, y: f64, z: f64| Sphere::new(Point3::new(x, y, z), 0.5).unwrap();
    let near = |answer: Answer<Option<f64>>, expected: f64| {
        let found = answer.known().flatten().unwrap();
        assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
    };
    near(clearance(&store, &cylinder(0.5, 2.125, 0.25), 10.0), 1.0);
    near(clearance(&store, &cylinder(0.5, 0.0, 0.25), 10.0), 2.0);
    near(clearance(&store, &cylinder(0.5, 0.0, 2.5), 10.0), 2.5);
    near(clearance(&store, &cylinder(1.75, 2.125, 2.5), 10.0), 1.5);
    near(clearance(&store, &cylinder(1.75, 2.125, 0.25), 10.0), 0.0);
    near(clearance(&store, &sphere(0.5, 2.125, 0.25), 10.0), 1.0);
    near(clearance(&store, &sphere(0.5, 0.0, 0.25), 10.0), 2.0);
    near(clearance(&store, &sphere(0.5, 0.0, 7.0), 10.0), 6.0);
    near(clearance(&store, &sphere(1.75, 2.125, 0.25), 10.0), 0.0);
    near(clearance(&store, &cuboid([-0.5, -1.0, 7.0], [0.5, 0.0, 8.0]), 10.0), 6.5);
}

/// The cell of the missing page begins at x = 0; a span that is in memory begins at pixel 66.
#[test]
fn a_missing_page_as_near_as_the_nearest_solid_is_no_hindrance() {
    let span = vec![(0, 255, true)];
    let whole = store(Columns::from([((-10, 5), span.clone()), ((66, 5), span)]));
    let missing = PageKey { tx: -1, ty: 0, layer: 0 };
    let store = whole.keep_loaded(|key| key != missing);
    let between = |first: f64| cuboid([first, 1.25, 0.0], [14.0, 1.5, 0.2]);
    assert_eq!(clearance(&store, &between(2.5), 3.0), Answer::Known(Some(2.5)));
    let Answer::NotLoaded(needed) = clearance(&store, &between(2.25), 3.0) else { panic!("it could be nearer") };
    assert_eq!(needed.keys(), [missing]);
}

/// Slices 10 and 11 of a page above the lowest layer, seen from 3 m beside and 4 m over or under them.
#[test]
fn a_missing_page_counts_as_near_as_its_occupied_slices() {
    let columns = Columns::from([((0, 0), vec![(PAGE_QUANTA + 2560, PAGE_QUANTA + 3050, true)])]);
    let store = store(columns).keep_loaded(|_| false);
    let [bottom, top] = [10, 12].map(|slice| (PAGE_QUANTA + 255 * slice) as f64 / 1024.0);
    for [low, high] in [[top + 4.0, top + 4.5], [bottom - 4.5, bottom - 4.0]] {
        let shape = cuboid([-4.0, 0.05, low], [-3.0, 0.2, high]);
        assert_eq!(clearance(&store, &shape, 4.5), Answer::Known(None), "{shape:?}");
        assert!(matches!(clearance(&store, &shape, 5.0), Answer::NotLoaded(_)), "{shape:?}");
    }
}

/// A shape without width on the border of two tiles touches them both and is in neither.
#[test]
fn a_missing_page_that_is_only_touched_is_not_in_the_way() {
    let store = store(Columns::from([((-1, 5), vec![(0, 1000, true)])])).keep_loaded(|_| false);
    let shape = |first: f64| cuboid([first, 1.25, 0.1], [0.0, 1.5, 0.5]);
    assert_eq!(depenetrate(&store, &shape(0.0), 1.0), Answer::Known(Some(Vector3::zeros())));
    assert!(matches!(depenetrate(&store, &shape(-0.01), 1.0), Answer::NotLoaded(_)));
}

/// Three sixteenths of a metre from the faces of a pillar of one pixel, 2 m high.
#[test]
fn of_equally_short_ways_out_the_first_direction_counts() {
    let store = store(Columns::from([((8, 8), vec![(0, 2048, true)])]));
    let shape = |low: f64| cuboid([2.0625, 2.0625, low], [2.1875, 2.1875, 3.0]);
    let (up, aside) = (Vector3::new(0.0, 0.0, 0.1875), Vector3::new(0.1875, 0.0, 0.0));
    for max in [0.1875, 1.0] {
        assert_eq!(depenetrate(&store, &shape(1.8125), max), Answer::Known(Some(up)), "{max}");
        assert_eq!(depenetrate(&store, &shape(1.0), max), Answer::Known(Some(aside)), "{max}");
    }
    for max in [0.1875f64.next_down(), 0.0] {
        assert_eq!(depenetrate(&store, &shape(1.8125), max), Answer::Known(None), "{max}");
    }
    // In no solid.
    let free = cuboid([3.0; 3], [3.5; 3]);
    assert_eq!(depenetrate(&store, &free, 0.0), Answer::Known(Some(Vector3::zeros())));
    for max in [-1.0, -f64::MIN_POSITIVE, f64::NAN] {
        assert_eq!(depenetrate(&store, &free, max), Answer::Known(None), "{max}");
    }
}

/// The two pages lie at the ends of all tiles, four billion apart: only they may be looked at.
#[test]
fn a_shape_over_all_tiles_costs_no_more_than_the_pages_there_are() {
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(5, 5, &[Span::new(0, 1024, true).unwrap()]));
    let page = builder.build();
    let infinite = f64::INFINITY;
    for axis in 0..2 {
        let key = |tile: i32| {
            let [tx, ty] = if axis == 0 { [tile, 0] } else { [0, tile] };
            PageKey { tx, ty, layer: 0 }
        };
        let pages = [-i32::MAX, i32::MAX].map(|tile| (key(tile), page.clone()));
        let store = Snapshot::from_pages(exact(), pages);
        let (mut min, mut max) = ([1.25, 1.25, 5.0], [1.5, 1.5, 6.0]);
        (min[axis], max[axis]) = (-infinite, infinite);
        assert_eq!(clearance(&store, &cuboid(min, max), 10.0), Answer::Known(Some(4.0)));
        let missing = store.keep_loaded(|key| key.tx < 0 || key.ty < 0);
        assert!(matches!(clearance(&missing, &cuboid(min, max), 10.0), Answer::NotLoaded(_)));
    }
}
