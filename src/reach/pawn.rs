//! A pawn on a grid: its dimensions in pixels and quanta.

use crate::frame::{Frame, PAGE_QUANTA};
use crate::sort::sort_by_key;
use crate::store::Snapshot;
use crate::walk::{Body, FLOOR_NEAR_M, pixels_beside};
use crate::{Error, Parameter, Result};
use std::sync::Arc;

/// Lengths that differ by less count as equal (pixels): rounding errors of `length / pixel`.
const EQUAL: f64 = 1e-6;
/// Greatest extent of a set of pages (tiles, layers), so that pixels and quanta fit in 31 bits.
const MOST_TILES: i64 = 1 << 24;
const MOST_LAYERS: i64 = 1 << 16;
/// Largest footprint (pixels to each side of the middle): the time for a place grows with its area.
const MOST_PIXELS: f64 = 256.0;
/// Farthest that floor is looked for beside the footprint (pixels).
const MOST_AHEAD: i32 = 512;

/// The neighbours of a pixel, in the order of a place's links.
pub(super) const WAYS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

/// Shape and abilities of the pawn that walks; lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pawn {
    /// Shape.
    pub body: Body,
    /// Highest step that it climbs (m, >= 0, less than its height).
    pub climb: f64,
    /// Deepest drop that it steps down (m, >= 0).
    pub max_drop: f64,
    /// Steepest ground that it walks on, as rise over run (> 0): the slope of the plane through the ground within half a
    /// metre to each side. Infinite if only steps and obstacles limit it.
    pub max_grade: f64,
    /// Longest ramp between two landings (m, > 0). A landing is ground that rises by at most 3 % over 1.5 m, and a ramp is
    /// all other ground: no place on it may be farther than half of this length from a landing. Infinite if ramps need no
    /// landings.
    pub max_ramp: f64,
}

impl Pawn {
    /// Returns a pawn that climbs 0.35 m and steps down as far, so that it can return from wherever it gets to.
    pub fn new(body: Body) -> Self {
        Self { body, climb: 0.35, max_drop: 0.35, max_grade: f64::INFINITY, max_ramp: f64::INFINITY }
    }

    fn check(&self) -> Result<()> {
        self.body.check()?;
        if !(0.0..self.body.height()).contains(&self.climb) {
            let reason = format!("{} m is not allowed; expected 0 to less than the pawn's height", self.climb);
            return Err(Error::parameter(Parameter::Pawn("climb height"), reason));
        }
        if !(self.max_drop >= 0.0 && self.max_drop.is_finite()) {
            let reason = format!("{} m is not allowed; expected 0 or more", self.max_drop);
            return Err(Error::parameter(Parameter::Pawn("deepest drop"), reason));
        }
        for (what, most) in [("steepest grade", self.max_grade), ("longest ramp", self.max_ramp)] {
            if most.is_nan() || most <= 0.0 {
                let reason = format!("{most} is not allowed; expected more than 0");
                return Err(Error::parameter(Parameter::Pawn(what), reason));
            }
        }
        Ok(())
    }
}

/// A pawn on the grid of a set of pages. Pixels count from the first tile of the set, heights from its lowest layer.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    pub frame: Frame,
    pub pawn: Pawn,
    /// First tile and lowest layer of the grid, and its number of tiles along x and y: those of the set, and a margin
    /// in which the body may hang over the end of the scan.
    pub origin: [i32; 3],
    pub tiles: [i32; 2],
    /// The footprint as a union of rectangles around the middle pixel: pixels to either side along x and y.
    pub rects: Vec<[i32; 2]>,
    /// Half extent of their union (pixels).
    pub half: [i32; 2],
    /// Greatest [`gap`] to a pixel that can stop the body on a step.
    pub corner: u64,
    /// Pixels outside of the footprint with gaps up to `corner`, nearest first.
    pub around: Arc<[[i16; 2]]>,
    /// Along x and y, true if the body has left the pixels behind it when it meets a step: then it needs headroom above
    /// the step only on the pixels on the step's side.
    pub lets_go: [bool; 2],
    /// Pixels to either side of the middle of the feet in which the feet need support.
    pub foot: i32,
    /// Distance from the footprint within which a floor makes an edge a step (pixels).
    pub ahead: i32,
    /// Height of the body, greatest step up and down, and greatest distance of floor from the feet (quanta).
    pub height: i32,
    pub up: i32,
    pub drop: i32,
    pub near: i32,
}

impl Grid {
    pub fn new(set: &Snapshot, pawn: Pawn) -> Result<Self> {
        pawn.check()?;
        let frame = *set.frame();
        let (min, max) = set.bounds().map_or(([0; 3], [0; 3]), |bounds| (bounds.min, bounds.max));
        let extent = [0, 1, 2].map(|axis| i64::from(max[axis]) - i64::from(min[axis]) + 1);
        for (extent, most) in extent.iter().zip([MOST_TILES, MOST_TILES, MOST_LAYERS]) {
            if *extent > most {
                return Err(Error::limit("extent of the scan in pages (extract a region first)", extent, most));
            }
        }
        let half = pawn.body.half() / frame.pixel_m();
        if half.max() > MOST_PIXELS {
            let reason =
                format!("it is {:.0} pixels wide; at most {:.0} are allowed", 2.0 * half.max(), 2.0 * MOST_PIXELS);
            return Err(Error::parameter(Parameter::Pawn("size"), reason));
        }
        let rects = match pawn.body {
            Body::Box { .. } => vec![[beside(half.x), beside(half.y)]],
            Body::Cylinder { .. } => disc(half.x),
        };
        let lets_go = [lets_go(half.x), lets_go(half.y)];
        let widest = |axis: usize| rects.iter().map(|rect| rect[axis]).max().unwrap_or(0);
        let half = [widest(0), widest(1)];
        // Far below what overflows, far above any building.
        let quanta = |metres: f64| (frame.quanta(metres) + EQUAL).min(f64::from(1 << 29)).floor() as i32;
        // No place lies farther from a span than this, so the result does not depend on where the scan lies in its
        // tiles.
        let margin = half.map(|half| i64::from((half + 64) / 64));
        let first = [0, 1].map(|axis| (i64::from(min[axis]) - margin[axis]).max(i64::from(i32::MIN)));
        let ahead = pixels_beside(frame.pixel_m()).min(MOST_AHEAD);
        // At a corner of the footprint: pixels straight ahead are no farther off.
        let corners = rects.iter().map(|[x, y]| gap([x + 1, *y]).max(gap([*x, y + 1])));
        let corner = corners.max().unwrap_or(0);
        Ok(Self {
            frame,
            pawn,
            corner,
            around: around(&rects, half.map(|half| half + ahead + 1), corner).into(),
            origin: [first[0] as i32, first[1] as i32, min[2]],
            tiles: [0, 1].map(|axis| (i64::from(min[axis]) - first[axis] + extent[axis] + margin[axis]) as i32),
            half,
            lets_go,
            foot: half[0].min(half[1]).min(1),
            ahead,
            rects,
            // Rounded up, so that a body that fits has room for rounding errors.
            height: quanta(pawn.body.height()) + 1,
            // Floors are rounded to quanta, so a step of exactly the climb height may be stored one quantum higher.
            up: quanta(pawn.climb) + 1,
            drop: quanta(pawn.max_drop) + 1,
            near: quanta(FLOOR_NEAR_M).clamp(1, i32::from(i16::MAX)),
        })
    }

    /// Returns the pixel of a place (pixels from the first tile); `None` outside the grid.
    pub fn pixel(&self, x: f64, y: f64) -> Option<[i32; 2]> {
        self.pixel_beside(x, y).filter(|pixel| self.is_inside(*pixel))
    }

    /// Returns the pixel of a place, in the grid or beside it (pixels from the first tile); `None` if it is too far off
    /// to be numbered.
    pub fn pixel_beside(&self, x: f64, y: f64) -> Option<[i32; 2]> {
        let mut pixel = [0; 2];
        for (axis, value) in [x, y].into_iter().enumerate() {
            let at = self.frame.pixel_of(value).saturating_sub(64 * i64::from(self.origin[axis]));
            pixel[axis] = i32::try_from(at).ok().filter(|_| value.is_finite())?;
        }
        Some(pixel)
    }

    /// Iterates over the pixels of the grid that lie within `far` pixels of another one along x and along y, row by row.
    pub fn square(&self, pixel: [i32; 2], far: i32) -> impl Iterator<Item = [i32; 2]> + use<> {
        let [x, y] = [0, 1].map(|axis| {
            let last = 64 * self.tiles[axis] - 1;
            pixel[axis].saturating_sub(far).max(0)..=pixel[axis].saturating_add(far).min(last)
        });
        y.flat_map(move |j| x.clone().map(move |i| [i, j]))
    }

    /// Returns a height in quanta, rounded down.
    pub fn level(&self, z: f64) -> i32 {
        let level = self.frame.quantum_floor(z) - i64::from(self.origin[2]) * PAGE_QUANTA;
        level.clamp(i64::from(i32::MIN / 2), i64::from(i32::MAX / 2)) as i32
    }

    /// Returns the world coordinate of the middle of a pixel along an axis (m).
    pub fn middle(&self, pixel: i32, axis: usize) -> f64 {
        ((64 * i64::from(self.origin[axis]) + i64::from(pixel)) as f64 + 0.5) * self.frame.pixel_m()
    }

    /// Returns the world height of a top (m).
    pub fn z(&self, top: i32) -> f64 {
        self.frame.top_height(i64::from(self.origin[2]) * PAGE_QUANTA + i64::from(top))
    }

    /// Returns whether a body gets straight across a corner to ground that lies higher by `rise` (quanta).
    pub fn is_stride(&self, rise: i32) -> bool {
        (-self.up.min(self.drop)..=self.up).contains(&rise)
    }

    pub fn is_inside(&self, [i, j]: [i32; 2]) -> bool {
        i >= 0 && j >= 0 && i >> 6 < self.tiles[0] && j >> 6 < self.tiles[1]
    }
}

/// Returns the squared distance from the middle of a pixel to the edge of another one `by` pixels away (half pixels,
/// squared).
pub(super) fn gap(by: [i32; 2]) -> u64 {
    let along = |by: i32| (2 * u64::from(by.unsigned_abs())).saturating_sub(1);
    along(by[0]).pow(2) + along(by[1]).pow(2)
}

/// Returns the offsets of the pixels outside of a footprint with gaps of at most `corner`, up to `widest`, nearest
/// first.
fn around(rects: &[[i32; 2]], widest: [i32; 2], corner: u64) -> Vec<[i16; 2]> {
    let beside = |[x, y]: [i32; 2]| !rects.iter().any(|rect| x.abs() <= rect[0] && y.abs() <= rect[1]);
    let mut around: Vec<[i32; 2]> = (-widest[0]..=widest[0])
        .flat_map(|x| (-widest[1]..=widest[1]).map(move |y| [x, y]))
        .filter(|by| gap(*by) <= corner && beside(*by))
        .collect();
    sort_by_key(&mut around, |by| (gap(*by), *by));
    around.into_iter().map(|by| by.map(|by| by as i16)).collect()
}

/// Returns whether a body has left the pixels behind it when its front meets the next pixel.
///
/// From the middle of a pixel it enters `2 · beside + 1` pixels, and its front meets the next one at most half a pixel
/// later. Its length is `2 · half` pixels: if that is at most `2 · beside`, the last pixel lies behind it by then.
fn lets_go(half: f64) -> bool {
    2.0 * half - EQUAL <= f64::from(2 * beside(half))
}

/// Returns the number of pixels to each side of the middle one whose interior an interval of half length `half`
/// (pixels) enters: walkers may touch what is solid.
fn beside(half: f64) -> i32 {
    ((half - 0.5 - EQUAL).ceil() as i32).max(0)
}

/// Returns the pixels whose interior a disc around the middle of a pixel enters.
fn disc(radius: f64) -> Vec<[i32; 2]> {
    let mut rects: Vec<[i32; 2]> = Vec::new();
    for row in 0..=beside(radius) {
        let gap = (f64::from(row) - 0.5).max(0.0);
        let width = beside((radius * radius - gap * gap).max(0.0).sqrt());
        match rects.last_mut() {
            Some(last) if last[0] == width => last[1] = row,
            _ => rects.push([width, row]),
        }
    }
    rects
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn footprints_hold_the_pixels_that_a_shape_enters() {
        assert_eq!(beside(5.0), 5);
        assert_eq!(beside(5.5), 5, "it touches the next pixel");
        assert_eq!(beside(5.51), 6);
        assert_eq!(beside(0.3), 0);
        for radius in [0.2, 0.5, 3.0, 5.0, 12.5] {
            let rects = disc(radius);
            for (dx, dy) in (-20i32..=20).flat_map(|dx| (-20i32..=20).map(move |dy| (dx, dy))) {
                let gap = |d: i32| (f64::from(d.abs()) - 0.5).max(0.0);
                let enters = (dx, dy) == (0, 0) || gap(dx).hypot(gap(dy)) < radius - 1e-5;
                let held = rects.iter().any(|rect| dx.abs() <= rect[0] && dy.abs() <= rect[1]);
                assert_eq!(held, enters, "{radius}: ({dx}, {dy})");
            }
        }
    }

    #[test]
    fn a_body_of_whole_pixels_lets_go_behind_when_it_meets_a_step() {
        assert!(lets_go(5.0) && lets_go(4.8) && !lets_go(5.2) && !lets_go(5.5) && !lets_go(12.5));
    }
}
