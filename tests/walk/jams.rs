//! Crowds without room: doors, pawns on one spot, pawns that fall onto others, pawns that join and leave.

use super::world::*;
use nalgebra::{Point2, Point3, Vector2};
use slicewalk::store::Snapshot;
use slicewalk::walk::*;

const TICK: f64 = 1.0 / 60.0;

fn walker(body: Body, at: [f64; 3]) -> Walker {
    Walker::new(Config { tick_s: TICK, ..config(body) }, Point3::from(at)).unwrap()
}

/// Penetration depth of two pawns (m), positive if they overlap.
fn depth(a: &Walker, b: &Walker) -> f64 {
    let (p, q) = (a.feet(), b.feet());
    let apart = (p - q).xy();
    let across = match (a.config().body, b.config().body) {
        (Body::Cylinder { radius: r, .. }, Body::Cylinder { radius: s, .. }) => r + s - apart.norm(),
        (a, b) => (a.half() + b.half() - apart.abs()).min(),
    };
    let up = (p.z + a.config().body.height() - q.z).min(q.z + b.config().body.height() - p.z);
    across.min(up)
}

fn pairs_inside(crowd: &Crowd) -> usize {
    let walkers = crowd.walkers();
    let pairs = (0..walkers.len()).flat_map(|n| (0..n).map(move |m| (n, m)));
    pairs.filter(|&(n, m)| depth(&walkers[n], &walkers[m]) > 1e-7).count()
}

/// Where a pawn's path through a door at the origin ends and the next one begins.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Rule {
    /// In the middle of the door, to 1 cm, like a route's waypoint.
    Waypoint,
    /// 30 cm from the middle.
    Near,
    /// Anywhere in the door.
    Past,
    /// Anywhere in the door, and each pawn aims at its own place.
    Own,
}

/// Returns how many of 20 pawns pass a door within a minute, and when the last of them does (s).
fn through(store: &Snapshot, bodies: [Body; 2], rule: Rule) -> (usize, f64) {
    let at = |n: usize| [-3.2 + 0.62 * (n / 5) as f64, -1.3 + 0.65 * (n % 5) as f64, 0.03];
    let mut crowd = Crowd::new((0..20).map(|n| walker(bodies[n % 2], at(n))).collect()).unwrap();
    let mut passed = [false; 20];
    let is_through = |walker: &&Walker| walker.feet().x > 0.3;
    let mut frames = 0;
    while frames < 3600 && !crowd.walkers().iter().all(|walker| is_through(&walker)) {
        frames += 1;
        crowd.step(store, TICK, |n, feet| {
            let own = if rule == Rule::Own { at(n)[1] } else { 0.0 };
            let (door, on) = (Point2::new(0.0, 0.1 * own), Point2::new(5.5, own));
            let away = (feet.xy() - door).norm();
            passed[n] |= match rule {
                Rule::Waypoint => away <= 0.01,
                Rule::Near => away <= 0.3,
                Rule::Past | Rule::Own => feet.x > -0.1,
            };
            MoveInput::Toward(if passed[n] { on } else { door })
        });
        assert_eq!(pairs_inside(&crowd), 0, "{bodies:?}, {rule:?}, frame {frames}");
    }
    (crowd.walkers().iter().filter(is_through).count(), f64::from(frames) * TICK)
}

#[test]
fn a_crowd_passes_through_a_door_one_after_the_other() {
    // As wide as two pawns; as what a scan leaves of a metre; and wide enough for one.
    for half in [10, 9, 7] {
        let store = room(4, |(i, j)| (-1..=0).contains(&i) && !(-half..half).contains(&j));
        for bodies in [[BOX, BOX], [CYLINDER, CYLINDER], [BOX, CYLINDER]] {
            for rule in [Rule::Waypoint, Rule::Near, Rule::Past, Rule::Own] {
                if rule == Rule::Own && half < 10 {
                    // Some of these places are where no pawn can stand.
                    continue;
                }
                let (count, seconds) = through(&store, bodies, rule);
                let what = format!("{half} pixels to a side, {bodies:?}, {rule:?}");
                println!("{what}: {count} in {seconds:.1} s");
                assert_eq!(count, 20, "{what}: after {seconds:.1} s");
            }
        }
    }
}

#[test]
fn those_who_come_from_both_sides_of_a_door_pass() {
    let store = room(4, |(i, j)| (-1..=0).contains(&i) && !(-9..9).contains(&j));
    let side = |n: usize| if n.is_multiple_of(2) { 1.0 } else { -1.0 };
    let at = |n: usize| [-side(n) * (1.0 + 0.7 * (n / 6) as f64), -0.7 + 0.7 * (n / 2 % 3) as f64, 0.03];
    let mut crowd = Crowd::new((0..12).map(|n| walker(CYLINDER, at(n))).collect()).unwrap();
    let mut passed = [false; 12];
    let mut frames = 0;
    while !crowd.walkers().iter().enumerate().all(|(n, walker)| walker.feet().x * side(n) > 0.3) {
        crowd.step(&store, TICK, |n, feet| {
            passed[n] |= feet.x * side(n) > -0.1;
            let on = Point2::new(2.5 * side(n), (n as f64 - 6.0) * 0.3);
            MoveInput::Toward(if passed[n] { on } else { Point2::origin() })
        });
        frames += 1;
        assert_eq!(pairs_inside(&crowd), 0, "frame {frames}");
        assert!(frames < 1800, "{:?}", crowd.walkers().iter().map(Walker::feet).collect::<Vec<_>>());
    }
}

#[test]
fn pawns_on_one_spot_part() {
    let hall = room(8, |_| false);
    let closet = room(4, |(i, j)| i.abs() > 25 || j.abs() > 25);
    let corridor = room(4, |(_, j)| !(-6..6).contains(&j));
    for (store, count, body, apart) in [
        (&hall, 2, BOX, 0.0),
        (&hall, 20, BOX, 0.0),
        (&hall, 20, CYLINDER, 0.0),
        (&hall, 100, CYLINDER, 0.0),
        (&hall, 100, BOX, 0.0),
        (&closet, 8, BOX, 0.02),
        (&closet, 8, CYLINDER, 0.02),
        (&corridor, 3, BOX, 0.02),
        (&corridor, 3, CYLINDER, 0.02),
    ] {
        let at = |n: usize| [apart * n as f64, if n.is_multiple_of(2) { apart } else { -apart }, 0.03];
        let mut crowd = Crowd::new((0..count).map(|n| walker(body, at(n))).collect()).unwrap();
        let mut frames = 0;
        while pairs_inside(&crowd) > 0 {
            crowd.step(store, TICK, |_, _| MoveInput::Stay);
            frames += 1;
            assert!(frames < 900, "{count} {body:?}: {} pairs inside each other", pairs_inside(&crowd));
        }
        for _ in 0..60 {
            crowd.step(store, TICK, |_, _| MoveInput::Stay);
            assert_eq!(pairs_inside(&crowd), 0, "{count} {body:?}: they stay apart");
        }
    }
}

#[test]
fn who_falls_upon_another_stands_on_its_head() {
    let store = room(4, |_| false);
    for (height, aside) in [(8.0, 0.0), (8.0, 0.2), (8.0, 0.3), (6.0, 0.45)] {
        let mut crowd =
            Crowd::new(vec![walker(BOX, [0.0, 0.0, 0.03]), walker(CYLINDER, [aside, 0.1, height])]).unwrap();
        let frame = |crowd: &mut Crowd, way: Vector2<f64>| {
            crowd.step(&store, TICK, |n, _| if n == 0 { MoveInput::Direction(way) } else { MoveInput::Stay });
            assert_eq!(pairs_inside(crowd), 0, "{height} m, {aside} m aside");
        };
        (0..180).for_each(|_| frame(&mut crowd, Vector2::zeros()));
        let [below, above] = [0, 1].map(|n| crowd.walkers()[n].feet().z);
        assert!((above - below - 1.8).abs() < 1e-9, "at {above} m over {below} m");
        assert_eq!(crowd.walkers()[1].state(), State::Walking);
        // When the lower pawn leaves, the other falls to the floor.
        (0..180).for_each(|_| frame(&mut crowd, Vector2::x()));
        assert_eq!(crowd.walkers()[1].feet().z, below);
    }
}

#[test]
fn a_pawn_in_a_post_is_not_pushed_into_another() {
    let store = room(2, |(x, y)| (0..4).contains(&x) && (0..4).contains(&y));
    // The second one stands where the nearest way out of the post leads.
    let mut crowd = Crowd::new(vec![walker(BOX, [-0.1, 0.1, 0.03]), walker(BOX, [-0.65, 0.1, 0.03])]).unwrap();
    for _ in 0..30 {
        crowd.step(&store, TICK, |_, _| MoveInput::Stay);
        assert_eq!(pairs_inside(&crowd), 0);
        assert_eq!(crowd.walkers()[0].feet().xy(), Point2::new(-0.1, 0.1));
    }
    crowd.remove(1);
    crowd.step(&store, TICK, |_, _| MoveInput::Stay);
    let out = crowd.walkers()[0].feet();
    assert!((out.x + 0.25).abs() < 0.01 && (out.y - 0.1).abs() < 0.01, "{out}");
}

#[test]
fn pawns_join_and_leave() {
    let store = room(4, |_| false);
    let place = Point2::new(0.0, 0.0);
    let mut crowd = Crowd::new(Vec::new()).unwrap();
    for n in 0..12 {
        assert_eq!(crowd.add(walker(CYLINDER, [-3.0, -3.0 + 0.55 * n as f64, 0.03])).unwrap(), n);
    }
    let slow = Walker::new(config(BOX), Point3::origin()).unwrap();
    assert!(crowd.add(slow).unwrap_err().to_string().contains("expected 0.016"), "ticks of another length");
    let settle = |crowd: &mut Crowd| {
        for _ in 0..3600 {
            if crowd.step(&store, TICK, |_, _| MoveInput::Toward(place)).arrived == crowd.walkers().len() {
                return;
            }
        }
        panic!("not all settle: {:?}", crowd.walkers().iter().map(Walker::state).collect::<Vec<_>>());
    };
    let nearest = |crowd: &Crowd| {
        let distances = crowd.walkers().iter().map(|walker| (walker.feet().xy() - place).norm());
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
    };
    settle(&mut crowd);
    // The middle pawn leaves, and another takes its place.
    let (number, distance) = nearest(&crowd);
    assert!(distance <= 0.01);
    let after = crowd.walkers()[(number + 1) % 12].feet();
    let gone = crowd.remove(number).unwrap();
    assert!((gone.feet().xy() - place).norm() <= 0.01 && crowd.remove(99).is_none());
    assert!(number == 11 || crowd.walkers()[number].feet() == after, "those after it move up");
    settle(&mut crowd);
    assert!(nearest(&crowd).1 <= 0.01, "{}", nearest(&crowd).1);
    // Into the middle of all of them.
    crowd.add(walker(BOX, [0.1, 0.1, 0.03])).unwrap();
    for _ in 0..600 {
        crowd.step(&store, TICK, |_, _| MoveInput::Stay);
    }
    assert_eq!(pairs_inside(&crowd), 0);
    while !crowd.walkers().is_empty() {
        crowd.remove(0);
        crowd.step(&store, TICK, |_, _| MoveInput::Stay);
    }
}

#[test]
fn a_step_of_a_crowd_is_bounded_and_works_as_far_out_as_pawns_can_be() {
    let store = room(2, |_| false);
    let mut crowd = Crowd::new(vec![walker(BOX, [0.0, 0.0, 0.03]), walker(CYLINDER, [1e9, -1e9, 1e9])]).unwrap();
    for dt in [3e4, 1e17, f64::MAX] {
        let report = crowd.step(&store, dt, |_, _| MoveInput::Direction(Vector2::new(1e300, -1e300)));
        assert_eq!(report.ticks, MOST_TICKS);
        assert!((report.unspent - (dt - f64::from(MOST_TICKS) * TICK)).abs() <= 1e-9 * dt, "{dt}: {}", report.unspent);
    }
    let report = crowd.step(&store, f64::NAN, |_, _| MoveInput::Stay);
    assert_eq!((report.ticks, report.unspent), (0, 0.0));
    assert!(crowd.walkers().iter().all(|walker| walker.feet().iter().all(|v| v.abs() <= 1e9)));
}
