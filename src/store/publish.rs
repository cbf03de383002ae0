//! Handing the newest of a sequence of values to any number of readers, none of whom ever waits.
//!
//! Two cells hold the newest value; an index says which of them readers take. The publisher writes the other cell, turns
//! the index, then writes the first. A reader that finds its cell being written has an index that was turned since:
//! it looks again. So no reader waits for a publisher or for another reader, even one that is suspended for ever; it
//! repeats at most once per publication. No `unsafe`: the cells are locks of which readers use `try_read` only.
//!
//! Checked by loom under every interleaving: `RUSTFLAGS="--cfg loom" cargo test --release --lib store::publish`.

#[cfg(loom)]
use loom::sync::{Arc, RwLock, RwLockReadGuard, atomic::AtomicUsize};
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
#[cfg(not(loom))]
use std::sync::{Arc, RwLock, RwLockReadGuard, atomic::AtomicUsize};
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
            if let Some(cell) = self.try_cell(self.newest.load(Acquire)) {
                return Arc::clone(&cell);
            }
            #[cfg(loom)]
            loom::thread::yield_now();
            #[cfg(not(loom))]
            std::hint::spin_loop();
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
    #[cfg(all(test, not(loom)))]
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

#[cfg(all(test, loom))]
mod tests {
    use super::*;
    use loom::sync::atomic::AtomicUsize;

    /// Counts itself while it lives.
    struct Counted(usize, Arc<AtomicUsize>);

    impl Counted {
        fn new(number: usize, alive: &Arc<AtomicUsize>) -> Arc<Self> {
            alive.fetch_add(1, Relaxed);
            Arc::new(Self(number, alive.clone()))
        }
    }

    impl Drop for Counted {
        fn drop(&mut self) {
            self.1.fetch_sub(1, Relaxed);
        }
    }

    fn readers_and_a_publisher(readers: usize, publications: usize) {
        loom::model(move || {
            let alive = Arc::new(AtomicUsize::new(0));
            let first = Counted::new(0, &alive);
            let current = Arc::new(Current::new(first.clone()));
            let reading: Vec<_> = (0..readers)
                .map(|_| {
                    let current = current.clone();
                    loom::thread::spawn(move || {
                        let one = current.get();
                        let two = current.get();
                        assert!(one.0 <= two.0, "never back in time");
                        // Both are alive as long as they are held, whatever the publisher does.
                        assert!(one.1.load(Relaxed) >= 1);
                    })
                })
                .collect();
            let (mut newest, mut retired) = (first, Retired::default());
            for number in 1..=publications {
                let next = Counted::new(number, &alive);
                current.publish(&next);
                retired.push(std::mem::replace(&mut newest, next));
                retired.reclaim();
            }
            reading.into_iter().for_each(|reader| reader.join().unwrap());
            retired.reclaim();
            assert_eq!(retired.len(), 0, "nobody is left who could hold an old one");
            assert_eq!(alive.load(Relaxed), 1);
            assert_eq!(current.get().0, publications, "what was published last");
        });
    }

    #[test]
    fn one_reader_two_publications() {
        readers_and_a_publisher(1, 2);
    }

    #[test]
    fn two_readers_one_publication() {
        readers_and_a_publisher(2, 1);
    }
}
