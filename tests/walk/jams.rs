//! Crowds where there is no room: doors, pawns on one spot, pawns that fall upon others; who joins and who leaves.

use super::world::*;
use nalgebra::{Point2, Point3};
use slicewalk::store::Store;
use slicewalk::walk::*;

const TICK: f64 = 1.0 / 60.0;

fn walker(body: Body, at: [f64; 3]) -> Walker {
    Walker::new(Config { tick_s: TICK, ..config(body) }, Point3::from(at)).unwrap()
}

/// How deep two pawns are in each other (m), above 0 if they are.
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
    pairs.filter(|&(n, m)| depth(&walkers[n], &walkers[m]) > 1e-6).count()
}

/// How far a pawn is on its way through a door at the origin, and where it wants to be.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Rule {
    /// Through the middle of the door, to 1 cm, then on: waypoints as they are taken by a route.
    Waypoint,
    /// Through the middle of the door, to 30 cm.
    Near,
    /// Toward the middle of the door until it is in it.
    Past,
    /// Through a place of its own in the door, to a place of its own behind it.
    Own,
}

/// Frames until all of 20 pawns are through, and how many are after a minute.
fn through(store: &Store, bodies: [Body; 2], rule: Rule) -> (usize, usize) {
    let at = |n: usize| [-3.2 + 0.62 * (n / 5) as f64, -1.3 + 0.65 * (n % 5) as f64, 0.03];
    let walkers = (0..20).map(|n| walker(bodies[n % 2], at(n)));
    let mut crowd = Crowd::new(walkers.collect()).unwrap();
    let mut passed = [false; 20];
    for frame in 1..=3600 {
        crowd.step(store, TICK, |n, feet| {
            let own = if rule == Rule::Own { at(n)[1] } else { 0.0 };
            let (door, on) = (Point2::new(0.0, 0.1 * own), Point2::new(3.5, own));
            let away = (feet.xy() - door).norm();
            passed[n] |= match rule {
                Rule::Waypoint => away <= 0.01,
                Rule::Near => away <= 0.3,
                Rule::Past | Rule::Own => feet.x > -0.1,
            };
            Wish::Toward(if passed[n] { on } else { door })
        });
        assert_eq!(pairs_inside(&crowd), 0, "frame {frame}");
        if crowd.walkers().iter().all(|walker| walker.feet().x > 0.3) {
            return (frame, 20);
        }
    }
    (3600, crowd.walkers().iter().filter(|walker| walker.feet().x > 0.3).count())
}

#[test]
fn a_crowd_passes_through_a_door_one_after_the_other() {
    // As wide as two pawns; what a scan leaves of a metre; and wide enough for one.
    for half in [10, 9, 7] {
        let store = room(4, |(i, j)| (-1..=0).contains(&i) && !(-half..half).contains(&j));
        for bodies in [[BOX, BOX], [CYLINDER, CYLINDER], [BOX, CYLINDER]] {
            for rule in [Rule::Waypoint, Rule::Near, Rule::Past, Rule::Own] {
                let (frames, count) = through(&store, bodies, rule);
                let seconds = frames as f64 * TICK;
                assert_eq!(count, 20, "{half} pixels to a side, {bodies:?}, {rule:?}: after {seconds:.1} s");
            }
        }
    }
}

#[test]
fn pawns_on_one_spot_part() {
    let store = room(8, |_| false);
    for (count, body) in [(2, BOX), (20, BOX), (20, CYLINDER), (100, CYLINDER), (100, BOX)] {
        let mut crowd = Crowd::new((0..count).map(|_| walker(body, [0.0, 0.0, 0.03])).collect()).unwrap();
        let mut frames = 0;
        while pairs_inside(&crowd) > 0 {
            crowd.step(&store, TICK, |_, _| Wish::Stay);
            frames += 1;
            assert!(frames < 600, "{count} {body:?}: {} pairs inside each other", pairs_inside(&crowd));
        }
    }
}
