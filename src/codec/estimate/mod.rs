//! Estimated length of a page's heights on a step grid, by which lossy encoding (`lossy`) chooses among grids and heights.
//!
//! Lengths are in 1/64 bit. What no choice changes is left out: which pixels are occupied, by how many spans of which
//! kind. The estimate is simpler than the page coding: each span is predicted from its neighbours in the west, north-west,
//! north and north-east, and one model learns the errors of bottoms, another those of thicknesses.

mod candidates;

use super::rans::{COST_BIT, Nibble};
use super::rows::{PIXELS, SLICE, fold};
use super::step_grid::{End, StepGrid};
use crate::page::Span;
pub(super) use candidates::Candidates;
use candidates::{bits, candidates, neighbours};

/// Bits of a grid's step and phase.
const GRID_BITS: u32 = 2 * 40;

/// A span whose heights are chosen.
#[derive(Debug, Clone, Copy, Default)]
struct Coded {
    /// Heights (quanta).
    bottom: u16,
    top: u16,
    /// Numbers of steps on the grid.
    bottom_step: u16,
    top_step: u16,
}

impl Coded {
    fn thickness(&self) -> i32 {
        i32::from(self.top_step) - i32::from(self.bottom_step)
    }
}

/// Symbol of a slice boundary, which the number of the slice follows. The others are lengths of folded residuals, which
/// the bits below the leading one follow.
const BOUNDARY: u32 = 15;
const SLICE_BITS: u32 = 7;

/// Adaptive models of symbols, of bottoms and of thicknesses.
type Models = [Nibble; 2];

/// Model at the start of each page: weights of the symbols, averaged over six scans.
const RESIDUAL: Nibble = Nibble::new([60, 40, 60, 90, 130, 160, 160, 130, 90, 60, 40, 30, 30, 25, 10, 1]);
const FRESH: Models = [RESIDUAL; 2];

/// Returns the symbol of a step, `None` for a slice boundary, if step `expected` is predicted.
#[inline]
fn symbol(expected: i32, step: Option<u32>) -> u32 {
    step.map_or(BOUNDARY, |step| bits(fold(step as i32 - expected)))
}

/// An estimate, pixel by pixel; reused from page to page.
#[derive(Debug)]
pub struct Estimate {
    grid: StepGrid,
    cost: u64,
    models: Models,
    spans: Vec<Coded>,
}

impl Default for Estimate {
    fn default() -> Self {
        Self { grid: StepGrid::QUANTA, cost: 0, models: FRESH, spans: Vec::new() }
    }
}

impl Estimate {
    /// Estimates spans on `grid`; `first` has the number of the first span of each pixel, in row order, and one more.
    /// `choose` returns the span with this number, of which `Candidates` predict the heights. Before each row,
    /// `goes_on` gets its number and the cost of the rows above it (1/64 bit). Returns the cost of all, `None` once it
    /// returns false.
    pub fn walk(
        &mut self,
        grid: StepGrid,
        first: &[u32],
        mut choose: impl FnMut(&Self, usize, &Candidates) -> Span,
        mut goes_on: impl FnMut(usize, u64) -> bool,
    ) -> Option<u64> {
        self.grid = grid;
        self.cost = if grid.is_quanta() { 0 } else { u64::from(GRID_BITS * COST_BIT) };
        self.models = FRESH;
        self.spans.clear();
        for pixel in 0..PIXELS {
            if pixel % 64 == 0 && !goes_on(pixel / 64, self.cost) {
                return None;
            }
            let own = first[pixel] as usize..first[pixel + 1] as usize;
            if own.is_empty() {
                continue;
            }
            let mut around = neighbours(first, pixel);
            let mut below = None;
            for number in own {
                let candidates = candidates(&self.spans, &mut around, below);
                let span = choose(self, number, &candidates);
                below = Some(self.add(&candidates, span));
            }
        }
        Some(self.cost)
    }

    fn add(&mut self, candidates: &Candidates, span: Span) -> Coded {
        let (bottom, top) = (span.bottom(), span.top());
        let bottom_step = self.learn(End::Bottom, candidates.bottom, bottom);
        let expected = bottom_step as i32 + candidates.thickness;
        let top_step = self.learn(End::Top, expected, top);
        let [bottom, top, bottom_step, top_step] = [bottom, top, bottom_step, top_step].map(|value| value as u16);
        let coded = Coded { bottom, top, bottom_step, top_step };
        self.spans.push(coded);
        coded
    }

    /// Returns the cost (1/64 bit) of a step of `end`, `None` for a slice boundary, if step `expected` is predicted.
    #[inline]
    pub fn cost(&self, end: End, expected: i32, step: Option<u32>) -> u32 {
        let symbol = symbol(expected, step);
        let rest = if symbol == BOUNDARY { SLICE_BITS } else { symbol.saturating_sub(1) };
        self.models[end as usize].cost(symbol) + rest * COST_BIT
    }

    /// Adds the cost of `height` to the sum and to the models what it shows. Returns its step, or the next one.
    #[inline]
    fn learn(&mut self, end: End, expected: i32, height: u32) -> u32 {
        let step = self.grid.index(height, end).map(|(step, _)| step);
        // All other heights have steps, or the grid is not one of this page.
        debug_assert!(step.is_some() || height.is_multiple_of(SLICE), "no step for {height} {end:?}");
        self.cost += u64::from(self.cost(end, expected, step));
        self.models[end as usize].learn(symbol(expected, step));
        step.unwrap_or_else(|| self.grid.at_or_above(height))
    }
}
