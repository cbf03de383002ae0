//! Errors: one enum. Every message says what is wrong and where, what was expected and found, and what to do if
//! anything helps.

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
    #[non_exhaustive]
    Io {
        /// File or folder acted on.
        path: PathBuf,
        /// Attempted action, as a verb phrase: "open", "read 512 bytes at 4096".
        action: String,
        /// Reason given by the operating system.
        source: io::Error,
        /// Parameter that would help if changed.
        suggestion: Option<Parameter>,
    },
    /// An input file (scan or mesh) cannot be used.
    #[non_exhaustive]
    Input {
        /// The file.
        path: PathBuf,
        /// Position in the file: "header, byte 96", "point 1064", "LAZ chunk 3".
        at: String,
        /// Expected and found values, and what to do.
        reason: String,
        /// Parameter that would help if changed.
        suggestion: Option<Parameter>,
    },
    /// An archive breaks a rule of `spec/slice-archive.md`.
    Format {
        /// Rule id of the specification, for example `H1`.
        rule: &'static str,
        /// Part of the archive: "header", "directory leaf 3", "page (4, -2, 0)".
        part: String,
        /// Byte offset of the part in the archive.
        offset: u64,
        /// Requirement of the rule.
        expected: String,
        /// Content of the bytes.
        found: String,
    },
    /// A value lies beyond a stated limit.
    #[non_exhaustive]
    Limit {
        /// Limited quantity, with what to do.
        what: String,
        /// Value found.
        value: String,
        /// Greatest (or least) value allowed.
        max: String,
        /// Parameter that would help if changed.
        suggestion: Option<Parameter>,
    },
    /// A valid file uses a feature that this version does not read.
    Unsupported {
        /// Feature that the file uses.
        what: String,
        /// Version of this crate.
        version: &'static str,
        /// Advice for the user.
        suggestion: String,
    },
    /// A parameter has an invalid value.
    Parameter {
        /// The parameter.
        what: Parameter,
        /// Reason for the refusal, and allowed values.
        reason: String,
    },
    /// A file must not be written under this name; the existing file stays.
    #[non_exhaustive]
    Output {
        /// Name as given by the user.
        path: PathBuf,
        /// Reason for the refusal, and what to do.
        reason: String,
        /// Parameter that would help if changed.
        suggestion: Option<Parameter>,
    },
    /// A file is complete under its name, but its folder could not be synced: a power failure may restore the previous
    /// state of the folder.
    NotDurable {
        /// The complete file.
        path: PathBuf,
        /// Reason given by the operating system.
        source: io::Error,
    },
    /// The user or the calling program asked to stop; nothing was published.
    Interrupted,
    /// A conversion failed and left temporary data from which another run can continue (`ConvertOptions::resume`).
    Resumable {
        /// Reason of the failure.
        source: Box<Error>,
        /// Path of the temporary data.
        path: PathBuf,
        /// Length of the data (bytes).
        bytes: u64,
        /// Points of the input that need not be read again.
        points: u64,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Reason(self).fmt(f)?;
        self.suggestion().map_or(Ok(()), |parameter| write!(f, "; {}", parameter.advice()))
    }
}

/// The message without advice.
struct Reason<'a>(&'a Error);

impl fmt::Display for Reason<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Error::Io { path, action, source, .. } => write!(f, "{}: cannot {action}: {source}", path.display()),
            Error::Input { path, at, reason, .. } => write!(f, "{}: {at}: {reason}", path.display()),
            Error::Format { rule, part, offset, expected, found } => {
                write!(f, "rule {rule}: {part} at byte {offset}: expected {expected}, found {found}")
            }
            Error::Limit { what, value, max, .. } => write!(f, "{what}: {value} is beyond the limit of {max}"),
            Error::Unsupported { what, version, suggestion } => {
                write!(f, "{what}: not supported by this version ({version}); {suggestion}")
            }
            Error::Parameter { what, reason } => write!(f, "{what}: {reason}"),
            Error::Output { path, reason, .. } => write!(f, "{}: {reason}", path.display()),
            Error::NotDurable { path, source } => write!(
                f,
                "{}: complete under this name, but its folder could not be synced: {source}; a power failure may undo that",
                path.display()
            ),
            Error::Interrupted => f.write_str("interrupted: nothing was written"),
            Error::Resumable { source, path, bytes, points } => write!(
                f,
                "{source}; resuming continues from {points} points, {bytes} bytes of temporary data in {}",
                path.display()
            ),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } | Self::NotDurable { source, .. } => Some(source),
            Self::Resumable { source, .. } => Some(source),
            _ => None,
        }
    }
}

/// Subject of an [`Error::Parameter`], or a parameter that would help in another error ([`Error::suggestion`]). A program
/// that has its own option for the parameter names that option instead ([`Error::render`]).
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Parameter {
    /// Edge of a pixel.
    PixelSize,
    /// Pixel size that should have followed from the input.
    AutomaticPixelSize,
    /// Height of a slice.
    SliceHeight,
    /// Steepest slope that can be stood on.
    MaxSlope,
    /// Tolerance to which heights may be coarsened.
    Tolerance,
    /// Least number of points in a voxel.
    MinPoints,
    /// Widest holes in floors that are closed.
    FillHoles,
    /// Source of colours.
    Colour,
    /// Greatest difference of colours.
    ColourError,
    /// Memory budget of a conversion.
    Memory,
    /// Number of worker threads.
    Threads,
    /// Folder for temporary data.
    TempDir,
    /// Memory budget of streamed pages.
    Cache,
    /// Permission to convert the readable part of incomplete input.
    Incomplete,
    /// Permission to replace an existing file.
    Overwrite,
    /// Unit of the input.
    Units,
    /// Columns of text that hold the coordinates.
    Columns,
    /// Part of a conversion.
    Shard,
    /// Resuming from the data of an earlier conversion.
    Resume,
    /// Positions of scanners.
    Stations,
    /// Names of scans and meshes.
    Input,
    /// Plan of a conversion or of a recovery.
    Plan,
    /// Region of an archive.
    Bounds,
    /// Parameter of a pawn or of its walk, by name: its speed, its climb height.
    Pawn(&'static str),
    /// Parameter of Gaussian splats, by name: their opacity, their greatest size.
    Splats(&'static str),
    /// Any other parameter, by name.
    Other(String),
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PixelSize => "pixel size",
            Self::AutomaticPixelSize => "automatic pixel size",
            Self::SliceHeight => "slice height",
            Self::MaxSlope => "maximum slope",
            Self::Tolerance => "tolerance",
            Self::MinPoints => "least points of a voxel",
            Self::FillHoles => "widest holes to close",
            Self::Colour => "colour",
            Self::ColourError => "error of colours",
            Self::Memory => "memory budget",
            Self::Threads => "number of threads",
            Self::TempDir => "folder for temporary data",
            Self::Cache => "cache",
            Self::Incomplete => "incomplete input",
            Self::Overwrite => "replacing of files",
            Self::Units => "unit of the input",
            Self::Columns => "columns of text",
            Self::Shard => "shard",
            Self::Resume => "resuming",
            Self::Stations => "stations",
            Self::Input => "input",
            Self::Plan => "plan",
            Self::Bounds => "bounds",
            Self::Pawn(name) | Self::Splats(name) => name,
            Self::Other(name) => name,
        })
    }
}

impl Parameter {
    /// Returns the advice for a caller of the library, as the end of a sentence.
    pub fn advice(&self) -> String {
        match self {
            Self::PixelSize => "give a larger pixel size, or the unit of the input".into(),
            Self::Units => "set the unit of the input".into(),
            Self::Memory => "give more memory".into(),
            Self::TempDir => "choose a folder with space for temporary data".into(),
            Self::Cache => "give a larger cache".into(),
            Self::Incomplete => "or allow incomplete input, to take what can be read".into(),
            Self::Overwrite => "allow it to be replaced".into(),
            Self::Plan => "give its plan".into(),
            Self::Input => "check the name: a file, a folder, or a pattern such as tiles/*.laz".into(),
            Self::Columns => "name the columns, such as x,y,z".into(),
            other => format!("set the {other} otherwise"),
        }
    }
}

impl<T: Into<String>> From<T> for Parameter {
    fn from(name: T) -> Self {
        Self::Other(name.into())
    }
}

impl Error {
    /// Makes an [`Error::Io`] for `path`.
    pub fn io(path: impl AsRef<Path>, action: impl Into<String>, source: io::Error) -> Self {
        Self::Io { path: path.as_ref().to_path_buf(), action: action.into(), source, suggestion: None }
    }

    /// Makes an [`Error::Input`] for `path`.
    pub fn input(path: impl AsRef<Path>, at: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Input { path: path.as_ref().to_path_buf(), at: at.into(), reason: reason.into(), suggestion: None }
    }

    /// Makes an [`Error::Output`] for `path`.
    pub fn output(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Output { path: path.as_ref().to_path_buf(), reason: reason.into(), suggestion: None }
    }

    /// Makes an [`Error::Limit`].
    pub fn limit(what: impl Into<String>, value: impl ToString, max: impl ToString) -> Self {
        Self::Limit { what: what.into(), value: value.to_string(), max: max.to_string(), suggestion: None }
    }

    /// Adds the parameter that would help if changed. Variants without a field for it stay unchanged.
    pub fn with_suggestion(mut self, parameter: Parameter) -> Self {
        if let Self::Io { suggestion, .. }
        | Self::Input { suggestion, .. }
        | Self::Limit { suggestion, .. }
        | Self::Output { suggestion, .. } = &mut self
        {
            *suggestion = Some(parameter);
        }
        self
    }

    /// Returns the parameter that would help if changed.
    pub fn suggestion(&self) -> Option<&Parameter> {
        match self {
            Self::Io { suggestion, .. }
            | Self::Input { suggestion, .. }
            | Self::Limit { suggestion, .. }
            | Self::Output { suggestion, .. } => suggestion.as_ref(),
            _ => None,
        }
    }

    /// Returns the message with a program's own advice: `advise` names its option, or returns `None` if it has none.
    pub fn render(&self, advise: impl FnOnce(&Parameter) -> Option<&'static str>) -> String {
        match self.suggestion().and_then(advise) {
            Some(advice) => format!("{}; {advice}", Reason(self)),
            None => self.to_string(),
        }
    }

    /// Makes an [`Error::Format`]; `rule` is the id in the specification.
    pub fn format(
        rule: &'static str,
        part: impl Into<String>,
        offset: u64,
        expected: impl ToString,
        found: impl ToString,
    ) -> Self {
        Self::Format { rule, part: part.into(), offset, expected: expected.to_string(), found: found.to_string() }
    }

    /// Makes an [`Error::Parameter`].
    pub fn parameter(what: impl Into<Parameter>, reason: impl Into<String>) -> Self {
        Self::Parameter { what: what.into(), reason: reason.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_names_its_own_option_as_the_way_out() {
        let error = Error::limit("points", 5, 4).with_suggestion(Parameter::Memory);
        assert_eq!(error.to_string(), "points: 5 is beyond the limit of 4; give more memory");
        assert_eq!(
            error.render(|_| Some("give more --memory")),
            "points: 5 is beyond the limit of 4; give more --memory"
        );
        assert_eq!(error.render(|_| None), error.to_string());
        let plain = Error::input("a.las", "header", "is short");
        assert_eq!(plain.render(|_| Some("never said")), "a.las: header: is short");
        assert_eq!(Error::Interrupted.with_suggestion(Parameter::Memory).suggestion(), None);
    }

    #[test]
    fn each_parameter_has_a_name_and_advice_of_its_own() {
        let all = [
            Parameter::PixelSize,
            Parameter::AutomaticPixelSize,
            Parameter::SliceHeight,
            Parameter::MaxSlope,
            Parameter::Tolerance,
            Parameter::MinPoints,
            Parameter::FillHoles,
            Parameter::Colour,
            Parameter::ColourError,
            Parameter::Memory,
            Parameter::Threads,
            Parameter::TempDir,
            Parameter::Cache,
            Parameter::Incomplete,
            Parameter::Overwrite,
            Parameter::Units,
            Parameter::Columns,
            Parameter::Shard,
            Parameter::Resume,
            Parameter::Stations,
            Parameter::Input,
            Parameter::Plan,
            Parameter::Bounds,
            Parameter::Pawn("speed"),
            Parameter::Splats("opacity"),
            "depth".into(),
        ];
        for texts in [all.each_ref().map(Parameter::to_string), all.each_ref().map(Parameter::advice)] {
            let distinct: std::collections::BTreeSet<_> = texts.iter().filter(|text| !text.is_empty()).collect();
            assert_eq!(distinct.len(), all.len(), "{texts:?}");
        }
    }

    #[test]
    fn errors_give_their_causes() {
        use std::error::Error as _;
        let refused = || io::Error::from(io::ErrorKind::PermissionDenied);
        let source = Box::new(Error::io("a.las", "open", refused()));
        let resumable = Error::Resumable { source, path: "spilled".into(), bytes: 1, points: 2 };
        let cause = resumable.source().unwrap();
        assert!(cause.to_string().starts_with("a.las: cannot open"), "{cause}");
        assert!(cause.source().is_some_and(|innermost| innermost.is::<io::Error>()));
        let not_durable = Error::NotDurable { path: "a".into(), source: refused() };
        assert!(not_durable.source().is_some_and(|cause| cause.is::<io::Error>()));
        assert!(Error::Interrupted.source().is_none() && Error::limit("points", 5, 4).source().is_none());
    }
}
