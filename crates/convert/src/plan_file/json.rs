//! Plan files as JSON.

use super::super::splats::SplatRules;
use super::super::upright::UpFound;
use super::{InputFacts, PlanFile, Stated};
use crate::bytes::{ByteSource, open_named};
use crate::colour::{ColourPlan, ColourScale, ColourSource};
use crate::frame::Frame;
use crate::info::{noise_info, up_info};
use crate::input::{StatedBounds, Units};
use crate::mesh::MeshMode;
use crate::output::{Existing, Output, OutputKind, PLAN_KEY, Protected};
use crate::placement::Similarity;
use crate::plan::{ClassSet, Classifier, Noise, Plan, PlanOptions, Up};
use crate::unit::{LengthUnit, UNIT_RANGE_M};
use crate::{Error, Result};
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Value, json};
use std::fmt;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::Path;

/// Version of the plan files written and read.
pub const VERSION: u64 = 2;
/// Greatest length of a plan file (bytes); enough for half a million inputs.
const MAX_BYTES: u64 = 256 << 20;
/// Bytes read at once.
const READ_BYTES: usize = 1 << 20;

impl PlanFile {
    /// Returns the plan file as JSON, without the list of inputs, which may be long.
    pub fn facts(&self) -> Value {
        let plan = &self.plan;
        json!({
            (PLAN_KEY): VERSION,
            "pixel_size": plan.frame.pixel_m(),
            "slice_height": plan.frame.slice_m(),
            "max_slope": plan.options.max_slope_deg,
            "tolerance": plan.options.tolerance_m,
            "classifier": plan.options.classifier.name(),
            "min_points": plan.options.min_points,
            // For builds that know only isolated voxels; they refuse the hash of any other number.
            "drop_isolated": plan.options.drop_floaters == 1,
            "drop_floaters": plan.options.drop_floaters,
            "remove_moving": plan.options.remove_moving,
            "fill_holes_pixels": plan.options.fill_holes,
            "up": plan.options.up.name(),
            "excluded_classes": plan.options.exclude_classes.iter().collect::<Vec<_>>(),
            "plan_hash": format!("{:032x}", plan.hash()),
            "units": match self.units {
                Units::Auto => json!("auto"),
                Units::Factor(factor) => json!(factor),
            },
            "crs": self.epsg.map(|code| format!("EPSG:{code}")),
            "columns": self.columns.map(|columns| columns.to_string()),
            "mesh": match self.mesh {
                MeshMode::Exact => json!("exact"),
                MeshMode::Sampled { step_m: None } => json!("sampled"),
                MeshMode::Sampled { step_m: Some(step_m) } => json!(step_m),
            },
            "levels": self.levels,
            "colour": self.colour.map(|ColourPlan { scale, error_milli }| json!({
                "source": scale.source.name(),
                "range": [scale.low, scale.high],
                "error": f64::from(error_milli) / 1000.0,
            })),
            "point_spacing": self.spacing_m,
            "placement": self.placement.map(|placement| placement.matrix()),
            "up_auto": self.up.as_ref().map(up_info),
            "splats": {
                "opacity": self.splats.opacity,
                "min_opacity": self.splats.min_opacity,
                "max_size": self.splats.max_size_m,
            },
            "tolerance_auto": self.noise.as_ref().map(noise_info),
            "stated": self.stated.as_ref().map(|Stated { crs, units }| json!({
                "reference_system": crs,
                "length_units": units.iter().map(|unit| [unit.horizontal_m, unit.vertical_m]).collect::<Vec<_>>(),
            })),
            "inputs": [],
        })
    }

    /// Writes the plan file to `path`, either all of it or nothing; replaces an older plan if `overwrite` is true.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<()> {
        self.write_to(Output::create(path, OutputKind::Plan(Existing::replaced_if(overwrite)), Protected::default())?)
    }

    /// Writes the plan file to an output that was created before the inputs were read, so that a file that must not be
    /// replaced was refused then. Memory: one input at a time.
    pub fn write_to(&self, output: Output) -> Result<()> {
        let path = output.name().to_path_buf();
        let mut text = BufWriter::new(output);
        self.write_text(&mut text).map_err(|error| Error::io(&path, "write", error))?;
        let output = text.into_inner().map_err(|error| Error::io(&path, "write", error.into_error()))?;
        output.publish().map(drop)
    }

    /// Writes the plan file as indented JSON, input by input.
    pub fn write_text(&self, text: &mut impl Write) -> io::Result<()> {
        // The list of inputs comes last.
        let facts = format!("{:#}", self.facts());
        let Some(facts) = facts.strip_suffix("[]\n}").filter(|_| !self.inputs.is_empty()) else {
            return writeln!(text, "{facts}");
        };
        write!(text, "{facts}[")?;
        for (number, input) in self.inputs.iter().enumerate() {
            let input = format!("{:#}", input_to_json(input)).replace('\n', "\n    ");
            write!(text, "{}\n    {input}", if number > 0 { "," } else { "" })?;
        }
        writeln!(text, "\n  ]\n}}")
    }

    /// Reads the plan file at `path`.
    pub fn read(path: &Path) -> Result<Self> {
        let source = open_named(path)?;
        if source.len() > MAX_BYTES {
            let what = format!("bytes of the plan file {}", path.display());
            return Err(Error::limit(what, source.len(), MAX_BYTES));
        }
        let mut start = [0; 3];
        let start = &mut start[..source.len().min(3) as usize];
        source.read_at(0, start)?;
        let at = if start == "\u{feff}".as_bytes() { 3 } else { 0 };
        let text =
            BufReader::with_capacity(source.len().clamp(1, READ_BYTES as u64) as usize, Text { source: &*source, at });
        let read: Read = serde_json::from_reader(text).map_err(|error| match error.classify() {
            serde_json::error::Category::Io => Error::io(path, "read", error.into()),
            _ => {
                let reason = format!("no plan in JSON: {error}; write it again");
                Error::input(path, format!("line {}", error.line()), reason)
            }
        })?;
        from_json(read).map_err(|wrong| {
            let Wrong { at, expected } = wrong;
            Error::input(path, at, format!("expected {expected}; write the plan again"))
        })
    }
}

/// Reader of the text of a plan file, from `at`.
struct Text<'a> {
    source: &'a dyn ByteSource,
    at: u64,
}

impl io::Read for Text<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = bytes.len().min(usize::try_from(self.source.len().saturating_sub(self.at)).unwrap_or(usize::MAX));
        self.source.read_at(self.at, &mut bytes[..count]).map_err(|error| match error {
            Error::Io { source, .. } => source,
            other => io::Error::other(other.to_string()),
        })?;
        self.at += count as u64;
        Ok(count)
    }
}

fn input_to_json(input: &InputFacts) -> Value {
    json!({
        "name": input.name,
        "bytes": input.bytes,
        "points": input.points,
        "fingerprint": format!("{:032x}", input.fingerprint),
        "bounds": input.bounds.map(|bounds| json!({ "min": bounds.min, "max": bounds.max })),
    })
}

/// Plan file as read. Each input becomes facts at once: as JSON, an input would take a kilobyte or more.
struct Read {
    facts: Value,
    /// `None` without a list of inputs.
    inputs: Option<Result<Vec<InputFacts>, Wrong>>,
}

impl<'de> Deserialize<'de> for Read {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ReadVisitor)
    }
}

struct ReadVisitor;

impl<'de> Visitor<'de> for ReadVisitor {
    type Value = Read;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Read, A::Error> {
        let (mut facts, mut inputs) = (serde_json::Map::new(), None);
        while let Some(key) = map.next_key::<String>()? {
            match &key[..] {
                "inputs" => inputs = map.next_value::<Inputs>()?.0,
                _ => drop(facts.insert(key, map.next_value()?)),
            }
        }
        Ok(Read { facts: Value::Object(facts), inputs })
    }
}

/// The inputs, or `None` if the value is not a list.
struct Inputs(Option<Result<Vec<InputFacts>, Wrong>>);

impl<'de> Deserialize<'de> for Inputs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(InputsVisitor)
    }
}

struct InputsVisitor;

impl<'de> Visitor<'de> for InputsVisitor {
    type Value = Inputs;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of files")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Inputs, A::Error> {
        let mut inputs = Ok(Vec::new());
        let mut at = 0u64;
        while let Some(value) = list.next_element::<Value>()? {
            if let Ok(known) = &mut inputs {
                match input_from_json(&value) {
                    Ok(input) => known.push(input),
                    Err(w) => inputs = Err(Wrong::new(format!("inputs[{at}].{}", w.at), w.expected)),
                }
            }
            at += 1;
        }
        if let Ok(known) = &mut inputs {
            known.shrink_to_fit();
        }
        Ok(Inputs(Some(inputs)))
    }
}

/// Error in a plan file.
struct Wrong {
    at: String,
    expected: String,
}

impl Wrong {
    fn new(at: impl Into<String>, expected: impl ToString) -> Self {
        Self { at: at.into(), expected: expected.to_string() }
    }
}

/// Reads one field of an object with `read`.
fn field<'a, T>(
    of: &'a Value,
    name: &str,
    expected: &str,
    read: impl FnOnce(&'a Value) -> Option<T>,
) -> Result<T, Wrong> {
    of.get(name).and_then(read).ok_or_else(|| Wrong::new(name, expected))
}

fn hex(value: &Value) -> Option<u128> {
    value.as_str().filter(|text| text.len() == 32).and_then(|text| u128::from_str_radix(text, 16).ok())
}

fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|number| number.is_finite())
}

fn from_json(Read { facts, inputs }: Read) -> Result<PlanFile, Wrong> {
    let value = &facts;
    field(value, PLAN_KEY, "version 2 of a plan", |v| v.as_u64().filter(|&version| version == VERSION))?;
    let frame = Frame::new(
        field(value, "pixel_size", "a length in metres", number)?,
        field(value, "slice_height", "a length in metres", number)?,
    );
    let classifier = |v: &Value| Classifier::ALL.into_iter().find(|rule| Some(rule.name()) == v.as_str());
    let up = |v: &Value| [Up::Z, Up::Y].into_iter().find(|up| Some(up.name()) == v.as_str());
    let classes = |v: &Value| {
        let classes = v.as_array()?.iter();
        classes.map(|class| u8::try_from(class.as_u64()?).ok()).collect::<Option<ClassSet>>()
    };
    // Missing in plans of earlier builds.
    let drop_floaters = match value.get("drop_floaters") {
        None => u16::from(field(value, "drop_isolated", "true or false", Value::as_bool)?),
        Some(_) => field(value, "drop_floaters", "a number of voxels", |v| u16::try_from(v.as_u64()?).ok())?,
    };
    let remove_moving = match value.get("remove_moving") {
        None => false,
        Some(_) => field(value, "remove_moving", "true or false", Value::as_bool)?,
    };
    let fill_holes = match value.get("fill_holes_pixels") {
        None => 0,
        Some(_) => field(value, "fill_holes_pixels", "a number of pixels", |v| u8::try_from(v.as_u64()?).ok())?,
    };
    let frame = frame.map_err(|error| Wrong::new("pixel_size, slice_height", format!("a grid, but {error}")))?;
    let options = PlanOptions {
        max_slope_deg: field(value, "max_slope", "an angle in degrees", number)?,
        tolerance_m: field(value, "tolerance", "a length in metres", number)?,
        classifier: field(value, "classifier", "span, thesis or plane", classifier)?,
        min_points: field(value, "min_points", "a number of points", |v| u32::try_from(v.as_u64()?).ok())?,
        drop_floaters,
        remove_moving,
        fill_holes,
        up: field(value, "up", "z or y", up)?,
        exclude_classes: field(value, "excluded_classes", "a list of classes from 0 to 255", classes)?,
    };
    options.check().map_err(|error| Wrong::new("plan", format!("options within their limits, but {error}")))?;
    let plan = Plan { frame, options };
    let stated = field(value, "plan_hash", "32 hexadecimal digits", hex)?;
    if stated != plan.hash() {
        let expected = format!("{:032x} for these options: the file was changed by hand", plan.hash());
        return Err(Wrong::new("plan_hash", expected));
    }
    let units = |v: &Value| match v.as_f64() {
        Some(factor) => Some(Units::Factor(factor)).filter(|_| factor.is_finite() && factor > 0.0),
        None => (v.as_str() == Some("auto")).then_some(Units::Auto),
    };
    // Missing in plans of earlier builds.
    let epsg = match value.get("crs") {
        None | Some(Value::Null) => None,
        Some(text) => {
            let code = text.as_str().and_then(|text| text.strip_prefix("EPSG:")?.parse().ok());
            Some(code.ok_or_else(|| Wrong::new("crs", "EPSG:N or null"))?)
        }
    };
    let columns = match value.get("columns") {
        None | Some(Value::Null) => None,
        Some(text) => {
            let columns = text.as_str().and_then(|text| text.parse().ok());
            Some(columns.ok_or_else(|| Wrong::new("columns", "names such as x,y,z or null"))?)
        }
    };
    let mesh = |v: &Value| match (v.as_str(), number(v)) {
        (Some("exact"), _) => Some(MeshMode::Exact),
        (Some("sampled"), _) => Some(MeshMode::Sampled { step_m: None }),
        (_, Some(step_m)) if step_m > 0.0 => Some(MeshMode::Sampled { step_m: Some(step_m) }),
        _ => None,
    };
    let spacing = |v: &Value| if v.is_null() { Some(None) } else { number(v).map(Some) };
    let colour = match value.get("colour") {
        None | Some(Value::Null) => None,
        Some(colour) => Some(colour_from_json(colour).map_err(|w| Wrong::new(format!("colour.{}", w.at), w.expected))?),
    };
    let inputs = inputs.unwrap_or_else(|| Err(Wrong::new("inputs", "a list of files")))?;
    let mut file = PlanFile {
        plan,
        units: field(value, "units", "auto or metres per unit", units)?,
        epsg,
        columns,
        mesh: field(value, "mesh", "exact, sampled, or a distance of points in metres", mesh)?,
        // Missing in plans of earlier builds, whose archives have no levels.
        levels: value.get("levels").map_or(Ok(false), |_| field(value, "levels", "true or false", Value::as_bool))?,
        colour,
        spacing_m: field(value, "point_spacing", "a length in metres or null", spacing)?,
        // Missing in plans of earlier builds.
        up: match value.get("up_auto") {
            None | Some(Value::Null) => None,
            Some(up) => Some(up_from_json(up)?),
        },
        placement: match value.get("placement") {
            None | Some(Value::Null) => None,
            Some(matrix) => Some(placement_from_json(matrix)?),
        },
        splats: match value.get("splats") {
            None => SplatRules::default(),
            Some(rules) => splats_from_json(rules)?,
        },
        noise: match value.get("tolerance_auto") {
            None | Some(Value::Null) => None,
            Some(noise) => Some(noise_from_json(noise)?),
        },
        // Missing in plans of earlier builds.
        stated: match value.get("stated") {
            None | Some(Value::Null) => None,
            Some(stated) => Some(stated_from_json(stated)?),
        },
        inputs,
    };
    file.sort_inputs();
    Ok(file)
}

fn stated_from_json(value: &Value) -> Result<Stated, Wrong> {
    let crs = |v: &Value| if v.is_null() { Some(None) } else { v.as_str().map(|text| Some(text.to_owned())) };
    let unit = |v: &Value| {
        let [horizontal, vertical] = &v.as_array()?[..] else { return None };
        let length = |v: &Value| number(v).filter(|length| UNIT_RANGE_M.contains(length));
        Some(LengthUnit { horizontal_m: length(horizontal)?, vertical_m: length(vertical)? })
    };
    let units = |v: &Value| v.as_array()?.iter().map(unit).collect::<Option<Vec<_>>>();
    let stated = (|| {
        Ok(Stated {
            crs: field(value, "reference_system", "a text or null", crs)?,
            units: field(value, "length_units", "pairs of metres per unit", units)?,
        })
    })();
    stated.map_err(|wrong: Wrong| Wrong { at: format!("stated.{}", wrong.at), ..wrong })
}

fn placement_from_json(value: &Value) -> Result<Similarity, Wrong> {
    let wrong = |why: String| Wrong::new("placement", format!("a matrix of 16 numbers, but {why}"));
    let numbers = value.as_array().and_then(|numbers| numbers.iter().map(number).collect::<Option<Vec<_>>>());
    let matrix = numbers.and_then(|numbers| <[f64; 16]>::try_from(numbers).ok());
    Similarity::of_matrix(matrix.ok_or_else(|| wrong("it is none".into()))?).map_err(wrong)
}

fn up_from_json(value: &Value) -> Result<UpFound, Wrong> {
    let direction = |v: &Value| {
        let [x, y, z] = &v.as_array()?[..] else { return None };
        Some([number(x)?, number(y)?, number(z)?])
    };
    let found = (|| {
        Ok(UpFound {
            up: field(value, "direction", "three numbers", direction)?,
            sure: field(value, "sure", "a number from 0 to 1", number)?,
            floor_m2: field(value, "floor_m2", "an area", number)?,
            next_m2: field(value, "next_m2", "an area", number)?,
        })
    })();
    found.map_err(|wrong: Wrong| Wrong { at: format!("up_auto.{}", wrong.at), ..wrong })
}

fn splats_from_json(value: &Value) -> Result<SplatRules, Wrong> {
    let size = |v: &Value| if v.is_null() { Some(None) } else { number(v).map(Some) };
    let rules = (|| {
        Ok(SplatRules {
            opacity: field(value, "opacity", "an opacity", number)?,
            min_opacity: field(value, "min_opacity", "an opacity", number)?,
            max_size_m: field(value, "max_size", "a length in metres or null", size)?,
        })
    })();
    let rules: SplatRules = rules.map_err(|wrong: Wrong| Wrong { at: format!("splats.{}", wrong.at), ..wrong })?;
    rules.check().map_err(|error| Wrong::new("splats", format!("rules within their limits, but {error}")))?;
    Ok(rules)
}

fn noise_from_json(value: &Value) -> Result<Noise, Wrong> {
    let length = |v: &Value| number(v).filter(|length| (0.0..=1e6).contains(length));
    let field = |name: &str| field(value, name, "a length in metres", length);
    let regions = self::field(value, "regions", "a number of regions", Value::as_u64);
    let noise = (|| Ok(Noise { noise_m: field("noise")?, regions: regions?, region_m: field("region_size")? }))();
    noise.map_err(|wrong: Wrong| Wrong { at: format!("tolerance_auto.{}", wrong.at), ..wrong })
}

fn colour_from_json(value: &Value) -> Result<ColourPlan, Wrong> {
    let source = |v: &Value| ColourSource::ALL.into_iter().find(|source| Some(source.name()) == v.as_str());
    let range = |v: &Value| {
        let ends = v.as_array().filter(|ends| ends.len() == 2)?;
        let end = |at: usize| u16::try_from(ends[at].as_u64()?).ok();
        Some((end(0)?, end(1)?)).filter(|(low, high)| low < high)
    };
    let milli = |v: &Value| {
        let milli = (number(v)? * 1000.0).round();
        (0.0..=f64::from(u16::MAX)).contains(&milli).then_some(milli as u16)
    };
    let (low, high) = field(value, "range", "two values from 0 to 65535, the lower one first", range)?;
    let source = field(value, "source", "rgb, intensity or class", source)?;
    let error_milli = field(value, "error", "a difference from 0 to 65.535", milli)?;
    Ok(ColourPlan { scale: ColourScale { source, low, high }, error_milli })
}

fn input_from_json(value: &Value) -> Result<InputFacts, Wrong> {
    let corner = |v: &Value| -> Option<[f64; 3]> {
        let axes = v.as_array().filter(|axes| axes.len() == 3)?;
        Some([number(&axes[0])?, number(&axes[1])?, number(&axes[2])?])
    };
    let bounds = |v: &Value| {
        if v.is_null() {
            return Some(None);
        }
        let (min, max) = (corner(v.get("min")?)?, corner(v.get("max")?)?);
        (0..3).all(|axis| min[axis] <= max[axis]).then_some(Some(StatedBounds { min, max }))
    };
    Ok(InputFacts {
        name: field(value, "name", "a file name", Value::as_str)?.to_owned(),
        bytes: field(value, "bytes", "a length", Value::as_u64)?,
        points: field(value, "points", "a number of points", Value::as_u64)?,
        fingerprint: field(value, "fingerprint", "32 hexadecimal digits", hex)?,
        bounds: field(value, "bounds", "least and greatest corner, or null", bounds)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn input() -> impl Strategy<Value = InputFacts> {
        let bounds = proptest::option::of((prop::array::uniform3(-1e7f64..1e7), prop::array::uniform3(0.0f64..1e6)));
        (any::<String>(), any::<u64>(), any::<u64>(), any::<u128>(), bounds).prop_map(
            |(name, bytes, points, fingerprint, bounds)| {
                let bounds = bounds.map(|(min, size)| {
                    let max = std::array::from_fn(|axis| min[axis] + size[axis]);
                    StatedBounds { min, max }
                });
                InputFacts { name, bytes, points, fingerprint, bounds }
            },
        )
    }

    fn whole(file: &PlanFile) -> Value {
        let mut facts = file.facts();
        facts["inputs"] = file.inputs.iter().map(input_to_json).collect();
        facts
    }

    proptest! {
        #[test]
        fn plans_come_back_to_the_last_bit(
            sizes in (1e-4f64..1e3, 1e-4f64..1e3, 0.0f64..=90.0, 0.0f64..1.0), rule in 0usize..3, min_points in 1u32..,
            drop_floaters: u16, flags: (bool, bool), classes: [u64; 4], units in proptest::option::of(1e-3f64..1e3), epsg: Option<u32>,
            spacing_m in proptest::option::of(1e-6f64..1e3), inputs in proptest::collection::vec(input(), 0..5)
        ) {
            let (pixel, slice, max_slope_deg, tolerance_m) = sizes;
            let options = PlanOptions {
                max_slope_deg,
                tolerance_m,
                classifier: Classifier::ALL[rule],
                min_points,
                drop_floaters,
                remove_moving: flags.1,
                fill_holes: (drop_floaters % 46) as u8,
                up: if flags.0 { Up::Y } else { Up::Z },
                exclude_classes: ClassSet::from_words(classes),
                    };
            let plan = Plan { frame: Frame::new(pixel, slice).unwrap(), options };
            let units = units.map_or(Units::Auto, Units::Factor);
            let mesh = [MeshMode::Exact, MeshMode::Sampled { step_m: None }, MeshMode::Sampled { step_m: Some(pixel) }][rule];
            let noise = flags.0.then_some(Noise { noise_m: pixel / 7.0, regions: u64::from(min_points), region_m: 0.25 });
            let columns = [None, Some("z,-,y,x".parse().unwrap()), Some("x,y,z,class".parse().unwrap())][rule];
            let colour = (rule > 0).then(|| ColourPlan {
                scale: ColourScale { source: ColourSource::ALL[rule], low: drop_floaters / 2, high: drop_floaters / 2 + 9 },
                error_milli: drop_floaters,
            });
            let stated = flags.1.then(|| Stated {
                crs: flags.0.then(|| "EPSG:25832".to_owned()),
                units: vec![LengthUnit { horizontal_m: 0.3048, vertical_m: 1.0 }],
            });
            let placement = flags.1.then(|| Similarity::parse("0 -2 0 1.5\n2 0 0 -3\n0 0 2 1e6\n0 0 0 1").unwrap());
            let up = flags.0.then_some(UpFound { up: [0.0, pixel, -1.0], sure: 0.3, floor_m2: slice, next_m2: 0.1 });
            let splats = SplatRules { opacity: 0.2, min_opacity: 0.25, max_size_m: flags.0.then_some(slice) };
            let mut file = PlanFile {
                plan,
                units,
                epsg,
                columns,
                mesh,
                levels: rule % 2 == 0,
                colour,
                spacing_m,
                up,
                placement,
                splats,
                noise,
                stated,
                inputs,
            };
            file.sort_inputs();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("plan.json");
            file.write(&path, false).unwrap();
            prop_assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{:#}\n", whole(&file)));
            let again = PlanFile::read(&path).unwrap();
            prop_assert_eq!(again.hash(), file.hash());
            prop_assert_eq!(again, file);
        }

        #[test]
        fn text_that_is_no_plan_is_refused_in_one_line(text in "[ -~\n]{0,80}", cut in 0usize..2000) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("plan.json");
            let refused = |text: &str| {
                std::fs::write(&path, text).unwrap();
                let error = PlanFile::read(&path).unwrap_err().to_string();
                error.lines().count() == 1 && error.contains("plan.json")
            };
            prop_assert!(refused(&text));
            let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
            let good = PlanFile { plan, units: Units::Auto, epsg: None, columns: None, mesh: MeshMode::Exact, levels: true, colour: None, spacing_m: None, up: None, placement: None, splats: SplatRules::default(), noise: None, stated: None, inputs: Vec::new() }.facts().to_string();
            prop_assert!(refused(&good[..cut % good.len()]));
        }
    }
}
