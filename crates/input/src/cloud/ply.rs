//! PLY without faces: points, as text or binary of either byte order.
//!
//! Only the element `vertex` is read; other elements are skipped, including those after it: anything behind them would
//! be points that the header does not state. Its properties may come in any order and of any type except lists. Memory:
//! the header, at most 1 MiB.

use super::body::{self, Body, Form, RgbPlaces};
use super::records::{Field, MOST_BYTES, Records, Rgb, Values, kind_of};
use super::text::Lines;
use super::values::Channels;
use super::{Opened, Opening, SPLATS, shown};
use crate::diagnostics::without_path;
use crate::ply_header::{Element, Encoding, Header, HeaderReader, MOST_HEADER, Property, line_end};
use crate::text::BYTE_ORDER_MARK;
use crate::{Error, Result};
use std::io::Read;

/// Maximum number of values in a list.
const MOST_IN_LIST: f64 = 65_536.0;

/// A header, and the offset of the body.
struct Start {
    header: Header,
    end: u64,
}

impl Start {
    /// Parses the start of a file; fails with the line number and what is wrong with the line.
    fn parse(start: &[u8]) -> Result<Self, (usize, String)> {
        let mark = if start.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
        let (mut reader, mut at, mut number) = (HeaderReader::default(), mark, 0);
        let line_end = line_end(start);
        loop {
            number += 1;
            let Some(len) = memchr::memchr(line_end, &start[at..]) else {
                let reason = if start.len() < MOST_HEADER { reader.cut() } else { HeaderReader::LONG };
                return Err((number, reason.into()));
            };
            let line = &start[at..at + len];
            at += len + 1;
            if let Some(header) = reader.take(line).map_err(|reason| (number, reason))? {
                return Ok(Self { header, end: at as u64 });
            }
        }
    }

    /// Returns whether it has properties that only splats have.
    fn is_splat(&self) -> bool {
        let named = |element: &Element| {
            element.properties.iter().any(|p| p.name == "packed_position" || p.name == "f_dc_0" || p.name == "rot_0")
        };
        self.header.elements.iter().filter(|element| element.name == "vertex").any(named)
    }

    /// Returns whether it has surfaces.
    fn has_faces(&self) -> bool {
        let is_face = |name: &str| name == "face" || name == "tristrips";
        self.header.elements.iter().any(|element| element.count > 0 && is_face(&element.name))
    }
}

/// Returns whether the PLY with this start is read here rather than as a mesh: it has no faces, or is a splat. A damaged
/// header is left to the mesh reader, which reports what is wrong.
pub fn is_point_cloud(start: &[u8]) -> bool {
    Start::parse(start).is_ok_and(|start| !start.has_faces() || start.is_splat())
}

pub(super) fn open(opening: &mut Opening<'_, '_>) -> Result<Opened> {
    let mut start = vec![0; opening.bytes.min(MOST_HEADER as u64) as usize];
    let got = opening.source.read_at(&mut start, 0)?;
    start.truncate(got);
    let start = Start::parse(&start).map_err(|(line, reason)| opening.error(format!("line {line}"), reason))?;
    if start.is_splat() {
        return Err(opening.error("header", SPLATS));
    }
    let Start { header, end } = start;
    let number = header.elements.iter().position(|element| element.name == "vertex");
    let Some((before, [vertex, behind @ ..])) = number.map(|number| header.elements.split_at(number)) else {
        return Err(opening.error("header", "it has no element \"vertex\": there are no points in it"));
    };
    header.check().map_err(|reason| opening.error("header", reason))?;
    let find = |names: &[&str]| {
        let is_named = |p: &Property| names.iter().any(|name| p.name.eq_ignore_ascii_case(name));
        vertex.properties.iter().position(is_named)
    };
    if vertex.properties.iter().any(|property| property.list.is_some()) {
        return Err(opening.error("header", "the element \"vertex\" has lists; write it without them"));
    }
    let (Some(x), Some(y), Some(z)) = (find(&["x"]), find(&["y"]), find(&["z"])) else {
        return Err(opening.error("header", "the element \"vertex\" has no properties x, y and z"));
    };
    let class = find(&["classification", "scalar_classification", "class"]);
    let rgb = [&["red", "r", "diffuse_red"][..], &["green", "g", "diffuse_green"], &["blue", "b", "diffuse_blue"]];
    let rgb = match rgb.map(find) {
        [Some(r), Some(g), Some(b)] => Some([r, g, b]),
        _ => None,
    };
    let intensity = find(&["intensity", "scalar_intensity", "reflectance", "scalar_reflectance"]);
    if header.encoding == Encoding::Text {
        let kind = |columns: &[usize]| {
            kind_of(&columns.iter().map(|&column| vertex.properties[column].number).collect::<Vec<_>>())
        };
        let channels = Channels::new(rgb.map(|rgb| kind(&rgb)), intensity.map(|column| kind(&[column])));
        let (axes, words, rgb) = ([x, y, z], vertex.properties.len(), rgb.map(RgbPlaces::Each));
        let form = Form { format: "PLY", commas: false, words, axes, class, rgb, intensity, channels };
        let mut lines = Lines::begin(opening.source, end);
        body::pass(&mut lines, before, opening.monitor)?.map_err(|reason| lines.error(reason))?;
        return Ok(Opened::new(Body::open(opening, form, lines, vertex.count, behind)?));
    }
    let big = header.encoding == Encoding::Big;
    let mut at = end;
    for element in before {
        at = skip(opening, element, at, big)?;
    }
    let mut stride = 0;
    let offsets: Vec<usize> = vertex
        .properties
        .iter()
        .map(|property| {
            stride += property.number.bytes();
            stride - property.number.bytes()
        })
        .collect();
    if stride > MOST_BYTES {
        return Err(Error::limit("bytes of a point", stride, MOST_BYTES));
    }
    let field = |number: usize| Field { at: offsets[number], number: vertex.properties[number].number };
    let points = Records::held(opening, at, stride, vertex.count)?;
    if points == vertex.count {
        let mut end = Ok(at + points * stride as u64);
        for element in behind {
            end = end.and_then(|end| skip(opening, element, end, big));
        }
        match end {
            Ok(end) => body::look_behind(opening, end, stride, vertex.count)?,
            Err(error @ Error::Input { .. }) => {
                opening.findings.note(format!("behind its points: {}", without_path(error)));
            }
            Err(error) => return Err(error),
        }
    }
    Ok(Opened::new(Records {
        format: "PLY",
        start: at,
        stride,
        stated: vertex.count,
        points,
        axes: [x, y, z].map(field),
        class: class.map(field),
        values: Values::new(rgb.map(|rgb| Rgb::Fields(rgb.map(field))), intensity.map(field)),
        big,
    }))
}

/// Returns the offset of the first byte after an element of a binary body.
fn skip(opening: &Opening<'_, '_>, element: &Element, start: u64, big: bool) -> Result<u64> {
    let cut = |opening: &Opening<'_, '_>| {
        opening.error("body", format!("the file ends within the element {}", shown(element.name.as_bytes())))
    };
    let fixed: u64 = element.properties.iter().filter(|p| p.list.is_none()).map(|p| p.number.bytes() as u64).sum();
    if element.properties.iter().all(|property| property.list.is_none()) {
        let end = element.count.checked_mul(fixed).and_then(|bytes| bytes.checked_add(start));
        return end.filter(|&end| end <= opening.bytes).ok_or_else(|| cut(opening));
    }
    // Lists are skipped number by number; each takes bytes of the file, which bounds the loop.
    let mut window = super::super::source::Window::new(opening.source, start, opening.bytes.saturating_sub(start));
    let mut value = [0; 8];
    for instance in 0..element.count {
        if instance.is_multiple_of(4096) && opening.monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        for property in &element.properties {
            let count = match property.list {
                None => 1,
                Some(number) => {
                    let value = &mut value[..number.bytes()];
                    window.read_exact(value).map_err(|_| cut(opening))?;
                    let count = number.read(value, big);
                    if !(0.0..=MOST_IN_LIST).contains(&count) || count.fract() != 0.0 {
                        let reason = format!("a list of {count} numbers; expected 0 to {MOST_IN_LIST}");
                        return Err(opening.error(format!("byte {}", start + window.position()), reason));
                    }
                    count as usize
                }
            };
            for _ in 0..count {
                window.read_exact(&mut value[..property.number.bytes()]).map_err(|_| cut(opening))?;
            }
        }
    }
    Ok(start + window.position())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_bounded_and_cut_ones_are_no_cloud() {
        let endless = [&b"ply\ncomment "[..], &vec![b'c'; MOST_HEADER]].concat();
        for (start, words) in [
            (&endless[..MOST_HEADER], "no \"end_header\" in the first MiB"),
            (&endless[..100], "the file ends before \"end_header\""),
            (b"ply", "expected \"ply\""),
        ] {
            let Err((_, reason)) = Start::parse(start) else { panic!("{words}: it is parsed") };
            assert!(reason.contains(words), "{words}: {reason}");
            assert!(!is_point_cloud(start), "{words}");
        }
    }
}
