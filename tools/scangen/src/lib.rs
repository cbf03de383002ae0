//! Seeded scan generator with closed-form truth.
//!
//! ```text
//! Scene (surfaces in closed form) ─┬─ Truth: distances, floors, ceilings, slopes, rays     → truth.json, scene.obj
//!                                  └─ Sampler: direct or scanner, noise, outliers, seeds   → LAS, E57, text of any size
//! ```
//!
//! The truth is computed from the surfaces, never from the points, and shares no code with the library under test. A
//! seed gives the same points on every platform: the generator is ChaCha8, arithmetic is `+ - * / sqrt` and a portable
//! `libm`. Memory is bounded: points are drawn, written and dropped.
//!
//! ```
//! use scangen::{Params, SampleSpec, Scene, Truth};
//!
//! let stairs = Scene::named("stairs", &Params::new().with("riser", 0.18))?;
//! let points: Vec<[f64; 3]> = stairs.points(7, &SampleSpec::direct_count(1000))?.collect();
//! assert_eq!(points.len(), 1000);
//! assert!(points.iter().all(|p| stairs.distance_to_point(*p) < 1e-9));
//! # Ok::<(), scangen::Error>(())
//! ```

mod bvh;
mod error;
pub mod geometry;
mod params;

pub mod shape;

pub mod scene;

mod truth;

pub mod sample;

pub mod write;

pub mod demo;

pub use error::{Error, Result};
pub use params::{ParamInfo, Params};
pub use sample::{Kind, Sample, SampleSpec};
pub use scene::{SCENES, Scene, Surface, Walk};
pub use truth::Truth;
pub use write::{Chunks, CloudFormat, Texture, WriteSpec, Written, write_clouds, write_las, write_samples};
