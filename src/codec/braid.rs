//! Entropy coding in two strands: the ideas of [`super::rans`], arranged for a processor that does several things at once
//! (specification, section 6.7).
//!
//! Symbols belong to one of two states whose words lie in one list, in the order in which they are wanted: while one state waits
//! for a table, the other goes on. Bits that no model could foretell lie apart, from the end of the bytes backwards, and cost a
//! shift. Nothing branches on what is read: a symbol is found by comparing it with all 16 bounds at once.

use super::Violation;
use super::rans::{SCALE, SCALE_BITS, inverses, pushed};

/// Least state between two symbols, and the states that coding starts from.
const LOW: u32 = 1 << 16;
/// Bytes of the two states.
const STATES: usize = 8;
/// Most bits that [`Strands::raw`] takes.
pub const MAX_RAW_BITS: u32 = 28;

/// How fast models learn: bounds move by 1/2ⁿ of the way, `n` by the symbols seen so far.
const RATES: [u8; 16] = [3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 6];
const BIT_RATES: [u8; 16] = [1, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5];
/// Least probability of a bit's rarer value.
const BIT_FLOOR: i32 = 32;

/// Adaptive probabilities of 16 symbols: 32 bytes, so that a model never crosses a line of the cache.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub struct Nibble {
    /// First slot of each symbol. That of the first is always 0; in its place stands how many symbols were seen.
    starts: [i16; 16],
}

/// Where the bounds of a model go when symbol `n` comes: all slots but one each to it.
static TARGETS: [Nibble; 16] = {
    let (mut targets, mut at) = ([Nibble { starts: [0; 16] }; 16], 0);
    while at < 256 {
        let (symbol, index) = (at / 16, at % 16);
        targets[symbol].starts[index] = if index > symbol { (SCALE - 16 + index as u32) as i16 } else { index as i16 };
        at += 1;
    }
    targets
};

impl Nibble {
    /// Probabilities in proportion to `weights`.
    pub const fn new(weights: [u16; 16]) -> Self {
        let (mut sum, mut index) = (0, 0);
        while index < 16 {
            sum += weights[index] as u32;
            index += 1;
        }
        let (mut starts, mut before) = ([0; 16], weights[0] as u32);
        index = 1;
        while index < 16 {
            starts[index] = (before * (SCALE - 16) / sum + index as u32) as i16;
            before += weights[index] as u32;
            index += 1;
        }
        Self { starts }
    }

    /// First slot of `symbol` [0..16] and the number of its slots.
    #[inline(always)]
    fn slots(&self, symbol: u32) -> (u32, u32) {
        let symbol = symbol as usize & 15;
        let start = if symbol == 0 { 0 } else { self.starts[symbol] as u32 };
        let end = if symbol == 15 { SCALE } else { self.starts[symbol + 1] as u32 };
        (start, end - start)
    }

    #[inline(always)]
    fn symbol_at(&self, slot: u32) -> u32 {
        let above = lanes::above(&self.starts, slot as i16);
        // The first number is none of the bounds.
        (above & !1 | 1 << 16).trailing_zeros() - 1
    }

    #[inline(always)]
    fn learn(&mut self, symbol: u32) {
        let seen = self.starts[0] as usize & 15;
        lanes::approach(&mut self.starts, &TARGETS[symbol as usize & 15].starts, RATES[seen]);
        self.starts[0] = (seen as i16 + 1).min(15);
    }
}

/// Adaptive probability of a bit.
#[derive(Debug, Clone, Copy)]
pub struct Bit {
    /// Slots, of `SCALE`, of a one; they are the highest.
    ones: u16,
    seen: u16,
}

impl Bit {
    /// A bit that is one with probability `ones / 32768`, between 32 and 32736.
    pub const fn new(ones: u16) -> Self {
        Self { ones, seen: 0 }
    }

    /// First slot of `bit` and the number of its slots.
    #[inline(always)]
    fn slots(&self, bit: bool) -> (u32, u32) {
        let ones = u32::from(self.ones);
        if bit { (SCALE - ones, ones) } else { (0, SCALE - ones) }
    }

    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        let rate = BIT_RATES[usize::from(self.seen) & 15];
        self.seen = (self.seen + 1).min(15);
        let target = if bit { SCALE as i32 - BIT_FLOOR } else { BIT_FLOOR };
        let ones = i32::from(self.ones);
        self.ones = (ones + ((target - ones) >> rate)) as u16;
    }
}

/// One end of the coding: takes the value to write and returns it, or takes any and returns the one read. `S` [0..2] is the strand
/// that a symbol belongs to.
pub trait Strands {
    /// Whether values are taken.
    const WRITES: bool;
    /// A symbol below 16.
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, symbol: u32) -> u32;
    /// A bit.
    fn bit<const S: usize>(&mut self, model: &mut Bit, bit: bool) -> bool;
    /// `bits` bits [0..=`MAX_RAW_BITS`] of equal probability.
    fn raw(&mut self, bits: u32, value: u32) -> u32;
}

/// Writes symbols; reusable.
#[derive(Debug, Default)]
pub struct BraidEncoder {
    /// First slot, strand (bit 15) and number of slots (from bit 16) of each symbol. What is decoded first is encoded last, so they wait here.
    symbols: Vec<u32>,
    words: Vec<u16>,
    /// Raw bits, lowest first; those that make no four bytes yet wait in `rest`.
    bytes: Vec<u8>,
    rest: u64,
    rest_bits: u32,
}

impl BraidEncoder {
    /// Forgets all symbols.
    pub fn clear(&mut self) {
        self.symbols.clear();
        self.bytes.clear();
        (self.rest, self.rest_bits) = (0, 0);
    }

    /// Appends the bytes of all symbols since [`clear`](Self::clear): the states (u32 each), their words (u16), the raw bits backwards.
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        let Self { symbols, words, bytes, rest, rest_bits } = self;
        let inverses = inverses();
        words.resize(symbols.len() + 1, 0);
        let (mut states, mut length) = ([LOW; 2], 0);
        for &symbol in symbols.iter().rev() {
            let (start, strand, count) = (symbol & (SCALE - 1), symbol as usize >> 15 & 1, symbol >> 16);
            let mut state = states[strand];
            // Whether a word goes out is hard to foresee, so each is written, and stays if it is to.
            words[length] = state as u16;
            let goes_out = u64::from(state) >= u64::from(count) << 17;
            length += usize::from(goes_out);
            state = if goes_out { state >> 16 } else { state };
            states[strand] = pushed(state, (start, count), inverses);
        }
        out.extend(states.iter().flat_map(|state| state.to_le_bytes()));
        out.extend(words[..length].iter().rev().flat_map(|word| word.to_le_bytes()));
        bytes.extend(&rest.to_le_bytes()[..rest_bits.div_ceil(8) as usize]);
        out.extend(bytes.iter().rev());
    }

    #[inline(always)]
    fn push<const S: usize>(&mut self, (start, count): (u32, u32)) {
        self.symbols.push(start | (S as u32) << 15 | count << 16);
    }
}

impl Strands for BraidEncoder {
    const WRITES: bool = true;

    #[inline(always)]
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, symbol: u32) -> u32 {
        self.push::<S>(model.slots(symbol));
        model.learn(symbol);
        symbol
    }

    #[inline(always)]
    fn bit<const S: usize>(&mut self, model: &mut Bit, bit: bool) -> bool {
        self.push::<S>(model.slots(bit));
        model.learn(bit);
        bit
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        debug_assert!(bits <= MAX_RAW_BITS && value >> bits == 0);
        self.rest |= u64::from(value) << self.rest_bits;
        self.rest_bits += bits;
        if self.rest_bits >= 32 {
            self.bytes.extend((self.rest as u32).to_le_bytes());
            self.rest >>= 32;
            self.rest_bits -= 32;
        }
        value
    }
}

/// Reads symbols from bytes that nobody vouches for: reading beyond the end gives some symbols, and an error at the end.
#[derive(Debug)]
pub struct BraidDecoder<'a> {
    states: [u32; 2],
    bytes: &'a [u8],
    /// Where the next word lies, and how many raw bits were read.
    at: usize,
    bits: usize,
}

impl<'a> BraidDecoder<'a> {
    /// Reads what [`BraidEncoder::finish`] wrote; fewer than 8 bytes or a state too low break `rule`.
    pub fn new(bytes: &'a [u8], rule: &'static str) -> Result<Self, Violation> {
        let wrong = || Violation::new(rule, "two states of 4 bytes, 65536 or more each", bytes.len());
        let (states, _) = bytes.split_first_chunk::<STATES>().ok_or_else(wrong)?;
        let states = u64::from_le_bytes(*states);
        let states = [states as u32, (states >> 32) as u32];
        if states.iter().any(|&state| state < LOW) {
            return Err(wrong());
        }
        Ok(Self { states, bytes, at: STATES, bits: 0 })
    }

    /// Requires that words and raw bits fill the bytes, with zeros up to a whole byte between them, and that the states are back where
    /// coding began; otherwise breaks `rule`.
    pub fn finish(self, rule: &'static str) -> Result<(), Violation> {
        let len = self.bytes.len();
        let used = self.at + self.bits.div_ceil(8);
        let unused =
            if used == len && !self.bits.is_multiple_of(8) { self.bytes[self.at] >> (self.bits % 8) } else { 0 };
        if used != len || unused != 0 || self.states != [LOW; 2] {
            let found = if used == len { "others".into() } else { format!("{used} needed of {len}") };
            return Err(Violation::new(rule, "the bytes that the page's symbols need", found));
        }
        Ok(())
    }

    #[inline(always)]
    fn slot<const S: usize>(&self) -> u32 {
        self.states[S] & (SCALE - 1)
    }

    #[inline(always)]
    fn take<const S: usize>(&mut self, (start, count): (u32, u32)) {
        let state = count * (self.states[S] >> SCALE_BITS) + self.slot::<S>() - start;
        let word =
            self.bytes.get(self.at..).and_then(|rest| rest.first_chunk()).map_or(0, |word| u16::from_le_bytes(*word));
        // Whether a word is wanted is hard to foresee, so one is always read.
        let wants = state < LOW;
        self.at += 2 * usize::from(wants);
        let longer = state << 16 | u32::from(word);
        self.states[S] = if wants { longer } else { state };
    }

    /// The 64 bits from bit `self.bits` on, less up to 7.
    #[inline(always)]
    fn window(&self) -> u64 {
        let end = self.bytes.len().saturating_sub(self.bits / 8);
        let before = &self.bytes[..end];
        let bits = before.last_chunk().map(|last| u64::from_be_bytes(*last));
        bits.unwrap_or_else(|| before.iter().fold(0, |bits, &byte| bits << 8 | u64::from(byte))) >> (self.bits % 8)
    }
}

impl Strands for BraidDecoder<'_> {
    const WRITES: bool = false;

    // A browser loads all code before the first picture; a copy for each place costs it more than the calls.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, _: u32) -> u32 {
        let symbol = model.symbol_at(self.slot::<S>());
        self.take::<S>(model.slots(symbol));
        model.learn(symbol);
        symbol
    }

    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn bit<const S: usize>(&mut self, model: &mut Bit, _: bool) -> bool {
        let bit = self.slot::<S>() >= SCALE - u32::from(model.ones);
        self.take::<S>(model.slots(bit));
        model.learn(bit);
        bit
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        let value = self.window() & ((1 << bits) - 1);
        self.bits += bits as usize;
        value as u32
    }
}

/// Sixteen numbers at once.
mod lanes {
    #[cfg(target_arch = "x86_64")]
    pub use self::sse2::{above, approach};
    #[cfg(not(target_arch = "x86_64"))]
    pub use portable::{above, approach};

    /// The same for every processor.
    #[cfg(any(test, not(target_arch = "x86_64")))]
    pub mod portable {
        /// Which of `all` are greater than `one`: bit `n` for number `n`.
        #[inline(always)]
        pub fn above(all: &[i16; 16], one: i16) -> u32 {
            all.iter().rev().fold(0, |above, &number| above << 1 | u32::from(number > one))
        }

        /// Moves each of `all` by 1/2ʳᵃᵗᵉ of the way to that of `targets`, rounded down.
        #[inline(always)]
        pub fn approach(all: &mut [i16; 16], targets: &[i16; 16], rate: u8) {
            for (number, target) in all.iter_mut().zip(targets) {
                *number += (target - *number) >> rate;
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    mod sse2 {
        use std::arch::x86_64::{
            __m128i, _mm_add_epi16, _mm_cmpgt_epi16, _mm_cvtsi32_si128, _mm_loadu_si128, _mm_movemask_epi8,
            _mm_packs_epi16, _mm_set1_epi16, _mm_sra_epi16, _mm_storeu_si128, _mm_sub_epi16,
        };

        #[inline(always)]
        fn load(all: &[i16; 16]) -> [__m128i; 2] {
            let first = all.as_ptr().cast::<__m128i>();
            // SAFETY: 16 numbers are two times 16 bytes, read wherever they lie; every x86-64 has SSE2.
            unsafe { [_mm_loadu_si128(first), _mm_loadu_si128(first.add(1))] }
        }

        #[inline(always)]
        pub fn above(all: &[i16; 16], one: i16) -> u32 {
            let [low, high] = load(all);
            // SAFETY: every x86-64 has SSE2.
            unsafe {
                let one = _mm_set1_epi16(one);
                _mm_movemask_epi8(_mm_packs_epi16(_mm_cmpgt_epi16(low, one), _mm_cmpgt_epi16(high, one))) as u32
            }
        }

        #[inline(always)]
        pub fn approach(all: &mut [i16; 16], targets: &[i16; 16], rate: u8) {
            let (numbers, targets) = (load(all), load(targets));
            let first = all.as_mut_ptr().cast::<__m128i>();
            // SAFETY: 16 numbers are two times 16 bytes, written where they were read; every x86-64 has SSE2.
            unsafe {
                let rate = _mm_cvtsi32_si128(i32::from(rate));
                for half in 0..2 {
                    let way = _mm_sra_epi16(_mm_sub_epi16(targets[half], numbers[half]), rate);
                    _mm_storeu_si128(first.add(half), _mm_add_epi16(numbers[half], way));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
            (0u32..=MAX_RAW_BITS, any::<u32>()).prop_map(|(bits, value)| Symbol::Raw(bits, value & ((1 << bits) - 1))),
        ];
        proptest::collection::vec(one, 0..600)
    }

    /// Symbols of models 0 and 2 go to strand 0, of model 1 to strand 1.
    fn run(coder: &mut impl Strands, symbols: &[Symbol], mut each: impl FnMut(&Symbol, u32)) {
        let mut nibbles = [const { Nibble::new([1; 16]) }; 3];
        let mut bits = [const { Bit::new(1 << 14) }; 3];
        for symbol in symbols {
            let value = match *symbol {
                Symbol::Nibble(1, value) => coder.nibble::<1>(&mut nibbles[1], value),
                Symbol::Nibble(model, value) => coder.nibble::<0>(&mut nibbles[model], value),
                Symbol::Bit(1, bit) => u32::from(coder.bit::<1>(&mut bits[1], bit)),
                Symbol::Bit(model, bit) => u32::from(coder.bit::<0>(&mut bits[model], bit)),
                Symbol::Raw(bits, value) => coder.raw(bits, value),
            };
            each(symbol, value);
        }
    }

    proptest! {
        #[test]
        fn gives_back_all_symbols_and_ends_where_it_began(symbols in symbols()) {
            let (mut encoder, mut bytes) = (BraidEncoder::default(), Vec::new());
            for _ in 0..2 {
                bytes.clear();
                encoder.clear();
                run(&mut encoder, &symbols, |_, _| {});
                encoder.finish(&mut bytes);
            }
            let mut decoder = BraidDecoder::new(&bytes, "P6").unwrap();
            run(&mut decoder, &symbols, |symbol, value| match *symbol {
                Symbol::Nibble(_, expected) | Symbol::Raw(_, expected) => assert_eq!(value, expected),
                Symbol::Bit(_, expected) => assert_eq!(value != 0, expected),
            });
            prop_assert_eq!(decoder.finish("P6"), Ok(()));
            for changed in [[&bytes[..8], &[0], &bytes[8..]].concat(), [&bytes[..], &[0]].concat(), bytes[..bytes.len() - 1].to_vec()] {
                let Ok(mut decoder) = BraidDecoder::new(&changed, "P6") else { continue };
                run(&mut decoder, &symbols, |_, _| {});
                prop_assert!(decoder.finish("P6").is_err());
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100), symbols in symbols()) {
            if let Ok(mut decoder) = BraidDecoder::new(&bytes, "P6") {
                run(&mut decoder, &symbols, |symbol, value| match symbol {
                    Symbol::Nibble(..) => assert!(value < 16),
                    Symbol::Bit(..) => {}
                    Symbol::Raw(bits, _) => assert!(value >> bits == 0),
                });
                let _ = decoder.finish("P6");
            }
        }

        #[test]
        fn processors_agree(mut all: [i16; 16], targets: [i16; 16], one: i16, rate in 0u8..8) {
            prop_assert_eq!(lanes::above(&all, one), lanes::portable::above(&all, one));
            // Bounds and targets are slots: their differences fit.
            let slots = |all: [i16; 16]| all.map(|slot| slot & i16::MAX);
            let (targets, mut same) = (slots(targets), slots(all));
            all = same;
            lanes::approach(&mut all, &targets, rate);
            lanes::portable::approach(&mut same, &targets, rate);
            prop_assert_eq!(all, same);
        }
    }

    #[test]
    fn every_symbol_keeps_a_slot_however_often_another_comes() {
        for often in 0..16 {
            let mut model = Nibble::new([1; 16]);
            for round in 0..4000u32 {
                // Now and then any other, so that bounds move both ways.
                model.learn(if round % 50 == 7 { round / 50 % 16 } else { often });
                let ends: Vec<_> = (0..16).map(|symbol| model.slots(symbol)).collect();
                assert!(ends.iter().all(|&(_, count)| count > 0 && count < SCALE), "{ends:?}");
                assert!(ends.windows(2).all(|pair| pair[0].0 + pair[0].1 == pair[1].0));
                assert_eq!((ends[0].0, ends[15].0 + ends[15].1), (0, SCALE));
                let found = |slot: u32| (0..16).rfind(|&symbol| ends[symbol].0 <= slot).unwrap() as u32;
                for slot in [0, 1, ends[often as usize].0, ends[often as usize].0.saturating_sub(1), SCALE - 1] {
                    assert_eq!(model.symbol_at(slot), found(slot));
                }
            }
        }
    }

    #[test]
    fn a_bit_keeps_both_values_possible() {
        for often in [false, true] {
            let mut bit = Bit::new(1 << 14);
            (0..2000).for_each(|_| bit.learn(often));
            assert!((32..=64).contains(&bit.slots(!often).1), "{bit:?}");
        }
    }
}
