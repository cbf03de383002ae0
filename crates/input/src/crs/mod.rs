//! Reference system of a file: its name and the lengths of its units.
//!
//! Input: the projection records. Output: [`Georeference`]. Well-known text is parsed by [`wkt`]; GeoTIFF keys follow the
//! GeoTIFF specification 1.0, section 2.7. Memory: a small multiple of the text, at most 1 MiB each.

mod wkt;

use super::epsg::{self, FOOT, Ground, US_SURVEY_FOOT};
use super::header::{f64_at, u16_at};
use super::records::{GEO_DOUBLES, GEO_KEYS, GEO_TEXT, MOST_TEXT, Records, WKT};
use super::{ScanFile, Those};
use crate::Monitor;
use crate::text::number;
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
/// Warning about coordinates of another kind than the system's.
const LENGTHS_FOR_ANGLES: &str = "its coordinates are lengths, but its reference system has longitude and latitude";
/// Warning about text that cannot be read to its end.
const DAMAGED: &str = "the well-known text of its reference system is damaged";
/// Warning about a system of depths.
const DOWNWARD: &str = "its reference system counts depths, downwards; z is taken as height";

impl Georeference {
    /// Returns a stated unit that is not plausible.
    pub(super) fn absurd_unit(&self) -> Option<f64> {
        [self.horizontal, self.vertical].into_iter().flatten().find(|unit| !BELIEVED_M.contains(unit))
    }

    /// Adds the system `code` if the file names none. Returns a note if the unit of `code` is unknown or the two
    /// systems cannot be compared; fails if the file states another system.
    pub(super) fn complete(&mut self, code: u32) -> Result<Option<String>, String> {
        match &self.text {
            None => {
                if epsg::system(code).is_none() {
                    return Ok(Some(format!("the unit of EPSG:{code} is unknown; set it with --units")));
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
            // Warnings about units that count elsewhere mean nothing here.
            self.notes.retain(|note| [DAMAGED, DOWNWARD].contains(&note.as_str()));
            self.note(
                "its reference system is not in metres, but coordinates in E57 are, by its standard: metres are taken",
            );
        }
        (self.horizontal, self.vertical, self.degrees) = (Some(1.0), None, false);
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
            self.note(&format!("it states two units for {axes}: {counts} m, which counts, and {other} m"));
        }
    }

    fn note(&mut self, text: &str) {
        if !self.notes.iter().any(|note| note == text) {
            self.notes.push(text.into());
        }
    }

    pub(super) fn read(records: &Records, says_wkt: bool) -> Self {
        let wkt = records.projection(WKT).and_then(clean_text).map(Self::of_text);
        let keys = records.projection(GEO_KEYS).map(|keys| Self::from_keys(keys, records));
        let keys = keys.filter(|k| *k != Self::default());
        match (wkt, keys) {
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

    fn from_keys(keys: &[u8], records: &Records) -> Self {
        let mut found = Self::default();
        let text = records.projection(GEO_TEXT).unwrap_or_default();
        let doubles = records.projection(GEO_DOUBLES).unwrap_or_default();
        let mut rows = keys.chunks_exact(8).map(|e| [u16_at(e, 0), u16_at(e, 2), u16_at(e, 4), u16_at(e, 6)]);
        let stated = rows.next().map_or(0, |head| usize::from(head[3]));
        let mut entries: Vec<[u16; 4]> = rows.collect();
        let held = entries.len();
        if stated > held || entries[stated..].iter().any(|entry| *entry != [0; 4]) {
            found.notes.push(format!("its GeoTIFF directory states {stated} keys and has room for {held}"));
        }
        entries.truncate(stated);
        let entry = |id: u16| entries.iter().find(|e| e[0] == id);
        let code = |id| entry(id).filter(|e| e[1] == 0).map(|e| e[3]);
        let double = |id| {
            let at = 8 * usize::from(entry(id).filter(|e| e[1] == GEO_DOUBLES)?[3]);
            (at + 8 <= doubles.len()).then(|| epsg::exact(f64_at(doubles, at)))
        };
        let citation = |id| {
            let e = entry(id).filter(|e| e[1] == GEO_TEXT)?;
            let from = usize::from(e[3]);
            clean_text(text.get(from..(from + usize::from(e[2])).min(text.len()))?)
        };
        let is_code = |code: &u16| *code != 0 && *code < USER_DEFINED;
        let ground = |code: u16| epsg::system(code.into()).map(|system| system.ground);
        let projected = code(3072).filter(is_code);
        let geographic = code(2048).filter(is_code);
        let model = code(1024).filter(is_code);
        // Some programs store the code of a geographic system in the key of a projected one.
        let misplaced = projected.filter(|&code| ground(code) == Some(Ground::Angles));
        found.degrees = model == Some(2)
            || misplaced.is_some()
            || model.is_none() && code(3072).is_none() && code(3076).is_none() && geographic.is_some();
        // A projection of the file's own has a geographic system as its base, which does not name it.
        let named = match found.degrees {
            true => misplaced.or(geographic).or(projected),
            false => projected.or(geographic.filter(|_| model == Some(GEOCENTRIC_MODEL))),
        };
        let named = named.map(u32::from);
        found.codes.extend(named);
        let cited = citation(3073).or_else(|| citation(1026));
        found.text = named.map(|n| format!("EPSG:{n}")).or_else(|| cited.clone());
        let mut stated = |id, size: Option<u16>, axes: &str| match code(id) {
            Some(USER_DEFINED) => {
                let length = size.and_then(double);
                if length.is_none() {
                    found
                        .notes
                        .push(format!("its GeoTIFF keys state a unit of their own for {axes}, but not its length"));
                }
                length
            }
            Some(0) | None => None,
            Some(unit) => {
                let length = epsg::unit(unit);
                if length.is_none() {
                    found.notes.push(format!("its GeoTIFF keys name {unit} as unit of length, which it is not"));
                }
                length
            }
        };
        let (horizontal, vertical) = (stated(3076, Some(3077), GROUND_AXES), stated(4099, None, HEIGHTS));
        if !found.degrees {
            found.horizontal = horizontal;
            if model == Some(GEOCENTRIC_MODEL) {
                found.note(GEOCENTRIC);
            }
        }
        found.vertical = vertical;
        // A vertical system is named by a code of its own, or by that of a geographic system with three axes.
        if let Some(code) = code(4096).filter(is_code)
            && let Some(epsg::System { ground: Ground::None | Ground::Angles, up: Some(up), .. }) =
                epsg::system(code.into())
        {
            found.codes.push(code.into());
            found.take_up(Some(up));
        }
        named.into_iter().for_each(|code| found.take_code(code));
        if let Some(code) = code(4096).filter(is_code)
            && (ground(code), found.vertical) == (None, None)
            && found.horizontal.is_some_and(|unit| unit != 1.0)
        {
            found.note(&format!("the unit of its vertical system {code} is unknown; that of x and y is taken"));
        }
        // Last resort: names such as "NAD83 / Texas Central (ftUS) + NAVD88 height (ftUS)".
        let (on_ground, above) =
            cited.as_deref().map(|text| text.split_once('+').unwrap_or((text, ""))).unwrap_or_default();
        if !found.degrees {
            found.horizontal = found.horizontal.or_else(|| unit_in_words(on_ground));
        }
        let of_heights = citation(4097);
        found.vertical = found.vertical.or_else(|| unit_in_words(of_heights.as_deref().unwrap_or(above)));
        found
    }
}

/// GeoTIFF model type of geocentric systems.
const GEOCENTRIC_MODEL: u16 = 3;
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
    let text = bytes.split(|&b| b == 0).find(|text| !text.trim_ascii().is_empty())?;
    let text = String::from_utf8_lossy(text);
    let text = text.trim().trim_start_matches('\u{feff}').trim_end_matches('|').trim();
    (!text.is_empty()).then(|| text.to_string())
}

/// Reference systems of a set of files, collected file by file. Texts may be long and many, so only two are held.
#[derive(Default)]
pub(super) struct Systems {
    /// The system whose text sorts first.
    least: Option<Stated>,
    /// Short name of one of the others, and the files that state any of them.
    other: Option<(String, Those)>,
}

/// A system, and the files that state it: in the same words or by the same codes.
struct Stated {
    text: String,
    codes: Vec<u32>,
    files: Those,
}

impl Systems {
    /// Adds the text and the codes that file `file` states; files come in ascending order.
    pub(super) fn add(&mut self, file: usize, text: Option<String>, codes: Vec<u32>) {
        let Some(text) = text else { return };
        let mut files = Those::default();
        files.add(file, true);
        let here = Stated { text, codes, files };
        match &mut self.least {
            None => self.least = Some(here),
            Some(least) if least.text == here.text || !here.codes.is_empty() && least.codes == here.codes => {
                least.files.add(file, true);
                least.text = std::mem::take(&mut least.text).min(here.text);
            }
            Some(least) => {
                let more = if here.text < least.text { std::mem::replace(least, here) } else { here };
                match &mut self.other {
                    Some((_, others)) => others.count += more.files.count,
                    none => *none = Some((short_name(&more.text), more.files)),
                }
            }
        }
    }

    /// Returns the text that sorts first; warns `monitor` if there are others.
    pub(super) fn common(self, files: &[ScanFile], monitor: &dyn Monitor) -> Option<String> {
        let Stated { text, files: those, .. } = self.least?;
        if let Some((name, others)) = &self.other {
            let named = |those: &Those, name: &str| format!("{} ({name})", those.names(files).unwrap_or_default());
            let text = format!(
                "{} and {} state different reference systems: coordinates are taken as they are, and the archive names the \
                 former system; bring the scans into one system first",
                named(&those, &short_name(&text)),
                named(others, name)
            );
            monitor.warn(&text.into());
        }
        Some(text)
    }
}

/// Returns a short name for messages: the name in the text, or the code.
fn short_name(text: &str) -> String {
    let name = text.split('"').nth(1).unwrap_or(text);
    name.chars().take(60).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Finds a unit in a citation such as "NAD83 / Texas Central (ftUS)": the last resort. The "Feet" of a state plane of
/// ESRI (`..._FIPS_4203_Feet`) are those of the US survey, unless they are "Intl".
fn unit_in_words(text: &str) -> Option<f64> {
    let text = text.to_ascii_lowercase();
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let words = format!(" {} ", words.collect::<Vec<_>>().join(" "));
    let any = |runs: &[&str]| runs.iter().any(|run| words.contains(run));
    let is_foot = text.contains("(ft)") || any(&[" foot ", " feet ", " ft intl ", " international ft "]);
    let of_survey = &[" ftus ", " usft ", " us ft ", " ft us ", " footus ", " foot us ", " us foot ", " us feet "];
    if any(of_survey) || any(&[" survey f"]) || is_foot && any(&[" fips "]) && !any(&[" intl ", " international "]) {
        Some(US_SURVEY_FOOT)
    } else {
        is_foot.then_some(FOOT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wkt(text: &str) -> Georeference {
        Georeference::from_wkt(text.to_string())
    }

    #[test]
    fn the_unit_of_the_projection_counts_and_not_that_of_the_angles() {
        let found = wkt(
            r#"PROJCS["P [ftUS]",GEOGCS["G",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",0.304800609601219]]"#,
        );
        assert_eq!((found.horizontal, found.vertical, found.degrees), (Some(US_SURVEY_FOOT), None, false));
    }

    #[test]
    fn heights_may_have_another_unit() {
        let found = wkt(
            r#"COMPD_CS["C",PROJCS["P",GEOGCS["G",UNIT["degree",0.0174]],UNIT["metre",1]],VERT_CS["V",VERT_DATUM["D",2005],UNIT["US survey foot",0.3048006096012192],AXIS["Up",UP]]]"#,
        );
        assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
        let found = wkt(
            r#"COMPOUNDCRS["C",PROJCRS["P",BASEGEOGCRS["G",UNIT["degree",0.0174]],CONVERSION["c",PARAMETER["x",1,LENGTHUNIT["metre",1]]],CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["foot",0.3048]],AXIS["(N)",north,LENGTHUNIT["foot",0.3048]]],VERTCRS["V",VDATUM["D"],CS[vertical,1],AXIS["H",up,LENGTHUNIT["metre",1]]]]"#,
        );
        assert_eq!((found.horizontal, found.vertical), (Some(FOOT), Some(1.0)));
    }

    /// Returns metres per unit of x and y, and of heights.
    fn units(text: &str) -> (Option<f64>, Option<f64>) {
        let found = wkt(text);
        assert!(!found.notes.iter().any(|note| note.contains("damaged")), "{text}: {:?}", found.notes);
        (found.horizontal, found.vertical)
    }

    const GEOGRAPHIC: &str = r#"GEOGCS["G",DATUM["D",SPHEROID["S",6378137,298.25]],PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]]"#;

    #[test]
    fn systems_stand_side_by_side_in_each_other_or_behind_too_many_brackets() {
        let feet = r#"UNIT["Foot_US",0.3048006096012192]"#;
        let ground = format!(r#"PROJCS["P",{GEOGRAPHIC},PROJECTION["Albers"],PARAMETER["x",0],UNIT["Meter",1.0]"#);
        for word in ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS", "vert_cs"] {
            let heights = format!(r#"{word}["V",VDATUM["D"],PARAMETER["Direction",1.0],{feet}"#);
            for text in [
                format!("{ground}],{heights}]"),
                format!("{ground}]{heights}]"),
                format!("{ground}] \n {heights}]"),
                format!("{ground},{heights}]]"),
                format!("{ground},{heights}],AUTHORITY[\"EPSG\",\"2903\"]]"),
                format!("{heights}],{ground}]"),
                format!("COMPD_CS[\"C\",{ground}],{heights}]]"),
                format!("COMPD_CS[\"C\",{ground}]],{heights}]]"),
                format!("COMPD_CS[\"C\",{ground}],{heights}"),
                format!("COMPD_CS[\"C\",{ground},{heights}]]"),
                format!("COMPD_CS[\"C\",{ground}]]],{heights}]]]"),
            ] {
                for text in [text.clone(), text.replace('[', "(").replace(']', ")"), text.to_lowercase()] {
                    assert_eq!(units(&text), (Some(1.0), Some(US_SURVEY_FOOT)), "{text}");
                }
            }
        }
        // A surplus or missing bracket before the unit of the map itself.
        let map = r#"PROJECTION["Albers"],UNIT["foot",0.3048]"#;
        let heights = r#"VERT_CS["V",VERT_DATUM["D",2005],UNIT["metre",1],AXIS["Up",UP]]"#;
        let open = &GEOGRAPHIC[..GEOGRAPHIC.len() - 1];
        for text in [
            format!("PROJCS[\"P\",{GEOGRAPHIC}],{map}],{heights}"),
            format!("PROJCS[\"P\",{open},{map}]],{heights}"),
            format!("COMPD_CS[\"C\",PROJCS[\"P\",{GEOGRAPHIC}],{map}],{heights}]"),
            format!("COMPD_CS[\"C\",PROJCS[\"P\",{open},{map}],{heights}]]"),
            format!("PROJCS[\"P\",{GEOGRAPHIC},{map}],{}]", heights.replace(",UNIT", "],UNIT")),
        ] {
            assert_eq!(units(&text), (Some(FOOT), Some(1.0)), "{text}");
        }
    }

    #[test]
    fn text_of_the_second_kind_states_units_by_system_by_axis_or_by_what_it_is_derived_from() {
        let foot = r#"LENGTHUNIT["US survey foot",0.304800609601219]"#;
        let metre = r#"LENGTHUNIT["metre",1]"#;
        let base = r#"BASEGEOGCRS["G",DATUM["D",ELLIPSOID["E",6378137,298.25,LENGTHUNIT["metre",1]]]],CONVERSION["c",METHOD["m"]]"#;
        let projected = |axes: &str| format!(r#"PROJCRS["P",{base},{axes}]"#);
        let feet = Some(US_SURVEY_FOOT);
        for (axes, expected) in [
            (
                format!(r#"CS[Cartesian,3],AXIS["E",east,{metre}],AXIS["N",north,{metre}],AXIS["h",up,{foot}]"#),
                (Some(1.0), feet),
            ),
            (
                format!(r#"CS[Cartesian,3],AXIS["h",up,{foot}],AXIS["E",east,{metre}],AXIS["N",north,{metre}]"#),
                (Some(1.0), feet),
            ),
            (
                format!(r#"CS[Cartesian,3],AXIS["E",east],AXIS["N",north],AXIS["h",up,{metre}],{foot}"#),
                (feet, Some(1.0)),
            ),
            (format!(r#"CS[Cartesian,3],AXIS["E",east],AXIS["N",north],AXIS["h",up],{foot}"#), (feet, None)),
            (format!(r#"CS[Cartesian,2],AXIS["E",east],AXIS["N",north],{foot},ID["EPSG",26915]"#), (feet, None)),
        ] {
            assert_eq!(units(&projected(&axes)), expected, "{axes}");
            let vertical = format!(r#"VERTCRS["V",VDATUM["D"],CS[vertical,1],AXIS["H",up],{foot}]"#);
            let joined = format!(r#"COMPOUNDCRS["C",{},{vertical}]"#, projected(&axes));
            assert_eq!(units(&joined), (expected.0, feet), "{joined}");
            let bound = format!(r#"BOUNDCRS[SOURCECRS[{joined}],TARGETCRS[GEOGCRS["WGS 84",CS[ellipsoidal,3]]]]"#);
            assert_eq!((units(&bound), wkt(&bound).degrees), ((expected.0, feet), false), "{bound}");
            let dated = format!(r#"COORDINATEMETADATA[{joined},EPOCH[2020]]"#);
            assert_eq!(units(&dated), (expected.0, feet), "{dated}");
        }
        let axes = format!(r#"CS[Cartesian,2],AXIS["E",east],AXIS["N",north],{foot}"#);
        let of_base = format!(r#"BASEPROJCRS["P",{base},{axes}],DERIVINGCONVERSION["d",METHOD["Affine"]]"#);
        assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},{axes}]"#)), (feet, None));
        assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},CS[Cartesian,2]]"#)), (feet, None));
        assert_eq!(units(&format!(r#"DERIVEDPROJCRS["S",{of_base},CS[Cartesian,2],{metre}]"#)), (Some(1.0), None));
        let of_base = format!(r#"BASEVERTCRS["V",VDATUM["D"],CS[vertical,1],{foot}]"#);
        assert_eq!(units(&format!(r#"VERTCRS["W",{of_base},DERIVINGCONVERSION["d",METHOD["m"]]]"#)), (None, feet));
        assert_eq!(
            units(&format!(
                r#"ENGCRS["S",EDATUM["D"],CS[Cartesian,3],AXIS["x",east],AXIS["y",north],AXIS["z",up,{metre}],{foot}]"#
            )),
            (feet, Some(1.0))
        );
        assert_eq!(units(r#"LOCAL_CS["S",LOCAL_DATUM["D",1],UNIT["foot",0.3048],AXIS["x",EAST]]"#), (Some(FOOT), None));
        let ellipsoidal = format!(
            r#"GEOGCRS["G",DATUM["D"],CS[ellipsoidal,3],AXIS["lat",north,ANGLEUNIT["degree",0.0174]],AXIS["h",up,{foot}]]"#
        );
        assert_eq!((units(&ellipsoidal), wkt(&ellipsoidal).degrees), ((None, feet), true));
        let geocentric = format!(r#"GEODCRS["G",DATUM["D"],CS[Cartesian,3],AXIS["X",geocentricX],{metre}]"#);
        let geocentric = wkt(&geocentric);
        assert_eq!((geocentric.degrees, geocentric.notes.as_slice()), (false, [GEOCENTRIC.to_owned()].as_slice()));
    }

    #[test]
    fn units_without_a_sound_factor_go_by_their_name_or_code_and_systems_without_units_by_theirs() {
        for (unit, expected) in [
            (r#"UNIT["US survey foot",1.0]"#, Some(US_SURVEY_FOOT)), // as some programs write it
            (r#"UNIT["Foot_US"]"#, Some(US_SURVEY_FOOT)),
            (r#"UNIT["Foot_US",0.3048006]"#, Some(US_SURVEY_FOOT)),
            (r#"UNIT["their foot",0.31]"#, Some(0.31)),
            (r#"UNIT["their foot",AUTHORITY["EPSG","9002"]]"#, Some(FOOT)),
            (r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]]"#, Some(1.0)),
            (r#"UNIT["Degree",0.0174532925199433]"#, None),
            (r#"AUTHORITY["EPSG","2229"]"#, Some(US_SURVEY_FOOT)),
        ] {
            assert_eq!(units(&format!(r#"PROJCS["P",{GEOGRAPHIC},{unit}]"#)).0, expected, "{unit}");
        }
        assert_eq!(
            units(r#"PROJCS["P",UNIT["metre",1]],VERT_CS["V",AUTHORITY["EPSG","6360"]]"#).1,
            Some(US_SURVEY_FOOT)
        );
        let joined =
            r#"COMPD_CS["C",PROJCS["P",UNIT["metre",1]],VERT_CS["V",VERT_DATUM["D",2005]],AUTHORITY["EPSG","8720"]]"#;
        assert_eq!(units(joined).1, epsg::system(8720).and_then(|system| system.up));
        let text = r#"PROJCS["P",UNIT["Foot_US",0.3048006096012192]]"#;
        for before in ["\u{feff}", "ESRI PE String = "] {
            assert_eq!(units(&format!("{before}{text}")).0, Some(US_SURVEY_FOOT), "{before}");
        }
        // All quotes doubled, with quotes in the name; then all escaped by a backslash.
        let text = r#"PROJCS["P ""[old]"" one",UNIT["Foot_US",0.3048006096012192]]"#;
        assert_eq!(units(text).0, Some(US_SURVEY_FOOT));
        let text = r#"PROJCS["P [ftUS]",UNIT["Foot_US",0.3048006096012192]]"#;
        for text in [text.replace('"', "\"\""), text.replace('"', "\\\""), text.replacen('"', "\u{201c}", 1)] {
            assert_eq!(units(&text).0, Some(US_SURVEY_FOOT), "{text}");
        }
    }

    #[test]
    fn depths_are_noted() {
        for text in [
            r#"VERT_CS["V",UNIT["metre",1],AXIS["Depth",DOWN]]"#,
            r#"VERTCS["V",PARAMETER["Direction",-1.0],UNIT["Meter",1.0]]"#,
            r#"VERTCRS["V",ID["EPSG",5715]]"#,
        ] {
            assert_eq!(wkt(text).notes, [DOWNWARD], "{text}");
        }
    }

    #[test]
    fn a_text_and_keys_complete_each_other_and_the_one_that_counts_is_followed() {
        let records = |wkt: &str, entries: &[[u16; 4]]| {
            let mut records = key_records(entries, "", &[]);
            records.keep(WKT, wkt.as_bytes().iter().copied().chain([0, 0]).collect());
            records
        };
        let text = format!(r#"PROJCS["P",{GEOGRAPHIC},UNIT["Meter",1.0]]"#);
        let keys = [[1024, 0, 1, 1], [3072, 0, 1, 5070], [4096, 0, 1, 6360], [4099, 0, 1, 9003]];
        for says_wkt in [true, false] {
            let found = Georeference::read(&records(&text, &keys), says_wkt);
            assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
            assert_eq!((found.text.as_deref(), found.notes.len()), (Some(text.as_str()), 0));
            let feet = [[1024, 0, 1, 1], [3072, 0, 1, 2229]];
            let found = Georeference::read(&records(&text, &feet), says_wkt);
            let counts = if says_wkt { 1.0 } else { US_SURVEY_FOOT };
            assert_eq!((found.horizontal, found.notes.len()), (Some(counts), 1), "{:?}", found.notes);
        }
        let heights = r#"VERTCS["V",UNIT["foot",0.3048]]"#;
        let found = Georeference::read(&records(&format!("{text},{heights}"), &keys), true);
        assert_eq!((found.vertical, found.notes.len()), (Some(FOOT), 1));
    }

    #[test]
    fn keys_name_the_unit_of_heights_by_code_by_system_or_in_words() {
        let vertical = |entries: &[[u16; 4]], text: &str| keys(entries, text, &[]).vertical;
        let feet = [3072, 0, 1, 2229];
        assert_eq!(vertical(&[feet, [4099, 0, 1, 9001]], ""), Some(1.0));
        assert_eq!(vertical(&[feet, [4096, 0, 1, 5703]], ""), Some(1.0));
        assert_eq!(vertical(&[feet, [4096, 0, 1, 6360], [4099, 0, 1, 9002]], ""), Some(FOOT));
        assert_eq!(vertical(&[feet, [4096, 0, 1, 4979]], ""), Some(1.0));
        assert_eq!(vertical(&[feet, [4096, 0, 1, 32767], [4099, 0, 1, 0]], ""), None);
        assert_eq!(vertical(&[[3072, 0, 1, 26915], [4097, GEO_TEXT, 13, 0]], "NAVD88 (ftUS)|"), Some(US_SURVEY_FOOT));
        let both = "Somewhere (m) + height (ftUS)|";
        let found = keys(&[[3073, GEO_TEXT, 30, 0], [3076, 0, 1, 9001]], both, &[]);
        assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(US_SURVEY_FOOT)));
        let degrees = keys(&[[3072, 0, 1, 4326]], "", &[]);
        assert!(degrees.degrees && degrees.horizontal.is_none());
        assert!(keys(&[[2048, 0, 1, 4759]], "", &[]).degrees);
        assert_eq!(keys(&[[1024, 0, 1, 3], [2048, 0, 1, 4978]], "", &[]).notes, [GEOCENTRIC]);
    }

    #[test]
    fn a_code_alone_gives_the_axes_of_its_system() {
        let of = |code| {
            let mut found = Georeference::default();
            let note = found.complete(code).unwrap();
            (found.degrees, found.horizontal, found.vertical, note.is_some())
        };
        for degrees in [4167, 4258, 4326, 4674, 4759, 4807, 9000] {
            assert_eq!(of(degrees), (true, None, None, false), "{degrees}");
        }
        assert_eq!(of(4979), (true, None, Some(1.0), false));
        assert_eq!(of(2229), (false, Some(US_SURVEY_FOOT), None, false));
        assert_eq!(of(5555), (false, Some(1.0), Some(1.0), false));
        assert_eq!(of(6360), (false, None, Some(US_SURVEY_FOOT), false));
        assert_eq!(of(900_913), (false, None, None, true));
        let text = |text: &str| Georeference::of_text(text.to_owned());
        assert_eq!(text("EPSG:2229+5703").codes, [2229, 5703]);
        assert_eq!(
            (text("EPSG:2229+5703").horizontal, text("EPSG:2229+5703").vertical),
            (Some(US_SURVEY_FOOT), Some(1.0))
        );
        assert!(text("urn:ogc:def:crs:EPSG::4674").degrees);
        assert_eq!(text("a site of ours").codes, [0; 0]);
        assert_eq!(["EPSG:5555", "EPSG:4979", "EPSG:25832"].map(projected_epsg), [None, None, Some(25832)]);
        assert_eq!(
            projected_epsg(r#"PROJCS["P",AUTHORITY["EPSG","25832"]],VERTCS["V",AUTHORITY["EPSG","5783"]]"#),
            Some(25832)
        );
    }

    #[test]
    fn codes_are_those_of_the_system_and_its_parts_and_not_of_what_these_rest_on() {
        let found = wkt(
            r#"PROJCRS["P",BASEGEOGCRS["G",ID["EPSG",4258]],CS[Cartesian,2],LENGTHUNIT["metre",1,ID["EPSG",9001]],ID["EPSG",25832]]"#,
        );
        assert_eq!(found.codes, [25832]);
        let found = wkt(
            r#"COMPD_CS["C",PROJCS["P",GEOGCS["G",AUTHORITY["EPSG","4269"]],UNIT["metre",1],AUTHORITY["EPSG","26917"]],VERT_CS["V",AUTHORITY["EPSG","5703"]]]"#,
        );
        assert_eq!(found.codes, [26917, 5703]);
        for none in
            [r#"PROJCS["P",AUTHORITY["ESRI","102100"]]"#, r#"PROJCS["EPSG","25832"]"#, r#"PROJCS["P",ID["EPSG",1e9]]"#]
        {
            assert_eq!(wkt(none).codes, [0; 0], "{none}");
        }
        let mut keyed = keys(&[[3072, 0, 1, 26915]], "", &[]);
        assert!(keyed.complete(26915).is_ok() && keyed.complete(25832).is_err());
    }

    #[test]
    fn degrees_are_told_apart() {
        let found = wkt(r#"GEOGCS["WGS 84",DATUM["D",SPHEROID["S",6378137,298.2]],UNIT["degree",0.0174532925]]"#);
        assert!(found.degrees && found.horizontal.is_none());
    }

    #[test]
    fn damaged_text_is_noted_and_never_followed_deep() {
        for text in ["PROJCS[\"P", "]", "A[B[C", &"A[".repeat(100_000), "PROJCS[UNIT[\"x\",one]]", ""] {
            let found = wkt(text);
            assert!(found.horizontal.is_none());
        }
    }

    fn key_records(entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Records {
        counted_records(entries.len() as u16, entries, text, doubles)
    }

    fn counted_records(stated: u16, entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Records {
        let mut directory = vec![1u16, 1, 0, stated];
        directory.extend(entries.iter().flatten());
        let bytes = |words: Vec<u16>| words.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let mut records = Records::default();
        records.keep(GEO_KEYS, bytes(directory));
        records.keep(GEO_TEXT, text.as_bytes().to_vec());
        records.keep(GEO_DOUBLES, doubles.iter().flat_map(|d| d.to_le_bytes()).collect());
        records
    }

    fn keys(entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Georeference {
        Georeference::read(&key_records(entries, text, doubles), false)
    }

    #[test]
    fn a_projection_of_the_files_own_is_not_named_by_the_geographic_system_below_it() {
        let base = [[1024, 0, 1, 1], [2048, 0, 1, 4269], [3072, 0, 1, USER_DEFINED], [3076, 0, 1, 9002]];
        let mut own = keys(&base, "", &[]);
        assert_eq!((own.text.as_deref(), own.codes.as_slice(), own.horizontal), (None, [].as_slice(), Some(FOOT)));
        assert_eq!(own.complete(2992), Ok(None));
        let cited = [base.as_slice(), &[[3073, GEO_TEXT, 9, 0]]].concat();
        assert_eq!(keys(&cited, "Our grid|", &[]).text.as_deref(), Some("Our grid"));
        let geocentric = keys(&[[1024, 0, 1, GEOCENTRIC_MODEL], [2048, 0, 1, 4978]], "", &[]);
        assert_eq!((geocentric.text.as_deref(), geocentric.horizontal), (Some("EPSG:4978"), Some(1.0)));
    }

    #[test]
    fn statements_that_contradict_each_other_are_noted() {
        let two =
            |axes, counts, other| format!("it states two units for {axes}: {counts} m, which counts, and {other} m");
        let metres = [[3072, 0, 1, 2992], [3076, 0, 1, 9001], [4096, 0, 1, 6360], [4099, 0, 1, 9001]];
        let found = keys(&metres, "", &[]);
        assert_eq!((found.horizontal, found.vertical), (Some(1.0), Some(1.0)));
        assert_eq!(found.notes, [two("heights", "1", "0.3048006096012192"), two("x and y", "1", "0.3048")]);
        let found = wkt(r#"PROJCS["P",UNIT["metre",1],AUTHORITY["EPSG","2992"]]"#);
        assert_eq!((found.horizontal, found.notes), (Some(1.0), vec![two("x and y", "1", "0.3048")]));
        let mut given = keys(&[[3076, 0, 1, 9001]], "", &[]);
        assert_eq!(given.complete(2229), Ok(None));
        assert_eq!(given.notes, [two("x and y", "1", "0.3048006096012192")]);
        let mut given = keys(&[[3076, 0, 1, 9001]], "", &[]);
        assert_eq!((given.complete(4326), given.degrees), (Ok(None), false));
        assert_eq!(given.notes, [LENGTHS_FOR_ANGLES]);
        for sound in [&[[3072, 0, 1, 2992], [3076, 0, 1, 9002]][..], &[[3072, 0, 1, 2155], [4096, 0, 1, 5703]]] {
            assert_eq!(keys(sound, "", &[]).notes, [""; 0]);
        }
        for (unit, counts) in [
            (r#"UNIT["metre",0.3048]"#, FOOT),
            (r#"UNIT["US survey foot",3.28083333333333]"#, US_SURVEY_FOOT),
            (r#"UNIT["foot",3.28084]"#, FOOT),
        ] {
            let found = wkt(&format!(r#"PROJCS["P",{unit}]"#));
            assert_eq!((found.horizontal, found.notes.len()), (Some(counts), 1), "{unit}: {:?}", found.notes);
        }
        for sound in [r#"UNIT["foot",0.3048006096]"#, r#"UNIT["Foot_US",0.304801]"#, r#"UNIT["metre",1.0000135965]"#] {
            assert_eq!(wkt(&format!(r#"PROJCS["P",{sound}]"#)).notes, [""; 0], "{sound}");
        }
    }

    #[test]
    fn keys_that_are_missing_or_surplus_or_refer_to_nothing_are_noted() {
        let entries = [[1024, 0, 1, 1], [3076, 0, 1, 9002]];
        let counted = |stated| Georeference::read(&counted_records(stated, &entries, "", &[]), false);
        assert_eq!((counted(2).horizontal, counted(2).notes), (Some(FOOT), vec![]));
        assert_eq!(counted(1).horizontal, None);
        assert_eq!(counted(1).notes, ["its GeoTIFF directory states 1 keys and has room for 2"]);
        assert_eq!(counted(9).notes[0], "its GeoTIFF directory states 9 keys and has room for 2");
        let padded = [entries[0], [0; 4]];
        assert_eq!(Georeference::read(&counted_records(1, &padded, "", &[]), false).notes, [""; 0]);
        let past = keys(&[[3072, 0, 1, 26910], [3076, 0, 1, USER_DEFINED], [3077, GEO_DOUBLES, 1, 7]], "", &[0.5]);
        assert_eq!(past.notes, ["its GeoTIFF keys state a unit of their own for x and y, but not its length"]);
        let heights = keys(&[[3072, 0, 1, 2992], [4099, 0, 1, USER_DEFINED]], "", &[]);
        assert_eq!(heights.notes, ["its GeoTIFF keys state a unit of their own for heights, but not its length"]);
        let unknown = keys(&[[3072, 0, 1, 2992], [4096, 0, 1, 5103]], "", &[]);
        assert_eq!(unknown.notes, ["the unit of its vertical system 5103 is unknown; that of x and y is taken"]);
    }

    #[test]
    fn a_system_is_in_metres_if_neither_its_text_nor_its_codes_state_another_unit() {
        let of = |unit: &str, code: u32| format!(r#"PROJCS["P",{unit},AUTHORITY["EPSG","{code}"]]"#);
        for metres in ["EPSG:25832", "EPSG:25832+5783", "EPSG:4326", "a site", &of(r#"UNIT["metre",1]"#, 25832)] {
            assert!(is_in_metres(metres), "{metres}");
        }
        let feet = r#"UNIT["foot",0.3048]"#;
        for other in ["EPSG:2992", "EPSG:25832+6360", &of(feet, 2992), &of(feet, 1), &of(r#"UNIT["metre",1]"#, 2992)] {
            assert!(!is_in_metres(other), "{other}");
        }
    }

    #[test]
    fn one_system_in_two_forms_is_one() {
        let forms = ["EPSG:26910", r#"PROJCS["P",UNIT["metre",1],AUTHORITY["EPSG","26910"]]"#];
        let of = |texts: &[&str]| {
            let mut systems = Systems::default();
            for (file, text) in texts.iter().enumerate() {
                systems.add(file, Some((*text).into()), Georeference::of_text((*text).into()).codes);
            }
            (systems.least.map(|least| (least.text, least.files.count)), systems.other.map(|(name, _)| name))
        };
        for [a, b] in [[0, 1], [1, 0]] {
            assert_eq!(of(&[forms[a], forms[b]]), (Some((forms[0].into(), 2)), None));
        }
        assert_eq!(of(&[forms[1], "EPSG:26911"]), (Some(("EPSG:26911".into(), 1)), Some("P".into())));
        assert_eq!(of(&["a site", "another"]), (Some(("a site".into(), 1)), Some("another".into())));
    }

    #[test]
    fn names_give_a_unit_by_whole_words() {
        for (name, expected) in [
            ("NAD_1983_StatePlane_Oregon_North_FIPS_3601_Feet_Intl", Some(FOOT)),
            ("NAD_1983_StatePlane_Oregon_North_FIPS_3601_Feet", Some(US_SURVEY_FOOT)),
            ("NAD 1983 StatePlane Michigan South FIPS 2113 Ft Intl", Some(FOOT)),
            ("Texas Central, U.S. survey feet", Some(US_SURVEY_FOOT)),
            ("Site in us-ft", Some(US_SURVEY_FOOT)),
            ("Site, international feet", Some(FOOT)),
            ("Footprints of Barefoot Bay", None),
            ("Foothills of International Falls", None),
            ("Ft Worth", None),
        ] {
            assert_eq!(unit_in_words(name), expected, "{name}");
        }
    }

    #[test]
    fn keys_give_the_unit_by_code_by_size_or_by_the_system() {
        let stated = keys(&[[3072, 0, 1, 26915], [3076, 0, 1, 9003], [4099, 0, 1, 9002]], "", &[]);
        assert_eq!(stated.text.as_deref(), Some("EPSG:26915"));
        assert_eq!((stated.horizontal, stated.vertical), (Some(US_SURVEY_FOOT), Some(FOOT)));
        let by_size = keys(&[[3076, 0, 1, 32767], [3077, GEO_DOUBLES, 1, 1]], "", &[7.0, 2.5]);
        assert_eq!(by_size.horizontal, Some(2.5));
        for size in [1e-7, 1e9, 0.0, -1.0, f64::NAN] {
            let absurd = keys(&[[3076, 0, 1, 32767], [3077, GEO_DOUBLES, 1, 0]], "", &[size]).absurd_unit();
            assert!(absurd.is_some_and(|unit| unit == size || size.is_nan()), "{size}: {absurd:?}");
            assert!(wkt(&format!(r#"PROJCS["P",UNIT["odd",{size}]]"#)).absurd_unit().is_some(), "{size}");
        }
        assert_eq!(by_size.absurd_unit(), None);
        let by_system = keys(&[[3072, 0, 1, 2229]], "", &[]);
        assert_eq!(by_system.horizontal, Some(US_SURVEY_FOOT));
        let by_words = keys(&[[3073, GEO_TEXT, 14, 0]], "Somewhere (ft)|", &[]);
        assert_eq!((by_words.text.as_deref(), by_words.horizontal), (Some("Somewhere (ft)"), Some(FOOT)));
        let degrees = keys(&[[1024, 0, 1, 2], [2048, 0, 1, 4326]], "", &[]);
        assert!(degrees.degrees && degrees.text.as_deref() == Some("EPSG:4326"));
        let broken = keys(&[[3076, 0, 1, 32632], [3077, GEO_DOUBLES, 1, 900], [3073, GEO_TEXT, 900, 800]], "", &[]);
        assert_eq!((broken.horizontal, broken.text, broken.notes.len()), (None, None, 1));
    }
}
