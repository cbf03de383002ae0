//! Sources of bytes: a file read by position, a file mapped into memory, bytes in memory, or a source of your own.
//!
//! Input: an offset and a length. Output: bytes, or an error. Memory: none of its own. The rest of the library reads
//! only through this trait, so a test that counts, delays, cuts or damages reads needs nothing else.

pub mod crc;
mod file_id;
mod held;
mod interrupt;
mod named;
mod positioned;
mod regular;
#[cfg(feature = "remote")]
mod remote;
#[doc(hidden)]
pub mod testing;

pub use file_id::FileId;
pub use held::{held, hold_source, is_file_at, len_at, release_sources};
pub use interrupt::{HAS_THREADS, spawn_in};
pub use interrupt::{Stop, interruptible, stop_of_thread};
pub use named::*;
pub use positioned::*;
pub use regular::*;
#[cfg(feature = "remote")]
pub use remote::list;
#[cfg(feature = "remote")]
pub use remote::{RemoteOptions, RemoteSource};
#[cfg(feature = "remote")]
pub use remote::{check_upload, upload};

use crate::{Error, Result};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Bytes of fixed length that several threads can read at any offset at once.
pub trait ByteSource: Send + Sync {
    /// Returns the number of bytes at the time the source was opened.
    fn len(&self) -> u64;

    /// Returns whether the source holds no bytes.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fills `buf` with the bytes at `offset`; fails if there are fewer.
    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()>;

    /// Returns the file that the bytes come from, if any: no output may replace it.
    fn file_id(&self) -> Option<FileId> {
        None
    }

    /// Returns the address of the object that the bytes come from, if any: no output may replace it.
    fn address(&self) -> Option<&str> {
        None
    }
}

impl<S: ByteSource + ?Sized> ByteSource for std::sync::Arc<S> {
    fn len(&self) -> u64 {
        (**self).len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        (**self).read_at(offset, buf)
    }

    fn file_id(&self) -> Option<FileId> {
        (**self).file_id()
    }

    fn address(&self) -> Option<&str> {
        (**self).address()
    }
}

/// File read by position. If the file is cut while it is open, reads return an error and never crash.
#[derive(Debug)]
pub struct FileSource {
    file: File,
    path: PathBuf,
    len: u64,
}

impl FileSource {
    /// Opens the file at `path`.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let (file, len) = open_file(path)?;
        Ok(Self { file, path: path.to_path_buf(), len })
    }
}

impl ByteSource for FileSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        read_exact_at(&self.file, offset, buf).map_err(|source| read_error(&self.path, offset, buf.len(), source))
    }

    fn file_id(&self) -> Option<FileId> {
        FileId::of(&self.file)
    }
}

/// File mapped into memory: the fastest source if the file does not change.
///
/// Condition: the file must not be written to or cut while the map lives. Cutting it ends the process with a signal
/// instead of an error. Archives are published by rename and never changed in place, so replacing one is safe; where
/// others may truncate files, use [`FileSource`].
#[derive(Debug)]
pub struct MapSource {
    map: memmap2::Mmap,
    path: PathBuf,
    id: Option<FileId>,
}

impl MapSource {
    /// Maps the file at `path`; see the condition of the type.
    #[allow(unsafe_code)]
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let (file, _) = open_file(path)?;
        // SAFETY: the map is read-only, and the type's condition, repeated at every constructor that leads here,
        // forbids changing the file while the map lives.
        let map = unsafe { memmap2::Mmap::map(&file) };
        let map = map.map_err(|source| Error::io(path, "map into memory", source))?;
        Ok(Self { map, path: path.to_path_buf(), id: FileId::of(&file) })
    }
}

impl ByteSource for MapSource {
    fn len(&self) -> u64 {
        self.map.len() as u64
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        copy_from(&self.map, offset, buf).map_err(|source| read_error(&self.path, offset, buf.len(), source))
    }

    fn file_id(&self) -> Option<FileId> {
        self.id
    }
}

/// Bytes held in memory.
#[derive(Debug, Clone)]
pub struct MemorySource {
    start: u64,
    bytes: std::sync::Arc<[u8]>,
}

impl MemorySource {
    /// Creates a source of `bytes`.
    pub fn new(bytes: impl Into<std::sync::Arc<[u8]>>) -> Self {
        Self::part(0, bytes)
    }

    /// Creates a source that has only `bytes`, from offset `start` to its end. Reads before `start` fail.
    pub fn part(start: u64, bytes: impl Into<std::sync::Arc<[u8]>>) -> Self {
        Self { start, bytes: bytes.into() }
    }
}

impl ByteSource for MemorySource {
    fn len(&self) -> u64 {
        self.start.saturating_add(self.bytes.len() as u64)
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let from = offset.checked_sub(self.start);
        let copied = from.map_or(Err(io::ErrorKind::UnexpectedEof.into()), |from| copy_from(&self.bytes, from, buf));
        copied.map_err(|source| read_error(Path::new("memory"), offset, buf.len(), source))
    }
}

fn open_file(path: &Path) -> Result<(File, u64)> {
    let (file, about) = open_regular(path).map_err(|source| Error::io(path, "open", source))?;
    Ok((file, about.len()))
}

fn copy_from(bytes: &[u8], offset: u64, buf: &mut [u8]) -> io::Result<()> {
    let start = usize::try_from(offset).ok().filter(|&start| start <= bytes.len());
    let wanted = start.and_then(|start| bytes[start..].get(..buf.len()));
    buf.copy_from_slice(wanted.ok_or(io::ErrorKind::UnexpectedEof)?);
    Ok(())
}

fn read_error(path: &Path, offset: u64, len: usize, source: io::Error) -> Error {
    Error::io(path, format!("read {len} bytes at {offset}"), source)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_read_what_is_there_and_nothing_beyond() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let bytes: Vec<u8> = (0..100).collect();
        std::fs::write(&path, &bytes).unwrap();
        let sources: [Box<dyn ByteSource>; 3] = [
            Box::new(FileSource::open(&path).unwrap()),
            Box::new(MapSource::open(&path).unwrap()),
            Box::new(MemorySource::new(&bytes[..])),
        ];
        let id = FileId::at(&path);
        for (source, id) in sources.iter().zip([id, id, None]) {
            assert!(source.len() == 100 && source.file_id() == id);
            let mut buf = [0; 10];
            source.read_at(90, &mut buf).unwrap();
            assert_eq!(buf, bytes[90..]);
            for offset in [91, 100, 1 << 40, u64::MAX] {
                let said = source.read_at(offset, &mut buf).unwrap_err().to_string();
                assert!(said.contains(&format!("cannot read 10 bytes at {offset}")), "{said}");
            }
        }
    }
}
