//! An object against a scene: a set of pages, of which some may not be in memory.

use super::Object;
use super::oriented::{LocalBox, Relative};
use crate::frame::{Frame, PAGE_QUANTA, TILE_PIXELS};
use crate::query::{Aabb, Overlap, overlaps};
use crate::store::Missing;
use crate::store::{PageSet, PageSlot};
use nalgebra::{Isometry3, Point3};

/// Whether an object touches the matter of a scene; see the [module text](super) for what that means.
///
/// Where pages are missing under a part of the object that touches nothing else, the answer is "not loaded".
pub fn touches_scene<S: PageSet>(object: &Object<'_>, scene: &S) -> Overlap {
    let Some(upright) = Upright::new(object) else { return Overlap::Clear };
    let mut missing: Option<Missing> = None;
    let mut hit = false;
    object.tree().descend(
        |bounds| match overlaps(scene, &upright.around(bounds)) {
            Overlap::Hit => true,
            Overlap::Clear => false,
            Overlap::NotLoaded(pages) => {
                missing.get_or_insert(pages);
                false
            }
        },
        |item| {
            hit = touches_spans(object, item, &upright.around(item), scene);
            hit
        },
    );
    match missing {
        _ if hit => Overlap::Hit,
        Some(missing) => Overlap::NotLoaded(missing),
        None => Overlap::Clear,
    }
}

/// Makes upright boxes around the boxes of an object.
struct Upright {
    relative: Isometry3<f64>,
    abs: nalgebra::Matrix3<f64>,
    slack: f64,
}

impl Upright {
    /// `None` if the object is somewhere that is no place.
    fn new(object: &Object<'_>) -> Option<Self> {
        let finite =
            object.pose.translation.vector.iter().chain(object.pose.rotation.coords.iter()).all(|v| v.is_finite());
        let turn = object.pose.rotation.to_rotation_matrix();
        // More than that of the comparison at the end, which may then decide alone.
        let slack = 4.0 * super::oriented::SLACK * (object.pose.translation.vector.amax() + object.model.radius());
        finite.then(|| Self { relative: object.pose, abs: turn.matrix().abs(), slack })
    }

    fn around(&self, b: &LocalBox) -> Aabb {
        let middle = self.relative * Point3::from(b.middle);
        let half = self.abs * nalgebra::Vector3::from(b.half) + nalgebra::Vector3::repeat(self.slack);
        Aabb::between(middle - half, middle + half)
    }
}

/// Whether a box of the object touches a span of the scene under the upright box around it.
fn touches_spans<S: PageSet>(object: &Object<'_>, item: &LocalBox, around: &Aabb, scene: &S) -> bool {
    let frame = scene.frame();
    let range = |axis: usize| (frame.pixel_of(around.min()[axis]), frame.pixel_of(around.max()[axis]));
    let (x, y) = (range(0), range(1));
    let (low, high) = (frame.quantum_ceil(around.min().z), frame.quantum_floor(around.max().z));
    let tiles = |(first, last): (i64, i64)| first.div_euclid(TILE_PIXELS)..=last.div_euclid(TILE_PIXELS);
    tiles(y).flat_map(|ty| tiles(x).map(move |tx| (tx, ty))).any(|(tx, ty)| {
        let (Ok(tile_x), Ok(tile_y)) = (i32::try_from(tx), i32::try_from(ty)) else { return false };
        scene.column(tile_x, tile_y).iter().any(|slot| {
            let base = i64::from(slot.layer()) * PAGE_QUANTA;
            let Some(page) = slot.page().filter(|_| base <= high && base + PAGE_QUANTA >= low) else { return false };
            let within = |(first, last): (i64, i64), tile: i64| {
                let start = tile * TILE_PIXELS;
                ((first - start).max(0) as u32, (last - start).min(TILE_PIXELS - 1) as u32)
            };
            let (px, py) = (within(x, tx), within(y, ty));
            (py.0..=py.1).flat_map(|v| (px.0..=px.1).map(move |u| (u, v))).any(|(u, v)| {
                page.column(u, v).iter().any(|span| {
                    let (bottom, top) = (base + i64::from(span.bottom()), base + i64::from(span.top()));
                    let pixel = (tx * TILE_PIXELS + i64::from(u), ty * TILE_PIXELS + i64::from(v));
                    bottom <= high && top >= low && meets_span(object, item, frame, pixel, (bottom, top))
                })
            })
        })
    })
}

fn meets_span(object: &Object<'_>, item: &LocalBox, frame: &Frame, pixel: (i64, i64), heights: (i64, i64)) -> bool {
    let t = frame.pixel_m();
    let (bottom, top) = (frame.bottom_height(heights.0), frame.top_height(heights.1));
    let place =
        Isometry3::translation((pixel.0 as f64 + 0.5) * t, (pixel.1 as f64 + 0.5) * t, bottom + (top - bottom) / 2.0);
    let half = [t / 2.0, t / 2.0, (top - bottom) / 2.0];
    let relative = Relative::new(&object.pose, &place, object.model.radius() + half.iter().sum::<f64>());
    relative.meets(item, &LocalBox { middle: [0.0; 3], half })
}
