//! How long work reports progress, soft problems and the wish to stop.

/// Receives progress and soft problems; may ask to stop. All methods may be called from several threads at once.
pub trait Monitor: Sync {
    /// A stage begins. `total` is an estimate (zero when unknown) in `unit`.
    fn stage(&self, _name: &str, _total: u64, _unit: &str) {}

    /// `amount` more units of the current stage are done.
    fn advance(&self, _amount: u64) {}

    /// A soft problem: work goes on, and the user should know. One line, no newline at its end.
    fn warn(&self, _text: &str) {}

    /// Whether the work should stop as soon as it can with [`Error::Interrupted`](crate::Error::Interrupted).
    fn cancelled(&self) -> bool {
        false
    }
}

/// Ignores everything and never stops.
#[derive(Debug, Default, Clone, Copy)]
pub struct NoMonitor;

impl Monitor for NoMonitor {}
