//! The shape.

use crate::normals::Sides;
use crate::parts::{Part, collect};
use parry3d::bounding_volume::{Aabb, BoundingSphere};
use parry3d::mass_properties::MassProperties;
use parry3d::math::{Pose, Real, Vector};
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::details::NormalConstraints;
use parry3d::query::{PointProjection, PointQuery, Ray, RayCast, RayIntersection};
use parry3d::shape::{
    CompositeShape, CompositeShapeRef, Cuboid, FeatureId, Shape, ShapeType, TypedCompositeShape, TypedShape,
};
use slicewalk::Result;
use slicewalk::frame::PageKey;
use slicewalk::nalgebra::Point3;
use slicewalk::store::Snapshot;
use std::sync::Arc;

/// Treatment of pages that are not in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unloaded {
    /// A solid box around its occupied slices: bodies stop in front of it.
    #[default]
    Solid,
    /// Nothing: bodies pass, and may be inside solid when it is loaded.
    Free,
}

/// Options of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Place in the scan that is the origin of the shape's coordinates (m). Put it near the bodies, because these
    /// coordinates are `f32`.
    pub origin: Point3<f64>,
    /// Treatment of missing pages.
    pub unloaded: Unloaded,
    /// Difference of height up to which neighbouring spans count as one surface for the direction of contacts (m).
    /// The shape itself does not change. 0 for steps of any height; the noise of the scan for rolling without bumps.
    pub level: f64,
}

impl Options {
    /// Returns options with missing pages solid, and surfaces level up to 1 cm.
    pub fn new(origin: Point3<f64>) -> Self {
        Self { origin, unloaded: Unloaded::Solid, level: 0.01 }
    }
}

/// The solid in a box of a scan, as a parry shape. Cloning shares it.
#[derive(Clone)]
pub struct Window(Arc<Inner>);

struct Inner {
    parts: Vec<(Pose, Cuboid, Sides)>,
    tree: Bvh,
    bounds: Aabb,
    missing: Vec<PageKey>,
}

impl Window {
    /// Collects the solid between two corners of the scan (m). Spans that reach out of it are whole, so a body within
    /// the box meets what it would meet in the scan.
    ///
    /// Cost: about 1 µs a span. Fails if the corners are not finite and in order, or if the box covers more than 2²⁶
    /// pixels or 2²² spans.
    pub fn new(set: &Snapshot, min: Point3<f64>, max: Point3<f64>, options: &Options) -> Result<Self> {
        let (parts, missing) = collect(set, min, max, options)?;
        let local = |place: Point3<f64>| {
            let place = place - options.origin;
            Vector::new(place.x as Real, place.y as Real, place.z as Real)
        };
        let boxes: Vec<Aabb> = parts.iter().map(|part| Aabb::new(local(part.min), local(part.max))).collect();
        let part = |(bounds, part): (&Aabb, &Part)| {
            (Pose::from_translation(bounds.center()), Cuboid::new(bounds.half_extents()), Sides(part.level))
        };
        Ok(Self(Arc::new(Inner {
            parts: boxes.iter().zip(&parts).map(part).collect(),
            tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            bounds: Aabb::new(local(min), local(max)),
            missing,
        })))
    }

    /// Returns the pages that were not in memory when the window was created: load them, and create it again.
    pub fn missing(&self) -> &[PageKey] {
        &self.0.missing
    }

    /// Returns the number of cuboids.
    pub fn len(&self) -> usize {
        self.0.parts.len()
    }

    /// Returns whether the window has no solid.
    pub fn is_empty(&self) -> bool {
        self.0.parts.is_empty()
    }

    /// Returns the memory of the shape (bytes).
    pub fn memory_bytes(&self) -> usize {
        size_of::<Inner>()
            + self.0.parts.capacity() * size_of::<(Pose, Cuboid, Sides)>()
            + self.0.tree.heap_memory_size()
    }

    /// Returns the box that was asked for, in the coordinates of the shape (m).
    pub fn bounds(&self) -> Aabb {
        self.0.bounds
    }
}

impl std::fmt::Debug for Window {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Window {{ cuboids: {}, missing: {} }}", self.len(), self.missing().len())
    }
}

impl CompositeShape for Window {
    fn map_part_at(&self, at: u32, f: &mut dyn FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>)) {
        if let Some((pose, shape, sides)) = self.0.parts.get(at as usize) {
            f(Some(pose), shape, Some(sides));
        }
    }

    fn bvh(&self) -> &Bvh {
        &self.0.tree
    }
}

impl TypedCompositeShape for Window {
    type PartShape = Cuboid;
    type PartNormalConstraints = Sides;

    fn map_typed_part_at<T>(
        &self,
        at: u32,
        mut f: impl FnMut(Option<&Pose>, &Cuboid, Option<&Sides>) -> T,
    ) -> Option<T> {
        self.0.parts.get(at as usize).map(|(pose, shape, sides)| f(Some(pose), shape, Some(sides)))
    }

    fn map_untyped_part_at<T>(
        &self,
        at: u32,
        mut f: impl FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>) -> T,
    ) -> Option<T> {
        self.map_typed_part_at(at, |pose, shape, sides| {
            f(pose, shape, sides.map(|sides| sides as &dyn NormalConstraints))
        })
    }
}

impl RayCast for Window {
    fn cast_local_ray(&self, ray: &Ray, most: Real, solid: bool) -> Option<Real> {
        CompositeShapeRef(self).cast_local_ray(ray, most, solid).map(|hit| hit.1)
    }

    fn cast_local_ray_and_get_normal(&self, ray: &Ray, most: Real, solid: bool) -> Option<RayIntersection> {
        let hit = CompositeShapeRef(self).cast_local_ray_and_get_normal(ray, most, solid);
        hit.map(|(part, hit)| hit.with_subshape(part))
    }
}

impl PointQuery for Window {
    fn project_local_point(&self, point: Vector, solid: bool) -> PointProjection {
        let found = CompositeShapeRef(self).project_local_point(point, Real::MAX, solid);
        found.map_or(PointProjection::new(false, point), |(part, mut projection)| {
            projection.subshape = part;
            projection
        })
    }

    fn project_local_point_and_get_feature(&self, point: Vector) -> (PointProjection, FeatureId) {
        let found = CompositeShapeRef(self).project_local_point_and_get_feature(point, Real::MAX);
        found.map_or((PointProjection::new(false, point), FeatureId::Unknown), |(part, mut projection, feature)| {
            projection.subshape = part;
            (projection, feature)
        })
    }

    fn contains_local_point(&self, point: Vector) -> bool {
        CompositeShapeRef(self).contains_local_point(point).is_some()
    }
}

impl Shape for Window {
    fn compute_local_aabb(&self) -> Aabb {
        if self.is_empty() { self.0.bounds } else { self.0.tree.root_aabb() }
    }

    fn compute_local_bounding_sphere(&self) -> BoundingSphere {
        self.compute_local_aabb().bounding_sphere()
    }

    fn clone_dyn(&self) -> Box<dyn Shape> {
        Box::new(self.clone())
    }

    /// A scan is not scaled.
    fn scale_dyn(&self, _scale: Vector, _subdivisions: u32) -> Option<Box<dyn Shape>> {
        None
    }

    /// A scan does not move: it has no mass.
    fn mass_properties(&self, _density: Real) -> MassProperties {
        MassProperties::default()
    }

    fn shape_type(&self) -> ShapeType {
        ShapeType::Custom
    }

    fn as_typed_shape(&self) -> TypedShape<'_> {
        TypedShape::Custom(self)
    }

    fn ccd_thickness(&self) -> Real {
        0.0
    }

    fn ccd_angular_thickness(&self) -> Real {
        std::f32::consts::FRAC_PI_2
    }

    fn as_composite_shape(&self) -> Option<&(dyn CompositeShape + Sync)> {
        Some(self)
    }
}
