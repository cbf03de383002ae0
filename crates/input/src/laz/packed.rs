//! Packed bytes of a part of a file, read piece by piece during decoding.

use std::io;

use super::coder::{Coder, Range};
use crate::source::{Source, WINDOW_BYTES};

/// Bytes before the position that are kept: the end of an encoder is examined again.
const LAST_BYTES: usize = 4;

/// Bytes of a file, with a piece around the position in memory.
pub(super) struct PackedBytes<'a> {
    source: &'a Source,
    /// Offset in the file of the first byte not held; `left`: bytes from there on.
    next: u64,
    left: u64,
    held: Vec<u8>,
    /// Number of bytes before those in `held`.
    before: u64,
    /// Position in `held`.
    position: usize,
    range: Range,
}

impl<'a> PackedBytes<'a> {
    /// Creates a reader of the `len` bytes from `start` on.
    pub fn new(source: &'a Source, start: u64, len: u64) -> Self {
        let (held, range) = (Vec::new(), Range::default());
        Self { source, next: start, left: len, held, before: 0, position: 0, range }
    }

    /// Returns the number of bytes consumed.
    pub fn position(&self) -> u64 {
        self.before + self.position as u64
    }

    /// Makes sure that at least `most` bytes from the position on are held, or all that exist.
    #[inline(always)]
    pub fn hold(&mut self, most: usize) -> io::Result<()> {
        match self.left > 0 && self.position + most > self.held.len() {
            true => self.refill(most),
            false => Ok(()),
        }
    }

    #[cold]
    fn refill(&mut self, most: usize) -> io::Result<()> {
        let past = self.position.min(self.held.len()).saturating_sub(LAST_BYTES);
        self.before += past as u64;
        self.held.drain(..past);
        self.position -= past;
        while self.left > 0 && self.held.len() < self.position + most {
            let kept = self.held.len();
            self.held.resize(kept + self.left.min(WINDOW_BYTES as u64) as usize, 0);
            let read = self.source.fill(&mut self.held[kept..], self.next)?;
            // If the file was truncated, it ends here.
            self.left = if kept + read < self.held.len() { 0 } else { self.left - read as u64 };
            self.held.truncate(kept + read);
            self.next += read as u64;
        }
        Ok(())
    }

    /// Returns the `len` bytes at the position, if they are held.
    pub fn bytes(&self, len: usize) -> Option<&[u8]> {
        self.held.get(self.position..self.position + len)
    }

    /// Returns a decoder that begins `behind` bytes after the position.
    pub fn begin(&self, behind: usize) -> Coder<'_> {
        Coder::begin(&self.held, self.position + behind)
    }

    /// Returns the decoder whose state was kept.
    pub fn coder(&self) -> Coder<'_> {
        Coder::resume(&self.held, self.position, self.range)
    }

    /// Returns the last position at which a decoder has `most` bytes ahead, or all that exist.
    pub fn reach(&self, most: usize) -> usize {
        if self.left > 0 { self.held.len() - most } else { self.held.len() }
    }

    /// Keeps the state of a decoder of these bytes.
    #[inline(always)]
    pub fn keep(&mut self, (position, range): (usize, Range)) {
        (self.position, self.range) = (position, range);
    }
}
