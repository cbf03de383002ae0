//! PLY, as text and binary of either byte order.
//!
//! Reads the elements `vertex` (x, y, z), `face` (a list of vertices) and `tristrips` (lists of vertices, each of which
//! forms a triangle with the two before it; −1 ends a strip), and the colours of the first two. Skips other elements.
//! Nothing may follow the last element.
//!
//! In text an element begins and ends with a line; one that spans several lines is accepted too.
//!
//! Source: Greg Turk, "The PLY Polygon File Format", 1994.

use super::polygon::Polygon;
use super::text::{Lines, only_padding};
use super::vertices::Vertices;
use super::watch::{Digest, MeshSource, Watch};
use super::{BATCH_TRIANGLES, MeshBatch, MeshOptions, Triangles, Wants};
use crate::input::number::Number;
use crate::input::ply_header::{Element, Encoding, Header, HeaderReader, Property};
use crate::paint::Paint;
use crate::text::shown;
use crate::{Error, Result};
use std::io::{BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Most numbers in a list of a face; lists of strips are bounded only by 2³² − 1.
const MOST_IN_LIST: f64 = 65_536.0;
const CUT: &str = "the file ends before the elements that its header states: it is cut; fetch it again";
/// Faces, or numbers of strips, read for one batch.
const FACES: u64 = 512;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Role {
    /// Coordinate of a vertex along an axis.
    Axis(usize),
    /// Vertices of a face.
    Corners,
    /// Red, green or blue, and the value that stands for full intensity.
    Channel(usize, f64),
    Other,
}

/// A property with its role.
#[derive(Debug, Clone, Copy)]
struct Column {
    role: Role,
    /// Type of the count if the property is a list.
    list: Option<Number>,
    number: Number,
}

impl Column {
    fn all_of(element: &Element) -> Vec<Self> {
        let of_face = is_surface(element);
        let column = |Property { name, list, number }: &Property| {
            let role = match (&name[..], list) {
                ("vertex_indices" | "vertex_index", Some(_)) if of_face => Role::Corners,
                (name, None) => match (axis_of(name), channel_of(name)) {
                    (Some(axis), _) => Role::Axis(axis),
                    (None, Some(channel)) => Role::Channel(channel, white_of(*number)),
                    (None, None) => Role::Other,
                },
                _ => Role::Other,
            };
            Self { role, list: *list, number: *number }
        };
        element.properties.iter().map(column).collect()
    }
}

/// Returns whether an element lists vertices of triangles.
fn is_surface(element: &Element) -> bool {
    element.name == "face" || element.name == "tristrips"
}

/// Returns the axis of the coordinate that a property holds.
fn axis_of(name: &str) -> Option<usize> {
    ["x", "y", "z"].iter().position(|axis| axis.eq_ignore_ascii_case(name))
}

/// Returns the colour channel that a property holds.
fn channel_of(name: &str) -> Option<usize> {
    let names = [["red", "r", "diffuse_red"], ["green", "g", "diffuse_green"], ["blue", "b", "diffuse_blue"]];
    names.iter().position(|names| names.iter().any(|other| other.eq_ignore_ascii_case(name)))
}

/// Value that stands for white.
fn white_of(number: Number) -> f64 {
    match number {
        Number::F16 | Number::F32 | Number::F64 => 1.0,
        Number::U16 => f64::from(u16::MAX),
        _ => f64::from(u8::MAX),
    }
}

/// Converts a channel's value to 8 bits.
fn byte_of(value: f64, white: f64) -> u8 {
    (value / white * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

/// Returns whether columns hold all three channels.
fn has_colour(columns: &[Column]) -> bool {
    (0..3).all(|channel| columns.iter().any(|column| matches!(column.role, Role::Channel(own, _) if own == channel)))
}

/// The body's numbers, in file order.
enum Body {
    /// `begun`: the line on which the current element begins.
    Text {
        lines: Lines,
        begun: u64,
    },
    Binary {
        reader: BufReader<MeshSource>,
        path: PathBuf,
        big: bool,
        at: u64,
    },
}

impl Body {
    fn error(&self, reason: impl Into<String>) -> Error {
        match self {
            Self::Text { lines, .. } => lines.error(reason),
            Self::Binary { path, at, .. } => Error::input(path, format!("byte {at} of the body"), reason),
        }
    }

    /// Advances to the next line that is not blank; returns false at the end of the file.
    fn next_line(lines: &mut Lines) -> Result<bool> {
        while lines.next()? {
            if lines.words().next().is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Begins an element; in text, on a new line.
    fn begin(&mut self) -> Result<()> {
        let Self::Text { lines, begun } = self else { return Ok(()) };
        if !Self::next_line(lines)? {
            return Err(lines.error(CUT));
        }
        *begun = lines.number_of_line();
        Ok(())
    }

    /// Returns whether there is nothing left to read; always true for a binary body, which cannot resume after an
    /// error.
    fn is_at_end(&mut self) -> Result<bool> {
        match self {
            Self::Text { lines, .. } => lines.is_at_end(),
            Self::Binary { .. } => Ok(true),
        }
    }

    /// Ends an element; in text nothing else may stand on its last line.
    fn finish(&self) -> Result<()> {
        let Self::Text { lines, begun } = self else { return Ok(()) };
        lines.rest().next().map_or(Ok(()), |word| {
            Err(lines.error(format!(
                "expected the end of the line behind the element that begins in line {begun}, found {}",
                shown(word)
            )))
        })
    }

    /// Reads the next number, of type `number` in a binary body.
    fn number(&mut self, number: Number) -> Result<f64> {
        match self {
            Self::Text { lines, .. } => {
                if lines.rest().next().is_none() && !Self::next_line(lines)? {
                    return Err(lines.error(CUT));
                }
                lines.next_number()
            }
            Self::Binary { reader, path, big, at } => {
                let mut value = [0; 8];
                let bytes = &mut value[..number.bytes()];
                reader.read_exact(bytes).map_err(|e| match e.kind() {
                    ErrorKind::UnexpectedEof => Error::input(&*path, format!("byte {at} of the body"), CUT),
                    _ => Error::io(&*path, format!("read byte {at} of the body"), e),
                })?;
                *at += bytes.len() as u64;
                Ok(number.read(bytes, *big))
            }
        }
    }

    /// Reads the length of a list, which is at most `most`.
    fn length(&mut self, number: Number, most: f64) -> Result<u64> {
        let length = self.number(number)?;
        if !(0.0..=most).contains(&length) || length.fract() != 0.0 {
            return Err(self.error(format!("a list of {length} numbers; expected 0 to {most}")));
        }
        Ok(length as u64)
    }

    /// Fails if more than padding follows the last element.
    fn end(&mut self) -> Result<()> {
        match self {
            Self::Text { lines, .. } => match Self::next_line(lines)? {
                true => Err(lines.error("more lines follow than the header states; write the file again")),
                false => Ok(()),
            },
            Self::Binary { reader, path, at, .. } => {
                let failed = |e| Error::io(&*path, format!("read byte {at} of the body"), e);
                only_padding(reader).map_err(failed)?.then_some(()).ok_or_else(|| {
                    let reason = "more bytes follow than the header states; write the file again";
                    Error::input(&*path, format!("byte {at} of the body"), reason)
                })
            }
        }
    }

    /// Reads one element and passes each number with its role to `give`.
    fn element(&mut self, columns: &[Column], mut give: impl FnMut(Role, f64)) -> Result<()> {
        self.begin()?;
        for column in columns {
            let count = match column.list {
                None => 1,
                Some(count) => self.length(count, MOST_IN_LIST)?,
            };
            for _ in 0..count {
                give(column.role, self.number(column.number)?);
            }
        }
        self.finish()
    }
}

/// Kind of the current elements.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Faces,
    Strips,
    Other,
}

/// A corner: vertex number, position and colour.
type Corner = (u64, [f64; 3], Option<[u8; 3]>);

/// Progress within an element with strips.
#[derive(Debug, Default)]
struct Strip {
    /// Number of properties begun.
    columns: usize,
    /// Numbers left in the last of them.
    left: u64,
    /// The two corners before.
    before: [Option<Corner>; 2],
}

pub(super) struct PlyReader {
    body: Body,
    vertices: Vertices,
    /// Elements after the current ones.
    elements: std::vec::IntoIter<Element>,
    kind: Kind,
    columns: Vec<Column>,
    left: u64,
    strip: Strip,
    corners: Vec<f64>,
    polygon: Polygon,
    /// True if colours are requested.
    coloured: bool,
    colours: Option<Vertices>,
    /// Colours of the corners of the current face.
    at_corners: Vec<[u8; 3]>,
    /// True if colours are requested and faces have them.
    faces_have: bool,
    /// Coordinates that are floats of 32 bits in the body.
    are_singles: [bool; 3],
}

impl PlyReader {
    pub(super) fn open(path: &Path, options: &MeshOptions, wants: Wants<'_>, watch: &mut Watch) -> Result<Self> {
        let (mut body, elements) = open_body(path, wants.digest)?;
        let mut elements = elements.into_iter();
        let coloured = wants.colours.is_some();
        let share = MeshOptions { memory_bytes: options.memory_bytes / 2, ..options.clone() };
        let mut vertices = Vertices::new(if coloured { &share } else { options });
        let (mut colours, mut are_singles) = (None, [false; 3]);
        for element in elements.by_ref() {
            let columns = Column::all_of(&element);
            if element.name != "vertex" {
                for _ in 0..element.count {
                    watch.step()?;
                    body.element(&columns, |_, _| ())?;
                }
                continue;
            }
            let has = |role: Role| columns.iter().any(|column| column.role == role);
            if !(0..3).all(|axis| has(Role::Axis(axis))) {
                return Err(Error::input(path, "header", "the element \"vertex\" has no properties x, y and z"));
            }
            colours = (coloured && has_colour(&columns)).then(|| Vertices::new(&share));
            if let Body::Binary { .. } = body {
                let is_single =
                    |axis: usize| columns.iter().any(|c| c.role == Role::Axis(axis) && c.number == Number::F32);
                are_singles = [0, 1, 2].map(is_single);
            }
            for _ in 0..element.count {
                watch.step()?;
                let (mut vertex, mut colour) = ([f64::NAN; 3], [0.0; 3]);
                body.element(&columns, |role, value| match role {
                    Role::Axis(axis) => vertex[axis] = value,
                    Role::Channel(channel, white) => colour[channel] = f64::from(byte_of(value, white)),
                    Role::Corners | Role::Other => {}
                })?;
                vertices.push(vertex)?;
                if let Some(colours) = &mut colours {
                    colours.push(colour)?;
                }
            }
            break;
        }
        vertices.flush()?;
        colours.as_mut().map(Vertices::flush).transpose()?;
        Ok(Self {
            body,
            vertices,
            elements,
            kind: Kind::Other,
            columns: Vec::new(),
            left: 0,
            strip: Strip::default(),
            corners: Vec::new(),
            polygon: Polygon::default(),
            coloured,
            colours,
            at_corners: Vec::new(),
            faces_have: false,
            are_singles,
        })
    }

    /// Advances to the next elements; returns false after the last.
    fn next_elements(&mut self) -> bool {
        let Some(element) = self.elements.next() else { return false };
        self.columns = Column::all_of(&element);
        self.left = element.count;
        self.kind = match &element.name[..] {
            "face" => Kind::Faces,
            "tristrips" => Kind::Strips,
            _ => Kind::Other,
        };
        self.faces_have = self.coloured && self.kind == Kind::Faces && has_colour(&self.columns);
        self.strip = Strip::default();
        true
    }

    /// Returns the vertex that a list refers to; the inner error means that there is no such vertex.
    fn corner(&mut self, index: f64) -> Result<Result<Corner>> {
        // Negative or fractional indices match no vertex.
        let number = (index >= 0.0 && index.fract() == 0.0).then_some(index as u64);
        let place = number.map(|number| self.vertices.get(number)).transpose()?.flatten();
        let (Some(number), Some(place)) = (number, place) else {
            let all = self.vertices.len();
            return Ok(Err(self.body.error(format!("there is no corner {index}: it has {all}"))));
        };
        let colour = self.colours.as_mut().map(|colours| colours.get(number)).transpose()?.flatten();
        Ok(Ok((number, place, colour.map(|colour| colour.map(|value| value as u8)))))
    }

    /// Reads the next face and outputs its triangles. After an inner error the reader can continue with the next face.
    fn face(&mut self, out: &mut MeshBatch, watch: &Watch) -> Result<Result<()>> {
        let (mut corners, mut flat) = (std::mem::take(&mut self.corners), [0; 3]);
        corners.clear();
        self.body.element(&self.columns, |role, value| match role {
            Role::Corners => corners.push(value),
            Role::Channel(channel, white) => flat[channel] = byte_of(value, white),
            Role::Axis(_) | Role::Other => {}
        })?;
        self.polygon.clear();
        self.at_corners.clear();
        for &index in &corners {
            match self.corner(index)? {
                Ok((_, place, colour)) => {
                    self.polygon.push(place);
                    self.at_corners.extend(colour);
                }
                Err(error) => return Ok(Err(error)),
            }
        }
        self.corners = corners;
        let Self { body, polygon, at_corners: colours, faces_have, .. } = self;
        let mut found = Vec::new();
        let cut = polygon.triangles(|numbers| found.push(numbers), &|| watch.check_cancelled())?;
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

    /// Reads some numbers of an element with strips; returns whether the element ends there.
    fn strip(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
        if self.strip.columns == 0 {
            self.body.begin()?;
        }
        for _ in 0..FACES {
            if self.strip.left == 0 {
                let Some(column) = self.columns.get(self.strip.columns) else {
                    self.strip = Strip::default();
                    return self.body.finish().map(|()| true);
                };
                let columns = self.strip.columns + 1;
                let left = column.list.map_or(Ok(1), |number| self.body.length(number, f64::from(u32::MAX)))?;
                self.strip = Strip { columns, left, before: [None; 2] };
                continue;
            }
            self.strip.left -= 1;
            let Column { role, number, .. } = self.columns[self.strip.columns - 1];
            let index = self.body.number(number)?;
            if role != Role::Corners {
                continue;
            }
            // −1 in an unsigned type.
            let ends = index == -1.0 || number == Number::U32 && index == f64::from(u32::MAX);
            let corner = match ends {
                true => None,
                false => self.corner(index)?.map(Some).or_else(|error| watch.lose(1, error).map(|()| None))?,
            };
            // A repeated vertex joins strips and forms no triangle.
            if let ([Some(a), Some(b)], Some(c)) = (self.strip.before, corner)
                && a.0 != b.0
                && b.0 != c.0
                && a.0 != c.0
            {
                let paint = match (a.2, b.2, c.2) {
                    (Some(a), Some(b), Some(c)) => Paint::Corners([a, b, c]),
                    _ => Paint::None,
                };
                out.push([a.1, b.1, c.1], paint);
            }
            self.strip.before = if corner.is_some() { [self.strip.before[1], corner] } else { [None; 2] };
        }
        Ok(false)
    }
}

impl Triangles for PlyReader {
    fn are_singles(&self) -> [bool; 3] {
        self.are_singles
    }

    fn read(&mut self, out: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
        for _ in 0..FACES {
            if out.len() >= BATCH_TRIANGLES {
                break;
            }
            watch.step()?;
            if self.left == 0 {
                if self.next_elements() {
                    continue;
                }
                self.body.end().or_else(|error| watch.lose(0, error))?;
                return Ok(false);
            }
            let ended = match self.kind {
                Kind::Faces => self.face(out, watch).map(|face| (true, face)),
                Kind::Strips => self.strip(out, watch).map(|ended| (ended, Ok(()))),
                Kind::Other => self.body.element(&self.columns, |_, _| ()).map(|()| (true, Ok(()))),
            };
            match ended {
                Ok((ended, outcome)) => {
                    outcome.or_else(|error| watch.lose(1, error))?;
                    self.left -= u64::from(ended);
                }
                // In text the next element begins on the next line, so reading can continue there.
                Err(error) if !self.body.is_at_end()? => {
                    watch.lose(1, error)?;
                    self.strip = Strip::default();
                    self.left -= 1;
                }
                Err(error) => {
                    watch.lose(self.left, error)?;
                    return Ok(false);
                }
            }
        }
        Ok(true)
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
    let wrong = |reason: String| Err(Error::input(path, "header", reason));
    let header = Header { encoding, elements };
    if let Err(reason) = header.check() {
        return wrong(reason);
    }
    let elements = header.elements;
    let Some(corners) = elements.iter().position(|element| element.name == "vertex") else {
        return wrong("it has no element \"vertex\"".into());
    };
    if elements[..corners].iter().any(|element| is_surface(element) && element.count > 0) {
        return wrong("faces come before their corners; write the file with corners first".into());
    }
    for element in elements[corners..].iter().filter(|element| is_surface(element)) {
        let name = shown(element.name.as_bytes());
        // The numbers of two lists would be those of one face.
        match Column::all_of(element).iter().filter(|column| column.role == Role::Corners).count() {
            0 => return wrong(format!("the element {name} has no list \"vertex_indices\"")),
            1 => {}
            lists => {
                let reason = format!("the element {name} has {lists} lists \"vertex_indices\"; write one");
                return wrong(reason);
            }
        }
    }
    let body = match encoding {
        Encoding::Text => Body::Text { lines, begun: 0 },
        Encoding::Little | Encoding::Big => Body::Binary {
            reader: lines.into_reader(),
            path: path.to_path_buf(),
            big: encoding == Encoding::Big,
            at: 0,
        },
    };
    Ok((body, elements))
}
