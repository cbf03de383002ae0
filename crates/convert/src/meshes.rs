//! First pass over meshes: writes the voxels that triangles fill, or points sampled on them, into runs.

use super::ConvertOptions;
use super::points::{Own, Read, out_of_reach};
use super::work::on_threads;
use crate::colour::ColourScale;
use crate::input::PointCounts;
use crate::input::scenes::Scene;
use crate::mesh::{MeshBatch, MeshCounts, MeshFeed, MeshSet};
use crate::plan::Plan;
use crate::shard_filter::ShardScope;
use crate::voxel::record::Recorder;
use crate::voxel::runs::{RunBuilder, RunStore};
use crate::voxel::surfaces::SurfaceBuilder;
use crate::{Error, Monitor, Result};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

/// Result of the first pass over meshes.
pub(super) struct MeshRead<'a> {
    /// Triangles counted as if they were points, with the bounds of their corners.
    pub read: Read,
    pub triangles: MeshCounts,
    pub points_made: u64,
    /// Files with their bounds.
    pub scenes: Vec<Scene<'a>>,
    /// Content hashes of the files, as read.
    pub hashes: Vec<u128>,
    pub complete: bool,
}

impl<'a> MeshRead<'a> {
    /// Takes the counts, files and hashes of `feed`, with no triangles read yet.
    fn of(feed: &MeshFeed<'a>) -> Self {
        Self {
            read: Read::NOTHING,
            triangles: feed.counts(),
            points_made: 0,
            scenes: feed.scenes().collect(),
            hashes: feed.hashes().collect(),
            complete: feed.is_complete(),
        }
    }
}

/// Settings for the colours of triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Colouring {
    pub scale: ColourScale,
    /// True if values follow the records that they belong to.
    pub with_points: bool,
}

/// Settings of the first pass.
#[derive(Clone, Copy)]
pub(super) struct MeshReading<'a> {
    /// Memory of one worker's run under construction.
    pub build_bytes: u64,
    pub scope: Option<&'a ShardScope>,
    pub colouring: Option<Colouring>,
}

/// First pass: writes all triangles into runs. One worker at a time reads; all of them rasterise triangles.
pub(super) fn read_meshes<'a>(
    set: &'a MeshSet,
    options: &ConvertOptions,
    plan: &Plan,
    store: &RunStore,
    reading: MeshReading<'_>,
    monitor: &dyn Monitor,
) -> Result<MeshRead<'a>> {
    if set.is_empty() {
        return Ok(MeshRead::of(&set.feed()));
    }
    let MeshReading { build_bytes, scope, colouring } = reading;
    monitor.stage("reading meshes", 0, "triangles");
    let feed = Mutex::new(set.feed());
    let failed = AtomicBool::new(false);
    let cancelled = || monitor.cancelled() || failed.load(Ordering::Relaxed);
    let work = || -> Result<(Read, u64)> {
        let mut runs = RunBuilder::new(Recorder::new(plan.frame), build_bytes);
        if let Some(scope) = scope {
            runs = runs.only(scope.keeps());
        }
        let mut surfaces = SurfaceBuilder::new(plan, options.reading.mesh);
        if let Some(Colouring { scale, with_points }) = colouring {
            let mut values = RunBuilder::of_values(Recorder::new(plan.frame), build_bytes, with_points);
            if let Some(scope) = scope {
                values = values.only(scope.keeps());
            }
            surfaces = surfaces.colouring(scale, values);
        }
        let (mut read, mut batch) = (Read::NOTHING, MeshBatch::default());
        let next = |batch: &mut MeshBatch| {
            // Free this batch's textures first, so that they do not wait while another worker reads.
            batch.clear();
            feed.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next_painted(batch, monitor)
        };
        while next(&mut batch)? {
            for (triangle, paint) in batch.iter() {
                if cancelled() {
                    return Err(Error::Interrupted);
                }
                let fold = |start, pick: fn(f64, f64) -> f64| {
                    [0, 1, 2].map(|axis| triangle.iter().fold(start, |extreme, corner| pick(extreme, corner[axis])))
                };
                let (min, max) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
                if !surfaces.reaches(min, max) {
                    return Err(out_of_reach(&plan.frame, min, max));
                }
                read.merge(&Read { min, max, own: Own { min, max, ..Read::NOTHING.own }, ..Read::NOTHING });
                surfaces.push(triangle, paint, &mut runs, store, &cancelled)?;
            }
            monitor.advance(batch.triangles.len() as u64);
        }
        surfaces.flush(&mut runs, store)?;
        runs.flush(store)?;
        Ok((read, surfaces.points_made()))
    };
    let done = on_threads(options.resources.threads, || work().inspect_err(|_| failed.store(true, Ordering::Relaxed)))?;
    let feed = feed.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut all = MeshRead::of(&feed);
    let triangles = all.triangles;
    all.read.counts.read = triangles.read;
    all.read.counts.not_finite = triangles.left_out;
    if scope.is_none_or(ShardScope::owns_meshes) {
        all.read.own.kept = triangles.read - triangles.left_out;
        all.read.own.left_out =
            PointCounts { read: triangles.left_out, not_finite: triangles.left_out, ..Read::NOTHING.counts };
    }
    for (read, points_made) in done {
        all.read.merge(&read);
        all.points_made += points_made;
    }
    Ok(all)
}
