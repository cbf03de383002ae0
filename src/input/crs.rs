//! Reference system of a file: its name, and how long its units are.
//!
//! In: the projection records. Out: [`Georeference`]. Well-known text (WKT 1 and 2) is read as a tree of brackets, not
//! by searching for words, since the unit of the angles, of the ellipsoid and of the axes stand in the same text. GeoTIFF
//! keys follow the GeoTIFF specification 1.0, section 2.7. Memory: some multiple of the text, at most 1 MiB each.
//!
//! Small case: `PROJCS["P",GEOGCS["G",UNIT["degree",0.0174]],UNIT["foot",0.3048]]`: the child `UNIT` of `PROJCS` counts
//! (0.3048), the one within `GEOGCS` does not.

use super::epsg::{self, FOOT, US_SURVEY_FOOT};
use super::header::{f64_at, u16_at};
use super::records::{GEO_DOUBLES, GEO_KEYS, GEO_TEXT, MOST_TEXT, Records, WKT};
use super::{ScanFile, Those};
use crate::Monitor;

/// What a file says about its coordinates.
#[derive(Debug, Default, Clone, PartialEq)]
pub(super) struct Georeference {
    /// WKT, else `EPSG:n`, else the citation of the GeoTIFF keys.
    pub text: Option<String>,
    /// EPSG codes of the system and of what it consists of, as far as it states them.
    pub codes: Vec<u32>,
    /// Metres per unit of x and y, as stated: any number.
    pub horizontal: Option<f64>,
    /// Metres per unit of z, likewise.
    pub vertical: Option<f64>,
    /// x and y are longitude and latitude.
    pub degrees: bool,
    /// Soft problems, for the monitor.
    pub notes: Vec<String>,
}

/// Units that are believed (m): scans come in units from the millimetre to the mile, and a size beyond an order of
/// magnitude more is damage that would crush the scene to a point or blow it up.
const BELIEVED_M: std::ops::RangeInclusive<f64> = 1e-3..=1e4;

impl Georeference {
    /// A stated unit that cannot be meant.
    pub(super) fn absurd_unit(&self) -> Option<f64> {
        [self.horizontal, self.vertical].into_iter().flatten().find(|unit| !BELIEVED_M.contains(unit))
    }

    /// Completes what the file says by the system `code`, if the file names none. Returns a note if the two cannot be
    /// compared; refuses another one.
    pub(super) fn complete(&mut self, code: u32) -> Result<Option<String>, String> {
        match &self.text {
            None => {
                self.degrees |= epsg::is_geographic(code);
                let unit = u16::try_from(code).ok().filter(|_| !self.degrees).and_then(epsg::projected);
                self.horizontal = self.horizontal.or(unit);
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

    pub(super) fn read(records: &Records, says_wkt: bool) -> Self {
        let wkt = records.projection(WKT).and_then(clean_text);
        let keys = records.projection(GEO_KEYS).map(|keys| Self::from_keys(keys, records));
        let keys = keys.filter(|k| *k != Self::default());
        match (wkt, keys) {
            // A file that has both and does not say which counts: the keys did, before LAS 1.4.
            (Some(wkt), Some(keys)) if !says_wkt => Self { text: Some(wkt), ..keys },
            (Some(wkt), _) => Self::from_wkt(wkt),
            (None, keys) => keys.unwrap_or_default(),
        }
    }

    /// Of a file that states its system as text alone.
    pub(super) fn of_text(text: String) -> Self {
        if text.len() as u64 > MOST_TEXT {
            let note = format!("its reference system is {} bytes long; it is passed over", text.len());
            return Self { notes: vec![note], ..Self::default() };
        }
        if text.contains(['[', '(']) { Self::from_wkt(text) } else { Self { text: Some(text), ..Self::default() } }
    }

    fn from_wkt(text: String) -> Self {
        let mut found = Self::default();
        match Node::parse(&text) {
            Some(root) => found.take(&root),
            None => found.notes.push("the well-known text of its reference system is damaged".into()),
        }
        found.text = Some(text);
        found
    }

    fn take(&mut self, node: &Node) {
        if node.word.ends_with("CS") || node.word.ends_with("CRS") {
            self.codes.extend(node.epsg_code());
        }
        match node.word.as_str() {
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" => {
                self.horizontal = self.horizontal.or(node.length_unit());
            }
            "GEOCCS" | "GEOCENTRICCRS" => {
                self.horizontal = self.horizontal.or(node.length_unit());
                self.notes.push("its reference system is geocentric: its z axis does not point up".into());
            }
            "GEOGCS" | "GEOGCRS" | "GEOGRAPHICCRS" | "GEODCRS" | "GEODETICCRS" => {
                self.degrees = true;
                // A third axis of its own unit: ellipsoidal heights.
                self.vertical = self.vertical.or(node.axis_unit("up"));
            }
            "VERT_CS" | "VERTCRS" | "VERTICALCRS" => self.vertical = self.vertical.or(node.length_unit()),
            "LOCAL_CS" | "ENGCRS" | "ENGINEERINGCRS" => {
                self.horizontal = self.horizontal.or(node.length_unit());
            }
            "COMPD_CS" | "COMPOUNDCRS" | "BOUNDCRS" | "SOURCECRS" => node.children.iter().for_each(|c| self.take(c)),
            _ => {}
        }
    }

    fn from_keys(keys: &[u8], records: &Records) -> Self {
        let mut found = Self::default();
        let text = records.projection(GEO_TEXT).unwrap_or_default();
        let doubles = records.projection(GEO_DOUBLES).unwrap_or_default();
        let entries: Vec<[u16; 4]> = keys
            .chunks_exact(8)
            .skip(1) // the directory's own head
            .map(|e| [u16_at(e, 0), u16_at(e, 2), u16_at(e, 4), u16_at(e, 6)])
            .collect();
        let entry = |id: u16| entries.iter().find(|e| e[0] == id);
        let code = |id| entry(id).filter(|e| e[1] == 0).map(|e| e[3]);
        let double = |id| {
            let at = 8 * usize::from(entry(id).filter(|e| e[1] == GEO_DOUBLES)?[3]);
            (at + 8 <= doubles.len()).then(|| exact(f64_at(doubles, at)))
        };
        let citation = |id| {
            let e = entry(id).filter(|e| e[1] == GEO_TEXT)?;
            let from = usize::from(e[3]);
            clean_text(text.get(from..(from + usize::from(e[2])).min(text.len()))?)
        };
        found.degrees = code(1024) == Some(2);
        let projected = code(3072).filter(|&c| epsg::projected(c).is_some());
        let geographic = code(2048).filter(|&c| c != 0 && c < 32767);
        let named = if found.degrees { geographic } else { projected.or(geographic) };
        found.codes.extend(named.map(u32::from));
        let cited = citation(3073).or_else(|| citation(1026));
        found.text = named.map(|n| format!("EPSG:{n}")).or_else(|| cited.clone());
        if !found.degrees {
            let stated = match code(3076) {
                Some(32767) => double(3077),
                Some(unit) => {
                    let length = epsg::unit(unit);
                    if length.is_none() {
                        found.notes.push(format!("its GeoTIFF keys name {unit} as unit of length, which is none"));
                    }
                    length
                }
                None => None,
            };
            found.horizontal = stated
                .or_else(|| projected.and_then(epsg::projected))
                .or_else(|| cited.as_deref().and_then(unit_in_words));
        }
        found.vertical =
            code(4099).and_then(epsg::unit).or_else(|| code(4096).filter(|&c| c > 5100).and_then(epsg::vertical));
        found
    }
}

/// EPSG code of the projected system in what an archive says of its reference system: `EPSG:n`, or well-known text.
pub fn projected_epsg(text: &str) -> Option<u16> {
    fn find(node: &Node) -> Option<u32> {
        match node.word.as_str() {
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" => node.epsg_code(),
            "COMPD_CS" | "COMPOUNDCRS" | "BOUNDCRS" | "SOURCECRS" => node.children.iter().find_map(find),
            _ => None,
        }
    }
    let code = match text.strip_prefix("EPSG:") {
        Some(code) => code.parse().ok().filter(|code| !epsg::is_geographic(*code)),
        None => find(&Node::parse(text)?),
    };
    code.and_then(|code| u16::try_from(code).ok()).filter(|code| epsg::projected(*code).is_some())
}

/// Text of a record without its terminator; `None` when nothing is left.
fn clean_text(bytes: &[u8]) -> Option<String> {
    let text = bytes.split(|&b| b == 0).next().unwrap_or_default();
    let text = String::from_utf8_lossy(text);
    let text = text.trim().trim_end_matches('|').trim();
    (!text.is_empty()).then(|| text.to_string())
}

/// The reference systems of a set of files, found one file after the other. Texts may be long and many: two are held.
#[derive(Default)]
pub(super) struct Systems {
    /// The one whose text sorts first, and the files that state it.
    least: Option<(String, Those)>,
    /// One of the others, and the files that state any of these.
    other: Option<(String, Those)>,
}

impl Systems {
    /// Adds what file `file` states; files come in ascending order.
    pub(super) fn add(&mut self, file: usize, text: Option<String>) {
        let Some(text) = text else { return };
        let mut here = Those::default();
        here.add(file, true);
        match &mut self.least {
            None => self.least = Some((text, here)),
            Some((least, files)) if *least == text => files.add(file, true),
            Some(least) => {
                let (name, files) = if text < least.0 { std::mem::replace(least, (text, here)) } else { (text, here) };
                match &mut self.other {
                    Some((_, others)) => others.count += files.count,
                    none => *none = Some((short_name(&name), files)),
                }
            }
        }
    }

    /// The text that sorts first; tells `monitor` if there are others.
    pub(super) fn common(self, files: &[ScanFile], monitor: &dyn Monitor) -> Option<String> {
        let (text, those) = self.least?;
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

/// A reference system for messages: the name in its text, or its code.
fn short_name(text: &str) -> String {
    let name = text.split('"').nth(1).unwrap_or(text);
    name.chars().take(60).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// A unit named in a citation such as "NAD83 / Texas Central (ftUS)": the last resort.
fn unit_in_words(text: &str) -> Option<f64> {
    let text = text.to_ascii_lowercase();
    let any = |words: &[&str]| words.iter().any(|w| text.contains(w));
    if any(&["ftus", "us survey f", "us-ft", "us_survey_f", "foot_us"]) {
        Some(US_SURVEY_FOOT)
    } else if any(&["(ft)", "international f", "foot", "feet"]) {
        Some(FOOT)
    } else {
        None
    }
}

/// Replaces a printed conversion factor by the metre or the exact foot that it stands for.
fn exact(factor: f64) -> f64 {
    let near = |exact: &f64| (factor - exact).abs() <= 1e-9 * exact;
    [1.0, FOOT, US_SURVEY_FOOT].into_iter().find(near).unwrap_or(factor)
}

/// One bracketed word of well-known text.
#[derive(Debug, Default)]
struct Node {
    word: String,
    numbers: Vec<f64>,
    /// Bare words such as axis directions, in lower case.
    bare: Vec<String>,
    /// Whether a quoted text in it is `EPSG`, and the last quoted text that is a number: `AUTHORITY["EPSG","25832"]`.
    is_epsg: bool,
    quoted_number: Option<u32>,
    children: Vec<Node>,
}

/// Longest EPSG code (digits).
const LONGEST_CODE: usize = 8;
/// Deepest nesting that is followed; real texts have about eight.
const DEEPEST: usize = 48;

impl Node {
    fn parse(text: &str) -> Option<Node> {
        let mut open: Vec<Node> = Vec::new();
        let mut token = String::new();
        let mut characters = text.chars();
        while let Some(c) = characters.next() {
            match c {
                '"' => {
                    // Content of quotes may hold brackets; only that of an EPSG code is needed.
                    let mut quoted = String::new();
                    loop {
                        match characters.next()? {
                            '"' => break,
                            c if quoted.len() <= LONGEST_CODE => quoted.push(c),
                            _ => {}
                        }
                    }
                    if let Some(node) = open.last_mut() {
                        node.is_epsg |= quoted.eq_ignore_ascii_case("EPSG");
                        node.quoted_number = quoted.parse().ok().or(node.quoted_number);
                    }
                }
                '[' | '(' => {
                    if open.len() == DEEPEST {
                        return None;
                    }
                    let word = std::mem::take(&mut token).to_ascii_uppercase();
                    open.push(Node { word, ..Node::default() });
                }
                ']' | ')' => {
                    let mut done = open.pop()?;
                    done.give(std::mem::take(&mut token));
                    match open.last_mut() {
                        Some(parent) => parent.children.push(done),
                        None => return Some(done),
                    }
                }
                ',' => open.last_mut()?.give(std::mem::take(&mut token)),
                c if c.is_whitespace() => {}
                c => token.push(c),
            }
        }
        None
    }

    fn give(&mut self, token: String) {
        match token.parse::<f64>() {
            Ok(number) => self.numbers.push(number),
            Err(_) if token.is_empty() => {}
            Err(_) => self.bare.push(token.to_ascii_lowercase()),
        }
    }

    /// Its own EPSG code: `AUTHORITY["EPSG","25832"]` (WKT 1) or `ID["EPSG",25832]` (WKT 2).
    fn epsg_code(&self) -> Option<u32> {
        let id = self.children.iter().find(|c| c.is_epsg && (c.word == "AUTHORITY" || c.word == "ID"))?;
        let number = || id.numbers.first().filter(|number| (1.0..=1e6).contains(*number)).map(|&number| number as u32);
        id.quoted_number.or_else(number)
    }

    fn unit(&self) -> Option<f64> {
        let unit = self.children.iter().find(|c| c.word == "UNIT" || c.word == "LENGTHUNIT")?;
        unit.numbers.first().map(|&factor| exact(factor))
    }

    /// Unit of the system, or (WKT 2 may state it so) of its first axis that has one.
    fn length_unit(&self) -> Option<f64> {
        self.unit().or_else(|| self.children.iter().filter(|c| c.word == "AXIS").find_map(Node::unit))
    }

    fn axis_unit(&self, direction: &str) -> Option<f64> {
        let axis = |c: &&Node| c.word == "AXIS" && c.bare.iter().any(|b| b == direction);
        self.children.iter().find(axis).and_then(Node::unit)
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

    fn keys(entries: &[[u16; 4]], text: &str, doubles: &[f64]) -> Georeference {
        let mut directory = vec![1u16, 1, 0, entries.len() as u16];
        directory.extend(entries.iter().flatten());
        let bytes = |words: Vec<u16>| words.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let mut records = Records::default();
        records.keep(GEO_KEYS, bytes(directory));
        records.keep(GEO_TEXT, text.as_bytes().to_vec());
        records.keep(GEO_DOUBLES, doubles.iter().flat_map(|d| d.to_le_bytes()).collect());
        Georeference::read(&records, false)
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
