//! Headers of PLY files, for both points and meshes.
//!
//! Source: Greg Turk, "The PLY Polygon File Format", 1994. Memory: the header, at most 1 MiB.

use super::number::Number;
use crate::text::shown;

/// Longest header (bytes).
pub const MOST_HEADER: usize = 1 << 20;
/// Maximum number of elements, and of properties per element.
const MOST_PARTS: usize = 1024;

const NO_PLY: &str = "expected \"ply\": this is no PLY file";

/// Returns the byte that ends each line of the file that begins with `start`: CR if it alone ends the first one.
pub fn line_end(start: &[u8]) -> u8 {
    // A LF behind the last line may belong to a binary body.
    let first = memchr::memchr2(b'\n', b'\r', start);
    let is_return = first.is_some_and(|at| start[at] == b'\r' && start.get(at + 1) != Some(&b'\n'));
    if is_return { b'\r' } else { b'\n' }
}

/// Encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Text.
    Text,
    /// Binary, lowest byte first.
    Little,
    /// Binary, highest byte first.
    Big,
}

/// A property of an element.
#[derive(Debug)]
pub struct Property {
    /// Name.
    pub name: String,
    /// Type of the count, if the property is a list.
    pub list: Option<Number>,
    /// Type of the value, or of the values of a list.
    pub number: Number,
}

/// An element: `count` rows of these properties.
#[derive(Debug)]
pub struct Element {
    /// Name.
    pub name: String,
    /// Number of rows.
    pub count: u64,
    /// Properties of a row, in order.
    pub properties: Vec<Property>,
}

/// A parsed header.
#[derive(Debug)]
pub struct Header {
    /// Encoding of the rows.
    pub encoding: Encoding,
    /// Elements, in order.
    pub elements: Vec<Element>,
}

impl Header {
    /// Checks that the rows of its elements can be separated and that the points are unambiguous; returns the reason if
    /// not.
    pub fn check(&self) -> Result<(), String> {
        if self.elements.iter().filter(|element| element.name == "vertex").count() > 1 {
            return Err("it has the element \"vertex\" more than once; write it once".into());
        }
        for (number, element) in self.elements.iter().enumerate() {
            if element.properties.is_empty() && element.count > 0 {
                return Err(format!("element {} has no properties", number + 1));
            }
            let of_name = |name: &str| element.properties.iter().filter(|p| p.name.eq_ignore_ascii_case(name)).count();
            if element.name == "vertex"
                && let Some(twice) = ["x", "y", "z"].into_iter().find(|axis| of_name(axis) > 1)
            {
                return Err(format!("the element \"vertex\" has the property {twice} more than once; write it once"));
            }
        }
        Ok(())
    }
}

/// Parses a header line by line.
#[derive(Debug, Default)]
pub struct HeaderReader {
    lines: u64,
    bytes: usize,
    encoding: Option<Encoding>,
    elements: Vec<Element>,
}

impl HeaderReader {
    /// Error for a header longer than [`MOST_HEADER`].
    pub const LONG: &str = "no \"end_header\" in the first MiB: this is no PLY, or damaged";

    /// Returns the error for a file that ends here.
    pub fn cut(&self) -> &'static str {
        if self.lines == 0 { NO_PLY } else { "the file ends before \"end_header\": it is cut; fetch it again" }
    }

    /// Takes the next line; returns the header with the last line, or what is wrong with the line.
    pub fn take(&mut self, line: &[u8]) -> Result<Option<Header>, String> {
        self.lines += 1;
        self.bytes += line.len() + 1;
        if self.bytes > MOST_HEADER {
            return Err(Self::LONG.into());
        }
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_whitespace().collect();
        if self.lines == 1 {
            return if words == ["ply"] { Ok(None) } else { Err(NO_PLY.into()) };
        }
        match words[..] {
            ["format", name, "1.0"] => {
                self.encoding = Some(match name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => {
                        let expected = "expected format ascii, binary_little_endian or binary_big_endian";
                        return Err(format!("{expected}, found {}", shown(other.as_bytes())));
                    }
                });
            }
            ["element", name, count] => {
                let unclear = |_| format!("expected a number of elements, found {}", shown(count.as_bytes()));
                let count = count.parse().map_err(unclear)?;
                self.elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref property @ ..] => {
                let parsed = match *property {
                    ["list", count, number, name] => number_named(count)
                        .zip(number_named(number))
                        .map(|(count, number)| Property { name: name.into(), list: Some(count), number }),
                    [number, name] => {
                        number_named(number).map(|number| Property { name: name.into(), list: None, number })
                    }
                    _ => None,
                };
                let unknown = || format!("a property that PLY does not know: {}", shown(property.join(" ").as_bytes()));
                let element = self.elements.last_mut().ok_or("a property before any element")?;
                element.properties.push(parsed.ok_or_else(unknown)?);
            }
            ["end_header"] => {
                let encoding = self.encoding.ok_or("no line \"format\" before the end")?;
                return Ok(Some(Header { encoding, elements: std::mem::take(&mut self.elements) }));
            }
            [] | ["comment" | "obj_info", ..] => {}
            [other, ..] => return Err(format!("expected a line of a PLY header, found {}", shown(other.as_bytes()))),
        }
        if self.elements.len() > MOST_PARTS || self.elements.last().is_some_and(|e| e.properties.len() > MOST_PARTS) {
            return Err(format!("more than {MOST_PARTS} elements or properties"));
        }
        Ok(None)
    }
}

fn number_named(name: &str) -> Option<Number> {
    Some(match name {
        "char" | "int8" => Number::I8,
        "uchar" | "uint8" => Number::U8,
        "short" | "int16" => Number::I16,
        "ushort" | "uint16" => Number::U16,
        "int" | "int32" => Number::I32,
        "uint" | "uint32" => Number::U32,
        "half" | "float16" => Number::F16,
        "float" | "float32" => Number::F32,
        "double" | "float64" => Number::F64,
        _ => return None,
    })
}
