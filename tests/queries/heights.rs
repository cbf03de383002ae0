//! Guarantee G3: the ends of a span enclose its points and exceed them by at most one quantum.

use crate::scan;

use scan::{Random, Setting, columns, converted};
use slicewalk::frame::{Frame, SLICE_QUANTA};
use slicewalk::plan::Classifier;
use std::collections::BTreeMap;

const T: f64 = 0.05;

/// Floors, a slope, a wall and clutter in 40 × 40 pixels, across the corner of four tiles.
fn scene(random: &mut Random, sigma: f64) -> Vec<[f64; 3]> {
    let edge = 20.0 * T;
    let mut points = Vec::new();
    for n in 0..9000 {
        let (x, y) = (random.between(-edge, edge), random.between(-edge, edge));
        let z = match n % 6 {
            0 | 1 => random.between(-0.002, 0.002),
            2 => 2.4 * sigma + x * 0.6,
            3 => random.between(0.0, 9.0 * sigma),
            4 => -1.3 * sigma + random.between(-0.002, 0.002),
            _ => random.between(-70.0 * sigma, 70.0 * sigma),
        };
        let x = if n % 6 == 3 { 0.37 * T + x * 1e-3 } else { x };
        points.push([x, y, z]);
    }
    points
}

#[test]
fn spans_end_at_most_one_quantum_outside_their_extreme_points() {
    for (seed, sigma) in [(1, 0.15), (2, 0.1), (3, 0.37), (4, 1.0), (5, 0.05)] {
        for shift in [0.0, 1e7] {
            for classifier in Classifier::ALL {
                let offset = [shift, -shift, shift / 10.0];
                let mut random = Random(seed);
                let points: Vec<_> =
                    scene(&mut random, sigma).iter().map(|p| [0, 1, 2].map(|a| p[a] + offset[a])).collect();
                let setting = Setting { pixel_m: T, slice_m: sigma, step: 1e-4, offset, classifier };
                let (points, bytes) = converted(&points, setting);
                let frame = Frame::new(T, sigma).unwrap();
                let mut by_pixel: BTreeMap<[i64; 2], Vec<f64>> = BTreeMap::new();
                for p in &points {
                    by_pixel.entry([frame.pixel_of(p[0]), frame.pixel_of(p[1])]).or_default().push(p[2]);
                }
                let columns = columns(bytes);
                assert_eq!(columns.len(), by_pixel.len());
                for (pixel, spans) in columns {
                    check(&frame, &by_pixel[&pixel], &spans, shift);
                }
            }
        }
    }
}

/// Where floor meets obstacle, a span ends on a slice boundary and not at a point; such spans are checked together.
fn check(frame: &Frame, heights: &[f64], spans: &[(i64, i64, bool)], shift: f64) {
    let mut runs: Vec<(i64, i64)> = Vec::new();
    for &(bottom, top, _) in spans {
        match runs.last_mut() {
            Some(below) if below.1 == bottom && bottom % SLICE_QUANTA == 0 => below.1 = top,
            _ => runs.push((bottom, top)),
        }
    }
    let slack = frame.quantum_m() + shift * f64::EPSILON * 4.0;
    let mut inside = 0;
    for (bottom, top) in runs {
        let (low, high) = (frame.bottom_height(bottom), frame.top_height(top));
        let own = heights.iter().filter(|z| (low..=high).contains(*z));
        let (least, greatest, count) =
            own.fold((f64::INFINITY, f64::NEG_INFINITY, 0), |(a, b, n), &z| (a.min(z), b.max(z), n + 1));
        assert!(count > 0, "no point between {low} and {high}");
        assert!(least - low <= slack && high - greatest <= slack, "{low}..{high} around {least}..{greatest}");
        inside += count;
    }
    assert!(inside >= heights.len(), "{} points, {inside} in spans", heights.len());
}

#[test]
fn a_floor_on_a_slice_boundary_is_one_span() {
    for (sigma, shift) in [(0.15, 0.0), (0.15, 1e7), (0.06, 0.0), (0.45, 1e7)] {
        for boundary in [-64.0, -1.0, 0.0, 1.0, 64.0] {
            for classifier in [Classifier::Span, Classifier::Plane] {
                let mut random = Random(11);
                let offset = [shift, shift, 0.0];
                let edge = 20.0 * T;
                let points: Vec<_> = (0..12_000)
                    .map(|_| {
                        let [x, y] = [0, 1].map(|_| shift + random.between(-edge, edge));
                        [x, y, boundary * sigma + random.between(-0.006, 0.006)]
                    })
                    .collect();
                let setting = Setting { pixel_m: T, slice_m: sigma, step: 1e-4, offset, classifier };
                let (_, bytes) = converted(&points, setting);
                for (pixel, spans) in columns(bytes) {
                    assert!(
                        matches!(spans[..], [(_, _, false)]),
                        "{classifier:?} {sigma} {boundary} {pixel:?}: {spans:?}"
                    );
                }
            }
        }
    }
}
