//! Options of a conversion as JSON, named and meant as in Python.

use serde_json::Value;
use slicewalk::plan::{ClassSet, Classifier};
use slicewalk_base::{Error, Parameter, Result};
use slicewalk_convert::size::parse_size;
use slicewalk_convert::values::{UpChoice, class_range, epsg, unit_from};
use slicewalk_convert::{ConvertOptions, HoleWidth, PixelSize, Tolerance};
use slicewalk_input::{Columns, Units};
use slicewalk_mesh::MeshMode;
use std::str::FromStr;

fn wrong(name: &str, reason: impl Into<String>) -> Error {
    Error::parameter(Parameter::Other(name.to_owned()), reason)
}

fn refuse(name: &str, expected: &str, found: &Value) -> Error {
    wrong(name, format!("expected {expected}, found {found}"))
}

fn number(name: &str, expected: &str, value: &Value) -> Result<f64> {
    value.as_f64().ok_or_else(|| refuse(name, expected, value))
}

fn whole(name: &str, most: u32, value: &Value) -> Result<u32> {
    let number = value.as_u64().filter(|number| (1..=u64::from(most)).contains(number));
    number.map(|number| number as u32).ok_or_else(|| refuse(name, &format!("a whole number from 1 to {most}"), value))
}

fn flag(name: &str, value: &Value) -> Result<bool> {
    value.as_bool().ok_or_else(|| refuse(name, "true or false", value))
}

fn text<T: FromStr<Err = String>>(name: &str, expected: &str, value: &Value) -> Result<T> {
    let text = value.as_str().ok_or_else(|| refuse(name, expected, value))?;
    text.parse().map_err(|reason: String| wrong(name, reason))
}

/// Reads a number, or a text as on the command line.
fn number_or<T: FromStr<Err = String>>(name: &str, expected: &str, value: &Value, make: fn(f64) -> T) -> Result<T> {
    if value.is_string() { text(name, expected, value) } else { number(name, expected, value).map(make) }
}

fn one_of<T: Copy>(name: &str, all: &[(&str, T)], value: &Value) -> Result<T> {
    let found = value.as_str().and_then(|word| all.iter().find(|(own, _)| *own == word));
    let words = || all.iter().map(|(own, _)| *own).collect::<Vec<_>>().join(", ");
    found.map(|(_, value)| *value).ok_or_else(|| refuse(name, &format!("one of {}", words()), value))
}

fn classes(name: &str, value: &Value) -> Result<ClassSet> {
    let expected = "classes from 0 to 255, such as [7, 18] or \"7,18,64-255\"";
    let range = |text: &str| class_range(text).ok();
    let of_number = |value: &Value| value.as_u64().and_then(|class| u8::try_from(class).ok());
    let found: Option<ClassSet> = match value {
        Value::String(text) => {
            text.split(',').map(range).collect::<Option<Vec<_>>>().map(|ranges| ranges.into_iter().flatten().collect())
        }
        Value::Array(all) => all.iter().map(of_number).collect(),
        other => of_number(other).map(|class| [class].into_iter().collect()),
    };
    found.ok_or_else(|| refuse(name, expected, value))
}

/// Sets the options that `given` names. Those about files, threads and parts have no meaning in a browser.
pub fn apply(options: &mut ConvertOptions, given: &Value) -> Result<()> {
    let Some(given) = given.as_object() else { return Ok(()) };
    for (name, value) in given.iter().filter(|(_, value)| !value.is_null()) {
        let own = name.as_str();
        match own {
            "pixel" => options.grid.pixel = number_or(own, "metres, or \"auto\"", value, PixelSize::Metres)?,
            "slice" => options.grid.slice_m = Some(number(own, "metres", value)?),
            "max_slope" => options.plan.max_slope_deg = number(own, "degrees", value)?,
            "tolerance" => {
                options.set_tolerance(number_or(own, "metres, or \"auto\"", value, Tolerance::Metres)?);
            }
            "classifier" => {
                let all = Classifier::ALL.map(|classifier| (classifier.name(), classifier));
                options.plan.classifier = one_of(own, &all, value)?;
            }
            "memory" => {
                options.resources.memory_bytes = match value.as_str() {
                    Some(size) => parse_size(size).map_err(|_| refuse(own, "a size such as \"512MiB\"", value))?,
                    None => value.as_u64().ok_or_else(|| refuse(own, "bytes, or a size such as \"512MiB\"", value))?,
                };
            }
            "exclude_class" => options.plan.exclude_classes = classes(own, value)?,
            "min_points" => options.plan.min_points = whole(own, u32::MAX, value)?,
            "drop_isolated" => {
                if flag(own, value)? {
                    options.plan.drop_floaters = options.plan.drop_floaters.max(1);
                }
            }
            "drop_floaters" => options.plan.drop_floaters = whole(own, u16::MAX.into(), value)? as u16,
            "remove_moving" => options.plan.remove_moving = flag(own, value)?,
            "free_space" => options.sections.free_space = flag(own, value)?,
            "fill_holes" => {
                options.grid.fill_holes = Some(number_or(own, "metres, or \"auto\"", value, HoleWidth::Metres)?);
            }
            "up" => {
                let up: UpChoice = text(own, "one of auto, z, y, x, -z, -y, -x", value)?;
                (options.plan.up, options.reading.turn) = (up.axis, up.turn);
            }
            "units" => options.reading.units = number_or(own, "a unit such as \"m\"", value, Units::Factor)?,
            "scale_from" => {
                let expected = "two places and their distance in metres, such as [[0, 0, 0], [1.7, 0, 0], 0.9]";
                let (from, to, metres): ([f64; 3], [f64; 3], f64) =
                    serde_json::from_value(value.clone()).map_err(|_| refuse(own, expected, value))?;
                options.reading.units = unit_from(from, to, metres).map_err(|reason| wrong(own, reason))?;
            }
            "crs" => {
                let code = value.as_str().and_then(|text| epsg(text).ok());
                options.reading.epsg = Some(code.ok_or_else(|| refuse(own, "a code such as \"EPSG:25832\"", value))?);
            }
            "columns" => options.reading.columns = Some(text::<Columns>(own, "a text such as \"x,y,z\"", value)?),
            "mesh" => {
                let all = [("exact", MeshMode::Exact), ("sampled", MeshMode::Sampled { step_m: None })];
                options.reading.mesh = one_of(own, &all, value)?;
            }
            "opacity" => options.reading.splats.opacity = number(own, "a number", value)?,
            "min_opacity" => options.reading.splats.min_opacity = number(own, "a number", value)?,
            "max_size" => options.reading.splats.max_size_m = Some(number(own, "metres", value)?),
            "levels" => {
                options.sections.levels = match value.as_bool() {
                    Some(levels) => levels,
                    None => one_of(own, &[("on", true), ("off", false)], value)?,
                };
            }
            "colour" => options.sections.colour = text(own, "a text such as \"rgb\"", value)?,
            "colour_error" => options.sections.colour_error = number(own, "a number", value)?,
            "allow_incomplete" => options.allow_incomplete = flag(own, value)?,
            other => return Err(wrong(other, "is no option of a conversion in the browser")),
        }
    }
    let is_given = |name: &str| given.get(name).is_some_and(|value| !value.is_null());
    if given.get("drop_isolated").and_then(Value::as_bool) == Some(true) && is_given("drop_floaters") {
        return Err(wrong("drop_isolated", "is drop_floaters: 1, which is given too; leave one of them out"));
    }
    if is_given("scale_from") && is_given("units") {
        return Err(wrong("scale_from", "is the unit, which is given too; leave one of them out"));
    }
    Ok(())
}
