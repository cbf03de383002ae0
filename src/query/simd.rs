//! Vectors of two and four numbers, by instructions that every x86-64 processor has, because the compiler would turn
//! some of these selections into branches. Elsewhere lane by lane, with bit-identical results.

#[cfg(any(not(target_arch = "x86_64"), slicewalk_portable))]
use portable as lanes;
#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
use sse2 as lanes;

use crate::page::Span;
pub(super) use lanes::{Floats, Pair, Unions, Window, greater, lesser};

/// Returns the last four of `spans`, which replaces a loop over the remainder of groups of four. Fewer spans are padded
/// with ones that meet nothing.
#[inline]
pub(super) fn last_four(spans: &[Span]) -> [Span; 4] {
    spans.last_chunk().copied().unwrap_or_else(|| std::array::from_fn(|n| spans.get(n).copied().unwrap_or(Span::NEVER)))
}

#[cfg(all(target_arch = "x86_64", not(slicewalk_portable)))]
mod sse2 {
    use super::last_four;
    use crate::frame::PAGE_QUANTA;
    use crate::page::Span;
    use crate::query::blocks::{Kinds, MATTER, OBSTACLE};
    use std::arch::x86_64::*;

    /// Bits of a height in a span.
    const FIELD: i32 = (1 << 14) - 1;
    /// A span's highest bits are its lane.
    const LANE_SHIFT: u32 = 29;

    /// Evaluates vector instructions.
    macro_rules! vector {
        ($($code:tt)*) => {
            // SAFETY: SSE2 is part of x86-64; nothing here reads or writes memory.
            unsafe { $($code)* }
        };
    }

    /// Returns the lesser of two numbers, neither of them NaN, in one instruction. `f64::min` takes more, and so does
    /// what the compiler makes of two selections side by side.
    #[inline]
    pub fn lesser(a: f64, b: f64) -> f64 {
        vector!(_mm_cvtsd_f64(_mm_min_sd(_mm_set_sd(a), _mm_set_sd(b))))
    }

    /// Returns the greater of two numbers, neither of them NaN, like [`lesser`].
    #[inline]
    pub fn greater(a: f64, b: f64) -> f64 {
        vector!(_mm_cvtsd_f64(_mm_max_sd(_mm_set_sd(a), _mm_set_sd(b))))
    }

    /// Four single-precision numbers, none of them NaN.
    #[derive(Clone, Copy)]
    pub struct Floats(__m128);

    impl Floats {
        #[inline]
        pub fn new([a, b, c, d]: [f32; 4]) -> Self {
            Self(vector!(_mm_set_ps(d, c, b, a)))
        }

        #[inline]
        pub fn plus(self, other: Self) -> Self {
            Self(vector!(_mm_add_ps(self.0, other.0)))
        }

        #[inline]
        pub fn minus(self, other: Self) -> Self {
            Self(vector!(_mm_sub_ps(self.0, other.0)))
        }

        #[inline]
        pub fn times(self, other: Self) -> Self {
            Self(vector!(_mm_mul_ps(self.0, other.0)))
        }

        #[inline]
        pub fn lesser(self, other: Self) -> Self {
            Self(vector!(_mm_min_ps(self.0, other.0)))
        }

        #[inline]
        pub fn greater(self, other: Self) -> Self {
            Self(vector!(_mm_max_ps(self.0, other.0)))
        }

        /// Returns 2 to the power of the nearest integer, for values from -1 to 9, by writing the exponent bits.
        #[inline]
        pub fn power_of_nearest(self) -> Self {
            let exponent = vector!(_mm_add_epi32(_mm_cvtps_epi32(self.0), _mm_set1_epi32(127)));
            Self(vector!(_mm_castsi128_ps(_mm_slli_epi32::<23>(exponent))))
        }

        /// Returns the integers nearest to these and then to the other numbers, all from 0 to 255, as bytes, lowest
        /// first.
        #[inline]
        pub fn bytes(self, others: Self) -> u64 {
            let words = vector!(_mm_packs_epi32(_mm_cvtps_epi32(self.0), _mm_cvtps_epi32(others.0)));
            vector!(_mm_cvtsi128_si64(_mm_packus_epi16(words, words))) as u64
        }
    }

    /// Two numbers, neither of them NaN.
    #[derive(Clone, Copy)]
    pub struct Pair(__m128d);

    impl Pair {
        #[inline]
        pub fn new([a, b]: [f64; 2]) -> Self {
            Self(vector!(_mm_set_pd(b, a)))
        }

        #[inline]
        pub fn plus(self, other: Self) -> Self {
            Self(vector!(_mm_add_pd(self.0, other.0)))
        }

        #[inline]
        pub fn minus(self, other: Self) -> Self {
            Self(vector!(_mm_sub_pd(self.0, other.0)))
        }

        #[inline]
        pub fn times(self, other: Self) -> Self {
            Self(vector!(_mm_mul_pd(self.0, other.0)))
        }

        #[inline]
        pub fn lesser(self, other: Self) -> Self {
            Self(vector!(_mm_min_pd(self.0, other.0)))
        }

        #[inline]
        pub fn greater(self, other: Self) -> Self {
            Self(vector!(_mm_max_pd(self.0, other.0)))
        }

        #[inline]
        pub fn both(self) -> [f64; 2] {
            vector!([_mm_cvtsd_f64(self.0), _mm_cvtsd_f64(_mm_unpackhi_pd(self.0, self.0))])
        }
    }

    /// Lowest bottom and highest top of spans: each lane holds the bottom and, above it, 16383 minus the top, so that
    /// the minimum is the extreme of both.
    #[derive(Clone, Copy)]
    pub struct Unions(__m128i);

    impl Unions {
        /// Extent of those of four spans that meet `low..=high`.
        #[inline]
        pub fn meeting(spans: &[Span; 4], low: u32, high: u32) -> Self {
            // Comparisons are signed and have 16 bits.
            let (low, high) = (low.min(FIELD as u32) as i32, high.min(PAGE_QUANTA as u32) as i32);
            // SAFETY: reads the four spans, which are 32 bits each.
            let words = unsafe { _mm_loadu_si128(std::ptr::from_ref(spans).cast()) };
            Self(vector! {
                let ends = ends_of(words);
                let beyond = _mm_cmpgt_epi16(ends, _mm_set1_epi32(high | (FIELD - low) << 16));
                let met = _mm_cmpeq_epi32(beyond, _mm_setzero_si128());
                _mm_or_si128(ends, _mm_andnot_si128(met, _mm_set1_epi16(i16::MAX)))
            })
        }

        #[inline]
        pub fn join(self, other: Self) -> Self {
            Self(vector!(_mm_min_epi16(self.0, other.0)))
        }

        /// Returns the lowest bottom and the highest top; the first exceeds the second if no span was met.
        #[inline]
        pub fn ends(self) -> (u32, u32) {
            let half = vector!(_mm_min_epi16(self.0, _mm_shuffle_epi32::<0b1110>(self.0)));
            let least = vector!(_mm_cvtsi128_si32(_mm_min_epi16(half, _mm_shuffle_epi32::<0b01>(half)))) as u32;
            (least & 0xFFFF, least >> 16 ^ FIELD as u32)
        }
    }

    /// Lanes and heights against which spans are tested.
    #[derive(Clone, Copy)]
    pub struct Window {
        /// The highest bottom and, above it, 16383 minus the lowest top.
        heights: __m128i,
        /// Added to a word, makes those of lanes `x0..=x1` the least signed numbers; `last` is the greatest of them.
        turn: __m128i,
        last: __m128i,
    }

    impl Window {
        /// Window of lanes `x0..=x1` [0..8] and heights `low..=high`.
        #[inline]
        pub fn new([x0, x1]: [u32; 2], low: u32, high: u32) -> Self {
            // Comparisons are signed and have 16 bits.
            let (low, high) = (low.min(FIELD as u32) as i32, high.min(PAGE_QUANTA as u32) as i32);
            let last = u32::MAX >> 3 | (x1 - x0) << LANE_SHIFT;
            Self {
                heights: vector!(_mm_set1_epi32(high | (FIELD - low) << 16)),
                turn: vector!(_mm_set1_epi32(i32::MIN.wrapping_sub((x0 << LANE_SHIFT) as i32))),
                last: vector!(_mm_set1_epi32(last as i32 ^ i32::MIN)),
            }
        }

        /// Returns four spans, and a mask with bits set in those outside the lanes or heights.
        #[inline]
        fn outside(self, spans: &[Span; 4]) -> (__m128i, __m128i) {
            // SAFETY: reads the four spans, which are 32 bits each.
            let words = unsafe { _mm_loadu_si128(std::ptr::from_ref(spans).cast()) };
            vector! {
                let beside = _mm_cmpgt_epi32(_mm_add_epi32(words, self.turn), self.last);
                (words, _mm_or_si128(_mm_cmpgt_epi16(ends_of(words), self.heights), beside))
            }
        }

        /// Returns four spans, and a mask with all bits set in those that lie in the lanes and meet the heights.
        #[inline]
        fn inside(self, spans: &[Span; 4]) -> (__m128i, __m128i) {
            let (words, outside) = self.outside(spans);
            (words, vector!(_mm_cmpeq_epi32(outside, _mm_setzero_si128())))
        }

        /// Returns the mask of those of sixteen spans that lie in the lanes and meet the heights.
        #[inline]
        pub fn meets_of_sixteen(self, spans: &[Span; 16]) -> u32 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|n| self.outside(&spans.as_chunks().0[n]).1);
            // Packing saturates, so a word with any bit set keeps one.
            vector! {
                let outside = _mm_packs_epi16(_mm_packs_epi32(a, b), _mm_packs_epi32(c, d));
                _mm_movemask_epi8(_mm_cmpeq_epi8(outside, _mm_setzero_si128())) as u32
            }
        }

        /// Returns the mask of those of four spans that lie in the lanes and meet the heights.
        #[inline]
        pub fn meets(self, spans: &[Span; 4]) -> u32 {
            vector!(_mm_movemask_ps(_mm_castsi128_ps(self.inside(spans).1))) as u32
        }

        /// Returns the classes of those `spans` that lie in the lanes and meet the heights. May stop once one of
        /// `until` is found.
        #[inline]
        pub fn kinds(self, spans: &[Span], until: Kinds) -> Kinds {
            let until = vector!(_mm_set1_epi32(until as i32));
            let mut all = vector!(_mm_setzero_si128());
            let mut join = |four: &[Span; 4]| {
                let (words, inside) = self.inside(four);
                all = vector!(_mm_or_si128(all, _mm_and_si128(inside, _mm_or_si128(words, _mm_set1_epi32(1)))));
                vector!(_mm_movemask_epi8(_mm_cmpeq_epi32(_mm_and_si128(all, until), _mm_setzero_si128()))) != 0xFFFF
            };
            let (fours, rest) = spans.as_chunks();
            let mut pairs = fours.chunks_exact(2);
            // Two at a time: the test for an early exit costs as much as one group.
            let done = pairs.any(|pair| {
                join(&pair[0]);
                join(&pair[1])
            });
            if !done {
                if let [four] = pairs.remainder() {
                    join(four);
                }
                if !rest.is_empty() {
                    join(&last_four(spans));
                }
            }
            let half = vector!(_mm_or_si128(all, _mm_shuffle_epi32::<0b1110>(all)));
            let kinds = vector!(_mm_cvtsi128_si32(_mm_or_si128(half, _mm_shuffle_epi32::<0b01>(half)))) as u32;
            kinds & (MATTER | OBSTACLE)
        }
    }

    /// Returns, per lane of 32 bits, the bottom of a span and, above it, 16383 minus its top.
    #[inline]
    fn ends_of(spans: __m128i) -> __m128i {
        vector! {
            let bottoms = _mm_and_si128(spans, _mm_set1_epi32(FIELD));
            _mm_or_si128(bottoms, _mm_andnot_si128(_mm_slli_epi32::<2>(spans), _mm_set1_epi32(FIELD << 16)))
        }
    }
}

#[cfg(any(test, not(target_arch = "x86_64"), slicewalk_portable))]
// Compiled for tests as well, which use only a part of it.
#[cfg_attr(all(target_arch = "x86_64", not(slicewalk_portable)), allow(dead_code))]
mod portable {
    use crate::page::Span;
    use crate::query::blocks::Kinds;
    use crate::query::scan::meeting_in_lanes;

    /// Returns the lesser of two numbers, neither of them NaN.
    #[inline]
    pub fn lesser(a: f64, b: f64) -> f64 {
        if a < b { a } else { b }
    }

    /// Returns the greater of two numbers, neither of them NaN.
    #[inline]
    pub fn greater(a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }

    /// Four single-precision numbers, none of them NaN.
    #[derive(Clone, Copy)]
    pub struct Floats([f32; 4]);

    /// Added to a number of magnitude below 2²², leaves the nearest integer (ties to even) in the last bits of the sum.
    const INTEGERS: f32 = (3 << 22) as f32;

    fn nearest(v: f32) -> u32 {
        (v + INTEGERS).to_bits().wrapping_sub(INTEGERS.to_bits())
    }

    impl Floats {
        #[inline]
        pub fn new(values: [f32; 4]) -> Self {
            Self(values)
        }

        #[inline]
        fn with(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
            Self(std::array::from_fn(|n| f(self.0[n], other.0[n])))
        }

        #[inline]
        pub fn plus(self, other: Self) -> Self {
            self.with(other, |a, b| a + b)
        }

        #[inline]
        pub fn minus(self, other: Self) -> Self {
            self.with(other, |a, b| a - b)
        }

        #[inline]
        pub fn times(self, other: Self) -> Self {
            self.with(other, |a, b| a * b)
        }

        #[inline]
        pub fn lesser(self, other: Self) -> Self {
            self.with(other, |a, b| if a < b { a } else { b })
        }

        #[inline]
        pub fn greater(self, other: Self) -> Self {
            self.with(other, |a, b| if a > b { a } else { b })
        }

        /// Returns 2 to the power of the nearest integer, for values from -1 to 9, by writing the exponent bits.
        #[inline]
        pub fn power_of_nearest(self) -> Self {
            Self(self.0.map(|v| f32::from_bits(nearest(v).wrapping_add(127) << 23)))
        }

        /// Returns the integers nearest to these and then to the other numbers, all from 0 to 255, as bytes, lowest
        /// first.
        #[inline]
        pub fn bytes(self, others: Self) -> u64 {
            let lanes = self.0.iter().chain(&others.0).rev();
            lanes.fold(0, |bytes, &v| bytes << 8 | u64::from(nearest(v)))
        }
    }

    /// Two numbers, neither of them NaN.
    #[derive(Clone, Copy)]
    pub struct Pair([f64; 2]);

    impl Pair {
        #[inline]
        pub fn new(values: [f64; 2]) -> Self {
            Self(values)
        }

        #[inline]
        fn with(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
            Self([f(self.0[0], other.0[0]), f(self.0[1], other.0[1])])
        }

        #[inline]
        pub fn plus(self, other: Self) -> Self {
            self.with(other, |a, b| a + b)
        }

        #[inline]
        pub fn minus(self, other: Self) -> Self {
            self.with(other, |a, b| a - b)
        }

        #[inline]
        pub fn times(self, other: Self) -> Self {
            self.with(other, |a, b| a * b)
        }

        #[inline]
        pub fn lesser(self, other: Self) -> Self {
            self.with(other, |a, b| if a < b { a } else { b })
        }

        #[inline]
        pub fn greater(self, other: Self) -> Self {
            self.with(other, |a, b| if a > b { a } else { b })
        }

        #[inline]
        pub fn both(self) -> [f64; 2] {
            self.0
        }
    }

    /// Lowest bottom and highest top of spans.
    #[derive(Clone, Copy)]
    pub struct Unions(u32, u32);

    impl Unions {
        /// Extent of those of four spans that meet `low..=high`.
        #[inline]
        pub fn meeting(spans: &[Span; 4], low: u32, high: u32) -> Self {
            let met = spans.iter().filter(|span| span.meets(low, high));
            met.fold(Self(u32::MAX, 0), |ends, span| ends.join(Self(span.bottom(), span.top())))
        }

        #[inline]
        pub fn join(self, other: Self) -> Self {
            Self(self.0.min(other.0), self.1.max(other.1))
        }

        /// Returns the lowest bottom and the highest top; the first exceeds the second if no span was met.
        #[inline]
        pub fn ends(self) -> (u32, u32) {
            (self.0, self.1)
        }
    }

    /// Lanes and heights against which spans are tested.
    #[derive(Clone, Copy)]
    pub struct Window {
        lanes: [u32; 2],
        low: u32,
        high: u32,
    }

    impl Window {
        /// Window of lanes `x0..=x1` [0..8] and heights `low..=high`.
        #[inline]
        pub fn new(lanes: [u32; 2], low: u32, high: u32) -> Self {
            Self { lanes, low, high }
        }

        /// Returns the mask of those of four spans that lie in the lanes and meet the heights.
        #[inline]
        pub fn meets(self, spans: &[Span; 4]) -> u32 {
            let [x0, x1] = self.lanes;
            let inside = |span: Span| span.meets(self.low, self.high) & (x0 <= span.lane()) & (span.lane() <= x1);
            spans.iter().rev().fold(0, |mask, &span| mask << 1 | u32::from(inside(span)))
        }

        /// Returns the mask of those of sixteen spans that lie in the lanes and meet the heights.
        #[inline]
        pub fn meets_of_sixteen(self, spans: &[Span; 16]) -> u32 {
            spans.as_chunks().0.iter().rev().fold(0, |mask, four| mask << 4 | self.meets(four))
        }

        /// Returns the classes of those `spans` that lie in the lanes and meet the heights. May stop once one of
        /// `until` is found.
        #[inline]
        pub fn kinds(self, spans: &[Span], until: Kinds) -> Kinds {
            meeting_in_lanes(spans, self.lanes[0], self.lanes[1], self.low, self.high, until)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::blocks::{MATTER, OBSTACLE};
    use proptest::prelude::*;

    fn span() -> impl Strategy<Value = Span> {
        (0..16320u32, 0..16320u32, any::<bool>())
            .prop_filter_map("a span", |(a, b, obstacle)| Span::new(a.min(b), a.max(b), obstacle))
    }

    /// Results of all operations on two pairs.
    macro_rules! of_pairs {
        ($lanes:ident, $x:expr, $y:expr) => {{
            let [x, y] = [$x, $y].map($lanes::Pair::new);
            [x.plus(y), x.minus(y), x.times(y), x.lesser(y), x.greater(y)].map($lanes::Pair::both)
        }};
    }

    /// An expression in all operations, as a ray has them: `(a·b + c - b)`, at least `a` and at most `b + c`.
    macro_rules! of_floats {
        ($lanes:ident, $a:expr, $b:expr, $c:expr) => {{
            let [a, b, c] = [$a, $b, $c].map($lanes::Floats::new);
            let powers = a.times(b).plus(c).minus(b).greater(a).lesser(b.plus(c)).power_of_nearest();
            powers.bytes(powers)
        }};
    }

    proptest! {
        #[test]
        fn every_platform_computes_the_same(
            x in prop::array::uniform2(-1e9..1e9f64), y in prop::array::uniform2(-1e9..1e9f64),
            a in prop::array::uniform4(0f32..3.0), b in prop::array::uniform4(0f32..3.0),
            c in prop::array::uniform4(0f32..3.0),
        ) {
            let each = |f: fn(f64, f64) -> f64| [f(x[0], y[0]), f(x[1], y[1])];
            let expected =
                [each(|a, b| a + b), each(|a, b| a - b), each(|a, b| a * b), each(f64::min), each(f64::max)];
            prop_assert_eq!(of_pairs!(lanes, x, y), expected);
            prop_assert_eq!(of_pairs!(portable, x, y), expected);
            let value = |n: usize| (a[n] * b[n] + c[n] - b[n]).max(a[n]).min(b[n] + c[n]);
            let bytes = [0, 1, 2, 3, 0, 1, 2, 3].map(|n| 1u8 << value(n).round_ties_even() as i32);
            prop_assert_eq!(of_floats!(lanes, a, b, c), u64::from_le_bytes(bytes));
            prop_assert_eq!(of_floats!(portable, a, b, c), u64::from_le_bytes(bytes));
        }

        #[test]
        fn every_platform_finds_the_same_of_two_numbers(a in any::<f64>(), other in any::<f64>()) {
            for (a, b) in [(a, other), (a, a), (a, -a), (0.0, -0.0), (-0.0, 0.0)] {
                prop_assume!(!a.is_nan() && !b.is_nan());
                let (lesser, greater) = (lanes::lesser(a, b), lanes::greater(a, b));
                prop_assert_eq!(lesser.to_bits(), portable::lesser(a, b).to_bits());
                prop_assert_eq!(greater.to_bits(), portable::greater(a, b).to_bits());
                prop_assert_eq!((lesser, greater), (a.min(b), a.max(b)));
            }
        }

        #[test]
        fn every_platform_finds_the_same_of_two_pairs(x in prop::array::uniform2(-1e9..1e9f64)) {
            // Of two zeros, it is the second one, whatever its sign.
            for (x, y) in [(x, x), ([0.0, -0.0], [-0.0, 0.0]), ([x[0], 0.0], [-0.0, x[1]])] {
                let bits = |pairs: [[f64; 2]; 5]| pairs.map(|pair| pair.map(f64::to_bits));
                prop_assert_eq!(bits(of_pairs!(lanes, x, y)), bits(of_pairs!(portable, x, y)));
            }
        }

        #[test]
        fn every_platform_finds_the_same_ends(
            quads in prop::array::uniform2(prop::array::uniform4(span())), a in 0..16400u32, b in 0..16400u32
        ) {
            let (low, high) = (a.min(b), a.max(b));
            let met: Vec<Span> = quads.as_flattened().iter().copied().filter(|span| span.meets(low, high)).collect();
            let lowest = met.iter().map(|span| span.bottom()).min();
            let expected = lowest.zip(met.iter().map(|span| span.top()).max());
            let [first, second] = quads.map(|quad| lanes::Unions::meeting(&quad, low, high));
            let (bottom, top) = first.join(second).ends();
            prop_assert_eq!((bottom <= top).then_some((bottom, top)), expected);
            let [first, second] = quads.map(|quad| portable::Unions::meeting(&quad, low, high));
            let (bottom, top) = first.join(second).ends();
            prop_assert_eq!((bottom <= top).then_some((bottom, top)), expected);
        }

        #[test]
        fn every_platform_finds_the_same_spans_in_a_window(
            spans in prop::array::uniform16((span(), 0..8u32).prop_map(|(span, lane)| span.in_lane(lane))),
            a in 0..16400u32, b in 0..16400u32, c in 0..8u32, d in 0..8u32,
        ) {
            let (low, high, x) = (a.min(b), a.max(b), [c.min(d), c.max(d)]);
            let inside = |span: &Span| span.meets(low, high) && (x[0]..=x[1]).contains(&span.lane());
            let expected: u32 = spans.iter().zip(0..).map(|(span, n)| u32::from(inside(span)) << n).sum();
            prop_assert_eq!(lanes::Window::new(x, low, high).meets_of_sixteen(&spans), expected);
            prop_assert_eq!(portable::Window::new(x, low, high).meets_of_sixteen(&spans), expected);
            for (n, four) in spans.as_chunks().0.iter().enumerate() {
                prop_assert_eq!(lanes::Window::new(x, low, high).meets(four), expected >> (4 * n) & 0xF);
                prop_assert_eq!(portable::Window::new(x, low, high).meets(four), expected >> (4 * n) & 0xF);
            }
        }

        #[test]
        fn every_platform_finds_the_same_kinds(
            spans in prop::collection::vec((span(), 0..8u32).prop_map(|(span, lane)| span.in_lane(lane)), 0..40),
            a in 0..16400u32, b in 0..16400u32, c in 0..8u32, d in 0..8u32,
        ) {
            let (low, high, x) = (a.min(b), a.max(b), [c.min(d), c.max(d)]);
            let inside = spans.iter().filter(|span| span.meets(low, high) && (x[0]..=x[1]).contains(&span.lane()));
            let expected = inside.fold(0, |kinds, span| kinds | span.kinds());
            for until in [0, MATTER, OBSTACLE] {
                let kinds = [
                    lanes::Window::new(x, low, high).kinds(&spans, until),
                    portable::Window::new(x, low, high).kinds(&spans, until),
                ];
                for kinds in kinds {
                    prop_assert!(kinds == expected || kinds & until != 0 && kinds & !expected == 0);
                }
            }
        }

        #[test]
        fn every_platform_makes_the_same_bytes(values in prop::array::uniform8(-0.5f32..7.5), edge in 0..8u8) {
            let mut values = values;
            values[0] = f32::from(edge) - 0.5;
            let powers = |values: [f32; 4]| lanes::Floats::new(values).power_of_nearest();
            let [low, high] = [0, 4].map(|n| [values[n], values[n + 1], values[n + 2], values[n + 3]]);
            let bytes = powers(low).bytes(powers(high));
            let expected = values.map(|v| 1u8 << v.round_ties_even() as i32);
            prop_assert_eq!(bytes, u64::from_le_bytes(expected));
            let powers = |values: [f32; 4]| portable::Floats::new(values).power_of_nearest();
            prop_assert_eq!(powers(low).bytes(powers(high)), bytes);
        }
    }
}
