//! Interface of methods that are charted.

use super::subject::Subject;
use crate::Random;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::query::Aabb;

/// A corner (m).
pub type Vec3 = [f64; 3];

/// A way to answer questions about a scene.
pub trait Method {
    /// Name in the table.
    fn name(&self) -> &'static str;

    /// How it was set, in a few words.
    fn settings(&self) -> String;

    /// Whether it knows a resolution; what does not is measured once for all pixel sizes.
    fn has_pixels(&self) -> bool {
        true
    }

    /// Why it cannot be built here at all, if it cannot.
    fn refuses(&self, _subject: &Subject, _pixel_m: f64) -> Option<String> {
        None
    }

    /// A rough guess of the memory it will take (bytes); `cubes` is the number of cubes of a pixel that hold points.
    fn estimate_bytes(&self, subject: &Subject, pixel_m: f64, cubes: usize) -> f64;

    /// How its memory and time grow with the number of cubes: as this power.
    fn growth(&self) -> i32 {
        1
    }

    /// Builds it from the scene's points or file.
    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>>;
}

/// A method, ready to answer.
pub trait Built {
    /// Returns whether a closed box holds solid; every place is in the coordinates of the scene.
    fn hits(&self, shape: &Aabb) -> bool;

    /// Size of its file, if it has one (bytes).
    fn file_bytes(&self) -> Result<Option<u64>> {
        Ok(None)
    }

    /// Memory that it holds for the measurement only, not for answers about boxes (bytes).
    fn spare_bytes(&self) -> usize {
        0
    }

    /// Memory that it holds outside of the counted heap (bytes).
    fn outside_bytes(&self) -> usize {
        0
    }

    /// Calls `give` with the closed boxes that it claims as solid (m); a point is a box without extent.
    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()>;

    /// Returns the distance from a place to the nearest solid that it claims (m), by growing cubes unless overridden.
    fn nearest(&self, to: Point3<f64>) -> f64 {
        nearest_by_boxes(to, |shape| self.hits(shape))
    }

    /// How far a random place of the pawn lies outside of the body that stands for the pawn (m).
    fn cut_off(&self, _pawn: Vec3, _random: &mut Random) -> f64 {
        0.0
    }

    /// Height of the highest solid under a box's footprint, from its bottom down to `depth_m` below.
    fn floor(&self, _shape: &Aabb, _depth_m: f64) -> Option<Option<f64>> {
        None
    }

    /// How far a box comes until the first contact (m).
    fn sweep(&self, _shape: &Aabb, _way: Vector3<f64>) -> Option<f64> {
        None
    }

    /// Heights at which one may stand over a place, between two heights (m).
    fn standing(&self, _place: [f64; 2], _between: [f64; 2]) -> Option<Vec<f64>> {
        None
    }

    /// Returns whether the solid at a place is an obstacle; `None` if the method does not classify.
    fn obstacle(&self, _at: Point3<f64>) -> Option<bool> {
        None
    }
}

/// Edge of the greatest cube that is tried (m).
const FARTHEST_M: f64 = 64.0;

/// Half the edge of the least cube about a place that is a hit (m), to a ten-thousandth.
fn nearest_by_boxes(to: Point3<f64>, hits: impl Fn(&Aabb) -> bool) -> f64 {
    let hit = |half: f64| {
        let half = Vector3::repeat(half);
        Aabb::new(to - half, to + half).is_ok_and(|shape| hits(&shape))
    };
    if hit(0.0) {
        return 0.0;
    }
    let mut high = 1e-4;
    while !hit(high) && high < FARTHEST_M {
        high *= 2.0;
    }
    let mut low = if high == 1e-4 { 0.0 } else { high / 2.0 };
    while high - low > 1e-4 {
        let middle = (low + high) / 2.0;
        *(if hit(middle) { &mut high } else { &mut low }) = middle;
    }
    high
}

/// A box less an origin.
pub fn moved(shape: &Aabb, origin: Vector3<f64>) -> Result<Aabb> {
    Ok(Aabb::new(shape.min() - origin, shape.max() - origin)?)
}

/// The cube of edge `pixel_m` with these indices, from `origin` (m).
pub fn cube(index: [i64; 3], pixel_m: f64, origin: Vector3<f64>) -> (Vec3, Vec3) {
    let corner = |more: i64| [0, 1, 2].map(|axis| (index[axis] + more) as f64 * pixel_m + origin[axis]);
    (corner(0), corner(1))
}
