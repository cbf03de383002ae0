//! Mesh files to triangles in metres, z up.

mod blocks;
mod gltf;
mod obj;
mod ply;
mod polygon;
mod stl;
mod text;
mod vertices;

use super::Triangle;
use crate::input::Units;
use crate::input::scenes::Scene;
use crate::plan::Up;
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Result};
use std::path::{Path, PathBuf};

/// Greatest coordinate that is kept, in magnitude (m); as for scans.
const FARTHEST_M: f64 = 1e12;

/// What to read and how.
#[derive(Debug, Clone)]
pub struct MeshOptions {
    /// Length of a file unit. Metres for [`Units::Auto`]: of the formats only glTF states one, and that is the metre.
    pub units: Units,
    /// Which axis of the files points up. glTF states that itself, y, and is always turned.
    pub up: Up,
    /// What a reader may hold of one file (bytes).
    pub memory_bytes: u64,
    /// Folder for the corners that do not fit.
    pub temp_dir: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Obj,
    Ply,
    Stl,
    Gltf,
}

fn kind_of(path: &Path) -> Option<Kind> {
    Some(match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "obj" => Kind::Obj,
        "ply" => Kind::Ply,
        "stl" => Kind::Stl,
        "gltf" | "glb" => Kind::Gltf,
        _ => return None,
    })
}

/// Triangles of one file, in file coordinates.
trait Triangles: Send {
    /// Appends some triangles, at most as many as one face or a few hundred make; false when there are no more.
    fn read(&mut self, out: &mut Vec<Triangle>) -> Result<bool>;
}

/// Numbers of triangles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MeshCounts {
    /// Triangles read.
    pub read: u64,
    /// Of these, left out for having no area or coordinates that are not finite or beyond 10¹² m.
    pub left_out: u64,
}

impl std::ops::AddAssign for MeshCounts {
    fn add_assign(&mut self, other: Self) {
        self.read += other.read;
        self.left_out += other.left_out;
    }
}

/// Mesh files that were found to exist.
#[derive(Debug)]
pub struct MeshSet {
    files: Vec<(PathBuf, Kind, u64)>,
    options: MeshOptions,
}

impl MeshSet {
    /// The meshes at `paths`, all of them with names of meshes. Warns once where no unit is known.
    pub fn open(paths: &[PathBuf], options: MeshOptions, monitor: &dyn Monitor) -> Result<Self> {
        let mut files = Vec::with_capacity(paths.len());
        for path in paths {
            let about = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
            let kind = kind_of(path).ok_or_else(|| {
                Error::input(path, "name", "no mesh of a known format; expected .obj, .ply, .stl, .gltf or .glb")
            })?;
            files.push((path.clone(), kind, about.len()));
        }
        let mut unknown = files.iter().filter(|file| options.units == Units::Auto && file.1 != Kind::Gltf);
        if let Some(first) = unknown.next() {
            let others = match unknown.count() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            monitor.warn(&format!(
                "{}{others}: meshes of this format state no unit; metres are assumed, --units sets another",
                first.0.display()
            ));
        }
        Ok(Self { files, options })
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// Unit of the files, if there are any.
    pub fn length_unit(&self) -> Option<LengthUnit> {
        (!self.is_empty()).then_some(match self.options.units {
            Units::Auto => LengthUnit::METRE,
            Units::Factor(factor) => LengthUnit::of(factor),
        })
    }

    /// Length of all files (bytes): for progress only.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.2).fold(0, u64::saturating_add)
    }

    /// All triangles, from the first.
    pub fn feed(&self) -> MeshFeed<'_> {
        MeshFeed {
            set: self,
            next: 0,
            open: None,
            of_file: MeshCounts::default(),
            total: MeshCounts::default(),
            bounds: Vec::new(),
        }
    }

    /// Bounds of all usable triangles (m), which are read for this; `None` if there are none.
    pub fn bounds(&self, monitor: &dyn Monitor) -> Result<Option<Bounds>> {
        let (mut feed, mut batch) = (self.feed(), Vec::new());
        while feed.next(&mut batch, &crate::NoMonitor)? {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
        }
        let all = feed.bounds.iter().fold(NO_BOUNDS, |all, file| grown(grown(all, file.0), file.1));
        Ok((all.0[0] <= all.1[0]).then_some(all))
    }

    fn reader(&self, number: usize) -> Result<Box<dyn Triangles>> {
        let (path, kind, _) = &self.files[number];
        let options = &self.options;
        Ok(match kind {
            Kind::Obj => Box::new(obj::Reader::open(path, options)?),
            Kind::Ply => Box::new(ply::Reader::open(path, options)?),
            Kind::Stl => Box::new(stl::Reader::open(path)?),
            Kind::Gltf => Box::new(gltf::Reader::open(path, options)?),
        })
    }

    /// File coordinates to metres, z up.
    fn place(&self, number: usize, triangle: &mut Triangle) {
        let factor = match self.options.units {
            Units::Auto => 1.0,
            Units::Factor(factor) => factor,
        };
        let turned = self.options.up == Up::Y || self.files[number].1 == Kind::Gltf;
        for corner in triangle {
            let [x, y, z] = corner.map(|v| v * factor);
            *corner = if turned { [x, -z, y] } else { [x, y, z] };
        }
    }
}

/// Least and greatest corner (m).
type Bounds = ([f64; 3], [f64; 3]);

/// Bounds of nothing.
const NO_BOUNDS: Bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);

/// `bounds` around `corner` too.
fn grown((min, max): Bounds, corner: [f64; 3]) -> Bounds {
    ([0, 1, 2].map(|axis| min[axis].min(corner[axis])), [0, 1, 2].map(|axis| max[axis].max(corner[axis])))
}

/// Whether a triangle has an area and lies where triangles are kept.
fn usable(triangle: &Triangle) -> bool {
    let near = triangle.as_flattened().iter().all(|v| v.abs() <= FARTHEST_M);
    near && super::raster::has_area(triangle)
}

/// Hands out the triangles of a set, file after file.
pub struct MeshFeed<'a> {
    set: &'a MeshSet,
    /// Number of the file at hand.
    next: usize,
    open: Option<Box<dyn Triangles>>,
    of_file: MeshCounts,
    total: MeshCounts,
    /// Of the usable triangles of each file so far.
    bounds: Vec<Bounds>,
}

impl<'a> MeshFeed<'a> {
    /// Replaces `batch` by the next usable triangles (m, z up), maybe none; false after the last.
    ///
    /// At the end of each file a warning tells how many triangles were left out; a file without any usable one is an
    /// error: an empty archive in place of a good one helps nobody.
    pub fn next(&mut self, batch: &mut Vec<Triangle>, monitor: &dyn Monitor) -> Result<bool> {
        batch.clear();
        let more = self.read(batch, monitor);
        if more.is_err() {
            // What follows an error means nothing; other workers find the end.
            self.next = self.set.files.len();
        }
        more
    }

    fn read(&mut self, batch: &mut Vec<Triangle>, monitor: &dyn Monitor) -> Result<bool> {
        let Some((path, ..)) = self.set.files.get(self.next) else { return Ok(false) };
        let reader = match &mut self.open {
            Some(reader) => reader,
            closed => closed.insert(self.set.reader(self.next)?),
        };
        let more = reader.read(batch)?;
        let read = batch.len();
        batch.iter_mut().for_each(|triangle| self.set.place(self.next, triangle));
        batch.retain(usable);
        self.bounds.resize(self.next + 1, NO_BOUNDS);
        self.bounds[self.next] = batch.as_flattened().iter().fold(self.bounds[self.next], |all, &c| grown(all, c));
        self.of_file += MeshCounts { read: read as u64, left_out: (read - batch.len()) as u64 };
        if !more {
            let MeshCounts { read, left_out } = std::mem::take(&mut self.of_file);
            if read == left_out {
                let reason = if read == 0 {
                    "it holds no triangles; a cloud of points must come as LAS or LAZ".into()
                } else {
                    format!("none of its {read} triangles has an area and finite corners within 1e12 m; write it again")
                };
                return Err(Error::input(path, "triangles", reason));
            }
            if left_out > 0 {
                monitor.warn(&format!(
                    "{}: {left_out} of {read} triangles left out: they have no area, or a corner is not finite or beyond \
                     1e12 m",
                    path.display()
                ));
            }
            self.total += MeshCounts { read, left_out };
            self.open = None;
            self.next += 1;
        }
        Ok(true)
    }

    /// Files with the bounds of their usable triangles so far.
    pub(crate) fn scenes(&self) -> impl Iterator<Item = Scene<'a>> {
        let files = self.set.files.iter().zip(&self.bounds);
        files.map(|(file, &(min, max))| Scene { path: &file.0, min, max })
    }

    /// Triangles of the files that came to their end.
    pub fn counts(&self) -> MeshCounts {
        self.total
    }
}
