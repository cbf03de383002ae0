//! Lines of a text, from any byte on, as it is or compressed.
//!
//! Memory: a block of 256 KiB and one line; of compressed text the window of its decoder, at most 8 MiB.

use super::super::shown;
use crate::input::source::{Source, Window};
use crate::{Error, Monitor, Result};
use std::io::{self, Read};
use std::path::Path;

/// Bytes read at once.
const BLOCK_BYTES: usize = 1 << 18;
/// Longest line (bytes).
const MOST_LINE: usize = 1 << 16;
/// Largest window of zstd, as a power of two: what its levels use, but for `--ultra` and `--long`.
const MOST_WINDOW_LOG: u32 = 23;
/// Beyond this many bytes an error names the byte and not the line.
const COUNTED: u64 = 1 << 28;

/// How a text is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::input::cloud) enum Packing {
    Plain,
    Gzip,
    Zstd,
}

impl Packing {
    /// By the first bytes of the file.
    pub fn of(source: &Source) -> Result<Self> {
        let mut magic = [0; 4];
        let got = source.read_at(&mut magic, 0)?;
        Ok(match &magic[..got] {
            [0x1F, 0x8B, ..] => Self::Gzip,
            [0x28, 0xB5, 0x2F, 0xFD] => Self::Zstd,
            _ => Self::Plain,
        })
    }
}

/// Name of a file without the ending of its compression.
pub(in crate::input) fn unpacked_name(path: &Path) -> &Path {
    let is_packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz") || e.eq_ignore_ascii_case("zst"));
    path.file_stem().filter(|_| is_packed).map_or(path, Path::new)
}

enum Input<'a> {
    Plain,
    Packed(Box<dyn Read + 'a>),
}

/// Hands out line after line.
pub(in crate::input::cloud) struct Lines<'a> {
    source: &'a Source,
    input: Input<'a>,
    block: Vec<u8>,
    /// What of the block comes next.
    next: usize,
    /// Place of the block in the text.
    at: u64,
    ended: bool,
    /// Where reading began, and lines since.
    start: u64,
    number: u64,
}

impl<'a> Lines<'a> {
    /// The lines of a plain text from a byte on.
    pub fn begin(source: &'a Source, start: u64) -> Self {
        Self { source, input: Input::Plain, block: Vec::new(), next: 0, at: start, ended: false, start, number: 0 }
    }

    /// All lines of a text of `bytes` bytes as it is stored.
    pub fn open(source: &'a Source, bytes: u64, packing: Packing) -> Result<Self> {
        let window = Window::new(source, 0, bytes);
        let failed = |e| Error::io(source.path(), "unpack it", e);
        let input: Box<dyn Read + 'a> = match packing {
            Packing::Plain => return Ok(Self::begin(source, 0)),
            Packing::Gzip => Box::new(flate2::read::MultiGzDecoder::new(window)),
            Packing::Zstd => {
                let mut decoder = zstd::stream::read::Decoder::new(window).map_err(failed)?;
                decoder.window_log_max(MOST_WINDOW_LOG).map_err(failed)?;
                Box::new(decoder)
            }
        };
        Ok(Self { input: Input::Packed(input), ..Self::begin(source, 0) })
    }

    /// Place in the text of the next line.
    pub fn position(&self) -> u64 {
        self.at + self.next as u64
    }

    fn fill(&mut self) -> Result<()> {
        self.block.drain(..self.next);
        self.at += self.next as u64;
        self.next = 0;
        let held = self.block.len();
        let at = self.at + held as u64;
        let room = match self.input {
            // A short file needs no long block.
            Input::Plain => self.source.stamp().len().saturating_sub(at).min(BLOCK_BYTES as u64) as usize,
            Input::Packed(_) => BLOCK_BYTES,
        };
        self.block.resize(held + room, 0);
        let out = &mut self.block[held..];
        let got = match &mut self.input {
            Input::Plain => self.source.read_at(out, at)?,
            Input::Packed(input) => loop {
                match input.read(out) {
                    Ok(got) => break got,
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => {
                        let reason = format!("cannot be unpacked: {error}; fetch or write it again");
                        return Err(Error::input(self.source.path(), format!("byte {at} of its text"), reason));
                    }
                }
            },
        };
        self.block.truncate(held + got);
        self.ended = got == 0;
        Ok(())
    }

    /// Where the next line lies in the block; what follows it comes next.
    fn find(&mut self) -> Result<Option<std::ops::Range<usize>>> {
        let mut searched = self.next;
        loop {
            let found = memchr::memchr(b'\n', &self.block[searched..]);
            let end = match found {
                Some(len) => searched + len,
                None if self.ended && self.next < self.block.len() => self.block.len(),
                None if self.ended => return Ok(None),
                None if self.block.len() - self.next > MOST_LINE => self.block.len(),
                None => {
                    searched = self.block.len() - self.next;
                    self.fill()?;
                    continue;
                }
            };
            let line = self.next..end;
            self.number += 1;
            if line.len() > MOST_LINE {
                return Err(self.error(format!("a line of more than {MOST_LINE} bytes: this is no text, or damaged")));
            }
            self.next = self.block.len().min(end + 1);
            return Ok(Some(line));
        }
    }

    /// Goes to the next line: its place in the text, and its bytes.
    pub fn next(&mut self) -> Result<Option<(u64, &[u8])>> {
        let Some(line) = self.find()? else { return Ok(None) };
        Ok(Some((self.at + line.start as u64, &self.block[line])))
    }

    /// Goes to the next line that is neither empty nor a comment.
    pub fn next_row(&mut self) -> Result<Option<(u64, &[u8])>> {
        Ok(self.next_place()?.map(|(at, line)| (at, &self.block[line])))
    }

    /// As [`next_row`](Self::next_row); [`at`](Self::at) has the bytes of the line.
    pub fn next_place(&mut self) -> Result<Option<(u64, std::ops::Range<usize>)>> {
        loop {
            let Some(line) = self.find()? else { return Ok(None) };
            if is_row(&self.block[line.clone()]) {
                return Ok(Some((self.at + line.start as u64, line)));
            }
        }
    }

    /// The bytes of the line handed out last.
    pub fn at(&self, line: std::ops::Range<usize>) -> &[u8] {
        &self.block[line]
    }

    /// The next row, as a line of its own.
    pub fn row(&mut self) -> Result<Option<Vec<u8>>> {
        Ok(self.next_row()?.map(|(_, line)| line.to_vec()))
    }

    /// The first row behind a place, without going there.
    pub fn peek(&self) -> Result<Option<Vec<u8>>> {
        match self.input {
            Input::Plain => Self::begin(self.source, self.position()).row(),
            Input::Packed(_) => Ok(None),
        }
    }

    /// Passes over up to `most` rows and, if asked for, stops before one of a single word; returns how many there were.
    pub fn count_rows(&mut self, most: u64, stop_at_word: bool, monitor: &dyn Monitor) -> Result<u64> {
        let mut rows = 0u64;
        while rows < most {
            if rows.is_multiple_of(1 << 16) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let Some(line) = self.find()? else { break };
            let text = &self.block[line.clone()];
            if !is_row(text) {
                continue;
            }
            if stop_at_word && is_word(text) {
                self.next = line.start;
                self.number -= 1;
                break;
            }
            rows += 1;
        }
        Ok(rows)
    }

    /// An error at the line handed out last.
    pub fn error(&self, reason: impl Into<String>) -> Error {
        let before = match self.input {
            Input::Plain if self.start > 0 && self.start <= COUNTED => self.lines_before().ok(),
            Input::Plain if self.start > COUNTED => None,
            _ => Some(0),
        };
        let at = match before {
            Some(before) => format!("line {}", before + self.number),
            None => format!("line {} from byte {} on", self.number, self.start),
        };
        Error::input(self.source.path(), at, reason)
    }

    fn lines_before(&self) -> Result<u64> {
        let (mut at, mut lines, mut block) = (0, 0, vec![0; BLOCK_BYTES]);
        while at < self.start {
            let want = (self.start - at).min(BLOCK_BYTES as u64) as usize;
            let got = self.source.read_at(&mut block[..want], at)?;
            if got == 0 {
                break;
            }
            lines += memchr::memchr_iter(b'\n', &block[..got]).count() as u64;
            at += got as u64;
        }
        Ok(lines)
    }

    /// An error: a row should hold something else.
    pub fn expected(&self, what: &str, line: &[u8]) -> Error {
        self.error(format!("expected {what}, found {}", shown(line.trim_ascii())))
    }
}

/// Whether a line is neither empty nor a comment.
fn is_row(line: &[u8]) -> bool {
    match line {
        [b'#', ..] | [b'/', b'/', ..] | [] => false,
        [first, ..] if *first > b' ' => true,
        _ => {
            let text = line.trim_ascii_start();
            !text.is_empty() && !text.starts_with(b"#") && !text.starts_with(b"//")
        }
    }
}

/// Whether a row is one word.
pub(super) fn is_word(line: &[u8]) -> bool {
    // Longer than any number of points.
    line.len() < 32 && {
        let text = line.trim_ascii();
        !text.iter().any(|byte| byte.is_ascii_whitespace() || matches!(byte, b',' | b';'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use std::io::Write;

    fn source(bytes: &[u8]) -> (tempfile::NamedTempFile, Source) {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        let source = Source::open(file.path(), None).unwrap();
        (file, source)
    }

    fn all(mut lines: Lines<'_>) -> Result<Vec<(u64, String)>> {
        let mut found = Vec::new();
        while let Some((at, line)) = lines.next()? {
            found.push((at, String::from_utf8_lossy(line).into_owned()));
        }
        Ok(found)
    }

    #[test]
    fn lines_have_their_places_plain_and_packed() {
        let text: String = (0..60_000).map(|n| format!("{n} {}\n", "x".repeat(n % 37))).collect::<String>() + "last";
        let mut at = 0;
        let expected: Vec<(u64, String)> = text
            .split('\n')
            .map(|line| {
                at += line.len() as u64 + 1;
                (at - line.len() as u64 - 1, line.to_owned())
            })
            .collect();
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(text.as_bytes()).unwrap();
        let packed = [text.clone().into_bytes(), gzip.finish().unwrap(), zstd::encode_all(text.as_bytes(), 3).unwrap()];
        for bytes in packed {
            let (_file, source) = source(&bytes);
            let packing = Packing::of(&source).unwrap();
            assert_eq!(all(Lines::open(&source, bytes.len() as u64, packing).unwrap()).unwrap(), expected);
        }
        let (_file, source) = source(text.as_bytes());
        let from = expected[1000].0;
        assert_eq!(all(Lines::begin(&source, from)).unwrap(), expected[1000..]);
    }

    #[test]
    fn endless_lines_are_refused_and_errors_name_their_line() {
        let mut text = b"1\n\n# a comment\n  2\n".to_vec();
        text.extend(vec![b'7'; 1 << 20]);
        let (_file, source) = source(&text);
        let mut lines = Lines::begin(&source, 2);
        assert_eq!(lines.row().unwrap().unwrap(), b"  2");
        assert!(lines.error("x").to_string().contains("line 4: x"));
        let error = lines.next_row().unwrap_err().to_string();
        assert!(error.contains("line 5: a line of more than 65536 bytes"), "{error}");
    }

    #[test]
    fn rows_are_counted_up_to_a_word() {
        let (_file, source) = source(b"1 2 3\r\n\n4 5 6\n  7\n8 9 10\n");
        let mut lines = Lines::begin(&source, 0);
        assert_eq!(lines.count_rows(100, true, &NoMonitor).unwrap(), 2);
        assert_eq!(lines.row().unwrap().unwrap(), b"  7");
        assert_eq!(lines.count_rows(100, false, &NoMonitor).unwrap(), 1);
        let cut = zstd::encode_all(&b"1 2 3\n".repeat(100_000)[..], 3).unwrap();
        let (_file, source) = super::tests::source(&cut[..cut.len() / 2]);
        let error = all(Lines::open(&source, cut.len() as u64 / 2, Packing::Zstd).unwrap()).unwrap_err().to_string();
        assert!(error.contains("cannot be unpacked"), "{error}");
    }
}
