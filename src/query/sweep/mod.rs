//! Sweeps: the first matter that a moving shape meets.
//!
//! Time of impact of moving boxes by intervals per axis (Ericson, Real-Time Collision Detection, 2005, section 5.5.8),
//! against every span that the motion can reach: tile columns in the order of travel, pages, blocks and spans pruned by
//! the same intervals. Nothing is sampled, so no speed is too high.

mod descent;
mod near;
mod solid;
mod step;

pub(crate) use descent::{GridCell, Matter, SweepArea, Visit, descend};
pub use near::{clearance, clearance_batch, depenetrate, depenetrate_batch};
pub use solid::Solid;
pub use step::{mean_floor_under, top_under};

use super::answer::Answer;
use super::batch;
use super::grid::Rect;
use crate::frame::{Frame, PageKey};
use crate::store::{Missing, PageSet, note};
use nalgebra::Vector3;
use solid::{Contact, Moving, Resting};

/// Farther than all matter is from all (m), and the square of its pixels is finite.
const LONGEST_M: f64 = 1e30;

/// Motions up to here (pixels) hardly leave the blocks around the shape.
const SHORT: f64 = 8.0;

/// Heights that no matter meets: above all that there is, and below.
const NOWHERE: (i64, i64) = (1 << 50, -(1 << 50));

/// The first matter that a moving shape meets.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SweepHit {
    /// Part of the motion until the contact, 0..=1. The shape moved by `fraction · motion` touches the matter.
    pub fraction: f64,
    /// Distance until the contact (m).
    pub distance: f64,
    /// Outward normal of the matter at the contact, of length 1: ±x, ±y or ±z for a box, ±z or across for a cylinder.
    /// Zero if the shape begins inside matter: then the fraction is 0, and [`depenetrate`](super::depenetrate) helps.
    pub normal: Vector3<f64>,
    /// The matter is an obstacle (an obstacle rather than floor, if both are met at once).
    pub obstacle: bool,
    /// Pixel of the matter.
    pub pixel: [i64; 2],
    /// Heights of the matter's span within its page, lowest and highest (m).
    pub heights: [f64; 2],
}

impl SweepHit {
    /// Whether the shape was inside matter before it moved.
    pub fn begins_inside(&self) -> bool {
        self.normal == Vector3::zeros()
    }
}

/// The first matter that `shape` meets on its way along `motion` (m); `None` if the way is free. Not loaded if a page
/// that is not in memory could hold matter before that.
///
/// Matter is as for [all queries](super#what-touching-means), but a sweep asks when the *interiors* meet: a shape that
/// touches matter may move along it and away from it, and one that moves towards it is stopped at 0. Faces that overlap
/// by no more than rounding errors (2⁻⁴⁸ of the coordinates, 4·10⁻⁸ m at 10⁷ m) touch. So what hits before its end,
/// moved by `fraction · motion`, touches there, and the next sweep goes on from there.
///
/// A shape without any height that lies in a plane of matter or in the plane between two pages (64 slices) touches what
/// is on both sides, so nothing stops it there; give it some height.
///
/// The answer does not depend on page, tile or slice boundaries: of contacts at the same time the one against z is
/// taken before x before y, then an obstacle before floor; of a shape that begins inside, any span that it is in. A
/// motion that is not finite is stopped at 0.
///
/// Cost: as [`overlaps`](super::overlaps) over the pixels swept; of long ways only what lies along them is looked at.
///
/// ```
/// use nalgebra::Vector3;
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Aabb, Answer, sweep};
/// use slicewalk::slice::{PageBuilder, Span};
/// use slicewalk::store::Store;
///
/// let frame = Frame::new(0.5, 1.5)?;
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(4, 0, &[Span::new(0, 255, true).unwrap()])); // x from 2 to 2.5, z from 0 to 1.5
/// let store = Store::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let pawn = Aabb::standing([0.0, 0.25, 0.0].into(), [0.5, 0.5, 1.8].into())?;
/// let Answer::Known(Some(hit)) = sweep(&store, &pawn, Vector3::new(100.0, 0.0, 0.0)) else { panic!("a pillar") };
/// assert!((hit.distance - 1.75).abs() < 1e-9);
/// assert_eq!(hit.normal, -Vector3::x());
/// # Ok::<(), slicewalk::Error>(())
/// ```
#[inline]
pub fn sweep<S: PageSet, H: Solid>(set: &S, shape: &H, motion: Vector3<f64>) -> Answer<Option<SweepHit>> {
    let frame = set.frame();
    let rest = shape.resting(frame);
    if !motion.iter().all(|v| v.is_finite()) {
        return Answer::Known(Some(stopped(frame, &rest)));
    }
    // What is left of a longer way leads past no matter.
    let share = if motion.amax() > LONGEST_M { LONGEST_M / motion.amax() } else { 1.0 };
    let motion = motion * share;
    let moving = Moving::new(frame, rest, motion);
    let area = moving.area();
    let is_short = moving.v[0].abs().max(moving.v[1].abs()) <= SHORT;
    let (heights, pixels) = ((area.low, area.high), area.rect);
    let mut search = Search { moving, best: Best::NONE, heights, pixels, is_short, missing: None };
    descend(set, &area, &mut search);
    if search.missing.is_some() && search.best.at < f64::INFINITY {
        // Only pages that could hold an earlier contact matter: those, again.
        search.missing = None;
        descend(set, &area, &mut search);
    }
    let hit = (search.best.at < f64::INFINITY).then(|| search.best.hit(frame, motion, share));
    Answer::new(hit, search.missing)
}

/// [`sweep`] for each of `ways` (a shape and its motion), in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `ways`.
pub fn sweep_batch<S: PageSet, H: Solid>(
    set: &S,
    ways: &[(H, Vector3<f64>)],
    answers: &mut [Answer<Option<SweepHit>>],
) {
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

/// The first contact so far.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Of the motion; -1 for a shape that begins inside, infinite while there is none.
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

    /// Whether this one is to be taken before `other`: an order in which no two contacts are equal.
    fn before(&self, other: &Self) -> bool {
        let axis = |best: &Self| (best.normal[2] == 0.0, best.normal[0] == 0.0, rank(&best.matter));
        self.at.total_cmp(&other.at).then_with(|| axis(self).cmp(&axis(other))).is_lt()
    }

    /// Of a motion that is this `share` of the one asked for.
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

/// The least of matter that is met at the same time counts.
#[inline]
fn rank(matter: &Matter) -> (bool, [i64; 2], i64) {
    (!matter.obstacle, matter.pixel, matter.bottom)
}

struct Search {
    moving: Moving,
    best: Best,
    /// Heights and pixels of matter that may be met first.
    heights: (i64, i64),
    pixels: Rect,
    /// The motion is so short that all blocks around it are looked at.
    is_short: bool,
    missing: Option<Missing>,
}

impl Search {
    /// Whether matter is met at the same time as what was found, because an upright way leads to the same height, but comes after that in
    /// the order of contacts.
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
        // A shape that begins inside looks for no better place.
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
                    // A shape that begins inside looks for no better place.
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
