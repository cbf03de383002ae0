//! Spans of a page on the coarser grid of a drawing.

use slicewalk::frame::TILE_PIXELS;
use slicewalk::page::{Page, Span};

/// Solid in one cell between two heights (steps).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bar {
    pub bottom: u16,
    pub top: u16,
    pub obstacle: bool,
}

/// Bars per cell, row by row; lowest first and disjoint.
#[derive(Debug)]
pub(super) struct Cells {
    /// Cells along an edge.
    pub edge: usize,
    bars: Vec<Bar>,
    /// Index of each cell's first bar, then the total.
    first: Vec<u32>,
}

impl Cells {
    /// Builds cells of `2^coarseness` pixels, with heights in steps of `step` quanta.
    ///
    /// A height within a step of a neighbour's takes the neighbour's value: noisy floors become level, and the drawing
    /// has few large quads.
    pub fn of(page: &Page, coarseness: u32, step: u32) -> Self {
        let edge = TILE_PIXELS as u32 >> coarseness;
        let mut cells = Self { edge: edge as usize, bars: Vec::new(), first: vec![0] };
        let mut spans: Vec<Span> = Vec::new();
        for number in 0..edge * edge {
            spans.clear();
            let (x, y) = ((number % edge) << coarseness, (number / edge) << coarseness);
            for (px, py) in (0..1 << coarseness).flat_map(|dy| (0..1 << coarseness).map(move |dx| (x + dx, y + dy))) {
                page.column(px, py).iter().for_each(|span| put(&mut spans, *span));
            }
            cells.add(&spans, step);
        }
        cells
    }

    /// Adds the next cell, from spans with ascending bottoms.
    fn add(&mut self, spans: &[Span], step: u32) {
        let (number, start) = (self.first.len() - 1, self.bars.len());
        for span in spans {
            let top = self.level(number, span.top(), step, |bar| bar.top).max(1);
            let bottom = self.level(number, span.bottom(), step, |bar| bar.bottom).min(top - 1);
            match self.bars[start..].last_mut() {
                // Touching spans form one bar; the highest decides the kind of its top.
                Some(below) if bottom <= below.top => {
                    if top > below.top {
                        (below.top, below.obstacle) = (top, span.is_obstacle());
                    } else if top == below.top {
                        below.obstacle |= span.is_obstacle();
                    }
                }
                _ => self.bars.push(Bar { bottom, top, obstacle: span.is_obstacle() }),
            }
        }
        self.first.push(self.bars.len() as u32);
    }

    /// Converts `height` (quanta) to steps; takes the height of a bar in the cell to the left or below if it is within
    /// a step.
    fn level(&self, number: usize, height: u32, step: u32, end: impl Fn(&Bar) -> u16) -> u16 {
        let near = |bars: &[Bar]| {
            let ends = bars.iter().map(&end);
            ends.filter(|level| (u32::from(*level) * step).abs_diff(height) <= step)
                .min_by_key(|level| (u32::from(*level) * step).abs_diff(height))
        };
        let left = (!number.is_multiple_of(self.edge)).then(|| near(self.cell(number - 1))).flatten();
        let below = || (number >= self.edge).then(|| near(self.cell(number - self.edge))).flatten();
        left.or_else(below).unwrap_or(((height + step / 2) / step) as u16)
    }

    fn cell(&self, number: usize) -> &[Bar] {
        &self.bars[self.first[number] as usize..self.first[number + 1] as usize]
    }

    /// Bars of cell (`x`, `y`); empty outside.
    pub fn at(&self, x: isize, y: isize) -> &[Bar] {
        let inside = |v: isize| (0..self.edge as isize).contains(&v);
        if inside(x) && inside(y) { self.cell(y as usize * self.edge + x as usize) } else { &[] }
    }
}

/// Inserts a span by its bottom; spans arrive nearly in order.
fn put(spans: &mut Vec<Span>, span: Span) {
    let above = spans.iter().rev().take_while(|other| other.bottom() > span.bottom()).count();
    spans.insert(spans.len() - above, span);
}
