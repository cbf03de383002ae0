//! Failures of a device.

use std::fmt;

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Reason why a device does not answer. No answer is ever wrong: a batch has all of its answers or fails.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Error {
    /// There is no graphics card, or no driver that wgpu can use.
    NoAdapter {
        /// Findings of the search.
        reason: String,
    },
    /// The adapter refuses to open a device.
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// Words of the driver.
        reason: String,
    },
    /// Something is larger than the device allows.
    TooLarge {
        /// Name of it.
        what: &'static str,
        /// Its size.
        found: u64,
        /// Greatest size that the device allows.
        limit: u64,
    },
    /// The device has not enough memory.
    OutOfMemory {
        /// Words of the driver.
        reason: String,
    },
    /// The device is gone: removed, reset or destroyed. Open another one and upload the pages again.
    Lost {
        /// Words of the driver.
        reason: String,
    },
    /// The device fails for another reason.
    Failed {
        /// Words of the driver.
        reason: String,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoAdapter { reason } => {
                write!(
                    f,
                    "no graphics card: {reason}; install a Vulkan, Metal or DirectX 12 driver, or use the processor"
                )
            }
            Self::NoDevice { adapter, reason } => {
                write!(f, "{adapter}: cannot open the device: {reason}; update the driver, or use the processor")
            }
            Self::TooLarge { what, found, limit } => write!(
                f,
                "{what}: too large for the device (expected at most {limit}, found {found}); use a part of the scene, or \
                 the processor"
            ),
            Self::OutOfMemory { reason } => {
                write!(f, "out of memory on the device: {reason}; use a part of the scene or smaller batches")
            }
            Self::Lost { reason } => write!(f, "device lost: {reason}; open another device and upload the pages again"),
            Self::Failed { reason } => {
                write!(f, "the device failed: {reason}; update the driver, or use the processor")
            }
        }
    }
}

impl std::error::Error for Error {}
