//! The plan of a conversion, and the measurements from which automatic options follow.

use crate::frame::{Frame, MAX_CELL_M};
use crate::input::InputSet;
use crate::input::spacing::{Spacing, Survey};
use crate::inputs::Inputs;
use crate::mesh::MeshSet;
use crate::plan::{Noise, Plan, PlanOptions};
use crate::splats::SplatSet;
use crate::text::number;
use crate::{ConvertOptions, Error, HoleWidth, Monitor, NoMonitor, Parameter, PixelSize, Result};

/// Automatic pixel size, in units of the scan's point spacing.
pub const AUTO_PIXEL_SPACINGS: f64 = 4.0;
/// Pixels along the longer side of meshes if the pixel size is chosen automatically (thesis, equation 3.3 with the
/// sides of the images in place of the printed ones, at the larger of its two resolutions).
pub const AUTO_PIXELS: f64 = 700.0;

/// Gaps of up to this many spacings lie between points that are spread at random: a disc this wide around a random
/// place holds no point in one of a thousand cases.
const GAP_SPACINGS: f64 = 3.0;

/// Factor of widths in pixels, so that three pixels of 0.1 m make 0.3 m.
const ROUNDING: f64 = 1.0 + 1e-9;

/// Most voxels that splats fill if the pixel size is chosen automatically: so a few blobs of many metres take seconds.
pub const AUTO_VOXELS: f64 = (1u64 << 23) as f64;

/// Measurements from which automatic options follow; `None` where the options were given.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Surveyed {
    /// Source of the pixel size.
    pub spacing: Option<Spacing>,
    /// Source of the tolerance.
    pub noise: Option<Noise>,
}

impl Surveyed {
    /// Reads the scans once, if an option follows from them and the result is not `known` from an earlier run.
    pub fn of(options: &ConvertOptions, set: &InputSet, known: Option<Self>, monitor: &dyn Monitor) -> Result<Self> {
        if let Some(known) = known {
            return Ok(known);
        }
        let auto_pixel = options.grid.pixel == PixelSize::Auto && !set.files().is_empty();
        let no_noise = options.grid.tolerance_auto.then(Noise::default);
        if set.files().is_empty() || !(auto_pixel || options.grid.tolerance_auto) {
            return Ok(Self { spacing: None, noise: no_noise });
        }
        let survey = read_survey(options, set, if auto_pixel { "spacing" } else { "noise" }, monitor)?;
        let spacing = auto_pixel.then(|| survey.spacing()).transpose()?;
        Ok(Self { spacing, noise: no_noise.map(|none| survey.noise().unwrap_or(none)) })
    }
}

/// Reads all points once, as a progress stage named `stage`. Incomplete input fails before its spacing does; if it is
/// allowed, the main pass reports what is missing.
fn read_survey(options: &ConvertOptions, set: &InputSet, stage: &'static str, monitor: &dyn Monitor) -> Result<Survey> {
    let survey = Survey::read(set, options.resources.threads, stage, monitor)?;
    set.check_complete(&NoMonitor)?;
    Ok(survey)
}

/// Returns the plan of a conversion of `inputs` and the measurements it follows from, which may be `known` from an
/// earlier run.
pub(crate) fn plan(
    options: &ConvertOptions,
    Inputs { scans: set, meshes, splats, cubes, .. }: &Inputs,
    known: Option<Surveyed>,
    monitor: &dyn Monitor,
) -> Result<(Plan, Surveyed)> {
    let surveyed = Surveyed::of(options, set, known, monitor)?;
    let is_auto = options.grid.pixel == PixelSize::Auto && surveyed.spacing.is_none();
    let of_cubes = cubes.finest_m().filter(|_| is_auto);
    let pixel_m = match (options.grid.pixel, surveyed.spacing) {
        (PixelSize::Metres(pixel_m), _) => pixel_m,
        (PixelSize::Auto, Some(spacing)) => round_to_digits(AUTO_PIXEL_SPACINGS * spacing.spacing_m, 2),
        (PixelSize::Auto, None) => match of_cubes {
            Some(finest_m) => finest_m,
            None => pixel_of_extent(options, meshes, splats, monitor)?,
        },
    };
    if surveyed.noise.is_some_and(|noise| noise.regions == 0) {
        let text = "--tolerance auto: too little of the input is flat to measure its noise; heights stay as they are";
        monitor.warn(&text.into());
    }
    if options.grid.pixel == PixelSize::Auto && !(1e-6..=MAX_CELL_M).contains(&pixel_m) {
        let reason = format!("the input asks for pixels of {pixel_m} m; give the pixel size in metres");
        return Err(Error::parameter(Parameter::AutomaticPixelSize, reason));
    }
    let mut plan = options.plan_of(pixel_m)?;
    let fills_auto = options.grid.fill_holes == Some(HoleWidth::Auto);
    if fills_auto && set.files().is_empty() {
        let text = "--fill-holes auto: the input has no points whose spacing counts, so no hole is closed; give the width in \
                    metres";
        monitor.warn(&text.into());
    } else if fills_auto {
        let spacing_m = match surveyed.spacing {
            Some(spacing) => spacing.spacing_m,
            None => read_survey(options, set, "spacing", monitor)?.spacing()?.spacing_m,
        };
        let pixels = (GAP_SPACINGS * spacing_m / pixel_m * ROUNDING).floor();
        plan.options.fill_holes = pixels.min(f64::from(PlanOptions::MOST_FILL_PIXELS)) as u8;
    }
    if let Some(finest_m) = of_cubes.filter(|_| options.grid.slice_m.is_none()) {
        // A cube is a voxel, so exporting the archive again gives the same cubes.
        plan.frame = Frame::new(finest_m, finest_m)?;
    }
    if let Some(noise) = surveyed.noise {
        plan.options.tolerance_m = noise.tolerance_m().min(MAX_CELL_M);
    }
    Ok((plan, surveyed))
}

impl ConvertOptions {
    /// Returns the plan for this pixel size (m).
    pub(super) fn plan_of(&self, pixel_m: f64) -> Result<Plan> {
        let slice_m = self.grid.slice_m.unwrap_or(round_to_digits(3.0 * pixel_m, 12).min(MAX_CELL_M));
        let fill_holes = self.fill_holes_pixels(pixel_m)?;
        Ok(Plan { frame: Frame::new(pixel_m, slice_m)?, options: PlanOptions { fill_holes, ..self.plan.clone() } })
    }

    /// Returns the width of the widest holes to close, unless it follows from the scans (pixels of this size, m).
    pub fn fill_holes_pixels(&self, pixel_m: f64) -> Result<u8> {
        let Some(HoleWidth::Metres(widest_m)) = self.grid.fill_holes else { return Ok(self.plan.fill_holes) };
        let pixels = (widest_m / pixel_m * ROUNDING).floor();
        let (pixel, most) = (number(pixel_m), PlanOptions::MOST_FILL_PIXELS);
        let reason = match pixels {
            pixels if pixels < 1.0 => format!("{} m is narrower than a pixel of {pixel} m", number(widest_m)),
            pixels if pixels > f64::from(most) => {
                let widest = number(f64::from(most) * pixel_m);
                format!("{} m is too wide: holes of up to {most} pixels, {widest} m, can be closed", number(widest_m))
            }
            _ => return Ok(pixels as u8),
        };
        Err(Error::parameter(Parameter::FillHoles, reason))
    }
}

/// Rounds `value` to `digits` significant decimal digits.
fn round_to_digits(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// Returns the pixel size for meshes and splats alone: their longer side has [`AUTO_PIXELS`] pixels, fewer if splats
/// would fill more than [`AUTO_VOXELS`], and more than 16 for each of them.
fn pixel_of_extent(
    options: &ConvertOptions,
    meshes: &MeshSet,
    splats: &SplatSet,
    monitor: &dyn Monitor,
) -> Result<f64> {
    monitor.stage("extent", 0, "triangles and splats");
    let survey = splats.survey(options, monitor)?;
    let both = meshes.bounds(monitor)?.into_iter().chain(survey.bounds);
    let along = |axis: usize| {
        let ends = both.clone().map(|(min, max)| (min[axis], max[axis]));
        ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).map_or(0.0, |(min, max)| max - min)
    };
    let longer = along(0).max(along(1));
    if longer > 0.0 {
        let pixel_m = longer / AUTO_PIXELS;
        let filled =
            |pixel_m: f64| survey.volume_m3 / (pixel_m * pixel_m * options.grid.slice_m.unwrap_or(3.0 * pixel_m));
        let excess = filled(pixel_m) / AUTO_VOXELS.max(16.0 * survey.counts.read as f64);
        // Slices of a given height do not grow with the pixels.
        let grows = |excess: f64| if options.grid.slice_m.is_some() { excess.sqrt() } else { libm::cbrt(excess) };
        Ok(round_to_digits(pixel_m * grows(excess.max(1.0)), 2))
    } else {
        Err(Error::parameter(
            Parameter::AutomaticPixelSize,
            "meshes and splats have no extent in x and y; give the pixel size in metres",
        ))
    }
}
