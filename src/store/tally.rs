//! Counting what a stream does.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

/// What a [`Stream`](super::Stream) did so far, and what it holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Pages that hints came to want and that were not in memory.
    pub requested: u64,
    /// Pages loaded.
    pub loaded: u64,
    /// Pages that a body touched already when their read began.
    pub late: u64,
    /// Pages dropped to make room.
    pub evicted: u64,
    /// Pages dropped that no body ever touched.
    pub wasted: u64,
    /// Pages that could not be loaded, each time counted.
    pub failed: u64,
    /// Times that the most urgent page found no room: all others were needed sooner, or views held too much.
    pub no_room: u64,
    /// Hints that were dropped: not finite, or given in the very moment in which the last one was taken.
    pub hints_dropped: u64,
    /// Reads, and the bytes that they asked for.
    pub reads: u64,
    /// Bytes read.
    pub read_bytes: u64,
    /// Pages in memory.
    pub resident_pages: usize,
    /// Weight of these pages (bytes).
    pub resident_bytes: usize,
    /// Bytes in use now: resident pages, pages that only views hold, pages and bytes being read.
    pub used_bytes: usize,
    /// Most bytes in use at any moment; never above the budget.
    pub peak_bytes: usize,
    /// The budget (bytes).
    pub budget_bytes: usize,
    /// Memory of the table of pages, which comes on top (bytes).
    pub table_bytes: usize,
}

/// Counters that several threads add to.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub requested: AtomicU64,
    pub loaded: AtomicU64,
    pub late: AtomicU64,
    pub evicted: AtomicU64,
    pub wasted: AtomicU64,
    pub failed: AtomicU64,
    pub no_room: AtomicU64,
    pub hints_dropped: AtomicU64,
    pub reads: AtomicU64,
    pub read_bytes: AtomicU64,
}

impl Tally {
    pub fn counters(&self) -> Counters {
        Counters {
            requested: self.requested.load(Relaxed),
            loaded: self.loaded.load(Relaxed),
            late: self.late.load(Relaxed),
            evicted: self.evicted.load(Relaxed),
            wasted: self.wasted.load(Relaxed),
            failed: self.failed.load(Relaxed),
            no_room: self.no_room.load(Relaxed),
            hints_dropped: self.hints_dropped.load(Relaxed),
            reads: self.reads.load(Relaxed),
            read_bytes: self.read_bytes.load(Relaxed),
            ..Counters::default()
        }
    }
}
