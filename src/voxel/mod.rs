//! The voxel pass: points in any order to the voxels of one tile column after another, in bounded memory.
//!
//! In: batches of points in metres, and triangles, which [`surfaces`] takes to the grid. [`record`] turns each point, and
//! what a triangle fills of each voxel, into 8 bytes relative to its tile column, [`runs`] sorts
//! them by tile column within the memory budget, on disk where they do not fit, and [`fold`] makes the voxels of a
//! column: exact integer bottom, top, count and moments; [`colours`] sums the colours of their points, where the archive gets colours. [`floaters`] finds small pieces of matter that are to be dropped, [`views`]
//! points that other stations of the scan saw through. [`judge`] tells obstacles from floors, by [`bands`] of slices, and
//! [`spans`] joins the voxels of a pixel. Out: the pages of a column, in archive order.

pub(crate) mod bands;
pub(crate) mod colours;
pub(crate) mod floaters;
pub(crate) mod fold;
pub(crate) mod judge;
pub(crate) mod record;
pub(crate) mod runs;
pub(crate) mod spans;
pub(crate) mod spill;
pub(crate) mod surfaces;
pub(crate) mod views;
