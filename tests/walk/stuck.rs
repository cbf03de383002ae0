//! Pawns that get nowhere say so; steps that are given too much time give it back; numbers that are none are refused.

use super::world::*;
use nalgebra::{Point2, Point3, Vector2};
use slicewalk::walk::*;
use std::collections::BTreeSet;

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Pixels of rough walls at any angle, some of them in a pocket about the way of a pawn that walks from the origin along x.
fn rough_walls(random: &mut Random) -> BTreeSet<(i64, i64)> {
    let mut pixels = BTreeSet::new();
    for _ in 0..3 {
        let (middle, angle) =
            (Point2::new(random.between(0.7, 1.5), random.between(-0.8, 0.8)), random.between(0.0, 3.14));
        let half = random.between(0.3, 1.2);
        let steps = (half / T * 4.0) as i64;
        for n in -steps..=steps {
            let rough = random.between(-0.6, 0.6) * T;
            let along = n as f64 / steps as f64 * half;
            let at = middle
                + Vector2::new(angle.cos() * along - angle.sin() * rough, angle.sin() * along + angle.cos() * rough);
            if at.coords.norm() > 0.55 {
                pixels.insert(((at.x / T).floor() as i64, (at.y / T).floor() as i64));
            }
        }
    }
    pixels
}

#[test]
fn a_pawn_that_gets_nowhere_is_blocked() {
    let mut random = Random(3);
    let (mut blocked, mut arrived) = (0, 0);
    for n in 0..400 {
        let walls = rough_walls(&mut random);
        let store = room(2, |pixel| walls.contains(&pixel));
        let body = [CYLINDER, BOX][n % 3 % 2];
        let goal = Point2::new(2.6, random.between(-0.6, 0.6));
        let mut walker = Walker::new(config(body), Point3::new(0.0, 0.0, 0.03)).unwrap();
        let mut route = Route::new(vec![goal]).unwrap();
        let (mut frames, mut still) = (0, 0);
        while walker.state() != State::Arrived && still < 120 {
            let report = walker.follow(&store, 1.0 / 60.0, &mut route);
            still = if report.state == State::Blocked { still + 1 } else { 0 };
            frames += 1;
            // A free way takes two seconds.
            assert!(frames < 60 * 20, "{n}, {body:?}: runs about at {}", walker.feet());
        }
        *(if still > 0 { &mut blocked } else { &mut arrived }) += 1;
    }
    assert!(blocked > 50 && arrived > 50, "{blocked} {arrived}: the test shows little");
}
