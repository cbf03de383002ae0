//! Peers that know points and spheres: the collision-affording point tree `capt`, and the k-d tree `kiddo`.

use super::scene::PAWN;
use crate::stability::Result;
use capt::Capt;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;
use slicewalk::query::Aabb;
use std::collections::HashMap;

/// Radius of the spheres that stand for a pawn (m), and their number: inscribed, one above the other.
pub const RADIUS: f64 = PAWN[0] / 2.0;
const COUNT: usize = 6;

pub fn centers(shape: &Aabb) -> impl Iterator<Item = [f64; 3]> {
    let middle = nalgebra::center(&shape.min(), &shape.max());
    let (low, rise) = (shape.min().z + RADIUS, shape.max().z - shape.min().z - 2.0 * RADIUS);
    (0..COUNT).map(move |n| [middle.x, middle.y, low + rise * n as f64 / (COUNT - 1) as f64])
}

/// Returns one point per cube of this edge (m), the resolution that Slicewalk has.
pub fn thinned(points: &[Point3<f64>], edge: f64) -> Vec<[f64; 3]> {
    let mut kept: HashMap<[i64; 3], [f64; 3]> = HashMap::new();
    for p in points {
        kept.entry([p.x, p.y, p.z].map(|v| (v / edge).floor() as i64)).or_insert([p.x, p.y, p.z]);
    }
    let mut kept: Vec<_> = kept.into_values().collect();
    kept.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
    kept
}

pub struct Affording(Capt<3>);

impl Affording {
    /// For the one radius that is asked about, as its documentation advises.
    pub fn new(points: &[[f64; 3]]) -> Self {
        let points: Vec<[f32; 3]> = points.iter().map(|p| p.map(|v| v as f32)).collect();
        Self(Capt::new(&points, (RADIUS as f32, RADIUS as f32), 1))
    }

    pub fn hits(&self, shape: &Aabb) -> bool {
        centers(shape).any(|center| self.0.collides(&center.map(|v| v as f32), RADIUS as f32))
    }
}

pub struct Tree {
    tree: ImmutableKdTree<f64, 3>,
    points: Vec<[f64; 3]>,
}

impl Tree {
    pub fn new(points: Vec<[f64; 3]>) -> Result<Self> {
        let tree = ImmutableKdTree::new_from_slice(&points).map_err(|e| format!("kiddo: {e:?}"))?;
        Ok(Self { tree, points })
    }

    /// The points.
    pub fn points(&self) -> &[[f64; 3]] {
        &self.points
    }

    /// Distance to the nearest point (m).
    pub fn nearest(&self, to: [f64; 3]) -> f64 {
        self.tree.query(&to).nearest_one::<SquaredEuclidean<f64>>().execute().distance.sqrt()
    }

    /// Numbers of the points within this distance (m).
    pub fn within(&self, of: [f64; 3], distance: f64) -> impl Iterator<Item = usize> {
        let near = self.tree.query(&of).within::<SquaredEuclidean<f64>>(distance * distance).unsorted().execute();
        near.into_iter().map(|found| found.item as usize)
    }

    /// The pawn as spheres: the nearest point of each.
    pub fn hits_spheres(&self, shape: &Aabb) -> bool {
        centers(shape).any(|center| {
            self.tree.query(&center).nearest_one::<SquaredEuclidean<f64>>().execute().distance <= RADIUS * RADIUS
        })
    }

    /// Exact: tests every point in the sphere around the box.
    pub fn hits(&self, shape: &Aabb) -> bool {
        let (min, max) = (shape.min(), shape.max());
        let middle = nalgebra::center(&min, &max);
        let around = ((max - min) / 2.0).norm_squared();
        let middle = [middle.x, middle.y, middle.z];
        let near = self.tree.query(&middle).within::<SquaredEuclidean<f64>>(around).unsorted().execute();
        near.iter().any(|found| {
            let p = self.points[found.item as usize];
            (0..3).all(|axis| (min[axis]..=max[axis]).contains(&p[axis]))
        })
    }
}
