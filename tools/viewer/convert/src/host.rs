//! Requests of the module to the program that runs it: bytes of inputs and of temporary files, and an ear for progress.

use crate::FOLDER;
use slicewalk_base::bytes::{ByteSource, FileId};
use slicewalk_base::disk::{About, Access, Disk, DiskFile, DiskFolder, FileKind};
use slicewalk_base::{Error, Monitor, Parameter, Result, Warning};
use std::cell::Cell;
use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

#[link(wasm_import_module = "host")]
unsafe extern "C" {
    /// Reads `len` bytes at `offset` of a file to `at`; returns the number read, or a negative [`failure`].
    safe fn read(file: u32, offset: f64, at: *mut u8, len: usize) -> i32;
    /// Writes `len` bytes from `at` at `offset` of a file; returns the number written, or a negative [`failure`].
    safe fn write(file: u32, offset: f64, at: *const u8, len: usize) -> i32;
    /// Creates an empty file and returns its number, or a negative [`failure`].
    safe fn create() -> i32;
    /// Removes a file that `create` made.
    safe fn remove(file: u32);
    /// Returns the space that is free for files (bytes).
    safe fn free_bytes() -> f64;
    safe fn stage(name: *const u8, name_len: usize, total: f64, unit: *const u8, unit_len: usize);
    safe fn advance(amount: f64);
    safe fn warn(text: *const u8, len: usize);
    safe fn cancelled() -> u32;
}

/// Returns the error that a negative answer of the host stands for.
fn failure(code: i32) -> io::Error {
    match code {
        -2 => ErrorKind::StorageFull.into(),
        -3 => io::Error::other("it was changed or removed since it was chosen; choose it again"),
        -4 => io::Error::other("too many temporary files"),
        _ => io::Error::other("the browser refused it"),
    }
}

/// File that the host provides as an input.
pub struct HostSource {
    pub name: PathBuf,
    pub file: u32,
    pub len: u64,
}

impl ByteSource for HostSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let mut done = 0;
        while done < buf.len() {
            let rest = &mut buf[done..];
            let at = offset + done as u64;
            let error = match read(self.file, at as f64, rest.as_mut_ptr(), rest.len()) {
                0 => ErrorKind::UnexpectedEof.into(),
                read if read > 0 => {
                    done += read as usize;
                    continue;
                }
                code => failure(code),
            };
            return Err(Error::io(&self.name, format!("read {} bytes at {at}", rest.len()), error));
        }
        Ok(())
    }
}

/// Temporary file of the host; removed when the last owner drops it.
#[derive(Debug)]
struct HostFile {
    number: u32,
    len: Mutex<u64>,
}

impl HostFile {
    fn create() -> io::Result<Arc<Self>> {
        let number = u32::try_from(create()).map_err(|_| failure(-4))?;
        Ok(Arc::new(Self { number, len: Mutex::new(0) }))
    }

    fn len(&self) -> MutexGuard<'_, u64> {
        self.len.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for HostFile {
    fn drop(&mut self) {
        remove(self.number);
    }
}

#[derive(Debug)]
struct Open(Arc<HostFile>);

impl DiskFile for Open {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        let len = self.0.len().saturating_sub(offset).min(buf.len() as u64) as usize;
        match read(self.0.number, offset as f64, buf.as_mut_ptr(), len) {
            read if read >= 0 => Ok(read as usize),
            code => Err(failure(code)),
        }
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        match write(self.0.number, offset as f64, bytes.as_ptr(), bytes.len()) {
            written if written >= 0 => {
                let mut len = self.0.len();
                *len = (*len).max(offset + written as u64);
                Ok(written as usize)
            }
            code => Err(failure(code)),
        }
    }

    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        let end = *self.0.len();
        self.write_at(bytes, end)
    }

    fn len(&self) -> io::Result<u64> {
        Ok(*self.0.len())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }

    fn try_lock(&self) -> io::Result<bool> {
        Ok(true)
    }
}

#[derive(Debug)]
struct Root;

impl DiskFolder for Root {
    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

/// Disk with one folder, [`FOLDER`], whose files are temporary files of the host.
#[derive(Debug, Default)]
pub struct HostDisk(Mutex<HashMap<PathBuf, Arc<HostFile>>>);

impl HostDisk {
    fn names(&self) -> MutexGuard<'_, HashMap<PathBuf, Arc<HostFile>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, path: &Path) -> io::Result<Arc<HostFile>> {
        self.names().get(path).cloned().ok_or_else(|| ErrorKind::NotFound.into())
    }

    /// Takes the file at `path` out of the disk; it stays with the host, which gets its number and length (bytes).
    pub fn take(&self, path: &Path) -> Option<(u32, u64)> {
        let file = self.names().remove(path)?;
        let taken = (file.number, *file.len());
        std::mem::forget(file);
        Some(taken)
    }
}

impl Disk for HostDisk {
    fn create(&self, path: &Path, _: Option<u32>) -> io::Result<Box<dyn DiskFile>> {
        if self.find(path).is_ok() {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let file = HostFile::create()?;
        self.names().insert(path.to_path_buf(), file.clone());
        Ok(Box::new(Open(file)))
    }

    fn create_unnamed(&self, _: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(Open(HostFile::create()?)))
    }

    fn open(&self, path: &Path, _: Access) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(Open(self.find(path)?)))
    }

    fn about(&self, path: &Path) -> io::Result<About> {
        let about = |kind, len| About { kind, len, mode: None, owner: None, read_only: false };
        match Path::new(FOLDER).starts_with(path) {
            true => Ok(about(FileKind::Folder, 0)),
            false => self.find(path).map(|file| about(FileKind::File, *file.len())),
        }
    }

    fn id(&self, _: &Path) -> Option<FileId> {
        None
    }

    fn read_link(&self, _: &Path) -> io::Result<PathBuf> {
        Err(ErrorKind::InvalidInput.into())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut names = self.names();
        let file = names.remove(from).ok_or(ErrorKind::NotFound)?;
        names.insert(to.to_path_buf(), file);
        Ok(())
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        match self.find(to) {
            Ok(_) => Err(ErrorKind::AlreadyExists.into()),
            Err(_) => self.rename(from, to),
        }
    }

    fn link(&self, _: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.names().remove(path).map(drop).ok_or_else(|| ErrorKind::NotFound.into())
    }

    /// Lists nothing: files live as long as the module, so an earlier run leaves none behind, and without locks those of
    /// this run would pass for left over.
    fn list(&self, _: &Path, _: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
        Ok(Vec::new())
    }

    fn open_folder(&self, _: &Path) -> io::Result<Box<dyn DiskFolder>> {
        Ok(Box::new(Root))
    }

    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(free_bytes() as u64)
    }
}

/// Passes progress and warnings on. Amounts are passed in steps, because a call costs more than an addition.
#[derive(Default)]
pub struct HostMonitor {
    amount: Cell<u64>,
    step: Cell<u64>,
    /// Whether the unit of an input is assumed, because it states none.
    pub assumed_unit: Cell<bool>,
}

// SAFETY: the module has one thread.
unsafe impl Sync for HostMonitor {}

impl Monitor for HostMonitor {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        self.amount.set(0);
        self.step.set((total / 500).max(1));
        stage(name.as_ptr(), name.len(), total as f64, unit.as_ptr(), unit.len());
    }

    fn advance(&self, amount: u64) {
        let sum = self.amount.get() + amount;
        self.amount.set(if sum < self.step.get() { sum } else { 0 });
        if sum >= self.step.get() {
            advance(sum as f64);
        }
    }

    fn warn(&self, warning: &Warning) {
        if warning.suggestion() == Some(&Parameter::Units) {
            self.assumed_unit.set(true);
        }
        let text = warning.to_string();
        warn(text.as_ptr(), text.len());
    }

    fn cancelled(&self) -> bool {
        cancelled() != 0
    }
}
