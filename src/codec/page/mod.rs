//! Page coding: spans predicted from their neighbours, coded with two interleaved rANS states (specification, chapter
//! 6).
//!
//! Occupied pixels come first, then pixel by pixel their spans. Four neighbours are combined for bottoms and
//! thicknesses at once, and a height is one symbol and some raw bits. One walk serves encoder and decoder, compiled for
//! each set of processor features.

mod heights;
mod models;
mod neighbours;
mod pixels;

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
use super::interleaved::Avx2;
use super::interleaved::{Base, InterleavedDecoder, InterleavedEncoder, Lanes, Strands};
use super::rows::{MAX_COLUMN, Rows, SLICE, unfold};
use super::step_grid::{End, StepGrid};
use super::{MAX_PAGE_SPANS, Violation};
use crate::page::{Page, RowBuilder, Span};
use heights::{ALPHABETS, Alphabet, Given, code_grid};
use models::{Models, fresh};
use neighbours::{Seen, expected, pack};

/// Largest encoding (bytes): two states; per span five symbols of at most a word each, and 28 bits; per pixel its
/// occupancy and at most five symbols for its number of spans; per block two symbols; for the grid two numbers of 46
/// bits.
pub const MAX_LEN: usize = 8 + MAX_PAGE_SPANS * (10 + 4) + 2 * (64 * 64 * (1 + 5) + 2 * 64) + 12;

/// Symbol of a slice boundary; its bits are the number of the slice.
const BOUNDARY: u32 = 15;
/// Most spans of a row, with an end marker for each pixel.
const ROW: usize = 64 * (MAX_COLUMN as usize + 1);
/// Number of steps, and a place for heights that have none.
const STEPS: usize = (1 << 14) + 1;
const NO_STEP: usize = 1 << 14;

/// Contribution of a span, and of an obstacle in addition, to the kind context of later neighbours; the context of four
/// stays below 50.
const CANDIDATE: u8 = 2;
const OBSTACLE: u8 = 10;

/// A row of pixels as later pixels see it, with one more pixel on each side.
#[derive(Debug)]
struct Row {
    /// Lowest span of each pixel, and its contribution to kind contexts.
    lowest: [Seen; 66],
    kinds: [u8; 66],
    /// Index of the pixel's first span in [`Scratch::seen`]; from bit 16 on its number of spans, up to 3.
    places: [u32; 66],
}

impl Row {
    const EMPTY: Self = Self { lowest: [Seen::NONE; 66], kinds: [0; 66], places: [0; 66] };
}

/// Lowest spans of the pixels coded last, from which a pixel without neighbours is predicted.
struct Nearest {
    /// [Step and thickness](pack) of the last occupied pixel of each column, with one more column on each side, and its
    /// row.
    columns: [(u32, i32); 66],
    /// Column of the last occupied pixel of the current row; before the first, one that is far away.
    west: i32,
}

impl Nearest {
    /// Farther than all pixels of a page.
    const FAR: i32 = -1 << 16;
    const NONE: Self = Self { columns: [(0, Self::FAR); 66], west: Self::FAR };

    /// Returns step and thickness of the lowest span of the nearest among the pixels coded last in this row and in the
    /// columns in the west, here and in the east; of the first of these if several are as near.
    #[inline(always)]
    fn of(&self, px: usize, py: usize) -> u32 {
        let (west, [a, b, c]) =
            (self.columns[(self.west.max(-1) + 1) as usize], [0, 1, 2].map(|at| self.columns[px + at]));
        let rows = [px as i32 - self.west, py as i32 - a.1 + 1, py as i32 - b.1, py as i32 - c.1 + 1];
        let nearest = rows.iter().zip(0..).fold(i32::MAX, |least, (&distance, at)| least.min(distance << 2 | at));
        [west.0, a.0, b.0, c.0][nearest as usize & 3]
    }

    #[inline(always)]
    fn set(&mut self, px: usize, py: usize, lowest: Seen) {
        self.columns[px + 1] = (lowest.packed(), py as i32);
        self.west = px as i32;
    }
}

/// State of the walk; reused from page to page.
#[derive(Debug)]
pub struct Scratch {
    models: Box<Models>,
    /// Initial models by alphabet, computed at run time: as a constant table they would be a tenth of a browser's
    /// decoder download.
    fresh: Box<[Models; 2]>,
    /// `NONE`, then the spans of the current row of pixels and the one before; and the contribution of each to kind
    /// contexts.
    seen: Box<[Seen; 1 + 2 * ROW]>,
    kinds: Box<[u8; 1 + 2 * ROW]>,
    rows: Box<[Row; 2]>,
    /// Per step of bottoms and of tops: 0 if it has not occurred; else 1 if it last had its usual height, 2 if one
    /// quantum above, 3 if one below.
    last_off: Box<[[u8; STEPS]; 2]>,
    encoder: InterleavedEncoder,
}

impl Scratch {
    /// Returns the memory for decoding (bytes), independent of the page.
    pub fn decoding_bytes() -> usize {
        let spans = size_of::<[Seen; 1 + 2 * ROW]>() + size_of::<[u8; 1 + 2 * ROW]>() + size_of::<[Row; 2]>();
        size_of::<Self>() + 3 * size_of::<Models>() + spans + 2 * STEPS
    }
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            models: Box::new(fresh(0)),
            fresh: Box::new([fresh(0), fresh(1)]),
            seen: Box::new([Seen::NONE; 1 + 2 * ROW]),
            kinds: Box::new([0; 1 + 2 * ROW]),
            rows: Box::new([Row::EMPTY; 2]),
            last_off: Box::new([[0; STEPS]; 2]),
            encoder: InterleavedEncoder::default(),
        }
    }
}

/// Returns the offset from the usual height that an entry of [`Scratch::last_off`] stands for.
#[inline]
fn off_of(last: u8) -> i32 {
    [0, 0, 1, -1][usize::from(last) & 3]
}

/// A coded span.
struct Coded {
    seen: Seen,
    /// Heights (quanta), which may not form a valid span.
    bottom: i32,
    top: i32,
    obstacle: bool,
}

impl Coded {
    /// Returns the span, which comes after the one `below` in its pixel, or the violation of rule P8.
    #[inline(always)]
    fn span(&self, below: Option<Span>) -> Result<Span, Violation> {
        let span = Span::new(self.bottom as u32, self.top as u32, self.obstacle);
        match span.filter(|&span| below.is_none_or(|below| below.lies_below(span))) {
            Some(span) => Ok(span),
            None => Err(Self::violation(self.bottom, self.top, below)),
        }
    }

    #[cold]
    fn violation(bottom: i32, top: i32, below: Option<Span>) -> Violation {
        let found = format!("{bottom}..={top} above {below:?}");
        Violation::new("P8", "spans inside the page and apart, lowest first", found)
    }

    /// Returns its contribution to kind contexts.
    #[inline(always)]
    fn kind(&self) -> u8 {
        CANDIDATE + if self.obstacle { OBSTACLE } else { 0 }
    }
}

/// State for coding spans.
struct Walk<'a, C> {
    coder: C,
    grid: StepGrid,
    is_quanta: bool,
    alphabet: &'static Alphabet,
    models: &'a mut Models,
    last_off: &'a mut [[u8; STEPS]; 2],
    /// [Step and thickness](pack) predicted without candidates.
    without: u32,
}

impl<C: Strands> Walk<'_, C> {
    /// Codes the number of spans of a pixel; `context` holds those of its neighbours. Returns more than 64 for invalid
    /// bytes.
    #[inline(always)]
    fn count(&mut self, context: u32, given: usize) -> u32 {
        let model = &mut self.models.count[context as usize & 15];
        let mut count = 1;
        loop {
            self.coder.refill();
            let more = self.coder.nibble::<1>(model, (given as u32).wrapping_sub(count).min(15));
            count += more;
            if more < 15 || count > MAX_COLUMN {
                return count;
            }
        }
    }

    /// Codes the next span of a pixel. `kinds` is the kind context of its candidates, `near`. Takes three symbols, or
    /// refills.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn span(&mut self, near: [Seen; 4], kinds: u8, given: Option<&Span>) -> Coded {
        let Self { coder, grid, alphabet, models, last_off, .. } = self;
        let expected = expected(near, self.without);
        // Values to write, if encoding.
        let [mut bottom_given, mut top_given] = [Given::default(); 2];
        let (mut bottom_symbol, mut top_symbol) = ((0, 0), (0, 0));
        if let Some(span) = given {
            bottom_given = Given::of(grid, span.bottom(), End::Bottom);
            top_given = Given::of(grid, span.top(), End::Top);
            bottom_symbol = bottom_given.symbol(alphabet, expected.low);
            let step = bottom_given.step.map_or_else(|| grid.at_or_above(span.bottom()), |step| step.0);
            top_symbol = top_given.symbol(alphabet, step as i32 + expected.thick);
        }
        let of_bottom = coder.nibble::<0>(&mut models.bottom[expected.low_context & 15], bottom_symbol.0);
        let of_top = coder.nibble::<1>(&mut models.thickness[expected.thick_context], top_symbol.0);
        let [bottom_bits, top_bits] = [of_bottom, of_top].map(|symbol| u32::from(alphabet.bits[symbol as usize & 15]));
        let both = coder.raw(bottom_bits + top_bits, bottom_symbol.1 | top_symbol.1 << bottom_bits);
        let least = |symbol: u32| u32::from(alphabet.least[symbol as usize & 15]);
        let bottom_residual = least(of_bottom) + (both & ((1 << bottom_bits) - 1));
        let top_residual = least(of_top) + (both >> bottom_bits);
        let mut bottom_step = (expected.low + unfold(bottom_residual)) & 0x3FFF;
        let top_of = |bottom_step| (bottom_step + expected.thick + unfold(top_residual)) & 0x3FFF;
        let mut top_step = top_of(bottom_step);
        let (mut bottom, mut top) = (bottom_step, top_step);
        if !self.is_quanta || of_bottom == BOUNDARY || of_top == BOUNDARY {
            // A boundary has no step to remember.
            let (mut bottom_place, mut top_place) = (bottom_step as usize & 0x3FFF, NO_STEP);
            bottom = grid.usual(bottom_step as u32, End::Bottom);
            if of_bottom == BOUNDARY {
                bottom = (bottom_residual * SLICE) as i32;
                bottom_step = grid.at_or_above(bottom as u32) as i32;
                bottom_place = NO_STEP;
                top_step = top_of(bottom_step);
            }
            if of_top == BOUNDARY {
                top = (top_residual * SLICE) as i32;
                top_step = grid.at_or_above(top as u32) as i32;
            } else {
                top = grid.usual(top_step as u32, End::Top);
                top_place = top_step as usize & 0x3FFF;
            }
            if grid.is_rounded {
                let [off_bottoms, off_tops] = &mut **last_off;
                let (last_bottom, last_top) = (off_bottoms[bottom_place], off_tops[top_place]);
                let mut off = (off_of(last_bottom), off_of(last_top));
                let given = (bottom_given.off(), top_given.off());
                let context = usize::from(last_bottom << 2 | last_top) & 15;
                let is_surprise = coder.bit::<1>(&mut models.surprise[context], given != off);
                coder.refill();
                if is_surprise {
                    let both = coder.nibble::<1>(&mut models.off, (given.0 * 3 + given.1 + 4) as u32).min(8) as i32;
                    off = (both / 3 - 1, both % 3 - 1);
                }
                let known = |off: i32| [3, 1, 2][(off + 1) as usize & 3];
                (off_bottoms[bottom_place], off_tops[top_place]) = (known(off.0), known(off.1));
                (off_bottoms[NO_STEP], off_tops[NO_STEP]) = (0, 0);
                (bottom, top) = (bottom + off.0, top + off.1);
            }
        }
        let thick = top_step - bottom_step;
        // A pixel's next span lies above this one.
        self.without = pack(top_step, thick);
        let is_thick = top - bottom > SLICE as i32 / 4;
        let model = &mut models.kind[usize::from(kinds + u8::from(is_thick)) & 63];
        let obstacle = coder.bit::<0>(model, given.is_some_and(|span| span.is_obstacle()));
        Coded { seen: Seen::new(bottom_step, thick, bottom), bottom, top, obstacle }
    }
}

/// Walks over `page`, or the page that `coder` reads, and passes each span to `taker`.
#[inline(always)]
fn walk<C: Strands>(
    mut coder: C,
    grid: StepGrid,
    scratch: &mut Scratch,
    page: Option<&Page>,
    mut taker: impl Sink,
) -> Result<C, Violation> {
    let Scratch { models, fresh, seen, kinds, rows: row_pair, last_off, .. } = scratch;
    let steps = usize::from(!grid.is_quanta());
    (**models).clone_from(&fresh[steps]);
    if grid.is_rounded {
        last_off.iter_mut().for_each(|end| end.fill(0));
    }
    let rows = pixels::occupancy(&mut coder, models, page)?;
    taker.begin(&rows);
    let mut given = page.map(Rows::of);
    let mut walk =
        Walk { coder, grid, is_quanta: steps == 0, alphabet: &ALPHABETS[steps], models, last_off, without: 0 };
    let mut nearest = Nearest::NONE;
    **row_pair = [Row::EMPTY; 2];
    for (py, &row) in rows.iter().enumerate() {
        let [even, odd] = &mut **row_pair;
        let (own, north) = if py % 2 == 0 { (even, &*odd) } else { (odd, &*even) };
        *own = Row::EMPTY;
        nearest.west = Nearest::FAR;
        let mut next = 1 + py % 2 * ROW;
        let mut pixels = row;
        while pixels != 0 {
            let px = pixels.trailing_zeros() as usize & 63;
            pixels &= pixels - 1;
            let spans: &[Span] =
                if C::WRITES { given.as_mut().map_or(&[], |rows| rows.at(px as u32, py as u32)) } else { &[] };
            let count = walk.count(own.places[px] >> 16 << 2 | north.places[px + 1] >> 16, spans.len());
            if count > MAX_COLUMN {
                return Err(Violation::new("P7", "1 to 64 spans in an occupied pixel", count));
            }
            own.places[px + 1] = next as u32 | count.min(3) << 16;
            let near = [own.lowest[px], north.lowest[px], north.lowest[px + 1], north.lowest[px + 2]];
            let candidates = own.kinds[px] + north.kinds[px] + north.kinds[px + 1] + north.kinds[px + 2];
            if candidates == 0 {
                walk.without = nearest.of(px, py);
            }
            let coded = walk.span(near, candidates, spans.first());
            nearest.set(px, py, coded.seen);
            (seen[next], kinds[next]) = (coded.seen, coded.kind());
            (own.lowest[px + 1], own.kinds[px + 1]) = (coded.seen, coded.kind());
            next += 1;
            let mut below = coded.span(None)?;
            taker.take(px as u32, below);
            if count > 1 {
                let places = [own.places[px], north.places[px], north.places[px + 1], north.places[px + 2]];
                let mut places = places.map(|place| place as usize & 0xFFFF);
                for index in 1..count {
                    // Pass the neighbours' spans that the one below rules out; usually one in each.
                    for place in &mut places {
                        *place += usize::from(seen[*place].bottom() <= below.top() as i32);
                        while seen[*place].bottom() <= below.top() as i32 {
                            *place += 1;
                        }
                    }
                    let candidates = places.iter().map(|&place| kinds[place]).sum();
                    walk.coder.refill();
                    let near = places.map(|place| seen[place]);
                    let coded = walk.span(near, candidates, spans.get(index as usize));
                    (seen[next], kinds[next]) = (coded.seen, coded.kind());
                    next += 1;
                    below = coded.span(Some(below))?;
                    taker.take(px as u32, below);
                }
            }
            (seen[next], kinds[next]) = (Seen::NONE, 0);
            next += 1;
            taker.end_pixel(px as u32, py as u32);
        }
    }
    Ok(walk.coder)
}

/// Receives what a walk finds.
trait Sink {
    /// Begins a page with these occupied pixels, one mask per row.
    fn begin(&mut self, rows: &[u64; 64]);
    /// Receives the next span of the pixel with this x.
    fn take(&mut self, px: u32, span: Span);
    /// Ends the pixel.
    fn end_pixel(&mut self, px: u32, py: u32);
}

/// For encoding, where the spans are known.
impl Sink for () {
    fn begin(&mut self, _: &[u64; 64]) {}

    #[inline(always)]
    fn take(&mut self, _: u32, _: Span) {}

    #[inline(always)]
    fn end_pixel(&mut self, _: u32, _: u32) {}
}

impl Sink for &mut RowBuilder {
    fn begin(&mut self, rows: &[u64; 64]) {
        RowBuilder::begin(self, *rows);
    }

    #[inline(always)]
    fn take(&mut self, px: u32, span: Span) {
        self.push(px, span);
    }

    #[inline(always)]
    fn end_pixel(&mut self, px: u32, py: u32) {
        RowBuilder::end_pixel(self, px, py);
    }
}

/// Appends the encoding of `page` with heights on `grid`, at most [`MAX_LEN`] bytes.
pub fn encode(grid: StepGrid, page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    #[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
    if let Some(lanes) = Avx2::detect() {
        // SAFETY: the processor has the features that the function requires.
        return unsafe { encode_avx2(lanes, grid, page, scratch, out) };
    }
    encode_with(Base, grid, page, scratch, out);
}

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn encode_avx2(lanes: Avx2, grid: StepGrid, page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    encode_with(lanes, grid, page, scratch, out);
}

#[inline(always)]
fn encode_with(lanes: impl Lanes, grid: StepGrid, page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    let mut encoder = std::mem::take(&mut scratch.encoder).with_lanes(lanes);
    encoder.clear();
    code_grid(&mut encoder, grid);
    if let Ok(mut encoder) = walk(encoder, grid, scratch, Some(page), ()) {
        encoder.finish(out);
        scratch.encoder = encoder.with_lanes(Base);
    }
}

/// Decodes `body` into `builder` (rules P6 to P8).
pub fn decode(body: &[u8], scratch: &mut Scratch, builder: &mut RowBuilder) -> Result<(), Violation> {
    #[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
    if let Some(lanes) = Avx2::detect() {
        // SAFETY: the processor has the features that the function requires.
        return unsafe { decode_avx2(lanes, body, scratch, builder) };
    }
    decode_with(Base, body, scratch, builder)
}

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn decode_avx2(lanes: Avx2, body: &[u8], scratch: &mut Scratch, builder: &mut RowBuilder) -> Result<(), Violation> {
    decode_with(lanes, body, scratch, builder)
}

#[inline(always)]
fn decode_with(
    lanes: impl Lanes,
    body: &[u8],
    scratch: &mut Scratch,
    builder: &mut RowBuilder,
) -> Result<(), Violation> {
    let mut decoder = InterleavedDecoder::new(body, lanes, "P6")?;
    let grid = code_grid(&mut decoder, StepGrid::QUANTA)
        .ok_or_else(|| Violation::new("P7", "steps of 2 to 255 quanta, above their phase", "others"))?;
    walk(decoder, grid, scratch, None, builder)?.finish("P6")
}
