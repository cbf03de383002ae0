//! Scenes and workloads that the benchmarks share, and the stability report.

pub mod building;
#[cfg(feature = "peers")]
pub mod chart;
pub mod counts;
#[path = "../../../tests/common/data.rs"]
pub mod data;
#[cfg(feature = "peers")]
pub mod goals;
#[cfg(feature = "peers")]
mod heap;
#[cfg(feature = "peers")]
pub mod inputs;
pub mod lossy;
pub mod measured;
pub mod pawns;
#[cfg(feature = "peers")]
pub mod peers;
pub mod random;
pub mod reading;
#[cfg(feature = "peers")]
pub mod scale;
pub mod size;
pub mod soak;
pub mod stability;
#[cfg(feature = "peers")]
pub mod thesis;
mod venv;
pub mod voxels;
pub mod walks;
mod watch;
#[cfg(feature = "peers")]
pub mod ways;

pub use random::Random;
