//! Walk in laser scans too large for memory.

pub mod error;
pub mod monitor;

pub mod frame;

pub mod plan;

pub mod slice;

pub mod store;

pub mod query;

pub use error::{Error, Result};
pub use monitor::{Monitor, NoMonitor};
