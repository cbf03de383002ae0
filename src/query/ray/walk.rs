//! The quick search of a ray: skips empty cells, and leaves uncertain cases to the exact search.

use super::RayHit;
use super::line::Line;
use crate::frame::{PAGE_QUANTA, TILE_PIXELS, floor_small};
use crate::page::{BlockView, Page, Span};
use crate::query::blocks::{slices_of, union_heights};
use crate::query::footprint::{floor_of, layers};
use crate::query::grid::{Heights, row_bits};
use crate::query::simd::{Floats, Pair, greater, lesser};
use crate::store::{KeyBounds, Snapshot};

/// Growth of cells across (pixels) and along z (quanta): many times the margins of the exact search and the rounding
/// errors of this one, provided that no coordinate exceeds [`FARTHEST`].
pub(super) const SLACK: f64 = 1.0 / (1 << 16) as f64;
pub(super) const SLACK_Z: f64 = 1.0 / (1 << 12) as f64;
/// Greatest coordinates (pixels, pixels, quanta).
const FARTHEST: [f64; 3] = [(1u64 << 30) as f64, (1u64 << 30) as f64, (1u64 << 32) as f64];

/// Growth of cells where single precision decides which of 8 × 8 cells a ray meets (cells): far above [`SLACK`] and the
/// rounding errors of numbers below 8, even multiplied by the slope.
const NEAR: f64 = 1.0 / (1 << 12) as f64;

/// Tiles along the edge of a region.
const REGION: i64 = 64;

/// The answer depends on rounding, or on pages that are not in memory.
pub(super) struct Unsure;

type Certain<T = ()> = Result<T, Unsure>;

/// Returns the first solid on `line` in a set of pages with these `bounds`.
pub(super) fn first_hit(set: &Snapshot, line: &Line, bounds: &KeyBounds) -> Certain<Option<RayHit>> {
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
        let inverse = walk.inverses[axis];
        let slack = if axis == 2 { SLACK_Z } else { SLACK };
        let (a, b) = ((low - slack - origin) * inverse, (high + slack - origin) * inverse);
        (t0, t1) = (greater(t0, lesser(a, b)), lesser(t1, greater(a, b)));
    }
    if t0 <= t1 {
        walk.scene(bounds, t0, t1)?;
    }
    Ok(walk.hit)
}

/// Returns `1 / speed`. Instead of infinity it returns a number that leads far beyond any ray, and that times 0 is 0.
#[inline]
fn inverse(speed: f64) -> f64 {
    if speed.abs() < 1e-30 { 1e30 } else { 1.0 / speed }
}

/// Returns `v` on an axis that is mirrored if the ray descends along it.
#[inline]
fn mirrored(v: f64, speed: f64) -> f64 {
    if speed < 0.0 { -v } else { v }
}

/// Returns the integer nearest to `v`, which must be of magnitude below 2³¹.
#[inline]
fn nearest(v: f64) -> i32 {
    (v + (3u64 << 51) as f64).to_bits() as i32
}

/// State of the search, in coordinates that are mirrored so that the ray ascends in x and y: pixel `n` of a mirrored
/// axis is pixel `-1 - n` of the grid, which is `!n`.
struct Walk<'a> {
    set: &'a Snapshot,
    line: &'a Line,
    /// Along the major and the minor axis: origin (pixels), pixels per metre, metres per pixel.
    origin: [f64; 2],
    speed: [f64; 2],
    inverse: [f64; 2],
    /// All bits for a mirrored axis, else 0.
    mirror: [i64; 2],
    /// Along x, y and z, not mirrored: metres per pixel and quantum.
    inverses: [f64; 3],
    /// Along x and y, not mirrored: origin (pixels), pixels per metre, metres per pixel.
    start: Pair,
    way: Pair,
    each: Pair,
    /// Pixels along x per pixel along y; and the least and greatest x of the ray in a row, relative to its x where the
    /// row begins.
    slope: f32,
    wider: [f32; 2],
    /// XORed with the number `8·y + x` of a cell in a mirrored square of 8 × 8, gives its number on the grid.
    turn: u32,
    /// Current page: height of its floor (quanta), and of the ray's origin above that floor.
    base: i64,
    height: f64,
    /// Distance of the hit; before there is one, the ray's length (m).
    end: f64,
    hit: Option<RayHit>,
    /// Cells of one mask are visited in the order in which the ray enters them, except for differences below this (m).
    /// A later cell is entered earlier only if it lies in the next row and before this one, which the mask then holds
    /// only for its margin.
    overlap: f64,
}

impl<'a> Walk<'a> {
    #[inline]
    fn new(set: &'a Snapshot, line: &'a Line) -> Self {
        let axes = [line.major, 1 - line.major];
        let speed = [line.speed[axes[0]], line.speed[axes[1]]];
        let mirror = [-i64::from(speed[0] < 0.0), -i64::from(speed[1] < 0.0)];
        let inverses = [inverse(line.speed[0]), inverse(line.speed[1]), inverse(line.speed[2])];
        let slope = lesser(greater(line.speed[0] * inverses[1], -1e30), 1e30);
        let (before, behind) = (slope * -NEAR, slope * (1.0 + NEAR));
        Self {
            set,
            line,
            origin: [mirrored(line.origin[axes[0]], speed[0]), mirrored(line.origin[axes[1]], speed[1])],
            speed: [speed[0].abs(), speed[1].abs()],
            inverse: axes.map(|axis| inverses[axis].abs()),
            mirror,
            inverses,
            start: Pair::new([line.origin[0], line.origin[1]]),
            way: Pair::new([line.speed[0], line.speed[1]]),
            each: Pair::new([inverses[0], inverses[1]]),
            slope: slope as f32,
            // Minus half a cell, because `nearest` is used as floor.
            wider: [lesser(before, behind) - NEAR - 0.5, greater(before, behind) + NEAR - 0.5].map(|v| v as f32),
            turn: if line.speed[0] < 0.0 { 7 } else { 0 } | if line.speed[1] < 0.0 { 56 } else { 0 },
            base: 0,
            height: line.origin[2],
            end: line.max,
            hit: None,
            // Four times the growth of the largest cells.
            overlap: 32.0 * NEAR * (inverses[0].abs() + inverses[1].abs()),
        }
    }

    /// Returns x and y, not mirrored, of the cell at position `cell` in row `row`.
    #[inline]
    fn on_grid(&self, row: i64, cell: i64) -> [i64; 2] {
        let (row, cell) = (row ^ self.mirror[0], cell ^ self.mirror[1]);
        if self.line.major == 0 { [row, cell] } else { [cell, row] }
    }

    /// Mirrors the mask of a square of 8 × 8 cells as the ray needs it, or back.
    #[inline]
    fn mirrored_square(&self, mask: u64) -> u64 {
        let rows = if self.turn & 56 == 0 { mask } else { mask.swap_bytes() };
        let columns = rows.reverse_bits().swap_bytes();
        if self.turn & 7 == 0 { rows } else { columns }
    }

    /// Returns the mask of the cells of `SIZE` pixels, in the square of 8 × 8 that begins at pixel `corner`, that the
    /// ray may meet between `t0` and `t1`. Tests all rows at once: for a ray that meets few cells, mispredicted
    /// branches would cost more than these instructions.
    #[inline]
    fn met<const SIZE: u32>(&self, corner: [f64; 2], t0: f64, t1: f64) -> u64 {
        let origin = self.start.minus(Pair::new(corner));
        let at = |t: f64| origin.plus(self.way.times(Pair::new([t; 2]))).times(Pair::new([1.0 / f64::from(SIZE); 2]));
        let (here, there) = (at(t0), at(t1));
        let ([x0, y0], ([_, low], [_, high])) = (here.both(), (here.lesser(there).both(), here.greater(there).both()));
        // Minus half a cell, because `nearest` is used as floor.
        let south = nearest(low - NEAR - 0.5).clamp(0, 7) as u32;
        let north = nearest(high + NEAR - 0.5).clamp(0, 7) as u32;
        let all = |v: f64| Floats::new([v as f32; 4]);
        let (x0, x1) = (all(x0), all(there.both()[0]));
        let inside = |v: Floats| v.greater(all(-0.5)).lesser(all(7.25));
        let (west, east) = (inside(x0.lesser(x1).minus(all(NEAR + 0.5))), inside(x0.greater(x1).plus(all(NEAR - 0.5))));
        let slope = Floats::new([self.slope; 4]);
        let begin = x0.minus(slope.times(all(y0)));
        let (first, last) = (begin.plus(Floats::new([self.wider[0]; 4])), begin.plus(Floats::new([self.wider[1]; 4])));
        let half = |rows: [f32; 4]| {
            let way = slope.times(Floats::new(rows));
            let bit = |x: Floats| x.plus(way).greater(west).lesser(east).power_of_nearest();
            let (from, upto) = (bit(first), bit(last));
            upto.plus(upto).minus(from)
        };
        half([0.0, 1.0, 2.0, 3.0]).bytes(half([4.0, 5.0, 6.0, 7.0])) & row_bits(south, north)
    }

    /// Returns the part between `t0` and `t1` in which the ray is in the cell of `size` pixels that begins at pixel
    /// `first`, grown by `slack` pixels.
    #[inline]
    fn within(&self, first: [f64; 2], size: f64, slack: f64, t0: f64, t1: f64) -> (f64, f64) {
        let origin = Pair::new(first).minus(self.start);
        let a = origin.minus(Pair::new([slack; 2])).times(self.each);
        let b = origin.plus(Pair::new([size + slack; 2])).times(self.each);
        let ([enter, or], [leave, and]) = (a.lesser(b).both(), a.greater(b).both());
        (greater(greater(t0, enter), or), lesser(lesser(t1, leave), and))
    }

    /// Calls `visit` for the cells of `1 << SHIFT` pixels that the ray meets between `t0` and `t1`, in the rectangle of
    /// `count` rows and columns that begins at cell `first`. Passes the row, the column, and the part of the ray in the
    /// cell. Cells are grown by [`SLACK`] pixels. Omits cells behind a hit.
    #[inline]
    fn cells<const SHIFT: u32>(
        &mut self,
        first: [i64; 2],
        count: [i32; 2],
        (t0, t1): (f64, f64),
        mut visit: impl FnMut(&mut Self, i32, i32, f64, f64) -> Certain,
    ) -> Certain {
        let size = (1u64 << SHIFT) as f64;
        let slack = SLACK / size;
        let origin = [0, 1].map(|n| (self.origin[n] - (first[n] << SHIFT) as f64) / size);
        let speed = self.speed.map(|speed| speed / size);
        // Where cell 0 is entered and left; each further cell adds `each`.
        let each = self.inverse.map(|inverse| inverse * size);
        let enter = [0, 1].map(|n| (-slack - origin[n]) * each[n]);
        let leave = [0, 1].map(|n| (1.0 + slack - origin[n]) * each[n]);
        // Minus half a cell, because `nearest` is used as floor.
        let (low, high) = (origin.map(|o| o - slack - 0.5), origin.map(|o| o + slack - 0.5));
        let from = |axis: usize, t: f64| nearest(low[axis] + speed[axis] * t).max(0);
        let upto = |axis: usize, t: f64| nearest(high[axis] + speed[axis] * t).min(count[axis] - 1);
        for row in from(0, t0)..=upto(0, t1) {
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

    /// Returns the heights of the ray between `t0` and `t1` above the page's floor, lower first (quanta).
    #[inline]
    fn heights(&self, t0: f64, t1: f64) -> (f64, f64) {
        let speed = self.line.speed[2];
        let (a, b) = (self.height + speed * t0, self.height + speed * t1);
        (lesser(a, b), greater(a, b))
    }

    /// Returns the heights in the page at which the ray may meet a span between `t0` and `t1`.
    #[inline]
    fn heights_in_page(&self, t0: f64, t1: f64) -> (u32, u32) {
        let (low, high) = self.heights(t0, t1);
        let low = nearest(low - SLACK_Z + 0.5).max(0);
        // Below the page's floor the ray meets nothing.
        let high = nearest(high + SLACK_Z - 0.5);
        if high < 0 { (i32::MAX as u32, 0) } else { (low as u32, high as u32) }
    }

    /// Returns the part between `t0` and `t1` in which the ray may lie between heights `bottom` and `top` of the page.
    #[inline]
    fn between(&self, bottom: u32, top: u32, t0: f64, t1: f64) -> (f64, f64) {
        let a = (f64::from(bottom) - SLACK_Z - self.height) * self.inverses[2];
        let b = (f64::from(top) + SLACK_Z - self.height) * self.inverses[2];
        (greater(t0, lesser(a, b)), lesser(t1, greater(a, b)))
    }

    /// Visits all tiles within `bounds`, by region if there are many.
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
        self.cells::<12>(first, count, (t0, t1), |walk, row, cell, t0, t1| {
            let region = [first[0] + i64::from(row), first[1] + i64::from(cell)];
            let [rx, ry] = walk.on_grid(region[0], region[1]);
            if walk.set.has_region(rx as i32, ry as i32) {
                walk.tiles([region[0] << 6, region[1] << 6], [REGION as i32; 2], t0, t1)?;
            }
            Ok(())
        })
    }

    #[inline(never)]
    fn tiles(&mut self, first: [i64; 2], count: [i32; 2], t0: f64, t1: f64) -> Certain {
        self.cells::<6>(first, count, (t0, t1), |walk, row, cell, t0, t1| {
            walk.tile([first[0] + i64::from(row), first[1] + i64::from(cell)], t0, t1)
        })
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
            // Beyond the page's ends `bottom` may exceed 63 and the shift wraps; `blocks_in` then returns no blocks.
            if slot.slices() & u64::MAX >> (63 - top) & u64::MAX.wrapping_shl(bottom) == 0 {
                continue;
            }
            let Some(page) = slot.page() else { return Err(Unsure) };
            self.page(page, page.blocks_in(bottom, top), [(tx << 6) as f64, (ty << 6) as f64], t0, t1)?;
        }
        Ok(())
    }

    /// Visits those of `blocks` that the ray meets, in the page whose first pixel is `corner`; `blocks` are occupied at
    /// the ray's heights.
    #[inline]
    fn page(&mut self, page: &Page, blocks: u64, corner: [f64; 2], t0: f64, t1: f64) -> Certain {
        if blocks == 0 {
            return Ok(());
        }
        let mut left = self.mirrored_square(blocks & self.met::<8>(corner, t0, t1));
        while left != 0 {
            let number = left.trailing_zeros() ^ self.turn;
            left &= left - 1;
            let first = [corner[0] + f64::from((number & 7) << 3), corner[1] + f64::from(number & 56)];
            let (t0, t1) = self.within(first, 8.0, SLACK, t0, t1);
            if t0 > t1 || t0 > self.end {
                if t0 > self.end + self.overlap {
                    break;
                }
                continue;
            }
            let (low, high) = self.heights_in_page(t0, t1);
            let block = page.block_at(number);
            let Some((bottom, top)) = union_heights(block, low, high) else { continue };
            let (t0, t1) = self.between(bottom, top, t0, t1);
            if t0 <= t1 && t0 <= self.end {
                self.block(block, first, t0, t1)?;
            }
        }
        Ok(())
    }

    /// Visits the pixels of a block whose first pixel is `first`.
    #[inline(never)]
    fn block(&mut self, block: BlockView<'_>, first: [f64; 2], t0: f64, t1: f64) -> Certain {
        let mut left = self.mirrored_square(block.pixels() & self.met::<1>(first, t0, t1));
        while left != 0 {
            let bit = left.trailing_zeros() ^ self.turn;
            left &= left - 1;
            let pixel = [first[0] + f64::from(bit & 7), first[1] + f64::from(bit >> 3)];
            let (t0, t1) = self.within(pixel, 1.0, SLACK, t0, t1);
            if t0 > t1 || t0 > self.end {
                if t0 > self.end + self.overlap {
                    break;
                }
                continue;
            }
            let (low, high) = self.heights_in_page(t0, t1);
            let spans = block.row_from(bit, low);
            let met = |span: &Span| span.lane() == bit & 7 && span.bottom() <= high;
            if spans.first().is_some_and(met) {
                self.pixel(spans.iter().copied().take_while(met), pixel, t0, t1)?;
            }
        }
        Ok(())
    }

    /// Tests a pixel; the ray meets, or may meet, its `spans` (at least one) between `t0` and `t1`.
    #[inline(never)]
    fn pixel(&mut self, spans: impl Iterator<Item = Span>, pixel: [f64; 2], t0: f64, t1: f64) -> Certain {
        // There is a hit already, and the ray does not certainly reach it before it enters this pixel.
        if self.hit.is_some() {
            return Err(Unsure);
        }
        // Between these the ray is certainly in the pixel.
        let (here, there) = self.within(pixel, 1.0, -SLACK, t0, t1);
        let (least, most) = self.heights(here, there);
        let (least, most) = (least + SLACK_Z, most - SLACK_Z);
        let [i, j] = pixel.map(|cell| i64::from(nearest(cell)));
        for span in spans {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::query::Ray;
    use crate::store::Snapshot;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_cell_that_a_ray_is_in_is_in_the_mask(
            from in prop::array::uniform2(-4i32..72),
            way in prop::array::uniform2(prop::sample::select(vec![-1.0, -0.3, -1e-5, -1e-40, 0.0, 1e-9, 1e-3, 0.7, 1.0])),
            off in prop::sample::select(vec![0.0, 1e-6, 0.3, 0.5]),
            length in 0.0..80.0f64,
        ) {
            let store = Snapshot::from_pages(Frame::new(1.0, 1.0).unwrap(), []);
            let origin = Point3::new(f64::from(from[0]) + off, f64::from(from[1]) + off, 0.0);
            let ray = Ray::new(origin, Vector3::new(way[0], way[1], 1e-2), length).unwrap();
            let line = Line::new(store.frame(), &ray);
            let walk = Walk::new(&store, &line);
            let mut met = 0;
            let mut check = |size: f64, mask: &dyn Fn(f64, f64) -> u64| {
                let (t0, t1) = walk.within([0.0; 2], 8.0 * size, SLACK, 0.0, length);
                let mask = if t0 <= t1 { mask(t0, t1) } else { 0 };
                for n in 0..64u32 {
                    let first = [f64::from(n & 7) * size, f64::from(n >> 3) * size];
                    let (enter, leave) = walk.within(first, size, SLACK, 0.0, length);
                    assert!(enter > leave || mask >> n & 1 == 1, "cell {n} of {size}: {ray:?}");
                    let (enter, leave) = walk.within(first, size, 0.01 * size, 0.0, length);
                    assert!(enter <= leave || mask >> n & 1 == 0, "no cell {n} of {size}: {ray:?}");
                    met += mask >> n & 1;
                }
            };
            check(1.0, &|t0, t1| walk.met::<1>([0.0; 2], t0, t1));
            check(8.0, &|t0, t1| walk.met::<8>([0.0; 2], t0, t1));
            let mask = 0x0123_4567_89AB_CDEF;
            for bit in 0..64u32 {
                prop_assert_eq!(walk.mirrored_square(mask) >> (bit ^ walk.turn) & 1, mask >> bit & 1);
            }
        }
    }
}
