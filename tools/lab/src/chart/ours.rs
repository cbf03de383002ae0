//! Slicewalk as a method: each classifier, exact and coarser, and the broad tier.

use super::method::{Built, Method, Vec3};
use super::subject::Subject;
use crate::stability::Result;
use nalgebra::{Point3, Vector3};
use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, PAGE_QUANTA, TILE_PIXELS};
use slicewalk::plan::{Classifier, PlanOptions};
use slicewalk::query::{Aabb, Answer, Overlap, overlaps, probe, sweep, top_under};
use slicewalk::store::Snapshot;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::path::PathBuf;
use tempfile::TempDir;

/// One way to convert and ask.
#[derive(Debug, Clone, Copy)]
pub struct Ours {
    pub name: &'static str,
    pub classifier: Classifier,
    /// Tolerance (pixels).
    pub tolerance: f64,
    /// Whether any solid in the pixels and slices of a box is a hit.
    pub broad: bool,
}

impl Ours {
    /// The default: exact heights, planes.
    pub const PLANE: Self =
        Self { name: "slicewalk plane", classifier: Classifier::Plane, tolerance: 0.0, broad: false };
    /// All ways.
    pub const ALL: [Self; 5] = [
        Self::PLANE,
        Self { name: "slicewalk span", classifier: Classifier::Span, ..Self::PLANE },
        Self { name: "slicewalk thesis", classifier: Classifier::Thesis, ..Self::PLANE },
        Self { name: "slicewalk plane t/4", tolerance: 0.25, ..Self::PLANE },
        Self { name: "slicewalk plane broad", broad: true, ..Self::PLANE },
    ];
}

impl Method for Ours {
    fn name(&self) -> &'static str {
        self.name
    }

    fn settings(&self) -> String {
        let tolerance = if self.tolerance > 0.0 { " --tolerance t/4" } else { "" };
        let broad = if self.broad { ", boxes grown to whole pixels and slices" } else { "" };
        format!("sliceconv --pixel t --classifier {}{tolerance}, all else by default{broad}", self.classifier.name())
    }

    /// Conversion keeps to its budget; in memory it is a few bytes a voxel.
    fn estimate_bytes(&self, _: &Subject, _: f64, cubes: usize) -> f64 {
        ConvertOptions::new(Vec::new(), PathBuf::new()).resources.memory_bytes as f64 + 100.0 * cubes as f64
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("scene.slices");
        let mut options = ConvertOptions::new(vec![subject.file.clone()], file.clone());
        options.grid.pixel = PixelSize::Metres(pixel_m);
        options.plan = PlanOptions {
            classifier: self.classifier,
            tolerance_m: self.tolerance * pixel_m,
            up: subject.up,
            ..PlanOptions::default()
        };
        options.reading.units = subject.units;
        options.resources.temp_dir = folder.path().into();
        convert(&options, &NoMonitor)?;
        let archive = Archive::open(&file)?;
        let (frame, store) = (*archive.frame(), Snapshot::resident(&archive, &NoMonitor)?);
        Ok(Box::new(Pages { broad: self.broad, frame, store, file, _folder: folder }))
    }
}

struct Pages {
    broad: bool,
    frame: Frame,
    store: Snapshot,
    file: PathBuf,
    _folder: TempDir,
}

impl Pages {
    /// The box grown to whole pixels and slices, less the upper edges, which belong to the next ones.
    fn grown(&self, shape: &Aabb) -> Aabb {
        let (min, max) = (shape.min(), shape.max());
        let along = |v: f64| self.frame.edge_of_pixel(self.frame.pixel_of(v));
        let beyond = |v: f64| self.frame.edge_of_pixel(self.frame.pixel_of(v) + 1).next_down();
        let slice = |v: f64, more: i64| self.frame.bottom_of_slice(self.frame.slice_of(v) + more);
        let low = Point3::new(along(min.x), along(min.y), slice(min.z, 0));
        let high = Point3::new(beyond(max.x), beyond(max.y), slice(max.z, 1).next_down());
        // Rounding may leave an edge inside of the box it began with.
        Aabb::new(low.inf(&min), high.sup(&max)).unwrap_or(*shape)
    }
}

impl Built for Pages {
    fn hits(&self, shape: &Aabb) -> bool {
        match self.broad {
            false => overlaps(&self.store, shape) == Overlap::Hit,
            true => overlaps(&self.store, &self.grown(shape)) == Overlap::Hit,
        }
    }

    fn file_bytes(&self) -> Result<Option<u64>> {
        Ok(Some(std::fs::metadata(&self.file)?.len()))
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        let archive = Archive::open(&self.file)?;
        let frame = self.frame;
        for entry in archive.entries() {
            let entry = entry?;
            let base = i64::from(entry.key.layer) * PAGE_QUANTA;
            for (px, py, spans) in archive.page(&entry)?.columns() {
                let pixel = [(entry.key.tx, px), (entry.key.ty, py)]
                    .map(|(tile, pixel)| i64::from(tile) * TILE_PIXELS + i64::from(pixel));
                let [[x0, x1], [y0, y1]] = pixel.map(|i| [frame.edge_of_pixel(i), frame.edge_of_pixel(i + 1)]);
                for span in spans {
                    let [bottom, top] = [span.bottom(), span.top()].map(|quantum| base + i64::from(quantum));
                    let mut z = [frame.bottom_height(bottom), frame.top_height(top)];
                    if self.broad {
                        let (first, last) = span.slices();
                        let slice = |s: u32| frame.bottom_height(base + i64::from(s) * slicewalk::frame::SLICE_QUANTA);
                        z = [slice(first), slice(last + 1)];
                    }
                    give([x0, y0, z[0]], [x1, y1, z[1]]);
                }
            }
        }
        Ok(())
    }

    fn floor(&self, shape: &Aabb, depth_m: f64) -> Option<Option<f64>> {
        (!self.broad).then(|| top_under(&self.store, shape, shape.min().z, depth_m).known().flatten())
    }

    fn sweep(&self, shape: &Aabb, way: Vector3<f64>) -> Option<f64> {
        match sweep(&self.store, shape, way) {
            Answer::Known(hit) if !self.broad => Some(hit.map_or(way.norm(), |hit| hit.distance)),
            _ => None,
        }
    }

    fn standing(&self, [x, y]: [f64; 2], between: [f64; 2]) -> Option<Vec<f64>> {
        (!self.broad).then(|| super::walkable::standing(&self.store, x, y, between))
    }

    fn obstacle(&self, at: Point3<f64>) -> Option<bool> {
        let found = probe(&self.store, &Aabb::new(at, at).ok()?).known()?;
        (found.hit && !self.broad).then_some(found.obstacle)
    }
}
