//! Temporary files beside a target.
//!
//! The name is `.TARGET.slicewalk-<16 hex digits>.part`. The file stays locked while its writer lives; leftovers of
//! writers that died are not, which is how the next run knows that it may remove them.

use super::disk;
use crate::bytes::read_exact_at;
use crate::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

const MARK: &str = ".slicewalk-";
const SUFFIX: &str = ".part";
const DIGITS: usize = 16;
/// How often another random name is tried.
const ATTEMPTS: usize = 100;
/// Bytes of the target's name in the temporary one; file systems allow 255 in all.
const MOST_NAME: usize = 200;

/// A temporary file; removed when dropped, unless it was renamed.
#[derive(Debug)]
pub(crate) struct Temporary {
    file: File,
    path: PathBuf,
    renamed: bool,
}

impl Temporary {
    /// Creates and locks a temporary file beside `target`.
    pub fn beside(target: &Path) -> Result<Self> {
        let (folder, name) = split(target)?;
        let random = RandomState::new();
        let replaces = disk::metadata(target).ok().flatten();
        for attempt in 0..ATTEMPTS {
            let mut part = prefix(name);
            part.push(format!("{:0DIGITS$x}{SUFFIX}", random.hash_one((attempt, std::process::id()))));
            let path = folder.join(part);
            let file = match disk::create(&path, replaces.as_ref()) {
                Ok(file) => file,
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(Error::io(path, "create the temporary file", error)),
            };
            let part = Self { file, path, renamed: false };
            match disk::try_lock(&part.file) {
                // Another run may take the file for a leftover before it is locked; then it is gone.
                Ok(true) if disk::metadata(&part.path).is_ok_and(|there| there.is_some()) => return Ok(part),
                Ok(_) => {}
                // Some file systems know no locks: leftovers stay there until removed by hand.
                Err(error) if error.kind() == io::ErrorKind::Unsupported => return Ok(part),
                Err(error) => return Err(Error::io(&part.path, "lock", error)),
            }
        }
        Err(Error::io(target, "create a temporary file beside it", io::ErrorKind::AlreadyExists.into()))
    }

    /// Writes `bytes` at `offset`.
    pub fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        let written = disk::write_at(&self.file, offset, bytes);
        written.map_err(|error| Error::io(&self.path, format!("write {} bytes at {offset}", bytes.len()), error))
    }

    /// Reads back what was written.
    pub fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let read = read_exact_at(&self.file, offset, buf);
        read.map_err(|error| Error::io(&self.path, format!("read {} bytes at {offset}", buf.len()), error))
    }

    /// Makes the content durable.
    pub fn sync(&self) -> Result<()> {
        disk::sync(&self.file).map_err(|error| Error::io(&self.path, "sync", error))
    }

    /// Length (bytes).
    pub fn len(&self) -> Result<u64> {
        let about = self.file.metadata().map_err(|error| Error::io(&self.path, "ask for the length", error))?;
        Ok(about.len())
    }

    /// Names the file `to` by `rename`, one of [`disk::rename`] and [`disk::rename_new`]. If that fails, the file stays
    /// temporary.
    pub fn rename(&mut self, to: &Path, rename: fn(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
        rename(&self.path, to)?;
        self.renamed = true;
        Ok(())
    }

    /// A visible name of its own for the file, in the same folder, that tells where it comes from.
    pub fn visible_name(&self, target: &Path) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let digits = name.strip_suffix(SUFFIX).and_then(|name| name.rsplit_once(MARK)).map_or("", |(_, digits)| digits);
        let mut visible = shortened(target.file_stem().unwrap_or_default());
        visible.push(format!("{MARK}{digits}"));
        if let Some(ending) = target.extension().filter(|ending| ending.len() <= DIGITS) {
            visible.push(".");
            visible.push(ending);
        }
        target.with_file_name(visible)
    }

    /// An error about the content of this file.
    pub fn broken(&self, action: &str) -> Error {
        Error::io(&self.path, action, io::ErrorKind::InvalidData.into())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.renamed {
            // Nothing sensible is left to do if this fails: the next run removes the file.
            let _ = disk::remove(&self.path);
        }
    }
}

/// Removes the temporary files that dead writers of `target` left.
pub(super) fn remove_leftovers(target: &Path) -> Result<()> {
    let (folder, name) = split(target)?;
    let prefix = prefix(name);
    let names = disk::list(folder, |name| is_part(name, &prefix)).map_err(|e| Error::io(folder, "list", e))?;
    for path in names.into_iter().map(|name| folder.join(name)) {
        // Whoever holds the lock is alive; a file that cannot be opened or removed is somebody else's.
        if disk::open_to_lock(&path).is_ok_and(|file| disk::try_lock(&file).is_ok_and(|free| free)) {
            let _ = disk::remove(&path);
        }
    }
    Ok(())
}

fn is_part(name: &OsStr, prefix: &OsStr) -> bool {
    let random = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
    let random = random.and_then(|rest| rest.strip_suffix(SUFFIX.as_bytes()));
    random.is_some_and(|digits| digits.len() == DIGITS && digits.iter().all(u8::is_ascii_hexdigit))
}

fn prefix(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(shortened(name));
    prefix.push(MARK);
    prefix
}

/// The beginning of a name too long to be a part of another one.
fn shortened(name: &OsStr) -> OsString {
    if name.len() <= MOST_NAME {
        return name.to_os_string();
    }
    let name = name.to_string_lossy();
    let ends = name.char_indices().map(|(at, letter)| at + letter.len_utf8());
    name[..ends.take_while(|&end| end <= MOST_NAME).last().unwrap_or(0)].into()
}

/// Folder and name of a target.
pub(super) fn split(target: &Path) -> Result<(&Path, &OsStr)> {
    let whole = target.as_os_str().as_encoded_bytes();
    // Not the `a` of `a/` and `a/.`, either.
    let name = target.file_name().filter(|name| whole.ends_with(name.as_encoded_bytes()));
    let name = name.ok_or_else(|| Error::output(target, "names no file; add a name"))?;
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok((folder, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_leftovers_of_the_same_target_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let alive = Temporary::beside(&target).unwrap();
        let kept = ["a.slices", ".b.slices.slicewalk-0123456789abcdef.part", ".a.slices.slicewalk-mine.part"];
        let stale = ".a.slices.slicewalk-0123456789abcdef.part";
        for name in kept.iter().chain([&stale]) {
            std::fs::write(folder.path().join(name), "old").unwrap();
        }
        remove_leftovers(&target).unwrap();
        assert!(kept.iter().all(|name| folder.path().join(name).exists()));
        assert!(!folder.path().join(stale).exists());
        assert!(alive.path.exists());
        let path = alive.path.clone();
        drop(alive);
        assert!(!path.exists());
    }

    #[test]
    fn names_as_long_as_a_file_system_allows_have_temporary_and_visible_names() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["x".repeat(255), "ü".repeat(124) + ".slices", "y".repeat(3) + "." + &"z".repeat(251)] {
            let target = folder.path().join(name);
            let mut part = Temporary::beside(&target).unwrap();
            let visible = part.visible_name(&target);
            part.rename(&visible, disk::rename_new).unwrap();
            assert!(visible.exists() && visible.to_string_lossy().contains(MARK));
        }
    }
}
