//! Names by which a file refers to others: beside it, or in folders below.

use crate::bytes::held;
use crate::text::shown;
use std::path::{Component, Path, PathBuf};

/// Returns the path of a file that the one at `of` refers to; the error says that it lies elsewhere.
pub fn path_beside(of: &Path, name: &str) -> Result<PathBuf, String> {
    // Files from Windows separate folders with backslashes.
    let below = PathBuf::from(name.replace('\\', "/"));
    let is_drive = name.as_bytes().get(1) == Some(&b':');
    let is_below = below.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if !is_below || is_drive || name.is_empty() {
        let name = shown(name.as_bytes());
        return Err(format!("{name} leads out of the folder of the file; put it there and name it so"));
    }
    let path = of.with_file_name(&below);
    // A browser hands files over without their folders.
    let bare = below.file_name().map(|name| of.with_file_name(name));
    Ok(bare.filter(|bare| held(&path).is_none() && held(bare).is_some()).unwrap_or(path))
}

/// Decodes `%20` and the like in the address of a file; keeps malformed codes as they are.
pub fn decode_percent(text: &str) -> String {
    let digit = |byte: &u8| char::from(*byte).to_digit(16);
    let (mut bytes, mut rest) = (Vec::with_capacity(text.len()), text.as_bytes());
    while let [byte, after @ ..] = rest {
        let code = match after {
            [high, low, ..] if *byte == b'%' => digit(high).zip(digit(low)),
            _ => None,
        };
        bytes.push(code.map_or(*byte, |(high, low)| (high << 4 | low) as u8));
        rest = if code.is_some() { &after[2..] } else { after };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_codes_are_decoded() {
        for (text, expected) in [
            ("no%20file.bin", "no file.bin"),
            ("%C3%b6%2F%41", "ö/A"),
            ("%25%20", "% "),
            ("100%", "100%"),
            ("%1", "%1"),
            ("%+1%-1% 1%0x", "%+1%-1% 1%0x"),
            ("%%20%2", "% %2"),
            ("%ö", "%ö"),
            ("", ""),
        ] {
            assert_eq!(decode_percent(text), expected, "{text}");
        }
    }
}
