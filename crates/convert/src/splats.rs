//! First pass over Gaussian splats: writes the voxels that their ellipsoids fill into runs.

use super::ConvertOptions;
use super::points::{Own, Read, out_of_reach};
use super::shard_filter::ShardScope;
use super::work::{Colouring, FirstPass, SourceRead, StopFlag};
use crate::archive::Bounds;
use crate::bytes::{HAS_THREADS, is_file_at, len_at, open_named, spawn_in};
use crate::input::scenes::Scene;
use crate::input::singles::Singles;
use crate::input::{InputOptions, InputSet, PointCounts, Units, each_once, expand_inputs, is_of_input};
use crate::placement::Similarity;
use crate::plan::{Plan, Up};
use crate::unit::LengthUnit;
use crate::voxel::ellipsoids::EllipsoidBuilder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::{Error, Monitor, Parameter, Result};
use slicewalk_splat::ellipsoid::{DEFAULT_OPACITY, Ellipsoid};
use slicewalk_splat::{Splat, SplatFormat, SplatOptions, SplatReader, SplatSummary, format_of};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_128;

/// Rules by which splats become solid.
#[derive(Debug, Clone, PartialEq)]
pub struct SplatRules {
    /// A place is solid if some splat's own opacity there is at least this (above 0, at most 1).
    pub opacity: f64,
    /// Splats with less opacity at their centre are left out (0 to 1).
    pub min_opacity: f64,
    /// Splats whose solid part is longer than this are left out (m).
    pub max_size_m: Option<f64>,
}

impl Default for SplatRules {
    fn default() -> Self {
        Self { opacity: DEFAULT_OPACITY, min_opacity: 0.0, max_size_m: None }
    }
}

impl SplatRules {
    pub(super) fn check(&self) -> Result<()> {
        let refused = |what: &'static str, value: f64, expected: &str| {
            let reason = format!("{} is not allowed; expected {expected}", crate::text::number(value));
            Err(Error::parameter(Parameter::Splats(what), reason))
        };
        if !(self.opacity > 0.0 && self.opacity <= 1.0) {
            return refused("opacity", self.opacity, "an opacity above 0 and at most 1");
        }
        if !(0.0..=1.0).contains(&self.min_opacity) {
            return refused("least opacity", self.min_opacity, "an opacity from 0 to 1");
        }
        match self.max_size_m {
            Some(size) if !(size > 0.0 && size.is_finite()) => refused("greatest size", size, "a length above 0"),
            _ => Ok(()),
        }
    }
}

/// Numbers of splats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SplatCounts {
    /// Splats read.
    pub read: u64,
    /// Left out because their opacity reaches the threshold nowhere.
    pub transparent: u64,
    /// Left out because they have less than the least opacity.
    pub faint: u64,
    /// Left out because they are larger than the greatest size.
    pub large: u64,
    /// Left out because a parameter is unusable; 0 unless incomplete input is allowed.
    pub unusable: u64,
    /// Stated by the file and not there, so not among those read; 0 unless incomplete input is allowed.
    pub missing: u64,
}

impl SplatCounts {
    /// Number of splats left out.
    pub fn left_out(&self) -> u64 {
        self.transparent + self.faint + self.large + self.unusable
    }

    fn add(&mut self, other: &Self) {
        self.read += other.read;
        self.transparent += other.transparent;
        self.faint += other.faint;
        self.large += other.large;
        self.unusable += other.unusable;
        self.missing = self.missing.saturating_add(other.missing);
    }

    /// Adds the splats that a reader did not pass on.
    fn lose(&mut self, summary: &SplatSummary) {
        let unusable = summary.lost() - summary.missing;
        self.read += unusable;
        self.unusable += unusable;
        self.missing = self.missing.saturating_add(summary.missing);
    }
}

/// Files of splats among the inputs.
#[derive(Debug, Clone, Default)]
pub(crate) struct SplatSet {
    paths: Vec<PathBuf>,
    bytes: u64,
    count: u64,
    colours: bool,
    /// Placement after unit and axes.
    placement: Option<Similarity>,
    /// True if a file was left out.
    is_partial: bool,
}

/// Returns the file that describes the folder of splats at `path`; `None` for other folders.
fn described(path: &Path) -> Option<PathBuf> {
    let names = if path.is_dir() { ["lod-meta.json", "meta.json"].as_slice() } else { &[] };
    names.iter().map(|name| path.join(name)).find(|file| is_file_at(file))
}

/// Returns whether a file holds splats, by content and name. One that cannot be read is left to the readers of scans,
/// which report it or leave it out.
fn is_splat(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let known = ["ply", "spz", "sog", "zip", "splat", "ksplat", "gltf", "glb", "json"];
    // A store is not asked twice, and only names that can be those of splats are opened.
    if crate::bytes::address(path).is_some() || !known.contains(&&ending[..]) || !is_file_at(path) {
        return false;
    }
    let Ok(source) = open_named(path) else { return false };
    format_of(&*source, path).is_ok_and(|format| format.is_some())
}

/// Inputs of a conversion, divided.
pub(crate) struct Divided {
    /// Files of splats.
    pub splats: Vec<PathBuf>,
    /// Scans and meshes.
    pub others: Vec<PathBuf>,
}

impl Divided {
    /// Expands inputs and sets the splats among them aside.
    pub fn of(inputs: &[PathBuf], monitor: &dyn Monitor) -> Result<Self> {
        let (mut splats, rest) = apart(inputs);
        let mut others =
            if rest.is_empty() && !splats.is_empty() { Vec::new() } else { expand_inputs(&rest, monitor)? };
        splats.extend(others.extract_if(.., |path| is_splat(path)));
        Ok(Self { splats: each_once(splats, monitor), others })
    }

    /// Opens the scans among inputs; returns them and the files of splats.
    pub fn open(inputs: &[PathBuf], options: InputOptions, monitor: &dyn Monitor) -> Result<(InputSet, Vec<PathBuf>)> {
        let (mut splats, rest) = apart(inputs);
        if rest.is_empty() && !splats.is_empty() {
            return Ok((InputSet::of_paths(Vec::new(), options, monitor)?, each_once(splats, monitor)));
        }
        let (scans, mut more) = InputSet::open_apart(&rest, &is_splat, options, monitor)?;
        splats.append(&mut more);
        Ok((scans, each_once(splats, monitor)))
    }
}

/// Separates folders of splats, by the files that describe them, from all other inputs.
fn apart(inputs: &[PathBuf]) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let (mut folders, mut rest) = (Vec::new(), Vec::new());
    for input in inputs {
        match described(input) {
            Some(file) => folders.push(file),
            None => rest.push(input.clone()),
        }
    }
    (folders, rest)
}

/// Measurements of all splats.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SplatSurvey {
    pub counts: SplatCounts,
    /// Bounds of all solid parts (m); `None` without any.
    pub bounds: Option<Bounds>,
    /// Sum of the volumes of all solid parts, however they overlap (m³).
    pub volume_m3: f64,
}

/// Steps per cubic metre in which volumes are added up.
const VOLUME_STEPS: f64 = (1u64 << 50) as f64;

impl SplatSet {
    /// Opens files of splats, each named once. If incomplete input is allowed, warns about each that cannot be opened.
    /// If none is left, this is an error unless the run `has_others`, inputs of other kinds.
    pub fn open(
        paths: Vec<PathBuf>,
        has_others: bool,
        options: &ConvertOptions,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let (mut set, mut left_out) = (Self::default(), None);
        for path in paths {
            match SplatReader::open(&path, &reading(options)) {
                Ok(reader) => {
                    set.count = set.count.saturating_add(reader.count());
                    set.bytes += len_at(&path).unwrap_or(0);
                    set.paths.push(path);
                }
                Err(error) if options.allow_incomplete && is_of_input(&error) => {
                    monitor.warn(&format!("incomplete: left out: {error}").into());
                    left_out = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        set.is_partial = left_out.is_some();
        if let Some(error) = left_out.filter(|_| set.is_empty() && !has_others) {
            return Err(error);
        }
        if let (Some(first), Units::Auto) = (set.paths.first(), options.reading.units) {
            let text = format!("{}: splats state no unit; metres are assumed", first.display());
            monitor.warn(&crate::Warning::from(text).with_suggestion(Parameter::Units));
        }
        Ok(set)
    }

    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// Returns true if no file was left out.
    pub fn is_complete(&self) -> bool {
        !self.is_partial
    }

    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.paths.iter().map(PathBuf::as_path)
    }

    /// Length of all files (bytes), for progress only.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Number of splats that the files state.
    pub fn count(&self) -> u64 {
        self.count
    }

    pub fn set_placement(&mut self, placement: Option<Similarity>) {
        self.placement = placement;
    }

    pub fn set_colours(&mut self, wanted: bool) {
        self.colours = wanted;
    }

    pub fn has_paint(&self) -> bool {
        self.colours && !self.is_empty()
    }

    /// Returns the unit of the files, if there are any.
    pub fn length_unit(&self, units: Units) -> Option<LengthUnit> {
        (!self.is_empty()).then_some(match units {
            Units::Auto => LengthUnit::METRE,
            Units::Factor(factor) => LengthUnit::of(factor),
        })
    }

    /// Reads all files and passes the solid parts of all splats to `give`; returns counts of all of them.
    pub fn for_each_solid(
        &self,
        options: &ConvertOptions,
        monitor: &dyn Monitor,
        give: &mut dyn FnMut(&Ellipsoid),
    ) -> Result<SplatCounts> {
        let mut counts = SplatCounts::default();
        for path in &self.paths {
            let mut reader = SplatReader::open(path, &reading(options))?;
            let placing = Placing::of(options, self.placement, reader.format());
            let summary = reader.for_each_batch(&Silent(monitor), &mut |batch| {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                batch.iter().filter_map(|splat| placing.solid(splat, &mut counts)).for_each(|solid| give(&solid));
                Ok(())
            })?;
            counts.lose(&summary);
        }
        Ok(counts)
    }

    /// Reads all files and measures the solid parts of all splats.
    pub fn survey(&self, options: &ConvertOptions, monitor: &dyn Monitor) -> Result<SplatSurvey> {
        let mut read = Read::NOTHING;
        // Integers, because the order of splats must not change the sum.
        let mut volume = 0u128;
        let counts = self.for_each_solid(options, monitor, &mut |ellipsoid| {
            let (min, max) = ellipsoid.bounds();
            read.merge(&Read { min, max, ..Read::NOTHING });
            volume = volume.saturating_add((ellipsoid.volume() * VOLUME_STEPS) as u128);
        })?;
        let bounds = (read.min[0] <= read.max[0]).then_some((read.min, read.max));
        Ok(SplatSurvey { counts, bounds, volume_m3: volume as f64 / VOLUME_STEPS })
    }
}

fn reading(options: &ConvertOptions) -> SplatOptions {
    SplatOptions {
        allow_incomplete: options.allow_incomplete,
        temp_dir: options.resources.temp_dir.clone(),
        memory_bytes: options.resources.memory_bytes / 8,
    }
}

/// Returns the length of a unit of the files (m).
fn unit_m(options: &ConvertOptions) -> f64 {
    match options.reading.units {
        Units::Auto => 1.0,
        Units::Factor(factor) => factor,
    }
}

/// Monitor that forwards cancellation and drops all messages.
struct Silent<'a>(&'a dyn Monitor);

impl Monitor for Silent<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Rules and placement of the splats of a file.
struct Placing<'a> {
    rules: &'a SplatRules,
    /// Unit and axes, then the placement.
    place: Option<Similarity>,
}

impl<'a> Placing<'a> {
    fn of(options: &'a ConvertOptions, placement: Option<Similarity>, format: SplatFormat) -> Self {
        let factor = unit_m(options);
        // As for meshes: glTF fixes its axes.
        let is_turned = options.plan.up == Up::Y || format == SplatFormat::Gltf;
        let axes = if is_turned { Similarity::raising([0.0, 1.0, 0.0]) } else { Similarity::IDENTITY };
        let place = placement.unwrap_or(Similarity::IDENTITY) * axes * Similarity::scaling(factor);
        Self { rules: &options.reading.splats, place: (place != Similarity::IDENTITY).then_some(place) }
    }

    /// Returns the solid part of a splat, or counts why it has none.
    fn solid(&self, splat: &Splat, counts: &mut SplatCounts) -> Option<Ellipsoid> {
        counts.read += 1;
        if f64::from(splat.opacity) < self.rules.min_opacity {
            counts.faint += 1;
            return None;
        }
        let Some(ellipsoid) = Ellipsoid::of(splat, self.rules.opacity) else {
            counts.transparent += 1;
            return None;
        };
        let ellipsoid = match &self.place {
            Some(place) => ellipsoid.moved(place.factor(), place.rows(), place.shift()),
            None => ellipsoid,
        };
        if self.rules.max_size_m.is_some_and(|most| ellipsoid.size() > most) {
            counts.large += 1;
            return None;
        }
        Some(ellipsoid)
    }
}

/// Hash of everything that a splat makes.
fn hash_of(splat: &Splat) -> u128 {
    let Splat { mean, scale, rotation, opacity, colour } = splat;
    let mut bytes = [0; 59];
    let numbers = mean.iter().flat_map(|v| v.to_le_bytes());
    let small = scale.iter().chain(rotation).chain([opacity]).flat_map(|v| v.to_le_bytes());
    bytes.iter_mut().zip(numbers.chain(small).chain(*colour)).for_each(|(byte, value)| *byte = value);
    xxh3_128(&bytes)
}

/// Result of the first pass over splats.
pub(super) struct SplatRead<'a> {
    /// Hashes are of the splats of each file, in any order; 0 unless a part is converted.
    pub source: SourceRead<'a>,
    pub counts: SplatCounts,
}

/// Work of one thread of the first pass: writes the solid parts of splats into its runs.
struct Rasteriser<'a> {
    placing: &'a Placing<'a>,
    plan: &'a Plan,
    store: &'a RunStore,
    runs: RunBuilder,
    builder: EllipsoidBuilder,
    read: Read,
    counts: SplatCounts,
    /// Hash of the splats in any order, if a part is converted.
    hash: Option<u128>,
}

impl<'a> Rasteriser<'a> {
    fn new(pass: &FirstPass<'a>, placing: &'a Placing<'a>, colouring: Option<Colouring>) -> Self {
        let FirstPass { plan, scope, store, .. } = *pass;
        let (runs, mut builder) = (pass.runs(), EllipsoidBuilder::new(plan));
        if let Some(Colouring { scale, with_points }) = colouring {
            builder = builder.colouring(scale, pass.values(with_points));
        }
        let (read, counts, hash) = (Read::NOTHING, SplatCounts::default(), scope.map(|_| 0));
        Self { placing, plan, store, runs, builder, read, counts, hash }
    }

    fn take(&mut self, batch: &[Splat], cancelled: &dyn Fn() -> bool) -> Result<()> {
        for splat in batch {
            if cancelled() {
                return Err(Error::Interrupted);
            }
            if let Some(hash) = &mut self.hash {
                *hash = hash.wrapping_add(hash_of(splat));
            }
            let Some(ellipsoid) = self.placing.solid(splat, &mut self.counts) else { continue };
            let (min, max) = ellipsoid.bounds();
            let paint = (splat.opacity, splat.colour);
            if !self.builder.push(&ellipsoid, (min, max), paint, &mut self.runs, self.store, cancelled)? {
                return Err(out_of_reach(&self.plan.frame, min, max));
            }
            self.read.merge(&Read { min, max, own: Own { min, max, ..Read::NOTHING.own }, ..Read::NOTHING });
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(Read, SplatCounts, u128)> {
        self.builder.flush(&mut self.runs, self.store)?;
        self.runs.flush(self.store)?;
        Ok((self.read, self.counts, self.hash.unwrap_or(0)))
    }
}

/// First pass: writes the solid parts of all splats into runs. One thread reads; all workers rasterise.
pub(super) fn read_splats<'a>(
    pass: FirstPass<'_>,
    set: &'a SplatSet,
    colouring: Option<Colouring>,
) -> Result<SplatRead<'a>> {
    let (mut all, mut counted) = (SourceRead::NOTHING, SplatCounts::default());
    if set.is_empty() {
        return Ok(SplatRead { source: all, counts: counted });
    }
    let FirstPass { options, scope, monitor, .. } = pass;
    monitor.stage("reading splats", set.count, "splats");
    let mut singles = Singles::default();
    for (number, path) in set.paths.iter().enumerate() {
        let mut reader = SplatReader::open(path, &reading(options))?;
        let placing = Placing::of(options, set.placement, reader.format());
        let flag = StopFlag::new(monitor);
        let cancelled = || flag.is_raised();
        let (send, receive) = crossbeam_channel::bounded::<Vec<Splat>>(options.resources.threads);
        let start = || Rasteriser::new(&pass, &placing, colouring);
        let work = || -> Result<(Read, SplatCounts, u128)> {
            let mut rasteriser = start();
            receive.iter().try_for_each(|batch| rasteriser.take(&batch, &cancelled))?;
            rasteriser.finish()
        };
        let alone = |reader: &mut SplatReader| -> Result<_> {
            let mut rasteriser = start();
            let sink = &mut |batch: &[Splat]| rasteriser.take(batch, &cancelled);
            let summary = reader.for_each_batch(monitor, sink)?;
            Ok((Ok(summary), rasteriser.finish().map(|done| vec![done])))
        };
        let together = |mut reader: SplatReader| {
            std::thread::scope(|scope| {
                let cancelled = &cancelled;
                let produce = move || {
                    let sink = &mut |batch: &[Splat]| match cancelled() {
                        true => Err(Error::Interrupted),
                        false => send.send(batch.to_vec()).map_err(|_| Error::Interrupted),
                    };
                    reader.for_each_batch(monitor, sink)
                };
                let producer =
                    spawn_in(scope, produce).map_err(|error| Error::io(path, "start a thread that reads it", error))?;
                let done = pass.on_threads(&flag, work);
                // After an error of the workers, the reader may wait for room.
                receive.iter().for_each(drop);
                let summary = producer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                Ok::<_, Error>((summary, done))
            })
        };
        let (summary, done) = if HAS_THREADS { together(reader)? } else { alone(&mut reader)? };
        // The error of the reader says more than that of workers, except where the reader was stopped by them.
        let (summary, done) = match (summary, done) {
            (Err(Error::Interrupted), done) => (None, done?),
            (summary, done) => (Some(summary?), done?),
        };
        let Some(summary) = summary else { return Err(Error::Interrupted) };
        let (mut of_file, mut of_hash) = (Read::NOTHING, 0u128);
        for (read, counts, hash) in done {
            of_hash = of_hash.wrapping_add(hash);
            of_file.merge(&read);
            counted.add(&counts);
        }
        counted.lose(&summary);
        singles.note(number, summary.singles);
        all.complete &= summary.is_complete();
        if of_file.min[0] <= of_file.max[0] {
            all.scenes.push(Scene { path, min: of_file.min, max: of_file.max });
        }
        all.hashes.push(of_hash);
        all.read.merge(&of_file);
    }
    let unit = unit_m(options) * set.placement.map_or(1.0, |placement| placement.factor());
    let coarse = singles.warning(pass.plan.frame.pixel_m(), |file| (&*set.paths[file], [unit; 3]));
    coarse.iter().for_each(|text| monitor.warn(&text.as_str().into()));
    let (read, left_out) = (counted.read, counted.left_out());
    all.read.counts.read = read;
    if scope.is_none_or(ShardScope::owns_meshes) {
        all.read.own.kept = read - left_out;
        all.read.own.left_out = PointCounts { read: left_out, ..Read::NOTHING.counts };
    }
    Ok(SplatRead { source: all, counts: counted })
}
