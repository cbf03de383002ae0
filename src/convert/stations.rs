//! Where scanners stood: by a table of stations, else by what the scans say themselves.

use crate::bytes::open_regular;
use crate::input::{InputSet, ScanFile, Standpoint};
use crate::{Error, Parameter, Result};
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
    /// The station of each cloud of each scan.
    pub of_cloud: Vec<Vec<usize>>,
}

impl Stations {
    /// The stations of `set`: for scans that the table at `table` names those of the table, for others the places that E57 (by
    /// the pose of each cloud) and PTX state.
    ///
    /// Fails for a table that is none, for stations of no scan, and for clouds with points whose station is not known.
    pub fn find(table: Option<&Path>, set: &InputSet) -> Result<Self> {
        let files = set.files();
        let named = table.map_or_else(|| Ok(vec![None; files.len()]), |path| read(path, files))?;
        Self::of(table, &named, files)
    }

    /// `named`: the place of each file that `table` names (m, z up).
    fn of(table: Option<&Path>, named: &[Option<[f64; 3]>], files: &[ScanFile]) -> Result<Self> {
        let stated: Vec<Vec<Standpoint>> = files.iter().map(ScanFile::standpoints).collect();
        let unnamed = stated.iter().zip(named).filter(|(_, named)| named.is_none()).flat_map(|(stated, _)| stated);
        // Programs that write points in common coordinates leave the pose of each cloud at that.
        let at_origin = unnamed.filter(|stated| **stated == Standpoint::At([0.0; 3])).count();
        let (mut places, mut known) = (Vec::new(), HashMap::new());
        // Clouds of one place are one station: what is in one of them does not show through another.
        let mut station_at = |place: [f64; 3]| {
            *known.entry(place.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                places.push(place);
                places.len() - 1
            })
        };
        let mut of_cloud = Vec::with_capacity(files.len());
        for ((file, stated), named) in files.iter().zip(stated).zip(named) {
            let mut own = Vec::with_capacity(stated.len());
            for stated in stated {
                let place = match (named, stated) {
                    (_, Standpoint::Needless) => None,
                    (&Some(place), _) => Some(place),
                    (None, Standpoint::At(at)) if at == [0.0; 3] && at_origin > 1 => {
                        let reason = format!("{at_origin} clouds state the origin as the place of their scanner");
                        return Err(unknown(table, file, &reason));
                    }
                    (None, Standpoint::At(at)) => match file.place_of(at) {
                        Some(place) => Some(place),
                        None => return Err(unknown(table, file, "its scanner stood beyond all coordinates")),
                    },
                    (None, Standpoint::Unknown(reason)) => return Err(unknown(table, file, &reason)),
                };
                own.push(place.map_or(0, &mut station_at));
            }
            of_cloud.push(own);
        }
        Ok(Self { places, of_cloud })
    }
}

/// The station of a file is not known.
fn unknown(table: Option<&Path>, file: &ScanFile, reason: &str) -> Error {
    let path = file.path().display();
    match table {
        Some(table) => Error::input(table, "file", format!("{path} has no station; add a line for it ({reason})")),
        None => {
            let way_out = "name a table of stations with the columns file,x,y,z";
            Error::parameter(Parameter::Stations, format!("{path}: {reason}; {way_out}"))
        }
    }
}

/// Reads the table at `path`, with the columns `file,x,y,z` in any order: of scans in `files` the name (with folders where the
/// name alone is not unique) and the place of the scanner in the coordinates of the scan. Returns the place of each file (m, z
/// up).
fn read(path: &Path, files: &[ScanFile]) -> Result<Vec<Option<[f64; 3]>>> {
    let (mut file, about) = open_regular(path).map_err(|error| Error::io(path, "open", error))?;
    if about.len() > MOST_BYTES {
        let what = format!("bytes of the stations {}", path.display());
        return Err(Error::limit(what, about.len(), MOST_BYTES));
    }
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(|error| Error::io(path, "read", error))?;
    let wrong = |line: usize, reason: String| Err(Error::input(path, format!("line {line}"), reason));
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
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
    let mut of_file: Vec<Option<[f64; 3]>> = vec![None; files.len()];
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
            *of_file = file.place_of(at);
            if of_file.is_none() {
                return wrong(number + 1, format!("{at:?} is beyond the coordinates of {named}"));
            }
            found = true;
        }
        if !found {
            return wrong(number + 1, format!("no input is called {named:?}; give the file's name as in its path"));
        }
    }
    Ok(of_file)
}
