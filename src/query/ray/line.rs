//! A ray on the grid, and the cells that it meets.

use super::{Ray, RayHit};
use crate::frame::{Frame, PAGE_QUANTA, TILE_PIXELS, floor_index};
use crate::page::Span;
use crate::query::disc::SLACK;
use crate::query::grid::{Heights, Rect};
use crate::store::KeyBounds;
use nalgebra::Vector3;
use std::ops::ControlFlow;

/// Growth of cells relative to the largest coordinate involved. It covers 10 rounding errors of the position of a point
/// on the ray (its rounding to the grid, direction and length), and 5 of the crossing of an edge.
const MARGIN: f64 = 1.5 * SLACK;

/// A ray in grid units: pixels, pixels and quanta.
#[derive(Clone, Copy)]
pub(super) struct Line {
    pub origin: [f64; 3],
    /// Grid units per metre along the ray.
    pub speed: [f64; 3],
    /// Axis of x and y along which the ray crosses more pixels.
    pub major: usize,
    /// Length (m).
    pub max: f64,
}

impl Line {
    #[inline]
    pub fn new(frame: &Frame, ray: &Ray) -> Self {
        let grid = |v: &Vector3<f64>| [frame.pixels(v.x), frame.pixels(v.y), frame.quanta(v.z)];
        let (origin, speed) = (grid(&ray.origin.coords), grid(&ray.direction));
        Self { origin, speed, major: usize::from(speed[1].abs() > speed[0].abs()), max: ray.max }
    }

    /// Returns the position along `axis` at distance `t`, and its margin (grid units).
    #[inline]
    fn at(&self, axis: usize, t: f64) -> (f64, f64) {
        let way = t * self.speed[axis];
        (self.origin[axis] + way, self.origin[axis].abs().max(way.abs()) * MARGIN)
    }

    /// Returns the part of `t0..=t1` in which the coordinate along `axis` lies in `low..=high`, grown by the margin.
    /// The part is empty if its first number exceeds the second.
    #[inline]
    pub fn clip(&self, axis: usize, low: f64, high: f64, t0: f64, t1: f64) -> (f64, f64) {
        let origin = self.origin[axis];
        let margin = low.abs().max(high.abs()).max(origin.abs()) * MARGIN;
        let (low, high) = (low - margin - origin, high + margin - origin);
        let speed = self.speed[axis];
        if speed == 0.0 {
            return if low <= 0.0 && 0.0 <= high { (t0, t1) } else { (f64::INFINITY, f64::NEG_INFINITY) };
        }
        let (a, b) = (low / speed, high / speed);
        (t0.max(a.min(b)), t1.min(a.max(b)))
    }

    /// Returns the part of `0..=max` inside the bounds of all pages.
    pub fn within(&self, bounds: &KeyBounds) -> Option<(f64, f64)> {
        let units = [TILE_PIXELS, TILE_PIXELS, PAGE_QUANTA];
        let (t0, t1) = (0..3).fold((0.0, self.max), |(t0, t1), axis| {
            let edge = |index: i64| (index * units[axis]) as f64;
            self.clip(axis, edge(bounds.min[axis].into()), edge(i64::from(bounds.max[axis]) + 1), t0, t1)
        });
        (t0 <= t1).then_some((t0, t1))
    }

    /// Calls `f` for the cells of `1 << shift` pixels in `area` that the ray meets between `t0` and `t1`, in order
    /// along the ray, with the part of the ray in each cell.
    #[inline]
    pub fn cells(
        &self,
        shift: u32,
        area: Rect,
        t0: f64,
        t1: f64,
        mut f: impl FnMut(i64, i64, f64, f64) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let size = (1u64 << shift) as f64;
        let minor = 1 - self.major;
        let bounds = [(area.i0, area.i1), (area.j0, area.j1)];
        // Cells along `axis` between the positions at `t0` and `t1`: first, last, and whether the ray visits them
        // backward.
        let run = |axis: usize, t0: f64, t1: f64| {
            let ((p0, e0), (p1, e1)) = (self.at(axis, t0), self.at(axis, t1));
            // Cells are closed, so the cell below an edge counts, too. At 0 the relative margin does not include it.
            let first = (-floor_index(-(p0 - e0).min(p1 - e1)) - 1) >> shift;
            let last = floor_index((p0 + e0).max(p1 + e1)) >> shift;
            let (first, last) = (first.max(bounds[axis].0), last.min(bounds[axis].1));
            let backward = self.speed[axis] < 0.0;
            (first, last, backward)
        };
        let each = |(first, last, backward): (i64, i64, bool)| {
            (first..=last).map(move |n| if backward { first + last - n } else { n })
        };
        for a in each(run(self.major, t0, t1)) {
            let (s0, s1) = self.clip(self.major, a as f64 * size, (a + 1) as f64 * size, t0, t1);
            if s0 > s1 {
                continue;
            }
            for b in each(run(minor, s0, s1)) {
                let (u0, u1) = self.clip(minor, b as f64 * size, (b + 1) as f64 * size, s0, s1);
                if u0 <= u1 {
                    let (i, j) = if self.major == 0 { (a, b) } else { (b, a) };
                    f(i, j, u0, u1)?;
                }
            }
        }
        ControlFlow::Continue(())
    }

    /// Returns the heights that the ray passes between `t0` and `t1`.
    #[inline]
    pub fn heights(&self, t0: f64, t1: f64) -> Heights {
        let ((a, ea), (b, eb)) = (self.at(2, t0), self.at(2, t1));
        let low = (a - ea).min(b - eb);
        let high = (a + ea).max(b + eb);
        Heights { low: -floor_index(-low), high: floor_index(high) }
    }

    /// Returns the outward normal of the side through which the ray enters pixel (`i`, `j`).
    fn side(&self, i: i64, j: i64) -> Vector3<f64> {
        let entry = |axis: usize, cell: i64| {
            let near = if self.speed[axis] > 0.0 { cell } else { cell + 1 };
            if self.speed[axis] == 0.0 {
                f64::NEG_INFINITY
            } else {
                (near as f64 - self.origin[axis]) / self.speed[axis]
            }
        };
        let axis = usize::from(entry(1, j) > entry(0, i));
        let mut normal = Vector3::zeros();
        normal[axis] = -self.speed[axis].signum();
        normal
    }

    /// Returns the hit of a span that the ray meets, in pixel (`i`, `j`) of a page with its floor at `base` (quanta).
    pub fn meet(&self, (i, j): (i64, i64), base: i64, span: Span) -> RayHit {
        // From the pixel's sides alone: where a page's floor or end clips the ray there is no face.
        let (t0, t1) = self.clip(0, i as f64, (i + 1) as f64, 0.0, self.max);
        let (t0, t1) = self.clip(1, j as f64, (j + 1) as f64, t0, t1);
        let (entry, margin) = self.at(2, t0);
        let (bottom, top) = ((base + i64::from(span.bottom())) as f64, (base + i64::from(span.top())) as f64);
        let through = |end: f64| ((end - self.origin[2]) / self.speed[2]).clamp(t0, t1.max(t0));
        let (distance, normal) = if entry + margin < bottom {
            (through(bottom), -Vector3::z())
        } else if entry - margin > top {
            (through(top), Vector3::z())
        } else if t0 == 0.0 {
            (0.0, Vector3::zeros())
        } else {
            (t0, self.side(i, j))
        };
        RayHit { distance, normal, obstacle: span.is_obstacle() }
    }
}
