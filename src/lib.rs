//! Walk in laser scans that are too large for memory.
//!
//! Slicewalk converts scans of any size (LAS, LAZ, E57, PTX, PTS, XYZ, PCD, PLY), meshes, Gaussian splats and cubes into
//! one compact *slice archive*. For every pixel of the ground plan, the archive holds the bottom, the top and an
//! obstacle flag of each vertical solid run (a *span*). A program opens the archive, keeps the pages around a moving body
//! in memory, and asks exact collision queries that never wait for the disk. The method comes from R. K. dos Anjos,
//! *Image Based Collision Detection* (IST Lisbon, 2011), and its future work.
//!
//! # Convert
//!
//! The program `sliceconv` and the crate `slicewalk-convert` read points and triangles in any order, in bounded memory,
//! and publish the archive when it is complete. The same points always give the same bytes.
//!
//! # Open and query
//!
//! [`Archive`](archive::Archive) reads an archive from a file, from memory or from any
//! [`ByteSource`](bytes::ByteSource). A [`Snapshot`](store::Snapshot) holds its pages in memory, all of
//! them or those around a body, and [`query`] has the queries. An answer errs only towards "hit", and by less than a pixel and a slice.
//!
//! ```no_run
//! use slicewalk::archive::Archive;
//! use slicewalk::nalgebra::{Point3, Vector3};
//! use slicewalk::query::{Aabb, Answer, Overlap, Ray, cast, floor_under, overlaps};
//! use slicewalk::store::Snapshot;
//!
//! let pages = Snapshot::resident(&Archive::open("scan.slices")?, &slicewalk::NoMonitor)?;
//! let pawn = Aabb::standing(Point3::new(12.0, 7.5, 1.2), Vector3::new(0.5, 0.5, 1.8))?;
//! let free = overlaps(&pages, &pawn) == Overlap::Clear;
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! # Walk
//!
//! A [`Walker`](walk::Walker) is a pawn that falls, climbs stairs and is blocked by walls. Its path does not depend on
//! the frame rate.
//!
//! ```no_run
//! # use slicewalk::archive::Archive;
//! # use slicewalk::store::Snapshot;
//! # let pages = Snapshot::resident(&Archive::open("scan.slices")?, &slicewalk::NoMonitor)?;
//! use slicewalk::nalgebra::{Point3, Vector2};
//! use slicewalk::walk::{Config, Walker, MoveInput};
//!
//! let mut pawn = Walker::new(Config::default(), Point3::new(12.0, 7.5, 1.2))?;
//! for _frame in 0..600 {
//!     pawn.step(&pages, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
//! }
//! println!("{} {:?}", pawn.feet(), pawn.state());
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! # Stream
//!
//! If the archive is larger than memory, a [`Stream`](store::Stream) keeps the pages around moving bodies within a byte
//! budget and loads them before they are needed. Queries run on a [`Snapshot`](store::Snapshot) of the stream: they take no
//! lock, do no I/O and allocate nothing. If a page is not in memory, the answer is "not loaded", never "free".
//!
//! ```no_run
//! use slicewalk::archive::Archive;
//! use slicewalk::nalgebra::{Point3, Vector2};
//! use slicewalk::store::{Stream, StreamOptions};
//! use slicewalk::walk::{Config, Walker, MoveInput};
//!
//! let stream = Stream::open(Archive::open("city.slices")?, StreamOptions::new(64 << 20))?;
//! let mut body = stream.pawn();
//! let mut pawn = Walker::new(Config::default(), Point3::new(12.0, 7.5, 1.2))?;
//! for _frame in 0..600 {
//!     let pages = stream.snapshot();
//!     body.hint(&pawn.motion_hint(stream.archive().frame()));
//!     let report = pawn.step(&pages, 1.0 / 60.0, MoveInput::Direction(Vector2::x()));
//!     if let Some(missing) = report.missing {
//!         body.need(&missing); // the pawn waits in place until these pages are there
//!     }
//! }
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! # Modules
//!
//! | task | module |
//! |---|---|
//! | read, check, merge, recover and cut archives | [`archive`], [`stats`] |
//! | read bytes from other sources | [`bytes`] |
//! | keep pages in memory | [`store`], [`page`] |
//! | query | [`query`], [`object`] |
//! | tell free space from space that no scanner saw | [`seen`] |
//! | walk | [`walk`] |
//! | find where a pawn can walk, and routes | [`reach`] |
//! | add and remove solids without changing the archive | [`edit`] |
//! | the grid, options of archives, units, errors, progress | [`frame`], [`plan`], [`unit`](mod@unit), [`error`], [`monitor`] |
//!
//! Without features the crate needs nothing that a browser lacks.

pub mod archive;
pub mod codec;
pub mod edit;
pub mod object;
pub mod page;
pub mod query;
pub mod reach;
pub mod seen;
pub mod stats;
pub mod store;
pub mod walk;

#[cfg(test)]
#[path = "../tests/common/random.rs"]
mod random;

pub use nalgebra;
pub use slicewalk_base::{Error, Monitor, NoMonitor, Parameter, Result, Warning};
pub use slicewalk_base::{bytes, colour, error, frame, monitor, plan, unit};
use slicewalk_base::{disk, output, raster, sort, text};

/// Compiles the examples in Markdown pages.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../README.md")]
    struct Readme;
    #[doc = include_str!("../docs/formats.md")]
    struct Formats;
}
