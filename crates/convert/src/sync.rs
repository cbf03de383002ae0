//! Primitives of the job hand-over; `tests/schedules.rs` replaces them by shuttle's types.

pub use crate::bytes::HAS_THREADS;
pub use crossbeam_channel::{Receiver, Sender, bounded};
pub use std::thread::{Scope, scope};

/// Starts a thread of `scope`; the system may refuse it.
pub fn start<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    work: impl FnOnce() + Send + 'scope,
) -> std::io::Result<()> {
    crate::bytes::spawn_in(scope, work).map(|_| ())
}
