//! Files that programs write: archives, plans, pictures, tables, exports. All are published in one way.
//!
//! - *Complete, or not there.* The bytes go to a locked temporary file beside the target. [`Output::publish`] syncs that
//!   file, renames it to the target and syncs the folder, which was opened before. Whatever fails up to the rename leaves
//!   what was there as it was, and no temporary file; a killed run leaves one, which the next output of that name removes.
//! - *[`Kind`] says what may be replaced.* It is judged when the output is created, before any work, and once more
//!   directly before the rename. An output that may replace nothing is renamed by a call that fails if something has
//!   appeared under the name; then the complete file is kept under a name of its own, which the error states.
//! - *[`Protected`] files are never replaced*, under whatever name: they are known by device and inode (volume and index
//!   on Windows), so hard links and symbolic links are seen through.
//! - *Symbolic links stay.* The file that a link names is replaced, or made.
//! - *Pipes, terminals and devices* take pictures, tables and exports: the complete bytes are written to them at the end.
//!   They are never replaced or removed. Archives and plans are regular files, and no output goes to a disk's device.
//! - *Permissions.* A new file has those of any new file; one that replaces another is at most as open as that was.
//!
//! Files: `disk.rs` holds every call that changes the file system, `temporary.rs` the file in the making, `target.rs` what
//! is there and may be replaced.

mod disk;
mod target;
mod temporary;

pub(crate) use target::ARCHIVE_MAGIC;
#[cfg(feature = "cli")]
pub(crate) use target::PLAN_KEY;
pub use target::{Existing, Kind, Protected};
pub(crate) use temporary::Temporary;

use crate::bytes::read_exact_at;
use crate::{Error, Result};
use std::fs::File;
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use target::{Judged, Place};

/// Bytes compared or copied at once.
const CHUNK: usize = 1 << 20;

/// A file in the making, which gets its name by [`publish`](Self::publish). Dropped without that, it leaves nothing.
///
/// Bytes are written by place, or in a row through [`Write`] and [`Seek`] (unbuffered: wrap it in a
/// [`BufWriter`](std::io::BufWriter)). After a write has failed it cannot be published.
#[derive(Debug)]
pub struct Output {
    /// The target as the user names it.
    name: PathBuf,
    kind: Kind,
    protected: Protected,
    place: Place,
    temporary: Temporary,
    /// Where [`Write`] goes on.
    position: u64,
    failed: bool,
}

impl Output {
    /// Begins a file that will be called `name`. What it must not replace is refused here, before any work; temporary files
    /// that dead writers of the same name left are removed. Opening a pipe waits for its reader.
    pub fn create(name: &Path, kind: Kind, protected: Protected) -> Result<Self> {
        let place = Place::find(name, kind, &protected)?;
        let beside = match &place {
            Place::File { path, .. } => path.clone(),
            Place::Stream(_) => std::env::temp_dir().join("output"),
        };
        temporary::remove_leftovers(&beside)?;
        let temporary = Temporary::beside(&beside)?;
        Ok(Self { name: name.to_path_buf(), kind, protected, place, temporary, position: 0, failed: false })
    }

    /// Writes `bytes` at `offset`.
    pub fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        let written = self.temporary.write_at(offset, bytes);
        self.failed |= written.is_err();
        written
    }

    /// Reads back what was written.
    pub fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.temporary.read_at(offset, buf)
    }

    /// Where other temporary files of the same work may lie: beside this path.
    pub(crate) fn beside(&self) -> &Path {
        match &self.place {
            Place::File { path, .. } => path,
            Place::Stream(_) => &self.name,
        }
    }

    /// Makes the file durable and renames it to its name. Returns whether it did; not if the target has the same bytes
    /// already ([`Existing::KeepSame`]).
    ///
    /// Before the rename any error leaves what was there. After it only the folder's sync can fail: then the new file
    /// stands complete under its name, and the error is [`Error::NotDurable`].
    pub fn publish(mut self) -> Result<bool> {
        if self.failed {
            return Err(Error::output(&self.name, "not all of it could be written, so it was not published"));
        }
        let (path, folder, existed) = match &mut self.place {
            Place::Stream(stream) => {
                return match copy(&self.temporary, stream) {
                    // Whoever closes a pipe early has read enough.
                    Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io(&self.name, "write", error)),
                    _ => Ok(true),
                };
            }
            Place::File { path, folder, existed } => (path.clone(), folder, *existed),
        };
        if self.kind.existing() == Existing::KeepSame {
            if is_there(&self.temporary, &path)? {
                return Ok(false);
            }
            if existed {
                return Err(Error::output(&self.name, "exists already and holds something else; --force replaces it"));
            }
        }
        self.temporary.sync()?;
        loop {
            let renamed = match self.kind.existing() {
                Existing::Refuse | Existing::KeepSame => self.temporary.rename(&path, disk::rename_new),
                Existing::Replace => match target::judge(&self.name, &path, self.kind, &self.protected)? {
                    Judged::Replaceable => self.temporary.rename(&path, disk::rename),
                    // Something that appears meanwhile is judged, too.
                    Judged::Free => match self.temporary.rename(&path, disk::rename_new) {
                        Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                        renamed => renamed,
                    },
                },
            };
            match renamed {
                Ok(()) => break,
                Err(error) if error.kind() == ErrorKind::AlreadyExists => return Err(self.keep(&path)),
                Err(error) => {
                    let action = format!("rename the temporary file to {}", self.name.display());
                    return Err(Error::io(&path, action, error));
                }
            }
        }
        let synced = folder.sync();
        synced.map(|()| true).map_err(|source| Error::NotDurable { path: self.name.clone(), source })
    }

    /// Something has the name: keeps the complete file under another one, and says so.
    fn keep(&mut self, path: &Path) -> Error {
        let visible = self.temporary.visible_name(path);
        let fate = match self.temporary.rename(&visible, disk::rename_new) {
            Ok(()) => format!("the new one is complete as {}; rename it or remove it", visible.display()),
            Err(error) => format!("the new one was removed, because it could not be renamed either: {error}"),
        };
        let reason = format!("another file got this name while the new one was written, and stays; {fate}");
        Error::output(&self.name, reason)
    }
}

/// Whether the file at `path` has the bytes of `new`.
fn is_there(new: &Temporary, path: &Path) -> Result<bool> {
    let failed = |error| Error::io(path, "compare with the new file", error);
    let Some(about) = disk::metadata(path).map_err(failed)? else { return Ok(false) };
    let len = new.len()?;
    if about.len() != len {
        return Ok(false);
    }
    let there = disk::open(path).map_err(failed)?;
    let (mut old_bytes, mut new_bytes) = (vec![0; CHUNK], vec![0; CHUNK]);
    for at in (0..len).step_by(CHUNK) {
        let count = (len - at).min(CHUNK as u64) as usize;
        read_exact_at(&there, at, &mut old_bytes[..count]).map_err(failed)?;
        new.read_at(at, &mut new_bytes[..count])?;
        if old_bytes[..count] != new_bytes[..count] {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Writes all of `new` to a pipe or device.
fn copy(new: &Temporary, stream: &File) -> io::Result<()> {
    let len = new.len().map_err(io::Error::other)?;
    let mut bytes = vec![0; CHUNK];
    for at in (0..len).step_by(CHUNK) {
        let count = (len - at).min(CHUNK as u64) as usize;
        new.read_at(at, &mut bytes[..count]).map_err(io::Error::other)?;
        disk::write_stream(stream, &bytes[..count])?;
    }
    Ok(())
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.write_at(self.position, bytes).map_err(io::Error::other)?;
        self.position += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.temporary.len().map_err(io::Error::other)?.checked_add_signed(by),
        };
        self.position = position.ok_or(ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

#[cfg(test)]
mod tests;
