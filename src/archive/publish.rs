//! All or nothing: a locked temporary file beside the target, renamed over it when it is complete and on disk.
//!
//! The name is `.<target>.slicewalk-<16 hex digits>.part`. The file stays locked while its writer lives; leftovers of
//! writers that died are not, which is how the next run knows that it may remove them.

use crate::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::fs::{File, OpenOptions, TryLockError};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MARK: &str = ".slicewalk-";
const SUFFIX: &str = ".part";
const DIGITS: usize = 16;
/// How often another random name is tried.
const ATTEMPTS: usize = 100;

/// A temporary file beside `target`; removed when dropped, unless published.
#[derive(Debug)]
pub(super) struct PartFile {
    file: File,
    path: PathBuf,
    published: bool,
}

impl PartFile {
    /// Creates and locks a temporary file beside `target`.
    pub fn create(target: &Path) -> Result<Self> {
        let (folder, name) = split(target)?;
        let random = RandomState::new();
        for attempt in 0..ATTEMPTS {
            let mut part = prefix(name);
            part.push(format!("{:0DIGITS$x}{SUFFIX}", random.hash_one((attempt, std::process::id()))));
            let path = folder.join(part);
            let opened = OpenOptions::new().read(true).write(true).create_new(true).open(&path);
            let file = match opened {
                Ok(file) => file,
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(Error::io(path, "create the temporary file", error)),
            };
            let part = Self { file, path, published: false };
            match part.file.try_lock() {
                // Another run may take the file for a leftover before it is locked; then it is gone.
                Ok(()) if part.path.exists() => return Ok(part),
                Ok(()) | Err(TryLockError::WouldBlock) => {}
                // Some file systems know no locks: leftovers stay there until removed by hand.
                Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => return Ok(part),
                Err(TryLockError::Error(error)) => return Err(Error::io(&part.path, "lock", error)),
            }
        }
        Err(Error::io(target, "create a temporary file beside it", io::ErrorKind::AlreadyExists.into()))
    }

    /// Writes `bytes` at `offset`.
    pub fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        let written = self.file.seek(SeekFrom::Start(offset)).and_then(|_| self.file.write_all(bytes));
        written.map_err(|error| Error::io(&self.path, format!("write {} bytes at {offset}", bytes.len()), error))
    }

    /// Reads back what was written.
    pub fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let read = crate::bytes::read_exact_at(&self.file, offset, buf);
        read.map_err(|error| Error::io(&self.path, format!("read {} bytes at {offset}", buf.len()), error))
    }

    /// An error about the content of this file.
    pub fn broken(&self, action: &str) -> Error {
        Error::io(&self.path, action, io::ErrorKind::InvalidData.into())
    }

    /// Makes the file durable and gives it its name, replacing what is there.
    pub fn publish(mut self, target: &Path) -> Result<()> {
        self.file.sync_all().map_err(|error| Error::io(&self.path, "bring to disk", error))?;
        std::fs::rename(&self.path, target).map_err(|error| Error::io(target, "give the archive its name", error))?;
        self.published = true;
        let (folder, _) = split(target)?;
        sync_folder(folder).map_err(|error| Error::io(folder, "bring the new name to disk", error))
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.published {
            // Nothing sensible is left to do if this fails: the next run removes the file.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Removes the temporary files that dead writers of `target` left.
pub(super) fn remove_leftovers(target: &Path) -> Result<()> {
    let (folder, name) = split(target)?;
    let listed = std::fs::read_dir(folder).map_err(|error| Error::io(folder, "list", error))?;
    let prefix = prefix(name);
    for entry in listed.flatten().filter(|entry| is_part(&entry.file_name(), &prefix)) {
        // Whoever holds the lock is alive; a file that cannot be opened or removed is somebody else's.
        if let Ok(file) = OpenOptions::new().write(true).open(entry.path())
            && file.try_lock().is_ok()
        {
            let _ = std::fs::remove_file(entry.path());
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
    prefix.push(name);
    prefix.push(MARK);
    prefix
}

/// Folder and name of a target.
fn split(target: &Path) -> Result<(&Path, &OsStr)> {
    let name = target.file_name();
    let name = name.ok_or_else(|| Error::parameter(target.display().to_string(), "names no file; add one"))?;
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok((folder, name))
}

#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder)?.sync_all() {
        // Some file systems cannot sync folders and keep names safe by themselves.
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        result => result,
    }
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_leftovers_of_the_same_target_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("a.slices");
        let alive = PartFile::create(&target).unwrap();
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
}
