//! The one seam through which the library changes files and names: outputs, spilled data, plans, merges, recoveries, exports.
//!
//! [`Disk`] and [`DiskFile`] are the raw calls of an operating system: a signal may interrupt them, and a write may take
//! fewer bytes than it was given. [`Files`] and [`OpenFile`] are what the code above uses: they repeat interrupted calls
//! and finish short ones. Cost: one virtual call per call of the operating system.
//!
//! [`Files::current`] is the real disk. A test runs work on another one ([`tests`]) by [`with`]; whatever begins in that
//! call keeps its disk, on all of its threads.

mod real;
mod temporary;
#[cfg(test)]
pub(crate) mod tests;

pub(crate) use temporary::{Temporary, remove_leftovers, split};
#[cfg(feature = "convert")]
pub(crate) use temporary::{leftovers, lock};

use crate::bytes::FileId;
use std::cell::RefCell;
use std::ffi::{OsStr, OsString};
use std::fmt::Debug;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What is at a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct About {
    pub kind: FileKind,
    /// Length (bytes).
    pub len: u64,
    /// Permissions, and the number of the owner, where the system has those of Unix.
    pub mode: Option<u32>,
    pub owner: Option<u32>,
    pub read_only: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    File,
    Folder,
    /// A pipe, a terminal, a socket, or a device that is no disk.
    Stream,
    Other,
}

/// Name of standard output where descriptors have names.
pub(crate) const STANDARD_OUTPUT: &str = "/dev/fd/1";

/// What a file is opened for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Access {
    Read,
    /// To be read, written and locked.
    Change,
    /// To be written at its end: a pipe or a device.
    Append,
}

/// Raw calls on names; see the module text.
pub(crate) trait Disk: Debug + Send + Sync {
    /// Creates a file that did not exist, to be read and written, with permissions `mode` less the umask.
    fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<Box<dyn DiskFile>>;
    /// Creates a file without a name, which vanishes with the process.
    #[cfg(feature = "convert")]
    fn create_unnamed(&self, folder: &Path) -> io::Result<Box<dyn DiskFile>>;
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>>;
    /// What is at `path`, links followed.
    fn about(&self, path: &Path) -> io::Result<About>;
    /// Which file is at `path`, links followed.
    fn id(&self, path: &Path) -> Option<FileId>;
    /// Where a symbolic link leads.
    fn read_link(&self, path: &Path) -> io::Result<PathBuf>;
    /// Gives a file another name, whatever has that name already.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Gives a file a name that nothing has; [`ErrorKind::Unsupported`] where one call cannot do that.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Gives a file a second name.
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Names of the regular files in `folder` that `wanted` accepts.
    fn list(&self, folder: &Path, wanted: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>>;
    /// Opens a folder, so that changed names in it can be made durable.
    fn open_folder(&self, path: &Path) -> io::Result<Box<dyn DiskFolder>>;
    /// Free space for files in `folder` (bytes).
    #[cfg(feature = "convert")]
    fn free_bytes(&self, folder: &Path) -> io::Result<u64>;
}

/// Raw calls on an open file. Dropping it releases its lock.
pub(crate) trait DiskFile: Debug + Send + Sync {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize>;
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize>;
    /// Writes at the end of a pipe or device.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;
    /// Length (bytes).
    fn len(&self) -> io::Result<u64>;
    /// Makes the content durable.
    fn sync(&self) -> io::Result<()>;
    /// Locks the file for its writer; `false` if somebody else holds the lock. [`ErrorKind::Unsupported`] where the file
    /// system knows no locks.
    fn try_lock(&self) -> io::Result<bool>;
}

/// An open folder.
pub(crate) trait DiskFolder: Debug + Send + Sync {
    /// Makes changed names durable.
    fn sync(&self) -> io::Result<()>;
}

thread_local! {
    static CURRENT: RefCell<Option<Files>> = const { RefCell::new(None) };
}

/// Runs `act` on another disk than the real one.
#[cfg(test)]
pub(crate) fn with<T>(disk: Arc<dyn Disk>, act: impl FnOnce() -> T) -> T {
    struct Back(Option<Files>);
    impl Drop for Back {
        fn drop(&mut self) {
            CURRENT.set(self.0.take());
        }
    }
    let _back = Back(CURRENT.replace(Some(Files(disk))));
    act()
}

/// Repeats `act` for as long as signals interrupt it.
fn repeat<T>(mut act: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        match act() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

/// A disk, as the code above uses it.
#[derive(Debug, Clone)]
pub(crate) struct Files(Arc<dyn Disk>);

impl Files {
    /// The disk that work which begins now is done on.
    pub fn current() -> Self {
        CURRENT.with_borrow(|current| current.clone()).unwrap_or_else(|| Self(Arc::new(real::RealDisk)))
    }

    /// Creates a file that did not exist, to be read and written, with permissions `mode` less the umask.
    pub fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<OpenFile> {
        repeat(|| self.0.create(path, mode)).map(OpenFile)
    }

    /// Creates a file without a name in `folder`.
    #[cfg(feature = "convert")]
    pub fn create_unnamed(&self, folder: &Path) -> io::Result<OpenFile> {
        repeat(|| self.0.create_unnamed(folder)).map(OpenFile)
    }

    pub fn open(&self, path: &Path, access: Access) -> io::Result<OpenFile> {
        repeat(|| self.0.open(path, access)).map(OpenFile)
    }

    /// What is at `path`, links followed; `None` if nothing is.
    pub fn about(&self, path: &Path) -> io::Result<Option<About>> {
        match repeat(|| self.0.about(path)) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            found => found.map(Some),
        }
    }

    pub fn id(&self, path: &Path) -> Option<FileId> {
        self.0.id(path)
    }

    pub fn read_link(&self, path: &Path) -> io::Result<PathBuf> {
        repeat(|| self.0.read_link(path))
    }

    /// Gives a file another name, whatever has that name already.
    pub fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        repeat(|| self.0.rename(from, to))
    }

    /// Gives a file a name that nothing has; fails with [`ErrorKind::AlreadyExists`] if something has it.
    ///
    /// By one call where the system can (Linux, macOS), else by a hard link, else (no links, as on FAT) by an empty file
    /// that takes the name and that the file then replaces: killed in between, the empty file stays.
    pub fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        match repeat(|| self.0.rename_new(from, to)) {
            Err(error) if error.kind() == ErrorKind::Unsupported => match self.rename_by_link(from, to) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
                Err(_) => self.rename_by_claim(from, to),
                Ok(()) => Ok(()),
            },
            done => done,
        }
    }

    fn rename_by_link(&self, from: &Path, to: &Path) -> io::Result<()> {
        repeat(|| self.0.link(from, to))?;
        // If the old name stays, the next run removes it as a leftover; the file has the new one.
        let _ = self.remove(from);
        Ok(())
    }

    fn rename_by_claim(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.create(to, None)?;
        self.rename(from, to).inspect_err(|_| {
            let _ = self.remove(to);
        })
    }

    pub fn remove(&self, path: &Path) -> io::Result<()> {
        repeat(|| self.0.remove(path))
    }

    /// Names of the regular files in `folder` that `wanted` accepts.
    pub fn list(&self, folder: &Path, wanted: impl Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
        repeat(|| self.0.list(folder, &wanted))
    }

    /// Opens a folder before a name in it changes, so that the change can be made durable.
    pub fn open_folder(&self, path: &Path) -> io::Result<OpenFolder> {
        match repeat(|| self.0.about(path))?.kind {
            FileKind::Folder => repeat(|| self.0.open_folder(path)).map(OpenFolder),
            _ => Err(ErrorKind::NotADirectory.into()),
        }
    }

    /// Free space for files in `folder` (bytes).
    #[cfg(feature = "convert")]
    pub fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        repeat(|| self.0.free_bytes(folder))
    }
}

/// An open file, as the code above uses it.
#[derive(Debug)]
pub(crate) struct OpenFile(Box<dyn DiskFile>);

impl OpenFile {
    /// Fills `buf` with the bytes from `offset` on; fewer are an error.
    pub fn read_exact_at(&self, offset: u64, buf: &mut [u8]) -> io::Result<()> {
        match self.read_up_to(offset, buf)? == buf.len() {
            true => Ok(()),
            false => Err(ErrorKind::UnexpectedEof.into()),
        }
    }

    /// Fills `buf` with the bytes from `offset` on; returns fewer than it holds only where the file ends.
    pub fn read_up_to(&self, offset: u64, buf: &mut [u8]) -> io::Result<usize> {
        let mut done = 0;
        while done < buf.len() {
            match repeat(|| self.0.read_at(&mut buf[done..], offset + done as u64))? {
                0 => break,
                read => done += read,
            }
        }
        Ok(done)
    }

    /// Writes all of `bytes` from `offset` on.
    pub fn write_at(&self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        write_all(bytes, |done| self.0.write_at(&bytes[done..], offset + done as u64))
    }

    /// Writes all of `bytes` to a pipe or device.
    pub fn append(&self, bytes: &[u8]) -> io::Result<()> {
        write_all(bytes, |done| self.0.append(&bytes[done..]))
    }

    /// Length (bytes).
    pub fn len(&self) -> io::Result<u64> {
        repeat(|| self.0.len())
    }

    /// Makes the content durable. A sync that failed is final: the file is given up, never synced again.
    pub fn sync(&self) -> io::Result<()> {
        repeat(|| self.0.sync())
    }

    /// Locks the file for its writer; `false` if somebody else holds the lock. It ends with the file, and so with the
    /// process.
    pub fn try_lock(&self) -> io::Result<bool> {
        repeat(|| self.0.try_lock())
    }
}

fn write_all(bytes: &[u8], mut write: impl FnMut(usize) -> io::Result<usize>) -> io::Result<()> {
    let mut done = 0;
    while done < bytes.len() {
        match repeat(|| write(done))? {
            0 => return Err(ErrorKind::WriteZero.into()),
            written => done += written,
        }
    }
    Ok(())
}

/// An open folder, as the code above uses it.
#[derive(Debug)]
pub(crate) struct OpenFolder(Box<dyn DiskFolder>);

impl OpenFolder {
    /// Makes changed names durable.
    pub fn sync(&self) -> io::Result<()> {
        match repeat(|| self.0.sync()) {
            // Some file systems cannot sync folders and keep names safe by themselves.
            Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
            synced => synced,
        }
    }
}
