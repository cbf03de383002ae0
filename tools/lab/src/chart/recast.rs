//! Recast: it knows floors and no boxes, so its cell has only what a floor has.

use super::cell::stand_figures;
use super::record::{Cell, Figure};
use super::subject::Subject;
use super::walkable::{self, Column};
use crate::peers::parry;
use crate::peers::recast::{Navmesh, SETTINGS, Triangle, of_mesh, of_scene};
use crate::stability::Result;
use nalgebra::Point3;

/// Name in the table.
pub const NAME: &str = "recast";
/// Steps of curved surfaces (m).
const STEP_M: f64 = 0.05;
/// Cubes whose faces are still few enough: twelve triangles each at worst.
const MOST_CUBES: usize = 3_000_000;

/// Triangles to walk on, and the time of the last build.
pub struct Ground {
    /// `None` for scans: the faces of their cubes are used instead.
    triangles: Option<Vec<Triangle>>,
    before: Option<(usize, f64)>,
}

impl Ground {
    /// The triangles of a scene, if it has surfaces.
    pub fn new(subject: &Subject) -> Self {
        let of_mesh = || subject.triangles.iter().map(|corners| corners.map(Point3::from)).collect();
        let scene = subject.scene.as_ref();
        let triangles = if subject.is_mesh() { Some(of_mesh()) } else { scene.map(|scene| of_scene(scene, STEP_M)) };
        Self { triangles, before: None }
    }

    /// Returns its cell; pixel sizes are expected from coarse to fine, so that the cost of the next can be predicted.
    pub fn cell(
        &mut self,
        subject: &Subject,
        pixel_cm: u32,
        cubes: usize,
        columns: &[Column],
        budget_s: f64,
    ) -> Result<Cell> {
        let from = if self.triangles.is_some() { "the true triangles" } else { "the faces of cubes of t" };
        let mut cell = Cell {
            scene: subject.name.clone(),
            method: NAME.into(),
            settings: format!("from {from}; {SETTINGS}"),
            pixel_cm,
            figures: Vec::new(),
            phantoms: Vec::new(),
        };
        let expected = self.before.map_or(0.0, |(before, seconds)| seconds * cubes as f64 / before.max(1) as f64);
        if expected > budget_s {
            cell.settings = format!("would take about {expected:.0} s to build; {budget_s} s is the limit");
            return Ok(cell);
        }
        match self.navmesh(subject, f64::from(pixel_cm) / 100.0, cubes) {
            Ok(navmesh) if navmesh.navmesh_bytes == 0 => cell.settings = "no region is large enough to walk on".into(),
            Ok(navmesh) => {
                self.before = Some((cubes, navmesh.build_s));
                cell.figures = vec![
                    Figure::one("build_s", navmesh.build_s, 1),
                    Figure::one("resident_bytes", navmesh.navmesh_bytes as f64, 1),
                    Figure::one("heightfield_bytes", navmesh.heightfield_bytes as f64, 1),
                ];
                let judged = walkable::judge(columns, |x, y| navmesh.heights(x, y));
                cell.figures.extend(stand_figures(&judged));
            }
            Err(why) => cell.settings = why.to_string(),
        }
        Ok(cell)
    }

    fn navmesh(&self, subject: &Subject, pixel_m: f64, cubes: usize) -> Result<Navmesh> {
        if let Some(triangles) = &self.triangles {
            return Navmesh::build(triangles, pixel_m);
        }
        if cubes > MOST_CUBES {
            return Err(format!("{cubes} cubes have too many faces; {MOST_CUBES} is the limit").into());
        }
        let points: Vec<_> = subject.local().collect();
        let mesh = parry::mesh(&parry::voxels(&points, [pixel_m; 3]))?;
        Navmesh::build(&of_mesh(&mesh, subject.origin), pixel_m)
    }
}
