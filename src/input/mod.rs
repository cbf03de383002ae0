//! Laser scans in, points in metres out.
//!
//! In: LAS 1.0 to 1.5 and LAZ files (COPC files are LAZ), directories, patterns. Out: [`PointBatch`]es of kept points,
//! z up, in metres. Nothing later knows what a LAS record is. No byte of a file is trusted: a damaged one gives an
//! [`Error::Input`] of one line or a warning, never a panic, and no number in it sizes anything before it is
//! checked against the file's length.
//!
//! How to use it: [`InputSet::open`] checks the headers; [`InputSet::units`] cuts the files into pieces; any number of
//! threads, each with its own [`Decoder`], decode pieces in any order; [`InputSet::warn_of_losses`] at the end.
//!
//! Memory: a set holds some hundred bytes a file and 8 bytes a LAZ chunk (16 MiB for 10¹¹ points); a decoder 3 MiB, and
//! for layered LAZ the compressed coordinates of one chunk (see [`InputOptions::memory_bytes`]).
//!
//! Sources: "LAS Specification 1.4 - R15" and "LAS Specification 1.5" (ASPRS); LASzip as in the crate `laz`.

mod convert;
mod crs;
mod epsg;
mod expand;
mod header;
mod las;
mod laz;
mod records;
pub(crate) mod scenes;
mod source;
pub mod spacing;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use self::convert::{Filter, Layout, Transform};
use self::header::Header;
use self::laz::{Body, Packing, Run};
use self::records::Records;
use self::scenes::Scene;
use self::source::Source;
use crate::plan::{ClassSet, Up};
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Parameter, Result};

pub use self::laz::quiet_decoder_panics;

/// Most points of one [`PointBatch`].
pub const BATCH_POINTS: usize = 1 << 16;
/// Points of one [`Unit`] of a plain LAS file.
const UNIT_POINTS: u64 = 1 << 17;
/// Longest slab of undecoded records (bytes); fits a second-level cache beside the batch.
const SLAB_BYTES: usize = 1 << 20;

/// Length of a file unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Units {
    /// As the file's reference system says; metres where it says nothing.
    #[default]
    Auto,
    /// Metres per unit, for x, y and z of every file (m, > 0).
    Factor(f64),
}

/// What to read and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputOptions {
    /// Length of a file unit.
    pub units: Units,
    /// Which axis of the files points up.
    pub up: Up,
    /// Bit `c % 64` of word `c / 64` set: points of LAS class `c` are left out.
    pub exclude_classes: ClassSet,
    /// What one decoder may hold of one compressed LAZ chunk, and the set of chunk tables (bytes).
    pub memory_bytes: u64,
}

impl Default for InputOptions {
    fn default() -> Self {
        Self { units: Units::Auto, up: Up::Z, exclude_classes: ClassSet::default(), memory_bytes: 64 << 20 }
    }
}

/// Kept points in metres, z up; the three columns are equally long.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointBatch {
    /// Coordinates along x (m).
    pub x: Vec<f64>,
    /// Coordinates along y (m).
    pub y: Vec<f64>,
    /// Heights (m).
    pub z: Vec<f64>,
}

impl PointBatch {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether it holds no point.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    fn resize(&mut self, points: usize) {
        for column in [&mut self.x, &mut self.y, &mut self.z] {
            column.resize(points, 0.0);
        }
    }
}

/// Numbers of points; sums do not depend on the order of units.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct UnitCounts {
    /// Points read, kept or not.
    pub read: u64,
    /// Of these, left out because withheld.
    pub withheld: u64,
    /// Of these, left out by class.
    pub excluded: u64,
    /// Of these, left out because a coordinate is not finite or beyond 10¹² m.
    pub not_finite: u64,
    /// Points that were expected but not there (not among `read`).
    pub missing: u64,
}

impl UnitCounts {
    /// Points handed on.
    pub fn kept(&self) -> u64 {
        self.read - self.withheld - self.excluded - self.not_finite
    }
}

impl std::ops::AddAssign for UnitCounts {
    fn add_assign(&mut self, other: Self) {
        self.read += other.read;
        self.withheld += other.withheld;
        self.excluded += other.excluded;
        self.not_finite += other.not_finite;
        self.missing += other.missing;
    }
}

/// A box that a header claims [m, z up].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedBounds {
    /// Least corner.
    pub min: [f64; 3],
    /// Greatest corner.
    pub max: [f64; 3],
}

/// One opened scan file.
#[derive(Debug)]
pub struct ScanFile {
    path: PathBuf,
    bytes: u64,
    header: Header,
    crs: Option<String>,
    transform: Transform,
    filter: Filter,
    content: Content,
    losses: Losses,
}

#[derive(Debug)]
enum Content {
    Plain { points: u64 },
    Packed { packing: Packing, body: Body },
}

/// What decoding lost, for one warning per file.
#[derive(Debug, Default)]
struct Losses {
    not_finite: AtomicU64,
    missing: AtomicU64,
    /// LAZ chunks that did not end where their points did.
    uneven: AtomicU64,
}

impl ScanFile {
    fn open(path: &Path, options: &InputOptions, chunks_left: u64) -> Result<(Self, Vec<String>, Unclear)> {
        if let Some(kind) = other_format(path) {
            let reason = format!("a {kind} is no laser scan in LAS or LAZ; expected \"LASF\" at byte 0");
            let source = Source::open(path)?;
            if source.bytes_at(0, 4)?.as_deref() != Some(b"LASF") {
                return Err(Error::input(path, "name", reason));
            }
        }
        let source = Source::open(path)?;
        let bytes = source.len()?;
        let mut header = Header::read(&source, bytes)?;
        let mut notes = std::mem::take(&mut header.notes);
        let mut records = Records::read(&source, &header, bytes)?;
        notes.append(&mut records.notes);
        let mut georeference = crs::Georeference::read(&records, header.says_wkt);
        let mut unclear = Unclear::default();
        let unit = match options.units {
            Units::Factor(factor) => [factor; 3],
            Units::Auto => {
                if let Some(unit) = georeference.absurd_unit() {
                    let reason = format!(
                        "it states a unit of {unit} m, which is no unit of scans (expected 0.001 to 10000 m); give the \
                         right one with --units"
                    );
                    return Err(Error::input(path, "reference system", reason));
                }
                notes.append(&mut georeference.notes);
                unclear.degrees = georeference.degrees;
                unclear.unit = georeference.horizontal.is_none() && !georeference.degrees;
                let horizontal = georeference.horizontal.unwrap_or(1.0);
                // Heights without a unit of their own: that of the map, as surveyors in feet do; never degrees.
                let vertical = georeference.vertical.unwrap_or(horizontal);
                [horizontal, horizontal, vertical]
            }
        };
        let transform = Transform { scale: header.scale, offset: header.offset, unit, up: options.up };
        let (content, layout) = match (&records.laszip, header.compressed) {
            (Some(body), true) => {
                let (packing, more) = Packing::read(&source, body, &header, options.memory_bytes)?;
                notes.extend(more);
                let body = packing.body(&source, &header, bytes, chunks_left, &mut notes)?;
                let layout = packing.layout;
                (Content::Packed { packing, body }, layout)
            }
            (None, false) => {
                let points = las::points(&source, &header, bytes, &mut notes)?;
                (Content::Plain { points }, if header.format < 6 { Layout::Old } else { Layout::Extended })
            }
            (None, true) => {
                let reason = "the points are compressed, but the LASzip record that says how is missing or cut";
                return Err(Error::input(path, "records before the points", reason));
            }
            (Some(_), false) => {
                let reason = "there is a LASzip record, but the point format does not say \"compressed\" (bit 7): one \
                              of the two is damaged";
                return Err(Error::input(path, "header, byte 104", reason));
            }
        };
        let filter = Filter::new(layout, &options.exclude_classes, &transform);
        let (path, crs) = (path.to_path_buf(), georeference.text);
        let file = Self { path, bytes, header, crs, transform, filter, content, losses: Losses::default() };
        if file.points_expected() == 0 && file.header.points_stated == 0 {
            notes.push("it holds no points".into());
        }
        Ok((file, notes, unclear))
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its length (bytes).
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// LAS version, for example (1, 4).
    pub fn version(&self) -> (u8, u8) {
        self.header.version
    }

    /// LAS point format [0..=10].
    pub fn point_format(&self) -> u8 {
        self.header.format
    }

    /// Whether its points are compressed (LAZ).
    pub fn compressed(&self) -> bool {
        self.header.compressed
    }

    /// Points that its header claims.
    pub fn points_stated(&self) -> u64 {
        self.header.points_stated
    }

    /// Points that it can hold by its length and chunk table: a better hint, still only a hint.
    pub fn points_expected(&self) -> u64 {
        match &self.content {
            Content::Plain { points } => *points,
            Content::Packed { body: Body::Stream { points, .. }, .. } => *points,
            Content::Packed { body: Body::Chunks { chunks, .. }, .. } => {
                chunks.iter().map(|c| u64::from(c.points)).sum()
            }
        }
    }

    /// Metres per file unit along the file's own x, y and z.
    pub fn unit_m(&self) -> [f64; 3] {
        self.transform.unit
    }

    /// Its reference system: WKT, else `EPSG:n`, else what its GeoTIFF keys cite.
    pub fn crs(&self) -> Option<&str> {
        self.crs.as_deref()
    }

    /// The bounds that its header claims; `None` where they are not finite or not in order. Often wrong.
    pub fn bounds_stated(&self) -> Option<StatedBounds> {
        let [a, b] = self.header.bounds;
        let in_order = (0..3).all(|axis| a[axis] <= b[axis]);
        let (a, b) = (self.transform.corner(a)?, self.transform.corner(b)?);
        let pick = |f: fn(f64, f64) -> f64| std::array::from_fn(|axis| f(a[axis], b[axis]));
        in_order.then_some(StatedBounds { min: pick(f64::min), max: pick(f64::max) })
    }
}

impl ScanFile {
    /// Whether the bounds that its header claims are not those of points from `min` to `max`, give or take a step of
    /// its coordinates. Unless these are `all` of its points, the claim may be larger.
    pub fn bounds_disagree(&self, min: [f64; 3], max: [f64; 3], all: bool) -> bool {
        let Some(stated) = self.bounds_stated() else { return true };
        (0..3).any(|axis| {
            let slack = self.slack(min[axis], max[axis]);
            let (below, above) = (stated.min[axis] - min[axis], max[axis] - stated.max[axis]);
            below.max(above) > slack || all && below.min(above) < -slack
        })
    }
}

impl ScanFile {
    /// The bounds that its header claims, larger by a step of its coordinates on every side.
    pub fn bounds_with_slack(&self) -> Option<StatedBounds> {
        let stated = self.bounds_stated()?;
        let slack: [f64; 3] = std::array::from_fn(|axis| self.slack(stated.min[axis], stated.max[axis]));
        let min: [f64; 3] = std::array::from_fn(|axis| stated.min[axis] - slack[axis]);
        let max: [f64; 3] = std::array::from_fn(|axis| stated.max[axis] + slack[axis]);
        let finite = min.iter().chain(&max).all(|v| v.is_finite());
        finite.then_some(StatedBounds { min, max })
    }

    /// The file with the bounds that its header claims, if it claims points.
    pub(crate) fn scene_stated(&self) -> Option<Scene<'_>> {
        let StatedBounds { min, max } = self.bounds_stated().filter(|_| self.points_expected() > 0)?;
        Some(Scene { path: &self.path, min, max })
    }

    /// How far a coordinate between `min` and `max` may lie from what a header says of it (m): a step of the largest
    /// scale, and rounding.
    fn slack(&self, min: f64, max: f64) -> f64 {
        let step =
            (0..3).map(|axis| (self.transform.scale[axis] * self.transform.unit[axis]).abs()).fold(0.0, f64::max);
        step + 1e-9 * min.abs().max(max.abs())
    }
}

/// What a file leaves open about its units.
#[derive(Debug, Default, Clone, Copy)]
struct Unclear {
    unit: bool,
    degrees: bool,
}

fn other_format(path: &Path) -> Option<&'static str> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    Some(match extension.as_str() {
        "off" | "3mf" | "fbx" => "mesh in a format that is not read (write it as OBJ, PLY, STL or glTF)",
        "e57" | "pcd" | "pts" | "ptx" | "xyz" | "rcp" | "rcs" => "point cloud of another format",
        "slices" => "slice archive",
        _ => return None,
    })
}

/// Opened scan files with checked headers, in order of their paths.
#[derive(Debug)]
pub struct InputSet {
    files: Vec<ScanFile>,
    meshes: Vec<PathBuf>,
    options: InputOptions,
    crs: Option<usize>,
}

impl InputSet {
    /// Opens and checks `inputs`: files; directories, which stand for the `.las` and `.laz` files directly in them;
    /// patterns with `*`, `?`, `[...]`, `**` where no such file exists. The same file named twice is read once. Files with
    /// names of meshes are set aside.
    ///
    /// Fails with one line on the first file that cannot be read at all. Cut files, wrong counts, unknown units and the
    /// like are told to `monitor`. Cost: a few small reads a file, and its chunk table.
    pub fn open(inputs: &[PathBuf], options: InputOptions, monitor: &dyn Monitor) -> Result<Self> {
        if let Units::Factor(factor) = options.units
            && !(1e-9..=1e9).contains(&factor)
        {
            return Err(Error::parameter(Parameter::Units, format!("{factor} is no number of metres per unit")));
        }
        let (meshes, paths): (Vec<_>, Vec<_>) =
            expand::expand(inputs, monitor)?.into_iter().partition(|path| expand::is_mesh(path));
        let mut files = Vec::with_capacity(paths.len());
        let mut chunks_left = options.memory_bytes.max(16 << 20) / size_of::<laz::Chunk>() as u64;
        let (mut no_unit, mut degrees) = (Vec::new(), Vec::new());
        for path in &paths {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let (file, notes, unclear) = ScanFile::open(path, &options, chunks_left)?;
            for note in notes {
                monitor.warn(&format!("{}: {note}", path.display()));
            }
            if let Content::Packed { body: Body::Chunks { chunks, .. }, .. } = &file.content {
                chunks_left -= chunks.len() as u64;
            }
            if unclear.unit {
                no_unit.push(path);
            }
            if unclear.degrees {
                degrees.push(path);
            }
            files.push(file);
        }
        let tell = |some: &[&PathBuf], what: &str| {
            if let Some(first) = some.first() {
                let others = if some.len() > 1 { format!(" and {} more", some.len() - 1) } else { String::new() };
                monitor.warn(&format!("{}{others}: {what}", first.display()));
            }
        };
        tell(&no_unit, "no unit of length is stated; metres are assumed, --units sets another");
        tell(
            &degrees,
            "x and y are longitude and latitude in degrees, which are taken as metres; project the scan first, or set \
             --units",
        );
        let crs = Self::common_crs(&files, monitor);
        Ok(Self { files, meshes, options, crs })
    }

    fn common_crs(files: &[ScanFile], monitor: &dyn Monitor) -> Option<usize> {
        let named = || (0..files.len()).filter(|&i| files[i].crs.is_some());
        let least = named().min_by_key(|&i| files[i].crs.as_deref())?;
        let (same, others): (Vec<_>, Vec<_>) = named().partition(|&i| files[i].crs == files[least].crs);
        if !others.is_empty() {
            let those = |some: &[usize]| {
                let file = &files[some[0]];
                let more = if some.len() > 1 { format!(" and {} more", some.len() - 1) } else { String::new() };
                let crs = crs::short_name(file.crs().unwrap_or_default());
                format!("{}{more} ({crs})", file.path.display())
            };
            monitor.warn(&format!(
                "{} and {} state different reference systems: coordinates are taken as they are, and the archive names \
                 the former system; bring the scans into one system first",
                those(&same),
                those(&others)
            ));
        }
        Some(least)
    }

    /// Independent pieces of work, made as they are asked for: 131,072 points of a LAS file, one LAZ chunk, or a LAZ file
    /// that can only be read from its start.
    pub fn units(&self) -> impl Iterator<Item = Unit> + Send + '_ {
        self.files.iter().enumerate().flat_map(|(file, scan)| {
            let units: Box<dyn Iterator<Item = Unit> + Send + '_> = match &scan.content {
                Content::Plain { points } => {
                    let points = *points;
                    Box::new((0..points.div_ceil(UNIT_POINTS)).map(move |i| {
                        let first = i * UNIT_POINTS;
                        Unit { file, points: UNIT_POINTS.min(points - first), part: Part::Records { first } }
                    }))
                }
                Content::Packed { body: Body::Stream { start, len, points }, .. } => {
                    let part = Part::Stream { start: *start, len: *len };
                    Box::new((*points > 0 && *len > 0).then_some(Unit { file, points: *points, part }).into_iter())
                }
                Content::Packed { body: Body::Chunks { start, chunks, open }, .. } => {
                    let mut at = *start;
                    Box::new(chunks.iter().enumerate().filter_map(move |(index, chunk)| {
                        let (start, len) = (at, u64::from(chunk.bytes));
                        at += len;
                        let open = *open && index + 1 == chunks.len();
                        let points = u64::from(chunk.points);
                        (points > 0).then_some(Unit { file, points, part: Part::Chunk { index, start, len, open } })
                    }))
                }
            };
            units
        })
    }

    /// Points that the headers and chunk tables lead to expect: for progress only.
    pub fn points_stated(&self) -> u64 {
        self.files.iter().map(ScanFile::points_expected).fold(0, u64::saturating_add)
    }

    /// Length of all files (bytes): for progress only.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|f| f.bytes).fold(0, u64::saturating_add)
    }

    /// The reference system of the scans; of several, the one whose text sorts first.
    pub fn crs(&self) -> Option<&str> {
        self.files[self.crs?].crs()
    }

    /// Units of the files that hold points.
    pub fn length_units(&self) -> impl Iterator<Item = LengthUnit> + '_ {
        self.files.iter().filter(|file| file.points_expected() > 0).map(|file| {
            let [horizontal_m, _, vertical_m] = file.unit_m();
            LengthUnit { horizontal_m, vertical_m }
        })
    }

    /// The files, in order of their paths.
    pub fn files(&self) -> &[ScanFile] {
        &self.files
    }

    /// Meshes among the inputs, in order of their paths: not opened, no part of the set's points.
    pub fn meshes(&self) -> &[PathBuf] {
        &self.meshes
    }

    /// The options that the set was opened with.
    pub fn options(&self) -> &InputOptions {
        &self.options
    }

    /// Tells `monitor` what decoding lost since the last call, one line per file and kind, in order of the files.
    pub fn warn_of_losses(&self, monitor: &dyn Monitor) {
        for file in &self.files {
            let warn = |counter: &AtomicU64, text: &str| {
                let count = counter.swap(0, Ordering::Relaxed);
                if count > 0 {
                    monitor.warn(&format!("{}: {count} {text}", file.path.display()));
                }
            };
            warn(&file.losses.not_finite, "points left out: a coordinate is not finite or beyond 1e12 m");
            warn(&file.losses.missing, "points are missing: the data end before them");
            warn(&file.losses.uneven, "LAZ chunks do not end where their last point does: they may be damaged");
        }
    }
}

/// One piece of work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unit {
    file: usize,
    points: u64,
    part: Part,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Records { first: u64 },
    Chunk { index: usize, start: u64, len: u64, open: bool },
    Stream { start: u64, len: u64 },
}

impl Unit {
    /// Index of its file in [`InputSet::files`].
    pub fn file(&self) -> usize {
        self.file
    }

    /// Points that it should hold: for progress only.
    pub fn points(&self) -> u64 {
        self.points
    }
}

/// Decodes units; one per thread, so that its buffers are reused.
#[derive(Debug, Default)]
pub struct Decoder {
    slab: Vec<u8>,
    batch: PointBatch,
    source: Option<Source>,
}

impl Decoder {
    /// A decoder with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Decodes `unit` of `set`, handing its kept points to `sink` in batches of 1 to [`BATCH_POINTS`] points.
    ///
    /// An error of `sink` ends the work and is returned. Points that are not there are counted, not an error; damaged
    /// compressed data are an error, after the points before the damage were handed on.
    pub fn decode(
        &mut self,
        set: &InputSet,
        unit: &Unit,
        sink: &mut dyn FnMut(&PointBatch) -> Result<()>,
    ) -> Result<UnitCounts> {
        let file = &set.files[unit.file];
        if self.source.as_ref().is_none_or(|s| s.path() != file.path) {
            self.source = Some(Source::open(&file.path)?);
        }
        let Some(source) = &self.source else { return Ok(UnitCounts::default()) };
        let record_bytes = match &file.content {
            Content::Plain { .. } => usize::from(file.header.record_bytes),
            Content::Packed { packing, .. } => packing.record_bytes,
        };
        // A slab is at least one record (64 KiB at most) and never more than a batch.
        let slab_points = (SLAB_BYTES / record_bytes).clamp(1, BATCH_POINTS);
        self.slab.resize(slab_points * record_bytes, 0);
        let (batch, mut counts) = (&mut self.batch, UnitCounts::default());
        let mut take = |records: &[u8]| {
            convert::convert(records, record_bytes, &file.transform, &file.filter, batch, &mut counts);
            if batch.is_empty() { Ok(()) } else { sink(batch) }
        };
        let classes = !set.options.exclude_classes.is_empty();
        let run = |packing, start, len, open, name| {
            let (points, memory_bytes) = (unit.points, set.options.memory_bytes);
            Run { source, packing, start, len, points, open, classes, memory_bytes, name }
        };
        let done = match (&unit.part, &file.content) {
            (Part::Chunk { index, start, len, open }, Content::Packed { packing, .. }) => {
                let run = run(packing, *start, *len, *open, format!("LAZ chunk {index}"));
                let (done, left) = run.decode(false, &mut self.slab, &mut take)?;
                if left > 0 && !open && !packing.layered() {
                    file.losses.uneven.fetch_add(1, Ordering::Relaxed);
                }
                done
            }
            (Part::Stream { start, len }, Content::Packed { packing, .. }) => {
                run(packing, *start, *len, true, "LAZ points".into()).decode(true, &mut self.slab, &mut take)?.0
            }
            (Part::Records { first }, _) => {
                let start = file.header.points_at + first * record_bytes as u64;
                las::read(source, start, unit.points, record_bytes, &mut self.slab, &mut take)?
            }
            _ => return Err(Error::parameter("unit", "it belongs to another set of files")),
        };
        // The last chunk of a file whose header lies holds fewer points than fit; that is no loss.
        let open = matches!(unit.part, Part::Chunk { open: true, .. });
        counts.missing = if open { 0 } else { unit.points.saturating_sub(done) };
        file.losses.not_finite.fetch_add(counts.not_finite, Ordering::Relaxed);
        file.losses.missing.fetch_add(counts.missing, Ordering::Relaxed);
        Ok(counts)
    }
}
