//! The real disk.

use super::{About, Access, Disk, DiskFile, DiskFolder, FileKind, STANDARD_OUTPUT};
use crate::bytes::{FileId, read_at, write_at};
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub(super) struct RealDisk;

impl Disk for RealDisk {
    fn create(&self, path: &Path, mode: Option<u32>) -> io::Result<Box<dyn DiskFile>> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        #[cfg(unix)]
        if let Some(mode) = mode {
            use std::os::unix::fs::OpenOptionsExt;
            options.mode(mode);
        }
        #[cfg(not(unix))]
        let _ = mode;
        Ok(Box::new(options.open(path)?))
    }

    #[cfg(all(feature = "spill", not(target_arch = "wasm32")))]
    fn create_unnamed(&self, folder: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(tempfile::tempfile_in(folder)?))
    }

    #[cfg(all(feature = "spill", target_arch = "wasm32"))]
    fn create_unnamed(&self, _: &Path) -> io::Result<Box<dyn DiskFile>> {
        Err(ErrorKind::Unsupported.into())
    }

    fn open(&self, path: &Path, access: Access) -> io::Result<Box<dyn DiskFile>> {
        if access == Access::Append && path == Path::new(STANDARD_OUTPUT) {
            return Ok(Box::new(standard_output()?));
        }
        let mut options = OpenOptions::new();
        match access {
            Access::Read => options.read(true),
            Access::Change => options.read(true).write(true),
            Access::Append => options.append(true),
        };
        Ok(Box::new(options.open(path)?))
    }

    fn about(&self, path: &Path) -> io::Result<About> {
        fs::metadata(path).map(|about| About {
            kind: kind(&about),
            len: about.len(),
            mode: mode_and_owner(&about).map(|both| both.0),
            owner: mode_and_owner(&about).map(|both| both.1),
            read_only: about.permissions().readonly(),
        })
    }

    fn id(&self, path: &Path) -> Option<FileId> {
        FileId::at(path)
    }

    fn read_link(&self, path: &Path) -> io::Result<PathBuf> {
        fs::read_link(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    #[cfg(all(feature = "spill", any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            // The kernel or the file system does not support the flag.
            Err(Errno::NOSYS | Errno::INVAL | Errno::NOTSUP) => Err(ErrorKind::Unsupported.into()),
            done => Ok(done?),
        }
    }

    #[cfg(not(all(feature = "spill", any(target_os = "linux", target_os = "android", target_vendor = "apple"))))]
    fn rename_new(&self, _: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::hard_link(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn list(&self, folder: &Path, wanted: &dyn Fn(&OsStr) -> bool) -> io::Result<Vec<OsString>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            // Opening a pipe of such a name would block.
            if wanted(&entry.file_name()) && entry.file_type().is_ok_and(|kind| kind.is_file()) {
                names.push(entry.file_name());
            }
        }
        Ok(names)
    }

    #[cfg(unix)]
    fn open_folder(&self, path: &Path) -> io::Result<Box<dyn DiskFolder>> {
        Ok(Box::new(Folder(File::open(path)?)))
    }

    #[cfg(not(unix))]
    fn open_folder(&self, _: &Path) -> io::Result<Box<dyn DiskFolder>> {
        Ok(Box::new(Folder))
    }

    #[cfg(feature = "spill")]
    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        // Some systems answer for the volume of a folder that does not exist.
        fs::metadata(folder)?;
        #[cfg(target_arch = "wasm32")]
        return Err(ErrorKind::Unsupported.into());
        #[cfg(not(target_arch = "wasm32"))]
        fs4::available_space(folder)
    }
}

impl DiskFile for File {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        read_at(self, offset, buf)
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        write_at(self, offset, bytes)
    }

    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        let mut file = self;
        file.write(bytes)
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn sync(&self) -> io::Result<()> {
        self.sync_all()
    }

    fn try_lock(&self) -> io::Result<bool> {
        match File::try_lock(self) {
            Ok(()) => Ok(true),
            Err(TryLockError::WouldBlock) => Ok(false),
            #[cfg(unix)]
            Err(TryLockError::Error(error)) if error.raw_os_error() == Some(libc::ENOLCK) => {
                Err(ErrorKind::Unsupported.into())
            }
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}

#[cfg(unix)]
#[derive(Debug)]
struct Folder(File);

#[cfg(unix)]
impl DiskFolder for Folder {
    fn sync(&self) -> io::Result<()> {
        self.0.sync_all()
    }
}

/// Folder on systems where folders cannot be synced.
#[cfg(not(unix))]
#[derive(Debug)]
struct Folder;

#[cfg(not(unix))]
impl DiskFolder for Folder {
    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(unix)]
fn mode_and_owner(about: &Metadata) -> Option<(u32, u32)> {
    use std::os::unix::fs::MetadataExt;
    Some((about.mode(), about.uid()))
}

#[cfg(not(unix))]
fn mode_and_owner(_: &Metadata) -> Option<(u32, u32)> {
    None
}

fn kind(about: &Metadata) -> FileKind {
    match about.file_type() {
        kind if kind.is_file() => FileKind::File,
        kind if kind.is_dir() => FileKind::Folder,
        kind if is_stream(kind) => FileKind::Stream,
        _ => FileKind::Other,
    }
}

#[cfg(unix)]
fn is_stream(kind: fs::FileType) -> bool {
    use std::os::unix::fs::FileTypeExt;
    kind.is_fifo() || kind.is_char_device() || kind.is_socket()
}

#[cfg(not(unix))]
fn is_stream(_: fs::FileType) -> bool {
    true
}

/// Duplicates standard output. Its name would not open a socket, and Windows has no such name.
fn standard_output() -> io::Result<File> {
    #[cfg(unix)]
    return std::os::fd::AsFd::as_fd(&io::stdout()).try_clone_to_owned().map(File::from);
    #[cfg(windows)]
    return std::os::windows::io::AsHandle::as_handle(&io::stdout()).try_clone_to_owned().map(File::from);
    #[cfg(not(any(unix, windows)))]
    return Err(ErrorKind::Unsupported.into());
}
