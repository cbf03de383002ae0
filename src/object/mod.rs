//! Rigid objects made of voxels: against each other, against pawns, and against scenes.
//!
//! In: [`Model`]s, made from the pages of an archive or from triangles, and where they are ([`Object`]). Out: whether
//! they touch. The thesis names this as future work ("inter-object collision ... by cross-checking both image
//! representations for occupied pixels", section 5.1).
//!
//! # What touching means
//!
//! The matter of a model is that of queries: a span of pixel `(i, j)` fills the closed box of the pixel's square and all
//! heights from its bottom to its top. An object carries these boxes, turned and moved by its pose. Two objects touch if
//! a box of one and a box of the other share a point; this is decided for oriented boxes by the 15 separating axes
//! (Gottschalk, Lin and Manocha, "OBBTree", 1996), and grows by `2⁻⁴⁵` of the coordinates for rounding, towards "hit":
//! those of the places, and those of the models themselves, for a model may be built far from its origin and moved back.
//! So of two surfaces that touch none is missed (G1), whatever their poses; and objects that touch have surfaces within
//! the diagonals of a voxel of each, where no more than a pixel of `t × t × σ` lies between a box and its surface.
//!
//! # Method
//!
//! A binary tree of boxes over each model's spans, cut at the median; two trees are descended together, larger box
//! first. A scene is its own summary: the boxes of the object's tree are asked of its pages, blocks and spans by
//! [`overlaps`](crate::query::overlaps), and the few that remain are held against single spans. Nothing is allocated,
//! locked or waited for. The cost grows with what lies near the other: boxes apart end the search at once.
//!
//! ```no_run
//! use slicewalk::archive::Archive;
//! use slicewalk::object::{Model, Object, touches, touches_scene};
//! use slicewalk::query::Overlap;
//! use slicewalk::store::Store;
//!
//! let store = |path: &str| Store::resident(&Archive::open(path)?, &slicewalk::NoMonitor);
//! let (scene, cart) = (store("hall.slices")?, Model::from_pages(&store("cart.slices")?)?);
//! let here = Object::new(&cart, nalgebra::Isometry3::translation(3.0, 2.0, 0.1))?;
//! let there = Object::new(&cart, nalgebra::Isometry3::rotation(nalgebra::Vector3::z() * 0.5))?;
//! let free = !touches(&here, &there) && touches_scene(&here, &scene) == Overlap::Clear;
//! # Ok::<(), slicewalk::Error>(())
//! ```

mod fill;
mod model;
mod oriented;
mod scene;
mod tree;

pub use model::Model;
pub use scene::touches_scene;

use crate::query::{Aabb, Sphere, all_within_reach};
use crate::{Error, Result};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use oriented::{LocalBox, Relative};
use tree::{Tree, deepest};

/// A model in its place.
#[derive(Debug, Clone, Copy)]
pub struct Object<'a> {
    model: &'a Model,
    /// From the coordinates of the model's tree, which are about its middle, to the world.
    pose: Isometry3<f64>,
    /// Sum of the coordinates that the pose and the model's boxes come from (m): their rounding errors scale with it.
    coordinates_m: f64,
}

impl<'a> Object<'a> {
    /// `model` moved from its own coordinates by `pose` (m).
    ///
    /// Fails if a number of the pose is NaN, a translation lies beyond ±10¹⁰⁰ m, or the rotation's quaternion is not of
    /// length 1 (to 10⁻⁶; what is left of that is taken out).
    pub fn new(model: &'a Model, pose: Isometry3<f64>) -> Result<Self> {
        let length = pose.rotation.quaternion().norm();
        let is_turn = (length - 1.0).abs() <= 1e-6;
        if !is_turn || !all_within_reach(&pose.translation.vector) {
            let reason = format!("no object can be moved by {:?} m", pose.translation.vector.as_slice());
            return Err(Error::parameter("pose", format!("{reason} and turned by a quaternion of length {length}")));
        }
        let rotation = UnitQuaternion::new_normalize(pose.rotation.into_inner());
        let middle = model.middle();
        let placed = Isometry3::from_parts(pose.translation, rotation) * Translation3::from(middle.coords);
        let places = [pose.translation.vector, middle.coords, placed.translation.vector];
        let coordinates_m = places.iter().map(Vector3::amax).sum::<f64>() + model.radius();
        Ok(Self { model, pose: placed, coordinates_m })
    }

    /// The model.
    pub fn model(&self) -> &'a Model {
        self.model
    }

    /// Middle (m) and radius (m) of a ball around the object: a first look for those who move many.
    pub fn ball(&self) -> (Point3<f64>, f64) {
        (Point3::from(self.pose.translation.vector), self.model.radius())
    }

    fn tree(&self) -> &'a Tree {
        self.model.tree()
    }
}

/// Whether two objects touch; see the [module text](self) for what that means. Ends at the first contact.
///
/// Cost: a hundred nanoseconds for objects apart. A close miss costs what lies near: for two bunnies of 30,000 to 400,000
/// spans 0.1 to 0.3 ms in the median of poses and 3 ms at most; at worst, for surfaces oblique to their grids that run
/// parallel within two voxels of each other, some microseconds for each of their spans.
pub fn touches(a: &Object<'_>, b: &Object<'_>) -> bool {
    let relative = Relative::new(&a.pose, &b.pose, a.coordinates_m + b.coordinates_m);
    let (left, right) = (a.tree(), b.tree());
    let mut open = Pairs::default();
    if !left.is_empty() && !right.is_empty() {
        open.push((0, 0));
    }
    while let Some((m, n)) = open.pop() {
        let (one, other) = (left.node(m), right.node(n));
        if relative.separates_by_faces(&one.bounds(), &other.bounds()) {
            continue;
        }
        // The larger is cut, and the half nearer to the other comes first: it may end the search.
        let halves = match (one.children(m), other.children(n)) {
            (None, None) => {
                let near = left.items(one).filter(|p| !relative.separates_by_faces(p, &other.bounds()));
                let pairs = near.flat_map(|p| right.items(other).map(move |q| (p, q)));
                if pairs.into_iter().any(|(p, q)| relative.meets(&p, &q)) {
                    return true;
                }
                continue;
            }
            (Some(_), Some(halves)) if other.size() > one.size() => halves.map(|half| (m, half)),
            (None, Some(halves)) => halves.map(|half| (m, half)),
            (Some(halves), _) => halves.map(|half| (half, n)),
        };
        let [first, second] = halves;
        let far = |(m, n): (u32, u32)| relative.distance_squared(&left.node(m).bounds(), &right.node(n).bounds());
        let (near, far) = if far(first) <= far(second) { (first, second) } else { (second, first) };
        open.push(far);
        open.push(near);
    }
    false
}

/// Whether an object touches a box that stands upright in the world, for example a pawn.
pub fn touches_box(object: &Object<'_>, shape: &Aabb) -> bool {
    // Only what the object can reach counts; that is finite.
    let (center, radius) = object.ball();
    let reach = Vector3::repeat(radius + 4.0 * oriented::SLACK * object.coordinates_m);
    let (low, high) = (shape.min().sup(&(center - reach)), shape.max().inf(&(center + reach)));
    if (0..3).any(|axis| low[axis] > high[axis]) {
        return false;
    }
    let half = (high - low) / 2.0;
    let middle = Isometry3::translation(low.x + half.x, low.y + half.y, low.z + half.z);
    let relative = Relative::new(&object.pose, &middle, 2.0 * object.coordinates_m + half.norm());
    let shape = LocalBox { middle: [0.0; 3], half: half.into() };
    object.tree().any(|bounds| !relative.separates_by_faces(bounds, &shape), |item| relative.meets(item, &shape))
}

/// Whether an object touches a sphere.
pub fn touches_sphere(object: &Object<'_>, sphere: &Sphere) -> bool {
    let center = object.pose.inverse_transform_point(&sphere.center());
    let coordinates_m = object.coordinates_m + center.coords.amax() + sphere.center().coords.amax();
    let reach = sphere.radius() + oriented::SLACK * coordinates_m;
    let near = |bounds: &LocalBox| {
        let beyond = |axis: usize| ((center[axis] - bounds.middle[axis]).abs() - bounds.half[axis]).max(0.0);
        Vector3::new(beyond(0), beyond(1), beyond(2)).norm_squared() <= reach * reach
    };
    object.tree().any(near, near)
}

/// Pairs of nodes to look at. A pair gives way to two, one level deeper on one side, so there are never more than the
/// levels of both trees and one.
struct Pairs {
    open: [(u32, u32); 2 * deepest() + 2],
    count: usize,
}

impl Default for Pairs {
    fn default() -> Self {
        Self { open: [(0, 0); 2 * deepest() + 2], count: 0 }
    }
}

impl Pairs {
    #[inline]
    fn push(&mut self, pair: (u32, u32)) {
        self.open[self.count] = pair;
        self.count += 1;
    }

    #[inline]
    fn pop(&mut self) -> Option<(u32, u32)> {
        self.count = self.count.checked_sub(1)?;
        Some(self.open[self.count])
    }
}
