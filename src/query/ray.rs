//! Rays: the first matter along a half-line.
//!
//! Cells are stepped through as by Amanatides and Woo (1987), on four levels: regions of 64 × 64 tiles, tiles, blocks,
//! pixels; a cell without matter at the ray's heights is left in one step. Two things differ from the paper. Crossings
//! are computed from the cell's index instead of summed up, so errors do not grow with the number of steps. And cells
//! are grown by a margin, so a ray along an edge or through a corner looks at the cells on both sides.

use super::answer::Answer;
use super::blocks::{local, local_heights, slices_between, slices_of, touches_union};
use super::disc::SLACK;
use super::footprint::{floor_of, layers};
use super::grid::{Heights, Rect, all_within_reach};
use crate::frame::{Frame, PAGE_QUANTA, PageKey, TILE_PIXELS, floor_index};
use crate::slice::{BlockView, Page, Span};
use crate::store::{KeyBounds, PageSet, PageSlot};
use crate::store::{Missing, note};
use crate::text::{number, place};
use crate::{Error, Result};
use nalgebra::{Point3, Vector3};
use std::ops::ControlFlow;

/// Growth of cells relative to the largest coordinate involved. Of the position of a point on the ray, its rounding to
/// the grid, direction and length account for 10 rounding errors, the crossing of an edge for 5.
const MARGIN: f64 = 1.5 * SLACK;

/// A half-line of limited length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    origin: Point3<f64>,
    direction: Vector3<f64>,
    max: f64,
}

impl Ray {
    /// The ray from `origin` (m, within ±10¹⁰⁰) along `direction` (finite, of any length but zero) for `max` metres
    /// [m, >= 0, may be infinite].
    pub fn new(origin: Point3<f64>, direction: Vector3<f64>, max: f64) -> Result<Self> {
        let scale = direction.amax();
        let fits = all_within_reach(&origin.coords) && direction.iter().all(|v| v.is_finite());
        if !fits || scale == 0.0 || max.is_nan() || max < 0.0 {
            let reason = format!(
                "no ray begins at {}, points along {} and is {} m long",
                place(origin.into()),
                place(direction.into()),
                number(max)
            );
            return Err(Error::parameter("ray", reason));
        }
        // Scaled first, so that the square of a tiny or huge length neither vanishes nor overflows.
        Ok(Self { origin, direction: (direction / scale).normalize(), max })
    }

    /// Where the ray begins (m).
    pub fn origin(&self) -> Point3<f64> {
        self.origin
    }

    /// Direction, of length 1.
    pub fn direction(&self) -> Vector3<f64> {
        self.direction
    }

    /// Length (m).
    pub fn max(&self) -> f64 {
        self.max
    }

    /// The point at `distance` from the origin (m).
    pub fn at(&self, distance: f64) -> Point3<f64> {
        self.origin + self.direction * distance
    }
}

/// The first matter along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RayHit {
    /// Distance from the origin (m).
    pub distance: f64,
    /// Outward normal of the face that was hit: ±x or ±y for the side of a pixel, ±z for the top or bottom of a span.
    /// Zero if the ray begins in or on matter: then there is no such face, and the distance is 0.
    pub normal: Vector3<f64>,
    /// The matter is an obstacle.
    pub obstacle: bool,
}

/// The first matter that `ray` meets; `None` if there is none within its length. Not loaded if a page that is not in
/// memory could hold matter before that.
///
/// Matter is as for [all queries](super#what-touching-means); squares are closed and grown by at most 2⁻⁴⁸ of the
/// coordinates, so a ray through an input point always hits; a ray that grazes a face may meet it earlier by as much
/// over the sine of their angle. Where the ray enters a side and a span's end at once, the side's normal is given.
///
/// Cost: a step per tile column on the way, per block in pages with matter at the ray's heights, and per pixel in blocks
/// with matter there; a region of 64 × 64 tiles without pages is one step.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use slicewalk::frame::{Frame, PageKey};
/// use slicewalk::query::{Answer, Ray, cast};
/// use slicewalk::slice::{PageBuilder, Span};
/// use slicewalk::store::Store;
///
/// let frame = Frame::new(0.5, 1.5)?;
/// let mut builder = PageBuilder::default();
/// assert!(builder.set_column(4, 0, &[Span::new(0, 255, true).unwrap()])); // x from 2 to 2.5, z from 0 to 1.5
/// let store = Store::from_pages(frame, [(PageKey { tx: 0, ty: 0, layer: 0 }, builder.build())]);
///
/// let ray = Ray::new(Point3::new(-3.0, 0.25, 1.0), Vector3::new(2.0, 0.0, 0.0), 100.0)?;
/// let Answer::Known(Some(hit)) = cast(&store, &ray) else { panic!("the pillar stands in the way") };
/// assert!((hit.distance - 5.0).abs() < 1e-12);
/// assert_eq!(hit.normal, -Vector3::x());
/// # Ok::<(), slicewalk::Error>(())
/// ```
pub fn cast<S: PageSet>(set: &S, ray: &Ray) -> Answer<Option<RayHit>> {
    search(set, ray, false)
}

/// As [`cast`]; a `thorough` search skips nothing.
#[inline]
fn search<S: PageSet>(set: &S, ray: &Ray, thorough: bool) -> Answer<Option<RayHit>> {
    let Some(bounds) = set.bounds() else { return Answer::Known(None) };
    let line = Line::new(set.frame(), ray);
    let mut search = Search { line, best: None, missing: None, thorough };
    if let Some((t0, t1)) = line.within(&bounds) {
        let region = |axis: usize| (i64::from(bounds.min[axis] >> 6), i64::from(bounds.max[axis] >> 6));
        let tile = |axis: usize| (i64::from(bounds.min[axis]), i64::from(bounds.max[axis]));
        let tiles = Rect { i0: tile(0).0, i1: tile(0).1, j0: tile(1).0, j1: tile(1).1 };
        let regions = Rect { i0: region(0).0, i1: region(0).1, j0: region(1).0, j1: region(1).1 };
        let mut each_region = Each(|rx: i64, ry: i64, t0, t1| {
            search.go_on(t0)?;
            if set.has_region(rx as i32, ry as i32) {
                // An end here is none of the region on the other side of an edge.
                let mut each_tile = Each(|tx: i64, ty: i64, t0, t1| {
                    search.tile(set.column(tx as i32, ty as i32), tx as i32, ty as i32, t0, t1)
                });
                let _ = line.cells(6, tiles.part(rx << 6, ry << 6, 64), t0, t1, &mut each_tile);
            }
            ControlFlow::Continue(())
        });
        let _ = line.cells(6 + 6, regions, t0, t1, &mut each_region);
    }
    let hit = search.best.map(|(distance, normal, obstacle)| RayHit { distance, normal, obstacle });
    Answer::new(hit, search.missing)
}

/// A ray in grid units: pixels, pixels and quanta.
#[derive(Clone, Copy)]
struct Line {
    origin: [f64; 3],
    /// Grid units per metre along the ray.
    speed: [f64; 3],
    /// Axis of x and y along which the ray crosses more pixels.
    major: usize,
    /// Length (m).
    max: f64,
}

impl Line {
    fn new(frame: &Frame, ray: &Ray) -> Self {
        let grid = |v: &[f64]| [frame.pixels(v[0]), frame.pixels(v[1]), frame.quanta(v[2])];
        let (origin, speed) = (grid(ray.origin.coords.as_slice()), grid(ray.direction.as_slice()));
        Self { origin, speed, major: usize::from(speed[1].abs() > speed[0].abs()), max: ray.max }
    }

    /// Position along `axis` at distance `t`, and its margin \[grid units\].
    #[inline]
    fn at(&self, axis: usize, t: f64) -> (f64, f64) {
        let way = t * self.speed[axis];
        (self.origin[axis] + way, self.origin[axis].abs().max(way.abs()) * MARGIN)
    }

    /// The part of `t0..=t1` in which the coordinate along `axis` lies in `low..=high`, grown by the margin; empty if
    /// the first exceeds the second.
    #[inline]
    fn clip(&self, axis: usize, low: f64, high: f64, t0: f64, t1: f64) -> (f64, f64) {
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

    /// The part of `0..=max` inside the bounds of all pages.
    fn within(&self, bounds: &KeyBounds) -> Option<(f64, f64)> {
        let units = [TILE_PIXELS, TILE_PIXELS, PAGE_QUANTA];
        let (t0, t1) = (0..3).fold((0.0, self.max), |(t0, t1), axis| {
            let edge = |index: i64| (index * units[axis]) as f64;
            self.clip(axis, edge(bounds.min[axis].into()), edge(i64::from(bounds.max[axis]) + 1), t0, t1)
        });
        (t0 <= t1).then_some((t0, t1))
    }

    /// Shows `visit` the cells of `1 << shift` pixels in `area` that the ray meets between `t0` and `t1`, in its order,
    /// with the part in which it does, but for those that it skips.
    #[inline]
    fn cells(&self, shift: u32, area: Rect, t0: f64, t1: f64, visit: &mut impl Visit) -> ControlFlow<()> {
        let size = (1u64 << shift) as f64;
        let minor = 1 - self.major;
        let bounds = [(area.i0, area.i1), (area.j0, area.j1)];
        // Cells along `axis` between the positions at `t0` and `t1`: first, last in the ray's order, and the step.
        let run = |axis: usize, t0: f64, t1: f64| {
            let ((p0, e0), (p1, e1)) = (self.at(axis, t0), self.at(axis, t1));
            // Cells are closed: a position on an edge lies in the cell below it, too. No margin says so at 0.
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
            if visit.skips_row(a) {
                continue;
            }
            let (s0, s1) = self.clip(self.major, a as f64 * size, (a + 1) as f64 * size, t0, t1);
            if s0 > s1 || visit.skips_row_between(s0, s1) {
                continue;
            }
            for b in each(run(minor, s0, s1)) {
                let (i, j) = if self.major == 0 { (a, b) } else { (b, a) };
                if visit.skips(i, j) {
                    continue;
                }
                let (u0, u1) = self.clip(minor, b as f64 * size, (b + 1) as f64 * size, s0, s1);
                if u0 <= u1 {
                    visit.cell(i, j, u0, u1)?;
                }
            }
        }
        ControlFlow::Continue(())
    }

    /// Heights that the ray passes between `t0` and `t1`.
    #[inline]
    fn heights(&self, t0: f64, t1: f64) -> Heights {
        let ((a, ea), (b, eb)) = (self.at(2, t0), self.at(2, t1));
        let low = (a - ea).min(b - eb);
        let high = (a + ea).max(b + eb);
        Heights { low: -floor_index(-low), high: floor_index(high) }
    }

    /// Outward normal of the side through which the ray enters pixel (`i`, `j`).
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
}

impl Rect {
    /// The part of a rectangle of cells in the square of `edge` cells that begins at (`i`, `j`).
    fn part(&self, i: i64, j: i64, edge: i64) -> Self {
        let (i1, j1) = (self.i1.min(i + edge - 1), self.j1.min(j + edge - 1));
        Self { i0: self.i0.max(i), i1, j0: self.j0.max(j), j1 }
    }
}

/// All cells of a square of 8 × 8 that begins at (`i`, `j`).
fn square(i: i64, j: i64) -> Rect {
    Rect { i0: i, i1: i + 7, j0: j, j1: j + 7 }
}

/// Row `n` [0..8] of a square of 8 × 8 cells across axis `major`, as a mask of its cells: bit `8·y + x`.
#[inline]
fn row_of(major: usize, n: i64) -> u64 {
    if major == 0 { 0x0101_0101_0101_0101 << (n & 7) } else { 0xFF << (8 * (n & 7)) }
}

/// Who looks at the cells on the way of a ray. Until something is hit, cells without matter may be skipped before it is
/// known where the ray meets them; after that each of them can end the search.
trait Visit {
    /// Whether the cells of row `a`, across the ray's major axis, hold nothing.
    #[inline]
    fn skips_row(&mut self, _a: i64) -> bool {
        false
    }

    /// Whether those of the same row hold nothing at the heights of the ray between `t0` and `t1`.
    #[inline]
    fn skips_row_between(&mut self, _t0: f64, _t1: f64) -> bool {
        false
    }

    /// Whether the cell (`i`, `j`) of that row holds nothing there.
    #[inline]
    fn skips(&self, _i: i64, _j: i64) -> bool {
        false
    }

    /// The cell (`i`, `j`), which the ray meets between `t0` and `t1`.
    fn cell(&mut self, i: i64, j: i64, t0: f64, t1: f64) -> ControlFlow<()>;
}

/// Every cell.
struct Each<F>(F);

impl<F: FnMut(i64, i64, f64, f64) -> ControlFlow<()>> Visit for Each<F> {
    #[inline]
    fn cell(&mut self, i: i64, j: i64, t0: f64, t1: f64) -> ControlFlow<()> {
        self.0(i, j, t0, t1)
    }
}

/// The blocks of a page whose first one is (`i`, `j`) and whose floor lies at `base` (quanta).
struct Blocks<'a> {
    search: &'a mut Search,
    page: &'a Page,
    base: i64,
    i: i64,
    j: i64,
    /// Blocks with matter at the heights of the ray in the page; those of them in the row at hand, at its heights.
    all: u64,
    row: u64,
}

impl Blocks<'_> {
    /// Blocks with matter at the heights of the ray between `t0` and `t1`.
    #[inline]
    fn between(&self, t0: f64, t1: f64) -> u64 {
        let heights = self.search.line.heights(t0, t1);
        // Heights of parts are rounded by themselves, and may lie outside of those of the whole by one.
        let heights = Heights { low: heights.low - 1, high: heights.high + 1 };
        local_heights(heights, self.base).map_or(0, |(low, high)| {
            let (first, last) = slices_of(low, high);
            self.page.blocks_in(first, last)
        })
    }
}

impl Visit for Blocks<'_> {
    #[inline]
    fn skips_row(&mut self, a: i64) -> bool {
        let major = self.search.line.major;
        self.row = self.all & row_of(major, a);
        self.search.may_skip() && self.row == 0
    }

    #[inline]
    fn skips_row_between(&mut self, t0: f64, t1: f64) -> bool {
        if !self.search.may_skip() {
            return false;
        }
        self.row &= self.between(t0, t1);
        self.row == 0
    }

    #[inline]
    fn skips(&self, i: i64, j: i64) -> bool {
        self.search.may_skip() && self.row >> (8 * (j - self.j) + (i - self.i)) & 1 == 0
    }

    #[inline]
    fn cell(&mut self, i: i64, j: i64, t0: f64, t1: f64) -> ControlFlow<()> {
        self.search.go_on(t0)?;
        let block = self.page.block((i - self.i) as u32, (j - self.j) as u32);
        let heights = local_heights(self.search.line.heights(t0, t1), self.base);
        if heights.is_some_and(|(low, high)| touches_union(block, low, high)) {
            self.search.block(block, i * 8, j * 8, self.base, t0, t1);
        }
        ControlFlow::Continue(())
    }
}

/// The pixels of a block whose first one is (`i`, `j`).
struct Pixels<'a> {
    search: &'a mut Search,
    block: BlockView<'a>,
    base: i64,
    i: i64,
    j: i64,
}

impl Visit for Pixels<'_> {
    #[inline]
    fn skips_row(&mut self, a: i64) -> bool {
        self.search.may_skip() && self.block.pixels() & row_of(self.search.line.major, a) == 0
    }

    #[inline]
    fn skips(&self, i: i64, j: i64) -> bool {
        self.search.may_skip() && self.block.pixels() >> (8 * (j - self.j) + (i - self.i)) & 1 == 0
    }

    #[inline]
    fn cell(&mut self, i: i64, j: i64, t0: f64, t1: f64) -> ControlFlow<()> {
        self.search.go_on(t0)?;
        let spans = self.block.column((j - self.j) as u32 * 8 + (i - self.i) as u32);
        if !spans.is_empty() {
            self.search.pixel(spans, i, j, self.base, t0, t1);
        }
        ControlFlow::Continue(())
    }
}

/// The nearest hit so far and the pages that are missing before it.
struct Search {
    line: Line,
    best: Option<(f64, Vector3<f64>, bool)>,
    missing: Option<Missing>,
    /// Looks at every cell: what tests compare with.
    thorough: bool,
}

impl Search {
    /// Whether matter at `t` or behind can still be the first hit. Asked when a cell is entered, not when one is left:
    /// a ray along an edge is in the cells on both sides at once.
    #[inline]
    fn go_on(&self, t: f64) -> ControlFlow<()> {
        match self.best {
            Some((distance, ..)) if distance < t => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    }

    /// Whether cells without matter may be left out: they end nothing as long as nothing is hit.
    #[inline]
    fn may_skip(&self) -> bool {
        self.best.is_none() && !self.thorough
    }

    fn tile<T: PageSlot>(&mut self, slots: &[T], tx: i32, ty: i32, t0: f64, t1: f64) -> ControlFlow<()> {
        self.go_on(t0)?;
        let heights = self.line.heights(t0, t1);
        let mut slots = layers(slots, heights);
        let upward = self.line.speed[2] >= 0.0;
        while let Some(slot) = if upward { slots.next() } else { slots.next_back() } {
            let base = floor_of(slot.layer());
            let (low, high) = (local(heights.low, base), local(heights.high, base));
            if slot.slices() & slices_between(low, high) == 0 {
                continue;
            }
            let (t0, t1) = self.line.clip(2, base as f64, (base + PAGE_QUANTA) as f64, t0, t1);
            if t0 > t1 || self.go_on(t0).is_break() {
                continue;
            }
            match slot.page() {
                Some(page) => self.page(page, tx, ty, base, t0, t1),
                None => note(&mut self.missing, PageKey { tx, ty, layer: slot.layer() }),
            }
        }
        ControlFlow::Continue(())
    }

    fn page(&mut self, page: &Page, tx: i32, ty: i32, base: i64, t0: f64, t1: f64) {
        let line = self.line;
        let (i, j) = (i64::from(tx) * 8, i64::from(ty) * 8);
        let mut blocks = Blocks { search: self, page, base, i, j, all: u64::MAX, row: u64::MAX };
        blocks.all = blocks.between(t0, t1);
        if blocks.all != 0 || blocks.search.thorough {
            let _ = line.cells(3, square(i, j), t0, t1, &mut blocks);
        }
    }

    fn block(&mut self, block: BlockView<'_>, i: i64, j: i64, base: i64, t0: f64, t1: f64) {
        let line = self.line;
        let _ = line.cells(0, square(i, j), t0, t1, &mut Pixels { search: self, block, base, i, j });
    }

    fn pixel(&mut self, spans: &[Span], i: i64, j: i64, base: i64, t0: f64, t1: f64) {
        let line = &self.line;
        let Some((low, high)) = local_heights(line.heights(t0, t1), base) else { return };
        for span in spans.iter().filter(|span| span.meets(low, high)) {
            // From the pixel's sides alone: what `t0` and `t1` owe to the page's floor and end is no face.
            let (t0, t1) = line.clip(0, i as f64, (i + 1) as f64, 0.0, line.max);
            let (t0, t1) = line.clip(1, j as f64, (j + 1) as f64, t0, t1);
            let (entry, margin) = line.at(2, t0);
            let (bottom, top) = ((base + i64::from(span.bottom())) as f64, (base + i64::from(span.top())) as f64);
            let through = |end: f64| ((end - line.origin[2]) / line.speed[2]).clamp(t0, t1.max(t0));
            let (distance, normal) = if entry + margin < bottom {
                (through(bottom), -Vector3::z())
            } else if entry - margin > top {
                (through(top), Vector3::z())
            } else if t0 == 0.0 {
                (0.0, Vector3::zeros())
            } else {
                (t0, line.side(i, j))
            };
            let nearer =
                |best: &(f64, Vector3<f64>, bool)| distance < best.0 || distance == best.0 && span.is_obstacle();
            if self.best.as_ref().is_none_or(nearer) {
                self.best = Some((distance, normal, span.is_obstacle()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slice::PageBuilder;
    use crate::store::Store;

    /// SplitMix64 (Steele, Lea and Flood 2014).
    struct Random(u64);

    impl Random {
        fn below(&mut self, end: u64) -> u64 {
            self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            (z ^ (z >> 31)) % end
        }

        /// From -1 to 1; a third of them multiples of an eighth.
        fn unit(&mut self) -> f64 {
            let steps = if self.below(3) == 0 { 8 } else { 1 << 40 };
            self.below(2 * steps + 1) as f64 / steps as f64 - 1.0
        }
    }

    /// Pages about the origin, sparse or dense, with ends of spans on and next to ends of slices.
    fn store(random: &mut Random) -> Store {
        let dense = [2, 60, 2000][random.below(3) as usize];
        let keys =
            (-2..2).flat_map(|tx| (-2..2).flat_map(move |ty| (-1..1).map(move |layer| PageKey { tx, ty, layer })));
        let pages = keys.map(|key| {
            let mut builder = PageBuilder::default();
            for _ in 0..=random.below(dense) {
                let end = |random: &mut Random| random.below(64) * 255 + [0, 1, 2, 100][random.below(4) as usize];
                let (a, b) = (end(random) as u32, end(random) as u32);
                let (px, py) = (random.below(64) as u32, random.below(64) as u32);
                let bottom = a.min(b).max(a.max(b).saturating_sub(random.below(600) as u32));
                if let Some(span) = Span::new(bottom, a.max(b).min(16320), random.below(2) == 0) {
                    let _ = builder.set_column(px, py, &[span]);
                }
            }
            (key, builder)
        });
        let built = pages.filter(|(_, builder)| !builder.is_empty()).map(|(key, builder)| (key, builder.build()));
        Store::from_pages(Frame::new(0.5, 1.5).unwrap(), built.collect::<Vec<_>>())
    }

    #[test]
    fn what_is_skipped_changes_no_bit_of_an_answer() {
        let mut random = Random(7);
        let (mut hits, mut rays) = (0, 0);
        for _ in 0..60 {
            let store = store(&mut random);
            for _ in 0..2000 {
                let along = [random.unit(), random.unit(), [1.0, 0.1, 0.0][random.below(3) as usize] * random.unit()];
                let from = Point3::new(64.0 * random.unit(), 64.0 * random.unit(), 100.0 * random.unit());
                let max = [20.0, 300.0, f64::INFINITY][random.below(3) as usize];
                let Ok(ray) = Ray::new(from, Vector3::from(along), max) else { continue };
                let bits = |thorough: bool| {
                    let Answer::Known(hit) = search(&store, &ray, thorough) else { panic!("all is in memory") };
                    hit.map(|hit| (hit.distance.to_bits(), hit.normal.map(f64::to_bits), hit.obstacle))
                };
                assert_eq!(bits(false), bits(true), "{ray:?}");
                hits += u32::from(bits(true).is_some());
                rays += 1;
            }
        }
        assert!(hits > rays / 10 && hits < rays / 10 * 9, "{hits} of {rays}");
    }
}
