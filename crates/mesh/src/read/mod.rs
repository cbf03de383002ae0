//! Readers of mesh files: triangles in metres, z up.

mod blocks;
mod feed;
mod gltf;
mod material;
mod obj;
mod placing;
mod ply;
mod polygon;
mod stl;
mod text;
mod texture;
mod vertices;
mod watch;

use self::watch::{Digest, Watch};
use super::Triangle;
use super::paint::Paint;
use crate::bytes::{Regular, Stamp};
use crate::input::{Units, is_of_input};
use crate::placement::Similarity;
use crate::plan::Up;
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Parameter, Result, Warning};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use self::feed::Bounds;
pub use self::feed::MeshFeed;

/// Greatest magnitude of a coordinate that is kept (m); the same as for scans.
const FARTHEST_M: f64 = 1e12;

/// Options for reading meshes.
#[derive(Debug, Clone)]
pub struct MeshOptions {
    /// Length of a file unit. [`Units::Auto`] means metres: of the formats only glTF states a unit, and that is the
    /// metre.
    pub units: Units,
    /// Up axis of the files. Ignored for glTF, whose up axis is always y.
    pub up: Up,
    /// Placement of all triangles, in metres with z up; `None` leaves them in place.
    pub placement: Option<Similarity>,
    /// Most memory that a reader uses for one file (bytes).
    pub memory_bytes: u64,
    /// Folder for vertices that do not fit in memory.
    pub temp_dir: PathBuf,
    /// If true, files with broken faces are read as far as possible, with warnings, instead of being refused.
    pub allow_incomplete: bool,
    /// If true, there are inputs of other kinds, so that with `allow_incomplete` no mesh need be usable.
    pub has_others: bool,
    /// If true, all bytes read are hashed, so that two runs can compare their input.
    pub hash: bool,
    /// If true, triangles get the colours that their files state.
    pub colours: bool,
    /// Most memory that the textures of one file take, decoded and during decoding (bytes); more is an error.
    pub texture_bytes: u64,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self {
            units: Units::Auto,
            up: Up::Z,
            placement: None,
            memory_bytes: 64 << 20,
            temp_dir: slicewalk_base::disk::temp_dir(),
            allow_incomplete: false,
            has_others: false,
            hash: false,
            colours: false,
            texture_bytes: 256 << 20,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MeshFormat {
    Obj,
    Ply,
    Stl,
    Gltf,
}

fn kind_of(path: &Path) -> Option<MeshFormat> {
    Some(match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "obj" => MeshFormat::Obj,
        "ply" => MeshFormat::Ply,
        "stl" => MeshFormat::Stl,
        "gltf" | "glb" => MeshFormat::Gltf,
        _ => return None,
    })
}

/// Triangles of one file, in file coordinates.
trait Triangles: Send {
    /// Appends at most a few thousand triangles; returns false if there are no more.
    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool>;

    /// Returns which coordinates are floats of 32 bits in the file, and placed by nothing in it.
    fn are_singles(&self) -> [bool; 3] {
        [false; 3]
    }
}

/// Triangles with their paints.
#[derive(Debug, Default)]
pub struct MeshBatch {
    /// Triangles (m).
    pub triangles: Vec<Triangle>,
    /// One per triangle; empty if colours are not requested.
    pub paints: Vec<Paint>,
    is_painted: bool,
}

impl MeshBatch {
    /// Removes all triangles.
    pub fn clear(&mut self) {
        self.triangles.clear();
        self.paints.clear();
    }

    /// Returns the triangles with their paints.
    pub fn iter(&self) -> impl Iterator<Item = (&Triangle, &Paint)> {
        self.triangles.iter().zip(self.paints.iter().chain(std::iter::repeat(&Paint::None)))
    }

    fn len(&self) -> usize {
        self.triangles.len()
    }

    fn push(&mut self, triangle: Triangle, paint: Paint) {
        self.triangles.push(triangle);
        if self.is_painted {
            self.paints.push(paint);
        }
    }

    fn retain(&mut self, keeps: impl Fn(&Triangle) -> bool) {
        if self.is_painted {
            let mut triangles = self.triangles.iter();
            self.paints.retain(|_| triangles.next().is_some_and(&keeps));
        }
        self.triangles.retain(keeps);
    }
}

/// Triangles after which a batch is full; one face may add as many again.
const BATCH_TRIANGLES: usize = 1 << 12;

/// Numbers of triangles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MeshCounts {
    /// Triangles read.
    pub read: u64,
    /// Triangles left out, because they have no area or coordinates that are not finite or beyond 10¹² m.
    pub left_out: u64,
}

impl std::ops::AddAssign for MeshCounts {
    fn add_assign(&mut self, other: Self) {
        self.read += other.read;
        self.left_out += other.left_out;
    }
}

/// Mesh files that could be opened.
#[derive(Debug)]
pub struct MeshSet {
    files: Vec<MeshFile>,
    options: MeshOptions,
    complete: bool,
}

#[derive(Debug)]
struct MeshFile {
    path: PathBuf,
    kind: MeshFormat,
    stamp: Stamp,
}

impl MeshSet {
    /// Opens the meshes at `paths`, all of them with names of mesh formats. Warns once if a format states no unit and
    /// none is given, and, if incomplete input is allowed, about each file that cannot be opened.
    pub fn open(paths: &[PathBuf], options: MeshOptions, monitor: &dyn Monitor) -> Result<Self> {
        let mut files = Vec::with_capacity(paths.len());
        let mut left_out = None;
        for path in paths {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            match MeshFile::open(path) {
                Ok(file) => files.push(file),
                Err(error) if options.allow_incomplete && is_of_input(&error) => {
                    monitor.warn(&format!("incomplete: left out: {error}").into());
                    left_out = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        let complete = left_out.is_none();
        if let Some(error) = left_out.filter(|_| files.is_empty() && !options.has_others) {
            return Err(error);
        }
        let mut unknown = files.iter().filter(|file| options.units == Units::Auto && file.kind != MeshFormat::Gltf);
        if let Some(first) = unknown.next() {
            let others = match unknown.count() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let text =
                format!("{}{others}: meshes of this format state no unit; metres are assumed", first.path.display());
            monitor.warn(&Warning::from(text).with_suggestion(Parameter::Units));
        }
        Ok(Self { files, options, complete })
    }

    /// Returns the paths of the files.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| file.path.as_path())
    }

    /// Returns whether there are no files.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// Returns the unit of the files, if there are any.
    pub fn length_unit(&self) -> Option<LengthUnit> {
        (!self.is_empty()).then_some(match self.options.units {
            Units::Auto => LengthUnit::METRE,
            Units::Factor(factor) => LengthUnit::of(factor),
        })
    }

    /// Length of all files (bytes), for progress only.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.stamp.len()).fold(0, u64::saturating_add)
    }

    /// Returns whether no file had to be left out.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Starts reading all triangles from the first.
    pub fn feed(&self) -> MeshFeed<'_> {
        MeshFeed::new(self, self.options.colours)
    }

    /// Sets whether triangles get colours.
    pub fn set_colours(&mut self, wanted: bool) {
        self.options.colours = wanted;
    }

    /// Returns whether triangles get colours.
    pub fn has_paint(&self) -> bool {
        self.options.colours && !self.is_empty()
    }

    /// Returns whether some triangle has a colour other than black. Usually reads only part of the first file; without
    /// colours, reads all files.
    pub fn has_colours(&self, monitor: &dyn Monitor) -> Result<bool> {
        let (mut feed, mut batch) = (MeshFeed::new(self, true), MeshBatch::default());
        while feed.next_painted(&mut batch, &Silent(monitor))? {
            if batch.paints.iter().any(Paint::is_seen) {
                return Ok(true);
            }
            batch.clear();
        }
        Ok(false)
    }

    /// Reads all files with their colours, for the warnings that say why there are none.
    pub fn report_colours(&self, monitor: &dyn Monitor) -> Result<()> {
        let (mut feed, mut batch) = (MeshFeed::new(self, true), MeshBatch::default());
        while feed.next_painted(&mut batch, monitor)? {}
        Ok(())
    }

    /// Reads all files and returns the bounds of all usable triangles (m), or `None` without any. Does not warn;
    /// reading the triangles themselves does.
    pub fn bounds(&self, monitor: &dyn Monitor) -> Result<Option<Bounds>> {
        let (mut feed, mut batch) = (MeshFeed::new(self, false), Vec::new());
        while feed.next(&mut batch, &Silent(monitor))? {}
        Ok(feed.bounds())
    }

    fn reader(&self, number: usize, wants: Wants<'_>, watch: &mut Watch) -> Result<Box<dyn Triangles>> {
        let MeshFile { path, kind, .. } = &self.files[number];
        let (options, Wants { digest, .. }) = (&self.options, wants);
        Ok(match kind {
            MeshFormat::Obj => Box::new(obj::ObjReader::open(path, options, wants, watch)?),
            MeshFormat::Ply => Box::new(ply::PlyReader::open(path, options, wants, watch)?),
            MeshFormat::Stl => Box::new(stl::StlReader::open(path, digest, watch)?),
            MeshFormat::Gltf => Box::new(gltf::GltfReader::open(path, options, wants, watch)?),
        })
    }

    /// Returns the length of a file unit (m), before any placement.
    fn unit_m(&self) -> f64 {
        match self.options.units {
            Units::Auto => 1.0,
            Units::Factor(factor) => factor,
        }
    }

    /// Converts file coordinates to metres, z up.
    fn place(&self, number: usize, triangle: &mut Triangle) {
        let factor = self.unit_m();
        let turned = self.options.up == Up::Y || self.files[number].kind == MeshFormat::Gltf;
        for corner in triangle {
            let [x, y, z] = corner.map(|v| v * factor);
            let at = if turned { [x, -z, y] } else { [x, y, z] };
            *corner = self.options.placement.map_or(at, |placement| placement.apply(at));
        }
    }
}

impl MeshFile {
    fn open(path: &Path) -> Result<Self> {
        let (_, stamp) = Regular::open(path).map_err(|e| Error::io(path, "open", e))?;
        let kind = kind_of(path).ok_or_else(|| {
            Error::input(path, "name", "no mesh of a known format; expected .obj, .ply, .stl, .gltf or .glb")
        })?;
        Ok(Self { path: path.to_path_buf(), kind, stamp })
    }
}

/// Outputs requested from a reader besides the triangles.
#[derive(Clone, Copy)]
struct Wants<'a> {
    digest: &'a Digest,
    /// Present if colours are requested; each texture holds a clone.
    colours: Option<&'a Arc<()>>,
}

/// Monitor that forwards cancellation and drops all messages.
struct Silent<'a>(&'a dyn Monitor);

impl Monitor for Silent<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Returns whether a corner is not finite or too far away to be kept.
fn is_far(triangle: &Triangle) -> bool {
    !triangle.as_flattened().iter().all(|v| v.abs() <= FARTHEST_M)
}

/// Returns whether a triangle has an area and lies within the kept coordinates.
fn usable(triangle: &Triangle) -> bool {
    !is_far(triangle) && super::raster::has_area(triangle)
}
