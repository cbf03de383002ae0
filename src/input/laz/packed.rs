//! The packed bytes at some place of a file, read piece by piece while they are decoded.

use std::io;

use super::coder::{Coder, Range};
use crate::input::source::{Source, WINDOW_BYTES};

/// Bytes before the position that stay: an encoder's last ones are looked at again.
const LAST_BYTES: usize = 4;

/// Bytes of a file, of which a piece around the position is held.
pub(super) struct PackedBytes<'a> {
    source: &'a Source,
    /// Place in the file of the first byte that is not held, and how many follow.
    next: u64,
    left: u64,
    held: Vec<u8>,
    /// Bytes before those that are held.
    before: u64,
    /// Position in `held`.
    position: usize,
    range: Range,
}

impl<'a> PackedBytes<'a> {
    /// The `len` bytes from `start` on.
    pub fn new(source: &'a Source, start: u64, len: u64) -> Self {
        let (held, range) = (Vec::new(), Range::default());
        Self { source, next: start, left: len, held, before: 0, position: 0, range }
    }

    /// Bytes taken.
    pub fn position(&self) -> u64 {
        self.before + self.position as u64
    }

    /// Holds at least `most` bytes from the position on, or all that there are.
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
            // A file that became shorter ends here.
            self.left = if kept + read < self.held.len() { 0 } else { self.left - read as u64 };
            self.held.truncate(kept + read);
            self.next += read as u64;
        }
        Ok(())
    }

    /// The `len` bytes at the position, if they are held.
    pub fn bytes(&self, len: usize) -> Option<&[u8]> {
        self.held.get(self.position..self.position + len)
    }

    /// A decoder that begins so many bytes behind the position.
    pub fn begin(&self, behind: usize) -> Coder<'_> {
        Coder::begin(&self.held, self.position + behind)
    }

    /// The decoder that was kept.
    pub fn coder(&self) -> Coder<'_> {
        Coder::resume(&self.held, self.position, self.range)
    }

    /// Last position from which on a decoder finds `most` bytes, or all that there are.
    pub fn reach(&self, most: usize) -> usize {
        if self.left > 0 { self.held.len() - most } else { self.held.len() }
    }

    /// Keeps where a decoder of these bytes is.
    #[inline(always)]
    pub fn keep(&mut self, (position, range): (usize, Range)) {
        (self.position, self.range) = (position, range);
    }
}
