//! First pass over meshes: writes the voxels that triangles fill, or points sampled on them, into runs.

use super::points::{Own, Read, out_of_reach};
use super::work::{Colouring, FirstPass, SourceRead, StopFlag};
use crate::input::PointCounts;
use crate::mesh::{MeshBatch, MeshCounts, MeshFeed, MeshSet};
use crate::shard_filter::ShardScope;
use crate::voxel::surfaces::SurfaceBuilder;
use crate::{Error, Result};
use std::sync::Mutex;

/// Result of the first pass over meshes.
pub(super) struct MeshRead<'a> {
    pub source: SourceRead<'a>,
    pub triangles: MeshCounts,
    pub points_made: u64,
}

impl<'a> MeshRead<'a> {
    /// Takes the counts, files and hashes of `feed`, with no triangles read yet.
    fn of(feed: &MeshFeed<'a>) -> Self {
        let source = SourceRead {
            read: Read::NOTHING,
            scenes: feed.scenes().collect(),
            hashes: feed.hashes().collect(),
            complete: feed.is_complete(),
        };
        Self { source, triangles: feed.counts(), points_made: 0 }
    }
}

/// First pass: writes all triangles into runs. One worker at a time reads; all of them rasterise triangles.
pub(super) fn read_meshes<'a>(
    pass: FirstPass<'_>,
    set: &'a MeshSet,
    colouring: Option<Colouring>,
) -> Result<MeshRead<'a>> {
    if set.is_empty() {
        return Ok(MeshRead::of(&set.feed()));
    }
    let FirstPass { options, plan, scope, store, monitor, .. } = pass;
    monitor.stage("reading meshes", 0, "triangles");
    let feed = Mutex::new(set.feed());
    let flag = StopFlag::new(monitor);
    let work = || -> Result<(Read, u64)> {
        let (mut runs, mut surfaces) = (pass.runs(), SurfaceBuilder::new(plan, options.reading.mesh));
        if let Some(Colouring { scale, with_points }) = colouring {
            surfaces = surfaces.colouring(scale, pass.values(with_points));
        }
        let (mut read, mut batch) = (Read::NOTHING, MeshBatch::default());
        let next = |batch: &mut MeshBatch| {
            // Free this batch's textures first, so that they do not wait while another worker reads.
            batch.clear();
            feed.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next_painted(batch, monitor)
        };
        while next(&mut batch)? {
            for (triangle, paint) in batch.iter() {
                if flag.is_raised() {
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
                surfaces.push(triangle, paint, &mut runs, store, &|| flag.is_raised())?;
            }
            monitor.advance(batch.triangles.len() as u64);
        }
        surfaces.flush(&mut runs, store)?;
        runs.flush(store)?;
        Ok((read, surfaces.points_made()))
    };
    let done = pass.on_threads(&flag, work)?;
    let feed = feed.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    feed.warn_of_coarse_floats(plan.frame.pixel_m(), monitor);
    let mut all = MeshRead::of(&feed);
    let (triangles, source) = (all.triangles, &mut all.source);
    source.read.counts.read = triangles.read;
    source.read.counts.not_finite = triangles.left_out;
    if scope.is_none_or(ShardScope::owns_meshes) {
        source.read.own.kept = triangles.read - triangles.left_out;
        source.read.own.left_out =
            PointCounts { read: triangles.left_out, not_finite: triangles.left_out, ..Read::NOTHING.counts };
    }
    for (read, points_made) in done {
        source.read.merge(&read);
        all.points_made += points_made;
    }
    Ok(all)
}
