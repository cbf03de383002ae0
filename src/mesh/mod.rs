//! Triangle meshes in: OBJ, PLY, STL and glTF files to triangles in metres, z up, and triangles to the grid.
//!
//! In: mesh files of any size. Out: triangles one batch after another, in the order of the files. Polygons are cut into
//! triangles; normals are passed over, and colours too unless they are wanted. No byte of a file is trusted: a damaged one
//! gives an [`Error::Input`](crate::Error::Input) of one line, and no number in it sizes anything before it is checked.
//! Memory: bounded by [`MeshOptions::memory_bytes`]; corners that do not fit it wait in a temporary file.
//!
//! [`raster`] takes triangles to the grid exactly, [`sample`] as points, the thesis' way (algorithm 3.2); `paint` gives the pieces of
//! triangles their colours.
//!
//! The readers are our own and thin, because the crates for these formats hold whole files in memory, or their structure in
//! a hundred times the bytes of the text.

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
    /// As points (thesis, algorithm 3.2), which are judged by the classifier.
    Sampled {
        /// Greatest distance of neighbouring points (m); the pixel size by default (thesis, equation 3.2).
        step_m: Option<f64>,
    },
}
