//! Subjects of the questions: the points of a scene, the file that holds them, and its true surfaces if known.

use crate::data;
use crate::peers::oracle::Oracle;
use crate::peers::spheres::Tree;
use crate::stability::Result;
use crate::thesis::models::{read_scan, triangles};
use nalgebra::{Point3, Vector3};
use scangen::scene::Surface;
use scangen::shape::{Polygon, Shape};
use scangen::{Params, SampleSpec, Scene, Truth, WriteSpec, write_las};
use slicewalk::plan::Up;
use slicewalk_input::Units;
use slicewalk_mesh::raster::has_area;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Noise of generated scans (m).
const NOISE_M: f64 = 0.002;
/// Width and depth of the pawn, and its height (m).
const WIDTH_M: f64 = 0.5;
const HEIGHT_M: f64 = 1.8;
/// Fits under the flights of the stairs of the scanned building (m).
const INDOOR_HEIGHT_M: f64 = 1.6;
/// Half the edge of the part of the largest scan that is used (m). All of it would take hours at the finest pixels.
const AUTZEN_HALF_M: f64 = 100.0;
/// Pixels of the ground whose number is a scene's area (m).
const GROUND_M: f64 = 0.32;

/// Names of all scenes, in the order in which they are measured.
pub const NAMES: [&str; 9] = ["house", "church", "street", "terrain", "indoor", "room", "delft", "sibenik", "autzen"];

/// A scene.
pub struct Subject {
    /// Its name.
    pub name: String,
    /// The points that every method is given (m).
    pub points: Vec<Point3<f64>>,
    /// File with these points, or with the triangles.
    pub file: PathBuf,
    /// Length of a unit of the file.
    pub units: Units,
    /// Which axis of the file points up.
    pub up: Up,
    /// The true surfaces, if they are known.
    pub scene: Option<Scene>,
    /// Per point its surface, in generated scans.
    pub surfaces: Vec<u32>,
    /// Triangles, if it is a mesh: then these are the truth, and the points stand for them.
    pub triangles: Vec<[[f64; 3]; 3]>,
    /// Size of the pawn (m).
    pub pawn: [f64; 3],
    /// Least and greatest coordinates (m).
    pub bounds: [Point3<f64>; 2],
    /// Whole metres near the middle: methods of single precision count from here.
    pub origin: Vector3<f64>,
    /// Brute force over the points.
    pub oracle: Oracle,
    /// All points, by nearness.
    pub tree: Tree,
    _folder: Option<TempDir>,
}

impl Subject {
    /// The scene of this name, of about `count` points if it is generated or thinned; `None` where its file is missing.
    pub fn named(name: &str, count: Option<usize>) -> Result<Option<Self>> {
        let scan = |file: &str, units| data::file(file).map(|path| Self::scan(name, &path, units, count)).transpose();
        Ok(Some(match name {
            "house" | "church" | "street" | "terrain" => {
                let params = match name {
                    "house" => Params::new().with("storeys", 2.0),
                    "terrain" => Params::new().with("size", 40.0).with("wave", 20.0).with("height", 2.0),
                    _ => Params::new(),
                };
                let scene = Scene::named(name, &params)?;
                Self::generated(scene, count.unwrap_or(1_000_000))?
            }
            "indoor" => return scan("indoor_two_storey_zup.laz", Units::Factor(1.0)),
            "room" => return scan("pump_room.laz", Units::Factor(1.0)),
            "delft" => return scan("delft_city_block_ahn3.laz", Units::Factor(1.0)),
            "autzen" => {
                let Some(path) = data::file("autzen_stadium.laz") else { return Ok(None) };
                let all = middle(read_scan(&path, Units::Factor(0.3048))?, AUTZEN_HALF_M);
                Self::written(name, thinned(all, count))?
            }
            "sibenik" => {
                let Some(path) = data::file("meshes/sibenik.obj") else { return Ok(None) };
                Self::mesh(name, path, count.unwrap_or(400_000))?
            }
            _ => return Err(format!("{name}: no such scene; there are {}", NAMES.join(", ")).into()),
        }))
    }

    /// A scan of surfaces that are known.
    pub fn generated(scene: Scene, count: usize) -> Result<Self> {
        let spec = SampleSpec::direct_count(count as u64).with_noise(NOISE_M);
        let samples: Vec<_> = scene.samples(17, &spec)?.collect();
        let surfaces = samples.iter().map(|sample| sample.surface).collect();
        let positions = samples.iter().map(|sample| sample.position).collect();
        let name = scene.name().to_owned();
        let subject = Self::written(&name, positions)?;
        Ok(Self { scene: Some(scene), surfaces, ..subject })
    }

    /// A scan of these points, written to a file in steps of 0.1 mm.
    pub fn written(name: &str, mut positions: Vec<[f64; 3]>) -> Result<Self> {
        let first = positions.first().ok_or("a scan without points")?;
        let spec = WriteSpec { scale: [1e-4; 3], offset: first.map(f64::floor), ..WriteSpec::default() };
        for p in &mut positions {
            *p = spec.rounded(*p).ok_or("a point does not fit a LAS file")?;
        }
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("scan.las");
        write_las(&file, positions.iter().copied(), &spec)?;
        Self::new(name, positions, file, Units::Factor(1.0), Some(folder))
    }

    fn scan(name: &str, path: &Path, units: Units, count: Option<usize>) -> Result<Self> {
        let all = read_scan(path, units)?;
        match count {
            Some(_) => Self::written(name, thinned(all, count)),
            None => Self::new(name, all, path.to_path_buf(), units, None),
        }
    }

    fn mesh(name: &str, file: PathBuf, count: usize) -> Result<Self> {
        let mut triangles = triangles(&file, true)?;
        triangles.retain(has_area);
        let surface =
            |t: &[[f64; 3]; 3]| Surface { shape: Shape::Polygon(Polygon::new(t.to_vec())), label: "triangle" };
        let scene = Scene::new(name, triangles.iter().map(surface).collect());
        let points = scene.points(17, &SampleSpec::direct_count(count as u64))?.collect();
        let subject = Self::new(name, points, file, Units::Factor(1.0), None)?;
        Ok(Self { scene: Some(scene), triangles, up: Up::Y, ..subject })
    }

    fn new(name: &str, positions: Vec<[f64; 3]>, file: PathBuf, units: Units, folder: Option<TempDir>) -> Result<Self> {
        let points: Vec<Point3<f64>> = positions.iter().map(|p| Point3::from(*p)).collect();
        let first = *points.first().ok_or("a scan without points")?;
        let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
        let size = high - low;
        // A few points to a cell, were they all on level ground.
        let edge = (size.x * size.y / points.len() as f64).sqrt().clamp(0.05, 1.0) * 2.0;
        let height = if name == "indoor" { INDOOR_HEIGHT_M } else { HEIGHT_M };
        Ok(Self {
            name: name.to_owned(),
            file,
            units,
            up: Up::Z,
            scene: None,
            surfaces: Vec::new(),
            triangles: Vec::new(),
            pawn: [WIDTH_M, WIDTH_M, height],
            bounds: [low, high],
            origin: nalgebra::center(&low, &high).coords.map(f64::floor),
            oracle: Oracle::with_cells(&points, edge),
            tree: Tree::new(positions)?,
            points,
            _folder: folder,
        })
    }

    /// Whether triangles are the truth.
    pub fn is_mesh(&self) -> bool {
        !self.triangles.is_empty()
    }

    /// Returns the distance from a place to the nearest solid (m).
    pub fn distance(&self, to: Point3<f64>) -> f64 {
        match &self.scene {
            Some(scene) if self.is_mesh() => scene.distance_to_point(to.into()),
            _ => self.tree.nearest(to.into()),
        }
    }

    /// Points less the origin.
    pub fn local(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        self.points.iter().map(|p| p - self.origin)
    }

    /// Number of cubes of this edge that hold points.
    pub fn cubes(&self, edge: f64) -> usize {
        self.local().map(|p| [0, 1, 2].map(|axis| (p[axis] / edge).floor() as i32)).collect::<HashSet<_>>().len()
    }

    /// Ground area of occupied pixels of 32 cm (m²).
    pub fn area(&self) -> f64 {
        let pixels = self.points.iter().map(|p| [p.x, p.y].map(|v| (v / GROUND_M).floor() as i64));
        pixels.collect::<HashSet<_>>().len() as f64 * GROUND_M * GROUND_M
    }
}

/// Every so manieth point, for about `count` of them.
fn thinned(all: Vec<[f64; 3]>, count: Option<usize>) -> Vec<[f64; 3]> {
    let step = count.map_or(1, |count| all.len() / count.max(1)).max(1);
    all.into_iter().step_by(step).collect()
}

/// The points at most `half` (m) from the middle of the bounds along x and y.
fn middle(mut all: Vec<[f64; 3]>, half: f64) -> Vec<[f64; 3]> {
    let middle = [0, 1].map(|axis| {
        let ends = [f64::INFINITY, f64::NEG_INFINITY];
        let [low, high] = all.iter().fold(ends, |[low, high], p| [low.min(p[axis]), high.max(p[axis])]);
        (low + high) / 2.0
    });
    all.retain(|p| (0..2).all(|axis| (p[axis] - middle[axis]).abs() <= half));
    all
}
