//! The two passes of a conversion in one run.

use crate::archive::{ArchiveWriter, Header, MAX_UNITS, Totals};
use crate::colour::{ColourPlan, ColourSource};
use crate::colours;
use crate::cubes::read_cubes;
use crate::disk::Files;
use crate::facts::InputFacts;
use crate::free::write_seen;
use crate::input::scenes::{Scene, far_apart};
use crate::input::{InputSet, PointCounts, ScanFile, TextLayout};
use crate::inputs::{Inputs, open_chosen};
use crate::mesh::MeshCounts;
use crate::meshes::read_meshes;
use crate::output::{Existing, Output, OutputKind, Protected};
use crate::pages::{Writing, write_archive};
use crate::plan::{Noise, Plan};
use crate::plan_file::PlanFile;
use crate::planning::plan;
use crate::points::{self, Read, Reading, Seeing, read_points};
use crate::removed::RemovedPoints;
use crate::resume::{Earlier, Identity, Progress, TakenOver};
use crate::shard_filter::ShardScope;
use crate::shard_inputs::Chosen;
use crate::splats::{SplatCounts, SplatSet, read_splats};
use crate::stations::Stations;
use crate::text::{counted, grouped};
use crate::unit::LengthUnit;
use crate::voxel::runs::RunStore;
use crate::voxel::spill::SpillPlace;
use crate::voxel::visibility::Views;
use crate::work::{Colouring, FirstPass};
use crate::{ColourMode, ConvertOptions, Error, Monitor, Parameter, Report, Result};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Temporary disk space per point (bytes): its record, its copies in the halos of other tile columns, and the index.
/// Points that lie closer together than tiles may have up to three copies each, which no header shows.
const TEMP_BYTES_PER_POINT: u64 = 9;
/// Temporary disk space per value of a point (bytes); 16-bit RGB takes twice as much.
const VALUE_BYTES_PER_POINT: u64 = 8;

/// Memory limits that decide when runs are spilled.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Bytes of runs kept in memory.
    pub retain_bytes: u64,
    /// Memory for one worker's run under construction (bytes).
    pub build_bytes: u64,
    /// Memory for the views of the stations (bytes).
    pub views_bytes: u64,
}

impl Limits {
    /// Most memory for all runs under construction (bytes): with more, a kill would lose more work than larger runs
    /// save.
    const MOST_BUILD_BYTES: u64 = 240 << 20;

    pub fn of(options: &ConvertOptions) -> Self {
        Self::for_threads(options.resources.threads, options)
    }

    /// Like [`of`](Self::of), but for another number of threads.
    pub fn for_threads(threads: usize, options: &ConvertOptions) -> Self {
        let memory_bytes = options.resources.memory_bytes;
        // Runs of values take half of it, if there are any.
        let builders = threads as u64 * if options.sections.colour == ColourMode::Off { 1 } else { 2 };
        let build_bytes = (memory_bytes / 4).min(Self::MOST_BUILD_BYTES) / builders;
        // The views of stations take half of what runs have otherwise.
        let views_bytes = if options.needs_stations() { memory_bytes / 4 } else { 0 };
        Self { retain_bytes: memory_bytes / 2 - views_bytes, build_bytes, views_bytes }
    }

    /// Returns the limits for meshes with textures: half as much for runs kept in memory.
    pub fn with_textures(self) -> Self {
        Self { retain_bytes: self.retain_bytes / 2, ..self }
    }
}

/// Converts `options.inputs` into the archive `options.output`, which appears either complete or not at all.
///
/// Cost: time linear in the number of points; memory of at most the budget plus a constant. If the points do not fit
/// into the budget, disk: about 9 bytes per point, up to 36 for points that all lie in the corners of tiles, and 8 or
/// 16 more with colours. Errors: unusable input or options, full disk, interruption by `monitor`. With
/// [`ConvertOptions::resume`] an error may leave temporary data from which a later call continues; [`Error::Resumable`]
/// says where.
pub fn convert(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Report> {
    options.check()?;
    convert_within(options, Limits::of(options), monitor)
}

/// Returns `path` as it is from the root; in a browser all paths are.
pub(super) fn absolute(path: &Path) -> std::io::Result<PathBuf> {
    if cfg!(target_arch = "wasm32") { Ok(path.to_path_buf()) } else { std::path::absolute(path) }
}

/// Returns the files that the removed points must not replace.
pub(super) fn protected_from_removed(options: &ConvertOptions, inputs: &Inputs) -> Protected {
    let mut protected: Protected = inputs.paths().collect();
    protected.add(&options.output);
    options.stations.iter().for_each(|stations| protected.add(stations));
    protected
}

/// Like [`convert`], but with other limits.
pub(crate) fn convert_within(options: &ConvertOptions, limits: Limits, monitor: &dyn Monitor) -> Result<Report> {
    let mut inputs = open_chosen(options, Chosen::of(options, monitor)?, monitor)?;
    // Create the output first, so that a file that must not be replaced is reported before the work.
    let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
    let output = Output::create_by(&options.output, kind, inputs.paths().collect(), &options.resources.temp_dir)?;
    let mut removed = match &options.removed {
        Some(path) => Some(RemovedPoints::create(path, protected_from_removed(options, &inputs))?),
        None => None,
    };
    let files = output.files().clone();
    let target = absolute(output.beside()).map_err(|error| Error::io(&options.output, "find", error))?;
    let earlier = Earlier::find(options, &output, &target)?;
    let known = earlier.as_ref().and_then(|earlier| earlier.surveyed(options));
    let (plan, surveyed) = plan(options, &inputs, known, monitor)?;
    let noise = surveyed.noise.or(options.plan_file.as_ref().and_then(|file| file.noise));
    let (source, colours) = colours_of(options, &mut inputs, monitor)?;
    let units = match &inputs.chosen {
        Some(chosen) => chosen.stated.units.clone(),
        None => inputs.length_units(),
    };
    let limits = if inputs.meshes.has_paint() { limits.with_textures() } else { limits };
    if units.len() > MAX_UNITS {
        let error = Error::limit("different units of inputs", units.len(), MAX_UNITS);
        return Err(error.with_suggestion(Parameter::Units));
    }
    let chosen = inputs.chosen.take();
    let read_of = (&inputs.scans, &inputs.splats);
    let mut scope = scope(options, read_of, &plan, colours, chosen.as_ref(), monitor)?;
    drop(chosen);
    let set = &mut inputs.scans;
    let seeing = match options.needs_stations() {
        true => {
            let Stations { stations, of_cloud, tag } = Stations::find(options.stations.as_deref(), set)?;
            set.set_tag(tag);
            scope.iter_mut().for_each(|scope| scope.sees_from(&stations));
            Some(Seeing {
                views: Views::new(&stations, plan.frame, limits.views_bytes)?,
                of_cloud,
                removes: plan.options.remove_moving,
            })
        }
        false => None,
    };
    let seeing = seeing.as_ref();
    let shard = scope.as_ref().map(|scope| scope.shard);
    let mut writer = ArchiveWriter::on(output, &plan)?;
    if options.sections.levels {
        writer.set_levels();
    }
    if options.sections.free_space {
        writer.set_seen();
    }
    if let Some(shard) = shard {
        writer.set_shard(shard);
    }

    let spilled = earlier.as_ref().map_or(0, Earlier::bytes);
    let (_, expected) = temp_bytes(options, set, limits.retain_bytes);
    check_free_space(options, &files, expected.saturating_sub(spilled))?;
    // Hashes take time and only serve to recognise spilled data later.
    let notes = options.resume || expected > 0;
    if notes || shard.is_some() {
        set.start_hashing();
    }
    let identity = Identity::of(options, &plan, surveyed, shard, set);
    let name = target.file_name().unwrap_or_default().to_owned();
    let place = SpillPlace { files, folder: options.resources.temp_dir.clone(), name, head: identity.head(&target) };
    let nothing = || Progress::nothing(set.files().len());
    let (mut store, progress, resumed) = match earlier {
        None => (RunStore::new(limits.retain_bytes, place), nothing(), None),
        Some(earlier) => {
            let TakenOver { spill, runs, progress, resumed } = earlier.take_over(&identity, place, set, monitor)?;
            (RunStore::resumed(limits.retain_bytes, spill, runs, resumed.points), progress, Some(resumed))
        }
    };
    let pass = FirstPass { options, plan: &plan, limits, scope: scope.as_ref(), store: &store, monitor };
    let conversion = Conversion { pass, inputs: &inputs, units: &units, noise, seeing, source, colours };
    let done = conversion.run(&progress, notes, writer, removed.as_mut());
    if let (Ok(_), Some(removed)) = (&done, removed) {
        removed.finish()?;
    }
    match done {
        Ok(report) => {
            let up = inputs.up.or(options.plan_file.as_ref().and_then(|file| file.up));
            let (spacing, placement, temp_bytes) = (surveyed.spacing, inputs.placement, store.temp_bytes());
            Ok(Report { spacing, up, placement, resumed, temp_bytes, ..report })
        }
        Err(error) => Err(keep(options, &mut store, error)),
    }
}

/// Returns the source of the colours, and their plan if it must be known before points are read, as in a part, which
/// does not see all points.
fn colours_of(
    options: &ConvertOptions,
    inputs: &mut Inputs,
    monitor: &dyn Monitor,
) -> Result<(Option<ColourSource>, Option<ColourPlan>)> {
    if let Some(file) = &options.plan_file {
        let source = file.colour.map(|plan| plan.scale.source);
        let found = colours::source_of_plan(source, options, inputs, monitor)?;
        return Ok((found.map(|found| found.source), file.colour));
    }
    let found = colours::source_of(options, inputs, monitor)?;
    let part = found.filter(|_| options.shard.is_some());
    let set = &mut inputs.scans;
    let scale = part.map(|found| colours::measure(set, found, options.resources.threads, monitor)).transpose()?;
    Ok((found.map(|found| found.source), scale.map(|scale| options.colour_plan(scale))))
}

/// Returns the part that the options ask for, or `None` for the whole; refuses inputs that are not those of the plan
/// file.
pub(super) fn scope(
    options: &ConvertOptions,
    inputs: (&InputSet, &SplatSet),
    plan: &Plan,
    colour: Option<ColourPlan>,
    chosen: Option<&Chosen>,
    monitor: &dyn Monitor,
) -> Result<Option<ShardScope>> {
    if let Some(shard) = options.shard {
        return ShardScope::new(shard, inputs, plan, options, colour, chosen, monitor).map(Some);
    }
    if let Some(file) = &options.plan_file {
        let facts = InputFacts::of(inputs, options.resources.threads, monitor)?;
        file.check_same_inputs(&PlanFile::of(facts, plan.clone(), options))?;
    }
    Ok(None)
}

/// Explains why the archive of a scan with points is empty.
fn nothing_kept(header: &Header, voxels_dropped: u64, points_moving: u64, splats: &SplatCounts) -> String {
    let Header { points_read, points_kept, points_excluded, points_withheld, .. } = *header;
    let left_out = points_excluded + points_withheld + points_moving + splats.left_out();
    let of_splats = match splats.left_out() {
        0 => String::new(),
        count => format!(", {} by limits of splats or unusable", counted(count, "splat")),
    };
    let why = match points_kept {
        0 => format!(
            "all {} are left out ({} by class, {} withheld, {} moving{of_splats}, {} without a finite position)",
            counted(points_read, "point"),
            grouped(points_excluded),
            grouped(points_withheld),
            grouped(points_moving),
            grouped(points_read - left_out)
        ),
        _ => format!("all {} have too few points or no neighbours", counted(voxels_dropped, "voxel")),
    };
    format!("nothing is kept: {why}; the archive is empty")
}

/// Keeps the spilled data after an error, if `resume` is set and the data is of use.
fn keep(options: &ConvertOptions, store: &mut RunStore, error: Error) -> Error {
    // After these errors the archive is complete, under its own name or another.
    let is_complete = matches!(error, Error::NotDurable { .. } | Error::Output { .. });
    let points = store.points_on_disk();
    if !options.resume || is_complete || points == 0 {
        return error;
    }
    let bytes = store.temp_bytes();
    match store.keep() {
        Some(path) => Error::Resumable { source: Box::new(error), path, bytes, points },
        None => error,
    }
}

/// Conversion whose plan and inputs are known.
struct Conversion<'a> {
    pass: FirstPass<'a>,
    inputs: &'a Inputs,
    units: &'a [LengthUnit],
    noise: Option<Noise>,
    seeing: Option<&'a Seeing>,
    source: Option<ColourSource>,
    /// Colour plan, if it does not follow from the points that are read.
    colours: Option<ColourPlan>,
}

/// Result of the first pass over all inputs.
struct AllRead {
    read: Read,
    mesh_counts: MeshCounts,
    points_made: u64,
    splat_counts: SplatCounts,
    cubes: u64,
    points_not_finite: u64,
    points_missing: u64,
    complete: bool,
}

impl Conversion<'_> {
    /// Runs both passes. `notes` makes runs record which input they cover, besides what `progress` has of an earlier run.
    fn run(
        &self,
        progress: &Progress,
        notes: bool,
        mut writer: ArchiveWriter,
        mut removed: Option<&mut RemovedPoints>,
    ) -> Result<Report> {
        let Inputs { scans, meshes, splats, cubes, .. } = self.inputs;
        let FirstPass { options, plan, scope, store, monitor, .. } = self.pass;
        let mut all = self.read(progress, notes, &mut writer)?;
        let (threads, columns) = (options.resources.threads, scope.map(|scope| (scope.shard.first, scope.shard.last)));
        if let Some(removed) = &mut removed {
            removed.set_bounds(all.read.min, all.read.max);
        }
        self.seeing.inspect(|seeing| seeing.views.finish());
        let writing = Writing {
            memory_bytes: options.resources.memory_bytes,
            threads,
            columns,
            views: self.seeing.filter(|seeing| seeing.removes).map(|seeing| &seeing.views),
            temp_dir: &options.resources.temp_dir,
            accumulator: options.resources.accumulator.as_deref(),
        };
        let left_out = write_archive(plan, store, writing, &mut writer, removed, monitor)?;
        let seen = self.seeing.filter(|_| options.sections.free_space);
        let seen = seen.map(|seeing| write_seen(&seeing.views, columns, threads, &mut writer, monitor)).transpose()?;
        let own = &mut all.read.own;
        own.kept -= left_out.moving;
        own.left_out.read += left_out.moving;
        let crs = scans.crs().unwrap_or_default().to_owned();
        if monitor.cancelled_at_last() {
            return Err(Error::Interrupted);
        }
        let header = writer.finish(Totals { noise: self.noise, ..own.totals(&crs, self.units) })?;
        if reads_all(scope) && header.points_read > 0 && header.voxels.occupied == 0 {
            // The part that counts splats counts those left out.
            let is_counted = scope.is_none_or(ShardScope::owns_meshes);
            let splats = if is_counted { all.splat_counts } else { SplatCounts::default() };
            monitor.warn(&nothing_kept(&header, left_out.voxels, left_out.moving, &splats).into());
        }
        let bytes = [scans.bytes(), meshes.bytes(), splats.bytes(), cubes.bytes()];
        Ok(Report {
            header,
            shard: scope.map(|scope| scope.shard),
            crs,
            units: self.units.to_vec(),
            noise: self.noise,
            spacing: None,
            up: None,
            placement: None,
            texts: texts(scans),
            input_bytes: bytes.into_iter().fold(0, u64::saturating_add),
            temp_bytes: 0,
            resumed: None,
            points_not_finite: all.points_not_finite,
            points_missing: all.points_missing,
            points_moving: left_out.moving,
            seen,
            complete: all.complete,
            triangles: all.mesh_counts,
            splats: all.splat_counts,
            cubes: all.cubes,
            points_made: all.points_made,
            voxels_dropped: left_out.voxels,
        })
    }

    /// First pass: writes points, triangles, splats and cubes into runs, and sets the colours and inputs of `writer`.
    fn read(&self, progress: &Progress, notes: bool, writer: &mut ArchiveWriter) -> Result<AllRead> {
        let Inputs { scans, meshes, splats, cubes, .. } = self.inputs;
        let (pass, seeing) = (self.pass, self.seeing);
        let FirstPass { options, scope, monitor, .. } = pass;
        let reading = Reading { progress, notes, seeing, source: self.source };
        let (mut read, of_files, values) = read_points(pass, scans, reading)?;
        let colours = self.colours.or(values.map(|values| options.colour_plan(values.scale())));
        if let Some(colours) = colours {
            writer.set_colours(colours);
        }
        // A part that leaves files out cannot conclude that nothing in the whole is usable.
        let whole = reads_all(scope);
        let has_others = !(meshes.is_empty() && splats.is_empty() && cubes.inputs().next().is_none());
        if whole && !(options.allow_incomplete && has_others) {
            refuse_unusable(scans, &read.counts)?;
        }
        scans.check_complete(monitor)?;
        let PointCounts { not_finite: points_not_finite, missing, .. } = read.own.left_out;
        let colouring = colours.map(|ColourPlan { scale, .. }| Colouring {
            scale,
            with_points: seeing.is_some_and(|seeing| seeing.removes),
        });
        let of_meshes = read_meshes(pass, meshes, colouring.filter(|_| meshes.has_paint()))?;
        let of_splats = read_splats(pass, splats, colouring.filter(|_| splats.has_paint()))?;
        let of_cubes = read_cubes(pass, cubes)?;
        let cube_count = of_cubes.read.counts.read;
        if let Some(scope) = scope {
            let of_scans = scans.files().iter().enumerate().map(|(number, file)| (file.path(), scans.hash(number)));
            let meshes = scans.meshes().iter().map(PathBuf::as_path).zip(of_meshes.source.hashes.iter().copied());
            let splats = splats.paths().zip(of_splats.source.hashes.iter().copied());
            writer.set_read(scope.inputs_read(of_scans.chain(meshes).chain(splats)));
        }
        let mut complete = scans.is_complete() && meshes.is_complete() && splats.is_complete() && cubes.is_complete();
        let mut scenes: Vec<Scene> = points::scenes(scans, &of_files).collect();
        for source in [of_meshes.source, of_splats.source, of_cubes] {
            read.merge(&source.read);
            complete &= source.complete;
            scenes.extend(source.scenes);
        }
        if whole {
            far_apart(&scenes).inspect(|warning| monitor.warn(warning));
        }
        if whole {
            refuse_unusable_splats(splats, &of_splats.counts, read.counts.read)?;
        }
        let unusable = read.counts.not_finite + of_splats.counts.unusable;
        if whole && !complete && read.counts.read == unusable {
            return Err(Error::parameter("INPUT", "nothing of it can be used; fetch or write it again"));
        }
        if whole && read.counts.read == 0 {
            monitor.warn(&"the input holds no points: the archive is empty".into());
        }
        Ok(AllRead {
            read,
            mesh_counts: of_meshes.triangles,
            points_made: of_meshes.points_made,
            splat_counts: of_splats.counts,
            cubes: cube_count,
            points_not_finite,
            points_missing: scans.points_missing().saturating_add(missing).saturating_add(of_splats.counts.missing),
            complete,
        })
    }
}

/// Returns whether a conversion reads all inputs, as the whole and some parts do.
fn reads_all(scope: Option<&ShardScope>) -> bool {
    scope.is_none_or(ShardScope::reads_all)
}

/// Returns the scans in text, and how their columns were understood.
fn texts(set: &InputSet) -> Vec<(PathBuf, TextLayout)> {
    let of_file = |file: &ScanFile| Some((file.path().to_path_buf(), file.text_layout()?.clone()));
    set.files().iter().filter_map(of_file).collect()
}

/// Estimates from the headers how many points one run reads and how much temporary data it writes beyond `retain_bytes`
/// (bytes). Headers may lie, so more than one point per byte is not believed.
pub(super) fn temp_bytes(options: &ConvertOptions, set: &InputSet, retain_bytes: u64) -> (u64, u64) {
    let parts = options.shard.map_or(1, |shard| u64::from(shard.count.max(1)));
    // A part need not have opened all inputs.
    let points = match &options.plan_file {
        Some(file) if options.shard.is_some() => {
            file.inputs.iter().map(|input| input.points.min(input.bytes)).fold(0, u64::saturating_add)
        }
        _ => set.points_stated().min(set.bytes()),
    } / parts;
    let values = match options.sections.colour {
        ColourMode::Off => 0,
        ColourMode::Of(ColourSource::Intensity | ColourSource::Class) => VALUE_BYTES_PER_POINT,
        _ => 2 * VALUE_BYTES_PER_POINT,
    };
    // If moving points are removed, each value follows the record of its point.
    let values = values + if options.plan.remove_moving && values > 0 { VALUE_BYTES_PER_POINT } else { 0 };
    (points, points.saturating_mul(TEMP_BYTES_PER_POINT + values).saturating_sub(retain_bytes))
}

/// Fails if the free disk space is too small for the temporary data.
pub(super) fn check_free_space(options: &ConvertOptions, files: &Files, needed: u64) -> Result<()> {
    let dir = &options.resources.temp_dir;
    let free = files.free_bytes(dir).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Error::output(dir, "no such folder; temporary data needs one that exists"),
        _ => Error::io(dir, "ask for its free space", error),
    })?;
    if needed > free {
        let points = needed / TEMP_BYTES_PER_POINT;
        let what = format!("temporary data for {points} points in {} (bytes; more memory needs less)", dir.display());
        return Err(Error::limit(what, needed, free).with_suggestion(Parameter::TempDir));
    }
    Ok(())
}

/// Refuses scans that state points of which none is usable: an empty archive in place of a good one helps no user.
/// Scans that state no points, or whose points are all excluded on purpose, make an empty archive.
fn refuse_unusable(set: &InputSet, counts: &PointCounts) -> Result<()> {
    let Some(first) = set.files().iter().find(|file| file.points_stated() > 0) else { return Ok(()) };
    if counts.read == 0 {
        let reason = format!(
            "the header states {} points, but none can be read: the file is cut or damaged; fetch or write it again",
            first.points_stated()
        );
        return Err(Error::input(first.path(), "points", reason));
    }
    if counts.not_finite == counts.read {
        let reason = match first.has_header() {
            true => {
                "no point has a finite position within 1e12 m: scale or offset in the header (bytes 131 to 178) are damaged; \
                 fetch or write the file again"
            }
            false => "no point has a finite position within 1e12 m; fetch or write the file again",
        };
        return Err(Error::input(first.path(), "points", reason));
    }
    Ok(())
}

/// Fails if all that was `read` are splats of which none is usable: an empty archive would silently replace a good one.
fn refuse_unusable_splats(set: &SplatSet, counts: &SplatCounts, read: u64) -> Result<()> {
    match set.paths().next() {
        Some(first) if counts.unusable > 0 && counts.unusable == read => {
            let reason = format!("none of {} can be used; fetch or write it again", grouped(read));
            Err(Error::input(first, "splats", reason))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temporary_data_that_does_not_fit_is_refused_by_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let mut options = ConvertOptions::new(Vec::new(), "a.slices".into());
        options.resources.temp_dir = folder.path().to_path_buf();
        check_free_space(&options, &Files::current(), 0).unwrap();
        let error = check_free_space(&options, &Files::current(), u64::MAX).unwrap_err();
        assert!(matches!(error, Error::Limit { .. }) && error.suggestion() == Some(&Parameter::TempDir), "{error}");
        assert!(error.to_string().contains(&folder.path().display().to_string()), "{error}");
    }
}
