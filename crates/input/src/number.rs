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
            Self::I16 | Self::U16 => 2,
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
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(value),
        }
    }
}

/// Parses a number in text, including the spellings of C libraries: `nan(ind)`, `1.#QNAN`, `-1.#IND`, `1.#INF`.
pub fn decimal(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| {
        let lower = text.strip_prefix(['+', '-']).unwrap_or(text).to_ascii_lowercase();
        let infinite = if text.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY };
        match lower.strip_prefix("1.#") {
            Some(rest) if rest.starts_with("inf") => Some(infinite),
            Some(_) => Some(f64::NAN),
            None => (lower.starts_with("nan(") && lower.ends_with(')')).then_some(f64::NAN),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::decimal;

    #[test]
    fn numbers_are_read_in_every_spelling_of_c() {
        for text in ["nan", "-nan", "NaN", "nan(ind)", "-nan(ind)", "-NAN(SNAN)", "1.#QNAN", "1.#QNAN0", "-1.#IND00"] {
            assert!(decimal(text.as_bytes()).is_some_and(f64::is_nan), "{text}");
        }
        let infinite = ["inf", "-inf", "+Infinity", "1.#INF", "-1.#INF00"].map(|text| decimal(text.as_bytes()));
        assert_eq!(
            infinite.map(|v| v.map(|v| v > 0.0)),
            [Some(true), Some(false), Some(true), Some(true), Some(false)]
        );
        assert!(infinite.iter().flatten().all(|v| v.is_infinite()));
        assert_eq!(decimal(b"-1.5e3"), Some(-1500.0));
        for text in ["", "nand", "nan(", "1.#", "1,5", "0x10", "one"] {
            assert!(decimal(text.as_bytes()).is_none_or(|v| text == "1.#" && v.is_nan()), "{text}");
        }
    }
}
