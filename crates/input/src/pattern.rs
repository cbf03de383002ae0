//! Glob patterns over folders, with names of any bytes and links that may form cycles.
//!
//! The crate `glob` matches names. Its own walk silently skips names that are not UTF-8, and follows cyclic links until
//! paths become too long. Memory: the folders still to visit, and the ids of those that `**` entered.

use crate::bytes::FileId;
use crate::{Error, Monitor, Result};
use glob::Pattern;
use std::collections::HashSet;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
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

/// Calls `found` with each file whose path matches `pattern`, following links. Calls `failed`, which decides whether the
/// walk continues, if a folder cannot be listed, or if the system does not say whether a name exists or is a folder.
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
                match fs::symlink_metadata(&next) {
                    Ok(_) => open.push((next, number + 1)),
                    Err(error) if is_nothing(&error) => {}
                    Err(error) => failed(Error::io(next, "look up", error))?,
                }
                continue;
            }
            Step::Folders if FileId::at(here(&path)).is_some_and(|id| !entered.insert((id, number))) => continue,
            Step::Folders => list(&path, |_| true),
            Step::Matching(pattern) => list(&path, |name| matches(pattern, name)),
        };
        let mut names = match names {
            Ok(names) => names,
            Err(error) if is_nothing(&error) => continue,
            Err(error) => {
                failed(Error::io(here(&path), "list", error))?;
                continue;
            }
        };
        // Reversed: the name pushed last is visited first.
        names.sort_by(|a, b| b.cmp(a));
        match step {
            Step::Folders => {
                for path in names.into_iter().map(|name| path.join(name)) {
                    match fs::metadata(&path) {
                        Ok(found) if found.is_dir() => open.push((path, number)),
                        Ok(_) => {}
                        Err(error) if is_nothing(&error) => {}
                        Err(error) => failed(Error::io(path, "look up", error))?,
                    }
                }
                open.push((path, number + 1));
            }
            _ => open.extend(names.into_iter().map(|name| (path.join(name), number + 1))),
        }
    }
    Ok(())
}

/// Number of the system's error for a link that leads back to itself.
const LOOP: i32 = if cfg!(any(target_os = "linux", target_os = "android")) {
    40
} else if cfg!(windows) {
    1921
} else {
    62
};

/// Returns whether an error says that a path does not exist, leads through a file or is a link to itself: then it
/// matches nothing.
fn is_nothing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) || error.raw_os_error() == Some(LOOP)
}

/// Returns the folder to list: `.` for an empty path.
fn here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() { Path::new(".") } else { path }
}

fn list(path: &Path, wanted: impl Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
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
        symlink("self", dir.path().join("self")).unwrap();
        assert_eq!(all(&dir.path().join("*.las")), std::slice::from_ref(&odd));
        assert!(all(&dir.path().join("self/*.las")).is_empty());
        assert_eq!(all(&dir.path().join(OsStr::from_bytes(b"Gr\xF6*"))), std::slice::from_ref(&odd));
        let mut found = all(&dir.path().join("**/*.las"));
        found.sort();
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found.contains(&odd));
        let interrupted = walk(&dir.path().join("**/*.las"), &Stops, &mut Err, &mut |_| ());
        assert!(matches!(interrupted, Err(Error::Interrupted)));
    }

    /// As in a folder that may be listed but not searched: the system does not say what a name is.
    #[cfg(unix)]
    #[test]
    fn a_name_that_cannot_be_looked_up_is_an_error_and_no_silent_gap() {
        let dir = tempfile::tempdir().unwrap();
        let long = "x".repeat(300);
        fs::write(dir.path().join("a.las"), "").unwrap();
        std::os::unix::fs::symlink(&long, dir.path().join("link")).unwrap();
        std::os::unix::fs::symlink("gone", dir.path().join("dangling")).unwrap();
        for (pattern, name) in [("**/*.las", "link"), (&*format!("f*/../{long}"), &long)] {
            let (mut errors, mut paths) = (Vec::new(), Vec::new());
            let mut fail = |error: Error| {
                errors.push(error.to_string());
                Ok(())
            };
            let pattern = dir.path().join(pattern);
            fs::create_dir_all(dir.path().join("folder")).unwrap();
            walk(&pattern, &NoMonitor, &mut fail, &mut |path| paths.push(path.to_path_buf())).unwrap();
            assert_eq!(errors.len(), 1, "{errors:?}");
            assert!(errors[0].contains(&format!("{name}: cannot look up: ")), "{errors:?}");
            assert_eq!(paths.len(), usize::from(name == "link"), "{paths:?}");
            let first = walk(&pattern, &NoMonitor, &mut Err, &mut |_| ());
            assert!(matches!(first, Err(Error::Io { .. })));
        }
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
