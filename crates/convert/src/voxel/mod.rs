//! The voxel pass: sorts points in any order into the voxels of one tile column after another, in bounded memory.
//!
//! In: batches of points (metres), triangles, which [`surfaces`] puts on the grid, the solid parts of Gaussian splats,
//! which [`ellipsoids`] puts there, and solid cubes, which [`cubes`] does. [`record`] turns each point, and
//! the part of each voxel that a triangle fills, into 8 bytes relative to its tile column. [`runs`] sorts the records
//! by tile column within the memory budget, spilling to disk. [`accumulate`] accumulates the voxels of a column: exact
//! integer bottom, top, count and moments. [`colours`] sums the colours of their points, if the archive gets colours.
//! [`components`] finds small components to drop, [`visibility`] points that other stations of the scan saw through. [`classify`]
//! classifies floors and obstacles, by [`bands`] of slices, and [`spans`] joins the voxels of a pixel. Out: the pages
//! of a column, in archive order.

pub(crate) mod accumulate;
pub(crate) mod bands;
pub(crate) mod classify;
pub(crate) mod colours;
pub(crate) mod components;
pub(crate) mod cubes;
pub(crate) mod ellipsoids;
pub(crate) mod record;
pub(crate) mod runs;
pub(crate) mod spans;
pub(crate) mod spill;
pub(crate) mod surfaces;
pub(crate) mod visibility;
