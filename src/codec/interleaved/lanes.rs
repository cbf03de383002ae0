//! Operations on sixteen bounds at once, by processor features.

use super::SCALE;

/// Slots at which the 16 symbols end. The last is `SCALE`, the smallest number as a signed one.
pub type Ends = [i16; 16];

/// Targets of the ends for each coded symbol: it gets all slots, except one for each other symbol.
pub static TARGETS: [Ends; 16] = {
    let (mut targets, mut at) = ([[SCALE as i16; 16]; 16], 0);
    while at < 16 * 15 {
        let (symbol, index) = (at / 15, at % 15);
        let end = index as u32 + 1;
        targets[symbol][index] = if index >= symbol { SCALE - 16 + end } else { end } as i16;
        at += 1;
    }
    targets
};

/// Processor features. A value of the type proves that this processor has them.
pub trait Lanes: Copy {
    /// Returns the symbol (0..16) that `slot` belongs to.
    fn symbol(self, ends: &Ends, slot: i16) -> u32;

    /// Moves each of `ends` by 1/2ʳᵃᵗᵉ of its distance to `targets`, rounded down.
    fn approach(self, ends: &mut Ends, targets: &Ends, rate: u8);
}

/// Features of every processor that the library is built for.
#[derive(Debug, Clone, Copy, Default)]
pub struct Base;

#[cfg(any(not(target_arch = "x86_64"), slicewalk_portable))]
impl Lanes for Base {
    #[inline(always)]
    fn symbol(self, ends: &Ends, slot: i16) -> u32 {
        portable::symbol(ends, slot)
    }

    #[inline(always)]
    fn approach(self, ends: &mut Ends, targets: &Ends, rate: u8) {
        portable::approach(ends, targets, rate);
    }
}

/// Implementation for any processor.
#[cfg(any(test, not(target_arch = "x86_64"), slicewalk_portable))]
mod portable {
    use super::Ends;

    #[inline(always)]
    pub fn symbol(ends: &Ends, slot: i16) -> u32 {
        let [ends @ .., _] = ends;
        ends.iter().map(|&end| u32::from(end <= slot)).sum()
    }

    #[inline(always)]
    pub fn approach(ends: &mut Ends, targets: &Ends, rate: u8) {
        for (end, target) in ends.iter_mut().zip(targets) {
            *end += (target - *end) >> rate;
        }
    }
}

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
pub use x86::Avx2;

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
mod x86 {
    use super::{Base, Ends, Lanes};
    use std::arch::x86_64::{
        __m128i, _mm_add_epi16, _mm_cmpgt_epi16, _mm_cvtsi32_si128, _mm_loadu_si128, _mm_movemask_epi8,
        _mm_packs_epi16, _mm_set1_epi16, _mm_sra_epi16, _mm_storeu_si128, _mm_sub_epi16, _mm256_add_epi16,
        _mm256_cmpgt_epi16, _mm256_loadu_si256, _mm256_movemask_epi8, _mm256_set1_epi16, _mm256_sra_epi16,
        _mm256_storeu_si256, _mm256_sub_epi16,
    };

    #[inline(always)]
    fn load(all: &Ends) -> [__m128i; 2] {
        let first = all.as_ptr().cast::<__m128i>();
        // SAFETY: 16 numbers are two times 16 bytes, and unaligned loads are allowed; every x86-64 has SSE2.
        unsafe { [_mm_loadu_si128(first), _mm_loadu_si128(first.add(1))] }
    }

    impl Lanes for Base {
        #[inline(always)]
        fn symbol(self, ends: &Ends, slot: i16) -> u32 {
            let [low, high] = load(ends);
            // SAFETY: every x86-64 has SSE2.
            let above = unsafe {
                let slot = _mm_set1_epi16(slot);
                _mm_movemask_epi8(_mm_packs_epi16(_mm_cmpgt_epi16(low, slot), _mm_cmpgt_epi16(high, slot)))
            };
            (above as u32 | 1 << 15).trailing_zeros()
        }

        #[inline(always)]
        fn approach(self, ends: &mut Ends, targets: &Ends, rate: u8) {
            let (numbers, targets) = (load(ends), load(targets));
            let first = ends.as_mut_ptr().cast::<__m128i>();
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

    /// AVX2 and the features that come with it.
    #[derive(Debug, Clone, Copy)]
    pub struct Avx2(());

    impl Avx2 {
        /// Returns `None` unless the processor has everything that functions with this argument may use: AVX2, BMI,
        /// BMI2 and LZCNT.
        pub fn detect() -> Option<Self> {
            let has = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt");
            has.then_some(Self(()))
        }
    }

    impl Lanes for Avx2 {
        #[inline(always)]
        fn symbol(self, ends: &Ends, slot: i16) -> u32 {
            // SAFETY: 16 numbers are 32 bytes, and unaligned loads are allowed; a value of `Avx2` exists only if the
            // processor has AVX2.
            let above = unsafe {
                let ends = _mm256_loadu_si256(ends.as_ptr().cast());
                _mm256_movemask_epi8(_mm256_cmpgt_epi16(ends, _mm256_set1_epi16(slot)))
            };
            // Two bits per end.
            (above as u32 | 1 << 30).trailing_zeros() / 2
        }

        #[inline(always)]
        fn approach(self, ends: &mut Ends, targets: &Ends, rate: u8) {
            // SAFETY: as above; written where they were read.
            unsafe {
                let numbers = _mm256_loadu_si256(ends.as_ptr().cast());
                let way = _mm256_sub_epi16(_mm256_loadu_si256(targets.as_ptr().cast()), numbers);
                let way = _mm256_sra_epi16(way, _mm_cvtsi32_si128(i32::from(rate)));
                _mm256_storeu_si256(ends.as_mut_ptr().cast(), _mm256_add_epi16(numbers, way));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn agree(lanes: impl Lanes, ends: &Ends, targets: &Ends, one: i16, rate: u8) {
        let mut ascending = *ends;
        ascending[..15].sort_unstable();
        assert_eq!(lanes.symbol(&ascending, one), portable::symbol(&ascending, one));
        let (mut moved, mut expected) = (*ends, *ends);
        lanes.approach(&mut moved, targets, rate);
        portable::approach(&mut expected, targets, rate);
        assert_eq!(moved, expected);
    }

    proptest! {
        #[test]
        fn processors_agree(ends: Ends, targets: Ends, one in 0i16..=i16::MAX, rate in 0u8..8) {
            // Ends and targets are slots, so their differences fit.
            let slots = |all: Ends| {
                let mut slots = all.map(|slot| slot & i16::MAX);
                slots[15] = SCALE as i16;
                slots
            };
            agree(Base, &slots(ends), &slots(targets), one, rate);
            #[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
            if let Some(lanes) = Avx2::detect() {
                agree(lanes, &slots(ends), &slots(targets), one, rate);
            }
        }
    }
}
