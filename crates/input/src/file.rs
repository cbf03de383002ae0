//! One scan file: its checked header and records, and the location of its points.
//!
//! This file and its sibling modules read LAS and LAZ; every other format is a [`Cloud`].

use super::cloud::{self, Cloud, Depth, Opened, Opening, Standpoint};
use super::convert::{Field, Layout, TagField, Transform};
use super::crs;
use super::diagnostics::Findings;
use super::header::LasHeader;
use super::laz::{Chunk, ChunkMemory, Chunking, Packing};
use super::records::Records;
use super::scenes::Scene;
use super::source::Source;
use super::{InputOptions, StatedBounds, Tag, TextLayout, Units, las};
use crate::bytes::Stamp;
use crate::colour::ColourSource;
use crate::text::number;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use xxhash_rust::xxh3::{Xxh3, xxh3_128};

/// One opened scan file.
#[derive(Debug)]
pub struct ScanFile {
    path: PathBuf,
    /// Length and time of the last change.
    pub stamp: Stamp,
    version: (u8, u8),
    format: u8,
    pub(super) record_bytes: u16,
    pub(super) points_at: u64,
    points_stated: u64,
    /// Minimum and maximum corner stated by the header, in file units.
    bounds: [[f64; 3]; 2],
    pub(super) transform: Transform,
    pub(super) content: Content,
    /// True if red, green and blue are 8-bit and must be scaled to 16 bits.
    pub(super) widen: bool,
    text: Option<Box<TextLayout>>,
}

#[derive(Debug)]
pub(super) enum Content {
    Plain {
        points: u64,
    },
    Packed {
        packing: Arc<Packing>,
        body: Chunking,
    },
    /// A format other than LAS; fields of `ScanFile` that only LAS has are 0.
    Cloud(Box<dyn Cloud>),
}

/// Data shared by the files of a set.
#[derive(Debug)]
pub(super) struct Common {
    /// Packings, keyed by the bytes of the LASzip record.
    packings: Mutex<HashMap<Vec<u8>, Arc<Packing>>>,
    /// Number of chunks that may still be listed.
    chunks_left: AtomicU64,
    /// Memory of decoders while files are opened: one at a time.
    memory: ChunkMemory,
}

impl Common {
    /// Shares a limit of `memory_bytes` among all chunk tables.
    pub fn new(memory_bytes: u64) -> Self {
        Self {
            packings: Mutex::default(),
            chunks_left: (memory_bytes / size_of::<Chunk>() as u64).into(),
            memory: ChunkMemory::new(memory_bytes, usize::MAX),
        }
    }

    fn packing(&self, source: &Source, body: &[u8], memory_bytes: u64) -> Result<Arc<Packing>> {
        let packings = || self.packings.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(packing) = packings().get(body) {
            return Ok(packing.clone());
        }
        let packing = Arc::new(Packing::read(source, body, memory_bytes)?);
        // Another thread may have inserted it meanwhile.
        Ok(packings().entry(body.to_vec()).or_insert(packing).clone())
    }
}

/// Reference system of a file, and what it leaves open.
#[derive(Debug, Default)]
pub(super) struct Reference {
    /// WKT, else `EPSG:n`, else the citation of the GeoTIFF keys.
    pub crs: Option<String>,
    /// EPSG codes of the system and its components, as far as stated.
    pub codes: Vec<u32>,
    pub no_unit: bool,
    pub degrees: bool,
    /// Warnings about what the user should check; files with the same one share it.
    pub odd: Vec<String>,
}

impl ScanFile {
    pub(super) fn open(
        path: &Path,
        options: &InputOptions,
        common: &Common,
        findings: &mut Findings,
        monitor: &dyn Monitor,
    ) -> Result<(Self, Reference)> {
        let source = Source::open(path, None)?;
        let bytes = source.stamp().len();
        let start = source.bytes_at(0, bytes.min(8) as usize)?.unwrap_or_default();
        if !start.starts_with(b"LASF") {
            if let Some(reason) = cloud::splat_named(path) {
                return Err(Error::input(path, "name", reason));
            }
            let format = if start == b"ASTM-E57" { Some(cloud::Format::E57) } else { cloud::format_named(path) };
            if let Some(format) = format {
                let opening =
                    Opening { source: &source, bytes, columns: options.columns, findings: &mut *findings, monitor };
                let opened = cloud::open(format, opening)?;
                return Self::of_cloud(&source, opened, options, findings);
            }
            if let Some(reason) = other_format(path) {
                return Err(Error::input(path, "name", reason));
            }
            if path != cloud::unpacked_name(path) {
                return Err(Error::input(path, "name", cloud::PACKED));
            }
        }
        let mut header = LasHeader::read(&source, bytes)?;
        findings.notes.append(&mut header.notes);
        let mut records = Records::read(&source, &header, bytes)?;
        findings.notes.append(&mut records.notes);
        let georeference = crs::Georeference::read(&records, header.says_wkt);
        let (reference, unit) = settle(path, georeference, options, findings)?;
        let transform = Transform {
            scale: header.scale,
            offset: header.offset,
            unit,
            up: options.up,
            placement: options.placement,
        };
        let content = match (&records.laszip, header.compressed) {
            (Some(body), true) => {
                let packing = common.packing(&source, body, options.memory_bytes)?;
                packing.check_record_bytes(&header, findings);
                let left = common.chunks_left.load(Ordering::Relaxed);
                let body = packing.body(&source, &header, bytes, left, findings)?;
                if let Chunking::Chunks { chunks, .. } = &body {
                    // Threads may exceed the limit, each by one file.
                    let less = |left: u64| Some(left.saturating_sub(chunks.len() as u64));
                    let _ = common.chunks_left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
                }
                packing.check_returns(&source, &header, &body, &common.memory, findings, monitor)?;
                Content::Packed { packing, body }
            }
            (None, false) => Content::Plain { points: las::points(&source, &header, bytes, findings)? },
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
        let file = Self {
            path: path.to_path_buf(),
            stamp: source.stamp(),
            version: header.version,
            format: header.format,
            record_bytes: header.record_bytes,
            points_at: header.points_at,
            points_stated: header.points_stated,
            bounds: header.bounds,
            transform,
            content,
            widen: false,
            text: None,
        };
        if file.points_expected() == 0 && file.points_stated == 0 {
            findings.note("it holds no points");
        }
        if let Content::Plain { points } = file.content {
            las::check_end(&source, &header, bytes, points, findings, monitor)?;
        }
        Ok((file, reference))
    }

    /// Builds the file of a cloud.
    fn of_cloud(
        source: &Source,
        opened: Opened,
        options: &InputOptions,
        findings: &mut Findings,
    ) -> Result<(Self, Reference)> {
        let Opened { cloud, georeference, odd, text } = opened;
        let (mut reference, unit) = settle(source.path(), georeference, options, findings)?;
        reference.odd.extend(odd);
        if cloud.points_expected() == 0 {
            findings.note("it holds no points");
        }
        let file = Self {
            path: source.path().to_path_buf(),
            stamp: source.stamp(),
            version: (0, 0),
            format: 0,
            record_bytes: 0,
            points_at: 0,
            points_stated: cloud.points_stated(),
            bounds: [[f64::NAN; 3]; 2],
            transform: Transform {
                scale: [1.0; 3],
                offset: [0.0; 3],
                unit,
                up: options.up,
                placement: options.placement,
            },
            content: Content::Cloud(cloud),
            widen: false,
            text: text.map(Box::new),
        };
        Ok((file, reference))
    }

    /// Converts a position in the file's own coordinates to metres, z up; `None` if the result is not finite.
    pub fn place_of(&self, at: [f64; 3]) -> Option<[f64; 3]> {
        self.transform.corner(at)
    }

    /// Returns the scanner position of each cloud, in the file's own coordinates.
    pub fn standpoints(&self) -> Vec<Standpoint> {
        match &self.content {
            Content::Cloud(cloud) => cloud.standpoints(),
            _ => vec![Standpoint::Unknown(format!("{} does not say where the scanner stood", self.format()))],
        }
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the length of the file (bytes).
    pub fn bytes(&self) -> u64 {
        self.stamp.len()
    }

    /// Returns the LAS version, for example (1, 4); `None` for other formats.
    pub fn version(&self) -> Option<(u8, u8)> {
        (!matches!(self.content, Content::Cloud(_))).then_some(self.version)
    }

    /// Returns the LAS point format [0..=10]; `None` for other formats.
    pub fn point_format(&self) -> Option<u8> {
        self.version().map(|_| self.format)
    }

    /// Returns the name of the format: LAS, LAZ, E57, PCD, PLY, PTS, PTX, text.
    pub fn format(&self) -> &'static str {
        match &self.content {
            Content::Plain { .. } => "LAS",
            Content::Packed { .. } => "LAZ",
            Content::Cloud(cloud) => cloud.format(),
        }
    }

    /// Returns how the columns of an XYZ, CSV, PTS or PTX file were interpreted.
    pub fn text_layout(&self) -> Option<&TextLayout> {
        self.text.as_deref()
    }

    /// Makes the checks that need all pieces decoded.
    pub(super) fn check(&self, findings: &mut Findings<'_>, monitor: &dyn Monitor) -> Result<()> {
        match &self.content {
            Content::Cloud(cloud) => cloud.check(findings, monitor),
            _ => Ok(()),
        }
    }

    /// Discards the data collected for [`check`](Self::check).
    pub(super) fn forget(&self) {
        if let Content::Cloud(cloud) = &self.content {
            cloud.forget();
        }
    }

    /// Returns whether the format has a header that states bounds and a point count, right or wrong, as LAS does.
    pub fn has_header(&self) -> bool {
        !matches!(self.content, Content::Cloud(_))
    }

    /// Returns the number of points stated by the header.
    pub fn points_stated(&self) -> u64 {
        self.points_stated
    }

    /// Returns the number of points that the file's length and chunk table allow: a better hint, but still only a hint.
    pub fn points_expected(&self) -> u64 {
        match &self.content {
            Content::Plain { points } => *points,
            Content::Packed { body: Chunking::Stream { points, .. }, .. } => *points,
            Content::Packed { body: Chunking::Chunks { chunks, .. }, .. } => {
                chunks.iter().map(|c| u64::from(c.points)).sum()
            }
            Content::Cloud(cloud) => cloud.points_expected(),
        }
    }

    /// Returns metres per file unit along the file's own x, y and z.
    pub fn unit_m(&self) -> [f64; 3] {
        self.transform.unit
    }

    /// Returns where flags and class lie in a record.
    pub(super) fn layout(&self) -> Layout {
        match &self.content {
            Content::Packed { packing, .. } => packing.layout,
            Content::Plain { .. } if self.format < 6 => Layout::Old,
            Content::Plain { .. } | Content::Cloud(_) => Layout::Extended,
        }
    }

    /// Returns where the colour values lie in a decoded record; `None` if the file has none.
    pub(super) fn field(&self, source: ColourSource) -> Option<Field> {
        let rgb = match &self.content {
            Content::Packed { packing, .. } => packing.rgb_at,
            // Offsets for point formats 0 to 10.
            Content::Plain { .. } => match self.format {
                2 => Some(20),
                3 | 5 => Some(28),
                7 | 8 | 10 => Some(30),
                _ => None,
            },
            Content::Cloud(_) => return None,
        };
        match source {
            ColourSource::Rgb => rgb.map(Field::Rgb),
            ColourSource::Intensity => Some(Field::Intensity),
            ColourSource::Class => Some(Field::Class(self.layout())),
        }
    }

    /// Returns where the tag of a point lies in a decoded record; `None` if the points have none.
    pub(super) fn tag_field(&self, tag: Tag) -> Option<TagField> {
        let (layout, format) = (self.layout(), self.point_format()?);
        match (tag, layout, &self.content) {
            (Tag::SourceId, Layout::Old, _) => Some(TagField::SourceId(18)),
            (Tag::SourceId, Layout::Extended, _) => Some(TagField::SourceId(20)),
            // The items state what packed records hold, whatever the header says.
            (Tag::GpsTime, Layout::Old, Content::Packed { packing, .. }) => packing.time_at.map(TagField::GpsTime),
            (Tag::GpsTime, Layout::Old, _) => matches!(format, 1 | 3..=5).then_some(TagField::GpsTime(20)),
            (Tag::GpsTime, Layout::Extended, _) => Some(TagField::GpsTime(22)),
        }
    }

    /// Returns whether the points have such a tag.
    pub fn has_tags(&self, tag: Tag) -> bool {
        self.tag_field(tag).is_some()
    }

    /// Returns whether the points have such values, according to the header.
    pub(super) fn has_values(&self, source: ColourSource) -> bool {
        let of_cloud = match &self.content {
            Content::Cloud(cloud) => cloud.has_values(source),
            _ => self.field(source).is_some(),
        };
        of_cloud && self.points_expected() > 0
    }

    /// Determines the meaning of values of this source.
    pub(super) fn prepare_values(&mut self, source: ColourSource) -> Result<()> {
        self.widen = false;
        if !self.has_values(source) {
            return Ok(());
        }
        match &mut self.content {
            Content::Cloud(cloud) => cloud.prepare(source, &Source::open(&self.path, None)?),
            _ => Ok(()),
        }
    }

    /// Returns the maximum value of red, green and blue.
    pub(super) fn depth(&self) -> Depth {
        match &self.content {
            Content::Cloud(cloud) => cloud.depth(),
            _ => Depth::Unstated,
        }
    }

    /// Returns the XXH3-128 of everything in the header that affects coordinates.
    pub(super) fn hash(&self) -> u128 {
        let Transform { scale, offset, unit, placement, .. } = self.transform;
        let placement = placement.into_iter().flat_map(|placement| placement.matrix());
        let numbers = [scale, offset, unit].concat().into_iter().chain(placement).flat_map(f64::to_le_bytes);
        let counts = [self.points_at, self.points_expected(), u64::from(self.record_bytes), u64::from(self.format)];
        let state = match &self.content {
            Content::Cloud(cloud) => cloud.state(),
            _ => Vec::new(),
        };
        xxh3_128(&numbers.chain(counts.into_iter().flat_map(u64::to_le_bytes)).chain(state).collect::<Vec<_>>())
    }

    /// Returns the XXH3-128 of everything that determines how the file is divided into pieces.
    pub fn layout_hash(&self) -> u128 {
        let mut hash = Xxh3::new();
        hash.update(&self.hash().to_le_bytes());
        if let Content::Packed { body: Chunking::Chunks { start, chunks }, .. } = &self.content {
            hash.update(&start.to_le_bytes());
            for chunk in chunks {
                hash.update(&[chunk.bytes.to_le_bytes(), chunk.points.to_le_bytes()].concat());
            }
        }
        hash.digest128()
    }

    /// Returns the bounds stated by the header, often wrong; `None` if not finite or not in order.
    pub fn bounds_stated(&self) -> Option<StatedBounds> {
        let [a, b] = self.bounds;
        let in_order = (0..3).all(|axis| a[axis] <= b[axis]);
        let (min, max) = self.transform.bounds(a, b)?;
        in_order.then_some(StatedBounds { min, max })
    }

    /// Returns whether the stated bounds differ from `min` and `max` of the points by more than one coordinate step.
    /// The stated bounds may be larger unless `all` points of the file are covered.
    pub fn bounds_disagree(&self, min: [f64; 3], max: [f64; 3], all: bool) -> bool {
        let Some(stated) = self.bounds_stated() else { return self.has_header() };
        // Turned bounds are larger than those of the turned points.
        let all = all && self.transform.placement.is_none();
        (0..3).any(|axis| {
            let slack = self.slack(min[axis], max[axis]);
            let (below, above) = (stated.min[axis] - min[axis], max[axis] - stated.max[axis]);
            below.max(above) > slack || all && below.min(above) < -slack
        })
    }

    /// Returns the stated bounds, enlarged by one coordinate step on every side.
    pub fn bounds_with_slack(&self) -> Option<StatedBounds> {
        let stated = self.bounds_stated()?;
        let slack: [f64; 3] = std::array::from_fn(|axis| self.slack(stated.min[axis], stated.max[axis]));
        let min: [f64; 3] = std::array::from_fn(|axis| stated.min[axis] - slack[axis]);
        let max: [f64; 3] = std::array::from_fn(|axis| stated.max[axis] + slack[axis]);
        let finite = min.iter().chain(&max).all(|v| v.is_finite());
        finite.then_some(StatedBounds { min, max })
    }

    /// Returns the file and its stated bounds, if it states points.
    pub fn scene_stated(&self) -> Option<Scene<'_>> {
        let StatedBounds { min, max } = self.bounds_stated().filter(|_| self.points_expected() > 0)?;
        Some(Scene { path: &self.path, min, max })
    }

    /// Tolerance for comparing a coordinate between `min` and `max` with the header (m): one step of the largest scale,
    /// plus rounding.
    fn slack(&self, min: f64, max: f64) -> f64 {
        let factor = self.transform.placement.map_or(1.0, |placement| placement.factor());
        let step =
            (0..3).map(|axis| (self.transform.scale[axis] * self.transform.unit[axis]).abs()).fold(0.0, f64::max);
        factor * step + 1e-9 * min.abs().max(max.abs())
    }
}

/// Combines what the file states with the options: returns the reference and the lengths of the units (m).
fn settle(
    path: &Path,
    mut georeference: crs::Georeference,
    options: &InputOptions,
    findings: &mut Findings,
) -> Result<(Reference, [f64; 3])> {
    let other = match options.units {
        Units::Factor(factor) => georeference.other_unit(factor).map(|other| (other, factor)),
        Units::Auto => None,
    };
    if let Some(code) = options.epsg {
        let note = georeference.complete(code).map_err(|reason| Error::input(path, "reference system", reason))?;
        georeference.notes.extend(note);
    }
    if let Units::Factor(_) = options.units {
        georeference.drop_notes_of_units();
    }
    let mut reference = Reference {
        crs: georeference.text.take(),
        codes: std::mem::take(&mut georeference.codes),
        degrees: georeference.degrees,
        ..Reference::default()
    };
    reference.odd.extend(other.map(|(other, factor)| {
        format!("it states a unit of {} m; the given one, {} m, counts", number(other), number(factor))
    }));
    let unit = match options.units {
        Units::Factor(factor) => [factor; 3],
        Units::Auto => {
            if let Some(unit) = georeference.absurd_unit() {
                let unit = number(unit);
                let reason =
                    format!("it states a unit of {unit} m, which scans do not have (expected 0.001 to 10000 m)");
                return Err(Error::input(path, "reference system", reason).with_suggestion(Parameter::Units));
            }
            reference.no_unit = georeference.horizontal.is_none() && !georeference.degrees;
            let horizontal = georeference.horizontal.unwrap_or(1.0);
            // Heights without a unit of their own use the map's, as is usual with surveys in feet; never degrees.
            let vertical = georeference.vertical.unwrap_or(horizontal);
            [horizontal, horizontal, vertical]
        }
    };
    findings.notes.append(&mut georeference.notes);
    Ok((reference, unit))
}

/// Returns why a file with this extension is not read, and what to do.
fn other_format(path: &Path) -> Option<&'static str> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    Some(match extension.as_str() {
        "off" | "3mf" | "fbx" => "a mesh in a format that is not read; write it as OBJ, PLY, STL or glTF",
        "rcp" | "rcs" | "fls" | "zfs" | "lsproj" => {
            "a point cloud in a format that is not read; write it as LAS, LAZ, E57, PLY, PCD, PTS, PTX or XYZ"
        }
        "slices" => "a slice archive holds no points; name the scans that it was made from",
        _ => return None,
    })
}
