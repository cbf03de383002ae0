//! Walking steps: our `Walker`, and `rapier3d`'s `KinematicCharacterController` with the settings of its guide.

use super::measure::{Measured, summary};
use super::oracle::Oracle;
use super::parry::vector;
use super::scene::{PAWN, ROUND, START, route};
use crate::stability::Result;
use nalgebra::{Point3, Vector2, Vector3};
use rapier3d::control::{CharacterAutostep, CharacterLength, KinematicCharacterController};
use rapier3d::prelude::*;
use slicewalk::store::Snapshot;
use slicewalk::walk::{Config, State, Walker, Waypoints};
use std::time::Instant;

/// Length of a frame (s).
pub const FRAME_S: f64 = 1.0 / 60.0;
/// Most frames of a walk: twice as many as Slicewalk needs. A walk ends after `STANDS` frames without progress.
const FRAMES: usize = 3200;
const STANDS: usize = 240;
/// Steps of the controller: greatest height, and least width of a tread (m). The first is Slicewalk's climb height.
pub const STEPS: [(f32, f32); 2] = [(0.35, 0.05), (0.35, 0.2)];
/// The body less this margin is inside solid if it holds a point (m).
const SHRUNK: f64 = 0.03;

/// How a walk ended.
pub struct Walked {
    /// Times of frames (ns), and the pawn's feet after each.
    pub measured: Measured<Point3<f64>>,
    /// Waypoints reached.
    pub reached: usize,
}

impl Walked {
    fn new(times: Vec<f64>, answers: Vec<Point3<f64>>, reached: usize) -> Self {
        Self { measured: Measured { times: summary(times), answers }, reached }
    }

    /// Frames in which the body, less a margin and the climb height at its feet, holds a point.
    pub fn inside(&self, oracle: &Oracle) -> usize {
        let half = Vector3::new(1.0, 1.0, 0.0) * ((PAWN[0] / 2.0 - SHRUNK) * std::f64::consts::FRAC_1_SQRT_2);
        let holds = |feet: &&Point3<f64>| {
            let (low, high) = (**feet - half, **feet + half);
            let (low, high) = (low + Vector3::new(0.0, 0.0, 0.4), high + Vector3::new(0.0, 0.0, PAWN[2] - SHRUNK));
            oracle.points(low, high).next().is_some()
        };
        self.measured.answers.iter().filter(holds).count()
    }
}

pub fn ours(store: &Snapshot, tick_s: f64) -> Result<Walked> {
    let mut walker = Walker::new(Config { tick_s, ..Config::new(ROUND) }, START.into())?;
    let mut route = Waypoints::new(route()?)?;
    let (mut times, mut feet) = (Vec::new(), Vec::new());
    while walker.state() != State::Arrived && times.len() < FRAMES {
        let start = Instant::now();
        walker.follow(store, FRAME_S, &mut route);
        times.push(start.elapsed().as_secs_f64() * 1e9);
        feet.push(walker.feet());
    }
    Ok(Walked::new(times, feet, route.next()))
}

/// A world as the controller asks it.
pub struct Physics {
    bodies: RigidBodySet,
    colliders: ColliderSet,
    broad: BroadPhaseBvh,
    narrow: NarrowPhase,
}

impl Physics {
    /// A world of one shape.
    pub fn new(world: SharedShape) -> Self {
        let (mut bodies, mut colliders) = (RigidBodySet::new(), ColliderSet::new());
        colliders.insert(ColliderBuilder::new(world));
        let (mut broad, mut narrow) = (BroadPhaseBvh::new(), NarrowPhase::new());
        PhysicsPipeline::new().step(
            Vector::ZERO,
            &IntegrationParameters::default(),
            &mut IslandManager::new(),
            &mut broad,
            &mut narrow,
            &mut bodies,
            &mut colliders,
            &mut ImpulseJointSet::new(),
            &mut MultibodyJointSet::new(),
            &mut SoftBodySet::new(),
            &mut CCDSolver::new(),
            &(),
            &(),
        );
        Self { bodies, colliders, broad, narrow }
    }
}

/// A capsule, as its guide advises, that climbs steps of some height and width, and snaps down as far.
pub struct Pawn<'a> {
    queries: QueryPipeline<'a>,
    controller: KinematicCharacterController,
    capsule: Capsule,
    /// Half of its height (m).
    half: f64,
    center: Point3<f64>,
    /// Its speed downwards (m/s).
    falling: f64,
}

impl<'a> Pawn<'a> {
    /// With its feet somewhere, a radius and a height (m), and steps of a height and a least width of treads (m).
    pub fn new(world: &'a Physics, feet: Point3<f64>, [radius, height]: [f64; 2], (step, width): (f32, f32)) -> Self {
        let dispatcher = world.narrow.query_dispatcher();
        let queries =
            world.broad.as_query_pipeline(dispatcher, &world.bodies, &world.colliders, QueryFilter::default());
        let controller = KinematicCharacterController {
            up: Vector::Z,
            autostep: Some(CharacterAutostep {
                max_height: CharacterLength::Absolute(step),
                min_width: CharacterLength::Absolute(width),
                include_dynamic_bodies: false,
            }),
            snap_to_ground: Some(CharacterLength::Absolute(step)),
            ..KinematicCharacterController::default()
        };
        let half = height / 2.0;
        let end = Vector::Z * (half - radius) as f32;
        let capsule = Capsule::new(-end, end, radius as f32);
        // A little above the ground, as its own skin asks.
        let center = feet + Vector3::new(0.0, 0.0, half + 0.02);
        Self { queries, controller, capsule, half, center, falling: 0.0 }
    }

    /// Where its feet are (m).
    pub fn feet(&self) -> Point3<f64> {
        self.center - Vector3::new(0.0, 0.0, self.half)
    }

    /// Runs a frame that moves by `across` (m) and keeps its height unless obstacles change it.
    pub fn float(&mut self, across: Vector2<f64>) {
        self.falling = -9.81 * FRAME_S;
        self.step(across);
    }

    /// Runs a frame that moves by `across` (m) and falls without support; returns its time (ns).
    pub fn step(&mut self, across: Vector2<f64>) -> f64 {
        self.falling += 9.81 * FRAME_S;
        let wanted = across.push(-self.falling * FRAME_S);
        let pose = Pose::from_translation(vector(&self.center.coords));
        let start = Instant::now();
        let (queries, capsule) = (&self.queries, &self.capsule);
        let moved = self.controller.move_shape(FRAME_S as f32, queries, capsule, &pose, vector(&wanted), |_| {});
        let took = start.elapsed().as_secs_f64() * 1e9;
        let by = moved.translation;
        self.center += Vector3::new(f64::from(by.x), f64::from(by.y), f64::from(by.z));
        if moved.grounded {
            self.falling = 0.0;
        }
        took
    }
}

/// Its walk along the route.
pub fn rapier(world: SharedShape, steps: (f32, f32)) -> Result<Walked> {
    let physics = Physics::new(world);
    let mut pawn = Pawn::new(&physics, START.into(), [PAWN[0] / 2.0, PAWN[2]], steps);
    let (places, speed) = (route()?, Config::new(ROUND).speed);
    let mut next = 0;
    let (mut times, mut feet) = (Vec::new(), Vec::new());
    while next < places.len() && times.len() < FRAMES {
        let way = places[next] - pawn.feet().xy();
        if way.norm() <= 0.03 {
            next += 1;
            continue;
        }
        times.push(pawn.step(way * (speed * FRAME_S / way.norm()).min(1.0)));
        feet.push(pawn.feet());
        let before = feet.len().checked_sub(STANDS).map(|n| feet[n]);
        if before.is_some_and(|before: Point3<f64>| (before - feet[feet.len() - 1]).norm() < 0.05) {
            break;
        }
    }
    Ok(Walked::new(times, feet, next))
}
