//! Which column of a text is which.

use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Most columns that can be named.
const MOST: usize = 64;

/// Columns of text, from left to right: `x`, `y`, `z`, maybe `class`; every other name (`i`, `r`, `-`) is passed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Columns {
    pub(super) axes: [u8; 3],
    pub(super) class: Option<u8>,
}

/// As the command line takes it: `x,y,z,i,r,g,b`, in the order of the columns.
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
        Ok(Self { axes: [axis("x")?, axis("y")?, axis("z")?], class: find(&["class", "classification", "c"])? })
    }
}

/// As [`FromStr`] reads it, with `-` for columns that are passed over.
impl Display for Columns {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let last = self.axes.into_iter().chain(self.class).max().unwrap_or(0);
        for place in 0..=last {
            let axis = self.axes.iter().position(|&axis| axis == place);
            let name = match axis {
                Some(axis) => ["x", "y", "z"][axis],
                None if self.class == Some(place) => "class",
                None => "-",
            };
            write!(f, "{}{name}", if place > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_read_as_they_are_written() {
        for (text, again) in
            [("x,y,z", "x,y,z"), ("z, -,Y,x,i,r,g,b", "z,-,y,x"), ("id,x,y,z,Classification,t", "-,x,y,z,class")]
        {
            let columns: Columns = text.parse().unwrap();
            assert_eq!(columns.to_string(), again);
            assert_eq!(again.parse::<Columns>().unwrap(), columns);
        }
        for wrong in ["", "x,y", "x,y,z,x", &"x,".repeat(100)] {
            assert!(wrong.parse::<Columns>().is_err(), "{wrong}");
        }
    }
}
