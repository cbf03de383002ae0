//! Counters of a loader's work.

/// Counts of the work of a [`Loader`](super::Loader) or a [`Stream`](super::Stream), and the memory it holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counters {
    /// Pages that became wanted by hints while they were not in memory.
    pub requested: u64,
    /// Pages loaded.
    pub loaded: u64,
    /// Pages that a body touched already when their fetch began.
    pub late: u64,
    /// Pages evicted to make room.
    pub evicted: u64,
    /// Pages evicted that no body ever touched.
    pub wasted: u64,
    /// Failures to load a page; each failed attempt counts.
    pub failed: u64,
    /// Times that the most urgent page did not fit: all others were needed sooner, or snapshots held too much.
    pub no_room: u64,
    /// Hints that were dropped: not finite or not in order, or given at the moment at which the last one was collected.
    pub hints_dropped: u64,
    /// Fetches of pages.
    pub reads: u64,
    /// Bytes requested by these fetches.
    pub read_bytes: u64,
    /// Fetches cancelled because their pages were no longer wanted.
    pub cancelled: u64,
    /// Pages in memory.
    pub resident_pages: usize,
    /// Bytes of these pages.
    pub resident_bytes: usize,
    /// Bytes in use now: the table of pages, resident pages, pages that only snapshots hold, and runs in flight with the
    /// scratch memory of decoding them.
    pub used_bytes: usize,
    /// Most bytes in use at any moment; never above the budget.
    pub peak_bytes: usize,
    /// The budget (bytes).
    pub budget_bytes: usize,
    /// Memory of the table of pages (bytes).
    pub table_bytes: usize,
}
