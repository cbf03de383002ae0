//! Output files of programs: archives, plans, pictures, tables, exports. All are published in the same way.
//!
//! - *Complete or absent.* The bytes go to a locked temporary file next to the target. [`Output::publish`] syncs that
//!   file, renames it to the target and syncs the folder, which was opened before. A failure up to the rename leaves
//!   the old file unchanged and no temporary file; a killed run leaves one, which the next output of that name removes.
//! - *[`OutputKind`] decides what may be replaced.* The check runs when the output is created, before any work, and
//!   again directly before the rename. An output that may replace nothing is renamed by a call that fails if a file has
//!   appeared under the name. If an archive or plan cannot be renamed to its target, it is kept under another name,
//!   which the error states.
//! - *[`Protected`] files are never replaced*, under any name: they are compared by device and inode (volume and index
//!   on Windows), so hard links and symbolic links are recognised.
//! - *Symbolic links stay.* The file that a link points to is replaced or created.
//! - *Pipes, terminals and devices* take pictures, tables and exports: the complete bytes are written to them at the
//!   end. They are never replaced or removed. Archives and plans must be regular files, and no output goes to a block
//!   device. `-` is standard output.
//! - *Permissions.* A new file gets the default permissions; one that replaces another is at most as open as that file
//!   was.
//!
//! `target.rs` decides whether the existing file may be replaced.

mod target;

pub use target::PLAN_KEY;
pub use target::{ARCHIVE_MAGIC, DRAFT_MAGIC};
pub use target::{Existing, OutputKind, Protected, is_standard};

use crate::bytes::{ByteSource, FileSource, local};
use crate::disk::{Access, Files, OpenFile, Temporary, remove_leftovers};
use crate::{Error, Monitor, Parameter, Result};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use target::{Judged, Target};

/// Bytes compared or copied at once.
const CHUNK: usize = 1 << 20;
/// Attempts to rename an output that may replace files.
const LOOKS: usize = 3;

/// File under construction; [`publish`](Self::publish) gives it its name. Dropped without that, it leaves nothing.
///
/// Bytes are written at an offset, or sequentially through [`Write`] and [`Seek`] (unbuffered: wrap it in a
/// [`BufWriter`](std::io::BufWriter)). After a failed write it cannot be published.
#[derive(Debug)]
pub struct Output {
    /// Target as the user named it.
    name: PathBuf,
    kind: OutputKind,
    protected: Protected,
    files: Files,
    target: Target,
    temporary: Temporary,
    /// Position of the next [`Write`].
    position: u64,
    failed: bool,
}

/// Fails if [`Output::create`] would refuse this name; creates nothing.
pub fn check(name: &Path, kind: OutputKind, protected: Protected) -> Result<()> {
    Target::find(&Files::current(), name, kind, &protected).map(drop)
}

impl Output {
    /// Creates an output for the target `name`. Refuses a target that must not be replaced, before any work, and
    /// removes temporary files that dead writers of the same name left. Opening a pipe waits for its reader.
    pub fn create(name: &Path, kind: OutputKind, protected: Protected) -> Result<Self> {
        Self::create_by(name, kind, protected, &crate::disk::temp_dir())
    }

    /// Like [`create`](Self::create), but an output that cannot be made next to its target, such as an object, is made
    /// in the folder `temp_dir`.
    pub fn create_by(name: &Path, kind: OutputKind, protected: Protected, temp_dir: &Path) -> Result<Self> {
        let files = Files::current();
        let target = Target::find(&files, name, kind, &protected)?;
        let beside = match &target {
            Target::File { path, .. } => path.clone(),
            Target::Stream(_) | Target::Object { .. } => temp_dir.join("output"),
        };
        remove_leftovers(&files, &beside)?;
        let temporary = Temporary::beside(&files, &beside)?;
        let name = name.to_path_buf();
        Ok(Self { name, kind, protected, files, target, temporary, position: 0, failed: false })
    }

    /// Creates a file next to `target` that is never published: it is written and read back, and vanishes when this is
    /// dropped.
    pub fn scratch(files: &Files, target: &Path) -> Result<Self> {
        remove_leftovers(files, target)?;
        let temporary = Temporary::beside(files, target)?;
        let folder = crate::disk::split(target)?.0;
        let folder = files.open_folder(folder).map_err(|error| Error::io(folder, "open", error))?;
        Ok(Self {
            name: target.to_path_buf(),
            kind: OutputKind::Result,
            protected: Protected::default(),
            files: files.clone(),
            target: Target::File { path: target.to_path_buf(), folder, existed: false },
            temporary,
            position: 0,
            failed: false,
        })
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

    /// Returns the target as the user named it.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// Returns the disk that the output is written to.
    pub fn files(&self) -> &Files {
        &self.files
    }

    /// Returns the number of the user who owns the output, if the system has such numbers.
    pub fn owner(&self) -> Option<u32> {
        self.files.about(self.temporary.path()).ok().flatten().and_then(|about| about.owner)
    }

    /// Returns the path next to which other temporary files of the same work may lie.
    pub fn beside(&self) -> &Path {
        match &self.target {
            Target::File { path, .. } => path,
            Target::Stream(_) => &self.name,
            Target::Object { .. } => self.temporary.path(),
        }
    }

    /// Makes the file durable and renames it to its target. Returns false if the target already holds the same bytes
    /// ([`Existing::KeepSame`]), so that nothing was done.
    ///
    /// Before the rename, any error leaves the old file unchanged. If the rename itself fails, an archive or a plan is
    /// kept under another name, which the error states. After the rename only the sync of the folder can fail: then the
    /// new file is complete under its name, and the error is [`Error::NotDurable`].
    pub fn publish(mut self) -> Result<bool> {
        if self.failed {
            return Err(Error::output(&self.name, "not all of it could be written, so it was not published"));
        }
        let (path, existed) = match &self.target {
            Target::Object { existed } => {
                let (len, read) = (self.temporary.len()?, |at, bytes: &mut [u8]| self.temporary.read_at(at, bytes));
                return publish_object(&self.name, self.kind, *existed, len, &read);
            }
            Target::Stream(stream) => {
                return match copy(&self.temporary, stream) {
                    // A reader that closes a pipe early has read enough.
                    Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io(&self.name, "write", error)),
                    _ => Ok(true),
                };
            }
            Target::File { path, existed, .. } => (path.clone(), *existed),
        };
        if self.kind.existing() == Existing::KeepSame {
            if is_there(&self.files, &self.temporary, &path)? {
                return Ok(false);
            }
            if existed {
                let error = Error::output(&self.name, "exists already and holds something else");
                return Err(error.with_suggestion(Parameter::Overwrite));
            }
        }
        self.temporary.sync()?;
        if let Err(error) = self.rename(&path) {
            return Err(self.keep(&path, error));
        }
        match self.target {
            Target::File { folder, .. } => {
                folder.sync().map(|()| true).map_err(|source| Error::NotDurable { path: self.name, source })
            }
            Target::Stream(_) | Target::Object { .. } => Ok(true),
        }
    }

    /// Renames the complete file to `path`, if the file there now may be replaced.
    fn rename(&mut self, path: &Path) -> Result<()> {
        let may_replace = self.kind.existing() == Existing::Replace;
        // A file that appears between the check and the rename is checked too.
        for _ in 0..if may_replace { LOOKS } else { 1 } {
            let judged = || target::judge(&self.files, &self.name, path, self.kind, &self.protected);
            let is_there = may_replace && judged()? == Judged::Replaceable;
            match self.temporary.rename(path, is_there) {
                Ok(()) => return Ok(()),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(Error::io(&self.name, "rename the temporary file to it", error)),
            }
        }
        Err(Error::output(&self.name, "another file got this name while the new one was written, and stays"))
    }

    /// Keeps an archive or a plan, which may have taken hours, under another name after the rename failed.
    fn keep(&mut self, path: &Path, error: Error) -> Error {
        let visible = self.temporary.visible_name(path);
        if self.kind == OutputKind::Result || self.temporary.rename(&visible, false).is_err() {
            return error;
        }
        let why = match error {
            Error::Output { reason, .. } => reason,
            Error::Io { action, source, .. } => format!("cannot {action}: {source}"),
            other => other.to_string(),
        };
        let kept = format!("the new one is complete as {}; rename it or remove it", visible.display());
        Error::output(&self.name, format!("{why}; {kept}"))
    }
}

/// Uploads the archive in the file `from` to `address`, whole or not at all. Returns false if `existing` is
/// [`Existing::KeepSame`] and the object already has these bytes, so that nothing was done.
///
/// Works like an [`Output`] to that address, but without a copy on disk: `from` must not change meanwhile, and stays.
pub fn upload_archive(from: &Path, address: &Path, existing: Existing, monitor: &dyn Monitor) -> Result<bool> {
    let source = FileSource::open(from)?;
    let mut start = vec![0; ARCHIVE_MAGIC.len().min(source.len() as usize)];
    source.read_at(0, &mut start)?;
    if start != ARCHIVE_MAGIC {
        return Err(Error::output(from, "is not a slice archive, so it is not uploaded"));
    }
    if crate::bytes::address(address).is_none() || local(address).is_some() {
        return Err(Error::output(address, "is not an address in an object store"));
    }
    let kind = OutputKind::Archive(existing);
    let existed = target::judge_object(address, kind)? == Judged::Replaceable;
    monitor.stage("upload", source.len(), "bytes");
    publish_object(address, kind, existed, source.len(), &|at, bytes| {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        source.read_at(at, bytes)?;
        monitor.advance(bytes.len() as u64);
        Ok(())
    })
}

/// Reader of bytes of a complete file.
type BytesAt<'a> = &'a dyn Fn(u64, &mut [u8]) -> Result<()>;

/// Writes `len` bytes from `read` to the address `name`, if the object there now may be replaced.
#[cfg(feature = "remote")]
fn publish_object(name: &Path, kind: OutputKind, existed: bool, len: u64, read: BytesAt<'_>) -> Result<bool> {
    if kind.existing() == Existing::KeepSame && existed {
        if is_at(name, len, read)? {
            return Ok(false);
        }
        let error = Error::output(name, "exists already and holds something else");
        return Err(error.with_suggestion(Parameter::Overwrite));
    }
    let judged = target::judge_object(name, kind)?;
    let create = kind.existing() != Existing::Replace || judged == Judged::Free;
    match crate::bytes::upload(name, len, create, &mut |at, bytes| read(at, bytes)) {
        Err(Error::Interrupted) => Err(Error::Interrupted),
        // The upload succeeded, but the answer was lost, and the retry found the object there.
        Err(_) if is_at(name, len, read).unwrap_or(false) => Ok(true),
        done => done.map(|()| true),
    }
}

#[cfg(not(feature = "remote"))]
fn publish_object(name: &Path, _: OutputKind, _: bool, _: u64, _: BytesAt<'_>) -> Result<bool> {
    Err(crate::bytes::without_feature(name))
}

/// Returns whether the object `name` holds exactly the `len` bytes from `read`.
#[cfg(feature = "remote")]
fn is_at(name: &Path, len: u64, read: BytesAt<'_>) -> Result<bool> {
    let there = crate::bytes::open_named(name)?;
    if there.len() != len {
        return Ok(false);
    }
    same_bytes(len, &|at, bytes| there.read_at(at, bytes), read)
}

/// Returns whether two files of `len` bytes have the same content.
fn same_bytes(len: u64, one: BytesAt<'_>, other: BytesAt<'_>) -> Result<bool> {
    let (mut one_bytes, mut other_bytes) = (vec![0; CHUNK], vec![0; CHUNK]);
    for at in (0..len).step_by(CHUNK) {
        let count = (len - at).min(CHUNK as u64) as usize;
        one(at, &mut one_bytes[..count])?;
        other(at, &mut other_bytes[..count])?;
        if one_bytes[..count] != other_bytes[..count] {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Returns whether the file at `path` has the content of `new`.
fn is_there(files: &Files, new: &Temporary, path: &Path) -> Result<bool> {
    let failed = |error| Error::io(path, "compare with the new file", error);
    let Some(about) = files.about(path).map_err(failed)? else { return Ok(false) };
    let len = new.len()?;
    if about.len != len {
        return Ok(false);
    }
    let there = files.open(path, Access::Read).map_err(failed)?;
    let read = |at, bytes: &mut [u8]| there.read_exact_at(at, bytes).map_err(failed);
    same_bytes(len, &read, &|at, bytes| new.read_at(at, bytes))
}

/// Writes all of `new` to a pipe or device.
fn copy(new: &Temporary, stream: &OpenFile) -> io::Result<()> {
    let len = new.len().map_err(io::Error::other)?;
    let mut bytes = vec![0; CHUNK];
    for at in (0..len).step_by(CHUNK) {
        let count = (len - at).min(CHUNK as u64) as usize;
        new.read_at(at, &mut bytes[..count]).map_err(io::Error::other)?;
        stream.append(&bytes[..count])?;
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

/// Reads back what was written, from the position of the next [`Write`].
impl Read for Output {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let left = self.temporary.len().map_err(io::Error::other)?.saturating_sub(self.position);
        let count = bytes.len().min(usize::try_from(left).unwrap_or(usize::MAX));
        self.read_at(self.position, &mut bytes[..count]).map_err(io::Error::other)?;
        self.position += count as u64;
        Ok(count)
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
