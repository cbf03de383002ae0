//! Bytes of a file from front to back, in blocks of 1 MiB, and parts of a file as sources of their own.

use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::BYTE_ORDER_MARK;
use slicewalk_base::{Error, Parameter, Result};
use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// Bytes read at once.
const BLOCK_BYTES: u64 = 1 << 20;
/// Most bytes of JSON: a set of levels has thousands of nodes, and a glTF may hold its values as text.
const MOST_JSON: u64 = 256 << 20;
/// Share of the memory that the structure of JSON may have: a byte of it becomes up to 50 in memory.
const STRUCTURE_SHARE: u64 = 8;

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
            // Also a place behind the end has nothing, which sources refuse.
            if len > 0
                && let Err(error) = self.source.read_at(self.at, &mut self.block)
            {
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

/// Reader of JSON that fails if there is too much outside of its strings.
struct Structure<'a> {
    column: Column,
    path: &'a Path,
    /// Bytes of structure that may be there in all, and that may follow.
    most: u64,
    left: u64,
    in_string: bool,
    is_escaped: bool,
}

impl Read for Structure<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let len = self.column.read(buf)?;
        for &byte in &buf[..len] {
            match byte {
                _ if self.is_escaped => self.is_escaped = false,
                b'\\' => self.is_escaped = self.in_string,
                b'"' => self.in_string = !self.in_string,
                _ if self.in_string || byte.is_ascii_whitespace() => {}
                _ if self.left == 0 => {
                    // Not damage, which may be left out: an archive does not depend on the memory.
                    let what = format!("{}: memory for the structure of its JSON", self.path.display());
                    let most = slicewalk_base::text::memory_size(self.most);
                    let error = Error::limit(what, format!("more than {most}"), most);
                    return Err(io::Error::other(error.with_suggestion(Parameter::Memory)));
                }
                _ => self.left -= 1,
            }
        }
        Ok(len)
    }
}

/// Parses the JSON of a whole source. Its text takes at most `memory` bytes.
pub fn json<T: serde::de::DeserializeOwned>(source: &Arc<dyn ByteSource>, path: &Path, memory: u64) -> Result<T> {
    if source.len() > MOST_JSON {
        let found = slicewalk_base::text::file_size(source.len());
        return Err(Error::input(path, "JSON", format!("expected at most 256 MiB, found {found}")));
    }
    if source.len() > memory {
        return Err(super::too_large(path, "its JSON", source.len(), memory));
    }
    let mut reader = Column::rest(source, 0);
    let start = reader.fill_buf().map_err(|e| read_error(path, "JSON", e))?;
    if start.starts_with(BYTE_ORDER_MARK) {
        reader.consume(BYTE_ORDER_MARK.len());
    }
    let most = memory / STRUCTURE_SHARE;
    let reader = Structure { column: reader, path, most, left: most, in_string: false, is_escaped: false };
    serde_json::from_reader(reader).map_err(|e| match e.is_io() {
        true => read_error(path, "JSON", e.into()),
        false => Error::input(path, "JSON", format!("{e}; fetch or write it again")),
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk_base::bytes::MemorySource;
    use std::io::Cursor;

    #[test]
    fn a_column_reads_and_seeks_like_the_bytes_it_shows() {
        let all: Vec<u8> = (0..3_000_000u32).map(|i| ((i * 7) >> 3) as u8).collect();
        let shown = &all[1000..2_900_000];
        let source: Arc<dyn ByteSource> = Arc::new(MemorySource::new(&all[..]));
        let mut column = Column::new(&source, 1000, shown.len() as u64);
        let mut cursor = Cursor::new(shown);
        for (to, take) in [
            (SeekFrom::Start(5), 3),
            (SeekFrom::Current(1_500_000), 70_000),
            (SeekFrom::Current(-60_000), 1),
            (SeekFrom::Start(0), 2),
            (SeekFrom::End(-1_000_001), 1_000_000),
            (SeekFrom::End(-7), 7),
        ] {
            assert_eq!(column.seek(to).unwrap(), cursor.seek(to).unwrap());
            let (mut a, mut b) = (vec![0; take], vec![0; take]);
            column.read_exact(&mut a).unwrap();
            cursor.read_exact(&mut b).unwrap();
            assert!(a == b, "{to:?}");
        }
        assert_eq!(column.read(&mut [0; 3]).unwrap(), 0);
        for before in [SeekFrom::End(-(shown.len() as i64) - 1), SeekFrom::Current(i64::MIN)] {
            assert_eq!(column.seek(before).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        }
        column.seek(SeekFrom::Start(1 << 40)).unwrap();
        assert_eq!(column.read(&mut [0; 3]).unwrap(), 0);
    }

    /// Blanks without end.
    struct Long;

    impl ByteSource for Long {
        fn len(&self) -> u64 {
            (256 << 20) + 1
        }

        fn read_at(&self, _: u64, buf: &mut [u8]) -> Result<()> {
            buf.fill(b' ');
            Ok(())
        }
    }

    #[test]
    fn json_that_is_too_long_is_refused_and_a_mark_before_it_is_skipped() {
        let of = |source: Arc<dyn ByteSource>| json::<Vec<u32>>(&source, Path::new("a.json"), 1 << 30);
        let error = of(Arc::new(Long)).unwrap_err().to_string();
        assert!(error.starts_with("a.json: JSON: expected at most 256 MiB"), "{error}");
        for text in ["[1,2]", "\u{feff}[1,2]"] {
            assert_eq!(of(Arc::new(MemorySource::new(text.as_bytes()))).unwrap(), [1, 2]);
        }
    }

    /// Strings take their length in memory, what is around them takes more.
    #[test]
    fn json_takes_no_more_than_its_memory() {
        let of = |text: &str, memory: u64| {
            let source: Arc<dyn ByteSource> = Arc::new(MemorySource::new(text.as_bytes()));
            json::<Vec<String>>(&source, Path::new("a.json"), memory).map_err(|error| error.to_string())
        };
        let text = r#"["{}\"[]\\ 1234567890 1234567890", ""]"#;
        let len = text.len() as u64;
        assert_eq!(of(text, len).unwrap(), [r#"{}"[]\ 1234567890 1234567890"#, ""]);
        let error = of(text, len - 1).unwrap_err();
        assert!(error.starts_with("a.json: memory for its JSON") && error.contains("more memory"), "{error}");
        let error = of(r#"["a","b","c","d"]"#, 32).unwrap_err();
        assert!(
            error.starts_with("a.json: memory for the structure of its JSON") && error.contains("more memory"),
            "{error}"
        );
    }
}
