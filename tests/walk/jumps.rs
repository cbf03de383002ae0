//! Jumps and changes of the body: how high, what stops them, what they reach, and where there is no room to stand up.

use super::world::*;
use nalgebra::{Vector2, Vector3};
use slicewalk::query::Answer;
use slicewalk::store::Snapshot;
use slicewalk::walk::*;

/// Take-off speed of a jump of 0.6 m.
const SPEED: f64 = 3.431;
const FRAME_S: f64 = 1.0 / 60.0;

/// A floor at 0, a slab from 2.2 m up over x > 2, and a block 0.5 m high behind x = -1.
fn hall() -> Snapshot {
    let scene = scene(|b| {
        b.level("floor", [-4.0, -2.0, 4.0, 2.0], 0.0, &[]);
        b.level("slab", [2.0, -2.0, 4.0, 2.0], 2.2, &[]);
        b.level("block", [-4.0, -2.0, -1.0, 2.0], 0.5, &[]);
        b.quad("front", [-1.0, -2.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 0.5]);
    });
    world(&scene, 0.0)
}

fn standing(store: &Snapshot, at: [f64; 3]) -> Walker {
    let mut walker = Walker::new(config(BOX), at.into()).unwrap();
    for _ in 0..60 {
        walker.step(store, FRAME_S, MoveInput::Stay);
    }
    assert_eq!(walker.state(), State::Walking);
    walker
}

/// Jumps while walking in direction `way` until the pawn stands again; returns the greatest height of the feet.
fn jump(store: &Snapshot, walker: &mut Walker, way: Vector2<f64>) -> f64 {
    assert!(walker.jump(SPEED));
    assert!(!walker.jump(SPEED), "nobody jumps in the air");
    let mut highest = walker.feet().z;
    for _ in 0..120 {
        walker.step(store, FRAME_S / 4.0, MoveInput::Direction(way));
        highest = highest.max(walker.feet().z);
        if walker.ground() != Ground::Air {
            return highest;
        }
    }
    walker.step(store, 2.0, MoveInput::Stay);
    highest
}

#[test]
fn a_jump_rises_as_far_as_its_speed_says_and_lands_where_it_began() {
    let store = hall();
    let mut walker = standing(&store, [0.0, 0.0, 0.1]);
    let before = walker.feet();
    let highest = jump(&store, &mut walker, Vector2::zeros());
    let expected = before.z + SPEED * SPEED / (2.0 * 9.81);
    assert!((highest - expected).abs() < 1e-4, "{highest}, expected {expected}");
    assert_eq!((walker.feet(), walker.state()), (before, State::Walking));
}

#[test]
fn a_ceiling_ends_the_rise_at_once() {
    let store = hall();
    let mut walker = standing(&store, [3.0, 0.0, 0.1]);
    let before = walker.feet();
    let highest = jump(&store, &mut walker, Vector2::zeros());
    assert!(highest + 1.8 <= 2.2 + 1e-9 && highest > before.z + 0.35, "{highest}");
    assert_eq!(walker.feet(), before);
}

#[test]
fn a_jump_reaches_what_is_too_high_to_climb_and_climbs_nothing_on_its_way() {
    let store = hall();
    let mut walker = standing(&store, [-0.5, 0.0, 0.1]);
    let left = -Vector2::x();
    for _ in 0..60 {
        walker.step(&store, FRAME_S, MoveInput::Direction(left));
    }
    assert!(walker.feet().z < 0.1, "0.5 m are not walked up");
    jump(&store, &mut walker, left);
    assert!((walker.feet().z - 0.5).abs() < 0.01 && walker.feet().x < -0.8, "{}", walker.feet());
    // A lower jump ends before the edge, although the pawn could climb the rest from the ground.
    let mut walker = standing(&store, [-0.5, 0.0, 0.1]);
    walker.jump(2.0);
    for _ in 0..240 {
        walker.step(&store, FRAME_S / 4.0, MoveInput::Direction(left));
        assert!(walker.feet().z < 0.25, "{}", walker.feet());
    }
}

#[test]
fn the_thesis_knows_no_jumps() {
    let store = hall();
    let thesis = Config { response: Response::Thesis, ..config(BOX) };
    let mut walker = Walker::new(thesis, [0.0, 0.0, 0.1].into()).unwrap();
    walker.step(&store, 1.0, MoveInput::Stay);
    assert!(!walker.jump(SPEED));
    for speed in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(!standing(&store, [0.0, 0.0, 0.1]).jump(speed));
    }
}

#[test]
fn under_a_low_ceiling_there_is_no_room_to_stand_up() {
    let scene = scene(|b| {
        b.level("floor", [-4.0, -2.0, 4.0, 2.0], 0.0, &[]);
        b.level("slab", [1.0, -2.0, 4.0, 2.0], 1.3, &[]);
    });
    let store = world(&scene, 0.0);
    let low = Body::Box { x: 0.5, y: 0.5, height: 1.0 };
    let mut walker = standing(&store, [0.0, 0.0, 0.1]);
    let go = |walker: &mut Walker| {
        for _ in 0..120 {
            walker.step(&store, FRAME_S, MoveInput::Direction(Vector2::x()));
        }
    };
    go(&mut walker);
    assert!(walker.feet().x < 1.0, "a head at 1.8 m does not pass below 1.3 m");
    walker.set_config(config(low)).unwrap();
    go(&mut walker);
    assert!(walker.feet().x > 1.5);
    assert_eq!(walker.has_room(&store, &BOX), Answer::Known(false));
    assert_eq!(walker.has_room(&store, &low), Answer::Known(true));
    walker.place(walker.feet() - Vector3::new(3.0, 0.0, 0.0));
    walker.step(&store, FRAME_S, MoveInput::Stay);
    assert_eq!(walker.has_room(&store, &BOX), Answer::Known(true));
    // An invalid body has no room anywhere.
    for body in [Body::Cylinder { radius: -1.0, height: 1.8 }, Body::Box { x: f64::NAN, y: 0.5, height: 1.8 }] {
        assert_eq!(walker.has_room(&store, &body), Answer::Known(false));
    }
    assert!(walker.set_config(Config { speed: f64::NAN, ..config(BOX) }).is_err());
    assert_eq!(walker.config().body, low);
}
