//! Lines of plain or compressed text, from any byte on.
//!
//! A line ends with a line feed, a carriage return, or both. A UTF-8 byte order mark is skipped, in plain and
//! compressed text; UTF-16 is refused. Memory: a block of 256 KiB and one line; for compressed text also the window of
//! its decoder, at most 8 MiB.

use super::super::shown;
use super::layout::Fault;
use super::whole_word;
use crate::source::{Source, Window};
use crate::unzstd::unzstd;
use crate::{Error, Monitor, Result};
use flate2::bufread::GzDecoder;
use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;
use std::path::Path;

/// Bytes read at once.
const BLOCK_BYTES: usize = 1 << 18;
/// Longest line (bytes).
pub(super) const MOST_LINE: usize = 1 << 16;
/// Largest zstd window, as a power of two: enough for all levels without `--ultra` and `--long`.
const MOST_WINDOW_LOG: u32 = 23;
/// Bytes of packed text read at once.
const PACKED_BYTES: usize = 128 << 10;
/// Beyond this offset, an error names the byte instead of the line.
const COUNTED: u64 = 1 << 28;

/// Bytes without a row after which a reader may stop.
const PAUSE_BYTES: u64 = 1 << 20;

/// Compression of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cloud) enum Packing {
    Plain,
    Gzip,
    Zstd,
}

impl Packing {
    /// Detects the compression by the first bytes of the file.
    pub fn of(source: &Source) -> Result<Self> {
        let mut magic = [0; 4];
        let got = source.read_at(&mut magic, 0)?;
        Ok(match &magic[..got] {
            [0x1F, 0x8B, ..] => Self::Gzip,
            [0x28, 0xB5, 0x2F, 0xFD] => Self::Zstd,
            // A skippable frame (RFC 8878, section 3.1.2), which other frames follow.
            [0x50..=0x5F, 0x2A, 0x4D, 0x18] => Self::Zstd,
            _ => Self::Plain,
        })
    }
}

/// Returns the name of a file without the extension of its compression.
pub fn unpacked_name(path: &Path) -> &Path {
    let is_packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz") || e.eq_ignore_ascii_case("zst"));
    path.file_stem().filter(|_| is_packed).map_or(path, Path::new)
}

/// Members of a gzip file, one after the other; `None` behind the last. Zeros behind one are padding, as in the program
/// gzip.
struct Members<'a>(Option<GzDecoder<BufReader<Window<'a>>>>);

impl Read for Members<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        while let Some(member) = &mut self.0 {
            let read = member.read(buf)?;
            if read > 0 || buf.is_empty() {
                return Ok(read);
            }
            let has_more = pass_zeros(member.get_mut())?;
            self.0 = self.0.take().filter(|_| has_more).map(|member| GzDecoder::new(member.into_inner()));
        }
        Ok(0)
    }
}

/// Skips zeros; returns whether other bytes follow.
fn pass_zeros(packed: &mut impl BufRead) -> io::Result<bool> {
    loop {
        let held = packed.fill_buf()?;
        let (zeros, len) = (held.iter().take_while(|byte| **byte == 0).count(), held.len());
        packed.consume(zeros);
        if zeros < len || len == 0 {
            return Ok(len > 0);
        }
    }
}

enum Input<'a> {
    Plain,
    Packed(Box<dyn Read + 'a>),
}

/// Next item when a text is read for its rows.
pub(in crate::cloud) enum Step {
    /// A row: its offset in the text, and its range in the block.
    Row(u64, Range<usize>),
    /// A line at this offset that is too long for a row.
    TooLong(u64),
    /// No row for some time.
    Pause,
}

/// A line: its offset in the text, and its bytes; `None` if they are too many.
type Line<'a> = (u64, Option<&'a [u8]>);

/// Reads a text line by line.
pub(in crate::cloud) struct Lines<'a> {
    source: &'a Source,
    input: Input<'a>,
    /// Asked for cancellation with each block.
    monitor: Option<&'a dyn Monitor>,
    block: Vec<u8>,
    /// Position of the next line in the block.
    next: usize,
    /// Offset of the block in the text.
    at: u64,
    ended: bool,
    /// The last line returned was too long; its rest must be skipped.
    is_within: bool,
    /// Offset where reading began; `number`: lines since.
    start: u64,
    number: u64,
}

impl<'a> Lines<'a> {
    /// Reads the lines of a plain text from a byte on.
    pub fn begin(source: &'a Source, start: u64) -> Self {
        Self {
            source,
            input: Input::Plain,
            monitor: None,
            block: Vec::new(),
            next: 0,
            at: start,
            ended: false,
            is_within: false,
            start,
            number: 0,
        }
    }

    /// Reads the lines of a plain text that begin after byte `start`, or from some offset beyond `until`.
    pub fn begin_behind(source: &'a Source, start: u64, until: u64) -> Result<Self> {
        let mut lines = Self { number: 1, ..Self::begin(source, start) };
        lines.pass_line(until)?;
        Ok(lines)
    }

    /// Reads all lines of a file of `bytes` bytes, after its byte order mark; fails for UTF-16.
    pub fn open(source: &'a Source, bytes: u64, packing: Packing, monitor: Option<&'a dyn Monitor>) -> Result<Self> {
        let window = Window::new(source, 0, bytes);
        let failed = |e| Error::io(source.path(), "unpack it", e);
        let packed = || BufReader::with_capacity(PACKED_BYTES, window);
        let input = match packing {
            Packing::Plain => Input::Plain,
            Packing::Gzip => Input::Packed(Box::new(Members(Some(GzDecoder::new(packed()))))),
            Packing::Zstd => Input::Packed(unzstd(packed(), MOST_WINDOW_LOG).map_err(failed)?),
        };
        let mut lines = Self { input, monitor, ..Self::begin(source, 0) };
        lines.fill()?;
        match lines.block[..] {
            [0xEF, 0xBB, 0xBF, ..] => lines.next = 3,
            // A byte order mark, or an ASCII character in UTF-16 without one.
            [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] | [0, _, ..] | [_, 0, ..] => {
                return Err(Error::input(source.path(), "byte 0", "text in UTF-16; save it as UTF-8"));
            }
            _ => {}
        }
        Ok(lines)
    }

    /// Returns the number of the last line returned, from 1.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Returns the offset of the next line in the text.
    pub fn position(&self) -> u64 {
        self.at + self.next as u64
    }

    fn fill(&mut self) -> Result<()> {
        if self.monitor.is_some_and(Monitor::cancelled) {
            return Err(Error::Interrupted);
        }
        self.block.drain(..self.next);
        self.at += self.next as u64;
        self.next = 0;
        let held = self.block.len();
        let at = self.at + held as u64;
        let room = match self.input {
            // A short file needs no full block.
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

    /// Returns the range of the next line in the block, and whether it is whole, and advances past it.
    fn find_any(&mut self) -> Result<Option<(Range<usize>, bool)>> {
        if self.is_within {
            self.pass_line(u64::MAX)?;
        }
        let mut searched = self.next;
        loop {
            let found = memchr::memchr2(b'\n', b'\r', &self.block[searched..]).map(|len| searched + len);
            // The byte after a carriage return shows whether a line feed belongs to it.
            let is_open = |end: usize| self.block[end] == b'\r' && end + 1 == self.block.len() && !self.ended;
            let end = match found {
                Some(end) if !is_open(end) => end,
                None if self.ended && self.next < self.block.len() => self.block.len(),
                None if self.ended => return Ok(None),
                None if self.block.len() - self.next > MOST_LINE => self.block.len(),
                more => {
                    searched = more.unwrap_or(self.block.len()) - self.next;
                    self.fill()?;
                    continue;
                }
            };
            let line = self.next..end;
            self.number += 1;
            let is_whole = line.len() <= MOST_LINE;
            self.is_within = !is_whole && found.is_none();
            let is_pair = self.block[end..].starts_with(b"\r\n");
            self.next = self.block.len().min(end + if is_pair { 2 } else { 1 });
            return Ok(Some((line, is_whole)));
        }
    }

    /// Returns the range of the next line in the block and advances past it; fails if the line is too long.
    fn find(&mut self) -> Result<Option<Range<usize>>> {
        match self.find_any()? {
            Some((_, false)) => Err(self.error(Fault::too_long().reason)),
            found => Ok(found.map(|(line, _)| line)),
        }
    }

    /// Advances past the next line end, however far away, or to some offset beyond `until`.
    fn pass_line(&mut self, until: u64) -> Result<()> {
        self.is_within = false;
        loop {
            match memchr::memchr2(b'\n', b'\r', &self.block[self.next..]).map(|len| self.next + len) {
                Some(end) if self.block[end] == b'\n' || end + 1 < self.block.len() || self.ended => {
                    let is_pair = self.block[end..].starts_with(b"\r\n");
                    self.next = end + if is_pair { 2 } else { 1 };
                    return Ok(());
                }
                Some(end) => self.next = end,
                None => self.next = self.block.len(),
            }
            if self.ended || self.position() >= until {
                return Ok(());
            }
            self.fill()?;
        }
    }

    /// Returns the next line.
    pub fn next(&mut self) -> Result<Option<Line<'_>>> {
        let Some((line, is_whole)) = self.find_any()? else { return Ok(None) };
        Ok(Some((self.at + line.start as u64, is_whole.then_some(&self.block[line]))))
    }

    /// Returns the next line that is neither empty nor a comment.
    pub fn next_row(&mut self) -> Result<Option<(u64, &[u8])>> {
        loop {
            let Some(line) = self.find()? else { return Ok(None) };
            if is_row(&self.block[line.clone()]) {
                return Ok(Some((self.at + line.start as u64, &self.block[line])));
            }
        }
    }

    /// Like [`next_row`](Self::next_row), but continues after lines that are too long, and returns `Pause` if no row
    /// comes for long. [`at`](Self::at) returns the bytes of the row.
    pub fn step(&mut self) -> Result<Option<Step>> {
        let from = self.position();
        loop {
            let Some((line, is_whole)) = self.find_any()? else { return Ok(None) };
            let place = self.at + line.start as u64;
            if !is_whole {
                return Ok(Some(Step::TooLong(place)));
            }
            if is_row(&self.block[line.clone()]) {
                return Ok(Some(Step::Row(place, line)));
            }
            if place - from > PAUSE_BYTES {
                return Ok(Some(Step::Pause));
            }
        }
    }

    /// Returns the bytes of the line returned last.
    pub fn at(&self, line: Range<usize>) -> &[u8] {
        &self.block[line]
    }

    /// Returns a copy of the next row.
    pub fn row(&mut self) -> Result<Option<Vec<u8>>> {
        Ok(self.next_row()?.map(|(_, line)| line.to_vec()))
    }

    /// Returns a copy of the next row without advancing; `None` if it is too long or far away, and for compressed text.
    pub fn peek(&self) -> Result<Option<Vec<u8>>> {
        match self.input {
            Input::Plain => {
                let mut lines = Self::begin(self.source, self.position());
                Ok(match lines.step()? {
                    Some(Step::Row(_, line)) => Some(lines.at(line).to_vec()),
                    _ => None,
                })
            }
            Input::Packed(_) => Ok(None),
        }
    }

    /// Skips up to `most` rows and returns how many there were; if requested, stops before a row of a single whole
    /// number.
    pub fn count_rows(&mut self, most: u64, stop_at_number: bool, monitor: &dyn Monitor) -> Result<u64> {
        self.keep_rows(most, stop_at_number, (0, |_| false), monitor).map(|(rows, _)| rows)
    }

    /// Like [`count_rows`](Self::count_rows), but also returns `keep` rows: the first, and those behind it for which
    /// `is_wanted` is true.
    pub fn keep_rows(
        &mut self,
        most: u64,
        stop_at_number: bool,
        (keep, is_wanted): (usize, fn(&[u8]) -> bool),
        monitor: &dyn Monitor,
    ) -> Result<(u64, Vec<Vec<u8>>)> {
        let mut kept = Vec::new();
        let mut rows = 0u64;
        while rows < most {
            if self.number.is_multiple_of(1 << 16) && monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            // A line that is too long counts as a row and is refused when it is read.
            let Some((line, is_whole)) = self.find_any()? else { break };
            let text = &self.block[line.clone()];
            if !is_row(text) {
                continue;
            }
            if stop_at_number && is_whole && whole_word(text).is_some() {
                self.next = line.start;
                self.number -= 1;
                break;
            }
            if is_whole && kept.len() < keep && (kept.is_empty() || is_wanted(text)) {
                kept.push(text.to_vec());
            }
            rows += 1;
        }
        Ok((rows, kept))
    }

    /// Creates an error about the line returned last.
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
        let mut is_behind_return = false;
        // One byte more: a line feed there belongs to the carriage return before.
        while at <= self.start {
            let want = (self.start - at + 1).min(BLOCK_BYTES as u64) as usize;
            let got = self.source.read_at(&mut block[..want], at)?;
            for end in memchr::memchr2_iter(b'\n', b'\r', &block[..got]) {
                let behind = if end == 0 { is_behind_return } else { block[end - 1] == b'\r' };
                let is_pair = block[end] == b'\n' && behind;
                let is_last = at + end as u64 == self.start;
                lines = match is_pair {
                    true if is_last => lines - 1,
                    false if !is_last => lines + 1,
                    _ => lines,
                };
            }
            is_behind_return = got > 0 && block[got - 1] == b'\r';
            at += got as u64;
            if got < want {
                break;
            }
        }
        Ok(lines)
    }

    /// Creates an error about a row with unexpected content.
    pub fn expected(&self, what: &str, line: &[u8]) -> Error {
        self.error(format!("expected {what}, found {}", shown(line.trim_ascii())))
    }
}

/// Describes the line of a text that contains byte `at`.
pub(super) fn number_at(source: &Source, packing: Packing, at: u64) -> Result<String> {
    match packing {
        Packing::Plain if at <= COUNTED => {
            let before = Lines::begin(source, at).lines_before()?;
            Ok(format!("line {}", before + 1))
        }
        _ => Ok(format!("byte {at} of its text")),
    }
}

/// Returns whether a line is neither empty nor a comment.
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

/// Returns whether a row is a single word.
pub(super) fn is_word(line: &[u8]) -> bool {
    // No number of points is longer.
    line.len() < 32 && {
        let text = line.trim_ascii();
        !text.iter().any(|byte| byte.is_ascii_whitespace() || matches!(byte, b',' | b';'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slicewalk_base::NoMonitor;
    use std::io::{Seek, SeekFrom, Write};

    fn source(bytes: &[u8]) -> (tempfile::NamedTempFile, Source) {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        let source = Source::open(file.path(), None).unwrap();
        (file, source)
    }

    fn all(mut lines: Lines<'_>) -> Result<Vec<(u64, String)>> {
        let mut found = Vec::new();
        while let Some((at, line)) = lines.next()? {
            found.push((at, String::from_utf8_lossy(line.unwrap()).into_owned()));
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
        let gzip = |bytes: &[u8]| {
            let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            out.write_all(bytes).unwrap();
            out.finish().unwrap()
        };
        let (first, second) = text.as_bytes().split_at(text.len() / 2);
        let members = [&gzip(first)[..], &[0; 300_000], &gzip(second), &[0; 512]].concat();
        let frame = zstd::encode_all(text.as_bytes(), 3).unwrap();
        let skipped = |magic: u8| [&[magic, 0x2A, 0x4D, 0x18, 2, 0, 0, 0, 7, 7], &frame[..]].concat();
        let plain = text.clone().into_bytes();
        for bytes in [plain, gzip(text.as_bytes()), members.clone(), skipped(0x50), skipped(0x5F), frame.clone()] {
            let (_file, source) = source(&bytes);
            let packing = Packing::of(&source).unwrap();
            assert_eq!(all(Lines::open(&source, bytes.len() as u64, packing, None).unwrap()).unwrap(), expected);
        }
        let (_file, source) = source(text.as_bytes());
        let from = expected[1000].0;
        assert_eq!(all(Lines::begin(&source, from)).unwrap(), expected[1000..]);
        // Other bytes behind the members are none of them.
        let more = [&members[..], b"more"].concat();
        let (_file, source) = super::tests::source(&more);
        let lines = Lines::open(&source, more.len() as u64, Packing::Gzip, None).unwrap();
        let error = all(lines).unwrap_err().to_string();
        assert!(error.contains("cannot be unpacked"), "{error}");
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
    fn lines_end_with_feeds_returns_or_both() {
        // Also with a pair split across the end of a block.
        for before in [0, BLOCK_BYTES - 3, BLOCK_BYTES - 2, BLOCK_BYTES - 1, BLOCK_BYTES, 2 * BLOCK_BYTES - 4] {
            let comments = "#\n".repeat(before / 2) + &"\n".repeat(before % 2);
            let text = format!("{comments}ab\r\ncd\ref\n\r\ngh\r");
            let (_file, source) = source(text.as_bytes());
            let mut lines = Lines::begin(&source, 0);
            let mut found = Vec::new();
            while let Some(row) = lines.row().unwrap() {
                let place = lines.error("x").to_string();
                found.push(String::from_utf8(row).unwrap());
                // Its line number must be the same when reading begins within the pair before it.
                let at = lines.position() - 1;
                assert_eq!(Lines::begin_behind(&source, at, u64::MAX).unwrap().error("x").to_string(), place);
            }
            assert_eq!(found, ["ab", "cd", "ef", "gh"], "{before}");
        }
    }

    #[test]
    fn marks_are_passed_over_and_other_encodings_refused() {
        let packed = |bytes: &[u8]| zstd::encode_all(bytes, 1).unwrap();
        let open = |bytes: &[u8]| {
            let (_file, source) = source(bytes);
            let packing = Packing::of(&source).unwrap();
            all(Lines::open(&source, bytes.len() as u64, packing, None)?)
        };
        for bytes in [b"\xEF\xBB\xBF1 2 3".to_vec(), packed(b"\xEF\xBB\xBF1 2 3")] {
            assert_eq!(open(&bytes).unwrap(), [(3, "1 2 3".to_owned())]);
        }
        for text in [&b"\xFF\xFE1\0"[..], b"\xFE\xFF\x001", b"1\0 \0", b"\x001\0 "] {
            for bytes in [text.to_vec(), packed(text)] {
                assert!(open(&bytes).unwrap_err().to_string().contains("UTF-16"), "{text:?}");
            }
        }
    }

    #[test]
    fn long_lines_can_be_passed_over_and_long_pauses_are_told() {
        let text = [&b"1 2 3\n"[..], &[b'7'; 1 << 18], b"\n4 5 6\n", &[b'\n'; 3 << 20], b"7 8 9"].concat();
        let (_file, source) = source(&text);
        let mut lines = Lines::begin(&source, 0);
        let mut found = String::new();
        while let Some(step) = lines.step().unwrap() {
            match step {
                Step::Row(_, line) => found += std::str::from_utf8(lines.at(line)).unwrap(),
                Step::TooLong(place) => found += &format!(" long {place}, "),
                Step::Pause => found += ".",
            }
        }
        assert_eq!(found, "1 2 3 long 6, 4 5 6..7 8 9");
        assert!(lines.error("x").to_string().contains(&format!("line {}", 4 + (3 << 20))));
        // A text that ends within such a line.
        let (_file, source) = super::tests::source(&[b'7'; 1 << 20]);
        let mut lines = Lines::begin(&source, 0);
        assert!(matches!(lines.step(), Ok(Some(Step::TooLong(0)))));
        assert!(matches!(lines.step(), Ok(None)));
        assert!(Lines::begin_behind(&source, 10, 1 << 19).unwrap().position() >= 1 << 19);
    }

    #[test]
    fn errors_far_into_a_file_name_its_byte() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        // Most systems store no bytes for the gap before.
        file.seek(SeekFrom::Start(COUNTED)).unwrap();
        file.write_all(b"\n1 2 3\n4 five 6\n").unwrap();
        let source = Source::open(file.path(), None).unwrap();
        let mut lines = Lines::begin(&source, COUNTED + 1);
        assert_eq!(lines.row().unwrap().unwrap(), b"1 2 3");
        assert_eq!(lines.row().unwrap().unwrap(), b"4 five 6");
        let error = lines.error("x").to_string();
        assert!(error.contains(&format!("line 2 from byte {} on: x", COUNTED + 1)), "{error}");
    }

    #[test]
    fn rows_are_counted_up_to_a_whole_number() {
        let (_file, source) = source(b"1 2 3\r\n\n4.5\n4 5 6\n  7\n8 9 10\n");
        let mut lines = Lines::begin(&source, 0);
        assert_eq!(lines.count_rows(100, true, &NoMonitor).unwrap(), 3);
        assert_eq!(lines.row().unwrap().unwrap(), b"  7");
        assert_eq!(lines.count_rows(100, false, &NoMonitor).unwrap(), 1);
        let cut = zstd::encode_all(&b"1 2 3\n".repeat(100_000)[..], 3).unwrap();
        let (_file, source) = super::tests::source(&cut[..cut.len() / 2]);
        let lines = Lines::open(&source, cut.len() as u64 / 2, Packing::Zstd, None);
        let error = lines.and_then(all).unwrap_err().to_string();
        assert!(error.contains("cannot be unpacked"), "{error}");
    }
}
