//! The first pass over meshes: all triangles into runs.

use super::{ConvertOptions, join, on_threads, out_of_reach, round_to_digits};
use crate::input::InputSet;
use crate::mesh::{MeshCounts, MeshOptions, MeshSet};
use crate::plan::Plan;
use crate::voxel::record::Recorder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::voxel::surfaces::SurfaceBuilder;
use crate::{Error, Monitor, NoMonitor, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Pixels along the longer side of meshes whose pixel size is chosen automatically (thesis, equation 3.3 with the sides
/// of the images in place of the printed ones, at the larger of its two resolutions).
const AUTO_PIXELS: f64 = 700.0;

/// What the first pass finds in meshes; all of it independent of the order of triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surfaces {
    pub triangles: MeshCounts,
    /// Bounds of the corners of all triangles that were kept.
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// Points made of them, if they were sampled.
    pub points_made: u64,
}

impl Surfaces {
    const NOTHING: Self = Self {
        triangles: MeshCounts { read: 0, left_out: 0 },
        min: [f64::INFINITY; 3],
        max: [f64::NEG_INFINITY; 3],
        points_made: 0,
    };

    fn merge(&mut self, other: &Self) {
        self.triangles += other.triangles;
        self.points_made += other.points_made;
        join(&mut self.min, &mut self.max, (&other.min, &other.max));
    }
}

fn open(options: &ConvertOptions, set: &InputSet, monitor: &dyn Monitor) -> Result<MeshSet> {
    let mesh_options = MeshOptions {
        units: options.units,
        up: options.up,
        memory_bytes: options.memory_bytes / 8,
        temp_dir: options.temp_dir.clone(),
    };
    MeshSet::open(set.meshes(), mesh_options, monitor)
}

/// Pixel size of meshes alone: their longer side in 700 pixels.
pub(super) fn pixel_of_extent(options: &ConvertOptions, set: &InputSet, monitor: &dyn Monitor) -> Result<f64> {
    monitor.stage("extent", 0, "triangles");
    let bounds = open(options, set, &NoMonitor)?.bounds(monitor)?;
    let longer = bounds.map_or(0.0, |(min, max)| (max[0] - min[0]).max(max[1] - min[1]));
    if longer > 0.0 {
        Ok(round_to_digits(longer / AUTO_PIXELS, 2))
    } else {
        Err(Error::parameter("--pixel auto", "the meshes have no extent in x and y; give the pixel size in metres"))
    }
}

/// Takes the triangles of all meshes among the inputs into runs. One worker at a time reads; all of them take
/// triangles to the grid.
pub(super) fn read(
    options: &ConvertOptions,
    set: &InputSet,
    plan: &Plan,
    store: &RunStore,
    build_bytes: u64,
    monitor: &dyn Monitor,
) -> Result<Surfaces> {
    let set = open(options, set, monitor)?;
    if set.is_empty() {
        return Ok(Surfaces::NOTHING);
    }
    monitor.stage("reading meshes", 0, "triangles");
    let feed = Mutex::new(set.feed());
    let failed = AtomicBool::new(false);
    let cancelled = || monitor.cancelled() || failed.load(Ordering::Relaxed);
    let work = || -> Result<Surfaces> {
        let mut runs = RunBuilder::new(Recorder::new(plan.frame), build_bytes);
        let mut builder = SurfaceBuilder::new(plan, options.mesh);
        let (mut found, mut batch) = (Surfaces::NOTHING, Vec::new());
        while feed.lock().unwrap_or_else(PoisonError::into_inner).next(&mut batch, monitor)? {
            for triangle in &batch {
                if cancelled() {
                    return Err(Error::Interrupted);
                }
                let fold = |start, pick: fn(f64, f64) -> f64| {
                    [0, 1, 2].map(|axis| triangle.iter().fold(start, |extreme, corner| pick(extreme, corner[axis])))
                };
                let (min, max) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
                if !builder.reaches(min, max) {
                    return Err(out_of_reach(&plan.frame, min, max));
                }
                join(&mut found.min, &mut found.max, (&min, &max));
                builder.push(triangle, &mut runs, store, &cancelled)?;
            }
            monitor.advance(batch.len() as u64);
        }
        builder.flush(&mut runs, store)?;
        runs.flush(store)?;
        Ok(Surfaces { points_made: builder.points_made(), ..found })
    };
    let found = on_threads(options.threads.max(1), || work().inspect_err(|_| failed.store(true, Ordering::Relaxed)))?;
    let mut all = Surfaces::NOTHING;
    found.iter().for_each(|found| all.merge(found));
    all.triangles = feed.into_inner().unwrap_or_else(PoisonError::into_inner).counts();
    Ok(all)
}
