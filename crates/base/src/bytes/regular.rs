//! Regular files only: opening a pipe may wait forever, and reading a device may never end.

use super::named::read_source;
use super::{ByteSource, FileId, held};
use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

/// Opens the file at `path` for reading; refuses pipes, devices and folders.
pub fn open_regular(path: &Path) -> io::Result<(File, Metadata)> {
    // Check by name first: opening a pipe without a writer would block.
    check(&std::fs::metadata(path).map_err(missing)?)?;
    let file = File::open(path)?;
    let about = file.metadata()?;
    check(&about)?;
    Ok((file, about))
}

/// Without a file system there are only the files that the program provides.
fn missing(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::Unsupported => io::Error::new(io::ErrorKind::NotFound, "it is not among the files given"),
        _ => error,
    }
}

fn check(about: &Metadata) -> io::Result<()> {
    match about {
        about if about.is_file() => Ok(()),
        about if about.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        _ => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a pipe or a device; copy its content to a file")),
    }
}

/// Regular file read from front to back.
pub enum Regular {
    /// A regular file.
    File(File),
    /// Bytes that the program provides, and the position of the next read.
    Held(Arc<dyn ByteSource>, u64),
}

impl Regular {
    /// Opens the file at `path`; returns it with its state.
    pub fn open(path: &Path) -> io::Result<(Self, Stamp)> {
        if let Some(source) = held(path) {
            let stamp = Stamp::of_held(source.len());
            return Ok((Self::Held(source, 0), stamp));
        }
        let (file, about) = open_regular(path)?;
        let stamp = Stamp::of(&file, &about);
        Ok((Self::File(file), stamp))
    }
}

impl Read for Regular {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(buf),
            Self::Held(source, position) => {
                let read = read_source(source, *position, buf)?;
                *position += read as u64;
                Ok(read)
            }
        }
    }
}

impl Seek for Regular {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Self::File(file) => file.seek(to),
            Self::Held(source, position) => {
                let to = match to {
                    SeekFrom::Start(to) => Some(to),
                    SeekFrom::End(by) => source.len().checked_add_signed(by),
                    SeekFrom::Current(by) => position.checked_add_signed(by),
                };
                *position = to.ok_or(io::ErrorKind::InvalidInput)?;
                Ok(*position)
            }
        }
    }
}

/// State of a file; if it differs later, the file was written to, cut or replaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    len: u64,
    modified: Option<SystemTime>,
    id: Option<FileId>,
}

impl Stamp {
    /// Returns the state of the open `file`, which `about` describes.
    pub fn of(file: &File, about: &Metadata) -> Self {
        Self { len: about.len(), modified: about.modified().ok(), id: FileId::of(file) }
    }

    /// Returns the state of bytes in memory.
    pub(super) fn of_held(len: u64) -> Self {
        Self { len, modified: None, id: None }
    }

    /// Returns the state of an object.
    #[cfg(feature = "remote")]
    pub(super) fn of_object(len: u64, modified: Option<SystemTime>, id: FileId) -> Self {
        Self { len, modified, id: Some(id) }
    }

    /// Returns the length of the file (bytes).
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Returns the modification time, if known (nanoseconds since 1970).
    pub fn modified_ns(&self) -> Option<i128> {
        let since = |time: SystemTime| match time.duration_since(SystemTime::UNIX_EPOCH) {
            Ok(after) => after.as_nanos() as i128,
            Err(before) => -(before.duration().as_nanos() as i128),
        };
        self.modified.map(since)
    }

    /// Returns whether the file at `path` is in this state.
    pub fn is_of(&self, path: &Path) -> bool {
        if let Some(source) = held(path) {
            return *self == Self::of_held(source.len());
        }
        if super::address(path).is_some() {
            return super::Input::open(path).is_ok_and(|(_, now)| now == *self);
        }
        let Ok(about) = std::fs::metadata(path) else { return false };
        let now = Self { len: about.len(), modified: about.modified().ok(), id: FileId::at(path) };
        *self == now
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn only_regular_files_are_opened_and_any_change_shows() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let pipe = at("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for refused in [&pipe, folder.path(), Path::new("/dev/zero"), &at("none")] {
            assert!(open_regular(refused).is_err(), "{}", refused.display());
        }
        fs::write(at("a"), "one").unwrap();
        fs::write(at("b"), "two").unwrap();
        let stamp = || open_regular(&at("a")).map(|(file, about)| Stamp::of(&file, &about)).unwrap();
        let first = stamp();
        assert!(first.is_of(&at("a")) && !first.is_of(&at("b")) && !first.is_of(&at("none")));
        fs::OpenOptions::new().append(true).open(at("a")).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
        assert!(!first.is_of(&at("a")), "another time");
        assert_eq!(stamp().modified_ns(), Some(0));
        let before = SystemTime::UNIX_EPOCH - std::time::Duration::from_millis(1500);
        fs::OpenOptions::new().append(true).open(at("a")).unwrap().set_modified(before).unwrap();
        assert_eq!(stamp().modified_ns(), Some(-1_500_000_000));
        let second = stamp();
        fs::write(at("a"), "longer").unwrap();
        assert!(!second.is_of(&at("a")), "another length");
        let third = stamp();
        fs::rename(at("b"), at("a")).unwrap();
        assert!(!third.is_of(&at("a")), "another file");
    }

    #[test]
    fn bytes_in_memory_are_sought_and_read_as_those_of_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        let bytes: Vec<u8> = (0..100).collect();
        fs::write(&file, &bytes).unwrap();
        crate::bytes::testing::hold("sought.bin", &bytes[..]);
        let [mut there, mut here] = [&*file, Path::new("sought.bin")].map(|path| Regular::open(path).unwrap().0);
        use SeekFrom::{Current, End, Start};
        for to in [Start(40), End(-1), Current(-50), Current(7), End(0), Start(200), Current(-300), End(-101), Start(0)]
        {
            let [a, b] = [&mut there, &mut here].map(|regular| {
                let (at, mut buf) = (regular.seek(to).ok(), [0; 5]);
                let read = regular.read(&mut buf).unwrap();
                (at, read, buf)
            });
            assert_eq!(a, b, "{to:?}");
        }
    }
}
