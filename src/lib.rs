//! Walk in laser scans too large for memory.

pub mod error;
pub mod monitor;

pub mod frame;

pub mod bytes;

pub mod plan;

pub mod unit;

#[cfg(feature = "convert")]
pub mod input;

pub mod mesh;

#[cfg(feature = "convert")]
mod voxel;

pub mod slice;

pub mod codec;

pub mod archive;

pub mod stats;

#[cfg(feature = "convert")]
pub mod convert;

#[cfg(feature = "cli")]
pub mod info;

#[cfg(feature = "cli")]
pub mod size;

pub mod store;

pub mod query;

pub mod object;

pub mod walk;

pub use error::{Error, Result};
pub use monitor::{Monitor, NoMonitor};
