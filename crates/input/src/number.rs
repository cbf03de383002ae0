//! Numbers in files, binary and as text.

/// Storage type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    /// 8 bits, signed.
    I8,
    /// 8 bits, unsigned.
    U8,
    /// 16 bits, signed.
    I16,
    /// 16 bits, unsigned.
    U16,
    /// 32 bits, signed.
    I32,
    /// 32 bits, unsigned.
    U32,
    /// 64 bits, signed.
    I64,
    /// 64 bits, unsigned.
    U64,
    /// IEEE 754, 16 bits.
    F16,
    /// IEEE 754, 32 bits.
    F32,
    /// IEEE 754, 64 bits.
    F64,
}

impl Number {
    /// Returns the length (bytes).
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Reads the number at the start of `at`, which must be long enough.
    #[inline]
    pub fn read(self, at: &[u8], big: bool) -> f64 {
        let mut value = [0; 8];
        let bytes = &mut value[..self.bytes()];
        bytes.copy_from_slice(&at[..bytes.len()]);
        if big {
            bytes.reverse();
        }
        let [a, b, c, d, ..] = value;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I64 => i64::from_le_bytes(value) as f64,
            Self::U64 => u64::from_le_bytes(value) as f64,
            Self::F16 => half(u16::from_le_bytes([a, b])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(value),
        }
    }
}

/// Converts a number in half precision, exactly.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3FF);
    let size = match (bits >> 10) & 0x1F {
        0 => fraction / f64::from(1 << 24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1024.0 + fraction) * f64::from(1u32 << (exponent - 1)) / f64::from(1 << 24),
    };
    if bits >> 15 == 0 { size } else { -size }
}

/// Words for a missing number other than `nan`: those of C libraries, databases and statistics programs.
const NO_NUMBERS: [&str; 11] = ["nanq", "nans", "qnan", "snan", "na", "n/a", "#n/a", "<na>", "null", "none", "nil"];

/// Parses a number in text: returns NaN for a word for a missing number, and `None` for any other text. `comma` is true
/// for decimal commas.
///
/// In every format a NaN coordinate means no return, because programs mark those so. An infinite one is a loss: an
/// overflow or a division by zero produced it from a measured point.
pub fn decimal(word: &[u8], comma: bool) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    let mut points = [0; 64];
    let number = match (comma, points.get_mut(..word.len())) {
        (false, _) => text.parse().ok(),
        // Beside decimal commas, a point separates thousands.
        (true, Some(points)) if !word.contains(&b'.') => {
            points.copy_from_slice(word);
            points.iter_mut().filter(|byte| **byte == b',').for_each(|byte| *byte = b'.');
            std::str::from_utf8(points).ok().and_then(|text| text.parse().ok())
        }
        (true, _) => None,
    };
    number.or_else(|| spelled(text))
}

/// Returns NaN or an infinity for the spellings of C libraries and other programs that Rust does not parse.
#[cold]
fn spelled(text: &str) -> Option<f64> {
    let infinite = if text.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY };
    let word = text.strip_prefix(['+', '-']).unwrap_or(text);
    match word.as_bytes() {
        // Microsoft's C library: 1.#INF, 1.#QNAN, 1.#IND00, 1.#J, 1.$.
        [b'1', b'.' | b',', b'#', b'I' | b'i', b'N' | b'n', b'F' | b'f', ..] => Some(infinite),
        [b'1', b'.' | b',', b'#' | b'$', ..] => Some(f64::NAN),
        [b'n' | b'N', b'a' | b'A', b'n' | b'N', b'(', .., b')'] => Some(f64::NAN),
        _ => NO_NUMBERS.iter().any(|other| word.eq_ignore_ascii_case(other)).then_some(f64::NAN),
    }
}

#[cfg(test)]
mod tests {
    use super::{Number, decimal};

    #[test]
    fn half_precision_is_read_exactly() {
        let cases: [(u16, f64); 9] = [
            (0x3C00, 1.0),
            (0xC000, -2.0),
            (0x7BFF, 65504.0),
            (0x0001, 2f64.powi(-24)),
            (0x03FF, 1023.0 * 2f64.powi(-24)),
            (0x0400, 2f64.powi(-14)),
            (0x3555, 1365.0 / 4096.0),
            (0x7C00, f64::INFINITY),
            (0xFC00, f64::NEG_INFINITY),
        ];
        for (bits, value) in cases {
            assert_eq!(Number::F16.read(&bits.to_le_bytes(), false), value, "{bits:#06x}");
            assert_eq!(Number::F16.read(&bits.to_be_bytes(), true), value, "{bits:#06x}");
        }
        assert!(Number::F16.read(&[0, 0x7E], false).is_nan());
    }

    #[test]
    fn numbers_of_every_type_are_read_in_both_byte_orders() {
        let cases: [(Number, &[u8], f64); 10] = [
            (Number::I8, &[0xFE], -2.0),
            (Number::U8, &[0xFE], 254.0),
            (Number::I16, &[0xFE, 0xFF], -2.0),
            (Number::U16, &[0xFE, 0xFF], 65_534.0),
            (Number::I32, &[0xFE, 0xFF, 0xFF, 0xFF], -2.0),
            (Number::U32, &[0xFE, 0xFF, 0xFF, 0xFF], 4_294_967_294.0),
            (Number::I64, &[0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF], -2.0),
            (Number::U64, &[1, 0, 0, 0, 0, 0, 0, 0x80], 9_223_372_036_854_775_808.0),
            (Number::F32, &[0, 0, 0x20, 0xC0], -2.5),
            (Number::F64, &[0, 0, 0, 0, 0, 0, 4, 0xC0], -2.5),
        ];
        for (number, little, value) in cases {
            let big: Vec<u8> = little.iter().rev().copied().collect();
            assert_eq!(number.bytes(), little.len(), "{number:?}");
            assert_eq!([number.read(little, false), number.read(&big, true)], [value; 2], "{number:?}");
        }
    }

    #[test]
    fn numbers_are_read_in_every_spelling() {
        let missing = [
            "nan",
            "NaN",
            "-nan",
            "+NAN",
            "nan(ind)",
            "-nan(ind)",
            "nan(snan)",
            "-NAN(0x8000000000000)",
            "NANQ",
            "1.#QNAN",
            "1.#QNAN0",
            "-1.#IND",
            "-1.#IND00",
            "1.#J",
            "-1.$",
            "1,#QNAN",
            "NA",
            "n/a",
            "#N/A",
            "<NA>",
            "null",
            "NULL",
            "None",
            "nil",
        ];
        let infinite = ["inf", "+Infinity", "1.#INF", "1.#INFe+000", "1,#inf", "-inf", "-INFINITY", "-1.#INF00"];
        for comma in [false, true] {
            for word in missing {
                assert!(decimal(word.as_bytes(), comma).is_some_and(f64::is_nan), "{word}");
            }
            for word in infinite {
                let expected = if word.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY };
                assert_eq!(decimal(word.as_bytes(), comma), Some(expected), "{word}");
            }
            for word in ["", "-", "nand", "nano", "nan(", "0x10", "one", "1.QNAN", "1,234,5", "1.234,5", "--nan"] {
                assert_eq!(decimal(word.as_bytes(), comma), None, "{word}");
            }
        }
        for (word, with_point, with_comma) in [
            ("-1.5e3", Some(-1500.0), None),
            ("1,5", None, Some(1.5)),
            ("1e400", Some(f64::INFINITY), Some(f64::INFINITY)),
        ] {
            assert_eq!([false, true].map(|comma| decimal(word.as_bytes(), comma)), [with_point, with_comma], "{word}");
        }
    }
}
