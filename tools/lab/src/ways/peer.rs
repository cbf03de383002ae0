//! Recast, built for each radius: from the true triangles, and from the faces of the voxels of the scan.

use super::claims::Pixel;
use crate::peers::parry;
use crate::peers::recast::{Navmesh, Triangle, of_mesh, of_scene};
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use scangen::Scene;
use slicewalk::frame::Frame;

/// Steps of curved surfaces (m).
const STEP_M: f64 = 0.05;
/// Cubes whose faces are still few enough.
const MOST_CUBES: usize = 2_000_000;

/// Input of Recast.
pub struct Meshes {
    pub truth: Vec<Triangle>,
    /// `None`: too many voxels.
    pub scan: Option<Vec<Triangle>>,
}

impl Meshes {
    /// Of a scene, and of points of its scan in cubes of `pixel_m` (m).
    pub fn new(scene: &Scene, points: &[[f64; 3]], pixel_m: f64) -> Result<Self> {
        let origin = Vector3::from(scene.bounds().center()).map(f64::floor);
        let local: Vec<Point3<f64>> = points.iter().map(|p| Point3::from(*p) - origin).collect();
        let mut cubes: Vec<[i32; 3]> =
            local.iter().map(|p| [p.x, p.y, p.z].map(|v| (v / pixel_m).floor() as i32)).collect();
        cubes.sort_unstable();
        cubes.dedup();
        let scan = if cubes.len() <= MOST_CUBES {
            let middles: Vec<Point3<f64>> =
                cubes.iter().map(|cube| Point3::from(cube.map(|v| (f64::from(v) + 0.5) * pixel_m))).collect();
            Some(of_mesh(&parry::mesh(&parry::voxels(&middles, [pixel_m; 3]))?, origin))
        } else {
            None
        };
        Ok(Self { truth: of_scene(scene, STEP_M), scan })
    }
}

/// Returns the heights that a navmesh claims over the middle of a pixel; empty if no navmesh could be built.
pub fn claims(navmesh: Option<&Navmesh>, frame: &Frame, pixel: Pixel) -> Vec<f64> {
    let [x, y] = pixel.map(|v| (v as f64 + 0.5) * frame.pixel_m());
    navmesh.map_or_else(Vec::new, |navmesh| navmesh.heights(x, y))
}
