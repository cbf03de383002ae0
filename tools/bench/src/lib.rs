//! Scenes and workloads that the benchmarks share, and the stability report.

pub mod building;
pub mod chart;
pub mod counts;
mod heap;
pub mod measured;
pub mod pawns;
pub mod peers;
pub mod random;
pub mod reading;
pub mod scale;
pub mod shared;
pub mod size;
pub mod soak;
pub mod stability;
pub mod thesis;
pub mod voxels;
pub mod walks;
mod watch;

pub use random::Random;
