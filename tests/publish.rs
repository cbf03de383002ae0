//! Publication of snapshots to readers, in every interleaving of its steps (loom).
//!
//! Not on Windows: loom ends its coroutines by unwinding, which wine cannot do, and the interleavings are the same
//! everywhere.
#![cfg(not(windows))]

/// Replaces the `sync` module of `publish.rs` by loom's.
mod sync {
    pub use loom::sync::atomic::AtomicUsize;
    pub use loom::sync::{Arc, RwLock, RwLockReadGuard};

    /// Lets other threads run.
    pub fn pause() {
        loom::thread::yield_now();
    }
}

#[path = "../src/store/publish.rs"]
mod publish;

use publish::{Current, Retired};
use std::sync::atomic::Ordering::Relaxed;
use sync::{Arc, AtomicUsize};

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
    let mut model = loom::model::Builder::new();
    // Every interleaving with up to three preemptions; without the bound it takes hours.
    model.preemption_bound = Some(3);
    model.check(move || {
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
                    // Both stay alive while they are held, whatever the publisher does.
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
        assert_eq!(retired.len(), 0, "no reader is left that could hold an old one");
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
