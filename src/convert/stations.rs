//! Where scanners stood: a table of stations, and which scan was made from which.

use crate::bytes::open_regular;
use crate::input::{InputSet, ScanFile};
use crate::{Error, Result};
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

/// Longest table that is read (bytes).
const MOST_BYTES: u64 = 64 << 20;

/// The stations of a set of scans.
#[derive(Debug)]
pub(super) struct Stations {
    /// Where they are (m, z up); each place once.
    pub places: Vec<[f64; 3]>,
    /// The station of each scan.
    pub of_file: Vec<usize>,
}

impl Stations {
    /// Reads the table at `path`, with the columns `file,x,y,z` in any order: of each scan of `set` its name (with folders
    /// where the name alone is not unique) and the place of its scanner in its own coordinates.
    ///
    /// Fails for tables that are no such table, for scans without a station and for stations of no scan.
    pub fn read(path: &Path, set: &InputSet) -> Result<Self> {
        let (mut file, about) = open_regular(path).map_err(|error| Error::io(path, "open", error))?;
        if about.len() > MOST_BYTES {
            let what = format!("bytes of the stations {}", path.display());
            return Err(Error::limit(what, about.len(), MOST_BYTES));
        }
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(|error| Error::io(path, "read", error))?;
        Self::from_text(path, &text, set.files())
    }

    fn from_text(path: &Path, text: &str, files: &[ScanFile]) -> Result<Self> {
        let wrong = |line: usize, reason: String| Err(Error::input(path, format!("line {line}"), reason));
        let mut lines =
            text.trim_start_matches('\u{feff}').lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let names: Vec<&str> = lines.next().map_or_else(Vec::new, |(_, line)| line.split(',').map(str::trim).collect());
        let column = |name: &str| names.iter().position(|&column| column == name);
        if column("t").is_some() || column("source_id").is_some() {
            let reason = "stations by gps time or by source id are not supported yet; write the points of each station to \
                          a file of their own and give file,x,y,z";
            return wrong(1, reason.into());
        }
        let (Some(name), Some(x), Some(y), Some(z)) = (column("file"), column("x"), column("y"), column("z")) else {
            return wrong(1, format!("expected the columns file,x,y,z, found {:?}", names.join(",")));
        };
        let (mut places, mut of_file, mut known) = (Vec::new(), vec![None; files.len()], HashMap::new());
        for (number, line) in lines {
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            if fields.len() != names.len() {
                return wrong(number + 1, format!("expected {} fields, found {}", names.len(), fields.len()));
            }
            let mut at = [0.0; 3];
            for (value, column) in at.iter_mut().zip([x, y, z]) {
                match fields[column].parse::<f64>() {
                    Ok(number) if number.is_finite() => *value = number,
                    _ => return wrong(number + 1, format!("expected a number, found {:?}", fields[column])),
                }
            }
            let named = fields[name].trim_matches('"');
            let mut found = false;
            for (file, of_file) in files.iter().zip(&mut of_file).filter(|(file, _)| file.path().ends_with(named)) {
                if of_file.is_some() {
                    return wrong(number + 1, format!("{} has a station already", file.path().display()));
                }
                let Some(place) = file.place_of(at) else {
                    return wrong(number + 1, format!("{at:?} is beyond the coordinates of {named}"));
                };
                // Files of one place are one station: what is in one of them does not show through another.
                *of_file = Some(*known.entry(place.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                    places.push(place);
                    places.len() - 1
                }));
                found = true;
            }
            if !found {
                return wrong(number + 1, format!("no input is called {named:?}; give the file's name as in its path"));
            }
        }
        let without = files.iter().zip(&of_file).find(|(_, of_file)| of_file.is_none());
        if let Some((file, _)) = without {
            let reason = format!("{} has no station; add a line for it", file.path().display());
            return Err(Error::input(path, "file", reason));
        }
        Ok(Self { places, of_file: of_file.into_iter().flatten().collect() })
    }
}
