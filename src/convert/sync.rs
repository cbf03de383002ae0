//! What the hand-over of jobs is made of; `tests/schedules.rs` puts shuttle's types in place of these.

pub use crossbeam_channel::{Receiver, Sender, bounded};
pub use std::thread::{Scope, scope};

/// Starts a thread of `scope`, which the system may refuse.
pub fn start<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    work: impl FnOnce() + Send + 'scope,
) -> std::io::Result<()> {
    crate::bytes::spawn_in(scope, work).map(|_| ())
}
