//! Ramps with and without landings, and steps.

use super::storeys::{LIFT, floors};
use super::{everywhere, flat, known, reached};
use crate::common::random::Random;
use nalgebra::{Matrix2, Vector2};
use slicewalk::frame::Frame;
use slicewalk::page::Span;
use slicewalk::reach::Pawn;
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;

/// A path 3 m wide and 22 m long through the origin that leads in a direction (radians), with these heights along it (m).
fn path(heading: f64, height: impl Fn(f64) -> f64) -> Snapshot {
    floors(|x, y| {
        let (along, across) = (x * heading.cos() + y * heading.sin(), y * heading.cos() - x * heading.sin());
        if across.abs() < 1.5 && along.abs() < 11.0 { vec![height(along)] } else { Vec::new() }
    })
}

fn wheelchair() -> Pawn {
    let body = Body::Cylinder { radius: 0.4, height: 1.4 };
    Pawn { climb: 0.02, max_drop: 0.02, max_grade: 0.06, ..Pawn::new(body) }
}

/// Whether a wheelchair gets from one end of a path 3 m wide to the other: 4 m of level ground, these stretches of a length
/// and a grade (m, rise over run), and level ground again. The path leads in a direction (degrees).
fn connects(stretches: &[(f64, f64)], direction: f64, max_ramp: f64) -> bool {
    let heading = direction.to_radians();
    let height = |along: f64| {
        let mut left = (along + 7.0).max(0.0);
        stretches.iter().fold(1.0, |z, (length, grade)| {
            let own = left.min(*length);
            left -= own;
            z + own * grade
        })
    };
    let store = path(heading, height);
    let pawn = Pawn { max_ramp, ..wheelchair() };
    let end = |along: f64| [along * heading.cos(), along * heading.sin(), height(along) + LIFT + 0.1];
    let (mut standing, mut region) = reached(&store, pawn, end(-10.0));
    let start = known(standing.spot(&store, end(-10.0).into()).unwrap()).unwrap();
    let goal = known(standing.spot(&store, end(10.0).into()).unwrap()).unwrap();
    region.keep_linked(&standing, &[start]);
    region.stands_at(&goal)
}

/// Ramps need a landing every six metres in whatever direction they lead (degrees).
fn needs_landings(direction: f64) {
    let passes = |stretches: &[(f64, f64)]| connects(stretches, direction, 6.0);
    assert!(passes(&[(5.5, 0.055)]) && !passes(&[(6.6, 0.055)]));
    assert!(passes(&[(5.5, -0.055)]) && !passes(&[(6.6, -0.055)]));
    // A landing divides a long ramp; a short one does not.
    assert!(passes(&[(5.0, 0.055), (1.5, 0.0), (5.0, 0.055)]));
    assert!(passes(&[(5.0, 0.055), (1.5, 0.02), (5.0, -0.055)]));
    assert!(!passes(&[(5.0, 0.055), (0.4, 0.0), (5.0, 0.055)]));
    // Ground that rises by less is no ramp.
    assert!(passes(&[(13.0, 0.028)]) && !passes(&[(13.0, 0.035)]));
    assert!(connects(&[(13.0, 0.055)], direction, f64::INFINITY));
    assert!(connects(&[(8.0, 0.055)], direction, 9.0) && !connects(&[(8.0, 0.055)], direction, 7.0));
}

#[test]
fn ramps_along_the_axis_need_landings() {
    needs_landings(0.0);
}

#[test]
fn ramps_at_30_degrees_need_landings() {
    needs_landings(30.0);
}

#[test]
fn ramps_at_45_degrees_need_landings() {
    needs_landings(45.0);
}

#[test]
fn ramps_at_77_degrees_need_landings() {
    needs_landings(77.0);
}

#[test]
fn ground_is_too_steep_if_it_exceeds_the_steepest_grade_by_more_than_a_fiftieth() {
    // 6 % are allowed.
    let connects = |grade: f64| connects(&[(5.0, grade)], 0.0, f64::INFINITY);
    assert_eq!([0.058, 0.0605, 0.063].map(connects), [true, true, false]);
}

#[test]
fn the_grade_of_a_plane_is_exact_beside_the_end_of_the_region_too() {
    for direction in [0.0, 17.0, 45.0, 68.0, 90.0] {
        let heading = f64::to_radians(direction);
        let (_, region) = reached(&path(heading, |along| 2.0 + 0.055 * along), wheelchair(), [0.0, 0.0, LIFT + 2.1]);
        let grades = region.places().zip(region.grades());
        let inner = grades.filter(|(place, _)| place.feet.xy().coords.norm() < 8.0);
        let off = inner.map(|(_, grade)| (grade - 0.055).abs()).fold(0.0, f64::max);
        assert!(off < 0.006, "{direction}°: {off}");
    }
}

/// Slope of the plane through these places (offset and height, pixels) that fits best; along them if they are narrower than
/// `narrow` pixels.
fn slope(places: &[(Vector2<f64>, f64)], narrow: f64) -> f64 {
    let count = places.len() as f64;
    let middle = places.iter().map(|place| place.0).sum::<Vector2<f64>>() / count;
    let height = places.iter().map(|place| place.1).sum::<f64>() / count;
    let (mut spread, mut rise) = (Matrix2::zeros(), Vector2::zeros());
    for (at, z) in places {
        spread += (at - middle) * (at - middle).transpose() / count;
        rise += (at - middle) * (z - height) / count;
    }
    let axes = spread.symmetric_eigen();
    let slopes = [0, 1].map(|n| (axes.eigenvalues[n], axes.eigenvectors.column(n).dot(&rise) / axes.eigenvalues[n]));
    let [across, along] = if slopes[0].0 < slopes[1].0 { slopes } else { [slopes[1], slopes[0]] };
    match () {
        () if along.0 < 1e-9 => 0.0,
        () if across.0 < narrow.powi(2) / 12.0 => along.1.abs(),
        () => across.1.hypot(along.1),
    }
}

#[test]
fn grades_are_those_of_the_planes_that_fit_best() {
    const SIDE: i64 = 60;
    // Pixels within half a metre, and across 0.3 m.
    const FAR: i64 = 5;
    let (mut narrow, mut wide) = (0, 0);
    for seed in 0..4 {
        let mut random = Random(seed);
        // Walls leave paths of any width.
        let mut heights = vec![[None; SIDE as usize]; SIDE as usize];
        for _ in 0..40 {
            let [i, j] = [0, 1].map(|_| random.below(SIDE as u32) as usize);
            let [wide, deep] = [1 + random.below(24) as usize, 1 + random.below(6) as usize];
            let is_along = random.below(2) == 0;
            let [wide, deep] = if is_along { [wide, deep] } else { [deep, wide] };
            for (x, y) in (i..i + wide).flat_map(|x| (j..j + deep).map(move |y| (x, y))) {
                if let Some(height) = heights.get_mut(x).and_then(|row| row.get_mut(y)) {
                    *height = Some((3 * x + 2 * y) as i64 + i64::from(random.below(12)));
                }
            }
        }
        let frame = Frame::new(flat::T, 0.3).unwrap();
        let height = |i: i64, j: i64| *heights.get(usize::try_from(i).ok()?)?.get(usize::try_from(j).ok()?)?;
        let columns = (0..SIDE * SIDE).filter_map(|at| {
            let (i, j) = (at % SIDE, at / SIDE);
            let top = 2550 + height(i, j)? as u32;
            Some(((i, j), vec![Span::new(2540, top, false).unwrap()]))
        });
        let pawn = Pawn::new(Body::Box { x: flat::T, y: flat::T, height: 1.0 });
        let (_, region) = everywhere(&flat::store(frame, columns), pawn);
        let grades = region.grades();
        assert!(grades.len() > 500, "{} places", grades.len());
        let line = |[i, j]: [i64; 2], by: [i64; 2]| {
            let side = |sign: i64| {
                let along = (1..=FAR).map(move |n| [i + sign * n * by[0], j + sign * n * by[1]]);
                along.take_while(|[i, j]| height(*i, *j).is_some())
            };
            std::iter::once([i, j]).chain(side(1)).chain(side(-1)).collect::<Vec<_>>()
        };
        for (place, grade) in region.places().zip(grades) {
            let own = [place.feet.x, place.feet.y].map(|v| (v / flat::T).floor() as i64);
            let around = line(own, [0, 1]).into_iter().flat_map(|at| line(at, [1, 0]));
            let pixel = frame.quantum_m() / frame.pixel_m();
            let places: Vec<_> = around
                .map(|[i, j]| {
                    (Vector2::new((i - own[0]) as f64, (j - own[1]) as f64), height(i, j).unwrap() as f64 * pixel)
                })
                .collect();
            let (least, most) = (slope(&places, 0.0), slope(&places, 3.0));
            if (least - most).abs() > 1e-6 {
                narrow += 1
            } else {
                wide += 1
            }
            assert!((grade - most).abs() < 1e-6, "seed {seed}, {own:?}: {grade}, expected {most}");
        }
    }
    assert!(narrow > 100 && wide > 1000, "{narrow} narrow, {wide} wide");
}

#[test]
fn a_grade_is_that_over_a_metre_at_fine_pixels_too() {
    // A strip of 3 m that rises by 5.5 %, with 0.4 m of level ground in its middle.
    const PIXEL: f64 = 0.005;
    let frame = Frame::new(PIXEL, 0.015).unwrap();
    let columns = (0..600i64).flat_map(|i| {
        let x = (i as f64 + 0.5 - 300.0) * PIXEL;
        let height = 0.055 * (x.abs() - 0.2).max(0.0) * x.signum() + 0.2;
        let top = (height / frame.quantum_m()).round() as u32;
        (0..8i64).map(move |j| ((i, j), vec![Span::new(top - 2, top, false).unwrap()]))
    });
    let pawn = Pawn::new(Body::Box { x: PIXEL, y: PIXEL, height: 1.0 });
    let (_, region) = everywhere(&flat::store(frame, columns), pawn);
    let mut grades = region.places().zip(region.grades());
    let (_, grade) = grades.find(|(place, _)| (place.feet.x - 1.5).abs() < PIXEL).unwrap();
    // 0.055 (1 - 1.5 · 0.4 + 0.5 · 0.4³); over 0.64 m it would be 0.010.
    assert!((grade - 0.0238).abs() < 0.002, "{grade}");
}

#[test]
fn headroom_and_steps_beyond_steep_ground_do_not_count() {
    let height = |along: f64| match along {
        ..0.0 => 0.0,
        ..4.0 => 0.2 * along,
        ..6.0 => 0.8,
        // A step that the pawn climbs.
        _ => 0.9,
    };
    let store = floors(|x, y| {
        let ceiling = if x < 0.0 { 2.4 } else { height(x) + 1.8 };
        if x.abs() < 9.0 && y.abs() < 1.5 { vec![height(x), ceiling] } else { Vec::new() }
    });
    let measures = |max_grade: f64| {
        let pawn = Pawn { max_grade, climb: 0.15, max_drop: 0.15, ..wheelchair() };
        let from = [-5.0, 0.0, LIFT + 0.1];
        let (mut standing, mut region) = reached(&store, pawn, from);
        let start = known(standing.spot(&store, from.into()).unwrap()).unwrap();
        region.keep_linked(&standing, &[start]);
        let (headroom, step) = (region.lowest_headroom().unwrap(), region.highest_step());
        (headroom.1, headroom.0.feet.x, step.map(|step| step.1))
    };
    let (low, x, step) = measures(f64::INFINITY);
    assert!(low < 2.0 && x > 0.0 && step.is_some_and(|step| (0.08..0.12).contains(&step)), "{low} {x} {step:?}");
    let (low, x, step) = measures(0.06);
    assert!(low > 2.0 && x < 0.0 && step.is_none_or(|step| step < 0.08), "{low} {x} {step:?}");
}

#[test]
fn a_step_with_points_above_its_tread_is_climbed() {
    let quanta = |z: f64| (2550.0 + z / 0.3 * 255.0).round() as u32;
    let columns = (0..50).flat_map(|i| (0..20).map(move |j| (i, j))).map(|(i, j)| {
        // The face of a step of 0.17 m at 20, and points of the next face that count as floor, 0.05 m above the tread, at 22.
        let (top, is_obstacle) = match i {
            ..20 => (0.0, false),
            20 => (0.17, true),
            22 => (0.215, false),
            _ => (0.168, false),
        };
        ((i, j), vec![Span::new(2547, quanta(top), is_obstacle).unwrap()])
    });
    let store = flat::store(Frame::new(flat::T, 0.3).unwrap(), columns);
    let pawn = Pawn { climb: 0.2, max_drop: 0.2, ..Pawn::new(Body::Box { x: 0.3, y: 0.3, height: 1.0 }) };
    let ends = [[1.05, 1.05, 3.1], [4.05, 1.05, 3.3]];
    for [from, to] in [ends, [ends[1], ends[0]]] {
        let (mut standing, region) = reached(&store, pawn, from);
        let to = known(standing.spot(&store, to.into()).unwrap()).unwrap();
        assert!(region.stands_at(&to), "{from:?}");
    }
}
