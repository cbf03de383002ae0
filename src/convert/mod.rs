//! Conversion: scans and meshes in, one archive out.
//!
//! Two passes over bounded memory. First every worker reads pieces of the input and sorts their points, and what
//! triangles fill of voxels, into runs by tile column. Then tile columns come out of the merged runs in archive order;
//! workers fold them to voxels, judge floors and obstacles, form spans, and encode pages, and one thread writes these in
//! order.
//!
//! Memory, for a budget of `M`: runs kept `M/2`, then runs being built and afterwards columns being worked on `M/4`,
//! input pieces and encoded pages `M/8` each. Nothing is sized by what a header states.

mod facts;
mod job;
mod meshes;
mod options;
mod pages;
#[cfg(feature = "cli")]
pub mod plan_file;
mod points;
mod preview;
mod scope;
mod split;
mod work;

pub use facts::InputFacts;
pub use job::Job;
pub use options::{ConvertOptions, PixelSize, ShardOptions};
pub use preview::{Preview, PreviewInput, preview};

use crate::archive::{ArchiveWriter, Header, MAX_UNITS, Shard, Totals};
use crate::frame::{Frame, MAX_CELL_M};
use crate::input::scenes::{Scene, far_apart};
use crate::input::spacing::{Spacing, estimate_spacing};
use crate::input::{InputOptions, InputSet, PointCounts, ScanFile};
use crate::mesh::{MeshCounts, MeshOptions, MeshSet};
use crate::output::{Existing, Output, OutputKind};
use crate::plan::Plan;
use crate::text::{counted, grouped};
use crate::unit::LengthUnit;
use crate::voxel::runs::RunStore;
use crate::{Error, Monitor, NoMonitor, Parameter, Result};
use meshes::read_meshes;
use pages::write_columns;
use points::read_points;
use scope::ShardScope;
use std::path::{Path, PathBuf};

/// Least memory budget (bytes).
pub const MIN_MEMORY_BYTES: u64 = 64 << 20;
/// Pixel size chosen automatically, in units of the scan's point spacing.
pub const AUTO_PIXEL_SPACINGS: f64 = 4.0;
/// Pixels along the longer side of meshes whose pixel size is chosen automatically (thesis, equation 3.3 with the sides
/// of the images in place of the printed ones, at the larger of its two resolutions).
pub const AUTO_PIXELS: f64 = 700.0;
/// Disk per point in the temporary file: its record, copies in the halo, and the index.
const TEMP_BYTES_PER_POINT: u64 = 9;

/// What a conversion did.
#[derive(Debug, Clone)]
pub struct Report {
    /// Header of the archive.
    pub header: Header,
    /// Which part it holds, if not the whole.
    pub shard: Option<Shard>,
    /// Point spacing found, if the pixel size was chosen automatically.
    pub spacing: Option<Spacing>,
    /// Text of the coordinate reference system; empty if the input names none.
    pub crs: String,
    /// Units in which the inputs came, each once.
    pub units: Vec<LengthUnit>,
    /// Length of all input files (bytes).
    pub input_bytes: u64,
    /// Bytes of temporary data written to disk.
    pub temp_bytes: u64,
    /// Points left out because a coordinate was not finite.
    pub points_not_finite: u64,
    /// Whether all of the input was read: always so, unless incomplete input is allowed.
    pub complete: bool,
    /// Triangles of meshes; they count as points in the header too.
    pub triangles: MeshCounts,
    /// Points made of them, if they were sampled.
    pub points_made: u64,
    /// Voxels dropped for having fewer than the least number of points or for being isolated, and with them their
    /// points: boxes that hold only such points are no hits (G1 holds for all other points).
    pub voxels_dropped: u64,
}

/// The files of a conversion.
pub(crate) struct Inputs {
    pub scans: InputSet,
    pub meshes: MeshSet,
}

impl Inputs {
    fn paths(&self) -> impl Iterator<Item = &Path> {
        self.scans.files().iter().map(ScanFile::path).chain(self.scans.meshes().iter().map(PathBuf::as_path))
    }
}

/// Opens the inputs of a conversion.
pub(crate) fn open_inputs(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Inputs> {
    if options.memory_bytes < MIN_MEMORY_BYTES {
        let reason = format!("{} bytes are too few; give at least {MIN_MEMORY_BYTES} (64MiB)", options.memory_bytes);
        return Err(Error::parameter(Parameter::Memory, reason));
    }
    options.plan.check()?;
    let input_options = InputOptions {
        units: options.units,
        epsg: options.epsg,
        up: options.plan.up,
        exclude_classes: options.plan.exclude_classes,
        memory_bytes: options.memory_bytes / 8 / options.threads.max(1) as u64,
        allow_incomplete: options.allow_incomplete,
        // Parts of one job are compared by what they read.
        hash: options.shard.is_some(),
    };
    let mut scans = InputSet::open(&options.inputs, input_options, monitor)?;
    let mesh_options = MeshOptions {
        units: options.units,
        up: options.plan.up,
        memory_bytes: options.memory_bytes / 8,
        temp_dir: options.temp_dir.clone(),
        allow_incomplete: options.allow_incomplete,
        hash: options.shard.is_some(),
    };
    let meshes = MeshSet::open(scans.meshes(), mesh_options, monitor)?;
    scans.set_meshes(meshes.paths());
    Ok(Inputs { scans, meshes })
}

/// The plan of a conversion of `inputs`, and the point spacing if the pixel size follows from it.
pub(crate) fn plan(
    options: &ConvertOptions,
    Inputs { scans: set, meshes }: &Inputs,
    monitor: &dyn Monitor,
) -> Result<(Plan, Option<Spacing>)> {
    let (pixel_m, spacing) = match options.pixel {
        PixelSize::Metres(pixel_m) => (pixel_m, None),
        PixelSize::Auto if set.files().is_empty() => (pixel_of_extent(meshes, monitor)?, None),
        PixelSize::Auto => {
            let spacing = estimate_spacing(set, options.threads.max(1), monitor)?;
            // Where losses are allowed, they come up again in the pass that counts, and are told then.
            set.check_complete(&NoMonitor)?;
            (round_to_digits(AUTO_PIXEL_SPACINGS * spacing.spacing_m, 2), Some(spacing))
        }
    };
    if options.pixel == PixelSize::Auto && !(1e-6..=MAX_CELL_M).contains(&pixel_m) {
        let reason = format!("the input asks for pixels of {pixel_m} m; give the pixel size in metres");
        return Err(Error::parameter(Parameter::AutomaticPixelSize, reason));
    }
    let plan = Plan {
        frame: Frame::new(pixel_m, options.slice_m.unwrap_or(round_to_digits(3.0 * pixel_m, 12).min(MAX_CELL_M)))?,
        options: options.plan.clone(),
    };
    Ok((plan, spacing))
}

/// Converts `options.inputs` into the archive `options.output`, which appears complete or not at all.
///
/// Cost: time linear in the points, memory at most the budget plus a constant, disk at most 12 bytes per point where
/// the points do not fit the budget. Errors: unusable input or options, full disk, interruption by `monitor`.
pub fn convert(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Report> {
    let threads = options.threads.max(1);
    let inputs = open_inputs(options, monitor)?;
    // Begun first, so that a file that must not be replaced is found before the work and not after it.
    let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
    let output = Output::create(&options.output, kind, inputs.paths().collect())?;
    let (plan, spacing) = plan(options, &inputs, monitor)?;
    let Inputs { scans: set, meshes } = inputs;
    let units = LengthUnit::distinct(set.length_units().chain(meshes.length_unit()));
    if units.len() > MAX_UNITS {
        let what = "different units of inputs (set one for all with --units)".into();
        return Err(Error::Limit { what, value: units.len().to_string(), max: MAX_UNITS.to_string() });
    }
    let scope = scope(options, &set, &plan, monitor)?;
    let mut writer = ArchiveWriter::on(output, &plan)?;
    if let Some(scope) = &scope {
        writer.set_shard(scope.shard);
    }

    let store = RunStore::new(options.memory_bytes / 2, &options.temp_dir);
    check_free_space(options, &set)?;
    let (mut read, of_files) =
        read_points(&set, &plan, &store, build_bytes(options), threads, scope.as_ref(), monitor)?;
    // A part that leaves files out cannot say of the whole that nothing in it can be used.
    let whole = scope.as_ref().is_none_or(ShardScope::reads_all);
    if whole {
        refuse_unusable(&set, &read.counts)?;
    }
    set.check_complete(monitor)?;
    let points_not_finite = read.own.left_out.not_finite;
    let mesh_read = read_meshes(&meshes, options, &plan, &store, scope.as_ref(), monitor)?;
    read.merge(&mesh_read.read);
    if let Some(scope) = &scope {
        let scans = set.files().iter().enumerate().map(|(number, file)| (file.path(), set.hash(number)));
        let meshes = set.meshes().iter().map(PathBuf::as_path).zip(mesh_read.hashes);
        writer.set_read(scope.inputs_read(scans.chain(meshes)));
    }
    let complete = set.is_complete() && meshes.is_complete() && mesh_read.complete;
    if whole {
        let scenes: Vec<Scene> = points::scenes(&set, &of_files).chain(mesh_read.scenes).collect();
        far_apart(&scenes).inspect(|text| monitor.warn(text));
    }
    if whole && read.counts.read == 0 {
        if !complete {
            return Err(Error::parameter("INPUT", "nothing of it can be read; fetch or write it again"));
        }
        monitor.warn("the input holds no points: the archive is empty");
    }
    let voxels_dropped = write_columns(&plan, &store, options.memory_bytes, threads, &mut writer, monitor)?;
    let own = read.own;
    let header = writer.finish(Totals {
        points_read: own.kept + own.left_out.read,
        points_kept: own.kept,
        points_withheld: own.left_out.withheld,
        points_excluded: own.left_out.excluded,
        bounds: (own.min[0] <= own.max[0]).then_some((own.min, own.max)),
        crs: set.crs().unwrap_or_default().to_owned(),
        units: units.clone(),
    })?;
    if whole && header.points_read > 0 && header.voxels.occupied == 0 {
        monitor.warn(&nothing_kept(&header, voxels_dropped));
    }
    Ok(Report {
        header,
        shard: scope.map(|scope| scope.shard),
        crs: set.crs().unwrap_or_default().to_owned(),
        units,
        spacing,
        input_bytes: set.bytes().saturating_add(meshes.bytes()),
        temp_bytes: store.temp_bytes(),
        points_not_finite,
        complete,
        triangles: mesh_read.triangles,
        points_made: mesh_read.points_made,
        voxels_dropped,
    })
}

/// The part that the options ask for, if not the whole; refuses inputs that are not those of the options' job.
fn scope(options: &ConvertOptions, set: &InputSet, plan: &Plan, monitor: &dyn Monitor) -> Result<Option<ShardScope>> {
    if let Some(shard) = options.shard {
        return ShardScope::new(shard, set, plan, options, monitor).map(Some);
    }
    if let Some(job) = &options.job {
        job.check_same_inputs(&Job::of(InputFacts::of(set, monitor)?, plan.clone(), options))?;
    }
    Ok(None)
}

/// Why an archive of a scan with points is empty.
fn nothing_kept(header: &Header, voxels_dropped: u64) -> String {
    let Header { points_read, points_kept, points_excluded, points_withheld, .. } = *header;
    let why = match points_kept {
        0 => format!(
            "all {} are left out ({} by class, {} withheld, {} without a finite position)",
            counted(points_read, "point"),
            grouped(points_excluded),
            grouped(points_withheld),
            grouped(points_read - points_excluded - points_withheld)
        ),
        _ => format!("all {} have too few points or no neighbours", counted(voxels_dropped, "voxel")),
    };
    format!("nothing is kept: {why}; the archive is empty")
}

/// Memory of one worker's run under construction.
fn build_bytes(options: &ConvertOptions) -> u64 {
    options.memory_bytes / 4 / options.threads.max(1) as u64
}

/// `value` to so many significant decimal digits.
fn round_to_digits(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// Pixel size of meshes alone: their longer side in [`AUTO_PIXELS`] pixels.
fn pixel_of_extent(meshes: &MeshSet, monitor: &dyn Monitor) -> Result<f64> {
    monitor.stage("extent", 0, "triangles");
    let longer = meshes.bounds(monitor)?.map_or(0.0, |(min, max)| (max[0] - min[0]).max(max[1] - min[1]));
    if longer > 0.0 {
        Ok(round_to_digits(longer / AUTO_PIXELS, 2))
    } else {
        Err(Error::parameter(
            Parameter::AutomaticPixelSize,
            "the meshes have no extent in x and y; give the pixel size in metres",
        ))
    }
}

/// Points that one run reads, and the temporary data that it then writes (bytes), as far as headers tell. These may lie,
/// so a count beyond one point per byte is not believed.
fn temp_bytes(options: &ConvertOptions, set: &InputSet) -> (u64, u64) {
    let parts = options.shard.map_or(1, |shard| u64::from(shard.count.max(1)));
    let points = set.points_stated().min(set.bytes()) / parts;
    (points, points.saturating_mul(TEMP_BYTES_PER_POINT).saturating_sub(options.memory_bytes / 2))
}

/// Refuses to begin what the disk will not hold.
fn check_free_space(options: &ConvertOptions, set: &InputSet) -> Result<()> {
    let dir = &options.temp_dir;
    if !dir.is_dir() {
        return Err(Error::output(dir, "no such folder; temporary data needs one that exists"));
    }
    let (points, needed) = temp_bytes(options, set);
    let free = fs4::available_space(dir).map_err(|e| Error::io(dir, "ask for its free space", e))?;
    if needed > free {
        let what = format!(
            "temporary data for {points} points in {} (bytes) (choose a folder with --temp-dir or give more --memory)",
            dir.display()
        );
        return Err(Error::Limit { what, value: needed.to_string(), max: free.to_string() });
    }
    Ok(())
}

/// Refuses scans that state points of which none can be used: an empty archive in place of a good one helps nobody.
/// Scans that state none, or whose points are all left out on purpose, make an empty archive.
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
        let reason = "no point has a finite position within 1e12 m: scale or offset in the header (bytes 131 to 178) are \
                      damaged; fetch or write the file again";
        return Err(Error::input(first.path(), "points", reason));
    }
    Ok(())
}
