//! The committed counts: a table of TOML, `path = instructions each`.

use crate::stability::Result;
use crate::stability::table::number;
use std::collections::BTreeMap;
use std::path::Path;

const HEAD: &str = "\
# Instructions of the hot paths, per operation, as callgrind counts them in a release build.
# `.ci/counts` compares with these; `.ci/counts --write` renews them.
[instructions]
";

/// Counts by name.
#[derive(Debug, Default)]
pub struct Committed(BTreeMap<String, f64>);

impl Committed {
    /// The counts in the file at `path`; none where there is no such file.
    pub fn read(path: &Path) -> Result<Self> {
        match std::fs::read_to_string(path) {
            Ok(text) => Self::parse(&text).map_err(|said| format!("{}: {said}", path.display()).into()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(format!("{}: {error}", path.display()).into()),
        }
    }

    /// The part of TOML that [`Committed::write`] writes.
    fn parse(text: &str) -> std::result::Result<Self, String> {
        let mut counts = BTreeMap::new();
        for (n, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') || line == "[instructions]" {
                continue;
            }
            let entry = line.split_once('=').and_then(|(name, count)| Some((name, count.trim().parse::<f64>().ok()?)));
            match entry {
                Some((name, count)) if count > 0.0 => counts.insert(name.trim().to_owned(), count),
                _ => return Err(format!("line {}: expected `path = count`, found {line:?}", n + 1)),
            };
        }
        Ok(Self(counts))
    }

    /// The committed count of a path.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.get(name).copied()
    }

    /// Writes counts to the file at `path`.
    pub fn write<'a>(path: &Path, counts: impl Iterator<Item = (&'a str, f64)>) -> Result<()> {
        let lines: String = counts.map(|(name, count)| format!("{name} = {}\n", number(count, 1))).collect();
        std::fs::write(path, HEAD.to_owned() + &lines).map_err(|e| format!("{}: {e}", path.display()).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_nonsense_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("counts.toml");
        assert!(Committed::read(&path).expect("no file, no counts").get("ray").is_none());
        Committed::write(&path, [("ray", 2345.67), ("floor", 9.0)].into_iter()).expect("writes");
        assert_eq!(Committed::read(&path).expect("reads").get("ray"), Some(2345.7));
        for nonsense in ["ray = ten", "ray", "ray = -1", "ray = NaN"] {
            assert!(Committed::parse(nonsense).expect_err(nonsense).contains("line 1"), "{nonsense}");
        }
    }

    /// A path that is counted and not committed would be guarded by nothing.
    #[test]
    fn every_path_has_a_committed_count() {
        let known = Committed::parse(include_str!("../../counts.toml")).expect("sound");
        for name in super::super::paths::NAMES {
            assert!(known.get(name).is_some(), "{name}");
        }
    }
}
