//! Reads laser scans and yields points in metres.
//!
//! Input: LAS 1.0 to 1.5 and LAZ files (COPC files are LAZ), clouds in E57, PLY, PCD and text, directories, patterns.
//! Output: [`PointBatch`]es of kept points, z up, in metres; no later stage knows what a LAS record is. No byte of a
//! file is trusted: a damaged file causes an [`Error::Input`] of one line or a warning, never a panic, and no number in
//! a file determines an allocation before it is checked against the file's length.
//!
//! Usage: [`InputSet::open`] checks the headers; [`InputSet::chunks`] divides the files into pieces; any number of
//! threads, each with its own [`PointDecoder`], decode pieces in any order; finally call [`InputSet::check_complete`].
//!
//! Memory: a set holds about 300 bytes plus the path per file and 8 bytes per LAZ chunk (16 MiB for 10¹¹ points). A
//! decoder holds 3 MiB, plus the compressed coordinates of one chunk for layered LAZ (see
//! [`InputOptions::memory_bytes`]) and 8 MiB for `.zst`.
//!
//! Sources: "LAS Specification 1.4 - R15" and "LAS Specification 1.5" (ASPRS); LASzip: see `laz`.

pub mod beside;
mod cloud;
mod columns;
mod convert;
mod crs;
mod decode;
mod diagnostics;
mod epsg;
mod epsg_table;
mod expand;
mod file;
pub mod gltf;
mod header;
mod las;
mod laz;
mod noise;
pub mod number;
mod pattern;
pub mod ply_header;
mod records;
pub mod scenes;
pub mod singles;
mod source;
pub mod spacing;
pub mod unzstd;

use laz::ChunkMemory;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use self::convert::{Filter, Layout};
use self::file::Common;
use crate::bytes::address;
use crate::colour::ColourSource;
use crate::placement::Similarity;
use crate::plan::{ClassSet, Up};
use crate::text::number;
use crate::unit::{FOOT_M, LengthUnit, UNIT_RANGE_M, US_SURVEY_FOOT_M};
use diagnostics::{Diagnostics, Findings};
use singles::Singles;
use slicewalk_base::{Error, Monitor, Parameter, Result, Warning, bytes, colour, placement, plan, text, unit};

pub use self::cloud::{Depth, Standpoint};
pub use self::columns::{Columns, TextColumn, TextLayout};
pub use self::convert::FARTHEST_M;
pub use self::crs::{is_in_metres, projected_epsg};
pub use self::decode::{PointChunk, PointDecoder};
pub use self::file::ScanFile;
pub use self::source::{ReadLog, Reads};
pub use diagnostics::{incomplete, warn_incomplete};
pub use expand::each_once;

/// Maximum number of points in one [`PointBatch`].
pub const BATCH_POINTS: usize = 1 << 16;

/// Length of a file unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Units {
    /// As stated by the file's reference system; metres if it states none.
    #[default]
    Auto,
    /// Metres per unit, for x, y and z of every file (m, > 0).
    Factor(f64),
}

/// Parses the command-line form: `auto`, the name of a unit, or metres per unit.
impl FromStr for Units {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        Ok(match text {
            "auto" => Self::Auto,
            "m" => Self::Factor(1.0),
            "ft" => Self::Factor(FOOT_M),
            "us-ft" => Self::Factor(US_SURVEY_FOOT_M),
            factor => match factor.parse::<f64>() {
                Ok(value) if value > 0.0 && value.is_finite() => Self::Factor(value),
                _ => return Err("expected auto, m, ft, us-ft, or metres per unit above 0".into()),
            },
        })
    }
}

/// Options for reading a set of files.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputOptions {
    /// Length of a file unit.
    pub units: Units,
    /// EPSG code of the reference system, for files that state none; a file that states another is refused.
    pub epsg: Option<u32>,
    /// Columns of text files without a header of their own; by default x, y and z come first.
    pub columns: Option<Columns>,
    /// Axis of the files that points up.
    pub up: Up,
    /// Placement of all points, in metres with z up; `None` leaves them in place.
    pub placement: Option<Similarity>,
    /// LAS classes to leave out: class `c` is bit `c % 64` of word `c / 64`.
    pub exclude_classes: ClassSet,
    /// Byte limit for a compressed LAZ chunk in a decoder, and for all chunk tables of the set together. Only one decoder
    /// at a time holds more than its share, this limit divided by the number of threads: together they hold at most
    /// twice the limit.
    pub memory_bytes: u64,
    /// Source of colour values to read from points, in files that have it.
    pub colour: Option<ColourSource>,
    /// Reads files that are only partly readable, with warnings, instead of refusing them.
    pub allow_incomplete: bool,
    /// Hashes everything that is decoded, so that two runs can check that they read the same data.
    pub hash: bool,
    /// Threads that read headers, and that decode at once; at least 1.
    pub threads: usize,
}

impl Default for InputOptions {
    fn default() -> Self {
        Self {
            units: Units::Auto,
            epsg: None,
            columns: None,
            up: Up::Z,
            placement: None,
            exclude_classes: ClassSet::default(),
            memory_bytes: 64 << 20,
            colour: None,
            allow_incomplete: false,
            hash: false,
            threads: 1,
        }
    }
}

/// Kept points of one cloud in metres, z up; the three columns have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct PointBatch {
    /// Coordinates along x (m).
    pub x: Vec<f64>,
    /// Coordinates along y (m).
    pub y: Vec<f64>,
    /// Heights (m).
    pub z: Vec<f64>,
    /// Cloud of the file that all points belong to, from 0: an E57 or PTX file may hold several.
    pub cloud: usize,
    /// Colour values, one per point; empty if the points have none or none were requested. Red, green and blue, up to
    /// 255 or 65,535 as stored in the file; otherwise the intensity or class followed by zeros.
    pub values: Vec<[u16; 3]>,
    /// Station tags, one per point: point source id or GPS time (s). Empty if the file has none or none were requested.
    pub tags: Vec<f64>,
}

/// Kind of tag that identifies the station which measured a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tag {
    /// The source identifier of LAS.
    SourceId,
    /// The GPS time of the point.
    GpsTime,
}

impl PointBatch {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Returns whether it holds no points.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Removes all points.
    pub fn clear(&mut self) {
        self.resize(0);
    }

    /// Adds a point (m).
    pub fn push(&mut self, point: [f64; 3]) {
        for (column, value) in [&mut self.x, &mut self.y, &mut self.z].into_iter().zip(point) {
            column.push(value);
        }
    }

    fn columns(&mut self) -> [&mut [f64]; 3] {
        [&mut self.x, &mut self.y, &mut self.z]
    }

    fn resize(&mut self, points: usize) {
        for column in [&mut self.x, &mut self.y, &mut self.z] {
            column.resize(points, 0.0);
        }
        self.values.truncate(points);
        self.tags.truncate(points);
    }
}

/// Point counts; their sums do not depend on the order in which pieces are decoded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PointCounts {
    /// Points read, kept or not.
    pub read: u64,
    /// Points among `read` left out because the file marks them: withheld in LAS, without a return in other formats
    /// (not a number, an invalid state, `0 0 0` in PTX).
    pub withheld: u64,
    /// Points among `read` left out by class.
    pub excluded: u64,
    /// Points among `read` left out because a coordinate is not finite or exceeds 10¹² m.
    pub not_finite: u64,
    /// Points that were expected but missing or unreadable (not included in `read`).
    pub missing: u64,
}

impl PointCounts {
    /// Returns the number of points passed on.
    pub fn kept(&self) -> u64 {
        self.read - self.withheld - self.excluded - self.not_finite
    }
}

impl std::ops::AddAssign for PointCounts {
    fn add_assign(&mut self, other: Self) {
        self.read += other.read;
        self.withheld += other.withheld;
        self.excluded += other.excluded;
        self.not_finite += other.not_finite;
        self.missing += other.missing;
    }
}

/// Bounding box stated by a header (m, z up).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedBounds {
    /// Minimum corner.
    pub min: [f64; 3],
    /// Maximum corner.
    pub max: [f64; 3],
}

/// Files opened before the warnings about them are issued.
const OPENED_AT_ONCE: usize = 1024;

/// Returns the number of threads for opening files with a few reads each. For remote files it may exceed the number of
/// processors: latency dominates, and every thread has a connection of its own.
pub fn threads_to_look<'a>(threads: usize, mut paths: impl ExactSizeIterator<Item = &'a Path>) -> usize {
    const AT_ONCE: usize = 32;
    let many = (paths.len() / FILES_A_CONNECTION).min(AT_ONCE);
    if paths.any(|path| address(path).is_some()) { threads.max(many) } else { threads }
}

/// Minimum number of remote files that justify one more connection.
const FILES_A_CONNECTION: usize = 3;

/// Expands `inputs` to files, sorted by path, each listed once.
pub fn expand_inputs(inputs: &[PathBuf], monitor: &dyn Monitor) -> Result<Vec<PathBuf>> {
    expand::expand(inputs, None, monitor)
}

/// Runs `work` on `items` on at most `threads` threads and returns the results in order, up to and including the first
/// for which `stops` is true. Returns fewer if `monitor` was cancelled.
fn in_order<I: Sync, T: Send>(
    items: &[I],
    threads: usize,
    work: &(dyn Fn(&I) -> T + Sync),
    stops: &(dyn Fn(&T) -> bool + Sync),
    monitor: &dyn Monitor,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let found = Mutex::new((0..items.len()).map(|_| None).collect::<Vec<Option<T>>>());
    let run = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(number).filter(|_| !monitor.cancelled()) else { return };
            let done = work(item);
            if stops(&done) {
                next.store(items.len(), Ordering::Relaxed);
            }
            found.lock().unwrap_or_else(PoisonError::into_inner)[number] = Some(done);
        }
    };
    std::thread::scope(|scope| {
        // The calling thread works too, so the work completes even if the system cannot start other threads.
        for _ in 1..threads.min(items.len()) {
            let _ = crate::bytes::spawn_in(scope, run);
        }
        run();
    });
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut stopped = false;
    let before = |done: &T| !std::mem::replace(&mut stopped, stops(done));
    found.into_iter().map_while(|done| done).take_while(before).collect()
}

/// Opened scan files with checked headers, sorted by path.
#[derive(Debug)]
pub struct InputSet {
    files: Vec<ScanFile>,
    meshes: Vec<PathBuf>,
    options: InputOptions,
    crs: Option<String>,
    /// Filters for records of the old and of the extended layout.
    filters: [Filter; 2],
    diagnostics: Diagnostics,
    left_out: Option<Error>,
    /// Sum of the hashes of the decoded data, per file; empty unless requested.
    hashes: Mutex<Vec<u128>>,
    /// Decoded coordinates that are floats of 32 bits.
    singles: Mutex<Singles>,
    /// Kind of tag to read from points that have it.
    tag: Option<Tag>,
    /// Memory of all decoders for compressed chunks.
    chunk_memory: ChunkMemory,
}

impl InputSet {
    /// Opens and checks `inputs`: files; directories, which stand for the scans directly in them; patterns with `*`,
    /// `?`, `[...]`, `**` where no file of that name exists. Directories and patterns skip `.txt`, `.csv`, `.asc` and
    /// `.ply`, except that patterns ending in `.ply` match PLY files. A file named twice is read once. Files with mesh
    /// extensions are set aside, PLY files only if they have faces.
    ///
    /// Fails with one line on the first file that cannot be read in full. With `allow_incomplete`, such a file is read
    /// as far as possible or left out, with a warning to `monitor`. Wrong counts, unknown units and the like are
    /// warnings, too. Cost: a few small reads per file, and its chunk table; all lines of text that states how many
    /// lines belong to a cloud (PTX, PLY, PCD); all packet headers of E57.
    pub fn open(inputs: &[PathBuf], options: InputOptions, monitor: &dyn Monitor) -> Result<Self> {
        let diagnostics = Diagnostics::default();
        let paths = expand::expand(inputs, options.allow_incomplete.then_some(&diagnostics), monitor)?;
        Self::with(paths, diagnostics, options, monitor)?.unless_all_are_left_out()
    }

    /// Like [`open`](Self::open), but sets the files aside for which `is_apart` is true, and returns their paths. All
    /// others may be [left out](Self::take_left_out).
    pub fn open_apart(
        inputs: &[PathBuf],
        is_apart: &dyn Fn(&Path) -> bool,
        options: InputOptions,
        monitor: &dyn Monitor,
    ) -> Result<(Self, Vec<PathBuf>)> {
        let diagnostics = Diagnostics::default();
        let paths = expand::expand(inputs, options.allow_incomplete.then_some(&diagnostics), monitor)?;
        let (apart, paths) = paths.into_iter().partition(|path| is_apart(path));
        Ok((Self::with(paths, diagnostics, options, monitor)?, apart))
    }

    /// Like [`open`](Self::open), but takes the files that [`expand_inputs`] found; there may be none.
    pub fn of_paths(paths: Vec<PathBuf>, options: InputOptions, monitor: &dyn Monitor) -> Result<Self> {
        Self::with(paths, Diagnostics::default(), options, monitor)?.unless_all_are_left_out()
    }

    fn unless_all_are_left_out(mut self) -> Result<Self> {
        match self.left_out.take().filter(|_| self.files.is_empty() && self.meshes.is_empty()) {
            Some(error) => Err(error),
            None => Ok(self),
        }
    }

    fn with(
        paths: Vec<PathBuf>,
        diagnostics: Diagnostics,
        options: InputOptions,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        if let Units::Factor(factor) = options.units
            && !UNIT_RANGE_M.contains(&factor)
        {
            return Err(Error::parameter(
                Parameter::Units,
                format!("{} is not a number of metres per unit", number(factor)),
            ));
        }
        let (mut left_out, allow_incomplete) = (None, options.allow_incomplete);
        let mut leave_out = |error: Error| match allow_incomplete && is_of_input(&error) {
            true => {
                monitor.warn(&format!("incomplete: left out: {error}").into());
                diagnostics.note();
                left_out = Some(error);
                Ok(())
            }
            false => Err(error),
        };
        let (mut meshes, mut scans) = (Vec::new(), Vec::new());
        for path in paths {
            match expand::is_mesh(&path) {
                Ok(true) => meshes.push(path),
                Ok(false) => scans.push(path),
                Err(error) => leave_out(error)?,
            }
        }
        let paths = scans;
        if let Some(mesh) = meshes.iter().find(|mesh| address(mesh).is_some()) {
            return Err(Error::input(mesh, "address", "meshes are read from files only; copy it here"));
        }
        let mut files: Vec<ScanFile> = Vec::with_capacity(paths.len());
        let common = Common::new(options.memory_bytes.max(16 << 20));
        let (mut systems, mut no_unit, mut degrees) = (crs::Systems::default(), Those::default(), Those::default());
        let mut odd = BTreeMap::<String, Those>::new();
        let open = |path: &PathBuf| {
            let mut findings = Findings { path, allow_incomplete, notes: Vec::new(), lost: Vec::new(), points: 0 };
            let opened = ScanFile::open(path, &options, &common, &mut findings, monitor);
            (findings.notes, (findings.lost, findings.points), opened)
        };
        let stops = |opened: &Result<_>| opened.as_ref().is_err_and(|error| !allow_incomplete || !is_of_input(error));
        let blocks = paths.chunks(OPENED_AT_ONCE);
        let opened = blocks.flat_map(|paths| {
            let threads = threads_to_look(options.threads, paths.iter().map(PathBuf::as_path));
            let found = in_order(paths, threads, &open, &|(_, _, opened)| stops(opened), monitor);
            paths.iter().zip(found)
        });
        let mut count = 0;
        for (path, (notes, (lost, points), opened)) in opened {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            count += 1;
            notes.iter().for_each(|note| monitor.warn(&format!("{}: {note}", path.display()).into()));
            lost.iter().for_each(|lost| warn_incomplete(path, lost, monitor));
            if !lost.is_empty() {
                diagnostics.note();
                diagnostics.note_points(points);
            }
            match opened {
                Ok((file, reference)) => {
                    systems.add(files.len(), reference.crs, reference.codes);
                    no_unit.add(files.len(), reference.no_unit);
                    degrees.add(files.len(), reference.degrees);
                    reference.odd.into_iter().for_each(|text| odd.entry(text).or_default().add(files.len(), true));
                    files.push(file);
                }
                Err(error) => leave_out(error)?,
            }
        }
        // All files were opened, unless the monitor was cancelled meanwhile.
        if count < paths.len() {
            return Err(Error::Interrupted);
        }
        odd.iter().for_each(|(text, those)| those.tell(&files, text, None, monitor));
        no_unit.tell(&files, "no unit of length is stated; metres are assumed", Some(Parameter::Units), monitor);
        degrees.tell(
            &files,
            "x and y are longitude and latitude in degrees, which are taken as lengths; project the scan first",
            None,
            monitor,
        );
        let crs = systems.common(&files, monitor).or_else(|| options.epsg.map(epsg_text));
        let filters = [Layout::Old, Layout::Extended].map(|layout| Filter::new(layout, &options.exclude_classes));
        let hashes = Mutex::new(vec![0; if options.hash { files.len() } else { 0 }]);
        if let Some(source) = options.colour {
            files.iter_mut().try_for_each(|file| file.prepare_values(source))?;
        }
        files.shrink_to_fit();
        let chunk_memory = ChunkMemory::new(options.memory_bytes, options.threads);
        let singles = Mutex::default();
        let tag = None;
        Ok(Self { files, meshes, options, crs, filters, diagnostics, left_out, hashes, singles, tag, chunk_memory })
    }

    /// Returns, once, the error of the last file that [`open_apart`](Self::open_apart) left out: the reason to fail if
    /// no other input is left.
    pub fn take_left_out(&mut self) -> Option<Error> {
        self.left_out.take()
    }

    /// Replaces the reference system, for runs whose inputs are not only scans.
    pub fn set_crs(&mut self, crs: Option<String>) {
        self.crs = crs;
    }

    /// Returns the number of points expected from headers and chunk tables: for progress only.
    pub fn points_stated(&self) -> u64 {
        self.files.iter().map(ScanFile::points_expected).fold(0, u64::saturating_add)
    }

    /// Returns the total length of all files (bytes): for progress only.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(ScanFile::bytes).fold(0, u64::saturating_add)
    }

    /// Returns the reference system stated by the scans, or that of the options if they state none. If scans state
    /// several, returns the one whose text sorts first.
    pub fn crs(&self) -> Option<&str> {
        self.crs.as_deref()
    }

    /// Returns the units of the files that hold points.
    pub fn length_units(&self) -> impl Iterator<Item = LengthUnit> + '_ {
        self.files.iter().filter(|file| file.points_expected() > 0).map(|file| {
            let [horizontal_m, _, vertical_m] = file.unit_m();
            LengthUnit { horizontal_m, vertical_m }
        })
    }

    /// Returns the files, sorted by path.
    pub fn files(&self) -> &[ScanFile] {
        &self.files
    }

    /// Returns the meshes among the inputs, sorted by path. They are not opened and add no points to the set.
    pub fn meshes(&self) -> &[PathBuf] {
        &self.meshes
    }

    /// Replaces the meshes by those that could be opened.
    pub fn set_meshes<'a>(&mut self, paths: impl Iterator<Item = &'a Path>) {
        self.meshes = paths.map(Path::to_path_buf).collect();
    }

    /// Returns the options the set was opened with.
    pub fn options(&self) -> &InputOptions {
        &self.options
    }

    /// Fails if decoding lost points since the last call, or if a file changed since it was opened. With
    /// `allow_incomplete`, warns `monitor` instead, with one line per file and kind of loss.
    pub fn check_complete(&self, monitor: &dyn Monitor) -> Result<()> {
        self.check_complete_of(&|_| true, monitor)
    }

    /// Like [`check_complete`](Self::check_complete), for the files, by number, that were decoded whole. What decoding
    /// found in the others is discarded; a later pass finds it again.
    pub fn check_complete_of(&self, is_whole: &dyn Fn(usize) -> bool, monitor: &dyn Monitor) -> Result<()> {
        for (number, file) in self.files.iter().enumerate() {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            if !is_whole(number) {
                file.forget();
                self.diagnostics.forget(number);
                continue;
            }
            if !file.stamp.is_of(file.path()) {
                self.diagnostics.add(number, |loss| loss.changed = true);
            }
            let path = file.path();
            let (notes, lost) = (Vec::new(), Vec::new());
            let mut findings = Findings { path, allow_incomplete: true, notes, lost, points: 0 };
            file.check(&mut findings, monitor)?;
            findings.notes.iter().for_each(|note| monitor.warn(&format!("{}: {note}", path.display()).into()));
            self.diagnostics.set_short(number, findings.points);
            if !findings.lost.is_empty() {
                self.diagnostics.add(number, |loss| loss.told.append(&mut findings.lost));
            }
        }
        self.diagnostics.settle(&self.files, self.options.allow_incomplete, monitor)
    }

    /// Returns true if nothing is known to be missing; always true unless `allow_incomplete` is set.
    pub fn is_complete(&self) -> bool {
        !self.diagnostics.any()
    }

    /// Returns the number of points found missing when the files were opened or checked; those missed by decoding are
    /// not included.
    pub fn points_missing(&self) -> u64 {
        self.diagnostics.points()
    }

    /// Returns an order-independent hash of the data decoded from a file, or 0 unless the options request hashes.
    pub fn hash(&self, file: usize) -> u128 {
        let hashes = self.hashes.lock().unwrap_or_else(PoisonError::into_inner);
        hashes.get(file).map_or(0, |hash| hash.wrapping_add(self.files[file].hash()))
    }

    /// Hashes all data decoded from now on.
    pub fn start_hashing(&mut self) {
        self.options.hash = true;
        self.hashes = Mutex::new(vec![0; self.files.len()]);
    }

    /// Determines the meaning of values of this source in files where only the points reveal it. Cost: some MiB read
    /// per such file.
    pub fn prepare_values(&mut self, source: ColourSource) -> Result<()> {
        self.files.iter_mut().try_for_each(|file| file.prepare_values(source))
    }

    /// Returns the maximum of red, green and blue of each file; `None` for files without colours.
    pub fn depths(&self) -> Vec<Option<Depth>> {
        self.files.iter().map(|file| file.has_values(ColourSource::Rgb).then(|| file.depth())).collect()
    }

    /// Marks the red, green and blue of a file as 8-bit; they are then scaled to 16 bits.
    pub fn widen(&mut self, file: usize) {
        self.files[file].widen = true;
    }

    /// Sets the source of colour values to read from now on.
    pub fn set_colour(&mut self, source: Option<ColourSource>) {
        self.options.colour = source;
    }

    /// Sets the placement of all points, in metres with z up.
    pub fn set_placement(&mut self, placement: Option<Similarity>) {
        self.options.placement = placement;
        self.files.iter_mut().for_each(|file| file.transform.placement = placement);
    }

    /// Sets the kind of tag to read from now on.
    pub fn set_tag(&mut self, tag: Option<Tag>) {
        self.tag = tag;
    }

    /// Returns whether points of any file have such values, according to the headers.
    pub fn has_values(&self, source: ColourSource) -> bool {
        self.files.iter().any(|file| file.has_values(source))
    }

    /// Adds the hash of a piece that was decoded from the file of this number.
    pub fn add_hash(&self, file: usize, hash: u128) {
        let mut hashes = self.hashes.lock().unwrap_or_else(PoisonError::into_inner);
        hashes[file] = hashes[file].wrapping_add(hash);
    }

    /// Warns once of files that store coordinates as floats of 32 bits, if a decoded point is at a coordinate
    /// where floats are coarse for pixels of `pixel_m`.
    pub fn warn_of_coarse_floats(&self, pixel_m: f64, monitor: &dyn Monitor) {
        let factor = self.options.placement.map_or(1.0, |placement| placement.factor());
        let about = |file: usize| (self.files[file].path(), self.files[file].unit_m().map(|unit| unit * factor));
        let singles = self.singles.lock().unwrap_or_else(PoisonError::into_inner);
        singles.warning(pixel_m, about).iter().for_each(|text| monitor.warn(&text.as_str().into()));
    }

    fn filter(&self, layout: Layout) -> &Filter {
        &self.filters[usize::from(layout == Layout::Extended)]
    }
}

/// Formats an EPSG code as the text of a reference system.
fn epsg_text(code: u32) -> String {
    format!("EPSG:{code}")
}

/// Returns whether an error concerns one input file rather than the options or the machine.
pub fn is_of_input(error: &Error) -> bool {
    matches!(error, Error::Io { .. } | Error::Input { .. } | Error::Unsupported { .. })
}

/// Files that share one warning.
#[derive(Default)]
struct Those {
    first: Option<usize>,
    count: usize,
}

impl Those {
    fn add(&mut self, file: usize, is_one: bool) {
        if is_one {
            self.first.get_or_insert(file);
            self.count += 1;
        }
    }

    /// Returns the name of the first file and the number of others.
    fn names(&self, files: &[ScanFile]) -> Option<String> {
        let first = files.get(self.first?)?.path().display();
        Some(if self.count > 1 { format!("{first} and {} more", self.count - 1) } else { first.to_string() })
    }

    fn tell(&self, files: &[ScanFile], what: &str, suggestion: Option<Parameter>, monitor: &dyn Monitor) {
        if let Some(names) = self.names(files) {
            let warning = Warning::from(format!("{names}: {what}"));
            monitor.warn(&match suggestion {
                Some(parameter) => warning.with_suggestion(parameter),
                None => warning,
            });
        }
    }
}
