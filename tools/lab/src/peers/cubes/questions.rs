//! Questions about the cubes, equal for all libraries, and their right answers.

use super::matter::Matter;
use crate::Random;
use crate::chart::subject::Subject;
use crate::chart::workload::Workload;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, Ray};

/// Length of rays, and of sweeps (m).
pub const RAY_M: f64 = 20.0;
pub const SWEEP_M: f64 = 0.1;
/// Peers count in single precision, some hundred metres from the origin at most: what lies this near to a face may be
/// answered either way (m).
pub const ROUNDING_M: f64 = 1e-4;
/// Distances may differ by this: parry and Jolt end a sweep at a tolerance (m).
const TOLERANCE_M: f64 = 2e-3;
/// How high above the feet rays begin (m).
const EYES_M: f64 = 1.5;
/// Height of a step that a pawn climbs (m).
const STEP_M: f64 = 0.35;

/// A kind of question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Is a place occupied?
    Points,
    /// The pawn's box anywhere.
    RandomBoxes,
    /// The pawn's box along a walk.
    WalkBoxes,
    /// The pawn's box along a walk, from the height of a step up.
    RaisedBoxes,
    /// Rays of 20 m.
    Rays,
    /// Sweeps of 0.1 m of the pawn's box.
    Sweeps,
}

impl Kind {
    /// All kinds, in the order of the page.
    pub const ALL: [Self; 6] =
        [Self::Points, Self::RandomBoxes, Self::WalkBoxes, Self::RaisedBoxes, Self::Rays, Self::Sweeps];

    /// Its name in the page.
    pub fn title(self) -> &'static str {
        match self {
            Self::Points => "Is a place occupied?",
            Self::RandomBoxes => "Box of the pawn, random places",
            Self::WalkBoxes => "Box of the pawn, along a walk",
            Self::RaisedBoxes => "Box of the pawn from 0.35 m above its feet up, along a walk",
            Self::Rays => "Ray of 20 m",
            Self::Sweeps => "Sweep of 0.1 m",
        }
    }
}

/// Questions, in metres from the origin of the cubes.
pub struct Questions {
    pub points: Vec<Point3<f64>>,
    pub random: Vec<Aabb>,
    pub walk: Vec<Aabb>,
    /// The boxes of the walk from the height of a step up, clear of the floors of coarse cubes.
    pub raised: Vec<Aabb>,
    pub rays: Vec<Ray>,
    /// From places that are free.
    pub sweeps: Vec<(Aabb, Vector3<f64>)>,
}

impl Questions {
    /// The boxes and sweeps that charts ask about the scene; places and rays of its own.
    pub fn new(scene: &Subject, work: &Workload, matter: &Matter) -> Result<Self> {
        let mut random = Random(31);
        let moved = |shape: &Aabb| Aabb::new(shape.min() - matter.origin, shape.max() - matter.origin);
        let boxes = |shapes: &[Aabb]| shapes.iter().map(moved).collect::<slicewalk::Result<Vec<_>>>();
        let (anywhere, walk) = (boxes(&work.random.shapes)?, boxes(&work.walk.shapes)?);
        let count = walk.len();
        let points = (0..count).map(|_| {
            let cube = matter.cubes[random.bits() as usize % matter.cubes.len()];
            Point3::from(cube.map(|n| (f64::from(n) + random.between(-2.0, 3.0)) * matter.edge))
        });
        let points = points.collect();
        let rays = walk.iter().filter_map(|shape| {
            let eyes: Point3<f64> =
                nalgebra::center(&shape.min(), &shape.max()).xy().coords.push(shape.min().z + EYES_M).into();
            let to = scene.points[random.bits() as usize % scene.points.len()] - matter.origin;
            let free = !matter.hits(&(eyes - Vector3::repeat(1e-3)), &(eyes + Vector3::repeat(1e-3)));
            free.then(|| Ray::new(eyes, to - eyes, RAY_M)).transpose().ok().flatten()
        });
        let rays = rays.collect();
        let sweeps = work.sweeps.iter().map(|(shape, way)| Ok((moved(shape)?, way.normalize() * SWEEP_M)));
        let sweeps: slicewalk::Result<Vec<_>> = sweeps.collect();
        let mut sweeps = sweeps?;
        let skin = Vector3::repeat(ROUNDING_M);
        sweeps.retain(|(shape, _)| !matter.hits(&(shape.min() - skin), &(shape.max() + skin)));
        let raised = walk.iter().map(|shape| Aabb::new(shape.min() + Vector3::z() * STEP_M, shape.max()));
        let raised = raised.collect::<slicewalk::Result<Vec<_>>>()?;
        Ok(Self { points, random: anywhere, walk, raised, rays, sweeps })
    }

    /// How many of a kind there are.
    pub fn count(&self, kind: Kind) -> usize {
        match kind {
            Kind::Points => self.points.len(),
            Kind::RandomBoxes => self.random.len(),
            Kind::WalkBoxes => self.walk.len(),
            Kind::RaisedBoxes => self.raised.len(),
            Kind::Rays => self.rays.len(),
            Kind::Sweeps => self.sweeps.len(),
        }
    }

    /// Returns all questions of a kind as plain numbers, in the layout of `peer.h`.
    pub fn numbers(&self, kind: Kind) -> Vec<f64> {
        let corners = |shape: &Aabb| [shape.min(), shape.max()].into_iter().flat_map(<[f64; 3]>::from);
        match kind {
            Kind::Points => self.points.iter().flat_map(|p| <[f64; 3]>::from(*p)).collect(),
            Kind::RandomBoxes => self.random.iter().flat_map(corners).collect(),
            Kind::WalkBoxes => self.walk.iter().flat_map(corners).collect(),
            Kind::RaisedBoxes => self.raised.iter().flat_map(corners).collect(),
            Kind::Rays => {
                let numbers = |ray: &Ray| {
                    let [from, way]: [[f64; 3]; 2] = [ray.origin().into(), ray.direction().into()];
                    from.into_iter().chain(way).chain([ray.max()])
                };
                self.rays.iter().flat_map(numbers).collect()
            }
            Kind::Sweeps => {
                let numbers = |(shape, way): &(Aabb, Vector3<f64>)| corners(shape).chain(<[f64; 3]>::from(*way));
                self.sweeps.iter().flat_map(numbers).collect()
            }
        }
    }
}

/// How an answer stands to the cubes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    Equal,
    /// Another, but right for cubes or places that are moved by less than [`ROUNDING_M`].
    Rounded,
    Wrong,
}

impl Questions {
    /// Checks the answer to question `n`: 1 or 0 for places and boxes, else a distance (m).
    pub fn judge(&self, matter: &Matter, kind: Kind, n: usize, answer: f64) -> Verdict {
        let yes = |hit: bool| if hit { 1.0 } else { 0.0 };
        let of_box = |min: &Point3<f64>, max: &Point3<f64>| {
            let [same, grown, shrunk] = [0.0, ROUNDING_M, -ROUNDING_M].map(|by| {
                let skin = Vector3::repeat(by);
                let (low, high) = (min - skin, max + skin);
                // A place that shrinks is nowhere, and may be free.
                yes((0..3).all(|axis| low[axis] <= high[axis]) && matter.hits(&low, &high))
            });
            verdict(answer == same, answer == grown || answer == shrunk)
        };
        match kind {
            Kind::Points => of_box(&self.points[n], &self.points[n]),
            Kind::RandomBoxes => of_box(&self.random[n].min(), &self.random[n].max()),
            Kind::WalkBoxes => of_box(&self.walk[n].min(), &self.walk[n].max()),
            Kind::RaisedBoxes => of_box(&self.raised[n].min(), &self.raised[n].max()),
            Kind::Rays => {
                let ray = &self.rays[n];
                let answer = answer.min(RAY_M);
                let like = |origin: Point3<f64>, direction: Vector3<f64>| {
                    (matter.cast(&origin, &direction, RAY_M).min(RAY_M) - answer).abs() <= TOLERANCE_M
                };
                if like(ray.origin(), ray.direction()) {
                    return Verdict::Equal;
                }
                // A ray that grazes an edge: one beside it goes the same way.
                let across = ray.direction().cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
                let other = ray.direction().cross(&across);
                let beside = (0..16).any(|step| {
                    let (s, c) = (f64::from(step) * std::f64::consts::FRAC_PI_8).sin_cos();
                    like(ray.origin() + (across * c + other * s) * ROUNDING_M, ray.direction())
                });
                verdict(false, beside)
            }
            Kind::Sweeps => {
                let (shape, way) = &self.sweeps[n];
                let by = |skin: f64| {
                    let skin = Vector3::repeat(skin);
                    matter.sweep(&(shape.min() - skin), &(shape.max() + skin), way)
                };
                let same = (by(0.0) - answer).abs() <= TOLERANCE_M;
                let between = by(ROUNDING_M) - TOLERANCE_M..=by(-ROUNDING_M) + TOLERANCE_M;
                verdict(same, between.contains(&answer))
            }
        }
    }
}

fn verdict(equal: bool, rounded: bool) -> Verdict {
    match (equal, rounded) {
        (true, _) => Verdict::Equal,
        (false, true) => Verdict::Rounded,
        (false, false) => Verdict::Wrong,
    }
}
