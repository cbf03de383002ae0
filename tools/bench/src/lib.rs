//! Scenes and workloads that the benchmarks share, and the stability report.

pub mod building;
pub mod chart;
mod heap;
pub mod pawns;
pub mod peers;
pub mod random;
pub mod size;
pub mod soak;
pub mod stability;
pub mod thesis;
pub mod voxels;
pub mod walks;

pub use random::Random;
