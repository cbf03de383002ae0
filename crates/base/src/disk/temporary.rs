//! Temporary files next to a target, or in a folder of their own.
//!
//! The name is `.TARGET.slicewalk-<16 hex digits>` and an ending. The file stays locked while its writer lives.
//! Leftovers of dead writers are not locked, so the next run knows that it may remove them.

use super::{Access, Files, OpenFile};
use crate::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

const MARK: &str = ".slicewalk-";
/// Ending of outputs under construction.
const PART: &str = ".part";
const DIGITS: usize = 16;
/// Number of random names tried.
const ATTEMPTS: usize = 100;
/// Bytes of the target's name in the temporary name; file systems allow 255 in all.
const MOST_NAME: usize = 200;

/// Temporary file; removed when dropped, unless it was renamed or kept.
#[derive(Debug)]
pub struct Temporary {
    files: Files,
    file: OpenFile,
    path: PathBuf,
    stays: bool,
}

impl Temporary {
    /// Creates and locks a temporary file next to `target`. It gets the permissions of the file that it will replace,
    /// as far as the umask allows; the owner can always read and write it.
    pub fn beside(files: &Files, target: &Path) -> Result<Self> {
        let (folder, name) = split(target)?;
        let replaces = files.about(target).ok().flatten();
        let mode = replaces.and_then(|old| old.mode).map(|mode| mode & 0o666 | 0o600);
        Self::create(files, folder, name, PART, mode)
    }

    /// Creates and locks a temporary file for the target called `name` in `folder`.
    pub fn create(files: &Files, folder: &Path, name: &OsStr, ending: &str, mode: Option<u32>) -> Result<Self> {
        let random = RandomState::new();
        for attempt in 0..ATTEMPTS {
            let mut part = prefix(name);
            part.push(format!("{:0DIGITS$x}{ending}", random.hash_one((attempt, super::process_id()))));
            let path = folder.join(part);
            let file = match files.create(&path, mode) {
                Ok(file) => file,
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(Error::io(path, "create the temporary file", error)),
            };
            let part = Self { files: files.clone(), file, path, stays: false };
            match part.file.try_lock() {
                // Another run may remove the file as a leftover before it is locked.
                Ok(true) if files.about(&part.path).is_ok_and(|there| there.is_some()) => return Ok(part),
                Ok(_) => {}
                // Some file systems have no locks: leftovers stay there until removed by hand.
                Err(error) if error.kind() == io::ErrorKind::Unsupported => return Ok(part),
                Err(error) => return Err(Error::io(&part.path, "lock", error)),
            }
        }
        Err(Error::io(folder.join(name), "create a temporary file beside it", io::ErrorKind::AlreadyExists.into()))
    }

    /// Writes `bytes` at `offset`.
    pub fn write_at(&self, offset: u64, bytes: &[u8]) -> Result<()> {
        let written = self.file.write_at(offset, bytes);
        written.map_err(|error| Error::io(&self.path, format!("write {} bytes at {offset}", bytes.len()), error))
    }

    /// Reads back what was written.
    pub fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let read = self.file.read_exact_at(offset, buf);
        read.map_err(|error| Error::io(&self.path, format!("read {} bytes at {offset}", buf.len()), error))
    }

    /// Makes the content durable.
    pub fn sync(&self) -> Result<()> {
        self.file.sync().map_err(|error| Error::io(&self.path, "sync", error))
    }

    /// Returns the length (bytes).
    pub fn len(&self) -> Result<u64> {
        self.file.len().map_err(|error| Error::io(&self.path, "ask for the length", error))
    }

    /// Renames the file to `to`, replacing a file there if `replace` is true. If that fails, the file stays temporary.
    pub fn rename(&mut self, to: &Path, replace: bool) -> io::Result<()> {
        match replace {
            true => self.files.rename(&self.path, to),
            false => self.files.rename_new(&self.path, to),
        }?;
        self.stays = true;
        Ok(())
    }

    /// Returns a visible, unused name for the file in the same folder, derived from the name of `target`.
    pub fn visible_name(&self, target: &Path) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let digits = name.strip_suffix(PART).and_then(|name| name.rsplit_once(MARK)).map_or("", |(_, digits)| digits);
        let mut visible = shortened(target.file_stem().unwrap_or_default());
        visible.push(format!("{MARK}{digits}"));
        if let Some(ending) = target.extension().filter(|ending| ending.len() <= DIGITS) {
            visible.push(".");
            visible.push(ending);
        }
        target.with_file_name(visible)
    }

    /// Makes an error about the content of this file.
    pub fn broken(&self, action: &str) -> Error {
        Error::io(&self.path, action, io::ErrorKind::InvalidData.into())
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Functions for runs that are resumed.
#[cfg(feature = "spill")]
impl Temporary {
    /// Takes over the temporary file at `path`, which is open as `file`.
    pub fn of(files: &Files, path: PathBuf, file: OpenFile) -> Self {
        Self { files: files.clone(), file, path, stays: false }
    }

    /// Sets whether the file stays when this is dropped.
    pub fn set_stays(&mut self, stays: bool) {
        self.stays = stays;
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.stays {
            // If this fails, the next run removes the file.
            let _ = self.files.remove(&self.path);
        }
    }
}

/// Removes the temporary files that dead writers of `target` left.
pub fn remove_leftovers(files: &Files, target: &Path) -> Result<()> {
    let (folder, name) = split(target)?;
    for path in leftovers(files, folder, name, PART)? {
        if lock(files, &path).is_some() {
            let _ = files.remove(&path);
        }
    }
    Ok(())
}

/// Returns the temporary files for the target `name` in `folder`, of dead and living writers.
pub fn leftovers(files: &Files, folder: &Path, name: &OsStr, ending: &str) -> Result<Vec<PathBuf>> {
    let prefix = prefix(name);
    let mut names =
        files.list(folder, |name| is_part(name, &prefix, ending)).map_err(|e| Error::io(folder, "list", e))?;
    names.sort();
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// Opens and locks the temporary file at `path`, if its writer is dead. A file that cannot be opened belongs to another
/// user.
pub fn lock(files: &Files, path: &Path) -> Option<OpenFile> {
    let file = files.open(path, Access::Change).ok()?;
    file.try_lock().is_ok_and(|free| free).then_some(file)
}

fn is_part(name: &OsStr, prefix: &OsStr, ending: &str) -> bool {
    let random = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
    let random = random.and_then(|rest| rest.strip_suffix(ending.as_bytes()));
    random.is_some_and(|digits| digits.len() == DIGITS && digits.iter().all(u8::is_ascii_hexdigit))
}

fn prefix(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(shortened(name));
    prefix.push(MARK);
    prefix
}

/// Shortens a name that is too long to be part of another one.
fn shortened(name: &OsStr) -> OsString {
    if name.len() <= MOST_NAME {
        return name.to_os_string();
    }
    let name = name.to_string_lossy();
    let ends = name.char_indices().map(|(at, letter)| at + letter.len_utf8());
    name[..ends.take_while(|&end| end <= MOST_NAME).last().unwrap_or(0)].into()
}

/// Splits a target into folder and name.
pub fn split(target: &Path) -> Result<(&Path, &OsStr)> {
    let whole = target.as_os_str().as_encoded_bytes();
    // In `a/` and `a/.`, `a` is not the name of a file.
    let name = target.file_name().filter(|name| whole.ends_with(name.as_encoded_bytes()));
    let name = name.ok_or_else(|| Error::output(target, "names no file; add a name"))?;
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok((folder, name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::testing::{Call, Hooked};
    use std::io::ErrorKind::{AlreadyExists, PermissionDenied, Unsupported};

    #[test]
    fn only_leftovers_of_the_same_target_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let files = Files::current();
        let alive = Temporary::beside(&files, &target).unwrap();
        let kept = ["a.slices", ".b.slices.slicewalk-0123456789abcdef.part", ".a.slices.slicewalk-mine.part"];
        let stale = ".a.slices.slicewalk-0123456789abcdef.part";
        for name in kept.iter().chain([&stale]) {
            std::fs::write(folder.path().join(name), "old").unwrap();
        }
        remove_leftovers(&files, &target).unwrap();
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
            let mut part = Temporary::beside(&Files::current(), &target).unwrap();
            let visible = part.visible_name(&target);
            part.rename(&visible, false).unwrap();
            assert!(visible.exists() && visible.to_string_lossy().contains(MARK));
        }
    }

    #[test]
    fn names_in_use_are_passed_over_and_disks_without_locks_need_none() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        // The first `count` calls of this sort fail.
        let beside = |sort: Call, kind: io::ErrorKind, count: usize| {
            let mut left = count;
            let hook = move |call| {
                let fails = call == sort && left > 0;
                left -= usize::from(fails);
                if fails { Err(kind.into()) } else { Ok(()) }
            };
            crate::disk::with(Hooked::real(hook), || Temporary::beside(&Files::current(), &target))
        };
        beside(Call::Create, AlreadyExists, ATTEMPTS - 1).unwrap();
        beside(Call::Lock, Unsupported, 1).unwrap();
        for (sort, kind, count, words) in [
            (Call::Create, AlreadyExists, ATTEMPTS, "cannot create a temporary file beside it"),
            (Call::Create, PermissionDenied, 1, "cannot create the temporary file"),
            (Call::Lock, PermissionDenied, 1, "cannot lock"),
        ] {
            let said = beside(sort, kind, count).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
        let said = beside(Call::Length, PermissionDenied, 1).unwrap().len().unwrap_err().to_string();
        assert!(said.contains("cannot ask for the length"), "{said}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
