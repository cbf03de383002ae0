//! The XML part of an E57: its clouds, their columns and poses.
//!
//! Parsed as a tree by `roxmltree`, which rejects document types and thus custom entities. Length, nodes and attributes
//! are limited beforehand.

use super::super::values::Scale;
use super::super::{Pose, shown};
use roxmltree::{Document, Node, ParsingOptions};

/// Limits on the text (bytes), its nodes and its attributes: about 64 MiB as a tree.
pub(super) const MOST_BYTES: u64 = 16 << 20;
const MOST_NODES: u32 = 400_000;
const MOST_ATTRIBUTES: usize = 400_000;
/// Maximum number of columns per cloud.
const MOST_COLUMNS: usize = 1024;

/// A column of the points of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    pub name: String,
    pub kind: Kind,
    /// Minimum and maximum of a column of floats, if stated.
    range: Option<(f64, f64)>,
}

/// Storage type of the values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Single,
    Double,
    /// Whole numbers from `min` on; the value is the number times `scale` plus `offset`.
    Integer {
        min: i64,
        max: i64,
        scale: f64,
        offset: f64,
    },
}

impl Kind {
    /// Returns the bits per value [0..=64].
    pub fn bits(&self) -> u32 {
        match self {
            Self::Single => 32,
            Self::Double => 64,
            Self::Integer { min, max, .. } => 64 - (max.wrapping_sub(*min) as u64).leading_zeros(),
        }
    }
}

/// A cloud as described by the file.
#[derive(Debug)]
pub(super) struct Description {
    pub name: String,
    /// Physical offset of its points.
    pub at: u64,
    pub records: u64,
    pub columns: Vec<Column>,
    /// `None` for the identity.
    pub pose: Option<Pose>,
    /// Scanner position: the origin of its own coordinates. `None` if no pose is stated.
    pub station: Option<[f64; 3]>,
    /// Stated limits of red, green, blue and intensity.
    limits: [Option<(f64, f64)>; 4],
}

/// Names of the value columns, in the order of the limits.
pub(super) const CHANNELS: [&str; 4] = ["colorRed", "colorGreen", "colorBlue", "intensity"];

/// Limits of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Limits {
    /// Black is 0, white is 255.
    Bytes,
    Between(Scale),
    /// No usable limits.
    Unstated,
}

impl Limits {
    /// Returns the limits with these values of black and white; `None` if they leave no usable range.
    pub fn of((black, white): (f64, f64)) -> Option<Self> {
        let scale = Scale::between(black, white)?;
        Some(if (black, white) == (0.0, 255.0) { Self::Bytes } else { Self::Between(scale) })
    }
}

/// Content of the XML.
#[derive(Default)]
pub(super) struct Contents {
    pub clouds: Vec<Result<Description, Undescribed>>,
    pub images: usize,
    /// Text of the reference system.
    pub system: Option<String>,
}

/// A cloud with an unusable description, and the number of points it states.
pub(super) struct Undescribed {
    pub wrong: Wrong,
    pub points: u64,
}

/// Fault of a description.
pub(super) enum Wrong {
    /// Damage: location and reason.
    Damaged(String, String),
    /// A feature, within the standard or beyond, that is not supported.
    Unsupported(String),
}

fn damaged<T>(at: impl Into<String>, reason: impl Into<String>) -> Result<T, Wrong> {
    Err(Wrong::Damaged(at.into(), reason.into()))
}

fn child<'a, 'i>(of: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    of.children().find(|node| node.is_element() && node.tag_name().name() == name)
}

fn number(node: Option<Node<'_, '_>>) -> Option<Result<f64, String>> {
    let node = node?;
    // An empty element means 0.
    let text = node.text().map_or("", str::trim);
    let parsed = if text.is_empty() { Ok(0.0) } else { text.parse::<f64>() };
    Some(parsed.ok().filter(|v| v.is_finite()).ok_or_else(|| {
        format!("expected a finite number in {}, found {}", node.tag_name().name(), shown(text.as_bytes()))
    }))
}

impl Contents {
    pub fn parse(xml: &str) -> Result<Self, Wrong> {
        let count = |wanted: u8| xml.bytes().filter(|&byte| byte == wanted).count();
        if count(b'=') > MOST_ATTRIBUTES {
            return damaged("XML", format!("more than {MOST_ATTRIBUTES} attributes"));
        }
        // The parser reserves a node for each of them before it checks its limit; elements have up to two.
        if count(b'<') > 2 * MOST_NODES as usize {
            return damaged("XML", format!("more than {MOST_NODES} nodes"));
        }
        let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
        let document = match Document::parse_with_options(xml, options) {
            Ok(document) => document,
            Err(error) => return damaged("XML", format!("{error}; write the file again")),
        };
        let root = document.root_element();
        if root.tag_name().name() != "e57Root" {
            return damaged("XML", format!("expected e57Root, found {}", shown(root.tag_name().name().as_bytes())));
        }
        let elements = |name: &'static str| {
            let of_name = move |node: &Node| node.is_element() && node.tag_name().name() == name;
            root.children().filter(of_name).flat_map(|node| node.children()).filter(|node: &Node| node.is_element())
        };
        let clouds = elements("data3D").enumerate().map(|(number, node)| {
            let points = child(node, "points").and_then(|points| points.attribute("recordCount")?.trim().parse().ok());
            Description::read(number, node).map_err(|wrong| Undescribed { wrong, points: points.unwrap_or(0) })
        });
        let system = child(root, "coordinateMetadata").and_then(|node| node.text()).map(str::trim);
        Ok(Self {
            clouds: clouds.collect(),
            images: elements("images2D").count(),
            system: system.filter(|text| !text.is_empty()).map(str::to_owned),
        })
    }
}

impl Description {
    fn read(number: usize, node: Node<'_, '_>) -> Result<Self, Wrong> {
        let own: String =
            child(node, "name").and_then(|name| name.text()).unwrap_or_default().chars().take(40).collect();
        let name = match own.trim() {
            "" => format!("cloud {}", number + 1),
            own => format!("cloud {} ({})", number + 1, shown(own.as_bytes())),
        };
        let Some(points) = child(node, "points") else { return damaged(name, "it has no element \"points\"") };
        let whole = |attribute: &str| points.attribute(attribute).and_then(|text| text.trim().parse::<u64>().ok());
        let (Some(at), Some(records)) = (whole("fileOffset"), whole("recordCount")) else {
            return damaged(name, "\"points\" states no fileOffset and recordCount");
        };
        let codecs =
            child(points, "codecs").into_iter().flat_map(|node| node.children()).filter(|n: &Node| n.is_element());
        for codec in codecs {
            let kinds = codec.children().filter(|n| n.is_element()).map(|n| n.tag_name().name().to_owned());
            if let Some(other) = kinds.into_iter().find(|name| name != "inputs" && name != "bitPackCodec") {
                let other = shown(other.as_bytes());
                return Err(Wrong::Unsupported(format!("{name}: points packed by the codec {other}")));
            }
        }
        let Some(prototype) = child(points, "prototype") else { return damaged(name, "it describes no columns") };
        let mut columns = Vec::new();
        for node in prototype.children().filter(Node::is_element) {
            if columns.len() == MOST_COLUMNS {
                return damaged(name, format!("more than {MOST_COLUMNS} columns"));
            }
            columns.push(Column::read(&name, node)?);
        }
        let pose = child(node, "pose").map(read_pose).transpose().or_else(|reason| damaged(name.clone(), reason))?;
        let station = pose.map(|pose| pose.apply([0.0; 3]));
        let limits = CHANNELS.map(|channel| {
            let group = if channel == "intensity" { "intensityLimits" } else { "colorLimits" };
            let group = child(node, group)?;
            let end = |which: &str| scaled(child(group, &format!("{channel}{which}"))?);
            Some((end("Minimum")?, end("Maximum")?))
        });
        let pose = pose.filter(|pose| *pose != Pose::IDENTITY);
        Ok(Self { name, at, records, columns, pose, station, limits })
    }

    /// Returns black and white of a channel, which is stored in column `column`: the limits of the cloud, else those of
    /// the column.
    pub fn limits(&self, channel: usize, column: usize) -> Limits {
        let column = &self.columns[column];
        let of_column = match column.kind {
            Kind::Integer { min, max, scale, offset } => Some((min, max))
                .filter(|ends| *ends != (i64::MIN, i64::MAX))
                .map(|(min, max)| (min as f64 * scale + offset, max as f64 * scale + offset)),
            Kind::Single | Kind::Double => column.range,
        };
        self.limits[channel].and_then(Limits::of).or(of_column.and_then(Limits::of)).unwrap_or(Limits::Unstated)
    }
}

/// Reads the number of an element, which may be scaled; `None` if it is not a number.
fn scaled(node: Node<'_, '_>) -> Option<f64> {
    let value = number(Some(node))?.ok()?;
    if node.attribute("type") != Some("ScaledInteger") {
        return Some(value);
    }
    let real = |of: &str, default: f64| node.attribute(of).map_or(Some(default), |text| text.trim().parse().ok());
    Some(value * real("scale", 1.0)? + real("offset", 0.0)?).filter(|value: &f64| value.is_finite())
}

impl Column {
    fn read(cloud: &str, node: Node<'_, '_>) -> Result<Self, Wrong> {
        let name = node.tag_name().name();
        // Columns of extensions are not columns of the standard, even with the same name.
        let root = node.document().root_element().tag_name().namespace();
        let is_of_standard = node.tag_name().namespace().is_none_or(|space| Some(space) == root);
        let wrong = |what: &str| damaged(cloud, format!("column {}: {what}", shown(name.as_bytes())));
        let attribute = |of: &str| node.attribute(of).map(str::trim);
        let whole = |of: &str, default: i64| attribute(of).map_or(Ok(default), str::parse);
        let real = |of: &str, default: f64| {
            attribute(of)
                .map_or(Ok(default), |text| text.parse::<f64>().map_err(drop))
                .and_then(|v| if v.is_finite() { Ok(v) } else { Err(()) })
        };
        let kind = match (attribute("type"), attribute("precision")) {
            (Some("Float"), Some("single")) => Kind::Single,
            (Some("Float"), None | Some("double")) => Kind::Double,
            (Some(integer @ ("Integer" | "ScaledInteger")), _) => {
                let (Ok(min), Ok(max)) = (whole("minimum", i64::MIN), whole("maximum", i64::MAX)) else {
                    return wrong("minimum or maximum is not a whole number");
                };
                if max < min {
                    return wrong("its maximum lies below its minimum");
                }
                let scaled = integer == "ScaledInteger";
                match (real("scale", 1.0), real("offset", 0.0)) {
                    (Ok(scale), Ok(offset)) if scaled => Kind::Integer { min, max, scale, offset },
                    _ if scaled => return wrong("scale or offset is not a finite number"),
                    _ => Kind::Integer { min, max, scale: 1.0, offset: 0.0 },
                }
            }
            (other, _) => {
                let other = shown(other.unwrap_or_default().as_bytes());
                return Err(Wrong::Unsupported(format!("{cloud}: column {} of type {other}", shown(name.as_bytes()))));
            }
        };
        let name = if is_of_standard { name.to_owned() } else { format!("extension:{name}") };
        // Floats default to the range of their type, which says nothing.
        let end = |of: &str| attribute(of)?.parse::<f64>().ok().filter(|v| v.abs() < 1e30);
        let range = end("minimum").zip(end("maximum"));
        Ok(Self { name, kind, range })
    }
}

/// Reads a pose: rotation as a quaternion, then translation.
fn read_pose(node: Node<'_, '_>) -> Result<Pose, String> {
    let read = |of: Option<Node<'_, '_>>, names: &[&str], default: &[f64]| {
        let values = names.iter().zip(default).map(|(name, &default)| match of {
            // A component missing from a stated structure has no safe default.
            Some(of) => number(child(of, name)).unwrap_or_else(|| Err(format!("its pose has no {name}"))),
            None => Ok(default),
        });
        values.collect::<Result<Vec<f64>, String>>()
    };
    let q = read(child(node, "rotation"), &["w", "x", "y", "z"], &[1.0, 0.0, 0.0, 0.0])?;
    let t = read(child(node, "translation"), &["x", "y", "z"], &[0.0; 3])?;
    // Some writers store zeros for no rotation.
    let q = if q == [0.0; 4] { vec![1.0, 0.0, 0.0, 0.0] } else { q };
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    if !(1e-3..=1e3).contains(&length) {
        return Err(format!("its pose has a quaternion of length {length}; expected 1"));
    }
    // A quaternion of unit length up to rounding is used unchanged.
    let by = if (length - 1.0).abs() < 1e-6 { 1.0 } else { length };
    let (w, x, y, z) = (q[0] / by, q[1] / by, q[2] / by, q[3] / by);
    Ok(Pose([
        [w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), w * w + y * y - x * x - z * z, 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w + z * z - x * x - y * y],
        [t[0], t[1], t[2]],
    ]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cloud turned by half about z and moved.
    const SOUND: &str = r#"<e57Root><data3D><vectorChild><name>hall</name><points fileOffset="48" recordCount="2">
        <prototype><cartesianX type="Float"/><cartesianY type="ScaledInteger" minimum="0" maximum="9" scale="0.5"/>
        <cartesianZ type="Integer" minimum="0" maximum="9"/></prototype>
        <codecs><vectorChild><inputs/><bitPackCodec/></vectorChild></codecs></points>
        <pose><rotation><w>0</w><x>0</x><y>0</y><z>1</z></rotation><translation><x>1</x><y>2</y><z>3</z></translation>
        </pose></vectorChild></data3D></e57Root>"#;

    #[test]
    fn quaternions_of_another_length_are_the_same_rotation() {
        for z in ["1", "2", "0.25"] {
            let xml = SOUND.replace("<z>1</z>", &format!("<z>{z}</z>"));
            let Ok(contents) = Contents::parse(&xml) else { panic!("{z}: the XML is sound") };
            let [Ok(cloud)] = &contents.clouds[..] else { panic!("{z}: the cloud is sound") };
            assert_eq!((&cloud.name[..], cloud.records, cloud.columns.len()), ("cloud 1 (\"hall\")", 2, 3));
            assert_eq!(cloud.pose.unwrap().apply([1.0, 4.0, 0.5]), [0.0, -2.0, 3.5], "{z}");
        }
    }

    #[test]
    fn wrong_descriptions_are_refused_by_their_fault() {
        let wrong = |xml: &str| match Contents::parse(xml) {
            Err(wrong) => Some(wrong),
            Ok(contents) => contents.clouds.into_iter().find_map(|cloud| cloud.err().map(|of| of.wrong)),
        };
        let many = "<a type=\"Float\"/>".repeat(MOST_COLUMNS + 1);
        for (from, to, words) in [
            ("e57Root", "root", "expected e57Root, found \"root\""),
            ("points", "dots", "it has no element \"points\""),
            ("fileOffset=\"48\"", "", "states no fileOffset and recordCount"),
            ("recordCount=\"2\"", "recordCount=\"-2\"", "states no fileOffset and recordCount"),
            ("prototype", "columns", "it describes no columns"),
            ("<cartesianX type=\"Float\"/>", &many[..], "more than 1024 columns"),
            ("minimum=\"0\"", "minimum=\"0.5\"", "\"cartesianY\": minimum or maximum is not a whole number"),
            ("maximum=\"9\"", "maximum=\"-1\"", "\"cartesianY\": its maximum lies below its minimum"),
            ("scale=\"0.5\"", "scale=\"half\"", "\"cartesianY\": scale or offset is not a finite number"),
            ("scale=\"0.5\"", "offset=\"inf\"", "\"cartesianY\": scale or offset is not a finite number"),
            ("<w>0</w>", "", "its pose has no w"),
            ("<z>3</z>", "", "its pose has no z"),
            ("<z>3</z>", "<z>inf</z>", "expected a finite number in z"),
            ("<z>1</z>", "<z>9999</z>", "a quaternion of length 9999; expected 1"),
        ] {
            assert!(SOUND.contains(from), "{from}");
            match wrong(&SOUND.replace(from, to)) {
                Some(Wrong::Damaged(_, reason)) => assert!(reason.contains(words), "{words}: {reason}"),
                Some(Wrong::Unsupported(what)) => panic!("{words}: not supported: {what}"),
                None => panic!("{words}: it is not refused"),
            }
        }
        assert!(wrong(SOUND).is_none());
    }
}
