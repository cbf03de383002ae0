//! Colours of a conversion: which values of the points they come from, and how values become colours.
//!
//! Triangles have 8-bit colours, which count as RGB and become as wide as those of points.
//!
//! The decision whether the points have values is made before anything is converted, by the first value that is not 0;
//! so a file whose RGB is zero throughout counts as one without, and costs a pass. How values become colours (8 or 16
//! bits, the range of intensities) follows from all kept points of the whole input. A conversion of the whole learns it
//! in its first pass. A part does not see all points, so it takes it from the plan file, or reads the whole input once
//! before it begins. Parts of a plan therefore make the same colours as a single run, and each voxel lies in one part.
//!
//! If some files have 8 bits and others 16, the 8-bit values are widened. LAS does not state which it has: next to
//! files that do, its values are read once more, up to the first that needs more than 8 bits.

use super::inputs::Inputs;
use super::options::{ColourMode, ConvertOptions};
use super::work::for_each_batch;
use crate::colour::{ColourPlan, ColourScale, ColourSource};
use crate::input::{Depth, InputSet, PointBatch};
use crate::text::number;
use crate::voxel::colours::ValueFact;
use crate::voxel::record::Record;
use crate::{Error, Monitor, Parameter, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Statistics of the values of all points, independent of their order.
#[derive(Debug, Clone)]
pub(super) struct Values {
    source: ColourSource,
    greatest: u16,
    /// Number of points for each intensity.
    counts: Vec<u64>,
}

impl Values {
    /// Creates the statistics of no points.
    pub fn new(source: ColourSource) -> Self {
        let counts = if source == ColourSource::Intensity { vec![0; 1 << 16] } else { Vec::new() };
        Self { source, greatest: 0, counts }
    }

    /// Adds the values of points.
    pub fn add(&mut self, values: &[[u16; 3]]) {
        if self.source == ColourSource::Intensity {
            values.iter().for_each(|value| self.counts[usize::from(value[0])] += 1);
        } else {
            let any = |most: u16, value: &[u16; 3]| most.max(value[0]).max(value[1]).max(value[2]);
            self.greatest = values.iter().fold(self.greatest, any);
        }
    }

    /// Adds the values that `records` hold, as far as the scale needs them.
    pub fn add_records(&mut self, records: impl Iterator<Item = Record>) {
        for record in records {
            match ValueFact::of(record.value()) {
                ValueFact::Bytes => self.greatest = self.greatest.max(u16::from(u8::MAX)),
                ValueFact::Wide => self.greatest = u16::MAX,
                ValueFact::Value(value) => {
                    if let Some(count) = self.counts.get_mut(usize::from(value)) {
                        *count += 1;
                    }
                }
            }
        }
    }

    /// Clears the statistics.
    pub fn clear(&mut self) {
        self.greatest = 0;
        self.counts.fill(0);
    }

    /// Adds the statistics of other points.
    pub fn merge(&mut self, other: &Self) {
        self.greatest = self.greatest.max(other.greatest);
        self.counts.iter_mut().zip(&other.counts).for_each(|(count, more)| *count += more);
    }

    /// Returns how the values become colours.
    pub fn scale(&self) -> ColourScale {
        match self.source {
            ColourSource::Rgb => ColourScale::of_rgb(self.greatest),
            ColourSource::Intensity => ColourScale::of_intensity(&self.counts),
            ColourSource::Class => ColourScale::CLASS,
        }
    }
}

impl ConvertOptions {
    /// Refuses a colour error out of range.
    pub(super) fn check_colour(&self) -> Result<()> {
        let most = f64::from(u16::MAX) / 1000.0;
        if !(0.0..=most).contains(&self.sections.colour_error) {
            let reason =
                format!("expected 0 to {} (CIELAB), found {}", number(most), number(self.sections.colour_error));
            return Err(Error::parameter(Parameter::ColourError, reason));
        }
        Ok(())
    }

    /// Returns the colour plan with this scale.
    pub(super) fn colour_plan(&self, scale: ColourScale) -> ColourPlan {
        ColourPlan { scale, error_milli: (self.sections.colour_error * 1000.0).round() as u16 }
    }
}

/// Source of the colours of a conversion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub source: ColourSource,
    /// True if points have it.
    points: bool,
}

impl Found {
    /// Sets which values the inputs read from now on.
    fn set(found: Option<Self>, Inputs { scans, meshes, splats, .. }: &mut Inputs) {
        splats.set_colours(found.is_some_and(|found| found.source == ColourSource::Rgb));
        scans.set_colour(found.filter(|found| found.points).map(|found| found.source));
        meshes.set_colours(found.is_some_and(|found| found.source == ColourSource::Rgb));
    }
}

/// Looks for values of `source` in the points and triangles of the input; returns `None` if it has no such values.
fn look(
    Inputs { scans, meshes, splats, .. }: &mut Inputs,
    source: ColourSource,
    threads: usize,
    monitor: &dyn Monitor,
) -> Result<Option<Found>> {
    let mut points = scans.has_values(source);
    if points {
        prepare(scans, source, threads, monitor)?;
        points = any_value(scans, source, threads, monitor)?;
    }
    let is_found = points || (source == ColourSource::Rgb && (!splats.is_empty() || meshes.has_colours(monitor)?));
    Ok(is_found.then_some(Found { source, points }))
}

/// Returns the source of the colours, if there are to be any. Cost: usually one piece of the input; where values are
/// zero throughout, a pass over it.
pub(super) fn source_of(options: &ConvertOptions, inputs: &mut Inputs, monitor: &dyn Monitor) -> Result<Option<Found>> {
    let wanted: &[ColourSource] = match options.sections.colour {
        ColourMode::Off => &[],
        ColourMode::Auto => &[ColourSource::Rgb, ColourSource::Intensity],
        ColourMode::Of(ref source) => std::slice::from_ref(source),
    };
    let mut found = None;
    for &source in wanted {
        found = look(inputs, source, options.resources.threads, monitor)?;
        if found.is_some() {
            break;
        }
    }
    Found::set(found, inputs);
    if found.is_some() {
        return Ok(found);
    }
    // If colours are wanted, reading the meshes then reports why they have none.
    inputs.meshes.set_colours(wanted.contains(&ColourSource::Rgb));
    if let ColourMode::Of(ColourSource::Rgb) = options.sections.colour {
        // Nothing else reads them: the conversion fails below.
        inputs.meshes.report_colours(monitor)?;
    }
    match options.sections.colour {
        ColourMode::Off => Ok(None),
        ColourMode::Of(source) if !inputs.scans.files().is_empty() => {
            let reason = format!(
                "no point of the input has {}; choose another source, or off, or name the columns of text without a header",
                match source {
                    ColourSource::Rgb => "an RGB value other than 0",
                    ColourSource::Intensity => "an intensity other than 0",
                    ColourSource::Class => "a class other than 0",
                }
            );
            Err(Error::parameter(Parameter::Colour, reason))
        }
        ColourMode::Of(source) => {
            let reason = match source {
                ColourSource::Rgb => "no triangle has a colour other than black; convert the meshes without",
                _ => "meshes have RGB alone; choose rgb or off",
            };
            Err(Error::parameter(Parameter::Colour, reason))
        }
        ColourMode::Auto => {
            let text = "no point has RGB or intensity, and no triangle a colour: the archive has no colours";
            monitor.warn(&text.into());
            Ok(None)
        }
    }
}

/// Like [`source_of`], but for a part of a plan that chose `source` for all its inputs.
pub(super) fn source_of_plan(
    source: Option<ColourSource>,
    options: &ConvertOptions,
    inputs: &mut Inputs,
    monitor: &dyn Monitor,
) -> Result<Option<Found>> {
    let found = match source {
        None => None,
        Some(source) if inputs.meshes.is_empty() && inputs.splats.is_empty() => {
            prepare(&mut inputs.scans, source, options.resources.threads, monitor)?;
            Some(Found { source, points: true })
        }
        Some(source) => look(inputs, source, options.resources.threads, monitor)?,
    };
    Found::set(found, inputs);
    Ok(found)
}

/// Finds out what values of `source` mean in each file for which only the points show it.
fn prepare(set: &mut InputSet, source: ColourSource, threads: usize, monitor: &dyn Monitor) -> Result<()> {
    set.prepare_values(source)?;
    if source != ColourSource::Rgb {
        return Ok(());
    }
    let mut depths = set.depths();
    let has = |depths: &[Option<Depth>], depth| depths.contains(&Some(depth));
    if has(&depths, Depth::Unstated) && (has(&depths, Depth::Eight) || has(&depths, Depth::Sixteen)) {
        let is_wide: Vec<AtomicBool> = depths.iter().map(|_| AtomicBool::new(false)).collect();
        let wanted = |file: usize| depths[file] == Some(Depth::Unstated) && !is_wide[file].load(Ordering::Relaxed);
        monitor.stage("reading colours", 0, "points");
        read_values(set, source, threads, monitor, &wanted, &|file, batch: &PointBatch| {
            monitor.advance(batch.len() as u64);
            if batch.values.as_flattened().iter().any(|&value| value > u16::from(u8::MAX)) {
                is_wide[file].store(true, Ordering::Relaxed);
            }
            true
        })?;
        for (depth, is_wide) in depths.iter_mut().zip(is_wide) {
            if *depth == Some(Depth::Unstated) {
                *depth = Some(if is_wide.into_inner() { Depth::Sixteen } else { Depth::Eight });
            }
        }
    }
    if has(&depths, Depth::Sixteen) {
        let narrow = |depth: &Option<Depth>| *depth == Some(Depth::Eight);
        depths.iter().enumerate().filter(|(_, depth)| narrow(depth)).for_each(|(file, _)| set.widen(file));
    }
    Ok(())
}

/// Returns whether some kept point has a value other than 0. One thread looks at the first piece, which usually
/// decides, so that no more than needed is decoded; then all threads look at everything.
fn any_value(set: &mut InputSet, source: ColourSource, threads: usize, monitor: &dyn Monitor) -> Result<bool> {
    let found = AtomicBool::new(false);
    let is_first = AtomicBool::new(true);
    let first = |_: usize| is_first.swap(false, Ordering::Relaxed);
    let looks: [(usize, &(dyn Fn(usize) -> bool + Sync)); 2] = [(1, &first), (threads, &|_| true)];
    for (threads, wanted) in looks {
        read_values(set, source, threads, monitor, wanted, &|_, batch: &PointBatch| {
            if batch.values.iter().any(|value| *value != [0; 3]) {
                found.store(true, Ordering::Relaxed);
            }
            !found.load(Ordering::Relaxed)
        })?;
        if found.load(Ordering::Relaxed) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Measures how the values of all points become colours. Cost: a pass over the input.
pub(super) fn measure(
    set: &mut InputSet,
    Found { source, points }: Found,
    threads: usize,
    monitor: &dyn Monitor,
) -> Result<ColourScale> {
    if !points {
        return Ok(Values::new(source).scale());
    }
    if source == ColourSource::Class {
        return Ok(ColourScale::CLASS);
    }
    monitor.stage("reading colours", set.points_stated(), "points");
    let all = Mutex::new(Values::new(source));
    read_values(set, source, threads, monitor, &|_| true, &|_, batch: &PointBatch| {
        monitor.advance(batch.len() as u64);
        all.lock().unwrap_or_else(PoisonError::into_inner).add(&batch.values);
        true
    })?;
    Ok(all.into_inner().unwrap_or_else(PoisonError::into_inner).scale())
}

/// Passes the points of the `wanted` files to `take`, with the number of the file, until `take` returns false.
fn read_values(
    set: &mut InputSet,
    source: ColourSource,
    threads: usize,
    monitor: &dyn Monitor,
    wanted: &(dyn Fn(usize) -> bool + Sync),
    take: &(dyn Fn(usize, &PointBatch) -> bool + Sync),
) -> Result<()> {
    set.set_colour(Some(source));
    for_each_batch(set, threads, monitor, wanted, take)
}
