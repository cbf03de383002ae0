//! How long work reports progress, warnings and the wish to stop.

use crate::Parameter;

/// Receives progress and warnings; may ask to stop. All methods may be called from several threads at once.
pub trait Monitor: Sync {
    /// A stage begins. `total` is an estimate (zero when unknown) in `unit`.
    fn stage(&self, _name: &str, _total: u64, _unit: &str) {}

    /// `amount` more units of the current stage are done.
    fn advance(&self, _amount: u64) {}

    /// Work goes on, but the user should know of this.
    fn warn(&self, _warning: &Warning) {}

    /// Whether the work should stop as soon as it can with [`Error::Interrupted`](crate::Error::Interrupted).
    fn cancelled(&self) -> bool {
        false
    }
}

/// What the user of long work should know although it goes on. As text, one line without a newline at its end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    text: String,
    way_out: Option<Parameter>,
}

impl<T: Into<String>> From<T> for Warning {
    fn from(text: T) -> Self {
        Self { text: text.into(), way_out: None }
    }
}

impl Warning {
    /// The same, with the parameter that would help if set otherwise.
    pub fn with_way_out(self, parameter: Parameter) -> Self {
        Self { way_out: Some(parameter), ..self }
    }

    /// What would help, if set otherwise.
    pub fn way_out(&self) -> Option<&Parameter> {
        self.way_out.as_ref()
    }

    /// The text with the way out as a program words it: `say` names its option, or gives `None` if it has none.
    pub fn told(&self, say: impl FnOnce(&Parameter) -> Option<&'static str>) -> String {
        match self.way_out().map(|parameter| (parameter, say(parameter))) {
            Some((_, Some(said))) => format!("{}; {said}", self.text),
            Some((parameter, None)) => format!("{}; {}", self.text, parameter.advice()),
            None => self.text.clone(),
        }
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.told(|_| None))
    }
}

/// Ignores everything and never stops.
#[derive(Debug, Default, Clone, Copy)]
pub struct NoMonitor;

impl Monitor for NoMonitor {}
