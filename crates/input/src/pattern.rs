//! Glob patterns over folders, with names of any bytes and links that may form cycles.
//!
//! The crate `glob` matches names. Its own walk silently skips names that are not UTF-8, and follows cyclic links until
//! paths become too long. Memory: the folders still to visit, and the ids of those that `**` entered.

use crate::bytes::FileId;
use crate::{Error, Monitor, Result};
use glob::Pattern;
use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Returns whether a path contains pattern characters.
pub(super) fn is_pattern(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().iter().any(|byte| matches!(byte, b'*' | b'?' | b'['))
}

/// One component of a pattern.
enum Step {
    /// A literal name.
    Exactly(PathBuf),
    /// Names that match a pattern.
    Matching(Pattern),
    /// `**`: any number of folders, including none.
    Folders,
}

impl Step {
    fn of(component: Component, pattern: &Path) -> Result<Self> {
        let name = component.as_os_str();
        Ok(match component {
            Component::Normal(_) if name == "**" => Self::Folders,
            Component::Normal(_) if is_pattern(Path::new(name)) => {
                let parsed = Pattern::new(&name.to_string_lossy());
                Self::Matching(parsed.map_err(|e| Error::input(pattern, "pattern", e.to_string()))?)
            }
            _ => Self::Exactly(PathBuf::from(name)),
        })
    }
}

/// Matches a name; each invalid UTF-8 sequence counts as one unknown character.
fn matches(pattern: &Pattern, name: &OsStr) -> bool {
    pattern.matches(&name.to_string_lossy())
}

/// Calls `found` with each file whose path matches `pattern`, following links. If a folder cannot be listed, calls
/// `failed`, which decides whether the walk continues.
pub(super) fn walk(
    pattern: &Path,
    monitor: &dyn Monitor,
    failed: &mut dyn FnMut(Error) -> Result<()>,
    found: &mut dyn FnMut(&Path),
) -> Result<()> {
    let steps = pattern.components().map(|component| Step::of(component, pattern)).collect::<Result<Vec<_>>>()?;
    // Stack of paths, each with the index of its next step. A folder that `**` entered is not entered again.
    let mut open = vec![(PathBuf::new(), 0)];
    let mut entered: HashSet<(FileId, usize)> = HashSet::new();
    while let Some((path, number)) = open.pop() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let Some(step) = steps.get(number) else {
            if !path.is_dir() {
                found(&path);
            }
            continue;
        };
        let names = match step {
            Step::Exactly(name) => {
                let next = path.join(name);
                // A path that does not exist, or that leads through a file, matches nothing.
                if fs::symlink_metadata(&next).is_ok() {
                    open.push((next, number + 1));
                }
                continue;
            }
            Step::Folders => {
                let again = FileId::at(here(&path)).is_some_and(|id| !entered.insert((id, number)));
                if again || !here(&path).is_dir() {
                    continue;
                }
                list(&path, |_| true)
            }
            Step::Matching(pattern) if here(&path).is_dir() => list(&path, |name| matches(pattern, name)),
            Step::Matching(_) => continue,
        };
        let mut names = match names {
            Ok(names) => names,
            Err(error) => {
                failed(Error::io(here(&path), "list", error))?;
                continue;
            }
        };
        // Reversed: the name pushed last is visited first.
        names.sort_by(|a, b| b.cmp(a));
        match step {
            Step::Folders => {
                open.extend(
                    names
                        .into_iter()
                        .map(|name| path.join(name))
                        .filter(|path| path.is_dir())
                        .map(|path| (path, number)),
                );
                open.push((path, number + 1));
            }
            _ => open.extend(names.into_iter().map(|name| (path.join(name), number + 1))),
        }
    }
    Ok(())
}

/// Returns the folder to list: `.` for an empty path.
fn here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() { Path::new(".") } else { path }
}

fn list(path: &Path, wanted: impl Fn(&OsStr) -> bool) -> std::io::Result<Vec<std::ffi::OsString>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(here(path))? {
        let name = entry?.file_name();
        if wanted(&name) {
            names.push(name);
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk_base::NoMonitor;

    fn all(pattern: &Path) -> Vec<PathBuf> {
        let mut paths = Vec::new();
        walk(pattern, &NoMonitor, &mut Err, &mut |path| paths.push(path.to_path_buf())).unwrap();
        paths
    }

    #[test]
    fn paths_match_as_the_crate_glob_matches_them() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.las", "b.las", ".hidden.las", "x/a.las", "x/y/a.laz", "x/y/z/[1].las", "x y/b.las"] {
            let path = dir.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, name).unwrap();
        }
        for pattern in [
            "*.las",
            "?.las",
            "*/*.las",
            "**/*.las",
            "x/**/*.la?",
            "**/y/*",
            "*/y/a.laz",
            "x/../*.las",
            "./[ab].las",
            "**/[[]1].las",
            "x*/[!b].las",
            "**/**/a.*",
            "none/*.las",
            "a.las/*",
            "x/y/z/[[]*",
            "**",
        ] {
            let whole = dir.path().join(pattern);
            let expected = glob::glob(whole.to_str().unwrap()).unwrap().map(|path| path.unwrap());
            let mut expected: Vec<PathBuf> = expected.filter(|path| !path.is_dir()).collect();
            expected.sort();
            let mut found = all(&whole);
            found.sort();
            found.dedup();
            assert_eq!(found, expected, "{pattern}");
        }
        assert!(walk(Path::new("a[.las"), &NoMonitor, &mut Err, &mut |_| ()).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn names_of_any_bytes_are_found_and_links_in_circles_end() {
        use std::os::unix::{ffi::OsStrExt, fs::symlink};
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join(OsStr::from_bytes(b"Gr\xF6\xDFe.las"));
        fs::write(&odd, "").unwrap();
        fs::create_dir_all(dir.path().join("a/b")).unwrap();
        fs::write(dir.path().join("a/b/c.las"), "").unwrap();
        // Each of the ten links leads back: a walk that follows them sees 10^40 paths.
        for n in 0..10 {
            symlink("..", dir.path().join(format!("a/up{n}"))).unwrap();
            symlink(dir.path(), dir.path().join(format!("a/b/top{n}"))).unwrap();
        }
        assert_eq!(all(&dir.path().join("*.las")), std::slice::from_ref(&odd));
        assert_eq!(all(&dir.path().join(OsStr::from_bytes(b"Gr\xF6*"))), std::slice::from_ref(&odd));
        let mut found = all(&dir.path().join("**/*.las"));
        found.sort();
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found.contains(&odd));
        let interrupted = walk(&dir.path().join("**/*.las"), &Stops, &mut Err, &mut |_| ());
        assert!(matches!(interrupted, Err(Error::Interrupted)));
    }

    #[cfg(unix)]
    struct Stops;

    #[cfg(unix)]
    impl Monitor for Stops {
        fn cancelled(&self) -> bool {
            true
        }
    }
}
