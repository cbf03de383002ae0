//! Text of command lines: numbers, sizes and names as people read them, and numbers as people type them.

use std::borrow::Cow;
use std::fmt::Display;
use std::str::FromStr;

/// Byte order mark of UTF-8, with which editors on Windows begin a text, to which it does not belong.
pub const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Returns the bytes of a text behind its byte order mark, if it has one.
pub fn behind_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text)
}

/// Formats a whole number with its digits in groups of three: `1,234,567`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Formats a number of things: `1 voxel`, `1,200 voxels`.
pub fn counted(number: u64, thing: &str) -> String {
    format!("{} {thing}{}", grouped(number), if number == 1 { "" } else { "s" })
}

/// Formats the length of a file in decimal units with three digits: `912 bytes`, `176 kB`, `20.4 GB`.
pub fn file_size(bytes: u64) -> String {
    scaled(bytes, 1000.0, ["kB", "MB", "GB", "TB", "PB", "EB"])
}

/// Formats an amount of memory in the binary units of options: `512 MiB`.
pub fn memory_size(bytes: u64) -> String {
    scaled(bytes, 1024.0, ["KiB", "MiB", "GiB", "TiB", "PiB", "EiB"])
}

fn scaled(bytes: u64, step: f64, units: [&str; 6]) -> String {
    if (bytes as f64) < step {
        return counted(bytes, "byte");
    }
    let (mut value, mut unit) = (bytes as f64 / step, 0);
    // A value that would be rounded up to the next unit is written in that unit.
    while value >= step - 0.5 && unit + 1 < units.len() {
        value /= step;
        unit += 1;
    }
    let decimals = if value >= 99.95 {
        0
    } else if value >= 9.995 {
        1
    } else {
        2
    };
    let text = format!("{value:.decimals$}");
    format!("{} {}", without_zeros(&text), units[unit])
}

/// Formats a number as short as possible without losing a bit, in powers of ten if it is far from 1: `0.25`, `1e300`.
pub fn number(value: f64) -> String {
    let text = format!("{value:?}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// Formats a position: `(1, 2.5, 1e300)`.
pub fn place(coordinates: [f64; 3]) -> String {
    format!("({})", coordinates.map(number).join(", "))
}

/// Returns the shortest decimal within half a `quantum` of `value`.
pub fn rounded(value: f64, quantum: f64) -> String {
    if value.abs() < 1e16 {
        for decimals in 0..=17 {
            let text = format!("{value:.decimals$}");
            if text.parse::<f64>().is_ok_and(|short| (short - value).abs() <= quantum / 2.0) {
                let text = without_zeros(&text);
                return if text == "-0" { "0".into() } else { text.into() };
            }
        }
    }
    number(value)
}

fn without_zeros(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Formats the edges of a box with as many decimals as `step` has: `4.62 × 4.53 × 3.7 m` for 0.05 m.
pub fn extent(min: [f64; 3], max: [f64; 3], step: f64) -> String {
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let edges = [0, 1, 2].map(|axis| match max[axis] - min[axis] {
        edge if edge.abs() < 1e16 => without_zeros(&format!("{edge:.decimals$}")).to_owned(),
        edge => number(edge),
    });
    format!("{} m", edges.join(" × "))
}

/// Formats ascending whole numbers in one short line: runs as ranges, and after `most` runs only the number of those
/// left.
pub fn ranges(numbers: impl IntoIterator<Item = u32>, most: usize) -> String {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for number in numbers {
        match runs.last_mut() {
            Some(run) if run.1 + 1 == number => run.1 = number,
            _ => runs.push((number, number)),
        }
    }
    let shown: Vec<String> = runs
        .iter()
        .take(most)
        .map(|&(first, last)| if first == last { first.to_string() } else { format!("{first}-{last}") })
        .collect();
    let rest: u64 = runs.iter().skip(most).map(|&(first, last)| u64::from(last - first) + 1).sum();
    let more = if rest == 0 { String::new() } else { format!(" and {} more", grouped(rest)) };
    shown.join(", ") + &more
}

/// Escapes `text` for one line of a terminal: control characters, line ends and marks that change the direction of
/// writing become escapes such as `\u001b`, as in JSON. File names and texts in files may hold such characters, and a
/// terminal obeys them.
pub fn one_line(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_harmful(c) || c == '\n')
}

/// Like [`one_line`], but keeps line ends. JSON stays equivalent.
pub fn lines(text: &str) -> Cow<'_, str> {
    escaped(text, is_harmful)
}

fn is_harmful(c: char) -> bool {
    let turns = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() && c != '\n' || turns
}

fn escaped(text: &str, harmful: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&harmful) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if harmful(c) {
            out += &format!("\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// Returns a parser of whole numbers from `least` to `most`; its error says what was expected.
pub fn whole_number<T>(least: T, most: T) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Copy,
{
    move |text| match text.parse() {
        Ok(number) if least <= number && number <= most => Ok(number),
        _ => Err(format!("expected a whole number from {least} to {most}")),
    }
}

/// Parses a finite number; the error says what was expected.
pub fn finite_number(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| "expected a number".into())
}

/// Returns the length of the quoted text at the beginning of `text`, including its quotes; a quote inside is doubled.
/// `None` if the text does not end.
pub fn quoted_len(text: &[u8]) -> Option<usize> {
    let mut at = 1;
    loop {
        at += text.get(at..)?.iter().position(|&byte| byte == b'"')? + 1;
        if text.get(at) != Some(&b'"') {
            return Some(at);
        }
        at += 1;
    }
}

/// Formats a word of a file for an error message: short, on one line.
pub fn shown(word: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(word).chars().take(40).flat_map(char::escape_debug).collect();
    format!("\"{text}\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_and_counted() {
        for (number, text) in
            [(0, "0"), (999, "999"), (1000, "1,000"), (112_624, "112,624"), (1 << 40, "1,099,511,627,776")]
        {
            assert_eq!(grouped(number), text);
        }
        assert_eq!([0, 1, 2].map(|n| counted(n, "finding")), ["0 findings", "1 finding", "2 findings"]);
    }

    #[test]
    fn sizes_have_three_digits_and_their_unit() {
        for (bytes, text) in [
            (1, "1 byte"),
            (999, "999 bytes"),
            (1000, "1 kB"),
            (176_123, "176 kB"),
            (2_140_000, "2.14 MB"),
            (20_400_000_000, "20.4 GB"),
            (999_600, "1 MB"),
            (u64::MAX, "18.4 EB"),
        ] {
            assert_eq!(file_size(bytes), text);
        }
        assert_eq!([512 << 20, 3 << 29, 1 << 10].map(memory_size), ["512 MiB", "1.5 GiB", "1 KiB"]);
    }

    #[test]
    fn decimals_are_no_longer_than_the_quantum_asks_for() {
        for (value, quantum, text) in [
            (-22.990000000000002, 0.15 / 255.0, "-22.99"),
            (0.1 + 0.2, 1e-9, "0.3"),
            (-1e-9, 1e-3, "0"),
            (637_000.25, 0.5, "637000"),
            (637_000.25, 0.4, "637000.2"),
            (1e300, 1.0, "1e300"),
            (f64::INFINITY, 1.0, "inf"),
            (0.1 + 0.2, 0.0, "0.30000000000000004"),
        ] {
            assert_eq!(rounded(value, quantum), text);
        }
        assert_eq!([1e300, 5.0, 0.25, 1e-12, f64::NAN].map(number), ["1e300", "5", "0.25", "1e-12", "NaN"]);
        assert_eq!(extent([0.0; 3], [4.6000001, 4.526, 3.7], 0.05), "4.6 × 4.53 × 3.7 m");
        assert_eq!(extent([0.0; 3], [1234.5, 1e300, 0.04], 2.0), "1234 × 1e300 × 0 m");
    }

    #[test]
    fn runs_of_numbers_are_ranges_and_the_line_stays_short() {
        assert_eq!(ranges([2], 8), "2");
        assert_eq!(ranges([1, 2, 3, 7, 9, 10], 8), "1-3, 7, 9-10");
        assert_eq!(ranges((1..=65_536).filter(|n| n % 2 == 0), 3), "2, 4, 6 and 32,765 more");
    }

    #[test]
    fn nothing_that_a_terminal_obeys_is_left() {
        let name = "a\u{1b}]0;owned\u{7}\n\u{9b}31m\u{202e}b\tc";
        assert_eq!(one_line(name), "a\\u001b]0;owned\\u0007\\u000a\\u009b31m\\u202eb\\u0009c");
        assert_eq!(lines("a\nb\u{7f}"), "a\nb\\u007f");
        assert_eq!(one_line("Größe 測量 א"), "Größe 測量 א");
        let json = serde_json::json!({ "name": name }).to_string();
        assert_eq!(serde_json::from_str::<serde_json::Value>(&lines(&json)).unwrap()["name"], name);
    }

    #[test]
    fn words_of_a_file_keep_their_letters() {
        assert_eq!(shown("Höhe".as_bytes()), "\"Höhe\"");
        assert_eq!(shown(b"a\"\x1b[31m\n"), r#""a\"\u{1b}[31m\n""#);
    }

    #[test]
    fn numbers_that_are_typed_wrong_are_answered_in_words() {
        assert_eq!(whole_number(1u16, 1024)("7"), Ok(7));
        for text in ["", "0", "1025", "two", "-1", "1.5", "99999999999999999999"] {
            assert_eq!(whole_number(1u16, 1024)(text), Err("expected a whole number from 1 to 1024".into()), "{text}");
        }
        assert!(finite_number("1e3") == Ok(1000.0) && finite_number("inf").is_err() && finite_number("x").is_err());
    }
}
