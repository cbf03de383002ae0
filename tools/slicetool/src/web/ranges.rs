//! Single byte ranges and conditions of HTTP requests (RFC 9110, chapters 13 and 14).

use std::ops::Range;

/// Requested part of a file.
#[derive(Debug, PartialEq, Eq)]
pub enum Wanted {
    Whole,
    /// Non-empty range within the file.
    Part(Range<u64>),
    /// Range outside the file.
    Outside,
}

/// Parses `header`, the value of `Range` in a request of a file with `len` bytes. Ignores several ranges and other
/// units, as the standard allows.
pub fn wanted(header: Option<&str>, len: u64) -> Wanted {
    let range = header.and_then(|value| value.trim().strip_prefix("bytes="));
    let Some((first, last)) = range.and_then(|range| range.trim().split_once('-')) else { return Wanted::Whole };
    // Only digits, because `parse` would accept a sign.
    let number = |text: &str| match text.bytes().all(|digit| digit.is_ascii_digit()) && !text.is_empty() {
        true => Some(text.parse().unwrap_or(u64::MAX)),
        false => None,
    };
    let (begin, end) = match (number(first), number(last)) {
        (Some(begin), None) if last.is_empty() => (begin, len),
        (Some(begin), Some(last)) if begin <= last => (begin, last.saturating_add(1).min(len)),
        (None, Some(count)) if first.is_empty() => (len.saturating_sub(count), len),
        _ => return Wanted::Whole,
    };
    if begin < end { Wanted::Part(begin..end) } else { Wanted::Outside }
}

/// Returns whether `header`, the value of `If-None-Match`, contains `tag`.
pub fn names_tag(header: &str, tag: &str) -> bool {
    header.split(',').map(str::trim).any(|named| named == "*" || named.strip_prefix("W/").unwrap_or(named) == tag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_cut_to_the_file() {
        let of_100 = |header| wanted(Some(header), 100);
        assert_eq!(of_100("bytes=0-9"), Wanted::Part(0..10));
        assert_eq!(of_100("bytes=90-"), Wanted::Part(90..100));
        assert_eq!(of_100("bytes=90-18446744073709551615"), Wanted::Part(90..100));
        assert_eq!(of_100("bytes=99999999999999999999999-"), Wanted::Outside);
        assert_eq!(of_100("bytes=-10"), Wanted::Part(90..100));
        assert_eq!(of_100("bytes=-1000"), Wanted::Part(0..100));
        assert_eq!(of_100("bytes=100-"), Wanted::Outside);
        assert_eq!(of_100("bytes=-0"), Wanted::Outside);
        assert_eq!(wanted(Some("bytes=0-"), 0), Wanted::Outside);
    }

    #[test]
    fn what_is_no_single_range_is_ignored() {
        let others = ["bytes=", "bytes=-", "bytes=9-1", "bytes=0-1,5-6", "lines=0-1", "bytes=+1-2", "bytes=a-b", "0-1"];
        assert!(others.into_iter().all(|header| wanted(Some(header), 100) == Wanted::Whole));
        assert_eq!(wanted(None, 100), Wanted::Whole);
    }

    #[test]
    fn tags_are_compared_one_by_one() {
        assert!(names_tag("\"a\", W/\"b\"", "\"b\"") && names_tag("*", "\"b\""));
        assert!(!names_tag("\"ab\"", "\"b\"") && !names_tag("", "\"b\""));
    }
}
