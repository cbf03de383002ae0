//! Ordered hand-over between threads: jobs from one thread to several workers, and their results to the calling thread,
//! in the order of the jobs.
//!
//! At most `ahead` jobs wait for an earlier one: each job needs a token, which comes back when its result is taken. A
//! thread that fails or stops drops its ends of the channels, which wakes the others. `tests/schedules.rs` runs this
//! file under schedules of its own choice.

use super::sync::{HAS_THREADS, Receiver, Sender, bounded, scope, start};
use std::collections::BTreeMap;

/// Error of a job given after the results are no longer taken; the caller of [`Pipeline::run`] has the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Closed;

/// Message to the calling thread.
enum Message<D, E> {
    /// Result of the job with this number.
    Done(u64, D),
    Failed(E),
    /// A worker panicked; the result of its job never comes.
    Panicked,
}

/// Settings of a hand-over.
#[derive(Debug, Clone, Copy)]
pub struct Pipeline {
    /// Workers wanted. If the system starts fewer, but at least one, these do all the work.
    pub threads: usize,
    /// Jobs that may be finished before the oldest unfinished one.
    pub ahead: usize,
}

impl Pipeline {
    /// Runs the jobs that `give` passes to its argument on workers made by `worker`, and passes their results to `take`
    /// in the order of the jobs. Calls `check` whenever a job is finished; `no_thread` makes the error if the system
    /// starts no thread.
    ///
    /// # Errors
    ///
    /// The first error that any of them returned. Results of earlier jobs may have been taken; nothing is taken after
    /// it.
    pub fn run<J: Send, D: Send, E: Send, W: FnMut(J) -> Result<D, E> + Send>(
        self,
        give: impl FnOnce(&mut dyn FnMut(J) -> Result<(), Closed>) -> Result<(), E> + Send,
        mut worker: impl FnMut() -> W,
        take: impl FnMut(D) -> Result<(), E>,
        check: impl Fn() -> Result<(), E>,
        no_thread: impl Fn(std::io::Error) -> E,
    ) -> Result<(), E> {
        if !HAS_THREADS {
            return run_alone(give, worker(), take, check);
        }
        let Self { threads, ahead } = self;
        let (job_in, job_out) = bounded::<(u64, J)>(threads);
        let (done_in, done_out) = bounded::<Message<D, E>>(ahead);
        let (token_in, token_out) = bounded::<()>(ahead);
        for _ in 0..ahead {
            let _ = token_in.send(());
        }
        scope(|scope| {
            for number in 0..threads {
                let (jobs, done, worker) = (job_out.clone(), done_in.clone(), worker());
                match start(scope, move || work(worker, &jobs, &done)) {
                    Ok(()) => {}
                    Err(error) if number == 0 => return Err(no_thread(error)),
                    // Fewer workers do the same work.
                    Err(_) => break,
                }
            }
            drop(job_out);
            let giver = start(scope, move || {
                let mut number = 0;
                let given = give(&mut |job| {
                    token_out.recv().map_err(|_| Closed)?;
                    job_in.send((number, job)).map_err(|_| Closed)?;
                    number += 1;
                    Ok(())
                });
                if let Err(error) = given {
                    let _ = done_in.send(Message::Failed(error));
                }
            });
            let taken = match giver {
                Ok(()) => take_in_order(take, check, &done_out, &token_in),
                Err(error) => Err(no_thread(error)),
            };
            // Drop both ends before the scope waits for threads that may be blocked on them.
            drop((done_out, token_in));
            taken
        })
    }
}

/// Does all the work on the calling thread.
pub(super) fn run_alone<J, D, E>(
    give: impl FnOnce(&mut dyn FnMut(J) -> Result<(), Closed>) -> Result<(), E>,
    mut work: impl FnMut(J) -> Result<D, E>,
    mut take: impl FnMut(D) -> Result<(), E>,
    check: impl Fn() -> Result<(), E>,
) -> Result<(), E> {
    let mut failed = None;
    let given = give(&mut |job| {
        let done = check().and_then(|()| work(job)).and_then(&mut take);
        done.map_err(|error| {
            failed.get_or_insert(error);
            Closed
        })
    });
    failed.map_or(given, Err)
}

fn take_in_order<D, E>(
    mut take: impl FnMut(D) -> Result<(), E>,
    check: impl Fn() -> Result<(), E>,
    done: &Receiver<Message<D, E>>,
    tokens: &Sender<()>,
) -> Result<(), E> {
    let mut waiting = BTreeMap::new();
    let mut next = 0;
    while let Ok(message) = done.recv() {
        check()?;
        match message {
            Message::Done(number, what) => waiting.insert(number, what),
            Message::Failed(error) => return Err(error),
            // The scope propagates the panic.
            Message::Panicked => return Ok(()),
        };
        while let Some(what) = waiting.remove(&next) {
            next += 1;
            take(what)?;
            let _ = tokens.send(());
        }
    }
    Ok(())
}

fn work<J, D, E>(mut worker: impl FnMut(J) -> Result<D, E>, jobs: &Receiver<(u64, J)>, done: &Sender<Message<D, E>>) {
    let _alarm = Alarm(done);
    while let Ok((number, job)) = jobs.recv() {
        let message = worker(job).map_or_else(Message::Failed, |what| Message::Done(number, what));
        let failed = matches!(message, Message::Failed(_));
        if done.send(message).is_err() || failed {
            return;
        }
    }
}

/// Wakes the calling thread if a worker panics; otherwise it would wait forever for that worker's job.
struct Alarm<'a, D, E>(&'a Sender<Message<D, E>>);

impl<D, E> Drop for Alarm<'_, D, E> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _ = self.0.send(Message::Panicked);
        }
    }
}
