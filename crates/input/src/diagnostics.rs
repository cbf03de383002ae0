//! Input that is only partly readable: an error unless the user allows it.
//!
//! Input is incomplete if a file holds points that are missing from the archive although no filter excluded them. A
//! header with wrong counts or bounds does not make it incomplete as long as all points are there.

use super::ScanFile;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Advice to users about incomplete input.
const WAY_OUT: &str = "fetch or write it again";

/// Error for a file that is only partly readable.
pub fn incomplete(path: &Path, at: &str, what: impl Display) -> Error {
    Error::input(path, at, format!("{what}; {WAY_OUT}")).with_suggestion(Parameter::Incomplete)
}

/// Warns that a file was read only in part.
pub fn warn_incomplete(path: &Path, what: impl Display, monitor: &dyn Monitor) {
    monitor.warn(&format!("{}: incomplete: {what}", path.display()).into());
}

/// Formats an error without its path, for messages that name the file already.
pub(super) fn without_path(error: Error) -> String {
    match error {
        Error::Input { at, reason, .. } => format!("{at}: {reason}"),
        Error::Io { action, source, .. } => format!("cannot {action}: {source}"),
        other => other.to_string(),
    }
}

/// Problems found while opening a file.
pub(super) struct Findings<'a> {
    pub path: &'a Path,
    pub allow_incomplete: bool,
    /// Warnings for the monitor.
    pub notes: Vec<String>,
    /// Descriptions of what is lost, and the number of points among it.
    pub lost: Vec<String>,
    pub points: u64,
}

impl Findings<'_> {
    /// Adds a warning.
    pub fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// Records that points cannot be read: an error unless `allow_incomplete` is set.
    pub fn lose(&mut self, text: impl Into<String>) -> Result<()> {
        let text = text.into();
        if !self.allow_incomplete {
            return Err(incomplete(self.path, "points", text));
        }
        self.lost.push(text);
        Ok(())
    }

    /// Like [`lose`](Self::lose), and counts the `points`.
    pub fn lose_points(&mut self, points: u64, text: impl Into<String>) -> Result<()> {
        self.lose(text)?;
        self.points = self.points.saturating_add(points);
        Ok(())
    }
}

/// Diagnostics while decoding one file.
#[derive(Debug, Default)]
pub(super) struct Loss {
    pub not_finite: u64,
    pub missing: u64,
    /// Damaged pieces; points unread because of damage (whole chunks, rest of a piece, single records); one of the
    /// reasons.
    pub damaged: u64,
    pub unread: u64,
    pub reason: Option<String>,
    /// Diagnostics described by the format itself.
    pub told: Vec<String>,
    pub changed: bool,
}

impl Loss {
    fn texts(&self) -> Vec<String> {
        let counted = [
            (self.missing, "points are missing: the data end before them"),
            (self.not_finite, "points have a coordinate that is not finite or beyond 1e12 m"),
        ];
        let mut texts: Vec<String> =
            counted.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        if let Some(reason) = &self.reason {
            let more =
                if self.damaged > 1 { format!(" (and {} pieces more)", self.damaged - 1) } else { String::new() };
            let lost = crate::text::counted(self.unread, "point");
            texts.push(format!("{reason}{more}; {lost} could not be read"));
        }
        texts.extend_from_slice(&self.told);
        if self.changed {
            texts.push("it was written to, cut or replaced while it was read".into());
        }
        texts
    }
}

/// Diagnostics while decoding, by file; most files have none.
#[derive(Debug, Default)]
pub(super) struct Diagnostics {
    by_file: Mutex<BTreeMap<usize, Loss>>,
    /// True if a loss was reported.
    any: AtomicBool,
    /// Points lost before decoding.
    points: AtomicU64,
    /// Points that the last check of a file found missing.
    short: Mutex<BTreeMap<usize, u64>>,
}

impl Diagnostics {
    pub fn add(&self, file: usize, change: impl FnOnce(&mut Loss)) {
        change(self.by_file.lock().unwrap_or_else(PoisonError::into_inner).entry(file).or_default());
    }

    /// Discards what was added for a file.
    pub fn forget(&self, file: usize) {
        self.by_file.lock().unwrap_or_else(PoisonError::into_inner).remove(&file);
    }

    /// Records a loss before decoding.
    pub fn note(&self) {
        self.any.store(true, Ordering::Relaxed);
    }

    /// Adds points lost before decoding.
    pub fn note_points(&self, points: u64) {
        let more = |sum: u64| Some(sum.saturating_add(points));
        let _ = self.points.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
    }

    /// Sets how many points a check of a file found missing, in place of those of the check before. The points of
    /// damaged pieces are among them and count only once.
    pub fn set_short(&self, file: usize, points: u64) {
        let by_file = self.by_file.lock().unwrap_or_else(PoisonError::into_inner);
        let unread = by_file.get(&file).map_or(0, |loss| loss.unread);
        let mut short = self.short.lock().unwrap_or_else(PoisonError::into_inner);
        match points.saturating_sub(unread) {
            0 => short.remove(&file),
            points => short.insert(file, points),
        };
    }

    /// Returns the number of points lost before decoding, or found missing by checks.
    pub fn points(&self) -> u64 {
        let short = self.short.lock().unwrap_or_else(PoisonError::into_inner);
        short.values().fold(self.points.load(Ordering::Relaxed), |sum, &points| sum.saturating_add(points))
    }

    pub fn any(&self) -> bool {
        self.any.load(Ordering::Relaxed)
    }

    /// Fails if anything was lost since the last call, or, if `allowed`, warns `monitor` once per file and kind of
    /// loss.
    pub fn settle(&self, files: &[ScanFile], allowed: bool, monitor: &dyn Monitor) -> Result<()> {
        let by_file = std::mem::take(&mut *self.by_file.lock().unwrap_or_else(PoisonError::into_inner));
        let lost: Vec<(&Path, String)> = by_file
            .iter()
            .flat_map(|(&file, loss)| loss.texts().into_iter().map(move |text| (files[file].path(), text)))
            .collect();
        let Some((path, text)) = lost.first() else { return Ok(()) };
        if !allowed {
            let files = by_file.values().filter(|loss| !loss.texts().is_empty()).count();
            let others =
                if files > 1 { format!(" (and {} files more are incomplete)", files - 1) } else { String::new() };
            return Err(incomplete(path, "points", format!("{text}{others}")));
        }
        self.note();
        lost.iter().for_each(|(path, text)| warn_incomplete(path, text, monitor));
        Ok(())
    }
}
