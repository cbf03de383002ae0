//! Tops under a footprint: the height of a step, and the mean floor of the thesis.

use super::descent::{GridCell, Matter, SweepArea, Visit, descend};
use super::solid::{Form, Moving, Solid};
use crate::frame::PageKey;
use crate::query::answer::Answer;
use crate::store::Snapshot;
use crate::store::{Missing, note};
use nalgebra::Vector3;

/// Returns the world height (m) of the highest top of a span of either class under `shape`, from height `from` (m) down
/// to `from - depth` (m, >= 0, finite); `None` if no span has one there. A span that continues above `from` has no top
/// there.
///
/// As in [`sweep`](crate::query::sweep()), a pixel counts if the shape's footprint meets its interior; the shape's own
/// heights do not count. A span cut by a page boundary counts as if it ended there. Cost: like
/// [`floor_under`](crate::query::floor_under). A NaN finds nothing.
pub fn top_under<H: Solid>(set: &Snapshot, shape: &H, from: f64, depth: f64) -> Answer<Option<f64>> {
    let Some((area, moving)) = window(set, shape, from, depth) else { return Answer::Known(None) };
    let mut search = Highest { moving, limit: area.high, best: area.low - 1, found: false, missing: None };
    descend(set, &area, &mut search);
    if search.missing.is_some() && search.found {
        search.missing = None;
        descend(set, &area, &mut search);
    }
    Answer::new(search.found.then(|| set.frame().top_height(search.best)), search.missing)
}

/// Returns the mean world height (m) of the tops of floor under `shape`, from height `from` (m) down to `from - depth`
/// (m, >= 0, finite); `None` if no floor is there. This is the average over "the points on the base of the bounding
/// box" of the thesis, section 3.2.2.
///
/// Pixels and cost are those of [`top_under`].
pub fn mean_floor_under<H: Solid>(set: &Snapshot, shape: &H, from: f64, depth: f64) -> Answer<Option<f64>> {
    let Some((area, moving)) = window(set, shape, from, depth) else { return Answer::Known(None) };
    let mut search = Mean { moving, low: area.low, high: area.high, sum: 0.0, count: 0, missing: None };
    descend(set, &area, &mut search);
    let mean = (search.count > 0).then(|| search.sum / f64::from(search.count) * set.frame().quantum_m());
    Answer::new(mean, search.missing)
}

/// Returns the area in which tops count, and the footprint at any height.
fn window<H: Solid>(set: &Snapshot, shape: &H, from: f64, depth: f64) -> Option<(SweepArea, Moving)> {
    if !from.is_finite() || !depth.is_finite() || depth < 0.0 {
        return None;
    }
    let frame = set.frame();
    // The footprint, at any height.
    let mut rest = shape.resting(frame);
    (rest.lo[2], rest.hi[2]) = (f64::NEG_INFINITY, f64::INFINITY);
    if let Form::Sphere { radius, .. } = rest.form {
        rest.form = Form::Cylinder { radius };
    }
    let moving = Moving::new(frame, rest, Vector3::zeros());
    let area = SweepArea { low: frame.quantum_ceil(from - depth), high: frame.quantum_floor(from), ..moving.area() };
    (area.low <= area.high).then_some((area, moving))
}

/// Returns whether the footprint meets a cell.
fn over(moving: &Moving, cell: &GridCell) -> bool {
    moving.contact(cell, f64::INFINITY).is_some()
}

struct Highest {
    moving: Moving,
    limit: i64,
    best: i64,
    found: bool,
    missing: Option<Missing>,
}

impl Visit for Highest {
    fn heights(&self) -> (i64, i64) {
        (self.best + 1, self.limit)
    }

    fn takes_all(&self) -> bool {
        true
    }

    fn enter(&mut self, cell: &GridCell) -> bool {
        cell.hi[2] > self.best as f64 && over(&self.moving, cell)
    }

    fn matter(&mut self, matter: &Matter) {
        if matter.top <= self.limit && self.enter(&matter.cell()) {
            self.best = matter.top;
            self.found = true;
        }
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }
}

struct Mean {
    moving: Moving,
    low: i64,
    high: i64,
    sum: f64,
    count: u32,
    missing: Option<Missing>,
}

impl Visit for Mean {
    fn heights(&self) -> (i64, i64) {
        (self.low, self.high)
    }

    fn enter(&mut self, cell: &GridCell) -> bool {
        over(&self.moving, cell)
    }

    fn matter(&mut self, matter: &Matter) {
        let inside = (self.low..=self.high).contains(&matter.top);
        if !matter.obstacle && inside && self.enter(&matter.cell()) {
            self.sum += matter.top as f64;
            self.count += 1;
        }
    }

    fn missing(&mut self, key: PageKey) {
        note(&mut self.missing, key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::page::{PageBuilder, Span};
    use crate::query::Aabb;
    use nalgebra::Point3;

    /// Pages of layer 0, full of one span each; pixels of 2⁻⁴ m and quanta of 2⁻¹⁰ m.
    fn store(tiles: &[i32], [bottom, top]: [u32; 2], obstacle: bool) -> Snapshot {
        let mut builder = PageBuilder::default();
        for n in 0..64 * 64 {
            assert!(builder.set_column(n % 64, n / 64, &[Span::new(bottom, top, obstacle).unwrap()]));
        }
        let page = builder.build();
        let key = |&tx| PageKey { tx, ty: 0, layer: 0 };
        Snapshot::from_pages(
            Frame::new(0.0625, 255.0 / 1024.0).unwrap(),
            tiles.iter().map(|tx| (key(tx), page.clone())),
        )
    }

    fn metres(quanta: u32) -> f64 {
        f64::from(quanta) / 1024.0
    }

    /// Over the last pixels of tile column (0, 0) and the first ones of (1, 0).
    fn shape() -> Aabb {
        Aabb::new(Point3::new(3.9, 1.0, 0.0), Point3::new(4.1, 1.2, 0.0)).unwrap()
    }

    #[test]
    fn tops_at_either_end_of_the_heights_count() {
        for obstacle in [false, true] {
            let store = store(&[0, 1], [100, 140], obstacle);
            for (from, depth, found) in
                [(140, 0, true), (140, 20, true), (240, 100, true), (240, 99, false), (139, 100, false)]
            {
                let top = top_under(&store, &shape(), metres(from), metres(depth));
                assert_eq!(top, Answer::Known(found.then(|| metres(140))), "top from {from} by {depth}");
                let mean = mean_floor_under(&store, &shape(), metres(from), metres(depth)).known().unwrap();
                assert_eq!(mean.is_some(), found && !obstacle, "mean from {from} by {depth}");
                assert!(mean.is_none_or(|mean| (mean - metres(140)).abs() < 1e-12), "{mean:?}");
            }
        }
    }

    #[test]
    fn a_missing_page_that_ends_at_the_highest_top_is_no_hindrance() {
        let scene = store(&[0, 1], [16000, 16320], false);
        for missing in [0, 1] {
            let part = scene.keep_loaded(|key| key.tx != missing);
            let top = top_under(&part, &shape(), metres(17000), metres(5000));
            assert_eq!(top, Answer::Known(Some(metres(16320))), "tile {missing} is missing");
            let mean = mean_floor_under(&part, &shape(), metres(17000), metres(5000));
            assert!(matches!(mean, Answer::NotLoaded(_)), "tile {missing} is missing: {mean:?}");
        }
        assert!(matches!(
            top_under(&scene.keep_loaded(|_| false), &shape(), metres(17000), metres(5000)),
            Answer::NotLoaded(_)
        ));
    }
}
