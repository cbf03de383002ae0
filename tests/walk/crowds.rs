//! Many pawns in one world.

use super::world::*;
use nalgebra::{Point2, Point3, Vector2};
use slicewalk::store::{Snapshot, Stream, StreamOptions};
use slicewalk::walk::*;

const TICK: f64 = 1.0 / 60.0;

fn hall(half: f64) -> Snapshot {
    let scene = scene(|b| {
        b.level("floor", [-half, -half, half, half], 0.0, &[]);
        for [x, y] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            b.column("column", [x * half / 2.0, y * half / 2.0], 0.3, [0.0, 3.0]);
        }
    });
    let (_dir, archive) = convert_at(&scene, 0.001, 900.0);
    Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap()
}

fn crowd(count: usize, spacing: f64) -> (Crowd, Vec<Point2<f64>>) {
    let side = (count as f64).sqrt().ceil() as usize;
    let place = |n: usize| {
        let at = |k: usize| (k as f64 - (side - 1) as f64 / 2.0) * spacing;
        Point2::new(at(n % side), at(n / side))
    };
    let walkers = (0..count).map(|n| {
        let body = if n % 2 == 0 { BOX } else { CYLINDER };
        let config = Config { tick_s: TICK, ..config(body) };
        Walker::new(config, Point3::new(place(n).x, place(n).y, 0.01)).unwrap()
    });
    let crowd = Crowd::new(walkers.collect()).unwrap();
    // All pawns go to the other side of the hall, through those coming from there.
    let goals = (0..count).map(|n| Point2::new(-place(n).x, place(n).y)).collect();
    (crowd, goals)
}

fn gap(a: &Walker, b: &Walker) -> f64 {
    let apart = (a.feet() - b.feet()).xy();
    match (a.config().body, b.config().body) {
        (Body::Cylinder { radius: r, .. }, Body::Cylinder { radius: s, .. }) => apart.norm() - r - s,
        (a, b) => (apart.abs() - a.half() - b.half()).max(),
    }
}

#[test]
fn pawns_never_enter_each_other_and_the_outcome_is_always_the_same() {
    let store = hall(12.0);
    let run = || {
        let (mut crowd, goals) = crowd(100, 1.8);
        for _ in 0..1800 {
            crowd.step(&store, TICK, |n, _| MoveInput::Toward(goals[n]));
            for (n, a) in crowd.walkers().iter().enumerate().filter(|(n, _)| n % 3 == 0) {
                for b in &crowd.walkers()[..n] {
                    assert!(gap(a, b) > -1e-7, "{} and {} overlap by {}", a.feet(), b.feet(), -gap(a, b));
                }
            }
        }
        let near = |(walker, goal): (&Walker, &Point2<f64>)| (walker.feet().xy() - goal).norm() < 2.0;
        let arrived = crowd.walkers().iter().zip(&goals).filter(|pair| near(*pair)).count();
        (crowd.walkers().iter().map(Walker::feet).collect::<Vec<_>>(), arrived)
    };
    let (places, arrived) = run();
    println!("{arrived} of 100 get across");
    assert!(arrived > 100 * 3 / 4, "{arrived} of 100 get across");
    assert_eq!(places, run().0);
}

#[test]
fn two_pawns_that_meet_head_on_pass() {
    let store = hall(8.0);
    for bodies in [[BOX, BOX], [CYLINDER, CYLINDER], [BOX, CYLINDER]] {
        let walker = |n: usize, x: f64| {
            let config = Config { tick_s: TICK, ..config(bodies[n]) };
            Walker::new(config, Point3::new(x, 0.0, 0.0)).unwrap()
        };
        let mut crowd = Crowd::new(vec![walker(0, -2.0), walker(1, 2.0)]).unwrap();
        let goals = [Point2::new(2.0, 0.0), Point2::new(-2.0, 0.0)];
        for _ in 0..360 {
            crowd.step(&store, TICK, |n, _| MoveInput::Toward(goals[n]));
        }
        for (walker, goal) in crowd.walkers().iter().zip(goals) {
            assert!((walker.feet().xy() - goal).norm() < 0.05, "{bodies:?}: at {}", walker.feet());
        }
    }
}

#[test]
fn pawns_that_begin_in_each_other_part() {
    let store = hall(8.0);
    let config = Config { tick_s: TICK, ..config(CYLINDER) };
    let at = |x: f64, y: f64| Walker::new(config, Point3::new(x, y, 0.0)).unwrap();
    let mut crowd = Crowd::new(vec![at(0.0, 0.0), at(0.1, 0.0), at(0.0, 0.2), at(0.0, 0.0)]).unwrap();
    for _ in 0..240 {
        crowd.step(&store, TICK, |_, _| MoveInput::Stay);
    }
    for (n, a) in crowd.walkers().iter().enumerate() {
        for b in &crowd.walkers()[..n] {
            assert!(gap(a, b) > -1e-6, "{} and {}", a.feet(), b.feet());
        }
    }
}

/// Runs frames until all have settled; returns their number and the greatest distance from `goal`, and checks that no
/// two pawns overlap meanwhile.
fn converge(crowd: &mut Crowd, store: &Snapshot, goal: Point2<f64>, most: usize) -> (usize, f64) {
    let mut frames = 0;
    loop {
        let report = crowd.step(store, TICK, |_, _| MoveInput::Toward(goal));
        frames += 1;
        if frames % 16 == 0 {
            for (n, a) in crowd.walkers().iter().enumerate() {
                for b in &crowd.walkers()[..n] {
                    assert!(gap(a, b) > -1e-7, "{} and {} overlap by {}", a.feet(), b.feet(), -gap(a, b));
                }
            }
        }
        if report.arrived == crowd.walkers().len() {
            break;
        }
        let open = || {
            crowd.walkers().iter().find(|w| w.state() != State::Arrived).map(|w| (w.feet(), w.state(), w.config().body))
        };
        assert!(frames < most, "{} of {} have settled, not {:?}", report.arrived, crowd.walkers().len(), open());
    }
    (frames, crowd.walkers().iter().map(|walker| (walker.feet().xy() - goal).norm()).fold(0.0, f64::max))
}

#[test]
fn a_crowd_that_wants_to_one_place_settles_around_it() {
    let store = hall(12.0);
    let (mut crowd, _) = crowd(150, 1.6);
    // Pawns from all sides, and pawns in a crowd that is already packed, which leaves a tail behind.
    for (goal, most) in [(Point2::new(0.3, 0.1), 1.5), (Point2::new(4.0, -3.0), 3.0)] {
        let (frames, radius) = converge(&mut crowd, &store, goal, 60 * 60);
        // The disc that all bodies would fill without gaps.
        let body = (0.25 + std::f64::consts::PI * 0.0625) / 2.0;
        let least = (150.0 * body / std::f64::consts::PI).sqrt();
        println!(
            "150 pawns settle within {radius:.2} m after {:.1} s; without gaps {least:.2} m",
            frames as f64 * TICK
        );
        assert!(radius < most * least, "{radius} m, without gaps {least} m");
        let still: Vec<_> = crowd.walkers().iter().map(Walker::feet).collect();
        for _ in 0..60 {
            crowd.step(&store, TICK, |_, _| MoveInput::Toward(goal));
        }
        assert_eq!(still, crowd.walkers().iter().map(Walker::feet).collect::<Vec<_>>(), "nobody stirs");
    }
}

#[test]
fn a_crowd_settles_in_a_corner_and_in_front_of_a_wall_too() {
    let scene = scene(|b| {
        b.level("floor", [-5.0, -5.0, 5.0, 5.0], 0.0, &[]);
        b.quad("wall", [3.0, -5.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 3.0]);
        b.quad("wall", [-5.0, 3.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 3.0]);
    });
    let store = world(&scene, 0.001);
    // In the corner, in front of one wall, and inside a wall, which no pawn can reach: there they stop as they arrive.
    for goal in [[2.5, 2.5], [2.6, 0.0]] {
        let walkers = (0..36).map(|n| {
            let config = Config { tick_s: TICK, ..config(if n % 3 == 0 { BOX } else { CYLINDER }) };
            let at = |k: i32| -4.0 + 0.8 * f64::from(k);
            Walker::new(config, Point3::new(at(n % 6), at(n / 6), 0.01)).unwrap()
        });
        let mut crowd = Crowd::new(walkers.collect()).unwrap();
        let (_, radius) = converge(&mut crowd, &store, goal.into(), 60 * 60);
        assert!(radius < 5.0, "{radius}");
    }
}

/// Each pawn on its own thread, while a stream loads pages: the paths are those of one thread.
#[test]
fn a_pawn_that_waits_for_pages_is_neither_blocked_nor_there() {
    let store = hall(8.0);
    let nothing = store.keep_loaded(|_| false);
    let config = Config { tick_s: TICK, ..config(BOX) };
    let mut crowd = Crowd::new(vec![Walker::new(config, Point3::new(0.5, 0.5, 0.02)).unwrap()]).unwrap();
    for _ in 0..60 {
        crowd.step(&store, TICK, |_, _| MoveInput::Toward(Point2::new(0.5, 0.5)));
    }
    // Near enough to count as arrived where others are in the way.
    for _ in 0..11 * 60 {
        let report = crowd.step(&nothing, TICK, |_, _| MoveInput::Toward(Point2::new(0.8, 0.5)));
        assert_eq!((report.waits, report.blocked, report.arrived), (report.ticks as usize, 0, 0), "{report:?}");
    }
    for _ in 0..60 {
        crowd.step(&store, TICK, |_, _| MoveInput::Toward(Point2::new(0.8, 0.5)));
    }
    assert!(crowd.walkers()[0].state() == State::Arrived && (crowd.walkers()[0].feet().x - 0.8).abs() < 0.02);
}

#[test]
fn pawns_walk_on_threads_of_their_own() {
    let scene = scene(|b| {
        b.level("floor", [-8.0, -8.0, 8.0, 8.0], 0.0, &[]);
        b.column("column", [1.0, 0.7], 0.3, [0.0, 3.0]);
        b.open_cuboid("step", [-3.0, -3.0, 0.0], [-1.0, 1.0, 0.2]);
    });
    let (_dir, archive) = convert_scene(&scene, 0.001);
    let store = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
    let stream = Stream::open(archive, StreamOptions::new(8 << 20)).unwrap();
    let pawn = |n: u32| {
        let at = |k: u32| f64::from(k) * 0.43 - 6.4;
        let angle = f64::from(n);
        let walker = Walker::new(config([BOX, CYLINDER][n as usize % 2]), Point3::new(at(n % 30), at(n / 30), 0.3));
        (walker.unwrap(), MoveInput::Direction(Vector2::new(angle.cos(), angle.sin())))
    };
    std::thread::scope(|scope| {
        let walk = |n: u32| {
            let (mut walker, wish) = pawn(n);
            let mut hints = stream.pawn();
            for _ in 0..30 {
                hints.hint(&walker.motion_hint(stream.archive().frame()));
                let mut report = walker.step(&hints.snapshot(), TICK, wish);
                while let Some(missing) = report.missing {
                    assert_eq!(stream.load_missing(&missing).unwrap().left_out, 0);
                    report = walker.step(&hints.snapshot(), report.unspent, wish);
                }
            }
            walker.feet()
        };
        let threads: Vec<_> = (0..900).map(|n| scope.spawn(move || walk(n))).collect();
        for (n, thread) in threads.into_iter().enumerate() {
            let (mut walker, wish) = pawn(n as u32);
            for _ in 0..30 {
                walker.step(&store, TICK, wish);
            }
            assert_eq!(thread.join().unwrap(), walker.feet(), "pawn {n}");
        }
    });
}

#[test]
fn a_thousand_pawns_stay_on_the_floor() {
    let store = hall(24.0);
    let (mut crowd, goals) = crowd(1000, 1.2);
    for _ in 0..60 {
        crowd.step(&store, TICK, |n, _| MoveInput::Toward(goals[n]));
    }
    assert!(crowd.walkers().iter().all(|walker| walker.feet().z.abs() < 0.02));
    crowd.step(&store, TICK, |_, _| MoveInput::Direction(Vector2::y()));
}
