//! Scenes with known truth, scanned and converted like a user would.

use nalgebra::{Point2, Point3};
use scangen::geometry::Placement;
use scangen::sample::{Mode, Order};
use scangen::scene::build::{Builder, Wall};
use scangen::{SampleSpec, Scene, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PageKey};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::store::Snapshot;
use slicewalk::walk::{Body, Config, State, StepReport, Walker, Waypoints};
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_input::Units;

pub const T: f64 = 0.05;
pub const BOX: Body = Body::Box { x: 0.5, y: 0.5, height: 1.8 };
pub const CYLINDER: Body = Body::Cylinder { radius: 0.25, height: 1.8 };

/// Points along a side of a pixel.
const PER_PIXEL: f64 = 3.0;

/// The scene, scanned evenly with `noise` (m) and converted at pixels of `T`.
pub fn convert_scene(scene: &Scene, noise: f64) -> (tempfile::TempDir, Archive) {
    convert_at(scene, noise, (PER_PIXEL / T).powi(2))
}

/// Like [`convert_scene`], with this many points per square metre.
pub fn convert_at(scene: &Scene, noise: f64, density: f64) -> (tempfile::TempDir, Archive) {
    let dir = tempfile::tempdir().unwrap();
    let scan = dir.path().join("scan.las");
    let spec = SampleSpec { mode: Mode::Direct(Order::Grid), ..SampleSpec::direct_density(density) };
    let samples = scene.samples(11, &spec.with_noise(noise)).unwrap();
    // The points' millimetre grid is the same wherever the scene is.
    let offset = scene.bounds().min.map(|v| v.div_euclid(1000.0) * 1000.0);
    write_samples(&scan, samples, &WriteSpec { offset, ..WriteSpec::for_path(&scan) }).unwrap();
    let mut options = ConvertOptions::new(vec![scan], dir.path().join("scene.slices"));
    options.grid.pixel = PixelSize::Metres(T);
    options.reading.units = Units::Factor(1.0);
    options.resources.threads = 1;
    options.resources.temp_dir = dir.path().to_path_buf();
    convert(&options, &NoMonitor).unwrap();
    let archive = Archive::open(dir.path().join("scene.slices")).unwrap();
    (dir, archive)
}

/// The scene's pages, all in memory.
pub fn world(scene: &Scene, noise: f64) -> Snapshot {
    let (_dir, archive) = convert_scene(scene, noise);
    Snapshot::resident(&archive, &NoMonitor).unwrap()
}

/// A level floor of `tiles` by `tiles` tiles of 3.2 m around the origin, with walls of 3 m in the pixels that `is_wall`
/// selects.
pub fn room(tiles: i64, is_wall: impl Fn((i64, i64)) -> bool) -> Snapshot {
    let span = |bottom, top, obstacle| Span::new(bottom, top, obstacle).unwrap();
    let page = |tx: i64, ty: i64| {
        let mut builder = PageBuilder::default();
        for (px, py) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
            let wall = is_wall((tx * 64 + i64::from(px), ty * 64 + i64::from(py)));
            let matter = if wall { [span(0, 5000, true)] } else { [span(0, 10, false)] };
            assert!(builder.set_column(px, py, &matter));
        }
        (PageKey { tx: tx as i32, ty: ty as i32, layer: 0 }, builder.build())
    };
    let row = |ty: i64| (-tiles / 2..tiles - tiles / 2).map(move |tx| (tx, ty));
    let places = (-tiles / 2..tiles - tiles / 2).flat_map(row);
    Snapshot::from_pages(Frame::new(T, 0.15).unwrap(), places.map(|(tx, ty)| page(tx, ty)).collect::<Vec<_>>())
}

/// A scene of the surfaces that `build` adds.
pub fn scene(build: impl FnOnce(&mut Builder)) -> Scene {
    let mut builder = Builder::new();
    build(&mut builder);
    builder.finish("test")
}

/// A wall of two faces, from the floor up to 3 m, with openings `[along0, z0, along1, z1]`.
pub fn wall(b: &mut Builder, from: [f64; 2], to: [f64; 2], openings: &[[f64; 4]]) {
    b.wall(Wall { from, to, thickness: 0.1, z: [0.0, 3.0] }, openings);
}

pub fn turned(scene: &Scene, rotate_deg: f64, translate: [f64; 3]) -> Scene {
    scene.placed(&Placement { rotate_deg, translate })
}

pub fn config(body: Body) -> Config {
    Config::new(body)
}

pub fn route(places: &[[f64; 2]]) -> Waypoints {
    Waypoints::new(places.iter().map(|place| Point2::from(*place)).collect()).unwrap()
}

/// A walk: the pawn's position after every frame.
pub struct Trace {
    pub path: Vec<Point3<f64>>,
    pub reports: Vec<StepReport>,
    pub walker: Walker,
}

impl Trace {
    pub fn end(&self) -> Point3<f64> {
        self.walker.feet()
    }

    pub fn state(&self) -> State {
        self.walker.state()
    }

    pub fn arrived(&self) -> bool {
        self.state() == State::Arrived
    }
}

/// Follows `places` until the pawn arrives, is blocked for a second, or `seconds` have passed.
pub fn walk(set: &Snapshot, config: Config, start: [f64; 3], places: &[[f64; 2]], hz: f64, seconds: f64) -> Trace {
    let mut walker = Walker::new(config, start.into()).unwrap();
    let mut way = route(places);
    let (mut path, mut reports, mut blocked) = (Vec::new(), Vec::new(), 0.0);
    while (path.len() as f64) < seconds * hz && blocked < 1.0 {
        let report = walker.follow(set, 1.0 / hz, &mut way);
        assert!(!report.waits(), "all pages are in memory");
        path.push(walker.feet());
        reports.push(report);
        blocked = if report.state == State::Blocked { blocked + 1.0 / hz } else { 0.0 };
        if report.state == State::Arrived {
            break;
        }
    }
    Trace { path, reports, walker }
}
