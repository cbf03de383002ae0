//! The arithmetic decoder of LASzip, its adaptive models, and integers coded as differences from expected ones.
//!
//! Input: compressed bytes. Output: the symbols that LASzip and the crate `laz` decode, in two thirds of the time of
//! the latter: the decoder state stays in registers, a model is one block of memory with 16-bit bounds and counts, and
//! its table has an entry per 128 parts of the range. Sources: A. Said, *Introduction to Arithmetic Coding: Theory and
//! Practice* (HPL-2004-76); M. Isenburg, *LASzip: lossless compression of LiDAR data* (PE&RS 79(2), 2013).
//!
//! Bytes that no encoder wrote yield other symbols, never a panic; they show at the end of the data
//! ([`Coder::is_at_end`]).

use std::hint::select_unpredictable;

/// Further bytes are read once the range is shorter than this (bits).
const MIN_LENGTH_BITS: u32 = 24;
/// Number of parts into which models divide the range, as a power of two.
const MODEL_BITS: u32 = 15;
/// Number of parts for models of one bit, as a power of two.
const BIT_MODEL_BITS: u32 = 13;
/// Number of parts per place in a model's table, as a power of two.
const PLACE_BITS: u32 = MODEL_BITS - 8;

/// Maximum number of bytes consumed by one symbol, bit or number of bits.
pub(super) const MOST_STEP_BYTES: usize = (MIN_LENGTH_BITS / 8) as usize;

/// Decoder of `bytes`. Past their end it reads zeros, which its position shows.
#[derive(Clone, Copy)]
pub(super) struct Coder<'a> {
    bytes: &'a [u8],
    position: usize,
    range: Range,
}

/// State of a decoder between the bytes consumed and those to come.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Range {
    value: u32,
    length: u32,
}

impl<'a> Coder<'a> {
    /// Creates a decoder that begins at `bytes[position]`.
    pub fn begin(bytes: &'a [u8], position: usize) -> Self {
        let mut coder = Self { bytes, position, range: Range { value: 0, length: u32::MAX } };
        coder.range.value = coder.next_four();
        coder.position += 4;
        coder
    }

    /// Creates a decoder that continues at `bytes[position]`.
    pub fn resume(bytes: &'a [u8], position: usize, range: Range) -> Self {
        Self { bytes, position, range }
    }

    pub fn position(&self) -> usize {
        self.position
    }

    /// Returns the state for [`resume`](Self::resume).
    pub fn state(&self) -> (usize, Range) {
        (self.position, self.range)
    }

    /// Returns whether it read past the end of the bytes.
    #[inline(always)]
    pub fn is_beyond(&self) -> bool {
        self.position > self.bytes.len()
    }

    /// Returns whether an encoder that wrote these symbols ends here. It adds a 256th or a 512th of the maximum range
    /// to the start of its own range, writes the upper one or two bytes of that, and zeros until it has written as many
    /// bytes as the decoder has consumed.
    pub fn is_at_end(&self) -> bool {
        let Range { value, length } = self.range;
        let (most, written, zeros) = match length {
            ..=0x0200_0000 => (1 << 23, 1 << 16, 2),
            _ => (1 << 24, 1 << 24, 3),
        };
        let last = self.position.checked_sub(zeros).and_then(|from| self.bytes.get(from..self.position));
        value <= most && value > most - written && last.is_some_and(|last| last.iter().all(|&byte| byte == 0))
    }

    #[inline(always)]
    fn next_four(&self) -> u32 {
        match self.bytes.get(self.position..).and_then(<[u8]>::first_chunk) {
            Some(&four) => u32::from_be_bytes(four),
            None => self.last_bytes(),
        }
    }

    #[cold]
    #[inline(never)]
    fn last_bytes(&self) -> u32 {
        let byte = |at| u32::from(self.bytes.get(self.position + at).copied().unwrap_or(0));
        (0..4).fold(0, |four, at| four << 8 | byte(at))
    }

    /// Narrows the range to `length` from `low` on, and reads bytes until it is long enough.
    #[inline(always)]
    fn narrow(&mut self, low: u32, length: u32) {
        let taken = length.leading_zeros() / 8;
        let both = u64::from(self.range.value - low) << 32 | u64::from(self.next_four());
        self.range = Range { value: (both << (8 * taken) >> 32) as u32, length: length << (8 * taken) };
        self.position += taken as usize;
    }

    /// Decodes a symbol with `model`.
    #[inline(always)]
    pub fn symbol<const N: usize, T: Place>(&mut self, model: &mut Model<N, T>) -> u32 {
        let part = self.range.length >> MODEL_BITS;
        // The last symbol also covers the remainder of the division.
        let parts = (self.range.value / part).min((1 << MODEL_BITS) - 1);
        let mut symbol: usize = model.places[(parts >> PLACE_BITS) as usize].into();
        while model.bounds.get(symbol + 1).is_some_and(|&bound| u32::from(bound) <= parts) {
            symbol += 1;
        }
        let symbol = symbol.min(N - 1);
        let low = u32::from(model.bounds[symbol]) * part;
        let high = match model.bounds.get(symbol + 1) {
            Some(&bound) if symbol + 1 < model.symbols as usize => u32::from(bound) * part,
            _ => self.range.length,
        };
        self.narrow(low, high - low);
        model.counts[symbol] += 1;
        model.left -= 1;
        if model.left == 0 {
            model.update();
        }
        symbol as u32
    }

    /// Decodes a bit with `model`.
    #[inline(always)]
    pub fn bit(&mut self, model: &mut BitModel) -> bool {
        let zero = model.zero * (self.range.length >> BIT_MODEL_BITS);
        let bit = self.range.value >= zero;
        match bit {
            true => self.narrow(zero, self.range.length - zero),
            false => {
                model.zeros += 1;
                self.narrow(0, zero);
            }
        }
        model.left -= 1;
        if model.left == 0 {
            model.update();
        }
        bit
    }

    /// Decodes a number of `count` [1..=19] equally likely bits.
    #[inline(always)]
    fn short(&mut self, count: u32) -> u32 {
        let part = self.range.length >> count;
        let number = self.range.value / part;
        self.narrow(number * part, part);
        number
    }

    /// Decodes a number of `count` [1..=32] bits.
    #[inline(always)]
    pub fn bits(&mut self, count: u32) -> u32 {
        if count <= 19 {
            return self.short(count);
        }
        let low = self.short(16);
        self.short(count - 16) << 16 | low
    }
}

/// Integer type of symbols in a model's table.
pub(super) trait Place: Copy + Default + Into<usize> + TryFrom<usize> {}
impl Place for u8 {}
impl Place for u16 {}

/// Adaptive frequencies of up to `N` symbols.
#[derive(Debug, Clone)]
pub(super) struct Model<const N: usize, T = u8> {
    /// For each place, the last symbol that begins no later than the place.
    places: [T; 1 << (MODEL_BITS - PLACE_BITS)],
    /// Start of each symbol, in parts of the range; symbols that do not exist start past its end.
    bounds: [u16; N],
    counts: [u16; N],
    symbols: u32,
    total: u32,
    /// Symbols from one update to the next; `left`: symbols until the next update.
    cycle: u32,
    left: u32,
}

impl<const N: usize, T: Place> Model<N, T> {
    /// Creates a model of `symbols` [2..=N] equally likely symbols.
    pub fn new(symbols: usize) -> Self {
        let mut model = Self {
            places: [T::default(); _],
            bounds: [1 << MODEL_BITS; N],
            counts: std::array::from_fn(|symbol| u16::from(symbol < symbols)),
            symbols: symbols as u32,
            total: 0,
            cycle: symbols as u32,
            left: 0,
        };
        model.update();
        model.cycle = (model.symbols + 6) / 2;
        model.left = model.cycle;
        model
    }

    #[inline(never)]
    fn update(&mut self) {
        let counts = &mut self.counts[..self.symbols as usize];
        self.total += self.cycle;
        if self.total > 1 << MODEL_BITS {
            counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
            self.total = counts.iter().map(|&count| u32::from(count)).sum();
        }
        let scale = (1 << 31) / self.total;
        let (mut sum, mut places) = (0, 0);
        for (symbol, (bound, &count)) in self.bounds.iter_mut().zip(&*counts).enumerate() {
            *bound = ((scale * sum) >> (31 - MODEL_BITS)) as u16;
            sum += u32::from(count);
            // Places that begin below this symbol belong to the one before.
            let end = usize::from(bound.div_ceil(1 << PLACE_BITS));
            if end > places {
                self.places[places..end].fill(T::try_from(symbol - 1).unwrap_or_default());
                places = end;
            }
        }
        self.places[places..].fill(T::try_from(counts.len() - 1).unwrap_or_default());
        self.cycle = (5 * self.cycle / 4).min(8 * (self.symbols + 6));
        self.left = self.cycle;
    }
}

/// Adaptive frequency of a bit being 0.
#[derive(Debug, Clone)]
pub(super) struct BitModel {
    /// Start of 1, in parts of the range.
    zero: u32,
    zeros: u32,
    total: u32,
    cycle: u32,
    left: u32,
}

impl BitModel {
    pub fn new() -> Self {
        Self { zero: 1 << (BIT_MODEL_BITS - 1), zeros: 1, total: 2, cycle: 4, left: 4 }
    }

    fn update(&mut self) {
        self.total += self.cycle;
        if self.total > 1 << BIT_MODEL_BITS {
            self.total = self.total.div_ceil(2);
            self.zeros = self.zeros.div_ceil(2);
            self.total += u32::from(self.zeros == self.total);
        }
        self.zero = (self.zeros * ((1 << 31) / self.total)) >> (31 - BIT_MODEL_BITS);
        self.cycle = (5 * self.cycle / 4).min(64);
        self.left = self.cycle;
    }
}

/// Maximum size of differences coded as one symbol (bits); of larger ones, the upper bits are.
const SYMBOL_BITS: u32 = 8;

/// Integers coded as differences from expected ones: first the size of the difference in bits, by context, then its
/// value among those of that size.
#[derive(Debug, Clone)]
pub(super) struct Numbers {
    sizes: Box<[Model<33>]>,
    /// Whether the difference is 0 or 1.
    small: BitModel,
    /// Differences of 1, 2, … bits.
    values: Box<[Model<256>]>,
    /// Numbers wrap around at this value; 0 for 2³².
    modulus: u32,
    size: u32,
}

impl Numbers {
    /// Maximum number of decoding steps per number.
    pub const MOST_STEPS: usize = 4;

    /// Creates a decoder for numbers of `bits` bits: 8, 16 or 32.
    pub fn new(bits: u32, contexts: usize) -> Self {
        // Copying a model is cheaper than computing its table again.
        let (size, largest) = (Model::new(bits as usize + 1), Model::new(1 << SYMBOL_BITS));
        Self {
            sizes: vec![size; contexts].into(),
            small: BitModel::new(),
            values: (1..=bits)
                .map(|size| if size < SYMBOL_BITS { Model::new(1 << size) } else { largest.clone() })
                .collect(),
            modulus: 1u32.checked_shl(bits).unwrap_or(0),
            size: 0,
        }
    }

    /// Returns the size of the last difference (bits).
    pub fn size(&self) -> u32 {
        self.size
    }

    /// Decodes the next number.
    #[inline(always)]
    pub fn next(&mut self, coder: &mut Coder, context: usize, expected: i32) -> i32 {
        self.size = coder.symbol(&mut self.sizes[context]);
        let difference = match self.size {
            0 => i32::from(coder.bit(&mut self.small)),
            32 => i32::MIN,
            size => {
                let mut value = coder.symbol(&mut self.values[size as usize - 1]);
                if size > SYMBOL_BITS {
                    let lower = size - SYMBOL_BITS;
                    value = value << lower | coder.bits(lower);
                }
                // The upper half are the positive differences of this size; 0 and 1 have size 0.
                let half = 1 << (size - 1);
                let (above, below) = (value.wrapping_add(1), value.wrapping_sub(2 * half - 1));
                select_unpredictable(value >= half, above, below) as i32
            }
        };
        let number = expected.wrapping_add(difference);
        match self.modulus as i32 {
            0 => number,
            modulus if number < 0 => number.wrapping_add(modulus),
            modulus if number >= modulus => number.wrapping_sub(modulus),
            _ => number,
        }
    }
}

/// Median of five recent numbers; each new number replaces the least or the greatest.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Median {
    sorted: [i32; 5],
    /// True if the next number replaces the least, false for the greatest.
    least: bool,
}

impl Median {
    pub fn get(&self) -> i32 {
        self.sorted[2]
    }

    /// Adds a number, without branches because its rank cannot be predicted.
    #[inline(always)]
    pub fn add(&mut self, number: i32) {
        let all = self.sorted;
        let kept: [i32; 4] = std::array::from_fn(|at| if self.least { all[at + 1] } else { all[at] });
        self.least = if self.least { number > all[2] } else { number >= all[2] };
        let [a, b, c, d] = kept;
        self.sorted = [a.min(number), a.max(b.min(number)), b.max(c.min(number)), c.max(d.min(number)), d.max(number)];
    }
}
