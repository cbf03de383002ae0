//! Conversion of triangles to records: exactly, as the parts of voxels that they fill, or as points; and of their
//! colours.

use super::colours::values_of_piece;
use super::record::{BATCH, Recorder, SurfaceVoxel, surface_voxels};
use super::runs::{RunBuilder, RunStore};
use crate::colour::ColourScale;
use crate::frame::Frame;
use crate::input::PointBatch;
use crate::mesh::paint::{Paint, PaintedPiece, PlacedPaint};
use crate::mesh::raster::{Raster, extent_of};
use crate::mesh::sample::oversample;
use crate::mesh::{MeshMode, Triangle};
use crate::plan::Plan;
use crate::{Error, Parameter, Result};

/// Approximate limit of the voxels that one triangle may fill. More indicate a wrong unit or pixel size, or a damaged
/// corner, and would fill the disk (2³²: 34 GB, 1.3 × 1.3 km in pixels of 2 cm).
const MOST_VOXELS: f64 = (1u64 << 32) as f64;

/// Converts the triangles of one worker to records; reuses its buffers.
#[derive(Debug)]
pub struct SurfaceBuilder {
    frame: Frame,
    recorder: Recorder,
    raster: Raster,
    /// Step of the points (m); `None` for exact conversion.
    step_m: Option<f64>,
    voxels: Vec<SurfaceVoxel>,
    points: PointBatch,
    /// Number of generated points.
    made: u64,
    colours: Option<SurfaceColours>,
}

/// Collects the colours of triangles' pieces.
#[derive(Debug)]
struct SurfaceColours {
    scale: ColourScale,
    runs: RunBuilder,
    pieces: Vec<(SurfaceVoxel, (u32, Option<u32>))>,
    /// Colours of the points in [`SurfaceBuilder::points`]; `None` for uncoloured ones.
    values: Vec<Option<[u8; 3]>>,
}

impl SurfaceBuilder {
    /// Creates a builder for archives of `plan`.
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
            colours: None,
        }
    }

    /// Puts the colours of painted triangles into `runs`, which must be value runs; `scale` maps values to colours.
    pub fn colouring(mut self, scale: ColourScale, runs: RunBuilder) -> Self {
        self.colours = Some(SurfaceColours { scale, runs, pieces: Vec::with_capacity(BATCH), values: Vec::new() });
        self
    }

    /// Number of points generated until now.
    pub fn points_made(&self) -> u64 {
        self.made
    }

    /// Returns whether all coordinates within these bounds have an index on the grid.
    pub fn reaches(&self, min: [f64; 3], max: [f64; 3]) -> bool {
        self.recorder.reaches(min, max)
    }

    /// Adds a usable triangle within [`reaches`](Self::reaches) and its colours; stops with an error once `cancelled`
    /// is true.
    pub fn push(
        &mut self,
        triangle: &Triangle,
        paint: &Paint,
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
            return Err(error.with_suggestion(Parameter::PixelSize));
        }
        let paint = self.colours.as_ref().and_then(|_| PlacedPaint::new(&self.frame, triangle, paint));
        match self.step_m {
            None => self.push_exactly(triangle, paint.as_ref(), runs, store, cancelled),
            Some(step_m) => self.push_points(triangle, paint.as_ref(), step_m, runs, store, cancelled),
        }
    }

    fn push_exactly(
        &mut self,
        triangle: &Triangle,
        paint: Option<&PlacedPaint>,
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<()> {
        let Some(placed) = self.raster.place(triangle) else { return Ok(()) };
        let (voxels, colours, steep) = (&mut self.voxels, &mut self.colours, placed.is_steep());
        let (first, last) = placed.rows();
        for j in first..=last {
            let mut done = Ok(());
            let row = paint.map(|paint| (paint, paint.row(j)));
            placed.for_each_pixel(j, |i, bottom, top| {
                for voxel in surface_voxels((i, j), (bottom, top), steep) {
                    if done.is_err() {
                        return;
                    }
                    if let (Some((paint, row)), Some(colours)) = (&row, colours.as_mut()) {
                        done = colours.add(voxel, paint.piece(row, i, voxel.slice), store);
                    }
                    voxels.push(voxel);
                    if done.is_ok() && voxels.len() == BATCH {
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
        paint: Option<&PlacedPaint>,
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
            if let Some(colours) = &mut self.colours {
                colours.values.push(paint.map(|paint| paint.at(&self.frame, [x, y, z], step_m * step_m)));
            }
            if points.len() == BATCH {
                let colours = self.colours.as_mut();
                done = if cancelled() { Err(Error::Interrupted) } else { push_points(points, colours, runs, store) };
            }
        });
        done
    }

    /// Passes the remaining records on; must be called at the end.
    pub fn flush(&mut self, runs: &mut RunBuilder, store: &RunStore) -> Result<()> {
        runs.push_surfaces(&self.voxels, store)?;
        self.voxels.clear();
        push_points(&mut self.points, self.colours.as_mut(), runs, store)?;
        match &mut self.colours {
            Some(colours) => colours.flush(store),
            None => Ok(()),
        }
    }
}

impl SurfaceColours {
    fn add(&mut self, voxel: SurfaceVoxel, piece: PaintedPiece, store: &RunStore) -> Result<()> {
        self.pieces.push((voxel, values_of_piece(&self.scale, piece)));
        if self.pieces.len() == BATCH {
            self.runs.push_surface_values(&self.pieces, store)?;
            self.pieces.clear();
        }
        Ok(())
    }

    /// Adds the colours of these points, and clears them.
    fn add_points(&mut self, points: &PointBatch, store: &RunStore) -> Result<()> {
        let Self { scale, runs, values, .. } = self;
        let value = |colour: [u8; 3]| values_of_piece(scale, PaintedPiece { colour, weight: 1 });
        // All points of one triangle have a colour or none has, so the pieces are long.
        let mut begin = 0;
        for piece in values.chunk_by(|a, b| a.is_some() == b.is_some()) {
            let range = begin..begin + piece.len();
            begin = range.end;
            if piece.first().is_some_and(Option::is_some) {
                let columns = [&points.x[range.clone()], &points.y[range.clone()], &points.z[range]];
                runs.push_values(columns, |number| value(piece[number].unwrap_or_default()), store)?;
            }
        }
        values.clear();
        Ok(())
    }

    fn flush(&mut self, store: &RunStore) -> Result<()> {
        self.runs.push_surface_values(&self.pieces, store)?;
        self.pieces.clear();
        self.runs.flush(store)
    }
}

fn push_points(
    points: &mut PointBatch,
    colours: Option<&mut SurfaceColours>,
    runs: &mut RunBuilder,
    store: &RunStore,
) -> Result<()> {
    runs.push(&points.x, &points.y, &points.z, store)?;
    if let Some(colours) = colours {
        colours.add_points(points, store)?;
    }
    for column in [&mut points.x, &mut points.y, &mut points.z] {
        column.clear();
    }
    Ok(())
}
