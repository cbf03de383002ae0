//! The quick search of a ray, which passes over what holds no matter and leaves what is not certain to the exact one.

use super::RayHit;
use super::line::Line;
use crate::frame::{PAGE_QUANTA, TILE_PIXELS, floor_small};
use crate::query::blocks::{local, slices_between, slices_of, union_heights};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::Heights;
use crate::slice::{BlockView, Page, Span};
use crate::store::{KeyBounds, PageSet, PageSlot};

/// Growth of cells across (pixels) and along z (quanta): many times the margins of the exact search and the rounding errors
/// of this one, as long as all coordinates are [`FARTHEST`] at most.
const SLACK: f64 = 1.0 / (1 << 16) as f64;
const SLACK_Z: f64 = 1.0 / (1 << 12) as f64;
/// Greatest coordinates (pixels, pixels, quanta).
const FARTHEST: [f64; 3] = [(1u64 << 30) as f64, (1u64 << 30) as f64, (1u64 << 32) as f64];

/// Tiles along the edge of a region.
const REGION: i64 = 64;

/// The answer depends on rounding, or on pages that are not in memory.
pub(super) struct Unsure;

type Certain<T = ()> = Result<T, Unsure>;

/// The first matter on `line` in a set of pages with these `bounds`.
pub(super) fn first_hit<S: PageSet>(set: &S, line: &Line, bounds: &KeyBounds) -> Certain<Option<RayHit>> {
    let mut walk = Walk::new(set, line);
    let (mut t0, mut t1) = (0.0, line.max);
    let units = [TILE_PIXELS, TILE_PIXELS, PAGE_QUANTA];
    for axis in 0..3 {
        let edge = |index: i64| (index * units[axis]) as f64;
        let (low, high) = (edge(bounds.min[axis].into()), edge(i64::from(bounds.max[axis]) + 1));
        let origin = line.origin[axis];
        if !(origin.abs() <= FARTHEST[axis] && -low <= FARTHEST[axis] && high <= FARTHEST[axis]) {
            return Err(Unsure);
        }
        let inverse = inverse(line.speed[axis]);
        let slack = if axis == 2 { SLACK_Z } else { SLACK };
        let (a, b) = ((low - slack - origin) * inverse, (high + slack - origin) * inverse);
        (t0, t1) = (greater(t0, lesser(a, b)), lesser(t1, greater(a, b)));
    }
    if t0 <= t1 {
        walk.scene(bounds, t0, t1)?;
    }
    Ok(walk.hit)
}

/// `1 / speed`, and instead of infinity a number that leads far beyond every way, and times 0 is 0.
#[inline]
fn inverse(speed: f64) -> f64 {
    if speed.abs() < 1e-30 { 1e30 } else { 1.0 / speed }
}

/// `v` on an axis that is mirrored if the ray descends along it.
#[inline]
fn mirrored(v: f64, speed: f64) -> f64 {
    if speed < 0.0 { -v } else { v }
}

/// The lesser of two numbers that are no NaN: one instruction, unlike `f64::min`.
#[inline]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The greater of two numbers that are no NaN.
#[inline]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The integer nearest to `v`, of magnitude below 2³¹.
#[inline]
fn nearest(v: f64) -> i32 {
    (v + (3u64 << 51) as f64).to_bits() as i32
}

/// A ray on its way, in coordinates that are mirrored so that it ascends in x and y: pixel `n` of a mirrored axis is
/// pixel `-1 - n` of the grid, which is `!n`.
struct Walk<'a, S> {
    set: &'a S,
    line: &'a Line,
    /// Along the major and the minor axis: origin (pixels), pixels per metre, metres per pixel.
    origin: [f64; 2],
    speed: [f64; 2],
    inverse: [f64; 2],
    /// All bits for a mirrored axis, else none.
    mirror: [i64; 2],
    inverse_z: f64,
    /// In a square of 8 × 8 cells, numbered `8·y + x`: how far apart rows and cells across are (as shifts), those of a
    /// row that begins with 0, and what turns a mirrored number back.
    shifts: [u32; 2],
    row: u64,
    turn: [i32; 2],
    /// The page at hand: height of its floor (quanta), and that of the ray's origin above it.
    base: i64,
    height: f64,
    /// Distance of the hit; before that, the ray's length (m).
    end: f64,
    hit: Option<RayHit>,
}

impl<'a, S: PageSet> Walk<'a, S> {
    #[inline]
    fn new(set: &'a S, line: &'a Line) -> Self {
        let axes = [line.major, 1 - line.major];
        let speed = [line.speed[axes[0]], line.speed[axes[1]]];
        let mirror = [-i64::from(speed[0] < 0.0), -i64::from(speed[1] < 0.0)];
        Self {
            set,
            line,
            origin: [mirrored(line.origin[axes[0]], speed[0]), mirrored(line.origin[axes[1]], speed[1])],
            speed: [speed[0].abs(), speed[1].abs()],
            inverse: [inverse(speed[0].abs()), inverse(speed[1].abs())],
            mirror,
            inverse_z: inverse(line.speed[2]),
            shifts: if line.major == 0 { [0, 3] } else { [3, 0] },
            row: if line.major == 0 { 0x0101_0101_0101_0101 } else { 0xFF },
            turn: [mirror[0] as i32 & 7, mirror[1] as i32 & 7],
            base: 0,
            height: line.origin[2],
            end: line.max,
            hit: None,
        }
    }

    /// Cell `row`, `cell` across it, in x and y and not mirrored.
    #[inline]
    fn on_grid(&self, row: i64, cell: i64) -> [i64; 2] {
        let (row, cell) = (row ^ self.mirror[0], cell ^ self.mirror[1]);
        if self.line.major == 0 { [row, cell] } else { [cell, row] }
    }

    /// Cells in `row` of a square of 8 × 8, as a mask.
    #[inline]
    fn row_of_square(&self, row: i32) -> u64 {
        self.row << ((row ^ self.turn[0]) << self.shifts[0])
    }

    /// The bit of a cell in such a mask.
    #[inline]
    fn bit_in_square(&self, row: i32, cell: i32) -> u32 {
        ((row ^ self.turn[0]) << self.shifts[0] | (cell ^ self.turn[1]) << self.shifts[1]) as u32
    }

    /// Shows `visit` the cells of `1 << SHIFT` pixels that the ray meets between `t0` and `t1`, in a rectangle of `count`
    /// rows and cells across that begins at cell `first`: row, cell across, and the part in which it does. Cells are grown
    /// by [`SLACK`]. Rows that `skips` says nothing is in are left out, and so is what lies behind a hit.
    #[inline]
    fn cells<const SHIFT: u32>(
        &mut self,
        first: [i64; 2],
        count: [i32; 2],
        (t0, t1): (f64, f64),
        skips: impl Fn(&Self, i32) -> bool,
        mut visit: impl FnMut(&mut Self, i32, i32, f64, f64) -> Certain,
    ) -> Certain {
        let size = (1u64 << SHIFT) as f64;
        let slack = SLACK / size;
        let origin = [0, 1].map(|n| (self.origin[n] - (first[n] << SHIFT) as f64) / size);
        let speed = self.speed.map(|speed| speed / size);
        // Where a cell is entered and left: those of cell 0, and for each further one.
        let each = self.inverse.map(|inverse| inverse * size);
        let enter = [0, 1].map(|n| (-slack - origin[n]) * each[n]);
        let leave = [0, 1].map(|n| (1.0 + slack - origin[n]) * each[n]);
        // Half a cell less: nearest is floor.
        let (low, high) = (origin.map(|o| o - slack - 0.5), origin.map(|o| o + slack - 0.5));
        let from = |axis: usize, t: f64| nearest(low[axis] + speed[axis] * t).max(0);
        let upto = |axis: usize, t: f64| nearest(high[axis] + speed[axis] * t).min(count[axis] - 1);
        for row in from(0, t0)..=upto(0, t1) {
            if skips(self, row) {
                continue;
            }
            let s0 = greater(t0, enter[0] + f64::from(row) * each[0]);
            let s1 = lesser(t1, leave[0] + f64::from(row) * each[0]);
            if s0 > self.end {
                break;
            }
            let (one, last) = (from(1, s0), upto(1, s1));
            if one == last {
                visit(self, row, one, s0, s1)?;
                continue;
            }
            for cell in one..=last {
                let u0 = greater(s0, enter[1] + f64::from(cell) * each[1]);
                let u1 = lesser(s1, leave[1] + f64::from(cell) * each[1]);
                if u0 <= u1 && u0 <= self.end {
                    visit(self, row, cell, u0, u1)?;
                }
            }
        }
        Ok(())
    }

    /// Heights of the ray between `t0` and `t1` above the page's floor, lower first (quanta).
    #[inline]
    fn heights(&self, t0: f64, t1: f64) -> (f64, f64) {
        let speed = self.line.speed[2];
        let (a, b) = (self.height + speed * t0, self.height + speed * t1);
        (lesser(a, b), greater(a, b))
    }

    /// Heights in the page that matter meets if the ray may between `t0` and `t1`.
    #[inline]
    fn heights_in_page(&self, t0: f64, t1: f64) -> (u32, u32) {
        let (low, high) = self.heights(t0, t1);
        let low = nearest(low - SLACK_Z + 0.5).max(0);
        // Below the page's floor nothing is met.
        let high = nearest(high + SLACK_Z - 0.5);
        if high < 0 { (i32::MAX as u32, 0) } else { (low as u32, high as u32) }
    }

    /// The part between `t0` and `t1` in which the ray may lie between heights `bottom` and `top` of the page.
    #[inline]
    fn between(&self, bottom: u32, top: u32, t0: f64, t1: f64) -> (f64, f64) {
        let a = (f64::from(bottom) - SLACK_Z - self.height) * self.inverse_z;
        let b = (f64::from(top) + SLACK_Z - self.height) * self.inverse_z;
        (greater(t0, lesser(a, b)), lesser(t1, greater(a, b)))
    }

    /// All tiles within `bounds`, in regions where they are many.
    fn scene(&mut self, bounds: &KeyBounds, t0: f64, t1: f64) -> Certain {
        let end = |n: usize, axis: usize| {
            let (a, b) = (i64::from(bounds.min[axis]) ^ self.mirror[n], i64::from(bounds.max[axis]) ^ self.mirror[n]);
            (a.min(b), a.max(b))
        };
        let ends = [end(0, self.line.major), end(1, 1 - self.line.major)];
        let first = [ends[0].0, ends[1].0];
        let count = [ends[0].1 - first[0] + 1, ends[1].1 - first[1] + 1];
        if count[0].max(count[1]) <= REGION {
            return self.tiles(first, [count[0] as i32, count[1] as i32], t0, t1);
        }
        let first = [first[0] >> 6, first[1] >> 6];
        let count = [((ends[0].1 >> 6) - first[0] + 1) as i32, ((ends[1].1 >> 6) - first[1] + 1) as i32];
        self.cells::<12>(
            first,
            count,
            (t0, t1),
            |_, _| false,
            |walk, row, cell, t0, t1| {
                let region = [first[0] + i64::from(row), first[1] + i64::from(cell)];
                let [rx, ry] = walk.on_grid(region[0], region[1]);
                if walk.set.has_region(rx as i32, ry as i32) {
                    walk.tiles([region[0] << 6, region[1] << 6], [REGION as i32; 2], t0, t1)?;
                }
                Ok(())
            },
        )
    }

    #[inline(never)]
    fn tiles(&mut self, first: [i64; 2], count: [i32; 2], t0: f64, t1: f64) -> Certain {
        self.cells::<6>(
            first,
            count,
            (t0, t1),
            |_, _| false,
            |walk, row, cell, t0, t1| walk.tile([first[0] + i64::from(row), first[1] + i64::from(cell)], t0, t1),
        )
    }

    #[inline]
    fn tile(&mut self, tile: [i64; 2], t0: f64, t1: f64) -> Certain {
        let [tx, ty] = self.on_grid(tile[0], tile[1]);
        let slots = self.set.column(tx as i32, ty as i32);
        if slots.is_empty() {
            return Ok(());
        }
        (self.base, self.height) = (0, self.line.origin[2]);
        let (low, high) = self.heights(t0, t1);
        let heights = Heights { low: floor_small(low - SLACK_Z), high: floor_small(high + SLACK_Z) };
        let mut slots = layers(slots, heights);
        let upward = self.line.speed[2] >= 0.0;
        while let Some(slot) = if upward { slots.next() } else { slots.next_back() } {
            self.base = floor_of(slot.layer());
            self.height = self.line.origin[2] - self.base as f64;
            let (t0, t1) = self.between(0, PAGE_QUANTA as u32, t0, t1);
            if t0 > t1 || t0 > self.end {
                continue;
            }
            let (low, high) = self.heights_in_page(t0, t1);
            let (bottom, top) = slices_of(low, high);
            if let Some(page) = slot.page() {
                self.page(page, page.blocks_in(bottom, top), [tile[0] << 3, tile[1] << 3], t0, t1)?;
            } else if slot.slices() & slices_between(local(heights.low, self.base), local(heights.high, self.base)) != 0
            {
                return Err(Unsure);
            }
        }
        Ok(())
    }

    /// Those `blocks` of a page that hold matter at the ray's heights; the first block of the page is `first`.
    #[inline]
    fn page(&mut self, page: &Page, blocks: u64, first: [i64; 2], t0: f64, t1: f64) -> Certain {
        if blocks == 0 {
            return Ok(());
        }
        let skips = |walk: &Self, row| blocks & walk.row_of_square(row) == 0;
        self.cells::<3>(first, [8; 2], (t0, t1), skips, |walk, row, cell, t0, t1| {
            let number = walk.bit_in_square(row, cell);
            if blocks >> number & 1 == 0 {
                return Ok(());
            }
            let (low, high) = walk.heights_in_page(t0, t1);
            let block = page.block_at(number);
            let Some((bottom, top)) = union_heights(block, low, high) else { return Ok(()) };
            let (t0, t1) = walk.between(bottom, top, t0, t1);
            if t0 <= t1 && t0 <= walk.end {
                let first = [(first[0] + i64::from(row)) << 3, (first[1] + i64::from(cell)) << 3];
                walk.block(block, first, t0, t1)?;
            }
            Ok(())
        })
    }

    /// A block whose first pixel is `first`.
    #[inline(never)]
    fn block(&mut self, block: BlockView<'_>, first: [i64; 2], t0: f64, t1: f64) -> Certain {
        let pixels = block.pixels();
        let skips = |walk: &Self, row| pixels & walk.row_of_square(row) == 0;
        self.cells::<0>(first, [8; 2], (t0, t1), skips, |walk, row, cell, t0, t1| {
            let bit = walk.bit_in_square(row, cell);
            if pixels >> bit & 1 == 0 {
                return Ok(());
            }
            let (low, high) = walk.heights_in_page(t0, t1);
            let spans = block.column(bit);
            if !spans.iter().any(|span| span.meets(low, high)) {
                return Ok(());
            }
            walk.pixel(spans, [first[0] + i64::from(row), first[1] + i64::from(cell)], t0, t1)
        })
    }

    /// A pixel with `spans`, some of which the ray meets between `t0` and `t1`, or may.
    #[inline(never)]
    fn pixel(&mut self, spans: &[Span], pixel: [i64; 2], t0: f64, t1: f64) -> Certain {
        // Something else was hit, and not before this is entered.
        if self.hit.is_some() {
            return Err(Unsure);
        }
        // From here to there the ray is in the pixel beyond doubt.
        let (mut here, mut there) = (t0, t1);
        for (n, &cell) in pixel.iter().enumerate() {
            let origin = cell as f64 - self.origin[n];
            here = greater(here, (origin + SLACK) * self.inverse[n]);
            there = lesser(there, (origin + 1.0 - SLACK) * self.inverse[n]);
        }
        let (least, most) = self.heights(here, there);
        let (least, most) = (least + SLACK_Z, most - SLACK_Z);
        let (low, high) = self.heights_in_page(t0, t1);
        let [i, j] = self.on_grid(pixel[0], pixel[1]);
        for &span in spans.iter().filter(|span| span.meets(low, high)) {
            if !(here <= there && f64::from(span.bottom()) <= most && f64::from(span.top()) >= least) {
                return Err(Unsure);
            }
            let hit = self.line.meet((i, j), self.base, span);
            if self.hit.is_none_or(|best| hit.is_before(&best)) {
                self.hit = Some(hit);
                self.end = hit.distance;
            }
        }
        Ok(())
    }
}
