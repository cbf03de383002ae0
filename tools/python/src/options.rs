//! Converts options from Python to the library's types.

use crate::arrays::short;
use crate::attend::{Audience, attended};
use crate::errors::{Failure, of_parameter};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyOverflowError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes, PyDict, PyString};
use slicewalk::plan::{ClassSet, Classifier};
use slicewalk::{Error, Parameter};
use slicewalk_convert::size::parse_size;
use slicewalk_convert::values::{UpChoice, class_range, epsg, transform, unit_from};
use slicewalk_convert::{ColourMode, ConvertOptions, HoleWidth, PixelSize, PlanFile, ShardOptions, Tolerance};
use slicewalk_input::{Columns, Units};
use slicewalk_mesh::MeshMode;
use std::path::PathBuf;
use std::str::FromStr;

/// Expected value of a switch.
const YES_OR_NO: &str = "True or False";

pub fn refuse(name: &str, reason: impl Into<String>) -> PyErr {
    Failure::from(Error::Parameter { what: Parameter::Other(name.to_owned()), reason: reason.into() }).into()
}

/// Converts an option's value to the type it needs; `expected` describes that type.
fn take<'py, T: FromPyObjectOwned<'py>>(name: &str, expected: &str, given: &Bound<'py, PyAny>) -> PyResult<T> {
    // Python would take True for 1.
    if expected != YES_OR_NO && given.extract::<bool>().is_ok() {
        return Err(wrong_type(given.py(), name, &format!("expected {expected}, found {}", short(given))));
    }
    given.extract::<T>().map_err(|error| wrong(name, expected, given, &Into::<PyErr>::into(error)))
}

/// Makes the error for a value that cannot be converted. It is also the error that Python raised.
fn wrong(name: &str, expected: &str, given: &Bound<'_, PyAny>, error: &PyErr) -> PyErr {
    let py = given.py();
    let reason = format!("expected {expected}, found {}", short(given));
    if error.is_instance_of::<PyTypeError>(py) {
        wrong_type(py, name, &reason)
    } else if error.is_instance_of::<PyOverflowError>(py) {
        of_parameter(py, "ParameterRangeError", name, &reason)
    } else {
        refuse(name, reason)
    }
}

/// Makes the error for a value of the wrong type.
pub fn wrong_type(py: Python<'_>, name: &str, reason: &str) -> PyErr {
    of_parameter(py, "ParameterTypeError", name, reason)
}

/// Readers of arguments, for `from_py_with`. Their errors name the argument, which those of PyO3 do not.
pub mod argument {
    use super::{YES_OR_NO, take, wrong_type};
    use crate::archive::Archive;
    use crate::arrays::short;
    use pyo3::prelude::*;
    use pyo3::types::PyString;
    use std::collections::HashMap;
    use std::num::NonZeroUsize;
    use std::path::PathBuf;

    macro_rules! arguments {
        ($($name:ident: $type:ty = $expected:expr;)*) => {
            $(pub fn $name(given: &Bound<'_, PyAny>) -> PyResult<$type> {
                take(stringify!($name), $expected, given)
            })*
        };
    }

    arguments! {
        climb: f64 = "metres";
        dt: f64 = "seconds";
        explain: bool = YES_OR_NO;
        force: bool = YES_OR_NO;
        gravity: f64 = "m/s²";
        hz: f64 = "frames per second";
        length: Option<f64> = "metres, or None";
        level: u32 = "0 or the number of an overview level";
        max_drop: Option<f64> = "metres, or None";
        max_grade: Option<f64> = "rise over run, or None";
        max_ramp: Option<f64> = "metres, or None";
        max_seconds: f64 = "seconds";
        number: u32 = "the number of an overview level";
        output: PathBuf = "a path";
        path: PathBuf = "a path";
        prefetch: bool = YES_OR_NO;
        retries: usize = "a whole number, 0 or more";
        seconds: f64 = "seconds";
        seen: bool = YES_OR_NO;
        speed: f64 = "metres per second";
        threads: Option<NonZeroUsize> = "a number of threads from 1 up, or None";
        timeout: f64 = "seconds";
        within: f64 = "metres";
        x: f64 = "metres";
        y: f64 = "metres";
    }

    pub fn archive<'a, 'py>(given: &'a Bound<'py, PyAny>) -> PyResult<&'a Bound<'py, Archive>> {
        let wrong = || wrong_type(given.py(), "archive", &format!("expected an Archive, found {}", short(given)));
        given.cast().map_err(|_| wrong())
    }

    pub fn progress<'a, 'py>(given: &'a Bound<'py, PyAny>) -> PyResult<Option<&'a Bound<'py, PyAny>>> {
        if !given.is_none() && !given.is_callable() {
            let reason = format!("expected a function, or None, found {}", short(given));
            return Err(wrong_type(given.py(), "progress", &reason));
        }
        Ok(Some(given).filter(|given| !given.is_none()))
    }

    pub fn response<'a>(given: &'a Bound<'_, PyAny>) -> PyResult<&'a str> {
        let wrong = || format!("expected slide, thesis or thesis-mean, found {}", short(given));
        given.cast::<PyString>().map_err(|_| wrong_type(given.py(), "response", &wrong()))?.to_str()
    }

    pub fn settings(given: &Bound<'_, PyAny>) -> PyResult<Option<HashMap<String, String>>> {
        // Without the settings, which may be secrets.
        given.extract().map_err(|_| wrong_type(given.py(), "settings", "expected a dict of texts by name, or None"))
    }
}

/// Reads a number in the library's type, or a text as on the command line.
fn number_or<T: FromStr<Err = String>>(
    name: &str,
    expected: &str,
    given: &Bound<'_, PyAny>,
    number: fn(f64) -> T,
) -> PyResult<T> {
    match given.cast::<PyString>() {
        Ok(text) => text.to_string().parse().map_err(|reason: String| refuse(name, reason)),
        Err(_) => take(name, expected, given).map(number),
    }
}

/// One of the words that the command line takes.
fn one_of<T: Copy>(name: &str, given: &Bound<'_, PyAny>, all: &[(&str, T)]) -> PyResult<T> {
    let words = all.iter().map(|(own, _)| *own).collect::<Vec<_>>().join(", ");
    let word: String = take(name, &format!("one of {words}"), given)?;
    let found = all.iter().find(|(own, _)| *own == word).map(|(_, value)| *value);
    found.ok_or_else(|| refuse(name, format!("expected one of {words}, found {word:?}")))
}

/// Reads a text like the command line does.
fn text_as<T: FromStr<Err = String>>(name: &str, expected: &str, given: &Bound<'_, PyAny>) -> PyResult<T> {
    take::<String>(name, expected, given)?.parse().map_err(|reason: String| refuse(name, reason))
}

/// Bytes, as a number or as a text such as `512MiB`.
pub fn size(name: &str, given: &Bound<'_, PyAny>) -> PyResult<u64> {
    match given.cast::<PyString>() {
        Ok(text) => parse_size(&text.to_string()).map_err(|reason| refuse(name, reason)),
        Err(_) => take(name, "a whole number of bytes, or a text such as \"512MiB\"", given),
    }
}

/// One or several paths.
pub fn paths(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<PathBuf>> {
    if let Ok(path) = given.extract::<PathBuf>() {
        return Ok(vec![path]);
    }
    let expected = "a path, or several";
    if given.is_instance_of::<PyBytes>() || given.is_instance_of::<PyByteArray>() {
        return Err(wrong_type(given.py(), name, &format!("expected {expected}, found {}", short(given))));
    }
    let items = given.try_iter().map_err(|error| wrong(name, expected, given, &error))?;
    let mut paths = Vec::new();
    for item in items {
        let item = item?;
        paths.push(take(&format!("{name}: item {}", paths.len()), "a path", &item)?);
    }
    if paths.is_empty() {
        return Err(refuse(name, format!("expected {expected}, found none")));
    }
    Ok(paths)
}

/// LAS classes: numbers, or a text as on the command line, such as `7,18,64-255`.
fn classes(given: &Bound<'_, PyAny>) -> PyResult<ClassSet> {
    let (name, expected) = ("exclude_class", "classes from 0 to 255, such as [7, 18] or \"7,18,64-255\"");
    if let Ok(text) = given.cast::<PyString>() {
        let text = text.to_string();
        let ranges: Option<Vec<_>> = text.split(',').map(|range| class_range(range).ok()).collect();
        let ranges = ranges.ok_or_else(|| refuse(name, format!("expected {expected}, found {text:?}")))?;
        return Ok(ranges.into_iter().flatten().collect());
    }
    match given.try_iter() {
        Ok(items) => items.map(|item| take::<u8>(name, expected, &item?)).collect(),
        Err(_) => take::<u8>(name, expected, given).map(|class| [class].into_iter().collect()),
    }
}

/// Part of a conversion, as on the command line: `"2/8"`, or the pair.
pub fn part_of(name: &str, given: &Bound<'_, PyAny>) -> PyResult<(u32, u32)> {
    let expected = "a part and their number, such as \"2/8\" or (2, 8)";
    let Ok(text) = given.cast::<PyString>() else { return take(name, expected, given) };
    let text = text.to_string();
    let part = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    part.ok_or_else(|| refuse(name, format!("expected {expected}, found {text:?}")))
}

/// Arguments of `convert`.
pub struct Asked {
    pub options: ConvertOptions,
    pub crs: String,
    pub quiet: bool,
}

impl Asked {
    /// Reads options by their names on the command line, with underscores.
    pub fn new(inputs: Vec<PathBuf>, output: PathBuf, given: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut options = ConvertOptions::new(inputs, output);
        let (mut crs, mut quiet, mut plan, mut shard, mut placement) = (String::new(), false, None, None, None);
        let (mut isolated, mut named) = (false, Vec::new());
        for (name, value) in given.into_iter().flatten() {
            let name: String = name.extract()?;
            if value.is_none() {
                continue;
            }
            let own = name.as_str();
            match own {
                "pixel" => {
                    options.grid.pixel = number_or(own, "metres, or \"auto\"", &value, PixelSize::Metres)?;
                }
                "slice" => options.grid.slice_m = Some(take(own, "metres", &value)?),
                "max_slope" => options.plan.max_slope_deg = take(own, "degrees", &value)?,
                "tolerance" => {
                    options.set_tolerance(number_or(own, "metres, or \"auto\"", &value, Tolerance::Metres)?);
                }
                "classifier" => {
                    let all = Classifier::ALL.map(|classifier| (classifier.name(), classifier));
                    options.plan.classifier = one_of(own, &value, &all)?;
                }
                "memory" => options.resources.memory_bytes = size(own, &value)?,
                "threads" => {
                    let threads: std::num::NonZeroU16 = take(own, "a number of threads from 1 to 65535", &value)?;
                    options.resources.threads = threads.get().into();
                }
                "temp_dir" => options.resources.temp_dir = take(own, "a folder", &value)?,
                "exclude_class" => options.plan.exclude_classes = classes(&value)?,
                "min_points" => {
                    let points: std::num::NonZeroU32 = take(own, "a number of points from 1 up", &value)?;
                    options.plan.min_points = points.get();
                }
                "drop_isolated" => isolated = take(own, YES_OR_NO, &value)?,
                "drop_floaters" => {
                    let floaters: std::num::NonZeroU16 = take(own, "a number of voxels from 1 to 65535", &value)?;
                    options.plan.drop_floaters = floaters.get();
                }
                "remove_moving" => options.plan.remove_moving = take(own, YES_OR_NO, &value)?,
                "free_space" => options.sections.free_space = take(own, YES_OR_NO, &value)?,
                "fill_holes" => {
                    options.grid.fill_holes = Some(number_or(own, "metres, or \"auto\"", &value, HoleWidth::Metres)?);
                }
                "stations" => options.stations = Some(take(own, "a file", &value)?),
                "removed" => options.removed = Some(take(own, "a file", &value)?),
                "up" => {
                    let up: UpChoice = text_as(own, "one of auto, z, y, x, -z, -y, -x", &value)?;
                    (options.plan.up, options.reading.turn) = (up.axis, up.turn);
                }
                "scale_from" => {
                    let expected = "two places and their distance in metres, such as ((0, 0, 0), (1.7, 0, 0), 0.9)";
                    let (from, to, metres) = take(own, expected, &value)?;
                    options.reading.units = unit_from(from, to, metres).map_err(|reason| refuse(own, reason))?;
                }
                "transform" => placement = Some(take::<PathBuf>(own, "a file", &value)?),
                "opacity" => options.reading.splats.opacity = take(own, "a number", &value)?,
                "min_opacity" => options.reading.splats.min_opacity = take(own, "a number", &value)?,
                "max_size" => options.reading.splats.max_size_m = Some(take(own, "metres", &value)?),
                "units" => {
                    options.reading.units =
                        number_or(own, "a unit such as \"m\", or metres per unit", &value, Units::Factor)?;
                }
                "columns" => {
                    options.reading.columns =
                        Some(text_as::<Columns>(own, "a text such as \"x,y,z,i,r,g,b\"", &value)?);
                }
                "mesh" => {
                    let all = [("exact", MeshMode::Exact), ("sampled", MeshMode::Sampled { step_m: None })];
                    options.reading.mesh = one_of(own, &value, &all)?;
                }
                "levels" => {
                    options.sections.levels = match value.extract::<bool>() {
                        Ok(levels) => levels,
                        Err(_) if value.cast::<PyString>().is_ok() => {
                            one_of(own, &value, &[("on", true), ("off", false)])?
                        }
                        Err(_) => take(own, YES_OR_NO, &value)?,
                    };
                }
                "colour" => options.sections.colour = text_as::<ColourMode>(own, "a text such as \"rgb\"", &value)?,
                "colour_error" => options.sections.colour_error = take(own, "a number", &value)?,
                "allow_incomplete" => options.allow_incomplete = take(own, YES_OR_NO, &value)?,
                "resume" => options.resume = take(own, YES_OR_NO, &value)?,
                "force" => options.overwrite = take(own, YES_OR_NO, &value)?,
                "plan" => plan = Some(take::<PathBuf>(own, "a file", &value)?),
                "shard" => shard = Some(part_of(own, &value)?),
                "quiet" => quiet = take(own, YES_OR_NO, &value)?,
                "crs" => {
                    crs = take::<String>(own, "a text such as \"EPSG:25832\"", &value)?;
                    options.reading.epsg = epsg(&crs).ok();
                }
                other => {
                    let text =
                        format!("got an unexpected keyword argument {other:?}; help(slicewalk.convert) lists all");
                    return Err(PyTypeError::new_err(text));
                }
            }
            named.push(name);
        }
        let is_named = |name: &str| named.iter().any(|own| own == name);
        if isolated && is_named("drop_floaters") {
            return Err(refuse("drop_isolated", "is drop_floaters=1, which is given too; leave one of them out"));
        }
        options.plan.drop_floaters = options.plan.drop_floaters.max(isolated.into());
        if is_named("scale_from") && is_named("units") {
            return Err(refuse("scale_from", "is the unit, which is given too; leave one of them out"));
        }
        // A plan may lie in an object store, which may be slow.
        let read = |path: PathBuf| {
            Python::attach(|py| attended(py, &Audience::default(), None, |_| Ok(PlanFile::read(&path)?)))
        };
        let plan_file = plan.map(read).transpose()?;
        options.reading.placement = placement.map(|path| transform(&path)).transpose().map_err(Failure::from)?;
        if let Some(file) = &plan_file {
            if let Some(name) = named.iter().find(|name| file.contradicts(name, &options)) {
                return Err(refuse(name, "contradicts the plan; leave it out, or write another plan"));
            }
            file.apply_to(&mut options);
        }
        if is_named("stations") && !options.needs_stations() {
            return Err(refuse("stations", "is for remove_moving=True and free_space=True; give one of these, too"));
        }
        if is_named("removed") && !options.plan.remove_moving {
            return Err(refuse("removed", "is for remove_moving=True; give both, or none"));
        }
        options.plan_file = plan_file;
        options.shard = shard.map(|(index, count)| ShardOptions { index, count });
        Ok(Self { options, crs, quiet })
    }

    /// Refuses a reference system that is not an EPSG code: scans state their own, and the code is for those that do
    /// not.
    pub fn check_code(&self) -> PyResult<()> {
        if self.crs.is_empty() || self.options.reading.epsg.is_some() {
            return Ok(());
        }
        Err(refuse("crs", format!("expected a code such as \"EPSG:25832\", found {:?}", self.crs)))
    }

    /// Refuses options that do not apply here.
    pub fn refuse(given: Option<&Bound<'_, PyDict>>, has_meaning: impl Fn(&str) -> bool) -> PyResult<()> {
        for name in given.into_iter().flat_map(|given| given.keys()) {
            let name: String = name.extract()?;
            if !has_meaning(&name) {
                return Err(PyTypeError::new_err(format!("got an unexpected keyword argument {name:?}")));
            }
        }
        Ok(())
    }
}
