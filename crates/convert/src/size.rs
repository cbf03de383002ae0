//! Sizes in bytes, as command lines take them.

/// Parses a number of bytes such as `512MiB`, `16m` or `1e6`; units B, KiB, MiB, GiB, TiB (also K, M, G, T) and KB, MB,
/// GB, in any case. The error says what was expected.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit: u64 = match text[digits.len()..].to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kib" => 1 << 10,
        "m" | "mib" => 1 << 20,
        "g" | "gib" => 1 << 30,
        "t" | "tib" => 1 << 40,
        "kb" => 1_000,
        "mb" => 1_000_000,
        "gb" => 1_000_000_000,
        other => return Err(format!("unknown unit {other:?}: expected B, KiB, MiB, GiB, KB, MB or GB")),
    };
    let value: f64 = digits.trim().parse().map_err(|_| "expected a size such as 512MiB".to_owned())?;
    let bytes = value * unit as f64;
    if (0.0..1e18).contains(&bytes) {
        Ok(bytes as u64)
    } else {
        Err("expected a size from 0 to less than 1e18 bytes".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_their_units() {
        for (text, bytes) in [
            ("0", 0),
            ("512MiB", 512 << 20),
            ("1.5k", 1536),
            ("2TiB", 2 << 40),
            ("1t", 1 << 40),
            ("3kb", 3_000),
            ("0.5MB", 500_000),
            ("2 GB", 2_000_000_000),
            ("7b", 7),
        ] {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "MiB", "-1", "12parsecs", "nan", "1e30", "20000000T", "1e17k"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }
}
