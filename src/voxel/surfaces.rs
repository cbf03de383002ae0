//! Triangles to records: exactly, as what they fill of voxels, or as points.

use super::record::{BATCH, Recorder, SurfaceVoxel, surface_voxels};
use super::runs::{RunBuilder, RunStore};
use crate::frame::Frame;
use crate::input::PointBatch;
use crate::mesh::raster::{Raster, extent_of};
use crate::mesh::sample::oversample;
use crate::mesh::{MeshMode, Triangle};
use crate::plan::Plan;
use crate::{Error, Parameter, Result};

/// Most voxels that one triangle may fill, roughly; more are a mistake in the unit or the pixel size, or a damaged corner,
/// and would fill the disk (2³²: 34 GB, 1.3 × 1.3 km in pixels of 2 cm).
const MOST_VOXELS: f64 = (1u64 << 32) as f64;

/// Turns the triangles of one worker into records. Its scratch is reused.
#[derive(Debug)]
pub struct SurfaceBuilder {
    frame: Frame,
    recorder: Recorder,
    raster: Raster,
    /// Step of the points; `None`: exactly.
    step_m: Option<f64>,
    voxels: Vec<SurfaceVoxel>,
    points: PointBatch,
    /// Points made.
    made: u64,
}

impl SurfaceBuilder {
    /// A builder for archives of `plan`.
    pub fn new(plan: &Plan, mode: MeshMode) -> Self {
        let step_m = match mode {
            MeshMode::Exact => None,
            MeshMode::Sampled { step_m } => Some(step_m.unwrap_or(plan.frame.pixel_m())),
        };
        Self {
            frame: plan.frame,
            recorder: Recorder::new(plan.frame),
            raster: Raster::new(plan.frame, plan.options.max_slope_deg),
            step_m,
            voxels: Vec::with_capacity(BATCH),
            points: PointBatch::default(),
            made: 0,
        }
    }

    /// Points made so far.
    pub fn points_made(&self) -> u64 {
        self.made
    }

    /// Whether all coordinates within these bounds have an index on the grid.
    pub fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        self.recorder.reaches(min, max)
    }

    /// Adds a usable triangle within [`reaches`](Self::reaches); stops where `cancelled` says so.
    pub fn push(
        &mut self,
        triangle: &Triangle,
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        let cell = self.frame.pixel_m() * self.frame.pixel_m().min(self.frame.slice_m());
        let least = self.step_m.map_or(cell, |step| step * step);
        let (area, longest) = extent_of(triangle);
        let voxels = area / least + longest / least.sqrt();
        if voxels > MOST_VOXELS {
            let error = Error::limit("voxels that one triangle fills", format!("{voxels:.0}"), MOST_VOXELS);
            return Err(error.with_way_out(Parameter::PixelSize));
        }
        match self.step_m {
            None => self.push_exactly(triangle, runs, store, cancelled),
            Some(step_m) => self.push_points(triangle, step_m, runs, store, cancelled),
        }
    }

    fn push_exactly(
        &mut self,
        triangle: &Triangle,
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        let Some(placed) = self.raster.place(triangle) else { return Ok(()) };
        let (voxels, steep) = (&mut self.voxels, placed.is_steep());
        let (first, last) = placed.rows();
        for j in first..=last {
            let mut done = Ok(());
            placed.for_each_pixel(j, |i, bottom, top| {
                for voxel in surface_voxels((i, j), (bottom, top), steep) {
                    if done.is_err() {
                        return;
                    }
                    voxels.push(voxel);
                    if voxels.len() == BATCH {
                        done = if cancelled() { Err(Error::Interrupted) } else { runs.push_surfaces(voxels, store) };
                        voxels.clear();
                    }
                }
            });
            done?;
        }
        Ok(())
    }

    fn push_points(
        &mut self,
        triangle: &Triangle,
        step_m: f64,
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        let mut done = Ok(());
        oversample(triangle, step_m, |[x, y, z]| {
            if done.is_err() {
                return;
            }
            let points = &mut self.points;
            points.x.push(x);
            points.y.push(y);
            points.z.push(z);
            self.made += 1;
            if points.len() == BATCH {
                done = if cancelled() { Err(Error::Interrupted) } else { push_points(points, runs, store) };
            }
        });
        done
    }

    /// Hands on what is left; to be called at the end.
    pub fn flush(&mut self, runs: &mut RunBuilder, store: &RunStore) -> Result<()> {
        runs.push_surfaces(&self.voxels, store)?;
        self.voxels.clear();
        push_points(&mut self.points, runs, store)
    }
}

fn push_points(points: &mut PointBatch, runs: &mut RunBuilder, store: &RunStore) -> Result<()> {
    runs.push(&points.x, &points.y, &points.z, store)?;
    for column in [&mut points.x, &mut points.y, &mut points.z] {
        column.clear();
    }
    Ok(())
}
