//! PLY, text and binary of either byte order: the elements `vertex` (x, y, z) and `face` (a list of corners); others are
//! passed over.
//!
//! Source: Greg Turk, "The PLY Polygon File Format", 1994.

use super::polygon::Polygon;
use super::text::{Lines, shown};
use super::vertices::Vertices;
use super::watch::{Digest, MeshSource, Watch};
use super::{BATCH_TRIANGLES, MeshOptions, Triangle, Triangles};
use crate::{Error, Result};
use std::io::{BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Most elements, and most properties of one.
const MOST_PARTS: usize = 256;
/// Most numbers in a list, of which a face has one.
const MOST_IN_LIST: f64 = 65_536.0;
/// Faces read for one batch.
const FACES: u64 = 512;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    /// Coordinate of a corner along an axis.
    Axis(usize),
    /// Corners of a face.
    Corners,
    Other,
}

#[derive(Debug, Clone)]
struct Property {
    role: Role,
    /// Type of the count, of a list.
    list: Option<Number>,
    number: Number,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ElementKind {
    Vertex,
    Face,
    Other,
}

#[derive(Debug, Clone)]
struct Element {
    kind: ElementKind,
    count: u64,
    properties: Vec<Property>,
}

/// The numbers of the body, one after the other.
enum Encoding {
    Text(Lines),
    Binary { reader: BufReader<MeshSource>, path: PathBuf, big: bool, at: u64 },
}

impl Encoding {
    fn error(&self, reason: impl Into<String>) -> Error {
        match self {
            Self::Text(lines) => lines.error(reason),
            Self::Binary { path, at, .. } => Error::input(path, format!("byte {at} of the body"), reason),
        }
    }

    /// Goes to the next element: in text each has a line.
    fn begin(&mut self) -> Result<()> {
        let Self::Text(lines) = self else { return Ok(()) };
        // Blank lines carry nothing.
        while lines.next()? {
            if lines.words().next().is_some() {
                return Ok(());
            }
        }
        Err(lines.error("the file ends before the elements that its header states: it is cut; fetch it again"))
    }

    /// The next number, which a binary body holds in the form `number`.
    fn number(&mut self, number: Number) -> Result<f64> {
        match self {
            Self::Text(lines) => lines.next_number(),
            Self::Binary { reader, path, big, at } => {
                let mut value = [0; 8];
                let bytes = match number {
                    Number::I8 | Number::U8 => &mut value[..1],
                    Number::I16 | Number::U16 => &mut value[..2],
                    Number::I32 | Number::U32 | Number::F32 => &mut value[..4],
                    Number::F64 => &mut value[..],
                };
                reader.read_exact(bytes).map_err(|e| match e.kind() {
                    ErrorKind::UnexpectedEof => Error::input(
                        &*path,
                        format!("byte {at} of the body"),
                        "the file ends before the elements that its header states: it is cut; fetch it again",
                    ),
                    _ => Error::io(&*path, format!("read byte {at} of the body"), e),
                })?;
                *at += bytes.len() as u64;
                if *big {
                    bytes.reverse();
                }
                let [a, b, c, d, ..] = value;
                Ok(match number {
                    Number::I8 => f64::from(a as i8),
                    Number::U8 => f64::from(a),
                    Number::I16 => f64::from(i16::from_le_bytes([a, b])),
                    Number::U16 => f64::from(u16::from_le_bytes([a, b])),
                    Number::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                    Number::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                    Number::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                    Number::F64 => f64::from_le_bytes(value),
                })
            }
        }
    }

    /// Reads one element; gives each number with its role.
    fn element(&mut self, properties: &[Property], mut give: impl FnMut(Role, f64)) -> Result<()> {
        self.begin()?;
        for property in properties {
            let count = match property.list {
                None => 1.0,
                Some(count) => self.number(count)?,
            };
            if !(0.0..=MOST_IN_LIST).contains(&count) {
                return Err(self.error(format!("a list of {count} numbers; expected 0 to {MOST_IN_LIST}")));
            }
            for _ in 0..count as u32 {
                give(property.role, self.number(property.number)?);
            }
        }
        Ok(())
    }
}

pub(super) struct PlyReader {
    body: Encoding,
    vertices: Vertices,
    properties: Vec<Property>,
    faces_left: u64,
    corners: Vec<f64>,
    polygon: Polygon,
}

impl PlyReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, digest: &Digest, watch: &mut Watch) -> Result<Self> {
        let (mut body, elements) = open_body(path, digest)?;
        let mut vertices = Vertices::new(options);
        let mut faces = None;
        for element in elements {
            let axes: Vec<Role> = element.properties.iter().map(|property| property.role).collect();
            if element.kind == ElementKind::Vertex {
                if !(0..3).all(|axis| axes.contains(&Role::Axis(axis))) {
                    return Err(Error::input(path, "header", "the element \"vertex\" has no properties x, y and z"));
                }
                for _ in 0..element.count {
                    watch.step()?;
                    let mut vertex = [f64::NAN; 3];
                    body.element(&element.properties, |role, value| {
                        if let Role::Axis(axis) = role {
                            vertex[axis] = value;
                        }
                    })?;
                    vertices.push(vertex)?;
                }
            } else if element.kind == ElementKind::Face {
                if !axes.contains(&Role::Corners) {
                    return Err(Error::input(path, "header", "the element \"face\" has no list \"vertex_indices\""));
                }
                faces = Some(element);
                break;
            } else {
                for _ in 0..element.count {
                    watch.step()?;
                    body.element(&element.properties, |_, _| ())?;
                }
            }
        }
        vertices.flush()?;
        let (properties, faces_left) = faces.map_or((Vec::new(), 0), |faces| (faces.properties, faces.count));
        Ok(Self { body, vertices, properties, faces_left, corners: Vec::new(), polygon: Polygon::default() })
    }
}

impl PlyReader {
    /// The corners of the next face, and its triangles; the inner error leaves the place of the next face known.
    fn face(&mut self, out: &mut Vec<Triangle>, watch: &Watch) -> Result<Result<()>> {
        let Self { body, vertices, properties, corners, polygon, .. } = self;
        corners.clear();
        body.element(properties, |role, value| {
            if role == Role::Corners {
                corners.push(value);
            }
        })?;
        polygon.clear();
        for &index in &*corners {
            // A whole number below 2⁵³, or no corner has it.
            let number = (index >= 0.0 && index.fract() == 0.0).then_some(index as u64);
            let corner = match number {
                Some(number) => vertices.get(number)?,
                None => None,
            };
            let Some(corner) = corner else {
                let all = vertices.len();
                return Ok(Err(body.error(format!("there is no corner {index}: it has {all}"))));
            };
            polygon.push(corner);
        }
        let cut = polygon.triangles(out, &|| watch.go_on())?;
        Ok(cut.map_err(|reason| body.error(reason)))
    }
}

impl Triangles for PlyReader {
    fn read(&mut self, out: &mut Vec<Triangle>, watch: &mut Watch) -> Result<bool> {
        for _ in 0..FACES.min(self.faces_left) {
            if out.len() >= BATCH_TRIANGLES {
                break;
            }
            watch.step()?;
            match self.face(out, watch) {
                Ok(face) => face.or_else(|error| watch.lose(1, error))?,
                Err(error) => {
                    watch.lose(self.faces_left, error)?;
                    return Ok(false);
                }
            }
            self.faces_left -= 1;
        }
        Ok(self.faces_left > 0)
    }
}

/// Reads the header.
fn open_body(path: &Path, digest: &Digest) -> Result<(Encoding, Vec<Element>)> {
    let mut lines = Lines::open(path, false, digest)?;
    if !lines.next()? || lines.words().next() != Some(b"ply") {
        return Err(lines.error("expected \"ply\": this is no PLY file"));
    }
    let mut format = Vec::new();
    let mut elements: Vec<Element> = Vec::new();
    loop {
        if !lines.next()? {
            return Err(lines.error("the file ends before \"end_header\": it is cut; fetch it again"));
        }
        let words: Vec<&[u8]> = lines.words().take(8).collect();
        match words[..] {
            [b"format", name, b"1.0"] => format = name[..name.len().min(40)].to_vec(),
            [b"element", name, count] => {
                let parsed = std::str::from_utf8(count).ok().and_then(|text| text.parse().ok());
                let unclear = || lines.error(format!("expected a number of elements, found {}", shown(count)));
                let kind = match name {
                    b"vertex" => ElementKind::Vertex,
                    b"face" => ElementKind::Face,
                    _ => ElementKind::Other,
                };
                elements.push(Element { kind, count: parsed.ok_or_else(unclear)?, properties: Vec::new() });
            }
            [b"property", ref property @ ..] => {
                let unknown = || {
                    lines.error(format!("a property that PLY does not know: {}", shown(property.concat().as_slice())))
                };
                let element = elements.last_mut().ok_or_else(|| lines.error("a property before any element"))?;
                element
                    .properties
                    .push(parse_property(property, element.kind == ElementKind::Face).ok_or_else(unknown)?);
            }
            [b"end_header"] => break,
            [] | [b"comment" | b"obj_info", ..] => {}
            [other, ..] => return Err(lines.error(format!("expected a line of a PLY header, found {}", shown(other)))),
        }
        if elements.len() > MOST_PARTS || elements.last().is_some_and(|e| e.properties.len() > MOST_PARTS) {
            return Err(lines.error(format!("more than {MOST_PARTS} elements or properties")));
        }
    }
    let faces = elements.iter().position(|element| element.kind == ElementKind::Face);
    let corners = elements.iter().position(|element| element.kind == ElementKind::Vertex);
    if let (Some(faces), Some(corners)) = (faces, corners)
        && faces < corners
    {
        return Err(Error::input(path, "header", "faces come before their corners; write the file with corners first"));
    }
    if let Some(empty) = elements.iter().position(|element| element.properties.is_empty() && element.count > 0) {
        return Err(Error::input(path, "header", format!("element {} has no properties", empty + 1)));
    }
    let body = match &format[..] {
        b"ascii" => Encoding::Text(lines),
        b"binary_little_endian" | b"binary_big_endian" => {
            let big = format == b"binary_big_endian";
            Encoding::Binary { reader: lines.into_reader(), path: path.to_path_buf(), big, at: 0 }
        }
        other => {
            let reason =
                format!("expected format ascii, binary_little_endian or binary_big_endian, found {}", shown(other));
            return Err(Error::input(path, "header", reason));
        }
    };
    Ok((body, elements))
}

fn parse_property(words: &[&[u8]], of_face: bool) -> Option<Property> {
    let (list, number, name) = match *words {
        [b"list", count, number, name] => (Some(Number::named(count)?), Number::named(number)?, name),
        [number, name] => (None, Number::named(number)?, name),
        _ => return None,
    };
    let role = match (name, list) {
        (b"x", None) => Role::Axis(0),
        (b"y", None) => Role::Axis(1),
        (b"z", None) => Role::Axis(2),
        (b"vertex_indices" | b"vertex_index", Some(_)) if of_face => Role::Corners,
        _ => Role::Other,
    };
    Some(Property { role, list, number })
}
