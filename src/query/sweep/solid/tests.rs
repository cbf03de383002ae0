//! Times of contact at the edges of the margin for rounding errors, in numbers that are exact.

use super::sealed::OnSolid;
use super::*;

/// Pixels and quanta of 1 m: the grid has the numbers of the world.
fn frame() -> Frame {
    Frame::new(1.0, 255.0).unwrap()
}

/// A box from `lo` to `hi` that moves by `v`.
fn moving(lo: [f64; 3], hi: [f64; 3], v: [f64; 3]) -> Moving {
    let shape = Aabb::new(lo.into(), hi.into()).unwrap();
    Moving::new(&frame(), shape.resting(&frame()), v.into())
}

#[test]
fn sides_of_a_box_beyond_all_pages_are_infinite() {
    let resting = |far: f64| Aabb::new([-far; 3].into(), [far; 3].into()).unwrap().resting(&frame());
    for far in [1.0, BEYOND] {
        let rest = resting(far);
        assert_eq!((rest.lo, rest.hi), ([-far; 3], [far; 3]));
    }
    for far in [BEYOND.next_up(), 1e20, f64::INFINITY] {
        let rest = resting(far);
        assert_eq!((rest.lo, rest.hi), ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]), "{far}");
    }
}

#[test]
fn an_area_leaves_out_what_a_box_only_touches() {
    let area = moving([0.0; 3], [4.0; 3], [2.0, 3.0, -8.0]).area();
    assert_eq!(area.rect, Rect { i0: 0, i1: 5, j0: 0, j1: 6 });
    assert_eq!((area.low, area.high), (-7, 3));
    let area = moving([0.0; 3], [4.0; 3], [-2.0, -3.0, 8.0]).area();
    assert_eq!(area.rect, Rect { i0: -2, i1: 3, j0: -3, j1: 3 });
    assert_eq!((area.low, area.high), (1, 11));
}

#[test]
fn an_area_is_visited_in_the_order_of_travel() {
    for (v, major, backward) in [
        ([3.0, 2.0, 1.0], 0, [false, false, false]),
        ([2.0, -3.0, 0.0], 1, [false, true, false]),
        ([-3.0, 2.0, -1.0], 0, [true, false, true]),
        ([2.0, 2.0, 0.0], 0, [false, false, false]),
        ([0.0, 0.0, -1.0], 0, [false, false, true]),
    ] {
        let area = moving([0.0; 3], [4.0; 3], v).area();
        assert_eq!((area.major, area.backward), (major, backward), "{v:?}");
    }
}

#[test]
fn a_box_at_rest_meets_what_it_overlaps_by_more_than_the_margin() {
    let rest = moving([0.0; 3], [4.0; 3], [0.0; 3]);
    // 2⁻⁴⁸ of the coordinate.
    let margin = 2f64.powi(-46);
    for (lo, hi, meeting) in [
        (4.0, 5.0, Meeting::NEVER),
        (4.0 - margin, 5.0, Meeting::NEVER),
        (4.0 - 2.0 * margin, 5.0, Meeting::ALWAYS),
        (-1.0, 0.0, Meeting::NEVER),
        (-1.0, margin, Meeting::NEVER),
        (-1.0, 2.0 * margin, Meeting::ALWAYS),
    ] {
        assert_eq!(rest.axis(0, lo, hi), meeting, "{lo} {hi}");
    }
}

#[test]
fn a_box_in_motion_enters_and_leaves_at_the_margin() {
    let forth = moving([0.0; 3], [4.0; 3], [4.0; 3]);
    // 2⁻⁴⁸ of the coordinate and the motion. A motion that ends up to half of it further only touches.
    let margin = 2f64.powi(-45);
    let (inside, never) = (f64::NEG_INFINITY, f64::INFINITY);
    for (lo, enter) in [
        (4.0 - 2.0 * margin, inside),
        (4.0 - margin, 0.0),
        (4.0, 0.0),
        (6.0, 0.5),
        (8.0 - margin, 1.0 - margin / 4.0),
        (8.0 - margin / 2.0, never),
        (8.0, never),
    ] {
        assert_eq!(forth.axis(0, lo, 9.0).enter, enter, "{lo}");
    }
    for (hi, leave) in [(0.0, -never), (margin, -never), (8.0, 2.0 + margin / 8.0)] {
        assert_eq!(forth.axis(0, -1.0, hi).leave, leave, "{hi}");
    }
    let back = moving([0.0; 3], [4.0; 3], [-4.0; 3]);
    assert_eq!(back.axis(0, -4.0, -2.0), Meeting { enter: 0.5, leave: 2.0 + margin / 8.0 });
    assert_eq!(back.axis(0, -4.0, margin), Meeting { enter: 0.0, leave: 2.0 + margin / 8.0 });
    // Shape and box without thickness.
    let flat = moving([4.0; 3], [4.0; 3], [4.0; 3]);
    assert_eq!(flat.axis(0, 6.0, 6.0), Meeting { enter: 0.5, leave: 0.5 + margin / 8.0 });
    // The reciprocal of this motion is infinite.
    let tiny = moving([0.0; 3], [0.0; 3], [1e-310; 3]);
    assert_eq!(tiny.axis(0, 0.0, 1.0), Meeting { enter: 0.0, leave: f64::INFINITY });
}

#[test]
fn what_a_box_touches_before_a_time_is_kept() {
    let all = Rect { i0: -100, i1: 100, j0: -100, j1: 100 };
    let (down, up) = (moving([10.0; 3], [12.0; 3], [-8.0, 8.0, -8.0]), moving([10.0; 3], [12.0; 3], [8.0, -8.0, 8.0]));
    // With a time that is too early by a rounding error, too.
    for at in [0.5, 0.5 - 2f64.powi(-50)] {
        assert_eq!(down.heights_before(at, (-100, 100)), (6, 100));
        assert_eq!(up.heights_before(at, (-100, 100)), (-100, 16));
        assert_eq!([&down, &up].map(|moving| moving.heights_before(at, (8, 9))), [(8, 9); 2]);
        // The pixels that end and begin at its faces, too.
        assert_eq!(down.pixels_before(at, all), Rect { i0: 5, i1: 12, j0: 9, j1: 16 });
        assert_eq!(up.pixels_before(at, all), Rect { i0: 9, i1: 16, j0: 5, j1: 12 });
    }
    assert_eq!(moving([10.0; 3], [12.0; 3], [0.0, 0.0, -8.0]).pixels_before(0.5, all), all);
}

#[test]
fn the_way_across_is_that_of_the_time_along() {
    let (right, left) = (moving([0.0; 3], [4.0; 3], [4.0, 8.0, 0.0]), moving([0.0; 3], [4.0; 3], [4.0, -8.0, 0.0]));
    // It enters halfway and is still there at the end; one pixel more on both sides.
    assert_eq!(right.across(0, 6.0, 8.0), (3.0, 13.0));
    assert_eq!(left.across(0, 6.0, 8.0), (-9.0, 1.0));
    // It enters after a quarter.
    assert_eq!(right.across(1, 6.0, 8.0), (0.0, 9.0));
}

#[test]
fn a_falling_box_lands_on_what_it_overlaps_by_more_than_the_margin() {
    let falling = moving([0.0; 3], [4.0; 3], [0.0, 0.0, -8.0]);
    let margin = 2f64.powi(-46);
    let cell = |x: (f64, f64)| GridCell { lo: [x.0, 0.0, -6.0], hi: [x.1, 4.0, -4.0] };
    let landed = Some(Contact { at: 0.5, normal: [0.0, 0.0, 1.0] });
    for (x, contact) in [
        ((4.0 - margin, 5.0), None),
        ((4.0 - 2.0 * margin, 5.0), landed),
        ((-1.0, margin), None),
        ((-1.0, 2.0 * margin), landed),
    ] {
        assert_eq!(falling.contact(&cell(x), f64::INFINITY), contact, "{x:?}");
    }
    // A contact at the same time as the best one counts.
    assert_eq!(falling.contact(&cell((0.0, 1.0)), 0.5), landed);
    assert_eq!(falling.contact(&cell((0.0, 1.0)), 0.5f64.next_down()), None);
}

/// A disc around `p` that moves by `v`, and a square from 0 to 1. The margin is large, so that all numbers are exact.
fn round(p: [f64; 2], v: [f64; 2]) -> Round {
    Round { p: [p[0], p[1], 0.0], v: [v[0], v[1], 0.0], lo: [0.0; 3], hi: [1.0, 1.0, 0.0], axes: 2, slack: 0.125 }
}

#[test]
fn a_disc_that_touches_a_square_all_the_way_never_meets_it() {
    for x in [-1.0, 2.0] {
        assert_eq!(round([x, 0.5], [0.0, 1.0]).within(1.0), Meeting::NEVER, "{x}");
        assert_eq!(round([0.5, x], [1.0, 0.0]).within(1.0), Meeting::NEVER, "{x}");
    }
    // Nearer, from one corner to the other.
    for x in [-0.75, 1.75] {
        let Meeting { enter, leave } = round([x, 0.5], [0.0, 1.0]).within(1.0);
        let half = 0.5 + 0.4375f64.sqrt();
        assert!((enter + half).abs() < 1e-12 && (leave - half).abs() < 1e-12, "{x}: {enter} {leave}");
    }
}

#[test]
fn a_disc_in_contact_is_stopped_only_if_it_approaches() {
    let contact = |x: f64, v: [f64; 2]| round([x, 0.5], v).contact(1.0, Meeting::ALWAYS, false);
    let (away, towards, along) = ([-1.0, 0.0], [1.0, 0.0], [0.0, 1.0]);
    let stopped = Some(Contact { at: 0.0, normal: [-1.0, 0.0, 0.0] });
    // Overlaps of more than twice the margin, twice the margin, less, and the margin itself.
    assert_eq!([away, towards, along].map(|v| contact(-0.7, v)), [Some(Contact::INSIDE); 3]);
    assert_eq!([away, towards, along].map(|v| contact(-0.75, v)), [None, stopped, None]);
    assert_eq!([away, along].map(|v| contact(-0.8, v)), [None; 2]);
    assert_eq!([away, along].map(|v| contact(-0.875, v)), [None; 2]);
}

#[test]
fn without_motion_only_the_constant_decides() {
    for (c, meeting) in [(-1.0, Meeting::ALWAYS), (0.0, Meeting::NEVER), (1.0, Meeting::NEVER)] {
        assert_eq!(below_zero([0.0, 0.0, c]), meeting, "{c}");
    }
    // (t + 1)·(t - 3) < 0, and a parabola that only touches 0.
    assert_eq!(below_zero([1.0, -1.0, -3.0]), Meeting { enter: -1.0, leave: 3.0 });
    assert_eq!(below_zero([1.0, -1.0, 1.0]), Meeting::NEVER);
}
