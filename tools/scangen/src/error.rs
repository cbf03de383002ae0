//! Errors: one enum; each text says what failed, where, and, if possible, what to do.

use std::io;
use std::path::{Path, PathBuf};

/// Result of every fallible operation of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Error of this crate. New variants may be added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused an action on a file.
    #[error("{path}: cannot {action}: {source}", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Attempted action, as a verb phrase.
        action: String,
        /// Reason given by the operating system.
        source: io::Error,
    },
    /// A parameter is invalid.
    #[error("{what}: {reason}")]
    Parameter {
        /// Name of the parameter for the user.
        what: String,
        /// Why it is refused, and what is allowed.
        reason: String,
    },
    /// The output format cannot hold the requested data.
    #[error("{path}: {reason}", path = path.display())]
    Output {
        /// The file being written.
        path: PathBuf,
        /// Part that does not fit, and what to do.
        reason: String,
    },
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: impl AsRef<Path>, action: impl Into<String>, source: io::Error) -> Self {
        Self::Io { path: path.as_ref().to_path_buf(), action: action.into(), source }
    }

    /// An [`Error::Parameter`].
    pub fn parameter(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Parameter { what: what.into(), reason: reason.into() }
    }

    /// An [`Error::Output`] for `path`.
    pub fn output(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Output { path: path.as_ref().to_path_buf(), reason: reason.into() }
    }
}
