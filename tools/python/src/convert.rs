//! `convert`, `write_plan` and `merge`: inputs into an archive.

use crate::attend::{Audience, attended};
use crate::errors::Failure;
use crate::options::{Asked, argument, part_of, paths};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyDict;
use serde_json::Value;
use slicewalk::archive::{merge as join, merge_run};
use slicewalk::{Error, Parameter};
use slicewalk_base::output::{Existing, Output, OutputKind, Protected, check, upload_archive};
use slicewalk_convert::PlanFile;
use slicewalk_convert::info::header_info;
use slicewalk_input::expand_inputs;
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Instant;

/// Converts a JSON value to Python objects.
pub fn dictionary<'py>(py: Python<'py>, facts: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (facts.to_string(),))
}

/// Converts scans (LAS, LAZ, COPC, E57, PTX, PTS, XYZ, CSV, PCD, PLY), meshes (OBJ, PLY, STL, glTF), Gaussian splats and
/// cubes (OctoMap, ``.voxel.json``) of any size into one slice archive, in bounded memory.
///
/// Either the complete archive appears under its name, or nothing does. The same points always give the same bytes.
/// Ctrl-C ends a conversion within a moment; nothing is left behind.
///
/// Args:
///     inputs: one path or any iterable of them: files, folders of scans, glob patterns. Scans may also be at https://
///         addresses and in object stores, where ``"s3://bucket/folder/"`` and patterns work, too; credentials come
///         from ``AWS_*`` in the environment
///     output: the archive to write: a file, or an address ``"s3://bucket/key"``
///     progress: called with stage, amount done, total (an estimate, 0 if unknown) and unit, on the calling thread, at
///         most 20 times a second; an exception that it raises ends the conversion
///     pixel: edge of a pixel (m), or ``"auto"``: four times the scan's point spacing
///     slice: height of a slice (m); three pixels by default
///     max_slope: steepest slope that a pawn can stand on (degrees, 45)
///     tolerance: largest error of heights, always outwards (m, 0), or ``"auto"``: at most the noise of the scan itself
///     classifier: ``"plane"``, ``"span"`` or ``"thesis"``
///     memory: memory budget, at least 64 MiB: bytes, or a text such as ``"512MiB"``
///     threads: worker threads; all cores by default
///     temp_dir: folder for temporary data
///     exclude_class: LAS classes to leave out, such as ``[7, 18]`` for noise, or a text such as ``"7,18,64-255"``
///     min_points: drop voxels with fewer points than this (1)
///     drop_isolated: drop voxels without any occupied voxel among their 26 neighbours
///     drop_floaters: drop connected components of up to this many voxels (1 to 65535); 1 means the same as
///         `drop_isolated`, and only one of the two may be given
///     fill_holes: close holes in floors up to this wide (m) with floor that the archive marks as inferred; ``"auto"``
///         takes three times the scan's point spacing
///     remove_moving: remove points that other stations of the scan saw through
///     free_space: also store which space the stations saw
///     stations: table ``file,x,y,z`` of the stations for `remove_moving` and `free_space`; E57 and PTX state
///         them themselves
///     removed: LAS file to write the removed points to
///     up: axis of the input that points up: ``"z"``, ``"y"``, and for scans and splats also ``"x"``, ``"-z"``, ``"-y"``,
///         ``"-x"``, or ``"auto"`` (as the floor shows)
///     transform: text file with a 4 × 4 matrix that moves the input
///     opacity: a place is solid if a Gaussian splat has this opacity there (0.1)
///     min_opacity: leave out splats whose opacity is lower (0)
///     max_size: leave out splats whose solid part is longer (m)
///     units: ``"auto"``, ``"m"``, ``"ft"``, ``"us-ft"``, or metres per unit
///     scale_from: two places of the input and their distance (m), from which the unit follows, such as
///         ``((0, 0, 0), (1.7, 0, 0), 0.9)``
///     crs: EPSG code for scans that state no reference system, such as ``"EPSG:25832"``; a scan that states another
///         one is refused
///     columns: columns of text files from left to right, such as ``"x,y,z,i,r,g,b"``; by default read from the header,
///         otherwise the first three
///     mesh: how meshes become voxels, ``"exact"`` or ``"sampled"``
///     levels: whether to add overview levels for previews and distant views (no)
///     colour: colour of each voxel: ``"rgb"``, ``"intensity"``, ``"class"``, ``"auto"`` (RGB if the scan has it,
///         otherwise intensity, otherwise none) or ``"off"``; for scans, not for meshes
///     colour_error: largest mean difference of a page's colours, in CIELAB (2); 0 keeps all 8 bits
///     allow_incomplete: convert the readable part of damaged input with warnings instead of refusing it
///     resume: continue an interrupted conversion, and keep the finished work if this one is interrupted
///     force: replace an existing archive
///     plan: take grid and options from this plan; options that contradict it are refused
///     shard: convert only this part, ``"2/8"`` or ``(2, 8)``
///     quiet: raise no warnings
///
/// Returns:
///     the dict that ``sliceconv --json`` prints, plus ``warnings``, the texts of all warnings, also with `quiet`
///
/// Raises:
///     InputError: an input cannot be used
///     OutputError: the archive exists already, or would replace an input
///     ParameterError: an option is invalid
///
/// Problems of the input that do not stop the conversion raise :class:`SlicewalkWarning`.
///
/// >>> report = slicewalk.convert("room.las", "again.slices", pixel=0.1, units="m")
/// >>> report["points_kept"], report["slices"]
/// (66400, 9)
#[pyfunction]
#[pyo3(signature = (inputs, output, *, progress=None, **options))]
pub fn convert<'py>(
    inputs: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = argument::output)] output: PathBuf,
    #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = inputs.py();
    let asked = Asked::new(paths("inputs", inputs)?, output, options)?;
    asked.check_code()?;
    let started = Instant::now();
    let audience = Audience { progress, quiet: asked.quiet, ..Audience::default() };
    let report = attended(py, &audience, None, |monitor| Ok(slicewalk_convert::convert(&asked.options, monitor)?))?;
    let mut facts = report.info();
    facts["seconds"] = started.elapsed().as_secs_f64().into();
    facts["warnings"] = audience.warnings.into_inner().into();
    dictionary(py, &facts)
}

/// Writes a plan that fixes grid, options and inputs of a conversion; ``convert(..., plan=, shard=)`` converts parts.
///
/// Args:
///     inputs: as for :func:`convert`
///     path: the plan to write (JSON)
///     progress: as for :func:`convert`
///     options: those of :func:`convert` except ``plan``, ``shard``, ``resume`` and ``removed``. Parts need
///         ``stations`` again
///
/// Returns:
///     the plan as a dict, with the number of inputs as ``inputs``: there may be hundreds of thousands, which only the
///     file lists. ``warnings`` holds the texts of all warnings, also with `quiet`
///
/// >>> plan = slicewalk.write_plan("room.las", "plan.json", pixel=0.1, units="m")
/// >>> for part in (1, 2):
/// ...     _ = slicewalk.convert("room.las", f"{part}.slices", plan="plan.json", shard=(part, 2))
#[pyfunction]
#[pyo3(signature = (inputs, path, *, progress=None, **options))]
pub fn write_plan<'py>(
    inputs: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = argument::path)] path: PathBuf,
    #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = inputs.py();
    Asked::refuse(options, |name| !matches!(name, "plan" | "shard" | "resume" | "removed"))?;
    let asked = Asked::new(paths("inputs", inputs)?, PathBuf::new(), options)?;
    asked.check_code()?;
    let audience = Audience { progress, quiet: asked.quiet, ..Audience::default() };
    let mut plan = attended(py, &audience, None, |monitor| {
        let kind = OutputKind::Plan(Existing::replaced_if(asked.options.overwrite));
        let output = Output::create(&path, kind, asked.options.inputs.iter().collect())?;
        let file = PlanFile::new(&asked.options, monitor)?;
        let mut facts = file.facts();
        facts["inputs"] = file.inputs.len().into();
        if monitor.cancelled_at_last() {
            return Err(Error::Interrupted.into());
        }
        file.write_to(output)?;
        Ok::<_, Failure>(facts)
    })?;
    plan["warnings"] = audience.warnings.into_inner().into();
    dictionary(py, &plan)
}

/// Joins the parts of a conversion. The archive equals that of a single run, byte for byte.
///
/// Args:
///     parts: archives that ``convert(..., plan=, shard=)`` wrote: all parts of one plan, in any order
///     output: the archive to write; left alone if it already has the right bytes
///     part: join only neighbouring parts into this part of a coarser cut: ``"2/8"`` or ``(2, 8)``. Merge it with the
///         other parts of that cut later, so that thousands of parts join as a tree
///     progress: as for :func:`convert`
///     force: replace an existing archive that holds something else
///
/// Returns:
///     the dict that ``slicetool merge --json`` prints
///
/// Raises:
///     InputError: a part is missing, damaged or belongs to another plan
///     OutputError: the archive exists already and holds something else
///
/// Every page is read and checked once. Takes about 10 MiB of memory, plus the metadata of each part.
///
/// >>> _ = slicewalk.write_plan("room.las", "plan.json", pixel=0.1, units="m")
/// >>> for part in (1, 2):
/// ...     _ = slicewalk.convert("room.las", f"{part}.slices", plan="plan.json", shard=(part, 2))
/// >>> slicewalk.merge(["1.slices", "2.slices"], "whole.slices")["shards"]
/// 2
#[pyfunction]
#[pyo3(signature = (parts, output, *, part=None, progress=None, force=false))]
pub fn merge<'py>(
    parts: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = argument::output)] output: PathBuf,
    part: Option<&Bound<'py, PyAny>>,
    #[pyo3(from_py_with = argument::progress)] progress: Option<&Bound<'py, PyAny>>,
    #[pyo3(from_py_with = argument::force)] force: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let py = parts.py();
    let (parts, part) = (paths("parts", parts)?, part.map(|part| part_of("part", part)).transpose()?);
    let merged = attended(py, &Audience { progress, ..Audience::default() }, None, |monitor| {
        Ok(match part {
            Some(part) => merge_run(&parts, part, &output, force, monitor).map_err(|error| match error {
                Error::Parameter { what: Parameter::Shard, reason } => Error::parameter("part", reason),
                error => error,
            })?,
            None => join(&parts, &output, force, monitor)?,
        })
    })?;
    let mut facts = header_info(&merged.header, &merged.crs, &merged.units);
    facts["written"] = merged.written.into();
    facts["shards"] = (parts.len() - merged.copies.len()).into();
    facts["copies_left_out"] = merged.copies.iter().map(|path| path.to_string_lossy().into_owned()).collect();
    facts["dropped"] = merged.dropped.into();
    dictionary(py, &facts)
}

/// Raises an error if an archive must not be written as `output`; for `slicewalk.cluster`.
#[pyfunction]
#[pyo3(name = "_check_output")]
pub fn check_output(py: Python<'_>, output: PathBuf, force: bool) -> PyResult<()> {
    attended(py, &Audience::default(), None, |_| {
        Ok(check(&output, OutputKind::Archive(Existing::replaced_if(force)), Protected::default())?)
    })
}

/// Returns the files that local inputs name, without inputs that name none; for `slicewalk.cluster`.
#[pyfunction]
#[pyo3(name = "_input_files")]
pub fn input_files(py: Python<'_>, inputs: Vec<PathBuf>) -> PyResult<Vec<OsString>> {
    let audience = Audience { quiet: true, ..Audience::default() };
    attended(py, &audience, None, |monitor| {
        let files = inputs.iter().filter_map(|input| expand_inputs(std::slice::from_ref(input), monitor).ok());
        Ok(files.flatten().map(PathBuf::into_os_string).collect())
    })
}

/// Uploads an archive to an address, all or nothing; for `slicewalk.cluster`.
#[pyfunction]
#[pyo3(name = "_upload_archive", signature = (path, address, *, force=false, progress=None))]
pub fn upload(
    py: Python<'_>,
    path: PathBuf,
    address: PathBuf,
    force: bool,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<bool> {
    let existing = if force { Existing::Replace } else { Existing::KeepSame };
    attended(py, &Audience { progress, ..Audience::default() }, None, |monitor| {
        Ok(upload_archive(&path, &address, existing, monitor)?)
    })
}

/// Writes an export, all or nothing, and never over an archive or a plan; for `slicewalk._bridges`.
#[pyfunction]
#[pyo3(name = "_write_export")]
pub fn write_export(py: Python<'_>, path: PathBuf, data: PyBackedBytes) -> PyResult<()> {
    attended(py, &Audience::default(), None, |monitor| {
        let mut output = Output::create(&path, OutputKind::Result, Protected::default())?;
        output.write_at(0, &data)?;
        if monitor.cancelled_at_last() {
            return Err(Error::Interrupted.into());
        }
        output.publish()?;
        Ok(())
    })
}
