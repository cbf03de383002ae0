//! What [`publish`](super::publish) is made of; its model in `tests/publish.rs` puts loom's in place of these.

pub(super) use std::hint::spin_loop as pause;
pub(super) use std::sync::atomic::AtomicUsize;
pub(super) use std::sync::{Arc, RwLock, RwLockReadGuard};
