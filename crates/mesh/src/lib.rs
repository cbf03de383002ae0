//! Triangle meshes: readers of OBJ, PLY, STL and glTF files, and conversion of triangles to the grid.
//!
//! In: mesh files of any size. Out: batches of triangles (metres, z up) in the order of the files. Polygons are
//! triangulated; normals are skipped, and so are colours unless requested. The bytes are untrusted: a damaged file
//! gives a one-line [`Error::Input`], and no number in it sizes an allocation before it is
//! checked. Memory: bounded by [`MeshOptions::memory_bytes`]; vertices that do not fit go to a temporary file.
//!
//! [`raster`] puts triangles on the grid exactly; [`sample`] puts them there as points, like the thesis (algorithm
//! 3.2); `paint` computes the colours of the pieces of triangles.
//!
//! The readers are written here and thin, because the crates for these formats hold whole files in memory, or their
//! structure in a hundred times the bytes of the text.

pub mod paint;
mod read;
pub mod sample;

pub use read::{MeshBatch, MeshCounts, MeshFeed, MeshOptions, MeshSet};
pub use slicewalk_base::raster::{self, Triangle};
use slicewalk_base::{
    Error, Monitor, Parameter, Result, Warning, bytes, colour, disk, frame, placement, plan, text, unit,
};
use slicewalk_input as input;

/// How triangles become voxels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MeshMode {
    /// Every pixel that a triangle touches, its exact heights there, and its true slope.
    #[default]
    Exact,
    /// As points, which the classifier classifies (thesis, algorithm 3.2).
    Sampled {
        /// Greatest distance between neighbouring points (m); the pixel size by default (thesis, equation 3.2).
        step_m: Option<f64>,
    },
}
