//! Values of options as text: on the command line, in Python and in the browser. Messages say what is expected.

use crate::Error;
use crate::archive::MAX_SHARDS;
use crate::input::Units;
use crate::placement::Similarity;
use crate::plan::Up;
use crate::upright::Turn;
use std::io::Read;
use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;

/// Parses a length (m).
pub fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("expected a length in metres above 0".into()),
    }
}

/// Parses a class or a range of classes: `7`, `64-255`.
pub fn class_range(text: &str) -> Result<RangeInclusive<u8>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.trim().parse(), last.trim().parse()) {
        (Ok(first), Ok(last)) if first <= last => Ok(first..=last),
        _ => Err("expected classes from 0 to 255 and ranges of them, such as 7,18,64-255".into()),
    }
}

/// Choice of the direction that points up.
#[derive(Debug, Clone, Copy)]
pub struct UpChoice {
    /// Axis of the plan.
    pub axis: Up,
    /// Turn of scans and splats, if meshes cannot be turned likewise.
    pub turn: Turn,
}

impl FromStr for UpChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (axis, turn) = match text {
            "z" => (Up::Z, Turn::None),
            "y" => (Up::Y, Turn::None),
            "x" => (Up::Z, Turn::From([1.0, 0.0, 0.0])),
            "-x" => (Up::Z, Turn::From([-1.0, 0.0, 0.0])),
            "-y" => (Up::Z, Turn::From([0.0, -1.0, 0.0])),
            "-z" => (Up::Z, Turn::From([0.0, 0.0, -1.0])),
            "auto" => (Up::Z, Turn::Auto),
            _ => return Err("expected auto, z, y, x, -z, -y or -x".into()),
        };
        Ok(Self { axis, turn })
    }
}

/// Parses the number of an EPSG code.
pub fn epsg(text: &str) -> Result<u32, String> {
    let code = text.get(..5).filter(|start| start.eq_ignore_ascii_case("EPSG:")).and_then(|_| text[5..].parse().ok());
    code.filter(|code| (1..1_000_000).contains(code)).ok_or_else(|| "expected a code such as EPSG:25832".into())
}

/// Parses a part and their number: `2/8`.
pub fn part(text: &str) -> Result<(u32, u32), String> {
    let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    numbers
        .filter(|&(index, count)| (1..=count).contains(&index) && count <= MAX_SHARDS)
        .ok_or_else(|| format!("expected a part and their number, from 1/1 to {0}/{0}", MAX_SHARDS))
}

/// Returns the unit by which two places (`X,Y,Z`, in the file's coordinates) are the stated metres apart.
pub fn scale_from(from: &str, to: &str, metres: &str) -> Result<Units, String> {
    let place = |text: &str| -> Result<[f64; 3], String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        let numbers = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
        let finite = numbers.filter(|numbers| numbers.iter().all(|v| v.is_finite()));
        finite.ok_or_else(|| format!("{text:?} is not a place; expected X,Y,Z"))
    };
    unit_from(place(from)?, place(to)?, length(metres)?)
}

/// Returns the unit by which two places in the file's coordinates are `metres` apart.
pub fn unit_from(from: [f64; 3], to: [f64; 3], metres: f64) -> Result<Units, String> {
    let apart = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt();
    if !(metres > 0.0 && metres.is_finite()) {
        Err("expected a distance in metres above 0".into())
    } else if apart > 0.0 && apart.is_finite() {
        Ok(Units::Factor(metres / apart))
    } else {
        Err("the two places are the same; name places as far apart as possible".into())
    }
}

/// Reads a 4 × 4 matrix from a text file.
pub fn transform(path: &Path) -> crate::Result<Similarity> {
    /// Longest text of a matrix (bytes).
    const MOST_BYTES: u64 = 1 << 16;
    let file = std::fs::File::open(path).map_err(|error| Error::io(path, "open", error))?;
    let mut text = String::new();
    file.take(MOST_BYTES).read_to_string(&mut text).map_err(|error| Error::io(path, "read", error))?;
    Similarity::parse(text.trim_start_matches('\u{feff}')).map_err(|reason| Error::input(path, "matrix", reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_places_and_their_distance_give_the_unit() {
        assert_eq!(scale_from("1,1,1", " 4, 5,1", "10"), Ok(Units::Factor(2.0)));
        for (from, to, metres, expected) in [
            ("1,1", "4,5,1", "10", "\"1,1\" is not a place"),
            ("1,1,1", "4,5,x", "10", "\"4,5,x\" is not a place"),
            ("1,1,1", "4,5,inf", "10", "\"4,5,inf\" is not a place"),
            ("1,1,1", "4,5,1", "0", "a length in metres above 0"),
            ("1,1,1", "1,1,1", "10", "the two places are the same"),
        ] {
            let error = scale_from(from, to, metres).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        for metres in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(unit_from([0.0; 3], [1.0; 3], metres).unwrap_err().contains("a distance in metres above 0"));
        }
    }

    #[test]
    fn a_matrix_that_cannot_be_read_is_refused_by_the_name_of_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.txt");
        let refused = |expected: &str| {
            let error = transform(&path).unwrap_err().to_string();
            assert!(error.contains("m.txt") && error.contains(expected), "{error}");
        };
        refused("open");
        std::fs::write(&path, b"1 0 0 \xFF").unwrap();
        refused("read");
        std::fs::write(&path, "1 0 0 0").unwrap();
        refused("matrix");
    }
}
