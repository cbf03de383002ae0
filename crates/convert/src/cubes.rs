//! First pass over solid cubes (OctoMap trees, voxel octrees): writes the voxels that they fill into runs.

use super::ConvertOptions;
use super::points::{Own, Read, out_of_reach};
use super::work::{FirstPass, SourceRead, StopFlag};
use crate::bytes::{is_file_at, open_named};
use crate::disk::Files;
use crate::input::scenes::Scene;
use crate::input::{Units, each_once, is_of_input};
use crate::plan::{Plan, Up};
use crate::text::grouped;
use crate::unit::LengthUnit;
use crate::voxel::cubes::{CubeBuilder, CubeGrid, PlacedCube};
use crate::{Error, Monitor, Parameter, Result};
use slicewalk_cube::{Cube, CubeFormat, CubeReader, HEAD_BYTES, binary_of, recognise};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Temporary data of one voxel (bytes).
const VOXEL_BYTES: f64 = 9.0;

/// Files of cubes among the inputs.
#[derive(Debug, Default)]
pub(crate) struct CubeSet {
    paths: Vec<PathBuf>,
    /// Files that belong to those in `paths`.
    beside: Vec<PathBuf>,
    bytes: u64,
    /// Least size of a cube (m).
    finest_m: Option<f64>,
    /// True if a file was left out.
    is_partial: bool,
    left_out: Option<Error>,
}

/// Returns the format of the cubes at `path`, by name and content; `None` for any other file, and for one that cannot
/// be read, which the readers of scans report.
fn format_of(path: &Path) -> Option<CubeFormat> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let may_be = ["bt", "ot", "json"].contains(&&ending[..]) && crate::bytes::address(path).is_none();
    if !may_be || !is_file_at(path) {
        return None;
    }
    let source = open_named(path).ok()?;
    let mut head = vec![0; source.len().min(HEAD_BYTES as u64) as usize];
    source.read_at(0, &mut head).ok()?;
    recognise(&head, path)
}

/// A file of cubes and their place.
struct Placed {
    reader: CubeReader,
    grid: CubeGrid,
    /// True if the file's axes are turned by the options.
    turned: bool,
}

impl Placed {
    fn open(path: &Path, options: &ConvertOptions) -> Result<Self> {
        let reader = CubeReader::open(path)?;
        // A voxel octree is y-up by its format, so its reader has turned it already.
        let turned = options.plan.up == Up::Y && binary_of(path).is_none();
        let factor = match options.reading.units {
            Units::Auto => 1.0,
            Units::Factor(factor) => factor,
        };
        let grid = CubeGrid { size_m: reader.size() * factor, origin_m: reader.origin().map(|v| v * factor) };
        Ok(Self { reader, grid, turned })
    }

    fn next_batch(&mut self, batch: &mut Vec<Cube>) -> Result<bool> {
        let more = self.reader.next_batch(batch)?;
        if self.turned {
            for cube in batch {
                let [x, y, z] = cube.corner;
                cube.corner = [x, -z - cube.edge, y];
            }
        }
        Ok(more)
    }
}

impl CubeSet {
    /// Sets the files of cubes among the inputs aside. Returns them and the paths of all other inputs. If incomplete
    /// input is allowed, reads them all, warns about each that is damaged, and [leaves it out](Self::take_left_out):
    /// cubes that are converted cannot be taken back.
    pub fn among(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<(Self, Vec<PathBuf>)> {
        let (paths, rest): (Vec<_>, Vec<_>) =
            options.inputs.iter().cloned().partition(|path| format_of(path).is_some());
        if let Some(path) = rest.iter().find(|path| is_words(path)) {
            let reason = "the words of a voxel octree; name its .voxel.json, which lies beside it";
            return Err(Error::input(path, "name", reason));
        }
        let paths = each_once(paths, monitor);
        let parameter = match (&options.shard, &options.plan_file) {
            (Some(_), _) => Some(Parameter::Shard),
            (None, Some(_)) => Some(Parameter::Other("plan file".into())),
            (None, None) => None,
        };
        if let (Some(first), Some(parameter)) = (paths.first(), parameter) {
            let reason = format!("{}: cubes are converted in one run, without a plan", first.display());
            return Err(Error::parameter(parameter, reason));
        }
        let mut set = Self::default();
        for path in paths {
            let grid = match grid_of(&path, options, monitor) {
                Err(error) if options.allow_incomplete && is_of_input(&error) => {
                    monitor.warn(&format!("incomplete: left out: {error}").into());
                    (set.is_partial, set.left_out) = (true, Some(error));
                    continue;
                }
                grid => grid?,
            };
            if grid.origin_m != [0.0; 3] {
                let text = format!(
                    "{}: its cubes do not lie on a grid from the origin, as pixels do; they grow to whole pixels",
                    path.display()
                );
                monitor.warn(&text.into());
            }
            set.finest_m = Some(set.finest_m.map_or(grid.size_m, |size| size.min(grid.size_m)));
            set.beside.extend(binary_of(&path));
            set.paths.push(path);
        }
        set.bytes = set.paths().map(|path| path.metadata().map_or(0, |about| about.len())).sum();
        Ok((set, rest))
    }

    /// Returns, once, the error of the last file that was left out: the reason to fail if no other input is left.
    pub fn take_left_out(&mut self) -> Option<Error> {
        self.left_out.take()
    }

    /// Returns true if no file was left out.
    pub fn is_complete(&self) -> bool {
        !self.is_partial
    }

    /// Returns the paths of the files that are read, those beside the inputs included.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.paths.iter().chain(&self.beside).map(PathBuf::as_path)
    }

    /// Returns the paths of the inputs.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        self.paths.iter().map(PathBuf::as_path)
    }

    /// Length of all files (bytes).
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the size of the smallest cubes that the files can hold (m).
    pub fn finest_m(&self) -> Option<f64> {
        self.finest_m
    }

    /// Returns the unit of the files, if there are any.
    pub fn length_unit(&self, units: Units) -> Option<LengthUnit> {
        (!self.paths.is_empty()).then_some(match units {
            Units::Auto => LengthUnit::METRE,
            Units::Factor(factor) => LengthUnit::of(factor),
        })
    }

    /// Reads all files and returns the bounds of all cubes (m), or `None` without any.
    pub fn bounds(&self, options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Option<([f64; 3], [f64; 3])>> {
        let mut all = Read::NOTHING;
        self.for_each(options, monitor, |grid, cube| {
            let (min, max) = grid.bounds(cube);
            all.merge(&Read { min, max, ..Read::NOTHING });
        })?;
        Ok((all.min[0] <= all.max[0]).then_some((all.min, all.max)))
    }

    fn for_each(
        &self,
        options: &ConvertOptions,
        monitor: &dyn Monitor,
        mut take: impl FnMut(&CubeGrid, &Cube),
    ) -> Result<()> {
        let mut batch = Vec::new();
        for path in &self.paths {
            let mut file = Placed::open(path, options)?;
            while file.next_batch(&mut batch)? {
                if monitor.cancelled() {
                    return Err(Error::Interrupted);
                }
                batch.iter().for_each(|cube| take(&file.grid, cube));
            }
        }
        Ok(())
    }

    /// Fails if the voxels that the cubes fill do not fit on the disk: a tree of a few bytes can fill any.
    fn check_space(
        &self,
        options: &ConvertOptions,
        plan: &Plan,
        retain_bytes: u64,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let mut voxels = 0.0;
        self.for_each(options, monitor, |grid, cube| {
            voxels += PlacedCube::new(&plan.frame, grid, cube).map_or(0.0, |placed| placed.voxels());
        })?;
        let (needed, dir) = (voxels * VOXEL_BYTES - retain_bytes as f64, &options.resources.temp_dir);
        let free = Files::current().free_bytes(dir).map_err(|error| Error::io(dir, "ask for its free space", error))?;
        if needed > free as f64 {
            let what = format!(
                "temporary data for {} voxels of cubes in {} (bytes; more memory needs less)",
                grouped(voxels as u64),
                dir.display()
            );
            return Err(Error::limit(what, format!("{needed:.0}"), free).with_suggestion(Parameter::TempDir));
        }
        Ok(())
    }
}

/// Opens a file of cubes, and reads it to its end if incomplete input is allowed.
fn grid_of(path: &Path, options: &ConvertOptions, monitor: &dyn Monitor) -> Result<CubeGrid> {
    let mut file = Placed::open(path, options)?;
    let mut batch = Vec::new();
    while options.allow_incomplete && file.next_batch(&mut batch)? {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
    }
    Ok(file.grid)
}

/// Returns whether this is the second file of a voxel octree.
fn is_words(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    name.to_ascii_lowercase().ends_with(".voxel.bin")
}

/// First pass: writes all cubes into runs. One worker at a time reads; all of them fill voxels.
pub(super) fn read_cubes<'a>(pass: FirstPass<'_>, set: &'a CubeSet) -> Result<SourceRead<'a>> {
    let FirstPass { options, plan, limits, store, monitor, .. } = pass;
    let mut all = SourceRead::NOTHING;
    if set.paths.is_empty() {
        return Ok(all);
    }
    monitor.stage("reading cubes", 0, "cubes");
    set.check_space(options, plan, limits.retain_bytes, monitor)?;
    for path in &set.paths {
        let file = Placed::open(path, options)?;
        let (grid, frame) = (file.grid, &plan.frame);
        let file = Mutex::new(file);
        let flag = StopFlag::new(monitor);
        let next =
            |batch: &mut Vec<Cube>| file.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next_batch(batch);
        let work = || -> Result<Read> {
            let (mut runs, mut builder) = (pass.runs(), CubeBuilder::default());
            let (mut read, mut batch) = (Read::NOTHING, Vec::new());
            while next(&mut batch)? {
                for cube in &batch {
                    let (min, max) = grid.bounds(cube);
                    let placed = PlacedCube::new(frame, &grid, cube).ok_or_else(|| out_of_reach(frame, min, max))?;
                    builder.push(&placed, &mut runs, store, &|| flag.is_raised())?;
                    read.merge(&Read { min, max, own: Own { min, max, ..Read::NOTHING.own }, ..Read::NOTHING });
                    read.counts.read += 1;
                    if flag.is_raised() {
                        return Err(Error::Interrupted);
                    }
                }
                monitor.advance(batch.len() as u64);
            }
            builder.flush(&mut runs, store)?;
            runs.flush(store)?;
            Ok(read)
        };
        let mut of_file = Read::NOTHING;
        pass.on_threads(&flag, work)?.iter().for_each(|read| of_file.merge(read));
        if of_file.counts.read > 0 {
            all.scenes.push(Scene { path, min: of_file.min, max: of_file.max });
        }
        all.read.merge(&of_file);
    }
    all.read.own.kept = all.read.counts.read;
    Ok(all)
}
