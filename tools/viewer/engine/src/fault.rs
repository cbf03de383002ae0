//! Errors as texts for JavaScript.

use slicewalk::{Error, Parameter};

/// Formats an error as `kind|message`.
pub(crate) fn text(error: &Error) -> String {
    let kind = match error {
        // The magic number is wrong, or only newer versions read the file.
        Error::Format { rule: "H1", .. } | Error::Unsupported { .. } => "not-an-archive",
        Error::Format { .. } => "damaged",
        Error::Io { .. } => "network",
        Error::Parameter { what: Parameter::Other(what), .. } if what == "cache" => "out-of-memory",
        _ => "invalid",
    };
    format!("{kind}|{error}")
}

/// An invalid argument.
pub(crate) fn invalid(message: impl std::fmt::Display) -> String {
    format!("invalid|{message}")
}
