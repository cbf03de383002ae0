//! Encoding of the colours of a page's voxels (specification, chapter 10).
//!
//! A colour is three numbers of steps: of luma, and of two channel differences (the reversible YCoCg of Malvar and
//! Sullivan, 2003). Each is predicted from surrounding voxels that are already coded; the residual is coded with
//! adaptive models. A block states its steps. The writer takes the widest steps whose mean difference from the exact
//! colours, in CIELAB, stays within the requested error. Steps of 1 keep 8-bit colours unchanged.

use super::rans::{Bit, Coder, Nibble, RansDecoder, RansEncoder};
use super::{MAX_PAGE_SPANS, Violation, unzigzag, zigzag};
use crate::colour::{Lab, LabTable, difference, to_8_bits};
use crate::page::{Colours, Occupancy};

/// First byte of a block, which names its coding.
const MODEL: u8 = 1;
/// Bytes of a block before its symbols.
const LEAD: usize = 4;
/// Most symbols of a voxel: whether it has a colour, and for each number a 4-bit symbol, its number of bits, and the
/// bits themselves.
const VOXEL_SYMBOLS: usize = 1 + 3 * 3;
/// Largest block (bytes): a page has no more voxels than it could have spans.
pub const MAX_COLOUR_BLOCK: usize = LEAD + 4 + 2 * VOXEL_SYMBOLS * MAX_PAGE_SPANS;
/// Largest channel difference, and largest luma.
const GREATEST: i32 = 255;
/// Marks a voxel without colour, in place of luma.
const ABSENT: i16 = i16::MIN;
/// Widest step of luma that is tried.
const MOST_STEP: u8 = 48;

/// Number of contexts for each kind of number.
const CONTEXTS: usize = 24;

#[derive(Clone)]
struct Models {
    present: [Bit; 4],
    number: [[Nibble; CONTEXTS]; 3],
    long: [Nibble; 3],
}

/// Returns a residual model whose weights fall more slowly for a larger `shift`, for places where neighbours differ
/// more.
const fn falling(shift: u32) -> Nibble {
    let mut weights = [1u16; 16];
    let mut at = 0;
    while at < 15 {
        // Halve every 2^shift symbols.
        weights[at] = 1 + (4096 >> (at as u32 >> shift)) as u16;
        at += 1;
    }
    weights[15] = 1 + (weights[14] >> 1);
    Nibble::new(weights)
}

const CONTEXT_MODELS: [Nibble; CONTEXTS] = {
    let mut models = [const { falling(0) }; CONTEXTS];
    let mut at = 0;
    while at < CONTEXTS {
        models[at] = match at % 8 {
            0 | 1 => falling(0),
            2..=4 => falling(1),
            _ => falling(2),
        };
        at += 1;
    }
    models
};

const FRESH: Models = Models {
    present: [const { Bit::new(31 << 10) }; 4],
    number: [const { CONTEXT_MODELS }; 3],
    long: [const { Nibble::new([8, 8, 8, 8, 4, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]) }; 3],
};

/// Decoded colour block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColourBlock {
    /// Quanta per step of luma and of the two differences, each at least 1.
    steps: [u8; 3],
    /// Numbers of steps, in voxel order; the first is [`ABSENT`] without a colour.
    values: Vec<[i16; 3]>,
}

/// Returns the steps that belong to a step of luma. One step of each makes about the same difference in CIELAB.
fn steps_for(luma: u8) -> [u8; 3] {
    let n = u32::from(luma);
    [luma, ((n * 9 + 4) / 8).max(1) as u8, ((n * 5 + 4) / 8).max(1) as u8]
}

/// Division by a constant above 1 as a multiplication. Exact for dividends below 2¹⁷ and divisors below 2¹⁵.
#[derive(Debug, Clone, Copy, Default)]
struct Divisor {
    half: u32,
    reciprocal: u32,
}

impl Divisor {
    const fn new(divisor: u32) -> Self {
        Self { half: divisor / 2, reciprocal: ((1 << 32) / divisor as u64 + 1) as u32 }
    }

    /// Returns `value / divisor`, rounded down.
    #[inline]
    fn floor(self, value: u32) -> i32 {
        ((u64::from(value) * u64::from(self.reciprocal)) >> 32) as i32
    }

    /// Returns `value / divisor`, rounded to nearest, halves away from zero.
    #[inline]
    fn nearest(self, value: i32) -> i16 {
        let found = self.floor(value.unsigned_abs() + self.half);
        (if value < 0 { -found } else { found }) as i16
    }
}

/// Divisors by twice a sum of neighbour weights.
const BY_WEIGHT: [Divisor; 16] = {
    let mut all = [Divisor { half: 0, reciprocal: 0 }; 16];
    let mut weight = 1;
    while weight <= MOST_WEIGHT {
        all[weight] = Divisor::new(2 * weight as u32);
        weight += 1;
    }
    all
};
/// Largest sum of neighbour weights.
const MOST_WEIGHT: usize = 3 + 3 + 3 + 1 + 2;
const _: () = assert!(MOST_WEIGHT < 16);

/// Returns `sum / weight`, rounded to nearest, halves up.
#[inline]
fn mean(sum: i32, weight: i32) -> i32 {
    // Shift above zero by whole quotients.
    const ABOVE: i32 = 1 << 9;
    let above = (2 * sum + weight + 2 * weight * ABOVE) as u32;
    BY_WEIGHT[weight as usize & 15].floor(above) - ABOVE
}

/// Returns the 8-bit colour of luma and differences.
#[inline]
fn rgb_of([y, co, cg]: [i32; 3]) -> [u8; 3] {
    let t = y - (cg >> 1);
    let g = cg + t;
    let b = t - (co >> 1);
    [b + co, g, b].map(|channel| channel.clamp(0, GREATEST) as u8)
}

/// Returns luma and differences of an 8-bit colour; [`rgb_of`] inverts this.
#[inline]
fn ycocg([r, g, b]: [u8; 3]) -> [i32; 3] {
    let [r, g, b] = [r, g, b].map(i32::from);
    let co = r - b;
    let t = b + (co >> 1);
    let cg = g - t;
    [t + (cg >> 1), co, cg]
}

/// Returns luma and differences of a 16-bit colour, in 1/257 of the 8-bit units, which keeps halves.
#[inline]
fn in_257ths(colour: [u16; 3]) -> [i32; 3] {
    let [r, g, b] = colour.map(i32::from);
    [(r + 2 * g + b + 2) / 4, r - b, g - (r + b) / 2]
}

/// Quantises 16-bit colours.
#[derive(Debug, Clone, Copy)]
struct Quantiser {
    steps: [u8; 3],
    divisors: [Divisor; 3],
}

impl Quantiser {
    fn new(steps: [u8; 3]) -> Self {
        Self { steps, divisors: steps.map(|step| Divisor::new(257 * u32::from(step))) }
    }

    #[inline]
    fn of(&self, colour: [u16; 3]) -> [i16; 3] {
        if self.steps == [1; 3] {
            return ycocg(colour.map(to_8_bits)).map(|value| value as i16);
        }
        self.of_257ths(in_257ths(colour))
    }

    /// Quantises luma and differences in 1/257 of the 8-bit units. Not for steps that are all 1.
    #[inline]
    fn of_257ths(&self, all: [i32; 3]) -> [i16; 3] {
        [0, 1, 2].map(|at| self.divisors[at].nearest(all[at]))
    }
}

/// Quantises like [`Quantiser`], for steps of any width, with plain divisions.
fn numbers(colour: [u16; 3], steps: [u8; 3]) -> [i16; 3] {
    if steps == [1; 3] {
        return ycocg(colour.map(to_8_bits)).map(|value| value as i16);
    }
    let all = in_257ths(colour);
    [0, 1, 2].map(|at: usize| {
        let step = 257 * i32::from(steps[at]);
        ((all[at].abs() + step / 2) / step * all[at].signum()) as i16
    })
}

/// Returns the colour for numbers of steps.
#[inline]
fn restored(value: [i16; 3], steps: [u8; 3]) -> [u8; 3] {
    rgb_of(std::array::from_fn(|at| i32::from(value[at]) * i32::from(steps[at])))
}

/// Cache of CIELAB values of 8-bit colours: a page has few, and each step width asks for them again.
#[derive(Debug, Clone)]
struct RecentLabs(Box<[(u32, Lab); 1 << RecentLabs::BITS]>);

impl Default for RecentLabs {
    fn default() -> Self {
        // Not the number of any colour.
        Self(Box::new([(u32::MAX, [0.0; 3]); 1 << Self::BITS]))
    }
}

impl RecentLabs {
    const BITS: u32 = 10;

    #[inline]
    fn of(&mut self, table: &LabTable, rgb: [u8; 3]) -> Lab {
        let number = u32::from_le_bytes([rgb[0], rgb[1], rgb[2], 0]);
        let place = &mut self.0[(number.wrapping_mul(0x9E37_79B1) >> (32 - Self::BITS)) as usize];
        if place.0 != number {
            *place = (number, table.of_8_bits(rgb));
        }
        place.1
    }
}

/// Finds the widest steps within an error; keeps its scratch memory: 24 bytes per voxel of a page.
#[derive(Debug, Clone, Default)]
struct Stepper {
    /// Luma and differences of each colour in 1/257 of the 8-bit units, and CIELAB.
    exact: [Vec<i32>; 3],
    labs: [Vec<f32>; 3],
    recent: RecentLabs,
}

impl Stepper {
    /// Colours per batch, so that the arithmetic compiles to vector instructions.
    const BATCH: usize = 64;
    /// Colours for which memory is kept from page to page.
    const KEPT: usize = 1 << 14;

    /// Returns the step of luma for these colours; `None` if there are no colours.
    ///
    /// Cost: about five passes over the voxels.
    fn luma(&mut self, colours: &[Option<[u16; 3]>], error_milli: u16) -> Option<u8> {
        if error_milli == 0 {
            return colours.iter().any(Option::is_some).then_some(1);
        }
        self.set(colours);
        let count = self.exact[0].len();
        let most = f64::from(error_milli) / 1000.0 * count as f64;
        let (mut low, mut high) = (1, if count > 0 { MOST_STEP } else { 1 });
        // Binary search. If wider steps did not always err more, the result still fits.
        while low < high {
            let middle = (low + high).div_ceil(2);
            if self.fits(middle, most) { low = middle } else { high = middle - 1 }
        }
        (count > 0).then_some(low)
    }

    fn set(&mut self, colours: &[Option<[u16; 3]>]) {
        let table = LabTable::get();
        for all in &mut self.exact {
            all.clear();
            all.shrink_to(Self::KEPT);
        }
        for all in &mut self.labs {
            all.clear();
            all.shrink_to(Self::KEPT);
        }
        for &colour in colours.iter().flatten() {
            self.exact.iter_mut().zip(in_257ths(colour)).for_each(|(all, number)| all.push(number));
            self.labs.iter_mut().zip(table.of_16_bits(colour)).for_each(|(all, number)| all.push(number));
        }
    }

    /// Returns whether the differences sum to at most `most` with this step of luma, which must be above 1.
    fn fits(&mut self, luma: u8, most: f64) -> bool {
        const BATCH: usize = Stepper::BATCH;
        let (table, Self { exact: [y, co, cg], labs: [l, a, b], recent }) = (LabTable::get(), self);
        let (steps, quantiser) = (steps_for(luma), Quantiser::new(steps_for(luma)));
        let mut sum = 0.0;
        for start in (0..y.len()).step_by(BATCH) {
            let all = start..(start + BATCH).min(y.len());
            let (mut rgb, mut found, mut apart) = ([[0; 3]; BATCH], [[0.0; BATCH]; 3], [0.0; BATCH]);
            let exact = y[all.clone()].iter().zip(&co[all.clone()]).zip(&cg[all.clone()]);
            for (rgb, ((&y, &co), &cg)) in rgb.iter_mut().zip(exact) {
                *rgb = restored(quantiser.of_257ths([y, co, cg]), steps);
            }
            for (number, &rgb) in rgb[..all.len()].iter().enumerate() {
                let lab = recent.of(table, rgb);
                (0..3).for_each(|axis| found[axis][number] = lab[axis]);
            }
            let exact = l[all.clone()].iter().zip(&a[all.clone()]).zip(&b[all.clone()]);
            for (number, ((&l, &a), &b)) in exact.enumerate() {
                apart[number] = difference([found[0][number], found[1][number], found[2][number]], [l, a, b]);
            }
            // Summed in order, since float sums depend on it. The sum never falls.
            sum = apart[..all.len()].iter().fold(sum, |sum, &apart| sum + f64::from(apart));
            if sum > most {
                return false;
            }
        }
        true
    }
}

impl ColourBlock {
    /// Quantises exact colours (16 bits a channel) of voxels in order, with the widest steps whose mean difference is
    /// at most `error_milli` thousandths of ΔE*ab, or 8-bit colours if no wider steps fit. `None` if there is no
    /// colour.
    pub fn quantise(colours: &[Option<[u16; 3]>], error_milli: u16, encoder: &mut ColourEncoder) -> Option<Self> {
        let steps = steps_for(encoder.stepper.luma(colours, error_milli)?);
        let quantiser = Quantiser::new(steps);
        let value = |colour: &Option<[u16; 3]>| colour.map_or([ABSENT, 0, 0], |colour| quantiser.of(colour));
        Some(Self { steps, values: colours.iter().map(value).collect() })
    }

    /// Returns the colours of those voxels of `occupancy` that are also in `part`, which was cut from the page.
    pub fn part(&self, occupancy: &Occupancy, part: &Occupancy) -> Option<Self> {
        let value = |(pixel, k)| {
            let number = occupancy.find(pixel, k)?;
            self.values.get(number).copied()
        };
        let values: Vec<_> = part.voxels().map(|voxel| value(voxel).unwrap_or([ABSENT, 0, 0])).collect();
        values.iter().any(|value| value[0] != ABSENT).then_some(Self { steps: self.steps, values })
    }

    /// Returns the colours of `voxels`, each given by a block and its number there. If two blocks with different steps
    /// have some, steps become 1, which keeps every colour as it is.
    pub fn pieced(blocks: [Option<&Self>; 2], voxels: impl Iterator<Item = (usize, Option<usize>)>) -> Option<Self> {
        let find = |(side, number): (usize, Option<usize>)| {
            let block = blocks.get(side).copied().flatten()?;
            block.values.get(number?).filter(|value| value[0] != ABSENT).map(|&value| (block.steps, value))
        };
        let found: Vec<Option<([u8; 3], [i16; 3])>> = voxels.map(find).collect();
        let mut all = found.iter().flatten().map(|(steps, _)| *steps);
        let first = all.next()?;
        let steps = if all.all(|steps| steps == first) { first } else { [1; 3] };
        let value = |(own, value): ([u8; 3], [i16; 3])| match own == steps {
            true => value,
            false => ycocg(restored(value, own)).map(|value| value as i16),
        };
        Some(Self { steps, values: found.into_iter().map(|found| found.map_or([ABSENT, 0, 0], value)).collect() })
    }

    /// Returns whether exact colours (16 bits a channel) of the same voxels quantise to this block with its steps.
    pub fn is_of(&self, colours: &[Option<[u16; 3]>]) -> bool {
        let value = |colour: &Option<[u16; 3]>| colour.map_or([ABSENT, 0, 0], |colour| numbers(colour, self.steps));
        self.values.len() == colours.len() && self.values.iter().zip(colours).all(|(own, colour)| *own == value(colour))
    }

    /// Returns the number of coloured voxels.
    pub fn count(&self) -> u64 {
        self.values.iter().filter(|value| value[0] != ABSENT).count() as u64
    }

    /// Returns the colours in voxel order.
    pub fn rgb(&self) -> impl Iterator<Item = Option<[u8; 3]>> + '_ {
        self.values.iter().map(|&value| (value[0] != ABSENT).then(|| restored(value, self.steps)))
    }

    /// Returns the block as [`Colours`] of the voxels of `occupancy`.
    pub fn colours(&self, occupancy: Occupancy) -> Option<Colours> {
        let colour = |&value: &[i16; 3]| {
            let [r, g, b] = restored(value, self.steps);
            if value[0] == ABSENT { [0; 4] } else { [r, g, b, 255] }
        };
        Colours::new(occupancy, self.values.iter().map(colour).collect())
    }

    /// Appends the encoded block, whose voxels are those of `occupancy`.
    pub fn encode(&mut self, occupancy: &Occupancy, encoder: &mut ColourEncoder, out: &mut Vec<u8>) {
        debug_assert_eq!(occupancy.len(), self.values.len());
        out.push(MODEL);
        out.extend(self.steps);
        encoder.rans.clear();
        walk(occupancy, self.steps, &mut self.values, &mut encoder.rans);
        encoder.rans.finish(out);
    }

    /// Decodes the block of a page with the voxels of `occupancy`; checks rules K5 to K7.
    pub fn decode(bytes: &[u8], occupancy: &Occupancy) -> Result<Self, Violation> {
        let Some((&[model, a, b, c], coded)) = bytes.split_first_chunk::<LEAD>() else {
            return Err(Violation::new("K5", "a model and three steps", format!("{} bytes", bytes.len())));
        };
        let steps = [a, b, c];
        if model != MODEL || steps.contains(&0) {
            let found = format!("model {model}, steps {steps:?}");
            return Err(Violation::new("K5", "model 1 and steps of 1 to 255", found));
        }
        let mut decoder = RansDecoder::new(coded, "K6")?;
        let mut values = vec![[ABSENT, 0, 0]; occupancy.len()];
        let sound = walk(occupancy, steps, &mut values, &mut decoder);
        decoder.finish("K6")?;
        if !sound || values.iter().all(|value| value[0] == ABSENT) {
            return Err(Violation::new(
                "K7",
                "numbers of steps within the range of colours, and some colour",
                "others",
            ));
        }
        Ok(Self { steps, values })
    }
}

/// Encodes blocks; keeps its scratch memory.
#[derive(Debug, Default)]
pub struct ColourEncoder {
    rans: RansEncoder,
    stepper: Stepper,
    without_levels: bool,
}

impl ColourEncoder {
    /// Sets whether colours are prepared for overview levels, which is the default. Encoding is cheaper without; an
    /// archive with levels refuses colours that are not prepared.
    pub fn for_levels(self, levels: bool) -> Self {
        Self { without_levels: !levels, ..self }
    }

    /// Returns whether colours are prepared for overview levels.
    pub fn is_for_levels(&self) -> bool {
        !self.without_levels
    }
}

/// Surroundings of a voxel: for each number the weighted sum, minimum and maximum of the neighbours. Four lanes of 16
/// bits, the last one idle, compile to vector instructions; no sum needs more bits.
struct Near {
    weight: i32,
    sum: [i16; 4],
    least: [i16; 4],
    most: [i16; 4],
    count: usize,
}

const _: () = assert!(MOST_WEIGHT as i32 * GREATEST < i16::MAX as i32);

impl Near {
    const NOTHING: Self = Self { weight: 0, sum: [0; 4], least: [i16::MAX; 4], most: [i16::MIN; 4], count: 0 };

    #[inline]
    fn add(&mut self, [a, b, c]: [i16; 3], weight: i16) {
        for (at, value) in [a, b, c, 0].into_iter().enumerate() {
            self.sum[at] += weight * value;
            self.least[at] = self.least[at].min(value);
            self.most[at] = self.most[at].max(value);
        }
        self.weight += i32::from(weight);
        self.count += 1;
    }
}

/// Returns the class of a spread between neighbours (0 to 7).
#[inline]
fn class(spread: i32) -> usize {
    const CLASSES: [u8; 12] = [0, 1, 2, 3, 3, 4, 4, 5, 5, 5, 6, 6];
    CLASSES.get(spread as usize).map_or(7, |&class| usize::from(class))
}

/// Returns the number of voxels of a pixel below a slice.
#[inline]
fn rank(mask: u64, slice: u32) -> usize {
    let below = mask & ((1u64 << slice) - 1);
    // Usually 0, and not every processor counts bits in one instruction.
    if below == 0 { 0 } else { below.count_ones() as usize }
}

/// Passes the voxels through `coder`, which reads or writes `values`. Returns whether all numbers are in range.
fn walk<C: Coder>(occupancy: &Occupancy, steps: [u8; 3], values: &mut [[i16; 3]], coder: &mut C) -> bool {
    let mut models = Box::new(FRESH);
    let mut sound = true;
    let most = steps.map(|step| (GREATEST + i32::from(step) / 2) / i32::from(step));
    let mut last = [(128 / i32::from(steps[0])) as i16, 0, 0];
    let mut present = [true; 2];
    for pixel in 0..64 * 64usize {
        let (mut mask, first) = occupancy.pixel(pixel);
        if mask == 0 {
            continue;
        }
        let (px, py) = (pixel & 63, pixel >> 6);
        // West, north, north-west, north-east, with their weights.
        let none = (0, 0);
        let around = [
            (if px > 0 { occupancy.pixel(pixel - 1) } else { none }, 3),
            (if py > 0 { occupancy.pixel(pixel - 64) } else { none }, 3),
            (if px > 0 && py > 0 { occupancy.pixel(pixel - 65) } else { none }, 1),
            (if px < 63 && py > 0 { occupancy.pixel(pixel - 63) } else { none }, 2),
        ];
        let mut below: Option<(u32, [i16; 3])> = None;
        let mut at = first;
        while mask != 0 {
            let k = mask.trailing_zeros();
            mask &= mask - 1;
            let number = at;
            at += 1;
            let Some(&value) = values.get(number) else { return false };
            let context = usize::from(present[0]) << 1 | usize::from(present[1]);
            let is_present = coder.bit(&mut models.present[context], value[0] != ABSENT);
            present = [is_present, present[0]];
            if !is_present {
                values[number] = [ABSENT, 0, 0];
                continue;
            }
            let mut near = Near::NOTHING;
            if let Some((_, value)) = below.filter(|below| below.0 + 1 == k) {
                near.add(value, 3);
            }
            for ((their_mask, their_first), weight) in around {
                // The neighbour's voxel at the same height, else the one below, else the one above.
                for slice in [k, k.wrapping_sub(1), k + 1] {
                    if slice < 64 && their_mask >> slice & 1 == 1 {
                        let value = values[their_first + rank(their_mask, slice)];
                        if value[0] != ABSENT {
                            near.add(value, weight);
                            break;
                        }
                    }
                }
            }
            if near.count == 0 {
                near.add(below.map_or(last, |below| below.1), 1);
                near.count = 0;
            }
            let mut coded = value;
            let mut before = 0;
            for channel in 0..3 {
                let expected = mean(i32::from(near.sum[channel]), near.weight);
                let spread = match near.count {
                    0 => 7,
                    1 => 5,
                    _ => class(i32::from(near.most[channel]) - i32::from(near.least[channel])),
                };
                let context = spread + 8 * if channel == 0 { near.count.saturating_sub(1).min(2) } else { before };
                let residual = i32::from(coded[channel]) - expected;
                let folded = coder_number(coder, &mut models, channel, context, zigzag(i64::from(residual)) as u32);
                let found = expected + unzigzag(u64::from(folded)) as i32;
                before = (folded as usize).div_ceil(2).min(2);
                let least = if channel == 0 { 0 } else { -most[channel] };
                sound &= (least..=most[channel]).contains(&found);
                coded[channel] = found.clamp(least, most[channel]) as i16;
            }
            values[number] = coded;
            below = Some((k, coded));
            last = coded;
        }
    }
    sound
}

/// Codes a number that is usually small.
#[inline]
fn coder_number<C: Coder>(coder: &mut C, models: &mut Models, channel: usize, context: usize, value: u32) -> u32 {
    let short = coder.nibble(&mut models.number[channel][context], value.min(15));
    if short < 15 {
        return short;
    }
    // `rest + 1` has its highest bit at `bits`.
    let rest = value.wrapping_sub(15).wrapping_add(1);
    let bits = coder.nibble(&mut models.long[channel], 31 - rest.max(1).leading_zeros().min(31)).min(12);
    let low = if bits > 0 { coder.raw(bits, rest & ((1 << bits) - 1)) } else { 0 };
    15 + (1 << bits | low) - 1
}

#[cfg(test)]
mod tests;
