//! PLY of splats: as training programs write it (sizes as logarithms, opacity as logarithm of odds), and packed as
//! PlayCanvas does (chunks of 256 splats with bounds, and four words a splat).

use super::columns::{Column, read_error};
use super::gate::{Gate, Raw, colour_of, sigmoid, smallest_three};
use super::{Body, Work, is_all, refuse};
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::{behind_mark, grouped, shown};
use slicewalk_base::{Error, Result};
use slicewalk_input::number::{Number, decimal};
use slicewalk_input::ply_header::{self, Element, Encoding, Header, HeaderReader, MOST_HEADER, Property};
use std::io::{BufRead, Read};
use std::path::Path;
use std::sync::Arc;

/// Longest line of text (bytes).
const MOST_LINE: u64 = 1 << 16;
const CHUNK_SPLATS: u64 = 256;
/// Bits of x, y and z in a packed word.
const SHARES: [u32; 3] = [11, 10, 11];

/// A file whose header was read.
struct File {
    source: Arc<dyn ByteSource>,
    encoding: Encoding,
    /// Byte at the end of each line.
    line_end: u8,
    elements: Vec<Element>,
    /// Where the rows begin (bytes).
    body: u64,
}

/// Place of a property in a row.
#[derive(Debug, Clone, Copy)]
struct Field {
    at: usize,
    column: usize,
    number: Number,
}

/// The rows of one element.
#[derive(Debug, Clone, Copy)]
struct Table {
    start: u64,
    lines_before: u64,
    width: usize,
    columns: usize,
    count: u64,
}

impl File {
    fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let wrong = |reason: String| refuse(path, "header", reason);
        let mut reader = Column::new(&source, 0, 2 * MOST_HEADER as u64);
        let line_end = ply_header::line_end(reader.fill_buf().map_err(|e| read_error(path, "header", e))?);
        let mut header = HeaderReader::default();
        let (mut line, mut body) = (Vec::new(), 0);
        loop {
            line.clear();
            let read = (&mut reader).take(MOST_HEADER as u64 + 1).read_until(line_end, &mut line);
            body += read.map_err(|e| read_error(path, "header", e))? as u64;
            if line.last() != Some(&line_end) {
                return Err(wrong(if line.len() > MOST_HEADER { HeaderReader::LONG } else { header.cut() }.into()));
            }
            let text = if body == line.len() as u64 { behind_mark(&line) } else { &line };
            if let Some(found) = header.take(text.trim_ascii_end()).map_err(wrong)? {
                found.check().map_err(wrong)?;
                let Header { encoding, elements } = found;
                return Ok(Self { source, encoding, line_end, elements, body });
            }
        }
    }

    /// Returns an element and the place of its rows.
    fn table(&self, name: &str, path: &Path) -> Result<(&Element, Table)> {
        let wrong = |reason: String| refuse(path, "header", reason);
        let (mut start, mut lines_before) = (self.body, 0u64);
        for element in &self.elements {
            let found = element.name == name;
            if (found || element.count > 0) && element.properties.iter().any(|p| p.list.is_some()) {
                let name = shown(element.name.as_bytes());
                return Err(wrong(format!("expected no list in or before the splats, found one in element {name}")));
            }
            let names_same = |a: &Property, b: &Property| a.name.eq_ignore_ascii_case(&b.name);
            let is_twice = |at: usize| element.properties[..at].iter().any(|p| names_same(p, &element.properties[at]));
            if let Some(at) = (0..element.properties.len()).filter(|_| found).find(|at| is_twice(*at)) {
                let [element, property] = [name, &element.properties[at].name].map(|name| shown(name.as_bytes()));
                return Err(wrong(format!(
                    "the element {element} has the property {property} more than once; write it once"
                )));
            }
            let width: usize = element.properties.iter().map(|p| p.number.bytes()).sum();
            if found {
                let (columns, count) = (element.properties.len(), element.count);
                return Ok((element, Table { start, lines_before, width, columns, count }));
            }
            start = start.saturating_add(element.count.saturating_mul(width as u64));
            lines_before = lines_before.saturating_add(element.count);
        }
        Err(wrong(format!("expected the element \"{name}\", found none; fetch or write it again")))
    }

    /// Returns how many rows of a table the file can hold; text may hold fewer.
    fn rows_there(&self, table: &Table) -> u64 {
        let bytes = self.source.len().saturating_sub(table.start);
        match self.encoding {
            Encoding::Text => table.count.min(self.source.len()),
            _ => table.count.min(bytes / table.width.max(1) as u64),
        }
    }

    /// Refuses a file that is shorter or longer than its elements, also those that hold no splats. Zeros and blanks at
    /// the end of a binary file are padding. A list in it has no stated length: what follows is not checked. `rows` has
    /// read the rows of `table`.
    fn check_end(&self, table: &Table, rows: &mut RowReader, work: &Work<'_>) -> Result<()> {
        let path = work.path;
        if self.encoding == Encoding::Text {
            return self.check_lines(table, rows, work);
        }
        let fixed = self.elements.iter().take_while(|element| element.properties.iter().all(|p| p.list.is_none()));
        let width = |element: &Element| element.properties.iter().map(|p| p.number.bytes() as u64).sum::<u64>();
        let rows = fixed.fold(0u64, |sum, element| sum.saturating_add(element.count.saturating_mul(width(element))));
        let (expected, found) = (self.body.saturating_add(rows), self.source.len());
        let is_fixed = self.elements.iter().all(|element| element.properties.iter().all(|p| p.list.is_none()));
        if found > expected && is_fixed {
            let is_padding = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
            if is_all(Column::rest(&self.source, expected), is_padding, work)? {
                return Ok(());
            }
            let [expected, found] = [expected, found].map(grouped);
            let reason = format!("expected {expected} bytes for all elements, found {found}; fetch or write it again");
            return Err(refuse(path, "length", reason));
        }
        if found >= expected {
            return Ok(());
        }
        let [expected, found] = [expected, found].map(grouped);
        let reason =
            format!("expected {expected} bytes for all elements, found {found}: the file is cut; fetch it again");
        Err(refuse(path, "length", reason))
    }

    /// Refuses a text with more lines than its elements have rows.
    fn check_lines(&self, table: &Table, rows: &mut RowReader, work: &Work<'_>) -> Result<()> {
        let stated = self.elements.iter().fold(0u64, |sum, element| sum.saturating_add(element.count));
        let mut lines = table.lines_before.saturating_add(table.count);
        while next_line(&mut rows.column, &mut rows.row, (lines, self.line_end), work.path)? {
            lines += 1;
            if lines.is_multiple_of(1 << 12) && work.monitor.cancelled() {
                return Err(Error::Interrupted);
            }
        }
        if lines <= stated {
            return Ok(());
        }
        let [expected, found] = [stated, lines].map(grouped);
        let reason = format!("expected {expected} rows of all elements, found {found}; fetch or write it again");
        Err(refuse(work.path, "length", reason))
    }

    fn reader(&self, table: &Table, path: &Path) -> Result<RowReader> {
        let is_text = self.encoding == Encoding::Text;
        let mut column = Column::rest(&self.source, if is_text { self.body } else { table.start });
        let mut row = Vec::new();
        let mut lines = 0;
        while is_text && lines < table.lines_before && next_line(&mut column, &mut row, (lines, self.line_end), path)? {
            lines += 1;
        }
        if !is_text {
            row.resize(table.width, 0);
        }
        let Self { encoding, line_end, .. } = *self;
        Ok(RowReader { column, encoding, line_end, row, words: Vec::new(), columns: table.columns, number: 0 })
    }
}

/// Reads the next line that is not empty and ends with `end`, of row `number`; returns whether there is one.
fn next_line(column: &mut Column, line: &mut Vec<u8>, (number, end): (u64, u8), path: &Path) -> Result<bool> {
    loop {
        line.clear();
        let read = column.take(MOST_LINE).read_until(end, line);
        let read = read.map_err(|e| read_error(path, format!("row {number}"), e))?;
        if read as u64 == MOST_LINE {
            return Err(refuse(
                path,
                format!("row {number}"),
                "a line of more than 64 KiB: this is damaged, or no text",
            ));
        }
        if read == 0 || !line.trim_ascii().is_empty() {
            return Ok(read > 0);
        }
    }
}

/// Reader of the rows of one element in file order.
struct RowReader {
    column: Column,
    encoding: Encoding,
    line_end: u8,
    row: Vec<u8>,
    words: Vec<f64>,
    columns: usize,
    number: u64,
}

impl RowReader {
    /// Reads the next row; returns whether there is one.
    fn step(&mut self, path: &Path) -> Result<bool> {
        let number = self.number;
        self.number += 1;
        if self.encoding != Encoding::Text {
            return match self.column.read_exact(&mut self.row) {
                Ok(()) => Ok(true),
                Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
                Err(e) => Err(read_error(path, format!("row {number}"), e)),
            };
        }
        if !next_line(&mut self.column, &mut self.row, (number, self.line_end), path)? {
            return Ok(false);
        }
        self.words.clear();
        for word in self.row.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()) {
            let value = decimal(word, false).ok_or_else(|| {
                refuse(path, format!("row {number}"), format!("expected a number, found {}", shown(word)))
            })?;
            self.words.push(value);
        }
        if self.words.len() != self.columns {
            let (expected, found) = (self.columns, self.words.len());
            // A cut file may end within a row, even within a number.
            if found < expected && self.row.last() != Some(&self.line_end) {
                return Ok(false);
            }
            return Err(refuse(path, format!("row {number}"), format!("expected {expected} numbers, found {found}")));
        }
        Ok(true)
    }

    fn get(&self, field: Field) -> f64 {
        match self.encoding {
            Encoding::Text => self.words[field.column],
            order => field.number.read(&self.row[field.at..], order == Encoding::Big),
        }
    }

    /// Returns a whole number of 32 bits; `None` if text holds another one.
    fn word(&self, field: Field) -> Option<u32> {
        let value = self.get(field);
        (value >= 0.0 && value <= f64::from(u32::MAX) && value == libm::trunc(value)).then_some(value as u32)
    }
}

/// Returns the property of this name, in upper or lower case.
fn field(element: &Element, name: &str) -> Option<Field> {
    let column = element.properties.iter().position(|p| p.name.eq_ignore_ascii_case(name))?;
    let at = element.properties[..column].iter().map(|p| p.number.bytes()).sum();
    Some(Field { at, column, number: element.properties[column].number })
}

fn fields<const N: usize>(element: &Element, names: [&str; N]) -> Option<[Field; N]> {
    let mut found = [Field { at: 0, column: 0, number: Number::U8 }; N];
    for (place, name) in found.iter_mut().zip(names) {
        *place = field(element, name)?;
    }
    Some(found)
}

/// Where the base colour comes from.
enum Colour {
    Harmonics([Field; 3]),
    /// Values from 0 to this.
    Direct([Field; 3], f64),
    None,
}

/// PLY with a property for each parameter.
pub struct Rows {
    file: File,
    table: Table,
    mean: [Field; 3],
    /// Fewer than three for discs (two) and balls (one).
    scale: Vec<Field>,
    rotation: [Field; 4],
    opacity: Field,
    colour: Colour,
}

impl Rows {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let file = File::open(source, path)?;
        let (element, table) = file.table("vertex", path)?;
        let without = |what: &str| {
            refuse(path, "header", format!("splats without the properties {what}; export it with all of them"))
        };
        let mean = fields(element, ["x", "y", "z"]).ok_or_else(|| without("x, y, z"))?;
        let rotation =
            fields(element, ["rot_0", "rot_1", "rot_2", "rot_3"]).ok_or_else(|| without("rot_0 to rot_3"))?;
        let opacity = field(element, "opacity").ok_or_else(|| without("opacity"))?;
        let scale: Vec<Field> =
            ["scale_0", "scale_1", "scale_2"].iter().map_while(|name| field(element, name)).collect();
        if scale.is_empty() {
            return Err(without("scale_0 to scale_2"));
        }
        let is_float = |f: &Field| matches!(f.number, Number::F16 | Number::F32 | Number::F64);
        if !scale.iter().chain(&rotation).chain([&opacity]).all(is_float) {
            let reason = "expected floating-point numbers for size, rotation and opacity, found whole numbers";
            return Err(refuse(path, "header", format!("{reason}; export it in another way")));
        }
        let direct = || fields(element, ["red", "green", "blue"]).or_else(|| fields(element, ["r", "g", "b"]));
        let colour = match (fields(element, ["f_dc_0", "f_dc_1", "f_dc_2"]), direct()) {
            (Some(harmonics), _) => Colour::Harmonics(harmonics),
            (None, Some(direct)) => {
                let most = match direct[0].number {
                    Number::F16 | Number::F32 | Number::F64 => 1.0,
                    Number::I8 | Number::U8 => 255.0,
                    _ => 65_535.0,
                };
                Colour::Direct(direct, most)
            }
            (None, None) => Colour::None,
        };
        Ok(Self { table, mean, scale, rotation, opacity, colour, file })
    }
}

impl Body for Rows {
    fn count(&self) -> u64 {
        self.table.count
    }

    fn are_singles(&self) -> [bool; 3] {
        self.mean.map(|field| self.file.encoding != Encoding::Text && field.number == Number::F32)
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let there = self.file.rows_there(&self.table);
        gate.miss(self.table.count - there)?;
        let mut rows = self.file.reader(&self.table, work.path)?;
        for number in 0..there {
            match rows.step(work.path) {
                Ok(true) => {}
                Ok(false) => return gate.miss(there - number),
                Err(error) => return broken(gate, error),
            }
            let get = |field: Field| rows.get(field);
            let scale = match self.scale[..] {
                [one] => [libm::exp(get(one)); 3],
                // A disc has no thickness.
                [a, b] => [libm::exp(get(a)), libm::exp(get(b)), 0.0],
                [a, b, c, ..] => [a, b, c].map(|f| libm::exp(get(f))),
                [] => [0.0; 3],
            };
            let colour = match self.colour {
                Colour::Harmonics(fields) => fields.map(|f| colour_of(get(f))),
                Colour::Direct(fields, most) => fields.map(|f| get(f) / most),
                Colour::None => [0.5; 3],
            };
            let (mean, rotation) = (self.mean.map(get), self.rotation.map(get));
            gate.push(Raw { mean, scale, rotation, opacity: sigmoid(get(self.opacity)), colour })?;
        }
        self.file.check_end(&self.table, &mut rows, work).or_else(|error| broken(gate, error))
    }
}

/// Stops at a damaged row; other errors are passed on.
fn broken(gate: &mut Gate<'_>, error: Error) -> Result<()> {
    if matches!(error, Error::Input { .. }) { gate.break_off(error) } else { Err(error) }
}

/// PLY with packed splats.
pub struct Packed {
    file: File,
    chunks: Table,
    table: Table,
    /// Least and greatest x, y, z.
    mean: [[Field; 3]; 2],
    /// Least and greatest logarithms of sizes.
    scale: [[Field; 3]; 2],
    /// Least and greatest red, green and blue; 0 and 1 if absent.
    colour: Option<[[Field; 3]; 2]>,
    /// Centre, rotation, size, colour.
    words: [Field; 4],
}

impl Packed {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let file = File::open(source, path)?;
        let (chunk, chunks) = file.table("chunk", path)?;
        let (vertex, table) = file.table("vertex", path)?;
        let without = |what: &str| {
            refuse(path, "header", format!("packed splats without the properties {what}; fetch or write it again"))
        };
        let bounds = |names: [[&str; 3]; 2]| Some([fields(chunk, names[0])?, fields(chunk, names[1])?]);
        let mean = bounds([["min_x", "min_y", "min_z"], ["max_x", "max_y", "max_z"]]);
        let scale =
            bounds([["min_scale_x", "min_scale_y", "min_scale_z"], ["max_scale_x", "max_scale_y", "max_scale_z"]]);
        let colour = bounds([["min_r", "min_g", "min_b"], ["max_r", "max_g", "max_b"]]);
        let words = fields(vertex, ["packed_position", "packed_rotation", "packed_scale", "packed_color"]);
        let words = words.ok_or_else(|| without("packed_position, packed_rotation, packed_scale and packed_color"))?;
        if words.iter().any(|f| f.number != Number::U32) {
            return Err(refuse(path, "header", "expected packed properties of type uint; fetch or write it again"));
        }
        let expected = table.count.div_ceil(CHUNK_SPLATS);
        if chunks.count != expected {
            let [splats, expected, found] = [table.count, expected, chunks.count].map(grouped);
            let reason =
                format!("expected {expected} chunks for {splats} splats, found {found}; fetch or write it again");
            return Err(refuse(path, "header", reason));
        }
        let mean = mean.ok_or_else(|| without("min_x to max_z"))?;
        let scale = scale.ok_or_else(|| without("min_scale_x to max_scale_z"))?;
        Ok(Self { chunks, table, mean, scale, colour, words, file })
    }
}

impl Body for Packed {
    fn count(&self) -> u64 {
        self.table.count
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let there = self.file.rows_there(&self.table);
        gate.miss(self.table.count - there)?;
        let mut chunks = self.file.reader(&self.chunks, work.path)?;
        let mut rows = self.file.reader(&self.table, work.path)?;
        let (mut mean, mut scale, mut colour) = ([[0.0; 3]; 2], [[0.0; 3]; 2], [[0.0; 3], [1.0; 3]]);
        for number in 0..there {
            let step = match number % CHUNK_SPLATS {
                0 => chunks.step(work.path).and_then(|chunk| Ok(chunk && rows.step(work.path)?)),
                _ => rows.step(work.path),
            };
            match step {
                Ok(true) => {}
                Ok(false) => return gate.miss(there - number),
                Err(error) => return broken(gate, error),
            }
            if number % CHUNK_SPLATS == 0 {
                let bounds = |fields: [[Field; 3]; 2]| fields.map(|f| f.map(|f| chunks.get(f)));
                (mean, scale) = (bounds(self.mean), bounds(self.scale));
                colour = self.colour.map_or(colour, bounds);
            }
            let words = self.words.map(|f| rows.word(f));
            let [Some(position), Some(rotation), Some(size), Some(shade)] = words else {
                let reason = "expected whole numbers of 32 bits; fetch or write it again";
                return broken(gate, refuse(work.path, format!("row {number}"), reason));
            };
            let byte = |shift: u32| f64::from((shade >> shift) & 255) / 255.0;
            let tint = [byte(24), byte(16), byte(8)];
            gate.push(Raw {
                mean: between(mean, shares(position)),
                scale: between(scale, shares(size)).map(libm::exp),
                rotation: unpack_rotation(rotation),
                opacity: byte(0),
                colour: between(colour, tint),
            })?;
        }
        self.file.check_end(&self.table, &mut rows, work).or_else(|error| broken(gate, error))
    }
}

/// Splits a word of 11, 10 and 11 bits into shares of 1.
fn shares(word: u32) -> [f64; 3] {
    let mut left = 32;
    SHARES.map(|bits| {
        left -= bits;
        let most = (1 << bits) - 1;
        f64::from((word >> left) & most) / f64::from(most)
    })
}

fn between([least, greatest]: [[f64; 3]; 2], share: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| least[axis] * (1.0 - share[axis]) + greatest[axis] * share[axis])
}

/// Restores w, x, y, z from two bits for the place of the largest and ten for each other.
fn unpack_rotation(word: u32) -> [f64; 4] {
    let small = [20, 10, 0].map(|shift| (f64::from((word >> shift) & 1023) / 1023.0 - 0.5) * std::f64::consts::SQRT_2);
    smallest_three(small, (word >> 30) as usize)
}
