//! Sharing of equal pages (chapter 12): finds candidates among the last 65,536 distinct pages.
//!
//! The hash only finds a candidate. The writer compares bytes before it shares, so no collision, accidental or
//! deliberate, can give a page the content of another. The window is a constant and does not depend on the memory
//! budget, so the same pages give the same file on any machine. Memory: about 4 MiB when full.

use super::directory::Extent;
use std::collections::{HashMap, VecDeque};

/// Number of distinct pages remembered.
pub(super) const WINDOW: usize = 1 << 16;

/// The most recent distinct pages, keyed by the hash of their bodies.
#[derive(Debug, Default)]
pub(super) struct Window {
    by_hash: HashMap<u64, Extent>,
    /// Oldest first.
    order: VecDeque<(u64, u64)>,
}

impl Window {
    /// Returns the remembered page whose body has this hash and whose length is `len` (bytes), if any.
    pub fn candidate(&self, hash: u64, len: u32) -> Option<Extent> {
        self.by_hash.get(&hash).copied().filter(|extent| extent.len == len)
    }

    /// Remembers a page; it replaces another of the same hash.
    pub fn insert(&mut self, hash: u64, extent: Extent) {
        if self.order.len() == WINDOW
            && let Some((oldest, offset)) = self.order.pop_front()
            && self.by_hash.get(&oldest).is_some_and(|extent| extent.offset == offset)
        {
            self.by_hash.remove(&oldest);
        }
        self.by_hash.insert(hash, extent);
        self.order.push_back((hash, extent.offset));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forgets_the_oldest_and_nothing_else() {
        let mut window = Window::default();
        let extent = |offset: u64| Extent { offset, len: 30, crc: 0 };
        for offset in 0..WINDOW as u64 + 2 {
            // Page 1 is inserted again late, under the same hash.
            window.insert(if offset == 9 { 1 } else { offset }, extent(offset));
        }
        assert_eq!(window.candidate(0, 30), None);
        assert_eq!(window.candidate(1, 30), Some(extent(9)), "the later page of this hash stays");
        assert_eq!(window.candidate(2, 30), Some(extent(2)));
        assert_eq!(window.candidate(2, 31), None);
        assert_eq!(window.by_hash.len(), WINDOW);
    }
}
