//! Points to pages, in the plain form: a dense array of voxels. Vertically adjacent occupied voxels become one span; a
//! span taller than a pixel is wide is an obstacle.

use nalgebra::Point3;
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey, SLICE_QUANTA};
use slicewalk::page::{Page, PageBuilder, Span};
use std::collections::BTreeMap;

/// Heights of the solid in the voxels of a box.
pub struct Voxels {
    frame: Frame,
    first: [i64; 3],
    count: [usize; 3],
    /// Lowest and highest quantum above the slice's floor; empty if the first exceeds the second.
    heights: Vec<(u8, u8)>,
}

impl Voxels {
    /// Creates an empty box between `min` and `max`.
    pub fn new(frame: Frame, min: Point3<f64>, max: Point3<f64>) -> Self {
        let index = |p: Point3<f64>| [frame.pixel_of(p.x), frame.pixel_of(p.y), frame.slice_of(p.z)];
        let (first, last) = (index(min), index(max));
        let count = [0, 1, 2].map(|axis| (last[axis] - first[axis] + 1) as usize);
        Self { frame, first, count, heights: vec![(255, 0); count.iter().product()] }
    }

    /// Adds a point; points outside are dropped.
    pub fn add(&mut self, p: Point3<f64>) {
        let slice = self.frame.slice_of(p.z);
        let index = [self.frame.pixel_of(p.x), self.frame.pixel_of(p.y), slice];
        let at = [0, 1, 2].map(|axis| index[axis] - self.first[axis]);
        if (0..3).all(|axis| (0..self.count[axis] as i64).contains(&at[axis])) {
            let at = (at[1] as usize * self.count[0] + at[0] as usize) * self.count[2] + at[2] as usize;
            let floor = slice * SLICE_QUANTA;
            let (low, high) = (self.frame.quantum_floor(p.z) - floor, self.frame.quantum_ceil(p.z) - floor);
            let heights = &mut self.heights[at];
            *heights = (heights.0.min(low as u8), heights.1.max(high as u8));
        }
    }

    /// Returns the occupied voxels: pixel, pixel, slice.
    pub fn occupied(&self) -> Vec<[i64; 3]> {
        let mut occupied = Vec::new();
        for (n, heights) in self.heights.iter().enumerate().filter(|(_, heights)| heights.0 <= heights.1) {
            let _ = heights;
            let (pixel, slice) = (n / self.count[2], n % self.count[2]);
            let at = [pixel % self.count[0], pixel / self.count[0], slice];
            occupied.push([0, 1, 2].map(|axis| at[axis] as i64 + self.first[axis]));
        }
        occupied
    }

    /// The pages.
    pub fn pages(&self) -> Vec<(PageKey, Page)> {
        let obstacle_quanta = (self.frame.pixel_m() / self.frame.quantum_m()) as i64;
        let mut pages: BTreeMap<PageKey, Vec<(u32, u32, Vec<Span>)>> = BTreeMap::new();
        for (n, column) in self.heights.chunks_exact(self.count[2]).enumerate() {
            let (i, j) = ((n % self.count[0]) as i64 + self.first[0], (n / self.count[0]) as i64 + self.first[1]);
            let mut spans: Vec<(i64, i64)> = Vec::new();
            let mut below = false;
            for (s, &(low, high)) in column.iter().enumerate() {
                let floor = (self.first[2] + s as i64) * SLICE_QUANTA;
                if low <= high {
                    match spans.last_mut().filter(|_| below) {
                        Some(last) => last.1 = floor + i64::from(high),
                        None => spans.push((floor + i64::from(low), floor + i64::from(high))),
                    }
                }
                below = low <= high;
            }
            for (bottom, top) in spans {
                for layer in bottom.div_euclid(PAGE_QUANTA)..=(top - 1).max(bottom).div_euclid(PAGE_QUANTA) {
                    let base = layer * PAGE_QUANTA;
                    let (low, high) = (bottom.max(base) - base, top.min(base + PAGE_QUANTA) - base);
                    let span = Span::new(low as u32, high as u32, top - bottom > obstacle_quanta).expect("clipped");
                    let tile = |v: i64| v.div_euclid(64) as i32;
                    let (px, py) = (i.rem_euclid(64) as u32, j.rem_euclid(64) as u32);
                    let page = pages.entry(PageKey { tx: tile(i), ty: tile(j), layer: layer as i32 }).or_default();
                    match page.last_mut() {
                        Some((x, y, spans)) if (*x, *y) == (px, py) => spans.push(span),
                        _ => page.push((px, py, vec![span])),
                    }
                }
            }
        }
        let mut builder = PageBuilder::default();
        let build = |(key, columns): (PageKey, Vec<(u32, u32, Vec<Span>)>)| {
            builder.clear();
            for (px, py, spans) in columns {
                assert!(builder.set_column(px, py, &spans), "{spans:?}");
            }
            (key, builder.build())
        };
        pages.into_iter().map(build).collect()
    }
}
