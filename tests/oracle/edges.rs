//! Rays and round shapes along edges, through corners and in the planes between pixels: solid is closed on all sides,
//! and an answer does not depend on where the scene is.
//!
//! All numbers are multiples of 1/32 m, small or shifted by whole tiles, so that integers give the truth.

use super::scene::{Columns, Random, pages_of};
use nalgebra::{Point3, Vector3};
use slicewalk::frame::Frame;
use slicewalk::query::*;
use slicewalk::store::Snapshot;

/// Edge of a pixel (m), which equals 64 quanta of height.
const UNIT: f64 = 0.0625;
const QUANTA: i64 = 64;
/// Corners of a cell, in steps of half a unit.
type Cell = ([i64; 3], [i64; 3]);

fn frame() -> Frame {
    Frame::new(UNIT, 255.0 / 1024.0).unwrap()
}

/// Solid around the corner of eight pages.
fn columns(random: &mut Random) -> Columns {
    let mut columns = Columns::new();
    for (i, j) in (-5..5).flat_map(|i| (-5..5).map(move |j| (i, j))) {
        let mut from = -6;
        while random.chance(45) {
            let bottom = from + random.below(5) as i64;
            let top = bottom + random.below(3) as i64;
            columns.entry((i, j)).or_default().push((bottom * QUANTA, top * QUANTA, random.chance(50)));
            from = top + 1;
        }
    }
    columns
}

fn cells(columns: &Columns) -> Vec<Cell> {
    let cell = |(i, j): (i64, i64), (bottom, top): (i64, i64)| {
        ([2 * i, 2 * j, 2 * bottom / QUANTA], [2 * i + 2, 2 * j + 2, 2 * top / QUANTA])
    };
    columns.iter().flat_map(|(&at, spans)| spans.iter().map(move |span| cell(at, (span.0, span.1)))).collect()
}

/// Builds the solid, moved by whole tiles and layers.
fn moved(columns: &Columns, by: [i64; 3]) -> Snapshot {
    let up = by[2] * 255 * QUANTA;
    let column = |(&(i, j), spans): (&(i64, i64), &Vec<_>)| {
        let spans = spans.iter().map(|&(bottom, top, obstacle): &(i64, i64, bool)| (bottom + up, top + up, obstacle));
        ((i + 64 * by[0], j + 64 * by[1]), spans.collect())
    };
    Snapshot::from_pages(frame(), pages_of(&columns.iter().map(column).collect()))
}

const SHIFTS: [[i64; 3]; 6] =
    [[0, 0, 0], [1, 0, 0], [0, -1, 1], [-3, 5, -2], [64, -65, 0], [1 << 20, -(1 << 20), 1 << 10]];

fn place(at: [i64; 3], by: [i64; 3]) -> Point3<f64> {
    let units = [64, 64, 255];
    Point3::from([0, 1, 2].map(|axis| (at[axis] as f64 / 2.0 + (by[axis] * units[axis]) as f64) * UNIT))
}

/// Twice the first time at which `at + time · way` (half units) is in a closed cell; components of `way` are 0, ±1, ±2.
fn first(cells: &[Cell], at: [i64; 3], way: [i64; 3]) -> Option<i64> {
    let hits = cells.iter().filter_map(|(low, high)| {
        let (mut t0, mut t1) = (0, i64::MAX);
        for axis in 0..3 {
            let (a, b) = (low[axis] - at[axis], high[axis] - at[axis]);
            if way[axis] == 0 {
                if a > 0 || b < 0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (2 * a / way[axis], 2 * b / way[axis]);
            (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
        }
        (t0 <= t1).then_some(t0)
    });
    hits.min()
}

#[test]
fn rays_along_edges_see_both_sides_wherever_the_scene_stands() {
    let mut random = Random(91);
    let (mut hits, mut misses) = (0, 0);
    for _ in 0..60 {
        let columns = columns(&mut random);
        let cells = cells(&columns);
        let stores = SHIFTS.map(|by| (by, moved(&columns, by)));
        for _ in 0..300 {
            // Mostly on edges, and most often in the middle planes.
            let mut start = |most: i64| match random.below(4) {
                0 => 0,
                1 => random.below(4 * most as usize + 1) as i64 - 2 * most,
                _ => (random.below(2 * most as usize + 1) as i64 - most) * 2,
            };
            let at = [start(7), start(7), start(9)];
            let way = [0; 3].map(|_| random.below(5) as i64 - 2);
            if way == [0; 3] {
                continue;
            }
            let truth = first(&cells, at, way);
            let direction = Vector3::from(way.map(|v| v as f64));
            for (by, store) in &stores {
                let ray = Ray::new(place(at, *by), direction, f64::INFINITY).unwrap();
                let Answer::Known(hit) = cast(store, &ray) else { panic!("all pages are in memory") };
                let expected = truth.map(|time| time as f64 / 4.0 * UNIT * direction.norm());
                assert_eq!(
                    hit.is_some(),
                    truth.is_some(),
                    "from {at:?} along {way:?}, moved by {by:?}: {hit:?} {expected:?}"
                );
                let apart = hit.zip(expected).map_or(0.0, |(hit, expected)| (hit.distance - expected).abs());
                assert!(apart < 1e-6, "from {at:?} along {way:?}, moved by {by:?}: {hit:?} {expected:?}");
            }
            *(if truth.is_some() { &mut hits } else { &mut misses }) += 1;
        }
    }
    assert!(hits > 3000 && misses > 3000, "{hits} {misses}: the test shows little");
}

#[test]
fn round_shapes_touch_what_lies_at_their_rim_wherever_the_scene_stands() {
    let mut random = Random(92);
    let (mut hits, mut misses) = (0, 0);
    for _ in 0..60 {
        let columns = columns(&mut random);
        let cells = cells(&columns);
        let stores = SHIFTS.map(|by| (by, moved(&columns, by)));
        for _ in 0..300 {
            let mut near = |most: i64| random.below(4 * most as usize + 1) as i64 - 2 * most;
            let (at, radius, height) = ([near(9), near(9), near(9)], near(3).abs(), near(2).abs());
            let beyond = |cell: &Cell, axis: usize, high: i64| {
                (cell.0[axis] - at[axis] - high).max(at[axis] - cell.1[axis]).max(0)
            };
            let across = |cell: &Cell| beyond(cell, 0, 0).pow(2) + beyond(cell, 1, 0).pow(2);
            let cylinder = cells.iter().any(|c| across(c) <= radius * radius && beyond(c, 2, height) == 0);
            let sphere = cells.iter().any(|c| across(c) + beyond(c, 2, 0).pow(2) <= radius * radius);
            for (by, store) in &stores {
                let metres = |v: i64| v as f64 / 2.0 * UNIT;
                let shapes = (
                    overlaps(store, &Cylinder::new(place(at, *by), metres(radius), metres(height)).unwrap()),
                    overlaps(store, &Sphere::new(place(at, *by), metres(radius)).unwrap()),
                );
                let answer = |hit: bool| if hit { Overlap::Hit } else { Overlap::Clear };
                let what = format!("at {at:?}, radius {radius}, height {height}, moved by {by:?}");
                assert_eq!(shapes, (answer(cylinder), answer(sphere)), "{what}");
            }
            *(if sphere { &mut hits } else { &mut misses }) += 1;
        }
    }
    assert!(hits > 3000 && misses > 3000, "{hits} {misses}: the test shows little");
}

/// The two basic cases: a wall on one side of a plane, and a ray in that plane.
#[test]
fn a_ray_in_the_plane_at_the_origin_hits_walls_on_either_side() {
    for (i, j) in [(-1, 3), (0, 3), (3, -1), (3, 0)] {
        let store = Snapshot::from_pages(frame(), pages_of(&Columns::from([((i, j), vec![(0, 640, true)])])));
        let along = if j == 3 { Vector3::y() } else { Vector3::x() };
        let hit = cast(&store, &Ray::new(Point3::new(0.0, 0.0, 0.2), along, 1.0).unwrap()).known().flatten();
        let is_right = |hit: RayHit| hit.normal == -along && (hit.distance - 3.0 * UNIT).abs() < 1e-12;
        assert!(hit.is_some_and(is_right), "({i}, {j}): {hit:?}");
    }
}

/// Pixels are grown by at most 2⁻⁴⁸ of the coordinates, so a ray that passes farther away misses them.
#[test]
fn rays_past_a_corner_or_below_an_edge_hit_only_within_rounding() {
    let is_hit = |store: &Snapshot, from: Point3<f64>, way: Vector3<f64>| {
        let ray = Ray::new(from, way, f64::INFINITY).unwrap();
        let Answer::Known(hit) = cast(store, &ray) else { panic!("all pages are in memory") };
        hit.is_some()
    };
    // Pixels in the middle and at the end of a block of 8 × 8, and rays across the origin to their corners.
    for (row, [x, y]) in
        [1003, 1007].into_iter().flat_map(|row| [[1, 1], [1, -1], [-1, 1], [-1, -1]].map(|way| (row, way)))
    {
        let mirrored = |number: i64, way: i64| if way > 0 { number } else { -1 - number };
        let pixel = (mirrored(1003, x), mirrored(row, y));
        let store = Snapshot::from_pages(frame(), pages_of(&Columns::from([(pixel, vec![(0, 640, true)])])));
        let corner = [x * 1003, y * (row + 1)];
        // A corner moves by the growth along both axes.
        let rounding = 2.0 * 2f64.powi(-48) * (row + 1) as f64;
        for (aside, hits) in [(-1e-9, true), (0.0, true), (1.05 * rounding, false), (1e-9, false)] {
            let begin = [(corner[0] - x * 2006) as f64, (corner[1] - y * 2006) as f64 + y as f64 * aside];
            let from = Point3::new(begin[0] * UNIT, begin[1] * UNIT, 0.3);
            let way = Vector3::new(x as f64, y as f64, 0.0);
            assert_eq!(is_hit(&store, from, way), hits, "{pixel:?} along {way:?}, {aside} pixels aside");
        }
    }
    // Descends from 100 quanta, and reaches the side of pixel (3, 0) a little above or below the span's bottom.
    let store = Snapshot::from_pages(frame(), pages_of(&Columns::from([((3, 0), vec![(0, 640, true)])])));
    for (above, hits) in [(1e-3, true), (1e-11, true), (-1e-11, false), (-1e-3, false)] {
        let from = Point3::new(0.5 * UNIT, 0.5 * UNIT, 100.0 / 1024.0);
        let to = Point3::new(3.0 * UNIT, 0.5 * UNIT, above / 1024.0);
        assert_eq!(is_hit(&store, from, to - from), hits, "{above} quanta above");
    }
}
