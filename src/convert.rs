//! Conversion: scans and meshes in, one archive out.
//!
//! Two passes over bounded memory. First every worker reads pieces of the input and sorts their points, and what
//! triangles fill of voxels, into runs by tile column. Then tile columns come out of the merged runs in archive order; workers fold them to voxels, judge
//! floors and obstacles, form spans, and encode pages, and one thread writes these in order.
//!
//! Memory, for a budget of `M`: runs kept `M/2`, then runs being built and afterwards columns being worked on `M/4`,
//! input pieces and encoded pages `M/8` each. Nothing is sized by what a header states.

use crate::archive::{ArchiveWriter, EncodedPage, Header, PageEncoder, Shard, Totals};
use crate::frame::{Frame, PageKey};
use crate::input::spacing::{Spacing, estimate_spacing};
use crate::input::{Decoder, InputOptions, InputSet, ScanFile, UnitCounts, Units};
use crate::mesh::{MeshCounts, MeshMode, MeshOptions, MeshSet};
use crate::plan::{Classifier, Plan, Up};
use crate::shard::{Part, ShardOptions};
use crate::slice::columns::ColumnPages;
use crate::slice::obstacle::Judge;
use crate::voxel::fold::{Area, Folded, Moments, Patch, PieceFolder, Sums, Voxel};
use crate::voxel::record::{ColumnKey, PATCH_AREA, Record, Recorder};
use crate::voxel::runs::{Job, Merge, RunBuilder, RunStore};
use crate::voxel::surfaces::SurfaceBuilder;
use crate::{Error, Monitor, NoMonitor, Result};
use crossbeam_channel::{Receiver, Sender, bounded};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

/// Least memory budget (bytes).
pub const MIN_MEMORY_BYTES: u64 = 64 << 20;
/// Pixel size chosen automatically, in units of the scan's point spacing.
pub const AUTO_PIXEL_SPACINGS: f64 = 4.0;
/// Pixels along the longer side of meshes whose pixel size is chosen automatically (thesis, equation 3.3 with the sides
/// of the images in place of the printed ones, at the larger of its two resolutions).
pub const AUTO_PIXELS: f64 = 700.0;
/// Memory of a worker per record of a column: the record as read and twice more while it is sorted, and the voxel (with its
/// verdicts and the place of its sums) and span that it may become.
const JOB_BYTES_PER_RECORD: u64 = 3 * size_of::<Record>() as u64 + size_of::<Voxel>() as u64 + 8 + 16;
/// Disk per point in the temporary file: its record, copies in the halo, and the index.
const TEMP_BYTES_PER_POINT: u64 = 9;
/// Memory of one voxel in a column that is folded piece by piece: before and after a piece, and in the patch.
const DENSE_BYTES_PER_VOXEL: u64 = 3 * size_of::<(usize, Voxel, Moments)>() as u64;
/// Memory of a small page that waits to be written, beyond its bytes.
const PAGE_BYTES: u64 = 256;
/// Jobs that may be finished before the oldest unfinished one.
const JOBS_AHEAD_PER_THREAD: usize = 8;

/// How the pixel size is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PixelSize {
    /// From the scans' own point spacing, or the extent of the meshes where there is no scan (costs one more pass over
    /// the input).
    Auto,
    /// This many metres.
    Metres(f64),
}

/// What to convert, and how. See the README for the command line that sets these.
#[derive(Debug, Clone)]
pub struct ConvertOptions {
    /// Files, folders and glob patterns.
    pub inputs: Vec<PathBuf>,
    /// The archive to write.
    pub output: PathBuf,
    /// Pixel size `t`.
    pub pixel: PixelSize,
    /// Slice height `σ` (m); three pixel sizes by default (thesis, section 3.1.3).
    pub slice_m: Option<f64>,
    /// Steepest slope that can be stood on (degrees).
    pub max_slope_deg: f64,
    /// How far heights may be coarsened, outwards (m).
    pub tolerance_m: f64,
    /// How floors and obstacles are told apart.
    pub classifier: Classifier,
    /// Memory budget [bytes, at least 64 MiB].
    pub memory_bytes: u64,
    /// Worker threads [>= 1].
    pub threads: usize,
    /// Folder for temporary data.
    pub temp_dir: PathBuf,
    /// LAS classes left out, as in [`Plan::exclude_classes`].
    pub exclude_classes: [u64; 4],
    /// Voxels with fewer points are dropped.
    pub min_points: u32,
    /// Whether voxels without matter in any of the 26 voxels around them are dropped.
    pub drop_isolated: bool,
    /// Up axis of the input.
    pub up: Up,
    /// Unit of the input.
    pub units: Units,
    /// How meshes become voxels.
    pub mesh: MeshMode,
    /// Whether an existing archive may be replaced.
    pub overwrite: bool,
    /// The part to convert; `None` for the whole.
    pub shard: Option<ShardOptions>,
}

impl ConvertOptions {
    /// Defaults of the command line for these inputs and this output.
    pub fn new(inputs: Vec<PathBuf>, output: PathBuf) -> Self {
        Self {
            inputs,
            output,
            pixel: PixelSize::Auto,
            slice_m: None,
            max_slope_deg: 45.0,
            tolerance_m: 0.0,
            classifier: Classifier::Plane,
            memory_bytes: 512 << 20,
            threads: std::thread::available_parallelism().map_or(1, |n| n.get()),
            temp_dir: std::env::temp_dir(),
            exclude_classes: [0; 4],
            min_points: 1,
            drop_isolated: false,
            up: Up::Z,
            units: Units::Auto,
            mesh: MeshMode::Exact,
            overwrite: false,
            shard: None,
        }
    }
}

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
    /// Bytes of temporary data written to disk.
    pub temp_bytes: u64,
    /// Points left out because a coordinate was not finite.
    pub points_not_finite: u64,
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

/// Opens the inputs of a conversion.
pub(crate) fn open_inputs(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Inputs> {
    if options.memory_bytes < MIN_MEMORY_BYTES {
        let reason = format!("{} bytes are too few; give at least {MIN_MEMORY_BYTES} (64MiB)", options.memory_bytes);
        return Err(Error::parameter("--memory", reason));
    }
    let input_options = InputOptions {
        units: options.units,
        up: options.up,
        exclude_classes: options.exclude_classes,
        memory_bytes: options.memory_bytes / 8 / options.threads.max(1) as u64,
    };
    let scans = InputSet::open(&options.inputs, input_options, monitor)?;
    let mesh_options = MeshOptions {
        units: options.units,
        up: options.up,
        memory_bytes: options.memory_bytes / 8,
        temp_dir: options.temp_dir.clone(),
    };
    let meshes = MeshSet::open(scans.meshes(), mesh_options, monitor)?;
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
            // The same losses come up again in the pass that counts; they are told then.
            set.warn_of_losses(&NoMonitor);
            (round_to_digits(AUTO_PIXEL_SPACINGS * spacing.spacing_m, 2), Some(spacing))
        }
    };
    let plan = Plan {
        frame: Frame::new(pixel_m, options.slice_m.unwrap_or(round_to_digits(3.0 * pixel_m, 12)))?,
        max_slope_deg: options.max_slope_deg,
        tolerance_m: options.tolerance_m,
        classifier: options.classifier,
        min_points: options.min_points,
        drop_isolated: options.drop_isolated,
        up: options.up,
        exclude_classes: options.exclude_classes,
    };
    plan.check()?;
    Ok((plan, spacing))
}

/// Converts `options.inputs` into the archive `options.output`, which appears complete or not at all.
///
/// Cost: time linear in the points, memory at most the budget plus a constant, disk at most 12 bytes per point where
/// the points do not fit the budget. Errors: unusable input or options, full disk, interruption by `monitor`.
pub fn convert(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Report> {
    let threads = options.threads.max(1);
    let inputs = open_inputs(options, monitor)?;
    let (plan, spacing) = plan(options, &inputs, monitor)?;
    let Inputs { scans: set, meshes } = inputs;
    let part = options.shard.as_ref().map(|shard| Part::new(shard, &set, &plan, options)).transpose()?;
    // Made first, so that an archive that must not be replaced is found before the work and not after it.
    let mut writer = ArchiveWriter::create(&options.output, &plan, options.overwrite)?;
    if let Some(part) = &part {
        writer.set_shard(part.shard);
    }

    let store = RunStore::new(options.memory_bytes / 2, &options.temp_dir);
    check_free_space(options, &set)?;
    let mut read = read_points(&set, &plan, &store, build_bytes(options), threads, part.as_ref(), monitor)?;
    set.warn_of_losses(monitor);
    // A part that leaves files out cannot say of the whole that nothing in it can be used.
    let whole = part.as_ref().is_none_or(Part::reads_all);
    if whole {
        refuse_unusable(&set, &read.counts)?;
    }
    let points_not_finite = read.own.left_out.not_finite;
    let mesh_read = read_meshes(&meshes, options, &plan, &store, part.as_ref(), monitor)?;
    read.merge(&mesh_read.read);
    if whole && read.counts.read == 0 {
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
    })?;
    Ok(Report {
        header,
        shard: part.map(|part| part.shard),
        crs: set.crs().unwrap_or_default().to_owned(),
        spacing,
        temp_bytes: store.temp_bytes(),
        points_not_finite,
        triangles: mesh_read.triangles,
        points_made: mesh_read.points_made,
        voxels_dropped,
    })
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
        Err(Error::parameter("--pixel auto", "the meshes have no extent in x and y; give the pixel size in metres"))
    }
}

/// Refuses to begin what the disk will not hold. Headers may lie, so a count beyond one point per byte is not believed.
fn check_free_space(options: &ConvertOptions, set: &InputSet) -> Result<()> {
    let parts = options.shard.as_ref().map_or(1, |shard| u64::from(shard.count.max(1)));
    let points = set.points_stated().min(set.bytes()) / parts;
    let needed = (points * TEMP_BYTES_PER_POINT).saturating_sub(options.memory_bytes / 2);
    let dir = &options.temp_dir;
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
fn refuse_unusable(set: &InputSet, counts: &UnitCounts) -> Result<()> {
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

/// What the first pass finds out; all of it independent of the order of points.
#[derive(Debug, Clone, Copy)]
struct Read {
    /// All points read.
    counts: UnitCounts,
    /// Bounds of all kept points.
    min: [f64; 3],
    max: [f64; 3],
    own: Own,
}

/// The points that count in the archive: all, or in a part each point in one part.
#[derive(Debug, Clone, Copy)]
struct Own {
    kept: u64,
    min: [f64; 3],
    max: [f64; 3],
    /// Points that make no voxel.
    left_out: UnitCounts,
}

impl Read {
    const NOTHING: Self = {
        let none = UnitCounts { read: 0, withheld: 0, excluded: 0, not_finite: 0, missing: 0 };
        let (min, max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        Self { counts: none, min, max, own: Own { kept: 0, min, max, left_out: none } }
    };

    fn merge(&mut self, other: &Self) {
        self.counts += other.counts;
        self.own.kept += other.own.kept;
        self.own.left_out += other.own.left_out;
        join(&mut self.min, &mut self.max, (&other.min, &other.max));
        join(&mut self.own.min, &mut self.own.max, (&other.own.min, &other.own.max));
    }
}

/// Makes bounds reach around others.
fn join(min: &mut [f64; 3], max: &mut [f64; 3], other: (&[f64; 3], &[f64; 3])) {
    for axis in 0..3 {
        min[axis] = min[axis].min(other.0[axis]);
        max[axis] = max[axis].max(other.1[axis]);
    }
}

/// First pass: all points, or those that a part needs, into runs.
fn read_points(
    set: &InputSet,
    plan: &Plan,
    store: &RunStore,
    build_bytes: u64,
    threads: usize,
    part: Option<&Part>,
    monitor: &dyn Monitor,
) -> Result<Read> {
    monitor.stage("reading points", set.points_stated(), "points");
    let recorder = Recorder::new(plan.frame);
    let units = Mutex::new(set.units().filter(|unit| part.is_none_or(|part| part.reads(unit.file()))));
    let next_unit = || units.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
    // What one worker cannot do ends the work of all, not only its own.
    let failed = AtomicBool::new(false);
    let of_files = Mutex::new(vec![Read::NOTHING; set.files().len()]);
    let work = || -> Result<Read> {
        let mut decoder = Decoder::new();
        let mut builder = RunBuilder::new(recorder, build_bytes);
        if let Some(part) = part {
            builder = builder.only(part.shard.first, part.shard.last);
        }
        let mut read = Read::NOTHING;
        while let Some(unit) = next_unit() {
            let mut of_unit = Read::NOTHING;
            of_unit.counts = decoder.decode(set, &unit, &mut |batch| {
                // A unit may be a whole file, so one look per unit would be too few.
                if monitor.cancelled() || failed.load(Ordering::Relaxed) {
                    return Err(Error::Interrupted);
                }
                monitor.advance(batch.len() as u64);
                let (mut min, mut max) = (Read::NOTHING.min, Read::NOTHING.max);
                for (axis, values) in [&batch.x, &batch.y, &batch.z].into_iter().enumerate() {
                    (min[axis], max[axis]) = range(values);
                }
                if batch.x.is_empty() {
                    return Ok(());
                }
                if !recorder.reaches(min, max) {
                    return Err(out_of_reach(&plan.frame, min, max));
                }
                let (kept, own_min, own_max) = match part {
                    Some(part) => {
                        part.check_bounds(&set.files()[unit.file()], unit.file(), min, max)?;
                        part.own(batch)
                    }
                    None => (batch.len() as u64, min, max),
                };
                let own = Own { kept, min: own_min, max: own_max, ..Read::NOTHING.own };
                of_unit.merge(&Read { min, max, own, ..Read::NOTHING });
                builder.push(&batch.x, &batch.y, &batch.z, store)
            })?;
            if part.is_none_or(|part| part.owns(unit.file())) {
                of_unit.own.left_out = of_unit.counts;
                of_unit.own.left_out.read -= of_unit.counts.kept();
            }
            monitor.advance(of_unit.counts.read - of_unit.counts.kept());
            read.merge(&of_unit);
            of_files.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[unit.file()].merge(&of_unit);
        }
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        builder.flush(store)?;
        Ok(read)
    };
    let mut all = Read::NOTHING;
    for read in on_threads(threads, || work().inspect_err(|_| failed.store(true, Ordering::Relaxed)))? {
        all.merge(&read);
    }
    warn_of_bounds(set, &of_files.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner), monitor);
    Ok(all)
}

/// What `work` gives on each of so many threads, or the error that says most.
fn on_threads<T: Send>(threads: usize, work: impl Fn() -> Result<T> + Sync) -> Result<Vec<T>> {
    let results: Vec<Result<T>> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(&work)).collect();
        workers
            .into_iter()
            .map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    let (mut done, mut stopped) = (Vec::with_capacity(threads), false);
    for result in results {
        match result {
            Ok(result) => done.push(result),
            // Stopped by another's error, which says more.
            Err(Error::Interrupted) => stopped = true,
            Err(error) => return Err(error),
        }
    }
    if stopped { Err(Error::Interrupted) } else { Ok(done) }
}

/// What the first pass finds in meshes.
struct MeshRead {
    /// Triangles as if they were points, with the bounds of their corners.
    read: Read,
    triangles: MeshCounts,
    points_made: u64,
}

/// First pass: all triangles into runs. One worker at a time reads; all of them take triangles to the grid.
fn read_meshes(
    set: &MeshSet,
    options: &ConvertOptions,
    plan: &Plan,
    store: &RunStore,
    part: Option<&Part>,
    monitor: &dyn Monitor,
) -> Result<MeshRead> {
    if set.is_empty() {
        return Ok(MeshRead { read: Read::NOTHING, triangles: MeshCounts::default(), points_made: 0 });
    }
    monitor.stage("reading meshes", 0, "triangles");
    let feed = Mutex::new(set.feed());
    let failed = AtomicBool::new(false);
    let cancelled = || monitor.cancelled() || failed.load(Ordering::Relaxed);
    let work = || -> Result<(Read, u64)> {
        let mut runs = RunBuilder::new(Recorder::new(plan.frame), build_bytes(options));
        if let Some(part) = part {
            runs = runs.only(part.shard.first, part.shard.last);
        }
        let mut surfaces = SurfaceBuilder::new(plan, options.mesh);
        let (mut read, mut batch) = (Read::NOTHING, Vec::new());
        while feed.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next(&mut batch, monitor)? {
            for triangle in &batch {
                if cancelled() {
                    return Err(Error::Interrupted);
                }
                let fold = |start, pick: fn(f64, f64) -> f64| {
                    [0, 1, 2].map(|axis| triangle.iter().fold(start, |extreme, corner| pick(extreme, corner[axis])))
                };
                let (min, max) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
                if !surfaces.reaches(min, max) {
                    return Err(out_of_reach(&plan.frame, min, max));
                }
                read.merge(&Read { min, max, own: Own { min, max, ..Read::NOTHING.own }, ..Read::NOTHING });
                surfaces.push(triangle, &mut runs, store, &cancelled)?;
            }
            monitor.advance(batch.len() as u64);
        }
        surfaces.flush(&mut runs, store)?;
        runs.flush(store)?;
        Ok((read, surfaces.points_made()))
    };
    let done = on_threads(options.threads.max(1), || work().inspect_err(|_| failed.store(true, Ordering::Relaxed)))?;
    let triangles = feed.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).counts();
    let mut all = MeshRead { read: Read::NOTHING, triangles, points_made: 0 };
    all.read.counts.read = triangles.read;
    all.read.counts.not_finite = triangles.left_out;
    if part.is_none_or(Part::owns_meshes) {
        all.read.own.kept = triangles.read - triangles.left_out;
        all.read.own.left_out =
            UnitCounts { read: triangles.left_out, not_finite: triangles.left_out, ..Read::NOTHING.counts };
    }
    for (read, points_made) in done {
        all.read.merge(&read);
        all.points_made += points_made;
    }
    Ok(all)
}

/// One warning if headers state other bounds than the points have: the archive's are those of the points, and a user
/// who compares the two should know which is wrong.
fn warn_of_bounds(set: &InputSet, of_files: &[Read], monitor: &dyn Monitor) {
    let disagrees = |(file, read): &(&ScanFile, &Read)| {
        let kept = read.counts.kept();
        // Points left out may be those at the corners; then the stated box may well be larger.
        let all = kept == read.counts.read && read.counts.missing == 0;
        kept > 0 && file.bounds_disagree(read.min, read.max, all)
    };
    let mut found = set.files().iter().zip(of_files).filter(disagrees);
    if let Some((file, read)) = found.next() {
        let others = match found.count() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        monitor.warn(&format!(
            "{}{others}: the header states other bounds than the points have; theirs are used: {:?} to {:?}",
            file.path().display(),
            read.min,
            read.max
        ));
    }
}

/// Least and greatest value, in lanes that compile to vector instructions.
fn range(values: &[f64]) -> (f64, f64) {
    let (mut min, mut max) = ([f64::INFINITY; 8], [f64::NEG_INFINITY; 8]);
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for lane in 0..8 {
            min[lane] = if chunk[lane] < min[lane] { chunk[lane] } else { min[lane] };
            max[lane] = if chunk[lane] > max[lane] { chunk[lane] } else { max[lane] };
        }
    }
    let min = min.iter().chain(rest).fold(f64::INFINITY, |a, &b| a.min(b));
    let max = max.iter().chain(rest).fold(f64::NEG_INFINITY, |a, &b| a.max(b));
    (min, max)
}

fn out_of_reach(frame: &Frame, min: [f64; 3], max: [f64; 3]) -> Error {
    Error::Limit {
        what: "coordinates that a grid of this pixel size reaches (m) (give a larger --pixel, or the unit by --units)"
            .into(),
        value: format!("{min:?} to {max:?}"),
        max: format!("±{}", frame.pixel_m().min(frame.slice_m()) * crate::frame::MAX_INDEX as f64),
    }
}

/// Pages of one job, in archive order, and the voxels dropped in it.
struct Done {
    number: u64,
    records: u64,
    pages: Vec<(PageKey, EncodedPage)>,
    voxels_dropped: u64,
}

/// Second pass: tile columns out of the runs, into the archive. Returns the number of voxels dropped.
fn write_columns(
    plan: &Plan,
    store: &RunStore,
    memory_bytes: u64,
    threads: usize,
    writer: &mut ArchiveWriter,
    monitor: &dyn Monitor,
) -> Result<u64> {
    let merge = Merge::new(store);
    monitor.stage("writing slices", merge.records(), "records");
    let ahead = JOBS_AHEAD_PER_THREAD * threads;
    let max_records = memory_bytes / 4 / threads as u64 / JOB_BYTES_PER_RECORD;
    let max_columns = (memory_bytes / 8 / ahead as u64 / PAGE_BYTES).max(1);
    let dense = Dense { one_at_a_time: Mutex::new(()), max_voxels: memory_bytes / 4 / DENSE_BYTES_PER_VOXEL };
    let (job_in, job_out) = bounded::<(u64, Job)>(threads);
    let (done_in, done_out) = bounded::<Result<Done>>(ahead);
    // A job is given out against a token, and a token comes back when its pages are written: so no more than
    // `ahead` jobs' pages ever wait for an earlier job.
    let (token_in, token_out) = bounded::<()>(ahead);
    for _ in 0..ahead {
        let _ = token_in.send(());
    }
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (jobs, done) = (job_out.clone(), done_in.clone());
            let (merge, dense) = (&merge, &dense);
            let worker = ColumnWorker::new(plan, max_records, dense, monitor);
            scope.spawn(move || work_on_columns(worker, merge, &jobs, &done));
        }
        drop(job_out);
        let merge = &merge;
        scope.spawn(move || {
            let mut number = 0;
            let given = merge.jobs(max_records, max_columns, |job| {
                // A closed channel means that the writer gave up; it knows why.
                if token_out.recv().is_err() || job_in.send((number, job)).is_err() {
                    return Err(Error::Interrupted);
                }
                number += 1;
                Ok(())
            });
            if let Err(error) = given {
                let _ = done_in.send(Err(error));
            }
        });
        let written = write_in_order(writer, &done_out, &token_in, monitor);
        // Both ends must go before the scope waits for the threads that may be blocked on them.
        drop((done_out, token_in));
        written
    })
}

fn write_in_order(
    writer: &mut ArchiveWriter,
    done: &Receiver<Result<Done>>,
    tokens: &Sender<()>,
    monitor: &dyn Monitor,
) -> Result<u64> {
    let mut waiting = BTreeMap::new();
    let (mut next, mut voxels_dropped) = (0, 0);
    for result in done {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let result = result?;
        waiting.insert(result.number, result);
        while let Some(result) = waiting.remove(&next) {
            next += 1;
            voxels_dropped += result.voxels_dropped;
            for (key, page) in result.pages {
                writer.put(key, page)?;
            }
            monitor.advance(result.records);
            let _ = tokens.send(());
        }
    }
    Ok(voxels_dropped)
}

fn work_on_columns(
    mut worker: ColumnWorker<'_>,
    merge: &Merge<'_>,
    jobs: &Receiver<(u64, Job)>,
    done: &Sender<Result<Done>>,
) {
    let _alarm = Alarm(done);
    for (number, job) in jobs {
        let result = worker.work(merge, &job).map(|(pages, voxels_dropped)| Done {
            number,
            records: job.records,
            pages,
            voxels_dropped,
        });
        let failed = result.is_err();
        if done.send(result).is_err() || failed {
            return;
        }
    }
}

/// Wakes the writing thread if a worker panics; it would else wait for ever for that worker's job.
struct Alarm<'a>(&'a Sender<Result<Done>>);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _ = self.0.send(Err(Error::Interrupted));
        }
    }
}

type Pages = Vec<(PageKey, EncodedPage)>;

/// What the workers share for columns that do not fit.
struct Dense {
    /// Held by the one worker that may use as much memory as all workers together.
    one_at_a_time: Mutex<()>,
    /// Voxels that it may then hold.
    max_voxels: u64,
}

/// Scratch of one worker of the second pass.
struct ColumnWorker<'a> {
    dense: &'a Dense,
    monitor: &'a dyn Monitor,
    judge: Judge,
    min_points: u32,
    drop_isolated: bool,
    max_records: u64,
    patch: Patch,
    sums: Sums,
    folder: PieceFolder,
    verdicts: Vec<bool>,
    columns: ColumnPages,
    tolerance: u32,
    encoder: PageEncoder,
    records: Vec<Record>,
}

impl<'a> ColumnWorker<'a> {
    fn new(plan: &Plan, max_records: u64, dense: &'a Dense, monitor: &'a dyn Monitor) -> Self {
        Self {
            dense,
            monitor,
            judge: Judge::new(plan),
            min_points: plan.min_points,
            drop_isolated: plan.drop_isolated,
            max_records,
            patch: Patch::default(),
            sums: Sums::default(),
            folder: PieceFolder::default(),
            verdicts: Vec::new(),
            columns: ColumnPages::default(),
            tolerance: plan.tolerance_quanta(),
            encoder: PageEncoder::new(plan.frame),
            records: Vec::new(),
        }
    }

    fn work(&mut self, merge: &Merge<'_>, job: &Job) -> Result<(Pages, u64)> {
        let mut pages = Pages::new();
        let mut dropped = 0;
        if job.records > self.max_records {
            dropped += self.dense_column(merge, job)?;
            self.encode(job.columns[0].0, &mut pages)?;
            return Ok((pages, dropped));
        }
        let mut records = std::mem::take(&mut self.records);
        merge.load(job, &mut records)?;
        let mut rest = &records[..];
        for &(key, count) in &job.columns {
            let (own, others) = rest.split_at(count as usize);
            rest = others;
            dropped +=
                self.patch.fold(own, self.min_points, Area::TILE, &mut self.sums) + self.judge_and_add(Area::TILE);
            self.encode(key, &mut pages)?;
        }
        self.records = records;
        Ok((pages, dropped))
    }

    /// Works on a column of more records than memory holds. Where they make few voxels, one pass folds them piece by
    /// piece; else the column is cut into areas of few enough records, with one pass for each.
    ///
    /// Cost: one to three passes over the column's records, then for each area its rows.
    fn dense_column(&mut self, merge: &Merge<'_>, job: &Job) -> Result<u64> {
        if let Some(dropped) = self.fold_piecemeal(merge, job, Area::TILE, self.max_records / 4)? {
            return Ok(dropped);
        }
        let mut counts = vec![0u64; PATCH_AREA];
        self.stream(merge, job, Area::TILE, |records| {
            records.iter().for_each(|record| counts[record.pixel()] += 1);
            true
        })?;
        let mut dropped = 0;
        let mut open = vec![Area::TILE];
        while let Some(area) = open.pop() {
            let with_halo: u64 = (0..PATCH_AREA).filter(|&pixel| area.holds_with_halo(pixel)).map(|p| counts[p]).sum();
            if with_halo <= self.max_records {
                let mut own = std::mem::take(&mut self.records);
                own.clear();
                own.reserve_exact(with_halo as usize);
                self.stream(merge, job, area, |records| {
                    own.extend(records.iter().filter(|record| area.holds_with_halo(record.pixel())));
                    true
                })?;
                dropped += self.patch.fold(&own, self.min_points, area, &mut self.sums) + self.judge_and_add(area);
                self.records = own;
            } else if let Some([low, high]) = area.halves() {
                // The last is taken first, and spans are to come in order of pixels where they can.
                open.extend([high, low]);
            } else {
                let dense = self.dense;
                let _alone = dense.one_at_a_time.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                (self.patch, self.sums) = Default::default();
                let folded = self.fold_piecemeal(merge, job, area, dense.max_voxels)?;
                (self.patch, self.sums) = Default::default();
                dropped += folded.ok_or_else(|| Error::Limit {
                    what: "occupied slices of one pixel and its neighbours (give more --memory, or a larger --slice)"
                        .into(),
                    value: "more".into(),
                    max: dense.max_voxels.to_string(),
                })?;
            }
        }
        Ok(dropped)
    }

    /// Folds the records of `area` piece by piece; `None` if they make more than `max_voxels`.
    fn fold_piecemeal(&mut self, merge: &Merge<'_>, job: &Job, area: Area, max_voxels: u64) -> Result<Option<u64>> {
        let mut folder = std::mem::take(&mut self.folder);
        let mut folded = Folded::new();
        let mut own = Vec::new();
        let fits = self.stream(merge, job, area, |records| {
            own.clear();
            own.extend(records.iter().filter(|record| area.holds_with_halo(record.pixel())));
            folder.fold_into(&mut folded, &own);
            folded.len() as u64 <= max_voxels
        })?;
        self.folder = folder;
        if !fits {
            return Ok(None);
        }
        let dropped = self.patch.set_folded(&folded, self.min_points, area, &mut self.sums);
        drop(folded);
        Ok(Some(dropped + self.judge_and_add(area)))
    }

    /// The records of a column in `area` and its halo, and others, piece by piece, until `take` has enough; whether it
    /// saw all.
    fn stream(
        &self,
        merge: &Merge<'_>,
        job: &Job,
        area: Area,
        mut take: impl FnMut(&[Record]) -> bool,
    ) -> Result<bool> {
        let chunk = (self.max_records / 4).max(1 << 12) as usize;
        let mut all = true;
        merge.stream(job, (area.y.0, area.y.1 + 2), chunk, |records| {
            if self.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            all = take(records);
            Ok(all)
        })?;
        Ok(all)
    }

    /// Returns how many isolated voxels were dropped.
    fn judge_and_add(&mut self, area: Area) -> u64 {
        let dropped = if self.drop_isolated { self.patch.drop_isolated(area, &mut self.sums) } else { 0 };
        self.judge.judge(&self.patch, &mut self.sums, area, &mut self.verdicts);
        self.columns.add(&self.patch, area, &self.verdicts);
        dropped
    }

    fn encode(&mut self, column: ColumnKey, pages: &mut Pages) -> Result<()> {
        let Self { columns, encoder, tolerance, .. } = self;
        columns.finish(column.first_slice(), |layer, page| {
            let key = PageKey::from_column(column.column, layer);
            let simple = (*tolerance > 0).then(|| encoder.simplify(page, *tolerance));
            pages.push((key, encoder.encode(key, simple.as_ref().unwrap_or(page))));
            Ok(())
        })
    }
}
