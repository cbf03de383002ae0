//! Speed and size charted against accuracy, ours beside its peers.

pub mod draw;
pub mod walkable;
