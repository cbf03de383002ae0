//! Names by which a file refers to others: beside it, or in folders below.

use crate::bytes::held;
use crate::text::shown;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

/// The files that one file refers to.
pub struct Beside {
    of: PathBuf,
    /// Names by path, of all files asked for.
    names: HashMap<PathBuf, PathBuf>,
}

impl Beside {
    /// Creates the list of the file at `of`.
    pub fn new(of: &Path) -> Self {
        Self { of: of.to_path_buf(), names: HashMap::new() }
    }

    /// Returns the path of the file that it calls `name`; the error says that it lies elsewhere, or that another one
    /// might be meant.
    pub fn path(&mut self, name: &str) -> Result<PathBuf, String> {
        // Files from Windows separate folders with backslashes.
        let below = PathBuf::from(name.replace('\\', "/"));
        let is_drive = name.as_bytes().get(1) == Some(&b':');
        let is_below = below.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if !is_below || is_drive || name.is_empty() {
            let name = shown(name.as_bytes());
            return Err(format!("{name} leads out of the folder of the file; put it there and name it so"));
        }
        let below: PathBuf = below.components().filter(|part| *part != Component::CurDir).collect();
        let path = self.of.with_file_name(&below);
        // A browser hands files over without their folders.
        let bare = below.file_name().map(|name| self.of.with_file_name(name));
        let path = bare.filter(|bare| held(&path).is_none() && held(bare).is_some()).unwrap_or(path);
        let known = self.names.entry(path.clone()).or_insert_with(|| below.clone());
        if *known != below {
            let [known, name] = [&*known, &below].map(|name| shown(name.as_os_str().as_encoded_bytes()));
            return Err(format!(
                "{name} and {known} differ in their folders, which are not known here; rename one, or write the model as \
                 one file"
            ));
        }
        Ok(path)
    }
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
    use crate::bytes::release_sources;
    use crate::bytes::testing::hold;

    /// Which of two files of one name a browser handed over is not known.
    #[test]
    fn files_of_one_name_in_two_folders_are_not_taken_for_one() {
        let mut beside = Beside::new(Path::new("models/a.gltf"));
        for name in ["a/data.bin", "b/data.bin", "./a\\data.bin", "data.bin"] {
            let path = name.replace('\\', "/").replace("./", "");
            assert_eq!(beside.path(name), Ok(Path::new("models").join(path)), "{name}");
        }
        hold("handed/data.bin", *b"any");
        let mut beside = Beside::new(Path::new("handed/a.gltf"));
        for name in ["a/data.bin", "a\\data.bin", "./a/data.bin"] {
            assert_eq!(beside.path(name), Ok("handed/data.bin".into()), "{name}");
        }
        for name in ["b/data.bin", "data.bin"] {
            let reason = beside.path(name).unwrap_err();
            assert!(reason.contains("differ in their folders, which are not known here"), "{reason}");
        }
        release_sources();
    }

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
