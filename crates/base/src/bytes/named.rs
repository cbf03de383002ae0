//! Inputs by name: regular files and, with the feature `remote`, objects by address.

#[cfg(feature = "remote")]
use super::remote::RemoteSource;
use super::{ByteSource, FileSource, Stamp, held, open_regular, read_up_to};
use crate::{Error, Result};
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Returns `path` as an address, if it is one: `s3://bucket/key`, `https://host/path`.
pub fn address(path: &Path) -> Option<&str> {
    let text = path.to_str()?;
    let (scheme, _) = text.split_once("://")?;
    let is_scheme = scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric() || b"+-.".contains(&b));
    is_scheme.then_some(text)
}

/// Returns the path that a `file://` address names.
pub fn local(path: &Path) -> Option<std::path::PathBuf> {
    let rest = address(path)?.strip_prefix("file://")?;
    let at = rest.find('/')?;
    matches!(&rest[..at], "" | "localhost").then(|| {
        #[cfg(feature = "remote")]
        let rest = percent_encoding::percent_decode_str(&rest[at..]).decode_utf8_lossy().into_owned();
        #[cfg(not(feature = "remote"))]
        let rest = rest[at..].to_owned();
        // The slash before a drive is not part of the path: `file:///C:/scans/a.laz`.
        let is_drive =
            cfg!(windows) && rest.as_bytes().get(1..3).is_some_and(|at| at[0].is_ascii_alphabetic() && at[1] == b':');
        if is_drive { rest[1..].into() } else { rest.into() }
    })
}

/// Opens the file or object `path`.
pub fn open_named(path: &Path) -> Result<Box<dyn ByteSource>> {
    let file = local(path);
    let path = file.as_deref().unwrap_or(path);
    if let Some(source) = held(path) {
        return Ok(Box::new(source));
    }
    match address(path) {
        None => Ok(Box::new(FileSource::open(path)?)),
        #[cfg(feature = "remote")]
        Some(address) => Ok(Box::new(Ahead::new(RemoteSource::with(address, &patient())?))),
        #[cfg(not(feature = "remote"))]
        Some(_) => Err(without_feature(path)),
    }
}

#[cfg(not(feature = "remote"))]
/// The error for the address of an object in a build without the feature `remote`.
pub fn without_feature(path: &Path) -> Error {
    Error::input(
        path,
        "address",
        "this build reads and writes files only; build it with --features remote, or use a file",
    )
}

/// Returns the options for conversions, which take hours: a minute for each request, and ten for a read.
#[cfg(feature = "remote")]
pub(super) fn patient() -> super::RemoteOptions {
    use std::time::Duration;
    let (timeout, patience) = (Duration::from_secs(60), Duration::from_secs(600));
    super::RemoteOptions { timeout, patience, ..super::RemoteOptions::default() }
}

/// Input read by position, whose changes are detected.
pub enum Input {
    /// A regular file.
    File(File),
    /// Bytes that the program provides.
    Held(Arc<dyn ByteSource>),
    /// An object; every answer belongs to the version that was opened.
    #[cfg(feature = "remote")]
    Object(Box<Ahead>),
}

impl Input {
    /// Opens the input `path`; returns it with its state.
    pub fn open(path: &Path) -> Result<(Self, Stamp)> {
        let file = local(path);
        let path = file.as_deref().unwrap_or(path);
        if let Some(source) = held(path) {
            let stamp = Stamp::of_held(source.len());
            return Ok((Self::Held(source), stamp));
        }
        match address(path) {
            None => {
                let (file, about) = open_regular(path).map_err(|e| Error::io(path, "open", e))?;
                let stamp = Stamp::of(&file, &about);
                Ok((Self::File(file), stamp))
            }
            #[cfg(feature = "remote")]
            Some(address) => {
                let source = RemoteSource::with(address, &patient())?;
                let stamp = source.stamp();
                Ok((Self::Object(Box::new(Ahead::new(source))), stamp))
            }
            #[cfg(not(feature = "remote"))]
            Some(_) => Err(without_feature(path)),
        }
    }

    /// Fills `buf` with the bytes at `offset`; returns fewer only at the end of the input.
    pub fn read_up_to(&self, offset: u64, buf: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => read_up_to(file, offset, buf),
            Self::Held(source) => read_source(source, offset, buf),
            #[cfg(feature = "remote")]
            Self::Object(source) => read_source(&**source, offset, buf),
        }
    }
}

impl std::fmt::Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::File(_) => "Input::File",
            Self::Held(_) => "Input::Held",
            #[cfg(feature = "remote")]
            Self::Object(_) => "Input::Object",
        })
    }
}

/// Fills `buf` with the bytes at `offset`; returns fewer only at the end of the source.
pub(super) fn read_source(source: &(impl ByteSource + ?Sized), offset: u64, buf: &mut [u8]) -> io::Result<usize> {
    let len = source.len().saturating_sub(offset).min(buf.len() as u64) as usize;
    if len == 0 {
        return Ok(0);
    }
    source.read_at(offset, &mut buf[..len]).map(|()| len).map_err(|error| match error {
        Error::Io { source, .. } => source,
        other => io::Error::other(other.to_string()),
    })
}

/// Object with read-ahead for sequential reads: reading a scan or an archive from its beginning takes one request per
/// megabyte instead of one per page.
///
/// Memory: two stretches of at most `Ahead::MOST` bytes.
#[cfg(feature = "remote")]
#[derive(Debug)]
pub struct Ahead {
    source: RemoteSource,
    /// The last one was used most recently.
    held: std::sync::Mutex<[Stretch; 2]>,
}

#[cfg(feature = "remote")]
#[derive(Debug, Default)]
struct Stretch {
    at: u64,
    bytes: Vec<u8>,
}

#[cfg(feature = "remote")]
impl Ahead {
    /// Longest stretch (bytes).
    const MOST: usize = 1 << 20;
    /// Shortest stretch read ahead, and the largest gap behind a stretch after which a read still continues it (bytes).
    const LEAST: usize = 64 << 10;

    /// Wraps a remote object.
    pub fn new(source: RemoteSource) -> Self {
        Self { source, held: Default::default() }
    }
}

#[cfg(feature = "remote")]
impl ByteSource for Ahead {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let end = offset.saturating_add(buf.len() as u64);
        let mut held = self.held.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let within = |stretch: &Stretch| stretch.at <= offset && end <= stretch.at + stretch.bytes.len() as u64;
        let follows = |stretch: &Stretch| {
            let behind = stretch.at + stretch.bytes.len() as u64;
            !stretch.bytes.is_empty() && (stretch.at..=behind + Self::LEAST as u64).contains(&offset)
        };
        if let Some(which) = held.iter().position(within) {
            held[which..].rotate_left(1);
        } else {
            if buf.len() >= Self::MOST || end > self.len() || self.source.holds(end) {
                return self.source.read_at(offset, buf);
            }
            let which = held.iter().position(follows);
            let ahead = which.map_or(0, |which| (2 * held[which].bytes.len()).clamp(Self::LEAST, Self::MOST));
            held[which.unwrap_or(0)..].rotate_left(1);
            let count = (self.len() - offset).min(ahead.max(buf.len()) as u64) as usize;
            let last = &mut held[1];
            // A failed read leaves nothing of the stretch.
            last.bytes.clear();
            let mut bytes = std::mem::take(&mut last.bytes);
            bytes.resize(count, 0);
            self.source.read_at(offset, &mut bytes)?;
            *last = Stretch { at: offset, bytes };
        }
        let Stretch { at, bytes } = &held[1];
        let start = (offset - at) as usize;
        buf.copy_from_slice(&bytes[start..start + buf.len()]);
        Ok(())
    }

    fn address(&self) -> Option<&str> {
        self.source.address()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_files_name_paths() {
        let path = |text: &str| local(Path::new(text)).map(|path| path.to_str().unwrap().to_owned());
        assert_eq!(path("file:///scans/a.laz").as_deref(), Some("/scans/a.laz"));
        assert_eq!(path("file://localhost/scans/a.laz").as_deref(), Some("/scans/a.laz"));
        let drive = if cfg!(windows) { "C:/scans/a.laz" } else { "/C:/scans/a.laz" };
        assert_eq!(path("file:///C:/scans/a.laz").as_deref(), Some(drive));
        assert_eq!((path("file://host/a.laz"), path("s3://bucket/a.laz"), path("a.laz")), (None, None, None));
    }

    #[test]
    fn inputs_in_memory_are_read_as_files_are() {
        let bytes: Vec<u8> = (0..100).collect();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.xyz");
        std::fs::write(&file, &bytes).unwrap();
        crate::bytes::testing::hold("held.xyz", &bytes[..]);
        let held = Path::new("held.xyz");
        let [there, here] = [&*file, held].map(|path| Input::open(path).unwrap());
        assert_eq!(here.1.len(), there.1.len());
        for (offset, len) in [(0, 100), (0, 7), (93, 7), (93, 8), (99, 100), (100, 1), (1 << 40, 5), (40, 0)] {
            let [a, b] = [&there.0, &here.0].map(|input| {
                let mut buf = vec![0xEE; len];
                let read = input.read_up_to(offset, &mut buf).unwrap();
                (read, buf)
            });
            assert_eq!(a, b, "{len} bytes at {offset}");
        }
        let mut buf = [0; 5];
        open_named(held).unwrap().read_at(95, &mut buf).unwrap();
        assert_eq!(buf, [95, 96, 97, 98, 99]);
        assert_eq!([held, &*file].map(|path| crate::bytes::len_at(path).unwrap()), [100, 100]);
        // Other threads see the files, not the held bytes.
        std::thread::spawn(|| assert!(Input::open(Path::new("held.xyz")).is_err())).join().unwrap();
        crate::bytes::release_sources();
        assert!(Input::open(held).is_err() && Input::open(&file).is_ok());
    }

    #[test]
    fn addresses_are_told_from_paths() {
        for text in ["s3://bucket/key", "https://host/a.laz", "file:///a"] {
            assert_eq!(address(Path::new(text)), Some(text));
        }
        for text in ["a.laz", "C://folder/a.laz", "folder//a.laz", "a b://c", "://x", "/s3:/bucket"] {
            assert_eq!(address(Path::new(text)), None, "{text}");
        }
    }
}
