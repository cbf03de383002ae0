//! `parry3d`: cubes as `Voxels`, their faces as a `TriMesh`, and the triangles of a mesh.

use super::method::{Built, Method, Vec3, cube, moved};
use super::subject::Subject;
use crate::peers::parry;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use parry3d::math::Vector;
use parry3d::shape::{Shape, TriMesh};
use slicewalk::query::Aabb;

/// Memory per cube as `Voxels` in the worst case, alone in its chunk, and as triangles (bytes).
const CHUNK_BYTES: f64 = 700.0;
const TRIANGLES_BYTES: f64 = 800.0;
/// Cubes along an edge of a chunk.
const CHUNK: i32 = 8;

/// Cubes of a pixel's edge.
pub struct Voxels;
/// Their faces.
pub struct Faces;
/// The triangles of a mesh themselves.
pub struct Triangles;

impl Method for Voxels {
    fn name(&self) -> &'static str {
        "parry3d Voxels"
    }

    fn settings(&self) -> String {
        "Voxels::new with cubes of t; intersection_test, cast_shapes that stops at penetration; f32 about the scene's middle"
            .into()
    }

    fn estimate_bytes(&self, subject: &Subject, pixel_m: f64, cubes: usize) -> f64 {
        // Only where it matters are chunks counted.
        match CHUNK_BYTES * cubes as f64 {
            most if most < super::MEMORY_BYTES => most,
            _ => CHUNK_BYTES * subject.cubes(pixel_m * f64::from(CHUNK)) as f64,
        }
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let points: Vec<_> = subject.local().collect();
        let voxels = cubes(&points, pixel_m);
        Ok(Box::new(Solid { shape: voxels, origin: subject.origin, claims: Claims::Cubes(pixel_m) }))
    }
}

impl Method for Faces {
    fn name(&self) -> &'static str {
        "parry3d TriMesh"
    }

    fn settings(&self) -> String {
        "faces of the cubes by Voxels::to_trimesh; no flags; f32 about the scene's middle".into()
    }

    fn estimate_bytes(&self, _: &Subject, _: f64, cubes: usize) -> f64 {
        TRIANGLES_BYTES * cubes as f64
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let points: Vec<_> = subject.local().collect();
        let mesh = parry::mesh(&cubes(&points, pixel_m))?;
        Ok(Box::new(Solid { shape: mesh, origin: subject.origin, claims: Claims::Faces }))
    }
}

impl Method for Triangles {
    fn name(&self) -> &'static str {
        "parry3d TriMesh"
    }

    fn settings(&self) -> String {
        "the triangles themselves; no flags; f32 about the scene's middle".into()
    }

    fn has_pixels(&self) -> bool {
        false
    }

    fn estimate_bytes(&self, subject: &Subject, _: f64, _: usize) -> f64 {
        TRIANGLES_BYTES * subject.triangles.len() as f64
    }

    fn build(&self, subject: &Subject, _: f64) -> Result<Box<dyn Built>> {
        let corner = |p: &[f64; 3]| parry::vector(&(Vector3::from(*p) - subject.origin));
        let vertices = subject.triangles.iter().flatten().map(corner).collect();
        let indices = (0..subject.triangles.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
        Ok(Box::new(Solid { shape: TriMesh::new(vertices, indices)?, origin: subject.origin, claims: Claims::Faces }))
    }
}

/// Cubes of this edge (m) around points.
pub fn cubes(points: &[Point3<f64>], edge_m: f64) -> parry3d::shape::Voxels {
    parry::voxels(points, [edge_m; 3])
}

enum Claims {
    /// Cubes of this edge (m).
    Cubes(f64),
    /// Vertices of triangles.
    Faces,
}

struct Solid<S> {
    shape: S,
    origin: Vector3<f64>,
    claims: Claims,
}

impl<S: Shape> Built for Solid<S> {
    fn hits(&self, shape: &Aabb) -> bool {
        moved(shape, self.origin).is_ok_and(|shape| parry::hits(&self.shape, &shape))
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        let shape: &dyn Shape = &self.shape;
        if let (Claims::Cubes(edge), Some(voxels)) = (&self.claims, shape.as_voxels()) {
            for voxel in voxels.voxels().filter(|voxel| !voxel.state.is_empty()) {
                let key = voxel.grid_coords;
                let (min, max) = cube([key.x, key.y, key.z].map(i64::from), *edge, self.origin);
                give(min, max);
            }
        }
        if let (Claims::Faces, Some(mesh)) = (&self.claims, shape.as_trimesh()) {
            let place = |v: &Vector| [f64::from(v.x), f64::from(v.y), f64::from(v.z)];
            for triangle in mesh.indices() {
                let corners = triangle.map(|n| Vector3::from(place(&mesh.vertices()[n as usize])) + self.origin);
                // A vertex of each, and its middle.
                let middle: [f64; 3] = ((corners[0] + corners[1] + corners[2]) / 3.0).into();
                give(corners[0].into(), corners[0].into());
                give(middle, middle);
            }
        }
        Ok(())
    }

    fn floor(&self, shape: &Aabb, depth_m: f64) -> Option<Option<f64>> {
        let shape = moved(shape, self.origin).ok()?;
        Some(parry::top(&self.shape, &shape, depth_m).map(|z| z + self.origin.z))
    }

    fn sweep(&self, shape: &Aabb, way: Vector3<f64>) -> Option<f64> {
        Some(parry::sweep(&self.shape, &moved(shape, self.origin).ok()?, way))
    }
}
