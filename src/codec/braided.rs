//! Model 3, `braided`: the spans of a page as [`super::adaptive`] foretells them, in an order and in symbols that take a processor a third of
//! the time (specification, section 6.7).
//!
//! First which pixels have matter, then pixel by pixel their spans. What four neighbours say is weighed for bottoms and thicknesses
//! at once, and a height is one symbol and some bits as they are. One walk serves encoder and decoder.

use super::adaptive::{MAX_COLUMN, Rows, SLICE, fold, unfold};
use super::braid::{Bit, BraidDecoder, BraidEncoder, Nibble, Strands};
use super::lattice::{End, Lattice};
use super::{MAX_PAGE_SPANS, Violation};
use crate::slice::{Page, RowBuilder, Span};

/// Greatest length of an encoding (bytes): states; of a span five symbols of at most a word, and 28 bits; of a pixel whether it has
/// matter, and its spans in five symbols or fewer; of a block two symbols; of the lattice two numbers of 46 bits.
pub const MAX_LEN: usize = 8 + MAX_PAGE_SPANS * (10 + 4) + 2 * (64 * 64 * (1 + 5) + 2 * 64) + 12;

/// Residuals that a symbol stands for: the least, and how many bits say which.
struct Alphabet {
    least: [u16; 16],
    bits: [u8; 16],
}

/// Symbol of a slice boundary; its bits are the number of the slice.
const BOUNDARY: u32 = 15;
/// Where every quantum is a step, and where not: few steps have small residuals.
static ALPHABETS: [Alphabet; 2] = [
    Alphabet {
        least: [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 0],
        bits: [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 7],
    },
    Alphabet {
        least: [0, 1, 2, 3, 4, 6, 8, 16, 32, 64, 128, 256, 512, 1024, 4096, 0],
        bits: [0, 0, 0, 0, 1, 1, 3, 4, 5, 6, 7, 8, 9, 12, 14, 7],
    },
];

impl Alphabet {
    /// Symbol of a folded residual.
    #[inline]
    fn symbol(&self, residual: u32) -> u32 {
        let bits = u32::BITS - residual.leading_zeros();
        // No symbol stands for more than one length below 1024, nor for less than half of one.
        let mut symbol = bits.min(14);
        while symbol > 0 && u32::from(self.least[symbol as usize]) > residual {
            symbol -= 1;
        }
        while symbol < 14 && u32::from(self.least[symbol as usize + 1]) <= residual {
            symbol += 1;
        }
        symbol
    }
}

/// Weights around the most common symbol of a height, at 15.
const SHAPE: [u16; 31] =
    [8, 8, 8, 8, 8, 8, 8, 8, 12, 16, 20, 35, 60, 110, 210, 300, 110, 45, 20, 12, 8, 6, 4, 3, 2, 2, 2, 2, 2, 2, 2];
/// The most common symbol of a bottom, by context, and of a thickness, by its class, where it is not 0.
const BOTTOM_PEAKS: [[usize; 16]; 2] =
    [[9, 6, 4, 6, 7, 9, 9, 9, 3, 3, 4, 5, 6, 6, 8, 10], [8, 6, 2, 7, 8, 11, 9, 9, 1, 2, 5, 6, 8, 9, 10, 12]];
const THICKNESS_PEAKS: [[usize; 8]; 2] = [[0, 3, 5, 6, 7, 8, 9, 11], [0, 6, 7, 8, 9, 10, 11, 12]];
/// Weights of thicknesses where thin ones are expected.
const THIN: [[u16; 16]; 2] = [
    [450, 30, 60, 60, 60, 70, 80, 80, 70, 50, 30, 15, 6, 3, 2, 2],
    [300, 95, 95, 45, 60, 30, 85, 80, 70, 50, 35, 30, 20, 5, 2, 5],
];
/// Weights of numbers of spans, by the greater of those in the west and north: up to 1, 2, 3 or more.
const COUNTS: [[u16; 16]; 3] = [
    [880, 80, 20, 6, 3, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1],
    [450, 390, 100, 30, 10, 5, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1],
    [200, 280, 240, 120, 60, 35, 20, 10, 5, 2, 1, 1, 1, 1, 1, 1],
];
/// By how many of six pixels before have matter.
const PIXELS_BEFORE: [u16; 7] = [3300, 8500, 17000, 19500, 21500, 24000, 28000];
const RARE: u16 = 1 << 10;

/// Everything that learns. Made anew for each page, so that a page can be read alone.
#[derive(Debug, Clone)]
struct Models {
    count: [Nibble; 16],
    bottom: [Nibble; 16],
    thickness: [Nibble; 80],
    /// How heights lie off the usual ones of their steps: three ways of the bottom, three of the top.
    off: Nibble,
    /// By the kinds of the blocks in the west and north: matter at all, and in all pixels.
    matter: [Bit; 9],
    full: [Bit; 9],
    /// By the six pixels before.
    pixel: [Bit; 64],
    /// Whether heights lie otherwise off their steps than when these came last, by what is known of the steps.
    surprise: [Bit; 16],
    /// By obstacles among the candidates, number of candidates, and whether the span is thick.
    kind: [Bit; 50],
}

fn around(peak: usize) -> Nibble {
    let (mut weights, mut symbol) = ([2; 16], 0);
    while symbol < BOUNDARY as usize {
        weights[symbol] = SHAPE[15 + symbol - peak];
        symbol += 1;
    }
    Nibble::new(weights)
}

/// Models as pages of nine scans have them in the mean.
fn fresh(steps: usize) -> Models {
    const UNSET: Nibble = Nibble::new([1; 16]);
    const RARELY: Bit = Bit::new(RARE);
    let mut models = Models {
        count: [UNSET; 16],
        bottom: [UNSET; 16],
        thickness: [Nibble::new(THIN[steps]); 80],
        off: UNSET,
        matter: [RARELY; 9],
        full: [RARELY; 9],
        pixel: [RARELY; 64],
        surprise: [RARELY; 16],
        kind: [RARELY; 50],
    };
    let mut at = 0;
    while at < 80 {
        if at < 9 {
            models.matter[at] = Bit::new(match at / 3 + at % 3 {
                0 => 2600,
                1 => 21500,
                _ => 31000,
            });
            models.full[at] = Bit::new(match at {
                8 => 29000,
                2 | 6 => 23000,
                5 | 7 => 12500,
                _ => 1500,
            });
        }
        if at < 16 {
            let most = if at / 4 > at % 4 { at / 4 } else { at % 4 };
            models.count[at] = Nibble::new(COUNTS[most.saturating_sub(1)]);
            models.bottom[at] = around(BOTTOM_PEAKS[steps][at]);
        }
        if at < 50 {
            let (obstacles, candidates) = (at / 10, at / 2 % 5);
            let thin = (2 * obstacles + 1) << 15;
            let thick = (2 * obstacles + 3) << 15;
            let ones = if at % 2 == 0 { thin / (4 * candidates + 8) } else { thick / (2 * candidates + 4) };
            models.kind[at] = Bit::new(if ones > 32000 { 32000 } else { ones as u16 });
        }
        if at < 64 {
            models.pixel[at] = Bit::new(PIXELS_BEFORE[at.count_ones() as usize]);
        }
        if at >= 10 {
            models.thickness[at] = around(THICKNESS_PEAKS[steps][at / 10]);
        }
        at += 1;
    }
    models
}

/// A span as those after it see it: step of its bottom, thickness in steps, bottom (quanta), and 256, or 257 for an obstacle.
type Seen = [i16; 4];
/// Ends the spans of a pixel: lies above every span, and is none.
const NONE: Seen = [i16::MAX, i16::MAX, i16::MAX, 0];
/// Most spans of a row, each pixel's with an end.
const ROW: usize = 64 * (MAX_COLUMN as usize + 1);

/// What the walk remembers; reused from page to page.
#[derive(Debug)]
pub struct Scratch {
    models: Box<Models>,
    /// New models by alphabet; a table of them would be a tenth of what a browser loads for a decoder.
    fresh: Box<[Models; 2]>,
    /// `NONE`, then the spans of two rows of pixels, the one in work and the one before.
    seen: Box<[Seen; 1 + 2 * ROW]>,
    /// Per step, of bottoms and tops: 0, or 1 and how the height lay off the usual one when the step came last (1 above, 2 below).
    last_off: Box<[[u8; 1 << 14]; 2]>,
    encoder: BraidEncoder,
}

impl Scratch {
    /// Bytes that decoding takes, whatever the page.
    pub fn decoding_bytes() -> usize {
        size_of::<Self>() + 3 * size_of::<Models>() + size_of::<[Seen; 1 + 2 * ROW]>() + 2 * (1 << 14)
    }
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            models: Box::new(fresh(0)),
            fresh: Box::new([fresh(0), fresh(1)]),
            seen: Box::new([NONE; 1 + 2 * ROW]),
            last_off: Box::new([[0; 1 << 14]; 2]),
            encoder: BraidEncoder::default(),
        }
    }
}

/// Class of a number by its bits, as in the adaptive model.
const CLASSES: [u8; 16] = [0, 0, 0, 1, 2, 3, 4, 5, 6, 6, 7, 7, 7, 7, 7, 7];
/// Contexts by the number of candidates and the bits of their spread: of bottoms, and the last part of that of thicknesses.
static CONTEXTS: [[[u8; 16]; 5]; 2] = {
    let (mut contexts, mut at) = ([[[0; 16]; 5]; 2], 0);
    while at < 80 {
        let (count, class) = (at / 16, CLASSES[at % 16]);
        contexts[0][count][at % 16] = match count {
            0 | 1 => count as u8,
            2 => 2 + class / 2,
            _ => 8 + class,
        };
        contexts[1][count][at % 16] = if count < 2 { count as u8 } else { 2 + class };
        at += 1;
    }
    contexts
};

/// Number of bits of a number below 2¹⁵.
#[inline(always)]
fn bits(value: u32) -> usize {
    (u32::BITS - value.leading_zeros()) as usize & 15
}

/// What the candidates say: step of the bottom and thickness that are expected, how far the candidates spread in these, how many
/// there are, and how many of them are obstacles.
struct Expected {
    low: i32,
    thick: i32,
    low_spread: u32,
    thick_spread: u32,
    count: usize,
    obstacles: usize,
}

/// Of the candidates, the second least of three or four, the least of two, the one. What is missing is greater than all.
#[inline(always)]
fn expected(near: [Seen; 4]) -> Expected {
    let (least, second, most_next, sum) = quad::weigh(near);
    let sum = sum[3] as u32;
    let count = sum as usize >> 8;
    let one = if count > 2 { second } else { least };
    // The next number of what is missing is the least of all.
    let spread = |field: usize| u32::from(most_next[field].wrapping_sub(1).wrapping_sub(least[field]) as u16);
    Expected {
        low: one[0].into(),
        thick: one[1].into(),
        low_spread: spread(0),
        thick_spread: spread(1),
        count,
        obstacles: sum as usize & 0xFF,
    }
}

/// All fields of four spans at once; two of them make sense.
mod quad {
    use super::Seen;

    #[cfg(not(target_arch = "x86_64"))]
    pub use portable::weigh;
    #[cfg(target_arch = "x86_64")]
    pub use sse2::weigh;

    /// The same for every processor.
    #[cfg(any(test, not(target_arch = "x86_64")))]
    pub mod portable {
        use super::Seen;

        fn each(a: Seen, b: Seen, of: impl Fn(i16, i16) -> i16) -> Seen {
            [of(a[0], b[0]), of(a[1], b[1]), of(a[2], b[2]), of(a[3], b[3])]
        }

        /// The least, the second least, the greatest of the next numbers, and the sum.
        pub fn weigh([a, b, c, d]: [Seen; 4]) -> (Seen, Seen, Seen, Seen) {
            let (min, max) = (|a, b| each(a, b, i16::min), |a, b| each(a, b, i16::max));
            let add = |a, b| each(a, b, i16::wrapping_add);
            let next = |a| add(a, [1; 4]);
            let (least_ab, most_ab, least_cd, most_cd) = (min(a, b), max(a, b), min(c, d), max(c, d));
            let second = min(max(least_ab, least_cd), min(most_ab, most_cd));
            let most_next = max(max(next(a), next(b)), max(next(c), next(d)));
            (min(least_ab, least_cd), second, most_next, add(add(a, b), add(c, d)))
        }
    }

    #[cfg(target_arch = "x86_64")]
    mod sse2 {
        use super::Seen;
        use std::arch::x86_64::{
            __m128i, _mm_add_epi16, _mm_loadl_epi64, _mm_max_epi16, _mm_min_epi16, _mm_set1_epi16, _mm_storel_epi64,
        };

        #[inline(always)]
        fn load(one: &Seen) -> __m128i {
            // SAFETY: four numbers are 8 bytes, read wherever they lie; every x86-64 has SSE2.
            unsafe { _mm_loadl_epi64(one.as_ptr().cast()) }
        }

        #[inline(always)]
        fn store(all: __m128i) -> Seen {
            let mut one = [0; 4];
            // SAFETY: as above, written.
            unsafe { _mm_storel_epi64(one.as_mut_ptr().cast(), all) };
            one
        }

        #[inline(always)]
        pub fn weigh(near: [Seen; 4]) -> (Seen, Seen, Seen, Seen) {
            let [a, b, c, d] = [load(&near[0]), load(&near[1]), load(&near[2]), load(&near[3])];
            // SAFETY: every x86-64 has SSE2.
            let (least, second, most_next, sum) = unsafe {
                let (min, max) = (|a, b| _mm_min_epi16(a, b), |a, b| _mm_max_epi16(a, b));
                let add = |a, b| _mm_add_epi16(a, b);
                let next = |a| _mm_add_epi16(a, _mm_set1_epi16(1));
                let (least_ab, most_ab, least_cd, most_cd) = (min(a, b), max(a, b), min(c, d), max(c, d));
                let second = min(max(least_ab, least_cd), min(most_ab, most_cd));
                let most_next = max(max(next(a), next(b)), max(next(c), next(d)));
                (min(least_ab, least_cd), second, most_next, add(add(a, b), add(c, d)))
            };
            (store(least), store(second), store(most_next), store(sum))
        }
    }
}

/// Which pixels have matter, as a mask for each row.
fn occupancy<C: Strands>(coder: &mut C, models: &mut Models, given: Option<&Page>) -> Result<[u64; 64], Violation> {
    let pixels_given = |block: u32| given.map_or(0, |page| page.block_at(block).pixels());
    let (mut matter, mut full) = (0u64, 0u64);
    for block in 0..64 {
        let kind = |exists: bool, back: u32| {
            if exists { (matter >> (block - back) & 1) as usize + (full >> (block - back) & 1) as usize } else { 0 }
        };
        let context = kind(block % 8 > 0, 1) * 3 + kind(block >= 8, 8);
        let pixels = pixels_given(block);
        if coder.bit::<0>(&mut models.matter[context], pixels != 0) {
            matter |= 1 << block;
            full |= u64::from(coder.bit::<1>(&mut models.full[context], pixels == u64::MAX)) << block;
        }
    }
    if matter == 0 {
        return Err(Violation::new("P6", "matter in some pixel", "none"));
    }
    let mut rows = [0u64; 64];
    for py in 0..64usize {
        let north = |back: usize| py.checked_sub(back).map_or(0, |north| rows[north]);
        let (north, north_2) = (north(1), north(2));
        let mut row = 0u64;
        for bx in 0..8 {
            let block = py as u32 / 8 * 8 + bx;
            if matter >> block & 1 == 0 {
                continue;
            }
            if full >> block & 1 == 1 {
                row |= 0xFF << (8 * bx);
                continue;
            }
            let pixels = (pixels_given(block) >> (8 * (py % 8))) as u32;
            // With a pixel to the west of the block as bit 0, and two to the west.
            let around = |row: u64, west: u32| ((u128::from(row) << west) >> (8 * bx)) as u32;
            let (north, north_2) = (around(north, 1), around(north_2, 0));
            let (mut west, mut found) = (around(row, 2) & 3, 0u32);
            let mut pixel = |x: u32, code: fn(&mut C, &mut Bit, bool) -> bool| {
                let context = west | (north >> x & 7) << 2 | (north_2 >> x & 1) << 5;
                let has = u32::from(code(coder, &mut models.pixel[context as usize & 63], pixels >> x & 1 == 1));
                west = west >> 1 | has << 1;
                found |= has << x;
            };
            for pair in 0..4 {
                pixel(2 * pair, C::bit::<0>);
                pixel(2 * pair + 1, C::bit::<1>);
            }
            row |= u64::from(found & 0xFF) << (8 * bx);
        }
        rows[py] = row;
    }
    Ok(rows)
}

/// How a height lies off the usual one, as [`Scratch::last_off`] keeps it.
#[inline]
fn off_of(last: u8) -> i32 {
    [0, 0, 1, -1][usize::from(last) & 3]
}

/// A height as it is coded.
#[derive(Clone, Copy, Default)]
struct Given {
    height: u32,
    /// `None` for a slice boundary that lies on no step.
    step: Option<(u32, i32)>,
}

impl Given {
    #[inline(always)]
    fn of(lattice: &Lattice, height: u32, end: End) -> Self {
        Self { height, step: lattice.index(height, end) }
    }

    /// The symbol, and its bits, near step `expected`.
    #[inline(always)]
    fn symbol(&self, alphabet: &Alphabet, expected: i32) -> (u32, u32) {
        let Some((step, _)) = self.step else {
            // Other heights all have steps, or the lattice would not be theirs.
            debug_assert!(self.height.is_multiple_of(SLICE), "no step for {}", self.height);
            return (BOUNDARY, self.height / SLICE);
        };
        let residual = fold(step as i32 - expected);
        let symbol = alphabet.symbol(residual);
        (symbol, residual - u32::from(alphabet.least[symbol as usize & 15]))
    }

    #[inline(always)]
    fn off(&self) -> i32 {
        self.step.map_or(0, |(_, off)| off)
    }
}

/// Walks over `page`, or the one that the coder reads, and hands each pixel's spans to `taker`.
fn walk<C: Strands>(
    mut coder: C,
    lattice: Lattice,
    scratch: &mut Scratch,
    page: Option<&Page>,
    mut taker: impl Taker,
) -> Result<C, Violation> {
    let Scratch { models, fresh, seen, last_off, .. } = scratch;
    let is_quanta = lattice.is_quanta();
    let alphabet = &ALPHABETS[usize::from(!is_quanta)];
    (**models).clone_from(&fresh[usize::from(!is_quanta)]);
    if !is_quanta {
        last_off.iter_mut().for_each(|end| end.fill(0));
    }
    let [off_bottoms, off_tops] = &mut **last_off;
    let rows = occupancy(&mut coder, models, page)?;
    taker.begin(&rows);
    let mut given = page.map(Rows::of);
    // By pixel of two rows, with one more on each side: where its spans are in `seen`, and from bit 16 on their number up to 3.
    let mut places = [[0u32; 66]; 2];
    let mut column = [Span::LEAST; MAX_COLUMN as usize];
    // Step and thickness where no candidate says them.
    let mut last = (0, 0);
    for (py, &row) in rows.iter().enumerate() {
        let [even, odd] = &mut places;
        let (own, north) = if py % 2 == 0 { (even, &*odd) } else { (odd, &*even) };
        own.fill(0);
        let mut next = 1 + py % 2 * ROW;
        let mut pixels = row;
        while pixels != 0 {
            let px = pixels.trailing_zeros() as usize & 63;
            pixels &= pixels - 1;
            let spans: &[Span] =
                if C::WRITES { given.as_mut().map_or(&[], |rows| rows.at(px as u32, py as u32)) } else { &[] };
            let around = [own[px], north[px + 1], north[px], north[px + 2]];
            let model = &mut models.count[(around[0] >> 16 << 2 | around[1] >> 16) as usize & 15];
            let mut count = 1;
            loop {
                let more = coder.nibble::<1>(model, (spans.len() as u32).wrapping_sub(count).min(15));
                count += more;
                if more < 15 || count > MAX_COLUMN {
                    break;
                }
            }
            if count > MAX_COLUMN {
                return Err(Violation::new("P7", "1 to 64 spans in an occupied pixel", count));
            }
            own[px + 1] = next as u32 | count.min(3) << 16;
            let mut places = around.map(|place| place as usize & 0xFFFF);
            let mut top_below = -1;
            for (index, found) in column.iter_mut().enumerate().take(count as usize) {
                if index > 0 {
                    // Past the neighbours' spans that the one below rules out; mostly one in each.
                    for place in &mut places {
                        *place += usize::from(i32::from(seen[*place][2]) <= top_below);
                        while i32::from(seen[*place][2]) <= top_below {
                            *place += 1;
                        }
                    }
                }
                let mut expected = expected(places.map(|place| seen[place]));
                if expected.count == 0 {
                    (expected.low, expected.thick) = last;
                    (expected.low_spread, expected.thick_spread) = (0, 0);
                }
                let Expected { low, thick, count: candidates, obstacles, .. } = expected;
                let context = |end: usize, spread: u32| usize::from(CONTEXTS[end][candidates.min(4)][bits(spread)]);
                let low_context = context(0, expected.low_spread);
                let class = usize::from(CLASSES[bits(thick.unsigned_abs())]);
                let thick_context = 10 * class + context(1, expected.thick_spread);
                // What is to be written, if something is.
                let [mut bottom_given, mut top_given] = [Given::default(); 2];
                let (mut bottom_symbol, mut top_symbol) = ((0, 0), (0, 0));
                if let Some(span) = spans.get(index) {
                    bottom_given = Given::of(&lattice, span.bottom(), End::Bottom);
                    top_given = Given::of(&lattice, span.top(), End::Top);
                    bottom_symbol = bottom_given.symbol(alphabet, low);
                    let step = bottom_given.step.map_or_else(|| lattice.at_or_above(span.bottom()), |step| step.0);
                    top_symbol = top_given.symbol(alphabet, step as i32 + thick);
                }
                let of_bottom = coder.nibble::<0>(&mut models.bottom[low_context & 15], bottom_symbol.0);
                let of_top = coder.nibble::<1>(&mut models.thickness[thick_context], top_symbol.0);
                let [bottom_bits, top_bits] =
                    [of_bottom, of_top].map(|symbol| u32::from(alphabet.bits[symbol as usize & 15]));
                let both = coder.raw(bottom_bits + top_bits, bottom_symbol.1 | top_symbol.1 << bottom_bits);
                let least = |symbol: u32| u32::from(alphabet.least[symbol as usize & 15]);
                let bottom_residual = least(of_bottom) + (both & ((1 << bottom_bits) - 1));
                let top_residual = least(of_top) + (both >> bottom_bits);
                let mut bottom_step = (low + unfold(bottom_residual)) & 0x3FFF;
                let mut bottom = bottom_step;
                let (mut top, mut top_step);
                if is_quanta && of_bottom != BOUNDARY && of_top != BOUNDARY {
                    top_step = (bottom_step + thick + unfold(top_residual)) & 0x3FFF;
                    top = top_step;
                } else {
                    bottom = lattice.usual(bottom_step as u32, End::Bottom);
                    if of_bottom == BOUNDARY {
                        bottom = (bottom_residual * SLICE) as i32;
                        bottom_step = lattice.at_or_above(bottom as u32) as i32;
                    }
                    top_step = (bottom_step + thick + unfold(top_residual)) & 0x3FFF;
                    top = lattice.usual(top_step as u32, End::Top);
                    if of_top == BOUNDARY {
                        top = (top_residual * SLICE) as i32;
                        top_step = lattice.at_or_above(top as u32) as i32;
                    }
                    if !is_quanta {
                        // A boundary has no step to remember.
                        let (mut no_bottom, mut no_top) = (0, 0);
                        let of_step = |symbol: u32| symbol != BOUNDARY;
                        let last_bottom = if of_step(of_bottom) {
                            &mut off_bottoms[bottom_step as usize & 0x3FFF]
                        } else {
                            &mut no_bottom
                        };
                        let last_top =
                            if of_step(of_top) { &mut off_tops[top_step as usize & 0x3FFF] } else { &mut no_top };
                        let mut off = (off_of(*last_bottom), off_of(*last_top));
                        let given = (bottom_given.off(), top_given.off());
                        let context = usize::from(*last_bottom << 2 | *last_top) & 15;
                        if coder.bit::<1>(&mut models.surprise[context], given != off) {
                            let both =
                                coder.nibble::<1>(&mut models.off, (given.0 * 3 + given.1 + 4) as u32).min(8) as i32;
                            off = (both / 3 - 1, both % 3 - 1);
                        }
                        let known = |off: i32| [3, 1, 2][(off + 1) as usize & 3];
                        (*last_bottom, *last_top) = (known(off.0), known(off.1));
                        (bottom, top) = (bottom + off.0, top + off.1);
                    }
                }
                let is_thick = top - bottom > SLICE as i32 / 4;
                let context = (obstacles * 5 + candidates) * 2 + usize::from(is_thick);
                let obstacle = coder.bit::<0>(
                    &mut models.kind[context.min(49)],
                    spans.get(index).is_some_and(|span| span.is_obstacle()),
                );
                let span = Span::new(bottom as u32, top as u32, obstacle)
                    .ok_or_else(|| Violation::new("P8", "a span inside the page", format!("{bottom}..={top}")))?;
                *found = span;
                let thick = top_step - bottom_step;
                seen[next] = [bottom_step as i16, thick as i16, bottom as i16, 256 + i16::from(obstacle)];
                next += 1;
                top_below = top;
                // Of the pixel's next span the bottom lies above this one's top; the next pixel's may lie where this one's does.
                last = (if index + 1 < count as usize { top_step } else { bottom_step }, thick);
            }
            seen[next] = NONE;
            next += 1;
            let spans = &column[..count as usize];
            if !taker.take(px as u32, py as u32, spans) {
                return Err(Violation::new(
                    "P8",
                    "spans apart, lowest first",
                    format!("{spans:?} in pixel ({px}, {py})"),
                ));
            }
        }
    }
    Ok(coder)
}

/// Appends the encoding of `page` with heights on `lattice`, at most [`MAX_LEN`] bytes.
pub fn encode(lattice: Lattice, page: &Page, scratch: &mut Scratch, out: &mut Vec<u8>) {
    let mut encoder = std::mem::take(&mut scratch.encoder);
    encoder.clear();
    code_lattice(&mut encoder, lattice);
    if let Ok(mut encoder) = walk(encoder, lattice, scratch, Some(page), ()) {
        encoder.finish(out);
        scratch.encoder = encoder;
    }
}

/// A bit that says whether there is a lattice, then its step and phase: how many zeros end it, and the rest of its 40 bits.
fn code_lattice(coder: &mut impl Strands, given: Lattice) -> Option<Lattice> {
    if coder.raw(1, u32::from(!given.is_quanta())) == 0 {
        return Some(Lattice::QUANTA);
    }
    let mut number = |given: u64| {
        let zeros = coder.raw(6, given.trailing_zeros().min(40));
        let bits = 40u32.checked_sub(zeros)?;
        let given = given.checked_shr(zeros).unwrap_or(0);
        let (low, high) = (bits.min(20), bits - bits.min(20));
        let low_part = coder.raw(low, (given & ((1 << low) - 1)) as u32);
        let high_part = coder.raw(high, (given >> low) as u32);
        Some((u64::from(high_part) << low | u64::from(low_part)).checked_shl(zeros).unwrap_or(0))
    };
    Lattice::new(number(given.step)?, number(given.phase)?)
}

/// Takes what a walk finds.
trait Taker {
    /// Begins a page with matter in these pixels.
    fn begin(&mut self, rows: &[u64; 64]);
    /// The spans of the next pixel; `false` if they are not apart.
    fn take(&mut self, px: u32, py: u32, spans: &[Span]) -> bool;
}

/// Where the spans are known.
impl Taker for () {
    fn begin(&mut self, _: &[u64; 64]) {}

    #[inline(always)]
    fn take(&mut self, _: u32, _: u32, _: &[Span]) -> bool {
        true
    }
}

impl Taker for &mut RowBuilder {
    fn begin(&mut self, rows: &[u64; 64]) {
        RowBuilder::begin(self, *rows);
    }

    #[inline(always)]
    fn take(&mut self, px: u32, py: u32, spans: &[Span]) -> bool {
        self.push_column(px, py, spans)
    }
}

/// Fills `builder` from the encoding `body`.
pub fn decode(body: &[u8], scratch: &mut Scratch, builder: &mut RowBuilder) -> Result<(), Violation> {
    let mut decoder = BraidDecoder::new(body, "P6")?;
    let lattice = code_lattice(&mut decoder, Lattice::QUANTA)
        .ok_or_else(|| Violation::new("P7", "steps of 2 to 255 quanta, above their phase", "others"))?;
    walk(decoder, lattice, scratch, None, builder)?.finish("P6")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::adaptive::tests::pages;
    use crate::codec::{Decoder, Encoder, MAX_BODY};
    use crate::frame::Frame;
    use crate::plan::Coding;
    use crate::slice::PageBuilder;
    use proptest::prelude::*;

    fn encoder() -> Encoder {
        Encoder::new(Frame::new(0.05, 0.15).unwrap(), 0).with_coding(Coding::Braided)
    }

    fn encoded(page: &Page) -> Vec<u8> {
        let mut body = Vec::new();
        encoder().encode(page, &mut body);
        body
    }

    /// `page` with heights on centimetres, as far as its spans are apart then.
    fn in_centimetres(page: &Page) -> Page {
        let mut builder = PageBuilder::default();
        for (px, py, spans) in page.columns() {
            let whole = |height: u32| height / 17 * 17;
            let moved =
                |s: &Span| Span::new(whole(s.bottom()), (whole(s.top()) + 1).min(16320), s.is_obstacle()).unwrap();
            let spans: Vec<_> = spans.iter().map(moved).collect();
            assert!(builder.set_column(px, py, &spans) || spans.len() > 1);
        }
        builder.build()
    }

    #[test]
    fn every_residual_has_one_symbol() {
        for alphabet in &ALPHABETS {
            for residual in 0..1 << 14 {
                let symbol = alphabet.symbol(residual);
                let rest = residual - u32::from(alphabet.least[symbol as usize]);
                assert!(symbol < BOUNDARY && rest >> alphabet.bits[symbol as usize] == 0, "{residual}");
            }
        }
    }

    #[test]
    fn the_largest_page_has_less_than_the_stated_length() {
        let mut builder = PageBuilder::default();
        for pixel in 0..64 * 64u32 {
            let height = |k: u32| 255 * k + (pixel.wrapping_mul(2654435761).wrapping_mul(k + 1) >> 7) % 200;
            let span = |k: u32| Span::new(height(k), height(k) + (pixel ^ k) % 50, (pixel ^ k).is_multiple_of(3));
            let spans: Vec<_> = (0..64).map(|k| span(k).unwrap()).collect();
            assert!(builder.set_column(pixel % 64, pixel / 64, &spans));
        }
        let page = builder.build();
        let body = encoded(&page);
        assert!(body.len() <= MAX_LEN, "{} bytes", body.len());
        assert_eq!(Decoder::default().decode(&body).unwrap(), page);
    }

    proptest! {
        #[test]
        fn processors_agree(near: [[i16; 4]; 4]) {
            prop_assert_eq!(quad::weigh(near), quad::portable::weigh(near));
        }

        #[test]
        fn pages_round_trip(pages in proptest::collection::vec(pages(), 1..4), centimetres: bool) {
            let (mut encoder, mut decoder) = (encoder(), Decoder::default());
            for page in pages {
                let page = if centimetres { in_centimetres(&page) } else { page };
                prop_assume!(page.span_count() > 0);
                let mut body = Vec::new();
                encoder.encode(&page, &mut body);
                prop_assert!(body.len() <= MAX_BODY && body == encoded(&page));
                prop_assert_eq!(decoder.decode(&body).unwrap(), page);
            }
        }

        #[test]
        fn what_decodes_encodes_again(
            page in pages(), centimetres: bool, flips in proptest::collection::vec(any::<(prop::sample::Index, u8)>(), 1..4)
        ) {
            let page = if centimetres { in_centimetres(&page) } else { page };
            prop_assume!(page.span_count() > 0);
            let mut body = encoded(&page);
            for (at, value) in flips {
                let place = at.index(body.len() - 1) + 1;
                body[place] = value;
            }
            match Decoder::default().decode(&body) {
                Ok(page) => {
                    let again = encoded(&page);
                    prop_assert_eq!(Decoder::default().decode(&again).unwrap(), page);
                }
                Err(violation) => prop_assert!(["P6", "P7", "P8"].contains(&violation.rule)),
            }
        }

        #[test]
        fn random_bytes_never_panic(mut body in proptest::collection::vec(any::<u8>(), 0..2000)) {
            if let Some(first) = body.first_mut() {
                *first = 3;
            }
            let _ = Decoder::default().decode(&body);
        }
    }
}
