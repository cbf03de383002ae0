//! Assignment of the columns of text files.

use crate::text::shown;
use serde_json::{Value, json};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Maximum number of columns that can be named.
const MOST: usize = 64;

/// Columns of text, from left to right: `x`, `y`, `z`, optionally `class`, `i` (intensity) and `r`, `g`, `b`; a column
/// with any other name (`-`) is skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Columns {
    pub(super) axes: [u8; 3],
    pub(super) class: Option<u8>,
    pub(super) intensity: Option<u8>,
    pub(super) rgb: Option<[u8; 3]>,
}

/// Parses the command-line form: `x,y,z,i,r,g,b`, in the order of the columns.
impl FromStr for Columns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names: Vec<String> = text.split(',').map(|name| name.trim().to_ascii_lowercase()).collect();
        let find = |wanted: &[&str]| -> Result<Option<u8>, String> {
            let mut places = (0u8..).zip(&names).filter(|(_, name)| wanted.contains(&name.as_str()));
            match (places.next(), places.next()) {
                (Some(_), Some(_)) => Err(format!("{} stands there twice", wanted[0])),
                (first, _) => Ok(first.map(|(place, _)| place)),
            }
        };
        if names.len() > MOST {
            return Err(format!("expected at most {MOST} columns, found {}", names.len()));
        }
        let missing = || "expected names of columns with x, y and z, such as x,y,z,i".to_owned();
        let axis = |name| find(&[name])?.ok_or_else(missing);
        let channels = [find(&["r", "red"])?, find(&["g", "green"])?, find(&["b", "blue"])?];
        let rgb = match channels {
            [Some(r), Some(g), Some(b)] => Some([r, g, b]),
            [None, None, None] => None,
            _ => return Err("expected all of r, g and b, or none of them".into()),
        };
        Ok(Self {
            axes: [axis("x")?, axis("y")?, axis("z")?],
            class: find(&["class", "classification", "c"])?,
            intensity: find(&["i", "intensity"])?,
            rgb,
        })
    }
}

/// Writes the form that [`FromStr`] parses, with `-` for skipped columns.
impl Display for Columns {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let named = self.axes.into_iter().zip(["x", "y", "z"]);
        let named = named.chain(self.class.map(|place| (place, "class")));
        let named = named.chain(self.intensity.map(|place| (place, "i")));
        let named: Vec<_> = named.chain(self.rgb.into_iter().flatten().zip(["r", "g", "b"])).collect();
        let last = named.iter().map(|named| named.0).max().unwrap_or(0);
        for place in 0..=last {
            let name = named.iter().find(|named| named.0 == place).map_or("-", |named| named.1);
            write!(f, "{}{name}", if place > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}

/// How a text scan was interpreted, so that a person can spot a wrong guess.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TextLayout {
    /// Column separator: blanks, commas, semicolons or tabs.
    pub separator: &'static str,
    /// True if numbers have decimal commas.
    pub decimal_comma: bool,
    /// Columns that are read: x, y and z, and class, intensity, red, green and blue where present.
    pub columns: Vec<TextColumn>,
    /// The first points, at most three, in the file's own coordinates.
    pub first_points: Vec<[f64; 3]>,
}

/// A text column that is read.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct TextColumn {
    /// Content: `x`, `y`, `z`, `class`, `intensity`, `red`, `green`, `blue`, or `rgb` for colours in one number.
    pub holds: &'static str,
    /// Column number, from 1.
    pub number: usize,
    /// Name in the header, if the header has one.
    pub name: Option<String>,
}

impl TextLayout {
    /// Returns the layout as JSON: `separator`, `decimal_comma`, `columns` (each with `holds`, `number` and `name`) and
    /// `first_points`.
    pub fn info(&self) -> Value {
        let column =
            |TextColumn { holds, number, name }: &TextColumn| json!({ "holds": holds, "number": number, "name": name });
        json!({
            "separator": self.separator,
            "decimal_comma": self.decimal_comma,
            "columns": self.columns.iter().map(column).collect::<Vec<_>>(),
            "first_points": self.first_points,
        })
    }
}

/// Describes the layout in words: `x is column 2 "X", y is column 3 "Y", z is column 4 "Z", separated by commas`.
impl Display for TextLayout {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        for TextColumn { holds, number, name } in &self.columns {
            write!(f, "{holds} is column {number}")?;
            if let Some(name) = name {
                write!(f, " {}", shown(name.as_bytes()))?;
            }
            f.write_str(", ")?;
        }
        write!(f, "separated by {}{}", self.separator, if self.decimal_comma { ", decimal commas" } else { "" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_read_as_they_are_written() {
        for (text, again) in [
            ("x,y,z", "x,y,z"),
            ("z, -,Y,x,Red,green,b", "z,-,y,x,r,g,b"),
            ("id,x,y,z,Classification,Intensity,t", "-,x,y,z,class,i"),
        ] {
            let columns: Columns = text.parse().unwrap();
            assert_eq!(columns.to_string(), again);
            assert_eq!(again.parse::<Columns>().unwrap(), columns);
        }
        for wrong in ["", "x,y", "x,y,z,x", "x,y,z,r,g", "x,y,z,i,intensity", &"x,".repeat(100)] {
            assert!(wrong.parse::<Columns>().is_err(), "{wrong}");
        }
    }
}
