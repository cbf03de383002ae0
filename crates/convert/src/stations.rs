//! Positions of scanners, from a table of stations or else from the scans themselves.
//!
//! A table names files; its rows give the position of a file's scanner, its position for one point source id, or its
//! position at a GPS time. Between two times the scanner moves in a straight line; a jump above [`FASTEST`] counts as
//! standing still until the later time. Such a path is cut into pieces within [`WITHIN_M`] of their first position,
//! each of them a station.

use crate::bytes::open_regular;
use crate::input::{FARTHEST_M, InputSet, ScanFile, Standpoint, Tag};
use crate::text::{self, number, quoted_len};
use crate::voxel::visibility::Station;
use crate::{Error, Parameter, Result};
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;

/// Greatest length of a table (bytes).
const MOST_BYTES: u64 = 64 << 20;
/// Distance within which a moving scanner counts as one station (m).
const WITHIN_M: f64 = 0.1;
/// Speed above which the scanner counts as standing still until the later time (m/s).
const FASTEST: f64 = 100.0;
/// Most pieces of all paths together.
const MOST_PIECES: f64 = (1u64 << 20) as f64;

/// Position (m, z up).
type Place = [f64; 3];

/// Stations of a set of scans.
#[derive(Debug)]
pub(super) struct Stations {
    /// The stations, each once.
    pub stations: Vec<Station>,
    /// Source of the points of each cloud of each scan.
    pub of_cloud: Vec<Vec<Measured>>,
    /// Attribute of a point that identifies its station.
    pub tag: Option<Tag>,
}

/// Station or stations that measured the points of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Measured {
    /// One station.
    From(usize),
    /// Station by point source id, and the one for any other id.
    BySource(BTreeMap<u16, usize>, Option<usize>),
    /// Stations by the GPS time from which they apply, in order, and the last time.
    ByTime(Vec<(f64, usize)>, f64),
}

impl Measured {
    /// Returns the station of a point with this tag, or the reason why it has none.
    pub fn station(&self, tag: f64) -> std::result::Result<usize, String> {
        match self {
            Self::From(station) => Ok(*station),
            Self::BySource(of, any_other) => of.get(&(tag as u16)).copied().or(*any_other).ok_or_else(|| {
                format!("point source id {tag} has no station; add a line for it to the table of stations")
            }),
            Self::ByTime(pieces, end) => {
                let after = pieces.partition_point(|piece| piece.0 <= tag);
                match after.checked_sub(1) {
                    Some(piece) if tag <= *end => Ok(pieces[piece].1),
                    _ => {
                        let first = pieces.first().map_or(f64::NAN, |piece| piece.0);
                        Err(format!(
                            "gps time {} is not in the table of stations (which covers {} to {})",
                            number(tag),
                            number(first),
                            number(*end)
                        ))
                    }
                }
            }
        }
    }
}

/// Positions that a table gives for a file.
#[derive(Debug, Clone, Default)]
enum Named {
    /// No position.
    #[default]
    Not,
    /// Position of its scanner.
    At(Place),
    /// Positions by point source id, and the one for any other id.
    BySource(BTreeMap<u16, Place>, Option<Place>),
    /// Positions at GPS times.
    ByTime(Vec<(f64, Place)>),
}

/// Known stations, with their numbers.
#[derive(Debug, Default)]
struct Known {
    stations: Vec<Station>,
    numbers: HashMap<[u64; 5], usize>,
}

impl Known {
    /// Returns the number of a station, adding it if it is new. Clouds at one position are one station, because what
    /// one of them holds cannot be seen through in another. Pieces of paths are one station only if they also begin at
    /// the same `time`.
    fn number(&mut self, at: Place, within_m: f64, time: f64) -> usize {
        let [x, y, z] = at.map(|v| (v + 0.0).to_bits());
        *self.numbers.entry([x, y, z, within_m.to_bits(), (time + 0.0).to_bits()]).or_insert_with(|| {
            self.stations.push(Station { at, within_m });
            self.stations.len() - 1
        })
    }

    fn stood(&mut self, at: Place) -> usize {
        self.number(at, 0.0, 0.0)
    }

    /// Returns the pieces of a path, each with the time at which it begins.
    fn way(&mut self, way: &[(f64, Place)]) -> Vec<(f64, usize)> {
        let mut pieces = Vec::new();
        // Positions along the path, at most half a piece apart.
        let mut places = way.windows(2).flat_map(|ends| {
            let [(t0, a), (t1, b)] = [ends[0], ends[1]];
            let steps = steps(ends);
            (0..steps.max(1.0) as u64).map(move |step| {
                let share = step as f64 / steps.max(1.0);
                let place = std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]));
                (t0 + share * (t1 - t0), place, steps > 0.0)
            })
        });
        let Some((mut begin, mut first, mut moves)) = places.next() else { return pieces };
        let mut end_piece = |begin: f64, first: Place, moves: bool| {
            let station = if moves { self.number(first, WITHIN_M, begin) } else { self.stood(first) };
            pieces.push((begin, station));
        };
        for (time, place, goes_on) in places {
            // A scanner that stands has sharp images, so standing and moving are not mixed.
            let most_m = if moves { 0.5 * WITHIN_M } else { 0.0 };
            if distance(first, place) > most_m || goes_on != moves {
                end_piece(begin, first, moves);
                (begin, first, moves) = (time, place, goes_on);
            }
        }
        end_piece(begin, first, moves);
        pieces
    }
}

/// Returns the number of steps between two positions of a path; 0 if the scanner stands.
fn steps(ends: &[(f64, Place)]) -> f64 {
    let far = distance(ends[0].1, ends[1].1);
    if far > FASTEST * (ends[1].0 - ends[0].0) { 0.0 } else { (far / (0.5 * WITHIN_M)).ceil() }
}

fn distance(a: Place, b: Place) -> f64 {
    let d: Place = std::array::from_fn(|axis| b[axis] - a[axis]);
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}

impl Stations {
    /// Finds the stations of `set`: from the table at `table` for the scans that it names, else from the positions that
    /// E57 (by the pose of each cloud) and PTX state.
    ///
    /// Fails for an invalid table, for rows that match no scan, and for clouds with points whose station is unknown.
    pub fn find(table: Option<&Path>, set: &InputSet) -> Result<Self> {
        let files = set.files();
        let (named, tag) = match table {
            Some(path) => read(path, files)?,
            None => (vec![Named::Not; files.len()], None),
        };
        Self::of(table, named, tag, files)
    }

    /// Builds the stations from what `table` gives for each file (`named`) and from what the scans state.
    fn of(table: Option<&Path>, named: Vec<Named>, tag: Option<Tag>, files: &[ScanFile]) -> Result<Self> {
        let stated: Vec<Vec<Standpoint>> = files.iter().map(ScanFile::standpoints).collect();
        let unnamed = stated.iter().zip(&named).filter(|(_, named)| matches!(named, Named::Not));
        // Programs that write points in common coordinates leave the pose of each cloud at the origin.
        let at_origin = |stated: &&Standpoint| **stated == Standpoint::At([0.0; 3]);
        let at_origin = unnamed.flat_map(|(stated, _)| stated).filter(at_origin).count();
        let mut known = Known::default();
        let mut of_cloud = Vec::with_capacity(files.len());
        for ((file, stated), named) in files.iter().zip(stated).zip(named) {
            let mut own = Vec::with_capacity(stated.len());
            let of_file = match named {
                Named::Not => None,
                Named::At(place) => Some(Measured::From(known.stood(place))),
                // Also for files whose points have no ids.
                Named::BySource(of, Some(place)) if of.is_empty() => Some(Measured::From(known.stood(place))),
                Named::BySource(of, any_other) => {
                    let of = of.into_iter().map(|(id, place)| (id, known.stood(place))).collect();
                    Some(Measured::BySource(of, any_other.map(|place| known.stood(place))))
                }
                Named::ByTime(way) => {
                    let end = way.last().map_or(f64::NAN, |end| end.0);
                    Some(Measured::ByTime(known.way(&way), end))
                }
            };
            for stated in stated {
                let station = match (&of_file, stated) {
                    // A cloud without points.
                    (_, Standpoint::Needless) => Measured::From(0),
                    (Some(measured), _) => measured.clone(),
                    (None, Standpoint::At(at)) if at == [0.0; 3] && at_origin > 1 => {
                        let reason = format!("{at_origin} clouds state the origin as the place of their scanner");
                        return Err(unknown(table, file, &reason));
                    }
                    (None, Standpoint::At(at)) => match place_of(file, at) {
                        Some(place) => Measured::From(known.stood(place)),
                        None => return Err(unknown(table, file, "its scanner stood beyond all coordinates")),
                    },
                    (None, Standpoint::Unknown(reason)) => return Err(unknown(table, file, &reason)),
                };
                own.push(station);
            }
            of_cloud.push(own);
        }
        Ok(Self { stations: known.stations, of_cloud, tag })
    }
}

/// Converts a position from a file's coordinates (m, z up); `None` if it lies farther out than any point may.
fn place_of(file: &ScanFile, at: Place) -> Option<Place> {
    file.place_of(at).filter(|place| place.iter().all(|v| v.abs() <= FARTHEST_M))
}

/// Splits a line into its fields, without quotes (quoted fields may hold commas), or returns what is wrong with it.
fn fields(line: &str) -> std::result::Result<Vec<String>, String> {
    let (mut fields, mut rest) = (Vec::new(), line.trim());
    loop {
        let len = match rest.starts_with('"') {
            true => quoted_len(rest.as_bytes()).ok_or_else(|| format!("an opening quote without its end: {rest:?}"))?,
            false => rest.find(',').unwrap_or(rest.len()),
        };
        let (field, behind) = rest.split_at(len);
        let quoted = field.strip_prefix('"').and_then(|field| field.strip_suffix('"'));
        fields.push(quoted.map_or_else(|| field.trim().to_owned(), |field| field.replace("\"\"", "\"")));
        match behind.trim_start() {
            "" => return Ok(fields),
            behind => {
                let behind = behind.strip_prefix(',');
                rest = behind.ok_or_else(|| format!("text behind a closing quote: {rest:?}"))?.trim_start();
            }
        }
    }
}

/// Makes the error for a file whose station is unknown.
fn unknown(table: Option<&Path>, file: &ScanFile, reason: &str) -> Error {
    let path = file.path().display();
    match table {
        Some(table) => Error::input(table, "file", format!("{path} has no station; add a line for it ({reason})")),
        None => {
            let suggestion = "name a table of stations with the columns file,x,y,z";
            Error::parameter(Parameter::Stations, format!("{path}: {reason}; {suggestion}"))
        }
    }
}

/// Column numbers of a table.
struct Columns {
    names: usize,
    file: usize,
    place: [usize; 3],
    tag: Option<(Tag, usize)>,
}

impl Columns {
    fn of(head: &str) -> std::result::Result<Self, String> {
        let names = fields(head)?;
        if let Some(twice) = names.iter().enumerate().find(|(at, name)| !name.is_empty() && names[..*at].contains(name))
        {
            return Err(format!("two columns are named {:?}", twice.1));
        }
        let column = |name: &str| names.iter().position(|column| column == name);
        let (Some(file), Some(x), Some(y), Some(z)) = (column("file"), column("x"), column("y"), column("z")) else {
            return Err(format!("expected the columns file,x,y,z, found {:?}", names.join(",")));
        };
        let tag = match (column("source_id"), column("t")) {
            (Some(_), Some(_)) => return Err("expected source_id or t, found both columns".into()),
            (Some(at), None) => Some((Tag::SourceId, at)),
            (None, Some(at)) => Some((Tag::GpsTime, at)),
            (None, None) => None,
        };
        Ok(Self { names: names.len(), file, place: [x, y, z], tag })
    }
}

/// Reads the table at `path`, with the columns `file,x,y,z` in any order, and optionally `source_id` or `t`. `file` is
/// the name of a scan in `files`, with folders if the name alone is ambiguous; the position is in the coordinates of
/// the scan. Returns what the table gives for each file.
fn read(path: &Path, files: &[ScanFile]) -> Result<(Vec<Named>, Option<Tag>)> {
    let (mut file, about) = open_regular(path).map_err(|error| Error::io(path, "open", error))?;
    if about.len() > MOST_BYTES {
        let what = format!("bytes of the stations {}", path.display());
        return Err(Error::limit(what, about.len(), MOST_BYTES));
    }
    let mut table = String::new();
    file.read_to_string(&mut table).map_err(|error| Error::io(path, "read", error))?;
    let wrong = |line: usize, reason: String| Error::input(path, format!("line {line}"), reason);
    let mut lines =
        table.trim_start_matches('\u{feff}').lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let columns = Columns::of(lines.next().map_or("", |(_, line)| line)).map_err(|reason| wrong(1, reason))?;
    let mut named = vec![Named::default(); files.len()];
    let mut called: HashMap<String, Vec<usize>> = HashMap::new();
    for (line, row) in lines.map(|(number, row)| (number + 1, row)) {
        let fields = fields(row).map_err(|reason| wrong(line, reason))?;
        if fields.len() != columns.names {
            return Err(wrong(line, format!("expected {} fields, found {}", columns.names, fields.len())));
        }
        let value = |column: usize| {
            let value = fields[column].parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| wrong(line, format!("expected a number, found {:?}", fields[column])))
        };
        let [x, y, z] = columns.place;
        let at = [value(x)?, value(y)?, value(z)?];
        let name = &fields[columns.file];
        // Every path ends with an empty name.
        let ends_so = |number: &usize| !name.is_empty() && files[*number].path().ends_with(name);
        let own = called.entry(name.clone()).or_insert_with(|| (0..files.len()).filter(ends_so).collect());
        if own.is_empty() {
            return Err(wrong(line, format!("no input is called {name:?}; give the file's name as in its path")));
        }
        for &mut number in own {
            let file = &files[number];
            let shown = file.path().display();
            let place = place_of(file, at)
                .ok_or_else(|| wrong(line, format!("{} is beyond the coordinates of {name}", text::place(at))))?;
            let twice = |what: String| wrong(line, format!("{shown} has a station {what}already"));
            match columns.tag {
                None if matches!(named[number], Named::Not) => named[number] = Named::At(place),
                None => return Err(twice(String::new())),
                Some((tag, column)) => {
                    let all = fields[column].is_empty() && tag == Tag::SourceId;
                    if !all && !file.has_tags(tag) {
                        let what = if tag == Tag::SourceId { "point source ids" } else { "gps times" };
                        return Err(wrong(line, format!("the points of {shown} have no {what}")));
                    }
                    match tag {
                        Tag::SourceId => {
                            let (of, any_other) = named[number].by_source();
                            if all {
                                if any_other.replace(place).is_some() {
                                    return Err(twice("for all other source ids ".into()));
                                }
                            } else {
                                let id = fields[column].parse::<u16>().map_err(|_| {
                                    let found = &fields[column];
                                    wrong(
                                        line,
                                        format!("expected a source id (0 to 65535) or nothing, found {found:?}"),
                                    )
                                })?;
                                if of.insert(id, place).is_some() {
                                    return Err(twice(format!("for source id {id} ")));
                                }
                            }
                        }
                        Tag::GpsTime => named[number].by_time().push((value(column)?, place)),
                    }
                }
            }
        }
    }
    check_ways(path, files, &mut named)?;
    Ok((named, columns.tag.map(|(tag, _)| tag)))
}

impl Named {
    /// Returns the positions by source id, converting `self` to that variant if necessary.
    fn by_source(&mut self) -> (&mut BTreeMap<u16, Place>, &mut Option<Place>) {
        if !matches!(self, Self::BySource(..)) {
            *self = Self::BySource(BTreeMap::new(), None);
        }
        let Self::BySource(of, any_other) = self else { unreachable!("made above") };
        (of, any_other)
    }

    /// Returns the positions by time, converting `self` to that variant if necessary.
    fn by_time(&mut self) -> &mut Vec<(f64, Place)> {
        if !matches!(self, Self::ByTime(_)) {
            *self = Self::ByTime(Vec::new());
        }
        let Self::ByTime(way) = self else { unreachable!("made above") };
        way
    }
}

/// Sorts the positions of each path by time. Refuses paths with a single position, two positions at one time, and paths
/// with too many pieces.
fn check_ways(path: &Path, files: &[ScanFile], named: &mut [Named]) -> Result<()> {
    let mut pieces = 0.0;
    for (file, named) in files.iter().zip(named) {
        let Named::ByTime(way) = named else { continue };
        way.sort_by(|a, b| a.0.total_cmp(&b.0));
        let shown = file.path().display();
        if way.len() < 2 {
            return Err(Error::input(path, "t", format!("{shown} has one place only; a way takes two or more")));
        }
        for pair in way.windows(2) {
            if pair[0].0 == pair[1].0 {
                let time = number(pair[0].0);
                return Err(Error::input(path, "t", format!("{shown} has two places at gps time {time}")));
            }
            pieces += steps(pair).max(1.0);
        }
        if pieces > MOST_PIECES {
            let what = format!("pieces of 0.05 m of the ways in {}", path.display());
            return Err(Error::limit(what, pieces, MOST_PIECES));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_are_cut_into_short_pieces_and_leaps_are_none() {
        let mut known = Known::default();
        // Stands, walks a metre along x, stands, jumps, stands.
        let way = [
            (0.0, [0.0; 3]),
            (5.0, [0.0; 3]),
            (7.0, [1.0, 0.0, 0.0]),
            (9.0, [1.0, 0.0, 0.0]),
            (9.001, [8.0, 0.0, 0.0]),
            (12.0, [8.0, 0.0, 0.0]),
        ];
        let pieces = known.way(&way);
        assert!(pieces.is_sorted_by(|a, b| a.0 < b.0));
        let measured = Measured::ByTime(pieces, 12.0);
        let station = |time: f64| known.stations[measured.station(time).unwrap()];
        assert_eq!(station(4.9), Station { at: [0.0; 3], within_m: 0.0 });
        assert_eq!(station(8.0), Station { at: [1.0, 0.0, 0.0], within_m: 0.0 });
        assert_eq!(station(9.0005), station(8.0));
        assert_eq!(station(12.0), Station { at: [8.0, 0.0, 0.0], within_m: 0.0 });
        for n in 1..200 {
            let time = 5.0 + f64::from(n) * 0.01;
            let from = [(time - 5.0) / 2.0, 0.0, 0.0];
            let own = station(time);
            assert!(own.within_m == WITHIN_M && distance(own.at, from) <= WITHIN_M + 1e-9, "{time}: {own:?}");
        }
        for time in [-0.1, 12.1, f64::NAN] {
            assert!(measured.station(time).is_err());
        }
        assert!(known.stations.len() < 25, "{}", known.stations.len());
    }

    #[test]
    fn fields_may_stand_in_quotes() {
        for (line, expected) in [
            ("a.las, 1,2 ,3", Ok(vec!["a.las", "1", "2", "3"])),
            ("\"a, \"\"b\"\".las\" ,1,", Ok(vec!["a, \"b\".las", "1", ""])),
            ("", Ok(vec![""])),
            ("\"a.las,1,2,3", Err("an opening quote without its end")),
            ("a.las,1,2,\"3", Err("an opening quote without its end")),
            ("\"a.las\"x,1,2,3", Err("text behind a closing quote")),
        ] {
            match (fields(line), expected) {
                (Ok(found), Ok(expected)) => assert_eq!(found, expected, "{line}"),
                (Err(found), Err(expected)) => assert!(found.starts_with(expected), "{line}: {found}"),
                (found, _) => panic!("{line}: {found:?}"),
            }
        }
        assert!(Columns::of("file,x,y,z,x").is_err());
    }

    #[test]
    fn other_source_ids_have_the_station_of_all_others() {
        let some = BTreeMap::from([(3, 0)]);
        assert_eq!(Measured::BySource(some.clone(), Some(7)).station(4.0), Ok(7));
        assert_eq!(Measured::BySource(some.clone(), Some(7)).station(3.0), Ok(0));
        assert!(Measured::BySource(some, None).station(4.0).is_err());
    }
}
