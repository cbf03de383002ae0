//! Scenes: named sets of surfaces with parameters.
//!
//! Each file builds the scenes of one subject; [`build`] holds the carpentry they share (walls with openings, slabs
//! with holes, stairs, columns).

pub mod build;
mod church;
mod city;
mod hall;
mod house;
mod simple;
mod street;
mod tower;

use crate::bvh::Bvh;
use crate::geometry::{Aabb, Placement, Vec3};
use crate::params::{ParamInfo, Params};
use crate::shape::Shape;
use crate::{Error, Result};
use build::Builder;

/// A surface and its role.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// The geometry.
    pub shape: Shape,
    /// Role: "floor", "wall", "column".
    pub label: &'static str,
}

/// A route through a scene that a pawn can walk.
#[derive(Debug, Clone, PartialEq)]
pub struct Walk {
    /// Start of the feet.
    pub start: Vec3,
    /// Places to reach in turn: x, y.
    pub waypoints: Vec<[f64; 2]>,
    /// End of the feet.
    pub end: Vec3,
}

/// A named set of surfaces.
#[derive(Debug, Clone)]
pub struct Scene {
    name: String,
    surfaces: Vec<Surface>,
    bounds: Aabb,
    tree: Bvh,
    walk: Option<Walk>,
    stations: Vec<Vec3>,
}

/// Entry of `scangen list`.
#[derive(Debug, Clone, Copy)]
pub struct SceneInfo {
    /// Name on the command line.
    pub name: &'static str,
    /// One-line description.
    pub about: &'static str,
    /// Parameters.
    pub params: &'static [ParamInfo],
    build: fn(&[f64], &mut Builder),
}

const fn param(name: &'static str, default: f64, min: f64, max: f64, about: &'static str) -> ParamInfo {
    ParamInfo { name, default, min, max, about }
}

/// Every scene, in the order of `scangen list`.
pub const SCENES: &[SceneInfo] = &[
    simple::PLANE,
    simple::RAMPS,
    simple::STAIRS,
    simple::CORRIDOR,
    house::HOUSE,
    hall::HALL,
    church::CHURCH,
    simple::COLUMNS,
    street::STREET,
    simple::TERRAIN,
    tower::TOWER,
    simple::UNIFORM,
    city::EXTENT,
];

impl Scene {
    /// The scene called `name` in [`SCENES`].
    pub fn named(name: &str, params: &Params) -> Result<Self> {
        let info = SCENES.iter().find(|s| s.name == name).ok_or_else(|| {
            let names: Vec<_> = SCENES.iter().map(|s| s.name).collect();
            Error::parameter("SCENE", format!("{name:?} is not one of {}", names.join(", ")))
        })?;
        let values = params.resolve(name, info.params)?;
        let mut builder = Builder::new();
        (info.build)(&values, &mut builder);
        Ok(builder.finish(name))
    }

    /// A scene of these surfaces.
    pub fn new(name: impl Into<String>, surfaces: Vec<Surface>) -> Self {
        let boxes: Vec<_> = surfaces.iter().map(|s| s.shape.bounds()).collect();
        let bounds = boxes.iter().fold(Aabb::EMPTY, |b, next| b.union(next));
        Self { name: name.into(), surfaces, bounds, tree: Bvh::new(&boxes), walk: None, stations: Vec::new() }
    }

    /// Returns the scene with surfaces, walk and stations moved.
    pub fn placed(&self, place: &Placement) -> Self {
        let surfaces = self.surfaces.iter().map(|s| Surface { shape: s.shape.placed(place), label: s.label }).collect();
        let mut scene = Self::new(self.name.clone(), surfaces);
        scene.walk = self.walk.as_ref().map(|w| Walk {
            start: place.apply(w.start),
            waypoints: w.waypoints.iter().map(|[x, y]| place.apply([*x, *y, 0.0])).map(|p| [p[0], p[1]]).collect(),
            end: place.apply(w.end),
        });
        scene.stations = self.stations.iter().map(|s| place.apply(*s)).collect();
        scene
    }

    /// Name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The surfaces; a surface's index is its id.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Smallest box around the surfaces (for terrain, bounded by its amplitudes).
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Area of all surfaces, both sides counted once `[m²]`.
    pub fn area(&self) -> f64 {
        self.surfaces.iter().map(|s| s.shape.area()).sum()
    }

    /// A route to walk, if the scene has one.
    pub fn walk(&self) -> Option<&Walk> {
        self.walk.as_ref()
    }

    /// Stations for a scanner; never empty for a scene of [`SCENES`].
    pub fn stations(&self) -> &[Vec3] {
        &self.stations
    }

    pub(crate) fn tree(&self) -> &Bvh {
        &self.tree
    }
}
