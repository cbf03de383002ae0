//! Well-known text (WKT 1 and 2, by GDAL or ESRI), parsed as a tree of brackets; a search for words would not do, since
//! the units of the angles, the ellipsoid and the axes are in the same text.
//!
//! Programs omit brackets or write too many: a system that cannot be part of another becomes its sibling.
//!
//! Example: in `PROJCS["P",GEOGCS["G",UNIT["degree",0.0174]],UNIT["foot",0.3048]]`, the child `UNIT` of `PROJCS` counts
//! (0.3048), the one within `GEOGCS` does not.

use crate::epsg::{self, FOOT, US_SURVEY_FOOT};
use crate::text::number;

/// Returns the length of a unit of well-known text by its name, for units that scans use.
fn unit_named(name: &str) -> Option<f64> {
    let name = name.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase();
    match name.as_str() {
        "m" | "metre" | "meter" | "metres" | "meters" => Some(1.0),
        "ft" | "foot" | "feet" | "internationalfoot" | "internationalfeet" | "footintl" | "footinternational" => {
            Some(FOOT)
        }
        "ftus" | "usft" | "footus" | "usfoot" | "ussurveyfoot" | "ussurveyfeet" | "surveyfoot" => Some(US_SURVEY_FOOT),
        _ => None,
    }
}

/// Kind of reference system that a WKT keyword stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Projected,
    Geographic,
    Geocentric,
    /// Axes of a site.
    Local,
    Vertical,
    /// A combination of other systems.
    Several,
}

impl Kind {
    pub fn of(word: &str) -> Option<Kind> {
        Some(match word {
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" | "DERIVEDPROJCRS" => Self::Projected,
            "GEOGCS" | "GEOGCRS" | "GEOGRAPHICCRS" | "GEODCRS" | "GEODETICCRS" => Self::Geographic,
            "GEOCCS" | "GEOCENTRICCRS" => Self::Geocentric,
            "LOCAL_CS" | "ENGCRS" | "ENGINEERINGCRS" => Self::Local,
            "VERT_CS" | "VERTCS" | "VERTCRS" | "VERTICALCRS" => Self::Vertical,
            "COMPD_CS" | "COMPOUNDCRS" | "BOUNDCRS" | "SOURCECRS" | "FITTED_CS" | "COORDINATEMETADATA" => Self::Several,
            _ => return None,
        })
    }
}

/// One WKT keyword with its brackets.
#[derive(Debug, Default)]
pub struct Node {
    pub word: String,
    /// First quoted text.
    pub name: Option<String>,
    pub numbers: Vec<f64>,
    /// Bare words such as axis directions, in lower case.
    pub bare: Vec<String>,
    /// Last quoted text that is a number: `AUTHORITY["EPSG","25832"]`.
    quoted_number: Option<u32>,
    pub children: Vec<Node>,
}

/// Relative difference up to which a factor is one of the feet that surveys use, whatever their name.
const BETWEEN_FEET: f64 = 1e-4;
/// Maximum number of bytes kept of a quoted text.
const LONGEST_NAME: usize = 64;
/// Maximum nesting depth; real texts have about eight levels.
const DEEPEST: usize = 48;

impl Node {
    /// Parses `text` into its top-level nodes; also returns whether the text is whole. Missing brackets are closed
    /// where a system begins that cannot be part of the one before, or at the end; surplus brackets are ignored.
    pub fn parse(text: &str) -> (Vec<Node>, bool) {
        // Some programs double each quote, or escape it with a backslash.
        let text = text.replace("\\\"", "\"").replace(['\u{201c}', '\u{201d}'], "\"");
        let is_doubled = ["[\"\"", "(\"\""].iter().any(|start| {
            text.find(start).and_then(|at| text[at + start.len()..].chars().next()).is_some_and(char::is_alphanumeric)
        });
        let text = if is_doubled { text.replace("\"\"", "\"") } else { text };
        let (mut roots, mut open, mut token) = (Vec::new(), Vec::<Node>::new(), String::new());
        let mut is_whole = true;
        let mut characters = text.chars().peekable();
        while let Some(c) = characters.next() {
            match c {
                '"' => {
                    // Quoted text may contain brackets and doubled quotes.
                    let mut quoted = String::new();
                    loop {
                        match characters.next() {
                            Some('"') if characters.next_if_eq(&'"').is_none() => break,
                            Some(c) if quoted.len() < LONGEST_NAME => quoted.push(c),
                            Some(_) => {}
                            None => {
                                is_whole = false;
                                break;
                            }
                        }
                    }
                    if let Some(node) = open.last_mut() {
                        node.quoted_number = quoted.parse().ok().or(node.quoted_number);
                        node.name.get_or_insert(quoted);
                    }
                }
                '[' | '(' => {
                    // A byte order mark, or a label as in `ESRI PE String = PROJCS[...`, may stand before a keyword.
                    let token = std::mem::take(&mut token).to_ascii_uppercase();
                    let is_other = |c: char| !c.is_ascii_alphanumeric() && c != '_';
                    let word = token.rsplit(is_other).next().unwrap_or_default().to_owned();
                    while open.last().is_some_and(|parent| !parent.may_hold(&word)) {
                        close(&mut open, &mut roots);
                    }
                    if open.len() == DEEPEST {
                        return (Vec::new(), false);
                    }
                    open.push(Node { word, ..Node::default() });
                }
                ']' | ')' => {
                    let token = std::mem::take(&mut token);
                    if let Some(node) = open.last_mut() {
                        node.give(token);
                        close(&mut open, &mut roots);
                    }
                }
                ',' | ';' => {
                    let token = std::mem::take(&mut token);
                    if let Some(node) = open.last_mut() {
                        node.give(token);
                    }
                }
                c if c.is_whitespace() => {}
                c => token.push(c),
            }
        }
        is_whole &= token.is_empty();
        while !open.is_empty() {
            close(&mut open, &mut roots);
        }
        (roots, is_whole)
    }

    /// Returns whether `word` may be nested in this node. Systems are siblings, except that a projected one contains a
    /// geographic one, which does not contain the projection.
    fn may_hold(&self, word: &str) -> bool {
        let own = Kind::of(&self.word);
        let holds_any = own == Some(Kind::Several) || own.is_none() && self.word.ends_with("CRS");
        match Kind::of(word) {
            Some(Kind::Geographic) => holds_any || own == Some(Kind::Projected),
            Some(_) => holds_any,
            None if matches!(word, "PROJECTION" | "CONVERSION") => {
                own != Some(Kind::Geographic) && !self.word.starts_with("BASEGEO")
            }
            None => true,
        }
    }

    fn give(&mut self, token: String) {
        match token.parse::<f64>() {
            Ok(number) => self.numbers.push(number),
            Err(_) if token.is_empty() => {}
            Err(_) => self.bare.push(token.to_ascii_lowercase()),
        }
    }

    /// Returns the node's own EPSG code: `AUTHORITY["EPSG","25832"]` (WKT 1) or `ID["EPSG",25832]` (WKT 2).
    pub fn epsg_code(&self) -> Option<u32> {
        let is_epsg = |node: &&Node| node.name.as_ref().is_some_and(|name| name.eq_ignore_ascii_case("EPSG"));
        let id = self.children.iter().filter(|c| c.word == "AUTHORITY" || c.word == "ID").find(is_epsg)?;
        let number = || id.numbers.first().filter(|number| (1.0..=1e6).contains(*number)).map(|&number| number as u32);
        id.quoted_number.or_else(number)
    }

    pub fn axes(&self) -> impl Iterator<Item = &Node> {
        self.children.iter().filter(|child| child.word == "AXIS")
    }

    pub fn is_vertical(&self) -> bool {
        self.bare.iter().any(|word| word == "up" || word == "down")
    }

    /// Returns whether heights grow downwards, according to the axis or (ESRI) a parameter.
    pub fn points_down(&self) -> bool {
        let direction = |child: &Node| {
            child.word == "PARAMETER"
                && child.name.as_deref() == Some("Direction")
                && child.numbers.first() == Some(&-1.0)
        };
        self.axes().any(|axis| axis.bare.iter().any(|word| word == "down")) || self.children.iter().any(direction)
    }

    pub fn is_geocentric(&self) -> bool {
        let is_cartesian =
            |child: &Node| child.word == "CS" && child.bare.first().is_some_and(|kind| kind == "cartesian");
        self.children.iter().any(is_cartesian)
    }

    /// Returns the length of the node's own unit by its factor, or else by its name or code.
    pub fn unit(&self, notes: &mut Vec<String>) -> Option<f64> {
        let unit = self.children.iter().find(|child| child.word == "UNIT" || child.word == "LENGTHUNIT")?;
        let name = unit.name.as_deref().unwrap_or_default();
        let is_angle = ["deg", "grad", "rad", "gon"].iter().any(|word| name.to_ascii_lowercase().starts_with(word));
        if is_angle && unit.word == "UNIT" {
            return None;
        }
        let coded = || unit.epsg_code().and_then(|code| epsg::unit(code.try_into().ok()?));
        let meant = unit_named(name).or_else(coded);
        let near = |factor: f64, meant: f64| (factor - meant).abs() <= BETWEEN_FEET * meant;
        match (unit.numbers.first().map(|&factor| epsg::exact(factor)), meant) {
            (Some(factor), Some(meant)) if !near(factor, meant) => {
                // Some programs write 1, or units per metre; another factor overrules the name, as the standard says.
                let counts = if factor == 1.0 || near(factor, 1.0 / meant) { meant } else { factor };
                notes.push(format!(
                    "its reference system states {} m as length of the unit {name}; {} m counts",
                    number(factor),
                    number(counts)
                ));
                Some(counts)
            }
            (factor, meant) => factor.or(meant),
        }
    }

    /// Returns the unit of the horizontal axes: that of the system, else (in WKT 2) of the first axis that has one,
    /// else of the system it is derived from.
    pub fn ground_unit(&self, notes: &mut Vec<String>) -> Option<f64> {
        let own = self
            .unit(notes)
            .or_else(|| self.axes().filter(|axis| !axis.is_vertical()).find_map(|axis| axis.unit(notes)));
        let is_base = |child: &&Node| matches!(child.word.as_str(), "BASEPROJCRS" | "BASEENGCRS");
        own.or_else(|| self.children.iter().find(is_base)?.ground_unit(notes))
    }

    /// Returns the unit of a vertical system: its own, else that of an axis, else of the system it is derived from.
    pub fn height_unit(&self, notes: &mut Vec<String>) -> Option<f64> {
        let own = self.unit(notes).or_else(|| self.axes().find_map(|axis| axis.unit(notes)));
        own.or_else(|| self.children.iter().find(|child| child.word == "BASEVERTCRS")?.height_unit(notes))
    }
}

/// Closes the innermost open node. A unit or axis cut off by a surplus bracket is attached to the system before it.
fn close(open: &mut Vec<Node>, roots: &mut Vec<Node>) {
    let Some(node) = open.pop() else { return };
    let siblings = match open.last_mut() {
        Some(parent) if Kind::of(&parent.word) != Some(Kind::Several) => return parent.children.push(node),
        Some(parent) => &mut parent.children,
        None => roots,
    };
    let is_part = matches!(node.word.as_str(), "UNIT" | "LENGTHUNIT" | "AXIS");
    match siblings.iter_mut().rev().find(|before| is_part && Kind::of(&before.word).is_some()) {
        Some(system) => system.children.push(node),
        None => siblings.push(node),
    }
}
