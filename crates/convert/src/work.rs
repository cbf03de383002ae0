//! Workers of the first pass.

use crate::bytes::spawn_in;
use crate::{Error, Result};

/// Runs `work` on `threads` threads and returns the results, or the most informative error. If the system starts fewer
/// threads, these find all the work; if it starts none, the calling thread does it.
pub(super) fn on_threads<T: Send>(threads: usize, work: impl Fn() -> Result<T> + Sync) -> Result<Vec<T>> {
    let results: Vec<Result<T>> = std::thread::scope(|scope| {
        let start = |_| spawn_in(scope, &work).ok();
        let workers: Vec<_> = (0..threads).map_while(start).collect();
        if workers.is_empty() {
            return vec![work()];
        }
        workers
            .into_iter()
            .map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    let (mut done, mut stopped) = (Vec::with_capacity(threads), false);
    for result in results {
        match result {
            Ok(result) => done.push(result),
            // Stopped by another thread's error, which says more.
            Err(Error::Interrupted) => stopped = true,
            Err(error) => return Err(error),
        }
    }
    if stopped { Err(Error::Interrupted) } else { Ok(done) }
}
