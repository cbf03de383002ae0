//! Disks for tests: one that makes calls fail ([`Hooked`]), and a model that loses what was not synced ([`model`]).

pub mod model;

use super::{About, Access, Disk, DiskFile, DiskFolder, real::RealDisk};
use crate::bytes::FileId;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A call of a [`Disk`], a [`DiskFile`] or a [`DiskFolder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Call {
    Create,
    Open,
    About,
    Rename,
    RenameNew,
    Link,
    Remove,
    List,
    OpenFolder,
    SyncFolder,
    FreeBytes,
    Read,
    Write,
    Length,
    Sync,
    Lock,
}

/// Effect on a call.
#[derive(Debug)]
pub enum Verdict {
    Done,
    Fails(io::Error),
    /// Reads or writes half the bytes; any other call succeeds.
    Short,
    /// Writes half the bytes and then fails; any other call fails.
    Torn(io::Error),
}

impl From<io::Result<()>> for Verdict {
    fn from(result: io::Result<()>) -> Self {
        result.map_or_else(Self::Fails, |()| Self::Done)
    }
}

type Hook = Arc<Mutex<dyn FnMut(Call) -> Verdict + Send>>;

/// Another disk, with a hook called before each call.
pub struct Hooked {
    disk: Arc<dyn Disk>,
    hook: Hook,
}

impl Hooked {
    pub fn new(disk: Arc<dyn Disk>, hook: impl FnMut(Call) -> Verdict + Send + 'static) -> Arc<Self> {
        Arc::new(Self { disk, hook: Arc::new(Mutex::new(hook)) })
    }

    /// Creates the real disk, whose calls fail when `hook` fails.
    pub fn real(mut hook: impl FnMut(Call) -> io::Result<()> + Send + 'static) -> Arc<Self> {
        Self::new(Arc::new(RealDisk), move |call| hook(call).into())
    }

    fn file(&self, file: io::Result<Box<dyn DiskFile>>) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(HookedFile { file: file?, hook: self.hook.clone() }))
    }
}

impl fmt::Debug for Hooked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Hooked({:?})", self.disk)
    }
}

/// Passes a call without bytes to the hook.
fn meet(hook: &Hook, call: Call) -> io::Result<()> {
    match ask(hook, call) {
        Verdict::Done | Verdict::Short => Ok(()),
        Verdict::Fails(error) | Verdict::Torn(error) => Err(error),
    }
}

fn ask(hook: &Hook, call: Call) -> Verdict {
    (hook.lock().unwrap_or_else(PoisonError::into_inner))(call)
}

impl Disk for Hooked {
    fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<Box<dyn DiskFile>> {
        meet(&self.hook, Call::Create)?;
        self.file(self.disk.create(path, mode))
    }
    #[cfg(feature = "spill")]
    fn create_unnamed(&self, folder: &Path) -> io::Result<Box<dyn DiskFile>> {
        meet(&self.hook, Call::Create)?;
        self.file(self.disk.create_unnamed(folder))
    }
    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>> {
        meet(&self.hook, Call::Open)?;
        self.file(self.disk.open(path, access))
    }
    fn about(&self, path: &Path) -> io::Result<About> {
        meet(&self.hook, Call::About)?;
        self.disk.about(path)
    }
    fn id(&self, path: &Path) -> Option<FileId> {
        self.disk.id(path)
    }
    fn read_link(&self, path: &Path) -> io::Result<PathBuf> {
        self.disk.read_link(path)
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        meet(&self.hook, Call::Rename)?;
        self.disk.rename(from, to)
    }
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        meet(&self.hook, Call::RenameNew)?;
        self.disk.rename_new(from, to)
    }
    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        meet(&self.hook, Call::Link)?;
        self.disk.link(from, to)
    }
    fn remove(&self, path: &Path) -> io::Result<()> {
        meet(&self.hook, Call::Remove)?;
        self.disk.remove(path)
    }
    fn list(&self, folder: &Path, wanted: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
        meet(&self.hook, Call::List)?;
        self.disk.list(folder, wanted)
    }
    fn open_folder(&self, path: &Path) -> io::Result<Box<dyn DiskFolder>> {
        meet(&self.hook, Call::OpenFolder)?;
        Ok(Box::new(HookedFolder { folder: self.disk.open_folder(path)?, hook: self.hook.clone() }))
    }
    #[cfg(feature = "spill")]
    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        meet(&self.hook, Call::FreeBytes)?;
        self.disk.free_bytes(folder)
    }
}

struct HookedFile {
    file: Box<dyn DiskFile>,
    hook: Hook,
}

impl fmt::Debug for HookedFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HookedFile({:?})", self.file)
    }
}

impl HookedFile {
    fn write(&self, bytes: &[u8], write: impl Fn(&[u8]) -> io::Result<usize>) -> io::Result<usize> {
        let half = &bytes[..bytes.len().div_ceil(2)];
        match ask(&self.hook, Call::Write) {
            Verdict::Done => write(bytes),
            Verdict::Short => write(half),
            Verdict::Fails(error) => Err(error),
            Verdict::Torn(error) => {
                write(half)?;
                Err(error)
            }
        }
    }
}

impl DiskFile for HookedFile {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        match ask(&self.hook, Call::Read) {
            Verdict::Done => self.file.read_at(buf, offset),
            Verdict::Short => {
                let half = buf.len().div_ceil(2);
                self.file.read_at(&mut buf[..half], offset)
            }
            Verdict::Fails(error) | Verdict::Torn(error) => Err(error),
        }
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        self.write(bytes, |bytes| self.file.write_at(bytes, offset))
    }
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        self.write(bytes, |bytes| self.file.append(bytes))
    }
    fn len(&self) -> io::Result<u64> {
        meet(&self.hook, Call::Length)?;
        self.file.len()
    }
    fn sync(&self) -> io::Result<()> {
        meet(&self.hook, Call::Sync)?;
        self.file.sync()
    }
    fn try_lock(&self) -> io::Result<bool> {
        meet(&self.hook, Call::Lock)?;
        self.file.try_lock()
    }
}

struct HookedFolder {
    folder: Box<dyn DiskFolder>,
    hook: Hook,
}

impl fmt::Debug for HookedFolder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HookedFolder({:?})", self.folder)
    }
}

impl DiskFolder for HookedFolder {
    fn sync(&self) -> io::Result<()> {
        meet(&self.hook, Call::SyncFolder)?;
        self.folder.sync()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FileKind, Files};
    use super::*;
    use std::fs;
    use std::io::ErrorKind;

    #[test]
    fn no_way_of_renaming_to_a_new_name_replaces_what_has_it() {
        type Way = fn(&Files, &Path, &Path) -> io::Result<()>;
        let ways: [(&str, Way); 4] = [
            ("one call", |files, from, to| files.0.rename_new(from, to)),
            ("link", Files::rename_by_link),
            ("claim", Files::rename_by_claim),
            ("whichever", Files::rename_new),
        ];
        let files = Files::current();
        for (name, way) in ways {
            let folder = tempfile::tempdir().unwrap();
            let (from, to) = (folder.path().join("from"), folder.path().join("to"));
            fs::write(&from, "new").unwrap();
            fs::write(&to, "old").unwrap();
            let refused = way(&files, &from, &to).unwrap_err();
            if refused.kind() == ErrorKind::Unsupported {
                eprintln!("skipped: this file system cannot rename by {name}");
                continue;
            }
            assert_eq!(refused.kind(), ErrorKind::AlreadyExists, "{name}");
            let found = (fs::read(&from).unwrap(), fs::read(&to).unwrap());
            assert_eq!(found, (b"new".to_vec(), b"old".to_vec()), "{name}");
            fs::remove_file(&to).unwrap();
            way(&files, &from, &to).unwrap();
            assert_eq!(fs::read(&to).unwrap(), b"new", "{name}");
            assert!(!from.exists(), "{name}");
        }
    }

    #[test]
    fn where_one_call_cannot_rename_to_a_new_name_a_link_or_a_claim_does() {
        for refused in [&[Call::RenameNew][..], &[Call::RenameNew, Call::Link]] {
            let folder = tempfile::tempdir().unwrap();
            let (from, to) = (folder.path().join("from"), folder.path().join("to"));
            fs::write(&from, "new").unwrap();
            let hook = |call| if refused.contains(&call) { Err(ErrorKind::Unsupported.into()) } else { Ok(()) };
            super::super::with(Hooked::real(hook), || {
                let files = Files::current();
                files.rename_new(&from, &to).unwrap();
                fs::write(&from, "newer").unwrap();
                assert_eq!(files.rename_new(&from, &to).unwrap_err().kind(), ErrorKind::AlreadyExists);
            });
            assert_eq!((fs::read(&to).unwrap(), fs::read(&from).unwrap()), (b"new".to_vec(), b"newer".to_vec()));
        }
    }

    #[test]
    fn signals_and_short_calls_are_met_by_repeating() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let mut number = 0;
        let hook = move |_| {
            number += 1;
            if number % 2 > 0 { Verdict::Fails(ErrorKind::Interrupted.into()) } else { Verdict::Short }
        };
        let bytes: Vec<u8> = (0..=255).collect();
        super::super::with(Hooked::new(Arc::new(RealDisk), hook), || {
            let files = Files::current();
            let file = files.create(&path, None).unwrap();
            file.write_at(0, &bytes).unwrap();
            let mut found = vec![0; 256];
            file.read_exact_at(0, &mut found).unwrap();
            assert!(found == bytes && file.try_lock().unwrap());
            file.sync().unwrap();
            assert_eq!(files.list(folder.path(), |_| true).unwrap(), ["file"]);
            files.rename(&path, &folder.path().join("other")).unwrap();
            files.open_folder(folder.path()).unwrap().sync().unwrap();
            assert_eq!(
                files.about(&folder.path().join("other")).unwrap().map(|about| about.kind),
                Some(FileKind::File)
            );
        });
    }

    #[test]
    fn a_claim_that_the_file_cannot_replace_is_taken_back() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        fs::write(&from, "new").unwrap();
        let hook = |call| match call {
            Call::RenameNew | Call::Link => Err(ErrorKind::Unsupported.into()),
            Call::Rename => Err(ErrorKind::PermissionDenied.into()),
            _ => Ok(()),
        };
        super::super::with(Hooked::real(hook), || {
            let refused = Files::current().rename_new(&from, &to).unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::PermissionDenied);
        });
        assert!(!to.exists());
        assert_eq!(fs::read(&from).unwrap(), b"new");
        assert_eq!(Files::current().open_folder(&from).unwrap_err().kind(), ErrorKind::NotADirectory);
    }
}
