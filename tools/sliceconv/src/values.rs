//! Values of options, with messages for wrong ones.

use std::ops::RangeInclusive;

pub fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("expected a length in metres above 0".into()),
    }
}

/// Parses a class or a range of classes: `7`, `64-255`.
pub fn classes(text: &str) -> Result<RangeInclusive<u8>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.trim().parse(), last.trim().parse()) {
        (Ok(first), Ok(last)) if first <= last => Ok(first..=last),
        _ => Err("expected classes from 0 to 255 and ranges of them, such as 7,18,64-255".into()),
    }
}

/// Parses the number of an EPSG code.
pub fn epsg(text: &str) -> Result<u32, String> {
    let code = text.get(..5).filter(|start| start.eq_ignore_ascii_case("EPSG:")).and_then(|_| text[5..].parse().ok());
    code.filter(|code| (1..1_000_000).contains(code)).ok_or_else(|| "expected a code such as EPSG:25832".into())
}

pub fn part(text: &str) -> Result<(u32, u32), String> {
    let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    numbers
        .filter(|&(index, count)| (1..=count).contains(&index) && count <= slicewalk::archive::MAX_SHARDS)
        .ok_or_else(|| format!("expected a part and their number, from 1/1 to {0}/{0}", slicewalk::archive::MAX_SHARDS))
}
