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
    /// Cells along an edge of the page.
    pub edge: usize,
    /// Cells of the neighbours around them: 0 or 1.
    margin: usize,
    bars: Vec<Bar>,
    /// Index of each cell's first bar, then the total.
    first: Vec<u32>,
}

impl Cells {
    /// Builds cells of `2^coarseness` pixels, with heights in steps of `step` quanta.
    ///
    /// A height within a step of a neighbour's takes the neighbour's value: noisy floors become level, and the drawing
    /// has few large quads. `around`: pages of the neighbours, row by row with the page itself in the middle, whose
    /// nearest cells surround the page's.
    pub fn of(page: &Page, around: Option<&[Option<&Page>; 9]>, coarseness: u32, step: u32) -> Self {
        let (edge, margin) = (TILE_PIXELS as u32 >> coarseness, u32::from(around.is_some()));
        let mut cells = Self { edge: edge as usize, margin: margin as usize, bars: Vec::new(), first: vec![0] };
        let mut spans: Vec<Span> = Vec::new();
        let wide = edge + 2 * margin;
        // Coordinates begin a page before the page, so that they are not negative.
        let first = TILE_PIXELS as u32 - (margin << coarseness);
        for number in 0..wide * wide {
            spans.clear();
            let (x, y) = (first + ((number % wide) << coarseness), first + ((number / wide) << coarseness));
            let place = (y / TILE_PIXELS as u32 * 3 + x / TILE_PIXELS as u32) as usize;
            let page = around.map_or(Some(page), |around| around[place]);
            let (x, y) = (x % TILE_PIXELS as u32, y % TILE_PIXELS as u32);
            for (dx, dy) in (0..1 << coarseness).flat_map(|dy| (0..1 << coarseness).map(move |dx| (dx, dy))) {
                page.into_iter()
                    .for_each(|page| page.column(x + dx, y + dy).iter().for_each(|span| put(&mut spans, *span)));
            }
            cells.add(&spans, step);
        }
        cells
    }

    /// Adds bars to cells (x, y) in their order.
    pub fn add_bars(&mut self, added: &[(isize, isize, Bar)]) {
        if added.is_empty() {
            return;
        }
        let (bars, first) = (std::mem::take(&mut self.bars), std::mem::replace(&mut self.first, vec![0]));
        let numbered: Vec<(usize, Bar)> = added.iter().map(|(x, y, bar)| (self.number(*x, *y), *bar)).collect();
        let mut added = numbered.into_iter().peekable();
        for (number, ends) in first.windows(2).enumerate() {
            let start = self.bars.len();
            self.bars.extend(&bars[ends[0] as usize..ends[1] as usize]);
            while let Some((_, bar)) = added.next_if(|(of, _)| *of == number) {
                let below = self.bars[start..].iter().take_while(|other| other.bottom < bar.bottom).count();
                self.bars.insert(start + below, bar);
            }
            self.first.push(self.bars.len() as u32);
        }
    }

    fn wide(&self) -> usize {
        self.edge + 2 * self.margin
    }

    fn number(&self, x: isize, y: isize) -> usize {
        let place = |v: isize| (v + self.margin as isize) as usize;
        place(y) * self.wide() + place(x)
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
        let left = (!number.is_multiple_of(self.wide())).then(|| near(self.cell(number - 1))).flatten();
        let below = || (number >= self.wide()).then(|| near(self.cell(number - self.wide()))).flatten();
        left.or_else(below).unwrap_or(((height + step / 2) / step) as u16)
    }

    fn cell(&self, number: usize) -> &[Bar] {
        &self.bars[self.first[number] as usize..self.first[number + 1] as usize]
    }

    /// Bars of cell (`x`, `y`); empty outside.
    pub fn at(&self, x: isize, y: isize) -> &[Bar] {
        let margin = self.margin as isize;
        let inside = |v: isize| (-margin..self.edge as isize + margin).contains(&v);
        if inside(x) && inside(y) { self.cell(self.number(x, y)) } else { &[] }
    }

    /// Bars of cell (`x`, `y`); empty for the cells of neighbours and outside.
    pub fn within(&self, x: isize, y: isize) -> &[Bar] {
        let inside = |v: isize| (0..self.edge as isize).contains(&v);
        if inside(x) && inside(y) { self.at(x, y) } else { &[] }
    }
}

/// Inserts a span by its bottom; spans arrive nearly in order.
fn put(spans: &mut Vec<Span>, span: Span) {
    let above = spans.iter().rev().take_while(|other| other.bottom() > span.bottom()).count();
    spans.insert(spans.len() - above, span);
}
