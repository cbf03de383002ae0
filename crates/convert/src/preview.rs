//! Preview of a conversion: what it would read and write.

use super::conversion::{Limits, check_free_space, protected_from_removed, scope, temp_bytes};
use super::inputs::open_inputs;
use super::options::ConvertOptions;
use super::planning::{Surveyed, plan};
use super::splats::SplatSurvey;
use super::stations::Stations;
use super::{Similarity, SplatCounts, UpFound};
use crate::archive::Bounds;
use crate::bytes::len_at;
use crate::disk::Files;
use crate::info::{noise_info, placing_info, plan_info, splat_info, unit_info};
use crate::input::scenes::{Scene, far_apart};
use crate::input::spacing::Spacing;
use crate::input::{ScanFile, StatedBounds, TextLayout};
use crate::output::{Existing, OutputKind, check};
use crate::plan::{Noise, Plan};
use crate::unit::LengthUnit;
use crate::voxel::visibility::Views;
use crate::{Error, Monitor, Result};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Result of [`preview`].
#[derive(Debug, Clone)]
pub struct Preview {
    /// Grid and options.
    pub plan: Plan,
    /// Measured point spacing, if the pixel size follows from it.
    pub spacing: Option<Spacing>,
    /// Direction that points up, if the input shows it.
    pub up: Option<UpFound>,
    /// Placement of all inputs, the rotation upwards included; `None` if they stay in place.
    pub placement: Option<Similarity>,
    /// Splats, and those that would be left out.
    pub splats: SplatCounts,
    /// Noise of the scan, if the tolerance follows from it.
    pub noise: Option<Noise>,
    /// Files that would be read: scans, then meshes.
    pub inputs: Vec<PreviewInput>,
    /// Bounds (m, z up): of scans as stated by their headers, of meshes as measured from their triangles.
    pub bounds: Option<Bounds>,
    /// Text of the coordinate reference system; empty if unknown.
    pub crs: String,
    /// Distinct units of the inputs.
    pub units: Vec<LengthUnit>,
    /// Temporary data that would be written (bytes), estimated from the stated points.
    pub temp_bytes: u64,
}

impl Preview {
    /// Returns the facts under the keys of the command-line contract (`sliceconv --dry-run --json`), except those of the
    /// machine.
    pub fn info(&self) -> Value {
        let mut facts = json!({ "dry_run": true });
        let inputs = self.inputs.iter().map(|input| {
            let text = input.text.as_ref().map(TextLayout::info);
            let path = input.path.to_string_lossy();
            json!({ "path": path, "bytes": input.bytes, "points_stated": input.points, "text": text })
        });
        facts["inputs"] = inputs.collect();
        facts["input_bytes"] = self.inputs.iter().map(|input| input.bytes).sum::<u64>().into();
        let points = self.inputs.iter().filter_map(|input| input.points).fold(0, u64::saturating_add);
        facts["points_stated"] = points.into();
        facts["bounds"] = self.bounds.map(|(min, max)| json!({ "min": min, "max": max })).into();
        let size = self.bounds.map(|(min, max)| [0, 1, 2].map(|axis| max[axis] - min[axis]));
        facts["extent"] = json!(size);
        facts["crs"] = Some(&self.crs[..]).filter(|crs| !crs.is_empty()).into();
        facts["unit"] = unit_info(&self.units);
        if let (Some(facts), Some(plan)) = (facts.as_object_mut(), plan_info(&self.plan).as_object()) {
            facts.extend(plan.clone());
        }
        facts["point_spacing"] = self.spacing.as_ref().map(|spacing| spacing.spacing_m).into();
        if let Some(noise) = &self.noise {
            facts["tolerance_auto"] = noise_info(noise);
        }
        splat_info(&mut facts, &self.splats);
        placing_info(&mut facts, self.up.as_ref(), self.placement.as_ref());
        facts["temp_bytes"] = self.temp_bytes.into();
        facts
    }
}

/// Input file of a conversion.
#[derive(Debug, Clone)]
pub struct PreviewInput {
    /// Path of the file.
    pub path: PathBuf,
    /// Length (bytes).
    pub bytes: u64,
    /// Stated number of points; `None` for a mesh.
    pub points: Option<u64>,
    /// Interpretation of the columns; text scans only.
    pub text: Option<TextLayout>,
}

/// Returns what [`convert`](super::convert()) would do with these options. Writes nothing, and fails where a conversion
/// would fail before it reads points: unusable inputs or options, an output that must not be replaced, too little disk
/// space, too little memory for what the stations saw. An empty output path is ignored.
///
/// Cost: headers of scans; the triangles of meshes once; the points once if pixel size or tolerance follows from them.
pub fn preview(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Preview> {
    let opened = open_inputs(options, monitor)?;
    if !options.output.as_os_str().is_empty() {
        let kind = OutputKind::Archive(Existing::replaced_if(options.overwrite));
        check(&options.output, kind, opened.paths().collect())?;
    }
    if let Some(removed) = &options.removed {
        check(removed, OutputKind::Result, protected_from_removed(options, &opened))?;
    }
    let limits = Limits::of(options);
    let temp_bytes = temp_bytes(options, &opened.scans, limits.retain_bytes).1;
    check_free_space(options, &Files::current(), temp_bytes)?;
    let (plan, Surveyed { spacing, noise }) = plan(options, &opened, None, monitor)?;
    let (set, meshes) = (&opened.scans, &opened.meshes);
    scope(options, (set, &opened.splats), &plan, None, None, monitor)?;
    if options.needs_stations() {
        let found = Stations::find(options.stations.as_deref(), set)?;
        Views::check_memory(&found.stations, limits.views_bytes)?;
    }
    let scenes: Vec<Scene> = set.files().iter().filter_map(ScanFile::scene_stated).collect();
    far_apart(&scenes).inspect(|warning| monitor.warn(warning));
    let scans = set.files().iter().filter(|file| file.points_expected() > 0).filter_map(ScanFile::bounds_stated);
    let scans = scans.map(|StatedBounds { min, max }| (min, max));
    let SplatSurvey { counts, bounds: splats, .. } = opened.splats.survey(options, monitor)?;
    let cubes = opened.cubes.bounds(options, monitor)?;
    let all = scans.chain(meshes.bounds(monitor)?).chain(splats).chain(cubes);
    let bounds = all.reduce(|(min, max), (other_min, other_max)| {
        let axes = |f: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| std::array::from_fn(|axis| f(a[axis], b[axis]));
        (axes(f64::min, min, other_min), axes(f64::max, max, other_max))
    });
    let scans = set.files().iter().map(|file| {
        let (points, text) = (Some(file.points_expected()), file.text_layout().cloned());
        Ok(PreviewInput { path: file.path().into(), bytes: file.bytes(), points, text })
    });
    let of_mesh = |path: &PathBuf| {
        let bytes = len_at(path).map_err(|error| Error::io(path, "read its length", error))?;
        Ok(PreviewInput { path: path.clone(), bytes, points: None, text: None })
    };
    let of_splats = opened.splats.paths().chain(opened.cubes.inputs()).map(|path| {
        let bytes = len_at(path).map_err(|error| Error::io(path, "read its length", error))?;
        Ok(PreviewInput { path: path.into(), bytes, points: None, text: None })
    });
    Ok(Preview {
        plan,
        spacing,
        up: opened.up.or(options.plan_file.as_ref().and_then(|file| file.up)),
        placement: opened.placement,
        splats: counts,
        noise: noise.or(options.plan_file.as_ref().and_then(|file| file.noise)),
        bounds,
        crs: set.crs().unwrap_or_default().to_owned(),
        units: opened.length_units(),
        temp_bytes,
        inputs: scans.chain(set.meshes().iter().map(of_mesh)).chain(of_splats).collect::<Result<_>>()?,
    })
}
