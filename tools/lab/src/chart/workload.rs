//! Questions with their true answers: random boxes, boxes along a walk, sweeps, and boxes that graze solid.

use super::subject::Subject;
use super::walkable::{self, Column};
use crate::Random;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use scangen::Truth;
use slicewalk::query::Aabb;

/// How far above the floor a pawn asks, and how far it steps (m).
const LIFT_M: f64 = 0.03;
const STEP_M: f64 = 0.0233;
/// How high it climbs, and how far down floor is looked for (m).
const CLIMB_M: f64 = 0.35;
pub const DEPTH_M: f64 = 1.0;
/// A walk restarts elsewhere after this many steps.
const STEPS: usize = 500;
/// Length of a sweep (m).
const SWEEP_M: f64 = 0.5;
/// Signed distances of grazing boxes (pixels), and bins of them to a pixel.
const NEAREST: f64 = -1.0;
const FARTHEST: f64 = 4.0;
const BINS: f64 = 4.0;

/// Boxes and whether they hold solid.
pub struct Boxes {
    pub shapes: Vec<Aabb>,
    pub truth: Vec<bool>,
}

impl Boxes {
    fn new(subject: &Subject, shapes: Vec<Aabb>) -> Self {
        let truth = shapes.iter().map(|shape| holds(subject, shape)).collect();
        Self { shapes, truth }
    }
}

/// All questions about one scene.
pub struct Workload {
    pub random: Boxes,
    pub walk: Boxes,
    /// The boxes of the walk from the height that it climbs, and the highest point under each (m).
    raised: Vec<Aabb>,
    floors: Vec<Option<f64>>,
    /// Sweeps of such boxes that begin free, and how far they come (m). They are raised because coarse cubes make
    /// floors begin too high, which the height of floors already measures.
    pub sweeps: Vec<(Aabb, Vector3<f64>)>,
    pub reached: Vec<f64>,
    /// Places all over the scene, and where one may stand there; none without true surfaces.
    pub columns: Vec<Column>,
}

/// Returns whether a closed box holds solid.
fn holds(subject: &Subject, shape: &Aabb) -> bool {
    match &subject.scene {
        Some(scene) if subject.is_mesh() => scene.distance_to_box(shape.min().into(), shape.max().into()) <= 0.0,
        _ => subject.oracle.hits(shape),
    }
}

impl Workload {
    /// `count` questions of each kind.
    pub fn new(subject: &Subject, count: usize) -> Result<Self> {
        let mut random = Random(21);
        let anywhere: Result<Vec<_>> = (0..count).map(|_| anywhere(subject, &mut random)).collect();
        let walk = Boxes::new(subject, walk(subject, count, &mut random)?);
        let raise = |shape: &Aabb| Aabb::new(shape.min() + Vector3::z() * CLIMB_M, shape.max());
        let raised = walk.shapes.iter().map(raise).collect::<slicewalk::Result<Vec<_>>>()?;
        let floors = raised.iter().map(|shape| subject.oracle.top(shape, DEPTH_M)).collect();
        let free: Vec<_> = raised.iter().filter(|shape| !subject.oracle.hits(shape)).copied().collect();
        let sweeps: Vec<_> = (0..if free.is_empty() { 0 } else { count / 4 })
            .map(|_| {
                let angle = random.between(0.0, std::f64::consts::TAU);
                let from = free[random.bits() as usize % free.len()];
                (from, Vector3::new(angle.cos(), angle.sin(), 0.0) * SWEEP_M)
            })
            .collect();
        let reached = sweeps.iter().map(|(shape, way)| subject.oracle.sweep(shape, *way)).collect();
        let columns = subject.scene.as_ref().map_or_else(Vec::new, |scene| walkable::columns(scene, count, 22));
        Ok(Self { random: Boxes::new(subject, anywhere?), walk, raised, floors, sweeps, reached, columns })
    }
}

fn pawn(subject: &Subject, feet: Point3<f64>) -> Result<Aabb> {
    Ok(Aabb::standing(feet, subject.pawn.into())?)
}

fn anywhere(subject: &Subject, random: &mut Random) -> Result<Aabb> {
    let [low, high] = subject.bounds;
    let mut at = |axis: usize, less: f64| random.between(low[axis], (high[axis] - less).max(low[axis]));
    pawn(subject, Point3::new(at(0, 0.0), at(1, 0.0), at(2, subject.pawn[2])))
}

/// Steps of a pawn that keeps to the floors that the points make and turns where a point is in the way.
fn walk(subject: &Subject, count: usize, random: &mut Random) -> Result<Vec<Aabb>> {
    let mut steps = Vec::with_capacity(count);
    let (mut feet, mut heading) = (stand(subject, random)?, 0.3f64);
    while steps.len() < count {
        if steps.len() % STEPS == STEPS - 1 {
            feet = stand(subject, random)?;
        }
        let next = feet + Vector3::new(heading.cos(), heading.sin(), 0.0) * STEP_M;
        let raised = pawn(subject, next + Vector3::z() * CLIMB_M)?;
        let floor = subject.oracle.top(&raised, DEPTH_M + CLIMB_M);
        let shape = pawn(subject, Point3::new(next.x, next.y, floor.unwrap_or(next.z) + LIFT_M))?;
        steps.push(shape);
        if floor.is_none() || subject.oracle.hits(&shape) {
            heading = random.between(0.0, std::f64::consts::TAU);
        } else {
            feet = shape.min() + Vector3::new(subject.pawn[0], subject.pawn[1], 0.0) / 2.0;
            heading += random.normal(0.02);
        }
    }
    Ok(steps)
}

/// A place with floor underfoot and room above.
fn stand(subject: &Subject, random: &mut Random) -> Result<Point3<f64>> {
    for _ in 0..20_000 {
        let from = anywhere(subject, random)?;
        let Some(floor) = subject.oracle.top(&from, 4.0 * DEPTH_M) else { continue };
        let middle = nalgebra::center(&from.min(), &from.max());
        let feet = Point3::new(middle.x, middle.y, floor + LIFT_M);
        if !holds(subject, &pawn(subject, feet)?) {
            return Ok(feet);
        }
    }
    Err(format!("{}: no place to stand was found in 20,000", subject.name).into())
}

/// Boxes near solid at one pixel size, and where floors can be distinguished from walls.
pub struct Grazing {
    /// Boxes, and the signed distance of the nearest point, negative inside (m).
    pub shapes: Vec<Aabb>,
    pub gaps: Vec<f64>,
    /// Raised boxes of the walk and the highest points under them, where nothing much higher is within a pixel and a
    /// half: other figures measure how far walls reach.
    pub floors: Vec<(Aabb, f64)>,
}

impl Grazing {
    /// Up to `each` boxes per bin of distance; distances from -1 to 4 pixels.
    pub fn new(subject: &Subject, work: &Workload, pixel_m: f64, each: usize) -> Result<Self> {
        let mut random = Random(77);
        let mut bins = vec![0; ((FARTHEST - NEAREST) * BINS) as usize];
        let mut grazing = Self { shapes: Vec::new(), gaps: Vec::new(), floors: floors(subject, work, pixel_m)? };
        if subject.is_mesh() {
            return Ok(grazing);
        }
        let size = Vector3::from(subject.pawn);
        for _ in 0..each * bins.len() * 4 {
            let p = subject.points[random.bits() as usize % subject.points.len()];
            let wanted = random.between(NEAREST, FARTHEST) * pixel_m;
            let axis = random.bits() as usize % 3;
            let mut min = Point3::from([0, 1, 2].map(|k| p[k] - random.between(0.0, size[k])));
            min[axis] = if random.bits() & 1 == 1 { p[axis] + wanted } else { p[axis] - wanted - size[axis] };
            let shape = Aabb::new(min, min + size)?;
            let Some(gap) = gap(subject, &shape, pixel_m) else { continue };
            let bin = Self::bin(gap, pixel_m);
            if let Some(count) = bins.get_mut(bin).filter(|count| **count < each) {
                *count += 1;
                grazing.shapes.push(shape);
                grazing.gaps.push(gap);
            }
        }
        Ok(grazing)
    }

    /// The bin of a distance.
    pub fn bin(gap: f64, pixel_m: f64) -> usize {
        ((gap / pixel_m - NEAREST) * BINS).floor() as usize
    }

    /// The middle of a bin (m).
    pub fn middle(bin: usize, pixel_m: f64) -> f64 {
        ((bin as f64 + 0.5) / BINS + NEAREST) * pixel_m
    }
}

/// Every fourth raised box of the walk, where the ground around it is no steeper than one in two.
fn floors(subject: &Subject, work: &Workload, pixel_m: f64) -> Result<Vec<(Aabb, f64)>> {
    let mut floors = Vec::new();
    if subject.is_mesh() {
        // Its points are too few to say how high it is.
        return Ok(floors);
    }
    let around = Vector3::new(1.5, 1.5, 0.0) * pixel_m;
    for (shape, floor) in work.raised.iter().zip(&work.floors).step_by(4) {
        let Some(floor) = *floor else { continue };
        let wider = Aabb::new(shape.min() - around, shape.max() + around)?;
        if subject.oracle.top(&wider, DEPTH_M).is_some_and(|top| top - floor <= around.x / 2.0 + 0.01) {
            floors.push((*shape, floor));
        }
    }
    Ok(floors)
}

/// Signed distance of the nearest point along the axis on which it is farthest (m); `None` outside the bins.
fn gap(subject: &Subject, shape: &Aabb, pixel_m: f64) -> Option<f64> {
    let reach = Vector3::repeat(FARTHEST * pixel_m);
    let (min, max) = (shape.min(), shape.max());
    let mut least = f64::INFINITY;
    for p in subject.oracle.points(min - reach, max + reach) {
        let apart = (0..3).map(|axis| (min[axis] - p[axis]).max(p[axis] - max[axis])).fold(f64::MIN, f64::max);
        least = least.min(apart);
        if least < NEAREST * pixel_m {
            return None;
        }
    }
    least.is_finite().then_some(least)
}
