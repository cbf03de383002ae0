//! Falls, seams, distance from the origin, speeds and frame rates, missing pages, walls with holes.

use super::world::*;
use nalgebra::{Point3, Vector2, Vector3};
use scangen::{Params, Scene};
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::{Aabb, Answer, Overlap, overlaps};
use slicewalk::store::{LoaderOptions, Prefetch, Snapshot, Stream, StreamOptions};
use slicewalk::walk::*;
use std::time::Duration;

/// A floor of `top` quanta (from z = 0), four tiles wide, from tile `first` on.
fn floor_store(first: i32, top: i64) -> Snapshot {
    let frame = Frame::new(T, 3.0 * T).unwrap();
    let layer = (top - 1).div_euclid(PAGE_QUANTA);
    let local = (top - layer * PAGE_QUANTA) as u32;
    let pages = (0..16).map(|n| {
        let mut builder = PageBuilder::default();
        for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            assert!(builder.set_column(px, py, &[Span::new(local - 1, local, false).unwrap()]));
        }
        (PageKey { tx: first + n % 4, ty: first + n / 4, layer: layer as i32 }, builder.build())
    });
    Snapshot::from_pages(frame, pages)
}

#[test]
fn a_flat_floor_gives_no_jitter_at_all() {
    // Tops in the middle of a slice, at its end, at the end of a page, and below zero; tiles on both sides of zero.
    for (first, top) in [(-2, 100), (-2, 255), (-2, PAGE_QUANTA), (3, -7), (-30_000, -PAGE_QUANTA), (-2, 1)] {
        let store = floor_store(first, top);
        let frame = Frame::new(T, 3.0 * T).unwrap();
        let z = frame.top_height(top);
        let corner = f64::from(first) * 64.0 * T;
        for body in [BOX, CYLINDER] {
            for hz in [15.0, 60.0, 144.0] {
                let from = [corner + 1.0, corner + 1.37, z + 0.1];
                let to = [corner + 11.0, corner + 9.0];
                let trace = walk(&store, config(body), from, &[to], hz, 30.0);
                assert!(trace.arrived(), "{body:?} on {top}: ends at {}", trace.end());
                assert!(trace.path.iter().all(|p| p.z == z), "{body:?} on {top}: not level");
                // A straight line at constant speed, across all seams.
                let way = (Vector2::from(to) - Vector2::new(from[0], from[1])).normalize();
                for pair in trace.path[..trace.path.len() - 1].windows(2) {
                    let moved = (pair[1] - pair[0]).xy();
                    assert!((moved.norm() - 1.4 / hz).abs() < 1.4 / 230.0 && moved.perp(&way).abs() < 1e-7);
                }
                assert!(trace.reports.iter().all(|report| report.stop.is_none()));
            }
        }
    }
}

#[test]
fn frame_rates_do_not_change_the_way() {
    let scene = Scene::named("stairs", &Params::new().with("risers", 4.0)).unwrap();
    let store = world(&scene, 0.002);
    let way = scene.walk().unwrap();
    for body in [BOX, CYLINDER] {
        let fine = walk(&store, config(body), way.start, &way.waypoints, 240.0, 30.0);
        assert!(fine.arrived());
        for hz in [15.0, 24.0, 30.0, 60.0, 90.0, 120.0, 144.0] {
            let coarse = walk(&store, config(body), way.start, &way.waypoints, hz, 30.0);
            assert!(coarse.arrived(), "{hz} Hz: ends at {}", coarse.end());
            let mut ticks = 0;
            for (place, report) in coarse.path.iter().zip(&coarse.reports) {
                ticks += report.ticks as usize;
                // If a frame is not a multiple of a tick, it may end one tick earlier.
                let there = ticks.min(fine.path.len()) - 1;
                assert_eq!(*place, fine.path[there], "{body:?} {hz} Hz after {ticks} ticks");
            }
        }
    }
}

#[test]
fn no_speed_tunnels_through_a_wall_or_a_floor() {
    let scene = scene(|b| {
        b.level("floor", [-6.0, -1.5, 6.0, 1.5], 0.0, &[]);
        b.quad("sheet", [4.0, -1.5, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0]);
    });
    let store = world(&scene, 0.0);
    for speed in [0.1, 1.4, 10.0, 50.0, 300.0] {
        for hz in [15.0, 60.0, 240.0] {
            let config = Config { speed, ..config(BOX) };
            let trace = walk(&store, config, [3.0, 0.0, 0.0], &[[5.9, 0.0]], hz, 20.0);
            assert!(!trace.arrived() && trace.end().x < 4.0 - 0.25 + 1e-6, "{speed} m/s, {hz} Hz: {}", trace.end());
            assert!(trace.end().x > 3.65, "{speed} m/s, {hz} Hz: stops early, at {}", trace.end());
            let falling = Config { terminal: speed.max(1.0), ..config };
            let mut walker = Walker::new(falling, Point3::new(0.0, 0.0, 40.0)).unwrap();
            for _ in 0..(45.0 * hz) as usize {
                walker.step(&store, 1.0 / hz, MoveInput::Stay);
            }
            assert!((walker.feet().z).abs() < 0.001, "{speed} m/s, {hz} Hz: falls to {}", walker.feet());
        }
    }
}

#[test]
fn the_way_is_the_same_far_from_the_origin() {
    let scene = Scene::named("stairs", &Params::new().with("risers", 3.0).with("landing", 1.0)).unwrap();
    let way = scene.walk().unwrap();
    let here = walk(&world(&scene, 0.0), config(CYLINDER), way.start, &way.waypoints, 60.0, 20.0);
    for shift in [[1e6, -1e6, 0.0], [-4.0e6, 5.0e6, 3000.0]] {
        let scene = turned(&scene, 0.0, shift);
        let way = scene.walk().unwrap();
        let there = walk(&world(&scene, 0.0), config(CYLINDER), way.start, &way.waypoints, 60.0, 20.0);
        assert!(here.arrived() && there.arrived(), "ends at {}", there.end());
        for (a, b) in here.path.iter().zip(&there.path) {
            let apart = (b - a) - Vector3::from(shift);
            // Elsewhere, the scan's own grid of millimetres may round to the next pixel.
            assert!(apart.norm() < 2.0 * T, "{a} and {b}");
        }
    }
}

#[test]
fn ledges_are_fallen_down_and_not_climbed() {
    for (height, falls) in [(0.2, false), (0.34, false), (0.4, true), (2.0, true)] {
        let scene = scene(|b| {
            b.level("floor", [-3.0, -1.0, 3.0, 1.0], 0.0, &[]);
            b.open_cuboid("block", [-3.0, -1.0, 0.0], [0.0, 1.0, height]);
        });
        let store = world(&scene, 0.001);
        for body in [BOX, CYLINDER] {
            let down = walk(&store, config(body), [-1.5, 0.0, height], &[[2.0, 0.0]], 60.0, 20.0);
            assert!(down.arrived() && down.end().z.abs() < 0.006, "{body:?} {height}: {}", down.end());
            let in_air = down.reports.iter().filter(|r| r.state == State::Falling).count() as f64 / 60.0;
            assert_eq!(in_air > 0.0, falls, "{body:?} {height}");
            if falls {
                // A free fall takes the square root of 2 h / g.
                assert!((in_air - (2.0 * height / 9.81).sqrt()).abs() < 0.05, "{height} m in {in_air} s");
            }
            let up = walk(&store, config(body), [2.0, 0.0, 0.0], &[[-1.5, 0.0]], 60.0, 20.0);
            assert_eq!(up.arrived(), !falls, "{body:?} {height}: {}", up.end());
            assert!(!falls || up.end().z < 0.05, "{body:?}: ratchets up to {}", up.end());
        }
    }
}

#[test]
fn a_fall_of_150_metres_ends_on_the_ground() {
    let tower =
        Scene::named("tower", &Params::new().with("storeys", 51.0).with("size", 6.0).with("shaft", 2.0)).unwrap();
    let (_dir, archive) = convert_at(&tower, 0.001, 1600.0);
    let store = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
    let way = tower.walk().unwrap();
    assert_eq!(way.start[2], 150.0);
    for hz in [15.0, 60.0] {
        let trace = walk(&store, config(BOX), way.start, &way.waypoints, hz, 60.0);
        assert!(trace.arrived(), "ends at {}", trace.end());
        assert!(trace.end().z.abs() < 0.01, "lands at {}", trace.end());
        let in_air = trace.reports.iter().filter(|r| r.state == State::Falling).count() as f64 / hz;
        // 50 m/s after 5.1 s and 127.4 m, the rest at that speed.
        let truth = 50.0 / 9.81 + (150.0 - 50.0 * 50.0 / 9.81 / 2.0) / 50.0;
        assert!((in_air - truth).abs() < 0.1, "{in_air} s, truth {truth}");
        assert!(trace.path.windows(2).all(|w| w[1].z <= w[0].z + 0.01));
    }
}

#[test]
fn sparse_walls_hold() {
    // From two points per pixel down to one per four pixels of 5 cm.
    for density in [800.0, 400.0, 200.0, 100.0] {
        let scene = scene(|b| {
            b.quad("wall", [0.0, -2.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 3.0]);
            b.level("floor", [-1.5, -1.0, 1.5, 1.0], 0.0, &[]);
        });
        let (_dir, archive) = convert_at(&scene, 0.001, density);
        let store = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
        for (n, body) in [BOX, CYLINDER, BOX, CYLINDER].into_iter().enumerate() {
            let y = 0.37 * n as f64 - 0.6;
            let trace = walk(&store, config(body), [-1.0, y, 0.0], &[[1.0, y]], 60.0, 10.0);
            assert!(!trace.arrived() && trace.end().x < -0.15, "{density} per m²: leaks to {}", trace.end());
        }
    }
}

#[test]
fn a_ladder_of_ledges_is_no_stair() {
    // A shelf with boards every 0.3 m that stick out by 6 cm: the pawn could stand on each if there were room for its
    // body.
    let scene = scene(|b| {
        b.level("floor", [-2.0, -1.0, 0.0, 1.0], 0.0, &[]);
        b.quad("back", [0.0, -1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]);
        for n in 1..9 {
            let z = 0.3 * f64::from(n);
            b.open_cuboid("board", [-0.06, -1.0, z - 0.02], [0.0, 1.0, z]);
        }
    });
    let store = world(&scene, 0.001);
    for body in [BOX, CYLINDER] {
        let trace = walk(&store, config(body), [-1.5, 0.0, 0.0], &[[1.0, 0.0]], 60.0, 10.0);
        assert!(trace.end().z < 0.05, "{body:?}: climbs to {}", trace.end());
    }
}

#[test]
fn what_is_not_in_memory_is_waited_for_and_changes_nothing() {
    let scene = Scene::named("stairs", &Params::new().with("risers", 4.0).with("landing", 4.0)).unwrap();
    let (dir, archive) = convert_scene(&scene, 0.001);
    let whole = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
    let way = scene.walk().unwrap();
    let truth = walk(&whole, config(BOX), way.start, &way.waypoints, 60.0, 30.0);
    assert!(truth.arrived());
    let archive = Archive::open(dir.path().join("scene.slices")).unwrap();
    let options = StreamOptions { prefetch: Prefetch::Off, ..StreamOptions::new(64 << 20) };
    let stream = Stream::open(archive, options).unwrap();
    let mut walker = Walker::new(config(BOX), way.start.into()).unwrap();
    let mut way = route(&way.waypoints.clone());
    let has_room = |walker: &Walker| walker.has_room(&stream.snapshot(), &BOX);
    assert!(matches!(has_room(&walker), Answer::NotLoaded(missing) if missing.count() > 0));
    let (mut waits, mut frame) = (0, 0);
    while walker.state() != State::Arrived {
        let mut report = walker.follow(&stream.snapshot(), 1.0 / 60.0, &mut way);
        while let Some(missing) = report.missing {
            // It stands still as long as no page is loaded.
            let (feet, state) = (walker.feet(), walker.state());
            let again = walker.follow(&stream.snapshot(), report.unspent, &mut way);
            assert!(again.waits() && again.missing_count() > 0 && again.ticks == 0 && again.moved == Vector3::zeros());
            assert_eq!((walker.feet(), walker.state()), (feet, state));
            stream.load_missing(&missing).unwrap();
            report = walker.follow(&stream.snapshot(), report.unspent, &mut way);
            waits += 1;
        }
        assert_eq!(walker.feet(), truth.path[frame], "frame {frame}");
        frame += 1;
    }
    assert!(waits > 1 && frame == truth.path.len());
    assert_eq!(has_room(&walker), Answer::Known(true));
}

#[test]
fn a_pawn_that_waits_at_a_wall_reaches_one_waypoint_at_a_time() {
    // The wall begins at 1 m and keeps the pawn 4, 5 and 6 mm from its waypoints.
    let store = room(2, |(i, _)| i >= 20);
    let nothing = store.keep_loaded(|_| false);
    let mut walker = Walker::new(config(BOX), Point3::new(0.5, 0.025, 0.03)).unwrap();
    let mut way = route(&[0.754, 0.755, 0.756].map(|x| [x, 0.025]));
    let tick = walker.config().tick_s;
    for _ in 0..200 {
        if way.next() == 0 {
            walker.follow(&store, tick, &mut way);
        }
    }
    for _ in 0..3 {
        let report = walker.follow(&nothing, tick, &mut way);
        assert!(report.waits() && way.next() == 1, "{report:?}: {}", way.next());
    }
    walker.follow(&store, tick, &mut way);
    assert_eq!(way.next(), 2);
}

#[test]
fn who_asks_for_the_next_place_in_each_tick_walks_as_one_who_follows() {
    let store = room(2, |_| false);
    let pawn = || Walker::new(config(CYLINDER), Point3::new(-1.0, -1.0, 0.03)).unwrap();
    let tick = pawn().config().tick_s;
    let places = [[1.5, -1.2], [1.5, -1.2], [1.6, 1.2], [-1.0, 1.0]];
    let (mut follows, mut asks, mut way, mut own) = (pawn(), pawn(), route(&places), route(&places));
    for _ in 0..2400 {
        follows.follow(&store, tick, &mut way);
        let place = own.next_place(&asks);
        assert_eq!(place, own.places().get(own.next()).copied());
        asks.step(&store, tick, place.map_or(MoveInput::Stay, MoveInput::Toward));
        assert_eq!((asks.feet(), own.next()), (follows.feet(), way.next()));
    }
    assert_eq!((follows.state(), own.next(), own.next_place(&asks)), (State::Arrived, 4, None));
}

#[test]
fn a_falling_pawn_around_which_solid_is_loaded_stops_and_says_so() {
    let (hall, solid) = (room(2, |_| false), room(2, |_| true));
    let mut walker = Walker::new(config(BOX), Point3::new(0.0, 0.0, 1.0)).unwrap();
    walker.step(&hall, 0.1, MoveInput::Stay);
    let feet = walker.feet();
    assert!(walker.state() == State::Falling && feet.z < 1.0);
    let report = walker.step(&solid, 0.1, MoveInput::Direction(Vector2::x()));
    assert_eq!((report.stop, walker.feet()), (Some(Stop::Inside), feet), "too deep inside to be pushed out");
    walker.step(&hall, 1.0, MoveInput::Stay);
    assert!(walker.state() == State::Walking && walker.feet().z < 0.1, "{}", walker.feet());
}

/// The thesis does not say how a pawn falls; here it lands on floor that it finds under it.
#[test]
fn pawns_of_the_thesis_fall_to_the_floor() {
    let store = room(2, |_| false);
    let floor = store.frame().top_height(10);
    for response in [Response::Thesis, Response::ThesisMean] {
        let config = Config { response, ..config(BOX) };
        let mut walker = Walker::new(config, Point3::new(0.0, 0.0, 2.0)).unwrap();
        let mut in_air = 0;
        for _ in 0..120 {
            in_air += usize::from(walker.step(&store, 1.0 / 60.0, MoveInput::Stay).state == State::Falling);
        }
        assert_eq!(walker.state(), State::Walking, "{response:?}");
        assert!((walker.feet().z - floor).abs() < 1e-9, "{response:?}: {}", walker.feet());
        // A free fall takes the square root of 2 h / g.
        let in_air = in_air as f64 / 60.0;
        assert!((in_air - (2.0 * 2.0f64 / 9.81).sqrt()).abs() < 0.05, "{response:?}: {in_air} s");
    }
}

/// If exactly what the motion hint says may be touched within one frame is loaded, no frame misses a page.
#[test]
fn the_outlook_names_every_page_that_a_step_asks_for() {
    let scene = scene(|b| {
        b.level("floor", [-7.0, -7.0, 7.0, 7.0], 0.0, &[]);
        b.level("roof", [-7.0, -7.0, 7.0, 7.0], 9.5, &[]);
        for n in 0..100 {
            let (x, y) = (f64::from(n % 10) * 1.31 - 6.4, f64::from(n / 10) * 1.27 - 6.4);
            b.open_cuboid("step", [x, y, 0.0], [x + 0.6, y + 0.5, 0.05 + 0.02 * f64::from(n % 17)]);
            if n % 3 == 0 {
                b.quad("wall", [x + 0.7, y, 0.0], [0.5, 0.3 * f64::from(n % 5) - 0.6, 0.0], [0.0, 0.0, 2.5]);
            }
        }
    });
    let (dir, _) = convert_scene(&scene, 0.001);
    let mut loaded = 0;
    for (n, speed) in [0.5, 1.4, 9.0, 40.0].into_iter().enumerate() {
        let hz = [30.0, 60.0][n % 2];
        let frame = Duration::from_secs_f64(1.0 / hz);
        let options = StreamOptions {
            prefetch: Prefetch::Manual,
            loader: LoaderOptions { horizon_min: frame, horizon_max: frame, ..LoaderOptions::new(64 << 20) },
        };
        let config = Config { speed, ..config([BOX, CYLINDER][n / 2]) };
        let mut walker = Walker::new(config, Point3::new(0.1, 0.2, 9.0)).unwrap();
        for part in 0..120 {
            // No page of the previous walk is in memory.
            let archive = Archive::open(dir.path().join("scene.slices")).unwrap();
            let stream = Stream::open(archive, options.clone()).unwrap();
            let mut pawn = stream.pawn();
            let angle = f64::from(part / 4) * 2.4;
            let wish = MoveInput::Direction(Vector2::new(angle.cos(), angle.sin()));
            for _ in 0..10 {
                pawn.hint(&walker.motion_hint(stream.archive().frame()));
                assert!(stream.settle(Duration::from_secs(60)));
                let report = walker.step(&stream.snapshot(), 1.0 / hz, wish);
                assert_eq!(report.missing, None, "{speed} m/s at {hz} Hz, at {}", walker.feet());
                if walker.feet().z < -1.0 || walker.feet().xy().coords.amax() > 6.0 {
                    walker.place(Point3::new(0.1, 0.2, 9.0));
                }
            }
            loaded += stream.counters().loaded;
        }
    }
    assert!(loaded > 500, "{loaded}");
}

#[test]
fn a_pawn_put_into_matter_gets_out() {
    let scene = scene(|b| {
        b.level("floor", [-2.0, -2.0, 2.0, 2.0], 0.0, &[]);
        b.column("post", [0.0, 0.0], 0.1, [0.0, 3.0]);
    });
    let store = world(&scene, 0.0);
    for body in [BOX, CYLINDER] {
        let mut walker = Walker::new(config(body), Point3::new(0.2, 0.05, 0.0)).unwrap();
        let report = walker.step(&store, 1.0 / 60.0, MoveInput::Stay);
        assert_eq!(report.stop, Some(Stop::Inside));
        let feet = walker.feet();
        let shape = Aabb::standing(feet + Vector3::new(0.0, 0.0, 0.01), Vector3::new(0.33, 0.33, 1.7)).unwrap();
        assert_eq!(overlaps(&store, &shape), Overlap::Clear, "{feet}");
        assert!(feet.x > 0.3 && feet.z.abs() < 0.01, "{feet}");
    }
}

/// Greatest distance from the exact path: along x at `y`, then along the wall's face.
#[test]
fn both_responses_stay_near_the_exact_way() {
    // A wall along x at y = 0.62; the pawn meets it at 30° and slides along it: closed form.
    let scene = scene(|b| {
        b.level("floor", [-4.0, -3.0, 5.0, 2.0], 0.0, &[]);
        b.quad("wall", [-4.0, 0.62, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 3.0]);
    });
    let store = world(&scene, 0.001);
    let mut deviations = Vec::new();
    for response in [Response::Slide, Response::Thesis, Response::ThesisMean] {
        for body in [BOX, CYLINDER] {
            let config = Config { response, ..config(body) };
            let mut walker = Walker::new(config, Point3::new(-3.0, -1.0, 0.0)).unwrap();
            let (s, c) = 30f64.to_radians().sin_cos();
            let mut worst = 0.0f64;
            for frame in 1..=240 {
                walker.step(&store, 1.0 / 60.0, MoveInput::Direction(Vector2::new(c, s)));
                let gone = 1.4 * f64::from(frame) / 60.0;
                let truth = Point3::new(-3.0 + gone * c, (-1.0 + gone * s).min(0.62 - 0.25), 0.0);
                worst = worst.max((walker.feet() - truth).norm());
            }
            println!("{response:?} {body:?}: off the exact way by {worst:.3} m at most");
            deviations.push((response, worst));
        }
    }
    for (response, worst) in deviations {
        // The thesis' pawn does not slide: it stays where it met the wall.
        assert!(worst < 2.0 * T || response != Response::Slide, "{response:?}: {worst}");
        assert!(worst < 3.0, "{response:?}: {worst}");
    }
}
