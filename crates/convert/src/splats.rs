//! First pass over Gaussian splats: writes the voxels that their ellipsoids fill into runs.

use super::points::{Own, Read, out_of_reach};
use super::work::on_threads;
use super::{ConvertOptions, meshes::Colouring};
use crate::bytes::{HAS_THREADS, is_file_at, len_at, open_named, spawn_in};
use crate::input::scenes::Scene;
use crate::input::{PointCounts, Units};
use crate::plan::{Plan, Up};
use crate::unit::LengthUnit;
use crate::voxel::ellipsoids::EllipsoidBuilder;
use crate::voxel::record::Recorder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::{Error, Monitor, Parameter, Result};
use slicewalk_splat::ellipsoid::{DEFAULT_OPACITY, Ellipsoid};
use slicewalk_splat::{HEAD_BYTES, Splat, SplatOptions, SplatReader, recognise};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Rules by which splats become solid.
#[derive(Debug, Clone, PartialEq)]
pub struct SplatRules {
    /// A place is solid if some splat's own opacity there is at least this (above 0, at most 1).
    pub opacity: f64,
    /// Splats with less opacity at their centre are left out (0 to 1).
    pub min_opacity: f64,
    /// Splats whose solid part is longer than this are left out (m).
    pub max_size_m: Option<f64>,
    /// Placement of splats after their unit and axes; `None` leaves them in place.
    pub placement: Option<Similarity>,
}

impl Default for SplatRules {
    fn default() -> Self {
        Self { opacity: DEFAULT_OPACITY, min_opacity: 0.0, max_size_m: None, placement: None }
    }
}

impl SplatRules {
    pub(super) fn check(&self) -> Result<()> {
        let refused = |what: &str, value: f64, expected: &str| {
            let reason = format!("{} is no {expected}", crate::text::number(value));
            Err(Error::parameter(Parameter::Other(what.into()), reason))
        };
        if !(self.opacity > 0.0 && self.opacity <= 1.0) {
            return refused("opacity", self.opacity, "opacity above 0 and at most 1");
        }
        if !(0.0..=1.0).contains(&self.min_opacity) {
            return refused("least opacity", self.min_opacity, "opacity from 0 to 1");
        }
        match self.max_size_m {
            Some(size) if !(size > 0.0 && size.is_finite()) => refused("greatest size", size, "length above 0"),
            _ => Ok(()),
        }
    }
}

/// A rotation, a uniform scale and a shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    rows: [[f64; 3]; 3],
    factor: f64,
    shift: [f64; 3],
}

impl Similarity {
    /// Greatest deviation of a matrix from a rotation times a scale, relative to the scale.
    const SLACK: f64 = 1e-5;

    /// Parses 16 numbers, row by row, separated by white space or commas. Fails with a reason if the matrix is no
    /// rotation with a uniform scale and a shift.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
        let numbers: Vec<f64> = words
            .map(|word| {
                word.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| format!("{word:?} is no number"))
            })
            .collect::<std::result::Result<_, _>>()?;
        let Ok(m) = <[f64; 16]>::try_from(numbers) else {
            return Err("expected 16 numbers: the rows of a 4 × 4 matrix".into());
        };
        if m[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err("expected 0 0 0 1 as the last row; write the matrix row by row".into());
        }
        let rows = [0, 1, 2].map(|row| [m[4 * row], m[4 * row + 1], m[4 * row + 2]]);
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let [a, b, c] = rows;
        let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        let factor = libm::cbrt(determinant);
        let rows = rows.map(|row| row.map(|v| v / factor));
        let is_rotation = (0..3)
            .all(|i| (0..3).all(|k| (dot(rows[i], rows[k]) - if i == k { 1.0 } else { 0.0 }).abs() <= Self::SLACK));
        if !(factor > 0.0 && factor.is_finite() && is_rotation) {
            return Err(
                "expected a rotation with one scale for all axes and a shift; it mirrors, shears or stretches".into()
            );
        }
        Ok(Self { rows, factor, shift: [m[3], m[7], m[11]] })
    }

    fn apply(&self, ellipsoid: &Ellipsoid) -> Ellipsoid {
        ellipsoid.moved(self.factor, &self.rows, self.shift)
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
    /// Left out because a number of theirs is unusable; 0 unless incomplete input is allowed.
    pub unusable: u64,
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
    }
}

/// Files of splats among the inputs.
#[derive(Debug, Clone, Default)]
pub(crate) struct SplatSet {
    paths: Vec<PathBuf>,
    bytes: u64,
    count: u64,
    colours: bool,
}

/// Returns whether there are splats at `path`, by content and name.
fn is_splat(path: &Path) -> bool {
    if path.is_dir() {
        return ["meta.json", "lod-meta.json"].iter().any(|name| is_file_at(&path.join(name)));
    }
    let Ok(source) = open_named(path) else { return false };
    let mut head = vec![0; source.len().min(HEAD_BYTES as u64) as usize];
    source.read_at(0, &mut head).is_ok() && recognise(&head, path).is_some()
}

/// Returns whether a name can be that of splats, so that other files are not opened to see.
fn may_be_splat(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let known = ["ply", "spz", "sog", "zip", "splat", "ksplat", "gltf", "glb", "json"];
    crate::bytes::address(path).is_none() && (known.contains(&&ending[..]) || path.is_dir())
}

impl SplatSet {
    /// Sets the splats among the inputs aside. Returns them, and the paths of all other inputs if there are splats.
    pub fn among(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<(Self, Option<Vec<PathBuf>>)> {
        let is = |path: &Path| may_be_splat(path) && is_splat(path);
        // Folders and patterns name scans alone; a store is not asked twice.
        let is_local = |path: &Path| is_file_at(path) || path.is_dir();
        let (mut paths, rest): (Vec<_>, Vec<_>) =
            options.inputs.iter().cloned().partition(|path| is_local(path) && is(path));
        if paths.is_empty() {
            return Ok((Self::default(), None));
        }
        paths.sort();
        if options.shard.is_some() || options.plan_file.is_some() {
            let reason = format!("{}: splats are converted in one run, without a plan", paths[0].display());
            return Err(Error::parameter(Parameter::Shard, reason));
        }
        if options.units == Units::Auto {
            let text = format!("{}: splats state no unit; metres are assumed", paths[0].display());
            monitor.warn(&crate::Warning::from(text).with_way_out(Parameter::Units));
        }
        let (mut bytes, mut count) = (0, 0u64);
        for path in &paths {
            count = count.saturating_add(SplatReader::open(path, &reading(options))?.count());
            bytes += len_at(path).unwrap_or(0);
        }
        Ok((Self { paths, bytes, count, colours: false }, Some(rest)))
    }

    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.paths.iter().map(PathBuf::as_path)
    }

    /// Length of all files (bytes), for progress only.
    pub fn bytes(&self) -> u64 {
        self.bytes
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

    /// Reads all files and returns the bounds of all solid parts (m), or `None` without any.
    pub fn bounds(&self, options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Option<([f64; 3], [f64; 3])>> {
        let (mut read, mut counts) = (Read::NOTHING, SplatCounts::default());
        let placing = Placing::of(options);
        for path in &self.paths {
            let mut reader = SplatReader::open(path, &reading(options))?;
            reader.for_each_batch(&Silent(monitor), options.memory_bytes / 8, &mut |batch| {
                for splat in batch {
                    if let Some(ellipsoid) = placing.solid(splat, &mut counts) {
                        let (min, max) = ellipsoid.bounds();
                        read.merge(&Read { min, max, ..Read::NOTHING });
                    }
                }
                Ok(())
            })?;
        }
        Ok((read.min[0] <= read.max[0]).then_some((read.min, read.max)))
    }
}

fn reading(options: &ConvertOptions) -> SplatOptions {
    SplatOptions { allow_incomplete: options.allow_incomplete, temp_dir: options.temp_dir.clone() }
}

/// Monitor that forwards cancellation and drops all messages.
struct Silent<'a>(&'a dyn Monitor);

impl Monitor for Silent<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Rules and placement of all splats of a conversion.
struct Placing<'a> {
    rules: &'a SplatRules,
    /// Unit and axes.
    axes: Option<Similarity>,
}

impl<'a> Placing<'a> {
    fn of(options: &'a ConvertOptions) -> Self {
        let factor = match options.units {
            Units::Auto => 1.0,
            Units::Factor(factor) => factor,
        };
        let rows = match options.plan.up {
            Up::Z => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            Up::Y => [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        };
        let axes = Similarity { rows, factor, shift: [0.0; 3] };
        let moves = factor != 1.0 || options.plan.up != Up::Z;
        Self { rules: &options.splats, axes: moves.then_some(axes) }
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
        let ellipsoid = self.axes.iter().chain(&self.rules.placement).fold(ellipsoid, |at, place| place.apply(&at));
        if self.rules.max_size_m.is_some_and(|most| ellipsoid.size() > most) {
            counts.large += 1;
            return None;
        }
        Some(ellipsoid)
    }
}

/// Result of the first pass over splats.
pub(super) struct SplatRead<'a> {
    /// Splats counted as if they were points, with the bounds of their solid parts.
    pub read: Read,
    pub counts: SplatCounts,
    pub scenes: Vec<Scene<'a>>,
    pub complete: bool,
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
}

impl<'a> Rasteriser<'a> {
    fn new(
        placing: &'a Placing<'a>,
        plan: &'a Plan,
        build_bytes: u64,
        colouring: Option<Colouring>,
        store: &'a RunStore,
    ) -> Self {
        let runs = RunBuilder::new(Recorder::new(plan.frame), build_bytes);
        let mut builder = EllipsoidBuilder::new(plan);
        if let Some(Colouring { scale, with_points }) = colouring {
            let values = RunBuilder::of_values(Recorder::new(plan.frame), build_bytes, with_points);
            builder = builder.colouring(scale, values);
        }
        Self { placing, plan, store, runs, builder, read: Read::NOTHING, counts: SplatCounts::default() }
    }

    fn take(&mut self, batch: &[Splat], cancelled: &dyn Fn() -> bool) -> Result<()> {
        for splat in batch {
            if cancelled() {
                return Err(Error::Interrupted);
            }
            let Some(ellipsoid) = self.placing.solid(splat, &mut self.counts) else { continue };
            let (min, max) = ellipsoid.bounds();
            if !self.builder.push(&ellipsoid, splat.colour, &mut self.runs, self.store, cancelled)? {
                return Err(out_of_reach(&self.plan.frame, min, max));
            }
            self.read.merge(&Read { min, max, own: Own { min, max, ..Read::NOTHING.own }, ..Read::NOTHING });
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(Read, SplatCounts)> {
        self.builder.flush(&mut self.runs, self.store)?;
        self.runs.flush(self.store)?;
        Ok((self.read, self.counts))
    }
}

/// First pass: writes the solid parts of all splats into runs. One thread reads; all workers rasterise.
pub(super) fn read_splats<'a>(
    set: &'a SplatSet,
    options: &ConvertOptions,
    plan: &Plan,
    store: &RunStore,
    build_bytes: u64,
    colouring: Option<Colouring>,
    monitor: &dyn Monitor,
) -> Result<SplatRead<'a>> {
    let mut all = SplatRead { read: Read::NOTHING, counts: SplatCounts::default(), scenes: Vec::new(), complete: true };
    if set.is_empty() {
        return Ok(all);
    }
    monitor.stage("reading splats", set.count, "splats");
    let placing = Placing::of(options);
    for path in &set.paths {
        let mut reader = SplatReader::open(path, &reading(options))?;
        let failed = AtomicBool::new(false);
        let cancelled = || monitor.cancelled() || failed.load(Ordering::Relaxed);
        let (send, receive) = crossbeam_channel::bounded::<Vec<Splat>>(options.threads);
        let start = || Rasteriser::new(&placing, plan, build_bytes, colouring, store);
        let work = || -> Result<(Read, SplatCounts)> {
            let mut rasteriser = start();
            receive.iter().try_for_each(|batch| rasteriser.take(&batch, &cancelled))?;
            rasteriser.finish()
        };
        let alone = |reader: &mut SplatReader| -> Result<_> {
            let mut rasteriser = start();
            let sink = &mut |batch: &[Splat]| rasteriser.take(batch, &cancelled);
            let summary = reader.for_each_batch(monitor, options.memory_bytes / 8, sink)?;
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
                    reader.for_each_batch(monitor, options.memory_bytes / 8, sink)
                };
                let producer =
                    spawn_in(scope, produce).map_err(|error| Error::io(path, "start a thread that reads it", error))?;
                let done =
                    on_threads(options.threads, || work().inspect_err(|_| failed.store(true, Ordering::Relaxed)));
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
        let mut of_file = Read::NOTHING;
        for (read, counts) in done {
            of_file.merge(&read);
            all.counts.add(&counts);
        }
        all.counts.read += summary.lost();
        all.counts.unusable += summary.lost();
        all.complete &= summary.lost() == 0;
        if of_file.min[0] <= of_file.max[0] {
            all.scenes.push(Scene { path, min: of_file.min, max: of_file.max });
        }
        all.read.merge(&of_file);
    }
    let (read, left_out) = (all.counts.read, all.counts.left_out());
    all.read.counts.read = read;
    all.read.own.kept = read - left_out;
    all.read.own.left_out = PointCounts { read: left_out, ..Read::NOTHING.counts };
    Ok(all)
}
