//! Options as Python gives them, in the library's own types.

use crate::errors::Failure;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use slicewalk::convert::{ColourMode, ConvertOptions, PixelSize, PlanFile, ShardOptions, Tolerance};
use slicewalk::input::{Columns, Units};
use slicewalk::mesh::MeshMode;
use slicewalk::plan::{Classifier, Up};
use slicewalk::size::parse_size;
use slicewalk::{Error, Parameter};
use std::path::PathBuf;
use std::str::FromStr;

pub fn refuse(name: &str, reason: impl Into<String>) -> PyErr {
    Failure::from(Error::Parameter { what: Parameter::Other(name.to_owned()), reason: reason.into() }).into()
}

/// A number in the library's type, or what a text on the command line would mean.
fn number_or<T: FromStr<Err = String>>(name: &str, given: &Bound<'_, PyAny>, number: fn(f64) -> T) -> PyResult<T> {
    match given.cast::<PyString>() {
        Ok(text) => text.to_string().parse().map_err(|reason: String| refuse(name, reason)),
        Err(_) => given.extract().map(number),
    }
}

/// One of the words that the command line takes.
fn one_of<T: Copy>(name: &str, given: &Bound<'_, PyAny>, all: &[(&str, T)]) -> PyResult<T> {
    let word: String = given.extract()?;
    let found = all.iter().find(|(own, _)| *own == word).map(|(_, value)| *value);
    let words = || all.iter().map(|(own, _)| *own).collect::<Vec<_>>().join(", ");
    found.ok_or_else(|| refuse(name, format!("expected one of {}, found {word:?}", words())))
}

/// Bytes, as a number or as a text such as `512MiB`.
pub fn size(name: &str, given: &Bound<'_, PyAny>) -> PyResult<u64> {
    match given.cast::<PyString>() {
        Ok(text) => parse_size(&text.to_string()).map_err(|reason| refuse(name, reason)),
        Err(_) => given.extract(),
    }
}

/// One path, or a sequence of them.
pub fn paths(given: &Bound<'_, PyAny>) -> PyResult<Vec<PathBuf>> {
    given.extract::<PathBuf>().map(|path| vec![path]).or_else(|_| given.extract())
}

/// What the command line calls a part: `"2/8"`, or the pair.
pub fn part_of(name: &str, given: &Bound<'_, PyAny>) -> PyResult<(u32, u32)> {
    let Ok(text) = given.cast::<PyString>() else { return given.extract() };
    let text = text.to_string();
    let part = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    part.ok_or_else(|| refuse(name, format!("expected a part and their number, such as \"2/8\", found {text:?}")))
}

/// What `convert` was asked for.
pub struct Asked {
    pub options: ConvertOptions,
    pub crs: String,
    pub quiet: bool,
}

impl Asked {
    /// Reads options by their names on the command line, with underscores.
    pub fn new(inputs: Vec<PathBuf>, output: PathBuf, given: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut options = ConvertOptions::new(inputs, output);
        let (mut crs, mut quiet, mut plan, mut shard) = (String::new(), false, None, None);
        let mut named = Vec::new();
        for (name, value) in given.into_iter().flatten() {
            let name: String = name.extract()?;
            if value.is_none() {
                continue;
            }
            match name.as_str() {
                "pixel" => options.pixel = number_or("pixel", &value, PixelSize::Metres)?,
                "slice" => options.slice_m = Some(value.extract()?),
                "max_slope" => options.plan.max_slope_deg = value.extract()?,
                "tolerance" => options.set_tolerance(number_or("tolerance", &value, Tolerance::Metres)?),
                "classifier" => {
                    let all = Classifier::ALL.map(|classifier| (classifier.name(), classifier));
                    options.plan.classifier = one_of("classifier", &value, &all)?;
                }
                "memory" => options.memory_bytes = size("memory", &value)?,
                "threads" => options.threads = value.extract::<std::num::NonZeroU16>()?.get().into(),
                "temp_dir" => options.temp_dir = value.extract()?,
                "exclude_class" => options.plan.exclude_classes = value.extract::<Vec<u8>>()?.into_iter().collect(),
                "min_points" => options.plan.min_points = value.extract()?,
                "drop_isolated" => {
                    let isolated = u16::from(value.extract::<bool>()?);
                    options.plan.drop_floaters = options.plan.drop_floaters.max(isolated);
                }
                "drop_floaters" => {
                    options.plan.drop_floaters = options.plan.drop_floaters.max(value.extract()?);
                }
                "remove_moving" => options.plan.remove_moving = value.extract()?,
                "fill_holes" => options.fill_holes_m = Some(value.extract()?),
                "stations" => options.stations = value.extract()?,
                "removed" => options.removed = value.extract()?,
                "up" => options.plan.up = one_of("up", &value, &[("z", Up::Z), ("y", Up::Y)])?,
                "units" => options.units = number_or("units", &value, Units::Factor)?,
                "columns" => {
                    let text = value.extract::<String>()?;
                    options.columns = Some(text.parse::<Columns>().map_err(|reason| refuse("columns", reason))?);
                }
                "mesh" => {
                    let all = [("exact", MeshMode::Exact), ("sampled", MeshMode::Sampled { step_m: None })];
                    options.mesh = one_of("mesh", &value, &all)?;
                }
                "levels" => {
                    options.levels = match value.extract::<bool>() {
                        Ok(levels) => levels,
                        Err(_) => one_of("levels", &value, &[("on", true), ("off", false)])?,
                    };
                }
                "colour" => {
                    let text = value.extract::<String>()?;
                    options.colour = text.parse::<ColourMode>().map_err(|reason| refuse("colour", reason))?;
                }
                "colour_error" => options.colour_error = value.extract()?,
                "allow_incomplete" => options.allow_incomplete = value.extract()?,
                "resume" => options.resume = value.extract()?,
                "force" => options.overwrite = value.extract()?,
                "plan" => plan = Some(value.extract::<PathBuf>()?),
                "shard" => shard = Some(part_of("shard", &value)?),
                "quiet" => quiet = value.extract()?,
                "crs" => {
                    crs = value.extract::<String>()?;
                    let code = crs.strip_prefix("EPSG:").and_then(|code| code.parse().ok());
                    options.epsg = code.filter(|code| (1..1_000_000).contains(code));
                }
                other => {
                    let text =
                        format!("got an unexpected keyword argument {other:?}; help(slicewalk.convert) lists all");
                    return Err(PyTypeError::new_err(text));
                }
            }
            named.push(name);
        }
        // With the interpreter free: a plan may lie in a store.
        let read = |path: PathBuf| match given {
            Some(given) => given.py().detach(|| PlanFile::read(&path)),
            None => PlanFile::read(&path),
        };
        let plan_file = plan.map(read).transpose().map_err(Failure::from)?;
        if let Some(file) = &plan_file {
            let wanted = options.clone();
            file.apply_to(&mut options);
            refuse_contradictions(&named, &wanted, &options, file)?;
        }
        options.plan_file = plan_file;
        options.shard = shard.map(|(index, count)| ShardOptions { index, count });
        Ok(Self { options, crs, quiet })
    }

    /// Refuses a reference system that is no EPSG code: scans have theirs, and the code is for those that state none.
    pub fn check_code(&self) -> PyResult<()> {
        if self.crs.is_empty() || self.options.epsg.is_some() {
            return Ok(());
        }
        Err(refuse("crs", format!("expected a code such as \"EPSG:25832\", found {:?}", self.crs)))
    }

    /// Refuses options that have no meaning here.
    pub fn refuse(given: Option<&Bound<'_, PyDict>>, names: &[&str]) -> PyResult<()> {
        for name in names {
            if given.is_some_and(|given| given.contains(name).unwrap_or(false)) {
                return Err(PyTypeError::new_err(format!("got an unexpected keyword argument {name:?}")));
            }
        }
        Ok(())
    }
}

/// Refuses options that were named and say otherwise than the plan.
fn refuse_contradictions(
    named: &[String],
    wanted: &ConvertOptions,
    planned: &ConvertOptions,
    file: &PlanFile,
) -> PyResult<()> {
    let same_holes = || match planned.pixel {
        PixelSize::Metres(pixel_m) => {
            wanted.fill_holes_pixels(pixel_m).is_ok_and(|pixels| pixels == planned.plan.fill_holes)
        }
        _ => false,
    };
    let differs = |name: &str| match name {
        "pixel" => wanted.pixel != planned.pixel,
        "slice" => wanted.slice_m != planned.slice_m,
        "units" => wanted.units != planned.units,
        "crs" => wanted.epsg != planned.epsg,
        "columns" => wanted.columns != planned.columns,
        "mesh" => wanted.mesh != planned.mesh,
        "levels" => wanted.levels != planned.levels,
        "colour" => wanted.colour != ColourMode::Auto && wanted.colour != planned.colour,
        "colour_error" => wanted.colour_error != planned.colour_error,
        "max_slope" => wanted.plan.max_slope_deg != planned.plan.max_slope_deg,
        "tolerance" => !file.has_tolerance_of(wanted),
        "classifier" => wanted.plan.classifier != planned.plan.classifier,
        "exclude_class" => wanted.plan.exclude_classes != planned.plan.exclude_classes,
        "min_points" => wanted.plan.min_points != planned.plan.min_points,
        "drop_isolated" | "drop_floaters" => wanted.plan.drop_floaters != planned.plan.drop_floaters,
        "remove_moving" => wanted.plan.remove_moving != planned.plan.remove_moving,
        "fill_holes" => !same_holes(),
        "up" => wanted.plan.up != planned.plan.up,
        _ => false,
    };
    match named.iter().find(|name| differs(name)) {
        Some(name) => Err(refuse(name, "contradicts the plan; leave it out, or write another plan")),
        None => Ok(()),
    }
}
