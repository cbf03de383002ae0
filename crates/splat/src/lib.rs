//! Readers of Gaussian splats: 3DGS PLY, PlayCanvas compressed PLY, SPZ, SOG, `.splat`, `.ksplat` and glTF.
//!
//! In: a file or folder of any size. Out: batches of [`Splat`]s in the order of the file, in its own axes and units.
//! Spherical harmonics beyond the base colour are skipped. The bytes are untrusted: a damaged file gives a one-line
//! [`Error::Input`], and no number in it sizes an allocation before it is checked. Memory: 1 MiB for each column of a
//! file, and more for compressed formats ([`SplatOptions::memory_bytes`]); what does not fit goes to a temporary file.
//!
//! Sources: "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (Kerbl et al., 2023) and its PLY files;
//! PlayCanvas, splat-transform and the SOG format; Niantic, the SPZ format; Kellogg, GaussianSplats3D; Kwok, splat;
//! Khronos, `KHR_gaussian_splatting`.

mod columns;
pub mod ellipsoid;
mod gate;
mod gltf;
mod ksplat;
mod ply;
pub mod raster;
mod recognise;
mod sog;
mod splat;
mod spz;
mod store;
mod zip;

use slicewalk_base::bytes::{ByteSource, open_named};
use slicewalk_base::{Error, Monitor, Parameter, Result};
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use gate::{BATCH_SPLATS, SplatSummary};
pub use recognise::{format_of, recognise};

/// One Gaussian: an ellipsoid with opacity, in the file's own axes and units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Centre.
    pub mean: [f64; 3],
    /// Standard deviations along its axes, not logarithms; at least 0.
    pub scale: [f32; 3],
    /// Unit quaternion w, x, y, z: turns the axes of the ellipsoid into those of the file.
    pub rotation: [f32; 4],
    /// Opacity at the centre (0..=1).
    pub opacity: f32,
    /// sRGB base colour.
    pub colour: [u8; 3],
}

/// Format of a file of splats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SplatFormat {
    /// PLY with one property per parameter, as training programs write it.
    Ply,
    /// PLY of PlayCanvas with packed vertices.
    CompressedPly,
    /// SPZ of Niantic.
    Spz,
    /// SOG of PlayCanvas in one zip file.
    Sog,
    /// SOG as a folder, by its `meta.json`.
    SogFolder,
    /// Levels of detail of SOG, by their `lod-meta.json`.
    SogLevels,
    /// Rows of 32 bytes, without a header.
    Splat,
    /// `.ksplat` of GaussianSplats3D.
    Ksplat,
    /// glTF or GLB with `KHR_gaussian_splatting`.
    Gltf,
}

/// Options of a reader.
#[derive(Debug, Clone)]
pub struct SplatOptions {
    /// Reads the valid splats of a truncated or damaged file instead of refusing the file.
    pub allow_incomplete: bool,
    /// Folder for temporary data.
    pub temp_dir: PathBuf,
    /// Memory for reading (bytes); less than 16 MiB counts as 16 MiB.
    ///
    /// PLY, `.splat`, `.ksplat`, SPZ and the values of glTF need less than that for any number of splats; gzipped SPZ
    /// beyond half of it goes to a temporary file (20 bytes a splat). SOG decodes whole images, of at most 8 bytes a pixel.
    /// Images, texts of glTF and levels of SOG beyond it are refused, and so are texts with a structure (what they have
    /// outside of strings) beyond an eighth of it.
    pub memory_bytes: u64,
}

impl Default for SplatOptions {
    fn default() -> Self {
        Self { allow_incomplete: false, temp_dir: slicewalk_base::disk::temp_dir(), memory_bytes: 64 << 20 }
    }
}

impl SplatOptions {
    fn memory(&self) -> u64 {
        self.memory_bytes.max(16 << 20)
    }
}

/// Body of a file whose header was read.
trait Body: Send {
    /// Number of splats that the file states, or that its length gives.
    fn count(&self) -> u64;

    /// Returns which coordinates are floats of 32 bits in the file, which nothing in it moves.
    fn are_singles(&self) -> [bool; 3] {
        [false; 3]
    }

    /// Passes every splat to `gate`.
    fn read(&mut self, work: &Work<'_>, gate: &mut gate::Gate<'_>) -> Result<()>;
}

/// State shared by all readers during a pass.
struct Work<'a> {
    path: &'a Path,
    options: &'a SplatOptions,
    /// At most so much is held (bytes).
    memory: u64,
    monitor: &'a dyn Monitor,
}

/// Reader of one file, folder or set of levels.
pub struct SplatReader {
    path: PathBuf,
    options: SplatOptions,
    format: SplatFormat,
    body: Box<dyn Body>,
}

/// Bytes at the start of a file that [`recognise`] needs to see: the longest header of a PLY that any program writes.
/// Only the structure of a glTF may be longer: [`format_of`] sees it all.
pub const HEAD_BYTES: usize = 64 << 10;

impl SplatReader {
    /// Opens the file or SOG folder at `path` and checks its header.
    pub fn open(path: impl AsRef<Path>, options: &SplatOptions) -> Result<Self> {
        let path = path.as_ref();
        if std::fs::metadata(path).is_ok_and(|about| about.is_dir()) {
            let inner = ["lod-meta.json", "meta.json"].map(|name| path.join(name)).into_iter().find(|p| p.is_file());
            let inner = inner.ok_or_else(|| {
                Error::input(path, "folder", "expected a SOG folder with meta.json or lod-meta.json; name a file in it")
            })?;
            return Self::open(inner, options);
        }
        Self::of_source(open_named(path)?.into(), path, options)
    }

    /// Opens `source`, which `path` names: the name decides where the content does not, and files beside it may be read.
    pub fn of_source(source: Arc<dyn ByteSource>, path: impl AsRef<Path>, options: &SplatOptions) -> Result<Self> {
        let path = path.as_ref();
        if source.is_empty() {
            return Err(Error::input(path, "byte 0", "the file is empty; fetch or write it again"));
        }
        let format = format_of(&*source, path)?.ok_or_else(|| {
            Error::input(
                path,
                "byte 0",
                "expected Gaussian splats (PLY, SPZ, SOG, .splat, .ksplat or glTF with KHR_gaussian_splatting), found \
                 another format",
            )
        })?;
        let memory = options.memory();
        let body: Box<dyn Body> = match format {
            SplatFormat::Ply => Box::new(ply::Rows::open(source, path)?),
            SplatFormat::CompressedPly => Box::new(ply::Packed::open(source, path)?),
            SplatFormat::Spz => Box::new(spz::Spz::open(source, path)?),
            SplatFormat::Sog => Box::new(sog::Sog::open_zip(source, path)?),
            SplatFormat::SogFolder => Box::new(sog::Sog::open_folder(source, path, memory)?),
            SplatFormat::SogLevels => Box::new(sog::Levels::open(source, path, memory)?),
            SplatFormat::Splat => Box::new(splat::Splats::open(source, path, options.allow_incomplete)?),
            SplatFormat::Ksplat => Box::new(ksplat::Ksplat::open(source, path)?),
            SplatFormat::Gltf => Box::new(gltf::Gltf::open(source, path, memory)?),
        };
        Ok(Self { path: path.to_path_buf(), options: options.clone(), format, body })
    }

    /// Returns the number of splats that the file states, or that its length gives. Damaged files may hold fewer.
    pub fn count(&self) -> u64 {
        self.body.count()
    }

    /// Returns the format.
    pub fn format(&self) -> SplatFormat {
        self.format
    }

    /// Passes all splats to `sink`, in the order of the file, in batches of at most [`BATCH_SPLATS`]; may be called more
    /// than once. Calls `monitor.advance` with the number of splats.
    ///
    /// Fails if splats are missing or unusable, unless [`SplatOptions::allow_incomplete`] is set: then the summary counts
    /// them, and `monitor` is warned.
    pub fn for_each_batch(
        &mut self,
        monitor: &dyn Monitor,
        sink: &mut dyn FnMut(&[Splat]) -> Result<()>,
    ) -> Result<SplatSummary> {
        let work = Work { path: &self.path, options: &self.options, memory: self.options.memory(), monitor };
        let mut gate = gate::Gate::new(&work, self.body.count(), self.body.are_singles(), sink);
        self.body.read(&work, &mut gate)?;
        gate.finish()
    }
}

/// Returns an error about the file.
fn refuse(path: &Path, at: impl Into<String>, reason: impl Into<String>) -> Error {
    Error::input(path, at, reason)
}

/// Returns whether all bytes of `rest` are such.
fn is_all(mut rest: columns::Column, is_such: impl Fn(&u8) -> bool, work: &Work<'_>) -> Result<bool> {
    loop {
        if work.monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let block = rest.fill_buf().map_err(|e| columns::read_error(work.path, "behind the splats", e))?;
        if block.is_empty() {
            return Ok(true);
        }
        if !block.iter().all(&is_such) {
            return Ok(false);
        }
        let len = block.len();
        rest.consume(len);
    }
}

/// Error for an image or text that needs more memory than allowed.
fn too_large(path: &Path, what: &str, needed: u64, memory: u64) -> Error {
    let [needed, memory] = [needed, memory].map(slicewalk_base::text::memory_size);
    Error::limit(format!("{}: memory for {what}", path.display()), needed, memory).with_suggestion(Parameter::Memory)
}
