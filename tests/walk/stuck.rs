//! Pawns without progress report it, steps with too much time return the rest, and invalid numbers are refused.

use super::random::Random;
use super::world::*;
use nalgebra::{Point2, Point3, Vector2};
use slicewalk::walk::*;
use std::collections::BTreeSet;

/// Pixels of rough walls at random angles, some of them forming a pocket on the path of a pawn that walks from the
/// origin along x.
fn rough_walls(random: &mut Random) -> BTreeSet<(i64, i64)> {
    let mut pixels = BTreeSet::new();
    for _ in 0..3 {
        let (middle, angle) =
            (Point2::new(random.between(0.7, 1.5), random.between(-0.8, 0.8)), random.between(0.0, 180.0).to_radians());
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
        let mut route = Waypoints::new(vec![goal]).unwrap();
        let (mut frames, mut still) = (0, 0);
        while walker.state() != State::Arrived && still < 120 {
            let report = walker.follow(&store, 1.0 / 60.0, &mut route);
            still = if report.state == State::Blocked { still + 1 } else { 0 };
            frames += 1;
            // An unobstructed path takes two seconds.
            assert!(frames < 60 * 20, "{n}, {body:?}: runs about at {}", walker.feet());
        }
        *(if still > 0 { &mut blocked } else { &mut arrived }) += 1;
    }
    assert!(blocked > 50 && arrived > 50, "{blocked} {arrived}: the test shows little");
}

#[test]
fn a_step_is_bounded_and_gives_the_rest_back() {
    let store = room(2, |_| false);
    let pawn = || Walker::new(config(BOX), Point3::new(-1.0, 0.0, 0.03)).unwrap();
    let tick = pawn().config().tick_s;
    for dt in [3e4, 1e17, f64::MAX] {
        let report = pawn().step(&store, dt, MoveInput::Stay);
        assert_eq!((report.ticks, report.state), (MOST_TICKS, State::Walking));
        assert!((report.unspent - (dt - f64::from(MOST_TICKS) * tick)).abs() <= 1e-9 * dt, "{dt}: {}", report.unspent);
    }
    for dt in [-1.0, f64::NAN, f64::INFINITY] {
        let report = pawn().step(&store, dt, MoveInput::Stay);
        assert_eq!((report.ticks, report.unspent), (0, 0.0));
    }
    // A caller that passes the rest on loses no time.
    let (mut walker, mut dt, mut ticks) = (pawn(), 5.0, 0);
    while dt > 0.0 {
        let report = walker.step(&store, dt, MoveInput::Direction(Vector2::x() * 0.2));
        (dt, ticks) = (report.unspent, ticks + report.ticks);
    }
    assert_eq!(ticks, 1200);
    assert!((walker.feet().x - 0.4).abs() < 1e-9, "{}", walker.feet());
}

#[test]
fn numbers_beyond_their_limits_are_refused_and_no_pawn_gets_farther_than_its_world() {
    type Change = fn(&mut Config);
    let with = |change: Change| {
        let mut config = config(BOX);
        change(&mut config);
        Walker::new(config, Point3::origin()).map_err(|error| error.to_string())
    };
    let wrong: [(&str, Change); 9] = [
        ("speed: 2000", |c| c.speed = 2000.0),
        ("speed: NaN", |c| c.speed = f64::NAN),
        ("climb height: 1.8", |c| c.climb = 1.8),
        ("gravity: -1", |c| c.gravity = -1.0),
        ("terminal speed: 0", |c| c.terminal = 0.0),
        ("tick: 1e-6", |c| c.tick_s = 1e-6),
        ("tick: 2", |c| c.tick_s = 2.0),
        ("pawn's width: 2000", |c| c.body = Body::Cylinder { radius: 1000.0, height: 2.0 }),
        ("pawn's height: 0", |c| c.body = Body::Box { x: 1.0, y: 1.0, height: 0.0 }),
    ];
    for (said, change) in wrong {
        let error = with(change).unwrap_err();
        assert!(error.contains(said) && error.contains("(expected "), "{error}");
    }
    assert!(Walker::new(config(BOX), Point3::new(1e300, 0.0, 0.0)).is_err());
    for places in [vec![], vec![Point2::new(0.0, f64::NAN)], vec![Point2::origin(), Point2::new(f64::INFINITY, 0.0)]] {
        let error = Waypoints::new(places).unwrap_err().to_string();
        assert!(error.contains("waypoints: expected at least one place"), "{error}");
    }
    let store = room(2, |_| false);
    let fast = Config { speed: 1000.0, ..config(BOX) };
    let mut walker = Walker::new(fast, Point3::new(1e9, 0.0, 0.0)).unwrap();
    walker.place(Point3::new(f64::MAX, 0.0, 0.0));
    for wish in [MoveInput::Direction(Vector2::new(1e300, 1e300)), MoveInput::Toward(Point2::new(f64::MAX, f64::MAX))] {
        walker.step(&store, 1.0, wish);
        assert!(walker.feet().iter().all(|v| v.abs() <= 1e9), "{}", walker.feet());
    }
}
