//! The spans in a box of a scan.

use crate::window::{Options, Unloaded};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey, SLICE_QUANTA, TILE_PIXELS};
use slicewalk::nalgebra::Point3;
use slicewalk::store::Snapshot;
use slicewalk::{Error, Result};
use std::collections::HashMap;

/// Most parts of a window: with their tree they take half a gigabyte.
const MOST_PARTS: usize = 1 << 22;
/// Most pixels under a window.
const MOST_PIXELS: u64 = 1 << 26;

/// Neighbours of a pixel, in the order of [`Part::level`].
pub const SIDES: [[i64; 2]; 4] = [[-1, 0], [1, 0], [0, -1], [0, 1]];

/// A solid run in one pixel, or a page that is not in memory.
#[derive(Debug, Clone, Copy)]
pub struct Part {
    /// Corners (m).
    pub min: Point3<f64>,
    pub max: Point3<f64>,
    /// Bits: side `n` has a neighbour whose top (bit `n`) or bottom (bit `4 + n`) is level with this one's.
    pub level: u8,
}

/// A run of quanta, both ends inclusive.
type Run = (i64, i64);

/// Collects the parts of a window, and the pages that it lacks.
pub fn collect(
    set: &Snapshot,
    min: Point3<f64>,
    max: Point3<f64>,
    options: &Options,
) -> Result<(Vec<Part>, Vec<PageKey>)> {
    if !(0..3).all(|axis| min[axis] <= max[axis] && (max[axis] - min[axis]).is_finite()) {
        return Err(Error::parameter("window", "expected finite corners, the minima not above the maxima"));
    }
    let frame = set.frame();
    // One pixel more on each side: neighbours decide which faces are level.
    let [i0, j0] = [frame.pixel_of(min.x) - 1, frame.pixel_of(min.y) - 1];
    let [i1, j1] = [frame.pixel_of(max.x) + 1, frame.pixel_of(max.y) + 1];
    let pixels = (i0.abs_diff(i1) + 1).saturating_mul(j0.abs_diff(j1) + 1);
    if pixels > MOST_PIXELS {
        return Err(Error::limit("pixels under a window; make it smaller", pixels, MOST_PIXELS));
    }
    let heights = (frame.quantum_ceil(min.z), frame.quantum_floor(max.z));
    let mut all = Reading { frame, rect: [i0, j0, i1, j1], heights, runs: HashMap::new(), count: 0 };
    let (mut lacking, mut missing) = (Vec::new(), Vec::new());
    for ty in j0.div_euclid(TILE_PIXELS)..=j1.div_euclid(TILE_PIXELS) {
        for tx in i0.div_euclid(TILE_PIXELS)..=i1.div_euclid(TILE_PIXELS) {
            let (Ok(tx), Ok(ty)) = (i32::try_from(tx), i32::try_from(ty)) else { continue };
            for slot in set.column(tx, ty) {
                let key = PageKey { tx, ty, layer: slot.layer() };
                match slot.page() {
                    Some(page) => all.page(key, page)?,
                    None => all.lacking(key, slot.slices(), &mut lacking, &mut missing),
                }
            }
        }
    }
    let mut parts = all.parts([i0 + 1, j0 + 1, i1 - 1, j1 - 1], options);
    if options.unloaded == Unloaded::Solid {
        parts.append(&mut lacking);
    }
    Ok((parts, missing))
}

struct Reading<'a> {
    frame: &'a Frame,
    rect: [i64; 4],
    heights: Run,
    runs: HashMap<[i64; 2], Vec<Run>>,
    count: usize,
}

impl Reading<'_> {
    /// Adds the spans of a page that meet the window. Pages come from below, so a span that a page's end cuts follows
    /// its other half.
    fn page(&mut self, key: PageKey, page: &slicewalk::page::Page) -> Result<()> {
        let floor = i64::from(key.layer) * PAGE_QUANTA;
        if floor > self.heights.1 || floor + PAGE_QUANTA < self.heights.0 {
            return Ok(());
        }
        let [i0, j0, i1, j1] = self.rect;
        let (x, y) = (i64::from(key.tx) * TILE_PIXELS, i64::from(key.ty) * TILE_PIXELS);
        for j in j0.max(y)..=j1.min(y + TILE_PIXELS - 1) {
            for i in i0.max(x)..=i1.min(x + TILE_PIXELS - 1) {
                let spans = page.column((i - x) as u32, (j - y) as u32);
                for span in spans {
                    let (bottom, top) = (floor + i64::from(span.bottom()), floor + i64::from(span.top()));
                    if bottom > self.heights.1 || top < self.heights.0 {
                        continue;
                    }
                    let runs = self.runs.entry([i, j]).or_default();
                    match runs.last_mut() {
                        Some(last) if last.1 == bottom => last.1 = top,
                        _ => {
                            runs.push((bottom, top));
                            self.count += 1;
                        }
                    }
                }
            }
        }
        if self.count > MOST_PARTS {
            return Err(Error::limit("spans in a window; make it smaller", self.count, MOST_PARTS));
        }
        Ok(())
    }

    /// Notes a page that is not in memory, if its occupied slices meet the window.
    fn lacking(&self, key: PageKey, slices: u64, parts: &mut Vec<Part>, missing: &mut Vec<PageKey>) {
        if slices == 0 {
            return;
        }
        let floor = i64::from(key.layer) * PAGE_QUANTA;
        let low = floor + i64::from(slices.trailing_zeros()) * SLICE_QUANTA;
        let high = floor + i64::from(64 - slices.leading_zeros()) * SLICE_QUANTA;
        if low > self.heights.1 || high < self.heights.0 {
            return;
        }
        missing.push(key);
        let first = [i64::from(key.tx) * TILE_PIXELS, i64::from(key.ty) * TILE_PIXELS];
        parts.push(self.part(first, first.map(|pixel| pixel + TILE_PIXELS - 1), (low, high), 0));
    }

    fn part(&self, [i0, j0]: [i64; 2], [i1, j1]: [i64; 2], (bottom, top): Run, level: u8) -> Part {
        let edge = |pixel| self.frame.edge_of_pixel(pixel);
        Part {
            min: Point3::new(edge(i0), edge(j0), self.frame.bottom_height(bottom)),
            max: Point3::new(edge(i1 + 1), edge(j1 + 1), self.frame.top_height(top)),
            level,
        }
    }

    /// Makes the parts of the pixels in a rectangle, in the order of rows.
    fn parts(&self, [i0, j0, i1, j1]: [i64; 4], options: &Options) -> Vec<Part> {
        let tolerance = (options.level / self.frame.quantum_m()).clamp(0.0, 1e6) as i64;
        let mut parts = Vec::with_capacity(self.count);
        for j in j0..=j1 {
            for i in i0..=i1 {
                for &run in self.runs.get(&[i, j]).map_or(&[][..], Vec::as_slice) {
                    let mut level = 0;
                    for (side, [di, dj]) in SIDES.iter().enumerate() {
                        let beside = self.runs.get(&[i + di, j + dj]).map_or(&[][..], Vec::as_slice);
                        level |= self::level(run, beside, tolerance) << side;
                    }
                    parts.push(self.part([i, j], [i, j], run, level));
                }
            }
        }
        parts
    }
}

/// Returns bit 0 if an adjacent run reaches over the top edge of `run` (less the tolerance), and bit 4 likewise at the
/// bottom edge.
fn level((bottom, top): Run, beside: &[Run], tolerance: i64) -> u8 {
    let at_top = beside.iter().any(|&(low, high)| low <= top && high >= top - tolerance);
    let at_bottom = beside.iter().any(|&(low, high)| high >= bottom && low <= bottom + tolerance);
    u8::from(at_top) | u8::from(at_bottom) << 4
}
