//! Prediction of a pixel's next span from its neighbours.

/// A span as later spans see it: step of its bottom, thickness in steps, bottom (quanta), and 1, as four 16-bit
/// numbers, the first one lowest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(transparent)]
pub struct Seen(u64);

impl Seen {
    /// Ends the spans of a pixel: lies above every span and does not count as a candidate.
    pub const NONE: Self = Self(0x7FFF_7FFF_7FFF);

    /// Packs a span. Steps, thicknesses and heights must be below 2¹⁵.
    #[inline(always)]
    pub fn new(step: i32, thick: i32, bottom: i32) -> Self {
        Self(1 << 48 | (bottom as u64 & 0xFFFF) << 32 | u64::from(pack(step, thick)))
    }

    /// Returns step and thickness, [packed](pack).
    #[inline(always)]
    pub fn packed(self) -> u32 {
        self.0 as u32
    }

    /// Returns the bottom (quanta).
    #[inline(always)]
    pub fn bottom(self) -> i32 {
        (self.0 >> 32) as i32 & 0xFFFF
    }
}

/// Packs a step and a thickness.
#[inline(always)]
pub fn pack(step: i32, thick: i32) -> u32 {
    step as u32 & 0xFFFF | (thick as u32) << 16
}

/// Prediction from the candidates: step of the bottom and thickness, and the contexts of both.
pub struct Expected {
    pub low: i32,
    pub thick: i32,
    pub low_context: usize,
    pub thick_context: usize,
}

/// Returns the prediction for a span with the candidates `near`; without candidates, the one [packed](pack) in
/// `without`.
#[inline(always)]
pub fn expected(near: [Seen; 4], without: u32) -> Expected {
    let Weighed { least, second, spread, count } = weigh(near);
    let (one, count) = (if count > 2 { second } else { least }, count as usize & 7);
    let one = if count == 0 { without } else { one };
    let (low, thick) = (i32::from(one as i16), one as i32 >> 16);
    let [of_bottoms, of_spreads] = &CONTEXTS;
    Expected {
        low,
        thick,
        low_context: of_bottoms[count][zeros(spread & 0xFFFF)].into(),
        thick_context: usize::from(CLASSES_OF_THICKNESSES[zeros(thick.unsigned_abs())])
            + usize::from(of_spreads[count][zeros(spread >> 16)]),
    }
}

/// Returns the number of leading zeros of `value`; 0 has as many as 1.
#[inline(always)]
fn zeros(value: u32) -> usize {
    (value | 1).leading_zeros() as usize & 31
}

/// Returns the class of a number with this many [`zeros`].
const fn class(zeros: usize) -> u8 {
    match 32 - zeros {
        0..=2 => 0,
        bits @ 3..=7 => bits as u8 - 2,
        8 | 9 => 6,
        _ => 7,
    }
}

/// Contexts by the number of candidates and the [`zeros`] of their spread: of bottoms, and the last part of those of
/// thicknesses.
static CONTEXTS: [[[u8; 32]; 8]; 2] = {
    let (mut contexts, mut at) = ([[[0; 32]; 8]; 2], 0);
    while at < 5 * 32 {
        let (count, zeros) = (at / 32, at % 32);
        contexts[0][count][zeros] = match count {
            0 | 1 => count as u8,
            2 => 2 + class(zeros) / 2,
            _ => 8 + class(zeros),
        };
        contexts[1][count][zeros] = if count < 2 { count as u8 } else { 2 + class(zeros) };
        at += 1;
    }
    contexts
};
/// First context of a thickness by the [`zeros`] of the expected one.
static CLASSES_OF_THICKNESSES: [u8; 32] = {
    let (mut classes, mut zeros) = ([0; 32], 0);
    while zeros < 32 {
        classes[zeros] = 10 * class(zeros);
        zeros += 1;
    }
    classes
};

/// Of the candidates' steps and thicknesses, [packed](pack): the minimum, the second smallest of all four (a missing
/// one counts as the largest), and the maximum less the minimum; and the number of candidates.
#[derive(Debug, PartialEq, Eq)]
struct Weighed {
    least: u32,
    second: u32,
    spread: u32,
    count: u32,
}

#[cfg(any(not(target_arch = "x86_64"), slicewalk_portable))]
use portable::weigh;
#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
use sse2::weigh;

/// Implementation for any processor.
#[cfg(any(test, not(target_arch = "x86_64"), slicewalk_portable))]
mod portable {
    use super::{Seen, Weighed, pack};

    pub fn weigh(near: [Seen; 4]) -> Weighed {
        let fields = |shift: u32| near.map(|seen| (seen.0 >> shift) as i16);
        let of = |[a, b, c, d]: [i16; 4]| {
            let (least_ab, most_ab, least_cd, most_cd) = (a.min(b), a.max(b), c.min(d), c.max(d));
            let (least, second) = (least_ab.min(least_cd), least_ab.max(least_cd).min(most_ab.min(most_cd)));
            // A missing number plus 1 wraps to the smallest, so the maximum ignores it.
            let most = [a, b, c, d].map(|one| one.wrapping_add(1)).into_iter().fold(i16::MIN, i16::max).wrapping_sub(1);
            [least, second, most.wrapping_sub(least)].map(i32::from)
        };
        let ([least, second, spread], thick) = (of(fields(0)), of(fields(16)));
        Weighed {
            least: pack(least, thick[0]),
            second: pack(second, thick[1]),
            spread: pack(spread, thick[2]),
            count: fields(48).iter().fold(0, |count, &one| count + u32::from(one as u16)) & 0xFFFF,
        }
    }
}

/// Processes all fields of four spans at once.
#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
mod sse2 {
    use super::{Seen, Weighed};
    use std::arch::x86_64::{
        __m128i, _mm_add_epi16, _mm_cvtsi64_si128, _mm_cvtsi128_si32, _mm_extract_epi16, _mm_max_epi16, _mm_min_epi16,
        _mm_set1_epi16, _mm_sub_epi16,
    };

    #[inline(always)]
    pub fn weigh(near: [Seen; 4]) -> Weighed {
        // SAFETY: every x86-64 has SSE2.
        unsafe {
            let [a, b, c, d] = near.map(|seen| _mm_cvtsi64_si128(seen.0 as i64));
            let (min, max) = (|a, b| _mm_min_epi16(a, b), |a, b| _mm_max_epi16(a, b));
            let add = |a, b| _mm_add_epi16(a, b);
            let one = _mm_set1_epi16(1);
            let next = |a| add(a, one);
            let (least_ab, most_ab, least_cd, most_cd) = (min(a, b), max(a, b), min(c, d), max(c, d));
            let least = min(least_ab, least_cd);
            let second = min(max(least_ab, least_cd), min(most_ab, most_cd));
            // A missing number plus 1 wraps to the smallest, so the maximum ignores it.
            let most_next = max(max(next(a), next(b)), max(next(c), next(d)));
            let spread = _mm_sub_epi16(_mm_sub_epi16(most_next, one), least);
            let low = |all: __m128i| _mm_cvtsi128_si32(all) as u32;
            let count = _mm_extract_epi16::<3>(add(add(a, b), add(c, d))) as u32;
            Weighed { least: low(least), second: low(second), spread: low(spread), count }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn processors_agree(near: [u64; 4]) {
            prop_assert_eq!(weigh(near.map(Seen)), portable::weigh(near.map(Seen)));
        }
    }
}
