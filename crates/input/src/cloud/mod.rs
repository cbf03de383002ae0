//! Clouds in formats other than LAS: PLY, PCD, text (XYZ, CSV, PTS, PTX) and E57.
//!
//! Input: an open file whose name or signature identifies its format. Output: a [`Cloud`]: facts from its header,
//! [`Piece`]s of work, and the points of each piece in the file's own coordinates. [`Taker`] does what all formats
//! share: units, rotation to z up, points without a return or out of range, batches.
//!
//! Coordinates are not rounded: a stored number (integer, `f32`, `f64`, decimal text) becomes the nearest `f64`, and
//! poses are applied in `f64`, each operation rounded once, in a fixed order, with sine and cosine from `libm` rather
//! than the system. So the same file gives the same coordinates on every machine.
//!
//! Memory per piece: a block of the file of at most 1 MiB and a batch; each format documents what it needs beyond that.

mod body;
mod e57;
mod pcd;
mod ply;
mod records;
mod text;
mod values;

use super::crs::Georeference;
use super::diagnostics::{Findings, incomplete, without_path};
use super::source::Source;
use super::{BATCH_POINTS, Columns, FARTHEST_M, InputOptions, PointBatch, PointCounts, TextLayout};
use crate::colour::ColourSource;
use crate::placement::Similarity;
use crate::plan::{ClassSet, Up};
use crate::text::shown;
use crate::{Error, Monitor, Result};
use std::fmt::Debug;
use std::path::Path;

pub(super) use ply::is_point_cloud as is_ply_cloud;
pub(super) use text::unpacked_name;
pub use values::Depth;

/// One opened cloud.
pub(super) trait Cloud: Debug + Send + Sync {
    /// Returns the name of the format.
    fn format(&self) -> &'static str;

    /// Returns the number of points the file states; 0 if it states none.
    fn points_stated(&self) -> u64;

    /// Returns the number of points the file can hold: a hint.
    fn points_expected(&self) -> u64;

    /// Returns whether any of its points have values of this source, according to its header.
    fn has_values(&self, source: ColourSource) -> bool;

    /// Determines the meaning of the values of this source, which the cloud has, if only the points reveal it. Call
    /// before decoding. Cost: at most some MiB of the file.
    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()>;

    /// Returns the maximum of red, green and blue, once they are prepared.
    fn depth(&self) -> Depth;

    /// Returns independent pieces of work, created lazily.
    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_>;

    /// Passes the points of a piece to `taker`, always the same points in the same order; returns how many are missing.
    fn decode(&self, piece: &Piece, source: &Source, scratch: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64>;

    /// Makes the checks that need all pieces, and discards the data collected for them. Cost: reads pieces that were
    /// not decoded, if necessary.
    fn check(&self, _findings: &mut Findings<'_>, _monitor: &dyn Monitor) -> Result<()> {
        Ok(())
    }

    /// Discards the data collected for [`check`](Self::check).
    fn forget(&self) {}

    /// Returns everything, apart from the bytes of the points, that determines pieces and coordinates.
    fn state(&self) -> Vec<u8>;

    /// Returns the scanner position of each of its clouds.
    fn standpoints(&self) -> Vec<Standpoint> {
        vec![Standpoint::Unknown(format!("{} does not say where the scanner stood", self.format()))]
    }
}

/// Scanner position of a cloud, according to its file.
#[derive(Debug, Clone, PartialEq)]
pub enum Standpoint {
    /// Position in the coordinates of the file.
    At([f64; 3]),
    /// The cloud has no points.
    Needless,
    /// Not stated; holds the reason.
    Unknown(String),
}

/// Unit of work; each format defines the meaning of its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Piece {
    /// Points that it should hold: for progress only.
    pub points: u64,
    /// Cloud or segment of the file.
    pub part: usize,
    pub first: u64,
    pub end: u64,
}

/// An opened cloud, with what opening found.
pub(super) struct Opened {
    pub cloud: Box<dyn Cloud>,
    pub georeference: Georeference,
    /// Warning about a guess that the user should check.
    pub odd: Option<String>,
    /// Columns and first points of text.
    pub text: Option<TextLayout>,
}

impl Opened {
    fn new(cloud: impl Cloud + 'static) -> Self {
        Self { cloud: Box::new(cloud), georeference: Georeference::default(), odd: None, text: None }
    }
}

/// Resources for opening a cloud.
pub(super) struct Opening<'a, 'f> {
    pub source: &'a Source,
    /// Length of the file (bytes).
    pub bytes: u64,
    pub columns: Option<Columns>,
    pub findings: &'a mut Findings<'f>,
    pub monitor: &'a dyn Monitor,
}

impl Opening<'_, '_> {
    /// Creates an error about this file.
    fn error(&self, at: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::input(self.source.path(), at, reason)
    }
}

/// Cloud formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    E57,
    Pcd,
    Ply,
    Pts,
    Ptx,
    Rows,
}

/// Returns the format indicated by the name.
pub(super) fn format_named(path: &Path) -> Option<Format> {
    let name = unpacked_name(path);
    Some(match name.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "e57" => Format::E57,
        "pcd" => Format::Pcd,
        "ply" => Format::Ply,
        "pts" => Format::Pts,
        "ptx" => Format::Ptx,
        "xyz" | "xyzrgb" | "xyzn" | "asc" | "csv" | "txt" => Format::Rows,
        _ => return None,
    })
}

/// Returns whether folders and patterns find a file of this name. `.txt`, `.csv` and `.asc` may be tables or grids of
/// any kind and `.ply` may be an export, so these must be named individually.
pub(super) fn is_found(path: &Path) -> bool {
    let ending = |endings: &[&str]| {
        unpacked_name(path).extension().is_some_and(|e| endings.iter().any(|ending| e.eq_ignore_ascii_case(ending)))
    };
    match path == unpacked_name(path) {
        true => ending(&["e57", "pcd", "pts", "ptx", "xyz", "xyzn", "xyzrgb"]),
        false => ending(&["pts", "ptx", "xyz", "xyzn", "xyzrgb"]),
    }
}

/// Returns the reason to refuse a Gaussian splat, recognised by its name; `None` for other files.
pub(super) fn splat_named(path: &Path) -> Option<&'static str> {
    let ending = path.extension()?.to_str()?.to_ascii_lowercase();
    ["splat", "ksplat", "spz", "sog"].contains(&ending.as_str()).then_some(SPLATS)
}

/// Error for splats.
const SPLATS: &str = "Gaussian splats are no point cloud: their centres lie beside the surfaces; convert the scan that \
                      they were made from, or their voxels or mesh";

/// Error for packed files of other formats than text.
pub(super) const PACKED: &str = "only text is read compressed (XYZ, CSV, PTS, PTX); unpack this file first";

/// Opens the file as a cloud of the given format.
pub(super) fn open(format: Format, mut opening: Opening<'_, '_>) -> Result<Opened> {
    if opening.bytes == 0 {
        return Err(opening.error("byte 0", "the file is empty; fetch or write it again"));
    }
    let is_text = matches!(format, Format::Pts | Format::Ptx | Format::Rows);
    let path = opening.source.path();
    if !is_text && path != unpacked_name(path) {
        return Err(opening.error("name", PACKED));
    }
    match format {
        Format::E57 => e57::open(&mut opening),
        Format::Pcd => pcd::open(&mut opening),
        Format::Ply => ply::open(&mut opening),
        Format::Pts => text::open_pts(&mut opening),
        Format::Ptx => text::open_ptx(&mut opening),
        Format::Rows => text::open_rows(&mut opening),
    }
}

/// Receives the points of a piece in file coordinates, and passes them on in batches.
pub(super) struct Taker<'a> {
    unit: [f64; 3],
    up: Up,
    placement: Option<Similarity>,
    exclude: Option<&'a ClassSet>,
    batch: &'a mut PointBatch,
    counts: PointCounts,
    /// Records since the last batch.
    since: usize,
    sink: &'a mut dyn FnMut(&PointBatch) -> Result<()>,
    /// True if the error came from the sink.
    pub refused: bool,
    colour: Option<ColourSource>,
    /// Factor for values.
    widen: u16,
    allow_incomplete: bool,
    /// Fault of the first record that was left out.
    reason: Option<String>,
    /// See [`farthest_singles`](Self::farthest_singles).
    farthest: [f64; 3],
}

impl<'a> Taker<'a> {
    pub fn new(
        unit: [f64; 3],
        options: &'a InputOptions,
        batch: &'a mut PointBatch,
        sink: &'a mut dyn FnMut(&PointBatch) -> Result<()>,
    ) -> Self {
        batch.clear();
        batch.cloud = 0;
        let exclude = Some(&options.exclude_classes).filter(|classes| !classes.is_empty());
        let counts = PointCounts::default();
        let InputOptions { up, placement, colour, allow_incomplete, .. } = *options;
        let (refused, reason) = (false, None);
        Self {
            unit,
            up,
            placement,
            exclude,
            batch,
            counts,
            since: 0,
            sink,
            refused,
            colour,
            widen: 1,
            allow_incomplete,
            reason,
            farthest: [0.0; 3],
        }
    }

    /// Scales values from 8 to 16 bits if `widen` is set.
    pub fn widening(self, widen: bool) -> Self {
        Self { widen: if widen { 257 } else { 1 }, ..self }
    }

    /// Returns whether classes are needed, to exclude or to colour points.
    pub fn wants_classes(&self) -> bool {
        self.exclude.is_some() || self.colour == Some(ColourSource::Class)
    }

    /// Begins a cloud of the file, which the following points belong to.
    pub fn begin_cloud(&mut self, cloud: usize) -> Result<()> {
        if cloud != self.batch.cloud {
            if self.since > 0 {
                self.flush()?;
            }
            self.batch.cloud = cloud;
        }
        Ok(())
    }

    /// Returns the source of requested values: red, green and blue, or intensity.
    pub fn wanted(&self) -> Option<ColourSource> {
        self.colour.filter(|source| *source != ColourSource::Class)
    }

    /// Adds a point, with its class if the file has classes, and with its value if it has one.
    #[inline]
    pub fn push(&mut self, at: [f64; 3], class: Option<f64>, value: Option<[u16; 3]>) -> Result<()> {
        self.counts.read += 1;
        if self.colour.is_some() {
            return self.push_coloured(at, class, value);
        }
        self.place(at, class, None)
    }

    fn push_coloured(&mut self, at: [f64; 3], class: Option<f64>, value: Option<[u16; 3]>) -> Result<()> {
        let value = match self.colour {
            Some(ColourSource::Class) => class.filter(|class| (0.0..256.0).contains(class)).map(|c| [c as u16, 0, 0]),
            _ => value.map(|value| value.map(|v| v.saturating_mul(self.widen))),
        };
        // In one batch, either all points have a value or none has.
        if !self.batch.is_empty() && self.batch.values.is_empty() == value.is_some() {
            self.flush()?;
        }
        self.place(at, class, value)
    }

    #[inline]
    fn place(&mut self, at: [f64; 3], class: Option<f64>, value: Option<[u16; 3]>) -> Result<()> {
        let point = [at[0] * self.unit[0], at[1] * self.unit[1], at[2] * self.unit[2]];
        let near = |v: f64| v.abs() <= FARTHEST_M;
        if let (Some(exclude), Some(class)) = (self.exclude, class)
            && (0.0..256.0).contains(&class)
            && exclude.contains(class as u8)
        {
            self.counts.excluded += 1;
        } else if near(point[0]) && near(point[1]) && near(point[2]) {
            self.batch.push(point);
            self.batch.values.extend(value);
        } else if at.iter().any(|v| v.is_nan()) {
            self.counts.withheld += 1;
        } else {
            self.counts.not_finite += 1;
        }
        self.step()
    }

    /// Notes the coordinates of a point that the file stores as floats of 32 bits.
    #[inline]
    pub fn note_singles(&mut self, at: [f64; 3], is_single: [bool; 3]) {
        for axis in 0..3 {
            let far = at[axis].abs();
            if is_single[axis] && far > self.farthest[axis] && far <= FARTHEST_M {
                self.farthest[axis] = far;
            }
        }
    }

    /// Returns how far from 0 the coordinates are that the file stores as floats of 32 bits (file units, before any pose).
    pub fn farthest_singles(&self) -> [f64; 3] {
        self.farthest
    }

    /// Adds a record that the file marks as having no return.
    #[inline]
    pub fn absent(&mut self) -> Result<()> {
        self.counts.read += 1;
        self.counts.withheld += 1;
        self.step()
    }

    /// Leaves out records that cannot be read: an error unless `allow_incomplete` is set.
    #[cold]
    pub fn leave_out(&mut self, records: u64, error: Error) -> Result<()> {
        if !self.allow_incomplete {
            return Err(match error {
                Error::Input { path, at, reason, .. } => incomplete(&path, &at, reason),
                error => error,
            });
        }
        self.counts.missing += records;
        self.reason.get_or_insert_with(|| without_path(error));
        Ok(())
    }

    /// Returns the number of records left out, and why the first was, if [`leave_out`](Self::leave_out) left out any.
    pub fn broken(&mut self) -> Option<(u64, String)> {
        self.reason.take().map(|reason| (self.counts.missing, reason))
    }

    /// Handles an unreadable record that the format itself reports. Returns whether incomplete input is allowed; if so,
    /// the record counts as missing.
    pub fn lose(&mut self) -> Result<bool> {
        if self.allow_incomplete {
            self.counts.missing += 1;
            self.step()?;
        }
        Ok(self.allow_incomplete)
    }

    #[inline]
    fn step(&mut self) -> Result<()> {
        self.since += 1;
        if self.since == BATCH_POINTS { self.flush() } else { Ok(()) }
    }

    /// Passes on the collected points.
    pub fn flush(&mut self) -> Result<()> {
        if self.up == Up::Y {
            std::mem::swap(&mut self.batch.y, &mut self.batch.z);
            self.batch.y.iter_mut().for_each(|y| *y = -*y);
        }
        self.placement.iter().for_each(|placement| placement.apply_to(self.batch.columns()));
        let taken = (self.sink)(self.batch).inspect_err(|_| self.refused = true);
        self.batch.clear();
        self.since = 0;
        taken
    }

    /// Returns the current counts.
    pub fn counts(&self) -> PointCounts {
        self.counts
    }
}

/// Returns the place `moved` that was computed from `at`. Infinity times 0 is NaN, which would count as no return; so a
/// NaN that was not there before becomes infinity.
#[inline]
fn loss_unless_absent(at: [f64; 3], moved: [f64; 3]) -> [f64; 3] {
    let has_nan = |at: [f64; 3]| at.iter().any(|v| v.is_nan());
    if has_nan(moved) && !has_nan(at) { [f64::INFINITY; 3] } else { moved }
}

/// A linear map, such as a rotation or scaling, and a shift: `x·m[0] + y·m[1] + z·m[2] + m[3]`, in this order.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pose([[f64; 3]; 4]);

impl Pose {
    const IDENTITY: Self = Self([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]]);

    #[inline]
    fn apply(&self, at: [f64; 3]) -> [f64; 3] {
        let ([x, y, z], m) = (at, &self.0);
        let moved = [0, 1, 2].map(|axis| x * m[0][axis] + y * m[1][axis] + z * m[2][axis] + m[3][axis]);
        loss_unless_absent(at, moved)
    }

    /// Returns whether all places have images in one plane.
    fn is_flat(&self) -> bool {
        let [x, y, z, _] = self.0;
        let length = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let volume = x[0] * (y[1] * z[2] - y[2] * z[1])
            + x[1] * (y[2] * z[0] - y[0] * z[2])
            + x[2] * (y[0] * z[1] - y[1] * z[0]);
        volume.abs() <= 1e-12 * length(x) * length(y) * length(z)
    }

    fn is_finite(&self) -> bool {
        self.0.as_flattened().iter().all(|v| v.is_finite())
    }

    fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        self.0.as_flattened().iter().flat_map(|v| v.to_le_bytes())
    }
}

#[cfg(test)]
mod tests;
