//! Who is asked: slicewalk, and the peers in Rust.

use super::matter::{Matter, Mesh};
use super::questions::{Kind, Questions};
use crate::peers::octomap::{Octomap, Tree};
use crate::peers::parry;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb as Bounds;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use parry3d::math::IVector;
use parry3d::shape::{SharedShape, TriMesh, Voxels};
use slicewalk::query::{Aabb, Answer, Overlap, Ray, cast, overlaps, sweep};
use slicewalk::store::Snapshot;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Library that holds the cubes.
pub trait Peer {
    /// Answers the first `count` questions of a kind in turn; returns the time (s), or `None` if it does not know the
    /// kind. The answers replace the content of `answers`: 1 or 0 for places and boxes, else distances (m).
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>>;

    /// Its version, as it says itself.
    fn version(&self) -> Option<String> {
        None
    }

    /// Bytes of its files, with a word for each.
    fn files(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// Bytes in memory, if it counts them.
    fn memory_bytes(&self) -> Option<u64> {
        None
    }
}

/// A peer, or why it is missing.
pub struct Entry {
    pub name: String,
    pub peer: Result<Box<dyn Peer>>,
}

fn timed<T>(items: &[T], answers: &mut Vec<f64>, mut call: impl FnMut(&T) -> f64) -> f64 {
    answers.clear();
    answers.reserve(items.len());
    let start = Instant::now();
    for item in items {
        answers.push(call(std::hint::black_box(item)));
    }
    start.elapsed().as_secs_f64()
}

fn yes(hit: bool) -> f64 {
    f64::from(u8::from(hit))
}

/// Slicewalk on some pages.
pub struct Ours<'a> {
    pub store: &'a Snapshot,
    pub questions: Rc<Questions>,
}

impl Peer for Ours<'_> {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let (store, q) = (self.store, &self.questions);
        let hits = |shape: &Aabb| yes(overlaps(store, shape) == Overlap::Hit);
        Ok(Some(match kind {
            Kind::Points => {
                let place = |p: &Point3<f64>| Aabb::new(*p, *p).map_or(0.0, |shape| hits(&shape));
                timed(&q.points[..count], answers, place)
            }
            Kind::RandomBoxes => timed(&q.random[..count], answers, hits),
            Kind::WalkBoxes => timed(&q.walk[..count], answers, hits),
            Kind::RaisedBoxes => timed(&q.raised[..count], answers, hits),
            Kind::Rays => timed(&q.rays[..count], answers, |ray| match cast(store, ray) {
                Answer::Known(hit) => hit.map_or(f64::INFINITY, |hit| hit.distance),
                Answer::NotLoaded(_) => f64::NAN,
            }),
            Kind::Sweeps => timed(&q.sweeps[..count], answers, |(shape, way)| match sweep(store, shape, *way) {
                Answer::Known(hit) => hit.map_or(way.norm(), |hit| hit.distance),
                Answer::NotLoaded(_) => f64::NAN,
            }),
        }))
    }

    fn memory_bytes(&self) -> Option<u64> {
        Some((self.store.weight_bytes() + self.store.table_bytes()) as u64)
    }
}

/// `parry3d` with one of its shapes.
pub struct Parry {
    shape: SharedShape,
    questions: Rc<Questions>,
}

impl Parry {
    /// The cubes themselves.
    pub fn voxels(matter: &Matter, questions: Rc<Questions>) -> Self {
        let cubes: Vec<_> = matter.cubes.iter().map(|c| IVector::new(c[0], c[1], c[2])).collect();
        let size = parry::vector(&Vector3::repeat(matter.edge));
        Self { shape: SharedShape::new(Voxels::new(size, &cubes)), questions }
    }

    /// Their boundary.
    pub fn mesh(mesh: &Mesh, questions: Rc<Questions>) -> Result<Self> {
        let vertices = mesh.vertices.iter().map(|v| parry3d::math::Vector::new(v[0], v[1], v[2])).collect();
        Ok(Self { shape: SharedShape::new(TriMesh::new(vertices, mesh.triangles.clone())?), questions })
    }
}

impl Peer for Parry {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let (shape, q) = (&*self.shape, &self.questions);
        let hits = |asked: &Aabb| yes(parry::hits(shape, asked));
        Ok(Some(match kind {
            // A mesh has no inside, and `Voxels` knows no more than a box does.
            Kind::Points => return Ok(None),
            Kind::RandomBoxes => timed(&q.random[..count], answers, hits),
            Kind::WalkBoxes => timed(&q.walk[..count], answers, hits),
            Kind::RaisedBoxes => timed(&q.raised[..count], answers, hits),
            Kind::Rays => timed(&q.rays[..count], answers, |ray: &Ray| parry::ray(shape, ray).unwrap_or(f64::INFINITY)),
            Kind::Sweeps => timed(&q.sweeps[..count], answers, |(asked, way)| parry::sweep(shape, asked, *way)),
        }))
    }
}

/// OctoMap, as the charts have it.
pub struct Octree {
    tree: Tree,
    questions: Rc<Questions>,
}

impl Octree {
    pub fn new(matter: &Matter, questions: Rc<Questions>) -> Result<Self> {
        let middle = |c: &[i32; 3]| Point3::from(c.map(|n| (f64::from(n) + 0.5) * matter.edge));
        let points: Vec<_> = matter.cubes.iter().map(middle).collect();
        Ok(Self { tree: Octomap::load()?.tree(&points, matter.edge)?, questions })
    }
}

impl Peer for Octree {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let hits = |asked: &Aabb| yes(self.tree.hits(asked));
        Ok(match kind {
            Kind::RandomBoxes => Some(timed(&self.questions.random[..count], answers, hits)),
            Kind::WalkBoxes => Some(timed(&self.questions.walk[..count], answers, hits)),
            Kind::RaisedBoxes => Some(timed(&self.questions.raised[..count], answers, hits)),
            _ => None,
        })
    }

    fn files(&self) -> Vec<(&'static str, u64)> {
        vec![("`.bt`", self.tree.file_bytes())]
    }

    fn memory_bytes(&self) -> Option<u64> {
        Some(self.tree.memory_bytes())
    }
}

/// `obvhs`: rays through its eight-way tree of the triangles, boxes through its binary tree of the runs of cubes.
pub struct Obvhs {
    rays: CwBvh,
    /// In the order of the tree, so that a leaf's lie side by side.
    triangles: Vec<RtTriangle>,
    /// The tree, with the runs in the tree's order.
    boxes: Option<(Bvh2, Vec<Bounds>)>,
    questions: Rc<Questions>,
}

impl Obvhs {
    /// Of a mesh, and of the cubes where boxes are to be asked, too.
    pub fn new(matter: Option<&Matter>, mesh: &Mesh, questions: Rc<Questions>) -> Self {
        let corner = |n: u32| mesh.vertices[n as usize].into();
        let of = |t: &[u32; 3]| Triangle { v0: corner(t[0]), v1: corner(t[1]), v2: corner(t[2]) };
        let triangles: Vec<Triangle> = mesh.triangles.iter().map(of).collect();
        let mut took = Duration::ZERO;
        let rays = build_cwbvh_from_tris(&triangles, BvhBuildParams::slow_build(), &mut took);
        let triangles = rays.primitive_indices.iter().map(|&n| RtTriangle::from(&triangles[n as usize])).collect();
        let boxes = matter.map(|matter| {
            let all: Vec<Bounds> = matter.runs().map(|[low, high]| bounds(&low, &high)).collect();
            let boxes = build_bvh2(&all, BvhBuildParams::slow_build(), &mut took);
            let runs = boxes.primitive_indices.iter().map(|&n| all[n as usize]).collect();
            (boxes, runs)
        });
        Self { rays, triangles, boxes, questions }
    }

    fn hits((boxes, runs): &(Bvh2, Vec<Bounds>), asked: &Aabb) -> f64 {
        let asked = bounds(&asked.min(), &asked.max());
        let mut hit = false;
        boxes.aabb_traverse(asked, |tree, node| {
            let node = &tree.nodes[node as usize];
            let own = &runs[node.first_index as usize..][..node.prim_count as usize];
            hit = own.iter().any(|run| run.intersect_aabb(&asked));
            !hit
        });
        yes(hit)
    }

    fn cast(&self, ray: &Ray) -> f64 {
        let [from, way] = [ray.origin().coords, ray.direction()].map(|v| single(&v.into()).into());
        let mut hit = RayHit::none();
        let ray = obvhs::ray::Ray::new(from, way, 0.0, ray.max() as f32);
        if self.rays.ray_traverse(ray, &mut hit, |ray, n| self.triangles[n].intersect(ray)) {
            f64::from(hit.t)
        } else {
            f64::INFINITY
        }
    }
}

fn single(p: &Point3<f64>) -> [f32; 3] {
    p.coords.map(|v| v as f32).into()
}

fn bounds(low: &Point3<f64>, high: &Point3<f64>) -> Bounds {
    Bounds::new(single(low).into(), single(high).into())
}

impl Peer for Obvhs {
    fn ask(&mut self, kind: Kind, count: usize, answers: &mut Vec<f64>) -> Result<Option<f64>> {
        let q = &self.questions;
        Ok(match (kind, &self.boxes) {
            (Kind::RandomBoxes, Some(boxes)) => {
                Some(timed(&q.random[..count], answers, |asked| Self::hits(boxes, asked)))
            }
            (Kind::WalkBoxes, Some(boxes)) => Some(timed(&q.walk[..count], answers, |asked| Self::hits(boxes, asked))),
            (Kind::RaisedBoxes, Some(boxes)) => {
                Some(timed(&q.raised[..count], answers, |asked| Self::hits(boxes, asked)))
            }
            (Kind::Rays, _) => Some(timed(&q.rays[..count], answers, |ray| self.cast(ray))),
            _ => None,
        })
    }
}
