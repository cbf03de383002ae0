//! Errors and panics as texts for JavaScript.

use slicewalk::{Error, Parameter};
use std::cell::RefCell;

/// An error as `kind|message`.
pub(crate) fn text(error: &Error) -> String {
    let kind = match error {
        // The magic number, and what only newer versions read.
        Error::Format { rule: "H1", .. } | Error::Unsupported { .. } => "not-an-archive",
        Error::Format { .. } => "damaged",
        Error::Io { .. } => "network",
        Error::Parameter { what: Parameter::Other(what), .. } if what == "cache" => "out-of-memory",
        _ => "invalid",
    };
    format!("{kind}|{error}")
}

/// An argument that makes no sense.
pub(crate) fn invalid(message: impl std::fmt::Display) -> String {
    format!("invalid|{message}")
}

thread_local! {
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Keeps what panics say: in wasm they end as traps without a text.
pub(crate) fn keep_panics() {
    #[cfg(target_family = "wasm")]
    std::panic::set_hook(Box::new(|info| PANIC.with_borrow_mut(|text| *text = info.to_string())));
}

pub(crate) fn last_panic() -> String {
    PANIC.with_borrow(Clone::clone)
}
