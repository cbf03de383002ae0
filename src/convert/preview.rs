//! What a conversion would read and make, without converting.

use super::options::ConvertOptions;
use super::stations::Stations;
use super::{Limits, Surveyed, check_free_space, open_inputs, plan, scope, temp_bytes};
use crate::archive::Bounds;
use crate::disk::Files;
use crate::input::scenes::{Scene, far_apart};
use crate::input::spacing::Spacing;
use crate::input::{ScanFile, StatedBounds, TextLayout};
use crate::output::{Existing, OutputKind, check};
use crate::plan::{Noise, Plan};
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Result};
use std::path::PathBuf;

/// What a conversion would read and make.
#[derive(Debug, Clone)]
pub struct Preview {
    /// Grid and options.
    pub plan: Plan,
    /// Point spacing found, if the pixel size follows from it.
    pub spacing: Option<Spacing>,
    /// Noise of the scan, if the tolerance follows from it.
    pub noise: Option<Noise>,
    /// The files that would be read: scans, then meshes.
    pub inputs: Vec<PreviewInput>,
    /// Bounds (m, z up): of scans as their headers state them, of meshes as their triangles have them.
    pub bounds: Option<Bounds>,
    /// Text of the coordinate reference system; empty if unknown.
    pub crs: String,
    /// Units in which the inputs come, each once.
    pub units: Vec<LengthUnit>,
    /// Temporary data that would be written, an estimate from the stated points (bytes).
    pub temp_bytes: u64,
}

/// A file that a conversion would read.
#[derive(Debug, Clone)]
pub struct PreviewInput {
    /// Where it is.
    pub path: PathBuf,
    /// Its length (bytes).
    pub bytes: u64,
    /// Points that it states; `None` for a mesh.
    pub points: Option<u64>,
    /// How its columns were understood, of a scan in text.
    pub text: Option<TextLayout>,
}

/// Finds out what [`convert`](super::convert()) would do with these options. Writes nothing, and fails where a conversion
/// would fail before it reads points: unusable inputs or options, an output that must not be replaced, too small a disk. An
/// empty output path is not looked at.
///
/// Cost: headers of scans; the triangles of meshes once; the points once if the pixel size follows from them.
pub fn preview(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Preview> {
    let opened = open_inputs(options, monitor)?;
    if !options.output.as_os_str().is_empty() {
        let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
        check(&options.output, kind, opened.paths().collect())?;
    }
    let temp_bytes = temp_bytes(options, &opened.scans, Limits::of(options).retain_bytes).1;
    check_free_space(options, &Files::current(), temp_bytes)?;
    let (plan, Surveyed { spacing, noise }) = plan(options, &opened, None, monitor)?;
    let (set, meshes) = (&opened.scans, &opened.meshes);
    scope(options, set, &plan, None, None, monitor)?;
    if options.plan.remove_moving {
        Stations::find(options.stations.as_deref(), set)?;
    }
    let scenes: Vec<Scene> = set.files().iter().filter_map(ScanFile::scene_stated).collect();
    far_apart(&scenes).inspect(|warning| monitor.warn(warning));
    let scans = set.files().iter().filter(|file| file.points_expected() > 0).filter_map(ScanFile::bounds_stated);
    let scans = scans.map(|StatedBounds { min, max }| (min, max));
    let bounds = scans.chain(meshes.bounds(monitor)?).reduce(|(min, max), (other_min, other_max)| {
        let axes = |f: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| f(a[axis], b[axis]));
        (axes(f64::min, min, other_min), axes(f64::max, max, other_max))
    });
    let scans = set.files().iter().map(|file| {
        let (points, text) = (Some(file.points_expected()), file.text_layout().cloned());
        Ok(PreviewInput { path: file.path().into(), bytes: file.bytes(), points, text })
    });
    let of_mesh = |path: &PathBuf| {
        let about = path.metadata().map_err(|error| Error::io(path, "read its length", error))?;
        Ok(PreviewInput { path: path.clone(), bytes: about.len(), points: None, text: None })
    };
    Ok(Preview {
        plan,
        spacing,
        noise: noise.or(options.plan_file.as_ref().and_then(|file| file.noise)),
        bounds,
        crs: set.crs().unwrap_or_default().to_owned(),
        units: opened.length_units(),
        temp_bytes,
        inputs: scans.chain(set.meshes().iter().map(of_mesh)).collect::<Result<_>>()?,
    })
}
