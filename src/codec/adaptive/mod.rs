//! Model 1, `adaptive`: all spans of all pixels, each predicted from its neighbours, coded by how well neighbours agree
//! (specification, chapter 6).
//!
//! One walk serves encoder and decoder ([`Coder`]): blocks with matter, then pixel by pixel in row order whether there
//! is matter, how many spans, and of each span bottom, thickness and kind. Heights are steps of a [`Lattice`]. What the
//! neighbours in the west, north-west, north and north-east say chooses the model that codes a value: where they agree,
//! little is left to say.

mod near;

use super::lattice::{End, HeightsOf, Lattice};
use super::loose::Tried;
use super::rans::{Bit, COST_BIT, Coder, Nibble, RansDecoder, RansEncoder};
use super::{MAX_PAGE_SPANS, Violation};
use crate::frame::{PAGE_QUANTA, SLICE_QUANTA};
use crate::slice::{BLOCK_PIXELS, Page, PageBuilder, Span};
pub(super) use near::Candidates;
use near::{bits, candidates, neighbours};

pub(super) const PIXELS: usize = 64 * 64;
/// Most spans in one pixel.
pub(super) const MAX_COLUMN: u32 = 64;
pub(super) const SLICE: u32 = SLICE_QUANTA as u32;
/// Bits of a lattice's step and phase: 8 before the point, 32 behind it.
const LATTICE_BITS: u32 = 40;

/// Most symbols of a page: of a span 12 (its pixel's count, five for each end, the kind), of a pixel whether it has
/// matter, two for each block, and the lattice.
const MAX_SYMBOLS: usize = 12 * MAX_PAGE_SPANS + PIXELS + 2 * 64 + 1 + 2 * (LATTICE_BITS as usize / 10);
/// Greatest length of an encoding (bytes): the state, and a word for each symbol at most.
pub const MAX_LEN: usize = 4 + 2 * MAX_SYMBOLS;

/// A span as it is coded.
#[derive(Debug, Clone, Copy, Default)]
struct Coded {
    /// Heights (quanta).
    bottom: u16,
    top: u16,
    /// Steps of the lattice.
    bottom_step: u16,
    top_step: u16,
    obstacle: bool,
}

impl Coded {
    fn thickness(&self) -> i32 {
        i32::from(self.top_step) - i32::from(self.bottom_step)
    }
}

/// Models of residuals: weights of the lengths of folded residuals, as six scans have them in the mean.
const RESIDUAL: Nibble = Nibble::new([60, 40, 60, 90, 130, 160, 160, 130, 90, 60, 40, 30, 30, 25, 10, 1]);
const COUNT: Nibble = Nibble::new([800, 120, 40, 20, 10, 5, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1]);
const HALF: Bit = Bit::new(1 << 14);
/// Within a length, small residuals are more common than great ones.
const FALLING: [Bit; 16] = [const { Bit::new(13 << 10) }; 16];
const QUARTER: Bit = Bit::new(1 << 13);
const RARE: Bit = Bit::new(1 << 10);

/// Everything that learns. Made anew for each page, so that a page can be read alone.
#[derive(Debug, Clone)]
pub(super) struct Models {
    /// By the kinds of the blocks in the west and north: matter at all, and in all pixels.
    matter: [Bit; 9],
    full: [Bit; 9],
    /// By the six pixels before.
    pixel: [Bit; 64],
    /// By the counts of spans in the west and north, 3 for more.
    count: [Nibble; 16],
    bottom: [Nibble; 16],
    thickness: [Nibble; 80],
    /// Highest bit below the leading one, by end and length.
    second: [[Bit; 16]; 2],
    /// Whether a height is off its step's usual one, by end and by what was last said of that step; and which way.
    off: [[Bit; 4]; 2],
    up: [Bit; 2],
    /// By obstacles among the candidates, number of candidates, and whether the span is thick.
    kind: [Bit; 50],
}

const FRESH: Models = Models {
    matter: [HALF; 9],
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

/// Spans coded so far and where each pixel's begin; reused from page to page.
#[derive(Debug)]
pub struct Scratch {
    models: Box<Models>,
    /// Per pixel in row order, and one more: index of its first span. Valid up to the pixel in work.
    first: Box<[u32]>,
    spans: Vec<Coded>,
    /// Per end and step: 0, or 1 + how far the height lay off the usual one when the step came last [1..=3].
    last_off: Box<[[u8; 1 << 14]; 2]>,
    encoder: RansEncoder,
    column: Vec<Span>,
    heights: Vec<(u32, End)>,
}

impl Scratch {
    /// Bytes that decoding a page of `spans` spans takes, if as many were [reserved](Self::reserve).
    pub fn decoding_bytes(spans: usize) -> usize {
        // The lists besides are for encoding, but for that of a column, which grows by doubling.
        let column = 3 * (MAX_COLUMN as usize + 1) * size_of::<Span>();
        size_of::<Models>() + (PIXELS + 1) * size_of::<u32>() + 2 * (1 << 14) + spans * size_of::<Coded>() + column
    }

    /// Makes room for `spans` spans.
    pub fn reserve(&mut self, spans: usize) {
        self.spans.reserve_exact(spans);
    }
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
            heights: Vec::new(),
        }
    }
}

/// A walk over a page, with its coder.
pub(super) struct Traversal<'a, C> {
    coder: C,
    pub lattice: Lattice,
    models: &'a mut Models,
    last_off: &'a mut [[u8; 1 << 14]; 2],
}

/// A height of a span: the quantum and the step.
type Height = (u32, u32);

impl<C> Traversal<'_, C> {
    /// What a height of `end` would take (1/64 bit) near step `expected`, which steps of `context` code: a step, and how far
    /// the height lies off its usual one; or a slice boundary.
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
        if !self.lattice.is_quanta() {
            let last = self.last_off[side][index as usize];
            cost += self.models.off[side][last as usize].cost(off != 0);
            cost += if off != 0 { COST_BIT } else { 0 };
        }
        cost
    }
}

impl<C: Coder> Traversal<'_, C> {
    /// Which blocks have matter, and which in all pixels, as masks.
    fn blocks(&mut self, given: (u64, u64)) -> (u64, u64) {
        let (mut matter, mut full) = (0u64, 0u64);
        for block in 0..64 {
            let kind = |exists: bool, back: u32| {
                if exists { (matter >> (block - back) & 1) as usize + (full >> (block - back) & 1) as usize } else { 0 }
            };
            let context = kind(block % 8 > 0, 1) * 3 + kind(block >= 8, 8);
            if self.coder.bit(&mut self.models.matter[context], given.0 >> block & 1 == 1) {
                matter |= 1 << block;
                full |= (self.coder.bit(&mut self.models.full[context], given.1 >> block & 1 == 1) as u64) << block;
            }
        }
        (matter, full)
    }

    /// Spans of a pixel with matter; 0 or more than 64 if the bytes are wrong.
    fn count(&mut self, west: u32, north: u32, given: u32) -> u32 {
        let model = &mut self.models.count[(west.min(3) * 4 + north.min(3)) as usize];
        let mut count = 1;
        loop {
            let more = self.coder.nibble(model, given.wrapping_sub(count).min(15));
            count += more;
            if more < 15 || count > MAX_COLUMN {
                return count;
            }
        }
    }

    /// A height near step `expected`, which steps of `context` code; `given` is the height to write.
    #[inline]
    fn height(&mut self, end: End, context: usize, expected: i32, given: Option<u32>) -> Height {
        let side = end as usize;
        let on_step = given.map(|height| self.lattice.index(height, end));
        let (index, off) = on_step.flatten().unwrap_or((0, 0));
        let residual = match on_step {
            Some(None) => None,
            _ => Some(fold(index as i32 - expected)),
        };
        let models = match end {
            End::Bottom => &mut self.models.bottom[..],
            End::Top => &mut self.models.thickness[..],
        };
        let length = self.coder.nibble(&mut models[context], residual.map_or(15, bits));
        if length == 15 {
            // Cut at a slice boundary, between the steps. Other heights all have steps, or the lattice would not be theirs.
            debug_assert!(given.is_none_or(|height| height.is_multiple_of(SLICE)), "no step for {given:?} {end:?}");
            let height = self.coder.raw(7, given.unwrap_or(0) / SLICE) * SLICE;
            return (height, self.lattice.at_or_above(height));
        }
        let residual = residual.unwrap_or(0);
        let mut folded = (length > 0) as u32;
        if length > 1 {
            let second = &mut self.models.second[side][length as usize];
            folded = 2 | self.coder.bit(second, residual >> (length - 2) & 1 == 1) as u32;
        }
        if length > 2 {
            let rest = length - 2;
            folded = folded << rest | self.coder.raw(rest, residual & ((1 << rest) - 1));
        }
        let index = (expected + unfold(folded)) as u32 & 0x3FFF;
        let usual = self.lattice.usual(index, end);
        if self.lattice.is_quanta() {
            return (usual as u32, index);
        }
        let last = &mut self.last_off[side][index as usize];
        let mut off_now = 0;
        if self.coder.bit(&mut self.models.off[side][*last as usize], off != 0) {
            off_now = if self.coder.bit(&mut self.models.up[side], off > 0) { 1 } else { -1 };
        }
        *last = if off_now == 0 { 1 } else { 2 };
        ((usual + off_now) as u32, index)
    }
}

/// Folds the sign of `difference`, taken modulo 2¹⁴, into the lowest bit: 0..2¹⁴.
#[inline]
pub(super) fn fold(difference: i32) -> u32 {
    let difference = difference << 18 >> 18;
    (difference << 1 ^ difference >> 31) as u32
}

/// Inverse of [`fold`].
#[inline]
pub(super) fn unfold(folded: u32) -> i32 {
    (folded >> 1) as i32 ^ -((folded & 1) as i32)
}

/// Where the values of a walk come from.
pub(super) trait Given<'a> {
    /// Blocks with matter, blocks with matter in all pixels.
    fn blocks(&self) -> (u64, u64);
    /// The spans of a pixel; all pixels of blocks with matter are asked for in row order.
    fn spans(&mut self, px: u32, py: u32) -> &'a [Span];
    /// `span`, the one of number `_at.1` in pixel `_at.0`, or what it is to be in its place.
    #[inline]
    fn chosen<C>(&self, span: Span, _at: (usize, usize), _: &Candidates, _: &Traversal<'_, C>) -> Span {
        span
    }
    /// Whether the walk goes on with a row of pixels; `cost` tells what the rows before it take (1/64 bit).
    #[inline]
    fn goes_on(&mut self, _row: u32, _cost: impl FnOnce() -> u64) -> bool {
        true
    }
}

/// For decoding: nothing.
impl<'a> Given<'a> for () {
    fn blocks(&self) -> (u64, u64) {
        (0, 0)
    }

    #[inline]
    fn spans(&mut self, _: u32, _: u32) -> &'a [Span] {
        &[]
    }
}

/// A page to write.
pub(super) struct Rows<'a> {
    page: &'a Page,
    /// Spans of the block's row in work that are still to come.
    rest: &'a [Span],
    /// Which row that is.
    row: (u32, u32),
}

impl<'a> Rows<'a> {
    pub fn of(page: &'a Page) -> Self {
        Self { page, rest: &[], row: (u32::MAX, 0) }
    }

    /// The spans of a pixel with matter; all such pixels are asked for in row order.
    #[inline]
    pub fn at(&mut self, px: u32, py: u32) -> &'a [Span] {
        let row = (px / BLOCK_PIXELS, py);
        if row != self.row {
            self.row = row;
            self.rest = self.page.block(row.0, py / BLOCK_PIXELS).rows(py % BLOCK_PIXELS, py % BLOCK_PIXELS);
        }
        self.next(px % BLOCK_PIXELS)
    }

    /// The spans of the next pixel, of this lane.
    #[inline]
    fn next(&mut self, lane: u32) -> &'a [Span] {
        let count = self.rest.iter().take_while(|span| span.lane() == lane).count();
        let (own, rest) = self.rest.split_at(count);
        self.rest = rest;
        own
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

/// Which of the six pixels before the one in work have matter.
#[derive(Default)]
struct Before {
    /// West 2, west.
    west: u64,
    /// Of the row to the north, the pixel to the west, and the others from the one in work on.
    north_west: u64,
    north: u64,
    /// The next row to the north, from the pixel in work on.
    north_2: u64,
}

impl Before {
    /// Before the first pixel of a row, under two others.
    fn row(north: u64, north_2: u64) -> Self {
        Self { north, north_2, ..Self::default() }
    }

    /// West 2, west, north-west, north, north-east, north 2, from the lowest bit up.
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

    /// Passes the row of a block without matter.
    fn pass_block(&mut self) {
        self.west = 0;
        self.north_west = self.north >> (BLOCK_PIXELS - 1) & 1;
        (self.north, self.north_2) = (self.north >> BLOCK_PIXELS, self.north_2 >> BLOCK_PIXELS);
    }
}

/// Walks over the page that `given` tells or the coder reads, and hands each pixel's spans to `give`.
pub(super) fn walk<'a, C: Coder>(
    coder: C,
    lattice: Lattice,
    scratch: &mut Scratch,
    mut given: impl Given<'a>,
    mut give: impl FnMut(u32, u32, &[Span]) -> Result<(), Violation>,
) -> Result<C, Violation> {
    let Scratch { models, first, spans, last_off, column, .. } = scratch;
    **models = FRESH;
    if !lattice.is_quanta() {
        last_off.iter_mut().for_each(|end| end.fill(0));
    }
    spans.clear();
    let mut traversal = Traversal { coder, lattice, models, last_off };
    let (matter, full) = traversal.blocks(given.blocks());
    if matter == 0 {
        return Err(Violation::new("P6", "matter in some pixel", "none"));
    }
    // Rows of pixels with matter: the one in work and the one before.
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
        if matter >> block & 1 == 0 {
            let end = pixel + BLOCK_PIXELS as usize;
            first[pixel + 1..=end].fill(spans.len() as u32);
            before.pass_block();
            pixel = end;
            continue;
        }
        let given_spans = given.spans(px, py);
        let has_matter = full >> block & 1 == 1 || {
            let model = &mut traversal.models.pixel[before.context()];
            traversal.coder.bit(model, !given_spans.is_empty())
        };
        before.pass(has_matter);
        if has_matter {
            row |= 1 << px;
            let mut around = neighbours(first, pixel);
            let [west, north, ..] = &around;
            let count = traversal.count(west.len() as u32, north.len() as u32, given_spans.len() as u32);
            if count > MAX_COLUMN {
                return Err(Violation::new("P7", "1 to 64 spans in an occupied pixel", count));
            }
            column.clear();
            let mut below = None;
            for index in 0..count as usize {
                let candidates = candidates(spans, &mut around, below);
                let span = given_spans.get(index);
                let span = span.map(|&span| given.chosen(span, (pixel, index), &candidates, &traversal));
                let (bottom, bottom_step) = traversal.height(
                    End::Bottom,
                    candidates.bottom_context(),
                    candidates.bottom,
                    span.map(|span| span.bottom()),
                );
                let (top, top_step) = traversal.height(
                    End::Top,
                    candidates.thickness_context(),
                    bottom_step as i32 + candidates.thickness,
                    span.map(|span| span.top()),
                );
                let thick = top.saturating_sub(bottom) > SLICE / 4;
                let context = candidates.kind_context() * 2 + thick as usize;
                let obstacle = traversal
                    .coder
                    .bit(&mut traversal.models.kind[context], span.is_some_and(|span| span.is_obstacle()));
                let span = Span::new(bottom, top, obstacle)
                    .ok_or_else(|| Violation::new("P8", "a span inside the page", format!("{bottom}..={top}")))?;
                column.push(span);
                let coded = Coded {
                    bottom: bottom as u16,
                    top: top as u16,
                    bottom_step: bottom_step as u16,
                    top_step: top_step as u16,
                    obstacle,
                };
                spans.push(coded);
                below = Some(coded);
            }
            give(px, py, column)?;
        }
        pixel += 1;
        first[pixel] = spans.len() as u32;
    }
    Ok(traversal.coder)
}

/// The heights of `page` that say which steps it has.
pub(super) fn telling_heights(page: &Page, heights: &mut Vec<(u32, End)>) {
    heights.clear();
    for spans in page.spans_of_blocks() {
        heights.extend(spans.iter().flat_map(|span| [(span.bottom(), End::Bottom), (span.top(), End::Top)]));
    }
    // Heights on slice boundaries may be those of cuts, and say nothing.
    heights.retain(|(height, _)| height % SLICE != 0);
}

fn lattice_of(of: &HeightsOf, steps: &[u64], page: &Page, heights: &mut Vec<(u32, End)>) -> Lattice {
    telling_heights(page, heights);
    Lattice::find(of, steps, heights).unwrap_or(Lattice::QUANTA)
}

/// Appends the encoding of `page`, at most [`MAX_LEN`] bytes; `steps` (1/2³² quantum) are looked for first.
pub fn encode(of: &HeightsOf, steps: &[u64], page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    let lattice = lattice_of(of, steps, page, &mut scratch.heights);
    code(lattice, page, scratch);
    scratch.encoder.finish(out);
}

/// What the symbols of `page` take on `lattice` (1/64 bit).
pub(super) fn length_on(lattice: Lattice, page: &Page, scratch: &mut Scratch) -> u64 {
    code(lattice, page, scratch);
    scratch.encoder.cost()
}

/// Leaves the symbols of `page` in the encoder of `scratch`.
fn code(lattice: Lattice, page: &Page, scratch: &mut Scratch) {
    let mut encoder = std::mem::take(&mut scratch.encoder);
    encoder.clear();
    code_lattice(&mut encoder, lattice);
    let walked = walk(encoder, lattice, scratch, Rows::of(page), |_, _, _| Ok(()));
    debug_assert!(walked.is_ok(), "a page holds matter");
    scratch.encoder = walked.unwrap_or_default();
}

/// Codes what `given` chooses on the lattice of `tried`: its spans, and their symbols.
pub(super) fn choose<'a>(given: impl Given<'a>, tried: &mut Tried, scratch: &mut Scratch) {
    let Tried { lattice, encoder, spans } = tried;
    let mut coder = std::mem::take(encoder);
    coder.clear();
    spans.clear();
    code_lattice(&mut coder, *lattice);
    let walked = walk(coder, *lattice, scratch, given, |_, _, column| {
        spans.extend_from_slice(column);
        Ok(())
    });
    debug_assert!(walked.is_ok(), "chosen spans lie inside the page");
    *encoder = walked.unwrap_or_default();
}

/// Appends the encoding of `page`, which has just been chosen as `tried`, as [`encode`] does.
pub(super) fn encode_chosen(
    of: &HeightsOf,
    steps: &[u64],
    page: &Page,
    tried: &mut Tried,
    scratch: &mut Scratch,
    out: &mut Vec<u8>,
) {
    let found = lattice_of(of, steps, page, &mut scratch.heights);
    // Found in the heights, a phase may differ a little from the one they were chosen on.
    let borders = (0..=PAGE_QUANTA as u32).step_by(SLICE as usize).flat_map(|at| [(at, End::Bottom), (at, End::Top)]);
    let mut heights = scratch.heights.iter().copied().chain(borders);
    let step = |lattice: &Lattice, height, end| (lattice.index(height, end), lattice.at_or_above(height));
    let is_same = |(height, end)| step(&found, height, end) == step(&tried.lattice, height, end);
    if !(found.is_like(&tried.lattice) || found.step == tried.lattice.step && heights.all(is_same)) {
        return encode(of, steps, page, scratch, out);
    }
    let mut head = RansEncoder::default();
    code_lattice(&mut head, found);
    tried.encoder.replace_first(&head);
    tried.encoder.finish(out);
}

/// A bit that says whether there is a lattice, then its step and phase, 10 bits at a time, highest first.
fn code_lattice(coder: &mut impl Coder, given: Lattice) -> Option<Lattice> {
    if coder.raw(1, !given.is_quanta() as u32) == 0 {
        return Some(Lattice::QUANTA);
    }
    let mut number = |given: u64| {
        let part = |at: u32| (given >> at & 0x3FF) as u32;
        (0..LATTICE_BITS / 10).rev().fold(0, |number, at| number << 10 | u64::from(coder.raw(10, part(10 * at))))
    };
    let (step, phase) = (number(given.step), number(given.phase));
    Lattice::new(step, phase)
}

/// Fills `builder`, which must be empty, from the encoding `body`.
pub fn decode(body: &[u8], scratch: &mut Scratch, builder: &mut PageBuilder) -> Result<(), Violation> {
    let mut decoder = RansDecoder::new(body, "P6")?;
    let lattice = code_lattice(&mut decoder, Lattice::QUANTA)
        .ok_or_else(|| Violation::new("P7", "steps of 2 to 255 quanta, above their phase", "others"))?;
    let decoder = walk(decoder, lattice, scratch, (), |px, py, spans| {
        let apart = || Violation::new("P8", "spans apart, lowest first", format!("{spans:?} in pixel ({px}, {py})"));
        builder.set_column(px, py, spans).then_some(()).ok_or_else(apart)
    })?;
    decoder.finish("P6")
}

#[cfg(test)]
pub(crate) mod tests;
