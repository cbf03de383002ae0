//! Publication of the newest of a sequence of values to any number of readers, which never wait.
//!
//! Two cells hold the newest value; an index selects the cell that readers use. The publisher writes the other cell,
//! switches the index, then writes the first cell. A reader tries again if its cell is being written, or if the index
//! changed while it held the cell. So no reader waits for a publisher or for another reader, even one that is suspended
//! forever, and it tries again at most once per publication. No `unsafe`: the cells are locks, and readers only use
//! `try_read`.
//!
//! `tests/publish.rs` compiles this file against loom's types and runs readers and a publisher in every interleaving.

use super::sync::{Arc, AtomicUsize, RwLock, RwLockReadGuard, pause};
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::{PoisonError, TryLockError};

/// The newest of a sequence of values.
#[derive(Debug)]
pub(super) struct Current<T> {
    cells: [RwLock<Arc<T>>; 2],
    newest: AtomicUsize,
}

impl<T> Current<T> {
    pub fn new(value: Arc<T>) -> Self {
        Self { cells: [RwLock::new(value.clone()), RwLock::new(value)], newest: AtomicUsize::new(0) }
    }

    /// Returns the newest value. Lock-free: tries again only if a publication ended meanwhile.
    pub fn get(&self) -> Arc<T> {
        loop {
            let at = self.newest.load(Acquire);
            // If the index still names the cell while it is held, the cell holds the newest value and not the next one,
            // so no reader sees a later value and then an earlier one.
            if let Some(cell) = self.try_cell(at).filter(|_| self.newest.load(Acquire) == at) {
                return Arc::clone(&cell);
            }
            pause();
        }
    }

    fn try_cell(&self, at: usize) -> Option<RwLockReadGuard<'_, Arc<T>>> {
        match self.cells[at & 1].try_read() {
            Ok(cell) => Some(cell),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Makes `value` the newest. The caller ensures that there is one publisher at a time. Waits for readers that are
    /// just copying the pointer of a cell; afterwards neither cell holds an older value.
    pub fn publish(&self, value: &Arc<T>) {
        let put = |at: usize| *self.cells[at].write().unwrap_or_else(PoisonError::into_inner) = Arc::clone(value);
        let old = self.newest.load(Relaxed);
        put(1 - old);
        self.newest.store(1 - old, Release);
        put(old);
    }

    /// Returns the lock that a publisher holds while it writes the cell that readers do not use.
    #[cfg(test)]
    #[allow(dead_code, reason = "the model of this file does without")]
    pub fn hold_a_publication(&self) -> impl Sized + '_ {
        self.cells[1 - self.newest.load(Relaxed)].write()
    }
}

/// Published values that may still be in use.
///
/// The publisher keeps one more handle of each and drops it when it is the last one. So readers never free anything,
/// and a value's memory is released only when no reader can see it.
#[derive(Debug)]
pub(super) struct Retired<T>(Vec<Arc<T>>);

impl<T> Default for Retired<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Retired<T> {
    /// Adds a value that [`Current`] no longer returns.
    pub fn push(&mut self, value: Arc<T>) {
        self.0.push(value);
    }

    /// Drops the values that no reader holds. A reader cannot get one again, because [`Current`] no longer returns it.
    pub fn reclaim(&mut self) {
        self.0.retain(|value| Arc::strong_count(value) > 1);
    }

    /// Returns the number of values that readers still held at the last [`reclaim`](Self::reclaim).
    pub fn len(&self) -> usize {
        self.0.len()
    }
}
