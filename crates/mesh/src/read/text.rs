//! Lines and words of text formats, of bounded length.

use super::watch::{Digest, MeshSource};
use crate::input::number::decimal;
use crate::text::{BYTE_ORDER_MARK, shown};
use crate::{Error, Result};
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Longest line (bytes).
const MOST_BYTES: u64 = 1 << 20;

/// Returns whether only zeros and blanks follow.
pub(super) fn only_padding(reader: &mut impl BufRead) -> io::Result<bool> {
    loop {
        let bytes = reader.fill_buf()?;
        let len = bytes.len();
        if len == 0 || !bytes.iter().all(|byte| *byte == 0 || byte.is_ascii_whitespace()) {
            return Ok(len == 0);
        }
        reader.consume(len);
    }
}

/// Reads a file word by word and keeps the line number. Lines end with LF, CR LF or CR.
pub(super) struct Words {
    reader: BufReader<MeshSource>,
    path: PathBuf,
    /// Number of the line of the word.
    number: u64,
    word: Vec<u8>,
    is_first: bool,
    /// True if the last byte read is a CR, so that a LF ends no other line.
    is_behind_return: bool,
}

impl Words {
    pub(super) fn new(reader: BufReader<MeshSource>, path: &Path) -> Self {
        let path = path.to_path_buf();
        Self { reader, path, number: 1, word: Vec::new(), is_first: false, is_behind_return: false }
    }

    /// Advances to the next word; returns false at the end of the file.
    pub(super) fn next(&mut self) -> Result<bool> {
        self.word.clear();
        self.is_first = false;
        loop {
            let bytes = self.reader.fill_buf();
            let bytes = bytes.map_err(|e| Error::io(&self.path, format!("read line {}", self.number), e))?;
            if bytes.is_empty() {
                return Ok(!self.word.is_empty());
            }
            let is_begun = !self.word.is_empty();
            let begin = bytes.iter().position(|byte| is_begun || !byte.is_ascii_whitespace()).unwrap_or(bytes.len());
            let (blanks, rest) = bytes.split_at(begin);
            for &byte in blanks {
                let ends_line = byte == b'\r' || byte == b'\n' && !self.is_behind_return;
                self.number += u64::from(ends_line);
                self.is_first |= ends_line;
                self.is_behind_return = byte == b'\r';
            }
            let len = rest.iter().position(u8::is_ascii_whitespace);
            let part = &rest[..len.unwrap_or(rest.len())];
            if (self.word.len() + part.len()) as u64 > MOST_BYTES {
                return Err(self
                    .error(format!("a word of more than {MOST_BYTES} bytes: the file is not text, or it is damaged")));
            }
            self.word.extend_from_slice(part);
            self.is_behind_return &= self.word.is_empty();
            let read = begin + part.len();
            self.reader.consume(read);
            if len.is_some() {
                return Ok(true);
            }
        }
    }

    /// Returns the word.
    pub(super) fn word(&self) -> &[u8] {
        &self.word
    }

    /// Returns whether a line ended before the word.
    pub(super) fn is_first(&self) -> bool {
        self.is_first
    }

    /// Parses the next three words as a position; `None` if the file ends before.
    pub(super) fn corner(&mut self) -> Result<Option<[f64; 3]>> {
        let mut corner = [0.0; 3];
        for value in &mut corner {
            if !self.next()? {
                return Ok(None);
            }
            let unclear = || self.error(format!("expected a number, found {}", shown(&self.word)));
            *value = decimal(&self.word, false).ok_or_else(unclear)?;
        }
        Ok(Some(corner))
    }

    /// Returns an error at the line of the word.
    pub(super) fn error(&self, reason: impl Into<String>) -> Error {
        Error::input(&self.path, format!("line {}", self.number), reason)
    }
}

/// Reads a file line by line and keeps the line number. Lines end with LF, CR LF or CR.
pub(super) struct Lines {
    reader: BufReader<MeshSource>,
    path: PathBuf,
    number: u64,
    line: Vec<u8>,
    /// Offset in the line from which the next word is searched.
    at: usize,
    /// True if a backslash at the end of a line without a comment continues it on the next.
    continued: bool,
    /// True if the first line ends with CR alone. Then a LF belongs to no CR before it, and may begin a binary body.
    returns: bool,
}

impl Lines {
    pub(super) fn open(path: &Path, continued: bool, digest: &Digest) -> Result<Self> {
        Ok(Self::new(BufReader::with_capacity(1 << 18, MeshSource::open(path, digest)?), path, continued))
    }

    pub(super) fn new(reader: BufReader<MeshSource>, path: &Path, continued: bool) -> Self {
        Self { reader, path: path.to_path_buf(), number: 0, line: Vec::new(), at: 0, continued, returns: false }
    }

    /// Returns the reader, positioned after the last line read.
    pub(super) fn into_reader(self) -> BufReader<MeshSource> {
        self.reader
    }

    /// Advances to the next line; returns false at the end of the file. Callers skip comments, which begin with `#`.
    pub(super) fn next(&mut self) -> Result<bool> {
        self.line.clear();
        self.at = 0;
        loop {
            self.number += 1;
            let (begin, is_ended) = (self.line.len(), self.read_line()?);
            if !is_ended && self.line.len() == begin {
                return Ok(!self.line.is_empty());
            }
            if self.number == 1 && self.line.starts_with(BYTE_ORDER_MARK) {
                self.line.drain(..BYTE_ORDER_MARK.len());
            }
            // Looks only at what is new: a comment before would have ended the line.
            let has_comment = || self.line[begin..].split(u8::is_ascii_whitespace).any(|word| word.starts_with(b"#"));
            // A comment may end with a backslash, as paths of Windows do.
            if !self.continued || self.line.last() != Some(&b'\\') || has_comment() {
                return Ok(true);
            }
            *self.line.last_mut().unwrap_or(&mut 0) = b' ';
        }
    }

    /// Appends the bytes up to the end of a line; returns false if the file ends first.
    fn read_line(&mut self) -> Result<bool> {
        let Self { reader, path, number, line, returns, .. } = self;
        let io = |e| Error::io(&*path, format!("read line {number}"), e);
        loop {
            let bytes = reader.fill_buf().map_err(io)?;
            let end = memchr::memchr2(b'\n', b'\r', bytes);
            let len = end.unwrap_or(bytes.len());
            if (line.len() + len) as u64 > MOST_BYTES {
                return Err(self
                    .error(format!("a line of more than {MOST_BYTES} bytes: the file is not text, or it is damaged")));
            }
            line.extend_from_slice(&bytes[..len]);
            let is_return = end.is_some_and(|end| bytes[end] == b'\r');
            reader.consume(len + usize::from(end.is_some()));
            if is_return {
                let is_pair = reader.fill_buf().map_err(io)?.first() == Some(&b'\n');
                *returns |= *number == 1 && !is_pair;
                reader.consume(usize::from(is_pair && !*returns));
            }
            if end.is_some() || len == 0 {
                return Ok(end.is_some());
            }
        }
    }

    /// Returns the line without its terminator.
    pub(super) fn line(&self) -> &[u8] {
        &self.line
    }

    pub(super) fn number_of_line(&self) -> u64 {
        self.number
    }

    /// Returns whether the line is the last.
    pub(super) fn is_at_end(&mut self) -> Result<bool> {
        let left = self.reader.fill_buf().map_err(|e| Error::io(&self.path, "read a line", e))?;
        Ok(left.is_empty())
    }

    /// Returns the words of the line that [`next_number`](Self::next_number) has not consumed.
    pub(super) fn rest(&self) -> impl Iterator<Item = &[u8]> {
        let rest = self.line.get(self.at..).unwrap_or_default();
        rest.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
    }

    /// Returns the words of the line.
    pub(super) fn words(&self) -> impl Iterator<Item = &[u8]> + Clone {
        self.line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
    }

    /// Advances to the next word of the line.
    fn next_word(&mut self) -> Option<std::ops::Range<usize>> {
        let rest = self.line.get(self.at..)?;
        let begin = self.at + rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let len = self.line[begin..].iter().position(u8::is_ascii_whitespace);
        self.at = len.map_or(self.line.len(), |len| begin + len);
        Some(begin..self.at)
    }

    /// Parses the next word of the line as a number. Visits each word once, however long the line.
    pub(super) fn next_number(&mut self) -> Result<f64> {
        let word = self.next_word();
        self.number(word.map(|word| &self.line[word]))
    }

    /// Returns an error at this line.
    pub(super) fn error(&self, reason: impl Into<String>) -> Error {
        Error::input(&self.path, format!("line {}", self.number), reason)
    }

    /// Parses a word of the line as a number.
    pub(super) fn number(&self, word: Option<&[u8]>) -> Result<f64> {
        let word = word.ok_or_else(|| self.error("expected a number, found the end of the line"))?;
        decimal(word, false).ok_or_else(|| self.error(format!("expected a number, found {}", shown(word))))
    }

    /// Parses three words of the line as a position.
    pub(super) fn corner<'a>(&self, words: &mut impl Iterator<Item = &'a [u8]>) -> Result<[f64; 3]> {
        Ok([self.number(words.next())?, self.number(words.next())?, self.number(words.next())?])
    }
}
