//! Batches of collision queries on slice archives, answered by a graphics card.
//!
//! A [`Scene`] uploads the pages of a [`Snapshot`](slicewalk::store::Snapshot) once. [`Scene::ask`] sends a batch of boxes,
//! cylinders, spheres, rays or floors and returns at once; [`Pending::wait`] collects the answers. They equal those of
//! [`slicewalk::query`] bit for bit, and "not loaded" stays an answer of its own.
//!
//! ```no_run
//! use slicewalk::archive::Archive;
//! use slicewalk::query::Aabb;
//! use slicewalk::store::Snapshot;
//! use slicewalk_gpu::{Options, Reply, Scene};
//!
//! let pages = Snapshot::resident(&Archive::open("scan.slices")?, &slicewalk::NoMonitor)?;
//! let (scene, reason) = Scene::open(&pages, &Options::default());
//! if let Some(reason) = reason {
//!     eprintln!("the processor answers: {reason}");
//! }
//! let boxes: Vec<Aabb> = (0..1_000_000)
//!     .map(|n| Aabb::standing([f64::from(n) * 1e-5, 2.0, 0.3].into(), [0.5, 0.5, 1.5].into()))
//!     .collect::<Result<_, _>>()?;
//! let replies = scene.ask(&boxes)?.wait()?;
//! let free = replies.answers.iter().filter(|answer| **answer == Reply::Known(false)).count();
//! println!("{free} of {} boxes are free", boxes.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How the answers stay exact
//!
//! The processor converts coordinates to the grid, in double precision and by the library's own functions. The device
//! decides on integers alone for boxes and floors. For cylinders, spheres and rays it computes in single precision with
//! margins that cover every rounding error, and each answer is certain or undecided. The processor answers what is
//! undecided, and computes the distance of a ray's hit from the spans that the device names.
//! [`Replies::by_processor`] counts those answers.
//!
//! The processor also answers what a device handles badly: shapes over more than 1024 tiles, radii above 65,536 pixels,
//! rays that cross more than 16,384 pixels of the scene, rays that reach a page that is not in memory, and questions that
//! take more steps than drivers allow.

mod device;
mod error;
mod kinds;
mod layout;
mod pending;
mod scene;
#[cfg(all(feature = "convert", not(target_family = "wasm")))]
mod voxels;

pub use device::{Device, Options};
pub use error::{Error, Result};
pub use kinds::{Below, Question, Reply};
pub use pending::{Pending, Replies};
pub use scene::Scene;
#[cfg(all(feature = "convert", not(target_family = "wasm")))]
pub use voxels::VoxelPass;
pub use wgpu;

/// Compiles the examples in Markdown pages.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../../docs/graphics-card.md")]
    struct GraphicsCard;
}
