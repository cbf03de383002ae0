//! Counting what a loader does.

/// What a [`Loader`](super::Loader) or a [`Stream`](super::Stream) did so far, and what it holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counters {
    /// Pages that hints came to want and that were not in memory.
    pub requested: u64,
    /// Pages loaded.
    pub loaded: u64,
    /// Pages that a body touched already when their fetch began.
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
    /// Fetches of pages.
    pub reads: u64,
    /// Bytes that these asked for.
    pub read_bytes: u64,
    /// Fetches that were given up because nobody wanted their pages any more.
    pub cancelled: u64,
    /// Pages in memory.
    pub resident_pages: usize,
    /// Weight of these pages (bytes).
    pub resident_bytes: usize,
    /// Bytes in use now: the table of pages, resident pages, pages that only views hold, and pages and bytes on their way
    /// with the scratch memory of decoding them.
    pub used_bytes: usize,
    /// Most bytes in use at any moment; never above the budget.
    pub peak_bytes: usize,
    /// The budget (bytes).
    pub budget_bytes: usize,
    /// Memory of the table of pages (bytes).
    pub table_bytes: usize,
}
