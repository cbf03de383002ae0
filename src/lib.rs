//! Walk in laser scans too large for memory.

pub mod error;
pub mod monitor;

pub mod frame;

pub mod plan;

#[cfg(feature = "convert")]
pub mod input;

pub mod slice;

#[cfg(feature = "convert")]
mod voxel;

pub use error::{Error, Result};
pub use monitor::{Monitor, NoMonitor};
