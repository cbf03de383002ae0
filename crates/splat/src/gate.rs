//! Checks that turn numbers of a file into splats, counts of diagnostics, and batches.

use super::gltf::Placing;
use super::{Splat, Work};
use slicewalk_base::text::counted;
use slicewalk_base::{Error, Result};
use slicewalk_input::{FARTHEST_M, incomplete, warn_incomplete};

/// Maximum number of splats in one batch.
pub const BATCH_SPLATS: usize = 1 << 14;
/// Value of the constant spherical harmonic.
const SH_CONSTANT: f64 = 0.282_094_791_773_878_14;

/// Result of reading a file.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[non_exhaustive]
pub struct SplatSummary {
    /// Splats passed on.
    pub splats: u64,
    /// Splats with a parameter that is not finite, or a centre beyond 1e12 units.
    pub not_finite: u64,
    /// Splats whose quaternion has no length.
    pub no_rotation: u64,
    /// Splats with a negative size.
    pub negative: u64,
    /// Splats with an opacity below 0 or above 1.
    pub opacity: u64,
    /// Splats that the file states and does not hold.
    pub missing: u64,
    /// True if the file holds more than it states, or is damaged behind its splats.
    pub contradicts: bool,
    /// How far from 0 coordinates lie that are floats of 32 bits in the file (its units); 0 without any.
    pub singles: [f64; 3],
}

impl SplatSummary {
    /// Returns whether the file holds exactly the splats that it states, all of them usable.
    pub fn is_complete(&self) -> bool {
        self.lost() == 0 && !self.contradicts
    }

    /// Returns the number of splats that were lost.
    pub fn lost(&self) -> u64 {
        (self.not_finite + self.no_rotation + self.negative + self.opacity).saturating_add(self.missing)
    }

    fn texts(&self) -> impl Iterator<Item = String> {
        [
            (self.missing, "missing: the data end before them"),
            (self.not_finite, "with a number that is not finite or beyond 1e12"),
            (self.no_rotation, "with a rotation of length 0"),
            (self.negative, "with a negative size"),
            (self.opacity, "with an opacity outside 0 to 1"),
        ]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{} {what}", counted(count, "splat")))
    }
}

/// A splat as its file states it, in doubles: sizes are standard deviations, colours are 0..=1 in sRGB.
#[derive(Debug, Clone, Copy)]
pub struct Raw {
    pub mean: [f64; 3],
    pub scale: [f64; 3],
    pub rotation: [f64; 4],
    pub opacity: f64,
    pub colour: [f64; 3],
}

/// Returns the opacity of a logit.
pub fn sigmoid(logit: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-logit))
}

/// Returns the colour of a coefficient of the constant spherical harmonic.
pub fn colour_of(coefficient: f64) -> f64 {
    0.5 + SH_CONSTANT * coefficient
}

/// Restores a unit quaternion from its three smaller components; `largest` is the place of the other one.
pub fn smallest_three(small: [f64; 3], largest: usize) -> [f64; 4] {
    let rest = 1.0 - small.iter().map(|v| v * v).sum::<f64>();
    let mut all = [libm::sqrt(rest.max(0.0)); 4];
    let mut next = small.into_iter();
    for (place, value) in all.iter_mut().enumerate() {
        if place != largest {
            *value = next.next().unwrap_or(0.0);
        }
    }
    all
}

/// Receiver of all splats of a file.
pub struct Gate<'a> {
    work: &'a Work<'a>,
    sink: &'a mut dyn FnMut(&[Splat]) -> Result<()>,
    batch: Vec<Splat>,
    /// Splats of the file up to the end of its present part.
    expected: u64,
    are_singles: [bool; 3],
    summary: SplatSummary,
    /// Number of the first lost splat.
    first_lost: u64,
    placing: Option<Placing>,
}

impl<'a> Gate<'a> {
    pub fn new(
        work: &'a Work<'a>,
        expected: u64,
        are_singles: [bool; 3],
        sink: &'a mut dyn FnMut(&[Splat]) -> Result<()>,
    ) -> Self {
        let batch = Vec::with_capacity(expected.min(BATCH_SPLATS as u64) as usize);
        let summary = SplatSummary::default();
        Self { work, sink, batch, expected, are_singles, summary, first_lost: 0, placing: None }
    }

    fn taken(&self) -> u64 {
        self.summary.splats.saturating_add(self.summary.lost())
    }

    /// Begins a part of the file, of so many splats: damage within it loses none of the next.
    pub fn begin(&mut self, splats: u64) {
        self.expected = self.taken().saturating_add(splats);
    }

    /// Sets where the next splats are placed; `None` leaves them as they are.
    pub fn place(&mut self, placing: Option<Placing>) {
        self.placing = placing;
    }

    /// Takes the next splat of the file.
    pub fn push(&mut self, raw: Raw) -> Result<()> {
        let raw = self.placing.as_ref().map_or(raw, |placing| placing.apply(raw));
        let lost = self.summary.lost();
        match check(&raw) {
            Ok(splat) => {
                self.summary.splats += 1;
                for axis in (0..3).filter(|axis| self.are_singles[*axis]) {
                    self.summary.singles[axis] = self.summary.singles[axis].max(splat.mean[axis].abs());
                }
                self.batch.push(splat);
                if self.batch.len() == BATCH_SPLATS {
                    self.flush()?;
                }
                return Ok(());
            }
            Err(Fault::NotFinite) => self.summary.not_finite += 1,
            Err(Fault::NoRotation) => self.summary.no_rotation += 1,
            Err(Fault::Negative) => self.summary.negative += 1,
            Err(Fault::Opacity) => self.summary.opacity += 1,
        }
        if lost == 0 {
            self.first_lost = self.taken() - 1;
        }
        self.lose()
    }

    /// Counts splats that the file states and does not hold.
    pub fn miss(&mut self, splats: u64) -> Result<()> {
        if self.summary.lost() == 0 {
            self.first_lost = self.taken();
        }
        self.summary.missing = self.summary.missing.saturating_add(splats);
        if splats == 0 { Ok(()) } else { self.lose() }
    }

    /// Handles damage behind which nothing of the present part can be read: an error, unless incomplete input is allowed.
    pub fn break_off(&mut self, error: Error) -> Result<()> {
        self.refuse(error)?;
        let missing = self.expected.saturating_sub(self.taken());
        self.miss(missing)
    }

    /// Fails with `error`, or warns of it if incomplete input is allowed.
    pub fn refuse(&mut self, error: Error) -> Result<()> {
        if !self.work.options.allow_incomplete {
            return Err(error.with_suggestion(slicewalk_base::Parameter::Incomplete));
        }
        self.summary.contradicts = true;
        self.work.monitor.warn(&error.to_string().into());
        Ok(())
    }

    fn lose(&self) -> Result<()> {
        if self.work.options.allow_incomplete {
            return Ok(());
        }
        let text = self.summary.texts().next().unwrap_or_default();
        Err(incomplete(self.work.path, &format!("splat {}", self.first_lost), text))
    }

    fn flush(&mut self) -> Result<()> {
        if self.work.monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        if !self.batch.is_empty() {
            (self.sink)(&self.batch)?;
            self.work.monitor.advance(self.batch.len() as u64);
            self.batch.clear();
        }
        Ok(())
    }

    /// Passes on the last splats.
    pub fn finish(mut self) -> Result<SplatSummary> {
        self.flush()?;
        for text in self.summary.texts() {
            warn_incomplete(self.work.path, text, self.work.monitor);
        }
        Ok(self.summary)
    }
}

enum Fault {
    NotFinite,
    NoRotation,
    Negative,
    Opacity,
}

fn check(raw: &Raw) -> Result<Splat, Fault> {
    let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
    let scale = raw.scale.map(|v| v as f32);
    let far = raw.mean.iter().any(|v| v.abs() > FARTHEST_M);
    let huge = scale.iter().any(|v| !v.is_finite());
    if !finite(&raw.mean) || far || huge || !finite(&raw.rotation) || raw.opacity.is_nan() || !finite(&raw.colour) {
        return Err(Fault::NotFinite);
    }
    if scale.iter().any(|v| *v < 0.0) {
        return Err(Fault::Negative);
    }
    if !(0.0..=1.0).contains(&raw.opacity) {
        return Err(Fault::Opacity);
    }
    // Divided by the greatest component first, so that no square overflows or vanishes.
    let greatest = raw.rotation.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    if greatest == 0.0 {
        return Err(Fault::NoRotation);
    }
    let q = raw.rotation.map(|v| v / greatest);
    let length = libm::sqrt(q.iter().map(|v| v * v).sum());
    let rotation = q.map(|v| (v / length) as f32);
    let colour = raw.colour.map(|v| libm::round(v.clamp(0.0, 1.0) * 255.0) as u8);
    Ok(Splat { mean: raw.mean, scale, rotation, opacity: raw.opacity as f32, colour })
}
