//! Triangle meshes: readers of OBJ, PLY, STL and glTF files, and conversion of triangles to the grid.
//!
//! In: mesh files of any size. Out: batches of triangles (metres, z up) in the order of the files. Polygons are
//! triangulated; normals are skipped, and so are colours unless requested. The bytes are untrusted: a damaged file
//! gives a one-line [`Error::Input`](crate::Error::Input), and no number in it sizes an allocation before it is
//! checked. Memory: bounded by [`MeshOptions::memory_bytes`]; vertices that do not fit go to a temporary file.
//!
//! [`raster`] puts triangles on the grid exactly; [`sample`] puts them there as points, like the thesis (algorithm
//! 3.2); `paint` computes the colours of the pieces of triangles.
//!
//! The readers are written here and thin, because the crates for these formats hold whole files in memory, or their
//! structure in a hundred times the bytes of the text.

#[cfg(feature = "convert")]
pub(crate) mod paint;
pub mod raster;
pub mod sample;

#[cfg(feature = "convert")]
mod read;

#[cfg(feature = "convert")]
pub(crate) use read::MeshBatch;
#[cfg(feature = "convert")]
pub use read::{MeshCounts, MeshFeed, MeshOptions, MeshSet};

/// Corners of a triangle (m).
pub type Triangle = [[f64; 3]; 3];

/// How triangles become voxels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
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
