//! Bodies for object tests, and simple ways to compare them without code of the library.
#![allow(dead_code, reason = "each test file uses a part")]

pub use crate::random::Random;

use crate::data;

use super::files::{Triangle, read};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// A random position within `reach` of the origin along each axis, in any rotation.
pub fn pose(random: &mut Random, reach: f64) -> Isometry3<f64> {
    let place = Translation3::from([0; 3].map(|_| random.between(-reach / 2.0, reach / 2.0)));
    let turn = [0; 3].map(|_| random.between(-3.1, 3.1));
    Isometry3::from_parts(place, UnitQuaternion::from_euler_angles(turn[0], turn[1], turn[2]))
}

/// The Stanford bunny around its centre; `None`, with a line on standard error, if it is missing.
pub fn bunny() -> Option<Vec<Triangle>> {
    let path = data::file("meshes/bunny_stanford.ply")?;
    let middle = [-0.017, 0.11, -0.002];
    Some(read(&path).into_iter().map(|t| t.map(|p| [0, 1, 2].map(|k| p[k] - middle[k]))).collect())
}

/// A closed ring of radius 1 and thickness 0.4 around the z axis, of `2·n·m` triangles.
pub fn knot(n: usize, m: usize) -> Vec<Triangle> {
    let corner = |i: usize, j: usize| {
        let turn = |k: usize, of: usize| (k % of) as f64 / of as f64 * std::f64::consts::TAU;
        let (u, v) = (turn(i, n), turn(j, m));
        let r = 1.0 + 0.4 * v.cos();
        [r * u.cos(), r * u.sin(), 0.4 * v.sin()]
    };
    let quads = (0..n).flat_map(|i| (0..m).map(move |j| (i, j)));
    quads
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// A level square of `n` × `n` metres.
pub fn grid(n: u32) -> Vec<Triangle> {
    let n = f64::from(n);
    vec![[[0.0; 3], [n, 0.0, 0.0], [n, n, 0.0]], [[0.0; 3], [n, n, 0.0], [0.0, n, 0.0]]]
}

pub fn placed(triangles: &[Triangle], pose: &Isometry3<f64>) -> Vec<[Vector3<f64>; 3]> {
    triangles.iter().map(|t| t.map(|p| (pose * Point3::from(p)).coords)).collect()
}

/// A box in the world, given by its corners.
#[derive(Debug)]
pub struct Oriented {
    axes: [Vector3<f64>; 3],
    middle: Vector3<f64>,
    half: [f64; 3],
    radius: f64,
}

impl Oriented {
    pub fn new(pose: &Isometry3<f64>, min: Point3<f64>, max: Point3<f64>) -> Self {
        let half = (max - min) / 2.0;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| pose * axis);
        Self { axes, middle: (pose * (min + half)).coords, half: half.into(), radius: half.norm() }
    }

    /// Returns whether the bounding spheres of the boxes meet.
    pub fn is_near(&self, other: &Self) -> bool {
        (self.middle - other.middle).norm_squared() <= (self.radius + other.radius + 1e-6).powi(2)
    }

    /// Largest gap along any separating axis.
    pub fn gap(&self, other: &Self) -> f64 {
        let crossed = self.axes.iter().flat_map(|a| other.axes.iter().map(move |b| a.cross(b)));
        let axes = self.axes.iter().copied().chain(other.axes).chain(crossed);
        let between = other.middle - self.middle;
        let reach =
            |of: &Self, axis: &Vector3<f64>| (0..3).map(|k| of.half[k] * of.axes[k].dot(axis).abs()).sum::<f64>();
        axes.filter(|axis| axis.norm() > 1e-6)
            .map(|axis| axis.normalize())
            .map(|axis| between.dot(&axis).abs() - reach(self, &axis) - reach(other, &axis))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    pub fn distance_to(&self, point: Point3<f64>) -> f64 {
        let d = point.coords - self.middle;
        (0..3).map(|k| (d.dot(&self.axes[k]).abs() - self.half[k]).max(0.0).powi(2)).sum::<f64>().sqrt()
    }
}

/// Minimum over all pairs of the largest gap along any separating axis of two triangles.
pub fn gap_of_triangles(a: &[[Vector3<f64>; 3]], b: &[[Vector3<f64>; 3]]) -> f64 {
    let ball = |t: &[Vector3<f64>; 3]| {
        let middle = (t[0] + t[1] + t[2]) / 3.0;
        (middle, t.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max))
    };
    let balls: Vec<_> = b.iter().map(ball).collect();
    let mut least = f64::INFINITY;
    for one in a {
        let (middle, radius) = ball(one);
        for (other, (center, reach)) in b.iter().zip(&balls) {
            // The distance of separate bounding spheres is a gap too.
            let apart = (middle - center).norm() - radius - reach;
            least = least.min(if apart > 0.0 {
                apart.max(gap_of_pair(one, other, apart))
            } else {
                gap_of_pair(one, other, apart)
            });
        }
    }
    least
}

fn gap_of_pair(a: &[Vector3<f64>; 3], b: &[Vector3<f64>; 3], apart: f64) -> f64 {
    if apart > 1.0 {
        return apart;
    }
    let edges = |t: &[Vector3<f64>; 3]| [t[1] - t[0], t[2] - t[1], t[0] - t[2]];
    let (e, f) = (edges(a), edges(b));
    let normals = [e[0].cross(&e[1]), f[0].cross(&f[1])];
    let crossed = e.iter().flat_map(|p| f.iter().map(move |q| p.cross(q)));
    // In a common plane, the normals of the edges decide.
    let flat = e.iter().map(|p| p.cross(&normals[0])).chain(f.iter().map(|q| q.cross(&normals[1])));
    normals
        .into_iter()
        .chain(crossed)
        .chain(flat)
        .filter(|axis| axis.norm() > 1e-12)
        .map(|axis| {
            let axis = axis.normalize();
            let range = |t: &[Vector3<f64>; 3]| {
                let d = t.map(|p| p.dot(&axis));
                (d.into_iter().fold(f64::INFINITY, f64::min), d.into_iter().fold(f64::NEG_INFINITY, f64::max))
            };
            let (p, q) = (range(a), range(b));
            (q.0 - p.1).max(p.0 - q.1)
        })
        .fold(f64::NEG_INFINITY, f64::max)
}
