//! Interleaved rANS: the entropy coding of [`super::rans`] with two states, for processors with parallel units
//! (specification, chapter 6).
//!
//! Each symbol belongs to one of two states. Both take words from one list, in the order in which they need them; while
//! one state waits for memory, the other proceeds. Bits that no model can predict are stored separately, backwards from
//! the end of the bytes, and cost a shift. No branch depends on decoded data: a symbol is found by comparing its slot
//! with all 16 bounds at once.

mod lanes;

use super::Violation;
use super::rans::{SCALE, SCALE_BITS, inverses, pushed};
#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
pub use lanes::Avx2;
use lanes::TARGETS;
pub use lanes::{Base, Lanes};
use std::hint::select_unpredictable;

/// Smallest state between two symbols, and the initial states.
const LOW: u32 = 1 << 16;
/// Bytes of the two states.
const STATES: usize = 8;
/// Most bits of one [`Strands::raw`].
pub const MAX_RAW_BITS: u32 = 28;

/// Learning rates: bounds move by 1/2ⁿ of the distance, with `n` by the number of symbols seen.
const RATES: [u8; 16] = [3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 6];
const BIT_RATES: [u8; 16] = [1, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5];
/// Number of symbols seen after one more; counting stops at 15.
const ONE_MORE: [u8; 16] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 15];
/// Smallest number of slots of a bit's rarer value.
const BIT_FLOOR: i32 = 32;

/// Adaptive probabilities of 16 symbols, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub struct Nibble {
    /// First slot of each symbol, 0 for the first, and the end of the last one.
    slots: [i16; 17],
    /// Number of symbols seen, up to 15.
    seen: u8,
}

impl Nibble {
    /// Creates a model with probabilities proportional to `weights`.
    pub const fn new(weights: [u16; 16]) -> Self {
        let (mut sum, mut index) = (0, 0);
        while index < 16 {
            sum += weights[index] as u32;
            index += 1;
        }
        let (mut slots, mut before) = ([0; 17], weights[0] as u32);
        index = 1;
        while index < 16 {
            slots[index] = (before * (SCALE - 16) / sum + index as u32) as i16;
            before += weights[index] as u32;
            index += 1;
        }
        slots[16] = SCALE as i16;
        Self { slots, seen: 0 }
    }

    /// Returns the first slot of `symbol` (0..16) and its number of slots.
    #[inline(always)]
    fn slots(&self, symbol: u32) -> (u32, u32) {
        let symbol = symbol as usize & 15;
        let slot = |symbol: usize| u32::from(self.slots[symbol] as u16);
        (slot(symbol), slot(symbol + 1) - slot(symbol))
    }

    #[inline(always)]
    fn symbol_at(&self, lanes: impl Lanes, slot: u32) -> u32 {
        let [_, ends @ ..] = &self.slots;
        lanes.symbol(ends, slot as i16)
    }

    #[inline(always)]
    fn learn(&mut self, lanes: impl Lanes, symbol: u32) {
        let [_, ends @ ..] = &mut self.slots;
        let seen = usize::from(self.seen) & 15;
        lanes.approach(ends, &TARGETS[symbol as usize & 15], RATES[seen]);
        self.seen = ONE_MORE[seen];
    }
}

/// Adaptive probability of a bit.
#[derive(Debug, Clone, Copy)]
pub struct Bit {
    /// Slots of a one, out of `SCALE`; they are the highest.
    ones: u16,
    /// Number of bits seen, up to 15.
    seen: u8,
}

impl Bit {
    /// Creates the model of a bit that is one with probability `ones / 32768`; `ones` is 32 to 32736.
    pub const fn new(ones: u16) -> Self {
        Self { ones, seen: 0 }
    }

    /// Returns the first slot of `bit` and its number of slots.
    #[inline(always)]
    fn slots(&self, bit: bool) -> (u32, u32) {
        let ones = u32::from(self.ones);
        // The bit is unpredictable, so avoid a branch.
        (select_unpredictable(bit, SCALE - ones, 0), select_unpredictable(bit, ones, SCALE - ones))
    }

    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        let seen = usize::from(self.seen) & 15;
        self.seen = ONE_MORE[seen];
        let target = select_unpredictable(bit, SCALE as i32 - BIT_FLOOR, BIT_FLOOR);
        let ones = i32::from(self.ones);
        self.ones = (ones + ((target - ones) >> BIT_RATES[seen])) as u16;
    }
}

/// Encoder or decoder. An encoder writes the given value and returns it; a decoder ignores it and returns the value
/// read. `S` (0..2) is the state that a symbol belongs to.
pub trait Strands {
    /// True for an encoder.
    const WRITES: bool;
    /// Codes a symbol below 16.
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, symbol: u32) -> u32;
    /// Codes a bit.
    fn bit<const S: usize>(&mut self, model: &mut Bit, bit: bool) -> bool;
    /// Codes `bits` bits (0..=`MAX_RAW_BITS`) of equal probability.
    fn raw(&mut self, bits: u32, value: u32) -> u32;
    /// Loads words. Must precede every four symbols and bits, each of which takes at most one word.
    fn refill(&mut self) {}
}

/// Writes symbols; reusable.
#[derive(Debug, Default)]
pub struct InterleavedEncoder<L = Base> {
    lanes: L,
    /// First slot, state (bit 15) and number of slots (from bit 16) of each symbol, buffered because symbols are
    /// encoded in reverse.
    symbols: Vec<u32>,
    words: Vec<u16>,
    /// Raw bits, lowest first; up to 31 bits that do not fill four bytes yet are in `rest`.
    bytes: Vec<u8>,
    rest: u64,
    rest_bits: u32,
}

impl<L: Lanes> InterleavedEncoder<L> {
    /// Returns this encoder for a processor with `lanes`.
    pub fn with_lanes<M: Lanes>(self, lanes: M) -> InterleavedEncoder<M> {
        let Self { symbols, words, bytes, rest, rest_bits, .. } = self;
        InterleavedEncoder { lanes, symbols, words, bytes, rest, rest_bits }
    }

    /// Drops all symbols.
    pub fn clear(&mut self) {
        self.symbols.clear();
        self.bytes.clear();
        (self.rest, self.rest_bits) = (0, 0);
    }

    /// Appends the bytes of all symbols since [`clear`](Self::clear): the states (u32 each), their words (u16), the raw
    /// bits backwards.
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        let Self { symbols, words, bytes, rest, rest_bits, .. } = self;
        let inverses = inverses();
        words.resize(symbols.len(), 0);
        let (mut states, mut length) = ([LOW; 2], 0);
        for &symbol in symbols.iter().rev() {
            let (start, strand, count) = (symbol & (SCALE - 1), symbol as usize >> 15 & 1, symbol >> 16);
            let mut state = states[strand];
            // Whether a word is emitted is hard to predict, so write it always and count it if it is.
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

impl<L: Lanes> Strands for InterleavedEncoder<L> {
    const WRITES: bool = true;

    #[inline(always)]
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, symbol: u32) -> u32 {
        self.push::<S>(model.slots(symbol));
        model.learn(self.lanes, symbol);
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

/// Reads symbols from untrusted bytes. Reading past the end gives arbitrary symbols, and an error from
/// [`finish`](Self::finish).
#[derive(Debug)]
pub struct InterleavedDecoder<'a, L = Base> {
    lanes: L,
    states: [u32; 2],
    bytes: &'a [u8],
    /// Next words, the first one lowest, as far as the last [`refill`](Strands::refill) loaded them; then zeros.
    words: u64,
    /// Bits of the states and of the words taken, and number of raw bits read.
    taken: usize,
    bits: usize,
}

impl<'a, L: Lanes> InterleavedDecoder<'a, L> {
    /// Starts reading what [`InterleavedEncoder::finish`] wrote. Fewer than 8 bytes or a state that is too low break
    /// `rule`.
    pub fn new(bytes: &'a [u8], lanes: L, rule: &'static str) -> Result<Self, Violation> {
        let wrong = || Violation::new(rule, "two states of 4 bytes, 65536 or more each", bytes.len());
        let (states, _) = bytes.split_first_chunk::<STATES>().ok_or_else(wrong)?;
        let states = u64::from_le_bytes(*states);
        let states = [states as u32, (states >> 32) as u32];
        if states.iter().any(|&state| state < LOW) {
            return Err(wrong());
        }
        Ok(Self { lanes, states, bytes, words: 0, taken: 8 * STATES, bits: 0 })
    }

    /// Checks that words and raw bits fill the bytes, with zero bits in the byte between them, and that the states are
    /// back at their initial value. Anything else breaks `rule`.
    pub fn finish(self, rule: &'static str) -> Result<(), Violation> {
        let (len, at) = (self.bytes.len(), self.taken / 8);
        let used = at + self.bits.div_ceil(8);
        let unused = if used == len && !self.bits.is_multiple_of(8) { self.bytes[at] >> (self.bits % 8) } else { 0 };
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
        let wants = state < LOW;
        let longer = state << 16 | self.words as u32 & 0xFFFF;
        self.states[S] = select_unpredictable(wants, longer, state);
        let word_bits = usize::from(wants) * 16;
        self.words >>= word_bits;
        self.taken += word_bits;
    }

    /// Returns 64 bits from bit `self.bits` on, of which up to 7 are missing; 0 where raw bits would lie in the states.
    #[inline(always)]
    fn window(&self) -> u64 {
        let end = self.bytes.len().saturating_sub(self.bits / 8);
        let bits = self.bytes[..end].last_chunk().map_or(0, |last| u64::from_be_bytes(*last));
        bits >> (self.bits % 8)
    }
}

impl<L: Lanes> Strands for InterleavedDecoder<'_, L> {
    const WRITES: bool = false;

    // A browser loads all code before the first picture; inlined copies cost it more than the calls.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn nibble<const S: usize>(&mut self, model: &mut Nibble, _: u32) -> u32 {
        let symbol = model.symbol_at(self.lanes, self.slot::<S>());
        self.take::<S>(model.slots(symbol));
        model.learn(self.lanes, symbol);
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

    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn refill(&mut self) {
        let at = self.taken / 8;
        self.words = match self.bytes.get(at..at + 8).and_then(|words| words.first_chunk()) {
            Some(words) => u64::from_le_bytes(*words),
            None => last_words(self.bytes.get(at..).unwrap_or(&[])),
        };
    }
}

/// Returns the words in `rest`, fewer than 8 bytes, the first one lowest; an odd last byte is ignored.
#[cold]
fn last_words(rest: &[u8]) -> u64 {
    let words = rest.as_chunks::<2>().0;
    words.iter().rev().fold(0, |words, &word| words << 16 | u64::from(u16::from_le_bytes(word)))
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

    /// Symbols of models 0 and 2 go to state 0, those of model 1 to state 1.
    fn run(coder: &mut impl Strands, symbols: &[Symbol], mut each: impl FnMut(&Symbol, u32)) {
        let mut nibbles = [const { Nibble::new([1; 16]) }; 3];
        let mut bits = [const { Bit::new(1 << 14) }; 3];
        for (number, symbol) in symbols.iter().enumerate() {
            if number % 4 == 0 {
                coder.refill();
            }
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
            let (mut encoder, mut bytes) = (InterleavedEncoder::<Base>::default(), Vec::new());
            for _ in 0..2 {
                bytes.clear();
                encoder.clear();
                run(&mut encoder, &symbols, |_, _| {});
                encoder.finish(&mut bytes);
            }
            let mut decoder = InterleavedDecoder::new(&bytes, Base, "P6").unwrap();
            run(&mut decoder, &symbols, |symbol, value| match *symbol {
                Symbol::Nibble(_, expected) | Symbol::Raw(_, expected) => assert_eq!(value, expected),
                Symbol::Bit(_, expected) => assert_eq!(value != 0, expected),
            });
            prop_assert_eq!(decoder.finish("P6"), Ok(()));
            for changed in [[&bytes[..8], &[0], &bytes[8..]].concat(), [&bytes[..], &[0]].concat(), bytes[..bytes.len() - 1].to_vec()] {
                let Ok(mut decoder) = InterleavedDecoder::new(&changed, Base, "P6") else { continue };
                run(&mut decoder, &symbols, |_, _| {});
                prop_assert!(decoder.finish("P6").is_err());
            }
            // No other bytes say the same.
            for bit in 0..8 * if bytes.len() < 40 { bytes.len() } else { 0 } {
                let mut changed = bytes.clone();
                changed[bit / 8] ^= 1 << (bit % 8);
                let Ok(mut decoder) = InterleavedDecoder::new(&changed, Base, "P6") else { continue };
                let mut is_same = true;
                run(&mut decoder, &symbols, |symbol, value| {
                    is_same &= match *symbol {
                        Symbol::Nibble(_, expected) | Symbol::Raw(_, expected) => value == expected,
                        Symbol::Bit(_, expected) => (value != 0) == expected,
                    };
                });
                prop_assert!(!is_same || decoder.finish("P6").is_err(), "bit {}", bit);
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100), symbols in symbols()) {
            if let Ok(mut decoder) = InterleavedDecoder::new(&bytes, Base, "P6") {
                run(&mut decoder, &symbols, |symbol, value| match symbol {
                    Symbol::Nibble(..) => assert!(value < 16),
                    Symbol::Bit(..) => {}
                    Symbol::Raw(bits, _) => assert!(value >> bits == 0),
                });
                let _ = decoder.finish("P6");
            }
        }
    }

    #[test]
    fn every_symbol_keeps_a_slot_however_often_another_comes() {
        for often in 0..16 {
            let mut model = Nibble::new([1; 16]);
            for round in 0..4000u32 {
                // Occasionally another symbol, so that bounds move both ways.
                model.learn(Base, if round % 50 == 7 { round / 50 % 16 } else { often });
                let ends: Vec<_> = (0..16).map(|symbol| model.slots(symbol)).collect();
                assert!(ends.iter().all(|&(_, count)| count > 0 && count < SCALE), "{ends:?}");
                assert!(ends.windows(2).all(|pair| pair[0].0 + pair[0].1 == pair[1].0));
                assert_eq!((ends[0].0, ends[15].0 + ends[15].1), (0, SCALE));
                let found = |slot: u32| (0..16).rfind(|&symbol| ends[symbol].0 <= slot).unwrap() as u32;
                for slot in [0, 1, ends[often as usize].0, ends[often as usize].0.saturating_sub(1), SCALE - 1] {
                    assert_eq!(model.symbol_at(Base, slot), found(slot));
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
