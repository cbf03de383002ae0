//! Triangle meshes in, exact heights per pixel out.

pub mod raster;

/// Corners of a triangle (m).
pub type Triangle = [[f64; 3]; 3];
