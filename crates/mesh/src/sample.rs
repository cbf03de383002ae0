//! Triangles to points at most one step apart: the thesis' oversampling (algorithm 3.2).
//!
//! Kept for comparison with [`raster`](super::raster): points miss pixels whose corners a triangle cuts, whatever the
//! step.
//!
//! *Follows the thesis' text, not its listing.* The printed algorithm walks away from the triangle (`a + i/n·(a − b)`),
//! never advances the counters of its outer loops, and uses one edge's count for another. The text and figure 3.5 are
//! clear: points walk along `ab` and `ac` one step at a time, and the segment between each pair is filled at the step.
//! When the shorter edge is used up, its walker continues along the third edge, until both reach the end.

use super::Triangle;

/// Calls `give` with the corners and, if an edge is longer than `step_m` (m, > 0), with points in the triangle.
pub fn oversample(triangle: &Triangle, step_m: f64, mut give: impl FnMut([f64; 3])) {
    let &[a, b, c] = triangle;
    triangle.iter().for_each(|&corner| give(corner));
    let steps = |p: [f64; 3], q: [f64; 3]| distance(p, q) / step_m;
    let (ab, ac, bc) = (steps(a, b), steps(a, c), steps(b, c));
    if ab.max(ac).max(bc) <= 1.0 {
        return;
    }
    let mut line = |p: [f64; 3], q: [f64; 3], ends: [bool; 2]| {
        let count = steps(p, q);
        if ends[0] {
            give(p);
        }
        for k in (1..).map(f64::from).take_while(|&k| k < count) {
            give(between(p, q, k / count));
        }
        if ends[1] {
            give(q);
        }
    };
    let (shorter, longer) = (ab.min(ac), ab.max(ac));
    for i in (1..).map(f64::from).take_while(|&i| i < shorter) {
        line(between(a, b, i / ab), between(a, c, i / ac), [true; 2]);
    }
    // `far` ends the longer edge, `near` the shorter; the second walker continues from `near` towards `far`.
    let (far, near) = if ab > ac { (b, c) } else { (c, b) };
    let begun = shorter.ceil().max(1.0);
    for k in (0..).map(f64::from) {
        let i = begun + k;
        if i >= longer && k >= bc {
            return;
        }
        let (on_long, on_third) = (i < longer, k < bc);
        let p = if on_long { between(a, far, i / longer) } else { far };
        let q = if on_third { between(near, far, k / bc) } else { far };
        // A walker at a corner gives nothing: corners are given once, above.
        line(p, q, [on_long, on_third && k > 0.0]);
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (b[k] - a[k]) * (b[k] - a[k])).sum::<f64>().sqrt()
}

/// Interpolates; clamps to the bounding box of the two, so that rounding leaves all points within the bounds of the
/// corners.
fn between(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
    [0, 1, 2].map(|k| (a[k] + (b[k] - a[k]) * share).clamp(a[k].min(b[k]), a[k].max(b[k])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_place_of_the_triangle_has_a_point_within_a_step(
            corners in prop::array::uniform3(prop::array::uniform3(-3.0f64..3.0)),
            step in 0.2f64..4.0, p in 0.0f64..1.0, q in 0.0f64..1.0
        ) {
            let (p, q) = if p + q > 1.0 { (1.0 - p, 1.0 - q) } else { (p, q) };
            let [a, b, c] = corners;
            let place = [0, 1, 2].map(|k| a[k] + p * (b[k] - a[k]) + q * (c[k] - a[k]));
            let mut nearest = f64::INFINITY;
            let mut count = 0u32;
            let end = |pick: fn(f64, f64) -> f64, axis: usize| {
                corners.iter().map(|corner| corner[axis]).reduce(pick).unwrap()
            };
            let mut inside = true;
            oversample(&corners, step, |point| {
                nearest = nearest.min(distance(point, place));
                count += 1;
                inside &= (0..3).all(|axis| (end(f64::min, axis)..=end(f64::max, axis)).contains(&point[axis]));
            });
            prop_assert!(inside);
            // Lines are at most one step apart, and so are points on them.
            prop_assert!(nearest <= step * 1.0001, "{nearest}");
            prop_assert!(f64::from(count) < 40.0 + 400.0 / (step * step));
        }
    }

    #[test]
    fn a_triangle_smaller_than_a_step_is_its_corners() {
        let mut points = Vec::new();
        oversample(&[[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]], 1.0, |point| points.push(point));
        assert_eq!(points.len(), 3);
    }
}
