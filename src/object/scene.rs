//! An object against a scene: a set of pages, some of which may not be in memory.

use super::Object;
use super::oriented::{LocalBox, Relative, SLACK};
use crate::frame::{Frame, PageKey, TILE_PIXELS};
use crate::query::{Aabb, GridCell, Matter, Overlap, SweepArea, Visit, descend, overlaps};
use crate::store::{Missing, Snapshot, join, note};
use nalgebra::{Isometry3, Point3};

/// Returns whether an object touches a scene, as the [module text](super) defines it.
///
/// If a part of the object touches nothing in memory but lies over missing pages, the answer is "not loaded". It may
/// name pages below the axis-aligned boxes around such parts that the parts themselves do not touch.
///
/// Cost: one [`overlaps`] for each box of the object's tree close to solid space, and a look at the spans under each of
/// the object's spans that is close to some. An object that touches nothing costs one [`overlaps`].
pub fn touches_scene(object: &Object<'_>, scene: &Snapshot) -> Overlap {
    let upright = Upright::new(object, scene.frame());
    let mut search = Search::new(object, scene.frame());
    let mut under = None;
    object.tree().descend(
        |bounds| match overlaps(scene, &upright.around(bounds)) {
            Overlap::Hit => true,
            Overlap::Clear => false,
            Overlap::NotLoaded(pages) => {
                join(&mut under, &pages);
                false
            }
        },
        |item| {
            search.item = *item;
            let area = SweepArea::around(scene.frame(), &upright.around(item));
            search.heights = (area.low, area.high);
            descend(scene, &area, &mut search);
            search.hit
        },
    );
    let mut missing = search.missing;
    if let Some(under) = under {
        join(&mut missing, &under);
    }
    match missing {
        _ if search.hit => Overlap::Hit,
        Some(missing) => Overlap::NotLoaded(missing),
        None => Overlap::Clear,
    }
}

/// Returns the sum of the coordinates of an object and of the cells of a scene that are tested against it (m).
fn coordinates_m(object: &Object<'_>, frame: &Frame) -> f64 {
    2.0 * object.coordinates_m + TILE_PIXELS as f64 * (frame.pixel_m() + frame.slice_m())
}

/// Makes axis-aligned boxes around the boxes of an object.
struct Upright {
    relative: Isometry3<f64>,
    abs: nalgebra::Matrix3<f64>,
    slack: f64,
}

impl Upright {
    fn new(object: &Object<'_>, frame: &Frame) -> Self {
        let turn = object.pose.rotation.to_rotation_matrix();
        // Greater than the slack of the final comparison, so that the latter alone decides.
        let slack = 4.0 * SLACK * coordinates_m(object, frame);
        Self { relative: object.pose, abs: turn.matrix().abs(), slack }
    }

    fn around(&self, b: &LocalBox) -> Aabb {
        let middle = self.relative * Point3::from(b.middle);
        let half = self.abs * nalgebra::Vector3::from(b.half) + nalgebra::Vector3::repeat(self.slack);
        Aabb::between(middle - half, middle + half)
    }
}

/// Tests a box of the object against cells of the scene.
struct Search<'a> {
    frame: &'a Frame,
    /// The world in the frame of the object.
    relative: Relative,
    item: LocalBox,
    /// Heights around the box (quanta).
    heights: (i64, i64),
    hit: bool,
    missing: Option<Missing>,
}

impl<'a> Search<'a> {
    fn new(object: &Object<'_>, frame: &'a Frame) -> Self {
        let relative = Relative::new(&object.pose, &Isometry3::identity(), coordinates_m(object, frame));
        let item = LocalBox { middle: [0.0; 3], half: [0.0; 3] };
        Self { frame, relative, item, heights: (0, 0), hit: false, missing: None }
    }

    /// Returns a cell as a box in the world.
    fn place(&self, cell: &GridCell) -> LocalBox {
        let t = self.frame.pixel_m();
        let (bottom, top) = (self.frame.bottom_height(cell.lo[2] as i64), self.frame.top_height(cell.hi[2] as i64));
        let (low, high) = ([cell.lo[0] * t, cell.lo[1] * t, bottom], [cell.hi[0] * t, cell.hi[1] * t, top]);
        let half = [0, 1, 2].map(|axis| (high[axis] - low[axis]) / 2.0);
        LocalBox { middle: [0, 1, 2].map(|axis| low[axis] + half[axis]), half }
    }
}

impl Visit for Search<'_> {
    fn heights(&self) -> (i64, i64) {
        self.heights
    }

    fn enter(&mut self, cell: &GridCell) -> bool {
        !self.hit && !self.relative.separates_by_faces(&self.item, &self.place(cell))
    }

    fn matter(&mut self, matter: &Matter) {
        self.hit = self.hit || self.relative.meets(&self.item, &self.place(&matter.cell()));
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }
}
