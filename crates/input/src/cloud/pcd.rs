//! PCD of the Point Cloud Library, versions .5 to 0.7: text, binary, and binary compressed by LZF.
//!
//! Fields may come in any order and of any type; x, y and z are required. NaN marks a pixel of an organised cloud
//! without a return. The viewpoint is not applied: by convention of the library, coordinates are used as stored.
//!
//! Compressed data store one column after another, up to 4 GiB unpacked. One decoder runs to the last needed column and
//! leaves a copy of itself at the start of each: three to seven copies (with classes and colours) of 104 KiB, which
//! then advance in step. So memory does not depend on the file, and nothing is unpacked more than twice.
//!
//! Sources: "The PCD (Point Cloud Data) file format" (pointclouds.org); LZF as in liblzf 3.6.

use super::body::{Body, Form, RgbPlaces, look_behind};
use super::records::{Field, MOST_BYTES, Records, Rgb, Values, bits_of};
use super::text::Lines;
use super::values::{SAMPLE_POINTS, Sample};
use super::{Cloud, Depth, Opened, Opening, Piece, Source, Taker, shown};
use crate::colour::ColourSource;
use crate::number::Number;
use crate::source::Window;
use crate::text::BYTE_ORDER_MARK;
use crate::{Error, Result};
use std::io::{self, Read};

/// Longest header (bytes).
const MOST_HEADER: usize = 1 << 16;
/// Maximum number of fields.
const MOST_FIELDS: usize = 1024;

/// A field described by the header.
#[derive(Debug, Clone)]
struct PcdField {
    name: String,
    /// `None` for a type that PCD does not define.
    number: Option<Number>,
    size: usize,
    count: usize,
    /// Offset of its first byte in a record; `column`: its first column in a row.
    at: usize,
    column: usize,
}

#[derive(Debug)]
struct Header {
    fields: Vec<PcdField>,
    points: u64,
    /// Width and height, if their product is another number of points.
    grid: Option<(u64, u64)>,
    /// Alternative number of points.
    other: u64,
    data: String,
    moved: bool,
    end: u64,
}

impl Header {
    /// Parses a header; fails with the line number and the reason.
    fn parse(start: &[u8]) -> Result<Self, (usize, String)> {
        let (mut fields, mut sizes, mut types, mut counts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut width, mut height, mut points, mut moved) = (None, 1u64, None, false);
        let mark = if start.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
        let (mut at, mut number) = (mark, 0);
        let data = loop {
            number += 1;
            let wrong = |reason: String| (number, reason);
            let Some(len) = start[at..].iter().position(|&byte| byte == b'\n') else {
                return Err(wrong("the header has no DATA line; the file is cut, or not a PCD".into()));
            };
            let line = String::from_utf8_lossy(&start[at..at + len]).into_owned();
            at += len + 1;
            let line = line.split('#').next().unwrap_or_default();
            let mut words = line.split_whitespace();
            let Some(key) = words.next() else { continue };
            let words: Vec<String> = words.map(str::to_owned).collect();
            let whole = |what: &str| {
                let word = words.first().map_or("", String::as_str);
                word.parse::<u64>()
                    .map_err(|_| wrong(format!("expected {what} as a whole number, found {}", shown(word.as_bytes()))))
            };
            match key {
                "VERSION" => {}
                "FIELDS" | "COLUMNS" => fields = words,
                "SIZE" => sizes = words,
                "TYPE" => types = words,
                "COUNT" => counts = words,
                "WIDTH" => width = Some(whole("a width")?),
                "HEIGHT" => height = whole("a height")?,
                "POINTS" => points = Some(whole("a number of points")?),
                "VIEWPOINT" => {
                    let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
                    moved = !numbers.is_empty() && numbers != [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
                }
                "DATA" => break words.first().cloned().unwrap_or_default(),
                other => {
                    let reason = format!("expected a line of a PCD header, found {}", shown(other.as_bytes()));
                    return Err(wrong(reason));
                }
            }
        };
        let wrong = |reason: String| (number, reason);
        if fields.len() > MOST_FIELDS {
            return Err(wrong(format!("{} fields; at most {MOST_FIELDS} are read", fields.len())));
        }
        if sizes.len() != fields.len()
            || types.len() != fields.len()
            || !counts.is_empty() && counts.len() != fields.len()
        {
            let found = [fields.len(), sizes.len(), types.len(), counts.len()];
            return Err(wrong(format!("FIELDS, SIZE, TYPE and COUNT name {found:?} fields; expected as many each")));
        }
        let mut described = Vec::with_capacity(fields.len());
        let (mut byte, mut column) = (0usize, 0usize);
        for (at, name) in fields.into_iter().enumerate() {
            let small = |text: Option<&String>, most: usize| {
                let text = text.map_or("1", String::as_str);
                let count = text.parse::<usize>().ok().filter(|count| (1..=most).contains(count));
                count.ok_or_else(|| {
                    wrong(format!("field {}: expected 1 to {most}, found {}", at + 1, shown(text.as_bytes())))
                })
            };
            let (size, count) = (small(sizes.get(at), 8)?, small(counts.get(at), MOST_BYTES)?);
            let number = match (types[at].as_str(), size) {
                ("I", 1) => Some(Number::I8),
                ("U", 1) => Some(Number::U8),
                ("I", 2) => Some(Number::I16),
                ("U", 2) => Some(Number::U16),
                ("I", 4) => Some(Number::I32),
                ("U", 4) => Some(Number::U32),
                ("I", 8) => Some(Number::I64),
                ("U", 8) => Some(Number::U64),
                ("F", 4) => Some(Number::F32),
                ("F", 8) => Some(Number::F64),
                _ => None,
            };
            described.push(PcdField { name, number, size, count, at: byte, column });
            byte += size * count;
            column += count;
        }
        if byte > MOST_BYTES {
            return Err(wrong(format!("a point of {byte} bytes; at most {MOST_BYTES} are read")));
        }
        let twice = |axis: &&str| described.iter().filter(|field| field.name.eq_ignore_ascii_case(axis)).count() > 1;
        if let Some(axis) = ["x", "y", "z"].into_iter().find(twice) {
            return Err(wrong(format!("the field {axis} is there more than once; write it once")));
        }
        let of_grid = width.and_then(|width| width.checked_mul(height));
        let grid = width.filter(|_| points.is_some() && points != of_grid).map(|width| (width, height));
        let points = points.or(of_grid).ok_or_else(|| wrong("the header states no number of points".into()))?;
        Ok(Self { fields: described, points, grid, other: points, data, moved, end: at as u64 })
    }

    fn field(&self, names: &[&str]) -> Option<&PcdField> {
        self.fields.iter().find(|field| names.iter().any(|name| field.name.eq_ignore_ascii_case(name)))
    }
}

pub(super) fn open(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let mut start = vec![0; opening.bytes.min(MOST_HEADER as u64) as usize];
    let got = opening.source.read_at(&mut start, 0)?;
    start.truncate(got);
    let mut header = Header::parse(&start).map_err(|(line, reason)| opening.error(format!("line {line}"), reason))?;
    if let Some((width, height)) = header.grid {
        let points = header.points;
        let text = format!("the header states {points} points, but a width of {width} and a height of {height}");
        opening.findings.lose(text)?;
        // Compressed data show which of the two is right; otherwise, the larger number is read.
        let grid = width.saturating_mul(height);
        (header.points, header.other) = (points.max(grid), points.min(grid));
    }
    let header = header;
    let names = || header.fields.iter().map(|field| field.name.as_str()).collect::<Vec<_>>().join(" ");
    let (Some(x), Some(y), Some(z)) = (header.field(&["x"]), header.field(&["y"]), header.field(&["z"])) else {
        let reason = format!("expected the fields x, y and z, found {}: it holds no points", shown(names().as_bytes()));
        return Err(opening.error("FIELDS", reason));
    };
    let axes = [x, y, z];
    let class = header.field(&["classification", "class", "label"]).filter(|field| field.number.is_some());
    if let Some(wrong) = axes.iter().find(|field| field.number.is_none() || field.count != 1) {
        let reason = format!("{} has a type, size or count that no coordinate has", shown(wrong.name.as_bytes()));
        return Err(opening.error("TYPE", reason));
    }
    if header.moved {
        opening.findings.note("its viewpoint is not applied; the coordinates are used as they are stored");
    }
    let field = |field: &PcdField| Field { at: field.at, number: field.number.unwrap_or(Number::F32) };
    let number = |names: &[&str]| header.field(names).filter(|field| field.number.is_some() && field.count == 1);
    let packed = header.field(&["rgb", "rgba"]).filter(|field| field.size == 4 && field.count == 1);
    let each = match [&["red", "r"][..], &["green", "g"], &["blue", "b"]].map(number) {
        [Some(r), Some(g), Some(b)] => Some([r, g, b]),
        _ => None,
    };
    let intensity = number(&["intensity", "i", "reflectance"]);
    let rgb = packed.map(field).map(Rgb::Bytes).or(each.map(|each| Rgb::Fields(each.map(field))));
    let values = Values::new(rgb, intensity.map(field));
    let stride = header.fields.iter().map(|field| field.size * field.count).sum();
    match header.data.to_ascii_lowercase().as_str() {
        "ascii" => {
            let of_packed = |field: &PcdField| match field.number {
                Some(Number::F32) => RgbPlaces::Float(field.column),
                _ => RgbPlaces::Whole(field.column),
            };
            let lines = Lines::begin(opening.source, header.end);
            let form = Form {
                format: "PCD",
                commas: lines.peek()?.is_some_and(|row| row.contains(&b',')),
                words: header.fields.iter().map(|field| field.count).sum(),
                axes: axes.map(|field| field.column),
                class: class.map(|field| field.column),
                rgb: packed.map(of_packed).or(each.map(|each| RgbPlaces::Each(each.map(|field| field.column)))),
                intensity: intensity.map(|field| field.column),
                channels: values.channels,
            };
            Ok(Opened::new(Body::open(opening, form, lines, header.points, &[])?))
        }
        "binary" => {
            let points = Records::held(opening, header.end, stride, header.points)?;
            if points == header.points {
                look_behind(opening, header.end + points * stride as u64, stride, points)?;
            }
            Ok(Opened::new(Records {
                format: "PCD",
                start: header.end,
                stride,
                stated: header.points,
                points,
                axes: axes.map(field),
                class: class.map(field),
                values,
                big: false,
            }))
        }
        "binary_compressed" => {
            let columns = axes.map(field);
            open_packed(opening, &header, stride, (columns, class.map(field), values)).map(Opened::new)
        }
        other => Err(Error::Unsupported {
            what: format!("{}: PCD with DATA {}", opening.source.path().display(), shown(other.as_bytes())),
            version: env!("CARGO_PKG_VERSION"),
            suggestion: "ascii, binary and binary_compressed are read; save it as one of these".into(),
        }),
    }
}

/// Compressed columns.
#[derive(Debug)]
struct Packed {
    start: u64,
    len: u64,
    unpacked: u64,
    stated: u64,
    points: u64,
    /// Needed columns, with the bytes of a record before each: x, y, z, and classes if there are any.
    columns: Vec<Field>,
    values: Values,
}

fn open_packed(
    opening: &mut Opening<'_, '_>,
    header: &Header,
    stride: usize,
    (axes, class, values): ([Field; 3], Option<Field>, Values),
) -> Result<Packed> {
    let sizes = opening.source.bytes_at(header.end, 8)?;
    let Some(sizes) = sizes else {
        return Err(opening.error(format!("byte {}", header.end), "the file ends before its data: it is cut"));
    };
    let size = |at: usize| u64::from(u32::from_le_bytes([sizes[at], sizes[at + 1], sizes[at + 2], sizes[at + 3]]));
    let (packed, unpacked) = (size(0), size(4));
    let fits = |points: &u64| points.checked_mul(stride as u64) == Some(unpacked);
    let Some(mut points) = [header.points, header.other].into_iter().find(fits) else {
        let reason = format!(
            "the header states {} points of {stride} bytes, the data {unpacked} unpacked bytes: one of the two is damaged",
            header.points
        );
        return Err(opening.error(format!("byte {}", header.end + 4), reason));
    };
    let stated = points;
    let start = header.end + 8;
    let held = opening.bytes.saturating_sub(start);
    if held < packed {
        let reason = format!("its compressed data have {packed} bytes, the file holds {held} of them");
        opening.findings.lose_points(points, reason)?;
        points = 0;
    } else {
        look_behind(opening, start + packed, stride, points)?;
    }
    // A reference of three bytes unpacks to at most 264.
    if unpacked / 88 > packed + 1 {
        let reason = format!("{packed} compressed bytes cannot hold {unpacked} unpacked ones: it is damaged");
        return Err(opening.error(format!("byte {}", header.end), reason));
    }
    let columns = axes.into_iter().chain(class).collect();
    Ok(Packed { start, len: packed, unpacked, stated, points, columns, values })
}

/// A column that is being unpacked.
type Unpacked<'a> = (Lzf<Window<'a>>, Field);

fn damaged_data(error: io::Error, source: &Source) -> Error {
    match error.get_ref() {
        Some(_) => Error::input(source.path(), "compressed data", format!("{error}; fetch or write it again")),
        None => Error::io(source.path(), "read its compressed data", error),
    }
}

impl Packed {
    /// Returns a decoder for each field, at the first point of its column, in the order of the file.
    fn unpack<'a>(&self, mut fields: Vec<Field>, source: &'a Source) -> Result<Vec<Unpacked<'a>>> {
        fields.sort_by_key(|field| field.at);
        fields.dedup();
        let mut walk = Lzf::new(Window::new(source, self.start, self.len), self.unpacked);
        let mut at = 0;
        let columns = fields.into_iter().map(|field| {
            // Each column holds all points of the cloud.
            let begin = self.points * field.at as u64;
            walk.skip(begin - at).map_err(|error| damaged_data(error, source))?;
            at = begin;
            Ok((walk.clone(), field))
        });
        columns.collect()
    }
}

/// Returns the fields of a value.
fn fields_of(rgb: Option<Rgb>) -> Vec<Field> {
    match rgb {
        None => Vec::new(),
        Some(Rgb::Fields(fields)) => fields.to_vec(),
        Some(Rgb::Bytes(field)) => vec![field],
    }
}

impl Cloud for Packed {
    fn format(&self) -> &'static str {
        "PCD"
    }

    fn points_stated(&self) -> u64 {
        self.stated
    }

    fn points_expected(&self) -> u64 {
        self.points
    }

    fn has_values(&self, source: ColourSource) -> bool {
        if source == ColourSource::Class { self.columns.len() > 3 } else { self.values.channels.has(source) }
    }

    fn prepare(&mut self, source: ColourSource, file: &Source) -> Result<()> {
        let mut sample = Sample::NOTHING;
        if self.values.channels.is_open(source) {
            let points = self.points.min(16 * SAMPLE_POINTS as u64);
            let mut columns = self.unpack(fields_of(self.values.fields(source)), file)?;
            for _ in 0..points {
                for (lzf, field) in &mut columns {
                    let mut value = [0; 8];
                    let bytes = &mut value[..field.number.bytes()];
                    lzf.read_exact(bytes).map_err(|error| damaged_data(error, file))?;
                    sample.add(field.number.read(bytes, false));
                }
            }
        }
        self.values.channels.settle(source, &sample);
        Ok(())
    }

    fn depth(&self) -> Depth {
        self.values.channels.depth()
    }

    fn pieces(&self) -> Box<dyn Iterator<Item = Piece> + Send + '_> {
        let all = Piece { points: self.points, part: 0, first: 0, end: self.points };
        Box::new((self.points > 0).then_some(all).into_iter())
    }

    fn decode(&self, piece: &Piece, source: &Source, scratch: &mut Vec<u8>, taker: &mut Taker<'_>) -> Result<u64> {
        let needed = if taker.wants_classes() { self.columns.len() } else { 3 };
        let wanted = taker.wanted().and_then(|wanted| Some((wanted, self.values.fields(wanted)?)));
        let of_value = fields_of(wanted.map(|(_, fields)| fields));
        let mut columns = self.unpack([&self.columns[..needed], &of_value].concat(), source)?;
        let at_once = piece.end.clamp(1, 1 << 13) as usize;
        scratch.resize(at_once * 8 * 7, 0);
        let is_single = [0, 1, 2].map(|axis| self.columns[axis].number == Number::F32);
        let mut next = 0;
        while next < piece.end {
            let count = (piece.end - next).min(at_once as u64) as usize;
            let mut values = scratch.chunks_exact_mut(at_once * 8);
            let mut filled = Vec::with_capacity(columns.len());
            for (lzf, field) in &mut columns {
                let Some(bytes) = values.next() else { break };
                let bytes = &mut bytes[..count * field.number.bytes()];
                lzf.read_exact(bytes).map_err(|error| damaged_data(error, source))?;
                filled.push((&*bytes, *field));
            }
            let value = |column: usize, row: usize| {
                let (bytes, Field { number, .. }): (&[u8], Field) = filled[column];
                number.read(&bytes[row * number.bytes()..], false)
            };
            let of_field = |field: Field| filled.iter().position(|filled| filled.1 == field).unwrap_or(0);
            let axes = [0, 1, 2].map(|axis| of_field(self.columns[axis]));
            let class = self.columns[3..needed].first().map(|class| of_field(*class));
            for row in 0..count {
                let colour = wanted.and_then(|(source, _)| {
                    let number = |field: Field| value(of_field(field), row);
                    let bits = |field: Field| bits_of(&filled[of_field(field)].0[4 * row..]);
                    self.values.of(source, number, bits)
                });
                let at = axes.map(|axis| value(axis, row));
                taker.note_singles(at, is_single);
                taker.push(at, class.map(|class| value(class, row)), colour)?;
            }
            next += count as u64;
        }
        if let Some((last, _)) = columns.last_mut() {
            last.finish().map_err(|error| damaged_data(error, source))?;
        }
        Ok(0)
    }

    fn state(&self) -> Vec<u8> {
        let fields = self.columns.iter().flat_map(|field| [field.at as u64, field.number as u64]);
        [self.start, self.len, self.points].into_iter().chain(fields).flat_map(u64::to_le_bytes).collect()
    }
}

/// Maximum distance of an LZF reference, and number of bytes unpacked at once.
const FARTHEST_BACK: usize = 1 << 13;
const AT_ONCE: usize = 1 << 15;

/// Unpacks LZF as a stream, keeping the last 8 KiB.
///
/// A control byte `n` below 32 is followed by `n + 1` literal bytes. Any other control byte begins a reference: its
/// upper three bits are the length less 2 (if 7, a byte follows that is added), its lower five bits and one more byte
/// the distance less 1.
#[derive(Clone)]
struct Lzf<R> {
    packed: R,
    /// Unpacked bytes: history before `next`, unread bytes from `next` on.
    made: Vec<u8>,
    next: usize,
    /// Number of bytes still to be unpacked.
    left: u64,
}

impl<R: Read> Lzf<R> {
    /// Creates a decoder that unpacks to `bytes` bytes.
    fn new(packed: R, bytes: u64) -> Self {
        Self { packed, made: Vec::new(), next: 0, left: bytes }
    }

    fn packed(&mut self, out: &mut [u8]) -> io::Result<()> {
        self.packed.read_exact(out).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => damaged("the data end too early"),
            _ => error,
        })
    }

    fn byte(&mut self) -> io::Result<usize> {
        let mut byte = [0];
        self.packed(&mut byte)?;
        Ok(byte[0].into())
    }

    /// Unpacks one control byte and what belongs to it.
    #[inline]
    fn follow(&mut self) -> io::Result<()> {
        let (control, begin) = (self.byte()?, self.made.len());
        if control < 32 {
            let mut bytes = [0; 32];
            let bytes = &mut bytes[..=control];
            self.packed(bytes)?;
            self.made.extend_from_slice(bytes);
        } else {
            let mut len = (control >> 5) + 2;
            if len == 9 {
                len += self.byte()?;
            }
            let back = ((control & 31) << 8 | self.byte()?) + 1;
            let Some(from) = begin.checked_sub(back) else {
                return Err(damaged("a reference to before the first byte"));
            };
            if back >= len {
                self.made.extend_from_within(from..from + len);
            } else {
                // The reference overlaps its own output, which repeats.
                let mut missing = len;
                while missing > 0 {
                    let now = missing.min(self.made.len() - from);
                    self.made.extend_from_within(from..from + now);
                    missing -= now;
                }
            }
        }
        let left = self.left.checked_sub((self.made.len() - begin) as u64);
        self.left = left.ok_or_else(|| damaged("more bytes than it states"))?;
        Ok(())
    }

    /// Returns the unread bytes, at least one.
    fn ahead(&mut self) -> io::Result<&[u8]> {
        if self.next == self.made.len() {
            self.made.drain(..self.next.saturating_sub(FARTHEST_BACK));
            self.next = self.made.len();
            while self.made.len() < self.next + AT_ONCE && self.left > 0 {
                self.follow()?;
            }
            if self.next == self.made.len() {
                return Err(damaged("fewer bytes than it states"));
            }
        }
        Ok(&self.made[self.next..])
    }

    /// Skips bytes.
    fn skip(&mut self, mut count: u64) -> io::Result<()> {
        while count > 0 {
            let now = (self.ahead()?.len() as u64).min(count);
            self.next += now as usize;
            count -= now;
        }
        Ok(())
    }

    fn read_exact(&mut self, mut out: &mut [u8]) -> io::Result<()> {
        while !out.is_empty() {
            let ahead = self.ahead()?;
            let now = ahead.len().min(out.len());
            let (filled, rest) = out.split_at_mut(now);
            filled.copy_from_slice(&ahead[..now]);
            out = rest;
            self.next += now;
        }
        Ok(())
    }

    /// Unpacks the rest; the packed bytes must end there.
    fn finish(&mut self) -> io::Result<()> {
        self.skip((self.made.len() - self.next) as u64 + self.left)?;
        match self.packed.read(&mut [0])? {
            0 => Ok(()),
            _ => Err(damaged("bytes follow the end of the data")),
        }
    }
}

fn damaged(reason: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("LZF: {reason}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpack(packed: &[u8], len: usize) -> io::Result<Vec<u8>> {
        let (mut lzf, mut out) = (Lzf::new(packed, len as u64), vec![0; len]);
        lzf.read_exact(&mut out)?;
        lzf.finish().map(|()| out)
    }

    #[test]
    fn references_may_overlap_what_they_make_and_reach_the_whole_window() {
        // "abc", then 7 bytes from 3 back, then 9 + 4 from 1 back by the long form.
        let packed = [2, b'a', b'b', b'c', 5 << 5, 2, 7 << 5, 4, 0];
        assert_eq!(unpack(&packed, 23).unwrap(), b"abcabcabcaaaaaaaaaaaaaa");
        let plain: Vec<u8> = (0..FARTHEST_BACK).map(|i| ((i * i) >> 3) as u8).collect();
        let mut packed: Vec<u8> = Vec::new();
        for piece in plain.chunks(32) {
            packed.push(piece.len() as u8 - 1);
            packed.extend(piece);
        }
        packed.extend([1 << 5 | 31, 255]);
        let unpacked = unpack(&packed, FARTHEST_BACK + 3).unwrap();
        assert_eq!(unpacked[..FARTHEST_BACK], plain);
        assert_eq!(unpacked[FARTHEST_BACK..], plain[..3]);
        // Also after old history was dropped.
        let packed: Vec<u8> = packed.repeat(40).into_iter().collect();
        let unpacked = unpack(&packed, 40 * (FARTHEST_BACK + 3)).unwrap();
        assert!(
            unpacked
                .chunks(FARTHEST_BACK + 3)
                .all(|again| again[..FARTHEST_BACK] == plain && again[FARTHEST_BACK..] == plain[..3])
        );
    }

    #[test]
    fn damage_is_an_error_and_reading_piecewise_changes_nothing() {
        for packed in [&[1 << 5, 0][..], &[5, 1, 2], &[0, 1, 1 << 5 | 31, 0], &[0, 1, 1 << 5], &[]] {
            assert!(unpack(packed, 40).unwrap_err().to_string().starts_with("LZF: "), "{packed:?}");
        }
        let packed = [2, b'a', b'b', b'c', 7 << 5, 100, 1, 0, b'z'];
        let whole = unpack(&packed, 113).unwrap();
        for (len, reason) in [(112, "bytes follow"), (111, "more bytes"), (114, "end too early")] {
            assert!(unpack(&packed, len).unwrap_err().to_string().contains(reason), "{len}");
        }
        let one: &[u8] = &[0, b'a'];
        let mut short = Lzf::new(one, 1);
        let error = short.read_exact(&mut [0; 2]).unwrap_err().to_string();
        assert!(error.contains("fewer bytes"), "{error}");
        let mut lzf = Lzf::new(&packed[..], 113);
        let mut pieces = Vec::new();
        for len in [1, 0, 5, 60] {
            let mut piece = vec![0; len];
            lzf.read_exact(&mut piece).unwrap();
            pieces.extend(piece);
        }
        let mut other = lzf.clone();
        lzf.skip(46).unwrap();
        let mut piece = [0];
        lzf.read_exact(&mut piece).unwrap();
        assert_eq!(piece[0], whole[112]);
        let mut rest = [0; 47];
        other.read_exact(&mut rest).unwrap();
        pieces.extend(rest);
        assert_eq!(pieces, whole);
    }
}
