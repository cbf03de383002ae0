//! Sweeps: the first solid that a moving shape meets.
//!
//! Time of impact of moving boxes by intervals per axis (Ericson, Real-Time Collision Detection, 2005, section 5.5.8),
//! against every span that the motion can reach. Tile columns are visited in the order of travel; the same intervals
//! prune pages, blocks and spans. Nothing is sampled, so the result is exact at any speed.

mod clearance;
mod descent;
mod solid;
mod surface;
mod tops;

pub use clearance::{clearance, clearance_batch, depenetrate, depenetrate_batch};
pub(crate) use descent::{GridCell, Matter, SweepArea, Visit, descend};
pub use solid::Solid;
pub use surface::{SurfacePoint, nearest_surface, nearest_surface_batch};
pub use tops::{mean_floor_under, top_under};

use super::answer::Answer;
use super::batch;
use super::grid::Rect;
use crate::frame::{Frame, PageKey};
use crate::store::{Missing, Snapshot, note};
use nalgebra::Vector3;
use solid::{Contact, Moving, Resting};

/// Longer than any motion that can reach something (m), while its square in pixels is still finite.
const LONGEST_M: f64 = 1e30;

/// Motions up to this length (pixels) hardly leave the blocks around the shape.
const SHORT: f64 = 8.0;

/// Heights that no span meets: the lowest top lies above all spans, the highest bottom below.
const NOWHERE: (i64, i64) = (1 << 50, -(1 << 50));

/// First solid that a moving shape meets.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SweepHit {
    /// Part of the motion until the contact, 0..=1. The shape moved by `fraction · motion` touches the solid.
    pub fraction: f64,
    /// Distance until the contact (m).
    pub distance: f64,
    /// Outward normal of the solid at the contact, of length 1: ±x, ±y or ±z for a box, ±z or horizontal for a
    /// cylinder. Zero if the shape begins inside: then the fraction is 0, and [`depenetrate`](super::depenetrate) finds
    /// a way out.
    pub normal: Vector3<f64>,
    /// The span that was met is an obstacle. If the shape meets an obstacle and floor at once, this is the obstacle.
    pub obstacle: bool,
    /// Pixel of the span.
    pub pixel: [i64; 2],
    /// Heights of the span within its page, lowest and highest (m).
    pub heights: [f64; 2],
}

impl SweepHit {
    /// Returns whether the shape was inside a solid before it moved.
    pub fn begins_inside(&self) -> bool {
        self.normal == Vector3::zeros()
    }
}

/// Returns the first solid that `shape` meets along `motion` (m); `None` if it meets none. Not loaded if a page that is
/// not in memory could hold an earlier contact.
///
/// Solid space is that of [all queries](super#definition-of-touching), but a sweep tests when the *interiors* meet: a
/// shape in contact may move along the solid and away from it; if it moves towards it, it is stopped at 0. Faces that
/// overlap by no more than rounding errors (2⁻⁴⁸ of the coordinates, 4·10⁻⁸ m at 10⁷ m) are in contact. So a shape
/// moved by `fraction · motion` to a contact touches there, and the next sweep continues from there.
///
/// A shape of zero height in a plane where spans end, or in the plane between two pages (64 slices), touches the solid
/// on both sides, so nothing stops it there. Give it some height.
///
/// The answer does not depend on page, tile or slice boundaries. Among contacts at the same time, one against z
/// precedes x, x precedes y, and then an obstacle precedes floor. A shape that begins inside reports any span that it
/// is in. A motion that is not finite is stopped at 0.
///
/// Cost: like [`overlaps`](super::overlaps) over the pixels swept; long motions visit only what lies along them.
/// ```
/// use nalgebra::Vector3;
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Aabb, Answer, sweep};
/// use slicewalk::page::{PageBuilder, Span};
/// use slicewalk::store::Snapshot;
///
/// let frame = Frame::new(0.5, 1.5)?;
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(4, 0, &[Span::new(0, 255, true).unwrap()])); // x from 2 to 2.5, z from 0 to 1.5
/// let store = Snapshot::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let pawn = Aabb::standing([0.0, 0.25, 0.0].into(), [0.5, 0.5, 1.8].into())?;
/// let Answer::Known(Some(hit)) = sweep(&store, &pawn, Vector3::new(100.0, 0.0, 0.0)) else { panic!("a pillar") };
/// assert!((hit.distance - 1.75).abs() < 1e-9);
/// assert_eq!(hit.normal, -Vector3::x());
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[inline]
pub fn sweep<H: Solid>(set: &Snapshot, shape: &H, motion: Vector3<f64>) -> Answer<Option<SweepHit>> {
    let frame = set.frame();
    let rest = shape.resting(frame);
    if !motion.iter().all(|v| v.is_finite()) {
        return Answer::Known(Some(stopped(frame, &rest)));
    }
    // The rest of a longer motion meets nothing.
    let share = if motion.amax() > LONGEST_M { LONGEST_M / motion.amax() } else { 1.0 };
    let motion = motion * share;
    let moving = Moving::new(frame, rest, motion);
    let area = moving.area();
    let is_short = moving.v[0].abs().max(moving.v[1].abs()) <= SHORT;
    let (heights, pixels) = ((area.low, area.high), area.rect);
    let mut search = Search { moving, best: Best::NONE, heights, pixels, is_short, missing: None };
    descend(set, &area, &mut search);
    if search.missing.is_some() && search.best.at < f64::INFINITY {
        // Search again: only pages that could hold an earlier contact are reported as missing.
        search.missing = None;
        descend(set, &area, &mut search);
    }
    let hit = (search.best.at < f64::INFINITY).then(|| search.best.hit(frame, motion, share));
    Answer::new(hit, search.missing)
}

/// Runs [`sweep`] for each of `ways` (a shape and its motion), in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `ways`.
pub fn sweep_batch<H: Solid>(set: &Snapshot, ways: &[(H, Vector3<f64>)], answers: &mut [Answer<Option<SweepHit>>]) {
    let pixel = |(shape, _): &(H, Vector3<f64>)| batch::pixel_of(set, shape);
    batch::answer_each(set, ways, answers, pixel, |(shape, motion)| sweep(set, shape, *motion));
}

fn stopped(frame: &Frame, rest: &Resting) -> SweepHit {
    let [x, y, z] = rest.lo;
    let z = z / frame.quanta(1.0);
    SweepHit {
        fraction: 0.0,
        distance: 0.0,
        normal: Vector3::zeros(),
        obstacle: false,
        pixel: [x as i64, y as i64],
        heights: [z, z],
    }
}

/// First contact found.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Fraction of the motion; -1 for a shape that begins inside, infinite if there is no contact.
    at: f64,
    normal: [f64; 3],
    matter: Matter,
}

impl Best {
    const NONE: Self = Self {
        at: f64::INFINITY,
        normal: [0.0; 3],
        matter: Matter { pixel: [0; 2], bottom: 0, top: 0, obstacle: false },
    };

    /// Returns whether this contact precedes `other`, in an order in which no two contacts are equal.
    fn before(&self, other: &Self) -> bool {
        let axis = |best: &Self| (best.normal[2] == 0.0, best.normal[0] == 0.0, rank(&best.matter));
        self.at.total_cmp(&other.at).then_with(|| axis(self).cmp(&axis(other))).is_lt()
    }

    /// Converts the contact to a hit; `motion` is this `share` of the requested motion.
    fn hit(&self, frame: &Frame, motion: Vector3<f64>, share: f64) -> SweepHit {
        let fraction = self.at.max(0.0);
        SweepHit {
            fraction: fraction * share,
            distance: fraction * motion.norm(),
            normal: Vector3::from(self.normal),
            obstacle: self.matter.obstacle,
            pixel: self.matter.pixel,
            heights: [frame.bottom_height(self.matter.bottom), frame.top_height(self.matter.top)],
        }
    }
}

/// Sort key among spans met at the same time; the least one is reported.
#[inline]
fn rank(matter: &Matter) -> (bool, [i64; 2], i64) {
    (!matter.obstacle, matter.pixel, matter.bottom)
}

struct Search {
    moving: Moving,
    best: Best,
    /// Heights and pixels of spans that may be met first.
    heights: (i64, i64),
    pixels: Rect,
    /// The motion is so short that all blocks around it are visited.
    is_short: bool,
    missing: Option<Missing>,
}

impl Search {
    /// Returns whether a span would be met at the same time as the best one, because an upright motion leads to the
    /// same height, but follows it in the order of contacts.
    #[inline]
    fn is_later_of_equal(&self, matter: &Matter) -> bool {
        let best = &self.best.matter;
        let equal = if self.moving.v[2] < 0.0 { matter.top == best.top } else { matter.bottom == best.bottom };
        equal && self.moving.is_upright && self.best.at < f64::INFINITY && rank(matter) >= rank(best)
    }
}

impl Visit for Search {
    #[inline]
    fn enter(&mut self, cell: &GridCell) -> bool {
        let meeting = self.moving.meeting(cell);
        // A shape that begins inside looks no further.
        meeting.is_some() && meeting.enter <= self.best.at && self.best.at >= 0.0
    }

    #[inline]
    fn matter(&mut self, matter: &Matter) {
        let [i, j] = matter.pixel;
        if self.best.at < 0.0 || !self.pixels.holds(i, j) || self.is_later_of_equal(matter) {
            return;
        }
        if let Some(Contact { at, normal }) = self.moving.contact(&matter.cell(), self.best.at) {
            let found = Best { at, normal, matter: *matter };
            if found.before(&self.best) {
                self.best = found;
                if at < 0.0 {
                    // A shape that begins inside looks no further.
                    self.heights = NOWHERE;
                } else {
                    self.heights = self.moving.heights_before(at, self.heights);
                    self.pixels = self.moving.pixels_before(at, self.pixels);
                }
            }
        }
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }

    #[inline]
    fn heights(&self) -> (i64, i64) {
        self.heights
    }

    #[inline]
    fn takes_all(&self) -> bool {
        self.is_short
    }

    #[inline]
    fn across(&self, axis: usize, lo: f64, hi: f64) -> (f64, f64) {
        self.moving.across(axis, lo, hi)
    }
}

#[cfg(test)]
mod tests;
