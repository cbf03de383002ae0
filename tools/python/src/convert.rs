//! `convert` and `write_plan`: scans and meshes into an archive.

use crate::attend::{Audience, attended};
use crate::errors::Failure;
use crate::options::{Asked, part_of, paths};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use slicewalk::archive::{merge as join, merge_run};
use slicewalk::convert::PlanFile;
use slicewalk::info::header_info;
use slicewalk::output::{Existing, Output, OutputKind, Protected, check, upload_archive};
use std::path::PathBuf;
use std::time::Instant;

/// Facts as Python's own values.
pub fn dictionary<'py>(py: Python<'py>, facts: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (facts.to_string(),))
}

/// Converts scans (LAS, LAZ, COPC, E57, PTX, PTS, XYZ, CSV, PCD, PLY) and meshes (OBJ, PLY, STL, glTF) of any size into one slice archive, in bounded memory.
///
/// The archive appears complete under its name, or not at all. The same points always give the same bytes. Ctrl-C ends a
/// conversion within a moment and leaves nothing behind.
///
/// Args:
///     inputs: one or many, in any iterable: files, folders of scans, glob patterns; scans also at https:// addresses and in object stores, where
///         ``"s3://bucket/folder/"`` and patterns work too, with credentials from ``AWS_*`` in the environment
///     output: the archive to write: a file, or an address ``"s3://bucket/key"``
///     progress: called with stage, amount done, total (an estimate, 0 if unknown) and unit, on this thread, at most 20 times
///         a second; what it raises ends the conversion
///     pixel: edge of a pixel (m), or ``"auto"``: four times the scan's point spacing
///     slice: height of a slice (m); three pixels by default
///     max_slope: steepest slope that can be stood on (degrees, 45)
///     tolerance: how far heights may be coarsened, always outwards (m, 0), or ``"auto"``: by no more than the scan's own noise
///     classifier: ``"plane"``, ``"span"`` or ``"thesis"``
///     memory: memory to use, at least 64 MiB: bytes, or a text such as ``"512MiB"``
///     threads: worker threads; all cores by default
///     temp_dir: folder for temporary data
///     exclude_class: LAS classes to leave out, such as ``[7, 18]`` for noise; also as a text, ``"7,18,64-255"``
///     min_points: drop voxels of fewer points (1)
///     drop_isolated: drop voxels without matter in any of the 26 around them
///     drop_floaters: drop connected matter of up to this many voxels (1 to 65535); 1 is `drop_isolated`, and only one of both is given
///     fill_holes: close holes in floors of up to this width (m) by floor that the archive marks as inferred
///     remove_moving, stations, removed: remove points that other stations of the scan saw through; a table `file,x,y,z` of the
///         stations, which E57 and PTX state themselves; a LAS file for what is removed
///     up: axis of the input that points up, ``"z"`` or ``"y"``
///     units: ``"auto"``, ``"m"``, ``"ft"``, ``"us-ft"``, or metres per unit
///     crs: EPSG code of scans that state no reference system, such as ``"EPSG:25832"``; one that states another is refused
///     columns: columns of text from left to right, such as ``"x,y,z,i,r,g,b"``; by its header, else the first three, by default
///     mesh: how meshes become voxels, ``"exact"`` or ``"sampled"``
///     levels: whether the archive gets overview levels for first looks and distant views (no)
///     colour: colour of each voxel: ``"rgb"``, ``"intensity"``, ``"class"``, ``"auto"`` (RGB where the scan has it, else intensity, else
///         none) or ``"off"``; of scans, not of meshes
///     colour_error: greatest mean difference of a page's colours, in CIELAB (2); 0 keeps them exactly, to 8 bits
///     allow_incomplete: convert what can be read of damaged input, with warnings, instead of refusing it
///     resume: go on from what an interrupted conversion left, and leave it if this one is interrupted
///     force: replace an existing archive
///     plan: take grid and options from this plan; those that contradict it are refused
///     shard: convert one part only, ``"2/8"`` or ``(2, 8)``
///     quiet: no warnings
///
/// Returns:
///     what ``sliceconv --json`` prints, as a dict, and ``warnings``, their texts, also if `quiet`
///
/// Raises:
///     InputError: an input cannot be used
///     OutputError: the archive exists already, or would replace an input
///     ParameterError: an option makes no sense
///
/// Soft problems of the input are :class:`SlicewalkWarning`.
///
/// >>> report = slicewalk.convert("room.las", "again.slices", pixel=0.1, units="m")
/// >>> report["points_kept"], report["slices"]
/// (66400, 9)
#[pyfunction]
#[pyo3(signature = (inputs, output, *, progress=None, **options))]
pub fn convert<'py>(
    inputs: &Bound<'py, PyAny>,
    output: PathBuf,
    progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = inputs.py();
    let asked = Asked::new(paths("inputs", inputs)?, output, options)?;
    asked.check_code()?;
    let started = Instant::now();
    let audience = Audience { progress, quiet: asked.quiet, ..Audience::default() };
    let report = attended(py, &audience, None, |monitor| Ok(slicewalk::convert::convert(&asked.options, monitor)?))?;
    let mut facts = report.info();
    facts["seconds"] = started.elapsed().as_secs_f64().into();
    facts["warnings"] = audience.warnings.into_inner().into();
    dictionary(py, &facts)
}

/// Fixes grid, options and inputs of a conversion in a plan, to be converted in parts with ``convert(..., plan=, shard=)``.
///
/// Args:
///     inputs: as for :func:`convert`
///     path: the plan to write (JSON)
///     progress: as for :func:`convert`
///     options: those of :func:`convert`, but for ``plan``, ``shard`` and ``resume``
///
/// Returns:
///     the plan as a dict, but for its inputs: ``inputs`` is their number. There may be hundreds of thousands; the file lists them.
///     ``warnings`` are texts, also if `quiet`
///
/// >>> plan = slicewalk.write_plan("room.las", "plan.json", pixel=0.1, units="m")
/// >>> for part in (1, 2):
/// ...     _ = slicewalk.convert("room.las", f"{part}.slices", plan="plan.json", shard=(part, 2))
#[pyfunction]
#[pyo3(signature = (inputs, path, *, progress=None, **options))]
pub fn write_plan<'py>(
    inputs: &Bound<'py, PyAny>,
    path: PathBuf,
    progress: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = inputs.py();
    Asked::refuse(options, |name| !matches!(name, "plan" | "shard" | "resume"))?;
    let asked = Asked::new(paths("inputs", inputs)?, PathBuf::new(), options)?;
    asked.check_code()?;
    let audience = Audience { progress, quiet: asked.quiet, ..Audience::default() };
    let mut plan = attended(py, &audience, None, |monitor| {
        let kind = OutputKind::Plan(Existing::replaced_if(asked.options.overwrite));
        let output = Output::create(&path, kind, asked.options.inputs.iter().collect())?;
        let file = PlanFile::new(&asked.options, monitor)?;
        let mut facts = file.facts();
        facts["inputs"] = file.inputs.len().into();
        file.write_to(output)?;
        Ok::<_, Failure>(facts)
    })?;
    plan["warnings"] = audience.warnings.into_inner().into();
    dictionary(py, &plan)
}

/// Joins the parts of a conversion into the archive of a single run, byte for byte.
///
/// Args:
///     parts: archives that ``convert(..., plan=, shard=)`` wrote: all parts of one plan, in any order
///     output: the archive to write; one that has the right bytes already is left alone
///     part: join neighbouring parts alone, into this part of a coarser cut: ``"2/8"`` or ``(2, 8)``. It is merged with the other
///         parts of that cut later, so that thousands of parts join as a tree
///     progress: as for :func:`convert`
///     force: replace an existing archive that holds something else
///
/// Returns:
///     what ``slicetool merge --json`` prints, as a dict
///
/// Raises:
///     InputError: a part is missing, foreign or damaged
///     OutputError: the archive exists already and holds something else
///
/// Every page is read and checked once. Memory: about 10 MiB, and the facts of each part.
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
    output: PathBuf,
    part: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    force: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let py = parts.py();
    let (parts, part) = (paths("parts", parts)?, part.map(|part| part_of("part", part)).transpose()?);
    let merged = attended(py, &Audience { progress, ..Audience::default() }, None, |monitor| {
        Ok(match part {
            Some(part) => merge_run(&parts, part, &output, force, monitor)?,
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

/// Refuses what an archive called `output` must not replace; for `slicewalk.cluster`.
#[pyfunction]
#[pyo3(name = "_check_output")]
pub fn check_output(py: Python<'_>, output: PathBuf, force: bool) -> PyResult<()> {
    attended(py, &Audience::default(), None, |_| {
        Ok(check(&output, OutputKind::Archive(Existing::replaced_if(force)), Protected::default())?)
    })
}

/// Uploads an archive to an address, whole or not at all; for `slicewalk.cluster`.
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
