//! Bytes of a file from front to back, in blocks of 1 MiB, and parts of a file as sources of their own.

use slicewalk_base::bytes::{ByteSource, FileId};
use slicewalk_base::text::BYTE_ORDER_MARK;
use slicewalk_base::{Error, Result};
use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// Bytes read at once.
const BLOCK_BYTES: u64 = 1 << 20;
/// Most bytes of JSON: a set of levels has thousands of nodes, and a glTF may hold its values as text.
const MOST_JSON: u64 = 256 << 20;

/// A part of a source.
pub struct Part {
    source: Arc<dyn ByteSource>,
    start: u64,
    len: u64,
}

impl Part {
    /// Returns the `len` bytes at `start`, or `None` if the source ends before.
    pub fn new(source: &Arc<dyn ByteSource>, start: u64, len: u64) -> Option<Self> {
        let is_there = start.checked_add(len).is_some_and(|end| end <= source.len());
        is_there.then(|| Self { source: source.clone(), start, len })
    }
}

impl ByteSource for Part {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        if offset.checked_add(buf.len() as u64).is_none_or(|end| end > self.len) {
            return Err(Error::io("part", "read", io::ErrorKind::UnexpectedEof.into()));
        }
        self.source.read_at(self.start + offset, buf)
    }

    fn file_id(&self) -> Option<FileId> {
        self.source.file_id()
    }
}

/// Reader of a range of a source.
pub struct Column {
    source: Arc<dyn ByteSource>,
    start: u64,
    at: u64,
    end: u64,
    block: Vec<u8>,
    used: usize,
}

impl Column {
    /// Reads up to `len` bytes from `start` on, fewer if the source ends before.
    pub fn new(source: &Arc<dyn ByteSource>, start: u64, len: u64) -> Self {
        let end = start.saturating_add(len).min(source.len()).max(start);
        Self { source: source.clone(), start, at: start, end, block: Vec::new(), used: 0 }
    }

    /// Reads a source from `start` to its end.
    pub fn rest(source: &Arc<dyn ByteSource>, start: u64) -> Self {
        Self::new(source, start, u64::MAX)
    }
}

impl BufRead for Column {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.used == self.block.len() {
            let len = self.end.saturating_sub(self.at).min(BLOCK_BYTES);
            self.block.resize(len as usize, 0);
            self.used = 0;
            if let Err(error) = self.source.read_at(self.at, &mut self.block) {
                self.block.clear();
                return Err(io::Error::other(error));
            }
            self.at += len;
        }
        Ok(&self.block[self.used..])
    }

    fn consume(&mut self, amount: usize) {
        self.used = (self.used + amount).min(self.block.len());
    }
}

impl Read for Column {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let there = self.fill_buf()?;
        let len = there.len().min(buf.len());
        buf[..len].copy_from_slice(&there[..len]);
        self.consume(len);
        Ok(len)
    }
}

impl Seek for Column {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let now = self.at - (self.block.len() - self.used) as u64;
        let place = match to {
            SeekFrom::Start(offset) => self.start.checked_add(offset),
            SeekFrom::Current(step) => now.checked_add_signed(step),
            SeekFrom::End(step) => self.end.checked_add_signed(step),
        };
        let place = place.filter(|place| *place >= self.start).ok_or(io::ErrorKind::InvalidInput)?;
        let first = self.at - self.block.len() as u64;
        if (first..=self.at).contains(&place) {
            self.used = (place - first) as usize;
        } else {
            (self.at, self.used) = (place, 0);
            self.block.clear();
        }
        Ok(place - self.start)
    }
}

/// Turns an error of reading, decompressing or decoding into an error about the file.
pub fn read_error(path: &Path, at: impl Into<String>, error: io::Error) -> Error {
    let kind = error.kind();
    match error.downcast::<Error>() {
        Ok(own) => own,
        Err(_) if kind == io::ErrorKind::UnexpectedEof => {
            Error::input(path, at, "the data end before their stated length: the file is cut; fetch it again")
        }
        Err(error) => Error::input(path, at, format!("damaged data ({error}); fetch or write it again")),
    }
}

/// Parses the JSON of a whole source.
pub fn json<T: serde::de::DeserializeOwned>(source: &Arc<dyn ByteSource>, path: &Path) -> Result<T> {
    if source.len() > MOST_JSON {
        let found = slicewalk_base::text::file_size(source.len());
        return Err(Error::input(path, "JSON", format!("expected at most 256 MiB, found {found}")));
    }
    let mut reader = Column::rest(source, 0);
    let start = reader.fill_buf().map_err(|e| read_error(path, "JSON", e))?;
    if start.starts_with(BYTE_ORDER_MARK) {
        reader.consume(BYTE_ORDER_MARK.len());
    }
    serde_json::from_reader(reader).map_err(|e| Error::input(path, "JSON", format!("{e}; fetch or write it again")))
}

/// Returns the path of a file next to `path`; an error if `name` leads out of that folder.
pub fn beside(path: &Path, name: &str) -> Result<std::path::PathBuf> {
    let inner = Path::new(name);
    let normal = |part| matches!(part, std::path::Component::Normal(_) | std::path::Component::CurDir);
    if name.is_empty() || name.contains(['\\', ':']) || !inner.components().all(normal) {
        let name = slicewalk_base::text::one_line(name).into_owned();
        return Err(Error::input(path, "files", format!("\"{name}\" lies outside its folder; put the file there")));
    }
    Ok(path.with_file_name(inner))
}
