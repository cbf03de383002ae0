//! Synchronisation primitives of the store. `tests/publish.rs` replaces them by loom's types. With `--cfg
//! slicewalk_schedules` they are shuttle's: `tests/schedules.rs` then runs streams in schedules that shuttle chooses.

#[cfg(not(slicewalk_schedules))]
#[cfg_attr(target_family = "wasm", allow(unused_imports, dead_code, reason = "streams have a thread"))]
mod real {
    pub use std::hint::spin_loop as pause;
    pub use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize};
    pub use std::sync::{Arc, Condvar, Mutex, MutexGuard, RwLock, RwLockReadGuard};
    pub use std::thread::{Builder, JoinHandle, Thread, park, park_timeout, yield_now};

    /// Releases the lock of `mutex` until `condvar` is notified, at most for `at_most`.
    pub fn wait_at_most<'a, T>(
        condvar: &Condvar,
        _: &'a Mutex<T>,
        guard: MutexGuard<'a, T>,
        at_most: std::time::Duration,
    ) -> MutexGuard<'a, T> {
        condvar.wait_timeout(guard, at_most).unwrap_or_else(std::sync::PoisonError::into_inner).0
    }
}

/// Shuttle has no time: a timed wait may end at any moment.
#[cfg(slicewalk_schedules)]
mod real {
    pub use shuttle::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize};
    pub use shuttle::sync::{Condvar, Mutex, MutexGuard, RwLock, RwLockReadGuard};
    pub use shuttle::thread::{Builder, JoinHandle, Thread, park, yield_now, yield_now as pause};
    // Only counts references; published data passes through the locks above.
    pub use std::sync::Arc;

    pub fn park_timeout(_: std::time::Duration) {
        yield_now();
    }

    /// Lets other threads take the lock for a moment.
    pub fn wait_at_most<'a, T>(
        _: &Condvar,
        mutex: &'a Mutex<T>,
        guard: MutexGuard<'a, T>,
        _: std::time::Duration,
    ) -> MutexGuard<'a, T> {
        drop(guard);
        yield_now();
        mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

pub(super) use real::*;
