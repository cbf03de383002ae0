//! Scenes, questions about them, and the device of the tests.
#![allow(dead_code, reason = "each test file uses a part")]

#[path = "../../../../tests/common/data.rs"]
pub mod data;
#[path = "../../../../tests/common/random.rs"]
mod random;

pub use random::Random;

use scangen::{Params, SampleSpec, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey};
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::{Aabb, Cylinder, Ray, Sphere};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use slicewalk_gpu::{Below, Device, Error, Options};
use slicewalk_input::Units;
use std::collections::BTreeMap;
use std::path::Path;

/// Variable that chooses the adapter: `card` for a graphics card, `required` to fail without the software adapter.
const ADAPTER: &str = "SLICEWALK_GPU";

/// The device of the tests; `None`, with a line on standard error, if there is no adapter.
pub fn device() -> Option<Device> {
    device_with(None)
}

/// The device of the tests, with a limit of its buffers (bytes).
pub fn device_with(buffer_bytes: Option<u64>) -> Option<Device> {
    let wanted = std::env::var(ADAPTER).unwrap_or_default();
    match Device::open(&Options { software: wanted != "card", buffer_bytes }) {
        Ok(device) => Some(device),
        Err(error @ Error::NoAdapter { .. }) if wanted.is_empty() => {
            eprintln!("skipped: {error}");
            None
        }
        Err(error) => panic!("{ADAPTER}={wanted}: {error}"),
    }
}

/// A scene with the name that messages use.
pub struct Scene {
    pub name: String,
    pub pages: Snapshot,
}

/// Converts a scan; `pixel` in metres.
pub fn converted(name: &str, scan: &Path, pixel: f64) -> Scene {
    let pages = Snapshot::resident(&archive(scan, pixel), &NoMonitor).unwrap();
    Scene { name: name.to_owned(), pages }
}

/// The archive of a scan, in memory.
fn archive(scan: &Path, pixel: f64) -> Archive {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("scan.slices");
    let mut options = ConvertOptions::new(vec![scan.to_owned()], output.clone());
    options.grid.pixel = PixelSize::Metres(pixel);
    options.reading.units = Units::Factor(1.0);
    options.resources.temp_dir = folder.path().to_owned();
    convert(&options, &NoMonitor).unwrap();
    Archive::from_bytes(std::fs::read(output).unwrap()).unwrap()
}

/// A scan of a generated scene.
pub fn generated(name: &str, points: u64, pixel: f64) -> Scene {
    let pages = Snapshot::resident(&generated_archive(name, points, pixel), &NoMonitor).unwrap();
    Scene { name: name.to_owned(), pages }
}

/// The archive of a scan of a generated scene.
pub fn generated_archive(name: &str, points: u64, pixel: f64) -> Archive {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    let scene = scangen::Scene::named(name, &Params::new()).unwrap();
    let samples = scene.samples(1, &SampleSpec::direct_count(points).with_noise(0.003)).unwrap();
    write_samples(&scan, samples, &WriteSpec::for_path(&scan)).unwrap();
    archive(&scan, pixel)
}

/// Random spans in the pixels around a corner of eight pages near `distance` from the origin (m): many end at slice and
/// page boundaries.
pub fn random_pages(seed: u64, distance: f64) -> Scene {
    let mut random = Random(seed);
    let pixel = [0.02, 0.05, 0.3][random.below(3)];
    let frame = Frame::new(pixel, [3.0 * pixel, 0.7 * pixel, 40.0 * pixel][random.below(3)]).unwrap();
    let corner = [distance, -distance].map(|at| (at / (64.0 * pixel)).round() as i32);
    let layer = (distance / 1e4 / (64.0 * frame.slice_m())).round() as i32;
    let mut columns: BTreeMap<PageKey, BTreeMap<(u32, u32), Vec<Span>>> = BTreeMap::new();
    let radius = 4 + random.below(30);
    for _ in 0..[20, 300, 3000][random.below(3)] {
        let [i, j] = [0, 1].map(|_| random.below(2 * radius) - radius);
        // One span for each slice, so that they stay apart.
        let slice = random.below(16) - 8;
        let (bottom, top) = match random.below(4) {
            0 => (0, random.below(255)),
            1 => (random.below(255), 255),
            2 => (0, 255),
            _ => {
                let bottom = random.below(250);
                (bottom, bottom + random.below(5))
            }
        };
        let base = (slice & 63) as u32 * 255;
        let key = PageKey { tx: corner[0] + (i >> 6), ty: corner[1] + (j >> 6), layer: layer + (slice >> 6) };
        let spans = columns.entry(key).or_default().entry(((i & 63) as u32, (j & 63) as u32)).or_default();
        spans.extend(Span::new(base + bottom, base + top, random.chance(40)));
    }
    let pages = columns.into_iter().map(|(key, columns)| {
        let mut builder = PageBuilder::default();
        for ((x, y), mut spans) in columns {
            spans.sort_by_key(|span| (span.bottom(), span.top()));
            let mut apart: Vec<Span> = Vec::new();
            for span in spans {
                if apart.last().is_none_or(|last| last.lies_below(span)) {
                    apart.push(span);
                }
            }
            assert!(builder.set_column(x, y, &apart));
        }
        (key, builder.build())
    });
    Scene { name: format!("random pages {seed} at {distance} m"), pages: Snapshot::from_pages(frame, pages) }
}

/// The scene with about a third of its pages not in memory.
pub fn partly_loaded(scene: &Scene, seed: u64) -> Scene {
    let mut random = Random(seed);
    let pages = scene.pages.keep_loaded(|_| !random.chance(33));
    Scene { name: format!("{}, partly loaded", scene.name), pages }
}

/// A generator of questions about a scene: most lie near solid, some on the grid's edges, some reach far.
pub struct Asker<'a> {
    pages: &'a Snapshot,
    random: Random,
    corner: [f64; 3],
    size: [f64; 3],
}

impl<'a> Asker<'a> {
    pub fn new(pages: &'a Snapshot, seed: u64) -> Self {
        let frame = pages.frame();
        let bounds = pages.bounds().unwrap();
        let unit = [64.0 * frame.pixel_m(), 64.0 * frame.pixel_m(), 64.0 * frame.slice_m()];
        let corner = [0, 1, 2].map(|axis| f64::from(bounds.min[axis]) * unit[axis]);
        let size = [0, 1, 2].map(|axis| (f64::from(bounds.max[axis] - bounds.min[axis]) + 1.0) * unit[axis]);
        Self { pages, random: Random(seed), corner, size }
    }

    /// A pixel and a height of solid, if a few tries find one.
    fn solid(&mut self) -> Option<[f64; 3]> {
        let frame = *self.pages.frame();
        for _ in 0..8 {
            let (tx, ty, slots) = self.pages.column_at(self.random.below(self.pages.column_count()));
            let slot = &slots[self.random.below(slots.len())];
            let Some(page) = slot.page() else { continue };
            // From a random pixel on, the first that is occupied.
            let begin = self.random.below(4096u32);
            let pixel = (0..4096).map(|n| (begin + n) & 4095).find(|n| !page.column(n & 63, n >> 6).is_empty())?;
            let (x, y) = (pixel & 63, pixel >> 6);
            let spans = page.column(x, y);
            let span = spans[self.random.below(spans.len())];
            let quantum =
                i64::from(slot.layer()) * PAGE_QUANTA + i64::from([span.bottom(), span.top()][self.random.below(2)]);
            let at = |tile: i32, pixel: u32| (f64::from(tile) * 64.0 + f64::from(pixel)) * frame.pixel_m();
            return Some([at(tx, x), at(ty, y), quantum as f64 * frame.quantum_m()]);
        }
        None
    }

    /// A place near solid, or anywhere in the scene and around it.
    pub fn place(&mut self) -> Point3<f64> {
        let frame = *self.pages.frame();
        let unit = [frame.pixel_m(), frame.pixel_m(), frame.quantum_m()];
        match self.solid() {
            Some(solid) if self.random.chance(80) => {
                let exact = self.random.chance(25);
                let spread = 10f64.powf(self.random.between(-1.0, 1.3));
                let at = [0, 1, 2].map(|axis| {
                    let away = self.random.between(-spread, spread);
                    solid[axis] + if exact { away.round() } else { away } * unit[axis]
                });
                at.into()
            }
            _ => {
                let at = [0, 1, 2].map(|axis| self.corner[axis] + self.random.between(-0.1, 1.1) * self.size[axis]);
                at.into()
            }
        }
    }

    /// A length of up to a few dozen pixels; sometimes none, sometimes a whole number of pixels.
    fn length(&mut self) -> f64 {
        let pixel = self.pages.frame().pixel_m();
        let length = 10f64.powf(self.random.between(-1.5, 1.6));
        match self.random.below(10) {
            0 => 0.0,
            1 => length.round() * pixel,
            _ => length * pixel,
        }
    }

    pub fn shape(&mut self) -> Aabb {
        let centre = self.place();
        let half = Vector3::new(self.length(), self.length(), self.length());
        let (mut low, mut high) = (centre - half, centre + half);
        if self.random.chance(2) {
            low[self.random.below(3)] = f64::NEG_INFINITY;
        }
        if self.random.chance(2) {
            high[self.random.below(3)] = f64::INFINITY;
        }
        Aabb::new(low, high).unwrap()
    }

    pub fn cylinder(&mut self) -> Cylinder {
        Cylinder::new(self.place(), self.length(), self.length()).unwrap()
    }

    pub fn sphere(&mut self) -> Sphere {
        Sphere::new(self.place(), self.length()).unwrap()
    }

    pub fn below(&mut self) -> Below {
        let shape = self.shape();
        let from = match self.random.below(20) {
            0 => f64::INFINITY,
            1 => f64::NAN,
            _ => self.place().z,
        };
        let depth = if self.random.chance(30) { f64::INFINITY } else { self.length() * 10.0 };
        Below { shape, from, depth }
    }

    pub fn ray(&mut self) -> Ray {
        let origin = self.place();
        let way = match self.random.below(8) {
            0 => {
                let mut way = Vector3::zeros();
                way[self.random.below(3)] = [-1.0, 1.0][self.random.below(2)];
                way
            }
            1 => self.place() - origin + Vector3::new(1e-9, 0.0, 0.0),
            _ => Vector3::from_fn(|_, _| self.random.between(-1.0, 1.0)),
        };
        let pixel = self.pages.frame().pixel_m();
        let max = match self.random.below(4) {
            0 => f64::INFINITY,
            1 => self.length(),
            _ => 400.0 * pixel,
        };
        Ray::new(origin, way, max).unwrap()
    }
}
