//! Errors: one enum; every text says what, where, expected and found, and the way out where there is one.

use std::io;
use std::path::{Path, PathBuf};

/// Result of every fallible operation of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong. New variants may be added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused an action on a file.
    #[error("{path}: cannot {action}: {source}", path = path.display())]
    Io {
        /// File or folder acted on.
        path: PathBuf,
        /// What was tried, as a verb phrase: "open", "read 512 bytes at 4096".
        action: String,
        /// The operating system's own reason.
        source: io::Error,
    },
    /// An input file (scan or mesh) cannot be used.
    #[error("{path}: {at}: {reason}", path = path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// Where in it: "header, byte 96", "point 1064", "LAZ chunk 3".
        at: String,
        /// What was expected and found, and the way out.
        reason: String,
    },
    /// An archive breaks a rule of `spec/slice-archive.md`.
    #[error("rule {rule}: {part} at byte {offset}: expected {expected}, found {found}")]
    Format {
        /// Rule id of the specification, for example `H1`.
        rule: &'static str,
        /// Part of the archive: "header", "directory leaf 3", "page (4, -2, 0)".
        part: String,
        /// Byte offset of the part in the archive.
        offset: u64,
        /// What the rule asks for.
        expected: String,
        /// What the bytes say.
        found: String,
    },
    /// A value lies beyond a stated limit.
    #[error("{what}: {value} is beyond the limit of {max}")]
    Limit {
        /// The limited thing, with the way out.
        what: String,
        /// Value found.
        value: String,
        /// Greatest (or least) value allowed.
        max: String,
    },
    /// A valid file uses something that this version does not read.
    #[error("{what}: not supported by this version ({version}); {way_out}")]
    Unsupported {
        /// What the file asks for.
        what: String,
        /// Version of this crate.
        version: &'static str,
        /// What the user can do.
        way_out: String,
    },
    /// A parameter makes no sense.
    #[error("{what}: {reason}")]
    Parameter {
        /// The parameter.
        what: Parameter,
        /// Why it is refused and what is allowed.
        reason: String,
    },
    /// A file must not be written under this name; what is there stays.
    #[error("{path}: {reason}", path = path.display())]
    Output {
        /// The name as it was given.
        path: PathBuf,
        /// Why not, and the way out.
        reason: String,
    },
    /// A file is complete under its name, but its folder could not be synced: after a power failure the folder may be as
    /// it was before.
    #[error(
        "{path}: complete under this name, but its folder could not be synced: {source}; a power failure may undo that",
        path = path.display()
    )]
    NotDurable {
        /// The complete file.
        path: PathBuf,
        /// The operating system's own reason.
        source: io::Error,
    },
    /// The user or the calling program asked to stop; nothing was published.
    #[error("interrupted: nothing was written")]
    Interrupted,
    /// A conversion failed and left temporary data from which another one can go on (`ConvertOptions::resume`).
    #[error(
        "{source}; --resume goes on from {points} points, {bytes} bytes of temporary data in {path}",
        path = path.display()
    )]
    Resumable {
        /// Why it failed.
        source: Box<Error>,
        /// The temporary data.
        path: PathBuf,
        /// Their length.
        bytes: u64,
        /// Points of the input that need not be read again.
        points: u64,
    },
}

/// What an [`Error::Parameter`] is about. A program that has an option of its own for it names that option instead.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Parameter {
    /// The edge of a pixel.
    PixelSize,
    /// The pixel size that was to follow from the input.
    AutomaticPixelSize,
    /// The height of a slice.
    SliceHeight,
    /// The steepest slope that can be stood on.
    MaxSlope,
    /// How far heights may be coarsened.
    Tolerance,
    /// The least number of points in a voxel.
    MinPoints,
    /// The memory budget of a conversion.
    Memory,
    /// The unit of the input.
    Units,
    /// Which part of a conversion is asked for.
    Shard,
    /// The plan of a conversion or of a recovery.
    Plan,
    /// The region to cut out of an archive.
    Bounds,
    /// A parameter of a pawn or of its walk, by name: its speed, its climb height.
    Pawn(&'static str),
    /// Anything else, by name.
    Other(String),
}

impl std::fmt::Display for Parameter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::PixelSize => "pixel size",
            Self::AutomaticPixelSize => "automatic pixel size",
            Self::SliceHeight => "slice height",
            Self::MaxSlope => "maximum slope",
            Self::Tolerance => "tolerance",
            Self::MinPoints => "least points of a voxel",
            Self::Memory => "memory budget",
            Self::Units => "unit of the input",
            Self::Shard => "shard",
            Self::Plan => "plan",
            Self::Bounds => "bounds",
            Self::Pawn(name) => name,
            Self::Other(name) => name,
        })
    }
}

impl<T: Into<String>> From<T> for Parameter {
    fn from(name: T) -> Self {
        Self::Other(name.into())
    }
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: impl AsRef<Path>, action: impl Into<String>, source: io::Error) -> Self {
        Self::Io { path: path.as_ref().to_path_buf(), action: action.into(), source }
    }

    /// An [`Error::Input`] for `path`.
    pub fn input(path: impl AsRef<Path>, at: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Input { path: path.as_ref().to_path_buf(), at: at.into(), reason: reason.into() }
    }

    /// An [`Error::Output`] for `path`.
    pub fn output(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Output { path: path.as_ref().to_path_buf(), reason: reason.into() }
    }

    /// An [`Error::Format`]; `rule` is the id in the specification.
    pub fn format(
        rule: &'static str,
        part: impl Into<String>,
        offset: u64,
        expected: impl ToString,
        found: impl ToString,
    ) -> Self {
        Self::Format { rule, part: part.into(), offset, expected: expected.to_string(), found: found.to_string() }
    }

    /// An [`Error::Parameter`].
    pub fn parameter(what: impl Into<Parameter>, reason: impl Into<String>) -> Self {
        Self::Parameter { what: what.into(), reason: reason.into() }
    }
}
