//! Moving shapes on the grid: when they meet a box.
//!
//! Units are pixels, pixels and quanta; times are fractions of the motion. A shape meets a box when its interior enters
//! the box's interior; touching is not meeting. Faces count as touching while they overlap by no more than `2·slack`, a
//! margin for rounding errors, so that a shape moved by `fraction · motion` to a contact touches there and can move on.
//! For each axis, the times at which the shape's bounding box enters and leaves a box are monotone functions of the
//! box's faces. So the same function that tests spans prunes blocks and pages, exactly.

use super::descent::{GridCell, SweepArea};
use crate::frame::{Frame, floor_index};
use crate::query::disc::SLACK;
use crate::query::grid::Rect;
use crate::query::simd::{greater, lesser};
use crate::query::{Aabb, Cylinder, Sphere};
use nalgebra::{Point3, Vector3};

/// A shape that can be swept: [`Aabb`], [`Cylinder`], [`Sphere`].
pub trait Solid: crate::query::Shape + sealed::OnSolid {}

impl<T: crate::query::Shape + sealed::OnSolid> Solid for T {}

pub(super) mod sealed {
    use super::Resting;
    use crate::frame::Frame;

    /// A shape with its exact form on a grid.
    pub trait OnSolid: Copy {
        fn resting(&self, frame: &Frame) -> Resting;
    }
}

/// Form of a shape inside its bounding box. Radii in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// The box itself.
    Box,
    /// Round in x and y.
    Cylinder { radius: f64 },
    /// Round in all axes; one quantum is `scale` pixels high.
    Sphere { radius: f64, scale: f64 },
}

/// A shape on the grid: its bounding box and its form.
#[derive(Debug, Clone, Copy)]
pub struct Resting {
    pub lo: [f64; 3],
    pub hi: [f64; 3],
    pub form: Form,
}

fn grid(frame: &Frame, p: Point3<f64>) -> [f64; 3] {
    [frame.pixels(p.x), frame.pixels(p.y), frame.quanta(p.z)]
}

/// Beyond all pixels and quanta of pages; larger coordinates are treated as infinite.
const BEYOND: f64 = (1u64 << 46) as f64;

impl sealed::OnSolid for Aabb {
    #[inline]
    fn resting(&self, frame: &Frame) -> Resting {
        let lo = grid(frame, self.min()).map(|v| if v < -BEYOND { f64::NEG_INFINITY } else { v });
        let hi = grid(frame, self.max()).map(|v| if v > BEYOND { f64::INFINITY } else { v });
        Resting { lo, hi, form: Form::Box }
    }
}

impl sealed::OnSolid for Cylinder {
    #[inline]
    fn resting(&self, frame: &Frame) -> Resting {
        let r = Vector3::new(self.radius(), self.radius(), 0.0);
        let top = self.feet() + Vector3::new(0.0, 0.0, self.height());
        let form = Form::Cylinder { radius: frame.pixels(self.radius()) };
        Resting { lo: grid(frame, self.feet() - r), hi: grid(frame, top + r), form }
    }
}

impl sealed::OnSolid for Sphere {
    #[inline]
    fn resting(&self, frame: &Frame) -> Resting {
        let r = Vector3::repeat(self.radius());
        let form = Form::Sphere { radius: frame.pixels(self.radius()), scale: frame.quantum_m() / frame.pixel_m() };
        Resting { lo: grid(frame, self.center() - r), hi: grid(frame, self.center() + r), form }
    }
}

/// Times between which a shape's interior meets a box's; they meet only if `enter < leave`. `enter` is -∞ if they meet
/// at 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Meeting {
    pub enter: f64,
    pub leave: f64,
}

impl Meeting {
    const ALWAYS: Self = Self { enter: f64::NEG_INFINITY, leave: f64::INFINITY };
    const NEVER: Self = Self { enter: f64::INFINITY, leave: f64::NEG_INFINITY };

    #[inline]
    fn and(self, other: Self) -> Self {
        Self { enter: greater(self.enter, other.enter), leave: lesser(self.leave, other.leave) }
    }

    #[inline]
    pub fn is_some(self) -> bool {
        self.enter < self.leave
    }
}

/// First contact with a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    /// Fraction of the motion, 0..=1; -1 if the shape begins inside.
    pub at: f64,
    /// Outward normal, of length 1; zero if the shape begins inside.
    pub normal: [f64; 3],
}

impl Contact {
    const INSIDE: Self = Self { at: -1.0, normal: [0.0; 3] };
}

/// A shape that moves by `v`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moving {
    pub rest: Resting,
    pub v: [f64; 3],
    inverse: [f64; 3],
    /// Rounding error of a coordinate.
    pub slack: [f64; 3],
    /// Centre, and squared radius, of a disc that holds the footprint of a cylinder during the whole motion; infinite
    /// for other shapes.
    middle: [f64; 2],
    reach: f64,
    /// A box or a cylinder that moves along z alone, or not at all.
    pub is_upright: bool,
}

impl Moving {
    #[inline]
    pub fn new(frame: &Frame, rest: Resting, motion: Vector3<f64>) -> Self {
        let v = [frame.pixels(motion.x), frame.pixels(motion.y), frame.quanta(motion.z)];
        // Infinite sides have no rounding errors, and only the part of a motion before a contact has any.
        let error = |side: f64| if side.is_finite() { side.abs() } else { 0.0 };
        let slack: [f64; 3] =
            std::array::from_fn(|a| (error(rest.lo[a]).max(error(rest.hi[a])) + v[a].abs().min(BEYOND)) * SLACK);
        let (middle, reach) = match rest.form {
            // Larger by far more than rounding errors.
            Form::Cylinder { radius } => (
                [0, 1].map(|a| (rest.lo[a] + rest.hi[a] + v[a]) * 0.5),
                radius + norm([v[0], v[1], 0.0]) * 0.5 + 8.0 * slack[0].max(slack[1]),
            ),
            // A box may be infinite, and then it has no middle.
            Form::Box | Form::Sphere { .. } => ([0.0; 2], f64::INFINITY),
        };
        let is_upright = v[0] == 0.0 && v[1] == 0.0 && !matches!(rest.form, Form::Sphere { .. });
        Self { rest, v, inverse: v.map(|v| 1.0 / v), slack, middle, reach: reach * reach, is_upright }
    }

    /// Returns the area that the bounding box can meet.
    #[inline]
    pub fn area(&self) -> SweepArea {
        let (lo, hi) = (self.rest.lo, self.rest.hi);
        let low = |a: usize| lo[a] + self.v[a].min(0.0);
        let high = |a: usize| hi[a] + self.v[a].max(0.0);
        // Pixels and heights that the box only touches are left out; `axis` rejects them, too.
        let pixels = |a: usize| (floor_index(low(a) + self.slack[a]), -floor_index(self.slack[a] - high(a)) - 1);
        let ((i0, i1), (j0, j1)) = (pixels(0), pixels(1));
        let (bottom, top) = (floor_index(low(2) + self.slack[2]), -floor_index(self.slack[2] - high(2)));
        let (bottom, top) = (bottom.saturating_add(1), top.saturating_sub(1));
        SweepArea {
            // A box of zero width lies in one pixel or on the edge of two; the same holds for zero height.
            rect: Rect { i0: i0.min(i1), i1: i1.max(i0), j0: j0.min(j1), j1: j1.max(j0) },
            low: bottom.min(top),
            high: top.max(bottom),
            major: usize::from(self.v[1].abs() > self.v[0].abs()),
            backward: self.v.map(|v| v < 0.0),
        }
    }

    /// Returns the times at which the bounding box meets `lo..hi` along `axis`.
    #[inline]
    fn axis(&self, axis: usize, lo: f64, hi: f64) -> Meeting {
        let (v, slack) = (self.v[axis], self.slack[axis]);
        // Distances that its faces have to move until they touch the far ones of the other box.
        let (below, above) = (lo - self.rest.hi[axis], hi - self.rest.lo[axis]);
        if v == 0.0 {
            return if below < -2.0 * slack && above > 2.0 * slack { Meeting::ALWAYS } else { Meeting::NEVER };
        }
        let (near, far) = if v > 0.0 { (below, above) } else { (-above, -below) };
        let scale = self.inverse[axis].abs();
        let enter = if near < -2.0 * slack {
            f64::NEG_INFINITY
        } else if near < v.abs() - slack {
            // Not `max`: the reciprocal of a tiny motion is infinite.
            if near > 0.0 { near * scale } else { 0.0 }
        } else {
            f64::INFINITY
        };
        // Later than `enter` even for a shape and a box without thickness.
        let leave = if far > 2.0 * slack { (far + slack) * scale } else { f64::NEG_INFINITY };
        Meeting { enter, leave }
    }

    /// Returns the times at which the bounding box meets `cell`.
    #[inline]
    pub fn meeting(&self, cell: &GridCell) -> Meeting {
        let of = |a: usize| self.axis(a, cell.lo[a], cell.hi[a]);
        of(0).and(of(1)).and(of(2))
    }

    /// Returns the part of `heights` that the bounding box touches up to time `at`.
    #[inline]
    pub fn heights_before(&self, at: f64, (low, high): (i64, i64)) -> (i64, i64) {
        let (way, slack) = (self.v[2] * at, 2.0 * self.slack[2]);
        if self.v[2] < 0.0 {
            (low.max(-floor_index(slack - self.rest.lo[2] - way)), high)
        } else {
            (low, high.min(floor_index(self.rest.hi[2] + way + slack)))
        }
    }

    /// Returns the part of `pixels` that the bounding box touches up to time `at`; all of them for an upright motion.
    #[inline]
    pub fn pixels_before(&self, at: f64, pixels: Rect) -> Rect {
        if self.is_upright {
            return pixels;
        }
        let ends = |a: usize| {
            let (way, slack) = (self.v[a] * at, 2.0 * self.slack[a]);
            let (low, high) = (self.rest.lo[a] + way.min(0.0), self.rest.hi[a] + way.max(0.0));
            // Pixels that begin or end there are touched.
            (-floor_index(slack - low) - 1, floor_index(high + slack))
        };
        let ((i0, i1), (j0, j1)) = (ends(0), ends(1));
        Rect { i0, i1, j0, j1 }
    }

    /// Returns the extent of the bounding box along the other axis while it meets `lo..hi` along `axis`.
    #[inline]
    pub fn across(&self, axis: usize, lo: f64, hi: f64) -> (f64, f64) {
        let other = 1 - axis;
        let Meeting { enter, leave } = self.axis(axis, lo, hi);
        let (t0, t1) = (enter.clamp(0.0, 1.0) * self.v[other], leave.clamp(0.0, 1.0) * self.v[other]);
        // One pixel more to cover rounding.
        (self.rest.lo[other] + t0.min(t1) - 1.0, self.rest.hi[other] + t0.max(t1) + 1.0)
    }

    /// Returns the first contact with `cell`, within the motion and not after `until`.
    #[cfg_attr(not(target_family = "wasm"), inline)]
    pub fn contact(&self, cell: &GridCell, until: f64) -> Option<Contact> {
        let gap = |a: usize| greater(greater(cell.lo[a] - self.middle[a], self.middle[a] - cell.hi[a]), 0.0);
        if gap(0) * gap(0) + gap(1) * gap(1) > self.reach {
            return None;
        }
        if self.is_upright {
            return self.upright_contact(cell, until);
        }
        let meetings: [Meeting; 3] = std::array::from_fn(|a| self.axis(a, cell.lo[a], cell.hi[a]));
        let hull = meetings[0].and(meetings[1]).and(meetings[2]);
        if !hull.is_some() || hull.enter > until {
            return None;
        }
        self.form_contact(cell, &meetings, hull)
    }

    /// Returns the first contact of a box or a cylinder that moves along z alone.
    #[inline]
    fn upright_contact(&self, cell: &GridCell, until: f64) -> Option<Contact> {
        let over = |a: usize| {
            let slack = -2.0 * self.slack[a];
            (cell.lo[a] - self.rest.hi[a] < slack) & (self.rest.lo[a] - cell.hi[a] < slack)
        };
        if !(over(0) & over(1)) {
            return None;
        }
        let meeting = self.axis(2, cell.lo[2], cell.hi[2]);
        if !meeting.is_some() || meeting.enter > until {
            return None;
        }
        if let Form::Cylinder { radius } = self.rest.form {
            let round = Round::new(self, cell, [1.0, 1.0, 0.0], 2);
            let distance = norm(round.away(0.0));
            // A radius below the margin: what the bounding box meets, the centre is in.
            if distance > 0.0 && distance >= radius - 2.0 * round.slack {
                return None;
            }
        }
        let first = Contact { at: meeting.enter, normal: self.face(2) };
        Some(if meeting.enter < 0.0 { Contact::INSIDE } else { first })
    }

    #[inline]
    fn form_contact(&self, cell: &GridCell, meetings: &[Meeting; 3], hull: Meeting) -> Option<Contact> {
        match self.rest.form {
            Form::Box if hull.enter < 0.0 => Some(Contact::INSIDE),
            Form::Box => {
                // On a tie z wins: a box that comes down on an edge lands.
                let axis = [2, 0, 1].into_iter().max_by(|&a, &b| {
                    let by_time = meetings[a].enter.total_cmp(&meetings[b].enter);
                    by_time.then((a != 2).cmp(&(b != 2)).reverse()).then(b.cmp(&a))
                });
                Some(Contact { at: hull.enter, normal: self.face(axis.unwrap_or(2)) })
            }
            Form::Cylinder { radius } => {
                let round = Round::new(self, cell, [1.0, 1.0, 0.0], 2);
                let contact = round.contact(radius, meetings[2], hull.enter < 0.0)?;
                // On a tie z wins, as for a box. Inside, it has entered before all times.
                let lands = meetings[2].enter >= contact.at;
                Some(if lands { Contact { normal: self.face(2), ..contact } } else { contact })
            }
            Form::Sphere { radius, scale } => {
                let round = Round::new(self, cell, [1.0, 1.0, scale], 3);
                round.contact(radius, Meeting::ALWAYS, hull.enter < 0.0)
            }
        }
    }

    /// Returns the normal of the face that is hit along `axis`.
    #[inline]
    fn face(&self, axis: usize) -> [f64; 3] {
        let mut normal = [0.0; 3];
        normal[axis] = -self.v[axis].signum();
        normal
    }
}

/// The centre of a round shape against a box, in units that are equal along all axes.
struct Round {
    /// Centre, motion, box.
    p: [f64; 3],
    v: [f64; 3],
    lo: [f64; 3],
    hi: [f64; 3],
    axes: usize,
    slack: f64,
}

impl Round {
    /// The first `axes` (2 or 3) axes count; the others are scaled by 0.
    fn new(moving: &Moving, cell: &GridCell, scale: [f64; 3], axes: usize) -> Self {
        let rest = &moving.rest;
        // Relative to the box, so that large coordinates lose no digits.
        let p = std::array::from_fn(|a| ((rest.lo[a] - cell.lo[a]) + (rest.hi[a] - cell.lo[a])) * 0.5 * scale[a]);
        let slack = (0..axes).map(|a| moving.slack[a] * scale[a]).fold(0.0, f64::max);
        Self {
            p,
            v: std::array::from_fn(|a| moving.v[a] * scale[a]),
            lo: [0.0; 3],
            hi: std::array::from_fn(|a| (cell.hi[a] - cell.lo[a]) * scale[a]),
            axes,
            slack,
        }
    }

    /// Returns the vector from the nearest point of the box to the centre at time `t`; 0 along axes that do not count.
    fn away(&self, t: f64) -> [f64; 3] {
        std::array::from_fn(|a| {
            let p = self.p[a] + t * self.v[a];
            p - p.clamp(self.lo[a], self.hi[a])
        })
    }

    /// Returns the times at which the centre is nearer than `radius` to the box. They form an interval, because a box
    /// with rounded edges is convex: it is the union of boxes grown by the radius along one axis, and of the
    /// surroundings of edges and corners.
    fn within(&self, radius: f64) -> Meeting {
        // Times between the faces along an axis, grown by `by`.
        let between = |a: usize, by: f64| {
            let (lo, hi, v) = (self.lo[a] - by - self.p[a], self.hi[a] + by - self.p[a], self.v[a]);
            if v == 0.0 {
                return if lo < 0.0 && 0.0 < hi { Meeting::ALWAYS } else { Meeting::NEVER };
            }
            let (s, t) = (lo / v, hi / v);
            Meeting { enter: lesser(s, t), leave: greater(s, t) }
        };
        // Times near an edge or a corner, on these sides along some axes.
        let near = |along: &[usize], sides: usize| {
            let distance = |sum: [f64; 3], (n, &a): (usize, &usize)| {
                let (v, from) = (self.v[a], self.p[a] - if sides >> n & 1 == 0 { self.lo[a] } else { self.hi[a] });
                [sum[0] + v * v, sum[1] + v * from, sum[2] + from * from]
            };
            below_zero(along.iter().enumerate().fold([0.0, 0.0, -radius * radius], distance))
        };
        let mut all = Meeting::NEVER;
        let mut join = |meeting: Meeting| {
            if meeting.is_some() {
                all = Meeting { enter: lesser(all.enter, meeting.enter), leave: greater(all.leave, meeting.leave) };
            }
        };
        if self.axes == 2 {
            join(between(0, radius).and(between(1, 0.0)));
            join(between(0, 0.0).and(between(1, radius)));
            (0..4).for_each(|sides| join(near(&[0, 1], sides)));
        } else {
            for (a, b, c) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
                join(between(a, radius).and(between(b, 0.0)).and(between(c, 0.0)));
                let along = between(a, 0.0);
                (0..4).for_each(|sides| join(near(&[b, c], sides).and(along)));
            }
            (0..8).for_each(|sides| join(near(&[0, 1, 2], sides)));
        }
        all
    }

    /// Returns the first contact while `also` holds; the bounding box `begins_inside` or not.
    fn contact(&self, radius: f64, also: Meeting, begins_inside: bool) -> Option<Contact> {
        let begin = self.away(0.0);
        let distance = norm(begin);
        // A shape without extent is never nearer than its radius.
        let is_inside = distance < radius - 2.0 * self.slack && also.enter < 0.0;
        if is_inside || distance == 0.0 && begins_inside {
            return Some(Contact::INSIDE);
        }
        if distance < radius - self.slack {
            // In contact, within rounding errors: only an approach counts.
            let nearer = (0..3).map(|a| begin[a] * self.v[a]).sum::<f64>() < 0.0;
            if also.enter < 0.0 && !nearer {
                return None;
            }
        }
        let reached = self.within((radius - self.slack).max(0.0)).and(also);
        if !(reached.is_some() && reached.enter <= 1.0 && reached.leave > 0.0) {
            return None;
        }
        let at = self.within(radius).enter.max(also.enter).clamp(0.0, 1.0);
        let normal = self.away(at);
        let length = norm(normal);
        // The centre is inside the box, which only a shape without extent can reach before a contact.
        let normal = if length > 0.0 { normal.map(|v| v / length) } else { unit_against(self.v) };
        Some(Contact { at, normal })
    }
}

/// Returns the times at which `a·t² + 2·b·t + c < 0`.
#[cfg_attr(target_family = "wasm", inline(never))]
fn below_zero([a, b, c]: [f64; 3]) -> Meeting {
    if a == 0.0 {
        return if c < 0.0 { Meeting::ALWAYS } else { Meeting::NEVER };
    }
    let root = b * b - a * c;
    if root <= 0.0 {
        return Meeting::NEVER;
    }
    // Compute the root without cancellation first. The sum is not 0: its terms have the same sign.
    let q = -(b + root.sqrt().copysign(b));
    let (s, t) = (q / a, c / q);
    Meeting { enter: lesser(s, t), leave: greater(s, t) }
}

pub(super) fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

fn unit_against(v: [f64; 3]) -> [f64; 3] {
    let length = norm(v);
    v.map(|v| if length > 0.0 { -v / length } else { 0.0 })
}

#[cfg(test)]
mod tests;
