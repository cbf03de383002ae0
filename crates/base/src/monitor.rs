//! Progress, warnings and cancellation of long work.

use crate::Parameter;

/// Receiver of progress and warnings, which may also cancel. All methods may be called from several threads at once.
pub trait Monitor: Sync {
    /// Begins a stage. `total` is an estimate (zero if unknown) in `unit`.
    fn stage(&self, _name: &str, _total: u64, _unit: &str) {}

    /// Reports that `amount` more units of the current stage are done.
    fn advance(&self, _amount: u64) {}

    /// Reports a warning; the work continues.
    fn warn(&self, _warning: &Warning) {}

    /// Returns whether the work should stop as soon as it can with [`Error::Interrupted`](crate::Error::Interrupted).
    fn cancelled(&self) -> bool {
        false
    }

    /// Like [`cancelled`](Self::cancelled), asked once, just before the output is put in place. May wait until
    /// all earlier progress and warnings are handled.
    fn cancelled_at_last(&self) -> bool {
        self.cancelled()
    }
}

/// Warning to the user while the work continues. Its text is one line without a newline at its end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    text: String,
    suggestion: Option<Parameter>,
}

impl<T: Into<String>> From<T> for Warning {
    fn from(text: T) -> Self {
        Self { text: text.into(), suggestion: None }
    }
}

impl Warning {
    /// Adds the parameter that would help if changed.
    pub fn with_suggestion(self, parameter: Parameter) -> Self {
        Self { suggestion: Some(parameter), ..self }
    }

    /// Returns the parameter that would help if changed.
    pub fn suggestion(&self) -> Option<&Parameter> {
        self.suggestion.as_ref()
    }

    /// Returns the text with a program's own advice: `say` names its option, or returns `None` if it has none.
    pub fn render(&self, say: impl FnOnce(&Parameter) -> Option<&'static str>) -> String {
        match self.suggestion().map(|parameter| (parameter, say(parameter))) {
            Some((_, Some(said))) => format!("{}; {said}", self.text),
            Some((parameter, None)) => format!("{}; {}", self.text, parameter.advice()),
            None => self.text.clone(),
        }
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.render(|_| None))
    }
}

/// Monitor that ignores everything and never cancels.
#[derive(Debug, Default, Clone, Copy)]
pub struct NoMonitor;

impl Monitor for NoMonitor {}
