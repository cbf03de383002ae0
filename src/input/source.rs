//! Positioned reading of one scan file, and a bounded window on it that the LAZ decoder can read and seek in.
//!
//! In: a path. Out: bytes at offsets. Nothing here moves a shared file position, so several threads may read one file.
//! Memory: one [`Window`] holds at most [`WINDOW_BYTES`].

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::bytes::{Stamp, open_regular, read_up_to};
use crate::{Error, Result};
use xxhash_rust::xxh3::xxh3_128_with_seed;

/// Read-ahead of a [`Window`] (bytes).
const WINDOW_BYTES: usize = 64 << 10;

/// An open scan file.
#[derive(Debug)]
pub(super) struct Source {
    file: File,
    path: PathBuf,
    stamp: Stamp,
    /// Sum of the hashes of what was read, if that is wanted.
    hash: Cell<Option<u128>>,
}

impl Source {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let (file, about) = open_regular(path).map_err(|e| Error::io(path, "open", e))?;
        let stamp = Stamp::of(&file, &about);
        Ok(Self { file, path: path.to_path_buf(), stamp, hash: Cell::new(None) })
    }

    /// Whether what is read is to be hashed.
    pub(super) fn hashes(&self, wanted: bool) {
        self.hash.set(wanted.then_some(0));
    }

    /// Hash of all that was read since the last call: of bytes and places, in whatever order.
    pub(super) fn take_hash(&self) -> u128 {
        let hash = self.hash.get();
        self.hashes(hash.is_some());
        hash.unwrap_or(0)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// State of the file when it was opened.
    pub(super) fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Fills `out` from `offset` on; returns fewer bytes only where the file ends.
    pub(super) fn read_at(&self, out: &mut [u8], offset: u64) -> Result<usize> {
        let len = out.len();
        self.fill(out, offset).map_err(|e| Error::io(&self.path, format!("read {len} bytes at byte {offset}"), e))
    }

    fn fill(&self, out: &mut [u8], offset: u64) -> io::Result<usize> {
        let read = read_up_to(&self.file, offset, out)?;
        if let Some(hash) = self.hash.get() {
            self.hash.set(Some(hash.wrapping_add(xxh3_128_with_seed(&out[..read], offset))));
        }
        Ok(read)
    }

    /// The `len` bytes at `offset`, or `None` where the file ends before. `len` must be bounded by the caller.
    pub(super) fn bytes_at(&self, offset: u64, len: usize) -> Result<Option<Vec<u8>>> {
        let mut bytes = vec![0; len];
        Ok((self.read_at(&mut bytes, offset)? == len).then_some(bytes))
    }
}

/// The bytes `start .. start + len` of a file as a stream of their own.
///
/// Layers that the decoder skips by seeking are never read from the disk; the last byte of the window is its end of
/// file, so damage in one LAZ chunk cannot run into the next.
pub(super) struct Window<'a> {
    source: &'a Source,
    start: u64,
    len: u64,
    /// Position in the window of the next byte to hand out is `held_at + next`.
    held_at: u64,
    held: Vec<u8>,
    next: usize,
}

impl<'a> Window<'a> {
    pub(super) fn new(source: &'a Source, start: u64, len: u64) -> Self {
        Self { source, start, len, held_at: 0, held: Vec::new(), next: 0 }
    }

    /// Position in the window (bytes).
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

    // The arithmetic decoder asks for one byte at a time: this is its inner loop.
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
    fn a_window_reads_and_seeks_like_the_bytes_it_shows() {
        let all: Vec<u8> = (0..300_000u32).map(|i| ((i * 7) >> 3) as u8).collect();
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&all).unwrap();
        let source = Source::open(file.path()).unwrap();
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
