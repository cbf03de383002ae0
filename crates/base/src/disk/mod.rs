//! Access to the disk: the only place where the library changes files and names, for outputs, spilled data, plans,
//! merges, recoveries and exports.
//!
//! [`Disk`] and [`DiskFile`] are the raw calls of an operating system: a signal may interrupt them, and a write may
//! take fewer bytes than it was given. [`Files`] and [`OpenFile`] are for the rest of the library: they repeat
//! interrupted calls and finish short ones. Cost: one virtual call per call of the operating system.
//!
//! [`Files::current`] is the real disk. Tests ([`testing`]) and browsers run work on another disk by [`with`]; work that
//! begins in that call keeps its disk, on all of its threads.

mod real;
mod temporary;
#[cfg(any(test, feature = "testing"))]
#[doc(hidden)]
pub mod testing;

pub use temporary::{Temporary, remove_leftovers, split};
#[cfg(feature = "spill")]
pub use temporary::{leftovers, lock};

use crate::bytes::FileId;
use std::cell::RefCell;
use std::ffi::{OsStr, OsString};
use std::fmt::Debug;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Attributes of the file at a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct About {
    /// Kind of file.
    pub kind: FileKind,
    /// Length (bytes).
    pub len: u64,
    /// Permissions and number of the owner, if the system has those of Unix.
    pub mode: Option<u32>,
    /// Number of the owner, where the system has one.
    pub owner: Option<u32>,
    /// True if the file may not be written.
    pub read_only: bool,
}

/// Kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A regular file.
    File,
    /// A folder.
    Folder,
    /// A pipe, a terminal, a socket, or a device other than a disk.
    Stream,
    /// Anything else.
    Other,
}

/// Name of standard output on systems where descriptors have names.
pub const STANDARD_OUTPUT: &str = "/dev/fd/1";

/// Purpose for which a file is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// For reading.
    Read,
    /// For reading, writing and locking.
    Change,
    /// For writing at the end of a pipe or device.
    Append,
}

/// Raw calls on names; see the module documentation.
pub trait Disk: Debug + Send + Sync {
    /// Creates a new file for reading and writing, with permissions `mode` less the umask. Fails if the file exists.
    fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<Box<dyn DiskFile>>;
    /// Creates a file without a name, which vanishes with the process.
    #[cfg(feature = "spill")]
    fn create_unnamed(&self, folder: &Path) -> io::Result<Box<dyn DiskFile>>;
    /// Opens the file at `path`.
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>>;
    /// Returns the attributes of the file at `path`, following links.
    fn about(&self, path: &Path) -> io::Result<About>;
    /// Returns the identity of the file at `path`, following links.
    fn id(&self, path: &Path) -> Option<FileId>;
    /// Returns where a symbolic link points.
    fn read_link(&self, path: &Path) -> io::Result<PathBuf>;
    /// Renames a file, replacing any file that has the new name.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Renames a file to an unused name; [`ErrorKind::Unsupported`] if no single call can do that.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Adds a second name to a file.
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes the file at `path`.
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Lists the names of the regular files in `folder` that `wanted` accepts.
    fn list(&self, folder: &Path, wanted: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>>;
    /// Opens a folder, so that changed names in it can be made durable.
    fn open_folder(&self, path: &Path) -> io::Result<Box<dyn DiskFolder>>;
    /// Returns the free space for files in `folder` (bytes).
    #[cfg(feature = "spill")]
    fn free_bytes(&self, folder: &Path) -> io::Result<u64>;
}

/// Raw calls on an open file. Dropping it releases its lock.
pub trait DiskFile: Debug + Send + Sync {
    /// Reads at an offset; may read less than was asked for.
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize>;
    /// Writes at an offset; may write less than was given.
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize>;
    /// Writes at the end of a pipe or device.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;
    /// Returns the length (bytes).
    fn len(&self) -> io::Result<u64>;
    /// Makes the content durable.
    fn sync(&self) -> io::Result<()>;
    /// Locks the file for its writer; `false` if another process holds the lock. [`ErrorKind::Unsupported`] if the file
    /// system has no locks.
    fn try_lock(&self) -> io::Result<bool>;
}

/// Open folder.
pub trait DiskFolder: Debug + Send + Sync {
    /// Makes changed names durable.
    fn sync(&self) -> io::Result<()>;
}

/// Returns the system's folder for temporary files; in a browser, a name that only the disk of [`with`] knows.
pub fn temp_dir() -> PathBuf {
    if cfg!(target_arch = "wasm32") { PathBuf::from("/") } else { std::env::temp_dir() }
}

/// Returns the number of this process, where processes have numbers.
fn process_id() -> u32 {
    if cfg!(target_arch = "wasm32") { 0 } else { std::process::id() }
}

thread_local! {
    static CURRENT: RefCell<Option<Files>> = const { RefCell::new(None) };
}

/// Runs `act` on a disk other than the real one.
pub fn with<T>(disk: Arc<dyn Disk>, act: impl FnOnce() -> T) -> T {
    struct Back(Option<Files>);
    impl Drop for Back {
        fn drop(&mut self) {
            CURRENT.set(self.0.take());
        }
    }
    let _back = Back(CURRENT.replace(Some(Files(disk))));
    act()
}

/// Repeats `act` while signals interrupt it.
fn repeat<T>(mut act: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        match act() {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

/// Disk, as the rest of the library uses it.
#[derive(Debug, Clone)]
pub struct Files(Arc<dyn Disk>);

impl Files {
    /// Returns the disk for work that begins now.
    pub fn current() -> Self {
        CURRENT.with_borrow(|current| current.clone()).unwrap_or_else(|| Self(Arc::new(real::RealDisk)))
    }

    /// Creates a new file for reading and writing, with permissions `mode` less the umask. Fails if the file exists.
    pub fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<OpenFile> {
        repeat(|| self.0.create(path, mode)).map(OpenFile)
    }

    /// Creates a file without a name in `folder`.
    #[cfg(feature = "spill")]
    pub fn create_unnamed(&self, folder: &Path) -> io::Result<OpenFile> {
        repeat(|| self.0.create_unnamed(folder)).map(OpenFile)
    }

    /// Opens the file at `path`.
    pub fn open(&self, path: &Path, access: Access) -> io::Result<OpenFile> {
        repeat(|| self.0.open(path, access)).map(OpenFile)
    }

    /// Returns the attributes of the file at `path`, following links; `None` if there is no file.
    pub fn about(&self, path: &Path) -> io::Result<Option<About>> {
        match repeat(|| self.0.about(path)) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            found => found.map(Some),
        }
    }

    /// Returns the identity of the file at `path`, following links.
    pub fn id(&self, path: &Path) -> Option<FileId> {
        self.0.id(path)
    }

    /// Returns the target of the link at `path`.
    pub fn read_link(&self, path: &Path) -> io::Result<PathBuf> {
        repeat(|| self.0.read_link(path))
    }

    /// Renames a file, replacing any file that has the new name.
    pub fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        repeat(|| self.0.rename(from, to))
    }

    /// Renames a file to an unused name; fails with [`ErrorKind::AlreadyExists`] if the name is in use.
    ///
    /// Uses one call where the system has one (Linux, macOS), else a hard link. Where there are no links (FAT), an
    /// empty file claims the name and the file then replaces it; a kill in between leaves the empty file.
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
        // If the old name stays, the next run removes it as a leftover; the file has its new name.
        let _ = self.remove(from);
        Ok(())
    }

    fn rename_by_claim(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.create(to, None)?;
        self.rename(from, to).inspect_err(|_| {
            let _ = self.remove(to);
        })
    }

    /// Removes the file at `path`.
    pub fn remove(&self, path: &Path) -> io::Result<()> {
        repeat(|| self.0.remove(path))
    }

    /// Lists the names of the regular files in `folder` that `wanted` accepts.
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

    /// Returns the free space for files in `folder` (bytes).
    #[cfg(feature = "spill")]
    pub fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        repeat(|| self.0.free_bytes(folder))
    }
}

/// Open file, as the rest of the library uses it.
#[derive(Debug)]
pub struct OpenFile(Box<dyn DiskFile>);

impl OpenFile {
    /// Fills `buf` with the bytes at `offset`; fails if there are fewer.
    pub fn read_exact_at(&self, offset: u64, buf: &mut [u8]) -> io::Result<()> {
        match self.read_up_to(offset, buf)? == buf.len() {
            true => Ok(()),
            false => Err(ErrorKind::UnexpectedEof.into()),
        }
    }

    /// Fills `buf` with the bytes at `offset`; returns their number, which is less than the length of `buf` only at the
    /// end of the file.
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

    /// Writes all of `bytes` at `offset`.
    pub fn write_at(&self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        write_all(bytes, |done| self.0.write_at(&bytes[done..], offset + done as u64))
    }

    /// Writes all of `bytes` to a pipe or device.
    pub fn append(&self, bytes: &[u8]) -> io::Result<()> {
        write_all(bytes, |done| self.0.append(&bytes[done..]))
    }

    /// Returns the length (bytes).
    pub fn len(&self) -> io::Result<u64> {
        repeat(|| self.0.len())
    }

    /// Makes the content durable. A failed sync is final: the file is abandoned, never synced again.
    pub fn sync(&self) -> io::Result<()> {
        repeat(|| self.0.sync())
    }

    /// Locks the file for its writer; `false` if another process holds the lock. The lock ends with the file, and so
    /// with the process.
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

/// Open folder, as the rest of the library uses it.
#[derive(Debug)]
pub struct OpenFolder(Box<dyn DiskFolder>);

impl OpenFolder {
    /// Makes changed names durable.
    pub fn sync(&self) -> io::Result<()> {
        match repeat(|| self.0.sync()) {
            // Some file systems cannot sync folders and keep names safe without it.
            Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
            synced => synced,
        }
    }
}
