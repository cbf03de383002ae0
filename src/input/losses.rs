//! Input that could be read in part only: an error, unless the user allows it.
//!
//! Points that are in a file and not in the archive, without a filter that asked for it, make the input incomplete. A
//! header that is wrong about counts or bounds while all points are there does not.

use super::ScanFile;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// What a user can do about incomplete input.
const WAY_OUT: &str = "fetch or write it again";

/// An error about a file that can be read in part only.
pub(crate) fn incomplete(path: &Path, at: &str, what: impl Display) -> Error {
    Error::input(path, at, format!("{what}; {WAY_OUT}")).with_way_out(Parameter::Incomplete)
}

/// Tells `monitor` that a file was read in part only.
pub(crate) fn warn_incomplete(path: &Path, what: impl Display, monitor: &dyn Monitor) {
    monitor.warn(&format!("{}: incomplete: {what}", path.display()).into());
}

/// An error about a file whose name is told beside it.
pub(super) fn without_path(error: Error) -> String {
    match error {
        Error::Input { at, reason, .. } => format!("{at}: {reason}"),
        other => other.to_string(),
    }
}

/// What opening a file finds wrong.
pub(super) struct Findings<'a> {
    pub path: &'a Path,
    pub allow_incomplete: bool,
    /// Soft problems, for the monitor.
    pub notes: Vec<String>,
    /// What is known to be lost, and how many points that is.
    pub lost: Vec<String>,
    pub points: u64,
}

impl Findings<'_> {
    /// A soft problem.
    pub fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// Points cannot be read.
    pub fn lose(&mut self, text: impl Into<String>) -> Result<()> {
        let text = text.into();
        if !self.allow_incomplete {
            return Err(incomplete(self.path, "points", text));
        }
        self.lost.push(text);
        Ok(())
    }

    /// So many points cannot be read.
    pub fn lose_points(&mut self, points: u64, text: impl Into<String>) -> Result<()> {
        self.lose(text)?;
        self.points = self.points.saturating_add(points);
        Ok(())
    }
}

/// What decoding lost of one file.
#[derive(Debug, Default)]
pub(super) struct Loss {
    pub not_finite: u64,
    pub missing: u64,
    /// Points in what cannot be read (chunks, pieces from their damage on, single records), pieces among that, and the reason of one.
    pub damaged: u64,
    pub unread: u64,
    pub reason: Option<String>,
    /// What the format found out, in words.
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

/// What decoding lost, by file; most files lose nothing.
#[derive(Debug, Default)]
pub(super) struct Losses {
    by_file: Mutex<BTreeMap<usize, Loss>>,
    /// Whether anything was lost and told.
    any: AtomicBool,
    /// Points lost before any point was decoded.
    points: AtomicU64,
}

impl Losses {
    pub fn add(&self, file: usize, change: impl FnOnce(&mut Loss)) {
        change(self.by_file.lock().unwrap_or_else(PoisonError::into_inner).entry(file).or_default());
    }

    /// Something was lost before any point was decoded.
    pub fn note(&self) {
        self.any.store(true, Ordering::Relaxed);
    }

    /// So many points were lost before any point was decoded.
    pub fn note_points(&self, points: u64) {
        self.points.fetch_add(points, Ordering::Relaxed);
    }

    /// Points lost before any point was decoded.
    pub fn points(&self) -> u64 {
        self.points.load(Ordering::Relaxed)
    }

    pub fn any(&self) -> bool {
        self.any.load(Ordering::Relaxed)
    }

    /// Fails if anything was lost since the last call, or tells `monitor` where that is allowed: one line a file and kind.
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
