//! Conversion of scans and meshes into one archive.
//!
//! ```no_run
//! use slicewalk_convert::{ConvertOptions, PixelSize, convert};
//!
//! let mut options = ConvertOptions::new(vec!["scan.laz".into()], "scan.slices".into());
//! options.pixel = PixelSize::Metres(0.05); // or PixelSize::Auto: four times the point spacing
//! options.plan.max_slope_deg = 40.0;
//! let report = convert(&options, &slicewalk::NoMonitor)?;
//! println!("{} voxels", report.header.voxels.occupied);
//! # Ok::<(), slicewalk::Error>(())
//! ```
//!
//! Two passes in bounded memory. First, all workers read pieces of the input and sort their points, and the voxels that
//! triangles fill, into runs by tile column. Then the merged runs yield tile columns in archive order: workers
//! accumulate them to voxels, classify floors and obstacles, form spans and encode pages, and one thread writes the
//! pages in order.
//!
//! Memory for a budget of `M`: `M/2` for runs kept in memory; `M/4` for runs under construction and afterwards for
//! columns being processed; `M/8` each for pieces of the input and for encoded pages. Nothing is sized by what a header
//! states.

mod colours;
mod columns;
mod cubes;
mod facts;
mod free;
mod holes;
#[doc(hidden)]
pub mod info;
mod meshes;
mod options;
mod pages;
mod pipeline;
mod plan_file;
mod points;
mod preview;
mod removed;
mod report;
mod resume;
mod shard_filter;
mod shard_inputs;
#[doc(hidden)]
pub mod size;
mod splats;
mod split;
mod stations;
mod sync;
#[cfg(test)]
mod tests;
mod upright;
mod voxel;
mod work;
mod writer;

pub use facts::InputFacts;
pub use free::SeenCounts;
pub use options::{ColourMode, ConvertOptions, PixelSize, ShardOptions, Tolerance};
pub use plan_file::{PlanFile, Stated};
pub use preview::{Preview, PreviewInput, preview};
pub use report::Report;
pub use resume::Resumed;
pub use slicewalk_base::placement::Similarity;
pub use splats::{SplatCounts, SplatRules};
pub use upright::{Turn, UpFound};
pub use writer::PointWriter;

use crate::archive::{ArchiveWriter, Header, MAX_UNITS, Totals};
use crate::colour::{ColourPlan, ColourSource};
use crate::disk::Files;
use crate::frame::{Frame, MAX_CELL_M};
use crate::input::scenes::{Scene, far_apart};
use crate::input::spacing::{Spacing, Survey, estimate_spacing};
use crate::input::{InputOptions, InputSet, PointCounts, ScanFile, TextLayout, Units};
use crate::mesh::{MeshOptions, MeshSet};
use crate::output::{Existing, Output, OutputKind, Protected};
use crate::plan::{Noise, Plan, PlanOptions};
use crate::text::{counted, grouped, number};
use crate::unit::LengthUnit;
use crate::voxel::runs::RunStore;
use crate::voxel::spill::SpillPlace;
use crate::voxel::visibility::Views;
use cubes::{CubeSet, read_cubes};
use free::write_seen;
use meshes::{Colouring, MeshReading, read_meshes};
use pages::{Writing, write_archive};
use points::{Reading, Seeing, read_points};
use removed::RemovedPoints;
use resume::{Earlier, Identity, Progress, TakenOver};
use shard_filter::ShardScope;
use shard_inputs::Chosen;
use slicewalk::{archive, codec, page};
use slicewalk_base::{
    Error, Monitor, NoMonitor, Parameter, Result, Warning, bytes, colour, disk, frame, output, placement, plan, text,
    unit,
};
use slicewalk_input as input;
use slicewalk_mesh as mesh;
use splats::{Divided, SplatSet, read_splats};
use stations::Stations;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Smallest memory budget (bytes).
pub const MIN_MEMORY_BYTES: u64 = 64 << 20;
/// Automatic pixel size, in units of the scan's point spacing.
pub const AUTO_PIXEL_SPACINGS: f64 = 4.0;
/// Pixels along the longer side of meshes if the pixel size is chosen automatically (thesis, equation 3.3 with the
/// sides of the images in place of the printed ones, at the larger of its two resolutions).
pub const AUTO_PIXELS: f64 = 700.0;
/// Temporary disk space per point (bytes): its record, its copies in the halos of other tile columns, and the index.
/// Points that lie closer together than tiles may have up to three copies each, which no header shows.
const TEMP_BYTES_PER_POINT: u64 = 9;
/// Temporary disk space per value of a point (bytes); 16-bit RGB takes twice as much.
const VALUE_BYTES_PER_POINT: u64 = 8;

/// Input files of a conversion.
pub(crate) struct Inputs {
    pub scans: InputSet,
    pub meshes: MeshSet,
    pub splats: SplatSet,
    pub cubes: CubeSet,
    /// Unit of splats and cubes.
    units: Units,
    /// Direction that points up, if the input shows it.
    pub up: Option<UpFound>,
    /// Placement of all inputs, its rotation upwards included.
    pub placement: Option<Similarity>,
    /// Choice of inputs of a part that need not open all of them.
    pub chosen: Option<Chosen>,
}

impl Inputs {
    /// Returns the paths of all inputs that the command reads, opened or not.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        let opened = self.scans.files().iter().map(ScanFile::path);
        let closed = self.chosen.iter().flat_map(|chosen| &chosen.closed);
        opened
            .chain(self.scans.meshes().iter().chain(closed).map(PathBuf::as_path))
            .chain(self.splats.paths())
            .chain(self.cubes.paths())
    }

    /// Returns the distinct units of the inputs.
    fn length_units(&self) -> Vec<LengthUnit> {
        let of_scans = self.scans.length_units().chain(self.meshes.length_unit());
        LengthUnit::distinct(
            of_scans.chain(self.splats.length_unit(self.units)).chain(self.cubes.length_unit(self.units)),
        )
    }
}

/// Memory for the textures of meshes (bytes), taken from the share of runs and from the later share of encoded pages.
fn texture_bytes(options: &ConvertOptions) -> u64 {
    options.memory_bytes / 8 * 3
}

/// Opens the inputs of a conversion.
pub(crate) fn open_inputs(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Inputs> {
    open_chosen(options, None, monitor)
}

/// Opens the `chosen` inputs of a conversion, or all of them.
fn open_chosen(options: &ConvertOptions, chosen: Option<Chosen>, monitor: &dyn Monitor) -> Result<Inputs> {
    options.check()?;
    let input_options = InputOptions {
        units: options.units,
        epsg: options.epsg,
        columns: options.columns,
        up: options.plan.up,
        placement: options.placement,
        exclude_classes: options.plan.exclude_classes,
        memory_bytes: options.memory_bytes / 8 / options.threads as u64,
        // Set later, and not needed for an automatic pixel size.
        colour: None,
        allow_incomplete: options.allow_incomplete,
        // Hash only the pass that reads the points of the archive, not the pass for an automatic pixel size.
        hash: false,
        threads: options.threads,
    };
    let mut cubes = CubeSet::default();
    let (mut scans, splats) = match &chosen {
        None => {
            let (of_cubes, others) = CubeSet::among(options, monitor)?;
            cubes = of_cubes;
            match others.is_empty() && !options.inputs.is_empty() {
                true => (InputSet::of_paths(others, input_options, monitor)?, Vec::new()),
                false => Divided::open(&others, input_options, monitor)?,
            }
        }
        Some(chosen) => {
            let mut scans = InputSet::of_paths(chosen.opened.clone(), input_options, monitor)?;
            chosen.check_stated(&scans)?;
            scans.set_crs(chosen.stated.crs.clone());
            (scans, chosen.splats.clone())
        }
    };
    let mut splats = SplatSet::open(splats, options, monitor)?;
    let mesh_options = MeshOptions {
        units: options.units,
        up: options.plan.up,
        placement: options.placement,
        memory_bytes: options.memory_bytes / 8,
        temp_dir: options.temp_dir.clone(),
        allow_incomplete: options.allow_incomplete,
        hash: options.shard.is_some(),
        // Set later.
        colours: false,
        texture_bytes: texture_bytes(options),
    };
    let meshes = MeshSet::open(scans.meshes(), mesh_options, monitor)?;
    scans.set_meshes(meshes.paths());
    let (up, placement) = place(options, &mut scans, &meshes, &mut splats, &cubes, monitor)?;
    Ok(Inputs { scans, meshes, splats, cubes, units: options.units, up, placement, chosen })
}

/// Places all inputs. Returns the direction that points up if it was found, and the placement.
fn place(
    options: &ConvertOptions,
    scans: &mut InputSet,
    meshes: &MeshSet,
    splats: &mut SplatSet,
    cubes: &CubeSet,
    monitor: &dyn Monitor,
) -> Result<(Option<UpFound>, Option<Similarity>)> {
    let refused = |path: &Path, reason: &str| {
        Err(Error::parameter(Parameter::Other("up".into()), format!("{}: {reason}", path.display())))
    };
    if options.turn != Turn::None {
        if let Some(mesh) = meshes.paths().next() {
            return refused(mesh, "meshes are turned by --up y or z, or by --transform");
        }
        if let (Some(_), Some(scan)) = (scans.crs().filter(|_| options.epsg.is_none()), scans.files().first()) {
            return refused(scan.path(), "it states a reference system, in which z is up; leave --up out");
        }
    }
    if let Some(file) = cubes.inputs().next().filter(|_| options.turn != Turn::None || options.placement.is_some()) {
        return refused(file, "its cubes lie on the grid of pixels and are not moved; leave --up and --transform out");
    }
    let up = match options.turn {
        Turn::Auto => {
            scans.set_placement(None);
            Some(upright::find_up(scans, splats, options, monitor)?)
        }
        _ => None,
    };
    let placement = options.placement_with(up.as_ref());
    if options.placement.is_some() && options.plan_file.is_none() && options.epsg.is_none() && scans.crs().is_some() {
        let text = "a scan states a reference system; the matrix moves its points, and the archive keeps the system";
        monitor.warn(&text.into());
    }
    scans.set_placement(placement);
    splats.set_placement(placement);
    Ok((up, placement))
}

/// Gaps of up to this many spacings lie between points that are spread at random: a disc this wide around a random
/// place holds no point in one of a thousand cases.
const GAP_SPACINGS: f64 = 3.0;

/// Returns the width of gaps between the points of the scans: three times their spacing (m). `None` without scans. For
/// [`ConvertOptions::fill_holes_m`] where points lie farther apart than pixels. Reads the points once.
pub fn gap_width_m(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Option<f64>> {
    let opened = open_inputs(options, monitor)?;
    if opened.scans.files().is_empty() {
        return Ok(None);
    }
    Ok(Some(GAP_SPACINGS * estimate_spacing(&opened.scans, options.threads, monitor)?.spacing_m))
}

/// Measurements from which automatic options follow; `None` where the options were given.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Surveyed {
    /// Source of the pixel size.
    pub spacing: Option<Spacing>,
    /// Source of the tolerance.
    pub noise: Option<Noise>,
}

impl Surveyed {
    /// Reads the scans once, if an option follows from them and the result is not `known` from an earlier run.
    fn of(options: &ConvertOptions, set: &InputSet, known: Option<Self>, monitor: &dyn Monitor) -> Result<Self> {
        if let Some(known) = known {
            return Ok(known);
        }
        let auto_pixel = options.pixel == PixelSize::Auto && !set.files().is_empty();
        let no_noise = options.tolerance_auto.then(Noise::default);
        if set.files().is_empty() || !(auto_pixel || options.tolerance_auto) {
            return Ok(Self { spacing: None, noise: no_noise });
        }
        let survey = Survey::read(set, options.threads, if auto_pixel { "spacing" } else { "noise" }, monitor)?;
        let spacing = auto_pixel.then(|| survey.spacing()).transpose()?;
        // With `--allow-incomplete`, the main pass reports diagnostics.
        set.check_complete(&NoMonitor)?;
        Ok(Self { spacing, noise: no_noise.map(|none| survey.noise().unwrap_or(none)) })
    }
}

/// Returns the plan of a conversion of `inputs` and the measurements it follows from, which may be `known` from an
/// earlier run.
pub(crate) fn plan(
    options: &ConvertOptions,
    Inputs { scans: set, meshes, splats, cubes, .. }: &Inputs,
    known: Option<Surveyed>,
    monitor: &dyn Monitor,
) -> Result<(Plan, Surveyed)> {
    let surveyed = Surveyed::of(options, set, known, monitor)?;
    let is_auto = options.pixel == PixelSize::Auto && surveyed.spacing.is_none();
    let of_cubes = cubes.finest_m().filter(|_| is_auto);
    let pixel_m = match (options.pixel, surveyed.spacing) {
        (PixelSize::Metres(pixel_m), _) => pixel_m,
        (PixelSize::Auto, Some(spacing)) => round_to_digits(AUTO_PIXEL_SPACINGS * spacing.spacing_m, 2),
        (PixelSize::Auto, None) => match of_cubes {
            Some(finest_m) => finest_m,
            None => pixel_of_extent(options, meshes, splats, monitor)?,
        },
    };
    if surveyed.noise.is_some_and(|noise| noise.regions == 0) {
        let text = "--tolerance auto: too little of the input is flat to measure its noise; heights stay as they are";
        monitor.warn(&text.into());
    }
    if options.pixel == PixelSize::Auto && !(1e-6..=MAX_CELL_M).contains(&pixel_m) {
        let reason = format!("the input asks for pixels of {pixel_m} m; give the pixel size in metres");
        return Err(Error::parameter(Parameter::AutomaticPixelSize, reason));
    }
    let mut plan = options.plan_of(pixel_m)?;
    if let Some(finest_m) = of_cubes.filter(|_| options.slice_m.is_none()) {
        // A cube is a voxel, so exporting the archive again gives the same cubes.
        plan.frame = Frame::new(finest_m, finest_m)?;
    }
    if let Some(noise) = surveyed.noise {
        plan.options.tolerance_m = noise.tolerance_m().min(MAX_CELL_M);
    }
    Ok((plan, surveyed))
}

impl ConvertOptions {
    /// Returns the plan for this pixel size (m).
    fn plan_of(&self, pixel_m: f64) -> Result<Plan> {
        let slice_m = self.slice_m.unwrap_or(round_to_digits(3.0 * pixel_m, 12).min(MAX_CELL_M));
        let fill_holes = self.fill_holes_pixels(pixel_m)?;
        Ok(Plan { frame: Frame::new(pixel_m, slice_m)?, options: PlanOptions { fill_holes, ..self.plan.clone() } })
    }

    /// Returns the width of the widest holes to close (pixels of this size, m).
    pub fn fill_holes_pixels(&self, pixel_m: f64) -> Result<u8> {
        let Some(widest_m) = self.fill_holes_m else { return Ok(self.plan.fill_holes) };
        // Slightly more, so that three pixels of 0.1 m make 0.3 m.
        let pixels = (widest_m / pixel_m * (1.0 + 1e-9)).floor();
        let (pixel, most) = (number(pixel_m), PlanOptions::MOST_FILL_PIXELS);
        let reason = match pixels {
            pixels if pixels < 1.0 => format!("{} m is narrower than a pixel of {pixel} m", number(widest_m)),
            pixels if pixels > f64::from(most) => {
                let widest = number(f64::from(most) * pixel_m);
                format!("{} m is too wide: holes of up to {most} pixels, {widest} m, can be closed", number(widest_m))
            }
            _ => return Ok(pixels as u8),
        };
        Err(Error::parameter(Parameter::FillHoles, reason))
    }

    /// Returns whether the positions of scanners change the archive.
    pub(crate) fn needs_stations(&self) -> bool {
        self.plan.remove_moving || self.free_space
    }

    fn check(&self) -> Result<()> {
        if self.memory_bytes < MIN_MEMORY_BYTES {
            let reason = format!("{} bytes are too few; give at least {MIN_MEMORY_BYTES} (64MiB)", self.memory_bytes);
            return Err(Error::parameter(Parameter::Memory, reason));
        }
        if self.threads == 0 {
            return Err(Error::parameter(Parameter::Threads, "0 do no work; give at least 1"));
        }
        if let Some(widest_m) = self.fill_holes_m.filter(|widest_m| !(*widest_m > 0.0 && widest_m.is_finite())) {
            let reason = format!("{} is not a width of holes in metres; give a length above 0", number(widest_m));
            return Err(Error::parameter(Parameter::FillHoles, reason));
        }
        if self.stations.is_some() && !self.needs_stations() {
            let reason = "a table of stations changes nothing unless moving points are removed or seen space is stored";
            return Err(Error::parameter(Parameter::Stations, reason));
        }
        if self.resume && crate::bytes::address(&self.output).is_some() {
            let reason = "an archive at an address cannot be resumed; leave it out, or write a file";
            return Err(Error::parameter(Parameter::Resume, reason));
        }
        self.check_colour()?;
        self.splats.check()?;
        self.plan.check()
    }
}

/// Memory limits that decide when runs are spilled.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Bytes of runs kept in memory.
    retain_bytes: u64,
    /// Memory for one worker's run under construction (bytes).
    build_bytes: u64,
    /// Memory for the views of the stations (bytes).
    views_bytes: u64,
}

impl Limits {
    /// Most memory for all runs under construction (bytes): with more, a kill would lose more work than larger runs
    /// save.
    const MOST_BUILD_BYTES: u64 = 240 << 20;

    fn of(options: &ConvertOptions) -> Self {
        // Runs of values take half of it, if there are any.
        let builders = options.threads as u64 * if options.colour == ColourMode::Off { 1 } else { 2 };
        let build_bytes = (options.memory_bytes / 4).min(Self::MOST_BUILD_BYTES) / builders;
        // The views of stations take half of what runs have otherwise.
        let views_bytes = if options.needs_stations() { options.memory_bytes / 4 } else { 0 };
        Self { retain_bytes: options.memory_bytes / 2 - views_bytes, build_bytes, views_bytes }
    }

    /// Returns the limits for meshes with textures: half as much for runs kept in memory.
    fn with_textures(self) -> Self {
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
fn absolute(path: &Path) -> std::io::Result<PathBuf> {
    if cfg!(target_arch = "wasm32") { Ok(path.to_path_buf()) } else { std::path::absolute(path) }
}

/// Like [`convert`], but with other limits.
pub(crate) fn convert_within(options: &ConvertOptions, limits: Limits, monitor: &dyn Monitor) -> Result<Report> {
    let mut inputs = open_chosen(options, Chosen::of(options, monitor)?, monitor)?;
    // Create the output first, so that a file that must not be replaced is reported before the work.
    let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
    let output = Output::create_by(&options.output, kind, inputs.paths().collect(), &options.temp_dir)?;
    let mut removed = match &options.removed {
        Some(path) => {
            let mut protected: Protected = inputs.paths().collect();
            protected.add(&options.output);
            options.stations.iter().for_each(|stations| protected.add(stations));
            Some(RemovedPoints::create(path, protected)?)
        }
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
    let Inputs { scans: mut set, meshes, splats, cubes, up, placement, chosen, .. } = inputs;
    let limits = if meshes.has_paint() { limits.with_textures() } else { limits };
    if units.len() > MAX_UNITS {
        let error = Error::limit("different units of inputs", units.len(), MAX_UNITS);
        return Err(error.with_suggestion(Parameter::Units));
    }
    let mut scope = scope(options, (&set, &splats), &plan, colours, chosen.as_ref(), monitor)?;
    drop(chosen);
    let seeing = match options.needs_stations() {
        true => {
            let Stations { stations, of_cloud, tag } = Stations::find(options.stations.as_deref(), &set)?;
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
    if options.levels {
        writer.set_levels();
    }
    if options.free_space {
        writer.set_seen();
    }
    if let Some(shard) = shard {
        writer.set_shard(shard);
    }

    let spilled = earlier.as_ref().map_or(0, Earlier::bytes);
    let (_, expected) = temp_bytes(options, &set, limits.retain_bytes);
    check_free_space(options, &files, expected.saturating_sub(spilled))?;
    // Hashes take time and only serve to recognise spilled data later.
    let notes = options.resume || expected > 0;
    if notes || shard.is_some() {
        set.start_hashing();
    }
    let identity = Identity::of(options, &plan, surveyed, shard, &set);
    let name = target.file_name().unwrap_or_default().to_owned();
    let place = SpillPlace { files, folder: options.temp_dir.clone(), name, head: identity.head(&target) };
    let nothing = || Progress::nothing(set.files().len());
    let (mut store, progress, resumed) = match earlier {
        None => (RunStore::new(limits.retain_bytes, place), nothing(), None),
        Some(earlier) => {
            let TakenOver { spill, runs, progress, resumed } = earlier.take_over(&identity, place, &set, monitor)?;
            (RunStore::resumed(limits.retain_bytes, spill, runs, resumed.points), progress, Some(resumed))
        }
    };
    let conversion = Conversion {
        options,
        limits,
        plan: &plan,
        set: &set,
        meshes: &meshes,
        splats: &splats,
        cubes: &cubes,
        scope,
        progress,
        notes,
        units,
        noise,
        seeing,
        source,
        colours,
        monitor,
    };
    let done = conversion.run(&store, writer, removed.as_mut());
    if let (Ok(_), Some(removed)) = (&done, removed) {
        removed.finish()?;
    }
    match done {
        Ok(report) => {
            let up = up.or(options.plan_file.as_ref().and_then(|file| file.up));
            Ok(Report { spacing: surveyed.spacing, up, placement, resumed, temp_bytes: store.temp_bytes(), ..report })
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
    let scale = part.map(|found| colours::measure(set, found, options.threads, monitor)).transpose()?;
    Ok((found.map(|found| found.source), scale.map(|scale| options.colour_plan(scale))))
}

/// Returns the part that the options ask for, or `None` for the whole; refuses inputs that are not those of the plan
/// file.
fn scope(
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
        let facts = InputFacts::of(inputs, options.threads, monitor)?;
        file.check_same_inputs(&PlanFile::of(facts, plan.clone(), options))?;
    }
    Ok(None)
}

/// Explains why the archive of a scan with points is empty.
fn nothing_kept(header: &Header, voxels_dropped: u64, points_moving: u64) -> String {
    let Header { points_read, points_kept, points_excluded, points_withheld, .. } = *header;
    let why = match points_kept {
        0 => format!(
            "all {} are left out ({} by class, {} withheld, {} moving, {} without a finite position)",
            counted(points_read, "point"),
            grouped(points_excluded),
            grouped(points_withheld),
            grouped(points_moving),
            grouped(points_read - points_excluded - points_withheld - points_moving)
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
    options: &'a ConvertOptions,
    limits: Limits,
    plan: &'a Plan,
    set: &'a InputSet,
    meshes: &'a MeshSet,
    splats: &'a SplatSet,
    cubes: &'a CubeSet,
    scope: Option<ShardScope>,
    progress: Progress,
    notes: bool,
    units: Vec<LengthUnit>,
    noise: Option<Noise>,
    seeing: Option<&'a Seeing>,
    source: Option<ColourSource>,
    /// Colour plan, if it does not follow from the points that are read.
    colours: Option<ColourPlan>,
    monitor: &'a dyn Monitor,
}

impl Conversion<'_> {
    fn run(
        self,
        store: &RunStore,
        mut writer: ArchiveWriter,
        mut removed: Option<&mut RemovedPoints>,
    ) -> Result<Report> {
        let Self {
            options,
            limits,
            plan,
            set,
            meshes,
            splats,
            cubes,
            scope,
            progress,
            notes,
            units,
            noise,
            seeing,
            source,
            colours,
            monitor,
        } = self;
        let threads = options.threads;
        let scope = scope.as_ref();
        let build_bytes = limits.build_bytes;
        let reading = Reading { build_bytes, threads, scope, progress: &progress, notes, seeing, source };
        let (mut read, of_files, values) = read_points(set, plan, store, reading, monitor)?;
        let colours = colours.or(values.map(|values| options.colour_plan(values.scale())));
        if let Some(colours) = colours {
            writer.set_colours(colours);
        }
        // A part that leaves files out cannot conclude that nothing in the whole is usable.
        let whole = scope.is_none_or(ShardScope::reads_all);
        if whole {
            refuse_unusable(set, &read.counts)?;
        }
        set.check_complete(monitor)?;
        let PointCounts { not_finite: points_not_finite, missing, .. } = read.own.left_out;
        let points_missing = set.points_missing().saturating_add(missing);
        let colouring = colours.map(|ColourPlan { scale, .. }| Colouring {
            scale,
            with_points: seeing.is_some_and(|seeing| seeing.removes),
        });
        let of_splats = colouring.filter(|_| splats.has_paint());
        let reading = MeshReading { build_bytes, scope, colouring: colouring.filter(|_| meshes.has_paint()) };
        let mesh_read = read_meshes(meshes, options, plan, store, reading, monitor)?;
        read.merge(&mesh_read.read);
        let reading = MeshReading { build_bytes, scope, colouring: of_splats };
        let splat_read = read_splats(splats, options, plan, store, reading, monitor)?;
        read.merge(&splat_read.read);
        let of_runs = [build_bytes, limits.retain_bytes];
        let cube_read = read_cubes(cubes, options, plan, store, of_runs, monitor)?;
        read.merge(&cube_read.read);
        if let Some(scope) = scope {
            let scans = set.files().iter().enumerate().map(|(number, file)| (file.path(), set.hash(number)));
            let meshes = set.meshes().iter().map(PathBuf::as_path).zip(mesh_read.hashes);
            let splats = splats.paths().zip(splat_read.hashes);
            writer.set_read(scope.inputs_read(scans.chain(meshes).chain(splats)));
        }
        let complete = set.is_complete() && meshes.is_complete() && mesh_read.complete && splat_read.complete;
        if whole {
            let of_splats = splat_read.scenes.into_iter().chain(cube_read.scenes);
            let scenes: Vec<Scene> = points::scenes(set, &of_files).chain(mesh_read.scenes).chain(of_splats).collect();
            far_apart(&scenes).inspect(|warning| monitor.warn(warning));
        }
        if whole && read.counts.read == 0 {
            if !complete {
                return Err(Error::parameter("INPUT", "nothing of it can be read; fetch or write it again"));
            }
            monitor.warn(&"the input holds no points: the archive is empty".into());
        }
        let columns = scope.map(|scope| (scope.shard.first, scope.shard.last));
        if let Some(removed) = &mut removed {
            removed.set_bounds(read.min, read.max);
        }
        seeing.inspect(|seeing| seeing.views.finish());
        let views = seeing.filter(|seeing| seeing.removes).map(|seeing| &seeing.views);
        let temp_dir = &options.temp_dir;
        let writing = Writing {
            memory_bytes: options.memory_bytes,
            threads,
            columns,
            views,
            temp_dir,
            weighted: !splats.is_empty(),
        };
        let left_out = write_archive(plan, store, writing, &mut writer, removed, monitor)?;
        let seen = match seeing.filter(|_| options.free_space) {
            Some(seeing) => Some(write_seen(&seeing.views, columns, threads, &mut writer, monitor)?),
            None => None,
        };
        let (voxels_dropped, points_moving) = (left_out.voxels, left_out.moving);
        read.own.kept -= points_moving;
        read.own.left_out.read += points_moving;
        let crs = set.crs().unwrap_or_default().to_owned();
        let header = writer.finish(Totals { noise, ..read.own.totals(&crs, &units) })?;
        if whole && header.points_read > 0 && header.voxels.occupied == 0 {
            monitor.warn(&nothing_kept(&header, voxels_dropped, points_moving).into());
        }
        Ok(Report {
            header,
            shard: scope.map(|scope| scope.shard),
            crs,
            units,
            noise,
            spacing: None,
            up: None,
            placement: None,
            texts: texts(set),
            input_bytes: [set.bytes(), meshes.bytes(), splats.bytes(), cubes.bytes()]
                .into_iter()
                .fold(0, u64::saturating_add),
            temp_bytes: 0,
            resumed: None,
            points_not_finite,
            points_missing,
            points_moving,
            seen,
            complete,
            triangles: mesh_read.triangles,
            splats: splat_read.counts,
            cubes: cube_read.count,
            points_made: mesh_read.points_made,
            voxels_dropped,
        })
    }
}

/// Returns the scans in text, and how their columns were understood.
fn texts(set: &InputSet) -> Vec<(PathBuf, TextLayout)> {
    let of_file = |file: &ScanFile| Some((file.path().to_path_buf(), file.text_layout()?.clone()));
    set.files().iter().filter_map(of_file).collect()
}

/// Rounds `value` to `digits` significant decimal digits.
fn round_to_digits(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// Returns the pixel size for meshes and splats alone: their longer side has [`AUTO_PIXELS`] pixels.
fn pixel_of_extent(
    options: &ConvertOptions,
    meshes: &MeshSet,
    splats: &SplatSet,
    monitor: &dyn Monitor,
) -> Result<f64> {
    monitor.stage("extent", 0, "triangles and splats");
    let both = meshes.bounds(monitor)?.into_iter().chain(splats.survey(options, monitor)?.1);
    let along = |axis: usize| {
        let ends = both.clone().map(|(min, max)| (min[axis], max[axis]));
        ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).map_or(0.0, |(min, max)| max - min)
    };
    let longer = along(0).max(along(1));
    if longer > 0.0 {
        Ok(round_to_digits(longer / AUTO_PIXELS, 2))
    } else {
        Err(Error::parameter(
            Parameter::AutomaticPixelSize,
            "meshes and splats have no extent in x and y; give the pixel size in metres",
        ))
    }
}

/// Estimates from the headers how many points one run reads and how much temporary data it writes beyond `retain_bytes`
/// (bytes). Headers may lie, so more than one point per byte is not believed.
fn temp_bytes(options: &ConvertOptions, set: &InputSet, retain_bytes: u64) -> (u64, u64) {
    let parts = options.shard.map_or(1, |shard| u64::from(shard.count.max(1)));
    // A part need not have opened all inputs.
    let points = match &options.plan_file {
        Some(file) if options.shard.is_some() => {
            file.inputs.iter().map(|input| input.points.min(input.bytes)).fold(0, u64::saturating_add)
        }
        _ => set.points_stated().min(set.bytes()),
    } / parts;
    let values = match options.colour {
        ColourMode::Off => 0,
        ColourMode::Of(ColourSource::Intensity | ColourSource::Class) => VALUE_BYTES_PER_POINT,
        _ => 2 * VALUE_BYTES_PER_POINT,
    };
    // If moving points are removed, each value follows the record of its point.
    let values = values + if options.plan.remove_moving && values > 0 { VALUE_BYTES_PER_POINT } else { 0 };
    (points, points.saturating_mul(TEMP_BYTES_PER_POINT + values).saturating_sub(retain_bytes))
}

/// Fails if the free disk space is too small for the temporary data.
fn check_free_space(options: &ConvertOptions, files: &Files, needed: u64) -> Result<()> {
    let dir = &options.temp_dir;
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
