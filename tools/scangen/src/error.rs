//! Errors: one enum; each text says what failed, where, and, if possible, what to do.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Result of every fallible operation of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Error of this crate. New variants may be added.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused an action on a file.
    Io {
        /// File or folder.
        path: PathBuf,
        /// Attempted action, as a verb phrase.
        action: String,
        /// Reason given by the operating system.
        source: io::Error,
    },
    /// A parameter is invalid.
    Parameter {
        /// Name of the parameter for the user.
        what: String,
        /// Why it is refused, and what is allowed.
        reason: String,
    },
    /// The output format cannot hold the requested data.
    Output {
        /// The file being written.
        path: PathBuf,
        /// Part that does not fit, and what to do.
        reason: String,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io { path, action, source } => write!(f, "{}: cannot {action}: {source}", path.display()),
            Self::Parameter { what, reason } => write!(f, "{what}: {reason}"),
            Self::Output { path, reason } => write!(f, "{}: {reason}", path.display()),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } => Some(source),
            _ => None,
        }
    }
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
