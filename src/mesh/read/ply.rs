//! PLY, text and binary of either byte order: the elements `vertex` (x, y, z) and `face` (a list of corners), and the colours of both;
//! others are passed over.
//!
//! Source: Greg Turk, "The PLY Polygon File Format", 1994.

use super::polygon::Polygon;
use super::text::Lines;
use super::vertices::Vertices;
use super::watch::{Digest, MeshSource, Watch};
use super::{BATCH_TRIANGLES, MeshBatch, MeshOptions, Triangles, Wants};
use crate::input::number::Number;
use crate::input::ply_header::{Element, Encoding, Header, HeaderReader, Property};
use crate::mesh::paint::Paint;
use crate::{Error, Result};
use std::io::{BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Most numbers in a list, of which a face has one.
const MOST_IN_LIST: f64 = 65_536.0;
/// Faces read for one batch.
const FACES: u64 = 512;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Role {
    /// Coordinate of a corner along an axis.
    Axis(usize),
    /// Corners of a face.
    Corners,
    /// Red, green or blue, and which of its values is white.
    Channel(usize, f64),
    Other,
}

/// A property, by what it is for.
#[derive(Debug, Clone, Copy)]
struct Column {
    role: Role,
    /// Type of the count, of a list.
    list: Option<Number>,
    number: Number,
}

impl Column {
    fn all_of(element: &Element) -> Vec<Self> {
        let of_face = element.name == "face";
        let column = |Property { name, list, number }: &Property| {
            let role = match (&name[..], list) {
                ("x", None) => Role::Axis(0),
                ("y", None) => Role::Axis(1),
                ("z", None) => Role::Axis(2),
                ("vertex_indices" | "vertex_index", Some(_)) if of_face => Role::Corners,
                (name, None) => match channel_of(name) {
                    Some(channel) => Role::Channel(channel, white_of(*number)),
                    None => Role::Other,
                },
                _ => Role::Other,
            };
            Self { role, list: *list, number: *number }
        };
        element.properties.iter().map(column).collect()
    }
}

/// The channel of a colour that a property is.
fn channel_of(name: &str) -> Option<usize> {
    let names = [["red", "r", "diffuse_red"], ["green", "g", "diffuse_green"], ["blue", "b", "diffuse_blue"]];
    names.iter().position(|names| names.iter().any(|other| other.eq_ignore_ascii_case(name)))
}

/// The value that stands for white.
fn white_of(number: Number) -> f64 {
    match number {
        Number::F32 | Number::F64 => 1.0,
        Number::U16 => f64::from(u16::MAX),
        _ => f64::from(u8::MAX),
    }
}

/// A channel's value as 8 bits.
fn byte_of(value: f64, white: f64) -> u8 {
    (value / white * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

/// Whether columns have all three channels.
fn has_colour(columns: &[Column]) -> bool {
    (0..3).all(|channel| columns.iter().any(|column| matches!(column.role, Role::Channel(own, _) if own == channel)))
}

/// The numbers of the body, one after the other.
enum Body {
    Text(Lines),
    Binary { reader: BufReader<MeshSource>, path: PathBuf, big: bool, at: u64 },
}

impl Body {
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
                let bytes = &mut value[..number.bytes()];
                reader.read_exact(bytes).map_err(|e| match e.kind() {
                    ErrorKind::UnexpectedEof => Error::input(
                        &*path,
                        format!("byte {at} of the body"),
                        "the file ends before the elements that its header states: it is cut; fetch it again",
                    ),
                    _ => Error::io(&*path, format!("read byte {at} of the body"), e),
                })?;
                *at += bytes.len() as u64;
                Ok(number.read(bytes, *big))
            }
        }
    }

    /// Reads one element; gives each number with its role.
    fn element(&mut self, columns: &[Column], mut give: impl FnMut(Role, f64)) -> Result<()> {
        self.begin()?;
        for column in columns {
            let count = match column.list {
                None => 1.0,
                Some(count) => self.number(count)?,
            };
            if !(0.0..=MOST_IN_LIST).contains(&count) {
                return Err(self.error(format!("a list of {count} numbers; expected 0 to {MOST_IN_LIST}")));
            }
            for _ in 0..count as u32 {
                give(column.role, self.number(column.number)?);
            }
        }
        Ok(())
    }
}

pub(super) struct PlyReader {
    body: Body,
    vertices: Vertices,
    columns: Vec<Column>,
    faces_left: u64,
    corners: Vec<f64>,
    polygon: Polygon,
    /// Colours of the corners, if they are wanted and there are some.
    colours: Option<Vertices>,
    /// Colours of the corners of the face at hand.
    at_corners: Vec<[u8; 3]>,
    /// Whether faces have colours that are wanted.
    faces_have: bool,
}

impl PlyReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, wants: Wants<'_>, watch: &mut Watch) -> Result<Self> {
        let (mut body, elements) = open_body(path, wants.digest)?;
        let coloured = wants.colours.is_some();
        let share = MeshOptions { memory_bytes: options.memory_bytes / 2, ..options.clone() };
        let mut vertices = Vertices::new(if coloured { &share } else { options });
        let (mut colours, mut faces_have) = (None, false);
        let mut faces = None;
        for element in elements {
            let columns = Column::all_of(&element);
            let has = |role: Role| columns.iter().any(|column| column.role == role);
            if element.name == "vertex" {
                if !(0..3).all(|axis| has(Role::Axis(axis))) {
                    return Err(Error::input(path, "header", "the element \"vertex\" has no properties x, y and z"));
                }
                let mut own = (coloured && has_colour(&columns)).then(|| Vertices::new(&share));
                for _ in 0..element.count {
                    watch.step()?;
                    let (mut vertex, mut colour) = ([f64::NAN; 3], [0.0; 3]);
                    body.element(&columns, |role, value| match role {
                        Role::Axis(axis) => vertex[axis] = value,
                        Role::Channel(channel, white) => colour[channel] = f64::from(byte_of(value, white)),
                        Role::Corners | Role::Other => {}
                    })?;
                    vertices.push(vertex)?;
                    if let Some(own) = &mut own {
                        own.push(colour)?;
                    }
                }
                colours = own;
            } else if element.name == "face" {
                if !has(Role::Corners) {
                    return Err(Error::input(path, "header", "the element \"face\" has no list \"vertex_indices\""));
                }
                faces_have = coloured && has_colour(&columns);
                faces = Some((columns, element.count));
                break;
            } else {
                for _ in 0..element.count {
                    watch.step()?;
                    body.element(&columns, |_, _| ())?;
                }
            }
        }
        vertices.flush()?;
        colours.as_mut().map(Vertices::flush).transpose()?;
        let (columns, faces_left) = faces.unwrap_or_default();
        let (corners, at_corners, polygon) = (Vec::new(), Vec::new(), Polygon::default());
        Ok(Self { body, vertices, columns, faces_left, corners, polygon, colours, at_corners, faces_have })
    }
}

impl PlyReader {
    /// The corners of the next face, and its triangles; the inner error leaves the place of the next face known.
    fn face(&mut self, out: &mut MeshBatch, watch: &Watch) -> Result<Result<()>> {
        let Self { body, vertices, columns, corners, polygon, colours, at_corners, faces_have, .. } = self;
        corners.clear();
        let mut flat = [0; 3];
        body.element(columns, |role, value| match role {
            Role::Corners => corners.push(value),
            Role::Channel(channel, white) => flat[channel] = byte_of(value, white),
            Role::Axis(_) | Role::Other => {}
        })?;
        polygon.clear();
        at_corners.clear();
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
            if let (Some(colours), Some(number)) = (colours.as_mut(), number) {
                at_corners.push(colours.get(number)?.unwrap_or_default().map(|value| value as u8));
            }
        }
        let (mut found, colours) = (Vec::new(), at_corners);
        let cut = polygon.triangles(|numbers| found.push(numbers), &|| watch.go_on())?;
        for numbers in found {
            let paint = match numbers.map(|number| colours.get(number)) {
                _ if *faces_have => Paint::Flat(flat),
                [Some(a), Some(b), Some(c)] => Paint::Corners([*a, *b, *c]),
                _ => Paint::None,
            };
            out.push(numbers.map(|number| polygon.corners()[number]), paint);
        }
        Ok(cut.map_err(|reason| body.error(reason)))
    }
}

impl Triangles for PlyReader {
    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
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
fn open_body(path: &Path, digest: &Digest) -> Result<(Body, Vec<Element>)> {
    let (mut lines, mut reader) = (Lines::open(path, false, digest)?, HeaderReader::default());
    let Header { encoding, elements } = loop {
        let line = if lines.next()? { lines.line() } else { return Err(lines.error(reader.cut())) };
        if let Some(header) = reader.take(line).map_err(|reason| lines.error(reason))? {
            break header;
        }
    };
    let place = |name: &str| elements.iter().position(|element| element.name == name);
    if let (Some(faces), Some(corners)) = (place("face"), place("vertex"))
        && faces < corners
    {
        return Err(Error::input(path, "header", "faces come before their corners; write the file with corners first"));
    }
    if let Some(empty) = elements.iter().position(|element| element.properties.is_empty() && element.count > 0) {
        return Err(Error::input(path, "header", format!("element {} has no properties", empty + 1)));
    }
    let body = match encoding {
        Encoding::Text => Body::Text(lines),
        Encoding::Little | Encoding::Big => Body::Binary {
            reader: lines.into_reader(),
            path: path.to_path_buf(),
            big: encoding == Encoding::Big,
            at: 0,
        },
    };
    Ok((body, elements))
}
