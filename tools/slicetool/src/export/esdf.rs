//! Signed distances to the surface of solid space on a regular grid of places (`.npy`), for planners.
//!
//! Samples are `float32` in metres, positive in free space and negative inside solid, in C order with the axes z, y, x.
//! Along each axis, sample `k` counted from the origin lies at `(k + 1/2)·step`, so with the default step at the middles
//! of pixels. Distances beyond `--within` are cut there. Format: NEP 1 of numpy, version 1.0.

use crate::Failure;
use crate::ground::Loader;
use nalgebra::Point3;
use slicewalk::archive::Bounds;
use slicewalk::query::{Aabb, Answer, Overlap, nearest_surface, overlaps};
use slicewalk::store::Snapshot;
use slicewalk_base::output::Output;
use slicewalk_base::text::{grouped, number};
use std::io::{BufWriter, IntoInnerError, Write};

/// Most samples of a grid (16 GiB).
const MOST_SAMPLES: f64 = (1u64 << 32) as f64;
/// Farthest sample from the origin (steps).
const FARTHEST: f64 = (1u64 << 52) as f64;
/// The distance changes by at most a step from one sample to the next, and by rounding errors.
const SLACK: f64 = 1.0 + 1e-6;

/// Grid of samples.
pub struct Samples {
    /// Region that they cover; by default the bounds of the archive and of what its edits add.
    pub bounds: Option<Bounds>,
    /// Distance between samples (m); by default a pixel.
    pub step_m: Option<f64>,
    /// Greatest distance (m).
    pub within_m: f64,
}

/// Writes the distances; returns a message about them. Memory: the pages in the cache.
pub fn npy(loader: &Loader, samples: &Samples, to: Output) -> Result<String, Failure> {
    let refused = |reason: String| Failure::Text(format!("{}: {reason}", loader.path().display()));
    let archive = loader.archive();
    let step = samples.step_m.unwrap_or(archive.frame().pixel_m());
    let added = archive.edits().and_then(|edits| edits.added_bounds(archive.frame()));
    let whole = [archive.header().bounds, added].into_iter().flatten().reduce(|(low, high), (min, max)| {
        ([0, 1, 2].map(|axis| low[axis].min(min[axis])), [0, 1, 2].map(|axis| high[axis].max(max[axis])))
    });
    let Some((min, max)) = samples.bounds.or(whole) else {
        return Err(refused("holds no points, so there are no distances; give --bounds".into()));
    };
    let ends = [0, 1, 2].map(|axis| ((min[axis] / step).floor(), (max[axis] / step).ceil()));
    if !ends.iter().all(|(first, end)| first.abs() < FARTHEST && end.abs() < FARTHEST) {
        return Err(refused("the region has no end; give --bounds without inf".into()));
    }
    let [nx, ny, nz] = ends.map(|(first, end)| (end - first).max(1.0));
    if nx * ny * nz > MOST_SAMPLES {
        let reason =
            format!("{nx} × {ny} × {nz} distances, more than {MOST_SAMPLES}; give smaller --bounds or a larger --step");
        return Err(refused(reason));
    }
    let [(x0, nx), (y0, ny), (z0, nz)] =
        [(ends[0].0, nx), (ends[1].0, ny), (ends[2].0, nz)].map(|(k, n)| (k, n as u64));
    let place = |first: f64, k: u64| (first + k as f64 + 0.5) * step;
    let mut file = BufWriter::new(to);
    let about = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({nz}, {ny}, {nx}), }}");
    // Magic, version and length take 10 bytes; data begin at a multiple of 64.
    let padded = (10 + about.len() + 1).next_multiple_of(64) - 10;
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(padded as u16).to_le_bytes())?;
    writeln!(file, "{about:<width$}", width = padded - 1)?;
    for (k, j) in (0..nz).flat_map(|k| (0..ny).map(move |j| (k, j))) {
        let mut last: Option<f64> = None;
        for i in 0..nx {
            let at = Point3::new(place(x0, i), place(y0, j), place(z0, k));
            let max = last.map_or(samples.within_m, |last| ((last.abs() + step) * SLACK).min(samples.within_m));
            let distance = loader.known(|view| Ok(signed(view, at, max)))?;
            let distance = distance.clamp(-samples.within_m, samples.within_m);
            file.write_all(&(distance as f32).to_le_bytes())?;
            last = Some(distance);
        }
    }
    file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
    let size = [nx, ny, nz].map(grouped).join(" × ");
    let first = [place(x0, 0), place(y0, 0), place(z0, 0)].map(number).join(",");
    Ok(format!("{size} distances of {} m from {first}, axes z, y, x", number(step)))
}

/// Returns the signed distance at a place, or ±`max` if nothing is that near.
fn signed(view: &Snapshot, at: Point3<f64>, max: f64) -> Answer<f64> {
    match nearest_surface(view, at, max) {
        Answer::Known(Some(found)) => Answer::Known(found.distance),
        Answer::Known(None) => {
            let Ok(point) = Aabb::new(at, at) else { return Answer::Known(max) };
            match overlaps(view, &point) {
                Overlap::Clear => Answer::Known(max),
                Overlap::Hit => Answer::Known(-max),
                Overlap::NotLoaded(missing) => Answer::NotLoaded(missing),
            }
        }
        Answer::NotLoaded(missing) => Answer::NotLoaded(missing),
    }
}
