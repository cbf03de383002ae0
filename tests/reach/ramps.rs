//! Ramps with and without landings, and steps.

use super::storeys::{LIFT, floors};
use super::{flat, known, reached};
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

#[test]
fn ramps_need_a_landing_every_six_metres() {
    for direction in [0.0, 30.0, 45.0, 77.0] {
        let passes = |stretches: &[(f64, f64)]| connects(stretches, direction, 6.0);
        assert!(passes(&[(5.5, 0.055)]) && !passes(&[(6.6, 0.055)]), "{direction}°");
        assert!(passes(&[(5.5, -0.055)]) && !passes(&[(6.6, -0.055)]), "{direction}°");
        // A landing divides a long ramp; a short one does not.
        assert!(passes(&[(5.0, 0.055), (1.5, 0.0), (5.0, 0.055)]), "{direction}°");
        assert!(passes(&[(5.0, 0.055), (1.5, 0.02), (5.0, -0.055)]), "{direction}°");
        assert!(!passes(&[(5.0, 0.055), (0.4, 0.0), (5.0, 0.055)]), "{direction}°");
        // Ground that rises by less is no ramp.
        assert!(passes(&[(13.0, 0.028)]) && !passes(&[(13.0, 0.035)]), "{direction}°");
        assert!(connects(&[(13.0, 0.055)], direction, f64::INFINITY), "{direction}°");
        assert!(
            connects(&[(8.0, 0.055)], direction, 9.0) && !connects(&[(8.0, 0.055)], direction, 7.0),
            "{direction}°"
        );
    }
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
