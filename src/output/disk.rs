//! Every change that outputs make to the file system, one function each; nothing above calls the operating system.
//!
//! A call that a signal interrupts (EINTR) is repeated.

use crate::bytes::write_all_at;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

/// Name of standard output where descriptors have names.
pub(super) const STANDARD_OUTPUT: &str = "/dev/fd/1";

/// The calls, for tests that let one of them fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Call {
    Create,
    Open,
    Metadata,
    Lock,
    Write,
    Sync,
    Rename,
    RenameNew,
    Remove,
    List,
    OpenFolder,
    SyncFolder,
}

/// Repeats `act` for as long as signals interrupt it.
fn repeat<T>(call: Call, mut act: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        #[cfg(test)]
        let done = faults::meet(call).and_then(|()| act());
        #[cfg(not(test))]
        let done = {
            let _ = call;
            act()
        };
        match done {
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

/// Creates a file that did not exist, to be read and written. Others may do with it what they may do with the file that
/// it will replace, as far as the umask allows; the owner can read and write it.
pub(super) fn create(path: &Path, replaces: Option<&fs::Metadata>) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    if let Some(old) = replaces {
        use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
        options.mode(old.mode() & 0o666 | 0o600);
    }
    #[cfg(not(unix))]
    let _ = replaces;
    repeat(Call::Create, || options.open(path))
}

/// Opens a file to be read.
pub(super) fn open(path: &Path) -> io::Result<File> {
    repeat(Call::Open, || File::open(path))
}

/// Opens a pipe or device to be written; what standard output has been given already stays.
pub(super) fn open_stream(path: &Path) -> io::Result<File> {
    if path == Path::new(STANDARD_OUTPUT) {
        return repeat(Call::Open, standard_output);
    }
    repeat(Call::Open, || OpenOptions::new().append(true).open(path))
}

/// Standard output once more. By its name a socket could not be opened, and Windows has no such name.
fn standard_output() -> io::Result<File> {
    #[cfg(unix)]
    return std::os::fd::AsFd::as_fd(&io::stdout()).try_clone_to_owned().map(File::from);
    #[cfg(windows)]
    return std::os::windows::io::AsHandle::as_handle(&io::stdout()).try_clone_to_owned().map(File::from);
    #[cfg(not(any(unix, windows)))]
    return Err(ErrorKind::Unsupported.into());
}

/// What is at `path`, links followed; `None` if nothing is.
pub(super) fn metadata(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match repeat(Call::Metadata, || fs::metadata(path)) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Locks a file for its writer; `false` if somebody else holds the lock. It ends with the file, and so with the process.
pub(super) fn try_lock(file: &File) -> io::Result<bool> {
    let locked = repeat(Call::Lock, || match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    });
    #[cfg(unix)]
    let no_locks = |error: &io::Error| error.raw_os_error() == Some(rustix::io::Errno::NOLCK.raw_os_error());
    #[cfg(not(unix))]
    let no_locks = |_: &io::Error| false;
    match locked {
        Err(error) if no_locks(&error) => Err(ErrorKind::Unsupported.into()),
        locked => locked,
    }
}

/// Writes all of `bytes` at `offset`.
pub(super) fn write_at(file: &File, offset: u64, bytes: &[u8]) -> io::Result<()> {
    repeat(Call::Write, || write_all_at(file, offset, bytes))
}

/// Writes all of `bytes` to a pipe or device.
pub(super) fn write_stream(mut file: &File, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        let written = repeat(Call::Write, || file.write(bytes))?;
        if written == 0 {
            return Err(ErrorKind::WriteZero.into());
        }
        bytes = &bytes[written..];
    }
    Ok(())
}

/// Makes the content of a file durable.
pub(super) fn sync(file: &File) -> io::Result<()> {
    repeat(Call::Sync, || file.sync_all())
}

/// Gives a file another name, whatever has that name already.
pub(super) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    repeat(Call::Rename, || fs::rename(from, to))
}

/// Gives a file a name that nothing has; fails with [`ErrorKind::AlreadyExists`] if something has it.
///
/// By one call where the system can (Linux, macOS), else by a hard link, else (no links, as on FAT) by an empty file that
/// takes the name and that the file then replaces: killed in between, the empty file stays.
pub(super) fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    repeat(Call::RenameNew, || match rename_in_one(from, to) {
        Err(error) if error.kind() == ErrorKind::Unsupported => match rename_by_link(from, to) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
            Err(_) => rename_by_claim(from, to),
            Ok(()) => Ok(()),
        },
        done => done,
    })
}

#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
fn rename_in_one(from: &Path, to: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // The kernel or the file system does not know the flag.
        Err(Errno::NOSYS | Errno::INVAL | Errno::NOTSUP) => Err(ErrorKind::Unsupported.into()),
        done => Ok(done?),
    }
}

#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
fn rename_in_one(_: &Path, _: &Path) -> io::Result<()> {
    Err(ErrorKind::Unsupported.into())
}

fn rename_by_link(from: &Path, to: &Path) -> io::Result<()> {
    fs::hard_link(from, to)?;
    // If the old name stays, the next run removes it as a leftover; the file has the new one.
    let _ = fs::remove_file(from);
    Ok(())
}

fn rename_by_claim(from: &Path, to: &Path) -> io::Result<()> {
    File::create_new(to)?;
    fs::rename(from, to).inspect_err(|_| {
        let _ = fs::remove_file(to);
    })
}

/// Removes a file.
pub(super) fn remove(path: &Path) -> io::Result<()> {
    repeat(Call::Remove, || fs::remove_file(path))
}

/// Names of the regular files in `folder` that `wanted` accepts.
pub(super) fn list(folder: &Path, wanted: impl Fn(&OsString) -> bool) -> io::Result<Vec<OsString>> {
    let mut names = Vec::new();
    let mut entries = repeat(Call::List, || fs::read_dir(folder))?;
    while let Some(entry) = repeat(Call::List, || entries.next().transpose())? {
        // A pipe of such a name would hold up whoever opens it.
        if wanted(&entry.file_name()) && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            names.push(entry.file_name());
        }
    }
    Ok(names)
}

/// Opens a file of another run to be locked.
pub(super) fn open_to_lock(path: &Path) -> io::Result<File> {
    repeat(Call::Open, || OpenOptions::new().write(true).open(path))
}

/// A folder, opened before a name in it changes, so that the change can be made durable.
#[derive(Debug)]
pub(super) struct Folder {
    #[cfg(unix)]
    file: File,
}

impl Folder {
    pub fn open(path: &Path) -> io::Result<Self> {
        let about = repeat(Call::OpenFolder, || fs::metadata(path))?;
        if !about.is_dir() {
            return Err(ErrorKind::NotADirectory.into());
        }
        Ok(Self {
            #[cfg(unix)]
            file: repeat(Call::OpenFolder, || File::open(path))?,
        })
    }

    /// Makes changed names durable.
    pub fn sync(&self) -> io::Result<()> {
        #[cfg(unix)]
        let synced = repeat(Call::SyncFolder, || self.file.sync_all());
        #[cfg(not(unix))]
        let synced = repeat(Call::SyncFolder, || Ok(()));
        match synced {
            // Some file systems cannot sync folders and keep names safe by themselves.
            Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
            synced => synced,
        }
    }
}

/// Lets calls fail.
#[cfg(test)]
pub(super) mod faults {
    use super::Call;
    use std::cell::RefCell;
    use std::io;

    type Hook = Box<dyn FnMut(Call) -> io::Result<()>>;

    thread_local! {
        static HOOK: RefCell<Option<Hook>> = const { RefCell::new(None) };
    }

    /// Asks the hook of this thread before a call.
    pub fn meet(call: Call) -> io::Result<()> {
        HOOK.with_borrow_mut(|hook| hook.as_mut().map_or(Ok(()), |hook| hook(call)))
    }

    /// Runs `act` with `hook` asked before each call of this thread.
    pub fn with<T>(hook: impl FnMut(Call) -> io::Result<()> + 'static, act: impl FnOnce() -> T) -> T {
        HOOK.set(Some(Box::new(hook)));
        let done = act();
        HOOK.set(None);
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_way_of_renaming_to_a_new_name_replaces_what_has_it() {
        type Way = fn(&Path, &Path) -> io::Result<()>;
        let ways: [(&str, Way); 4] = [
            ("one call", rename_in_one),
            ("link", rename_by_link),
            ("claim", rename_by_claim),
            ("whichever", rename_new),
        ];
        for (name, way) in ways {
            let folder = tempfile::tempdir().unwrap();
            let (from, to) = (folder.path().join("from"), folder.path().join("to"));
            fs::write(&from, "new").unwrap();
            fs::write(&to, "old").unwrap();
            let refused = way(&from, &to).unwrap_err();
            if refused.kind() == ErrorKind::Unsupported {
                eprintln!("skipped: this file system cannot rename by {name}");
                continue;
            }
            assert_eq!(refused.kind(), ErrorKind::AlreadyExists, "{name}");
            assert_eq!(
                (fs::read(&from).unwrap(), fs::read(&to).unwrap()),
                (b"new".to_vec(), b"old".to_vec()),
                "{name}"
            );
            fs::remove_file(&to).unwrap();
            way(&from, &to).unwrap();
            assert_eq!(fs::read(&to).unwrap(), b"new", "{name}");
            assert!(!from.exists(), "{name}");
        }
    }
}
