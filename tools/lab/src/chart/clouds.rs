//! Methods that know points and spheres: `kiddo` and `capt`.

use super::method::{Built, Method, Vec3, moved};
use super::subject::Subject;
use crate::Random;
use crate::peers::spheres::{Affording, RADIUS, Tree, centers, thinned};
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;
use std::cell::OnceCell;

/// Memory of a tree per point; of a collision-affording one at least (bytes).
const POINT_BYTES: f64 = 64.0;
const AFFORDING_BYTES: f64 = 600.0;

/// `kiddo`: boxes exactly, or the pawn as spheres.
pub struct Kiddo {
    pub exact: bool,
}

/// `capt`.
pub struct Capt;

impl Method for Kiddo {
    fn name(&self) -> &'static str {
        if self.exact { "kiddo exact" } else { "kiddo spheres" }
    }

    fn settings(&self) -> String {
        let how = if self.exact {
            "all points within the sphere around the box, tested in turn"
        } else {
            "the nearest point of six spheres inscribed in the pawn"
        };
        format!("ImmutableKdTree<f64, 3> over all points, no optional features; {how}")
    }

    fn has_pixels(&self) -> bool {
        false
    }

    fn estimate_bytes(&self, subject: &Subject, _: f64, _: usize) -> f64 {
        POINT_BYTES * subject.points.len() as f64
    }

    fn build(&self, subject: &Subject, _: f64) -> Result<Box<dyn Built>> {
        let points = subject.points.iter().map(|&p| p.into()).collect();
        Ok(Box::new(Near { tree: Tree::new(points)?, exact: self.exact }))
    }
}

struct Near {
    tree: Tree,
    exact: bool,
}

impl Built for Near {
    fn spare_bytes(&self) -> usize {
        if self.exact { 0 } else { std::mem::size_of_val(self.tree.points()) }
    }

    fn hits(&self, shape: &Aabb) -> bool {
        if self.exact { self.tree.hits(shape) } else { self.tree.hits_spheres(shape) }
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        self.tree.points().iter().for_each(|&p| give(p, p));
        Ok(())
    }

    fn nearest(&self, to: Point3<f64>) -> f64 {
        self.tree.nearest(to.into())
    }

    fn cut_off(&self, pawn: Vec3, random: &mut Random) -> f64 {
        if self.exact { 0.0 } else { outside_spheres(pawn, random) }
    }
}

impl Method for Capt {
    fn name(&self) -> &'static str {
        "capt"
    }

    fn settings(&self) -> String {
        "one point per cube of t; f32 about the scene's middle; built for the one radius of the pawn's six spheres; one lane"
            .into()
    }

    fn estimate_bytes(&self, _: &Subject, _: f64, cubes: usize) -> f64 {
        AFFORDING_BYTES * cubes as f64
    }

    /// A leaf holds what lies within the radius: more points, each in more leaves.
    fn growth(&self) -> i32 {
        2
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let local: Vec<_> = subject.local().collect();
        let points = thinned(&local, pixel_m);
        let tree = Affording::new(&points);
        Ok(Box::new(Leaves { tree, points, near: OnceCell::new(), origin: subject.origin }))
    }
}

struct Leaves {
    tree: Affording,
    points: Vec<Vec3>,
    /// Tree for nearest points, built on first use.
    near: OnceCell<Tree>,
    origin: Vector3<f64>,
}

impl Built for Leaves {
    fn spare_bytes(&self) -> usize {
        std::mem::size_of_val(&self.points[..])
    }

    fn hits(&self, shape: &Aabb) -> bool {
        moved(shape, self.origin).is_ok_and(|shape| self.tree.hits(&shape))
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        for p in &self.points {
            let p = [0, 1, 2].map(|axis| p[axis] + self.origin[axis]);
            give(p, p);
        }
        Ok(())
    }

    fn nearest(&self, to: Point3<f64>) -> f64 {
        let near = self.near.get_or_init(|| Tree::new(self.points.clone()).expect("it has points"));
        near.nearest((to - self.origin).into())
    }

    fn cut_off(&self, pawn: Vec3, random: &mut Random) -> f64 {
        outside_spheres(pawn, random)
    }
}

/// How far a random place of the pawn lies outside of its spheres (m).
fn outside_spheres(pawn: Vec3, random: &mut Random) -> f64 {
    let Ok(body) = Aabb::standing(Point3::origin(), pawn.into()) else { return 0.0 };
    let at = [0, 1, 2].map(|axis| random.between(body.min()[axis], body.max()[axis]));
    let from = |center: [f64; 3]| (Point3::from(center) - Point3::from(at)).norm() - RADIUS;
    centers(&body).map(from).fold(f64::INFINITY, f64::min).max(0.0)
}
