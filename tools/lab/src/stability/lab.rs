//! The bench under every sweep: points become a LAS file, the file an archive, the archive answers, by the same public
//! functions that a user calls. The thesis' rule as written answers the same questions from the points themselves.

use super::Result;
use super::written::Written;
use nalgebra::Point3;
use scangen::{Kind, Sample, WriteSpec, write_samples};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use slicewalk::plan::{Classifier, PlanOptions};
use slicewalk::query::{Aabb, Answer, Overlap, floor_under, overlaps, probe};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::path::PathBuf;
use tempfile::TempDir;

/// A point (m).
pub type Vec3 = [f64; 3];

/// Rule that distinguishes obstacles from floors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// The thesis' algorithm 3.3 to the letter.
    Written,
    /// The thesis' rule over all points of a voxel instead of the last one: `--classifier thesis`.
    OrderFree,
    /// Extent of vertical runs: `--classifier span`.
    Span,
    /// Slicewalk's default: `--classifier plane`.
    Plane,
}

impl Method {
    /// All methods, in the order of tables.
    pub const ALL: [Self; 4] = [Self::Written, Self::OrderFree, Self::Span, Self::Plane];

    /// Name in tables and plots.
    pub fn name(self) -> &'static str {
        match self {
            Self::Written => "thesis as written",
            Self::OrderFree => "thesis order-free",
            Self::Span => "span",
            Self::Plane => "plane",
        }
    }
}

/// Grid and options of one conversion; slices are three pixels high.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// Pixel size (m).
    pub pixel_m: f64,
    /// Slope limit (degrees).
    pub limit_deg: f64,
    /// Voxels with fewer points are dropped.
    pub min_points: u32,
    /// Connected solid of at most this many voxels is dropped.
    pub drop_floaters: u16,
}

impl Setting {
    /// Pixels of `pixel_m`, a limit of 45 degrees, every point counts.
    pub fn new(pixel_m: f64) -> Self {
        Self { pixel_m, limit_deg: 45.0, min_points: 1, drop_floaters: 0 }
    }

    /// Returns the setting with another limit (degrees).
    pub fn limit(self, limit_deg: f64) -> Self {
        Self { limit_deg, ..self }
    }

    /// Slice height (m).
    pub fn slice_m(&self) -> f64 {
        3.0 * self.pixel_m
    }
}

/// Points as a LAS file holds them.
pub struct Scan {
    folder: TempDir,
    /// The points, as a reader gets them.
    pub points: Vec<Vec3>,
}

impl Scan {
    /// Points in steps of 0.1 mm.
    pub fn new(points: Vec<Vec3>) -> Result<Self> {
        Self::in_steps(points, 1e-4, [0.0; 3])
    }

    /// Points in steps of `step` (m) about `offset` (m).
    pub fn in_steps(mut points: Vec<Vec3>, step: f64, offset: Vec3) -> Result<Self> {
        let folder = tempfile::tempdir()?;
        let spec = WriteSpec { scale: [step; 3], offset, ..WriteSpec::default() };
        for point in &mut points {
            *point = spec.rounded(*point).ok_or("a point does not fit a LAS file")?;
        }
        let sample = |&position: &Vec3| Sample { position, kind: Kind::Surface, surface: 0, station: 0 };
        write_samples(&folder.path().join("scan.las"), points.iter().map(sample), &spec)?;
        Ok(Self { folder, points })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Converts with one of the classifiers.
    pub fn convert(&self, setting: Setting, classifier: Classifier) -> Result<Converted> {
        let output = self.path("scan.slices");
        let mut options = ConvertOptions::new(vec![self.path("scan.las")], output.clone());
        options.grid.pixel = PixelSize::Metres(setting.pixel_m);
        options.plan = PlanOptions {
            max_slope_deg: setting.limit_deg,
            classifier,
            min_points: setting.min_points,
            drop_floaters: setting.drop_floaters,
            ..PlanOptions::default()
        };
        options.resources.threads = 1;
        options.overwrite = true;
        options.resources.temp_dir = self.folder.path().into();
        convert(&options, &NoMonitor)?;
        let archive = Archive::open(&output)?;
        let store = Snapshot::resident(&archive, &NoMonitor)?;
        Ok(Converted { bytes: std::fs::read(&output)?, archive, store })
    }

    /// Classifies the scan by one method.
    pub fn judge(&self, setting: Setting, method: Method) -> Result<Judged> {
        let classifier = match method {
            Method::Written => return Ok(Judged::Written(Written::new(setting, self.points.iter().copied()))),
            Method::OrderFree => Classifier::Thesis,
            Method::Span => Classifier::Span,
            Method::Plane => Classifier::Plane,
        };
        Ok(Judged::Converted(Box::new(self.convert(setting, classifier)?)))
    }
}

/// An archive, open and in memory.
pub struct Converted {
    /// The archive's bytes.
    pub bytes: Vec<u8>,
    /// The archive.
    pub archive: Archive,
    /// All of its pages.
    pub store: Snapshot,
}

/// Occupied voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Voxel {
    /// Pixel.
    pub pixel: [i64; 2],
    /// Bottom and top of its slice (m).
    pub z: [f64; 2],
    /// The class.
    pub obstacle: bool,
}

impl Voxel {
    /// Its middle (m).
    pub fn middle(&self, pixel_m: f64) -> Vec3 {
        let [i, j] = self.pixel.map(|v| (v as f64 + 0.5) * pixel_m);
        [i, j, (self.z[0] + self.z[1]) / 2.0]
    }
}

impl Converted {
    /// Calls `give` with every span: pixel, bottom and top (quanta), obstacle or not. Spans end at page borders.
    pub fn spans(&self, mut give: impl FnMut([i64; 2], [i64; 2], bool)) -> Result<()> {
        for entry in self.archive.entries() {
            let entry = entry?;
            let key = entry.key;
            let page = self.archive.page(&entry)?;
            let base = i64::from(key.layer) * PAGE_SLICES * slicewalk::frame::SLICE_QUANTA;
            for (px, py, spans) in page.columns() {
                let pixel =
                    [i64::from(key.tx) * TILE_PIXELS + i64::from(px), i64::from(key.ty) * TILE_PIXELS + i64::from(py)];
                for span in spans {
                    give(pixel, [base + i64::from(span.bottom()), base + i64::from(span.top())], span.is_obstacle());
                }
            }
        }
        Ok(())
    }
}

/// Scan as classified by one method.
pub enum Judged {
    /// By the thesis' algorithm as written.
    Written(Written),
    /// By a conversion.
    Converted(Box<Converted>),
}

impl Judged {
    /// Calls `give` with every voxel.
    pub fn voxels(&self, mut give: impl FnMut(Voxel)) -> Result<()> {
        let converted = match self {
            Self::Written(written) => {
                written.voxels(give);
                return Ok(());
            }
            Self::Converted(converted) => converted,
        };
        let frame = *converted.archive.frame();
        for entry in converted.archive.entries() {
            let entry = entry?;
            let key = entry.key;
            for (px, py, spans) in converted.archive.page(&entry)?.columns() {
                let pixel =
                    [i64::from(key.tx) * TILE_PIXELS + i64::from(px), i64::from(key.ty) * TILE_PIXELS + i64::from(py)];
                for span in spans {
                    let (first, last) = span.slices();
                    for slice in first..=last {
                        let slice = i64::from(key.layer) * PAGE_SLICES + i64::from(slice);
                        let z = [frame.bottom_of_slice(slice), frame.bottom_of_slice(slice + 1)];
                        give(Voxel { pixel, z, obstacle: span.is_obstacle() });
                    }
                }
            }
        }
        Ok(())
    }

    /// Highest floor at one place from `from` down to `from - depth` (m).
    pub fn floor(&self, x: f64, y: f64, from: f64, depth: f64) -> Option<f64> {
        match self {
            Self::Written(written) => written.floor(x, y, from, depth),
            Self::Converted(converted) => {
                let place = Aabb::new(Point3::new(x, y, from), Point3::new(x, y, from)).ok()?;
                match floor_under(&converted.store, &place, from, depth) {
                    Answer::Known(floor) => floor,
                    Answer::NotLoaded(_) => unreachable!("all pages are in memory"),
                }
            }
        }
    }

    /// Returns whether a box touches solid, and whether it touches an obstacle.
    pub fn touches(&self, min: Vec3, max: Vec3) -> (bool, bool) {
        match self {
            Self::Written(written) => written.touches(min, max),
            Self::Converted(converted) => {
                let shape = Aabb::new(min.into(), max.into()).expect("finite");
                let hit = overlaps(&converted.store, &shape) == Overlap::Hit;
                match probe(&converted.store, &shape) {
                    Answer::Known(probe) => (hit, probe.obstacle),
                    Answer::NotLoaded(_) => unreachable!("all pages are in memory"),
                }
            }
        }
    }
}
