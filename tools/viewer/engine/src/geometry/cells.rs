//! The spans of a page on the coarser grid of a drawing.

use slicewalk::frame::TILE_PIXELS;
use slicewalk::slice::Page;

/// Matter of one cell between two heights (steps).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bar {
    pub bottom: u16,
    pub top: u16,
    pub obstacle: bool,
}

/// Bars per cell, row by row, lowest first and apart.
#[derive(Debug)]
pub(super) struct Cells {
    /// Cells along an edge.
    pub edge: usize,
    bars: Vec<Bar>,
    /// Where each cell's bars begin, and the end.
    first: Vec<u32>,
}

impl Cells {
    /// Cells of `2^coarseness` pixels; heights in steps of `step` quanta.
    ///
    /// A height that lies within a step of a neighbour's takes that: floors with noise become level, and the drawing few
    /// large quads.
    pub fn of(page: &Page, coarseness: u32, step: u32) -> Self {
        let edge = TILE_PIXELS as usize >> coarseness;
        let mut spans: Vec<Vec<(u32, u32, bool)>> = vec![Vec::new(); edge * edge];
        for (px, py, column) in page.columns() {
            let cell = (py as usize >> coarseness) * edge + (px as usize >> coarseness);
            spans[cell].extend(column.iter().map(|span| (span.bottom(), span.top(), span.is_obstacle())));
        }
        let mut cells = Self { edge, bars: Vec::new(), first: vec![0] };
        for (number, spans) in spans.iter_mut().enumerate() {
            spans.sort_unstable();
            let start = cells.bars.len();
            for &(bottom, top, obstacle) in spans.iter() {
                let top = cells.level(number, top, step, |bar| bar.top).max(1);
                let bottom = cells.level(number, bottom, step, |bar| bar.bottom).min(top - 1);
                match cells.bars[start..].last_mut() {
                    // What touches is one bar; the highest says what its top is.
                    Some(below) if bottom <= below.top => {
                        if top > below.top {
                            (below.top, below.obstacle) = (top, obstacle);
                        } else if top == below.top {
                            below.obstacle |= obstacle;
                        }
                    }
                    _ => cells.bars.push(Bar { bottom, top, obstacle }),
                }
            }
            cells.first.push(cells.bars.len() as u32);
        }
        cells
    }

    /// `height` (quanta) in steps: that of a bar of the cell to the left or below, if it is within a step.
    fn level(&self, number: usize, height: u32, step: u32, end: impl Fn(&Bar) -> u16) -> u16 {
        let near = |bars: &[Bar]| {
            let ends = bars.iter().map(&end);
            ends.filter(|level| (u32::from(*level) * step).abs_diff(height) <= step)
                .min_by_key(|level| (u32::from(*level) * step).abs_diff(height))
        };
        let left = (!number.is_multiple_of(self.edge)).then(|| near(self.cell(number - 1))).flatten();
        let below = || (number >= self.edge).then(|| near(self.cell(number - self.edge))).flatten();
        left.or_else(below).unwrap_or((height as f64 / f64::from(step)).round() as u16)
    }

    fn cell(&self, number: usize) -> &[Bar] {
        &self.bars[self.first[number] as usize..self.first[number + 1] as usize]
    }

    /// Bars of cell (`x`, `y`); none outside.
    pub fn at(&self, x: isize, y: isize) -> &[Bar] {
        let inside = |v: isize| (0..self.edge as isize).contains(&v);
        if inside(x) && inside(y) { self.cell(y as usize * self.edge + x as usize) } else { &[] }
    }
}
