//! Foundation of the slicewalk crates: errors, progress, the grid, plans, units, colours, byte sources and atomic files.
//!
//! Programs use these through `slicewalk`, which re-exports what its interface needs. This crate makes no promise of its own.
#![allow(clippy::len_without_is_empty, reason = "lengths of files, in bytes")]

pub mod bytes;
pub mod colour;
pub mod disk;
pub mod error;
pub mod frame;
pub mod monitor;
pub mod output;
pub mod placement;
pub mod plan;
pub mod raster;
pub mod sort;
pub mod text;
pub mod unit;

pub use error::{Error, Parameter, Result};
pub use monitor::{Monitor, NoMonitor, Warning};
