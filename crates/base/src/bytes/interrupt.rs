//! Cancellation of reads that wait for a server. It is set per thread, because a source may serve many threads at once.

use std::cell::RefCell;
use std::io;
use std::sync::Arc;
use std::thread::{Scope, ScopedJoinHandle};

/// Function that returns whether a thread should stop waiting.
pub type Stop = Arc<dyn Fn() -> bool + Send + Sync>;

thread_local! {
    static STOP: RefCell<Option<Stop>> = const { RefCell::new(None) };
}

/// Runs `work`. While `stop` returns `true`, reads of remote objects on this thread fail within a moment with
/// [`Error::Interrupted`](crate::Error::Interrupted) instead of waiting for their server.
pub fn interruptible<T>(stop: Option<Stop>, work: impl FnOnce() -> T) -> T {
    struct Restore(Option<Stop>);
    impl Drop for Restore {
        fn drop(&mut self) {
            STOP.set(self.0.take());
        }
    }
    let _restore = Restore(STOP.replace(stop));
    work()
}

/// Returns the `stop` function of this thread.
pub fn stop_of_thread() -> Option<Stop> {
    STOP.with_borrow(Clone::clone)
}

/// True if the system can start threads; a browser's module cannot.
pub const HAS_THREADS: bool = !cfg!(target_arch = "wasm32");

/// Starts a thread of `scope` that inherits this thread's `stop` function; the system may refuse it.
pub fn spawn_in<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> io::Result<ScopedJoinHandle<'scope, T>> {
    let stop = stop_of_thread();
    std::thread::Builder::new().spawn_scoped(scope, || interruptible(stop, work))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wish_of_a_thread_ends_with_its_work() {
        let says = |stop: bool| -> Option<Stop> { Some(Arc::new(move || stop)) };
        let heard = || stop_of_thread().map(|stop| stop());
        assert_eq!(heard(), None);
        interruptible(says(true), || {
            assert_eq!(heard(), Some(true));
            interruptible(says(false), || assert_eq!(heard(), Some(false)));
            assert_eq!(heard(), Some(true));
            std::thread::scope(|scope| {
                scope.spawn(|| assert_eq!(heard(), None));
                spawn_in(scope, || assert_eq!(heard(), Some(true))).unwrap();
            });
        });
        assert_eq!(heard(), None);
    }
}
