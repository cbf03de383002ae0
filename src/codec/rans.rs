//! Entropy coding: rANS, a range variant of asymmetric numeral systems (Duda 2013, arXiv:1311.2540), with one state and
//! adaptive models (specification, section 10.2). Colours are coded with it.
//!
//! Symbols take bits according to their probability in a model. Models learn from earlier symbols, so the bytes contain
//! no tables. One walk over the content serves encoder and decoder: it passes each value to a [`Coder`] and continues
//! with the value returned. The state has 32 bits and moves in words of 16 bits; probabilities have 15 bits. A symbol
//! takes one multiplication and at most one word; decoding needs no division.

use super::Violation;
use std::sync::OnceLock;

/// Bits of a probability.
pub(super) const SCALE_BITS: u32 = 15;
pub(super) const SCALE: u32 = 1 << SCALE_BITS;
/// Smallest state between two symbols, and the initial state.
const LOW: u32 = 1 << 16;
/// Most bits of one [`Coder::raw`].
pub const MAX_RAW_BITS: u32 = 15;

/// Learning rates: a probability moves by 1/2ⁿ of the distance, with `n` by the number of symbols seen.
const RATES: [u8; 16] = [2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6];
const BIT_RATES: [u8; 16] = [1, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5];
/// Smallest number of slots of a bit's rarer value.
const BIT_FLOOR: u16 = 32;

/// Adaptive probabilities of 16 symbols.
#[derive(Debug, Clone)]
pub struct Nibble {
    /// Cumulative probability of the symbols before each, out of `SCALE - 16`; every symbol has one more slot of its
    /// own.
    below: [i16; 16],
    seen: u8,
}

impl Nibble {
    /// Creates a model with probabilities proportional to `weights`.
    pub const fn new(weights: [u16; 16]) -> Self {
        let (mut sum, mut index) = (0u32, 0);
        while index < 16 {
            sum += weights[index] as u32;
            index += 1;
        }
        let mut below = [0; 16];
        let mut before = 0u32;
        index = 0;
        while index < 16 {
            below[index] = (before * (SCALE - 16) / sum) as i16;
            before += weights[index] as u32;
            index += 1;
        }
        Self { below, seen: 0 }
    }

    /// Returns the first slot of `symbol` (0..16) and its number of slots.
    #[inline]
    fn slots(&self, symbol: u32) -> (u32, u32) {
        let start = |symbol: u32| self.below[symbol as usize & 15] as u32 + symbol;
        let end = if symbol >= 15 { SCALE } else { start(symbol + 1) };
        (start(symbol), end - start(symbol))
    }

    /// Returns the cost of `symbol` (1/64 bit).
    #[inline]
    pub fn cost(&self, symbol: u32) -> u32 {
        cost_of(self.slots(symbol).1)
    }

    #[inline]
    fn symbol_at(&self, slot: u32) -> u32 {
        let slot = slot as i16;
        let passed = |(symbol, &below): (usize, &i16)| (below + symbol as i16 <= slot) as i16;
        self.below.iter().enumerate().map(passed).sum::<i16>() as u32 - 1
    }

    #[inline]
    pub fn learn(&mut self, symbol: u32) {
        let rate = RATES[self.seen as usize & 15] as u32;
        self.seen = (self.seen + 1).min(15);
        let symbol = symbol as i16;
        for (index, below) in self.below.iter_mut().enumerate() {
            let up = ((SCALE - 16) as i16 - *below) >> rate;
            let down = *below >> rate;
            *below += if index as i16 > symbol { up } else { -down };
        }
    }
}

/// Units per bit in which costs are counted.
pub const COST_BIT: u32 = 64;
/// log₂(1 + i/64), in 1/64.
const LOG: [u8; 64] = {
    let (mut table, mut at) = ([0; 64], 0);
    while at < 64 {
        // Squaring doubles the logarithm, which yields its bits in turn.
        let (mut power, mut bits, mut rounds) = ((64 + at as u64) << 24, 0u8, 0);
        while rounds < 6 {
            power = (power * power) >> 30;
            bits <<= 1;
            if power >= 2 << 30 {
                power >>= 1;
                bits |= 1;
            }
            rounds += 1;
        }
        table[at] = bits;
        at += 1;
    }
    table
};

/// Returns the cost of a symbol with `count` slots (1/64 bit).
#[inline]
fn cost_of(count: u32) -> u32 {
    SCALE_BITS * COST_BIT - log(count)
}

/// Returns the binary logarithm of `count`, rounded down to 1/64.
#[inline]
fn log(count: u32) -> u32 {
    let whole = count.ilog2();
    // The six bits below the highest.
    let fraction = LOG[(count >> whole.saturating_sub(6) << 6u32.saturating_sub(whole)) as usize & 63];
    whole * COST_BIT + u32::from(fraction)
}

/// Adaptive probability of a bit.
#[derive(Debug, Clone)]
pub struct Bit {
    /// Slots of a one, out of `SCALE`; they are the highest.
    ones: u16,
    seen: u8,
}

impl Bit {
    /// Creates the model of a bit that is one with probability `ones / 32768`; `ones` is 32 to 32736.
    pub const fn new(ones: u16) -> Self {
        Self { ones, seen: 0 }
    }

    #[inline]
    fn slots(&self, bit: bool) -> (u32, u32) {
        let ones = self.ones as u32;
        if bit { (SCALE - ones, ones) } else { (0, SCALE - ones) }
    }

    #[inline]
    fn learn(&mut self, bit: bool) {
        let rate = BIT_RATES[self.seen as usize & 15] as u32;
        self.seen = (self.seen + 1).min(15);
        if bit {
            self.ones += ((SCALE as u16 - BIT_FLOOR) - self.ones) >> rate;
        } else {
            self.ones -= (self.ones - BIT_FLOOR) >> rate;
        }
    }
}

/// Encoder or decoder. An encoder writes the given value and returns it; a decoder ignores it and returns the value
/// read.
pub trait Coder {
    /// Codes a symbol below 16.
    fn nibble(&mut self, model: &mut Nibble, symbol: u32) -> u32;
    /// Codes a bit.
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool;
    /// Codes `bits` bits (1..=15) of equal probability.
    fn raw(&mut self, bits: u32, value: u32) -> u32;
}

/// Writes symbols; reusable.
#[derive(Debug, Default)]
pub struct RansEncoder {
    /// First slot and number of slots of each symbol, buffered because symbols are encoded in reverse.
    slots: Vec<(u16, u16)>,
    words: Vec<u16>,
}

/// ⌊2⁶⁴ / n⌋ + 1 for each number `n` of slots, and 2⁶⁴ − 1 for 1, to divide by multiplication. Computed on first use
/// and shared by all encoders (256 KiB).
static INVERSES: OnceLock<Vec<u64>> = OnceLock::new();

pub(super) fn inverses() -> &'static [u64] {
    let inverse = |count: u64| if count < 2 { u64::MAX } else { ((1 << 64) / u128::from(count) + 1) as u64 };
    INVERSES.get_or_init(|| (0..=u64::from(SCALE)).map(inverse).collect())
}

/// Returns `state / count` by the inverse of `count` (1..=`SCALE`). The error is below `state / 2⁶⁴`, and no quotient
/// is closer than `1 / SCALE` below the next whole number. For a `count` of 1 the result is one too small.
#[inline]
fn quotient(state: u32, inverse: u64) -> u32 {
    ((u128::from(state) * u128::from(inverse)) >> 64) as u32
}

/// Returns the state after a symbol with these slots (first, number); words must have been emitted before.
#[inline]
pub(super) fn pushed(state: u32, (start, count): (u32, u32), inverses: &[u64]) -> u32 {
    // Compensates for the quotient that is one too small.
    let start = start + if count == 1 { SCALE - 1 } else { 0 };
    state + start + quotient(state, inverses[count as usize]) * (SCALE - count)
}

impl RansEncoder {
    /// Drops all symbols.
    pub fn clear(&mut self) {
        self.slots.clear();
    }

    /// Appends the bytes of all symbols since [`clear`](Self::clear): the state (u32), then its words (u16).
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        let Self { slots, words, .. } = self;
        let inverses = inverses();
        words.resize(slots.len(), 0);
        let (mut state, mut length) = (LOW, 0);
        for &(start, count) in slots.iter().rev() {
            let slots = (u32::from(start), u32::from(count));
            // Whether a word is emitted is hard to predict, so write it always and count it if it is.
            words[length] = state as u16;
            let goes_out = u64::from(state) >= u64::from(count) << 17;
            length += usize::from(goes_out);
            state = if goes_out { state >> 16 } else { state };
            state = pushed(state, slots, inverses);
        }
        out.extend(state.to_le_bytes());
        out.extend(words[..length].iter().rev().flat_map(|word| word.to_le_bytes()));
    }

    #[inline]
    fn push(&mut self, (start, count): (u32, u32)) {
        self.slots.push((start as u16, count as u16));
    }
}

impl Coder for RansEncoder {
    #[inline]
    fn nibble(&mut self, model: &mut Nibble, symbol: u32) -> u32 {
        self.push(model.slots(symbol));
        model.learn(symbol);
        symbol
    }

    #[inline]
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool {
        self.push(model.slots(bit));
        model.learn(bit);
        bit
    }

    #[inline]
    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        debug_assert!((1..=MAX_RAW_BITS).contains(&bits) && value >> bits == 0);
        let shift = SCALE_BITS - bits;
        self.push((value << shift, 1 << shift));
        value
    }
}

/// Reads symbols from untrusted bytes. Reading past the end gives arbitrary symbols, and an error from
/// [`finish`](Self::finish).
#[derive(Debug)]
pub struct RansDecoder<'a> {
    state: u32,
    words: &'a [[u8; 2]],
    short: bool,
}

impl<'a> RansDecoder<'a> {
    /// Starts reading what [`RansEncoder::finish`] wrote. Fewer than 4 bytes, an odd number, or a state that is too low
    /// break `rule`.
    pub fn new(bytes: &'a [u8], rule: &'static str) -> Result<Self, Violation> {
        let wrong = || Violation::new(rule, "a state of 4 bytes, 65536 or more, and whole words", bytes.len());
        let (state, words) = bytes.split_first_chunk::<4>().ok_or_else(wrong)?;
        let (words, odd) = words.as_chunks::<2>();
        let state = u32::from_le_bytes(*state);
        if state < LOW || !odd.is_empty() {
            return Err(wrong());
        }
        Ok(Self { state, words, short: false })
    }

    /// Checks that all words were read and the state is back at its initial value. Anything else breaks `rule`.
    pub fn finish(self, rule: &'static str) -> Result<(), Violation> {
        if self.short || !self.words.is_empty() || self.state != LOW {
            let found = if self.short { "too few".into() } else { format!("{} words left", self.words.len()) };
            return Err(Violation::new(rule, "as many bytes as the page's symbols need", found));
        }
        Ok(())
    }

    #[inline]
    fn slot(&self) -> u32 {
        self.state & (SCALE - 1)
    }

    #[inline]
    fn take(&mut self, (start, count): (u32, u32)) {
        self.state = count * (self.state >> SCALE_BITS) + self.slot() - start;
        if self.state < LOW {
            let word = match self.words.split_first() {
                Some((word, rest)) => {
                    self.words = rest;
                    u16::from_le_bytes(*word)
                }
                None => {
                    self.short = true;
                    0
                }
            };
            self.state = self.state << 16 | word as u32;
        }
    }
}

impl Coder for RansDecoder<'_> {
    #[inline]
    fn nibble(&mut self, model: &mut Nibble, _: u32) -> u32 {
        let symbol = model.symbol_at(self.slot());
        self.take(model.slots(symbol));
        model.learn(symbol);
        symbol
    }

    #[inline]
    fn bit(&mut self, model: &mut Bit, _: bool) -> bool {
        let bit = self.slot() >= SCALE - model.ones as u32;
        self.take(model.slots(bit));
        model.learn(bit);
        bit
    }

    #[inline]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        let shift = SCALE_BITS - bits;
        let value = self.slot() >> shift;
        self.take((value << shift, 1 << shift));
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn multiplying_by_an_inverse_is_dividing() {
        let of_all = inverses();
        for count in 1..=SCALE {
            let multiples = [1, 2, 3, u32::MAX / count / 2, u32::MAX / count].map(|times| times * count);
            let around = multiples.into_iter().flat_map(|at| [at - 1, at, at.saturating_add(1)]);
            for state in around.chain([LOW, u32::MAX]).filter(|&state| state > 0) {
                let found = quotient(state, of_all[count as usize]) + u32::from(count == 1);
                assert_eq!(found, state / count, "{state} / {count}");
            }
        }
    }

    #[test]
    fn states_begin_at_the_lowest_that_coding_ends_in() {
        let lowest = LOW.to_le_bytes();
        assert_eq!(RansDecoder::new(&lowest, "P2").unwrap().finish("P2"), Ok(()));
        assert!(RansDecoder::new(&(LOW - 1).to_le_bytes(), "P2").is_err());
    }

    #[test]
    fn costs_are_logarithms() {
        for count in 1..=SCALE {
            let exact = f64::from(COST_BIT) * (f64::from(SCALE) / f64::from(count)).log2();
            assert!((f64::from(cost_of(count)) - exact).abs() < 2.5, "{count}");
        }
    }

    #[derive(Debug, Clone)]
    enum Symbol {
        Nibble(usize, u32),
        Bit(usize, bool),
        Raw(u32, u32),
    }

    fn symbols() -> impl Strategy<Value = Vec<Symbol>> {
        let one = prop_oneof![
            (0usize..3, prop_oneof![Just(0u32), Just(15), 0u32..16]).prop_map(|(model, s)| Symbol::Nibble(model, s)),
            (0usize..3, proptest::bool::weighted(0.05)).prop_map(|(model, bit)| Symbol::Bit(model, bit)),
            (1u32..=MAX_RAW_BITS, any::<u32>()).prop_map(|(bits, value)| Symbol::Raw(bits, value & ((1 << bits) - 1))),
        ];
        proptest::collection::vec(one, 0..600)
    }

    fn run(coder: &mut impl Coder, symbols: &[Symbol], mut each: impl FnMut(&Symbol, u32)) {
        let mut nibbles = [const { Nibble::new([1; 16]) }; 3];
        let mut bits = [const { Bit::new(1 << 14) }; 3];
        for symbol in symbols {
            let value = match *symbol {
                Symbol::Nibble(model, value) => coder.nibble(&mut nibbles[model], value),
                Symbol::Bit(model, bit) => u32::from(coder.bit(&mut bits[model], bit)),
                Symbol::Raw(bits, value) => coder.raw(bits, value),
            };
            each(symbol, value);
        }
    }

    proptest! {
        #[test]
        fn gives_back_all_symbols_and_ends_where_it_began(symbols in symbols()) {
            let (mut encoder, mut bytes) = (RansEncoder::default(), Vec::new());
            run(&mut encoder, &symbols, |_, _| {});
            encoder.finish(&mut bytes);
            let mut decoder = RansDecoder::new(&bytes, "P6").unwrap();
            run(&mut decoder, &symbols, |symbol, value| match *symbol {
                Symbol::Nibble(_, expected) | Symbol::Raw(_, expected) => assert_eq!(value, expected),
                Symbol::Bit(_, expected) => assert_eq!(value != 0, expected),
            });
            prop_assert_eq!(decoder.finish("P6"), Ok(()));
            for changed in [[&bytes[..], &[0; 2]].concat(), bytes[..bytes.len() - 2].to_vec()] {
                let Ok(mut decoder) = RansDecoder::new(&changed, "P6") else { continue };
                run(&mut decoder, &symbols, |_, _| {});
                prop_assert!(decoder.finish("P6").is_err());
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100), symbols in symbols()) {
            if let Ok(mut decoder) = RansDecoder::new(&bytes, "P6") {
                run(&mut decoder, &symbols, |symbol, value| match symbol {
                    Symbol::Nibble(..) => assert!(value < 16),
                    Symbol::Bit(..) => {}
                    Symbol::Raw(bits, _) => assert!(value >> bits == 0),
                });
            }
        }
    }

    #[test]
    fn every_symbol_keeps_a_slot_however_often_another_comes() {
        for often in 0..16 {
            let mut model = Nibble::new([1; 16]);
            for _ in 0..2000 {
                model.learn(often);
                let ends: Vec<_> = (0..16).map(|symbol| model.slots(symbol)).collect();
                assert!(ends.iter().all(|&(_, count)| count > 0));
                assert!(ends.windows(2).all(|pair| pair[0].0 + pair[0].1 == pair[1].0));
                assert_eq!((ends[0].0, ends[15].0 + ends[15].1), (0, SCALE));
            }
            assert!(model.slots(often).1 > SCALE * 9 / 10);
        }
    }

    #[test]
    fn common_symbols_take_a_small_part_of_a_bit() {
        let (mut encoder, mut bytes) = (RansEncoder::default(), Vec::new());
        run(&mut encoder, &vec![Symbol::Nibble(0, 3); 10_000], |_, _| {});
        encoder.finish(&mut bytes);
        assert!(bytes.len() < 10_000 / 8 / 10, "{} bytes", bytes.len());
    }
}
