//! Extent of an archive's solid on the grid, and the check that the bounds in the head fit it (chapter 8, rule T6).

use super::head::Bounds;
use crate::codec::Violation;
use crate::frame::{Frame, MAX_INDEX, PAGE_QUANTA, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::page::PageBounds;
use crate::plan::{Plan, PlanOptions};

/// Edges of a page (pixels, pixels, quanta); bounds may reach this far beyond the solid.
const PAGE: [i64; 3] = [TILE_PIXELS, TILE_PIXELS, PAGE_QUANTA];
/// Grid units of a pixel or slice along each axis.
const UNITS: [i64; 3] = [1, 1, SLICE_QUANTA];

/// Returns the smallest bounds around both.
pub(super) fn joined(a: Option<Bounds>, b: Option<Bounds>) -> Option<Bounds> {
    let (Some((min, max)), Some((other_min, other_max))) = (a, b) else { return a.or(b) };
    let axes = |f: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| f(a[axis], b[axis]));
    Some((axes(f64::min, min, other_min), axes(f64::max, max, other_max)))
}

/// Smallest box around all solid: pixels along x and y, quanta along z, both ends inclusive.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Matter {
    range: Option<([i64; 3], [i64; 3])>,
}

/// Allowed grid positions of the bounds along one axis.
struct Allowed {
    min: (i64, i64),
    max: (i64, i64),
}

impl Matter {
    /// Adds the solid of a page.
    pub fn add(&mut self, key: PageKey, page: &PageBounds) {
        let corner = [i64::from(key.tx), i64::from(key.ty), i64::from(key.layer)];
        let place = |axis: usize, at: u32| corner[axis] * PAGE[axis] + i64::from(at);
        let low = std::array::from_fn(|axis| place(axis, page.min[axis]));
        let high = std::array::from_fn(|axis| place(axis, page.max[axis]));
        let (min, max) = self.range.get_or_insert((low, high));
        for axis in 0..3 {
            min[axis] = min[axis].min(low[axis]);
            max[axis] = max[axis].max(high[axis]);
        }
    }

    /// Returns the bounds of whole pixels and quanta around the solid (m); `None` without solid.
    pub fn bounds(&self, frame: &Frame) -> Option<Bounds> {
        let (min, max) = self.range?;
        let edges = |i: i64, j: i64, height: f64| [frame.edge_of_pixel(i), frame.edge_of_pixel(j), height];
        let min = edges(min[0], min[1], frame.bottom_height(min[2]));
        let max = edges(max[0] + 1, max[1] + 1, frame.top_height(max[2]));
        // Adding zero turns −0, the bottom at quantum 0, into 0.
        Some((min.map(|v| v + 0.0), max))
    }

    /// Checks rule T6 for the `bounds` of an archive of `plan`; `is_part` if it holds one part of a conversion.
    pub fn check(&self, plan: &Plan, is_part: bool, bounds: Option<&Bounds>) -> Result<(), Violation> {
        let Some((min, max)) = bounds else {
            let wrong = |around| Violation::new("T6", format!("bounds around the solid, {around:?}"), "no bounds");
            let around = self.bounds(&plan.frame).filter(|_| !borrows(plan, is_part));
            return around.map_or(Ok(()), |around| Err(wrong(around)));
        };
        let (low, high) = on_grid(&plan.frame, min, max);
        for axis in 0..3 {
            let allowed = self.allowed(plan, is_part, axis);
            let inside = |(least, greatest), at| (least..=greatest).contains(&at);
            if !inside(allowed.min, low[axis]) || !inside(allowed.max, high[axis]) {
                let expected = match self.bounds(&plan.frame) {
                    Some(around) => format!("bounds near the solid, {around:?}"),
                    None => "bounds on the grid".into(),
                };
                return Err(Violation::new("T6", expected, format!("{:?}", (min, max))));
            }
        }
        Ok(())
    }

    /// Moves the faces of `bounds` that break rule T6 to the solid; returns `None` if they break it and there is no
    /// solid.
    pub fn fit(&self, plan: &Plan, is_part: bool, bounds: Option<Bounds>) -> Option<Bounds> {
        if self.check(plan, is_part, bounds.as_ref()).is_ok() {
            return bounds;
        }
        self.moved(plan, bounds, |axis| self.allowed(plan, is_part, axis))
    }

    /// Moves the faces of `bounds` that lie beyond the outermost pixels or quanta of the solid to the solid; returns
    /// `None` without solid.
    pub fn shrink(&self, plan: &Plan, bounds: Option<Bounds>) -> Option<Bounds> {
        self.moved(plan, bounds, |axis| self.near(axis, 0, moved_by(plan, axis)))
    }

    /// Moves the faces of `bounds` that are not `allowed` along an axis to the solid.
    fn moved(&self, plan: &Plan, bounds: Option<Bounds>, allowed: impl Fn(usize) -> Allowed) -> Option<Bounds> {
        let around = self.bounds(&plan.frame)?;
        let Some((mut min, mut max)) = bounds else { return Some(around) };
        let (low, high) = on_grid(&plan.frame, &min, &max);
        for axis in 0..3 {
            let allowed = allowed(axis);
            if !(allowed.min.0..=allowed.min.1).contains(&low[axis]) {
                min[axis] = around.0[axis];
            }
            if !(allowed.max.0..=allowed.max.1).contains(&high[axis]) {
                max[axis] = around.1[axis];
            }
        }
        Some((min, max))
    }

    fn allowed(&self, plan: &Plan, is_part: bool, axis: usize) -> Allowed {
        let end = (MAX_INDEX + 1) * UNITS[axis];
        // Points of dropped voxels count for the bounds, and a part has the bounds of all triangles.
        let PlanOptions { min_points, drop_floaters, remove_moving, .. } = plan.options;
        let close = min_points == 1 && drop_floaters == 0 && !remove_moving && !is_part;
        let margin = if close { PAGE[axis] } else { 2 * end };
        self.near(axis, margin, if borrows(plan, is_part) { 2 * end } else { moved_by(plan, axis) })
    }

    /// Returns the positions at most `margin` outside the solid, or up to `moved` inside.
    fn near(&self, axis: usize, margin: i64, moved: i64) -> Allowed {
        let end = (MAX_INDEX + 1) * UNITS[axis];
        let Some((least, greatest)) = self.range.map(|(min, max)| (min[axis], max[axis])) else {
            return Allowed { min: (-end, end), max: (-end, end) };
        };
        Allowed {
            min: ((least - margin).max(-end), (least + moved).min(end)),
            max: ((greatest - moved).max(-end), (greatest + margin).min(end)),
        }
    }
}

/// Returns how far heights may lie inside the solid that was coarsened (grid units).
fn moved_by(plan: &Plan, axis: usize) -> i64 {
    if axis == 2 { i64::from(plan.tolerance_quanta()) } else { 0 }
}

/// Returns whether solid may lie beyond the bounds: in a part with filled holes, floor may follow from points of other
/// parts.
fn borrows(plan: &Plan, is_part: bool) -> bool {
    is_part && plan.options.fill_holes > 0
}

/// Returns the grid position of bounds: the pixels that hold their ends, the quanta at or below the minimum and at or
/// above the maximum.
fn on_grid(frame: &Frame, min: &[f64; 3], max: &[f64; 3]) -> ([i64; 3], [i64; 3]) {
    let pixels = |of: &[f64; 3]| [frame.pixel_of(of[0]), frame.pixel_of(of[1])];
    let ([x0, y0], [x1, y1]) = (pixels(min), pixels(max));
    ([x0, y0, frame.quantum_floor(min[2])], [x1, y1, frame.quantum_ceil(max[2])])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(tx: i32, ty: i32, layer: i32) -> PageKey {
        PageKey { tx, ty, layer }
    }

    fn matter(least: [u32; 3], greatest: [u32; 3]) -> Matter {
        let mut matter = Matter::default();
        matter.add(key(-2, 0, 1), &PageBounds { min: least, max: least });
        matter.add(key(3, 0, 1), &PageBounds { min: greatest, max: greatest });
        matter
    }

    fn plan() -> Plan {
        Plan::new(Frame::new(0.1, 0.3).unwrap())
    }

    #[test]
    fn each_face_must_lie_near_the_matter() {
        let (matter, plan) = (matter([5, 6, 700], [9, 8, 900]), plan());
        let good = matter.bounds(&plan.frame).unwrap();
        assert_eq!(matter.check(&plan, false, Some(&good)), Ok(()));
        assert_eq!(matter.check(&plan, false, None).unwrap_err().rule, "T6");
        assert_eq!(matter.fit(&plan, false, None), Some(good));
        let broken = |plan: &Plan, is_part, (min, max): Bounds| {
            let broken = matter.check(plan, is_part, Some(&(min, max))).is_err();
            let fitted = matter.fit(plan, is_part, Some((min, max))).unwrap();
            assert_eq!(matter.check(plan, is_part, Some(&fitted)), Ok(()));
            assert_eq!(fitted != (min, max), broken);
            broken
        };
        let with = |options| Plan { options, ..plan.clone() };
        let dropping = [
            with(PlanOptions { min_points: 2, ..PlanOptions::default() }),
            with(PlanOptions { drop_floaters: 1, ..PlanOptions::default() }),
        ];
        for axis in 0..3 {
            let size = if axis == 2 { 0.3 } else { 0.1 };
            let moved = |by: [f64; 2]| {
                let mut bounds = good;
                bounds.0[axis] += by[0] * size;
                bounds.1[axis] += by[1] * size;
                bounds
            };
            for slices in [[1.5, 0.0], [0.0, -2.5], [-65.0, 0.0], [0.0, 66.0], [-1e300, 0.0], [0.0, 1e300]] {
                assert!(broken(&plan, false, moved(slices)), "axis {axis}, moved by {slices:?}");
            }
            assert!(!broken(&plan, false, moved([-63.0, 63.0])));
            for (plan, is_part) in [(&dropping[0], false), (&dropping[1], false), (&plan, true)] {
                assert!(!broken(plan, is_part, moved([-1e6, 1e6])), "axis {axis}");
                assert!(broken(plan, is_part, moved([1.5, 0.0])) && broken(plan, is_part, moved([0.0, 1e300])));
            }
        }
    }

    #[test]
    fn heights_may_be_moved_outwards_by_the_tolerance() {
        let matter = matter([5, 6, 700], [5, 6, 900]);
        let loose = Plan { options: PlanOptions { tolerance_m: 0.05, ..PlanOptions::default() }, ..plan() };
        let (mut min, mut max) = matter.bounds(&loose.frame).unwrap();
        (min[2], max[2]) = (min[2] + 0.0494, max[2] - 0.0494);
        assert_eq!(matter.check(&loose, false, Some(&(min, max))), Ok(()));
        assert!(matter.check(&plan(), false, Some(&(min, max))).is_err());
        max[2] -= 0.0012;
        assert!(matter.check(&loose, false, Some(&(min, max))).is_err());
    }

    #[test]
    fn matter_of_a_part_may_lie_beyond_its_bounds_where_holes_are_closed() {
        let matter = matter([5, 6, 700], [9, 8, 900]);
        let closing = Plan { options: PlanOptions { fill_holes: 3, ..PlanOptions::default() }, ..plan() };
        for axis in 0..3 {
            let (mut min, mut max) = matter.bounds(&closing.frame).unwrap();
            (min[axis], max[axis]) = (min[axis] + 0.5, max[axis] - 0.5);
            let holds = |plan: &Plan, is_part| matter.check(plan, is_part, Some(&(min, max))).is_ok();
            assert!(holds(&closing, true) && !holds(&closing, false) && !holds(&plan(), true), "axis {axis}");
        }
    }

    #[test]
    fn without_matter_bounds_lie_on_the_grid() {
        let (none, plan) = (Matter::default(), plan());
        assert_eq!(none.check(&plan, false, None), Ok(()));
        assert_eq!(none.check(&plan, false, Some(&([-1e9; 3], [1e9; 3]))), Ok(()));
        assert!(none.check(&plan, false, Some(&([-1e300; 3], [1e9; 3]))).is_err());
        assert_eq!(none.fit(&plan, false, Some(([0.0; 3], [1.0; 3]))), Some(([0.0; 3], [1.0; 3])));
        assert_eq!(none.fit(&plan, false, Some(([0.0; 3], [1e300; 3]))), None);
    }

    #[test]
    fn bounds_at_the_origin_have_no_sign() {
        let bounds = |at: i32, place: [u32; 3]| {
            let mut matter = Matter::default();
            matter.add(key(at, at, at), &PageBounds { min: place, max: place });
            let (min, max) = matter.bounds(&plan().frame).unwrap();
            [min.map(f64::to_bits), max.map(f64::to_bits)]
        };
        assert_eq!(bounds(0, [0; 3])[0], [0; 3]);
        assert_eq!(bounds(-1, [63, 63, 16320])[1], [0; 3]);
    }

    #[test]
    fn joined_bounds_are_the_smallest_around_both() {
        let (a, b) = (([0.0, 1.0, 2.0], [3.0, 4.0, 5.0]), ([-1.0, 1.5, 2.0], [2.0, 9.0, 5.0]));
        assert_eq!(joined(Some(a), Some(b)), Some(([-1.0, 1.0, 2.0], [3.0, 9.0, 5.0])));
        assert_eq!((joined(Some(a), None), joined(None, Some(b)), joined(None, None)), (Some(a), Some(b), None));
    }

    #[test]
    fn only_faces_beyond_the_outermost_cells_are_moved_to_the_matter() {
        // Pixels 197 to 201 and 6 to 8, quanta 700 to 900.
        let plan = Plan::new(Frame::new(0.5, 1.0).unwrap());
        let mut matter = Matter::default();
        matter.add(key(3, 0, 0), &PageBounds { min: [5, 6, 700], max: [9, 8, 900] });
        let around = matter.bounds(&plan.frame).unwrap();
        assert_eq!([around.0[0], around.0[1], around.1[0], around.1[1]], [98.5, 3.0, 101.0, 4.5]);
        let inside = ([98.6, 3.1, 700.5 / 255.0], [100.9, 4.4, 899.5 / 255.0]);
        let beyond = ([97.9, 2.9, 2.0], [101.1, 4.6, 4.0]);
        assert_eq!(matter.shrink(&plan, Some(inside)), Some(inside));
        assert_eq!(matter.shrink(&plan, Some(beyond)), Some(around));
        assert_eq!(matter.shrink(&plan, None), Some(around));
        assert_eq!(Matter::default().shrink(&plan, Some(inside)), None);
        for axis in 0..3 {
            let (mut given, mut expected) = (inside, inside);
            (given.0[axis], expected.0[axis]) = (beyond.0[axis], around.0[axis]);
            assert_eq!(matter.shrink(&plan, Some(given)), Some(expected));
            let (mut given, mut expected) = (inside, inside);
            (given.1[axis], expected.1[axis]) = (beyond.1[axis], around.1[axis]);
            assert_eq!(matter.shrink(&plan, Some(given)), Some(expected));
        }
    }

    #[test]
    fn bounds_of_a_part_may_lie_anywhere_on_the_grid() {
        let plan = Plan::new(Frame::new(0.5, 1.0).unwrap());
        let closing = Plan { options: PlanOptions { fill_holes: 3, ..PlanOptions::default() }, ..plan.clone() };
        // Matter on one side of the origin, the end of the grid on the other.
        for (at, side) in [(3, -1.0), (-3, 1.0)] {
            let mut matter = Matter::default();
            matter.add(key(at, at, at), &PageBounds { min: [5, 6, 700], max: [9, 8, 900] });
            let end = [1u64 << 35, 1 << 35, 1 << 36].map(|end| side * end as f64);
            let around = matter.bounds(&plan.frame).unwrap();
            for (axis, place) in end.into_iter().enumerate() {
                let holds = |place: f64| {
                    let mut bounds = around;
                    let face = if side < 0.0 { &mut bounds.0 } else { &mut bounds.1 };
                    face[axis] = place;
                    matter.check(&plan, true, Some(&bounds)).is_ok()
                };
                assert!(holds(place) && !holds(place + side), "axis {axis}, {side}");
            }
            assert_eq!(matter.check(&closing, true, Some(&(end, end))), Ok(()));
            assert!(matter.check(&plan, true, Some(&(end, end))).is_err());
        }
    }

    proptest! {
        #[test]
        fn the_bounds_of_matter_fit_it(
            pixel in 0.003f64..3.0, at in prop::array::uniform3(-(1i32 << 30)..1 << 30), low in 0u32..64, height in 0u32..16320
        ) {
            let plan = Plan::new(Frame::new(pixel, 3.0 * pixel).unwrap());
            let mut matter = Matter::default();
            let page = PageBounds { min: [low, low, height], max: [63, 63, 16320] };
            matter.add(key(at[0], at[1], at[2]), &page);
            let bounds = matter.bounds(&plan.frame).unwrap();
            prop_assert_eq!(matter.check(&plan, false, Some(&bounds)), Ok(()));
            prop_assert_eq!(matter.fit(&plan, false, Some(bounds)), Some(bounds));
        }
    }
}
