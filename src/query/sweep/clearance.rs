//! Clearance of a shape, and the shortest way out of solid space.

use super::descent::{GridCell, Matter, SweepArea, Visit, descend};
use super::solid::{Form, Moving, Resting, Solid, norm};
use crate::frame::{Frame, PageKey, floor_index};
use crate::query::answer::Answer;
use crate::query::batch;
use crate::query::disc::{lower, upper};
use crate::query::grid::Rect;
use crate::query::simd::greater;
use crate::store::Snapshot;
use crate::store::{Missing, note};
use nalgebra::Vector3;

/// Returns the distance from `shape` to the nearest solid if that is at most `max` (m, >= 0): 0 if the shape touches
/// it, `None` if there is nothing that near. Not loaded if a page that is not in memory could hold something nearer.
///
/// Exact except for rounding errors (2⁻⁴⁸ of the coordinates). A NaN finds nothing. Cost: like
/// [`overlaps`](crate::query::overlaps) of the shape grown by 1.5 pixels or up to four times the distance found, or by
/// `max` if there is nothing within 24 pixels; keep `max` as small as possible.
pub fn clearance<H: Solid>(set: &Snapshot, shape: &H, max: f64) -> Answer<Option<f64>> {
    if max.is_nan() || max < 0.0 {
        return Answer::Known(None);
    }
    match nearest_cell(set, shape.resting(set.frame()), max) {
        Answer::Known(found) => Answer::Known(found.map(|(distance, _)| distance)),
        Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
    }
}

/// Returns the distance to the nearest solid within `max` (m, >= 0), and that solid.
pub(super) fn nearest_cell(set: &Snapshot, rest: Resting, max: f64) -> Answer<Option<(f64, GridCell)>> {
    // Small reaches first, because they find near solids sooner.
    for reach in NEAR.map(|pixels| pixels * set.frame().pixel_m()) {
        if 2.0 * reach > max {
            break;
        }
        match nearest(set, rest, reach) {
            Answer::Known(None) => {}
            Answer::NotLoaded(_) => break,
            found => return found,
        }
    }
    nearest(set, rest, max)
}

/// Reaches tried before `max` (pixels).
const NEAR: [f64; 3] = [1.5, 6.0, 24.0];

/// Like [`nearest_cell`], by one descent.
fn nearest(set: &Snapshot, rest: Resting, max: f64) -> Answer<Option<(f64, GridCell)>> {
    let frame = set.frame();
    let area = around(frame, &rest, max);
    let heights = (area.low, area.high);
    let mut search = Nearest { rest, metres: metres(frame), best: max, heights, found: None, missing: None };
    descend(set, &area, &mut search);
    if search.missing.is_some() && search.found.is_some() {
        search.missing = None;
        descend(set, &area, &mut search);
    }
    Answer::new(search.found.map(|cell| (search.best, cell)), search.missing)
}

/// Runs [`clearance`] for each of `shapes`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `shapes`.
pub fn clearance_batch<H: Solid>(set: &Snapshot, shapes: &[H], max: f64, answers: &mut [Answer<Option<f64>>]) {
    batch::answer_each(set, shapes, answers, |shape| batch::pixel_of(set, shape), |shape| clearance(set, shape, max));
}

/// Returns the shortest push along one axis that moves `shape` out of all solids (m): zero if it is in none, `None` if
/// every axis needs more than `max` (m, >= 0). Among equal pushes, up precedes +x, -x, +y, -y, down.
///
/// Exact: after the push, the shape at most touches a solid, and no shorter push along an axis achieves that. Not
/// loaded if a page that is not in memory could be in the way. Cost: up to 6 × the number of gaps passed × an overlap
/// query.
pub fn depenetrate<H: Solid>(set: &Snapshot, shape: &H, max: f64) -> Answer<Option<Vector3<f64>>> {
    if max.is_nan() || max < 0.0 {
        return Answer::Known(None);
    }
    let frame = set.frame();
    let rest = shape.resting(frame);
    let mut best: Option<Vector3<f64>> = None;
    for (axis, sign) in [(2, 1.0), (0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, -1.0)] {
        let limit = best.map_or(max, |push| push.norm());
        match push(set, rest, axis, sign, limit) {
            Answer::Known(Some(distance)) if best.is_none() || distance < limit => {
                let mut out = Vector3::zeros();
                out[axis] = sign * distance;
                best = Some(out);
                if distance == 0.0 {
                    break;
                }
            }
            Answer::Known(_) => {}
            Answer::NotLoaded(missing) => return Answer::NotLoaded(missing),
        }
    }
    Answer::Known(best)
}

/// Runs [`depenetrate`] for each of `shapes`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `shapes`.
pub fn depenetrate_batch<H: Solid>(
    set: &Snapshot,
    shapes: &[H],
    max: f64,
    answers: &mut [Answer<Option<Vector3<f64>>>],
) {
    batch::answer_each(set, shapes, answers, |shape| batch::pixel_of(set, shape), |shape| depenetrate(set, shape, max));
}

/// Returns metres per grid unit.
fn metres(frame: &Frame) -> [f64; 3] {
    [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()]
}

/// Returns the first and last pixel or quantum within `reach` of a shape along `axis` (grid units).
fn within(rest: &Resting, axis: usize, reach: f64) -> (i64, i64) {
    (floor_index(lower(rest.lo[axis] - reach) - 1.0), floor_index(upper(rest.hi[axis] + reach) + 1.0))
}

/// Returns the area within `reach` of a shape (m).
fn around(frame: &Frame, rest: &Resting, reach: f64) -> SweepArea {
    let unit = metres(frame);
    let [(i0, i1), (j0, j1), (low, high)] = [0, 1, 2].map(|axis| within(rest, axis, reach / unit[axis]));
    SweepArea { rect: Rect { i0, i1, j0, j1 }, low, high, major: 0, backward: [false; 3] }
}

struct Nearest {
    rest: Resting,
    metres: [f64; 3],
    /// Distance of the nearest span found; initially the greatest distance searched (m).
    best: f64,
    /// Heights of spans at most as far as `best`.
    heights: (i64, i64),
    /// The nearest span found.
    found: Option<GridCell>,
    missing: Option<Missing>,
}

impl Nearest {
    /// Returns the distance of the shape to a cell (m).
    fn distance(&self, cell: &GridCell) -> f64 {
        let Resting { lo, hi, form } = self.rest;
        let gap = |a: usize, lo: f64, hi: f64| greater(greater(cell.lo[a] - hi, lo - cell.hi[a]), 0.0) * self.metres[a];
        let middle = |a: usize| {
            let center = (lo[a] + hi[a]) * 0.5;
            gap(a, center, center)
        };
        match form {
            Form::Box => norm([gap(0, lo[0], hi[0]), gap(1, lo[1], hi[1]), gap(2, lo[2], hi[2])]),
            Form::Cylinder { radius } => {
                let across = (norm([middle(0), middle(1), 0.0]) - radius * self.metres[0]).max(0.0);
                norm([across, 0.0, gap(2, lo[2], hi[2])])
            }
            Form::Sphere { radius, .. } => (norm([middle(0), middle(1), middle(2)]) - radius * self.metres[0]).max(0.0),
        }
    }
}

impl Visit for Nearest {
    fn heights(&self) -> (i64, i64) {
        self.heights
    }

    fn enter(&mut self, cell: &GridCell) -> bool {
        let distance = self.distance(cell);
        distance < self.best || self.found.is_none() && distance <= self.best
    }

    fn matter(&mut self, matter: &Matter) {
        let cell = matter.cell();
        if self.enter(&cell) {
            self.best = self.distance(&cell);
            self.heights = within(&self.rest, 2, self.best / self.metres[2]);
            self.found = Some(cell);
        }
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }
}

/// Computes [`clearance`] from the distance of every one of `cells`.
#[cfg(test)]
pub(super) fn nearest_of_all(
    frame: &Frame,
    rest: Resting,
    cells: impl Iterator<Item = GridCell>,
    max: f64,
) -> Option<f64> {
    let heights = (i64::MIN, i64::MAX);
    let search = Nearest { rest, metres: metres(frame), best: max, heights, found: None, missing: None };
    cells.map(|cell| search.distance(&cell)).filter(|&distance| distance <= max).min_by(f64::total_cmp)
}

/// Returns how far a shape must move along `axis` to be out of all solids, by repeatedly leaving all spans that it is
/// in.
fn push(set: &Snapshot, rest: Resting, axis: usize, sign: f64, max: f64) -> Answer<Option<f64>> {
    let unit = metres(set.frame())[axis];
    let mut gone = 0.0;
    loop {
        let mut at = rest;
        at.lo[axis] += sign * gone;
        at.hi[axis] += sign * gone;
        let moving = Moving::new(set.frame(), at, Vector3::zeros());
        let area = moving.area();
        let mut search = WayOut { moving, axis, sign, heights: (area.low, area.high), most: 0.0, missing: None };
        descend(set, &area, &mut search);
        if let Some(missing) = search.missing {
            return Answer::NotLoaded(missing);
        }
        if search.most == 0.0 {
            return Answer::Known(Some(gone * unit));
        }
        // Near the origin of the axis, the rest of the way may be shorter than the spacing of numbers near `gone`.
        gone = (gone + search.most).max(gone.next_up());
        if gone * unit > max || gone == f64::INFINITY {
            return Answer::Known(None);
        }
    }
}

struct WayOut {
    moving: Moving,
    axis: usize,
    sign: f64,
    heights: (i64, i64),
    /// Longest way out of any span found (grid units).
    most: f64,
    missing: Option<Missing>,
}

impl WayOut {
    /// Returns the distance along the axis out of `cell` (grid units).
    fn way(&self, cell: &GridCell) -> f64 {
        let Resting { lo, hi, form } = self.moving.rest;
        let middle = |a: usize| (lo[a] + hi[a]) * 0.5;
        let gap = |a: usize, scale: f64| greater(greater(cell.lo[a] - middle(a), middle(a) - cell.hi[a]), 0.0) * scale;
        let axis = self.axis;
        let chord = |radius: f64, squares: f64| (radius * radius - squares).max(0.0).sqrt();
        let square = |v: f64| v * v;
        let round = |half: f64| (middle(axis) - half, middle(axis) + half);
        let (low, high) = match form {
            Form::Cylinder { radius } if axis < 2 => round(chord(radius, square(gap(1 - axis, 1.0)))),
            Form::Sphere { radius, scale } if axis < 2 => {
                round(chord(radius, square(gap(1 - axis, 1.0)) + square(gap(2, scale))))
            }
            Form::Sphere { radius, scale } => round(chord(radius, square(gap(0, 1.0)) + square(gap(1, 1.0))) / scale),
            _ => (lo[axis], hi[axis]),
        };
        if self.sign > 0.0 { cell.hi[axis] - low } else { high - cell.lo[axis] }
    }
}

impl Visit for WayOut {
    fn heights(&self) -> (i64, i64) {
        self.heights
    }

    fn enter(&mut self, cell: &GridCell) -> bool {
        self.moving.meeting(cell).is_some()
    }

    fn matter(&mut self, matter: &Matter) {
        let cell = matter.cell();
        if self.moving.contact(&cell, 1.0).is_some() {
            self.most = self.most.max(self.way(&cell));
        }
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }
}
