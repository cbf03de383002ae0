//! Plan files as JSON.

use super::super::options::ReadingOptions;
use super::super::splats::SplatRules;
use super::super::upright::{Turn, UpFound};
use super::{InputFacts, PlanFile, Stated};
use crate::bytes::{ByteSource, open_named};
use crate::colour::{ColourPlan, ColourScale, ColourSource};
use crate::frame::Frame;
use crate::input::{StatedBounds, Units};
use crate::mesh::MeshMode;
use crate::output::{Existing, Output, OutputKind, Protected};
use crate::placement::Similarity;
use crate::plan::{ClassSet, Classifier, Noise, Plan, PlanOptions, Up};
use crate::text::BYTE_ORDER_MARK;
use crate::unit::{LengthUnit, UNIT_RANGE_M};
use crate::{Error, Result};
use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;
use std::borrow::Cow;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::Path;

/// Version of the plan files written and read.
const VERSION: u64 = 2;
/// Greatest length of a plan file (bytes); enough for half a million inputs.
const MAX_BYTES: u64 = 256 << 20;
/// Bytes read at once.
const READ_BYTES: usize = 1 << 20;

/// Layout of a plan file. Lengths in metres, angles in degrees.
#[derive(Serialize, Deserialize)]
struct PlanText<'a> {
    /// [`PLAN_KEY`](crate::output::PLAN_KEY).
    slicewalk_plan: u64,
    pixel_size: f64,
    slice_height: f64,
    max_slope: f64,
    tolerance: f64,
    #[serde(with = "named")]
    classifier: Classifier,
    min_points: u32,
    drop_floaters: u16,
    remove_moving: bool,
    fill_holes_pixels: u8,
    #[serde(with = "named")]
    up: Up,
    excluded_classes: Vec<u8>,
    #[serde(with = "hex")]
    plan_hash: u128,
    /// `"auto"`, or metres per unit.
    units: Value,
    /// `"EPSG:N"`.
    crs: Option<String>,
    columns: Option<String>,
    /// `"exact"`, `"sampled"`, or the distance of points.
    mesh: Value,
    levels: bool,
    free_space: bool,
    colour: Option<ColourText>,
    point_spacing: Option<f64>,
    placement: Option<[f64; 16]>,
    up_auto: Option<UpText>,
    splats: SplatText,
    tolerance_auto: Option<NoiseText>,
    stated: StatedText,
    inputs: Cow<'a, [InputFacts]>,
}

#[derive(Serialize, Deserialize)]
struct ColourText {
    #[serde(with = "named")]
    source: ColourSource,
    range: [u16; 2],
    error: f64,
}

#[derive(Serialize, Deserialize)]
struct UpText {
    direction: [f64; 3],
    axis: String,
    tilt_deg: f64,
    sure: f64,
    floor_m2: f64,
    next_m2: f64,
}

#[derive(Serialize, Deserialize)]
struct SplatText {
    opacity: f64,
    min_opacity: f64,
    max_size: Option<f64>,
}

#[derive(Serialize, Deserialize)]
struct NoiseText {
    noise: f64,
    regions: u64,
    region_size: f64,
}

#[derive(Serialize, Deserialize)]
struct StatedText {
    reference_system: Option<String>,
    /// Horizontal and vertical.
    length_units: Vec<[f64; 2]>,
}

#[derive(Serialize, Deserialize)]
struct BoundsText {
    min: [f64; 3],
    max: [f64; 3],
}

/// Names as on the command line.
mod named {
    use super::*;

    pub trait Named: Copy + 'static {
        const ALL: &'static [Self];
        fn name(self) -> &'static str;
    }

    macro_rules! named {
        ($($type:ident: $all:expr),*) => {
            $(impl Named for $type {
                const ALL: &'static [Self] = $all;
                fn name(self) -> &'static str {
                    self.name()
                }
            })*
        };
    }
    named!(Classifier: &Classifier::ALL, Up: &[Up::Z, Up::Y], ColourSource: &ColourSource::ALL);

    pub fn serialize<S: Serializer, T: Named>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(value.name())
    }

    pub fn deserialize<'de, D: Deserializer<'de>, T: Named>(deserializer: D) -> Result<T, D::Error> {
        let found = String::deserialize(deserializer)?;
        T::ALL.iter().copied().find(|value| value.name() == found).ok_or_else(|| {
            let names: Vec<_> = T::ALL.iter().map(|value| value.name()).collect();
            D::Error::custom(format!("{found:?} instead of {}", names.join(" or ")))
        })
    }
}

/// Hashes of 128 bits as 32 hexadecimal digits.
pub(in super::super) mod hex {
    use super::*;

    pub fn serialize<S: Serializer>(value: &u128, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{value:032x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u128, D::Error> {
        let text = String::deserialize(deserializer)?;
        let value = u128::from_str_radix(&text, 16).ok().filter(|_| text.len() == 32);
        value.ok_or_else(|| D::Error::custom(format!("{text:?} instead of 32 hexadecimal digits")))
    }
}

/// Bounds whose least corner is not above the greatest one, or null.
pub(in super::super) mod bounds {
    use super::*;

    pub fn serialize<S: Serializer>(value: &Option<StatedBounds>, serializer: S) -> Result<S::Ok, S::Error> {
        value.map(|StatedBounds { min, max }| BoundsText { min, max }).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<StatedBounds>, D::Error> {
        let Some(BoundsText { min, max }) = Option::deserialize(deserializer)? else { return Ok(None) };
        match (0..3).all(|axis| min[axis] <= max[axis]) {
            true => Ok(Some(StatedBounds { min, max })),
            false => Err(D::Error::custom("a least corner above the greatest one")),
        }
    }
}

/// Value of a plan file that cannot be used: its place, and what was expected or found.
struct Wrong(&'static str, String);

impl<'a> PlanText<'a> {
    fn of(file: &'a PlanFile, inputs: &'a [InputFacts]) -> Self {
        let PlanFile { plan: Plan { frame, options }, reading, .. } = file;
        Self {
            slicewalk_plan: VERSION,
            pixel_size: frame.pixel_m(),
            slice_height: frame.slice_m(),
            max_slope: options.max_slope_deg,
            tolerance: options.tolerance_m,
            classifier: options.classifier,
            min_points: options.min_points,
            drop_floaters: options.drop_floaters,
            remove_moving: options.remove_moving,
            fill_holes_pixels: options.fill_holes,
            up: options.up,
            excluded_classes: options.exclude_classes.iter().collect(),
            plan_hash: file.plan.hash(),
            units: match reading.units {
                Units::Auto => "auto".into(),
                Units::Factor(factor) => factor.into(),
            },
            crs: reading.epsg.map(|code| format!("EPSG:{code}")),
            columns: reading.columns.map(|columns| columns.to_string()),
            mesh: match reading.mesh {
                MeshMode::Exact => "exact".into(),
                MeshMode::Sampled { step_m: None } => "sampled".into(),
                MeshMode::Sampled { step_m: Some(step_m) } => step_m.into(),
            },
            levels: file.levels,
            free_space: file.free_space,
            colour: file.colour.map(|ColourPlan { scale: ColourScale { source, low, high }, error_milli }| {
                ColourText { source, range: [low, high], error: f64::from(error_milli) / 1000.0 }
            }),
            point_spacing: file.spacing_m,
            placement: reading.placement.map(|placement| placement.matrix()),
            up_auto: file.up.as_ref().map(|found| {
                let UpFound { up: direction, sure, floor_m2, next_m2 } = *found;
                let (axis, tilt_deg) = found.axis();
                UpText { direction, axis: axis.into(), tilt_deg, sure, floor_m2, next_m2 }
            }),
            splats: SplatText {
                opacity: reading.splats.opacity,
                min_opacity: reading.splats.min_opacity,
                max_size: reading.splats.max_size_m,
            },
            tolerance_auto: file.noise.map(|Noise { noise_m: noise, regions, region_m: region_size }| NoiseText {
                noise,
                regions,
                region_size,
            }),
            stated: StatedText {
                reference_system: file.stated.crs.clone(),
                length_units: file.stated.units.iter().map(|unit| [unit.horizontal_m, unit.vertical_m]).collect(),
            },
            inputs: inputs.into(),
        }
    }

    fn into_plan(self) -> Result<PlanFile, Wrong> {
        let wrong = |at, expected: &'static str| move || Wrong(at, format!("expected {expected}"));
        if self.slicewalk_plan != VERSION {
            return Err(Wrong("slicewalk_plan", format!("expected version {VERSION} of a plan")));
        }
        let options = PlanOptions {
            max_slope_deg: self.max_slope,
            tolerance_m: self.tolerance,
            classifier: self.classifier,
            min_points: self.min_points,
            drop_floaters: self.drop_floaters,
            remove_moving: self.remove_moving,
            fill_holes: self.fill_holes_pixels,
            up: self.up,
            exclude_classes: self.excluded_classes.into_iter().collect::<ClassSet>(),
        };
        let frame = Frame::new(self.pixel_size, self.slice_height);
        let plan =
            Plan { frame: frame.map_err(|error| Wrong("pixel_size, slice_height", error.to_string()))?, options };
        plan.options.check().map_err(|error| Wrong("plan", error.to_string()))?;
        if self.plan_hash != plan.hash() {
            let expected = format!("expected {:032x} for these options: the file was changed by hand", plan.hash());
            return Err(Wrong("plan_hash", expected));
        }
        let splats = SplatRules {
            opacity: self.splats.opacity,
            min_opacity: self.splats.min_opacity,
            max_size_m: self.splats.max_size,
        };
        splats.check().map_err(|error| Wrong("splats", error.to_string()))?;
        let reading = ReadingOptions {
            units: match (self.units.as_str(), self.units.as_f64()) {
                (Some("auto"), _) => Units::Auto,
                (_, Some(factor)) if UNIT_RANGE_M.contains(&factor) => Units::Factor(factor),
                _ => return Err(wrong("units", "auto or metres per unit")()),
            },
            epsg: self
                .crs
                .map(|text| {
                    text.strip_prefix("EPSG:")
                        .and_then(|code| code.parse().ok())
                        .ok_or_else(wrong("crs", "EPSG:N or null"))
                })
                .transpose()?,
            columns: self
                .columns
                .map(|text| text.parse().map_err(|_| wrong("columns", "names such as x,y,z or null")()))
                .transpose()?,
            mesh: match (self.mesh.as_str(), self.mesh.as_f64()) {
                (Some("exact"), _) => MeshMode::Exact,
                (Some("sampled"), _) => MeshMode::Sampled { step_m: None },
                (_, Some(step_m)) if step_m > 0.0 => MeshMode::Sampled { step_m: Some(step_m) },
                _ => return Err(wrong("mesh", "exact, sampled, or a distance of points in metres")()),
            },
            turn: Turn::None,
            placement: self
                .placement
                .map(|matrix| Similarity::of_matrix(matrix).map_err(|error| Wrong("placement", error)))
                .transpose()?,
            splats,
        };
        let mut file = PlanFile {
            plan,
            reading,
            levels: self.levels,
            free_space: self.free_space,
            colour: self.colour.map(ColourText::into_plan).transpose()?,
            spacing_m: self.point_spacing,
            up: self.up_auto.map(|UpText { direction, sure, floor_m2, next_m2, .. }| UpFound {
                up: direction,
                sure,
                floor_m2,
                next_m2,
            }),
            noise: self.tolerance_auto.map(NoiseText::into_noise).transpose()?,
            stated: self.stated.into_stated()?,
            inputs: self.inputs.into_owned(),
        };
        file.sort_inputs();
        Ok(file)
    }
}

impl ColourText {
    fn into_plan(self) -> Result<ColourPlan, Wrong> {
        let Self { source, range: [low, high], error } = self;
        let error_milli = (error * 1000.0).round();
        if low >= high {
            return Err(Wrong("colour.range", format!("expected the lower value first, found {low} and {high}")));
        }
        if !(0.0..=f64::from(u16::MAX)).contains(&error_milli) {
            return Err(Wrong("colour.error", format!("expected a difference from 0 to 65.535, found {error}")));
        }
        Ok(ColourPlan { scale: ColourScale { source, low, high }, error_milli: error_milli as u16 })
    }
}

impl NoiseText {
    fn into_noise(self) -> Result<Noise, Wrong> {
        let Self { noise: noise_m, regions, region_size: region_m } = self;
        match [noise_m, region_m].iter().all(|length| (0.0..=1e6).contains(length)) {
            true => Ok(Noise { noise_m, regions, region_m }),
            false => Err(Wrong("tolerance_auto", "expected lengths from 0 to 1e6 m".into())),
        }
    }
}

impl StatedText {
    fn into_stated(self) -> Result<Stated, Wrong> {
        let units = self.length_units.into_iter().map(|[horizontal_m, vertical_m]| {
            let within = UNIT_RANGE_M.contains(&horizontal_m) && UNIT_RANGE_M.contains(&vertical_m);
            within.then_some(LengthUnit { horizontal_m, vertical_m })
        });
        let units = units.collect::<Option<_>>();
        let expected = || Wrong("stated.length_units", "expected pairs of metres per unit".into());
        Ok(Stated { crs: self.reference_system, units: units.ok_or_else(expected)? })
    }
}

impl PlanFile {
    /// Returns the plan file as JSON, without the list of inputs, which may be long.
    pub fn facts(&self) -> Value {
        serde_json::to_value(PlanText::of(self, &[])).unwrap_or_default()
    }

    /// Writes the plan file to `path`, either all of it or nothing; replaces an older plan if `overwrite` is true.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<()> {
        self.write_to(Output::create(path, OutputKind::Plan(Existing::replaced_if(overwrite)), Protected::default())?)
    }

    /// Writes the plan file to an output that was created before the inputs were read, so that a file that must not be
    /// replaced was refused then.
    pub fn write_to(&self, output: Output) -> Result<()> {
        let path = output.name().to_path_buf();
        let mut text = BufWriter::new(output);
        self.write_text(&mut text).map_err(|error| Error::io(&path, "write", error))?;
        let output = text.into_inner().map_err(|error| Error::io(&path, "write", error.into_error()))?;
        output.publish().map(drop)
    }

    /// Writes the plan file as indented JSON.
    pub fn write_text(&self, text: &mut impl Write) -> io::Result<()> {
        serde_json::to_writer_pretty(&mut *text, &PlanText::of(self, &self.inputs))?;
        writeln!(text)
    }

    /// Reads the plan file at `path`.
    pub fn read(path: &Path) -> Result<Self> {
        let source = open_named(path)?;
        if source.len() > MAX_BYTES {
            let what = format!("bytes of the plan file {}", path.display());
            return Err(Error::limit(what, source.len(), MAX_BYTES));
        }
        let mut start = vec![0; source.len().min(BYTE_ORDER_MARK.len() as u64) as usize];
        source.read_at(0, &mut start)?;
        let at = if start == BYTE_ORDER_MARK { start.len() as u64 } else { 0 };
        let text =
            BufReader::with_capacity(source.len().clamp(1, READ_BYTES as u64) as usize, Text { source: &*source, at });
        let mut json = serde_json::Deserializer::from_reader(text);
        let again = "write the plan again";
        let text: PlanText<'_> = serde_path_to_error::deserialize(&mut json).map_err(|error| {
            let (at, error) = (error.path().to_string(), error.into_inner());
            match error.classify() {
                serde_json::error::Category::Io => Error::io(path, "read", error.into()),
                _ if at.starts_with('[') => {
                    Error::input(path, "line 1", format!("no plan in JSON: a list, expected an object; {again}"))
                }
                serde_json::error::Category::Data if at != "." => Error::input(path, at, format!("{error}; {again}")),
                _ => Error::input(path, format!("line {}", error.line()), format!("no plan in JSON: {error}; {again}")),
            }
        })?;
        json.end().map_err(|error| {
            Error::input(path, format!("line {}", error.line()), format!("no plan in JSON: {error}; {again}"))
        })?;
        text.into_plan().map_err(|Wrong(at, reason)| Error::input(path, at, format!("{reason}; {again}")))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ConvertOptions;
    use proptest::prelude::*;
    use serde_json::json;

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
            let stated = Stated {
                crs: flags.0.then(|| "EPSG:25832".to_owned()),
                units: vec![LengthUnit { horizontal_m: 0.3048, vertical_m: 1.0 }],
            };
            let placement = flags.1.then(|| Similarity::parse("0 -2 0 1.5\n2 0 0 -3\n0 0 2 1e6\n0 0 0 1").unwrap());
            let up = flags.0.then_some(UpFound { up: [0.0, pixel, -1.0], sure: 0.3, floor_m2: slice, next_m2: 0.1 });
            let splats = SplatRules { opacity: 0.2, min_opacity: 0.25, max_size_m: flags.0.then_some(slice) };
            let reading = ReadingOptions { units, turn: Turn::None, placement, epsg, columns, mesh, splats };
            let mut file = PlanFile {
                plan,
                reading,
                levels: rule % 2 == 0,
                free_space: flags.1,
                colour,
                spacing_m,
                up,
                noise,
                stated,
                inputs,
            };
            file.sort_inputs();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("plan.json");
            file.write(&path, false).unwrap();
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
            let options = ConvertOptions::new(Vec::new(), "a.slices".into());
            let good = PlanFile::of(Vec::new(), plan, &options).facts().to_string();
            prop_assert!(refused(&good[..cut % good.len()]));
        }
    }

    #[test]
    fn values_that_no_plan_has_are_refused_by_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.json");
        let plan = Plan::new(Frame::new(0.1, 0.3).unwrap());
        let good = PlanFile::of(Vec::new(), plan, &ConvertOptions::new(Vec::new(), "a.slices".into())).facts();
        let read = |text: &Value| {
            std::fs::write(&path, text.to_string()).unwrap();
            PlanFile::read(&path).map_err(|error| error.to_string())
        };
        read(&good).unwrap();
        // Editors on Windows begin a text with a byte order mark.
        std::fs::write(&path, format!("\u{feff}{good}")).unwrap();
        PlanFile::read(&path).unwrap();
        let rgb = ColourSource::Rgb.name();
        for (key, value, place) in [
            ("min_points", json!(0), "plan: "),
            ("splats", json!({ "opacity": 0.1, "min_opacity": 2.0, "max_size": null }), "splats: "),
            ("splats", json!({ "opacity": 0.1, "min_opacity": 0.0, "max_size": -1.0 }), "splats: "),
            ("units", json!("feet"), "units: expected"),
            ("crs", json!("25832"), "crs: expected"),
            ("columns", json!("a,b"), "columns: expected"),
            ("mesh", json!(-1.0), "mesh: expected"),
            ("placement", json!(vec![0.0; 16]), "placement: "),
            ("colour", json!({ "source": rgb, "range": [5, 5], "error": 1.0 }), "colour.range: expected"),
            ("colour", json!({ "source": rgb, "range": [0, 255], "error": 66.0 }), "colour.error: expected"),
            ("tolerance_auto", json!({ "noise": -1.0, "regions": 1, "region_size": 1.0 }), "tolerance_auto: expected"),
            (
                "stated",
                json!({ "reference_system": null, "length_units": [[0.0, 1.0]] }),
                "stated.length_units: expected",
            ),
        ] {
            let mut bad = good.clone();
            bad[key] = value;
            let error = read(&bad).unwrap_err();
            assert!(error.contains("plan.json") && error.contains(place), "{place}: {error}");
        }
    }

    #[test]
    fn a_plan_of_more_bytes_than_any_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.json");
        std::fs::File::create(&path).unwrap().set_len(MAX_BYTES + 1).unwrap();
        let error = PlanFile::read(&path).unwrap_err();
        assert!(matches!(error, Error::Limit { .. }) && error.to_string().contains("plan.json"), "{error}");
    }
}
