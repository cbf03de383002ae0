//! The nearest place of the surface of solid space, from outside and from inside.

use super::clearance::nearest_cell;
use super::solid::sealed::OnSolid;
use crate::frame::{Frame, PageKey, TILE_PIXELS, floor_index};
use crate::query::Aabb;
use crate::query::answer::Answer;
use crate::query::batch;
use crate::query::blocks::{local, slices_between};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::Heights;
use crate::store::{Missing, Snapshot, note};
use nalgebra::{Point3, Vector3};

/// Where the surface of solid space is nearest, as planners need it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SurfacePoint {
    /// Signed distance to the surface (m): above 0 in free space, below 0 inside solid.
    pub distance: f64,
    /// The nearest place on the surface (m).
    pub point: Point3<f64>,
    /// Direction in which the distance grows by its own length, of length 1; zero on the surface itself.
    pub gradient: Vector3<f64>,
}

/// Returns the place on the surface of solid space nearest to `place` if it is at most `max` away (m, >= 0), from
/// outside or from inside; `None` if there is nothing that near, or if a coordinate is not finite.
///
/// Exact for the spans, except for rounding errors (2⁻⁴⁸ of the coordinates): solid space is the union of all spans,
/// each a closed box over its pixel. Which of several equally near places is returned may depend on the pages in memory.
/// Not loaded if a page that is not in memory could hold something nearer. Cost: like [`clearance`](super::clearance) of a point; inside
/// solid, a few nanoseconds for each pixel within the distance found. Keep `max` small.
pub fn nearest_surface(set: &Snapshot, place: Point3<f64>, max: f64) -> Answer<Option<SurfacePoint>> {
    if max.is_nan() || max < 0.0 || !place.iter().all(|v| v.is_finite()) {
        return Answer::Known(None);
    }
    let frame = set.frame();
    let at = [frame.pixels(place.x), frame.pixels(place.y), frame.quanta(place.z)];
    let rest = Aabb::between(place, place).resting(frame);
    let cell = match nearest_cell(set, rest, max) {
        Answer::Known(None) => return Answer::Known(None),
        Answer::Known(Some((distance, cell))) if distance > 0.0 => cell,
        Answer::Known(Some(_)) => return suggestion(set, place, at, max),
        Answer::NotLoaded(missing) => return Answer::NotLoaded(missing),
    };
    let point = [0, 1, 2].map(|axis| at[axis].max(cell.lo[axis]).min(cell.hi[axis]));
    let apart = offset(frame, point, at);
    let distance = apart.norm();
    Answer::Known(Some(SurfacePoint { distance, point: world(frame, place, at, point), gradient: apart / distance }))
}

/// Runs [`nearest_surface`] for each of `places`, in order, into `answers`.
///
/// # Panics
/// If `answers` is shorter than `places`.
pub fn nearest_surface_batch(
    set: &Snapshot,
    places: &[Point3<f64>],
    max: f64,
    answers: &mut [Answer<Option<SurfacePoint>>],
) {
    let pixel = |place: &Point3<f64>| [set.frame().pixel_of(place.x), set.frame().pixel_of(place.y)];
    batch::answer_each(set, places, answers, pixel, |place| nearest_surface(set, *place, max));
}

/// Returns the vector between two places on the grid (m).
fn offset(frame: &Frame, from: [f64; 3], to: [f64; 3]) -> Vector3<f64> {
    let unit = [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()];
    Vector3::from([0, 1, 2].map(|axis| (to[axis] - from[axis]) * unit[axis]))
}

/// Converts `point` on the grid to the world; where it shares a coordinate with `at`, it has that of `place`.
fn world(frame: &Frame, place: Point3<f64>, at: [f64; 3], point: [f64; 3]) -> Point3<f64> {
    let unit = [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()];
    Point3::from([0, 1, 2].map(|axis| if point[axis] == at[axis] { place[axis] } else { point[axis] * unit[axis] }))
}

/// Finds the nearest free place from `at` (grid units), which is inside solid: ring by ring, for each pixel the ends of
/// the run of spans at this height, if there is one.
fn suggestion(set: &Snapshot, place: Point3<f64>, at: [f64; 3], max: f64) -> Answer<Option<SurfacePoint>> {
    let mut search = WayOut { frame: *set.frame(), at, best: max, found: None, missing: None };
    search.run(set);
    if search.missing.is_some() && search.found.is_some() {
        // Pages beyond the place found are irrelevant.
        search.missing = None;
        search.run(set);
    }
    let WayOut { frame, found, missing, .. } = search;
    let point = found.map(|point| {
        let apart = offset(&frame, at, point);
        let distance = apart.norm();
        let gradient = if distance > 0.0 { apart / distance } else { Vector3::zeros() };
        SurfacePoint { distance: -distance, point: world(&frame, place, at, point), gradient }
    });
    missing.map_or(Answer::Known(point), Answer::NotLoaded)
}

struct WayOut {
    frame: Frame,
    at: [f64; 3],
    /// Distance of the nearest free place found; initially the greatest distance searched (m).
    best: f64,
    found: Option<[f64; 3]>,
    missing: Option<Missing>,
}

impl WayOut {
    fn run(&mut self, set: &Snapshot) {
        let [i, j] = [self.at[0], self.at[1]].map(floor_index);
        let pixel = self.frame.pixel_m();
        // The pixels of a ring are at least its number less one pixel away.
        for ring in 0.. {
            if (ring - 1).max(0) as f64 * pixel > self.best {
                return;
            }
            for side in -ring..=ring {
                self.pixel(set, i + side, j - ring);
                if ring > 0 {
                    self.pixel(set, i + side, j + ring);
                }
                if side.abs() < ring {
                    self.pixel(set, i - ring, j + side);
                    self.pixel(set, i + ring, j + side);
                }
            }
        }
    }

    /// Considers the free space over and under the run of spans in pixel (`i`, `j`), or all of it if there is none.
    fn pixel(&mut self, set: &Snapshot, i: i64, j: i64) {
        let [x, y, z] = self.at;
        let [near_x, near_y] = [(x, i), (y, j)].map(|(at, first)| at.max(first as f64).min((first + 1) as f64));
        let flat = offset(&self.frame, self.at, [near_x, near_y, z]).norm();
        if flat > self.best || flat == self.best && self.found.is_some() {
            return;
        }
        match self.run_at(set, i, j) {
            Run::Unknown => {}
            Run::None => self.consider(flat, [near_x, near_y, z]),
            Run::Between(bottom, top) => {
                for end in [top, bottom] {
                    let point = [near_x, near_y, end];
                    self.consider(offset(&self.frame, self.at, point).norm(), point);
                }
            }
        }
    }

    fn consider(&mut self, distance: f64, point: [f64; 3]) {
        if distance < self.best || self.found.is_none() && distance <= self.best {
            (self.best, self.found) = (distance, Some(point));
        }
    }

    /// Returns the spans of a pixel that join at the height of the place, as far as they lie within the best distance.
    /// Notes pages that are not in memory.
    fn run_at(&mut self, set: &Snapshot, i: i64, j: i64) -> Run {
        let z = self.at[2];
        let reach = self.best / self.frame.quantum_m();
        let heights = Heights { low: floor_index(z - reach) - 1, high: floor_index(z + reach) + 1 };
        let [tx, ty] = [i, j].map(|first| i32::try_from(first.div_euclid(TILE_PIXELS)));
        // No page lies beyond.
        let (Ok(tx), Ok(ty)) = (tx, ty) else { return Run::None };
        let [px, py] = [i, j].map(|first| first.rem_euclid(TILE_PIXELS) as u32);
        let (mut run, mut is_known): (Option<(i64, i64)>, _) = (None, true);
        for slot in layers(set.column(tx, ty), heights) {
            let base = floor_of(slot.layer());
            let Some(page) = slot.page() else {
                let (low, high) = (local(heights.low, base), local(heights.high, base));
                if slot.slices() & slices_between(low, high) != 0 {
                    note(&mut self.missing, PageKey { tx, ty, layer: slot.layer() });
                    is_known = false;
                }
                continue;
            };
            for span in page.column(px, py) {
                let (bottom, top) = (base + i64::from(span.bottom()), base + i64::from(span.top()));
                run = match run {
                    Some((first, last)) if bottom <= last => Some((first, last.max(top))),
                    // This run holds the place, or lies over it.
                    Some((_, last)) if last as f64 >= z => break,
                    _ => Some((bottom, top)),
                };
            }
        }
        match run.map(|(bottom, top)| (bottom as f64, top as f64)) {
            _ if !is_known => Run::Unknown,
            Some((bottom, top)) if bottom <= z && z <= top => Run::Between(bottom, top),
            _ => Run::None,
        }
    }
}

/// Spans of a pixel at a height (quanta).
enum Run {
    None,
    Between(f64, f64),
    Unknown,
}
