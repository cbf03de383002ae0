//! Reference system of a file: its name and the lengths of its units.
//!
//! Input: the projection records. Output: [`Georeference`]. Well-known text is parsed by [`wkt`], GeoTIFF keys are read by
//! [`geotiff`]; [`Systems`] are those of a set of files. Memory: a small multiple of the text, at most 1 MiB each.

mod geotiff;
mod systems;
mod wkt;

use super::epsg::{self, Ground};
use super::records::{GEO_KEYS, MOST_TEXT, Records, WKT};
use crate::text::number;
use std::borrow::Cow;
pub(super) use systems::Systems;
use systems::short_name;
use wkt::{Kind, Node};

/// Reference system and units of a file.
#[derive(Debug, Default, Clone, PartialEq)]
pub(super) struct Georeference {
    /// WKT, else `EPSG:n`, else the citation of the GeoTIFF keys.
    pub text: Option<String>,
    /// EPSG codes of the system and its components, as far as stated.
    pub codes: Vec<u32>,
    /// Metres per unit of x and y, as stated; not validated.
    pub horizontal: Option<f64>,
    /// Metres per unit of z, as stated; not validated.
    pub vertical: Option<f64>,
    /// True if x and y are longitude and latitude.
    pub degrees: bool,
    /// Warnings for the monitor.
    pub notes: Vec<String>,
}

/// Plausible units (m): scans use units from the millimetre to the mile. Anything beyond 10 km is damage that would
/// collapse the scene to a point or inflate it.
const BELIEVED_M: std::ops::RangeInclusive<f64> = 1e-3..=1e4;
/// Relative difference of two statements of one unit: written with few digits, it is smaller than that of the two feet.
const ROUNDING: f64 = 1e-6;
/// Names of axes in messages.
const GROUND_AXES: &str = "x and y";
const HEIGHTS: &str = "heights";
/// Warning about a system whose axes start at the centre of the Earth.
const GEOCENTRIC: &str = "its reference system is geocentric: its z axis does not point up";
/// Warning about an E57 whose system has other units.
const METRES: &str =
    "its reference system is not in metres, but coordinates in E57 are, by its standard: metres are taken";
/// Warning about coordinates of another kind than the system's.
const LENGTHS_FOR_ANGLES: &str = "its coordinates are lengths, but its reference system has longitude and latitude";
/// Warning about text that cannot be read to its end.
const DAMAGED: &str = "the well-known text of its reference system is damaged";
/// Warning about a record that holds no text.
const UNREADABLE: &str = "the well-known text of its reference system is unreadable; it is passed over";
/// Warning about a system of depths.
const DOWNWARD: &str = "its reference system counts depths, downwards; z is taken as height";

impl Georeference {
    /// Returns a stated unit that is not plausible.
    pub(super) fn absurd_unit(&self) -> Option<f64> {
        [self.horizontal, self.vertical].into_iter().flatten().find(|unit| !BELIEVED_M.contains(unit))
    }

    /// Adds the system `code` if the file names none. Returns a note if nothing states a unit or the two systems
    /// cannot be compared; fails if the file states another system.
    pub(super) fn complete(&mut self, code: u32) -> Result<Option<String>, String> {
        match &self.text {
            None => {
                if epsg::system(code).is_none() {
                    let is_open = self.horizontal.is_none();
                    return Ok(is_open.then(|| format!("the unit of EPSG:{code} is unknown; set it with --units")));
                }
                self.take_code(code);
            }
            Some(_) if self.codes.contains(&code) => {}
            Some(text) if self.codes.is_empty() => {
                let name = short_name(text);
                return Ok(Some(format!("it states the reference system {name} without an EPSG code, which is kept")));
            }
            Some(text) => {
                let stated = self.codes.iter().map(|code| format!("EPSG:{code}")).collect::<Vec<_>>().join(", ");
                let name = short_name(text);
                let stated = if name.starts_with("EPSG:") { name } else { format!("{name} ({stated})") };
                return Err(format!(
                    "the file states another one (expected EPSG:{code}, found {stated}); state that one, or none"
                ));
            }
        }
        Ok(None)
    }

    /// Adds the units of system `code` where none are stated.
    fn take_code(&mut self, code: u32) {
        let Some(system) = epsg::system(code) else { return };
        match system.ground {
            Ground::Length(unit) => {
                self.note_other(self.horizontal, Some(unit), GROUND_AXES);
                self.horizontal = self.horizontal.or(Some(unit));
            }
            Ground::Angles if self.horizontal.is_some() => self.note(LENGTHS_FOR_ANGLES),
            Ground::Angles => self.degrees = true,
            Ground::Geocentric => {
                self.horizontal = self.horizontal.or(Some(1.0));
                self.note(GEOCENTRIC);
            }
            Ground::None => {}
        }
        self.take_up(system.up);
    }

    /// Takes metres as the unit, whatever the system states, as E57 demands.
    pub(super) fn take_metres(&mut self) {
        let units = [self.horizontal, self.vertical];
        if self.degrees || units.into_iter().flatten().any(|unit| unit != 1.0) {
            self.drop_notes_of_units();
            self.note(METRES);
        }
        (self.horizontal, self.vertical, self.degrees) = (Some(1.0), Some(1.0), false);
    }

    /// Drops the warnings about units, where others count than the stated ones.
    pub(super) fn drop_notes_of_units(&mut self) {
        self.notes.retain(|note| !note.contains("unit") && note != METRES);
    }

    /// Adds the unit of a vertical axis of a system that is named by code, negative if it points down.
    fn take_up(&mut self, up: Option<f64>) {
        if up.is_some_and(|unit| unit < 0.0) {
            self.note(DOWNWARD);
        }
        self.note_other(self.vertical, up.map(f64::abs), HEIGHTS);
        self.vertical = self.vertical.or(up.map(f64::abs));
    }

    /// Notes that the file also states another unit than the one that counts.
    fn note_other(&mut self, counts: Option<f64>, other: Option<f64>, axes: &str) {
        if let (Some(counts), Some(other)) = (counts, other)
            && (counts - other).abs() > ROUNDING * other
        {
            let (counts, other) = (number(counts), number(other));
            self.note(&format!("two units are given for {axes}: {counts} m, which counts, and {other} m"));
        }
    }

    /// Returns a stated unit that is not `factor` (m).
    pub(super) fn other_unit(&self, factor: f64) -> Option<f64> {
        let mut stated = [self.horizontal, self.vertical].into_iter().flatten();
        stated.find(|unit| (unit - factor).abs() > ROUNDING * factor)
    }

    fn note(&mut self, text: &str) {
        if !self.notes.iter().any(|note| note == text) {
            self.notes.push(text.into());
        }
    }

    pub(super) fn read(records: &Records, says_wkt: bool) -> Self {
        let wkt = records.projection(WKT).and_then(Self::of_record);
        let keys = records.projection(GEO_KEYS).map(|keys| Self::from_keys(keys, records));
        let keys = keys.filter(|k| *k != Self::default());
        match (wkt, keys) {
            (Some(wkt), Some(keys)) if wkt.text.is_none() => keys.or(wkt),
            (Some(wkt), Some(keys)) if says_wkt => wkt.or(keys),
            // The file has both and does not say which counts; before LAS 1.4, the keys did.
            (Some(wkt), Some(keys)) => Self { text: wkt.text.clone(), ..keys.or(wkt) },
            (wkt, keys) => wkt.or(keys).unwrap_or_default(),
        }
    }

    /// Fills in what `self` does not state from `other`; notes units that differ.
    fn or(mut self, other: Self) -> Self {
        self.note_other(self.horizontal, other.horizontal, GROUND_AXES);
        self.note_other(self.vertical, other.vertical, HEIGHTS);
        if !self.degrees && self.horizontal.is_none() {
            (self.degrees, self.horizontal) = (other.degrees, other.horizontal);
        }
        self.vertical = self.vertical.or(other.vertical);
        if self.codes.is_empty() {
            self.codes = other.codes;
        }
        other.notes.iter().for_each(|note| self.note(note));
        self
    }

    /// Parses a record of well-known text; `None` if it is empty.
    fn of_record(bytes: &[u8]) -> Option<Self> {
        let text = decoded(bytes);
        let mut parts = parts(&text);
        let first = parts.next()?;
        let is_odd = |c: char| c.is_control() || c == char::REPLACEMENT_CHARACTER;
        let mut is_name = || parts.next().is_none() && !first.contains(is_odd);
        match first.contains(['[', '(']) || !codes(first).is_empty() || is_name() {
            true => Some(Self::of_text(first.to_owned())),
            false => Some(Self { notes: vec![UNREADABLE.into()], ..Self::default() }),
        }
    }

    /// Parses a system stated only as text: well-known text, or a code such as `EPSG:25832+5783`.
    pub(super) fn of_text(text: String) -> Self {
        if text.len() as u64 > MOST_TEXT {
            let note = format!("its reference system is {} bytes long; it is passed over", text.len());
            return Self { notes: vec![note], ..Self::default() };
        }
        if text.contains(['[', '(']) {
            return Self::from_wkt(text);
        }
        let mut found = Self { codes: codes(&text), ..Self::default() };
        found.codes.clone().into_iter().for_each(|code| found.take_code(code));
        found.text = Some(text);
        found
    }

    fn from_wkt(text: String) -> Self {
        let mut found = Self::default();
        let (roots, is_whole) = Node::parse(&text);
        roots.iter().for_each(|root| found.take(root));
        // Codes supply what the text does not state. Reversed, since the vertical system comes last.
        found.codes.clone().into_iter().rev().for_each(|code| found.take_code(code));
        if !is_whole || roots.is_empty() {
            found.note(DAMAGED);
        }
        found.text = Some(text);
        found
    }

    /// Adds what system `node` states.
    fn take(&mut self, node: &Node) {
        let kind = Kind::of(&node.word);
        if kind.is_some() {
            self.codes.extend(node.epsg_code());
        }
        match kind {
            Some(Kind::Projected | Kind::Local) => {
                self.horizontal = self.horizontal.or_else(|| node.ground_unit(&mut self.notes));
                self.take_height(node);
            }
            Some(Kind::Geographic) if node.is_geocentric() => self.take_geocentric(node),
            Some(Kind::Geographic) => {
                self.degrees |= self.horizontal.is_none();
                self.take_height(node);
            }
            Some(Kind::Geocentric) => self.take_geocentric(node),
            Some(Kind::Vertical) => {
                self.vertical = node.height_unit(&mut self.notes).or(self.vertical);
                if node.points_down() {
                    self.note(DOWNWARD);
                }
            }
            Some(Kind::Several) => node.children.iter().for_each(|child| self.take(child)),
            None => {}
        }
    }

    fn take_geocentric(&mut self, node: &Node) {
        self.horizontal = self.horizontal.or_else(|| node.ground_unit(&mut self.notes));
        self.note(GEOCENTRIC);
    }

    /// Adds the unit of a third axis: ellipsoidal heights, or heights of a site.
    fn take_height(&mut self, node: &Node) {
        let up = node.axes().find(|axis| axis.is_vertical());
        self.vertical = self.vertical.or_else(|| up?.unit(&mut self.notes));
        if node.points_down() {
            self.note(DOWNWARD);
        }
    }
}

/// GeoTIFF value for "user-defined".
const USER_DEFINED: u16 = 32767;

/// Returns the EPSG code of the projected system in the reference system of an archive: `EPSG:n`, or well-known text.
pub fn projected_epsg(text: &str) -> Option<u16> {
    fn find(node: &Node) -> Option<u32> {
        match Kind::of(&node.word)? {
            Kind::Projected => node.epsg_code(),
            Kind::Several => node.children.iter().find_map(find),
            _ => None,
        }
    }
    let code = match text.contains(['[', '(']) {
        false => codes(text).first().copied(),
        true => Node::parse(text).0.iter().find_map(find),
    };
    let is_projected = |code: &u32| {
        epsg::system(*code).is_none_or(|system| matches!(system.ground, Ground::Length(_)) && !system.is_compound)
    };
    code.filter(is_projected).and_then(|code| u16::try_from(code).ok()).filter(|code| (1..USER_DEFINED).contains(code))
}

/// Returns whether the reference system of an archive (a code, well-known text or a name) states no unit but the metre.
pub fn is_in_metres(text: &str) -> bool {
    let found = Georeference::of_text(text.into());
    let systems = found.codes.iter().filter_map(|&code| epsg::system(code));
    let by_code = systems.flat_map(|system| match system.ground {
        Ground::Length(unit) => [Some(unit), system.up],
        _ => [None, system.up],
    });
    [found.horizontal, found.vertical].into_iter().chain(by_code).flatten().all(|unit| unit.abs() == 1.0)
}

/// Returns the codes in `EPSG:n`, `EPSG:n+m` or `urn:ogc:def:crs:EPSG::n`; none for other text.
fn codes(text: &str) -> Vec<u32> {
    let text = text.trim().to_ascii_uppercase();
    let code = |part: &str| part.rsplit(':').next()?.parse().ok();
    let is_epsg = text.starts_with("EPSG:") || text.starts_with("URN:OGC:DEF:CRS:EPSG:");
    let found = is_epsg.then(|| text.split('+').map(code).collect::<Option<Vec<u32>>>());
    found.flatten().unwrap_or_default()
}

/// Returns the text of a record without surrounding zeros; `None` if nothing is left.
fn clean_text(bytes: &[u8]) -> Option<String> {
    parts(&String::from_utf8_lossy(bytes)).next().map(str::to_owned)
}

/// Returns the parts of a text between zeros that are not empty, without blanks and what may surround a text.
fn parts(text: &str) -> impl Iterator<Item = &str> {
    let parts = text.split('\0').map(|part| part.trim().trim_start_matches('\u{feff}').trim_end_matches('|').trim());
    parts.filter(|part| !part.is_empty())
}

/// Decodes UTF-8, or UTF-16 where a byte order mark or the zeros beside the ASCII of the first characters show it.
fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    /// Characters looked at.
    const FIRST: usize = 4;
    let first = || bytes.chunks_exact(2).take(FIRST);
    let is_long = bytes.len() >= 2 * FIRST;
    let unit = if bytes.starts_with(&[0xFF, 0xFE]) || is_long && first().all(|pair| pair[0] != 0 && pair[1] == 0) {
        u16::from_le_bytes
    } else if bytes.starts_with(&[0xFE, 0xFF]) || is_long && first().all(|pair| pair[0] == 0 && pair[1] != 0) {
        u16::from_be_bytes
    } else {
        return String::from_utf8_lossy(bytes);
    };
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

#[cfg(test)]
mod tests;
