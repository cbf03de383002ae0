//! Solid cubes: readers of OctoMap trees (`.bt`, `.ot`) and of voxel octrees of splat viewers (`.voxel.json`), and a
//! writer of OctoMap trees ([`OctomapTree`]).
//!
//! In: a file of any size. Out: batches of [`Cube`]s with z up, as whole numbers of the file's resolution. Free leaves
//! of OctoMap are skipped. The bytes are untrusted: a damaged file gives a one-line [`Error::Input`], every node is
//! visited once, and no number in the file sizes an allocation. Memory: 64 KiB for each level of a tree, and at
//! most 2 MiB.
//!
//! Sources: OctoMap 1.9, `writeBinary` of `OccupancyOcTreeBase` and `writeData` of `OcTreeBaseImpl`; PlayCanvas, page
//! "Voxel format" of the user manual of splat-transform, version 1.1.

mod free_cubes;
mod octomap;
mod octomap_tree;
mod recognise;
mod span_cubes;
#[cfg(test)]
mod tests;
mod voxel;
mod window;

use slicewalk_base::bytes::{ByteSource, open_named};
use slicewalk_base::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use free_cubes::FreeCubes;
pub use octomap_tree::{Octomap, OctomapTree};
pub use recognise::{CubeFormat, recognise};
pub use span_cubes::SpanCubes;

/// Most cubes in a batch.
pub const BATCH_CUBES: usize = 1 << 12;
/// Bytes at the start of a file that [`recognise`] needs to see.
pub const HEAD_BYTES: usize = 1 << 8;

/// A solid cube: `corner[a]..corner[a] + edge` along each axis, in cubes of the file's resolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cube {
    /// Lowest corner.
    pub corner: [i64; 3],
    /// Edge, at least 1.
    pub edge: i64,
}

/// The cubes of a file, one after another.
trait Body: Send {
    /// Returns the next solid cube, or `None` after the last one, when all counts of the file are checked.
    fn next(&mut self) -> Result<Option<Cube>>;
}

/// Reader of one file.
pub struct CubeReader {
    size: f64,
    origin: [f64; 3],
    body: Box<dyn Body>,
}

impl CubeReader {
    /// Opens the file at `path` and checks its header.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::of_source(open_named(path)?.into(), path)
    }

    /// Opens `source`, which `path` names: a voxel octree's second file lies beside it.
    pub fn of_source(source: Arc<dyn ByteSource>, path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut head = vec![0; source.len().min(HEAD_BYTES as u64) as usize];
        source.read_at(0, &mut head)?;
        match recognise(&head, path) {
            Some(CubeFormat::OctomapBinary | CubeFormat::Octomap) => octomap::open(source, path),
            Some(CubeFormat::Voxel) => voxel::open(source, path),
            None => Err(refuse(
                path,
                "byte 0",
                "expected an OctoMap tree (\"# Octomap OcTree\") or a .voxel.json, found another format",
            )),
        }
    }

    /// Returns the edge of a cube of the finest level, in units of the file.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Returns the place of the corner of cube (0, 0, 0), in units of the file: the origin, unless the file's grid is
    /// not anchored there.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Puts the next cubes, at most [`BATCH_CUBES`], into `batch` in place of its contents; returns false after the last.
    pub fn next_batch(&mut self, batch: &mut Vec<Cube>) -> Result<bool> {
        batch.clear();
        while batch.len() < BATCH_CUBES {
            match self.body.next()? {
                Some(cube) => batch.push(cube),
                None => break,
            }
        }
        Ok(!batch.is_empty())
    }
}

/// Returns the file that belongs to the voxel header at `header`: the same name with `.bin` in place of `.json`.
pub fn binary_of(header: &Path) -> Option<PathBuf> {
    let name = header.file_name()?.to_str()?;
    let stem = name.get(..name.len().checked_sub(".json".len())?)?;
    let is_voxel = name.to_ascii_lowercase().ends_with(".voxel.json");
    is_voxel.then(|| header.with_file_name(format!("{stem}.bin")))
}

/// Makes an error about the file.
fn refuse(path: &Path, at: impl Into<String>, reason: impl Into<String>) -> Error {
    Error::input(path, at, reason)
}
