//! The real scan at one pixel size, and where a pawn asks in it.

use crate::Random;
use crate::stability::{Error, Result};
use nalgebra::{Point2, Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::query::{Aabb, Ray};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, Walker, Waypoints};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::path::{Path, PathBuf};

/// Width, depth and height of the pawn (m): it fits under the flights of the scan's stairs.
pub const PAWN: [f64; 3] = [0.5, 0.5, 1.6];
/// A cylinder as wide and high.
pub const ROUND: Body = Body::Cylinder { radius: PAWN[0] / 2.0, height: PAWN[2] };
/// Where the walk begins, and how far above the floor a pawn asks (m).
pub const START: [f64; 3] = [-5.0, -3.0, -1.2];
const LIFT: f64 = 0.03;

/// The scan, if it is there.
pub fn scan() -> Option<PathBuf> {
    crate::data::file("indoor_two_storey_zup.laz")
}

pub fn points(scan: &Path) -> Result<Vec<Point3<f64>>> {
    let mut reader = las::Reader::from_path(scan)?;
    let data = reader.read_all()?;
    let points: std::result::Result<Vec<_>, _> = data.points().map(|p| p.map(|p| Point3::new(p.x, p.y, p.z))).collect();
    Ok(points?)
}

pub fn store(scan: &Path, pixel_m: f64) -> Result<Snapshot> {
    let folder = tempfile::tempdir()?;
    let mut options = ConvertOptions::new(vec![scan.to_path_buf()], folder.path().join("scan.slices"));
    options.grid.pixel = PixelSize::Metres(pixel_m);
    convert(&options, &NoMonitor)?;
    Ok(Snapshot::resident(&Archive::open(folder.path().join("scan.slices"))?, &NoMonitor)?)
}

/// The way up the stairs and back that `docs/walk-and-routes.md` follows.
pub fn route() -> Result<Vec<Point2<f64>>> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/route-indoor.csv"))?;
    let place = |line: &str| {
        let (x, y) = line.split_once(',')?;
        Some(Point2::new(x.trim().parse().ok()?, y.trim().parse().ok()?))
    };
    Ok(text.lines().filter_map(place).collect())
}

/// Pawns, sweeps and rays.
pub struct Workload {
    /// At random places of the scan's bounds.
    pub random: Vec<Aabb>,
    /// Along a walk, at 600 frames a second, just above the floor.
    pub walk: Vec<Aabb>,
    /// From places of the walk 0.1 m in any direction across.
    pub sweeps: Vec<(Aabb, Vector3<f64>)>,
    /// From the pawn's eyes through a point of the scan, and on; with the distance of that point (m).
    pub rays: Vec<(Ray, f64)>,
}

impl Workload {
    pub fn new(points: &[Point3<f64>], store: &Snapshot) -> Result<Self> {
        let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        let mut random = Random(21);
        let pawn = |feet| Aabb::standing(feet, Vector3::from(PAWN));
        let anywhere = (0..10_000).map(|_| {
            let mut at = |axis: usize, less: f64| random.between(low[axis], high[axis] - less);
            pawn(Point3::new(at(0, 0.0), at(1, 0.0), at(2, PAWN[2])))
        });
        let anywhere: Vec<_> = anywhere.collect::<std::result::Result<_, _>>()?;
        let config = Config { tick_s: 1.0 / 600.0, ..Config::new(ROUND) };
        let (mut walker, mut route) = (Walker::new(config, START.into())?, Waypoints::new(route()?)?);
        let mut walk = Vec::new();
        while walker.state() != State::Arrived && walk.len() < 60_000 {
            walker.follow(store, 1.0 / 600.0, &mut route);
            walk.push(pawn(walker.feet() + Vector3::new(0.0, 0.0, LIFT))?);
        }
        if walker.state() != State::Arrived {
            return Err(format!("the walk ends at {}", walker.feet()).into());
        }
        let sweeps = (0..10_000).map(|_| {
            let from = walk[random.bits() as usize % walk.len()];
            let angle = random.between(0.0, std::f64::consts::TAU);
            (from, Vector3::new(angle.cos(), angle.sin(), 0.0) * 0.1)
        });
        let sweeps = sweeps.collect();
        let rays = (0..5_000).map(|_| {
            let from = walk[random.bits() as usize % walk.len()];
            let eyes = from.min() + Vector3::new(0.25, 0.25, 1.5);
            let to = points[random.bits() as usize % points.len()];
            Ok((Ray::new(eyes, to - eyes, 10.0)?, (to - eyes).norm()))
        });
        let rays: std::result::Result<Vec<_>, Error> = rays.collect();
        Ok(Self { random: anywhere, walk: walk.clone(), sweeps, rays: rays? })
    }
}
