//! Estimated length of a page with heights on a step grid, by which lossy encoding (`lossy`) chooses heights.
//!
//! Lengths are in 1/64 bit. The estimate has its own models, simpler than those of the page coding: each span is
//! predicted from its neighbours in the west, north-west, north and north-east, and their agreement selects the model.
//! It visits a page in coding order, so a caller can stop once a candidate is too long.

mod nearest_costs;

use super::lossy::Tried;
use super::rans::{Bit, COST_BIT, Coder, Nibble, RansEncoder};
use super::rows::{PIXELS, Rows, SLICE, fold};
use super::step_grid::{End, StepGrid};
use crate::page::{BLOCK_PIXELS, Page, Span};
pub(super) use nearest_costs::Candidates;
use nearest_costs::{bits, candidates, neighbours};

/// Bits of a grid's step and phase: 8 before the binary point, 32 after it.
const GRID_BITS: u32 = 40;

/// A coded span.
#[derive(Debug, Clone, Copy, Default)]
struct Coded {
    /// Heights (quanta).
    bottom: u16,
    top: u16,
    /// Numbers of steps on the grid.
    bottom_step: u16,
    top_step: u16,
    obstacle: bool,
}

impl Coded {
    fn thickness(&self) -> i32 {
        i32::from(self.top_step) - i32::from(self.bottom_step)
    }
}

/// Initial models of residuals: weights of the lengths of folded residuals, averaged over six scans.
const RESIDUAL: Nibble = Nibble::new([60, 40, 60, 90, 130, 160, 160, 130, 90, 60, 40, 30, 30, 25, 10, 1]);
const COUNT: Nibble = Nibble::new([800, 120, 40, 20, 10, 5, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1]);
const HALF: Bit = Bit::new(1 << 14);
/// Among residuals of one length, small ones are more common.
const FALLING: [Bit; 16] = [const { Bit::new(13 << 10) }; 16];
const QUARTER: Bit = Bit::new(1 << 13);
const RARE: Bit = Bit::new(1 << 10);

/// All adaptive models, reset for each page because pages are read independently.
#[derive(Debug, Clone)]
pub(super) struct Models {
    /// By the states of the blocks in the west and north: whether a block is occupied at all, and in all pixels.
    occupied: [Bit; 9],
    full: [Bit; 9],
    /// By the six pixels before.
    pixel: [Bit; 64],
    /// By the numbers of spans in the west and north, capped at 3.
    count: [Nibble; 16],
    bottom: [Nibble; 16],
    thickness: [Nibble; 80],
    /// Highest bit below the leading one, by end and length.
    second: [[Bit; 16]; 2],
    /// Whether a height is off its step's usual one, by end and by what that step had last; and in which direction.
    off: [[Bit; 4]; 2],
    up: [Bit; 2],
    /// By obstacles among the candidates, number of candidates, and whether the span is thick.
    kind: [Bit; 50],
}

const FRESH: Models = Models {
    occupied: [HALF; 9],
    full: [QUARTER; 9],
    pixel: [HALF; 64],
    count: [COUNT; 16],
    bottom: [RESIDUAL; 16],
    thickness: [RESIDUAL; 80],
    second: [FALLING; 2],
    off: [const { [RARE, RARE, HALF, RARE] }; 2],
    up: [HALF; 2],
    kind: [HALF; 50],
};

/// Spans already coded and where each pixel's begin; reused from page to page.
#[derive(Debug)]
pub struct Scratch {
    models: Box<Models>,
    /// Index of the first span of each pixel, in row order, and one more. Valid up to the current pixel.
    first: Box<[u32]>,
    spans: Vec<Coded>,
    /// Per end and step: 0 if the step has not occurred, 1 if it last had its usual height, 2 if not.
    last_off: Box<[[u8; 1 << 14]; 2]>,
    encoder: RansEncoder,
    column: Vec<Span>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            models: Box::new(FRESH),
            first: vec![0; PIXELS + 1].into(),
            spans: Vec::new(),
            last_off: Box::new([[0; 1 << 14]; 2]),
            encoder: RansEncoder::default(),
            column: Vec::new(),
        }
    }
}

/// State of a walk over a page, with the symbols already coded.
pub(super) struct Traversal<'a> {
    coder: RansEncoder,
    pub grid: StepGrid,
    models: &'a mut Models,
    last_off: &'a mut [[u8; 1 << 14]; 2],
}

impl Traversal<'_> {
    /// Returns the cost (1/64 bit) of a height of `end` with the models of `context`, if step `expected` is predicted.
    /// `step` is the height's step and its offset from the usual height; `None` is a slice boundary.
    #[inline]
    pub fn cost(&self, end: End, context: usize, expected: i32, step: Option<(u32, i32)>) -> u32 {
        let side = end as usize;
        let models = match end {
            End::Bottom => &self.models.bottom[..],
            End::Top => &self.models.thickness[..],
        };
        let Some((index, off)) = step else { return models[context].cost(15) + 7 * COST_BIT };
        let residual = fold(index as i32 - expected);
        let length = bits(residual);
        let mut cost = models[context].cost(length);
        if length > 1 {
            cost += self.models.second[side][length as usize].cost(residual >> (length - 2) & 1 == 1);
            cost += (length - 2) * COST_BIT;
        }
        if !self.grid.is_quanta() {
            let last = self.last_off[side][index as usize];
            cost += self.models.off[side][last as usize].cost(off != 0);
            cost += if off != 0 { COST_BIT } else { 0 };
        }
        cost
    }

    /// Codes which blocks are occupied, and which in all pixels, given as masks.
    fn blocks(&mut self, (occupied, full): (u64, u64)) {
        for block in 0..64 {
            let kind = |exists: bool, back: u32| {
                if exists {
                    (occupied >> (block - back) & 1) as usize + (full >> (block - back) & 1) as usize
                } else {
                    0
                }
            };
            let context = kind(block % 8 > 0, 1) * 3 + kind(block >= 8, 8);
            if self.coder.bit(&mut self.models.occupied[context], occupied >> block & 1 == 1) {
                self.coder.bit(&mut self.models.full[context], full >> block & 1 == 1);
            }
        }
    }

    /// Codes the number of spans of an occupied pixel.
    fn count(&mut self, west: u32, north: u32, given: u32) {
        let model = &mut self.models.count[(west.min(3) * 4 + north.min(3)) as usize];
        let mut count = 1;
        loop {
            let more = self.coder.nibble(model, (given - count).min(15));
            count += more;
            if more < 15 {
                return;
            }
        }
    }

    /// Codes `height` with the models of `context`, if step `expected` is predicted. Returns its step.
    #[inline]
    fn height(&mut self, end: End, context: usize, expected: i32, height: u32) -> u32 {
        let side = end as usize;
        let models = match end {
            End::Bottom => &mut self.models.bottom[..],
            End::Top => &mut self.models.thickness[..],
        };
        let Some((index, off)) = self.grid.index(height, end) else {
            // A span cut at a slice boundary ends between steps. All other heights have steps, or the grid is not one
            // of this page.
            debug_assert!(height.is_multiple_of(SLICE), "no step for {height} {end:?}");
            self.coder.nibble(&mut models[context], 15);
            self.coder.raw(7, height / SLICE);
            return self.grid.at_or_above(height);
        };
        let residual = fold(index as i32 - expected);
        let length = self.coder.nibble(&mut models[context], bits(residual));
        if length > 1 {
            let second = &mut self.models.second[side][length as usize];
            self.coder.bit(second, residual >> (length - 2) & 1 == 1);
        }
        if length > 2 {
            let rest = length - 2;
            self.coder.raw(rest, residual & ((1 << rest) - 1));
        }
        let index = index & 0x3FFF;
        if !self.grid.is_quanta() {
            let last = &mut self.last_off[side][index as usize];
            if self.coder.bit(&mut self.models.off[side][*last as usize], off != 0) {
                self.coder.bit(&mut self.models.up[side], off > 0);
            }
            *last = if off == 0 { 1 } else { 2 };
        }
        index
    }
}

/// Source of the values of a walk.
pub(super) trait Given<'a> {
    /// Returns masks of the occupied blocks and of those occupied in all pixels.
    fn blocks(&self) -> (u64, u64);
    /// Returns the spans of a pixel. All pixels of occupied blocks are asked for in row order.
    fn spans(&mut self, px: u32, py: u32) -> &'a [Span];
    /// Returns `span`, which is number `_at.1` in pixel `_at.0`, or the span to code in its place.
    #[inline]
    fn chosen(&self, span: Span, _at: (usize, usize), _: &Candidates, _: &Traversal<'_>) -> Span {
        span
    }
    /// Returns whether to continue with a row of pixels; `cost` returns the cost of the rows before it (1/64 bit).
    #[inline]
    fn goes_on(&mut self, _row: u32, _cost: impl FnOnce() -> u64) -> bool {
        true
    }
}

impl<'a> Given<'a> for Rows<'a> {
    fn blocks(&self) -> (u64, u64) {
        let page = self.page;
        let mask = |has: fn(u64) -> bool| {
            (0..64).fold(0, |mask, block| mask | (has(page.block_at(block).pixels()) as u64) << block)
        };
        (mask(|pixels| pixels != 0), mask(|pixels| pixels == u64::MAX))
    }

    #[inline]
    fn spans(&mut self, px: u32, py: u32) -> &'a [Span] {
        if px.is_multiple_of(BLOCK_PIXELS) {
            self.rest =
                self.page.block(px / BLOCK_PIXELS, py / BLOCK_PIXELS).rows(py % BLOCK_PIXELS, py % BLOCK_PIXELS);
        }
        self.next(px % BLOCK_PIXELS)
    }
}

/// Occupancy of the six pixels before the current one.
#[derive(Default)]
struct Before {
    /// The two pixels to the west.
    west: u64,
    /// In the row to the north: the pixel to the west, and those from the current column on.
    north_west: u64,
    north: u64,
    /// In the next row to the north: the pixels from the current column on.
    north_2: u64,
}

impl Before {
    /// Returns the state before the first pixel of a row, below two others.
    fn row(north: u64, north_2: u64) -> Self {
        Self { north, north_2, ..Self::default() }
    }

    /// Returns the context: west 2, west, north-west, north, north-east, north 2, from the lowest bit up.
    #[inline]
    fn context(&self) -> usize {
        (self.west | self.north_west << 2 | (self.north & 3) << 3 | (self.north_2 & 1) << 5) as usize
    }

    #[inline]
    fn pass(&mut self, has_matter: bool) {
        self.west = self.west >> 1 | u64::from(has_matter) << 1;
        self.north_west = self.north & 1;
        (self.north, self.north_2) = (self.north >> 1, self.north_2 >> 1);
    }

    /// Skips the row of an empty block.
    fn pass_block(&mut self) {
        self.west = 0;
        self.north_west = self.north >> (BLOCK_PIXELS - 1) & 1;
        (self.north, self.north_2) = (self.north >> BLOCK_PIXELS, self.north_2 >> BLOCK_PIXELS);
    }
}

/// Walks over the page of `given` and passes the spans of each occupied pixel to `give`.
fn walk<'a>(
    coder: RansEncoder,
    grid: StepGrid,
    scratch: &mut Scratch,
    mut given: impl Given<'a>,
    mut give: impl FnMut(&[Span]),
) -> RansEncoder {
    let Scratch { models, first, spans, last_off, column, .. } = scratch;
    **models = FRESH;
    if !grid.is_quanta() {
        last_off.iter_mut().for_each(|end| end.fill(0));
    }
    spans.clear();
    let mut traversal = Traversal { coder, grid, models, last_off };
    let (occupied, full) = given.blocks();
    traversal.blocks((occupied, full));
    // Occupied pixels of the current row and of the one before.
    let (mut row, mut row_north) = (0u64, 0u64);
    let mut before = Before::default();
    first[0] = 0;
    let mut pixel = 0;
    while pixel < PIXELS {
        let (px, py) = (pixel as u32 % 64, pixel as u32 / 64);
        if px == 0 {
            if !given.goes_on(py, || traversal.coder.cost()) {
                break;
            }
            before = Before::row(row, row_north);
            (row_north, row) = (row, 0);
        }
        let block = py / 8 * 8 + px / 8;
        if occupied >> block & 1 == 0 {
            let end = pixel + BLOCK_PIXELS as usize;
            first[pixel + 1..=end].fill(spans.len() as u32);
            before.pass_block();
            pixel = end;
            continue;
        }
        let given_spans = given.spans(px, py);
        let is_occupied = !given_spans.is_empty();
        if full >> block & 1 == 0 {
            let model = &mut traversal.models.pixel[before.context()];
            traversal.coder.bit(model, is_occupied);
        }
        before.pass(is_occupied);
        if is_occupied {
            row |= 1 << px;
            let mut around = neighbours(first, pixel);
            let [west, north, ..] = &around;
            traversal.count(west.len() as u32, north.len() as u32, given_spans.len() as u32);
            column.clear();
            let mut below = None;
            for (index, &span) in given_spans.iter().enumerate() {
                let candidates = candidates(spans, &mut around, below);
                let span = given.chosen(span, (pixel, index), &candidates, &traversal);
                let (bottom, top) = (span.bottom(), span.top());
                let bottom_step = traversal.height(End::Bottom, candidates.bottom_context(), candidates.bottom, bottom);
                let expected = bottom_step as i32 + candidates.thickness;
                let top_step = traversal.height(End::Top, candidates.thickness_context(), expected, top);
                let context = candidates.kind_context() * 2 + usize::from(top - bottom > SLICE / 4);
                traversal.coder.bit(&mut traversal.models.kind[context], span.is_obstacle());
                column.push(span);
                let coded = Coded {
                    bottom: bottom as u16,
                    top: top as u16,
                    bottom_step: bottom_step as u16,
                    top_step: top_step as u16,
                    obstacle: span.is_obstacle(),
                };
                spans.push(coded);
                below = Some(coded);
            }
            give(column);
        }
        pixel += 1;
        first[pixel] = spans.len() as u32;
    }
    traversal.coder
}

/// Returns the estimated length of `page` on `grid` (1/64 bit).
pub(super) fn length_on(grid: StepGrid, page: &Page, scratch: &mut Scratch) -> u64 {
    let mut encoder = std::mem::take(&mut scratch.encoder);
    encoder.clear();
    code_grid(&mut encoder, grid);
    scratch.encoder = walk(encoder, grid, scratch, Rows::of(page), |_| {});
    scratch.encoder.cost()
}

/// Walks over what `given` chooses on the grid of `tried`, and stores its spans and symbols there.
pub(super) fn choose<'a>(given: impl Given<'a>, tried: &mut Tried, scratch: &mut Scratch) {
    let Tried { grid, encoder, spans } = tried;
    let mut coder = std::mem::take(encoder);
    coder.clear();
    spans.clear();
    code_grid(&mut coder, *grid);
    *encoder = walk(coder, *grid, scratch, given, |column| spans.extend_from_slice(column));
}

/// Codes a bit that is 1 if there is a grid, then its step and phase, 10 bits at a time, highest first.
fn code_grid(coder: &mut RansEncoder, given: StepGrid) {
    if coder.raw(1, u32::from(!given.is_quanta())) == 1 {
        for number in [given.step, given.phase] {
            for at in (0..GRID_BITS / 10).rev() {
                coder.raw(10, (number >> (10 * at) & 0x3FF) as u32);
            }
        }
    }
}
