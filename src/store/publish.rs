//! Handing the newest of a sequence of values to any number of readers, none of whom ever waits.
//!
//! Two cells hold the newest value; an index says which of them readers take. The publisher writes the other cell, turns
//! the index, then writes the first. A reader that finds its cell being written, or the index turned while it held the
//! cell, looks again. So no reader waits for a publisher or for another reader, even one that is suspended for ever; it
//! repeats at most once per publication. No `unsafe`: the cells are locks of which readers use `try_read` only.
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

    /// The newest value. Lock-free: repeats only if a publication ended meanwhile.
    pub fn get(&self) -> Arc<T> {
        loop {
            let at = self.newest.load(Acquire);
            // If the index still names the cell while it is held, it holds the newest value, not the one that is about
            // to become it: nobody sees a later value and then an earlier one.
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

    /// Makes `value` the newest. One publisher at a time: the caller sees to that. Waits for readers that are just
    /// copying the pointer of a cell; afterwards neither cell holds an older value.
    pub fn publish(&self, value: &Arc<T>) {
        let put = |at: usize| *self.cells[at].write().unwrap_or_else(PoisonError::into_inner) = Arc::clone(value);
        let old = self.newest.load(Relaxed);
        put(1 - old);
        self.newest.store(1 - old, Release);
        put(old);
    }

    /// The lock that a publisher holds while it writes the cell that nobody should read.
    #[cfg(test)]
    #[allow(dead_code, reason = "the model of this file does without")]
    pub fn hold_a_publication(&self) -> impl Sized + '_ {
        self.cells[1 - self.newest.load(Relaxed)].write()
    }
}

/// Values that were published and may still be in use.
///
/// The publisher keeps one more handle of each, and drops it when it is the last: so a reader never has to free anything
/// itself, and what a value holds is given back exactly when nobody can see it.
#[derive(Debug)]
pub(super) struct Retired<T>(Vec<Arc<T>>);

impl<T> Default for Retired<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Retired<T> {
    /// Takes over a value that [`Current`] no longer hands out.
    pub fn push(&mut self, value: Arc<T>) {
        self.0.push(value);
    }

    /// Drops the values that no reader holds. No reader can come to hold one again, as nobody hands it out.
    pub fn reclaim(&mut self) {
        self.0.retain(|value| Arc::strong_count(value) > 1);
    }

    /// Number of values that readers still held when [`reclaim`](Self::reclaim) was last called.
    pub fn len(&self) -> usize {
        self.0.len()
    }
}
