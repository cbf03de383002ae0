//! Bytes of a source, read by blocks for places that mostly ascend.

use slicewalk_base::Result;
use slicewalk_base::bytes::ByteSource;
use std::sync::Arc;

/// Bytes read at once.
const BLOCK_BYTES: u64 = 1 << 16;

/// The block of a source that was read last.
pub struct Window {
    source: Arc<dyn ByteSource>,
    start: u64,
    block: Vec<u8>,
}

impl Window {
    /// Creates an empty window.
    pub fn new(source: Arc<dyn ByteSource>) -> Self {
        Self { source, start: 0, block: Vec::new() }
    }

    /// Returns the length of the source.
    pub fn len(&self) -> u64 {
        self.source.len()
    }

    /// Returns `N` bytes at `at`, or `None` if the source ends before.
    pub fn bytes<const N: usize>(&mut self, at: u64) -> Result<Option<[u8; N]>> {
        if at.checked_add(N as u64).is_none_or(|end| end > self.source.len()) {
            return Ok(None);
        }
        let is_held = at >= self.start && at + N as u64 <= self.start + self.block.len() as u64;
        if !is_held {
            let len = BLOCK_BYTES.min(self.source.len() - at);
            self.block.resize(len as usize, 0);
            self.start = at;
            if let Err(error) = self.source.read_at(at, &mut self.block) {
                self.block.clear();
                return Err(error);
            }
        }
        let from = (at - self.start) as usize;
        Ok(self.block.get(from..from + N).and_then(|bytes| bytes.try_into().ok()))
    }
}
