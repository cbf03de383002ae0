//! Fast parsing of short decimal numbers, as scanners write them.
//!
//! If up to 19 digits form a whole number of at most 2⁵³, the value is this number divided by a power of ten that is
//! exact too, so a single division rounds correctly (W. D. Clinger, "How to read floating point numbers accurately",
//! 1990). All other numbers are left to the standard library, which gives the same result for these.

/// Powers of ten that `f64` represents exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];
/// Number of digits that always fit in 64 bits.
const MOST_DIGITS: usize = 19;

/// Parses the short number at the start of `text`: a sign, digits, and optionally `point` and more digits. Returns it
/// and its length. What follows may turn it into another number; the caller must check.
#[inline]
pub(in crate::cloud) fn short(text: &[u8], point: u8) -> Option<(f64, usize)> {
    let signed = matches!(text.first(), Some(b'-' | b'+'));
    let digits = &text[usize::from(signed)..];
    let (mut whole, mut at) = (0u64, 0);
    let mut take = |at: &mut usize| {
        while let Some(digit) = digits.get(*at).map(|byte| byte.wrapping_sub(b'0')).filter(|&digit| digit < 10) {
            // Wraps beyond 19 digits; such numbers are refused below.
            whole = whole.wrapping_mul(10).wrapping_add(digit.into());
            *at += 1;
        }
    };
    take(&mut at);
    let (mut count, mut behind) = (at, 0);
    if digits.get(at) == Some(&point) {
        let begin = at + 1;
        at = begin;
        take(&mut at);
        behind = at - begin;
        count += behind;
    }
    if count == 0 || count > MOST_DIGITS || whole > 1 << 53 {
        return None;
    }
    let value = whole as f64 / POWERS[behind];
    Some((if text[0] == b'-' { -value } else { value }, at + usize::from(signed)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn same(text: &str) {
        let expected: f64 = text.parse().unwrap();
        match short(text.as_bytes(), b'.') {
            Some((value, len)) => {
                assert_eq!((value.to_bits(), len), (expected.to_bits(), text.len()), "{text}");
            }
            None => assert!(text.bytes().filter(u8::is_ascii_digit).count() > 15, "{text} is short"),
        }
    }

    proptest! {
        #[test]
        fn short_numbers_are_those_of_the_standard_library(sign in "[+-]?", whole in "[0-9]{1,19}", part in "(\\.[0-9]{0,19})?") {
            same(&format!("{sign}{whole}{part}"));
        }

        #[test]
        fn written_numbers_are_read_back(value in -1e7f64..1e7, places in 0usize..10) {
            same(&format!("{value:.places$}"));
        }
    }

    #[test]
    fn edges_and_what_is_no_short_number() {
        ["0", "-0.0", "+1.", ".5", "-.25", "9007199254740992", "0.000000000000000001"].into_iter().for_each(same);
        for text in
            ["", "-", ".", "+.", "x", "nan", "9007199254740993", "12345678901234567890", "0.00000000000000000001"]
        {
            assert_eq!(short(text.as_bytes(), b'.'), None, "{text}");
        }
        assert_eq!(short(b"1e5", b'.'), Some((1.0, 1)));
        assert_eq!(short(b"1.5", b','), Some((1.0, 1)));
        assert_eq!(short(b"-1,5 2", b','), Some((-1.5, 4)));
    }
}
