//! Conversion of the solid parts of splats to records: the parts of voxels that they fill, and their colours.

use super::colours::values_of_piece;
use super::record::{BATCH, Recorder, SurfaceVoxel, WHOLE, surface_voxels};
use super::runs::{RunBuilder, RunStore};
use crate::colour::ColourScale;
use crate::mesh::paint::PaintedPiece;
use crate::plan::Plan;
use crate::{Error, Parameter, Result};
use slicewalk_splat::ellipsoid::Ellipsoid;
use slicewalk_splat::raster::EllipsoidRaster;

/// Approximate limit of the voxels that one splat may fill. More indicate a wrong unit or pixel size, or a blob of sky.
const MOST_VOXELS: f64 = (1u64 << 30) as f64;

/// Converts the ellipsoids of one worker to records; reuses its buffers.
#[derive(Debug)]
pub struct EllipsoidBuilder {
    raster: EllipsoidRaster,
    recorder: Recorder,
    voxels: Vec<SurfaceVoxel>,
    colours: Option<Colours>,
}

/// Collects the colours of ellipsoids' pieces.
#[derive(Debug)]
struct Colours {
    scale: ColourScale,
    runs: RunBuilder,
    pieces: Vec<(SurfaceVoxel, (u32, Option<u32>))>,
}

impl EllipsoidBuilder {
    /// Creates a builder for archives of `plan`.
    pub fn new(plan: &Plan) -> Self {
        Self {
            raster: EllipsoidRaster::new(plan.frame, plan.options.max_slope_deg),
            recorder: Recorder::new(plan.frame),
            voxels: Vec::with_capacity(BATCH),
            colours: None,
        }
    }

    /// Puts colours into `runs`, which must be value runs; `scale` maps values to colours.
    pub fn colouring(mut self, scale: ColourScale, runs: RunBuilder) -> Self {
        self.colours = Some(Colours { scale, runs, pieces: Vec::with_capacity(BATCH) });
        self
    }

    /// Adds an ellipsoid with its bounds, and the opacity and colour of its splat; returns false if the grid does not reach
    /// it. Stops with an error once `cancelled` is true.
    pub fn push(
        &mut self,
        ellipsoid: &Ellipsoid,
        (min, max): ([f64; 3], [f64; 3]),
        (opacity, colour): (f32, [u8; 3]),
        runs: &mut RunBuilder,
        store: &RunStore,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<bool> {
        let placed = self.raster.place(ellipsoid).filter(|placed| placed.is_on_grid());
        let Some(placed) = placed.filter(|_| self.recorder.reaches(min, max)) else { return Ok(false) };
        if placed.voxels() > MOST_VOXELS {
            let error = Error::limit("voxels that one splat fills", format!("{:.0}", placed.voxels()), MOST_VOXELS);
            return Err(error.with_suggestion(Parameter::PixelSize));
        }
        let (voxels, colours) = (&mut self.voxels, &mut self.colours);
        let weight = weight_of(opacity);
        let (first, last) = placed.rows();
        for j in first..=last {
            let mut done = Ok(());
            placed.for_each_pixel(j, |piece| {
                for mut voxel in surface_voxels((piece.i, j), (piece.bottom, piece.top), piece.steep == Some(true)) {
                    voxel.part.weight = weight;
                    voxel.part.undecided = piece.steep.is_none();
                    if done.is_err() {
                        return;
                    }
                    if let Some(colours) = colours.as_mut() {
                        done = colours.add(voxel, colour, store);
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
        Ok(true)
    }

    /// Passes the remaining records on; must be called at the end.
    pub fn flush(&mut self, runs: &mut RunBuilder, store: &RunStore) -> Result<()> {
        runs.push_surfaces(&self.voxels, store)?;
        self.voxels.clear();
        match &mut self.colours {
            Some(Colours { runs, pieces, .. }) => {
                runs.push_surface_values(pieces, store)?;
                pieces.clear();
                runs.flush(store)
            }
            None => Ok(()),
        }
    }
}

/// Returns the weight of a splat's voxels in components: its opacity in quarters, rounded up.
fn weight_of(opacity: f32) -> u8 {
    (opacity * f32::from(WHOLE)).ceil().clamp(1.0, f32::from(WHOLE)) as u8
}

impl Colours {
    fn add(&mut self, voxel: SurfaceVoxel, colour: [u8; 3], store: &RunStore) -> Result<()> {
        self.pieces.push((voxel, values_of_piece(&self.scale, PaintedPiece { colour, weight: 1 })));
        if self.pieces.len() == BATCH {
            self.runs.push_surface_values(&self.pieces, store)?;
            self.pieces.clear();
        }
        Ok(())
    }
}
