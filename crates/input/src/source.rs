//! Positioned reads from a scan file, and a bounded window that supports `Read` and `Seek`.
//!
//! Input: a path. Output: bytes at offsets. No shared file position is moved, so several threads may read one file.
//! Memory: one [`Window`] holds at most [`WINDOW_BYTES`].

use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::bytes::{Input, Stamp};
use crate::{Error, Result};
use xxhash_rust::xxh3::{Xxh3, xxh3_128_with_seed};

/// Read-ahead of a [`Window`] (bytes).
pub(super) const WINDOW_BYTES: usize = 64 << 10;

/// An open scan file.
#[derive(Debug)]
pub(super) struct Source {
    input: Input,
    path: PathBuf,
    stamp: Stamp,
    /// Log that records the reads, if any.
    log: Option<ReadLog>,
}

/// Pieces read from a file, with their hash.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Reads {
    /// Sum of the hashes of the pieces; each covers the bytes and their offset.
    pub sum: u128,
    /// Offset and length of each piece.
    pub pieces: Vec<(u64, u64)>,
}

impl Reads {
    /// Returns whether the same pieces of the file at `path` hold the same bytes. Cost: reads them all.
    pub fn are_of(&self, path: &Path) -> Result<bool> {
        let source = Source::open(path, None)?;
        let (mut sum, mut buffer) = (0u128, vec![0; WINDOW_BYTES]);
        for &(at, len) in &self.pieces {
            let (mut hash, end) = (Xxh3::with_seed(at), at.saturating_add(len));
            let mut next = at;
            while next < end {
                let count = (end - next).min(WINDOW_BYTES as u64) as usize;
                let read = source.read_at(&mut buffer[..count], next)?;
                if read < count {
                    return Ok(false);
                }
                hash.update(&buffer[..count]);
                next += count as u64;
            }
            sum = sum.wrapping_add(hash.digest128());
        }
        Ok(sum == self.sum)
    }
}

/// Log of what a decoder reads for the current chunk, shared with those who query it.
#[derive(Debug, Clone, Default)]
pub struct ReadLog(Arc<Mutex<Noted>>);

#[derive(Debug, Default)]
struct Noted {
    file: usize,
    /// Sum of the hashes of all pieces of the chunk.
    all: u128,
    reads: Reads,
}

impl ReadLog {
    /// Maximum number of pieces listed again by each call of `reads`, enough for a chunk of usual size. For longer
    /// chunks (a whole file), each call lists only the pieces since the last one.
    const MOST_PIECES: usize = 256;

    fn noted(&self) -> MutexGuard<'_, Noted> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a chunk of file `file`.
    pub(super) fn begin(&self, file: usize) {
        *self.noted() = Noted { file, ..Noted::default() };
    }

    fn add(&self, at: u64, bytes: &[u8]) {
        let hash = xxh3_128_with_seed(bytes, at);
        let Noted { all, reads: Reads { sum, pieces }, .. } = &mut *self.noted();
        *all = all.wrapping_add(hash);
        *sum = sum.wrapping_add(hash);
        pieces.push((at, bytes.len() as u64));
    }

    /// Returns an order-independent hash of everything read for the chunk.
    pub fn hash(&self) -> u128 {
        self.noted().all
    }

    /// Returns the file and what was read of it for the points of the current chunk.
    pub fn reads(&self) -> (usize, Reads) {
        let mut noted = self.noted();
        match noted.reads.pieces.len() <= Self::MOST_PIECES {
            true => (noted.file, noted.reads.clone()),
            false => (noted.file, std::mem::take(&mut noted.reads)),
        }
    }
}

impl Source {
    /// Opens the file at `path`; reads are recorded in `log`.
    pub(super) fn open(path: &Path, log: Option<ReadLog>) -> Result<Self> {
        let (input, stamp) = Input::open(path)?;
        Ok(Self { input, path: path.to_path_buf(), stamp, log })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the state of the file at the time it was opened.
    pub(super) fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Fills `out` from `offset` on; returns fewer bytes only at the end of the file.
    pub(super) fn read_at(&self, out: &mut [u8], offset: u64) -> Result<usize> {
        let len = out.len();
        self.fill(out, offset).map_err(|e| Error::io(&self.path, format!("read {len} bytes at byte {offset}"), e))
    }

    pub(super) fn fill(&self, out: &mut [u8], offset: u64) -> io::Result<usize> {
        let read = self.input.read_up_to(offset, out)?;
        if let Some(log) = &self.log {
            log.add(offset, &out[..read]);
        }
        Ok(read)
    }

    /// Returns the `len` bytes at `offset`, or `None` if the file ends before. The caller must bound `len`.
    pub(super) fn bytes_at(&self, offset: u64, len: usize) -> Result<Option<Vec<u8>>> {
        let mut bytes = vec![0; len];
        Ok((self.read_at(&mut bytes, offset)? == len).then_some(bytes))
    }
}

/// The bytes `start .. start + len` of a file as a stream of their own.
///
/// Bytes skipped by seeking are never read from disk; the end of the window reads as end of file.
#[derive(Clone)]
pub(super) struct Window<'a> {
    source: &'a Source,
    start: u64,
    len: u64,
    /// Window position of `held`; the next byte to return is at `held_at + next`.
    held_at: u64,
    held: Vec<u8>,
    next: usize,
}

impl<'a> Window<'a> {
    pub(super) fn new(source: &'a Source, start: u64, len: u64) -> Self {
        Self { source, start, len, held_at: 0, held: Vec::new(), next: 0 }
    }

    /// Returns the position in the window (bytes).
    pub(super) fn position(&self) -> u64 {
        self.held_at + self.next as u64
    }

    fn refill(&mut self) -> io::Result<()> {
        self.held_at += self.held.len() as u64;
        self.next = 0;
        let want = self.len.saturating_sub(self.held_at).min(WINDOW_BYTES as u64) as usize;
        self.held.resize(want, 0);
        let got = self.source.fill(&mut self.held, self.start + self.held_at)?;
        self.held.truncate(got);
        Ok(())
    }

    #[cold]
    fn read_exact_slowly(&mut self, mut out: &mut [u8]) -> io::Result<()> {
        while !out.is_empty() {
            match self.read(out)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                n => out = &mut out[n..],
            }
        }
        Ok(())
    }
}

impl Read for Window<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.next == self.held.len() {
            self.refill()?;
        }
        let held = &self.held[self.next..];
        let n = held.len().min(out.len());
        out[..n].copy_from_slice(&held[..n]);
        self.next += n;
        Ok(n)
    }

    // Some decoders read one byte at a time, so this is their inner loop.
    #[inline]
    fn read_exact(&mut self, out: &mut [u8]) -> io::Result<()> {
        match self.held.get(self.next..self.next + out.len()) {
            Some(held) => {
                out.copy_from_slice(held);
                self.next += out.len();
                Ok(())
            }
            None => self.read_exact_slowly(out),
        }
    }
}

impl Seek for Window<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let target = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.position().checked_add_signed(by),
            SeekFrom::End(by) => self.len.checked_add_signed(by),
        };
        let target = target.ok_or(io::ErrorKind::InvalidInput)?;
        match target.checked_sub(self.held_at) {
            Some(inside) if inside <= self.held.len() as u64 => self.next = inside as usize,
            _ => {
                self.held.clear();
                self.next = 0;
                self.held_at = target;
            }
        }
        Ok(target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn reads_are_those_of_a_file_with_the_same_bytes_only() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&[7; 1000]).unwrap();
        let log = ReadLog::default();
        let source = Source::open(file.path(), Some(log.clone())).unwrap();
        log.begin(3);
        source.bytes_at(900, 100).unwrap();
        source.bytes_at(10, 20).unwrap();
        let (number, reads) = log.reads();
        assert_eq!((number, reads.pieces.as_slice()), (3, [(900, 100), (10, 20)].as_slice()));
        let after = |change: &dyn Fn(&std::fs::File)| {
            change(file.as_file());
            reads.are_of(file.path()).unwrap()
        };
        assert!(after(&|_| ()));
        assert!(!after(&|file| file.set_len(999).unwrap()), "shorter");
        // The byte that is lost comes back as 0.
        assert!(!after(&|file| file.set_len(1000).unwrap()), "changed");
    }

    #[test]
    fn many_reads_are_listed_once_and_few_again() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&[7; 10]).unwrap();
        for (count, again) in [(256, 256), (257, 0)] {
            let log = ReadLog::default();
            let source = Source::open(file.path(), Some(log.clone())).unwrap();
            log.begin(0);
            (0..count).for_each(|_| drop(source.bytes_at(1, 2).unwrap()));
            let all = log.hash();
            assert_eq!([0; 2].map(|_| log.reads().1.pieces.len()), [count, again]);
            assert_eq!(log.hash(), all);
        }
    }

    #[test]
    fn a_window_reads_and_seeks_like_the_bytes_it_shows() {
        let all: Vec<u8> = (0..300_000u32).map(|i| ((i * 7) >> 3) as u8).collect();
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&all).unwrap();
        let source = Source::open(file.path(), None).unwrap();
        let shown = &all[1000..251_000];
        let mut window = Window::new(&source, 1000, 250_000);
        let mut cursor = io::Cursor::new(shown);
        for (skip, take) in [(0i64, 3usize), (5, 70_000), (-60_000, 1), (130_000, 64), (-3, 65_536), (0, 12)] {
            assert_eq!(window.seek(SeekFrom::Current(skip)).unwrap(), cursor.seek(SeekFrom::Current(skip)).unwrap());
            let (mut a, mut b) = (vec![0; take], vec![0; take]);
            window.read_exact(&mut a).unwrap();
            cursor.read_exact(&mut b).unwrap();
            assert!(a == b);
            assert_eq!(window.position(), cursor.position());
        }
        window.seek(SeekFrom::End(-2)).unwrap();
        assert_eq!(window.read_exact(&mut [0; 3]).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
        window.seek(SeekFrom::Start(1 << 40)).unwrap();
        assert_eq!(window.read(&mut [0; 3]).unwrap(), 0);
    }
}
