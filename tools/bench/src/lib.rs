//! Scenes and workloads that the benchmarks share.

pub mod building;
pub mod pawns;
pub mod random;
pub mod voxels;

pub use random::Random;
