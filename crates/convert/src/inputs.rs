//! Opening and placing the inputs of a conversion.

use crate::cubes::CubeSet;
use crate::input::{InputOptions, InputSet, ScanFile, Units};
use crate::mesh::{MeshMode, MeshOptions, MeshSet};
use crate::placement::Similarity;
use crate::plan::Up;
use crate::shard_inputs::Chosen;
use crate::splats::{Divided, SplatSet};
use crate::unit::LengthUnit;
use crate::upright::{self, Turn, UpFound};
use crate::{ConvertOptions, Error, Monitor, Parameter, Result};
use std::path::{Path, PathBuf};

/// Input files of a conversion.
pub(crate) struct Inputs {
    pub scans: InputSet,
    pub meshes: MeshSet,
    pub splats: SplatSet,
    pub cubes: CubeSet,
    /// Unit of splats and cubes.
    pub units: Units,
    /// Direction that points up, if the input shows it.
    pub up: Option<UpFound>,
    /// Placement of all inputs, its rotation upwards included.
    pub placement: Option<Similarity>,
    /// Choice of inputs of a part that need not open all of them.
    pub chosen: Option<Chosen>,
}

impl Inputs {
    /// Returns the paths of all inputs that the command reads, opened or not.
    pub(super) fn paths(&self) -> impl Iterator<Item = &Path> {
        let opened = self.scans.files().iter().map(ScanFile::path);
        let closed = self.chosen.iter().flat_map(|chosen| &chosen.closed);
        opened
            .chain(self.scans.meshes().iter().chain(closed).map(PathBuf::as_path))
            .chain(self.splats.paths())
            .chain(self.cubes.paths())
    }

    /// Returns the distinct units of the inputs.
    pub(super) fn length_units(&self) -> Vec<LengthUnit> {
        let of_scans = self.scans.length_units().chain(self.meshes.length_unit());
        LengthUnit::distinct(
            of_scans.chain(self.splats.length_unit(self.units)).chain(self.cubes.length_unit(self.units)),
        )
    }
}

/// Memory for the textures of meshes (bytes), taken from the share of runs and from the later share of encoded pages.
fn texture_bytes(options: &ConvertOptions) -> u64 {
    options.resources.memory_bytes / 8 * 3
}

/// Opens the inputs of a conversion.
pub(crate) fn open_inputs(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Inputs> {
    open_chosen(options, None, monitor)
}

/// Opens the `chosen` inputs of a conversion, or all of them.
pub(super) fn open_chosen(options: &ConvertOptions, chosen: Option<Chosen>, monitor: &dyn Monitor) -> Result<Inputs> {
    options.check()?;
    let input_options = InputOptions {
        units: options.reading.units,
        epsg: options.reading.epsg,
        columns: options.reading.columns,
        up: options.plan.up,
        placement: options.reading.placement,
        exclude_classes: options.plan.exclude_classes,
        memory_bytes: options.resources.memory_bytes / 16,
        // Set later, and not needed for an automatic pixel size.
        colour: None,
        allow_incomplete: options.allow_incomplete,
        // Hash only the pass that reads the points of the archive, not the pass for an automatic pixel size.
        hash: false,
        threads: options.resources.threads,
    };
    let mut cubes = CubeSet::default();
    let (mut scans, splats) = match &chosen {
        None => {
            let (of_cubes, others) = CubeSet::among(options, monitor)?;
            cubes = of_cubes;
            match others.is_empty() && !options.inputs.is_empty() {
                true => (InputSet::of_paths(others, input_options, monitor)?, Vec::new()),
                false => Divided::open(&others, input_options, monitor)?,
            }
        }
        Some(chosen) => {
            let mut scans = InputSet::of_paths(chosen.opened.clone(), input_options, monitor)?;
            chosen.check_stated(&scans)?;
            scans.set_crs(chosen.stated.crs.clone());
            (scans, chosen.splats.clone())
        }
    };
    let has_others = !scans.files().is_empty() || cubes.inputs().next().is_some();
    let mesh_options = MeshOptions {
        units: options.reading.units,
        up: options.plan.up,
        placement: options.reading.placement,
        memory_bytes: options.resources.memory_bytes / 8,
        temp_dir: options.resources.temp_dir.clone(),
        allow_incomplete: options.allow_incomplete,
        has_others: has_others || !splats.is_empty(),
        hash: options.shard.is_some(),
        // Set later.
        colours: false,
        texture_bytes: texture_bytes(options),
    };
    let meshes = MeshSet::open(scans.meshes(), mesh_options, monitor)?;
    let has_others = has_others || !meshes.is_empty();
    let mut splats = SplatSet::open(splats, has_others, options, monitor)?;
    let left_out = scans.take_left_out().or(cubes.take_left_out());
    if let Some(error) = left_out.filter(|_| !has_others && splats.is_empty()) {
        return Err(error);
    }
    scans.set_meshes(meshes.paths());
    if options.plan.remove_moving
        && let (MeshMode::Sampled { .. }, Some(mesh)) = (options.reading.mesh, meshes.paths().next())
    {
        let reason = format!(
            "{}: points sampled from meshes could be removed as moving; take exact meshes, or keep what moves",
            mesh.display()
        );
        return Err(Error::parameter(Parameter::Other("mesh".into()), reason));
    }
    let (up, placement) = place(options, &mut scans, &meshes, &mut splats, &cubes, monitor)?;
    Ok(Inputs { scans, meshes, splats, cubes, units: options.reading.units, up, placement, chosen })
}

/// Places all inputs. Returns the direction that points up if it was found, and the placement.
fn place(
    options: &ConvertOptions,
    scans: &mut InputSet,
    meshes: &MeshSet,
    splats: &mut SplatSet,
    cubes: &CubeSet,
    monitor: &dyn Monitor,
) -> Result<(Option<UpFound>, Option<Similarity>)> {
    let refused = |path: &Path, reason: &str| {
        Err(Error::parameter(Parameter::Other("up".into()), format!("{}: {reason}", path.display())))
    };
    if options.reading.turn != Turn::None {
        if let Some(mesh) = meshes.paths().next() {
            return refused(mesh, "meshes are turned by --up y or z, or by --transform");
        }
        if let (Some(_), Some(scan)) = (scans.crs().filter(|_| options.reading.epsg.is_none()), scans.files().first()) {
            return refused(scan.path(), "it states a reference system, in which z is up; leave --up out");
        }
    }
    if let Some(file) =
        cubes.inputs().next().filter(|_| options.reading.turn != Turn::None || options.reading.placement.is_some())
    {
        return refused(file, "its cubes lie on the grid of pixels and are not moved; leave --up and --transform out");
    }
    let up = match options.reading.turn {
        Turn::Auto => {
            scans.set_placement(None);
            Some(upright::find_up(scans, splats, options, monitor)?)
        }
        _ => None,
    };
    let placement = options.placement_with(up.as_ref());
    let moved = match options.plan.up {
        _ if options.reading.placement.is_some() => Some("the matrix moves its points"),
        Up::Y => Some("its y axis is turned upwards"),
        Up::Z => None,
    };
    if let Some(moved) = moved
        && options.plan_file.is_none()
        && options.reading.epsg.is_none()
        && scans.crs().is_some()
    {
        let text = format!("a scan states a reference system; {moved}, and the archive keeps the system");
        monitor.warn(&text.into());
    }
    scans.set_placement(placement);
    splats.set_placement(placement);
    Ok((up, placement))
}
