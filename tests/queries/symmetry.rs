//! A scene's answers do not depend on the order of its points, on where it is, or on left and right.

use crate::scan;

use proptest::prelude::*;
use scan::{Columns, Random, Setting, columns, converted};
use slicewalk::frame::SLICE_QUANTA;
use slicewalk::plan::Classifier;

/// A pixel size and a step of coordinates that are exact in binary at any distance.
const T: f64 = 1.0 / 16.0;
const STEP: f64 = 1.0 / 4096.0;

fn setting(classifier: Classifier, offset: [f64; 3]) -> Setting {
    Setting { pixel_m: T, slice_m: 3.0 * T, step: STEP, offset, classifier }
}

/// Slopes around the limit, steps, a wall and clutter around the corner of four tiles. Coordinates in x and y are odd
/// multiples of the step: never on a border of a pixel or of its 1/128 parts.
fn scene(seed: u64, slope: f64) -> Vec<[f64; 3]> {
    let mut random = Random(seed);
    let edge = 14.0 * T;
    let count = random.between(500.0, 6000.0) as usize;
    (0..count)
        .map(|n| {
            let (x, y) = (random.between(-edge, edge), random.between(-edge, edge));
            let z = match n % 8 {
                0..=3 => (x * 0.8 + y * 0.6) * slope,
                4 => (x / 0.3).floor() * 0.18 - 2.0,
                5 => random.between(0.0, 2.0),
                6 => -3.0 + random.between(-0.01, 0.01),
                _ => random.between(-10.0, 10.0),
            };
            let x = if n % 8 == 5 { y * 0.3 + 0.2 } else { x };
            let odd = |v: f64| ((v / (2.0 * STEP)).floor() * 2.0 + 1.0) * STEP;
            [odd(x), odd(y), (z / STEP).round() * STEP]
        })
        .collect()
}

fn any_classifier() -> impl Strategy<Value = Classifier> {
    prop::sample::select(Classifier::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_order_of_points_gives_the_same_bytes(
        seed: u64, order: u64, slope in 0.3f64..2.0, classifier in any_classifier()
    ) {
        let mut points = scene(seed, slope);
        let first = converted(&points, setting(classifier, [0.0; 3])).1;
        let mut random = Random(order);
        for at in (1..points.len()).rev() {
            points.swap(at, random.between(0.0, (at + 1) as f64) as usize);
        }
        prop_assert!(first == converted(&points, setting(classifier, [0.0; 3])).1);
    }

    #[test]
    fn whole_tiles_and_slices_away_the_spans_and_verdicts_are_the_same(
        seed: u64, slope in 0.3f64..2.0, classifier in any_classifier(),
        tiles in prop::array::uniform2(-2_500_000i64..2_500_000), slices in -10_000_000i64..10_000_000
    ) {
        let points = scene(seed, slope);
        let offset = [tiles[0] as f64 * 64.0 * T, tiles[1] as f64 * 64.0 * T, slices as f64 * 3.0 * T];
        let moved: Vec<_> = points.iter().map(|p| [0, 1, 2].map(|a| p[a] + offset[a])).collect();
        let here = columns(converted(&points, setting(classifier, [0.0; 3])).1);
        let there = columns(converted(&moved, setting(classifier, offset)).1);
        let up = slices * SLICE_QUANTA;
        let expected: Columns = here
            .into_iter()
            .map(|([i, j], spans)| {
                let spans = spans.into_iter().map(|(bottom, top, kind)| (bottom + up, top + up, kind));
                ([i + tiles[0] * 64, j + tiles[1] * 64], spans.collect())
            })
            .collect();
        prop_assert_eq!(there, expected);
    }

    #[test]
    fn mirrored_points_give_mirrored_spans_and_verdicts(
        seed: u64, slope in 0.3f64..2.0, classifier in any_classifier(), axis in 0usize..2
    ) {
        let points = scene(seed, slope);
        let mut mirrored = points.clone();
        mirrored.iter_mut().for_each(|p| p[axis] = -p[axis]);
        let plain = columns(converted(&points, setting(classifier, [0.0; 3])).1);
        let found = columns(converted(&mirrored, setting(classifier, [0.0; 3])).1);
        let expected: Columns = plain
            .into_iter()
            .map(|(mut pixel, spans)| {
                pixel[axis] = -1 - pixel[axis];
                (pixel, spans)
            })
            .collect();
        prop_assert_eq!(found, expected);
    }
}
