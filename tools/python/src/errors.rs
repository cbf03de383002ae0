//! Exceptions of `slicewalk.errors`, with the fields of the library's errors as attributes.

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slicewalk::frame::PageKey;
use slicewalk::store::Missing;
use slicewalk::{Error, Parameter};

/// Reason of a failure.
pub enum Failure {
    /// Error of the library.
    Error(Error),
    /// Pages that are not in memory.
    NotLoaded(Vec<PageKey>),
    /// Python exception.
    Raised(PyErr),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Error(error)
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl From<Missing> for Failure {
    fn from(missing: Missing) -> Self {
        Self::NotLoaded(missing.keys().to_vec())
    }
}

impl Failure {
    /// Makes the exception. `path` is the file or address of the operation, used where the error names none.
    pub fn raise(self, py: Python<'_>, path: Option<&str>) -> PyErr {
        exception(py, self, path, None).unwrap_or_else(|error| error)
    }
}

/// Returns the advice for a parameter, with Python's names of options.
pub fn suggestion(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::PixelSize => "give a larger pixel, or the units",
        Parameter::Units => "set the units",
        Parameter::Memory => "give more memory",
        Parameter::TempDir => "choose a temp_dir with space",
        Parameter::Cache => "give a larger budget",
        Parameter::Incomplete => "or pass allow_incomplete=True, to take what can be read",
        Parameter::Overwrite => "force=True replaces it",
        Parameter::Plan => "pass its plan",
        _ => return None,
    })
}

/// Returns the name in Python of a parameter that the library calls otherwise.
fn argument(parameter: &Parameter) -> Option<&'static str> {
    Some(match parameter {
        Parameter::PixelSize | Parameter::AutomaticPixelSize => "pixel",
        Parameter::SliceHeight => "slice",
        Parameter::MaxSlope => "max_slope",
        Parameter::MinPoints => "min_points",
        Parameter::FillHoles => "fill_holes",
        Parameter::ColourError => "colour_error",
        Parameter::Memory => "memory",
        Parameter::Threads => "threads",
        Parameter::TempDir => "temp_dir",
        Parameter::Cache => "budget",
        // A budget that this archive's table exceeds.
        Parameter::Other(name) if name == "cache" => "budget",
        Parameter::Incomplete => "allow_incomplete",
        Parameter::Overwrite => "force",
        Parameter::Units => "units",
        Parameter::Resume => "resume",
        Parameter::Columns => "columns",
        Parameter::Input => "inputs",
        Parameter::Pawn("climb height") => "climb",
        Parameter::Pawn("deepest drop") => "max_drop",
        Parameter::Pawn("steepest grade") => "max_grade",
        Parameter::Pawn("longest ramp") => "max_ramp",
        Parameter::Pawn("start") => "feet",
        Parameter::Pawn("size" | "pawn's width" | "pawn's height") => "pawn",
        Parameter::Splats("least opacity") => "min_opacity",
        Parameter::Splats("greatest size") => "max_size",
        _ => return None,
    })
}

/// Makes an exception of `slicewalk.errors` that has no other facts.
pub fn plain(class: &str, text: &str) -> PyErr {
    Python::attach(|py| made(py, class, text, &PyDict::new(py)).unwrap_or_else(|error| error))
}

/// Makes the exception `class` for a parameter whose value cannot be converted.
pub fn of_parameter(py: Python<'_>, class: &str, name: &str, reason: &str) -> PyErr {
    let facts = PyDict::new(py);
    let set = facts.set_item("at", name).and_then(|()| facts.set_item("reason", reason));
    set.and_then(|()| made(py, class, &format!("{name}: {reason}"), &facts)).unwrap_or_else(|error| error)
}

/// Makes the exception for row `row` of the array `what`.
pub fn of_row(py: Python<'_>, what: &str, row: usize, error: Error) -> PyErr {
    exception(py, error.into(), None, Some((what, row))).unwrap_or_else(|error| error)
}

fn exception(py: Python<'_>, failure: Failure, path: Option<&str>, row: Option<(&str, usize)>) -> PyResult<PyErr> {
    let facts = PyDict::new(py);
    facts.set_item("path", path)?;
    let error = match failure {
        Failure::Error(Error::Parameter { what, reason }) => {
            let what = argument(&what).map_or(what, |name| Parameter::Other(name.to_owned()));
            Error::Parameter { what, reason }
        }
        Failure::Error(error) => error,
        Failure::Raised(error) => return Ok(error),
        Failure::NotLoaded(keys) => {
            let pages: Vec<_> = keys.iter().map(|key| (key.tx, key.ty, key.layer)).collect();
            facts.set_item("pages", &pages)?;
            facts.set_item("hint", "load them with Stream.load, or ask the archive itself")?;
            return made(py, "NotLoadedError", &format!("pages that are not in memory are needed: {pages:?}"), &facts);
        }
    };
    let mut text = error.render(suggestion);
    facts.set_item("hint", error.suggestion().and_then(suggestion))?;
    if let Some((what, row)) = row {
        facts.set_item("row", row)?;
        text = format!("{what}: row {row}: {text}");
    }
    let set_io = |path: &std::path::Path, source: &std::io::Error| -> PyResult<()> {
        facts.set_item("path", path.to_string_lossy())?;
        facts.set_item("errno", source.raw_os_error())?;
        facts.set_item("strerror", source.to_string())
    };
    // For a conversion that can be resumed, the underlying error says more.
    let about = match &error {
        Error::Resumable { source, .. } => &**source,
        error => error,
    };
    let class = match about {
        Error::Io { source, .. } if source.kind() == std::io::ErrorKind::OutOfMemory => {
            return Ok(PyMemoryError::new_err(in_python(&text)));
        }
        Error::Io { path, action, source, .. } => {
            set_io(path, source)?;
            facts.set_item("action", action)?;
            match source.kind() {
                std::io::ErrorKind::NotFound => "MissingFileError",
                _ => "FileError",
            }
        }
        Error::Input { path, at, reason, .. } => {
            facts.set_item("path", path.to_string_lossy())?;
            facts.set_item("at", at)?;
            facts.set_item("reason", in_python(reason))?;
            "InputError"
        }
        Error::Format { rule, part, offset, expected, found } => {
            facts.set_item("rule", rule)?;
            facts.set_item("part", part)?;
            facts.set_item("offset", offset)?;
            facts.set_item("expected", expected)?;
            facts.set_item("found", found)?;
            text = path.map_or(text.clone(), |path| format!("{path}: {text}"));
            "FormatError"
        }
        Error::Limit { what, value, max, .. } => {
            facts.set_item("reason", in_python(what))?;
            facts.set_item("expected", max)?;
            facts.set_item("found", value)?;
            "LimitError"
        }
        Error::Unsupported { what, suggestion, .. } => {
            facts.set_item("found", what)?;
            facts.set_item("hint", in_python(suggestion))?;
            "UnsupportedError"
        }
        Error::Parameter { what, reason } => {
            facts.set_item("at", what.to_string())?;
            facts.set_item("reason", in_python(reason))?;
            "ParameterError"
        }
        Error::Output { path, reason, .. } => {
            facts.set_item("path", path.to_string_lossy())?;
            facts.set_item("reason", in_python(reason))?;
            "OutputError"
        }
        Error::NotDurable { path, source } => {
            set_io(path, source)?;
            "NotDurableError"
        }
        Error::Interrupted => "CancelledError",
        _ => "Error",
    };
    made(py, class, &text, &facts)
}

/// Replaces command-line options in a message of the library with their names in Python.
pub fn in_python(text: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let (before, option) = word.split_once("--").unwrap_or((word, ""));
        let is_option = matches!(before, "" | "(") && option.starts_with(|c: char| c.is_ascii_lowercase());
        words.push(if is_option { format!("{before}{}", option.replace('-', "_")) } else { word.to_owned() });
    }
    words.join(" ")
}

fn made(py: Python<'_>, class: &str, text: &str, facts: &Bound<'_, PyDict>) -> PyResult<PyErr> {
    let class = py.import("slicewalk.errors")?.getattr(class)?;
    Ok(PyErr::from_value(class.call((in_python(text),), Some(facts))?))
}
