//! `parry3d`: the same voxels as `Voxels`, and their faces as a `TriMesh`.

use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use parry3d::math::{IVector, Pose, Vector};
use parry3d::query::{ShapeCastOptions, cast_shapes, intersection_test};
use parry3d::shape::{Cuboid, Shape, TriMesh, Voxels};
use slicewalk::query::{Aabb, Ray};
use std::collections::HashSet;

/// The voxels of this size (m) that hold a point.
pub fn voxels(points: &[Point3<f64>], size: [f64; 3]) -> Voxels {
    let key = |p: &Point3<f64>| [0, 1, 2].map(|axis| (p[axis] / size[axis]).floor() as i32);
    let keys: HashSet<[i32; 3]> = points.iter().map(key).collect();
    let keys: Vec<_> = keys.into_iter().map(|k| IVector::new(k[0], k[1], k[2])).collect();
    Voxels::new(vector(&Vector3::from(size)), &keys)
}

/// The faces of voxels, two triangles each.
pub fn mesh(voxels: &Voxels) -> Result<TriMesh> {
    let (vertices, indices) = voxels.to_trimesh();
    Ok(TriMesh::new(vertices, indices)?)
}

pub fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

fn cuboid(shape: &Aabb) -> (Pose, Cuboid) {
    let center = nalgebra::center(&shape.min(), &shape.max());
    (Pose::from_translation(vector(&center.coords)), Cuboid::new(vector(&((shape.max() - shape.min()) / 2.0))))
}

pub fn hits(world: &dyn Shape, shape: &Aabb) -> bool {
    let (pose, cuboid) = cuboid(shape);
    intersection_test(&Pose::IDENTITY, world, &pose, &cuboid).is_ok_and(|answer| answer.intersecting)
}

/// Distance until the first contact (m).
pub fn sweep(world: &dyn Shape, shape: &Aabb, way: Vector3<f64>) -> f64 {
    let (pose, cuboid) = cuboid(shape);
    let options = ShapeCastOptions { stop_at_penetration: true, ..ShapeCastOptions::with_max_time_of_impact(1.0) };
    let hit = cast_shapes(&Pose::IDENTITY, Vector::ZERO, world, &pose, vector(&way), &cuboid, options);
    hit.ok().flatten().map_or(1.0, |hit| f64::from(hit.time_of_impact)) * way.norm()
}

/// Height of the highest solid under the footprint, down to `depth` below: a thin plate falls.
pub fn top(world: &dyn Shape, shape: &Aabb, depth: f64) -> Option<f64> {
    let (min, mut max) = (shape.min(), shape.max());
    max.z = min.z + 1e-3;
    let plate = Aabb::new(min, max).ok()?;
    let fallen = sweep(world, &plate, Vector3::new(0.0, 0.0, -depth));
    (fallen < depth).then_some(min.z - fallen)
}

/// Distance to the first solid (m).
pub fn ray(world: &dyn Shape, ray: &Ray) -> Option<f64> {
    let length = ray.direction().norm();
    let cast = parry3d::query::Ray::new(vector(&ray.origin().coords), vector(&(ray.direction() / length)));
    world.cast_ray(&Pose::IDENTITY, &cast, ray.max() as f32, true).map(f64::from)
}
